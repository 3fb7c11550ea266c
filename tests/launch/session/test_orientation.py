"""The keys of an orientation: what a session may state, and what it is told where it may not."""

from __future__ import annotations

import math
from typing import Any

import pytest

from manyhands.launch.session import Session, SessionError
from manyhands.launch.session.session import ENVIRONMENT
from manyhands.nodes.kernel.bundle import OrientationPart, SensedPart
from tests.support.slot import ORIENTATION, sensed, slot


def test_it_is_read_and_written_again() -> None:
    session = Session.from_dict(slot())
    assert session.hands == ("pen",)
    own = session.devices["pen"].orientation
    assert own is not None
    assert own.torque == ("0.004*sin(2*pi*t)", 0.0, "0.03*sin(2*pi*2*t)")
    part = own.part(0.3)
    assert isinstance(part, OrientationPart)
    assert (part.source.damping, part.source.inertia) == (0.001, 2e-5)
    assert Session.from_dict(session.to_dict()) == session
    assert Session.from_dict(session.as_plain()) == session


def test_one_that_is_sensed_is_read_and_written_again() -> None:
    session = Session.from_dict(sensed())
    assert (session.hands, session.sensed_hands) == (("pen",), ("pen",))
    own = session.devices["pen"].orientation
    assert own is not None
    assert isinstance(own.part(0.3), SensedPart)
    assert session.stiffest_orientations == {"pen": 0.3}
    assert Session.from_dict(session.to_dict()) == session
    assert Session.from_dict(session.as_plain()) == session
    assert Session.from_dict(slot()).sensed_hands == ()


def test_one_that_is_sensed_goes_with_torques_of_joints_and_with_a_ladder() -> None:
    """No torque acts on its hand, so there is nothing that either could give out."""
    data = sensed(design={"coupling": "spring-damper", "tau": 1e-4, "ladder": [2e-4]})
    data["devices"]["pen"] |= {"held": "torque", "linkage": {"kappa": 10.0}}
    assert Session.from_dict(data).sensed_hands == ("pen",)


def test_without_a_stiffness_it_is_the_stiffest_that_is_proved() -> None:
    data = slot()
    del data["devices"]["pen"]["orientation"]["stiffness"]
    session = Session.from_dict(data)
    for tau, rho in ((0.0, 0.0), (0.0005, 0.2)):
        k = session.orientation_stiffness("pen", tau, rho)
        assert k * ((1 + rho) * 0.001 + 3 * tau) / 2 == pytest.approx(0.99 * 0.001)
    assert session.stiffest_orientations["pen"] == session.orientation_stiffness("pen", 0.0, 0.0)


def _with(**keys: Any) -> dict[str, Any]:
    data = slot()
    data["devices"]["pen"] |= keys
    return data


def _environment(**keys: Any) -> dict[str, Any]:
    data = slot()
    data[ENVIRONMENT] |= keys
    return data


def _sensed(without: str = "", **keys: Any) -> dict[str, Any]:
    data = sensed()
    own = data["devices"]["pen"]["orientation"] | keys
    data["devices"]["pen"]["orientation"] = {key: value for key, value in own.items() if key != without}
    return data


def test_a_person_at_a_browser_may_turn_it() -> None:
    data = _with(driver="browser", hand={"stiffness": 100})
    del data["devices"]["pen"]["orientation"]["torque"]
    assert Session.from_dict(data).hands == ("pen",)


CHAIN = {"kind": "chain", "turns": ["z", "y", "y"], "links": [[0, 0, 0.1], [0.1, 0, 0], [0.1, 0, 0]],
         "low": [-0.2, -0.2, 0.8], "high": [0.2, 0.2, 1.2]}  # fmt: skip
TWISTED = {"kappa": 10.0, "length": 0.05}
"""Of joints that hold force and torque together."""


def _sensed_with(**keys: Any) -> dict[str, Any]:
    data = sensed()
    data["devices"]["pen"] |= keys
    return data


def test_joints_that_hold_its_torque_state_a_length_and_take_of_its_damping() -> None:
    data = _with(held="torque", linkage=TWISTED, limits={"force": 4, "speed": 0.5})
    session = Session.from_dict(data)
    assert Session.from_dict(session.to_dict()) == session
    held = session.devices["pen"].held_torque
    assert held is not None
    assert held.force == pytest.approx(math.sqrt(3 * 4**2 + (0.2 / 0.05) ** 2))
    assert held.speed == pytest.approx(math.sqrt(3 * 0.5**2 + (30 * 0.05) ** 2))
    assert held.force**2 >= 3 * 4**2 + (0.2 / 0.05) ** 2
    taken = session.taken_of_orientation("pen", 2e-4, 0.1)
    assert taken == held.turning(0.001, 2e-4, 0.1) > 0.0
    del data["devices"]["pen"]["orientation"]["stiffness"]
    k = Session.from_dict(data).orientation_stiffness("pen", 2e-4, 0.1)
    assert k * (1.1 * 0.001 + 3 * 2e-4) / 2 == pytest.approx(0.99 * (0.001 - taken))
    assert session.tells_work("pen") is False


