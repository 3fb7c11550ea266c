"""Lemma 2 of [Bianchini2010]_: Lemma 1 with B, D and Sigma = Delta^{-1} entering linearly.

For Delta > 0, Sigma = (A, B, C, D) is Delta-OSP and Phi-ISP, strictly, iff there are Q > 0 and R with

    [ Q  R^T ]            [ C/2 ]           [ (D + D^T)/2 - Phi   B^T   D^T      ]
    [ R  S   ]  > 0,  R = [  A  ] Q,    S = [ B                   Q     0        ].        (3)
                          [  C  ]           [ D                   0     Delta^-1 ]

The chapter prints S with + Phi, which contradicts (2) and Definition 2; it must be - Phi. With P = Q^{-1}, a
congruence takes (3) to

    [ P    C^T/2               A^T     C^T      ]
    [ .    (D + D^T)/2 - Phi   B^T     D^T      ]  > 0,                                     (4)
    [ .    .                   P^{-1}  0        ]
    [ .    .                   .       Delta^-1 ]

and the Schur complement of its last two blocks is -M(P) of (2). (3) is strict, so it has solutions only for systems
without neutral pairs (:mod:`manyhands.design.passivity.storage`).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from manyhands.design import convex as cp
from manyhands.design.errors import SolverFailure
from manyhands.design.models.statespace import Matrix, StateSpace, symmetric_part
from manyhands.design.passivity.lemma1 import checked_levels, scaled, verified_margin
from manyhands.design.solver import ProgramInfeasible, solve, symmetric, value


def lemma2_matrix(system: StateSpace, Q: Matrix, Delta: Matrix, Phi: Matrix | None = None) -> Matrix:
    """The matrix of (3)(b) with R from (3)(c), (2n+2m) x (2n+2m).

    Args:
        system: (A, B, C, D), n states, m inputs and outputs.
        Q: n x n symmetric.
        Delta: m x m positive definite output level.
        Phi: m x m input level; zero by default.

    Raises:
        ValueError: Delta is not positive definite, or a level of the wrong shape.

    Example:
        >>> import numpy as np
        >>> from manyhands import passivity
        >>> lag, Delta = passivity.StateSpace([[0.5]], [[0.5]], [[1.0]], [[1.0]]), np.array([[0.2]])
        >>> Q = np.linalg.inv(passivity.storage_by_lemma2(lag, Delta))
        >>> bool(np.linalg.eigvalsh(passivity.lemma2_matrix(lag, Q, Delta))[0] > 0.0)
        True
    """
    Delta, Phi = _strict_levels(system, Delta, Phi)
    n, m = system.order, system.inputs
    A, B, C, D = system.A, system.B, system.C, system.D
    R = np.vstack([C / 2.0, A, C]) @ Q
    S = np.block(
        [
            [(D + D.T) / 2.0 - Phi, B.T, D.T],
            [B, Q, np.zeros((n, m))],
            [D, np.zeros((m, n)), symmetric_part(np.linalg.inv(Delta))],
        ]
    )
    return np.block([[Q, R.T], [R, S]])


def schur_matrix(system: StateSpace, P: Matrix, Delta: Matrix, Phi: Matrix | None = None) -> Matrix:
    """The matrix of (4), (2n+2m) x (2n+2m), for P > 0; arguments as in :func:`lemma2_matrix`.

    Example:
        >>> import numpy as np
        >>> from manyhands import passivity
        >>> lag, Delta = passivity.StateSpace([[0.5]], [[0.5]], [[1.0]], [[1.0]]), np.array([[0.2]])
        >>> P = passivity.storage_by_lemma2(lag, Delta)
        >>> bool(np.linalg.eigvalsh(passivity.schur_matrix(lag, P, Delta))[0] > 0.0)
        True
    """
    n, m = system.order, system.inputs
    Q: Matrix = np.asarray(np.linalg.inv(P), dtype=np.float64)
    congruence = np.eye(2 * n + 2 * m)
    congruence[:n, :n] = P
    return congruence.T @ lemma2_matrix(system, Q, Delta, Phi) @ congruence


def lemma2_expression(Q: Any, AQ: Any, B: Any, CQ: Any, D: Any, Sigma: Any, Phi: Any) -> Any:
    """(3)(b) as a cvxpy expression, affine in all of its arguments.

    For a given A and C, AQ = A @ Q and CQ = C @ Q are linear in Q; in a synthesis they are variables of their own.

    Args:
        Q: n x n.
        AQ: n x n.
        B: n x m.
        CQ: m x n.
        D: m x m.
        Sigma: m x m, Delta^{-1}.
        Phi: m x m.

    Example:
        >>> import cvxpy as cp
        >>> import numpy as np
        >>> from manyhands import passivity
        >>> Q, one = cp.Variable((1, 1), symmetric=True), np.eye(1)
        >>> passivity.lemma2_expression(Q, 0.5 * Q, 0.5 * one, Q, one, 5.0 * one, 0.0 * one).shape
        (4, 4)
    """
    n, m = B.shape
    corner = (D + D.T) / 2 - Phi
    if n == 0:
        return cp.bmat([[corner, D.T], [D, Sigma]])
    zero = np.zeros((n, m))
    return cp.bmat(
        [
            [Q, CQ.T / 2, AQ.T, CQ.T],
            [CQ / 2, corner, B.T, D.T],
            [AQ, B, Q, zero],
            [CQ, D, zero.T, Sigma],
        ]
    )


def storage_by_lemma2(system: StateSpace, Delta: Matrix, Phi: Matrix | None = None) -> Matrix | None:
    """P = Q^{-1} for the Q that leaves (3) the most room, checked in Lemma 1 itself; None if (3) has no solution.

    Args:
        system: (A, B, C, D), discrete, m x m, without neutral pairs.
        Delta: m x m positive definite output level.
        Phi: m x m input level; zero by default.

    Raises:
        ValueError: Delta is not positive definite, or a level of the wrong shape.
        SolverFailure: the solver's Q does not survive its check in Lemma 1.

    Example:
        >>> import numpy as np
        >>> from manyhands import passivity
        >>> lag = passivity.StateSpace([[0.5]], [[0.5]], [[1.0]], [[1.0]])
        >>> Delta = np.array([[0.2]])
        >>> Q = passivity.storage_by_lemma2(lag, Delta)
        >>> Q is not None
        True
    """
    Delta, Phi = _strict_levels(system, Delta, Phi)
    units = scaled(system)
    own, n = units.system, system.order
    Sigma = symmetric_part(np.linalg.inv(units.output_level(Delta)))
    Q: Any = cp.Variable((n, n), symmetric=True) if n else cp.Constant(np.zeros((0, 0)))
    room = cp.Variable()
    AQ, CQ = (own.A @ Q, own.C @ Q) if n else (None, None)
    M = lemma2_expression(Q, AQ, own.B, CQ, own.D, Sigma, units.input_level(Phi))
    constraints = [symmetric(M) >> room * np.eye(M.shape[0]), room <= 1.0]
    try:
        best = solve(cp.Problem(cp.Maximize(room), constraints), "Lemma 2")
    except ProgramInfeasible:
        return None
    if best <= 0.0:
        return None
    P = units.storage(np.asarray(np.linalg.inv(symmetric_part(value(Q))))) if n else np.zeros((0, 0))
    if verified_margin(system, P, Delta, Phi) is None:
        raise SolverFailure("Lemma 2: the solver's Q does not survive its check: the system is at the edge of (3)")
    return P


def _strict_levels(system: StateSpace, Delta: Matrix, Phi: Matrix | None) -> tuple[Matrix, Matrix]:
    Delta, Phi = checked_levels(system, Delta, Phi)
    if float(np.linalg.eigvalsh(Delta)[0]) <= 0.0:
        raise ValueError("Delta: expected a positive definite matrix, because Lemma 2 contains its inverse")
    return Delta, Phi
