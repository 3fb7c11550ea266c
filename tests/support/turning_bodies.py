"""Steps of rigid bodies that turn and touch, in batches, and what each gives out.

This is the scheme of docs/decisions/0055-bodies-that-turn.md, and its neighbours. A *thing* has a centre c and an
orientation R, a matrix. The first thing is a tool: its centre is a port, and its orientation is led by a hand. The last
is the world, which never moves. A step moves the centre by s and turns it by the Cayley map of W,

    R' = (I - [W]/2)^{-1} (I + [W]/2) R,      so that      R'a - Ra = W x (Ra + R'a)/2    for every a.

Any s and W are a step: what the equations of motion lack for it counts as a force and a torque from outside, whose work
is counted. So an inequality is tried at any step, without a solver.

Arrays have the axes (batch, thing or law, ...). Units are m, s, kg, N; turns are in rad.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

THINGS = 3
"""Things that move; the world is one more."""
TOOL, WORLD = 0, THINGS
T = 1e-3


class Arms(StrEnum):
    """Where the arms of forces and of masses are taken in a step."""

    START = "start"
    MEAN = "mean"
    END = "end"


class Normals(StrEnum):
    """By which gradient a force acts along a gap whose normal turns."""

    MEAN = "mean"
    """The discrete gradient: of every product, the one factor's change times the mean of the others."""
    START = "start"


class Kind(StrEnum):
    """What a gap is between the points p of one thing and q of another."""

    PLANE = "plane"
    """n^T (p - q) with n at rest: a wall."""
    ROUND = "round"
    """|p - q| less both radii. The force belongs to the tangent plane of the step's start, as in decision 41."""
    FACE = "face"
    """n^T (p - q) with n fixed to the second thing: a corner above a face."""
    EDGE = "edge"
    """(d x e)^T (p - q) with d fixed to the first thing and e to the second: two edges."""


@dataclass(frozen=True)
class Scheme:
    """How a step is made.

    Attributes:
        arms: where the arms of forces and masses are taken.
        normals: the gradient of a gap whose normal turns.
        middle: whether speeds and contact forces are those of the middle of the step, in place of its end.
        carried: whether the velocities of the step before are turned with their thing before they are compared.
    """

    arms: Arms = Arms.MEAN
    normals: Normals = Normals.MEAN
    middle: bool = False
    carried: bool = False


@dataclass(frozen=True)
class Law:
    """One contact of each step of a batch, between fixed things."""

    kind: Kind
    first: int
    second: int
    p: Array  # (batch, 3), in the first thing's axes
    q: Array  # (batch, 3), in the second thing's
    d: Array  # (batch, 3), a unit vector in the first thing's axes; only of EDGE
    n: Array  # (batch, 3), a unit vector in the second thing's axes
    radii: Array  # (batch,), both together
    stiffness: Array
    damping: Array
    friction: Array  # mu
    most: Array  # of friction, N: mu N of the tick before
    bristle: Array  # (batch, 3), e of the tick before


@dataclass(frozen=True)
class World:
    """A batch of things, each with its own past, before a step.

    Attributes:
        c, R: centres and orientations.
        way, chord: of the tick before, c(k) - c(k-1) and R(k) - R(k-1).
        turn: the rotation of the tick before, R(k) R(k-1)^T.
        mass: of the centre, 0 for the tool.
        second: the sum of m a a^T of a thing's masses, positive semidefinite; its inertia is trace I - second.
        hand: the orientation of the hand that leads the tool, of this tick.
        lead: the stiffness of its chordal spring, N*m/rad.
        gravity: m/s^2.
    """

    c: Array
    R: Array
    way: Array
    chord: Array
    turn: Array
    mass: Array
    second: Array
    hand: Array
    lead: Array
    gravity: Array
    laws: tuple[Law, ...]


