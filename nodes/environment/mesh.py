"""Proxies on the surface of a solid, given by its signed distances on a grid, with Coulomb friction.

The proxy of a tool, a point or a sphere of radius R, keeps to where the distance d is at least R. Each tick it moves
from where it was towards the tool's place r without force. It slides along the tangent plane (constraints of the
god-object, [Zilles1995]_; of implicit surfaces, [Salisbury1997]_), and stops where the way to the tool is within the
cone of friction ([Harwin2002]_):

    |t| <= mu depth,     r - q = t - depth n,     n = grad d/|grad d| at q.

The spring's force on the tool is K M (q - r), M = (I + D K)^{-1} (:mod:`manyhands.nodes.environment.proxy`). Where
K and the tool's part of D are multiples of I, it has the direction of q - r, and so is within the cone too.

Distances are interpolated linearly along each axis, and so are their gradients, which are differences at the nodes. So
the normal changes without steps, and an edge is rounded by about a cell.

Nothing here is trusted: the test of the proxies keeps the environment's level for any answer.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from manyhands.design.models.distance_grid import DistanceGrid, grid_of_text

Vector = NDArray[np.float64]
Place: TypeAlias = tuple[float, float, float]

STEPS: Final = 16
"""The most parts of a proxy's way in a tick."""

CONE_TOLERANCE: Final = 1e-3
"""The spring of a proxy that touches has |t| <= (mu + this) depth."""

_NEAR: Final = 1e-4  # cells: what is nearer to the surface is on it
_FLAT: Final = 0.05  # a gradient shorter than this has no direction


class Lookup:
    """The distance and its gradient at any place, from tables of a grid."""

    def __init__(self, grid: DistanceGrid) -> None:
        """Tables of ``grid``: 32 bytes for each node."""
        d = grid.distances
        table = np.stack([d, *np.gradient(d, grid.cell)], axis=-1)
        self._table = np.ascontiguousarray(table.reshape(-1, 4))
        self._origin, self._inverse = grid.origin, 1.0 / grid.cell
        nx, ny, nz = d.shape
        self._last = (nx - 2, ny - 2, nz - 2)
        self._along_x, self._along_y = ny * nz, nz
        corners = [(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1)]
        self._corners = np.array([(i * ny + j) * nz + k for i, j, k in corners], dtype=np.intp)
        self._weights = np.empty(8)

    def __call__(self, place: Place) -> tuple[float, float, float, float]:
        """The distance d (m) and its gradient, interpolated linearly along each axis.

        Beyond the grid they are those at its border, and the way to it is added to d.
        """
        (u, v, w), (ox, oy, oz), (li, lj, lk) = place, self._origin, self._last
        u, v, w = (u - ox) * self._inverse, (v - oy) * self._inverse, (w - oz) * self._inverse
        i, j, k = min(max(int(u), 0), li), min(max(int(v), 0), lj), min(max(int(w), 0), lk)
        a, b, c = min(max(u - i, 0.0), 1.0), min(max(v - j, 0.0), 1.0), min(max(w - k, 0.0), 1.0)
        a_, b_, c_ = 1.0 - a, 1.0 - b, 1.0 - c
        weights = self._weights
        weights[:] = (
            a_ * b_ * c_, a_ * b_ * c, a_ * b * c_, a_ * b * c, a * b_ * c_, a * b_ * c, a * b * c_, a * b * c
        )  # fmt: skip
        at = self._corners + (i * self._along_x + j * self._along_y + k)
        d, gx, gy, gz = (weights @ self._table[at]).tolist()
        u, v, w = u - (i + a), v - (j + b), w - (k + c)
        if u or v or w:
            d += math.sqrt(u * u + v * v + w * w) / self._inverse
        return d, gx, gy, gz


