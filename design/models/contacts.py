"""Pairs that may touch in a scene, with their gaps: signed distances, and the gradients of these.

Every gap is a *convex* function of the positions. The signed distance to a convex set is convex everywhere, inside it
as well, and so is the distance of two centres. Therefore the tangent plane at any position is a lower bound
of the gap. The proof of a scene (docs/decisions/0041-scenes.md) rests on that bound alone. Where a centre is on an
axis, an edge or a corner, there are many tangent planes, and the gradient is that of one of them.

| pair | gap |
|---|---|
| two spheres | distance of the centres, less both radii |
| anything and a wall | height of its lowest point over the plane; so is each face of a room |
| sphere and capsule | distance from the capsule's axis, less both radii; a sphere's axis is a point |
| two capsules | distance of the axes, which is that of a centre from a parallelogram, less both radii |
| anything else and box | signed distance of a centre from a box, less the radii |

A thing is its *core*, a point, a segment or a box with its sides along the axes, with a radius around it. Nothing
turns. So the cores A + a and B + b of two things meet where a - b is in the Minkowski difference of B and A. That set
is convex, and the gap is the signed distance of a - b from it, less both radii. For two boxes it is a box, and so it is
for a box and a segment along an axis.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from manyhands.design.models.statespace import Matrix

GROUND: Final = "ground"
"""The end of a link that stands still."""

Point: TypeAlias = tuple[float, float, float]
"""A position or a vector in the scene, along x, y and z."""

AXES: Final = "xyz"
"""The axes of space, in the order of every position here."""


def coordinates(body: str) -> tuple[str, ...]:
    """The names of a body's coordinates x, y and z among the masses of a session."""
    return tuple(f"{body}.{axis}" for axis in AXES)


_SMALL: Final = 1e-140  # m; the squares of shorter vectors have few digits, or none

_GREATER: Final = 2.0**700
"""A power of two, so that a short vector times this has the same digits."""

_UP = np.array([0.0, 0.0, 1.0])  # a direction where any is as good


class Surface(NamedTuple):
    """How two things touch.

    Attributes:
        stiffness: normal to the surface, and along it while they stick, N/m; 0 where they never touch.
        damping: normal to the surface, N*s/m.
        friction: the coefficient of Coulomb friction, dimensionless.
    """

    stiffness: float
    damping: float = 0.0
    friction: float = 0.0


class Core(NamedTuple):
    """A point, a segment or a box: what a thing is within its radius.

    Attributes:
        kind: "segment" or "box"; a point is a segment of length 0.
        ends: of the segment, or the corners of the box with the least and the greatest coordinates, m.
    """

    kind: str
    ends: tuple[Point, Point]

    @property
    def is_point(self) -> bool:
        """Whether it has no extent."""
        return self.ends[0] == self.ends[1]

    @property
    def along_axes(self) -> bool:
        """Whether it is a box, or a segment along one of the axes, which is a box without width."""
        return self.kind == "box" or sum(a != b for a, b in zip(*self.ends, strict=True)) <= 1

    def support(self, direction: Point) -> float:
        """How far it reaches from its middle along a vector of any length, m."""
        half = [(b - a) / 2.0 for a, b in zip(*self.ends, strict=True)]
        reaches = [n * h for n, h in zip(direction, half, strict=True)]
        along = sum(map(abs, reaches)) if self.kind == "box" else abs(sum(reaches))
        return along / math.hypot(*direction)


def core_difference(a: Core, b: Core) -> tuple[str, tuple[Point, ...]] | None:
    """The Minkowski difference of ``b`` and ``a``, where a centre less the other is while the cores meet.

    Args:
        a: with its middle at the origin.
        b: anywhere.

    Returns:
        Kind and shape of a :class:`ContactPair`; None for a box and a segment that is along no axis.
    """
    low, high = b.ends
    half = a.ends[1]
    if a.is_point or b.is_point:
        wide = b if a.is_point else a
        return _KINDS[wide.kind], (_moved(low, half, -1.0), _moved(high, half, 1.0))
    if a.along_axes and b.along_axes:
        least, most = (tuple(f(pair) for pair in zip(low, high, strict=True)) for f in (min, max))
        wide_half = tuple(map(abs, half))
        return "box", (_moved(least, wide_half, -1.0), _moved(most, wide_half, 1.0))
    if a.kind == b.kind == "segment":
        return "parallelogram", (low, high, half)
    return None


_KINDS: Final = {"segment": "capsule", "box": "box"}


