"""How a device of a session holds its force: kappa, or kinematics from which it follows, and what is refused."""

from typing import Any

import pytest

from manyhands.design.models.linkage import greatest_bending, linkage_of
from manyhands.launch.plan.loop import haptic_loop
from manyhands.launch.session import Session, SessionError

CHAIN: dict[str, Any] = {
    "kind": "chain", "turns": ["z", "z"], "links": [[0.12, 0, 0], [0.14, 0, 0]], "low": [-0.6, 1.4], "high": [0.6, 1.8],
}  # fmt: skip


def session(**device: Any) -> Session:
    arm = {"dof": 2, "osp": 0.3, "driver": "simulated", "mass": 0.2, "limits": {"force": [3, 4], "speed": [0.6, 0.8]}}
    return Session.from_dict(
        {
            "session": "arm",
            "period": 0.001,
            "devices": {"arm": arm | device},
            "couplings": {"c": {"devices": ["arm"]}},
            "environment": {
                "type": "network",
                "links": [{"between": [f"arm.{axis}", "ground"], "stiffness": 1000} for axis in (0, 1)],
            },
            "design": {"coupling": "spring-damper"},
        }
    )


def test_a_device_holds_forces_unless_it_says_otherwise() -> None:
    plain = session()
    assert plain.devices["arm"].held == "force"
    assert haptic_loop(plain).devices[0].held is None
    assert plain == session(held="force")


def test_kappa_is_believed_with_the_limits_of_all_axes_together() -> None:
    [device] = haptic_loop(session(held="torque", linkage={"kappa": 18.8})).devices
    assert device.held is not None
    assert device.held.linkage is None
    assert (device.held.kappa, device.held.force, device.held.speed) == pytest.approx((18.8, 5.0, 1.0), rel=1e-12)
    assert device.held.force > 5.0
    assert device.held.speed > 1.0


def test_kinematics_give_a_kappa_that_a_proof_decides() -> None:
    [device] = haptic_loop(session(held="torque", linkage=CHAIN)).devices
    assert device.held is not None
    assert device.held.linkage == CHAIN
    assert device.held.kappa == pytest.approx(1.05 * greatest_bending(linkage_of(CHAIN)))
    [stated] = haptic_loop(session(held="torque", linkage=CHAIN | {"kappa": 20.0})).devices
    assert stated.held is not None
    assert stated.held.kappa == 20.0


def test_friction_of_joints_is_no_part_of_a_claim() -> None:
    rough = session(held="torque", linkage=CHAIN | {"friction": 0.02})
    [device] = haptic_loop(rough).devices
    assert device.held is not None
    assert device.held.linkage == CHAIN
    assert device.friction is None
    assert rough.devices["arm"].joint_friction == (0.02, 0.02)
    assert Session.from_dict(rough.as_plain()) == rough
    assert session(held="torque", linkage=CHAIN | {"friction": [0.02, 0.03]}).devices["arm"].joint_friction == (
        0.02,
        0.03,
    )


@pytest.mark.parametrize(
    ("device", "words"),
    [
        (
            {"held": "torque", "linkage": CHAIN | {"friction": 0}},
            "linkage: found 0; expected a friction in N·m greater",
        ),
        (
            {"held": "torque", "linkage": CHAIN | {"friction": [1]}},
            "found a list of 1; expected one value, or a list of 2",
        ),
        ({"held": "torque", "linkage": {"kappa": 18.8, "friction": 1}}, "or a kind of kinematics as well"),
        (
            {"held": "torque", "linkage": CHAIN | {"friction": 1}, "driver": "a.lab:device", "mass": None},
            "linkage.friction: found friction of joints with 'driver: a.lab:device'; expected driver: simulated",
        ),
        (
            {"held": "torque", "linkage": CHAIN, "friction": {"least": 1, "static": 2, "stribeck": 1}},
            "friction.static: found static behind the kinematics of a linkage; expected least alone",
        ),
        ({"held": "torque"}, "found held: torque alone; expected its linkage as well"),
        ({"linkage": {"kappa": 18.8}}, "found a linkage alone; expected held: torque as well"),
        ({"held": "both", "linkage": {"kappa": 18.8}}, "'both'"),
        ({"held": "torque", "linkage": {"kappa": 0}}, "kappa"),
        ({"held": "torque", "linkage": {"length": 1}}, "or a kind of kinematics as well"),
        ({"held": "torque", "linkage": 18.8}, "found 18.8"),
        ({"held": "torque", "linkage": CHAIN | {"kind": "arm"}}, "kind: found 'arm'"),
        ({"held": "torque", "linkage": CHAIN | {"high": [0.6, 1.4]}}, "expected each range to rise"),
        ({"held": "torque", "linkage": CHAIN | {"low": [-0.6, 0.0]}}, "without singular poses"),
        ({"dof": 1, "held": "torque", "linkage": CHAIN, "limits": {}}, "as many as the device has, 1"),
        ({"held": "torque", "linkage": CHAIN, "driver": "browser"}, "kappa alone, or driver: simulated"),
        ({"held": "torque", "linkage": {"kappa": 18.8}, "driver": "trace"}, "held: force, for a recorded motion"),
    ],
)
def test_what_does_not_fit_is_named(device: dict[str, Any], words: str) -> None:
    with pytest.raises(SessionError) as caught:
        session(**device)
    assert words in str(caught.value)
