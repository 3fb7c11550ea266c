"""What the drivers of one motor axis share: a controller behind a serial port that answers when it is asked, N·m, rad.

**Why a sample waits for its answer.** A controller does not send by itself. An answer to the question of the tick
before would be a period old, and a certificate covers no delay beyond the period. A thread that asks all the time has
answers of up to two trips, and takes the interpreter from the loop at that rate. So :meth:`MotorAxis.sample` asks, and
waits one trip in ``select``: a few tenths of a millisecond. It never waits longer than for the age that is stated.

Trips from S to R are measured (:func:`manyhands.devices.starting.trips`). The way of an answer back and that of the
next torque are at most S + (R - S) + (R - S) together, on whichever of them a trip is longer. Half of it is stated as
the age of a sample, and half as the delay of a torque; only the sum counts for a certificate. The age varies by R - S.

**Lags that belong to the delay.** A current loop of bandwidth w answers like a first-order lag, whose phase is never
beyond that of a delay of 1/w. A critically damped tracking loop of natural frequency w, through which both controllers
pass their encoder, has the imaginary part -2 x^3 / (1 + x^2)^2 at x = (frequency)/w, never beyond that of a delay of
1/(2 w). Both are a part of the timing that is stated, for at small amplitudes they cost a spring what such delays cost.

**One axis of rotation holds its force.** The angle is the coordinate of the port, and the motor's torque its force. So
no pose stands between them, and ``holds_torque`` is False: between two ticks the very force of the port is held.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Final

from manyhands.devices.serial_port import PortError, SerialPort
from manyhands.devices.starting import checked, is_number, measured_times, trips
from manyhands.nodes.device.plugin import DeviceDriver
from manyhands.nodes.device.specification import AGE_JITTER, DeviceSpecification, DeviceTiming, up
from manyhands.protocol.clock import Clock, Duration, Instant, RealtimeClock, from_seconds, seconds

TURN: Final = 2.0 * math.pi
"""rad."""

GREETING: Final = from_seconds(2.0)
"""How long a controller may take to answer for the first time, and to become ready."""

AGAIN: Final = from_seconds(0.05)
"""How long an answer is waited for at the start before the question is asked again."""

LONGEST: Final = from_seconds(0.1)
"""The watchdog of a torque that is given without an end."""

REARMING: Final = from_seconds(0.5)
"""How long an axis may take to come back after its watchdog had ended a torque."""

PARAMETERS: Final[Mapping[str, object]] = {
    "port": "",
    "baud": 115200,
    "torque": None,
    "range": 10.0,
    "speed": None,
    "zero": 0.0,
    "inertia": None,
    "counts": None,
    "silence": 0.01,
    "sample_age": None,
    "actuation_delay": None,
}
"""What a session may give for any controller, and what holds where it does not; N·m, rad, rad/s, kg·m² and s.

