"""Drivers of a device that turns in space: one as another package would write it, and others that are broken."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar

from manyhands.nodes.device.specification import DeviceSpecification, OrientationSpecification
from manyhands.nodes.kernel.orientation import UPRIGHT, Quaternion, turned_by
from manyhands.protocol.clock import Instant
from tests.support.plugin_drivers import STEP, Counterpart

Torque = tuple[float, float, float]
NO_TORQUE: Torque = (0.0, 0.0, 0.0)


class Pen(Counterpart):
    """A mass on each axis, and an inertia about each, with damping; every other quaternion has the opposite sign.

    Its samples are ``age`` old, and its forces and torques act ``delay`` later, s. A wrist turns it to and fro about x
    with ``wrist``, N*m. It feels no torque where it is ``sensed``.

    Attributes:
        let_go: the names of the drivers that were released, one for each call.
    """

    let_go: ClassVar[list[str]] = []

    def __init__(self, ports: tuple[str, ...], period: float, parameters: Mapping[str, Any]) -> None:
        super().__init__(ports, period, parameters)
        self.inertia, self.burn = parameters.get("inertia", 2e-5), parameters.get("burn", 0.001)
        self.wrist = parameters.get("wrist", 0.0)
        self.torque = None if parameters.get("sensed") else parameters.get("torque", 0.2)
        self.holds = parameters.get("holds", "world")
        self.R, self.omega, self.t = UPRIGHT, [0.0, 0.0, 0.0], NO_TORQUE
        if "at" in parameters:
            self.R = turned_by(UPRIGHT, parameters["at"])
        self.turned: int | None = None
        self.torques: list[tuple[int, Torque]] = []  # from an instant on
        self.stood: list[tuple[int, Quaternion]] = []
        self.sampled = 0
        self.sign = 1.0

    def specification(self) -> DeviceSpecification:
        of = OrientationSpecification(speed=60.0, torque=self.torque, holds=self.holds)
        return replace(super().specification(), orientation=of)

    def sample(self, tick: int, at: Instant) -> Sequence[float]:
        self.sampled = at
        return super().sample(tick, at)

    def orientation(self) -> Sequence[float]:
        self._turn(self.sampled)
        wanted = self.sampled - self.age
        while len(self.stood) > 1 and self.stood[1][0] <= wanted:
            del self.stood[0]
        self.sign = -self.sign
        return [self.sign * part for part in self.stood[0][1]]

    def apply_wrench(
        self, f: Sequence[float], torque: Sequence[float], at: Instant, until: Instant | None = None
    ) -> Sequence[float] | None:
        self._twist(torque, at, until)
        return super().apply(f, at, until)

    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> Sequence[float] | None:
        self._twist(NO_TORQUE, at, None)
        return super().apply(f, at, until)

    def release(self, at: Instant) -> Sequence[float] | None:
        self.let_go.append(type(self).__name__)
        return super().release(at)

    def _twist(self, torque: Sequence[float], at: int, until: int | None) -> None:
        self._turn(at)
        x, y, z = torque
        self.torques = [one for one in self.torques if one[0] <= at + self.delay] + [(at + self.delay, (x, y, z))]
        if until is not None:
            self.torques.append((until + self.delay, NO_TORQUE))

    def _turn(self, to: int) -> None:
        now = to if self.turned is None else self.turned
        self.stood = self.stood or [(now, self.R)]
        while now < to:
            while self.torques and self.torques[0][0] <= now:
                self.t = self.torques.pop(0)[1]
            end = min([to, now + STEP, *(at for at, _ in self.torques[:1])])
            dt = (end - now) * 1e-9
            hand = [self.wrist * math.sin(4.0 * math.pi * now * 1e-9), 0.0, 0.0]
            for i in range(3):
                self.omega[i] += dt * (self.acts()[i] + hand[i] - self.burn * self.omega[i]) / self.inertia
            self.R = turned_by(self.R, [dt * one for one in self.omega])
            now = end
            self.stood.append((now, self.R))
        self.turned = now

    def acts(self) -> Torque:
        return self.t


class NotUnit(Pen):
    def orientation(self) -> Sequence[float]:
        return [1.01 * part for part in super().orientation()]


class NotANumber(Pen):
    def orientation(self) -> Sequence[float]:
        return [math.nan, 0.0, 0.0, 0.0]


class Three(Pen):
    def orientation(self) -> Sequence[float]:
        return [0.0, 0.0, 1.0]


class Words(Pen):
    def orientation(self) -> Sequence[float]:
        return "upright"


class Torn(Pen):
    """Its cable to the grip is torn: it raises."""

    def orientation(self) -> Sequence[float]:
        raise OSError("no grip")


class WrenchTorn(Pen):
    def apply_wrench(
        self, f: Sequence[float], torque: Sequence[float], at: Instant, until: Instant | None = None
    ) -> Sequence[float] | None:
        raise OSError("no amplifier")


class Jumping(Pen):
    """One orientation in a hundred is of somewhere else."""

    calls = 0

    def orientation(self) -> Sequence[float]:
        self.calls += 1
        own = Quaternion(*super().orientation())
        return turned_by(own, (0.0, 0.5, 0.0)) if self.calls % 100 == 99 else own


class Ticking(Pen):
    """It turns evenly, by 1 rad in 5 ms, in steps of that: continuous in no sense, and faster than stated."""

    def orientation(self) -> Sequence[float]:
        return turned_by(UPRIGHT, (0.0, 0.0, (self.sampled // 5_000_000) * 1.0))


class Twisting(Pen):
    """A torque acts from its start on."""

    def acts(self) -> Torque:
        return (self.t[0], self.t[1] + 0.002, self.t[2])


class TwistingByForce(Pen):
    """A force turns it, too: its motors are coupled."""

    def apply_wrench(
        self, f: Sequence[float], torque: Sequence[float], at: Instant, until: Instant | None = None
    ) -> Sequence[float] | None:
        return super().apply_wrench(f, [torque[0], torque[1], torque[2] + 0.01 * f[0]], at, until)


class TorqueKept(Pen):
    """Its torque does not end at its instant, though its force does."""

    def apply_wrench(
        self, f: Sequence[float], torque: Sequence[float], at: Instant, until: Instant | None = None
    ) -> Sequence[float] | None:
        found = super().apply_wrench(f, torque, at, until)
        self._twist(torque, at, None)
        return found


class TorqueNotReleased(Pen):
    def release(self, at: Instant) -> Sequence[float] | None:
        return Counterpart.apply(self, [0.0] * self.n, at)


class TorqueOpposed(Pen):
    def apply_wrench(
        self, f: Sequence[float], torque: Sequence[float], at: Instant, until: Instant | None = None
    ) -> Sequence[float] | None:
        return super().apply_wrench(f, [-one for one in torque], at, until)


class TorqueSwapped(Pen):
    def apply_wrench(
        self, f: Sequence[float], torque: Sequence[float], at: Instant, until: Instant | None = None
    ) -> Sequence[float] | None:
        return super().apply_wrench(f, [torque[1], torque[0], torque[2]], at, until)


class TorqueLate(Pen):
    """Its torques act 5 ms late, which it does not state."""

    def _twist(self, torque: Sequence[float], at: int, until: int | None) -> None:
        super()._twist(torque, at, None)
        begin, own = self.torques.pop()
        self.torques.append((begin + 5_000_000, own))
        if until is not None:
            self.torques.append((until, NO_TORQUE))


class Conjugate(Pen):
    """From the world's axes to those of the tool, in place of the other way round."""

    def orientation(self) -> Sequence[float]:
        w, x, y, z = super().orientation()
        return [w, -x, -y, -z]


class ScalarLast(Pen):
    """(x, y, z, w)."""

    def orientation(self) -> Sequence[float]:
        w, x, y, z = super().orientation()
        return [x, y, z, w]


class OldOrientation(Pen):
    """The orientation of 20 ms ago, beside a new displacement."""

    def orientation(self) -> Sequence[float]:
        now, self.sampled = self.sampled, max(0, self.sampled - 20_000_000)
        found = super().orientation() if self.sampled >= (self.turned or 0) else self._older()
        self.sampled = now
        self._turn(now)
        return found

    def _older(self) -> Sequence[float]:
        while len(self.stood) > 1 and self.stood[1][0] <= self.sampled:
            del self.stood[0]
        return self.stood[0][1]
