"""The simulated driver: a mass held by a simulated hand, exactly discretised.

One call of :meth:`SimulatedDriver.sample` is one period of the device's own time, however long the tick took
by the clock: a run in real time then has the very numbers of the simulation, and lateness is a figure in the
report rather than a disturbance of the experiment.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from manyhands.design.device import HeldDevice, held_device
from manyhands.nodes.bundle import DeviceBundle
from manyhands.nodes.device.intent import Intent, intent_from

Vector = NDArray[np.float64]


class SimulatedDriver:
    """A :class:`manyhands.nodes.device.driver.Driver` around a :class:`HeldDevice`."""

    def __init__(self, plant: HeldDevice, force: Sequence[Intent], motion: Sequence[Intent], T: float) -> None:
        """Start at rest in x = 0.

        Args:
            plant: the device with its hand, m axes.
            force: the intended force (N) of each axis as a function of time (s).
            motion: the intended motion (m) of each axis as a function of time (s).
            T: period, s.
        """
        m = plant.axes
        self._sampled = plant.sampled(T)
        self._damping, self._mass = plant.damping, plant.mass
        self._force, self._motion, self._T = tuple(force), tuple(motion), T
        self._state = np.zeros(self._sampled.order)
        self._f = np.zeros(m)
        self._work = 0.0
        self._m = m

    @property
    def axes(self) -> int:
        """Number of axes."""
        return self._m

    def sample(self, tick: int) -> Vector:
        """Advance to the instant kT under the force held since the last tick, and return x(k), m."""
        m, T = self._m, self._T
        if tick > 0:
            t = (tick - 1) * T
            intended = np.array([f(t) for f in self._force])
            goal = np.array([(q(t + T) - q(t)) / T for q in self._motion])
            before = self._state
            total = self._f + intended
            self._state = self._sampled.A @ before + self._sampled.B @ np.concatenate([total, goal])
            dx = self._state[:m] - before[:m]
            dv = self._state[m : 2 * m] - before[m : 2 * m]
            hand_impulse = total * T - self._damping * dx - self._mass * dv
            self._work = float(intended @ dx - goal @ hand_impulse)
        return self._state[:m].copy()

    def apply(self, f: Vector) -> None:
        """Hold f (N) over the next period."""
        self._f = f

    def release(self) -> None:
        """Hold zero force."""
        self._f = np.zeros(self._m)

    def intended_work(self) -> float:
        """Work of the intention over the last period, J."""
        return self._work


def simulated_driver(bundle: DeviceBundle) -> SimulatedDriver:
    """The simulated device and hand that a bundle describes."""
    hand = bundle.hand
    return SimulatedDriver(
        held_device(
            list(hand.mass),
            list(hand.damping),
            hand.operator,
            list(hand.hand_damping),
            list(hand.hand_stiffness),
        ),
        [intent_from(data) for data in hand.force],
        [intent_from(data) for data in hand.motion],
        bundle.common.period,
    )
