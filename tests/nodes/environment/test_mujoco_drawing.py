"""What a MuJoCo model is said to look like: every geom in the frame that it moves in, and nothing in a wrong place."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from manyhands.design.models.distance_grid import MOST_DRAWN
from manyhands.launch.plan import engine
from manyhands.launch.plan.engine import drawing_of
from manyhands.launch.plan.prepare import unproved
from manyhands.launch.run.broadcast import describe
from manyhands.launch.session.shipped import load_named
from manyhands.nodes.environment.drawing import Frame, Shape, WorldDrawing
from manyhands.nodes.environment.model import make_model
from manyhands.nodes.environment.mujoco import MujocoEngine
from manyhands.nodes.kernel.factory import FactoryName
from manyhands.nodes.monitor.session_state import About, AboutError

UPRIGHT = (1.0, 0.0, 0.0, 0.0)
MODEL = """<mujoco><option gravity="0 0 0"/><worldbody>
<geom name="floor" type="plane" size="0.3 0 0.01" pos="0 0 -0.1"/>
<geom name="collides" type="box" size="1 1 1" group="3"/>
<body name="outer" pos="0.1 0 0"><joint name="x" type="slide" axis="0 0 2"/>
  <geom type="ellipsoid" size="0.01 0.02 0.03" mass="0.05"/>
  <body name="tip" pos="0 0 0.05" euler="90 0 0">
    <geom type="capsule" size="0.01 0.02" pos="0 0.01 0" mass="0.05"/></body></body>
<body name="wheel" pos="0.2 0 0"><joint type="hinge" axis="0 0 1"/>
  <geom type="cylinder" size="0.05 0.01"/></body>
<body name="vane" pos="0.3 0 0"><joint type="hinge" axis="0 0 1"/><geom type="box" size="0.05 0.01 0.02"/></body>
<body name="unheard" pos="0.4 0 0"><freejoint/><geom type="sphere" size="0.01"/></body>
</worldbody></mujoco>"""


def drawn(model: str = MODEL, bodies: tuple[str, ...] = ("wheel", "vane"), **other: Any) -> WorldDrawing:
    given = {"model": model, "tools": ["x"], "bodies": [*bodies], "stiffness": [2000.0]}
    return MujocoEngine(("p",), 1e-3, given | other).drawing()


def test_each_geom_is_in_the_frame_of_what_moves_it() -> None:
    drawing = drawn()
    assert drawing.up == "z"
    found = {(shape.frame, shape.shape): shape for shape in drawing.shapes}
    assert [*found] == [
        ("", "plane"),
        ("outer", "ellipsoid"),
        ("outer", "capsule"),
        ("wheel", "cylinder"),
        ("vane", "box"),
    ]
    assert found["", "plane"].size[:2] == (0.3, 0.0)
    assert found["", "plane"].at == (0.0, 0.0, -0.1)
    assert found["outer", "ellipsoid"].size == (0.01, 0.02, 0.03)
    tip = found["outer", "capsule"]  # 0.01 along the y axis of a body that is turned by 90 degrees about x
    assert tip.size == (0.01, 0.01, 0.02)
    assert tip.at == pytest.approx((0.0, 0.0, 0.06), abs=1e-12)
    assert np.abs(tip.turn).tolist() == pytest.approx([0.5**0.5, 0.5**0.5, 0.0, 0.0])


def test_a_frame_says_what_moves_it() -> None:
    frames = drawn().frames
    assert frames["outer"] == Frame((0.1, 0.0, 0.0), UPRIGHT, ("p",), ((0.0, 0.0, 1.0),))
    assert frames["wheel"] == Frame((0.2, 0.0, 0.0), UPRIGHT, reported=True)  # it is round about its hinge
    assert frames["vane"] == Frame((0.3, 0.0, 0.0), UPRIGHT, reported=True, turns=True)


JAW = """<mujoco><compiler angle="radian"/><worldbody>
<body name="palm" pos="0 0 0.1"><joint name="x" type="slide" axis="1 0 0"/><geom size="0.01"/>
  <body name="thumb" pos="0.25 0 0"><joint name="jaw" type="hinge" axis="0 2 0" pos="0.25 0 0"/>
    <geom type="box" size="0.004 0.01 0.04"/></body></body>
