"""Every kind of world in real processes: the simulated clock gives the simulation's numbers, and the file proves it."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from manyhands.launch.audit.audit import audit
from manyhands.launch.audit.findings import CheckVerdict
from manyhands.launch.audit.replay import replay
from manyhands.launch.audit.simulation import Simulation
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.plan.reach import reach
from manyhands.launch.recordings.run import read_run
from manyhands.launch.recordings.tables import read_recording
from manyhands.launch.run.recorder import RecorderProcess
from manyhands.launch.run.supervisor import Supervisor
from manyhands.launch.session.shipped import load_named

ROOT = Path(__file__).parents[2]
SESSIONS = ROOT / "launch" / "sessions"
TICKS = 730  # no multiple of the ticks between two telemetry messages
LIFTED = 2270  # likewise: the gripper has closed by then, and lifts the cube
ENTERED = 2770  # likewise: the peg has been turned, and has found its hole
ROLLED = 1690  # likewise: one wrist has rolled the stretcher, and with it the other
DRIVEN = 1530  # likewise: the driver has turned the screw
ENGINES = {"mujoco": TICKS, "gripper": LIFTED, "insert": ENTERED, "stretcher": ROLLED, "screw": DRIVEN}

DISC = """
class Disc:
    \"\"\"A round plate that pushes, whose proxy is the nearest point outside of it.\"\"\"

    def __init__(self, ports, period, parameters):
        self._centre, self._radius = parameters["centre"], parameters["radius"]

    def proxy(self, x, k):
        away = x - self._centre
        distance = float((away @ away) ** 0.5)
        return x if distance >= self._radius else self._centre + away * (self._radius / distance)
"""
PLATE = """
session: plate
period: 0.001
devices:
  hand:
    {dof: 2, osp: 1.37, driver: simulated, mass: 0.2, hand: {stiffness: 300, damping: 5,
     motion: ["0.05*min(1, 4*t)", "0.01*sin(2*pi*2*t)"]}}
couplings: {to_hand: {devices: [hand]}}
environment:
  type: python
  model: "disc:Disc"
  stiffness: 20000
  parameters: {centre: 0.04, radius: 0.035}
design: {coupling: spring-damper}
"""
LIFT = """
session: lift
period: 0.001
devices:
  anna:
    {dof: 3, axes: [x, y, z], osp: 1.37, driver: simulated, mass: 0.2, hand: {stiffness: 300, damping: 5,
     motion: [0, "-0.04*min(1, 2*t)", 0]}}
couplings: {to_anna: {devices: [anna]}}
environment:
  type: scene
  gravity: [0, -9.81, 0]
  tools: {anna: {at: [-0.02, 0.07, 0], radius: 0.01}}
  bodies:
    lift: {shape: box, low: [-0.05, 0, -0.05], high: [0.05, 0.05, 0.05], motion: [0, "0.02*sin(9*t)", 0]}
    rod: {shape: capsule, mass: 0.1, ends: [[0.03, 0.07, -0.02], [0.03, 0.07, 0.02]], radius: 0.015}
    crate: {shape: box, mass: 0.1, low: [0.02, 0.09, -0.02], high: [0.04, 0.11, 0.02]}
  obstacles: {floor: {shape: wall, at: [0, -0.1, 0], normal: [0, 1, 0]}}
  contact: {stiffness: 3000, damping: 2, friction: 0.6}
  tank: 0.03
design: {coupling: spring-damper}
"""


def long(name: str) -> object:
    return pytest.param(name, marks=pytest.mark.long)


@pytest.mark.parametrize(
    "name",
    [
        *("lift", "mujoco", "gripper", "insert", "screw"),
        *map(long, ("stretcher", "carry", "rub", "peg", "tray", "puck", "plate")),
    ],
)
def test_processes_simulation_replay_and_audit_agree_to_the_last_bit(name: str, tmp_path: Path) -> None:
    """Scenes, engines, a model that is asked for forces, and one that is asked for positions."""
    engine, ticks = name in ENGINES, ENGINES.get(name, TICKS)
    if engine and importlib.util.find_spec("mujoco") is None:
        pytest.skip("the extra mujoco is not installed")
    (tmp_path / "disc.py").write_text(DISC)
    for own, text in (("plate", PLATE), ("lift", LIFT)):
        (tmp_path / f"{own}.yaml").write_text(text)
    folder = ROOT / "examples" if name == "puck" else tmp_path if name in ("plate", "lift") else SESSIONS
    prepared = prepare(load_named(folder / f"{name}.yaml"))
    expected = Simulation(prepared).run(ticks)
    path = tmp_path / "run.mcap"
    recorder = RecorderProcess(prepared, "simulated", path)
    ways = reach(prepared, "ipc")
    outcome = Supervisor(prepared, clock="simulated", reach=ways, ticks=ticks, record=False, recorder=recorder).run()
    assert (outcome.code, outcome.faults, outcome.incidents) == (0, (), ())

    run = read_run(path)
    assert abs(expected.f_v).max() > 0.5  # the hands do meet something
    found = read_recording(path)
    assert found.x.tobytes() == expected.x.tobytes()
    assert found.f_v.tobytes() == expected.f_v.tobytes()
    again = replay(prepared, run)
    assert (again.identical, again.ticks, again.missing, again.deviations) == (True, ticks, {}, ())
    done = audit(path, run, lambda text: None, lambda tick: None)
    assert done.holds
    # an audit runs no code that a session names, so it cannot compute such an environment again
    foreign = engine or name in ("puck", "plate")
    if name == "gripper":
        turned = run.traces["environment", "orientations"]
        assert [*turned.columns] == [f"{body}.q{part}" for body in ("cube", "finger") for part in "wxyz"]
        assert np.linalg.norm(turned.values.reshape(ticks, 2, 4), axis=2) == pytest.approx(1.0, abs=1e-12)
        assert np.ptp(turned.values[:, 6]) > 0.1  # the finger's
    if name == "insert":
        assert np.ptp(run.traces["peg", "orientation"].values[:, 3]) > 0.1
        assert abs(run.traces["peg", "torque"].values[2500:, 2]).max() > 0.005  # N·m: the hole holds it
    if name == "stretcher":
        assert run.traces["back", "account"].values[-1, 2] > 1e-4  # J: granted to the wrist that only holds
    if name == "screw":
        felt = run.traces["driver", "torque"].values[:, 2]
        assert 0.005 < 1.1 * felt[1200:1250].mean() < felt[-50:].mean()  # N·m: it is harder to turn the deeper it is
    if name in ("insert", "stretcher", "screw"):
        assert {row.promise: row.state for row in done.promises}["orientation account"] == "kept"
    unchecked = {check.party for check in done.checks if check.verdict is not CheckVerdict.HOLDS}
    assert unchecked == ({"environment"} if foreign else set())
