"""The gain from peak to peak, against the sum it stands for and against the input that reaches it."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from manyhands.design import peak_gain as module
from manyhands.design.models.coupling import SpringDamper
from manyhands.design.models.statespace import StateSpace
from manyhands.design.peak_gain import output_bounds, peak_gain


def impulse_response(system: StateSpace, ticks: int) -> np.ndarray:
    """h(0), h(1), ..., ticks x outputs x inputs, one product at a time."""
    out, state = [np.array(system.D)], np.array(system.B)
    for _ in range(ticks - 1):
        out.append(system.C @ state)
        state = system.A @ state
    return np.array(out)


def scaled(rng: np.random.Generator, n: int, p: int, m: int, radius: float) -> StateSpace:
    A = rng.normal(size=(n, n))
    A *= radius / np.max(np.abs(np.linalg.eigvals(A)))
    return StateSpace(A, rng.normal(size=(n, p)), rng.normal(size=(m, n)), rng.normal(size=(m, p)))


@given(
    seed=st.integers(0, 2**16),
    n=st.integers(1, 5),
    p=st.integers(1, 3),
    m=st.integers(1, 3),
    radius=st.sampled_from([0.0, 0.3, 0.9, 0.98]),
)
def test_the_gain_is_the_sum_of_the_impulse_response(seed: int, n: int, p: int, m: int, radius: float) -> None:
    system = scaled(np.random.default_rng(seed), n, p, m, radius)
    expected = np.abs(impulse_response(system, 3000)).sum(axis=0)  # 0.98^3000 is below 1e-26
    np.testing.assert_allclose(peak_gain(system), expected, rtol=1e-11, atol=2e-12 * float(np.max(expected)))


@given(seed=st.integers(0, 2**16), n=st.integers(1, 4), m=st.integers(1, 3), radius=st.sampled_from([0.2, 0.9]))
def test_no_bounded_input_goes_beyond_and_the_worst_one_gets_there(seed: int, n: int, m: int, radius: float) -> None:
    rng = np.random.default_rng(seed)
    system, amplitude, ticks = scaled(rng, n, m, m, radius), rng.uniform(0.1, 3.0, m), 400
    magnitude, step = output_bounds(system, amplitude)
    responses = {0: impulse_response(system, ticks)}
    responses[1] = np.diff(responses[0], axis=0, prepend=np.zeros((1, m, m)))
    for i in range(m):
        for order, bound in ((0, magnitude), (1, step)):
            worst = amplitude * np.sign(responses[order][::-1, i, :])
            y = system.simulate(worst)
            reached = y[-1, i] if order == 0 else y[-1, i] - y[-2, i]
            assert reached == pytest.approx(bound[i], rel=1e-9)
    y = system.simulate(amplitude * rng.choice([-1.0, 1.0], (ticks, m)))
    assert np.all(np.abs(y) <= magnitude * (1.0 + 1e-12))
    assert np.all(np.abs(np.diff(y, axis=0)) <= step * (1.0 + 1e-12))


@pytest.mark.parametrize("pole", [0.5, -0.999, 0.99999, -0.999999])
def test_a_slow_pole_is_bounded_in_closed_form(pole: float) -> None:
    system = StateSpace([[pole]], [[2.0]], [[1.0]], [[0.25]])
    assert peak_gain(system)[0, 0] == pytest.approx(0.25 + 2.0 / (1.0 - abs(pole)), rel=1e-8)


def test_when_work_ends_early_the_tail_is_still_a_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    system = scaled(np.random.default_rng(5), 3, 2, 2, 0.999)
    exact = peak_gain(system)
    monkeypatch.setattr(module, "_LONGEST_STRIDE", 64)
    for strides in (30, 60, 200):
        monkeypatch.setattr(module, "_MOST_STRIDES", strides)
        early = peak_gain(system)
        assert np.all(early >= exact * (1.0 - 1e-12))
        assert np.all(np.isfinite(early))
    monkeypatch.setattr(module, "_MOST_STRIDES", 1)
    assert np.all(np.isinf(peak_gain(system)))  # nothing is known of A^64 yet


@pytest.mark.parametrize("pole", [1.0, -1.0, 1.5, -2.0])
def test_what_is_not_stable_has_no_bound(pole: float) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        system = StateSpace(np.diag([0.5, pole]), np.eye(2), np.eye(2), np.zeros((2, 2)))
        assert np.all(np.isinf(peak_gain(system)))
        magnitude, step = output_bounds(system, np.ones(2))
    assert np.all(np.isinf(magnitude))
    assert np.all(np.isinf(step))


def test_without_states_the_gain_is_that_of_the_feedthrough() -> None:
    D = np.array([[1.0, -2.0], [0.0, 3.0]])
    np.testing.assert_array_equal(peak_gain(StateSpace.static(D)), np.abs(D))
    magnitude, step = output_bounds(StateSpace.static(D), np.array([1.0, 0.5]))
    np.testing.assert_allclose(magnitude, [2.0, 1.5])
    np.testing.assert_allclose(step, [4.0, 3.0])


def test_an_input_that_is_always_zero_adds_nothing() -> None:
    system = StateSpace(np.diag([0.5, 1.0]), np.eye(2), np.eye(2), np.zeros((2, 2)))
    magnitude, _ = output_bounds(system, np.zeros(2))
    np.testing.assert_array_equal(magnitude, [0.0, 0.0])


@given(stiffness=st.floats(10.0, 5000.0), damping=st.floats(1e-3, 5.0))
def test_a_spring_damper_moves_its_tool_as_far_as_its_spring(stiffness: float, damping: float) -> None:
    """V = (K + B (1 - z^-1)/T)^-1: of |f| <= F, the part with memory is what V's static gain leaves beside D_V."""
    T = 1e-3
    block = SpringDamper(np.array([[stiffness]]), np.array([[damping]])).realisation(T)
    assume(float(block.A[0, 0]) < 0.9999)
    dynamic = StateSpace(block.A, block.B, block.C, np.zeros((1, 1)))
    magnitude, _ = output_bounds(dynamic, np.array([2.0]))
    assert magnitude[0] == pytest.approx(2.0 * (1.0 / stiffness - block.D[0, 0]), rel=1e-9)
