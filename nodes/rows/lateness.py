"""How long the others of a session waited for one coupling, by the environment's figures."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from manyhands.nodes.kernel.words import counted
from manyhands.nodes.rows import figures as names
from manyhands.protocol.messages import Figures


@dataclass(frozen=True)
class CouplingLateness:
    """How long the others waited for one coupling.

    Attributes:
        ticks: the ticks in which it came after the others, or not at all.
        time: how long the others waited in them, us.
        frozen: how often it was frozen for being silent.
        held: the ticks in which it was held.
        waived: how often it was late so often that nobody waited for it any more.
    """

    ticks: int
    time: float
    frozen: int
    held: int = 0
    waived: int = 0

    def as_plain(self) -> dict[str, float]:
        """As a JSON object for the report; the time in s."""
        counts = {count: getattr(self, count) for count in _COUNTS}
        return {"ticks": self.ticks, "seconds": self.time / 1e6} | counts

    def sentence(self, name: str) -> str:
        """The figures as a sentence; ``name`` is that of the coupling."""
        return (
            f"the others waited for {name} in {counted(self.ticks, 'tick')}, {self.time / 1e6:.3g} s in all, and then "
            f"no more; its tool rested for {counted(self.held, 'tick')}, and it was frozen "
            f"{counted(self.frozen, 'time')}"
        )


_COUNTS: Final = {
    "ticks": names.WAITED_TICKS,
    "frozen": names.FROZEN_LATE,
    "held": names.OVERDUE,
    "waived": names.WAIVED,
}
"""The figures of the counts of a :class:`CouplingLateness`, by field."""


def lateness_tables(lateness: Mapping[str, CouplingLateness]) -> dict[str, dict[str, float]]:
    """The tables of figures that state the lateness of these couplings."""
    fields = _COUNTS | {"time": names.WAITED_TIME}
    return {of: {name: float(getattr(one, field)) for name, one in lateness.items()} for field, of in fields.items()}


def lateness_by_coupling(figures: Figures) -> dict[str, CouplingLateness]:
    """The lateness of every coupling that made the others wait, by its name; without those that make no sense."""
    times = figures.table(names.WAITED_TIME)
    out = {}
    for name in figures.table(names.WAITED_TICKS):
        counts = {field: figures.table(of).get(name, 0.0) for field, of in _COUNTS.items()}
        time = times.get(name, math.nan)
        if all(0.0 <= value < math.inf for value in (time, *counts.values())) and counts["ticks"] + counts["held"]:
            out[name] = CouplingLateness(time=time, **{field: int(count) for field, count in counts.items()})
    return out
