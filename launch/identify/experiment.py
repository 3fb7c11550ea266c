"""The experiment: strokes to and fro on lines through a pose, at several speeds (:func:`experiment`).

A virtual spring and a virtual damper, both weak, pull the tip after a place that goes to and fro with rounded turns:
:data:`BANDWIDTH` beside the device's own mass, so that age and delay of tens of milliseconds leave it stable. Before
anything is measured the servo learns what the device needs on top: bias, dry friction, damping and mass. Then these are
constants, so that the force is smooth. What the servo does is no part of the result: the result knows the forces that
were given, and where the device was.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from manyhands.design.closed_motion import Along, estimated, even_lines, identified_by_turns, measured_along
from manyhands.design.identification import (
    HALF,
    Doubt,
    Identified,
    Line,
    MeasuredMotion,
    TooLittle,
    damping_set,
    encoder_step,
    lines,
    measured_line,
    noise_of,
)
from manyhands.launch.identify.rig import Aborted, Controller, Late, MotionLog, Rig
from manyhands.nodes.kernel.arithmetic import Floats, dot, plus

Array = NDArray[np.float64]

LEVELS: Final = ((0.12, 3), (0.25, 4), (0.5, 5), (1.0, 7))
"""Of the greatest speed, and how many times to and fro."""

AROUND: Final = ((0.1, 2, 2), (0.2, 2, 3), (0.45, 5, 4), (1.0, 11, 7))
"""Likewise with several axes: times in which the servo learns, and then those that are measured."""

FIRST: Final = 2
"""How many of :data:`AROUND`, from the fastest on, tell which lines to take."""

WARM: Final = ((0.2, 3), (0.4, 3), (0.8, 3))
"""Likewise, of the strokes in which the servo learns."""

BANDWIDTH: Final = 16.0
"""rad/s, of the virtual spring with the mass."""

ACROSS: Final = 28.0
"""rad/s, likewise aside of the line: motion aside is what several axes are least certain of."""

DAMPED: Final = 0.6
"""Its damping ratio."""

ROUNDED: Final = 0.8
"""How sharp the turns are, below 1."""

SMOOTH: Final = 0.5
"""Likewise with several axes, whose inertia bends sharp turns."""

SOFT: Final = (12.0, 18.0)
"""rad/s, in place of :data:`BANDWIDTH` and :data:`ACROSS` where displacements are off by more than :data:`COARSE`, and
the servo learns what repeats: noise moves such a force less, and a restless force is a wide interval."""

COARSE: Final = 2e-5
"""m; see there."""

EASED: Final = 0.01
"""s, in which such a soft servo follows what its spring and damper ask for."""

TONES: Final = 4
"""Multiples of the motion's frequency, up to which the servo learns."""

TUNED: Final = 0.5
"""Part of what is missing that is learned at a time."""

REACH: Final = 2.0
"""By how much a multiple of the frequency may be above the servo's bandwidth, to be learned."""

PART: Final = 0.25
"""Of a stroke one way, over which the servo's model of the device is fitted."""

LEARNS: Final = 0.3
"""s, in which bias and friction are learned."""

FIRST_LEARNS: Final = 1.0
"""s, likewise before a mass is known: faster, a device four times as heavy as :data:`FIRST_MASS` would swing up."""

BEYOND: Final = 1.6
"""Of the wanted travel, at which a motion is aborted."""

DRAGGED: Final = 2.0
"""s, in which the device is pulled to another pose."""

STOOD: Final = 2e-4
"""s by which the call that returns a displacement may take longer than mostly; beyond that its instant is unknown."""

TRIES: Final = 4
"""How often a run is begun that ends early since the loop got no turn."""

FIRST_MASS: Final = 0.15
"""kg, before anything is known."""


@dataclass(frozen=True)
class AtPose:
    """What was found at one pose.

    Attributes:
        place: where, m.
        lines: what was measured.
        found: what that allows.
        doubts: by line, what was not known of the measurement.
    """

    place: tuple[float, ...]
    lines: tuple[Line, ...]
    found: Identified
    doubts: tuple[Doubt, ...]
    steps: tuple[float, ...]
    """The encoders' steps by axis, m; 0 where none was found."""


