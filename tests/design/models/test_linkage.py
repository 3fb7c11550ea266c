"""Linkages: J and the bending of the tip against differences, kappa against a dense search, poses, and plain data."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.design.models.linkage import (
    FiveBar,
    Linkage,
    LinkageError,
    Poses,
    SerialChain,
    greatest_bending,
    linkage_of,
)
from manyhands.design.models.statespace import Matrix, matrix
from tests.support.linkages import ARM, DELTA, FIVE_BAR, LINKAGES, STYLUS

STEP = 1e-6  # rad or m: differences over it have errors of about 1e-9 of the value, by rounding
TOLERANCE = 1e-6
OVER = Poses((-0.9, -0.5, -2.36), (0.9, 1.0, -0.79))


def pose_of(linkage: Linkage, shares: list[float]) -> Matrix:
    low, high = np.array(linkage.poses.low), np.array(linkage.poses.high)
    return np.asarray(low + np.array(shares[: linkage.axes]) * (high - low))


shares = st.lists(st.floats(0.02, 0.98), min_size=3, max_size=3)
units = st.tuples(st.floats(0.0, np.pi), st.floats(-1.5, 1.5)).map(
    lambda at: np.array([np.cos(at[0]) * np.cos(at[1]), np.sin(at[0]) * np.cos(at[1]), np.sin(at[1])])
)


@pytest.mark.parametrize("linkage", LINKAGES.values(), ids=LINKAGES)
@given(shares=shares)
def test_the_jacobian_is_the_tip_s_change_by_the_joints(linkage: Linkage, shares: list[float]) -> None:
    pose, steps = pose_of(linkage, shares), STEP * np.eye(linkage.axes)
    tips = np.stack([linkage.tip(pose + step) - linkage.tip(pose - step) for step in steps], axis=1)
    joints = np.stack([linkage.joints(pose + step) - linkage.joints(pose - step) for step in steps], axis=1)
    jacobian = linkage.jacobian(pose)
    assert np.abs(jacobian @ joints - tips).max() <= TOLERANCE * STEP


@pytest.mark.parametrize("linkage", LINKAGES.values(), ids=LINKAGES)
@given(shares=shares, along=units)
def test_the_tip_s_bending_is_what_a_held_torque_leaves_of_a_force(
    linkage: Linkage, shares: list[float], along: Matrix
) -> None:
    """Of J(q_hat) J(q)^-1 - I, by which a held torque pushes otherwise than the force that it stands for."""
    v = along[: linkage.axes]
    pose = pose_of(linkage, shares)
    moved = pose + STEP * (np.linalg.inv(linkage.jacobian(pose)) @ v if isinstance(linkage, SerialChain) else v)
    left = (linkage.jacobian(pose) @ np.linalg.inv(linkage.jacobian(moved)) - np.eye(linkage.axes)) @ v / STEP
    bending = np.einsum("aij,i,j->a", linkage.bending(pose), v, v)
    assert np.abs(left + bending).max() <= 1e-3 * (1.0 + np.abs(bending).max())  # one-sided: of the order of the step


@pytest.mark.parametrize("linkage", LINKAGES.values(), ids=LINKAGES)
def test_kappa_is_that_of_a_dense_search(linkage: Linkage) -> None:
    random = np.random.default_rng(7)
    kappa, greatest = greatest_bending(linkage), 0.0
    for _ in range(3000):
        at = random.integers(0, 5, 3) / 4.0 if random.random() < 0.5 else random.random(3)  # corners and edges too
        tensor = linkage.bending(pose_of(linkage, list(at)))
        v = random.normal(size=(50, linkage.axes))
        v /= np.linalg.norm(v, axis=1)[:, None]
        greatest = max(greatest, float(np.linalg.norm(np.einsum("aij,ni,nj->na", tensor, v, v), axis=1).max()))
    assert 0.9 * kappa <= greatest <= kappa * (1.0 + 1e-9)


def test_a_chain_in_a_plane_bends_as_its_links_do() -> None:
    """At a right angle between two links of one length l, |s| is greatest along the diagonals, by hand: see below.

    With q = (0, 90 degrees) and l = 1: the tip is at (1, 1), J = [[-1, -1], [1, 0]], phi''[w, w] =
    -(1, 1) w_1^2 - 2 (0, 1) w_1 w_2 - (0, 1) w_2^2. For v = (1, 0) w = (0, -1): s = (0, -1).
    """
    chain = SerialChain(Poses((-1.0, 1.0), (1.0, 2.0)), (2, 2), matrix([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))
    tensor = chain.bending(np.array([0.0, np.pi / 2.0]))
    assert np.allclose(tensor[:, 0, 0], [0.0, -1.0], atol=1e-12)
    # v = (0, 1): w = (1, -1): -(1, 1) + 2 (0, 1) - (0, 1) = (-1, 0)
    assert np.allclose(tensor[:, 1, 1], [-1.0, 0.0], atol=1e-12)


def test_links_twice_as_long_bend_half_as_much() -> None:
    long = SerialChain(ARM.poses, ARM.turns, 2.0 * ARM.links)
    assert greatest_bending(long) == pytest.approx(greatest_bending(ARM) / 2.0, rel=1e-6)  # two searches


@pytest.mark.parametrize(
    ("make", "found"),
    [
        (lambda: Poses((0.0, 1.0), (1.0, 1.0)), "each range to rise"),
        (lambda: SerialChain(ARM.poses, (2, 0), ARM.links), "found z, x; expected three axes"),
        (lambda: SerialChain(ARM.poses, (2, 2, 2), ARM.links), "3 joints"),
        (lambda: FiveBar(FIVE_BAR.poses, apart=0.06, upper=0.0, rod=0.1), "lengths"),
        (lambda: greatest_bending(SerialChain(Poses((0.0, -1.0), (1.0, 1.0)), ARM.turns, ARM.links)), "singular"),
        # no pose of the grid has its tip on the axis of the first joint
        (lambda: greatest_bending(SerialChain(OVER, STYLUS.turns, STYLUS.links)), "singular"),
        (lambda: greatest_bending(FiveBar(Poses((-1.0, 0.1), (1.0, 0.2)), apart=0.06, upper=0.12, rod=0.16)), "reach"),
    ],
)
def test_what_is_no_linkage_is_refused(make: object, found: str) -> None:
    with pytest.raises(LinkageError, match=found):
        make()  # type: ignore[operator]


@pytest.mark.parametrize("linkage", LINKAGES.values(), ids=LINKAGES)
@given(shares=shares, off=st.lists(st.floats(-0.1, 0.1), min_size=3, max_size=3))
def test_a_pose_is_found_from_its_tip_and_a_pose_nearby(
    linkage: Linkage, shares: list[float], off: list[float]
) -> None:
    pose = pose_of(linkage, shares)
    found = linkage.pose_at(linkage.tip(pose), pose + np.array(off[: linkage.axes]))
    assert np.abs(found - pose).max() <= 1e-10


@pytest.mark.parametrize("linkage", LINKAGES.values(), ids=LINKAGES)
@given(shares=shares)
def test_the_first_pose_is_found_from_home(linkage: Linkage, shares: list[float]) -> None:
    pose = pose_of(linkage, shares)
    found = linkage.pose_at(linkage.tip(pose), linkage.home)
    assert np.abs(found - pose).max() <= 1e-10


@pytest.mark.parametrize(
    ("linkage", "tip", "found"),
    [
        (ARM, [0.5, 0.0], "found no pose with the tip at"),  # further than both links
        (ARM, [-0.15, 0.1], "expected one from"),  # turned out of the box
        (STYLUS, [0.0, 0.3, 0.0], "found no pose|expected one from"),
        (DELTA, [0.0, 0.0, 0.17], "expected one from"),
        (FiveBar(Poses((-1.0, 0.1), (1.0, 0.2)), apart=0.06, upper=0.12, rod=0.16), [0.9, 0.15], "every arm reaches"),
    ],
    ids=["too far", "out of the box", "a stylus", "a delta robot", "out of an arm's reach"],
)
def test_a_tip_that_no_pose_of_the_box_has_is_refused(linkage: Linkage, tip: list[float], found: str) -> None:
    with pytest.raises(LinkageError, match=found):
        linkage.pose_at(np.array(tip), linkage.home)


@pytest.mark.parametrize("linkage", LINKAGES.values(), ids=LINKAGES)
def test_plain_data_lead_back_to_the_linkage_to_the_last_bit(linkage: Linkage) -> None:
    data = linkage.describe()
    read = linkage_of(json.loads(json.dumps(data)))
    assert type(read) is type(linkage)
    assert read.describe() == data
    assert np.array_equal(read.jacobian(read.home), linkage.jacobian(linkage.home))


def changed(linkage: Linkage, **changes: Any) -> dict[str, Any]:
    return {**linkage.describe(), **changes}


@pytest.mark.parametrize(
    ("data", "found"),
    [
        ({}, "kind: found None; expected one of chain, five-bar, delta"),
        (changed(ARM, kind=["chain"]), r"kind: found \['chain'\]"),
        (changed(ARM, rod=0.1), r"found \['rod'\]; expected the keys kind, turns, links, low, high of a chain"),
        ({"kind": "delta"}, r"found \['kind'\]; expected the keys kind, base"),
        (changed(ARM, turns="zz"), "turns: found 'zz'; expected a list of two or three"),
        (changed(ARM, turns=["z", 2]), r"turns\[1\]: found 2; expected x, y or z"),
        (
            changed(ARM, turns=["z", "x"]),
            "turns: found z, [xz]; expected three axes, or z twice",
        ),
        (changed(ARM, links=[[0.1, 0.0, 0.0]] * 1000), "links: found .*; expected a list of 2 rows"),
        (changed(ARM, links=[[0.1, 0.0], [0.1, 0.0, 0.0]]), r"links\[0\]: found .*; expected a list of 3 numbers"),
        (
            changed(ARM, links=[[0.1, 0.0, 0.0], [0.1, 0.0, 0.01]]),
            "turns: found z, [xz]; expected three axes, or z twice",
        ),
        (changed(STYLUS, low=[0.0, math.nan, 0.0]), r"low\[1\]: found nan; expected a finite number"),
        (changed(STYLUS, low=[0.0, 10**400, 0.0]), r"low\[1\]: found a whole number of many digits"),
        (changed(STYLUS, low=STYLUS.describe()["high"]), "low, high: found poses from"),
        (changed(FIVE_BAR, apart=-0.1), "apart: found -0.1; expected a length of 0 or more, m"),
        (changed(FIVE_BAR, rod=0), "rod: found 0.0; expected a length of more than 0, m"),
        (changed(DELTA, upper="long"), "upper: found 'long'; expected a finite number"),
        (changed(DELTA, platform=True), "platform: found True; expected a finite number"),
    ],
)
def test_data_that_state_no_linkage_are_refused_by_their_key(data: dict[str, Any], found: str) -> None:
    with pytest.raises(LinkageError, match=found):
        linkage_of(data)
