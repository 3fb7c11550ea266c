"""What is stated of a device's mass and of its hand (:class:`Inertia`)."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Inertia:
    """What is stated of a device and its hand; one number for each axis.

    Attributes:
        mass: m, the least moving mass, kg.
        hand: F_h, the greatest force that speeds the device up apart from its own, N.
        step: the step of its encoder at the axis, m; 0 for displacements that are exact.

    Raises:
        ValueError: the numbers are not one for each axis, or out of their range.
    """

    mass: tuple[float, ...]
    hand: tuple[float, ...]
    step: tuple[float, ...]

    def __post_init__(self) -> None:
        if not len(self.mass) == len(self.hand) == len(self.step):
            raise ValueError(
                f"found {len(self.mass)} masses, {len(self.hand)} forces and {len(self.step)} steps; expected one an "
                "axis"
            )
        for what, values, least in (("mass", self.mass, 1e-6), ("hand", self.hand, 0.0), ("step", self.step, 0.0)):
            if not all(least <= value < math.inf for value in values):
                raise ValueError(f"{what}: found {values!r:.60}; expected finite numbers, at least {least:g}")
