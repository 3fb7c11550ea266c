"""Simulated devices: a mass held by a hand, discretised exactly (:class:`Plant`), and drivers for it.

A :class:`HeldDeviceDriver` lives in wall time, as a real device does. An :class:`OwnTimeDriver` lives in its own time:
one call of its ``sample`` is one period, however long the tick took by the clock. So a run of it in real time has
exactly the numbers of the simulation (docs/decisions/0005).

A :class:`Hand` holds the device. That of an :class:`IntentHand` has an intention that is a function of time.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from manyhands.design.models.device import HeldDevice, exponential_less_identity, held_device
from manyhands.design.models.statespace import StateSpace
from manyhands.nodes.device.wall_time import WallTimeDriver
from manyhands.nodes.kernel.arithmetic import NARROW, Floats, Rows, dot, linear_map, minus, plus
from manyhands.nodes.kernel.bundle import SimulatedHand
from manyhands.nodes.kernel.intent import Intent, intent_from
from manyhands.nodes.kernel.orientation import Quaternion
from manyhands.protocol.clock import Duration, Instant, from_seconds, seconds
from manyhands.protocol.messages import Figures


class Intention(NamedTuple):
    """The hand's intended force (N) and velocity (m/s), one entry for each axis, both constant over one period."""

    force: Floats
    velocity: Floats


class Transitions:
    """The step of z' = A z + B u, u constant, over any whole number of nanoseconds, without an exponential.

    With M = [A B; 0 0] the step over t is a product of tabulated exp(M d b^j ns), d the digits of t to the base b. Each
    of them is computed as Q(t) = exp(M t) - I, by

        Q(s + t) = Q(s) + Q(t) + Q(s) Q(t),

    from a series at the start: exp(M t) itself differs too little from I at one nanosecond to hold M in its digits.
    """

    def __init__(self, system: StateSpace, longest: Duration) -> None:
        """Tabulate the steps of ``system`` up to ``longest``, ns."""
        n = system.order
        M = np.vstack([np.hstack([system.A, system.B]), np.zeros((system.inputs, n + system.inputs))])
        self._narrow = n * len(M) <= NARROW
        bits = _BITS if n * len(M) <= _MOST_ENTRIES else _FEW_BITS
        self._mask = 2**bits - 1
        # the last digit first; its matrices, n x len(M), as lists where these beat numpy, and as an array
        self._tables: list[tuple[int, list[Rows], Any]] = []
        unit = exponential_less_identity(M * seconds(Duration(1)))  # for the nanoseconds of the present digit
        for shift in range(0, longest.bit_length(), bits):
            most = min(longest >> shift, self._mask)
            table = np.zeros((1, *M.shape))
            while len(table) <= most:
                table = np.concatenate([table, unit + table + unit @ table])
                unit = 2.0 * unit + unit @ unit
            steps = table[: most + 1, :n] + np.eye(n, len(M))
            self._tables.insert(0, (shift, steps.tolist() if self._narrow else [], steps))

    def step(self, state: Floats, inputs: Floats, duration: int, rows: int | None = None) -> Floats:
        """The state after ``duration``, ns, at most the longest, under constant inputs.

        ``rows`` is the number of its first entries that are wanted; None for all.
        """
        wanted = len(state) if rows is None else rows
        for shift, lists, arrays in self._tables:
            if digit := duration >> shift & self._mask:
                z = state + inputs
                if self._narrow:
                    step = lists[digit]
                    state = [dot(step[row], z) for row in range(wanted if shift == 0 else len(step))]
                else:
                    state = (arrays[digit][: wanted if shift == 0 else None] @ z).tolist()
        return state[:wanted]


_BITS: Final = 10
"""Bits of a digit: a period of 1 ms has two digits, and 2,000 matrices."""

_MOST_ENTRIES: Final = 512
"""Entries of a matrix up to which there are so many of them; at 8 bytes an entry they take 8 MB."""

_FEW_BITS: Final = 5
"""Bits of a digit for greater matrices: a period of 1 ms has four digits, and 123 matrices."""


