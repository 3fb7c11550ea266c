"""A ladder: rungs that are certificates like any other, softer and softer, and mixtures of them that hold exactly."""

from __future__ import annotations

import copy
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.design.certificate import Certificate, content
from manyhands.design.errors import Infeasible
from manyhands.design.ladder import MOST_PORTS, Ladder, automatic_delays, design_ladder
from manyhands.design.models.coupling import Partition, SpringDamper
from manyhands.design.models.environment import DelayedNetwork
from manyhands.design.models.network import GROUND, Network, NetworkLink
from manyhands.design.problem import DeviceLevel, HapticLoop, LinearWanted, SpringDamperGiven, SpringDamperWanted, Wish
from manyhands.design.proof import ProofInputError, prove
from manyhands.design.proof.ladder import prove_ladder
from manyhands.design.synthesis import design

T = 1e-3
QUARTERS = (0.25 * T, 0.5 * T, T)
PAIRED = Partition(("c", "d"), ((2, 0), (1,)))


def late(partition: Partition, stiffness: float = 600.0, osp: float = 1.37) -> HapticLoop:
    """Three hands at a ring of masses that answers a tick late, and so lacks passivity."""
    ports = ("p0", "p1", "p2")
    links = [NetworkLink((port, f"m{i}"), stiffness, 0.1) for i, port in enumerate(ports)]
    links += [NetworkLink((f"m{i}", f"m{(i + 1) % 3}"), stiffness / 2.0, 0.2) for i in range(3)]
    network = Network(ports, tuple((f"m{i}", 0.5) for i in range(3)), (*links, NetworkLink(("m0", GROUND), 200.0, 0.5)))
    devices = tuple(DeviceLevel(f"d{i}", (i,), np.array([[osp * (1.0 + 0.1 * i)]])) for i in range(3))
    return HapticLoop("late", T, ports, devices, partition, DelayedNetwork(network, 1))


def ladder_of(loop: HapticLoop, wanted: Any = SpringDamperWanted(), delays: tuple[float, ...] = QUARTERS) -> Ladder:  # noqa: B008
    found = design_ladder(design(loop, wanted).certificate, wanted, delays)
    assert found.ladder is not None
    return found.ladder


def plain(certificate: Certificate) -> dict[str, Any]:
    return content(certificate) | {"id": certificate.id}


# --- an opinion on (10) that shares nothing with the package


def positive_definite(M: list[list[Fraction]]) -> bool:
    """By elimination, exactly."""
    M = [row[:] for row in M]
    for k in range(len(M)):
        if M[k][k] <= 0:
            return False
        for i in range(k + 1, len(M)):
            factor = M[i][k] / M[k][k]
            for j in range(k, len(M)):
                M[i][j] -= factor * M[k][j]
    return True


def mixed(ladder: Ladder, chosen: list[int]) -> list[list[Fraction]]:
    """(10) with block i at rung ``chosen[i]``, 2m x 2m."""
    partition = ladder.rungs[0].loop.partition
    m = partition.size
    M = [[-Fraction(ladder.Phi_E[i % m, j % m]) for j in range(2 * m)] for i in range(2 * m)]
    for number, block in enumerate(partition.blocks):
        levels = ladder.rungs[chosen[number]].levels
        share = Fraction(levels.device.share)
        for a, i in enumerate(block):
            for b, j in enumerate(block):
                M[i][j] += share * Fraction(levels.Delta_D[number][a, b])
                M[m + i][m + j] += Fraction(levels.Delta_V[number][a, b])
    return M


# --- the rungs


@pytest.mark.parametrize("partition", ["decentralised", "centralised"])
def test_example_1_has_a_rung_for_every_quarter(problems, partition: str) -> None:
    loop = problems.example_1(getattr(problems, partition))
    ladder = ladder_of(loop)
    assert ladder.taus == (0.0, *QUARTERS)
    assert ladder.independent
    assert len({rung.id for rung in ladder.rungs}) == 4
    stiffest = [rung.spring_damper.stiffness[0, 0] for rung in ladder.rungs if rung.spring_damper is not None]
    assert stiffest == pytest.approx([1110.21, 568.35, 390.59, 239.60], rel=1e-4)
    for rung, tau in zip(ladder.rungs[1:], QUARTERS, strict=True):
        assert all(finding.holds for finding in prove(plain(rung)))
        assert rung.loop.tau == tau
        assert rung.method["rung of"] == ladder.rungs[0].id
        alone = design(replace(loop, tau=tau), SpringDamperWanted()).certificate
        assert rung.spring_damper is not None
        assert alone.spring_damper is not None
        np.testing.assert_allclose(
            rung.spring_damper.stiffness, alone.spring_damper.stiffness, rtol=1e-4, atol=1e-3 * stiffest[0]
        )
        assert rung.levels.device == alone.levels.device  # the gain that leaves most room, as a whole design finds it
        assert rung.margins["(10)"] == pytest.approx(alone.margins["(10)"], rel=1e-3)


