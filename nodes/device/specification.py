"""What a device's driver states of itself: its limits, its timing, its axes (:class:`DeviceSpecification`).

**Axes.** With the map of the session (:class:`AxisMap`), port i is the driver's axis j(i) with the sign s(i), and the
scale c > 0:

    x_i = c s(i) X_j(i),        F_j(i) = c s(i) f_i,

so that the power f^T dx = F^T dX is the same on both sides.

**Orientation.** Where the map is the signed permutation P, an orientation of the driver's, by an angle about the unit
vector u, is at the session the rotation by the same angle about det(P) P u, and a torque t of the session at the driver
det(P) P^T t. Both are axial vectors: in a mirror they turn the other way. So the power t^T omega is the same, too, and
the scale changes neither.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

from manyhands.design.models.axis import AxisKind, Units, kinds_of
from manyhands.nodes.kernel.driver_statement import IMPOSED, NO_DELAY, DeviceTiming
from manyhands.nodes.kernel.inertia import Inertia
from manyhands.protocol.limits import MAX_BY_ITSELF, MAX_SENTENCE

__all__ = [
    "NO_DELAY",
    "ROUNDING",
    "AxisMap",
    "DeviceSpecification",
    "DeviceTiming",
    "OrientationSpecification",
    "promises_too_much",
    "up",
]
"""With what a driver of another package takes from here beside its specification."""

SAMPLE_AGE: Final = "sample_age"
AGE_JITTER: Final = "age_jitter"
ACTUATION_DELAY: Final = "actuation_delay"
TIMES: Final = (SAMPLE_AGE, AGE_JITTER, ACTUATION_DELAY)
"""The times of a :class:`DeviceTiming`, as a session and :attr:`DeviceSpecification.measured` name them."""

ROOM: Final = 1.5
"""A session is to state so many times what a driver measured at its start, for every start measures another time."""

_MEASURED: Final = (
    "which the driver measured at this start: end other programs, or state as much and design the session anew"
)

ROUND: Final = 5e-5
"""s; a measured time is rounded up to multiples of it."""

ORIENTED_AXES: Final = 3
"""The axes of a device that tells its orientation: where its tool is in space."""

ROUNDING = 1e-9
"""Relative; a limit that is stated in another frame than it is compared in is rounded."""


WORLD: Final = "world"
TOOL: Final = "tool"
JOINTS: Final = "joints"
HOLDS: Final = (WORLD, TOOL, JOINTS)
"""In whose axes motors may hold a torque from tick to tick: the world's, the tool's, or as torques of joints."""


@dataclass(frozen=True)
class OrientationSpecification:
    """What a driver states of its device's orientation.

    Attributes:
        speed: the greatest angular velocity that it measures rightly, rad/s.
        torque: the greatest torque about any axis, N*m, which the hardware can hold; None where no motor turns it, and
            its orientation is sensed alone.
        holds: in whose axes its motors hold the torque between two calls, one of :data:`HOLDS`. A session can use a
            torque that is held in the world's axes. It can use one that is held as torques of joints where it states
            how these bend in all six directions (``held: torque``, ``linkage: {kappa, length}``). Of the tool's axes
            nothing is proved, so a driver of such motors may state no torque, and exert none.

    Raises:
        ValueError: a number is not finite and positive, or ``holds`` is none of them.
    """

    speed: float
    torque: float | None = None
    holds: str = WORLD

    def __post_init__(self) -> None:
        for what, value in (("speed", self.speed), ("torque", self.torque)):
            if value is not None and not 0.0 < value < math.inf:
                raise ValueError(f"orientation: {what}: found {value!r:.40}; expected a finite number greater than 0")
        if self.holds not in HOLDS:
            raise ValueError(f"orientation: holds: found {self.holds!r:.40}; expected one of {', '.join(HOLDS)}")

    @property
    def felt(self) -> bool:
        """Whether a session may have a torque of it, with no more than its limits."""
        return self.torque is not None and self.holds == WORLD

    def session_keys(self) -> dict[str, Any]:
        """The keys of a session's orientation that keep to it: the limits of a torque, or that it is sensed."""
        return {"limits": {"torque": self.torque, "speed": self.speed}} if self.felt else {"sensed": True}

    def promises_too_much(self, torque: float | None, speed: float | None, twisting: bool = False) -> Iterator[str]:
        """A sentence for each limit of a session's orientation that is beyond what is stated.

        Args:
            torque: the session's greatest, N*m; None where its orientation is sensed.
            speed: likewise, rad/s.
            twisting: whether the session counts on torques of joints of six axes.
        """
        if torque is None or speed is None:
            return
        sensed = "orientation: found a torque; expected sensed: true"
        if self.holds == TOOL:
            yield f"{sensed}, for its motors hold it in the tool's axes, of which nothing is proved"
        elif self.torque is None:
            none = "no motor turns its device" if self.holds == WORLD else "its driver exerts none by its joints"
            yield f"{sensed}, for {none}"
        elif self.holds == JOINTS and not twisting:
            yield (
                f"{sensed}, or held: torque and linkage: {{kappa, length}} of all six directions, for its motors hold "
                "it as torques of joints"
            )
        if self.torque is None:
            return
        for what, found, most, unit in (("torque", torque, self.torque, "N·m"), ("speed", speed, self.speed, "rad/s")):
            if found > most * (1.0 + ROUNDING):
                yield f"orientation.limits.{what}: found {found:g} {unit}; expected at most {most:g} {unit}"


