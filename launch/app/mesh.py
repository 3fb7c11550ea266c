"""Mesh files, read into solids and turned into distance grids."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any, Final

import numpy as np

from manyhands.design.files import read_regular
from manyhands.design.models.distance_grid import BAND, DistanceGrid, grid_of_mesh
from manyhands.design.models.triangle_mesh import MeshError, TriangleMesh, solid
from manyhands.extras import explained
from manyhands.launch.session.limits import MAX_MESH_BYTES, MAX_MODEL_BYTES
from manyhands.nodes.kernel.factory import in_one_line

_SUFFIXES: Final = (".stl", ".obj")
_CELLS: Final = 64  # along the longest side, where no cell is stated


def read_mesh(path: Path, unit: float = 1e-3) -> TriangleMesh:
    """The solid in an STL or OBJ file.

    Args:
        path: the file; materials and textures that it names are not read.
        unit: of its coordinates, m: the file names none.

    Raises:
        MeshError: the file cannot be read, is too long or no such file, or its surface is no solid.
        MissingExtra: trimesh is not installed.
    """
    suffix = path.suffix.lower()
    if suffix not in _SUFFIXES:
        raise MeshError(f"found the suffix {suffix!r}; expected {' or '.join(_SUFFIXES)}")
    try:
        data = read_regular(path, MAX_MESH_BYTES)
    except (OSError, ValueError) as error:
        raise MeshError(f"found no readable file ({error}); expected an STL or OBJ file") from error
    with explained():
        import trimesh
    try:
        # without a resolver no other file is read; equal vertices are made one by solid()
        found: Any = trimesh.load_mesh(
            io.BytesIO(data), file_type=suffix[1:], process=False, skip_materials=True, resolver=None
        )
        vertices, triangles = np.asarray(found.vertices, dtype=np.float64), np.asarray(found.faces, dtype=np.int64)
    except Exception as error:
        raise MeshError(f"found no mesh ({in_one_line(error)}); expected an STL or OBJ file") from error
    return solid(vertices * unit, triangles)


def made_grid(mesh: TriangleMesh, cell: float | None = None, band: int = BAND) -> DistanceGrid:
    """The distance grid of a solid, small enough for a session.

    Args:
        mesh: of :func:`read_mesh`.
        cell: m; None for a 64th of the longest side, in two digits.
        band: in cells.

    Raises:
        MeshError, ValueError: as :func:`manyhands.design.models.distance_grid.grid_of_mesh`; or its text is too long.
    """
    low, high = mesh.bounds
    grid = grid_of_mesh(mesh, float(f"{float((high - low).max()) / _CELLS:.2g}") if cell is None else cell, band)
    size = len(grid.text)
    if size > MAX_MODEL_BYTES:
        raise MeshError(
            f"found a grid of {size} bytes with cells of {grid.cell:g} m; expected at most {MAX_MODEL_BYTES}, which "
            "takes larger cells"
        )
    return grid
