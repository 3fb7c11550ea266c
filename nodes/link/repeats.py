"""How often a party that waits for an answer repeats its signal, and how many repeats a receiver may find at once.

A signal or its answer may be lost with a connection, and only a repeat shows the receiver who is behind. So whoever
waits repeats its signal: often at first, then ever more rarely. A receiver that sleeps, or a network that is down,
lets the repeats pile up, and all of them are then read in one wait. They are no flood.

**The sender.** :class:`Repeats` decides for every sender. After :data:`OFTEN` repeats the next one comes once an
eighth of the whole wait has passed since the last, and at the latest after :data:`LONGEST_INTERVAL`. So the answer to a
receiver that is back comes later by an eighth of its absence at most, and never by more than that interval.

**The receiver.** Let w be how long the sender has waited, t = ``every`` and L the longest interval. From one repeat to
the next pass t/2 at least (a loop that wakes once a period wakes a little early or late), and behind the first
:data:`OFTEN` about w/8 or L. While the interval is w/8, each repeat makes w greater by the factor 9/8. From OFTEN t/2
to 8 L this takes ln(16 L / (OFTEN t)) / ln(9/8) repeats: 63 for the shortest period of 10 us, 24 for 1 ms. Where the
interval is L, no two repeats are less than L - t/2 >= L/2 apart. So of one signal there come at most

    170 + 2 w / L.

A receiver finds the repeats of three signals in one wait at most: of the one that it has answered last, of the one
that follows, and of one to which an answer of zeros has sent the peer on. That is 510 and the part that grows with w,
for which their waits add up to one. :data:`~manyhands.protocol.limits.MAX_STRAY_FRAMES` is 512, and
:func:`most_strays` adds the other. Each repeat is answered by one frame at most, so the bound holds for the answers as
well.

**The wait** that a receiver counts with must begin before the peer's. An honest peer sends the signal of a tick once it
has the answer that ends the tick before. No answer is for a tick more than LEAD (3) beyond the one that its sender
awaits. So of the last LEAD + 2 ticks whose signals a receiver has admitted, it had admitted one before it sent that
answer. It keeps the instants of :data:`TICKS_BACK` such ticks, which are more, and counts from the oldest. That instant
lies before the sleep, however long the sleep was.
"""

from __future__ import annotations

from typing import Final

from manyhands.protocol.clock import Duration, Instant, from_seconds
from manyhands.protocol.limits import MAX_STRAY_FRAMES

OFTEN: Final = 100
"""Repeats of one signal that come as often as the sender likes."""

SHARE: Final = 8
"""Afterwards the next repeat comes after one part in so many of the wait."""

LONGEST_INTERVAL: Final = from_seconds(0.1)
"""The longest time from one repeat to the next, ns: a broken connection is not sooner made anew."""

TICKS_BACK: Final = 8
"""The admitted ticks of which a receiver keeps the instants."""


class Repeats:
    """When a party that waits for an answer sends its signal again. Pure: instants go in."""

    __slots__ = ("_began", "_count", "_every", "_last")

    def __init__(self, every: Duration, now: Instant) -> None:
        """The signal is sent for the first time at ``now``; the first repeats come ``every`` so many ns."""
        self._every = every
        self.begin(now)

    def begin(self, now: Instant) -> None:
        """Another signal is sent for the first time."""
        self._began = self._last = now
        self._count = 0

    def due(self, now: Instant) -> bool:
        """Whether the signal is to be sent again at ``now``; if so, it counts as sent."""
        every = interval = self._every
        if self._count >= OFTEN:
            interval = Duration(max(every, min(LONGEST_INTERVAL, (now - self._began) // SHARE)))
        if now - self._last < interval - every // 2:  # a loop that wakes once a period wakes a little early or late
            return False
        self._last = now
        self._count += 1
        return True


def most_strays(wait: Duration) -> int:
    """The most frames without the signal awaited that honest peers send in a ``wait``; the derivation stands above."""
    return MAX_STRAY_FRAMES + 2 * wait // LONGEST_INTERVAL
