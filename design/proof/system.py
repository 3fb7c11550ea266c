"""Environments given by matrices or by rational functions, discretised in balls or exactly.

A continuous (A, B, C, D) becomes

- by backward Euler, with R = (I - T A)^-1, (R, T R B, C R, D + T C R B);
- by Tustin, with R = (I - T A/2)^-1, (R (I + T A/2), T R B, C R, D + (T/2) C R B);
- by zero-order hold, (the blocks of exp(T [A B; 0 0]), C, D).

A rational function of s becomes a rational function of z, exactly, by s = (z-1)/(Tz) or s = 2 (z-1)/(T (z+1)). Row by
row, each entry has the controllable companion form of its degree n, the larger degree of numerator and denominator,
whether common factors cancel or not: ones above the diagonal of A, -(a_n, ..., a_1) in its last row, B the last unit
vector, C = (b_n - a_n b_0, ..., b_1 - a_1 b_0), D = b_0.

**In differences.** The same form of a polynomial in z - 1 instead of z has A = I + that companion matrix; B, C and D
follow as above. Its states are a state of the entry and its differences from tick to tick, xi, (z-1) xi, (z-1)^2 xi and
so on. The states of the form in z are later and later values of xi, which for a slow pole hardly differ: a storage
matrix of floats in them loses its digits.
"""

from __future__ import annotations

import numpy as np
from flint import arb, arb_mat, fmpq, fmpq_poly

from manyhands.design.proof.claim import SystemData, TransferData
from manyhands.design.proof.exact import Number, exact_decimal
from manyhands.design.proof.rational import assembled, columns_cut, greatest, identity
from manyhands.design.proof.statics import feedthrough

_SWEEPS = 4
_MOST_GROWTH = 10_000  # of the norm of T A under a zero-order hold: its exponential has to be representable

Realisation = tuple[arb_mat, arb_mat, arb_mat, arb_mat]


class NotDiscretised(ValueError):
    """The discrete environment does not exist, or its numbers are out of bounds."""


def discrete(system: SystemData, T: fmpq) -> Realisation:
    """E, discrete, without its delay.

    Raises:
        ZeroDivisionError: the method's matrix is not proved regular.
        NotDiscretised: the zero-order hold's exponential is out of bounds.
        Undecided: the static gain is stated instead of D, but the system has a pole at z = 1 or s = 0.
    """
    A, B, C = (table.balls() for table in (system.A, system.B, system.C))
    D = arb_mat(feedthrough(system.A, system.B, system.C, system.D, system.static, system.method is None))
    n, m = A.nrows(), D.nrows()
    if system.method is None or n == 0:
        return A, B, C, D
    I = identity(arb_mat, n)
    if system.method == "zoh":
        whole = assembled(arb_mat, [[A, B], [arb_mat(m, n), arb_mat(m, m)]]) * T
        left, right = columns_cut(_exponential(whole), n)
        return _rows(left, n), _rows(right, n), C, D
    step = T if system.method == "backward-euler" else T / 2
    R = (I - A * step).inv()
    following = R if system.method == "backward-euler" else R * (I + A * step)
    C_R = C * R
    return following, R * B * T, C_R, D + C_R * B * step


def _exponential(M: arb_mat) -> arb_mat:
    """exp(M), computed for X^-1 M X; X is a diagonal of powers of two, hence exact, that reduces the norm.

    Raises:
        NotDiscretised: the reduced norm is out of bounds.
    """
    n = M.nrows()
    powers = [arb(2) ** power for power in _balance([[float(entry) for entry in row] for row in M.tolist()])]

    def scaled(N: arb_mat, into: int) -> arb_mat:
        rows = N.tolist()
        entries = [rows[i][j] * (powers[j] / powers[i]) ** into for i in range(n) for j in range(n)]
        return arb_mat(n, n, entries)

    balanced = scaled(M, 1)
    if not greatest(balanced) * n < _MOST_GROWTH:
        raise NotDiscretised("T A or T B is too large for a zero-order hold")
    return scaled(balanced.exp(), -1)


