"""Pairs that may touch in a scene, with their gaps: signed distances, and the gradients of these.

Every gap is a *convex* function of the positions. The signed distance to a convex set is convex everywhere, inside it
as well, and so is the distance of two centres. Therefore the tangent plane at any position is a lower bound
of the gap. The proof of a scene (docs/decisions/0041-scenes.md) rests on that bound alone.

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
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from manyhands.design.models.statespace import Matrix

GROUND: Final = "ground"
"""The end of a link that stands still."""

Point: TypeAlias = tuple[float, float, float]
"""A position or a vector in the scene, along x, y and z."""

_PARALLEL: Final = 1e-14
"""The square of a sine below which two axes are parallel: either way the nearest point is then exact to 1e-7."""

_LEAST: Final = 1e-300  # m^2, of the square of an axis: no division by 0

AXES: Final = "xyz"
"""The axes of space, in the order of every position here."""


def coordinates(body: str) -> tuple[str, ...]:
    """The names of a body's coordinates x, y and z among the masses of a session."""
    return tuple(f"{body}.{axis}" for axis in AXES)


_UP = np.array([0.0, 0.0, 1.0])  # the gradient where a centre is on an axis or on the other centre: one of many


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
"""The order of the rows by their kinds; the first three are distances from sets without an inside."""


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
        spheres, capsules, pairs_of_axes, planes = (kinds.count(kind) for kind in _ORDER[:-1])
        round_ = spheres + capsules + pairs_of_axes
        self._capsules = slice(spheres, spheres + capsules)
        self._parallelograms = slice(spheres + capsules, round_)
        self._round = slice(0, round_)
        self._planes = slice(round_, round_ + planes)
        self._boxes = slice(round_ + planes, count)
        ends, axes, sides, corners = (
            np.array([pair.shape for pair in rows[part]], dtype=np.float64).reshape(-1, size, 3)
            for part, size in zip(self._parts(), (2, 3, 2, 2), strict=True)
        )
        self._middles, self._across = axes[:, :2].sum(axis=1) / 2.0, (axes[:, 1] - axes[:, 0]) / 2.0
        self._along_other = axes[:, 2]
        self._start, self._axis = ends[:, 0], ends[:, 1] - ends[:, 0]
        square = (self._axis * self._axis).sum(axis=1)
        self._along = self._axis / np.where(square > 0.0, square, 1.0)[:, None]
        lengths = np.sqrt((sides[:, 1] * sides[:, 1]).sum(axis=1))
        if not np.all(lengths > 0.0):
            raise ValueError("found a wall with the normal [0, 0, 0]; expected a direction")
        self._normals = sides[:, 1] / lengths[:, None]
        self._heights = (sides[:, 0] * self._normals).sum(axis=1)
        self._centres, self._halves = corners.sum(axis=1) / 2.0, (corners[:, 1] - corners[:, 0]) / 2.0

    def __len__(self) -> int:
        """C, the number of pairs."""
        return len(self.stiffness)

    def _parts(self) -> tuple[slice, slice, slice, slice]:
        return self._capsules, self._parallelograms, self._planes, self._boxes

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
        capsules, parallelograms, planes, boxes = self._parts()
        if len(self._start):
            relative = u[capsules] - self._start
            at = np.minimum(np.maximum((relative * self._along).sum(axis=1), 0.0), 1.0)
            u[capsules] = relative - at[:, None] * self._axis
        if len(self._middles):
            u[parallelograms] = _from_parallelograms(u[parallelograms] - self._middles, self._across, self._along_other)
        if self._round.stop:
            across = u[self._round]
            distance = np.sqrt((across * across).sum(axis=1))
            gap[self._round] = distance
            centred = distance == 0.0
            if centred.any():
                across[centred], distance[centred] = _UP, 1.0
            across /= distance[:, None]
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


def _from_parallelograms(relative: Matrix, a: Matrix, b: Matrix) -> Matrix:
    """The vectors from the nearest points s a + t b, -1 <= s, t <= 1, m.

    The s of the nearest point of the plane, within its bounds; the best t for that s; and the best s for that t. Where
    a and b are parallel to rounding, the best s for t = 0 begins, which ends at a nearest point as well.
    """
    aa, bb = (np.maximum((side * side).sum(axis=1), _LEAST) for side in (a, b))
    ab = (a * b).sum(axis=1)
    ua, ub = (relative * a).sum(axis=1), (relative * b).sum(axis=1)
    determinant = aa * bb - ab * ab
    parallel = determinant <= _PARALLEL * aa * bb
    s = np.where(parallel, ua / aa, (ua * bb - ub * ab) / np.where(parallel, 1.0, determinant))
    t = np.clip((ub - np.clip(s, -1.0, 1.0) * ab) / bb, -1.0, 1.0)
    s = np.clip((ua - t * ab) / aa, -1.0, 1.0)
    return np.asarray(relative - s[:, None] * a - t[:, None] * b)


def _from_boxes(relative: Matrix, halves: Matrix) -> tuple[NDArray[np.float64], Matrix]:
    """Signed distance from boxes around 0, m, and its gradient; inside a box that of the nearest face."""
    beyond = np.abs(relative) - halves
    sides = np.copysign(1.0, relative)
    outside = np.maximum(beyond, 0.0)
    distance = np.sqrt((outside * outside).sum(axis=1))
    gradient = sides * outside
    for row in np.flatnonzero(distance == 0.0):
        face = int(np.argmax(beyond[row]))
        distance[row] = beyond[row, face]
        gradient[row, face] = sides[row, face]
    away = distance > 0.0
    gradient[away] /= distance[away, None]
    return distance, gradient
