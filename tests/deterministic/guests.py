"""A guest with a valid key that keeps within its declared limits, and does its worst there: strategies by a seed.

What a guest can choose: when its samples leave, what their stamps claim, how its device moves whatever it feels,
whether it sends telemetry, and when it goes and comes. A strategy is one choice of each. An honest guest is one, too.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from random import Random
from typing import Final

from manyhands.nodes.device.core import Guard
from manyhands.nodes.device.drivers import Driver
from manyhands.nodes.device.node import DeviceNode
from manyhands.nodes.kernel.bundle import DeviceBundle, Limits
from manyhands.protocol.clock import Duration, Instant, from_seconds
from manyhands.protocol.codec import decode, encode
from manyhands.protocol.limits import MAX_CONTROL_BYTES, MAX_COUNT
from manyhands.protocol.messages import Figures, Sample
from manyhands.protocol.transport import Link, TransportError, Trouble

from .scheduler import Scheduler

WITHIN: Final = 0.98
"""Part of its declared limits that a guest's motion reaches at most: beyond them its samples are refused."""
BURST: Final = 250
"""The tick at which an honest guest's burst of late samples begins."""


class Timing(StrEnum):
    """When a sample leaves the guest."""

    IN_TIME = "in time"
    LATE = "late in every tick"
    ALTERNATING = "late in some ticks, in time in as many"
    RANDOM = "late by a random time"
    CREEPING = "later and later"
    BURST = "late in a few ticks, once"


class Stamps(StrEnum):
    """What a sample's stamp claims."""

    TRUE = "true"
    LONG = "that several periods have passed in every tick"
    RANDOM = "anything"
    STILL = "that no time passes"


class Motion(StrEnum):
    """How the guest's device moves."""

    HAND = "as a hand moves it"
    SINE = "as a sine"
    BANG = "back and forth at its greatest speed"
    AGAINST = "against the force that it is sent"
    ALONG = "along with the force that it is sent"


class Leaving(StrEnum):
    """Whether the guest stays."""

    STAYS = "stays"
    POLITELY = "leaves with a last word, comes back"
    IMPOLITELY = "leaves without a word, comes back"


@dataclass(frozen=True)
class Strategy:
    """What a guest does.

    Attributes:
        timing: of its samples.
        late: their delay, periods; the longest, where they differ.
        every: ticks late and then in time, where they alternate.
        stamps: of its samples.
        periods: that its stamps claim a tick, where they claim too many; it then moves so many times too fast.
        motion: of its device.
        frequency: of its motion, Hz.
        share: of what it might reach within its limits.
        telemetry: whether it sends any.
        leaving: whether it stays.
        stays: ticks between coming and leaving, the longest.
    """

    timing: Timing = Timing.IN_TIME
    late: float = 0.0
    every: int = 1
    stamps: Stamps = Stamps.TRUE
    periods: int = 1
    motion: Motion = Motion.HAND
    frequency: float = 1.0
    share: float = 1.0
    telemetry: bool = True
    leaving: Leaving = Leaving.STAYS
    stays: int = 300

    def __str__(self) -> str:
        """What is not as an honest guest's."""
        told = []
        if self.timing is not Timing.IN_TIME:
            ticks = f", {self.every} ticks each" if self.timing is Timing.ALTERNATING else ""
            told.append(f"{self.timing} ({self.late:.2f} T{ticks})")
        if self.stamps is not Stamps.TRUE:
            told.append(f"stamps say {self.stamps} ({self.periods})")
        if self.motion is not Motion.HAND:
            told.append(f"moves {self.motion} ({self.frequency:.1f} Hz, {self.share:.2f})")
        if not self.telemetry:
            told.append("sends no telemetry")
        if self.leaving is not Leaving.STAYS:
            told.append(f"{self.leaving} ({self.stays})")
        return "; ".join(told) or "honest"


def strategy(random: Random) -> Strategy:
    """One or several kinds of hostility; each kind alone as often as all mixtures with it."""
    kinds = ["timing", "stamps", "motion", "telemetry", "leaving"]
    chosen = set(random.sample(kinds, 1 if random.random() < 0.5 else random.randint(2, 4)))
    told = Strategy(
        late=random.uniform(0.2, 2.9),
        every=random.randint(1, 8),
        periods=random.randint(2, 6),
        frequency=math.exp(random.uniform(math.log(0.5), math.log(20.0))),
        share=random.uniform(0.3, 1.0),
        stays=random.randint(60, 300),
    )
    changes: dict[str, object] = {}
    if "timing" in chosen:
        changes["timing"] = random.choice([one for one in Timing if one not in (Timing.IN_TIME, Timing.BURST)])
    if "stamps" in chosen:
        changes["stamps"] = random.choice([one for one in Stamps if one is not Stamps.TRUE])
    if "motion" in chosen or changes.get("stamps") is Stamps.LONG:  # stamps alone gain nothing
        changes["motion"] = random.choice([one for one in Motion if one is not Motion.HAND])
    if "telemetry" in chosen:
        changes["telemetry"] = False
    if "leaving" in chosen:
        changes["leaving"] = random.choice([one for one in Leaving if one is not Leaving.STAYS])
    return Strategy(**{**vars(told), **changes})  # type: ignore[arg-type]


def honest(random: Random) -> Strategy:
    """An honest guest's, whose connection is bad for a moment."""
    return Strategy(timing=Timing.BURST, late=random.uniform(0.5, 2.0), every=random.randint(1, 10))


