"""Distance grids: how exact they are, their text, and what is refused."""

from __future__ import annotations

import base64
import json
import zlib
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.design.models.distance_grid import FORMAT, MOST_NODES, DistanceGrid, grid_of_mesh, grid_of_text
from manyhands.design.models.triangle_mesh import MeshError
from manyhands.nodes.environment.mesh import Lookup

from ...support.cases import EXAMPLES, WIDE_EXAMPLES, cases
from ...support.meshes import CELL, exact_distances, grid, shape

ROUNDING = CELL / 2000  # of a kept distance


@settings(max_examples=cases(EXAMPLES, 5 * WIDE_EXAMPLES), deadline=None)
@given(name=st.sampled_from(["box", "ball", "torus", "star"]), place=st.tuples(*[st.floats(-1.0, 1.0)] * 3))
def test_the_distance_between_nodes_is_within_its_bound(name: str, place: tuple[float, float, float]) -> None:
    """sqrt(3)/2 cells from the exact distance, wherever that is within the band."""
    made = grid(name)
    low, high = shape(name).bounds
    x, y, z = (low + high) / 2.0 + 0.65 * (high - low) * place
    exact = float(np.clip(exact_distances(shape(name), np.array([[x, y, z]])), -4 * CELL, 4 * CELL)[0])
    assert abs(Lookup(made)((x, y, z))[0] - exact) <= 3**0.5 / 2 * CELL + ROUNDING


def test_on_a_smooth_surface_the_error_is_of_second_order() -> None:
    """On a ball of radius R at most 3/8 cell^2/(R - cell), and the facets' height."""
    rng = np.random.default_rng(1)
    places = rng.normal(size=(300, 3))
    places *= (0.02 + rng.uniform(-CELL, CELL, (300, 1))) / np.linalg.norm(places, axis=1)[:, None]
    lookup = Lookup(grid("ball"))
    found = np.array([lookup((x, y, z)) for x, y, z in places.tolist()])
    facets = 0.02 - np.linalg.norm(shape("ball").vertices[shape("ball").triangles].mean(axis=1), axis=1).min()
    error = np.abs(found[:, 0] - (np.linalg.norm(places, axis=1) - 0.02))
    assert error.max() <= 3 / 8 * CELL**2 / (0.02 - CELL) + facets + ROUNDING
    directions = places / np.linalg.norm(places, axis=1)[:, None]
    gradients = found[:, 1:] / np.linalg.norm(found[:, 1:], axis=1)[:, None]
    assert (gradients * directions).sum(axis=1).min() > 0.99


def test_beyond_the_grid_the_way_to_it_counts() -> None:
    lookup = Lookup(grid("box"))
    assert lookup((0.0, 0.5, 0.0))[0] > 0.45
    assert lookup((0.3, -0.4, 0.0))[0] == pytest.approx(4 * CELL + np.hypot(0.272, 0.377), abs=2 * CELL)


def test_the_text_holds_every_number() -> None:
    made = grid("star")
    found = grid_of_text(made.text)
    np.testing.assert_array_equal(found.distances, made.distances)
    np.testing.assert_array_equal(found.surface.vertices, made.surface.vertices)
    np.testing.assert_array_equal(found.surface.triangles, made.surface.triangles)
    assert (found.origin, found.cell, found.band) == (made.origin, made.cell, made.band)
    assert found.text == made.text
    assert max(map(len, made.text.splitlines())) <= 150


def test_the_digest_is_of_the_numbers_and_not_of_their_packing() -> None:
    made = grid("box")
    first, head, *lines = made.text.splitlines()
    again = zlib.compress(zlib.decompress(base64.b64decode("".join(lines))), 1)
    other = grid_of_text("\n".join([first, head, base64.b64encode(again).decode()]))
    assert other.digest == made.digest
    changed = made.distances.copy()
    changed[3, 3, 3] -= CELL / 1000
    assert DistanceGrid(made.origin, made.cell, made.band, changed, made.surface).digest != made.digest
    assert DistanceGrid((0.0, 0.0, 0.0), made.cell, made.band, made.distances, made.surface).digest != made.digest


