"""The damping and the dry friction of a device that motion at several speeds allows: sets, not estimates.

**The class.** A tip x moves by inertia M(x), forces F of its motors, any conservative force, and what it burns,

    burned power = v^T B v + N(x, v),

with B constant near a pose, and N dry friction: N(x, a v) = |a| N(x, v), but for a level that does not grow with the
speed (Coulomb's and Stribeck's laws are of this kind; the level may change with the place and the direction).

**The equation.** The tip goes to and fro on one line, s = u^T x, at several speeds. psi(s) >= 0 is a smooth window that
ends inside the line, Psi its integral and R = integral psi ds. The work of the motors under the window on a way there
and one back, half of it each,

    D = 1/2 sum of both ways of integral psi(s) F^T dx = c R + <B, V> + <M, Q>,
    V = 1/2 sum integral psi v v^T dt,        Q = -1/2 * 1/2 sum integral v v^T dpsi/dt dt,

where c is the window's mean of N(x, u). All conservative forces cancel, for both ways have the same window; so does the
dependence of M on the place, as far as both are equally fast. Nothing is differentiated twice
(docs/decisions/0053-identification.md has the derivation and each bound of an error).

**The set.** Each pair of ways is one equation, with a bound of its error from the step of the encoder, noise, the delay
that is not known, and the velocity. For B, M and one c a pair, those are linear inequalities (:func:`damping_set`, of a
single axis; of several, :mod:`manyhands.design.closed_motion`). Dry friction that does not grow with the speed orders
the c. So a linear program has the greatest and the least of any
entry: set membership [Milanese1991]_. What is above a lower end is not known to be there, and what is below it is
excluded by the class and the bounds alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise, product
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

Array = NDArray[np.float64]

HALF: Final = 0.015
"""s; noise is what is beyond a cubic over twice that."""

PARTS: Final = (0.03, 0.06, 0.1)
"""Of the time of a way: velocities are means over twice that, within :data:`SHORTEST` and :data:`LONGEST`, s. Over the
longer ones errors of displacements matter less, and how the velocity changes more."""

SHORTEST: Final = 0.01
LONGEST: Final = 0.06

WINDOW: Final = (-0.92, -0.4, 0.4, 0.92)
"""Where the window begins, is full, falls and ends, by half of a way: its slopes are where the tip is slow."""

SIDE: Final = (-0.2, 0.45, 0.55, 0.92)
"""Likewise that to the right, for the mass: from where the tip is fast to where it is slow."""

RATIO: Final = 1.3
"""By which the speeds of Stribeck's law in one set differ at most."""

SURE: Final = 1.3
"""By which what was seen of noise, and of the change of a velocity within :data:`HALF`, is enlarged."""

EVEN: Final = 0.1
"""Of the median time between samples, by which one may be off among those that tell the noise."""

UNEVEN: Final = 0.1
"""Of the inertia's change from side to side, how far it may be from a straight line within the window."""

ASIDE: Final = 2.0
"""How much greater than along a line an inertia may be aside of it, for the small motion aside."""

ASKEW: Final = 0.005
"""Of what is burned on a way, by which both directions may differ more at one speed than at another."""

POWERS: Final = (1.5, 1.75, 2.0, 2.25, 2.5, 2.75, 3.0)
"""Of the speed, in drag: sums of these, none negative."""

POWERED: Final = 0.01
"""Of a drag, how far a power between two of :data:`POWERS` is from their sums, at speeds of a ratio up to 25."""

BENT: Final = 0.5
"""Of its correction, that a velocity may still be off by."""

_ROUNDING: Final = 1e-12  # of a pair's work, J/J
_SEEN: Final = 65  # places of a window at which both ways are compared
_PLACES: Final = 48  # narrow windows, for friction that changes with the place: one that repeats over a tenth of a way
# is flattened in them by less than SURE


class NotOfThisClass(ValueError):
    """No parameters agree with what was measured: the device is not of the class, or a stated bound is false."""


class TooLittle(ValueError):
    """What was measured does not bound the parameters: the device hardly moved, or stuck."""


