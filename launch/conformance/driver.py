"""The suite for drivers: it reads a device at rest, pushes it a little on each axis, falls silent, and compares.

    at rest -> on each axis: push, release, push the other way, release -> push and fall silent -> close

A push is small, short, and ends early once the device has moved by :attr:`Push.travel`. A device that does not obey on
one axis is not pushed any more. Pushes both ways make the
judgement independent of gravity and of a motion that the device has already. A real mechanism is pushed only where its
user has agreed; without a push everything about forces stays open. So it does where the driver states that no force
moves its device.

**What is judged, and from what.** With x(t) the displacement and F the force on axis i:

- *exception*, *wrong answer*: every call returns what :class:`manyhands.nodes.device.plugin.DeviceDriver` asks for.
- *blocking call*: the median of a call's durations is at most T/2, and the greatest at most T. Fewer than
  :data:`AGAIN` longer calls are not judged.
- *swapped axes*, *wrong sign*: of all axes, axis i answers F most, and in its direction. The answer is a in the fit
  x(t) = x0 + v0 t + a t^2 / 2 over the push, half the difference between both ways.
- *motion without force*: before any push a device rests, or speeds up evenly, as under gravity. One whose acceleration
  changes by more than :data:`OWN` of an answer moves by itself, and its answers say nothing. A device on a spring is
  known by the fit below with -k/m iint x added: a stiff spring drives it back within the push, and its sign is right.
- *stale sample*: the delay L of the best fit x(t) = x0 + v0 t + g t^2 + W(t - L)/m - b/m int x dt, with W the double
  integral of the pushes, is no longer than the stated latency and :data:`GRACE` periods. Samples that stay the same for
  longer than the stated age, and then jump, are stale as well.
- *wrong unit*: the mass m of that fit, or F/a, is one that a hand can move, and near the stated one. No sample is
  beyond the stated reach.
- *wrong force*: the gain, stated mass over the mass of the fit, is within :data:`GAIN` of 1. Of hardware it is not
  judged by the mass, which friction and pose change. Where the driver measures the force that it exerts, that is one it
  was given, within :data:`manyhands.nodes.device.plugin.PART` of its stated limit, in every tick.
- *wrong work*: where the driver tells the work of its motors, that is f^T dx over a push and the rest after it, within
  :data:`WORK_GAIN`, asked in every :data:`SELDOM`-th tick and, on the way back, in every one.
- *estimate*: the damping and friction of that fit with friction, in words; it judges nothing.
- *no release*: after ``release`` less than :data:`LEFT` of a is left.
- *force kept on silence*: a force that was applied until an instant ends there, though no call follows, give or take
  :data:`GRACE` periods. It is tried with the longest time for which a session of this period holds a force
  (:data:`manyhands.nodes.kernel.timeouts.HELD_TICKS`), and with one as brief as can be seen. How long it lasted follows
  from the way that the device has gone when it is read again.

**Orientation.** Where the driver tells one, it is read with every sample. A driver that states a torque is pushed by
torques about its three axes, too, and all that is said above of forces is judged of them, with the turn in place of the
displacement. Its forces are exerted together with a torque of 0.

- *wrong answer*: an orientation is a unit quaternion.
- *jumping orientation*: from one sample to the next it turns no further than at the stated speed. A quaternion and its
  opposite are the same.
- *torque without being asked*: before any force, and while a force acts alone, the device speeds up by less than
  :data:`LEFT` of its answer to a torque.

The suite can judge what it moves: a hand that holds the device, or much dry friction, leaves checks open. It proves
nothing about a driver that behaves differently later.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from manyhands.design.levels.device import least_gain
from manyhands.design.models.axis import AxisKind, Units
from manyhands.launch.conformance.judgement import Conformance, Judgement, broken
from manyhands.launch.conformance.timing import CallTimer
from manyhands.nodes.device.drivers import Driver
from manyhands.nodes.device.plugin import PART, DriverFailure, PluginDriver
from manyhands.nodes.device.specification import DeviceSpecification
from manyhands.nodes.kernel.orientation import Quaternion, angle, difference
from manyhands.nodes.kernel.timeouts import HELD_TICKS
from manyhands.protocol.clock import Clock, Instant, SimulatedClock, from_seconds

Array = NDArray[np.float64]
_R = TypeVar("_R")

EXCEPTION: Final = "exception"
WRONG_ANSWER: Final = "wrong answer"
BLOCKING: Final = "blocking call"
STALE: Final = "stale sample"
SWAPPED: Final = "swapped axes"
SIGN: Final = "wrong sign"
MOTION: Final = "motion without force"
UNIT: Final = "wrong unit"
FORCE: Final = "wrong force"
WORK: Final = "wrong work"
RELEASE: Final = "no release"
ESTIMATE: Final = "estimate"
SILENCE: Final = "force kept on silence"
CLOSE: Final = "close"
JUMP: Final = "jumping orientation"
TORQUE: Final = "torque without being asked"

REST_TICKS: Final = 200
"""Ticks in which the device is only read."""

PUSH_TICKS: Final = 60
"""Ticks of a push, and of the time after it."""

SILENT_TICKS: Final = 50
"""Ticks of silence, of which a force may last the first ones."""

SILENT_TIME: Final = 0.05
"""s of silence at least: a way shorter than that is known to a few steps of an encoder alone."""

BRIEF_TICKS: Final = 2
"""Ticks that a force may last where its device's account allows no more; a session asks for less and for more."""

WINDOWS: Final = 8
"""Times as long as a push, in which a device is looked at before any."""

LEAST_TICKS: Final = 15
"""Ticks of a push that ended early, without which it is not judged."""

OWN: Final = 0.5
"""The part of an answer by which the acceleration may change while no force is exerted."""

LEAST_MOTION: Final = 1e-9
"""m; a push that moves the device by less moves nothing."""

GRACE: Final = 1.5
"""Periods by which an answer may come later than stated: a force acts from one tick on, and a sample is of a tick."""

LONGEST_DELAY: Final = 40
"""Ticks; the longest delay that is looked for."""

GAIN: Final = 0.05
"""The part by which an exerted force may differ from the one that was given."""

WORK_GAIN: Final = 0.15
"""The part by which the work of the motors may differ from f^T dx: a force acts up to a tick and its delay later."""

