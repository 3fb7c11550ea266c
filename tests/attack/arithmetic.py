"""Two arithmetics with one interface: floats for the search, and long numbers in which a suspect is built again.

Matrices are numpy arrays in both, of floats or of python-flint's balls, so that what is built from them is written
once. A number of a file is the decimal that stands there: 0.1 is one tenth. Floats round it, long numbers do not.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any, Protocol

import numpy as np
import scipy.linalg
from flint import acb, acb_mat, arb, arb_mat, ctx, fmpq
from numpy.typing import NDArray

Array = NDArray[Any]
BITS = 600


class Arithmetic(Protocol):
    """What the oracle computes with."""

    def number(self, value: float | Fraction) -> Any:
        """The decimal that the file writes for ``value``."""

    def zeros(self, rows: int, columns: int) -> Array:
        """A matrix of zeros."""

    def solve(self, A: Array, B: Array) -> Array:
        """A^-1 B, for one matrix or a stack of them; raises ArithmeticError where A is singular."""

    def exponential(self, A: Array) -> Array:
        """exp(A)."""

    def radius(self, A: Array) -> float:
        """Spectral radius less 1: the growth of a period."""

    def circle(self, angles: Array) -> Any:
        """exp(j angle), in a shape that multiplies matrices."""


class Floats:
    """Double precision; responses are computed for a stack of frequencies at once."""

    def number(self, value: float | Fraction) -> float:
        return float(value)

    def zeros(self, rows: int, columns: int) -> Array:
        return np.zeros((rows, columns))

    def solve(self, A: Array, B: Array) -> Array:
        try:
            return np.linalg.solve(A, B)
        except np.linalg.LinAlgError as error:
            raise ArithmeticError(str(error)) from error

    def exponential(self, A: Array) -> Array:
        return np.asarray(scipy.linalg.expm(A))

    def radius(self, A: Array) -> float:
        if not np.all(np.isfinite(A)):
            return float("nan")
        return float(np.abs(np.linalg.eigvals(A)).max(initial=0.0)) - 1.0

    def circle(self, angles: Array) -> Array:
        return np.exp(1j * np.asarray(angles))[:, None, None]


class Precise:
    """Balls of ``BITS`` bits, within ``ctx.workprec(BITS)``: rounding is out of question, and is enclosed."""

    def number(self, value: float | Fraction) -> arb:
        with ctx.workprec(BITS):
            return arb(decimal(value))

    def zeros(self, rows: int, columns: int) -> Array:
        out = np.empty((rows, columns), dtype=object)
        out[...] = arb(0)
        return out

    def solve(self, A: Array, B: Array) -> Array:
        try:
            return _array(_matrix(A).solve(_matrix(B)))
        except ZeroDivisionError as error:
            raise ArithmeticError("singular") from error

    def exponential(self, A: Array) -> Array:
        return _array(_matrix(A).exp())

    def radius(self, A: Array) -> float:
        if not len(A):
            return -1.0
        values = acb_mat(_matrix(A)).eig(algorithm="approx")
        return float(max((abs(value).mid() for value in values), key=float) - 1)

    def circle(self, angles: Array) -> acb:
        (angle,) = angles
        return (acb(0, 1) * arb(float(angle))).exp()


def decimal(value: float | Fraction) -> fmpq:
    """The rational number that the shortest decimal of ``value`` writes, or that it is."""
    exact = value if isinstance(value, Fraction) else Fraction(repr(value))
    return fmpq(exact.numerator, exact.denominator)


def rational(rows: Sequence[Sequence[float]]) -> list[list[fmpq]]:
    """A matrix of the file, by its decimals."""
    return [[decimal(value) for value in row] for row in rows]


def semidefinite(M: list[list[fmpq]], strict: bool = False) -> bool:
    """Whether the symmetric rational matrix is positive semidefinite, or definite, by elimination without rounding."""
    S = [list(row) for row in M]
    n = len(S)
    for k in range(n):
        pivot = S[k][k]
        if pivot < 0 or (strict and pivot == 0):
            return False
        if pivot == 0:
            if any(S[k][j] != 0 for j in range(k + 1, n)):
                return False
            continue
        for i in range(k + 1, n):
            if S[i][k] != 0:
                factor = S[i][k] / pivot
                for j in range(k + 1, n):
                    S[i][j] -= factor * S[k][j]
    return True


def certainly_negative(M: Array) -> bool:
    """Whether the Hermitian matrix of long numbers has a direction of negative sign, by the same elimination."""
    S = np.array(M, dtype=object)
    n = len(S)
    for k in range(n):
        pivot = acb(S[k, k]).real
        if pivot < 0:
            return True
        if not pivot > 0:
            return False
        for i in range(k + 1, n):
            factor = S[i, k] / pivot
            for j in range(k + 1, n):
                S[i, j] = S[i, j] - factor * S[k, j]
    return False


def _matrix(A: Array) -> arb_mat | acb_mat:
    rows = [list(row) for row in A]
    if any(isinstance(value, acb) for row in rows for value in row):
        return acb_mat(rows) if rows and rows[0] else acb_mat(A.shape[0], A.shape[1])
    return arb_mat(rows) if rows and rows[0] else arb_mat(A.shape[0], A.shape[1])


def _array(M: arb_mat | acb_mat) -> Array:
    out = np.empty((M.nrows(), M.ncols()), dtype=object)
    for i, row in enumerate(M.tolist()):
        for j, value in enumerate(row):
            out[i, j] = value
    return out
