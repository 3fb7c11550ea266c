"""The hand of a person who moves a simulated device by a pointer, or by a device without motors, and feels no force.

What the person moves gives a goal (:class:`GoalSource`): a browser's pointer (:class:`BrowserGoal`), or the deflection
of a SpaceMouse or a gamepad (:mod:`manyhands.nodes.device.rate_goal`). The goal is smoothed and becomes the intended
motion of a simulated hand: a spring and a damper join the device to it (:class:`PointerHand`). The coupling acts on
that hand as on every simulated device, and the work of the motion is in the ledger.

While no person holds the device, the hand is open: the device is a mass with its damping. A hand that opens forgets the
tension of its spring and the state of its operator. A hand that closes begins at rest on the device, its spring slack.
Either way the energy stored in the hand is lost or 0, so the hand is passive although its parameters change with time.
Its mass stays.

**The grasp** (:class:`Pointer`, pure) is what the browser's page sends: a position, and of a device that has an
orientation as a port, where it shall be turned (:mod:`manyhands.nodes.device.wrist`). A page may end without a message,
for example with its computer. So a grasp that is not sent again ends after :data:`PATIENCE`, in periods of the device's
time.

**The smoothed motion** (:class:`Follower`, pure) is one that a hand could make, bounded in reach, speed and
acceleration. A pointer moves in steps, a few dozen a second, and the motion that holds a device must not. Axis by axis,
with the way of one tick s(k) = r(k) - r(k-1) and the goal g clipped to the reach,

    s(k+1) = q^2 s(k) + (1 - q)^2 (g - r(k)),    r(k+1) = r(k) + s(k+1),    q = exp(-omega T),

is the critically damped follower: both its poles are q, whatever the period. Then |s(k+1) - s(k)| <= A T^2 is imposed,
and |s| <= S T.

**It does not overshoot.** Where (1 - q)(g - r) >= q s holds at one tick, it holds at the next, and g - r >= 0: without
bounds the difference of the two sides shrinks to q of itself, and a smaller s(k+1) makes it greater. The one bound that
makes s(k+1) greater is A, on braking. The law brakes by at most (1 - q) s there, so A never acts on it if
S <= A T/(1 - q), and S is taken no greater. From rest the condition holds on the way to every goal. With the reach in
place of g it holds whatever the goals were, as the law grows with g: so the motion never leaves the reach.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final, Protocol

from manyhands.nodes.device.simulated import Hand, Intention, Plant, bare_device_of, device_of
from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.kernel.bundle import SIMULATED, Common, Limits, SimulatedHand
from manyhands.nodes.kernel.orientation import UPRIGHT, Quaternion, unit
from manyhands.nodes.rows import figures as names
from manyhands.protocol.messages import Figures, Grasp, Release
from manyhands.protocol.transport.pointer import PointerInlet

PATIENCE: Final = 2.0
"""The time after which a grasp that is not sent again ends, s."""


class GoalSource(Protocol):
    """Where a person wants the device to be, m; asked once a period, and it never waits."""

    def tick(self) -> Floats | None:
        """Read what has come, and step by one tick; returns the goal, or None while no person holds the device.

        Raises:
            ValueError: the source is of no use any more; the message says what to do.
        """
        ...

    def buttons(self) -> int:
        """Which of the session's buttons of the device are held down, bit by bit."""
        ...

    def wanted_turn(self) -> Quaternion | None:
        """Where the person wants the device to be turned, after :meth:`tick`; None while nobody turns it."""
        ...

    def begin(self, position: Floats) -> Floats:
        """The hand has closed on the device at ``position``, m; returns the goal with which it begins, m."""
        ...

    def figures(self) -> Figures:
        """Whether the device is held, and counts of what has come."""
        ...

    def close(self) -> None:
        """Close its files and sockets. A second call does nothing."""
        ...


