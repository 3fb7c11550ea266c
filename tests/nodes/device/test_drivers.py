"""Conformance of every driver, and what surrounds a simulated device."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from manyhands.design.models.device import held_device, zero_order_hold
from manyhands.design.models.statespace import StateSpace
from manyhands.design.passivity.operators import RationalMatrix
from manyhands.launch.conformance.driver import (
    RELEASE,
    SIGN,
    SILENCE,
    STALE,
    SWAPPED,
    UNIT,
    Bench,
    Push,
    check_driver,
)
from manyhands.launch.conformance.judgement import Conformance
from manyhands.launch.conformance.timing import CallTimer
from manyhands.nodes.device.drivers import Driver
from manyhands.nodes.device.specification import DeviceSpecification
from manyhands.nodes.kernel.intent import intent_from
from manyhands.protocol.clock import SimulatedClock
from tests.support.instants import instant
from tests.support.small_drivers import Make, T, both, browser, carried, dragged, simulated, trace, waving

BARE = both(simulated, browser)  # without a hand
DRIVERS = [*BARE, *both(trace, dragged, carried)]


@pytest.fixture(params=DRIVERS, ids=lambda make: make.__name__)
def make(request: pytest.FixtureRequest) -> Make:
    made: Make = request.param
    return made


@pytest.fixture
def driver(make: Make) -> Driver:
    return make()


@pytest.mark.parametrize("make", [simulated, browser], ids=["simulated", "browser"])
def test_in_wall_time_our_own_drivers_pass_the_suite_for_everybodys(make: Callable[..., Driver]) -> None:
    """``manyhands check-driver`` runs it; drivers in their own time ignore the instants that it is about."""
    stated = DeviceSpecification((8.0, 8.0), (1.0, 1.0), (3.0, 3.0), mass=(0.2, 0.2), hardware=False)
    bench = Bench(make(wall=True), T, SimulatedClock(), CallTimer(lambda: 0, lambda: 0))
    found = list(check_driver(bench, stated, Push()))
    assert {judgement.verdict for judgement in found} == {Conformance.KEPT}, found
    assert {RELEASE, SIGN, SILENCE, STALE, SWAPPED, UNIT} <= {judgement.check for judgement in found}


def test_displacements_are_one_finite_entry_an_axis_from_rest(driver: Driver) -> None:
    for tick in range(5):
        x = driver.sample(tick, instant(tick))
        assert len(x) == driver.axes
        assert all(type(at) is float for at in x)
        assert np.all(np.isfinite(x))
        driver.apply(np.ones(driver.axes), instant(tick))
        driver.idle(instant(tick + 1))


def test_a_force_returns_where_the_device_is_at_that_instant(driver: Driver) -> None:
    for tick in range(5):
        x = list(driver.sample(tick, instant(tick)))
        assert list(driver.apply(np.ones(driver.axes), instant(tick))) == x
        assert list(driver.release(instant(tick))) == x
        driver.idle(instant(tick + 1))


def test_samples_are_the_callers_to_keep(make: Make) -> None:
    meddled, other = make(), make()
    for tick in range(3):
        first, same = meddled.sample(tick, instant(tick)), other.sample(tick, instant(tick))
        np.testing.assert_array_equal(first, same)
        assert isinstance(first, list)
        first[0] += 1.0
        for one in (meddled, other):
            one.apply(np.zeros(one.axes), instant(tick))
            one.idle(instant(tick + 1))


@pytest.mark.parametrize("make", BARE, ids=lambda make: make.__name__)
def test_the_force_is_held_and_moves_the_device_along(make: Make) -> None:
    driver = make()
    driver.sample(0, instant(0))
    driver.apply(np.full(driver.axes, 2.0), instant(0))
    driver.idle(instant(1))
    first = np.array(driver.sample(1, instant(1)))
    driver.idle(instant(2))  # no new force: the old one is held
    second = np.array(driver.sample(2, instant(2)))
    assert np.all(first > 0.0)
    assert np.all(second - first > first)


def test_released_it_is_driven_no_more(make: Make) -> None:
    driver, other = make(), make()
    for tick, force in enumerate((2.0, 2.0, 0.0, 0.0, 0.0)):
        np.testing.assert_array_equal(driver.sample(tick, instant(tick)), other.sample(tick, instant(tick)))
        assert driver.intended_work() == other.intended_work()
        driver.apply(np.full(driver.axes, 2.0), instant(tick))
        if force == 0.0:
            driver.release(instant(tick))
        driver.idle(instant(tick + 1))
        other.apply(np.full(driver.axes, force), instant(tick))
        other.idle(instant(tick + 1))


@pytest.mark.parametrize("make", both(waving, carried, trace, dragged), ids=lambda make: make.__name__)
def test_idle_is_a_favour_not_a_duty(make: Make) -> None:
    lazy, eager = make(), make()
    for tick in range(50):
        np.testing.assert_array_equal(lazy.sample(tick, instant(tick)), eager.sample(tick, instant(tick)))
        assert lazy.intended_work() == eager.intended_work()
        for one in (lazy, eager):
            one.apply(np.array([0.1 * tick, -1.0]), instant(tick))
        eager.idle(instant(tick + 1))
        eager.idle(instant(tick + 1))
    assert any(lazy.sample(50, instant(50)))


def test_its_report_is_named_and_finite_and_closing_is_repeatable(driver: Driver) -> None:
    driver.sample(0, instant(0))
    driver.idle(instant(1))
    assert all(type(name) is str and np.isfinite(value) for name, value in driver.figures().items())
    driver.close()
    driver.close()


def test_before_the_first_tick_nothing_has_been_intended(driver: Driver) -> None:
    driver.sample(0, instant(0))
    assert driver.intended_work() == 0.0


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
        driver.sample(tick, instant(tick))
        total += driver.intended_work()
        driver.apply(np.array([0.3]), instant(tick))
        driver.idle(instant(tick + 1))
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
