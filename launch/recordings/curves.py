"""Curves over time, thinned for drawing so that no extreme is lost, however many ticks there are.

A picture has some thousand columns of pixels; a recording may have millions of ticks. Of the ticks that share a column
the first, the least, the greatest and the last are kept, in their order. So the line through them covers every pixel
that the line through all of them would. A tick with NaN is kept as well, so that a gap stays visible.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from manyhands.nodes.rows.own_ticks import own_span

Array = NDArray[np.float64]

COLUMNS = 1000
"""Columns of pixels that a line is drawn for: about as many as a picture has."""


@dataclass(frozen=True, eq=False)
class Curve:
    """One quantity of one port or node over the ticks.

    Attributes:
        label: of the port or node.
        values: one a tick; NaN where it is not known.
        rate: ticks of the node in one of the picture's.
    """

    label: str
    values: Array
    rate: float = 1.0

    def window(self, rows: range) -> Curve:
        """The same curve for these ticks of the picture."""
        own = own_span(rows, self.rate)
        return Curve(self.label, self.values[own.start : own.stop], self.rate)


@dataclass(frozen=True, eq=False)
class Panel:
    """Curves of one kind, which share their axes.

    Attributes:
        name: of the topic, by which the panel is asked for.
        title: what it shows.
        axis: the quantity, with its unit.
        curves: all over the same time.
        zero: whether to draw a line at zero.
    """

    name: str
    title: str
    axis: str
    curves: tuple[Curve, ...]
    zero: bool = False

    def window(self, first: int, beyond: int) -> Panel:
        """The same panel for the ticks ``first`` to ``beyond - 1``."""
        curves = tuple(curve.window(range(first, beyond)) for curve in self.curves)
        return Panel(self.name, self.title, self.axis, curves, self.zero)


def by_rate(curves: Sequence[Curve]) -> dict[float, list[Curve]]:
    """The curves by their rate; those of one rate have one length."""
    out: dict[float, list[Curve]] = {}
    for curve in curves:
        out.setdefault(curve.rate, []).append(curve)
    return out


def backward_difference(x: Array, period: float, sampled: Array | None = None) -> Array:
    """(x(k) - x(k-1))/T along the first axis, x(-1) being zero; NaN beside every NaN of x.

    Args:
        x: ticks x columns.
        period: T, s.
        sampled: the instants s(k) of a device in wall time, ticks x 1, ns; None for a device with a sample every T.
            With them, the result is (x(k) - x(k-1))/(s(k) - s(k-1)), and NaN in the first tick.
    """
    return _over_time(np.diff(x, axis=0, prepend=np.zeros((1, *x.shape[1:]))), period, sampled)


def angular_velocity(R: Array, period: float, sampled: Array | None = None) -> Array:
    """The shortest turn from R(k-1) to R(k) over the time between them, in the world's axes, ticks x 3, rad/s.

    R(-1) is upright. NaN beside what is not recorded; of a device in wall time likewise in the first tick.

    Args:
        R: unit quaternions, the real part first, ticks x 4.
        period: as in :func:`backward_difference`.
        sampled: likewise.
    """
    before = np.vstack([[1.0, 0.0, 0.0, 0.0], R[:-1]])
    w, v = R[:, :1], R[:, 1:]
    real = (R * before).sum(axis=1, keepdims=True)
    parts = before[:, :1] * v - w * before[:, 1:] - np.cross(v, before[:, 1:])  # of R(k) R(k-1)*
    size = np.linalg.norm(parts, axis=1, keepdims=True)
    angle = 2.0 * np.arctan2(size, np.abs(real)) * np.where(real < 0.0, -1.0, 1.0)
    # a turn that is too small for a quotient is twice these parts
    turn = parts * np.divide(angle, size, out=np.full_like(size, 2.0), where=(size > 0.0) | np.isnan(size))
    return _over_time(turn, period, sampled)


def _over_time(step: Array, period: float, sampled: Array | None) -> Array:
    if sampled is None:
        return step / period
    between = np.diff(sampled, axis=0, prepend=np.nan)
    return np.divide(step, 1e-9 * between, out=np.full_like(step, np.nan), where=between > 0.0)


def thinned(values: Array, columns: int = COLUMNS) -> NDArray[np.intp]:
    """Indices of the values to draw, in order: all of few values; of many, those that the module describes.

    Args:
        values: one a tick, NaN in gaps.
        columns: number of columns of pixels.
    """
    size = -(-len(values) // columns)
    if size <= 4:
        return np.arange(len(values))
    least, greatest, unknown = _by_column(values, size)
    first = np.arange(len(least)) * size
    last = np.minimum(first + size, len(values)) - 1
    return np.unique(np.stack([first, least, greatest, unknown, last]))


def _by_column(values: Array, size: int) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """The index of the least, the greatest and, if any, an unknown value in each column of ``size`` ticks."""
    columns = -(-len(values) // size)
    padded = np.concatenate([values, np.full(columns * size - len(values), values[-1])]).reshape(columns, size)
    gap = np.isnan(padded)
    first = np.arange(columns) * size
    found = (np.where(gap, np.inf, padded).argmin(axis=1), np.where(gap, -np.inf, padded).argmax(axis=1))
    least, greatest, unknown = (np.minimum(first + at, len(values) - 1) for at in (*found, gap.argmax(axis=1)))
    return least, greatest, unknown


def band(curves: Sequence[Curve], columns: int = COLUMNS) -> tuple[NDArray[np.intp], Array, Array]:
    """The least and the greatest of many curves of one length, over the ticks of each column.

    Returns:
        The first tick of each column, and for each column the least and the greatest; NaN where none is known. The last
            tick is repeated at the end, where the last column ends.
    """
    ticks = len(curves[0].values)
    size = max(1, -(-ticks // columns))
    starts = np.arange(0, ticks, size)
    least, greatest = np.full(len(starts), np.nan), np.full(len(starts), np.nan)
    for curve in curves:
        least = np.fmin(least, np.fmin.reduceat(curve.values, starts))
        greatest = np.fmax(greatest, np.fmax.reduceat(curve.values, starts))
    return np.append(starts, ticks - 1), np.append(least, least[-1]), np.append(greatest, greatest[-1])


def alone(values: Array) -> NDArray[np.bool_]:
    """Which values have a gap (or the end) on both sides, so that no line leads to them."""
    known = ~np.isnan(values)
    before, after = np.append(False, known[:-1]), np.append(known[1:], False)
    return np.asarray(known & ~before & ~after)


def gaps(curves: Sequence[Curve], columns: int = COLUMNS) -> list[tuple[int, int]]:
    """Spans of ticks [first, beyond) in which some curve is not known; spans within a column of each other are
    joined.
    """
    if not curves:
        return []
    ticks = len(curves[0].values)
    unknown = np.zeros(ticks + 2, dtype=np.int8)
    for curve in curves:
        unknown[1:-1] |= np.isnan(curve.values)
    edges = np.diff(unknown)
    spans: list[tuple[int, int]] = []
    near = ticks // columns
    for first, beyond in zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True):
        if spans and first - spans[-1][1] <= near:
            spans[-1] = (spans[-1][0], int(beyond))
        else:
            spans.append((int(first), int(beyond)))
    return spans