def test_every_rung_covers_the_longer_periods_of_the_first(problems) -> None:
    loop = replace(problems.example_1(), period_tolerance=0.2)
    ladder = ladder_of(loop)
    assert ladder.taus == (0.0, *QUARTERS)
    assert ladder.independent
    assert [rung.period_tolerance for rung in ladder.rungs] == [0.2] * 4
    for rung, prompt in zip(ladder.rungs, ladder_of(problems.example_1()).rungs, strict=True):
        assert all(finding.holds for finding in prove(plain(rung)))
        assert rung.spring_damper is not None
        assert prompt.spring_damper is not None
        assert rung.spring_damper.stiffness[0, 0] < prompt.spring_damper.stiffness[0, 0]


def test_the_stiffest_stays_the_stiffest(problems) -> None:
    loop, wanted = problems.example_1(), SpringDamperWanted(Wish("stiffest"))
    for rung in ladder_of(loop, wanted).rungs:
        alone = design(replace(loop, tau=rung.tau), wanted).certificate
        assert rung.spring_damper is not None
        assert alone.spring_damper is not None
        np.testing.assert_allclose(rung.spring_damper.stiffness, alone.spring_damper.stiffness, rtol=1e-4)
        budget = 1.37 / ((0.5 + 1.5 * rung.tau / T) * T)
        assert 0.97 * budget < rung.spring_damper.stiffness[0, 0] < budget


def test_a_given_coupling_is_kept_while_it_can_be_certified(problems) -> None:
    ladder = ladder_of(problems.example_1(), SpringDamperGiven(problems.C26))
    kept = [rung.spring_damper.stiffness[0, 0] for rung in ladder.rungs if rung.spring_damper is not None]
    assert kept[:3] == [704.9058] * 3  # below 1566 and 1096 N/m, not below the 685 of a whole tick
    assert kept[3] == pytest.approx(239.6, rel=1e-3)


def test_a_linear_coupling_is_softened_by_springs_and_dampers(problems) -> None:
    ladder = ladder_of(problems.example_1(), LinearWanted((1, 1, 1)), (T,))
    assert ladder.rungs[0].spring_damper is None
    assert all(isinstance(part, SpringDamper) for part in ladder.rungs[1].coupling)
    assert ladder.independent
    asked = {"coupling": "linear", "objective": "feasible", "algorithm": "convex", "order": {"cx": 1, "cy": 1, "cz": 1}}
    assert [rung.asked for rung in ladder.rungs] == [
        asked,
        asked,
    ]  # the session's wish; method records how it was softened


def test_what_is_asked_of_transparency_is_asked_of_the_rungs(problems) -> None:
    from manyhands.design.models.weights import Filter, Transparency

    low_pass = Filter.from_continuous((1.0,), (1.0 / 125.0, 1.0), T)
    aim = Transparency("loop-shaping", low_pass, Filter((1.0,), (1.0,)))
    ladder = ladder_of(problems.example_1(), SpringDamperWanted(Wish("loop-shaping", aim)), (0.5 * T,))
    first, second = (rung.transparency for rung in ladder.rungs)
    assert first is not None
    assert second is not None
    assert first.gamma < second.gamma  # what the delay costs
    assert second.gamma < 40.0  # of feasible couplings, 49 and more


def test_delays_without_a_coupling_are_reported() -> None:
    loop = late(PAIRED)
    first = design(loop, SpringDamperWanted()).certificate
    found = design_ladder(first, SpringDamperWanted(), QUARTERS)
    assert found.ladder is not None
    assert found.ladder.taus == (0.0, 0.25 * T)
    (note,) = found.notes
    assert note.startswith("no rung for a delay of 0.5 ms, 1 ms: ")
    assert "the environment lacks passivity" in note
    nothing = design_ladder(first, SpringDamperWanted(), (0.5 * T,))
    assert nothing.ladder is None
    assert len(nothing.notes) == 1
    with pytest.raises(Infeasible):
        design(replace(loop, tau=0.5 * T), SpringDamperWanted())


