"""When the environment stops waiting for couplings that have not come. Pure: instants go in, a decision comes out.

The node looks, decides, and acts on the decision, again and again until the tick is complete. In real time the node
gives up a missing coupling once it has kept others waiting for ``hold``. The others wait from the instant at which
the node finds the first of their signals, but at the latest from one period after the wait began. They never wait
before the instant at which their devices sample.

Under the simulated clock ``hold`` and ``patience`` are None: then no coupling is ever given up.
"""

from __future__ import annotations

from enum import Enum
from typing import Final, NamedTuple

from manyhands.nodes.kernel.timeouts import Timeouts
from manyhands.protocol.clock import Duration, Instant

_NOBODY_WAITS: Final = Instant(2**62)


class Step(Enum):
    """What the node does next."""

    LISTEN = "listen to every coupling whose signal is not there"
    GIVE_UP = "give up the couplings that are missing"
    MOVE = "wait at a later tick, before which no coupling is awaited"


class Decision(NamedTuple):
    """The next step, and what else follows from the time.

    Attributes:
        step: what the node does next.
        forget: whether the devices have let go by now, so that the next signals are first ones.
        pardon: whether no signal has come for so long that a coupling that was given up keeps no other waiting.
        waited: how long others have waited for the couplings that are given up, ns; 0 at the other steps.
    """

    step: Step
    forget: bool
    pardon: bool
    waited: Duration = Duration(0)


class Deadline:
    """The wait of one tick.

    Attributes:
        listened: whether the node has listened to every coupling since the wait began. Before that it gives none up:
            the node itself may not have run, while another process had its processor.
    """

    __slots__ = ("_began", "_due", "_first", "_period", "_timeouts", "listened")

    def __init__(self, timeouts: Timeouts, period: Duration, due: Instant, began: Instant) -> None:
        """Begin to wait; no signal is there yet.

        Args:
            timeouts: the timeouts, of which ``hold`` and ``patience`` are used.
            period: T, ns.
            due: when the devices sample the present tick.
            began: when the tick before was answered.
        """
        self._timeouts, self._period, self._due, self._began = timeouts, period, due, began
        self._first = _NOBODY_WAITS  # since when a coupling whose signal is there waits for the missing ones
        self.listened = False

    def complete(self, present: bool, missing: bool) -> bool:
        """Whether the wait is over: a signal is there, none is missing, and the node has listened to every coupling."""
        return present and not missing and self.listened

    def decide(self, now: Instant, present: bool, missing: bool, later: bool, early: bool) -> Decision:
        """What to do at ``now``.

        Args:
            now: the present time.
            present: whether the signal of any coupling for this tick is there.
            missing: whether any coupling is waited for.
            later: whether no coupling is awaited before a later tick.
            early: whether any coupling has sent a signal of a later tick; such a coupling waits as well.
        """
        hold, patience = self._timeouts.hold, self._timeouts.patience
        elapsed = now - self._began
        forget = patience is not None and elapsed > patience
        pardon = hold is not None and elapsed > hold and not present
        if present:
            self._first = max(self._due, min(self._first, now, Instant(self._began + self._period)))
        elif later:
            self._first = _NOBODY_WAITS
            return Decision(Step.MOVE, forget, pardon)
        elif early:
            self._first = min(self._first, now)
        waited = now - self._first
        if hold is not None and waited >= hold and missing and self.listened:
            self._first = _NOBODY_WAITS
            return Decision(Step.GIVE_UP, forget, pardon, Duration(waited))
        return Decision(Step.LISTEN, forget, pardon)

    def restart(self, now: Instant) -> None:
        """Begin the wait anew at ``now``: the session is at a different tick."""
        self._began, self._first = now, _NOBODY_WAITS
