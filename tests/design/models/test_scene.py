"""Scenes: signed distances and their tangent planes, the energy at the start, and what is refused."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import combinations_with_replacement, product
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.design.environments import environment_of
from manyhands.design.models.contacts import ContactPair, Contacts, Core, Surface, core_difference
from manyhands.design.models.declared import DeclaredScene
from manyhands.design.models.scene import UNTOUCHED, Body, ContactScene, Falling, Obstacle, SceneLink, ToolSphere

from ...support.scenes import random_scene

SURFACE = Surface(1000.0)
LOW, HIGH = (-1.0, -2.0, -0.5), (1.0, 2.0, 0.5)
SHAPES = {
    "spheres": ((), 1),
    "plane": (((0.1, 0.2, 0.3), (1.0, -2.0, 0.5)), -1),
    "capsule": (((-1.0, 0.0, 0.2), (0.5, 1.0, 0.0)), -1),
    "point": (((0.3, 0.0, -0.2), (0.3, 0.0, -0.2)), -1),
    "parallelogram": (((-1.0, 0.0, 0.2), (0.5, 1.0, 0.0), (0.3, -0.5, 0.1)), -1),
    "parallel axes": (((-1.0, 0.0, 0.2), (0.5, 1.0, 0.0), (0.75, 0.5, -0.1)), -1),
    "box": ((LOW, HIGH), -1),
}


def contacts_of(shape: str, reach: float = 0.0) -> Contacts:
    points, b = SHAPES[shape]
    kind = {"point": "capsule", "parallel axes": "parallelogram"}.get(shape, shape)
    return Contacts([ContactPair(("a", "b"), 0, b, SURFACE, reach, kind, points)], 2)


def distance(shape: str, u: np.ndarray, z: np.ndarray) -> float:
    """The signed distance by its definition: the nearest of many points, or the farthest of many planes."""
    if shape == "spheres":
        return float(np.linalg.norm(z[0] - z[1]))
    points = np.array(SHAPES[shape][0])
    if shape == "plane":
        return float((u - points[0]) @ points[1] / np.linalg.norm(points[1]))
    if len(points) == 3:
        return from_parallelogram(u - points[:2].mean(axis=0), (points[1] - points[0]) / 2.0, points[2])
    if shape != "box":
        along = np.linspace(0.0, 1.0, 20001)[:, None]
        return float(np.linalg.norm(u - (points[0] + along * (points[1] - points[0])), axis=1).min())
    nearest = np.clip(u, *points)
    inside = np.min([u - points[0], points[1] - u])
    return float(np.linalg.norm(u - nearest)) if inside < 0.0 else -float(inside)


def from_parallelogram(u: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
    """The distance from s a + t b, -1 <= s, t <= 1: a search by thirds over s, with the best t for each."""

    def of(s: float) -> float:
        t = np.clip((u - s * a) @ b / (b @ b), -1.0, 1.0)
        return float(np.linalg.norm(u - s * a - t * b))

    low, high = -1.0, 1.0
    for _ in range(100):
        one, two = (2.0 * low + high) / 3.0, (low + 2.0 * high) / 3.0
        low, high = (low, two) if of(one) <= of(two) else (one, high)
    return of(low)


@pytest.mark.parametrize("shape", SHAPES)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_tangent_plane_is_below_the_gap(shape: str, seed: int) -> None:
    """Convexity, on which the proof of a scene rests; and the gap is the distance less the reach."""
    rng = np.random.default_rng(seed)
    contacts = contacts_of(shape, reach=0.25)
    z, other = (rng.normal(size=(2, 3)) * 10.0 ** rng.uniform(-2.0, 0.5) for _ in range(2))
    gap, gradient = contacts.gaps(z)
    assert gap[0] + 0.25 == pytest.approx(distance(shape, z[0], z), abs=1e-7)
    assert np.linalg.norm(gradient[0]) == pytest.approx(1.0, abs=1e-12)
    moved = contacts.incidence @ (other - z)
    assert contacts.gaps(other)[0][0] >= gap[0] + float(gradient[0] @ moved[0]) - 1e-12
    step = 1e-6 * rng.normal(size=(2, 3))
    there = contacts.gaps(z + step)[0][0]
    assert there - gap[0] == pytest.approx(float(gradient[0] @ (contacts.incidence @ step)[0]), abs=1e-8)


EXTENT = {
    "point": Core("segment", ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))),
    "rod": Core("segment", ((0.0, 0.3, 0.0), (0.0, -0.3, 0.0))),
    "slanted rod": Core("segment", ((0.2, -0.3, -0.1), (-0.2, 0.3, 0.1))),
    "other rod": Core("segment", ((-0.1, -0.3, -0.4), (0.1, 0.3, 0.4))),
    "crate": Core("box", ((-0.2, -0.1, -0.3), (0.2, 0.1, 0.3))),
    "plate": Core("box", ((-0.4, -0.4, -0.05), (0.4, 0.4, 0.05))),
}


def vertices(core: Core) -> np.ndarray:
    ends = np.array(core.ends)
    return np.array([*product(*ends.T)]) if core.kind == "box" else ends


@pytest.mark.parametrize(("one", "other"), [*combinations_with_replacement(EXTENT, 2)])
@given(seed=st.integers(0, 2**32 - 1))
def test_the_gap_of_two_things_is_the_widest_slab_between_them(one: str, other: str, seed: int) -> None:
    """By the definition of a signed distance: no direction has more room, and the gradient has as much."""
    rng, a, b = np.random.default_rng(seed), EXTENT[one], EXTENT[other]
    offset = rng.normal(size=3) * rng.choice([0.0, 0.5])  # of an obstacle, which is not about the origin
    low, high = (tuple((np.array(end) + offset).tolist()) for end in b.ends)
    known = core_difference(a, Core(b.kind, (low, high)))
    refused = {one, other} & {"slanted rod", "other rod"} and {one, other} & {"crate", "plate"}
    assert (known is None) == bool(refused)
    if known is None:
        return
    z = rng.normal(size=(2, 3)) * 10.0 ** rng.uniform(-2.0, 0.0)
    (gap,), (n,) = Contacts([ContactPair(("a", "b"), 0, 1, SURFACE, 0.0, *known)], 2).gaps(z)

    def room(directions: np.ndarray) -> np.ndarray:
        ours, theirs = vertices(a) + z[0], vertices(b) + offset + z[1]
        return np.asarray((directions @ ours.T).min(axis=1) - (directions @ theirs.T).max(axis=1))

    directions = rng.normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    assert room(directions).max() <= gap + 1e-12
    assert room(n[None])[0] == pytest.approx(gap, abs=1e-9)
    assert a.support(tuple(n)) == pytest.approx((vertices(a) @ n).max(), abs=1e-12)


@pytest.mark.parametrize(("shape", "at"), [("spheres", (0.3, 0, -0.2)), ("capsule", (-1, 0, 0.2)), ("box", (0, 0, 0))])
def test_a_centre_has_a_gradient(shape: str, at: tuple[float, ...]) -> None:
    """Where the distance has a corner, one of its tangent planes is taken."""
    contacts, z = contacts_of(shape), np.array([at, at])
    gap, gradient = contacts.gaps(z)
    assert gap[0] == pytest.approx(-0.5 if shape == "box" else 0.0)
    assert np.linalg.norm(gradient[0]) == pytest.approx(1.0)
    for step in np.random.default_rng(1).normal(size=(20, 2, 3)):
        assert contacts.gaps(z + step)[0][0] >= gap[0] + float(gradient[0] @ (contacts.incidence @ step)[0]) - 1e-12


@given(seed=st.integers(0, 2**32 - 1))
def test_a_scene_is_read_as_it_was_written(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, int(rng.integers(1, 4)), int(rng.integers(0, 4)), int(rng.integers(1, 4)))
    motion = ("0.1*t", 0.0, {"times": [0.0, 1.0], "values": [0.0, 0.2]})
    driven = Body("driven", 0.0, (0.0, 0.0, 0.0), 0.01, motion=motion)
    scene = replace(scene, bodies=(*scene.bodies, driven), tank=2.0)
    again = environment_of(DeclaredScene(scene).terms(), scene.ports)
    assert again == DeclaredScene(scene)
    assert isinstance(again, DeclaredScene)
    assert again.scene.energy_at_start == pytest.approx(scene.energy_at_start, abs=1e-12)
    assert scene != replace(scene, surface=Surface(scene.surface.stiffness, 0.1, 0.2))


BALL = Body("ball", 0.5, (0.0, 0.0, 0.3), 0.05)
CRATE = Body("crate", 0.5, (0.0, 0.0, 0.3), 0.0, "box", (0.1, 0.1, 0.05))
G = (0.0, 0.0, -9.81)
FLOOR = Obstacle("floor", "wall", ((1.0, 1.0, 0.1), (0.0, 0.0, 2.0)))
ROOM = Obstacle("room", "room", ((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0)))
SPRING = SceneLink(("ball", "ground"), 200.0, 0.0)


def scene_of(**parts: Any) -> ContactScene:
    given_parts: dict[str, Any] = {"tools": (ToolSphere("p", (0,), (0,), (0.0, 0.0, 0.0)),), "surface": SURFACE}
    return ContactScene(("p",), **{**given_parts, **parts})


def test_driven_bodies_touch_what_can_give_way() -> None:
    driven = replace(BALL, mass=0.0, motion=("0.1*t", 0.0, 0.0))
    scene = scene_of(
        bodies=(BALL, replace(driven, name="one"), replace(driven, name="two")), obstacles=(ROOM,), tank=3.0
    )
    assert {pair.names for pair in scene.pairs()} == {
        *(("p", name) for name in ("ball", "one", "two", "room")),
        *(("ball", name) for name in ("one", "two", "room")),
    }
    overlapping = 2 * 500.0 * 0.1**2  # the ball and each driven one are in one place
    assert scene.energy_at_start == pytest.approx(3.0 + overlapping)
    assert scene.geometry.terms()["bodies"]["one"]["motion"] == [0.0, 0.0, 0.0]


def test_the_energy_at_the_start() -> None:
    weight = 0.5 * 9.81
    sunk = weight**2 / (2 * 1000.0)
    assert scene_of(bodies=(BALL,)).energy_at_start == 0.0
    apart = ((("p", "floor"), Surface(0.0)),)  # the tool is below the floor
    on_floor = scene_of(bodies=(BALL,), obstacles=(FLOOR,), gravity=G, surfaces=apart)
    assert on_floor.energy_at_start == pytest.approx(weight * 0.15 + sunk)
    flat = replace(BALL, shape="capsule", half=(0.2, 0.3, 0.0), name="flat")
    no_gap = ((("crate", "flat"), Surface(0.0)),)
    lying = scene_of(bodies=(CRATE, flat), obstacles=(FLOOR,), gravity=G, surfaces=apart + no_gap)
    assert lying.energy_at_start == pytest.approx(2 * (weight * 0.15 + sunk))
    in_room = scene_of(bodies=(BALL,), obstacles=(ROOM,), gravity=(3.0, -9.0, 0.0))
    expected = 0.5 * (3.0 + 9.0) * 0.95 + (1.5**2 + 4.5**2) / 2000.0
    assert in_room.energy_at_start == pytest.approx(expected)
    assert scene_of(bodies=(BALL,), links=(SPRING,), gravity=G).energy_at_start == pytest.approx(weight**2 / 400.0)
    strained = SceneLink(("p", "ball"), 100.0, 0.0, (0.0, 0.0, 0.0))
    assert scene_of(bodies=(BALL,), links=(strained,)).energy_at_start == pytest.approx(50.0 * 0.09)
    overlapping = Body("ball", 0.5, (0.0, 0.0, 0.04), 0.05)
    assert scene_of(bodies=(overlapping,)).energy_at_start == pytest.approx(500.0 * 0.01**2)


@given(seed=st.integers(0, 2**32 - 1))
def test_no_position_has_less_energy_than_the_lowest(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, y, z = rng.normal(size=3).tolist()
    held = rng.integers(0, 3)
    obstacles = ((ROOM,), (Obstacle("w", "wall", ((x, y, z), (-x, -y, -z))),), ())[held]
    scene = scene_of(
        bodies=(BALL,), obstacles=obstacles, gravity=(x, y, z), links=(SPRING,) if held == 2 else (), surface=SURFACE
    )
    lowest = scene.lowest_energy(BALL)
    for at in rng.normal(size=(50, 3)):
        q = np.array(at)
        energy = scene.contacts.energy(np.array([[100.0, 0.0, 0.0], q])) - 0.5 * float(q @ [x, y, z])
        if held == 2:
            energy += 100.0 * float((q - BALL.at) @ (q - BALL.at))
        elif held == 0:  # the tool is outside of the room
            energy -= scene.contacts.energy(np.array([[100.0, 0.0, 0.0], [0.0, 0.0, 0.0]]))
        else:
            energy -= scene.contacts.energy(np.array([[100.0, 0.0, 0.0], 1e3 * -np.array([x, y, z])]))
        assert energy >= lowest - 1e-9


def test_a_wall_holds_a_body_against_an_oblique_gravity() -> None:
    """200 walls whose normals are multiples of minus gravity as decimals, and the same with one last digit changed."""
    rng = np.random.default_rng(7)
    for pair in range(200):
        digits = rng.integers(-99, 100, 3)
        digits[0] = digits[0] or 1
        factor = int(rng.integers(1, 30)) if pair else 1
        gravity = (3.6, 2.7, -5.6) if pair == 0 else tuple(float(f"{d}e-1") for d in digits.tolist())
        normal = tuple(float(f"{round(-10.0 * g) * factor}e-{pair % 3}") for g in gravity)
        wall = Obstacle("floor", "wall", ((0.0, 0.0, 0.0), normal))
        apart = ((("p", "floor"), Surface(0.0)),)
        scene = scene_of(bodies=(BALL,), obstacles=(wall,), gravity=gravity, surfaces=apart)
        weight = 0.5 * math.hypot(*gravity)
        sunk = weight**2 / (2.0 * SURFACE.stiffness)
        assert scene.lowest_energy(BALL) == pytest.approx(weight * BALL.radius - sunk, rel=1e-12)
        turned = (normal[0], normal[1] + 1e-13 * (abs(normal[1]) + 1.0), normal[2])
        with pytest.raises(Falling):
            scene_of(bodies=(BALL,), obstacles=(replace(wall, points=((0.0, 0.0, 0.0), turned)),), gravity=gravity)


def test_a_wall_that_is_nearly_against_gravity_is_named() -> None:
    """A normal that was rounded: the body would slide off, and the error says by how much, and what to write."""
    gravity = (0.0, 9.81 * math.sin(0.3), -9.81 * math.cos(0.3))
    wall = Obstacle("ramp", "wall", ((0.0, 0.0, 0.0), (0.0, round(-math.sin(0.3), 6), round(math.cos(0.3), 6))))
    with pytest.raises(Falling) as error:
        scene_of(bodies=(BALL,), obstacles=(wall,), gravity=gravity)
    x, y, z = (0.0 - g for g in gravity)
    assert f"the wall ramp with the normal [{x!r}, {y!r}, {z!r}], exactly against gravity" in str(error.value)
    scene_of(bodies=(BALL,), obstacles=(replace(wall, points=((0.0, 0.0, 0.0), (x, y, z))),), gravity=gravity)


@pytest.mark.parametrize(
    "parts",
    [
        {},
        {"obstacles": (replace(FLOOR, points=((0.0, 0.0, 0.0), (0.0, 1e-9, 1.0))),)},
        {"obstacles": (replace(FLOOR, points=((0.0, 0.0, 0.0), (0.0, 0.0, -1.0))),)},
        {"obstacles": (Obstacle("block", "box", ((-1.0, -1.0, -1.0), (1.0, 1.0, 0.0))),)},
        {"obstacles": (FLOOR,), "surfaces": ((("ball", "floor"), Surface(0.0)),)},
        {"links": (SceneLink(("ball", "ground"), 0.0, 1.0),)},
        {"links": (SceneLink(("ball", "p"), 100.0, 1.0),)},
    ],
)
def test_a_body_that_would_fall_for_good_is_refused(parts: dict[str, Any]) -> None:
    with pytest.raises(Falling, match="body ball: found gravity, and nothing that holds the body"):
        scene_of(bodies=(BALL,), gravity=G, **parts)


MESH = Obstacle(
    "o",
    "mesh",
    ((0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.0, 0.1, 0.0), (0.0, 0.0, 0.1)),
    triangles=((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)),
)


@pytest.mark.parametrize(
    ("parts", "error"),
    [
        ({"bodies": (BALL, BALL)}, "expected distinct ones"),
        ({"bodies": (replace(BALL, name="ground"),)}, "expected distinct ones"),
        ({"bodies": (replace(BALL, mass=0.0),)}, "masses"),
        ({"bodies": (replace(BALL, radius=-0.1),)}, "radius"),
        ({"bodies": (replace(BALL, shape="cone"),)}, "body ball: found the shape 'cone'"),
        ({"bodies": (replace(BALL, shape="box"),)}, "body ball: found the shape 'box'"),
        ({"bodies": (replace(BALL, half=(0.1, 0.0, 0.0)),)}, "body ball: found the shape 'sphere'"),
        (
            {"bodies": (CRATE, replace(BALL, shape="capsule", half=(0.1, 0.1, 0.0)))},
            "body crate: found a box that may touch a capsule along no",
        ),
        ({"bodies": (replace(BALL, motion=(0.0, 0.0, 0.0)),)}, "a mass or 3 motions"),
        ({"bodies": (replace(BALL, mass=0.0, motion=(0.0, 0.0)),)}, "a mass or 2 motions"),
        (
            {"bodies": (replace(BALL, mass=0.0, motion=({"times": [0.0] * 10001, "values": []}, 0.0, 0.0)),)},
            "a motion of 10001 samples",
        ),
        ({"tank": -1.0}, "a tank of -1.0 J"),
        ({"bodies": (replace(BALL, at=(0.0, float("nan"), 0.0)),)}, "finite coordinates"),
        ({"bodies": tuple(replace(BALL, name=f"b{i}") for i in range(32))}, "at most 32"),
        ({"surface": Surface(2e6)}, "at most 1e"),
        ({"surface": Surface(1.0, -1.0)}, ">= 0"),
        ({"tools": ()}, "every port at one tool"),
        ({"tools": (ToolSphere("p", (0,), (3,), (0.0, 0.0, 0.0)),)}, "axes"),
        ({"obstacles": (Obstacle("o", "cone", ()),)}, "shape 'cone'"),
        ({"obstacles": (Obstacle("o", "box", (HIGH, LOW)),)}, "'low' below 'high'"),
        ({"obstacles": (Obstacle("o", "wall", (LOW, (0.0, 0.0, 0.0))),)}, "normal"),
        ({"obstacles": (replace(FLOOR, triangles=MESH.triangles),)}, "shape 'wall' with 2 points and 4 triangles"),
        ({"obstacles": (MESH,)}, "contact with a mesh, which is not convex"),
        ({"surface": UNTOUCHED, "obstacles": (replace(MESH, triangles=()),)}, "0 triangles in all; expected 1 to 2000"),
        (
            {"surface": UNTOUCHED, "obstacles": (replace(MESH, triangles=MESH.triangles * 501),)},
            "2004 triangles in all",
        ),
        (
            {"surface": UNTOUCHED, "obstacles": (MESH, replace(MESH, name="n", triangles=MESH.triangles * 500))},
            "2004 triangles in all",
        ),
        ({"surface": UNTOUCHED, "obstacles": (replace(MESH, points=MESH.points[:3]),)}, "a triangle of no point"),
        (
            {"surface": UNTOUCHED, "obstacles": (replace(MESH, points=((float("nan"),) * 3,) * 4),)},
            "finite coordinates",
        ),
        ({"links": (SceneLink(("p", "q"), 1.0, 0.0),)}, "link between"),
        ({"surfaces": ((("p", "p"), SURFACE),)}, "contact between"),
    ],
)
def test_what_makes_no_scene(parts: dict[str, Any], error: str) -> None:
    with pytest.raises(ValueError, match=error):
        scene_of(**parts)


def test_linked_and_excepted_things_touch_as_stated() -> None:
    scene = scene_of(
        bodies=(BALL, replace(BALL, name="other")),
        obstacles=(ROOM,),
        links=(SceneLink(("p", "ball"), 1.0, 0.0),),
        surfaces=((("other", "room"), Surface(0.0)), (("other", "ball"), Surface(7.0, 1.0, 0.5))),
    )
    assert [(pair.names, pair.surface.stiffness) for pair in scene.pairs() if pair.kind == "spheres"] == [
        (("p", "other"), 1000.0),
        (("ball", "other"), 7.0),
    ]
    assert {pair.names for pair in scene.pairs() if pair.kind == "plane"} == {("p", "room"), ("ball", "room")}
