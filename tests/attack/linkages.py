"""Hands that know the linkage: motions of a planar arm whose motors hold torques, and a search for one that pays.

A motion repeats after N ticks. In each of M parts of a tick the tip goes straight and evenly from one place to the
next. Samples are taken at the ticks, and the periodic forces of the linear loop of coupling V and world E follow from
their responses. A force k becomes the torques J(q_r)^T f(k), r a place between its sample and the place at which it
acts, and these are held until the next ones. So a cycle gives the hand exactly

    sum over holds of  tau^T (q_next - q)   less what the mechanism burns,  sum of  dx^T Delta_D dx / h.

Where that is above 0, every further cycle pays again, and the claim is false. Nothing of the product is used but the
certificate's plain data: kinematics and kappa are computed here, in another way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from tests.attack.arithmetic import Floats
from tests.attack.parties import Data, NoSystem, Reader, Realisation

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Arm:
    """Two links in a plane; both motors at the base or in the joints, with angles relative to the link before.

    Attributes:
        upper, lower: lengths, m.
        least, most: of the second angle, rad, within 0 ... pi.
    """

    upper: float
    lower: float
    least: float
    most: float

    def tip(self, q: Array) -> Array:
        """Position of the tip, m, for angles in the last axis."""
        a, b = q[..., 0], q[..., 0] + q[..., 1]
        return np.stack(
            [self.upper * np.cos(a) + self.lower * np.cos(b), self.upper * np.sin(a) + self.lower * np.sin(b)], -1
        )

    def angles(self, x: Array) -> Array:
        """The pose with a positive second angle, rad; NaN out of reach."""
        with np.errstate(invalid="ignore"):
            cosine = (np.sum(x**2, -1) - self.upper**2 - self.lower**2) / (2.0 * self.upper * self.lower)
            second = np.arccos(cosine)
        first = np.arctan2(x[..., 1], x[..., 0])
        first = first - np.arctan2(self.lower * np.sin(second), self.upper + self.lower * np.cos(second))
        return np.stack([first, second], -1)

    def jacobian(self, q: Array) -> Array:
        """dx/dq, m/rad."""
        a, b = q[..., 0], q[..., 0] + q[..., 1]
        far = np.stack([-self.lower * np.sin(b), self.lower * np.cos(b)], -1)
        near = far + np.stack([-self.upper * np.sin(a), self.upper * np.cos(a)], -1)
        return np.stack([near, far], -1)

    def bending(self, second: float, direction: Array) -> Array:
        """The tip's acceleration at unit speed along ``direction`` with joints that do not accelerate, 1/m.

        The links turn at w and w' about their ends: the acceleration is -w^2 times each link's vector.
        """
        q = np.array([0.0, second])
        speeds = np.linalg.solve(self.jacobian(q), direction.T).T
        w, both = speeds[..., :1], speeds[..., :1] + speeds[..., 1:]
        first = self.upper * np.array([1.0, 0.0])
        last = self.lower * np.array([np.cos(second), np.sin(second)])
        return np.asarray(-(w**2) * first - both**2 * last)

    def worst(self) -> tuple[float, float, Array, Array]:
        """kappa (1/m), and where it is: the second angle, the direction of motion and that of the acceleration."""
        seconds = np.linspace(self.least, self.most, 60)
        angles = np.linspace(0.0, np.pi, 180, endpoint=False)
        v = np.stack([np.cos(angles), np.sin(angles)], -1)
        s = np.stack([self.bending(float(second), v) for second in seconds])
        sizes = np.sqrt(np.sum(s**2, -1))
        i, j = np.unravel_index(int(np.argmax(sizes)), sizes.shape)
        return float(sizes[i, j]), float(seconds[i]), v[j], s[i, j] / sizes[i, j]


@dataclass(frozen=True)
class Timing:
    """When the forces of a cycle act, and of which pose their torques are.

    Attributes:
        parts: M, of a tick.
        acts: by tick, how many parts after its sample the force acts.
        read: by tick, how many parts after its sample the joints are read; negative is before it.
    """

    parts: int
    acts: tuple[int, ...]
    read: tuple[int, ...]

    @property
    def ticks(self) -> int:
        """N."""
        return len(self.acts)


class Cycle:
    """What a cycle of a motion gives, for one device that holds torques; all ports of the certificate are its own."""

    def __init__(self, data: Data, arm: Arm, home: Array, timing: Timing) -> None:
        """Of the tip's displacements from the pose ``home``.

        Raises:
            ArithmeticError: the loop has no periodic forces.
        """
        [device] = data["devices"].values()
        self.arm, self.home, self.timing = arm, arm.tip(home), timing
        self.force, self.speed = device["held"]["force"], device["held"]["speed"]
        self.damping = np.array(device["osp"], dtype=float)
        self.h = data["period"] / timing.parts
        reader = Reader(data, Floats())
        self.responses = [
            _forces(reader, np.exp(2j * np.pi * k / timing.ticks)) for k in range(timing.ticks)
        ]  # fmt: skip
        starts = np.arange(timing.ticks) * timing.parts
        self._acts = starts + np.array(timing.acts)
        self._read = (starts + np.array(timing.read)) % (timing.ticks * timing.parts)

    def scaled(self, motion: Array) -> Array:
        """The motion, smaller where it would be too fast or ask too much force; motions are ... x N M x 2."""
        step = np.roll(motion, -1, -2) - motion
        fastest = np.sqrt(np.sum(step**2, -1)).max(-1) / self.h
        strongest = np.sqrt(np.sum(self.forces(motion) ** 2, -1)).max(-1)
        size = np.minimum(self.speed / np.maximum(fastest, 1e-300), self.force / np.maximum(strongest, 1e-300))
        return np.asarray(motion * np.minimum(1.0, size)[..., None, None])

    def forces(self, motion: Array) -> Array:
        """The force of each tick, N."""
        spectrum = np.fft.fft(motion[..., :: self.timing.parts, :], axis=-2)
        out = np.einsum("kij,...kj->...ki", np.array(self.responses), spectrum)
        return np.asarray(np.fft.ifft(out, axis=-2).real)

    def ratio(self, motion: Array) -> Array:
        """What the torques give over what the mechanism burns, above 1 where a cycle pays; 0 outside the arm's box."""
        motion = self.scaled(motion)
        q = self.arm.angles(self.home + motion)
        J = self.arm.jacobian(q[..., self._read, :])
        torques = np.einsum("...kij,...ki->...kj", J, self.forces(motion))
        ends = np.concatenate([self._acts[1:], self._acts[:1] + motion.shape[-2]]) % motion.shape[-2]
        begins = self._acts % motion.shape[-2]
        given = np.sum(torques * (q[..., ends, :] - q[..., begins, :]), (-1, -2))
        step = np.roll(motion, -1, -2) - motion
        burnt = np.einsum("...ji,ik,...jk->...", step, self.damping, step) / self.h
        inside = (q[..., 1] >= self.arm.least).all(-1) & (q[..., 1] <= self.arm.most).all(-1)
        with np.errstate(invalid="ignore"):
            return np.where(inside & (burnt > 0.0), given / np.maximum(burnt, 1e-300), 0.0)


