"""The result of a check of a recording: the first number that differs, or that all agree.

A check claims no more than it has compared. Every other tick is in its gaps, with the reason: what could not be
recomputed, and what is absent from the recording or no finite number.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from manyhands.nodes.kernel.json_number import json_number

Array = NDArray[np.float64]

EXACT: Final = "exact: the same arithmetic in the same order"

ABSENT: Final = "it is absent from the recording, or no finite number"
"""Why a recorded number was not compared, where it is not there."""

UNKNOWN: Final = "the recording does not hold what it would follow from"
"""Why a recorded number was not compared, where nothing else is known."""


class CheckVerdict(StrEnum):
    """The result of a check."""

    HOLDS = "holds"
    BROKEN = "broken"
    ENFORCED = "enforced"  # an assumption did not hold, and the session bounded what that may cost: nothing is unproved
    ASSUMPTION = "assumption"  # an assumption of the certificate did not hold; no party broke its promise
    MISSING = "missing"  # ticks that the party owed are absent, or hold no finite number: the rest was compared
    UNCHECKED = "unchecked"  # there was nothing to compare


@dataclass(frozen=True)
class Difference:
    """A number that differs from the expected one.

    Attributes:
        tick: of the session.
        column: of the trace: a port, a mass, E.
        recorded: the number in the recording.
        recomputed: the expected number; of a bound, the bound.
    """

    tick: int
    column: str
    recorded: float
    recomputed: float

    def as_plain(self) -> dict[str, Any]:
        """As a JSON object."""
        return {
            "tick": self.tick,
            "column": self.column,
            "recorded": json_number(self.recorded),
            "recomputed": json_number(self.recomputed),
        }


@dataclass(frozen=True)
class UncheckedTicks:
    """Ticks that a check does not cover, ``begin <= tick < end``, and why."""

    begin: int
    end: int
    why: str

    def __str__(self) -> str:
        ticks = f"tick {self.begin}" if self.end == self.begin + 1 else f"ticks {self.begin} to {self.end - 1}"
        return f"{ticks}: {self.why}"


def gaps_of(ticks: NDArray[np.bool_], why: str) -> list[UncheckedTicks]:
    """Each run of the marked ticks as one gap."""
    edges = np.flatnonzero(np.diff(ticks, prepend=False, append=False))
    return [UncheckedTicks(int(begin), int(end), why) for begin, end in zip(edges[::2], edges[1::2], strict=True)]


@dataclass(frozen=True)
class Check:
    """One check of a recording.

    Attributes:
        name: of the check, such as ``ledger``.
        party: a node, or the session.
        what: the claim that was checked, a sentence.
        verdict: its result.
        numbers: how many numbers were compared.
        first: the first that differs.
        differing: how many differ.
        gaps: ticks that were not checked.
        tolerance: by which a number may differ, in its unit; the greatest, where it varies.
        source: the reason for the tolerance.
        remark: a further remark.
    """

    name: str
    party: str
    what: str
    verdict: CheckVerdict
    numbers: int = 0
    first: Difference | None = None
    differing: int = 0
    gaps: tuple[UncheckedTicks, ...] = ()
    tolerance: float = 0.0
    source: str = EXACT
    remark: str = ""

    @property
    def holds(self) -> bool:
        """Whether no promise was found broken."""
        return self.verdict is not CheckVerdict.BROKEN

    def as_plain(self) -> dict[str, Any]:
        """As a JSON object."""
        return {
            "name": self.name,
            "party": self.party,
            "what": self.what,
            "verdict": self.verdict.value,
            "numbers": self.numbers,
            "differing": self.differing,
            "first": None if self.first is None else self.first.as_plain(),
            "unchecked": [{"begin": gap.begin, "end": gap.end, "why": gap.why} for gap in self.gaps],
            "tolerance": json_number(self.tolerance),
            "tolerance_from": self.source,
            "told": self.remark,
        }


def compare(
    name: str,
    party: str,
    what: str,
    columns: Sequence[str],
    recorded: Array,
    recomputed: Array,
    *,
    gaps: Sequence[UncheckedTicks] = (),
    tolerance: Array | float = 0.0,
    source: str = EXACT,
    owed: NDArray[np.bool_] | None = None,
) -> Check:
    """Compare numbers with the expected ones; ticks in which either is not finite are among the gaps.

    Args:
        name: of the check.
        party: a node, or the session.
        what: the claim, a sentence.
        columns: names of the columns.
        recorded: ticks x columns.
        recomputed: ticks x columns.
        gaps: why some could not be recomputed.
        tolerance: one number, or one for each number compared.
        source: the reason for the tolerance.
        owed: the ticks that are to be compared; None for all.
    """
    both = np.isfinite(recorded) & np.isfinite(recomputed)
    with np.errstate(invalid="ignore"):
        wrong = both & ~(np.abs(recorded - recomputed) <= tolerance)
    first = first_of(wrong, columns, recorded, recomputed)
    numbers = int(both.sum())
    verdict = CheckVerdict.BROKEN if first is not None else CheckVerdict.HOLDS if numbers else CheckVerdict.UNCHECKED
    widest = float(np.max(tolerance, initial=0.0, where=np.broadcast_to(both, np.shape(tolerance)))) if np.ndim(
        tolerance
    ) else float(tolerance)  # fmt: skip
    left = np.asarray(~both.all(axis=1), dtype=np.bool_)
    if owed is not None:
        left &= owed
    known = np.asarray(np.isfinite(recorded).all(axis=1), dtype=np.bool_)
    absent = _not_in(gaps, left & ~known, ABSENT)
    if first is None and any(np.isfinite(recomputed[gap.begin : gap.end]).any() for gap in absent):
        verdict = CheckVerdict.MISSING
    gaps = [*gaps, *absent, *_not_in(gaps, left & known, UNKNOWN)]
    return Check(name, party, what, verdict, numbers, first, int(wrong.sum()), tuple(gaps), widest, source)


def _not_in(gaps: Sequence[UncheckedTicks], ticks: NDArray[np.bool_], why: str) -> list[UncheckedTicks]:
    """The marked ticks that are in none of the gaps, as gaps of their own."""
    left = ticks.copy()
    for gap in gaps:
        left[gap.begin : gap.end] = False
    return gaps_of(left, why)


def first_of(wrong: NDArray[np.bool_], columns: Sequence[str], recorded: Array, recomputed: Array) -> Difference | None:
    """The first number that is marked as wrong, by tick and then by column; None if there is none."""
    ticks = np.flatnonzero(wrong.any(axis=1))
    if not len(ticks):
        return None
    tick = int(ticks[0])
    column = int(np.argmax(wrong[tick]))
    return Difference(tick, columns[column], float(recorded[tick, column]), float(recomputed[tick, column]))


def within(
    name: str,
    party: str,
    what: str,
    columns: Sequence[str],
    values: Array,
    bound: Array,
    wrong: NDArray[np.bool_],
    *,
    otherwise: CheckVerdict = CheckVerdict.BROKEN,
    gaps: Sequence[UncheckedTicks] = (),
    tolerance: float = 0.0,
    source: str = EXACT,
    remark: str = "",
) -> Check:
    """The check that no number is beyond its bound: ``wrong`` are those that are, ``otherwise`` is the verdict then.

    Values, ticks x columns, that are not finite are not checked, and without any the ``remark`` is left out. Everything
    else is as in :class:`Check`.
    """
    first, numbers = first_of(wrong, columns, values, bound), int(np.isfinite(values).sum())
    verdict = otherwise if first is not None else CheckVerdict.HOLDS if numbers else CheckVerdict.UNCHECKED
    told = remark if numbers else ""
    return Check(name, party, what, verdict, numbers, first, int(wrong.sum()), tuple(gaps), tolerance, source, told)


def verdicts(checks: Sequence[Check]) -> Mapping[CheckVerdict, int]:
    """Number of checks with each verdict."""
    return {verdict: sum(check.verdict is verdict for check in checks) for verdict in CheckVerdict}
