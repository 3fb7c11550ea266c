"""A driver of another package: its base class (:class:`DeviceDriver`), and what stands between it and the loop.

A session names the driver's factory (:mod:`manyhands.nodes.kernel.factory`). The device's process calls it, and nothing
else does. :class:`PluginDriver` makes a :class:`manyhands.nodes.device.drivers.Driver` of the result: it maps the axes,
checks every answer, and names the driver where one is of no use.

**The session promises, the driver states, and the process compares.** A certificate is designed without running the
driver, from the numbers in the session file. The driver states its own numbers when it is made
(:mod:`manyhands.nodes.device.specification`). A session that promises more than its driver states is refused before
anything moves.

**A driver that measures the force that its device exerts is held to it.** A measured force has to be one of those that
the driver was given within the stated delay and a period, give or take :data:`PART` of the stated limit. Every other
tick is counted (``untrue``), and ends in a sentence that names the driver, and not its user.

**A driver's code is trusted, its answers are not.** An exception, a wrong number of entries, or a displacement that is
not finite ends the device's node with the driver's name, after one last release.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from numbers import Integral
from typing import Final

from manyhands.nodes.device.specification import AxisMap, DeviceSpecification, other_kinds, promises_too_much
from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.kernel.bundle import SIMULATED, WALL, DeviceBundle, OrientationPart, PluginDevice
from manyhands.nodes.kernel.buttons import picked
from manyhands.nodes.kernel.driver_statement import DeviceTiming
from manyhands.nodes.kernel.factory import FactoryError, FactoryName, in_one_line, made_by
from manyhands.nodes.kernel.lifetime import Stopped
from manyhands.nodes.kernel.orientation import UPRIGHT, Quaternion, normalised
from manyhands.nodes.rows import figures as names
from manyhands.protocol.clock import Duration, Instant, from_seconds
from manyhands.protocol.messages import Figures

REQUIRED: Final = (
    "specification", "sample", "apply", "release", "close", "exerted", "idle", "figures",
)  # fmt: skip
"""The methods of a driver; the last three have a default in :class:`DeviceDriver`. So have ``work``, which is asked for
where motors hold torques, ``buttons``, which is asked for where the session names buttons, and ``orientation`` and
``apply_wrench``, which are called where a session has the device's orientation, and its torque."""


