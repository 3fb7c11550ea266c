"""What a refusal states, against design itself: each limit has to be where design begins to refuse, within 1 %.

python -m tests.attack.limits --refusals 200
"""

from __future__ import annotations

import argparse
import re
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from manyhands.design.errors import DesignError, Infeasible
from manyhands.design.limits import IN_PROPORTION
from manyhands.design.models.coupling import Partition, SpringDamper
from manyhands.design.models.declared import DeclaredEnvironment
from manyhands.design.models.environment import DelayedNetwork, NetworkBox, TransferEnvironment
from manyhands.design.models.kind import Environment
from manyhands.design.models.network import GROUND, Network, NetworkLink
from manyhands.design.models.statespace import StateSpace
from manyhands.design.problem import DeviceLevel, HapticLoop, LinearGiven, SpringDamperGiven
from manyhands.design.series import counted_parts
from manyhands.design.synthesis import design
from manyhands.design.wave_link import WaveLinkFace, wave_link_id

Generator = np.random.Generator
WITHIN = 0.01


class Case(NamedTuple):
    """A loop with a coupling that may be too stiff: every block is a number times the identity.

    Attributes:
        loop: the haptic loop.
        stiffness: of each block, N/m.
        damping: of each block, N*s/m.
        linear: whether the blocks are given as state spaces.
    """

    loop: HapticLoop
    stiffness: tuple[float, ...]
    damping: tuple[float, ...]
    linear: bool

    def refusal(self) -> DesignError | None:
        """Why design refuses it; None if it is certified."""
        parts = self.loop.partition.blocks
        springs = [
            SpringDamper(k * np.eye(len(own)), b * np.eye(len(own)))
            for own, k, b in zip(parts, self.stiffness, self.damping, strict=True)
        ]
        try:
            if self.linear:
                blocks: tuple[StateSpace, ...] = tuple(part.realisation(self.loop.period) for part in springs)
                design(self.loop, LinearGiven(blocks))
            else:
                embed = self.loop.partition.embed
                whole = SpringDamper(embed([part.stiffness for part in springs]), embed([p.damping for p in springs]))
                design(self.loop, SpringDamperGiven(whole))
        except DesignError as error:
            return error
        return None


def random_case(rng: Generator) -> Case:
    """One to three ports, any world, delay, tolerance and device; mostly too stiff."""
    sizes = [[1], [1], [1, 1], [2], [1, 2]][int(rng.integers(5))]
    m, T = sum(sizes), float(rng.choice([1e-3, 5e-4, 2e-3]))
    ports = tuple(f"p{i}" for i in range(m))
    starts = np.cumsum([0, *sizes])
    blocks = tuple(tuple(range(a, b)) for a, b in pairwise(starts.tolist()))
    partition = Partition(tuple(f"c{i}" for i in range(len(sizes))), blocks)
    osp = float(10.0 ** rng.uniform(-0.5, 0.7))
    own = [osp if rng.random() < 0.7 else osp * float(rng.uniform(0.5, 2.0)) for _ in sizes]
    tau = float(rng.choice([0.0, rng.uniform(0.05, 1.0)])) * T
    tolerance = float(rng.choice([0.0, 0.0, rng.uniform(0.01, 0.5)]))
    loop = HapticLoop(
        session="limits",
        period=T,
        ports=ports,
        devices=tuple(
            DeviceLevel(f"d{i}", block, level * np.eye(len(block)))
            for i, (block, level) in enumerate(zip(blocks, own, strict=True))
        ),
        partition=partition,
        environment=_world(rng, ports, osp, len(sizes) == 1),
        tau=tau,
        period_tolerance=tolerance,
    )
    if rng.random() < 0.2 and type(loop.environment) is Network:
        loop = replace(loop, series=counted_parts(loop))
    linear = rng.random() < 0.15 and not loop.series
    limit = 1.0 / (T * (0.5 * (1.0 + tolerance) + 1.5 * tau / T))
    stiffness = tuple(level * limit * float(10.0 ** rng.uniform(-0.3, 0.7)) for level in own)
    damping = tuple(level * float(rng.choice([0.0, 0.01, rng.uniform(0.0, 0.6)])) for level in own)
    return Case(loop, stiffness, damping, linear)


