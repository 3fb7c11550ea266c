"""Semidefinite programs and their solver: the only module that calls one.

:func:`solve` takes cvxpy expressions. :class:`LinearMatrixProgram` takes numbers, F_0 + sum_i x_i F_i >= 0, and hands
them to Clarabel without a modelling layer. The minimax programs of transparency need this: a search solves dozens of
them, each with different coefficients, and building expressions would take ten times as long as solving. Both turn a
solver's status into an error of :mod:`manyhands.design.errors`. No "optimal" is trusted: callers recompute every
inequality from the returned numbers, and :mod:`manyhands.design.proof` proves the certificate.

**Coordinates.** In raw SI units a solver can return a value as optimal that is wrong by a factor of several. So ports
are scaled by S = Delta_D^{-1/2}, which makes levels of order one. The states of a stable system are scaled so that each
is as controllable as it is observable: storage matrices are then of the order of the ports' units too.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import clarabel
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_discrete_lyapunov, svd

from manyhands.design import convex as cp
from manyhands.design.errors import SolverFailure
from manyhands.design.models.statespace import Matrix, StateSpace, symmetric_part

SOLVER = "CLARABEL"


class ProgramInfeasible(Exception):
    """The solver reported that the program has no solution; the caller turns this into an error of its own."""


def solve(program: cp.Problem, what: str) -> float:
    """Solve ``program`` and return its value.

    Args:
        program: a semidefinite program.
        what: for messages, e.g. "Theorem 3 for the given coupling".

    Raises:
        ProgramInfeasible: no solution exists.
        SolverFailure: the solver gave up, or reported the program as unbounded.
    """
    try:
        with warnings.catch_warnings():
            # the status shows a rough answer, and the proof decides whether it is good enough
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
    """(X + X^T)/2 of a cvxpy expression, because a cone constraint requires a symmetric argument."""
    return (expression + expression.T) / 2


def positive(P: Any, least: float) -> list[cp.Constraint]:
    """P >= ``least`` I for a storage matrix; no constraint for a system without states."""
    n = P.shape[0]
    return [symmetric(P) >> least * np.eye(n)] if n else []


def affine(constant: Matrix, directions: Matrix, p: Any) -> Any:
    """The symmetric matrix constant + sum_i p_i directions_i as one affine cvxpy expression.

    It is one product and one reshape. The same matrix written in blocks takes cvxpy several times as long to compile.

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
    """M(P) of Lemma 1 (see :mod:`manyhands.design.passivity.storage`) as a cvxpy expression, affine in P, Delta,
    Phi.
    """
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