@dataclass(frozen=True)
class DeviceSpecification:
    """What a driver states of its device, in its own axes and in m, N and m/s (or rad, N·m and rad/s).

    Attributes:
        force: the greatest force of each axis, N, which the hardware can hold.
        displacement: the greatest displacement from 0 of each axis, m: the workspace.
        speed: the greatest speed of each axis that the driver measures rightly, m/s.
        timing: the age of its samples and the delay of its forces.
        axes: names of its axes in their order, which a session's ``axis_map`` refers to; numbers from 0 unless given.
        turning: the names of those that turn, whose numbers are in N·m and rad; None where the driver does not say it.
            A session has to say the same (``axes: {NAME: rotation}``).
        mass: the least moving mass that a push meets on each axis, kg (or kg·m²); None where it is not known. A session
            may state no greater one.
        moved_by_force: whether its forces move it. A source of motion, such as a tracker or a driven stage, states
            False: ``check-driver`` then skips what a push would show, and every run says that no certificate covers it.
        holds_torque: whether its motors hold the torques of joints between two forces, in place of the force at the
            tip. A session has to state so (``held: torque``), for its certificate is false otherwise.
        step: the encoder's step on each axis, m; None where it is not known. A session that counts on friction may
            state no smaller one.
        by_itself: what the device does inside the loop by itself, and cannot be switched off or was left on: a
            sentence each, as "compensates gravity by a force of its own". They are stated beside the certificate.
        measured: which of :data:`TIMES` the driver measured at this start. Its next start may measure greater ones, so
            a session needs room above them (:meth:`promised`); a time that is not named is the same at every start.
        buttons: the names of its buttons, in the order of the bits that :meth:`DeviceDriver.buttons` returns.
        orientation: what it states of its device's orientation, beside three axes that translate; None where it tells
            none.
        hardware: whether forces act on a real mechanism, in real time. A simulated counterpart states False: it moves
            by the instants of the calls, and also takes part under the simulated clock.

    Raises:
        ValueError: the numbers are not one for each axis, or out of their range.
    """

    force: tuple[float, ...]
    displacement: tuple[float, ...]
    speed: tuple[float, ...]
    timing: DeviceTiming = NO_DELAY
    axes: tuple[str, ...] = ()
    turning: tuple[str, ...] | None = None
    mass: tuple[float, ...] | None = None
    holds_torque: bool = False
    step: tuple[float, ...] | None = None
    by_itself: tuple[str, ...] = ()
    hardware: bool = True
    moved_by_force: bool = True
    measured: tuple[str, ...] = ()
    buttons: tuple[str, ...] = ()
    orientation: OrientationSpecification | None = None

    def __post_init__(self) -> None:
        m = len(self.force)
        if not self.axes:
            object.__setattr__(self, "axes", tuple(str(axis) for axis in range(m)))
        for what in ("force", "displacement", "speed", "mass", "step"):
            values = getattr(self, what)
            if what in ("mass", "step") and values is None:
                continue
            if len(values) != m or not m or not all(0.0 < value < math.inf for value in values):
                expected = f"{m or 'one or more'} finite numbers greater than 0, one an axis"
                raise ValueError(f"{what}: found {values!r:.60}; expected {expected}")
        if len(self.axes) != m or len(set(self.axes)) != m:
            raise ValueError(f"axes: found {self.axes!r:.60}; expected {m} names, each once")
        if not {*(self.turning or ())} <= {*self.axes}:
            raise ValueError(f"turning: found {self.turning!r:.60}; expected some of its axes {self.axes!r:.60}")
        if isinstance(self.buttons, str) or len({*self.buttons}) != len(self.buttons):
            raise ValueError(f"buttons: found {self.buttons!r:.60}; expected names, each once")
        fit = all(0 < len(one) <= MAX_SENTENCE and one.isprintable() for one in self.by_itself)
        if isinstance(self.by_itself, str) or len(self.uncovered) > MAX_BY_ITSELF or not fit:
            expected = f"at most {MAX_BY_ITSELF} sentences, each printable and of at most {MAX_SENTENCE} characters"
            raise ValueError(f"by_itself: found {self.by_itself!r:.60}; expected {expected}")
        if self.orientation is not None and (m != ORIENTED_AXES or self.turning):
            expected = f"{ORIENTED_AXES} axes that translate, and form a right-handed frame"
            raise ValueError(
                f"orientation: found it beside {m} axes, {len(self.turning or ())} turning; expected {expected}"
            )
        if isinstance(self.measured, str) or {*self.measured} - {*TIMES}:
            raise ValueError(f"measured: found {self.measured!r:.60}; expected names of {', '.join(TIMES)}")

    @property
    def kinds(self) -> tuple[AxisKind, ...]:
        """What each axis does; it translates where the driver does not say it."""
        return kinds_of(self.axes, self.turning or ())

    @property
    def units(self) -> Units:
        """The units of its axes together."""
        return Units.of(self.kinds)

    @property
    def units_by_axis(self) -> tuple[Units, ...]:
        """The units of each axis."""
        return tuple(Units.of([kind]) for kind in self.kinds)

    @property
    def uncovered(self) -> tuple[str, ...]:
        """What the device does outside every certificate: ``by_itself``, and its motion where no force moves it."""
        return self.by_itself if self.moved_by_force else (*self.by_itself, IMPOSED)

    def promised(self, starts: Iterable[DeviceTiming] = ()) -> DeviceTiming:
        """The timing that a session may state: the greatest of these starts, with :data:`ROOM` where it was measured.

        A jitter that was measured is all of the age, which bounds it at every start whose age is in bounds.

        Args:
            starts: what the driver stated at other starts.
        """
        every = [self.timing, *starts]

        def most(what: str, times: Iterable[float]) -> float:
            return up(ROOM * max(times)) if what in self.measured else max(times)

        age = most(SAMPLE_AGE, (one.sample_age for one in every))
        whole = AGE_JITTER in self.measured or any(one.age_jitter is None for one in every)
        varies = None if whole else max(one.jitter for one in every)
        return DeviceTiming(age, varies, most(ACTUATION_DELAY, (one.actuation_delay for one in every)))

    def session_keys(self, promised: DeviceTiming | None = None) -> dict[str, Any]:
        """The keys of a session's device that keep to what is stated; by axis as tuples.

        Args:
            promised: the timing that the session states; :meth:`promised` of this start by default.
        """
        keys: dict[str, Any] = {"limits": {"force": self.force, "displacement": self.displacement, "speed": self.speed}}
        timing = promised or self.promised()
        if timing.sample_age:
            keys[SAMPLE_AGE] = timing.sample_age
        if timing.sample_age and timing.age_jitter is not None:
            keys[AGE_JITTER] = timing.age_jitter
        if timing.actuation_delay:
            keys[ACTUATION_DELAY] = timing.actuation_delay
        keys |= {key: value for key, value in (("mass", self.mass), ("step", self.step)) if value is not None}
        keys |= {"held": "torque"} if self.holds_torque else {}
        return keys if self.orientation is None else keys | {"orientation": self.orientation.session_keys()}


