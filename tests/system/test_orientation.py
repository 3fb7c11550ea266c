"""A stick that a hand turns in a slot, in real processes: to the last bit in simulated time, and kept in real time."""

from __future__ import annotations

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
from manyhands.protocol.channels import ACCOUNT, ORIENTATION, PROXY, TORQUE
from tests.support.slot import sensed, slot_by

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


@pytest.mark.alone
@pytest.mark.parametrize("link", [None, {"b": 20}])
def test_in_real_time_its_account_is_kept_however_late_it_is(link: dict[str, Any] | None, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    prepared = prepare(slot_by(link, design={"coupling": "spring-damper", "tau": 0.001}))
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
