"""The reports of a SpaceMouse and a gamepad, read from a fake's pipe, become deflections; and what else may come."""

from __future__ import annotations

import fcntl
import os
import struct
import threading
from pathlib import Path

import pytest

from manyhands.nodes.device.motion_sources import MOTION_SOURCES
from manyhands.nodes.device.motion_sources import spacemouse as spacemouse_module
from manyhands.nodes.device.motion_sources.gamepad import EVENT, Gamepad
from manyhands.nodes.device.motion_sources.source import MOST_AT_ONCE, MotionSource, MotionSourceError
from manyhands.nodes.device.motion_sources.spacemouse import PRODUCTS, SpaceMouse

from ....fakes.motion_device import fake_motion_device


@pytest.mark.parametrize("kind", ["compact", "enterprise"])
def test_a_spacemouse_reports_all_six_axes(kind: str, tmp_path: Path) -> None:
    """Raw y and z point to the user and down, and raw pitch and roll turn the other way."""
    with fake_motion_device(kind, tmp_path) as fake:
        mouse = SpaceMouse(str(fake.path))
        assert mouse.look() is False
        assert mouse.deflection == [0.0] * 6
        fake.deflect(1.0, -0.5, 0.2, 0.4, -0.6, 0.8)
        assert mouse.look() is False
        assert mouse.deflection == pytest.approx([1.0, 0.5, -0.2, -0.4, 0.6, 0.8], abs=0.5 / 350.0)
        fake.deflect(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        mouse.look()
        assert mouse.deflection == [0.0] * 6
        mouse.look()  # silence: it is at rest
        assert mouse.deflection == [0.0] * 6
        assert mouse.reports >= (2 if kind == "enterprise" else 4)
        mouse.close()
        mouse.close()


def test_the_newest_report_counts_and_the_last_one_holds(tmp_path: Path) -> None:
    with fake_motion_device("compact", tmp_path) as fake:
        mouse = SpaceMouse(str(fake.path))
        fake.deflect(0.2, 0.0, 0.0, 0.0, 0.0, 0.0)
        fake.deflect(0.7, 0.0, 0.0, 0.0, 0.0, 0.0)
        mouse.look()
        assert mouse.deflection[0] == pytest.approx(0.7, abs=0.5 / 350.0)
        fake.process.send_signal(19)  # SIGSTOP: a bus that stalls
        for _ in range(2 * MOST_AT_ONCE):
            mouse.look()
        assert mouse.deflection[0] == pytest.approx(0.7, abs=0.5 / 350.0)
        mouse.close()


@pytest.mark.parametrize("kind", ["compact", "gamepad"])
def test_a_button_is_told_once_and_other_reports_are_counted(kind: str, tmp_path: Path) -> None:
    with fake_motion_device(kind, tmp_path) as fake:
        source = MOTION_SOURCES["gamepad" if kind == "gamepad" else "spacemouse"](str(fake.path))
        assert source.look() is False  # a gamepad tells first that no button is pressed
        fake.press(1)
        assert source.look() is True
        assert source.look() is False
        for report in (b"\x17\x64", b"\1\2\3", b"\3", b"\x99" * 40):
            fake.send(report)
        source.look()
        assert source.refused >= 4 if kind == "compact" else source.refused >= 3
        assert not any(source.deflection)
        source.close()


def test_a_gamepad_has_two_sticks_and_its_triggers(tmp_path: Path) -> None:
    with fake_motion_device("gamepad", tmp_path) as fake:
        pad = Gamepad(str(fake.path))
        pad.look()
        assert pad.deflection == [0.0] * 5
        fake.deflect(0.5, -1.0, -1.0, 0.25, 0.75, -1.0)  # X, Y, Z, RX, RY, RZ
        pad.look()
        assert pad.deflection == pytest.approx([0.5, 1.0, -0.75, 0.25, 0.0], abs=1e-4)
        fake.deflect(0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
        pad.look()
        assert pad.deflection == pytest.approx([0.0, 0.0, 0.0, 0.0, 0.5], abs=1e-4)
        pad.close()


def test_triggers_are_at_rest_before_any_event(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    pad = Gamepad(str(tmp_path / "pipe"))
    assert pad.deflection == [0.0] * 5
    pad._take(struct.pack("=IhBB", 0, 0, 0x82, 0))
    assert pad.deflection == [0.0] * 5
    pad._take(struct.pack("=IhBB", 0, 32767, 2, 5))  # the right one; nothing was heard of the left one
    assert pad.deflection == [0.0] * 4 + [1.0]
    pad.close()


@pytest.mark.parametrize(("kind", "source"), [("compact", SpaceMouse), ("gamepad", Gamepad)])
def test_unplugged_it_says_what_to_do(kind: str, source: type[MotionSource], tmp_path: Path) -> None:
    with fake_motion_device(kind, tmp_path) as fake:
        opened = source(str(fake.path))
        opened.look()
        fake.unplug()
        with pytest.raises(MotionSourceError, match=r"the end of its data; expected reports .* plug it in again"):
            opened.look()
        opened.close()


def test_an_error_of_the_kernel_is_told_likewise(tmp_path: Path) -> None:
    """A hidraw file of a device that is gone answers EIO, as a terminal's master does whose other end is closed."""
    os.mkfifo(tmp_path / "pipe")
    mouse = SpaceMouse(str(tmp_path / "pipe"))
    master, slave = os.openpty()
    os.dup2(master, mouse._fd)
    os.close(master)
    os.set_blocking(mouse._fd, False)
    mouse.look()
    os.close(slave)
    with pytest.raises(MotionSourceError, match="Input/output error; expected reports of a SpaceMouse"):
        mouse.look()
    mouse.close()


def test_a_stranger_cannot_have_another_file_opened(tmp_path: Path) -> None:
    """Neither a file, nor a device of another kind: opening some of them does something."""
    plain = tmp_path / "plain"
    plain.write_text("")
    link = tmp_path / "hidraw0"
    link.symlink_to("/dev/null")
    for source in MOTION_SOURCES.values():
        for path in (plain, link, Path("/dev/zero"), tmp_path):
            with pytest.raises(MotionSourceError, match="another kind of file"):
                source(str(path))
        with pytest.raises(MotionSourceError, match=r"no such file.* plugged in"):
            source(str(tmp_path / "none"))


def test_without_permission_it_prints_the_rule(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    os.mkfifo(tmp_path / "pipe")

    def denied(*_: object) -> int:
        raise PermissionError(13, "Permission denied")

    with monkeypatch.context() as patched:
        patched.setattr(os, "open", denied)
        with pytest.raises(MotionSourceError, match=r'KERNEL=="hidraw\*", KERNELS=="\*:256F:\*", .*uaccess'):
            SpaceMouse(str(tmp_path / "pipe"))
        with pytest.raises(MotionSourceError, match="usermod -aG input"):
            Gamepad(str(tmp_path / "pipe"))


def test_the_spacemouse_that_is_plugged_in_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a receiver that is a mouse as well, the interface whose descriptor is that of a multi-axis controller."""
    monkeypatch.setattr(spacemouse_module, "_HIDRAW", tmp_path)
    with pytest.raises(MotionSourceError, match="found no SpaceMouse, and 0 other devices"):
        SpaceMouse.found()
    for name, product, begin in (
        ("hidraw0", "0000046D:0000C31C", "05010906"),  # a keyboard
        ("hidraw2", "0000256F:0000C652", "05010902"),  # the receiver's mouse
        ("hidraw10", "0000256F:0000C635", "05010908"),
        ("hidraw9", "0000256F:0000C652", "05010908"),
    ):
        device = tmp_path / name / "device"
        device.mkdir(parents=True)
        (device / "uevent").write_text(f"DRIVER=hid-generic\nHID_ID=0003:{product}\nHID_NAME=x\n")
        (device / "report_descriptor").write_bytes(bytes.fromhex(begin + "a101"))
    assert SpaceMouse.found() == "/dev/hidraw9"


def answers(monkeypatch: pytest.MonkeyPatch, *given: bytes | OSError) -> list[tuple[int, int]]:
    """The kernel's answers to ioctl, in their order; returns the requests, with the sizes of their buffers."""
    asked: list[tuple[int, int]] = []
    left = iter(given)

    def ioctl(_: int, request: int, buffer: bytes) -> bytes:
        asked.append((request, len(buffer)))
        answer = next(left)
        if isinstance(answer, OSError):
            raise answer
        return answer

    monkeypatch.setattr(fcntl, "ioctl", ioctl)
    return asked


def test_a_device_of_another_maker_is_no_spacemouse(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    os.mkfifo(tmp_path / "pipe")
    mouse = SpaceMouse(str(tmp_path / "pipe"))
    known = struct.pack("=IHH", 3, 0x256F, 0xC635)
    asked = answers(monkeypatch, known, struct.pack("=IHH", 3, 0x046D, 0xC31C), OSError(19, "No such device"))
    mouse._recognise(mouse._fd, pipe=False)
    with pytest.raises(MotionSourceError, match="found the device 046d:c31c; expected a SpaceMouse, one of 046d:c625"):
        mouse._recognise(mouse._fd, pipe=False)
    with pytest.raises(MotionSourceError, match="No such device"):
        mouse._recognise(mouse._fd, pipe=False)
    assert asked == [((2 << 30) | (8 << 16) | (ord("H") << 8) | 3, 8)] * 3  # _IOR('H', 3, 8)
    assert (0x256F, 0xC633) in PRODUCTS
    mouse.close()


@pytest.mark.parametrize(
    ("codes", "values", "deflection"),
    [
        pytest.param((0, 1, 2, 3, 4, 5, 16, 17), (0, 0, 1, 0, -1, -1, 0, 0), [0, 0, 1, 0, -1], id="xpad"),
        pytest.param((0, 1, 2, 5, 9, 10, 16, 17), (1, 0, 0.5, -1, 1, -1, 0, 0), [1, 0, 1, 0.5, 1], id="bluetooth"),
        pytest.param((0, 1, 6, 7), (0, -1, 1, 1), [0, 1, 0, 0, 0], id="joystick"),
    ],
)
def test_axes_are_those_that_the_kernel_names(
    codes: tuple[int, ...],
    values: tuple[float, ...],
    deflection: list[float],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    os.mkfifo(tmp_path / "pipe")
    pad = Gamepad(str(tmp_path / "pipe"))
    asked = answers(monkeypatch, bytes([len(codes)]), bytes(codes).ljust(64, b"\0"))
    pad._recognise(pad._fd, pipe=False)
    ior = (2 << 30) | (ord("j") << 8)
    assert asked == [(ior | (1 << 16) | 0x11, 1), (ior | (64 << 16) | 0x32, 64)]
    events = [struct.pack("=IhBB", 0, round(32767 * value), 2, axis) for axis, value in enumerate(values)]
    pad._take(b"".join(events))
    assert pad.deflection == pytest.approx(deflection, abs=1e-4)
    pad.close()


def test_reading_never_waits(tmp_path: Path) -> None:
    """A writer that never pauses does not keep the loop, and a silent one neither."""
    os.mkfifo(tmp_path / "pipe")
    mouse = SpaceMouse(str(tmp_path / "pipe"))
    ready, over = threading.Event(), threading.Event()

    def write() -> None:
        with open(tmp_path / "pipe", "wb", buffering=0) as pipe:
            ready.set()
            while not over.is_set():
                pipe.write(b"\x17" * 512)

    writer = threading.Thread(target=write)
    writer.start()
    ready.wait(10.0)
    before = mouse.refused
    mouse.look()
    assert mouse.refused - before <= MOST_AT_ONCE
    over.set()
    while writer.is_alive():
        try:
            os.read(mouse._fd, 65536)
        except BlockingIOError:
            writer.join(0.01)
    mouse.close()


@pytest.mark.parametrize("kind", ["compact", "gamepad"])
def test_buttons_are_known_as_long_as_they_are_held_down(kind: str, tmp_path: Path) -> None:
    def tell(*down: int) -> None:
        if kind == "compact":
            fake.send(b"\x03" + sum(1 << button for button in down).to_bytes(4, "little"))
        else:
            for button in range(3):
                fake.send(EVENT.pack(0, int(button in down), 1, button))

    with fake_motion_device(kind, tmp_path) as fake:
        source = MOTION_SOURCES["gamepad" if kind == "gamepad" else "spacemouse"](str(fake.path))
        for down, held, pressed in (((0, 2), 0b101, 0b101), ((0, 1), 0b011, 0b010), ((), 0, 0)):
            tell(*down)
            source.look()
            assert source.buttons == held
            if kind == "compact":
                assert source.pressed == pressed, "of these it has told no release"
        fake.press(1)
        source.look()
        assert (source.buttons, source.pressed & 0b10) == (0, 0b10), "it was pressed and let go between two looks"
        source.close()