@dataclass(frozen=True)
class Taken:
    """What a batch of steps took in and stored, J.

    Attributes:
        given_out: the rise of what is stored, less what came in: through the port, from the hand's account and from
            outside. At most 0 where a step is passive.
        lead: what the hand's account was credited, less what the spring did on the tool; at least 0.
        scale: the sum of the sizes of all energies and works, for rounding.
        forces, torques: from outside, which the step needs, by thing; for the tool, minus what the world exerts on it.
    """

    given_out: Array
    lead: Array
    scale: Array
    forces: Array
    torques: Array
    laws: tuple[Law, ...]  # of the next tick


def cross_matrix(W: Array) -> Array:
    """[W], with [W] a = W x a."""
    found = np.zeros((*W.shape, 3))
    found[..., 0, 1], found[..., 0, 2], found[..., 1, 2] = -W[..., 2], W[..., 1], -W[..., 0]
    return found - np.swapaxes(found, -1, -2)


def cayley(W: Array) -> Array:
    """The rotation by 2 atan(|W|/2) about W."""
    half = cross_matrix(W) / 2.0
    scale = 1.0 / (1.0 + (W * W).sum(axis=-1) / 4.0)
    found: Array = np.eye(3) + scale[..., None, None] * 2.0 * (half + half @ half)
    return found


def axial(P: Array) -> Array:
    """The sum of x cross y where P is that of x y^T."""
    return np.stack([P[..., 1, 2] - P[..., 2, 1], P[..., 2, 0] - P[..., 0, 2], P[..., 0, 1] - P[..., 1, 0]], axis=-1)


def dot(a: Array, b: Array) -> Array:
    """a^T b along the last axis."""
    found: Array = (a * b).sum(axis=-1)
    return found


def _put(R: Array, a: Array) -> Array:
    found: Array = np.einsum("bij,bj->bi", R, a)
    return found


def _norm2(M: Array) -> Array:
    found: Array = (M * M).sum(axis=(-1, -2))
    return found


def chordal(lead: Array, hand: Array, at: Array) -> tuple[Array, Array]:
    """The energy of the chordal spring, J, and its torque on the hand, N*m."""
    D = hand @ np.swapaxes(at, -1, -2)
    energy = lead * (3.0 - np.trace(D, axis1=-2, axis2=-1)) / 2.0
    return energy, lead[:, None] / 2.0 * axial(D)


