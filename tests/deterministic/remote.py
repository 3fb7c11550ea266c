"""Example 1 with remote users, in one process and in simulated time: the product's cores over a simulated network.

Every site has its own clock and period. A remote user's device, coupling and face are stepped at the user's ticks, the
environment and the world's faces at its own, and what they send travels over :mod:`tests.deterministic.network`. Users
that are not remote are in the environment's tick, as in the paper.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from manyhands.design.models.coupling import SpringDamper
from manyhands.design.models.device import HeldDevice, zero_order_hold
from manyhands.design.models.network import Network, NetworkLink
from manyhands.design.models.statespace import StateSpace
from manyhands.nodes.coupling.core import CouplingCore
from manyhands.nodes.environment.core import EnvironmentCore
from manyhands.nodes.kernel.arithmetic import Floats, LinearMap, linear_map
from manyhands.nodes.wave_link import UserFace, WorldFace

from .network import Channel, Path

T = 1e-3
"""The environment's period, s."""

DELTA = 1.37
"""Delta_D of each device, N*s/m."""

DIVERGED = 10.0
"""The speed of a device beyond which a run ends, m/s."""

Force = Callable[[float], float]


def pulse(force: float, begin: float, end: float) -> Force:
    """A hand's intended force, N, by the time in s."""
    return lambda t: force if begin <= t < end else 0.0


EXAMPLE_1: tuple[Force, Force, Force] = (pulse(2.0, 0.1, 0.2), pulse(-1.5, 0.15, 0.25), pulse(1.0, 0.2, 0.35))


class UserEnd(Protocol):
    """What a scheme does in a remote user's process."""

    def hear(self, *message: Any) -> object: ...
    def step(self, p: Floats) -> Floats: ...
    def message(self) -> Any: ...


class WorldEnd(Protocol):
    """What a scheme does in the environment's process."""

    D_V: np.ndarray

    def hear(self, *message: Any) -> object: ...
    def tool(self) -> Floats: ...
    def step(self, f: Floats) -> None: ...
    def message(self) -> Any: ...


@dataclass(frozen=True)
class Remote:
    """How one user is remote.

    Attributes:
        up: the way to the environment.
        down: the way back.
        period: the user's period by its own clock, s.
        ppm: how much longer a second of its clock is, millionths.
        delay: from a sample of the device to the force that answers it, s.
        ends: makes both ends; it is given the user's period and the coupling's D_V.
        theta: what both ends may harvest, N*s/m.
    """

    up: Path
    down: Path
    ends: Callable[[float, np.ndarray], tuple[Any, Any]]
    period: float = T
    ppm: float = 0.0
    delay: float = 0.0
    theta: tuple[float, float] = (0.0, 0.0)


def waves(b: float, depth: float = 2.0, **options: Any) -> Callable[[float, np.ndarray], tuple[UserFace, WorldFace]]:
    """Both faces of a wave link of one port; options as those of the faces, or by ``user`` and ``world`` each."""
    user, world = options.pop("user", {}), options.pop("world", {})
    matrix = np.array([[b]])

    def ends(period: float, D_V: np.ndarray) -> tuple[UserFace, WorldFace]:
        return (
            UserFace(matrix, D_V, period, T, depth, **options, **user),
            WorldFace(matrix, T, period, depth * T / period, **options, **world),
        )

    return ends


