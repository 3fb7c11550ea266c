"""How much of the force that was asked of a device its hand was given, by the figures of its telemetry: pure.

:mod:`manyhands.nodes.device.given` states what the two shares are, and keeps their account. Here the figures become
shares again, of a whole run or of its last seconds, and a sentence: how much, and why.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import astuple, dataclass
from operator import sub
from typing import Any, Final

from manyhands.nodes.kernel.words import counted
from manyhands.nodes.rows import figures as names

ENOUGH: Final = 0.9
"""The least share, by force and by time, that counts as enough. A ramp after one stall takes 0.1 s, 2 % of
:data:`WINDOW`, and a machine's usual late ticks take less. Below it, a wall feels a tenth softer than is certified.
"""

WINDOW: Final = 5.0
"""The time that the shares of a running session are about, s: as for its pace."""

LEAST_TIME: Final = 2.0
"""The time that a device must have taken part for before its shares are judged, s: one stall with its ramp is less
than a tenth of it."""

LEAST_FORCE: Final = 0.01
"""The mean force that must have been asked for before the share by force is judged, N: no hand feels less."""

MEASURE: Final = (
    "manyhands doctor, with the session's file, measures what would help on this machine: other periods, or where "
    "couplings run"
)
"""What is said of a machine that is too slow. Only a measurement can tell what would help it, and at what cost."""

FIGURES: Final = (
    names.FORCE_ASKED, names.FORCE_GIVEN, names.FORCE_TIME, names.FORCE_AWAY, names.FORCE_HELD_BACK, names.FORCE_CUT,
)  # fmt: skip
"""The figures of a device's telemetry that this is made of, in the order of the fields of :class:`GivenForce`."""


@dataclass(frozen=True)
class GivenForce:
    """The force that a device was asked for and gave, over a run or a part of it.

    Attributes:
        asked: the impulse that was asked for within the limits, N*s.
        given: the impulse that was exerted, N*s.
        time: the time that counts, s.
        away: the part of it without a valid answer, s.
        held_back: the part in which the reserve for lateness took something of the force, s.
        cut: the part in which a limit did, s.
    """

    asked: float
    given: float
    time: float
    away: float = 0.0
    held_back: float = 0.0
    cut: float = 0.0

    @classmethod
    def of(cls, figures: Mapping[str, float]) -> GivenForce | None:
        """What the figures of a device state; None where it states nothing, or no finite numbers from 0 on."""
        values = [figures.get(name, math.nan) for name in FIGURES]
        if not all(0.0 <= value < math.inf for value in values):
            return None
        asked, given, *times = values
        return cls(asked, given, *(1e-6 * time for time in times))

    def since(self, before: GivenForce) -> GivenForce:
        """What has come since ``before``."""
        return GivenForce(*map(sub, astuple(self), astuple(before)))

    @property
    def lacking(self) -> float:
        """The time in which the device did not exert all that was asked, s."""
        return self.away + self.held_back + self.cut

    @property
    def by_force(self) -> float | None:
        """The share by force; None where too little was asked for."""
        if not self.asked > LEAST_FORCE * self.time:
            return None
        return min(1.0, max(0.0, self.given / self.asked))

    @property
    def by_time(self) -> float | None:
        """The share by time; None before the device has taken part."""
        if not self.time > 0.0:
            return None
        return min(1.0, max(0.0, 1.0 - self.lacking / self.time))

    @property
    def enough(self) -> bool:
        """Whether both shares are enough, or too little is known to judge them."""
        shares = [share for share in (self.by_force, self.by_time) if share is not None]
        return self.time < LEAST_TIME or all(share >= ENOUGH for share in shares)

    def in_words(self, span: str = "the time") -> str:
        """Both shares over ``span``, for a sentence about a device that was given them; empty before any time."""
        if self.by_time is None:
            return ""
        when = f"in {percent(self.by_time)} of {span}"
        if self.by_force is None:
            return f"all of the force asked {when}"
        return f"{percent(self.by_force)} of the force asked, and all of it {when}"

    def as_plain(self) -> dict[str, Any]:
        """As a JSON object for the report."""
        shares = {"force": self.by_force, "time": self.by_time}
        times = {"seconds": self.time, "away": self.away, "held_back": self.held_back, "cut": self.cut}
        return {name: share for name, share in shares.items() if share is not None} | times

    def sentence(self, device: str, frozen: Mapping[str, float]) -> str:
        """How much the hand of ``device`` was given, why it was not more, and what tells what helps.

        Args:
            device: its name.
            frozen: how often each of its couplings was frozen for staying silent in that time.
        """
        times = {name: counted(n, "time") for name, n in frozen.items() if n > 0.0}
        often = ", ".join(f"{name} was frozen {count}" for name, count in times.items())
        remedy, most = f". {MEASURE}", max(self.away, self.held_back, self.cut)
        if most == 0.0:
            why, remedy = "its forces were lowered, as its lateness says", ""
        elif most == self.away:
            why = f"for {self.away:.2g} s of them it had no answer in time, or its force rose again after that"
            if often:
                why += f"; {often} for staying silent, which the machine that they share may have caused"
        elif most == self.held_back:
            why = (
                f"for {self.held_back:.2g} s of them forces came so late that the reserve for lateness (faults.tank) "
                "held them back"
            )
        else:
            why, remedy = f"for {self.cut:.2g} s of them its limits of force or motion cut the force", ""
        return f"{device} was given {self.in_words(f'the last {self.time:.2g} s')}: {why}{remedy}"


def shares_cell(by_force: float | None, by_time: float | None) -> str:
    """Both shares for a table, in percent, rounded down; a dash for one that is not known, nothing without both."""
    shares = (by_force, by_time)
    if shares == (None, None):
        return ""
    return "/".join("-" if share is None else f"{math.floor(100.0 * share + 1e-9)}" for share in shares)


def percent(share: float) -> str:
    """A share in percent, rounded down: what lacks something is never called all."""
    return f"{math.floor(1000.0 * share + 1e-9) / 10.0:.3g} %"
