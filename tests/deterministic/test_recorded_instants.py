"""An audit computes devices in wall time again from their recorded instants, and finds every number that was changed.

The recording is of a whole session in virtual time under the realtime clock. Its certificate covers no delay, so the
interfaces of its devices change motions and forces. Processes are stopped for a while, and one is killed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from manyhands.launch.audit.audit import Audit, AuditVerdict, audit
from manyhands.launch.audit.checks import account_bounded
from manyhands.launch.audit.findings import ABSENT, Check, CheckVerdict
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.recordings.run import RecordedRun, read_run
from manyhands.launch.session import load_session
from manyhands.nodes.device.node import DeviceNode
from manyhands.nodes.kernel.allowance import LatenessAllowance
from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.recorder.core import RecorderCore
from manyhands.nodes.rows import figures as names
from manyhands.nodes.rows.tick_events import Kind, events_in
from manyhands.protocol.codec import encode
from manyhands.protocol.messages import Figures, Observation
from tests.support.forged_recordings import REALTIME, Forged
from tests.support.simulated_recordings import SESSIONS, START, attachments_of, recorded_of

from .recorded import Told, WatchedSession, audited
from .world import SimulatedSession

MS = 1_000_000  # ns
TICKS = 650
DEVICES = ("dx", "dy", "dz")
OF_A_DEVICE = ("signal", "applied", "exerted", "interface", "given", "ended", "instants", "account", "ledger", "bound")


def faults(session: SimulatedSession) -> None:
    def plan(at: float, act: Callable[[], None]) -> None:
        session.scheduler.after(int(at * MS), act)

    plan(250, lambda: session.stop("dx", 3 * MS))
    plan(300, lambda: session.stop("cy", 20 * MS))
    plan(400, lambda: session.stop("environment", 30 * MS))
    plan(500, lambda: session.kill("dz"))


@pytest.fixture(scope="module")
def prepared() -> Prepared:
    wishes = ["design.tau=0", "design.ladder=[]", "design.objective=stiffest", "faults.breach=warn",
              "faults.tank=1e-6"]  # fmt: skip
    return prepare(load_session(SESSIONS / "example1.yaml", wishes))


@pytest.fixture(scope="module")
def told(prepared: Prepared) -> Told:
    session = WatchedSession(prepared, faults)
    assert session.violations == []
    return session.told


def test_a_device_beyond_its_limits_is_followed(tmp_path: Path) -> None:
    """Its guard sends a displacement of its own, and lets it exert a part of what it is asked for.

    The couplings change their rungs as well. Their clutches open a hundred ticks before, and the environment says so.
    """
    prepared = prepare(load_session(SESSIONS / "example1.yaml", ["devices.dy.limits={displacement: 0.002}"]))
    told = WatchedSession(prepared, lambda session: None).told
    assert told["dy"][-1].figures[names.LET_GO] > 0
    done = audited(tmp_path / "r.mcap", prepared, told)
    assert broken(done) == {}
    assert {event.kind for of in told["cx"] for event in events_in(of.figures)} == {Kind.BEGAN, Kind.RUNG}
    assert check_of(done, "environment", "forces").numbers > 0
    for name, what in (("dy", "exerted"), ("dy", "interface"), ("dy", "ledger"), ("cy", "signal"), ("cy", "agreement")):
        check = check_of(done, name, what)
        assert (check.verdict, check.numbers, check.gaps) == (CheckVerdict.HOLDS, TICKS, ()), check


@pytest.mark.parametrize("depth", ["depth: 2", "depth: 0"])
def test_a_wave_link_that_joins_in_the_first_tick_breaks_nobodys_promise(depth: str, tmp_path: Path) -> None:
    """Its depth is stated, so that it has a row from tick 0 on, while its clutch is still open."""
    linked = f"couplings.cx.wave_link={{b: 20, {depth}, tau: 0.0003}}"
    pushed = "devices.dx.hand.force=2*pulse(t, 0, 0.1)"
    prepared = prepare(load_session(SESSIONS / "example1.yaml", [linked, pushed, "design.tau=0.0003"]))
    told = WatchedSession(prepared, lambda session: None, 250).told
    done = audited(tmp_path / "r.mcap", prepared, told)
    assert broken(done) == {}
    assert check_of(done, "environment", "work").numbers > 200


def check_of(done: Audit, party: str, name: str) -> Check:
    return next(check for check in done.checks if (check.party, check.name) == (party, name))


def broken(done: Audit) -> dict[tuple[str, str], int]:
    return {(check.party, check.name): -1 if check.first is None else check.first.tick for check in done.broken}


def test_an_honest_recording_in_real_time_holds_to_the_end(prepared: Prepared, told: Told, tmp_path: Path) -> None:
    done = audited(tmp_path / "r.mcap", prepared, told)
    assert broken(done) == {}
    happened = {event.kind for messages in told.values() for of in messages for event in events_in(of.figures)}
    assert {Kind.BEGAN, Kind.RELEASED, Kind.JUMPED} <= happened
    for name in DEVICES:
        rows = sum(len(message.traces[names.TAU]) for message in told[name])
        for check in (check_of(done, name, what) for what in OF_A_DEVICE):
            killed = name == "dz"  # its last rows were never reported
            assert check.verdict is CheckVerdict.HOLDS, check
            assert {gap.why for gap in check.gaps} <= ({ABSENT} if killed else set()), check
            assert check.tolerance == 0.0 or check.name in ("ledger", "account", "bound")
        assert check_of(done, name, "interface").numbers == check_of(done, name, "ledger").numbers == rows
        assert check_of(done, name, "ledger").tolerance < 1e-10

    # the interfaces have changed motions and forces
    assert min(told[name][-1].figures[names.INTERFACE_TICKS] for name in ("dx", "dy")) > 10
    for coupling in ("cx", "cy"):  # cz has rows while dz is gone
        assert check_of(done, coupling, "signal").numbers > 0.9 * check_of(done, coupling, "ledger").numbers


def test_lateness_that_is_counted_alone_breaks_nobodys_promise(tmp_path: Path) -> None:
    wishes = ["design.tau=0", "design.ladder=[]", "design.objective=stiffest", "faults.breach=warn",
              "faults.lateness=count"]  # fmt: skip
    prepared = prepare(load_session(SESSIONS / "example1.yaml", wishes))
    told = WatchedSession(prepared, faults).told
    done = audited(tmp_path / "r.mcap", prepared, told)
    assert broken(done) == {}
    for name in DEVICES:
        assert min(message.figures[names.LEDGER_MIN] for message in told[name]) < 0.0
        for what in ("bound", "account"):
            assert check_of(done, name, what).verdict is CheckVerdict.ASSUMPTION
    for name in ("cx", "cy", "cz", "environment"):
        assert check_of(done, name, "bound").verdict is CheckVerdict.HOLDS


@pytest.mark.parametrize("among_free_periods", [False, True])
def test_gaps_that_are_not_integrated_are_followed(
    among_free_periods: bool, prepared: Prepared, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An hour here is 60 ms, and what is integrated of it 8 ms; free periods without a stop are longer than that."""
    for module in ("nodes.device.wall_time", "launch.audit.device"):
        monkeypatch.setattr(f"manyhands.{module}.LONGEST_GAP", 8 * MS)

    def stops(session: SimulatedSession) -> None:
        session.scheduler.after(200 * MS, lambda: session.stop("environment", 34 * MS))
        session.scheduler.after(300 * MS, lambda: session.stop("dx", 60 * MS))
        session.scheduler.after(int(400.4 * MS), lambda: session.stop("dy", 60 * MS))

        if among_free_periods:
            session.scheduler.after(500 * MS, lambda: session.stop("environment", 34 * MS))
            session.scheduler.after(515 * MS, lambda: session.stop("dx", 60 * MS))

    told = WatchedSession(prepared, stops).told
    assert all(told[name][-1].figures[names.RELEASED] > 8.0 for name in DEVICES)
    stopped = [told[name][-1].figures.get(names.SUSPENDED) for name in DEVICES]
    assert stopped == [1.0 + among_free_periods, 1.0, None]
    done = audited(tmp_path / "r.mcap", prepared, told)
    assert broken(done) == {}
    for name in DEVICES[among_free_periods:]:
        for check in (check_of(done, name, what) for what in OF_A_DEVICE):
            assert (check.verdict, check.gaps) == (CheckVerdict.HOLDS, ()), check
    if among_free_periods:
        (gap,) = check_of(done, "dx", "interface").gaps
        assert gap.why.startswith("its process did not run for a while and ran free")