class Pointer:
    """The grasp of a person's hand, by the messages of the pointer.

    Attributes:
        goal: where the person wants the device to be, m; None while no person holds it.
        turn: where the person wants it to be turned; None while nobody turns it.
    """

    def __init__(self, axes: int, within: Callable[[Sequence[float]], Floats], T: float, turns: bool = False) -> None:
        """No grasp yet.

        Args:
            axes: number of axes of the device.
            within: returns the point of the device's reach, m, that is nearest to a given point, m.
            T: period, s.
            turns: whether the device has an orientation, so that four numbers may stand behind those of its axes.
        """
        self._axes, self._within, self._turns = axes, within, turns
        self._most_ticks = max(1, round(PATIENCE / T))
        self._ticks = 0  # since the last message of the grasp
        self.goal: Floats | None = None
        self.turn: Quaternion | None = None
        self._grasps = self._clipped = self._refused = self._lapsed = 0

    def tick(self, received: Grasp | Release | None) -> None:
        """Step by one tick; ``received`` is the latest message since the tick before, None for none.

        A grasp with the wrong number of axes, a number that is not finite, or an orientation that is none, is counted,
        and changes nothing.
        """
        match received:
            case Grasp(position):
                self._grasp(position.tolist())
            case Release():
                self.goal = self.turn = None
            case None:
                pass
        if self.goal is None:
            return
        self._ticks += 1
        if self._ticks > self._most_ticks:
            self.goal = self.turn = None
            self._lapsed += 1

    def _grasp(self, numbers: Floats) -> None:
        position, behind = numbers[: self._axes], numbers[self._axes :]
        turn = unit(behind) if self._turns and len(behind) == len(UPRIGHT) else None
        if len(position) != self._axes or not all(map(math.isfinite, position)) or (behind and turn is None):
            self._refused += 1
            return
        goal = self._within(position)
        if goal != position:
            self._clipped += 1
        self.goal, self.turn, self._ticks = goal, turn, 0
        self._grasps += 1

    def figures(self, malformed: int) -> Figures:
        """Whether the device is held, and counts of grasps; ``malformed`` counts datagrams that were no message."""
        return Figures(
            {
                names.GRASPED: 0.0 if self.goal is None else 1.0,
                names.GRASPS: float(self._grasps),
                names.GRASPS_CLIPPED: float(self._clipped),
                names.GRASPS_REFUSED: float(self._refused + malformed),
                names.GRASPS_LAPSED: float(self._lapsed),
            }
        )


class BrowserGoal:
    """The :class:`GoalSource` that a browser's page moves."""

    def __init__(self, pointer: Pointer, inlet: PointerInlet | None) -> None:
        """Hold nothing.

        Args:
            pointer: the grasp.
            inlet: receives the pointer's messages, and is closed with the source; None where no pointer can connect.
        """
        self._pointer, self._inlet = pointer, inlet

    def buttons(self) -> int:
        """None: a page has no buttons of a device."""
        return 0

    def tick(self) -> Floats | None:
        """Read the pointer's messages."""
        if self._inlet is not None:
            self._pointer.tick(self._inlet.latest())
        return self._pointer.goal

    def wanted_turn(self) -> Quaternion | None:
        """The orientation of the pointer's grasp."""
        return self._pointer.turn

    def begin(self, position: Floats) -> Floats:
        """The goal of the pointer, wherever the device is."""
        return position if self._pointer.goal is None else self._pointer.goal

    def figures(self) -> Figures:
        """Whether the device is held, and counts of the pointer's messages."""
        return self._pointer.figures(0 if self._inlet is None else self._inlet.malformed)

    def close(self) -> None:
        """Close the pointer's socket. A second call does nothing."""
        if self._inlet is not None:
            self._inlet.close()


class Follower:
    """The critically damped follower of a goal on m axes, one step a tick.

    Attributes:
        position: r, m; beyond the reach only where it began there.
        reach: of each axis, in either direction, m.
        speed: S of each axis, m/s; no greater than A T/(1 - q).
    """

    def __init__(self, reach: Sequence[float], speed: Sequence[float], acceleration: float, rate: float, T: float):
        """Be at rest in 0.

        Args:
            reach: of each axis, in either direction, m.
            speed: the greatest speed of each axis, m/s.
            acceleration: A, the greatest of any axis, m/s^2.
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
        """Move for one tick towards ``goal`` (m), or the point of the reach nearest to it; returns r', m/s."""
        ways: Floats = []
        for at, before, wanted, most in zip(self.position, self._way, self.within(goal), self._most, strict=True):
            way = self._carried * before + self._drawn * (wanted - at)
            way = min(max(way, before - self._change), before + self._change)
            ways.append(min(max(way, -most), most))
        self.position = [at + way for at, way in zip(self.position, ways, strict=True)]
        self._way = ways
        return [way / self._T for way in ways]


