"""Definiteness of symmetric rational matrices, exactly.

A symmetric matrix has real eigenvalues, so that by Descartes' rule of signs it is positive definite exactly when the
coefficients of

    det(x I - M) = x^n - e_1 x^(n-1) + e_2 x^(n-2) - ...

alternate strictly, all e_k > 0, and semidefinite exactly when all e_k >= 0. The coefficients are whole numbers once
the denominators are cleared, and no pivot is ever chosen: singular matrices are as good as any.
"""

from __future__ import annotations

import numpy as np
from flint import fmpq, fmpq_mat

from manyhands.design.proof.finding import Verdict

_ARGUMENT = "exactly, in rationals"


def scaled(M: fmpq_mat) -> fmpq_mat:
    """D M D with a diagonal D of powers of two that brings the diagonal near 1: definite as M is, and shorter."""
    n = M.nrows()
    powers = [_half_log2(M[i, i]) for i in range(n)]
    two = fmpq(2)
    factors = [two ** (-power) for power in powers]
    return fmpq_mat(n, n, [M[i, j] * factors[i] * factors[j] for i in range(n) for j in range(n)])


def _half_log2(value: fmpq) -> int:
    """Half the binary logarithm of |value|, to the nearest whole number; 0 for 0."""
    if value == 0:
        return 0
    return (abs(int(value.p)).bit_length() - int(value.q).bit_length()) // 2


def definite(M: fmpq_mat, strict: bool = True) -> Verdict:
    """Whether the symmetric M is positive definite, or semidefinite where not ``strict``."""
    n = M.nrows()
    if n == 0:
        return Verdict(True, 1.0, _ARGUMENT)
    if n == 1:  # a thousand ports are a thousand of these
        entry = M[0, 0]
        holds = entry > 0 or (not strict and entry == 0)
        return Verdict(holds, float((entry > 0) - (entry < 0)), _ARGUMENT)
    if M.transpose() != M:
        return Verdict(False, float("-inf"), "the matrix is not symmetric")
    N = scaled(M)
    numerators, _ = N.numer_denom()
    coefficients = numerators.charpoly()
    # x^n first: the sign of the coefficient of x^(n-k) must be (-1)^k
    signed = [coefficients[n - k] * (-1) ** k for k in range(1, n + 1)]
    holds = all(e > 0 for e in signed) if strict else all(e >= 0 for e in signed)
    return Verdict.of(holds, least_eigenvalue(N), _ARGUMENT)


def least_eigenvalue(M: fmpq_mat) -> float:
    """The least eigenvalue in floats, for the reader."""
    return float_least([[rounded(M[i, j]) for j in range(M.ncols())] for i in range(M.nrows())])


def float_least(rows: list[list[float]]) -> float:
    """The least eigenvalue of a symmetric matrix of floats, for the reader; nan where there is none."""
    matrix = np.array(rows, dtype=np.float64)
    if not np.all(np.isfinite(matrix)):
        return float("nan")
    try:
        with np.errstate(all="ignore"):
            return float(np.linalg.eigvalsh(matrix)[0]) if matrix.size else 1.0
    except np.linalg.LinAlgError:
        return float("nan")


def rounded(value: fmpq) -> float:
    """A float near ``value``; infinite where it is out of range."""
    try:
        return int(value.p) / int(value.q)
    except OverflowError:
        return float("inf") if value > 0 else float("-inf")
