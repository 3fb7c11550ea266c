"""The driver of an ODrive of firmware 0.6: :class:`ODrive`.

    devices:
      knob: {dof: 1, driver: odrive, parameters: {port: /dev/ttyACM0, torque: 0.3}, osp: ..., limits: {...}}

It speaks the documented ASCII protocol (:mod:`manyhands.devices.odrive.lines`) over USB or a UART. The axis runs in
torque control with its input passed through. Before each torque its watchdog is set to what is left of the torque's
time, for ``c`` feeds it. An axis that its watchdog has disarmed is cleared and armed again.

Names and meanings of the properties are those of the maker's reference of firmware 0.6
(docs.odriverobotics.com, "ODrive API Reference", as of November 2026). Nothing is saved in the ODrive.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar, Final

from manyhands.devices.motor_axis import GREETING, LONGEST, PARAMETERS, TURN, Found, MotorAxis, MotorError
from manyhands.devices.odrive.lines import Answer, Error, Form, answer, command, said
from manyhands.protocol.clock import Instant, from_seconds, seconds

FIRMWARE: Final = (0, 6)
"""The major and minor version that this is written for."""

IDLE: Final = 1
CLOSED_LOOP: Final = 8
TORQUE_CONTROL: Final = 1
PASSTHROUGH: Final = 1

_ANSWER: Final = from_seconds(0.2)
_STATUS: Final = from_seconds(0.02)  # from one question for the axis' status to the next, at the latest
_TRIES: Final = 5
_GREETINGS: Final = 3
_ALL: Final = 1000

REMEDIES: Final[Mapping[Error, str]] = {
    Error.DC_BUS_UNDER_VOLTAGE: "see its supply and cables",
    Error.DC_BUS_OVER_VOLTAGE: "the motor fed back more than its supply takes; connect a brake resistor",
    Error.DC_BUS_OVER_REGEN_CURRENT: "the motor fed back more than its supply takes; connect a brake resistor",
    Error.MOTOR_OVER_TEMP: "let it cool, and ask for less torque",
    Error.INVERTER_OVER_TEMP: "let it cool, and ask for less torque",
    Error.VELOCITY_LIMIT_VIOLATION: "it was turned faster than vel_limit allows",
    Error.MISSING_ESTIMATE: "see its encoder",
    Error.BAD_CONFIG: "see its configuration in the maker's GUI",
    Error.SPINOUT_DETECTED: "see its encoder, and calibrate it",
    Error.CALIBRATION_ERROR: "calibrate it in the maker's GUI",
}
"""What to do about an error; about others the maker's reference has more."""


