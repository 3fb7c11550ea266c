"""The energy that a party of the environment may put into the others (:class:`EnergyBudget`)."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class EnergyBudget:
    """The energy that a party may put into the others.

    Attributes:
        power: P, the power without an end, W.
        energy: E, the energy at once, J.
        store: the energy that it may give back uncharged of what it has received, however long ago, J.

    Raises:
        ValueError: an entry is not a finite number greater than 0.
    """

    power: float
    energy: float
    store: float

    def __post_init__(self) -> None:
        for found in (self.power, self.energy, self.store):
            if not 0.0 < found < math.inf:
                raise ValueError(f"found {found} in a budget; expected a finite number greater than 0")