@dataclass(frozen=True)
class MeasuredMotion:
    """What was measured in one run to and fro along a line.

    Attributes:
        sampled: instants of the calls that returned displacements, s.
        x: displacements, ticks x axes, m.
        applied: instants at which forces were given, s.
        f: these forces, held until the next, N.
        level: the number of its speed; greater for a faster one.
        turns: indices of ticks at which the wanted motion turns round.
        extra: by tick, work of the motors beyond f^T dx, J: what torques that are held add.
        stale: by tick, whether the displacement is older than :class:`Doubt` says, and so is none; None where none is.
        took: by tick, how much later than ``applied`` the force may have been given, s; None for not at all.
        settled: how many of the turns come before it goes to and fro evenly.
    """

    sampled: Array
    x: Array
    applied: Array
    f: Array
    level: int
    turns: tuple[int, ...]
    extra: Array | None = None
    stale: NDArray[np.bool_] | None = None
    took: Array | None = None
    settled: int = 1


@dataclass(frozen=True)
class Doubt:
    """Between of what is not known of the measurement.

    Attributes:
        delta: of the error of a displacement, m.
        latency: of the time from the instant of a displacement, by age and delay together, to that of its force: the
            least and the greatest, s.
        jitter: by how much the age of samples varies, s.
    """

    delta: float
    latency: tuple[float, float] = (0.0, 0.0)
    jitter: float = 0.0


@dataclass(frozen=True)
class WayThrough:
    """One way under a window.

    Attributes:
        level: of its speed.
        forward: whether s grows.
        P: work under the window, J.
        V: integral psi v v^T dt, m^2/s; Q is that of inertia, m^2/s^2.
        R: integral psi |ds|, m.
        slow: the least speed where the window is open, m/s; ``fast`` the greatest.
        P_error: bound of the error of P, J; <B, V> is off by at most ``V_error`` (u^T B u + tr B/2), or without the
            trace on a single axis; <M, Q> likewise.
        K: by power p of :data:`POWERS`, integral psi |v_u|^p |ds|, which is what drag of |v|^p burns; ``K_error`` is
            the bound of its error.
        aside: the mean way aside by the way ahead.
        squares: v_u^2 over the places of the window, m^2/s^2.
        speed_error: bound of the error of v_u, m/s.
    """

    level: int
    forward: bool
    P: float
    V: Array
    Q: Array
    R: float
    slow: float
    fast: float
    P_error: float
    V_error: float
    Q_error: float
    K: Array
    K_error: Array
    aside: Array
    squares: Array
    speed_error: float


@dataclass(frozen=True)
class ThereAndBack:
    """A way there and one back, which is one equation (see the module).

    Attributes:
        level, D, V, Q, R, slow, fast, D_error, V_error, Q_error, K, K_error, aside: those of both ways, as of
            :class:`WayThrough`.
        tilted: as Q, for an inertia that grows from -1 to 1 over the window, m^2/s^2.
        apart: as Q, for one that changes by at most 1 in any way.
        odd: half of the difference of both works, J, with ``odd_V`` and ``odd_Q`` likewise.
        odd_aside: what M may add to the odd work by motion aside, by u^T M u, m^2/s^2.
        slowest: over the places of the window, the least speed of both ways, m/s; ``fastest`` the greatest.
        psi: the window over these places.
    """

    level: int
    D: float
    V: Array
    Q: Array
    R: float
    slow: float
    fast: float
    D_error: float
    V_error: float
    Q_error: float
    K: Array
    K_error: Array
    aside: Array
    tilted: float
    apart: float
    odd: float
    odd_V: float
    odd_Q: float
    odd_aside: float
    slowest: Array
    fastest: Array
    psi: Array


@dataclass(frozen=True)
class Line:
    """What was measured along one line.

    Attributes:
        u: its direction, not normalised: +-1 and 0.
        pairs: under the window in the middle.
        sides: under a window to the left and to the right of it.
        places: by narrow window of the slowest level, the burned work by its R, N, and the bound of its error.
    """

    u: Array
    pairs: tuple[ThereAndBack, ...]
    sides: tuple[tuple[ThereAndBack, ...], tuple[ThereAndBack, ...]]
    places: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class Between:
    """From the least to the greatest value."""

    low: float
    high: float

    def holds(self, value: float) -> bool:
        """Whether the value is in it."""
        return self.low <= value <= self.high


@dataclass(frozen=True)
class Identified:
    """What the set allows near one pose.

    Attributes:
        damping: the least eigenvalue of B, N*s/m: ``low`` is what an ``osp`` on all axes may be.
        by_line: u^T B u by line, for u of length 1.
        friction: by line, the levels c of dry friction at speed, over all places, N.
        by_axis: c_i by axis with sum c_i |v_i| <= N(x, v) for all v, N.
        mass: u^T M u by line.
        stribeck: whether only friction that falls with the speed agrees with the data.
    """

    damping: Between
    by_line: tuple[Between, ...]
    friction: tuple[Between, ...]
    by_axis: tuple[float, ...]
    mass: tuple[Between, ...]
    stribeck: bool


