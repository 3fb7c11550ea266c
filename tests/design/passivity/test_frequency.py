"""The least supply over frequency: against brute force, and between the points of a grid."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import block_diag

from manyhands.design.models.statespace import (
    StateSpace,
    axis_image,
    cayley,
    crossing_angles,
    frequency_of,
    gaps,
    in_discrete_time,
    natural_rate,
    storage_inequality,
)
from manyhands.design.passivity.frequency import (
    input_rows,
    least_hermitian_eigenvalue,
    least_ratio,
    pairs_at,
    supply_form,
)

seeds = st.integers(0, 2**32 - 1)


def stable(seed: int, n: int, m: int, time: str = "discrete") -> StateSpace:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    poles = np.linalg.eigvals(A)
    if time == "discrete":
        A = A * (rng.uniform(0.2, 0.98) / max(np.abs(poles).max(initial=0.0), 1e-12))
    else:
        A = A - (poles.real.max(initial=0.0) + rng.uniform(0.05, 1.0)) * np.eye(n)
    return StateSpace(A, rng.normal(size=(n, m)), rng.normal(size=(m, n)), rng.normal(size=(m, m)))


def hermitian(system: StateSpace, point: complex) -> float:
    response = system.response(point)
    return float(np.linalg.eigvalsh((response + response.conj().T) / 2.0)[0])


@given(seeds, st.integers(0, 5), st.integers(1, 3))
def test_the_least_eigenvalue_is_below_a_dense_grid_and_taken(seed: int, n: int, m: int) -> None:
    system = stable(seed, n, m)
    value, angle = least_hermitian_eigenvalue(system)
    grid = min(hermitian(system, np.exp(1j * w)) for w in np.linspace(0.0, np.pi, 300))
    scale = max(1.0, abs(value))
    assert value <= grid + 1e-9 * scale
    assert value == pytest.approx(hermitian(system, np.exp(1j * angle)), abs=1e-9 * scale)


@given(seeds, st.integers(1, 4), st.integers(1, 2))
@settings(max_examples=50)
def test_continuous_time_too(seed: int, n: int, m: int) -> None:
    system = stable(seed, n, m, "continuous")
    value, frequency = least_hermitian_eigenvalue(system, "continuous")
    scale = max(1.0, abs(value))
    grid = min(hermitian(system, 1j * w) for w in [0.0, *np.logspace(-3, 4, 400)])
    assert value <= grid + 1e-9 * scale
    if np.isfinite(frequency) and frequency < 1e6:
        assert value == pytest.approx(hermitian(system, 1j * frequency), abs=1e-8 * scale)
    else:
        assert value == pytest.approx(np.linalg.eigvalsh((system.D + system.D.T) / 2.0)[0], abs=1e-5 * scale)


def test_example_1s_operator(problems) -> None:
    value, frequency = least_hermitian_eigenvalue(problems.operator(0.1).realisation(), "continuous")
    assert value == pytest.approx(-0.090, abs=5e-4)
    assert frequency == pytest.approx(20.9, abs=0.05)
    assert least_hermitian_eigenvalue(problems.operator(0.01).realisation(), "continuous")[0] == pytest.approx(
        4.6e-5, abs=5e-7
    )


@pytest.mark.parametrize("ratio", [1e-3, 1e-6, 1e-8])
def test_a_resonance_that_falls_between_all_grids(ratio: float) -> None:
    """1 - 2 (2 zeta w s)/(s^2 + 2 zeta w s + w^2) is -1 at w alone."""
    w = 37.123
    width = 2.0 * ratio * w
    A, B, C = np.array([[0.0, 1.0], [-(w**2), -width]]), np.array([[0.0], [1.0]]), np.array([[0.0, -2.0 * width]])
    value, frequency = least_hermitian_eigenvalue(StateSpace(A, B, C, np.eye(1)), "continuous")
    assert value == pytest.approx(-1.0, abs=1e-6)
    assert frequency == pytest.approx(w, rel=1e-6)


def test_an_integrator_has_minus_half_a_period() -> None:
    """Re(T/(z-1)) = -T/2 on the whole circle, z = 1 excepted, where it has no value."""
    system = StateSpace(np.eye(1), np.eye(1), np.array([[3.0]]), np.zeros((1, 1)))
    least = least_ratio(system, supply_form(system), input_rows(system))
    assert least.value == pytest.approx(-1.5, abs=1e-7)


@given(seeds, st.integers(1, 5), st.integers(1, 3), st.floats(0.05, np.pi - 0.05))
def test_a_pair_does_not_see_the_storage(seed: int, n: int, m: int, angle: float) -> None:
    system = stable(seed, n, m)
    rng = np.random.default_rng(seed)
    P, Delta, Phi = (X + X.T for X in (rng.normal(size=(k, k)) for k in (n, m, m)))
    X = pairs_at(system, np.exp(1j * angle))
    assert X.shape[1] == m
    M, Q = storage_inequality(system, P, Delta, Phi), supply_form(system, Delta, Phi)
    np.testing.assert_allclose(X.conj().T @ M @ X, -X.conj().T @ Q @ X, atol=1e-10 * (1 + np.abs(M).max()))


def test_a_missing_comparison_is_reported() -> None:
    system = StateSpace.static([[1.0]])
    with pytest.raises(ValueError, match="every pair is silent"):
        least_ratio(system, supply_form(system), np.zeros((1, 1)))


@given(seeds, st.integers(1, 4), st.integers(1, 3), st.floats(0.1, 10.0))
def test_the_cayley_transform_keeps_response_and_storage(seed: int, n: int, m: int, factor: float) -> None:
    """At s = a (z-1)/(z+1) the responses agree, and N(P) and M(P) have one signature: a congruence."""
    system = stable(seed, n, m, "continuous")
    rate = factor * natural_rate(system)
    discrete = cayley(system, rate)
    z = np.exp(1j * 1.1)
    np.testing.assert_allclose(
        discrete.response(z), system.response(rate * (z - 1.0) / (z + 1.0)), rtol=1e-8, atol=1e-8
    )
    assert frequency_of(1.1, "continuous", rate) == pytest.approx((rate * (z - 1.0) / (z + 1.0)).imag)
    rng = np.random.default_rng(seed)
    P = rng.normal(size=(n, n))
    P = P + P.T
    A, B, C, D = system.A, system.B, system.C, system.D
    N = np.block([[A.T @ P + P @ A, P @ B - C.T / 2.0], [B.T @ P - C / 2.0, -(D + D.T) / 2.0]])
    R = np.linalg.inv(rate * np.eye(n) - A)
    W = np.block([[np.sqrt(2.0 * rate) * R, R @ B], [np.zeros((m, n)), np.eye(m)]])
    M = storage_inequality(discrete, P)
    np.testing.assert_allclose(M, W.T @ N @ W, atol=1e-9 * (1.0 + np.abs(M).max()))


@given(seeds, st.integers(0, 4), st.integers(1, 3), st.floats(0.05, np.pi - 0.05))
def test_the_image_on_the_axis_has_the_response_of_the_circle(seed: int, n: int, m: int, angle: float) -> None:
    """At s = j tan(angle/2) the image responds as the system does at z = e^(j angle); cayley takes it back."""
    system = stable(seed, n, m)
    image, z = axis_image(system), np.exp(1j * angle)
    np.testing.assert_allclose(image.response((z - 1.0) / (z + 1.0)), system.response(z), rtol=1e-8, atol=1e-8)
    back = cayley(image, 1.0)
    for name in ("A", "B", "C", "D"):
        np.testing.assert_allclose(getattr(back, name), getattr(system, name), rtol=1e-8, atol=1e-8)


def test_imaginary_eigenvalues_are_crossings_and_others_are_none() -> None:
    rotation = np.array([[0.0, np.tan(0.4)], [-np.tan(0.4), 0.0]])
    decay = np.diag([0.3, -0.3])
    nearly = np.array([[1e-4, 1.0], [-1.0, 1e-4]])
    joined = block_diag(rotation, decay, nearly)
    assert crossing_angles(joined, 1e-9) == pytest.approx([0.8])
    assert crossing_angles(joined, 1e-3) == pytest.approx([0.8, np.pi / 2.0])
    assert crossing_angles(joined, 0.0, 0.31) == pytest.approx([0.0, 0.8, np.pi / 2.0])


def test_crossings_leave_gaps_with_one_middle_each() -> None:
    ends, middles = gaps([2.0, 1.0, 1.0, np.pi])
    np.testing.assert_array_equal(ends, [0.0, 1.0, 2.0, np.pi])
    np.testing.assert_array_equal(middles, [0.5, 1.5, (2.0 + np.pi) / 2.0])
    ends, middles = gaps([])
    np.testing.assert_array_equal(ends, [0.0, np.pi])
    np.testing.assert_array_equal(middles, [np.pi / 2.0])


def test_a_rate_must_suit_the_system() -> None:
    system = StateSpace([[2.0]], [[1.0]], [[1.0]], [[0.0]])
    with pytest.raises(ValueError, match="no eigenvalue of A"):
        cayley(system, 2.0)
    with pytest.raises(ValueError, match="positive rate"):
        cayley(system, 0.0)
    found, rate = in_discrete_time(system, "continuous")  # its own natural rate is the eigenvalue
    assert rate != pytest.approx(2.0)
    assert np.all(np.isfinite(found.A))
    assert in_discrete_time(system, "discrete") == (system, 1.0)
    assert natural_rate(StateSpace.static([[1.0]])) == 1.0
