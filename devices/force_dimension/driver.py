"""The driver of Force Dimension's devices: :class:`ForceDimension`.

    devices:
      omega: {dof: 3, driver: force-dimension, parameters: {serial: 7001}, held: torque, linkage: {...}, osp: ..., ...}

**Forces.** The library turns torques into motor commands, and the motors hold these until the next ones. So the driver
does what the maker's own example of the Jacobian does: it reads the encoders, computes t = J(q)^T f with the library's
J, and sends t by ``dhdSetDeltaJointTorques``. ``dhdSetForce`` would take the joints of a reading that nothing names, so
that nobody could tell the work. Where a motor cannot give its part, the driver scales all of them down first. So it
knows what is exerted.

**Work.** Each reading of the encoders is of one instant, and place, angles and J are computed from it. Between two
readings the motors do t^T dq, and new torques take the place of old ones somewhere in the call that sends them. The
driver tells the most that this can have been (:func:`most_work`). It is unknown where the watchdog may have ended the
torques in between, where the library did not refresh a reading, or scaled the torques.

**What the device would do by itself** is switched off at the start: gravity compensation, and the time guard, by which
the library answers with old readings. The watchdog is set for each force, in steps of 125 us. Exchanges are
synchronous, so that a reading is no older than its call. A tick has two of them, a reading and new torques.

**A wrist** is asked for its orientation where a session has that, which takes an exchange more. The motors of an active
one would hold torques of its joints. What these give out is paid for where J of all six axes is known
(docs/decisions/0054-orientation.md), and this driver has that of the delta alone. So no torque is ever exerted there:
the orientation of any wrist is sensed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from ctypes import CDLL, c_int, c_uint, c_ushort
from pathlib import Path
from typing import Any, Final

from manyhands.devices.force_dimension import survey
from manyhands.devices.force_dimension.library import (
    SATURATED,
    SYNCHRONOUS,
    ForceDimensionError,
    Kinematics,
    load,
    quaternion,
)
from manyhands.devices.starting import TRIPS, is_number, measured_times, merged
from manyhands.nodes.device.plugin import DeviceDriver
from manyhands.nodes.device.specification import WORLD, DeviceSpecification, DeviceTiming, OrientationSpecification, up
from manyhands.protocol.clock import Clock, Duration, Instant, RealtimeClock, from_seconds, seconds

PARAMETERS: Final[Mapping[str, object]] = {
    "library": "",
    "device": 0,
    "serial": None,
    "reach": None,
    "speed": 1.0,
    "turning": 20.0,
    "silence": 0.01,
    "sample_age": None,
    "actuation_delay": None,
}
"""What a session may give, and what holds where it does not; lengths in m, times in s. ``device`` counts from 0, and
``serial`` stands in its place. The last two stand in for what would be measured."""

REACHES: Final[Mapping[str, tuple[tuple[int, ...], float]]] = {
    "delta": ((63, 64), 0.15),
    "omega": ((32, 33, 34, 35, 36, 37), 0.075),
    "sigma": ((104, 105, 106, 107, 206), 0.075),
    "lambda": ((108, 109, 203), 0.1125),
    "Falcon": ((60,), 0.04),
}
"""Of each family the system types, and the radius of its workspace, m (CHAI3D 3.3.0, src/devices/CDeltaDevices.cpp)."""

BUTTONS: Final = tuple(f"button{i}" for i in range(16))
"""The names of its buttons, by the numbers that the library gives them; button0 is that of the grip."""

TICK: Final = Duration(125_000)
"""ns; the watchdog's step."""

LONGEST: Final = 255
"""Steps of the watchdog at most: 31.9 ms."""

CALM: Final = 200
"""Forces in a row that allow a longer watchdog, before it is set longer."""

LOOK: Final = from_seconds(0.02)
"""How often the device's status is asked for."""

_STATUS: Final = 64  # entries; the SDK has 16 or 17, by its version
_POWER, _FORCE, _ERROR, _CAUSE = 0, 5, 9, 14
_CAUSES: Final = {
    1: "by its force button: press it again",
    2: "since it was faster than its velocity threshold: hold it, and begin anew",
    4: "by a program: see that none other uses it",
    5: "since its USB was unplugged: plug it in",
    6: "since nobody holds its dead man's switch: take it into the hand",
}
"""Why a device may have taken its forces away; after the watchdog (3) the driver turns them on again."""

_MOST_DEVICES: Final = 8
_ZERO: Final = (0.0, 0.0, 0.0)


