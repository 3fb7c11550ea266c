"""The mesh of the session ``stroke``: a plate with three ridges and a dome, as an STL file in mm.

python examples/relief.py              # writes relief.stl
manyhands mesh relief.stl --cell 0.002 # writes relief.grid, whose text is in stroke.yaml
"""

import struct
import sys
from pathlib import Path

import numpy as np

STEP = 4.0  # mm, between the vertices of the upper side
HALF_X, HALF_Z, BOTTOM = 48.0, 28.0, -8.0  # mm
RIDGE, PITCH = 6.0, 16.0  # mm, height and distance of the ridges
DOME, RADIUS = 10.0, 20.0  # mm, height and radius of the dome's foot


def height(x: np.ndarray, z: np.ndarray) -> np.ndarray:
    """The upper side, mm: ridges with sharp crests where x < 0, and a dome where x > 0."""
    ridges = RIDGE * np.maximum(0.0, 1.0 - np.abs((x + HALF_X) % PITCH - PITCH / 2) / (PITCH / 2))
    away = np.hypot(x - HALF_X / 2, z) / RADIUS
    return np.where(x < 0.0, ridges, DOME * np.maximum(0.0, 1.0 - away**2))


def corners() -> np.ndarray:
    """The triangles, F x 3 corners x (x, y, z), mm; seen from outside they turn to the left."""
    xs, zs = np.arange(-HALF_X, HALF_X + 1, STEP), np.arange(-HALF_Z, HALF_Z + 1, STEP)
    x, z = np.meshgrid(xs, zs, indexing="ij")
    top = np.stack([x, height(x, z), z], axis=-1)
    a, b, c, d = top[:-1, :-1], top[1:, :-1], top[1:, 1:], top[:-1, 1:]
    upper = np.concatenate([np.stack([a, c, b], axis=2), np.stack([a, d, c], axis=2)]).reshape(-1, 3, 3)
    rim = np.concatenate([top[:, 0], top[-1, 1:], top[-2::-1, -1], top[0, -2:0:-1]])
    following = np.roll(rim, -1, axis=0)
    foot, next_foot = rim * (1, 0, 1) + (0, BOTTOM, 0), following * (1, 0, 1) + (0, BOTTOM, 0)
    sides = [np.stack(three, axis=1) for three in ((rim, following, next_foot), (rim, next_foot, foot))]
    middle = np.broadcast_to([0.0, BOTTOM, 0.0], foot.shape)
    return np.concatenate([upper, *sides, np.stack([foot, next_foot, middle], axis=1)])


def stl(triangles: np.ndarray) -> bytes:
    """The triangles as a binary STL file."""
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    rows = np.zeros(len(triangles), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("zero", "<u2")])
    rows["normal"], rows["corners"] = normals / np.linalg.norm(normals, axis=1)[:, None], triangles
    return b"relief of the session stroke, in mm".ljust(80) + struct.pack("<I", len(rows)) + rows.tobytes()


if __name__ == "__main__":
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else Path("relief.stl")
    target.write_bytes(stl(corners()))
    print(f"{target}: {len(corners())} triangles")
