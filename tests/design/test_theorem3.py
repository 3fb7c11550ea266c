"""Theorem 3 for given couplings: what is certified, what is refused, and why."""

import numpy as np
import pytest
from hypothesis import Phase, given, reject, settings
from hypothesis import strategies as st
from scipy.signal import cont2discrete

from manyhands.design import theorem3
from manyhands.design.errors import Infeasible, SolverFailure
from manyhands.design.levels.contract import Levels
from manyhands.design.levels.environment import best_level
from manyhands.design.models.coupling import CouplingBlock, Partition, SpringDamper
from manyhands.design.models.network import GROUND, Network, NetworkLink
from manyhands.design.models.statespace import Matrix, StateSpace
from manyhands.design.problem import HapticLoop
from manyhands.design.theorem3 import certify_given, devices, joint_levels

from ..support.cases import cases

NO_SHRINKING = [Phase.generate]  # shrinking semidefinite programs takes minutes


def certified(loop: HapticLoop, coupling: SpringDamper) -> Levels:
    return certify_given(loop, coupling.restrict(loop.partition))


def resonant(stiffness: float, height: float, omega: float, zeta: float, T: float, units: Matrix) -> StateSpace:
    """A compliance of second order: (1.02 + height / (s^2 + 2 zeta omega s + omega^2)) / stiffness, bilinear."""
    A, B = np.array([[0.0, 1.0], [-(omega**2), -2.0 * zeta * omega]]), np.array([[0.0], [1.0]])
    C, D = np.array([[height / stiffness, 0.0]]), np.array([[1.02 / stiffness]])
    A, B, C, D, _ = cont2discrete((A, B, C, D), T, "bilinear")
    return StateSpace(units @ A @ np.linalg.inv(units), units @ B, C @ np.linalg.inv(units), D)


PAPER = [("C26", 0.7979, 0.54194, 0.54199), ("C27", 0.9455, 0.7239, 0.7284), ("C28", 1.8329, 621.7, 734.6)]


def example(problems, name: str) -> HapticLoop:
    return problems.example_1(problems.centralised if name == "C27" else problems.decentralised)


@pytest.mark.parametrize(("name", "reference", "least", "greatest"), PAPER)
def test_the_papers_couplings(problems, name: str, reference: float, least: float, greatest: float) -> None:
    coupling, loop = getattr(problems, name), example(problems, name)
    J, J_minus_B, limit = problems.greatest_level(loop.Delta_D, coupling, loop.period)
    eigenvalues = np.linalg.eigvalsh(limit)
    assert (eigenvalues[0], eigenvalues[-1]) == pytest.approx((least, greatest), rel=1e-3)
    assert min(np.linalg.eigvalsh(J)[0], np.linalg.eigvalsh(J_minus_B)[0]) > 0.0
    levels = certified(loop, coupling)
    assert problems.margin(loop, levels) == pytest.approx(reference, abs=1e-3)  # the references have four digits
    # the closed form, less what keeps it true in exact numbers
    Delta_V = loop.partition.embed(levels.Delta_V)
    np.testing.assert_allclose(Delta_V, loop.partition.embed(loop.partition.restrict(limit)), rtol=1e-7, atol=1e-12)
    assert np.linalg.eigvalsh(limit - Delta_V)[0] > 0.0
    assert loop.partition.admits(levels.Phi_E)  # each block can receive its own part
    assert np.shape(levels.P_E) == (2, 2)  # one mass: a deflection and a velocity, no integrators
    assert all(P is None for P in levels.P_V)
    assert problems.dissipation(loop, levels.Phi_E) > 0.0


@pytest.mark.parametrize(("name", "reference", "least", "greatest"), PAPER[:2])
def test_the_joint_program_agrees_on_the_papers_couplings(
    problems, name: str, reference: float, least: float, greatest: float
) -> None:
    """(28) is beyond the cap of the program's levels."""
    coupling, loop = getattr(problems, name), example(problems, name)
    (device,) = devices(loop)
    found = joint_levels(loop, problems.blocks(loop, coupling), loop.environment.split(loop.period), device)
    assert found.t == pytest.approx(reference, abs=1e-3)
    assert found.t == pytest.approx(problems.margin(loop, certified(loop, coupling)), rel=1e-5)


