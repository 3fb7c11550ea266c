"""The rows of a recording as those who recompute it take them, and the first tick at which a clutch may have moved.

A row is whole or it is none. What happened to a node between two rows is in its events
(:mod:`manyhands.launch.recordings.course`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

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


def changed_after(figures: Figures, name: str, at_rest: float = 0.0) -> int | None:
    """The tick behind which a figure first was no longer ``at_rest``, as far as its telemetry says; None for never."""
    begin = 0
    for tick, told in figures:
        value = told.get(name, at_rest)
        if value != at_rest and not np.isnan(value):
            return begin
        begin = tick
    return None


def first_sign(run: Run, environment: str) -> tuple[int, str]:
    """The first tick at which a clutch may have been at work, and why; the run's end where there is no sign of one.

    A clutch moves when a coupling is frozen, comes back, or changes its rung, and when the devices have waited so long
    that they have let go; and when one is held to its energy budget. The devices count who lets go, the environment
    all the others.
    """
    told, signs = run.figures.get(environment, ()), [(run.ticks, "")]

    def look(figures: Figures, name: str, why: str) -> None:
        begin = changed_after(figures, name)
        if begin is not None:
            signs.append((begin, why))

    look(told, names.FROZEN, "a coupling was frozen")
    look(told, names.FROZEN_TICKS, "a coupling was frozen")
    own = there(rows_of(run, environment, names.TOOL_POSITION))
    for node in run.recorded.roles:
        figures = run.figures.get(node, ())
        look(figures, names.RELEASED, f"{node} ran free")
        look(figures, names.JUMPS, f"{node} went on at a later tick")
        look(figures, names.RUNG, f"{node} changed its rung")
        look(told, f"{names.RUNG}_{node}", f"{node} changed its rung")
        look(told, f"{names.SCALED}{node}", f"{node} was held to its budget")
    holes = np.flatnonzero(~own)
    signs += [(int(holes[0]), "the environment has no row there")] if len(holes) else []
    for node, role in run.recorded.roles.items():
        if role is Role.COUPLING:
            holes = np.flatnonzero(own & ~there(rows_of(run, node, names.FREE_POSITION)))
            signs += [(int(holes[0]), f"{node} has no row there")] if len(holes) else []
    return min(signs)
