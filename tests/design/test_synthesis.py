"""From a wish to a certificate, and errors that say what to relax."""

import numpy as np
import pytest

from manyhands.design import synthesis
from manyhands.design.certificate import content
from manyhands.design.contract import Levels, loop_inequality
from manyhands.design.errors import Infeasible, NotConverged, SolverFailure, TooLarge
from manyhands.design.network import GROUND, Link, Network
from manyhands.design.partition import Partition
from manyhands.design.problem import (
    DeviceLevel,
    HapticLoop,
    LinearGiven,
    NoCoupling,
    SpringDamperGiven,
    SpringDamperWanted,
)
from manyhands.design.statespace import StateSpace
from manyhands.design.synthesis import design
from manyhands.design.verification import verify


@pytest.mark.parametrize("name", ["decentralised", "centralised"])
def test_example_1_is_certified(problems, name: str) -> None:
    loop = problems.example_1(getattr(problems, name))
    certificate = design(loop, SpringDamperWanted())
    assert all(finding.holds for finding in verify(certificate, content(certificate)))
    found = loop_inequality(loop.Delta_D, certificate.levels.Delta_V, certificate.levels.Phi_E)
    assert np.linalg.eigvalsh(found)[0] == certificate.margins["(10)"] > 0.0
    assert certificate.coupling is not None
    assert loop.partition.admits(certificate.coupling.stiffness)
    assert certificate.method["algorithm"] == "Theorem 4, cone complementarity linearisation"
    assert 1 <= certificate.method["iterations"] <= 20


def test_the_same_wish_gives_the_same_certificate(problems) -> None:
    first, second = (design(problems.example_1(), SpringDamperWanted()) for _ in range(2))
    assert first.id == second.id


@pytest.mark.parametrize(
    ("stiffness", "damping", "condition", "relax"),
    [
        (3000.0, 0.0, "2740 N/m", "osp above 1.5"),
        (705.0, 1.1, "2/T times its damping", "osp above 1.4"),
        (0.0, 0.1, "V is not stable", "a spring of positive stiffness"),
        (-10.0, 0.1, "", "stiffness"),
        (0.0, 0.0, "T K + B is singular", "make K and B positive definite"),
    ],
)
def test_a_given_coupling_that_cannot_be(problems, stiffness, damping, condition: str, relax: str) -> None:
    with pytest.raises(Infeasible) as error:
        design(problems.example_1(), SpringDamperGiven(problems.uniform(stiffness, damping)))
    assert condition in error.value.condition
    assert any(relax in advice for advice in error.value.relax), error.value.relax
    assert all(advice in str(error.value) for advice in error.value.relax)


def test_no_coupling_cannot_be_certified(problems) -> None:
    with pytest.raises(Infeasible, match=r"there is no coupling.*to relax: use 'design: \{coupling"):
        design(problems.example_1(), NoCoupling())


def test_an_ill_posed_algebraic_loop_is_refused(problems) -> None:
    """D_V = -1/D_E leaves f_v undetermined within the tick."""
    network = Network(("dx",), (), (Link(("dx", GROUND), 1000.0, 0.0),))
    loop = problems.loop(network, Partition(("c",), ((0,),)), [1.37], 1e-3)
    with pytest.raises(Infeasible, match=r"I \+ D_E D_V is singular.*change the coupling's direct feedthrough"):
        design(loop, LinearGiven((StateSpace.static([[-1e-3]]),)))


def test_a_coupling_of_another_shape_is_the_callers_mistake(problems) -> None:
    loop = problems.example_1()
    for wanted, words in (
        (SpringDamperGiven(problems.uniform(700.0, 0.1, 2)), "a coupling of 3 ports, found 2"),
        (SpringDamperGiven(problems.C27), "different blocks"),
        (LinearGiven((StateSpace.static([[1e-3]]),) * 2), "expected blocks of V"),
        (LinearGiven((StateSpace.static(np.eye(3)),)), "expected blocks of V"),
    ):
        with pytest.raises(ValueError, match=words):
            design(loop, wanted)


def test_the_cap_on_iterations_is_an_error(problems, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("manyhands.design.theorem4.MOST_ITERATIONS", 2)
    with pytest.raises(NotConverged, match=r"stopped after 2 iterations at .*wanted < 1e-04"):
        design(problems.example_1(), SpringDamperWanted())


def test_a_solver_that_lies_is_not_believed(problems, monkeypatch: pytest.MonkeyPatch) -> None:
    honest = synthesis.certify_given

    def lying(loop, blocks) -> Levels:
        found = honest(loop, blocks)
        return Levels(1.3 * found.Delta_V, found.Phi_E, found.P_E, found.P_V)

    monkeypatch.setattr(synthesis, "certify_given", lying)
    with pytest.raises(SolverFailure, match="does not survive verification: V_hat of cx is Delta_V-OSP"):
        design(problems.example_1(), SpringDamperGiven(problems.C26))


def test_a_loop_beyond_the_programs_of_this_version_is_refused_before_memory_is() -> None:
    ports = tuple(f"p{i}" for i in range(49))
    loop = HapticLoop(
        session="many",
        period=1e-3,
        ports=ports,
        devices=tuple(DeviceLevel(port, (i,), np.array([[1.0]])) for i, port in enumerate(ports)),
        partition=Partition(ports, tuple((i,) for i in range(49))),
        network=Network(ports, (), tuple(Link((port, "ground"), 100.0, 0.1) for port in ports)),
    )
    with pytest.raises(TooLarge, match=r"49 ports .* at most 48"):
        design(loop, SpringDamperWanted())