@dataclass
class Guest:
    """One guest in a session; its processes come and go.

    Attributes:
        name: of its device.
        strategy: what it does.
        random: decides what that leaves open.
    """

    name: str
    strategy: Strategy
    random: Random

    def lead(self, node: DeviceNode, bundle: DeviceBundle, scheduler: Scheduler) -> None:
        """Give a device's node the guest's driver, and a guard without limits."""
        if self.strategy.motion is Motion.HAND:
            return
        most = (1e300,) * len(bundle.common.ports)
        node.device.guard = Guard(Limits(most, most, most), bundle.common.period, bundle.common.ports)
        node.device.driver = self.driver(bundle, scheduler)

    def driver(self, bundle: DeviceBundle, scheduler: Scheduler) -> Driver:
        """The driver of its device."""
        T, realtime = bundle.common.period, bundle.common.clock == "realtime"
        began = scheduler.now

        def time(turn: int) -> float:
            return (scheduler.now - began) / 1e9 if realtime else turn * T

        return PushingDriver(self.strategy, bundle.limits, T, time)

    def delay(self, tick: int, period: Duration) -> Duration:
        """The delay with which the sample of ``tick`` leaves, ns."""
        plan = self.strategy
        match plan.timing:
            case Timing.IN_TIME:
                late = 0.0
            case Timing.LATE:
                late = plan.late
            case Timing.ALTERNATING:
                late = plan.late if tick // plan.every % 2 else 0.0
            case Timing.RANDOM:
                late = self.random.uniform(0.0, plan.late)
            case Timing.CREEPING:
                late = min(plan.late, 0.01 * tick)
            case Timing.BURST:
                late = plan.late if 0 <= tick - BURST < plan.every else 0.0
        return Duration(round(late * period))

    def claim(self, tick: int, stamp: Instant, period: Duration) -> Instant:
        """The stamp of the sample of ``tick``, ns."""
        match self.strategy.stamps:
            case Stamps.TRUE:
                return stamp
            case Stamps.LONG:
                return Instant(stamp + tick * (self.strategy.periods - 1) * period)
            case Stamps.RANDOM:
                return Instant(self.random.choice([0, MAX_COUNT, self.random.randrange(10**13)]))
            case Stamps.STILL:
                return Instant(0)


class PushingDriver:
    """A device that moves as its user's machine wishes, whatever it is sent."""

    def __init__(self, plan: Strategy, limits: Limits, T: float, time: Callable[[int], float]) -> None:
        self.axes = len(limits.force)
        self._plan, self._time, self._T = plan, time, T
        fast = plan.periods if plan.stamps is Stamps.LONG else 1
        self._speed = [WITHIN * plan.share * fast * most for most in limits.speed]
        self._reach = [WITHIN * most for most in limits.displacement]
        self._x = [0.0] * self.axes
        self._f: Sequence[float] = self._x
        self._t: float | None = None

    def sample(self, tick: int, at: Instant) -> Sequence[float]:
        """Where it is."""
        t = self._time(tick)
        passed = 0.0 if self._t is None else t - self._t
        self._t = t
        self._x = [self._at(axis, t, passed) for axis in range(self.axes)]
        return self._x

    def _at(self, axis: int, t: float, passed: float) -> float:
        plan, speed, reach = self._plan, self._speed[axis], self._reach[axis]
        match plan.motion:
            case Motion.SINE:
                omega = 2.0 * math.pi * plan.frequency
                return min(reach, speed / omega) * math.sin(omega * t)
            case Motion.BANG:
                amplitude = min(reach, speed / (4.0 * plan.frequency))
                return amplitude * (2.0 / math.pi) * math.asin(math.sin(2.0 * math.pi * plan.frequency * t))
            case _:
                way = math.copysign(1.0, self._f[axis]) * (1.0 if plan.motion is Motion.ALONG else -1.0)
                return max(-reach, min(reach, self._x[axis] + way * speed * passed))

    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> Sequence[float]:
        """Ignore the force."""
        self._f = list(f)
        return self._x

    def release(self, at: Instant) -> Sequence[float]:
        """No force."""
        return self.apply([0.0] * self.axes, at)

    def idle(self, due: Instant) -> None:
        """Nothing is put off."""

    def intended_work(self) -> float:
        """Report none."""
        return 0.0

    def figures(self) -> Figures:
        """Report no figures."""
        return Figures()

    def close(self) -> None:
        """Nothing is held."""


class GuestLink:
    """A guest's end of a link: its samples leave when and as it wishes."""

    def __init__(self, link: Link, guest: Guest, scheduler: Scheduler, period: float) -> None:
        self._link, self._guest, self._scheduler, self._period = link, guest, scheduler, from_seconds(period)
        self._leaves = Instant(0)
        self.recv = link.recv

    def send(self, frame: bytes) -> bool:
        """Send a frame; a sample leaves late and with the strategy's stamp."""
        message = decode(frame, MAX_CONTROL_BYTES)
        if not isinstance(message, Sample):
            return self._link.send(frame)
        guest, now = self._guest, self._scheduler.now
        told = encode(Sample(message.tick, guest.claim(message.tick, message.stamp, self._period), message.values))
        leaves = Instant(max(self._leaves, now + guest.delay(message.tick, self._period)))
        if leaves <= now:
            return self._link.send(told)
        self._leaves = leaves
        self._scheduler.at(leaves, lambda: self._send_late(told))
        return True

    def _send_late(self, frame: bytes) -> None:
        """Send a delayed sample, unless the link is closed or its process is gone by then."""
        with suppress(TransportError):
            self._link.send(frame)

    def trouble(self) -> Trouble | None:
        """None that is known."""
        return self._link.trouble()

    def close(self) -> None:
        """Close this end."""
        self._link.close()