</worldbody></mujoco>"""


def test_a_hinge_of_a_tool_turns_its_frame_about_its_axis_and_a_slide_moves_it() -> None:
    given = {"model": JAW, "tools": ["x", "jaw"], "turning": ["b"], "bodies": [], "stiffness": [1.0, 1.0]}
    frames = MujocoEngine(("a", "b"), 1e-3, given).drawing().frames
    assert frames["palm"] == Frame((0.0, 0.0, 0.1), UPRIGHT, ("a",), ((1.0, 0.0, 0.0),))
    directions = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    assert frames["thumb"] == Frame((0.25, 0.0, 0.1), UPRIGHT, ("a", "b"), directions, axes={"b": (0.5, 0.0, 0.1)})
    told = MujocoEngine(("a", "b"), 1e-3, given | {"bodies": ["thumb"]}).drawing().frames["thumb"]
    assert told == Frame((0.25, 0.0, 0.1), UPRIGHT, reported=True, turns=True)
    heard = given | {"bodies": ["thumb"], "orientations": ["thumb"]}
    assert MujocoEngine(("a", "b"), 1e-3, heard).drawing().frames["thumb"] == replace(told, turns=False, oriented=True)


PEN = """<mujoco><compiler angle="radian"/><worldbody>
<body name="carriage" pos="0 0 0.1"><joint name="x" type="slide" axis="1 0 0"/>
  <joint name="y" type="slide" axis="0 1 0"/><geom size="0.01"/>
  <body name="pen" pos="0.02 0 0" euler="0 0.5 0"><joint name="z" type="slide" axis="0 0 1"/>
    <joint name="ball" type="ball" pos="0 0 0.03"/>
    <geom type="capsule" size="0.004 0.03" mass="0.05"/></body></body>
