"""The proof of a scene's certificate: what is checked off line, and that every forged scene is found out."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from manyhands.design.certificate import content, from_content, identity
from manyhands.design.models.contacts import Surface
from manyhands.design.models.coupling import Partition
from manyhands.design.models.declared import DeclaredScene
from manyhands.design.models.scene import Body, ContactScene, Obstacle, SceneHold, SceneLink, ToolSphere
from manyhands.design.problem import DeviceLevel, HapticLoop, SpringDamperWanted
from manyhands.design.proof import ProofInputError, prove
from manyhands.design.synthesis import design

PORTS = ("a.x", "a.y", "b.x")
SCENE = ContactScene(
    PORTS,
    tools=(ToolSphere("a", (0, 1), (0, 1), (0.0, 0.0, 0.0), 0.01), ToolSphere("b", (2,), (0,), (0.1, 0.0, 0.0))),
    bodies=(
        Body("ball", 0.5, (0.0, 0.0, 0.1), 0.02),
        Body("lamp", 0.1, (0.1, 0.0, 0.5)),
        Body("crate", 0.3, (0.5, 0.0, 0.1), 0.0, "box", (0.05, 0.06, 0.07)),
        Body("rod", 0.3, (0.0, 0.5, 0.1), 0.01, "capsule", (-0.05, 0.0, 0.0)),
        Body("piston", 0.0, (0.7, 0.0, 0.1), 0.01, motion=("0.1*sin(t)", 0.0, 0.0)),
    ),
    obstacles=(
        Obstacle("floor", "wall", ((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))),
        Obstacle("block", "box", ((0.2, 0.2, 0.0), (0.3, 0.3, 0.1))),
    ),
    links=(SceneLink(("a", "ball"), 300.0, 0.1), SceneLink(("lamp", "ground"), 40.0, 0.1)),
    surface=Surface(3000.0, 1.0, 0.4),
    surfaces=((("lamp", "floor"), Surface(0.0)),),
    gravity=(0.0, 0.0, -9.81),
    tank=2.5,
    holds=(SceneHold("a", "a.grip", 500.0, 2.0, 0.01),),
)


@pytest.fixture(scope="module")
def data() -> dict[str, Any]:
    devices = (DeviceLevel("a", (0, 1), 1.37 * np.eye(2)), DeviceLevel("b", (2,), np.array([[1.37]])))
    partition = Partition(("ca", "cb"), ((0, 1), (2,)))
    loop = HapticLoop("scene", 1e-3, PORTS, devices, partition, DeclaredScene(SCENE), 0.0)
    certificate = design(loop, SpringDamperWanted()).certificate
    plain = content(certificate)
    assert from_content(plain | {"id": certificate.id}).loop.environment == DeclaredScene(SCENE)
    return plain


def sealed(data: dict[str, Any]) -> dict[str, Any]:
    return data | {"id": identity(data)}


def test_a_scene_is_proved_and_its_level_enforced(data: dict[str, Any]) -> None:
    findings = prove(sealed(data))
    assert [finding for finding in findings if not finding.holds] == []
    (level,) = [finding for finding in findings if finding.enforced]
    assert "driven bodies give out at most the 2.5 J of their tank" in level.argument
    assert "a button holds by springs that begin without energy" in level.argument
    assert "wall by convex potentials; box, tools and bodies by tangent planes" in level.argument
    assert data["levels"]["Phi_E"] == [[0.0] * 3] * 3 or not np.any(
        [np.any(block) for block in data["levels"]["Phi_E"].values()]
    )


def setter(*path: Any, to: Any) -> Callable[[dict[str, Any]], None]:
    def change(environment: dict[str, Any]) -> None:
        part: Any = environment
        for key in path[:-1]:
            part = part[key]
        part[path[-1]] = to

    return change


def oblique(gravity: list[float], normal: list[float]) -> Callable[[dict[str, Any]], None]:
    def change(environment: dict[str, Any]) -> None:
        environment["gravity"] = gravity
        environment["obstacles"]["floor"]["points"] = [[0, 0, 0], normal]

    return change


BODIES, FALLS = "masses are positive", "no body falls"


@pytest.mark.parametrize(
    ("change", "fails"),
    [
        (setter("bodies", "ball", "mass", to=0.0), BODIES),
        (setter("bodies", "ball", "mass", to=-1.0), BODIES),
        (setter("bodies", "ball", "radius", to=-0.1), BODIES),
        (setter("tank", to=-1e-9), BODIES),
        (setter("bodies", "ball", to={"mass": 0.5, "at": [0, 0, 0.1], "radius": 0, "motion": [0, 0, 0]}), ""),
        (setter("bodies", "crate", "half", to=[0.05, -0.06, 0.07]), BODIES),
        (setter("bodies", "rod", "half", to=[0.05, -0.06, 0.07]), ""),
        (setter("links", 0, "stiffness", to=-1.0), BODIES),
        (setter("holds", 0, "stiffness", to=-1.0), BODIES),
        (setter("holds", 0, "damping", to=-0.1), BODIES),
        (setter("holds", 0, "within", to=-0.1), BODIES),
        (setter("holds", 0, "button", to="b.other"), ""),
        (setter("links", 0, "damping", to=-0.1), BODIES),
        (setter("contact", "stiffness", to=-3000.0), BODIES),
        (setter("contact", "friction", to=-0.1), BODIES),
        (setter("contacts", 0, "damping", to=-0.1), BODIES),
        (setter("tools", "b", "axes", to=["z"]), ""),
        (setter("tools", "a", "axes", to=["x", "x"]), "an axis of its own"),
        (setter("tools", "b", "ports", to=["a.x"]), "an axis of its own"),
        (setter("obstacles", "block", "points", to=[[1, 1, 1], [0, 2, 2]]), "convex"),
        (setter("obstacles", "floor", "points", to=[[0, 0, 0], [0, 0, 0]]), "convex"),
        (setter("obstacles", "floor", "points", to=[[0, 0, 0], [0, 0, -1]]), FALLS),
        (setter("obstacles", "floor", "points", to=[[0, 0, 0], [1e-300, 0, 1]]), FALLS),
        (setter("obstacles", "floor", "points", to=[[0, 0, 0], [0, 0, 7]]), ""),
        (oblique([3.6, 2.7, -5.6], [-3.6, -2.7, 5.6]), ""),
        (oblique([0.36, 0.27, -0.56], [-10.8, -8.1, 16.8]), ""),
        (oblique([3.6, 2.7, -5.6], [-3.6, -2.7, 5.600000000000001]), FALLS),
        (setter("gravity", to=[0, 1e-200, -9.81]), FALLS),
        (setter("contact", "stiffness", to=0.0), FALLS),
        (setter("contacts", 0, "between", to=["ball", "floor"]), FALLS),
        (setter("links", 1, "stiffness", to=0.0), FALLS),
        (setter("links", 1, "between", to=["lamp", "a"]), FALLS),
    ],
)
def test_a_forged_scene_is_not_proved(
    data: dict[str, Any], change: Callable[[dict[str, Any]], None], fails: str
) -> None:
    forged = copy.deepcopy(data)
    change(forged["environment"])
    failing = [finding.condition for finding in prove(sealed(forged)) if not finding.holds]
    assert any(fails in condition for condition in failing) if fails else failing == []


def test_a_level_below_that_of_the_scene_is_not_proved(data: dict[str, Any]) -> None:
    forged = copy.deepcopy(data)
    level = -1e-9 * np.eye(3)
    forged["levels"]["Phi_E"] = {"ca": level[:2, :2].tolist(), "cb": level[2:, 2:].tolist()}
    assert any(not finding.holds and "Phi_E" in finding.argument for finding in prove(sealed(forged)))


@pytest.mark.parametrize(
    ("change", "place"),
    [
        (setter("bodies", "a", to={"mass": 1.0, "at": [0, 0, 0], "radius": 0}), "environment"),
        (setter("tank", to="full"), "tank"),
        (setter("holds", 0, "tool", to="c"), "holds[0].tool"),
        (setter("holds", 0, "button", to=3), "holds[0].button"),
        (setter("holds", 0, "until", to=3), "holds[0]"),
        (setter("bodies", "piston", "motion", to=[0, 0]), "bodies.piston.motion"),
        (setter("bodies", "crate", "half", to=[0, 0]), "bodies.crate.half"),
        (setter("bodies", "crate", "shape", to="cone"), "bodies.crate.shape"),
        (setter("bodies", "rod", "turns", to=True), "bodies.rod"),
        (setter("tools", "a", "at", to=[0, 0]), "tools.a.at"),
        (setter("tools", "a", "axes", to=["x", "w"]), "tools.a.axes"),
        (setter("obstacles", "block", "shape", to="cone"), "obstacles.block.shape"),
        (setter("obstacles", "block", "shape", to="mesh"), "obstacles.block.shape"),
        (setter("obstacles", "block", "triangles", to=[[0, 1, 2]]), "obstacles.block"),
        (setter("obstacles", "block", "points", to=[[0, 0, 0]]), "obstacles.block.points"),
        (setter("links", 0, "between", to=["a", "floor"]), "links[0].between"),
        (setter("contacts", 0, "between", to=["a", "a"]), "contacts[0].between"),
        (setter("contact", "grip", to=1.0), "contact"),
        (setter("gravity", to=["down", 0, 0]), "gravity"),
    ],
)
def test_what_is_no_scene_is_refused_at_its_place(
    data: dict[str, Any], change: Callable[[dict[str, Any]], None], place: str
) -> None:
    forged = copy.deepcopy(data)
    change(forged["environment"])
    with pytest.raises(ProofInputError) as error:
        prove(sealed(forged))
    assert str(error.value).startswith("environment")
    assert place in str(error.value)
