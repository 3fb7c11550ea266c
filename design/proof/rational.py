"""Definiteness of symmetric matrices: exactly in rationals, or in ball arithmetic.

**In rationals.** A symmetric matrix has real eigenvalues, so that by Descartes' rule of signs it is positive definite
exactly when the coefficients of

    det(x I - M) = x^n - e_1 x^(n-1) + e_2 x^(n-2) - ...

alternate strictly, all e_k > 0, and semidefinite exactly when all e_k >= 0. The coefficients are whole numbers once
the denominators are cleared. No pivot is chosen, so that singular matrices need no special case.

**In balls.** For any X, if ||X^T M X - I|| < 1 in the greatest row sum, then X^T M X > 0, so that X is regular and
M > 0. X comes from numpy's Cholesky factor of M's midpoint, and the proof does not rely on how X was found. If M is too
close to singular for floats, a slightly shifted matrix is factored first, and then X^T M X, which is better
conditioned.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np
from flint import arb, arb_mat, ctx, fmpq, fmpq_mat, fmpz
from numpy.typing import NDArray

from manyhands.design.proof import cost
from manyhands.design.proof.finding import Verdict

_ARGUMENT = "exactly, in rationals"


def scaled(M: fmpq_mat) -> fmpq_mat:
    """D M D for a diagonal D of powers of two that brings the diagonal near 1: as definite as M, in shorter numbers."""
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
    """Whether the symmetric M is positive definite; without ``strict``, whether it is semidefinite.

    Where the numbers are long, balls are tried first, which are quicker and can only prove M > 0. What they do not
    decide is decided exactly, unless that would take more than :data:`.cost.MOST_EXACT` operations.
    """
    n = M.nrows()
    if n == 0:
        return Verdict(True, 1.0, _ARGUMENT)
    if n == 1:  # worth a shortcut: a thousand ports are a thousand of these
        entry = M[0, 0]
        holds = entry > 0 or (not strict and entry == 0)
        return Verdict(holds, float((entry > 0) - (entry < 0)), _ARGUMENT)
    if M.transpose() != M:
        return Verdict(False, float("-inf"), "the matrix is not symmetric")
    if cost.charpoly(n, _height(M)) > cost.EXACT_FIRST:
        verdict = decided(n, lambda: definite_in_balls(arb_mat(M)))
        if verdict.holds:
            return verdict
    N = scaled(M)
    bits = _common_bits(N)
    if cost.charpoly(n, bits) > cost.MOST_EXACT:
        argument = f"not proved in balls, and its numbers of more than {min(bits, _LONGEST):.0f} bits are too long"
        return Verdict(False, least_eigenvalue(N), f"{argument} to be decided exactly")
    numerators, _ = N.numer_denom()
    coefficients = numerators.charpoly()
    # starting with x^n, the sign of the coefficient of x^(n-k) must be (-1)^k
    signed = [coefficients[n - k] * (-1) ** k for k in range(1, n + 1)]
    holds = all(e > 0 for e in signed) if strict else all(e >= 0 for e in signed)
    return Verdict.of(holds, least_eigenvalue(N), _ARGUMENT)


_LONGEST = 100_000  # bits of a common denominator that is still computed


def _height(M: fmpq_mat) -> int:
    """The longest numerator or denominator of an entry, bits."""
    return max((int(entry.height_bits()) for entry in M.entries()), default=0)


def _common_bits(M: fmpq_mat) -> float:
    """A bound of the numerators over the common denominator, bits; infinite where that is longer than is computed."""
    common = fmpz(1)
    for q in {int(entry.q) for entry in M.entries()}:
        common = common.lcm(q)
        if common.bit_length() > _LONGEST:
            return float("inf")
    return float(common.bit_length() + _height(M))


def least_eigenvalue(M: fmpq_mat) -> float:
    """The least eigenvalue in floats, for the reader."""
    return float_least([[rounded(M[i, j]) for j in range(M.ncols())] for i in range(M.nrows())])


def float_least(rows: list[list[float]]) -> float:
    """The least eigenvalue of a symmetric matrix of floats, for the reader; nan if it cannot be computed."""
    matrix = np.array(rows, dtype=np.float64)
    if not np.all(np.isfinite(matrix)):
        return float("nan")
    try:
        with np.errstate(all="ignore"):
            return float(np.linalg.eigvalsh(matrix)[0]) if matrix.size else 1.0
    except np.linalg.LinAlgError:
        return float("nan")


def rounded(value: fmpq) -> float:
    """A float near ``value``; infinite if ``value`` is out of range."""
    try:
        return int(value.p) / int(value.q)
    except OverflowError:
        return float("inf") if value > 0 else float("-inf")


_STEPS = 5  # at a precision that a caller has set
_EPSILON = float(np.finfo(np.float64).eps)

Kind = TypeVar("Kind", fmpq_mat, arb_mat)
"""Matrices of rationals or of balls, so that the proofs' formulas are written once for both."""


def decided(order: int, test: Callable[[], Verdict]) -> Verdict:
    """The verdict of ``test`` at the first precision that proves it; a division by zero is a failure.

    Args:
        order: rows of the largest matrix.
        test: builds the matrices at the present precision and returns the verdict on them.
    """
    return all_decided(order, lambda: {"": test()}).popitem()[1]


def all_decided(order: int, test: Callable[[], dict[str, Verdict]]) -> dict[str, Verdict]:
    """Like :func:`decided`, for several verdicts by name; a division by zero leaves one, under an empty name."""
    found: dict[str, Verdict] = {}
    for precision in cost.precisions(order):
        with ctx.workprec(precision):
            try:
                found = test()
            except ZeroDivisionError:
                found = {"": Verdict(False, float("nan"), "a matrix that must be inverted is singular, or nearly so")}
        if all(verdict.holds for verdict in found.values()):
            break
    return found