@given(st.data())
@settings(max_examples=cases(20, 40), phases=NO_SHRINKING)
def test_the_joint_program_and_the_exact_way_agree_on_random_loops(problems, data: st.DataObject) -> None:
    """One semidefinite program over everything, against closed form and level set; masses that drift are among them."""
    loop = data.draw(problems.loops(tied=data.draw(st.booleans())))
    coupling = data.draw(problems.couplings(loop, least_damping=0.02, most=0.9))
    (device,) = devices(loop)
    levels, split, T = certified(loop, coupling), loop.environment.split(loop.period), loop.period
    Delta_V = loop.partition.embed(levels.Delta_V)
    found = best_level(split, T, loop.Delta_D, Delta_V, loop.partition)
    # every frequency bounds t from above, and this is the bound at the one that was found: t cannot be more ...
    response = split.rest.response(np.exp(1j * found.frequency * T))
    H = (response + np.conj(response.T)) / 2.0 - T / 2.0 * split.stiffness  # the Hermitian part of E_hat
    bound = np.linalg.eigvalsh(np.block([[loop.Delta_D + H, H], [H, Delta_V + H]]))[0]
    least = float(np.linalg.eigvalsh(loop.Delta_D)[0])
    assert found.best == pytest.approx(bound, rel=1e-9, abs=1e-9 * least)
    # ... and the program reports that it is not less. Where t is small against the levels, it reports too much
    try:
        joint = joint_levels(loop, problems.blocks(loop, coupling), split, device).t
    except SolverFailure:
        reject()  # modes too slow for the program
    assert found.best * (1.0 - 1e-5) <= joint <= found.best + 1e-5 * max(found.best, 5.0 * least)
    # of which a claim gives up what its proof needs, or, by energy, what it does not know
    assert 0.0 < problems.margin(loop, levels) <= found.best * (1.0 + 1e-9)


@given(st.data())
@settings(max_examples=60)
def test_certified_is_what_the_closed_form_admits(problems, data: st.DataObject) -> None:
    """On a passive environment: J > 0, J - B > 0 and Delta_V* > 0, no more and no less."""
    loop = data.draw(problems.loops())
    coupling = data.draw(problems.couplings(loop, least_damping=-0.3, most=1.3))
    S = loop.scaling
    J, J_minus_B, greatest = problems.greatest_level(loop.Delta_D, coupling, loop.period)
    room = [np.linalg.eigvalsh(S @ X @ S)[0] for X in (J, J_minus_B)]
    if min(room) > 0.0:
        room.append(np.linalg.eigvalsh(S @ greatest @ S)[0])
    if abs(min(room)) < 1e-6:
        return  # too near to the limit for either answer to be wrong
    if min(room) < 0.0:
        with pytest.raises(Infeasible):
            certified(loop, coupling)
        return
    levels = certified(loop, coupling)
    assert problems.margin(loop, levels) > 0.0
    Delta_V = loop.partition.embed(levels.Delta_V)
    assert np.linalg.eigvalsh(S @ Delta_V @ S)[0] > 0.0
    assert np.linalg.eigvalsh(S @ (greatest - Delta_V) @ S)[0] > -1e-12 * np.abs(greatest).max()
    assert problems.dissipation(loop, levels.Phi_E) > -1e-9  # cancellation in E at the lowest frequencies


def test_the_stiffness_limit_is_named(problems) -> None:
    loop = problems.example_1()
    with pytest.raises(Infeasible) as error:
        certified(loop, problems.uniform(3000.0, 0.0))
    assert "coupling cx: its stiffness, 3000 N/m, is not below 2 Delta_D / T = 2740 N/m" in str(error.value)
    assert error.value.remedies == ()  # what helps is a change of a session, which this module does not know


def test_what_is_a_little_inside_the_limits_is_enough(problems) -> None:
    coupling = problems.uniform(3000.0, 0.0)
    for loop in (problems.example_1(osp=1.51), problems.example_1(T=0.91e-3)):
        assert problems.margin(loop, certified(loop, coupling)) > 0.0
    loop = problems.example_1()
    assert problems.margin(loop, certified(loop, problems.uniform(2739.9, 0.0))) > 0.0


