"""No forgery of a recording is called held: an audit finds it broken, or says which ticks it could not check."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from manyhands.launch.app.cli import app
from manyhands.launch.audit.audit import Audit, AuditVerdict, audit
from manyhands.launch.audit.findings import CheckVerdict
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.recordings.run import RecordedRun, read_run
from manyhands.launch.session import load_session

from ...support.forged_recordings import SIMULATED, Forged
from ...support.simulated_recordings import SESSIONS, attachments_of, recorded_of, simulated, written

TICKS = 300


@pytest.fixture(scope="module")
def prepared() -> Prepared:
    return prepare(load_session(SESSIONS / "example1.yaml", ["design.ladder=[]"]))


@pytest.fixture(scope="module")
def run(prepared: Prepared, tmp_path_factory: pytest.TempPathFactory) -> RecordedRun:
    path = tmp_path_factory.mktemp("recording") / "run.mcap"
    written(path, recorded_of(prepared), attachments_of(prepared), simulated(prepared, TICKS))
    return read_run(path)


def audited(path: Path) -> Audit:
    return audit(path, read_run(path), lambda text: None, lambda tick: None)


def test_what_is_written_again_without_a_change_holds(run: RecordedRun, tmp_path: Path) -> None:
    assert audited(Forged.of(run).write(tmp_path / "r.mcap", run)).verdict is AuditVerdict.HOLDS


@pytest.mark.parametrize("what", SIMULATED)
def test_no_forgery_holds(what: str, run: RecordedRun, tmp_path: Path) -> None:
    forged = Forged.of(run)
    SIMULATED[what](forged)
    done = audited(forged.write(tmp_path / "f.mcap", run))
    gone = any(word in what for word in ("NaN", "infinite", "gone")) and "says" not in what
    assert done.verdict is (AuditVerdict.UNCHECKED if gone else AuditVerdict.BROKEN)
    for check in done.checks:  # every tick is compared or listed
        if check.name in ("signal", "tools", "masses", "ledger"):
            left = {tick for gap in check.gaps for tick in range(gap.begin, gap.end)}
            ports = max(1, len(run.recorded.ports[check.party]) if check.name in ("signal", "tools") else 1)
            assert check.numbers >= ports * (TICKS - len(left)) - ports * (TICKS - done.ticks), check


def test_the_ticks_are_counted_and_named(run: RecordedRun, tmp_path: Path) -> None:
    forged = Forged.of(run)
    SIMULATED["every x is NaN"](forged)
    path = forged.write(tmp_path / "f.mcap", run)
    (rows,) = [check for check in audited(path).checks if (check.party, check.name) == ("dx", "rows")]
    assert rows.verdict is CheckVerdict.MISSING
    assert [str(gap) for gap in rows.gaps] == ["ticks 51 to 299: x is absent, or not finite"]
    assert rows.remark == "249 of 300 ticks are absent or not finite"
    shown = CliRunner().invoke(app, ["audit", str(path)])
    assert shown.exit_code == 1
    assert "not checked: dx: ticks 51 to 299: x is absent, or not finite" in shown.stdout
    assert f"{path}: not checked: record (dx, dy, dz); what is there holds (" in shown.stdout.splitlines()[-1]


def test_a_cut_recording_says_what_is_not_checked(run: RecordedRun, tmp_path: Path) -> None:
    whole = Forged.of(run).write(tmp_path / "r.mcap", run)
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole.read_bytes()[:-200])
    shown = CliRunner().invoke(app, ["audit", str(cut)])
    assert shown.exit_code == 1
    assert f"{cut}: not checked: record (session); what is there holds (" in shown.stdout.splitlines()[-1]


def test_a_recording_without_a_tick_is_not_checked(prepared: Prepared, tmp_path: Path) -> None:
    path = written(tmp_path / "r.mcap", recorded_of(prepared), attachments_of(prepared), {})
    shown = CliRunner().invoke(app, ["audit", str(path)])
    assert shown.exit_code == 1
    assert (
        f"{path}: not checked: record (session); what is there holds (1 of 2 checks)" in shown.stdout.splitlines()[-1]
    )


def test_a_recording_begun_in_mid_session_accuses_nobody(run: RecordedRun, tmp_path: Path) -> None:
    forged = Forged.of(run)
    SIMULATED["all first rows are gone"](forged)
    done = audited(forged.write(tmp_path / "r.mcap", run))
    assert done.broken == ()
    lacking = {check.party: check.gaps[0] for check in done.checks if check.verdict is CheckVerdict.MISSING}
    assert {(gap.begin, gap.end) for gap in lacking.values()} == {(0, 51)}
    assert lacking.keys() == {*run.recorded.roles}
