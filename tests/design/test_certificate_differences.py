"""A proof does not show which session a certificate belongs to; the comparison with the session does."""

import dataclasses

import numpy as np
import pytest

from manyhands.design.certificate import Certificate, asked_text, describe_request, differences
from manyhands.design.models.environment import DelayedNetwork, NetworkBox, StateSpaceEnvironment, TransferEnvironment
from manyhands.design.models.network import Network, NetworkLink
from manyhands.design.models.statespace import StateSpace
from manyhands.design.models.weights import Filter, Transparency
from manyhands.design.problem import (
    CouplingRequest,
    HapticLoop,
    LinearGiven,
    LinearWanted,
    NoCoupling,
    PolePair,
    SpringDamperGiven,
    SpringDamperWanted,
    Wish,
)
from manyhands.design.synthesis import design

NOT_GIVEN = "the coupling is not the one that the session gives"
NOT_ASKED = "design.coupling differs: the certificate has given, the session asks for "
OTHER_AIM = "the transparency problem differs, in its objective or its weights"


def aim(objective: str = "loop-shaping", corner: float = 125.0) -> Transparency:
    return Transparency(objective, Filter.from_continuous((1.0,), (1.0 / corner, 1.0), 1e-3), Filter.one())


def softer(network: Network, factor: float = 0.9) -> Network:
    links = tuple(NetworkLink(link.ends, factor * link.stiffness, link.damping) for link in network.links)
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


def asking(certificate: Certificate, wanted: CouplingRequest) -> Certificate:
    """The same claims, as if the coupling had been found for this wish."""
    return dataclasses.replace(certificate, asked=describe_request(wanted, certificate.loop.partition.names))


def test_what_fits(problems, proved: Certificate, shaped: Certificate, linear: Certificate) -> None:
    loop = problems.example_1()
    assert differences(proved, loop, SpringDamperGiven(problems.C26)) == []
    assert differences(shaped, loop, SpringDamperGiven(problems.C26, aim())) == []
    assert differences(linear, loop, LinearGiven(linear.blocks)) == []
    for wanted in (SpringDamperWanted(), SpringDamperWanted(Wish("stiffest"))):
        found = design(loop, wanted).certificate
        assert differences(found, loop, wanted) == []


def test_a_feasible_certificate_is_not_the_stiffest(problems) -> None:
    loop = problems.example_1()
    feasible, stiffest = SpringDamperWanted(), SpringDamperWanted(Wish("stiffest"))
    assert differences(design(loop, feasible).certificate, loop, stiffest) == [
        "design.objective differs: the certificate has feasible, the session asks for stiffest"
    ]
    assert differences(design(loop, stiffest).certificate, loop, feasible) == [
        "design.objective differs: the certificate has stiffest, the session asks for feasible"
    ]


@pytest.mark.parametrize(
    ("asked", "wanted", "keys"),
    [
        (SpringDamperWanted(), SpringDamperWanted(Wish(algorithm="complementarity")), ["algorithm", "iterations"]),
        (
            SpringDamperWanted(Wish(algorithm="complementarity", iterations=7)),
            SpringDamperWanted(Wish(algorithm="complementarity")),
            ["iterations"],
        ),
        (LinearWanted((1, 1, 1)), LinearWanted((1, 2, 1)), ["order"]),
        (LinearWanted((2, 2, 2)), LinearWanted((2, 2, 2), poles=(PolePair(30.0, 0.7),)), ["poles"]),
        (LinearWanted((2, 2, 2), poles=(PolePair(30.0),)), LinearWanted((2, 2, 2), poles=(PolePair(31.0),)), ["poles"]),
        (LinearWanted((1, 1, 1)), LinearWanted((1, 1, 1), Wish("stiffest")), ["objective"]),
        (LinearWanted((1, 1, 1), Wish("loop-shaping", aim())), LinearWanted((1, 1, 1)), ["objective", "weights"]),
        (
            LinearWanted((1, 1, 1), Wish("loop-shaping", aim())),
            LinearWanted((1, 1, 1), Wish("loop-shaping", aim(corner=100.0))),
            ["weights"],
        ),
        (SpringDamperWanted(), LinearWanted((1, 1, 1)), ["coupling"]),
        (SpringDamperWanted(Wish("stiffest")), LinearWanted((1, 1, 1)), ["coupling", "objective"]),
    ],
)
def test_every_key_that_was_asked_counts(problems, linear: Certificate, asked, wanted, keys: list[str]) -> None:
    certificate, loop = asking(linear, asked), problems.example_1()
    for one, other in ((asked, wanted), (wanted, asked)):
        found = [text for text in differences(asking(linear, one), loop, other) if text.startswith("design.")]
        assert sorted(text.split()[0].removeprefix("design.") for text in found) == keys
        assert all("differs: the certificate has " in text and "the session asks for " in text for text in found)
    same = [text for text in differences(certificate, loop, asked) if text.startswith("design.")]
    assert same == []


