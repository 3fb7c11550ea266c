"""A fake ODrive of firmware 0.6 behind its ASCII port: the maker's manual, written down a second time.

With ``discards`` an answer that would begin before the last one has left is discarded, as the manual says; a fake that
is given its turn late would do so more often than an ODrive does. The watchdog disarms the axis with its error as the
reason. A reason stays until ``sc``, and an axis with active errors cannot be armed.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from .rotor import Controller, FakeMotor, Rotor, fake_motor, serve

WATCHDOG = 0x1000000
UNDER_VOLTAGE = 0x200
ARMING = 0.002  # s
FLOATS = {
    "vbus_voltage": 24.0,
    "axis0.config.watchdog_timeout": 0.0,
    "axis0.controller.input_torque": 0.0,
    "axis0.config.torque_soft_max": math.inf,
    "axis0.config.torque_soft_min": -math.inf,
    "axis0.config.motor.torque_constant": 0.05,
    "axis0.config.motor.current_soft_max": 20.0,
    "axis0.config.motor.current_control_bandwidth": 5000.0,
    "axis0.config.encoder_bandwidth": 5000.0,
    "axis0.controller.config.vel_limit": 10.0,
}
WHOLES = {
    "fw_version_major": 0,
    "fw_version_minor": 6,
    "fw_version_revision": 11,
    "axis0.requested_state": 0,
    "axis0.config.enable_watchdog": 0,
    "axis0.controller.config.control_mode": 3,
    "axis0.controller.config.input_mode": 1,
    "axis0.controller.config.enable_torque_mode_vel_limit": 1,
    "axis0.config.anticogging.enabled": 0,
    "axis0.procedure_result": 0,
}


class FakeODrive(Controller):
    """``settings``: properties (of its own), uncalibrated, discards (whether answers that meet are discarded)."""

    def begin(self) -> None:
        self.floats, self.wholes = dict(FLOATS), dict(WHOLES)
        for name, value in self.settings.get("properties", {}).items():
            (self.wholes if name in self.wholes else self.floats)[name] = value
        self.state, self.reason, self.active = 1, 0, 0
        self.busy = 0.0  # until an answer has left
        self.ready, self.arming = 0.0, False

    def expire(self) -> None:
        self.disarm(WATCHDOG)
        self.active |= WATCHDOG

    def told(self) -> int:
        return self.wholes["axis0.requested_state"]

    def disarm(self, reason: int) -> None:
        self.torque = 0.0
        if self.state == 8:
            self.state, self.reason = 1, reason

    def fault(self, code: int) -> None:
        self.active |= code
        self.disarm(code)
        if code & UNDER_VOLTAGE:
            self.floats["vbus_voltage"] = 8.0

    def line(self, text: bytes) -> None:
        body, star, claimed = text.strip().partition(b"*")
        sealed = bool(star)
        if sealed and int(claimed) != self.xor(body):
            self.counts["bad"] += 1
            return
        words = body.decode().split(";")[0].split()
        said = self.said(words) if words else None
        if said is None:
            return
        now = time.monotonic()
        if now < self.busy and self.settings.get("discards"):
            self.counts["bad"] += 1
            return
        self.busy = now + self.rotor.latency
        out = said.encode()
        self.answer(out + (b"*%d" % self.xor(out) if sealed else b"") + b"\r\n")

    def xor(self, data: bytes) -> int:
        found = 0
        for byte in data:
            found ^= byte
        return found

    def said(self, words: list[str]) -> str | None:
        command, rest = words[0], words[1:]
        if command == "f":
            return f"{self.turns:.6f} {self.scale * self.speed / (2.0 * math.pi):.6f}"
        if command == "r":
            return self.read(rest[0])
        if command == "w":
            return self.write(rest[0], float(rest[1]))
        if command in ("c", "u"):
            if command == "c":
                self.floats["axis0.controller.input_torque"] = float(rest[1])
            self.feed()
            self.drive()
        elif command == "sc":
            self.active, self.reason = self.held, 0
        else:
            return "unknown command"
        return None

    def feed(self) -> None:
        on, self.lives = self.wholes["axis0.config.enable_watchdog"], self.floats["axis0.config.watchdog_timeout"]
        self.expires = self.at + self.lives if on else math.inf
        self.active &= ~WATCHDOG

    def wake(self) -> None:
        if self.arming and self.current() == 8:
            self.arming = False
            self.drive()

    def drive(self) -> None:
        """A torque that is limited by the speed would be another one: then it is none, so that a test sees it."""
        of = self.wholes
        pure = of["axis0.controller.config.control_mode"] == 1 == of["axis0.controller.config.input_mode"]
        unlimited = not of["axis0.controller.config.enable_torque_mode_vel_limit"]
        wanted = self.floats["axis0.controller.input_torque"]
        self.torque = wanted if self.current() == 8 and pure and unlimited else 0.0

    def current(self) -> int:
        if self.state == 8 and self.at < self.ready:
            return 1
        return self.state

    def read(self, name: str) -> str:
        if name in self.floats:
            return f"{self.floats[name]:f}"
        if name in self.wholes:
            return f"{self.wholes[name]:d}"
        found = {"current_state": self.current(), "disarm_reason": self.reason, "active_errors": self.active}
        name = name.removeprefix("axis0.")
        if name == "pos_estimate":
            return f"{self.turns:.6f}"
        return f"{found[name]:d}" if name in found else "invalid property"

    def write(self, name: str, value: float) -> str | None:
        if name in self.floats:
            self.floats[name] = value
        elif name in self.wholes:
            self.wholes[name] = int(value)
        else:
            return "invalid property"
        if name == "axis0.requested_state":
            if value == 8 and not self.active and not self.settings.get("uncalibrated"):
                self.state, self.reason, self.ready, self.arming = 8, 0, self.at + ARMING, True
            elif value == 8:
                self.reason = self.active
            else:
                self.disarm(0)
        elif name == "axis0.config.enable_watchdog":
            self.feed()
        return None


@contextmanager
def fake_odrive(rotor: Rotor | None = None, link: Path | None = None, **settings: Any) -> Iterator[FakeMotor]:
    """An ODrive that runs meanwhile."""
    with fake_motor("odrive", rotor or Rotor(), settings, link) as one:
        yield one


if __name__ == "__main__":
    serve(FakeODrive)
