"""A certificate without its frozen blocks proves like any other, and (10) holds at any ratios of the blocks."""

from __future__ import annotations

import dataclasses
from fractions import Fraction
from itertools import combinations
from typing import Any

import numpy as np
import pytest
from flint import fmpq
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.design.certificate import Certificate, content
from manyhands.design.levels.contract import loop_inequality
from manyhands.design.models.coupling import Partition
from manyhands.design.models.declared import DeclaredEnvironment
from manyhands.design.models.environment import DelayedNetwork, NetworkBox, StateSpaceEnvironment, TransferEnvironment
from manyhands.design.models.network import GROUND, Network, NetworkLink
from manyhands.design.models.statespace import StateSpace
from manyhands.design.models.transfer import InDifferences
from manyhands.design.problem import CouplingRequest, DeviceLevel, HapticLoop, LinearGiven, SpringDamperGiven
from manyhands.design.proof import exact, prove
from manyhands.design.proof.claim import Claim, read
from manyhands.design.proof.contract import Delta_D, Delta_V, condition_10
from manyhands.design.synthesis import design
from tests.support.reduction import at_any_ratio, condition_at, reduced

PORTS = ("dx", "dy", "dz")
DECLARED = np.array([[0.1, 0.02, 0.0], [0.02, 0.2, 0.03], [0.0, 0.03, 0.3]])


def data_of(certificate: Certificate) -> dict[str, Any]:
    return content(certificate) | {"id": certificate.id}


def failing(certificate: Certificate) -> list[str]:
    return [f"{f.condition}: {f.argument}" for f in prove(data_of(certificate)) if not f.holds]


def oscillators(method: str | None, delay: int) -> StateSpaceEnvironment:
    """A mass on a spring behind each port, and a common spring: 220 - 1e5/(s^2 + 2 s + 1500), 20 N/m across."""
    A, B = np.array([[0.0, 1.0], [-1500.0, -2.0]]), np.array([[0.0], [500.0]])
    one = StateSpace(A, B, np.array([[-200.0, 0.0]]), np.array([[200.0]]))
    if method is None:
        one = StateSpace(0.5 * np.eye(1), np.eye(1), np.array([[50.0]]), np.array([[100.0]]))
    A, B, C, D = (np.kron(np.eye(3), getattr(one, name)) for name in "ABCD")
    return StateSpaceEnvironment(PORTS, StateSpace(A, B, C, D + 20.0 * np.ones((3, 3))), method, delay)


def kinds(problems) -> dict[str, tuple[HapticLoop, CouplingRequest]]:
    """A loop with three blocks for every kind of environment, storage and coupling."""
    loop, soft = problems.example_1(), SpringDamperGiven(problems.uniform(800.0, 0.3))
    strong, low = problems.example_1(osp=8.0), problems.network
    wide = tuple(dataclasses.replace(link, stiffness=1.5 * link.stiffness) for link in low.links)
    across = ((100.0, 2.0e3), (1.0, 200.0))  # 10 N/m at rest, 100 N/m when pushed fast
    entries = tuple(tuple(((800.0, 8.0e4), (1.0, 200.0)) if i == j else across for j in range(3)) for i in range(3))
    # blocks that are not contiguous, and that split a device whose level joins its axes
    split = Partition(("even", "odd"), ((2, 0), (1,)))
    device = DeviceLevel("d", (0, 1, 2), np.array([[8.0, 1.0, 0.5], [1.0, 7.0, 0.5], [0.5, 0.5, 9.0]]))
    tied = dataclasses.replace(loop, devices=(device,), partition=split)

    def on(environment, base: HapticLoop = loop, tau: float = 0.0) -> HapticLoop:
        return dataclasses.replace(base, environment=environment, tau=tau)

    return {
        "network": (loop, soft),
        "linear, inside the tick late": (on(low, strong, tau=2e-4), LinearGiven(problems.blocks(loop, problems.C26))),
        "links between ports": (
            on(
                Network(
                    PORTS,
                    (),
                    (*(NetworkLink((p, GROUND), 500.0, 0.1) for p in PORTS), NetworkLink(("dx", "dz"), 300.0, 0.2)),
                )
            ),
            soft,
        ),
        "drifting": (
            on(Network(PORTS, (("free", 1.0),), tuple(NetworkLink((p, "free"), 0.0, 0.5) for p in PORTS))),
            soft,
        ),
        "box": (on(NetworkBox(low, dataclasses.replace(low, links=wide))), soft),
        "late": (on(DelayedNetwork(low, 2), strong), SpringDamperGiven(problems.uniform(1.4e4, 0.5))),
        "hold": (on(oscillators("zoh", 0), strong), soft),
        "discrete, late": (on(oscillators(None, 1), strong), soft),
        "rational": (on(TransferEnvironment(PORTS, entries), strong), soft),
        "rational, late": (on(TransferEnvironment(PORTS, entries, "tustin", 1), strong), soft),
        "one device of three axes": (tied, soft),
        "declared": (on(DeclaredEnvironment(PORTS, DECLARED)), soft),
    }


