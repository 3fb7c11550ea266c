"""The browser driver: a simulated device that a person with a browser holds and drags. No haptic loop: nothing is felt.

The person gives a trajectory, as the intended motion of a simulated hand: a spring and a damper between the device and
the pointer, which is smoothed (:mod:`manyhands.nodes.device.pointer`). What the coupling does to that hand is that of
every simulated device, and the work that the motion does is in the ledger.

Held by nobody the hand is open: the device is a mass with its damping. An opening hand forgets its spring's tension and
its operator's state, and a closing one begins at rest on the device, its spring slack. So either way the energy that is
stored in it is lost or 0, and the hand, whose parameters change with time, is passive all the same. Its mass stays.

Whether a person holds a device, and where to: what was said at its pointer, tick by tick. Pure.

A page may go without a word, with the computer it is shown on: a grasp that is not said again is over after
:data:`PATIENCE`, in ticks of the device's own time.

From where a pointer is to a motion that a hand could make: bounded in reach, speed and acceleration. Pure.

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
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final

from manyhands.nodes import telemetry as names
from manyhands.nodes.arithmetic import Floats
from manyhands.nodes.bundle import SIMULATED, Common, Limits, SimulatedHand
from manyhands.nodes.device.simulated import Intention, Plant, PlantDriver, bare_device_of, device_of
from manyhands.protocol.messages import Grasp, Release
from manyhands.protocol.transport.pointer import PointerInlet

PATIENCE: Final = 2.0
"""s, after which a grasp of which nothing more is heard is over."""


class Pointer:
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
        """Whether it is held, and what was said; ``malformed``: datagrams that were nothing of a pointer's."""
        return {
            names.GRASPED: 0.0 if self.goal is None else 1.0,
            names.GRASPS: float(self._said),
            names.GRASPS_CLIPPED: float(self._clipped),
            names.GRASPS_REFUSED: float(self._refused + malformed),
            names.GRASPS_LAPSED: float(self._lapsed),
        }


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


REACH: Final = 0.8
"""Of the device's limit of displacement: how far the pointer draws it; the rest is for what others do to it."""

SPEED: Final = 0.5
"""m/s, and also of the device's limit of speed: how fast the pointer draws it; likewise."""

ACCELERATION: Final = 20.0
"""m/s^2, the most."""

RATE: Final = 30.0
"""rad/s, of the follower: some 0.1 s behind a hand that moves steadily."""


class BrowserDriver(PlantDriver):
    """A :class:`manyhands.nodes.device.drivers.Driver` around a device that is held, or not."""

    def __init__(self, hand: SimulatedHand, limits: Limits, T: float, inlet: PointerInlet | None) -> None:
        """Start at rest in x = 0, held by nobody.

        Args:
            hand: the device, and the hand that holds it to the pointer.
            limits: the device's own.
            T: period, s.
            inlet: where a person's hand is heard, closed by the driver; None where nobody can be.

        Raises:
            ValueError: no device can be made of it.
        """
        self._inlet = inlet
        self._held, self._bare = Plant(device_of(hand), T), Plant(bare_device_of(hand), T)
        super().__init__(self._bare)
        speed = [min(SPEED, SPEED * limit) for limit in limits.speed]
        self._follower = Follower([REACH * most for most in limits.displacement], speed, ACCELERATION, RATE, T)
        self._pointer = Pointer(self.axes, self._follower.within, T)
        self._at_rest = Intention(self._zero, self._zero)

    def figures(self) -> Mapping[str, float]:
        """Whether it is held, and what was said at its pointer."""
        return self._pointer.figures(0 if self._inlet is None else self._inlet.malformed)

    def close(self) -> None:
        """Close the pointer. A second time does nothing."""
        if self._inlet is not None:
            self._inlet.close()

    def _intend(self, tick: int) -> Intention:
        if self._inlet is not None:
            self._pointer.tick(self._inlet.latest())
        goal = self._pointer.goal
        if goal is None:
            self._become(self._bare)
            return self._at_rest
        if self._plant is not self._held:
            self._become(self._held)
            self._follower.begin(self._state[: self._m])
        return Intention(self._zero, self._follower.step(goal))

    def _become(self, plant: Plant) -> None:
        """The hand opens, or closes: the device's motion goes on, and what the hand stored does not."""
        if self._plant is not plant:
            m = self._m
            self._plant, self._state = plant, plant.holding(self._state[:m], self._state[m : 2 * m])


def pointer_of(common: Common) -> PointerInlet | None:
    """Where the device of a bundle can be held; None under the simulated clock, and without a session's directory.

    Raises:
        TransportError: it cannot be opened.
    """
    if common.clock == SIMULATED or not common.directory:
        return None
    return PointerInlet(Path(common.directory), common.name)
