"""How far a device can move in a short time, by what is stated of its inertia (:class:`SpeedBound`).

A mechanism with a least mass m on an axis, in a hand that pushes with at most F_h, cannot jump. Under a force r its
speed grows by at most

    d|v|/dt  <=  a = (F_h + |r|)/m,

so that, from a speed of at most u on, it moves in the time h by at most

    d(h) = u h + a h^2 / 2.

What brakes it (friction, damping, a wall) is not bounded, and need not be. F_h is all that speeds it up apart from r:
the hand, a weight that is not balanced, what the damping of another axis adds.

The speed itself is not measured. It follows from displacements: over a time t with the mean speed d/t, and a at most,

    |v|  <=  max(a t, |d|/t + a t/2)        at its end.

For if v at the end is V > a t, it was at least V - a (t - s) > 0 at every s before, so that d/t >= V - a t/2. The bound
that grew from the last one, u + a t, holds as well; the lesser of the two is taken.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.kernel.inertia import Inertia

_ROUNDING: Final = 1.0 + 1e-9
_REST: Final = 1e-12
"""m; displacements are differences of positions in doubles."""


class SpeedBound:
    """The speed that each axis of one device may have at most, from what it was seen to do.

    Attributes:
        fastest: u, the bound at the instant of the last displacement, m/s.
        broken: the axis that has moved further than its inertia allows; None while none has.
    """

    __slots__ = ("_hand", "_mass", "_step", "broken", "fastest")

    def __init__(self, stated: Inertia) -> None:
        """Begin at an unknown speed."""
        self._mass, self._hand, self._step = stated.mass, stated.hand, stated.step
        self.fastest: Floats = [math.inf] * len(stated.mass)
        self.broken: int | None = None

    def grown(self, u: Floats, r: Floats, h: float) -> Floats:
        """The bound after the force r (N) has acted for h (s), m/s."""
        return [v + h * (hand + abs(f)) / m for v, hand, f, m in zip(u, self._hand, r, self._mass, strict=True)]

    def speeds(self, u: Floats, r: Floats, h: float) -> Floats:
        """The greatest mean speed of each axis over a time h (s) from a speed of u (m/s) on, under r (N)."""
        half = 0.5 * h
        return [v + half * (hand + abs(f)) / m for v, hand, f, m in zip(u, self._hand, r, self._mass, strict=True)]

    def work(self, u: Floats, r: Floats) -> tuple[float, float]:
        """The work of r (N) in a time h (s) from a speed of u (m/s) on is at most  rate h + growth h^2 / 2;  both."""
        rate = growth = 0.0
        for v, hand, f, m in zip(u, self._hand, r, self._mass, strict=True):
            size = abs(f)
            if size > 0.0:
                rate += size * v
                growth += size * (hand + size) / m
        return rate, growth

    def saw(self, d: Floats, parts: Sequence[tuple[Floats, float]]) -> None:
        """Take the displacement d (m) since the last one, while forces r (N) acted for h (s) each."""
        t = sum(h for _, h in parts)
        out = []
        for axis, (u, m, hand, step) in enumerate(zip(self.fastest, self._mass, self._hand, self._step, strict=True)):
            far, greatest = 0.0, 0.0
            for r, h in parts:
                a = (hand + abs(r[axis])) / m
                far += h * (u + 0.5 * a * h)
                u += a * h
                greatest = max(greatest, a)
            moved = abs(d[axis])
            if moved > far * _ROUNDING + step + _REST:
                self.broken = axis
            out.append(min(u, max(greatest * t, (moved + step + _REST) / t + 0.5 * greatest * t)))
        self.fastest = out
