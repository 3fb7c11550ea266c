"""A host's world with two seats behind wave links: an honest user, and a guest who sends any waves it likes.

    python -m tests.deterministic.seats [--runs N] [--seed S] [--seconds S]

Environment, clutches, budgets, wave ends and gates are the product's, as the session's bundles make them; the honest
user's device, coupling and wave end are, too. The guest has an authentic link and sends frames. The seed alone makes a
run happen again. The exit code is 1 if the guest did more than its limits and its budget allow, or changed the honest
user's account.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np
import yaml

from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.session import load_session
from manyhands.nodes.coupling.core import CouplingCore
from manyhands.nodes.environment.core import environment_core
from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.kernel.bundle import REALTIME, CouplingBundle, EnvironmentBundle
from manyhands.nodes.link.join import Received
from manyhands.nodes.link.peer_link import PeerLink
from manyhands.nodes.wave_link.ends import UserEnd, WorldEnd
from manyhands.protocol.clock import Duration, Instant
from manyhands.protocol.codec import encode
from manyhands.protocol.messages import Reaction, Tool, Wave
from tests.support.message_link import MessageLink

from .remote import Device

T: Final = 1e-3
LIMITS: Final = {"force": 8, "displacement": 0.2, "speed": 2}
NOT_AT_ALL: Final = Duration(0)


@cache
def prepared(tank: float = 0.005, b: float = 20.0) -> Prepared:
    """Two seats and a ball between them."""
    link = {"b": b, "round_trip": 0.02, "tank": tank, "depth": 3}
    session = {
        "session": "seats", "period": T,
        "devices": {
            name: {"dof": 1, "osp": 1.37, "driver": "simulated", "mass": 0.2, "limits": LIMITS}
            for name in ("left", "right")
        },
        "couplings": {f"{name}_seat": {"devices": [name], "wave_link": link} for name in ("left", "right")},
        "environment": {
            "type": "network", "masses": {"ball": 1.0},
            "links": [
                {"between": ["left", "ball"], "stiffness": 2000, "damping": 0.1},
                {"between": ["right", "ball"], "stiffness": 2000, "damping": 0.1},
                {"between": ["left", "ground"], "stiffness": 0, "damping": 0.3},
                {"between": ["right", "ground"], "stiffness": 0, "damping": 0.3},
            ],
        },
        "design": {"coupling": "spring-damper", "tau": 0.0005},
    }  # fmt: skip
    with TemporaryDirectory() as folder:
        path = Path(folder) / "session.yaml"
        path.write_text(yaml.safe_dump(session))
        return prepare(load_session(path))


class Ears:
    """A listener that hears of floods alone."""

    def __init__(self) -> None:
        self.failure = ""

    def on_other_tick(self, _peer_link: PeerLink, _other: int, _awaited: int) -> bool:
        return False

    def on_notice(self, _peer_link: PeerLink, _message: object) -> bool:
        return False

    def flooded(self, text: str) -> None:
        self.failure = text


class Hour:
    """A clock that the run moves."""

    def __init__(self) -> None:
        self.ns = 10**9

    def now(self) -> Instant:
        return Instant(self.ns)

    def sleep_until(self, _instant: Instant) -> None:
        raise AssertionError("nothing sleeps here")


Guest = Callable[["Seats"], Wave | None]


@dataclass
class Found:
    """What a run was like.

    Attributes:
        furthest: the greatest displacement of the guest's tool in the world, m.
        given: the energy of the guest that the other received, J.
        beyond: by how much that exceeded E + P t, over any time, J; negative where it did not.
        stops: how often the honest user was stopped, and the guest.
        scaled: ticks in which the honest user was scaled, and the guest.
        step: the greatest change of the honest hand's force in a tick, N.
        refused: waves of the guest that were not admitted.
        honest_refused: waves of the honest user, or of its world, that were not admitted.
        ledger: the honest user's wave link: the least of both ends' energy, J.
    """

    furthest: float = 0.0
    given: float = 0.0
    beyond: float = -math.inf
    stops: tuple[int, int] = (0, 0)
    scaled: tuple[int, int] = (0, 0)
    step: float = 0.0
    refused: int = 0
    honest_refused: int = 0
    ledger: float = 0.0


class Seats:
    """The run.

    Attributes:
        k: the world's tick.
        world: the ends of the world, the honest user's first.
        bound: what the guest's site can do at most.
    """

    def __init__(self, guest: Guest, hand: Callable[[float], float], delay: int = 5, bounded: bool = True) -> None:
        """Everything at rest.

        Args:
            guest: the wave that the guest sends in a tick, which has everything in sight.
            hand: the honest user's intended force by the time, N.
            delay: ticks that waves are on their way.
            bounded: False for a world, and an honest user, as they were without bounds.
        """
        session = prepared()
        bundles = cut(session, RunPlan(REALTIME, None, "memory://control"))
        world, user = bundles["environment"], bundles["left_seat"]
        assert isinstance(world, EnvironmentBundle)
        assert isinstance(user, CouplingBundle)
        assert user.wave is not None
        self.bound = user.wave.bounds
        if not bounded:
            world = replace(world, waves={name: replace(wave, bounds=None) for name, wave in world.waves.items()})
            user = replace(user, wave=replace(user.wave, bounds=None))
        assert user.wave is not None
        self.clock: Any = Hour()
        self._guest, self._hand, self._delay = guest, hand, delay
        self.links = [MessageLink(), MessageLink()]  # of the world's ends
        self.at_user = MessageLink()
        self.world = [
            WorldEnd(world.common, peer, link, self.clock, world.waves[peer.name])  # type: ignore[arg-type]
            for peer, link in zip(world.common.peers, self.links, strict=True)
        ]
        (environment,) = (peer for peer in user.common.peers if peer.name == "environment")
        self.user = UserEnd(user.common, environment, self.at_user, self.clock, user.wave, user.block.D)  # type: ignore[arg-type]
        self.coupling = CouplingCore(user.block, user.K, user.level, T, user.limits.force)
        self.device = Device(T, 0.0)
        D_V = np.diag([float(end.face.D_V[0, 0]) for end in self.world])  # type: ignore[union-attr]
        self.core = environment_core(world, D_V, [[0], [1]])
        self.budget = world.budgets[1]
        self._active = [False, False]
        for i in range(2):
            self.core.clutches.freeze(i)
        self.ears = Ears()
        self.k, self.n = 0, 0
        self.told = Wave(0, (0.0,), 0.0)
        self._up: deque[tuple[int, Any]] = deque()
        self._down: deque[tuple[int, Any]] = deque()
        self._f = 0.0
        self._owed = 0.0  # the energy that the others may still receive, in excess of what was given so far
        self._before = 0.0
        self.found = Found()

    def run(self, seconds: float) -> Found:
        """Run for so long."""
        for _ in range(round(seconds / T)):
            self.tick()
        found, energy = self.found, self.core.energy
        found.given = energy.given[1]
        found.stops, found.scaled = (energy.stops[0], energy.stops[1]), (energy.scaled[0], energy.scaled[1])
        found.refused = sum(self.world[1].dropped.values())
        found.honest_refused = sum(self.world[0].dropped.values()) + sum(self.user.dropped.values())
        return found

    def tick(self) -> None:
        """A tick of all: the honest user's, the guest's waves, the world's."""
        self.clock.ns += 10**6
        k, found = self.k, self.found
        while self._down and self._down[0][0] <= k:
            self.at_user.say(self._down.popleft()[1])
        p = self.coupling.free_position([self.device.x])
        f = [0.0]
        self.user.send(Tool, k, 0, p)
        if self.user.hear(f, k, NOT_AT_ALL, self.ears) is Received.SIGNAL:  # type: ignore[arg-type]
            f = self.coupling.limited(f)
        self.user.settle(k)
        self.coupling.absorb(f)
        self.device.step(f[0], self._hand(k * T))
        found.step, self._f = max(found.step, abs(f[0] - self._f)), f[0]
        self._up.extend((k + self._delay, message) for message in self.at_user.said)
        self.at_user.said.clear()
        while self._up and self._up[0][0] <= k:
            self.links[0].say(self._up.popleft()[1])
        if (wave := self._guest(self)) is not None:
            self.links[1].coming.append(encode(wave))
            self.told = wave
        self._world_tick(k)
        self._down.extend((k + self._delay, message) for message in self.links[0].said)
        for link in self.links:
            link.said.clear()
        found.ledger = min(found.ledger, self.user.face.ledger + self.world[0].face.ledger)
        found.furthest = max(found.furthest, abs(self.world[1].face.x[0]))
        # what a bucket of E that P fills would have left
        given = self.core.energy.given[1]
        self._owed = min(self.budget.energy, self._owed + self.budget.power * T) if k else self.budget.energy
        self._owed -= given - self._before
        self._before = given
        found.beyond = max(found.beyond, -self._owed)
        self.k += 1

    def _world_tick(self, k: int) -> None:
        p: Floats = [0.0, 0.0]
        for i, end in enumerate(self.world):
            part = [0.0, 0.0]
            heard = end.hear(part, k, NOT_AT_ALL, self.ears)  # type: ignore[arg-type]
            if heard is Received.SIGNAL:
                p[i] = part[i]
                if not self._active[i]:
                    self._active[i] = True
                    self.core.clutches.engage(i)
        f = self.core.react(p)
        for i, end in enumerate(self.world):
            if self._active[i]:
                end.send(Reaction, k, 0, f)
        self.core.settle()