KINDS = (
    "network", "linear, inside the tick late", "links between ports", "drifting", "box", "late", "hold",
    "discrete, late", "rational", "rational, late", "one device of three axes", "declared",
)  # fmt: skip


@pytest.fixture(scope="module")
def designed(problems) -> dict[str, Certificate]:
    return {kind: design(loop, wanted).certificate for kind, (loop, wanted) in kinds(problems).items()}


def test_every_kind_is_named(designed: dict[str, Certificate]) -> None:
    assert tuple(designed) == KINDS
    storages = {isinstance(certificate.levels.P_E, str) for certificate in designed.values()}
    assert storages == {True, False}


@pytest.mark.parametrize("kind", KINDS)
def test_remaining_users_are_certified_with_any_others_frozen(designed: dict[str, Certificate], kind: str) -> None:
    whole = designed[kind]
    names = whole.loop.partition.names
    for count in range(1, len(names)):
        for frozen in combinations(names, count):
            certificate = reduced(whole, frozen)
            assert failing(certificate) == [], frozen
            assert certificate.loop.partition.names == tuple(name for name in names if name not in frozen)
            assert certificate.margins["(10)"] >= whole.margins["(10)"] * (1.0 - 1e-9)  # interlacing


@pytest.mark.parametrize("kind", KINDS)
def test_it_is_a_principal_part_of_the_whole(designed: dict[str, Certificate], kind: str) -> None:
    """(10) exactly; E by its response, built anew from the reduced physics."""
    whole = designed[kind]
    frozen = whole.loop.partition.names[1:2]
    certificate = reduced(whole, frozen)
    ports = [whole.loop.ports.index(port) for port in certificate.loop.ports]
    m = len(whole.loop.ports)

    def of(it: Certificate) -> np.ndarray:
        embed, share = it.loop.partition.embed, it.levels.device.share
        return loop_inequality(share * embed(it.levels.Delta_D), embed(it.levels.Delta_V), it.levels.Phi_E)

    both = [*ports, *(m + port for port in ports)]
    np.testing.assert_array_equal(of(certificate), of(whole)[np.ix_(both, both)])
    if kind == "declared":
        return  # there is no E to respond
    T = whole.loop.period
    for angle in (0.01, 0.3, 3.0):
        z = np.exp(1j * angle)
        expected = whole.loop.environment.environment(T).response(z)[np.ix_(ports, ports)]
        found = certificate.loop.environment.environment(T).response(z)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_without_frozen_axes_a_device_keeps_at_most_its_promised_level(designed: dict[str, Certificate]) -> None:
    """With no force at the frozen axes it is OSP with a Schur complement of its level, not with a part of it."""
    whole = designed["one device of three axes"]
    level = whole.loop.devices[0].level
    (device,) = reduced(whole, ["odd"]).loop.devices
    left, gone = [0, 2], [1]
    kept = level[np.ix_(left, left)] - level[np.ix_(left, gone)] @ np.linalg.solve(
        level[np.ix_(gone, gone)], level[np.ix_(gone, left)]
    )
    assert np.linalg.eigvalsh(kept - device.level)[0] > 0.0
    assert np.linalg.eigvalsh(device.level)[0] > 0.0
    both_whole = reduced(designed["network"], ["cx"])
    assert [d.name for d in both_whole.loop.devices] == ["d1", "d2"]


def test_a_declared_environment_keeps_its_part(designed: dict[str, Certificate]) -> None:
    held = reduced(designed["declared"], ["cy"])
    assert held.loop.environment == DeclaredEnvironment(("dx", "dz"), DECLARED[np.ix_([0, 2], [0, 2])])
    assert held.levels.P_E == "enforced"


def test_a_reduction_names_its_origin_and_can_be_reduced_again(designed: dict[str, Certificate]) -> None:
    whole = designed["late"]
    once = reduced(reduced(whole, ["cx"]), ["cz"])
    at_once = reduced(whole, ["cx", "cz"])
    assert at_once.method == {"algorithm": "reduction", "of": whole.id, "frozen": "cx, cz"}
    assert content(once) | {"method": {}} == content(at_once) | {"method": {}}
    assert at_once.id not in ("", whole.id)
    assert at_once.asked == whole.asked == {"coupling": "given", "objective": "feasible"}