class DeviceDriver(ABC):
    """The base class of a driver of another package; a loop calls it from one thread, in every period.

    Instants count from tick 0's instant in ns, and never decrease. Forces and displacements are those of the device's
    own axes.
    """

    @abstractmethod
    def specification(self) -> DeviceSpecification:
        """What the driver states of its device; called once, before anything else."""

    @abstractmethod
    def sample(self, tick: int, at: Instant) -> Sequence[float]:
        """The newest displacement, m, one entry for each axis; it must not wait for a newer one.

        Args:
            tick: counts the calls from 0.
            at: the instant of the call.
        """

    @abstractmethod
    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> Sequence[float] | None:
        """Exert the force f (N) from now on, and hold it until the next call.

        Args:
            f: the force, N, one entry for each axis.
            at: the instant of the call.
            until: from this instant on the device has to exert no force by itself, even if no call follows: the
                watchdog of its amplifier. None leaves that to the watchdog's own time.

        Returns:
            The displacement at ``at``, m, where the device measures it; None otherwise.
        """

    @abstractmethod
    def release(self, at: Instant) -> Sequence[float] | None:
        """Exert no force from now on; returns as :meth:`apply`. The loop calls it when it has no force in time."""

    @abstractmethod
    def close(self) -> None:
        """Exert no force, and release the device's files and sockets. A second call does nothing."""

    def exerted(self) -> Sequence[float] | None:
        """The force that the device really exerts since the last :meth:`apply`, N; None where it cannot tell.

        The loop asks for it when nobody waits, once a tick.
        """
        return None

    def work(self) -> float | None:
        """The work of the motors on the device since the last call, J, up to the displacement that was returned last.

        Of joints q and the torques t that the motors held between two readings it is the sum of t^T (q_new - q_old).
        The loop asks at once after each displacement that it uses, where the session states that the motors hold
        torques. None where the driver cannot tell this once, as when its watchdog ended a force between two readings;
        the next answer then begins with this call.
        """
        return None

    def orientation(self) -> Sequence[float]:
        """How the device was turned at the sample that was returned last, as a unit quaternion; it must not wait.

        The loop asks after each displacement, where the session has the device's orientation.

        Returns:
            (w, x, y, z): the rotation from the axes of the tool to those of the driver's displacements, which form a
            right-handed frame. q and -q are the same. (1, 0, 0, 0) is the tool's place in the model of the world.
        """
        raise NotImplementedError("found no orientation; expected a method orientation of the driver")

    def apply_wrench(
        self, f: Sequence[float], torque: Sequence[float], at: Instant, until: Instant | None = None
    ) -> Sequence[float] | None:
        """Exert a force and a torque together from now on, and hold both until the next call.

        It is called in place of :meth:`apply` where the session has a torque of the device's orientation. From
        ``until`` on the device has to exert neither by itself. :meth:`release` and :meth:`apply` end the torque.

        Args:
            f: the force, N, one entry for each axis.
            torque: N*m, about the driver's three axes, which stand still in the world while it is held.
            at: the instant of the call.
            until: as of :meth:`apply`.

        Returns:
            As :meth:`apply`.
        """
        raise NotImplementedError("found no torque; expected a method apply_wrench of the driver")

    def buttons(self) -> int:
        """Which buttons are held down: bit i for the i-th that the specification names; it must not wait.

        The loop asks after each displacement that it sends, where the session names buttons of the device.
        """
        return 0

    def idle(self, due: Instant) -> None:
        """Do work that was put off; the next sample is due at ``due``."""
        del due

    def figures(self) -> Mapping[str, float]:
        """Figures of its own for the telemetry, at most a few; called ten times a second."""
        return {}


OFF_UNIT: Final = 1e-3
"""By how much the length of a driver's quaternion may be off: as of numbers that were rounded to three digits."""

PART: Final = 0.05
"""The part of an axis' stated limit of force by which a measured force may differ from the one that was given."""


@dataclass
class Differences:
    """Measured forces that differ in one way from those that were given.

    Attributes:
        ticks: in how many ticks one did.
        most: by how much at most, on any axis, N.
    """

    ticks: int = 0
    most: float = 0.0

    def count(self, by: float) -> None:
        """A tick in which one differs by so much, N."""
        self.ticks += 1
        self.most = max(self.most, by)


class GivenForces:
    """The forces that a driver was given lately, and whether a measured one is among them.

    Attributes:
        untrue: measurements that were not, by their distance from the nearest.
        limp: measurements of no force on any axis, where one was given: the device protects itself, or its watchdog has
            acted. They are none of ``untrue``.
    """

    def __init__(self, limits: Sequence[float], window: Duration) -> None:
        """No force was given.

        Args:
            limits: the greatest force of each of the driver's axes, as it states them, N.
            window: for how long a former force may still be measured, ns.
        """
        self._allowed, self._window = [PART * limit for limit in limits], window
        self._zero: Floats = [0.0] * len(limits)
        self._given: deque[tuple[Instant, Floats]] = deque([(Instant(0), self._zero)])
        self._at = Instant(0)
        self.untrue, self.limp = Differences(), Differences()

    def give(self, F: Floats, at: Instant, until: Instant | None = None) -> None:
        """From ``at`` on it has to be F (N), and from ``until`` on zero."""
        given, self._at = self._given, at
        while len(given) > 1 and given[-1][0] > at:  # what was to come
            given.pop()
        given.append((at, F))
        if until is not None:
            given.append((max(at, until), self._zero))
        while len(given) > 1 and given[1][0] <= at - self._window:
            given.popleft()

    def measured(self, F: Floats) -> None:
        """The force is F (N) at the instant of the last call of :meth:`give`."""
        worst = 0.0
        for axis, (force, allowed) in enumerate(zip(F, self._allowed, strict=True)):
            of_axis = [given[axis] for begin, given in self._given if begin <= self._at]
            beyond = max(min(of_axis) - force, force - max(of_axis))
            if beyond > allowed:
                worst = max(worst, beyond)
        if worst > 0.0:
            none = all(abs(force) <= allowed for force, allowed in zip(F, self._allowed, strict=True))
            (self.limp if none else self.untrue).count(worst)


