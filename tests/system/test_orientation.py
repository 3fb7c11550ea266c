"""A stick that a hand turns in a slot, in real processes: to the last bit in simulated time, and kept in real time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from manyhands.launch.audit.audit import AuditVerdict, audit
from manyhands.launch.audit.findings import CheckVerdict
from manyhands.launch.audit.orientation import BOUND, NAME
from manyhands.launch.audit.replay import replay
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.plan.reach import reach
from manyhands.launch.recordings.run import RecordedRun, read_run, rows_of
from manyhands.launch.run.recorder import RecorderProcess
from manyhands.launch.run.supervisor import Supervisor
from manyhands.launch.session import Session
from manyhands.launch.session.shipped import load_named
from manyhands.protocol.channels import ACCOUNT, ORIENTATION, PROXY, TORQUE
from tests.support.slot import sensed, slot, slot_by, told

pytest.importorskip("mujoco")
ABOUT = {(NAME, "pen"), (BOUND, "pen"), (BOUND, "environment")}


def recorded(prepared: Prepared, clock: str, ticks: int, path: Path) -> RecordedRun:
    recorder, ways = RecorderProcess(prepared, clock, path), reach(prepared, "ipc")
    outcome = Supervisor(prepared, clock=clock, reach=ways, ticks=ticks, record=False, recorder=recorder).run()
    assert (outcome.code, outcome.faults) == (0, ())
    return read_run(path)


FAR: dict[str, Any] = {"b": 20, "network": {"delay": 0.02, "jitter": 0.004, "loss": 0.02}}


@pytest.mark.parametrize("link", [None, FAR, {"b": 20, "period": 0.0005}])
def test_processes_simulation_replay_and_audit_agree_to_the_last_bit(
    link: dict[str, Any] | None, tmp_path: Path
) -> None:
    path, prepared = tmp_path / "run.mcap", prepare(slot_by(link))
    run = recorded(prepared, "simulated", 730, path)
    assert np.nanmax(np.abs(rows_of(run, "pen", TORQUE))) > 1e-3
    if link is None or "period" not in link:  # a replay is one process, which has one period
        again = replay(prepared, run)
        assert (again.identical, again.ticks, again.missing, again.deviations) == (True, 730, {}, ())
    done = audit(path, run, lambda text: None, lambda tick: None)
    assert done.holds
    assert {(check.name, check.party) for check in done.checks if check.verdict is CheckVerdict.HOLDS} >= ABOUT
    assert {row.promise: row.state for row in done.promises}["orientation account"] == "kept"


def test_a_hand_that_feels_nothing_makes_no_promise_and_its_run_is_computed_again(tmp_path: Path) -> None:
    path, prepared = tmp_path / "run.mcap", prepare(Session.from_dict(sensed()))
    run = recorded(prepared, "simulated", 230, path)
    again = replay(prepared, run)
    assert (again.identical, again.ticks, again.missing, again.deviations) == (True, 230, {}, ())
    done = audit(path, run, lambda text: None, lambda tick: None)
    assert done.holds
    about = {(check.name, check.party) for check in done.checks if check.verdict is CheckVerdict.HOLDS}
    assert about >= {(NAME, "pen"), ("agreement", "pen")}
    assert "orientation account" not in {row.promise for row in done.promises}


@pytest.mark.parametrize("sense", [False, True])
def test_one_that_a_driver_of_another_package_tells_is_replayed_and_audited_without_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, sense: bool
) -> None:
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[2]))  # where the driver is found
    path, own = tmp_path / "run.mcap", {"sensed": True, "stiffness": 0.3} if sense else None
    prepared = prepare(Session.from_dict(told(own)))
    run = recorded(prepared, "simulated", 330, path)
    assert np.ptp(rows_of(run, "pen", ORIENTATION), axis=0).max() > 0.01
    again = replay(prepared, run)
    assert (again.identical, again.ticks, again.missing, again.deviations) == (True, 330, {}, ())
    assert again.given == ("pen",)
    done = audit(path, run, lambda text: None, lambda tick: None)
    assert done.holds
    held = {(check.name, check.party) for check in done.checks if check.verdict is CheckVerdict.HOLDS}
    assert held >= ({(NAME, "pen"), ("agreement", "pen")} if sense else ABOUT)
    (word,) = (row for row in done.promises if row.promise == "driver's word")
    assert "its orientation" in word.remark
    assert ("its damping in turning" in word.remark) != sense
    run.traces["pen", "orientation"].values[100, 1] += 1e-6
    assert not audit(path, run, lambda text: None, lambda tick: None).holds


LINKED = {"c": {"devices": ["pen"], "wave_link": {"b": 20}}}
FELT: tuple[Callable[[], dict[str, Any]], ...] = (slot, told, lambda: slot(couplings=LINKED))


@pytest.mark.alone
@pytest.mark.parametrize("of", FELT)
def test_in_real_time_its_account_is_kept_however_late_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, of: Callable[[], dict[str, Any]]
) -> None:
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[2]))  # where the driver is found
    path = tmp_path / "run.mcap"
    prepared = prepare(Session.from_dict({**of(), "design": {"coupling": "spring-damper", "tau": 0.001}}))
    run = recorded(prepared, "realtime", 2000, path)
    done = audit(path, run, lambda text: None, lambda tick: None)
    assert done.verdict is not AuditVerdict.BROKEN
    broken = [check for check in done.checks if (check.name, check.party) in ABOUT]
    assert all(check.verdict is CheckVerdict.HOLDS for check in broken), broken
    R, Q, torque, account = (rows_of(run, "pen", trace) for trace in (ORIENTATION, PROXY, TORQUE, ACCOUNT))
    known = np.isfinite(R).all(axis=1)
    assert known.sum() > 1000
    for one in (R[known], Q[known]):
        assert np.linalg.norm(one, axis=1) == pytest.approx(1.0, abs=1e-12)
    assert np.linalg.norm(torque[known], axis=1).max() <= 0.2 * (1.0 + 1e-9)
    assert (account[known, 0] >= account[known, 1] - account[known, 2] - 1e-12).all()
    assert run.figures["pen"][-1][1]["orientation_margin"] >= -1e-12


@pytest.mark.alone
@pytest.mark.long
@pytest.mark.parametrize(("name", "ticks"), [("insert", 5000), ("stretcher", 4600), ("screw", 7000)])
def test_in_real_time_the_shipped_tools_turn_as_they_are_to(name: str, ticks: int, tmp_path: Path) -> None:
    """By hands that go by the clock, however late their torques are."""
    path = tmp_path / "run.mcap"
    run = recorded(prepare(load_named(name, ["design.tau=0.001"])), "realtime", ticks, path)
    done = audit(path, run, lambda text: None, lambda tick: None)
    assert done.verdict is not AuditVerdict.BROKEN
    masses, turned = rows_of(run, "environment", "q"), rows_of(run, "environment", "R")
    if name == "insert":
        depth = masses[:, 5] + 0.025 - (masses[:, 2] - 0.035)
        # m: on the rim until it is wiggled, at 2.4 s of the hands' clock, of which a busy world's ticks may be behind
        assert np.nanmax(depth[:2000]) < 0.001
        assert np.nanmedian(depth[4600:]) == pytest.approx(0.04, abs=5e-4)
    elif name == "screw":
        turned = -np.unwrap(2.0 * np.arctan2(turned[:, 7], turned[:, 4])) / (2.0 * np.pi)
        assert np.nanmedian(-masses[6700:, 5]) > 5e-4  # m, by at least two strokes,
        assert np.nanmedian(-masses[6700:, 5]) == pytest.approx(0.002 * np.nanmedian(turned[6700:]), abs=1e-5)
    else:
        assert np.nanmedian(masses[1500:3000, 2]) > 0.02  # m: carried,
        assert np.nanmedian(masses[4400:, 2]) == pytest.approx(0.006, abs=5e-4)  # and put down
        assert np.degrees(2.0 * np.nanmedian(turned[3300:3600, 3])) == pytest.approx(20.0, abs=2.0)
    for hand in load_named(name, []).hands:
        assert run.figures[hand][-1][1]["orientation_margin"] >= -1e-12
