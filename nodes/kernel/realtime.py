"""The real-time rights that a node's process asks of the kernel before its loop: locked memory, SCHED_FIFO, no slack.

The kernel may refuse each wish, and a loop runs without any of them, only less evenly. So this module raises nothing:
every step returns a sentence that states what was granted, or why not and what would help. A figure of the report
states it as well. :func:`prepare` decides what to ask for, of any :class:`System`; :class:`Linux` has the calls alone.

**Memory** is locked, both the pages in use and those still to come, each when it is first touched (MCL_ONFAULT). So a
page that the loop has used is there in its next tick. Without MCL_ONFAULT the kernel would read in every mapped page at
once, several times what a node uses, for code that never runs. Where the limit on locked memory is too small nothing is
locked, for under MCL_FUTURE every allocation beyond the limit fails.

**SCHED_FIFO** is for a process that is pinned to one processor. It is set for the loop's thread and for ZeroMQ's, which
is one above, so that a frame leaves when it is sent and not when the loop waits next. A loop waits for the thread that
moves its frames, so a priority of the loop alone gains nothing there (docs/decisions/0017-timing.md has figures). Where
a process has more than :data:`FEW_LINKS` links, both threads have the loop's priority: ZeroMQ's thread then works only
while the loop waits or yields, and moves the frames of all links at once. One above, it would take the processor for
every single frame. ZeroMQ's thread for TCP keeps ordinary scheduling, at the nice value :data:`NETWORK_NICE`: strangers
can send it work, and under SCHED_FIFO it would keep its processor, or be ended. The process asks for SCHED_FIFO when
frames have gone over the links: ZeroMQ's thread then runs. A thread that is still starting is left as it is. Children
and later threads do not inherit it. A loop that never waits does not keep its processor for ever: RLIMIT_RTTIME ends a
process of which a thread has computed for :data:`RUNAWAY_TIME` without waiting once (SIGXCPU).
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import resource
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Protocol

from manyhands.nodes.kernel.words import counted
from manyhands.protocol.clock import Duration, from_seconds
from manyhands.protocol.transport.zeromq import NETWORK_THREAD

CAP_IPC_LOCK: Final = 14  # linux/capability.h
CAP_SYS_NICE: Final = 23

_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4  # asm-generic/mman.h
_PR_GET_TIMERSLACK: Final = 30  # linux/prctl.h
_ZEROMQ_THREAD: Final = "ZMQbg/"  # libzmq's names of its threads begin with this
_NETWORK_THREAD: Final = f"{_ZEROMQ_THREAD}IO/{NETWORK_THREAD}"
_EVERY_USER: Final = ["0", "0", "4294967295"]  # /proc/self/uid_map of the first user namespace


@dataclass(frozen=True)
class Scheduling:
    """The scheduling of the loop's thread and ZeroMQ's threads.

    Attributes:
        policy: their policy, with SCHED_RESET_ON_FORK where that is set.
        priority: the priority of ZeroMQ's threads.
        runaway: RLIMIT_RTTIME's soft limit, us.
        below: how much lower the priority of the loop's thread is.
    """

    policy: int
    priority: int
    runaway: int
    below: int = 0


class System(Protocol):
    """The calls to the operating system; tests replace it."""

    def capable(self, capability: int) -> bool:
        """Whether the process has this capability over the whole machine, and not only in a user namespace."""
        ...

    def memory_limit(self) -> int | None:
        """The limit of locked memory, bytes; None without a limit."""
        ...

    def mapped(self) -> int:
        """The size of the process's address space, bytes."""
        ...

    def lock_memory(self) -> None:
        """Lock all memory.

        Raises:
            OSError: the kernel refuses.
        """
        ...

    def unlock_memory(self) -> None:
        """Unlock all memory."""
        ...

    def priority_limit(self) -> int:
        """The greatest real-time priority that may be asked for without the capability."""
        ...

    def scheduling(self) -> Scheduling:
        """The scheduling of the calling thread and of the threads that it has made."""
        ...

    def schedule(self, wanted: Scheduling) -> int:
        """Schedule the calling thread and ZeroMQ's threads as ``wanted``; returns the number of these threads.

        Raises:
            OSError: the kernel refuses.
        """
        ...

    def favour_network(self, nice: int) -> int:
        """Give ZeroMQ's thread for TCP this nice value; returns the number of such threads, 0 or 1.

        Raises:
            OSError: the kernel refuses.
        """
        ...

    def processors(self) -> set[int]:
        """The processors that the calling thread may use."""
        ...

    def timer_slack(self) -> int | None:
        """The calling thread's timer slack, ns; None where the kernel does not report it."""
        ...