``torque`` is required. ``zero`` is the controller's angle that is the session's 0. ``counts`` are those of the encoder
in a turn of the output. ``silence``: an unanswered question of so long means that the controller is gone. The last two
stand in for what would be measured."""


class MotorError(RuntimeError):
    """A controller does not answer, or is no longer of use; the message names its port and says what to do."""


@dataclass(frozen=True)
class Found:
    """What a controller has told of itself at the start.

    Attributes:
        torque: the greatest that it can be given, N·m; infinite where it does not tell.
        low: the least angle at which it exerts torques freely, rad; minus infinity where there is none.
        high: the greatest one, rad.
        speed: beyond which it limits torques or gives up, rad/s.
        sensor_lag: of its encoder's filter, s.
        motor_lag: of its current loop, s.
        step: of the numbers that it sends, rad.
        by_itself: sentences of a :class:`DeviceSpecification`.
    """

    torque: float
    low: float
    high: float
    speed: float
    sensor_lag: float
    motor_lag: float
    step: float
    by_itself: tuple[str, ...]


class Questions:
    """Questions that have no answer yet, each under a tag that its answer has as well.

    Answers come in the order of their questions. So the answer to one means that older ones will never be answered.
    """

    def __init__(self) -> None:
        self._open: dict[Hashable, Instant] = {}

    def __contains__(self, tag: Hashable) -> bool:
        return tag in self._open

    def __len__(self) -> int:
        return len(self._open)

    def ask(self, tag: Hashable, at: Instant) -> None:
        """A question of this tag, which has none that is open, was sent at ``at``."""
        self._open[tag] = at

    def answer(self, tag: Hashable) -> Instant | None:
        """When the question was sent that an answer of this tag belongs to; None where none was."""
        if tag not in self._open:
            return None
        for older in list(self._open):
            sent = self._open.pop(older)
            if older == tag:
                return sent
        return None

    @property
    def oldest(self) -> Instant | None:
        """When the oldest open question was sent; None where none is open."""
        return next(iter(self._open.values()), None)

    def forget(self) -> None:
        """Wait for no answer any more."""
        self._open.clear()


class MotorAxis(DeviceDriver):
    """A motor controller behind a serial port, as a device of one axis."""

    KNOWN: ClassVar[Mapping[str, object]] = PARAMETERS
    """The parameters of this kind of controller, and what holds where one is not given."""

    def __init__(
        self,
        ports: Sequence[str],
        period: float,
        parameters: Mapping[str, Any],
        clock: Clock | None = None,
    ) -> None:
        """Open the port, make the axis ready, and measure how long an answer takes.

        Args:
            ports: of the session's device: one.
            period: of the session, s.
            parameters: :attr:`KNOWN`, of which ``port`` and ``torque`` are required.
            clock: what the driver measures by; the realtime clock by default.

        Raises:
            ValueError: the parameters are not those.
            MotorError: no such controller answers, or it cannot be used.
            PortError: the port cannot be opened.
        """
        self._given = given = _checked(parameters, self.KNOWN)
        if len(ports) != 1:
            raise ValueError(f"found a device of {len(ports)} axes; expected dof: 1, for a motor has one")
        self._clock = clock or RealtimeClock()
        self._silence = from_seconds(given["silence"])
        self._most: float = given["torque"]
        self._questions = Questions()
        self._x = 0.0  # rad, of the newest answer
        self._asked = Instant(0)  # when it was asked for
        self._held = 0.0  # the torque that was asked for last, N·m
        self._rearming: Instant | None = None  # since when, after the watchdog had ended a torque
        self._unsent = self._old = self._trips = 0
        self._oldest = 0.0  # s
        self._sampled = Instant(0)
        self._longest = self._patience = LONGEST
        self._port = SerialPort(given["port"], given["baud"], end=b"\n")
        try:
            self._found = self._begin()
            self._limits = self._agreed()
            self._timing = self._timed(period)
        except BaseException:
            self.close()
            raise

    # --- of each controller

    @abstractmethod
    def _begin(self) -> Found:
        """Make the axis ready: it holds no torque and would exert one that it is given."""

    @abstractmethod
    def _hear(self) -> None:
        """Take what has come; of an angle :meth:`_take` is told."""

    @abstractmethod
    def _ask(self) -> None:
        """Ask for the angle, and keep the question."""

    @abstractmethod
    def _check(self) -> None:
        """Bring an axis back that its watchdog has disarmed.

        Raises:
            MotorError: it is of no use any more.
        """

    @abstractmethod
    def _exert(self, torque: float, lives: float) -> bool:
        """Send a torque, N·m, that ends by itself after ``lives`` s; False where the port had no room."""

    @abstractmethod
    def _stop(self) -> None:
        """Take the power from the motor."""

    @property
    @abstractmethod
    def _armed(self) -> bool:
        """Whether the newest answer was that of an axis that exerts its torque."""

    # --- the start

    def _agreed(self) -> tuple[float, float, float]:
        """Torque, displacement and speed that are stated, N·m, rad and rad/s."""
        found, given = self._found, self._given
        if self._most > found.torque:
            raise ValueError(
                f"parameters.torque: found {self._most:g} N·m; expected at most {found.torque:.4g}, which the "
                "controller's own limits allow"
            )
        zero = given["zero"]
        reach = min(given["range"], found.high - zero, zero - found.low)
        if reach <= 0.0:
            raise ValueError(
                f"parameters.zero: found {zero:g} rad; expected an angle between the controller's own bounds, "
                f"{found.low:.4g} and {found.high:.4g} rad"
            )
        return self._most, reach, min(found.speed, given["speed"] or math.inf)

    def _timed(self, period: float) -> DeviceTiming:
        """The timing as the session gives it, or as it is measured; both are rounded up."""
        found, given = self._found, self._given
        shortest, longest = trips(self._trip)
        half, age, delay = longest - shortest / 2.0, given["sample_age"], given["actuation_delay"]
        if delay is None:
            delay = up(half + found.motor_lag)
        if age is None:
            age = up(half + found.sensor_lag)
        self._longest = from_seconds(max(longest, age - found.sensor_lag))
        self._patience = from_seconds(period + longest)
        return DeviceTiming(age, min(age, up(longest - shortest)), delay)

    def _trip(self) -> Duration:
        """From a question to its answer."""
        began = self._clock.now()
        end, due = Instant(began + GREETING), began
        while (now := self._clock.now()) < end:
            if now >= due:
                self._ask()
                due = Instant(now + AGAIN)
            self._port.wait(AGAIN)
            self._hear()
            if self._asked >= began:
                return Duration(self._clock.now() - self._asked)
        raise MotorError(f"{self._port.path}: found no answer to a question for the angle; expected one")

    # --- the loop

    def specification(self) -> DeviceSpecification:
        """What the session gives and the controller allows, and the timing that was measured."""
        torque, reach, speed = self._limits
        given = self._given
        counts, inertia = given["counts"], given["inertia"]
        return DeviceSpecification(
            force=(torque,),
            displacement=(reach,),
            speed=(speed,),
            timing=self._timing,
            measured=(*measured_times(given), AGE_JITTER),  # the jitter always
            axes=("rz",),
            turning=("rz",),
            mass=None if inertia is None else (inertia,),
            step=None if counts is None else (max(TURN / counts, self._found.step),),
            holds_torque=False,  # the torque is the port's own force, whatever the angle
            by_itself=self._found.by_itself,
        )

    def sample(self, tick: int, at: Instant) -> Sequence[float]:
        """The angle that is measured now, rad: asks for it, and waits for the answer as long as is stated."""
        began = self._clock.now()
        self._hear()
        if began - self._sampled > self._silence:  # as before the first tick
            if self._rearming is not None:  # its wait begins anew: in a pause nobody has armed it
                self._rearming = began
            self._renew()
        else:
            self._ask()
            end = Instant(began + self._longest)
            while self._asked < began and (now := self._clock.now()) < end:
                self._port.wait(Duration(end - now))
                self._hear()
        self._sampled = now = self._clock.now()
        open_since = self._questions.oldest
        if open_since is not None and now - open_since > self._silence:
            raise MotorError(
                f"{self._port.path}: found no answer for {1e-6 * (now - open_since):.3g} ms; expected one within "
                f"{1e-6 * self._silence:g} ms: see that the controller has power and is plugged in"
            )
        self._check()
        age = seconds(Duration(now - self._asked)) + self._found.sensor_lag
        self._oldest = max(self._oldest, age)
        self._old += age > self._timing.sample_age
        return (self._x,)

    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> None:
        """Send the torque f, N·m, with a watchdog that ends it."""
        lives = LONGEST if until is None else Duration(min(LONGEST, until - at))
        self._give(f[0] if lives > 0 else 0.0, lives if lives > 0 else LONGEST)

    def release(self, at: Instant) -> None:
        """Send no torque."""
        self._give(0.0, LONGEST)

    def exerted(self) -> Sequence[float] | None:
        """No torque while the axis is disarmed, N·m; None otherwise, for no answer is newer than the last torque."""
        return None if self._armed else (0.0,)

    def figures(self) -> Mapping[str, float]:
        """What came late or not at all."""
        return {
            "oldest_ms": 1e3 * self._oldest,
            "older_than_stated": float(self._old),
            "unsent_torques": float(self._unsent),
            "watchdog_trips": float(self._trips),
        }

    def close(self) -> None:
        """Take the power from the motor, and close the port."""
        try:
            self._stop()
        except (PortError, ValueError, OSError):
            return  # it is gone, and the torque ends by itself
        finally:
            self._port.close()

    # --- both

    def _renew(self) -> None:
        """Wait for a new answer, after a pause in which nothing was asked."""
        self._trip()

    def _take(self, x: float, asked: Instant) -> None:
        """The angle of an answer, rad in the controller's own count, and when it was asked for."""
        self._x, self._asked = x - self._given["zero"], asked

    def _give(self, torque: float, lives: Duration) -> None:
        """Send a torque, unless the controller has not heard from us for too long: it would hear this one late.

        An axis that is disarmed is sent none: it would exert that as soon as it is armed again, at an instant that
        nobody knows. And no torque lasts long, so that the watchdog does not disarm the axis again meanwhile.
        """
        open_since = self._questions.oldest
        if open_since is not None and self._clock.now() - open_since > self._patience:
            self._unsent += 1
            return
        self._held = max(-self._most, min(self._most, torque))
        given = (self._held, lives) if self._armed else (0.0, LONGEST)
        self._unsent += not self._exert(given[0], seconds(given[1]))

    def _tripped(self) -> bool:
        """The axis is disarmed by its watchdog: whether this is news.

        Raises:
            MotorError: it does not come back.
        """
        now = self._clock.now()
        if self._rearming is None:
            self._rearming = now
            self._trips += self._held != 0.0
            return True
        if now - self._rearming > REARMING:
            raise MotorError(
                f"{self._port.path}: found the axis disarmed by its watchdog, and not back after "
                f"{seconds(REARMING):g} s; expected it to obey again: its next start clears all errors and arms it"
            )
        return False


def _checked(parameters: Mapping[str, Any], known: Mapping[str, object]) -> dict[str, Any]:
    """The parameters, with what holds where one is not given."""
    given = checked(parameters, known, ("silence", "sample_age", "actuation_delay"))
    for name, unit in (
        ("torque", "N·m"), ("range", "rad"), ("speed", "rad/s"), ("inertia", "kg·m²"), ("counts", "counts a turn"),
    ):  # fmt: skip
        value = given[name]
        if value is None and known[name] is None and name != "torque":
            continue
        if not is_number(value) or not value > 0.0:
            raise ValueError(f"parameters.{name}: found {value!r:.40}; expected a number of {unit} greater than 0")
    if not is_number(given["zero"]):
        raise ValueError(f"parameters.zero: found {given['zero']!r:.40}; expected an angle in rad")
    return given
