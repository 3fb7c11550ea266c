"""What others do for a tool that a hand turns, beside the law of decision 54: a god-object, and a midpoint body.

Both see the samples of :mod:`tests.support.turning` and state a torque in each tick, which the device holds. Times are
in periods T, torques in k rad, inertias in k T^2, so that k = T = 1. What they stand in is nothing, or a *hole*: the
tool's axis is within 20 degrees of the vertical.

**The god-object with an orientation** (:func:`god_object`), as documented in [Zilles1995]_ and [Ortega2007]_: the proxy
is the nearest orientation that the hole allows, and the torque is that of a spring along the shortest turn, -k theta u.
What we had to choose: the projection is one step, without inertia and without friction; a hole for their polyhedra.

**Passive midpoint integration** (:class:`MidpointBody`), as documented in the abstract and the introduction of
[Kim2017]_: a rigid body, its spring and its contacts are integrated by the midpoint rule, on SE(3), so that in each
step the body and the spring have gained no more than what the moving end of the spring did; contacts by a linear
complementarity problem. The text of the derivation was not at hand, so what follows was ours to choose:

- the coupling: a chordal spring, and a damper, between the device's samples and the body;
- the rule on rotations: that of quaternions, q' - q = (T/2) w (q' + q)/2, of which U = 2k (1 - (R.q)^2) and the hole's
  q'Gq - c are quadratic forms, so that the balance is exact and no term is linearised. Theirs takes no iterations; ours
  is iterated until it stands, which can only help it;
- the contact: its direction follows the midpoint for some rounds, and then stands, so that the hole's push never does
  work on the body, while the tool may get beyond the hole by some thousandths of a degree;
- the body: as heavy about every axis as an avatar of ours has to be, 4 k T^2;
- the device's side, of which nothing is said: the torque of the midpoint, or that of the same spring at the sample and
  the step's end, which is half a period fresher. Either is held for a period.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from manyhands.nodes.kernel.orientation import UPRIGHT, Quaternion, between, difference
from tests.support.turning import SUBSTEPS, Array, Motions, product, violent

HOLE: Final = math.radians(20.0)
"""How far the axis of a tool in a hole may be tilted, rad."""

INERTIA: Final = 4.0
"""Of a midpoint body, k T^2."""

FASTEST: Final = 0.1
"""Of the hands, rad/T: 100 rad/s at a millisecond, several times what a wrist can do."""

LATE: Final = 0.1
"""The part of the ticks that are late, where some are."""

_ROUNDS: Final = 16  # of the midpoint rule; each leaves about a sixteenth of the error
_NORMAL: Final = 6  # of these, in which the contact's direction follows the midpoint; then it stands


def hands(rng: np.random.Generator, count: int, ticks: int, delay: int, late: bool = False) -> Motions:
    """Hands that turn at up to :data:`FASTEST`: half of them violently, half to and fro about one axis.

    Args:
        rng: the random numbers.
        count: of hands.
        ticks: of each.
        delay: the substeps after which a torque acts at the latest.
        late: whether every tenth tick is late besides: it takes up to three periods, in which the hand turns on at the
            same speed, and its torque acts within the first of its four parts, or the second, third or last.
    """
    found = violent(rng, count, ticks, delay)
    half = count // 2
    axes = rng.standard_normal((half, 3))
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    omega = 10.0 ** rng.uniform(-1.5, 0.0, (half, 1))  # rad a tick
    fine = np.arange(ticks * SUBSTEPS + 1) / SUBSTEPS
    way = np.minimum(fine / (ticks / 4), 1.0) * np.sin(omega * fine)
    turns = np.array(found.turns)
    turns[:half] = np.diff(way, axis=1).reshape(half, ticks, SUBSTEPS, 1) * axes[:, None, None]
    fastest = FASTEST * 10.0 ** rng.uniform(-1.0, 0.0, (count, 1, 1, 1)) / SUBSTEPS
    turns *= fastest / np.linalg.norm(turns, axis=-1, keepdims=True).max(axis=(1, 2), keepdims=True)
    if not late:
        return Motions(turns, found.lasts, found.acts)
    when = rng.random((count, ticks)) < LATE
    longer = np.where(when, rng.uniform(1.0, 3.0, when.shape), 1.0)[..., None]
    acts = np.where(when, rng.integers(0, SUBSTEPS, when.shape), found.acts)
    return Motions(turns * longer[..., None], found.lasts * longer, acts)


def geodesic(R: Quaternion, Q: Quaternion) -> tuple[float, float, float]:
    """-theta u, the torque of a spring along the shortest turn."""
    w, x, y, z = difference(R, Q)
    sine = math.sqrt(x * x + y * y + z * z)
    factor = -2.0 * math.atan2(sine, abs(w)) * math.copysign(1.0, w) / max(sine, 1e-300)
    return (factor * x, factor * y, factor * z)


def in_a_hole(R: Quaternion) -> Quaternion:
    """The nearest orientation whose axis is within :data:`HOLE` of the vertical."""
    w, x, y, z = R
    tilt = 2.0 * math.atan2(math.hypot(x, y), math.hypot(w, z))
    if tilt <= HOLE:
        return R
    # R is a tilt about a horizontal axis after a twist about the vertical one; the twist stays, and the tilt is less
    size = math.hypot(w, z)
    twist = Quaternion(w / size, 0.0, 0.0, z / size) if size > 0.0 else UPRIGHT
    tilted = between(UPRIGHT, difference(R, twist), HOLE / tilt)
    return difference(tilted, Quaternion(twist.w, 0.0, 0.0, -twist.z))


def god_object(samples: Array) -> Array:
    """The torque of a god-object in a hole, motions x ticks x 3, from the samples, motions x ticks x 4."""
    found = [[geodesic(R, in_a_hole(R)) for R in (Quaternion(*q) for q in motion)] for motion in samples.tolist()]
    return np.array(found)


_UPRIGHTNESS: Final = np.array([1.0, -1.0, -1.0, 1.0])
"""G: the upright part of the tool's axis is q'Gq."""


def _conjugate(q: Array) -> Array:
    return q * np.array([1.0, -1.0, -1.0, -1.0])


def _dot(a: Array, b: Array) -> Array:
    found: Array = (a * b).sum(-1, keepdims=True)
    return found


def _turn(old: Array, new: Array) -> Array:
    """The angular velocity by which the midpoint rule gets from ``old`` to ``new`` in a period."""
    mean = 0.5 * (old + new)
    return 2.0 * product(new - old, _conjugate(mean))[..., 1:] / _dot(mean, mean)


def _moved(q: Array, w: Array) -> Array:
    """Where the midpoint rule gets from q in a period by the angular velocity w: (1 - w/4)^-1 (1 + w/4) q."""
    quarter = np.concatenate([np.ones_like(w[..., :1]), 0.25 * w], axis=-1)
    return product(product(quarter, quarter), q) / _dot(quarter, quarter)


class MidpointBody:
    """Bodies that are joined to the samples of as many hands by a spring and a damper, one for each.

    Attributes:
        Q: their orientations at the sample, bodies x 4.
        kept: what each and its spring hold, less what the spring's moving end has put in so far, k rad^2. By the
            midpoint rule it never rises.
    """

    def __init__(self, count: int, damping: float = 0.0, hole: bool = False) -> None:
        """Begin upright and at rest, with the devices there as well.

        Args:
            count: of bodies.
            damping: of the coupling, k T.
            hole: whether each is in a hole.
        """
        self._B, self._hole = damping, hole
        self.Q = np.tile(np.array([1.0, 0.0, 0.0, 0.0]), (count, 1))
        self._R, self._w = self.Q.copy(), np.zeros((count, 3))
        self.kept = np.zeros(count)
        self._port = np.zeros(count)

    def step(self, R: Array) -> tuple[Array, Array]:
        """Take a period, in which the devices get to R, bodies x 4.

        Returns:
            The torque on the devices by the midpoint, and by the sample alone; bodies x 3 each.
        """
        Q, w, mean, moved = self.Q, self._w.copy(), 0.5 * (self._R + R), _turn(self._R, R)
        n = self._normal(Q)
        for number in range(_ROUNDS):
            middle, there = 0.5 * (Q + _moved(Q, w)), _moved(Q, w)
            s = 0.5 * (_dot(self._R, Q) + _dot(R, there))
            torque = 2.0 * s * product(mean, _conjugate(middle))[..., 1:] + self._B * (moved - w)
            w = self._w + torque / (2.0 * INERTIA)
            if self._hole:
                n = self._normal(middle) if number < _NORMAL else n
                gap = np.maximum(0.0, _dot(Q, _UPRIGHTNESS * Q) - math.cos(HOLE))
                w = w + np.maximum(0.0, -(gap + _dot(n, w)) / np.maximum(_dot(n, n), 1e-12)) * n
        there = _moved(Q, w)
        self._w = 2.0 * w - self._w
        self.Q = there / np.linalg.norm(there, axis=-1, keepdims=True)
        self._port += (torque * moved).sum(-1)
        self._R = R
        lag = product(R, _conjugate(self.Q))
        self.kept = 0.5 * INERTIA * (self._w**2).sum(-1) + 2.0 * (lag[..., 1:] ** 2).sum(-1) - self._port
        return -torque, -2.0 * lag[..., :1] * lag[..., 1:] - self._B * (moved - w)

    @staticmethod
    def _normal(q: Array) -> Array:
        """n, with which the upright part of the tool's axis changes by n.w in a step about the midpoint q."""
        found: Array = product(_UPRIGHTNESS * q, _conjugate(q))[..., 1:]
        return found


def midpoint(samples: Array, damping: float = 0.0, hole: bool = False) -> tuple[Array, Array, Array]:
    """Midpoint bodies joined to the samples, motions x ticks x 4.

    Returns:
        The torques by the midpoint and by the sample, motions x ticks x 3 each, and where the bodies are, x 4.
    """
    bodies = MidpointBody(len(samples), damping, hole)
    ticks = [(*bodies.step(samples[:, k]), bodies.Q) for k in range(samples.shape[1])]
    first, second, way = (np.stack(column, axis=1) for column in zip(*ticks, strict=True))
    return first, second, way