REACH: Final = 0.8
"""Part of the device's limit of displacement to which the pointer draws it; the rest is for the others' forces."""

SPEED: Final = 0.5
"""The greatest speed of the pointer's motion, m/s, and also as part of the device's limit of speed; likewise."""

ACCELERATION: Final = 20.0
"""The greatest acceleration of the pointer's motion, m/s^2."""

RATE: Final = 30.0
"""omega of the follower, rad/s: it is some 0.1 s behind a hand that moves steadily."""


class PointerHand(Hand):
    """The hand of a person, who may hold a simulated device by a source of goals; open at first."""

    def __init__(
        self, held: Plant, bare: Plant, limits: Limits, T: float, source: Callable[[Follower], GoalSource]
    ) -> None:
        """Hold nothing.

        Args:
            held: the device with the hand that joins it to the goal.
            bare: the device with the open hand.
            limits: the limits of the device.
            T: period, s.
            source: makes the source of goals, which the hand closes, for the follower of them.
        """
        self._held, self._bare = held, bare
        self.plant = bare
        m = self._m = bare.axes
        speed = [min(SPEED, SPEED * limit) for limit in limits.speed]
        self._follower = Follower([REACH * most for most in limits.displacement], speed, ACCELERATION, RATE, T)
        self._source = source(self._follower)
        self._goal: Floats | None = None
        self._prepared = False
        self._zero: Floats = [0.0] * m
        self._at_rest = Intention(self._zero, self._zero)

    def figures(self) -> Figures:
        """Whether the device is held, and counts of what moves it."""
        return self._source.figures()

    def buttons(self) -> int:
        """The buttons that are held down at the source, bit by bit."""
        return self._source.buttons()

    def wanted_turn(self) -> Quaternion | None:
        """Where the source wants the device to be turned."""
        return self._source.wanted_turn()

    def close(self) -> None:
        """Close the source. A second call does nothing."""
        self._source.close()

    def prepare(self, tick: int) -> None:
        """Read what has come from the source."""
        if not self._prepared:
            self._prepared = True
            self._goal = self._source.tick()

    def intend(self, tick: int, state: Floats) -> tuple[Floats, Intention]:
        """Open or close the hand, and follow the goal while it is closed."""
        self.prepare(tick)
        self._prepared = False
        goal = self._goal
        if goal is None:
            return self._become(self._bare, state), self._at_rest
        if self.plant is not self._held:
            state = self._become(self._held, state)
            self._follower.begin(state[: self._m])
            goal = self._source.begin(state[: self._m])
        return state, Intention(self._zero, self._follower.step(goal))

    def _become(self, plant: Plant, state: Floats) -> Floats:
        """Open or close the hand: position and velocity of the device stay, and the state of the hand begins at 0."""
        if self.plant is plant:
            return state
        m, self.plant = self._m, plant
        return plant.holding(state[:m], state[m : 2 * m])


def pointer_hand(
    hand: SimulatedHand, limits: Limits, T: float, source: Callable[[Follower], GoalSource], parts: bool = False
) -> PointerHand:
    """The hand of a person on the device that a bundle describes.

    Args:
        hand: the device, and the hand that joins it to the goal.
        limits: the limits of the device.
        T: period, s.
        source: see :class:`PointerHand`.
        parts: whether the plants step over parts of a period, for a driver in wall time.

    Raises:
        ValueError: a mass of the device is not positive, or the source cannot be made.
    """
    return PointerHand(Plant(device_of(hand), T, parts), Plant(bare_device_of(hand), T, parts), limits, T, source)


def browser_goal(T: float, inlet: PointerInlet | None, turns: bool = False) -> Callable[[Follower], GoalSource]:
    """Makes the source of goals of a browser's pointer, which ``turns`` the device as well where that can be.

    Without an inlet nobody ever holds the device.
    """
    return lambda follower: BrowserGoal(Pointer(len(follower.reach), follower.within, T, turns), inlet)


def pointer_of(common: Common) -> PointerInlet | None:
    """The inlet of the device's pointer; None under the simulated clock, and without a session's directory.

    Raises:
        TransportError: its socket cannot be opened.
    """
    if common.clock == SIMULATED or not common.directory:
        return None
    return PointerInlet(Path(common.directory), common.name)
