"""The messages that show an engine's world: every frame where MuJoCo has it, and solids that viewers know."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import jsonschema
import mujoco
import numpy as np
import pytest

from manyhands.design.models.contacts import coordinates
from manyhands.nodes.environment.drawing import WorldDrawing
from manyhands.nodes.environment.mujoco import MujocoEngine
from manyhands.nodes.recorder.engine_messages import EngineMessages
from manyhands.nodes.recorder.format import Recorded
from manyhands.nodes.recorder.scene_messages import SCENE_SCHEMAS
from manyhands.protocol.messages import Role

from .test_scene_messages import published

MODEL = """<mujoco><compiler angle="radian"/><option gravity="0 0 0"/>
<asset><mesh name="piece" vertex="0 0 0  0.1 0 0  0 0.1 0  0 0 0.1"/></asset><worldbody>
<geom type="plane" size="0 0.2 0.01" pos="0 0 -0.3"/><geom type="ellipsoid" size="0.01 0.02 0.03" pos="0.5 0 0"/>
<body name="arm" pos="0.1 0.2 0" euler="0.3 -0.2 0.5"><joint name="turn" type="hinge" axis="0 1 2" pos="0.02 0 -0.01"/>
  <geom type="capsule" fromto="0 0 0 0.1 0 0" size="0.01"/>
  <body name="sledge" pos="0.1 0 0" euler="0 0.4 0"><joint name="slide" type="slide" axis="1 0 1"/>
    <geom type="box" size="0.02 0.01 0.01"/>
    <body name="tip" pos="0 0.05 0"><joint name="roll" type="hinge" axis="1 0 0" pos="0 0.01 0"/>
      <geom type="cylinder" size="0.01 0.02"/><geom type="mesh" mesh="piece" contype="0" conaffinity="0"/>
    </body></body></body>
<body name="thing" pos="-0.3 0 0"><freejoint/><geom size="0.02"/></body>
</worldbody></mujoco>"""
PORTS, TICK_NS = ("d.a", "d.b", "d.c"), 1e6
MASSES = coordinates("thing")


def drawing() -> WorldDrawing:
    given = {"model": MODEL, "tools": ["turn", "slide", "roll"], "turning": ["d.a", "d.c"], "bodies": ["thing"]}
    return MujocoEngine(PORTS, 1e-3, given | {"orientations": ["thing"], "stiffness": [1.0] * 3}).drawing()


def traces(seed: int, ticks: int = 120) -> dict[str, np.ndarray]:
    random = np.random.default_rng(seed)
    R = random.normal(size=(ticks, 4))
    return {
        "x_e": random.normal(size=(ticks, 3)),
        "q": random.normal(size=(ticks, 3)),
        "R": R / np.linalg.norm(R, axis=1)[:, None],
    }


def test_frames_are_where_mujoco_has_them() -> None:
    """Two hinges and a slide in a chain, beside their bodies' origins, with bodies that are turned at the start."""
    told = traces(1, 40)
    poses = EngineMessages(drawing(), "s", "environment", PORTS, MASSES, ("thing",), TICK_NS).poses(told)
    assert poses is not None
    model: Any = mujoco.MjModel.from_xml_string(MODEL)
    data = mujoco.MjData(model)
    for row, pose in enumerate(poses):
        data.qpos[:3] = told["x_e"][row]
        data.qpos[3:6], data.qpos[6:] = told["q"][row], told["R"][row]
        mujoco.mj_forward(model, data)
        assert {*pose} == {"arm", "sledge", "tip", "thing"}
        for name, (at, turn) in pose.items():
            body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
            assert at == pytest.approx(data.xpos[body], abs=1e-12)
            assert abs(float(np.dot(turn, data.xquat[body]))) == pytest.approx(1.0, abs=1e-12)  # q and -q are one turn


PEN = """<mujoco><compiler angle="radian"/><option gravity="0 0 0"/><worldbody>
<body name="carriage" pos="0 0 0.1" euler="0 0 0.4"><joint name="x" type="slide" axis="1 0 0"/>
  <joint name="y" type="slide" axis="0 1 0"/><geom size="0.01"/>
  <body name="pen" pos="0.02 0 0" euler="0 0.5 0"><joint name="z" type="slide" axis="0 0 1"/>
    <joint name="ball" type="ball" pos="0 0.01 0.03"/><geom type="capsule" size="0.004 0.03"/></body></body>
</worldbody></mujoco>"""


def pen() -> WorldDrawing:
    given = {"model": PEN, "tools": ["x", "y", "z"], "bodies": [], "stiffness": [1.0] * 3}
    return MujocoEngine(PORTS, 1e-3, given | {"avatars": ["ball"], "avatar_stiffness": [1e-3]}).drawing()


