"""Hostile hands of six axes, in MuJoCo: tools that are thrown at a body and turned violently, with torques.

Two hands move where they like, and turn as they like: to another orientation at up to 80 rad/s, to and fro, or along
the torque that they feel, which is what draws most out of a held torque. Both tools turn in the engine, so that the
proxies come from contacts. Answers and signals are lost, and hands start anew. In every tick

- the environment's ledger is at least -1e-12 of the work that was done;
- likewise every account is not below its bound, deposits less grants, and the accounts of all lives together not
  below 0;
- the bank's balance is at least 0;
- what both hands have put in by turning, at the damping b = kT/2 that the law asks for, is not below -1e-12 of that
  work.

The last is computed from the way of the hands and from the torques alone: the hands are without inertia, and turn
evenly from sample to sample. A *careless* engine makes energy in its contacts. Without the test hands get energy.
"""

from __future__ import annotations

import argparse
import itertools
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Final, Protocol

import numpy as np

from manyhands.nodes.environment.core import respond
from manyhands.nodes.environment.enforced import EnforcedCore
from manyhands.nodes.environment.model import AskedModel, Engine
from manyhands.nodes.environment.mujoco import MujocoEngine
from manyhands.nodes.environment.oriented_tools import OrientedTools
from manyhands.nodes.environment.proxy import ProxyLaw, Vector
from manyhands.nodes.kernel.bundle import OrientedTool
from manyhands.nodes.kernel.orientation import (
    NO_RIDER,
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
)
from tests.support.thrown_tools import BODIES, CARES, SHAPES, STARTS, model

T: Final = 1e-3
K: Final = 2000.0
"""N/m, of the springs to the avatars."""

D_V: Final = T / (T * 800.0 + 0.5)
"""m/N, of couplings of 800 N/m and 0.5 N·s/m."""

STIFFNESS: Final = 0.4
"""k of the hands' springs, N·m/rad."""

DAMPING: Final = 0.5 * STIFFNESS * T
"""b, N·m·s/rad: the least that is asked for without a delay."""

MOST: Final = 0.25
"""N·m; less than k, so that springs yield now and then."""

FASTEST: Final = 80.0
"""rad/s."""

PORTS: Final = tuple(f"{name}.{axis}" for name in STARTS for axis in "xyz")

ROUNDING: Final = 1e-12
"""Of the work that was done: below it nothing may be given out."""

AFTER: Final = 20
"""The ticks that go on after an engine has given up, with proxies that rest."""

LOST: Final = 0.05
"""The part of signals, and of answers, that do not come."""


class Untested(OrientationSpring):
    """A spring that takes every proxy, whatever that gives out."""

    def turn(self, R: Quaternion, proposed: Quaternion | None, granted: float = 0.0) -> Vector3:
        """The torque to the proposed proxy."""
        self.proxy = self.proxy if proposed is None else proposed
        return torque(STIFFNESS, R, self.proxy)