@dataclass(frozen=True)
class AxisMap:
    """Which axis of the driver each port is.

    Attributes:
        axes: by port, the number of the driver's axis.
        signs: by port, 1.0 or -1.0.
        scale: c, by which displacements grow and forces shrink towards the ports; dimensionless, greater than 0.

    Raises:
        ValueError: the axes are no permutation, a sign is neither, or the scale is not greater than 0.
    """

    axes: tuple[int, ...]
    signs: tuple[float, ...]
    scale: float = 1.0

    def __post_init__(self) -> None:
        m = len(self.axes)
        if sorted(self.axes) != list(range(m)) or len(self.signs) != m or {*self.signs} - {1.0, -1.0}:
            raise ValueError(f"found the axes {self.axes} with the signs {self.signs}; expected each axis once, ±1")
        if not 0.0 < self.scale < math.inf:
            raise ValueError(f"found the scale {self.scale}; expected a finite number greater than 0")

    @property
    def gains(self) -> tuple[float, ...]:
        """By port, c s(i)."""
        return tuple(self.scale * sign for sign in self.signs)

    @property
    def turns(self) -> tuple[float, ...]:
        """By port, the sign with which an axial vector, as a torque is one, has the driver's component axes[port]."""
        swaps = sum(a > b for i, a in enumerate(self.axes) for b in self.axes[i + 1 :])
        mirrored = math.prod(self.signs) * (-1.0) ** swaps  # det(P)
        return tuple(mirrored * sign for sign in self.signs)


