"""The damping of a device by motion from turn to turn: equations that no kinetic energy enters (set membership).

The tip goes to and fro along a line, from a turn to a later one on the same side. There it is at rest at the same
place. So neither its inertia nor a conservative force has a part in the work of the motors, whatever the linkage:

    D = sum of F^T dx = c R + <B, V> + sum k_p K_p,    V = integral v v^T dt,    K_p = integral |v|^(p+1) dt,

with R the way. A window (:mod:`manyhands.design.identification`) needs the mass: where it opens, the tip is fast. With
several axes the mass is a matrix that changes with the pose, and what is uncertain of it was as much as the least
damping. In exchange the turns count, and with them friction at rest. Stribeck's law is therefore summed over all speeds
that a motion has. docs/decisions/0053-identification.md has the bound of each error.

The lines may be any. Where the damping differs much from direction to direction, lines that are about equally damped
tell most of the weakest one (:func:`even_lines`).
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import combinations, pairwise, product
from typing import Final

import numpy as np
from numpy.typing import NDArray

from manyhands.design.identification import (
    BENT,
    HALF,
    PARTS,
    POWERED,
    POWERS,
    SURE,
    Between,
    Doubt,
    Identified,
    Inequalities,
    Line,
    MeasuredMotion,
    NotOfThisClass,
    Run,
    Speeds,
    TooLittle,
    least_friction,
    lines,
    mass_interval,
    none_agree,
    range_of,
    run_of,
    stribeck_ranges,
)

Array = NDArray[np.float64]

LOCAL: Final = 2.0
"""By how much dry friction near the turns may be more than on the whole way."""

RESTS: Final = 20.0
"""The slowest motion's greatest speed by the least of Stribeck's speeds that are told apart."""

GRID: Final = 12
"""Parts of each edge of the cube, whose faces are the directions in which the least eigenvalue is sought."""

SEEN: Final = 400
"""Places at which two speeds are compared."""

EVEN: Final = 4.0
"""How many times the least damping the greatest may be for the axes and the diagonals to be enough."""

WEAKEST: Final = 0.01
"""Of the greatest damping, what the estimate of the least is at least."""

MOST_PART: Final = 0.32
"""Of the fastest motion's accelerations, that the slowest may have at most to tell what pulls at the device."""

ON_THE_WAY: Final = 0.65
"""Of the damping of a linkage in the mean over its ways, what it is at least at each place of them."""

NEAR: Final = 0.8
"""Of the least damping along a line, from which on a bound by the entries of B is good enough."""

NEARLY: Final = 20.0
"""The condition of lines that are too near to a plane to be summed."""

_POWERS: Final = np.array(POWERS)


@dataclass(frozen=True)
class Rounds:
    """Whole times to and fro at one speed, which are one equation (see the module).

    Attributes:
        level: of the speed.
        D: work of the motors, J; ``D_error`` is the bound of its error, without that of the mass.
        V: integral v v^T dt, m^2/s; <B, V> is off by at most ``V_error`` (u^T B u + tr B/2), or without the trace on a
            single axis.
        K: by power p of drag, integral |v|^(p+1) dt; ``K_error`` is the bound of its error.
        R: the way, m.
        kinetic: by how much v^2/2 may differ from the first turn to the last, m^2/s^2.
        aside: how far it was from a straight line, m.
        ends: the mean places of both turns, m.
        speeds: bounds of the speeds that it had, m/s, with the part of the way at each.
        slowest: the least speed by place, :data:`SEEN` places between the ends, m/s; ``fastest`` the greatest.
        fast: above the greatest speed, m/s.
        force: the greatest force, N.
        turns_at: the least acceleration at a turn, m/s^2; ``turns_by`` is the greatest.
        open: by how much the last place may differ from the first, m.
    """

    level: int
    D: float
    D_error: float
    V: Array
    V_error: float
    K: Array
    K_error: Array
    R: float
    kinetic: float
    aside: float
    ends: tuple[float, float]
    speeds: tuple[Array, Array, Array]
    slowest: Array
    fastest: Array
    fast: float
    force: float
    turns_at: float
    turns_by: float
    open: float

    @property
    def places(self) -> Array:
        """Where ``slowest`` and ``fastest`` are, m."""
        return np.linspace(*self.ends, SEEN)


