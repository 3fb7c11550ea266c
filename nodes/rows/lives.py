"""The figures of a node over all its processes: each counts from 0, and a node that comes back has a new one.

What the numbers of several processes make together is declared with each figure
(:attr:`~manyhands.nodes.rows.figures.Figure.over_lives`). Of a process that has died, what its last telemetry said is
all that is known.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping
from typing import Final

from manyhands.nodes.rows.figures import FIGURES, Figure, OverLives
from manyhands.protocol.messages import Figures

_JOINED: Final[Mapping[OverLives, Callable[[float, float], float]]] = {
    OverLives.SUM: operator.add,
    OverLives.GREATEST: max,
    OverLives.LEAST: min,
}


class Lives:
    """The figures of the nodes of one session."""

    def __init__(self) -> None:
        """Nothing is known yet."""
        self._earlier: dict[str, Figures] = {}
        self._latest: dict[str, Figures] = {}

    def take(self, node: str, figures: Figures) -> None:
        """The present process of ``node`` has said this: its latest telemetry, or its final report."""
        self._latest[node] = figures

    def forget(self, node: str) -> None:
        """``node`` has a new process, which counts from 0."""
        if node in self._latest:
            self._earlier[node] = self.of(node)
            del self._latest[node]

    def of(self, node: str) -> Figures:
        """What all processes of ``node`` make together; of several, only numbers that are finite."""
        latest, earlier = self._latest.get(node, Figures()), self._earlier.get(node)
        return latest if earlier is None else together(earlier, latest)


def together(earlier: Figures, latest: Figures) -> Figures:
    """What the figures of former processes and of the latest one make together, as far as they are finite."""
    earlier, latest = earlier.finite(), latest.finite()
    numbers, tables = dict(latest), {name: dict(table) for name, table in latest.tables.items()}
    for name, before in earlier.items():
        figure = FIGURES.get(name)
        if figure is None:
            continue  # an event, which is over
        if figure.beside:
            if earlier.get(figure.beside, math.inf) < latest.get(figure.beside, math.inf):
                numbers[name] = before
        else:
            _join(figure, numbers, name, before)
    for name, table in earlier.tables.items():
        if (figure := FIGURES.get(name)) is not None:
            for key, before in table.items():
                _join(figure, tables.setdefault(name, {}), key, before)
    return Figures(numbers, {name: table for name, table in tables.items() if table})


def _join(figure: Figure, numbers: dict[str, float], key: str, before: float) -> None:
    """Make one number of that of former processes and of the latest one, which stands in ``numbers``."""
    join = _JOINED.get(figure.over_lives)
    if join is not None:
        numbers[key] = join(before, numbers[key]) if key in numbers else before
