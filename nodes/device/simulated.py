"""The simulated driver: a mass held by a simulated hand, exactly discretised.

One call of :meth:`SimulatedDriver.sample` is one period of the device's own time, however long the tick took
by the clock: a run in real time then has the very numbers of the simulation, and lateness is a figure in the
report rather than a disturbance of the experiment.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from manyhands.design.device import HeldDevice, held_device
from manyhands.nodes.bundle import DeviceBundle
from manyhands.nodes.device.intent import Intent, intent_from
from manyhands.nodes.linear_map import Floats, dot, linear_map


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
        self._step = linear_map(np.hstack([sampled.A, sampled.B]))  # over (state, force, intended velocity)
        self._damping: Floats = plant.damping.tolist()
        self._mass: Floats = plant.mass.tolist()
        self._force, self._motion, self._T = tuple(force), tuple(motion), T
        self._state: Floats = [0.0] * sampled.order
        self._tick = 0
        self._work = 0.0
        self._f: Floats = [0.0] * m
        self._next: tuple[Floats, float] | None = (self._state, 0.0)
        self._m = m

    @property
    def axes(self) -> int:
        """Number of axes."""
        return self._m

    def sample(self, tick: int) -> Floats:
        """The displacement at the instant kT, m: where the force applied last has brought the device."""
        self._state, self._work = self._next if self._next is not None else self._advanced()
        self._tick, self._next = tick, None
        return self._state[: self._m]

    def apply(self, f: Sequence[float]) -> None:
        """Hold f (N) over the period that begins."""
        self._f, self._next = list(f), None

    def release(self) -> None:
        """Hold zero force."""
        self.apply([0.0] * self._m)

    def idle(self) -> None:
        """Compute where the force leads, before the next sample is due: there it costs the loop no latency."""
        self._next = self._advanced()

    def intended_work(self) -> float:
        """Work of the intention over the last period, J."""
        return self._work

    def _advanced(self) -> tuple[Floats, float]:
        """State and work of the intention at the end of the period, under the force that is held."""
        m, T, before = self._m, self._T, self._state
        t = self._tick * T
        intended = [force(t) for force in self._force]
        total = [held + own for held, own in zip(self._f, intended, strict=True)]
        goal = [(motion(t + T) - motion(t)) / T for motion in self._motion]
        after = self._step(before + total + goal)
        moved = [x - last for x, last in zip(after[:m], before[:m], strict=True)]
        work = dot(intended, moved)
        if any(goal):
            faster = [v - last for v, last in zip(after[m : 2 * m], before[m : 2 * m], strict=True)]
            lost = zip(total, self._damping, moved, self._mass, faster, strict=True)
            work -= dot(goal, [force * T - b * dx - mass * dv for force, b, dx, mass, dv in lost])
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
