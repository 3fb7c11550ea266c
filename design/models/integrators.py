"""The transformed environment E_hat = Tz/(z-1) E with its integrators split off exactly.

E_hat has an integrator for each port. An integrator stores energy and is never strictly dissipative. With the static
stiffness E1 = E(1) and a stable E,

    E_hat(z) = T/(z-1) E1 + Rest(z),        Re T/(e^jw - 1) = -T/2,

so that E_hat is (-Phi_E)-ISP exactly when E1 = E1^T >= 0 and Rest + Phi_E - (T/2) E1 is positive real. Rest has
no integrator left: its inequality,

    [ A^T P A - P          A^T P B - C^T/2                                 ]
    [ B^T P A - C/2        B^T P B - (D + D^T)/2 - Phi_E + (T/2) E1        ]  <= 0,      P > 0,

(Lemma 1 of [Bianchini2010]_ for Rest = (A, B, C, D)) can be strict, and a certificate only has to store P.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from manyhands.design.errors import Infeasible
from manyhands.design.models.brief import brief_repr
from manyhands.design.models.statespace import Matrix, StateSpace, matrix, storage_inequality, symmetric_part
from manyhands.design.models.transfer import InDifferences, stated

_ASYMMETRY = 1e-9  # of E1, relative: a greater one is not the rounding of the given matrices


@dataclass(frozen=True, eq=False)
class Split:
    """E_hat = T/(z-1) E1 + Rest.

    Attributes:
        stiffness: E1, the static stiffness, m x m symmetric, N/m.
        rest: Rest, from velocity (m/s) to force (N), of order n, stable.
        units: of Rest's states, n powers of two, where they are the differences of rational functions divided by these
            (:mod:`manyhands.design.models.transfer`); None for all other states, which have none.
    """

    stiffness: Matrix
    rest: StateSpace
    units: Matrix | None = None

    __repr__ = brief_repr

    def environment(self, T: float) -> StateSpace:
        """E with its integrators again, in the state (eta, u_): Rest's state and the displacement of the tick before.

        A = [A_r -B_r/T; 0 0], B = [B_r/T; I], C = [C_r  E1 - D_r/T], D = D_r/T: stable also where masses drift freely.
        """
        rest, m = self.rest, self.rest.inputs
        return StateSpace(
            np.block([[rest.A, -rest.B / T], [np.zeros((m, rest.order + m))]]),
            np.vstack([rest.B / T, np.eye(m)]),
            np.hstack([rest.C, self.stiffness - rest.D / T]),
            rest.D / T,
        )

    def stated(self, P: Matrix) -> Matrix | InDifferences:
        """A storage matrix of Rest as a certificate states it.

        Raises:
            SolverFailure: an entry leaves the floats.
        """
        return P if self.units is None else stated(P, self.units)

    def dissipation(self, P: Matrix, Phi_E: Matrix, T: float) -> Matrix:
        """The matrix of the module's inequality, (n+m) x (n+m); E_hat is (-Phi_E)-ISP when it is <= 0."""
        return storage_inequality(self.rest, P, Phi=T / 2.0 * self.stiffness - Phi_E)


def split_system(E: StateSpace, T: float) -> Split:
    """Split E_hat for a stable discrete environment E, from displacement (m) to force (N), with period T (s).

    Rest = (A, -T A (I - A)^{-1} B, C, T D). Its state is the state of E minus the steady state of E under the
    displacement of the tick before.

    Raises:
        Infeasible: E is not stable, or its static stiffness E(1) is not symmetric or not positive semidefinite:
            E_hat is then passive at no level.
    """
    n, m = E.order, E.inputs
    radius = float(np.max(np.abs(np.linalg.eigvals(E.A)), initial=0.0))
    if radius >= 1.0:
        raise Infeasible(
            f"the environment is not stable: it has a pole of modulus {radius:.6g}; expected a damping of every mode"
        )
    steady = np.linalg.solve(np.eye(n) - E.A, E.B)
    stiffness = E.C @ steady + E.D
    # the size of the terms that cancel in E(1); of a free mass only their rounding remains
    scale = max(float(np.max(np.abs(E.C) @ np.abs(steady) + np.abs(E.D), initial=0.0)), 1e-300)
    if float(np.max(np.abs(stiffness - stiffness.T), initial=0.0)) > _ASYMMETRY * scale:
        raise Infeasible(
            "the environment's static stiffness E(1) is not symmetric, so that E_hat is passive at no level; expected "
            "static forces from an energy"
        )
    least = float(np.linalg.eigvalsh(symmetric_part(stiffness))[0]) if m else 0.0
    if least < -_ASYMMETRY * scale:
        raise Infeasible(
            f"the environment's static stiffness has the negative eigenvalue {least:.4g} N/m, so that E_hat is "
            "passive at no level: it pushes the tools away from rest"
        )
    rest = StateSpace(E.A, -T * E.A @ steady, E.C, T * E.D)
    return Split(matrix(symmetric_part(stiffness)), rest)


def delayed_split(split: Split, ticks: int, T: float) -> Split:
    """The split of E_hat z^-d, for d = ``ticks``, which is T/(z-1) E1 + [z^-d Rest - E1 T (z^-1 + ... + z^-d)].

    The states are those of Rest, then the velocities w_{k-1}, ..., w_{k-d}.
    """
    if ticks == 0:
        return split
    late = delayed_system(split.rest, ticks)
    C = np.array(late.C)
    C[:, split.rest.order :] -= T * np.tile(split.stiffness, ticks)
    units = None if split.units is None else np.concatenate([split.units, np.ones(ticks * split.rest.inputs)])
    return Split(split.stiffness, StateSpace(late.A, late.B, C, late.D), units)


def delayed_system(E: StateSpace, ticks: int) -> StateSpace:
    """E z^-d, for d = ``ticks``. The states are those of E, then the inputs of the last d ticks, the latest first."""
    n, m, d = E.order, E.inputs, ticks
    if d == 0:
        return E
    last = n + m * (d - 1)  # index of the input of d ticks ago
    A, B = np.zeros((n + m * d, n + m * d)), np.zeros((n + m * d, m))
    A[:n, :n] = E.A
    A[:n, last:] = E.B
    B[n : n + m] = np.eye(m)
    A[n + m :, n:last] = np.eye(m * (d - 1))
    C = np.hstack([E.C, np.zeros((E.outputs, m * (d - 1))), E.D])
    return StateSpace(A, B, C, np.zeros((E.outputs, m)))
