"""Which figures of a node a table shows while a session runs, in which order and form: one place for all tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from manyhands.nodes import telemetry as names


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes:
        title: above it, with its unit.
        figure: the figure of a node's telemetry that it shows.
        form: how, as :func:`format` has it.
        rank: where there is little room the columns of the highest rank are left out first.
    """

    title: str
    figure: str
    form: str
    rank: int

    def cell(self, figures: Mapping[str, float]) -> str:
        """What stands in it; nothing where the node has no such figure."""
        value = figures.get(self.figure)
        return "" if value is None else format(value, self.form)


COLUMNS: Final = (
    Column("late", names.LATE, ".0f", 1),
    Column("τ p50 [µs]", f"{names.TAU}_p50", ".0f", 4),
    Column("τ p99 [µs]", f"{names.TAU}_p99", ".0f", 2),
    Column("rung", names.RUNG, ".0f", 5),
    Column("frozen", names.FROZEN, ".0f", 3),
    Column("speed [m/s]", names.SPEED, ".2e", 7),
    Column("ledger [J]", names.LEDGER, ".2e", 6),
    Column("margin [J]", names.LEDGER_MARGIN, ".2e", 8),
    Column("refused", names.NOT_ADMITTED, ".0f", 9),
)
"""In the order in which they are shown."""

LEAST_SHOWN: Final = 1e-3
"""J below which nobody is said to have moved anybody."""

MOST_SHOWN: Final = 6
"""Pairs that are shown, those with the most energy."""


def energy_line(figures: Mapping[str, float]) -> str:
    """Who moved whom, and who is held to an energy budget, in a line; empty for nothing."""
    pairs = ((value, *key.removeprefix(names.MOVED).partition("/")) for key, value in figures.items()
             if key.startswith(names.MOVED) and value >= LEAST_SHOWN)  # fmt: skip
    moved = [f"{supplier} → {receiver} {value:.3g}" for value, supplier, _, receiver in sorted(pairs, reverse=True)]
    scaled = [key.removeprefix(names.SCALED) for key, value in figures.items() if key.startswith(names.SCALED)]
    parts = [f"who moved whom [J]: {', '.join(moved[:MOST_SHOWN])}"] if moved else []
    if len(moved) > MOST_SHOWN:
        parts[0] += f" and {len(moved) - MOST_SHOWN} more"
    return "; ".join([*parts, *([f"held to an energy budget: {', '.join(scaled)}"] if scaled else [])])
