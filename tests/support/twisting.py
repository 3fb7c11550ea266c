"""Devices of six axes whose motors hold joint torques: what they give out beyond what force and torque count.

The tip has the twist xi = (v, omega) = J(q) dq/dt, in the world's axes. It is measured by |xi|^2 = |v|^2 + L^2
|omega|^2, and a wrench (f, m) by |f|^2 + |m|^2/L^2. The motors hold J(q_r)^T (f, m), q_r the joints at a reading
between the sample and the instant a at which they act. Until the next ones act they give out

    z^T (f, m) beyond f^T integral v + m^T integral omega,      z = J(q_r) (q' - q_a) - integral xi.

So of all wrenches of a size W the worst one gives out W |z|, and no search over wrenches is needed. A motion has even
rates of its joints in each substep. Times are in periods T.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SUBSTEPS: Final = 4

_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(4)  # of a substep: exact up to the seventh degree


class Mechanism(Protocol):
    """Six joints and a tip.

    Attributes:
        length: L, m/rad.
        low: the least of each joint, rad or m.
        high: the greatest.
    """

    length: float
    low: Array
    high: Array

    def place(self, q: Array) -> tuple[Array, Array]:
        """The tip's rotation matrix, ... x 3 x 3, and its position, ... x 3, m."""
        ...

    def jacobian(self, q: Array) -> Array:
        """J, ... x 6 x 6."""
        ...

    def changes(self, q: Array) -> Array:
        """dJ/dq, ... x 6 x 6 x 6: by joint, row and column."""
        ...


def scale(of: Mechanism) -> Array:
    """N = diag(1, 1, 1, L, L, L), by which a twist is measured, as a vector."""
    return np.array([1.0, 1.0, 1.0, of.length, of.length, of.length])


def bending(of: Mechanism, q: Array) -> Array:
    """The tensor S of N S(xi) N^-1, S(xi) = dJ/dt J^-1, at poses, ... x 6 x 6 x 6, 1/m.

    Entry (a, c, d) is of row a and column c, along the d-th entry of N xi.
    """
    N, inverse = scale(of), np.linalg.inv(of.jacobian(q))
    S = np.einsum("...jab,...bc,...jd->...acd", of.changes(q), inverse, inverse)
    found: Array = N[:, None, None] * S / N[None, :, None] / N[None, None, :]
    return found


def steepest(S: Array, rng: np.random.Generator, starts: int = 6, rounds: int = 15) -> Array:
    """kappa at each of so many poses, the greatest |S(u) v| of unit u and v, by alternation between u, v and S(u) v."""
    best = np.zeros(len(S))
    for _ in range(starts):
        u, size = rng.standard_normal((len(S), 6)), best
        for _ in range(rounds):
            u /= np.linalg.norm(u, axis=1, keepdims=True)
            left, s, right = np.linalg.svd(np.einsum("nacd,nd->nac", S, u))
            size = s[:, 0]
            u = np.einsum("nacd,na,nc->nd", S, left[:, :, 0], right[:, 0])
        best = np.maximum(size, best)
    return best


def straightest(S: Array, rng: np.random.Generator, starts: int = 6, rounds: int = 15) -> Array:
    """The unit u of the greatest |S(u) u| at each of so many poses: where even motion bends most."""
    even = 0.5 * (S + np.swapaxes(S, -1, -2))
    best, at = np.zeros(len(S)), np.zeros((len(S), 6))
    for _ in range(starts):
        u = rng.standard_normal((len(S), 6))
        for _ in range(rounds):
            u /= np.linalg.norm(u, axis=1, keepdims=True)
            along = np.einsum("nacd,nc,nd->na", even, u, u)
            values, vectors = np.linalg.eigh(np.einsum("nacd,na->ncd", even, along))
            first = np.abs(values[:, 0]) > np.abs(values[:, -1])
            u = np.where(first[:, None], vectors[:, :, 0], vectors[:, :, -1])
        size = np.linalg.norm(np.einsum("nacd,nc,nd->na", even, u, u), axis=1)
        at = np.where((size > best)[:, None], u, at)
        best = np.maximum(size, best)
    return at


