"""A tank of a wave link with its account in whole numbers beside it: exact, whatever the magnitudes.

A float is a whole multiple of 2^-1074, so T/2 c^2 is one of 2^-3222. All sums here are Python integers in that unit.
"""

from __future__ import annotations

import math
from typing import Final

from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.wave_link.tank import Tank

_BITS: Final = 1074
"""Of a float: every finite one is a multiple of 2^-1074."""


def whole(x: float) -> int:
    """x in units of 2^-1074."""
    numerator, denominator = x.as_integer_ratio()
    return (numerator << _BITS) // denominator


def joules(x: float) -> int:
    """x, J, in units of 2^-3222."""
    return whole(x) << (2 * _BITS)


class ExactTank(Tank):
    """A tank that checks after each of its steps that no rounding made energy.

    Attributes:
        left: E_0, all that was heard and all that was earned, less all that was shipped and paid, units of 2^-3222 J.
        least: the least L so far, J.
    """

    def __init__(self, T: float, E_0: float) -> None:
        super().__init__(T, E_0)
        self.left = joules(E_0)
        self.least = E_0
        self._T = whole(0.5 * T)

    def receive(self, G: float) -> None:
        before = self.heard
        super().receive(G)
        self._book(joules(self.heard) - joules(before))

    def pay(self, c: Floats) -> Floats:
        paid = super().pay(c)
        self._book(-self._energy(paid))
        return paid

    def earn(self, a: Floats, harvest: float) -> float:
        energy = super().earn(a, harvest)
        # an outgoing wave that is no number is none that anybody can play
        earned = self._energy(a) if all(map(math.isfinite, a)) else joules(energy)
        self._book(earned + joules(harvest if 0.0 < harvest < math.inf else 0.0))
        return energy

    def ship(self, s: float) -> None:
        before = self.shipped
        super().ship(s)
        assert self.shipped >= before
        self._book(joules(before) - joules(self.shipped))

    def _energy(self, wave: Floats) -> int:
        """T/2 |wave|^2, units of 2^-3222 J."""
        return self._T * sum(whole(one) ** 2 for one in wave)

    def _book(self, energy: int) -> None:
        self.left += energy
        level = self.level
        assert level >= 0.0, f"L = {level}"
        assert joules(level) <= self.left, f"L = {level} J is more than came and did not go"
        self.least = min(self.least, level)