def bursts(random: Random) -> Guest:
    """Sums of any size from 1e-2 to 1e12, and energies of 1e12 J."""
    energy = random.choice([0.0, 1e12])
    top = random.choice([0.0, 2.0, 6.0, 12.0])

    def wave(seats: Seats) -> Wave | None:
        seats.n += 1
        size = 10.0 ** random.uniform(-2.0, top) if seats.n > 1 else 0.0
        return Wave(seats.n, (min(size, 9e11) * random.choice([-1.0, 1.0]),), energy if seats.n > 1 else 0.0)

    return wave


def at_the_bound(random: Random) -> Guest:
    """The steepest sums and the greatest energy that are admitted, back and forth at any rate."""
    rate = 10.0 ** random.uniform(-0.7, 2.3)
    shape = random.choice(["square", "random", "follows", "burst"])

    def wave(seats: Seats) -> Wave | None:
        assert seats.bound is not None
        seats.n += 1
        most, t = seats.bound.wave[0] * (1.0 - 1e-9), seats.k * T
        face = seats.world[1].face
        match shape:
            case "square":
                a = math.copysign(most, math.sin(2.0 * math.pi * rate * t))
            case "random":
                a = random.choice([-most, most])
            case "follows":  # along the force, so that it always does work on the others
                a = -math.copysign(most, face.signals[1][0] or 1.0)  # type: ignore[union-attr]
            case _:
                a = most * math.sin(2.0 * math.pi * rate * t) if t % 2.0 > 1.0 else 0.0
        if seats.n == 1:
            return Wave(1, (0.0,), 0.0)
        n0, G = 1, face.tank.shipped + 0.005 + seats.bound.power * (T * (seats.n - 1) + 9.9)
        return Wave(seats.n, (seats.told.sums[0] + T * a,), max(seats.told.shipped, (1.0 - 1e-6) * G * n0))

    return wave