class ForceDimension(DeviceDriver):
    """A device of the maker, with the three axes of its delta structure."""

    def __init__(
        self,
        ports: Sequence[str],
        period: float,
        parameters: Mapping[str, Any],
        clock: Clock | None = None,
    ) -> None:
        """Load the library, open the device, refuse it where it is not usable, and measure its times.

        Args:
            ports: of the session's device, three.
            period: of the session, s.
            parameters: :data:`PARAMETERS`.
            clock: what the driver measures by; the realtime clock by default.

        Raises:
            ValueError: the parameters are not those.
            ForceDimensionError: there is no library or no device, or the device is not usable.
        """
        given = _checked(parameters)
        if len(ports) != 3:
            raise ValueError(f"found a device of dof {len(ports)}; expected 3: x towards the user, y right, z up")
        self._clock = clock or RealtimeClock()
        self._silence, self._speed = from_seconds(given["silence"]), given["speed"]
        self._status = (c_int * _STATUS)()
        self._t, self._F = list(_ZERO), list(_ZERO)  # the torques that are held, N·m, and the force they stand for, N
        self._first: list[float] = self._t  # the torques at the last reading, and what has changed since
        self._changes: list[Change] = []
        self._watchdog = _Watchdog()
        self._until: Instant | None = None  # of the present force, by the driver's clock
        self._work = self._answer = 0.0  # J, up to the last reading, and up to the last sample
        self._lost = self._answer_lost = False  # whether they are not known
        self._scaled = self._brief = self._may_have_ended = False
        self._oldest = 0.0  # s
        self._old = self._unrefreshed = self._saturated = self._ended = 0
        self._kinematics = opened(load(given["library"]), given["serial"], given["device"])
        self._wrist, self._active = self._kinematics.wrist, self._kinematics.active_wrist
        self._turning = given["turning"]
        self._open = True
        try:
            self._threshold = self._prepared(given)
            self._reach = reach_of(self._kinematics, given["reach"])
            around = self._kinematics.read()[1]
            position = self._kinematics.position()
            survey.check(self._kinematics, self._reach, position, (around, self._kinematics.read()[1]))
            self._survey = survey.survey(self._kinematics, self._reach)
            self._timing, self._measured = self._timed(given), measured_times(given)
            _, counts = self._kinematics.read()
        except BaseException:
            self.close()
            raise
        self._q, self._x = self._kinematics.angles(counts), self._kinematics.place(counts)
        self._sent = self._looked = self._clock.now()
        self._read_in = (self._sent, self._sent)
        self._may_have_ended = True  # looking around takes longer than the watchdog waits

    @property
    def kinematics(self) -> Kinematics:
        """What the library says of the open device's mechanism."""
        return self._kinematics

    # --- the start

    def _prepared(self, given: Mapping[str, Any]) -> int:
        """Refuse a device that is not usable, and switch off what it does by itself; returns its velocity threshold."""
        called, name = self._kinematics.called, self._kinematics.name
        self._asked()
        if not called("drdIsInitialized"):
            raise ForceDimensionError(
                f"{name}: found that it is not calibrated; expected a calibrated one: put its tip into the rest "
                "position (the pole into the pit) until its light stops blinking, or run the maker's autoinit"
            )
        called("dhdSetComMode", SYNCHRONOUS)
        mode = called("dhdGetComMode")
        if mode != SYNCHRONOUS and given["sample_age"] is None:
            raise ForceDimensionError(
                f"{name}: found the communication mode {mode}; expected {SYNCHRONOUS}, synchronous: of another one "
                "nothing says how old a reading is, so state it as parameters.sample_age"
            )
        called("dhdSetTimeGuard", 0)
        called("dhdSetGravityCompensation", 0)
        try:
            called("dhdSetWatchdog", LONGEST)
        except ForceDimensionError as error:
            raise ForceDimensionError(
                f"{error}; without a watchdog in its firmware (3.0 or newer) its last force would last on when this "
                "computer falls silent, so it is not used"
            ) from error
        threshold = c_uint()
        called("dhdGetVelocityThreshold", threshold)
        self._turn_on()
        return threshold.value

    def _timed(self, given: Mapping[str, Any]) -> DeviceTiming:
        """The times as they are given, or as they are measured: of a reading, and of new torques."""
        clock, kinematics = self._clock, self._kinematics
        reading = acting = 0
        for _ in range(TRIPS):
            begin = clock.now()
            kinematics.read()
            read = clock.now()
            kinematics.called("dhdSetDeltaJointTorques", *_ZERO)
            reading, acting = max(reading, read - begin), max(acting, clock.now() - read)
        age, delay = given["sample_age"], given["actuation_delay"]
        age = up(seconds(Duration(reading))) if age is None else age
        return DeviceTiming(age, None, up(seconds(Duration(acting))) if delay is None else delay)

    # --- the loop

    def specification(self) -> DeviceSpecification:
        """What the library knows of the device in its box, and the timing that was measured."""
        each = math.floor(10.0 * self._survey.force / math.sqrt(3.0)) / 10.0
        return DeviceSpecification(
            force=(each,) * 3,  # so that all three together are held in every direction
            displacement=(self._reach,) * 3,
            speed=(self._speed,) * 3,
            timing=self._timing,
            measured=self._measured,
            axes=("x", "y", "z"),
            step=self._survey.step,
            holds_torque=True,
            buttons=BUTTONS,
            orientation=OrientationSpecification(self._turning, holds="joints" if self._active else WORLD)
            if self._wrist
            else None,
            by_itself=(
                "takes its force away and brakes where it is faster than its velocity threshold "
                f"({self._threshold} in units of its own)",
            ),
        )

    def sample(self, tick: int, at: Instant) -> Sequence[float]:
        """The tip's place, m, of encoders that are read now."""
        if self._until is not None and self._clock.now() >= self._until:
            self._exert(_ZERO)  # in case that readings keep its watchdog from ending a force
        self._read()
        now = self._clock.now()
        age = seconds(Duration(now - self._read_in[0]))
        self._oldest = max(self._oldest, age)
        self._old += age > self._timing.sample_age
        if now - self._read_in[0] > self._silence:
            raise ForceDimensionError(
                f"{self._kinematics.name}: found no new reading for {1e3 * age:.3g} ms; expected one with each call: "
                "see that nothing keeps its USB port busy"
            )
        self._answer, self._work = self._answer + self._work, 0.0
        self._answer_lost, self._lost = self._answer_lost or self._lost, False
        return self._x

    def orientation(self) -> Sequence[float]:
        """How its wrist is turned, (w, x, y, z), read now: not more than two exchanges after the place."""
        return quaternion(self._kinematics.frame())

    def buttons(self) -> int:
        """The buttons that are held down, by the maker's numbers."""
        return self._kinematics.buttons()

    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> None:
        """Hold the torques that stand for f, N; from ``until`` on the device's watchdog ends them."""
        allows = LONGEST if until is None else (until - at) // TICK
        self._until = None if until is None else Instant(self._clock.now() + max(0, until - at))
        self._brief = allows < 1
        if self._brief:
            self._exert(_ZERO)  # its end cannot be told to the watchdog
            return
        steps, watchdog = self._watchdog.after(min(allows, LONGEST)), self._watchdog
        if steps < watchdog.steps:  # first, for this may end the last force
            watchdog.steps = self._set(steps)
        self._exert(f)
        if steps > watchdog.steps:
            watchdog.steps = self._set(steps)

    def release(self, at: Instant) -> None:
        """Hold no torques."""
        self._until, self._brief = None, False
        self._exert(_ZERO)

    def exerted(self) -> Sequence[float] | None:
        """The force that the held torques stand for, N; where the library has scaled them, what it says of it.

        None of a force that was too brief to be exerted: it is over before anybody could tell.
        """
        if self._brief:
            return None
        return self._kinematics.force() if self._scaled else self._F

    def work(self) -> float | None:
        """The work of the motors since the last call, J, up to the last sample; None where it is not known."""
        answer = None if self._answer_lost else self._answer
        self._answer, self._answer_lost = 0.0, False
        return answer

    def idle(self, due: Instant) -> None:
        """See from time to time that the device still obeys."""
        now = self._clock.now()
        if now - self._looked >= LOOK:
            self._looked = now
            status = self._asked()
            if not status[_FORCE]:
                self._may_have_ended = self._lost = True
                self._refuse(status)

    def figures(self) -> Mapping[str, float]:
        """What came late, not at all, or by itself; and the rate at which the library exchanges forces."""
        return {
            "oldest_ms": 1e3 * self._oldest,
            "older_than_stated": float(self._old),
            "not_refreshed": float(self._unrefreshed),
            "saturated": float(self._saturated),
            "watchdog_ends": float(self._ended),
            "rate_khz": float(self._kinematics.rate()),
        }

    def close(self) -> None:
        """Take the torques away, and close the device."""
        if not self._open:
            return
        self._open = False
        try:
            self._kinematics.called("dhdSetDeltaJointTorques", *_ZERO)
            self._kinematics.called("dhdStop")
        except ForceDimensionError:
            return  # it is gone, and its watchdog ends the force
        finally:
            self._kinematics.close()

    # --- both

    def _read(self) -> None:
        """Read the encoders, and book what the motors did since the reading before."""
        kinematics, began = self._kinematics, self._clock.now()
        fresh, counts = kinematics.read()
        ended = self._clock.now()
        self._see_end(ended)
        if not fresh:
            self._unrefreshed += 1
            self._lost = self._lost or any(self._t) or bool(self._changes)
            return
        q = kinematics.angles(counts)
        way = [b - a for a, b in zip(self._q, q, strict=True)]
        self._work += most_work(way, self._first, self._changes, self._read_in, (began, ended))
        self._lost = self._lost or self._scaled
        self._q, self._x, self._read_in = q, kinematics.place(counts), (began, ended)
        self._first, self._changes = self._t, []

    def _exert(self, f: Sequence[float]) -> None:
        """Hold the torques J^T f of the joints as they were read last, all less where a motor cannot give its part."""
        kinematics, clock = self._kinematics, self._clock
        self._see_end(clock.now())
        if self._may_have_ended:
            self._revive()
        part, t = 1.0, list(_ZERO)
        if any(f):
            J = kinematics.jacobian(self._q)
            t = [J[j] * f[0] + J[3 + j] * f[1] + J[6 + j] * f[2] for j in range(3)]
            low, high = kinematics.torques(self._q)
            for torque, least, most in zip(t, low, high, strict=True):
                if not least <= part * torque <= most:
                    part = (most if torque > 0.0 else least) / torque
            t = [part * torque for torque in t]
        began = clock.now()
        scaled = kinematics.called("dhdSetDeltaJointTorques", *t) == SATURATED
        ended = clock.now()
        self._see_end(ended)
        self._lost = self._lost or self._scaled
        self._changes.append((began, ended, [b - a for a, b in zip(self._t, t, strict=True)]))
        self._sent, self._scaled = began, scaled
        self._saturated += scaled or part < 1.0
        self._t, self._F = t, [part * force for force in f]

    def _see_end(self, now: Instant) -> None:
        """Whether the watchdog may have ended the torques by now, and has the device brake."""
        if now - self._sent >= self._watchdog.steps * TICK:
            self._may_have_ended, self._lost = True, self._lost or any(self._t)

    def _revive(self) -> None:
        """Give a device its force again that its watchdog may have taken away."""
        status = self._asked()
        if not status[_FORCE]:
            self._refuse(status)
            self._ended += 1
            self._turn_on()
        self._may_have_ended = False

    def _turn_on(self) -> None:
        """Turn the motors on, with no torque of before."""
        self._kinematics.called("dhdSetDeltaJointTorques", *_ZERO)
        if self._active:
            self._kinematics.called("dhdSetWristJointTorques", *_ZERO)
        self._t, self._F = list(_ZERO), list(_ZERO)
        self._scaled = False
        self._kinematics.called("dhdSetBrakes", 0)
        self._kinematics.called("dhdEnableForce", 1)

    def _set(self, steps: int) -> int:
        self._kinematics.called("dhdSetWatchdog", steps)
        return steps

    def _asked(self) -> list[int]:
        """The device's status; refused where it has no power, or an error."""
        self._kinematics.called("dhdGetStatus", self._status)
        status = list(self._status)
        if not status[_POWER] or status[_ERROR]:
            what = "with an error" if status[_ERROR] else "without power"
            raise ForceDimensionError(
                f"{self._kinematics.name}: found it {what}; expected one that is ready: switch it off and on again"
            )
        return status

    def _refuse(self, status: Sequence[int]) -> None:
        """Refuse a device whose forces are off by anything but its watchdog."""
        cause = status[_CAUSE]
        if cause in _CAUSES:
            raise ForceDimensionError(
                f"{self._kinematics.name}: found its forces taken away {_CAUSES[cause]}; expected a device that obeys"
            )


