"""Nodes that are lost and come back, in threads over the in-memory transport: which wait, which go on, and where."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.session import load_session
from manyhands.launch.session.session import ENVIRONMENT
from manyhands.nodes.environment.clutch import SLOWEST
from manyhands.nodes.environment.membership import Membership
from manyhands.nodes.kernel.bundle import REALTIME
from manyhands.nodes.rows.figures import WAITED_IN
from manyhands.protocol.messages import Absent, Report, Shift

from ..support.threaded_session import ThreadedSession

SESSIONS = Path(__file__).parents[2] / "launch" / "sessions"
TICKS = 1000
HELD = 300  # the tick at which dz waits for the test
ROUNDING = -1e-12  # J: ledgers add some thousand terms of about 1e-4 J
SEATED_SOON = (Membership.REJOINING, Membership.ACTIVE)
CHAIN = {"dx": "cx", "cx": "cx"}


@pytest.fixture(scope="module")
def prepared() -> Prepared:
    return prepare(load_session(SESSIONS / "example1.yaml"))


@pytest.fixture(scope="module")
def colocated() -> Prepared:
    return prepare(load_session(SESSIONS / "example1.yaml", ["colocate=true"]))


def hold_dz(name: str, line: Any) -> None:
    """While dz waits for the test no node can finish, because the environment waits for dz."""
    if name == "dz":
        line.pause = HELD


def held(prepared: Prepared, new_life: Callable[[], Any], **more: Any) -> ThreadedSession:
    """A session under the simulated clock that stands still at a tick until dz is released."""
    stage = ThreadedSession(prepared, new_life, ticks=TICKS, **more)
    stage.prepare = hold_dz
    return stage


def check(reports: dict[str, Report], ticks: int = TICKS) -> None:
    """All are done, and have kept their promises."""
    for name, report in reports.items():
        assert report.ticks == ticks, name
        assert report.figures["ledger_margin"] >= ROUNDING, name


def check_rows(stage: ThreadedSession) -> None:
    """Every node's rows are of consecutive ticks, and its last row is of the tick before ``tick``."""
    for line in stage.all_lines:
        before = 0
        for telemetry in line.told:
            for name, trace in telemetry.traces.items():
                if name != WAITED_IN:
                    assert telemetry.tick - len(trace) >= before
            waits = [tuple(row) for row in telemetry.traces.get(WAITED_IN, np.empty((0, 2))).tolist()]
            assert len(set(waits)) == len(waits)  # a coupling once a tick
            before = telemetry.tick


@pytest.mark.parametrize("who", ["dx", "cx", ENVIRONMENT])
def test_a_lost_node_comes_back_and_the_session_finishes(
    prepared: Prepared, new_life: Callable[[], Any], who: str
) -> None:
    with held(prepared, new_life) as stage:
        stage.paused("dz")
        stage.lose(who)
        stage.bring_back(who, HELD)
        if who in CHAIN:
            stage.await_state(CHAIN[who], *SEATED_SOON)
        stage.release("dz")
        reports = stage.reports()
        check(reports)
        check_rows(stage)
    assert reports[ENVIRONMENT].figures["absences"] == (0 if who == ENVIRONMENT else 1)
    for other in ("dy", "dz"):
        assert reports[other].figures["jumps"] == 0
    x = {name: np.vstack([told.traces["x"] for told in stage.lines[name].told]) for name in ("dy", "dz")}
    assert all(len(trace) == TICKS for trace in x.values())


def test_a_node_is_lost_twice(prepared: Prepared, new_life: Callable[[], Any]) -> None:
    with held(prepared, new_life) as stage:
        stage.paused("dz")
        for _ in range(2):
            stage.lose("cx")
            stage.bring_back("cx", HELD)
            stage.await_state("cx", *SEATED_SOON)
        stage.release("dz")
        check(stage.reports())