class Plant:
    """A :class:`HeldDevice` and the steps of its state under constant inputs. It keeps no state of its own.

    Attributes:
        divides: whether two parts of a step may lead elsewhere than the whole.
    """

    def __init__(self, device: HeldDevice, T: float, parts: bool = False) -> None:
        """Sample ``device`` with the period ``T``, s.

        Args:
            device: the device with its hand.
            T: period, s.
            parts: whether it also steps over parts of a period; its period then is a whole number of nanoseconds.
        """
        self._period = from_seconds(T)
        self._T = seconds(self._period) if parts else T
        sampled = device.sampled(self._T)
        self.axes, self.order = device.axes, sampled.order
        self.divides = False
        self._step = linear_map(np.hstack([sampled.A, sampled.B]))  # over (state, force, intended velocity)
        self._parts = Transitions(device.continuous(), self._period) if parts else None
        self._damping: Floats = device.damping.tolist()
        self._mass: Floats = device.mass.tolist()

    def holding(self, x: Floats, v: Floats) -> Floats:
        """The state of a device at x (m) with the velocity v (m/s), whose hand is at rest on it, its spring slack."""
        return [*x, *v, *[0.0] * (self.order - 2 * self.axes)]

    def after(self, before: Floats, f: Floats, intention: Intention, part: int | None = None) -> Floats:
        """The state after one period, or a part of it.

        Args:
            before: the state at its beginning.
            f: the coupling's force over it, N.
            intention: the hand's intention over it.
            part: the length of the step, ns, at most a period; None for a period. Only a plant with parts has parts.
        """
        inputs = plus(f, intention.force) + intention.velocity
        if part is None or self._parts is None or part == self._period:
            return self._step(before + inputs)
        return self._parts.step(before, inputs, part)

    def holds(self, f: Floats, read: Floats) -> Floats:
        """What is held while the couplings' force is f (N), the device having been read in the state ``read``: f."""
        return f

    def done(self, state: Floats) -> float | None:
        """What its motors have done so far, J; None where they hold the force itself, whose work is f^T dx."""
        return None

    def seen(self, before: Floats, f: Floats, intention: Intention, part: int) -> Floats:
        """Displacement (m) and velocity (m/s) as :meth:`after` has them, in less time."""
        if self._parts is None or part == self._period:
            return self.after(before, f, intention, part)[: 2 * self.axes]
        inputs = plus(f, intention.force) + intention.velocity
        return self._parts.step(before, inputs, part, 2 * self.axes)

    def work(self, before: Floats, after: Floats, f: Floats, intention: Intention, part: int | None = None) -> float:
        """The intention's work over a step of :meth:`after`, J; of both states the first 2m entries are used."""
        T = self._T if part is None or part == self._period else seconds(Duration(part))
        goal = intention.velocity
        impulse = [force * T for force in plus(f, intention.force)] if any(goal) else goal
        return self._work_by(impulse, before, after, intention)

    def _work_by(self, impulse: Floats, before: Floats, after: Floats, intention: Intention) -> float:
        """The intention's work where motors and hand have given ``impulse``, N*s; that counts only with a velocity."""
        m = self.axes
        moved = minus(after[:m], before[:m])
        work = dot(intention.force, moved)
        goal = intention.velocity
        if any(goal):
            faster = minus(after[m : 2 * m], before[m : 2 * m])
            lost = zip(impulse, self._damping, moved, self._mass, faster, strict=True)
            work -= dot(goal, [given - b * dx - mass * dv for given, b, dx, mass, dv in lost])
        return work


class Hand(ABC):
    """The hand of a simulated device: what it intends, period by period, and what it makes of the device.

    Attributes:
        plant: the device with the hand as it holds it in the present period.
    """

    plant: Plant

    @abstractmethod
    def prepare(self, tick: int) -> None:
        """Do what :meth:`intend` can do for ``tick`` before its period begins; a second call does nothing."""

    @abstractmethod
    def intend(self, tick: int, state: Floats) -> tuple[Floats, Intention]:
        """Begin the period of ``tick``; called once a period.

        Args:
            tick: the period's number.
            state: the state of device and hand at its beginning.

        Returns:
            The state with which the period begins, and the hand's intention over it.
        """

    def buttons(self) -> int:
        """The buttons that the hand holds down, bit by bit; most hands press none."""
        return 0

    def wanted_turn(self) -> Quaternion | None:
        """Where the hand wants the device to be turned; None while it does not, as most hands never do."""
        return None

    @abstractmethod
    def figures(self) -> Figures:
        """The hand's own figures for the telemetry."""

    @abstractmethod
    def close(self) -> None:
        """Release the hand's files and sockets. A second call does nothing."""


