"""The experiment: strokes to and fro on lines through a pose, at several speeds (:func:`experiment`).

A virtual spring and a virtual damper, both weak, pull the tip after a place that goes to and fro with rounded turns:
:data:`BANDWIDTH` beside the device's own mass, so that age and delay of tens of milliseconds leave it stable. Before
anything is measured the servo learns what the device needs on top: bias, dry friction, damping and mass. Then these are
constants, so that the force is smooth. What the servo does is no part of the result: the result knows the forces that
were given, and where the device was.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

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
from manyhands.nodes.kernel.arithmetic import Floats, dot

Array = NDArray[np.float64]

LEVELS: Final = ((0.12, 3), (0.25, 4), (0.5, 5), (1.0, 7))
"""Of the greatest speed, and how many times to and fro."""

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

    def at(self, speed: float) -> float:
        """Go to and fro with this speed in the middle, m/s; returns the time of one stroke there and back, s."""
        self.omega = speed * math.asin(ROUNDED) / (self.travel * ROUNDED)
        return 2.0 * math.pi / self.omega

    def __call__(self, x: Floats, v: Floats, t: float) -> Floats:
        """The force, N."""
        phase = self.omega * t
        sin, cos = ROUNDED * math.sin(phase), ROUNDED * math.cos(phase)
        root, scale = math.sqrt(1.0 - sin * sin), self.travel / math.asin(ROUNDED)
        want, speed = scale * math.asin(sin), scale * self.omega * cos / root
        # d/dt of cos/root, with ROUNDED in both
        push = scale * self.omega**2 * sin * (cos * cos / root**3 - 1.0 / root)
        stiffness, damper = self.mass * BANDWIDTH**2, 2.0 * DAMPED * self.mass * BANDWIDTH
        guide = self.mass * (ACROSS**2 - BANDWIDTH**2), 2.0 * DAMPED * self.mass * (ACROSS - BANDWIDTH)
        ease = max(-1.0, min(1.0, speed / (0.1 * scale * self.omega)))
        ahead = self.mass * push + self.damping * speed + self.friction * ease
        lacks = [a + u * want - b for u, a, b in zip(self.u, self.origin, x, strict=True)]
        behind, along = dot(self.u, lacks), dot(self.u, v)
        f = [
            stiffness * lack
            + damper * (u * speed - w)
            + guide[0] * (lack - u * behind)  # aside of the line
            - guide[1] * (w - u * along)
            + u * ahead
            + bias
            for u, lack, w, bias in zip(self.u, lacks, v, self.bias, strict=True)
        ]
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
    bias, mass = [0.0] * m, FIRST_MASS if stated.mass is None else float(np.mean(stated.mass))
    runs: list[tuple[Array, list[MeasuredMotion]]] = []
    for u in lines(m):
        length = [float(entry) for entry in u / np.sqrt(u @ u)]
        name = _line_name(u, stated.axes)
        servo = _Servo(length, list(origin), rig.safety.travel, mass, list(bias), T=rig.T, most=0.7 * min(rig.force))
        speed = _warmed(rig, servo, tell, name)
        mass, bias = servo.mass, list(servo.bias)
        motions = []
        for level, (part, times) in enumerate(LEVELS):
            tell(f"{name}: {times} times to and fro at {part * speed:.3g} m/s")
            log = _run(rig, servo, (times + 0.3) * servo.at(part * speed), tell)
            motions.append(_motion(log, level, servo))
        runs.append((u, motions))
    return evaluated(tuple(origin), runs, rig)


def _run(rig: Rig, servo: Controller, duration: float, tell: Told) -> MotionLog:
    """One run; again from its origin where a machine that gave the loop no turn let the device coast out of bounds."""
    origin = rig.origin
    for _ in range(TRIES - 1):
        try:
            return rig.run(servo, duration, BEYOND * rig.safety.travel)
        except Late as error:
            tell(f"once more, for a tick came {1e3 * rig.longest:.3g} ms after the one before: {error}")
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
            f"the device is {1e3 * off:.3g} mm off its next pose; expected it nearer: give more force, or fewer poses"
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
            f"--poses: found {number}, and {1e3 * max(far, 0.0):.3g} mm of room beside the first; expected 1, or less "
            "travel"
        )
    ways = [0.0, *(part for pair in range(1, number) for part in (1.0 / pair, -1.0 / pair))]
    return [[x + far * part for x in start] for part in ways[:number]]


def _warmed(rig: Rig, servo: _Servo, tell: Told, name: str) -> float:
    """Let the servo learn; returns the greatest speed that force and safety leave, m/s."""
    speed = min(rig.safety.speed, 0.7 * min(rig.stated.speed))
    for part, times in WARM:
        servo.learning = True
        tell(f"{name}: the servo learns mass, damping and friction")
        log = _run(rig, servo, times * servo.at(part * speed), tell)
        fit = _fit(log, servo)
        if fit is not None:
            servo.learn(*fit)
        # what the turns take: mass times the greatest acceleration of the wanted motion
        spare = 0.8 * min(rig.force) - servo.friction - servo.damping * speed - max(map(abs, servo.bias))
        omega = speed * math.asin(ROUNDED) / (servo.travel * ROUNDED)
        peak = servo.mass * servo.travel * omega**2 * ROUNDED / math.sqrt(1.0 - ROUNDED**2) / math.asin(ROUNDED)
        if peak > max(spare, 0.05 * min(rig.force)):
            speed *= math.sqrt(max(spare, 0.05 * min(rig.force)) / peak)
    servo.learning = False
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
    """What the runs along all lines allow."""
    stated, m = rig.stated, len(origin)
    every = np.concatenate([motion.x for _, motions in runs for motion in motions])
    steps = []
    for axis in range(m):
        found = encoder_step(every[:, axis]) or 0.0
        steps.append(max(found, 0.0 if stated.step is None else stated.step[axis]))
    timing = stated.timing
    latency = (timing.sample_age - timing.jitter, timing.sample_age + timing.actuation_delay)
    measured, doubts = [], []
    for u, motions in runs:
        step = math.sqrt(float(np.count_nonzero(u))) * max(steps)
        delta = max(noise_of(motions[0], u, step), 1e-9)
        doubt = Doubt(delta, latency, timing.jitter)
        try:
            measured.append(measured_line(motions, u, doubt))
        except TooLittle as error:
            raise TooLittle(f"{_line_name(u, stated.axes)}: {error}") from error
        doubts.append(doubt)
    return AtPose(origin, tuple(measured), damping_set(measured), tuple(doubts), tuple(steps))


def line_names(axes: Sequence[str]) -> Iterator[str]:
    """A name for each line of :func:`lines`, such as "x" and "x-y"."""
    return (_line_name(u, axes) for u in lines(len(axes)))


def _line_name(u: Array, axes: Sequence[str]) -> str:
    words = [("+" if value > 0.0 else "-") + axis for value, axis in zip(u, axes, strict=True) if value]
    return "".join(words).removeprefix("+")