def _world(rng: Generator, ports: tuple[str, ...], osp: float, alone: bool) -> Environment:
    m = len(ports)
    links = tuple(
        NetworkLink((port, "hub" if rng.random() < 0.7 else GROUND), float(10.0 ** rng.uniform(2, 4)), 0.2)
        for port in ports
    )
    ground = NetworkLink(("hub", GROUND), 1000.0, 0.5)
    network = Network(ports, (("hub", 1.0),), (*links, ground))
    kind = int(rng.integers(6))
    if kind == 0:
        soft = tuple(NetworkLink(link.ends, link.stiffness * 0.03, link.damping) for link in network.links)
        return DelayedNetwork(Network(ports, network.masses, soft), 1)
    if kind == 1:
        return DeclaredEnvironment(ports, float(rng.uniform(0.0, 0.3)) * osp * np.eye(m))
    if kind == 2:
        entries = tuple(
            tuple(((2.0, 300.0) if i == j else (0.0,), (0.01, 1.0) if i == j else (1.0,)) for j in range(m))
            for i in range(m)
        )
        return TransferEnvironment(ports, entries, "backward-euler")
    if kind == 3 and alone:
        b = 20.0 * np.eye(m)
        name = wave_link_id("limits", "c0", ports, b, 0.01)
        theta = tuple(float(rng.choice([0.0, 0.1])) * osp for _ in ports)
        return WaveLinkFace(ports, id=name, b=b, tank=0.01, harvest=theta, round_trip=None, mass=None)
    if kind == 4:
        stiff = tuple(NetworkLink(link.ends, 2.0 * link.stiffness, link.damping) for link in network.links)
        return NetworkBox(network, Network(ports, network.masses, stiff))
    return network


def faults(case: Case, error: DesignError) -> list[str]:
    """What a refusal states that is not so, by design itself: what does not help, or goes too far."""
    found = []
    for way in error.relax if isinstance(error, Infeasible) else ():
        for by, expected in ((-WITHIN, True), (WITHIN, False)):
            changed = _changed(case, way, 1.0 + by)
            if changed is not None and (changed.refusal() is None) != expected:
                found.append(f"{way}: {'not enough' if expected else 'more than is needed'}")
    return found


def _changed(case: Case, way: str, by: float) -> Case | None:
    """The case with a change by the stated figure, nearer to what is refused by a factor; None if it has no figure."""
    names, loop = case.loop.partition.names, case.loop
    if match := re.fullmatch(r"a stiffness( plus 2/T times its damping)? below (.*)", way):
        whole = match[1] or way.endswith(IN_PROPORTION)
        stated = re.findall(r"([\d.e+]+) N/m(?: at (\w+))?", match[2])
        stiffness, damping = list(case.stiffness), list(case.damping)
        for i, name in enumerate(names):
            figure = next((float(x) for x, at in stated if at in ("", name)), np.inf) * by
            has = stiffness[i] + (2.0 / loop.period * damping[i] if match[1] else 0.0)
            if has > figure:
                stiffness[i] *= figure / has
                damping[i] *= figure / has if whole else 1.0
        return case._replace(stiffness=tuple(stiffness), damping=tuple(damping))
    if match := re.fullmatch(r"devices with an osp above ([\d.e+-]+) N\*s/m", way):
        least = float(match[1]) / by
        devices = tuple(replace(d, level=d.level * max(1.0, least / d.level[0, 0])) for d in loop.devices)
        return case._replace(loop=replace(loop, devices=devices))
    if match := re.fullmatch(r"a period below ([\d.e+-]+) ms", way):
        return case._replace(loop=replace(loop, period=float(match[1]) * 1e-3 * by))
    return None


def main() -> int:
    """Search, and print what is not so."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--refusals", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    rng = np.random.default_rng(given.seed)
    refusals = figures = wrong = tried = 0
    while refusals < given.refusals:
        case = random_case(rng)
        tried += 1
        error = case.refusal()
        if not isinstance(error, Infeasible) or not any(_changed(case, way, 1.0) for way in error.relax):
            continue
        refusals += 1
        figures += sum(_changed(case, way, 1.0) is not None for way in error.relax)
        for fault in faults(case, error):
            wrong += 1
            print(f"{fault}\n  {error}\n  {case}")  # noqa: T201 -- what a campaign is for
    print(f"{tried} sessions, {refusals} refusals with {figures} figures, {wrong} of them wrong")  # noqa: T201
    return int(wrong > 0)


if __name__ == "__main__":
    raise SystemExit(main())