def step(world: World, s: Array, W: Array, scheme: Scheme) -> Taken:
    """What the step s, W takes in.

    Args:
        world: before the step.
        s: the centres' motion, (batch, THINGS, 3).
        W: the turns, likewise.
        scheme: how the step is made.
    """
    batch = len(s)
    still = np.zeros((batch, 1, 3))
    s, W = np.concatenate([s, still], axis=1), np.concatenate([W, still], axis=1)
    R, c = world.R, world.c
    R_next, c_next = cayley(W) @ R, c + s
    arms = {Arms.START: R, Arms.MEAN: (R + R_next) / 2.0, Arms.END: R_next}[scheme.arms]
    chord = R_next - R
    forces, torques = np.zeros((batch, THINGS + 1, 3)), np.zeros((batch, THINGS + 1, 3))  # by contacts and springs
    stored = [np.zeros(batch), np.zeros(batch)]
    scale, laws = np.zeros(batch), []

    for law in world.laws:
        i, j = law.first, law.second
        a, b = _put(arms[:, i], law.p), _put(arms[:, j], law.q)
        before = c[:, i] + _put(R[:, i], law.p) - c[:, j] - _put(R[:, j], law.q)
        after = c_next[:, i] + _put(R_next[:, i], law.p) - c_next[:, j] - _put(R_next[:, j], law.q)
        n = [_put(R[:, j], law.n), _put(R_next[:, j], law.n)]
        d = [_put(R[:, i], law.d), _put(R_next[:, i], law.d)]
        on_n, on_d = np.zeros((batch, 3)), np.zeros((batch, 3))  # the gap's derivatives by n and d
        if law.kind is Kind.PLANE:
            along = n[0]
            gap, end = dot(along, before) - law.radii, dot(along, after) - law.radii
            true = end
        elif law.kind is Kind.ROUND:
            along = before / np.sqrt(dot(before, before))[:, None]
            gap = np.sqrt(dot(before, before)) - law.radii
            end, true = gap + dot(along, after - before), np.sqrt(dot(after, after)) - law.radii
        elif law.kind is Kind.FACE:
            gap, end = dot(n[0], before) - law.radii, dot(n[1], after) - law.radii
            true = end
            along, on_n = (n[0] + n[1]) / 2.0, (before + after) / 2.0
            if scheme.normals is Normals.START:
                along, on_n = n[0], before
        else:
            crossed = [np.cross(d[0], n[0]), np.cross(d[1], n[1])]
            gap, end = dot(crossed[0], before) - law.radii, dot(crossed[1], after) - law.radii
            true = end
            along, middle = (crossed[0] + crossed[1]) / 2.0, (before + after) / 2.0
            on_d, on_n = np.cross((n[0] + n[1]) / 2.0, middle), np.cross(middle, (d[0] + d[1]) / 2.0)
            if scheme.normals is Normals.START:
                along, on_d, on_n = crossed[0], np.cross(n[0], before), np.cross(before, d[0])
        deep, felt = np.maximum(0.0, -gap), -end
        if scheme.middle:
            felt = (felt - gap) / 2.0
        N = np.maximum(0.0, law.stiffness * felt + law.damping * (-end - deep) / T)
        # friction, across the normal of the step's start
        across = law.n * 0.0 + (along if law.kind in (Kind.PLANE, Kind.ROUND) else n[0])
        size = np.sqrt(dot(across, across))[:, None]
        across = across / size
        old = law.bristle - dot(law.bristle, across)[:, None] * across
        # on the points of both things that are at one place between the two at the start
        place = c[:, i] + _put(R[:, i], law.p) - law.radii[:, None] / 2.0 * across
        mine = np.einsum("bji,bj->bi", R[:, i], place - c[:, i])
        others = np.einsum("bji,bj->bi", R[:, j], place - c[:, j])
        slid = s[:, i] + _put(chord[:, i], mine) - s[:, j] - _put(chord[:, j], others)
        bent = old + slid - dot(slid, across)[:, None] * across
        most = law.most / law.stiffness
        bent = bent * (most / np.maximum(most, np.sqrt(dot(bent, bent)) + 1e-300))[:, None]
        force, rub = N[:, None] * along, -law.stiffness[:, None] * bent
        forces[:, i] += force + rub
        forces[:, j] -= force + rub
        mean_n, mean_d = _put(arms[:, j], law.n), _put(arms[:, i], law.d)
        torques[:, i] += (
            np.cross(a, force) + np.cross(_put(arms[:, i], mine), rub) + N[:, None] * np.cross(mean_d, on_d)
        )
        torques[:, j] += (
            np.cross(b, -force) + np.cross(_put(arms[:, j], others), -rub) + N[:, None] * np.cross(mean_n, on_n)
        )
        half = law.stiffness / 2.0
        stored[0] += half * (deep**2 + dot(law.bristle, law.bristle))
        stored[1] += half * (np.maximum(0.0, -true) ** 2 + dot(bent, bent))
        laws.append(replace(law, bristle=bent, most=law.friction * N))
        scale += np.abs(dot(rub, slid)) + N * (np.abs(gap) + np.abs(end))

    move, turned = slice(0, THINGS), np.swapaxes
    mass, second = world.mass[:, :, None], world.second
    forces[:, move] += mass * world.gravity[:, None, :]
    for when, centre in enumerate((c, c_next)):
        height = (world.mass * dot(centre[:, move], world.gravity[:, None, :])).sum(axis=1)
        stored[when] -= height
        scale += np.abs(height)

    # the spring of the hand, a linear one between the matrices: force -lead/2 (R' - hand)
    pull = -world.lead[:, None, None] / 2.0 * (R_next[:, TOOL] - world.hand)
    led = axial(arms[:, TOOL] @ turned(pull, -1, -2))
    torques[:, TOOL] += led
    energy, t = chordal(world.lead, world.hand, R[:, TOOL])
    energy_next, t_next = chordal(world.lead, world.hand, R_next[:, TOOL])
    credited = energy - energy_next - dot(t_next - t, t_next - t) / (2.0 * world.lead)
    worked = dot(led, W[:, TOOL])

    # inertia
    way, past = world.way, world.chord
    if scheme.carried:
        past = world.turn @ past
    speed, velocity = s[:, move] / T, chord[:, move] / T
    gained, swung = (s[:, move] - way) / T, (chord[:, move] - past) / T
    if scheme.middle:  # v' = 2 s/T - v
        speed, velocity = 2.0 * s[:, move] / T - way / T, 2.0 * chord[:, move] / T - past / T
        gained, swung = speed - way / T, velocity - past / T
    needed = mass * gained / T - forces[:, move]
    spun = axial(arms[:, move] @ second @ turned(swung, -1, -2)) / T
    if scheme.carried:  # what turning the velocities left out, in a form that does no work
        momentum = axial(arms[:, move] @ second @ turned(past, -1, -2)) / T
        spun = spun + np.cross(W[:, move], momentum) / T
    twisted = spun - torques[:, move]
    for when, (v, V) in enumerate(((way / T, past / T), (speed, velocity))):
        kinetic = (world.mass * dot(v, v) / 2.0 + ((V @ second) * V).sum(axis=(-1, -2)) / 2.0).sum(axis=1)
        stored[when] += kinetic
        scale += kinetic
    # what came from outside; of the tool's centre, what its hand did through the port
    came = (dot(needed, s[:, move]) + dot(twisted, W[:, move])).sum(axis=1)
    scale += (np.abs(dot(needed, s[:, move])) + np.abs(dot(twisted, W[:, move]))).sum(axis=1)
    scale += stored[0] + stored[1] + np.abs(credited) + world.lead
    return Taken(stored[1] - stored[0] - came - credited, credited - worked, scale, needed, twisted, tuple(laws))


