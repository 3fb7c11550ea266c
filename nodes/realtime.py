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
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from manyhands.nodes.linux import CAP_IPC_LOCK, CAP_SYS_NICE, Linux, Scheduling, System
from manyhands.protocol.clock import Duration, from_seconds

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
