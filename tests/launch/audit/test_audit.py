"""An audit agrees with every honest recording, and reports later changes with their tick and party."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Mapping
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner

from manyhands.design.certificate import from_content, to_json
from manyhands.launch.app.audit_report import print_audit
from manyhands.launch.app.cli import app
from manyhands.launch.audit.audit import Audit, AuditVerdict, audit
from manyhands.launch.audit.checks import bounded, period_assumed
from manyhands.launch.audit.coupling import FollowedCoupling
from manyhands.launch.audit.device import DeviceRows, FollowedDevice, FollowedInOwnTime, FollowedInWallTime
from manyhands.launch.audit.events import Course, Happening, course_of
from manyhands.launch.audit.findings import Check, CheckVerdict, UncheckedTicks, compare
from manyhands.launch.audit.recompute import recompute
from manyhands.launch.audit.simulation import Silence
from manyhands.launch.plan.bundles import RunPlan as Way
from manyhands.launch.plan.bundles import cut
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.recordings.integrity import findings
from manyhands.launch.recordings.run import FiguresByTick, first_sign, read_run, there
from manyhands.launch.session import load_session
from manyhands.nodes.coupling.core import CouplingCore
from manyhands.nodes.device.core import DeviceCore
from manyhands.nodes.device.drivers import Driver, driver_of
from manyhands.nodes.device.tick import WallTimeTick
from manyhands.nodes.kernel.bundle import REALTIME, SIMULATED, CouplingBundle, DeviceBundle
from manyhands.nodes.recorder.format import CERTIFICATE_FILE
from manyhands.protocol.channels import LEDGER, TAU
from tests.support.instants import instant

from ...support.simulated_recordings import (
    SESSIONS,
    TICKS,
    attachments_of,
    forged,
    prepared_as,
    recorded_of,
    simulated,
    written,
)

AT = 217

Rows = dict[tuple[str, str], np.ndarray]


def test_an_environment_that_raised_all_forces_again_is_computed_anew_up_to_there(recording: Path) -> None:
    """Otherwise the ramp, of which no coupling and no device knows, would look like a forged row of the environment."""
    run = read_run(recording)
    figures = [
        (tick, of.with_numbers({"raised@57": 1.0} if tick > 57 else {})) for tick, of in run.figures["environment"]
    ]
    assert first_sign(run, "environment") == (run.ticks, "")
    raised = dataclasses.replace(run, figures={**run.figures, "environment": figures})
    assert first_sign(raised, "environment") == (57, "the devices had waited")


def audited(path: Path) -> Audit:
    return audit(path, read_run(path), lambda text: None, lambda tick: None)


def found(done: Audit, party: str, name: str) -> Check:
    return next(check for check in done.checks if (check.party, check.name) == (party, name))


def broken(done: Audit) -> dict[tuple[str, str], int]:
    """By party and name of the checks that do not hold, the first tick that differs."""
    return {(check.party, check.name): -1 if check.first is None else check.first.tick for check in done.broken}


@pytest.mark.parametrize(
    "kind", ["example1", "example1-operator", "linear", "enforced", "series", "carry", "steering", "stroke"]
)
def test_an_honest_recording_holds_to_the_last_bit(kind: str, tmp_path: Path) -> None:
    prepared = prepared_as(kind)
    rows = simulated(prepared, TICKS)
    done = audited(written(tmp_path / "r.mcap", recorded_of(prepared), attachments_of(prepared), rows))
    assert broken(done) == {}
    assert done.holds
    nodes = recorded_of(prepared).roles
    for node in nodes:
        ledger = found(done, node, "ledger")
        assert (ledger.verdict, ledger.numbers, ledger.gaps, ledger.tolerance) == (CheckVerdict.HOLDS, TICKS, (), 0.0)
        assert found(done, node, "bound").verdict is CheckVerdict.HOLDS
    for check in done.checks:
        assert check.verdict is CheckVerdict.HOLDS, check
    work = found(done, "environment", "work")
    assert (work.numbers, work.tolerance < 1e-13) == (TICKS, True)
    assert sum(check.numbers for check in done.checks) > 20 * TICKS


def one(node: str, trace: str, by: float) -> Callable[[Rows], None]:
    def change(rows: Rows) -> None:
        rows[node, trace][AT, 0] += by

    return change


def shifted(node: str) -> Callable[[Rows], None]:
    def change(rows: Rows) -> None:
        rows[node, LEDGER] += 1e-3

    return change


def both_forces(rows: Rows) -> None:
    rows["dy", "f_v"][AT] += 1e-6
    rows["cy", "f_v"][AT] += 1e-6


FORGED: Mapping[str, tuple[Callable[[Rows], None], dict[tuple[str, str], int]]] = {
    "one number of a device's ledger": (one("dx", LEDGER, 1e-12), {("dx", "ledger"): AT}),
    "one number of a coupling's ledger": (one("cz", LEDGER, 1e-12), {("cz", "ledger"): AT}),
    "one number of the environment's": (
        one("environment", LEDGER, 1e-12),
        {("environment", "ledger"): AT, ("environment", "work"): AT},
    ),
    "a whole ledger, by 1 mJ": (shifted("dx"), {("dx", "ledger"): 0}),
    "a whole ledger of a coupling": (shifted("cy"), {("cy", "ledger"): 0}),
    "a whole ledger of the environment": (
        shifted("environment"),
        {("environment", "ledger"): 0, ("environment", "work"): 0},
    ),
    "a device's force": (
        one("dy", "f_v", 1e-9),
        {("cy", "agreement"): AT, ("dy", "ledger"): AT, ("dy", "signal"): AT + 1},
    ),
    "a coupling's force": (
        one("cy", "f_v", 1e-9),
        {
            ("cy", "agreement"): AT,
            ("cy", "ledger"): AT,
            ("cy", "signal"): AT + 1,
            ("environment", "forces"): AT,
            ("environment", "agreement"): AT,
            ("environment", "work"): AT,
        },
    ),
    "the force of both": (
        both_forces,
        {
            ("cy", "ledger"): AT,
            ("cy", "signal"): AT + 1,
            ("dy", "ledger"): AT,
            ("dy", "signal"): AT + 1,
            ("environment", "forces"): AT,
            ("environment", "agreement"): AT,
            ("environment", "work"): AT,
        },
    ),
    "a displacement": (
        one("dz", "x", 1e-9),
        {("dz", "signal"): AT, ("dz", "ledger"): AT, ("cz", "signal"): AT},
    ),
    "a tool": (
        one("environment", "x_e", 1e-9),
        {("environment", "tools"): AT, ("environment", "agreement"): AT, ("environment", "work"): AT},
    ),
    "a mass": (one("environment", "q", 1e-9), {("environment", "masses"): AT}),
}


@pytest.mark.parametrize("what", FORGED)
def test_what_was_changed_is_found_at_its_tick_and_party(what: str, recording: Path, tmp_path: Path) -> None:
    change, expected = FORGED[what]
    done = audited(forged(tmp_path / "forged.mcap", read_run(recording), change))
    assert not done.holds
    ticks = broken(done)
    assert expected.items() <= ticks.items()
    others = {key for key in ticks if key not in expected}
    assert {party for party, _ in others} <= {party for party, _ in expected}, others
    assert min(ticks.values()) == min(expected.values())


def test_the_recorded_and_the_expected_value_are_reported(recording: Path, tmp_path: Path) -> None:
    honest = read_run(recording).traces["dx", "ledger"].values[AT, 0]
    done = audited(forged(tmp_path / "forged.mcap", read_run(recording), one("dx", LEDGER, 1e-3)))
    first = found(done, "dx", "ledger").first
    assert first is not None
    assert (first.tick, first.column, first.recorded, first.recomputed) == (AT, "E", honest + 1e-3, honest)


def last_line(done: Audit) -> str:
    """The line that a person reads last."""
    shown = StringIO()
    print_audit(Console(file=shown, width=500), "r.mcap", done)
    return shown.getvalue().splitlines()[-1]


def test_a_frozen_couplings_gap_is_reported_and_the_rest_is_checked(prepared: Prepared, tmp_path: Path) -> None:
    rows = simulated(prepared, 600, [Silence("cx", 150, 220), Silence("cz", 260, 300)])
    path = written(tmp_path / "r.mcap", recorded_of(prepared), attachments_of(prepared), rows)
    done = audited(path)
    assert broken(done) == {}
    ledger = found(done, "cx", "ledger")
    assert (ledger.numbers, ledger.gaps) == (600 - 70, ())  # a process that begins anew is recomputed, too
    for name in ("tools", "masses", "forces", "ledger"):
        check = found(done, "environment", name)
        assert [(gap.begin, gap.end) for gap in check.gaps] == [(150, 600)]
        assert check.verdict is CheckVerdict.HOLDS
    work = found(done, "environment", "work")
    assert (work.numbers, work.gaps) == (600, ())
    assert last_line(done).endswith("; ticks without a check of the ledger: 75 % of environment's")
    few = dataclasses.replace(
        done, checks=(done.checks[0], dataclasses.replace(ledger, gaps=(UncheckedTicks(0, 2, ""),)))
    )
    assert last_line(few).endswith("; ticks without a check of the ledger: less than 1 % of cx's")

    change = one("environment", LEDGER, 1e-9)  # behind the gap, where no core is followed any more
    assert broken(audited(forged(tmp_path / "f.mcap", read_run(path), change))) == {("environment", "work"): AT}

    def later(rows: Rows) -> None:
        rows["environment", LEDGER][400:] += 1e-3

    forged_later = audited(forged(tmp_path / "l.mcap", read_run(path), later))
    assert broken(forged_later)["environment", "work"] == 400


def bundle_of(prepared: Prepared, name: str) -> object:
    return cut(prepared, Way(SIMULATED, None, ""))[name]


def course(bundle: DeviceBundle | CouplingBundle, figures: FiguresByTick, rows: np.ndarray) -> Course:
    return course_of(figures, there(rows), len(bundle.rungs))


def own_time(bundle: DeviceBundle, make: Callable[[], Driver | str], x: np.ndarray, f: np.ndarray) -> FollowedDevice:
    """A device in its own time that felt what its coupling handed on."""
    none = np.full((len(x), 3), np.nan)
    return FollowedInOwnTime(bundle, make, DeviceRows(x, f, f, none, none, None, np.zeros(len(x), dtype=np.bool_)))


def played_device(
    bundle: DeviceBundle, f: list[float], free: Mapping[int, int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x, f and ledger of a device that ran free for so many periods before those ticks."""
    driver, core = driver_of(bundle), DeviceCore(*bundle.promises[0], bundle.common.period)
    turn, x, energy = 0, [], []
    for k, force in enumerate(f):
        for _ in range(free.get(k, 0)):
            at = driver.sample(turn, instant(turn))
            driver.apply([0.0], instant(turn))
            core.sample(at)
            core.apply([0.0], driver.intended_work())
            turn += 1
        at = driver.sample(turn, instant(turn))
        driver.apply([force], instant(turn))
        core.sample(at)
        core.apply([force], driver.intended_work())
        turn += 1
        x.append(at)
        energy.append([core.ledger.total])
    return np.array(x), np.array(f)[:, None], np.array(energy)


