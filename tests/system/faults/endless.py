"""A model of the environment whose step, from some tick on, never returns."""

from __future__ import annotations

import signal
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray


class Endless:
    """A spring at every port; from the tick ``lasts`` on its answer never comes."""

    def __init__(self, ports: tuple[str, ...], period: float, parameters: Mapping[str, float]) -> None:
        self.stiffness, self.lasts = parameters["stiffness"], parameters["lasts"]

    def react(self, x_e: NDArray[np.float64], k: int) -> NDArray[np.float64]:
        while k >= self.lasts:
            signal.pause()  # no signal that it survives changes anything
        return -self.stiffness * x_e
