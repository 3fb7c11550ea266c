"""The frames of the board protocol, version 1: bytes to messages and back. Pure; PROTOCOL.md beside it has the layout.

A frame is COBS(payload, CRC) and a zero byte [Cheshire1999]_, with the CRC-16 of ITU-T V.41 that begins with 0xFFFF.
The board's end of it is ``firmware/mhb.c``; both are held to the same vectors.
"""

from __future__ import annotations

import math
import struct
from binascii import crc_hqx
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import IntFlag
from typing import Final

VERSION: Final = 1
MOST_AXES: Final = 6
MOST_FRAME: Final = 162
"""Bytes of the longest frame, its end included: an About of six axes has 157."""

_HELLO, _FORCE, _ABOUT, _STATE = 0x01, 0x02, 0x81, 0x82
_NAME: Final = 16
_HELLO_LAYOUT: Final = struct.Struct("<BBBI")
_FORCE_LAYOUT: Final = struct.Struct("<BHI")
_ABOUT_LAYOUT: Final = struct.Struct(f"<BBI{_NAME}sBBBII")
_STATE_LAYOUT: Final = struct.Struct("<BHHIBB")
_OF_AXES: Final = 5  # force, displacement, speed, step and mass


class Feature(IntFlag):
    """What a board is."""

    TELLS_WORK = 0x01
    HOLDS_TORQUE = 0x02


NOTHING: Final = Feature(0)


class Status(IntFlag):
    """The state of a board."""

    CALIBRATED = 0x01
    READY = 0x02
    SATURATED = 0x04
    EXPIRED = 0x08
    BRAKED = 0x10
    FAULT = 0x20


@dataclass(frozen=True)
class About:
    """What a board answers to a hello.

    Attributes:
        version: the protocol's that it speaks; with any other than :data:`VERSION` the other fields are empty.
        nonce: that of the hello.
        name: of the board.
        rotations: by axis, whether it turns; then m, N and m/s are rad, N·m and rad/s.
        features: what it is.
        period: from one state to the next, s.
        longest: the longest time that a force may live, s.
        force: the greatest force of each axis, N.
        displacement: the greatest displacement from 0 of each axis, m.
        speed: the greatest speed of each axis that it measures rightly, m/s.
        step: of its encoders, m; 0 where it is not known.
        mass: the least moving mass of each axis, kg; 0 where it is not known.
    """

    version: int
    nonce: int
    name: str = ""
    rotations: tuple[bool, ...] = ()
    features: Feature = NOTHING
    period: float = 0.0
    longest: float = 0.0
    force: tuple[float, ...] = ()
    displacement: tuple[float, ...] = ()
    speed: tuple[float, ...] = ()
    step: tuple[float, ...] = ()
    mass: tuple[float, ...] = ()

    @property
    def axes(self) -> int:
        """Number of axes."""
        return len(self.force)


@dataclass(frozen=True)
class State:
    """What a board sends in each of its periods.

    Attributes:
        number: counts the states since the hello, modulo 2^16.
        answers: the number of the last force that it took; None before the first.
        at: when the displacement was measured, by the board's clock in us, modulo 2^32.
        status: of the board.
        x: displacement, m, one entry an axis.
        f: the force that it exerts, N, one entry an axis.
        work: of its motors since it was switched on, J; None where it does not tell.
    """

    number: int
    answers: int | None
    at: int
    status: Status
    x: tuple[float, ...]
    f: tuple[float, ...]
    work: float | None


def crc(data: bytes) -> int:
    """CRC-16 of ITU-T V.41, most significant bit first, that begins with 0xFFFF and inverts nothing."""
    return crc_hqx(data, 0xFFFF)


def coded(data: bytes) -> bytes:
    """The COBS code of ``data``, without a zero byte in it [Cheshire1999]_."""
    out = bytearray()
    blocks = data.split(b"\0")
    for last, block in enumerate(blocks, start=1 - len(blocks)):
        while len(block) >= 254:
            out += b"\xff" + block[:254]
            block = block[254:]
            if not block and last == 0:
                return bytes(out)
        out.append(len(block) + 1)
        out += block
    return bytes(out)


def decoded(code: bytes) -> bytes | None:
    """The data of a COBS code; None where it is none."""
    out, at = bytearray(), 0
    while at < len(code):
        block = code[at]
        if not block or at + block > len(code):
            return None
        data = code[at + 1 : at + block]
        if 0 in data:
            return None
        out += data
        at += block
        if block < 255 and at < len(code):
            out.append(0)
    return bytes(out)


