"""The H-infinity norm against python-control and closed forms, and the storage function that proves it."""

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.design.errors import SolverFailure
from manyhands.design.models.statespace import StateSpace, frequency_response
from manyhands.design.passivity import hinfinity
from manyhands.design.passivity.hinfinity import bounded_real_storage, hinf_norm


def random_system(seed: int, order: int, outputs: int, inputs: int, radius: float) -> StateSpace:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(order, order))
    if order:
        A *= radius / np.max(np.abs(np.linalg.eigvals(A)))
    return StateSpace(
        A, rng.normal(size=(order, inputs)), rng.normal(size=(outputs, order)), rng.normal(size=(outputs, inputs))
    )


systems = st.builds(
    random_system,
    st.integers(0, 2**32 - 1),
    st.integers(0, 8),
    st.integers(1, 3),
    st.integers(1, 3),
    st.floats(0.3, 0.999),
)


def norm_by_control(system: StateSpace) -> float:
    """The norm by SLICOT where it is installed, else by python-control's bisection after a Cayley transform."""
    A, B, C, D = system.A, system.B, system.C, system.D
    if control.exception.slycot_check():
        return float(control.linfnorm(control.ss(A, B, C, D, True), tol=1e-10)[0])
    inverse = np.linalg.inv(A + np.eye(len(A)))  # z = (1 + s)/(1 - s): its own transform needs poles that are not zero
    continuous = control.ss(
        inverse @ (A - np.eye(len(A))), np.sqrt(2.0) * inverse @ B, np.sqrt(2.0) * C @ inverse, D - C @ inverse @ B
    )
    return float(control.system_norm(continuous, p="inf", tol=1e-7))


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(1, 8), st.integers(1, 3), st.floats(0.3, 0.999))
def test_agrees_with_python_control(seed: int, order: int, ports: int, radius: float) -> None:
    """Square systems: python-control's own bisection takes no others."""
    system = random_system(seed, order, ports, ports, radius)
    assert hinf_norm(system)[0] == pytest.approx(norm_by_control(system), rel=1e-6)


@given(systems)
def test_the_peak_is_at_the_reported_frequency_and_nowhere_higher(system: StateSpace) -> None:
    gamma, frequency = hinf_norm(system, T=0.01)
    at = frequency_response(system, np.array([frequency * 0.01]))[0]
    assert np.linalg.norm(at, 2) == pytest.approx(gamma, rel=1e-9)
    everywhere = frequency_response(system, np.linspace(0.0, np.pi, 5001))
    assert np.max(np.linalg.norm(everywhere, 2, axis=(1, 2))) <= gamma * (1.0 + 1e-7)


@pytest.mark.parametrize("distance", [1e-2, 1e-5, 1e-8])
def test_a_peak_as_narrow_as_its_pole_is_near(distance: float) -> None:
    """1/(z - p) for p at an angle of its own: the peak is 1/(1 - |p|)."""
    c, s = (1.0 - distance) * np.cos(0.7123), (1.0 - distance) * np.sin(0.7123)
    system = StateSpace(np.array([[c, -s], [s, c]]), np.eye(2), np.eye(2), np.zeros((2, 2)))
    gamma, angle = hinf_norm(system)
    assert gamma == pytest.approx(1.0 / distance, rel=1e-7)
    assert angle == pytest.approx(0.7123, abs=distance)


@given(systems)
def test_the_hamiltonian_finds_peaks_between_the_points_of_the_grid(system: StateSpace) -> None:
    expected, _ = hinf_norm(system)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(hinfinity, "frequency_grid", lambda poles: np.array([0.0, 3.0, np.pi]))
        assert hinf_norm(system)[0] == pytest.approx(expected, rel=1e-6)


def test_badly_scaled_states_do_not_matter() -> None:
    system = random_system(3, 6, 2, 2, 0.99)
    scale = 10.0 ** np.array([-6, 4, 0, -3, 7, 2])
    other = StateSpace(system.A * scale[:, None] / scale, system.B * scale[:, None], system.C / scale, system.D)
    assert hinf_norm(other)[0] == pytest.approx(hinf_norm(system)[0], rel=1e-7)
    assert proves(other, 1.001 * hinf_norm(system)[0], bounded_real_storage(other, 1.001 * hinf_norm(system)[0]), scale)


def test_an_unstable_system_has_none() -> None:
    with pytest.raises(ValueError, match="pole of modulus 1"):
        hinf_norm(StateSpace(np.eye(1), np.eye(1), np.eye(1), np.eye(1)))


def proves(system: StateSpace, gamma: float, P: np.ndarray, scale: np.ndarray | None = None) -> bool:
    """The bounded real lemma, in states divided by ``scale``."""
    n = system.order
    X = np.diag(np.concatenate([np.ones(n) if scale is None else scale, np.ones(system.inputs)]))
    left, out = np.hstack([system.A, system.B]), np.hstack([system.C, system.D])
    M = left.T @ P @ left + out.T @ out
    M[:n, :n] -= P
    M[n:, n:] -= gamma**2 * np.eye(system.inputs)
    inner = X[:n, :n] @ P @ X[:n, :n]
    return bool(np.linalg.eigvalsh(X @ M @ X)[-1] < 0.0 and (n == 0 or np.linalg.eigvalsh(inner)[0] > 0.0))


@given(systems, st.sampled_from([1e-4, 1e-2, 1.0]))
def test_a_bound_above_the_norm_is_proved(system: StateSpace, slack: float) -> None:
    gamma = (1.0 + slack) * hinf_norm(system)[0]
    assert proves(system, gamma, bounded_real_storage(system, gamma))


@given(systems)
def test_a_bound_below_the_norm_is_not(system: StateSpace) -> None:
    with pytest.raises(SolverFailure, match="found no storage function"):
        bounded_real_storage(system, 0.999 * hinf_norm(system)[0])


def test_states_that_no_input_reaches_and_no_output_sees() -> None:
    system = random_system(5, 3, 2, 2, 0.9)
    A = np.zeros((5, 5))
    A[:3, :3], A[3, 3], A[4, 4], A[4, 0] = system.A, 0.5, 0.8, 1.0
    padded = StateSpace(A, np.vstack([system.B, np.zeros((2, 2))]), np.hstack([system.C, np.zeros((2, 2))]), system.D)
    gamma = hinf_norm(padded)[0]
    assert gamma == pytest.approx(hinf_norm(system)[0], rel=1e-9)
    assert proves(padded, 1.001 * gamma, bounded_real_storage(padded, 1.001 * gamma))
