"""Coordinates in which a solver can be trusted further: storage near I, gains near 1.

States psi' = X psi and ports u' = S^{-1} u, y' = S y, with S diagonal, leave the exchanged power y^T u as it is:

    A' = X A X^{-1},  B' = X B S,  C' = S C X^{-1},  D' = S D S,
    P' = X^{-T} P X^{-1},  Delta' = S^{-1} Delta S^{-1},  Phi' = S Phi S.

X comes from P_g = W_c^{-1} # W_o, the geometric mean of the Gramians. It has the unit of an energy over the square of
a state, whatever the units of states and ports, and P_g = X^T X is I in the new states. Once some storage
matrix P is known, its own factor is better still (:func:`with_storage`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import matrix_balance, solve_discrete_lyapunov

from manyhands.design.statespace import Matrix, StateSpace, symmetric_part

_INSIDE = 0.9995  # the spectral radius to which A is shrunk, where greater, for the Gramians to exist
_UNSEEN = 1e-9  # part of the largest eigenvalue of a Gramian below which a direction counts as unseen


@dataclass(frozen=True, eq=False)
class Scaled:
    """A discrete system in scaled coordinates.

    Attributes:
        system: the scaled one.
        X: n x n, scaled states = X states.
        S: the diagonal of S, m entries.
    """

    system: StateSpace
    X: Matrix
    S: Matrix

    def output_level(self, Delta: Matrix) -> Matrix:
        """Delta' of a level Delta, m x m."""
        return np.asarray(Delta / np.outer(self.S, self.S))

    def input_level(self, Phi: Matrix) -> Matrix:
        """Phi' of a level Phi, m x m."""
        return np.asarray(Phi * np.outer(self.S, self.S))

    def storage(self, P: Matrix) -> Matrix:
        """P of a storage matrix P' found in scaled states."""
        return symmetric_part(self.X.T @ P @ self.X)


def scaled(system: StateSpace) -> Scaled:
    """A discrete ``system`` in ports and states of its own size."""
    d = state_units(system)
    system = StateSpace(system.A * d / d[:, None], system.B / d[:, None], system.C * d, system.D)
    controllable, observable = _gramians(system)
    through = np.abs(np.diag(system.D))
    energy_in = np.sqrt(np.maximum(np.diag(system.B.T @ observable @ system.B), 0.0))
    energy_out = np.sqrt(np.maximum(np.diag(system.C @ controllable @ system.C.T), 0.0))
    gain = np.maximum(through, np.sqrt(energy_in * energy_out))
    gain = np.where(gain > 0.0, gain, max(float(np.max(np.abs(system.D), initial=0.0)), float(np.max(gain)), 1e-300))
    S = np.exp2(-np.round(np.log2(np.where(gain > 1e-290, gain, 1.0)) / 2.0))
    own = _changed(system, _factor(_mean(controllable, observable)), np.asarray(S))
    return Scaled(own.system, own.X / d, own.S)


def with_storage(system: StateSpace, P: Matrix, S: Matrix) -> Scaled:
    """A discrete ``system`` in states where its positive definite ``P`` is I, and in ports scaled by diag(``S``).

    Raises:
        numpy.linalg.LinAlgError: P is not positive definite.
    """
    return _changed(system, np.asarray(np.linalg.cholesky(symmetric_part(P)).T), S)


def _changed(system: StateSpace, X: Matrix, S: Matrix) -> Scaled:
    inverse = np.linalg.inv(X)
    return Scaled(
        StateSpace(
            X @ system.A @ inverse,
            X @ system.B * S,
            S[:, None] * system.C @ inverse,
            S[:, None] * system.D * S,
        ),
        X,
        S,
    )


def state_units(system: StateSpace) -> Matrix:
    """Powers of two d, n of them: in states psi / d the rows and columns of [A B; C 0] are of a size.

    Without them the equations of the Gramians of a system in extreme units are too ill-conditioned to be solved.
    """
    n, m = system.order, system.inputs
    joined = np.block([[system.A, system.B], [system.C, np.zeros((system.outputs, m))]])
    _, (d, _) = matrix_balance(joined, permute=False, separate=True)
    return np.asarray(d[:n], dtype=np.float64)


def _gramians(system: StateSpace) -> tuple[Matrix, Matrix]:
    """Controllability and observability Gramians, of the system with A shrunk into the circle where need be."""
    n = system.order
    if n == 0:
        return np.zeros((0, 0)), np.zeros((0, 0))
    radius = float(np.max(np.abs(np.linalg.eigvals(system.A))))
    A = system.A * (_INSIDE / max(radius, _INSIDE))
    return (
        symmetric_part(solve_discrete_lyapunov(A, system.B @ system.B.T)),
        symmetric_part(solve_discrete_lyapunov(A.T, system.C.T @ system.C)),
    )


def _mean(controllable: Matrix, observable: Matrix) -> Matrix:
    """W_c^{-1} # W_o = W_c^{-1/2} (W_c^{1/2} W_o W_c^{1/2})^{1/2} W_c^{-1/2}, unseen directions lifted."""
    if controllable.size == 0:
        return controllable
    # one unit for each state first, so that "unseen" does not depend on units
    d = np.where(np.diag(controllable) > 0.0, np.diag(controllable), 1.0) ** -0.5
    root = _root(controllable * np.outer(d, d))
    middle = _root(root @ (observable / np.outer(d, d)) @ root)
    inverse = np.linalg.inv(root)
    return symmetric_part(inverse @ middle @ inverse) * np.outer(d, d)


def _root(M: Matrix) -> Matrix:
    """The square root of a positive semidefinite matrix, with eigenvalues not below the floor of unseen directions."""
    values, vectors = np.linalg.eigh(symmetric_part(M))
    floor = _UNSEEN * max(float(values[-1]), 0.0) if values[-1] > 0.0 else 1.0
    return np.asarray(vectors * np.sqrt(np.maximum(values, floor)) @ vectors.T)


def _factor(P: Matrix) -> Matrix:
    """X with X^T X = P."""
    return np.asarray(np.linalg.cholesky(P).T) if P.size else P
