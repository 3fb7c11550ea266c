"""Passivity of discrete systems in state space: Lemma 1 of [Bianchini2010]_, with facial reduction.

Sigma = (A, B, C, D) is Delta-OSP and Phi-ISP (Definition 2) with storage psi^T P psi, P > 0, iff

    M(P) = [ A^T P A - P + C^T Delta C        A^T P B - C^T/2 + C^T Delta D               ]
           [ B^T P A - C/2 + D^T Delta C      B^T P B - (D + D^T)/2 + D^T Delta D + Phi  ]  <= 0.    (2)

The paper prints (2) with <, which neither E_hat (an integrator per port) nor V_hat (a differentiator per port) can
satisfy. A *neutral* pair (psi, w) has

    A psi + B w = psi    and    w = 0 (at the input of E_hat) or C psi + D w = 0 (at the output of V_hat).

It neither stores nor exchanges energy, so its quadratic form is zero for every P. M(P) <= 0 then forces
M(P) (psi, w) = 0, which are linear equalities on P. They are imposed exactly, by P = P_0 + sum_i p_i N_i, and
strictness is required only on a complement of the neutral pairs. Without this reduction, (2) has no interior point for
a solver.

More generally, every pair with A psi + B w = z psi, |z| = 1, that exchanges nothing at the levels Delta, Phi is neutral
(:mod:`manyhands.design.passivity.frequency`), also a complex one. :func:`storage_face_of` is for all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from manyhands.design.models.statespace import Matrix, StateSpace

_RANK_TOLERANCE = 1e-9  # static directions differ from slow ones (omega T of 1e-6 and more) by far more
_EQUALITY_TOLERANCE = 1e-8  # relative residual above which the equalities have no solution


@dataclass(frozen=True, eq=False)
class StorageFace:
    """The affine set of storage matrices P that the neutral pairs allow, and the directions for strictness.

    Attributes:
        P_0: one matrix of the set, n x n symmetric.
        directions: N_i stacked, d x n x n, symmetric: P = P_0 + sum_i p_i N_i.
        complement: W, (n+m) x c with orthonormal columns: on the set, (2) becomes W^T M(P) W < 0.
    """

    P_0: Matrix
    directions: Matrix
    complement: Matrix


def storage_face_of(
    system: StateSpace, M_0: Matrix, pairs: Sequence[tuple[complex, NDArray[np.complex128]]]
) -> StorageFace | None:
    """The face that given neutral ``pairs`` leave: M(P) x = 0 for each pair.

    With G = [A, B], E = [I, 0], x = (psi, w): M(P) x = (z G - E)^T P psi + M(0) x, real and imaginary parts.

    Args:
        system: (A, B, C, D), n states, m inputs.
        M_0: M(0) at the given levels, (n+m) x (n+m).
        pairs: (z, x) with |z| = 1, x of n+m complex entries and length about 1.

    Returns:
        The face, or None if the equalities have no symmetric solution.
    """
    n, m = system.order, system.inputs
    if not pairs:
        return _solved(system, lambda _: np.zeros(0), np.zeros(0), np.eye(n + m))
    G, E = np.hstack([system.A, system.B]), np.hstack([np.eye(n), np.zeros((n, m))])
    stacked = np.stack([x for _, x in pairs], axis=1)
    left = [(z * G - E).T for z, _ in pairs]
    right = -M_0 @ stacked

    def both(columns: NDArray[np.complex128]) -> Matrix:
        return np.concatenate([columns.real.ravel(), columns.imag.ravel()])

    return _solved(
        system,
        lambda N: both(np.stack([rows @ (N @ x[:n]) for rows, (_, x) in zip(left, pairs, strict=True)], axis=1)),
        both(right),
        kernel(np.hstack([stacked.real, stacked.imag]).T),
    )


def _solved(
    system: StateSpace, equations_of: Callable[[Matrix], Matrix], right: Matrix, complement: Matrix
) -> StorageFace | None:
    """The face of ``equations_of(P)`` = ``right``, linear in P; None if the equations have no solution."""
    n = system.order
    rows, columns = np.triu_indices(n)
    basis = np.zeros((rows.size, n, n))
    basis[np.arange(rows.size), rows, columns] = 1.0
    basis[np.arange(rows.size), columns, rows] = 1.0
    if right.size == 0:
        return StorageFace(np.zeros((n, n)), basis, complement)
    equations = np.stack([equations_of(N) for N in basis], axis=1) if len(basis) else np.zeros((right.size, 0))
    free = kernel(equations)
    determined = kernel(free.T)  # solving only here avoids dividing rounding by rounding in the free directions
    coefficients = determined @ np.linalg.lstsq(equations @ determined, right, rcond=None)[0]
    residual = float(np.max(np.abs(equations @ coefficients - right)))
    gain = float(np.max(np.abs(np.hstack([system.C, system.D]))))  # ``right`` may be rounding of this size
    if residual > _EQUALITY_TOLERANCE * max(gain, 1e-300):
        return None
    return StorageFace(np.tensordot(coefficients, basis, axes=1), np.tensordot(free.T, basis, axes=1), complement)


def kernel(M: Matrix) -> Matrix:
    """An orthonormal basis of the null space of M, columns x d, by singular values.

    They are compared with the largest singular value or 1, whichever is larger. Every M of this module consists of
    A - I or of orthonormal columns, so that a value far below 1 is rounding even if all values are.
    """
    if M.shape[0] == 0 or M.shape[1] == 0:
        return np.eye(M.shape[1])
    _, values, right = np.linalg.svd(M, full_matrices=True)
    rank = int(np.sum(values > _RANK_TOLERANCE * max(float(values[0]), 1.0)))
    return np.asarray(right[rank:].T)