@pytest.mark.parametrize(
    ("first", "second"), [("cx", "dx"), (ENVIRONMENT, "cx")], ids=["device and coupling", "coupling and environment"]
)
def test_both_ends_of_a_link_are_lost_at_once(
    prepared: Prepared, new_life: Callable[[], Any], first: str, second: str
) -> None:
    """The binding end comes back first, learns that the other is absent, and offers it an endpoint."""
    with held(prepared, new_life) as stage:
        stage.paused("dz")
        stage.lose(first, second)
        stage.bring_back(first, HELD, absent=[second])
        stage.bring_back(second, HELD)
        stage.await_state("cx", *SEATED_SOON)
        stage.release("dz")
        reports = stage.reports()
        check(reports)
        check_rows(stage)
    assert reports["dy"].figures["jumps"] == 0


def test_a_peer_lost_during_its_return_reconnects_at_the_next(prepared: Prepared, new_life: Callable[[], Any]) -> None:
    """The environment learns of an absence while the endpoint that it offered before still waits."""
    with held(prepared, new_life) as stage:
        stage.paused("dz")
        stage.lose("cx")
        assert stage.lines[ENVIRONMENT].offers.get(timeout=60)[0] == "cx"
        stage.lines[ENVIRONMENT].words.put(Absent("cx"))
        stage.bring_back("cx", HELD)
        stage.await_state("cx", *SEATED_SOON)
        stage.release("dz")
        check(stage.reports())


def test_a_user_that_stays_away_does_not_hold_the_others_up(prepared: Prepared, new_life: Callable[[], Any]) -> None:
    with held(prepared, new_life) as stage:
        stage.paused("dz")
        stage.lose("dx")
        stage.release("dz")
        reports = stage.reports("dy", "dz", "cy", "cz", ENVIRONMENT)
        check(reports)
    assert TICKS - HELD - 2 <= reports[ENVIRONMENT].figures["frozen_ticks"] <= TICKS - HELD + 1
    assert reports[ENVIRONMENT].figures["absences"] == 1


@pytest.mark.parametrize("first", ["dx", ENVIRONMENT])
def test_an_environment_comes_back_though_a_user_stays_away(
    prepared: Prepared, new_life: Callable[[], Any], first: str
) -> None:
    """The coupling without a device still shakes hands with it, and names the missing device."""
    with held(prepared, new_life) as stage:
        stage.paused("dz")
        stage.lose(first)
        stage.lose(ENVIRONMENT if first == "dx" else "dx")
        stage.bring_back(ENVIRONMENT, HELD)
        stage.release("dz")
        reports = stage.reports("dy", "dz", "cy", "cz", ENVIRONMENT)
        check(reports)
    assert reports[ENVIRONMENT].figures["frozen_ticks"] >= TICKS - HELD - 2


@pytest.mark.parametrize("session", ["prepared", "colocated"])
def test_couplings_change_their_rungs(
    session: str, new_life: Callable[[], Any], request: pytest.FixtureRequest
) -> None:
    with held(request.getfixturevalue(session), new_life) as stage:
        stage.paused("dz")
        stage.lines[ENVIRONMENT].words.put(Shift("cx", 1))
        stage.lines[ENVIRONMENT].words.put(Shift("cy", 2))
        stage.release("dz")
        reports = stage.reports()
        check(reports)
    rungs = {name: report.figures["rung"] for name, report in reports.items() if "rung" in report.figures}
    assert rungs == {"dx": 1, "cx": 1, "dy": 2, "cy": 2, "dz": 0, "cz": 0}
    assert all(report.figures.get("jumps", 0) == 0 for report in reports.values())


