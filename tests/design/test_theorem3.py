"""Theorem 3 for given couplings: what is certified, what is refused, and why."""

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from scipy.signal import cont2discrete

from manyhands.design import theorem3
from manyhands.design.certificate import content
from manyhands.design.contract import loop_inequality
from manyhands.design.coupling import SpringDamper
from manyhands.design.errors import Infeasible, SolverFailure
from manyhands.design.network import GROUND, Link, Network
from manyhands.design.partition import Partition
from manyhands.design.problem import DeviceLevel, HapticLoop, SpringDamperGiven
from manyhands.design.solver import solve
from manyhands.design.statespace import Matrix, StateSpace
from manyhands.design.synthesis import design
from manyhands.design.theorem3 import certify_given
from manyhands.design.verification import verify


def margin(loop: HapticLoop, levels) -> float:
    return float(np.linalg.eigvalsh(loop_inequality(loop.Delta_D, levels.Delta_V, levels.Phi_E))[0])


def resonant(stiffness: float, height: float, omega: float, zeta: float, T: float, units: Matrix) -> StateSpace:
    """A compliance of second order: (1.02 + height / (s^2 + 2 zeta omega s + omega^2)) / stiffness, bilinear."""
    A, B = np.array([[0.0, 1.0], [-(omega**2), -2.0 * zeta * omega]]), np.array([[0.0], [1.0]])
    C, D = np.array([[height / stiffness, 0.0]]), np.array([[1.02 / stiffness]])
    A, B, C, D, _ = cont2discrete((A, B, C, D), T, "bilinear")
    return StateSpace(units @ A @ np.linalg.inv(units), units @ B, C @ np.linalg.inv(units), D)


@pytest.mark.parametrize(
    ("name", "reference", "least", "greatest"),
    [("C26", 0.7979, 0.54194, 0.54199), ("C27", 0.9455, 0.7239, 0.7284), ("C28", 1.8329, 621.7, 734.6)],
)
def test_the_papers_couplings(problems, name: str, reference: float, least: float, greatest: float) -> None:
    coupling = getattr(problems, name)
    loop = problems.example_1(problems.centralised if name == "C27" else problems.decentralised)
    J, J_minus_B, limit = problems.greatest_level(loop.Delta_D, coupling, loop.period)
    eigenvalues = np.linalg.eigvalsh(limit)
    assert (eigenvalues[0], eigenvalues[-1]) == pytest.approx((least, greatest), rel=1e-3)
    assert min(np.linalg.eigvalsh(J)[0], np.linalg.eigvalsh(J_minus_B)[0]) > 0.0
    levels = certify_given(loop, problems.blocks(loop, coupling))
    assert margin(loop, levels) == pytest.approx(reference, rel=0.05)
    assert np.linalg.eigvalsh(limit - levels.Delta_V)[0] > -1e-6  # the level cannot be beyond the greatest
    assert np.linalg.eigvalsh(levels.Delta_V)[0] > 0.0
    assert np.all(levels.Delta_V[~loop.partition.mask()] == 0.0)
    assert levels.P_E.shape == (5, 5)
    assert [P.shape for P in levels.P_V] == [(2 * len(b), 2 * len(b)) for b in loop.partition.blocks]


@given(st.data())
@settings(max_examples=40, phases=[Phase.generate])  # shrinking semidefinite programs takes minutes
def test_certified_is_what_the_closed_form_admits(problems, data: st.DataObject) -> None:
    """On a passive environment: J > 0, J - B > 0 and Delta_V* > 0, no more and no less."""
    loop = data.draw(problems.loops())
    coupling = data.draw(problems.couplings(loop, least_damping=-0.3, most=1.3))
    S = loop.scaling
    J, J_minus_B, greatest = problems.greatest_level(loop.Delta_D, coupling, loop.period)
    room = [np.linalg.eigvalsh(S @ X @ S)[0] for X in (J, J_minus_B)]
    if min(room) > 0.0:
        room.append(np.linalg.eigvalsh(S @ greatest @ S)[0])
    if abs(min(room)) < 1e-3:
        return  # too near to the limit for either answer to be wrong
    blocks = problems.blocks(loop, coupling)
    if min(room) < 0.0:
        with pytest.raises(Infeasible):
            certify_given(loop, blocks)
        return
    levels = certify_given(loop, blocks)
    assert margin(loop, levels) > 0.0
    assert np.linalg.eigvalsh(S @ levels.Delta_V @ S)[0] > 0.0
    assert np.linalg.eigvalsh(S @ (greatest - levels.Delta_V) @ S)[0] > -1e-5


def test_the_stiffness_limit_is_named(problems) -> None:
    loop = problems.example_1()
    with pytest.raises(Infeasible) as error:
        certify_given(loop, problems.blocks(loop, problems.uniform(3000.0, 0.0)))
    assert "coupling cx: its stiffness, 3000 N/m, is not below 2 Delta_D / T = 2740 N/m" in str(error.value)
    assert "a stiffness below 2740 N/m" in error.value.relax
    assert "devices with an osp above 1.5 N*s/m" in error.value.relax
    assert "a period below 0.913 ms" in error.value.relax