class Linux:
    """The calls to Linux."""

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

        The limit is set first, so that a thread never has the priority without the limit. The hard limit stays as it
        is, for a hard limit that was lowered cannot be raised again.
        """
        hard = resource.getrlimit(resource.RLIMIT_RTTIME)[1]
        soft = wanted.runaway if hard == resource.RLIM_INFINITY or wanted.runaway == hard else min(wanted.runaway, hard)
        resource.setrlimit(resource.RLIMIT_RTTIME, (soft, hard))
        threads = [0, *_zeromq_threads()]
        for thread in threads:
            priority = wanted.priority - wanted.below if thread == 0 else wanted.priority
            os.sched_setscheduler(thread, wanted.policy, os.sched_param(priority))
        return len(threads)

    def favour_network(self, nice: int) -> int:
        """See :class:`System`."""
        threads = _threads(lambda name: name == _NETWORK_THREAD)
        for thread in threads:
            os.setpriority(os.PRIO_PROCESS, thread, nice)  # for Linux, a thread is a process here
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
    """The ids of ZeroMQ's threads that have begun their work, which is when they take their names, but that for TCP.

    Before that, such a thread reads its scheduling and sets it again. If the scheduling changed in between, the kernel
    could refuse the second call, and libzmq would abort the process.
    """
    return _threads(lambda name: name.startswith(_ZEROMQ_THREAD) and name != _NETWORK_THREAD)


def _threads(of_name: Callable[[str], bool]) -> list[int]:
    """The ids of this process's threads whose names are such."""
    threads = Path("/proc/self/task").iterdir()
    return [int(thread.name) for thread in threads if of_name((thread / "comm").read_text().rstrip("\n"))]


def _status(key: str) -> str:
    """The value of a line of /proc/self/status."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(line.split(":", 1)[1].strip() for line in lines if line.startswith(f"{key}:"))


FIFO_PRIORITY: Final = 10  # of 1 ... 99; interrupt threads of a PREEMPT_RT kernel have 50
NETWORK_NICE: Final = -10  # nine tenths of a processor for which threads at nice 0 compete; a flood cannot take it all
RUNAWAY_TIME: Final = from_seconds(0.5)  # hundreds of ticks; a loop waits several times in each
FEW_LINKS: Final = 4  # with more, it costs less to move all their frames at once than to send each without delay
RESERVE: Final = 64 * 2**20  # bytes that a loop may still map: thread stacks, arenas, telemetry


@dataclass(frozen=True)
class RealtimeWishes:
    """The rights that a process asks for.

    Attributes:
        memory: whether its memory is to be locked.
        priority: of SCHED_FIFO, 1 ... 99; 0 for ordinary scheduling.
        links: the number of the loop's links; beyond :data:`FEW_LINKS` their frames are moved together.
        reserve: bytes that the process may still map after :func:`prepare`.
        runaway: how long a thread may compute under SCHED_FIFO without waiting, ns.
    """

    memory: bool = True
    priority: int = FIFO_PRIORITY
    links: int = 1
    reserve: int = RESERVE
    runaway: Duration = RUNAWAY_TIME


@dataclass(frozen=True)
class Grant:
    """The answer to one wish: whether it was granted, and a sentence that states what was granted or why not."""

    granted: bool
    answer: str


@dataclass(frozen=True)
class Granted:
    """The answers to all wishes of :func:`prepare`.

    Attributes:
        memory_locked: pages in use stay in memory.
        fifo: the scheduling is SCHED_FIFO.
        timer_slack: the timer slack is the least there is, which :class:`manyhands.protocol.clock.RealtimeClock` sets.
        pinned: the process is pinned to one processor; the supervisor does that at its start, and a guest itself.
        before: the scheduling that :func:`restore` sets again; None where it was not changed.
    """

    memory_locked: Grant
    fifo: Grant
    timer_slack: Grant
    pinned: Grant
    before: Scheduling | None = None

    def table(self) -> dict[str, float]:
        """1 for each wish that was granted and 0 for the others."""
        return {name: float(grant.granted) for name, grant in self.grants().items()}

    def grants(self) -> dict[str, Grant]:
        """The answers by the names of the report."""
        return {
            "memory_locked": self.memory_locked,
            "fifo": self.fifo,
            "timer_slack": self.timer_slack,
            "pinned": self.pinned,
        }


def prepare(wishes: RealtimeWishes, system: System | None = None) -> Granted:
    """Ask for all ``wishes``; call this in the loop's thread, when frames have gone over its links.

    Args:
        wishes: the rights to ask for.
        system: the operating system; None for Linux.
    """
    asked = Linux() if system is None else system
    processors = asked.processors()
    alone = len(processors) == 1
    which = f"the {'processor' if alone else 'processors'} {', '.join(map(str, sorted(processors)))}"
    pinned = Grant(alone, f"may use {which}")
    fifo, before = _raise(wishes, asked, pinned.granted)
    return Granted(_lock(wishes, asked), fifo, _slack(asked), pinned, before)


def pin_guest(name: str) -> None:
    """Pin the process of a node on another machine to one processor where it may ask for a real-time priority.

    The supervisor pins the processes of its own machine, where it knows them all. A guest knows itself alone, so its
    name chooses: several guests on one machine mostly share the processors. Call this before ZeroMQ's threads start,
    which inherit it.

    Args:
        name: the node's.
    """
    if may_raise():
        processors = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {processors[zlib.crc32(name.encode()) % len(processors)]})


@contextlib.contextmanager
def realtime_thread() -> Iterator[Grant]:
    """Run the calling thread as a node's loop, pinned and under SCHED_FIFO where it may be, until the block ends.

    It is for a loop of a program that does other work as well, such as the motion of ``identify``. The block gets the
    answer to the wish for SCHED_FIFO.
    """
    processors = os.sched_getaffinity(0)
    pin_guest("loop")
    granted = prepare(RealtimeWishes())
    try:
        yield granted.fifo
    finally:
        restore(granted)
        os.sched_setaffinity(0, processors)


def restore(granted: Granted, system: System | None = None) -> None:
    """Give back locked memory, priority and its limit; call this in the thread that called :func:`prepare`.

    Raises:
        OSError: the kernel refuses.
    """
    asked = Linux() if system is None else system
    if granted.memory_locked.granted:
        asked.unlock_memory()
    if granted.before is not None:
        _schedule_as_before(granted.before, asked)
        _favour_network(asked, 0)


def _schedule_as_before(before: Scheduling, system: System) -> None:
    try:
        system.schedule(before)
    except PermissionError:  # only a privileged process may let its children inherit the scheduling again
        system.schedule(Scheduling(before.policy | os.SCHED_RESET_ON_FORK, before.priority, before.runaway))


def way_giver() -> Callable[[], None]:
    """The function that a loop calls after it has sent a tick's signals, before the work that can wait.

    Under SCHED_FIFO no thread of the same priority gets the processor until this thread waits. So the loop gives way to
    the processes that it has just sent a signal, which may run on the same processor. Under ordinary scheduling the
    function does nothing, for a thread that gives way there may wait for processes of other programs.
    """
    policy = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
    return os.sched_yield if policy == os.SCHED_FIFO else _go_on


def _go_on() -> None:
    pass


def schedule_as(thread: int) -> None:
    """Give the calling thread the scheduling of another one, such as the loop's, where the kernel permits it."""
    policy, param = os.sched_getscheduler(thread), os.sched_getparam(thread)
    if policy != os.sched_getscheduler(0) or param.sched_priority != os.sched_getparam(0).sched_priority:
        with contextlib.suppress(PermissionError):
            os.sched_setscheduler(0, policy, param)


