"""How much the supervisor listens: a budget of frames that refills with time, so that a flood costs bounded work.

What is beyond the budget stays unread; ZeroMQ takes turns between senders and stops reading those whose queues are
full, so one who floods is slowed down and the others' frames still come through.
"""

from __future__ import annotations

from manyhands.protocol.clock import Duration, Instant

_NS_PER_S = 1_000_000_000


class Allowance:
    """A token bucket that, once dry, stays so until a tenth of a second's worth is there: few wake-ups in a flood.

    Attributes:
        exhausted: times that it ran dry.
    """

    def __init__(self, per_second: int, now: Instant) -> None:
        """Full at ``now``: ``per_second`` frames at once, and as many a second in the long run."""
        self._interval = _NS_PER_S // per_second
        self._credit = _NS_PER_S  # ns
        self._at = now
        self._dry = False
        self.exhausted = 0

    def spend(self, frames: int, now: Instant) -> None:
        """Take this many frames off, though it be more than there are."""
        self._refill(now)
        self._credit -= frames * self._interval
        if self._credit < self._interval and not self._dry:
            self._dry = True
            self.exhausted += 1

    def pause(self, now: Instant) -> Duration:
        """How long not to listen; 0 while there is something left."""
        self._refill(now)
        wanted = _NS_PER_S // 10 if self._dry else self._interval
        if self._credit >= wanted:
            self._dry = False
            return Duration(0)
        return Duration(wanted - self._credit)

    def _refill(self, now: Instant) -> None:
        self._credit = min(_NS_PER_S, self._credit + now - self._at)
        self._at = now
