"""Scenes in closed loop: certified couplings, simulated devices, hands that move at random."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from manyhands.design.models.scene import ContactScene
from manyhands.launch.audit.simulation import Silence, Simulation
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.session import Session, load_session
from manyhands.nodes.environment.enforced import EnforcedCore

from ...support.scenes import random_scene, scene_session

SHIPPED = Path(__file__).parents[3] / "launch" / "sessions"


def session_of(scene: ContactScene, rng: np.random.Generator) -> Session:
    """A session in which hands shake the tools of a scene, a device of 1.37 N·s/m for each."""

    def motion() -> str:
        size, frequency, phase = rng.uniform(0.0, 0.06), rng.uniform(0.5, 8.0), rng.uniform(0.0, 6.0)
        return f"{size}*(sin(2*pi*{frequency}*t+{phase})-sin({phase}))"

    devices = {
        tool.name: {
            "osp": 1.37,
            "mass": 0.2,
            "hand": {"stiffness": 300, "damping": 4, "motion": [motion() for _ in tool.ports]},
        }
        for tool in scene.tools
    }
    design = {"coupling": "given", "stiffness": 900, "damping": 0.2}
    return Session.model_validate(scene_session(scene, devices, design))


@pytest.mark.parametrize("seed", range(int(os.environ.get("MANYHANDS_SCENES", "4"))))  # `make scenes` runs 500
def test_every_account_holds_in_a_random_scene(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, int(rng.integers(1, 4)), int(rng.integers(0, 5)), int(rng.integers(1, 4)))
    simulation = Simulation(prepare(session_of(scene, rng)))
    signals = simulation.run(300)
    assert isinstance(simulation.environment, EnforcedCore)
    assert np.abs(signals.x).max() < 0.5
    assert np.abs(signals.f_v).max() < 500.0
    stored = scene.energy_at_start
    for name, ledger in simulation.ledgers.items():
        assert ledger.minimum >= -1e-9 * (1.0 + stored), name
    assert simulation.environment.controller is not None
    assert simulation.environment.controller.energy <= 1e-6 * (1.0 + stored)


def test_a_user_who_falls_silent_comes_back_to_the_ball() -> None:
    """While one user is frozen the other goes on, and no account falls below 0 when the first one comes back."""
    simulation = Simulation(prepare(load_session(SHIPPED / "carry.yaml")))
    recording = simulation.run(2200, faults=[Silence("to_ben", 1300, 1700)])
    assert not recording.f_v[1300:1700, 3:].any()
    assert np.abs(recording.f_v[1300:1700, :3]).max() > 1.0
    assert simulation.environment.clutches.all[1].ratio > 0.7
    assert min(ledger.minimum for ledger in simulation.ledgers.values()) >= -1e-12


def test_a_ball_is_handed_over_by_buttons() -> None:
    simulation = Simulation(prepare(load_session(SHIPPED / "handover.yaml")))
    environment, found = simulation.environment, {}
    assert isinstance(environment, EnforcedCore)

    def look(ticks: int) -> None:
        found[ticks] = (*environment.masses[:2], environment.figures["holding"])

    simulation.run(6000, progress=look)
    seconds = (2000, 3000, 4000, 6000)  # anna holds it; both do; ben does; and it lies at his side
    assert [found[k][2] for k in seconds] == [1.0, 2.0, 1.0, 0.0]
    assert [found[k][0] for k in seconds] == pytest.approx([0.024, 0.06, 0.108, 0.12], abs=3e-3)
    assert [found[k][1] for k in seconds] == pytest.approx([0.073, 0.073, 0.067, 0.0], abs=3e-3)
    assert environment.controller is not None
    assert environment.controller.ticks == 0
    assert min(ledger.minimum for ledger in simulation.ledgers.values()) >= 0.0


@pytest.mark.parametrize("name", ["carry", "rub", "peg", "tray"])
def test_a_shipped_scene_runs_without_its_controller(name: str) -> None:
    """The promise comes from the contacts themselves: nothing is kept back in any tick."""
    prepared = prepare(load_session(SHIPPED / f"{name}.yaml"))
    assert prepared.certified
    simulation = Simulation(prepared)
    simulation.run(2000)
    environment = simulation.environment
    assert isinstance(environment, EnforcedCore)
    assert environment.controller is not None
    assert environment.controller.ticks == 0
    assert min(ledger.minimum for ledger in simulation.ledgers.values()) >= 0.0
    x, y, z = (environment.masses or environment.tools)[:3]
    if name == "carry":  # the ball hangs between two hands, by friction
        assert y > 0.04
        assert max(abs(x), abs(z)) < 1e-3
    elif name == "rub":  # it lags behind the hand, which is at 0
        assert y < -0.01
        assert x == pytest.approx(2.6e-4, abs=1e-4)
    elif name == "peg":  # on the plate, within the hole
        assert y == pytest.approx(-0.05, abs=1e-3)
        assert abs(0.004 + x) < 6e-4
    else:  # the tray hangs in the air
        assert min(environment.masses[1::3]) > 0.05
