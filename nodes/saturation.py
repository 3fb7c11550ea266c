"""Clipping a force to its limits, port by port: at the coupling, and again at the device, last before its actuator.

A clipped force is not the one that the certificate is about. Both places count the ticks, so that it is told.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]


class Saturation:
    """Limits of the force at a number of ports.

    Attributes:
        ticks: how often a force was clipped.
    """

    __slots__ = ("_limits", "ticks")

    def __init__(self, limits: Sequence[float]) -> None:
        """``limits``: greatest absolute force by port, N."""
        self._limits = tuple(limits)
        self.ticks = 0

    def clip(self, f: Vector) -> Vector:
        """``f`` (N) itself where it is within the limits, otherwise a new array that is; what is no number becomes 0.

        Compared as Python floats: for the few ports of a device or a block that takes less than numpy's calls, and no
        array is made where nothing is to be clipped.
        """
        forces = f.tolist()
        for force, limit in zip(forces, self._limits, strict=True):
            if not -limit <= force <= limit:
                break
        else:
            return f
        self.ticks += 1
        return np.array(
            [
                0.0 if math.isnan(force) else max(-limit, min(limit, force))
                for force, limit in zip(forces, self._limits, strict=True)
            ]
        )