def hostile(rng: np.random.Generator, batch: int, greatest: float = 3.0) -> tuple[World, Array, Array]:
    """Things with a violent past, deep in stiff contacts, and a violent step of each.

    Args:
        rng: draws all.
        batch: how many.
        greatest: rad, of the turns of a tick; the past's and the step's are log-uniform up to it.
    """

    def log(low: float, high: float, *shape: int) -> Array:
        return np.asarray(10.0 ** rng.uniform(low, high, (batch, *shape)))

    def vectors(*shape: int) -> Array:
        found = rng.normal(size=(batch, *shape, 3))
        return np.asarray(found / np.sqrt((found**2).sum(axis=-1, keepdims=True)))

    def turns() -> Array:
        angle = np.minimum(log(-4.0, np.log10(greatest), THINGS), 3.1)
        return np.asarray(2.0 * np.tan(angle / 2.0)[..., None] * vectors(THINGS))

    size = log(-2.0, -1.0)
    R = cayley(2.0 * np.tan(rng.uniform(0.0, 1.5, (batch, THINGS)))[..., None] * vectors(THINGS))
    R = np.concatenate([R, np.broadcast_to(np.eye(3), (batch, 1, 3, 3))], axis=1)
    c = np.concatenate([size[:, None, None] * rng.normal(size=(batch, THINGS, 3)), np.zeros((batch, 1, 3))], axis=1)
    turn = cayley(turns())
    chord = R[:, :THINGS] - np.swapaxes(turn, -1, -2) @ R[:, :THINGS]
    mass = log(-3.0, 0.0, THINGS)
    axes = cayley(vectors(THINGS) * 2.0)
    spread = log(-2.0, 0.0, THINGS, 3)
    second = np.einsum("btij,btj,btkj->btik", axes, spread, axes) * (mass * size[:, None] ** 2)[..., None, None]
    mass[:, TOOL] = 0.0
    laws = []
    for kind, i, j in (
        (Kind.PLANE, 0, WORLD), (Kind.PLANE, 1, WORLD), (Kind.PLANE, 2, WORLD), (Kind.ROUND, 1, WORLD),
        (Kind.ROUND, 0, 1), (Kind.ROUND, 1, 2), (Kind.FACE, 0, 1), (Kind.FACE, 1, 2), (Kind.FACE, 2, 0),
        (Kind.EDGE, 0, 1), (Kind.EDGE, 1, 2),
    ):  # fmt: skip
        p, q = size[:, None] * vectors(), size[:, None] * vectors()
        if j == WORLD:
            q = c[:, i] + size[:, None] * rng.normal(size=(batch, 3))
        apart = c[:, i] + _put(R[:, i], p) - c[:, j] - _put(R[:, j], q)
        d, n = vectors(), vectors()
        along = {
            Kind.ROUND: apart / np.sqrt(dot(apart, apart))[:, None],
            Kind.EDGE: np.cross(_put(R[:, i], d), _put(R[:, j], n)),
        }
        gap = dot(along.get(kind, _put(R[:, j], n)), apart)
        touching = gap - size * log(-5.0, 0.0) * rng.choice([-1.0, 1.0], batch)
        stiffness = log(1.0, 7.0) * rng.choice([0.0, 1.0], batch, p=[0.4, 0.6]) + 1e-6
        bristle = size[:, None] * log(-5.0, -1.0, 1) * vectors()
        laws.append(
            Law(
                kind, i, j, p, q, d, n, touching, stiffness,
                stiffness * log(-5.0, -1.0) * rng.choice([0.0, 1.0], batch),
                log(-2.0, 1.0), stiffness * size * log(-6.0, 0.0), bristle,
            )
        )  # fmt: skip
    reach = size[:, None, None]
    world = World(
        c, R, reach * log(-4.0, 0.0, THINGS, 1) * vectors(THINGS), chord, turn, mass, second,
        cayley(turns()[:, 0]) @ R[:, TOOL], log(-3.0, 2.0), 9.81 * vectors(), tuple(laws),
    )  # fmt: skip
    return world, reach * log(-5.0, 0.0, THINGS, 1) * vectors(THINGS), turns()


