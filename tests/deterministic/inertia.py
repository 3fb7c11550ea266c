"""An adversary within a device's inertia and its hand's force, against the reserve that rests on both.

    python -m tests.deterministic.inertia [--ticks N] [--seed S]

It chooses every instant, every answer, and every motion that a mechanism of the least mass can make in a hand of the
greatest force: it brakes at once, and speeds up as strongly as it can. No account may fall below -(E_0 + P t). With a
mass of half that stated the same search has to break it, and a hand of three times the force has to be named.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from manyhands.nodes.kernel.inertia import Inertia
from tests.support.moved_device import E_0, OSP, TICK, Device, promise

Generator = np.random.Generator
FAST = 100.0
"""m/s; the limit of speed, which no motion here comes near, so that inertia alone counts."""

DELAYS = (0, 300_000, 600_000, TICK, 2 * TICK, 3 * TICK, 5 * TICK, 20 * TICK)
RESTS = (100_000, 400_000, TICK, TICK, TICK, 2 * TICK, 30 * TICK)


@dataclass(frozen=True)
class Course:
    """What came of one device.

    Attributes:
        seed: of the course.
        ticks: how many.
        margin: the least of e + E_0, J, by the interface's account and by the definition of e.
        broken: whether the interface has found its statement broken.
        given: the part of the force that was exerted of what was asked for, by time.
    """

    seed: int
    ticks: int
    margin: float
    broken: bool
    given: float


def course(seed: int, ticks: int, mass: float = 1.0, hand: float = 1.0, stated: bool = True) -> Course:
    """Run one device.

    Args:
        seed: of everything.
        ticks: how many.
        mass: the true masses, in parts of those stated.
        hand: the true greatest force of the hand, likewise.
        stated: whether the interface knows of the inertia at all.
    """
    rng = np.random.default_rng(seed)
    osp = float(10.0 ** rng.uniform(-1.7, 0.3)) * list(OSP.values())[int(rng.integers(0, len(OSP)))]
    m = len(osp)
    masses = tuple(float(10.0 ** rng.uniform(-1.7, 0.7)) for _ in range(m))
    forces = tuple(float(rng.choice([2.0, 20.0, 50.0])) for _ in range(m))
    stating = Inertia(masses, forces, (0.0,) * m)
    true = replace(stating, mass=tuple(mass * one for one in masses), hand=tuple(hand * one for one in forces))
    tau = float(rng.choice([0.0, 3e-4, 1e-3]))
    latency = int(rng.choice([0, 300_000])) if tau else 0  # tau has a device's own latency in it
    device = Device(osp, promise(tau, 0.3), tau, E_0, latency, stating if stated else None, FAST)
    known = rng.random() < 0.7
    size, greed = float(rng.choice([1.0, 5.0, 20.0])), float(rng.random())
    least, asked, given = 0.0, 0.0, 0.0

    def push(until: int) -> None:
        """With probability ``greed`` along the force that acts, which costs most."""
        ways, brakes = rng.uniform(-1.0, 1.0, m), np.where(rng.random(m) < 0.5, rng.random(m), 1.0)
        if rng.random() < greed:
            ways, brakes = np.where(device.exerted == 0.0, np.sign(ways), np.sign(device.exerted)), np.ones(m)
        if rng.random() < 0.3:  # come to rest first, so that the speed does not grow without an end
            brakes = np.zeros(m)
        device.push(ways, brakes, until, true)

    for _ in range(ticks):
        device.send()
        push(device.now + int(rng.choice(DELAYS)))
        way = np.sign(device.velocity) if rng.random() < greed else rng.uniform(-1.0, 1.0, m)
        f = size * way * rng.choice([0.0, 0.3, 1.0])
        device.answer(f.tolist(), known)
        least = min(least, device.interface.account.least)
        following = device.now + int(rng.choice(RESTS))
        lasting = max(0, min(following, device.until or following) - device.now)
        asked += float(np.linalg.norm(f)) * (following - device.now)
        given += float(np.linalg.norm(device.exerted)) * lasting
        push(following)
    least = min(least, device.energy + 1e-12 * device.scale)
    broken = device.interface.account.broken is not None
    return Course(seed, ticks, least + E_0, broken, given / asked if asked else 1.0)


def _course(job: tuple[int, int, float, float, bool]) -> Course:
    return course(*job)


def campaign(ticks: int, seed: int, mass: float = 1.0, hand: float = 1.0, stated: bool = True) -> list[Course]:
    """Courses of 50 ticks each, so many ticks in all."""
    jobs = [(seed + i, 50, mass, hand, stated) for i in range(-(-ticks // 50))]
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        return pool.map(_course, jobs, chunksize=20)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the campaign; returns 1 if a bound was broken, or if the search could not have broken one."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ticks", type=int, default=100_000, help="searched ticks (100000)")
    parser.add_argument("--seed", type=int, default=1, help="of the first course (1)")
    asked = parser.parse_args(arguments)
    honest = campaign(asked.ticks, asked.seed)
    lighter = campaign(asked.ticks // 5, asked.seed, mass=0.5)
    stronger = campaign(asked.ticks // 5, asked.seed, hand=3.0)
    without = campaign(asked.ticks // 5, asked.seed, stated=False)
    broken = [one for one in honest if one.margin < 0.0 or one.broken]
    for one in broken:
        print(f"seed {one.seed}: margin {one.margin:.3g} J, {'a broken statement' * one.broken}")  # noqa: T201
    fell = sum(one.margin < 0.0 for one in lighter)
    named = sum(one.broken for one in stronger)
    print(  # noqa: T201
        f"{sum(one.ticks for one in honest)} ticks of {len(honest)} devices: least margin "
        f"{min(one.margin for one in honest):.3g} J of {E_0:g}; bounds broken or statements doubted: {len(broken)}. "
        f"Force given of force asked, by time: {np.mean([one.given for one in honest]):.3f}, without the statement "
        f"{np.mean([one.given for one in without]):.3f}. With half the mass the bound broke in {fell} of "
        f"{len(lighter)}, and the statement was named in {sum(one.broken for one in lighter)}. With three times the "
        f"force it was named in {named} of {len(stronger)}."
    )
    return 1 if broken or not fell or named < len(stronger) else 0


if __name__ == "__main__":
    sys.exit(main())
