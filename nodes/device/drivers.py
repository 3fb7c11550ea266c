"""The interface of a force-feedback device (:class:`Driver`), the driver of each bundle, and that of a recorded hand.

The drivers of a recorded motion, :class:`TraceDriver` in its own time and :class:`WallTimeTrace`, move the device as it
was recorded, whatever force acts on it. Such a hand does not yield, and is passive all the same: in a frame that moves
with the recorded motion r, the device stays where it is. The hand is the limit of the simulated hand
(:mod:`manyhands.design.models.device`) for a stiffness k_h without bound, on a device without mass. The work of its
intention is the limit as well, with v_m = dx/T:

    W(k) = -f_v(k-1)^T dx + dx^T Delta_D dx / T,    dx = r(k) - r(k-1), r(-1) = 0.

With it the ledger of G_hat, which is (share Delta_D)-OSP with K = kappa T Delta_D^-1, comes to

    f_v^T K f_v / 2 + sum of  a g^T K g + 2 a g^T dx + (1 - share) dx^T Delta_D dx / T,

a = 1/2 - share kappa, g = f_v(k) - f_v(k-1), and is never below 0 (docs/decisions/0023-trace-driver.md). Without a
delay inside the tick the sum is 0, and what is left is the ledger of a device that does not move in its frame.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

from manyhands.nodes.device.dry_joints import DryMechanism
from manyhands.nodes.device.friction import DryPlant
from manyhands.nodes.device.mechanism import Mechanism
from manyhands.nodes.device.motion_sources import MOTION_SOURCES
from manyhands.nodes.device.plugin import buttons_among, plugin_driver
from manyhands.nodes.device.pointer import Follower, GoalSource, browser_goal, pointer_hand, pointer_of
from manyhands.nodes.device.rate_goal import RateGoal
from manyhands.nodes.device.simulated import Hand, HeldDeviceDriver, OwnTimeDriver, Plant, device_of, intent_hand
from manyhands.nodes.device.wall_time import WallTimeDriver
from manyhands.nodes.kernel.arithmetic import Floats, dot, linear_map
from manyhands.nodes.kernel.bundle import (
    SIMULATED,
    WALL,
    DeviceBundle,
    PersonHand,
    PluginDevice,
    RateMotion,
    RecordedMotion,
    SimulatedHand,
)
from manyhands.nodes.kernel.intent import SampledSignal
from manyhands.protocol.clock import Duration, Instant, seconds
from manyhands.protocol.messages import Figures


class Driver(Protocol):
    """A force-feedback device: displacement out, force in, one of each a tick.

    One that has buttons has a method ``buttons() -> int`` as well: those of its bundle that are held down, bit by bit.

    Instants count from tick 0's instant, ns, and never decrease from call to call; an instant before that of the last
    call counts as that one. A driver in its own time ignores them.
    """

    @property
    def axes(self) -> int:
        """Number of axes."""
        ...

    def sample(self, tick: int, at: Instant) -> Sequence[float]:
        """The displacement at the instant ``at``, m, one entry for each axis; ``tick`` counts the calls from 0."""
        ...

    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> Sequence[float] | None:
        """Exert the force f (N) from the instant ``at`` on, and hold it until the next call.

        Args:
            f: the force, N, one entry for each axis.
            at: the instant of the call.
            until: from this instant on the device by itself exerts no force, even if no call follows; None to hold f.

        Returns:
            The displacement at ``at``, m; None where the device cannot measure it then.
        """
        ...

    def release(self, at: Instant) -> Sequence[float] | None:
        """Exert no force from ``at`` on, as :meth:`apply`; the loop calls this when it has no force in time."""
        ...

    def idle(self, due: Instant) -> None:
        """Do the work that was put off: the tick's force is applied, and the next sample is due at ``due``."""
        ...

    def intended_work(self) -> float:
        """The work of the hand's intention between the last two samples, J; 0 where it is unknown."""
        ...

    def work(self) -> float | None:
        """The work of its motors on the device since the last call, J, up to the displacement that it returned last.

        It is asked at once after that displacement, where motors hold torques. It is infinite where it is unknown this
        once, and None where the motors hold the force itself, whose work is f^T dx.
        """
        ...

    def figures(self) -> Figures:
        """The driver's own figures for the telemetry, by the names of :mod:`manyhands.nodes.rows.figures`."""
        ...

    def close(self) -> None:
        """Exert no force, and release the device's files and sockets. A second call does nothing."""
        ...


class TraceDriver:
    """A :class:`manyhands.nodes.device.drivers.Driver` that plays a motion, tick by tick; at its end it stays there."""

    def __init__(self, motion: RecordedMotion, T: float) -> None:
        """Be at rest in 0 before the first sample.

        Args:
            motion: the recorded motion, linear between its samples.
            T: period, s.

        Raises:
            ValueError: the motion has no samples, or its times or values cannot be used.
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

    def sample(self, tick: int, at: Instant) -> Floats:
        """The displacement r(kT), m."""
        x = self._next if tick == self._tick else self._at(tick)
        moved = [now - last for now, last in zip(x, self._x, strict=True)]
        self._work = dot(moved, self._friction(moved)) - dot(self._f, moved)
        self._x, self._next, self._tick = x, x, tick
        return x.copy()

    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> Floats:
        """Take f (N) as the force over the period that begins; the motion does not yield to it."""
        self._f = list(map(float, f))
        return self._x.copy()

    def release(self, at: Instant) -> Floats:
        """Take zero force."""
        return self.apply([0.0] * len(self._traces), at)

    def idle(self, due: Instant) -> None:
        """Compute the next sample of the motion, before it is due."""
        if self._next is self._x:
            self._tick += 1
            self._next = self._at(self._tick)

    def intended_work(self) -> float:
        """The work W(k) of the hand's intention between the last two samples, J."""
        return self._work

    def work(self) -> float | None:
        """None: whatever moves this device, it holds the force itself."""
        return None

    def figures(self) -> Figures:
        """No figures."""
        return Figures()

    def close(self) -> None:
        """Do nothing: the driver holds no files or sockets."""

    def _at(self, tick: int) -> Floats:
        t = tick * self._T
        return [trace(t) for trace in self._traces]


