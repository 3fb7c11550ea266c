"""Axes that turn in a session file: their units in every message, lever arms, and what cannot have them."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest

from manyhands.design.models.axis import TRANSLATING, TURNING, AxisKind
from manyhands.launch.audit.simulation import Simulation
from manyhands.launch.plan.loop import haptic_loop
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.session import Session, SessionError

WHEEL: dict[str, Any] = {
    "session": "wheel",
    "period": 0.001,
    "devices": {
        "wheel": {"dof": 1, "axes": "rotation", "osp": 0.1, "driver": "simulated", "mass": 0.02},
        "road": {"dof": 1, "axes": {"rack": "translation"}, "osp": 60.0, "driver": "simulated", "mass": 4.0},
    },
    "couplings": {"cw": {"devices": ["wheel"]}, "cr": {"devices": ["road"]}},
    "environment": {
        "type": "network",
        "masses": {"rod": 3.0},
        "inertias": {"column": 0.004},
        "links": [
            {"between": ["wheel", "column"], "stiffness": 60.0, "damping": 0.05},
            {"between": ["column", "rod"], "stiffness": 1e6, "damping": 200.0, "lever": {"column": 0.008}},
            {"between": ["road.rack", "rod"], "stiffness": 5e4, "damping": 100.0},
            {"between": ["rod", "ground"], "stiffness": 4e4, "damping": 1500.0},
        ],
    },
    "design": {"coupling": "spring-damper", "objective": "stiffest"},
}


def changed(path: str, value: object) -> dict[str, Any]:
    """The session with one value changed; ``None`` takes a key out."""
    data = copy.deepcopy(WHEEL)
    *way, last = (int(step) if step.isdigit() else step for step in path.split("."))
    part: Any = data
    for step in way:
        part = part[step]
    if value is None:
        del part[last]
    else:
        part[last] = value
    return data


def refusal(data: dict[str, Any]) -> str:
    """The message of a session that is refused."""
    with pytest.raises(SessionError) as caught:
        Session.from_dict(data)
    return str(caught.value).partition(": ")[2]


def test_what_turns_is_known_by_name() -> None:
    session = Session.from_dict(WHEEL)
    assert session.ports == ("wheel", "road.rack")
    assert session.turning_ports == ("wheel",)
    assert session.turning == ("wheel", "column")
    assert session.devices["wheel"].kinds == (AxisKind.ROTATION,)
    assert session.units("wheel") == TURNING
    assert session.units("road.rack")("N") == TRANSLATING("N") == "N"
    assert session.units()("N/m") == "N/m or N·m/rad"
    assert haptic_loop(session).turning == {"wheel"}


@pytest.mark.parametrize("axes", ["rotation", {"phi": "rotation"}])
def test_a_lever_arm_understands_the_number_of_a_single_axis(axes: object) -> None:
    knob = {"dof": 1, "axes": axes, "osp": 0.1, "driver": "simulated", "mass": 0.02}
    link = {"between": ["knob.0", "cart"], "stiffness": 10.0, "lever": {"knob.0": 0.5}}
    ground = {"between": ["cart", "ground"], "stiffness": 1.0}
    world = {"type": "network", "masses": {"cart": 1.0}, "links": [link, ground]}
    data = {**WHEEL, "devices": {"knob": knob}, "couplings": {"c": {"devices": ["knob"]}}, "environment": world}
    assert haptic_loop(Session.from_dict(data)).environment.links[0].arms == (0.5, 1.0)  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("axes", "ports", "kinds"),
    [
        ("rotation", ("d.0", "d.1"), ["rotation"] * 2),
        ("translation", ("d.0", "d.1"), ["translation"] * 2),
        (["x", "y"], ("d.x", "d.y"), ["translation"] * 2),
        ({"x": "translation", "phi": "rotation"}, ("d.x", "d.phi"), ["translation", "rotation"]),
    ],
)
def test_axes_are_names_kinds_or_both(axes: object, ports: tuple[str, ...], kinds: list[str]) -> None:
    device = {"dof": 2, "axes": axes, "osp": 1.0, "driver": "simulated", "mass": 0.1}
    links = [{"between": [port, "ground"], "stiffness": 10.0} for port in ports]
    data = {**WHEEL, "devices": {"d": device}, "couplings": {"c": {"devices": ["d"]}}}
    session = Session.from_dict({**data, "environment": {"type": "network", "links": links}})
    assert session.ports == ports
    assert list(session.devices["d"].kinds) == kinds
    written = session.to_dict()  # what a run keeps is read back as the same
    assert written["devices"]["d"]["axes"] == axes
    assert Session.from_dict(written) == session


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("devices.wheel.axes", "turning", "found 'turning'; expected one of translation, rotation"),
        ("devices.road.axes", {"rack": "rotating"}, "found 'rotating'; expected one of translation, rotation"),
        ("devices.road.axes", {"a": "rotation", "b": "rotation"}, "found 2 axis names; expected 1"),
        ("devices.wheel.mass", 0.0, "expected a mass in kg·m² greater than 0"),
        ("devices.wheel.osp", -1.0, "expected an OSP level in N·m·s/rad greater than 0"),
        ("devices.wheel.damping", -1.0, "expected a damping in N·m·s/rad of at least 0"),
        ("devices.wheel.damping", 0.05, "expected a damping in N·m·s/rad with diag(damping) - osp"),
        ("devices.wheel.step", -1.0, "expected a step in rad of at least 0"),
        ("devices.wheel.friction", 3, "with the least dry friction in N·m"),
        ("devices.wheel.friction", {"least": -1.0}, "expected a friction in N·m greater than 0"),
        ("devices.wheel.friction", {"least": 0.2, "most": 0.1, "pitch": 1.0}, "found 0.1 N·m; expected at least"),
        ("devices.wheel.limits", {"force": 0.0}, "expected a limit of the force in N·m greater than 0"),
        ("devices.wheel.limits", {"speed": "3 rad"}, "expected a number in rad/s, without the unit"),
        ("devices.wheel.hand", {"stiffness": -1.0}, "expected a stiffness in N·m/rad of at least 0"),
        ("devices.wheel.hand", {"motion": True}, "expected an intended motion: a number in rad"),
        ("devices.road.mass", 0.0, "expected a mass in kg greater than 0"),
        ("environment.inertias.column", 0.0, "expected an inertia in kg·m² greater than 0"),
        ("environment.inertias.rod", 1.0, "found the name 'rod' of a mass; expected a name that no mass has"),
        ("environment.inertias.wheel", 1.0, "found the name 'wheel' of a port"),
        ("environment.inertias.lost", 1.0, "found an inertia without a link; expected at least one link to every iner"),
        ("environment.links.1.lever", None, "found no lever arm of 'column', which turns, beside an end with one or"),
        ("environment.links.1.lever", {"rod": 0.01}, "found 'rod', which is no end of it or does not turn"),
        ("environment.links.1.lever", {"column": 0.0}, "expected a lever arm in m/rad greater than 0"),
        ("environment.links.1.lever", {}, "found an empty mapping; expected {END: ARM}"),
        ("environment.links.0.lever", {"wheel": 0.01}, "found no lever arm of 'column', which turns"),
        ("environment.links.3.lever", {"ground": 1.0}, "found the ground; expected an end that turns"),
    ],
)
def test_messages_have_the_units_of_the_axis(path: str, value: object, message: str) -> None:
    assert message in refusal(changed(path, value))


def test_a_list_by_axis_has_the_units_of_each() -> None:
    device = {"dof": 2, "axes": {"x": "translation", "phi": "rotation"}, "osp": 1.0, "driver": "simulated"}
    data = changed("devices.wheel", device | {"mass": [0.1, -2.0]})
    assert "devices.wheel.mass.1: found -2.0; expected a mass in kg·m²" in refusal(data)
    data = changed("devices.wheel", device | {"mass": -2.0})
    assert "found -2.0; expected a mass in kg or kg·m² greater than 0" in refusal(data)


def test_gears_that_could_not_turn_are_refused_at_their_place() -> None:
    data = copy.deepcopy(WHEEL)
    data["environment"]["links"].append({"between": ["wheel", "rod"], "stiffness": 5.0, "lever": {"wheel": 0.009}})
    assert "environment.links: found two ways from wheel to " in refusal(data)
    data["environment"]["links"][-1]["lever"] = {"wheel": 0.008}
    Session.from_dict(data)


@pytest.mark.parametrize("name", ["rub", "stroke"])
def test_a_tool_in_space_does_not_turn(name: str) -> None:
    from manyhands.launch.session.shipped import load_named

    data = load_named(name, []).to_dict()
    device = next(iter(data["devices"]))
    axes = data["devices"][device].get("axes")
    data["devices"][device]["axes"] = dict.fromkeys(axes, "rotation") if axes else "rotation"
    kind = data["environment"]["type"]
    assert f"which turns; expected ports that translate, or another type: a tool of a {kind}" in refusal(data)


ARM = 2.0**-7
"""m/rad; a power of 2, so that a product with it is exact."""


def scaled() -> dict[str, Any]:
    """The same world with the wheel and the column in metres of the rack: x = ARM phi, f = torque/ARM."""
    data = copy.deepcopy(WHEEL)
    own, square = data["devices"]["wheel"], ARM * ARM
    own |= {"axes": "translation", "osp": 0.1 / square, "mass": 0.02 / square}
    own["hand"] = {"stiffness": 6.0 / square, "damping": 0.4 / square, "motion": f"{ARM!r}*0.7*sin(2*pi*0.5*t)"}
    world = data["environment"]
    world["masses"] = {"rod": 3.0, "column": world.pop("inertias")["column"] / square}
    world["links"][0] |= {"stiffness": 60.0 / square, "damping": 0.05 / square}
    del world["links"][1]["lever"]
    return data


def turning() -> dict[str, Any]:
    """The world with an arm of ARM and a hand that steers."""
    data = changed("environment.links.1.lever", {"column": ARM})
    data["devices"]["wheel"]["hand"] = {"stiffness": 6.0, "damping": 0.4, "motion": "0.7*sin(2*pi*0.5*t)"}
    return data


def test_a_world_that_turns_is_the_scaled_world_to_the_last_digits() -> None:
    """Design, levels and motion: all but a coupling's last digits, which a solver leaves, are the same numbers."""
    angles, metres = (prepare(Session.from_dict(data)) for data in (turning(), scaled()))
    assert angles.certificate is not None
    assert metres.certificate is not None
    K, scaled_K = np.diag(angles.certificate.stiffness), np.diag(metres.certificate.stiffness)
    assert K[0] / ARM**2 == pytest.approx(scaled_K[0], rel=1e-12)  # closed forms, one port a block
    assert K[1] == pytest.approx(scaled_K[1], rel=1e-12)
    given = {"coupling": "given", "stiffness": K.tolist(), "damping": [0.0, 0.0]}
    in_metres = given | {"stiffness": [K[0] / ARM**2, K[1]]}
    runs = []
    for data, design in ((turning(), given), (scaled(), in_metres)):
        made = prepare(Session.from_dict(data | {"design": design}))
        runs.append(Simulation(made).run(1500))
    first, second = runs
    scale = np.array([ARM, 1.0])
    most = np.abs(second.x).max(axis=0)
    assert most[0] > 0.3 * ARM  # it moves
    assert np.abs(first.x * scale - second.x).max(axis=0) == pytest.approx(0.0, abs=1e-11 * most.min())
    force = np.abs(second.f_v).max()
    assert np.abs(first.f_v / scale - second.f_v).max() <= 1e-9 * force
