"""A device behind its interface that an adversary moves: every piece of its motion is booked exactly.

The adversary chooses everything that the device does not: where the device moves, what the couplings answer, and when
each sample is taken and each force applied.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from manyhands.design.levels.contract import DeviceShare
from manyhands.design.levels.device import device_share, least_gain
from manyhands.design.levels.dry_friction import DryFriction
from manyhands.nodes.device.interface import DeviceInterface
from manyhands.nodes.kernel.allowance import LatenessAllowance
from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.kernel.inertia import Inertia
from manyhands.protocol.clock import Duration, Instant

T = 1e-3
TICK = 1_000_000  # ns
SPEED = 1.0
E_0 = 5e-3
STALE = Duration(6 * TICK)
Array = NDArray[np.float64]

GRID: Final = 100_000
"""ns; a device that is pushed has a place at every such instant, so that samples with a latency are true."""

OSP = {
    "one axis": np.array([[1.37]]),
    "two axes": np.diag([0.5, 4.0]),
    "joined axes": np.array([[2.0, 0.9], [0.9, 1.0]]),
}


def promise(tau: float, above: float) -> DeviceShare:
    """What a certificate with this delay (s) promises, with kappa a part ``above`` its least."""
    kappa = least_gain(tau / T) * (1.0 + above)
    share = device_share(kappa, tau / T)
    return DeviceShare(kappa, share.share, share.c)


@dataclass
class Course:
    """What a device did, as the definition of e needs it: pieces of constant force, and ticks with their answers."""

    pieces: list[tuple[Array, Array, float]] = field(default_factory=list)
    ticks: list[tuple[Array, Array, Array]] = field(default_factory=list)

    def energy(self, osp: Array, promised: DeviceShare, friction: DryFriction | None = None) -> float:
        """e by its definition, J."""
        level = osp if friction is None else friction.raised(osp)
        K = promised.kappa * T * np.linalg.inv(level)
        received = 0.0
        for w, f, before in self.ticks:
            y = (w + K @ (f - before)) / T
            received += T * float(f @ y) - T * promised.share * float(y @ level @ y)
        done = sum(float(r @ d) - float(d @ osp @ d) / h for r, d, h in self.pieces if h > 0.0)
        if friction is not None:
            done -= sum(float(np.array(friction.least) @ np.abs(d)) for _, d, _ in self.pieces)
        return received - done


class Device:
    """A device that an adversary moves; it books every piece of its motion exactly.

    Its time is that of its forces: with a latency, in ns, a sample has the place of so much earlier. With ``steps`` its
    displacements are measured: each is off by ``noise``, which the adversary chooses within half a step.

    Attributes:
        noise: of what is measured, m.
        gone: the way on each axis, m.
        velocity: of a device that is pushed, m/s.
        beyond: by tick, the energy that a motion beyond the limit of speed has cost more than any within it, J.
    """

    def __init__(
        self,
        osp: Array,
        promised: DeviceShare,
        tau: float,
        tank: float | None,
        latency: int = 0,
        inertia: Inertia | None = None,
        speed: float = SPEED,
        power: float = 0.0,
        friction: DryFriction | None = None,
        steps: Floats | None = None,
    ) -> None:
        m = len(osp)
        self.osp, self.promised, self.latency, self.friction = osp, promised, latency, friction
        allowed = None if tank is None else LatenessAllowance(tank, power)
        self.interface = DeviceInterface(
            osp, promised, tau, 0.0, T, (speed,) * m, STALE, allowed, Duration(latency), inertia, None, friction, steps
        )
        self.noise, self.gone = np.zeros(m), np.zeros(m)
        self.x, self.now, self.f = np.zeros(m), 0, np.zeros(m)
        self.sent, self.velocity = np.zeros(m), np.zeros(m)
        self.course = Course()
        self.exerted, self.until = np.zeros(m), None
        self.places = [(-latency, self.x), (0, self.x)]
        self.beyond = [0.0]

    def move(self, velocity: Array, until: int) -> None:
        """Move at a constant velocity, m/s; the force may end by itself on the way."""
        ends = self.until
        for at in [until] if ends is None or not self.now < ends < until else [ends, until]:
            h = (at - self.now) * 1e-9
            r = self.exerted if ends is None or self.now < ends else np.zeros(len(self.x))
            d = velocity * h
            self.course.pieces.append((r, d, h))
            if h > 0.0:
                cost = float(r @ d) - float(d @ self.osp @ d) / h
                if self.friction is not None:
                    cost -= float(np.array(self.friction.least) @ np.abs(d))
                self.beyond[-1] += max(0.0, cost - h * self.interface.account.cost(r.tolist()))
            self.x, self.now, self.gone = self.x + d, at, self.gone + np.abs(d)
            self.places.append((at, self.x))

    def push(self, ways: Array, brakes: Array, until: int, true: Inertia) -> None:
        """Brake at once to so much of the velocity, and then speed up by so much of what inertia and hand allow.

        Args:
            ways: by axis, from -1 to 1.
            brakes: by axis, from 0 to 1.
            until: the end, ns.
            true: what the device really weighs, and how strong its hand really is.
        """
        self.velocity = v = brakes * self.velocity
        while self.now < until:
            at = min(until, self.now - self.now % GRID + GRID)
            if self.until is not None and self.now < self.until < at:
                at = self.until
            h = (at - self.now) * 1e-9
            r = self.exerted if self.until is None or self.now < self.until else np.zeros(len(self.x))
            a = ways * (np.array(true.hand) + np.abs(r)) / np.array(true.mass)
            d = v * h + 0.5 * a * h * h
            self.course.pieces.append((r, d, h))
            self.x, self.now, self.velocity = self.x + d, at, v + a * h
            v = self.velocity
            self.places.append((at, self.x))

    def _taken(self) -> Array:
        at = self.now - self.latency
        while self.places[1][0] < at:
            del self.places[0]
        (begin, first), (end, last) = self.places[:2]
        return last if end <= at else first + (last - first) * ((at - begin) / (end - begin))

    def send(self) -> None:
        x = (self._taken() + self.noise).tolist()
        sent = np.array(self.interface.send(x, x, Instant(self.now)))
        if self.interface.shortened:
            assert self.until is None or self.now <= self.interface.until <= self.until
            self.until = self.interface.until
        self.w, self.sent = sent - self.sent, sent
        self.beyond.append(0.0)

    def answer(self, f: Floats, known: bool = True, part: float = 1.0) -> None:
        """Take the couplings' answer, N; motors that are limp exert but a ``part`` of what they are given."""
        held, until = self.interface.force(f, f, Instant(self.now))
        self.course.ticks.append((self.w, np.array(f), self.f))
        self.f = np.array(f)
        exerted = held if part == 1.0 else [part * force for force in held]
        self.exerted, self.until = np.array(exerted), until
        known = known and not self.latency
        self.interface.applied((self.x + self.noise).tolist() if known else None, Instant(self.now), exerted, until)

    @property
    def energy(self) -> float:
        return self.course.energy(self.osp, self.promised, self.friction)

    @property
    def scale(self) -> float:
        """The size of the terms of the sums, J, of which rounding is a part."""
        return 1.0 + sum(abs(float(r @ d)) for r, d, _ in self.course.pieces)
