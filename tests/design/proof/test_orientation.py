"""The claim about an orientation: proved up to its limit, and refused beyond it."""

from __future__ import annotations

import copy
import hashlib
import json
from collections.abc import Callable
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

import manyhands as mh
from manyhands.design.certificate import content, load, save
from manyhands.design.errors import Infeasible
from manyhands.design.levels.orientation import OrientationLevel, orientation_of, stiffest
from manyhands.design.proof.finding import Finding
from manyhands.design.proof.prove import prove
from manyhands.launch.app.budget import budget_object, orientation_limits, print_budget, session_budget
from manyhands.launch.app.design_report import print_certificate
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.session import Session
from tests.support.slot import joined, sensed, session, slot


@pytest.fixture(scope="module")
def claimed() -> dict[str, Any]:
    certificate = prepare(session(design={"coupling": "spring-damper", "tau": 0.0005}), None).certificate
    assert certificate is not None
    return json.loads(json.dumps({**content(certificate), "id": certificate.id}))


def _changed(data: dict[str, Any], change: Callable[[dict[str, Any]], None]) -> dict[str, Any]:
    out = copy.deepcopy(data)
    change(out["devices"]["pen"])
    own = {key: value for key, value in out.items() if key != "id"}
    out["id"] = hashlib.sha256(json.dumps(own, separators=(",", ":")).encode()).hexdigest()
    return out


def _about(findings: tuple[Finding, ...]) -> list[Finding]:
    return [finding for finding in findings if "orientation" in finding.condition]


def test_it_is_of_version_6_and_proved(claimed: dict[str, Any]) -> None:
    assert claimed["version"] == 6
    assert claimed["devices"]["pen"]["orientation"] == {"osp": 0.001, "stiffness": 0.3}
    findings = prove(claimed)
    assert all(finding.holds for finding in findings)
    (found,) = _about(findings)
    assert found.condition == "the orientation of pen: b > 0, k > 0, k (lambda T + 3 tau)/2 <= b"


@pytest.mark.parametrize(("k", "holds"), [(0.8, True), (0.8000001, False), (-0.1, False), (0.0, False)])
def test_its_limit_is_exact(claimed: dict[str, Any], k: float, holds: bool) -> None:
    """0.001 = k (0.001 + 3 0.0005)/2 at k = 0.8."""
    data = _changed(claimed, lambda device: device["orientation"].update(stiffness=k))
    findings = prove(data)
    assert [finding.holds for finding in _about(findings)] == [holds]
    assert all(finding.holds for finding in findings) is holds


@pytest.fixture(scope="module")
def sensed_claim() -> dict[str, Any]:
    certificate = prepare(Session.from_dict(sensed()), None).certificate
    assert certificate is not None
    return json.loads(json.dumps({**content(certificate), "id": certificate.id}))


def test_one_that_is_sensed_needs_nothing(sensed_claim: dict[str, Any]) -> None:
    assert sensed_claim["devices"]["pen"]["orientation"] == {"sensed": True, "stiffness": 0.3}
    findings = prove(sensed_claim)
    assert all(finding.holds for finding in findings)
    (found,) = _about(findings)
    assert found.condition == "the orientation of pen is sensed, without a torque: k > 0, and nothing is needed"
    held = {"kappa": 1.0, "force": 1.0, "speed": 0.1}
    assert all(finding.holds for finding in _about(prove(_changed(sensed_claim, lambda own: own.update(held=held)))))
    stiff = _changed(sensed_claim, lambda own: own["orientation"].update(stiffness=1e6))
    assert all(finding.holds for finding in _about(prove(stiff)))
    none = _changed(sensed_claim, lambda own: own["orientation"].update(stiffness=0.0))
    assert not any(finding.holds for finding in _about(prove(none)))


def test_one_that_is_sensed_is_written_and_read_back_and_shown(tmp_path: Path) -> None:
    certificate = mh.certify(Session.from_dict(sensed()))
    save(certificate, tmp_path / "slot.json")
    read, _ = load(tmp_path / "slot.json")
    assert read.loop.devices[0].orientation == OrientationLevel(None, 0.3)
    assert read.id == certificate.id
    with pytest.raises(ValueError, match="sensed"):
        orientation_of({"sensed": False, "stiffness": 1.0})
    found = session_budget(Session.from_dict(sensed()))
    assert orientation_limits(found.loop) == [("pen", None, 0.3)]
    assert budget_object(found)["orientations"] == {"pen": {"sensed": True, "stiffness": 0.3}}
    shown = StringIO()
    print_budget(Console(file=shown, width=200), found)
    assert "The orientation of pen: sensed, without a torque" in shown.getvalue()
    print_certificate(Console(file=shown, width=200), certificate)
    assert "no torque acts on the hand, and nothing is needed" in shown.getvalue()


