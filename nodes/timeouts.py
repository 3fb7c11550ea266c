"""How long the parties of a session wait for each other: one table, in ticks, for both clocks.

In real time a tick that a party misses is paid by all others, so waiting ends: the environment gives a coupling up,
a device lets go of a stale force. Under the simulated clock time stands still while somebody is waited for, and
nobody is given up but on the supervisor's word.
"""

from __future__ import annotations

from dataclasses import dataclass

from manyhands.nodes.bundle import SIMULATED, Common
from manyhands.protocol.clock import Duration, from_seconds

FREEZE_TICKS = 3
"""Periods that the environment waits for a coupling once another one's signal of the tick is there."""

STALE_TICKS = 5
"""A device that has waited this many periods for its force applies zero force until one comes."""

LISTEN_TICKS = 32
"""Ticks between two looks at what the supervisor says, while all goes well; who waits in vain looks at once."""

LOOK = from_seconds(0.1)
"""Between two looks at whether the node should still run, and what the supervisor says."""

_LOST_IN_SIMULATION = from_seconds(20.0)  # real time, far beyond any turn that a busy machine makes a process wait


@dataclass(frozen=True)
class Timeouts:
    """How long is waited, ns of real time.

    Attributes:
        freeze: for a coupling, by the environment; None: for ever.
        stale: for a force, by a device; None: for ever.
        again: for an answer, before the signal is sent once more.
        look: at once, at most.
        turn: for one signal of an ordinary tick, before it is seen what else there is.
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
