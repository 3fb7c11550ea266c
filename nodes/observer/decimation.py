"""A long trace in few points, of which none that matters is missing: least and greatest value of every bucket. Pure.

A bucket is a run of ticks of fixed length, counted from tick 0, so that the buckets of all traces of a session lie side
by side. Of each, two values are kept, its least and its greatest, in the order in which they came: what is drawn
through them touches every extreme of the trace, however short, which leaving out samples would not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def extremes(values: Floats) -> Floats:
    """Least and greatest value of each bucket, in the order of time.

    Args:
        values: buckets x ticks x columns; NaN where there is none.

    Returns:
        Buckets x 2 x columns: of every bucket and column the two, the earlier first; NaN twice where all are NaN.
    """
    absent = np.isnan(values)
    least = np.where(absent, np.inf, values).argmin(axis=1)
    greatest = np.where(absent, -np.inf, values).argmax(axis=1)
    places = np.stack([np.minimum(least, greatest), np.maximum(least, greatest)], axis=1)
    return np.take_along_axis(values, places, axis=1)


@dataclass(frozen=True, eq=False)
class Decimated:
    """Some buckets of a trace: the index of the first, and of each the two values (buckets x 2 x columns)."""

    first: int
    values: Floats


class Decimator:
    """Makes buckets of a trace that comes in pieces, one after another.

    Attributes:
        size: ticks a bucket.
    """

    def __init__(self, size: int, columns: int) -> None:
        """Nothing has come yet.

        Raises:
            ValueError: ``size`` is below 1.
        """
        if size < 1:
            raise ValueError(f"found a bucket of {size} ticks; expected at least 1")
        self.size, self._columns = size, columns
        self._next: int | None = None
        self._rest = np.empty((0, columns))

    def take(self, tick: int, values: Floats) -> list[Decimated]:
        """The next piece.

        Args:
            tick: of its first row; rows that have come before are left out.
            values: ticks x columns, a row a tick.

        Returns:
            The buckets that are whole now, or that a gap has cut; in the order of time.
        """
        if self._next is not None and tick < self._next:
            values = values[self._next - tick :]
            tick = self._next
        if not len(values):
            return []
        done = self._cut() if self._next is not None and tick > self._next else []
        whole = self._whole(tick, values)
        return done if whole is None else [*done, whole]

    def _cut(self) -> list[Decimated]:
        """What was begun before a gap."""
        rest, self._rest = self._rest, self._rest[:0]
        if not len(rest) or self._next is None:
            return []
        return [Decimated((self._next - 1) // self.size, extremes(rest[None]))]

    def _whole(self, tick: int, values: Floats) -> Decimated | None:
        begun = tick - len(self._rest)
        rows = np.concatenate([self._rest, values])
        self._next = tick + len(values)
        first, before = divmod(begun, self.size)  # a piece after a gap may begin inside a bucket
        if before:
            rows = np.concatenate([np.full((before, self._columns), np.nan), rows])
        count = len(rows) // self.size
        self._rest = rows[count * self.size :]
        if not count:
            self._rest = rows[before:]
            return None
        return Decimated(first, extremes(rows[: count * self.size].reshape(count, self.size, self._columns)))