@pytest.fixture(scope="module")
def twisted() -> dict[str, Any]:
    """Of a device whose joints hold force and torque together."""
    certificate = prepare(Session.from_dict(joined()), None).certificate
    assert certificate is not None
    return json.loads(json.dumps({**content(certificate), "id": certificate.id}))


def test_torques_of_joints_take_of_both_dampings(twisted: dict[str, Any]) -> None:
    held = twisted["devices"]["pen"]["held"]
    assert set(held) == {"kappa", "force", "speed", "length"}
    findings = prove(twisted)
    assert all(finding.holds for finding in findings)
    (found,) = _about(findings)
    assert found.condition == "the orientation of pen: b > 0, k > 0, k (lambda T + 3 tau)/2 <= b - L^2 d"
    # d = kappa F/(1 - kappa v (T + tau)/2) (T + 3 tau)/2
    bent = 10.0 * held["force"] / (1.0 - 10.0 * held["speed"] * 0.0012 / 2.0)
    d = bent * 0.0016 / 2.0
    left = 0.001 - 0.05**2 * d
    assert found.value == pytest.approx(left - 0.3 * 0.0016 / 2.0)
    (level,) = twisted["levels"]["Delta_D"].values()
    assert level[0][0] == pytest.approx(1.37 - d)
    for k, holds in ((left / 0.0008 * (1 - 1e-9), True), (left / 0.0008 * (1 + 1e-9), False)):
        stiff = prove(_changed(twisted, lambda own, k=k: own["orientation"].update(stiffness=k)))
        assert [finding.holds for finding in _about(stiff)] == [holds]


FORGED: dict[str, Callable[[dict[str, Any]], None]] = {
    "a greater force": lambda own: own["held"].update(force=2.0 * own["held"]["force"]),
    "a greater kappa": lambda own: own["held"].update(kappa=20.0),
    "a longer length": lambda own: own["held"].update(length=0.2),
    "no length": lambda own: own["held"].pop("length"),
    "a length below 0": lambda own: own["held"].update(length=-0.05),
    "a length of 0": lambda own: own["held"].update(length=0.0),
    "more damping than there is": lambda own: own["orientation"].update(osp=1e-4),
    "an orientation that is sensed": lambda own: own.update(orientation={"sensed": True, "stiffness": 0.3}),
    "no orientation": lambda own: own.pop("orientation"),
    "a tip that turns too far": lambda own: own["held"].update(speed=1e3),
}


@pytest.mark.parametrize("change", FORGED.values(), ids=FORGED)
def test_a_claim_about_torques_of_joints_that_is_changed_is_not_proved(
    twisted: dict[str, Any], change: Callable[[dict[str, Any]], None]
) -> None:
    assert not all(finding.holds for finding in prove(_changed(twisted, change)))


@pytest.mark.parametrize("length", [None, "0.05", True, [0.05]])
def test_a_length_that_is_no_number_is_refused(twisted: dict[str, Any], length: Any) -> None:
    with pytest.raises(ValueError, match="length"):
        prove(_changed(twisted, lambda own: own["held"].update(length=length)))


def test_kinematics_beside_a_length_are_refused(twisted: dict[str, Any]) -> None:
    chain = {"kind": "chain", "turns": ["z", "y", "y"], "links": [[0, 0, 0.1], [0.1, 0, 0], [0.1, 0, 0]],
             "low": [-0.2, -0.2, 0.8], "high": [0.2, 0.2, 1.2]}  # fmt: skip
    with pytest.raises(ValueError, match="no kinematics of six axes"):
        prove(_changed(twisted, lambda own: own["held"].update(linkage=chain)))


def test_a_spring_for_which_joints_leave_too_little_is_refused(twisted: dict[str, Any]) -> None:
    data = joined(stiffness=1.2)
    pen = data["devices"]["pen"]
    with pytest.raises(Infeasible, match=r"of which torques of its joints take 0\.000\d+, allows at delays of 0\.2 ms"):
        mh.certify(Session.from_dict(data))
    pen["linkage"]["kappa"] = 60.0
    with pytest.raises(Infeasible, match=r"expected more than the 0\.001\d+ N·m·s/rad that torques of its joints"):
        mh.certify(Session.from_dict(data))
    del pen["orientation"]["stiffness"]
    with pytest.raises(Infeasible, match="state a lower greatest force or torque"):
        mh.certify(Session.from_dict(data))


