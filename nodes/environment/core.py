"""The environment's tick without its I/O: it closes the algebraic loop and never sees x.

From the free tool positions p(k) of all ports and the couplings' feedthrough D_V,

    f_v(k) = -(I + D_E D_V)^{-1} (C_E eta(k) + D_E p(k)),
    x_e(k) = p(k) + D_V f_v(k),     eta(k+1) = A_E eta(k) + B_E x_e(k).

All three are linear in (eta, p): one product with a matrix made beforehand gives them at once.

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
        n, m = E.order, E.inputs
        f = -np.linalg.solve(loop, np.hstack([E.C, E.D]))  # rows over (eta, p)
        x_e = np.hstack([np.zeros((m, n)), np.eye(m)]) + D_V @ f
        eta = np.hstack([E.A, np.zeros((n, m))]) + E.B @ x_e
        self._step = np.ascontiguousarray(np.vstack([f, x_e, eta]))
        self._Phi, self._T, self._m, self._n = Phi_E, T, m, n
        self._known = np.zeros(n + m)  # (eta, p), filled in place
        self._x_e = np.zeros(m)
        self._next = np.zeros(2 * m + n)  # (f, x_e, eta of the next tick)
        self.ledger = None if Phi_E is None else Ledger()

    def react(self, p: Vector) -> Vector:
        """f_v(k), N, for the free tool positions p(k), m."""
        self._known[self._n :] = p
        self._next = self._step @ self._known
        return self._next[: self._m]

    def settle(self) -> None:
        """Step to the next tick and keep the ledger: what can wait until the forces are on their way."""
        m = self._m
        f, x_e = self._next[:m], self._next[m : 2 * m]
        if self.ledger is not None and self._Phi is not None:
            w = (x_e - self._x_e) / self._T
            self.ledger.enter(self._T * float(-(w @ f) + w @ self._Phi @ w))
        self._known[: self._n] = self._next[2 * m :]
        self._x_e = x_e
