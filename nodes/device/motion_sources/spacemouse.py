"""The SpaceMouse of 3Dconnexion, read from its hidraw file (:class:`SpaceMouse`).

A report begins with its number. Numbers are 16 bits with sign, the least byte first, and :data:`FULL` at full
deflection.

======  =============================================================  ==================================
report  has                                                            of
======  =============================================================  ==================================
1       x, -y, -z: translation, in six bytes                           all
1       the same, and -rx, -ry, rz: rotation, in six bytes more        Enterprise, wireless and Pro Wireless
2       -rx, -ry, rz                                                   the others
3       a bit for each button                                          all
======  =============================================================  ==================================

x is to the right, y away from the user, z up; rx, ry and rz turn about these by the right hand's rule.

Sources: layouts and product numbers, ``pyspacemouse/devices.toml`` of github.com/JakubAndrysek/PySpaceMouse; product
numbers, ``src/dev.c`` of github.com/FreeSpacenav/spacenavd; one report for each read, ``drivers/hid/hidraw.c`` of
Linux; ``HIDIOCGRAWINFO``, its ``include/uapi/linux/hidraw.h``; that the descriptor begins with a multi-axis controller,
the USB HID Usage Tables (page 1, usage 8).
"""

from __future__ import annotations

import fcntl
import re
import struct
from pathlib import Path
from typing import ClassVar, Final

from manyhands.nodes.device.motion_sources.source import MotionSource, MotionSourceError

FULL: Final = 350.0
"""A device's number at full deflection."""

PRODUCTS: Final = frozenset({
    *((0x046D, product) for product in (0xC625, 0xC626, 0xC627, 0xC628, 0xC629, 0xC62B)),
    *((0x256F, product) for product in (0xC62E, 0xC62F, 0xC631, 0xC632, 0xC633, 0xC635, 0xC636, 0xC638, 0xC63A)),
    *((0x256F, product) for product in (0xC641, 0xC652)),
})  # fmt: skip
"""Vendor and product: SpacePilot, SpaceNavigator, SpaceExplorer, SpaceNavigator for Notebooks, SpacePilot Pro,
SpaceMouse Pro; Wireless and its receiver, Pro Wireless and its receiver, Enterprise, Compact, Module, Pro Wireless and
Wireless by Bluetooth; SpaceMouse (USB), Universal Receiver."""

UDEV_RULE: Final = 'KERNEL=="hidraw*", KERNELS=="*:{vendor:04X}:*", MODE="0660", TAG+="uaccess"'
"""The rule of udev by which the user at this machine may read a SpaceMouse; by USB and Bluetooth alike."""

_HIDRAW: Final = Path("/sys/class/hidraw")
_MULTI_AXIS: Final = bytes.fromhex("05010908")
_RAWINFO: Final = 0x80084803  # HIDIOCGRAWINFO: bus, vendor, product
_THREE: Final = struct.Struct("<3h")
_TRANSLATION, _ROTATION, _BUTTONS = 1, 2, 3
_SIGNS: Final = ((1.0, -1.0, -1.0), (-1.0, -1.0, 1.0))  # of what the reports have, in the axes above


class SpaceMouse(MotionSource):
    """A SpaceMouse."""

    AXES: ClassVar = ("x", "y", "z", "rx", "ry", "rz")
    DEAD_ZONE: ClassVar = 0.05
    NAME: ClassVar = "SpaceMouse"
    FILES: ClassVar = re.compile("/dev/hidraw[0-9]+")
    PERMISSION: ClassVar = (
        f"write {UDEV_RULE.format(vendor=0x256F)} to /etc/udev/rules.d/70-spacemouse.rules, for an older one of the "
        "vendor 046d with that number, and plug it in again"
    )

    @classmethod
    def found(cls) -> str:
        """The path of the first SpaceMouse that is plugged in, of those of its interfaces that report deflections.

        Raises:
            MotionSourceError: there is none.
        """
        others = 0
        for device in sorted(_HIDRAW.glob("hidraw*"), key=lambda path: (len(path.name), path.name)):
            try:
                ids = re.search(r"^HID_ID=\w+:(\w+):(\w+)$", (device / "device" / "uevent").read_text(), re.MULTILINE)
                descriptor = (device / "device" / "report_descriptor").read_bytes()
            except OSError:  # it was unplugged in between
                continue
            if ids and (int(ids[1], 16), int(ids[2], 16)) in PRODUCTS and descriptor.startswith(_MULTI_AXIS):
                return f"/dev/{device.name}"
            others += 1
        raise MotionSourceError(
            f"found no SpaceMouse, and {others} other devices in {_HIDRAW}; expected one that is plugged in and known "
            "(`lsusb` shows its numbers), or its file as `device`"
        )

    def _recognise(self, fd: int, pipe: bool) -> None:
        if pipe:
            return
        try:
            _, vendor, product = struct.unpack("=IHH", fcntl.ioctl(fd, _RAWINFO, bytes(8)))
        except OSError as error:
            raise self._gone(error.strerror) from error
        if (vendor, product) not in PRODUCTS:
            raise MotionSourceError(
                f"{self.path}: found the device {vendor:04x}:{product:04x}; expected a SpaceMouse, one of "
                f"{', '.join(f'{v:04x}:{p:04x}' for v, p in sorted(PRODUCTS))}"
            )

    def _take(self, data: bytes) -> bool:
        number, size = data[0], len(data) - 1
        if number == _TRANSLATION and size >= _THREE.size:
            self._turn(0, data, 1)
            if size >= 2 * _THREE.size:
                self._turn(1, data, 1 + _THREE.size)
        elif number == _ROTATION and size >= _THREE.size:
            self._turn(1, data, 1)
        elif number != _BUTTONS or not size:
            self.refused += 1  # a battery's, for one
            return False
        self.reports += 1
        if number != _BUTTONS:
            return False
        before, self.buttons = self.buttons, int.from_bytes(data[1:5], "little")
        self.pressed |= self.buttons & ~before
        return any(data[1:])

    def _turn(self, which: int, data: bytes, begin: int) -> None:
        for axis, (raw, sign) in enumerate(zip(_THREE.unpack_from(data, begin), _SIGNS[which], strict=True)):
            self.deflection[3 * which + axis] = min(max(sign * raw / FULL, -1.0), 1.0)