def test_a_cell_decides_how_large_a_tool_may_be() -> None:
    grid = grid_of_mesh(shape("box"), 0.004, 8)
    assert grid.largest_radius == pytest.approx(0.024)
    assert [grid.band_for(radius) for radius in (0.004, 0.0041, 0.024)] == [3, 4, 8]


def altered(**entries: Any) -> str:
    first, head, data = grid("box").text.split("\n", 2)
    return "\n".join([first, json.dumps({**json.loads(head), **entries}), data])


def packed(numbers: bytes) -> str:
    first, head, _ = grid("box").text.split("\n", 2)
    return "\n".join([first, head, base64.b64encode(zlib.compress(numbers)).decode()])


NUMBERS = zlib.decompress(base64.b64decode("".join(grid("box").text.split("\n")[2:])))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "found the first line ''; expected 'manyhands distance grid 1'"),
        ("solid box\n{}\n", "found the first line 'solid box'"),
        (FORMAT, "damaged"),
        (FORMAT + "\n[]\n", "expected the keys band, cell"),
        (FORMAT + "\n" + "[" * 100_000 + "\n", "damaged"),
        (altered(more=1), "expected the keys"),
        (altered(cell="x"), "damaged"),
        (altered(cell=float("nan")), "cells of 1e-05 to 1 m"),
        (altered(cell=1e-9), "cells of 1e-05 to 1 m"),
        (altered(origin=[0, 0, 1e9]), "origin within 1000 m"),
        (altered(origin=[0, 0]), "damaged"),
        (altered(shape=[MOST_NODES, MOST_NODES, MOST_NODES]), f"at most {MOST_NODES}"),
        (altered(shape=[1, 20, 20]), "two nodes or more"),
        (altered(shape=[20, 20]), "whole numbers"),
        (altered(shape=[20.0, 20, 20]), "whole numbers"),
        (altered(shape=[20, 20, 20]), "bytes of numbers"),
        (altered(band=0), "band of 2 to 32"),
        (altered(band=True), "whole numbers"),
        (altered(triangles=10**9), "at most 2000 triangles"),
        (altered(band=2), "beyond the band"),
        (grid("box").text[:-60], "damaged"),
        (grid("box").text.replace("\n", "\n!", 3), "damaged"),
        (packed(b"\0" * 10**8), "bytes of numbers or more"),
        (packed(NUMBERS[:-1]), "bytes of numbers"),
        (packed(NUMBERS[:-2] + b"\xff\xff"), "triangle of no vertex"),
        (packed(b"\xff\x7f" * (len(NUMBERS) // 2)), "beyond the band"),
    ],
)
def test_a_damaged_text_is_refused(text: str, said: str) -> None:
    with pytest.raises(ValueError, match=said) as caught:
        grid_of_text(text)
    assert "expected" in str(caught.value)
    assert len(str(caught.value)) < 300


@settings(max_examples=cases(EXAMPLES, 10 * WIDE_EXAMPLES), deadline=None)
@given(at=st.integers(0, 10**6), letter=st.characters(codec="ascii"))
def test_a_text_with_one_character_changed_is_a_grid_or_refused(at: int, letter: str) -> None:
    text = grid("box").text
    at %= len(text)
    with suppress(ValueError):
        made = grid_of_text(text[:at] + letter + text[at + 1 :])
        assert np.isfinite(made.distances).all()
        assert made.distances.size <= MOST_NODES


@pytest.mark.parametrize(
    ("cell", "band", "said"),
    [
        (1e-4, 4, "nodes with cells of 0.0001 m; expected at most 1048576, which takes cells of about"),
        (1e-5, 32, "expected at most 1048576"),
        (float("nan"), 4, "expected 1e-05 to 1 m"),
        (0.0, 4, "expected 1e-05 to 1 m"),
        (CELL, 1, "2 to 32 cells"),
        (CELL, 33, "2 to 32 cells"),
    ],
)
def test_a_grid_that_is_too_large(cell: float, band: int, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        grid_of_mesh(shape("box"), cell, band)


def test_a_mesh_in_a_wrong_unit() -> None:
    mesh = shape("box")
    with pytest.raises(MeshError, match="beyond 1000 m; expected it nearer: state the unit"):
        grid_of_mesh(mesh._replace(vertices=mesh.vertices * 1e6), 1.0)