@pytest.mark.parametrize("free", [{250: 7}, {160: 1, 200: 3}, {3: 5}, {20: 2, 180: 4}])
def test_a_device_that_ran_free_is_followed(prepared: Prepared, free: Mapping[int, int]) -> None:
    bundle = bundle_of(prepared, "dx")
    assert isinstance(bundle, DeviceBundle)
    # at rest until its hand pushes, at 100 ticks
    f = [0.0 if k < 120 else 0.3 * np.sin(0.05 * k) for k in range(TICKS)]
    x, force, energy = played_device(bundle, f, free)
    figures = [
        (
            tick,
            {"released": float(sum(n for k, n in free.items() if k < tick))}
            | {f"released@{k}": float(n) for k, n in free.items() if tick - 50 <= k < tick},
        )
        for tick in range(50, TICKS + 50, 50)
    ]
    again = recompute(own_time(bundle, lambda: driver_of(bundle), x, force), course(bundle, figures, x))
    np.testing.assert_array_equal(again["x"], x)
    np.testing.assert_array_equal(again["ledger"], energy)
    assert again.gaps == []
    # without a word of it in its figures it is another motion
    blind = recompute(own_time(bundle, lambda: driver_of(bundle), x, force), course(bundle, [], x))
    assert not compare("signal", "dx", "", ("dx",), x, blind["x"]).holds
    # with a count of them alone it is believed from the telemetry before on
    counted = [(tick, {"released": told["released"]}) for tick, told in figures]
    unsure = recompute(own_time(bundle, lambda: driver_of(bundle), x, force), course(bundle, counted, x))
    begin = min(free) // 50 * 50
    assert [(gap.begin, gap.end) for gap in unsure.gaps] == [(begin, TICKS)]
    np.testing.assert_array_equal(unsure["x"][:begin], x[:begin])
    assert np.isnan(unsure["ledger"][begin:]).all()