def other_kinds(
    stated: DeviceSpecification, axis_map: AxisMap, ports: Sequence[str], kinds: Sequence[AxisKind]
) -> Iterator[str]:
    """A sentence for each port whose axis does something else than its driver states.

    Args:
        stated: by the driver, in its own axes.
        axis_map: of the session.
        ports: their names.
        kinds: what the session says of each port.
    """
    for port, axis, kind in zip(ports, axis_map.axes, kinds, strict=True):
        if stated.turning is not None and kind is not (own := stated.kinds[axis]):
            name = port.partition(".")[2]
            yield f"axes: found {kind} for {port}; expected {f'{{{name}: {own}}}' if name else own}"


def promises_too_much(
    stated: DeviceSpecification,
    axis_map: AxisMap,
    limits: tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]],
    timing: DeviceTiming,
    inertia: Inertia | None = None,
    step: tuple[float, ...] | None = None,
) -> Iterator[str]:
    """A sentence for each number of a session that promises more than its driver states.

    Args:
        stated: by the driver, in its own axes.
        axis_map: of the session.
        limits: of the session, by port: force (N), displacement (m) and speed (m/s).
        timing: of the session.
        inertia: of the session; None where it states none.
        step: of the session's encoders, by port, m; None where it states none.
    """
    c, units = axis_map.scale, [stated.units_by_axis[axis] for axis in axis_map.axes]
    own = ((stated.force, 1.0 / c, "N"), (stated.displacement, c, "m"), (stated.speed, c, "m/s"))
    for what, promised, (of_driver, factor, unit) in zip(("force", "displacement", "speed"), limits, own, strict=True):
        for port, axis in enumerate(axis_map.axes):
            most = factor * of_driver[axis]
            if promised[port] > most * (1.0 + ROUNDING):
                at = units[port](unit)
                yield f"limits.{what}: found {promised[port]:g} {at}; expected at most {most:g} {at}"
                break
    if inertia is not None and stated.mass is not None:
        for port, axis in enumerate(axis_map.axes):
            least = stated.mass[axis] / (c * c)  # x = c X and f = F/c
            if inertia.mass[port] > least * (1.0 + ROUNDING):
                at = units[port]("kg")
                yield f"mass: found {inertia.mass[port]:g} {at}; expected at most {least:g} {at}"
                break
    if step is not None and stated.step is not None:
        for port, axis in enumerate(axis_map.axes):
            least = c * stated.step[axis]
            if step[port] < least * (1.0 - ROUNDING):
                at = units[port]("m")
                yield f"step: found {step[port]:g} {at}; expected at least {least:g} {at}"
                break
    for what, promise, own_time in (
        (SAMPLE_AGE, timing.sample_age, stated.timing.sample_age),
        (AGE_JITTER, timing.jitter, stated.timing.jitter),
        (ACTUATION_DELAY, timing.actuation_delay, stated.timing.actuation_delay),
    ):
        if promise < own_time * (1.0 - ROUNDING):
            text = f"{what}: found {promise:g} s; expected at least {own_time:g} s"
            yield f"{text}, {_MEASURED}" if what in stated.measured else text


def up(time: float) -> float:
    """A time rounded up to a multiple of :data:`ROUND`, s."""
    return round(ROUND * math.ceil(time / ROUND - 1e-9), 9)
