"""The follower of a pointer stays within its bounds for any motion, and arrives without overshoot."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.nodes.device.pointer import ACCELERATION, RATE, SPEED, Follower

ROUNDING = 1e-12  # of the reach: two roundings a tick, over some thousands
REACH = 0.1

periods = st.sampled_from([1e-5, 2.5e-4, 1e-3, 1e-2, 0.1])
finite = st.floats(allow_nan=False, allow_infinity=False)
goals = st.lists(st.tuples(st.floats(-0.5, 0.5) | finite, st.integers(1, 60)), min_size=1, max_size=12)


def follower(T: float, reach: float = REACH) -> Follower:
    return Follower([reach], [SPEED], ACCELERATION, RATE, T)


@given(goals, periods)
def test_reach_speed_and_acceleration_are_kept_whatever_is_wanted(wanted: list[tuple[float, int]], T: float) -> None:
    one, before, velocity = follower(T), 0.0, 0.0
    for goal, ticks in wanted:
        for _ in range(ticks):
            (v,) = one.step([goal])
            (x,) = one.position
            assert abs(x) <= REACH * (1.0 + ROUNDING)
            assert abs(v) <= SPEED * (1.0 + ROUNDING)
            assert abs(v - velocity) <= ACCELERATION * T * (1.0 + ROUNDING)
            assert x - before == pytest.approx(v * T, abs=ROUNDING * REACH)  # the velocity is that of the motion
            before, velocity = x, v


@given(st.floats(-REACH, REACH), st.floats(-REACH, REACH), st.sampled_from([1e-3, 1e-2, 0.1]))
def test_from_rest_it_arrives_and_does_not_overshoot(begin: float, goal: float, T: float) -> None:
    one = follower(T)
    one.begin([begin])
    distance, side = abs(goal - begin), np.sign(goal - begin)
    # at full speed all the way, and then the follower's own decay to a thousandth, (1 + 10) exp(-10)
    slowest = distance / one.speed[0] + one.speed[0] / ACCELERATION + 10.0 / RATE
    for _ in range(int(np.ceil(slowest / T)) + 10):
        one.step([goal])
        assert side * (goal - one.position[0]) >= -ROUNDING * REACH
    assert abs(goal - one.position[0]) <= 1e-3 * distance + ROUNDING * REACH


@given(st.floats(0.0, 1.0), goals)
def test_begun_beyond_its_reach_it_comes_back_and_no_further(beyond: float, wanted: list[tuple[float, int]]) -> None:
    one = follower(1e-3)
    one.begin([REACH + beyond])
    before = REACH + beyond
    for goal, ticks in wanted:
        for _ in range(ticks):
            one.step([goal])
            assert -REACH * (1.0 + ROUNDING) <= one.position[0] <= max(before, REACH) + ROUNDING
            before = one.position[0]


def test_axes_are_apart() -> None:
    both = Follower([0.1, 0.02], [0.5, 0.05], ACCELERATION, RATE, 1e-3)
    alone = [Follower([0.1], [0.5], ACCELERATION, RATE, 1e-3), Follower([0.02], [0.05], ACCELERATION, RATE, 1e-3)]
    for tick in range(300):
        goal = [0.08, -0.3] if tick < 150 else [-0.1, 0.01]
        assert both.step(goal) == [one.step([at])[0] for one, at in zip(alone, goal, strict=True)]
    assert both.position == [alone[0].position[0], alone[1].position[0]]


def test_a_follower_faster_than_it_can_brake_would_overshoot() -> None:
    """Why the speed is bounded by the acceleration: what the check above is able to see."""
    one = follower(1e-3, reach=10.0)
    one._most = [5.0 * 1e-3]
    furthest = 0.0
    for _ in range(4000):
        one.step([2.0])
        furthest = max(furthest, one.position[0])
    assert furthest > 2.001