def pivots(rng: np.random.Generator, batch: int, kind: Kind) -> tuple[World, Array, Array]:
    """Things without mass that turn on one contact whose depth stays what it is: nothing may be stored or burnt.

    Args:
        rng: draws all.
        batch: how many.
        kind: of the contact; not ROUND, whose tangent plane burns a little.
    """
    world, s, W = hostile(rng, batch)
    laws = [law for law in world.laws if law.kind is kind]
    law = laws[int(rng.integers(len(laws)))]
    none = np.zeros(batch)
    law = replace(
        law, stiffness=law.stiffness + 10.0, damping=none, friction=none, most=none, bristle=np.zeros((batch, 3))
    )
    i, j = law.first, law.second
    R, R_next = world.R, np.concatenate([cayley(W) @ world.R[:, :THINGS], world.R[:, THINGS:]], axis=1)
    s = np.concatenate([s, np.zeros((batch, 1, 3))], axis=1)

    def gap(R: Array, c: Array) -> tuple[Array, Array]:
        along = _put(R[:, j], law.n)
        if kind is Kind.EDGE:
            along = np.cross(_put(R[:, i], law.d), along)
        return dot(along, c[:, i] + _put(R[:, i], law.p) - c[:, j] - _put(R[:, j], law.q)), along

    before, _ = gap(R, world.c)
    there, along = gap(R_next, world.c + s)
    s[:, i] -= ((there - before) / dot(along, along))[:, None] * along
    law = replace(law, radii=before + 10.0 ** rng.uniform(-4.0, -1.0, batch))  # that deep
    light = 1e-30
    world = replace(
        world,
        mass=world.mass * light,
        second=world.second * light,
        lead=world.lead * light,
        gravity=np.zeros((batch, 3)),
        laws=(law,),
    )
    return world, s[:, :THINGS], W


