"""Theorem 4 of [Bianchini2010]_ as a reader of the chapter would type it into cvxpy: what the benchmark compares with.

Every unknown at once and in SI units. The strict inequalities are typed as <= and >=, with a small number where the
chapter needs one; nothing is reduced to a face, or solved block by block. Cone complementarity linearisation stops at
||W Z - I|| < 1e-4, as in the chapter's 4.1. E_hat may be given in the states in which it comes, (u, q, q') of the tick
before, or in states scaled by energy, which helps the solvers and is not in the chapter.
"""

from __future__ import annotations

from dataclasses import dataclass

import cvxpy as cp
import numpy as np

from manyhands.design.models.network import Network
from manyhands.design.models.statespace import Matrix, StateSpace, block_diagonal

TOLERANCE = 1e-4  # on ||W Z - I||, spectral norm
MOST_ITERATIONS = 100
_POSITIVE = 1e-6


@dataclass(frozen=True, eq=False)
class Outcome:
    """What the transcription came to.

    Attributes:
        status: "converged", "not converged", or the solver's status of the first program that it did not solve.
        iterations: linearised programs solved.
        stiffness: K by (22), N/m, one entry a port; None when not converged.
        damping: B by (22), N*s/m.
    """

    status: str
    iterations: int
    stiffness: Matrix | None = None
    damping: Matrix | None = None


def transformed_environment(network: Network, T: float, by_energy: bool) -> StateSpace:
    """E_hat = E Tz/(z-1) with states (u, q, q') of the tick before, or these times the root of their energy over T."""
    m, E = len(network.ports), network.environment(T)
    u_old = np.eye(m, E.order)  # u = u_old + T w
    E_hat = StateSpace(E.A + E.B @ u_old, T * E.B, E.C + E.D @ u_old, T * E.D)
    if not by_energy:
        return E_hat
    energy = block_diagonal([network.stiffness_matrix(), network.mass_matrix()]) / (2.0 * T)
    root = np.linalg.cholesky(energy).T
    back = np.linalg.inv(root)
    return StateSpace(root @ E_hat.A @ back, root @ E_hat.B, E_hat.C @ back, E_hat.D)


def theorem_4(E_hat: StateSpace, osp: float, T: float, solver: str) -> Outcome:
    """Find a decentralised spring-damper coupling, one block a port.

    Args:
        E_hat: the transformed environment.
        osp: level of every device, N*s/m.
        T: period, s.
        solver: name of a cvxpy solver.
    """
    m, n = E_hat.inputs, E_hat.order
    A_E, B_E, C_E, D_E = E_hat.A, E_hat.B, E_hat.C, E_hat.D
    Delta_D, K = osp * np.eye(m), T / (2.0 * osp) * np.eye(m)
    I, zero = np.eye(m), np.zeros((m, m))

    P, Phi_E = cp.Variable((n, n), symmetric=True), cp.Variable((m, m), symmetric=True)
    a, c = cp.Variable(m), cp.Variable(m)  # A_V and C_V are diagonal: 1 x 1 blocks
    delta, sigma = cp.Variable(m), cp.Variable(m)
    Q, Y = cp.Variable((2 * m, 2 * m), symmetric=True), cp.Variable((2 * m, 2 * m), symmetric=True)
    A_V, C_V, Delta_V, Sigma = cp.diag(a), cp.diag(c), cp.diag(delta), cp.diag(sigma)

    # (10)
    loop = cp.bmat([[Delta_D - Phi_E, -Phi_E], [-Phi_E, Delta_V - Phi_E]])
    # (14)
    off = A_E.T @ P @ B_E - C_E.T / 2.0
    corner = B_E.T @ P @ B_E - (D_E + D_E.T) / 2.0 - Phi_E
    dissipation = cp.bmat([[A_E.T @ P @ A_E - P, off], [off.T, corner]])
    # (15) with (12), B_V = T A_V and D_V = T C_V
    A = cp.bmat([[A_V, -A_V], [zero, zero]])
    B = cp.bmat([[A_V], [I]])
    D = C_V - K / T
    C = cp.bmat([[C_V, -D]])
    R = cp.bmat([[C / 2.0], [A], [C]])
    S = cp.bmat([[D, B.T, D], [B, Q, np.zeros((2 * m, m))], [D, np.zeros((m, 2 * m)), Sigma]])
    coupling = cp.bmat([[Y, R.T], [R, S]])
    # (18)
    W = cp.bmat([[Sigma, np.zeros((m, 2 * m))], [np.zeros((2 * m, m)), Q]])
    Z = cp.bmat([[Delta_V, np.zeros((m, 2 * m))], [np.zeros((2 * m, m)), Y]])
    inverse = cp.bmat([[W, np.eye(3 * m)], [np.eye(3 * m), Z]])

    def psd(M: cp.Expression) -> cp.Constraint:
        return (M + M.T) / 2.0 >> 0

    constraints = [
        psd(loop - _POSITIVE * np.eye(2 * m)),
        psd(-dissipation),
        psd(P - _POSITIVE * np.eye(n)),
        psd(coupling),
        psd(inverse),
        psd(W - _POSITIVE * np.eye(3 * m)),
    ]
    status = _solve(cp.Problem(cp.Minimize(0), constraints), solver)
    if status is not None:
        return Outcome(status, 0)
    for iteration in range(1, MOST_ITERATIONS + 1):
        W_j, Z_j = W.value, Z.value
        status = _solve(cp.Problem(cp.Minimize(cp.trace(W_j @ Z + Z_j @ W)), constraints), solver)
        if status is not None:
            return Outcome(status, iteration)
        if np.linalg.norm(W.value @ Z.value - np.eye(3 * m), 2) < TOLERANCE:
            # (22)
            return Outcome("converged", iteration, (1.0 - a.value) / c.value / T, a.value / c.value)
    return Outcome("not converged", MOST_ITERATIONS)


def _solve(program: cp.Problem, solver: str) -> str | None:
    """None when there is a solution to go on with, however rough; otherwise the solver's status."""
    try:
        program.solve(solver=solver)
    except cp.error.SolverError as error:
        return f"solver error: {str(error).splitlines()[0][:80]}"
    return None if program.status in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE) else str(program.status)