def test_a_device_that_is_lost_is_believed_from_there_on(prepared: Prepared) -> None:
    bundle = bundle_of(prepared, "dx")
    assert isinstance(bundle, DeviceBundle)
    x, force, _ = played_device(bundle, [0.1] * TICKS, {})
    x[200:] += 1e-3
    x[190:200] = np.nan
    again = recompute(own_time(bundle, lambda: driver_of(bundle), x, force), course(bundle, [], x))
    assert [(gap.begin, gap.end) for gap in again.gaps] == [(200, TICKS)]
    assert np.isnan(again["ledger"][190:]).all()
    np.testing.assert_array_equal(again["x"][:190], x[:190])


def test_a_device_that_a_person_moved_is_believed(prepared: Prepared) -> None:
    bundle = bundle_of(prepared, "dx")
    assert isinstance(bundle, DeviceBundle)
    x = np.zeros((9, 1))
    device = own_time(bundle, lambda: "a person moved it", x, x)
    again = recompute(device, course(bundle, [], x))
    assert np.isnan(again["ledger"]).all()
    assert [(gap.begin, gap.end) for gap in device.motion_gaps] == [(0, 9)]


def test_a_coupling_that_changed_its_rung_is_followed(prepared: Prepared) -> None:
    bundle = bundle_of(prepared, "cx")
    assert isinstance(bundle, CouplingBundle)
    rung = 1
    assert len(bundle.rungs) > rung
    rng = np.random.default_rng(3)
    x, f = np.cumsum(rng.normal(size=(TICKS, 1)), axis=0) * 1e-5, rng.normal(size=(TICKS, 1))
    f[150:160] = 0.0
    p, energy = np.zeros_like(x), np.zeros_like(x)
    core = CouplingCore(bundle.block, bundle.K, bundle.level, bundle.common.period, bundle.limits.force)
    for k in range(TICKS):
        p[k] = core.free_position(x[k].tolist())
        if k == 150:
            of = bundle.rungs[rung]
            core.change(of.block, of.K, of.level)
        core.absorb(f[k].tolist())
        assert core.ledger is not None
        energy[k] = core.ledger.total
    counted = [(100, {"rung": 0.0}), (200, {"rung": 1.0}), (300, {"rung": 1.0})]
    figures = [(tick, {**told, **({"rung@150": 1.0} if tick == 200 else {})}) for tick, told in counted]
    again = recompute(FollowedCoupling(bundle, x, p, f), course(bundle, figures, p))
    np.testing.assert_array_equal(again["p"], p)
    np.testing.assert_array_equal(again["ledger"], energy)
    assert (course(bundle, figures, p).in_force, again.gaps) == ([(150, 1)], [])
    blind = recompute(FollowedCoupling(bundle, x, p, f), course(bundle, [], p))
    first = compare("signal", "cx", "", ("dx",), p, blind["p"]).first
    assert first is not None
    assert first.tick == 151
    # with the rung among its figures alone it is believed from the telemetry before on
    unsure = recompute(FollowedCoupling(bundle, x, p, f), course(bundle, counted, p))
    assert [(gap.begin, gap.end) for gap in unsure.gaps] == [(100, TICKS)]
    assert np.isnan(unsure["p"][100:]).all()
    np.testing.assert_array_equal(unsure["p"][:100], p[:100])