LINKS = [{"between": [f"pen.{i}", "ground"], "stiffness": 100} for i in range(3)]

REFUSED = {
    "two axes": (_with(dof=2, hand={}), "3 axes that translate"),
    "a driver": (_with(driver="a.b:c", mass=None, hand=None), "no inertia: the driver's device and its user"),
    "a SpaceMouse": (_with(driver="spacemouse", hand={"stiffness": 100}), "driver: simulated, browser, or a driver"),
    "a person and a torque": (_with(driver="browser", hand={"stiffness": 100}), "no torque: the intention comes from"),
    "torques of joints": (_with(held="torque", linkage={"kappa": 10.0}), "linkage: {kappa: K, length: L} of all six"),
    "kinematics of its place": (_with(held="torque", linkage=CHAIN), "linkage: {kappa: K, length: L} of all six"),
    "kinematics and a length": (_with(held="torque", linkage={**CHAIN, "length": 0.05}), "found ['length']"),
    "a length of nothing": (_with(held="torque", linkage={"kappa": 10.0, "length": 0}), "a length in m/rad greater"),
    "a length alone": (_with(held="torque", linkage={"length": 0.05}), "{kappa: 18.8}, in 1/m"),
    "a length of turns that are sensed": (
        _sensed_with(held="torque", linkage=TWISTED),
        "no length, or an orientation with a torque",
    ),
    "friction beside it": (
        _with(held="torque", linkage=TWISTED, friction={"least": 0.1}),
        "no friction: what it burns",
    ),
    "joints that take all of its damping": (
        _with(held="torque", linkage={"kappa": 1000.0, "length": 0.05}, limits={"force": 4, "speed": 0.5}),
        "that torques of its joints may give out without any delay, or a lower greatest force or torque",
    ),
    "a tip that turns too far": (
        _with(held="torque", linkage={"kappa": 1000.0, "length": 0.05}, limits={"force": 4, "speed": 100}),
        "lower speeds: the tip may turn too far",
    ),
    "axes that turn": (_with(axes={"x": "translation", "y": "translation", "w": "rotation"}), "axes that translate"),
    "no avatar": (_environment(avatars={}), "environment.avatars: {pen: JOINT}"),
    "an avatar of nobody": (_environment(avatars={"pen": "turn", "pin": "turn"}), "a device with an orientation: pen"),
    "another world": (
        slot(environment={"type": "network", "links": LINKS}),
        "an engine with an avatar for its tool",
    ),
    "no inertia": (slot({"inertia": 0.0}), "an inertia in kg·m² greater than 0"),
    "an osp without a number": (slot({"osp": math.nan}), "a level in N·m·s/rad"),
    "too little damping": (slot({"damping": 1e-4}), "at least the osp, 0.001 N·m·s/rad"),
    "two torques": (slot({"torque": [0, 0]}), "three torques in N·m"),
    "a torque of words": (slot({"torque": ["import os", 0, 0]}), "a formula"),
    "a torque that ends": (slot({"torque": ["1/(t-1)", 0, 0]}), "a finite value at every time"),
    "no limits": ({**slot(), "devices": {"pen": {**slot()["devices"]["pen"], "orientation": {
        key: value for key, value in ORIENTATION.items() if key != "limits"}}}}, "limits"),
    "no osp": ({**slot(), "devices": {"pen": {**slot()["devices"]["pen"], "orientation": {
        key: value for key, value in ORIENTATION.items() if key != "osp"}}}}, "or sensed: true"),
    "sensed with an osp": (_sensed(osp=0.001), "no osp: no motor turns a sensed device"),
    "sensed with limits": (_sensed(limits=ORIENTATION["limits"]), "no limits: no motor turns a sensed device"),
    "sensed without a stiffness": (_sensed("stiffness"), "by which the tool's avatar follows the hand"),
    "sensed without a damping": (_sensed("damping"), "damping, of the simulated device, in N·m·s/rad"),
    "simulated without an inertia": (_sensed("inertia"), "inertia, of the simulated device and its hand"),
    "a recorded motion": (_with(driver="trace", mass=None, hand=None), "nothing else turns in space"),
    "sensed by a number": (_sensed(sensed=1), "true or false"),
    "an unknown key": (slot({"stifness": 1.0}), "stiffness"),
}  # fmt: skip


@pytest.mark.parametrize(("data", "expected"), REFUSED.values(), ids=REFUSED)
def test_what_cannot_be_is_refused_in_one_sentence(data: dict[str, Any], expected: str) -> None:
    with pytest.raises(SessionError) as refused:
        Session.from_dict(data)
    assert expected in str(refused.value)
