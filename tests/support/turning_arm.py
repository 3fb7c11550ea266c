"""A hand on a device of six axes whose motors hold joint torques: the search against decision 54 on SE(3).

The device is a :class:`~tests.support.twisting.Mechanism`. In each tick the motors are given m = J(q_r)^T (f, t), q_r
the joints at a reading between the sample and the force, and hold it. Forces and torques are those of springs to
proxies, each under the test of the law. Twists are measured by |xi|^2 = |v|^2 + L^2 |omega|^2. Times are in periods T.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from manyhands.nodes.kernel.orientation import OrientationSpring, Quaternion

from .turning import product, turned
from .twisting import SUBSTEPS, Array, Mechanism, Ways, twists


@dataclass(frozen=True)
class Arm:
    """A device of six axes, its springs, and what they ask of its damping.

    Attributes:
        of: the device.
        stiffness: of the tip's place, N/m; 1 stands for any.
        turning: of its orientation, N m/rad.
        most: the greatest force, N; the greatest torque is L times it.
        bend: K_geo, N/m.
        delay: the substeps after which torques act at the latest.
    """

    of: Mechanism
    stiffness: float
    turning: float
    most: float
    bend: float
    delay: int

    def dampings(self) -> tuple[float, float]:
        """What the tip has to burn at least, b of its place (N T/m) and of its orientation (N m T/rad)."""
        h = 0.5 + 1.5 * self.delay / SUBSTEPS
        return h * (self.stiffness + self.bend), h * (self.turning + self.bend * self.of.length**2)

    def least(self, rng: np.random.Generator, moved: Ways) -> Array:
        """The least energy that the hand of each of these motions has put in, J."""
        b, b_r = self.dampings()
        _, burnt = twists(self.of, moved.q)
        held = self._held(rng, moved)
        work = (held * np.diff(moved.q, axis=1)).sum(-1)
        found: Array = np.minimum(np.cumsum(burnt @ np.array([b, b_r]) - work, axis=1).min(axis=1), 0.0)
        return found

    def _held(self, rng: np.random.Generator, moved: Ways) -> Array:
        """The joint torques in each substep."""
        q, ticks = moved.q, moved.acts.shape[1]
        samples, L = q[:, :-1:SUBSTEPS], self.of.length
        rows = np.arange(len(q))[:, None]
        J = self.of.jacobian(q[rows, np.arange(ticks) * SUBSTEPS + moved.reads])
        R, tips = self.of.place(samples)
        motors = np.empty((len(q), ticks, 6))
        for i in range(len(q)):
            spring = OrientationSpring(self.turning, most=L * self.most * math.sqrt(0.5), at=quaternion(R[i, 0]))
            at, account = tips[i, 0], 0.0
            jumps = 10.0 ** rng.uniform(-3.0, 0.0)
            kind = rng.integers(0, 3)
            for k in range(ticks):
                here, x = quaternion(R[i, k]), tips[i, k]
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
        begun = np.arange(SUBSTEPS)[None, None, :] >= moved.acts[:, :, None]
        return np.where(begun[..., None], motors[:, :, None], before[:, :, None]).reshape(len(q), -1, 6)


def _moved(K: float, x: Array, at: Array, step: Array, account: float) -> tuple[Array, float]:
    """The proxy of a place after the part of its step that the account allows, and the account."""
    part = 1.0
    for _ in range(40):
        gain = K * float((x - at - part * step) @ (part * step))
        if account + gain >= 0.0:
            return at + part * step, account + gain
        part *= 0.5
    return at, account


def quaternion(R: Array) -> Quaternion:
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