def test_the_damping_limit_is_named(problems) -> None:
    """K T/2 + B < Delta_D: 0.3525 + B < 1.37."""
    loop = problems.example_1()
    assert problems.margin(loop, certified(loop, problems.uniform(705.0, 1.0174))) > 0.0
    with pytest.raises(Infeasible, match=r"stiffness plus 2/T times its damping, 2765 N/m, is not below .* 2740 N/m"):
        certified(loop, problems.uniform(705.0, 1.03))


def test_a_coupling_at_its_limit_is_refused_before_the_proof_is(problems) -> None:
    """J = B = 1/2 in exact numbers; in machine numbers its side of the limit is unknown."""
    loop = problems.example_1(osp=8.0)
    with pytest.raises(Infeasible, match=r"1.6e\+04 N/m, is not below .* 1.6e\+04 N/m"):
        certified(loop, problems.uniform(1.5e4, 0.5))


@pytest.mark.parametrize("linear", [False, True], ids=["springs", "linear"])
def test_a_damper_without_spring_is_refused(problems, linear: bool) -> None:
    loop, coupling = problems.example_1(), problems.uniform(0.0, 0.1)
    with pytest.raises(Infeasible, match=r"a spring of positive stiffness"):
        certify_given(loop, problems.blocks(loop, coupling) if linear else coupling.restrict(loop.partition))


def test_a_negative_level_is_refused(problems) -> None:
    """A negative damper so strong that Delta_V* = Lambda J^-1 (J + B) J^-1 Lambda - Lambda is not positive."""
    with pytest.raises(Infeasible, match=r"greatest level of V_hat has the eigenvalue -"):
        certified(problems.example_1(), problems.uniform(500.0, -0.3))


def test_no_coupling_is_refused(problems) -> None:
    with pytest.raises(Infeasible, match="V\\(1\\) is not positive"):
        certify_given(problems.example_1(), tuple(StateSpace.static([[0.0]]) for _ in range(3)))


@pytest.mark.parametrize("units", [1e-9, 1e-3, 1.0, 1e6])
def test_units_of_the_states_do_not_matter(problems, units: float) -> None:
    """And one-port blocks are worth their closed form, whatever proves it."""
    loop = problems.example_1()
    same = certified(loop, problems.C26)
    blocks = tuple(StateSpace(V.A, units * V.B, V.C / units, V.D) for V in problems.blocks(loop, problems.C26))
    levels = certify_given(loop, blocks)
    # what the program gives up for room: 1e-4 of a level
    assert problems.margin(loop, levels) == pytest.approx(problems.margin(loop, same), rel=1e-3)
    for found, closed in zip(levels.Delta_V, same.Delta_V, strict=True):
        assert closed[0, 0] * (1.0 - 1e-3) < found[0, 0] < closed[0, 0]
    assert [np.shape(P) for P in levels.P_V] == [(1, 1)] * 3


def test_other_coordinates_of_a_block_do_not_matter(problems) -> None:
    loop = problems.example_1(problems.centralised)
    (V,) = problems.blocks(loop, problems.C27)
    X = np.array([[1.0, 2.0, 0.0], [0.5, -1.0, 3.0], [0.0, 4.0, 1.0]]) * 10.0
    other = StateSpace(X @ V.A @ np.linalg.inv(X), X @ V.B, V.C @ np.linalg.inv(X), V.D)
    found, same = (problems.margin(loop, certify_given(loop, (system,))) for system in (other, V))
    assert found == pytest.approx(same, rel=1e-3)
    assert same == pytest.approx(problems.margin(loop, certified(loop, problems.C27)), rel=1e-3)


def test_large_blocks_beyond_the_joint_program_get_their_own_level(problems, monkeypatch: pytest.MonkeyPatch) -> None:
    """The greatest multiple of Delta_D is an OSP level like another: certified, with no more margin than the best."""
    loop = problems.example_1(problems.centralised)
    blocks = problems.blocks(loop, problems.C27)
    best = problems.margin(loop, certify_given(loop, blocks))
    monkeypatch.setattr(theorem3, "MOST_JOINT", 4)
    levels = certify_given(loop, blocks)
    (Delta_V,) = levels.Delta_V
    np.testing.assert_allclose(Delta_V, Delta_V[0, 0] * np.eye(3), rtol=1e-12)
    assert Delta_V[0, 0] == pytest.approx(0.7239, rel=2e-3)  # the least eigenvalue of the greatest level
    assert 0.0 < problems.margin(loop, levels) <= best