class WallTimeTrace(WallTimeDriver):
    """A :class:`manyhands.nodes.device.drivers.Driver` that plays a motion by the clock; at its end it stays there.

    The work W is that of :class:`TraceDriver`, over each piece of time between two events or grid points in place of T.
    """

    def __init__(self, motion: RecordedMotion, T: float) -> None:
        """Be at rest in 0 until one period before the first sample.

        Args:
            motion: the recorded motion, linear between its samples.
            T: period, s.

        Raises:
            ValueError: the motion has no samples, or its times or values cannot be used.
        """
        self._traces = [SampledSignal(motion.times, axis) for axis in motion.values]
        self._level = linear_map(motion.damping)
        self._T = T
        super().__init__(len(self._traces), T)

    def _begin(self, at: int) -> tuple[Floats, float]:
        x = self._at(at)
        return x, dot(x, self._level(x)) / self._T

    def _prepare(self, tick: int) -> None:
        """Nothing is known ahead."""

    def _enter(self, tick: int, state: Floats) -> Floats:
        return state

    def _advance(self, state: Floats, f: Floats, begin: int, end: int) -> Floats:
        return self._at(end)

    def _seen(self, state: Floats, f: Floats, begin: int, end: int) -> Floats:
        return self._at(end)

    def _left(self, state: Floats, f: Floats, begin: int, end: int) -> tuple[Floats, float]:
        after = self._at(end)  # the motion knows its place at every instant
        return after, self._work_over(state, after, f, begin, end)

    def _work_over(self, before: Floats, after: Floats, f: Floats, begin: int, end: int) -> float:
        moved = [now - last for now, last in zip(after, before, strict=True)]
        return dot(moved, self._level(moved)) / seconds(Duration(end - begin)) - dot(f, moved)

    def _at(self, at: int) -> Floats:
        tick, part = divmod(at, self._period)
        t = tick * self._T + seconds(Duration(part))  # as TraceDriver has it at the grid points, to the last bit
        return [trace(t) for trace in self._traces]


def driver_of(bundle: DeviceBundle) -> Driver:
    """The driver of the source that the bundle names; the caller closes it.

    Where the source is a driver of another package, this imports and runs that package's code.

    Raises:
        ValueError: the bundle's numbers make no device, or the driver of another package cannot be made.
        MotionSourceError: the device by which a person moves it cannot be opened.
        TransportError: the socket of its pointer cannot be opened.
    """
    T, wall = bundle.common.period, bundle.time == WALL
    match bundle.source:
        case SimulatedHand() as hand:
            return _held(intent_hand(hand, T, wall, _plant(hand, T)), T, wall)
        case RecordedMotion() as motion:
            return WallTimeTrace(motion, T) if wall else TraceDriver(motion, T)
        case PersonHand(physics, rate):
            return _held(pointer_hand(physics, bundle.limits, T, _goal(rate, bundle), wall), T, wall)
        case PluginDevice() as device:
            return plugin_driver(device, bundle)


def _plant(hand: SimulatedHand, T: float) -> Plant | None:
    """The plant of a device that has a linkage or dry friction; None for any other."""
    if hand.linkage is not None:
        friction = hand.linkage.get("friction")
        if friction is not None:
            return DryMechanism(device_of(hand), T, hand.linkage, tuple(map(float, friction)))
        return Mechanism(device_of(hand), T, hand.linkage)
    return None if hand.friction is None else DryPlant(device_of(hand), T, hand.friction)


def _goal(rate: RateMotion | None, bundle: DeviceBundle) -> Callable[[Follower], GoalSource]:
    """Makes the source of the goals by which a person moves a device; under the simulated clock nobody does."""
    T = bundle.common.period
    if rate is None or bundle.common.clock == SIMULATED:
        return browser_goal(T, pointer_of(bundle.common), bundle.orientation is not None)
    if rate.source not in MOTION_SOURCES:
        raise ValueError(f"found the source of motion {rate.source!r}; expected one of {', '.join(MOTION_SOURCES)}")
    kind = MOTION_SOURCES[rate.source]
    if wrong := [name for name in rate.axes if name.removeprefix("-") not in kind.AXES]:
        raise ValueError(f"found the axis {wrong[0]!r} of a {kind.NAME}; expected one of {', '.join(kind.AXES)}")
    axes = [(kind.AXES.index(name.removeprefix("-")), -1.0 if name.startswith("-") else 1.0) for name in rate.axes]
    buttons = buttons_among(bundle.common.buttons, kind.BUTTONS, f"a {kind.NAME}")
    return lambda follower: RateGoal(kind(rate.device), axes, rate.speed, rate.dead_zone, follower, T, buttons)


def _held(hand: Hand, T: float, wall: bool) -> Driver:
    return HeldDeviceDriver(hand, T) if wall else OwnTimeDriver(hand)