@dataclass
class _Tones:
    """A force that repeats with a motion to and fro, in all axes: learned time by time from what is missing.

    Each multiple of the frequency is learned as far as the servo's own spring, damper and mass would have it.

    Attributes:
        u: the line's direction.
        at: cosine and sine by multiple from 0 on, multiples x axes, N.
    """

    u: Floats
    at: tuple[Array, Array] = field(init=False)
    _heard: tuple[Array, Array] = field(init=False)
    _count: int = 0
    _time: int = 0
    _known: list[tuple[float, tuple[Array, Array]]] = field(default_factory=list)

    def __post_init__(self) -> None:
        zero = np.zeros((TONES + 1, len(self.u)))
        self.at, self._heard = (zero, zero.copy()), (zero.copy(), zero.copy())

    def begin(self, omega: float, after: float) -> None:
        """Go on to a frequency (rad/s) after another: what inertia needs grows with its square."""
        if after:
            self._known.append((after, self.at))
        if len(self._known) == 1:
            self.at = tuple(one * (omega / after) ** 2 for one in self.at)  # type: ignore[assignment]
        elif self._known:
            (first, one), (second, other) = self._known[-2:]
            part = (omega**2 - second**2) / (second**2 - first**2)
            self.at = tuple(b + part * (b - a) for a, b in zip(one, other, strict=True))  # type: ignore[assignment]
        self._listen(0)

    def _listen(self, time: int) -> None:
        self._heard = (np.zeros_like(self.at[0]), np.zeros_like(self.at[0]))
        self._count, self._time = 0, time

    def force(self, lacks: Floats, omega: float, t: float, mass: float, wide: tuple[float, float]) -> Floats:
        """The force at the time t (s), N, of a servo as ``wide`` (rad/s); it hears what is missing (m)."""
        time = int(omega * t / (2.0 * math.pi))
        if time != self._time:
            if self._time:  # the first time has the start in it
                self._learn(omega, mass, wide)
            self._listen(time)
        angles = omega * t * np.arange(TONES + 1)
        cos, sin = np.cos(angles), np.sin(angles)
        self._heard[0][:] += np.outer(cos, lacks)
        self._heard[1][:] += np.outer(sin, lacks)
        self._count += 1
        return [float(value) for value in cos @ self.at[0] + sin @ self.at[1]]

    def _learn(self, omega: float, mass: float, wide: tuple[float, float]) -> None:
        u, cosine, sine = np.array(self.u), *self.at
        for multiple in range(TONES + 1):
            w, (a, b) = multiple * omega, (heard[multiple] for heard in self._heard)
            part = TUNED * (2.0 if multiple else 1.0) / self._count * mass
            for bandwidth, of in zip(wide, (np.outer(u, u), np.eye(len(u)) - np.outer(u, u)), strict=True):
                if w <= REACH * bandwidth:
                    stiff, damper = part * (bandwidth**2 - w * w), part * 2.0 * DAMPED * bandwidth * w
                    cosine[multiple] += of @ (stiff * a + damper * b)
                    sine[multiple] += of @ (stiff * b - damper * a)


