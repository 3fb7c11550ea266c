"""The driver of wheels and joysticks that the kernel gives an event device with constant forces: :class:`EvdevWheel`.

    devices:
      wheel: {dof: 1, driver: evdev-wheel, parameters: {device: ..., range: 15.708, most: 2.1}, osp: ..., limits: {...}}

With one axis it is a wheel (rad, N·m), with two a joystick (x to the right, y towards its user; rad, N·m as well).

**A force** is a constant effect of each axis. Every tick overwrites it (``EVIOCSFF``) and plays it anew, so that its
length counts from there. The length is what ends a force when nobody calls any more. Not every driver counts it from an
upload (Kimplul/hid-tmff2#107, PCSX2/pcsx2#11906), and ``ff-memless.c`` counts the length that was there *before* the
upload. A start makes all of them the same. ``update: restart`` stops the effect first, for a driver that takes a new
level at a start from rest alone (mescon/logitech-trueforce-linux-driver#11). The direction of an effect never changes:
some drivers do not follow it (Kimplul/hid-tmff2#43), and hid-pidff may replace it by 0x4000. The sign is the level's.

**Its end.** Kernel drivers count in ticks of the kernel, so a length is rounded down to whole ticks, and is then over
before ``until``; a force of less than a tick is none.
"""

from __future__ import annotations

import errno
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any, Final, TypeVar

from manyhands.devices.evdev import event_device as ev
from manyhands.devices.evdev.bus import UsbWay, range_in, tick, way_to
from manyhands.devices.evdev.event_device import Axis, Calls, EventDevice
from manyhands.devices.starting import is_number, merged
from manyhands.nodes.device.plugin import DeviceDriver
from manyhands.nodes.device.specification import DeviceSpecification, DeviceTiming
from manyhands.protocol.clock import Duration, Instant, from_seconds, seconds

_T = TypeVar("_T")

PARAMETERS: Final[Mapping[str, object]] = {
    "device": "",
    "range": None,
    "most": None,
    "update": "replay",
    "reverse": False,
    "mass": None,
    "sample_age": None,
    "actuation_delay": None,
}
"""What a session may give, and what holds where it does not. ``range``: rad from stop to stop, and ``most``: N·m at the
greatest level, each a number or one for each axis; both are required. ``reverse``: whether the kernel driver pushes the
other way. ``mass``: the least that a push meets, kg·m², where it is known. The times, s, stand in for what the bus
says."""

UPDATES: Final = ("replay", "restart")

DIRECTIONS: Final = ((0x4000, -1.0), (0x0000, 1.0))
"""Of the effect of x and of y, with the sign of a level that pushes towards greater counts: linux/input.h has 0x4000 as
left and 0 as down, that is towards the user."""

FASTEST: Final = 100.0
"""rad/s; a position is measured at every speed, and no hand turns a wheel as fast."""

UNATTENDED: Final = from_seconds(0.05)
"""How long a force lasts that was given no end."""

BY_ITSELF: Final = (
    "reports a position when it changes, so a wheel that rests and one whose bus has stalled look the same; "
    "forces queue behind a stalled bus, and come late",
    "may add damping, friction or smoothing of its firmware, which only its maker's software shows",
)

LOOK: Final = from_seconds(0.5)
"""How often the kernel driver is asked whether its range is the same."""


class WheelError(RuntimeError):
    """A wheel cannot be used, or is gone; the message names it and says what to do."""


