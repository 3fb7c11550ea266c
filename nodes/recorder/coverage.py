"""The ticks of a party that a recording holds, and how many are missing: one count for writer and readers.

A party's ticks are its own (:mod:`manyhands.nodes.rows.own_ticks`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from manyhands.nodes.rows.own_ticks import own_tick, own_tick_before, session_tick

MOST_GAPS: Final = 1000
"""The most gaps of one party that are kept one by one; the count includes all."""


@dataclass(frozen=True)
class Gap:
    """Missing ticks: ``begin <= tick < end``."""

    begin: int
    end: int


@dataclass
class Coverage:
    """The ticks of one party, in order of arrival: the first, the last, and the missing ones between.

    Attributes:
        first: the first tick; None before any.
        next: the tick after the last.
        missing: number of missing ticks between the two.
    """

    first: int | None = None
    next: int = 0
    missing: int = 0
    _gaps: list[Gap] = field(default_factory=list)

    def take(self, begin: int, end: int) -> None:
        """Add the ticks ``begin <= tick < end``; ticks that were added before are ignored."""
        if self.first is None:
            self.first = self.next = begin
        if begin > self.next:
            self.missing += begin - self.next
            if len(self._gaps) < MOST_GAPS:
                self._gaps.append(Gap(self.next, begin))
        self.next = max(self.next, end)

    def take_each(self, ticks: NDArray[np.int64]) -> None:
        """Add ticks, an array in increasing order; ticks that were added before are ignored."""
        if not len(ticks):
            return
        breaks = np.flatnonzero(np.diff(ticks) != 1) + 1
        for begin, end in zip([0, *breaks.tolist()], [*breaks.tolist(), len(ticks)], strict=True):
            self.take(int(ticks[begin]), int(ticks[end - 1]) + 1)

    def missing_in(self, begin: int, end: int) -> int:
        """Number of missing ticks in ``begin <= tick < end``.

        ``begin`` is at most the first tick, ``end`` at least the one after the last.
        """
        if self.first is None:
            return end - begin
        return (self.first - begin) + self.missing + (end - self.next)

    def gaps_in(self, begin: int, end: int) -> tuple[Gap, ...]:
        """The missing ticks in ``begin <= tick < end`` as gaps, in order: the first :data:`MOST_GAPS`."""
        first = end if self.first is None else self.first
        found = [Gap(begin, first), *self._gaps, Gap(max(first, self.next), end)]
        return tuple(gap for gap in found if gap.begin < gap.end)[:MOST_GAPS]


def spans_by_party(
    coverages: Mapping[str, Coverage], rate_of: Callable[[str], float], begin: int | None = None
) -> dict[str, range]:
    """By party, its own ticks up to the end of the latest tick of any party.

    Args:
        coverages: of each party.
        rate_of: the rate of a party.
        begin: the session's tick from which on they count; None for the first tick of any party.
    """
    first = [session_tick(one.first, rate_of(name)) for name, one in coverages.items() if one.first is not None]
    begin = min(first, default=0) if begin is None else begin
    latest = max((one.next / rate_of(name) for name, one in coverages.items()), default=0.0)
    return {
        name: range(
            own_tick(begin, rate_of(name)) if one.first is None else min(one.first, own_tick(begin, rate_of(name))),
            max(one.next, own_tick_before(latest, rate_of(name))),
        )
        for name, one in coverages.items()
    }


def missing_by_party(coverages: Mapping[str, Coverage], spans: Mapping[str, range]) -> dict[str, int]:
    """Number of missing ticks in the span of each party, for the parties that miss some."""
    counts = {name: one.missing_in(spans[name].start, spans[name].stop) for name, one in coverages.items()}
    return {name: count for name, count in counts.items() if count > 0}
