"""A scene in three dimensions: the messages that a 3-D panel draws, in a recording and by their published form."""

from __future__ import annotations

import inspect
import json
import math
from collections.abc import Iterator
from dataclasses import replace
from io import BytesIO
from typing import Any

import jsonschema
import numpy as np
import pytest
from mcap.reader import make_reader

from manyhands.design.models.contacts import Surface, coordinates
from manyhands.design.models.scene import (
    MOST_OBSTACLES,
    MOST_POINTS,
    UNTOUCHED,
    Body,
    ContactScene,
    Obstacle,
    SceneLink,
    ToolSphere,
)
from manyhands.nodes.recorder.core import RecorderCore
from manyhands.nodes.recorder.format import Recorded
from manyhands.nodes.recorder.scene_messages import DRAWN_RADIUS, POSE_SCHEMA, SCENE_SCHEMAS, SceneMessages
from manyhands.protocol.codec import encode
from manyhands.protocol.messages import Figures, Observation, Role

WHOLE = ContactScene(
    ("b", "a.y", "a.x"),  # not in the order of the environment's columns
    tools=(ToolSphere("a", (2, 1), (0, 1), (0.1, 0.2, 0.3), 0.01), ToolSphere("b", (0,), (2,), (0.0, 0.0, 0.1))),
    bodies=(Body("ball", 0.2, (0.0, 0.05, 0.0), 0.04),),
    obstacles=(
        Obstacle("slope", "wall", ((0.0, -0.1, 0.0), (1.0, 2.0, -2.0))),
        Obstacle("room", "room", ((-0.5, -0.4, -0.3), (0.5, 0.4, 0.3))),
        Obstacle("block", "box", ((0.2, 0.0, 0.0), (0.3, 0.2, 0.4))),
        Obstacle("knob", "sphere", ((0.0, 0.3, 0.0),), 0.02),
        Obstacle("bar", "capsule", ((0.1, 0.0, 0.0), (0.1, 0.3, -0.4)), 0.03),
        Obstacle("pin", "capsule", ((0.2, 0.0, 0.0), (0.2, 0.0, -0.1)), 0.01),
        Obstacle("dot", "capsule", ((0.2, 0.0, 0.0), (0.2, 0.0, 0.0)), 0.01),
    ),
    links=(SceneLink(("ball", "ground"), 100.0, 0.1),),
    surface=Surface(1000.0),
    gravity=(0.0, -9.81, 0.0),
)
MESH = Obstacle(
    "wedge",
    "mesh",
    ((0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.0, 0.1, 0.0), (0.0, 0.0, 0.1)),
    triangles=((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)),
)
RECORDED = Recorded(
    "s",
    "id",
    0.001,
    "simulated",
    {"a": Role.DEVICE, "b": Role.DEVICE, "c": Role.COUPLING, "environment": Role.ENVIRONMENT},
    {"a": ("a.x", "a.y"), "b": ("b",), "c": ("a.x", "a.y", "b"), "environment": ("a.x", "a.y", "b")},
    ("ball.x", "ball.y", "ball.z"),
    scene=replace(WHOLE.geometry, obstacles=(*WHOLE.obstacles, MESH), surface=UNTOUCHED, surfaces=()),
)
START = 1_700_000_000_123_456_789
TICKS = 1230
X_E, Q = (np.random.default_rng(5).normal(scale=0.05, size=(TICKS, 3)) for _ in range(2))


def observed(begin: int, end: int, x_e: Any = X_E, q: Any = Q) -> bytes:
    return encode(Observation("environment", end, Figures(), {"x_e": x_e[begin:end], "q": q[begin:end]}))


def recorded(recorded: Recorded = RECORDED, x_e: Any = X_E) -> list[tuple[Any, Any, Any]]:
    """Schema, channel and message of what shows the scene, as the package ``mcap`` reads them."""
    core, ends = RecorderCore(recorded), [100, 149, 151, 800, TICKS]
    for begin, end in zip([0, *ends], ends, strict=False):
        core.take(observed(begin, end, x_e), START + ends[0] * 1_000_000)
    assert core.refused == 0
    found = make_reader(BytesIO(core.cut() + core.end()), validate_crcs=True).iter_messages()
    return [one for one in found if one[1].topic.rpartition("/")[2] in SCENE_SCHEMAS]


def sent(topic: str, x_e: Any = X_E) -> list[tuple[int, dict[str, Any]]]:
    """Time and content of the messages of a topic."""
    name = f"/s/environment/{topic}"
    return [(m.log_time, json.loads(m.data)) for _, channel, m in recorded(x_e=x_e) if channel.topic == name]


def nanoseconds(stamp: dict[str, int]) -> int:
    return stamp["sec"] * 10**9 + stamp["nsec"]


def xyz(vector: dict[str, float]) -> list[float]:
    return [vector[axis] for axis in "xyz"]


