"""Closed surfaces of triangles: what makes one a solid, and the signed distance from it at the nodes of a grid.

The sign comes from the normal at the nearest feature: that of a face, the sum of both faces' at an edge, and the sum
weighted with the angles at a vertex. With these normals the sign is right at every point outside the surface and inside
([Baerentzen2005]_).
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from manyhands.design.models.statespace import Matrix

MOST_TRIANGLES: Final = 50_000
"""Of a mesh: the time to compute its distances grows with their number."""

_FLATTEST: Final = 1e-9  # a triangle's height over its longest edge: below, its normal is rounding

Indices = NDArray[np.int64]


class MeshError(ValueError):
    """A mesh is no solid: the message says what was found and what is expected."""


class TriangleMesh(NamedTuple):
    """A surface of triangles.

    Attributes:
        vertices: V x 3, m.
        triangles: F x 3, indices of vertices; seen from outside, they turn to the left.
    """

    vertices: Matrix
    triangles: Indices

    @property
    def bounds(self) -> tuple[Matrix, Matrix]:
        """The corners with the least and the greatest coordinates, m."""
        return self.vertices.min(axis=0), self.vertices.max(axis=0)


def solid(vertices: ArrayLike, triangles: ArrayLike) -> TriangleMesh:
    """The mesh of these triangles, with equal vertices made one; it is a closed surface with an inside.

    Args:
        vertices: V x 3, m.
        triangles: F x 3, indices of vertices.

    Raises:
        MeshError: there are none or too many triangles; a number is not finite; a triangle has no area; or the surface
            is open, has no consistent outside, or faces inwards.
    """
    points, faces = np.array(vertices, dtype=np.float64), np.array(triangles, dtype=np.int64)
    if points.ndim != 2 or points.shape[1:] != (3,) or faces.ndim != 2 or faces.shape[1:] != (3,) or not len(faces):
        raise MeshError("found no triangles; expected a surface of triangles")
    if len(faces) > MOST_TRIANGLES:
        raise MeshError(f"found {len(faces)} triangles; expected at most {MOST_TRIANGLES}: simplify the mesh")
    if not np.isfinite(points).all() or faces.min() < 0 or faces.max() >= len(points):
        raise MeshError("found a vertex that is not finite or does not exist; expected three finite coordinates each")
    points, place = np.unique(points[faces.ravel()], axis=0, return_inverse=True)
    faces = place.reshape(-1, 3)
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]  # such a triangle is an edge, whose two sides cancel
    if not len(faces):
        raise MeshError("found triangles without any area; expected a surface")
    _require_areas(points, faces)
    _require_closed(faces)
    mesh = TriangleMesh(points, faces)
    corners = points[faces]
    volume = float(np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))) / 6.0
    if not volume > 0.0:
        raise MeshError(
            f"found a volume of {volume:.3g} m³: the triangles face inwards; expected them to face outwards"
        )
    return mesh


def _require_areas(points: Matrix, faces: Indices) -> None:
    corners = points[faces]
    edges = np.roll(corners, -1, axis=1) - corners
    longest = (edges * edges).sum(axis=2).max(axis=1)
    doubled = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    flat = np.flatnonzero(~(doubled > _FLATTEST * longest))
    if len(flat):
        x, y, z = corners[flat[0]].mean(axis=0)
        raise MeshError(
            f"found {len(flat)} triangles without area, the first at ({x:.4g}, {y:.4g}, {z:.4g}) m; expected three "
            "corners that are not on a line: repair the mesh"
        )


def _require_closed(faces: Indices) -> None:
    starts, ends = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    count = int(faces.max()) + 1
    forth, times = np.unique(starts * count + ends, return_counts=True)
    back = np.unique(ends * count + starts)
    alone = len(np.setdiff1d(forth, back, assume_unique=True))
    doubled = int((times > 1).sum())
    if doubled:
        raise MeshError(
            f"found {doubled} edges where neighbouring triangles face opposite ways, or more than two meet; expected "
            "two triangles at every edge, both facing outwards: repair the mesh"
        )
    if alone:
        raise MeshError(
            f"found {alone} edges with one triangle alone; expected a closed surface, with two triangles at every "
            "edge: repair the mesh"
        )


def coarsened(mesh: TriangleMesh, most: int) -> TriangleMesh:
    """A mesh of at most ``most`` triangles that looks alike: vertices in the same cell of a grid become their mean.

    For drawing alone; what is left need not be closed ([Rossignac1993]_).
    """
    low, high = mesh.bounds
    cells = 64.0
    while len(mesh.triangles) > most:
        size = float((high - low).max()) / cells
        _, place = np.unique(np.floor((mesh.vertices - low) / size).astype(np.int64), axis=0, return_inverse=True)
        place = place.ravel()
        sums = np.stack([np.bincount(place, mesh.vertices[:, axis]) for axis in range(3)], axis=1)
        faces = place[mesh.triangles]
        a, b, c = faces.T
        mesh = TriangleMesh(sums / np.bincount(place)[:, None], faces[(a != b) & (b != c) & (c != a)])
        cells /= 1.25
    used, place = np.unique(mesh.triangles, return_inverse=True)
    return TriangleMesh(mesh.vertices[used], place.reshape(-1, 3))


def signed_distances(
    mesh: TriangleMesh, origin: Matrix, cell: float, shape: tuple[int, int, int], band: float
) -> Matrix:
    """The signed distances of a grid's nodes from a closed surface, m: below 0 inside, and cut off at +-``band``.

    Args:
        mesh: as :func:`solid` returns it.
        origin: the first node, m; it is outside, as all nodes on the grid's first face along x are.
        cell: the distance between neighbouring nodes, m.
        shape: the number of nodes along x, y and z.
        band: m, at least one cell.

    Raises:
        MeshError: the surface crosses itself, or a part of it faces inwards: the distances of neighbouring nodes differ
            by more than their own distance.
    """
    found = np.full(shape, np.inf)  # distance, squared
    sides = np.zeros(shape)
    corners = mesh.vertices[mesh.triangles]
    normals = _normals(mesh)
    first = np.maximum(np.ceil((corners.min(axis=1) - band - origin) / cell), 0).astype(np.int64)
    last = np.minimum(np.floor((corners.max(axis=1) + band - origin) / cell) + 1, shape).astype(np.int64)
    axes = [origin[j] + cell * np.arange(shape[j]) for j in range(3)]
    for triangle, (low, high) in enumerate(zip(first.tolist(), last.tolist(), strict=True)):
        box = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
        nodes = np.stack(np.meshgrid(*(axes[j][box[j]] for j in range(3)), indexing="ij"), axis=-1)
        squares, side = _from_triangle(nodes.reshape(-1, 3), corners[triangle], normals[triangle])
        part, part_sides = found[box], sides[box]  # views
        nearer = squares.reshape(part.shape) < part
        part[nearer] = squares.reshape(part.shape)[nearer]
        part_sides[nearer] = side.reshape(part.shape)[nearer]
    sides[0][sides[0] == 0.0] = 1.0
    for i in range(1, shape[0]):  # a node beyond the band is on the side of its neighbour
        beyond = sides[i] == 0.0
        sides[i][beyond] = sides[i - 1][beyond]
    distances = np.asarray(sides * np.minimum(np.sqrt(found), band))
    steepest = max(float(np.abs(np.diff(distances, axis=axis)).max(initial=0.0)) for axis in range(3))
    if steepest > cell * (1.0 + 1e-6):
        raise MeshError(
            "found a surface that crosses itself, or a part of it that faces inwards; expected one outside and one "
            "inside: unite the parts of the mesh"
        )
    return distances


def _normals(mesh: TriangleMesh) -> Matrix:
    """By triangle the normals of its features, F x 7 x 3: three vertices, the edges that begin there, the face."""
    points, faces = mesh
    corners = points[faces]
    edges = np.roll(corners, -1, axis=1) - corners
    face = np.cross(edges[:, 0], edges[:, 1])
    face /= np.linalg.norm(face, axis=1)[:, None]
    out = np.empty((len(faces), 7, 3))
    out[:, 6] = face
    lengths = np.linalg.norm(edges, axis=2)
    backwards = -np.roll(edges, 1, axis=1)
    cosines = (edges * backwards).sum(axis=2) / (lengths * np.roll(lengths, 1, axis=1))
    angles = np.arccos(np.clip(cosines, -1.0, 1.0))
    at_vertices = np.zeros_like(points)
    for corner in range(3):
        np.add.at(at_vertices, faces[:, corner], angles[:, corner, None] * face)
    count = len(points)
    starts, ends = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    order = np.argsort(starts * count + ends)
    opposite = order[np.searchsorted((starts * count + ends)[order], ends * count + starts)]
    out[:, :3] = at_vertices[faces]
    out[:, 3:6] = (np.repeat(face, 3, axis=0) + face[opposite // 3]).reshape(-1, 3, 3)
    return out


def _from_triangle(points: Matrix, corners: Matrix, normals: Matrix) -> tuple[Matrix, Matrix]:
    """Squared distances of n points from a triangle, m^2, and the sides on which they are: 1 outside, -1 inside.

    The nearest point is a + v ab + w ac; where the plane's nearest point is outside of the triangle, it is on an edge
    or a vertex, as the signs of these products decide ([Ericson2005]_, section 5.1.5).
    """
    a, b, c = corners
    ab, ac = b - a, c - a
    d1, d2 = (points - a) @ ab, (points - a) @ ac
    d3, d4 = (points - b) @ ab, (points - b) @ ac
    d5, d6 = (points - c) @ ab, (points - c) @ ac
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    regions = [
        (d1 <= 0) & (d2 <= 0),
        (d3 >= 0) & (d4 <= d3),
        (d6 >= 0) & (d5 <= d6),
        (vc <= 0) & (d1 >= 0) & (d3 <= 0),
        (va <= 0) & (d4 >= d3) & (d5 >= d6),
        (vb <= 0) & (d2 >= 0) & (d6 <= 0),
    ]
    zero, one = np.zeros(len(points)), np.ones(len(points))
    with np.errstate(divide="ignore", invalid="ignore"):  # of regions that are not chosen
        along_ab, along_bc, along_ca = d1 / (d1 - d3), (d4 - d3) / ((d4 - d3) + (d5 - d6)), d2 / (d2 - d6)
        inside = va + vb + vc
        v = np.select(regions, [zero, one, zero, along_ab, 1.0 - along_bc, zero], vb / inside)
        w = np.select(regions, [zero, zero, one, zero, along_bc, along_ca], vc / inside)
    across = points - (a + v[:, None] * ab + w[:, None] * ac)
    feature = np.select(regions, [0, 1, 2, 3, 4, 5], 6)
    side = np.where((across * normals[feature]).sum(axis=1) >= 0.0, 1.0, -1.0)
    return (across * across).sum(axis=1), side
