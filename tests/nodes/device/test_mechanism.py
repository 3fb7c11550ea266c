"""A simulated mechanism that holds torques: its joints, its exact work, and what ledger and account make of it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.design.levels.held_torque import HeldTorque
from manyhands.design.models.device import held_device
from manyhands.design.models.linkage import linkage_of
from manyhands.design.models.statespace import StateSpace
from manyhands.nodes.device.drivers import driver_of
from manyhands.nodes.device.mechanism import Mechanism, TipAstray, joints_of
from manyhands.nodes.device.simulated import Intention
from manyhands.nodes.device.tick import OwnTimeTick, WallTimeTick
from manyhands.nodes.kernel.allowance import LatenessAllowance
from manyhands.nodes.kernel.bundle import WALL, DeviceBundle, PersonHand, SimulatedHand
from tests.support.held_arm import Arm
from tests.support.instants import instant
from tests.support.mechanisms import ALL_LINKAGES, CHAIN, DELTA, FIVE_BAR, HOME, mechanism_bundle, swinging, worst

T = 1e-3
TICK = 1_000_000
bundle = pytest.fixture(scope="module")(mechanism_bundle)


@pytest.mark.parametrize("data", ALL_LINKAGES.values(), ids=list(ALL_LINKAGES))
@given(place=st.lists(st.floats(-0.015, 0.015), min_size=3, max_size=3), f=st.lists(st.floats(-5, 5), min_size=3))
def test_torques_push_by_the_derivative_of_the_joints(
    data: Mapping[str, Any], place: list[float], f: list[float]
) -> None:
    joints = joints_of(data)
    m = len(joints.home)
    x, f = place[:m], f[:m]
    q = joints.at(x, joints.home)
    t = joints.torque(f, x, q)
    assert joints.push(t, x, q) == pytest.approx(f, abs=1e-12)
    for axis in range(m):
        ends = [[at + side * (i == axis) for i, at in enumerate(x)] for side in (-1e-6, 1e-6)]
        before, after = (np.array(joints.at(end, q)) for end in ends)
        assert float(np.array(t) @ (after - before)) / 2e-6 == pytest.approx(f[axis], abs=1e-7)


@pytest.mark.parametrize("data", ALL_LINKAGES.values(), ids=list(ALL_LINKAGES))
@given(place=st.lists(st.floats(-0.015, 0.015), min_size=3, max_size=3))
def test_the_joints_are_those_that_a_certificate_bounds(data: Mapping[str, Any], place: list[float]) -> None:
    linkage, joints = linkage_of(data), joints_of(data)
    m = linkage.axes
    x = place[:m]
    q = joints.at(x, joints.home)
    pose = linkage.pose_at(linkage.tip(linkage.home) + x, linkage.home)
    assert np.mod(q - linkage.joints(pose) + 1.0, 2.0 * np.pi) == pytest.approx(1.0, abs=1e-9)
    J = linkage.jacobian(pose)
    for unit in np.eye(m).tolist():
        assert joints.torque(unit, x, q) == pytest.approx((J.T @ unit).tolist(), abs=1e-9)


def test_the_joints_are_at_home_in_the_middle_of_their_ranges() -> None:
    assert joints_of(CHAIN).at([0.0, 0.0], [0.4, 2.4]) == pytest.approx(HOME, abs=1e-14)
    arm, joints = Arm(HOME), joints_of(CHAIN)
    assert joints.at([0.01, -0.02], list(HOME)) == pytest.approx(arm.joints(np.array([0.01, -0.02])), abs=1e-12)
    five = joints_of(FIVE_BAR)  # symmetric: the right arm's angle and the left one's, each from outside
    assert five.home[0] == pytest.approx(five.home[1], abs=1e-12)
    elbow = np.array([0.025 + 0.1 * math.cos(five.home[1]), 0.1 * math.sin(five.home[1])])
    assert float(np.linalg.norm(elbow - [0.0, 0.145])) == pytest.approx(0.13, abs=1e-12)


@pytest.mark.parametrize(
    ("data", "found"),
    [
        ({}, "low"),
        ({**CHAIN, "kind": "rope"}, "rope"),
        ({**CHAIN, "turns": ["z"]}, "1 turns and 2 links; expected 2"),
        ({**CHAIN, "turns": ["z", "w"]}, "w"),
        ({**DELTA, "rod": "long"}, "long"),
        ({**DELTA, "rod": 0.01}, "found the tip of a simulated linkage"),
    ],
)
def test_what_is_no_linkage_is_refused(data: Mapping[str, Any], found: str) -> None:
    with pytest.raises(ValueError, match=f"(?s)linkage.*{found}"):
        joints_of(data)


def test_a_tip_that_no_joints_can_bring_there_ends_the_run() -> None:
    joints = joints_of(CHAIN)
    with pytest.raises(TipAstray, match=r"found the tip of a simulated linkage at .* m; expected it where its joints"):
        joints.at([0.5, 0.5], joints.home)


def mechanism(data: Mapping[str, Any], damping: float = 0.0, mass: float = 0.1) -> Mechanism:
    m = 3 if data["kind"] == "delta" or len(data["low"]) == 3 else 2
    nothing = StateSpace.static(np.zeros((m, m)))
    return Mechanism(held_device([mass] * m, [damping] * m, nothing, [0.0] * m, [0.0] * m), T, data)


@pytest.mark.parametrize("data", ALL_LINKAGES.values(), ids=list(ALL_LINKAGES))
@given(
    v=st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3),
    f=st.lists(st.floats(-12.0, 12.0), min_size=3, max_size=3),
    part=st.sampled_from([1, 40_000, 499_999, 500_001, TICK]),
)
def test_no_energy_comes_from_the_integration(
    data: Mapping[str, Any], v: list[float], f: list[float], part: int
) -> None:
    """Of a bare mass without damping: what the motors did is t^T dq, and is the kinetic energy that it gained."""
    plant = mechanism(data)
    m, n = plant.axes, plant.order
    before = plant.holding([0.0] * m, v[:m])
    t = plant.holds(f[:m], before)
    after = plant.after(before, t, Intention([0.0] * m, [0.0] * m), part)
    motors = sum(torque * (b - a) for torque, a, b in zip(t, before[n : n + m], after[n : n + m], strict=True))
    kinetic = [0.5 * 0.1 * sum(speed**2 for speed in state[m : 2 * m]) for state in (before, after)]
    assert plant.done(after) == pytest.approx(motors, abs=1e-14)
    assert plant.done(after) == pytest.approx(kinetic[1] - kinetic[0], abs=1e-14)
    impulse = [0.1 * (after[m + i] - before[m + i]) for i in range(m)]
    assert after[n + m : n + 2 * m] == pytest.approx(impulse, abs=1e-14)


def test_a_long_step_moves_the_mass_as_many_short_ones_do() -> None:
    plant = mechanism(CHAIN, 0.2)
    at_rest = Intention([0.0, 0.0], [0.0, 0.0])
    before = plant.holding([0.0, 0.0], [0.5, -0.2])
    t = plant.holds([12.0, 5.0], before)
    whole, steps = plant.after(before, t, at_rest), before
    for _ in range(100):
        steps = plant.after(steps, t, at_rest, TICK // 100)
    assert whole[:2] == pytest.approx(steps[:2], abs=1e-7)  # of 0.6 mm
    assert whole[2:4] == pytest.approx(steps[2:4], abs=1e-5)
    held = plant.after(before, t, at_rest)[2:4]
    free = plant._linear(before[: plant.order], [12.0, 5.0], at_rest, TICK, plant.order)[2:4]
    assert max(map(abs, np.subtract(held, free))) > 4e-4  # m/s, that the torques make


@pytest.mark.parametrize(("linkage", "broken"), [(None, False), (CHAIN, True)], ids=["force", "torque"])
def test_a_promise_that_ignores_the_torques_is_seen_to_be_broken(
    bundle: DeviceBundle, linkage: Mapping[str, Any] | None, broken: bool
) -> None:
    """The ledger of a device in its own time has the ports' work, and the intention's by what really pushed the tip."""
    bundle = dataclasses.replace(bundle, source=swinging(linkage))
    assert (min(ledger_of(bundle)) < -0.05) == broken


def ledger_of(bundle: DeviceBundle) -> list[float]:
    """The ledger after each of 5 s' ticks in which the couplings ask for 12 N, in the device's own time."""
    tick, totals = OwnTimeTick(bundle, driver_of(bundle)), []
    _, push = worst()
    for turn in range(5_000):
        tick.sample(turn, instant(turn))
        tick.exert(push, instant(turn))
        tick.book()
        totals.append(tick.ledger.total)
    return totals


HELD = HeldTorque(19.0, 12.0, 1.5)


def test_a_promise_of_what_the_torques_leave_is_kept(bundle: DeviceBundle) -> None:
    hand = dataclasses.replace(swinging(CHAIN), damping=(0.15,) * 2)
    kept = dataclasses.replace(bundle, source=hand, osp=0.15 * np.eye(2), held=HELD)
    totals = ledger_of(kept)
    assert kept.levels[0][0, 0] == pytest.approx(0.034, abs=0.001)
    assert min(totals) >= 0.0


def test_the_work_of_a_device_in_wall_time_is_what_moved_it(bundle: DeviceBundle) -> None:
    """A bare mass without damping, under forces that begin and end at any instant: its energy is that of the motors."""
    nothing = StateSpace.static(np.zeros((2, 2)))
    source = SimulatedHand((0.1,) * 2, (0.0,) * 2, nothing, (0.0,) * 2, (0.0,) * 2, (0.0,) * 2, (0.0,) * 2, CHAIN)
    places = []
    for idles in (False, True):
        driver = driver_of(dataclasses.replace(bundle, source=source, time=WALL))
        rng, total, moved = np.random.default_rng(5), 0.0, []
        for turn in range(60):
            moved.append(driver.sample(turn, instant(turn + 0.1)))
            total += driver.work() or 0.0
            force = (-1.0) ** (turn // 5) * rng.uniform(-2.0, 2.0, 2)
            until = None if turn % 3 else instant(turn + 0.8)
            driver.apply(force.tolist(), instant(turn + 0.4), until)
            if turn % 2:
                total += driver.work() or 0.0
            if turn % 7 == 0:
                driver.release(instant(turn + 0.6))
            if idles:
                driver.intended_work()
                driver.idle(instant(turn + 1))
        driver.sample(60, instant(60))
        total += driver.work() or 0.0
        v = driver._present.state[2:4]
        assert total == pytest.approx(0.05 * (v[0] ** 2 + v[1] ** 2), abs=1e-12)
        assert total > 1e-4
        places.append(moved)
    assert places[0] == places[1]


@pytest.mark.parametrize(
    ("held", "late", "broken"),
    [(HELD, 0.0, False), (HELD, 1.5, False), (None, 0.0, True)],
    ids=["stated", "late", "ignored"],
)
def test_in_wall_time_only_torques_that_were_not_stated_break_the_promise(
    bundle: DeviceBundle, held: HeldTorque | None, late: float, broken: bool
) -> None:
    """Where every tenth force is late by more than a tick, lateness may take the tank, and no more."""
    E_0 = 5e-3
    hand, osp = dataclasses.replace(swinging(CHAIN), damping=(0.15,) * 2), 0.15 * np.eye(2)
    bundle = dataclasses.replace(bundle, source=hand, osp=osp, held=held, time=WALL, allowance=LatenessAllowance(E_0))
    tick, totals, turn, at = WallTimeTick(bundle, driver_of(bundle)), [], 0, 0.0
    _, push = worst()
    while at < 5_000:
        tick.sample(turn, instant(at))
        delay = late if turn % 10 == 9 else 0.0
        tick.exert(push, instant(at + delay))
        tick.book()
        totals.append(tick.ledger.total)
        turn, at = turn + 1, at + (2.0 if delay else 1.0)
    assert (min(totals) < -10.0 * E_0) == broken
    assert tick.wall_interface.account.least >= -E_0


def test_a_linkage_behind_a_pointer_is_refused() -> None:
    with pytest.raises(ValueError, match="found a linkage of a device that a pointer moves"):
        PersonHand(swinging(CHAIN))