@dataclass(frozen=True)
class Along:
    """What was measured along one line of length 1, slowest first."""

    u: Array
    rounds: tuple[Rounds, ...]

    @property
    def burns(self) -> float:
        """Above the mean dry friction at each of these speeds, N: it falls with the speed."""
        return min((one.D + one.D_error) / one.R for one in self.rounds)

    @property
    def pull(self) -> float:
        """Above what a weight or springs pull with, N.

        At a turn inertia takes what the motors exert, less that pull and friction, which is not more than both. So with
        the part a of the fastest motion's accelerations, the pull P of the slowest is at most F + a (F' + 3 P).
        """
        slow, top = self.rounds[0], self.rounds[-1]
        part = min(slow.turns_by / top.turns_at, MOST_PART)
        return SURE * (slow.force + part * top.force) / (1.0 - 3.0 * part)

    @property
    def mass(self) -> float:
        """Above u^T M u, kg: what pushes at the turns of the fastest motion."""
        top = self.rounds[-1]
        return SURE * (top.force + 3.0 * self.pull) / top.turns_at


@dataclass(frozen=True)
class Damped:
    """What the set allows.

    Attributes:
        least: the least eigenvalue of B, N*s/m.
        by_line: u^T B u by line.
        levels: by line the level of dry friction beyond Stribeck's speed, N; None where only friction without such a
            form agrees.
        stribeck: whether only friction that falls with the speed, or drag, agrees with the data.
    """

    least: Between
    by_line: tuple[Between, ...]
    levels: tuple[Between | None, ...]
    stribeck: bool


def measured_along(motions: Sequence[MeasuredMotion], u: Array, doubt: Doubt) -> Along:
    """What motions along a line burned.

    Args:
        motions: along it, slowest first.
        u: its direction.
        doubt: what is not known of the measurement.

    Raises:
        TooLittle: at fewer than two speeds it went to and fro.
    """
    length = u / np.sqrt(u @ u)
    found = []
    for motion in motions:
        told = [one for part in PARTS if (one := _rounds(run_of(motion, u, doubt, part), doubt)) is not None]
        if told:
            found.append(min(told, key=lambda one: one.V_error))
    if len(found) < 2:
        raise TooLittle(
            f"found whole times to and fro at {len(found)} of {len(motions)} speeds; expected two or more: give more "
            "force, more travel, or a greater speed"
        )
    return Along(length, tuple(found))


def _turns(run: Run) -> list[int]:
    """The ticks at which it turned: the extremes after each turn of the wanted motion."""
    wanted, found = run.motion.turns, []
    after = int(np.median(np.diff(wanted))) // 3
    middle = float(np.median(run.s))
    for turn in wanted:
        part = run.s[max(0, turn - 2) : turn + after]
        found.append(max(0, turn - 2) + int(np.argmax(part) if run.s[turn] > middle else np.argmin(part)))
    return found


def _without_gaps(run: Run, turns: Sequence[int]) -> Sequence[int]:
    """The longest row of these turns, from one to a later one on its side, between which no tick came too late."""
    best: Sequence[int] = ()
    begin = 0
    for at in range(len(turns) - 1):
        way = slice(turns[at], turns[at + 1] + 1)
        if max(float(np.diff(run.t[way]).max()), float(run.between[way].max())) > HALF:
            begin = at + 1
        elif (at + 1 - begin) % 2 == 0 and at + 2 - begin > len(best):
            best = turns[begin : at + 2]
    return best