def _box(of: Mechanism) -> tuple[Array, Array]:
    """The joints' box; half a turn or more where a joint has no ends: nothing depends on a slide, and all on a turn."""
    return np.where(np.isinf(of.low), -np.pi, of.low), np.where(np.isinf(of.high), np.pi, of.high)


def curvature(of: Mechanism, rng: np.random.Generator, poses: int = 600, closer: int = 6) -> float:
    """kappa over the joints' box, 1/m, by a search that comes closer to the best poses; it may miss a little."""
    low, high = _box(of)
    q = rng.uniform(low, high, (poses, 6))
    corners = np.array(list(product(*zip(low, high, strict=True))))
    q = np.concatenate([q, corners])
    most, width = 0.0, 0.25 * (high - low)
    for _ in range(closer):
        kappa = steepest(bending(of, q), rng, starts=3)
        most = max(most, float(kappa.max()))
        best = q[np.argsort(-kappa)[:8]]
        q = np.clip(np.repeat(best, 24, axis=0) + width * rng.uniform(-1.0, 1.0, (192, 6)), low, high)
        width = width / 2.5
    return most


@dataclass(frozen=True)
class Ways:
    """So many motions of the joints.

    Attributes:
        q: at the ends of substeps, motions x (1 + ticks x substeps) x 6.
        acts: the substep at whose beginning each tick's torques begin to act, motions x ticks.
        reads: that at whose beginning the joints were read for them.
    """

    q: Array
    acts: NDArray[np.intp]
    reads: NDArray[np.intp]


def ways(of: Mechanism, rng: np.random.Generator, count: int, ticks: int, speed: float, delay: int) -> Ways:
    """Motions of all kinds: free ones, even ones, to and fro at random; even and to and fro where it bends most.

    Args:
        of: the mechanism.
        rng: the random numbers.
        count: of motions.
        ticks: of each.
        speed: the greatest |xi|, m/T.
        delay: the substeps after which torques act at the latest; half of all act then.
    """
    q = np.zeros((count, ticks * SUBSTEPS + 1, 6))
    low, high = _box(of)
    q[:, 0] = rng.uniform(0.75 * low + 0.25 * high, 0.25 * low + 0.75 * high, (count, 6))
    best = straightest(bending(of, q[:, 0]), rng)[:, None]
    signs = np.repeat(np.where(rng.random((count, ticks, 1)) < 0.5, 1.0, -1.0), SUBSTEPS, axis=1)
    turns = np.repeat(np.where(np.arange(ticks) % 2, -1.0, 1.0), SUBSTEPS)[None, :, None]
    free = rng.standard_normal((count, ticks * SUBSTEPS, 6))
    direction, nothing = rng.standard_normal((count, 1, 6)), 0.0 * free
    kind = rng.integers(0, 5, (count, 1, 1))
    wanted = np.select([kind == i for i in range(5)],
                       [free, nothing + direction, signs * direction, nothing + best, turns * best])  # fmt: skip
    wanted /= np.linalg.norm(wanted, axis=-1, keepdims=True)
    wanted *= speed * 10.0 ** rng.uniform(-1.5, 0.0, (count, 1, 1)) / scale(of)
    for i in range(ticks * SUBSTEPS):
        rate = np.linalg.solve(of.jacobian(q[:, i]), wanted[:, i, :, None])[..., 0] / SUBSTEPS
        there = q[:, i] + rate
        out = np.any((there < of.low) | (there > of.high), axis=1)
        back = q[:, i] - rate
        there[out] = back[out]  # it turns back at its stops, or else stays
        still = np.any((there < of.low) | (there > of.high), axis=1)
        there[still] = q[still, i]
        q[:, i + 1] = there
    acts = np.where(rng.random((count, ticks)) < 0.5, delay, rng.integers(0, delay + 1, (count, ticks)))
    reads = np.minimum(rng.integers(0, delay + 1, acts.shape), acts)
    latest = rng.random((count, 1)) < 0.5  # in every tick, by joints that were read at the sample
    return Ways(q, np.where(latest, delay, acts), np.where(latest, 0, reads))