def test_a_process_that_came_back_begins_at_rest(prepared: Prepared) -> None:
    bundle = bundle_of(prepared, "dx")
    assert isinstance(bundle, DeviceBundle)
    one, two = (played_device(bundle, [0.1] * n, {}) for n in (100, TICKS - 130))
    hole = np.full((30, 1), np.nan)
    x, f, energy = (np.vstack([before, hole, after]) for before, after in zip(one, two, strict=True))
    figures: list[tuple[int, dict[str, float]]] = [(100, {"began@0": 1.0}), (200, {"began@130": 1.0})]
    again = recompute(own_time(bundle, lambda: driver_of(bundle), x, f), course(bundle, figures, x))
    np.testing.assert_array_equal(again["x"], x)
    np.testing.assert_array_equal(again["ledger"], energy)
    assert again.gaps == []


def test_a_device_left_behind_goes_on_from_its_position(prepared: Prepared) -> None:
    bundle = bundle_of(prepared, "dx")
    assert isinstance(bundle, DeviceBundle)
    played = played_device(bundle, [0.1] * 100 + [0.0] * 200, {100: 4})
    x, f, energy = (np.vstack([rows[:100], np.full((30, 1), np.nan), rows[100:]]) for rows in played)
    happened = {"jumped@130": 100.0, "released@101": 3.0, "released@130": 1.0}
    figures = [(100, {"began@0": 1.0}), (230, {"released": 4.0} | happened), (330, {"released": 4.0})]
    again = recompute(own_time(bundle, lambda: driver_of(bundle), x, f), course(bundle, figures, x))
    np.testing.assert_array_equal(again["x"], x)
    np.testing.assert_array_equal(again["ledger"], energy)
    lost = [(100, {"began@0": 1.0}), (330, {"released": 4.0})]  # a telemetry that never came
    assert course(bundle, lost, x).unknown == [UncheckedTicks(130, 330, "it had rows missing, and no event states why")]