def giant(kind: str) -> Guest:
    """Sums as great as a face takes, or swings of 500 m in the world, with all the energy that they need."""

    def wave(seats: Seats) -> Wave | None:
        seats.n += 1
        if seats.n == 1:
            return Wave(1, (0.0,), 0.0)
        swing = math.sin(2.0 * math.pi * seats.k * T)
        U = {"square": math.copysign(9e11, swing), "jump": 9e11, "swing": 200.0 * swing}[kind]
        return Wave(seats.n, (U,), 1e12)

    return wave


def silent(_seats: Seats) -> Wave | None:
    """Nobody sits there."""
    return None


def pushes(random: Random) -> Callable[[float], float]:
    """The honest hand's intended force, N."""
    size, rate = random.choice([0.0, 3.0, 5.0]), random.uniform(0.3, 3.0)
    return lambda t: size * math.sin(2.0 * math.pi * rate * t)


def case(seed: int) -> tuple[str, Guest, Callable[[float], float]]:
    """The guest and the honest hand of a seed."""
    random = Random(f"seats {seed}")
    name, make = random.choice([("bursts", bursts), ("at the bound", at_the_bound), ("at the bound", at_the_bound)])
    return name, make(random), pushes(random)


def wrong(found: Found) -> list[str]:
    """What did not hold."""
    out = []
    if found.beyond > 0.0:
        out.append(f"the other received {found.beyond:.3g} J more of the guest than E + P t")
    if found.stops[0] or found.scaled[0]:
        out.append(f"the honest user was scaled in {found.scaled[0]} ticks, and stopped {found.stops[0]} times")
    if found.honest_refused:
        out.append(f"{found.honest_refused} waves of the honest user's link were refused")
    if found.ledger < -2.0 * 0.005:
        out.append(f"the honest user's link gave {-found.ledger:.3g} J")
    return out


def main() -> int:
    """Run the campaign; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--unbounded", action="store_true", help="as it was before waves had bounds")
    given = parser.parse_args()
    kinds: Counter[bool] = Counter()
    for seed in range(given.seed * 100_000, given.seed * 100_000 + given.runs):
        name, guest, hand = case(seed)
        found = Seats(guest, hand, bounded=not given.unbounded).run(given.seconds)
        problems = wrong(found)
        kinds[not problems] += 1
        print(f"seed {seed}: {name}: {'; '.join(problems) or 'sound'}; {found}", flush=True)  # noqa: T201
    print(f"{kinds[True]} of {given.runs} runs sound")  # noqa: T201 -- what a campaign is for
    return 1 if kinds[False] else 0


if __name__ == "__main__":
    sys.exit(main())