def twists(of: Mechanism, q: Array) -> tuple[Array, Array]:
    """Of each substep the integral of xi, motions x substeps x 6, and that of |xi|^2 over T, with its entries squared.

    Returns:
        The integrals of xi; and those of |v|^2 and of |omega|^2, motions x substeps x 2, in m^2/T and rad^2/T.
    """
    step = np.diff(q, axis=1)
    fractions = (_POINTS + 1) / 2
    inner = q[:, :-1, None] + fractions[None, None, :, None] * step[:, :, None]
    xi = np.einsum("ntpab,ntb->ntpa", of.jacobian(inner), step)
    squares = np.stack([(xi[..., :3] ** 2).sum(-1), (xi[..., 3:] ** 2).sum(-1)], axis=-1)
    ahead: Array = np.einsum("ntpa,p->nta", xi, _WEIGHTS / 2)
    burnt: Array = np.einsum("ntpa,p->nta", squares, _WEIGHTS / 2) * SUBSTEPS
    return ahead, burnt


def longest_twist(of: Mechanism, q: Array) -> float:
    """The greatest |xi| of the motions, m/T; a little more."""
    _, burnt = twists(of, q)
    return 1.001 * float(np.sqrt(SUBSTEPS * (burnt @ np.array([1.0, of.length**2])).max()))


def leaks(of: Mechanism, moved: Ways) -> tuple[Array, Array]:
    """What torques for the worst wrenches of the size 1 have given out at the end of each substep, and the burning.

    Returns:
        The sums of |z|, m; and those of the integrals of |xi|^2, m^2/T; both motions x substeps.
    """
    q, N = moved.q, scale(of)
    ahead, burnt = twists(of, q)
    way = np.concatenate([np.zeros((len(q), 1, 6)), np.cumsum(ahead, axis=1)], axis=1)
    count, ticks = moved.acts.shape
    steps = ticks * SUBSTEPS
    begins = np.arange(ticks)[None, :] * SUBSTEPS
    begun, read = begins + moved.acts, begins + moved.reads
    rows = np.arange(count)
    given, total = np.zeros((count, steps)), np.zeros(count)
    hold = np.full(count, -1)
    for i in range(steps):
        tick = i // SUBSTEPS
        # a delay of a whole period acts at the beginning of the next tick, before that one's own may
        for one in {max(tick - 1, 0), tick}:
            new = (begun[:, one] == i) & (hold < one)
            if new.any():
                total = np.where(new & (i > 0), given[:, i - 1], total)
                hold = np.where(new, one, hold)
        acts = hold >= 0
        k = np.maximum(hold, 0)
        J = of.jacobian(q[rows, read[rows, k]])
        start = begun[rows, k]
        z = np.einsum("nab,nb->na", J, q[:, i + 1] - q[rows, start]) - (way[:, i + 1] - way[rows, start])
        given[:, i] = np.where(acts, total + np.linalg.norm(N * z, axis=1), 0.0)
    return given, np.cumsum(burnt @ np.array([1.0, of.length**2]), axis=1)


class Chain:
    """Six revolute joints one behind the other, about any axes."""

    def __init__(self, axes: Array, links: Array, home: Array, width: float, length: float) -> None:
        """Joints within ``width`` (rad) of ``home``; rows of ``links`` (m) and unit ``axes`` are in joints' frames."""
        self.axes, self.links, self.length = axes, links, length
        self.low, self.high = home - width, home + width

    def _frames(self, q: Array) -> tuple[Array, Array, Array, Array]:
        """The joints' axes and places, ... x 6 x 3, and the tip's rotation and position."""
        turned = np.broadcast_to(np.eye(3), (*q.shape[:-1], 3, 3))
        place = np.zeros((*q.shape[:-1], 3))
        about, at = [], []
        for i, (axis, link) in enumerate(zip(self.axes, self.links, strict=True)):
            about.append(turned @ axis)
            at.append(place)
            turned = turned @ _about(axis, q[..., i])
            place = place + turned @ link
        return np.stack(about, axis=-2), np.stack(at, axis=-2), turned, place

    def place(self, q: Array) -> tuple[Array, Array]:
        """The tip's rotation and position."""
        return self._frames(q)[2:]

    def jacobian(self, q: Array) -> Array:
        """Column i is the axis of joint i times the lever to the tip, above the axis."""
        about, at, _, tip = self._frames(q)
        return np.swapaxes(np.concatenate([np.cross(about, tip[..., None, :] - at), about], axis=-1), -1, -2)

    def changes(self, q: Array) -> Array:
        """Joint j turns all that is behind it: the axes of later joints, and the levers of all."""
        about, at, _, tip = self._frames(q)
        levers = np.cross(about, tip[..., None, :] - at)
        found = np.zeros((*q.shape[:-1], 6, 6, 6))
        for j, i in product(range(6), repeat=2):
            found[..., j, :3, i] = np.cross(about[..., min(i, j), :], levers[..., max(i, j), :])
            if j < i:
                found[..., j, 3:, i] = np.cross(about[..., j, :], about[..., i, :])
        return found


