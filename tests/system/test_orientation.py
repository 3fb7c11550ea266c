"""A stick that a hand turns in a slot, in real processes: to the last bit in simulated time, and kept in real time."""

from __future__ import annotations

from pathlib import Path

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
from manyhands.launch.session.shipped import load_named
from manyhands.protocol.channels import ACCOUNT, ORIENTATION, PROXY, TORQUE
from tests.support.slot import session

pytest.importorskip("mujoco")
ABOUT = {(NAME, "pen"), (BOUND, "pen"), (BOUND, "environment")}


def recorded(prepared: Prepared, clock: str, ticks: int, path: Path) -> RecordedRun:
    recorder, ways = RecorderProcess(prepared, clock, path), reach(prepared, "ipc")
    outcome = Supervisor(prepared, clock=clock, reach=ways, ticks=ticks, record=False, recorder=recorder).run()
    assert (outcome.code, outcome.faults) == (0, ())
    return read_run(path)


def test_processes_simulation_replay_and_audit_agree_to_the_last_bit(tmp_path: Path) -> None:
    path, prepared = tmp_path / "run.mcap", prepare(session())
    run = recorded(prepared, "simulated", 730, path)
    again = replay(prepared, run)
    assert (again.identical, again.ticks, again.missing, again.deviations) == (True, 730, {}, ())
    done = audit(path, run, lambda text: None, lambda tick: None)
    assert done.holds
    assert {(check.name, check.party) for check in done.checks if check.verdict is CheckVerdict.HOLDS} >= ABOUT
    assert {row.promise: row.state for row in done.promises}["orientation account"] == "kept"


@pytest.mark.alone
def test_in_real_time_its_account_is_kept_however_late_it_is(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    prepared = prepare(session(design={"coupling": "spring-damper", "tau": 0.001}))
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
@pytest.mark.parametrize(("name", "ticks"), [("insert", 5000), ("stretcher", 4600)])
def test_in_real_time_the_shipped_tools_turn_as_they_are_to(name: str, ticks: int, tmp_path: Path) -> None:
    """By hands that go by the clock, however late their torques are."""
    path = tmp_path / "run.mcap"
    run = recorded(prepare(load_named(name, ["design.tau=0.001"])), "realtime", ticks, path)
    done = audit(path, run, lambda text: None, lambda tick: None)
    assert done.verdict is not AuditVerdict.BROKEN
    masses, turned = rows_of(run, "environment", "q"), rows_of(run, "environment", "R")
    if name == "insert":
        depth = masses[:, 5] + 0.025 - (masses[:, 2] - 0.035)
        assert np.nanmax(depth[:2400]) < 0.001  # m: on the rim until it is wiggled
        assert np.nanmedian(depth[4600:]) == pytest.approx(0.04, abs=5e-4)
    else:
        assert np.nanmedian(masses[1500:3000, 2]) > 0.02  # m: carried,
        assert np.nanmedian(masses[4400:, 2]) == pytest.approx(0.006, abs=5e-4)  # and put down
        assert np.degrees(2.0 * np.nanmedian(turned[3300:3600, 3])) == pytest.approx(20.0, abs=2.0)
    for hand in load_named(name, []).hands:
        assert run.figures[hand][-1][1]["orientation_margin"] >= -1e-12
