"""What a system does by itself: motions that its inputs do not cause and its outputs do not show, taken apart.

Two equal masses on equal springs at one port swing against each other unseen. Such a motion, psi_u+ = A_u psi_u,
stands beside the rest,

    psi = T (psi_f, psi_u),    T^{-1} A T = diag(A_f, A_u),    T^{-1} B = (B_f, 0),    C T = (C_f, 0),

so that Lemma 1 of [Bianchini2010]_ parts, too: a storage matrix of the whole exists iff one of the felt part
(A_f, B_f, C_f, D) does, at the same levels, and some P_u > 0 has A_u^T P_u A_u <= P_u. Nothing that is measured at the
ports can tell how large P_u ought to be, and a program that is asked for both at once is lost in that freedom.

The unfelt states are found as a subspace N that is invariant and unobservable, beside an invariant one that holds
every state which inputs can reach, the kernel of L^T; both by a staircase, one singular value
decomposition for each step, each decided for itself. N is used where L^T N is square and far from singular,
which it is in all that is reciprocal, as networks are. Elsewhere nothing is taken apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_discrete_lyapunov

from manyhands.design.scaling import state_units
from manyhands.design.statespace import Matrix, StateSpace, symmetric_part

_ROUNDING = 1e-11  # of a spectral radius: no farther from 1 is on the circle; of a port's row: there is none
UNFELT = 1e-11
"""Of A's norm: what is felt by less is rounding."""

_APART = 1e-4  # least cosine between N and L: T's condition stays below its inverse
_INDEPENDENT = 1e-6  # the same for the eigenvectors of a motion that is to be stored mode by mode


@dataclass(frozen=True, eq=False)
class Parted:
    """A discrete system and its unfelt motions.

    Attributes:
        felt: (A_f, B_f, C_f, D).
        T_inverse: n x n, (psi_f, psi_u) = T_inverse psi.
        P_u: storage matrix of the unfelt motions, A_u^T P_u A_u <= P_u, P_u > 0.
    """

    felt: StateSpace
    T_inverse: Matrix
    P_u: Matrix

    def storage(self, P_f: Matrix) -> Matrix:
        """The whole system's storage matrix, from one of its felt part."""
        felt, unfelt = self.T_inverse[: len(P_f)], self.T_inverse[len(P_f) :]
        return symmetric_part(felt.T @ P_f @ felt + unfelt.T @ self.P_u @ unfelt)


def parted(system: StateSpace, tolerance: float = UNFELT) -> Parted:
    """Take the unfelt motions of a discrete ``system`` apart, as far as they have a storage of their own.

    Where there is none, or none with a storage matrix, ``felt`` is the system itself.

    Args:
        system: (A, B, C, D).
        tolerance: of A's norm in balanced units; a step of the staircase below that leads nowhere. Above
            :data:`UNFELT` what is felt a little is taken for unfelt: a storage matrix that is found so may still be
            the whole's, if it is put into the inequality, but what is refused for the felt part is not for the whole.
    """
    whole = Parted(system, np.eye(system.order), np.zeros((0, 0)))
    if system.order == 0:
        return whole
    d = state_units(system)
    A, B, C = system.A * d / d[:, None], system.B / d[:, None], system.C * d
    N, L = _unobservable(A, C, tolerance), _unobservable(A.T, B.T, tolerance)
    if N.shape != L.shape or N.shape[1] == 0:
        return whole
    if float(np.linalg.svd(L.T @ N, compute_uv=False)[-1]) < _APART:
        return whole
    M = _orthogonal_to(L)
    back = np.linalg.inv(np.hstack([M, N]))
    P_u = storage_of_motion(back[M.shape[1] :] @ A @ N)
    if P_u is None:
        return whole
    reached = back[: M.shape[1]]
    return Parted(StateSpace(reached @ A @ M, reached @ B, C @ M, system.D), back / d, P_u)


def storage_of_motion(A: Matrix) -> Matrix | None:
    """Some P > 0 with A^T P A <= P, n x n, with as much room as there is; None where there is none to be had.

    Where A has independent eigenvectors V, P = (V V^*)^{-1}: every mode loses its own 1 - |z|^2. Otherwise, within
    the circle, the P of A^T P A - r^2 P = -I, with r half-way between A's spectral radius and 1 (in their squares).
    """
    values, vectors = np.linalg.eig(A)
    radius = float(np.max(np.abs(values), initial=0.0))
    if radius > 1.0 + _ROUNDING:
        return None
    if float(np.linalg.svd(vectors, compute_uv=False)[-1]) > _INDEPENDENT:
        inverse = np.linalg.inv(vectors)
        return symmetric_part((inverse.conj().T @ inverse).real)
    if radius >= 1.0 - _ROUNDING:
        return None
    r = np.sqrt((1.0 + radius**2) / 2.0)
    return symmetric_part(solve_discrete_lyapunov((A / r).T, np.eye(len(A))))


def _unobservable(A: Matrix, C: Matrix, tolerance: float) -> Matrix:
    """An orthonormal basis, n x d, of the greatest A-invariant subspace that C does not see."""
    sizes = np.linalg.norm(C, axis=1)
    rows = C[sizes > _ROUNDING * max(float(np.max(sizes, initial=0.0)), 1e-300)]  # each port in a unit of its own
    N = _kernel(rows / np.linalg.norm(rows, axis=1)[:, None], tolerance)
    least = tolerance * max(float(np.linalg.norm(A, 2)), 1e-300)
    while N.shape[1]:
        moved = A @ N
        leaving = moved - N @ (N.T @ moved)
        stay = _kernel(leaving, least)
        if stay.shape[1] == N.shape[1]:
            break
        N = np.linalg.qr(N @ stay)[0] if stay.shape[1] else N[:, :0]
    return N


def _orthogonal_to(L: Matrix) -> Matrix:
    """An orthonormal basis of the kernel of L^T, n x (n - d), for L of d orthonormal columns."""
    return np.asarray(np.linalg.svd(L, full_matrices=True)[0][:, L.shape[1] :])


def _kernel(M: Matrix, tolerance: float) -> Matrix:
    """An orthonormal basis of what M takes to less than ``tolerance`` of its length."""
    if M.shape[0] == 0:
        return np.eye(M.shape[1])
    _, values, right = np.linalg.svd(M, full_matrices=True)
    return np.asarray(right[int(np.sum(values > tolerance)) :].T)