@dataclass
class _Servo:
    """A spring and a damper to a place that goes to and fro along u through the origin."""

    u: Floats
    origin: Floats
    travel: float
    mass: float
    bias: Floats
    friction: float = 0.0
    damping: float = 0.0
    omega: float = 1.0
    learning: bool = True
    learns: float = FIRST_LEARNS
    most: float = math.inf
    T: float = 1e-3
    rounded: float = ROUNDED
    tones: _Tones | None = None
    soft: bool = False
    asked: Floats = field(default_factory=list)

    def at(self, speed: float) -> float:
        """Go to and fro with this speed in the middle, m/s; returns the time of one stroke there and back, s."""
        before, self.omega = self.omega, self.turning(speed)
        if self.tones is not None and not self.learning:
            self.tones.begin(self.omega, before)
        return 2.0 * math.pi / self.omega

    def turning(self, speed: float) -> float:
        """The frequency of a motion with this speed in the middle, rad/s."""
        return speed * math.asin(self.rounded) / (self.travel * self.rounded)

    def peak(self, speed: float) -> float:
        """What the turns of such a motion take, N."""
        r = self.rounded
        return self.mass * self.travel * self.turning(speed) ** 2 * r / math.sqrt(1.0 - r**2) / math.asin(r)

    def __call__(self, x: Floats, v: Floats, t: float) -> Floats:
        """The force, N."""
        phase = self.omega * t
        sin, cos = self.rounded * math.sin(phase), self.rounded * math.cos(phase)
        root, scale = math.sqrt(1.0 - sin * sin), self.travel / math.asin(self.rounded)
        if self.tones is not None:
            scale *= min(1.0, 0.1 + phase / math.pi)  # it begins at rest
        want, speed = scale * math.asin(sin), scale * self.omega * cos / root
        # d/dt of cos/root, with ROUNDED in both
        push = scale * self.omega**2 * sin * (cos * cos / root**3 - 1.0 / root)
        own, across = SOFT if self.soft else (BANDWIDTH, ACROSS)
        stiffness, damper = self.mass * own**2, 2.0 * DAMPED * self.mass * own
        guide = self.mass * (across**2 - own**2), 2.0 * DAMPED * self.mass * (across - own)
        ease = max(-1.0, min(1.0, speed / (0.1 * scale * self.omega)))
        ahead = self.mass * push + self.damping * speed + self.friction * ease
        lacks = [a + u * want - b for u, a, b in zip(self.u, self.origin, x, strict=True)]
        behind, along = dot(self.u, lacks), dot(self.u, v)
        f = [
            stiffness * lack
            + damper * (u * speed - w)
            + guide[0] * (lack - u * behind)  # aside of the line
            - guide[1] * (w - u * along)
            for u, lack, w in zip(self.u, lacks, v, strict=True)
        ]
        if self.soft:
            part = min(1.0, self.T / EASED)
            f = self.asked = [a + part * (b - a) for a, b in zip(self.asked or f, f, strict=True)]
        if self.tones is not None and not self.learning:
            f = plus(f, self.tones.force(lacks, self.omega, t, self.mass, (own, across)))
        f = [one + u * ahead + bias for one, u, bias in zip(f, self.u, self.bias, strict=True)]
        if self.learning:
            rate = stiffness / self.learns * self.T
            self.friction = max(0.0, min(self.most, self.friction + rate * behind * ease))
            for axis, lack in enumerate(lacks):
                learned = self.bias[axis] + 0.5 * rate * lack
                self.bias[axis] = max(-self.most, min(self.most, learned))
        return f

    def learn(self, mass: float, damping: float, friction: float) -> None:
        """Take what a run has shown; a mass only as far as one run can be believed."""
        self.mass = min(4.0 * self.mass, max(0.25 * self.mass, mass))
        self.damping = max(0.0, damping)
        self.friction = min(self.most, max(0.0, friction))
        self.learns = LEARNS

    def turns(self, times: Array) -> tuple[int, ...]:
        """Of these times of the wanted motion, s, the ticks at which it turns round."""
        half = np.floor(self.omega * times / math.pi + 0.5)
        return tuple(int(tick) + 1 for tick in np.flatnonzero(np.diff(half)))


def _fit(log: MotionLog, servo: _Servo) -> tuple[float, float, float] | None:
    """m, kg, b, N*s/m, and c, N, that fit f = m a + b v + c sgn(v) + k s + g best; None where there is no fit.

    All terms are means over :data:`PART` of a stroke, over which the change of the velocity is known well. The errors
    of a derivative would make the mass look small.
    """
    t, length = np.array(log.sampled), np.array(servo.u)
    s, f = np.array(log.x) @ length, np.array(log.f) @ length
    T = float(np.median(np.diff(t)))
    n, w = max(1, round(HALF / T)), max(2, round(PART * math.pi / servo.omega / T))
    if len(s) < 4 * (n + w):
        return None
    v = (s[2 * n :] - s[: -2 * n]) / (t[2 * n :] - t[: -2 * n])
    t, s, f = t[n:-n], s[n:-n], f[n:-n]

    def mean(values: Array) -> Array:
        return np.convolve(values, np.full(w, 1.0 / w), "valid")[:-1]

    a = (v[w:] - v[:-w]) / (t[w:] - t[:-w])
    A = np.column_stack([a, mean(v), mean(np.sign(v)), mean(s), np.ones_like(a)])
    m, b, c, *_ = np.linalg.lstsq(A, mean(f), rcond=None)[0]
    return float(m), float(b), float(c)


