"""Networks whose links span 15 to 22 decades: their energy proves them, whatever floats can compute of them."""

from __future__ import annotations

import numpy as np
import pytest

from manyhands.design.errors import DesignError, SolverFailure
from manyhands.design.levels.contract import ENERGY
from manyhands.design.levels.floats import within_floats
from manyhands.design.models.coupling import Partition
from manyhands.design.models.environment import NetworkBox
from manyhands.design.models.kind import Environment
from manyhands.design.models.network import GROUND, Network, NetworkLink
from manyhands.design.problem import DeviceLevel, HapticLoop, SpringDamperWanted, Wish
from manyhands.design.synthesis import design
from manyhands.design.world import world_terms
from manyhands.design.world_synthesis import design_world

from ..support.cases import cases, searched


def far_apart(rng: np.random.Generator) -> Environment:
    """One to three ports and up to three masses, joined at random, now and then known up to intervals."""
    m, n = int(rng.integers(1, 4)), int(rng.integers(0, 4))
    ports, masses = tuple(f"p{i}" for i in range(m)), [f"m{i}" for i in range(n)]
    least = float(rng.uniform(-8.0, -2.0))
    most = least + float(rng.uniform(15.0, 22.0))
    links = []
    for end in [*ports, *masses]:
        others = [other for other in [*ports, *masses, GROUND] if other != end]
        for other in sorted({str(x) for x in rng.choice(others, size=rng.integers(1, 3))}):
            damping = 10.0 ** rng.uniform(least - 3.0, most - 3.0) * float(rng.random() < 0.6)
            links.append(NetworkLink((end, other), 10.0 ** rng.uniform(least, most), damping))
    low = Network(ports, tuple((name, 10.0 ** rng.uniform(-6.0, 6.0)) for name in masses), tuple(links))
    if rng.random() < 0.7:
        return low
    f = 1.0 + float(rng.exponential(2.0))
    stiffer = tuple(NetworkLink(a.ends, f * a.stiffness, f * a.damping) for a in links)
    return NetworkBox(low, Network(ports, low.masses, stiffer))


def loop_of(rng: np.random.Generator, world: Environment) -> HapticLoop:
    m = len(world.ports)
    devices = tuple(DeviceLevel(f"d{i}", (i,), np.array([[10.0 ** rng.uniform(-1.0, 1.0)]])) for i in range(m))
    blocks = Partition(tuple(f"c{i}" for i in range(m)), tuple((i,) for i in range(m)))
    if rng.random() < 0.4:
        blocks = Partition(("c",), (tuple(range(m)),))
    return HapticLoop("far", 1e-3, world.ports, devices, blocks, world, float(rng.choice([0.0, 3e-4])))


@pytest.mark.wide
def test_every_network_is_certified() -> None:
    for seed in range(searched(12, 60)):
        rng = np.random.default_rng([7, seed])
        loop = loop_of(rng, far_apart(rng))
        design(loop, SpringDamperWanted(Wish("feasible" if seed % 2 else "stiffest")))  # or it raises


@pytest.mark.parametrize("high", [1.0, 2.0])
def test_a_millionth_beside_a_million_millions(high: float) -> None:
    """1e-6 beside 1e12 N/m: K is singular in floats, and so is Z."""
    spans = ((("p", "m"), 1e12), (("m", "n"), 1e-6), (("n", GROUND), 1e12), (("m", GROUND), 1e-6))
    masses = (("m", 1e-3), ("n", 1e-3))
    low, top = (Network(("p",), masses, tuple(NetworkLink(e, f * k, 0.0) for e, k in spans)) for f in (1.0, high))
    world = low if high == 1.0 else NetworkBox(low, top)
    loop = HapticLoop("far", 1e-3, ("p",), (DeviceLevel("d", (0,), np.eye(1)),), Partition(("c",), ((0,),)), world)
    found = design(loop, SpringDamperWanted()).certificate
    assert found.levels.P_E is ENERGY or high == 1.0


def test_worlds_of_wave_links_too() -> None:
    for seed in range(cases(6, 20)):
        world = far_apart(np.random.default_rng([11, seed]))
        m = len(world.ports)
        blocks = Partition(tuple(f"c{i}" for i in range(m)), tuple((i,) for i in range(m)))
        links = {name: (np.eye(1), 0.01) for name in blocks.names[1:]}
        design_world(world_terms("far", 1e-3, world, blocks, links))


def test_an_error_of_arithmetic_is_one_refusal_with_the_span() -> None:
    world = Network(("p",), (), (NetworkLink(("p", GROUND), 2e-6, 0.0), NetworkLink(("p", GROUND), 3e12, 0.0)))
    with pytest.raises(SolverFailure, match=r"Singular matrix.*from 2e-06 to 3e\+12 N/m"), within_floats(world):
        np.linalg.inv(np.zeros((1, 1)))
    with pytest.raises(SolverFailure, match="too far apart"), within_floats(world):
        raise OverflowError
    with pytest.raises(ValueError, match="as it was"), within_floats(world):  # no other error is renamed
        raise ValueError("as it was")
    assert issubclass(SolverFailure, DesignError)  # exit code 3
