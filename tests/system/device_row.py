"""What a row of the campaign of faults has (tests/system/device_faults.py): :class:`Row`, with its :class:`Fault`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from manyhands.nodes.kernel.timeouts import HELD_TICKS

from ..fakes.far_side import FarSide

KILL: Final = "KILL"
"""In place of an order: the process of the device's driver is killed, which then cannot let go."""

LASTS: Final = HELD_TICKS
"""Periods from a sample on for which its force is held at the longest."""


@dataclass(frozen=True)
class Fault:
    """A fault of a device.

    Attributes:
        orders: to the fake, or :data:`KILL`.
        within: the time in which its motors exert no force, s, by what the device's page and the driver state.
        said: what an incident says of it, a pattern; empty where the device's process has nothing to say.
        dies: whether the device's process ends; a new one takes its place.
        then: orders that end the fault, once it was said.
        after: what is said before these orders, a pattern; empty where ``said`` is all.
        lasts: for how long it is let be where nothing is said, s.
        apart: for how long the session says nothing of another one, s.
        late: for how long forces may then come late that were under way, s, by what the device's page states.
    """

    orders: Sequence[str]
    within: float
    said: str = ""
    dies: bool = True
    then: Sequence[str] = ()
    after: str = ""
    lasts: float = 0.1
    apart: float = 0.0
    late: float = 0.0


@dataclass(frozen=True)
class Free:
    """The device of a row where nobody holds it, as `manyhands identify` needs it (tests/system/test_identify.py).

    Attributes:
        opened: gives the fake, as that of :class:`Row`.
        options: of the command.
        damping: the truth, N s/m or N m s/rad: the least of all directions.
        friction: likewise, N or N m.
        mass: likewise, kg or kg m^2.
        step: of its encoders, m or rad.
        stated: whether an osp of use can be stated of it; of three axes none is surely half of the truth.
    """

    opened: Callable[[Path], AbstractContextManager[FarSide]]
    options: Sequence[object]
    damping: float
    friction: float
    mass: float
    step: float
    stated: bool = True


@dataclass(frozen=True)
class Row:
    """A device of the campaign.

    Attributes:
        opened: gives the fake, with files of its own in a folder; ``force`` of it is N or N m.
        free: the same where nobody holds it.
        keys: of the session's device, without ``parameters``.
        period: of the session, s.
        faults: by name.
        parameters: for the driver, beside those of the fake.
        stiffness: of the world's springs at its first axis, N/m or N m/rad.
        ground: of the innocent's spring to the ground, N/m; ``stiffness`` where it is not given.
        felt: the force on an axis from which on the device counts as felt, N or N m.
        design: of the session.
        precision: the relative precision in which its motors are given a force.
        scale: the fake's force for one of the session's, on every axis.
        way: for how long a force may be under way, s, where the device counts its time from its arrival.
        late: how much later than it was told a device ends a force, s: its stated ``actuation_delay`` at most.
    """

    opened: Callable[[Path], AbstractContextManager[FarSide]]
    free: Free
    keys: Mapping[str, Any]
    period: float
    faults: Mapping[str, Fault]
    parameters: Mapping[str, Any] = field(default_factory=dict)
    stiffness: float = 80.0
    ground: float | None = None
    felt: float = 0.05
    design: Mapping[str, Any] = field(default_factory=dict)
    precision: float = 1e-6
    scale: float = 1.0
    way: float = 0.0
    late: float = 0.0


Entry = tuple[str, int, str]
"""A line of a fake's log: its kind, when it was written, ns, and the rest."""


class LoggedFarSide:
    """A fake that takes orders, and writes a log of lines ``KIND INSTANT REST``; an order to note a mark is one."""

    def __init__(self, give: Callable[[str], object], log: Path) -> None:
        """A far side whose fake is given its orders by ``give``, one in a line."""
        self._give, self._log = give, log

    def order(self, *lines: str) -> None:
        if lines:
            self._give("\n".join(lines))

    def mark(self, number: int, *lines: str) -> None:
        self.order(f"note mark {number}", *lines)

    def entries(self) -> list[Entry]:
        """What the log has so far; the fake goes on, so its last line may be in the making."""
        whole, _, _ = self._log.read_text().rpartition("\n")
        parts = ((*line.split(" ", 2), "")[:3] for line in whole.splitlines())
        return [(kind, int(at), rest) for kind, at, rest in parts]


def marks_in(entries: Sequence[Entry]) -> dict[int, int]:
    """When each mark was noted, ns."""
    noted = ((at, rest.removeprefix("note ").split()) for kind, at, rest in entries if kind == "o")
    return {int(words[1]): at for at, words in noted if words[:1] == ["mark"]}