def _moved(point: Sequence[float], by: Sequence[float], sign: float) -> Point:
    x, y, z = (p + sign * d for p, d in zip(point, by, strict=True))
    return x, y, z


class ContactPair(NamedTuple):
    """Two things that may touch.

    Attributes:
        names: of the two things.
        a: index of the first point.
        b: index of the second point; -1 where the second thing stands still.
        surface: how they touch.
        reach: the radii of both, m; for a plane also how far the core reaches towards it.
        kind: "spheres", "plane", "capsule", "parallelogram" or "box".
        shape: nothing for two spheres; a point of a plane and its normal; the ends of an axis; the ends of an axis and
            half of the other one; the corners of a box.
    """

    names: tuple[str, str]
    a: int
    b: int
    surface: Surface
    reach: float
    kind: str
    shape: tuple[Sequence[float], ...] = ()


_ORDER: Final = ("spheres", "capsule", "parallelogram", "plane", "box")
"""The order of the rows by their kinds."""


class Contacts:
    """All pairs of a scene, in arrays of C rows, one for each pair.

    Attributes:
        pairs: in the order of the rows.
        incidence: C x P; with the points' positions z (P x 3), ``incidence @ z`` is the first point less the second.
        stiffness: N/m.
        damping: N*s/m.
        friction: dimensionless.
    """

    def __init__(self, pairs: Iterable[ContactPair], points: int) -> None:
        """Arrays of ``pairs`` between ``points`` points.

        Raises:
            ValueError: a plane has no normal.
        """
        rows = self.pairs = sorted(pairs, key=lambda pair: _ORDER.index(pair.kind))
        count = len(rows)
        self.incidence = np.zeros((count, points))
        for row, pair in enumerate(rows):
            self.incidence[row, pair.a] = 1.0
            if pair.b >= 0:
                self.incidence[row, pair.b] = -1.0
        surfaces = np.array([pair.surface for pair in rows]).reshape(count, 3)
        self.stiffness, self.damping, self.friction = np.ascontiguousarray(surfaces.T)
        self._reach = np.array([pair.reach for pair in rows])
        kinds = [pair.kind for pair in rows]
        ends = np.cumsum([kinds.count(kind) for kind in _ORDER]).tolist()
        self._spheres, *parts = (slice(begin, end) for begin, end in pairwise([0, *ends]))
        self._capsules, self._parallelograms, self._planes, self._boxes = parts
        axes, sheets, sides, corners = (
            np.array([pair.shape for pair in rows[part]], dtype=np.float64).reshape(-1, size, 3)
            for part, size in zip(parts, (2, 3, 2, 2), strict=True)
        )
        self._from_axes, self._from_sheets = _Distances(axes), _Distances(sheets)
        lengths = np.sqrt((sides[:, 1] * sides[:, 1]).sum(axis=1))
        if not np.all(lengths > 0.0):
            raise ValueError("found a wall with the normal [0, 0, 0]; expected a direction")
        self._normals = sides[:, 1] / lengths[:, None]
        self._heights = (sides[:, 0] * self._normals).sum(axis=1)
        self._centres, self._halves = corners.sum(axis=1) / 2.0, (corners[:, 1] - corners[:, 0]) / 2.0

    def __len__(self) -> int:
        """C, the number of pairs."""
        return len(self.stiffness)

    def gaps(self, z: Matrix) -> tuple[NDArray[np.float64], Matrix]:
        """The gaps and their gradients.

        Args:
            z: the points' positions, P x 3, m.

        Returns:
            The gaps, m, below 0 where two things overlap; and the gradients by the first point's position, C x 3. They
            are unit vectors, and a second point's are the opposite ones.
        """
        u = self.incidence @ z
        gap = np.empty(len(u))
        spheres, planes, boxes = self._spheres, self._planes, self._boxes
        if spheres.stop:
            u[spheres], gap[spheres] = _units(u[spheres])
            u[: spheres.stop][gap[spheres] == 0.0] = _UP
        for part, distances in ((self._capsules, self._from_axes), (self._parallelograms, self._from_sheets)):
            if part.start < part.stop:
                gap[part], u[part] = distances.to(u[part])
        if len(self._normals):
            gap[planes] = (u[planes] * self._normals).sum(axis=1) - self._heights
            u[planes] = self._normals
        if len(self._centres):
            gap[boxes], u[boxes] = _from_boxes(u[boxes] - self._centres, self._halves)
        return gap - self._reach, u

    def energy(self, z: Matrix) -> float:
        """The energy that the springs of overlapping pairs store, J; ``z`` as for :meth:`gaps`."""
        depth = np.maximum(0.0, -self.gaps(z)[0])
        return 0.5 * float(self.stiffness @ (depth * depth))