class DriverFailure(ValueError):
    """A driver failed or gave no usable answer; the message names it, the call, what was found and what was right.

    Attributes:
        raised: whether it raised an exception; otherwise its answer was of no use.
    """

    def __init__(self, text: str, raised: bool) -> None:
        super().__init__(text)
        self.raised = raised


def axis_map_of(device: PluginDevice, own: tuple[str, ...]) -> AxisMap:
    """The map of a session's device to a driver with these names of its axes.

    Raises:
        FactoryError: the driver has another number of axes, or no such axis.
    """
    if len(own) != device.axes:
        raise FactoryError(
            f"the driver {device.driver.factory}: found {len(own)} axes ({', '.join(own)}); expected {device.axes}, "
            "the dof of the session's device"
        )
    wanted = device.axis_map or own
    for name in wanted:
        if name.removeprefix("-") not in own:
            raise FactoryError(
                f"axis_map: found the axis {name!r:.40}; expected one of {', '.join(own)}, which the driver "
                f"{device.driver.factory} has, with or without a minus"
            )
    axes = tuple(own.index(name.removeprefix("-")) for name in wanted)
    return AxisMap(axes, tuple(-1.0 if name.startswith("-") else 1.0 for name in wanted), device.scale)


def buttons_among(wanted: Sequence[str], own: Sequence[str], who: str) -> tuple[int, ...]:
    """By button of a session's device, ``device.button``, its number among the buttons that its driver has.

    Raises:
        FactoryError: the driver has no such button; ``who`` names it.
    """
    found = []
    for name in wanted:
        device, _, button = name.rpartition(".")
        if button not in own:
            has = ", ".join(own) or "none"
            raise FactoryError(
                f"devices.{device}.buttons: found {button!r:.40}; expected buttons of {who}, which has {has}"
            )
        found.append(own.index(button))
    return tuple(found)


def made_driver(name: FactoryName, ports: tuple[str, ...], T: float) -> tuple[DeviceDriver, DeviceSpecification]:
    """Make a driver, and ask it what it states.

    Raises:
        FactoryError: the factory fails, or its result is no driver.
    """
    made: DeviceDriver = made_by(name, "driver", ports, T)
    if lacks := [method for method in REQUIRED if not callable(getattr(made, method, None))]:
        raise FactoryError(
            f"the driver {name.factory} cannot be used: found {type(made).__name__} without {', '.join(lacks)}; "
            "expected a subclass of manyhands.nodes.device.plugin.DeviceDriver"
        )
    try:
        stated: object = made.specification()
    except Stopped:
        raise
    except (Exception, SystemExit) as error:  # foreign code: every exception is named
        raise FactoryError(f"the driver {name.factory}: specification: found {in_one_line(error)}") from error
    if not isinstance(stated, DeviceSpecification):
        raise FactoryError(
            f"the driver {name.factory}: specification: found {type(stated).__name__}; expected a DeviceSpecification"
        )
    return made, stated


