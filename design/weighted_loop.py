"""Transparency of the coupling: the two H-infinity problems of section 5 of [Bianchini2010]_.

loop shaping    minimise ||W_1 E V W_2||_inf                                     (24)
closed loop     minimise ||W_1 (F(E,V) - E) W_2||_inf,   F = (I + E V)^{-1} E    (23)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from manyhands.design.statespace import Matrix, StateSpace, frequency_response
from manyhands.design.weights import Filter

ComplexArray = NDArray[np.complex128]
Objective = Literal["loop-shaping", "closed-loop"]


@dataclass(frozen=True)
class Transparency:
    """What the coupling is optimised for.

    Attributes:
        objective: "loop-shaping" (24) or "closed-loop" (23).
        W1: weight on the force side, times the identity.
        W2: weight on the hand's side, times the identity.
    """

    objective: Objective
    W1: Filter
    W2: Filter

    def __post_init__(self) -> None:
        if self.objective not in ("loop-shaping", "closed-loop"):
            raise ValueError(f"objective: found {self.objective!r}, expected 'loop-shaping' or 'closed-loop'")


def weighted(loop_E: StateSpace, V: StateSpace, aim: Transparency) -> StateSpace:
    """W_1 E V W_2, or W_1 (F(E,V) - E) W_2 = -W_1 E V (I + E V)^{-1} E W_2, as a system.

    Both are series connections, states in the order in which the signal passes,

        loop shaping    W_2, V, E, W_1
        closed loop     W_2, E, L, W_1,    L = -E V (I + E V)^{-1} with the states of V, then those of a second E:

            r = R (y - C_E eta - D_E C_V xi),   R = (I + D_E D_V)^{-1},   u = C_V xi + D_V r,
            xi+ = A_V xi + B_V r,   eta+ = A_E eta + B_E u,   output r - y,

    with the realisations of E and V as given and those of W_1, W_2 from :meth:`Filter.realisation`.

    Args:
        loop_E: E, displacement (m) to force (N), m x m.
        V: coupling, force (N) to displacement (m), m x m.
        aim: objective and weights.

    Raises:
        ValueError: I + D_E D_V is singular (closed loop), or sizes differ.
    """
    m = loop_E.inputs
    if (loop_E.outputs, V.inputs, V.outputs) != (m, m, m):
        raise ValueError(f"expected E and V of the same {m} ports, found {loop_E.outputs}, {V.inputs}, {V.outputs}")
    before, after = aim.W2.realisation(m), aim.W1.realisation(m)
    if aim.objective == "loop-shaping":
        return _series(before, V, loop_E, after)
    return _series(before, loop_E, _lost(loop_E, V), after)


def _lost(E: StateSpace, V: StateSpace) -> StateSpace:
    """L = (I + E V)^{-1} - I."""
    m, n_V, n_E = E.inputs, V.order, E.order
    inner = np.eye(m) + E.D @ V.D
    if not np.linalg.norm(inner, -2) > 1e-12 * (1.0 + np.linalg.norm(E.D @ V.D, 2)):
        raise ValueError("I + D_E D_V is singular: force and tool position have no unique solution in a tick")
    R = np.linalg.inv(inner)
    r = np.hstack([-R @ E.D @ V.C, -R @ E.C, R])  # over (xi, eta, y)
    u = V.D @ r
    u[:, :n_V] += V.C
    xi, eta = V.B @ r, E.B @ u
    xi[:, :n_V] += V.A
    eta[:, n_V : n_V + n_E] += E.A
    r[:, n_V + n_E :] -= np.eye(m)
    state = np.vstack([xi, eta])
    return StateSpace(state[:, : n_V + n_E], state[:, n_V + n_E :], r[:, : n_V + n_E], r[:, n_V + n_E :])


def _series(*systems: StateSpace) -> StateSpace:
    """The first system's output into the second's input, and so on; states in that order."""
    total = systems[0]
    for s in systems[1:]:
        total = StateSpace(
            np.block([[total.A, np.zeros((total.order, s.order))], [s.B @ total.C, s.A]]),
            np.vstack([total.B, s.B @ total.D]),
            np.hstack([s.D @ total.C, s.C]),
            s.D @ total.D,
        )
    return total


@dataclass(frozen=True, eq=False)
class WeightedLoop:
    """The weighted response and its derivative with respect to V, frequency by frequency.

    Attributes:
        E: the environment, displacement to force.
        aim: objective and weights.
    """

    E: StateSpace
    aim: Transparency

    def factors(self, V: ComplexArray, angles: Matrix) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """The weighted response G and L, R with dG = L dV R, each angles x m x m.

        Loop shaping: G = w E V, dG = w E dV with w = W_1 W_2. Closed loop: dF = -F dV F, so dG = -w F dV F.

        Args:
            V: response of the coupling, angles x m x m.
            angles: theta in rad.
        """
        z = np.exp(1j * angles)
        w = (self.aim.W1.response(z) * self.aim.W2.response(z))[:, None, None]
        E = frequency_response(self.E, angles)
        I = np.eye(self.E.inputs, dtype=np.complex128)
        if self.aim.objective == "loop-shaping":
            return w * E @ V, w * E, np.asarray(np.broadcast_to(I, E.shape))
        F: ComplexArray = np.asarray(np.linalg.solve(I + E @ V, E), dtype=np.complex128)
        return -w * F @ V @ E, -w * F, F  # F - E = -F V E

    def poles(self) -> ComplexArray:
        """Poles of E and of the weights: where the response changes fast."""
        filters = (self.aim.W1.den, self.aim.W2.den)
        return np.concatenate([np.linalg.eigvals(self.E.A), *(np.roots(den) for den in filters)]).astype(np.complex128)

    def poles_with(self, V: StateSpace) -> ComplexArray:
        """The poles that the coupling brings: its own, or those of F(E,V)."""
        A = V.A if self.aim.objective == "loop-shaping" else _lost(self.E, V).A
        return np.linalg.eigvals(A).astype(np.complex128)
