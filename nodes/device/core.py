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
from manyhands.nodes.linear_map import Floats, dot, linear_map

Vector = NDArray[np.float64]


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
        self._T = T
        self.change(level, K)
        self._x: Floats = [0.0] * level.shape[0]
        self._f, self._velocity = self._x, self._x
        self.ledger = Ledger()
        self.speed = 0.0
        self.peak_speed = 0.0

    def change(self, level: Vector, K: Vector) -> None:
        """From now on another promise; to be called where no force is applied, for there both begin at rest."""
        self._level, self._K_over_T = linear_map(level), linear_map(K / self._T)

    def sample(self, x: Floats) -> None:
        """Take the displacement x(k), m; the list is kept until the next."""
        T = self._T
        self._velocity = [(at - last) / T for at, last in zip(x, self._x, strict=True)]
        self._x = x
        self.speed = speed = math.hypot(*self._velocity)
        if speed > self.peak_speed:
            self.peak_speed = speed

    def apply(self, f: Floats, intended_work: float) -> None:
        """Take the force f_v(k) that is applied from now on, N.

        Args:
            f: f_v(k); the list is kept until the next.
            intended_work: what the hand's intention did since the last sample, J; 0 where it is unknown.
        """
        change = self._K_over_T([force - last for force, last in zip(f, self._f, strict=True)])
        y = [v + part for v, part in zip(self._velocity, change, strict=True)]
        self.ledger.enter(self._T * (dot(f, y) - dot(y, self._level(y))) + intended_work)
        self._f = f