def test_what_a_certificate_leaves_unsaid_is_named(problems) -> None:
    """Whoever takes words out of ``asked`` and makes a new id has a certificate that fits no session."""
    loop, wanted = problems.example_1(), SpringDamperWanted(Wish("stiffest"))
    found = design(loop, SpringDamperWanted()).certificate
    for asked, keys in (
        ({}, ["algorithm", "coupling", "objective"]),
        ({"coupling": "spring-damper"}, ["algorithm", "objective"]),
        ({"objective": "stiffest"}, ["algorithm", "coupling"]),
        ({"coupling": "linear"}, ["coupling", "objective"]),  # what only one class may have is left out
        ({"coupling": "linear", "objective": None}, ["coupling", "objective"]),
    ):
        texts = differences(dataclasses.replace(found, asked=asked), loop, wanted)
        assert sorted(text.split()[0].removeprefix("design.") for text in texts) == keys, asked
    assert texts[-1] == "design.objective differs: the certificate has null, the session asks for stiffest"
    (text,) = differences(
        dataclasses.replace(found, asked={"coupling": "spring-damper", "algorithm": "convex"}), loop, wanted
    )
    assert text == "design.objective differs: the certificate has nothing, the session asks for stiffest"


def test_messages_quote_foreign_files_shortly_and_plainly(problems, proved: Certificate) -> None:
    asked = {"coupling": "\x1b[2J", "objective": "x" * 1000, "order": [0] * 10_000}
    foreign = dataclasses.replace(proved, asked=asked)
    text = "\n".join([asked_text(asked), *differences(foreign, problems.example_1(), SpringDamperGiven(problems.C26))])
    assert "\\u001b[2J" in text
    assert "\x1b" not in text
    assert len(text) < 2000


def test_another_loop_is_named(problems, proved: Certificate) -> None:
    loop, network = problems.example_1(), problems.network
    stiffer = softer(network, 1.1)
    matrices = StateSpaceEnvironment(network.ports, network.environment(1e-3))
    for other, words in (
        (problems.example_1(T=2e-3), "the period"),
        (dataclasses.replace(loop, tau=1e-4), "the delay inside the tick"),
        (dataclasses.replace(loop, period_tolerance=0.1), "the period tolerance"),
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
    """Environments of the same kind that differ in one number."""
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
        given = SpringDamperGiven(problems.C26)
        assert differences(certificate, on(loop, one), given) == []
        assert differences(certificate, on(loop, another), given) == ["the environment differs"]


def test_another_coupling_is_named(problems, proved: Certificate, linear: Certificate) -> None:
    loop = problems.example_1()
    for wanted in (SpringDamperGiven(problems.uniform(700.0, 0.0372)), LinearGiven((StateSpace.static([[1e-3]]),) * 3)):
        assert differences(proved, loop, wanted) == [NOT_GIVEN]
        assert differences(linear, loop, wanted) == [NOT_GIVEN]
    assert differences(linear, loop, SpringDamperGiven(problems.C26)) == [NOT_GIVEN]
    # the same transfer function in other numbers is another file
    assert differences(proved, loop, LinearGiven(proved.blocks)) == [NOT_GIVEN]
    for certificate, wanted, word, words in (
        (
            proved,
            LinearWanted((1, 1, 1)),
            "linear",
            "is of the spring-damper class, and the session wants a linear one",
        ),
        (linear, SpringDamperWanted(), "spring-damper", "is not of the spring-damper class that the session wants"),
    ):
        # what was asked is no claim: the coupling itself is compared, whatever origin the file states
        assert differences(asking(certificate, wanted), loop, wanted) == [f"the coupling {words}"]
        found = differences(certificate, loop, wanted)
        assert (found[0], found[-1]) == (NOT_ASKED + word, f"the coupling {words}")
    assert differences(proved, loop, NoCoupling()) == [NOT_ASKED + "none", "the session wants no coupling"]


def test_another_aim_is_named(problems, proved: Certificate, shaped: Certificate) -> None:
    loop, C26 = problems.example_1(), problems.C26
    given = SpringDamperGiven(C26, aim())
    assert differences(asking(proved, given), loop, given) == [OTHER_AIM]
    for other, keys in (
        (None, ["objective", "weights"]),
        (aim("closed-loop"), ["objective"]),
        (aim(corner=100.0), ["weights"]),
        (dataclasses.replace(aim(), W2=aim().W1), ["weights"]),
    ):
        wanted = SpringDamperGiven(C26, other)
        assert differences(asking(shaped, wanted), loop, wanted) == [OTHER_AIM]  # what is claimed is compared, too
        *asked, last = differences(shaped, loop, wanted)
        assert [text.split()[0] for text in asked] == [f"design.{key}" for key in keys]
        assert last == OTHER_AIM


def test_every_difference_is_reported(problems, proved: Certificate) -> None:
    wanted = LinearWanted((1, 1, 1))
    found = differences(asking(proved, wanted), problems.example_1(T=2e-3, osp=1.4), wanted)
    assert len(found) == 3
