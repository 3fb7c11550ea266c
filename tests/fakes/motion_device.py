"""Fakes of devices without motors, behind a named pipe in place of their file, in a process of their own.

A SpaceMouse reports as its documents say: numbers of 350 at full deflection, one report for each read (the pipe keeps
packets apart, as hidraw does), again and again while it is deflected, zero once it is let go, then nothing. A gamepad
sends the state of each axis and button first, and then an event for each change. What does not fit into the pipe is
lost, as in the kernel's ring. The process' end is the pull of the plug.
"""

from __future__ import annotations

import fcntl
import os
import select
import struct
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

EVERY = 0.008
"""s between two reports of a deflected SpaceMouse; those that were watched at a bus had 8 ms by cable."""


class FakeMotionDevice:
    """A running device.

    Attributes:
        path: of its pipe.
        process: that it runs in.
    """

    def __init__(self, path: Path, process: subprocess.Popen[str]) -> None:
        self.path, self.process = path, process

    def deflect(self, *parts: float) -> None:
        """Move its cap, its sticks and triggers: parts of the full deflection, in the device's own axes."""
        self._order("deflect " + " ".join(f"{part:.9g}" for part in parts))

    def press(self, button: int = 0) -> None:
        """Press a button, and let it go."""
        self._order(f"press {button}")

    def send(self, report: bytes) -> None:
        """Send these bytes."""
        self._order(f"send {report.hex()}")

    def unplug(self) -> None:
        """End it: its file is gone."""
        self.process.kill()
        self.process.wait()

    def _order(self, line: str) -> None:
        """Give an order, and wait until it was carried out."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()
        assert self.process.stdout.readline() == "done\n"


@contextmanager
def fake_motion_device(kind: str, folder: Path) -> Iterator[FakeMotionDevice]:
    """A ``compact`` or an ``enterprise`` SpaceMouse, or a ``gamepad``, that is plugged in meanwhile."""
    path = folder / kind
    if not path.exists():
        os.mkfifo(path)
    process = subprocess.Popen(
        [sys.executable, __file__, kind, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        assert process.stdout.readline() == "plugged in\n"
        yield FakeMotionDevice(path, process)
    finally:
        process.kill()
        process.wait()
        process.stdin.close()
        process.stdout.close()


def _reports(kind: str, at: Sequence[float]) -> list[bytes]:
    """The reports of a SpaceMouse whose cap is deflected by ``at``, in the axes of its reports."""
    raw = struct.pack("<6h", *(round(350.0 * part) for part in at))
    if kind == "enterprise":
        return [b"\1" + raw]
    return [b"\1" + raw[:6], b"\2" + raw[6:]]


def _event(kind: int, number: int, value: int) -> bytes:
    return struct.pack("=IhBB", int(time.monotonic() * 1000.0) & 0xFFFFFFFF, value, kind, number)


def _button(kind: str, number: int, down: bool) -> bytes:
    if kind == "gamepad":
        return _event(1, number, int(down))
    return b"\3" + ((1 << number) * down).to_bytes(4, "little")


def _moved(kind: str, before: Sequence[float], at: Sequence[float]) -> list[bytes]:
    if kind != "gamepad":
        return _reports(kind, at)
    return [
        _event(2, axis, round(32767.0 * to)) for axis, (of, to) in enumerate(zip(before, at, strict=True)) if of != to
    ]


def _main(kind: str, path: str) -> None:
    pipe = os.open(path, os.O_RDWR | os.O_NONBLOCK)
    fcntl.fcntl(pipe, fcntl.F_SETFL, fcntl.fcntl(pipe, fcntl.F_GETFL) | os.O_DIRECT)  # packets

    def send(*reports: bytes) -> None:
        for report in reports:
            try:
                os.write(pipe, report)
            except BlockingIOError:
                return

    at = [0.0] * 6 if kind != "gamepad" else [0.0, 0.0, -1.0, 0.0, 0.0, -1.0]  # a trigger at rest is at its least
    if kind == "gamepad":
        send(*(_event(0x82, axis, round(32767.0 * value)) for axis, value in enumerate(at)), _event(0x81, 0, 0))
    print("plugged in", flush=True)  # noqa: T201 -- the answer
    while True:
        deflected = kind != "gamepad" and any(at)
        if not select.select([sys.stdin], [], [], EVERY if deflected else None)[0]:
            send(*_reports(kind, at))
            continue
        order = sys.stdin.readline().split()
        if not order:
            return
        if order[0] == "deflect":
            before, at = at, [float(part) for part in order[1:]]
            send(*_moved(kind, before, at))
        elif order[0] == "press":
            send(*(_button(kind, int(order[1]), down) for down in (True, False)))
        else:
            send(bytes.fromhex(order[1]))
        print("done", flush=True)  # noqa: T201 -- the answer


if __name__ == "__main__":
    _main(*sys.argv[1:])
