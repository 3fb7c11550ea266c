"""Hands that turn a device, and what a held torque gives them: the search against decision 54.

A hand moves a device without inertia that burns b |omega|^2, in substeps of even turning. It samples its orientation,
and the torque of :class:`~manyhands.nodes.kernel.orientation.OrientationSpring` acts some substeps later, until the
next one does. What the hand has put in, the integral of (b omega - t)^T omega, may never fall below minus the tank.
Times are in periods T, torques in k rad, so that k = T = 1.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from manyhands.nodes.kernel.orientation import OrientationSpring, Quaternion

Array = NDArray[np.float64]
Proxies = Callable[[int, int, Quaternion, Quaternion], Quaternion | None]
"""The proposal for a motion and a tick, from the device's orientation and the proxy before."""

SUBSTEPS: Final = 4


@dataclass(frozen=True)
class Motions:
    """So many motions of a hand.

    Attributes:
        turns: the rotation vector of each substep, motions x ticks x substeps x 3, rad.
        lasts: how long each substep takes, motions x ticks x substeps, T.
        acts: the substep in which each tick's torque begins to act, motions x ticks.
    """

    turns: Array
    lasts: Array
    acts: NDArray[np.intp]

    @property
    def samples(self) -> Array:
        """The orientation at the beginning of each tick, motions x ticks x 4."""
        return paths(self.turns)[:, :-1:SUBSTEPS]

    @property
    def latest(self) -> float:
        """The longest delay, T."""
        ends = np.cumsum(self.lasts, axis=2)
        starts = np.concatenate([np.zeros_like(ends[:, :, :1]), ends], axis=2)
        return float(np.take_along_axis(starts, self.acts[:, :, None], axis=2).max(initial=0.0))


def product(a: Array, b: Array) -> Array:
    """Products of quaternions, ... x 4."""
    w, v, s, u = a[..., :1], a[..., 1:], b[..., :1], b[..., 1:]
    return np.concatenate([w * s - (v * u).sum(-1, keepdims=True), w * u + s * v + np.cross(v, u)], axis=-1)


def turned(vectors: Array) -> Array:
    """The quaternions of rotation vectors, ... x 3, rad."""
    angles = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.concatenate([np.cos(angles / 2), 0.5 * np.sinc(angles / (2 * np.pi)) * vectors], axis=-1)


def paths(turns: Array) -> Array:
    """The orientations at the ends of all substeps, motions x (1 + ticks x substeps) x 4; all begin upright."""
    steps = turned(turns).reshape(len(turns), -1, 4)
    found = np.empty((len(turns), steps.shape[1] + 1, 4))
    found[:, 0] = (1.0, 0.0, 0.0, 0.0)
    for i in range(steps.shape[1]):
        there = product(steps[:, i], found[:, i])
        found[:, i + 1] = there / np.linalg.norm(there, axis=-1, keepdims=True)
    return found


def torques(motions: Motions, proposed: Proxies, tank: float = 0.0, most: float = math.inf) -> tuple[Array, int]:
    """What the spring exerts in each tick, motions x ticks x 3, and how often its test held a step."""
    samples = motions.samples
    found, held = np.empty((*samples.shape[:2], 3)), 0
    for i, orientations in enumerate(samples.tolist()):
        spring = OrientationSpring(1.0, most)
        for k, numbers in enumerate(orientations):
            R = Quaternion(*numbers)
            # one hand alone: what it has deposited is granted to it in the next tick
            found[i, k] = spring.turn(R, proposed(i, k, R, spring.proxy), tank + spring.deposited)
        held += spring.held
    return found, held


def held_torques(motions: Motions, exerted: Array) -> Array:
    """The torque that acts in each substep, motions x (ticks x substeps) x 3."""
    count, ticks = exerted.shape[:2]
    before = np.concatenate([np.zeros((count, 1, 3)), exerted[:, :-1]], axis=1)
    begun = np.arange(SUBSTEPS)[None, None, :] >= motions.acts[:, :, None]
    return np.where(begun[..., None], exerted[:, :, None], before[:, :, None]).reshape(count, ticks * SUBSTEPS, 3)


def least_energy(motions: Motions, exerted: Array, b: float) -> Array:
    """The least that each hand has put in so far at the end of a substep, in k rad^2."""
    turns = motions.turns.reshape(len(exerted), -1, 3)
    burnt = b * (turns**2).sum(-1) / motions.lasts.reshape(len(exerted), -1)
    work = (held_torques(motions, exerted) * turns).sum(-1)
    least: Array = np.minimum(np.cumsum(burnt - work, axis=1).min(axis=1), 0.0)
    return least


def bound(delay: float, longest: float = 1.0) -> float:
    """The damping that (*) of the law asks for, in k T, with delays and periods of at most these, T."""
    return 0.5 * longest + 1.5 * delay


