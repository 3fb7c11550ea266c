"""Frames of the register protocol of moteus, and the lines of fdcanusb that carry them: bytes to values and back. Pure.

By the maker's documents, as of November 2026: registers and mappings in mjbots/moteus ``docs/protocol/registers.md``,
subframes and CAN ids in ``docs/protocol/can.md``, the lines' checksum in ``docs/integration/uart.md``, and the lines in
mjbots/fdcanusb ``README.md``. The maker's Python package is the second source that the tests hold these bytes against.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from enum import IntEnum
from typing import Final

REGISTER_MAP: Final = 5
"""The version of the register map that this is written for, of register 0x102."""

FIRST_SOURCE: Final = 0x70
SOURCES: Final = 16
"""A question's CAN source is one of these; an answer goes to it, so that it names its question."""

FIRMWARE: Final = 0x101
MAP_VERSION: Final = 0x102


class Register(IntEnum):
    """What is asked in every tick."""

    MODE = 0x000
    POSITION = 0x001
    VELOCITY = 0x002
    TORQUE = 0x003
    VOLTAGE = 0x00D
    TEMPERATURE = 0x00E
    FAULT = 0x00F
    MILLISECONDS = 0x070


class Mode(IntEnum):
    """Register 0x000; 2 to 4 are steps on the way to any that drives the motor."""

    STOPPED = 0
    FAULT = 1
    ENABLING = 2
    CALIBRATING = 3
    CALIBRATED = 4
    POSITION = 10
    TIMEOUT = 11


QUERY: Final = bytes([0x11, 0x00, 0x1F, 0x01, 0x13, 0x0D, 0x19, 0x70])
"""Read mode as int8, position, velocity and torque as float, voltage, temperature and fault as int8, and the counter of
milliseconds as int32: it begins anew with a controller that has lost its power, and with it what it was told."""

VERSIONS: Final = bytes([0x1A, 0x81, 0x02])
"""Read the versions of firmware and register map, 0x101 and 0x102, as int32."""

STOP: Final = bytes([0x01, 0x00, Mode.STOPPED])

_NOP: Final = 0x50
_SIZES: Final = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
"""Bytes that a CAN-FD frame can have."""

_TYPES: Final = (struct.Struct("<b"), struct.Struct("<h"), struct.Struct("<i"), struct.Struct("<f"))
_HALF_VOLT: Final = 0.5
"""V, of an int8."""

_DIAGNOSTIC: Final = 1  # the channel of the text console
_MOST_TEXT: Final = 61
_POLL: Final = 48


def torque(value: float, most: float, lives: float) -> bytes:
    """A pure torque: position mode, with no proportional, derivative or integral part.

    Position is "as it is" (the least int8) and its velocity 0, so that the position's own error is none. Limits of
    velocity and acceleration are off, as no trajectory is meant: with one, an inertia's feedforward would be added.

    Args:
        value: N·m.
        most: the greatest torque, N·m.
        lives: until the controller's watchdog ends it, s.
    """
    return b"".join(
        (
            bytes([0x01, 0x00, Mode.POSITION]),
            bytes([0x02, 0x20, 0x80, 0x00]),  # position and velocity
            struct.pack("<BBf", 0x0D, 0x22, value),  # feedforward torque
            bytes([0x02, 0x23, 0x00, 0x00]),  # scales of kp and kd
            struct.pack("<BBf", 0x0D, 0x25, most),
            struct.pack("<BBf", 0x0D, 0x27, lives),
            bytes([0x02, 0x28, 0xFF, 0xFF]),  # less than 0: no limit of velocity and acceleration
            bytes([0x01, 0x2B, 0x00]),  # the scale of the integral's limit
        )
    )


def diagnostic(text: bytes) -> bytes:
    """A line for the controller's text console; at most 61 bytes."""
    if len(text) > _MOST_TEXT:
        raise ValueError(f"found {len(text)} bytes; expected at most {_MOST_TEXT}")
    return bytes([0x40, _DIAGNOSTIC, len(text)]) + text


DIAGNOSTIC_POLL: Final = bytes([0x42, _DIAGNOSTIC, _POLL])


def can_id(source: int, destination: int, answered: bool) -> int:
    """The CAN id of a frame to a controller; ``answered`` asks it for an answer."""
    return (0x8000 if answered else 0) | source << 8 | destination


def command(identifier: int, payload: bytes, sealed: bool = False) -> bytes:
    """The line that sends a frame, padded to a size that CAN-FD has; ``sealed`` with a checksum."""
    size = next(size for size in _SIZES if size >= len(payload))
    text = b"can send %04x %s" % (identifier, (payload + bytes([_NOP]) * (size - len(payload))).hex().encode())
    return (seal(text) if sealed else text) + b"\n"


def crc8(data: bytes) -> int:
    """CRC-8 with the polynomial 0x97, most significant bit first, that begins with 0."""
    crc = 0
    for byte in data:
        crc = _CRC[crc ^ byte]
    return crc


def _of(byte: int) -> int:
    for _ in range(8):
        byte = byte << 1 ^ (0x197 if byte & 0x80 else 0)
    return byte


_CRC: Final = tuple(_of(byte) for byte in range(256))


def seal(text: bytes) -> bytes:
    """A line with its checksum, without its end."""
    return text + b" *%02X" % crc8(text + b" ")


def unseal(line: bytes) -> tuple[bytes, bool] | None:
    """A line without its checksum, and whether it had one; None where that is wrong."""
    if line[-3:-2] != b"*":
        return line, False
    try:
        claimed = int(line[-2:], 16)
    except ValueError:
        return None
    return (line[:-3].rstrip(b" "), True) if crc8(line[:-3]) == claimed else None


def received(line: bytes) -> tuple[int, int, bytes] | None:
    """Source, destination and payload of a line that reports a frame; None where it is none."""
    words = line.split()
    if len(words) < 3 or words[0] != b"rcv":
        return None
    try:
        identifier, payload = int(words[1], 16), bytes.fromhex(words[2].decode("ascii"))
    except ValueError:
        return None
    return identifier >> 8 & 0x7F, identifier & 0x7F, payload


def registers(payload: bytes) -> Mapping[int, float] | None:
    """The registers of an answer, ints in the units of :class:`Register`; None where it is none.

    Raises nothing: what is cut off, or is no answer, is None.
    """
    found: dict[int, float] = {}
    at = 0
    while at < len(payload):
        kind = payload[at]
        at += 1
        if kind == _NOP:
            continue
        if kind & 0xF0 != 0x20:
            return None
        count, layout = kind & 0x03, kind >> 2 & 0x03
        if not count:
            if (read := _varuint(payload, at)) is None:
                return None
            count, at = read
        if (read := _varuint(payload, at)) is None:
            return None
        first, at = read
        size = _TYPES[layout].size
        if at + count * size > len(payload):
            return None
        for register in range(first, first + count):
            (value,) = _TYPES[layout].unpack_from(payload, at)
            found[register] = value * _HALF_VOLT if register == Register.VOLTAGE and layout == 0 else value
            at += size
    return found


def console(payload: bytes) -> bytes | None:
    """The text of an answer to a poll of the console; None where it is none."""
    if len(payload) < 3 or payload[0] != 0x41 or payload[1] != _DIAGNOSTIC:
        return None
    return payload[3 : 3 + payload[2]]


def _varuint(data: bytes, at: int) -> tuple[int, int] | None:
    value = 0
    for shift in range(0, 35, 7):
        if at >= len(data):
            return None
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    return None
