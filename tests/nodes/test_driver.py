"""What every driver must do, and what the simulated one does besides."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from manyhands.design.device import held_device, zero_order_hold
from manyhands.design.operators import RationalMatrix
from manyhands.design.statespace import StateSpace
from manyhands.nodes.device.driver import Driver
from manyhands.nodes.device.intent import intent_from
from manyhands.nodes.device.simulated import SimulatedDriver

T = 1e-3


def simulated(force: str = "0", motion: str = "0", axes: int = 2, stiffness: float = 0.0) -> SimulatedDriver:
    entry = ((0.02, 1.2, 20.0), (1.0, 10.3, 100.0))
    none = ((0.0,), (1.0,))
    operator = RationalMatrix(tuple(tuple(entry if i == j else none for j in range(axes)) for i in range(axes)))
    plant = held_device([0.2] * axes, [1.37] * axes, operator.realisation(), [0.5] * axes, [stiffness] * axes)
    return SimulatedDriver(plant, [intent_from(force)] * axes, [intent_from(motion)] * axes, T)


DRIVERS: list[Callable[[], Driver]] = [simulated]


@pytest.fixture(params=DRIVERS, ids=lambda make: make.__name__)
def driver(request: pytest.FixtureRequest) -> Driver:
    made: Driver = request.param()
    return made


def test_displacements_are_one_finite_entry_an_axis_from_rest(driver: Driver) -> None:
    for tick in range(5):
        x = driver.sample(tick)
        assert len(x) == driver.axes
        assert all(type(at) is float for at in x)
        assert np.all(np.isfinite(x))
        driver.apply(np.ones(driver.axes))
        driver.idle()


def test_samples_are_the_callers_to_keep(driver: Driver) -> None:
    first = driver.sample(0)
    kept = list(first)
    first[0] += 1.0
    driver.apply(np.zeros(driver.axes))
    driver.idle()
    np.testing.assert_array_equal(driver.sample(1), kept)


def test_the_force_is_held_and_moves_the_device_along(driver: Driver) -> None:
    driver.sample(0)
    driver.apply(np.full(driver.axes, 2.0))
    driver.idle()
    first = np.array(driver.sample(1))
    driver.idle()  # no new force: the old one is held
    second = np.array(driver.sample(2))
    assert np.all(first > 0.0)
    assert np.all(second - first > first)


def test_released_it_is_driven_no_more(driver: Driver) -> None:
    other = simulated()
    for tick, force in enumerate((2.0, 2.0, 0.0, 0.0)):
        np.testing.assert_array_equal(driver.sample(tick), other.sample(tick))
        driver.apply(np.full(driver.axes, 2.0))
        if force == 0.0:
            driver.release()
        driver.idle()
        other.apply(np.full(driver.axes, force))
        other.idle()


def test_idle_is_a_favour_not_a_duty() -> None:
    lazy, eager = simulated("sin(9*t)"), simulated("sin(9*t)")
    for tick in range(50):
        np.testing.assert_array_equal(lazy.sample(tick), eager.sample(tick))
        assert lazy.intended_work() == eager.intended_work()
        for one in (lazy, eager):
            one.apply(np.array([0.1 * tick, -1.0]))
        eager.idle()


def test_the_intention_s_work_is_the_integral_of_its_power() -> None:
    """Against the same device integrated in 400 steps a tick, with f_int and v_m held over the tick as documented."""
    force, motion, steps = "1.5*sin(40*t)", "0.01*sin(30*t)", 400
    driver = simulated(force, motion, axes=1, stiffness=200.0)
    plant = held_device(
        [0.2], [1.37], RationalMatrix(((((0.02, 1.2, 20.0), (1.0, 10.3, 100.0)),),)).realisation(), [0.5], [200.0]
    )
    fine: StateSpace = zero_order_hold(plant.continuous(), T / steps)
    state = np.zeros(fine.order)
    total = expected = 0.0
    push, goal = intent_from(force), intent_from(motion)
    for tick in range(60):
        driver.sample(tick)
        total += driver.intended_work()
        driver.apply(np.array([0.3]))
        driver.idle()
        t = tick * T
        f_int, v_m = push(t), (goal(t + T) - goal(t)) / T
        if tick < 59:
            for _ in range(steps):
                v = state[1]
                before = state
                state = fine.A @ state + fine.B @ np.array([0.3 + f_int, v_m])
                middle = (before + state) / 2.0  # trapezoidal, so exact to the second order in T / steps
                w = middle[1] - v_m
                hand = plant.operator.C @ middle[2:4] + plant.operator.D[0] * w + 0.5 * w + 200.0 * middle[4]
                expected += (f_int * (v + state[1]) / 2.0 - v_m * float(hand[0])) * T / steps
    assert abs(expected) > 1e-4
    # the trapezoidal rule's error is of the order (omega T / steps)^2, 1e-8 for the fastest mode here
    assert total == pytest.approx(expected, rel=1e-6)
