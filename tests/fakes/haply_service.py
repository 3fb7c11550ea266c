"""A fake of Haply's Inverse Service, a program: WebSocket and HTTP at one port, events at another, and plants.

    python haply_service.py '{"devices": ["049D"], ...}'

It prints both ports, and takes orders as lines on standard input (:func:`Service.order`). What it says is built by
:func:`inventory`, whose names ``tests/devices/haply/test_schema.py`` holds against the maker's own. Times are real.

**The plant** is a point of the mass m at the tip of an arm of three joints, which turn about z, and twice about the
horizontal axis; b (N·s/m) damps the tip, and a hand may hold it by a spring. Joints are seen in steps. A force f on the
tip becomes the torques J(q)^T f of the joints as they are when a message has come, and these are held until the next
message; with ``"held": "firmware"`` the force itself is held. A device that hears nothing lets go after ``idle``, also
without a service.

**A log** (order "log PATH") has a line for each of these, with the instant by CLOCK_MONOTONIC, ns: "m AT f..." (the
force that the motors get, N), "r AT TEXT" (a message that was heard), "o AT ORDER", and "b FROM TO" (this process had
no turn).
"""

from __future__ import annotations

import asyncio
import json
import os
import struct
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from math import acos, atan2, cos, degrees, hypot, pi, radians, sin
from typing import Any, TextIO

from websockets.exceptions import InvalidState
from websockets.frames import Frame, Opcode
from websockets.http11 import Request
from websockets.server import ServerProtocol

DEFAULTS: dict[str, Any] = {
    "devices": ["049D"],
    "version": "3.5.0",
    "dialects": ["vector", "values"],
    "idle": 0.03,  # s without a message after which a device is idle
    "held": "torque",
    "tells_torques": True,
    "torque_unit": 1.0,
    "tells_config": True,
    "first_frame": True,
    "in_use": False,
    "refuses": [],  # keys of the config that cannot be switched off over HTTP
    "float32": False,  # whether it reports forces in 32 bits
    "late": False,  # whether a frame tells the force of the message before
    "mass": 0.15,
    "damping": 1.0,
    "step": 0.01,  # degrees
    "hand": 0.0,  # N/m
    "amplitude": 0.0,  # m
    "frequency": 0.7,  # Hz
    "gain": 0.3,  # of the force gate, as it stands at first
    "filters": True,  # whether a client may configure gate and damping
    "sign": 1.0,  # of the forces
    "pressed": None,  # the buttons of a VerseGrip that are held down, as "ac"; None without one
    "turned": None,  # its orientation, [w, x, y, z]; None without one, or where it tells none
}
LINK = 0.15  # m, both
HOME = (0.0, -0.15, 0.15)
PRIORITY = 5  # of SCHED_FIFO: above ordinary processes, and below the loops, which it must not delay
GRAIN = 1e-3  # s, in which devices move on while a log is written
DT = 5e-4  # s, the longest step: one that a busy machine can follow
STOP = 0.1  # m from home; there it has springs, before the arm is stretched