def _about(axis: Array, angle: Array) -> Array:
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sin, cos = np.sin(angle)[..., None, None], np.cos(angle)[..., None, None]
    found: Array = np.eye(3) + sin * K + (1.0 - cos) * (K @ K)
    return found


def chain_at_random(rng: np.random.Generator, wrist: bool = False, worst: float = 12.0) -> Chain:
    """A chain of six joints whose box is well away from singular poses; its last three axes may meet in a point."""
    while True:
        axes = rng.standard_normal((6, 3))
        axes /= np.linalg.norm(axes, axis=1, keepdims=True)
        links = rng.standard_normal((6, 3))
        links *= rng.uniform(0.05, 0.2, (6, 1)) / np.linalg.norm(links, axis=1, keepdims=True)
        if wrist:
            links[3:5] = 0.0
            links[5] *= 0.3
        made = Chain(axes, links, rng.uniform(-np.pi, np.pi, 6), rng.uniform(0.05, 0.25), rng.uniform(0.05, 0.2))
        q = rng.uniform(made.low, made.high, (64, 6))
        J = scale(made)[:, None] * made.jacobian(q)
        if np.linalg.cond(J).max() < worst:
            return made


class Gantry:
    """Three slides carry three revolute joints (yaw, pitch, roll); the tip is some way from where their axes meet."""

    def __init__(self, tip: Array, pitch: float, length: float) -> None:
        """``tip`` (m) is in the gimbal's own axes; it pitches by at most ``pitch`` (rad), less than a right angle."""
        self.tip, self.length = tip, length
        ends = np.array([np.inf, np.inf, np.inf, np.inf, pitch, np.inf])
        self.low, self.high = -ends, ends

    def place(self, q: Array) -> tuple[Array, Array]:
        """The tip's rotation and position."""
        R = self._gimbal(q)[1]
        return R, q[..., :3] + R @ self.tip

    def _gimbal(self, q: Array) -> tuple[Array, Array]:
        """The three axes, as columns, and the rotation."""
        z, y, x = np.eye(3)[::-1]
        yaw, pitch, roll = (_about(axis, q[..., 3 + i]) for i, axis in enumerate((z, y, x)))
        axes = [np.broadcast_to(z, (*q.shape[:-1], 3)), yaw @ y, yaw @ pitch @ x]
        return np.stack(axes, axis=-1), yaw @ pitch @ roll

    def jacobian(self, q: Array) -> Array:
        """The slides move the tip alone."""
        E, R = self._gimbal(q)
        J = np.zeros((*q.shape[:-1], 6, 6))
        J[..., :3, :3] = np.eye(3)
        J[..., :3, 3:] = np.cross(E, (R @ self.tip)[..., :, None], axisa=-2, axisb=-2, axisc=-2)
        J[..., 3:, 3:] = E
        return J

    def changes(self, q: Array) -> Array:
        """As of a chain whose axes meet."""
        E, R = self._gimbal(q)
        about, lever = np.swapaxes(E, -1, -2), (R @ self.tip)[..., None, :]
        levers = np.cross(about, lever)
        found = np.zeros((*q.shape[:-1], 6, 6, 6))
        for j, i in product(range(3), repeat=2):
            found[..., 3 + j, :3, 3 + i] = np.cross(about[..., min(i, j), :], levers[..., max(i, j), :])
            if j < i:
                found[..., 3 + j, 3:, 3 + i] = np.cross(about[..., j, :], about[..., i, :])
        return found
