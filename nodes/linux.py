"""What a process may ask of Linux about itself: rights, memory, scheduling; the calls and nothing decided.

What to ask for is :mod:`manyhands.nodes.realtime`'s business, which takes any :class:`System`.
"""

from __future__ import annotations

import ctypes
import os
import resource
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Protocol

CAP_IPC_LOCK: Final = 14  # linux/capability.h
CAP_SYS_NICE: Final = 23

_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4  # asm-generic/mman.h
_PR_GET_TIMERSLACK: Final = 30  # linux/prctl.h
_ZEROMQ_THREAD: Final = "ZMQbg/"  # how libzmq's threads are named
_EVERY_USER: Final = ["0", "0", "4294967295"]  # /proc/self/uid_map of the first user namespace


@dataclass(frozen=True)
class Scheduling:
    """How the loop's thread and ZeroMQ's are scheduled.

    Attributes:
        policy: their policy, with SCHED_RESET_ON_FORK where that is set.
        priority: of ZeroMQ's threads.
        runaway: RLIMIT_RTTIME's soft limit, us.
        below: by how much the loop's thread has less.
    """

    policy: int
    priority: int
    runaway: int
    below: int = 0


class System(Protocol):
    """What is asked of the operating system; a test gives answers of its own."""

    def capable(self, capability: int) -> bool:
        """Whether the process has this capability over the machine, and not in a user namespace alone."""
        ...

    def memory_limit(self) -> int | None:
        """How much memory may be locked, bytes; None without a limit."""
        ...

    def mapped(self) -> int:
        """Size of the process's address space, bytes."""
        ...

    def lock_memory(self) -> None:
        """Lock all memory, or raise OSError."""
        ...

    def unlock_memory(self) -> None:
        """Unlock all memory."""
        ...

    def priority_limit(self) -> int:
        """The greatest real-time priority that may be asked for without the capability."""
        ...

    def scheduling(self) -> Scheduling:
        """How the calling thread is scheduled, and with it those that it has made."""
        ...

    def schedule(self, wanted: Scheduling) -> int:
        """Schedule the calling thread and ZeroMQ's so, or raise OSError; returns how many threads they are."""
        ...

    def processors(self) -> set[int]:
        """The processors that the calling thread may use."""
        ...

    def timer_slack(self) -> int | None:
        """The calling thread's timer slack, ns; None where it cannot be had."""
        ...


class Linux:
    """The calls themselves."""

    def __init__(self) -> None:
        self._libc = ctypes.CDLL(None, use_errno=True)

    def capable(self, capability: int) -> bool:
        """See :class:`System`."""
        effective = int(_status("CapEff"), 16)
        return bool(effective >> capability & 1) and Path("/proc/self/uid_map").read_text().split() == _EVERY_USER

    def memory_limit(self) -> int | None:
        """See :class:`System`."""
        soft = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
        return None if soft == resource.RLIM_INFINITY else soft

    def mapped(self) -> int:
        """See :class:`System`."""
        return int(_status("VmSize").split()[0]) * 1024

    def lock_memory(self) -> None:
        """See :class:`System`."""
        self._checked(self._libc.mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT))

    def unlock_memory(self) -> None:
        """See :class:`System`."""
        self._checked(self._libc.munlockall())

    def priority_limit(self) -> int:
        """See :class:`System`."""
        soft = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
        return 99 if soft == resource.RLIM_INFINITY else min(soft, 99)

    def scheduling(self) -> Scheduling:
        """See :class:`System`."""
        runaway = resource.getrlimit(resource.RLIMIT_RTTIME)[0]
        return Scheduling(os.sched_getscheduler(0), os.sched_getparam(0).sched_priority, runaway)

    def schedule(self, wanted: Scheduling) -> int:
        """See :class:`System`.

        The limit comes first: there is no moment in which a thread has the priority and nothing stops it. The hard
        limit stays as it is, for one that is lowered cannot be raised again.
        """
        hard = resource.getrlimit(resource.RLIMIT_RTTIME)[1]
        soft = wanted.runaway if hard == resource.RLIM_INFINITY or wanted.runaway == hard else min(wanted.runaway, hard)
        resource.setrlimit(resource.RLIMIT_RTTIME, (soft, hard))
        threads = [0, *_zeromq_threads()]
        for thread in threads:
            priority = wanted.priority - wanted.below if thread == 0 else wanted.priority
            os.sched_setscheduler(thread, wanted.policy, os.sched_param(priority))
        return len(threads)

    def processors(self) -> set[int]:
        """See :class:`System`."""
        return os.sched_getaffinity(0)

    def timer_slack(self) -> int | None:
        """See :class:`System`."""
        slack = self._libc.prctl(_PR_GET_TIMERSLACK, 0, 0, 0, 0)
        return slack if slack >= 0 else None

    def _checked(self, result: int) -> None:
        if result != 0:
            number = ctypes.get_errno()
            raise OSError(number, os.strerror(number))


def _zeromq_threads() -> list[int]:
    """ZeroMQ's threads that have begun their work, which is when they take their names.

    Before that such a thread reads how it is scheduled and sets it again: were it changed between the two, the kernel
    could refuse what it sets, and libzmq would abort the process.
    """
    threads = Path("/proc/self/task").iterdir()
    return [int(thread.name) for thread in threads if (thread / "comm").read_text().startswith(_ZEROMQ_THREAD)]


def _status(key: str) -> str:
    """A line of /proc/self/status."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(line.split(":", 1)[1].strip() for line in lines if line.startswith(f"{key}:"))