Told = Callable[[str], None]


def experiment(rig: Rig, tell: Told = lambda _text: None) -> AtPose:
    """Move a device to and fro on all lines through the place where it is, and find what it burns.

    Args:
        rig: the device.
        tell: is told what begins.

    Raises:
        Aborted, DriverFailure: the motion ended early; the device was released.
        NotOfThisClass, TooLittle: nothing can be stated.
    """
    origin, stated = rig.here(), rig.stated
    m = len(origin)
    if m == 1:
        servo = _servo(rig, np.ones(1), None)
        speed = _warmed(rig, servo, tell, stated.axes[0])
        motions = [_at_level(rig, servo, speed, level, LEVELS[level], tell) for level in range(len(LEVELS))]
        return evaluated(tuple(origin), [(np.ones(1), motions)], rig)
    runs: list[_AlongLine] = []

    def begun(u: Array) -> _AlongLine:
        servo = _servo(rig, u, runs[-1].servo if runs else None)
        speed = _warmed(rig, servo, tell, line_name(u, stated.axes), bool(runs))
        servo.omega = 0.0
        return _AlongLine(u, servo, speed)

    for u in lines(m):
        runs.append(begun(u))
        _around(rig, runs[-1], range(len(AROUND))[: -FIRST - 1 : -1], tell)
    first = estimated([_told(one, rig) for one in runs])
    chosen = runs
    if even := even_lines(first):
        chosen = [begun(u) for u in even]
        runs += chosen
    for one in chosen:
        _around(rig, one, [level for level in range(len(AROUND))[::-1] if level not in one.motions], tell)
    return evaluated(tuple(origin), [(one.u, one.slowest_first()) for one in runs], rig)


@dataclass
class _AlongLine:
    """What moves along a line, and what was measured, by level."""

    u: Array
    servo: _Servo
    speed: float
    motions: dict[int, MeasuredMotion] = field(default_factory=dict)

    def slowest_first(self) -> list[MeasuredMotion]:
        """What was measured."""
        return [self.motions[level] for level in sorted(self.motions)]


def _told(one: _AlongLine, rig: Rig) -> Along:
    motions = one.slowest_first()
    try:
        return measured_along(motions, one.u, _doubt(motions[0], one.u, _steps(motions, rig), rig))
    except TooLittle as error:
        raise TooLittle(f"{line_name(one.u, rig.stated.axes)}: {error}") from error


def _servo(rig: Rig, u: Array, after: _Servo | None) -> _Servo:
    """A servo along u that knows what another one has learned."""
    m, length = len(u), [float(entry) for entry in u / np.sqrt(u @ u)]
    mass = FIRST_MASS if rig.stated.mass is None else float(np.mean(rig.stated.mass))
    bias = [0.0] * m
    if after is not None:
        mass, bias = after.mass, list(after.bias)
    servo = _Servo(length, list(rig.origin), rig.safety.travel, mass, bias, T=rig.T, most=0.7 * min(rig.force))
    if m > 1:
        servo.rounded, servo.tones = SMOOTH, _Tones(length)
    return servo