def test_a_process_that_begins_behind_the_session_has_jumped_before_its_first_row(prepared: Prepared) -> None:
    bundle = bundle_of(prepared, "dx")
    assert isinstance(bundle, DeviceBundle)
    rows = np.zeros((300, 1))
    figures = [(100, {"began@0": 1.0, "jumps": 0.0}), (200, {"began@130": 1.0, "jumps": 1.0}), (300, {"jumps": 1.0})]
    before = course(bundle, figures, rows).before
    assert (before[0].began, before[0].jumped) == (True, False)
    assert (before[130].began, before[130].jumped) == (True, True)


def test_a_device_in_wall_time_is_told_of_a_jump_before_it_exerts_again(
    prepared: Prepared, monkeypatch: pytest.MonkeyPatch
) -> None:
    bundle = cut(prepared, Way(REALTIME, None, ""))["dx"]
    assert isinstance(bundle, DeviceBundle)
    calls: list[str] = []
    for name in ("skipped", "exert"):
        told = getattr(WallTimeTick, name)

        def call(tick: WallTimeTick, *given: object, name: str = name, told: Callable[..., object] = told) -> object:
            calls.append(name)
            return told(tick, *given)

        monkeypatch.setattr(WallTimeTick, name, call)
    at, x, ticks = 1e6 * np.arange(9.0), np.zeros((9, 1)), 9
    instants = np.column_stack([at, at + 2e5, at + 2e5])
    rows = DeviceRows(x, x, x, instants, x, None, np.zeros(ticks, dtype=np.bool_))
    recompute(FollowedInWallTime(bundle, lambda: "given", rows), Course({5: Happening(jumped=True)}, {}, ticks))
    assert calls == [*["exert"] * 5, "skipped", *["exert"] * 4]


