"""A fake motor controller's body: a rotor, a watchdog, latency, and a pseudo-terminal; orders come on standard input.

    J w' = t - b w - friction + k (r(time) - angle),   r(time) = amplitude sin(2 pi frequency time)

It runs in a process of its own and in real time (``python -m tests.fakes.moteus FD JSON``), with the standard library
alone. Orders, a line each:

    stall MS     neither read nor send for so long, as a busy bus does; what came meanwhile is read afterwards
    mute, speak  send nothing any more, but go on reading; and send again
    drop N       leave out the next N answers
    noise        send a line that is none
    reset        begin anew, as after a brown-out
    fault CODE   the controller's own protection takes the motor's power, with this code of its maker
    hold CODE    likewise, and again whenever the host would drive the motor, as while somebody holds the stop
    free         the cause of such a fault is gone
    unplug       the line is gone, and what was on it; the motor keeps its power
    plug PATH    a new line, whose port PATH leads to
    forever      from now on a torque is held until the next one: a firmware without a watchdog
    scale K      from now on all angles are K times what they are, as of a firmware with another unit
    note WORDS   nothing but a line of the log
    log PATH     from now on write down what happens, a line each, with its instant (CLOCK_MONOTONIC, ns):
                 "o AT ORDER", "m AT TORQUE" (of the motor, N·m), "r AT LINE" (what was heard), "b AT NS" (this process
                 had no turn for so long)
    ask          answer on standard output, as JSON: the angle (rad), the torque that acts (N·m), the watchdog's time
                 (s), the state that it was told to be in, and counts
"""

from __future__ import annotations

import heapq
import json
import math
import os
import select
import subprocess
import sys
import time
import tty
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from .ordered import OrderedFake, ended

STEP = 1e-4  # s, of the motion
LATE = 1e-3  # s, from which on a turn that comes late is written down


@dataclass(frozen=True)
class Rotor:
    """Inertia (kg·m²), damping (N·m·s), dry friction (N·m), encoder's counts a turn, the hand (N·m/rad, rad, Hz)."""

    J: float = 2e-4
    b: float = 2e-3
    c: float = 0.0
    counts: int = 16384
    k: float = 0.0
    amplitude: float = 0.0
    frequency: float = 0.0
    latency: float = 2e-4  # s, from a question's arrival to its answer