class OwnTimeDriver:
    """A :class:`manyhands.nodes.device.drivers.Driver` in its own time: one period from sample to sample."""

    def __init__(self, hand: Hand) -> None:
        """Start at rest in x = 0."""
        self._hand = hand
        m = self._m = hand.plant.axes
        self._zero: Floats = [0.0] * m
        self._state: Floats = hand.plant.holding(self._zero, self._zero)
        self._tick = 0
        self._work = self._done = 0.0
        self._f = self._zero
        self._intention: Intention | None = None  # over the period that has begun, once it is known
        self._next: tuple[Floats, float] | None = (self._state, 0.0)

    @property
    def axes(self) -> int:
        """Number of axes."""
        return self._m

    def sample(self, tick: int, at: Instant) -> Floats:
        """The displacement at the instant kT, m: where the force of the last period has moved the device."""
        self._state, self._work = self._next if self._next is not None else self._advanced()
        self._tick, self._next, self._intention = tick, None, None
        return self._state[: self._m]

    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> Floats:
        """Hold f (N) over the period that begins; returns the displacement of the last sample, m."""
        held = list(map(float, f))  # a float of numpy is slow in the products
        self._f, self._next = self._hand.plant.holds(held, self._state), None
        return self._state[: self._m]

    def release(self, at: Instant) -> Floats:
        """Hold zero force."""
        return self.apply(self._zero, at)

    def idle(self, due: Instant) -> None:
        """Compute the next state before its sample is due, when this costs the loop no latency."""
        self._next = self._advanced()

    def intended_work(self) -> float:
        """Work of the intention over the last period, J."""
        return self._work

    def work(self) -> float | None:
        """Work of the motors since the last call, up to the last sample, J; None where they hold the force itself."""
        done = self._hand.plant.done(self._state)
        if done is None:
            return None
        since, self._done = done - self._done, done
        return since

    def buttons(self) -> int:
        """The buttons that the hand holds down, bit by bit."""
        return self._hand.buttons()

    def wanted_turn(self) -> Quaternion | None:
        """Where the hand wants the device to be turned; None for a hand that does not turn it so."""
        return self._hand.wanted_turn()

    def figures(self) -> Figures:
        """The hand's figures."""
        return self._hand.figures()

    def close(self) -> None:
        """Hold zero force, and close the hand's files and sockets. A second call does nothing."""
        self._f, self._next = self._zero, None
        self._hand.close()

    def _advanced(self) -> tuple[Floats, float]:
        """The state at the end of the period under the present force, and the work of the intention."""
        if self._intention is None:
            self._state, self._intention = self._hand.intend(self._tick, self._state)
        plant = self._hand.plant
        after = plant.after(self._state, self._f, self._intention)
        return after, plant.work(self._state, after, self._f, self._intention)


