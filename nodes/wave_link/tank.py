"""The tank of one face of a wave link: its energy, and the two rules on which passivity rests.

With L the energy in the tank, G what this face has shipped, and T the period, a tick does

    L += (newest G heard) - (the G heard before) - T/2 |c|^2 + T/2 |a|^2 + T w^T theta w - s,    G += s,

and the rules are |c|^2 <= 2 L/T, where L includes what was heard in this tick, and 0 <= s <= L. So L >= 0 for ever.
Everything else is free: which wave c is played, and when energy s is shipped.

**Rounding never makes energy.** The numbers are floats, and the rules hold for what these floats are as exact
rationals. What a wave costs is rounded up, what is earned or heard is rounded down, and so is L after each step. G
grows by no more than what leaves L. So, exactly and after any number of ticks,

    L + (the sum of all s) + (the sum of all T/2 |c|^2)  <=  E_0 + (all that was heard) + (all that was earned),

and L >= 0 (docs/remote/proof.md has the proof). What rounding loses is some 1e-15 of the energy that
passes. No method raises, whatever finite or infinite numbers or NaN it is given.
"""

from __future__ import annotations

import math
import sys
from typing import Final

from manyhands.nodes.kernel.arithmetic import Floats, dot

FULL: Final = 2.0**50
"""The energy beyond which a tank, and G, take in no more, J; what comes beyond is lost."""

_INSIDE: Final = 1e-9  # part by which a limited wave stays inside its limit, a million times the rounding
_ULP: Final = sys.float_info.epsilon
_TINY: Final = sys.float_info.min  # beyond all that is lost where products underflow, J


class Tank:
    """L and the sums of one face.

    Attributes:
        level: L, J; never below 0.
        shipped: G of this life, J; it never falls.
        heard: the newest G of the other face in this life, J.
        clipped: ticks in which the incoming wave was limited by L.
        cost: what was paid last, J.
    """

    __slots__ = ("_half_T", "clipped", "cost", "heard", "level", "shipped")

    def __init__(self, T: float, E_0: float) -> None:
        """Start a link.

        Args:
            T: this face's period, s.
            E_0: L at the start, J; 0 for a face whose predecessor has died, for its energy is lost.
        """
        self._half_T = 0.5 * T
        self.level = E_0
        self.shipped = self.heard = self.cost = 0.0
        self.clipped = 0

    def row(self) -> Floats:
        """L, G and the G heard, J: the tank's row in telemetry."""
        return [self.level, self.shipped, self.heard]

    def renew(self) -> None:
        """Start a new life with the energy that is in the tank; what is in transit is lost, on both ways."""
        self.shipped = self.heard = 0.0

    def receive(self, G: float) -> None:
        """Take in the energy of a newer message; a ``G`` that has fallen, or is not finite, changes nothing."""
        if self.heard <= G < math.inf:
            self._gain(_sum_below(G, -self.heard))
            self.heard = G

    def pay(self, c: Floats) -> Floats:
        """Pay for the wave c(k), and return it; where L does not suffice, the longest wave in its direction that L
        pays for. For a wave that is not finite that is none.
        """
        cost = self._cost(c)
        if not cost <= self.level:
            self.clipped += 1
            c = self._affordable(c)
            cost = self._cost(c)
            if not cost <= self.level:  # no wave so short has a cost that a float could hold
                c, cost = [0.0] * len(c), 0.0
        self.cost = cost
        self.level = _sum_below(self.level, -cost)
        return c

    def earn(self, a: Floats, harvest: float) -> float:
        """Take in the energy of the outgoing wave a(k) and the harvest T w^T theta w, J; returns the former, J."""
        square = dot(a, a)
        energy = self._half_T * min(square, FULL / self._half_T) if square > 0.0 else 0.0
        energy = max(0.0, energy * (1.0 - (len(a) + 4) * _ULP) - _TINY)
        self._gain(energy)
        if 0.0 < harvest < math.inf:
            self._gain(harvest)
        return energy

    def ship(self, s: float) -> None:
        """Move the energy ``s`` from the tank into G: all of L where ``s`` is more, and none where it is below 0.

        G grows by no more than what leaves L, exactly.
        """
        if not s > 0.0:
            return
        s = min(s, self.level)
        shipped = _sum_below(self.shipped, s)  # so that G gains s at most
        if shipped <= FULL:
            self.level = _sum_below(self.level, -_sum_above(shipped, -self.shipped))
            self.shipped = shipped

    def _cost(self, c: Floats) -> float:
        """T/2 |c|^2, J, not below it: each of m products and m sums is off by half an ulp at most."""
        energy = self._half_T * dot(c, c)
        if energy == 0.0 and not any(c):
            return 0.0
        return energy * (1.0 + (len(c) + 4) * _ULP) + _TINY

    def _affordable(self, c: Floats) -> Floats:
        """The longest wave in the direction of c that L pays for; zeros for a c that is not finite."""
        size = max(map(abs, c))
        if not all(map(math.isfinite, c)) or not size > 0.0:
            return [0.0] * len(c)
        unit = [along / size for along in c]  # its squares neither overflow nor all underflow
        length = (1.0 - _INSIDE) * math.sqrt(self.level / (self._half_T * dot(unit, unit)))
        return [length * along for along in unit]

    def _gain(self, energy: float) -> None:
        """Add ``energy`` >= 0 to L, rounded down, up to a full tank."""
        self.level = min(FULL, _sum_below(self.level, energy))


def _sum_below(a: float, b: float) -> float:
    """The greatest float or the one before it that is at most a + b, for finite numbers whose sum does not overflow.

    The error of a sum is a float itself, and six operations find it exactly (theorem 7 of [Shewchuk1997]_).
    """
    total = a + b
    part = total - a
    error = (a - (total - part)) + (b - part)
    return total if error >= 0.0 else math.nextafter(total, -math.inf)


def _sum_above(a: float, b: float) -> float:
    """The least float or the one after it that is at least a + b; as :func:`_sum_below`."""
    return -_sum_below(-a, -b)
