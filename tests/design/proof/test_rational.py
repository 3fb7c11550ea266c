"""The arithmetic: definiteness exactly and in balls, far closer to singular than floats can tell."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from flint import arb_mat, ctx, fmpq, fmpq_mat
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.design.proof import environment, rational
from manyhands.design.proof import exact as sparse
from manyhands.design.proof.exact import MAX_DENSE

SMALL = st.integers(-6, 6)


def exact(rows: list[list[int]]) -> fmpq_mat:
    return fmpq_mat(rows)


@st.composite
def symmetric(draw: st.DrawFn) -> list[list[int]]:
    n = draw(st.integers(1, 4))
    M = [[0] * n for _ in range(n)]
    for i in range(n):
        for j in range(i + 1):
            M[i][j] = M[j][i] = draw(SMALL) + (8 if i == j and draw(st.booleans()) else 0)
    return M


def minors(M: list[list[int]], strict: bool) -> bool:
    """Sylvester's criterion by elimination in fractions: leading minors, or all principal ones."""

    def det(rows: list[int]) -> Fraction:
        A = [[Fraction(M[i][j]) for j in rows] for i in rows]
        out = Fraction(1)
        for k in range(len(A)):
            pivot = next((i for i in range(k, len(A)) if A[i][k]), None)
            if pivot is None:
                return Fraction(0)
            if pivot != k:
                A[k], A[pivot], out = A[pivot], A[k], -out
            out *= A[k][k]
            for i in range(k + 1, len(A)):
                f = A[i][k] / A[k][k]
                A[i] = [a - f * b for a, b in zip(A[i], A[k], strict=True)]
        return out

    n = len(M)
    if strict:
        return all(det(list(range(k))) > 0 for k in range(1, n + 1))
    return all(det([i for i in range(n) if mask >> i & 1]) >= 0 for mask in range(1, 2**n))


@given(M=symmetric())
def test_exact_definiteness_is_sylvesters(M: list[list[int]]) -> None:
    assert rational.definite(exact(M)).holds is minors(M, strict=True)
    assert rational.definite(exact(M), strict=False).holds is minors(M, strict=False)
    if rational.decided(len(M), lambda: rational.definite_in_balls(arb_mat(exact(M)))).holds:
        assert minors(M, strict=True)
    elif minors(M, strict=True):
        pytest.fail("small whole numbers are easy for balls")


def hilbert(n: int) -> fmpq_mat:
    return fmpq_mat(n, n, [fmpq(1, i + j + 1) for i in range(n) for j in range(n)])


@pytest.mark.parametrize("n", [8, 14, 20])
def test_the_hilbert_matrix(n: int) -> None:
    """Condition up to 1e28: positive; singular when the right rank-one matrix is taken off; then negative."""
    H = hilbert(n)
    assert rational.definite(H).holds
    assert rational.decided(n, lambda: rational.definite_in_balls(arb_mat(H))).holds
    e = fmpq_mat(n, 1, [fmpq((-1) ** i) for i in range(n)])
    least = 1 / (e.transpose() * H.inv() * e)[0, 0]  # H - least e e' is singular
    singular = H - e * e.transpose() * least
    assert rational.definite(singular, strict=False).holds
    assert not rational.definite(singular).holds
    assert not rational.decided(n, lambda: rational.definite_in_balls(arb_mat(singular))).holds
    below = H - e * e.transpose() * (least * (1 + fmpq(1, 10**9)))
    assert not rational.definite(below, strict=False).holds
    assert not rational.decided(n, lambda: rational.definite_in_balls(arb_mat(below))).holds


def test_scales_do_not_matter() -> None:
    D = [fmpq(10) ** (8 * (i - 3)) for i in range(7)]
    H = hilbert(7)
    M = fmpq_mat(7, 7, [H[i, j] * D[i] * D[j] for i in range(7) for j in range(7)])
    assert rational.definite(M).holds
    assert rational.decided(7, lambda: rational.definite_in_balls(arb_mat(M))).holds
    assert rational.definite(M).least == pytest.approx(float(np.linalg.eigvalsh(_unit(7))[0]), rel=3.0)


def _unit(n: int) -> np.ndarray:
    H = np.array([[1.0 / (i + j + 1) for j in range(n)] for i in range(n)])
    d = np.sqrt(np.diag(H))
    return H / d / d[:, None]


def test_the_radius_of_a_ball_counts() -> None:
    with ctx.workprec(128):
        wide = arb_mat([[1, 0], [0, 1]])
        entry = wide[0, 1]
        wide[0, 1] = wide[1, 0] = entry + rational.arb(0, 0.5)
        assert rational.definite_in_balls(wide).holds
        wide[0, 1] = wide[1, 0] = entry + rational.arb(0, 1.5)
        assert not rational.definite_in_balls(wide).holds
        wide[0, 1] = wide[1, 0] = rational.arb("nan")
        assert not rational.definite_in_balls(wide).holds


def test_the_precision_is_put_back() -> None:
    before = ctx.prec
    with pytest.raises(KeyboardInterrupt):
        rational.decided(1, _interrupted)
    assert ctx.prec == before


def _interrupted():
    raise KeyboardInterrupt


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=15)
def test_diagonal_dominance_with_weights(seed: int) -> None:
    """A chain of springs with a negative spring at its end: proved nearly up to the stiffness of the chain."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(65, 120))
    M: sparse.Sparse = {}
    springs = [fmpq(int(rng.integers(1, 100))) for _ in range(n)]
    for i, k in enumerate(springs):  # a chain, the first one held by the ground
        sparse.add_entry(M, i, i, k)
        if i:
            sparse.add_entry(M, i - 1, i - 1, k)
            sparse.add_entry(M, i - 1, i, -k)
            sparse.add_entry(M, i, i - 1, -k)
    series = 1 / sum((1 / k for k in springs), fmpq(0))
    at_end = (n - 1, n - 1)
    below, above = dict(M), dict(M)
    sparse.add_entry(below, *at_end, -series * fmpq(9, 10))
    sparse.add_entry(above, *at_end, -series * (1 + fmpq(1, 10**6)))
    assert environment.dominant(below, list(range(n))).holds
    assert not environment.dominant(above, list(range(n))).holds
    assert not sparse.definite(sparse.dense(above, range(n))).holds


def test_too_large_a_number_is_reported() -> None:
    M: sparse.Sparse = {}
    for i in range(MAX_DENSE + 1):
        sparse.add_entry(M, i, i, fmpq(2))
        sparse.add_entry(M, 0, i, fmpq(1, 100)) if i else None
        sparse.add_entry(M, i, 0, fmpq(1, 100)) if i else None
    verdict = sparse.definite_by_groups(M, MAX_DENSE + 1)
    assert not verdict.holds
    assert "too many" in verdict.argument