def lines(m: int) -> list[Array]:
    """The lines that determine B, and bound dry friction in all directions: axes and full diagonals, as +-1 and 0."""
    axes = list(np.eye(m))
    return axes if m == 1 else axes + [np.array([1.0, *signs]) for signs in product((1.0, -1.0), repeat=m - 1)]


# --- from samples to ways


def encoder_step(x: Array) -> float | None:
    """The step of which all differences of these displacements (m) are multiples; None where there is none."""
    jumps = np.abs(np.diff(np.unique(x)))
    jumps = jumps[jumps > 1e-12]
    if len(jumps) < 10:
        return None
    step = float(jumps.min())
    for _ in range(3):  # the smallest difference is rounded: refine by all of them
        counts = np.round(jumps / step)
        step = float(jumps @ counts / (counts @ counts))
    return step if float(np.max(np.abs(jumps / step - np.round(jumps / step)))) < 1e-3 else None


def noise_of(motion: MeasuredMotion, u: Array, step: float) -> float:
    """A bound of the error of a displacement along u, m: half a step, or what is beyond a cubic over :data:`HALF`.

    It is looked for where ticks are even and no sample is too old.
    """
    gap = np.diff(motion.sampled)
    n = max(3, round(HALF / 2.0 / float(np.median(gap))))
    uneven = np.append(np.abs(gap / np.median(gap) - 1.0) > EVEN, False)
    if motion.stale is not None:
        uneven |= motion.stale
    even = np.convolve(uneven[motion.turns[0] :], np.ones(2 * n + 1), "valid") == 0
    powers = np.vander(np.arange(-n, n + 1) / n, 4)
    weights = np.linalg.pinv(powers)[-1]  # of the fit's value in the middle
    worst = 0.0
    for axis in np.flatnonzero(u):
        x = motion.x[motion.turns[0] :, axis]
        fit = np.convolve(x, weights[::-1], "valid")
        worst = max(worst, float(np.max(np.abs(x[n : len(x) - n] - fit)[even], initial=0.0)))
    return max(0.5 * step, SURE * worst)


@dataclass(frozen=True)
class _Window:
    """psi(s): 0 up to ``begins``, 1 from ``full`` to ``falls``, 0 from ``ends`` on, and halves of a cosine between."""

    begins: float
    full: float
    falls: float
    ends: float

    def at(self, s: Array) -> Array:
        up = np.clip((s - self.begins) / (self.full - self.begins), 0.0, 1.0)
        down = np.clip((self.ends - s) / (self.ends - self.falls), 0.0, 1.0)
        return np.asarray(np.sin(0.5 * np.pi * up) ** 2 * np.sin(0.5 * np.pi * down) ** 2)

    def integral(self, s: Array) -> Array:
        def ramp(z: Array) -> Array:  # the integral of sin^2(pi z/2), and 1 beyond 1
            inside = np.clip(z, 0.0, 1.0)
            return np.asarray(0.5 * (inside - np.sin(np.pi * inside) / np.pi) + np.maximum(z - 1.0, 0.0))

        rise, fall = self.full - self.begins, self.ends - self.falls
        up, down = rise * ramp((s - self.begins) / rise), fall * ramp((self.ends - s) / fall)
        whole = 0.5 * rise + self.falls - self.full + 0.5 * fall
        return np.where(s < self.falls, up, whole - down)

    @property
    def steepest(self) -> float:
        """The greatest |psi'|, 1/m."""
        return 0.5 * np.pi / min(self.full - self.begins, self.ends - self.falls)

    def places(self) -> Array:
        return np.linspace(self.begins, self.ends, _SEEN)


