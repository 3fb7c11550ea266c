"""One event device of the kernel: ``open``, ``ioctl``, ``read`` and ``write``, and the bytes that go through them.

The numbers are those of ``linux/input.h`` and ``linux/input-event-codes.h``, and what the calls do is in the kernel's
``Documentation/input/ff.rst`` and ``drivers/input/{evdev,ff-core,ff-memless}.c``. A test compiles a program that prints
the sizes and numbers of the system's own header.
"""

from __future__ import annotations

import errno
import fcntl
import os
import struct
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple, Protocol

EV_SYN, EV_ABS, EV_FF = 0x00, 0x03, 0x15
SYN_REPORT, SYN_DROPPED = 0, 3
ABS_X, ABS_Y, ABS_WHEEL = 0x00, 0x01, 0x08
FF_RUMBLE, FF_CONSTANT, FF_GAIN, FF_AUTOCENTER = 0x50, 0x52, 0x60, 0x61

FULL: Final = 0x7FFF
"""The level of a constant force that is the device's greatest."""

LONGEST: Final = 0x7FFF
"""ms; the longest length that every kernel driver takes for what it is."""

EVENT: Final = struct.Struct("llHHi")
"""struct input_event: seconds, microseconds, type, code, value."""

ABSINFO: Final = struct.Struct("6i")
"""struct input_absinfo: value, minimum, maximum, fuzz, flat, resolution."""

_UNION: Final = 24 + struct.calcsize("P")
"""Bytes of the union in struct ff_effect; its largest member ends with a pointer."""

EFFECT: Final = struct.Struct(f"=HhH2H2H2xh4H{_UNION - 10}x")
"""struct ff_effect of a constant force: type, id, direction; trigger's button and interval; replay's length and delay;
level; the envelope's four numbers, which stay 0."""

_READ, _WRITE = 2, 1
_BITS: Final = 96  # bytes; KEY_MAX / 8 + 1
_AT_ONCE: Final = 64 * EVENT.size


def _number(direction: int, number: int, size: int) -> int:
    """_IOC of asm-generic/ioctl.h, with the type 'E'."""
    return direction << 30 | size << 16 | ord("E") << 8 | number


def EVIOCGBIT(kind: int) -> int:
    """Which codes of a type of event there are; type 0 for the types."""
    return _number(_READ, 0x20 + kind, _BITS)


def EVIOCGABS(axis: int) -> int:
    """An axis' value and range."""
    return _number(_READ, 0x40 + axis, ABSINFO.size)


def EVIOCSABS(axis: int) -> int:
    """Set an axis' range and filter."""
    return _number(_WRITE, 0xC0 + axis, ABSINFO.size)


EVIOCSFF: Final = _number(_WRITE, 0x80, EFFECT.size)
EVIOCRMFF: Final = _number(_WRITE, 0x81, 4)
EVIOCGRAB: Final = _number(_WRITE, 0x90, 4)
EVIOCSCLOCKID: Final = _number(_WRITE, 0xA0, 4)


class Calls(Protocol):
    """The kernel's calls that this module makes; each raises :class:`OSError`."""

    def open(self, path: str, flags: int) -> int:
        """A descriptor of the file."""

    def close(self, fd: int) -> None:
        """Close a descriptor."""

    def read(self, fd: int, size: int) -> bytes:
        """At most ``size`` bytes."""

    def write(self, fd: int, data: bytes) -> int:
        """How many bytes were written."""

    def ioctl(self, fd: int, request: int, argument: bytearray | int) -> int:
        """Ask the device; a bytearray is read and overwritten."""


class Kernel:
    """:class:`Calls` of the kernel itself."""

    def open(self, path: str, flags: int) -> int:
        """os.open."""
        return os.open(path, flags)

    def close(self, fd: int) -> None:
        """os.close."""
        os.close(fd)

    def read(self, fd: int, size: int) -> bytes:
        """os.read."""
        return os.read(fd, size)

    def write(self, fd: int, data: bytes) -> int:
        """os.write."""
        return os.write(fd, data)

    def ioctl(self, fd: int, request: int, argument: bytearray | int) -> int:
        """fcntl.ioctl."""
        return fcntl.ioctl(fd, request, argument)


