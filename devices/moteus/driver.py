"""The driver of a moteus controller: :class:`Moteus`.

    devices:
      knob: {dof: 1, driver: moteus, parameters: {port: /dev/ttyACM0, torque: 0.3}, osp: ..., limits: {...}}

It speaks the documented register protocol (:mod:`manyhands.devices.moteus.frames`) through fdcanusb, or through a UART,
where the controller itself plays fdcanusb. A torque is a position-mode command without any gain, with a watchdog of its
own in each frame. The watchdog's end is set to "stopped" by the text console, in the controller's memory alone: the
factory's end brakes the motor.

At the start the driver reads what lies inside the loop, and what it cannot switch off it states.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar, Final

from manyhands.devices.moteus.frames import (
    DIAGNOSTIC_POLL,
    FIRMWARE,
    FIRST_SOURCE,
    MAP_VERSION,
    QUERY,
    REGISTER_MAP,
    SOURCES,
    STOP,
    VERSIONS,
    Mode,
    Register,
    can_id,
    command,
    console,
    diagnostic,
    received,
    registers,
    torque,
    unseal,
)
from manyhands.devices.motor_axis import AGAIN, GREETING, LONGEST, PARAMETERS, TURN, Found, MotorAxis, MotorError
from manyhands.protocol.clock import Instant, seconds

TRIES: Final = 3
"""How often a line for the console is sent until it is answered."""

FLOAT: Final = 2.0**-24
"""Relative; half of a step of the floats in which a controller sends its turns."""

FAULTS: Final[Mapping[int, str]] = {
    32: "calibration: it saw no magnet; see its distance from the chip",
    33: "motor driver: most often its supply could not give the current; use a stronger one or less torque",
    34: "over voltage: the motor fed back more than its supply takes; use one that can sink power, or a flux brake",
    35: "encoder: its readings are not those of a magnet; see its mount",
    36: "motor not configured: run moteus_tool --calibrate",
    37: "PWM overrun, an error of its firmware",
    38: "over temperature: let it cool, and ask for less torque",
    39: "outside limit: turn the motor to between servopos.position_min and position_max",
    40: "under voltage: see its supply and cables",
    41: "configuration changed: another program has changed it",
    42: "no commutation encoder is valid",
    43: "no output encoder is valid: home it as its configuration asks for",
    44: "driver enable: its gate driver could not be switched on",
    46: "timing violation, an error of its firmware",
    47: "servo.bemf_feedforward needs a limit of acceleration, and a torque has none: set it to 0",
    48: "servopos.position_min or position_max lies outside the possible range",
}
"""Register 0x00f in mode 1, by the maker's list, and what to do."""

_LIMITED: Final = range(96, 104)
"""Register 0x00f of a controller that obeys, and limits the torque by its own configuration."""

_PREPARING: Final = (Mode.STOPPED, Mode.ENABLING, Mode.CALIBRATING, Mode.CALIBRATED)


