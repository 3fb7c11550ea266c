"""Theorem 4 by cone complementarity linearisation: it converges, in structure, and its coupling is certified."""

import re
from dataclasses import replace

import numpy as np
import pytest

from manyhands.design.errors import Infeasible
from manyhands.design.levels.contract import loop_inequality
from manyhands.design.models.coupling import Partition, SpringDamper
from manyhands.design.models.environment import DelayedNetwork
from manyhands.design.models.network import GROUND, Network, NetworkLink
from manyhands.design.models.statespace import Matrix, symmetric_part
from manyhands.design.problem import DeviceLevel, HapticLoop
from manyhands.design.theorem3 import certify_given, devices
from manyhands.design.theorem4 import TOLERANCE, BlockUnknowns, Interrupted, StoppedShort, design_spring_damper


def storage_of(K_s: Matrix, J: Matrix, K: Matrix, T: float) -> Matrix:
    """The known storage of a spring-damper's V_hat, in the state (zeta, f of the tick before) of (12).

    zeta^T J^-1 zeta / 2 + ((f - zeta)^T K_s^-1 (f - zeta) - f^T K f) / (2T); zeta = B u, u the deflection's velocity.
    """
    soft = np.linalg.inv(K_s) / (2.0 * T)
    return np.block([[np.linalg.inv(J) / 2.0 + soft, -soft], [-soft, soft - K / (2.0 * T)]])


def violation(problems, m: int, kappa: float, part: float = 0.99) -> float:
    """By how much springs and dampers, with ``part`` of their greatest level, violate (15), (16), (18) for a gain.

    Ports where Delta_D = I, so that the true gain is 1/2; noncommuting K_s and B.
    """
    rng, T = np.random.default_rng(m), problems.T
    turn, _ = np.linalg.qr(rng.normal(size=(m, m)))
    K_s = 2.0 / T * symmetric_part(turn @ np.diag(rng.uniform(0.2, 0.6, m)) @ turn.T)
    B = np.diag(rng.uniform(0.05, 0.3, m))
    V = SpringDamper(K_s, B).realisation(T)
    J, _, greatest = problems.greatest_level(np.eye(m), SpringDamper(K_s, B), T)
    P = symmetric_part(storage_of(K_s, J, T / 2.0 * np.eye(m), T))
    block = BlockUnknowns.spring_damper(m)
    block.A.value, block.C.value = V.A, symmetric_part(V.C)
    block.levels.Z.value, block.levels.W.value = part * greatest, symmetric_part(np.linalg.inv(part * greatest))
    block.storage.Z.value, block.storage.W.value = P, symmetric_part(np.linalg.inv(P))
    conditions = [*block.constraints(kappa), *(pair.cone() for pair in block.pairs)]
    return max(float(np.max(c.violation())) for c in conditions)


@pytest.mark.parametrize("m", [1, 2, 3])
def test_the_inequality_of_a_block_is_lemma_1_rewritten(problems, m: int) -> None:
    """A storage known in closed form satisfies Lemma 2's inequality, and not at another gain or a greater level.

    With P's entries near 1, rounding is below 1e-12.
    """
    assert violation(problems, m, 0.5) < 1e-12
    assert min(violation(problems, m, kappa) for kappa in (0.45, 0.55)) > 1e-4
    assert violation(problems, m, 0.5, part=1.01) > 1e-4


def check(problems, loop: HapticLoop, most: int = 20) -> SpringDamper:
    """Design, and hold the result against what Theorem 4 promises, without the solver."""
    told: list[str] = []
    coupling, convergence = design_spring_damper(loop, told.append)
    assert convergence.residuals[-1] < TOLERANCE == 1e-4
    assert convergence.iterations <= most
    assert told == [f"iteration {i}, |WZ - I| = {r:.1e}" for i, r in enumerate(convergence.residuals)]
    for M in (coupling.stiffness, coupling.damping):
        assert loop.partition.admits(M)
        np.testing.assert_array_equal(M, M.T)
    J, J_minus_B, greatest = problems.greatest_level(loop.Delta_D, coupling, loop.period)
    assert all(np.linalg.eigvalsh(M)[0] > 0.0 for M in (J, J_minus_B, greatest, coupling.stiffness))
    assert margin(loop, coupling) > 0.0
    return coupling


def margin(loop: HapticLoop, coupling: SpringDamper) -> float:
    """The least eigenvalue of (10), by the levels that Theorem 3 finds for the coupling."""
    levels = certify_given(loop, coupling.restrict(loop.partition))
    Delta_G = levels.device.share * loop.Delta_D
    condition_10 = loop_inequality(Delta_G, loop.partition.embed(levels.Delta_V), levels.Phi_E)
    return float(np.linalg.eigvalsh(condition_10)[0])


@pytest.mark.parametrize("name", ["decentralised", "centralised"])
def test_example_1(problems, name: str) -> None:
    check(problems, problems.example_1(getattr(problems, name)), most=11)


def test_a_block_that_joins_two_ports_around_a_third(problems) -> None:
    coupling = check(problems, problems.example_1(Partition(("outer", "inner"), ((2, 0), (1,)))))
    assert coupling.stiffness[0, 2] != 0.0
    assert coupling.stiffness[0, 1] == coupling.stiffness[1, 2] == 0.0


