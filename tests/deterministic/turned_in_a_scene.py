"""Hands of six axes in a scene of its own whose bodies turn: what the test costs, and what the theorem gives.

Two sticks of three balls are the tools, and a dumb-bell of five the thing. Hands are hostile
(:mod:`tests.deterministic.turned`), or move and turn as people do, at up to 2 Hz and 46 degrees. The scene is that of
:mod:`tests.support.turning_scene`. The springs to its avatars are *held*, as an engine's are, or *of the tick's end*.

1. Under the tests of decisions 42 and 54: how many of the proposed steps are shortened.
2. Without any test, with springs of the tick's end: what the hands have put in by moving, and the accounts of their
   springs, together are never less than what the scene has stored (docs/decisions/0055-bodies-that-turn.md).
"""

from __future__ import annotations

import argparse
import itertools
import math
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from manyhands.nodes.environment.core import respond
from manyhands.nodes.environment.enforced import EnforcedCore
from manyhands.nodes.environment.model import AskedModel
from manyhands.nodes.environment.oriented_tools import OrientedTools
from manyhands.nodes.environment.proxy import ProxyLaw, Vector
from manyhands.nodes.kernel.bundle import OrientedTool
from manyhands.nodes.kernel.orientation import (
    RIDER,
    UPRIGHT,
    OrientationSpring,
    Quaternion,
    Vector3,
    difference,
    torque,
    total,
    turned_by,
    unit,
    yielded,
)
from tests.deterministic.turned import (
    D_V,
    DAMPING,
    FASTEST,
    MOST,
    PORTS,
    ROUNDING,
    STIFFNESS,
    HostileHand,
    K,
    T,
    Told,
    at_an_engine,
)
from tests.support.thrown_tools import STARTS
from tests.support.turning_scene import Balls, TurningScene

CONTACTS = 1e4
"""N/m."""


def scene(
    ends: bool, stiffness: float = CONTACTS, friction: float = 0.6, loss: float = 1.0, share: float = 0.5
) -> TurningScene:
    """Two sticks and a dumb-bell.

    Args:
        ends: whether the springs to the avatars are of the tick's end.
        stiffness: of the contacts, N/m.
        friction: mu.
        loss: the part of the avatars' drags, 0.2 N*s/m and 0.5 mN*m*s/rad.
        share: of the tick's end in the arms.
    """
    three, masses = [(-0.02, 0.0, 0.0), (0.0, 0.0, 0.0), (0.02, 0.0, 0.0)], (0.03, 0.04, 0.03)
    rods = [Balls((x, 0.0, 0.0), three, 0.01, masses, 0.2 * loss, 5e-4 * loss) for x in STARTS.values()]
    five = [(x, 0.0, 0.0) for x in (-0.018, -0.009, 0.0, 0.009, 0.018)]  # nothing overlaps
    thing = Balls((0.0, 0.0, 0.0), five, 0.01, (0.04, 0.01, 0.01, 0.01, 0.04))
    # where a tool would be without any force of the world, its own compliance and the spring are in series
    springs = (1.0 / (1.0 / K + D_V), STIFFNESS) if ends else None
    return TurningScene([*rods, thing], T, stiffness, 0.0, friction, len(rods), springs, share=share)


