"""A device's tick without its I/O: its energy ledger (:class:`DeviceCore`) and its limits (:class:`Guard`).

**The promise.** The device with its hand promises that G_hat is (share Delta_D)-OSP, from force F to

    y(k) = (x(k) - x(k-1))/T + K (F(k) - F(k-1))/T,    K = kappa T Delta_D^{-1}    ((7)-(9) of [Bianchini2010]_),

with share = 1 and kappa = 1/2 without delay, and what :mod:`manyhands.design.levels.device` gives for a delay inside
the tick.

For a device in wall time, x and f are what its couplings received and asked for
(:mod:`manyhands.nodes.device.interface`). Lateness may then lower the ledger below zero, by the interface's tank at the
most where it is bounded.

The *intention* of the hand is no part of that promise. Where it is known, as for a simulated hand, the work that it did
is added to the ledger.

**The limits.** The device itself checks what it exerts and where it is, so its safety needs no trust in another
process. A force beyond its limit is clipped, last before the actuator. The couplings clip to the same limits already,
so a force that is clipped here means that a coupling misbehaves.

A device beyond its displacement or its speed **lets go**: between it and its couplings stands an ideal transformer like
the environment's clutch (:mod:`manyhands.nodes.environment.clutch`), whose ratio s falls to 0 at once,

    x'(k) - x'(k-1) = s(k-1) (x(k) - x(k-1)),      f_applied(k) = s(k) f(k),

with x the device's own displacement, x' the displacement sent to its couplings, and f the force that they ask for. So
the device exerts no force, its tool stays where it is, and the session goes on. Once the device has been within its
limits for :data:`RETURN` periods, s rises by the same ramp as after every return. The force that x(k) moved against was
applied with s(k-1), so the work that the couplings compute is the work that was done: with v'(k) = s(k-1) v(k),

    f(k-1)^T T v'(k) = f_applied(k-1)^T T v(k)  >=  storage difference + T v(k)^T Delta_D v(k),      |v'| <= |v|,

and the device's promise holds of x' and f as it does of x and f_applied, whatever s does (docs/decisions/0029).

A device that *leaves* lets go by the same ramp, downwards, and does not take hold again. So its own hand feels no step,
and the promise holds as above.

A force that comes too late is not decided here: :mod:`manyhands.nodes.device.node` stops waiting for it, and exerts
none.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from manyhands.design.models.axis import TRANSLATING, AxisKind, Units
from manyhands.nodes.kernel.arithmetic import Floats, Saturation, dot, linear_map, minus, plus
from manyhands.nodes.kernel.bundle import Limits
from manyhands.nodes.kernel.passivity import Ledger

Vector = NDArray[np.float64]


class DeviceCore:
    """The state of one device between ticks.

    Attributes:
        ledger: its energy ledger.
        speed: Euclidean norm of the backward-difference velocity at the last tick, m/s.
        peak_speed: the greatest speed so far, m/s.
    """

    def __init__(self, level: Vector, K: Vector, T: float, allowed: float = 0.0) -> None:
        """Start at rest in x = 0.

        Args:
            level: share Delta_D of this device, m_i x m_i, N*s/m.
            K: kappa T Delta_D^{-1}, m_i x m_i, m/N.
            T: period, s.
            allowed: how far the ledger may fall below 0, J.
        """
        self._T = T
        self.change(level, K)
        self._x: Floats = [0.0] * level.shape[0]
        self._f, self._velocity = self._x, self._x
        self.ledger = Ledger(allowed)
        self.speed = 0.0
        self.peak_speed = 0.0

    def change(self, level: Vector, K: Vector) -> None:
        """Promise a different level from now on; call this only where no force is applied, for there both are at rest.

        Args:
            level: share Delta_D of this device, m_i x m_i, N*s/m.
            K: kappa T Delta_D^{-1}, m_i x m_i, m/N.
        """
        self._level, self._K_over_T = linear_map(level), linear_map(K / self._T)

    def sample(self, x: Floats, speed: float | None = None) -> None:
        """Take the displacement x(k), m; the list is kept until the next call.

        Args:
            x: what the couplings received.
            speed: the device's own, m/s; None for that of x over one period.
        """
        T = self._T
        self._velocity = [step / T for step in minus(x, self._x)]
        self._x = x
        self.speed = speed = math.hypot(*self._velocity) if speed is None else speed
        if speed > self.peak_speed:
            self.peak_speed = speed

    def apply(self, f: Floats, intended_work: float) -> None:
        """Take the force f_v(k) that is applied from now on, N.

        Args:
            f: f_v(k); the list is kept until the next call.
            intended_work: the work of the hand's intention since the last sample, J; 0 where it is unknown.
        """
        change = self._K_over_T(minus(f, self._f))
        y = plus(self._velocity, change)
        self.ledger.enter(self._T * (dot(f, y) - dot(y, self._level(y))) + intended_work)
        self._f = f


RETURN: Final = 100
"""Periods that a device must be within its limits before it takes hold again; the ramp to s = 1 has as many."""


class Guard:
    """The limits of one device, and the ratio s by which it lets go.

    Attributes:
        armed: whether it lets go at a breach. It always does, except where an audit follows a device that did not,
            through samples that are not all known.
        let_go: how often the device has let go.
        leaving: whether it lets go for good, because it leaves.
        why: which limit it exceeded when it let go last, in one sentence; empty if it never did.
        pace: the greatest speed at which it came beyond a limit since :meth:`take_pace`, m/s. A sample in a period
            without a force has no row, so that no row may tell it.
    """

    def __init__(self, limits: Limits, T: float, axes: Sequence[str], kinds: Sequence[AxisKind] = ()) -> None:
        """Watch from the first sample on.

        Args:
            limits: displacement, speed and force, one entry for each axis.
            T: period, s.
            axes: the device's ports, for the sentences.
            kinds: what each axis does, likewise; without them all translate.
        """
        self._axes, self._T = tuple(axes), T
        self._units = [Units.of([kind]) for kind in kinds] or [TRANSLATING] * len(axes)
        self._displacement, self._speed = limits.displacement, limits.speed
        self._saturation = Saturation(limits.force)
        self._before: Floats | None = None
        self._reported: Floats | None = None  # x'(k), where it is not x(k)
        self._ratio, self._rises, self._within = 1.0, RETURN, 0
        self.armed, self.leaving = True, False
        self.let_go, self.why = 0, ""
        self.pace = 0.0

    def take_pace(self) -> float:
        """:attr:`pace`, which begins anew, m/s."""
        taken, self.pace = self.pace, 0.0
        return taken

    @property
    def clipped(self) -> int:
        """Ticks whose force was clipped here."""
        return self._saturation.ticks

    @property
    def holds(self) -> bool:
        """Whether s > 0: the device exerts a force."""
        return self._ratio > 0.0

    @property
    def ratio(self) -> float:
        """s(k), 0 ... 1."""
        return self._ratio

    def leave(self) -> None:
        """From now on s falls to 0 by the ramp, and stays there."""
        self.leaving = True

    def report(self, x: Floats, periods: int = 1) -> Floats:
        """x'(k), m, for the displacement x(k), m: ``x`` itself as long as the device has never let go.

        Args:
            x: the device's own displacement, m.
            periods: the periods since the sample before; more than one where a tick was late.
        """
        before = self._before or x
        breach = self.breach(x, periods)
        if breach is not None:
            self.pace = max(self.pace, _finite(math.dist(x, before)) / (self._T * periods))
        if (breach is None or not self.armed) and self._reported is None and not self.leaving:
            return x
        reported, ratio = self._reported or before, self._ratio
        moved = [at + _finite(ratio * (to - last)) for at, to, last in zip(reported, x, before, strict=True)]
        self._reported = kept = self._within_limits(moved, reported, self._T * periods)
        if breach is None and kept != moved:
            breach = (
                f"{self._axes[0]} would report a position beyond its limits, counted from where it had let go; "
                "it lets go once more"
            )
        self._follow(breach)
        return kept

    def breach(self, x: Floats, periods: int = 1) -> str | None:
        """Which limit the displacement x(k), m, exceeds, in one sentence; None if it is within its limits.

        The first sample has no speed: a device may be switched on anywhere within its reach. ``x`` is kept until the
        next call, for its speed.
        """
        before, self._before = self._before or x, x
        T = self._T * periods
        for axis in range(len(x)):
            at, last = x[axis], before[axis]
            if not abs(at) <= self._displacement[axis]:
                return self._sentence(axis, "displacement", at, self._displacement[axis], "m")
            if not abs(at - last) <= T * self._speed[axis]:
                return self._sentence(axis, "speed", (at - last) / T, self._speed[axis], "m/s")
        return None

    def clip(self, f: Floats) -> Floats:
        """The force to apply for f_v(k), N: s times the force within every axis' limit; a clipped tick is counted."""
        held = self._saturation.clip(f)
        return held if self._ratio == 1.0 else [self._ratio * force for force in held]

    def _within_limits(self, moved: Floats, reported: Floats, T: float) -> Floats:
        """``moved``, m, or as much of the way there from ``reported``, m, as the limits of reach and speed allow."""
        kept = []
        for to, at, reach, speed in zip(moved, reported, self._displacement, self._speed, strict=True):
            kept.append(max(-reach, min(reach, max(at - T * speed, min(at + T * speed, to)))))
        return kept

    def _follow(self, breach: str | None) -> None:
        """Choose s(k): 0 at a breach; after :data:`RETURN` periods without one it rises by the ramp.

        Of a device that leaves it falls by the same ramp.
        """
        if breach is not None:
            if self._ratio > 0.0:
                self.let_go += 1
                self.why = breach
            self._ratio, self._rises, self._within = 0.0, 0, 0
            return
        self._within += 1
        if self.leaving:
            self._rises = max(0, self._rises - 1)
        elif self._within > RETURN and self._rises < RETURN:
            self._rises += 1
        else:
            return
        self._ratio = 1.0 if self._rises == RETURN else math.sin(0.5 * math.pi * self._rises / RETURN) ** 2

    def _sentence(self, axis: int, quantity: str, found: float, limit: float, unit: str) -> str:
        own = self._units[axis](unit)
        return (
            f"found a {quantity} of {found:.6g} {own} at {self._axes[axis]}; expected at most {limit:g} {own}, its "
            "limit; see what moved it, or raise the limit in the session file"
        )


def _finite(by: float) -> float:
    return by if math.isfinite(by) else 0.0
