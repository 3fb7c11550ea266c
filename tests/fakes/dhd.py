"""The fake library of Force Dimension's SDK and its devices (dhd.c), to be loaded, looked at, and given orders."""

from __future__ import annotations

import ctypes
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import pytest

from manyhands.protocol.clock import Instant

from .compiled import FAKES, built

LINKAGE: Final = {"kind": "delta", "base": 0.08, "platform": 0.03, "upper": 0.12, "rod": 0.2}
"""Its kinematics as a session states them, m; the session's x, y, z are the driver's y, z, x."""

MIDDLE: Final = 0.16
"""m; the linkage's z at 0."""

_BEGIN: Final = 10_000_000_000


def library() -> Path:
    """The library, compiled."""
    flags = ("-std=gnu99", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC")
    return built("libdrd.so", (FAKES / "dhd.c",), flags)


@dataclass(frozen=True)
class Seen:
    """What a device does: place (m), acting torques (N·m), work (J) and counts."""

    x: tuple[float, ...]
    t: tuple[float, ...]
    work: float
    watchdogs: int
    reads: int
    sets: int
    forces: bool
    braked: bool
    gravity: bool
    guard_us: int
    watchdog: int
    mode: int


class FakeDevices:
    """The devices of one test.

    Attributes:
        path: of the library.
    """

    def __init__(self) -> None:
        self.path = str(library())
        self._library = ctypes.CDLL(self.path)
        self._library.fake_dhd_time.restype = ctypes.c_int64
        self._library.fake_dhd_time.argtypes = [ctypes.c_int64]

    def order(self, line: str, device: int = 0) -> None:
        """Give orders of dhd.c, a line each, all at one instant."""
        assert self._library.fake_dhd_order(device, line.encode()) == 0, line

    def asked(self, device: int = 0) -> Seen:
        """What the device does at this instant."""
        out = (ctypes.c_double * 16)()
        assert self._library.fake_dhd_ask(device, out) == 0
        n = [int(value) for value in out[7:]]
        return Seen(tuple(out[:3]), tuple(out[3:6]), out[6], *n[:3], *(bool(value) for value in n[3:6]), *n[6:])  # type: ignore[arg-type]

    def force(self, device: int = 0) -> tuple[float, ...]:
        """The force (N) that the torques stood for which act, when they came."""
        out = (ctypes.c_double * 3)()
        assert self._library.fake_dhd_force(device, out) == 0
        return tuple(out)

    def wrist(self, device: int = 0) -> tuple[float, ...]:
        """The torques (N·m) of its wrist's joints."""
        out = (ctypes.c_double * 3)()
        assert self._library.fake_dhd_wrist(device, out) == 0
        return tuple(out)

    def time(self, to: int = 0) -> int:
        """The devices' time, ns; ``to`` makes it the test's."""
        return int(self._library.fake_dhd_time(to))

    def forget(self) -> None:
        """Let go of the devices' file."""
        self._library.fake_dhd_forget()


class OwnTime:
    """The time of devices that goes on by their exchanges and by :meth:`sleep_until`, and not by the machine."""

    def __init__(self, of: FakeDevices) -> None:
        self._of = of
        of.time(_BEGIN)

    def now(self) -> Instant:
        return Instant(self._of.time())

    def sleep_until(self, t: Instant) -> None:
        self._of.time(max(t, self.now()))

    def wait(self, seconds: float) -> None:
        """Let a time pass, s."""
        self.sleep_until(Instant(self.now() + int(1e9 * seconds)))


@contextmanager
def fake_devices() -> Iterator[FakeDevices]:
    """Two devices of a test; the first is plugged in."""
    folder = Path(tempfile.mkdtemp(prefix="dhd"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FAKE_DHD", str(folder / "devices"))
        devices = FakeDevices()
        try:
            devices.order("present 1")
            yield devices
        finally:
            devices.forget()
            shutil.rmtree(folder)
