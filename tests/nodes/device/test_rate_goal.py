"""A deflection moves a goal at its speed, from rest, within its reach; the device that follows keeps its promise."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.design.models.statespace import StateSpace
from manyhands.nodes.device.core import DeviceCore
from manyhands.nodes.device.drivers import driver_of
from manyhands.nodes.device.motion_sources.source import MotionSourceError
from manyhands.nodes.device.pointer import ACCELERATION, RATE, REACH, SPEED, Follower, pointer_hand
from manyhands.nodes.device.rate_goal import RateGoal
from manyhands.nodes.device.simulated import OwnTimeDriver
from manyhands.nodes.kernel.bundle import (
    OWN,
    REALTIME,
    SIMULATED,
    WALL,
    DeviceBundle,
    Limits,
    PersonHand,
    RateMotion,
    SimulatedHand,
)
from manyhands.nodes.rows import figures as names
from manyhands.protocol.plain import Unfit, read, written
from tests.fakes.motion_device import fake_motion_device
from tests.support.instants import instant
from tests.support.mechanisms import mechanism_bundle

T = 1e-3
LIMITS = Limits((30.0,) * 2, (0.1, 0.05), (3.0, 0.4))
OPERATOR = StateSpace.static(np.zeros((2, 2)))
HAND = SimulatedHand((0.2,) * 2, (1.37,) * 2, OPERATOR, (5.0,) * 2, (200.0,) * 2, (0.0,) * 2, (0.0,) * 2)
SPEED_AT_FULL, DEAD = 0.1, 0.2


class Stick:
    """A device that a test deflects."""

    def __init__(self) -> None:
        self.deflection = [0.0, 0.0, 0.0]
        self.pressed = False
        self.reports = self.refused = self.closed = 0

    def look(self) -> bool:
        pressed, self.pressed = self.pressed, False
        return pressed

    def close(self) -> None:
        self.closed += 1


def a_goal(stick: Stick, speed: float = SPEED_AT_FULL) -> RateGoal:
    follower = Follower([0.08, 0.04], [SPEED, 0.2], ACCELERATION, RATE, T)
    return RateGoal(stick, ((0, 1.0), (2, -1.0)), speed, DEAD, follower, T)


def test_a_deflection_is_a_speed_beyond_its_dead_zone() -> None:
    """Half of what is left of full deflection is half the speed, and axes are mapped with their signs."""
    stick = Stick()
    goal = a_goal(stick)
    assert goal.tick() is None
    stick.deflection = [0.0, 1.0, (1.0 + DEAD) / 2.0]
    assert goal.tick() is not None
    assert goal.begin([0.01, 0.02]) == [0.01, 0.02]
    for _ in range(100):
        at = goal.tick()
    assert at == pytest.approx([0.01, 0.02 - 100 * T * SPEED_AT_FULL / 2.0])
    stick.deflection = [-1.0, 0.0, DEAD]
    for _ in range(100):
        at = goal.tick()
    assert at == pytest.approx([0.0, 0.015])
    stick.deflection = [0.0, 0.0, 0.0]
    assert goal.tick() == at  # who lets the cap go holds still


def test_the_goal_stays_within_its_reach_and_moves_no_faster_than_its_follower() -> None:
    stick = Stick()
    goal = a_goal(stick, speed=0.4)
    goal.tick()
    stick.deflection = [1.0, 0.0, -1.0]
    goal.tick()
    before = goal.begin([1.0, 0.0])
    assert before == [0.08, 0.0]
    at = goal.tick()
    assert at is not None
    assert at[1] == pytest.approx(T * 0.2)  # of the follower
    for _ in range(1000):
        at = goal.tick()
    assert at == [0.08, 0.04]
    assert goal.figures()[names.GRASPS_CLIPPED] == 1001.0
    stick.deflection = [-1.0, 0.0, 0.0]
    at = goal.tick()
    assert at == pytest.approx([0.08 - T * 0.4, 0.04])  # it comes back at once, whatever was asked beyond


def test_a_hand_closes_only_from_rest_and_a_button_opens_it() -> None:
    stick = Stick()
    stick.deflection = [0.5, 0.0, 0.0]  # it drifts, or is held, from the start
    goal = a_goal(stick)
    assert [goal.tick() for _ in range(3)] == [None] * 3
    stick.deflection = [DEAD, 0.0, 0.0]
    assert goal.tick() is None
    stick.deflection = [0.5, 0.0, 0.0]
    assert goal.tick() is not None
    goal.begin([0.0, 0.0])
    stick.pressed = True
    assert goal.tick() is None
    assert goal.tick() is None  # still deflected
    assert goal.figures()[names.GRASPED] == 0.0
    stick.deflection = [0.0, 0.0, 0.0]
    assert goal.tick() is None
    stick.deflection = [0.0, 0.0, 0.9]
    assert goal.tick() is not None
    assert goal.figures()[names.GRASPED] == 1.0
    goal.close()
    assert stick.closed == 1


turns = st.tuples(
    st.lists(st.sampled_from((-1.0, 0.0, 0.3, 1.0)), min_size=3, max_size=3),
    st.booleans(),
    st.integers(1, 60),
    st.floats(-3.0, 3.0),
)


@given(st.lists(turns, min_size=1, max_size=10))
def test_whatever_is_deflected_the_device_keeps_its_promise(acts: list[tuple[list[float], bool, int, float]]) -> None:
    """Its ledger, with the work of the hand's intention, never falls below 0, at any force."""
    stick = Stick()
    axes = ((0, 1.0), (2, -1.0))
    hand = pointer_hand(HAND, LIMITS, T, lambda follower: RateGoal(stick, axes, SPEED, 0.0, follower, T))
    driver, level = OwnTimeDriver(hand), 1.37 * np.eye(2)
    core, tick = DeviceCore(level, np.linalg.inv(level) * T / 2.0, T), 0
    for deflection, stick.pressed, ticks, force in acts:
        stick.deflection = deflection
        for _ in range(ticks):
            core.sample(driver.sample(tick, instant(tick)))
            driver.apply([force, -force], instant(tick))
            tick += 1
            driver.idle(instant(tick))
            core.apply([force, -force], driver.intended_work())
        if driver.figures()[names.GRASPED]:
            reach = [REACH * most for most in LIMITS.displacement]
            assert all(abs(at) <= most for at, most in zip(hand._source.begin([9.0, -9.0]), reach, strict=True))
    driver.close()
    assert core.ledger.minimum >= -1e-12