class ODrive(MotorAxis):
    """An axis of an ODrive as a device."""

    KNOWN: ClassVar[Mapping[str, object]] = {**PARAMETERS, "baud": 115200, "axis": 0}

    def _begin(self) -> Found:
        number = self._given["axis"]
        if isinstance(number, bool) or number not in (0, 1):
            raise ValueError(f"parameters.axis: found {number!r:.40}; expected 0 or 1")
        self._axis, self._of = number, f"axis{number}."
        self._coming = b""
        self._whole: str | None = None  # the property that was asked for last, of a whole number
        self._answers: list[Answer] = []  # while it starts
        self._state, self._reason = IDLE, 0
        self._lost = False  # whether it is not armed, and has told no reason since
        self._outdated = False  # whether the status that is still to come was asked for before it was armed again
        self._wondered = Instant(0)  # when a status was asked for last
        self._watchdog = math.nan  # s, as it was set last
        self._digits = 6  # of the angle, behind the point
        self._starting = True
        self._broken = self._complaints = 0
        self._port.write(b"\n")  # ends whatever it has heard before
        self._greet()
        found = self._configured()
        self._arm_first()
        self._starting = False
        return found

    # --- the start

    def _greet(self) -> None:
        found: tuple[float | None, float | None] = None, None
        for _ in range(_GREETINGS):
            major = self._number("fw_version_major")
            found = major, None if major is None else self._number("fw_version_minor")
            if found == FIRMWARE:
                return
            self._came(_ALL)  # what another program had asked for may still have come
        if found[0] is None:
            raise MotorError(
                f"{self._port.path}: found no answer of an ODrive; expected one: see that it has power, that its port "
                "speaks ASCII (config.usb_cdc_protocol, config.uart0_protocol), and that no other program has it"
            )
        text = ".".join("?" if one is None else f"{one:g}" for one in found)
        raise MotorError(
            f"{self._port.path}: found an ODrive of firmware {text}; expected {FIRMWARE[0]}.{FIRMWARE[1]}: other "
            "versions have other properties; update it in the maker's GUI"
        )

    def _answer(self, question: str, tries: int = _TRIES) -> Answer | None:
        """What is answered to a question; None for silence. Answers to its repetitions are waited for as well."""
        for again in range(tries):
            self._answers.clear()
            self._port.write(command(question))
            if self._came(1):
                found = self._answers[0]
                self._came(1 + again)
                return found
        return None

    def _came(self, number: int) -> bool:
        """Wait until so many answers have come."""
        end = Instant(self._clock.now() + _ANSWER)
        while len(self._answers) < number and self._clock.now() < end:
            self._port.wait(_ANSWER)
            self._hear()
        return len(self._answers) >= number

    def _number(self, name: str) -> float | None:
        """A property, or None where there is none of this name; nothing is asked meanwhile."""
        given = self._answer(f"r {name}")
        return given.numbers[0] if given is not None and len(given.numbers) == 1 else None

    def _required(self, name: str) -> float:
        value = self._number(name)
        if value is None:
            raise MotorError(
                f"{self._port.path}: found no property {name}; expected one: update the firmware in the maker's GUI"
            )
        return value

    def _set(self, name: str, value: float) -> None:
        """Set a property, and read it back."""
        self._port.write(command(f"w {name} {value:g}"))
        found = self._required(name)
        if not math.isclose(found, value, rel_tol=1e-4):
            raise MotorError(f"{self._port.path}: found {found:g} in {name}; expected {value:g}, which was written")

    def _configured(self) -> Found:
        """Put the axis into torque control, and read what lies inside the loop."""
        of = self._of
        self._port.write(command(f"w {of}requested_state {IDLE}"))
        self._set(f"{of}config.enable_watchdog", 0)
        self._set(f"{of}controller.config.control_mode", TORQUE_CONTROL)
        self._set(f"{of}controller.config.input_mode", PASSTHROUGH)
        self._set(f"{of}controller.config.enable_torque_mode_vel_limit", 0)
        self._set(f"{of}controller.input_torque", 0)
        most = min(
            self._required(f"{of}config.torque_soft_max"),
            -self._required(f"{of}config.torque_soft_min"),
            self._required(f"{of}config.motor.torque_constant") * self._required(f"{of}config.motor.current_soft_max"),
        )
        speed = TURN * self._required(f"{of}controller.config.vel_limit")
        current = self._required(f"{of}config.motor.current_control_bandwidth")
        sensor = self._required(f"{of}config.encoder_bandwidth")
        by_itself = [
            "counts a torque's time from its arrival: one that a stalled bus delivers late acts for up to its watchdog "
            "time after it",
            f"filters its encoder by a tracking loop of {sensor:g} rad/s, and controls its current at {current:g} "
            "rad/s: both are in the delays that are stated",
            "limits the torque by temperature, current and the power of its supply, and gives up beyond "
            f"{speed:.3g} rad/s (vel_limit) by its tolerance",
        ]
        if self._number(f"{of}config.anticogging.enabled"):
            by_itself.append("compensates the motor's cogging by a torque of its own (config.anticogging)")
        if self._answer(f"f {self._axis}") is None:
            raise MotorError(f"{self._port.path}: found no angle of axis {self._axis}; expected one")
        return Found(
            torque=most,
            low=-math.inf,
            high=math.inf,
            speed=speed,
            sensor_lag=0.5 / sensor,
            motor_lag=1.0 / current,
            step=TURN * 10.0**-self._digits,
            by_itself=tuple(by_itself),
        )

    def _arm_first(self) -> None:
        """Clear errors, switch the watchdog on, and wait until the axis is in closed loop control."""
        of = self._of
        self._set(f"{of}config.watchdog_timeout", seconds(GREETING))
        self._port.write(command(f"u {self._axis}"))
        self._set(f"{of}config.enable_watchdog", 1)
        self._port.write(command(f"u {self._axis}") + command("sc"))
        if errors := int(self._required(f"{of}active_errors")):
            raise self._failed(errors, "active errors")
        self._port.write(command(f"w {of}requested_state {CLOSED_LOOP}"))
        end = Instant(self._clock.now() + GREETING)
        while self._clock.now() < end:
            self._port.write(command(f"c {self._axis} 0"))
            self._state = int(self._required(f"{of}current_state"))
            if self._state == CLOSED_LOOP:
                return
            self._reason = int(self._required(f"{of}disarm_reason"))
            if self._reason:
                raise self._failed(self._reason, "the disarm reason")
        raise MotorError(
            f"{self._port.path}: found the axis in state {self._state}; expected {CLOSED_LOOP} (closed loop control): "
            "calibrate motor and encoder in the maker's GUI, and save"
        )

    def _failed(self, errors: int, what: str) -> MotorError:
        remedies = [text for error, text in REMEDIES.items() if errors & error] or ["see the maker's list of errors"]
        return MotorError(
            f"{self._port.path}: found {what} {said(errors)}; expected none: {'; '.join(remedies)}. Its next start "
            "clears it"
        )

    # --- the loop

    def _ask(self) -> None:
        now = self._clock.now()
        # two forms in turn, so that a late answer is not taken for one to the newest question
        if Form.PAIR not in self._questions:
            self._questions.ask(Form.PAIR, now)
            self._port.write(command(f"f {self._axis}"))
        elif Form.FRACTION not in self._questions:
            self._questions.ask(Form.FRACTION, now)
            self._port.write(command(f"r {self._of}pos_estimate"))

    def _status(self, now: Instant) -> bytes:
        self._whole = "disarm_reason" if self._whole == "current_state" else "current_state"
        self._questions.ask(Form.WHOLE, now)
        return command(f"r {self._of}{self._whole}")

    def idle(self, due: Instant) -> None:
        """Ask for the axis' status, where nothing else was asked: of two answers at a time one may be discarded.

        After :data:`_STATUS` it is asked in any case: on a busy machine a question may always be open.
        """
        self._hear()
        now = self._clock.now()
        if not len(self._questions) or (Form.WHOLE not in self._questions and now - self._wondered > _STATUS):
            self._wondered = now
            self._port.write(self._status(now))

    def _exert(self, value: float, lives: float) -> bool:
        lines = b""
        if (lives := math.floor(1e4 * lives) / 1e4) != self._watchdog:
            lines = command(f"w {self._of}config.watchdog_timeout {max(lives, 1e-4):.4f}")
        sent = self._port.write(lines + command(f"c {self._axis} {value:.6g}"))
        self._watchdog = lives if sent else math.nan
        return sent

    def _stop(self) -> None:
        if hasattr(self, "_of"):
            self._port.write(command(f"c {self._axis} 0") + command(f"w {self._of}requested_state {IDLE}"))

    @property
    def _armed(self) -> bool:
        return self._state == CLOSED_LOOP and not self._reason

    def _hear(self) -> None:
        *lines, self._coming = (self._coming + self._port.read()).split(b"\n")
        self._coming = self._coming[-512:]
        for line in lines:
            if not (line := line.strip()):
                continue
            given = answer(line)
            if given is None:
                self._broken += 1
            elif self._starting:
                self._answers.append(given)
                if given.form is Form.PAIR:
                    self._digits = len(given.text.split()[0].partition(".")[2])
            else:
                self._heard(given)

    def _heard(self, given: Answer) -> None:
        if given.form is Form.TEXT:
            self._complaints += 1
            return
        asked = self._questions.answer(given.form)
        if asked is None:
            self._broken += 1
        elif given.form is not Form.WHOLE:
            self._take(TURN * given.numbers[0], asked)
        else:
            if self._outdated:
                self._outdated = False
            elif self._whole == "current_state":
                self._state = int(given.numbers[0])
                self._lost = self._lost and self._state != CLOSED_LOOP
            else:
                self._reason = int(given.numbers[0])
                self._lost = not self._reason and self._state != CLOSED_LOOP

    def _check(self) -> None:
        if not math.isfinite(self._x):
            raise MotorError(f"{self._port.path}: found the angle {self._x}; expected a number: see its encoder")
        if self._armed:
            self._rearming = None
        elif self._reason == Error.WATCHDOG_TIMER_EXPIRED:
            self._tripped()
            self._port.write(self._arming())
        elif self._reason:
            raise self._failed(self._reason, "the disarm reason")
        elif self._rearming is not None:
            self._tripped()
        elif self._lost:
            raise MotorError(
                f"{self._port.path}: found the axis in state {self._state} without an error; expected {CLOSED_LOOP} "
                "(closed loop control): it has started anew, or another program commands it; see its supply, and end "
                "the other program"
            )

    def _arming(self) -> bytes:
        """The lines that arm an axis which its watchdog had disarmed; what was asked before tells nothing any more."""
        self._reason, self._state, self._lost = 0, IDLE, False
        self._outdated = Form.WHOLE in self._questions
        # feeding first, for a watchdog that is still expired would be the next error at once; for long, as the time of
        # the last torque may be over before the next one comes; and by no torque, for the last one would act again
        self._watchdog = seconds(LONGEST)
        long = command(f"w {self._of}config.watchdog_timeout {self._watchdog:.4f}")
        return (
            long + command(f"c {self._axis} 0") + command("sc") + command(f"w {self._of}requested_state {CLOSED_LOOP}")
        )

    def _renew(self) -> None:
        """Ask for the status as well: the watchdog may have disarmed an axis that nobody fed."""
        self._starting = True
        try:
            self._reason = int(self._required(f"{self._of}disarm_reason"))
            self._state = int(self._required(f"{self._of}current_state"))
        finally:
            self._starting = False
        self._lost = not self._reason and self._state != CLOSED_LOOP
        super()._renew()

    def figures(self) -> Mapping[str, float]:
        """What came late or not at all."""
        return {
            **super().figures(),
            "broken_lines": float(self._broken),
            "complaints": float(self._complaints),
        }