class Moteus(MotorAxis):
    """A moteus controller as a device of one axis."""

    KNOWN: ClassVar[Mapping[str, object]] = {**PARAMETERS, "baud": 921600, "id": 1}

    def _begin(self) -> Found:
        self._id = self._given["id"]
        if isinstance(self._id, bool) or not isinstance(self._id, int) or not 1 <= self._id < FIRST_SOURCE:
            raise ValueError(f"parameters.id: found {self._id!r:.40}; expected an id from 1 to {FIRST_SOURCE - 1}")
        self._source = 0  # counts questions
        self._sealed = False  # whether lines have checksums
        self._coming, self._text = b"", b""
        self._mode, self._fault, self._numbers = -1, 0, dict[int, float]()
        self._voltage = self._temperature = math.nan
        self._counted: int | None = None  # its milliseconds
        self._anew = False  # whether they have begun anew
        self._stopped = Instant(0)  # when it was stopped last
        self._broken = self._refused = self._limited = 0
        self._port.write(b"\ncan on\n")  # of a converter that has not begun; any other says ERR
        self._until(Mode.STOPPED, STOP)
        self._versions()
        found = self._configured()
        self._until(Mode.POSITION, torque(0.0, self._most, seconds(LONGEST)))
        return found

    # --- the start

    def _until(self, mode: Mode, payload: bytes) -> None:
        """Send a command until the controller says that it is in this mode."""
        end, due = Instant(self._clock.now() + GREETING), self._clock.now()
        while (now := self._clock.now()) < end:
            if now >= due:
                self._questions.forget()
                if self._mode == Mode.TIMEOUT and mode != Mode.STOPPED:  # a pause: it leaves this mode by a stop alone
                    self._send(STOP)
                self._send(payload)
                self._ask()
                due = Instant(now + AGAIN)
            self._port.wait(AGAIN)
            self._hear()
            if self._mode == mode:
                return
            if self._mode == Mode.FAULT and mode != Mode.STOPPED:
                raise self._faulty()
        if self._mode < 0:
            raise MotorError(
                f"{self._port.path}: found no answer of a moteus {self._id} within {seconds(GREETING):g} s; expected "
                "one: see that it has power, that its id and the CAN cable are right, and that no other program "
                "has the port"
            )
        raise MotorError(f"{self._port.path}: found the moteus in mode {self._mode}; expected {mode.value} on command")

    def _awaited(self, payload: bytes) -> bool:
        """Ask something else than the angle, and wait a while; whether it was answered."""
        self._questions.forget()
        self._send(payload, answered=True)
        end = Instant(self._clock.now() + AGAIN)
        while len(self._questions) and self._clock.now() < end:
            self._port.wait(AGAIN)
            self._hear()
        return not len(self._questions)

    def _versions(self) -> None:
        for _ in range(10 * TRIES):  # on a bus that loses a frame
            self._awaited(VERSIONS)
            version = self._numbers.get(MAP_VERSION)
            if version == REGISTER_MAP:
                return
            if version is not None:
                firmware = int(self._numbers.get(FIRMWARE, 0))
                raise MotorError(
                    f"{self._port.path}: found a moteus with register map {version:g} (firmware 0x{firmware:06x}); "
                    f"expected {REGISTER_MAP}: flash a firmware of it by moteus_tool"
                )
        raise MotorError(f"{self._port.path}: found no version of the register map; expected {REGISTER_MAP}")

    def _said(self, line: str) -> str:
        """The console's answer to a line."""
        for _ in range(TRIES):
            end = Instant(self._clock.now() + GREETING)
            while self._polled() and self._clock.now() < end:
                self._text = b""  # of an earlier line, which came late
            self._send(diagnostic(line.encode() + b"\n"))
            while b"\n" not in self._text and self._clock.now() < end:
                self._polled()
            if b"\n" in self._text:
                break
        said, self._text = self._text, b""
        return said.decode("ascii", "replace").strip()

    def _polled(self) -> bool:
        """Ask for what the console has said; whether more may come."""
        before = len(self._text)
        return not self._awaited(DIAGNOSTIC_POLL) or len(self._text) > before

    def _setting(self, name: str) -> float:
        """A number of its configuration."""
        said = self._said(f"conf get {name}")
        try:
            return float(said)
        except ValueError:
            raise MotorError(
                f"{self._port.path}: found {said!r:.60} for the setting {name}; expected a number: flash a newer "
                "firmware by moteus_tool"
            ) from None

    def _configured(self) -> Found:
        """Read what lies inside the loop, and switch off what can be."""
        self._said("conf set servo.timeout_mode 0")
        if (mode := self._setting("servo.timeout_mode")) != 0:
            raise MotorError(
                f"{self._port.path}: found servo.timeout_mode {mode:g}; expected 0, for the watchdog's end must leave "
                "the motor without torque"
            )
        if self._setting("servo.fixed_voltage_mode"):
            raise MotorError(
                f"{self._port.path}: found servo.fixed_voltage_mode; expected 0, for no torque is controlled in it"
            )
        current = self._setting("servo.pid_dq_hz")
        source = int(self._setting("motor_position.output.source"))
        filtered = self._setting(f"motor_position.sources.{source}.pll_filter_hz")
        low, high = self._setting("servopos.position_min"), self._setting("servopos.position_max")
        speed = TURN * self._setting("servo.max_velocity")
        by_itself = [
            "counts a torque's time from its arrival: one that a stalled bus delivers late acts for up to its watchdog "
            "time after it",
            f"filters its encoder by a tracking loop of {filtered:g} Hz, and controls its current at {current:g} Hz: "
            "both are in the delays that are stated",
            f"limits the torque near {speed:.3g} rad/s (servo.max_velocity), and by its temperature, power and voltage",
        ]
        if self._setting("motor.cogging_dq_scale"):
            by_itself.append("compensates the motor's cogging by a torque of its own (motor.cogging_dq_scale)")
        if self._setting("servo.voltage_mode_control"):
            by_itself.append("turns torques into voltages (servo.voltage_mode_control): at speed they are not exact")
        if rate := self._setting("servo.max_current_desired_rate"):
            by_itself.append(f"lets its current change by at most {rate:g} A/s (servo.max_current_desired_rate)")
        low, high = (-math.inf if math.isnan(low) else low), (math.inf if math.isnan(high) else high)
        reach = self._given["range"] + abs(self._given["zero"])
        return Found(
            torque=math.inf,
            low=TURN * low,
            high=TURN * high,
            speed=speed,
            # the tracking loop's corner of 3 dB is at 2.48 of its natural frequency, for it is critically damped
            sensor_lag=2.48 / (2.0 * TURN * filtered) if filtered else 0.0,
            motor_lag=1.0 / (TURN * current),
            step=2.0 * FLOAT * reach,
            by_itself=tuple(by_itself),
        )

    # --- the loop

    def _send(self, payload: bytes, answered: bool = False) -> bool:
        source = FIRST_SOURCE + self._source
        if answered:
            if source in self._questions:  # sixteen are open: an answer must not be taken for that to a newer one
                return False
            self._questions.ask(source, self._clock.now())
            self._source = (self._source + 1) % SOURCES
        return self._port.write(command(can_id(source, self._id, answered), payload, self._sealed))

    def _ask(self) -> None:
        self._send(QUERY, answered=True)

    def _exert(self, value: float, lives: float) -> bool:
        return self._send(torque(value, self._most, lives))

    def _stop(self) -> None:
        if hasattr(self, "_sealed"):
            self._send(STOP)

    @property
    def _armed(self) -> bool:
        return self._mode == Mode.POSITION

    def _hear(self) -> None:
        *lines, self._coming = (self._coming + self._port.read()).split(b"\n")
        self._coming = self._coming[-512:]
        for line in lines:
            self._line(line.strip())

    def _line(self, line: bytes) -> None:
        if (opened := unseal(line)) is None:
            self._broken += 1
            return
        text, sealed = opened
        self._sealed = self._sealed or sealed
        if text in (b"", b"OK"):
            return
        if text.startswith(b"ERR"):
            self._refused += 1
            return
        if (frame := received(text)) is None or frame[0] != self._id:
            self._broken += frame is None
            return
        _, source, payload = frame
        asked = self._questions.answer(source)
        if (said := console(payload)) is not None:
            self._text += said  # a late answer has it as well, and the controller has forgotten it
            return
        if asked is None:
            return
        if (numbers := registers(payload)) is None:
            self._broken += 1
            return
        self._numbers = dict(numbers)
        if Register.POSITION in numbers and Register.MODE in numbers:
            self._mode, self._fault = int(numbers[Register.MODE]), int(numbers.get(Register.FAULT, 0))
            self._voltage = numbers.get(Register.VOLTAGE, math.nan)
            self._temperature = numbers.get(Register.TEMPERATURE, math.nan)
            counted = int(numbers.get(Register.MILLISECONDS, 0))
            if self._counted is not None and (counted - self._counted) % (1 << 32) >= 1 << 31:
                self._anew = True
            self._counted = counted
            self._take(TURN * numbers[Register.POSITION], asked)

    def _check(self) -> None:
        mode = self._mode
        if self._anew:
            raise MotorError(
                f"{self._port.path}: found that the moteus has started anew; expected one that goes on: see its supply"
            )
        if mode == Mode.POSITION:
            self._rearming = None
            self._limited += self._fault in _LIMITED
            if not math.isfinite(self._x):
                raise MotorError(f"{self._port.path}: found the angle {self._x}; expected a number: calibrate it")
            return
        if mode == Mode.TIMEOUT:
            self._tripped()
            if self._asked > self._stopped:  # it leaves this mode by a stop alone
                self._send(STOP)
                self._stopped = self._clock.now()
            return
        if mode == Mode.FAULT:
            raise self._faulty()
        if mode in _PREPARING and self._rearming is not None:
            self._tripped()
            return
        raise MotorError(
            f"{self._port.path}: found the moteus in mode {mode}; expected {Mode.POSITION.value}: another program "
            "commands it; end that program"
        )

    def _faulty(self) -> MotorError:
        said = FAULTS.get(self._fault, "see the list of the maker")
        return MotorError(
            f"{self._port.path}: found the moteus with fault {self._fault}, {said}; expected none (it has "
            f"{self._voltage:g} V and {self._temperature:g} °C). Its next start clears the fault"
        )

    def figures(self) -> Mapping[str, float]:
        """What came late or not at all, was limited, and the state of its supply."""
        return {
            **super().figures(),
            "broken_lines": float(self._broken),
            "refused_lines": float(self._refused),
            "limited": float(self._limited),
            "volt": self._voltage,
            "celsius": self._temperature,
        }
