"""Limits of force, displacement and speed in whole sessions: real processes, against the simulation in one process."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from manyhands.launch.outcome import Outcome
from manyhands.launch.preparation import Prepared, prepare
from manyhands.launch.reach import reach
from manyhands.launch.session import load_session
from manyhands.launch.simulation import Simulation
from manyhands.launch.supervisor import Supervisor

SESSIONS = Path(__file__).parents[2] / "launch" / "sessions"
TICKS = 600  # the hands push from 100 to 350


def prepared(limits: str, file: str = "example1.yaml") -> Prepared:
    return prepare(load_session(SESSIONS / file, [f"devices.dx.limits={limits}"]))


def run(session: Prepared) -> Outcome:
    return Supervisor(session, clock="simulated", reach=reach(session.session, "ipc"), ticks=TICKS, record=True).run()


@pytest.mark.parametrize("file", ["example1.yaml", "example1-centralised.yaml"])
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
    for name, core in simulation.couplings.items():
        assert nodes[name]["saturated"] == core.saturated
        assert (core.saturated > 0) == (name in ("cx", "c"))
    for device in session.session.devices:
        assert nodes[device]["clipped"] == 0


@pytest.mark.parametrize("limits", ["{displacement: 1e-4}", "{speed: 0.01}"])
def test_a_device_beyond_its_limits_lets_go_and_the_session_goes_on(limits: str) -> None:
    session = prepared(limits)
    outcome = run(session)
    assert (outcome.code, outcome.faults) == (0, ())
    assert outcome.recording is not None
    simulation = Simulation(session)
    expected = simulation.run(TICKS)
    assert outcome.recording.x.tobytes() == expected.x.tobytes()
    assert outcome.recording.f_v.tobytes() == expected.f_v.tobytes()
    guard = simulation.guards["dx"]
    assert guard.let_go >= 1
    assert outcome.report["nodes"]["dx"]["let_go"] == guard.let_go
    assert "let_go" not in outcome.report["nodes"]["dy"] or outcome.report["nodes"]["dy"]["let_go"] == 0
    assert any("dx was beyond its limits of displacement or speed, and let go" in one for one in outcome.incidents)
    beyond = np.flatnonzero(expected.f_v[:, 0] == 0.0)
    assert 50 < len(beyond) < TICKS  # no force while it is beyond, and for a while after
    assert not np.any(np.all(expected.f_v[120:, 1:] == 0.0, axis=1))  # the others feel the world all the time
