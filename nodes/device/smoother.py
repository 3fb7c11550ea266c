"""From where a pointer is to a motion that a hand could make: bounded in reach, speed and acceleration. Pure.

A pointer comes in steps, a few dozen a second; what holds a device must not. Axis by axis, with the way of one tick
s(k) = r(k) - r(k-1) and the goal g clipped to the reach,

    s(k+1) = q^2 s(k) + (1 - q)^2 (g - r(k)),    r(k+1) = r(k) + s(k+1),    q = exp(-omega T),

is the critically damped follower: both its poles are q, whatever the period. Then |s(k+1) - s(k)| <= A T^2 is imposed,
and |s| <= S T.

**It does not overshoot.** Where (1 - q)(g - r) >= q s at one tick, the follower has it at the next, and g - r >= 0:
without bounds the difference shrinks to q of itself, and whatever makes s(k+1) smaller makes it greater. The one
bound that makes s(k+1) greater is A, on braking; the law brakes by at most (1 - q) s there, so that A never acts on it
if S <= A T/(1 - q), and S is taken no greater. From rest that holds on the way to every goal. It holds for the reach in
place of g whatever the goals were, as the law grows with g: so the reach is never left.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from manyhands.nodes.linear_map import Floats


class Follower:
    """Follows a goal on m axes, a step a tick.

    Attributes:
        position: r, m; beyond its reach only where it was begun there.
        reach: of each axis, either way, m.
        speed: S, m/s, as it is kept to.
    """

    def __init__(self, reach: Sequence[float], speed: Sequence[float], acceleration: float, rate: float, T: float):
        """Be at rest in 0.

        Args:
            reach: of each axis, m.
            speed: the most of each axis, m/s.
            acceleration: A, the most of any axis, m/s^2.
            rate: omega, rad/s.
            T: period, s.
        """
        q = math.exp(-rate * T)
        self._carried, self._drawn = q * q, (1.0 - q) ** 2
        self._T = T
        self._change = acceleration * T * T
        self.reach = tuple(reach)
        self.speed = tuple(min(most, acceleration * T / (1.0 - q)) for most in speed)
        self._most = [most * T for most in self.speed]
        self.begin([0.0] * len(self.reach))

    def begin(self, position: Floats) -> None:
        """Be at rest at ``position``, m."""
        self.position = position.copy()
        self._way: Floats = [0.0] * len(position)

    def within(self, goal: Sequence[float]) -> Floats:
        """The point of the reach that is nearest to ``goal``, m."""
        return [min(max(at, -most), most) for at, most in zip(goal, self.reach, strict=True)]

    def step(self, goal: Sequence[float]) -> Floats:
        """Go on for a tick towards ``goal`` (m), or the point of the reach that is nearest to it; returns r', m/s."""
        ways: Floats = []
        for at, before, wanted, most in zip(self.position, self._way, self.within(goal), self._most, strict=True):
            way = self._carried * before + self._drawn * (wanted - at)
            way = min(max(way, before - self._change), before + self._change)
            ways.append(min(max(way, -most), most))
        self.position = [at + way for at, way in zip(self.position, ways, strict=True)]
        self._way = ways
        return [way / self._T for way in ways]