class HeldDeviceDriver(WallTimeDriver):
    """A :class:`manyhands.nodes.device.drivers.Driver` of a simulated device in wall time."""

    def __init__(self, hand: Hand, T: float) -> None:
        """Begin at rest in x = 0, at the instant of the first call.

        Args:
            hand: the hand; its plants step over parts of a period.
            T: period, s.
        """
        super().__init__(hand.plant.axes, T, hand.plant.divides)
        self._hand = hand
        self._intention = Intention(self._zero, self._zero)  # over the period that was entered last
        self._read = hand.plant.holding(self._zero, self._zero)  # the state at the last sample
        self._torques = hand.plant.done(self._read) is not None
        self._done = 0.0

    def sample(self, tick: int, at: Instant) -> Floats:
        """As of :class:`WallTimeDriver`; the joints are read here."""
        x = super().sample(tick, at)
        if self._torques:
            self._read = self._latest()
        return x

    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> Floats:
        """As of :class:`WallTimeDriver`; of a linkage the torques are held that stand for f at the last sample."""
        if self._torques:
            f = self._hand.plant.holds(list(map(float, f)), self._read)
        return super().apply(f, at, until)

    def work(self) -> float | None:
        """Work of the motors since the last call, J, up to the displacement that was returned last.

        None where they hold the force itself.
        """
        done = self._hand.plant.done(self._latest()) if self._torques else None
        if done is None:
            return None
        since, self._done = done - self._done, done
        return since

    def buttons(self) -> int:
        """The buttons that the hand holds down, bit by bit."""
        return self._hand.buttons()

    def wanted_turn(self) -> Quaternion | None:
        """Where the hand wants the device to be turned; None for a hand that does not turn it so."""
        return self._hand.wanted_turn()

    def figures(self) -> Figures:
        """The hand's figures."""
        return self._hand.figures()

    def close(self) -> None:
        """Exert no force, and close the hand's files and sockets. A second call does nothing."""
        super().close()
        self._hand.close()

    def _begin(self, at: int) -> tuple[Floats, float]:
        return self._hand.plant.holding(self._zero, self._zero), 0.0

    def _prepare(self, tick: int) -> None:
        self._hand.prepare(tick)

    def _enter(self, tick: int, state: Floats) -> Floats:
        state, self._intention = self._hand.intend(tick, state)
        return state

    def _advance(self, state: Floats, f: Floats, begin: int, end: int) -> Floats:
        return self._hand.plant.after(state, f, self._intention, end - begin)

    def _seen(self, state: Floats, f: Floats, begin: int, end: int) -> Floats:
        return self._hand.plant.seen(state, f, self._intention, end - begin)

    def _work_over(self, before: Floats, after: Floats, f: Floats, begin: int, end: int) -> float:
        return self._hand.plant.work(before, after, f, self._intention, end - begin)


def device_of(hand: SimulatedHand) -> HeldDevice:
    """The device with its hand that a bundle describes.

    Raises:
        ValueError: a mass is not positive.
    """
    return held_device(
        list(hand.mass), list(hand.damping), hand.operator, list(hand.hand_damping), list(hand.hand_stiffness)
    )


def bare_device_of(hand: SimulatedHand) -> HeldDevice:
    """The same device with an open hand: the mass of both, and the device's own damping.

    Raises:
        ValueError: a mass is not positive.
    """
    m = hand.axes
    return held_device(list(hand.mass), list(hand.damping), StateSpace.static(np.zeros((m, m))), [0.0] * m, [0.0] * m)


class IntentHand(Hand):
    """A hand whose intention is a function of time."""

    def __init__(self, plant: Plant, force: Sequence[Intent], motion: Sequence[Intent], T: float) -> None:
        """Hold ``plant`` all the time.

        Args:
            plant: the device with the hand, m axes.
            force: the intended force (N) of each axis as a function of time (s).
            motion: the intended motion (m) of each axis as a function of time (s).
            T: period, s.
        """
        self.plant = plant
        self._force, self._motion, self._T = tuple(force), tuple(motion), T
        self._prepared: tuple[int, Intention] | None = None

    def prepare(self, tick: int) -> None:
        """Evaluate the functions."""
        if self._prepared is None or self._prepared[0] != tick:
            self._prepared = tick, self._at(tick)

    def intend(self, tick: int, state: Floats) -> tuple[Floats, Intention]:
        """The force at the period's beginning, and the motion's mean velocity over it; ``state`` stays."""
        if self._prepared is not None and self._prepared[0] == tick:
            return state, self._prepared[1]
        return state, self._at(tick)

    def figures(self) -> Figures:
        """No figures."""
        return Figures()

    def close(self) -> None:
        """Do nothing: there are no files or sockets."""

    def _at(self, tick: int) -> Intention:
        T = self._T
        t = tick * T
        goal = [(motion(t + T) - motion(t)) / T for motion in self._motion]
        return Intention([force(t) for force in self._force], goal)


def intent_hand(hand: SimulatedHand, T: float, parts: bool = False, plant: Plant | None = None) -> IntentHand:
    """The simulated hand that a bundle describes.

    Args:
        hand: the physics of device and hand, and the hand's intention.
        T: period, s.
        parts: whether the plant steps over parts of a period, for a driver in wall time.
        plant: the device with the hand, where it is not this plant.

    Raises:
        ValueError: a mass is not positive, or an intention is not usable.
    """
    forces, motions = ([intent_from(data) for data in every] for every in (hand.force, hand.motion))
    return IntentHand(plant or Plant(device_of(hand), T, parts), forces, motions, T)