class Device:
    """A mass with its passive hand, of one axis, exactly sampled, with a force that acts after a delay."""

    def __init__(self, period: float, delay: float, mass: float = 0.2) -> None:
        operator = StateSpace(
            np.array([[-10.3, -100.0], [1.0, 0.0]]),
            np.array([[1.0], [0.0]]),
            0.02 * np.array([[49.7, 900.0]]),
            np.array([[0.02]]),
        )
        zero = np.zeros(1)
        held = HeldDevice(np.array([mass]), np.array([DELTA]), operator, zero, zero).continuous()
        system = StateSpace(held.A, held.B[:, :1], held.C, held.D[:, :1])
        self._steps: list[LinearMap] = []
        for part in (delay, period - delay):
            step = zero_order_hold(system, part)
            self._steps.append(linear_map(np.hstack([step.A, step.B])))
        self._delay = delay
        self.state: Floats = [0.0] * system.order
        self._f = 0.0

    @property
    def x(self) -> float:
        return self.state[0]

    @property
    def v(self) -> float:
        return self.state[1]

    def step(self, f: float, intended: float) -> None:
        """A period with the answer ``f`` of its couplings, which acts after the delay; N."""
        state = self.state
        if self._delay > 0.0:
            state = self._steps[0]([*state, self._f + intended])
        self.state = self._steps[1]([*state, f + intended])
        self._f = f


@dataclass
class Trace:
    """What one remote user's run was, by the user's ticks."""

    t: list[float] = field(default_factory=list)
    x: list[float] = field(default_factory=list)
    v: list[float] = field(default_factory=list)
    f_c: list[float] = field(default_factory=list)
    x_c: list[float] = field(default_factory=list)
    gap: list[float] = field(default_factory=list)


class User:
    """One user: device, coupling, and either its two ends or nothing in between."""

    def __init__(self, remote: Remote | None, V: tuple[float, float], hand: Force, seed: int) -> None:
        period = T if remote is None else remote.period
        block = SpringDamper(np.array([[V[0]]]), np.array([[V[1]]])).realisation(period)
        K = np.array([[period / 2.0 / DELTA]])
        self.block, self.K = block, K
        self.coupling = CouplingCore(block, K, None, period, [1e9])
        self.D_V, self.hand, self.remote = block.D, hand, remote
        self._D = float(block.D[0, 0])
        self.device = Device(period, 0.0 if remote is None else remote.delay)
        self.trace = Trace()
        self.supplied = self.least = 0.0  # energy into the two-port with the harvest, J
        self.x_c = self.x_e = 0.0
        self._begun = False
        if remote is not None:
            self.user, self.world = remote.ends(period, block.D)
            self.up: Channel[Any] = Channel(remote.up, 2 * seed)
            self.down: Channel[Any] = Channel(remote.down, 2 * seed + 1)
            self.real_period = period * (1.0 + 1e-6 * remote.ppm)

    def tick(self, t: float, keep: bool) -> None:
        """A tick of a remote user."""
        for message in self.down.arrived(t):
            self.user.hear(*message)
        direct = getattr(self.user, "direct", False)  # a scheme that is the coupling, too
        p = [self.device.x] if direct else self.coupling.free_position([self.device.x])
        f = self.user.step(p)
        x_c = p[0] if direct else p[0] + self._D * f[0]
        if self._begun:
            self.enter(-f[0] * (x_c - self.x_c), x_c - self.x_c, 0)
        self.x_c, self._begun = x_c, True
        if keep:
            trace = self.trace
            trace.t.append(t)
            trace.x.append(self.device.x)
            trace.v.append(self.device.v)
            trace.f_c.append(f[0])
            trace.x_c.append(x_c)
            trace.gap.append(x_c - self.x_e)
        if (message := self.user.message()) is not None:
            self.up.send(t + 1e-4, message)
        self.coupling.absorb(f)
        self.device.step(f[0], self.hand(t))

    def enter(self, energy: float, moved: float, site: int) -> None:
        """Book the energy at one of the two ports, J, with the harvest that Theorem 1 allows there."""
        assert self.remote is not None
        period = (self.remote.period, T)[site]
        self.supplied += energy + self.remote.theta[site] * moved * moved / period
        self.least = min(self.least, self.supplied)


STIFFNESS = (3800.0, 3500.0, 3300.0)
DAMPING = (0.1, 0.2, 0.3)


