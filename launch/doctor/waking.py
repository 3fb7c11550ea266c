"""How late a process wakes: with the kernel's timer slack, with the least, and before all others."""

from __future__ import annotations

import ctypes
from array import array
from dataclasses import dataclass
from typing import Any

from manyhands.launch.doctor.conversation import said
from manyhands.nodes.life import Life
from manyhands.nodes.realtime import Granted, RealtimeWishes, prepare, restore
from manyhands.protocol.clock import Instant, RealtimeClock

DEFAULT_SLACK = 50_000  # ns, the kernel's own
LEAST_SLACK = 1
BLOCK = 50  # ticks after which the next way of waking is tried: all of them see the same weather

_PR_SET_TIMERSLACK = 29  # linux/prctl.h


@dataclass(frozen=True)
class WakeTask:
    """Wake ``ticks`` times in each way.

    Attributes:
        period: ns.
        ticks: number of times.
        priority: of SCHED_FIFO for the last of the ways; 0 leaves it out.
    """

    period: int
    ticks: int
    priority: int


def wake(task: WakeTask, life: Life) -> dict[str, Any]:
    """How late each way of waking is, ns, in turns of :data:`BLOCK` ticks; and what the kernel granted."""
    late = {"default_slack": array("q"), "least_slack": array("q")}
    wishes = RealtimeWishes(priority=task.priority)
    granted = prepare(wishes)
    if granted.before is not None:
        late["fifo"] = array("q")
    restore(granted)
    clock = RealtimeClock()
    granted = _with_slack(granted)
    life.enter_loop()
    try:
        while not life.stopping and len(late["default_slack"]) < task.ticks:
            for way, found in late.items():
                if way == "fifo":
                    fifo = prepare(RealtimeWishes(memory=False, priority=task.priority))
                    _wake_block(task, clock, found)
                    restore(fifo)
                else:
                    set_timer_slack(DEFAULT_SLACK if way == "default_slack" else LEAST_SLACK)
                    _wake_block(task, clock, found)
            life.check()
    finally:
        life.leave_loop()
    return {"late_ns": {way: found.tolist() for way, found in late.items()}, **said(granted)}


def _wake_block(task: WakeTask, clock: RealtimeClock, late: array[int]) -> None:
    due = clock.now()
    for _ in range(BLOCK):
        due = Instant(due + task.period)
        clock.sleep_until(due)
        woke = clock.now()
        late.append(woke - due)
        if woke > due + task.period:  # one bad wake-up is not to be counted in those after it
            due = woke


def _with_slack(granted: Granted) -> Granted:
    """As granted, with what the kernel says of the slack that the clock has asked for."""
    slack = prepare(RealtimeWishes(memory=False, priority=0)).timer_slack
    return Granted(granted.memory_locked, granted.fifo, slack, granted.pinned)


def set_timer_slack(nanoseconds: int) -> None:
    """Set this thread's timer slack; a kernel that refuses leaves it as it is, which the figures show."""
    ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, ctypes.c_ulong(nanoseconds), 0, 0, 0)