def test_a_tool_is_turned_as_its_hand_was_told_last() -> None:
    """About a point beside its body's origin, after another hand in the trace; zeros tell nothing."""
    model: Any = mujoco.MjModel.from_xml_string(PEN)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "pen")
    start = data.xquat[body].copy()
    random = np.random.default_rng(6)
    x_e, told = random.normal(size=(6, 3)), np.zeros((6, 10))
    for row in range(6):
        data.qpos[:3], data.qpos[3:] = x_e[row], random.normal(size=4)
        data.qpos[3:] /= np.linalg.norm(data.qpos[3:])
        mujoco.mj_forward(model, data)
        by = np.zeros(4)
        mujoco.mju_mulQuat(by, data.xquat[body], [start[0], *-start[1:]])  # in the world's axes
        told[row, :4], told[row, 5:9] = (1.0, 0.0, 0.0, 0.0), by
    told[4, 5:] = 0.0
    told[5, 5:] = np.nan
    hands = {"other": ("o.a", "o.b", "o.c"), "d": PORTS}
    space = EngineMessages(pen(), "s", "environment", PORTS, (), (), TICK_NS, hands)
    poses = space.poses({"x_e": x_e, "told": told})
    assert poses is not None
    for row, pose in enumerate(poses):
        data.qpos[:3] = x_e[row]
        turn = told[min(row, 3), 5:9]
        mujoco.mju_mulQuat(by, turn, start)
        if row < 4:
            own = np.zeros(4)
            mujoco.mju_mulQuat(own, [start[0], *-start[1:]], by)
            data.qpos[3:] = own
        mujoco.mj_forward(model, data)
        at, found = pose["pen"]
        assert at == pytest.approx(data.xpos[body], abs=1e-12)
        assert abs(float(np.dot(found, data.xquat[body]))) == pytest.approx(1.0, abs=1e-12)
        assert pose["carriage"][0] == pytest.approx(data.xpos[body - 1], abs=1e-12)
    assert space.poses({"x_e": x_e}) is None


def recorded() -> Recorded:
    roles = {"d": Role.DEVICE, "environment": Role.ENVIRONMENT}
    ports = {"d": PORTS, "environment": PORTS}
    return Recorded(
        "s",
        "0" * 64,
        1e-3,
        "simulated",
        roles,
        ports,
        MASSES,
        turning=("d.a", "d.c"),
        oriented=("thing",),
        drawing=drawing(),
    )


def test_messages_agree_with_their_schemas_and_are_those_that_foxglove_sdk_defines() -> None:
    space = recorded().scene_messages()
    assert space is not None
    found = [*space.of(120, traces(2), 0)]
    assert [one.tick for one in found] == [0, 0, 50, 100]
    for one in found:
        name, schema = SCENE_SCHEMAS[one.topic]
        jsonschema.validate(json.loads(one.data), json.loads(schema))
        assert len(published(name, json.loads(one.data)).encode()) > 100


def test_each_geom_is_a_solid_of_its_frame() -> None:
    space = recorded().scene_messages()
    assert space is not None
    (scene,) = [json.loads(one.data) for one in space.of(1, traces(3, 1), 0) if one.topic == "scene"]
    found = {
        (one["frame_id"], kind): len(one[kind])
        for one in scene["entities"]
        for kind in ("cubes", "spheres", "cylinders", "triangles")
        if one[kind]
    }
    assert found == {
        ("s", "cubes"): 1,
        ("s", "spheres"): 1,
        ("s/arm", "spheres"): 2,
        ("s/arm", "cylinders"): 1,
        ("s/sledge", "cubes"): 1,
        ("s/tip", "cylinders"): 1,
        ("s/tip", "triangles"): 1,
        ("s/thing", "spheres"): 1,
    }
    (arm,) = [one for one in scene["entities"] if one["frame_id"] == "s/arm"]
    ends = sorted(one["pose"]["position"]["x"] for one in arm["spheres"])
    assert ends == pytest.approx([0.0, 0.1], abs=1e-12)
    assert arm["cylinders"][0]["size"] == pytest.approx({"x": 0.02, "y": 0.02, "z": 0.1})


def test_a_recording_has_the_drawing_and_one_that_does_not_fit_is_refused() -> None:
    texts = recorded().as_metadata()
    assert Recorded.from_metadata(texts) == recorded()
    assert "drawing" not in replace(recorded(), drawing=None).as_metadata()
    with pytest.raises(ValueError, match="found a scene of other ports or bodies in the metadata"):
        Recorded.from_metadata(texts | {"masses": "[]"})
    with pytest.raises(ValueError, match="metadata that make no sense"):
        Recorded.from_metadata(texts | {"drawing": texts["drawing"].replace('"up": "z"', '"up": "x"')})


def test_what_is_not_reported_is_not_shown() -> None:
    space = recorded().scene_messages()
    assert space is not None
    whole = traces(4)
    for missing in whole:
        assert [*space.of(120, {name: kept for name, kept in whole.items() if name != missing}, 0)] == []
