"""What a node's process asks of the kernel before its loop: its memory kept, its turn before others', no slack.

Each wish may be refused, and a loop runs without any of them, only less evenly. So nothing is raised here: every step
says in a sentence what was granted, or why not and what would have helped, and a figure says it to the report.

**Memory** is locked, pages in use and those still to come, each when it is first touched (MCL_ONFAULT): a page that
the loop has used is there in its next tick. Without MCL_ONFAULT every mapped page would be read in at once, several
times what a node uses, for code that never runs. Where the limit on locked memory is too small nothing is locked, for
MCL_FUTURE has every allocation beyond the limit fail.

**SCHED_FIFO** is for a process that is pinned to one processor, for the loop's thread and ZeroMQ's, which is one above,
so that a frame leaves when it is sent and not when the loop waits next: a loop that comes before others
waits for ZeroMQ's thread all the same, and gains nothing while that one does not (docs/decisions/0017-timing.md has
figures). So it is asked for when frames have gone over the links: that thread then runs; one that is still starting is
left as it is. Children and later threads do not inherit it. A loop that has gone wild does not take its processor with
it: RLIMIT_RTTIME ends a process of which a thread has computed for :data:`RUNAWAY_TIME` without waiting once (SIGXCPU).

What a process may ask of Linux about itself: rights, memory, scheduling; the calls and nothing decided.

What to ask for is :mod:`manyhands.nodes.realtime`'s business, which takes any :class:`System`.
"""

from __future__ import annotations

import ctypes
import os
import resource
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Protocol

from manyhands.protocol.clock import Duration, from_seconds

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


FIFO_PRIORITY: Final = 10  # of 1 ... 99; interrupt threads of a PREEMPT_RT kernel have 50
RUNAWAY_TIME: Final = from_seconds(0.5)  # hundreds of ticks; a loop waits several times in each
RESERVE: Final = 64 * 2**20  # bytes that a loop may still map: thread stacks, arenas, telemetry


@dataclass(frozen=True)
class RealtimeWishes:
    """What a process would like.

    Attributes:
        memory: have its memory locked.
        priority: of SCHED_FIFO, 1 ... 99; 0 for ordinary scheduling.
        reserve: bytes that it may still map after :func:`prepare`.
        runaway: for how long it may compute under SCHED_FIFO without waiting.
    """

    memory: bool = True
    priority: int = FIFO_PRIORITY
    reserve: int = RESERVE
    runaway: Duration = RUNAWAY_TIME


@dataclass(frozen=True)
class Grant:
    """Whether a wish was granted, and in a sentence: what was, or why not."""

    granted: bool
    said: str


@dataclass(frozen=True)
class Granted:
    """What :func:`prepare` was granted.

    Attributes:
        memory_locked: pages in use stay in memory.
        fifo: SCHED_FIFO.
        timer_slack: the least there is, which :class:`manyhands.protocol.clock.RealtimeClock` asks for.
        pinned: to one processor, which whoever starts the process does.
        before: what :func:`restore` goes back to; None where scheduling was not changed.
    """

    memory_locked: Grant
    fifo: Grant
    timer_slack: Grant
    pinned: Grant
    before: Scheduling | None = None

    def figures(self) -> dict[str, float]:
        """1 for each that was granted and 0 for the others, under the names of the report."""
        return {f"realtime_{name}": float(grant.granted) for name, grant in self.grants().items()}

    def grants(self) -> dict[str, Grant]:
        """All of them, by name."""
        return {
            "memory_locked": self.memory_locked,
            "fifo": self.fifo,
            "timer_slack": self.timer_slack,
            "pinned": self.pinned,
        }


def prepare(wishes: RealtimeWishes, system: System | None = None) -> Granted:
    """Ask for all that is wished; to be called in the loop's thread, when frames have gone over its links.

    Args:
        wishes: what to ask for.
        system: whom to ask; the kernel by default.
    """
    asked = Linux() if system is None else system
    processors = asked.processors()
    pinned = Grant(len(processors) == 1, f"may use the processors {', '.join(map(str, sorted(processors)))}")
    fifo, before = _raise(wishes, asked, pinned.granted)
    return Granted(_lock(wishes, asked), fifo, _slack(asked), pinned, before)


