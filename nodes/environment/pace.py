"""When a world has its ticks, where no user is in the tick whose signal could pace it: all come by wave links.

Tick by tick the world's clock decides. A tick that ends too late is made up for, so that the world's time does not
stand still meanwhile: the next one begins at once. Ticks are left out in two cases. A process that was held up for a
period or more begins with the present tick, and no wave lacks what was left out, since waves are sums. And where
:data:`UNRESTED` ticks in a row were late, the machine is too slow for the world. Ticks are then left out until one can
be waited for: a loop that never waits would be ended as a runaway
(:data:`manyhands.nodes.kernel.realtime.RUNAWAY_TIME`).
"""

from __future__ import annotations

from typing import Final

from manyhands.protocol.clock import Duration, Instant

UNRESTED: Final = 8
"""Late ticks in a row that are made up for."""


class Pace:
    """The periods of a world's clock.

    Attributes:
        late: periods whose tick had not ended when the next was due, or was never done.
    """

    __slots__ = ("_due", "_epoch", "_period", "_slot", "_unrested", "late")

    def __init__(self, epoch: Instant, period: Duration, now: Instant) -> None:
        """Begin with the first period that is due from ``now`` on; the period 0 is at ``epoch``."""
        self._epoch, self._period = epoch, period
        self._slot = max(0, -((epoch - now) // period))
        self._due = max(now, epoch)  # when the tick that was done last should have ended
        self._unrested = self.late = 0

    def due(self, now: Instant) -> Instant:
        """When the next tick is due; at ``now`` the tick before has ended."""
        at = Instant(self._epoch + self._slot * self._period)
        self.late += now > self._due
        if now <= at:
            self._unrested = 0
            return at
        self._unrested += 1
        if self._unrested <= UNRESTED:
            return at
        self._unrested = 0
        return self._let_go(now)

    def begun(self, now: Instant) -> None:
        """The tick has begun, and at ``now`` its positions are there."""
        self._due = Instant(self._epoch + (self._slot + 1) * self._period)
        self._slot += 1
        if now > self._due:
            self._let_go(now)

    def _let_go(self, now: Instant) -> Instant:
        """Go on with the first period that is not due before ``now``; returns when that is."""
        following = -((self._epoch - now) // self._period)
        self.late += following - self._slot
        self._slot = following
        return Instant(self._epoch + following * self._period)