def violent(rng: np.random.Generator, count: int, ticks: int, delay: int, wobble: float = 0.0) -> Motions:
    """Motions of all kinds: to and fro about one axis, about many, from a hundredth of a radian a tick to two.

    Args:
        rng: the random numbers.
        count: of motions.
        ticks: of each.
        delay: the substeps after which a torque acts at the latest; half of all act then.
        wobble: periods are between 1 - wobble and 1 + wobble.
    """
    shape = (count, ticks, SUBSTEPS)
    axes = rng.standard_normal((count, 1, 1, 3))
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    signs = np.where(rng.random((count, ticks, 1, 1)) < 0.5, 1.0, -1.0)
    about = axes * signs * np.abs(rng.standard_normal((*shape, 1)))
    free = rng.standard_normal((*shape, 3))
    kind = rng.integers(0, 3, (count, 1, 1, 1))
    amplitude = 10.0 ** rng.uniform(-2.0, 0.3, (count, 1, 1, 1)) / SUBSTEPS
    turns = amplitude * np.select([kind == 0, kind == 1], [free, about], about + 0.2 * free)
    lasts = np.broadcast_to(1.0 + rng.uniform(-wobble, wobble, (count, ticks, 1)), shape) / SUBSTEPS
    latest = rng.random((count, ticks)) < 0.5
    return Motions(
        turns, np.ascontiguousarray(lasts), np.where(latest, delay, rng.integers(0, delay + 1, latest.shape))
    )


def hostile(rng: np.random.Generator, count: int, ticks: int) -> Proxies:
    """Proxies that jump about the device, about where they were, to and fro between the two, rest, or do not come."""
    kinds = rng.integers(0, 5, count)
    jumps = rng.standard_normal((count, ticks, 3)) * 10.0 ** rng.uniform(-2.0, 0.3, (count, 1, 1))
    steps = turned(jumps).tolist()
    coins = rng.random((count, ticks)).tolist()

    def proposed(i: int, k: int, R: Quaternion, Q: Quaternion) -> Quaternion | None:
        there = R if kinds[i] in (0, 2) or (kinds[i] == 3 and coins[i][k] < 0.5) else Q
        if kinds[i] == 4 and coins[i][k] < 0.3:
            return None
        return _times(steps[i][k], there) if kinds[i] != 2 else there

    return proposed


def resonant(
    amplitude: float, omega: float, delay: int, ticks: int, ratio: complex | None = None
) -> tuple[Motions, Proxies]:
    """A hand that swings about one axis, and the proxy that a lossless world would answer with: the worst of all.

    With a constant delay of t T the pair gives out energy exactly if b < k T/2 (sin((1 + t) w/2)/sin(w/2))^2, which is
    k T (1 + t)^2/2 for slow swings.

    Args:
        amplitude: of the hand, rad.
        omega: rad a tick.
        delay: the substeps after which a torque acts.
        ticks: of the motion; it swells for a quarter of them.
        ratio: of the proxy's swing to the hand's, as phasors; the worst one if it is None.
    """
    s, t = math.sin(omega / 2), delay / SUBSTEPS
    phase = math.pi / 2 - omega / 2 - t * omega
    if ratio is None:
        ratio = 1.0 - (np.exp(1j * (math.pi / 2 - omega / 2)) + np.exp(-1j * phase)) / (2.0 * s)
    fine = np.arange(ticks * SUBSTEPS + 1) / SUBSTEPS
    swell = np.minimum(fine / (ticks / 4), 1.0)
    x = amplitude * swell * np.cos(omega * fine)
    q = amplitude * swell[:-1:SUBSTEPS] * np.real(ratio * np.exp(1j * omega * np.arange(ticks)))
    turns = np.zeros((1, ticks, SUBSTEPS, 3))
    turns[0, :, :, 2] = np.diff(x).reshape(ticks, SUBSTEPS)
    turns[0, 0, 0, 2] += x[0]
    halves = (0.5 * q).tolist()

    def proposed(i: int, k: int, R: Quaternion, Q: Quaternion) -> Quaternion:
        return Quaternion(math.cos(halves[k]), 0.0, 0.0, math.sin(halves[k]))

    lasts = np.full((1, ticks, SUBSTEPS), 1.0 / SUBSTEPS)
    return Motions(turns, lasts, np.full((1, ticks), delay, dtype=np.intp)), proposed


def _times(a: list[float], b: Quaternion) -> Quaternion:
    w, x, y, z = a
    numbers = (
        w * b.w - x * b.x - y * b.y - z * b.z,
        w * b.x + x * b.w + y * b.z - z * b.y,
        w * b.y + y * b.w + z * b.x - x * b.z,
        w * b.z + z * b.w + x * b.y - y * b.x,
    )
    norm = math.sqrt(sum(number * number for number in numbers))
    return Quaternion(*(number / norm for number in numbers))