class EvdevWheel(DeviceDriver):
    """A wheel or a joystick behind an event device."""

    def __init__(
        self,
        ports: Sequence[str],
        period: float,
        parameters: Mapping[str, Any],
        calls: Calls | None = None,
        way: UsbWay | None = None,
    ) -> None:
        """Open the device for this driver alone, and switch off what it does by itself.

        Args:
            ports: of the session's device: one for a wheel, two for a joystick.
            period: of the session, s.
            parameters: :data:`PARAMETERS`, of which ``device``, ``range`` and ``most`` are required.
            calls: of the kernel; the kernel's own by default.
            way: to the device; what sysfs has of it by default.

        Raises:
            ValueError: the parameters are not those, or the bus is too slow for the period.
            WheelError: it cannot be opened, exerts no constant force, or another program has it.
        """
        m, given = len(ports), _checked(parameters, len(ports))
        self._path, self._update = str(given["device"]), given["update"]
        self._range, self._most = _each(given["range"], m), _each(given["most"], m)
        self._mass = None if given["mass"] is None else tuple(_each(given["mass"], m))
        self._signs = [-1.0 if turned else 1.0 for turned in _each(given["reverse"], m)]
        self._tick = tick()
        self._playing, self._last = False, 0
        self._effects: list[int] = []
        self._fuzz: dict[int, int] = {}
        self._dropped = self._old = 0
        self._gap = 0.0  # s
        self._looked = Instant(0)
        self._moved_at: int | None = None  # when the last report came, if it moved an axis by more than a step
        self._device = self._opened(calls)
        try:
            self._way = way or way_to(self._path)
            self._timing = self._timed(given, m, period)
            _agree(self._path, self._range[0], self._way.range)
            self._codes = self._asked(lambda: self._found(m))
            self._asked(self._prepare)
            self._asked(self._reread)
        except BaseException:
            self.close()
            raise

    # --- the start

    def _opened(self, calls: Calls | None) -> EventDevice:
        try:
            return EventDevice(self._path, calls)
        except FileNotFoundError as error:
            raise WheelError(
                f"{self._path}: found no such device; plug it in, and look into /dev/input/by-id"
            ) from error
        except PermissionError as error:
            raise WheelError(
                f"{self._path}: found no permission to open it; manyhands devices prints the rule of udev that gives "
                "it to whoever sits at this machine, and where to write it"
            ) from error
        except OSError as error:
            raise WheelError(f"{self._path}: found {error.strerror}; expected an event device of the kernel") from error

    def _found(self, m: int) -> list[int]:
        """The codes of its axes.

        Raises:
            WheelError: it has no such axis, or no constant force.
        """
        device = self._device
        if ev.EV_FF not in device.codes() or ev.FF_CONSTANT not in device.codes(ev.EV_FF):
            vibrates = ev.FF_RUMBLE in device.codes(ev.EV_FF)
            raise WheelError(
                f"{self._path}: found {'vibration alone' if vibrates else 'no force feedback'}; expected constant "
                "forces (FF_CONSTANT): see that its kernel driver is loaded, and that the path ends in -event-joystick"
            )
        absolute = device.codes(ev.EV_ABS)
        first = ev.ABS_WHEEL if m == 1 and ev.ABS_X not in absolute else ev.ABS_X
        codes = [first, ev.ABS_Y][:m]
        if lacks := [code for code in codes if code not in absolute or _counts(device.axis(code)) <= 0]:
            raise WheelError(
                f"{self._path}: found no absolute axis {lacks[0]}; expected {m}, the dof of the session's device"
            )
        return codes

    def _prepare(self) -> None:
        """Take it for this driver alone, and switch off what it does by itself."""
        device = self._device
        try:
            device.grab()
        except OSError as error:
            if error.errno != errno.EBUSY:
                raise
            raise WheelError(
                f"{self._path}: found another program that has grabbed it; end it (a game, Steam's input, a remapper)"
            ) from error
        for code in self._codes:
            self._fuzz[code] = device.axis(code).fuzz
            device.filter(code, 0)
        axes = [device.axis(code) for code in self._codes]
        self._centre = [(axis.minimum + axis.maximum) / 2.0 for axis in axes]
        self._step = tuple(width / _counts(axis) for width, axis in zip(self._range, axes, strict=True))
        self._can = device.codes(ev.EV_FF)
        for code, value in ((ev.FF_GAIN, 0xFFFF), (ev.FF_AUTOCENTER, 0)):
            if code in self._can:
                device.play([(code, value)])
        try:
            for axis in range(len(self._codes)):
                self._effects.append(device.upload(-1, DIRECTIONS[axis][0], 0, 1))
        except OSError as error:
            if error.errno != errno.ENOSPC:
                raise
            raise WheelError(
                f"{self._path}: found no room for {len(self._codes)} effects; plug it out and in, and it forgets them"
            ) from error

    def _timed(self, given: Mapping[str, Any], m: int, period: float) -> DeviceTiming:
        """The timing as the session gives it, or as the bus has it.

        A report waits in the device until the host asks, for an interval at most, and is the newest one for another. A
        force leaves at the kernel driver's next timer; its reports go one an interval, and the device takes another one
        to act.
        """
        way, driver = self._way, self._way.driver
        reports = m * (driver.reports + (self._update == "restart"))
        if way.polled is None or way.sent is None:
            if given["sample_age"] is None or given["actuation_delay"] is None:
                raise ValueError(
                    f"parameters: found no sample_age or actuation_delay, and no USB endpoint of {self._path} in /sys; "
                    "expected both times, in s"
                )
            return DeviceTiming(given["sample_age"], None, given["actuation_delay"])
        if reports * way.sent > period * (1.0 + 1e-9):
            raise ValueError(
                f"{self._path}: found a period of {1e3 * period:g} ms; expected {1e3 * reports * way.sent:g} ms or "
                f"more: {driver.name} sends up to {reports} reports a tick, and its bus takes one in "
                f"{1e3 * way.sent:g} ms. More would queue up, and forces come later and later"
            )
        delay = driver.timer + driver.ticks * tick() + (reports + 1) * way.sent
        found = {"sample_age": 2.0 * way.polled, "actuation_delay": delay}
        for name, least in (("sample_age", way.polled), ("actuation_delay", reports * way.sent)):
            if given[name] is None:
                continue
            found[name] = given[name]
            if given[name] < least * (1.0 - 1e-9):
                raise ValueError(
                    f"parameters.{name}: found {given[name]:g} s; expected {least:g} s or more, by its bus alone"
                )
        return DeviceTiming(round(found["sample_age"], 9), None, round(found["actuation_delay"], 9))

    # --- the loop

    def specification(self) -> DeviceSpecification:
        """What the session gave of its mechanism, the encoder's step, and what the bus says of its timing."""
        said = [*BY_ITSELF]
        if ev.FF_AUTOCENTER not in self._can:
            said.append("may pull to its middle: its kernel driver has no FF_AUTOCENTER to switch off")
        if ev.FF_GAIN not in self._can:
            said.append(
                "has a gain of its own that its kernel driver cannot set (no FF_GAIN), beside what most was measured at"
            )
        if self._way.driver.levels < ev.FULL:
            said.append(f"rounds a force to 1/{self._way.driver.levels} of the greatest, in its kernel driver")
        return DeviceSpecification(
            force=tuple(self._most),
            displacement=tuple(width / 2.0 for width in self._range),
            speed=(FASTEST,) * len(self._codes),
            timing=self._timing,
            axes=(axes := ("wheel",) if len(self._codes) == 1 else ("x", "y")),
            turning=axes,
            mass=self._mass,
            step=self._step,
            by_itself=tuple(said),
        )

    def sample(self, tick: int, at: Instant) -> Sequence[float]:
        """The newest position, rad."""
        self._asked(self._read)
        return [
            step * (count - centre) for step, count, centre in zip(self._step, self._counts, self._centre, strict=True)
        ]

    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> None:
        """Exert f, N·m, no longer than ``until``."""
        length = self._length(Duration(until - at) if until is not None else UNATTENDED)
        if not length:
            self.release(at)
            return
        self._asked(lambda: self._exert(f, length))

    def release(self, at: Instant) -> None:
        """Stop all effects."""
        if self._playing:
            self._asked(lambda: self._device.play([(effect, 0) for effect in self._effects]))
            self._playing = False

    def idle(self, due: Instant) -> None:
        """See from time to time that nobody has set its range to another one."""
        file = self._way.range_file
        if file is None or due - self._looked < LOOK:
            return
        self._looked = due
        turns = range_in(file)
        if turns is not None and _differs(self._range[0], turns):
            raise WheelError(
                f"{self._path}: found its range set to {turns:.5g} rad ({math.degrees(turns):.0f}°); expected "
                f"{self._range[0]:g} rad, as parameters.range says: set it back, and let no program change it"
            )

    def figures(self) -> Mapping[str, float]:
        """What its reports show of their age while it moves."""
        return {
            "longest_gap_ms": 1e3 * self._gap,
            "older_than_stated": float(self._old),
            "dropped_reports": float(self._dropped),
        }

    def close(self) -> None:
        """Stop and erase the effects, give its filter back, and close it."""
        with suppress(OSError):  # it is gone, and the kernel with its effects
            for effect in self._effects:
                self._device.erase(effect)
            for code, fuzz in self._fuzz.items():
                self._device.filter(code, fuzz)
        self._effects, self._fuzz, self._playing = [], {}, False
        self._device.close()

    # --- both

    def _length(self, lives: Duration) -> int:
        """The length of a force that may live so long, ms, in whole ticks of the kernel; 0 for none.

        The last length stays while it is not too long, and more than half of what may be: hid-pidff sends a report more
        for each new one.
        """
        ticks = max(0, math.floor(seconds(lives) / self._tick + 1e-6))  # on a late machine it may be over
        most = min(math.floor(1e3 * ticks * self._tick + 1e-6), ev.LONGEST)
        if not self._last <= most < 2 * self._last:
            self._last = most
        return self._last

    def _exert(self, f: Sequence[float], length: int) -> None:
        if self._update == "restart" and self._playing:
            self._device.play([(effect, 0) for effect in self._effects])
        for axis, effect in enumerate(self._effects):
            direction, sign = DIRECTIONS[axis]
            part = max(-1.0, min(1.0, f[axis] / self._most[axis]))
            self._device.upload(effect, direction, round(sign * self._signs[axis] * part * ev.FULL), length)
        self._playing = True
        self._device.play([(effect, 1) for effect in self._effects])

    def _reread(self) -> None:
        """Ask for the positions, in place of events that were lost."""
        self._counts = [self._device.axis(code).value for code in self._codes]
        self._moved_at = None

    def _read(self) -> None:
        """Take the events that have come."""
        counts, before = self._counts, self._counts.copy()
        dropped = 0
        for event in self._device.events():
            if event.kind == ev.EV_ABS and event.code in self._codes:
                counts[self._codes.index(event.code)] = event.value
            elif event.kind == ev.EV_SYN and event.code == ev.SYN_REPORT:
                self._note(event.at, max(abs(a - b) for a, b in zip(counts, before, strict=True)))
                before = counts.copy()
            elif event.kind == ev.EV_SYN and event.code == ev.SYN_DROPPED:
                dropped += 1
        if dropped:
            self._dropped += dropped
            self._reread()

    def _note(self, at: int, moved: int) -> None:
        """Two reports in a row that each moved an axis by more than a step: the first was current until the second."""
        if moved < 2:
            self._moved_at = None
            return
        if self._moved_at is not None:
            gap = 1e-9 * (at - self._moved_at)
            self._gap = max(self._gap, gap)
            self._old += gap > self._timing.sample_age
        self._moved_at = at

    def _asked(self, call: Callable[[], _T]) -> _T:
        """Make a call of the device.

        Raises:
            WheelError: it is gone, or refuses it.
        """
        try:
            return call()
        except OSError as error:
            why = "it unplugged" if error.errno == errno.ENODEV else error.strerror
            raise WheelError(
                f"{self._path}: found {why}; expected a device that obeys: see that it is plugged in and has power"
            ) from error


