"""An arm of two links whose motors hold torques, and a device of it that an adversary moves."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from manyhands.design.levels.contract import DeviceShare
from manyhands.design.levels.held_torque import HeldTorque
from manyhands.nodes.device.interface import DeviceInterface
from manyhands.nodes.kernel.allowance import LatenessAllowance
from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.kernel.inertia import Inertia
from manyhands.protocol.clock import Duration, Instant

from .moved_device import STALE, Array, Device, T


@dataclass
class Arm:
    """Links of 120 and 140 mm; the device's displacement is that of the tip from its place at ``home``.

    Attributes:
        home: the joints' angles at x = 0, rad.
    """

    home: tuple[float, float] = (0.3, 1.6)
    links: tuple[float, float] = (0.12, 0.14)
    origin: Array = field(init=False)

    def __post_init__(self) -> None:
        self.origin = np.zeros(2)
        self.origin = self.tip(np.array(self.home))

    def tip(self, q: Array) -> Array:
        (a, b), (first, both) = self.links, (q[0], q[0] + q[1])
        return np.array([a * np.cos(first) + b * np.cos(both), a * np.sin(first) + b * np.sin(both)]) - self.origin

    def joints(self, x: Array) -> Array:
        (a, b), (X, Y) = self.links, x + self.origin
        bend = math.acos((X * X + Y * Y - a * a - b * b) / (2.0 * a * b))
        return np.array([math.atan2(Y, X) - math.atan2(b * math.sin(bend), a + b * math.cos(bend)), bend])

    def jacobian(self, q: Array) -> Array:
        (a, b), (first, both) = self.links, (q[0], q[0] + q[1])
        return np.array(
            [
                [-a * np.sin(first) - b * np.sin(both), -b * np.sin(both)],
                [a * np.cos(first) + b * np.cos(both), b * np.cos(both)],
            ]
        )

    def torque(self, r: Array, at: Array) -> Array:
        """J^T r with the joints as they are at the displacement ``at``."""
        return self.jacobian(self.joints(at)).T @ r

    def bending(self, q: Array, v: Array) -> Array:
        """The tip's acceleration while it moves with the velocity v, and no joint accelerates."""
        (a, b), (first, both) = self.links, (q[0], q[0] + q[1])
        w = np.linalg.solve(self.jacobian(q), v)
        out = -a * w[0] ** 2 * np.array([np.cos(first), np.sin(first)])
        return out - b * (w[0] + w[1]) ** 2 * np.array([np.cos(both), np.sin(both)])

    def kappa(self, reach: float) -> float:
        """The greatest bending of unit motions within ``reach`` of x = 0 on each axis, 1/m."""
        ways = [np.array([np.cos(way), np.sin(way)]) for way in np.linspace(0.0, np.pi, 61)]
        places = [self.joints(np.array([x, y])) for x in (-reach, 0.0, reach) for y in (-reach, 0.0, reach)]
        return max(float(np.linalg.norm(self.bending(q, way))) for q in places for way in ways)


REACH: Final = 0.03
"""m; the adversary stays within it on each axis."""


class HeldDevice(Device):
    """A device whose arm holds torques.

    Attributes:
        arm: the arm.
        told: whether its account is told of the torques; otherwise it takes the device to hold the force.
        tells: whether it knows what its motors did.
        level: what the promise is made of, N*s/m.
        torque: of the joints, N*m.
        read: the displacement at the last sample, m.
        done: by the motors, J.
    """

    def __init__(
        self,
        osp: Array,
        promised: DeviceShare,
        tau: float,
        tank: float | None,
        held: HeldTorque,
        speed: float,
        arm: Arm,
        inertia: Inertia | None = None,
        told: bool = True,
    ) -> None:
        super().__init__(osp, promised, tau, tank, 0, None, speed)
        self.arm, self.told, self.tells = arm, told, True
        allowed = None if tank is None else LatenessAllowance(tank)
        self.interface = DeviceInterface(
            osp,
            promised,
            tau,
            0.0,
            T,
            (speed,) * len(osp),
            STALE,
            allowed,
            Duration(0),
            inertia,
            held if told else None,
        )
        left = held.left(osp, T, tau, 0.0)
        assert left is not None
        self.level = left if told else osp
        self.torque = self.read = np.zeros(2)
        self.done = self.seen = 0.0  # by the motors, J: in all, and up to the last call

    def move(self, velocity: Array, until: int) -> None:
        """Move at a constant velocity, which turns back at the ends of the reach."""
        velocity = np.round(velocity, 9)
        while self.now < until:
            velocity = np.where(velocity * self.x < REACH * np.abs(velocity), velocity, -velocity)
            moves = velocity != 0.0
            speeds = np.abs(velocity[moves])
            ways = (REACH - np.sign(velocity[moves]) * self.x[moves]) / speeds
            end = min([until, *(self.now + max(1, math.ceil(1e9 * way)) for way in ways)])
            if self.until is not None and self.now < self.until < end:
                end = self.until
            h = (end - self.now) * 1e-9
            d = velocity * h
            acts = self.until is None or self.now < self.until
            work = float(self.torque @ (self.arm.joints(self.x + d) - self.arm.joints(self.x))) if acts else 0.0
            self.course.pieces.append((self.exerted if acts else np.zeros(2), d, h))
            self.done += work
            self.x, self.now = self.x + d, end

    def _work(self) -> float | None:
        done, self.seen = self.done - self.seen, self.done
        return None if not self.told else done if self.tells else math.inf

    def send(self) -> None:
        self.read = self.x
        x = self.x.tolist()
        sent = np.array(self.interface.send(x, x, Instant(self.now), self._work()))
        if self.interface.shortened:
            self.until = self.interface.until
        self.w, self.sent = sent - self.sent, sent

    def answer(self, f: Floats, known: bool = True) -> None:
        held, until = self.interface.force(f, f, Instant(self.now))
        self.course.ticks.append((self.w, np.array(f), self.f))
        self.f = np.array(f)
        self.exerted, self.until = np.array(held), until
        self.torque = self.arm.torque(self.exerted, self.read)
        x = self.x.tolist() if known else None
        self.interface.applied(x, Instant(self.now), held, until, self._work() if known else None)

    @property
    def energy(self) -> float:
        """e by its definition, with the torques' work, J."""
        promised, K = self.promised, self.promised.kappa * T * np.linalg.inv(self.level)
        received = 0.0
        for w, f, before in self.course.ticks:
            y = (w + K @ (f - before)) / T
            received += T * float(f @ y) - T * promised.share * float(y @ self.level @ y)
        return received - self.done + self.burned

    @property
    def burned(self) -> float:
        """What the device burned at least, J."""
        return sum(float(d @ self.osp @ d) / h for _, d, h in self.course.pieces if h > 0.0)