@pytest.mark.parametrize("asked", [0.0, 0.5])
def test_which_force_was_asked_of_a_device_that_had_let_go_is_not_guessed(prepared: Prepared, asked: float) -> None:
    """After a jump it is that of its coupling's row, or none; a device that exerts none of either does not show it."""
    bundle = cut(prepared, Way(REALTIME, None, ""))["dx"]
    assert isinstance(bundle, DeviceBundle)
    at, ticks = 1e6 * np.arange(9.0), 9
    x, f, zero = np.zeros((ticks, 1)), np.full((ticks, 1), asked), np.zeros((ticks, 1))
    x[3] = 10.0 * bundle.limits.displacement[0]
    instants = np.column_stack([at, at + 2e5, at + 2e5])
    rows = DeviceRows(x, np.where(np.arange(ticks)[:, None] < 3, f, 0.0), f, instants, zero, 3, zero[:, 0] > 0.0)
    again = recompute(FollowedInWallTime(bundle, lambda: "given", rows), Course({5: Happening(jumped=True)}, {}, ticks))
    found = [(gap.begin, gap.end) for gap in again.gaps if "one of two forces" in gap.why]
    assert found == ([(5, ticks)] if asked else [])
    assert np.isfinite(again["interface"][:5]).all()
    assert np.isfinite(again["interface"][5:]).all() == (asked == 0.0)


def test_more_free_periods_than_are_computed_end_the_check(prepared: Prepared) -> None:
    bundle = bundle_of(prepared, "dx")
    assert isinstance(bundle, DeviceBundle)
    x, f, _ = played_device(bundle, [0.1] * 50, {})
    figures = [(50, {"began@0": 1.0, "released": 1e15, "released@20": 1e15})]
    again = recompute(own_time(bundle, lambda: driver_of(bundle), x, f), course(bundle, figures, x))
    assert [(gap.begin, gap.end) for gap in again.gaps] == [(20, 50)]


def test_a_rung_beyond_the_ladder_is_no_rung(prepared: Prepared) -> None:
    bundle = bundle_of(prepared, "cx")
    assert isinstance(bundle, CouplingBundle)
    found = course(bundle, [(50, {"began@0": 1.0, "rung@20": 99.0})], np.zeros((50, 1)))
    assert (found.in_force, [gap.begin for gap in found.unknown]) == ([], [20])


def test_a_coupling_killed_before_it_could_report_is_not_called_forged(prepared: Prepared, tmp_path: Path) -> None:
    rows = simulated(prepared, 600, [Silence("cx", 250, 400)])
    for trace in ("p", "f_v", LEDGER):
        rows["cx", trace][200:250] = np.nan  # its last ticks, without telemetry
    figures = {"frozen:cx@250": 1.0, "returned:cx@400": 1.0}

    def told(node: str, tick: int) -> Mapping[str, float]:
        return figures if (node, tick) == ("environment", 600) else {}

    parts = recorded_of(prepared), attachments_of(prepared)
    done = audited(written(tmp_path / "r.mcap", *parts, rows, told, frozen=False))
    assert broken(done) == {}
    work = found(done, "environment", "work")
    assert [(gap.begin, gap.end) for gap in work.gaps] == [(200, 250)]
    assert work.numbers == 550
    # of a recording without a word of that less is known
    done = audited(written(tmp_path / "s.mcap", *parts, rows, frozen=False))
    assert broken(done) == {}
    # and the first row of its return may be of another tick than the environment's
    assert [(gap.begin, gap.end) for gap in found(done, "environment", "work").gaps] == [(200, 400), (400, 402)]
    assert done.verdict is AuditVerdict.UNCHECKED


