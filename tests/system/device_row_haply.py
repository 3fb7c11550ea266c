"""The row of an Inverse3 behind its service in the campaign of faults (tests/system/device_faults.py).

The fake's service may be killed; its device then lets go by itself, after the time in which it hears nothing. The maker
documents neither that time nor what a closed connection does (docs/devices/haply-inverse3.md), so both are the fake's.
The force in its log is that of a message, whose torques the motors hold.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Final

from ..fakes.far_side import FarSide, Force, Given, Record
from ..fakes.haply import FakeHaply, fake_haply
from .device_row import KILL, LASTS, Fault, Free, LoggedFarSide, Row, marks_in

IDLE: Final = 0.02  # s without a message, after which the device lets go
GRAIN: Final = 0.002  # s, of the fake's log: it looks every millisecond
CATCHES_UP: Final = 5_000_000  # ns, in which a service that has stalled has heard what was waiting
FREE: Final[Mapping[str, Any]] = {"mass": 0.15, "damping": 1.0, "step": 0.001}
HELD: Final[Mapping[str, Any]] = {**FREE, "hand": 100.0, "amplitude": 0.015}
"""Somebody holds the device, and moves."""


class HaplyFarSide(LoggedFarSide):
    """A fake service that writes a log."""

    def __init__(self, one: FakeHaply, folder: Path) -> None:
        super().__init__(lambda text: one.order(*text.split("\n")), folder / "haply.log")
        self._one = one
        self.parameters: Mapping[str, object] = {"port": one.port, "events": one.events}
        self.order(f"log {self._log}")

    def force(self) -> Sequence[float]:
        f: list[float] = self._one.asked()["f"]
        return f

    def record(self) -> Record:
        self._one.asked()  # it has written down all until now
        motors, given = list[tuple[int, Force]](), list[Given]()
        busy, stalls = list[tuple[int, int]](), list[tuple[int, int]]()
        for kind, at, rest in (entries := self.entries()):
            match kind:
                case "m":
                    x, y, z = map(float, rest.split())
                    motors.append((at, (x, y, z)))
                case "r":
                    given += [Given(at, at + int(1e9 * (IDLE + GRAIN)), f) for f in forces(rest)]
                case "b":
                    busy.append((at, int(rest)))
                case "o" if rest.startswith("stall "):
                    stalls.append((at, at + 1_000_000 * int(rest.split()[-1]) + CATCHES_UP))
        return Record(motors, given, marks_in(entries), busy, stalls)


def forces(message: str) -> Iterator[Force]:
    """The forces that a message gives."""
    for one in json.loads(message).get("inverse3", []):
        f = one.get("commands", {}).get("set_cursor_force", {}).get("vector")
        if f is not None:
            yield float(f["x"]), float(f["y"]), float(f["z"])


@contextmanager
def haply(folder: Path, given: Mapping[str, Any] = HELD) -> Iterator[FarSide]:
    with fake_haply(**given, idle=IDLE) as one:
        yield HaplyFarSide(one, folder)


SILENCE: Final = 0.5  # s, of the driver: a busy machine may give it no turn for a while
T: Final = 0.004  # s
BY_ITSELF: Final = LASTS * T
AT_ONCE: Final = 0.001  # s
LETS_GO: Final = IDLE + GRAIN
CLOSED: Final = "expected an open connection: the service was stopped"
TIMES: Final = {"sample_age": 0.002, "actuation_delay": 0.001}  # s

HAPLY: Final = Row(
    opened=haply,
    free=Free(
        opened=partial(haply, given=FREE),
        options=("--dof", 3, "--force", 2, "--travel", 0.04, "--speed", 0.25),
        damping=FREE["damping"],
        friction=0.0,
        mass=FREE["mass"],
        step=0.0,  # none is stated, and joints' steps are none of the tip
        stated=False,
    ),
    keys={
        "dof": 3,
        "axes": ["x", "y", "z"],
        "osp": 1.0,
        "driver": "haply-inverse3",
        **TIMES,
        "held": "torque",
        "linkage": {"kappa": 8},
        "limits": {"force": 5, "displacement": 0.15, "speed": 1},
    },
    period=T,
    parameters={"silence": SILENCE, "force": 5, **TIMES},
    design={"coupling": "spring-damper", "tau": 0.004, "period_tolerance": 0.5},
    faults={
        "service killed": Fault(["die"], LETS_GO, CLOSED, then=["rise"], after="found no service"),
        "unplugged": Fault(
            ["gone", "lose"], LETS_GO, "see its cable and its power", then=["find"], after="found the devices none"
        ),
        "braked": Fault(
            ["ebrake", "status ready 0"],
            AT_ONCE,
            "found its emergency brake on",
            then=["free", "status ready 1"],
            after="expected it ready: free its emergency brake",
        ),
        "not ready": Fault(["status ready 0"], AT_ONCE, "found it not ready", then=["status ready 1"]),
        "without power": Fault(
            ["status power_supply 0"], AT_ONCE, "found it without power", then=["status power_supply 1"]
        ),
        "stalled for 30 ms": Fault(["stall 30"], LETS_GO, dies=False),
        "first frame lost": Fault(
            ["first 0", "close"],
            AT_ONCE,
            CLOSED,
            then=["first 1"],
            after="expected the first one, which the service sends by itself",
        ),
        "millimetres": Fault(
            ["mm"], BY_ITSELF + AT_ONCE, "positions may be in another unit since an update", then=["m"]
        ),
        "silent": Fault(["mute"], SILENCE + BY_ITSELF + AT_ONCE, "found no answer for", then=["speak"]),
        "process killed": Fault([KILL], LETS_GO, "was killed by SIGKILL while running"),
    },
)