def rotated(quaternion: dict[str, float], vector: Any) -> np.ndarray:
    """A vector turned by a unit quaternion, v + 2 u x (u x v + w v)."""
    u, w, v = np.array(xyz(quaternion)), quaternion["w"], np.array(vector)
    assert np.linalg.norm([*u, w]) == pytest.approx(1.0)
    return np.asarray(v + 2.0 * np.cross(u, np.cross(u, v) + w * v))


def entities() -> dict[str, dict[str, Any]]:
    return {entity["id"]: entity for entity in sent("scene")[0][1]["entities"]}


def test_positions_are_the_places_and_the_displacements() -> None:
    found = sent("transforms")
    assert [time - START for time, _ in found] == [k * 1_000_000 for k in range(0, TICKS, 50)]  # 20 a second
    for number, (time, update) in enumerate(found):
        at = {one["child_frame_id"]: one for one in update["transforms"]}
        assert all(nanoseconds(one["timestamp"]) == time for one in at.values())
        assert {one["parent_frame_id"] for one in at.values()} == {"s"}
        x_e, q = X_E[50 * number], Q[50 * number]
        expected = {
            "s/a": [0.1 + x_e[0], 0.2 + x_e[1], 0.3],
            "s/b": [0.0, 0.0, 0.1 + x_e[2]],
            "s/ball": [0.0 + q[0], 0.05 + q[1], 0.0 + q[2]],
        }
        assert {name: xyz(one["translation"]) for name, one in at.items()} == expected


def test_shapes_come_once_a_second_each_in_its_frame() -> None:
    assert [time - START for time, _ in sent("scene")] == [0, 1_000_000_000]
    found = entities()
    assert [*found] == ["a", "b", "ball", "slope", "room", "block", "knob", "bar", "pin", "dot", "wedge"]
    assert all(one["frame_id"] == (f"s/{name}" if name in ("a", "b", "ball") else "s") for name, one in found.items())
    assert all(one["frame_locked"] for one in found.values())
    radii = {name: one["spheres"][0]["size"]["x"] / 2 for name, one in found.items() if name in ("a", "b", "ball")}
    assert radii == {"a": 0.01, "b": DRAWN_RADIUS, "ball": 0.04}