def after(world: World, s: Array, W: Array, taken: Taken) -> World:
    """The world after a step; its hand stays."""
    turn = cayley(W)
    R = world.R.copy()
    R[:, :THINGS] = turn @ R[:, :THINGS]
    c = world.c.copy()
    c[:, :THINGS] += s
    return replace(world, c=c, R=R, way=s, chord=R[:, :THINGS] - world.R[:, :THINGS], turn=turn, laws=taken.laws)


@dataclass(frozen=True)
class Solved:
    """Steps that need nothing from outside.

    Attributes:
        s, W: the steps.
        taken: what they took in.
        off: what is left of the equations, m and rad, of each.
        rounds: of Newton's method, for the whole batch.
    """

    s: Array
    W: Array
    taken: Taken
    off: Array
    rounds: int


MOST_ROUNDS = 40
ENOUGH = 1e-13
"""m and rad, beside the step's own size."""


def solve(world: World, compliance: Array, free: Array, scheme: Scheme) -> Solved:
    """The steps in which the tool is at r + D f, and nothing else comes from outside.

    Newton's method with differences for derivatives, from what the things would do alone, with halved steps where the
    equations are further from fulfilled.

    Args:
        world: before the step.
        compliance: D, (batch, 3, 3), m/N.
        free: r less where the tool is, (batch, 3), m.
        scheme: how the step is made.
    """
    batch, size = len(free), 6 * THINGS
    inertia = np.trace(world.second, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - (
        world.R[:, :THINGS] @ world.second @ np.swapaxes(world.R[:, :THINGS], -1, -2)
    )
    yielding = T * T * np.linalg.inv(inertia)
    mass = np.maximum(world.mass, 1e-300)[..., None]

    def lacking(u: Array) -> tuple[Array, Taken]:
        s, W = u[:, : size // 2].reshape(batch, THINGS, 3), u[:, size // 2 :].reshape(batch, THINGS, 3)
        taken = step(world, s, W, scheme)
        ways = T * T * taken.forces / mass
        ways[:, TOOL] = s[:, TOOL] - free + _put(compliance, taken.forces[:, TOOL])
        turns = np.einsum("btij,btj->bti", yielding, taken.torques)
        return np.concatenate([ways.reshape(batch, -1), turns.reshape(batch, -1)], axis=1), taken

    w = axial(np.swapaxes(world.turn, -1, -2)) / (1.0 + np.trace(world.turn, axis1=-2, axis2=-1))[..., None] * 2.0
    w *= np.minimum(1.0, 1.0 / np.maximum(np.abs(w).max(axis=-1, keepdims=True), 1e-12))
    way = world.way.copy()
    way[:, TOOL] = free
    u = np.concatenate([way.reshape(batch, -1), w.reshape(batch, -1)], axis=1)
    found, taken = lacking(u)
    off = np.abs(found).max(axis=1)
    rounds = 0
    while rounds < MOST_ROUNDS and np.any(off > ENOUGH * (1.0 + np.abs(u).max(axis=1))):
        rounds += 1
        slope = np.empty((batch, size, size))
        for column in range(size):
            moved = u.copy()
            moved[:, column] += (h := 1e-8)
            slope[:, :, column] = (lacking(moved)[0] - found) / h
        try:
            way_on = -np.linalg.solve(slope, found[:, :, None])[:, :, 0]
        except np.linalg.LinAlgError:
            way_on = -np.einsum("bij,bj->bi", np.linalg.pinv(slope), found)
        part, best, best_off = np.ones((batch, 1)), u, off
        for _ in range(8):
            trial = u + part * way_on
            there, _ = lacking(trial)
            size_there = np.abs(there).max(axis=1)
            better = size_there < best_off
            best = np.where(better[:, None], trial, best)
            best_off = np.where(better, size_there, best_off)
            part = np.where(better[:, None], part, part / 4.0)
            if np.all(better):
                break
        if np.array_equal(best, u):
            break
        u = best
        found, taken = lacking(u)
        off = np.abs(found).max(axis=1)
    half = size // 2
    return Solved(u[:, :half].reshape(batch, THINGS, 3), u[:, half:].reshape(batch, THINGS, 3), taken, off, rounds)
