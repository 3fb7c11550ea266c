"""Scenes in session files: what they become, and the place of every error."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from manyhands.design.models.contacts import Surface
from manyhands.design.models.declared import DeclaredScene
from manyhands.design.models.scene import Body
from manyhands.launch.session import SceneEnvironment, Session, SessionError, load_session

TEXT = """
session: scene
period: 0.001
devices:
  anna: {dof: 3, osp: 1.37, driver: simulated, mass: 0.2, hand: {}}
  ben: {dof: 2, axes: [z, x], osp: 1.37, driver: simulated, mass: 0.2, hand: {}}
couplings: {ca: {devices: [anna]}, cb: {devices: [ben]}}
environment:
  type: scene
  gravity: [0, 0, -9.81]
  tools:
    anna: {at: [-0.1, 0, 0.05], radius: 0.01}
    ben: {at: [0.1, 0, 0.05]}
  bodies:
    ball: {mass: 0.5, at: [0, 0, 0.05], radius: 0.03}
    crate: {shape: box, mass: 0.2, low: [0.5, 0.5, 0], high: [0.6, 0.7, 0.3]}
    rod: {shape: capsule, mass: 0.1, ends: [[-0.5, 0.3, 0.2], [-0.5, 0.1, 0.2]], radius: 0.01}
    piston: {motion: ["0.1*sin(t)", 0, {times: [0, 2], values: [0, 0.1]}], at: [0.7, 0.2, 0.4], radius: 0.02}
  tank: 4
  obstacles:
    floor: {shape: wall, at: [0, 0, 0], normal: [0, 0, 1]}
    room: {shape: room, low: [-1, -1, -1], high: [1, 1, 1]}
    block: {shape: box, low: [0.3, 0.3, 0], high: [0.4, 0.4, 0.1]}
    stone: {shape: sphere, at: [0.3, 0, 0], radius: 0.05}
    rail: {shape: capsule, ends: [[0, 0.3, 0], [0.1, 0.3, 0]], radius: 0.05}
  links:
    - {between: [ben, ball], stiffness: 300, damping: 0.1, rest: [0.1, 0, 0]}
  contact: {stiffness: 3000, damping: 1, friction: 0.4}
  contacts:
    - {between: [anna, floor], stiffness: 500, friction: 2}
design: {coupling: spring-damper}
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "scene.yaml"
    file.write_text(TEXT, encoding="utf-8")
    return file


def test_a_file_becomes_a_scene(path: Path) -> None:
    session = load_session(path)
    environment = session.environment.for_design(session.ports)
    assert isinstance(environment, DeclaredScene)
    assert not np.any(environment.level)
    scene = environment.scene
    anna, ben = scene.tools
    assert (anna.ports, anna.axes, anna.at, anna.radius) == ((0, 1, 2), (0, 1, 2), (-0.1, 0.0, 0.05), 0.01)
    assert (ben.ports, ben.axes) == ((3, 4), (2, 0))  # by the names of the device's axes
    assert scene.bodies[0] == Body("ball", 0.5, (0.0, 0.0, 0.05), 0.03)
    crate, rod, piston = scene.bodies[1:]
    motion = ("0.1*sin(t)", 0.0, {"times": [0.0, 2.0], "values": [0.0, 0.1]})
    assert piston == Body("piston", 0.0, (0.7, 0.2, 0.4), 0.02, motion=motion)
    assert scene.tank == 4.0
    assert (crate.shape, crate.radius, rod.shape, rod.radius) == ("box", 0.0, "capsule", 0.01)
    assert [*crate.at, *crate.half] == pytest.approx([0.55, 0.6, 0.15, 0.05, 0.1, 0.15])
    assert [*rod.at, *rod.half] == pytest.approx([-0.5, 0.2, 0.2, 0.0, -0.1, 0.0])
    assert [(o.shape, len(o.points), o.radius) for o in scene.obstacles] == [
        ("wall", 2, 0.0),
        ("room", 2, 0.0),
        ("box", 2, 0.0),
        ("sphere", 1, 0.05),
        ("capsule", 2, 0.05),
    ]
    assert scene.rest_of(scene.links[0]).tolist() == [0.1, 0.0, 0.0]
    assert scene.surface == Surface(3000.0, 1.0, 0.4)
    assert scene.surface_of("floor", "anna") == Surface(500.0, 0.0, 2.0)
    assert scene.surface_of("ball", "ben").stiffness == 0.0


def test_a_session_is_the_same_after_it_is_written(path: Path) -> None:
    session = load_session(path)
    again = Session.model_validate(session.as_plain())
    assert isinstance(again.environment, SceneEnvironment)
    assert again.environment.for_design(again.ports) == session.environment.for_design(session.ports)


