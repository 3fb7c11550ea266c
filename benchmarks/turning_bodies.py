"""Steps of bodies that turn and touch: which give out energy (`make turning-bodies`, decision 55).

1. Any step: three things deep in stiff contacts, with a violent past, make any step whatever. What the equations lack
   for it counts as force and torque from outside.
2. Pivots: things without mass turn on one contact whose depth stays what it is. Nothing may be gained, or lost.
3. Solved steps: the same things, with nothing from outside but the tool's hand. Steps that were not solved to 1e-9 m
   and rad are left out.

Energies are in parts of all energies and works of their step. The exit code is 1 where the scheme of the decision gives
out more than rounding, or another does not.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np

from tests.support.turning_bodies import Arms, Array, Kind, Normals, Scheme, hostile, pivots, solve, step

SCHEMES = {
    "mean arms": Scheme(),
    "mean arms, carried": Scheme(carried=True),
    "arms of the start": Scheme(arms=Arms.START),
    "arms of the end": Scheme(arms=Arms.END),
    "forces of the middle": Scheme(middle=True),
    "normals of the start": Scheme(normals=Normals.START),
}
HOLD = ("mean arms", "mean arms, carried")
"""Those that the theorem is about."""

ROUNDING = 1e-12
UNSOLVED = 1e-9
BATCH = 2000


def any_steps(scheme: Scheme, steps: int, seed: int) -> tuple[Array, float]:
    """What so many steps give out, and the least that a hand was credited beyond its spring's work, in parts."""
    rng = np.random.default_rng(seed)
    given, least = [], np.inf
    for _ in range(max(1, steps // BATCH)):
        taken = step(*hostile(rng, BATCH), scheme)
        given.append(taken.given_out / taken.scale)
        least = min(least, float((taken.lead / taken.scale).min()))
    return np.concatenate(given), least


def pivoted(scheme: Scheme, steps: int, seed: int) -> Array:
    """What pivots on walls, faces and edges give out, in parts."""
    rng = np.random.default_rng([seed, 1])
    given = []
    for _ in range(max(1, steps // BATCH // 3)):
        for kind in (Kind.PLANE, Kind.FACE, Kind.EDGE):
            taken = step(*pivots(rng, BATCH, kind), scheme)
            given.append(taken.given_out / taken.scale)
    return np.concatenate(given)


def solved(scheme: Scheme, steps: int, seed: int, batch: int = 250) -> tuple[Array, float]:
    """What solved steps give out, in parts, and the part of all that was solved."""
    rng = np.random.default_rng([seed, 2])
    given = []
    batches = max(1, steps // batch)
    for _ in range(batches):
        world, s, _ = hostile(rng, batch, 0.3)
        skew = rng.normal(size=(batch, 3, 3))
        compliance = skew - np.swapaxes(skew, 1, 2) + 0.5 * np.eye(3)
        compliance *= (10.0 ** rng.uniform(-6.0, -3.0, batch))[:, None, None]
        found = solve(world, compliance, s[:, 0], scheme)
        given.append((found.taken.given_out / found.taken.scale)[found.off < UNSOLVED])
    ended = np.concatenate(given)
    return ended, len(ended) / (batch * batches)


def main() -> int:
    """Print a row for each scheme."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=1_000_000, help="any steps, and a third as many pivots (1000000)")
    parser.add_argument("--solved", type=int, default=1000, help="solved steps (1000)")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    say, holds = print, True
    say("scheme: any steps, part that gives out, most; pivots, most, least; solved, part of those that gives out,")
    say("most; least credit to a hand beyond its spring's work; seconds")
    for name, scheme in SCHEMES.items():
        began = time.perf_counter()
        free, credit = any_steps(scheme, given.steps, given.seed)
        turned = pivoted(scheme, given.steps // 3, given.seed)
        ended, part = solved(scheme, given.solved, given.seed)
        worst = max(float(free.max()), float(turned.max()))
        holds &= (worst <= ROUNDING and credit >= -ROUNDING) == (name in HOLD)
        holds &= name not in HOLD or float(ended.max()) <= UNSOLVED
        say(
            f"{name:22} {len(free):8} {np.mean(free > ROUNDING):8.2%} {free.max():9.2g}   {len(turned):7} "
            f"{turned.max():9.2g} {turned.min():9.2g}   {len(ended):5} ({part:.0%}) "
            f"{np.mean(ended > UNSOLVED):7.2%} {ended.max():9.2g}   {credit:9.2g} "
            f"{time.perf_counter() - began:6.0f} s",
            flush=True,
        )
    say("all as the decision says" if holds else "NOT AS THE DECISION SAYS")
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main())