class Device:
    """A device with its plant, and what the service knows of it."""

    def __init__(self, name: str, given: dict[str, Any]) -> None:
        self.name, self.given = name, given
        self.x, self.v = list(HOME), [0.0, 0.0, 0.0]
        self.t = 0.0
        self.began = time.monotonic()
        self.force, self.torques, self.work = [0.0] * 3, [0.0] * 3, 0.0
        self.reported = [0.0] * 3
        self.heard = -1.0  # s, when a message came last
        self.status = {
            "calibrated": True,
            "power_supply": True,
            "ready": True,
            "started": True,
        }
        self.enabled = {"gravity_compensation": True, "torque_scaling": True}
        self.gate, self.damping = given["gain"], 0.0  # of the session
        self.unit = 1.0
        self.owner: int | None = None  # the session that commands it
        self.most = 0.0
        self.note: Callable[[str], None] = lambda line: None

    def joints(self) -> tuple[float, float, float]:
        x, y, z = self.x
        r = hypot(x, y)
        bend = -acos(max(-1.0, min(1.0, (r * r + z * z) / (2 * LINK * LINK) - 1.0)))
        return atan2(x, -y), atan2(z, r) - atan2(LINK * sin(bend), LINK * (1.0 + cos(bend))), bend

    def seen(self) -> tuple[float, ...]:
        """The joints as the encoders see them, rad."""
        step = radians(self.given["step"])
        return tuple(step * round(q / step) for q in self.joints())

    def loads(self, f: list[float]) -> list[float]:
        """J(q)^T f, N·m."""
        turn, one, two = self.joints()
        s, c = sin(turn), cos(turn)
        out, up = f[0] * s - f[1] * c, f[2]
        r, z = LINK * (cos(one) + cos(one + two)), LINK * (sin(one) + sin(one + two))
        return [
            r * (f[0] * c + f[1] * s),
            -z * out + r * up,
            LINK * (-sin(one + two) * out + cos(one + two) * up),
        ]

    def tip(self, torques: list[float]) -> list[float]:
        """J(q)^-T t, N."""
        turn, one, two = self.joints()
        s, c = sin(turn), cos(turn)
        r, z = LINK * (cos(one) + cos(one + two)), LINK * (sin(one) + sin(one + two))
        a, b = -LINK * sin(one + two), LINK * cos(one + two)
        area = -z * b - r * a
        out, up = (torques[1] * b - torques[2] * r) / area, (-z * torques[2] - a * torques[1]) / area
        across = torques[0] / r
        return [across * c + out * s, across * s - out * c, up]

    def advance(self) -> None:
        """Move up to the present."""
        now = time.monotonic() - self.began
        g = self.given
        while self.t < now:
            dt = min(DT, now - self.t)
            if self.heard >= 0.0 and self.t - self.heard > g["idle"]:
                self.command([0.0] * 3)
                self.heard = -1.0
            f = list(self.force) if g["held"] == "firmware" else self.tip(self.torques)
            self.most = max(self.most, *map(abs, f))
            for i in range(3):
                # each axis of the hand moves by a phase of its own
                goal = HOME[i] + g["amplitude"] * sin(2 * pi * g["frequency"] * self.t + i)
                pull = g["hand"] * (goal - self.x[i])
                away = self.x[i] - HOME[i]
                pull -= 2000.0 * (away - max(-STOP, min(STOP, away)))
                b = g["damping"] + self.damping
                self.v[i] = (self.v[i] + dt / g["mass"] * (f[i] + pull)) / (1.0 + dt * b / g["mass"])
                self.x[i] += dt * self.v[i]
                self.work += dt * f[i] * self.v[i]
            self.t += dt

    def command(self, f: list[float]) -> None:
        before = self.force
        self.force = [self.given["sign"] * (1.0 - self.gate) * value if self.works() else 0.0 for value in f]
        self.torques = self.loads(self.force)
        if self.force != before:
            self.note(f"m {time.monotonic_ns()} {' '.join(map(repr, self.force))}")

    def works(self) -> bool:
        return self.status["ready"] and self.status["power_supply"]

    def state(self) -> dict[str, Any]:
        self.advance()
        turn, one, two = self.seen()
        r, z = LINK * (cos(one) + cos(one + two)), LINK * (sin(one) + sin(one + two))
        told = self.torques if self.given["tells_torques"] else [0.0] * 3
        force = self.force
        if self.given["late"]:
            told, force = self.reported_torques, self.reported
        idle = self.heard < 0.0
        if self.given["float32"]:
            force = list(struct.unpack("3f", struct.pack("3f", *force)))
        return {
            "cursor_position": named("xyz", [self.unit * p for p in (r * sin(turn), -r * cos(turn), z)]),
            "cursor_velocity": named("xyz", self.v),
            "angular_position": angles([degrees(q) for q in (turn, one, two)]),
            "angular_velocity": angles([0.0] * 3),
            "body_orientation": {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0},
            "current_cursor_force": named("xyz", force),
            "current_cursor_position": named("xyz", [0.0] * 3),
            "current_angular_torques": angles([self.given["torque_unit"] * t for t in told]),
            "current_angular_position": angles([0.0] * 3),
            "control_domain": "undefined" if idle else "cartesian",
            "control_mode": "idle" if idle else "force",
            "mode": "idle" if idle else "force",
            "transform": {"position": named("xyz", [0.0] * 3), "scale": named("xyz", [1.0] * 3)},
        }

    reported_torques = [0.0] * 3

    def config(self) -> dict[str, Any]:
        return {
            "type": "inverse3",
            "port": "/dev/ttyACM0",
            "device_info": {"major_version": 7, "minor_version": 4, "id": self.name, "device_type": 4, "uuid": "0"},
            "extended_device_id": self.name,
            "extended_firmware_version": "0",
            "gravity_compensation": {"enabled": self.enabled["gravity_compensation"], "scaling_factor": 1.0},
            "handedness": "right",
            "streaming_mode": "USB",
            "torque_scaling": {"enabled": self.enabled["torque_scaling"]},
            "home_return": {"enabled": False},
            "preset": "defaults",
            "basis": {"permutation": "XYZ"},
            "mount": {
                "position": named("xyz", [0.0] * 3),
                "rotation": {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0},
                "scale": named("xyz", [1.0] * 3),
            },
            "filters": {"force_gate": {"gain": self.gate}, "damping": {"scalar": self.damping}},
        }

    def entry(self, config: bool) -> dict[str, Any]:
        """The device in a frame."""
        found: dict[str, Any] = {"device_id": self.name}
        if config and self.given["tells_config"]:
            found["config"] = self.config()
        state = self.state()
        in_use = self.given["in_use"] or self.heard >= 0.0
        return found | {"state": state, "status": self.status | {"in_use": in_use}}