def test_if_rung_0_needs_too_much_another_environment_level_is_searched() -> None:
    """Rung 0's Phi_E may be as great as its own levels allow; then a rung has its own, and that serves rung 0 too."""
    loop = late(Partition(("a", "b", "c"), ((0,), (1,), (2,))))
    given_one = SpringDamperGiven(SpringDamper(np.diag([2600.0, 2600.0, 900.0]), np.diag([0.05, 0.05, 0.05])))
    ladder = ladder_of(loop, given_one, (0.25 * T,))
    first, second = ladder.rungs
    share = second.levels.device.share
    assert np.max(np.diag(first.levels.Phi_E) / np.diag(loop.Delta_D)) > share  # (10) fails beside it
    assert np.array_equal(ladder.Phi_E, second.levels.Phi_E)
    assert ladder.independent
    for chosen in ([0, 0, 0], [1, 0, 0], [0, 1, 1], [1, 1, 1]):
        assert positive_definite(mixed(ladder, chosen))


def test_the_delays_that_nobody_stated(problems) -> None:
    loop = problems.example_1()
    assert automatic_delays(loop) == QUARTERS
    assert automatic_delays(replace(loop, tau=0.3e-3)) == (0.5 * T, T)
    assert automatic_delays(replace(loop, tau=T)) == ()
    ports = tuple(f"p{i}" for i in range(MOST_PORTS + 1))
    many = HapticLoop(
        "many",
        T,
        ports,
        tuple(DeviceLevel(port, (i,), np.eye(1)) for i, port in enumerate(ports)),
        Partition(ports, tuple((i,) for i in range(len(ports)))),
        Network(ports, (), tuple(NetworkLink((port, GROUND), 100.0, 0.1) for port in ports)),
    )
    assert automatic_delays(many) == (T,)


@pytest.mark.parametrize("delays", [(0.0,), (2e-4, 2e-4), (5e-4, 2e-4), (2e-4, 1.1e-3)])
def test_delays_that_do_not_grow_within_the_period_are_refused(problems, delays: tuple[float, ...]) -> None:
    first = design(problems.example_1(), SpringDamperWanted()).certificate
    with pytest.raises(ValueError, match="expected them to grow from 0"):
        design_ladder(first, SpringDamperWanted(), delays)
    with pytest.raises(ValueError, match="expected one of them"):
        prove_ladder([plain(first)], 1)


# --- mixing


@settings(max_examples=15, deadline=None)
@given(data=st.data())
def test_every_mixture_of_a_ladder_is_positive_definite(problems, data: st.DataObject) -> None:
    """Passive networks and late ones, blocks of any structure, levels from ladders of two to four rungs."""
    stiffness = data.draw(st.floats(100.0, 700.0))
    partition = data.draw(problems.partitions(3))
    loop = late(partition, stiffness, data.draw(st.floats(1.2, 4.0)))
    if data.draw(st.booleans()):
        loop = replace(loop, environment=loop.environment.network)
    delays = tuple(sorted(data.draw(st.sets(st.sampled_from([0.1e-3, *QUARTERS]), min_size=1, max_size=3))))
    found = design_ladder(design(loop, SpringDamperWanted()).certificate, SpringDamperWanted(), delays)
    if found.ladder is None:
        assert found.notes
        return
    assert found.ladder.independent
    rungs, blocks = len(found.ladder.rungs), len(partition.blocks)
    for _ in range(4):
        chosen = data.draw(st.lists(st.integers(0, rungs - 1), min_size=blocks, max_size=blocks))
        assert positive_definite(mixed(found.ladder, chosen))


@pytest.fixture(scope="module")
def lacking() -> tuple[dict[str, Any], dict[str, Any]]:
    """The plain data of a ladder of two rungs over an environment that lacks passivity."""
    first, second = ladder_of(late(PAIRED), delays=(0.25 * T,)).rungs
    return plain(first), plain(second)


def test_a_ladder_is_proved_from_its_plain_data(lacking: tuple[dict[str, Any], dict[str, Any]]) -> None:
    proof = prove_ladder(lacking, 1)
    assert all(finding.holds for finding in (proof.one_loop, proof.together, proof.independent))
    assert "joins no two blocks" in proof.independent.argument
    other = prove_ladder(lacking, 0)  # rung 0's Phi_E is more than rung 1 can bear
    assert other.one_loop.holds
    assert not other.together.holds
    assert other.together.argument.startswith("rung 1: ")


def forged(lacking: tuple[dict[str, Any], dict[str, Any]]) -> tuple[dict[str, Any], dict[str, Any]]:
    first, second = copy.deepcopy(lacking)
    return first, second


@pytest.mark.parametrize("rung", [0, 1])
@pytest.mark.parametrize("level", ["share", "Delta_V", "Delta_D"])
def test_levels_that_do_not_go_together_are_refused(lacking, level: str, rung: int) -> None:
    """One number of one rung; the other rung is as it was."""
    data = forged(lacking)
    levels = data[rung]["levels"]
    if level == "share":
        levels["share"] *= 0.25
    else:
        levels[level]["d"][0][0] *= 0.05
    proof = prove_ladder(data, 1)
    assert proof.one_loop.holds
    assert not proof.together.holds
    assert not proof.independent.holds
    assert proof.together.argument.startswith(f"rung {rung}: ")


