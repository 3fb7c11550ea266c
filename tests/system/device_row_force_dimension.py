"""The row of Force Dimension's devices in the campaign of faults: an omega behind a fake of the maker's library.

The fake (tests/fakes/dhd.c) lives in a file: each call brings it up to the present, with its watchdog's end in between.
So it has every turn, whoever the machine's turns go to, and writes down no time in which it was busy.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final

from manyhands.devices.force_dimension.driver import TICK
from manyhands.launch.run.breaches import QUIET

from ..fakes.dhd import FakeDevices, fake_devices
from ..fakes.far_side import FarSide, Force, Given, Record
from .device_row import KILL, LASTS, Fault, Free, LoggedFarSide, Row, marks_in

MASS: Final = 0.2  # kg
DAMPING: Final = 1.5  # N*s/m
HELD: Final = ("hand 100 0.7", "to 0.01 0.007 -0.008")
"""Orders: somebody holds it, and moves."""


class DhdFarSide(LoggedFarSide):
    """The first of the fake's devices."""

    def __init__(self, devices: FakeDevices, folder: Path, orders: Sequence[str]) -> None:
        super().__init__(devices.order, folder / "dhd.log")
        self._devices = devices
        self.parameters: Mapping[str, object] = {"library": devices.path}
        self.order(f"plant {MASS} {DAMPING} 0", *orders, f"log {self._log}", "note began")

    def force(self) -> Sequence[float]:
        return self._devices.force()

    def record(self) -> Record:
        self._devices.force()  # it is brought up to now
        motors: list[tuple[int, Force]] = []
        given, steps = list[Given](), 0
        for kind, at, rest in (entries := self.entries()):
            match kind:
                case "m":
                    motors.append((at, _force(rest)))
                case "t":
                    given.append(Given(at, at + steps * TICK, _force(rest)))
                case "w":
                    steps = int(rest)
                    if given and given[-1].until > at:  # it counts from the torques on which it comes
                        ends = max(at, given[-1].at + steps * TICK)
                        given[-1] = replace(given[-1], until=ends)
        return Record(motors, given, marks_in(entries), [])


def _force(words: str) -> Force:
    return tuple(map(float, words.split()))


@contextmanager
def omega(folder: Path, orders: Sequence[str] = HELD) -> Iterator[FarSide]:
    with fake_devices() as devices:
        yield DhdFarSide(devices, folder, orders)


T: Final = 0.004  # s
SILENCE: Final = 0.5  # s, of the driver: on a busy machine it may have no turn for longer than the 10 ms that are usual
BY_ITSELF: Final = LASTS * T
AT_ONCE: Final = 0.001  # s
GONE: Final = "communication error"

FORCE_DIMENSION: Final = Row(
    opened=omega,
    free=Free(
        opened=partial(omega, orders=()),
        options=("--dof", 3, "--force", 4, "--travel", 0.024, "--speed", 0.35),
        damping=DAMPING,
        friction=0.0,
        mass=MASS,
        step=0.0,  # none is stated, and joints' steps are none of the tip
        stated=False,
    ),
    keys={
        "dof": 3,
        "axes": ["x", "y", "z"],
        "osp": 1.5,
        "driver": "force-dimension",
        "sample_age": 0.0005,
        "actuation_delay": 0.0005,
        "step": 0.0001,
        "held": "torque",
        "linkage": {"kappa": 16},
        "limits": {"force": 3, "displacement": 0.04, "speed": 0.5},
    },
    period=T,
    parameters={"reach": 0.04, "silence": SILENCE, "sample_age": 0.0005, "actuation_delay": 0.0005},
    precision=1e-3,  # its motors have 32768 steps of 1 N m
    design={"coupling": "spring-damper", "tau": 0.003, "period_tolerance": 0.5},
    faults={
        "unplugged": Fault(
            ["unplugged 1"], AT_ONCE, GONE, then=["unplugged 0"], after="found no device with the number 0"
        ),
        "cable cut, and the device has not seen it": Fault(
            ["cut 1"], BY_ITSELF, GONE, then=["cut 0"], after="found no device with the number 0"
        ),
        "force button": Fault(["button"], AT_ONCE, "found its forces taken away by its force button"),
        "velocity threshold": Fault(
            ["fastest 1e-9"], AT_ONCE, "faster than its velocity threshold", then=["fastest 3"]
        ),
        "process killed": Fault([KILL], BY_ITSELF, "was killed by SIGKILL while running"),
        "reset, and not calibrated": Fault(
            ["reset"], AT_ONCE, GONE, then=["uncalibrated 0"], after="found that it is not calibrated"
        ),
        "stalled for 30 ms": Fault(["stall 30"], BY_ITSELF, dies=False),
        "wrong units": Fault(
            ["scale 1000"],
            BY_ITSELF + 0.001,
            "beyond its limits of displacement or speed, and let go",
            dies=False,
            then=["scale 1"],
            apart=QUIET + 1.0,
        ),
        "process killed, and the next one's library in mm": Fault(
            [KILL, "scale 1000"],
            BY_ITSELF,
            "was killed by SIGKILL while running",
            then=["scale 1"],
            after="this library has another unit of length",
        ),
        "readings of the past": Fault(
            ["stuck 1"], SILENCE + BY_ITSELF + 0.001, "found no new reading for", then=["stuck 0"]
        ),
    },
)
