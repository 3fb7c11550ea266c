"""Clipping a force to its limits, port by port: at the coupling, and again at the device, last before its actuator.

A clipped force is not the one that the certificate is about. Both places count the ticks, so that it is told.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from manyhands.nodes.linear_map import Floats


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

    def clip(self, f: Floats) -> Floats:
        """``f`` (N) itself where it is within the limits, otherwise a new list that is; what is no number becomes 0."""
        for force, limit in zip(f, self._limits, strict=True):
            if not -limit <= force <= limit:
                break
        else:
            return f
        self.ticks += 1
        return [
            0.0 if math.isnan(force) else max(-limit, min(limit, force))
            for force, limit in zip(f, self._limits, strict=True)
        ]