@pytest.mark.parametrize(
    ("override", "at", "found"),
    [
        ("tools.cleo={}", "tools.cleo", "'cleo'"),
        ("tools={anna: {}}", "tools", "no tool for the device 'ben'"),
        ("tools.anna.at=[0, 0]", "tools.anna.at", "a list of 2"),
        ("tools.anna.at=[0, 0, 2e3]", "tools.anna.at.2", "2000"),
        ("tools.anna.at=[0.3, 0.3, 0.1]", "tools.anna", "10 mm inside 'block'"),
        ("tools.anna.at=[-0.1, 0, 0.005]", "tools.anna", "5 mm inside 'floor'"),
        ("bodies.ball.mass=0", "bodies.ball.mass", "0"),
        ("bodies.ball.at=here", "bodies.ball.at", "here"),
        ("bodies.ball.ends=[[0, 0, 0], [0, 0, 1]]", "bodies.ball.ends", "ends of a sphere"),
        ("bodies.ball={mass: 1}", "bodies.ball", "a sphere without at"),
        ("bodies.crate.shape=room", "bodies.crate.shape", "room"),
        ("bodies.crate.radius=0.1", "bodies.crate.radius", "radius of a box"),
        ("bodies.crate.high=[0.6, 0.4, 0.3]", "bodies.crate.high", "along y"),
        ("bodies.rod.radius=0", "bodies.rod.radius", "0"),
        (
            "bodies.rod.ends=[[-0.5, 0.3, 0.2], [-0.5, 0.1, 0.3]]",
            "bodies.crate",
            "a box that may touch a capsule along no axis ('crate' and 'rod')",
        ),
        ("bodies.ball.motion=[0, 0, 0]", "bodies.ball", "a mass and a motion"),
        ("bodies.ball={at: [0, 0, 0.05]}", "bodies.ball", "neither a mass nor a motion"),
        ("bodies.piston.motion=[0, 0]", "bodies.piston.motion", "a list of 2"),
        ("bodies.piston.motion=[0, cos(t), 0]", "bodies.piston.motion", "1 m at t = 0 along y"),
        ("bodies.piston.motion=[0, open(t), 0]", "bodies.piston.motion.1", "open"),
        ("tank=-1", "tank", "-1"),
        ("tank=1e4", "tank", "10000"),
        ("bodies={}", "tank", "a tank, and no body with a motion"),
        ("bodies.ben={mass: 1, at: [0, 0, 1]}", "bodies.ben", "'ben'"),
        ("obstacles.ground={shape: sphere, at: [0, 0, 9], radius: 1}", "obstacles.ground", "of the ground"),
        ("obstacles.floor.shape=cone", "obstacles.floor.shape", "cone"),
        ("obstacles.floor.radius=1", "obstacles.floor.radius", "radius of a wall"),
        ("obstacles.floor.normal=[0, 0, 0]", "obstacles.floor.normal", "[0, 0, 0]"),
        ("obstacles.rail={shape: capsule, radius: 0.1}", "obstacles.rail", "a capsule without ends"),
        ("obstacles.room.high=[1, 1, -2]", "obstacles.room.high", "along z"),
        ("obstacles.stone.radius=0", "obstacles.stone.radius", "0"),
        ("links.0.between=[ben, floor]", "links.0.between.1", "unknown end 'floor'"),
        ("links.0.between=[ben, ben]", "links.0.between", "'ben' twice"),
        ("links.0={between: [ben, ball]}", "links.0", "neither stiffness nor damping"),
        ("contact.stiffness=2e6", "contact.stiffness", "2"),
        ("contact.friction=-1", "contact.friction", "-1"),
        ("contacts.0.between=[floor, room]", "contacts.0.between", "two obstacles"),
        ("contacts.0.between=[anna, lamp]", "contacts.0.between.1", "unknown end 'lamp'"),
        (
            "obstacles={floor: {shape: sphere, at: [3, 3, 3], radius: 1}}",
            "bodies.ball",
            "gravity, and nothing that holds the body",
        ),
        ("gravity=9.81", "gravity", "9.81"),
        ("enforce=false", "enforce", "enforce"),
        ("delay=1", "delay", "delay"),
    ],
)
def test_an_error_names_its_place(path: Path, override: str, at: str, found: str) -> None:
    with pytest.raises(SessionError) as error:
        load_session(path, [f"environment.{override}"])
    text = str(error.value)
    assert f"environment.{at}: " in text
    assert found in text


def test_too_many_pairs_are_refused_with_both_numbers(path: Path) -> None:
    bodies = {f"b{i}": {"mass": 1, "at": [0, 0, 1], "radius": 0.01} for i in range(30)}
    obstacles = {f"o{i}": {"shape": "sphere", "at": [9, 9, 9], "radius": 0.1} for i in range(17)}
    given = [f"environment.{key}={json.dumps(value)}" for key, value in (("bodies", bodies), ("obstacles", obstacles))]
    flat = ["environment.links=[]", "environment.contacts=[]", "environment.tank=0", "environment.gravity=[0, 0, 0]"]
    with pytest.raises(
        SessionError, match=r"environment\.bodies: found 1040 pairs that may touch; expected at most 1024"
    ):
        load_session(path, [*given, *flat])


@pytest.mark.parametrize(("device", "found"), [("{dof: 4", "a device with 4 axes"), ("{dof: 3, axes: [x, y, w]", "")])
def test_a_device_has_at_most_three_axes(path: Path, device: str, found: str) -> None:
    override = f"devices.anna={device}, osp: 1.37, driver: simulated, mass: 0.2, hand: {{}}}}"
    if not found:  # without names of the scene's axes, x, y and z in order
        session = load_session(path, [override])
        environment: Any = session.environment.for_design(session.ports)
        assert environment.scene.tools[0].axes == (0, 1, 2)
        return
    with pytest.raises(SessionError, match=found):
        load_session(path, [override])