def test_a_recording_from_before_the_events_is_audited() -> None:
    path = Path(__file__).parents[1] / "data" / "recording-0.6.0.mcap"
    run = read_run(path)
    assert not any("@" in name for told in run.figures.values() for _, figures in told for name in figures)
    done = audited(path)
    assert {check.verdict for check in done.checks} == {CheckVerdict.HOLDS}
    assert (done.ticks, findings(path)) == (30, [])
    code, out, _ = invoke("replay", path)
    assert code == 0
    assert "identical" in out


def test_a_ledger_below_zero_is_a_broken_promise(recording: Path) -> None:
    run = read_run(recording)
    assert bounded(run, "dx").verdict is CheckVerdict.HOLDS
    run.traces["dx", "ledger"].values[AT] = -1e-9
    check = bounded(run, "dx")
    assert check.verdict is CheckVerdict.BROKEN
    assert check.first is not None
    assert (check.first.tick, check.first.recorded) == (AT, -1e-9)
    assumed = bounded(run, "dx", promised=False)
    assert (assumed.verdict, assumed.holds, assumed.first) == (CheckVerdict.ASSUMPTION, True, check.first)
    assert assumed.what.endswith("what lateness puts in is not enforced")
    run.traces["dx", "ledger"].values[:] = np.nan
    assert bounded(run, "dx").verdict is CheckVerdict.UNCHECKED


def test_limits_and_assumptions(recording: Path, tmp_path: Path) -> None:
    def change(rows: Rows) -> None:
        rows["dx", TAU][AT:] = 1500.0
        rows["dy", "x"][AT] = 11.0

    done = audited(forged(tmp_path / "f.mcap", read_run(recording), change))
    tau = found(done, "dx", "tau")
    assert (tau.verdict, tau.holds, tau.differing) == (CheckVerdict.ASSUMPTION, True, TICKS - AT)
    assert tau.first is not None
    assert tau.first.tick == AT
    assert found(done, "dy", "tau").verdict is CheckVerdict.HOLDS
    assert {check.first.tick for check in done.broken if check.name == "limits" and check.first} == {AT}


def test_the_period_that_is_assumed_is_the_certificates(recording: Path) -> None:
    run = read_run(recording)
    for rho, most in ((0.0, "1"), (0.4, "1.4")):
        text = f"samples are at most {most} T apart, or more after an early force, as the device counted"
        assert period_assumed(run, "dx", rho).what == text
    assert period_assumed(run, "dx", 0.0).verdict is CheckVerdict.HOLDS
    tick, told = run.figures["dx"][-1]
    run.figures["dx"][-1] = tick, told.with_numbers({"period_breaches": 3.0})
    check = period_assumed(run, "dx", 0.0)
    assert (check.verdict, check.remark) == (CheckVerdict.ASSUMPTION, "not in 3 ticks")


def test_a_certificate_that_proves_nothing_is_found(prepared: Prepared, tmp_path: Path) -> None:
    assert prepared.certificate is not None
    data = json.loads(to_json(prepared.certificate))
    data["levels"]["Phi_E"] = {name: [[-10.0]] for name in ("cx", "cy", "cz")}
    parts = attachments_of(prepared) | {CERTIFICATE_FILE: to_json(from_content(data)).encode()}
    done = audited(written(tmp_path / "r.mcap", recorded_of(prepared), parts, simulated(prepared, 20)))
    (check,) = done.checks
    assert (check.name, check.holds) == ("certificate", False)
    assert "not proved" in check.remark


def test_another_certificate_than_that_of_the_run_is_found(prepared: Prepared, tmp_path: Path) -> None:
    recorded = dataclasses.replace(recorded_of(prepared), certificate="0" * 64)
    done = audited(written(tmp_path / "r.mcap", recorded, attachments_of(prepared), simulated(prepared, 20)))
    assert broken(done) == {("session", "certificate"): -1}
    assert "which its session ran under by its metadata" in done.checks[0].remark


def invoke(*arguments: str | Path) -> tuple[int, str, str]:
    done = CliRunner().invoke(app, [*map(str, arguments)])
    return done.exit_code, done.stdout, done.stderr