def test_it_is_read_back_and_its_budget_counts_the_joints(twisted: dict[str, Any], tmp_path: Path) -> None:
    data = joined()
    certificate = mh.certify(Session.from_dict(data))
    save(certificate, tmp_path / "slot.json")
    read, _ = load(tmp_path / "slot.json")
    (again,), (own,) = read.loop.devices, certificate.loop.devices
    assert (again.held, again.orientation) == (own.held, own.orientation)
    assert read.id == certificate.id == twisted["id"]
    found = session_budget(Session.from_dict(data))
    ((_, most, _),) = orientation_limits(found.loop)
    (held,) = (device.held for device in read.loop.devices)
    assert held is not None
    assert most == pytest.approx((0.001 - held.turning(0.001, 0.0002, 0.0)) / 0.0008)
    shown = StringIO()
    print_certificate(Console(file=shown, width=300), certificate)
    assert "where a turn counts by 0.05 m/rad" in shown.getvalue()
    assert "of which torques of its joints take 0.0001" in shown.getvalue()


def test_held_torques_without_a_length_are_not_covered(claimed: dict[str, Any]) -> None:
    held = {"kappa": 1.0, "force": 1.0, "speed": 0.1}
    findings = prove(_changed(claimed, lambda device: device.update(held=held)))
    assert any(not finding.holds and "not torques of joints" in finding.condition for finding in findings)


@pytest.mark.parametrize(
    "orientation",
    [
        None,
        [],
        {},
        {"osp": 0.001},
        {"osp": 0.001, "stiffness": "0.3"},
        {"osp": 0.001, "stiffness": 0.3, "more": 1},
        {"osp": 0.001, "sensed": True, "stiffness": 0.3},
        {"sensed": False, "stiffness": 0.3},
        {"stiffness": 0.3},
        {"sensed": 1, "stiffness": 0.3},
        {"osp": 0.001, "sensed": False, "stiffness": 0.3},
    ],
)
def test_what_is_no_orientation_is_refused(claimed: dict[str, Any], orientation: Any) -> None:
    with pytest.raises(ValueError, match="orientation"):
        prove(_changed(claimed, lambda device: device.update(orientation=orientation)))


def test_a_device_with_other_ports_has_none(claimed: dict[str, Any]) -> None:
    """Three that translate are where the tool is."""
    one = json.loads(json.dumps({**content(mh.certify(mh.load("example1")))}))
    one |= {"version": 6, "period_tolerance": 0.1}
    one["devices"]["dx"]["orientation"] = claimed["devices"]["pen"]["orientation"]
    one["id"] = ""
    with pytest.raises(ValueError, match="three"):
        prove(one)


def test_it_is_written_and_read_back(tmp_path: Path) -> None:
    certificate = mh.certify(session())
    save(certificate, tmp_path / "slot.json")
    read, _ = load(tmp_path / "slot.json")
    assert read.loop.devices[0].orientation == OrientationLevel(0.001, 0.3)
    assert read.id == certificate.id
    with pytest.raises(ValueError, match="keys"):
        orientation_of({"osp": 1.0, "stiffness": 1.0, "more": 1.0})


def test_a_spring_that_is_too_stiff_is_refused_with_what_would_do() -> None:
    with pytest.raises(Infeasible, match=r"expected at most 2 N·m/rad, which an osp of 0\.001"):
        mh.certify(session(orientation={"stiffness": 2.5}))


def test_the_stiffest_is_proved_whatever_the_delay() -> None:
    for tau in (0.0, 1e-4, 3.7e-4, 1e-3):
        k = stiffest(0.0013, 0.001, tau, 0.05)
        assert OrientationLevel(0.0013, k).proved(0.001, tau, 0.05)
        assert not OrientationLevel(0.0013, k / 0.98).proved(0.001, tau, 0.05)


def test_the_budget_says_how_stiff_it_may_be() -> None:
    found = session_budget(session(design={"coupling": "spring-damper", "tau": 0.0005}))
    ((name, most, own),) = orientation_limits(found.loop)
    assert (name, own) == ("pen", 0.3)
    assert most == pytest.approx(0.8)
    assert budget_object(found)["orientations"] == {"pen": {"limit": most, "stiffness": 0.3}}
    assert "orientations" not in budget_object(session_budget(mh.load("example1")))
    shown = StringIO()
    print_budget(Console(file=shown, width=200), found)
    assert "The orientation of pen: certified up to 0.8 N·m/rad at τ = 0.5 ms; the session has 0.3" in shown.getvalue()


def test_a_session_with_another_orientation_has_another_certificate() -> None:
    a, b = (mh.certify(mh.Session.from_dict(slot({"stiffness": k}))) for k in (0.3, 0.31))
    assert a.id != b.id
