"""The wrist of a person who turns a simulated device by a pointer, and feels no torque.

What the person moves gives an orientation as a goal. It is smoothed, and a spring and a damper join the device to what
was smoothed: with R the device's orientation, G(k) the smoothed one and Omega(k) how fast that turns, the hand's torque
is

    t(R, G) + b_h (Omega - omega),      t the chordal spring of :mod:`manyhands.nodes.kernel.orientation`,

with k_h and b_h of the hand alone. The device's own spring, its account and its certificate are not concerned: a
certificate assumes nothing of a hand. Where no goal is there, the wrist is loose. A wrist that closes begins at rest at
the device's orientation, its spring slack.

**The smoothed turn** (:class:`TurnFollower`) is the follower of :mod:`manyhands.nodes.device.pointer` on SO(3): with
the way s(k) of one tick, a rotation vector, and e(k) that of the shortest turn to the goal,

    s(k+1) = q^2 s(k) + (1 - q)^2 e(k),    G(k+1) = exp(s(k+1)) G(k),    q = exp(-omega T).

Then |s(k+1) - s(k)| <= A T^2 is imposed, and |s| <= S T. A goal that is half a turn away has two shortest turns, of
which one is taken.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

from manyhands.nodes.kernel.orientation import Quaternion, Vector3, difference, torque, turned_by

SPEED: Final = 6.0
"""The greatest speed of a pointer's turn, rad/s, and half of the device's limit of speed; the lesser one counts."""

ACCELERATION: Final = 240.0
"""The greatest change of that speed, rad/s^2."""

RATE: Final = 30.0
"""omega of the follower, rad/s, as that of a pointer's motion."""

STRENGTH: Final = 2.0
"""k_h in a radian of the device's greatest torque, so that a wrist that is 30 degrees off exerts as much."""

_NO_TORQUE: Final[Vector3] = (0.0, 0.0, 0.0)


class TurnFollower:
    """The critically damped follower of an orientation, one step a tick.

    Attributes:
        at: G.
    """

    def __init__(self, speed: float, T: float) -> None:
        """Be at rest, upright.

        Args:
            speed: the greatest, rad/s.
            T: period, s.
        """
        q = math.exp(-RATE * T)
        self._carried, self._drawn, self._T = q * q, (1.0 - q) ** 2, T
        self._change = ACCELERATION * T * T
        self._most = min(speed, ACCELERATION * T / (1.0 - q)) * T
        self.begin(Quaternion())

    def begin(self, at: Quaternion) -> None:
        """Be at rest at an orientation."""
        self.at, self._way = at, _NO_TORQUE

    def step(self, goal: Quaternion) -> Vector3:
        """Turn for one tick towards ``goal``; returns Omega, rad/s."""
        wanted = [self._carried * s + self._drawn * e for s, e in zip(self._way, vector_to(self.at, goal), strict=True)]
        change = _within([new - old for new, old in zip(wanted, self._way, strict=True)], self._change)
        self._way = _within([old + by for old, by in zip(self._way, change, strict=True)], self._most)
        self.at = turned_by(self.at, self._way)
        x, y, z = self._way
        return (x / self._T, y / self._T, z / self._T)


class Wrist:
    """A person's wrist, which may hold a device by an orientation; loose at first."""

    def __init__(
        self, goal: Callable[[], Quaternion | None], inertia: float, most: float, speed: float, T: float
    ) -> None:
        """Hold nothing.

        Args:
            goal: where the person wants the device to be turned; None while no person turns it.
            inertia: of the device with the hand, kg*m^2.
            most: the greatest torque of the device, N*m.
            speed: its greatest speed, rad/s.
            T: period, s.
        """
        self._goal = goal
        # its torque is held for a period: a spring beyond J/T^2 would turn the body past its goal within one
        self.stiffness = min(STRENGTH * most, inertia / (T * T))
        self.damping = 2.0 * math.sqrt(self.stiffness * inertia)
        self._follower = TurnFollower(min(SPEED, 0.5 * speed), T)
        self._holds = False

    def begin(self, R: Quaternion) -> tuple[Vector3, float]:
        """Begin a period, with the device at R: the hand's torque over it, N*m, and its damping, N*m*s/rad."""
        goal = self._goal()
        if goal is None:
            self._holds = False
            return _NO_TORQUE, 0.0
        if not self._holds:
            self._holds = True
            self._follower.begin(R)
        rate = self._follower.step(goal)
        t = torque(self.stiffness, R, self._follower.at)
        x, y, z = (own + self.damping * fast for own, fast in zip(t, rate, strict=True))
        return (x, y, z), self.damping


def vector_to(at: Quaternion, goal: Quaternion) -> Vector3:
    """The rotation vector of the shortest turn from one orientation to the other, in the world's axes, rad."""
    w, x, y, z = difference(goal, at)
    size = math.sqrt(x * x + y * y + z * z)
    if size == 0.0:
        return _NO_TORQUE
    scale = math.copysign(2.0 * math.atan2(size, abs(w)) / size, w)
    return (scale * x, scale * y, scale * z)


def _within(vector: list[float], most: float) -> Vector3:
    """The vector, shortened to the length ``most`` where it is longer."""
    x, y, z = vector
    size = math.sqrt(x * x + y * y + z * z)
    scale = most / size if size > most else 1.0
    return (scale * x, scale * y, scale * z)
