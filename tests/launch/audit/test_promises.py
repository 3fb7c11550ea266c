"""What an audit says of each promise: its checks and the recorded telemetry go in, rows and the exit code come out."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from manyhands.launch.app.cli import app
from manyhands.launch.audit.checks import delay_assumed, period_assumed
from manyhands.launch.audit.findings import Check, CheckVerdict, Difference
from manyhands.launch.audit.promises import promises_of
from manyhands.launch.audit.simulation import Silence
from manyhands.launch.plan.prepare import Prepared
from manyhands.launch.recordings.run import RecordedRun, read_run
from manyhands.nodes.monitor.health import holds, missed
from manyhands.protocol.channels import TAU
from manyhands.protocol.messages import Condition, Figures, PromiseStatus

from ...support.simulated_recordings import TICKS, attachments_of, forged, recorded_of, simulated, written


@pytest.fixture(scope="module")
def run(recording: Path) -> RecordedRun:
    return read_run(recording)


def check(name: str, party: str, verdict: CheckVerdict, tick: int = 120, differing: int = 0) -> Check:
    first = Difference(tick, "E", -0.25, 0.0) if differing else None
    return Check(name, party, "what it is", verdict, 9, first, differing)


HOLDS, BROKEN = CheckVerdict.HOLDS, CheckVerdict.BROKEN
ENFORCED, ASSUMPTION, UNCHECKED = CheckVerdict.ENFORCED, CheckVerdict.ASSUMPTION, CheckVerdict.UNCHECKED


@pytest.mark.parametrize(
    ("checks", "expected"),
    [
        ([check("bound", "dx", HOLDS), check("ledger", "dx", HOLDS)], []),
        ([check("bound", "dx", BROKEN, differing=2)],
         [("passivity", "broken", ("dx",), 0.12, {"ticks": 2.0, "J": 0.25})]),
        ([check("tau", "dx", ENFORCED, differing=4)], [("delay", "enforced", ("dx",), 0.12, {"ticks": 4.0})]),
        ([check("tau", "dx", ASSUMPTION, differing=4)], [("delay", "broken", ("dx",), 0.12, {"ticks": 4.0})]),
        ([check("period", "dy", ASSUMPTION)], [("period", "broken", ("dy",), None, {})]),
        ([check("account", "dx", BROKEN, differing=1)],
         [("lateness energy", "broken", ("dx",), 0.12, {"ticks": 1.0, "J": 0.25})]),
        ([check("link", "cx", BROKEN, differing=1)], [("wave link", "broken", ("cx",), 0.12, {"ticks": 1.0})]),
        ([check("signal", "cx", BROKEN, differing=3), check("ledger", "cx", BROKEN, 90, differing=5)],
         [("record", "broken", ("cx",), 0.09, {"ticks": 5.0})]),
        ([check("certificate", "session", BROKEN)], [("certificate", "broken", ("session",), None, {})]),
        ([check("bound", "dx", UNCHECKED)], [("passivity", "not checked", ("dx",), None, {})]),
        ([check("signal", "dx", UNCHECKED), check("figures", "dx", HOLDS)], []),  # it is listed with the gaps
        ([check("rows", "dx", CheckVerdict.MISSING), check("signal", "dx", HOLDS)],
         [("record", "not checked", ("dx",), None, {})]),
        ([check("tau", "dx", UNCHECKED)], []),  # under the simulated clock nobody promises it
    ],
)  # fmt: skip
def test_a_check_adds_to_the_row_of_its_promise(
    prepared: Prepared,
    run: RecordedRun,
    checks: list[Check],
    expected: list[tuple[str, str, tuple[str, ...], float | None, Mapping[str, float]]],
) -> None:
    rows = promises_of(prepared, run, checks)
    found = missed(rows)
    assert [(row.promise, row.state, row.who, row.since, row.cost) for row in found] == expected
    assert holds(rows) == all(row.state == "enforced" for row in found)
    assert ("certificate", "kept") in {(row.promise, row.state) for row in rows}


def test_a_run_without_a_tick_has_kept_nothing(prepared: Prepared, tmp_path: Path) -> None:
    path = written(tmp_path / "r.mcap", recorded_of(prepared), attachments_of(prepared), {})
    run = read_run(path)
    assert run.ticks == 0
    rows = promises_of(prepared, run, [check("certificate", "session", HOLDS), check("bound", "dx", UNCHECKED)])
    assert {row.promise for row in rows if row.state == "kept"} == {"certificate"}


def test_a_party_without_any_row_owes_nothing(prepared: Prepared, tmp_path: Path) -> None:
    rows = {key: values for key, values in simulated(prepared, 50).items() if key[0] not in ("dx", "cx")}
    gone = {key: np.full_like(values, np.nan) for key, values in simulated(prepared, 50).items() if key not in rows}
    path = written(tmp_path / "r.mcap", recorded_of(prepared), attachments_of(prepared), rows | gone)
    assert missed(promises_of(prepared, read_run(path), [check("bound", "dx", UNCHECKED)])) == []


def test_delay_and_period_beyond_the_certificate_are_enforced_where_their_energy_is(run: RecordedRun) -> None:
    trace = run.traces["dx", "tau"].values
    before = trace.copy()
    trace[100:] = 1500.0
    assert delay_assumed(run, "dx", {0: 1e-3}, enforced=True).verdict is ENFORCED
    assert delay_assumed(run, "dx", {0: 1e-3}).verdict is ASSUMPTION
    trace[:] = before
    assert delay_assumed(run, "dx", {0: 1e-3}, enforced=True).verdict is HOLDS
    assert period_assumed(run, "dx", 0.0, enforced=True).verdict is HOLDS


def audited(path: Path) -> tuple[int, str, Mapping[str, object]]:
    done = CliRunner().invoke(app, ["audit", str(path)])
    plain = CliRunner().invoke(app, ["audit", str(path), "--json"])
    assert plain.exit_code == done.exit_code
    return done.exit_code, done.stdout, json.loads(plain.stdout)


def test_a_broken_assumption_is_no_success(recording: Path, tmp_path: Path) -> None:
    def later(rows: dict[tuple[str, str], np.ndarray]) -> None:
        rows["dx", TAU][200:] = 1500.0

    code, out, told = audited(forged(tmp_path / "f.mcap", read_run(recording), later))
    assert (code, told["holds"]) == (1, False)
    assert f"delay: broken by dx since 0.2 s ({TICKS - 200} ticks)" in out
    last = out.splitlines()[-1]
    assert "does not hold: broken: delay (dx) (58 of 58 checks, 1 of them an assumption that did not hold)" in last


def test_a_clipped_force_is_not_covered(prepared: Prepared, tmp_path: Path) -> None:
    def clipped(node: str, tick: int) -> Mapping[str, float]:
        return {"clipped": 0.0 if tick < 150 else 7.0} if node == "dy" else {}

    rows = simulated(prepared, TICKS)
    path = written(tmp_path / "r.mcap", recorded_of(prepared), attachments_of(prepared), rows, clipped)
    code, out, _ = audited(path)
    assert code == 1
    assert "force limits: broken by dy since 0.2 s (7 ticks)" in out


def test_a_frozen_user_costs_the_certificate_nothing(prepared: Prepared, tmp_path: Path) -> None:
    rows = simulated(prepared, 400, [Silence("cx", 150, 220)])
    path = written(tmp_path / "r.mcap", recorded_of(prepared), attachments_of(prepared), rows)
    code, out, told = audited(path)
    assert code == 0
    assert "presence: enforced at cx from 0.1 s to 0.2 s (1 time, 0.07 s)" in out
    assert "holds (58 of 58 checks)" in out.splitlines()[-1]
    promises = told["promises"]
    assert isinstance(promises, list)
    [row] = [row for row in promises if row["promise"] == "presence" and row["state"] != "kept"]
    assert (row["who"], row["since"], row["until"]) == (["cx"], 0.15, 0.22)


def test_what_the_session_has_shown_and_what_is_found_are_one_row(prepared: Prepared, run: RecordedRun) -> None:
    figures = {**run.figures, "dx": [*run.figures["dx"], (TICKS, {"ledger_margin": -0.5})]}
    told = type(run)(run.recorded, run.traces, figures)
    [row] = missed(promises_of(prepared, told, [check("bound", "dx", BROKEN, differing=2)]))
    assert (row.state, row.since, row.cost) == ("broken", 0.12, {"ticks": 2.0, "J": 0.5})
    [row] = missed(promises_of(prepared, told, [check("bound", "dx", HOLDS)]))
    assert row == PromiseStatus(
        "passivity", "broken", ("dx",), 1e-3 * TICKS, None, {"J": 0.5}, "dx: its ledger fell 0.5 J below its bound"
    )


def test_what_the_supervisors_clock_showed_is_what_an_audit_says(prepared: Prepared, run: RecordedRun) -> None:
    """The pace and who was away, by the last condition, as the page and the report had them."""
    paced = type(run)(replace(run.recorded, clock="realtime"), run.traces, run.figures)
    slow = PromiseStatus("pace", "broken", ("session",), 0.1, None, {"x": 0.6, "s": 2.0}, "it runs slower")
    away = PromiseStatus("presence", "broken", ("cx",), 0.15, 0.2, {"s": 0.05}, "cx: lost")
    of_nobody = PromiseStatus("presence", "broken", ("stranger",), 0.15)
    kept = PromiseStatus("pace", "kept", since=0.0)

    def told(*conditions: tuple[PromiseStatus, ...]) -> list[PromiseStatus]:
        shown = [(TICKS, Condition("over", 1.0, {}, (), (), (), (), rows)) for rows in conditions]
        return missed(promises_of(prepared, replace(paced, conditions=shown), []))

    assert told((kept,), (kept, slow, away, of_nobody)) == [slow, away]
    assert told((slow,), (kept,)) == []
    [unknown] = told()
    assert (unknown.promise, unknown.state, unknown.who) == ("pace", "not checked", ("session",))
    frozen = {**run.figures, "environment": [(TICKS, Figures({"frozen:cx@150": 1.0}))]}
    [graver] = missed(promises_of(prepared, replace(run, figures=frozen, conditions=[
        (TICKS, Condition("over", 1.0, {}, (), (), (), (), (away,)))
    ]), []))  # fmt: skip
    assert graver == away
