"""What the ends of wave links report, tick by tick."""

from __future__ import annotations

from array import array
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from manyhands.nodes.link.join import WaveRow
from manyhands.protocol.channels import FORCE, FREE_POSITION, TANK, WAVE


def wave_traces(rows: Sequence[WaveRow]) -> dict[str, NDArray[np.float64]]:
    """The waves and the tank of a user's end by tick, as traces; empty without a wave link."""
    if not rows:
        return {}
    return {WAVE: np.array([row.c for row in rows]), TANK: np.array([row.tank for row in rows])}


class WorldRows:
    """What all world's ends report, tick by tick: positions, forces, waves and tanks.

    Each tick is written down as numbers at once. To make arrays of 100 ticks of 64 links takes 5 ms, which would be
    five late ticks.
    """

    __slots__ = ("_rows", "_values")

    def __init__(self) -> None:
        """No row yet."""
        self._rows = 0
        self._values = [array("d") for _ in range(4)]

    def add(self, ends: Sequence[WaveRow]) -> None:
        """Add a tick's row; ``ends`` are the same links in each."""
        p, f, c, tank = self._values
        p.extend([at for end in ends for at in end.p])
        f.extend([force for end in ends for force in end.f])
        c.extend([wave for end in ends for wave in end.c])
        tank.extend([energy for end in ends for energy in end.tank])
        self._rows += 1

    def take(self) -> dict[str, NDArray[np.float64]]:
        """The rows since the last call, as traces; empty without any."""
        rows, values = self._rows, self._values
        self._rows, self._values = 0, [array("d") for _ in range(4)]
        if rows == 0:
            return {}
        traces = (FREE_POSITION, FORCE, WAVE, TANK)
        return {name: np.frombuffer(value).reshape(rows, -1) for name, value in zip(traces, values, strict=True)}
