"""What lateness may put into the loop through one device (:class:`LatenessAllowance`).

The interface of a device keeps its account e(k) >= -(E_0 + P t) (docs/decisions/0030-lateness-in-joules.md). E_0 is for
the single late tick. P is for a machine that is late now and then: a mean power so small that a hand does not feel it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class LatenessAllowance:
    """The energy and the power that lateness may put in.

    Attributes:
        energy: E_0, J.
        power: P, W.

    Raises:
        ValueError: a number is negative or not finite.
    """

    energy: float
    power: float = 0.0

    def __post_init__(self) -> None:
        for what, found, unit in (("tank", self.energy, "J"), ("power", self.power, "W")):
            if not 0.0 <= found < math.inf:
                raise ValueError(f"found a {what} of {found} {unit}; expected a finite number, at least 0")

    def __str__(self) -> str:
        """As ``5 mJ``, or ``5 mJ and 1 mW``."""
        return f"{1e3 * self.energy:g} mJ" + (f" and {1e3 * self.power:g} mW" if self.power else "")

    def by(self, t: float) -> float:
        """E_0 + P t, J: what may have been put in by the time t, s."""
        return self.energy + self.power * max(0.0, t)