class CalmHand(HostileHand):
    """A hand that moves by 20 to 30 mm about the thing, and turns by up to 0.8 rad about each axis, at 0.3 to 2 Hz."""

    def __init__(self, rng: np.random.Generator, start: Vector, spring: type[OrientationSpring]) -> None:
        """Begin at ``start``, m, upright."""
        super().__init__(rng, start, spring)
        self._ticks = 0
        self._phases, self._rates = rng.uniform(0.0, math.tau, (6, 2)), rng.uniform(0.3, 2.0, (6, 2))
        self._parts = np.array([0.7, 0.3])

    def _waves(self) -> Vector:
        now = np.sin(math.tau * self._rates * self._ticks * T + self._phases) - np.sin(self._phases)
        found: Vector = min(1.0, self._ticks / 200) * (now @ self._parts)
        return found

    def move(self, thing: Vector) -> Vector:
        """Move and turn until the next sample; returns the place, m."""
        self._ticks += 1
        waves = self._waves()
        self.p = np.array([0.03, 0.02, 0.02]) * waves[:3] - 0.45 * min(1.0, self._ticks / 200) * self._start
        w, *v = difference(turned_by(UPRIGHT, (0.8 * waves[3:]).tolist()), self.R)
        z = np.multiply(2.0 * math.copysign(1.0, w), v)
        given, burnt = float(np.dot(self._torque, z)), DAMPING * float(z @ z) / T
        self.put_in += burnt - given
        self.work += burnt + abs(given)
        self.turned += float(np.linalg.norm(z))
        self.R = turned_by(self.R, z.tolist())
        return self.p

    def rides(self) -> list[float]:
        """What rides with its signal, which is never lost."""
        return [*self.R, self.spring.deposited, self.life]

    def feel(self, came: list[float]) -> None:
        """Exert the torque of the tick."""
        spring = self.spring
        self._torque = spring.turn(self.R, unit(came[:4]), total(came[4]))
        self.margin = min(self.margin, spring.account - (spring.deposited - spring.granted))


def under_the_tests(ends: bool, calm: bool, ticks: int, seed: int) -> tuple[Told, TurningScene]:
    """What became of a run with both tests."""
    world = scene(ends)
    told = at_an_engine(world, lambda: world.touching > 0, ticks, seed, kind=CalmHand if calm else HostileHand)
    return told, world


class _PooledLaw(ProxyLaw):
    """The law of proxies, which knows after a proposal what its tick will leave of B, J."""

    left = 0.0

    def propose(self, r: Vector, compliance: Vector, x_e: Vector) -> Vector:
        """The springs' forces, N."""
        f = super().propose(r, compliance, x_e)
        self.left = self._budget + float(self._gains(r, self._M @ (r - self._next), self._next - self._q).sum())
        return f

    def take_in(self, energy: float) -> None:
        """Put ``energy`` into B, J; negative takes it out."""
        self._total += energy
        self._budget += energy


class _PooledTools(OrientedTools):
    """Tools whose bank has what is in B as well; what wrists have deposited goes to B only where both ways are open."""

    def __init__(self, tools: Sequence[OrientedTool], asked: AskedModel, law: _PooledLaw, both_ways: bool) -> None:
        """Share with ``law``."""
        super().__init__(tools, asked)
        self._law, self._both_ways = law, both_ways

    def hear(self, riders: Sequence[float], tick: int) -> None:
        """Take in what came."""
        super().hear(riders, tick)
        if self._both_ways:
            self._law.take_in(self.bank.balance)
            self.bank.balance = 0.0

    def answer(self) -> list[float]:
        """Grant out of what the bank has, and then of what B has left."""
        own, left = self.bank.balance, max(0.0, self._law.left)
        self.bank.balance = own + left
        told = super().answer()
        taken = max(0.0, left - self.bank.balance)  # the bank's own goes first
        self._law.take_in(-taken)
        self.bank.balance = max(0.0, self.bank.balance - (left - taken))
        return told


@dataclass
class Pooled:
    """What became of a run in which one budget is kept for moving and turning.

    Attributes:
        ticks: so many.
        held: by turning, the steps that were held.
        stayed: by moving, likewise.
        least: the least of what came in by moving and of all lives' accounts, together, J.
        moving: the least that came in by moving alone, J.
        work: the sizes of all of it, J.
    """

    ticks: int = 0
    held: int = 0
    stayed: int = 0
    least: float = 0.0
    moving: float = 0.0
    work: float = 0.0


