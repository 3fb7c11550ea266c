"""Rational functions of s as a discrete state space, in states that keep their digits.

With backward Euler s = D/(T (1 + D)), with Tustin s = 2 D/(T (2 + D)), for the difference D = z - 1. So an entry of
degree n is a rational function of D too, and has the companion form of its coefficients a_k, b_k in D:

    A = I + N,   N = ones above the diagonal, -(a_n, ..., a_1) in the last row,   B = the last unit vector,
    C = (b_n - a_n b_0, ..., b_1 - a_1 b_0),   D = b_0.

Its states are a state xi and its differences from tick to tick, D xi, D^2 xi and so on. In the companion form in z they
would be later and later values of xi. Of a slow pole at -a these differ by a T, hence a polynomial in z of several slow
poles has the sum (a T)^n of its coefficients, which are of order one: floats lose the poles, and a storage matrix loses
its room. In D the coefficients themselves are of the size of the poles. They are computed exactly from the entry's
decimals, and rounded once.

Each state is divided by a power of two, its unit, which balances N [Osborne1960]_. :class:`InDifferences` is a storage
matrix in the states without units, as a certificate states it.
"""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from functools import lru_cache
from typing import Literal

import numpy as np

from manyhands.design.errors import Infeasible, SolverFailure
from manyhands.design.models.brief import brief_repr
from manyhands.design.models.statespace import Matrix, Rational, StateSpace, block_diagonal, matrix, trimmed_polynomial

_SWEEPS = 20  # of balancing; each is exact, and after these a further one changes little
_MOST_POWER = 400  # of two, in a unit: so that no product of two units leaves the floats
_KEPT = 64  # realisations


@dataclass(frozen=True, eq=False)
class InDifferences:
    """A storage matrix in the differences of the states of rational functions.

    Attributes:
        P: n x n symmetric; the states are those of the entries, row by row, then those of a delay.
    """

    P: Matrix

    __repr__ = brief_repr

    def __len__(self) -> int:
        """N."""
        return len(self.P)


@lru_cache(_KEPT)
def realise(
    entries: tuple[tuple[Rational, ...], ...], method: Literal["backward-euler", "tustin"], T: float
) -> tuple[StateSpace, Matrix]:
    """The discrete state space of a matrix of rational functions of s, and the units of its states.

    Every entry keeps its states, also an entry that is a plain gain. A proof that rebuilds the system exactly then does
    not have to decide which numbers are zero.

    Args:
        entries: m rows of m (numerator, denominator), descending powers of s; may be improper for backward Euler.
        method: of the discretisation.
        T: period, s.

    Returns:
        The system, n states; and n powers of two, by which the differences were divided.

    Raises:
        Infeasible: an entry's output would need a future input, or a coefficient leaves the floats.
    """
    m = len(entries)
    parts: list[Matrix] = []
    units: list[Matrix] = []
    B, C, D = np.zeros((0, m)), np.zeros((m, 0)), np.zeros((m, m))
    for i, row in enumerate(entries):
        for j, entry in enumerate(row):
            place = f"the environment's entry ({i + 1}, {j + 1})"
            N, leaving, D[i, j] = _in_differences(entry, method, T, place)
            order = len(N)
            unit = _balancing(N)
            units.append(unit)
            parts.append(np.eye(order) + N * unit / unit[:, None])
            entering, wide = np.zeros((order, m)), np.zeros((m, order))
            if order:
                entering[-1, j] = 1.0 / unit[-1]
                wide[i] = leaving * unit
            B, C = np.vstack([B, entering]), np.hstack([C, wide])
    unit = np.concatenate(units)
    unit.setflags(write=False)
    return StateSpace(block_diagonal(parts), B, C, D), unit


