"""Verification finds false claims, and what it calls proved is stable."""

import dataclasses
import subprocess
import sys
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from manyhands.design.certificate import Certificate, content, seal
from manyhands.design.coupling import SpringDamper
from manyhands.design.device import held_device
from manyhands.design.errors import Infeasible
from manyhands.design.network import Link, Network
from manyhands.design.operators import RationalMatrix
from manyhands.design.partition import Partition
from manyhands.design.problem import (
    DeviceLevel,
    LinearGiven,
    NoCoupling,
    SpringDamperGiven,
    SpringDamperWanted,
)
from manyhands.design.statespace import StateSpace, block_diagonal, parallel_blocks
from manyhands.design.synthesis import design
from manyhands.design.verification import differences, margins, verify


@pytest.fixture(scope="module")
def proved(problems) -> Certificate:
    return design(problems.example_1(), SpringDamperGiven(problems.C26))


def failing(certificate: Certificate) -> list[str]:
    return [finding.condition for finding in verify(certificate, content(certificate)) if not finding.holds]


def resealed(certificate: Certificate) -> Certificate:
    """With the id and the margins of its own content, as a careful forger would have them."""
    return seal(dataclasses.replace(certificate, margins=margins(certificate)))


def test_what_design_returns_is_proved(proved: Certificate) -> None:
    assert failing(proved) == []
    assert proved.margins["(10)"] == pytest.approx(0.7979, rel=0.05)
    assert min(proved.margins.values()) > 0.0


def levels(**change: Callable) -> Callable[[Certificate], Certificate]:
    def apply(c: Certificate) -> Certificate:
        new = {name: f(getattr(c.levels, name)) for name, f in change.items()}
        return dataclasses.replace(c, levels=dataclasses.replace(c.levels, **new))

    return apply


def loop(**change: object) -> Callable[[Certificate], Certificate]:
    return lambda c: dataclasses.replace(c, loop=dataclasses.replace(c.loop, **change))


def coupling(stiffness: float, damping: float) -> Callable[[Certificate], Certificate]:
    def apply(c: Certificate) -> Certificate:
        new = SpringDamper(stiffness * np.eye(3), damping * np.eye(3))
        blocks = tuple(part.realisation(c.loop.period) for part in new.restrict(c.loop.partition))
        return dataclasses.replace(c, coupling=new, blocks=blocks)

    return apply


def block(**change: Callable) -> Callable[[Certificate], Certificate]:
    def apply(c: Certificate) -> Certificate:
        first = dataclasses.replace(c.blocks[0], **{name: f(getattr(c.blocks[0], name)) for name, f in change.items()})
        return dataclasses.replace(c, blocks=(first, *c.blocks[1:]))

    return apply


def network(mass: float = 3.0, factor: float = 1.0) -> Callable[[Certificate], Certificate]:
    def apply(c: Certificate) -> Certificate:
        old = c.loop.network
        links = tuple(Link(link.ends, factor * link.stiffness, link.damping) for link in old.links)
        return loop(network=Network(old.ports, (("hub", mass),), links))(c)

    return apply


def devices(osp: float) -> Callable[[Certificate], Certificate]:
    return loop(devices=tuple(DeviceLevel(f"d{i}", (i,), np.array([[osp]])) for i in range(3)))


