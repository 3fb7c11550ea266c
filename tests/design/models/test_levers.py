"""Links with lever arms: a network that has them is the same as one without, in scaled coordinates."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.design.certificate import content, from_content, identity
from manyhands.design.levels.network import diagonal_level, dissipation_matrix, structured_level
from manyhands.design.models.coupling import Partition
from manyhands.design.models.network import GROUND, Network, NetworkLink, scales
from manyhands.design.models.statespace import Matrix
from manyhands.design.problem import DeviceLevel, HapticLoop, SpringDamperWanted, Wish
from manyhands.design.proof import ProofInputError, prove
from manyhands.design.series import counted_parts
from manyhands.design.synthesis import design

T = 1e-3
ROUNDING = 1e-9  # relative: some hundreds of roundings, and a linear system of a condition of 1e5 at most

_scale = st.sampled_from([0.008, 0.05, 0.3, 1.0, 1.7, 12.5])
_value = st.sampled_from([0.5, 3.0, 40.0])


@st.composite
def networks(draw: st.DrawFn) -> tuple[Network, Network, Matrix]:
    """A network with lever arms; the same in coordinates s u without any; and s of its ports."""
    ports = tuple(f"p{i}" for i in range(draw(st.integers(1, 3))))
    masses = tuple(f"m{i}" for i in range(draw(st.integers(0, 3))))
    names = (*ports, *masses)
    s = {name: draw(_scale) for name in names}
    with_arms, plain = [], []
    for i, name in enumerate(names):  # every name is joined to one before it, or to the ground, and some twice
        others = draw(st.lists(st.sampled_from([*names[:i], GROUND]), min_size=1, max_size=2, unique=True))
        for other in others:
            k, b = 100.0 * draw(_value), draw(_value)
            arms = s[name], s.get(other, 1.0)
            with_arms.append(NetworkLink((name, other), k, b, arms))
            plain.append(NetworkLink((name, other), k, b))
    M = {name: draw(_value) for name in masses}
    lever = Network(ports, tuple((name, M[name] * s[name] ** 2) for name in masses), tuple(with_arms))
    return lever, Network(ports, tuple(M.items()), tuple(plain)), np.array([s[name] for name in ports])


@given(networks())
def test_the_force_is_that_of_the_scaled_network(drawn: tuple[Network, Network, Matrix]) -> None:
    lever, plain, s = drawn
    E, scaled = lever.environment(T), plain.environment(T)
    for z in (1.3, -1.0, np.exp(0.4j)):
        wanted = s[:, None] * scaled.response(z) * s
        assert np.abs(E.response(z) - wanted).max() <= ROUNDING * max(1.0, np.abs(wanted).max())
    static = s[:, None] * plain.split(T).stiffness * s
    assert np.abs(lever.split(T).stiffness - static).max() <= ROUNDING * max(1.0, np.abs(static).max())
    assert lever.split(T).rest.order == plain.split(T).rest.order


@given(networks())
def test_a_motion_that_stretches_no_link_but_to_ground(drawn: tuple[Network, Network, Matrix]) -> None:
    lever = drawn[0]
    free = replace(lever, links=tuple(link for link in lever.links if GROUND not in link.ends))
    moves = free.together()
    assert np.all(moves > 0.0)
    Z = dissipation_matrix(free, T).toarray()
    assert np.abs(Z @ moves).max(initial=0.0) <= ROUNDING * np.abs(Z).max(initial=0.0) * moves.max()


@given(networks())
def test_the_level_is_kept_by_the_energy(drawn: tuple[Network, Network, Matrix]) -> None:
    lever, m = drawn[0], len(drawn[0].ports)
    Z = dissipation_matrix(lever, T).toarray()
    level = np.zeros_like(Z)
    level[:m, :m] = diagonal_level(lever, T)
    assert np.linalg.eigvalsh(Z + level)[0] >= -ROUNDING * np.abs(Z).max()
    alone = Partition(tuple(lever.ports), tuple((i,) for i in range(m)))
    found = structured_level(dissipation_matrix(lever, T), alone, together=lever.together())
    level[:m, :m] = -np.diag([float(block[0, 0]) for block in found.blocks])
    assert np.linalg.eigvalsh(Z + level)[0] >= -ROUNDING * np.abs(Z).max()


def test_a_chain_of_many_levers_that_floats_keeps_nothing() -> None:
    """Beyond the groups that are proved exactly; by row sums alone it would seem to be tied to the ground."""
    names = [f"m{i}" for i in range(80)]
    arms = [(0.5, 0.7), (0.6, 0.4)] * 40
    ends = zip(["p", *names], names, arms, strict=False)
    links = [NetworkLink((a, b), 50.0, 0.2, own) for a, b, own in ends]
    chain = Network(("p",), tuple((name, 0.1) for name in names), tuple(links))
    assert diagonal_level(chain, T)[0, 0] == 0.0
    tied = replace(chain, links=(*chain.links, NetworkLink((names[-1], GROUND), 50.0, 0.2)))
    assert diagonal_level(tied, T)[0, 0] < 0.0


LOOP = (
    NetworkLink(("a", "b"), 1.0, 0.0, (0.02, 0.01)),
    NetworkLink(("b", "c"), 1.0, 0.0, (0.03, 0.02)),
    NetworkLink(("c", "a"), 1.0, 0.0, (0.02, 0.06)),
)


def test_gears_that_could_not_turn_are_refused() -> None:
    assert scales(LOOP) == {"a": 1.0, "b": 0.5, "c": pytest.approx(1.0 / 3.0)}
    wrong = (*LOOP[:2], NetworkLink(("c", "a"), 1.0, 0.0, (0.02, 0.0600001)))
    with pytest.raises(ValueError, match=r"two ways from a to \w that multiply its motion by .*; expected the same"):
        scales(wrong)
    with pytest.raises(ValueError, match="two ways from a to"):
        Network(("a",), (("b", 1.0), ("c", 1.0)), wrong)
    for arm in (0.0, -1.0, float("inf")):
        with pytest.raises(ValueError, match=r"link between .*: found the arms .*; expected finite ones > 0"):
            Network(("a",), (), (NetworkLink(("a", GROUND), 1.0, 0.0, (arm, 1.0)),))


def rack(arm: float = 0.008) -> HapticLoop:
    """A wheel, and a road that pushes the rack."""
    world = Network(
        ("wheel", "road"),
        (("column", 0.004), ("rod", 3.0)),
        (
            NetworkLink(("wheel", "column"), 60.0, 0.05),
            NetworkLink(("column", "rod"), 1e6, 200.0, (arm, 1.0)),
            NetworkLink(("rod", GROUND), 4e4, 1500.0),
            NetworkLink(("road", "rod"), 5e4, 100.0),
        ),
    )
    devices = (
        DeviceLevel("wheel", (0,), np.array([[0.1]]), turning=(0,)),
        DeviceLevel("road", (1,), np.array([[60.0]])),
    )
    return HapticLoop("rack", T, world.ports, devices, Partition(("cw", "cr"), ((0,), (1,))), world)


STIFFEST = SpringDamperWanted(Wish("stiffest"))


def failing(data: dict[str, Any]) -> list[str]:
    """What is not proved of a certificate's content."""
    return [f"{one.condition}: {one.argument}" for one in prove(data | {"id": identity(data)}) if not one.holds]


