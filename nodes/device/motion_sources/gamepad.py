"""A gamepad or a joystick, read from its joystick file, ``/dev/input/js*`` (:class:`Gamepad`).

The kernel's joystick driver sends an event of eight bytes for each change, and when the file is opened one for the
present state of each axis and button (:data:`INITIAL`). Its axes are numbered device by device. The kernel says which
is which (``JSIOCGAXMAP``):

=========  ==========================================================================================
axis here  is
=========  ==========================================================================================
x, y       the left stick, to the right and away from the user: X and -Y
z          the right stick away from the user: -RY, or -RZ where there is no RX
rx         the right stick to the right: RX, or Z
triggers   the right trigger less the left one: RZ - Z where there is an RX, otherwise GAS - BRAKE
=========  ==========================================================================================

Sources: ``Documentation/input/joydev/joystick-api.rst`` (events, their values and the first ones) and
``Documentation/input/gamepad.rst`` (sticks, negative is left and up) of Linux, its ``include/uapi/linux/joystick.h``
and ``input-event-codes.h``; that triggers are Z and RZ, its ``drivers/input/joystick/xpad.c``.
"""

from __future__ import annotations

import fcntl
import re
import struct
from pathlib import Path
from typing import ClassVar, Final

from manyhands.nodes.device.motion_sources.source import MOST_BUTTONS, MotionSource, MotionSourceError

FULL: Final = 32767.0
"""An axis' value at full deflection."""

INITIAL: Final = 0x80
"""The bit of an event's type that tells a state from a change."""

EVENT: Final = struct.Struct("=IhBB")
"""``js_event``: the time (ms), the value, the type, the number of the axis or button."""

_BUTTON, _AXIS = 1, 2
_X, _Y, _Z, _RX, _RY, _RZ, _GAS, _BRAKE = 0, 1, 2, 3, 4, 5, 9, 10
_CODES: Final = 64  # ABS_CNT
_AXMAP: Final = 0x80406A32  # JSIOCGAXMAP: the code of each axis, a byte each
_AXES: Final = 0x80016A11  # JSIOCGAXES: their number
_USUAL: Final = bytes((_X, _Y, _Z, _RX, _RY, _RZ))
"""The axes of a pipe, in the order that xpad has them."""


class Gamepad(MotionSource):
    """A gamepad or a joystick."""

    AXES: ClassVar = ("x", "y", "z", "rx", "triggers")
    DEAD_ZONE: ClassVar = 0.15
    NAME: ClassVar = "gamepad"
    FILES: ClassVar = re.compile("/dev/input/js[0-9]+")
    PERMISSION: ClassVar = (
        "log in at this machine, or add yourself to the group of the file, `sudo usermod -aG input $USER`, and log in "
        "again"
    )

    @classmethod
    def found(cls) -> str:
        """The path of the first joystick.

        Raises:
            MotionSourceError: there is none.
        """
        files = sorted(Path("/dev/input").glob("js*"), key=lambda path: (len(path.name), path.name))
        if not files:
            raise MotionSourceError(
                "found no gamepad (/dev/input/js*); expected one that is plugged in, and the kernel's module joydev: "
                "`sudo modprobe joydev`"
            )
        return str(files[0])

    def _recognise(self, fd: int, pipe: bool) -> None:
        codes = _USUAL
        if not pipe:
            try:
                number = fcntl.ioctl(fd, _AXES, bytes(1))[0]
                codes = fcntl.ioctl(fd, _AXMAP, bytes(_CODES))[:number]
            except OSError as error:
                raise self._gone(error.strerror) from error
        if _RX in codes:
            right, triggers = (_RX, _RY), (_RZ, _Z)
        else:
            right, triggers = (_Z, _RZ), (_GAS, _BRAKE)
        self._codes = codes
        self._use = (_X, _Y, right[1], right[0])
        self._triggers = triggers
        self._value = dict.fromkeys(codes, 0.0) | dict.fromkeys(triggers, -1.0)  # a trigger at rest is at its least

    def _take(self, data: bytes) -> bool:
        if len(data) % EVENT.size:
            self.refused += 1
            return False
        pressed = False
        for _, value, kind, number in EVENT.iter_unpack(data):
            if kind & ~INITIAL == _AXIS and number < len(self._codes):
                self._value[self._codes[number]] = min(max(value / FULL, -1.0), 1.0)
            elif kind & ~INITIAL != _BUTTON:
                self.refused += 1
                continue
            if kind & ~INITIAL == _BUTTON and number < MOST_BUTTONS:
                self.buttons = self.buttons | 1 << number if value else self.buttons & ~(1 << number)
            if kind == _BUTTON and value != 0:
                pressed = True
                self.pressed |= 1 << min(number, MOST_BUTTONS)
            self.reports += 1
        x, y, z, rx = (self._value.get(code, 0.0) for code in self._use)
        right, left = (self._value[code] for code in self._triggers)
        self.deflection[:] = x, -y, -z, rx, (right - left) / 2.0
        return pressed