def _in_differences(entry: Rational, method: str, T: float, place: str) -> tuple[Matrix, Matrix, float]:
    """N (n x n), C (n,) and D of one entry, without units."""
    num, den = (trimmed_polynomial(part) or (0.0,) for part in entry)
    degree = max(len(num), len(den)) - 1
    above, below = (_substituted(part, degree, method, T) for part in (num, den))
    if below[0] == 0:
        raise Infeasible(
            f"{place} is not causal after discretisation; expected backward Euler, or a numerator of a lower degree"
        )
    b, a = [c / below[0] for c in above], [c / below[0] for c in below]
    N = np.diag(np.ones(max(degree - 1, 0)), 1) if degree else np.zeros((0, 0))
    try:
        if degree:
            N[-1] = [-float(c) for c in a[:0:-1]]
        leaving = np.array([float(b_k - a_k * b[0]) for b_k, a_k in zip(b[:0:-1], a[:0:-1], strict=True)])
        return N, leaving, float(b[0])
    except OverflowError:
        raise Infeasible(
            f"{place} has coefficients so far apart that they leave the floats after discretisation; expected num and "
            "den divided by a common number, or without the terms that do not matter"
        ) from None


def _substituted(coefficients: tuple[float, ...], degree: int, method: str, T: float) -> list[Fraction]:
    """Coefficients in D, descending, of a polynomial in s times (T (1 + D))^degree, or (T (2 + D))^degree; exact."""
    period = _decimal(T)
    slope, constant = (Fraction(1), period) if method == "backward-euler" else (Fraction(2), 2 * period)
    # Horner's rule, with s = slope D / (constant + period D), ascending powers of D
    total, power = [Fraction(0)], [Fraction(1)]
    for coefficient in coefficients:
        total = _sum(_times(total, [Fraction(0), slope]), [_decimal(coefficient) * c for c in power])
        power = _times(power, [constant, period])
    for _ in range(degree + 1 - len(coefficients)):
        total = _times(total, [constant, period])
    total += [Fraction(0)] * (degree + 1 - len(total))
    return total[degree::-1]


def _times(left: list[Fraction], right: list[Fraction]) -> list[Fraction]:
    out = [Fraction(0)] * (len(left) + len(right) - 1)
    for i, a in enumerate(left):
        for j, b in enumerate(right):
            out[i + j] += a * b
    return out


def _sum(left: list[Fraction], right: list[Fraction]) -> list[Fraction]:
    longer, shorter = (left, right) if len(left) >= len(right) else (right, left)
    return [c + (shorter[i] if i < len(shorter) else 0) for i, c in enumerate(longer)]


def _decimal(value: float) -> Fraction:
    """The number's shortest decimal, exactly."""
    return Fraction(Decimal(repr(float(value))))


def _balancing(N: Matrix) -> Matrix:
    """Powers of two u for which N_ij u_j / u_i has rows and columns of similar size (Osborne's iteration)."""
    size, powers = np.abs(N), np.zeros(len(N))
    np.fill_diagonal(size, 0.0)
    for _ in range(_SWEEPS):
        before = powers.copy()
        for i in range(len(N)):
            row, column = float(np.sum(size[i])), float(np.sum(size[:, i]))
            if row > 0.0 and column > 0.0:
                step = np.round(np.log2(row / column) / 2.0)
                powers[i] += step
                size[i] *= 2.0**-step
                size[:, i] *= 2.0**step
        if np.all(powers == before):
            break
    return np.asarray(2.0 ** np.clip(powers, -_MOST_POWER, _MOST_POWER), dtype=np.float64)


def stated(P: Matrix, units: Matrix) -> InDifferences:
    """A storage matrix in states with ``units``, n x n, as a certificate states it: in the states without them.

    Raises:
        SolverFailure: an entry leaves the floats.
    """
    with np.errstate(over="ignore"):
        out = P / units[:, None] / units
    if not np.all(np.isfinite(out)):
        raise SolverFailure("the environment's storage matrix leaves the floats: its poles are too far apart")
    return InDifferences(matrix(out))