def example_1() -> Network:
    """Three ports at one hub."""
    ports = ("dx", "dy", "dz")
    links = [NetworkLink((port, "hub"), k, B) for port, k, B in zip(ports, STIFFNESS, DAMPING, strict=True)]
    return Network(ports, (("hub", 3.0),), (*links, NetworkLink(("hub", "ground"), 2600.0, 0.5)))


class RemoteSession:
    """Example 1 with some of its users remote.

    Attributes:
        users: the three users.
        diverged: when a device was faster than :data:`DIVERGED` first, s; None for never.
    """

    def __init__(
        self,
        remotes: Sequence[Remote | None],
        V: tuple[float, float],
        hands: Sequence[Force] = EXAMPLE_1,
        seed: int = 0,
        network: Network | None = None,
    ) -> None:
        """Everything at rest."""
        self.users = [
            User(remote, V, hand, 10 * seed + i) for i, (remote, hand) in enumerate(zip(remotes, hands, strict=True))
        ]
        D_V = np.diag([float((user.D_V if user.remote is None else user.world.D_V)[0, 0]) for user in self.users])
        self._D = np.diag(D_V).tolist()
        E = (example_1() if network is None else network).environment(T)
        blocks = [[i] for i in range(len(self.users))]
        self.environment = EnvironmentCore(E, D_V, np.zeros((len(blocks), len(blocks))), T, blocks)
        for i, user in enumerate(self.users):
            if user.remote is not None and hasattr(user.world, "aligned"):
                self.environment.clutches.freeze(i)
        self._joining = [hasattr(user.world, "aligned") if user.remote is not None else False for user in self.users]
        self.diverged: float | None = None
        self.t = 0.0

    def run(self, seconds: float, keep: bool = True) -> RemoteSession:
        """Run until ``seconds``, or until a device diverges."""
        tick = round(self.t / T)
        due = [(user.real_period, user) for user in self.users if user.remote is not None]
        counts = [math.ceil((self.t - 0.37 * T) / period) if self.t else 0 for period, _ in due]
        while self.t < seconds and self.diverged is None:
            end = (tick + 1) * T
            self._tick_world(tick * T)
            for i, (period, user) in enumerate(due):
                while (at := 0.37 * T + counts[i] * period) < end:
                    user.tick(at, keep)
                    counts[i] += 1
            if not all(abs(user.device.v) < DIVERGED for user in self.users):
                self.diverged = end
            tick += 1
            self.t = tick * T
        return self

    def restart(self, i: int, life: int) -> None:
        """The coupling's process of user ``i`` has died, and a successor without energy has taken its place."""
        user = self.users[i]
        assert user.remote is not None
        successor, _ = user.remote.ends(user.remote.period, user.D_V)
        successor.tank.level = 0.0
        successor.renew(life)
        user.user, user._begun = successor, False
        user.coupling = CouplingCore(user.block, user.K, None, user.remote.period, [1e9])
        user.world.renew(life)
        self.environment.clutches.freeze(i)
        self._joining[i] = True

    def _tick_world(self, t: float) -> None:
        p: Floats = []
        for user in self.users:
            if user.remote is None:
                p += user.coupling.free_position([user.device.x])
            else:
                for message in user.up.arrived(t):
                    user.world.hear(*message)
                p += user.world.tool()
        for i, user in enumerate(self.users):
            if self._joining[i] and user.world.aligned:
                self._joining[i] = False
                user.x_e = user.world.x[0]
                self.environment.clutches.engage(i)
        f = self.environment.react(p)
        self.environment.settle()
        for i, user in enumerate(self.users):
            if user.remote is None:
                user.coupling.absorb([f[i]])
                user.device.step(f[i], user.hand(t))
            else:
                user.world.step([f[i]])
                x_e = p[i] + self._D[i] * f[i]
                user.enter(f[i] * (x_e - user.x_e), x_e - user.x_e, 1)
                user.x_e = x_e
                message = user.world.message()
                if message is not None and not self._joining[i]:
                    user.down.send(t + 1e-4, message)
