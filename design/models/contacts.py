"""Pairs that may touch in a scene, with their gaps: signed distances, and the gradients of these.

Every gap is a *convex* function of the positions. The signed distance to a convex set is convex everywhere, inside it
as well, and so is the distance of two centres. Therefore the tangent plane at any position is a lower bound
of the gap. The proof of a scene (docs/decisions/0041-scenes.md) rests on that bound alone.

| pair | gap |
|---|---|
| two spheres | distance of the centres, less both radii |
| sphere and wall | height over the plane, less the radius; so is each face of a room |
| sphere and capsule | distance from the capsule's axis, less both radii; a sphere's axis is a point |
| sphere and box | signed distance from the box, less the radius |
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from manyhands.design.models.statespace import Matrix

GROUND: Final = "ground"
"""The end of a link that stands still."""

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


class ContactPair(NamedTuple):
    """Two things that may touch.

    Attributes:
        names: of the two things.
        a: index of the first point.
        b: index of the second point; -1 where the second thing stands still.
        surface: how they touch.
        reach: the radii of both, m.
        kind: "spheres", "plane", "capsule" or "box".
        shape: nothing for two spheres; a point of a plane and its normal; the ends of an axis; the corners of a box.
    """

    names: tuple[str, str]
    a: int
    b: int
    surface: Surface
    reach: float
    kind: str
    shape: tuple[Sequence[float], ...] = ()


def _ordered(pairs: Iterable[ContactPair]) -> list[ContactPair]:
    order = ("spheres", "capsule", "plane", "box")
    return sorted(pairs, key=lambda pair: order.index(pair.kind))


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
        rows = self.pairs = _ordered(pairs)
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
        spheres, capsules, planes = (kinds.count(kind) for kind in ("spheres", "capsule", "plane"))
        self._capsules = slice(spheres, spheres + capsules)
        self._round = slice(0, spheres + capsules)
        self._planes = slice(spheres + capsules, spheres + capsules + planes)
        self._boxes = slice(spheres + capsules + planes, count)
        shapes = [np.array([pair.shape for pair in rows[part]], dtype=np.float64) for part in self._parts()]
        ends, sides, corners = (shape.reshape(len(shape), 2, 3) for shape in shapes)
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

    def _parts(self) -> tuple[slice, slice, slice]:
        return self._capsules, self._planes, self._boxes

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
        capsules, planes, boxes = self._parts()
        if len(self._start):
            relative = u[capsules] - self._start
            at = np.minimum(np.maximum((relative * self._along).sum(axis=1), 0.0), 1.0)
            u[capsules] = relative - at[:, None] * self._axis
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
