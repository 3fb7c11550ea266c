"""A fake moteus behind a fake fdcanusb: the maker's documents, written down a second time.

Registers and modes are those of mjbots/moteus ``docs/protocol/registers.md``; the watchdog leads to mode 11, which a
stop alone ends (``docs/troubleshooting/timeout-mode-11.md``); a fault is mode 1, which a stop clears. Any drive begins
with the steps 2 to 4. Settings are in memory, as by ``conf set``.
"""

from __future__ import annotations

import math
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from .rotor import Controller, FakeMotor, Rotor, fake_motor, serve

SETTINGS = {
    "servo.timeout_mode": 12.0,
    "servo.fixed_voltage_mode": 0.0,
    "servo.voltage_mode_control": 0.0,
    "servo.pid_dq_hz": 1000.0,
    "servo.max_velocity": 500.0,
    "servo.max_current_desired_rate": 0.0,
    "servopos.position_min": math.nan,
    "servopos.position_max": math.nan,
    "motor.cogging_dq_scale": 0.0,
    "motor_position.output.source": 0.0,
    "motor_position.sources.0.pll_filter_hz": 4000.0,
}
PREPARING = 0.003  # s
FORMATS = ("<b", "<h", "<i", "<f")


class FakeMoteus(Controller):
    """``settings``: id, map (version of the register map), volts, uart (checksums), conf (settings of its own), and
    lapses (how often its watchdog runs out at once, as after a pause of the host)."""

    def begin(self) -> None:
        given = self.settings
        self.id, self.map, self.volts = given.get("id", 1), given.get("map", 5), given.get("volts", 24.0)
        self.uart = given.get("uart", False)
        self.conf = {**SETTINGS, **given.get("conf", {})}
        self.lapses = given.get("lapses", 0)
        self.mode, self.code, self.ready = 0, 0, 0.0
        self.wanted: dict[int, float] = {}
        self.said = b""
        self.powered = time.monotonic()

    def expire(self) -> None:
        self.mode = 11
        # any other end than "stopped" brakes: here it holds on to the torque, so that a test sees it
        if self.conf["servo.timeout_mode"] == 0:
            self.torque = 0.0

    def told(self) -> int:
        return int(self.wanted.get(0, 0))

    def fault(self, code: int) -> None:
        self.mode, self.code, self.torque, self.expires = 1, code, 0.0, math.inf
        if code == 40:
            self.volts = 8.0

    def crc(self, data: bytes) -> int:
        crc = 0
        for byte in data:
            crc ^= byte
            for _ in range(8):
                crc = (crc << 1 ^ 0x97 if crc & 0x80 else crc << 1) & 0xFF
        return crc

    def say(self, text: bytes) -> None:
        if self.uart:
            text += b" "
            text += b"*%02X" % self.crc(text)
        self.answer(text + b"\r\n")

    def line(self, text: bytes) -> None:
        text, star, claimed = text.strip().partition(b"*")
        if star and int(claimed, 16) != self.crc(text):
            self.counts["bad"] += 1
            self.say(b"ERR checksum")
            return
        words = text.split()
        if words[:2] == [b"can", b"on"]:
            self.say(b"OK")
        elif words[:2] == [b"can", b"send"] and len(words) >= 4:
            if not self.uart:
                self.say(b"OK")  # of the converter, before any answer
            self.frame(int(words[2], 16), bytes.fromhex(words[3].decode()))
        elif words:
            self.counts["bad"] += 1
            self.say(b"ERR unknown command")

    def frame(self, identifier: int, data: bytes) -> None:
        if identifier & 0x7F != self.id or len(data) not in (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64):
            self.counts["bad"] += 1
            return
        reply, written, at = b"", dict[int, float](), 0

        def varuint() -> int:
            nonlocal at
            value = shift = 0
            while True:
                byte = data[at]
                at += 1
                value |= (byte & 0x7F) << shift
                shift += 7
                if byte < 0x80:
                    return value

        while at < len(data):
            kind = data[at]
            at += 1
            if kind == 0x50:
                continue
            if kind == 0x40:
                channel, size = varuint(), varuint()
                self.console(channel, data[at : at + size])
                at += size
            elif kind == 0x42:
                channel, size = varuint(), varuint()
                part, self.said = self.said[:size], self.said[size:]
                reply += bytes([0x41, channel, len(part)]) + part
            elif kind < 0x20:
                count = kind & 3 or varuint()
                first, form = varuint(), FORMATS[kind >> 2 & 3]
                if kind >= 0x10:
                    reply += bytes([0x20 | kind & 0x0C, count]) + self.number(first)
                for register in range(first, first + count):
                    if kind >= 0x10:
                        reply += struct.pack(form, self.read(register, form))
                    else:
                        (value,) = struct.unpack_from(form, data, at)
                        written[register] = math.nan if form == "<b" and value == -128 else value
                        at += struct.calcsize(form)
            else:
                self.counts["bad"] += 1
                return
        if written:
            self.write(written)
        if identifier & 0x8000:
            source = identifier >> 8 & 0x7F
            self.say(b"rcv %x %s E B F" % (self.id << 8 | source, reply.hex().encode()))

    def number(self, register: int) -> bytes:
        return bytes([register]) if register < 0x80 else bytes([register & 0x7F | 0x80, register >> 7])

    def read(self, register: int, form: str) -> float:
        self.wake()
        found = {
            0x000: self.mode, 0x001: self.turns, 0x002: self.scale * self.speed / (2.0 * math.pi), 0x003: self.torque,
            0x00D: 2.0 * self.volts if form == "<b" else self.volts, 0x00E: 31, 0x00F: self.code,
            0x070: 1e3 * (time.monotonic() - self.powered), 0x101: 0x010000, 0x102: self.map,
        }[register]  # fmt: skip
        return found if form == "<f" else int(found)

    def wake(self) -> None:
        if self.mode in (2, 3, 4):
            self.mode = 10 if self.at >= self.ready else 3
            if self.mode == 10:
                self.drive()

    def write(self, written: dict[int, float]) -> None:
        mode = written.get(0)
        if mode == 0:
            self.wanted = written
            self.mode, self.code, self.torque, self.expires = 0, 0, 0.0, math.inf
        elif mode == 10 and self.mode not in (1, 11):
            self.wanted = written
            if self.held:
                self.fault(self.held)
                return
            if self.lapses:
                self.lapses -= 1
                self.expire()
                return
            if self.mode == 0:
                self.mode, self.ready = 2, self.at + PREPARING
            self.wake()
            if self.mode == 10:
                self.drive()
            self.lives = written.get(0x27, 0.0) or 0.1
            self.expires = math.inf if math.isnan(self.lives) else self.at + self.lives

    def drive(self) -> None:
        """A torque with gains would be another one: then it is none, so that a test sees it."""
        of = self.wanted
        pure = (of.get(0x23), of.get(0x24), of.get(0x2B)) == (0, 0, 0) and math.isnan(of.get(0x20, 0.0))
        unlimited = min(of.get(0x28, 0.0), of.get(0x29, 0.0)) < 0
        most = of.get(0x25, math.inf)
        self.torque = max(-most, min(most, of.get(0x22, 0.0))) if pure and unlimited else 0.0

    def console(self, channel: int, text: bytes) -> None:
        words = text.decode().split()
        if channel == 1 and words[:2] == ["conf", "get"] and words[2] in self.conf:
            self.said += f"{self.conf[words[2]]:g}\r\n".encode()
        elif channel == 1 and words[:2] == ["conf", "set"] and words[2] in self.conf:
            self.conf[words[2]] = float(words[3])
            self.said += b"OK\r\n"
        else:
            self.said += b"ERR unknown\r\n"


@contextmanager
def fake_moteus(rotor: Rotor | None = None, link: Path | None = None, **settings: Any) -> Iterator[FakeMotor]:
    """A moteus that runs meanwhile."""
    with fake_motor("moteus", rotor or Rotor(), settings, link) as one:
        yield one


if __name__ == "__main__":
    serve(FakeMoteus)