@dataclass(frozen=True)
class Axis:
    """What the kernel knows of an axis: struct input_absinfo, in the device's counts."""

    value: int
    minimum: int
    maximum: int
    fuzz: int
    flat: int
    resolution: int


class Event(NamedTuple):
    """One event: when the kernel received it (ns of the monotonic clock), its type, code and value."""

    at: int
    kind: int
    code: int
    value: int


class EventDevice:
    """An open event device.

    Every method raises :class:`OSError` with ``ENODEV`` once the device was unplugged.
    """

    def __init__(self, path: str, calls: Calls | None = None) -> None:
        """Open it; nothing that it does then waits.

        Raises:
            OSError: it cannot be opened, or is no event device (``ENOTTY``, ``EINVAL``).
        """
        self.path, self._calls = path, calls or Kernel()
        self._fd = self._calls.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            self._calls.ioctl(self._fd, EVIOCSCLOCKID, bytearray(struct.pack("i", time.CLOCK_MONOTONIC)))
        except BaseException:
            self.close()
            raise

    def codes(self, kind: int = 0) -> frozenset[int]:
        """The codes of a type of event that the device has; of type 0 the types themselves."""
        bits = bytearray(_BITS)
        self._calls.ioctl(self._fd, EVIOCGBIT(kind), bits)
        return frozenset(8 * at + bit for at, byte in enumerate(bits) for bit in range(8) if byte >> bit & 1)

    def axis(self, code: int) -> Axis:
        """An axis as it is now."""
        data = bytearray(ABSINFO.size)
        self._calls.ioctl(self._fd, EVIOCGABS(code), data)
        return Axis(*ABSINFO.unpack(data))

    def filter(self, code: int, fuzz: int) -> None:
        """Have the kernel leave out changes of an axis by less than ``fuzz`` counts; 0 for none."""
        axis = replace(self.axis(code), fuzz=fuzz)
        numbers = axis.value, axis.minimum, axis.maximum, axis.fuzz, axis.flat, axis.resolution
        self._calls.ioctl(self._fd, EVIOCSABS(code), bytearray(ABSINFO.pack(*numbers)))

    def grab(self) -> None:
        """From now on nobody else receives this device's events; ``EBUSY`` where another program has done so."""
        self._calls.ioctl(self._fd, EVIOCGRAB, 1)

    def upload(self, number: int, direction: int, level: int, length: int) -> int:
        """Store a constant force, which is not played by that.

        Args:
            number: of the effect that is overwritten; -1 for a new one.
            direction: a polar angle, 0x10000 for a turn: 0 pulls down, 0x4000 to the left.
            level: from -:data:`FULL` to :data:`FULL`.
            length: ms after its start at which it ends; 0 for never.

        Returns:
            Its number; ``ENOSPC`` where the device has room for no more.
        """
        effect = bytearray(EFFECT.pack(FF_CONSTANT, number, direction, 0, 0, length, 0, level, 0, 0, 0, 0))
        self._calls.ioctl(self._fd, EVIOCSFF, effect)
        stored: int = EFFECT.unpack(effect)[1]
        return stored

    def erase(self, number: int) -> None:
        """Stop an effect, and forget it."""
        self._calls.ioctl(self._fd, EVIOCRMFF, number)

    def play(self, orders: Sequence[tuple[int, int]]) -> None:
        """Play effects by their numbers so many times, 0 to stop; likewise set FF_GAIN and FF_AUTOCENTER."""
        self._calls.write(self._fd, b"".join(EVENT.pack(0, 0, EV_FF, code, value) for code, value in orders))

    def events(self) -> Iterator[Event]:
        """All events that have come; the kernel keeps whole reports only."""
        while True:
            try:
                data = self._calls.read(self._fd, _AT_ONCE)
            except BlockingIOError:
                return
            if not data:
                raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))
            for s, us, kind, code, value in EVENT.iter_unpack(data):
                yield Event(1_000_000_000 * s + 1000 * us, kind, code, value)
            if len(data) < _AT_ONCE:
                return

    def close(self) -> None:
        """Close it, which ends its grab, and stops and erases its effects; a second call does nothing."""
        if self._fd >= 0:
            fd, self._fd = self._fd, -1
            self._calls.close(fd)
