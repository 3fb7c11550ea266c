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
that is not known, and the velocity. For B, M and one c a pair, those are linear inequalities (:func:`damping_set`). Dry
friction that does not grow with the speed orders the c. So a linear program has the greatest and the least of any
entry: set membership [Milanese1991]_. What is above a lower end is not known to be there, and what is below it is
excluded by the class and the bounds alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

Array = NDArray[np.float64]

HALF: Final = 0.015
"""s; velocities are means over twice that."""

WINDOW: Final = 0.6
"""Of the shortest way's half, that the window takes to each side."""

RATIO: Final = 1.3
"""By which the speeds of Stribeck's law in one set differ at most."""

SURE: Final = 1.3
"""By which what was seen of noise, and of the change of a velocity within :data:`HALF`, is enlarged."""

_ROUNDING: Final = 1e-12  # of a pair's work, J/J
_PLACES: Final = 24  # narrow windows, for friction that changes with the place


class NotOfThisClass(ValueError):
    """No parameters agree with what was measured: the device is not of the class, or a stated bound is false."""


class TooLittle(ValueError):
    """What was measured does not bound the parameters: the device hardly moved, or stuck."""


@dataclass(frozen=True)
class Motion:
    """What was measured in one run to and fro along a line.

    Attributes:
        sampled: instants of the calls that returned displacements, s.
        x: displacements, ticks x axes, m.
        applied: instants at which forces were given, s.
        f: these forces, held until the next, N.
        level: the number of its speed; greater for a faster one.
        turns: indices of ticks at which the wanted motion turns round.
        extra: by tick, work of the motors beyond f^T dx, J: what torques that are held add.
    """

    sampled: Array
    x: Array
    applied: Array
    f: Array
    level: int
    turns: tuple[int, ...]
    extra: Array | None = None