def test_the_command_agrees(recording: Path) -> None:
    code, out, _ = invoke("audit", recording)
    assert code == 0
    assert out.splitlines()[-1] == f"{recording}: holds (58 of 58 checks)"
    assert "proved again, and this session's" in out
    code, out, _ = invoke("audit", recording, "--json")
    told = json.loads(out)
    assert (code, told["holds"], told["ticks"], told["damage"]) == (0, True, TICKS, [])
    assert {check["verdict"] for check in told["checks"]} == {"holds"}


def test_the_command_names_tick_and_party(recording: Path, tmp_path: Path) -> None:
    path = forged(tmp_path / "forged.mcap", read_run(recording), one("dx", LEDGER, 1e-3))
    code, out, _ = invoke("audit", path)
    assert code == 1
    assert f"broken: dx: ledger: differs first at tick {AT}, E: recorded " in out
    assert f"{path}: does not hold: " in out.splitlines()[-1]


def test_an_uncertified_recording_is_refused(tmp_path: Path) -> None:
    session = load_session(SESSIONS / "example1-uncoupled.yaml")
    prepared = prepare(session, uncertified=True)
    rows = simulated(prepared, 50)
    path = written(tmp_path / "r.mcap", recorded_of(prepared), attachments_of(prepared), rows)
    code, out, err = invoke("audit", path)
    assert (code, out) == (2, "")
    assert "found no certificate in it" in err
    code, out, _ = invoke("replay", path)
    assert code == 0
    assert "identical" in out


def test_what_a_clutch_gives_up_at_last_is_within_the_tolerance(tmp_path: Path) -> None:
    hand = "{operator: {num: [0.02, 1.2, 20], den: [1, 10.3, 100]}, stiffness: 500, motion: '0.03*sin(7*t)'}"
    prepared = prepare(load_session(SESSIONS / "example1.yaml", [f"devices.dx.hand={hand}", "design.ladder=[]"]))
    rows = simulated(prepared, 4300, [Silence("cx", 10, 12)])
    path = written(tmp_path / "r.mcap", recorded_of(prepared), attachments_of(prepared), rows)
    done = audited(path)
    work = found(done, "environment", "work")
    assert (done.holds, work.numbers) == (True, 4300)
    assert 1e-6 < work.tolerance < 1e-5  # in the one tick in which the last offset is let go
    assert "and in 1 ticks LET_GO" in work.source

    def gained(rows: Rows) -> None:  # what is let go is given up, and not gained
        rows["environment", LEDGER][2000:] += 1e-6

    assert broken(audited(forged(tmp_path / "f.mcap", read_run(path), gained)))["environment", "work"] == 2000


def test_a_device_that_has_let_go_did_as_it_should(prepared: Prepared, tmp_path: Path) -> None:
    """Its messages to the couplings, and its use of their forces, follow from its displacement."""
    overrides = ["devices.dx.limits={speed: 0.01}", "devices.dy.limits={power: 0.001, energy: 0.002}"]
    session = load_session(SESSIONS / "example1.yaml", overrides)
    slow = dataclasses.replace(prepared, session=session)
    rows = simulated(slow, TICKS)
    path = written(tmp_path / "a.mcap", recorded_of(slow), attachments_of(slow), rows)
    beyond = np.abs(np.diff(rows["dx", "x"], axis=0)) > 1e-5
    assert beyond.any()
    assert np.all(rows["dx", "f_v"][1:][beyond] == 0.0)
    assert not [check for check in audited(path).broken if check.party != "environment"]
    felt = rows["dx", "f_v"].copy()
    felt[1:][beyond] = 0.5  # it had not let go
    forged = written(tmp_path / "b.mcap", recorded_of(slow), attachments_of(slow), {**rows, ("dx", "f_v"): felt})
    broken = {(check.party, check.name) for check in audited(forged).broken}
    assert {("dx", "limits"), ("cx", "agreement")} <= broken
