"""The lines of ODrive's ASCII protocol: text and back. Pure.

By the maker's manual of firmware 0.6 (docs.odriverobotics.com, "ASCII Protocol", as of November 2026): a line is a
command, ``*`` and a checksum in decimal, the exclusive or of all characters before the ``*``. An answer has a checksum
where its question had one. Answers do not say what they answer, and one that would begin before the last has left is
discarded. So no two questions of one form of answer are open at a time (:class:`Form`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, IntFlag


class Form(Enum):
    """What an answer looks like."""

    PAIR = "two numbers"  # feedback
    FRACTION = "a number with a point"  # a property that is a float
    WHOLE = "a whole number"  # a property that is an integer or a truth value
    TEXT = "text"  # a complaint


class Error(IntFlag):
    """The errors of an axis, ``ODrive.Error`` of firmware 0.6."""

    INITIALIZING = 0x1
    SYSTEM_LEVEL = 0x2
    TIMING_ERROR = 0x4
    MISSING_ESTIMATE = 0x8
    BAD_CONFIG = 0x10
    DRV_FAULT = 0x20
    MISSING_INPUT = 0x40
    DC_BUS_OVER_VOLTAGE = 0x100
    DC_BUS_UNDER_VOLTAGE = 0x200
    DC_BUS_OVER_CURRENT = 0x400
    DC_BUS_OVER_REGEN_CURRENT = 0x800
    CURRENT_LIMIT_VIOLATION = 0x1000
    MOTOR_OVER_TEMP = 0x2000
    INVERTER_OVER_TEMP = 0x4000
    VELOCITY_LIMIT_VIOLATION = 0x8000
    POSITION_LIMIT_VIOLATION = 0x10000
    WATCHDOG_TIMER_EXPIRED = 0x1000000
    ESTOP_REQUESTED = 0x2000000
    SPINOUT_DETECTED = 0x4000000
    BRAKE_RESISTOR_DISARMED = 0x8000000
    THERMISTOR_DISCONNECTED = 0x10000000
    CALIBRATION_ERROR = 0x40000000


@dataclass(frozen=True)
class Answer:
    """A line that an ODrive has sent.

    Attributes:
        form: of it.
        numbers: in it; none of a text.
        text: as it came, without its checksum.
    """

    form: Form
    numbers: tuple[float, ...]
    text: str


def command(text: str) -> bytes:
    """A line with its checksum."""
    body = text.encode("ascii") + b" "
    return body + b"*%d\n" % _xor(body)


def answer(line: bytes) -> Answer | None:
    """What a line says; None where it has no checksum, or a wrong one."""
    body, star, claimed = line.rpartition(b"*")
    if not star or not claimed.strip().isdigit() or int(claimed) != _xor(body):
        return None
    text = body.decode("ascii", "replace").strip()
    words = text.split()
    try:
        numbers = tuple(map(float, words))
    except ValueError:
        return Answer(Form.TEXT, (), text)
    if len(numbers) == 2:
        return Answer(Form.PAIR, numbers, text)
    if len(numbers) != 1:
        return Answer(Form.TEXT, (), text)
    fraction = "." in text or not math.isfinite(numbers[0])
    return Answer(Form.FRACTION if fraction else Form.WHOLE, numbers, text)


def said(errors: int) -> str:
    """The names of errors, as ``DC_BUS_UNDER_VOLTAGE``."""
    names = [one.name or "" for one in Error if errors & one]
    known = sum(one for one in Error if errors & one)
    return " | ".join([*names, *([f"0x{errors & ~known:x}"] if errors & ~known else [])]) or "none"


def _xor(data: bytes) -> int:
    found = 0
    for byte in data:
        found ^= byte
    return found