def sealed(payload: bytes) -> bytes:
    """The frame of a payload: with its checksum, coded, and ended."""
    return coded(payload + crc(payload).to_bytes(2, "little")) + b"\0"


def opened(code: bytes) -> bytes | None:
    """The payload of a frame, without its end; None where it is no code, or its checksum is wrong."""
    data = decoded(code)
    if data is None or len(data) < 3 or crc(data[:-2]) != int.from_bytes(data[-2:], "little"):
        return None
    return data[:-2]


def hello(nonce: int) -> bytes:
    """The frame that begins a conversation; ``nonce`` (32 bits) comes back in the answer."""
    return sealed(_HELLO_LAYOUT.pack(_HELLO, VERSION, VERSION, nonce))


def force(number: int, until: int, f: Sequence[float]) -> bytes:
    """The frame of a force.

    Args:
        number: counts the forces, modulo 2^16.
        until: when it ends, by the board's clock, us, modulo 2^32. A force that comes later is none.
        f: the force, N, one entry an axis.
    """
    return sealed(_FORCE_LAYOUT.pack(_FORCE, number & 0xFFFF, until & 0xFFFFFFFF) + struct.pack(f"<{len(f)}f", *f))


def read(payload: bytes, axes: int) -> About | State | None:
    """The message of a payload, without its checksum; None where it is none for a board of so many axes."""
    if payload[:1] == bytes([_ABOUT]):
        return _about(payload)
    return _state(payload, axes) if payload[:1] == bytes([_STATE]) else None


def _about(payload: bytes) -> About | None:
    if len(payload) < 6:
        return None
    if payload[1] != VERSION:
        return About(payload[1], int.from_bytes(payload[2:6], "little"))
    if len(payload) < _ABOUT_LAYOUT.size:
        return None
    _, version, nonce, name, axes, rotations, features, period, longest = _ABOUT_LAYOUT.unpack_from(payload)
    if not 0 < axes <= MOST_AXES or len(payload) != _ABOUT_LAYOUT.size + 4 * _OF_AXES * axes:
        return None
    # a decimal of seven digits comes back as itself: 0.7 N would otherwise be less than a session's 0.7
    numbers = [float(f"{one:.7g}") for one in struct.unpack_from(f"<{_OF_AXES * axes}f", payload, _ABOUT_LAYOUT.size)]
    of_axes = [tuple(numbers[i * axes : (i + 1) * axes]) for i in range(_OF_AXES)]
    positive, known = of_axes[:3], of_axes[3:]
    if not all(0.0 < one < math.inf for row in positive for one in row):
        return None
    if not all(0.0 <= one < math.inf for row in known for one in row) or not period or not longest:
        return None
    text = name.rstrip(b"\0").decode("ascii", "replace")
    turns = tuple(bool(rotations >> axis & 1) for axis in range(axes))
    return About(version, nonce, text, turns, Feature(features & 0x03), 1e-6 * period, 1e-6 * longest, *of_axes)


def _state(payload: bytes, axes: int) -> State | None:
    short = _STATE_LAYOUT.size + 8 * axes
    if len(payload) not in (short, short + 8):
        return None
    _, number, answers, at, status, any_force = _STATE_LAYOUT.unpack_from(payload)
    numbers = struct.unpack_from(f"<{2 * axes}f", payload, _STATE_LAYOUT.size)
    if not all(map(math.isfinite, numbers)):
        return None
    work = None if len(payload) == short else 1e-9 * int.from_bytes(payload[short:], "little", signed=True)
    answered = answers if any_force else None
    return State(number, answered, at, Status(status & 0x3F), numbers[:axes], numbers[axes:], work)


class Reader:
    """Frames out of a stream of bytes, however it is cut.

    Attributes:
        axes: of the board; states are read once it is known.
        broken: the number of frames that were none, or of no message.
    """

    def __init__(self) -> None:
        self.axes = 0
        self.broken = 0
        self._coming, self._lost = bytearray(), False

    def take(self, data: bytes) -> Iterator[About | State]:
        """The messages that end in ``data``."""
        *ended, rest = data.split(b"\0")
        for piece in ended:
            self._add(piece)
            code, lost = bytes(self._coming), self._lost
            self._coming.clear()
            self._lost = False
            if not lost and not code:
                continue  # two ends in a row: a board may send one first, to end what was noise
            payload = None if lost else opened(code)
            message = None if payload is None else read(payload, self.axes)
            if message is None:
                self.broken += 1
            else:
                yield message
        self._add(rest)

    def _add(self, piece: bytes) -> None:
        if len(self._coming) + len(piece) >= MOST_FRAME:
            self._lost = True
            self._coming.clear()
        elif not self._lost:
            self._coming += piece
