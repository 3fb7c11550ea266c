"""Lemma 1 and its facial reduction."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.design.models.coupling import SpringDamper, transformed_coupling
from manyhands.design.models.statespace import StateSpace, cayley, storage_inequality
from manyhands.design.passivity.frequency import pairs_at
from manyhands.design.passivity.storage import StorageFace, kernel, storage_face_of


def neutral_pairs(system: StateSpace, at: str) -> np.ndarray:
    """An orthonormal basis, (n+m) x d, of the static neutral pairs that are silent ``at`` "input" or "output"."""
    n, m = system.order, system.inputs
    steady = np.hstack([system.A - np.eye(n), system.B])
    silent = np.hstack([np.zeros((m, n)), np.eye(m)]) if at == "input" else np.hstack([system.C, system.D])
    return kernel(np.vstack([steady, silent]))


def storage_face(system: StateSpace, at: str) -> StorageFace | None:
    """The face that the static neutral pairs leave, z = 1."""
    pairs = [(1.0 + 0.0j, pair.astype(complex)) for pair in neutral_pairs(system, at).T]
    return storage_face_of(system, storage_inequality(system, np.zeros((system.order, system.order))), pairs)


def equality_residual(system: StateSpace, P: np.ndarray, at: str) -> float:
    """The residual of [A - I, B]^T P psi = c, relative to its larger side; c by hand for each kind of pair."""
    n, pairs = system.order, neutral_pairs(system, at)
    psi, w = pairs[:n], pairs[n:]
    at_input = np.vstack([np.zeros_like(psi), system.C @ psi / 2.0])
    right = at_input if at == "input" else np.vstack([system.C.T @ w / 2.0, system.D.T @ w / 2.0])
    left = np.hstack([system.A - np.eye(n), system.B]).T @ P @ psi
    scale = max(np.abs(P).max(initial=0.0), np.abs(right).max(initial=0.0), 1e-300)
    return float(np.abs(left - right).max(initial=0.0)) / scale


def quadratic_form(system: StateSpace, P, Delta, Phi, psi, u) -> float:
    """V(psi+) - V(psi) - y^T u + y^T Delta y + u^T Phi u, Definition 2, term by term."""
    after, y = system.A @ psi + system.B @ u, system.C @ psi + system.D @ u
    return after @ P @ after - psi @ P @ psi - y @ u + y @ Delta @ y + u @ Phi @ u


@given(st.integers(0, 2**32 - 1), st.integers(0, 4), st.integers(1, 3))
def test_the_inequality_is_definition_2(seed: int, n: int, m: int) -> None:
    rng = np.random.default_rng(seed)
    system = StateSpace(*(rng.normal(size=shape) for shape in ((n, n), (n, m), (m, n), (m, m))))
    P, Delta, Phi = (X + X.T for X in (rng.normal(size=(k, k)) for k in (n, m, m)))
    M = storage_inequality(system, P, Delta, Phi)
    psi, u = rng.normal(size=n), rng.normal(size=m)
    both = np.concatenate([psi, u])
    expected = quadratic_form(system, P, Delta, Phi, psi, u)
    assert both @ M @ both == pytest.approx(expected, rel=1e-9, abs=1e-9 * (1 + np.abs(M).max() * (both @ both)))
    zero = np.zeros((m, m))
    np.testing.assert_array_equal(storage_inequality(system, P), storage_inequality(system, P, zero, zero))


@given(st.data())
def test_the_face_of_a_network_holds_its_physical_storage(problems, data: st.DataObject) -> None:
    E_hat = data.draw(problems.networks()).transformed_environment(1e-3)
    face = storage_face(E_hat, "input")
    assert face is not None
    n = E_hat.order
    difference = np.eye(n) - face.P_0
    N = face.directions.reshape(len(face.directions), n * n)
    left_over = difference.ravel() - N.T @ np.linalg.lstsq(N.T, difference.ravel(), rcond=None)[0] if n else np.zeros(0)
    assert np.abs(left_over).max(initial=0.0) < 1e-7


@given(st.data(), st.integers(0, 2**32 - 1))
def test_every_point_of_a_face_is_on_it(problems, data: st.DataObject, seed: int) -> None:
    loop = data.draw(problems.loops())
    V_hat = transformed_coupling(data.draw(problems.couplings(loop)).realisation(loop.period), loop.K, loop.period)
    for system, at in ((loop.environment.transformed_environment(loop.period), "input"), (V_hat, "output")):
        face = storage_face(system, at)
        assert face is not None
        p = np.random.default_rng(seed).normal(size=len(face.directions))
        P = face.P_0 + np.tensordot(p, face.directions, axes=1)
        assert equality_residual(system, P, at) < 1e-9
        pairs = neutral_pairs(system, at)
        # what the face is for: a neutral pair is in the kernel of M(P), with its rows and not only its value
        scale = max(1.0, np.abs(P).max(initial=0.0))
        assert np.abs(storage_inequality(system, P) @ pairs).max(initial=0.0) < 1e-9 * scale
        assert face.complement.shape[1] + pairs.shape[1] == system.order + system.inputs
        np.testing.assert_allclose(face.complement.T @ pairs, 0.0, atol=1e-12)


def test_off_the_face_the_residual_shows_it(problems) -> None:
    E_hat = problems.network.transformed_environment(problems.T)
    assert equality_residual(E_hat, np.eye(5), "input") < 1e-12
    assert equality_residual(E_hat, np.eye(5) + 1e-3 * np.ones((5, 5)), "input") > 1e-6


def test_example_1_has_an_integrator_a_port(problems) -> None:
    assert neutral_pairs(problems.network.transformed_environment(problems.T), "input").shape == (8, 3)
    V_hat = transformed_coupling(problems.C26.realisation(1e-3), problems.example_1().K, 1e-3)
    assert neutral_pairs(V_hat, "output").shape == (9, 3)


def test_neutral_pairs_are_steady_and_silent(problems) -> None:
    E_hat = problems.network.transformed_environment(problems.T)
    pairs = neutral_pairs(E_hat, "input")
    np.testing.assert_allclose(E_hat.A @ pairs[:5], pairs[:5], atol=1e-12)
    np.testing.assert_allclose(pairs[5:], 0.0, atol=1e-12)


def test_an_unsymmetric_static_compliance_has_no_face(problems) -> None:
    K, B, T = np.array([[700.0, 200.0], [200.0, 900.0]]), np.diag([0.1, 0.4]), problems.T
    V = SpringDamper(K, B).realisation(T)
    skewed = StateSpace(V.C @ B, T * V.C @ B, V.C, V.D)
    K_loop = T / 2.0 / 1.37 * np.eye(2)
    assert storage_face(transformed_coupling(skewed, K_loop, T), "output") is None
    assert storage_face(transformed_coupling(V, K_loop, T), "output") is not None


def test_an_unsymmetric_static_stiffness_has_no_face() -> None:
    """f = [[2, 1], [0, 2]] x makes energy out of going round in circles."""
    T, k = 1e-3, np.array([[2.0, 1.0], [0.0, 2.0]])
    E_hat = StateSpace(np.eye(2), T * np.eye(2), k, T * k)
    assert storage_face(E_hat, "input") is None


def test_a_system_without_neutral_pairs_is_not_reduced() -> None:
    system = StateSpace(np.array([[0.5]]), np.array([[1.0]]), np.array([[0.2]]), np.array([[1.0]]))
    face = storage_face(system, "input")
    assert face is not None
    assert face.directions.shape == (1, 1, 1)
    np.testing.assert_allclose(face.complement.T @ face.complement, np.eye(2), atol=1e-15)


@given(st.integers(0, 2**32 - 1), st.integers(1, 4), st.integers(1, 2), st.integers(1, 3))
def test_a_face_keeps_complex_pairs_neutral(seed: int, n: int, m: int, points: int) -> None:
    """A lossless system, A skew and C = B^T, is neutral at every z: M(P) x = 0 on the whole face, which has P = I/2."""
    rng = np.random.default_rng(seed)
    A, D = (X - X.T for X in (rng.normal(size=(n, n)), rng.normal(size=(m, m))))
    B = rng.normal(size=(n, m))
    system = cayley(StateSpace(A, B, B.T, D), 1.7)
    pairs = [(complex(z), x) for z in np.exp(1j * rng.uniform(0.1, 3.0, points)) for x in pairs_at(system, z).T]
    face = storage_face_of(system, storage_inequality(system, np.zeros((n, n))), pairs)
    assert face is not None
    p = rng.normal(size=len(face.directions))
    M = storage_inequality(system, face.P_0 + np.tensordot(p, face.directions, axes=1))
    stacked = np.stack([x for _, x in pairs], axis=1)
    assert np.abs(M @ stacked).max() < 1e-7 * max(1.0, np.abs(M).max())
    np.testing.assert_allclose(face.complement.T @ stacked, 0.0, atol=1e-8)
    N = face.directions.reshape(len(face.directions), n * n)
    difference = (np.eye(n) / 2.0 - face.P_0).ravel()
    left_over = difference - N.T @ np.linalg.lstsq(N.T, difference, rcond=None)[0] if len(N) else difference
    assert np.abs(left_over).max() < 1e-7


def test_without_pairs_a_face_is_everything() -> None:
    system = StateSpace(0.5 * np.eye(2), np.ones((2, 1)), np.ones((1, 2)), np.ones((1, 1)))
    face = storage_face_of(system, storage_inequality(system, np.zeros((2, 2))), [])
    assert face is not None
    assert face.directions.shape == (3, 2, 2)
    np.testing.assert_array_equal(face.complement, np.eye(3))


def test_the_kernel_of_rounding_is_everything() -> None:
    np.testing.assert_allclose(kernel(np.full((2, 2), 1e-17)) @ kernel(np.full((2, 2), 1e-17)).T, np.eye(2), atol=1e-15)
    assert kernel(np.zeros((0, 3))).shape == (3, 3)
    assert kernel(np.diag([1.0, 1e-6])).shape == (2, 0)
