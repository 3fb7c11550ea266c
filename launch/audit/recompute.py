"""A party of a recorded run computed again: its own object takes what others recorded for it, row by row.

Every party follows its recording in the same way. A new process begins at rest. Where the recording does not hold what
happened, the party is lost, and found again with the next process. Everything else is in a :class:`FollowedParty`,
which calls the party's own object as the loop of its node calls it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from manyhands.launch.audit.events import Course, Happening
from manyhands.launch.audit.findings import UncheckedTicks

Array = NDArray[np.float64]
Progress = Callable[[int], None]

_EVERY: Final = 1000  # ticks between two reports of progress
_NOTHING: Final = Happening()


class Lost(Exception):
    """A party cannot be followed from a row on, for the reason that the text gives; empty where nothing is left."""


class FollowedParty(ABC):
    """A party that is computed again: what was recorded for it, and its own object as it is between two rows.

    Attributes:
        rows: the ticks of its rows.
        fields: the fields that are computed, with the number of columns of each.
        ticks: of the recording.
        gaps: the ticks that cannot be computed from the beginning on, with the reason.
    """

    rows: Sequence[int]
    fields: Mapping[str, int]
    ticks: int
    gaps: Sequence[UncheckedTicks] = ()

    @abstractmethod
    def begin(self, joins: bool) -> None:
        """A process begins, at rest; ``joins`` is whether the session ran already."""

    def change(self, rung: int) -> None:
        """The party has changed to ``rung`` since its last row; many parties have no rungs."""
        raise AssertionError(f"found the rung {rung} of a party without rungs")

    @abstractmethod
    def row(self, k: int, happened: Happening, rung: int | None) -> Mapping[str, Sequence[float]]:
        """Compute the row of tick ``k``.

        Args:
            k: the tick.
            happened: what happened since the last row.
            rung: the rung that the party changes to in this tick; None if it does not.

        Returns:
            The fields that follow.

        Raises:
            Lost: they do not follow, and neither do those of later rows.
        """


@dataclass(eq=False)
class Recomputed:
    """A party's fields, computed again.

    Attributes:
        fields: by name, ticks x columns; NaN where they could not be computed.
        gaps: the ticks that could not be computed, with the reason.
    """

    fields: Mapping[str, Array]
    gaps: list[UncheckedTicks] = field(default_factory=list)

    def __getitem__(self, name: str) -> Array:
        return self.fields[name]


def no_progress(_tick: int) -> None:
    """Progress that is not reported."""


def from_there_on(why: str) -> str:
    """Why a party is not checked any more."""
    return f"{why}: from there on it is not checked"


def recompute(follower: FollowedParty, course: Course, progress: Progress = no_progress) -> Recomputed:
    """A party's fields, from what was recorded for it.

    Args:
        follower: the party.
        course: what happened between its rows.
        progress: called now and then with the number of ticks that are done.
    """
    ticks = follower.ticks
    fields = {name: np.full((ticks, columns), np.nan) for name, columns in follower.fields.items()}
    out = Recomputed(fields, [*follower.gaps])
    lost = False
    follower.begin(joins=False)
    for k in follower.rows:
        happened = course.before.get(k, _NOTHING)
        if happened.began and k > 0:
            lost = False
            follower.begin(joins=True)
            if out.gaps and out.gaps[-1].end > k:
                out.gaps[-1] = replace(out.gaps[-1], end=k)
        if lost:
            continue
        try:
            if happened.unknown:
                raise Lost(from_there_on(happened.unknown))
            if happened.rung is not None:
                follower.change(happened.rung)
            for name, numbers in follower.row(k, happened, course.rungs.get(k)).items():
                out.fields[name][k] = numbers
        except Lost as lost_by:
            lost = True
            if why := str(lost_by):
                out.gaps.append(UncheckedTicks(k, ticks, why))
        if k % _EVERY == 0:
            progress(k)
    return out
