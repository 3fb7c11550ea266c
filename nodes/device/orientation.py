"""A device's orientation in its tick: the law of :mod:`manyhands.nodes.kernel.orientation`, from a hand to its torque.

In each tick the device says its orientation R(k), and what it has deposited. With the tick's answer comes a proxy that
the world proposes, or none. The torque follows here, in the device's own process, and goes to the motors with the
force. Nothing is assumed of what comes: what is no orientation is none, and the proxy rests.

The device *lets go*, by a proxy that follows it without a torque,

- in a period in which no answer came;
- while its guard lets go of the force (:mod:`manyhands.nodes.device.core`), by whose ramp the greatest torque rises;
- in a tick to which it has turned faster than its limit;
- for two ticks when it changes its rung, and with it the stiffness: the greatest torque falls by a ramp before, and
  rises by one after;
- while late ticks may have given out more than the session allows to lateness.

**A driver of another package** tells the orientation (:class:`DriverBody`), and is given the torque with the force, by
the device's tick. Its samples are old and its torques act late by what the session states of it. So that much is added
to each delay, and the jitter of its samples to each period. A torque ends with its force. Where it has ended before the
next sample the spring begins anew there: what it had stored is lost.

A device that only senses its orientation (:class:`SensedOrientation`) says it in the same way. It takes in nothing, for
it has no torque and no account.

A :class:`TurnedBody` is a simulated device in a hand, the same about every axis, whose turn over a piece of time with a
constant torque is exact up to the order of small turns. A person may turn it by a pointer instead
(:mod:`manyhands.nodes.device.wrist`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, Protocol

from manyhands.design.levels.held_torque import HeldTorque
from manyhands.nodes.device.wrist import Wrist
from manyhands.nodes.kernel.allowance import LatenessAllowance
from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.kernel.bundle import DeviceRung, OrientationPart, TurnedHand
from manyhands.nodes.kernel.driver_statement import NO_DELAY, DeviceTiming
from manyhands.nodes.kernel.intent import intent_from
from manyhands.nodes.kernel.orientation import (
    FIRST_LIFE,
    UPRIGHT,
    OrientationSpring,
    Quaternion,
    Vector3,
    angle,
    energy,
    total,
    turned_by,
    unit,
)
from manyhands.nodes.kernel.timeouts import RAMP
from manyhands.protocol.clock import Duration, Instant, from_seconds, seconds

NOTHING: Final = (0.0, 0.0, 0.0, 0.0, 0.0)
"""No proxy, and no grant."""

NO_TORQUE: Final[Vector3] = (0.0, 0.0, 0.0)

LONGEST_GAP: Final = from_seconds(10.0)
"""The longest time between two calls in which a simulated body moves, ns; then it stands still."""

_HAIR: Final = 1.0 + 1e-9  # of a speed, which is a quotient of rounded numbers


class Turnable(Protocol):
    """What a hand turns."""

    def to(self, at: Instant) -> Quaternion:
        """Move on to the instant ``at``, and return the orientation then; an earlier one is the present."""
        ...

    def apply(self, u: Vector3, at: Instant, until: Instant | None = None) -> None:
        """Hold the torque u, N*m, from the instant ``at`` on, and let go of it at ``until``; None for never."""
        ...


class Telling(Protocol):
    """A driver that tells how its device is turned."""

    def orientation(self) -> Quaternion:
        """How the device was turned at its last sample, in the session's axes."""
        ...


class DriverBody:
    """A :class:`Turnable` that a driver of another package moves; its tick hands it torques and forces together."""

    def __init__(self, driver: Telling) -> None:
        """Ask ``driver`` at each sample, after it has told the displacement."""
        self._driver = driver

    def to(self, at: Instant) -> Quaternion:
        """The orientation of the driver's last sample."""
        return self._driver.orientation()

    def apply(self, u: Vector3, at: Instant, until: Instant | None = None) -> None:
        """Nothing more is to be done."""


