"""A small scene of its own whose bodies turn, solved tick by tick: docs/decisions/0055-bodies-that-turn.md.

Each body is a set of balls with masses, rigidly joined. Its centre moves by s and it turns by the Cayley map of W in a
tick. Balls touch six walls and the balls of other bodies, with friction. Forces are those of the tick's end, and their
arms the mean of those at both ends. A tick is solved by Newton's method with the arms of the iterate at hand, so that
each round solves one symmetric positive definite system, as a scene's does now.

It has the interface of :class:`manyhands.nodes.environment.model.Engine`, with avatars that turn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tests.support.turning_bodies import axial, cayley, cross_matrix

Array = NDArray[np.float64]

HALF_ROOM: Final = 0.1
"""m, from the middle to each wall."""

MOST_ROUNDS: Final = 40
ENOUGH: Final = 1e-12
"""m and rad: the last step of a tick's solution."""


@dataclass(frozen=True)
class Balls:
    """A rigid body.

    Attributes:
        start: its centre of mass, m.
        at: the balls' centres from there, m; with their masses they have their centre of mass at 0.
        radius: of each ball, m.
        mass: of each, kg.
        drag: N*s/m, against its motion.
        spin_drag: N*m*s/rad, against its turning.
    """

    start: Sequence[float]
    at: Sequence[Sequence[float]]
    radius: float
    mass: Sequence[float]
    drag: float = 0.0
    spin_drag: float = 0.0


