"""Simulated devices: a mass held by a hand, discretised exactly, in its own time (:class:`Plant`), and drivers for it.

One call of :meth:`PlantDriver.sample` is one period of the device's own time, however long the tick took by the clock.
So a run in real time has exactly the numbers of the simulation. A late tick is then a figure in the report, and does
not disturb the experiment.

The hand of a :class:`SimulatedDriver` has an intention that is a function of time.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from manyhands.design.models.device import HeldDevice, held_device
from manyhands.design.models.statespace import StateSpace
from manyhands.nodes.arithmetic import Floats, dot, linear_map
from manyhands.nodes.bundle import SimulatedHand
from manyhands.nodes.device.intent import Intent, intent_from
from manyhands.protocol.clock import Instant


class Intention(NamedTuple):
    """The hand's intended force (N) and velocity (m/s), one entry for each axis, both constant over one period."""

    force: Floats
    velocity: Floats


class Plant:
    """A sampled :class:`HeldDevice`: the step of its state over one period. It keeps no state of its own."""

    def __init__(self, device: HeldDevice, T: float) -> None:
        """Sample ``device`` with the period ``T``, s."""
        sampled = device.sampled(T)
        self.axes, self.order = device.axes, sampled.order
        self._step = linear_map(np.hstack([sampled.A, sampled.B]))  # over (state, force, intended velocity)
        self._damping: Floats = device.damping.tolist()
        self._mass: Floats = device.mass.tolist()
        self._T = T

    def holding(self, x: Floats, v: Floats) -> Floats:
        """The state of a device at x (m) with the velocity v (m/s), whose hand is at rest on it, its spring slack."""
        return [*x, *v, *[0.0] * (self.order - 2 * self.axes)]

    def after(self, before: Floats, f: Floats, intention: Intention) -> tuple[Floats, float]:
        """Step over one period.

        Args:
            before: the state at its beginning.
            f: the coupling's force over it, N.
            intention: the hand's intention over it.

        Returns:
            The state at its end, and the intention's work over it, J.
        """
        m, T = self.axes, self._T
        total = [held + own for held, own in zip(f, intention.force, strict=True)]
        goal = intention.velocity
        after = self._step(before + total + goal)
        moved = [x - last for x, last in zip(after[:m], before[:m], strict=True)]
        work = dot(intention.force, moved)
        if any(goal):
            faster = [v - last for v, last in zip(after[m : 2 * m], before[m : 2 * m], strict=True)]
            lost = zip(total, self._damping, moved, self._mass, faster, strict=True)
            work -= dot(goal, [force * T - b * dx - mass * dv for force, b, dx, mass, dv in lost])
        return after, work


class PlantDriver(ABC):
    """A :class:`manyhands.nodes.device.drivers.Driver` of a plant; subclasses give the hand's intention."""

    def __init__(self, plant: Plant) -> None:
        """Start at rest in x = 0."""
        m = self._m = plant.axes
        self._plant = plant
        self._zero: Floats = [0.0] * m
        self._state: Floats = plant.holding(self._zero, self._zero)
        self._tick = 0
        self._work = 0.0
        self._f = self._zero
        self._intention: Intention | None = None  # over the period that has begun, once it is known
        self._next: tuple[Floats, float] | None = (self._state, 0.0)

    @property
    def axes(self) -> int:
        """Number of axes."""
        return self._m

    def sample(self, tick: int, at: Instant) -> Floats:
        """The displacement at the instant kT, m: where the force of the last period has moved the device."""
        self._state, self._work = self._next if self._next is not None else self._advanced()
        self._tick, self._next, self._intention = tick, None, None
        return self._state[: self._m]

    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> Floats:
        """Hold f (N) over the period that begins; returns the displacement of the last sample, m."""
        self._f, self._next = list(map(float, f)), None  # a float of numpy is slow in the products
        return self._state[: self._m]

    def release(self, at: Instant) -> Floats:
        """Hold zero force."""
        return self.apply(self._zero, at)

    def idle(self, due: Instant) -> None:
        """Compute the next state before its sample is due, when this costs the loop no latency."""
        self._next = self._advanced()

    def intended_work(self) -> float:
        """Work of the intention over the last period, J."""
        return self._work

    def figures(self) -> Mapping[str, float]:
        """No figures."""
        return {}

    def close(self) -> None:
        """Hold zero force; there are no files or sockets to close."""
        self._f, self._next = self._zero, None

    def _advanced(self) -> tuple[Floats, float]:
        """The state at the end of the period under the present force, and the work of the intention."""
        if self._intention is None:
            self._intention = self._intend(self._tick)
        return self._plant.after(self._state, self._f, self._intention)

    @abstractmethod
    def _intend(self, tick: int) -> Intention:
        """The hand's intention over the period from ``tick`` on; called once a period."""


def device_of(hand: SimulatedHand) -> HeldDevice:
    """The device with its hand that a bundle describes.

    Raises:
        ValueError: a mass is not positive.
    """
    return held_device(
        list(hand.mass), list(hand.damping), hand.operator, list(hand.hand_damping), list(hand.hand_stiffness)
    )


def bare_device_of(hand: SimulatedHand) -> HeldDevice:
    """The same device with an open hand: the mass of both, and the device's own damping.

    Raises:
        ValueError: a mass is not positive.
    """
    m = hand.axes
    return held_device(list(hand.mass), list(hand.damping), StateSpace.static(np.zeros((m, m))), [0.0] * m, [0.0] * m)


class SimulatedDriver(PlantDriver):
    """A :class:`manyhands.nodes.device.drivers.Driver` whose hand has an intention that is a function of time."""

    def __init__(self, device: HeldDevice, force: Sequence[Intent], motion: Sequence[Intent], T: float) -> None:
        """Start at rest in x = 0.

        Args:
            device: the device with its hand, m axes.
            force: the intended force (N) of each axis as a function of time (s).
            motion: the intended motion (m) of each axis as a function of time (s).
            T: period, s.
        """
        super().__init__(Plant(device, T))
        self._force, self._motion, self._T = tuple(force), tuple(motion), T

    def _intend(self, tick: int) -> Intention:
        T = self._T
        t = tick * T
        goal = [(motion(t + T) - motion(t)) / T for motion in self._motion]
        return Intention([force(t) for force in self._force], goal)


def simulated_driver(hand: SimulatedHand, T: float) -> SimulatedDriver:
    """The driver of the simulated device and hand that a bundle describes; ``T``: period, s.

    Raises:
        ValueError: a mass is not positive, or an intention is not usable.
    """
    forces, motions = ([intent_from(data) for data in every] for every in (hand.force, hand.motion))
    return SimulatedDriver(device_of(hand), forces, motions, T)
