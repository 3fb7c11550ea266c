"""The law of decision 54 against violent hands and hostile worlds, at its limit and beyond it (`make orientation`).

1. Motions on SO(3) of all kinds, with proxies that jump, rest or do not come: at the certified damping none may give
   out energy, for delays of 0 to T and periods of up to 1.3 T. At 1/1.3 of it the worst pair of a hand and a lossless
   world has to.
2. Motions on SE(3) of devices of six axes whose motors hold joint torques: gantries with a gimbal, chains of six
   joints, and such with a wrist. The hands' energy with springs, and what torques for the worst wrenches give out, in
   parts of what the stated damping burns: more than 1 would give energy.
3. The same hands and worlds without the test, by a chordal and by a geodesic spring: what each gives out at most.

Energies are in k rad^2, on SE(3) in J of a spring of 1 N/m. The exit code is 1 where something does not hold.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial

import numpy as np

from manyhands.nodes.kernel.orientation import UPRIGHT, Quaternion, torque
from tests.support.turning import (
    SUBSTEPS,
    Array,
    Motions,
    Proxies,
    bound,
    hostile,
    least_energy,
    resonant,
    torques,
    violent,
)
from tests.support.turning_arm import Arm
from tests.support.turning_peers import geodesic, in_a_hole
from tests.support.twisting import Gantry, Mechanism, chain_at_random, curvature, leaks, longest_twist, ways

ROUNDING = 1e-12
BATCH = 250
TICKS = 12
DELAYS = (0, 1, 2, 4)
SEARCHED = 1.05
"""A search may miss the greatest kappa by a little."""
SWINGS = (0.15, 0.3, 0.6)
"""rad a tick, of the worst hand."""


def turning(delay: int, seed: int) -> tuple[int, float, int]:
    """Motions of a batch, the least energy at the limit, and how often the test held a step."""
    rng = np.random.default_rng([seed, delay])
    motions = violent(rng, BATCH, TICKS, delay, wobble=0.3)
    exerted, held = torques(motions, hostile(rng, BATCH, TICKS))
    b = bound(motions.latest, float(motions.lasts.sum(axis=2).max()))
    return BATCH, float(least_energy(motions, exerted, b).min()), held


def mechanism(rng: np.random.Generator) -> Mechanism:
    """A device of six axes."""
    kind = rng.integers(0, 3)
    if kind == 0:
        return Gantry(0.05 * rng.standard_normal(3), rng.uniform(0.2, 0.8), rng.uniform(0.03, 0.2))
    return chain_at_random(rng, wrist=kind == 1)


def turning_and_moving(delay: int, seed: int) -> tuple[int, float, float]:
    """Likewise of a device of six axes; and the greatest part of the damping that its torques asked for."""
    rng = np.random.default_rng([seed, delay, 6])
    of = mechanism(rng)
    kappa = SEARCHED * curvature(of, rng)
    force = 10.0 ** rng.uniform(-3.0, 0.0)
    moved = ways(of, rng, BATCH, TICKS, 10.0 ** rng.uniform(-3.0, -1.0) / kappa, delay)
    way = longest_twist(of, moved.q) * (1.0 + delay / SUBSTEPS)
    bend = kappa * force / (1.0 - kappa * way / 2.0)
    arm = Arm(of, 1.0, of.length**2 * 10.0 ** rng.uniform(-1.0, 1.0), force, bend, delay)
    given, paid = leaks(of, moved)
    paid *= (0.5 + 1.5 * delay / SUBSTEPS) * bend / force
    part = float((given[:, -1] / np.maximum(paid[:, -1], 1e-300)).max())
    excess = float((given - paid * (1.0 + 1e-9)).max())
    return BATCH, float(arm.least(rng, moved).min()), part if excess <= ROUNDING else math.inf


def worst(delay: int) -> tuple[float, float]:
    """The least energy of the worst pairs at the limit and at 1/1.3 of it, in parts of the tank."""
    found = [0.0, 0.0]
    for swing in SWINGS:
        motions, proposed = resonant(0.02, swing, delay, 1500)
        tank = 4e-4
        exerted, _ = torques(motions, proposed, tank=tank)
        for i, part in enumerate((1.0, 1.3)):
            least = float(least_energy(motions, exerted, bound(motions.latest) / part)[0])
            found[i] = min(found[i], least / tank)
    return found[0], found[1]


def untested(
    motions: Motions, proposed: Proxies, spring: Callable[[Quaternion, Quaternion], tuple[float, float, float]]
) -> Array:
    """The torques of a spring to whatever proxy is proposed."""
    samples = motions.samples.tolist()
    found = np.empty((*motions.samples.shape[:2], 3))
    for i, orientations in enumerate(samples):
        Q = UPRIGHT
        for k, numbers in enumerate(orientations):
            R = Quaternion(*numbers)
            Q = proposed(i, k, R, Q) or Q
            found[i, k] = spring(R, Q)
    return found


def hole(i: int, k: int, R: Quaternion, Q: Quaternion) -> Quaternion:
    """The nearest orientation that a hole allows to a tool."""
    return in_a_hole(R)


def peers(delay: int, seed: int) -> dict[tuple[str, str], float]:
    """The most that is given out at the certified damping, by world and by law, in k rad^2."""
    rng = np.random.default_rng([seed, delay, 3])
    hands = violent(rng, 4 * BATCH, TICKS, delay)
    found, b = {}, bound(hands.latest)
    for world, proposed in (("a hole", hole), ("one that jumps", hostile(rng, 4 * BATCH, TICKS))):
        for law, exerted in (
            ("tested, chordal", torques(hands, proposed)[0]),
            ("not tested, chordal", untested(hands, proposed, partial(torque, 1.0))),
            ("not tested, geodesic", untested(hands, proposed, geodesic)),
        ):
            found[world, law] = max(0.0, -float(least_energy(hands, exerted, b).min()))
    return found


def main() -> int:
    """Search, and print what came of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--motions", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--processes", type=int, default=2)
    given = parser.parse_args()
    began, holds = time.perf_counter(), True
    batches = -(-given.motions // (BATCH * len(DELAYS)))
    print("the worst pair of a hand and a world is in tanks, at b and at b/1.3\n")
    print(f"{'delay':>7} {'on':>6} {'motions':>8} {'least energy':>13} {'held':>8} {'worst, b':>9} {'b/1.3':>7}")
    with ProcessPoolExecutor(given.processes) as pool:
        for delay in DELAYS:
            seeds = [given.seed * 1_000_000 + n for n in range(batches)]
            flat = list(pool.map(partial(turning, delay), seeds))
            bent = list(pool.map(partial(turning_and_moving, delay), seeds))
            at_limit, beyond = worst(delay)
            least, least_bent = min(one[1] for one in flat), min(one[1] for one in bent)
            held = sum(one[2] for one in flat)
            name = f"{delay / SUBSTEPS:g} T"
            count = sum(one[0] for one in flat)
            print(f"{name:>7} {'SO(3)':>6} {count:8d} {least:13.2g} {held:8d} {at_limit:9.3f} {beyond:7.2f}")
            most = max(one[2] for one in bent)
            print(f"{name:>7} {'SE(3)':>6} {sum(o[0] for o in bent):8d} {least_bent:13.2g}", end=" ")
            print(f"; held torques asked for at most {most:.3f} of their damping", flush=True)
            holds &= min(least, least_bent) >= -ROUNDING and at_limit >= -1.0 - 1e-9 and beyond < -1.0 and most <= 1.0
        for delay in (0, SUBSTEPS // 2):
            print(f"\ngiven out at most at the certified damping, a delay of {delay / SUBSTEPS:g} T, k rad^2")
            for (world, law), most in peers(delay, given.seed).items():
                print(f"  {world:16} {law:22} {most:.3g}")
    print(f"{time.perf_counter() - began:.0f} s; {'all holds' if holds else 'SOMETHING DOES NOT HOLD'}")
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main())