def _balance(rows: list[list[float]]) -> list[int]:
    """Exponents p of 2 for which the rows and columns of M_ij 2^(p_j - p_i) have similar norms (Osborne)."""
    M = np.abs(np.array(rows))
    n = len(M)
    np.fill_diagonal(M, 0.0)
    powers = np.zeros(n)
    if not np.all(np.isfinite(M)):
        return [0] * n
    with np.errstate(all="ignore"):
        for _ in range(_SWEEPS):
            for i in range(n):
                row, column = float(np.sum(M[i])), float(np.sum(M[:, i]))
                if row > 0.0 and column > 0.0 and np.isfinite(row / column):
                    step = float(np.round(np.log2(row / column) / 2.0))
                    powers[i] += step
                    M[i] *= 2.0**-step
                    M[:, i] *= 2.0**step
    return [int(power) for power in np.clip(powers, -500, 500)]


def _rows(M: arb_mat, count: int) -> arb_mat:
    """The first ``count`` rows of M."""
    return arb_mat(count, M.ncols(), [entry for row in M.tolist()[:count] for entry in row])


def transfer_order(transfer: TransferData) -> int:
    """Number of states of the entries' companion forms together."""
    return sum(max(len(num), len(den)) - 1 for row in transfer.entries for num, den in row)


def realised(transfer: TransferData, T: fmpq, differences: bool = False) -> Realisation:
    """E, discrete, without its delay, from exact coefficients; with states in ``differences`` or of the form in z.

    Raises:
        NotDiscretised: an entry is not causal.
    """
    m, order = len(transfer.entries), transfer_order(transfer)
    A, B, C, D = arb_mat(order, order), arb_mat(order, m), arb_mat(m, order), arb_mat(m, m)
    at = 0
    for i, row in enumerate(transfer.entries):
        for j, (num, den) in enumerate(row):
            degree = max(len(num), len(den)) - 1
            above, below = (_substituted(part, degree, transfer.method, T, differences) for part in (num, den))
            if below[0] == 0:
                raise NotDiscretised(f"entry ({i + 1}, {j + 1}) is not causal after discretisation")
            b, a = [x / below[0] for x in above], [x / below[0] for x in below]
            D[i, j] = b[0]
            for k in range(degree):
                if k:
                    A[at + k - 1, at + k] = 1
                C[i, at + degree - 1 - k] = b[k + 1] - a[k + 1] * b[0]
            for k in range(degree):
                A[at + degree - 1, at + degree - 1 - k] = -a[k + 1]
            for k in range(degree if differences else 0):
                A[at + k, at + k] = (1 - a[1]) if k == degree - 1 else 1
            if degree:
                B[at + degree - 1, j] = 1
            at += degree
    return A, B, C, D


def _substituted(coefficients: tuple[Number, ...], degree: int, method: str, T: fmpq, differences: bool) -> list[fmpq]:
    """Coefficients in z, or in z - 1, descending, of a polynomial in s times (Tz)^degree, or (T (z+1))^degree."""
    euler = method == "backward-euler"
    z = fmpq_poly([1, 1]) if differences else fmpq_poly([0, 1])
    above = (z - 1) * (1 if euler else 2)
    below = z * T if euler else (z + 1) * T
    total = fmpq_poly([0])
    for power, c in enumerate(reversed(coefficients)):
        total += fmpq_poly([exact_decimal(c)]) * above**power * below ** (degree - power)
    return [total[degree - k] for k in range(degree + 1)]


def companion(num: tuple[Number, ...], den: tuple[Number, ...], ports: int) -> Realisation:
    """A scalar filter in z times the identity of ``ports``: companion form, kron with I.

    For den = z^n + a_1 z^(n-1) + ... + a_n, after division by its first coefficient: first row of A is (-a_1, ...,
    -a_n), ones below the diagonal, B the first unit vector, C_j = b_j - a_j b_0, D = b_0.
    """
    n = len(den) - 1
    a = [exact_decimal(c) / exact_decimal(den[0]) for c in den]
    b = [fmpq(0)] * (n + 1 - len(num)) + [exact_decimal(c) / exact_decimal(den[0]) for c in num]
    A, B, C = arb_mat(n * ports, n * ports), arb_mat(n * ports, ports), arb_mat(ports, n * ports)
    for k in range(n):
        for p in range(ports):
            A[p, k * ports + p] = -a[k + 1]
            C[p, k * ports + p] = b[k + 1] - a[k + 1] * b[0]
            if k:
                A[k * ports + p, (k - 1) * ports + p] = 1
    for p in range(ports if n else 0):
        B[p, p] = 1
    return A, B, C, identity(arb_mat, ports) * arb(b[0])