ONE = np.zeros((3, 3))
ONE[0, 0] = 1.0
FORGERIES = {
    "a greater Delta_V": (levels(Delta_V=lambda D: 1.2 * D), "OSP"),
    "a greater Delta_V of one block": (levels(Delta_V=lambda D: D + 0.1 * ONE), "V_hat of cx"),
    "a negative Delta_V": (levels(Delta_V=lambda D: D - 2.0 * ONE), "Delta_V > 0"),
    "a Delta_V across blocks": (levels(Delta_V=lambda D: D + 1e-12), "block structure"),
    "an unsymmetric Delta_V": (levels(Delta_V=lambda D: D + np.diag([0.1, 0.0], 1)), "symmetric"),
    "a lower Phi_E": (levels(Phi_E=lambda Phi: Phi - 0.5 * np.eye(3)), "E_hat is (-Phi_E)-ISP"),
    "a slightly lower Phi_E": (levels(Phi_E=lambda Phi: Phi - 0.05 * ONE), "E_hat is (-Phi_E)-ISP"),
    "a greater Phi_E": (levels(Phi_E=lambda Phi: Phi + 2.0 * np.eye(3)), "condition (10)"),
    "a scaled P_E": (levels(P_E=lambda P: 1.01 * P), "E_hat is (-Phi_E)-ISP"),
    "a P_E off its face": (levels(P_E=lambda P: P + 1e-5), "steady states are neutral"),
    "a negative P_E": (levels(P_E=lambda P: -P), "the storage is positive"),
    "a P_E of another size": (levels(P_E=lambda P: P[:4, :4]), "the storage matrix is 5 x 5"),
    "a scaled P_V": (levels(P_V=lambda P: (1.1 * P[0], *P[1:])), "V_hat of cx"),
    "a P_V of another size": (levels(P_V=lambda P: (P[0][:1, :1], *P[1:])), "the storage matrix is 2 x 2"),
    "a stiffness beyond the limit": (coupling(3000.0, 0.0), "passive over frequency"),
    "another stiffness": (coupling(760.0, 0.0372), "V_hat of cx"),
    "a damping beyond the limit": (coupling(705.0, 1.1), "passive over frequency"),
    "a block that is not K and B": (block(D=lambda D: 1.0001 * D), "realise K and B"),
    "a block of another order": (
        lambda c: dataclasses.replace(c, blocks=(StateSpace.static([[1e-3]]), *c.blocks[1:])),
        "realise K and B",
    ),
    "an unstable block": (block(A=lambda A: A + 1.0), "V is not stable"),
    "other masses": (network(mass=300.0), "E_hat is (-Phi_E)-ISP"),
    "other springs": (network(factor=0.01), "E_hat is (-Phi_E)-ISP"),
    "devices with less damping": (devices(0.3), "passive over frequency"),
    "devices with somewhat less damping": (devices(1.2), "V_hat of cx"),
    "a longer period": (loop(period=4.1e-3), "passive over frequency"),
    "a somewhat longer period": (loop(period=1.1e-3), "realise K and B"),
    "other blocks": (loop(partition=Partition(("cx", "cy", "cz"), ((1,), (0,), (2,)))), ""),
    "a delay": (lambda c: dataclasses.replace(c, tau=1e-4), "tau = 0"),
    "numbers beyond floating point": (levels(P_E=lambda P: 1e308 * P, Phi_E=lambda Phi: 1e308 * Phi), ""),
    "a period beyond floating point": (loop(period=5e-324), "evaluated in floating point"),
}


@pytest.mark.parametrize("name", FORGERIES)
def test_a_false_claim_is_found(proved: Certificate, name: str) -> None:
    forge, words = FORGERIES[name]
    forged = forge(proved)
    if name == "a period beyond floating point":  # even its content cannot be had
        found = [f.condition for f in verify(forged, content(proved)) if not f.holds]
        assert any(words in condition for condition in found), found
        return
    found = failing(resealed(forged))
    assert found
    assert any(words in condition for condition in found), found


def test_a_linear_certificate_is_held_to_its_blocks(problems) -> None:
    """Where no K and B are stated, the inequality alone must find a changed block."""
    c = design(problems.example_1(), LinearGiven(problems.blocks(problems.example_1(), problems.C26)))
    assert failing(c) == []
    found = failing(resealed(block(C=lambda C: 1.02 * C, D=lambda D: 1.02 * D)(c)))
    assert any("V_hat of cx" in condition for condition in found), found


def test_stated_margins_and_restatements_are_checked(proved: Certificate) -> None:
    better = seal(dataclasses.replace(proved, margins={**proved.margins, "(10)": 2.0 * proved.margins["(10)"]}))
    assert failing(better) == ["the stated margins are the ones found"]
    fewer = seal(dataclasses.replace(proved, margins={"(10)": proved.margins["(10)"]}))
    assert failing(fewer) == ["the margins are those of this version's conditions"]
    data = content(proved)
    data["levels"]["Delta_D"][0][0] *= 1.001
    found = [f.condition for f in verify(proved, data) if not f.holds]
    assert "the stated E_hat and Delta_D are those of the physical data" in found