class PluginDriver:
    """A :class:`manyhands.nodes.device.drivers.Driver` around one of another package.

    Attributes:
        by_itself: what its device does outside every certificate, as the driver states; a sentence each.
        oriented: what the driver states of its device's orientation; None where it tells none.
    """

    def __init__(
        self,
        name: str,
        driver: DeviceDriver,
        axis_map: AxisMap,
        stated: DeviceSpecification,
        T: float,
        timing: DeviceTiming | None = None,
        buttons: Sequence[int] = (),
    ) -> None:
        """Map and check a driver.

        Args:
            name: of its factory, for messages.
            driver: the driver.
            axis_map: from its axes to the ports.
            stated: by the driver, in its own axes.
            T: period, s.
            timing: of the device as the session has it; None for what the driver states. Where its latency is not 0,
                the driver's displacement at a force is not that of its instant, and is not used.
            buttons: by button of the session, its number among the driver's.
        """
        self._buttons = tuple(buttons)
        timing = timing or stated.timing
        self.by_itself, self._units = stated.uncovered, stated.units
        self._name, self._driver, self._measures = name, driver, timing.latency == 0.0
        self._given = GivenForces(stated.force, from_seconds(T + timing.actuation_delay))
        self._measured = 0
        m = self._m = len(axis_map.axes)
        self._to_ports = list(zip(axis_map.axes, axis_map.gains, strict=True))
        port_of = {axis: port for port, axis in enumerate(axis_map.axes)}
        self._to_axes = [(port_of[axis], axis_map.gains[port_of[axis]]) for axis in range(m)]
        self._zero: Floats = [0.0] * m
        self.oriented = stated.orientation
        if self.oriented is not None:
            self._turned = list(zip(axis_map.axes, axis_map.turns, strict=True))
            self._torques = [(port_of[axis], axis_map.turns[port_of[axis]]) for axis in range(m)]
        self._F = self._zero  # in the driver's axes, N
        self._failed = False
        self._unexerted = Differences()

    @property
    def axes(self) -> int:
        """Number of axes."""
        return self._m

    def sample(self, tick: int, at: Instant) -> Floats:
        """The driver's newest displacement at the ports, m."""
        try:
            X = list(map(float, self._driver.sample(tick, at)))
        except (Exception, SystemExit) as error:  # foreign code: every exception is named
            raise self._raised("sample", error, "a displacement") from error
        if len(X) != self._m or not all(map(math.isfinite, X)):
            raise self._unusable("sample", X, f"{self._m} finite displacements in {self._units('m')}")
        return [gain * X[axis] for axis, gain in self._to_ports]

    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> Floats | None:
        """Exert f (N) of the ports; returns the displacement only where the device measures it without latency."""
        self._F = [gain * f[port] for port, gain in self._to_axes]
        self._given.give(self._F, at, until)
        try:
            X = self._driver.apply(self._F.copy(), at, until)
        except (Exception, SystemExit) as error:  # foreign code: every exception is named
            raise self._raised("apply", error, "no exception") from error
        return None if X is None else self._at_ports("apply", X)

    def apply_wrench(
        self, f: Sequence[float], torque: Sequence[float], at: Instant, until: Instant | None = None
    ) -> Floats | None:
        """Exert f (N) of the ports and a torque about the world's axes (N*m) together; returns as :meth:`apply`."""
        self._F = [gain * f[port] for port, gain in self._to_axes]
        self._given.give(self._F, at, until)
        own = [sign * torque[port] for port, sign in self._torques]
        try:
            X = self._driver.apply_wrench(self._F.copy(), own, at, until)
        except (Exception, SystemExit) as error:  # foreign code: every exception is named
            raise self._raised("apply_wrench", error, "no exception") from error
        return None if X is None else self._at_ports("apply_wrench", X)

    def orientation(self) -> Quaternion:
        """How the device was turned at its last sample, in the session's axes."""
        try:
            q = list(map(float, self._driver.orientation()))
        except (Exception, SystemExit) as error:  # foreign code: every exception is named
            raise self._raised("orientation", error, "a unit quaternion") from error
        if len(q) != len(UPRIGHT) or not abs(math.hypot(*q) - 1.0) <= OFF_UNIT:  # so for NaN
            raise self._unusable(
                "orientation", q, f"a unit quaternion (w, x, y, z), of a length of 1 within {OFF_UNIT:g}"
            )
        return normalised([q[0], *(sign * q[1 + axis] for axis, sign in self._turned)])

    def release(self, at: Instant) -> Floats | None:
        """Exert no force; after a failure of the driver, what it raises once more is not reported."""
        self._F = self._zero
        self._given.give(self._F, at)
        try:
            X = self._driver.release(at)
        except (Exception, SystemExit) as error:  # foreign code: every exception is named
            if self._failed:
                return None
            raise self._raised("release", error, "no exception") from error
        return None if X is None or self._failed else self._at_ports("release", X)

    def exerted(self, held: Floats) -> Floats:
        """The force that the device really exerts, N, at the ports; ``held`` itself where it is that, or unknown."""
        try:
            given = self._driver.exerted()
            F = None if given is None else list(map(float, given))
        except (Exception, SystemExit) as error:  # foreign code: every exception is named
            raise self._raised("exerted", error, "a force or None") from error
        if F is None:
            return held
        self._measured += 1
        if F == self._F:
            return held
        if len(F) != self._m or not all(map(math.isfinite, F)):
            raise self._unusable("exerted", F, f"{self._m} finite forces in {self._units('N')}, or None")
        self._given.measured(F)
        self._unexerted.count(max(abs(a - b) for a, b in zip(F, self._F, strict=True)))
        return [F[axis] / gain for axis, gain in self._to_ports]

    def buttons(self) -> int:
        """Which of the session's buttons are held down, bit by bit."""
        try:
            state = self._driver.buttons()
        except (Exception, SystemExit) as error:  # foreign code: every exception is named
            raise self._raised("buttons", error, "an integer") from error
        if not isinstance(state, Integral) or state < 0:
            raise self._unusable("buttons", state, "an integer of at least 0, with a bit for each button")
        return picked(int(state), self._buttons)

    def idle(self, due: Instant) -> None:
        """Let the driver do what it has put off."""
        try:
            self._driver.idle(due)
        except (Exception, SystemExit) as error:  # foreign code: every exception is named
            raise self._raised("idle", error, "no exception") from error

    def intended_work(self) -> float:
        """0: the intention of a person's hand is not known."""
        return 0.0

    @property
    def tells_work(self) -> bool:
        """Whether the driver has a method of its own for the work of its motors."""
        own = getattr(type(self._driver), "work", None)
        return own is not None and own is not DeviceDriver.work

    def work(self) -> float | None:
        """The work of its motors since the last call, J; infinite where the driver cannot tell, None if it never can.

        Ports and axes have the same power, so it is that of the driver's own axes.
        """
        if not self.tells_work:
            return None
        try:
            given = self._driver.work()
            done = None if given is None else float(given)
        except (Exception, SystemExit) as error:  # foreign code: every exception is named
            raise self._raised("work", error, "a work in J or None") from error
        if done is None:
            return math.inf
        if not math.isfinite(done):
            raise self._unusable("work", done, "a finite work in J, or None")
        return done

    def figures(self) -> Figures:
        """The driver's figures, whether it measures its forces, and what of them differs from those it was given."""
        try:
            own = {str(key): float(value) for key, value in self._driver.figures().items()}
        except (Exception, SystemExit) as error:  # foreign code: every exception is named
            raise self._raised("figures", error, "numbers by name") from error
        found = dict[str, float]()
        if self._measured:
            found[names.MEASURED] = float(self._measured)
        for differences, ticks, most in (
            (self._unexerted, names.UNEXERTED, names.UNEXERTED_MOST),
            (self.untrue, names.UNTRUE, names.UNTRUE_MOST),
            (self.limp, names.LIMP, names.LIMP_MOST),
        ):
            if differences.ticks:
                found |= {ticks: float(differences.ticks), most: differences.most}
        return Figures(found, {names.DRIVER: own} if own else {})

    @property
    def untrue(self) -> Differences:
        """The forces that the driver has measured, and had not been given."""
        return self._given.untrue

    @property
    def limp(self) -> Differences:
        """Where it has measured no force although it had been given one."""
        return self._given.limp

    @property
    def measures(self) -> bool:
        """Whether the driver has measured the force that its device exerts."""
        return self._measured > 0

    def close(self) -> None:
        """Close the driver; after a failure, what it raises once more is not reported."""
        try:
            self._driver.close()
        except (Exception, SystemExit) as error:  # foreign code: every exception is named
            if not self._failed:
                raise self._raised("close", error, "no exception") from error

    def _at_ports(self, call: str, X: Sequence[float]) -> Floats | None:
        """A displacement of the driver at the ports, m; None where it is not that of its instant."""
        if len(X) != self._m or not all(map(math.isfinite, X)):
            raise self._unusable(call, X, f"{self._m} finite displacements in {self._units('m')}, or None")
        return [gain * float(X[axis]) for axis, gain in self._to_ports] if self._measures else None

    def _raised(self, call: str, error: BaseException, expected: str) -> DriverFailure:
        self._failed = True
        text = f"the driver {self._name} failed in {call}: found {in_one_line(error)}; expected {expected}"
        return DriverFailure(text, raised=True)

    def _unusable(self, call: str, found: object, expected: str) -> DriverFailure:
        self._failed = True
        text = f"the driver {self._name} failed in {call}: found {found!r:.80}; expected {expected}"
        return DriverFailure(text, raised=False)


