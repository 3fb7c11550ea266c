"""What a hand is given in a whole session whose coupling is late again and again, in virtual time."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from manyhands.launch.audit.findings import CheckVerdict
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.run.broadcast import describe
from manyhands.launch.session import load_session
from manyhands.nodes.kernel.bundle import REALTIME
from manyhands.nodes.monitor.given import GivenForce
from manyhands.nodes.monitor.health import PromiseState
from manyhands.nodes.monitor.health_model import HealthModel
from manyhands.nodes.rows import figures as names
from manyhands.nodes.rows.promises import Promise
from manyhands.protocol.messages import Figures, PromiseStatus
from tests.support.simulated_recordings import SESSIONS

from .recorded import Told, WatchedSession, audited
from .world import SimulatedSession

MS = 1_000_000  # ns
EVERY = 250  # ms, between two stops of a coupling
STOPPED = 140  # ms, longer than a coupling that is silent is held


def late_again_and_again(session: SimulatedSession) -> None:
    for at in range(50, 650, EVERY):
        session.scheduler.after(at * MS, lambda: session.stop("cx", STOPPED * MS))


@pytest.fixture(scope="module")
def prepared() -> Prepared:
    return prepare(load_session(SESSIONS / "example1.yaml", ["design.objective=stiffest", "faults.breach=warn"]))


@pytest.fixture(scope="module")
def told(prepared: Prepared) -> Told:
    session = WatchedSession(prepared, late_again_and_again)
    assert session.violations == []
    return session.told


def given(told: Told, device: str) -> GivenForce:
    found = GivenForce.of(told[device][-1].figures)
    assert found is not None
    return found


def test_a_frozen_user_is_given_little_by_time_though_nothing_was_asked_of_it(told: Told) -> None:
    dx, dy = given(told, "dx"), given(told, "dy")
    assert dx.by_force is not None
    assert dx.by_time is not None
    assert dx.by_time < 0.2 < dx.by_force  # from 50 ms on it is away, or its force rises again
    assert dx.away > 0.95 * dx.lacking
    assert dy.by_time is not None
    assert dy.by_time > 0.95  # the others go on


def test_the_session_says_whose_hand_lacks_its_force_and_accuses_nobody(prepared: Prepared, told: Told) -> None:
    model = HealthModel(describe(prepared, REALTIME, "", 0).terms)
    for node, messages in told.items():
        for of in messages if node == "environment" else ():
            model.take(node, of.tick, of.figures)
    for seconds in (0.0, 5.0):  # the session goes on in the same way for long enough to judge it
        for node in ("dx", "dy", "dz"):
            of = told[node][-1]
            longer = {name: value * (1.0 + seconds) for name, value in of.figures.items() if name.startswith("force_")}
            model.take(node, of.tick + round(seconds * 1e3), Figures(longer))
    (row,) = [row for row in model.rows() if row.promise == Promise.GIVEN and row.state == PromiseState.BROKEN]
    assert isinstance(row, PromiseStatus)
    assert row.who == ("dx",)
    assert "cx was frozen" in row.remark
    assert "the machine that they share may have caused" in row.remark


def test_an_audit_finds_what_a_hand_was_given_again_and_a_share_that_was_made_up(
    prepared: Prepared, told: Told, tmp_path: Path
) -> None:
    done = audited(tmp_path / "r.mcap", prepared, told)
    (check,) = [check for check in done.checks if (check.party, check.name) == ("dx", "given")]
    assert (check.verdict, check.gaps) == (CheckVerdict.HOLDS, ())
    last = told["dx"][-1]
    better = replace(
        last, figures=last.figures.with_numbers({names.FORCE_AWAY: last.figures[names.FORCE_AWAY] - 0.001})
    )
    done = audited(tmp_path / "f.mcap", prepared, {**told, "dx": [*told["dx"][:-1], better]})
    (check,) = [check for check in done.checks if (check.party, check.name) == ("dx", "given")]
    assert check.verdict is CheckVerdict.BROKEN
    assert check.first is not None
    assert (check.first.tick, check.first.column) == (last.tick - 1, names.FORCE_AWAY)
