"""Signed distances from a solid on a regular grid, with the surface for drawing, and the text that holds both.

Between the nodes the distance is interpolated linearly along each axis. A distance changes by at most the way between
two points, so this differs from the exact distance by at most sqrt(3)/2 cells, wherever that is within the band; for
|sum_i w_i d(p_i) - d(p)| <= sum_i w_i |p_i - p|, and the weights' sum of |p_i - p|^2 is at most 3/4 of a cell's square.
Where the surface has the radius of curvature R, the error is of the order cell^2/R.

The text is the file of a grid, and a value in sessions and bundles. Its first line names the format, the second is an
object of JSON, and the others are base64 of deflated numbers: distances, vertices, triangles. Reading it bounds every
size before anything is unpacked, and runs no code.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import json
import math
import textwrap
import zlib
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from manyhands.design.models.brief import brief_repr
from manyhands.design.models.statespace import Matrix
from manyhands.design.models.triangle_mesh import MeshError, TriangleMesh, coarsened, signed_distances

FORMAT: Final = "manyhands distance grid 1"
"""The first line of the text."""

MOST_NODES: Final = 1 << 20
"""The greatest number of nodes: their table at run time has 32 bytes each."""

MOST_DRAWN: Final = 2000
"""The greatest number of triangles that are drawn: viewers are sent them once a second."""

BAND: Final = 4
"""The band in cells, where nothing else is wanted."""

MOST_BAND: Final = 32
"""The widest band in cells."""

_STEPS_IN_CELL: Final = 1000  # a distance is kept in these parts of a cell, in 16 bits
_MICROMETRE: Final = 1e6  # of drawn vertices, in a metre
_FARTHEST: Final = 1e3  # m
_FINEST, _COARSEST = 1e-5, 1.0  # m, of a cell
_KEYS: Final = ("band", "cell", "origin", "shape", "triangles", "vertices")


@dataclass(frozen=True, eq=False)
class DistanceGrid:
    """Signed distances from a solid, at nodes.

    Attributes:
        origin: the first node, m.
        cell: between neighbouring nodes, m.
        band: in cells: distances are cut off at plus and minus this.
        distances: along x, y and z, m; below 0 inside.
        surface: the triangles for drawing.
    """

    origin: tuple[float, float, float]
    cell: float
    band: int
    distances: Matrix
    surface: TriangleMesh

    __repr__ = brief_repr

    @property
    def largest_radius(self) -> float:
        """The greatest radius of a sphere whose contacts lie within the band, m: two cells less than the band."""
        return self.cell * (self.band - 2)

    def band_for(self, radius: float) -> int:
        """The least band, in cells, whose largest radius is at least ``radius``, m."""
        return math.ceil(radius / self.cell) + 2

    @property
    def digest(self) -> str:
        """SHA-256 over all numbers; however they are deflated and wrapped as text, it is the same."""
        head, numbers = self._packed
        return hashlib.sha256(head.encode() + numbers).hexdigest()

    @property
    def text(self) -> str:
        """The grid as text; :func:`grid_of_text` reads it."""
        head, numbers = self._packed
        lines = textwrap.wrap(base64.b64encode(zlib.compress(numbers, 9)).decode(), 100)
        return "\n".join([FORMAT, head, *lines, ""])

    @property
    def _packed(self) -> tuple[str, bytes]:
        """The second line, and the numbers before they are deflated."""
        parts = np.rint(self.distances * (_STEPS_IN_CELL / self.cell)).astype("<i2")
        # differences along z are smaller numbers, which deflate to half the size
        parts[:, :, 1:] -= parts[:, :, :-1].copy()
        vertices = np.rint(self.surface.vertices * _MICROMETRE).astype("<i4")
        head = {
            "band": self.band,
            "cell": self.cell,
            "origin": list(self.origin),
            "shape": list(self.distances.shape),
            "triangles": len(self.surface.triangles),
            "vertices": len(self.surface.vertices),
        }
        return json.dumps(head), parts.tobytes() + vertices.tobytes() + self.surface.triangles.astype("<u2").tobytes()


def grid_of_mesh(mesh: TriangleMesh, cell: float, band: int = BAND) -> DistanceGrid:
    """The grid of a solid, with a margin of the band's width on all sides.

    Distances are rounded to a thousandth of a cell, as the text holds them, and drawn vertices to a micrometre.

    Args:
        mesh: as :func:`manyhands.design.models.triangle_mesh.solid` returns it.
        cell: m.
        band: in cells.

    Raises:
        MeshError: the grid would have too many nodes, or the surface crosses itself.
        ValueError: the cell or the band is out of its range.
    """
    if not _FINEST <= cell <= _COARSEST or not 2 <= band <= MOST_BAND:
        raise ValueError(
            f"found cells of {cell:g} m and a band of {band}; expected {_FINEST:g} to {_COARSEST:g} m, and 2 to "
            f"{MOST_BAND} cells"
        )
    low, high = mesh.bounds
    if not max(np.abs(low).max(), np.abs(high).max()) <= _FARTHEST:
        raise MeshError(f"found a mesh beyond {_FARTHEST:g} m; expected it nearer: state the unit of its coordinates")
    # floats, for their product may be too large for integers
    counts = np.ceil((high - low) / cell) + 2 * band + 1
    if not counts.prod() <= MOST_NODES:
        least = cell * (float(counts.prod()) / MOST_NODES) ** (1 / 3)
        raise MeshError(
            f"found {counts.prod():.3g} nodes with cells of {cell:g} m; expected at most {MOST_NODES}, which takes "
            f"cells of about {least:.2g} m"
        )
    nx, ny, nz = (int(count) for count in counts)
    first = np.array([round(float(x), 9) for x in (low + high - cell * (counts - 1)) / 2.0])
    distances = signed_distances(mesh, first, cell, (nx, ny, nz), band * cell)
    rounded = np.rint(distances * (_STEPS_IN_CELL / cell)) * (cell / _STEPS_IN_CELL)
    drawn = coarsened(mesh, MOST_DRAWN)
    drawn = TriangleMesh(np.rint(drawn.vertices * _MICROMETRE) / _MICROMETRE, drawn.triangles)
    x, y, z = first.tolist()
    return DistanceGrid((x, y, z), cell, band, rounded, drawn)


def grid_of_text(text: str) -> DistanceGrid:
    """The grid that :attr:`DistanceGrid.text` wrote.

    Raises:
        ValueError: the text is of a different format, or its numbers make no grid; the message says what was expected.
    """
    first, _, rest = text.partition("\n")
    second, _, data = rest.partition("\n")
    if first.strip() != FORMAT:
        raise ValueError(f"found the first line {first[:60]!r}; expected {FORMAT!r}, as manyhands mesh writes it")
    try:
        origin, cell, band, shape, sizes = _head(json.loads(second))
        deflated = base64.b64decode("".join(data.split()), validate=True)
        nodes = math.prod(shape)
        ends = np.cumsum([2 * nodes, 12 * sizes[0], 6 * sizes[1]]).tolist()
        unpack = zlib.decompressobj()
        plain = unpack.decompress(deflated, ends[2] + 1)
    except (binascii.Error, zlib.error, ValueError, TypeError, RecursionError) as error:
        raise ValueError(f"found a damaged distance grid ({error}); expected it as manyhands mesh writes it") from error
    if len(plain) != ends[2]:
        raise ValueError(f"found {len(plain)} bytes of numbers or more in a distance grid; expected {ends[2]}")
    parts = np.frombuffer(plain[: ends[0]], dtype="<i2").reshape(shape).cumsum(axis=2, dtype=np.int64)
    vertices = np.frombuffer(plain[ends[0] : ends[1]], dtype="<i4").reshape(-1, 3) / _MICROMETRE
    triangles = np.frombuffer(plain[ends[1] :], dtype="<u2").reshape(-1, 3).astype(np.int64)
    if np.abs(parts).max() > band * _STEPS_IN_CELL or triangles.max(initial=-1) >= len(vertices):
        raise ValueError(
            "found a distance beyond the band, or a triangle of no vertex; expected it as manyhands mesh writes it"
        )
    return DistanceGrid(origin, cell, band, parts * (cell / _STEPS_IN_CELL), TriangleMesh(vertices, triangles))


def _head(
    data: Any,
) -> tuple[tuple[float, float, float], float, int, tuple[int, int, int], tuple[int, int]]:
    """Origin, cell, band, shape, and the numbers of vertices and triangles."""
    if not isinstance(data, dict) or tuple(sorted(data)) != _KEYS:
        raise ValueError(f"expected the keys {', '.join(_KEYS)} in its second line")
    x, y, z = (float(value) for value in data["origin"])
    cell = float(data["cell"])
    whole = [data["band"], data["vertices"], data["triangles"], *data["shape"]]
    if any(type(count) is not int for count in whole) or len(whole) != 6:
        raise ValueError("expected whole numbers")
    band, vertices, triangles, nx, ny, nz = whole
    if not all(abs(value) <= _FARTHEST for value in (x, y, z)) or not _FINEST <= cell <= _COARSEST:
        raise ValueError(f"expected an origin within {_FARTHEST:g} m, and cells of {_FINEST:g} to {_COARSEST:g} m")
    if not (min(nx, ny, nz) >= 2 and max(nx, ny, nz) <= MOST_NODES and nx * ny * nz <= MOST_NODES):
        raise ValueError(f"expected two nodes or more along each axis, and at most {MOST_NODES}")
    if not (2 <= band <= MOST_BAND and 0 <= vertices <= 3 * MOST_DRAWN and 0 <= triangles <= MOST_DRAWN):
        raise ValueError(f"expected a band of 2 to {MOST_BAND} cells, and at most {MOST_DRAWN} triangles")
    return (x, y, z), cell, band, (nx, ny, nz), (vertices, triangles)