class _Distances:
    """Distances from segments, or from parallelograms: the sets {c + s a + t b, -1 <= s, t <= 1}, b = 0 for segments.

    The distance of x from a convex closed set is the greatest of n^T x - h(n) over unit vectors n, h being the support
    function: here n^T c + |n^T a| + |n^T b|. It is attained where n leads to x from the nearest point: from a corner;
    from an edge, across it; or along the normal of the sheet. So each of these directions is a *candidate*, and the
    greatest value is the distance. The plane of every candidate is below the distance everywhere, whatever rounding has
    made of its direction. Where x is on the set to rounding, the way to x is noise; then the candidates win that are
    across an axis, or normal to the sheet, to the last bit.
    """

    def __init__(self, shapes: NDArray[np.float64]) -> None:
        """The sets between two ends (R x 2 x 3), or with half of the other side as a third row (R x 3 x 3), m."""
        self._centres = shapes[:, :2].sum(axis=1) / 2.0
        a = (shapes[:, 1] - shapes[:, 0]) / 2.0
        none = np.zeros_like(a)
        up = np.broadcast_to(_UP, a.shape)
        along_a = _units(a)[0]
        across_a = _across(np.eye(3)[np.abs(a).argmin(axis=1)], along_a, up)
        if shapes.shape[1] == 2:
            b, self._normals = none, none[:, None][:, :0]
            feet, rails, spare = [a, -a, none], [none, none, along_a], across_a
        else:
            b = shapes[:, 2]
            along_b = _units(b)[0]
            spare = _across(np.cross(along_a, _across(b, along_a, across_a)), along_a, up)
            self._normals = np.stack([spare, -spare], axis=1)
            feet = [a + b, a - b, b - a, -a - b, b, -b, a, -a]
            rails = [none] * 4 + [along_a] * 2 + [along_b] * 2
        self._feet, self._rails = np.stack(feet, axis=1), np.stack(rails, axis=1)
        self._spare = np.repeat(spare[:, None], len(feet), axis=1)
        self._sides = np.stack([a, b], axis=2)

    def to(self, x: Matrix) -> tuple[NDArray[np.float64], Matrix]:
        """The distances to places ``x``, R x 3, m, and their gradients."""
        x = x - self._centres
        found = _across(x[:, None] - self._feet, self._rails, self._spare)
        candidates = np.concatenate([found, self._normals], axis=1)
        values = (candidates @ x[:, :, None])[:, :, 0] - np.abs(candidates @ self._sides).sum(axis=2)
        rows, best = np.arange(len(x)), values.argmax(axis=1)
        return values[rows, best], candidates[rows, best]


def _units(v: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The unit vectors along v, over the last axis, and the lengths of v; 0 for 0."""
    length = np.sqrt((v * v).sum(axis=-1))
    small = length < _SMALL
    if not small.any():
        return v / length[..., None], length
    greater = np.where(small[..., None], _GREATER * v, v)
    length = np.sqrt((greater * greater).sum(axis=-1))
    units = greater / np.where(length > 0.0, length, 1.0)[..., None]
    return units, np.where(small, length / _GREATER, length)


def _across(v: NDArray[np.float64], along: NDArray[np.float64], spare: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit vectors along v, over the last axis, less what they have along the unit vectors ``along``.

    The second projection takes away what rounding has left of the first. Where little remains after it, v was along
    ``along`` to rounding, or 0: the direction is then ``spare``.
    """
    n = _units(v - (v * along).sum(axis=-1)[..., None] * along)[0]
    n = n - (n * along).sum(axis=-1)[..., None] * along
    n, length = _units(n)
    return np.where((length < 0.5)[..., None], spare, n)


def _from_boxes(relative: Matrix, halves: Matrix) -> tuple[NDArray[np.float64], Matrix]:
    """Signed distance from boxes around 0, m, and its gradient; inside a box that of the nearest face."""
    beyond = np.abs(relative) - halves
    sides = np.copysign(1.0, relative)
    gradient, distance = _units(sides * np.maximum(beyond, 0.0))
    for row in np.flatnonzero(distance == 0.0):
        face = int(np.argmax(beyond[row]))
        distance[row] = beyond[row, face]
        gradient[row, face] = sides[row, face]
    return distance, gradient
