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
        m, sampled = plant.axes, plant.sampled(T)
        self._step = np.ascontiguousarray(np.hstack([sampled.A, sampled.B]))  # over (state, force, intended velocity)
        self._known = np.zeros(self._step.shape[1])  # filled in place
        self._order = sampled.order
        self._damping, self._mass = plant.damping, plant.mass
        self._force, self._motion, self._T = tuple(force), tuple(motion), T
        self._state = np.zeros(sampled.order)
        self._tick = 0
        self._work = 0.0
        self._f = np.zeros(m)
        self._next: tuple[Vector, float] | None = (self._state, 0.0)
        self._m = m

    @property
    def axes(self) -> int:
        """Number of axes."""
        return self._m

    def sample(self, tick: int) -> Vector:
        """The displacement at the instant kT, m: where the force applied last has brought the device."""
        self._state, self._work = self._next if self._next is not None else self._advanced()
        self._tick, self._next = tick, None
        return self._state[: self._m].copy()

    def apply(self, f: Vector) -> None:
        """Hold f (N) over the period that begins."""
        self._f, self._next = f, None

    def release(self) -> None:
        """Hold zero force."""
        self.apply(np.zeros(self._m))

    def idle(self) -> None:
        """Compute where the force leads, before the next sample is due: there it costs the loop no latency."""
        self._next = self._advanced()

    def intended_work(self) -> float:
        """Work of the intention over the last period, J."""
        return self._work

    def _advanced(self) -> tuple[Vector, float]:
        """State and work of the intention at the end of the period, under the force that is held."""
        m, n, T, before = self._m, self._order, self._T, self._state
        t = self._tick * T
        intended = np.array([force(t) for force in self._force])
        self._known[:n] = before
        total, goal = self._known[n : n + m], self._known[n + m :]
        total[:] = self._f + intended
        for axis, motion in enumerate(self._motion):
            goal[axis] = (motion(t + T) - motion(t)) / T
        after = self._step @ self._known
        change = after[: 2 * m] - before[: 2 * m]
        work = float(intended @ change[:m])
        if goal.any():
            hand_impulse = total * T - self._damping * change[:m] - self._mass * change[m:]
            work -= float(goal @ hand_impulse)
        return after, work


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
