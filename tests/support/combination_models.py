"""The models that the table of combinations runs: a wall of proxies, and a world that gives energy away."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]


class Wall:
    """Every tool is free for a millimetre either way."""

    def __init__(self, ports: tuple[str, ...], period: float, parameters: Mapping[str, Any]) -> None:
        """Nothing is kept."""

    def proxy(self, x: Vector, k: int) -> Vector:
        """The nearest free positions, m."""
        return np.clip(x, -0.001, 0.001)


class Active:
    """A spring of 300 N/m and a damper with the wrong sign, whose forces come ``ticks`` late."""

    def __init__(self, ports: tuple[str, ...], period: float, parameters: Mapping[str, Any]) -> None:
        """At rest."""
        length = 2 + int(parameters.get("ticks", 0))
        self._period, self._known = period, deque([np.zeros(len(ports))] * length, length)

    def react(self, x_e: Vector, k: int) -> Vector:
        """The forces on the hands, N."""
        self._known.append(x_e.copy())
        before, now = self._known[0], self._known[1]
        return np.clip(3.0 * (now - before) / self._period - 300.0 * now, -1e3, 1e3)