class MeshTool:
    """The proxy of one tool.

    Attributes:
        place: where it is, m.
    """

    def __init__(self, lookup: Lookup, cell: float, at: Place, axes: tuple[int, ...], radius: float, mu: float) -> None:
        """Start at ``at``, m; the proxy moves along ``axes`` alone, and slides from the friction ``mu`` on."""
        self._lookup, self._cell, self._radius, self._mu = lookup, cell, radius, mu
        x, y, z = (float(axis in axes) for axis in range(3))
        self._free = (x, y, z)
        self.place = at

    def follow(self, goal: Place) -> Place:
        """Move the proxy towards ``goal``, the tool's place without force, m.

        Returns:
            Where the spring to the tool begins: the proxy, or the goal where nothing is touched. A proxy that has not
            arrived after :data:`STEPS` parts goes on in the next tick. Until then the spring is that of the tangent
            plane where the proxy is; or there is none, where the proxy is in the air.
        """
        cell, near, mu = self._cell, _NEAR * self._cell, self._mu
        fx, fy, fz = self._free
        longest = cell  # of a part along the surface
        x, y, z = self.place
        bx = by = bz = 0.0  # the part along the surface before
        touched = False
        for left in range(STEPS, 0, -1):
            distance, nx, ny, nz = self._lookup((x, y, z))
            clearance = distance - self._radius
            vx, vy, vz = goal[0] - x, goal[1] - y, goal[2] - z
            way = math.sqrt(vx * vx + vy * vy + vz * vz)
            if clearance >= way - near:
                self.place = goal
                return goal
            nx, ny, nz = nx * fx, ny * fy, nz * fz
            slope = math.sqrt(nx * nx + ny * ny + nz * nz)
            if slope < _FLAT:
                if clearance <= 0.0:  # deep inside, which only a false grid leads to: rest
                    self.place = x, y, z
                    return self.place
                part = min(1.0, max(clearance, 0.5 * cell) / way)
                x, y, z = x + part * vx, y + part * vy, z + part * vz
                continue
            nx, ny, nz = nx / slope, ny / slope, nz / slope
            height = max(clearance / slope, -cell) if abs(clearance) > near * slope else 0.0
            towards = vx * nx + vy * ny + vz * nz
            depth = -(height + towards)  # of the goal under the tangent plane
            if depth <= 0.0 or (height > 0.0 and not touched):
                # the goal is on this side of the plane, or the proxy is in the air: straight on, down to the plane
                part = 1.0 if depth <= 0.0 else height / -towards
                part = min(part, max(clearance, cell) / way)
                x, y, z = x + part * vx, y + part * vy, z + part * vz
                continue
            touched = True
            tx, ty, tz = vx - towards * nx, vy - towards * ny, vz - towards * nz
            along = math.sqrt(tx * tx + ty * ty + tz * tz)
            excess = along - mu * depth
            slides = excess > CONE_TOLERANCE * depth
            if not slides and height == 0.0:
                self.place = x, y, z
                return self.place
            part = excess / along if slides else 0.0
            if left == 1:
                self.place = x, y, z
                return x - height * nx + part * tx, y - height * ny + part * ty, z - height * nz + part * tz
            if slides and tx * bx + ty * by + tz * bz < 0.0:
                longest *= 0.5  # it has gone too far, as in a corner
            bx, by, bz = tx, ty, tz
            part = min(part, longest / along) if slides else 0.0
            x, y, z = x - height * nx + part * tx, y - height * ny + part * ty, z - height * nz + part * tz
        self.place = x, y, z
        return goal


class MeshProxies:
    """A :class:`manyhands.nodes.environment.model.ProxyModel` whose tools touch one solid, and not each other."""

    def __init__(self, ports: tuple[str, ...], period: float, parameters: Mapping[str, Any]) -> None:
        """Read the grid, and stand where the session begins.

        Args:
            ports: of the session.
            period: T, s; the proxies do not depend on it.
            parameters: ``grid``, the text of the distance grid; ``friction``, mu; ``tools``, a list of objects with
                ``ports``, ``axes`` (0, 1 or 2 for each port), ``at`` (m) and ``radius`` (m).

        Raises:
            KeyError, TypeError, ValueError: the parameters are of a different form, or a tool begins in the solid.
        """
        grid = grid_of_text(parameters["grid"])
        lookup = Lookup(grid)
        index = {port: i for i, port in enumerate(ports)}
        self._tools: list[tuple[MeshTool, Place, list[tuple[int, int]]]] = []
        for tool in parameters["tools"]:
            x, y, z = (float(value) for value in tool["at"])
            axes = tuple(int(axis) for axis in tool["axes"])
            own = [(index[port], axis) for port, axis in zip(tool["ports"], axes, strict=True)]
            proxy = MeshTool(lookup, grid.cell, (x, y, z), axes, float(tool["radius"]), float(parameters["friction"]))
            self._tools.append((proxy, (x, y, z), own))

    def proxy(self, x: Vector, k: int) -> list[float]:
        """The proxies for the tools at the displacements x, m, one for each port."""
        r: list[float] = x.tolist()
        for tool, at, own in self._tools:
            goal = [*at]
            for port, axis in own:
                goal[axis] += r[port]
            q = tool.follow((goal[0], goal[1], goal[2]))
            for port, axis in own:
                # equal bits, where nothing is touched
                r[port] = r[port] if q[axis] == goal[axis] else q[axis] - at[axis]
        return r