def tell(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def named(names: str, values: list[float]) -> dict[str, float]:
    return dict(zip(names, values, strict=True))


def angles(values: list[float]) -> dict[str, float]:
    return {f"a{i}": value for i, value in enumerate(values)}


class Service:
    """The service: its sessions, and what goes wrong."""

    def __init__(self, given: dict[str, Any]) -> None:
        self.given = given
        self.devices = {name: Device(name, given) for name in given["devices"]}
        self.lost: dict[str, Device] = {}  # unplugged
        self.servers: list[asyncio.Server] = []
        self.ports: list[int] = []
        self.mute = self.dead = False
        self.log: TextIO | None = None
        self.living: asyncio.Task[None] | None = None
        self.sessions: dict[int, tuple[asyncio.StreamWriter, ServerProtocol]] = {}
        self.listeners: list[tuple[asyncio.StreamWriter, ServerProtocol]] = []
        self.profiles: list[str] = []
        self.stalled = asyncio.Event()
        self.stalled.set()
        self.messages = 0
        self.last: dict[str, float] = {}

    def inventory(self, session: int, config: bool) -> dict[str, Any]:
        """A frame."""
        frame = {"session_id": session, "inverse3": [device.entry(config) for device in self.devices.values()]}
        pressed, turned = self.given["pressed"], self.given["turned"]
        if pressed is not None or turned is not None:
            buttons = {name: name in (pressed or "") for name in "abc"}
            state: dict[str, Any] = {"buttons": buttons, "hall": 0}
            if turned is not None:
                state["orientation"] = named("wxyz", turned)
            frame["wireless_verse_grip"] = [{"device_id": "61562", "state": state}]
        return frame

    def hear(self, text: str, session: int) -> dict[str, Any]:
        """Obey a message; returns its answer."""
        self.messages += 1
        message = json.loads(text)
        asked = message.get("session", {})
        if "configure" in asked:
            self.profiles.append(asked["configure"].get("profile", {}).get("name", ""))
        for one in message.get("inverse3", []):
            device = self.devices.get(one["device_id"])
            if device is None:
                continue
            device.advance()
            device.reported, device.reported_torques = list(device.force), list(device.torques)
            configure = one.get("configure", {}) if self.given["filters"] else {}
            device.gate = configure.get("force_gate", {}).get("gain", device.gate)
            device.damping = configure.get("damping", {}).get("scalar", device.damping)
            device.heard, device.owner = device.t, session
            f = [0.0] * 3
            for dialect, value in one.get("commands", {}).get("set_cursor_force", {}).items():
                if dialect in self.given["dialects"]:
                    f = [float(value[axis]) for axis in "xyz"]
            device.command(f)
        return self.inventory(session, "force_render_full_state" in asked)

    # --- the log

    def note(self, line: str) -> None:
        if self.log is not None:
            self.log.write(line + "\n")

    async def live(self) -> None:
        """Move all devices on, so that a force ends in time where nobody asks; note when there was no turn for it."""
        last = time.monotonic_ns()
        while True:
            await asyncio.sleep(GRAIN)
            now = time.monotonic_ns()
            if now - last > 2e9 * GRAIN:
                self.note(f"b {last} {now}")
            last = now
            for device in (*self.devices.values(), *self.lost.values()):
                device.advance()

    # --- the wire

    async def serve(self, port: int = 0, events: int = 0) -> None:
        """Listen at both ports."""
        self.servers = [
            await asyncio.start_server(partial(self.talk, events=of_events), "localhost", at)
            for of_events, at in ((False, port), (True, events))
        ]

    async def talk(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, events: bool) -> None:
        with suppress(OSError, asyncio.IncompleteReadError, InvalidState):
            head = await reader.readuntil(b"\r\n\r\n")
            if b"upgrade: websocket" in head.lower():
                await self.websocket(head, reader, writer, events)
            else:
                await self.http(head, reader, writer)
        writer.close()

    async def http(self, head: bytes, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        lines = head.decode().split("\r\n")
        method, path, _ = lines[0].split()
        length = next((int(line[15:]) for line in lines if line.lower().startswith("content-length:")), 0)
        body = json.loads(await reader.readexactly(length)) if length else {}
        status, answer = self.asked(method, path.partition("?")[0], body)
        data = json.dumps(answer).encode()
        writer.write(f"HTTP/1.1 {status}\r\nContent-Length: {len(data)}\r\nConnection: close\r\n\r\n".encode() + data)
        await writer.drain()

    def asked(self, method: str, path: str, body: dict[str, Any]) -> tuple[str, Any]:
        if (method, path) == ("GET", "/version"):
            return "200 OK", {"git_tag": self.given["version"], "project_version": self.given["version"] + ".0"}
        if (method, path) == ("GET", "/devices"):
            return "200 OK", self.inventory(0, True)
        parts = path.strip("/").split("/")
        key, device = parts[-1], self.devices.get(body.get("device_id", parts[1] if len(parts) > 1 else ""))
        if method != "POST" or device is None or key not in device.enabled:
            return "404 Not Found", {"ok": False, "error": "no such route"}
        if key in self.given["refuses"]:
            return "200 OK", {"ok": False, "error": "not permitted"}
        device.enabled[key] = bool(body.get("enabled", body.get("enable")))
        return "200 OK", {"ok": True, "data": {"enabled": device.enabled[key]}}

    async def websocket(
        self, head: bytes, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, events: bool
    ) -> None:
        protocol = ServerProtocol()
        protocol.receive_data(head)
        (request,) = protocol.events_received()
        assert isinstance(request, Request)
        protocol.send_response(protocol.accept(request))
        session = max(self.sessions, default=6) + 1
        if events:
            self.listeners.append((writer, protocol))
        else:
            self.sessions[session] = writer, protocol
            if self.given["first_frame"] and not self.mute:
                protocol.send_text(json.dumps(self.inventory(session, True)).encode())
        self.flush(writer, protocol)
        try:
            while data := await reader.read(65536):
                protocol.receive_data(data)
                for event in protocol.events_received():
                    if isinstance(event, Frame) and event.opcode is Opcode.TEXT and not events:
                        await self.stalled.wait()
                        text = bytes(event.data).decode()
                        self.note(f"r {time.monotonic_ns()} {text}")
                        answer = self.hear(text, session)
                        if not self.mute:
                            protocol.send_text(json.dumps(answer).encode())
                self.flush(writer, protocol)
                if protocol.close_expected():
                    break
        finally:
            self.sessions.pop(session, None)
            self.listeners = [one for one in self.listeners if one[0] is not writer]
            for device in () if self.dead else self.devices.values():
                if device.owner == session:  # one connection is one session
                    device.advance()
                    device.command([0.0] * 3)
                    device.heard, device.owner = -1.0, None

    def flush(self, writer: asyncio.StreamWriter, protocol: ServerProtocol) -> None:
        for data in protocol.data_to_send():
            if writer.is_closing():
                raise ConnectionError("the client is gone")
            if data:
                writer.write(data)

    # --- orders

    def event(self, name: str, level: str, **data: Any) -> None:
        text = {"name": name, "category": "device", "level": level, "data": data, "message": name}
        for writer, protocol in self.listeners:
            protocol.send_text(json.dumps(text).encode())
            self.flush(writer, protocol)

    def die(self) -> None:
        """The service is killed; the devices go on."""
        self.dead = True
        for server in self.servers:
            server.close()
        for writer, _ in (*self.sessions.values(), *self.listeners):
            writer.transport.abort()
        self.listeners = []

    async def rise(self) -> None:
        """A new service, at the same ports."""
        self.dead = False
        for device in self.devices.values():
            device.gate, device.damping, device.owner = self.given["gain"], 0.0, None
            device.enabled = dict.fromkeys(device.enabled, True)
        await self.serve(*self.ports)

    async def order(self, line: str) -> str:
        """Do what a test wants: "status KEY 0|1", "ebrake", "free", "gone", "mm", "m", "stall MS", "close", "lose",
        "find", "rate", "ping", "unasked", "pressed BUTTONS", "turned W X Y Z", "mute", "speak", "first 0|1", "die",
        "rise", "forever", "log PATH", "note TEXT", "ask".
        """
        word, *rest = line.split()
        one = next(iter((*self.devices.values(), *self.lost.values())))
        self.note(f"o {time.monotonic_ns()} {line.strip()}")
        match word:
            case "status":
                one.status[rest[0]] = rest[1] == "1"
                one.advance()
                if not one.works():
                    one.command([0.0] * 3)
            case "ebrake" | "free":
                kind = "ebrake_triggered" if word == "ebrake" else "ebrake_released"
                self.event("device-safety-triggered", "error", device_id=one.name, safety_type=kind)
            case "gone":
                self.event("device-disconnected", "warning", device_id=one.name)
            case "rate":
                self.event("session-control-rate-low", "warning", session_id=7)
            case "mm" | "m":
                one.unit = 1000.0 if word == "mm" else 1.0
            case "lose":
                self.lost[one.name] = self.devices.pop(one.name)
            case "find":
                self.devices[one.name] = self.lost.pop(one.name)
            case "pressed":  # the buttons of a VerseGrip, as "ac"
                self.given["pressed"] = "".join(rest)
            case "turned":  # its orientation, as "w x y z"; none without numbers
                self.given["turned"] = [float(part) for part in rest] or None
            case "mute" | "speak":
                self.mute = word == "mute"
            case "first":
                self.given["first_frame"] = rest[0] == "1"
            case "forever":  # a device that holds its force whatever becomes of its client
                self.given["idle"], self.dead = float("inf"), True
            case "die":
                self.die()
            case "rise":
                await self.rise()
            case "log":
                self.log = open(rest[0], "w")  # noqa: SIM115 -- until the end
                for device in self.devices.values():
                    device.note = self.note
                self.living = asyncio.get_running_loop().create_task(self.live())
            case "stall":
                self.stalled.clear()
                asyncio.get_running_loop().call_later(float(rest[0]) / 1e3, self.stalled.set)
            case "close":
                for writer, protocol in list(self.sessions.values()):
                    protocol.send_close(1001, "going away")
                    self.flush(writer, protocol)
                    writer.close()
            case "ping":
                for writer, protocol in self.sessions.values():
                    protocol.send_ping(b"hello")
                    self.flush(writer, protocol)
            case "unasked":
                for session, (writer, protocol) in self.sessions.items():
                    protocol.send_text(json.dumps(self.inventory(session, False)).encode())
                    self.flush(writer, protocol)
        if self.log is not None:
            self.log.flush()
        told = {}
        for device in (*self.devices.values(), *self.lost.values()):
            device.advance()
            told[device.name] = {
                "x": [a - b for a, b in zip(device.x, HOME, strict=True)],
                "f": device.force,
                "most": device.most,
                "work": device.work,
                "idle": device.heard < 0.0,
                "enabled": device.enabled,
                "gate": device.gate,
                "damping": device.damping,
            }
        return json.dumps({"devices": told, "profiles": self.profiles, "messages": self.messages})


async def main(given: dict[str, Any]) -> None:
    service = Service(DEFAULTS | given)
    loop = asyncio.get_running_loop()
    await service.serve(given.get("port", 0), given.get("events", 0))
    service.ports = [server.sockets[0].getsockname()[1] for server in service.servers]
    with suppress(PermissionError):  # a device has processors of its own
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    tell(" ".join(map(str, service.ports)))
    reader = asyncio.StreamReader()
    await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    while line := await reader.readline():
        tell(await service.order(line.decode()))


if __name__ == "__main__":
    asyncio.run(main(json.loads(sys.argv[1])))