class Controller(ABC):
    """What every fake controller does; one maker's protocol is a subclass."""

    def __init__(self, fd: int, rotor: Rotor, **settings: Any) -> None:
        self.fd, self.rotor, self.settings = fd, rotor, settings
        self.angle = self.speed = self.torque = 0.0  # rad, rad/s, N·m
        self.expires = math.inf  # when the watchdog ends the torque
        self.lives = 0.0  # its time as it was set last, s
        self.began = self.at = time.monotonic()
        self.scale = 1.0
        self.counts: dict[str, int] = {"lines": 0, "bad": 0, "expired": 0}
        self.held = 0  # the code of the fault that comes again
        self._stalled, self._mute, self._drop, self._forever = 0.0, False, 0, False
        self._port: Path | None = None  # that leads to its line, once it was plugged in by an order
        self._far_end = -1  # an end that stays open: without one a line hangs up when its reader goes
        self._log: Path | None = None
        self._lines: list[str] = []  # of the log, which are still to be written
        self._noted = 0.0  # the torque that was written down last
        self._leaving: list[tuple[float, int, bytes]] = []
        self._sent = 0
        self._coming = b""
        self.begin()

    @abstractmethod
    def begin(self) -> None:
        """The state after power has come."""

    @abstractmethod
    def line(self, text: bytes) -> None:
        """Take a line of the host."""

    @abstractmethod
    def expire(self) -> None:
        """The watchdog has run out."""

    @abstractmethod
    def told(self) -> int:
        """The state that the host has told it to be in last, in the maker's numbers."""

    @abstractmethod
    def fault(self, code: int) -> None:
        """The controller protects itself."""

    @abstractmethod
    def wake(self) -> None:
        """Exert the torque that waits for it, once the axis has become ready."""

    @property
    def turns(self) -> float:
        """The angle as its encoder has it, turns."""
        turns = self.angle / (2.0 * math.pi)
        return self.scale * math.floor(turns * self.rotor.counts + 0.5) / self.rotor.counts

    def answer(self, text: bytes) -> None:
        """Send a line once the latency is over."""
        if self._mute:
            return
        if self._drop:
            self._drop -= 1
            return
        self._sent += 1
        heapq.heappush(self._leaving, (time.monotonic() + self.rotor.latency, self._sent, text))

    def advance(self, to: float) -> None:
        """Move the rotor up to an instant; the watchdog ends the torque in between."""
        while self.at < to:
            if self.at >= self.expires and not self._forever:
                self.expires = math.inf
                self.counts["expired"] += 1
                self.expire()
            self.wake()
            self._note_torque()
            end = min(to, self.at + STEP)
            if not self._forever:  # else an end that has passed would make the steps 1 ns long
                end = min(end, max(self.expires, self.at + 1e-9))
            self._move(end - self.at)
            self.at = end

    def _move(self, dt: float) -> None:
        of = self.rotor
        goal = of.amplitude * math.sin(2.0 * math.pi * of.frequency * (self.at - self.began))
        drive = self.torque + of.k * (goal - self.angle)
        speed = (self.speed + dt * drive / of.J) / (1.0 + dt * of.b / of.J + dt * dt * of.k / of.J)
        most = dt * of.c / of.J
        self.speed = speed - most if speed > most else speed + most if speed < -most else 0.0
        self.angle += dt * self.speed

    def note(self, kind: str, words: object, at: float | None = None) -> None:
        """Write a line of the log, of this instant unless another is given."""
        if self._log is not None:
            self._lines.append(f"{kind} {1e9 * (self.at if at is None else at):.0f} {words}\n")

    def _note_torque(self) -> None:
        if self.torque != self._noted:
            self._noted = self.torque
            self.note("m", repr(self.torque))

    def _unplug(self) -> None:
        if self._port is not None:
            self._port.unlink(missing_ok=True)
        for fd in (self.fd, self._far_end):
            if fd >= 0:
                os.close(fd)
        self.fd = self._far_end = -1
        self._leaving, self._coming = [], b""

    def _plug(self, port: Path) -> None:
        self._unplug()
        self.fd, self._far_end = os.openpty()
        tty.setraw(self._far_end)
        os.set_blocking(self.fd, False)
        port.symlink_to(os.ttyname(self._far_end))
        self._port = port

    def order(self, line: str) -> None:
        """Follow an order of the test."""
        self.note("o", line)
        word, _, rest = line.partition(" ")
        if word == "stall":
            self._stalled = time.monotonic() + 1e-3 * float(rest)
        elif word in ("mute", "speak"):
            self._mute = word == "mute"
        elif word == "drop":
            self._drop = int(rest)
        elif word == "noise":
            os.write(self.fd, b"\x80noise\r\n")
        elif word == "reset":
            self.torque, self.expires = 0.0, math.inf
            self.begin()
        elif word == "fault":
            self.fault(int(rest, 0))
        elif word == "hold":
            self.held = int(rest, 0)
            self.fault(self.held)
        elif word == "free":
            self.held = 0
        elif word == "unplug":
            self._unplug()
        elif word == "plug":
            self._plug(Path(rest))
        elif word == "forever":
            self._forever = True
        elif word == "scale":
            self.scale = float(rest)
        elif word == "log":
            self._log = Path(rest)
            self.note("m", repr(self.torque))
        elif word == "ask":
            if self._log is not None:
                with self._log.open("a") as log:
                    log.writelines(self._lines)
                self._lines.clear()
            found = {
                "angle": self.angle,
                "torque": self.torque,
                "lives": self.lives,
                "told": self.told(),
                **self.counts,
            }
            sys.stdout.write(json.dumps(found) + "\n")
            sys.stdout.flush()
        elif word != "note":
            raise SystemExit(f"unknown order {line!r}")
        self._note_torque()

    def run(self) -> None:
        """Until standard input ends."""
        os.set_blocking(self.fd, False)
        orders = b""
        while True:
            now = time.monotonic()
            stalled = now < self._stalled
            due = self._stalled if stalled else self._leaving[0][0] if self._leaving else math.inf
            wait = max(0.0, min(due - now, 1e-3))
            ready, _, _ = select.select([0] if stalled or self.fd < 0 else [0, self.fd], [], [], wait)
            woken = time.monotonic()
            self.advance(woken)
            if 0 in ready:
                if not (data := os.read(0, 4096)):
                    return
                *lines, orders = (orders + data).split(b"\n")
                for line in lines:
                    self.order(line.decode())
            if self.fd in ready and time.monotonic() >= self._stalled:
                self._read()
            while self._leaving and self._leaving[0][0] <= time.monotonic() and time.monotonic() >= self._stalled:
                with suppress(BlockingIOError):
                    os.write(self.fd, heapq.heappop(self._leaving)[2])
            begun, ended = min(woken, now + wait), time.monotonic()
            if ended > begun + LATE:
                self.note("b", f"{1e9 * (ended - begun):.0f}", ended)

    def _read(self) -> None:
        with suppress(OSError):
            self._coming += os.read(self.fd, 65536)
        *lines, self._coming = self._coming.split(b"\n")
        for line in lines:
            self.counts["lines"] += 1
            self.note("r", line.decode("ascii", "replace"))
            self.line(line)
            self._note_torque()


class FakeMotor(OrderedFake):
    """A running controller; its orders are those above."""

    def asked(self) -> dict[str, float]:
        """Its angle (rad), the torque that acts (N·m), its watchdog (s), state and counts, of this instant."""
        found: dict[str, float] = json.loads(self.answer())
        return found


@contextmanager
def fake_motor(kind: str, rotor: Rotor, settings: dict[str, Any], link: Path | None = None) -> Iterator[FakeMotor]:
    """A controller of this kind that runs meanwhile; ``link`` is made to lead to its port."""
    master, slave = os.openpty()
    tty.setraw(slave)
    path = os.ttyname(slave)
    try:
        process = subprocess.Popen(
            [sys.executable, "-m", f"tests.fakes.{kind}", str(master), json.dumps([asdict(rotor), settings])],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, pass_fds=(master,), cwd=Path(__file__).parents[2],
        )  # fmt: skip
    finally:
        os.close(master)
    if link is not None:
        link.unlink(missing_ok=True)
        link.symlink_to(path)
    try:
        with ended(process):
            yield FakeMotor(path, process)
    finally:
        os.close(slave)


def serve(kind: type[Controller]) -> None:
    """The process of a fake."""
    rotor, settings = json.loads(sys.argv[2])
    kind(int(sys.argv[1]), Rotor(**rotor), **settings).run()