SELDOM: Final = 5
"""Ticks from one question for the work to the next, for an answer must be all that was done since the last one."""

AGAIN: Final = 3
"""Calls longer than a period that no busy machine explains: what waits for its device does so again and again."""

TURNS: Final = ("rx", "ry", "rz")
"""What a suite calls the turns about the three axes of a driver."""

LEAST_TURN: Final = 1e-6
"""rad; a device that turns by less may not have turned: a quaternion is rounded."""

LEFT: Final = 0.1
"""The part of a push that may be left after its release: what the steps of an encoder may look like."""

MASSES: Final = (0.005, 50.0)
"""kg; the masses that a hand can move, where a driver states none."""

INERTIAS: Final = (1e-6, 5.0)
"""kg·m²; likewise on an axis that turns: from a rotor of a few grams to a ship's wheel."""

KNOWN_TO: Final = 4.0
"""Steps, or noises, to which the way of two silences is known: where a line before them leads to is one of them."""

PIECES: Final = 200
"""In which a silence is computed."""

BISECTIONS: Final = 16
"""Of the time for which a force lasted."""

LOOK: Final = 0.1
"""s, from one look at a running suite to the next."""

PATIENCE: Final = 2.0
"""s; a call that takes longer is taken for one that never returns."""


@dataclass(frozen=True)
class Push:
    """How the device may be pushed.

    Attributes:
        force: N.
        travel: a push ends once the device has moved by so much, m.
        torque: about each axis of a device that exerts one beside its forces, N*m.
        turn: a torque ends once the device has turned by so much, rad.
    """

    force: float = 0.5
    travel: float = 0.01
    torque: float = 0.005
    turn: float = 0.2


@dataclass
class Stretch:
    """One stretch of ticks: when the samples were taken, and what they were.

    Attributes:
        at: s since the first tick of all.
        x: ticks x axes, m.
        R: of a device that tells its orientation, by tick; empty for others.
    """

    at: list[float] = field(default_factory=list)
    x: list[list[float]] = field(default_factory=list)
    R: list[Quaternion] = field(default_factory=list)

    @property
    def times(self) -> Array:
        """As an array, s."""
        return np.array(self.at)

    @property
    def places(self) -> Array:
        """As an array, ticks x axes, m."""
        return np.array(self.x)

    def turns(self, ticks: slice = slice(None)) -> Stretch:
        """The same ticks with the turns since the first of them in place of displacements, rad."""
        R, x = self.R[ticks], [[0.0] * 3]
        for before, now in pairwise(R):
            x.append([a + b for a, b in zip(x[-1], _turn(now, before), strict=True)])
        return Stretch(self.at[ticks], x[: len(R)])

    def __len__(self) -> int:
        return len(self.at)


def _turn(R: Quaternion, before: Quaternion) -> list[float]:
    """The rotation vector from the orientation of a tick to that of the next, rad; its length is at most pi.

    Their sum is the integral of the angular velocity, which a torque changes as a force does a velocity. It has no end
    at half a turn, as the rotation vector from an origin has.
    """
    w, *v = difference(R, before)
    size = math.hypot(*v)
    scale = 2.0 if size < 1e-12 else 2.0 * math.atan2(size, abs(w)) / size
    return [math.copysign(scale, w) * part for part in v]


@dataclass
class _Books:
    """What motors and ports did in a stretch.

    Attributes:
        every: the work of the motors is asked for in every so many-th tick.
        motors: as the driver tells it, J; infinite where it cannot.
        ports: f^T dx, J.
        size: the sum of |f^T dx|, J: a push may brake first, and then speed up.
    """

    every: int = 1
    motors: float = 0.0
    ports: float = 0.0
    size: float = 0.0


class SuiteStopped(Exception):
    """The user has ended the suite."""