Change = tuple[int, int, list[float]]
"""New torques: when the call that sent them began and ended, ns, and by how much they differ from those before, N·m."""


def most_work(
    way: Sequence[float],
    first: Sequence[float],
    changes: Sequence[Change],
    since: tuple[int, int],
    until: tuple[int, int],
) -> float:
    """The most that the motors can have done between two readings, if the joints moved evenly in between, J.

    With dq the way, t_0 the first torques, D_i what new ones add, and s_i the part of the way at which they came,

        W = t_0^T dq + sum over i of (1 - s_i) D_i^T dq.

    Each s_i is known up to the calls: new torques act from some instant of theirs on, and a reading is of some instant
    of its own. Of its least and greatest the one counts with which W is greater. So W is too great by at most
    |D_i^T dq| times that range: two or three calls in the time between two readings. Joints that do not move evenly,
    but with an acceleration a, add an error of a h^2/8 |D_i| at most, h that time.

    Args:
        way: dq, rad.
        first: t_0, N·m.
        changes: since the first reading.
        since: when the call of the first reading began and ended, ns.
        until: likewise of the second.
    """
    work = sum(torque * by for torque, by in zip(first, way, strict=True))
    for began, ended, more in changes:
        adds = sum(torque * by for torque, by in zip(more, way, strict=True))
        earliest = (began - since[1]) / max(1, until[1] - since[1])
        latest = (ended - since[0]) / max(1, until[0] - since[0])
        work += adds * (1.0 - (max(0.0, earliest) if adds > 0.0 else min(1.0, latest)))
    return work


