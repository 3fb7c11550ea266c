"""The environment's tick without its I/O: it closes the algebraic loop and never sees x.

From the free tool positions p(k) of all ports and the couplings' feedthrough D_V,

    f_v(k) = -(I + D_E D_V)^{-1} (C_E eta(k) + D_E p(k)),
    x_e(k) = p(k) + D_V f_v(k),     eta(k+1) = A_E eta(k) + B_E x_e(k).

It promises that E_hat is (-Phi_E)-ISP: from the tool velocity w to -f_v, T (w^T (-f_v) + w^T Phi_E w) sums to
no less than zero.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from manyhands.design.statespace import StateSpace
from manyhands.nodes.ledger import Ledger

Vector = NDArray[np.float64]


class EnvironmentCore:
    """The state of the environment between ticks.

    Attributes:
        ledger: its energy ledger; None when the session is not certified.
    """

    def __init__(self, E: StateSpace, D_V: Vector, Phi_E: Vector | None, T: float) -> None:
        """Start at rest, all tools at 0.

        Args:
            E: (A_E, B_E, C_E, D_E), tool displacement (m) to force (N), m ports.
            D_V: the couplings' feedthrough, m x m, m/N, as told at the handshake.
            Phi_E: the environment's level, m x m, N*s/m, or None.
            T: period, s.

        Raises:
            ValueError: the algebraic loop has no unique solution.
        """
        loop = np.eye(E.outputs) + E.D @ D_V
        if not np.linalg.cond(loop) < 1e12:
            raise ValueError("I + D_E D_V is singular: force and tool position have no unique solution in a tick")
        self._E, self._D_V, self._Phi, self._T = E, D_V, Phi_E, T
        self._from_state = -np.linalg.solve(loop, E.C)
        self._from_tool = -np.linalg.solve(loop, E.D)
        self._eta = np.zeros(E.order)
        self._x_e = np.zeros(E.inputs)
        self.ledger = None if Phi_E is None else Ledger()

    def react(self, p: Vector) -> Vector:
        """f_v(k), N, for the free tool positions p(k), m; steps to the next tick."""
        f: Vector = self._from_state @ self._eta + self._from_tool @ p
        x_e = p + self._D_V @ f
        if self.ledger is not None and self._Phi is not None:
            w = (x_e - self._x_e) / self._T
            self.ledger.enter(self._T * float(-(w @ f) + w @ self._Phi @ w))
        self._eta = self._E.A @ self._eta + self._E.B @ x_e
        self._x_e = x_e
        return f