def test_what_the_message_advises_is_enough(problems) -> None:
    coupling = problems.uniform(3000.0, 0.0)
    for loop in (problems.example_1(osp=1.51), problems.example_1(T=0.91e-3)):
        assert margin(loop, certify_given(loop, problems.blocks(loop, coupling))) > 0.0
    loop = problems.example_1()
    assert margin(loop, certify_given(loop, problems.blocks(loop, problems.uniform(2735.0, 0.0)))) > 0.0


def test_the_damping_limit_is_named(problems) -> None:
    """K T/2 + B < Delta_D: 0.3525 + B < 1.37."""
    loop = problems.example_1()
    assert margin(loop, certify_given(loop, problems.blocks(loop, problems.uniform(705.0, 1.01)))) > 0.0
    with pytest.raises(Infeasible, match=r"stiffness plus 2/T times its damping, 2765 N/m, is not below .* 2740 N/m"):
        certify_given(loop, problems.blocks(loop, problems.uniform(705.0, 1.03)))


def test_a_damper_without_spring_is_refused(problems) -> None:
    loop = problems.example_1()
    with pytest.raises(Infeasible, match=r"V is not stable.*a spring of positive stiffness"):
        certify_given(loop, problems.blocks(loop, problems.uniform(0.0, 0.1)))


def test_no_coupling_is_refused(problems) -> None:
    with pytest.raises(Infeasible, match="V\\(1\\) is not positive"):
        certify_given(problems.example_1(), tuple(StateSpace.static([[0.0]]) for _ in range(3)))


@pytest.mark.parametrize("units", [1e-9, 1e-3, 1e6])
def test_units_of_the_states_do_not_matter(problems, units: float) -> None:
    loop = problems.example_1()
    same = certify_given(loop, problems.blocks(loop, problems.C26))
    blocks = tuple(StateSpace(V.A, units * V.B, V.C / units, V.D) for V in problems.blocks(loop, problems.C26))
    assert margin(loop, certify_given(loop, blocks)) == pytest.approx(margin(loop, same), rel=1e-3)


def test_other_coordinates_of_a_block_do_not_matter(problems) -> None:
    loop = problems.example_1(problems.centralised)
    (V,) = problems.blocks(loop, problems.C27)
    X = np.array([[1.0, 2.0, 0.0], [0.5, -1.0, 3.0], [0.0, 4.0, 1.0]]) * 10.0
    other = StateSpace(X @ V.A @ np.linalg.inv(X), X @ V.B, V.C @ np.linalg.inv(X), V.D)
    found, same = (margin(loop, certify_given(loop, (system,))) for system in (other, V))
    assert found == pytest.approx(same, rel=1e-3)


@pytest.mark.parametrize("units", [np.eye(2), np.array([[10.0, 20.0], [30.0, 40.0]]), np.diag([1e5, 1e5])])
def test_a_second_order_block_is_certified(problems, units) -> None:
    loop = problems.example_1()
    blocks = (resonant(1000.0, 446.1, 52.0, 0.5, loop.period, units),) * 3
    assert margin(loop, certify_given(loop, blocks)) > 0.9


def test_a_second_order_block_that_is_not_passive_is_refused_with_its_frequency(problems) -> None:
    loop = problems.example_1()
    with pytest.raises(Infeasible, match=r"V_hat is not passive at .* rad/s"):
        certify_given(loop, (resonant(2000.0, 40000.0, 300.0, 0.005, loop.period, np.eye(2)),) * 3)


def test_a_skew_part_that_vanishes_in_steady_state_is_admitted(problems) -> None:
    """V(-1) need not be symmetric: only V(1) must be."""
    network = Network(("x", "y"), (), (Link(("x", GROUND), 1000.0, 1.0), Link(("y", GROUND), 1000.0, 1.0)))
    loop = problems.loop(network, Partition(("c",), ((0, 1),)), [1.37, 1.37], 1e-3)
    skew = np.array([[0.0, 1.0], [-1.0, 0.0]]) * 1e-5  # times (z - 1)/(z - 0.5)
    V = StateSpace(0.5 * np.eye(2), np.eye(2), -0.5 * skew, np.eye(2) / 1000.0 + skew)
    np.testing.assert_allclose(V.response(1.0).real, np.eye(2) / 1000.0, atol=1e-15)
    assert np.abs(V.response(-1.0).real - V.response(-1.0).real.T).max() > 1e-5
    assert margin(loop, certify_given(loop, (V,))) > 0.0


def test_an_unsymmetric_static_compliance_is_refused(problems) -> None:
    network = Network(("x", "y"), (), (Link(("x", GROUND), 1000.0, 1.0), Link(("y", GROUND), 1000.0, 1.0)))
    loop = problems.loop(network, Partition(("c",), ((0, 1),)), [1.37, 1.37], 1e-3)
    with pytest.raises(Infeasible, match=r"V\(1\) is not symmetric"):
        certify_given(loop, (StateSpace.static([[1e-3, 1e-5], [0.0, 1e-3]]),))