def definite_in_balls(M: arb_mat) -> Verdict:
    """Whether the symmetric matrix that M encloses is proved positive definite."""
    n = M.nrows()
    argument = f"in balls of {ctx.prec} bits"
    if n == 0:
        return Verdict(True, 1.0, argument)
    diagonal = [M[i, i] for i in range(n)]
    for i, value in enumerate(diagonal):
        if not value > 0:  # nan and infinities as well
            return Verdict(False, _sign(value), f"{argument}: diagonal entry {i + 1} of {n} is not proved positive")
    scales = [_power_of_two(value) for value in diagonal]
    entries = M.entries()
    N = arb_mat(n, n, [entries[i * n + j] * scales[i] * scales[j] for i in range(n) for j in range(n)])
    middle = _midpoint(N)
    if middle is None:
        return Verdict(False, float("nan"), f"{argument}: the matrix is not finite")
    least = float_least(middle.tolist())
    S, X = N, None
    for _ in range(cost.STEPS.get(ctx.prec, _STEPS)):
        factor = _inverse_factor(middle)
        if factor is None:
            break
        Y = arb_mat(n, n, factor.ravel().tolist())
        X = Y if X is None else (X * Y).mid()
        N = X.transpose() * S * X
        if _distance_from_identity(N) < 1:
            return Verdict.of(True, least, argument)
        remaining = _midpoint(N)
        if remaining is None:
            break
        middle = remaining
    return Verdict(False, least, f"{argument}: not proved positive definite")


def identity(kind: type[Kind], n: int) -> Kind:
    """The n x n identity."""
    return kind(n, n, [int(i == j) for i in range(n) for j in range(n)])


def zeros(kind: type[Kind], rows: int, columns: int) -> Kind:
    """A matrix of zeros."""
    return kind(rows, columns)


def assembled(kind: type[Kind], blocks: list[list[Kind]]) -> Kind:
    """The matrix with these blocks; blocks of a row have equal heights, blocks of a column equal widths."""
    rows = sum(row[0].nrows() for row in blocks)
    columns = sum(block.ncols() for block in blocks[0])
    lines = []
    for row in blocks:
        parts = [block.tolist() for block in row]
        lines += [[entry for part in parts for entry in part[i]] for i in range(row[0].nrows())]
    return kind(rows, columns, [entry for line in lines for entry in line])


def diagonal_blocks(kind: type[Kind], parts: list[Kind]) -> Kind:
    """The block-diagonal matrix of ``parts``, which may be empty or not square."""
    rows, columns = sum(p.nrows() for p in parts), sum(p.ncols() for p in parts)
    out = zeros(kind, rows, columns)
    row = column = 0
    for part in parts:
        place(out, part, row, column)
        row, column = row + part.nrows(), column + part.ncols()
    return out


def place(into: Kind, part: Kind, row: int, column: int) -> None:
    """Write ``part`` into a matrix with its first entry at (row, column)."""
    for i, line in enumerate(part.tolist()):
        for j, entry in enumerate(line):
            into[row + i, column + j] = entry


def columns_cut(M: arb_mat, at: int) -> tuple[arb_mat, arb_mat]:
    """The columns before ``at``, and the columns from ``at`` on."""
    rows = M.tolist()
    n, width = M.nrows(), M.ncols()
    left = arb_mat(n, at, [entry for row in rows for entry in row[:at]])
    return left, arb_mat(n, width - at, [entry for row in rows for entry in row[at:]])


def symmetrised(M: arb_mat) -> arb_mat:
    """(M + M^T)/2."""
    return (M + M.transpose()) / 2


def greatest(M: arb_mat) -> arb:
    """The greatest absolute value of an entry, as an upper bound; 0 without entries."""
    most = arb(0)
    for entry in M.entries():
        most = most.max(entry.abs_upper())
    return most


def _power_of_two(value: arb) -> arb:
    """About value^(-1/2), as a power of two, so that scaling by it is exact."""
    mantissa, exponent = value.mid().man_exp()
    return arb(2) ** (-((abs(int(mantissa)).bit_length() + int(exponent)) // 2))


def _sign(value: arb) -> float:
    return -1.0 if value < 0 else 0.0


def _midpoint(M: arb_mat) -> NDArray[np.float64] | None:
    """The midpoint as floats, symmetric; None if it is not finite."""
    n = M.nrows()
    out = np.array([float(entry) for entry in M.entries()], dtype=np.float64).reshape(n, n)
    if not np.all(np.isfinite(out)):
        return None
    return np.asarray((out + out.T) / 2.0)


def _inverse_factor(M: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """About L^-T, for M + shift I = L L^T with the least shift, of the size of rounding, that allows the factor."""
    n = M.shape[0]
    unit = n * _EPSILON * float(np.max(np.abs(M)))
    with np.errstate(all="ignore"):
        for shift in (0.0, 4.0 * unit, 256.0 * unit):
            try:
                L = np.linalg.cholesky(M + shift * np.eye(n))
                Y = np.linalg.solve(L, np.eye(n)).T
            except np.linalg.LinAlgError:
                continue
            if np.all(np.isfinite(Y)):
                return np.asarray(Y)
    return None


def _distance_from_identity(N: arb_mat) -> arb:
    """An upper bound of ||N - I|| in the greatest row sum."""
    most = arb(0)
    for i, row in enumerate(N.tolist()):
        row[i] = row[i] - 1
        total = sum(map(abs, row), arb(0)).upper()
        if not total.is_finite():
            return arb.pos_inf()
        most = most.max(total)
    return most
