"""The instants of the ticks of a session at 1 kHz, for drivers that a test calls itself."""

from __future__ import annotations

from manyhands.protocol.clock import Instant


def instant(tick: float) -> Instant:
    """The instant of tick ``tick``, ns since tick 0; a fraction is an instant between two ticks."""
    return Instant(round(tick * 1_000_000))
