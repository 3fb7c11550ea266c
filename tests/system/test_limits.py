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
from manyhands.nodes.device.guard import LimitExceeded

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


@pytest.mark.parametrize(
    ("limits", "sentence"),
    [
        ("{displacement: 1e-4}", "found a displacement of 0.0001"),
        ("{speed: 0.01}", "found a speed of 0.01"),
    ],
)
def test_a_device_beyond_its_limits_ends_the_session(limits: str, sentence: str) -> None:
    session = prepared(limits)
    outcome = run(session)
    assert outcome.code == 1
    assert any(fault.startswith(f"dx: {sentence}") for fault in outcome.faults), outcome.faults
    with pytest.raises(LimitExceeded, match=sentence) as simulated:
        Simulation(session).run(TICKS)
    told = str(simulated.value)
    assert told.startswith("dx, 0.1")
    assert told.split(": ", 1)[1] in {fault.removeprefix("dx: ") for fault in outcome.faults}
    # the recording ends where the limit was passed: nothing beyond it was said to anybody
    assert outcome.recording is not None
    within = outcome.recording.x[np.isfinite(outcome.recording.x[:, 0]), 0]
    assert 100 < len(within) < TICKS
    assert np.max(np.abs(within)) <= 1e-4 or "speed" in sentence