@pytest.mark.parametrize("told", [True, False], ids=["told again", "not told again"])
def test_a_returned_environment_finds_the_rungs_it_knows(
    prepared: Prepared, new_life: Callable[[], Any], told: bool
) -> None:
    with held(prepared, new_life) as stage:
        stage.lines[ENVIRONMENT].words.put(Shift("cx", 1))
        stage.paused("dz")
        stage.lines["cx"].reach(lambda telemetry: telemetry.figures["rung"] == 1.0 or telemetry.tick >= HELD)
        stage.lose(ENVIRONMENT)
        stage.bring_back(ENVIRONMENT, HELD)
        if told:
            stage.lines[ENVIRONMENT].words.put(Shift("cx", 1))
        stage.release("dz")
        reports = stage.reports()
        check(reports)
    assert {reports[name].figures["rung"] for name in ("dx", "cx")} == {int(told)}
    core = stage.nodes[ENVIRONMENT].core  # type: ignore[attr-defined]
    assert core.clutches.all[0].ratio >= SLOWEST - 1e-12  # it may still work an offset off
    rung = stage.nodes["cx"]._bundle.rungs[int(told)].block  # type: ignore[attr-defined]
    np.testing.assert_array_equal(core._D_V[:1, :1], rung.D)


@pytest.mark.parametrize("who", ["dx", ENVIRONMENT])
def test_a_process_of_several_nodes_is_lost_and_comes_back(
    colocated: Prepared, new_life: Callable[[], Any], who: str
) -> None:
    with held(colocated, new_life) as stage:
        stage.paused("dz")
        stage.lose(who)
        if who == ENVIRONMENT:  # no node goes on without it, and cz shakes hands with it in the process of dz
            stage.release("dz")
        stage.bring_back(who, HELD)
        stage.await_state("cx", *SEATED_SOON)
        stage.release("dz")
        check(stage.reports())
        check_rows(stage)


class Test_in_real_time:
    @pytest.mark.parametrize("who", ["dx", "cx", ENVIRONMENT])
    def test_a_node_that_is_lost_comes_back(self, prepared: Prepared, new_life: Callable[[], Any], who: str) -> None:
        with ThreadedSession(prepared, new_life, clock=REALTIME) as stage:
            tick = stage.reach("dy", 200)
            stage.lose(who)
            tick = stage.reach("dy", tick + 100) if who != ENVIRONMENT else tick  # the others go on
            stage.bring_back(who, tick)
            for name in ("dx", "dy", ENVIRONMENT):
                stage.reach(name, tick + 200)
            reports = stage.end()
            check_rows(stage)
        for name, report in reports.items():
            assert report.figures["ledger_margin"] >= ROUNDING, name

    @pytest.mark.parametrize("session", ["prepared", "colocated"])
    def test_a_temporarily_silent_user_is_frozen_and_rejoins(
        self, session: str, new_life: Callable[[], Any], request: pytest.FixtureRequest
    ) -> None:
        stage = ThreadedSession(request.getfixturevalue(session), new_life, clock=REALTIME)

        def pause_dx(name: str, line: Any) -> None:
            line.pause = 200 if name == "dx" else -1

        stage.prepare = pause_dx
        with stage:
            stage.paused("dx")
            stage.await_state("cx", Membership.FROZEN)
            tick = stage.reach("dy", stage.lines["dy"].told[-1].tick + 100)  # the others go on
            stage.release("dx")
            stage.reach("dx", tick + 100)
            reports = stage.end()
            check_rows(stage)
        assert reports["dx"].figures["jumps"] >= 1
        for name, report in reports.items():
            assert report.figures["ledger_margin"] >= ROUNDING, name

    def test_a_device_without_force_runs_free_until_it_hears_again(
        self, prepared: Prepared, new_life: Callable[[], Any]
    ) -> None:
        stage = ThreadedSession(prepared, new_life, clock=REALTIME)

        def pause_cx(name: str, line: Any) -> None:
            line.pause = 200 if name == "cx" else -1

        stage.prepare = pause_cx
        with stage:
            stage.paused("cx")
            account = stage.nodes["dx"]._account  # type: ignore[attr-defined]
            stage.see("dx", lambda: account.released >= 20)  # it goes on sampling, in every period
            stage.release("cx")
            stage.reach("dx", stage.lines["dy"].told[-1].tick + 100)
            reports = stage.end()
        assert reports["dx"].figures["stale"] >= 1
        assert reports["dx"].figures["released"] >= 20
        assert reports["dx"].figures["ledger_margin"] >= ROUNDING
