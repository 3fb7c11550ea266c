"""A coupling block's tick without its I/O: V_i, seen from x and f_v of its own ports.

    p(k) = x(k) + C_V xi(k)                       the tool's position without force
    xi(k+1) = A_V xi(k) + B_V f_v(k)

The environment, which knows D_V, completes x_e = p + D_V f_v. The block promises that V_hat,i is
Delta_V,i-OSP, from f_v to the backward difference of (V_i - K_i) f_v ((7) of [Bianchini2010]_).

A force beyond the limits of its devices is clipped before it is sent on and absorbed, so that xi follows the force that
is applied. In such a tick the environment's force differs from the device's, and the certificate does not cover it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from manyhands.design.models.statespace import StateSpace
from manyhands.nodes.kernel.arithmetic import Floats, Saturation, dot, linear_map, minus, plus
from manyhands.nodes.kernel.passivity import Ledger

Vector = NDArray[np.float64]


class CouplingCore:
    """The state of one coupling block between ticks.

    Attributes:
        ledger: its energy ledger; None when the session is not certified, so that the block promises nothing.
    """

    def __init__(
        self, block: StateSpace, K: Vector, level: Vector | None, T: float, force_limits: Sequence[float]
    ) -> None:
        """Start at rest.

        Args:
            block: as of :meth:`change`.
            K: likewise.
            level: likewise.
            T: period, s.
            force_limits: the greatest force of each port's device, N.
        """
        self._saturation, self._T = Saturation(force_limits), T
        self.ledger: Ledger | None = None
        self.change(block, K, level)

    def change(self, block: StateSpace, K: Vector, level: Vector | None) -> None:
        """Go on at rest as another block, with the ledger so far; call this only where no force is applied.

        Args:
            block: (A_V, B_V, C_V, D_V) of the block, force (N) to displacement (m).
            K: the block of the loop transformation's K, m/N.
            level: Delta_V,i, N*s/m, or None.
        """
        n, m = self._n, self._m = block.order, block.outputs
        xi = np.hstack([block.A, block.B])  # rows over (xi, f_v)
        self._step = linear_map(np.vstack([xi, block.C @ xi, np.hstack([block.C, block.D - K])]))
        self._level = None if level is None else linear_map(level)
        self._xi: Floats = [0.0] * n
        self._offset: Floats = [0.0] * m  # C_V xi
        self._y: Floats = [0.0] * m  # (V - K) f_v of the tick before, m
        self.ledger = None if level is None else self.ledger or Ledger()

    def free_position(self, x: Floats) -> Floats:
        """p(k), m, from the devices' displacement x(k), m."""
        return plus(x, self._offset)

    @property
    def saturated(self) -> int:
        """Ticks whose force was clipped."""
        return self._saturation.ticks

    def limited(self, f: Floats) -> Floats:
        """f_v(k) of the environment, N, clipped to the limits: the force to send on and to absorb."""
        return self._saturation.clip(f)

    def absorb(self, f: Floats) -> None:
        """Take the force f_v(k), N, that is applied at the block's ports, keep the ledger and step to the next tick."""
        n, m = self._n, self._m
        following = self._step([*self._xi, *f])  # xi and C_V xi of the next tick, (V - K) f_v of this one
        if self.ledger is not None and self._level is not None:
            T, y = self._T, following[n + m :]
            w = [step / T for step in minus(y, self._y)]
            self.ledger.enter(T * (dot(f, w) - dot(w, self._level(w))))
            self._y = y
        self._xi = following[:n]
        self._offset = following[n : n + m]
