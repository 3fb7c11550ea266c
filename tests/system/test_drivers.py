"""Whole sessions whose devices are moved by a recording, or by a hand at a browser."""

from __future__ import annotations

import signal
from pathlib import Path

import numpy as np
import pytest

from manyhands.launch.audit.simulation import Simulation
from manyhands.launch.look.sessions import find_session
from manyhands.launch.plan.plan import Plan
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.plan.reach import reach
from manyhands.launch.recordings.recording import Recording
from manyhands.launch.run.supervisor import Supervisor
from manyhands.launch.session import load_session
from manyhands.nodes.rows import figures as names
from manyhands.protocol.clock import RealtimeClock, from_seconds
from manyhands.protocol.codec import decode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import Grasp, Observation
from manyhands.protocol.transport.broadcast import Visit
from manyhands.protocol.transport.pointer import PointerOutlet, pointer_path

from ..support.commands import read_until, run, started

SESSIONS = Path(__file__).parents[2] / "launch" / "sessions"
TICKS = 600
ROUNDING = -1e-12  # J: of a thousand additions of less than a joule
DEADLINE = from_seconds(60.0)
TRACED = "devices.{0}={{dof: 1, osp: 1.37, driver: trace, trace: {{file: '{1}'}}}}"


@pytest.mark.parametrize("colocate", ["false", pytest.param("true", marks=pytest.mark.long)])
def test_a_recorded_motion_meets_another_coupling_as_in_the_simulation(tmp_path: Path, colocate: str) -> None:
    """A run of processes records it; a weaker coupling, and half the period, replay it."""
    recorded = tmp_path / "run.npz"
    run("launch", "example1", "--clock", "simulated", "--duration", "0.4", "--record", recorded)
    given = ["design.coupling=given", "design.stiffness=300", "design.damping=0.1", f"colocate={colocate}"]
    first = Simulation(prepare(load_session(SESSIONS / "example1.yaml"))).run(400)
    session = load_session(SESSIONS / "example1.yaml", [TRACED.format("dx", recorded), *given])
    prepared = prepare(session)
    simulation = Simulation(prepared)
    expected = simulation.run(TICKS)
    np.testing.assert_array_equal(expected.x[:400, 0], first.x[:, 0])
    assert np.all(expected.x[400:, 0] == first.x[-1, 0])
    assert np.abs(expected.f_v[:400, 0] - first.f_v[:, 0]).max() > 0.01  # another coupling, another force
    assert all(ledger.minimum >= ROUNDING for ledger in simulation.ledgers.values())
    outcome = Supervisor(prepared, clock="simulated", reach=reach(Plan(session), "ipc"), ticks=TICKS, record=True).run()
    assert (outcome.faults, outcome.code) == ((), 0)
    assert isinstance(outcome.recording, Recording)
    np.testing.assert_array_equal(outcome.recording.x, expected.x)
    np.testing.assert_array_equal(outcome.recording.f_v, expected.f_v)
    finer = load_session(SESSIONS / "example1.yaml", [TRACED.format("dx", recorded), *given, "period=0.0005"])
    twice = Simulation(prepare(finer)).run(799)
    np.testing.assert_allclose(twice.x[::2, 0], first.x[:, 0], rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(twice.x[1::2, 0], (first.x[1:, 0] + first.x[:-1, 0]) / 2.0, rtol=0.0, atol=1e-15)


@pytest.mark.alone
def test_a_hand_at_a_browser_moves_a_running_sessions_other_user() -> None:
    clock = RealtimeClock()
    with started("launch", "browser") as process:
        read_until(process, "running: tick")
        running = find_session("browser")
        assert running.about.grips == ("left",)
        visit, outlet = Visit(running.directory), PointerOutlet(running.directory, "left")
        try:
            deadline = clock.now() + DEADLINE
            moved = held = False
            while not (moved and held):
                assert clock.now() < deadline, (moved, held)
                outlet.send(Grasp(np.array([0.1])))
                frame = visit.recv(from_seconds(5.0))
                told = None if frame is None else decode(frame, MAX_CONTROL_BYTES)
                match told:
                    case Observation("right"):
                        force, x = told.traces[names.FORCE], told.traces[names.DISPLACEMENT]
                        moved = bool(np.abs(force).max() > 1.0 and x.max() > 0.01)
                    case Observation("left"):
                        held = told.figures[names.GRASPED] == 1.0 and told.figures[names.GRASPS] > 0.0
            assert pointer_path(running.directory, "left").is_socket()
        finally:
            visit.close()
            outlet.close()
        process.send_signal(signal.SIGINT)
        assert process.stderr is not None
        rest = process.stderr.read()
        assert process.wait(60) in (0, 130), rest
        assert not running.directory.exists()
        assert "Traceback" not in rest
