"""A device's tick without its I/O: what it knows of x and f_v, and its energy ledger.

The device with its hand promises that G_hat is (share Delta_D)-OSP, from force F to

    y(k) = (x(k) - x(k-1))/T + K (F(k) - F(k-1))/T,    K = kappa T Delta_D^{-1}    ((7)-(9) of [Bianchini2010]_),

with share = 1 and kappa = 1/2 without delay, and what :mod:`manyhands.design.delay` gives for a delay inside the tick.

What the hand *intends* is no part of that promise; where it is known, as for a simulated hand, the work
that it did is added to the ledger.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from manyhands.nodes.ledger import Ledger

Vector = NDArray[np.float64]

STALE_TICKS = 5
"""A device that has waited this many periods for its force applies zero force until one comes."""


class DeviceCore:
    """The state of one device between ticks.

    Attributes:
        ledger: its energy ledger.
        speed: Euclidean norm of the backward-difference velocity at the last tick, m/s.
        peak_speed: the greatest speed so far, m/s.
    """

    def __init__(self, level: Vector, K: Vector, T: float) -> None:
        """Start at rest in x = 0.

        Args:
            level: share Delta_D of this device, m_i x m_i, N*s/m.
            K: kappa T Delta_D^{-1}, m_i x m_i, m/N.
            T: period, s.
        """
        self._level, self._T = level, T
        self._K_over_T = K / T
        self._x = np.zeros(level.shape[0])
        self._f = np.zeros(level.shape[0])
        self._velocity = np.zeros(level.shape[0])
        self.ledger = Ledger()
        self.speed = 0.0
        self.peak_speed = 0.0

    def sample(self, x: Vector) -> None:
        """Take the displacement x(k), m."""
        self._velocity = (x - self._x) / self._T
        self._x = x
        self.speed = math.sqrt(self._velocity @ self._velocity)
        self.peak_speed = max(self.peak_speed, self.speed)

    def apply(self, f: Vector, intended_work: float) -> None:
        """Take the force f_v(k) that is applied from now on, N.

        Args:
            f: f_v(k).
            intended_work: what the hand's intention did since the last sample, J; 0 where it is unknown.
        """
        y = self._velocity + self._K_over_T @ (f - self._f)
        self.ledger.enter(self._T * float(f @ y - y @ self._level @ y) + intended_work)
        self._f = f