def _forces(reader: Reader, z: complex) -> Any:
    """f = -(I + E V)^-1 E x at one point of the unit circle, N/m."""
    V, E = (_response(system, z) for system in (reader.coupling, reader.environment))
    return -np.linalg.solve(np.eye(len(V)) + E @ V, E)


def _response(system: Realisation, z: complex) -> Any:
    A, B, C, D = system
    return C @ np.linalg.lstsq(z * np.eye(len(A)) - A, B, rcond=None)[0] + D if len(A) else D + 0.0j


def searched(data: Data, arm: Arm, timing: Timing, rng: np.random.Generator, steps: int = 30) -> tuple[float, int]:
    """The greatest ratio that a search among motions finds, and how many motions it looked at.

    It begins where the theory is sharpest: at the pose of kappa, under the greatest force along the acceleration
    there, with a dither along the direction of motion. The best of these beginnings is improved.
    """
    _, second, along, towards = arm.worst()
    room = min(2e-3, 0.1 * (arm.most - arm.least))  # for the motion
    nudge = float(np.clip(second, arm.least + room, arm.most - room))
    looked, number = 0, timing.ticks * timing.parts
    waves = {number} if timing.ticks % 2 else {number, 2 * timing.parts}  # parts of a period: all, or two ticks
    best: tuple[float, Cycle | None, Array] = 0.0, None, np.zeros(0)
    for sign, long in product((1.0, -1.0), sorted(waves)):
        cycle = Cycle(data, arm, np.array([0.0, nudge]), timing)
        static = cycle.responses[0].real
        if not np.all(np.isfinite(static)) or np.linalg.cond(static) > 1e9:
            static = -np.eye(2)
        offset = np.linalg.solve(static, sign * 0.999 * cycle.force * towards)
        cycle.home = cycle.home - offset  # the pose is to be the worst one with the offset in place
        wave = np.cos(2.0 * np.pi * np.arange(number) / long)
        size = 0.1 * cycle.speed * cycle.h * (1.0 + rng.random())
        start = offset + size * (wave[:, None] * along + 0.05 * rng.normal(size=(number, 2)))
        found, looked = float(cycle.ratio(start)), looked + 1
        if best[1] is None or found > best[0]:
            best = found, cycle, start
    value, cycle, start = best
    if cycle is None or not steps:
        return value, looked

    def negative(micrometres: Array) -> tuple[float, Array]:
        nonlocal looked
        step = 0.1
        shifts = np.concatenate([np.zeros((1, 2 * number)), step * np.eye(2 * number)])
        found = cycle.ratio(1e-6 * (micrometres + shifts).reshape(-1, number, 2))
        looked += len(found)
        return -float(found[0]), -(found[1:] - found[0]) / step

    result = minimize(negative, 1e6 * start.ravel(), jac=True, method="L-BFGS-B", options={"maxiter": steps})
    return max(value, -float(result.fun)), looked


def pays(data: Data, rng: np.random.Generator, steps: int) -> tuple[float, int]:
    """As :func:`searched`, for a certificate with the kinematics of a planar arm, and a timing that it covers."""
    [device] = data["devices"].values()
    linkage = device["held"]["linkage"]
    arm = Arm(linkage["links"][0][0], linkage["links"][1][0], linkage["low"][1], linkage["high"][1])
    every = timings(data, rng)
    try:
        return searched(data, arm, every[int(rng.integers(len(every)))], rng, steps)
    except (ArithmeticError, NoSystem, np.linalg.LinAlgError):
        return 0.0, 0


def timings(data: Data, rng: np.random.Generator) -> Sequence[Timing]:
    """Cycles of two to twelve ticks, with forces that act as late as the certificate covers, or anywhere before."""
    out = []
    for ticks in (2, 3, 4, 12):
        parts = int(rng.integers(2, 5))
        latest = int(np.floor(parts * data["tau"] / data["period"] + 1e-9))
        acts = tuple(int(rng.choice([0, latest, rng.integers(latest + 1)])) for _ in range(ticks))
        read = tuple(int(rng.integers(act + 1)) if rng.random() < 0.5 else 0 for act in acts)
        out.append(Timing(parts, acts, read))
    return out