def _rounds(run: Run, doubt: Doubt) -> Rounds | None:
    """The most whole times to and fro after it has settled that have no gap; None where there are none."""
    motion = run.motion
    turns = _without_gaps(run, _turns(run)[motion.settled :])
    if len(turns) < 3:
        return None
    part = slice(turns[0], turns[-1] + 1)
    s, t, v, w, u, y, f = (*(of[part] for of in (run.s, run.t, run.v, run.w)), run.u, run.y[part], motion.f[part])
    gap, between = np.diff(t), run.between[part]
    hard = run.pull(part)
    off = doubt.delta + 0.5 * np.abs(v) * doubt.jitter  # of a displacement, beside a constant age
    off += np.maximum(between**2 - float(np.median(run.between)) ** 2, 0.0) / 8.0 * hard
    bend = BENT * run.bend[part]
    speed_error = 5.0 / 3.0 * off / run.half + bend

    def error(weights: Array) -> float:
        """Bound of the error of sum weights v, by parts."""
        return run.by_parts(weights, off) + float(np.abs(weights) @ bend)

    # the work: summed by parts, an error of a displacement counts as much as the force changes there
    D = float(np.sum(f[:-1] * np.diff(y, axis=0)))
    if motion.extra is not None:
        D += float(np.sum(motion.extra[part][:-1]))
    unknown = 0.5 * (doubt.latency[1] - doubt.latency[0])
    late = unknown + (0.0 if motion.took is None else motion.took[part][1:-1])
    apart = np.maximum(np.maximum(gap[1:], gap[:-1]), between[1:-1])
    worked = doubt.delta + np.abs(v[1:-1]) * late + apart**2 / 8.0 * hard
    D_error = float(np.linalg.norm(np.diff(f[:-1], axis=0), axis=1) @ worked)
    D_error += 2.0 * doubt.delta * float(np.linalg.norm(f[[0, -2]], axis=1).max())

    dt = np.gradient(t)
    along = np.abs(v)
    first, last = np.linalg.norm(w[0]), np.linalg.norm(w[-1])
    ends = speed_error[0] + speed_error[-1]
    kinetic = 0.5 * float((np.linalg.norm(w[0] - w[-1]) + ends) * (first + last + ends))
    K_error = np.array([error(dt * (p + 1.0) * along**p) for p in POWERS])
    K_error += (0.5 * (_POWERS + 1.0) * _POWERS) * (
        (dt * speed_error**2) @ ((along + speed_error)[:, None] ** (_POWERS - 1.0))
    )
    places = run.s[turns]
    low, high = (places[1::2], places[::2]) if places[0] > places[1] else (places[::2], places[1::2])
    beside = y - np.outer(s, u)
    middle = 0.5 * (beside.max(axis=0) + beside.min(axis=0))
    slowest, fastest = _by_place(run, turns, speed_error, (float(low.mean()), float(high.mean())))
    mean, doubtful = 0.5 * (along[1:] + along[:-1]), 0.5 * (speed_error[1:] + speed_error[:-1])
    way = np.abs(np.diff(s))
    return Rounds(
        motion.level, D, D_error,
        np.einsum("k,ki,kj->ij", dt, w, w), error(2.0 * dt * v) + float(dt @ speed_error**2),
        dt @ along[:, None] ** (_POWERS + 1.0), K_error,
        float(np.sum(np.abs(np.diff(places)))),
        kinetic,
        float(np.max(np.linalg.norm(beside - middle, axis=1))) + doubt.delta,
        (float(low.mean()), float(high.mean())),
        (np.maximum(mean - doubtful, 0.0), mean + doubtful, way / way.sum()),
        slowest, fastest,
        float(np.max(along + speed_error)),
        float(np.max(np.linalg.norm(f, axis=1))),
        *_turning(run, turns),
        float(np.linalg.norm(y[-1] - y[0])) + 2.0 * doubt.delta,
    )  # fmt: skip


def _by_place(run: Run, turns: Sequence[int], speed_error: Array, ends: tuple[float, float]) -> tuple[Array, Array]:
    """The least and the greatest speed by place, over all ways."""
    places = np.linspace(*ends, SEEN)
    slowest, fastest = np.full(SEEN, np.inf), np.zeros(SEEN)
    for begin, end in pairwise(turns):
        s, v = run.s[begin : end + 1], np.abs(run.v[begin : end + 1])
        e = speed_error[begin - turns[0] : end + 1 - turns[0]]
        order = np.argsort(s)
        inside = (places >= s[order[0]]) & (places <= s[order[-1]])
        least = np.interp(places, s[order], np.maximum(v - e, 0.0)[order])
        slowest = np.where(inside, np.minimum(slowest, least), 0.0)
        fastest = np.maximum(fastest, np.interp(places, s[order], (v + e)[order]))
    return slowest, fastest


