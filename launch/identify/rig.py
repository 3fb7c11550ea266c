"""A driver in a loop of its own that moves its device within bounds, and lets go whatever happens (:class:`Rig`).

Every tick looks at what could be wrong before it exerts anything: the user's key, the way from the place where the
motion began, the speed, and the device's own workspace. Where a tick that came late is why, that is what is said
(:class:`Late`). A force ends by itself after :data:`HOLD`. However a run ends, the driver is released, and the rig's
``close`` closes it.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field

from manyhands.nodes.device.plugin import PluginDriver
from manyhands.nodes.device.specification import DeviceSpecification
from manyhands.nodes.kernel.arithmetic import Floats, minus, plus
from manyhands.nodes.rows import figures as names
from manyhands.protocol.clock import Clock, Duration, Instant, from_seconds, seconds

Controller = Callable[[Floats, Floats, float], Floats]
"""Displacement (m), velocity (m/s) and time since the run began (s) -> force (N)."""

HOLD = from_seconds(0.02)
"""After that a force ends by itself, though no call follows, ns."""

SPAN = 0.01
"""s; a controller is told the mean place over that, and the velocity between two of them: encoder steps and varying
ages would make its force restless, and a restless force is a wide interval."""

MOST_TICKS = 2.5
"""Periods by which the wanted motion goes on in a tick at most."""

OLDER = "older_than_stated"
"""The figure in which drivers count displacements that are older than they state."""

COASTS = 0.5
"""s after a tick whose force had ended, in which a bound that is left is that tick's fault."""

STALLED = 0.5
"""Periods that a call for a displacement may take; beyond that the speed is known less well than is judged."""

LOOK_EVERY = 0.02
"""s from one look at the user's key to the next."""


class Aborted(Exception):
    """The motion ended early; the message says why, and the device was released."""


class Late(Aborted):
    """A bound ended the motion, and the machine is why, for it gave the loop no turn: it may be tried again."""


@dataclass(frozen=True)
class Safety:
    """How the device may be moved.

    Attributes:
        force: the greatest on each axis, N.
        travel: the greatest wanted way from the place where the motion began, m.
        speed: the greatest wanted speed along any line, m/s.
    """

    force: float = 2.0
    travel: float = 0.03
    speed: float = 0.25


@dataclass
class MotionLog:
    """What happened in a run, by tick; ``phase`` is the time of the wanted motion, s."""

    phase: list[float] = field(default_factory=list)
    sampled: list[float] = field(default_factory=list)
    x: list[Floats] = field(default_factory=list)
    applied: list[float] = field(default_factory=list)
    f: list[Floats] = field(default_factory=list)
    extra: list[float] = field(default_factory=list)
    stale: list[bool] = field(default_factory=list)
    """Whether the driver counted the displacement as older than it states."""
    asked: list[float] = field(default_factory=list)
    """How long the driver's ``sample`` took, s; ``gave`` is its ``apply``."""
    gave: list[float] = field(default_factory=list)


