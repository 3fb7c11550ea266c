"""Which driver a device's bundle asks for.

The driver of a recorded hand: it moves the device as it once moved, whatever force acts on it.

A hand that does not yield is a passive hand all the same: seen from the frame of the recorded motion r, the device
stays where it is. It is the limit of the simulated hand (:mod:`manyhands.design.models.device`) for a stiffness k_h
without bound, on a device without mass, and so is the work of its intention, v_m = dx/T:

    W(k) = -f_v(k-1)^T dx + dx^T Delta_D dx / T,    dx = r(k) - r(k-1), r(-1) = 0.

With it the ledger of G_hat, which is (share Delta_D)-OSP with K = kappa T Delta_D^-1, comes to

    f_v^T K f_v / 2 + sum of  a g^T K g + 2 a g^T dx + (1 - share) dx^T Delta_D dx / T,

a = 1/2 - share kappa, g = f_v(k) - f_v(k-1), and is never below 0 (docs/decisions/0023-trace-driver.md). Without a
delay inside the tick the sum is 0, and what is left is the ledger of a device that does not move in its frame.

What the loop asks of a force-feedback device, whichever it is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from manyhands.nodes.arithmetic import Floats, dot, linear_map
from manyhands.nodes.bundle import BrowserHand, DeviceBundle, RecordedMotion, SimulatedHand
from manyhands.nodes.device.intent import SampledSignal
from manyhands.nodes.device.pointer import BrowserDriver, pointer_of
from manyhands.nodes.device.simulated import simulated_driver


class TraceDriver:
    """A :class:`manyhands.nodes.device.drivers.Driver` that plays a motion; at its end it stays there."""

    def __init__(self, motion: RecordedMotion, T: float) -> None:
        """Be at rest in 0 before the first sample.

        Args:
            motion: what was recorded, linear between its samples.
            T: period, s.

        Raises:
            ValueError: the motion is none.
        """
        self._traces = [SampledSignal(motion.times, axis) for axis in motion.values]
        self._friction = linear_map(motion.damping / T)  # Delta_D / T
        self._T, self._tick = T, 0
        self._f: Floats = [0.0] * len(self._traces)
        self._x, self._next = self._f, self._at(0)
        self._work = 0.0

    @property
    def axes(self) -> int:
        """Number of axes."""
        return len(self._traces)

    def sample(self, tick: int) -> Floats:
        """The displacement r(kT), m."""
        x = self._next if tick == self._tick else self._at(tick)
        moved = [at - last for at, last in zip(x, self._x, strict=True)]
        self._work = dot(moved, self._friction(moved)) - dot(self._f, moved)
        self._x, self._next, self._tick = x, x, tick
        return x.copy()

    def apply(self, f: Sequence[float]) -> None:
        """Bear f (N) over the period that begins."""
        self._f = list(map(float, f))

    def release(self) -> None:
        """Bear no force."""
        self._f = [0.0] * len(self._traces)

    def idle(self) -> None:
        """Look up where the motion goes next."""
        if self._next is self._x:
            self._tick += 1
            self._next = self._at(self._tick)

    def intended_work(self) -> float:
        """Work of the hand between the last two samples, J; see above."""
        return self._work

    def figures(self) -> Mapping[str, float]:
        """Nothing to tell."""
        return {}

    def close(self) -> None:
        """Nothing is open."""

    def _at(self, tick: int) -> Floats:
        t = tick * self._T
        return [trace(t) for trace in self._traces]


class Driver(Protocol):
    """A force-feedback device: displacement out, force in, one of each a tick."""

    @property
    def axes(self) -> int:
        """Number of axes."""
        ...

    def sample(self, tick: int) -> Sequence[float]:
        """The displacement x(k), m, one entry an axis, at this moment."""
        ...

    def apply(self, f: Sequence[float]) -> None:
        """Exert the force f (N) and hold it until the next call."""
        ...

    def release(self) -> None:
        """Exert no force: what a device does that hears nothing."""
        ...

    def idle(self) -> None:
        """The tick's force is applied and the next sample is not yet due: do what has been put off."""
        ...

    def intended_work(self) -> float:
        """Work done by the hand's intention between the last two samples, J; 0 where that is unknown."""
        ...

    def figures(self) -> Mapping[str, float]:
        """What is to be told of the device with its telemetry, by the names of :mod:`manyhands.nodes.telemetry`."""
        ...

    def close(self) -> None:
        """Exert no force, and give back what is held of the machine. A second time does nothing."""
        ...


def driver_of(bundle: DeviceBundle) -> Driver:
    """The device itself; whoever asked for it closes it.

    Raises:
        ValueError: the bundle's numbers make no device.
        TransportError: its pointer cannot be opened.
    """
    T = bundle.common.period
    match bundle.source:
        case SimulatedHand() as hand:
            return simulated_driver(hand, T)
        case RecordedMotion() as motion:
            return TraceDriver(motion, T)
        case BrowserHand(physics):
            return BrowserDriver(physics, bundle.limits, T, pointer_of(bundle.common))