def test_springs_and_linear_blocks_in_one_coupling(problems) -> None:
    loop = problems.example_1()
    springs, linear = problems.C26.restrict(loop.partition), problems.blocks(loop, problems.C26)
    parts: tuple[CouplingBlock, ...] = (springs[0], linear[1], springs[2])
    levels = certify_given(loop, parts)
    assert [P is None for P in levels.P_V] == [True, False, True]
    assert problems.margin(loop, levels) == pytest.approx(0.7979, abs=1e-3)


@pytest.mark.parametrize("units", [np.eye(2), np.array([[10.0, 20.0], [30.0, 40.0]]), np.diag([1e5, 1e5])])
def test_a_second_order_block_is_certified(problems, units) -> None:
    loop = problems.example_1()
    blocks = (resonant(1000.0, 446.1, 52.0, 0.5, loop.period, units),) * 3
    assert problems.margin(loop, certify_given(loop, blocks)) > 0.9


def test_a_nonpassive_second_order_block_is_refused_with_its_frequency(problems) -> None:
    loop = problems.example_1()
    with pytest.raises(Infeasible, match=r"V_hat is not passive at .* rad/s"):
        certify_given(loop, (resonant(2000.0, 40000.0, 300.0, 0.005, loop.period, np.eye(2)),) * 3)


def two_ports(problems, blocks: tuple[tuple[int, ...], ...], osp: list[float], stiffness: float = 1000.0) -> HapticLoop:
    network = Network(("x", "y"), (), tuple(NetworkLink((port, GROUND), stiffness, 1.0) for port in "xy"))
    return problems.loop(network, Partition(tuple("ab"[: len(blocks)]), blocks), osp, 1e-3)


def test_a_skew_part_that_vanishes_in_steady_state_is_admitted(problems) -> None:
    """V(-1) need not be symmetric: only V(1) must be."""
    loop = two_ports(problems, ((0, 1),), [1.37, 1.37])
    skew = np.array([[0.0, 1.0], [-1.0, 0.0]]) * 1e-5  # times (z - 1)/(z - 0.5)
    V = StateSpace(0.5 * np.eye(2), np.eye(2), -0.5 * skew, np.eye(2) / 1000.0 + skew)
    np.testing.assert_allclose(V.response(1.0).real, np.eye(2) / 1000.0, atol=1e-15)
    assert np.abs(V.response(-1.0).real - V.response(-1.0).real.T).max() > 1e-5
    assert problems.margin(loop, certify_given(loop, (V,))) > 0.0


def test_an_unsymmetric_static_compliance_is_refused(problems) -> None:
    loop = two_ports(problems, ((0, 1),), [1.37, 1.37])
    with pytest.raises(Infeasible, match=r"V\(1\) is not symmetric"):
        certify_given(loop, (StateSpace.static([[1e-3, 1e-5], [0.0, 1e-3]]),))


@pytest.mark.parametrize("linear", [False, True], ids=["springs", "linear"])
def test_a_damper_that_is_hardly_there(problems, linear: bool) -> None:
    """A_V of 1e-161: a state that nothing reaches."""
    loop, coupling = problems.example_1(), problems.uniform(1000.0, 1e-161)
    parts = problems.blocks(loop, coupling) if linear else coupling.restrict(loop.partition)
    assert problems.margin(loop, certify_given(loop, parts)) > 0.0


@pytest.mark.parametrize("linear", [False, True], ids=["springs", "linear"])
def test_a_level_that_condition_10_does_not_need_is_positive(problems, linear: bool) -> None:
    """The weak device alone decides the best t; nothing in (10) keeps the other block's level above zero."""
    loop, coupling = two_ports(problems, ((0,), (1,)), [0.05, 5.0], 100.0), problems.uniform(20.0, 1e-3, 2)
    levels = certify_given(loop, problems.blocks(loop, coupling) if linear else coupling.restrict(loop.partition))
    assert min(Delta[0, 0] for Delta in levels.Delta_V) > 1e-3