def test_no_solver_is_needed() -> None:
    """A node verifies with numpy alone."""
    code = (
        "import sys, manyhands.design.verification\n"
        "print(sorted({name.split('.')[0] for name in sys.modules} & {'cvxpy', 'clarabel', 'scipy', 'zmq', 'yaml'}))"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert out.stdout.strip() == "[]"


@given(st.data())
@settings(max_examples=40, phases=[Phase.generate])  # shrinking semidefinite programs takes minutes
def test_what_is_certified_is_stable(problems, data: st.DataObject) -> None:
    """Theorem 3 itself: any passive hand, any device at its declared level, by the eigenvalues of the closed loop."""
    loop = data.draw(problems.loops(tied=True))
    T, m = loop.period, len(loop.ports)
    wanted = SpringDamperGiven(data.draw(problems.couplings(loop, least_damping=-0.2, most=1.05)))
    try:
        certificate = design(loop, wanted)
    except Infeasible:
        return
    V, E = loop.partition.join(certificate.blocks), loop.network.environment(T)
    for _ in range(3):  # hands are cheap, programs are not
        hands = [data.draw(problems.passive_entries()) for _ in range(m)]
        draw = lambda low, high: data.draw(st.lists(st.floats(low, high), min_size=m, max_size=m))  # noqa: E731
        masses = [float(b) * t for b, t in zip(np.diag(loop.Delta_D), draw(0.02, 1.0), strict=True)]
        H = parallel_blocks([RationalMatrix(((hand,),)).realisation() for hand in hands])
        stiffness = draw(0.0, 200.0)
        device = held_device(masses, list(np.diag(loop.Delta_D)), H, draw(0.0, 1.0), stiffness)
        sampled = device.sampled(T)
        G = StateSpace(sampled.A, sampled.B[:, :m], sampled.C[:m], np.zeros((m, m)))
        closed = problems.closed_loop(G, V, E)
        # some are 1: positions at rest; and twice where masses drift freely, which rounding splits by its root, 1.5e-8
        radius = np.abs(np.linalg.eigvals(closed)).max()
        assert radius <= 1.0 + 1e-7, (radius, certificate.margins)


def test_the_stability_test_can_fail(problems) -> None:
    """By the same means, a stiffness just beyond the limit against a rigid wall is unstable."""
    T, b = 1e-3, 1.37
    for K, unstable in ((2600.0, False), (2900.0, True)):
        device = held_device([0.005], [b], StateSpace.static([[0.0]]), [0.0], [0.0])
        sampled = device.sampled(T)
        G = StateSpace(sampled.A[:2, :2], sampled.B[:2, :1], sampled.C[:1, :2], np.zeros((1, 1)))
        V = problems.uniform(K, 0.0, 1).realisation(T)
        wall = Network(("p",), (), (Link(("p", "ground"), 1e9, 0.0),)).environment(T)
        radius = np.abs(np.linalg.eigvals(problems.closed_loop(G, V, wall))).max()
        assert (radius > 1.0) == unstable


def test_differences_name_what_differs(problems, proved: Certificate) -> None:
    given_ = SpringDamperGiven(problems.C26)
    assert differences(proved, problems.example_1(), given_) == []
    assert differences(proved, problems.example_1(), SpringDamperWanted()) == []
    for other, words in (
        (problems.example_1(T=2e-3), "the period"),
        (problems.example_1(osp=1.4), "the level or order of devices"),
        (problems.example_1(problems.centralised), "the block structure"),
        (dataclasses.replace(problems.example_1(), session="other"), "the session's name"),
        (network(mass=2.0)(proved).loop, "the environment"),
    ):
        (found,) = differences(proved, other, given_)
        assert found.startswith(f"{words} differs")
    assert differences(proved, problems.example_1(), NoCoupling()) == ["the session wants no coupling"]
    other = "the coupling is not the one that the session gives"
    for wanted in (SpringDamperGiven(problems.uniform(700.0, 0.0372)), LinearGiven((StateSpace.static([[1e-3]]),) * 3)):
        assert differences(proved, problems.example_1(), wanted) == [other]
    assert differences(proved, problems.example_1(), LinearGiven(proved.blocks)) == []


def test_joined_blocks_are_the_coupling(problems, proved: Certificate) -> None:
    joined = proved.loop.partition.join(proved.blocks)
    np.testing.assert_array_equal(joined.D, block_diagonal([b.D for b in proved.blocks]))
