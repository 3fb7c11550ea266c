"""Theorem 4 for linear couplings: any order, any partition, certified by Theorem 3 and stable with a real device."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from manyhands.design.errors import Infeasible, TooLarge
from manyhands.design.levels.contract import loop_inequality
from manyhands.design.models.coupling import Partition, transformed_coupling
from manyhands.design.models.environment import DelayedNetwork
from manyhands.design.models.network import GROUND, Network, NetworkLink
from manyhands.design.models.statespace import Matrix, StateSpace, storage_inequality, symmetric_part
from manyhands.design.problem import DeviceLevel, HapticLoop
from manyhands.design.theorem3 import certify_given, devices
from manyhands.design.theorem4 import (
    MOST_STATES,
    TOLERANCE,
    BlockUnknowns,
    LinearCoupling,
    StoppedShort,
    design_linear,
    linear_unknowns,
    recover_linear,
)


def margin(loop: HapticLoop, coupling: LinearCoupling) -> float:
    """The least eigenvalue of (10), by the levels that Theorem 3 finds for the coupling."""
    levels = certify_given(loop, coupling.blocks)
    Delta_G = levels.device.share * loop.Delta_D
    condition_10 = loop_inequality(Delta_G, loop.partition.embed(levels.Delta_V), levels.Phi_E)
    return float(np.linalg.eigvalsh(condition_10)[0])


def masses_with_damping(loop: HapticLoop, mass: float) -> StateSpace:
    """Devices as masses (kg) with exactly the damping Delta_D, sampled: displacement from held force."""
    m, T = len(loop.ports), loop.period
    A = np.block([[np.zeros((m, m)), np.eye(m)], [np.zeros((m, m)), -loop.Delta_D / mass]])
    B = np.vstack([np.zeros((m, m)), np.eye(m) / mass])
    held = expm(np.block([[A, B], [np.zeros((m, 3 * m))]]) * T)
    return StateSpace(held[: 2 * m, : 2 * m], held[: 2 * m, 2 * m :], np.eye(m, 2 * m), np.zeros((m, m)))


def check(problems, loop: HapticLoop, orders: tuple[int, ...]) -> LinearCoupling:
    """Design, and hold the result against what Theorem 4 promises, without the solver."""
    told: list[str] = []
    coupling, convergence = design_linear(loop, orders, told.append)
    assert convergence.residuals[-1] < TOLERANCE
    assert told == [f"iteration {i}, |WZ - I| = {r:.1e}" for i, r in enumerate(convergence.residuals)]
    assert coupling.skew < 1e-6  # (15) forces V(1) to be symmetric as W Z tends to I
    for V, n, ports in zip(coupling.blocks, orders, loop.partition.blocks, strict=True):
        assert (V.order, V.inputs, V.outputs) == (n, len(ports), len(ports))
        static = V.response(1.0).real
        np.testing.assert_allclose(static, static.T, rtol=0.0, atol=1e-14 * np.max(np.abs(static)))
    assert margin(loop, coupling) > 0.0
    for mass in (0.05, 0.2, 1.0):
        closed = problems.closed_loop(
            masses_with_damping(loop, mass),
            loop.partition.join(coupling.blocks),
            loop.environment.environment(loop.period),
        )
        assert np.max(np.abs(np.linalg.eigvals(closed))) < 1.0
    return coupling


MIXED = Partition(("outer", "inner"), ((0, 2), (1,)))
AROUND = Partition(("outer", "inner"), ((2, 0), (1,)))


@pytest.mark.parametrize("order", [0, 1, 2])
def test_example_1_decentralised(problems, order: int) -> None:
    check(problems, problems.example_1(), (order,) * 3)


@pytest.mark.parametrize("order", [0, 1, 3, 6])
def test_example_1_centralised(problems, order: int) -> None:
    check(problems, problems.example_1(problems.centralised), (order,))


@pytest.mark.parametrize("partition", [MIXED, AROUND], ids=["in order", "turned"])
@pytest.mark.parametrize("orders", [(1, 2), (3, 0)])
def test_blocks_of_unlike_orders(problems, partition: Partition, orders: tuple[int, int]) -> None:
    check(problems, problems.example_1(partition), orders)


def test_a_device_whose_level_joins_its_axes(problems) -> None:
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
    loop = HapticLoop("planar", 1e-3, network.ports, (device,), Partition(("a",), ((1, 0),)), network)
    check(problems, loop, (2,))


@pytest.mark.parametrize(("osp", "T"), [(0.05, 1e-3), (30.0, 2.5e-4), (0.05, 1e-2)])
def test_other_scales(problems, osp: float, T: float) -> None:
    check(problems, problems.example_1(MIXED, osp=osp, T=T), (1, 2))


def test_devices_of_unlike_levels(problems) -> None:
    check(problems, problems.loop(problems.network, MIXED, [0.05, 1.37, 20.0], 1e-3), (2, 1))


def test_an_environment_that_is_not_passive(problems) -> None:
    """A spring whose force is a tick late needs Phi_E >= 1: (10) then asks for a level above 3.7 of the coupling."""
    spring = DelayedNetwork(Network(("p0",), (), (NetworkLink(("p0", GROUND), 2000.0, 0.0),)), 1)
    loop = HapticLoop(
        "late",
        problems.T,
        ("p0",),
        (DeviceLevel("d", (0,), np.array([[1.37]])),),
        Partition(("c",), ((0,),)),
        spring,
    )
    for order in (0, 1, 2):
        coupling = check(problems, loop, (order,))
        assert certify_given(loop, coupling.blocks).Delta_V[0][0, 0] > 1.0 + 1.0 / 0.37


def test_an_environment_that_no_coupling_helps(problems) -> None:
    loop = replace(problems.example_1(), environment=DelayedNetwork(problems.network, 1))
    with pytest.raises(Infeasible, match=r"no coupling .* E_hat \+ Delta_D is not passive"):
        design_linear(loop, (1, 1, 1))


def test_a_delay_inside_the_tick(problems) -> None:
    """Static compliances exceed K = kappa T Delta_D^-1, and the coupling is certified for the delay."""
    network = Network(("p", "q"), (), (NetworkLink(("p", "q"), 500.0, 0.2), NetworkLink(("q", GROUND), 800.0, 0.1)))
    loop = problems.loop(network, Partition(("a", "b"), ((0,), (1,))), [1.0, 2.0], problems.T)
    loop = replace(loop, tau=0.3 * problems.T)
    device = devices(loop)[0]
    coupling, _ = design_linear(loop, (1, 2), kappa=device.kappa, share=device.share)
    for V, K in zip(coupling.blocks, loop.loop_gain(device.kappa), strict=True):
        assert np.linalg.eigvalsh(V.response(1.0).real - K)[0] > 0.0
    assert margin(loop, coupling) > 0.0


def test_the_cap_hands_on_what_there_is(problems) -> None:
    loop = problems.example_1(MIXED)
    with pytest.raises(StoppedShort, match=r"Theorem 4: stopped after 0 iterations") as error:
        design_linear(loop, (1, 2), iterations=0)
    best = error.value.best
    assert isinstance(best, LinearCoupling)
    assert [V.order for V in best.blocks] == [1, 2]


@pytest.mark.parametrize("orders", [(1, 2, 3), (1,), (1, -1), ()])
def test_orders_that_do_not_fit(problems, orders: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="expected one >= 0 for each of the 2 blocks of V"):
        design_linear(problems.example_1(MIXED), orders)


def test_a_block_too_large_for_its_program(problems) -> None:
    with pytest.raises(TooLarge, match=rf"coupling outer: .* expected at most {MOST_STATES} together"):
        design_linear(problems.example_1(MIXED), (MOST_STATES - 1, 1))


def given_block(V: StateSpace, T: float) -> BlockUnknowns:
    """Unknowns with the values of V, for ports where Delta_D = I."""
    n, m = V.order, V.inputs
    unknowns = linear_unknowns(n, m)
    if n:
        unknowns.A.value, unknowns.B.value, unknowns.C.value = V.A, V.B / T, V.C
    unknowns.D.value = V.D / T
    return unknowns


def random_block(seed: int, n: int, m: int) -> StateSpace:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    A *= 0.8 / max(float(np.max(np.abs(np.linalg.eigvals(A)), initial=0.0)), 1e-6)
    return StateSpace(A, rng.normal(size=(n, m)), rng.normal(size=(m, n)), rng.normal(size=(m, m)) + 3.0 * np.eye(m))


def block_matrix(V: StateSpace, P: Matrix, Delta: Matrix, kappa: float, room: float = 0.0) -> Matrix:
    """The matrix that (15) asks to be >= 0, with W Z = I."""
    block = given_block(V, 1e-3)
    block.levels.Z.value, block.levels.W.value = Delta, symmetric_part(np.linalg.inv(Delta))
    block.storage.Z.value, block.storage.W.value = P, symmetric_part(np.linalg.inv(P))
    return np.asarray(block.constraints(kappa, room)[0].args[0].value)


def random_storage(seed: int, n: int) -> Matrix:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(n, n))
    return symmetric_part(root @ root.T + 0.1 * np.eye(n))


@settings(max_examples=30)
@given(st.integers(0, 10**6), st.integers(0, 4), st.integers(1, 3), st.floats(0.1, 3.0))
def test_a_blocks_inequality_is_lemma_1_of_its_transformed_coupling(seed: int, n: int, m: int, kappa: float) -> None:
    """Schur's complement of (15) at W Z = I is -M(P), for every V, P and Delta.

    Rounding: entries are below 1e3 times the condition of P and Delta, 1e5 at most.
    """
    V, T, P, Delta = random_block(seed, n, m), 1e-3, random_storage(seed, n + m), random_storage(seed + 1, m)
    M = block_matrix(V, P, Delta, kappa)
    V_hat = transformed_coupling(V, kappa * T * np.eye(m), T)
    G, y = np.hstack([V_hat.A, V_hat.B]), np.hstack([V_hat.C, V_hat.D])
    L = np.vstack([np.eye(n + 2 * m), -P @ G, -Delta @ y])
    expected = -storage_inequality(V_hat, P, Delta)
    np.testing.assert_allclose(L.T @ M @ L, expected, rtol=0.0, atol=1e-9 * np.max(np.abs(expected)))


@settings(max_examples=30)
@given(st.integers(0, 10**6), st.integers(0, 4), st.integers(1, 3))
def test_room_is_not_asked_of_a_constant_force(seed: int, n: int, m: int) -> None:
    """``room`` takes something off for every state, force and output except what no coupling can dissipate."""
    V, P, Delta = random_block(seed, n, m), random_storage(seed, n + m), random_storage(seed + 1, m)
    N = block_matrix(V, P, Delta, 0.5) - block_matrix(V, P, Delta, 0.5, room=1.0)
    u, p = np.eye(m), np.random.default_rng(seed).normal(size=(n + m, m))
    neutral = np.vstack([np.zeros((n, m)), u, u, p, np.zeros((m, m))])
    np.testing.assert_allclose(N @ neutral, 0.0, atol=1e-12)
    values = np.linalg.eigvalsh(N)
    np.testing.assert_allclose(values, [0.0] * (n + 2 * m) + [1.0] * (n + 2 * m), atol=1e-12)


def test_a_skew_remainder_of_static_compliance_is_removed_and_reported(problems) -> None:
    loop = problems.loop(Network(("p", "q"), (), ()), Partition(("c",), ((0, 1),)), [1.0, 1.0], problems.T)
    V = random_block(3, 2, 2)
    found = recover_linear(loop, [given_block(V, loop.period)])
    assert found is not None
    static, mended = V.response(1.0).real, found.blocks[0].response(1.0).real
    np.testing.assert_allclose(mended, (static + static.T) / 2.0, atol=1e-13)
    assert found.skew == pytest.approx(
        np.linalg.norm(static - static.T, 2) / 2.0 / np.linalg.norm(static, 2), rel=1e-12
    )
    assert found.blocks[0].order == 2
    np.testing.assert_allclose(found.blocks[0].response(1j) - mended, V.response(1j) - static, atol=1e-13)


@pytest.mark.parametrize(("gain", "kept"), [(1e-10, False), (1e-7, True)])
def test_dynamics_that_are_rounding_become_zeros(problems, gain: float, kept: bool) -> None:
    """They would only make the certificate harder to prove; what is more than rounding stays."""
    loop = problems.loop(Network(("p",), (), ()), Partition(("c",), ((0,),)), [1.0], problems.T)
    T = loop.period
    V = StateSpace(np.diag([0.5, 0.3]), T * gain * np.ones((2, 1)), np.ones((1, 2)), T * np.ones((1, 1)))
    found = recover_linear(loop, [given_block(V, T)])
    assert found is not None
    assert [bool(np.any(M)) for M in (found.blocks[0].A, found.blocks[0].B, found.blocks[0].C)] == [kept] * 3
    assert found.blocks[0].order == 2
    for z in (1.0, -1.0, 1j):
        np.testing.assert_allclose(found.blocks[0].response(z), V.response(z), rtol=1e-9)


def test_scaled_ports_are_taken_back(problems) -> None:
    """In ports scaled by S = Delta_D^-1/2, V is S^-1 V S^-1."""
    network = Network(("p", "q"), (), ())
    device = DeviceLevel("d", (0, 1), np.array([[2.0, 0.5], [0.5, 1.0]]))
    loop = HapticLoop("x", 1e-3, ("p", "q"), (device,), Partition(("c",), ((0, 1),)), network)
    V, S = random_block(5, 3, 2), loop.scaling
    inverse = np.linalg.inv(S)
    scaled = StateSpace(V.A, V.B @ inverse, inverse @ V.C, inverse @ V.D @ inverse)
    found = recover_linear(loop, [given_block(scaled, loop.period)])
    assert found is not None
    for z in (1.0, -1.0, 1j):
        skew = (V.response(1.0) - V.response(1.0).T) / 2.0
        np.testing.assert_allclose(found.blocks[0].response(z), V.response(z) - skew, rtol=1e-10, atol=1e-12)


def test_a_block_that_is_not_stable_is_no_answer(problems) -> None:
    loop = problems.loop(Network(("p",), (), ()), Partition(("c",), ((0,),)), [1.0], problems.T)
    one = np.ones((1, 1))
    assert recover_linear(loop, [given_block(StateSpace(1.01 * one, one, one, one), loop.period)]) is None