class Rig:
    """A driver, moved tick by tick.

    Attributes:
        origin: where the present motion began, m.
        stop: whether the user wants an end; asked every :data:`LOOK_EVERY`.
        ticks: how many there were.
        late: how many of them came later than half a period after the last one's next.
        longest: the longest time between two, s.
        stale: how many displacements were older than the driver states, by its own count.
    """

    def __init__(
        self,
        driver: PluginDriver,
        stated: DeviceSpecification,
        T: float,
        clock: Clock,
        safety: Safety,
        stop: Callable[[], bool] = lambda: False,
        turns: Callable[[], AbstractContextManager[object]] = nullcontext,
    ) -> None:
        """Begin at the clock's present instant.

        Args:
            driver: the driver.
            stated: what it states.
            T: period, s.
            clock: paces the ticks.
            safety: how the device may be moved.
            stop: whether the user wants an end.
            turns: what gives the loop its turns while it runs.
        """
        self.T, self.safety, self.stated = T, safety, stated
        self._driver, self._clock, self.stop, self._turns = driver, clock, stop, turns
        self._epoch, self._slot, self._tick = clock.now(), 0, 0
        self._period = from_seconds(T)
        self.force = [min(safety.force, limit) for limit in stated.force]
        self._works = stated.holds_torque and driver.tells_work
        self._units = stated.units_by_axis
        self._span = max(1, round(SPAN / T))
        self._past: deque[Floats] = deque()
        self._means: deque[Floats] = deque()
        self._sum: Floats = []
        self._last: tuple[Floats, Floats] | None = None  # displacement and force of the tick before
        self._looked = -math.inf
        self._coasts, self._unsure = (-math.inf, ""), (-math.inf, "")  # until when the machine is why, and the words
        self._old = 0  # displacements that were too old
        self.ticks = self.late = self.stale = 0
        self.longest = 0.0
        self.origin = self._sampled()[1]

    def run(self, control: Controller, duration: float, reach: float) -> MotionLog:
        """Exert what ``control`` says for so long.

        Args:
            control: the controller.
            duration: of the wanted motion, s.
            reach: the greatest way from :attr:`origin` on any axis, m; beyond that the motion is aborted.

        Raises:
            Aborted: the user, the device or a bound ended it.
            DriverFailure: the driver failed.
        """
        with self._turns():
            return self._run(control, duration, reach)

    def _run(self, control: Controller, duration: float, reach: float) -> MotionLog:
        log, phase, before = MotionLog(), 0.0, None
        try:
            while True:
                at, x = self._sampled()
                took = seconds(Duration(self._now())) - at
                log.asked.append(took)
                if took > STALLED * self.T:
                    words = f"a call of the driver took {1e3 * took:.3g} ms, within which nobody knows when it read:"
                    self._unsure = at + took + 2.0 * SPAN + self.T, words
                # after a tick that came late the wanted motion goes on where it was, and not where it would be
                phase += 0.0 if before is None else min(at - before, MOST_TICKS * self.T)
                stale = self._count(at, before)
                before = at
                if phase >= duration:
                    return log
                place, v = self._smooth(at, x)
                self._look(at, x, v, reach)
                f = [
                    max(-most, min(most, value))
                    for value, most in zip(control(place, v, phase), self.force, strict=True)
                ]
                log.extra.append(self._extra(x))
                now = self._now()
                self._driver.apply(f, now, Instant(now + HOLD))
                log.gave.append(seconds(Duration(self._now() - now)))
                self._last = x, f
                log.stale.append(stale)
                log.phase.append(phase)
                log.sampled.append(at)
                log.x.append(x)
                log.applied.append(seconds(Duration(now)))
                log.f.append(f)
                self._driver.exerted(f)
                self._driver.idle(Instant(self._slot * self._period))
        finally:
            self._last = None
            self.release()

    def release(self) -> None:
        """Exert no force."""
        self._driver.release(self._now())

    def close(self) -> None:
        """Release and close the driver."""
        try:
            self.release()
        finally:
            self._driver.close()

    def here(self) -> Floats:
        """Where the device is now, m; the next motion begins there."""
        self._past.clear()
        self._means.clear()
        self.origin = self._sampled()[1]
        return self.origin

    def _sampled(self) -> tuple[float, Floats]:
        self._clock.sleep_until(Instant(self._epoch + self._slot * self._period))
        at = self._now()
        x = list(self._driver.sample(self._tick, at))
        self._tick += 1
        # a tick that came late is not made up for
        self._slot = max(self._slot + 1, -((self._epoch - self._clock.now()) // self._period))
        return seconds(Duration(at)), x

    def _count(self, at: float, before: float | None) -> bool:
        """Count this tick; returns whether its displacement is older than the driver states."""
        gap = self.T if before is None else at - before
        self.ticks += 1
        self.late += gap > 1.5 * self.T
        self.longest = max(self.longest, gap)
        if gap > seconds(HOLD):
            words = f"a tick came {1e3 * gap:.3g} ms after the one before, when its force had ended, and"
            self._coasts = at + COASTS, words
        own = self._driver.figures().tables.get(names.DRIVER, {})
        old = int(own.get(OLDER, 0.0))
        stale, self._old = old > self._old, old
        self.stale += stale
        return stale

    def _extra(self, x: Floats) -> float:
        """The work of the motors since the last sample beyond f^T dx, J."""
        if not self._works:
            return 0.0
        done = self._driver.work()
        if self._last is None or done is None:
            return 0.0
        before, f = self._last
        return done - sum(F * (b - a) for F, a, b in zip(f, before, x, strict=True))

    def _smooth(self, at: float, x: Floats) -> tuple[Floats, Floats]:
        """The mean place over the last :data:`SPAN`, m, and the velocity from the one before that, m/s.

        The velocity is by the mean instants of both: after a tick that came late they are not a span apart.
        """
        past, means = self._past, self._means
        timed = [at, *x]
        if not past:
            self._sum = [0.0] * len(timed)
        past.append(timed)
        self._sum = plus(self._sum, timed)
        if len(past) > self._span:
            self._sum = minus(self._sum, past.popleft())
        now = [total / len(past) for total in self._sum]
        means.append(now)
        before = means.popleft() if len(means) > self._span else means[0]
        span, *way = minus(now, before)
        return now[1:], [one / max(self.T, span) for one in way]

    def _look(self, at: float, x: Floats, v: Floats, reach: float) -> None:
        if at - self._looked >= LOOK_EVERY:
            self._looked = at
            if self.stop():
                raise Aborted("stopped by a key; no force is exerted")
        axes, stated = self.stated.axes, self.stated
        for axis, (place, begin, speed) in enumerate(zip(x, self.origin, v, strict=True)):
            m, mm, per_second = (self._units[axis](unit) for unit in ("m", "mm", "m/s"))
            if abs(place - begin) > reach:
                found = f"moved by {1e3 * (place - begin):.3g} {mm}; expected at most {1e3 * reach:.3g} {mm}"
                why = ": somebody pushed it, or its force is wrong (manyhands check-driver)"
            elif abs(place) > (most := stated.displacement[axis]):
                found = f"is at {place:.4g} {m}; expected within ±{most:g} {m}"
                why = ", the device's own limit: begin nearer to the middle, or give less travel"
            elif abs(speed) > (most := stated.speed[axis]):
                found = f"moves at {speed:.3g} {per_second}; expected at most {most:g} {per_second}"
                why = ", the device's own limit: give a smaller speed"
                if at < self._unsure[0]:
                    raise Late(
                        f"{self._unsure[1]} axis {axes[axis]} seems to move at {found.removeprefix('moves at ')}"
                    )
            else:
                continue
            found = f"axis {axes[axis]} {found}"
            raise Late(f"{self._coasts[1]} {found}") if at < self._coasts[0] else Aborted(f"{found}{why}")

    def _now(self) -> Instant:
        return Instant(self._clock.now() - self._epoch)
