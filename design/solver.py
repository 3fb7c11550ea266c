"""The one place where a semidefinite program is handed to a solver.

Statuses are turned into errors of our own, and no "optimal" is believed: callers re-establish every
inequality from the numbers that come back (:mod:`manyhands.design.proof`).
"""

from __future__ import annotations

import warnings
from typing import Any

import cvxpy as cp
import numpy as np

from manyhands.design.errors import SolverFailure
from manyhands.design.statespace import Matrix, StateSpace

SOLVER = "CLARABEL"


class ProgramInfeasible(Exception):
    """The solver proved that the program has no solution; the caller knows what that means."""


def solve(program: cp.Problem, what: str) -> float:
    """Solve ``program`` and return its value.

    Args:
        program: a semidefinite program.
        what: for messages, e.g. "Theorem 3 for the given coupling".

    Raises:
        ProgramInfeasible: no solution exists.
        SolverFailure: the solver gave up, or called the program unbounded.
    """
    try:
        with warnings.catch_warnings():
            # a rough answer is told by its status, and the proof tells whether it is good enough
            warnings.filterwarnings("ignore", message="Solution may be inaccurate", category=UserWarning)
            program.solve(solver=SOLVER)
    except cp.error.SolverError as error:
        raise SolverFailure(
            f"{what}: {SOLVER} gave up ({error}). The data may span too many orders of magnitude: "
            "compare stiffness * period, damping and OSP levels, which should be within a few decades"
        ) from error
    if program.status in (cp.INFEASIBLE, cp.INFEASIBLE_INACCURATE):
        raise ProgramInfeasible(what)
    if program.status not in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE):
        raise SolverFailure(f"{what}: {SOLVER} ended with status {program.status!r}")
    return float(program.value)


def value(variable: Any) -> Matrix:
    """The value of a solved variable or expression, or of a constant, as a float64 matrix."""
    return np.array(getattr(variable, "value", variable), dtype=np.float64)


def symmetric(expression: Any) -> Any:
    """(X + X^T)/2 of a cvxpy expression: cones take their argument's symmetric part as written."""
    return (expression + expression.T) / 2


def positive(P: Any, least: float) -> list[cp.Constraint]:
    """P >= ``least`` I for a storage matrix; nothing to ask of a system without states."""
    n = P.shape[0]
    return [symmetric(P) >> least * np.eye(n)] if n else []


def affine(constant: Matrix, directions: Matrix, p: Any) -> Any:
    """The symmetric matrix constant + sum_i p_i directions_i as one affine cvxpy expression.

    A product and a reshape, whatever the directions came from: what cvxpy makes of the same matrix written out in
    blocks takes it several times as long to compile.

    Args:
        constant: k x k symmetric.
        directions: d x k x k, symmetric.
        p: cvxpy variable with d entries; unused when d = 0.
    """
    d, k = directions.shape[0], constant.shape[0]
    if d == 0:
        return cp.Constant(constant)
    return constant + cp.reshape(directions.reshape(d, k * k).T @ p, (k, k), order="C")


def storage_inequality_expression(system: StateSpace, P: Any, Delta: Any = None, Phi: Any = None) -> Any:
    """M(P) of Lemma 1 (see :mod:`manyhands.design.passivity`) as a cvxpy expression, affine in P, Delta, Phi."""
    A, B, C, D = system.A, system.B, system.C, system.D
    n, m = system.order, system.inputs
    G = np.hstack([A, B])
    I_psi = np.hstack([np.eye(n), np.zeros((n, m))])
    I_w = np.hstack([np.zeros((m, n)), np.eye(m)])
    y = np.hstack([C, D])
    out = G.T @ P @ G - I_psi.T @ P @ I_psi - (y.T @ I_w + I_w.T @ y) / 2
    if Delta is not None:
        out = out + y.T @ Delta @ y
    if Phi is not None:
        out = out + I_w.T @ Phi @ I_w
    return out
