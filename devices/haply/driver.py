"""The driver of an Inverse3 behind Haply's Inverse Service: :class:`HaplyInverse3`.

    devices:
      hand: {dof: 3, driver: haply-inverse3, parameters: {device_id: "049D"}, held: torque, osp: ..., limits: {...}}

**Two messages a period.** The service answers each message with one state, and sends none by itself. The state that
answers the force of a tick is nearly a period old when the next sample is due. So a thread, the *keeper*, sends the
held force once more, :attr:`HaplyInverse3.lead` before the next sample, and ``sample`` takes what has come by then. It
waits for nothing but in one case: after a pause of the loop itself, in which nothing was asked.

**The keeper ends a force.** The service holds a force as long as it likes after the last message, and no frame says
until when. At ``until`` the keeper sends that no force is to be exerted, though the loop is silent. A process that is
stopped as a whole has no keeper either: then the service's own time counts, which is measured at the start.

**A VerseGrip** is a grip without motors whose orientation and buttons come with the same frames. So its orientation is
sensed, and costs a certificate nothing, however old it is. A frame without it leaves the one before.

The keeper has the real-time priority of the loop, once the loop has one: otherwise a busy machine would end forces
late, and let samples grow old.

**Timing.** With the longest trip R and the shortest r of :data:`TRIPS` messages and their answers, the period P in
which device and service speak over USB, and the room s for late wake-ups, the lead is R + s. As for a board, the way
there is taken to be half of the trip, and only the sum of both times counts for a certificate:

    sample_age = R + 2 s + P - r/2,   age_jitter = P + 2 s + (R - r)/2,   actuation_delay = R/2 + P.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any, Final

from manyhands.devices.haply.channel import PATIENCE, Channel, asked
from manyhands.devices.haply.service import (
    BUTTONS,
    OFF,
    ZERO,
    HaplyError,
    Reading,
    Speech,
    Vector,
    decoded,
    devices,
    grip_in,
    left_on,
    reading,
    switch,
    unusable,
    version_of,
)
from manyhands.devices.haply.work import MotorWork, same
from manyhands.devices.starting import is_number, measured_times, merged
from manyhands.extras import require
from manyhands.nodes.device.plugin import PART, DeviceDriver
from manyhands.nodes.device.specification import DeviceSpecification, DeviceTiming, OrientationSpecification, up
from manyhands.nodes.kernel.orientation import UPRIGHT
from manyhands.nodes.kernel.realtime import schedule_as
from manyhands.protocol.clock import Clock, Duration, Instant, RealtimeClock, from_seconds, seconds
from manyhands.protocol.limits import MAX_SENTENCE

TRIPS: Final = 300
"""Messages of which the longest trip counts."""

ROOM: Final = 0.1
"""Part of a period by which a thread may wake too late, s in the formulas above."""

ROUNDED: Final = 1e-3
"""N; how much the numbers of 32 bits of a report may be off, and more."""

LONGEST: Final = from_seconds(0.05)
"""How long a force without ``until`` is held."""

LISTENING: Final = from_seconds(0.2)
"""How long the keeper goes on for a loop that is silent, so that its next sample is fresh."""

FAREWELL: Final = 0.5
"""s, in which the service may answer at the end."""

WAITING: Final = 3
"""Messages without an answer from which on the keeper adds none: a service that is behind would only be later."""

IDLE_WITHIN: Final = 0.5
"""s; how long it is waited at the start for the service to let go of a device that is sent nothing."""

LOOKS: Final = 3
"""How often that is measured at most: on a busy machine the first look may come too late."""

PARAMETERS: Final[Mapping[str, object]] = {
    "device_id": "",
    "port": 10001,
    "events": 10020,
    "origin": (0.0, -0.15, 0.15),
    "force": 4.0,
    "reach": 0.15,
    "speed": 1.0,
    "force_held": "torque",
    "leave": (),
    "device_period": 0.00025,
    "silence": 0.02,
    "grip": "",
    "turning": 30.0,
    "sample_age": None,
    "actuation_delay": None,
}
"""What a session may give, and what holds where it does not (docs/devices/haply-inverse3.md has what each is)."""

_GLOBAL: Final = ("gravity_compensation", "torque_scaling")
_BRAKES: Final = {"ebrake_triggered": True, "ebrake_released": False}


class HaplyInverse3(DeviceDriver):
    """An Inverse3, with three axes.

    Attributes:
        lead: how long before a sample is due the state for it is asked for, s.
    """

    def __init__(
        self, ports: Sequence[str], period: float, parameters: Mapping[str, Any], clock: Clock | None = None
    ) -> None:
        """Connect, choose the device, switch off what it does by itself, and measure how long messages take.

        Args:
            ports: of the session's device, three.
            period: of the session, s.
            parameters: :data:`PARAMETERS`.
            clock: what the driver measures by; the realtime clock by default.

        Raises:
            ValueError: the parameters are not those.
            HaplyError: no service, no such device, or it is not ready.
            MissingExtra: the library ``websockets`` is not installed.
        """
        require("haply")  # before the service is asked, which may not answer either
        self._given = given = _checked(parameters)
        if len(ports) != 3:
            raise ValueError(f"dof: found {len(ports)}; expected 3, for an Inverse3 has the axes x, y and z")
        self._clock, self._period = clock or RealtimeClock(), from_seconds(period)
        self._lock = threading.Condition()
        self._outstanding: deque[tuple[Instant, Vector]] = deque()  # messages without an answer yet
        self._force, self._ends, self._heard = ZERO, Instant(0), Instant(0)
        self._offset = 0  # ns of the clock ahead of the session's instants
        self._due = self._wakes = Instant(0)
        self._gone = ""
        self._buttons = 0  # of a VerseGrip, by the newest frame
        self._turn: Sequence[float] | None = None  # its orientation, by the newest frame that had it
        self._turned: Sequence[float] = UPRIGHT  # at the last sample
        self._newest: tuple[Instant, Reading, Vector] | None = None  # when its message was sent, and of which force
        self._work = MotorWork()
        self._told = self._sampled = 0.0, 0  # J, and what is unknown of it: as told last, and up to the sample
        self._counts = dict.fromkeys(
            (
                "older_than_stated",
                "unsent_forces",
                "unasked_frames",
                "other_forces",
                "rate_warnings",
                "safety_events",
                "grip_missing",
            ),
            0.0,
        )
        self._oldest = self._other_most = 0.0
        self._closing, self._braked = False, False
        self._keeper: threading.Thread | None = None
        self._events: Channel | None = None
        self._restore: list[str] = []  # what was on, and is to be again
        self.lead = self._half = 0.0  # s, the latter half of the shortest trip
        self._holds = LONGEST
        self._loop = threading.get_native_id()
        self._version = version_of(asked(given["port"], "/version"))
        self._channel = Channel(given["port"])
        try:
            self._id = self._chosen(self._first())
            self._name = f"{self._channel.name}, device {self._id}"
            self._speech = Speech(self._id, self._version)
            self._by_itself = self._plain(ports)
            with suppress(HaplyError):  # without events, states tell what is wrong
                self._events = Channel(given["events"])
            self._timing = self._timed()
            self._holds, self._idle_after = self._idles()
            self._keeper = threading.Thread(target=self._keep, name="haply", daemon=True)
            self._keeper.start()
        except BaseException:
            self.close()
            raise

    # --- the start

    def _first(self) -> dict[str, dict[str, Any]]:
        """The devices of the frame that the service sends by itself."""
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            for text in self._channel.read():
                if found := decoded(text):
                    self._look_at_grip(found)
                    return devices(found)
            self._channel.wait(end - time.monotonic())
        raise HaplyError(
            f"{self._channel.name}: found no frame within {PATIENCE:g} s; expected the first one, which the service "
            "sends by itself: restart the service (Haply Hub, or haply-inverse-service)"
        )

    def _chosen(self, found: dict[str, dict[str, Any]]) -> str:
        """The id of the device, which is free and of use."""
        wanted, where = self._given["device_id"], self._channel.name
        listed = ", ".join(found) or "none"
        if not wanted and len(found) == 1:
            (wanted,) = found
        if wanted not in found:
            do = "plug it in and give it power" if not found else "choose one of them: parameters: {device_id: ...}"
            raise HaplyError(f"{where}: found the devices {listed}; expected {wanted or 'one'}: {do}")
        device, name = found[wanted], f"{where}, device {wanted}"
        first = reading(device)
        if first is None:
            raise HaplyError(f"{name}: found no cursor_position in the first frame; expected one in m")
        if first.status.get("in_use"):
            raise HaplyError(f"{name}: found it in use by another program; expected it free: end that one")
        if text := unusable(first, name):
            raise HaplyError(text)
        self._config = device.get("config")
        return str(wanted)

    def _plain(self, ports: Sequence[str]) -> tuple[str, ...]:
        """Switch off what the device does by itself; returns a sentence for all that is not off, as it reports."""
        before, why = left_on(self._config), dict[str, str]()
        for key in _GLOBAL:
            if key in before and key not in self._given["leave"]:
                try:
                    asked(self._given["port"], *switch(key, False, self._id, self._version))
                    self._restore.append(key)
                except HaplyError as error:
                    why[key] = f"; switching it off was refused ({error})"
        self._exchange(self._speech.hello(f"org.manyhands:{ports[0].partition('.')[0]}"))
        config = self._exchange(self._speech.all()).get("config")
        basis = config.get("basis") if isinstance(config, dict) else None
        if isinstance(basis, dict) and basis.get("permutation", "XYZ") != "XYZ":
            raise HaplyError(f"{self._name}: found the basis {basis}; expected XYZ, which this session has asked for")
        for key in self._given["leave"]:
            why[key] = "; it was left so (parameters.leave)"
        sentences = (f"{OFF[key]} ({key}: {how}{why.get(key, '')})" for key, how in left_on(config).items())
        return tuple(sentence[:MAX_SENTENCE] for sentence in sentences)

    def _exchange(self, text: str) -> dict[str, Any]:
        """Send a message, and wait for its answer; returns the device in it."""
        with self._lock:
            self._write(text, ZERO)
        end = time.monotonic() + PATIENCE
        found: dict[str, Any] = {}
        while self._outstanding:
            if time.monotonic() > end:
                raise HaplyError(
                    f"{self._name}: found no answer within {PATIENCE:g} s; expected one for each message: restart "
                    "the service"
                )
            self._channel.wait(end - time.monotonic())
            found = self._read() or found
        self._usable()
        return found

    def _timed(self) -> DeviceTiming:
        """The timing as it is measured, or as the session gives it."""
        given, text = self._given, self._speech.force(ZERO)
        trips = []
        for _ in range(TRIPS):
            sent = self._clock.now()
            self._exchange(text)
            trips.append(seconds(Duration(self._clock.now() - sent)))
        shortest, longest = min(trips), max(trips)
        room, own = ROOM * seconds(self._period), given["device_period"]
        self._half = shortest / 2.0
        self.lead = longest + room
        age, delay = given["sample_age"], given["actuation_delay"]
        delay = up(longest / 2.0 + own) if delay is None else delay
        if age is not None:
            self.lead = min(self.lead, max(room, age - room - own + self._half))
            return DeviceTiming(age, None, delay)
        age = up(longest + 2.0 * room + own - self._half)
        return DeviceTiming(age, min(age, up(own + 2.0 * room + (longest - shortest) / 2.0)), delay)

    def _idles(self) -> tuple[Duration, float]:
        """How long the service surely holds a force after a message, and after how long it has let go, s.

        The latter is infinite where that was not seen.
        """
        holds, idle = LONGEST, math.inf
        for _ in range(LOOKS):
            self._exchange(self._speech.force(ZERO))
            if self._newest is None or self._newest[1].idle:
                break  # at a force of zero it is idle already
            holds, idle = self._idle_once()
            if holds:
                break
        return min(holds, LONGEST), idle

    def _idle_once(self) -> tuple[Duration, float]:
        sent, holds = time.monotonic(), 0.0
        with suppress(HaplyError):
            while (looked := time.monotonic() - sent) < IDLE_WITHIN:
                now = devices(asked(self._given["port"], "/devices")).get(self._id)
                state = None if now is None else reading(now)
                if state is not None and state.idle:
                    return from_seconds(holds), time.monotonic() - sent
                holds = looked
                self._channel.wait(0.005)
        return LONGEST, math.inf

    # --- the loop

    def specification(self) -> DeviceSpecification:
        """What the session's parameters say of the device, the timing that was measured, and what was left on."""
        given, by_itself = self._given, self._by_itself
        if self._idle_after == math.inf:
            by_itself += (f"may hold a force for {IDLE_WITHIN:g} s and more where its driver's process is stopped",)
        return DeviceSpecification(
            force=(given["force"],) * 3,
            displacement=(given["reach"],) * 3,
            speed=(given["speed"],) * 3,
            timing=self._timing,
            measured=measured_times(given),
            axes=("x", "y", "z"),
            holds_torque=given["force_held"] == "torque",
            by_itself=by_itself,
            buttons=BUTTONS,
            orientation=None if self._turn is None else OrientationSpecification(given["turning"]),
        )

    def orientation(self) -> Sequence[float]:
        """That of its VerseGrip, by the newest frame that had it; (w, x, y, z)."""
        return self._turned

    def buttons(self) -> int:
        """The buttons of its VerseGrip that are held down by the newest frame."""
        return self._buttons

    def sample(self, tick: int, at: Instant) -> Sequence[float]:
        """The newest displacement from the origin, m."""
        now = self._clock.now()
        self._offset, self._heard = now - at, now
        self._read()
        newest = self._fresh(now)
        self._turned = self._turn or UPRIGHT
        self._sampled = self._work.sum, self._work.unknown
        return [a - b for a, b in zip(newest.position, self._given["origin"], strict=True)]

    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> None:
        """Send the force f, N, which the keeper ends at ``until``."""
        now = self._clock.now()
        x, y, z = f
        self._set((x, y, z), Instant(now + (LONGEST if until is None else until - at)), now)

    def release(self, at: Instant) -> None:
        """Send no force."""
        now = self._clock.now()
        self._set(ZERO, now, now)

    def exerted(self) -> Sequence[float] | None:
        """The force that the service reports, N; None as long as no state answers one like the last.

        A report that differs by less than :data:`ROUNDED` is the force that was given.
        """
        self._read()
        given = self._force
        if self._newest is None or self._newest[2] != given:
            return None
        told = self._newest[1].force
        if told is not None and all(abs(a - b) < ROUNDED for a, b in zip(told, given, strict=True)):
            return given
        return None if self._work.late else told

    def work(self) -> float | None:
        """The work of the motors since the last call, J; None where the frames do not tell it."""
        (before, unknown), self._told = self._told, self._sampled
        done, missing = self._sampled
        return None if missing > unknown or self._work.doubted else done - before

    def idle(self, due: Instant) -> None:
        """Read what has come, and have the state for the sample at ``due`` asked for in time."""
        self._read()
        self._due = Instant(due + self._offset)

    def figures(self) -> Mapping[str, float]:
        """What came late or not at all, and what the service reports otherwise than it was told."""
        idle = 0.0 if self._idle_after == math.inf else 1e3 * self._idle_after
        return {
            "oldest_ms": 1e3 * self._oldest,
            **self._counts,
            "other_most": self._other_most,
            "idle_after_ms": idle,
            "torques_doubted": float(self._work.doubted),
            "work_unknown": float(self._work.unknown),
        }

    def close(self) -> None:
        """Send no force, end the keeper, and switch on again what was on; a second call does nothing."""
        with self._lock:
            if self._closing:
                return
            self._closing = True
            if self._keeper is not None:
                with suppress(HaplyError):
                    self._write(self._speech.force(ZERO), ZERO)
            self._lock.notify()
        if self._keeper is not None:
            self._keeper.join()
        self._channel.close()
        if self._events is not None:
            self._events.close()
        for key in self._restore:
            with suppress(HaplyError):  # a service that is gone
                asked(self._given["port"], *switch(key, True, self._id, self._version), timeout=FAREWELL)

    # --- what comes

    def _read(self) -> dict[str, Any] | None:
        """Take all that has come; returns the device of the last frame."""
        found = None
        for text in self._channel.read():
            found = self._take(text) or found
        if self._channel.owed:
            with self._lock:
                self._channel.answer()
        if self._events is not None:
            self._listen(self._events)
        return found

    def _take(self, text: str) -> dict[str, Any] | None:
        if not self._outstanding:
            self._counts["unasked_frames"] += 1
            self._work.gap()
            return None
        sent, f = self._outstanding.popleft()
        frame = decoded(text)
        self._look_at_grip(frame)
        device = devices(frame).get(self._id)
        now = None if device is None else reading(device)
        if device is None or now is None:
            self._gone = f"{self._name}: found a frame without it; expected its state: see its cable and its power"
            return None
        before = f if self._newest is None else self._newest[2]
        if self._newest is not None and any(before) and self._clock.now() - self._newest[0] > self._holds:
            self._work.gap()  # the service may have let go: this answer came so long after the force before was sent
        self._newest = sent, now, f
        self._work.take(now, f)
        if now.force is not None and not same(now.force, f) and not same(now.force, before):
            most = max(abs(a - b) for a, b in zip(now.force, f, strict=True))
            if most > PART * self._given["force"]:
                self._counts["other_forces"] += 1
                self._other_most = max(self._other_most, most)
        return device

    def _look_at_grip(self, frame: Any) -> None:
        """Take the buttons and the orientation of the VerseGrip from a frame."""
        grip = grip_in(frame, self._given["grip"])
        self._buttons = 0 if grip is None else grip.buttons
        if grip is not None and grip.orientation is not None:
            self._turn = grip.orientation
        elif self._turn is not None:
            self._counts["grip_missing"] += 1

    def _listen(self, events: Channel) -> None:
        try:
            texts = events.read()
        except HaplyError:
            self._events = None
            events.close()
            return
        for text in texts:
            event = decoded(text)
            data = event.get("data") if isinstance(event, dict) else None
            name = str(event.get("name")) if isinstance(event, dict) else ""
            data = data if isinstance(data, dict) else {}
            if "rate" in name:
                self._counts["rate_warnings"] += 1
            if data.get("device_id") != self._id:
                continue
            if name == "device-safety-triggered":
                self._counts["safety_events"] += 1
                self._braked = _BRAKES.get(str(data.get("safety_type")), self._braked)
            elif name == "device-disconnected":
                self._gone = f"{self._name}: found it disconnected; expected it plugged in: see its cable and its power"

    def _usable(self) -> Reading:
        """The newest reading, of a device that is there and obeys."""
        if self._gone:
            raise HaplyError(self._gone)
        if self._braked:
            raise HaplyError(f"{self._name}: found its emergency brake on; expected it free: release the brake")
        if self._newest is None:
            raise HaplyError(f"{self._name}: found no state of it in any frame; expected one for each message")
        if text := unusable(self._newest[1], self._name):
            raise HaplyError(text)
        return self._newest[1]

    def _fresh(self, now: Instant) -> Reading:
        """The newest reading, for a sample at ``now``."""
        newest = self._usable()
        limit = max(from_seconds(self._given["silence"]), 2 * self._period)
        bound = limit
        with self._lock:  # the keeper may ask as soon as it sees that the loop goes on
            asked = self._outstanding[0][0] if self._outstanding else None
        if self._asked_before(now if asked is None else asked) > 2 * self._period:  # nothing was asked: a pause
            bound = Duration(2 * self._period)
            if asked is None:
                self._send()
        while (
            (now := self._clock.now()) and self._asked_before(now) > bound
            and self._outstanding and now - self._outstanding[0][0] <= limit
        ):  # fmt: skip
            self._channel.wait(seconds(self._period))
            self._read()
            newest = self._usable()
        before = self._asked_before(now)
        if before > limit:
            raise HaplyError(
                f"{self._name}: found no answer for {1e-6 * before:.0f} ms; expected one for each message within "
                f"{1e-6 * limit:g} ms: the service is busy or stopped (see its log)"
            )
        age = seconds(before) + self._given["device_period"] - self._half
        self._oldest = max(self._oldest, age)
        self._counts["older_than_stated"] += age > self._timing.sample_age
        return newest

    def _asked_before(self, now: Instant) -> Duration:
        """How long before ``now`` the message was sent that the newest reading answers."""
        assert self._newest is not None  # noqa: S101 -- there is one after the start
        return Duration(now - self._newest[0])

    # --- what goes, under the lock

    def _set(self, f: Vector, ends: Instant, now: Instant) -> None:
        self._heard = now
        with self._lock:
            self._force, self._ends = (f, ends) if ends > now else (ZERO, now)
            self._write(self._speech.force(self._force), self._force)
            if ends < self._wakes:
                self._lock.notify()

    def _send(self) -> None:
        """Send what holds at this instant."""
        with self._lock:
            if self._clock.now() >= self._ends:
                self._force = ZERO
            self._write(self._speech.force(self._force), self._force)

    def _write(self, text: str, f: Vector) -> None:
        self._outstanding.append((self._clock.now(), f))  # before it goes: its answer may be read at once
        if not self._channel.send(text):
            self._outstanding.pop()
            self._counts["unsent_forces"] += 1

    def _keep(self) -> None:
        """Send what holds, shortly before each sample and at the end of each force."""
        lead = from_seconds(self.lead)
        try:
            while not self._closing:
                schedule_as(self._loop)
                now = self._clock.now()
                asks = Instant(self._due - lead)
                asks = Instant(asks - (asks - now) // self._period * self._period) if asks > now else asks
                if asks <= now:
                    asks = Instant(asks + ((now - asks) // self._period + 1) * self._period)
                with self._lock:
                    if self._closing:
                        break  # close() has called already, and does so once
                    holds = self._force != ZERO
                    self._wakes = min(asks, self._ends) if holds else asks
                    if self._wakes > now:
                        self._lock.wait(seconds(Duration(self._wakes - now)))
                    if self._closing or self._clock.now() < self._wakes:
                        continue  # it was woken, since a force ends sooner
                ended = holds and self._clock.now() >= self._ends
                listening = holds or self._clock.now() - self._heard < LISTENING
                if ended or (listening and len(self._outstanding) < WAITING):
                    self._send()
        except HaplyError as error:
            self._gone = str(error)


def _checked(parameters: Mapping[str, Any]) -> dict[str, Any]:
    given = merged(parameters, PARAMETERS)
    for key in ("port", "events"):
        if type(given[key]) is not int or not 0 < given[key] < 65536:
            raise ValueError(f"{key}: found {given[key]!r:.40}; expected a port's number")
    for key in ("force", "reach", "speed", "turning", "device_period", "silence", "sample_age", "actuation_delay"):
        if PARAMETERS[key] is None and given[key] is None:
            continue
        given[key] = _positive(key, given[key])
    for key in ("device_id", "grip"):
        if not isinstance(given[key], str):
            raise ValueError(
                f"{key}: found {given[key]!r:.40}; expected the id as text, in quotes: YAML takes some ids for numbers"
            )
    if given["force_held"] not in ("torque", "firmware"):
        raise ValueError(f"force_held: found {given['force_held']!r:.40}; expected torque or firmware")
    if not isinstance(given["leave"], list | tuple) or (set(map(str, given["leave"])) - set(_GLOBAL)):
        raise ValueError(f"leave: found {given['leave']!r:.60}; expected a list of {' and '.join(_GLOBAL)}")
    origin = given["origin"]
    if not isinstance(origin, list | tuple) or len(origin) != 3 or not all(map(is_number, origin)):
        raise ValueError(f"origin: found {origin!r:.60}; expected the three coordinates of x = 0, m")
    return given


def _positive(key: str, value: Any) -> float:
    if not is_number(value) or value <= 0.0:
        raise ValueError(f"{key}: found {value!r:.40}; expected a number greater than 0")
    return float(value)