def pooled(world: TurningScene, ticks: int, seed: int, hand: type[HostileHand], both_ways: bool = True) -> Pooled:
    """Two hands under one test for moving and turning together; or the bank alone has the other's budget, too."""
    asked = AskedModel("scene", world, PORTS)
    blocks = [[0, 1, 2], [3, 4, 5]]
    law = _PooledLaw(asked, K * np.eye(6), None, T, blocks, bodies=1)
    power = MOST * FASTEST * T + 0.5 * STIFFNESS * (FASTEST * T) ** 2
    oriented = _PooledTools([OrientedTool(name, STIFFNESS, MOST, power) for name in STARTS], asked, law, both_ways)
    core = EnforcedCore(law, D_V * np.eye(6), np.zeros((6, 6)), T, False, blocks, oriented=oriented)
    rng, told = np.random.default_rng(seed), Pooled()
    hands = [hand(rng, np.array([x, 0.0, 0.0]), OrientationSpring) for x in STARTS.values()]
    for k in range(ticks):
        thing = np.array(world.positions())
        places = [number for one in hands for number in one.move(thing).tolist()]
        before = core.tools
        answer = respond(core, places + [number for one in hands for number in one.rides()], k)
        core.settle()
        for i, one in enumerate(hands):
            one.feel(answer[6 + RIDER * i : 6 + RIDER * (i + 1)])
        told.work += abs(float(np.dot(answer[:6], np.subtract(core.tools, before))))
        assert core.ledger is not None
        together = core.ledger.total + sum(one.gone + one.spring.account for one in hands)
        told.least, told.moving = min(told.least, together), core.ledger.minimum
        told.ticks += 1
    told.work += sum(one.work for one in hands)
    told.held = sum(one.held + one.spring.held for one in hands)
    told.stayed = sum(law.held)
    return told


@dataclass
class Together:
    """What became of a run without tests.

    Attributes:
        least: the least of what came in by moving and by the accounts, less the rise of what the scene stores, J.
        moving: the least that came in by moving alone, J.
        turning: the least sum of the accounts, J.
        work: the sizes of all of it, J.
        touching: ticks with a contact.
        unfinished: ticks that were not solved.
    """

    least: float = 0.0
    moving: float = 0.0
    turning: float = 0.0
    work: float = 0.0
    touching: int = 0
    unfinished: int = 0


class _Open:
    """A model's world without a test: avatars that follow, and the hands' springs at them."""

    def __init__(self, world: TurningScene, seed: int, hand: type[HostileHand]) -> None:
        asked = AskedModel("scene", world, PORTS)
        blocks = [[0, 1, 2], [3, 4, 5]]
        law = ProxyLaw(asked, K * np.eye(6), None, T, blocks, bodies=1, tank=1e6)
        self.core = EnforcedCore(law, D_V * np.eye(6), np.zeros((6, 6)), T, False, blocks)
        self.law = law
        rng = np.random.default_rng(seed)
        self.hands = [hand(rng, np.array([x, 0.0, 0.0]), OrientationSpring) for x in STARTS.values()]


def together(world: TurningScene, ticks: int, seed: int, hand: type[HostileHand] = CalmHand) -> Together:
    """Hands that turn and move, with no test; a hand that is hostile loses no signal here.

    Args:
        world: with springs of the tick's end for the theorem, or held ones to see it broken.
        ticks: so many.
        seed: of the hands.
        hand: how they move.
    """
    run, told = _Open(world, seed, hand), Together()
    stored, accounts = world.energy, 0.0
    proxies: list[Quaternion] = [UPRIGHT] * len(run.hands)
    for k in range(ticks):
        thing = np.array(world.positions())
        places = [number for one in run.hands for number in one.move(thing).tolist()]
        torques: list[float] = []
        for one, proxy in zip(run.hands, proxies, strict=True):
            torques += (-t for t in torque(STIFFNESS, one.R, proxy))
        world.turn(np.array(torques))
        before = run.core.tools
        answer = respond(run.core, places, k)
        run.core.settle()
        numbers = world.avatars()
        for i, one in enumerate(run.hands):
            new = unit(numbers[4 * i : 4 * i + 4])
            assert new is not None
            gained = yielded(STIFFNESS, one.R, proxies[i], new)
            accounts += gained
            told.work += abs(gained)
            proxies[i] = new
            felt: Vector3 = torque(STIFFNESS, one.R, new)
            one._torque = felt
        told.work += abs(float(np.dot(answer[:6], np.subtract(run.core.tools, before))))
        assert run.core.ledger is not None
        assert not any(run.law.held)
        came = run.core.ledger.total
        told.moving, told.turning = min(told.moving, came), min(told.turning, accounts)
        told.least = min(told.least, came + accounts - (world.energy - stored))
        told.touching += world.touching > 0
    told.unfinished = world.unfinished
    return told


