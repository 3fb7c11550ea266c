"""How late a process wakes: ``python -m manyhands.launch.doctor.wakeup PERIOD PARENT_PID TICKS PRIORITY``.

This process probes the machine alone, without a session. It compares the kernel's default timer slack, the least slack,
and SCHED_FIFO, by turns in one process; a node uses only one of them. It prints one line of JSON.
"""

from __future__ import annotations

import ctypes
import json
import sys
from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from manyhands.nodes.kernel.lifetime import Life, Stopped
from manyhands.nodes.kernel.realtime import Grant, Granted, RealtimeWishes, prepare, restore
from manyhands.nodes.rows.distribution import PERCENTILES
from manyhands.protocol.clock import Instant, RealtimeClock

DEFAULT_SLACK = 50_000  # ns, the kernel's own
LEAST_SLACK = 1
BLOCK = 50  # ticks before the next way takes its turn, so that other load affects all ways alike

_EXIT_OK = 0
_EXIT_BAD_INPUT = 2
_PR_SET_TIMERSLACK = 29  # linux/prctl.h
_RANKS = {"p50": 0.5, "p99": 0.99, "p999": 0.999, "max": 1.0}


@dataclass(frozen=True)
class Spread:
    """Percentiles of a duration, us; a percentile between two values is the greater of them."""

    p50: float
    p99: float
    p999: float
    max: float

    @classmethod
    def of(cls, nanoseconds: Sequence[int]) -> Self:
        """The percentiles of at least one duration, given in ns."""
        values = np.quantile(np.array(nanoseconds, dtype=np.float64), [_RANKS[p] for p in PERCENTILES], method="higher")
        return cls(*(float(value) / 1e3 for value in values))

    def plain(self) -> dict[str, float]:
        """The percentiles as plain data, for ``--json``."""
        return {name: getattr(self, name) for name in PERCENTILES}


@dataclass(frozen=True)
class Waking:
    """How late a process wakes.

    Attributes:
        late: the lateness by way: ``default_slack``, ``least_slack``, and ``fifo`` where it is permitted.
        granted: what the kernel granted to the process, by requested right.
    """

    late: dict[str, Spread]
    granted: dict[str, Grant]

    def to_json(self) -> str:
        """One line of JSON, which :meth:`from_json` reads."""
        granted = {name: [grant.granted, grant.answer] for name, grant in self.granted.items()}
        return json.dumps({"late": {way: spread.plain() for way, spread in self.late.items()}, "granted": granted})

    @classmethod
    def from_json(cls, line: str) -> Self:
        """The result in the line that a process of this module printed."""
        plain: dict[str, Any] = json.loads(line)
        granted = {name: Grant(bool(yes), str(text)) for name, (yes, text) in plain["granted"].items()}
        return cls({way: Spread(**percentiles) for way, percentiles in plain["late"].items()}, granted)


def wake(period: int, ticks: int, priority: int, life: Life) -> Waking:
    """Wake ``ticks`` times in each way, in turns of :data:`BLOCK` ticks.

    Args:
        period: time between wake-ups, ns.
        ticks: number of wake-ups in each way.
        priority: SCHED_FIFO priority of the last way; 0 leaves this way out.
        life: the lifetime of the process, which ends with its parent.

    Raises:
        Stopped: the process is to end.
    """
    late = {"default_slack": array("q"), "least_slack": array("q")}
    granted = prepare(RealtimeWishes(priority=priority))
    if granted.before is not None:
        late["fifo"] = array("q")
    restore(granted)
    clock = RealtimeClock()
    granted = _with_slack(granted)
    life.enter_loop()
    try:
        while len(late["default_slack"]) < ticks:
            for way, found in late.items():
                if way == "fifo":
                    fifo = prepare(RealtimeWishes(memory=False, priority=priority))
                    wake_block(period, clock, found)
                    restore(fifo)
                else:
                    set_timer_slack(DEFAULT_SLACK if way == "default_slack" else LEAST_SLACK)
                    wake_block(period, clock, found)
            life.check()
            if life.stopping:
                raise Stopped
    finally:
        life.leave_loop()
    return Waking({way: Spread.of(found) for way, found in late.items()}, granted.grants())


def wake_block(period: int, clock: RealtimeClock, late: array[int]) -> None:
    """Wake :data:`BLOCK` times, every ``period`` ns, and append by how much each time was late, ns."""
    due = clock.now()
    for _ in range(BLOCK):
        due = Instant(due + period)
        clock.sleep_until(due)
        woke = clock.now()
        late.append(woke - due)
        if woke > due + period:  # a wake-up that is late by more than a period must not delay those after it
            due = woke


def _with_slack(granted: Granted) -> Granted:
    """``granted`` with the kernel's answer about the timer slack that the clock has requested."""
    slack = prepare(RealtimeWishes(memory=False, priority=0)).timer_slack
    return Granted(granted.memory_locked, granted.fifo, slack, granted.pinned)


def set_timer_slack(nanoseconds: int) -> None:
    """Set this thread's timer slack; if the kernel refuses, the slack stays, and the figures show it."""
    ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, ctypes.c_ulong(nanoseconds), 0, 0, 0)


def main() -> int:
    """Measure with the arguments of the command line; returns the exit code."""
    if len(sys.argv) != 5 or not all(argument.isdigit() for argument in sys.argv[1:]):
        print("usage: python -m manyhands.launch.doctor.wakeup PERIOD PARENT_PID TICKS PRIORITY", file=sys.stderr)  # noqa: T201
        return _EXIT_BAD_INPUT
    period, parent, ticks, priority = map(int, sys.argv[1:])
    try:
        found = wake(period, ticks, priority, Life(parent))
    except Stopped:
        return _EXIT_OK  # the parent process has asked for the end
    print(found.to_json())  # noqa: T201 -- to the process that started it
    return _EXIT_OK


if __name__ == "__main__":
    sys.exit(main())
