"""The rows of a recording as those who recompute it take them, and what its figures say of where they may.

A row is whole or it is none. What happened to a node between two rows (it ran free, it was frozen, it changed its rung)
is in no row; but its figures count it, ten times a second, and so say between which ticks it was.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from manyhands.launch.recordings.run import Run
from manyhands.nodes import telemetry as names
from manyhands.protocol.messages import Role

Array = NDArray[np.float64]
Figures = Sequence[tuple[int, Mapping[str, float]]]


def rows_of(run: Run, node: str, trace: str) -> Array:
    """The rows of one trace of a node, ticks x columns; NaN where it has none, and for every tick where it is missing.

    Args:
        run: the recording.
        node: whose.
        trace: by its name in telemetry, such as ``x``.
    """
    for (of, _), kept in run.traces.items():
        if of == node and kept.topic.trace == trace:
            values = kept.values
            if len(values) == run.ticks:
                return values
            missing = np.full((run.ticks - len(values), values.shape[1]), np.nan)
            return np.vstack([values, missing])
    topic = next(topic for topic in run.recorded.topics(node) if topic.trace == trace)
    return np.full((run.ticks, len(run.recorded.columns(node, topic))), np.nan)


def there(rows: Array) -> NDArray[np.bool_]:
    """The ticks whose row is whole."""
    return np.asarray(np.isfinite(rows).all(axis=1), dtype=np.bool_)


@dataclass(frozen=True)
class Window:
    """Something happened at one of these ticks: not before ``begin``, and before ``end``; ``value`` is told then."""

    begin: int
    end: int
    value: float


def changes(figures: Figures, name: str, at_rest: float = 0.0) -> list[Window]:
    """Where a figure became another one; it begins as ``at_rest``."""
    out, before, begin = [], at_rest, 0
    for tick, told in figures:
        value = told.get(name, before)
        if value != before and not np.isnan(value):
            out.append(Window(begin, tick, value))
            before = value
        begin = tick
    return out


def count_until(figures: Figures, name: str) -> Callable[[int], float]:
    """What a count had come to, at most, when a tick was done: what is told by the first figures behind it."""
    ticks = [tick for tick, _ in figures]
    values = [0.0 if np.isnan(value := told.get(name, 0.0)) else value for _, told in figures]

    def at(tick: int) -> float:
        i = int(np.searchsorted(ticks, tick, side="right"))
        if not values:
            return 0.0
        return values[min(i, len(values) - 1)]

    return at


def first_sign(run: Run, environment: str) -> tuple[int, str]:
    """The first tick at which a clutch may have been at work, and why; the run's end where there is no sign of one.

    A clutch moves when a coupling is frozen, comes back, or changes its rung, and when the devices have waited so long
    that they have let go; and when one is held to its energy budget. The devices count who lets go, the environment
    all the others.
    """
    signs: list[tuple[int, str]] = [(run.ticks, "")]
    told = run.figures.get(environment, ())
    signs += [(w.begin, "a coupling was frozen") for w in changes(told, names.FROZEN)[:1]]
    signs += [(w.begin, "a coupling was frozen") for w in changes(told, names.FROZEN_TICKS)[:1]]
    own = there(rows_of(run, environment, names.TOOL_POSITION))
    for node in run.recorded.roles:
        figures = run.figures.get(node, ())
        for name, why in (
            (names.RELEASED, f"{node} ran free"),
            (names.JUMPS, f"{node} went on at a later tick"),
            (names.RUNG, f"{node} changed its rung"),
        ):
            signs += [(w.begin, why) for w in changes(figures, name)[:1]]
        signs += [(w.begin, f"{node} changed its rung") for w in changes(told, f"{names.RUNG}_{node}")[:1]]
        signs += [(w.begin, f"{node} was held to its budget") for w in changes(told, f"{names.SCALED}{node}")[:1]]
    holes = np.flatnonzero(~own)
    signs += [(int(holes[0]), "the environment has no row there")] if len(holes) else []
    for node, role in run.recorded.roles.items():
        if role is Role.COUPLING:
            holes = np.flatnonzero(own & ~there(rows_of(run, node, names.FREE_POSITION)))
            signs += [(int(holes[0]), f"{node} has no row there")] if len(holes) else []
    return min(signs)
