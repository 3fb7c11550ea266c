"""The shipped screw: what a wrist turns goes in by the pitch of its thread, and is harder to turn the deeper it is."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import pytest

from manyhands.launch.audit.simulation import Simulation
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.session.shipped import load_named

from ...support.engine_runs import Traces, account_kept, simulated, world_kept

TICKS: Final = 7000
PITCH: Final = 0.002  # m a turn
STROKES: Final = slice(1200, 1900), slice(3200, 4100), slice(5400, 6300)
"""In which the blade is in the screw and turns it."""

IN_THE_AIR: Final = slice(2300, 2800), slice(4500, 5000), slice(6700, TICKS)


def driven(torque: str | None = None) -> tuple[Simulation, Traces]:
    """Seven seconds of the session; or of one in which the driver stays down, and the hand intends this torque."""
    session = load_named("screw", [])
    data: dict[str, Any] = session.to_dict()
    if torque is not None:
        data["devices"]["driver"]["orientation"]["torque"][2] = torque
        data["devices"]["driver"]["hand"]["motion"][2] = "-0.02*min(1, max(0, (t - 0.4)/0.3))"
    return simulated(data, TICKS)


def depth(traces: Traces) -> np.ndarray:
    """How far the screw has gone in, m."""
    found: np.ndarray = -traces["environment/masses"][:, 5]
    return found


def turns(traces: Traces, body: int) -> np.ndarray:
    """How far a body has been turned about the vertical, to the right; 0 is the driver, 1 the screw."""
    q = traces["environment/orientations"][:, 4 * body : 4 * body + 4]
    found: np.ndarray = -np.unwrap(2.0 * np.arctan2(q[:, 3], q[:, 0])) / (2.0 * np.pi)
    return found


@pytest.fixture(scope="module")
def run() -> tuple[Simulation, Traces]:
    return driven()


def test_turning_it_takes_it_in_by_the_pitch(run: tuple[Simulation, Traces]) -> None:
    _, traces = run
    deep, turned = depth(traces), turns(traces, 1)
    assert abs(deep - PITCH * turned).max() < 5e-6  # m, at every tick: the thread gives way by so much
    assert turned[-1] == pytest.approx(0.82, abs=0.05)
    for stroke in STROKES:
        assert np.diff(deep[stroke]).min() > 0.0


def test_the_driver_is_lifted_turned_back_and_finds_the_cross_again(run: tuple[Simulation, Traces]) -> None:
    _, traces = run
    driver, deep = turns(traces, 0), depth(traces)
    for lifted in IN_THE_AIR:
        assert np.ptp(deep[lifted]) < 1e-5  # m: what it has pressed does not unscrew it
        assert abs(traces["driver/torque"][lifted]).max() < 2e-3  # N·m
    for lifted in IN_THE_AIR[:2]:
        assert driver[lifted][0] - driver[lifted][-1] > 0.2
    for stroke in STROKES:  # driver and screw turn as one, within the play of the blade
        apart = driver[stroke] - turns(traces, 1)[stroke]
        assert np.ptp(apart) < 0.5 / 360.0


def test_the_wrist_feels_it_grow_with_the_depth(run: tuple[Simulation, Traces]) -> None:
    _, traces = run
    felt, deep = traces["driver/torque"][:, 2], depth(traces)
    every = np.concatenate([felt[stroke] for stroke in STROKES])
    where = np.concatenate([deep[stroke] for stroke in STROKES])
    slope, first = np.polyfit(where, every, 1)
    assert abs(every - (slope * where + first)).max() < 0.004  # N·m
    assert slope == pytest.approx(36.0, abs=6.0)  # N·m/m
    for stroke in STROKES:
        assert felt[stroke][-50:].mean() > 1.2 * felt[stroke][:50].mean()
    assert felt[STROKES[0]][:50].mean() == pytest.approx(0.0065, abs=0.002)  # N·m
    assert felt[STROKES[2]][-50:].mean() == pytest.approx(0.061, abs=0.006)


def test_a_hand_that_turns_less_hard_stops_before(run: tuple[Simulation, Traces]) -> None:
    """Its torque is that of the screw where it stops: so it is the screw that it feels."""
    _, traces = driven("0.042*pulse(t, 0, 0.4) - 0.02*pulse(t, 0.8, 8)")
    assert 0.0003 < depth(traces)[-1] < 0.4 * depth(run[1])[-1]
    assert traces["driver/torque"][-1, 2] == pytest.approx(0.02, abs=0.002)
    assert depth(traces)[-1] - depth(traces)[-1000] < 5e-5  # m: MuJoCo's friction creeps


def test_every_account_is_kept(run: tuple[Simulation, Traces]) -> None:
    simulation, traces = run
    assert sum(world_kept(simulation).held) < 10
    _, deposited, granted = account_kept(traces, "driver").T
    assert deposited[-1] > 0.05  # J: the wrist has turned the screw,
    assert granted[-1] < 0.01 * deposited[-1]  # and the screw turns no wrist
    assert np.linalg.norm(traces["driver/torque"], axis=1).max() < 0.2


def test_the_certificate_has_the_orientation() -> None:
    certificate = prepare(load_named("screw", [])).certificate
    assert certificate is not None
    (device,) = certificate.loop.devices
    assert device.orientation is not None
    assert (device.orientation.stiffness, device.orientation.osp) == (1.0, 0.0034)