def _turning(run: Run, turns: Sequence[int]) -> tuple[float, float]:
    """The least and the greatest mean acceleration around a turn, m/s^2, over a tenth of a way each side."""
    n = max(1, int(np.min(np.diff(turns))) // 10)
    around = [turn for turn in turns if n <= turn < len(run.t) - n]
    found = [abs(run.v[turn + n] - run.v[turn - n]) / (run.t[turn + n] - run.t[turn - n]) for turn in around]
    return max(min(found, default=0.0), 1e-6), max(found, default=np.inf)


# --- which lines


def estimated(of: Sequence[Along]) -> Array:
    """About B, by the two fastest motions of each line: to choose lines by, and no bound."""
    rows, sides = [], []
    m = len(of[0].u)
    places = [(i, j) for i in range(m) for j in range(i, m)]
    for one in of:
        slow, fast = one.rounds[-2:]
        slope = (fast.D / fast.R - slow.D / slow.R) / (np.trace(fast.V) / fast.R - np.trace(slow.V) / slow.R)
        rows.append([one.u[i] * one.u[j] * (1.0 if i == j else 2.0) for i, j in places])
        sides.append(max(slope, 0.0))
    entries = np.linalg.lstsq(np.array(rows), np.array(sides), rcond=None)[0]
    B = np.zeros((m, m))
    for (i, j), entry in zip(places, entries, strict=True):
        B[i, j] = B[j, i] = entry
    values, vectors = np.linalg.eigh(B)
    values = np.maximum(values, WEAKEST * max(float(values[-1]), 1e-9))
    return np.asarray((vectors * values) @ vectors.T)


def even_lines(B: Array) -> list[Array]:
    """Lines that a device with the damping B damps about equally, and their sums; none where the axes do."""
    values, vectors = np.linalg.eigh(B)
    if values[-1] <= EVEN * values[0]:
        return []
    stretched = vectors / np.sqrt(values)
    found = [stretched @ u for u in lines(len(B))]
    return [u / np.sqrt(u @ u) for u in found]


# --- the set


@dataclass
class _Damping(Inequalities):
    """Inequalities whose z begins with B, by its upper triangle.

    Attributes:
        about: :func:`estimated`.
    """

    about: Array = field(kw_only=True)

    @property
    def m(self) -> int:
        """The number of axes."""
        return len(self.about)

    @property
    def places(self) -> list[tuple[int, int]]:
        """Row and column of each of the first entries."""
        return [(i, j) for i in range(self.m) for j in range(i, self.m)]

    def column(self, matrix: Array) -> Array:
        """<B, matrix> as a row over the upper triangle."""
        return np.array([matrix[i, j] if i == j else matrix[i, j] + matrix[j, i] for i, j in self.places])

    def objective(self, matrix: Array) -> Array:
        """<B, matrix> as a row."""
        row = self.empty()
        row[: self.free] = self.column(matrix)
        return row


def _base(of: Sequence[Along]) -> _Damping:
    m, every = len(of[0].u), [(at, one) for at, line in enumerate(of) for one in line.rounds]
    free = m * (m + 1) // 2
    found = _Damping(free, [Speeds(at, *one.speeds) for at, one in every], len(of), about=estimated(of))
    told = len(lines(m))
    # the axes come first, and the first of other lines are at right angles as well
    mass = min(sum(line.mass for line in of[first : first + m]) for first in (0, told) if first < len(of))
    across = [_across(of, line.u) for line in of]
    middles = [np.median([one.ends for one in line.rounds], axis=0) for line in of]
    for number, (at, one) in enumerate(every):
        line, (low, high) = of[at], middles[at]
        error = one.D_error + mass * one.kinetic + one.open * line.pull
        # on a curved path friction differs by at most its own change along the path, there and back
        curved = 2.0 * across[at] * one.aside / (high - low)
        moved = LOCAL * line.burns * (abs(one.ends[0] - low) + abs(one.ends[1] - high)) / (high - low)
        error += one.R * (curved + moved)
        off = found.column(unsure(line.u, found.about))
        for sign in (1.0, -1.0):
            row = found.empty()
            row[:free] = sign * found.column(one.V) - one.V_error * off
            row[free + number] = sign * one.R
            row[found.drag(at)] = sign * one.K - one.K_error - POWERED * one.K
            found.add(row / one.R, (sign * one.D + error) / one.R)
    for at, line in enumerate(of):
        found.add(-found.objective(np.outer(line.u, line.u)), 0.0)  # B is at least 0
        row = found.empty()
        row[found.level(at) + 1] = 1.0  # it began to move under the forces that it was given
        found.add(row, 2.0 * line.pull)
        found.without_drag(at)
    for number, (i, slower) in enumerate(every):  # friction does not grow with the speed
        for other, (j, faster) in enumerate(every):
            if i != j or faster.level <= slower.level:
                continue
            places = slower.places
            sure = np.interp(places, faster.places, faster.slowest, 0.0, 0.0) >= slower.fastest
            found.no_greater(other, number, LOCAL * of[i].burns * (1.0 - float(np.mean(sure))))
    return found


def _across(of: Sequence[Along], u: Array) -> float:
    """Above N(x, w), dry friction in any direction w at a right angle to u, N: by the lines that w is a sum of."""
    m = len(u)
    if m == 1:
        return 0.0
    beside, most = np.eye(m) - np.outer(u, u), np.inf
    for basis in combinations(of, m):
        directions = np.column_stack([line.u for line in basis])
        if np.linalg.cond(directions) < NEARLY:
            parts = np.linalg.norm(np.linalg.inv(directions) @ beside, axis=1)
            most = min(most, float(parts @ [line.burns for line in basis]))
    return most


def unsure(u: Array, about: Array) -> Array:
    """The matrix A with an error e of a velocity v along u counting with 2 v^T B e of at most 2 |v| |e| <A, B>.

    The part of e along u counts with u^T B u. One aside, e', with u^T B e', at most (s u^T B u + e'^T B e'/s)/2 for any
    s, and e'^T B e' is at most tr B - u^T B u; s is the best for a B like ``about``.
    """
    m = len(u)
    if m == 1:
        return np.ones((1, 1))
    s = max(1.0, float(np.sqrt(np.trace(about) / (u @ about @ u))))
    aside = np.sqrt(m - 1.0) / 2.0  # each axis aside may be off
    return np.asarray((1.0 + aside * (s - 1.0 / s)) * np.outer(u, u) + aside / s * np.eye(m))


def damped(of: Sequence[Along]) -> Damped:
    """All that the class and what was measured allow.

    Args:
        of: what was measured near one pose; the axes come first.

    Raises:
        NotOfThisClass: the set is empty.
    """
    base = _base(of)
    least, fastest = (min(line.rounds[at].fast for line in of) for at in (0, -1))
    sets = [base.with_stribeck(*ends) for ends in stribeck_ranges(least / RESTS, fastest)]
    every = [base.falling(), *sets]
    ends = [[range_of(base.objective(np.outer(line.u, line.u)), *one, base.free) for line in of] for one in every]
    kept = [pair for pair in zip(every, ends, strict=True) if all(pair[1])]
    if not kept:
        raise none_agree("damping and friction")
    formed = [(one, by_line) for one, by_line in zip(sets, ends[1:], strict=True) if all(by_line)]
    lows = [max(0.0, min(by_line[at][0] for _, by_line in kept)) for at in range(len(of))]
    highs = [max(by_line[at][1] for _, by_line in formed or kept) for at in range(len(of))]
    by_line = tuple(Between(low, max(low, high)) for low, high in zip(lows, highs, strict=True))
    levels: list[Between | None] = []
    for at in range(len(of)):
        row = base.empty()
        row[base.level(at)] = 1.0
        found = [end for one, _ in formed for end in range_of(row, *one, base.free)]
        levels.append(Between(max(0.0, min(found)), max(found)) if found else None)
    most = min(highs)
    least = lows[0] if base.m == 1 else _least_eigenvalue(base, [(one, min(by_line)[0]) for one, by_line in kept])
    return Damped(
        Between(min(max(0.0, least), most), most),
        by_line,
        tuple(levels),
        not range_of(base.objective(np.eye(base.m)), *base.coulomb(), base.free),
    )


def identified_by_turns(windows: Sequence[Line], of: Sequence[Along]) -> Identified:
    """What is allowed of a device of several axes: its damping by whole times to and fro, and friction's places and the
    masses by windows. The axes and the diagonals of :func:`lines` come first.

    Raises:
        NotOfThisClass: the set is empty.
    """
    found = damped(of)
    friction, mass = [], []
    for window, along, level in zip(windows, of, found.levels, strict=True):
        friction.append(least_friction(window, [] if level is None else [level.low, level.high], along.burns))
        between = Between(0.0, along.mass)
        if window.pairs:
            with suppress(TooLittle, NotOfThisClass):
                between, _ = mass_interval(window)
        mass.append(between)
    told = len(lines(len(of[0].u)))
    by_axis = _friction_by_axis(friction[:told], [along.u for along in of[:told]])
    least = Between(ON_THE_WAY * found.least.low, found.least.high)
    return Identified(least, found.by_line, tuple(friction), by_axis, tuple(mass), found.stribeck)


def _friction_by_axis(friction: Sequence[Between], directions: Sequence[Array]) -> tuple[float, ...]:
    """The c with sum c_i |v_i| <= N(v) in all directions, where N is a norm: by its convexity between the lines."""
    m = len(directions[0])
    whole = min(np.sqrt(m) * one.low for one in friction[m:])
    others = sum(one.high for one in friction[:m])
    found = []
    for axis in range(m):
        found.append(max(0.0, min(friction[axis].low, whole - (others - friction[axis].high))))
    return tuple(found)


def _least_eigenvalue(base: _Damping, sets: Sequence[tuple[tuple[Array, Array], float]]) -> float:
    """Below all eigenvalues of all B of these sets, N*s/m; with each comes the least that a line has in it.

    With S^2 about B, the entries of S^-1 B S^-1 are bounded; what that gives is enough for most sets. In the others the
    least of w^T B w is sought over directions.
    """
    S = _root(base.about)
    bounds = [_by_entries(base, S, one) for one, _ in sets]
    least = np.inf
    for at in np.argsort(bounds):
        one, of_lines = sets[at]
        if bounds[at] >= least:
            break
        if least <= 0.0:
            return 0.0
        near = base.m > 2 and bounds[at] >= NEAR * of_lines  # in a plane directions are few
        least = min(least, bounds[at] if near else max(bounds[at], _by_directions(base, S, one)))
    return float(least)


def _root(B: Array) -> Array:
    values, vectors = np.linalg.eigh(B)
    return np.asarray((vectors * np.sqrt(values)) @ vectors.T)


def _by_entries(base: _Damping, S: Array, one: tuple[Array, Array]) -> float:
    """With B = S C S, and C between bounds of each entry: C is at least its middle less the norm of what it is off."""
    back, m = np.linalg.inv(S), base.m
    middle, off = np.zeros((m, m)), np.zeros((m, m))
    for i, j in base.places:
        entry = 0.5 * (np.outer(back[i], back[j]) + np.outer(back[j], back[i]))
        low, high = range_of(base.objective(entry), *one, base.free)
        if not np.isfinite([low, high]).all():
            return -np.inf
        middle[i, j] = middle[j, i] = 0.5 * (low + high)
        off[i, j] = off[j, i] = 0.5 * (high - low)
    return float(np.linalg.eigvalsh(S @ (middle - np.linalg.norm(off, 2) * np.eye(m)) @ S)[0])


def _by_directions(base: _Damping, S: Array, one: tuple[Array, Array]) -> float:
    """By C = S^-1 B S^-1 in directions z all over the sphere; ends early below 0.

    Every direction is within a of one of these z. With mu below (z^T C z - sin^2 a tr C)/|S^-1 z|^2 for all of them,
    C - mu S^-2 has no negative eigenvalue, and B none below mu.
    """
    m, back = base.m, np.linalg.inv(S)
    trace = range_of(base.objective(back @ back), *one, base.free, (-1.0,))[0]
    if not np.isfinite(trace):
        return -np.inf
    # from the faces of a cube to the sphere nothing grows: half of a cell's diagonal is the greatest angle
    square = float(np.sin(np.sqrt(m - 1) / GRID) ** 2)
    least, edge = np.inf, np.linspace(-1.0, 1.0, GRID + 1)
    for axis in range(m):
        for others in product(edge, repeat=m - 1):
            z = np.insert(np.array(others), axis, 1.0)
            z /= np.sqrt(z @ z)
            w = back @ z
            low = range_of(base.objective(np.outer(w, w)), *one, base.free, (1.0,))[0]
            least = min(least, (low - square * trace) / float(w @ w))
            if least <= 0.0:
                return float(least)
    return float(least)
