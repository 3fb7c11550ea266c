"""Linkages in the prover: the same bending as in floats, bounds that hold and are near, and data that are refused."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from flint import arb, fmpq
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.design.models.linkage import Delta, FiveBar, Linkage, Poses, SerialChain, greatest_bending
from manyhands.design.proof.exact import Item
from manyhands.design.proof.finding import ProofInputError
from manyhands.design.proof.jets import Jet
from manyhands.design.proof.linkage import _directions, bends_at_most, read_linkage
from tests.support.linkages import ARM, DELTA, FIVE_BAR, LINKAGES, STYLUS, data_of, random_linkage, rational

SHARE = st.floats(0.0, 1.0)
BELOW = FiveBar(Poses((-0.05, -0.19), (0.05, -0.13)), apart=0.06, upper=0.12, rod=0.16)


@pytest.mark.parametrize("linkage", [*LINKAGES.values(), BELOW], ids=[*LINKAGES, "five-bar, its tip below"])
@given(at=st.tuples(SHARE, SHARE, SHARE), width=st.floats(0.0, 0.2), share=st.tuples(SHARE, SHARE, SHARE))
def test_the_balls_over_a_part_have_the_bending_of_each_of_its_poses(
    linkage: Linkage, at: tuple[float, ...], width: float, share: tuple[float, ...]
) -> None:
    low, high = np.array(linkage.poses.low), np.array(linkage.poses.high)
    m = linkage.axes
    first = low + (1.0 - width) * np.array(at[:m]) * (high - low)
    last = first + width * (high - low)
    jets = Jet.arguments([arb(float(a)).union(arb(float(b))) for a, b in zip(first, last, strict=True)])
    pose = first + np.array(share[:m]) * (last - first)
    try:
        forms = data_of(linkage).forms(jets)
    except ZeroDivisionError:  # too wide a part
        return
    tensor = linkage.bending(pose)
    pairs = [(j, k) for j in range(m) for k in range(j + 1)]
    rounding = 1e-9 * np.abs(tensor).max()
    for i, row in enumerate(forms):
        for entry, (j, k) in zip(row, pairs, strict=True):
            assert entry.value.overlaps(arb(tensor[i, j, k], rounding))
            steps = [arb(float(to)) - jet.middle for to, jet in zip(pose, jets, strict=True)]
            along = sum((slope * step for slope, step in zip(entry.slopes, steps, strict=True)), entry.middle)
            assert along.overlaps(arb(tensor[i, j, k], rounding))


@pytest.mark.parametrize("kind", LINKAGES)
def test_what_is_proved_is_no_less_than_the_search_and_at_most_a_tenth_more(kind: str) -> None:
    """Where a box is narrow: :func:`tests.support.linkages.least_proved` is the longer form, for more of them."""
    linkage = random_linkage(kind, np.random.default_rng(1))
    kappa, data = greatest_bending(linkage), data_of(linkage)
    assert not bends_at_most(data, rational(0.999 * kappa)).holds
    assert bends_at_most(data, rational(1.1 * kappa), most_parts=2_000).holds


@pytest.mark.parametrize("linkage", LINKAGES.values(), ids=LINKAGES)
def test_a_kappa_that_is_too_small_is_refuted_by_a_pose(linkage: Linkage) -> None:
    kappa = greatest_bending(linkage)
    found = bends_at_most(data_of(linkage), rational(0.99 * kappa))
    assert not found.holds
    assert "the tip bends by" in found.argument
    assert 0.97 * 0.99 * kappa < found.least <= kappa * (1.0 + 1e-9)  # 0.97: directions lie 0.1 rad from each other


def test_the_bound_of_a_whole_delta_robot_is_proved() -> None:
    """Over all of its box: by half above the search, so that it is quick."""
    assert bends_at_most(data_of(DELTA), rational(1.5 * greatest_bending(DELTA)), most_parts=2_000).holds


@dataclass(frozen=True)
class Bent:
    """Any s(v) = (S + x S_1) v v over |x| <= 1, in the plane.

    Attributes:
        middle: S: by coordinate of s, its entries 11, 12 and 22.
        slopes: S_1, likewise.
    """

    middle: tuple[tuple[float, float, float], ...]
    slopes: tuple[tuple[float, float, float], ...] = ((0.0,) * 3,) * 2
    low = (fmpq(-1), fmpq(-1))

    @property
    def whole(self) -> list[tuple[fmpq, fmpq]]:
        return [(fmpq(-1), fmpq(1))] * 2

    def forms(self, pose: list[Jet]) -> list[list[Jet]]:
        return [
            [pose[0] * arb(slope) + arb(entry) for entry, slope in zip(row, slopes, strict=True)]
            for row, slopes in zip(self.middle, self.slopes, strict=True)
        ]


ROUND = (1.0, 0.0, 1.0)  # |v|^2


@pytest.mark.parametrize(
    ("bent", "greatest"),
    [
        (Bent((ROUND, (0.0,) * 3), (ROUND, (0.0,) * 3)), 2.0),
        (Bent((ROUND, (0.0,) * 3), ((0.0,) * 3, ROUND)), math.sqrt(2.0)),  # s changes at a right angle to itself
        (Bent(((0.0, 1.0, 0.0), (0.0, 0.0, 0.0))), 1.0),  # sin of twice the angle
    ],
    ids=["along itself", "across itself", "by the direction"],
)
def test_bending_of_any_form_is_bounded_from_above_and_nearly_so(bent: Any, greatest: float) -> None:
    assert not bends_at_most(bent, rational(0.999 * greatest), most_parts=200).holds
    assert bends_at_most(bent, rational(1.02 * greatest), most_parts=200).holds


def test_directions_between_those_that_are_looked_at_count() -> None:
    """With |s| = |cos 2(a - a_0)| for the angle a of v, a_0 in the middle between two directions."""
    nearest = float(_directions(2).nearest.mid())
    bent: Any = Bent(((math.cos(2 * nearest), math.sin(2 * nearest), -math.cos(2 * nearest)), (0.0,) * 3))
    assert not bends_at_most(bent, rational(1.0 - 1e-9)).holds
    assert bends_at_most(bent, rational(1.0 + 1e-9)).holds


@pytest.mark.parametrize(
    ("linkage", "because"),
    [
        (SerialChain(Poses((-1.0, -0.5), (1.0, 0.6)), ARM.turns, ARM.links), "the tip bends by|regular"),
        (SerialChain(Poses((-1.0, -0.5), (1.0, 0.5)), ARM.turns, ARM.links), "regular"),  # straight in the middle
        (FiveBar(Poses((-0.3, 0.1), (0.3, 0.2)), apart=0.06, upper=0.12, rod=0.16), "within reach|bends by"),
        (Delta(Poses((-0.04, -0.04, 0.3), (0.04, 0.04, 0.4)), DELTA.upper, DELTA.rod, 0.06, 0.03), "within reach"),
    ],
    ids=["a singular pose", "in the middle", "reach at the sides", "reach everywhere"],
)
def test_a_box_with_a_singular_pose_or_one_out_of_reach_is_never_proved(linkage: Linkage, because: str) -> None:
    found = bends_at_most(data_of(linkage), rational(1e4))
    assert not found.holds
    assert any(part in found.argument for part in because.split("|"))


def test_what_is_not_decided_is_not_proved() -> None:
    found = bends_at_most(data_of(FIVE_BAR), rational(1.05 * greatest_bending(FIVE_BAR)), most_parts=10)
    assert (found.holds, found.argument) == (False, "not decided with 10 parts of the box of poses")


@pytest.mark.parametrize("m", [2, 3])
def test_no_direction_is_further_than_stated_from_all_of_those_that_are_looked_at(m: int) -> None:
    directions = _directions(m)
    rows = np.array([[float(entry.mid()) for entry in row] for row in directions.table.tolist()])
    random = np.random.default_rng(5).normal(size=(5000, m))
    random /= np.linalg.norm(random, axis=1)[:, None]
    pairs = [(j, k) for j in range(m) for k in range(j + 1)]
    # (v^T w)^2 = sum of v_j v_k w_j w_k over all j and k, of which the table has both of a pair in one
    cosines = rows @ np.array([random[:, j] * random[:, k] for j, k in pairs])
    assert np.arccos(np.sqrt(np.min(np.max(cosines, axis=0)))) <= float(directions.nearest.upper())
    assert float(directions.nearest.upper()) <= 0.11


def changed(linkage: Linkage, **changes: Any) -> dict[str, Any]:
    return {**linkage.describe(), **changes}


@pytest.mark.parametrize(
    ("data", "found"),
    [
        ({}, "device.linkage: the key kind is missing"),
        ([], "device.linkage: found a list of 0 entries; expected an object"),
        (changed(ARM, kind="cart"), "device.linkage.kind: found 'cart'"),
        (changed(ARM, rod=0.1), "device.linkage: missing keys .*, unknown keys"),
        (changed(ARM, turns=["z", "w"]), r"device.linkage.turns\[1\]: found 'w'"),
        (changed(ARM, turns=["z"] * 4), "device.linkage.turns: found 4 entries"),
        (changed(ARM, turns=["z", "x"]), "device.linkage.turns: found .*; expected three axes, or z twice"),
        (
            changed(ARM, links=[[0.1, 0.0, 0.0], [0.1, 0.0, 0.01]]),
            "device.linkage.turns: found .*; expected three axes",
        ),
        (changed(ARM, links=[[0.1, 0.0, 0.0]]), "device.linkage.links: found 1 entries; expected 2"),
        (changed(ARM, links=[[0.1, 0.0], [0.1, 0.0, 0.0]]), r"device.linkage.links\[0\]: found 2 entries"),
        (changed(STYLUS, low=[0.0, math.nan, 0.0]), r"device.linkage.low\[1\]: found nan; expected a finite number"),
        (changed(STYLUS, low=[0.0, 0.0]), "device.linkage.low: found 2 entries; expected 3"),
        (changed(STYLUS, low=STYLUS.describe()["high"]), "device.linkage.high: found .*; expected numbers greater"),
        (changed(FIVE_BAR, apart=-0.1), "device.linkage.apart: found -0.1; expected a length of 0 or more"),
        (changed(FIVE_BAR, rod=0), "device.linkage.rod: found 0; expected a length greater than 0"),
        (changed(DELTA, upper="long"), "device.linkage.upper: found 'long'; expected a finite number"),
        (changed(DELTA, platform=True), "device.linkage.platform: found True; expected a finite number"),
    ],
)
def test_data_that_state_no_linkage_are_refused_with_their_place(data: object, found: str) -> None:
    with pytest.raises(ProofInputError, match=found):
        read_linkage(Item(data, "device.linkage"))


@settings(max_examples=50)
@given(
    st.sampled_from(["apart", "upper", "rod"]),
    st.one_of(st.sampled_from([5e-324, 1e-300, 1e300, 1.7e308, 2**1000]), st.floats(1e-12, 1e12)),
    st.one_of(st.sampled_from([1e308, 1e-300]), st.floats(0.0, 1e9)),
)
def test_no_size_of_numbers_breaks_the_proof(key: str, value: float, kappa: float) -> None:
    data = read_linkage(Item(changed(FIVE_BAR, **{key: value}), "linkage"))
    found = bends_at_most(data, rational(kappa), most_parts=30)
    assert found.argument


@settings(max_examples=50)
@given(
    st.lists(st.floats(-1e300, 1e300), min_size=9, max_size=9),
    st.lists(st.floats(-1e300, 1e300), min_size=3, max_size=3),
    st.floats(1e-9, 1e300),
)
def test_no_chain_breaks_the_proof(links: list[float], low: list[float], width: float) -> None:
    high = [max(at + width, math.nextafter(at, math.inf)) for at in low]
    data = changed(STYLUS, links=[links[:3], links[3:6], links[6:]], low=low, high=high)
    assert bends_at_most(read_linkage(Item(data, "linkage")), rational(1e9), most_parts=30).argument
