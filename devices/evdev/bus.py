"""What the kernel tells of the way to an event device: its driver, the polling of its bus, and the range it was set to.

An event does not say how old its position is, and a wheel that rests sends none. What bounds the age is the interval at
which the host controller asks the device for a report (``bInterval``), which sysfs has with its endpoints
(``Documentation/ABI/stable/sysfs-bus-usb``). ``usbhid.jspoll`` overrides it.

**Kernel drivers differ in when a force leaves them**, as their sources say. Each entry of :data:`KNOWN` has where.
"""

from __future__ import annotations

import math
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Final

SYSFS: Final = Path("/sys")

CONTROL: Final = 0.002
"""s; a report over the control pipe, which no endpoint's interval paces: two frames of a full-speed bus."""

_COARSE: Final = 6  # CLOCK_MONOTONIC_COARSE of linux/time.h, which advances with the kernel's tick


@dataclass(frozen=True)
class KernelDriver:
    """How a kernel driver passes a force on.

    Attributes:
        name: for messages.
        timer: the period of its own timer, at which forces leave, s; 0 where they leave at once.
        ticks: how many ticks of the kernel it may take beside, for it counts in these.
        reports: to the device at the most for one update of one effect.
        levels: steps from 0 to the greatest force.
    """

    name: str
    timer: float
    ticks: int
    reports: int
    levels: int = 0x7FFF


PIDFF: Final = KernelDriver("hid-pidff", 0.0, 0, 3)
"""JacKeTUs/universal-pidff hid-pidff.c, at once: Set Effect for a new length, Set Constant Force for a new level, and
Effect Operation for each start."""

KNOWN: Final = {
    # drivers/input/ff-memless.c, drivers/hid/hid-lg4ff.c: forces leave in the kernel's next tick, as 8 bits
    "hid_logitech": KernelDriver("hid-lg4ff", 0.0, 1, 1, 0x7F),
    "logitech": KernelDriver("hid-lg4ff", 0.0, 1, 1, 0x7F),  # built in, without a module
    # berarma/new-lg4ff hid-lg4ff.c: DEFAULT_TIMER_PERIOD
    "hid_logitech_new": KernelDriver("new-lg4ff", 0.002, 0, 1, 0x7F),
    # Kimplul/hid-tmff2 src/hid-tmff2.h: DEFAULT_TIMER_PERIOD, counted in ticks; an update and a start
    "hid_tmff_new": KernelDriver("hid-tmff2", 0.008, 1, 2),
    "hid_universal_pidff": PIDFF,
    "hid_generic": PIDFF,
    "hid-generic": PIDFF,
}

UNKNOWN: Final = KernelDriver("an unknown kernel driver", 0.008, 1, 3)
"""In each respect as slow as the slowest known one."""


@dataclass(frozen=True)
class UsbWay:
    """The way to a device and back.

    Attributes:
        driver: of the kernel.
        polled: the interval of its reports to the host, s; None where it is at no USB.
        sent: the interval of reports to it, s; None likewise.
        range: from stop to stop that the kernel driver has set, rad; None where it tells none.
        range_file: where it tells this.
    """

    driver: KernelDriver = UNKNOWN
    polled: float | None = None
    sent: float | None = None
    range: float | None = None
    range_file: Path | None = None


def way_to(path: str, root: Path = SYSFS) -> UsbWay:
    """What sysfs, at ``root``, has of the event device at ``path``; an empty :class:`UsbWay` where it has none."""
    hid = root / "class" / "input" / os.path.basename(os.path.realpath(path)) / "device" / "device"
    if not hid.exists():
        return UsbWay()
    hid = hid.resolve()
    driver = hid / "driver"
    name = (driver / "module" if (driver / "module").exists() else driver).resolve().name
    polled, sent, turns = _endpoint(hid.parent, "in"), _endpoint(hid.parent, "out"), range_in(hid / "range")
    file = None if turns is None else hid / "range"
    if polled is None:
        return UsbWay(KNOWN.get(name, UNKNOWN), range=turns, range_file=file)
    joysticks = _text(root / "module" / "usbhid" / "parameters" / "jspoll")
    least = 1e-3 * int(joysticks) if joysticks.isdigit() else 0.0
    return UsbWay(KNOWN.get(name, UNKNOWN), max(polled, least), max(sent or CONTROL, least), turns, file)


def tick() -> float:
    """The time between two ticks of the kernel (1/CONFIG_HZ), s, in which some of its drivers count."""
    return time.clock_getres(_COARSE)


def _endpoint(interface: Path, direction: str) -> float | None:
    """The interval of an interrupt endpoint of a USB interface, s; the longest of several, None for none."""
    found = [
        _interval(_text(endpoint / "interval"))
        for endpoint in interface.glob("ep_*")
        if _text(endpoint / "type") == "Interrupt" and _text(endpoint / "direction") == direction
    ]
    return max(found, default=None)


def _interval(text: str) -> float:
    for unit, factor in (("ms", 1e-3), ("us", 1e-6)):
        if text.endswith(unit):
            return factor * int(text.removesuffix(unit))
    raise ValueError(f"found the interval {text!r:.20}; expected one in ms or us, as sysfs has them")


def range_in(file: Path) -> float | None:
    """The range that a kernel driver tells in a file of sysfs, rad; None for none."""
    degrees = _text(file)
    return math.radians(int(degrees)) if degrees.isdigit() and int(degrees) else None


def _text(path: Path) -> str:
    try:
        return path.read_text().strip()
    except OSError:
        return ""
