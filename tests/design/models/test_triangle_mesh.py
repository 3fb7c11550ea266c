"""Solids of triangles: what is one, and signed distances from it, held against other code's."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from manyhands.design.models import triangle_mesh
from manyhands.design.models.triangle_mesh import MeshError, coarsened, signed_distances, solid

from ...support.meshes import exact_distances, shape

CORNERS = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], dtype=float)
FACES = np.array([(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)])


def nodes(origin: np.ndarray, cell: float, counts: tuple[int, int, int]) -> np.ndarray:
    axes = [origin[j] + cell * np.arange(counts[j]) for j in range(3)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


def test_the_distance_from_a_box_is_its_formula() -> None:
    origin, cell, counts = np.array([-0.03, -0.025, -0.02]), 0.0021, (29, 24, 20)
    found = signed_distances(shape("box"), origin, cell, counts, 0.008)
    beyond = np.abs(nodes(origin, cell, counts)) - np.array([0.02, 0.015, 0.01])
    exact = np.linalg.norm(np.maximum(beyond, 0.0), axis=-1) + np.minimum(beyond.max(axis=-1), 0.0)
    np.testing.assert_allclose(found, np.clip(exact, -0.008, 0.008), atol=1e-15)


@pytest.mark.parametrize("name", ["torus", "star"])
def test_the_distance_is_that_of_other_code(name: str) -> None:
    """At 1200 nodes, on all of which side and distance agree with trimesh and the winding number."""
    mesh, cell, band = shape(name), 0.0043, 0.013
    low, high = mesh.bounds
    counts = tuple(int(n) for n in np.ceil((high - low + 2 * band) / cell) + 1)
    found = signed_distances(mesh, low - band, cell, counts, band)  # type: ignore[arg-type]
    rng = np.random.default_rng(0)
    chosen = rng.choice(found.size, 600, replace=False)
    points = nodes(low - band, cell, counts).reshape(-1, 3)[chosen]  # type: ignore[arg-type]
    np.testing.assert_allclose(found.ravel()[chosen], np.clip(exact_distances(mesh, points), -band, band), atol=1e-12)


def bad() -> Iterator[Any]:
    inside_out = FACES[:, ::-1]
    yield pytest.param(CORNERS, np.zeros((0, 3), dtype=int), "no triangles", id="empty")
    yield pytest.param(CORNERS[:, :2], FACES, "no triangles", id="flat coordinates")
    yield pytest.param(CORNERS, FACES[:3], "3 edges with one triangle alone", id="open")
    yield pytest.param(CORNERS, inside_out, "face inwards", id="inwards")
    yield pytest.param(CORNERS, [*FACES[:3], FACES[3][::-1]], "face opposite ways", id="one turned")
    yield pytest.param(CORNERS, [*FACES, FACES[0]], "more than two meet", id="doubled")
    yield pytest.param(np.where(CORNERS == 1.0, np.nan, 0.0), FACES, "not finite", id="nan")
    yield pytest.param(CORNERS, FACES + 1, "does not exist", id="no vertex")
    yield pytest.param(CORNERS, FACES - 1, "does not exist", id="below 0")
    yield pytest.param(np.zeros((4, 3)), FACES, "without any area", id="a point")
    yield pytest.param([*CORNERS[:3], (0.5, 0.0, 0.0)], FACES, "1 triangles without area", id="on a line")


@pytest.mark.parametrize(("vertices", "triangles", "said"), [*bad()])
def test_what_is_no_solid(vertices: Any, triangles: Any, said: str) -> None:
    with pytest.raises(MeshError, match=said) as caught:
        solid(vertices, triangles)
    assert "; expected " in str(caught.value) or ": expected" in str(caught.value)


def test_too_many_triangles(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(triangle_mesh, "MOST_TRIANGLES", 3)
    with pytest.raises(MeshError, match="4 triangles; expected at most 3"):
        solid(CORNERS, FACES)


def test_triangles_of_their_own_corners_become_one_surface() -> None:
    """As in an STL file, with one triangle more that has no area because two corners are the same."""
    soup = np.concatenate([CORNERS[FACES].reshape(-1, 3), CORNERS[[0, 0, 1]]])
    mesh = solid(soup, np.arange(15).reshape(-1, 3))
    assert (len(mesh.vertices), len(mesh.triangles)) == (4, 4)


@pytest.mark.parametrize("turned", [False, True])
def test_parts_that_cross_are_refused(turned: bool) -> None:
    other = CORNERS * 0.5 + np.array([3.0, 0.0, 0.0]) if turned else CORNERS + np.array([0.2, 0.1, 0.1])
    faces = FACES[:, ::-1] if turned else FACES
    mesh = solid([*CORNERS, *other], [*FACES, *(faces + 4)])
    low, high = mesh.bounds
    counts = tuple(int(n) for n in np.ceil((high - low + 0.4) / 0.05) + 1)
    with pytest.raises(MeshError, match="crosses itself, or a part of it that faces inwards"):
        signed_distances(mesh, low - 0.2, 0.05, counts, 0.2)  # type: ignore[arg-type]


def test_a_cavity_is_outside() -> None:
    """A part that faces inwards within one that faces outwards is a hollow."""
    inner = CORNERS * 0.4 + 0.1
    mesh = solid([*CORNERS, *inner], [*FACES, *(FACES[:, ::-1] + 4)])
    found = signed_distances(mesh, np.full(3, -0.2), 0.05, (29, 29, 29), 0.2)
    assert found[8, 8, 8] > 0.0  # (0.2, 0.2, 0.2)
    assert found[5, 5, 5] < 0.0


def test_a_coarsened_mesh_looks_alike() -> None:
    mesh = shape("torus")
    small = coarsened(mesh, 100)
    assert 20 < len(small.triangles) <= 100
    assert len(np.unique(small.triangles)) == len(small.vertices)
    assert np.abs(exact_distances(mesh, small.vertices)).max() < 0.005
    same = coarsened(mesh, len(mesh.triangles))
    np.testing.assert_array_equal(same.vertices[same.triangles], mesh.vertices[mesh.triangles])