def test_boxes_and_rooms_reach_from_corner_to_corner() -> None:
    for obstacle in WHOLE.obstacles[1:3]:
        (cube,) = entities()[obstacle.name]["cubes"]
        at, half = np.array(xyz(cube["pose"]["position"])), np.array(xyz(cube["size"])) / 2
        assert [*(at - half), *(at + half)] == pytest.approx([*obstacle.points[0], *obstacle.points[1]])
        assert cube["pose"]["orientation"] == {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
    assert entities()["room"]["cubes"][0]["color"]["a"] < 0.5  # what is inside can be seen


def test_the_surface_of_a_wall_is_its_plane() -> None:
    (cube,) = entities()["slope"]["cubes"]
    n = np.array(WHOLE.obstacles[0].points[1]) / 3.0
    assert rotated(cube["pose"]["orientation"], [0, 0, 1]) == pytest.approx(n)
    face = np.array(xyz(cube["pose"]["position"])) + cube["size"]["z"] / 2 * n
    assert float(n @ (face - np.array(WHOLE.obstacles[0].points[0]))) == pytest.approx(0.0, abs=1e-15)
    low, high = WHOLE.bounds
    assert math.dist(face, (low + high) / 2) < cube["size"]["x"] / 2  # it is where the scene is
    assert cube["size"]["x"] == cube["size"]["y"] > math.dist(low, high)


def test_a_capsule_is_a_cylinder_between_two_spheres() -> None:
    for name in ("bar", "pin", "dot"):
        shape, obstacle = entities()[name], next(one for one in WHOLE.obstacles if one.name == name)
        assert {(*xyz(sphere["pose"]["position"]),) for sphere in shape["spheres"]} == {*obstacle.points}
        if name == "dot":
            assert (len(shape["spheres"]), shape["cylinders"]) == (1, [])
            continue
        (cylinder,) = shape["cylinders"]
        half = rotated(cylinder["pose"]["orientation"], [0, 0, cylinder["size"]["z"] / 2])
        middle = np.array(xyz(cylinder["pose"]["position"]))
        assert [*(middle - half), *(middle + half)] == pytest.approx([*obstacle.points[0], *obstacle.points[1]])
        assert cylinder["size"]["x"] == cylinder["size"]["y"] == 2 * obstacle.radius
    (knob,) = entities()["knob"]["spheres"]
    assert (xyz(knob["pose"]["position"]), knob["size"]["z"]) == ([0.0, 0.3, 0.0], 0.04)


def test_a_mesh_is_a_list_of_triangles() -> None:
    (triangles,) = entities()["wedge"]["triangles"]
    assert [xyz(point) for point in triangles["points"]] == [[*point] for point in MESH.points]
    assert triangles["indices"] == [0, 2, 1, 0, 1, 3, 1, 2, 3, 0, 3, 2]
    assert xyz(triangles["pose"]["position"]) == [0.0, 0.0, 0.0]
    assert triangles["colors"] == []


def test_a_body_is_drawn_about_its_own_frame() -> None:
    bodies = (
        Body("crate", 0.2, (0.1, 0.2, 0.3), shape="box", half=(0.04, 0.02, 0.01)),
        Body("rod", 0.2, (0.0, 0.0, 0.9), 0.005, "capsule", (0.03, 0.0, 0.04)),
    )
    scene = ContactScene((), bodies=bodies)
    masses = tuple(name for body in bodies for name in coordinates(body.name))
    made = SceneMessages(scene, "s", "environment", (), masses, 1e6)
    (update,) = made.of(1, {"x_e": np.zeros((1, 0)), "q": np.zeros((1, 6))}, START, ["scene"])
    crate, rod = json.loads(update.data)["entities"]
    (cube,), (cylinder,) = crate["cubes"], rod["cylinders"]
    assert (crate["frame_id"], rod["frame_id"]) == ("s/crate", "s/rod")
    assert (xyz(cube["pose"]["position"]), xyz(cube["size"])) == ([0.0, 0.0, 0.0], [0.08, 0.04, 0.02])
    assert xyz(cylinder["size"]) == pytest.approx([0.01, 0.01, 0.1])
    assert rotated(cylinder["pose"]["orientation"], [0, 0, 0.05]) == pytest.approx([0.03, 0.0, 0.04])
    assert [xyz(end["pose"]["position"]) for end in rod["spheres"]] == [[-0.03, 0.0, -0.04], [0.03, 0.0, 0.04]]


def test_messages_agree_with_their_schemas() -> None:
    found = recorded()
    assert {schema.name for schema, _, _ in found} == {"foxglove.SceneUpdate", "foxglove.FrameTransforms"}
    for schema, channel, message in found:
        assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
        assert channel.metadata == {"node": "environment", "role": "environment"}
        stated = json.loads(schema.data)
        jsonschema.Draft202012Validator.check_schema(stated)
        jsonschema.validate(json.loads(message.data), stated)


def kinds() -> dict[str, Any]:
    """The classes that foxglove-sdk has for the parts of messages, by key. Published schemas require all keys."""
    messages = pytest.importorskip("foxglove.messages")
    return {
        "timestamp": messages.Timestamp,
        "lifetime": messages.Duration,
        "entities": messages.SceneEntity,
        "transforms": messages.FrameTransform,
        "spheres": messages.SpherePrimitive,
        "cubes": messages.CubePrimitive,
        "cylinders": messages.CylinderPrimitive,
        "triangles": messages.TriangleListPrimitive,
        "pose": messages.Pose,
        "color": messages.Color,
        **dict.fromkeys(("position", "size", "translation"), messages.Vector3),
        "points": messages.Point3,
        "colors": messages.Color,
        **dict.fromkeys(("orientation", "rotation"), messages.Quaternion),
        "foxglove.PoseInFrame": messages.PoseInFrame,
        "foxglove.SceneUpdate": messages.SceneUpdate,
        "foxglove.FrameTransforms": messages.FrameTransforms,
    }


def published(key: str, value: Any) -> Any:
    """A part of a message as foxglove-sdk's own class for it, which takes only the keys and types of its schema."""
    if isinstance(value, list):
        return [published(key, one) for one in value]
    if isinstance(value, dict):
        assert value.keys() == keys_of(key), key
        return kinds()[key](**{name: published(name, one) for name, one in value.items()})
    return value


def keys_of(key: str) -> set[str]:
    return {*inspect.signature(kinds()[key]).parameters}


def stated(key: str, schema: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """The objects in a schema, each with the key that holds it."""
    for name, own in schema.get("properties", {}).items():
        yield from stated(name, own)
    if schema["type"] == "array":
        yield from stated(key, schema["items"])
    elif schema.get("properties"):
        yield key, schema


@pytest.mark.parametrize(("name", "text"), [*SCENE_SCHEMAS.values(), POSE_SCHEMA])
def test_schemas_have_the_keys_that_foxglove_publishes(name: str, text: str) -> None:
    for key, schema in stated(name, json.loads(text)):
        expected = {"key", "value"} if key == "metadata" else keys_of(key)
        assert set(schema["properties"]) == set(schema["required"]) == expected, key


def test_messages_are_those_that_foxglove_sdk_defines() -> None:
    for schema, _, message in recorded():
        assert len(published(schema.name, json.loads(message.data)).encode()) > 100


def test_a_thing_without_a_position_is_left_out() -> None:
    lost = X_E.copy()
    lost[50, 0], lost[100, 2] = np.nan, np.inf
    found = [{one["child_frame_id"] for one in update["transforms"]} for _, update in sent("transforms", lost)[:3]]
    assert found == [{"s/a", "s/b", "s/ball"}, {"s/b", "s/ball"}, {"s/a", "s/ball"}]


@pytest.mark.parametrize(("period", "ticks"), [(0.001, 50), (0.003, 17), (0.05, 1), (0.2, 1)])
def test_a_second_has_at_most_twenty_positions(period: float, ticks: int) -> None:
    made = replace(RECORDED, period=period).scene_messages()
    assert made is not None
    traces = {"x_e": X_E[:200], "q": Q[:200]}
    assert [one.tick for one in made.of(200, traces, 0, ["transforms"])] == [*range(0, 200, ticks)]
    assert [one.tick for one in made.of(1200, traces, 0, ["scene"])] == [
        k for k in range(1000, 1200) if k % (20 * ticks) == 0
    ]


def test_what_is_not_wanted_or_not_reported_is_not_made() -> None:
    made = RECORDED.scene_messages()
    assert made is not None
    assert [*made.of(100, {"x_e": X_E[:100]}, 0)] == []  # the bodies are missing
    assert [*made.of(100, {"x_e": X_E[:100], "q": Q[:100]}, 0, [])] == []
    assert [*made.of(49, {"x_e": X_E[:48], "q": Q[:48]}, 0)] == []


def test_the_largest_scene_has_bounded_messages() -> None:
    bodies = tuple(Body(f"{i:0200}", 1.0, (-1 / 3, -2 / 3, -1 / 7), 1 / 3) for i in range(MOST_POINTS))
    ends = ((-1 / 3, -1 / 7, -2 / 3), (1 / 3, -2 / 7, 1 / 7))
    bars = tuple(Obstacle(f"o{i:0199}", "capsule", ends, 1 / 3) for i in range(MOST_OBSTACLES))
    scene = ContactScene((), bodies=bodies, obstacles=bars)
    masses = tuple(name for body in bodies for name in coordinates(body.name))
    made = SceneMessages(scene, "s" * 200, "environment", (), masses, 1e6)
    found = [*made.of(1, {"x_e": np.zeros((1, 0)), "q": np.full((1, 96), -1 / 9)}, START)]
    sizes = {one.topic: len(one.data) for one in found}
    assert sizes["scene"] < 2**17
    assert sizes["transforms"] < 2**16


def test_the_metadata_has_the_geometry_alone() -> None:
    texts = RECORDED.as_metadata()
    assert Recorded.from_metadata(texts) == RECORDED
    assert set(json.loads(texts["scene"])) == {"ports", "tools", "bodies", "obstacles", "contact", "contacts"}
    without = replace(RECORDED, scene=None)
    assert "scene" not in without.as_metadata()
    assert recorded(without) == []


def damaged() -> Iterator[Any]:
    good = WHOLE.geometry_terms()
    ball, tool = good["bodies"]["ball"], good["tools"]["b"]
    yield pytest.param({**good, "ports": ["x", "y", "z"]}, id="other ports")
    yield pytest.param({**good, "bodies": {"bull": ball}}, id="a body without a trace")
    yield pytest.param({**good, "bodies": {"ball": {**ball, "radius": 10**400}}}, id="beyond all doubles")
    yield pytest.param({**good, "bodies": {"ball": {**ball, "radius": -1.0}}}, id="a negative radius")
    yield pytest.param({**good, "obstacles": {"=1": good["obstacles"]["knob"]}}, id="a name that is a formula")
    yield pytest.param({**good, "obstacles": {"far": far(1e308)}}, id="a box that is too large")
    yield pytest.param({**good, "tools": {**good["tools"], "b": {**tool, "at": [0, 0]}}}, id="two coordinates")
    yield pytest.param({"ports": good["ports"]}, id="no things")
    yield pytest.param([], id="a list")
    yield pytest.param(None, id="null")


def far(reach: float) -> dict[str, Any]:
    return {"shape": "box", "points": [[-reach] * 3, [reach] * 3], "radius": 0.0}


@pytest.mark.filterwarnings("ignore:overflow")
@pytest.mark.parametrize("scene", [*damaged()])
def test_a_scene_that_does_not_fit_is_refused(scene: Any) -> None:
    with pytest.raises(ValueError, match=r"found (a scene|the name)"):
        Recorded.from_metadata({**RECORDED.as_metadata(), "scene": json.dumps(scene)})


def test_a_scene_in_ticks_that_are_too_short_is_refused() -> None:
    with pytest.raises(ValueError, match="found a scene of other ports"):
        Recorded.from_metadata({**RECORDED.as_metadata(), "period": "1e-320"})