@dataclass(frozen=True)
class Doubt:
    """Bounds of what is not known of the measurement.

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
class Way:
    """One way under a window.

    Attributes:
        level: of its speed.
        forward: whether s grows.
        P: work under the window, J.
        V: integral psi v v^T dt, m^2/s * m.
        Q: that of inertia, m^2/s^2.
        R: integral psi |ds|, m.
        slow: the least speed where the window is open, m/s; ``fast`` the greatest.
        error: bound of the error of P, J; ``speed_error`` that of v, m/s; ``aside`` the mean way aside by way ahead.
        squares: v_u^2 over the places of the window, m^2/s^2.
    """

    level: int
    forward: bool
    P: float
    V: Array
    Q: Array
    R: float
    slow: float
    fast: float
    error: float
    speed_error: float
    aside: Array
    squares: Array


@dataclass(frozen=True)
class Pair:
    """A way there and one back, which is one equation (see the module)."""

    level: int
    D: float
    V: Array
    Q: Array
    R: float
    slow: float
    fast: float
    error: float
    speed_error: float
    aside: Array
    apart: float
    """Half of the mean of |v_u^2 there - v_u^2 back|, times the integral of |psi'|: what M(x) may do, m^2/s^2."""
    odd: float
    """Half of the difference of both works, J; ``odd_Q`` that of the inertia's integrals, m^2/s^2."""
    odd_Q: float


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
    pairs: tuple[Pair, ...]
    sides: tuple[tuple[Pair, ...], tuple[Pair, ...]]
    places: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class Interval:
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
        friction: by line, the level c of dry friction at speed where the place makes it least, N.
        by_axis: c_i by axis with sum c_i |v_i| <= N(x, v) for all v, N.
        mass: u^T M u by line.
        stribeck: whether only friction that falls with the speed agrees with the data.
    """

    damping: Interval
    by_line: tuple[Interval, ...]
    friction: tuple[Interval, ...]
    by_axis: tuple[float, ...]
    mass: tuple[Interval, ...]
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


def noise_of(motion: Motion, u: Array, step: float) -> float:
    """A bound of the error of a displacement along u, m: half a step, or what a slow motion shows beyond a smooth one."""
    n = 2 * round(HALF / 2.0 / float(np.median(np.diff(motion.sampled)))) + 1
    worst = 0.5 * step
    for axis in np.flatnonzero(u):
        x = motion.x[:, axis]
        smooth = np.convolve(x, np.ones(n) / n, "valid")
        inner = slice(n // 2, len(x) - n // 2)
        speed = np.abs(np.gradient(smooth))
        ahead = speed > 0.5 * np.median(speed)  # turning round bends the motion itself
        worst = max(worst, SURE * float(np.max(np.abs(x[inner] - smooth)[ahead], initial=0.0)))
    return worst


@dataclass(frozen=True)
class _Window:
    """psi(s) = cos^2(pi (s - middle)/(2 half)), up to ``half`` to each side."""

    middle: float
    half: float

    def at(self, s: Array) -> Array:
        z = np.clip((s - self.middle) / self.half, -1.0, 1.0)
        return np.asarray(np.cos(0.5 * np.pi * z) ** 2)

    def integral(self, s: Array) -> Array:
        z = np.clip((s - self.middle) / self.half, -1.0, 1.0)
        return np.asarray(0.5 * self.half * (z + np.sin(np.pi * z) / np.pi))


@dataclass(frozen=True)
class _Run:
    """A motion along a line, by the instants at which its forces changed."""

    motion: Motion
    u: Array
    t: Array
    s: Array
    y: Array
    v: Array
    bend: Array
    along: Array
    f_along: Array


def _run_of(motion: Motion, u: Array, doubt: Doubt) -> _Run:
    """Displacements and velocities at the instants of the forces, as far as age and delay are known."""
    late = 0.5 * (doubt.latency[0] + doubt.latency[1])
    t = motion.applied
    y = np.column_stack([np.interp(t + late, motion.sampled, x) for x in motion.x.T])
    n = max(1, round(HALF / float(np.median(np.diff(t)))))

    def velocity(n: int) -> Array:
        first, last = np.maximum(np.arange(len(t)) - n, 0), np.minimum(np.arange(len(t)) + n, len(t) - 1)
        return np.asarray((y[last] - y[first]) / (t[last] - t[first])[:, None])

    v = velocity(n)
    length = u / np.sqrt(u @ u)
    # a mean over twice the time bends four times as much: a third of the difference is the error of the shorter one
    bend = np.abs((velocity(2 * n) - v) @ length) / 3.0
    return _Run(motion, length, t, y @ length, y, v, bend, v @ length, motion.f @ length)


def _ways(run: _Run, window: _Window, doubt: Doubt) -> list[Way | None]:
    """The ways between two turns; None for one that does not cross the window, or stops in it."""
    turns = run.motion.turns
    return [_way(run, slice(a, b + 1), window, doubt) for a, b in zip(turns, turns[1:], strict=False)]


def _way(run: _Run, part: slice, window: _Window, doubt: Doubt) -> Way | None:
    s, t, v, along = run.s[part], run.t[part], run.v[part], run.along[part]
    gap = np.diff(t)
    sign = 1.0 if s[-1] > s[0] else -1.0
    if min(sign * (s[-1] - window.middle), sign * (window.middle - s[0])) < window.half + 2.0 * doubt.delta:
        return None
    middle = 0.5 * (s[1:] + s[:-1])
    psi, Psi = window.at(middle), window.integral(s)
    steps = np.diff(Psi)
    opened = psi > 1e-6
    speeds = sign * 0.5 * (along[1:] + along[:-1])
    speed_error = doubt.delta / HALF
    fast = float(speeds[opened].max())
    speed_error += SURE * float(np.max(run.bend[part][:-1][opened])) + fast * doubt.jitter / (2.0 * HALF)
    slow = float(speeds[opened].min()) - speed_error
    if slow <= 0.0 or float(gap.max()) > HALF:
        return None
    f, ahead = run.f_along[part][:-1], run.u
    dy = np.diff(run.y[part], axis=0)
    aside = dy - np.outer(dy @ ahead, ahead)
    F_aside = run.motion.f[part][:-1] - np.outer(f, ahead)
    P = float(f @ steps + np.sum(psi[:, None] * F_aside * aside))
    if run.motion.extra is not None:
        P += float(psi @ run.motion.extra[part][:-1])
    # summed by parts: an error of a displacement counts where the force changes
    jumps = np.linalg.norm(np.diff(run.motion.f[part][:-1], axis=0), axis=1)
    at = window.at(s[1:-1])
    unknown = 0.5 * (doubt.latency[1] - doubt.latency[0])
    between = float(gap.max()) ** 2 / 8.0 * float(np.max(np.abs(np.diff(along) / gap)))  # interpolated
    error = float(jumps @ (at * (doubt.delta + between + np.abs(along[1:-1]) * unknown)))
    error += _ROUNDING * abs(P)
    velocities = 0.5 * (v[1:] + v[:-1])
    weights = psi * gap
    V = np.einsum("k,ki,kj->ij", weights, velocities, velocities)
    # the part along the line has one factor exactly, by Psi
    V += np.outer(ahead, ahead) * float(steps @ (sign * speeds) - weights @ speeds**2)
    slopes = np.diff(window.at(s))
    Q = -0.5 * np.einsum("k,ki,kj->ij", slopes, velocities, velocities)
    beside = velocities - np.outer(velocities @ ahead, ahead)
    R = float(np.abs(Psi[-1] - Psi[0]))
    places = np.linspace(window.middle - window.half, window.middle + window.half, 65)
    order = np.argsort(s)
    squares = np.interp(places, s[order], along[order] ** 2)
    went = (weights @ beside) / R
    return Way(run.motion.level, sign > 0.0, P, V, Q, R, slow, fast + speed_error, error, speed_error, went, squares)


def _pairs(ways: Iterable[Way | None]) -> list[Pair]:
    """One pair of each way there with the next one back."""
    found, before = [], None
    for way in ways:
        if way is None or before is None or way.forward == before.forward:
            before = way
            continue
        there, back = (before, way) if before.forward else (way, before)
        differ = np.abs(there.squares - back.squares)
        # psi rises over the first half of the places and falls over the second: |psi'| has the integral 2
        shape = np.abs(np.sin(np.linspace(-np.pi, np.pi, len(differ))))
        apart = 0.5 * float(differ @ shape / shape.sum())
        found.append(
            Pair(
                way.level,
                0.5 * (there.P + back.P),
                0.5 * (there.V + back.V),
                0.5 * (there.Q + back.Q),
                0.5 * (there.R + back.R),
                min(there.slow, back.slow),
                max(there.fast, back.fast),
                0.5 * (there.error + back.error),
                max(there.speed_error, back.speed_error),
                0.5 * (there.aside - back.aside),
                apart,
                0.5 * (there.P - back.P),
                0.5 * float(np.trace(there.Q) - np.trace(back.Q)),
            )
        )
        before = None
    return found


def measured_line(motions: Sequence[Motion], u: Array, doubt: Doubt) -> Line:
    """The pairs of ways along a line.

    Args:
        motions: along it, at several levels of speed.
        u: its direction, as :func:`lines` has it.
        doubt: what is not known of the measurement.

    Raises:
        TooLittle: at fewer than two levels the device went to and fro without a stop.
    """
    runs = [_run_of(motion, u, doubt) for motion in motions]
    ends = [run.s[list(run.motion.turns)] for run in runs]
    low = max(float(np.median(e[e < np.mean(e)])) for e in ends)
    high = min(float(np.median(e[e > np.mean(e)])) for e in ends)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    if half < 20.0 * doubt.delta:
        raise TooLittle(
            f"found ways of {1e3 * half:.3g} mm to each side; expected more than {2e4 * doubt.delta:.3g} mm, twenty times "
            "what a displacement may be off by: something holds the device, or the force is too small for its friction"
        )

    def pairs(window: _Window, of: Sequence[_Run]) -> list[Pair]:
        return [pair for run in of for pair in _pairs(_ways(run, window, doubt))]

    main = pairs(_Window(middle, WINDOW * half), runs)
    if len({pair.level for pair in main}) < 2:
        raise TooLittle(
            f"found ways without a stop at {len({pair.level for pair in main})} of {len(motions)} speeds; expected two or "
            "more: give more force, more travel, or a greater speed"
        )
    aside = [pairs(_Window(middle + way * 0.65 * half, 0.3 * half), runs) for way in (-1.0, 1.0)]
    slowest = min(pair.level for pair in main)
    places = []
    wide = WINDOW * half / _PLACES * 2.0
    for place in np.linspace(-1.0, 1.0, _PLACES + 1):
        window = _Window(middle + place * (WINDOW * half - wide), wide)
        for pair in pairs(window, [run for run in runs if run.motion.level == slowest])[:2]:
            places.append((pair.D / pair.R, pair.error / pair.R))
    return Line(u, tuple(main), (tuple(aside[0]), tuple(aside[1])), tuple(places))


# --- from ways to sets


def mass_interval(line: Line) -> Interval:
    """u^T M u for u of length 1, by where a way speeds up and slows down; it also covers how it changes on the way.

    Raises:
        TooLittle: no way speeds up or slows down.
    """
    found = []
    for side in line.sides:
        rows, limits = [], []
        for pair in side:
            # b and c are nearly the same both ways, and cancel: what is left of them is in the error
            slack = pair.error + 0.02 * abs(pair.D)
            slack += pair.speed_error * pair.fast * _mass_guess(side)
            rows += [[1.0, pair.odd_Q], [-1.0, -pair.odd_Q]]
            limits += [pair.odd + slack, -pair.odd + slack]
        if rows:
            found += _range(np.array([0.0, 1.0]), np.array(rows), np.array(limits), 1)
    if not found:
        raise TooLittle("found no way that speeds up; expected some: give more travel, or a greater speed")
    low, high = min(found), max(found)
    if not np.isfinite(high):
        raise TooLittle("found no bound of the moving mass; expected ways at different speeds: give a greater speed")
    return Interval(max(0.0, 0.95 * low), 1.05 * high)


def _mass_guess(side: Sequence[Pair]) -> float:
    Q, P = np.array([pair.odd_Q for pair in side]), np.array([pair.odd for pair in side])
    spread = Q - Q.mean()
    return abs(float(spread @ P / max(float(spread @ spread), 1e-30)))


def _range(c: Array, A: Array, b: Array, free: int, extra: Array | None = None) -> list[float]:
    """The least and the greatest c^T z for A z <= b, with the first ``free`` entries of z of any sign; [] if empty."""
    bounds = [(None, None) if i < free else (0.0, None) for i in range(len(c))]
    ends = []
    scale = float(np.max(np.abs(b), initial=1e-12))
    for sign in (1.0, -1.0):
        answer = linprog(sign * c, A_ub=A / scale, b_ub=b / scale, bounds=bounds, method="highs")
        if answer.status == 2:
            return []
        ends.append(sign * float(answer.fun) if answer.status == 0 else -sign * np.inf)
    return ends


@dataclass
class _Set:
    """Linear inequalities on z = (B by its upper triangle, M likewise, c by pair, and by line c and what rest adds)."""

    m: int
    lines: Sequence[Line]
    mass: Sequence[Interval]
    rows: list[Array] = field(default_factory=list)
    limits: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.places = [(i, j) for i in range(self.m) for j in range(i, self.m)]
        self.of_pairs = [(number, pair) for number, line in enumerate(self.lines) for pair in line.pairs]
        self.free = 2 * len(self.places)
        self.size = self.free + len(self.of_pairs) + 2 * len(self.lines)

    def column(self, matrix: Array) -> Array:
        """<B, matrix> as a row over the upper triangle."""
        return np.array([matrix[i, j] if i == j else matrix[i, j] + matrix[j, i] for i, j in self.places])

    def add(self, row: Array, limit: float) -> None:
        """row^T z <= limit."""
        self.rows.append(row)
        self.limits.append(limit)

    def empty(self) -> Array:
        """A row of zeros."""
        return np.zeros(self.size)


def _greatest(line: Line) -> tuple[float, float]:
    """Above what u^T B u can be (N*s/m), and what dry friction can (N), by all that was burned."""
    damping = min((pair.D + pair.error) / max(float(np.trace(pair.V)) - pair.R * pair.speed_error, 1e-30)
                  for pair in line.pairs)  # fmt: skip
    return max(damping, 0.0), max(max((pair.D + pair.error) / pair.R for pair in line.pairs), 0.0)


def _constraints(lines: Sequence[Line], mass: Sequence[Interval]) -> _Set:
    m = len(lines[0].u)
    found = _Set(m, lines, mass)
    most = [_greatest(line) for line in lines]
    # the greatest eigenvalue is at most the trace, which the axes' lines bound
    trace = sum(damping for damping, _ in most[:m])
    drag = sum(friction for _, friction in most[:m])
    triangle, first = len(found.places), found.free
    heaviest = sum(interval.high for interval in mass[:m])
    for number, (line, pair) in enumerate((lines[i], pair) for i, pair in found.of_pairs):
        at = mass[next(i for i, other in enumerate(lines) if other is line)]
        straight = np.mean([other.aside for other in line.pairs], axis=0)
        error = pair.error + trace * pair.R * pair.speed_error * (1.0 if m == 1 else 2.0)
        # inertia: where both ways differ, M(x) may; and the velocity's error
        error += (at.high - at.low) * pair.apart + heaviest * 2.0 * pair.speed_error**2
        error += heaviest * pair.speed_error * (pair.fast - pair.slow)
        error += drag * pair.R * float(np.linalg.norm(pair.aside - straight))
        row = found.empty()
        row[:triangle], row[triangle:first] = found.column(pair.V), found.column(pair.Q)
        row[first + number] = pair.R
        found.add(row, pair.D + error)
        found.add(-row, -pair.D + error)
    for line, interval in zip(lines, mass, strict=True):
        u = line.u / np.sqrt(line.u @ line.u)
        row = found.empty()
        row[triangle:first] = found.column(np.outer(u, u))
        found.add(row, interval.high)
        found.add(-row, -interval.low)
        row = found.empty()
        row[:triangle] = -found.column(np.outer(u, u))  # B is at least 0
        found.add(row, 0.0)
    for one, (i, slower) in enumerate(found.of_pairs):  # friction does not grow with the speed
        for other, (j, faster) in enumerate(found.of_pairs):
            if i == j and faster.slow >= slower.fast:
                row = found.empty()
                row[first + other], row[first + one] = 1.0, -1.0
                found.add(row, 0.0)
    return found


def _with_stribeck(base: _Set, least: float, most: float) -> tuple[Array, Array]:
    """The set where each line has c + more e^-(v/v_s)^2 with a v_s of this range, m/s; 0 is no such part."""
    rows, limits = list(base.rows), list(base.limits)
    for number, (i, pair) in enumerate(base.of_pairs):
        level, more = base.free + len(base.of_pairs) + 2 * i, base.free + len(base.of_pairs) + 2 * i + 1
        row = base.empty()
        row[base.free + number], row[level] = 1.0, -1.0
        row[more] = -np.exp(-((pair.slow / most) ** 2)) if most > 0.0 else 0.0
        other = -row
        other[more] = np.exp(-((pair.fast / least) ** 2)) if least > 0.0 else 0.0
        rows += [row, other]
        limits += [0.0, 0.0]
    return np.array(rows), np.array(limits)


def damping_set(lines: Sequence[Line]) -> Identified:
    """All that the class and what was measured allow.

    Args:
        lines: those of :func:`lines`, in their order, near one pose.

    Raises:
        NotOfThisClass: the set is empty.
        TooLittle: a mass is not bounded.
    """
    mass = [mass_interval(line) for line in lines]
    base = _constraints(lines, mass)
    A, b = np.array(base.rows), np.array(base.limits)
    units = [line.u / np.sqrt(line.u @ line.u) for line in lines]

    def objective(u: Array) -> Array:
        row = base.empty()
        row[: len(base.places)] = base.column(np.outer(u, u))
        return row

    lows = [_range(objective(u), A, b, base.free) for u in units]
    if not all(lows):
        raise NotOfThisClass(
            "found no damping, mass and friction that agree with what was measured; expected a device that burns "
            "b v^2 and dry friction which does not grow with the speed: something else acts on it (a hand, a cable, a "
            "filter or a force of its own), or its driver's sample_age, actuation_delay or step is too small"
        )
    sets = [_with_stribeck(base, *ends) for ends in _stribeck_speeds(lines)]
    coulomb = bool(_range(objective(units[0]), *sets[0], base.free))
    by_line, friction = [], []
    for number, (line, u, low) in enumerate(zip(lines, units, lows, strict=True)):
        ends = [end for one in sets for end in _range(objective(u), *one, base.free)]
        high = max(ends, default=low[1])
        by_line.append(Interval(max(0.0, low[0]), max(high, low[0])))
        row = base.empty()
        row[base.free + len(base.of_pairs) + 2 * number] = 1.0
        levels = [end for one in sets for end in _range(row, *one, base.free)]
        friction.append(_least_friction(line, levels))
    return Identified(
        _least_eigenvalue(by_line, len(lines[0].u)),
        tuple(by_line),
        tuple(friction),
        _by_axis(friction, [line.u for line in lines]),
        tuple(mass),
        not coulomb,
    )


def _stribeck_speeds(lines: Sequence[Line]) -> list[tuple[float, float]]:
    """Ranges of Stribeck's speed: none that is seen, and on to half of the greatest speed, m/s."""
    slowest = min(pair.slow for line in lines for pair in line.pairs)
    fastest = min(max(pair.slow for pair in line.pairs) for line in lines)
    edges = [slowest / 4.0]
    while edges[-1] < fastest / 2.0:
        edges.append(edges[-1] * RATIO)
    return [(0.0, 0.0), *zip([0.0, *edges], edges, strict=False)]