class HostileHand:
    """A hand of six axes: where it is, how it is turned, and its spring.

    Attributes:
        p: the place, m, from where it began.
        R: its orientation.
        spring: of this life.
        life: its number.
        gone: the accounts of the lives before, J.
        put_in: what it has put in by turning, J.
        work: the sum of the sizes of what that is made of, J.
        margin: the least distance of an account from its bound, J.
        turned: the whole angle by which it has turned, rad.
        held: the steps that its test has held.
    """

    def __init__(self, rng: np.random.Generator, start: Vector, spring: type[OrientationSpring]) -> None:
        """Begin at ``start``, m, upright."""
        self._rng, self._start, self._kind = rng, start, spring
        self.p, self._aim, self._speed, self._shake = np.zeros(3), np.zeros(3), 1.0, 0.0
        self.R, self._way, self._swing = UPRIGHT, 0, np.zeros(3)
        self._rate, self._to = 0.0, UPRIGHT
        self.spring, self.life, self.gone = spring(STIFFNESS, MOST), 1.0, 0.0
        self._torque: Vector3 = (0.0, 0.0, 0.0)
        self.put_in = self.work = self.margin = self.turned = 0.0
        self.held = 0

    def move(self, thing: Vector) -> Vector:
        """Move and turn until the next sample; returns the place that it claims, m."""
        rng = self._rng
        if rng.random() < 0.02:  # 20 ms in the mean: another aim, up to 8 m/s there
            at = thing + rng.normal(scale=0.02, size=3) if rng.random() < 0.8 else rng.uniform(-0.12, 0.12, 3)
            self._aim, self._speed = at - self._start, 10.0 ** rng.uniform(-1.5, 0.9)
            self._shake = float(rng.choice([0.0, 1e-3, 5e-3]))
        if rng.random() < 0.02:
            self._way = int(rng.integers(4))
            self._swing = rng.standard_normal(3)
            self._swing /= np.linalg.norm(self._swing)
            self._rate = min(10.0 ** rng.uniform(-1.0, 2.0), FASTEST)
            self._to = turned_by(UPRIGHT, rng.standard_normal(3).tolist())
        step = self._aim - self.p
        far = float(np.linalg.norm(step))
        self.p = self.p + step * min(1.0, self._speed * T / max(far, 1e-12))
        self._turn()
        return self.p + self._shake * rng.normal(size=3)

    def _turn(self) -> None:
        most = self._rate * T
        if self._way == 0:  # to another orientation
            w, *v = difference(self._to, self.R)
            z = np.multiply(2.0 * math.copysign(1.0, w), v)
        elif self._way == 1:  # to and fro
            self._swing = -self._swing
            z = most * self._swing
        elif self._way == 2:  # along the torque, as far as draws most out of it
            z = np.multiply(0.5 * T / DAMPING, self._torque)
        else:
            z = self._rng.normal(scale=most / 2.0, size=3)
        z *= min(1.0, most / max(float(np.linalg.norm(z)), 1e-12))
        given, burnt = float(np.dot(self._torque, z)), DAMPING * float(z @ z) / T
        self.put_in += burnt - given
        self.work += burnt + abs(given)
        self.turned += float(np.linalg.norm(z))
        self.R = turned_by(self.R, z.tolist())

    def rides(self) -> list[float]:
        """What rides with its signal; nothing where that is lost."""
        if self._rng.random() < LOST:
            return [*NO_RIDER]
        return [*self.R, self.spring.deposited, self.life]

    def feel(self, came: list[float]) -> None:
        """Exert the torque of the tick, by an answer that may be lost or for another life; or start anew."""
        rng, spring = self._rng, self.spring
        if rng.random() < 0.001:
            self.gone += spring.account
            self.held += spring.held
            self.spring = spring = self._kind(STIFFNESS, MOST, self.R)
            self.life += 1.0
            self._torque = (0.0, 0.0, 0.0)
            return
        mine = came[5] == self.life and rng.random() >= LOST
        self._torque = spring.turn(self.R, unit(came[:4]) if mine else None, total(came[4]) if mine else 0.0)
        self.margin = min(self.margin, spring.account - (spring.deposited - spring.granted))


@dataclass
class Told:
    """What became of a run.

    Attributes:
        ticks: those of the run; a few after the engine has given up.
        ledger: the least of the environment's ledger, J.
        work: the work that was done on the tools by moving them, J.
        margin: the least distance of an account from its bound, J.
        accounts: the least sum of all lives' accounts, J.
        balance: the least balance of the bank, J.
        put_in: the least that both hands had put in by turning, J.
        turning: the work that was done by turning, J.
        held: by turning, the steps that were held.
        stayed: by moving, likewise.
        lives: how many lives both hands had.
        touching: ticks with a contact.
        turned: the whole angle by which both hands have turned, rad.
        gave_up: whether the engine did.
    """

    ticks: int = 0
    ledger: float = 0.0
    work: float = 0.0
    margin: float = 0.0
    accounts: float = 0.0
    balance: float = 0.0
    put_in: float = 0.0
    turning: float = 0.0
    held: int = 0
    stayed: int = 0
    lives: int = 0
    touching: int = 0
    turned: float = 0.0
    gave_up: int = 0

    @property
    def holds(self) -> bool:
        """Whether nothing was given out that nobody had put in."""
        turning = -ROUNDING * self.turning
        return (
            self.ledger >= -ROUNDING * self.work
            and min(self.margin, self.accounts, self.put_in) >= turning
            and self.balance >= 0.0
        )

    def add(self, other: Told) -> None:
        """Take in another run: the least of what is least, and the sums of all else."""
        for name in (field.name for field in fields(self)):
            mine, others = getattr(self, name), getattr(other, name)
            setattr(self, name, min(mine, others) if name in _LEAST else mine + others)


_LEAST: Final = {"ledger", "margin", "accounts", "balance", "put_in"}


def thrown(
    body: str, shape: str, care: str, ticks: int, seed: int, spring: type[OrientationSpring] = OrientationSpring
) -> Told:
    """Two hostile hands of six axes, and a body that they turn in MuJoCo."""
    ports = PORTS
    parameters = {
        "model": model(body, shape, care, turns=True),
        "tools": [port.replace(".", "_") for port in ports],
        "avatars": [f"{name}_turn" for name in STARTS],
        "avatar_stiffness": [STIFFNESS] * len(STARTS),
        "bodies": ["thing"],
        "stiffness": [K] * len(ports),
    }
    engine = MujocoEngine(ports, T, parameters)
    return at_an_engine(engine, lambda: bool(engine._data.ncon > 0), ticks, seed, spring)