def _checked(parameters: Mapping[str, Any], m: int) -> dict[str, Any]:
    """The parameters, with what holds where one is not given."""
    given = merged(parameters, PARAMETERS)
    if not isinstance(given["device"], str) or not given["device"]:
        raise ValueError("parameters.device: found none; expected the path of its event device, as in /dev/input/by-id")
    kinds = {"range": "the angle from stop to stop, rad", "most": "the greatest torque, N·m", "mass": "inertia, kg·m²"}
    for name, kind in kinds.items():
        if name == "mass" and given[name] is None:
            continue
        if not all(_positive(value) for value in _each(given[name], m)) or len(_each(given[name], m)) != m:
            raise ValueError(
                f"parameters.{name}: found {given[name]!r:.40}; expected {kind}, or one for each of {m} axes"
            )
    if given["update"] not in UPDATES:
        raise ValueError(f"parameters.update: found {given['update']!r:.40}; expected one of {', '.join(UPDATES)}")
    if any(not isinstance(one, bool) for one in _each(given["reverse"], m)) or len(_each(given["reverse"], m)) != m:
        raise ValueError(f"parameters.reverse: found {given['reverse']!r:.40}; expected true or false, for each axis")
    for name in ("sample_age", "actuation_delay"):
        if given[name] is not None and not (_positive(given[name]) and given[name] < 1.0):
            raise ValueError(f"parameters.{name}: found {given[name]!r:.40}; expected a time in s, below 1")
    return given


def _each(value: Any, m: int) -> list[Any]:
    """A value for each of m axes: the same for all, or those of a list."""
    return list(value) if isinstance(value, list | tuple) else [value] * m


def _positive(value: object) -> bool:
    return is_number(value) and value > 0.0


def _counts(axis: Axis) -> int:
    """Steps from one end of an axis to the other."""
    return axis.maximum - axis.minimum


def _differs(width: float, stated: float) -> bool:
    """Whether a range is not the kernel driver's, which has it in whole degrees, rad."""
    return abs(width - stated) > 0.01 * stated


def _agree(path: str, width: float, stated: float | None) -> None:
    """Hold the session's range of a wheel against the one that its kernel driver has set."""
    if stated is not None and _differs(width, stated):
        raise ValueError(
            f"parameters.range: found {width:g} rad; expected {stated:.5g} rad ({math.degrees(stated):.0f}°), to which "
            f"the kernel driver of {path} has set it (the file range in /sys): every angle would be wrong by the ratio"
        )