@pytest.mark.parametrize("blocks", [((0, 1),), ((1,), (0,))], ids=["whole", "split"])
def test_a_device_of_two_axes_with_a_full_level(problems, blocks) -> None:
    network = Network(
        ("d.x", "d.y"),
        (("ball", 0.4),),
        (
            NetworkLink(("d.x", "ball"), 900.0, 0.2),
            NetworkLink(("d.y", "ball"), 500.0, 0.0),
            NetworkLink(("ball", GROUND), 50.0, 0.1),
        ),
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
        ((), (NetworkLink(("p0", GROUND), 0.0, 2.0),)),
        ((("m", 1.0),), (NetworkLink(("p0", "m"), 0.0, 1.0),)),
        ((("m", 10.0),), (NetworkLink(("p0", GROUND), 4600.0, 1.8), NetworkLink(("m", "p0"), 0.5, 0.0))),
    ],
    ids=["stateless", "floating", "slow undamped mass"],
)
def test_environments_at_the_edge(problems, masses, links) -> None:
    network = Network(("p0",), masses, links)
    check(problems, problems.loop(network, Partition(("c",), ((0,),)), [0.3], 2.5e-4))


def spring_late(problems, stiffness: float) -> HapticLoop:
    """One device against a spring to ground whose force is a tick late: Phi_E >= stiffness T / 2."""
    network = DelayedNetwork(Network(("p0",), (), (NetworkLink(("p0", GROUND), stiffness, 0.0),)), 1)
    device = DeviceLevel("d", (0,), np.array([[1.37]]))
    return HapticLoop("late", problems.T, ("p0",), (device,), Partition(("c",), ((0,),)), network)


def test_an_environment_that_is_not_passive(problems) -> None:
    """(10) binds: with Phi_E >= 1, the coupling's level has to exceed Phi_E + Phi_E^2/(Delta_D - Phi_E) = 3.7."""
    loop = spring_late(problems, 2000.0)
    coupling = check(problems, loop)
    *_, greatest = problems.greatest_level(loop.Delta_D, coupling, loop.period)
    assert greatest[0, 0] > 1.0 + 1.0 / 0.37


def test_an_environment_that_no_coupling_helps(problems) -> None:
    """Phi_E >= 1.5 exceeds Delta_D = 1.37, and one tick of delay in Example 1 does too."""
    example_1 = replace(problems.example_1(), environment=DelayedNetwork(problems.network, 1))
    for loop in (spring_late(problems, 3000.0), example_1):
        with pytest.raises(Infeasible, match=r"no coupling .* E_hat \+ Delta_D is not passive"):
            design_spring_damper(loop)


@pytest.mark.parametrize("share", [0.3, 0.8])
def test_the_environment_may_use_what_the_delay_leaves_of_the_device(problems, share: float) -> None:
    """Phi_E < share Delta_D: a spring that is a tick late may have 2 share Delta_D / T."""
    limit = 2.0 * share * 1.37 / problems.T
    design_spring_damper(spring_late(problems, 0.9 * limit), share=share)
    with pytest.raises(Infeasible, match=f"with {share} of Delta_D left by the delay"):
        design_spring_damper(spring_late(problems, 1.1 * limit), share=share)


@pytest.mark.parametrize("name", ["decentralised", "centralised"])
def test_a_delay_inside_the_tick(problems, name: str) -> None:
    """The gain bounds the stiffness by Delta_D / (kappa T), and the coupling is certified for the delay."""
    loop = replace(problems.example_1(getattr(problems, name)), tau=0.3 * problems.T)
    device = devices(loop)[0]
    assert device.kappa > 0.9
    coupling, _ = design_spring_damper(loop, kappa=device.kappa, share=device.share)
    stiffest = float(np.linalg.eigvalsh(coupling.stiffness)[-1])
    assert 0.1 < stiffest * device.kappa * problems.T / problems.osp < 1.0
    assert margin(loop, coupling) > 0.0


def test_the_cap_hands_on_what_there_is(problems) -> None:
    """The coupling of an early iterate is not what complementarity proves, but Theorem 3 may."""
    loop = problems.example_1()
    with pytest.raises(StoppedShort, match=r"Theorem 4: stopped after 4 iterations at .*wanted < 1e-04") as error:
        design_spring_damper(loop, iterations=4)
    assert error.value.convergence.iterations == 4
    assert isinstance(error.value.best, SpringDamper)
    assert margin(loop, error.value.best) > 0.0


def test_ctrl_c_hands_on_what_there_is(problems) -> None:
    def progress(text: str) -> None:
        if re.match("iteration 3,", text):
            raise KeyboardInterrupt

    with pytest.raises(Interrupted) as error:
        design_spring_damper(problems.example_1(), progress)
    assert margin(problems.example_1(), error.value.best) > 0.0


@pytest.mark.parametrize("options", [{"kappa": 0.0}, {"share": -1.0}, {"kappa": float("nan")}, {"share": float("inf")}])
def test_gains_that_cannot_be(problems, options: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="expected finite ones > 0"):
        design_spring_damper(problems.example_1(), **options)
