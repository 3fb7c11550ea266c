"""Limits of force, displacement and speed in whole sessions: real processes, against the simulation in one process."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from manyhands.launch.audit.simulation import Simulation
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.plan.reach import reach
from manyhands.launch.run.outcome import Outcome
from manyhands.launch.run.supervisor import Supervisor
from manyhands.launch.session import load_session

SESSIONS = Path(__file__).parents[2] / "launch" / "sessions"
TICKS = 600  # the hands push from 100 to 350


def prepared(limits: str, file: str = "example1.yaml") -> Prepared:
    return prepare(load_session(SESSIONS / file, [f"devices.dx.limits={limits}"]))


def run(session: Prepared) -> Outcome:
    return Supervisor(session, clock="simulated", reach=reach(session, "ipc"), ticks=TICKS, record=True).run()


@pytest.mark.parametrize("file", ["example1.yaml", pytest.param("example1-centralised.yaml", marks=pytest.mark.long)])
def test_a_force_limit_that_bites_gives_the_simulations_numbers(file: str) -> None:
    session = prepared("{force: 1.25}", file)
    outcome = run(session)
    assert outcome.faults == ()
    assert outcome.recording is not None
    simulation = Simulation(session)
    expected = simulation.run(TICKS)
    assert outcome.recording.x.tobytes() == expected.x.tobytes()
    assert outcome.recording.f_v.tobytes() == expected.f_v.tobytes()
    assert np.max(np.abs(expected.f_v[:, 0])) == 1.25
    nodes = outcome.report["nodes"]
    for name, coupling in simulation.couplings.items():
        assert nodes[name]["saturated"] == coupling.core.saturated
        assert (coupling.core.saturated > 0) == (name in ("cx", "c"))
    for device in session.session.devices:
        assert nodes[device]["clipped"] == 0


@pytest.mark.parametrize("limits", ["{displacement: 1e-4}", "{speed: 0.01}"])
def test_beyond_its_limits_a_device_lets_go_and_others_continue(limits: str) -> None:
    session = prepared(limits)
    outcome = run(session)
    assert (outcome.code, outcome.faults) == (0, ())
    assert outcome.recording is not None
    simulation = Simulation(session)
    expected = simulation.run(TICKS)
    assert outcome.recording.x.tobytes() == expected.x.tobytes()
    assert outcome.recording.f_v.tobytes() == expected.f_v.tobytes()
    guard = simulation.devices["dx"].guard
    assert guard.let_go >= 1
    assert outcome.report["nodes"]["dx"]["let_go"] == guard.let_go
    assert "let_go" not in outcome.report["nodes"]["dy"] or outcome.report["nodes"]["dy"]["let_go"] == 0
    assert any("dx was beyond its limits of displacement or speed, and let go" in one for one in outcome.incidents)
    beyond = np.flatnonzero(expected.f_v[:, 0] == 0.0)
    assert 50 < len(beyond) < TICKS  # no force while it is beyond, and for a while after
    assert not np.any(np.all(expected.f_v[120:, 1:] == 0.0, axis=1))  # the others feel the world all the time


def test_a_guest_moving_others_too_fast_is_held_to_its_budget() -> None:
    """A guest reports a motion of 5 cm at 6 Hz; before there were budgets this ended the session, naming dy."""
    t = np.arange(0.0, 1.201, 1e-3)
    path = np.minimum(1.0, t / 0.1) * 0.045 * np.sin(2.0 * np.pi * 6.0 * t)
    trace = f"{{times: {t.round(3).tolist()}, values: {path.tolist()}}}"
    overrides = [
        f"devices.dx={{dof: 1, osp: 1.37, driver: trace, trace: {trace}, limits: {{speed: 2, power: 0.5, energy: 2}}}}",
        *(f"devices.{name}.limits={{speed: 0.8}}" for name in ("dy", "dz")),
        *(f"devices.{name}.hand.force=0" for name in ("dy", "dz")),
    ]
    session = prepare(load_session(SESSIONS / "example1.yaml", overrides))
    ticks = 1200
    how = reach(session, "ipc")
    outcome = Supervisor(session, clock="simulated", reach=how, ticks=ticks, record=True).run()
    assert (outcome.code, outcome.faults) == (0, ())
    assert outcome.recording is not None
    expected = Simulation(session).run(ticks)
    assert outcome.recording.x.tobytes() == expected.x.tobytes()  # clutches and guards act alike in both
    assert outcome.recording.f_v.tobytes() == expected.f_v.tobytes()
    energy = outcome.report["nodes"]["environment"]["energy"]
    assert energy["given"]["cx"] <= 2.0 + 0.5 * ticks * 1e-3
    assert set(energy["scaled"]) == {"cx"}
    (stopped,) = [one for one in outcome.incidents if "budget" in one]
    assert "cx (dx) was beyond its energy budget" in stopped
    let_go = [one for one in outcome.incidents if "let go" in one]
    assert {one.split(": ")[1].split(" ")[0] for one in let_go} == {"dy", "dz"}
    assert all(one.endswith("of it from cx (dx)") for one in let_go)