def _at_level(
    rig: Rig, servo: _Servo, speed: float, level: int, what: tuple[float, int], tell: Told, settles: int = 0
) -> MeasuredMotion:
    """A motion at one speed; in its first ``settles`` times to and fro the servo learns."""
    part, times = what
    name = line_name(np.array(servo.u), rig.stated.axes)
    tell(f"{name}: {settles + times} times to and fro at {part * speed:.3g} {rig.stated.units('m/s')}")
    log = _run(rig, servo, (settles + times + 0.3) * servo.at(part * speed), tell)
    motion = _motion(log, level, servo)
    return replace(motion, settled=2 * settles + 1) if settles else motion


def _around(rig: Rig, one: _AlongLine, levels: Sequence[int], tell: Told) -> None:
    """Move along a line at these levels."""
    for level in levels:
        part, settles, times = AROUND[level]
        one.motions[level] = _at_level(rig, one.servo, one.speed, level, (part, times), tell, settles)


def _run(rig: Rig, servo: Controller, duration: float, tell: Told) -> MotionLog:
    """One run; again from its origin where a machine that gave the loop no turn is why it ended."""
    origin = rig.origin
    for _ in range(TRIES - 1):
        try:
            return rig.run(servo, duration, BEYOND * rig.safety.travel)
        except Late as error:
            tell(f"once more, for {error}")
            drag(rig, origin)
            rig.origin = origin
    return rig.run(servo, duration, BEYOND * rig.safety.travel)


def drag(rig: Rig, to: Sequence[float]) -> None:
    """Pull the device to another place (m) with the servo's spring and damper, in :data:`DRAGGED` s, and hold it there.

    Raises:
        Aborted: as :meth:`Rig.run`; or it did not come near.
    """
    begin = rig.here()
    way = [b - a for a, b in zip(begin, to, strict=True)]
    mass = FIRST_MASS if rig.stated.mass is None else min(rig.stated.mass)
    stiffness, damping = mass * BANDWIDTH**2, 2.0 * DAMPED * mass * BANDWIDTH
    bias = [0.0] * len(way)

    def pull(x: Floats, v: Floats, t: float) -> Floats:
        part = min(1.0, t / DRAGGED)
        part *= part * (3.0 - 2.0 * part)
        lacks = [a + part * whole - b for a, whole, b in zip(begin, way, x, strict=True)]
        for axis, lack in enumerate(lacks):
            bias[axis] += stiffness / LEARNS * rig.T * lack
        return [stiffness * lack - damping * w + held for lack, w, held in zip(lacks, v, bias, strict=True)]

    rig.run(pull, 1.5 * DRAGGED, max(map(abs, way)) + rig.safety.travel)
    off = max(abs(a - b) for a, b in zip(rig.here(), to, strict=True))
    if off > rig.safety.travel:
        raise Aborted(
            f"the device is {1e3 * off:.3g} {rig.stated.units('mm')} off its next pose; expected it nearer: "
            "give more force, or fewer poses"
        )


def poses(start: Sequence[float], rig: Rig, number: int) -> list[list[float]]:
    """So many places to measure at, on a diagonal of the workspace through the start; the first is the start itself, m.

    Raises:
        ValueError: there is no room for more than one.
    """
    room = [most - abs(x) - BEYOND * rig.safety.travel for most, x in zip(rig.stated.displacement, start, strict=True)]
    far = min(*room, 2.0 * rig.safety.travel)
    if number > 1 and far < 0.5 * rig.safety.travel:
        raise ValueError(
            f"--poses: found {number}, and {1e3 * max(far, 0.0):.3g} {rig.stated.units('mm')} of room beside the "
            "first; expected 1, or less travel"
        )
    ways = [0.0, *(part for pair in range(1, number) for part in (1.0 / pair, -1.0 / pair))]
    return [[x + far * part for x in start] for part in ways[:number]]


