"""How far another machine's monotonic clock is ahead of ours, from an exchange of time stamps.

    ours:    sent ─────────▶                 ◀───────── received
    theirs:             heard ── answered

Half the way there and half the way back are equal but for what queues and schedulers add, so the exchange with
the shortest way tells most: its error is at most half its own round trip (RFC 5905, section 8, has the same formula).
"""

from collections.abc import Iterable
from dataclasses import dataclass

from manyhands.protocol.clock import Duration


@dataclass(frozen=True, slots=True)
class Exchange:
    """One question and its answer, monotonic ns: ``sent`` and ``received`` by our clock, the others by theirs."""

    sent: int
    heard: int
    answered: int
    received: int

    @property
    def round_trip(self) -> Duration:
        """Time on the way, both ways, ns."""
        return Duration((self.received - self.sent) - (self.answered - self.heard))

    @property
    def offset(self) -> Duration:
        """Their clock minus ours, ns."""
        return Duration(((self.heard - self.sent) + (self.answered - self.received)) // 2)


def offset_of(exchanges: Iterable[Exchange]) -> Duration:
    """Their clock minus ours, ns, by the exchange with the shortest way.

    Raises:
        ValueError: there are none.
    """
    return min(exchanges, key=lambda exchange: exchange.round_trip).offset
