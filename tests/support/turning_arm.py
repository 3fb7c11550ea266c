"""A hand on a device of six axes whose motors hold joint torques: the search against decision 54 on SE(3).

The device is a gantry with a gimbal: three slides carry three revolute joints (yaw, pitch, roll), and the tip is some
way from where their axes meet. With q the joints, the twist of the tip is xi = (v, omega) = J(q) dq/dt. In each tick
the motors are given m = J(q_s)^T (f, t), q_s the joints at the sample, and hold it. Forces and torques are those of
springs to proxies, each under the test of the law. Twists are measured by |xi|^2 = |v|^2 + L^2 |omega|^2. Times are in
periods T.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from manyhands.nodes.kernel.orientation import OrientationSpring, Quaternion

from .turning import product, turned

Array = NDArray[np.float64]

SUBSTEPS: Final = 4
PITCH: Final = 0.6
"""rad; the gimbal pitches no further, for at a right angle it is singular."""

TIP: Final = np.array([0.05, 0.0, 0.02])
"""The tip from where the axes meet, in the gimbal's own axes, m."""

L: Final = 0.05
"""m/rad; what a turn counts against a way."""

SCALE: Final = np.array([1.0, 1.0, 1.0, L, L, L])

_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(4)  # of a substep: exact up to the seventh degree


def rotation(angles: Array) -> Array:
    """The rotation matrices of yaw, pitch and roll, ... x 3 x 3."""
    (a, b, c), zero = np.moveaxis(angles, -1, 0), np.zeros(angles.shape[:-1])
    one = np.ones_like(zero)

    def rows(*entries: Array) -> Array:
        return np.stack(entries, axis=-1).reshape(*zero.shape, 3, 3)

    yaw = rows(np.cos(a), -np.sin(a), zero, np.sin(a), np.cos(a), zero, zero, zero, one)
    pitch = rows(np.cos(b), zero, np.sin(b), zero, one, zero, -np.sin(b), zero, np.cos(b))
    roll = rows(one, zero, zero, zero, np.cos(c), -np.sin(c), zero, np.sin(c), np.cos(c))
    found: Array = yaw @ pitch @ roll
    return found


def jacobian(angles: Array) -> Array:
    """J, ... x 6 x 6: the tip's twist of the rates of three slides and of yaw, pitch and roll."""
    a, b = angles[..., 0], angles[..., 1]
    zero, one = np.zeros_like(a), np.ones_like(a)
    E = np.stack(
        [
            np.stack([zero, zero, one], axis=-1),
            np.stack([-np.sin(a), np.cos(a), zero], axis=-1),
            np.stack([np.cos(a) * np.cos(b), np.sin(a) * np.cos(b), -np.sin(b)], axis=-1),
        ],
        axis=-1,
    )
    r = rotation(angles) @ TIP
    J = np.zeros((*angles.shape[:-1], 6, 6))
    J[..., :3, :3] = np.eye(3)
    J[..., :3, 3:] = np.cross(E, r[..., None, :], axisa=-2, axisb=-1, axisc=-2)
    J[..., 3:, 3:] = E
    return J


def curvature(rng: np.random.Generator, poses: int = 400) -> float:
    """kappa, the greatest |dJ[J^-1 xi] J^-1 eta| of unit xi and eta, by a search over poses and directions, 1/m."""
    most, h = 0.0, 1e-5
    for _ in range(poses):
        angles = np.array([0.0, rng.uniform(-PITCH, PITCH), rng.uniform(-np.pi, np.pi)])
        J = jacobian(angles)
        inverse = np.linalg.inv(J)
        change = np.zeros((6, 6, 6))  # of J, by joint
        for joint in range(3):
            step = h * np.eye(3)[joint]
            change[3 + joint] = (jacobian(angles + step) - jacobian(angles - step)) / (2 * h)
        S = np.einsum("jab,bc,jd->adc", change, inverse, inverse)  # of xi (d) and eta (c)
        S = SCALE[:, None, None] * S / SCALE[None, :, None] / SCALE[None, None, :]
        for _ in range(4):
            xi = rng.standard_normal(6)
            for _ in range(12):
                xi /= np.linalg.norm(xi)
                u, s, v = np.linalg.svd(np.einsum("adc,d->ac", S, xi))
                xi = np.einsum("adc,a,c->d", S, u[:, 0], v[0])
            most = max(most, float(s[0]))
    return most