class TurningScene:
    """The scene.

    Attributes:
        energy: what is stored after the last tick, J.
        came: what came in during the last tick by outside forces and torques, J.
        missing: the work of what the last tick's solution left of the equations, J.
        touching: the pairs that pressed in the last tick.
        rounds: of Newton's method, in all ticks.
        unfinished: ticks that it did not solve.
        ticks: how many there were.
        most_turned: the greatest turn of a body in a tick, rad.
    """

    def __init__(
        self,
        bodies: Sequence[Balls],
        T: float,
        stiffness: float,
        damping: float,
        friction: float,
        avatars: int = 0,
        springs: tuple[float, float] | None = None,
        gravity: Sequence[float] = (0.0, 0.0, 0.0),
        share: float = 0.5,
    ) -> None:
        """Begin at rest and upright.

        Args:
            bodies: the avatars first.
            T: period, s.
            stiffness: of every contact, N/m.
            damping: of every contact, N*s/m.
            friction: mu.
            avatars: how many of the bodies are.
            springs: of avatars, N/m and N*m/rad, where their forces are those of the tick's end: the first from where
                the tool would be without any force, the second to the hand's orientation. None for the forces and
                torques that the engine is told, held for the tick.
            gravity: m/s^2.
            share: of the tick's end in the arms; the theorem is on 1/2.
        """
        self._share_of_end = share
        count = self._count = len(bodies)
        self._T, self._k, self._b, self._mu, self._avatars = T, stiffness, damping, friction, avatars
        self._gravity = np.array(gravity)
        self._start = np.array([body.start for body in bodies])
        self._c, self._R = self._start.copy(), np.broadcast_to(np.eye(3), (count, 3, 3)).copy()
        self._way, self._chord = np.zeros((count, 3)), np.zeros((count, 3, 3))
        self._turn = self._R.copy()
        self._mass = np.array([sum(body.mass) for body in bodies])
        self._drag = np.array([body.drag for body in bodies]) / T
        self._spin_drag = np.array([body.spin_drag for body in bodies]) / T
        self._second = np.array(
            [
                sum(
                    m * (np.outer(a, a) + body.radius**2 / 5.0 * np.eye(3))
                    for a, m in zip(body.at, body.mass, strict=True)
                )
                for body in bodies
            ]
        )
        balls = [(i, at, body.radius) for i, body in enumerate(bodies) for at in body.at]
        owner, at, radius = (np.array(column) for column in zip(*balls, strict=True))
        walls = [(ball, axis, sign) for ball in range(len(balls)) for axis in range(3) for sign in (1.0, -1.0)]
        pairs = [(i, j) for i in range(len(balls)) for j in range(i) if owner[i] != owner[j]]
        # the world is one more thing, which rests
        self._i = np.array([owner[ball] for ball, *_ in walls] + [owner[i] for i, _ in pairs])
        self._j = np.array([count] * len(walls) + [owner[j] for _, j in pairs])
        self._p = np.array([at[ball] for ball, *_ in walls] + [at[i] for i, _ in pairs])
        self._q = np.array([np.zeros(3)] * len(walls) + [at[j] for _, j in pairs])
        self._radii = np.array(
            [radius[ball] - HALF_ROOM for ball, *_ in walls] + [radius[i] + radius[j] for i, j in pairs]
        )
        self._share = np.array([radius[ball] for ball, *_ in walls] + [radius[i] for i, _ in pairs])
        self._walls = len(walls)
        self._n = np.array([-sign * np.eye(3)[axis] for _, axis, sign in walls] + [np.zeros(3) for _ in pairs])
        self._bristles = np.zeros((len(self._i), 3))
        self._normal = np.zeros(len(self._i))
        self._push, self._twist = np.zeros((count, 3)), np.zeros((count, 3))
        self._springs = springs
        self._pull, self._lead = np.zeros((count, 1)), np.zeros((count, 1))  # N/m, N*m/rad
        self._aim, self._hand = self._c.copy(), self._R.copy()
        self.came = self.missing = self.most_turned = 0.0
        self.touching = self.rounds = self.unfinished = self.ticks = 0
        self.energy = self._energy(self._gaps()[0], self._bristles)

    def _points(self, c: Array, R: Array) -> Array:
        """p - q of each pair."""
        c, R = np.concatenate([c, np.zeros((1, 3))]), np.concatenate([R, np.eye(3)[None]])
        found: Array = (
            c[self._i] + np.einsum("nij,nj->ni", R[self._i], self._p)
            - c[self._j] - np.einsum("nij,nj->ni", R[self._j], self._q)
        )  # fmt: skip
        return found

    def _gaps(self) -> tuple[Array, Array, Array]:
        """Each pair's gap, its normal, and p - q."""
        apart = self._points(self._c, self._R)
        n, gaps = self._n.copy(), np.empty(len(apart))
        gaps[: self._walls] = (n[: self._walls] * apart[: self._walls]).sum(axis=1)
        far = np.sqrt((apart[self._walls :] ** 2).sum(axis=1))
        n[self._walls :] = apart[self._walls :] / np.maximum(far, 1e-300)[:, None]
        gaps[self._walls :] = far
        return gaps - self._radii, n, apart

    def _energy(self, gaps: Array, bristles: Array) -> float:
        kinetic = (self._mass * (self._way**2).sum(axis=1)).sum() + ((self._chord @ self._second) * self._chord).sum()
        deep = np.maximum(0.0, -gaps)
        height = -(self._mass * (self._c @ self._gravity)).sum()
        return float(kinetic / self._T**2 / 2.0 + height + self._k / 2.0 * ((deep**2).sum() + (bristles**2).sum()))

    def push(self, forces: Array) -> None:
        """Push the bodies by these forces in the next tick, N, (bodies, 3)."""
        self._push = np.array(forces)

    def twist(self, torques: Array) -> None:
        """Likewise turn all bodies, N*m."""
        self._twist = np.array(torques)

    def tick(self) -> None:
        """Solve one tick, and take it."""
        T, count, k = self._T, self._count, self._k
        gap, n, _ = self._gaps()
        reach = 8.0 * float(np.abs(self._way).max() + 0.1 * np.abs(self._chord).max()) + 2e-3
        near = np.flatnonzero(gap < reach)
        i, j, n, gap = self._i[near], self._j[near], n[near], gap[near]
        deep = np.maximum(0.0, -gap)
        across = np.eye(3) - n[:, :, None] * n[:, None, :]
        old = np.einsum("nij,nj->ni", across, self._bristles[near])
        most = self._mu * self._normal[near]
        centre = np.concatenate([self._c, np.zeros((1, 3))])
        upright = np.concatenate([self._R, np.eye(3)[None]])
        p, q = self._p[near], self._q[near]
        # friction acts on the points of both that are at the contact when the tick begins
        place = centre[i] + np.einsum("nij,nj->ni", upright[i], p) - self._share[near, None] * n
        mine = np.einsum("nji,nj->ni", upright[i], place - centre[i])
        others = np.einsum("nji,nj->ni", upright[j], place - centre[j])
        past = self._turn @ self._chord
        weight = self._mass[:, None] * self._gravity
        s, W = self._way.copy(), 2.0 * axial(np.swapaxes(self._turn, 1, 2))
        W /= (1.0 + np.trace(self._turn, axis1=1, axis2=2))[:, None]
        rows = np.arange(len(near))

        def jacobian(arms: Array, a: Array, b: Array) -> Array:
            """The motion of p - q along x, y and z by s and W, with the mean arms of both: pairs x 3 x unknowns."""
            found = np.zeros((len(near), 3, 2 * (count + 1), 3))
            found[rows, :, 2 * i] += np.eye(3)
            found[rows, :, 2 * j] -= np.eye(3)
            found[rows, :, 2 * i + 1] -= cross_matrix(np.einsum("nij,nj->ni", arms[i], a))
            found[rows, :, 2 * j + 1] += cross_matrix(np.einsum("nij,nj->ni", arms[j], b))
            return found[:, :, : 2 * count].reshape(len(near), 3, 6 * count)

        u = np.stack([s, W], axis=1).ravel()
        last, done = np.inf, False
        for round_ in range(MOST_ROUNDS + 1):
            s, W = u.reshape(count, 2, 3)[:, 0], u.reshape(count, 2, 3)[:, 1]
            turn = cayley(W)
            R = turn @ self._R
            share = self._share_of_end
            arms = np.concatenate([share * R + (1.0 - share) * self._R, np.eye(3)[None]])
            G, A = jacobian(arms, p, q), jacobian(arms, mine, others)
            along = np.einsum("ni,nij->nj", n, G)
            end = gap + along @ u
            felt = np.maximum(0.0, -k * end - self._b * (end + deep) / T)
            trial = old + np.einsum("nij,nj->ni", across, A @ u)
            size = np.sqrt((trial**2).sum(axis=1))
            part = np.minimum(1.0, most / np.maximum(k * size, 1e-300))
            bent = trial * part[:, None]
            moment = arms[:count] @ self._second
            spun = axial(moment @ np.swapaxes(R - self._R - past, 1, 2)) / T**2
            momentum = axial(moment @ np.swapaxes(past, 1, 2)) / T**2
            lacks = np.empty((count, 2, 3))
            lacks[:, 0] = self._mass[:, None] * (s - self._way) / T**2 + self._drag[:, None] * s - weight - self._push
            lacks[:, 0] += self._pull * (self._c + s - self._aim)
            lacks[:, 1] = spun + np.cross(W, momentum) + self._spin_drag[:, None] * W - self._twist
            # the chordal spring is a linear one between the matrices
            lacks[:, 1] += self._lead / 2.0 * axial(arms[:count] @ np.swapaxes(R - self._hand, 1, 2))
            lacking = lacks.ravel() - along.T @ felt + k * np.einsum("nij,ni->j", A, bent)
            if done or round_ == MOST_ROUNDS:
                break
            H = np.zeros((6 * count, 6 * count))
            spread = moment @ np.swapaxes(arms[:count], 1, 2)
            J = np.trace(spread, axis1=1, axis2=2)[:, None, None] * np.eye(3) - spread
            for body in range(count):
                at = 6 * body
                H[at : at + 3, at : at + 3] = (self._mass[body] / T**2 + self._drag[body] + self._pull[body]) * np.eye(
                    3
                )
                H[at + 3 : at + 6, at + 3 : at + 6] = (
                    J[body] / T**2
                    - cross_matrix(momentum[body])
                    + (self._spin_drag[body] + self._lead[body]) * np.eye(3)
                )
            firm = (k + self._b / T) * (felt > 0.0)
            H += along.T @ (firm[:, None] * along)
            rub = np.matmul(across, A)
            H += np.einsum("nij,nik->jk", rub * (k * part)[:, None, None], rub)
            step = np.linalg.solve(H, -lacking)
            size_ = float(np.abs(step).max())
            u = u + step * (0.5 if size_ > 0.9 * last and round_ > 8 else 1.0)
            last, done = size_, size_ <= ENOUGH
            self.rounds += 1
        self.unfinished += not done
        self._normal, self._bristles = np.zeros(len(self._i)), np.zeros((len(self._i), 3))
        self._normal[near], self._bristles[near] = felt, bent
        self.touching = int(np.count_nonzero(felt))
        after = self._c + s
        led = (
            self._pull * (self._aim - after),
            axial(arms[:count] @ np.swapaxes(self._hand - R, 1, 2)) * self._lead / 2.0,
        )
        self.came = float((led[0] * s).sum() + (led[1] * W).sum())
        self.came += float((self._push * s).sum() + (self._twist * W).sum())
        self.missing = float(lacking @ u)
        self.most_turned = max(self.most_turned, float(2.0 * np.arctan(np.sqrt((W**2).sum(axis=1)).max() / 2.0)))
        self._way, self._chord, self._turn = s.copy(), R - self._R, turn
        self._c, self._R = self._c + s, _orthogonal(R)
        self.energy = self._energy(self._gaps()[0], self._bristles)
        self.ticks += 1

    # the interface of an engine

    def turn(self, torques: Array) -> None:
        """Turn the avatars in the next step by these torques, k sin(theta) u of the springs to their hands, N*m."""
        t = np.reshape(torques, (-1, 3))
        if self._springs is None:
            self._twist[: self._avatars] = t
            return
        # up to a quarter turn, beyond which a hand follows, the torque tells where the hand is
        sine = np.minimum(1.0, np.sqrt((t**2).sum(axis=1)) / self._springs[1])
        tangent = 2.0 * np.tan(np.arcsin(sine) / 2.0) / np.maximum(sine * self._springs[1], 1e-300)
        self._hand[: self._avatars] = cayley(t * tangent[:, None]) @ self._R[: self._avatars]
        self._lead[: self._avatars, 0] = self._springs[1] * (sine > 0.0)

    def step(self, x: Array, f: Array) -> Array:
        """One tick with the avatars led by their tools; where they are then."""
        if self._springs is None:
            self._push[: self._avatars] = -np.reshape(f, (-1, 3))
        else:
            self._aim[: self._avatars] = self._start[: self._avatars] + np.reshape(x, (-1, 3))
            self._pull[: self._avatars] = self._springs[0]
        self.tick()
        return (self._c - self._start)[: self._avatars].ravel()

    def avatars(self) -> list[float]:
        """The avatars' orientations, as quaternions."""
        return [number for R in self._R[: self._avatars] for number in quaternion(R)]

    def positions(self) -> list[float]:
        """Where the first body is that is no avatar, m."""
        found: list[float] = self._c[self._avatars].tolist()
        return found


def _orthogonal(R: Array) -> Array:
    """R without what rounding has added: one step of Newton's method for the nearest rotation."""
    return np.asarray(R @ (3.0 * np.eye(3) - np.swapaxes(R, 1, 2) @ R) / 2.0)


def quaternion(R: Array) -> list[float]:
    """The unit quaternion of a rotation, by its greatest component."""
    squares = [1.0 + float(R.trace()), *(1.0 + 2.0 * float(R[a, a]) - float(R.trace()) for a in range(3))]
    greatest = int(np.argmax(squares))
    v = axial(R.T).tolist()  # 4 w times the imaginary parts
    if greatest == 0:
        found = [squares[0], *v]
    else:
        a = greatest - 1
        found = [v[a], *(float(R[a, other] + R[other, a]) for other in range(3))]
        found[greatest] = squares[greatest]
    return [part / float(np.linalg.norm(found)) for part in found]