class TurnedBody:
    """A simulated device that a hand turns: J domega/dt + b omega = torque, R(0) upright and at rest.

    Attributes:
        R: its orientation at the instant of the last call.
    """

    def __init__(self, of: TurnedHand, T: float, wrist: Wrist | None = None) -> None:
        """Begin at the instant 0; the hand's torque is constant over each period T, s.

        Args:
            of: its physics, and what its hand intends.
            T: period, s.
            wrist: of a person who may turn it; None for nobody.
        """
        self._rate, self._damping = of.damping / of.inertia, of.damping
        self._of, self._wrist = of, wrist
        self._intents = tuple(intent_from(data) for data in of.torque)
        self._period = from_seconds(T)
        self._at, self._begun = Instant(0), -1
        self._hand = self._u = self._omega = NO_TORQUE
        self._ends: Instant | None = None  # when the motors let go of u by themselves
        self.R = UPRIGHT

    def to(self, at: Instant) -> Quaternion:
        """Move on to the instant ``at``, and return the orientation then; an earlier one is the present."""
        left = at - self._at
        if left > LONGEST_GAP:
            self._at, self._omega, left = Instant(at - LONGEST_GAP), NO_TORQUE, LONGEST_GAP
        while left > 0:
            number, into = divmod(self._at, self._period)
            if number != self._begun:
                t = seconds(Duration(number * self._period))
                x, y, z = self._intents
                self._begun, self._hand = number, (x(t), y(t), z(t))
                if self._wrist is not None:
                    own, damping = self._wrist.begin(self.R)
                    self._hand = (self._hand[0] + own[0], self._hand[1] + own[1], self._hand[2] + own[2])
                    self._damping = self._of.damping + damping
                    self._rate = self._damping / self._of.inertia
            part = min(left, self._period - into)
            if self._ends is not None:
                if self._at >= self._ends:
                    self._u, self._ends = NO_TORQUE, None
                else:
                    part = min(part, self._ends - self._at)
            self._move(seconds(Duration(part)))
            self._at, left = Instant(self._at + part), left - part
        return self.R

    def apply(self, u: Vector3, at: Instant, until: Instant | None = None) -> None:
        """Hold the torque u, N*m, from the instant ``at`` on, and let go of it at ``until``; None for never."""
        self.to(at)
        self._u, self._ends = u, until

    def _move(self, dt: float) -> None:
        decay = -math.expm1(-self._rate * dt)  # 1 - exp
        turn, omega = [], []
        for own, held, before in zip(self._hand, self._u, self._omega, strict=True):
            end = (own + held) / self._damping
            turn.append(end * dt + (before - end) * decay / self._rate)
            omega.append(before + (end - before) * decay)
        self.R = turned_by(self.R, turn)
        self._omega = (omega[0], omega[1], omega[2])


class Oriented(Protocol):
    """The orientation of one device, as its tick calls it.

    Attributes:
        life: the number of this process, which is drawn where others may come before or after it.
        R: the orientation of the last sample.
        torque: that of the last tick, N*m.
    """

    life: float
    R: Quaternion
    torque: Vector3

    def sample(self, turn: int, at: Instant) -> None:
        """Take the orientation: in wall time that at ``at``, in its own time that after ``turn`` periods."""
        ...

    @property
    def rides(self) -> Floats:
        """What rides with the sample: the orientation, the deposits and the life."""
        ...

    def exert(self, came: Sequence[float], at: Instant, ratio: float = 1.0, until: Instant | None = None) -> Vector3:
        """Take what came with the tick's answer, and exert the torque that follows from ``at`` on; returns it, N*m."""
        ...

    def release(self, at: Instant) -> None:
        """Exert no torque from ``at`` on."""
        ...

    def change(self, rung: DeviceRung) -> None:
        """Change the rung, as soon as no torque acts."""
        ...

    def shorten(self, until: Instant) -> None:
        """The motors let go of the torque by themselves at ``until`` already."""
        ...

    def row(self) -> tuple[Sequence[float], ...]:
        """A part for each topic of the orientation."""
        ...