def test_a_certificate_with_levers_is_proved_and_read_back() -> None:
    certificate = design(rack(), STIFFEST).certificate
    data = content(certificate) | {"id": certificate.id}
    assert data["version"] == 6
    assert data["devices"]["wheel"]["turning"] == ["wheel"]
    assert "turning" not in data["devices"]["road"]
    assert [link.get("arms") for link in data["environment"]["links"]] == [None, [0.008, 1.0], None, None]
    assert identity(data) == certificate.id
    assert not failing(data)
    assert from_content(data).loop.environment == certificate.loop.environment
    assert from_content(data).loop.turning == {"wheel"}


@pytest.mark.parametrize("arms", [[0.0, 1.0], [-0.008, 1.0], [0.008], [0.008, "1"], [0.008, 1.0, 1.0], 3])
def test_forged_arms_are_refused(arms: object) -> None:
    data = content(design(rack(), STIFFEST).certificate)
    data["environment"]["links"][1]["arms"] = arms
    with pytest.raises(ProofInputError, match=r"environment\.links"):
        prove(data | {"id": identity(data)})


def test_a_proof_refuses_gears_that_could_not_turn() -> None:
    """Of these it says which masses springs hold, and would say it wrongly."""
    data = content(design(rack(), STIFFEST).certificate)
    links = data["environment"]["links"]
    links.append({"between": ["wheel", "rod"], "stiffness": 10.0, "damping": 0.0, "arms": [0.0081, 1.0]})
    with pytest.raises(ProofInputError, match=r"environment\.links.*two ways between two ends"):
        prove(data | {"id": identity(data)})
    links[-1]["arms"] = [0.008, 1.0]
    assert failing(data)  # it is read, and is another world than the one that was designed for


def test_another_arm_makes_another_world() -> None:
    data = content(design(rack(), STIFFEST).certificate)
    data["environment"]["links"][1]["arms"] = [0.8, 1.0]  # a hundred times the lever
    assert failing(data)


def test_a_contact_by_a_lever_is_not_counted_in_series() -> None:
    loop = rack()
    levered = replace(
        loop,
        environment=Network(
            loop.ports, (("rod", 3.0),), (
                NetworkLink(("wheel", "rod"), 1e6, 1.0, (0.008, 1.0)), NetworkLink(("road", "rod"), 5e4, 100.0),
                NetworkLink(("rod", GROUND), 4e4, 1500.0),
            ),
        ),
    )  # fmt: skip
    assert set(levered.environment.contacts()) == {"road"}
    assert counted_parts(levered, 0.5)[0] == 0.0
    counted = design(replace(levered, series=(0.0, 0.1)), STIFFEST).certificate
    data = content(counted)
    assert not failing(data)
    data["series"] = {"wheel": 0.1}
    assert any("wheel has a lever arm" in one for one in failing(data))