def changed(told: Told, node: str, trace: str, column: int, tick: int, by: float) -> Told:
    """The telemetry with one number changed."""
    out = {name: list(messages) for name, messages in told.items()}
    for i, message in enumerate(out[node]):
        rows = message.traces[trace].copy()
        begin = message.tick - len(rows)
        if begin <= tick < message.tick:
            rows[tick - begin, column] += by
            out[node][i] = replace(message, traces={**message.traces, trace: rows})
            return out
    raise AssertionError(f"{node} has no row of tick {tick}")


SAMPLED, APPLIED, ENDED = range(3)


@pytest.mark.parametrize("tick", [120, 480])
@pytest.mark.parametrize(
    ("trace", "column", "by", "found"),
    [
        (names.INSTANTS, SAMPLED, 1000.0, {"signal": 0}),
        (names.INSTANTS, SAMPLED, -1.0, {"signal": 0, "instants": 0}),
        (names.INSTANTS, APPLIED, 1000.0, {"interface": 0, "signal": 1}),
        (names.INSTANTS, APPLIED, -1.0, {"interface": 0, "instants": 0}),
        (names.INSTANTS, ENDED, -1.0, {"ended": 0}),
        (names.INTERFACE, 0, 1e-12, {"interface": 0}),
        (names.FORCE, 0, 1e-9, {"exerted": 0, "signal": 1}),
        (names.DISPLACEMENT, 0, 1e-12, {"signal": 0}),
        (names.APPLIED, 0, 1e-12, {"applied": 0}),
        (names.LEDGER, 0, 1e-9, {"ledger": 0}),
    ],
)
def test_a_forged_number_is_found_at_its_tick(
    trace: str,
    column: int,
    by: float,
    found: Mapping[str, int],
    tick: int,
    prepared: Prepared,
    told: Told,
    tmp_path: Path,
) -> None:
    done = audited(tmp_path / "f.mcap", prepared, changed(told, "dx", trace, column, tick, by))
    ticks = broken(done)
    assert {("dx", name): tick + later for name, later in found.items()}.items() <= ticks.items()
    assert min(ticks.values()) == tick
    # what the couplings received follows from the device's motion, and so may what they recorded
    assert {party for party, _ in ticks} <= {"dx", "cx"}