class Bench:
    """A driver in a loop of its own, whose calls are timed.

    Attributes:
        driver: the driver.
        durations: of the calls, by method, ns.
        inside: the call that has not returned yet, and its number; None between calls.
        stopping: set from outside, ends the suite at the next tick.
        exerted: what the driver measured of its force in each tick of the last stretches, N, at the ports; empty for a
            driver that measures none. Whoever asks clears it.
    """

    def __init__(self, driver: Driver, T: float, clock: Clock, timer: CallTimer | None = None) -> None:
        """Begin at the clock's present instant.

        Args:
            driver: the driver.
            T: period, s.
            clock: paces the ticks: a :class:`SimulatedClock` for a counterpart that moves by the instants of the calls.
            timer: what the calls are timed by.
        """
        self.driver = self._driver = driver
        self.T, self._clock, self._timer = T, clock, timer or CallTimer()
        self._period, self._epoch = from_seconds(T), clock.now()
        self._turn = self._slot = self._calls = 0
        self._timed = True
        self.durations: dict[str, list[int]] = {}
        self.inside: tuple[str, int] | None = None
        self.stopping = False
        self.exerted: list[list[float]] = []
        self.samples = Stretch()  # all of them
        self.books = _Books()
        self._held: list[float] | None = None
        self._oriented = driver if isinstance(driver, PluginDriver) and driver.oriented is not None else None
        self._felt = driver if isinstance(driver, PluginDriver) and driver.oriented and driver.oriented.felt else None
        self._turned: list[float] | None = None  # rad, since torques are exerted

    def turns(self) -> None:
        """From now on push by torques (N*m), and take the turns from here for displacements, rad."""
        self._turned = [0.0] * 3

    def rest(self, ticks: int) -> Stretch:
        """Read the device for some ticks, with no force."""
        return self._run(ticks, None)

    def push(self, f: list[float], ticks: int, travel: float) -> Stretch:
        """Exert f (N) for some ticks, or until the device has moved by ``travel``, m."""
        return self._run(ticks, f, travel)

    def silence(self, f: list[float], lasts: int, ticks: int) -> Stretch:
        """Exert f (N) until ``lasts`` ticks are over, call nothing for ``ticks``, and read the device on both ends."""
        self._tick(None)
        now = self._now()
        until = Instant(now + lasts * self._period)
        self._exert(f, now, until)
        record = Stretch()
        self._keep(record)
        self._slot += ticks - 1
        self._timed = False  # a counterpart makes up for all of the silence in the next call
        self._tick(None)
        self._timed = True
        self._keep(record)
        return record

    def close(self) -> None:
        """Close the driver, twice."""
        self._call("close", self._driver.close)
        self._call("close", self._driver.close)

    def _run(self, ticks: int, f: list[float] | None, travel: float | None = None) -> Stretch:
        record = Stretch()
        for _ in range(ticks):
            self._tick(f)
            self._keep(record)
            moved = max(abs(now - first) for now, first in zip(record.x[-1], record.x[0], strict=True))
            if travel is not None and moved > travel:
                break
        if f is not None:
            now = self._now()
            self._call("release", lambda: self._driver.release(now))
        return record

    def _tick(self, f: list[float] | None) -> None:
        """One period: sample, and exert f (N) or nothing."""
        if self.stopping:
            raise SuiteStopped
        self._clock.sleep_until(Instant(self._epoch + self._slot * self._period))
        at, driver, turn = self._now(), self._driver, self._turn
        x = self._call("sample", lambda: driver.sample(turn, at))
        self.samples.at.append(at * 1e-9)
        self.samples.x.append(list(x))
        if self._oriented is not None:
            R = self._call("orientation", self._oriented.orientation)
            if self._turned is not None:
                more = _turn(R, self.samples.R[-1])
                self._turned = [a + b for a, b in zip(self._turned, more, strict=True)]
            self.samples.R.append(R)
        if isinstance(driver, PluginDriver) and driver.tells_work:
            self._book(driver)
        self._held = f
        if f is None:
            self._call("release", lambda: driver.release(at))
        else:
            self._exert(f, at, Instant(at + SILENT_TICKS * self._period))
        self._slot = max(self._slot + 1, -((self._epoch - self._clock.now()) // self._period))
        self._turn += 1
        if isinstance(driver, PluginDriver):
            force = [0.0] * driver.axes if f is None or self._turned is not None else f
            measured = self._call("exerted", lambda: driver.exerted(force))
            if driver.measures and f is not None and self._turned is None:
                self.exerted.append(list(measured))
        due = Instant(self._slot * self._period)
        self._call("idle", lambda: driver.idle(due))

    def _book(self, driver: PluginDriver) -> None:
        books = self.books
        if self._held is not None:
            before, now = self.samples.x[-2:]
            seen = sum(F * (b - a) for F, a, b in zip(self._held, before, now, strict=True))
            books.ports += seen
            books.size += abs(seen)
        if self._turn % books.every == 0:
            books.motors += self._call("work", driver.work) or 0.0

    def _now(self) -> Instant:
        return Instant(self._clock.now() - self._epoch)

    def _keep(self, record: Stretch) -> None:
        """Add the last tick: its displacement, or its turn while torques are exerted."""
        samples = self.samples
        record.at.append(samples.at[-1])
        record.x.append(samples.x[-1] if self._turned is None else self._turned)
        record.R += samples.R[-1:]

    def _exert(self, f: list[float], at: Instant, until: Instant) -> None:
        """Exert a force (N), or a torque (N*m) while torques are exerted."""
        driver, felt = self._driver, self._felt
        if felt is None:
            self._call("apply", lambda: driver.apply(f, at, until))
            return
        none = [0.0] * len(f)
        force, torque = (f, none) if self._turned is None else (none, f)
        self._call("apply_wrench", lambda: felt.apply_wrench(force, torque, at, until))

    def _call(self, method: str, call: Callable[[], _R]) -> _R:
        self._calls += 1
        self.inside = method, self._calls
        self._timer.begin()
        try:
            return call()
        finally:
            took = self._timer.end()
            if self._timed:
                self.durations.setdefault(method, []).append(took)
            self.inside = None


def check_driver(bench: Bench, stated: DeviceSpecification, push: Push | None) -> Iterator[Judgement]:
    """Try a driver, and close it.

    Args:
        bench: the driver in its loop.
        stated: what the driver states, at the bench's ports.
        push: how the device may be pushed; None not to push it. A device that no force moves is not pushed.
    """
    judged: list[Judgement] = []
    m = len(stated.force)
    forced: list[_Pushed] = []
    unpushed = "nothing was pushed"
    if not stated.moved_by_force:
        push, unpushed = None, "skipped: the driver states that no force moves its device (moved_by_force=False)"
    try:
        rest = bench.rest(REST_TICKS)
        for axis in range(m if push is not None else 0):
            assert push is not None  # noqa: S101
            force = min(push.force, stated.force[axis])
            f = [force if i == axis else 0.0 for i in range(m)]
            back = [-value for value in f]
            ways, books = [], []
            for way, every in ((f, SELDOM), (back, 1)):  # the first from rest, so that it brakes nothing
                bench.books = _Books(every)
                ways += [bench.push(way, PUSH_TICKS, push.travel), bench.rest(PUSH_TICKS)]
                books.append(bench.books)
            bench.books = _Books()
            pushed = _Pushed(axis, force, rest, *ways)
            forced.append(pushed)
            found = list(_judged(pushed, bench.T, stated))
            if not broken(found):  # forces and displacements are in order, so what they did is known
                found = [*_worked(bench, pushed, books, stated), *found]
            judged += found
            if broken(found):
                break  # what does not obey is not pushed any more
            if found[-1].check == RELEASE:  # all before it is in order
                judged.append(_silence(bench, pushed, f, back, stated))
        if push is not None and not broken(judged) and stated.orientation is not None and stated.orientation.felt:
            judged += _torques(bench, forced, stated, push)
    except DriverFailure as failure:
        yield _failed(failure)
        yield from _times(bench)
        return
    finally:
        closing = _closed(bench)
    yield Judgement(EXCEPTION, Conformance.KEPT, f"no call raised in {len(bench.samples)} ticks")
    yield from _times(bench)
    yield _reach(bench, stated)
    yield from _jumps(bench, stated)
    if push is None:
        for check in (STALE, SWAPPED, SIGN, RELEASE, SILENCE):
            yield Judgement(check, Conformance.OPEN, unpushed)
    yield from judged
    if not broken(judged):  # what a push has found says more
        yield from _measured(bench, stated)
    yield closing


def _torques(bench: Bench, forced: Sequence[_Pushed], stated: DeviceSpecification, push: Push) -> Iterator[Judgement]:
    """What the turns show for torques about each axis, of which everything is judged that is judged of forces.

    Args:
        bench: the driver in its loop.
        forced: the pushes by forces, in order.
        stated: what the driver states.
        push: how the device may be pushed.
    """
    of = stated.orientation
    assert of is not None  # noqa: S101
    most = of.torque or 0.0
    axes = TURNS
    turning = DeviceSpecification(
        (most,) * 3, (math.pi,) * 3, (of.speed,) * 3, stated.timing, axes, axes, hardware=stated.hardware
    )
    torque, answers = min(push.torque, most), []
    for axis in range(3):
        bench.turns()
        rest = bench.rest(REST_TICKS)
        f = [torque if i == axis else 0.0 for i in range(3)]
        back = [-value for value in f]
        ways = []
        for way in (f, back):
            ways += [bench.push(way, PUSH_TICKS, push.turn), bench.rest(PUSH_TICKS)]
        pushed = _Pushed(axis, torque, rest, *ways)
        found = list(_judged(pushed, bench.T, turning))
        yield from found
        if broken(found):
            return
        answers.append(abs(float(pushed.answer()[axis])))
        if found[-1].check == RELEASE:
            yield _silence(bench, pushed, f, back, turning)
    yield from _unasked(bench, forced, stated, min(answers), torque)


def _unasked(
    bench: Bench, forced: Sequence[_Pushed], stated: DeviceSpecification, answer: float, torque: float
) -> Iterator[Judgement]:
    """Whether a torque acts before anything is asked for, or with a force alone; ``answer`` is to ``torque``, N*m."""
    before = _acceleration(bench.samples.turns(slice(0, PUSH_TICKS)))
    cases = [("before any force", float(np.abs(before).max()))]
    for pushed in forced:
        turned = (_acceleration(pushed.there.turns()) - _acceleration(pushed.back.turns())) / 2.0
        cases.append((f"for a push of {pushed.force:g} N {pushed.words(stated)}", float(np.abs(turned).max())))
    for when, found in cases:
        if found > LEFT * answer:
            seems = torque * found / answer
            text = f"found a device that speeds up as by a torque of {seems:.2g} N·m {when}; expected none"
            free = f"{text}: let it stand free" if stated.hardware else text
            yield Judgement(TORQUE, Conformance.OPEN if stated.hardware else Conformance.BROKEN, free)
            return
    yield Judgement(TORQUE, Conformance.KEPT, "no torque acted before one was asked for, and none with a force alone")


def _jumps(bench: Bench, stated: DeviceSpecification) -> Iterator[Judgement]:
    """Whether the orientation turned further between two samples than at its stated speed; nothing without one."""
    if stated.orientation is None:
        return
    speed, jitter = stated.orientation.speed, stated.timing.jitter
    samples, fastest = bench.samples, 0.0
    for i, (R, last) in enumerate(pairwise(samples.R)):
        far, h = angle(last, R), samples.at[i + 1] - samples.at[i] + jitter
        if far > speed * h + LEAST_TURN:
            found = f"an orientation that turned by {far:.3g} rad from one sample to the next, {1e3 * h:.3g} ms later"
            text = f"found {found}; expected at most {speed * h:.3g} rad, at its stated speed of {speed:g} rad/s"
            yield Judgement(JUMP, Conformance.BROKEN, text)
            return
        fastest = max(fastest, far / h) if h > 0.0 else fastest
    told = f"{len(samples.R)} orientations, each a rotation, which turn at {fastest:.3g} rad/s at most"
    yield Judgement(JUMP, Conformance.KEPT, told)


def _worked(bench: Bench, pushed: _Pushed, books: list[_Books], stated: DeviceSpecification) -> Iterator[Judgement]:
    """Whether the motors did what the ports saw, in a push each way; nothing where the driver does not tell."""
    if not isinstance(bench.driver, PluginDriver) or not bench.driver.tells_work:
        return
    of = pushed.words(stated)
    seldom, often = books
    if not np.isfinite(often.motors + seldom.motors) or min(often.size, seldom.size) == 0.0:
        yield Judgement(
            WORK, Conformance.OPEN, f"the driver could not tell the work of a push {of}, or it moved nothing"
        )
        return
    for one, when in ((seldom, f"asked in one of {SELDOM} ticks"), (often, "asked in every tick")):
        if abs(one.motors - one.ports) > WORK_GAIN * one.size:
            found = f"found a work of {one.motors:.3g} J in a push {of}, {when}; expected {one.ports:.3g} J, f dx"
            yield Judgement(WORK, Conformance.BROKEN, f"{found}: {_fault(one.motors / one.ports)}")
            return
    yield Judgement(WORK, Conformance.KEPT, f"its motors did {often.motors:.3g} J in a push {of}, as its ports saw")


def _fault(ratio: float) -> str:
    """What may be wrong with books that are off by this factor."""
    if abs(ratio + 1.0) <= WORK_GAIN:
        return "it is that of the motors on the device, and not the other way round"
    if 0.5 < ratio * SELDOM < 1.5:
        return "it is all since the last answer, and not of the last tick alone"
    if any(abs(ratio * unit - 1.0) <= WORK_GAIN for unit in (1e3, 1e-3, 1e6, 1e-6)):
        return "it is in J, of torques in N·m and angles in rad"
    return "it is the sum of t^T (q_new - q_old) since the last answer, with the torques that were held in between"


def _failed(failure: DriverFailure) -> Judgement:
    return Judgement(EXCEPTION if failure.raised else WRONG_ANSWER, Conformance.BROKEN, str(failure))


def _closed(bench: Bench) -> Judgement:
    try:
        bench.close()
    except DriverFailure as failure:
        return Judgement(CLOSE, Conformance.BROKEN, f"{failure}; it may be called twice")
    return Judgement(CLOSE, Conformance.KEPT, "closed twice")


def _micro(value: float) -> str:
    """A time in µs: three digits, and all of a thousand and more."""
    return f"{value:.3g}" if value < 1000.0 else f"{value:.0f}"


def _times(bench: Bench) -> Iterator[Judgement]:
    """The durations of the calls of the loop."""
    T, texts = bench.T * 1e6, []
    for method in ("sample", "orientation", "apply", "apply_wrench", "release", "exerted", "work", "idle"):
        if method not in bench.durations:
            continue
        p50, most = (float(value) / 1e3 for value in np.percentile(bench.durations[method], (50, 100)))
        texts.append(f"{method} p50 {_micro(p50)} µs, at most {_micro(most)} µs")
        longer = sum(value > 1e3 * T for value in bench.durations[method])
        if p50 > T / 2 or longer:
            expected = f"a median of at most {T / 2:g} µs and never more than {T:g} µs, the period"
            if p50 <= T / 2 and longer < AGAIN:
                text = f"found {texts[-1]}, longer than the period {longer} times, as on a busy machine: check it again"
                yield Judgement(BLOCKING, Conformance.OPEN, text)
                return
            yield Judgement(BLOCKING, Conformance.BROKEN, f"found {texts[-1]}; expected {expected}")
            return
    yield Judgement(BLOCKING, Conformance.KEPT, "; ".join(texts))


def _measured(bench: Bench, stated: DeviceSpecification) -> Iterator[Judgement]:
    """The forces that the driver itself has measured; nothing where it measures none."""
    driver = bench.driver
    if not isinstance(driver, PluginDriver) or not driver.measures:
        return
    N = stated.units("N")
    if (untrue := driver.untrue).ticks:
        found = f"measured forces that it had not been given, in {untrue.ticks} ticks, by up to {untrue.most:.3g} {N}"
        expected = f"each within {PART:.0%} of its stated limit of one that it was given, within its stated delay"
    elif (limp := driver.limp).ticks:
        found = f"no force in {limp.ticks} ticks, in which it was given up to {limp.most:.3g} {N}"
        expected = "one that exerts what it is given while nothing is wrong: see its power, its watchdog and its limits"
    else:
        yield Judgement(FORCE, Conformance.KEPT, "every force that it measured is one that it was given")
        return
    yield Judgement(FORCE, Conformance.BROKEN, f"found {found}; expected {expected}")


def _reach(bench: Bench, stated: DeviceSpecification) -> Judgement:
    most = np.abs(bench.samples.places).max(axis=0)
    for axis, (found, reach) in enumerate(zip(most, stated.displacement, strict=True)):
        if found > reach:
            unit = stated.units_by_axis[axis]("m")
            text = (
                f"found a sample of {found:.4g} {unit} on axis {stated.axes[axis]}; expected at most {reach:g} {unit}"
            )
            return Judgement(UNIT, Conformance.BROKEN, f"{text}, its reach: displacements are in {unit}")
    return Judgement(
        UNIT, Conformance.KEPT, f"samples up to {most.max():.3g} {stated.units('m')}, within the stated reach"
    )


@dataclass(frozen=True)
class _Pushed:
    """A push on one axis: one way, the time after it, the other way, and the time after that; ``rest`` came first."""

    axis: int
    force: float
    rest: Stretch
    there: Stretch
    after: Stretch
    back: Stretch
    after_back: Stretch

    def answer(self) -> Array:
        """The acceleration of each axis along the push, m/s^2: half the difference between both ways."""
        return (_acceleration(self.there) - _acceleration(self.back)) / 2.0

    def own(self) -> Array:
        """By how much the acceleration of each axis changed before any push, over times as long as one, m/s^2.

        Half the difference, as the answer is.
        """
        ticks = min(len(self.there), len(self.back), len(self.rest))
        begins = np.linspace(0, len(self.rest) - ticks, WINDOWS).astype(int)
        parts = (Stretch(self.rest.at[i : i + ticks], self.rest.x[i : i + ticks]) for i in begins)
        return np.asarray(np.ptp([_acceleration(part) for part in parts], axis=0) / 2.0)

    def words(self, stated: DeviceSpecification) -> str:
        """Where the push acts."""
        return f"on axis {stated.axes[self.axis]}" if len(stated.axes) > 1 else "on its axis"

    def whole(self, m: int) -> tuple[Array, Array, Array]:
        """Times (s), displacements (m) and the force on the axis (N) of all ticks."""
        parts = (self.there, self.force), (self.after, 0.0), (self.back, -self.force), (self.after_back, 0.0)
        times = np.concatenate([record.times for record, _ in parts])
        places = np.concatenate([record.places.reshape(-1, m) for record, _ in parts])
        # it is released at the instant of its last sample
        forces = [[force] * (len(record) - 1) + [0.0] for record, force in parts]
        return times, places, np.concatenate([np.array(every) for every in forces])


def _acceleration(record: Stretch) -> Array:
    """The acceleration a of the fit x(t) = x0 + v0 t + a t^2 / 2, m/s^2, by axis."""
    t = record.times - record.at[0]
    fit = np.linalg.lstsq(np.column_stack([np.ones_like(t), t, t**2 / 2.0]), record.places, rcond=None)[0]
    return np.asarray(fit[2])


def _judged(pushed: _Pushed, T: float, stated: DeviceSpecification) -> Iterator[Judgement]:
    """What the answers of all axes to a push on one of them show."""
    axis, name, m = pushed.axis, stated.axes[pushed.axis], len(stated.force)
    of = pushed.words(stated)
    unit = stated.units_by_axis[axis]
    bounds = INERTIAS if stated.kinds[axis] is AxisKind.ROTATION else MASSES
    low, high = bounds if stated.mass is None else (stated.mass[axis] / 3.0, 3.0 * stated.mass[axis])
    N, m_, kg = unit("N"), unit("m"), unit("kg")
    expected = f"expected {low:.3g} to {high:.3g} {kg}: displacements are in {m_}, and forces in {N}"
    axes_turn = stated.axes == TURNS
    short = min(pushed.there, pushed.back, key=len)
    ticks = len(short)
    if ticks < LEAST_TICKS:
        moved = float(np.abs(short.places[-1] - short.places[0]).max())  # beyond the travel, which ended it
        mass = pushed.force * ((ticks - 1) * T) ** 2 / (2.0 * moved)
        text = (
            f"{pushed.force:g} {N} {of} moved it by {moved:.3g} {m_} within {ticks} ticks, as if it had {mass:.2g} {kg}"
        )
        if mass < low:
            yield Judgement(UNIT, Conformance.BROKEN, f"found that {text}; {expected}")
        else:
            less = "less torque (--torque)" if axes_turn else "less force, or let it travel further (--travel)"
            yield Judgement(UNIT, Conformance.OPEN, f"{text}; push with {less}")
        return
    times, places, force = pushed.whole(m)
    a = pushed.answer()
    duration = len(pushed.there) * T
    moved = float(np.ptp(pushed.rest.places, axis=0).max())
    if np.abs(a).max() * duration**2 / 2.0 < LEAST_MOTION and moved > LEAST_MOTION:
        yield _own_motion(f"moves by {moved:.3g} {m_} without a force, and no differently for a push {of}", stated)
        return
    if np.abs(a).max() * duration**2 / 2.0 < LEAST_MOTION:
        text = (
            f"found no motion for a push of {pushed.force:g} {N} {of}; expected one: its samples are old, its force is "
            "not exerted, or something holds it"
        )
        yield Judgement(STALE, Conformance.OPEN if stated.hardware else Conformance.BROKEN, text)
        return
    strongest = int(np.argmax(np.abs(a)))
    if text := _held(places[:, strongest], T, stated):
        yield Judgement(STALE, Conformance.BROKEN, text)
        return
    if (own := pushed.own())[strongest] > OWN * abs(a[strongest]):
        found = f"its acceleration changes by ±{own[strongest]:.2g} {unit('m/s²')} without a force, and by ±"
        yield _own_motion(f"moves by itself: {found}{abs(a[strongest]):.2g} {unit('m/s²')} for a push {of}", stated)
        return
    if abs(a[strongest]) > 3.0 * abs(a[axis]):
        found = f"a push {of} that moves axis {stated.axes[strongest]}"
        yield Judgement(SWAPPED, Conformance.BROKEN, f"found {found}; expected a motion of axis {name}")
        return
    yield Judgement(SWAPPED, Conformance.KEPT, f"a push {of} moves that axis most")
    plain, dry = (_answer(times - times[0], places[:, axis], force, T, dry=dry) for dry in (False, True))
    latency = stated.timing.latency
    # dry friction brakes at the end of a push, which looks as if it came late
    fit = dry if plain.good and plain.delay > latency + GRACE * T else plain
    if a[axis] < 0.0 or not fit.good or fit.delay > latency + GRACE * T:
        sprung = _answer(times - times[0], places[:, axis], force, T, spring=True)
        prompt = sprung.delay <= latency + GRACE * T
        if sprung.good and prompt and np.isfinite(sprung.mass) and sprung.stiffness > 0.0:
            yield Judgement(SIGN, Conformance.KEPT, f"it moves along a push {of}, and a spring drives it back")
            k = float(f"{sprung.stiffness:.2g}")
            spring = f"a spring of about {k:g} {unit('N/m')}"
            text = f"{spring} hides the rest {of}: switch off its own springs or centring for this"
            yield Judgement(MOTION, Conformance.OPEN, text)
            return
    if a[axis] < 0.0:
        text = f"found a push of +{pushed.force:g} {N} {of} that moves it by {a[axis]:.3g} {unit('m/s²')}"
        yield Judgement(SIGN, Conformance.BROKEN, f"{text}; expected a motion along the force")
        return
    yield Judgement(SIGN, Conformance.KEPT, f"it moves along a push {of}")
    delay, mass, fits = fit.delay, fit.mass, fit.good
    unseen = _unseen(pushed, mass if fits else pushed.force / float(a[axis]), stated)
    if fits and delay > latency + unseen + GRACE * T:
        also = f", and {1e3 * unseen:.3g} ms until it has moved by the stated step" if unseen else ""
        yield Judgement(
            STALE,
            Conformance.BROKEN,
            f"found an answer to a push {of} that comes {1e3 * delay:.3g} ms late; expected at most "
            f"{1e3 * latency:.3g} ms, the stated sample_age and actuation_delay{also}",
        )
        return
    late = f"the answer to a push {of} comes within {1e3 * delay:.2g} ms; stated {1e3 * latency:.3g} ms, and a tick"
    yield Judgement(
        STALE, Conformance.KEPT if fits else Conformance.OPEN, late if fits else f"no fit of the motion {of}"
    )
    mass = mass if fits else pushed.force / float(a[axis])
    if not low <= mass <= high:
        found = f"found {pushed.force:g} {N} that seem to move {mass:.3g} {kg} {of}; {expected}"
        held = stated.hardware and mass > high  # dry friction, or a hand
        yield Judgement(UNIT, Conformance.OPEN if held else Conformance.BROKEN, found)
        return
    yield Judgement(UNIT, Conformance.KEPT, f"{pushed.force:g} {N} move {mass:.3g} {kg} {of}")
    left = float((_acceleration(pushed.after) - _acceleration(pushed.after_back))[axis] / 2.0 / a[axis])
    if left > LEFT:
        found = f"{left:.0%} of a push {of} after its release"
        yield Judgement(RELEASE, Conformance.BROKEN, f"found {found}; expected none")
        return
    if fits and stated.mass is not None and not stated.hardware:
        gain = stated.mass[axis] / mass
        if abs(gain - 1.0) > GAIN:  # a counterpart with dry friction seems to weigh more than it does
            gain = stated.mass[axis] / dry.mass if dry.good else gain
        if abs(gain - 1.0) > GAIN:
            found = f"{gain:.3g} times the force that was given, by the motion of {stated.mass[axis]:g} {kg} {of}"
            yield Judgement(FORCE, Conformance.BROKEN, f"found {found}; expected it within {GAIN:.0%}")
            return
        yield Judgement(FORCE, Conformance.KEPT, f"{gain:.3g} times the force that was given, {of}")
    if dry.good:
        yield _estimate(dry, of, T, latency, stated.timing.jitter, unit)
    yield Judgement(RELEASE, Conformance.KEPT, f"released, {max(0.0, left):.0%} of a push {of} is left")


def _own_motion(found: str, stated: DeviceSpecification) -> Judgement:
    """That the device moves by itself; of hardware nothing is judged, for it may hang, or somebody may hold it."""
    expected = (
        "expected a device that rests: let it hang still; a driver whose device no force moves states "
        "moved_by_force=False"
    )
    return Judgement(
        MOTION, Conformance.OPEN if stated.hardware else Conformance.BROKEN, f"found a device that {found}; {expected}"
    )


def _estimate(fit: _Fit, of: str, T: float, latency: float, jitter: float, unit: Units) -> Judgement:
    """What the device seems to burn, and the limit of a stiffness that it is worth, :mod:`manyhands.design.budget`."""
    burned = f"{max(0.0, fit.damping):.2g} {unit('N·s/m')}, and {max(0.0, fit.friction):.2g} {unit('N')}"
    text = f"it seems to damp {burned}, {of}"
    if fit.damping > 0.0:
        worth = "nothing"  # no certificate covers a delay of more than the period
        if latency <= T:
            worth = f"{fit.damping / (least_gain(latency / T, min(1.0, jitter / T)) * T):.3g} {unit('N/m')}"
        text += f", worth {worth} in this period and with its own delay alone"
    return Judgement(ESTIMATE, Conformance.KEPT, f"{text}: an estimate, and no osp, which manyhands identify measures")


def _unseen(pushed: _Pushed, mass: float, stated: DeviceSpecification) -> float:
    """How long a push moves a mass (kg) before its encoder shows it, s, at the latest: sqrt(2 m q/f)."""
    step = 0.0 if stated.step is None else stated.step[pushed.axis]
    return float(np.sqrt(2.0 * mass * step / pushed.force)) if np.isfinite(mass) else 0.0


def _held(x: Array, T: float, stated: DeviceSpecification) -> str:
    """How samples stay the same for longer than their age, and jump; empty where they do not.

    An encoder also repeats a sample of a slow device, and then moves by one step. Samples that were held move by
    several steps, of different sizes.
    """
    steps = np.diff(x)
    moved = np.flatnonzero(steps)
    if len(moved) < 3:
        return ""
    runs = np.diff(moved)  # samples from one change to the next
    longest = stated.timing.sample_age / T + GRACE
    held = runs > max(2.0, longest)
    smallest = np.abs(steps[moved]).min()
    jumps = np.abs(steps[moved[1:]])[held] > 1.5 * smallest
    if np.count_nonzero(jumps) < max(3, len(moved) // 2):
        return ""
    found = f"samples that stay the same for {1e3 * T * float(np.median(runs[held])):.3g} ms, and then jump"
    return f"found {found}; expected a new one at every call, or a sample_age as long as that"


@dataclass(frozen=True)
class _Fit:
    """How a device answers a push, by the best fit.

    Attributes:
        delay: L, s.
        mass: m, kg; infinite where the push moves nothing.
        damping: b, N s/m; negative where the fit says so.
        friction: c, N; 0 where none was fitted.
        stiffness: k, N/m; 0 where none was fitted.
        good: whether the rest is a twentieth of the motion at most.
    """

    delay: float
    mass: float
    damping: float
    friction: float
    stiffness: float
    good: bool


def _answer(t: Array, x: Array, force: Array, T: float, *, dry: bool = False, spring: bool = False) -> _Fit:
    """The best fit; friction against the motion (``dry``) or a ``spring`` are fitted as well, by double integrals."""
    held = np.concatenate([[0.0], np.cumsum((x[1:] + x[:-1]) / 2.0 * np.diff(t))])
    best, delay, found = np.inf, 0.0, np.zeros(1)
    scale = float(np.std(x))
    fine = T / 4.0
    grid = np.arange(t[0], t[-1] + fine, fine)
    f = force[np.searchsorted(t, grid + 1e-12, side="right") - 1]
    W = np.cumsum(np.cumsum(f)) * fine**2
    columns = [np.ones_like(t), t, t**2, held]
    if dry:
        against = np.sign(np.interp(grid, t, np.gradient(x, t)))
        columns.append(np.interp(t, grid, np.cumsum(np.cumsum(against)) * fine**2))
    if spring:
        columns.append(np.concatenate([[0.0], np.cumsum((held[1:] + held[:-1]) / 2.0 * np.diff(t))]))
    for step in range(4 * LONGEST_DELAY):
        shifted = np.interp(t - step * fine, grid, W, left=0.0)
        A = np.column_stack([*columns, shifted])
        fit = np.linalg.lstsq(A, x, rcond=None)[0]
        size = float(np.sqrt(np.mean((x - A @ fit) ** 2)))
        if size < best:
            best, delay, found = size, step * fine, fit
    mass = 1.0 / float(found[-1]) if found[-1] > 0.0 else np.inf
    friction = -mass * float(found[4]) if dry else 0.0
    stiffness = -mass * float(found[-2]) if spring else 0.0
    return _Fit(delay, mass, -mass * float(found[3]), friction, stiffness, best <= 0.05 * scale)


def _silence(
    bench: Bench, pushed: _Pushed, f: list[float], back: list[float], stated: DeviceSpecification
) -> Judgement:
    """Whether forces end by themselves while nothing is called, by the way that they have moved the device."""
    T, of, unit = bench.T, pushed.words(stated), stated.units_by_axis[pushed.axis]
    fit = _answer_of(pushed, T, stated)
    step = 0.0 if stated.step is None else stated.step[pushed.axis]
    bench.rest(PUSH_TICKS)
    told, ticks = [], HELD_TICKS
    while True:
        silences = [_silent(bench, way, ticks) for way in (f, back)]
        asked, window = ticks * T, silences[0].at[-1] - silences[0].at[-2] - fit.delay
        lasted, error = _lasted(pushed, fit, silences, step, asked)
        if lasted - error > asked + GRACE * T:
            return Judgement(SILENCE, Conformance.BROKEN, _kept_on(of, lasted, ticks, T, lasted > 0.9 * window))
        if error > asked:
            more = "torque (--torque)" if stated.axes == TURNS else "force (--force)"
            text = (
                f"a step of {step:g} {unit('m')} is too coarse to see whether a force {of} ends after "
                f"{1e3 * asked:.3g} ms, for it tells the time to {1e3 * error:.2g} ms: push with more {more}"
            )
            return Judgement(SILENCE, Conformance.OPEN, text)
        told.append(f"{1e3 * lasted:.2g} of {1e3 * asked:.3g} ms")
        brief = max(BRIEF_TICKS, math.ceil(error / T))  # as brief as can be seen
        if ticks < HELD_TICKS or brief >= HELD_TICKS:
            text = f"forces {of} ended by themselves while nothing was called, after {' and '.join(told)}"
            return Judgement(SILENCE, Conformance.KEPT, text)
        ticks = brief


def _kept_on(of: str, lasted: float, ticks: int, T: float, throughout: bool) -> str:
    """The sentence about a force that lasted longer (s) than the ``ticks`` that it was given."""
    asked, allowed = 1e3 * ticks * T, 1e3 * (ticks + GRACE) * T
    why = "the longest that a session of this period holds one" if ticks == HELD_TICKS else "as its account may ask"
    found = f"found a force {of} that went on for {1e3 * lasted:.3g} ms in which nothing was called"
    text = (
        f"{found}; expected its end after {asked:.3g} ms, its 'until', {why}, and at most {allowed:.3g} ms: have the "
        "device, or a thread of its driver, end each force at its 'until'"
    )
    if throughout:
        return text
    period = math.ceil(1e4 * lasted / (BRIEF_TICKS + GRACE)) / 10.0
    return f"{text}; a watchdog as coarse as that needs a period of at least {period:g} ms"


def _silent(bench: Bench, f: list[float], lasts: int) -> Stretch:
    """A push that ends by itself in silence, after some ticks that show how the device moves without it."""
    ticks = max(SILENT_TICKS, math.ceil(SILENT_TIME / bench.T))
    before = bench.rest(LEAST_TICKS * ticks // SILENT_TICKS)
    during = bench.silence(f, lasts, ticks)
    return Stretch(before.at + during.at, before.x + during.x)


def _answer_of(pushed: _Pushed, T: float, stated: DeviceSpecification) -> _Fit:
    """How the device answers a push: by the fit with friction, by that without, or by its acceleration alone."""
    times, places, force = pushed.whole(len(stated.force))
    for dry in (True, False):
        fit = _answer(times - times[0], places[:, pushed.axis], force, T, dry=dry)
        if fit.good and np.isfinite(fit.mass):
            return fit
    mass = pushed.force / float(pushed.answer()[pushed.axis])
    return _Fit(stated.timing.latency, mass, 0.0, 0.0, 0.0, good=False)


def _lasted(pushed: _Pushed, fit: _Fit, silences: list[Stretch], step: float, asked: float) -> tuple[float, float]:
    """How long a force lasted in silence, s, and how far that is off for steps (m) and noise, s, if it is as ``asked``.

    Half the difference of both ways is what the force did, for gravity is the same in both.
    """
    axis, moved, starts, noise = pushed.axis, 0.0, [], 0.0
    for sign, record in zip((1.0, -1.0), silences, strict=True):
        before = Stretch(record.at[:-1], record.x[:-1])
        t = before.times - before.at[-1]
        slope, place = np.polyfit(t, before.places[:, axis], 1)
        noise = max(noise, float(np.abs(before.places[:, axis] - slope * t - place).max()))
        moved += sign * (record.x[-1][axis] - float(place)) / 2.0
        starts.append((sign, float(slope), record.at[-1] - record.at[-2] - fit.delay))
    window = min(window for _, _, window in starts)

    def way(lasts: float) -> float:
        return sum(sign * _way(v, sign * pushed.force, lasts, end, fit) / 2.0 for sign, v, end in starts)

    low, high = 0.0, window
    for _ in range(BISECTIONS):
        middle = (low + high) / 2.0
        low, high = (middle, high) if way(middle) < moved else (low, middle)
    more = (way(asked + window / PIECES) - way(asked)) / (window / PIECES)  # m for each second that it lasts longer
    return low, KNOWN_TO * max(step, noise) / max(more, np.finfo(float).tiny)


def _way(v: float, force: float, lasts: float, end: float, fit: _Fit) -> float:
    """The way (m) until ``end`` (s) of a device that begins at v (m/s), under a force (N) that ``lasts`` so long, s."""
    x, dt = 0.0, end / PIECES
    damping, friction = max(0.0, fit.damping), max(0.0, fit.friction)
    for piece in range(PIECES):
        acts = min(1.0, max(0.0, lasts / dt - piece))
        v += dt * (acts * force - damping * v) / fit.mass
        v = math.copysign(max(0.0, abs(v) - dt * friction / fit.mass), v)
        x += dt * v
    return x


def checked_apart(bench: Bench, suite: Callable[[], list[Judgement]], patience: float = PATIENCE) -> list[Judgement]:
    """Run a suite in a thread of its own, so that a call that never returns is named as well.

    Args:
        bench: the suite's.
        suite: makes the findings.
        patience: s after which a call is taken for one that never returns.
    """
    try:
        return run_apart(bench, suite, patience)
    except NeverReturned as error:
        return [Judgement(BLOCKING, Conformance.BROKEN, f"{error}; expected it to return at once")]


class NeverReturned(Exception):
    """A call of a driver has not returned for long; the message names it."""


def run_apart(
    bench: Bench, suite: Callable[[], _R], patience: float = PATIENCE, look: Callable[[], None] | None = None
) -> _R:
    """Run what uses a bench in a thread of its own; returns its result.

    Args:
        bench: the bench.
        suite: what uses it.
        patience: s after which a call is taken for one that never returns.
        look: called in this thread ten times a second meanwhile, as long as it likes.

    Raises:
        NeverReturned: a call of the driver does not return.
    """
    found: list[_R] = []
    failed: list[BaseException] = []

    def work() -> None:
        try:
            found.append(suite())
        except BaseException as error:  # noqa: BLE001 -- raised again in the caller's thread
            failed.append(error)

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    last, waited = bench.inside, 0.0
    step = patience if look is None else min(patience, LOOK)
    try:
        while thread.is_alive():
            thread.join(step)
            waited += step
            if look is not None:
                look()
            inside = bench.inside
            if inside != last:
                last, waited = inside, 0.0
            elif thread.is_alive() and inside is not None and waited >= patience:
                raise NeverReturned(
                    f"found that {inside[0]} has not returned for {patience:g} s; the device may keep its force"
                )
    except NeverReturned:
        raise  # there is no use in waiting for it
    except BaseException:
        bench.stopping = True  # the suite's thread closes the driver
        thread.join(patience)
        raise
    if failed:
        raise failed[0]
    return found[0]


def clock_for(stated: DeviceSpecification, real: Clock) -> Clock:
    """The clock of a bench: the real one for hardware, one that jumps for a simulated counterpart."""
    return real if stated.hardware else SimulatedClock()
