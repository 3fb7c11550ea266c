"""The ticks of a party that a recording holds, and how many are missing: one count for writer and readers.

A party's ticks are its own (:mod:`manyhands.nodes.rows.own_ticks`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
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


def missing_by_party(
    coverages: Mapping[str, Coverage], spans: Mapping[str, range], away: Mapping[str, Sequence[Gap]] | None = None
) -> dict[str, int]:
    """Number of missing ticks in the span of each party, for the parties that miss some.

    Args:
        coverages: of each party.
        spans: by party, the ticks that are looked at.
        away: by party, in increasing order, the ticks in which it was not there, and which do not count.
    """
    out = {}
    for name, one in coverages.items():
        begin, end = spans[name].start, spans[name].stop
        gaps = one.gaps_in(begin, end)
        owed = without(gaps, (away or {}).get(name, ()))
        out[name] = one.missing_in(begin, end) - _ticks(gaps) + _ticks(owed)
    return {name: count for name, count in out.items() if count > 0}


def _ticks(gaps: Sequence[Gap]) -> int:
    return sum(gap.end - gap.begin for gap in gaps)


def without(gaps: Sequence[Gap], away: Sequence[Gap]) -> tuple[Gap, ...]:
    """What is left of ``gaps`` without the ticks of ``away``; both in increasing order."""
    out = []
    for gap in gaps:
        begin = gap.begin
        for absence in away:
            if begin < absence.begin < gap.end:
                out.append(Gap(begin, absence.begin))
            if absence.begin < gap.end:
                begin = max(begin, absence.end)
        if begin < gap.end:
            out.append(Gap(begin, gap.end))
    return tuple(out)