def restore(granted: Granted, system: System | None = None) -> None:
    """Give back what :func:`prepare` was granted: locked memory, priority and its limit; in the same thread.

    Raises:
        OSError: the kernel does not take it back.
    """
    asked = Linux() if system is None else system
    if granted.memory_locked.granted:
        asked.unlock_memory()
    if granted.before is not None:
        _schedule_as_before(granted.before, asked)


def _schedule_as_before(before: Scheduling, system: System) -> None:
    try:
        system.schedule(before)
    except PermissionError:  # only the privileged may have children inherit again
        system.schedule(Scheduling(before.policy | os.SCHED_RESET_ON_FORK, before.priority, before.runaway))


def way_giver() -> Callable[[], None]:
    """What a loop calls when a tick's signals are sent, before it does what can wait.

    Under SCHED_FIFO nobody of the same priority gets the processor before this thread waits: those who have just been
    sent something, and run on it, come first. Under ordinary scheduling it does nothing: there a thread that gives way
    may wait for strangers.
    """
    policy = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
    return os.sched_yield if policy == os.SCHED_FIFO else _go_on


def _go_on() -> None:
    pass


def may_raise(system: System | None = None) -> bool:
    """Whether a process like this one may have a real-time priority; its control group may refuse it all the same."""
    asked = Linux() if system is None else system
    return asked.capable(CAP_SYS_NICE) or asked.priority_limit() > 0


def memory_needed(wishes: RealtimeWishes, system: System) -> int:
    """How much memory may have to be locked, bytes: the kernel counts what is mapped, used or not."""
    return system.mapped() + wishes.reserve


def _lock(wishes: RealtimeWishes, system: System) -> Grant:
    if not wishes.memory:
        return Grant(False, "not asked for")
    limit, need = system.memory_limit(), memory_needed(wishes, system)
    if limit is not None and limit < need and not system.capable(CAP_IPC_LOCK):
        return Grant(
            False, f"found RLIMIT_MEMLOCK {_mib(limit)}; expected at least {_mib(need)}; raise memlock in limits.conf"
        )
    try:
        system.lock_memory()
    except OSError as error:
        return Grant(False, f"mlockall: {error.strerror}")
    return Grant(True, "locked as it is touched")


def _raise(wishes: RealtimeWishes, system: System, pinned: bool) -> tuple[Grant, Scheduling | None]:
    """SCHED_FIFO, and what was before; at the priority that the limit leaves where the wished one is above it."""
    if wishes.priority == 0:
        return Grant(False, "not asked for"), None
    if not pinned:
        return Grant(False, "not pinned to one processor, where it would make ticks slower"), None
    before, limit = system.scheduling(), system.priority_limit()
    priority = wishes.priority if system.capable(CAP_SYS_NICE) else min(wishes.priority, limit)
    if priority < 1:
        text = f"found RLIMIT_RTPRIO {limit} and no CAP_SYS_NICE; raise rtprio to {wishes.priority} in limits.conf"
        return Grant(False, text), None
    wanted = Scheduling(os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, priority, wishes.runaway // 1000, min(1, priority - 1))
    try:
        threads = system.schedule(wanted)
    except OSError as error:
        _schedule_as_before(before, system)  # the limit, and some of the threads, may have changed already
        return Grant(
            False, f"SCHED_FIFO {priority}: {error.strerror}; its control group may have no real-time share"
        ), None
    wild = f"ended after {wishes.runaway / 1e9:g} s without a wait"
    return Grant(True, f"SCHED_FIFO {priority} for {threads} threads, {wild}"), before


def _slack(system: System) -> Grant:
    slack = system.timer_slack()
    if slack is None:
        return Grant(False, "the kernel does not tell it")
    return Grant(slack <= 1, f"{slack} ns")


def _mib(size: int) -> str:
    return f"{size / 2**20:.0f} MiB"
