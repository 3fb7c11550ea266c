"""The driver of a recorded motion replays it exactly, and its ledger is that of a hand that does not yield."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.design.levels.device import device_share, least_gain
from manyhands.nodes.device.core import DeviceCore
from manyhands.nodes.device.drivers import TraceDriver
from manyhands.nodes.kernel.bundle import RecordedMotion
from tests.support.instants import instant

T = 1e-3
DELTA = np.array([[1.37, 0.4], [0.4, 0.9]])
ROUNDING = 1e-12  # of the energy that passed: some 2^-53 for each of a few thousand additions

forces = st.lists(st.tuples(*[st.floats(-50.0, 50.0)] * 2), min_size=1, max_size=40)
positions = st.lists(st.tuples(*[st.floats(-0.1, 0.1)] * 2), min_size=1, max_size=40)


def driver_of(x: list[tuple[float, float]], period: float = T) -> TraceDriver:
    times = tuple(k * period for k in range(len(x)))
    return TraceDriver(RecordedMotion(DELTA, times, tuple(zip(*x, strict=True))), T)


def passed_through(
    driver: TraceDriver, force: list[tuple[float, float]], level: np.ndarray, K: np.ndarray, works: bool = True
) -> tuple[DeviceCore, float]:
    """The device's core after these forces, and the energy that passed, to judge rounding by."""
    core, passed, before = DeviceCore(level, K, T), 1e-12, np.zeros(2)
    for tick, f in enumerate(force):
        x = driver.sample(tick, instant(tick))
        core.sample(x)
        driver.apply(f, instant(tick))
        driver.idle(instant(tick + 1))
        core.apply(list(f), driver.intended_work() if works else 0.0)
        moved, before = np.array(x) - before, np.array(x)
        passed += abs(np.array(f) @ moved) + 2.0 * moved @ DELTA @ moved / T + float(np.array(f) @ K @ np.array(f))
    return core, passed


@given(forces, positions)
def test_it_is_where_it_was_whatever_force_acts(force: list[tuple[float, float]], x: list[tuple[float, float]]) -> None:
    driver = driver_of(x)
    for tick, f in enumerate(force):
        np.testing.assert_array_equal(driver.sample(tick, instant(tick)), x[min(tick, len(x) - 1)])
        assert driver.apply(f, instant(tick)) == driver.release(instant(tick)) == list(x[min(tick, len(x) - 1)])
        driver.apply(f, instant(tick))


def test_between_its_samples_it_is_linear_and_afterwards_it_stays() -> None:
    driver = driver_of([(0.0, 0.0), (0.01, -0.02)], period=4 * T)
    found = []
    for tick in range(7):
        found.append(driver.sample(tick, instant(tick)))
        driver.idle(instant(tick + 1))
    expected = [[0.01 * share, -0.02 * share] for share in (0.0, 0.25, 0.5, 0.75, 1.0, 1.0, 1.0)]
    np.testing.assert_allclose(found, expected, rtol=1e-15, atol=1e-18)


@given(forces, positions)
def test_without_delay_its_ledger_equals_a_resting_devices_in_its_frame(
    force: list[tuple[float, float]], x: list[tuple[float, float]]
) -> None:
    K = T / 2.0 * np.linalg.inv(DELTA)
    core, passed = passed_through(driver_of(x), force, DELTA, K)
    last = np.array(force[-1])
    assert abs(core.ledger.total - last @ K @ last / 2.0) <= ROUNDING * passed
    assert core.ledger.minimum >= -ROUNDING * passed


@given(forces, positions, st.floats(0.0, 1.0), st.floats(1.001, 3.0))
def test_its_ledger_is_never_below_zero_at_any_rung(
    force: list[tuple[float, float]], x: list[tuple[float, float]], tau_hat: float, more: float
) -> None:
    kappa = more * least_gain(tau_hat)
    share = device_share(kappa, tau_hat).share if tau_hat > 0.0 else 1.0 / (2.0 * kappa)
    core, passed = passed_through(driver_of(x), force, share * DELTA, kappa * T * np.linalg.inv(DELTA))
    assert core.ledger.minimum >= -ROUNDING * passed


def test_without_the_work_of_the_hand_the_promise_would_look_broken() -> None:
    """What the checks above are able to see."""
    x, force = [(0.01 * k * T, 0.0) for k in range(100)], [(-1.0, 0.5)] * 100
    K = T / 2.0 * np.linalg.inv(DELTA)
    core, _ = passed_through(driver_of(x), force, DELTA, K, works=False)
    assert core.ledger.minimum < -1e-4
    careless = driver_of(x)
    careless._friction = lambda moved: [0.0] * len(moved)
    core, _ = passed_through(careless, [(0.0, 0.0)] * 100, DELTA, K)
    assert core.ledger.minimum < -1e-6


def test_the_hand_s_work_is_force_and_friction_along_the_way() -> None:
    driver = driver_of([(0.0, 0.0), (0.002, 0.001)])
    driver.sample(0, instant(0))
    driver.apply([3.0, -1.0], instant(0))
    driver.sample(1, instant(1))
    moved = np.array([0.002, 0.001])
    assert driver.intended_work() == pytest.approx(moved @ DELTA @ moved / T - 3.0 * 0.002 + 0.001, rel=1e-14)


@pytest.mark.parametrize(
    ("times", "values", "found"),
    [
        ((0.0, 1.0), ((0.0,), (0.0, 1.0)), "without 2 samples"),
        ((0.0,), ((0.0,),), "axes in a device's source"),
        ((0.1,), ((0.0,), (0.0,)), "the first time is 0.1 s"),
        ((0.0, 0.0), ((0.0, 0.0), (0.0, 0.0)), "increasing times"),
        ((0.0, 1.0), ((0.0, float("nan")), (0.0, 0.0)), "not finite"),
    ],
)
def test_what_is_no_motion_is_refused(
    times: tuple[float, ...], values: tuple[tuple[float, ...], ...], found: str
) -> None:
    with pytest.raises(ValueError, match=found):
        TraceDriver(RecordedMotion(DELTA, times, values), T)
