"""What the rows of motor controllers have in common: a fake of tests/fakes/rotor.py behind its wire, the hand, faults.

A controller counts the time of a torque from its arrival, and its watchdog disarms it: see the page of each.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final, Protocol

from manyhands.launch.run.breaches import QUIET

from ..fakes.far_side import FarSide, Force, Given, Record
from ..fakes.rotor import FakeMotor, Rotor
from .device_row import KILL, LASTS, Fault, Free, LoggedFarSide, Row, marks_in

HELD: Final = Rotor(J=2e-4, b=0.01, k=0.2, amplitude=0.5, frequency=0.7)
"""Somebody holds the knob, and turns it."""

FREE: Final = replace(HELD, c=0.002, k=0.0)

SILENCE: Final = 0.5  # s, of the driver: a busy machine may give the fake no turn for a while
T: Final = 0.004  # s
MOST: Final = 0.5  # N·m
DELAY: Final = 0.0005  # s, from a torque's sending to its beginning
WAY: Final = 0.002  # s, of a torque: the fake looks at its wire once in a millisecond at least
BY_ITSELF: Final = LASTS * T + WAY
AT_ONCE: Final = 0.001  # s
MUTE: Final = 2.0 * T + BY_ITSELF
"""A question may have been answered just before, and no torque is sent once an answer is overdue by a period."""


class Wire(Protocol):
    """The torques on a controller's wire, by its maker's documents and without the code of driver and fake."""

    given: list[Given]

    def take(self, line: str, at: int) -> None:
        """A line that was read at an instant, ns."""
        ...


class MotorFarSide(LoggedFarSide):
    """A fake controller whose port is a link, so that it is the same after it was plugged in again."""

    def __init__(self, one: FakeMotor, wire: Callable[[], Wire], folder: Path) -> None:
        super().__init__(one.order, folder / "motor.log")
        self._one, self._wire = one, wire
        port = folder / "port"
        self.plug = f"plug {port}"
        self.parameters: Mapping[str, object] = {"port": str(port)}
        self.order(self.plug, f"log {self._log}")
        one.asked()  # so that the port is there

    def order(self, *lines: str) -> None:
        super().order(*(self.plug if line == "plug" else line for line in lines))

    def force(self) -> Sequence[float]:
        return [self._one.asked()["torque"]]

    def record(self) -> Record:
        self._one.asked()  # it has written down all until now
        motors: list[tuple[int, Force]] = []
        busy, wire = list[tuple[int, int]](), self._wire()
        for kind, at, rest in (entries := self.entries()):
            match kind:
                case "m":
                    motors.append((at, (float(rest),)))
                case "r":
                    wire.take(rest, at)
                case "b":
                    busy.append((at - int(rest), at))
        return Record(motors, wire.given, marks_in(entries), busy)


Fake = Callable[[Rotor], AbstractContextManager[FakeMotor]]


def motor_row(driver: str, fake: Fake, wire: Callable[[], Wire], faults: Mapping[str, Fault], **more: Any) -> Row:
    """The row of a controller.

    Args:
        driver: its short name.
        fake: gives its fake.
        wire: reads what it was sent.
        faults: those of its own, beside those of all controllers.
        more: fields of the row.
    """

    @contextmanager
    def opened(folder: Path, rotor: Rotor = HELD) -> Iterator[FarSide]:
        with fake(rotor) as one:
            yield MotorFarSide(one, wire, folder)

    return Row(
        opened=opened,
        free=Free(
            opened=partial(opened, rotor=FREE),
            options=("--force", 0.4, "--travel", 0.8, "--speed", 6),
            damping=FREE.b,
            friction=FREE.c,
            mass=FREE.J,
            step=2.0 * math.pi / FREE.counts,
        ),
        keys={
            "dof": 1,
            "axes": {"rz": "rotation"},
            "osp": 0.01,
            "driver": driver,
            "sample_age": 0.001,
            "actuation_delay": DELAY,
            "mass": 0.0002,
            "step": 0.0004,
            "limits": {"force": MOST, "displacement": 6, "speed": 60},
        },
        period=T,
        parameters={
            "torque": MOST,
            "inertia": 0.0002,
            "counts": 16384,
            "silence": SILENCE,
            "sample_age": 0.001,
            "actuation_delay": DELAY,
        },
        stiffness=0.2,
        ground=80.0,
        felt=0.005,
        design={"coupling": "spring-damper", "tau": 0.003, "period_tolerance": 0.5},
        way=WAY,
        faults={
            "unplugged": Fault(
                ["unplug"],
                BY_ITSELF,
                "see that it is plugged in and has power",
                then=["plug"],
                after="there is no such port; plug the device in",
            ),
            "process killed": Fault([KILL], BY_ITSELF, "was killed by SIGKILL while running"),
            "stalled for 30 ms": Fault(["stall 30"], BY_ITSELF, dies=False),
            "first frames lost": Fault([KILL, "drop 3"], BY_ITSELF, "was killed by SIGKILL while running"),
            "reset": Fault(["reset"], AT_ONCE, "has started anew"),
            "wrong units": Fault(
                ["scale 1000"],
                T + BY_ITSELF,
                "beyond its limits of displacement or speed, and let go",
                dies=False,
                then=["scale 1"],
                apart=QUIET + 1.0,
            ),
            "mute": Fault(["mute"], MUTE, "found no answer for", then=["speak"]),
            **faults,
        },
        **more,
    )
