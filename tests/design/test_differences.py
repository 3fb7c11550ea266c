"""What a proof alone does not say: that a certificate is about this session, and not about another."""

import dataclasses

import numpy as np
import pytest

from manyhands.design.certificate import Certificate
from manyhands.design.differences import differences
from manyhands.design.environment import DelayedNetwork, NetworkBox, StateSpaceEnvironment, TransferEnvironment
from manyhands.design.network import Link, Network
from manyhands.design.problem import (
    HapticLoop,
    LinearGiven,
    LinearWanted,
    NoCoupling,
    SpringDamperGiven,
    SpringDamperWanted,
    Wish,
)
from manyhands.design.statespace import StateSpace
from manyhands.design.synthesis import design
from manyhands.design.transparency import Transparency
from manyhands.design.weights import Filter

NOT_GIVEN = "the coupling is not the one that the session gives"
OTHER_AIM = "the transparency problem differs, in its objective or its weights"


def aim(objective: str = "loop-shaping", corner: float = 125.0) -> Transparency:
    return Transparency(objective, Filter.from_continuous((1.0,), (1.0 / corner, 1.0), 1e-3), Filter.one())


def softer(network: Network, factor: float = 0.9) -> Network:
    links = tuple(Link(link.ends, factor * link.stiffness, link.damping) for link in network.links)
    return Network(network.ports, network.masses, links)


def on(loop: HapticLoop, environment) -> HapticLoop:
    return dataclasses.replace(loop, environment=environment)


@pytest.fixture(scope="module")
def proved(problems) -> Certificate:
    return design(problems.example_1(), SpringDamperGiven(problems.C26)).certificate


@pytest.fixture(scope="module")
def shaped(problems) -> Certificate:
    return design(problems.example_1(), SpringDamperGiven(problems.C26, aim())).certificate


@pytest.fixture(scope="module")
def linear(problems) -> Certificate:
    loop = problems.example_1()
    return design(loop, LinearGiven(problems.blocks(loop, problems.C26))).certificate


def test_what_fits(problems, proved: Certificate, shaped: Certificate, linear: Certificate) -> None:
    loop = problems.example_1()
    assert differences(proved, loop, SpringDamperGiven(problems.C26)) == []
    assert differences(proved, loop, SpringDamperWanted()) == []
    assert differences(proved, loop, SpringDamperWanted(Wish("stiffest"))) == []  # how it was found is not at issue
    assert differences(shaped, loop, SpringDamperGiven(problems.C26, aim())) == []
    assert differences(shaped, loop, SpringDamperWanted(Wish("loop-shaping", aim()))) == []
    assert differences(linear, loop, LinearGiven(linear.blocks)) == []
    assert differences(linear, loop, LinearWanted((1, 1, 1))) == []


def test_another_loop_is_named(problems, proved: Certificate) -> None:
    loop, network = problems.example_1(), problems.network
    stiffer = softer(network, 1.1)
    matrices = StateSpaceEnvironment(network.ports, network.environment(1e-3))
    for other, words in (
        (problems.example_1(T=2e-3), "the period"),
        (dataclasses.replace(loop, tau=1e-4), "the delay inside the tick"),
        (problems.example_1(osp=1.4), "the level or order of devices"),
        (dataclasses.replace(loop, devices=loop.devices[::-1]), "the level or order of devices"),
        (problems.example_1(problems.centralised), "the block structure"),
        (dataclasses.replace(loop, session="other"), "the session's name"),
        (on(loop, softer(network)), "the environment"),
        (on(loop, DelayedNetwork(network, 1)), "the environment"),
        (on(loop, NetworkBox(network, stiffer)), "the environment"),
        (on(loop, matrices), "the environment"),
    ):
        (found,) = differences(proved, other, SpringDamperGiven(problems.C26))
        assert found.startswith(f"{words} differs")


def test_every_number_of_an_environment_counts(problems, proved: Certificate) -> None:
    """Environments of the same kind, equal but for one thing."""
    loop, network = problems.example_1(), problems.network
    E = network.environment(1e-3)
    nudged = StateSpace(E.A, E.B, E.C, np.nextafter(E.D, np.inf))
    entries = tuple(tuple(((float(i == j), 9.0), (1.0,)) for j in range(3)) for i in range(3))
    other = (*entries[:2], (*entries[2][:2], ((1.0, 9.5), (1.0,))))
    ports, stiffer = network.ports, softer(network, 1.1)
    for one, another in (
        (DelayedNetwork(network, 1), DelayedNetwork(network, 2)),
        (NetworkBox(network, stiffer), NetworkBox(network, softer(network, 1.2))),
        (StateSpaceEnvironment(ports, E), StateSpaceEnvironment(ports, nudged)),
        (StateSpaceEnvironment(ports, E), StateSpaceEnvironment(ports, E, None, 1)),
        (StateSpaceEnvironment(ports, E), StateSpaceEnvironment(ports, E, "zoh")),
        (TransferEnvironment(ports, entries), TransferEnvironment(ports, other)),
        (TransferEnvironment(ports, entries), TransferEnvironment(ports, entries, "tustin")),
    ):
        certificate = dataclasses.replace(proved, loop=on(loop, one))
        assert differences(certificate, on(loop, one), SpringDamperWanted()) == []
        assert differences(certificate, on(loop, another), SpringDamperWanted()) == ["the environment differs"]


def test_another_coupling_is_named(problems, proved: Certificate, linear: Certificate) -> None:
    loop = problems.example_1()
    for wanted in (SpringDamperGiven(problems.uniform(700.0, 0.0372)), LinearGiven((StateSpace.static([[1e-3]]),) * 3)):
        assert differences(proved, loop, wanted) == [NOT_GIVEN]
        assert differences(linear, loop, wanted) == [NOT_GIVEN]
    assert differences(linear, loop, SpringDamperGiven(problems.C26)) == [NOT_GIVEN]
    # the same transfer function in other numbers is another file
    assert differences(proved, loop, LinearGiven(proved.blocks)) == [NOT_GIVEN]
    assert differences(proved, loop, LinearWanted((1, 1, 1))) == [
        "the coupling is of the spring-damper class, and the session wants a linear one"
    ]
    assert differences(linear, loop, SpringDamperWanted()) == [
        "the coupling is not of the spring-damper class that the session wants"
    ]
    assert differences(proved, loop, NoCoupling()) == ["the session wants no coupling"]


def test_another_aim_is_named(problems, proved: Certificate, shaped: Certificate) -> None:
    loop, C26 = problems.example_1(), problems.C26
    assert differences(proved, loop, SpringDamperGiven(C26, aim())) == [OTHER_AIM]
    for other in (None, aim("closed-loop"), aim(corner=100.0), dataclasses.replace(aim(), W2=aim().W1)):
        assert differences(shaped, loop, SpringDamperGiven(C26, other)) == [OTHER_AIM]
    assert differences(shaped, loop, SpringDamperWanted()) == [OTHER_AIM]


def test_all_that_differs_is_told(problems, proved: Certificate) -> None:
    found = differences(proved, problems.example_1(T=2e-3, osp=1.4), LinearWanted((1, 1, 1)))
    assert len(found) == 3