</worldbody></mujoco>"""


@pytest.mark.parametrize("told", [{}, {"bodies": ["pen"], "orientations": ["pen"]}])
def test_a_tool_that_its_hand_turns_is_in_a_frame_of_its_ports_with_a_pivot(told: dict[str, Any]) -> None:
    given = {"model": PEN, "tools": ["x", "y", "z"], "bodies": [], "stiffness": [1.0] * 3}
    avatars = {"avatars": ["ball"], "avatar_stiffness": [0.01]}
    drawing = MujocoEngine(("a", "b", "c"), 1e-3, given | avatars | told).drawing()
    pen = drawing.frames["pen"]
    assert (pen.ports, pen.reported, pen.oriented, drawing.hidden) == (("a", "b", "c"), False, False, ())
    c, s = np.cos(0.5), np.sin(0.5)
    assert pen.directions == (pytest.approx((1, 0, 0)), pytest.approx((0, 1, 0)), pytest.approx((s, 0, c)))
    assert pen.pivot == pytest.approx((0.02 + 0.03 * s, 0.0, 0.1 + 0.03 * c))
    assert drawing.frames["carriage"].pivot is None
    assert drawing.frames["carriage"].ports == ("a", "b")

    nobodys = MujocoEngine(("a", "b", "c"), 1e-3, given).drawing()
    assert nobodys.hidden == ("pen",)


def test_what_moves_unreported_is_named_and_not_drawn() -> None:
    assert drawn().hidden == ("unheard",)
    alone = drawn(bodies=())
    assert alone.hidden == ("wheel", "vane", "unheard")
    assert {shape.frame for shape in alone.shapes} == {"", "outer"}


def test_a_mesh_has_its_triangles_and_one_that_is_too_large_is_named() -> None:
    tetrahedron = '<mesh name="piece" vertex="0 0 0  0.1 0 0  0 0.1 0  0 0 0.1"/>'
    text = MODEL.replace("<worldbody>", f'<asset>{tetrahedron}</asset><worldbody><geom type="mesh" mesh="piece"/>', 1)
    [mesh] = [shape for shape in drawn(text).shapes if shape.shape == "mesh"]
    points = np.array(mesh.points)
    assert (len(mesh.points), len(mesh.triangles)) == (4, 4)
    sides = [np.linalg.norm(points[i] - points[j]) for i in range(4) for j in range(i)]
    assert sorted(sides) == pytest.approx([0.1] * 3 + [0.1 * 2**0.5] * 3, rel=1e-5)
    many = drawn(
        text.replace('<geom type="mesh" mesh="piece"/>', '<geom type="mesh" mesh="piece"/>' * (MOST_DRAWN // 4 + 1))
    )
    assert many.large == ("piece",)


def test_a_start_makes_the_engine_once_and_another_model_is_made_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[FactoryName] = []

    def count(name: FactoryName, *rest: Any) -> Any:
        made.append(name)
        return make_model(name, *rest)

    monkeypatch.setattr(engine, "make_model", count)
    engine._tried.cache_clear()
    session = load_named("mujoco", ["design={coupling: given, stiffness: 900, damping: 0.2}"])
    engine.require_engine(session)
    assert drawing_of(session.with_delay(0.0)) == drawing_of(session)
    assert engine.engine_lines(session) == []
    assert len(made) == 1
    assert made[0] == session.foreign_code["environment.model"]
    drawing_of(load_named("mujoco", ["period=0.002", "design={coupling: given, stiffness: 900, damping: 0.2}"]))
    assert len(made) == 2


def test_the_shipped_session_is_described_with_its_drawing(tmp_path: Path) -> None:
    session = load_named("mujoco", ["design={coupling: given, stiffness: 900, damping: 0.2}"])
    about = replace(describe(unproved(session), "simulated", "ipc", 0), drawing=drawing_of(session))
    assert about.drawing is not None
    assert about.drawing.frames["left"].ports == ("left.0", "left.1") or set(about.drawing.frames["left"].ports) == {
        *session.ports_of("left")
    }
    assert not about.drawing.frames["puck"].turns
    about.save(tmp_path)
    assert About.load(tmp_path) == about
    assert drawing_of(load_named("carry", [])) is None
    moved = replace(
        about.drawing, frames={**about.drawing.frames, "puck": Frame((0, 0, 0), UPRIGHT, ("nobody",), ((1, 0, 0),))}
    )
    replace(about, drawing=moved).save(tmp_path)
    with pytest.raises(AboutError, match=r"drawing\.frames\.puck: found other ports"):
        About.load(tmp_path)
    left = about.drawing.frames["left"]
    unheld = replace(about.drawing, frames={**about.drawing.frames, "left": replace(left, pivot=left.at)})
    replace(about, drawing=unheld, hands=("left",)).save(tmp_path)
    assert About.load(tmp_path).drawing == unheld
    for hands, place in (
        ((), r"drawing\.frames\.left"),
        (("right",), r"drawing\.frames\.left"),
        (("nobody",), "hands"),
    ):
        replace(about, drawing=unheld, hands=hands).save(tmp_path)
        with pytest.raises(AboutError, match=f"{place}: found"):
            About.load(tmp_path)


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"up": "x"}, "drawing.up"),
        ({"shapes": (Shape("nowhere", "box", (1, 1, 1), (0, 0, 0), UPRIGHT),)}, "in the frame 'nowhere'"),
        ({"shapes": (Shape("", "cone", (1, 1, 1), (0, 0, 0), UPRIGHT),)}, "found a 'cone'"),
        ({"shapes": (Shape("", "mesh", (1, 1, 1), (0, 0, 0), UPRIGHT, ((0, 0, 0),), ((0, 0, 1),)),)}, "of no point"),
        ({"shapes": (Shape("", "box", (1, 1, np.nan), (0, 0, 0), UPRIGHT),)}, "not finite"),
        ({"frames": {"a": Frame((0, 0, 0), UPRIGHT, ("p",))}}, "a direction for each port"),
        ({"frames": {"a": Frame((0, 0, 0), UPRIGHT, axes={"p": (0, 0, 0)})}}, "found an axis of no port of it"),
        ({"frames": {"a": Frame((0, 0, np.inf), UPRIGHT)}}, "not finite"),
        ({"frames": {"a": Frame((0, 0, 0), UPRIGHT, pivot=(0, 0, 0))}}, "a pivot; expected ports"),
        ({"frames": {"a": Frame((0, 0, 0), UPRIGHT, ("p",), ((1, 0, 0),), pivot=(0, np.nan, 0))}}, "not finite"),
    ],
)
def test_a_drawing_that_cannot_be_drawn_is_refused(changes: dict[str, Any], error: str) -> None:
    with pytest.raises(ValueError, match=error):
        replace(drawn(), **{"shapes": (), "frames": {}} | changes)
