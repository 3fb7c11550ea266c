"""Solids to touch in tests, their distances by other code than ours, and proxies on them."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import trimesh

from manyhands.design.models.distance_grid import DistanceGrid, grid_of_mesh
from manyhands.design.models.triangle_mesh import TriangleMesh, solid
from manyhands.nodes.environment.mesh import MeshProxies

CELL = 0.002  # m


@cache
def shape(name: str) -> TriangleMesh:
    """A solid by its name, about 50 mm wide, m."""
    made: Any
    match name:
        case "box":
            made = trimesh.creation.box((0.04, 0.03, 0.02))
        case "ball":
            made = trimesh.creation.icosphere(subdivisions=3, radius=0.02)
        case "torus":
            made = trimesh.creation.torus(0.02, 0.008, major_sections=24, minor_sections=12)
        case "star":  # ridges and hollows with sharp edges
            angles = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
            rim = np.where(np.arange(12) % 2, 0.012, 0.026)[:, None] * np.stack(
                [np.cos(angles), np.sin(angles)], axis=1
            )
            ring = [np.column_stack([rim, np.full(12, z)]) for z in (-0.01, 0.01)]
            points = np.concatenate([*ring, [[0.0, 0.0, -0.014], [0.0, 0.0, 0.016]]])
            turns = [(i, (i + 1) % 12) for i in range(12)]
            faces = [
                three
                for i, j in turns
                for three in ((i, j, 12 + j), (i, 12 + j, 12 + i), (j, i, 24), (12 + i, 12 + j, 25))
            ]
            return solid(points, faces)
    return solid(made.vertices, made.faces)


@cache
def grid(name: str, cell: float = CELL) -> DistanceGrid:
    return grid_of_mesh(shape(name), cell)


def exact_distances(mesh: TriangleMesh, points: np.ndarray) -> np.ndarray:
    """Signed distances by trimesh's nearest points, and by the winding number, m; below 0 inside."""
    triangles = mesh.vertices[mesh.triangles]
    found = np.array([_nearest(triangles, point) for point in points])
    away = triangles[None] - points[:, None, None]  # n x F x 3 x 3
    a, b, c = (away[:, :, corner] for corner in range(3))
    la, lb, lc = (np.linalg.norm(side, axis=-1) for side in (a, b, c))
    above = np.einsum("nfi,nfi->nf", a, np.cross(b, c))
    below = la * lb * lc + (a * b).sum(-1) * lc + (b * c).sum(-1) * la + (c * a).sum(-1) * lb
    winding = 2.0 * np.arctan2(above, below).sum(axis=1) / (4.0 * np.pi)
    return np.where(np.abs(winding) > 0.5, -found, found)


def _nearest(triangles: np.ndarray, point: np.ndarray) -> float:
    nearest = trimesh.triangles.closest_point(triangles, np.broadcast_to(point, (len(triangles), 3)))
    return float(np.linalg.norm(nearest - point, axis=1).min())


def parameters(
    made: DistanceGrid, friction: float, **tools: tuple[tuple[float, float, float], float]
) -> dict[str, Any]:
    """What the factory is called with: tools with three axes, by name where each begins and its radius."""
    return {
        "grid": made.text,
        "friction": friction,
        "tools": [
            {"ports": [f"{name}.{axis}" for axis in "xyz"], "axes": [0, 1, 2], "at": [*at], "radius": radius}
            for name, (at, radius) in tools.items()
        ],
    }


def proxies(made: DistanceGrid, friction: float, **tools: tuple[tuple[float, float, float], float]) -> MeshProxies:
    ports = tuple(f"{name}.{axis}" for name in tools for axis in "xyz")
    return MeshProxies(ports, 1e-3, parameters(made, friction, **tools))
