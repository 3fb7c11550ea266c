"""How long the parties of a session wait for each other: one table, in ticks, for both clocks.

In real time all parties wait for the one that misses a tick, so every wait has an end: the environment holds the
coupling, and a device lets go of a stale force. Under the simulated clock time stands still during a wait. There a
party is given up only when the supervisor reports that it is lost.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from manyhands.nodes.kernel.bundle import SIMULATED, Common
from manyhands.protocol.clock import Duration, from_seconds

HOLD_TICKS = 3
"""Periods that the environment waits for a coupling once the signal of any other for the tick is there; then it holds
the coupling."""

STALE_TICKS = 5
"""A device that has waited this many periods for its force applies zero force until one comes."""

HELD_TICKS: Final = STALE_TICKS + 1
"""The most periods after its sample for which a force is held: until it is stale, and one period more.

No ``until`` of a driver is further away. The account of late forces often asks for a nearer one, and counts on that.
"""

RAMP: Final = 100
"""Ticks of a clutch from s = 0 to s = 1, and of a force that rises from 0."""

PATIENCE_TICKS = RAMP
"""The most periods in which a coupling that is not heard is held, and after which forces rise by the ramp again.

The ramp (:data:`RAMP`) takes as long, so that holding never costs a user more than
freezing does. A busy machine makes a process wait for some milliseconds, and for thirty now and then. Devices let go
meanwhile, but the motion that they send afterwards is within their limit of speed.
"""

LISTEN_TICKS = 32
"""Ticks between two looks at the supervisor's messages, while all signals come; a node that waits looks at once."""

LOOK = from_seconds(0.1)
"""The longest time between two looks at whether the node should still run, and at the supervisor's messages."""

_LOST_IN_SIMULATION = from_seconds(20.0)  # real time; a busy machine makes no process wait so long for its turn


@dataclass(frozen=True)
class Timeouts:
    """How long a node waits, ns of real time.

    Attributes:
        hold: the environment waits so long for a coupling, and holds it then; None for no end.
        stale: a device waits so long for a force; None for no end.
        again: a node waits so long for an answer before it sends its signal once more.
        look: the longest single wait, after which the node looks at its supervisor.
        turn: the wait for one signal of an ordinary tick, before the node looks what else it has received.
        patience: after this time the environment takes the devices to have let go; None where time stands still.
    """

    hold: Duration | None
    stale: Duration | None
    again: Duration
    look: Duration
    turn: Duration
    patience: Duration | None


def timeouts(common: Common) -> Timeouts:
    """The timeouts of a session's nodes."""
    if common.clock == SIMULATED:
        return Timeouts(None, None, _LOST_IN_SIMULATION, LOOK, LOOK, None)
    period = from_seconds(common.period)
    hold, patience = Duration(HOLD_TICKS * period), Duration(PATIENCE_TICKS * period)
    stale, turn = Duration(STALE_TICKS * period), Duration(2 * period)
    return Timeouts(hold, stale, hold, min(LOOK, hold), min(LOOK, turn), patience)


def longest_hold(common: Common) -> Duration:
    """How long a device in wall time holds a force or a torque at most, from its sample on: :data:`HELD_TICKS`."""
    return Duration((HELD_TICKS if timeouts(common).stale else 1) * from_seconds(common.period))