@dataclass(frozen=True)
class Arm:
    """A device of six axes, its springs, and what they ask of its damping.

    Attributes:
        stiffness: of the tip's place, N/m; 1 stands for any.
        turning: of its orientation, N m/rad.
        most: the greatest force, N; the greatest torque is L times it.
        bend: K_geo, N/m.
        delay: the substeps after which torques act at the latest.
    """

    stiffness: float
    turning: float
    most: float
    bend: float
    delay: int

    def dampings(self) -> tuple[float, float]:
        """What the tip has to burn at least, b of its place (N T/m) and of its orientation (N m T/rad)."""
        h = 0.5 + 1.5 * self.delay / SUBSTEPS
        return h * (self.stiffness + self.bend), h * (self.turning + self.bend * L**2)

    def least(self, rng: np.random.Generator, count: int, ticks: int, speed: float, part: float = 1.0) -> Array:
        """The least energy that each of so many hands has put in, J.

        Args:
            rng: the random numbers.
            count: of motions.
            ticks: of each.
            speed: the greatest |xi|, in the norm above, m/T.
            part: of the damping that is asked for, which the device has.
        """
        q, rates = _joints(rng, count, ticks, speed)
        b, b_r = self.dampings()
        fractions = (_POINTS + 1) / 2
        inner = q[:, :-1, None] + fractions[None, None, :, None] * np.diff(q, axis=1)[:, :, None]
        xi = np.einsum("ntpab,ntb->ntpa", jacobian(inner[..., 3:]), rates)
        squares = part * (b * (xi[..., :3] ** 2).sum(-1) + b_r * (xi[..., 3:] ** 2).sum(-1))
        burnt = (squares * _WEIGHTS / 2).sum(-1) / SUBSTEPS
        held = self._held(rng, q, ticks)
        work = (held * np.diff(q, axis=1)).sum(-1)
        found: Array = np.minimum(np.cumsum(burnt - work, axis=1).min(axis=1), 0.0)
        return found

    def _held(self, rng: np.random.Generator, q: Array, ticks: int) -> Array:
        """The joint torques in each substep."""
        samples = q[:, :-1:SUBSTEPS]
        J = jacobian(samples[..., 3:])
        R = rotation(samples[..., 3:])
        tips = samples[..., :3] + R @ TIP
        acts = np.where(rng.random(J.shape[:2]) < 0.5, self.delay, rng.integers(0, self.delay + 1, J.shape[:2]))
        motors = np.empty((len(q), ticks, 6))
        for i in range(len(q)):
            spring = OrientationSpring(self.turning, most=L * self.most * math.sqrt(0.5), at=_quaternion(R[i, 0]))
            at, account = tips[i, 0], 0.0
            jumps = 10.0 ** rng.uniform(-3.0, 0.0)
            kind = rng.integers(0, 3)
            for k in range(ticks):
                here, x = _quaternion(R[i, k]), tips[i, k]
                turn = product(turned(jumps * rng.standard_normal(3)), np.array(here if kind else spring.proxy))
                t = spring.turn(here, None if kind == 2 else Quaternion(*turn.tolist()), spring.deposited)
                step = (x if kind else at) + 0.05 * jumps * rng.standard_normal(3) - at
                if kind != 2:
                    at, account = _moved(self.stiffness, x, at, step, account)
                f = -self.stiffness * (x - at)
                if (size := float(np.linalg.norm(f))) > self.most * math.sqrt(0.5):  # then the proxy follows
                    f *= self.most * math.sqrt(0.5) / size
                    at = x + f / self.stiffness
                motors[i, k] = J[i, k].T @ np.concatenate([f, t])
        before = np.concatenate([np.zeros((len(q), 1, 6)), motors[:, :-1]], axis=1)
        begun = np.arange(SUBSTEPS)[None, None, :] >= acts[:, :, None]
        return np.where(begun[..., None], motors[:, :, None], before[:, :, None]).reshape(len(q), -1, 6)