def test_a_damper_that_is_hardly_there(problems) -> None:
    """A_V of 1e-161: a state that nothing reaches."""
    loop = problems.example_1()
    assert margin(loop, certify_given(loop, problems.blocks(loop, problems.uniform(1000.0, 1e-161)))) > 0.0


def test_a_level_that_10_does_not_ask_for_is_positive_all_the_same(problems) -> None:
    """The weak device alone decides the best t; nothing in (10) keeps the other block's level above zero."""
    network = Network(("x", "y"), (), (Link(("x", GROUND), 100.0, 1.0), Link(("y", GROUND), 100.0, 1.0)))
    loop = problems.loop(network, Partition(("a", "b"), ((0,), (1,))), [0.05, 5.0], 1e-3)
    levels = certify_given(loop, problems.blocks(loop, problems.uniform(20.0, 1e-3, 2)))
    assert np.diag(levels.Delta_V).min() > 1e-3


def test_a_heavy_mass_behind_a_damper_leaves_room_to_verify(problems) -> None:
    """The dissipation that proves it is Phi_E itself, of which the best t leaves next to nothing."""
    network = Network(("p0",), (("m", 2.5),), (Link(("p0", "m"), 0.0, 1.0),))
    loop = problems.loop(network, Partition(("c",), ((0,),)), [0.0546875], 2.5e-4)
    certificate = design(loop, SpringDamperGiven(problems.uniform(9.949, 1.48e-3, 1)))
    assert certificate.margins["E_hat"] > 1e-8


@pytest.mark.parametrize(
    ("masses", "links"),
    [
        ((), ()),
        ((), (Link(("p0", GROUND), 0.0, 2.0),)),
        ((), (Link(("p0", GROUND), 500.0, 0.0),)),
        ((("m", 1.0),), ()),
        ((("m", 1.0),), (Link(("p0", "m"), 0.0, 1.0),)),
        ((("m", 2.0),), (Link(("p0", GROUND), 4635.0, 1.8), Link(("m", "p0"), 5.1, 0.0))),
        ((("m", 10.0),), (Link(("p0", "m"), 0.5, 0.0),)),
    ],
    ids=["nothing", "damper", "spring", "free mass", "damped mass", "slow undamped mass", "slower still"],
)
def test_every_kind_of_environment(problems, masses, links) -> None:
    network = Network(("p0", "p1"), masses, (*links, Link(("p1", GROUND), 100.0, 0.1)))
    loop = problems.loop(network, Partition(("a", "b"), ((1,), (0,))), [1.37, 0.4], 2.5e-4)
    assert margin(loop, certify_given(loop, problems.blocks(loop, problems.uniform(300.0, 0.05, 2)))) > 0.0


def test_a_solver_that_stumbles_at_the_edge_is_asked_for_less(problems, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[str] = []

    def stumbling(program, what: str) -> float:
        calls.append(what)
        if len(calls) in stumbles:
            raise SolverFailure("stumbled")
        return solve(program, what)

    monkeypatch.setattr(theorem3, "solve", stumbling)
    loop = problems.example_1()
    stumbles = {2}  # the first program succeeds, the second fails at its first try
    levels = certify_given(loop, problems.blocks(loop, problems.C26))
    assert len(calls) == 3
    assert margin(loop, levels) == pytest.approx(0.9 * 0.8095, rel=0.05)
    calls.clear()
    stumbles = {2, 3, 4}  # the whole search: the network's own energy is left
    levels = certify_given(loop, problems.blocks(loop, problems.C26))
    np.testing.assert_array_equal(levels.P_E, np.eye(5))
    assert margin(loop, levels) > 0.0
    calls.clear()
    stumbles = set(range(1, 20))
    with pytest.raises(SolverFailure, match="stumbled"):
        certify_given(loop, problems.blocks(loop, problems.C26))


def test_modes_too_slow_for_a_solver_are_certified_by_their_energy() -> None:
    """Stiff and soft links between heavy masses at 4 kHz, behind a hand with little damping: found by chance."""
    links = [
        ("m1", "m3", 7097.9, 7.83), ("m2", "m3", 0.0, 0.01), ("m1", "m0", 1.0, 0.01), ("p0", "m3", 0.0, 0.01),
        ("p0", "m0", 1.0, 0.01), ("m1", "p0", 1.0, 0.01), ("m2", "p0", 1.0, 5.0), ("m3", "p0", 2.03, 0.01),
    ]  # fmt: skip
    masses = (("m0", 0.674), ("m1", 9.89), ("m2", 3.74), ("m3", 3.82))
    loop = HapticLoop(
        session="slow",
        period=2.5e-4,
        ports=("p0",),
        devices=(DeviceLevel("d0", (0,), np.array([[0.05]])),),
        partition=Partition(("c0",), ((0,),)),
        network=Network(("p0",), masses, tuple(Link((a, b), k, c) for a, b, k, c in links)),
    )
    coupling = SpringDamper(np.array([[8.31658742]]), np.array([[0.00139397]]))
    certificate = design(loop, SpringDamperGiven(coupling))
    assert all(finding.holds for finding in verify(certificate, content(certificate)))