class _Watchdog:
    """Which time the device's watchdog has: at most that of each force, and longer once all forces allow it for long.

    Setting it costs an exchange. So a shorter time is set at once, and a longer one after :data:`CALM` forces.

    Attributes:
        steps: that the device has.
    """

    def __init__(self) -> None:
        self.steps = LONGEST
        self._least, self._forces = LONGEST, 0  # of the forces since it was changed

    def after(self, allows: int) -> int:
        """The steps that it should have for a force that allows so many."""
        self._least, self._forces = min(self._least, allows), self._forces + 1
        if allows >= self.steps and self._forces < CALM:
            return self.steps
        least = min(self._least, allows)
        self._least, self._forces = LONGEST, 0
        return least


def opened(library: CDLL, serial: int | None, device: int) -> Kinematics:
    """The device with a serial number, or with a number among those that are plugged in; open.

    Raises:
        ForceDimensionError: there is none, or it cannot be opened.
    """
    library.dhdEnableExpertMode()
    seen = []
    for number in range(_MOST_DEVICES) if serial is not None else [device]:
        if library.drdOpenID(number) < 0:
            continue
        own = c_ushort()
        name = (library.dhdGetSystemName(number) or b"device").decode(errors="replace")
        if library.dhdGetSerialNumber(own, number) >= 0 and serial in (None, own.value):
            return Kinematics(library, number, f"{name} {own.value}")
        seen.append(f"{name} {own.value}")
        library.drdClose(number)
    said = (library.dhdErrorGetLastStr() or b"").decode(errors="replace")
    sought = f"the serial number {serial}" if serial is not None else f"the number {device}"
    raise ForceDimensionError(
        f"found no device with {sought} that can be opened ({', '.join(seen) or said}; {library.dhdGetDeviceCount()} "
        "plugged in); expected one: see that it has power, that no other program has it, and that a udev rule lets you "
        "use USB devices of the vendor 1451"
    )


