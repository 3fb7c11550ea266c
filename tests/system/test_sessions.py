"""Whole sessions: real processes over real sockets, against the simulation in one process."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from manyhands.launch.audit.simulation import Simulation
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.plan.reach import reach
from manyhands.launch.recordings.recording import Recording
from manyhands.launch.run.outcome import Outcome
from manyhands.launch.run.supervisor import Supervisor
from manyhands.launch.session import load_session

SESSIONS = Path(__file__).parents[2] / "launch" / "sessions"
TICKS = 1500  # the hands push until 350


def run(prepared: Prepared, transport: str, clock: str = "simulated", ticks: int = TICKS) -> Outcome:
    return Supervisor(prepared, clock=clock, reach=reach(prepared, transport), ticks=ticks, record=True).run()


def recording_of(outcome: Outcome) -> Recording:
    assert outcome.faults == ()
    assert outcome.code == 0
    assert outcome.lost == {}
    assert outcome.recording is not None
    return outcome.recording


@pytest.mark.parametrize("transport", ["ipc", "tcp"])
def test_processes_in_lockstep_give_the_simulations_numbers_twice(transport: str) -> None:
    prepared = prepare(load_session(SESSIONS / "example1.yaml"))
    expected = Simulation(prepared).run(TICKS)
    first, second = (recording_of(run(prepared, transport)) for _ in range(2))
    for signal in ("x", "f_v"):
        want, got = getattr(expected, signal), getattr(first, signal)
        assert np.max(np.abs(want)) > 0.0
        # the promise is 1e-9 relative; the same operations in the same order give the same bits
        np.testing.assert_allclose(got, want, rtol=1e-9, atol=0.0)
        assert got.tobytes() == getattr(second, signal).tobytes(), f"{signal} differs between two runs"


@pytest.mark.parametrize(
    "file",
    [
        "example1-centralised.yaml",
        pytest.param("example1-operator.yaml", marks=pytest.mark.long),
        "example1-uncoupled.yaml",
        "carry.yaml",
        "handover.yaml",
        "steering.yaml",
        pytest.param("stroke.yaml", marks=pytest.mark.long),
    ],
)
def test_every_shipped_session_runs(file: str) -> None:
    """One block over three devices, three blocks over one device, no coupling at all, and a scene."""
    prepared = prepare(load_session(SESSIONS / file), uncertified=True)
    outcome = run(prepared, "ipc", ticks=400)
    recording = recording_of(outcome)
    np.testing.assert_array_equal(recording.x, Simulation(prepared).run(400).x)
    nodes = outcome.report["nodes"]
    assert set(nodes) == {*prepared.session.devices, *prepared.session.couplings, "environment"}
    for node in nodes.values():
        assert node["ticks"] == 400
        if "ledger" in node and prepared.certificate is not None:
            assert node["ledger"]["min"] >= 0.0


def test_a_simulated_network_is_the_same_in_one_process_and_in_many() -> None:
    network = "network: {delay: 0.02, jitter: 0.01, loss: 0.05}"
    linked = [f"couplings.cx.wave_link={{mass: 0.5, round_trip: 0.1, {network}}}", "design.tau=0"]
    prepared = prepare(load_session(SESSIONS / "example1.yaml", linked))
    expected, recording = Simulation(prepared).run(400), recording_of(run(prepared, "ipc", ticks=400))
    np.testing.assert_array_equal(recording.x, expected.x)
    np.testing.assert_array_equal(recording.f_v, expected.f_v)
    near = prepare(load_session(SESSIONS / "example1.yaml", [linked[0].replace("0.02", "0"), "design.tau=0"]))
    assert np.max(np.abs(Simulation(near).run(400).f_v - expected.f_v)) > 0.1  # N: the delay is felt


@pytest.mark.alone
def test_in_real_time_the_report_has_lateness_tau_and_period() -> None:
    """Slowly enough that even on a busy machine no wait lasts three periods, which would freeze a user."""
    slowly = ["period=0.05", "design.ladder=[]", "faults.breach=warn"]
    own = [f"devices.{name}.time=own" for name in ("dx", "dy", "dz")]  # so that x is that of the simulation
    prepared = prepare(load_session(SESSIONS / "example1.yaml", [*slowly, *own]))
    outcome = run(prepared, "ipc", clock="realtime", ticks=60)
    recording = recording_of(outcome)
    np.testing.assert_array_equal(recording.x, Simulation(prepared).run(60).x)
    assert outcome.report["session"] == "example-1"
    assert outcome.report["certificate"] == prepared.id
    assert outcome.report["clock"] == "realtime"
    assert outcome.report["duration"] == pytest.approx(3.0)
    for device in prepared.session.devices:
        node = outcome.report["nodes"][device]
        assert 0 <= node["late"] <= 60
        assert 0.0 < node["tau_us"]["p50"] <= node["tau_us"]["p99"] <= node["tau_us"]["p999"] <= node["tau_us"]["max"]
        assert node["period_us"]["p50"] > 0.0
        assert node["tau_breaches"] == 60  # the certificate assumes no delay at all
        (notice,) = (text for text in outcome.notices if "later than the certificate covers (0 ms)" in text)
        assert f" {device} in 100.0% of its ticks" in notice


def test_the_uncoupled_hands_shake_and_the_coupled_ones_come_to_rest() -> None:
    """Ten seconds of the world of Example 1, in one process: the purpose of the certificate."""
    coupled = Simulation(prepare(load_session(SESSIONS / "example1.yaml"))).run(10_000).velocity
    uncoupled = Simulation(prepare(load_session(SESSIONS / "example1-uncoupled.yaml"), uncertified=True))
    shaken = uncoupled.run(10_000).velocity
    assert np.all(np.max(np.abs(coupled[-100:]), axis=0) < 1e-3 * np.max(np.abs(coupled), axis=0))
    assert np.all(np.max(np.abs(shaken[-1000:]), axis=0) > 2.0 * np.max(np.abs(shaken[4000:5000]), axis=0))
