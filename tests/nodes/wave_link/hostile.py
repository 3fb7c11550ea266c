"""Two faces of a wave link between hostile parties, over a network that delivers what it likes.

The account is kept here a second time, from the signals at the two ports alone. So it shares nothing with the tanks
that it judges, except what is looked up in them for the equality of Theorem 1.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from manyhands.nodes.wave_link import Sums, UserFace, WorldFace

Vector = np.ndarray


def impedance(rng: np.random.Generator, m: int) -> Vector:
    """A symmetric, positive definite matrix with couplings between the ports, N*s/m."""
    Q = rng.normal(size=(m, m))
    b = Q @ Q.T * 10.0 ** rng.uniform(-1, 1) + 10.0 ** rng.uniform(-1, 1.5) * np.eye(m)
    return (b + b.T) / 2.0


@dataclass
class HostileLine:
    """A link under test, every message that was ever sent, and the energy that entered at the two ports.

    Attributes:
        supplied: sum of -f_c^T (x_c(k) - x_c(k-1)) and f_e^T (x_e(k) - x_e(k-1)), J.
        harvest: sum of T w^T theta w at both ports, J.
        lost: energy of dead tanks, and of what was in transit when a life ended, J.
        moved: sum of the absolute values of all of that, J; rounding is a small part of it.
    """

    seed: int
    m: int
    E_0: float
    harvests: bool
    supplied: float = 0.0
    harvest: float = 0.0
    lost: float = 0.0
    moved: float = 0.0
    life: int = 0
    sent: list[list[Sums]] = field(default_factory=lambda: [[], []])

    def __post_init__(self) -> None:
        self.rng = rng = np.random.default_rng(self.seed)
        m = self.m
        self.b = impedance(rng, m)
        self.T = (1e-3 * 2.0 ** rng.uniform(-2, 1), 1e-3 * 2.0 ** rng.uniform(-2, 1))
        self.D_V = self.feedthrough()
        self.theta = [impedance(rng, m) * 0.05 if self.harvests else None for _ in range(2)]
        self.depth = [float(rng.uniform(0, 10)), float(rng.uniform(0, 10))]
        self.smoothing = [None, float(rng.uniform(1, 20))]
        self.user, self.world = self.new_user(self.E_0), self.new_world(self.E_0)
        self.x_c: Vector | None = None
        self.x_e, self.f_c, self.f_e = np.zeros(m), np.zeros(m), np.zeros(m)

    def feedthrough(self) -> Vector:
        """D_V of some coupling, m/N."""
        D = self.rng.normal(size=(self.m, self.m))
        return 1e-6 * 10.0 ** self.rng.uniform(-1, 3) * (D @ D.T + 0.1 * np.eye(self.m))

    def new_user(self, E_0: float) -> UserFace:
        return UserFace(
            self.b, self.D_V, *self.T, self.depth[0], E_0=E_0, theta=self.theta[0], smoothing=self.smoothing[0],
            life=self.life,
        )  # fmt: skip

    def new_world(self, E_0: float) -> WorldFace:
        return WorldFace(
            self.b, *self.T[::-1], self.depth[1], E_0=E_0, theta=self.theta[1], smoothing=self.smoothing[1],
            life=self.life,
        )  # fmt: skip

    @property
    def faces(self) -> tuple[UserFace, WorldFace]:
        return self.user, self.world

    @property
    def transit(self) -> float:
        """Energy that was shipped in this life and not heard yet, J."""
        user, world = self.user.tank, self.world.tank
        return (user.shipped - world.heard) + (world.shipped - user.heard)

    @property
    def ledger(self) -> float:
        """The left side of Theorem 1, J."""
        return self.supplied + self.harvest

    @property
    def rounding(self) -> float:
        return 1e-10 * (self.moved + self.E_0) + 1e-15

    def enter(self, g: Vector, motion: Vector, site: int, harvests: bool = True) -> None:
        """Book the energy of the force ``g`` on the link along ``motion``, J."""
        energy = float(g @ motion)
        theta = self.theta[site]
        harvest = 0.0 if theta is None or not harvests else float(motion @ theta @ motion) / self.T[site]
        self.supplied += energy
        self.harvest += harvest
        self.moved += float(np.abs(g) @ np.abs(motion)) + harvest

    def size(self, scale: float) -> float:
        """A hostile amplitude: mostly moderate, at times far from it, at times nothing."""
        return scale * float(self.rng.choice([0.0, 1.0, 1.0, 1.0, 100.0]))

    def tick_user(self) -> None:
        """One tick at the user: p at random, or along the last force, where motion takes energy out."""
        rng, T = self.rng, self.T[0]
        at = np.zeros(self.m) if self.x_c is None else self.x_c
        kind = rng.integers(0, 4)
        if kind == 0:
            p = at + self.size(1e-3) * rng.normal(size=self.m)
        elif kind == 1:
            p = at + self.size(1e-5) * self.f_c
        elif kind == 2:
            p = at
        else:
            p = at + self.size(0.1 * T) * rng.normal(size=self.m)
        self.f_c = f = np.array(self.user.step(p.tolist()))
        x = p + self.D_V @ f
        # a free face has no force, and leaves the harvest
        self.enter(-f, x - (p if self.x_c is None else self.x_c), 0, not self.user.free)
        self.x_c = x
        self.sent[0].append(self.user.message())

    def tick_world(self) -> None:
        """One tick at the world: f at random, or against the tool's motion with no regard to any model."""
        rng = self.rng
        aligned = self.world.aligned
        p = np.array(self.world.tool())
        if not aligned and self.world.aligned:
            self.x_e = np.array(self.world.x)  # the face has taken its place; nothing has moved
        kind = rng.integers(0, 4)
        if kind == 0:
            f = self.size(5.0) * rng.normal(size=self.m)
        elif kind == 1:
            f = -self.size(0.5) * self.b @ (p - self.x_e) / self.T[1]
        elif kind == 2:
            f = np.zeros(self.m)
        else:
            f = 2.0 * self.f_e
            f *= min(1.0, 1e3 / (np.linalg.norm(f) + 1e-300))
        harvests = bool(rng.random() < 0.8)
        self.f_e = f
        self.world.step(f.tolist(), harvests)
        x = p + self.world.D_V @ f
        self.enter(f, x - self.x_e, 1, harvests)
        self.x_e = x
        if self.world.aligned:
            self.sent[1].append(self.world.message())

    def skip(self, site: int) -> None:
        """The process of ``site`` does not run for a while: nothing moves, and no energy passes."""
        face = self.faces[site]
        face.skip(int(self.rng.choice([1, 2, 5, 400])))
        if self.rng.random() < 0.5:
            self.sent[site].append(face.message())

    def deliver(self, site: int) -> None:
        """Any messages of the past come to ``site``, in any order, any number of times; most often the recent ones."""
        flown = self.sent[1 - site]
        if not flown:
            return
        for _ in range(int(self.rng.integers(0, 4))):
            recent = self.rng.random() < 0.7
            back = int(self.rng.integers(0, min(len(flown), 8 if recent else len(flown))))
            wave = flown[-1 - back]
            self.faces[site].hear(wave.n, wave.U, wave.G, wave.life)

    def die(self, site: int) -> None:
        """The process of ``site`` dies, and a successor without energy takes its place, in a new life."""
        self.lost += self.transit + self.faces[site].tank.level
        self.life += 1
        if site == 0:
            self.user, self.x_c = self.new_user(0.0), None
            self.world.renew(self.life)
        else:
            self.world, self.x_e = self.new_world(0.0), np.zeros(self.m)
            self.user.renew(self.life)