def reach_of(kinematics: Kinematics, given: float | None) -> float:
    """The half edge of the box that is stated: as given, or of the cube inside the family's workspace, m.

    Raises:
        ForceDimensionError: none is given for a device that is not known.
    """
    if given is not None:
        return given
    kind = kinematics.called("dhdGetSystemType")
    for types, radius in REACHES.values():
        if kind in types:
            return math.floor(1e3 * radius / math.sqrt(3.0)) / 1e3
    raise ForceDimensionError(
        f"{kinematics.name}: found the system type {kind}, whose workspace is not known here; expected "
        "parameters.reach: how far it may go from 0 on each axis, m"
    )


def _checked(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """The parameters, with what holds where one is not given."""
    given = merged(parameters, PARAMETERS)
    library = given["library"]
    if not isinstance(library, str) or (library and not Path(library).is_absolute()):
        raise ValueError(f"parameters.library: found {library!r:.80}; expected the whole path of libdrd")
    for name, most in (("device", _MOST_DEVICES - 1), ("serial", 65535)):
        value = given[name]
        if (name in parameters or name == "device") and (
            isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= most
        ):
            raise ValueError(f"parameters.{name}: found {value!r:.40}; expected a whole number from 0 to {most}")
    units = {
        "reach": "a length in m, at most 1",
        "speed": "a speed in m/s, at most 10",
        "turning": "an angular velocity in rad/s, at most 1000",
    }
    for name in ("reach", "speed", "turning", "silence", "sample_age", "actuation_delay"):
        value, longest = given[name], {"speed": 10.0, "turning": 1000.0}.get(name, 1.0)
        if value is None and PARAMETERS[name] is None:
            continue
        if not is_number(value) or not 0.0 < value <= longest:
            expected = units.get(name, "a time in s, at most 1")
            raise ValueError(f"parameters.{name}: found {value!r:.40}; expected {expected}")
    return given
