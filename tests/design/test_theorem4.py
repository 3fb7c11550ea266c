"""Theorem 4 by cone complementarity linearisation: it converges, in structure, and its coupling is certified."""

import numpy as np
import pytest

from manyhands.design.contract import loop_inequality
from manyhands.design.network import GROUND, Link, Network
from manyhands.design.partition import Partition
from manyhands.design.problem import DeviceLevel, HapticLoop
from manyhands.design.statespace import symmetric_part
from manyhands.design.theorem3 import certify_given
from manyhands.design.theorem4 import TOLERANCE, _Block, design_spring_damper


def violation(problems, K_loop: float) -> float:
    """By how much (26), with the level and storage that prove it, violates (15), (16), (18) for a loop gain."""
    loop = problems.example_1()
    V, T = problems.blocks(loop, problems.C26)[0], loop.period
    levels = certify_given(loop, problems.blocks(loop, problems.C26))
    P, Delta = levels.P_V[0], levels.Delta_V[:1, :1]
    block = _Block.of(1)
    block.A_V.value, block.C_V.value, block.Delta.value, block.Sigma.value = V.A, V.C, Delta, 1.0 / Delta
    block.Y.value, block.Q.value = (P + P.T) / 2.0, symmetric_part(np.linalg.inv(P))
    return max(float(np.max(c.violation())) for c in block.constraints(np.array([[K_loop]]), T))


def test_the_inequality_of_a_block_is_lemma_1_rewritten(problems) -> None:
    """What Theorem 3 proves with Lemma 1 satisfies Lemma 2's inequality, and does not at another loop gain."""
    gain = problems.T / 2.0 / problems.osp
    assert violation(problems, gain) < 1e-7
    assert min(violation(problems, factor * gain) for factor in (0.9, 1.1)) > 1e-5


def check(problems, loop: HapticLoop) -> None:
    """Design, and hold the result against what Theorem 4 promises, without the solver."""
    told: list[tuple[int, float]] = []
    coupling, convergence = design_spring_damper(loop, lambda i, residual: told.append((i, residual)))
    assert convergence.residuals[-1] < TOLERANCE == 1e-4
    assert convergence.iterations <= 20
    assert told == list(enumerate(convergence.residuals))
    for M in (coupling.stiffness, coupling.damping):
        assert loop.partition.admits(M)
        np.testing.assert_array_equal(M, M.T)
    J, J_minus_B, greatest = problems.greatest_level(loop.Delta_D, coupling, loop.period)
    assert all(np.linalg.eigvalsh(M)[0] > 0.0 for M in (J, J_minus_B, greatest, coupling.stiffness))
    levels = certify_given(loop, problems.blocks(loop, coupling))
    condition_10 = loop_inequality(loop.Delta_D, levels.Delta_V, levels.Phi_E)
    m = len(loop.ports)
    np.testing.assert_allclose(condition_10[:m, m:], -levels.Phi_E)
    np.testing.assert_allclose(condition_10[m:, m:], levels.Delta_V - levels.Phi_E)
    assert np.linalg.eigvalsh(condition_10)[0] > 0.0


@pytest.mark.parametrize("name", ["decentralised", "centralised"])
def test_example_1(problems, name: str) -> None:
    check(problems, problems.example_1(getattr(problems, name)))


def test_a_block_that_joins_two_ports_around_a_third(problems) -> None:
    partition = Partition(("outer", "inner"), ((2, 0), (1,)))
    loop = problems.example_1(partition)
    check(problems, loop)
    coupling, _ = design_spring_damper(loop)
    assert coupling.stiffness[0, 2] != 0.0
    assert coupling.stiffness[0, 1] == coupling.stiffness[1, 2] == 0.0


@pytest.mark.parametrize("blocks", [((0, 1),), ((1,), (0,))], ids=["whole", "split"])
def test_a_device_of_two_axes_with_a_full_level(problems, blocks) -> None:
    network = Network(
        ("d.x", "d.y"),
        (("ball", 0.4),),
        (Link(("d.x", "ball"), 900.0, 0.2), Link(("d.y", "ball"), 500.0, 0.0), Link(("ball", GROUND), 50.0, 0.1)),
    )
    device = DeviceLevel("d", (0, 1), np.array([[1.5, 0.3], [0.3, 1.2]]))
    partition = Partition(tuple("ab"[: len(blocks)]), blocks)
    check(problems, HapticLoop("planar", 1e-3, network.ports, (device,), partition, network))


@pytest.mark.parametrize(("osp", "T"), [(0.05, 1e-3), (30.0, 1e-3), (1.37, 2.5e-4), (1.37, 1e-2), (0.05, 1e-2)])
def test_other_scales(problems, osp: float, T: float) -> None:
    check(problems, problems.example_1(osp=osp, T=T))


def test_devices_of_unlike_levels(problems) -> None:
    check(problems, problems.loop(problems.network, problems.decentralised, [0.05, 1.37, 20.0], 1e-3))


@pytest.mark.parametrize(
    ("masses", "links"),
    [
        ((), (Link(("p0", GROUND), 0.0, 2.0),)),
        ((("m", 1.0),), (Link(("p0", "m"), 0.0, 1.0),)),
        ((("m", 10.0),), (Link(("p0", GROUND), 4600.0, 1.8), Link(("m", "p0"), 0.5, 0.0))),
    ],
    ids=["stateless", "floating", "slow undamped mass"],
)
def test_environments_at_the_edge(problems, masses, links) -> None:
    network = Network(("p0",), masses, links)
    check(problems, problems.loop(network, Partition(("c",), ((0,),)), [0.3], 2.5e-4))
