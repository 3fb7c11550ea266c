"""The devices of the campaign of faults, a row each (tests/system/device_faults.py); their fakes: tests/fakes/.

A new driver is a file ``device_row_NAME.py`` and a line below. The file has a function that opens its fake as a
:class:`~tests.fakes.far_side.FarSide`, its keys of a session, and its faults (device_row.py).
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Final

from manyhands.devices.serial_board.frames import opened
from manyhands.launch.run.breaches import QUIET

from ..fakes.board import Axis, FakeBoard, fake_board
from ..fakes.far_side import FarSide, Force, Given, Record
from .device_row import KILL, LASTS, Fault, Free, LoggedFarSide, Row, marks_in
from .device_row_evdev_wheel import EVDEV_WHEEL
from .device_row_force_dimension import FORCE_DIMENSION
from .device_row_haply import HAPLY
from .device_row_moteus import MOTEUS
from .device_row_odrive import ODRIVE

# --- the serial board


class BoardFarSide(LoggedFarSide):
    """A fake board whose port is a link, so that it is the same after it was plugged in again."""

    def __init__(self, one: FakeBoard, folder: Path) -> None:
        super().__init__(one.order, folder / "board.log")
        self._one = one
        port = folder / "port"
        self.plug = f"plug {port}"
        self.parameters: Mapping[str, object] = {"port": str(port)}
        self.order(self.plug, f"log {self._log}")
        one.asked()  # so that the port is there

    def order(self, *lines: str) -> None:
        super().order(*(self.plug if line == "plug" else line for line in lines))

    def force(self) -> Sequence[float]:
        return self._one.asked()[1]

    def record(self) -> Record:
        self._one.asked()  # it has written down all until now
        motors: list[tuple[int, Force]] = []
        busy, wire = list[tuple[int, int]](), BoardWire()
        for kind, at, rest in (entries := self.entries()):
            match kind:
                case "c":
                    wire.clock(at, int(rest))
                case "m":
                    motors.append((at, tuple(single(float(force)) for force in rest.split())))
                case "r":
                    wire.take(bytes.fromhex(rest), at)
                case "b":
                    busy.append((at - 1000 * int(rest), at))
        return Record(motors, wire.given, marks_in(entries), busy)


def single(number: float) -> float:
    """The number in single precision, as it is on a board."""
    return float(struct.unpack("<f", struct.pack("<f", number))[0])


class BoardWire:
    """The forces on a board's wire, by PROTOCOL.md and without the firmware's core.

    Attributes:
        given: the forces, in the order in which they came.
    """

    LONGEST: Final = 50_000_000
    """ns, as the fake states it."""

    LIMIT: Final = 5.0
    """N, as the fake states it."""

    def __init__(self) -> None:
        self.given: list[Given] = []
        self._coming = b""
        self._at_zero = self._shown = 0

    def clock(self, at: int, shown: int) -> None:
        """The board's clock shows ``shown`` us at the instant ``at``, ns."""
        self._at_zero, self._shown = at, shown

    def take(self, data: bytes, at: int) -> None:
        """What was read at an instant, ns."""
        *frames, self._coming = (self._coming + data).split(b"\0")
        for frame in frames:
            payload = opened(frame)
            if payload is None or payload[0] != 0x02:
                continue
            until = struct.unpack_from("<I", payload, 3)[0]
            f = struct.unpack_from(f"<{(len(payload) - 7) // 4}f", payload, 7)
            ends = self._at_zero + 1000 * self._since(until, at)
            limited = tuple(max(-self.LIMIT, min(self.LIMIT, force)) for force in f)
            self.given.append(Given(at, min(ends, at + self.LONGEST), limited))

    def _since(self, shown: int, at: int) -> int:
        """us from the clock's 0 until it shows ``shown``, nearest to the instant ``at``, ns."""
        turn = 1 << 32
        first = (shown - self._shown) % turn
        return first + turn * round(((at - self._at_zero) / 1000 - first) / turn)


HELD: Final = Axis(m=0.15, b=1.0, step=1e-5, k=100.0, amplitude=0.01, frequency=0.7)
"""Somebody holds the board, and moves."""

FREE: Final = Axis(m=0.15, b=3.0, c=0.1, step=1e-5)


@contextmanager
def board(folder: Path, axis: Axis = HELD) -> Iterator[FarSide]:
    with fake_board(axis, period_us=500) as one:
        yield BoardFarSide(one, folder)


SILENCE: Final = 0.5  # s, of the driver: a busy machine may give the board no turn for a while
T: Final = 0.004  # s
BY_ITSELF: Final = LASTS * T
AT_ONCE: Final = 0.001  # s: two periods of the board
GONE: Final = "found no state for"

SERIAL_BOARD: Final = Row(
    opened=board,
    free=Free(
        opened=partial(board, axis=FREE),
        options=("--travel", 0.06, "--speed", 0.25, "--force", 4),
        damping=FREE.b,
        friction=FREE.c,
        mass=FREE.m,
        step=FREE.step,
    ),
    keys={
        "dof": 1,
        "osp": 1.0,
        "driver": "serial-board",
        "sample_age": 0.001,
        "actuation_delay": 0.0005,
        "mass": 0.149,
        "step": 0.00001,
        "limits": {"force": 5, "displacement": 0.1, "speed": 2},
    },
    period=T,
    parameters={"silence": SILENCE, "sample_age": 0.001, "actuation_delay": 0.0005},
    design={"coupling": "spring-damper", "tau": 0.003, "period_tolerance": 0.5},
    faults={
        "unplugged": Fault(
            ["unplug"],
            BY_ITSELF,
            "see that it is plugged in and has power",
            then=["plug"],
            after="there is no such port; plug the device in",
        ),
        "process killed": Fault([KILL], BY_ITSELF, "was killed by SIGKILL while running"),
        "reset": Fault(["reset"], AT_ONCE, GONE),
        "braked": Fault(["brake"], AT_ONCE, "found the board braked by its own protection", then=["free"]),
        "stalled for 30 ms": Fault(["stall 30"], BY_ITSELF, dies=False),
        "first frame lost": Fault(["reset", "drop 1"], AT_ONCE, GONE),
        "wrong units": Fault(
            ["scale 1000"],
            BY_ITSELF + 0.001,
            "beyond its limits of displacement or speed, and let go",
            dies=False,
            then=["scale 1"],
            apart=QUIET + 1.0,
        ),
        "mute": Fault(["mute"], SILENCE + BY_ITSELF + 0.001, GONE, then=["speak"]),
    },
)

ROWS: Final[Mapping[str, Row]] = {
    "serial-board": SERIAL_BOARD,
    "moteus": MOTEUS,
    "odrive": ODRIVE,
    "haply-inverse3": HAPLY,
    "force-dimension": FORCE_DIMENSION,
    "evdev-wheel": EVDEV_WHEEL,
}
"""By the driver's name."""
