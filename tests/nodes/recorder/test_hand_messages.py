"""Where a device is that its hand turns: poses that viewers know, in the order of the model's axes."""

from __future__ import annotations

import json
from typing import Any

import jsonschema
import numpy as np
import pytest

from manyhands.nodes.environment.drawing import Frame
from manyhands.nodes.recorder.hand_messages import HandMessages
from manyhands.nodes.recorder.scene_messages import POSE_SCHEMA

from .test_scene_messages import published

PORTS = ("d.a", "d.b", "d.c")
ROOT = 0.5**0.5
RISEN = (ROOT, 0.0, -ROOT, 0.0)  # x is where z was
FRAME = Frame((0.1, 0.0, 0.0), (ROOT, 0.0, 0.0, ROOT), ("d.c", "d.a", "d.b"),
              ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)), pivot=(0.3, 0.0, 0.0))  # fmt: skip


def poses(frame: Frame | None, x: Any, R: Any, tick: int | None = None) -> list[dict[str, Any]]:
    made = HandMessages("s", "d", PORTS, 50e6, frame)
    found = [*made.of(len(x) if tick is None else tick, {"x": np.array(x), "R": np.array(R)}, 10**18)]
    for one in found:
        jsonschema.validate(json.loads(one.data), json.loads(POSE_SCHEMA[1]))
        assert len(published(POSE_SCHEMA[0], json.loads(one.data)).encode()) > 50
    return [json.loads(one.data) for one in found]


def test_a_pose_is_that_of_a_tool_in_the_devices_place() -> None:
    (pose,) = poses(FRAME, [[1.0, 2.0, 3.0]], [RISEN])
    assert pose["frame_id"] == "s"
    assert pose["timestamp"] == {"sec": 10**9, "nsec": 0}
    # 0.2 m beside the pivot, turned downwards; then along the ports
    assert pose["pose"]["position"] == pytest.approx({"x": 1.3, "y": 2.0, "z": 3.0 - 0.2})
    assert pose["pose"]["orientation"] == pytest.approx({"w": 0.5, "x": -0.5, "y": -0.5, "z": 0.5})


def test_without_a_drawing_it_is_the_displacement_and_the_turn() -> None:
    (pose,) = poses(None, [[1.0, 2.0, 3.0]], [RISEN])
    assert pose["pose"]["position"] == {"x": 1.0, "y": 2.0, "z": 3.0}
    assert pose["pose"]["orientation"] == pytest.approx({"w": ROOT, "x": 0.0, "y": -ROOT, "z": 0.0})


def test_what_is_no_pose_is_left_out() -> None:
    x = [[0.0, 0.0, 0.0], [0.0, np.nan, 0.0], [0.0, 0.0, np.inf], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]
    R = [[0.0, 0.0, 0.0, 0.0], RISEN, RISEN, RISEN, [np.nan, 1.0, 0.0, 0.0]]
    (pose,) = poses(FRAME, x, R)
    assert pose["pose"]["position"]["x"] == pytest.approx(1.3)
    made = HandMessages("s", "d", PORTS, 1e6, None)
    assert [one.tick for one in made.of(120, {"x": np.zeros((70, 3)), "R": np.array([RISEN] * 70)}, 0)] == [50, 100]
    assert [*made.of(120, {"x": np.zeros((70, 3))}, 0)] == []