def _least_friction(line: Line, levels: Sequence[float]) -> Interval:
    """The level of the window's mean, less what the place takes from it at least."""
    if not levels:
        return Interval(0.0, _greatest(line)[1])
    dip = 0.0
    if line.places:
        mean = float(np.mean([level for level, _ in line.places]))
        dip = max(0.0, *(SURE * (mean - level) + error for level, error in line.places))
    aside = float(np.linalg.norm(np.mean([pair.aside for pair in line.pairs], axis=0)))
    low, high = min(levels), max(levels)
    return Interval(max(0.0, low - dip - aside * high), high * (1.0 + aside))


def _least_eigenvalue(by_line: Sequence[Interval], m: int) -> Interval:
    """The least eigenvalue of all B with these u^T B u on :func:`lines`: by Weyl, over the entries' intervals."""
    if m == 1:
        return by_line[0]
    middle = [0.5 * (one.low + one.high) for one in by_line]
    off = [0.5 * (one.high - one.low) for one in by_line]
    B, E = np.diag(middle[:m]), np.diag(off[:m])
    diagonals = [u for u in lines(m)[m:]]
    for i in range(m):
        for j in range(i + 1, m):
            # q(u) = m (u/|u|)^T B (u/|u|): the products u_i u_j pick B_ij out of their sum
            B[i, j] = B[j, i] = sum(u[i] * u[j] * m * q for u, q in zip(diagonals, middle[m:], strict=True)) / 2.0**m
            E[i, j] = E[j, i] = sum(m * q for q in off[m:]) / 2.0**m
    least, spread = float(np.linalg.eigvalsh(B)[0]), float(np.linalg.eigvalsh(E)[-1])
    return Interval(max(0.0, least - spread), min(least + spread, *(one.high for one in by_line)))


def _by_axis(friction: Sequence[Interval], directions: Sequence[Array]) -> tuple[float, ...]:
    """c with sum c_i |v_i| <= N(v) in all directions, where N is a norm: by its convexity between the lines."""
    m = len(directions[0])
    if m == 1:
        return (friction[0].low,)
    whole = min(np.sqrt(m) * one.low for one in friction[m:])
    others = sum(one.high for one in friction[:m])
    found = []
    for axis in range(m):
        found.append(max(0.0, min(friction[axis].low, whole - (others - friction[axis].high))))
    return tuple(found)