def test_rungs_of_another_loop_or_in_another_order_are_refused(lacking) -> None:
    def refused(first: dict[str, Any], second: dict[str, Any]) -> str:
        proof = prove_ladder((first, second), 0)
        assert not any(finding.holds for finding in (proof.one_loop, proof.together, proof.independent))
        return proof.one_loop.argument

    for key, change in (
        ("period", 0.0011),
        ("environment", {**lacking[1]["environment"], "delay": 0}),
        ("structure", {"c": ["p2", "p1"], "d": ["p0"]}),
        ("devices", {**lacking[1]["devices"], "d0": {"ports": ["p0"], "osp": [[1.3]]}}),
    ):
        first, second = forged(lacking)
        second[key] = change
        assert refused(first, second) == f"rung 1: {key} is not rung 0's"
    first, second = forged(lacking)
    second |= {"period_tolerance": 0.1, "version": 4}
    assert refused(first, second) == "rung 1: period_tolerance is not rung 0's"
    first, second = forged(lacking)
    second["structure"] = dict(reversed(second["structure"].items()))
    assert refused(first, second) == "rung 1: the order of structure is not rung 0's"
    refused(*reversed(forged(lacking)))  # delays that do not grow
    refused(lacking[0], lacking[0])
    first, second = forged(lacking)
    del second["levels"]["share"]
    with pytest.raises(ProofInputError, match="levels"):
        prove_ladder((first, second), 0)


def test_a_nonpassive_level_that_joins_blocks_changes_their_rungs_together(lacking) -> None:
    m = 3
    for sign, independent in ((1.0, False), (-1.0, True)):
        first, second = forged(lacking)
        first["levels"]["Phi_E"] = (sign * (0.01 * np.eye(m) + 0.005 * np.ones((m, m)))).tolist()
        proof = prove_ladder((first, second), 0)
        assert proof.together.holds
        assert proof.independent.holds is independent
    first["levels"]["Phi_E"] = (-0.01 * np.eye(m) + 0.005 * np.ones((m, m))).tolist()  # one eigenvalue above zero
    assert not prove_ladder((first, second), 0).independent.holds


def test_rungs_that_divide_a_device_differently_are_not_mixed() -> None:
    """Each rung keeps to the device's joint level; a block of one beside a block of the other would exceed it."""
    osp = np.array([[1.0, 0.9], [0.9, 1.0]])
    walls = Network(("p0", "p1"), (), tuple(NetworkLink((port, GROUND), 1e6, 0.0) for port in ("p0", "p1")))
    device = (DeviceLevel("d", (0, 1), osp),)
    partition = Partition(("a", "b"), ((0,), (1,)))

    def rung(shares: tuple[float, float], tau: float) -> dict[str, Any]:
        loop = HapticLoop("split", T, walls.ports, device, partition, walls, tau)
        given = SpringDamperGiven(SpringDamper(np.diag([50.0, 50.0]), np.diag([1e-3, 1e-3])))
        data = content(design(loop, given).certificate)
        levels = data["levels"]
        for name, share in zip("ab", shares, strict=True):
            limit = share / (2.0 * levels["kappa"])
            K = 0.97 * limit * 2.0 / T
            J = limit - T / 2.0 * K
            data["coupling"]["blocks"][name] = {"stiffness": [[K]], "damping": [[0.0]]}
            levels["Delta_D"][name] = [[share]]
            levels["Delta_V"][name] = [[0.99 * (limit**2 / J - limit)]]
        levels["Phi_E"] = {"a": [[-499.0]], "b": [[-499.0]]}
        return {**data, "margins": {}}

    rungs = (rung((0.147, 0.05), 0.0), rung((0.05, 0.147), 1e-6))
    for data in rungs:
        assert [f for f in prove({**data, "id": "0"}) if not f.holds and not f.condition.startswith("the id")] == []
    proof = prove_ladder([{**data, "id": "0"} for data in rungs], 0)
    assert proof.together.holds
    assert not proof.independent.holds
    assert "a different Delta_D" in proof.independent.argument
    assert np.linalg.eigvalsh(osp - np.diag([0.147, 0.05])).min() > 0.0  # each rung keeps what the device promises
    assert (
        np.linalg.eigvalsh(osp - np.diag([0.147, 0.147])).min() < 0.0
    )  # what block a of one and b of the other count on