def bundle(rate: RateMotion, clock: str) -> DeviceBundle:
    """The bundle of a device of two axes, without a directory."""
    of, source = mechanism_bundle(), PersonHand(HAND, rate)
    common = dataclasses.replace(of.common, clock=clock, directory="")
    return dataclasses.replace(
        of, common=common, osp=1.37 * np.eye(2), source=source, limits=LIMITS, time=WALL if clock == REALTIME else OWN
    )


def test_a_bundle_has_what_moves_the_goal_and_its_driver_reads_it(tmp_path: Path) -> None:
    with fake_motion_device("compact", tmp_path) as fake:
        rate = RateMotion("spacemouse", str(fake.path), ("x", "-rz"), 0.15, 0.05)
        of = bundle(rate, REALTIME)
        again = read(DeviceBundle, written(of))
        assert isinstance(again.source, PersonHand)
        assert again.source.rate == rate
        driver = driver_of(again)
        for tick in range(1, 50):
            driver.sample(tick, instant(tick))
        fake.deflect(1.0, 0.0, 0.0, 0.0, 0.0, -1.0)
        for tick in range(50, 300):
            x = driver.sample(tick, instant(tick))
        # a follower of 30 rad/s is 2/30 s behind
        assert x == pytest.approx([0.15 * (0.25 - 2.0 / 30.0)] * 2, abs=0.003)
        fake.unplug()
        with pytest.raises(MotionSourceError, match="plug it in again"):
            driver.sample(302, instant(302))
        assert driver.release(instant(303)) is not None  # as the loop does at its end, whatever ended it
        assert driver.figures()[names.GRASPED] == 0.0
        driver.close()


def test_under_the_simulated_clock_nobody_holds_it_and_nothing_is_opened() -> None:
    driver = driver_of(bundle(RateMotion("gamepad", "/nowhere", ("x", "y"), 0.1, 0.1), SIMULATED))
    for tick in range(20):
        assert driver.sample(tick, instant(tick)) == [0.0, 0.0]
        driver.apply([0.0, 0.0], instant(tick))
    assert driver.figures()[names.GRASPED] == 0.0
    driver.close()


@pytest.mark.parametrize(
    ("change", "found"),
    [
        ({"speed": 0.0}, r"speed: found 0.0; expected more than 0 m/s"),
        ({"speed": math.inf}, "speed: found"),
        ({"dead_zone": 1.0}, r"dead_zone: found 1.0; expected at least 0, below 1"),
        ({"axes": ["x"]}, "axes"),
        ({"axes": [1, 2]}, "axes"),
        ({"source": None}, "source: found None"),
        ({"more": 1}, "more"),
    ],
)
def test_a_bundle_that_does_not_fit_is_refused(change: dict[str, object], found: str) -> None:
    data = written(bundle(RateMotion("gamepad", "", ("x", "y"), 0.1, 0.1), REALTIME))
    data["source"]["rate"] |= change
    with pytest.raises(Unfit, match=found):
        read(DeviceBundle, data)


@pytest.mark.parametrize(
    ("rate", "found"),
    [
        (RateMotion("wheel", "", ("x", "y"), 0.1, 0.1), "'wheel'; expected one of spacemouse, gamepad"),
        (RateMotion("gamepad", "", ("x", "ry"), 0.1, 0.1), "'ry' of a gamepad; expected one of x, y, z, rx, triggers"),
        (RateMotion("gamepad", "/dev/null", ("x", "y"), 0.1, 0.1), "another kind of file"),
    ],
)
def test_a_kind_or_an_axis_that_there_is_not_is_named(rate: RateMotion, found: str) -> None:
    with pytest.raises(ValueError, match=found):
        driver_of(bundle(rate, REALTIME))
