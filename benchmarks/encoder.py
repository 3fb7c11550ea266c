"""Random linear loops whose devices measure in steps, and hands that look for energy in them (`make encoder`).

Each loop is a network of springs, dampers and masses with a coupling that is designed and proved. Its devices burn the
dry friction that the certificate asks for, c = w, and not more; 96 hands of :mod:`tests.support.quantised` move for 300
ticks each. None may be given any energy. The same hands then have 2/3 of that friction, which says how hard they look:
where every loop is one spring between a hand and a wall, they find energy in each.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np

from manyhands.design.certificate import Certificate
from manyhands.design.errors import DesignError
from manyhands.design.models.coupling import Partition, SpringDamper
from manyhands.design.models.network import GROUND, Network, NetworkLink
from manyhands.design.problem import (
    CouplingRequest,
    DeviceLevel,
    HapticLoop,
    SpringDamperGiven,
    SpringDamperWanted,
    Wish,
)
from manyhands.design.synthesis import design
from tests.support.quantised import Hands, most_given

ENOUGH = 1e3  # N: friction that covers every step, to learn what is asked for


def random_loop(rng: np.random.Generator) -> HapticLoop:
    """One to three users at a network of up to three masses, with encoders of 1 to 100 um; some ports have none."""
    m, n = int(rng.integers(1, 4)), int(rng.integers(0, 4))
    ports, masses = (
        tuple(f"p{i}" for i in range(m)),
        tuple((f"m{i}", float(10 ** rng.uniform(-2, 1))) for i in range(n)),
    )
    ends = [*ports, *(name for name, _ in masses)]
    links = []
    for end in (*ends, *rng.choice(ends, size=rng.integers(0, 3)).tolist()):
        other = str(rng.choice([e for e in (*ends, GROUND, GROUND) if e != end]))
        stiffness, damping = 10 ** rng.uniform(1, 4.5), 10 ** rng.uniform(-2, 1)
        links.append(NetworkLink((str(end), other), float(stiffness), float(damping)))
    steps = [(float(10 ** rng.uniform(-6, -4)),) if i == 0 or rng.random() < 0.8 else None for i in range(m)]
    T = float(rng.choice([2.5e-4, 1e-3]))
    return HapticLoop(
        session="random",
        period=T,
        ports=ports,
        devices=tuple(
            DeviceLevel(port, (i,), np.array([[10 ** rng.uniform(-1, 0.5)]]), None, step, (ENOUGH,))
            for i, (port, step) in enumerate(zip(ports, steps, strict=True))
        ),
        partition=Partition(tuple(f"c{i}" for i in range(m)), tuple((i,) for i in range(m))),
        environment=Network(ports, masses, tuple(links)),
        tau=float(rng.choice([0.0, 0.3, 1.0])) * T,
    )


def spring(rng: np.random.Generator) -> Certificate:
    """One spring between a hand and a wall."""
    K, q = float(rng.uniform(200.0, 900.0)), float(10 ** rng.uniform(-6, -4))
    wall = Network(("p0",), (), (NetworkLink(("p0", GROUND), 1e4, 0.0),))
    devices = (DeviceLevel("p0", (0,), np.array([[1.0]]), None, (q,), (ENOUGH,)),)
    loop = HapticLoop("spring", 1e-3, ("p0",), devices, Partition(("c0",), ((0,),)), wall)
    return design(loop, SpringDamperGiven(SpringDamper(np.array([[K]]), np.array([[0.0]])))).certificate


def certified(rng: np.random.Generator) -> Certificate | None:
    """The certificate of a random loop, with one of two aims; None where there is none, or it bounds no steps."""
    loop = random_loop(rng)
    wanted: CouplingRequest = SpringDamperWanted(Wish("stiffest" if rng.random() < 0.5 else "feasible"))
    try:
        found = design(loop, wanted).certificate
    except DesignError:
        return None
    return found if found.encoder is not None and found.encoder.covered else None


def main() -> int:
    """Search in so many loops and single springs; returns 1 where a hand was given energy."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--loops", type=int, default=1000)
    parser.add_argument("--springs", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    began, rng = time.monotonic(), np.random.default_rng(options.seed)
    searched = without = fewer = 0
    most = 0.0
    while searched < options.loops:
        found = certified(rng)
        if found is None or found.encoder is None or found.encoder.force is None:
            without += 1
            continue
        w, hands = np.array(found.encoder.force), Hands(seed=searched)
        most = max(most, most_given(found, w, hands))
        fewer += most_given(found, w / 1.5, hands) > 0.0
        searched += 1
    springs = [spring(rng) for _ in range(options.springs)]
    forces = [np.array(one.encoder.force) for one in springs if one.encoder is not None]
    hands = Hands(count=400, ticks=2000)
    of_springs = max((most_given(one, w, hands) for one, w in zip(springs, forces, strict=True)), default=0.0)
    given = sum(most_given(one, w / 1.5, hands) > 0.0 for one, w in zip(springs, forces, strict=True))
    print(
        f"{searched} loops ({without} more without a certificate that bounds steps), {time.monotonic() - began:.0f} s"
    )
    print(f"c = w: the most that a hand was given is {most:.3g} J; in single springs {of_springs:.3g} J")
    print(f"c = w/1.5: a hand was given energy in {fewer} of the loops, and in {given} of {len(springs)} springs")
    return int(most > 0.0 or of_springs > 0.0 or given < len(springs))


if __name__ == "__main__":
    sys.exit(main())