def may_raise(system: System | None = None) -> bool:
    """Whether this process may ask for a real-time priority; its control group may still refuse it."""
    asked = Linux() if system is None else system
    return asked.capable(CAP_SYS_NICE) or asked.priority_limit() > 0


def memory_needed(wishes: RealtimeWishes, system: System) -> int:
    """The limit of locked memory that the process needs, bytes: the kernel counts all mapped pages, used or not."""
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
    """Ask for SCHED_FIFO at the wished priority or the greatest permitted; returns also the scheduling before."""
    if wishes.priority == 0:
        return Grant(False, "not asked for"), None
    if not pinned:
        return Grant(False, "not pinned to one processor, where it would make ticks slower"), None
    before, limit = system.scheduling(), system.priority_limit()
    priority = wishes.priority if system.capable(CAP_SYS_NICE) else min(wishes.priority, limit)
    if priority < 1:
        text = f"found RLIMIT_RTPRIO {limit} and no CAP_SYS_NICE; raise rtprio to {wishes.priority} in limits.conf"
        return Grant(False, text), None
    below = min(1, priority - 1)
    if wishes.links > FEW_LINKS:
        priority, below = priority - below, 0
    wanted = Scheduling(os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, priority, wishes.runaway // 1000, below)
    try:
        threads = system.schedule(wanted)
    except OSError as error:
        _schedule_as_before(before, system)  # the limit, and some of the threads, may have changed already
        return Grant(
            False, f"SCHED_FIFO {priority}: {error.strerror}; its control group may have no real-time share"
        ), None
    wild = f"ended after {wishes.runaway / 1e9:g} s without a wait"
    network = _favour_network(system, NETWORK_NICE)
    return Grant(True, f"SCHED_FIFO {priority} for {counted(threads, 'thread')}, {wild}{network}"), before


def _favour_network(system: System, nice: int) -> str:
    """Give ZeroMQ's thread for TCP this nice value; returns what was granted, as the end of a sentence."""
    try:
        return f"; nice {nice} for the thread of TCP" if system.favour_network(nice) else ""
    except OSError as error:
        return f"; nice 0 for the thread of TCP ({error.strerror})"


def _slack(system: System) -> Grant:
    slack = system.timer_slack()
    if slack is None:
        return Grant(False, "the kernel does not report it")
    return Grant(slack <= 1, f"{slack} ns")


def _mib(size: int) -> str:
    return f"{size / 2**20:.0f} MiB"