def _joints(rng: np.random.Generator, count: int, ticks: int, speed: float) -> tuple[Array, Array]:
    """Joints at the ends of substeps, motions x (1 + ticks x substeps) x 6, and their rates in each, per T."""
    steps = ticks * SUBSTEPS
    signs = np.repeat(np.where(rng.random((count, ticks, 1)) < 0.5, 1.0, -1.0), SUBSTEPS, axis=1)
    direction = rng.standard_normal((count, 1, 6))
    free = rng.standard_normal((count, steps, 6))
    kind = rng.integers(0, 3, (count, 1, 1))
    wanted = np.select([kind == 0, kind == 1], [free, np.broadcast_to(direction, free.shape)], signs * direction)
    wanted /= np.linalg.norm(wanted, axis=-1, keepdims=True)
    wanted *= speed * 10.0 ** rng.uniform(-1.5, 0.0, (count, 1, 1)) / SCALE
    q = np.zeros((count, steps + 1, 6))
    q[:, 0, 4] = rng.uniform(-PITCH / 2, PITCH / 2, count)
    q[:, 0, 5] = rng.uniform(-np.pi, np.pi, count)
    rates = np.empty((count, steps, 6))
    for i in range(steps):
        J = jacobian(q[:, i, 3:])
        rate = np.linalg.solve(J, wanted[:, i, :, None])[..., 0]
        # the pitch turns back at its stops, and no twist of the substep is faster
        beyond = np.abs(q[:, i, 4] + rate[:, 4] / SUBSTEPS) > PITCH
        rate[beyond] *= -1.0
        q[:, i + 1] = q[:, i] + rate / SUBSTEPS
        q[:, i + 1, 4] = np.clip(q[:, i + 1, 4], -PITCH, PITCH)
        rates[:, i] = (q[:, i + 1] - q[:, i]) * SUBSTEPS
    return q, rates


def _moved(K: float, x: Array, at: Array, step: Array, account: float) -> tuple[Array, float]:
    """The proxy of a place after the part of its step that the account allows, and the account."""
    part = 1.0
    for _ in range(40):
        gain = K * float((x - at - part * step) @ (part * step))
        if account + gain >= 0.0:
            return at + part * step, account + gain
        part *= 0.5
    return at, account


def _quaternion(R: Array) -> Quaternion:
    """Of a rotation matrix; by its greatest component."""
    w = np.array([1 + np.trace(R), *(1 + 2 * R[i, i] - np.trace(R) for i in range(3))])
    squares = np.sqrt(np.maximum(w, 0.0)) / 2
    n = int(np.argmax(squares))
    a = 4 * squares[n]
    rows = [
        (squares[0], (R[2, 1] - R[1, 2]) / a, (R[0, 2] - R[2, 0]) / a, (R[1, 0] - R[0, 1]) / a),
        ((R[2, 1] - R[1, 2]) / a, squares[1], (R[0, 1] + R[1, 0]) / a, (R[0, 2] + R[2, 0]) / a),
        ((R[0, 2] - R[2, 0]) / a, (R[0, 1] + R[1, 0]) / a, squares[2], (R[1, 2] + R[2, 1]) / a),
        ((R[1, 0] - R[0, 1]) / a, (R[0, 2] + R[2, 0]) / a, (R[1, 2] + R[2, 1]) / a, squares[3]),
    ]
    numbers = np.array(rows[n])
    return Quaternion(*(numbers / np.linalg.norm(numbers)).tolist())