class LinearMatrixProgram:
    """Minimise c^T x subject to linear inequalities and linear matrix inequalities.

    Args:
        size: number of unknowns x.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self._scalar: list[tuple[Matrix, Matrix]] = []
        self._norms: list[tuple[Matrix, Matrix]] = []
        self._cones: list[tuple[int, Matrix, sp.csc_matrix]] = []

    def nonnegative(self, constant: Matrix, linear: Matrix) -> None:
        """Require constant + linear x >= 0, entry by entry: k and k x size."""
        self._scalar.append((constant, linear))

    def positive(self, constant: Matrix, linear: Matrix) -> None:
        """Require constant + sum_i x_i linear[i] >= 0 as symmetric matrices: k x k and size x k x k."""
        k = len(constant)
        if k == 1:
            self.nonnegative(constant[0], linear[:, 0, :].T)
            return
        columns, rows = np.tril_indices(k)  # the upper triangle, column by column
        weight = np.where(rows == columns, 1.0, np.sqrt(2.0))
        self._cones.append((k, constant[rows, columns] * weight, sp.csc_matrix((linear[:, rows, columns] * weight).T)))

    def second_order(self, constant: Matrix, linear: Matrix) -> None:
        """Require the first entry of constant + linear x >= the Euclidean norm of the others: k and k x size."""
        self._norms.append((constant, linear))

    def hermitian(self, constant: NDArray[np.complex128], linear: NDArray[np.complex128]) -> None:
        """Like :meth:`positive`, for Hermitian matrices: [Re, -Im; Im, Re] is real and has the same eigenvalues."""
        if len(constant) == 1:
            self.nonnegative(constant[0].real, linear[:, 0, :].real.T)
            return
        self.positive(_embedded(constant), _embedded(linear))

    def solve(self, cost: Matrix, what: str) -> Matrix:
        """The minimiser x.

        Args:
            cost: c.
            what: for messages.

        Raises:
            ProgramInfeasible: no x satisfies the constraints.
            SolverFailure: the solver gave no usable answer.
        """
        blocks, right, cones = [], [], []
        if self._scalar:
            blocks.append(sp.csc_matrix(np.vstack([linear for _, linear in self._scalar])))
            right.append(np.concatenate([constant for constant, _ in self._scalar]))
            cones.append(clarabel.NonnegativeConeT(len(right[0])))
        if self._norms:
            blocks.append(sp.csc_matrix(np.vstack([linear for _, linear in self._norms])))
            right.append(np.concatenate([constant for constant, _ in self._norms]))
            cones += [clarabel.SecondOrderConeT(len(constant)) for constant, _ in self._norms]
        for k, constant, linear in self._cones:
            blocks.append(linear)
            right.append(constant)
            cones.append(clarabel.PSDTriangleConeT(k))
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.max_threads = 1  # the cones are small, and the machine may have only two cores
        solver = clarabel.DefaultSolver(
            sp.csc_matrix((self.size, self.size)),
            np.asarray(cost, dtype=np.float64),
            -sp.vstack(blocks, format="csc"),
            np.concatenate(right),
            cones,
            settings,
        )
        solution = solver.solve()
        status = str(solution.status)
        if "PrimalInfeasible" in status:
            raise ProgramInfeasible(what)
        x = np.array(solution.x, dtype=np.float64)
        if status not in ("Solved", "AlmostSolved") or not np.all(np.isfinite(x)):
            raise SolverFailure(f"{what}: Clarabel ended with status {status!r}")
        return x


def coefficients(affine: Callable[[Matrix], Matrix], size: int) -> tuple[Matrix, Matrix]:
    """F_0 and the F_i of an affine matrix function of x in R^size, by evaluating it at 0 and the unit vectors."""
    constant = affine(np.zeros(size))
    linear = np.zeros((size, *constant.shape))
    for i, unit in enumerate(np.eye(size)):
        linear[i] = affine(unit) - constant
    return constant, linear


def _embedded(hermitian: NDArray[np.complex128]) -> Matrix:
    re, im = hermitian.real, hermitian.imag
    return np.asarray(np.concatenate([np.concatenate([re, -im], -1), np.concatenate([im, re], -1)], -2))


_HIDDEN = 1e-14  # of the greatest Hankel singular value: the least one that a direction is given

_MOST_DOUBLINGS = 60  # 2^60 ticks
_CONVERGED = 1e-14  # relative change of a Gramian in one doubling


def scale_ports(system: StateSpace, left: Matrix, right: Matrix) -> StateSpace:
    """The system left * Sigma * right, for square matrices on its outputs and inputs."""
    return StateSpace(system.A, system.B @ right, left @ system.C, left @ system.D @ right)


def change_states(system: StateSpace, X: Matrix) -> StateSpace:
    """The same system in the states X psi, for a nonsingular X, n x n."""
    inverse = np.linalg.inv(X)
    return StateSpace(X @ system.A @ inverse, X @ system.B, system.C @ inverse, system.D)


def balancing(system: StateSpace) -> Matrix:
    """X, n x n, such that the Gramians of the stable discrete system are equal in the states X psi.

    W_c = L L^T, W_o = R^T R, R L = U diag(h) V^T: X = diag(h)^{-1/2} U^T R. Directions that are hardly controllable or
    observable get the least admitted value of h, so that X stays nonsingular.
    """
    n = system.order
    if n == 0:
        return np.zeros((0, 0))
    L = _factor(solve_discrete_lyapunov(system.A, system.B @ system.B.T))
    R = _factor(solve_discrete_lyapunov(system.A.T, system.C.T @ system.C)).T
    U, h, _ = svd(R @ L)
    h = np.maximum(h, _HIDDEN * max(float(h[0]), 1e-300))
    return np.asarray((U / np.sqrt(h)).T @ R, dtype=np.float64)


def reachability(A: Matrix, B: Matrix) -> Matrix:
    """The Gramian sum_k A^k B B^T A^kT, n x n, of a stable A; doubling keeps the small entries accurate."""
    total, power = B @ B.T, A
    for _ in range(_MOST_DOUBLINGS):
        more = power @ total @ power.T
        total = total + more
        if float(np.max(np.abs(more), initial=0.0)) <= _CONVERGED * float(np.max(np.abs(total), initial=0.0)):
            break
        power = power @ power
    return total


def _factor(W: Matrix) -> Matrix:
    """A lower triangular L with L L^T = W plus a small diagonal, just enough for a positive definite sum."""
    W = symmetric_part(W)
    scale = float(np.max(np.abs(np.diag(W)), initial=0.0))
    root = np.sqrt(np.maximum(np.diag(W), _HIDDEN * max(scale, 1e-300)))
    unit = W / root[:, None] / root[None, :]
    lift = _HIDDEN
    while True:
        try:
            return np.asarray(root[:, None] * cholesky(unit + lift * np.eye(len(W)), lower=True), dtype=np.float64)
        except np.linalg.LinAlgError:
            lift *= 10.0