def test_a_storage_is_minimised_over_what_is_hidden(designed: dict[str, Certificate]) -> None:
    """Of nine entries of one state each, the held port's inputs rest and its own forces are not seen."""
    whole, found = designed["rational"].levels.P_E, reduced(designed["rational"], ["cy"]).levels.P_E
    assert isinstance(whole, InDifferences)
    assert isinstance(found, InDifferences)
    whole, found = whole.P, found.P
    moving, seen = [0, 2, 3, 5, 6, 8], [0, 1, 4, 5]  # row by row without column 1; of these without row 1
    expected = np.linalg.inv(np.linalg.inv(np.asarray(whole)[np.ix_(moving, moving)])[np.ix_(seen, seen)])
    np.testing.assert_allclose(np.asarray(found), expected, rtol=1e-8, atol=1e-12 * np.abs(expected).max())
    without = np.asarray(whole)[np.ix_([0, 2, 6, 8], [0, 2, 6, 8])]
    assert np.linalg.eigvalsh(without - expected)[0] > -1e-12 * np.abs(expected).max()
    assert np.abs(without - expected).max() > 1e-6 * np.abs(expected).max()


def test_a_false_certificate_stays_false(designed: dict[str, Certificate]) -> None:
    """A part of what does not hold need not hold: what is wrong at a remaining port is found."""
    whole = designed["late"]
    less = dataclasses.replace(whole, levels=dataclasses.replace(whole.levels, P_E=0.5 * np.asarray(whole.levels.P_E)))
    assert any("(14)" in text for text in failing(reduced(less, ["cx"])))


@pytest.mark.parametrize(
    ("frozen", "words"),
    [(["cx", "c?"], r"found the frozen blocks \['c\?'\]"), (["cx", "cy", "cz"], "every block frozen")],
)
def test_what_cannot_be_reduced_is_refused(designed: dict[str, Certificate], frozen: list[str], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        reduced(designed["network"], frozen)


# --- any ratios


def claim_of(certificate: Certificate) -> Claim:
    return read(data_of(certificate))


ratios = st.fractions(0, 1, max_denominator=1000)


@settings(max_examples=40)
@given(data=st.data())
def test_10_holds_at_any_ratios(designed: dict[str, Certificate], data: st.DataObject) -> None:
    """The identity and the definiteness that the proof rests on, in rationals."""
    claim = claim_of(designed[data.draw(st.sampled_from(KINDS))])
    drawn: dict[str, Fraction] = {block.name: data.draw(ratios) for block in claim.blocks}
    s = {name: fmpq(value.numerator, value.denominator) for name, value in drawn.items()}
    m = len(claim.ports)
    by_port = {port: s[block.name] for block in claim.blocks for port in block.ports}
    expected: dict[tuple[int, int], fmpq] = {}
    for (i, j), value in condition_10(claim).items():
        exact.add_entry(expected, i, j, by_port[i % m] * value * by_port[j % m])
    for (i, j), value in Delta_D(claim).items():
        exact.add_entry(expected, i, j, (1 - by_port[i] * by_port[j]) * claim.share * value)
    for (i, j), value in Delta_V(claim).items():
        exact.add_entry(expected, m + i, m + j, (1 - by_port[i] * by_port[j]) * value)
    at = condition_at(claim, s)
    assert at == expected
    finding = at_any_ratio(claim)
    assert finding.holds
    # no smaller than the bound, less what floats took from it
    bound = fmpq(*(finding.value * (1.0 - 1e-9)).as_integer_ratio())
    for i in range(2 * m):
        exact.add_entry(at, i, i, -bound)
    assert exact.definite_by_groups(at, 2 * m, strict=False).holds


@pytest.mark.parametrize("what", ["Phi_E", "Delta_V", "share", "structure"])
def test_what_any_ratio_needs_is_needed(designed: dict[str, Certificate], what: str) -> None:
    claim = claim_of(designed["network"])
    match what:
        case "Phi_E":
            spoilt = dataclasses.replace(claim, Phi_E={(i, i): fmpq(2) for i in range(3)})
        case "Delta_V":
            negative = dataclasses.replace(claim.Delta_V[0], values=[[-1e-9]])
            spoilt = dataclasses.replace(claim, Delta_V=(negative, *claim.Delta_V[1:]))
        case "share":
            spoilt = dataclasses.replace(claim, share=fmpq(0))
        case _:
            spoilt = dataclasses.replace(claim, blocks=(*claim.blocks[:2], claim.blocks[1]))
    assert not at_any_ratio(spoilt).holds


def test_one_ratio_a_block_is_what_it_takes() -> None:
    """Two ratios within a block whose levels join its ports can break (10): the reason for one ratio a block."""
    Delta_G = Delta_V = np.array([[1.0, 0.9], [0.9, 1.0]])
    least = np.linalg.eigvalsh(Delta_G)
    # Phi_E = t Delta_G satisfies (10) just so: with Delta_V = Delta_G its limit is t = 1/2
    Phi = 0.499 * Delta_G
    assert least[0] > 0.0
    assert np.linalg.eigvalsh(loop_inequality(Delta_G, Delta_V, Phi))[0] > 0.0
    for s in (0.0, 0.3, 1.0):
        assert np.linalg.eigvalsh(loop_inequality(Delta_G, Delta_V, s * Phi * s))[0] > 0.0
    S = np.diag([1.0, 0.0])
    assert np.linalg.eigvalsh(loop_inequality(Delta_G, Delta_V, S @ Phi @ S))[0] < 0.0
