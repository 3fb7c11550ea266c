"""Dry friction in the joints of a simulated linkage: it burns c |dq| in each step, and a joint stands where it must."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.design.models.device import held_device
from manyhands.design.models.statespace import StateSpace
from manyhands.nodes.device.drivers import driver_of
from manyhands.nodes.device.dry_joints import DryMechanism
from manyhands.nodes.device.mechanism import Mechanism
from manyhands.nodes.device.simulated import HeldDeviceDriver, IntentHand, Intention, OwnTimeDriver
from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.kernel.bundle import WALL, SimulatedHand
from manyhands.protocol.clock import Instant
from tests.support.instants import instant
from tests.support.mechanisms import ALL_LINKAGES, CHAIN, DELTA, mechanism_bundle

T = 1e-3
TICK = 1_000_000
MASS = 0.1


def mechanism(data: Mapping[str, Any], c: float = 0.03) -> DryMechanism:
    """A bare mass behind these joints, without damping."""
    m = 3 if data["kind"] == "delta" or len(data["low"]) == 3 else 2
    device = held_device([MASS] * m, [0.0] * m, StateSpace.static(np.zeros((m, m))), [0.0] * m, [0.0] * m)
    return DryMechanism(device, T, data, [c * (1.0 + 0.5 * joint) for joint in range(m)])


def still(m: int) -> Intention:
    return Intention([0.0] * m, [0.0] * m)


def kinetic(state: Floats, m: int) -> float:
    return 0.5 * MASS * sum(v * v for v in state[m : 2 * m])


@pytest.mark.parametrize("data", ALL_LINKAGES.values(), ids=list(ALL_LINKAGES))
@given(
    v=st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3),
    forces=st.lists(st.lists(st.floats(-8.0, 8.0), min_size=3, max_size=3), min_size=1, max_size=5),
    part=st.sampled_from([1, 40_000, 499_999, 500_001, TICK]),
)
@settings(max_examples=15, deadline=None)
def test_friction_takes_c_times_the_angles_and_never_gives(
    data: Mapping[str, Any], v: list[float], forces: list[list[float]], part: int
) -> None:
    """What the motors did and the mass has not is burned: in each step c |dq| of every joint, and more at a stand."""
    plant = mechanism(data)
    m, n = plant.axes, plant.order
    c = np.array(plant._friction)
    state = plant.holding([0.0] * m, [0.3 * speed for speed in v[:m]])
    for f in forces:
        before, t = state, plant.holds(f[:m], state)
        state = plant.after(before, t, still(m), part)
        dq = np.array(state[n : n + m]) - before[n : n + m]
        motors = float(np.array(t) @ dq) if part <= 500_000 else plant.done(state) - plant.done(before)
        burned = motors - (kinetic(state, m) - kinetic(before, m))
        assert plant.done(state) - plant.done(before) == pytest.approx(motors, abs=1e-14)
        assert burned >= float(c @ np.abs(dq)) - 1e-13
        impulse = np.array(state[n + m : n + 2 * m]) - before[n + m : n + 2 * m]
        assert impulse == pytest.approx(MASS * (np.array(state[m : 2 * m]) - before[m : 2 * m]), abs=1e-13)


@pytest.mark.parametrize("data", ALL_LINKAGES.values(), ids=list(ALL_LINKAGES))
def test_joints_that_go_on_turning_burn_no_more_than_that(data: Mapping[str, Any]) -> None:
    plant = mechanism(data)
    m, n = plant.axes, plant.order
    J = np.array([plant._joints.torque(unit, [0.0] * m, plant._joints.home) for unit in np.eye(m).tolist()])
    before = plant.holding([0.0] * m, (J @ np.full(m, 2.0 if m == 2 else 1.5)).tolist())
    after = plant.after(before, [0.0] * m, still(m))
    dq = np.array(after[n : n + m]) - before[n : n + m]
    assert np.all(dq > 1e-4)
    burned = kinetic(before, m) - kinetic(after, m)
    assert burned == pytest.approx(float(np.array(plant._friction) @ dq), abs=1e-14)


@pytest.mark.parametrize("data", [CHAIN, DELTA], ids=["chain", "delta"])
def test_each_joint_stands_up_to_its_friction_and_turns_with_the_rest_beyond(data: Mapping[str, Any]) -> None:
    plant = mechanism(data)
    m, n, c = plant.axes, plant.order, plant._friction
    home = plant.holding([0.0] * m, [0.0] * m)
    below = [0.99 * limit for limit in c]
    state = home
    for _ in range(20):
        state = plant.after(state, below, still(m))
    assert (state[: 2 * m], state[n : n + m]) == (home[: 2 * m], home[n : n + m])
    for joint in range(m):  # the others are held by their friction, to rounding
        t = [1.5 * limit if other == joint else 0.0 for other, limit in enumerate(c)]
        state = plant.after(home, t, still(m))
        turned = np.array(state[n : n + m]) - home[n : n + m]
        others = np.delete(turned, joint)
        assert turned[joint] > 1e-6
        assert np.abs(others).max() < 1e-12
        rates = np.array([np.dot(row, state[m : 2 * m]) for row in plant._joints.by_tip(state[:m], state[n : n + m])])
        assert np.abs(np.delete(rates, joint)).max() < 1e-9
        assert rates[joint] > 1e-3


def test_a_swing_comes_to_a_stand_and_does_not_creep() -> None:
    plant = mechanism(CHAIN)
    state = plant.holding([0.0, 0.0], [0.3, -0.2])
    for _ in range(200):
        state = plant.after(state, [0.01, -0.01], still(2))
    place = state[:2]
    assert state[2:4] == [0.0, 0.0]
    for tick in range(100):
        state = plant.after(state, [0.02 * (-1.0) ** tick, 0.03], still(2))
        assert state[:4] == [*place, 0.0, 0.0]


def test_with_hardly_any_friction_it_moves_as_the_mechanism_without() -> None:
    plant, free = mechanism(CHAIN, 1e-12), Mechanism(mechanism_device(), T, CHAIN)
    ours, theirs = (one.holding([0.0, 0.0], [0.3, -0.1]) for one in (plant, free))
    for tick in range(30):
        t = free.holds([8.0 * (-1.0) ** (tick // 5), 3.0], theirs)
        ours, theirs = plant.after(ours, t, still(2)), free.after(theirs, t, still(2))
    assert ours == pytest.approx(theirs, abs=1e-9)


def mechanism_device() -> Any:
    return held_device([MASS] * 2, [0.0] * 2, StateSpace.static(np.zeros((2, 2))), [0.0] * 2, [0.0] * 2)


def test_own_time_is_wall_time_with_events_on_the_ticks_and_its_work_is_exact() -> None:
    """A hand of a damper alone: its force is b_h (v - v_m), so that its work follows from the way."""
    b = 3.0
    device = held_device([MASS] * 2, [0.2] * 2, StateSpace.static(np.zeros((2, 2))), [b] * 2, [0.0] * 2)

    def driven() -> IntentHand:
        plant = DryMechanism(device, T, CHAIN, [0.02, 0.03])
        motions = [lambda t: 0.01 * math.sin(12.0 * t), lambda t: 0.05 * t * t]
        return IntentHand(plant, [lambda t: 0.0] * 2, motions, T)

    own, wall = OwnTimeDriver(driven()), HeldDeviceDriver(driven(), T)
    before, goal = [0.0, 0.0], np.zeros(2)
    for tick in range(150):
        at = Instant(tick * TICK)
        x = own.sample(tick, at)
        assert wall.sample(tick, at) == pytest.approx(x, rel=1e-9, abs=1e-14)
        moved = np.array(x) - before
        assert own.intended_work() == pytest.approx(-float(goal @ (b * (moved - goal * T))), abs=1e-12)
        assert wall.intended_work() == pytest.approx(own.intended_work(), abs=1e-12)
        assert wall.work() == pytest.approx(own.work(), abs=1e-13)
        for driver in (own, wall):
            driver.apply([-300.0 * x[0], 1.0], at)
        t, before = tick * T, x
        ends = (np.array([0.01 * math.sin(12.0 * s), 0.05 * s * s]) for s in (t, t + T))
        goal = -np.subtract(*ends) / T


def test_the_work_of_the_motors_in_wall_time_is_what_friction_and_mass_have() -> None:
    """Whenever it is sampled: the mass has at most what the motors did, less c |dq| between the samples."""
    nothing = StateSpace.static(np.zeros((2, 2)))
    linkage = {**CHAIN, "friction": [0.02, 0.03]}
    zeros = (0.0,) * 2
    source = SimulatedHand((MASS,) * 2, zeros, nothing, zeros, zeros, zeros, zeros, linkage)
    driver = driver_of(dataclasses.replace(mechanism_bundle(), source=source, time=WALL))
    rng, done, ways, joints = np.random.default_rng(5), 0.0, 0.0, None
    for turn in range(80):
        for call in (0.1, 0.4):
            if call == 0.1:
                driver.sample(turn, instant(turn + call))
            else:
                driver.apply(((-1.0) ** (turn // 5) * rng.uniform(-2.0, 2.0, 2)).tolist(), instant(turn + call))
            done += driver.work() or 0.0
            state = driver._latest()  # type: ignore[attr-defined]
            q = np.array(state[6:8])
            ways += 0.0 if joints is None else float(np.array([0.02, 0.03]) @ np.abs(q - joints))
            joints = q
            assert kinetic(state, 2) <= done - ways + 1e-13
    assert ways > 1e-4
    assert kinetic(state, 2) > 0.0


def test_what_is_no_friction_of_the_joints_is_refused() -> None:
    for friction in ([0.1], [0.1, 0.0], [0.1, -0.1], [0.1, 0.1, 0.1]):
        with pytest.raises(ValueError, match=r"friction: found .*; expected 2 numbers above 0, one a joint"):
            DryMechanism(mechanism_device(), T, CHAIN, friction)
