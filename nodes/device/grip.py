"""Whether a person holds a device, and where to: what was said at its grip, tick by tick. Pure.

A page may go without a word, with the computer it is shown on: a grasp that is not said again is over after
:data:`PATIENCE`, in ticks of the device's own time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Final

from manyhands.nodes import telemetry as names
from manyhands.nodes.linear_map import Floats
from manyhands.protocol.messages import Grasp, Release

PATIENCE: Final = 2.0
"""s, after which a grasp of which nothing more is heard is over."""


class Grip:
    """What is known of a person's hand.

    Attributes:
        goal: where it wants the device to be, m; None while it does not hold it.
    """

    def __init__(self, axes: int, within: Callable[[Sequence[float]], Floats], T: float) -> None:
        """Held by nobody.

        Args:
            axes: of the device.
            within: the point of the device's reach that is nearest to another.
            T: period, s.
        """
        self._axes, self._within = axes, within
        self._most_ticks = max(1, round(PATIENCE / T))
        self._ticks = 0  # since the last grasp was said
        self.goal: Floats | None = None
        self._said = self._clipped = self._refused = self._lapsed = 0

    def tick(self, said: Grasp | Release | None) -> None:
        """A tick, and what was said last since the one before; what makes no sense is counted, and changes nothing."""
        match said:
            case Grasp(position):
                self._grasp(position.tolist())
            case Release():
                self.goal = None
            case None:
                pass
        if self.goal is None:
            return
        self._ticks += 1
        if self._ticks > self._most_ticks:
            self.goal = None
            self._lapsed += 1

    def _grasp(self, position: Floats) -> None:
        if len(position) != self._axes or not all(map(math.isfinite, position)):
            self._refused += 1
            return
        goal = self._within(position)
        if goal != position:
            self._clipped += 1
        self.goal, self._ticks = goal, 0
        self._said += 1

    def figures(self, malformed: int) -> Mapping[str, float]:
        """Whether it is held, and what was said; ``malformed``: datagrams that were nothing of a grip's."""
        return {
            names.GRASPED: 0.0 if self.goal is None else 1.0,
            names.GRASPS: float(self._said),
            names.GRASPS_CLIPPED: float(self._clipped),
            names.GRASPS_REFUSED: float(self._refused + malformed),
            names.GRASPS_LAPSED: float(self._lapsed),
        }