def _require_oriented(bundle: DeviceBundle, driver: DeviceDriver, stated: DeviceSpecification, name: str) -> None:
    """Hold a session's orientation to what its driver states.

    Raises:
        FactoryError: the driver tells none, or the session promises more of it.
    """
    felt = bundle.orientation if isinstance(bundle.orientation, OrientationPart) else None
    at = f"devices.{bundle.common.name}"
    if stated.orientation is None:
        raise FactoryError(
            f"{at}.orientation: found the driver {name}, which states no orientation; expected one that does, or no "
            "orientation in the session"
        )
    for method in ("orientation", "apply_wrench")[: 1 if felt is None else 2]:
        if getattr(type(driver), method, None) in (None, getattr(DeviceDriver, method)):
            raise FactoryError(f"{at}: found the driver {name} without a method {method}; expected it to have one")
    torque, speed = (None, None) if felt is None else (felt.torque, felt.speed)
    if found := list(stated.orientation.promises_too_much(torque, speed, bundle.twisting is not None)):
        raise FactoryError(f"{at}: the session promises more than its driver {name} states: {'; '.join(found)}")


def plugin_driver(device: PluginDevice, bundle: DeviceBundle) -> PluginDriver:
    """Import and make the driver that a device's bundle names, and hold the session to what it states.

    Raises:
        FactoryError: the driver cannot be made, is hardware under the simulated clock, or the session promises more
            than it states.
    """
    name, ports = device.driver.factory, bundle.common.ports
    driver, stated = made_driver(device.driver, ports, bundle.common.period)
    try:
        axis_map = axis_map_of(device, stated.axes)
        if stated.hardware and bundle.common.clock == SIMULATED:
            raise FactoryError(
                f"the driver {name}: found hardware under the {SIMULATED} clock; expected the realtime clock, for a "
                "mechanism moves in real time"
            )
        limits = bundle.limits.force, bundle.limits.displacement, bundle.limits.speed
        buttons = buttons_among(bundle.common.buttons, stated.buttons, f"the driver {name}")
        if buttons and not callable(getattr(driver, "buttons", None)):
            raise FactoryError(f"the driver {name}: found buttons, and no method buttons; expected it to tell them")
        made = PluginDriver(name, driver, axis_map, stated, bundle.common.period, device.timing, buttons)
        if stated.holds_torque and bundle.held is None:
            raise FactoryError(
                f"devices.{bundle.common.name}.held: found force; expected torque, for the driver {name} states that "
                "the motors of its device hold torques"
            )
        if bundle.held is not None and bundle.held.works and bundle.time == WALL and not made.tells_work:
            raise FactoryError(
                f"devices.{bundle.common.name}: found the driver {name} without a method work; expected the work of "
                "its motors in J, for they hold torques, and the account of lateness rests on it"
            )
        if bundle.orientation is not None:
            _require_oriented(bundle, driver, stated, name)
        if found := list(other_kinds(stated, axis_map, ports, bundle.common.kinds)):
            raise FactoryError(
                f"devices.{bundle.common.name}: the driver {name} states what its axes do, and the session says "
                f"otherwise: {'; '.join(found)}"
            )
        if found := list(promises_too_much(stated, axis_map, limits, device.timing, bundle.inertia, device.step)):
            raise FactoryError(
                f"devices.{bundle.common.name}: the session promises more than its driver {name} states: "
                + "; ".join(found)
            )
    except FactoryError:
        driver.close()
        raise
    return made