class TurnsAvatars(Engine, Protocol):
    """An engine with avatars that turn."""

    def turn(self, torques: Vector) -> None:
        """Turn them in the next step."""
        ...

    def avatars(self) -> list[float]:
        """Their orientations."""
        ...


def at_an_engine(
    engine: TurnsAvatars,
    touches: Callable[[], bool],
    ticks: int,
    seed: int,
    spring: type[OrientationSpring] = OrientationSpring,
    kind: type[HostileHand] = HostileHand,
) -> Told:
    """Two hands of six axes, hostile unless stated, and an engine whose avatars are theirs.

    Args:
        engine: with an avatar for each of :data:`STARTS`, on springs of :data:`K` and :data:`STIFFNESS`.
        touches: whether anything touched in the engine's last step.
        ticks: at most so many.
        seed: of the hands.
        spring: the hands' law.
        kind: how they move.
    """
    asked = AskedModel("engine", engine, PORTS)
    blocks = [[0, 1, 2], [3, 4, 5]]
    law = ProxyLaw(asked, K * np.eye(6), None, T, blocks, bodies=1)
    power = MOST * FASTEST * T + 0.5 * STIFFNESS * (FASTEST * T) ** 2
    oriented = OrientedTools([OrientedTool(name, STIFFNESS, MOST, power) for name in STARTS], asked)
    core = EnforcedCore(law, D_V * np.eye(6), np.zeros((6, 6)), T, False, blocks, oriented=oriented)
    rng, told, left = np.random.default_rng(seed), Told(), AFTER
    hands = [kind(rng, np.array([x, 0.0, 0.0]), spring) for x in STARTS.values()]
    for k in range(ticks):
        thing = np.array(engine.positions())
        places = [number for hand in hands for number in hand.move(thing).tolist()]
        told.put_in = min(told.put_in, sum(hand.put_in for hand in hands))
        before = core.tools
        answer = respond(core, places + [number for hand in hands for number in hand.rides()], k)
        core.settle()
        for i, hand in enumerate(hands):
            hand.feel(answer[6 + RIDER * i : 6 + RIDER * (i + 1)])
        told.work += abs(float(np.dot(answer[:6], np.subtract(core.tools, before))))
        told.accounts = min(told.accounts, sum(hand.gone + hand.spring.account for hand in hands))
        told.balance = min(told.balance, oriented.bank.balance)
        told.touching += touches()
        told.ticks += 1
        if core.failure is not None:
            told.gave_up, left = 1, left - 1
            if left == 0:
                break
    assert core.ledger is not None
    told.ledger = core.ledger.minimum
    told.margin, told.turning = min(hand.margin for hand in hands), sum(hand.work for hand in hands)
    told.held = sum(hand.held + hand.spring.held for hand in hands)
    told.lives = sum(int(hand.life) for hand in hands)
    told.stayed = sum(law.held)
    told.turned = sum(hand.turned for hand in hands)
    return told


def main() -> int:
    """Run them in every world, and print what came of it; the exit code is 1 where something does not hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ticks", type=int, default=100_000, help="in all worlds with the test together (100000)")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    worlds, holds, every = list(itertools.product(BODIES, SHAPES, CARES)), True, Told()
    each = -(-given.ticks // len(worlds))
    say = print
    say(f"{'body':14} {'shape':10} {'engine':9} {'ticks':>6} {'ended':>5} {'turned':>8} {'held':>6} {'lives':>5} "
        f"{'ledger':>8} {'accounts':>9} {'margin':>9} {'put in':>8} {'work':>8} {'untested':>9}")  # fmt: skip
    for number, (body, shape, care) in enumerate(worlds):
        told, loose, seed = Told(), Told(), given.seed + 10_000 * number
        while told.ticks < each:
            one = thrown(body, shape, care, min(each - told.ticks, RUN), seed)
            holds &= one.holds
            told.add(one)
            if loose.ticks < RUN:
                loose.add(thrown(body, shape, care, min(each, RUN - loose.ticks), seed, Untested))
            seed += 1
        holds &= loose.put_in < -1e-9 * loose.turning
        every.add(told)
        say(f"{body:14} {shape:10} {care:9} {_cells(told)} {loose.put_in:7.2g} J", flush=True)
    say(f"{'all':35} {_cells(every)}")
    say("all holds" if holds else "SOMETHING DOES NOT HOLD")
    return 0 if holds else 1


RUN: Final = 2000
"""Ticks of one run at most."""


def _cells(told: Told) -> str:
    return (
        f"{told.ticks:6d} {told.gave_up:5d} {told.turned:6.0f} r {told.held:6d} {told.lives:5d} {told.ledger:8.1g} "
        f"{told.accounts:9.2g} {told.margin:9.2g} {told.put_in:8.1g} {told.turning:6.1f} J"
    )


if __name__ == "__main__":
    sys.exit(main())