class SensedOrientation:
    """The orientation of a device that only senses it: no torque acts on its hand, whatever comes.

    Attributes:
        life: the number of this process.
        R: the orientation of the last sample.
        torque: none.
    """

    def __init__(self, body: Turnable, T: float, wall: bool = False) -> None:
        """Begin upright.

        Args:
            body: what its hand turns.
            T: period, s.
            wall: whether it turns in wall time.
        """
        self._period, self._wall = from_seconds(T), wall
        self._body = body
        self.life, self.R, self.torque = FIRST_LIFE, UPRIGHT, NO_TORQUE

    def sample(self, turn: int, at: Instant) -> None:
        """Take the orientation, as of :class:`Oriented`."""
        self.R = self._body.to(at if self._wall else Instant(turn * self._period))

    @property
    def rides(self) -> Floats:
        """What rides with the sample: the orientation, and the life. It has deposited nothing."""
        return [*self.R, 0.0, self.life]

    def exert(self, came: Sequence[float], at: Instant, ratio: float = 1.0, until: Instant | None = None) -> Vector3:
        """Exert no torque."""
        return NO_TORQUE

    def release(self, at: Instant) -> None:
        """Do nothing: no torque acts."""

    def change(self, rung: DeviceRung) -> None:
        """Do nothing: no torque acts at any rung."""

    def shorten(self, until: Instant) -> None:
        """Do nothing, likewise."""

    def row(self) -> tuple[Sequence[float], ...]:
        """R alone."""
        return (self.R,)