def _warmed(rig: Rig, servo: _Servo, tell: Told, name: str, knows: bool = False) -> float:
    """Let the servo learn, at once faster where it ``knows``; returns the greatest speed that is left, m/s."""
    speed = min(rig.safety.speed, 0.7 * min(rig.stated.speed))
    restless = False
    for part, times in WARM[knows:]:
        servo.learning = True
        tell(f"{name}: the servo learns mass, damping and friction")
        log = _run(rig, servo, times * servo.at(part * speed), tell)
        restless = noise_of(_motion(log, 0, servo), np.array(servo.u), 0.0) > COARSE
        fit = _fit(log, servo)
        if fit is not None:
            servo.learn(*fit)
        # what the turns take: mass times the greatest acceleration of the wanted motion
        spare = 0.8 * min(rig.force) - servo.friction - servo.damping * speed - max(map(abs, servo.bias))
        peak = servo.peak(speed)
        if peak > max(spare, 0.05 * min(rig.force)):
            speed *= math.sqrt(max(spare, 0.05 * min(rig.force)) / peak)
    servo.learning, servo.soft = False, restless and servo.tones is not None
    return speed


def _motion(log: MotionLog, level: int, servo: _Servo) -> MeasuredMotion:
    sampled = np.array(log.sampled)
    # a program that stood still within a call cannot say when that took place
    asked, gave = (
        np.maximum(np.array(took) - float(np.median(took)), 0.0) for took in (log.asked[: len(log.x)], log.gave)
    )
    stale = np.array(log.stale) | (asked > STOOD)
    # a tick's work beyond f^T dx is told with the sample that ends the step
    extra = np.append(log.extra[1:], 0.0)
    return MeasuredMotion(
        sampled, np.array(log.x), np.array(log.applied), np.array(log.f), level, servo.turns(np.array(log.phase)),
        extra if np.any(extra) else None, stale if np.any(stale) else None, gave if np.any(gave) else None,
    )  # fmt: skip


def evaluated(origin: tuple[float, ...], runs: Sequence[tuple[Array, list[MeasuredMotion]]], rig: Rig) -> AtPose:
    """What the runs along all lines allow; of several axes, the axes and the diagonals come first."""
    steps = _steps([motion for _, motions in runs for motion in motions], rig)
    measured, doubts, along = [], [], []
    for u, motions in runs:
        doubt = _doubt(motions[0], u, steps, rig)
        doubts.append(doubt)
        try:
            if len(u) > 1:
                along.append(measured_along(motions, u, doubt))
                measured.append(_windows(motions, u, doubt))
            else:
                measured.append(measured_line(motions, u, doubt))
        except TooLittle as error:
            raise TooLittle(f"{line_name(u, rig.stated.axes)}: {error}") from error
    found = damping_set(measured[0]) if not along else identified_by_turns(measured, along)
    return AtPose(origin, tuple(measured), found, tuple(doubts), steps)


def _steps(motions: Sequence[MeasuredMotion], rig: Rig) -> tuple[float, ...]:
    """The encoders' steps by axis, m; 0 where none is seen or stated."""
    every, stated = np.concatenate([motion.x for motion in motions]), rig.stated.step
    found = (encoder_step(one) or 0.0 for one in every.T)
    return tuple(max(one, 0.0 if stated is None else stated[axis]) for axis, one in enumerate(found))


def _doubt(motion: MeasuredMotion, u: Array, steps: Sequence[float], rig: Rig) -> Doubt:
    timing = rig.stated.timing
    latency = (timing.sample_age - timing.jitter, timing.sample_age + timing.actuation_delay)
    step = math.sqrt(float(np.count_nonzero(u))) * max(steps)
    return Doubt(max(noise_of(motion, u, step), 1e-9), latency, timing.jitter)


def _windows(motions: Sequence[MeasuredMotion], u: Array, doubt: Doubt) -> Line:
    """What windows tell of friction by place, and of the mass; nothing where it stops in them."""
    try:
        return measured_line(motions, u, doubt)
    except TooLittle:
        return Line(u, (), ((), ()))


def line_name(u: Array, axes: Sequence[str]) -> str:
    """A name for a line, such as "x", "x-y" or "0.8x-0.6y"."""
    size = np.abs(u[np.flatnonzero(u)])
    even = float(size.max() - size.min()) < 1e-9
    words = [
        ("+" if value > 0.0 else "-") + ("" if even else f"{abs(value):.2g}") + axis
        for value, axis in zip(u, axes, strict=True) if value
    ]  # fmt: skip
    return "".join(words).removeprefix("+")
