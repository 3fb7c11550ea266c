"""State and port coordinates in which semidefinite programs are honest.

In raw SI units a solver can call a value optimal that is several times off. Ports are scaled by
S = Delta_D^{-1/2}, so that levels are of order one, and the states of a stable system so that each is as controllable
as it is observable: a storage matrix is then of the order of the port's units too.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import cholesky, solve_discrete_lyapunov, svd

from manyhands.design.statespace import Matrix, StateSpace, symmetric_part

_HIDDEN = 1e-14  # of the greatest Hankel singular value: below, a direction is not seen at all and keeps its scale

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
    observable are given h's least admitted value, so that X stays nonsingular.
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
    """The Gramian, the sum over k of A^k B B^T A^kT, n x n, of a stable A by doubling: no state's share is lost."""
    total, power = B @ B.T, A
    for _ in range(_MOST_DOUBLINGS):
        more = power @ total @ power.T
        total = total + more
        if float(np.max(np.abs(more), initial=0.0)) <= _CONVERGED * float(np.max(np.abs(total), initial=0.0)):
            break
        power = power @ power
    return total


def _factor(W: Matrix) -> Matrix:
    """A lower triangular L with L L^T = W plus as little as makes it positive definite."""
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
