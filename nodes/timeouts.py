"""How long the parties of a session wait for each other: one table, in ticks, for both clocks.

In real time all parties wait for the one that misses a tick, so every wait has an end: the environment freezes the
coupling, and a device lets go of a stale force. Under the simulated clock time stands still during a wait. There a
party is given up only when the supervisor reports that it is lost.
"""

from __future__ import annotations

from dataclasses import dataclass

from manyhands.nodes.bundle import SIMULATED, Common
from manyhands.protocol.clock import Duration, from_seconds

FREEZE_TICKS = 3
"""Periods that the environment waits for a coupling once the signal of any other coupling for the tick is there."""

STALE_TICKS = 5
"""A device that has waited this many periods for its force applies zero force until one comes."""

LISTEN_TICKS = 32
"""Ticks between two looks at the supervisor's messages, while all signals come; a node that waits looks at once."""

LOOK = from_seconds(0.1)
"""The longest time between two looks at whether the node should still run, and at the supervisor's messages."""

_LOST_IN_SIMULATION = from_seconds(20.0)  # real time; a busy machine makes no process wait so long for its turn


@dataclass(frozen=True)
class Timeouts:
    """How long a node waits, ns of real time.

    Attributes:
        freeze: the environment waits so long for a coupling; None for no end.
        stale: a device waits so long for a force; None for no end.
        again: a node waits so long for an answer before it sends its signal once more.
        look: the longest single wait, after which the node looks at its supervisor.
        turn: the wait for one signal of an ordinary tick, before the node looks what else it has received.
    """

    freeze: Duration | None
    stale: Duration | None
    again: Duration
    look: Duration
    turn: Duration


def timeouts(common: Common) -> Timeouts:
    """The timeouts of a session's nodes."""
    if common.clock == SIMULATED:
        return Timeouts(None, None, _LOST_IN_SIMULATION, LOOK, LOOK)
    period = from_seconds(common.period)
    freeze = Duration(FREEZE_TICKS * period)
    stale, turn = Duration(STALE_TICKS * period), Duration(2 * period)
    return Timeouts(freeze, stale, freeze, min(LOOK, freeze), min(LOOK, turn))
