"""What is read of sysfs, on a tree of files like it."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from manyhands.devices.evdev.bus import CONTROL, KNOWN, PIDFF, UNKNOWN, UsbWay, tick, way_to


def tree(
    root: Path, module: str | None, driver: str = "logitech", out: str | None = "2ms", extra: bool = True, **files: str
) -> None:
    """A wheel at event7: its HID device below a USB interface with endpoints."""
    interface = root / "devices" / "usb1" / "1-2" / "1-2:1.0"
    hid = interface / "0003:046D:C24F.0001"
    (hid / "input" / "input9" / "event7").mkdir(parents=True)
    (hid / "input" / "input9" / "device").symlink_to(hid)
    (root / "class" / "input").mkdir(parents=True)
    (root / "class" / "input" / "event7").symlink_to(hid / "input" / "input9" / "event7")
    (hid / "input" / "input9" / "event7" / "device").symlink_to(hid / "input" / "input9")
    bus = root / "bus" / "hid" / "drivers" / driver
    bus.mkdir(parents=True)
    (hid / "driver").symlink_to(bus)
    if module is not None:
        (root / "module" / module).mkdir(parents=True)
        (bus / "module").symlink_to(root / "module" / module)
    for name, direction, interval in (("ep_81", "in", "1ms"), ("ep_01", "out", out)):
        if extra and interval is not None:
            (interface / name).mkdir()
            for file, text in (("type", "Interrupt"), ("direction", direction), ("interval", interval)):
                (interface / name / file).write_text(text + "\n")
    for file, text in files.items():
        (hid / file).write_text(text)


def test_a_wheel_at_a_usb(tmp_path: Path) -> None:
    tree(tmp_path, "hid_logitech_new", range="900\n")
    found = way_to("/dev/input/event7", tmp_path)
    assert found == UsbWay(KNOWN["hid_logitech_new"], 0.001, 0.002, math.radians(900), found.range_file)
    assert found.range_file is not None
    assert found.range_file.read_text() == "900\n"


@pytest.mark.parametrize(
    ("module", "driver", "expected"),
    [
        (None, "hid-generic", PIDFF),
        (None, "logitech", KNOWN["logitech"]),
        ("hid_tmff_new", "tmff2", KNOWN["hid_tmff_new"]),
        ("hid_fanatec", "ftec_csl_elite", UNKNOWN),
    ],
)
def test_kernel_drivers_are_known_by_their_modules(tmp_path: Path, module: str, driver: str, expected: object) -> None:
    tree(tmp_path, module, driver)
    assert way_to("/dev/input/event7", tmp_path).driver == expected


def test_a_link_to_the_device_is_followed(tmp_path: Path) -> None:
    tree(tmp_path, "hid_logitech")
    link = tmp_path / "usb-wheel-event-joystick"
    link.symlink_to("/dev/input/event7")
    assert way_to(str(link), tmp_path).polled == 0.001


def test_reports_over_the_control_pipe_have_no_interval(tmp_path: Path) -> None:
    tree(tmp_path, "hid_logitech", out=None)
    assert way_to("/dev/input/event7", tmp_path).sent == CONTROL


def test_an_interval_that_the_user_has_set_for_joysticks_counts_where_it_is_longer(tmp_path: Path) -> None:
    tree(tmp_path, "hid_logitech", out="500us")
    assert way_to("/dev/input/event7", tmp_path).sent == 0.0005
    parameters = tmp_path / "module" / "usbhid" / "parameters"
    parameters.mkdir(parents=True)
    (parameters / "jspoll").write_text("4\n")
    found = way_to("/dev/input/event7", tmp_path)
    assert (found.polled, found.sent) == (0.004, 0.004)


def test_of_several_endpoints_the_slowest_counts(tmp_path: Path) -> None:
    tree(tmp_path, "hid_logitech")
    second = tmp_path / "devices" / "usb1" / "1-2" / "1-2:1.0" / "ep_82"
    second.mkdir()
    for file, text in (("type", "Interrupt"), ("direction", "in"), ("interval", "8ms")):
        (second / file).write_text(text)
    assert way_to("/dev/input/event7", tmp_path).polled == 0.008


def test_elsewhere_than_at_a_usb_nothing_is_known(tmp_path: Path) -> None:
    assert way_to("/dev/input/event7", tmp_path) == UsbWay()
    tree(tmp_path, "hid_logitech", extra=False, range="0")
    assert way_to("/dev/input/event7", tmp_path) == UsbWay(KNOWN["hid_logitech"])


def test_the_kernels_tick_is_one_that_kernels_have() -> None:
    assert 0.0009 < tick() < 0.0101