def test_the_account_of_a_device_that_a_person_moved_is_checked(
    prepared: Prepared, told: Told, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its motion is taken from the recording, at s(k) and at a(k); everything else follows from it."""
    monkeypatch.setattr("manyhands.launch.audit.audit.hand_of", lambda *_: "a person moved the device")
    done = audited(tmp_path / "r.mcap", prepared, told)
    assert broken(done) == {}
    for name in ("exerted", "interface", "ended"):
        check = check_of(done, "dx", name)
        assert (check.verdict, check.gaps) == (CheckVerdict.HOLDS, ())
    (gap,) = check_of(done, "dx", "signal").gaps
    assert gap.why == "a person moved the device: its motion and its ledger are not checked"
    assert check_of(done, "dx", "ledger").verdict is CheckVerdict.UNCHECKED
    for trace in (names.INTERFACE, names.APPLIED):
        forged = changed(told, "dx", trace, 0, 120, 1e-6)
        assert broken(audited(tmp_path / "f.mcap", prepared, forged))["dx", "interface"] == 120


def test_a_recording_without_instants_says_so(prepared: Prepared, told: Told, tmp_path: Path) -> None:
    older = {
        node: [
            replace(of, traces={k: v for k, v in of.traces.items() if k not in (names.INSTANTS, names.INTERFACE)})
            for of in messages
        ]
        for node, messages in told.items()
    }
    done = audited(tmp_path / "o.mcap", prepared, older)
    assert broken(done) == {}
    (gap,) = check_of(done, "dx", "signal").gaps
    assert gap.why.startswith("it was in wall time, and the recording has no instants")


def test_what_lateness_put_in_is_compared_with_the_tank() -> None:
    account, at = np.array([[0.0], [1e-3], [-2e-3], [np.nan], [-1e-3]]), 1e9 * np.arange(5.0)
    kept = account_bounded("d", account, at, LatenessAllowance(2e-3))
    assert (kept.verdict, kept.numbers, kept.remark) == (CheckVerdict.HOLDS, 4, "least account -2 mJ")
    exceeded = account_bounded("d", account, at, LatenessAllowance(1.9e-3))
    assert (exceeded.verdict, exceeded.differing) == (CheckVerdict.BROKEN, 1)
    assert exceeded.first is not None
    assert exceeded.first.tick == 2
    assert (
        account_bounded("d", account, at, LatenessAllowance(1e-3, 0.5e-3)).verdict is CheckVerdict.HOLDS
    )  # 2 mJ after 2 s
    assert account_bounded("d", account, at, LatenessAllowance(1e-3, 0.4e-3)).verdict is CheckVerdict.BROKEN
    assert account_bounded("d", account, at, None).verdict is CheckVerdict.ASSUMPTION
    assert account_bounded("d", account[:2], at[:2], None).verdict is CheckVerdict.HOLDS
    assert account_bounded("d", account[3:4], at[3:4], LatenessAllowance(1e-3)).verdict is CheckVerdict.UNCHECKED


@pytest.mark.parametrize("what", REALTIME)
def test_no_forgery_in_real_time_holds(what: str, run: RecordedRun, tmp_path: Path) -> None:
    forged = Forged.of(run)
    REALTIME[what](forged)
    path = forged.write(tmp_path / "f.mcap", run)
    done = audit(path, read_run(path), lambda text: None, lambda tick: None)
    assert not done.holds
    assert not done.broken or not any(word in what for word in ("NaN",))


@pytest.fixture(scope="module")
def run(prepared: Prepared, tmp_path_factory: pytest.TempPathFactory) -> RecordedRun:
    """A recording of an honest session that was stopped now and then, and lost nobody."""

    def stops(session: SimulatedSession) -> None:
        session.scheduler.after(60 * MS, lambda: session.stop("dx", 3 * MS))
        session.scheduler.after(100 * MS, lambda: session.stop("cy", 20 * MS))

    path = tmp_path_factory.mktemp("run") / "r.mcap"
    assert audited(path, prepared, WatchedSession(prepared, stops, ticks=200).told).holds
    return read_run(path)


def test_a_recording_begun_in_mid_session_accuses_no_device_that_leaves(tmp_path: Path) -> None:
    """Its force falls by a ramp below what its coupling hands on, and its state before the recording is not known.

    All delays are certified, so its interface changes nothing, and nothing else says that its force is another.
    """
    prepared = prepare(load_session(SESSIONS / "example1.yaml", ["design.tau=0.001", "design.ladder=[]"]))

    def leave(session: SimulatedSession) -> None:
        node = session.processes["dx"].node
        assert isinstance(node, DeviceNode)
        guard, account, report = node.device.guard, node._account, node.device.guard.report

        def leaving(x: Floats, periods: int = 1) -> Floats:
            if not guard.leaving:
                guard.leave()
                account.leave(account.ticks)
            return report(x, periods)

        guard.report = leaving  # type: ignore[method-assign]

    session = WatchedSession(prepared, lambda session: session.scheduler.after(250 * MS, lambda: leave(session)))
    assert not session.told["dx"][-1].traces[names.FORCE].any()
    assert session.told["dx"][-1].figures[names.INTERFACE_TICKS] == 0.0
    whole = audited(tmp_path / "whole.mcap", prepared, session.told)
    later = {name: [of for of in messages if of.tick > 110] for name, messages in session.told.items()}
    done = audited(tmp_path / "later.mcap", prepared, later)
    assert broken(whole) == broken(done) == {}
    assert done.verdict is AuditVerdict.UNCHECKED


def test_a_process_that_does_the_last_tick_of_another_again_is_recorded(
    prepared: Prepared, told: Told, tmp_path: Path
) -> None:
    """Without the event of its beginning its motion would look like a forged one of the process before."""
    core = RecorderCore(recorded_of(prepared, "realtime"), attachments_of(prepared), START)
    first, again = told["dz"][0], told["dz"][1]
    one = {name: trace[:1] for name, trace in again.traces.items()}
    for tick, figures in ((first.tick, first.figures), (first.tick, Figures({f"{Kind.BEGAN}@{first.tick - 1}": 1.0}))):
        traces = first.traces if figures is first.figures else one
        core.take(encode(Observation("dz", tick, figures, traces)), START)
    assert core.refused == 0
    core.take(encode(Observation("dz", first.tick, Figures(), one)), START)  # no process began
    core.take(encode(Observation("dz", first.tick - 1, Figures({f"{Kind.BEGAN}@{first.tick - 2}": 1.0}), one)), START)
    assert core.refused == 2
    path = tmp_path / "r.mcap"
    path.write_bytes(core.cut() + core.end())
    np.testing.assert_array_equal(read_run(path).traces["dz", "sample"].values[first.tick - 1], again.traces["x"][0])
