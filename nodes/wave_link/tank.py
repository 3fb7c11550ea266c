"""The energy account of one face of a wave link: its tank, and the two rules on which passivity rests.

With L the energy in the tank, G what this face has shipped, and T the period, a tick does

    L += (newest G heard) - (the G heard before) - T/2 |c|^2 + T/2 |a|^2 + T w^T theta w - s,    G += s,

and the rules are |c|^2 <= 2 L/T, where L includes what was heard in this tick, and 0 <= s <= L. So L >= 0 for ever.
Everything else is free: which wave c is played, and when energy s is shipped.
"""

from __future__ import annotations

import math
from typing import Final

from manyhands.nodes.arithmetic import Floats, dot

_INSIDE: Final = 1e-9  # part by which a limited wave stays inside its limit, a million times the rounding


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
        """Take in the energy of a newer message; ``G`` is not below the one heard before."""
        self.level += G - self.heard
        self.heard = G

    def pay(self, c: Floats) -> Floats:
        """Pay for the wave c(k), and return it; where L does not suffice, the longest wave in its direction that L
        pays for.
        """
        cost = self._half_T * dot(c, c)
        if cost <= self.level:
            self.cost = cost
            self.level -= cost
            return c
        self.clipped += 1
        part = (1.0 - _INSIDE) * math.sqrt(self.level / cost)
        c = [part * along for along in c]
        self.cost = cost = self._half_T * dot(c, c)
        self.level = max(0.0, self.level - cost)
        return c

    def earn(self, a: Floats, harvest: float) -> float:
        """Take in the energy of the outgoing wave a(k) and the harvest T w^T theta w, J; returns the former, J."""
        energy = self._half_T * dot(a, a)
        self.level += energy + harvest
        return energy

    def ship(self, s: float) -> None:
        """Move the energy s, 0 <= s <= L, from the tank into G.

        What leaves L is what G gains to the last bit, for rounding would otherwise add up over days.
        """
        shipped = self.shipped + s
        moved = shipped - self.shipped
        if moved > self.level:
            shipped = math.nextafter(shipped, 0.0)
            moved = shipped - self.shipped
        self.level -= moved
        self.shipped = shipped