class DeviceOrientation:
    """The orientation of one device, from its samples to its torques.

    Attributes:
        spring: the law, with its account.
        life: the number of this process, which is drawn where others may come before or after it.
        rung: that of which its damping pays for the torque.
        R: the orientation of the last sample.
        came: what came for it with the last answer: a proposed proxy and a sum of grants; zeros for nothing.
        most: the greatest torque of the last tick, N*m.
        torque: that of the last tick, N*m.
        let_go: the ticks with an answer in which it has let go.
        least: the least that its account has been, J.
        margin: the least distance of its account from its bound, J.
    """

    def __init__(
        self,
        part: OrientationPart,
        T: float,
        rung: DeviceRung,
        allowance: LatenessAllowance | None = None,
        longest: Duration | None = None,
        body: Turnable | None = None,
        timing: DeviceTiming = NO_DELAY,
        held: HeldTorque | None = None,
    ) -> None:
        """Begin at rest, with the proxy at the device.

        Args:
            part: what the device has of its orientation.
            T: period, s.
            rung: whose delays and periods its damping pays for.
            allowance: what lateness may put in; None for anything, which is counted alone.
            longest: of a device in wall time, how long its motors hold a torque, ns; None for one in its own time,
                where nothing is late.
            body: what its hand turns; the simulated one of its part unless given.
            timing: how late the device measures and acts, beside the loop.
            held: how its motors hold the torque as torques of joints; None where they hold the torque itself.

        Raises:
            ValueError: neither a body nor a simulated one is there.
        """
        if body is None:
            if part.source is None:
                raise ValueError("found an orientation without a body; expected the driver's, or a simulated one")
            body = TurnedBody(part.source, T)
        self._body = body
        self._T, self._period, self._longest = T, from_seconds(T), longest
        self._limit, self._speed, self._joints = part.torque, part.speed, held
        self._fade = RAMP  # how many parts of the greatest torque it takes
        self._next: DeviceRung | None = None  # the rung that it changes to
        self._part = part
        self._allowance = allowance
        self._latency, self._jitter = from_seconds(timing.latency), from_seconds(timing.jitter)
        self._slack = Duration(self._jitter + from_seconds(timing.actuation_delay))  # how well ends are known
        self._ends = Instant(0)  # when the torque ends by itself
        self.spring = OrientationSpring(part.stiffness_at(rung), part.torque)
        self.life = FIRST_LIFE
        self.R, self.most = UPRIGHT, part.torque
        self.came: tuple[float, ...] = NOTHING
        self.torque = self._before = NO_TORQUE
        self._sampled: Instant | None = None
        self._acted = Instant(0)
        self._fast, self._held = False, False
        self.let_go = 0
        self.least = self.margin = 0.0
        self._take(rung)
        self._held_for = seconds(self._covered)  # how long the torque of the tick before was held, s

    def _take(self, rung: DeviceRung) -> None:
        """Take the stiffness of a rung, and what its damping pays for.

        What pays for the torques of joints is no part of it. Beside the spring's torque they exert at most
        L F (e^(kappa l) - 1) about the tip.
        """
        self.rung, self._k, self._b, self._beside = rung, self._part.stiffness_at(rung), self._part.osp, 0.0
        if (held := self._joints) is not None and held.length is not None:
            times = self._T, rung.tau, rung.period_tolerance
            longest = held.speed * (self._T * (1.0 + rung.period_tolerance) + rung.tau)
            self._b -= held.turning(*times)
            self._beside = held.length * held.force * math.expm1(held.kappa * longest)
        T = self._T * (1.0 + rung.period_tolerance)
        self._tau: Duration = from_seconds(rung.tau)
        self._covered: Duration = from_seconds(T)
        t = rung.tau / T
        self._epsilon = 2.0 * t / (1.0 + t)

    def change(self, rung: DeviceRung) -> None:
        """Change the rung, once the greatest torque has come to 0 by the ramp."""
        self._next = rung

    def sample(self, turn: int, at: Instant) -> None:
        """Take the orientation: in wall time that at ``at``, in its own time that after ``turn`` periods."""
        wall = self._longest is not None
        before, since = self.R, self._sampled
        now = at if wall else Instant(turn * self._period)
        self.R, self._sampled = self._body.to(now), now
        self._fast, self._held = False, False
        if since is None:
            self.spring.proxy = self.R  # from rest, without a torque
        if since is None or now <= since:
            return
        far, h = angle(before, self.R), now - since
        self._fast = far > self._speed * seconds(Duration(h + self._jitter)) * _HAIR
        if wall:
            acted, ended = max(since, self._acted), max(since, self._ends)
            self._judge(
                far, Duration(h), Duration(acted - since + self._latency), Duration(ended - since + self._latency)
            )

    def _judge(self, far: float, h: Duration, d: Duration, ended: Duration) -> None:
        """Count the tick that has ended, of ``h`` ns, over a turn of ``far`` rad.

        Its torque changed after ``d`` ns and ends by itself after ``ended`` ns, both in the device's own time.
        """
        spring, acted, longest = self.spring, any(self.torque) or any(self._before), h + self._jitter
        before, self._held_for = self._held_for, seconds(Duration(min(longest, ended)))
        late = longest > self._covered or d > self._tau or d > h
        fastest = self._speed + (max(math.hypot(*self.torque), math.hypot(*self._before)) + self._beside) / self._b
        burnt = self._b * far * far / seconds(Duration(longest))
        if acted:
            if late:
                spring.charge(self._most_of(before, self._held_for, seconds(d), fastest))
            if ended < h + self._slack:  # the motors have let go by themselves since
                if ended >= h:  # or do so just now
                    spring.charge(self._limit * fastest * seconds(self._slack))
                spring.lose(self.R)
        elif self._owes:  # without a torque nothing was stored, and what was burnt pays for nothing else
            spring.lose(self.R)
            spring.pay(burnt)
        else:  # it pays for what the spring has stored since, as the account counts it
            unpaid = energy(self._k, self.R, spring.proxy) - burnt
            if unpaid > 0.0:  # as in a late tick alone
                spring.charge(unpaid)
            else:
                spring.pay(-unpaid)
        if spring.owed and self._allowance is not None:
            spring.pay(self._allowance.power * seconds(h))

    @property
    def _owes(self) -> bool:
        """Whether late ticks may have given out more than lateness may put in at once."""
        return self._allowance is not None and self.spring.owed > self._allowance.energy

    def _most_of(self, before: float, h: float, d: float, fastest: float) -> float:
        """What a tick of h s with a delay of d s, after one of ``before`` s, may give out, J: decision 54, (4).

        ``fastest``, rad/s, is the greatest speed: what a torque alone would reach comes to that of the hand.
        """
        e, late = self._epsilon, (2.0 * before + d) * d
        if e > 0.0:
            late = min(late, (1.0 + 1.0 / e) * d * d)
        return 0.5 * self._k * fastest**2 * ((1.0 + e) * h * h + late)

    @property
    def rides(self) -> Floats:
        """What rides with the sample: the orientation, the deposits and the life."""
        return [*self.R, self.spring.deposited, self.life]

    def exert(self, came: Sequence[float], at: Instant, ratio: float = 1.0, until: Instant | None = None) -> Vector3:
        """Take what came with the tick's answer, and exert the torque that follows from ``at`` on; returns it, N*m.

        Args:
            came: :data:`manyhands.nodes.kernel.orientation.RIDER` numbers.
            at: the instant.
            ratio: of the guard, by which the device takes hold.
            until: when the motors let go by themselves; None for the longest that they hold a torque.
        """
        self.came = tuple(came[:5]) if came[5] == self.life else NOTHING
        self._fade = max(0, self._fade - 1) if self._next is not None else min(RAMP, self._fade + 1)
        self.most = self._limit * ratio * (self._fade / RAMP)
        if self._fast or self._owes or not self.most > 0.0:
            self.let_go += 1
            self._hold(self._released(), at, until)
            # the tick before is judged by the rung in which its torque acted, so there must have been none
            if self._next is not None and not self.most > 0.0 and not any(self._before):
                self._take(self._next)
                self.spring.change(self._k, self.R)
                self._next = None
            return self.torque
        self._hold(follow(self.spring, self.R, self.came, self.most), at, until)
        return self.torque

    def release(self, at: Instant) -> None:
        """Exert no torque from ``at`` on."""
        self._hold(self._released(), at)

    def shorten(self, until: Instant) -> None:
        """The motors let go of the torque by themselves at ``until`` already."""
        self._ends = min(self._ends, until)
        self._body.apply(self.torque, self._sampled or until, self._ends)

    def row(self) -> tuple[Sequence[float], ...]:
        """R, Q, the torque, what came, and the account with all that it is made of: a part for each topic."""
        s = self.spring
        account = (s.account, s.deposited, s.granted, s.owed, s.late, self.most)
        return self.R, s.proxy, self.torque, self.came, account

    def _released(self) -> Vector3:
        self.spring.release(self.R)
        return NO_TORQUE

    def _hold(self, u: Vector3, at: Instant, until: Instant | None = None) -> None:
        if not self._held:  # otherwise it has let go in this tick already
            self._held, self._before, self._acted = True, self.torque, at
        self._ends = Instant(at + (self._longest or 0)) if until is None else until
        self.torque = u
        spring = self.spring
        self.least = min(self.least, spring.account)
        self.margin = min(self.margin, spring.account - (spring.deposited - spring.granted))
        if self._longest is not None:
            self._body.apply(u, at, self._ends)
        else:
            self._body.apply(u, self._sampled or Instant(0))


def follow(spring: OrientationSpring, R: Quaternion, came: Sequence[float], most: float) -> Vector3:
    """The torque for what came with an answer, N*m, which the audit computes again.

    Args:
        spring: with its account.
        R: the device's orientation.
        came: a proposed proxy and a sum of grants, J.
        most: the greatest torque, N*m.
    """
    spring.most = most
    return spring.turn(R, unit(came[:4]), total(came[4]))