@dataclass(frozen=True)
class Run:
    """A motion along a line, by the instants at which its forces changed: s, v and f along it; y and w in all axes."""

    motion: MeasuredMotion
    u: Array
    t: Array
    y: Array
    w: Array
    s: Array
    v: Array
    f: Array
    bend: Array
    between: Array  # s, between the samples around each instant
    n: int
    half: float

    def by_parts(self, weights: Array, off: Array) -> float:
        """Bound of the error of sum weights v, where displacements are off by ``off``: v is a difference of them."""
        n, span = self.n, 2.0 * self.half
        padded, around = np.pad(weights, 2 * n), np.pad(off, 2 * n, mode="edge")
        once = np.abs(padded[2 * n :] - padded[: -2 * n]) @ around[n:-n] / span
        twice = np.abs(padded[4 * n :] - padded[: -4 * n]) @ off / (2.0 * span)
        return float(4.0 / 3.0 * once + twice / 3.0)

    def pull(self, part: slice) -> float:
        """A bound of the acceleration on a way, m/s^2."""
        v, t = self.v[part], self.t[part]
        n = min(self.n, len(v) // 4)
        return SURE * float(np.max(np.abs(v[2 * n :] - v[: -2 * n]) / (t[2 * n :] - t[: -2 * n])))


def run_of(motion: MeasuredMotion, u: Array, doubt: Doubt, part: float) -> Run:
    """Displacements and velocities at the instants of the forces, as far as age and delay are known.

    Velocities are means over twice this part of a way.
    """
    late = 0.5 * (doubt.latency[0] + doubt.latency[1])
    t, length = motion.applied, u / np.sqrt(u @ u)
    kept = np.ones(len(t), bool) if motion.stale is None else ~motion.stale
    sampled = motion.sampled[kept]
    y = np.column_stack([np.interp(t + late, sampled, x) for x in motion.x[kept].T])
    between = np.diff(sampled)[np.clip(np.searchsorted(sampled, t + late) - 1, 0, len(sampled) - 2)]
    stroke = float(np.median(np.diff(t[list(motion.turns)])))  # from one turn to the next, s
    half = min(LONGEST, max(SHORTEST, part * stroke))
    n = max(1, round(half / float(np.median(np.diff(t)))))
    half = 0.5 * float(np.min(t[2 * n :] - t[: -2 * n], initial=2.0 * half))  # late ticks are followed by short ones

    def mean_velocity(n: int) -> Array:
        first, last = np.maximum(np.arange(len(t)) - n, 0), np.minimum(np.arange(len(t)) + n, len(t) - 1)
        return np.asarray((y[last] - y[first]) / (t[last] - t[first])[:, None])

    # a mean over twice the time is off four times as much: a third of the difference corrects the shorter one
    bend = (mean_velocity(n) - mean_velocity(2 * n)) / 3.0
    w = mean_velocity(n) + bend
    return Run(
        motion, length, t, y, w, y @ length, w @ length, motion.f @ length, np.abs(bend @ length), between, n, half
    )


def _ways(runs: Sequence[Run], window: _Window, doubt: Doubt) -> Iterator[WayThrough | None]:
    """The ways between two turns; None for one that does not cross the window, or stops in it.

    Of the same motion with several means of velocity, each way is told with the least bound of an error.
    """
    turns = runs[0].motion.turns
    for a, b in pairwise(turns):
        told = [way for run in runs if (way := _way(run, slice(a, b + 1), window, doubt)) is not None]
        yield min(told, key=lambda way: way.Q_error, default=None)


def _way(run: Run, part: slice, window: _Window, doubt: Doubt) -> WayThrough | None:
    s, t, v, w, u = run.s[part], run.t[part], run.v[part], run.w[part], run.u
    sign = 1.0 if s[-1] > s[0] else -1.0
    first, last = (s[0], s[-1]) if sign > 0.0 else (s[-1], s[0])
    if min(window.begins - first, last - window.ends) < 2.0 * doubt.delta:
        return None
    gap, psi, Psi = np.diff(t), window.at(s), window.integral(s)
    opened = psi > 1e-6
    fast, bend = float(np.max(sign * v[opened])), BENT * run.bend[part]
    left_out = np.maximum(run.between[part] ** 2 - float(np.median(run.between)) ** 2, 0.0) / 8.0 * run.pull(part)
    off = doubt.delta + 0.5 * np.abs(v) * doubt.jitter + left_out  # of a displacement, beside a constant age
    speed_error = 5.0 / 3.0 * float(np.max(off)) / run.half + float(
        np.max(bend[opened])
    )  # of v: with what the correction adds
    slow = float(np.min(sign * v[opened])) - speed_error
    if slow <= 0.0 or float(gap.max()) > HALF or float(np.max(run.between[part])) > HALF:
        return None
    R = float(np.abs(Psi[-1] - Psi[0]))

    def error(weights: Array) -> float:
        """Bound of the error of sum weights v, with that of the correction."""
        return run.by_parts(weights, off) + float(np.abs(weights) @ bend)

    # over the window, not over time: exact in the place, and one factor v
    over, slopes = _centred(Psi), _centred(psi)
    V = float(over @ v) * np.outer(u, u)
    V_error = error(over) + float(np.abs(np.diff(v)) @ (psi * off)[1:])
    powers = np.array(POWERS)
    steep = [error(over * p * np.maximum(sign * v, slow) ** (p - 1.0)) for p in POWERS]
    turned = 0.5 * powers * np.abs(powers - 1.0) * speed_error**2  # times v^(p-2): what a straight line leaves out
    bounds = np.maximum(slow ** (powers - 2.0), (fast + speed_error) ** (powers - 2.0))
    raised = np.maximum(sign * v, 0.0)[:, None] ** powers
    K = sign * over @ raised
    K_error = np.array(steep) + turned * bounds * R + (psi * off)[1:] @ np.abs(np.diff(raised, axis=0))
    beside = w - np.outer(v, u)
    weights = psi * _centred(t)
    cross = np.einsum("k,ki,k->i", weights, beside, v)
    V = V + np.outer(u, cross) + np.outer(cross, u) + np.einsum("k,ki,kj->ij", weights, beside, beside)
    Q = -0.5 * np.einsum("k,ki,kj->ij", slopes, w, w)
    Q_error = (
        error(slopes * v) + speed_error**2 + 0.5 * window.steepest * float(np.abs(np.diff(v**2)) @ (opened * off)[1:])
    )
    order = np.argsort(s)
    squares = np.interp(window.places(), s[order], v[order] ** 2)
    P, P_error = _work(run, part, window, doubt)
    return WayThrough(
        run.motion.level, sign > 0.0, P, V, Q, R, slow, fast + speed_error, P_error, V_error, Q_error,
        K, K_error,
        weights @ beside / R, squares, speed_error,
    )  # fmt: skip


def _centred(values: Array) -> Array:
    """Half the difference of both neighbours; their sum is that of all differences."""
    return np.gradient(values) if len(values) > 1 else np.zeros_like(values)


def _work(run: Run, part: slice, window: _Window, doubt: Doubt) -> tuple[float, float]:
    """The work of the motors under the window, J, and a bound of its error.

    A force acts from its instant to the next one's. Summed by parts, an error of a displacement counts as much as the
    force changes there.
    """
    s, v, u, f = run.s[part], run.v[part], run.u, run.f[part][:-1]
    gap = np.diff(run.t[part])
    psi = window.at(0.5 * (s[1:] + s[:-1]))
    dy = np.diff(run.y[part], axis=0)
    F_beside = run.motion.f[part][:-1] - np.outer(f, u)
    P = float(f @ np.diff(window.integral(s)) + np.sum(psi[:, None] * F_beside * dy))
    if run.motion.extra is not None:
        P += float(psi @ run.motion.extra[part][:-1])
    jumps = np.linalg.norm(np.diff(run.motion.f[part][:-1], axis=0), axis=1)
    unknown = 0.5 * (doubt.latency[1] - doubt.latency[0])
    between = np.maximum(np.maximum(gap[1:], gap[:-1]), run.between[part][1:-1])
    off = doubt.delta + between**2 / 8.0 * run.pull(part)  # a place between two samples is interpolated
    off += np.abs(v[1:-1]) * (unknown + (0.0 if run.motion.took is None else run.motion.took[part][1:-1]))
    return P, float(jumps @ (window.at(s[1:-1]) * off)) + _ROUNDING * abs(P)


def _pairs(run: Sequence[Run], window: _Window, doubt: Doubt) -> list[ThereAndBack]:
    """One pair of each way there with the next one back."""
    found: list[ThereAndBack] = []
    before: WayThrough | None = None
    places = window.places()
    psi = window.at(places)
    slope, tilt = np.gradient(psi), np.linspace(-1.0, 1.0, _SEEN)
    for way in _ways(run, window, doubt):
        if way is None or before is None or way.forward == before.forward:
            before = way
            continue
        there, back = (before, way) if before.forward else (way, before)
        differ = -0.25 * (there.squares - back.squares)
        off = max(there.speed_error, back.speed_error)
        speeds = np.sqrt(np.stack([there.squares, back.squares]))
        found.append(
            ThereAndBack(
                way.level,
                0.5 * (there.P + back.P),
                0.5 * (there.V + back.V),
                0.5 * (there.Q + back.Q),
                0.5 * (there.R + back.R),
                min(there.slow, back.slow),
                max(there.fast, back.fast),
                0.5 * (there.P_error + back.P_error),
                0.5 * (there.V_error + back.V_error),
                0.5 * (there.Q_error + back.Q_error),
                0.5 * (there.K + back.K),
                0.5 * (there.K_error + back.K_error),
                0.5 * (there.aside - back.aside),
                float(differ @ (tilt * slope)),
                float(np.abs(differ) @ np.abs(slope)),
                0.5 * (there.P - back.P),
                0.5 * float(np.trace(there.V) - np.trace(back.V)),
                0.5 * float(run[0].u @ (there.Q - back.Q) @ run[0].u),
                float(
                    np.linalg.norm(
                        (there.Q - back.Q) @ run[0].u - run[0].u * (run[0].u @ (there.Q - back.Q) @ run[0].u)
                    )
                ),
                np.maximum(speeds.min(axis=0) - off, 0.0),
                speeds.max(axis=0) + off,
                psi,
            )
        )
        before = None
    return found


def measured_line(motions: Sequence[MeasuredMotion], u: Array, doubt: Doubt) -> Line:
    """The pairs of ways along a line.

    Args:
        motions: along it, at several levels of speed.
        u: its direction, as :func:`lines` has it.
        doubt: what is not known of the measurement.

    Raises:
        TooLittle: at fewer than two levels the device went to and fro without a stop.
    """
    runs = [[run_of(motion, u, doubt, part) for part in PARTS] for motion in motions]
    ends = [run[0].s[list(run[0].motion.turns)] for run in runs]
    low = max(float(np.median(e[e < np.mean(e)])) for e in ends)
    high = min(float(np.median(e[e > np.mean(e)])) for e in ends)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    if half < 20.0 * doubt.delta:
        raise TooLittle(
            f"found ways of {1e3 * half:.3g} mm to each side; expected more than {2e4 * doubt.delta:.3g} mm, "
            "twenty times what a displacement may be off by: something holds the device, or the force is too small for "
            "its friction"
        )

    def pairs(window: Sequence[float], of: Sequence[list[Run]]) -> list[ThereAndBack]:
        found = _Window(*(middle + half * place for place in window))
        return [pair for run in of for pair in _pairs(run, found, doubt)]

    main = pairs(WINDOW, runs)
    levels = {pair.level for pair in main}
    if len(levels) < 2:
        raise TooLittle(
            f"found ways without a stop at {len(levels)} of {len(motions)} speeds; expected two or more: give more "
            "force, more travel, or a greater speed"
        )
    aside = pairs([-place for place in reversed(SIDE)], runs), pairs(SIDE, runs)
    slowest, places, wide = min(levels), [], 2.0 * WINDOW[3] / _PLACES
    for place in np.linspace(WINDOW[0] + wide, WINDOW[3] - wide, _PLACES):
        narrow = [place - wide, place - 0.01 * wide, place + 0.01 * wide, place + wide]
        for pair in pairs(narrow, [run[:1] for run in runs if run[0].motion.level == slowest])[:2]:
            places.append((pair.D / pair.R, pair.D_error / pair.R))
    return Line(u, tuple(main), (tuple(aside[0]), tuple(aside[1])), tuple(places))


# --- from ways to sets


def mass_interval(line: Line) -> tuple[Between, float]:
    """u^T M u for u of length 1, by where a way speeds up and slows down, and how much it changes on the way, kg.

    Half of the difference of both ways' work is G + <M, Q'>; G is of conservative forces, the same at every speed.

    Raises:
        TooLittle: no way speeds up or slows down.
    """
    damping, found = POWERS[-1] * _greatest(line)[0], []  # v^p changes p times as much as v
    more = 1.0 if len(line.u) == 1 else 2.0
    for side in line.sides:
        rows, limits = [], []
        for pair in side:
            slack = pair.D_error + damping * (abs(pair.odd_V) + pair.V_error) + ASKEW * abs(pair.D)
            for sign in (1.0, -1.0):
                rows.append([sign, sign * pair.odd_Q - more * pair.Q_error - ASIDE * pair.odd_aside])
                limits.append(sign * pair.odd + slack)
        if rows:
            found.append(range_of(np.array([0.0, 1.0]), np.array(rows), np.array(limits), 1))
    if not all(found):
        raise NotOfThisClass(
            "found no mass that agrees with how it speeds up; expected one: a hand, a cable or a filter"
        )
    if not found or not np.isfinite(found).all():
        raise TooLittle("found no bound of the moving mass; expected ways at different speeds: give a greater speed")
    middles = [0.5 * (low + high) for low, high in found]
    low, high = min(one[0] for one in found), max(one[1] for one in found)
    return Between(max(0.0, low), high), max(middles) - min(middles)


def range_of(c: Array, A: Array, b: Array, free: int, ends_of: Sequence[float] = (1.0, -1.0)) -> list[float]:
    """The least and the greatest c^T z for A z <= b, with the first ``free`` entries of z of any sign; [] if empty.

    ``ends_of`` has 1 for the least, and -1 for the greatest.
    """
    bounds = [(None, None) if i < free else (0.0, None) for i in range(len(c))]
    ends = []
    scale = float(np.max(np.abs(b), initial=1e-12))
    for sign in ends_of:
        answer = linprog(sign * c, A_ub=A / scale, b_ub=b / scale, bounds=bounds, method="highs")
        if answer.status == 2:
            return []
        ends.append(sign * float(answer.fun) if answer.status == 0 else -sign * np.inf)
    return ends


@dataclass(frozen=True)
class Speeds:
    """The speeds that an equation of the set is about.

    Attributes:
        line: the number of its line.
        slowest: bounds of the speed from below, m/s; ``fastest`` from above.
        weights: how much each counts.
    """

    line: int
    slowest: Array
    fastest: Array
    weights: Array

    def left(self, stribeck: float, speeds: Array) -> float:
        """The mean of e^-(v/v_s)^2 over these speeds, for v_s in m/s; 0 is no such part."""
        if stribeck == 0.0:
            return 0.0
        return float(np.exp(-np.minimum((speeds / stribeck) ** 2, 700.0)) @ self.weights / self.weights.sum())


@dataclass
class Inequalities:
    """Linear inequalities row^T z <= limit on all that the class leaves open.

    z begins with ``free`` entries of any sign. None of the others is negative: the mean friction c of each equation,
    and by line the c beyond Stribeck's speed, what rest adds to it, and the drag of each power.

    Attributes:
        free: how many entries come first.
        speeds: of each equation.
        lines: how many there are.
        rows: of what was measured, with their ``limits``.
        order: rows and limits of friction that does not grow with the speed, and of no drag.
    """

    free: int
    speeds: Sequence[Speeds]
    lines: int
    rows: list[Array] = field(default_factory=list)
    limits: list[float] = field(default_factory=list)
    order: list[tuple[Array, float]] = field(default_factory=list)

    def empty(self) -> Array:
        """A row of zeros."""
        return np.zeros(self.level(self.lines))

    def level(self, line: int) -> int:
        """Where z has the c of this line; next to it is what rest adds, and then its drag."""
        return self.free + len(self.speeds) + (2 + len(POWERS)) * line

    def drag(self, line: int) -> slice:
        """Where z has the drag of this line."""
        return slice(self.level(line) + 2, self.level(line + 1))

    def add(self, row: Array, limit: float) -> None:
        """row^T z <= limit."""
        self.rows.append(row)
        self.limits.append(limit)

    def without_drag(self, line: int) -> None:
        """Add to ``order`` that this line has no drag."""
        row = self.empty()
        row[self.drag(line)] = 1.0
        self.order.append((row, 0.0))

    def no_greater(self, faster: int, slower: int, limit: float = 0.0) -> None:
        """Add to ``order`` that the friction of one equation is not above another's, but for ``limit``, N."""
        row = self.empty()
        row[self.free + faster], row[self.free + slower] = 1.0, -1.0
        self.order.append((row, limit))

    def falling(self) -> tuple[Array, Array]:
        """The set where friction falls with the speed in any way, and there is no drag."""
        return self._ordered(self.rows, self.limits)

    def with_stribeck(self, least: float, most: float) -> tuple[Array, Array]:
        """The set with drag and c + more e^-(v/v_s)^2 along each line, for v_s in this range, m/s; 0: no such part."""
        rows, limits = list(self.rows), list(self.limits)
        for number, one in enumerate(self.speeds):
            level = self.level(one.line)
            row = self.empty()
            row[self.free + number], row[level] = 1.0, -1.0
            row[level + 1] = -one.left(most, one.slowest)
            other = -row
            other[level + 1] = one.left(least, one.fastest)
            rows += [row, other]
            limits += [0.0, 0.0]
        return np.array(rows), np.array(limits)

    def coulomb(self) -> tuple[Array, Array]:
        """The set where friction is the same at all speeds, and there is no drag."""
        rows, limits = self.with_stribeck(0.0, 0.0)
        return self._ordered(rows, limits)

    def _ordered(self, rows: Iterable[Array], limits: Iterable[float]) -> tuple[Array, Array]:
        more, bounds = zip(*self.order, strict=True)
        return np.array([*rows, *more]), np.array([*limits, *bounds])


def stribeck_ranges(least: float, fastest: float) -> list[tuple[float, float]]:
    """Ranges of Stribeck's speed: none, below ``least``, and on to half of the ``fastest``, m/s."""
    edges = [least]
    while edges[-1] < fastest / 2.0:
        edges.append(edges[-1] * RATIO)
    return [(0.0, 0.0), *zip([0.0, *edges], edges, strict=False)]


def none_agree(what: str) -> NotOfThisClass:
    """The error where ``what`` has no values that agree with what was measured."""
    return NotOfThisClass(
        f"found no {what} that agree with what was measured; expected a device that burns b v^2, dry friction which "
        "does not grow with the speed, and drag: something else acts on it (a hand, a cable, a filter or a force of "
        "its own), or its driver's sample_age, actuation_delay or step is too small"
    )


def _greatest(line: Line) -> tuple[float, float]:
    """Above what u^T B u and drag by v can be (N*s/m), and what dry friction can (N), by all that was burned."""
    top = max(pair.level for pair in line.pairs)  # where drag is greatest
    damping = max(
        (pair.D + pair.D_error) / max(float(np.trace(pair.V)) - pair.V_error, 1e-30)
        for pair in line.pairs
        if pair.level == top
    )
    return max(damping, 0.0), max(0.0, *((pair.D + pair.D_error) / pair.R for pair in line.pairs))


def _constraints(line: Line, mass: Between, change: float) -> Inequalities:
    """On a single axis, whose z begins with b and m; the mass changes by ``change`` from side to side."""
    speeds = [Speeds(0, pair.slowest, pair.fastest, pair.psi) for pair in line.pairs]
    found = Inequalities(2, speeds, 1)
    for number, pair in enumerate(line.pairs):
        error = pair.D_error + change * (SURE * abs(pair.tilted) + UNEVEN * pair.apart)
        for sign in (1.0, -1.0):
            row = found.empty()
            row[0] = sign * pair.V[0, 0] - pair.V_error
            row[1] = sign * pair.Q[0, 0] - pair.Q_error
            row[found.free + number] = sign * pair.R
            row[found.drag(0)] = sign * pair.K - pair.K_error - POWERED * pair.K
            found.add(row, sign * pair.D + error)
    b, m = found.empty(), found.empty()
    b[0] = m[1] = 1.0
    found.add(m, mass.high)
    found.add(-m, -mass.low)
    found.add(-b, 0.0)
    for number, slower in enumerate(line.pairs):
        for other, faster in enumerate(line.pairs):
            if bool(np.all(faster.slowest >= slower.fastest)):
                found.no_greater(other, number)
    found.without_drag(0)
    return found


def damping_set(line: Line) -> Identified:
    """All that the class and what was measured of a single axis allow.

    Raises:
        NotOfThisClass: the set is empty.
        TooLittle: the mass is not bounded.
    """
    mass, change = mass_interval(line)
    base = _constraints(line, mass, change)
    speeds = [pair.slow for pair in line.pairs]
    sets = [base.with_stribeck(*ends) for ends in stribeck_ranges(min(speeds) / 4.0, max(speeds))]
    b, level = base.empty(), base.empty()
    b[0] = level[base.level(0)] = 1.0
    ends = [range_of(b, *one, base.free) for one in (base.falling(), *sets)]
    found = [of for of in ends if of]
    if not found:
        raise none_agree("damping, mass and friction")
    formed = [of for of in ends[1:] if of] or found
    low, high = min(of[0] for of in found), max(of[1] for of in formed)
    damping = Between(max(0.0, low), max(high, low))
    levels = [end for one, of in zip(sets, ends[1:], strict=True) if of for end in range_of(level, *one, base.free)]
    friction = least_friction(line, levels, _greatest(line)[1])
    return Identified(
        Between(min(damping.low, damping.high), damping.high),
        (damping,),
        (friction,),
        (friction.low,),
        (mass,),
        not range_of(b, *base.coulomb(), base.free),
    )


def least_friction(line: Line, levels: Sequence[float], most: float) -> Between:
    """The level of the window's mean, less what the place may take, and up to what it may add; or up to ``most``."""
    if not levels or not line.pairs:
        return Between(0.0, most)
    dip = rise = 0.0
    if line.places:
        mean = float(np.mean([level for level, _ in line.places]))
        dip = max(0.0, *(SURE * (mean - level) + error for level, error in line.places))
        rise = max(0.0, *(SURE * (level - mean) + error for level, error in line.places))
    aside = float(np.linalg.norm(np.mean([pair.aside for pair in line.pairs], axis=0)))
    low, high = min(levels), max(levels)
    return Between(max(0.0, low - dip - aside * high), (high + rise) * (1.0 + aside))
