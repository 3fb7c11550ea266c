"""Waves of any magnitude at one face of a wave link, with its account in exact whole numbers beside it.

    python -m tests.deterministic.magnitudes [--ticks N] [--seed S] [--again SEED]

A hostile party sends sums U and energies G from 1e-300 to 1e300, of one size, in bursts or mixed, to a user's face or
to a world's. The party at the face itself moves or pushes at any size as well. After each step of the tank L must be
at least 0, and no more than E_0 and what came, less what went, exactly. Nothing may raise. The seed alone makes a run
happen again. The exit code is 1 if anything did not hold.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable
from random import Random
from typing import Final

import numpy as np

from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.wave_link import UserFace, WorldFace
from tests.nodes.wave_link.exact_tank import ExactTank

TICKS: Final = 2000
"""Of one run; the next has another link, another tank and another strategy."""

TANKS: Final = (0.0, 0.0, 5e-324, 1e-300, 1e-12, 5e-3, 10.0, 1e12)

Size = Callable[[Random], float]


def sizes() -> dict[str, Size]:
    """How great the numbers of a strategy are."""

    def any_size(random: Random) -> float:
        return 10.0 ** random.uniform(-300.0, 300.0)

    def usual(random: Random) -> float:
        return 10.0 ** random.uniform(-4.0, 2.0)

    def burst(random: Random) -> float:
        return 10.0 ** random.choice([-2.0, 6.0, random.uniform(-2.0, 6.0)])

    def admitted(random: Random) -> float:
        return 10.0 ** random.uniform(-300.0, 12.0)

    def edge(random: Random) -> float:
        return random.choice(
            [0.0, 5e-324, 2.2e-308, 1e-162, 1e-154, 1.0, 1e12, 9.9e11, 1e154, 1e300, sys.float_info.max]
        )

    def mixed(random: Random) -> float:
        return random.choice([any_size, usual, burst, admitted, edge])(random)

    return {
        "any size": any_size,
        "usual": usual,
        "bursts": burst,
        "up to 1e12": admitted,
        "edges": edge,
        "mixed": mixed,
    }


class Siege:
    """One face, and a hostile party at the other end of its link.

    Attributes:
        told: the link and the strategy, in words.
        tank: of the face.
    """

    def __init__(self, seed: int) -> None:
        """Choose all by the seed."""
        self.random = random = Random(f"magnitudes {seed}")
        m = random.choice([1, 1, 1, 2, 3])
        rng = np.random.default_rng(seed)
        Q = rng.normal(size=(m, m))
        b = 10.0 ** random.uniform(-1.0, 3.0) * (Q @ Q.T + np.eye(m))
        b = 0.5 * (b + b.T)
        T, peer_T = 1e-3 * 2.0 ** random.randint(-2, 1), 1e-3 * 2.0 ** random.randint(-2, 1)
        E_0, depth = random.choice(TANKS), random.uniform(0.0, 10.0)
        theta = 0.01 * b if random.random() < 0.3 else None
        self._m = m
        self._user = random.random() < 0.5
        self.face: UserFace | WorldFace
        if self._user:
            self.face = UserFace(b, 1e-5 * np.eye(m), T, peer_T, depth, E_0=E_0, theta=theta)
        else:
            self.face = WorldFace(b, T, peer_T, depth, E_0=E_0, theta=theta)
        self.face.tank = self.tank = ExactTank(T, E_0)
        kinds = sizes()
        names = {what: random.choice(list(kinds)) for what in ("sums", "energy", "own")}
        if random.random() < 0.7:
            names["own"] = "usual"
        self._size = {what: kinds[name] for what, name in names.items()}
        self._sums_grow, self._ships = random.random() < 0.5, random.choice([0.0, 0.05, 1.0])
        self._n, self._U, self._G = 0, [0.0] * m, 0.0
        where = "a user's" if self._user else "the world's"
        self.told = f"{where} face, {m} ports, E_0 = {E_0:g} J: {', '.join(f'{k} {v}' for k, v in names.items())}"

    def tick(self) -> None:
        """Some messages, and a tick of the face."""
        random, face = self.random, self.face
        for _ in range(random.choice([0, 1, 1, 1, 2])):
            self._n += random.choice([1, 1, 1, 2, 40])
            U = self._drawn("sums")
            if self._sums_grow:
                U = [at + by for at, by in zip(self._U, U, strict=True)]
            if random.random() < self._ships:
                self._G = min(self._G + self._size["energy"](random), sys.float_info.max)
            if face.hear(self._n, U, self._G):
                self._U = U
            elif not math.hypot(*self._U) < 1e12 or not self._G < 1e12:
                self._U, self._G = [0.0] * self._m, face.tank.heard
        if random.random() < 0.01:
            face.skip(random.choice([1, 3, 300]))
        if isinstance(face, UserFace):
            face.step(self._drawn("own"))
        else:
            face.tool()
            face.step(self._drawn("own"), harvests=random.random() < 0.8)
        face.message()
        if random.random() < 0.001:  # lives begin anew, and the survivor keeps its energy
            face.renew(face.life + 1)
            self._n, self._U, self._G = 0, [0.0] * self._m, 0.0

    def _drawn(self, what: str) -> Floats:
        random, size = self.random, self._size[what]
        return [size(random) * random.choice([-1.0, 1.0]) for _ in range(self._m)]


def run(seed: int, ticks: int = TICKS) -> Siege:
    """Run one siege.

    Raises:
        AssertionError: the account did not hold.
    """
    siege = Siege(seed)
    for _ in range(ticks):
        siege.tick()
    return siege


def main() -> int:
    """Run the campaign; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ticks", type=int, default=1_000_000, help="of all runs together")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--again", type=int, help="only the run of this seed")
    given = parser.parse_args()
    seeds = (
        [given.seed * 100_000 + i for i in range(-(-given.ticks // TICKS))] if given.again is None else [given.again]
    )
    began, failing, clipped = time.monotonic(), [], 0
    for seed in seeds:
        siege = Siege(seed)
        try:
            for _ in range(TICKS):
                siege.tick()
        except Exception as problem:  # noqa: BLE001 -- whatever a core raises is a finding
            failing.append(seed)
            print(f"seed {seed}: {siege.told}: {type(problem).__name__}: {problem}", flush=True)  # noqa: T201
        clipped += siege.tank.clipped
    print(  # noqa: T201 -- what a campaign is for
        f"{len(seeds) - len(failing)} of {len(seeds)} runs of {TICKS} ticks sound in {time.monotonic() - began:.0f} s; "
        f"{clipped} waves limited"
    )
    return 1 if failing else 0


if __name__ == "__main__":
    sys.exit(main())
