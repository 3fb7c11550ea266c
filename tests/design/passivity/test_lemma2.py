"""Lemma 2: the same as Lemma 1, written so that B, D and the inverse level are linear."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.design.models.statespace import StateSpace, storage_inequality
from manyhands.design.passivity.lemma1 import analyse
from manyhands.design.passivity.lemma2 import lemma2_expression, lemma2_matrix, schur_matrix, storage_by_lemma2

seeds = st.integers(0, 2**32 - 1)


def definite(rng: np.random.Generator, n: int, low: float, high: float) -> np.ndarray:
    Q, _ = np.linalg.qr(rng.normal(size=(n, n)))
    return Q @ np.diag(rng.uniform(low, high, n)) @ Q.T


def draw(seed: int, n: int, m: int) -> tuple[StateSpace, np.ndarray, np.ndarray, np.ndarray]:
    """A system, P, Delta > 0 and Phi, about half of them with M(P) < 0."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    A *= rng.uniform(0.1, 0.8) / max(np.abs(np.linalg.eigvals(A)).max(initial=0.0), 1e-9)
    D = definite(rng, m, 1.0, 3.0) + 0.2 * rng.normal(size=(m, m))
    system = StateSpace(A, 0.4 * rng.normal(size=(n, m)), 0.4 * rng.normal(size=(m, n)), D)
    P, Delta = definite(rng, n, 0.3, 1.0), definite(rng, m, 0.01, 0.4)
    Phi = definite(rng, m, -0.5, 0.5)
    return system, P, (Delta + Delta.T) / 2.0, (Phi + Phi.T) / 2.0


@given(seeds, st.integers(0, 4), st.integers(1, 3))
def test_it_is_lemma_1(seed: int, n: int, m: int) -> None:
    """(3) > 0, (4) > 0 and M(P) < 0 with P = Q^-1 > 0: one and the same, unless at the edge."""
    system, P, Delta, Phi = draw(seed, n, m)
    least = -np.linalg.eigvalsh(storage_inequality(system, P, Delta, Phi))[-1]
    by_3 = np.linalg.eigvalsh(lemma2_matrix(system, np.linalg.inv(P), Delta, Phi))[0]
    by_4 = np.linalg.eigvalsh(schur_matrix(system, P, Delta, Phi))[0]
    if abs(least) > 1e-9:
        assert (least > 0.0) == (by_3 > 0.0) == (by_4 > 0.0)


def test_both_outcomes_occur() -> None:
    signs = {bool(np.linalg.eigvalsh(storage_inequality(*draw(seed, 2, 2)))[-1] < 0.0) for seed in range(20)}
    assert signs == {True, False}


def test_the_printed_sign_of_Phi_would_be_wrong() -> None:
    """y = 2 u is 1.9-ISP (with Delta 0.01), and not 2.1-ISP; with + Phi it would be both."""
    gain, Q = StateSpace.static([[2.0]]), np.zeros((0, 0))
    level = np.array([[0.01]])
    assert np.linalg.eigvalsh(lemma2_matrix(gain, Q, level, np.array([[1.9]])))[0] > 0.0
    assert np.linalg.eigvalsh(lemma2_matrix(gain, Q, level, np.array([[2.1]])))[0] < 0.0


@given(seeds, st.integers(0, 4), st.integers(1, 3))
@settings(max_examples=40)
def test_both_lemmas_decide_alike(seed: int, n: int, m: int) -> None:
    system, _, Delta, Phi = draw(seed, n, m)
    P = storage_by_lemma2(system, Delta, Phi)
    finding = analyse(system, Delta, Phi)
    assert (P is not None) == finding.holds
    if P is not None and n:
        assert np.linalg.eigvalsh(storage_inequality(system, P, Delta, Phi))[-1] < 0.0


@given(seeds, st.integers(0, 3), st.integers(1, 2))
def test_the_expression_is_the_matrix(seed: int, n: int, m: int) -> None:
    system, P, Delta, Phi = draw(seed, n, m)
    Q = np.linalg.inv(P)
    found = lemma2_expression(Q, system.A @ Q, system.B, system.C @ Q, system.D, np.linalg.inv(Delta), Phi)
    np.testing.assert_allclose(found.value, lemma2_matrix(system, Q, Delta, Phi), rtol=1e-9, atol=1e-9)


def test_it_contains_the_inverse_of_Delta() -> None:
    with pytest.raises(ValueError, match="positive definite"):
        lemma2_matrix(StateSpace.static(np.eye(2)), np.zeros((0, 0)), np.diag([1.0, 0.0]))
    with pytest.raises(ValueError, match="Phi: found 3 x 3; expected a 2 x 2 matrix"):
        storage_by_lemma2(StateSpace.static(np.eye(2)), np.eye(2), np.eye(3))
