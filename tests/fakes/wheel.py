"""A fake wheel or joystick: a kernel driver and the device behind it, in a process of its own, with failures to order.

The driver speaks to it in two ways. :class:`FakeCalls` stands in for the kernel's calls within the test's process. With
:meth:`FakeWheel.environment` a process makes the calls themselves, to the C library's functions, which evdev_calls.c
leads to the fake.
"""

from __future__ import annotations

import errno
import os
import socket
import struct
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import astuple, dataclass
from pathlib import Path

from manyhands.devices.evdev.event_device import EVIOCGRAB, EVIOCRMFF

from .compiled import FAKES, built
from .ordered import AxesFake, ended

STRICT = ("-std=gnu99", "-Wall", "-Wextra", "-Werror")
_ASKED = struct.Struct("=IIQq")
_ANSWERED = struct.Struct("=qII")
_OPEN, _IOCTL, _READ, _WRITE = 1, 2, 3, 4
_MOST = 2048


@dataclass(frozen=True)
class Turn:
    """One axis: inertia (kg·m²), damping (N·m·s/rad), friction (N·m), a step that its range overwrites, the hand's
    spring (N·m/rad) and its motion (rad, Hz), the greatest torque (N·m), and the range from stop to stop (rad)."""

    m: float = 0.02
    b: float = 0.05
    c: float = 0.0
    step: float = 0.0
    k: float = 0.0
    amplitude: float = 0.0
    frequency: float = 0.0
    most: float = 2.0
    range: float = 15.0


class FakeCalls:
    """The kernel's calls (:class:`manyhands.devices.evdev.event_device.Calls`), to a fake."""

    def __init__(self) -> None:
        self._open: dict[int, socket.socket] = {}

    def open(self, path: str, flags: int) -> int:
        """Connect to the fake, whose socket is the path."""
        assert flags & os.O_NONBLOCK
        door = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            door.connect(path)
            self._asked(door, _OPEN)
        except BaseException:
            door.close()
            raise
        self._open[door.fileno()] = door
        return door.fileno()

    def close(self, fd: int) -> None:
        """Hang up."""
        self._open.pop(fd).close()

    def read(self, fd: int, size: int) -> bytes:
        """Read events."""
        return self._asked(self._open[fd], _READ, size)[1]

    def write(self, fd: int, data: bytes) -> int:
        """Write events."""
        return self._asked(self._open[fd], _WRITE, data=data)[0]

    def ioctl(self, fd: int, request: int, argument: bytearray | int) -> int:
        """Ask as the kernel is asked."""
        if isinstance(argument, int):
            assert request in (EVIOCGRAB, EVIOCRMFF)
            return self._asked(self._open[fd], _IOCTL, request, argument)[0]
        assert len(argument) == request >> 16 & 0x3FFF
        result, data = self._asked(self._open[fd], _IOCTL, request, data=bytes(argument))
        argument[: len(data)] = data
        return result

    def _asked(
        self, door: socket.socket, op: int, request: int = 0, value: int = 0, data: bytes = b""
    ) -> tuple[int, bytes]:
        try:
            door.send(_ASKED.pack(op, len(data), request, value) + data)
            answer = door.recv(_ANSWERED.size + _MOST)
        except ConnectionError:
            answer = b""
        if not answer:
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))
        result, _, _ = _ANSWERED.unpack_from(answer)
        if result < 0:
            raise OSError(-result, os.strerror(-result))
        return result, answer[_ANSWERED.size :]


class FakeWheel(AxesFake):
    """A running fake; its orders are those of wheel.c."""

    first_count = "uploads"

    def advance(self, seconds: float) -> None:
        """Let time pass for a fake whose time is ``manual``."""
        self.order(f"advance {round(1e6 * seconds)}")
        self.asked()  # so that it has

    @property
    def environment(self) -> dict[str, str]:
        """With this a process of this machine has the fake as its event device."""
        return {"MANYHANDS_FAKE_EVDEV": self.path, "LD_PRELOAD": str(calls())}


def calls() -> Path:
    """evdev_calls.c, a library to preload."""
    return built("evdev_calls.so", (FAKES / "evdev_calls.c",), (*STRICT, "-shared", "-fPIC"))


@contextmanager
def fake_wheel(
    *turns: Turn, kind: str = "lg4ff", hz: int = 250, in_us: int = 1000, out_us: int = 1000
) -> Iterator[FakeWheel]:
    """A device of these axes that runs meanwhile, behind the kernel driver ``kind`` of wheel.c."""
    program = built("wheel", (FAKES / "wheel.c",), STRICT)
    numbers = [f"{number:.9g}" for turn in turns or (Turn(),) for number in astuple(turn)]
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "event7")
        process = subprocess.Popen(
            [program, path, kind, str(hz), str(in_us), str(out_us), str(len(turns) or 1), *numbers],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        with ended(process):
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
            yield FakeWheel(path, process)