def main() -> int:
    """Print both; the exit code is 1 where something does not hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ticks", type=int, default=8000, help="of each row (8000)")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    holds, say = True, print
    seeds = [given.seed + run for run in range(max(1, given.ticks // RUN))]
    say("under the tests: hands, springs, ticks, held by turning and by moving, of two hands' steps; touching;")
    say("unsolved; rounds a tick; ms a tick")
    for calm in (True, False):
        for ends in (False, True):
            rows, every, rounds, unfinished, began = [], Told(), 0, 0, time.perf_counter()
            for seed in seeds:
                told, world = under_the_tests(ends, calm, RUN, seed)
                holds &= told.holds
                every.add(told)
                rows.append((told.held / (2 * told.ticks), told.stayed / (2 * told.ticks)))
                rounds, unfinished = rounds + world.rounds, unfinished + world.unfinished
            lasts = (time.perf_counter() - began) / every.ticks * 1e3
            turning, moving = np.array(rows).T
            say(
                f"{'calm' if calm else 'hostile':8}{'end' if ends else 'held':5}{every.ticks:7}  "
                f"{turning.mean():6.1%} ({turning.min():.1%} to {turning.max():.1%})  "
                f"{moving.mean():6.1%} ({moving.min():.1%} to {moving.max():.1%})  "
                f"{every.touching:6} {unfinished:4} {rounds / every.ticks:5.1f} {lasts:5.1f}",
                flush=True,
            )
    say("one budget: ways, hands, springs, ticks, held by turning and by moving; least sum, least by moving, work (J)")
    for both_ways, kind, ends in itertools.product((False, True), (CalmHand, HostileHand), (False, True)):
        runs = [pooled(scene(ends), RUN, seed, kind, both_ways) for seed in seeds]
        work, least = sum(one.work for one in runs), min(one.least for one in runs)
        moving = min(one.moving for one in runs)
        holds &= least >= -ROUNDING * work and (both_ways or moving >= -ROUNDING * work)
        turned = np.array([one.held / (2 * one.ticks) for one in runs])
        moved = np.array([one.stayed / (2 * one.ticks) for one in runs])
        say(
            f"{'both' if both_ways else 'one':5}{'calm' if kind is CalmHand else 'hostile':8}"
            f"{'end' if ends else 'held':5}{RUN * len(seeds):7}  "
            f"{turned.mean():6.1%} ({turned.min():.1%} to {turned.max():.1%})  "
            f"{moved.mean():6.1%} ({moved.min():.1%} to {moved.max():.1%})  {least:9.2g} {moving:9.2g} {work:8.3g}",
            flush=True,
        )
    say("without a test: hands, springs, ticks, least sum, least by moving, least accounts, work (J), touching,")
    say("unsolved")
    for hand in (CalmHand, HostileHand):
        for ends in (True, False):
            row = Together()
            for seed in seeds:
                one = together(scene(ends), RUN, seed, hand)
                row = Together(
                    min(row.least, one.least), min(row.moving, one.moving), min(row.turning, one.turning),
                    row.work + one.work, row.touching + one.touching, row.unfinished + one.unfinished,
                )  # fmt: skip
            holds &= not ends or row.least >= -ROUNDING * row.work
            say(
                f"{'calm' if hand is CalmHand else 'hostile':8}{'end' if ends else 'held':5}{RUN * len(seeds):7} "
                f"{row.least:9.2g} {row.moving:9.2g} {row.turning:9.2g} {row.work:8.3g} {row.touching:6} "
                f"{row.unfinished:4}",
                flush=True,
            )
    say("all holds" if holds else "SOMETHING DOES NOT HOLD")
    return 0 if holds else 1


RUN = 1000
"""Ticks of a run."""

if __name__ == "__main__":
    sys.exit(main())
