"""The row of steering wheels in the campaign of faults: a geared wheel behind hid-pidff and the calls of the C library.

The fake's kernel driver (tests/fakes/wheel.c) never stops the effects of a process that has died, though a real one
does: so what ends their force is their own length, in the wheel.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final

import pytest

from manyhands.devices.evdev.bus import tick
from manyhands.launch.run.breaches import QUIET

from ..fakes.far_side import FarSide, Force, Given, Record
from ..fakes.wheel import FakeWheel, Turn, fake_wheel
from .device_row import KILL, LASTS, Fault, Free, LoggedFarSide, Row, marks_in

HELD: Final = Turn(m=0.03, b=0.06, c=0.06, k=4.0, amplitude=0.4, frequency=0.5)
"""Hands that turn a geared wheel to and fro, 1.3 rad/s at most."""

FREE: Final = replace(HELD, k=0.0)


class WheelFarSide(LoggedFarSide):
    """A fake wheel, which a process of this machine has as its event device."""

    def __init__(self, one: FakeWheel, folder: Path) -> None:
        super().__init__(one.order, folder / "wheel.log")
        self._one = one
        self.parameters: Mapping[str, object] = {"device": one.path}
        self.order("keep 1", f"log {self._log}")

    def force(self) -> Sequence[float]:
        return self._one.asked()[1]

    def record(self) -> Record:
        self._one.asked()  # it has written down all until now
        motors: list[tuple[int, Force]] = []
        busy, wire = list[tuple[int, int]](), WheelWire()
        for kind, at, rest in (entries := self.entries()):
            match kind:
                case "m":
                    motors.append((at, tuple(map(float, rest.split()))))
                case "a":
                    what, value = rest.split()
                    wire.take(at, what, int(value))
                case "b":
                    busy.append((at - 1000 * int(rest), at))
        return Record(motors, wire.given, marks_in(entries), busy)


class WheelWire:
    """The torques on a wheel's wire, by its reports: a level, how long one lasts from each start on, starts and stops.

    Attributes:
        given: the torques, in the order in which they came.
    """

    def __init__(self) -> None:
        self.given: list[Given] = []
        self._level = self._length = self._since = self._until = 0

    def take(self, at: int, kind: str, value: int) -> None:
        """A report of an instant, ns."""
        match kind:
            case "level":
                self._level = value
            case "length":
                self._length = value
                if at <= self._until:  # it counts from the last start, of a force that acts
                    self._until = max(at, self._lasts())
            case "start":
                self._since = at
                self._until = self._lasts()
            case "stop":
                self._until = at
        torque = HELD.most * max(-1.0, min(1.0, -self._level / 0x7FFF))  # to the left, as all its effects are
        if at < self._until:
            self.given.append(Given(at, self._until, (float(f"{torque:.9g}"),)))

    def _lasts(self) -> int:
        return self._since + 1_000_000 * self._length


@contextmanager
def wheel(folder: Path, turn: Turn = HELD) -> Iterator[FarSide]:
    hz = round(1.0 / tick())  # like the kernel's own, to whose clock the driver looks
    running = fake_wheel(turn, kind="pid", hz=hz, in_us=250, out_us=500)
    with running as one, pytest.MonkeyPatch.context() as patch:
        for name, value in one.environment.items():
            patch.setenv(name, value)
        yield WheelFarSide(one, folder)


T: Final = 0.004  # s
AGE: Final = 0.0005  # s: two intervals of its reports
DELAY: Final = 0.0015  # s: three reports, two a millisecond: a bus of high speed
BY_ITSELF: Final = LASTS * T + DELAY
AT_ONCE: Final = 0.001  # s
STALLED: Final = 0.03  # s

EVDEV_WHEEL: Final = Row(
    opened=wheel,
    free=Free(
        opened=partial(wheel, turn=FREE),
        options=("--force", 1.9, "--travel", 1, "--speed", 8),
        damping=FREE.b,
        friction=FREE.c,
        mass=FREE.m,
        step=FREE.range / 65535,
    ),
    keys={
        "dof": 1,
        "axes": "rotation",
        "osp": 0.05,
        "driver": "evdev-wheel",
        "sample_age": AGE,
        "actuation_delay": DELAY,
        "mass": 0.0299,
        "step": 0.00023,
        "limits": {"force": 2, "displacement": 7, "speed": 12},
    },
    period=T,
    parameters={"range": HELD.range, "most": HELD.most, "sample_age": AGE, "actuation_delay": DELAY},
    stiffness=20.0,
    precision=4e-5,  # its levels have 32767 steps to 2 N m
    late=DELAY,
    design={"coupling": "spring-damper", "tau": 0.0035, "period_tolerance": 0.5},
    faults={
        "unplugged": Fault(["unplug"], AT_ONCE, "found it unplugged", then=["plug"], after="found no such device"),
        "process killed": Fault([KILL], BY_ITSELF, "was killed by SIGKILL while running"),
        "process killed, and another program grabs it": Fault(
            [KILL, "busy 1"],
            BY_ITSELF,
            "was killed by SIGKILL while running",
            then=["busy 0"],
            after="found another program that has grabbed it",
        ),
        "stalled for 30 ms": Fault(["stall 30"], BY_ITSELF, dies=False, late=4.0 * STALLED + BY_ITSELF),
        "set to another range": Fault(
            [f"range {HELD.range / 20.0}"],
            BY_ITSELF + T,
            "beyond its limits of displacement or speed, and let go",
            dies=False,
            then=[f"range {HELD.range}"],
            apart=QUIET + 1.0,
        ),
        "kernel driver that stops playing": Fault(["still 1"], BY_ITSELF, dies=False, then=["still 0"], lasts=0.5),
        "kernel driver that refuses": Fault(
            ["refuse 1"], BY_ITSELF, "found Input/output error; expected a device that obeys", then=["refuse 0"]
        ),
    },
)
