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
from tests.support.slot import sensed, session, slot


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


def test_held_torques_are_not_covered(claimed: dict[str, Any]) -> None:
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
