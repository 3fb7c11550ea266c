"""The spring between orientations and the bank: what the law of decision 54 says, at its limit and beyond it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.nodes.kernel.orientation import (
    UPRIGHT,
    OrientationBank,
    OrientationSpring,
    Quaternion,
    angle,
    between,
    energy,
    torque,
    total,
    unit,
    yielded,
)

from ...support.turning import (
    SUBSTEPS,
    Array,
    Motions,
    bound,
    hostile,
    least_energy,
    product,
    resonant,
    torques,
    turned,
    violent,
)

ROUNDING = 1e-12
"""Of sums of a few hundred terms of the size of 1, in doubles."""

vectors = st.tuples(*[st.floats(-3.2, 3.2)] * 3)
"""Rotation vectors, rad; some turn by more than half a turn."""


def of(vector: tuple[float, float, float]) -> Quaternion:
    return Quaternion(*turned(np.array(vector)).tolist())


@given(vectors, vectors)
def test_the_torque_is_minus_the_slope_of_the_energy(at: tuple[float, float, float], proxy: tuple[float, ...]) -> None:
    R, Q, h = of(at), of(proxy), 1e-6  # type: ignore[arg-type]
    for axis in np.eye(3):
        ahead, behind = (_turn(R, sign * h * axis) for sign in (1.0, -1.0))
        slope = (energy(2.0, ahead, Q) - energy(2.0, behind, Q)) / (2 * h)
        assert -slope == pytest.approx(float(np.dot(torque(2.0, R, Q), axis)), abs=1e-9)  # h^2 and rounding over h


@given(vectors, vectors, vectors)
def test_the_torque_changes_by_k_times_the_turn_at_most(
    at: tuple[float, float, float], proxy: tuple[float, float, float], turn: tuple[float, float, float]
) -> None:
    R, Q, h = of(at), of(proxy), 1e-4
    step = h * np.array(turn)
    change = np.subtract(torque(1.0, _turn(R, step), Q), torque(1.0, R, Q))
    assert np.linalg.norm(change) <= np.linalg.norm(step) + ROUNDING


@given(vectors, vectors, st.floats(0.0, 1.0))
def test_a_proxy_that_comes_to_the_device_yields_nothing_less_than_0(
    at: tuple[float, float, float], proxy: tuple[float, float, float], part: float
) -> None:
    R, Q = of(at), of(proxy)
    assert yielded(1.0, R, Q, R) >= -ROUNDING
    assert yielded(1.0, R, Q, between(Q, R, part)) >= -ROUNDING
    assert angle(R, between(Q, R, part)) == pytest.approx((1.0 - part) * angle(R, Q), abs=1e-7)  # of the arc cosine


@pytest.mark.parametrize("delay", [0, 1, SUBSTEPS // 2, SUBSTEPS])
def test_no_motion_and_no_proxy_gives_energy_at_the_limit(delay: int) -> None:
    rng = np.random.default_rng(54 + delay)
    motions = violent(rng, 300, 12, delay, wobble=0.3)
    exerted, held = torques(motions, hostile(rng, 300, 12))
    assert held > 0
    longest = float(motions.lasts.sum(axis=2).max())
    assert least_energy(motions, exerted, bound(motions.latest, longest)).min() >= -ROUNDING


@pytest.mark.parametrize("delay", [0, 1, SUBSTEPS // 2, SUBSTEPS])
def test_the_limit_is_near(delay: int) -> None:
    motions, proposed = resonant(0.02, 0.3, delay, 800)
    exerted, _ = torques(motions, proposed, tank=4e-4)
    whole, less = (least_energy(motions, exerted, bound(motions.latest) / part)[0] for part in (1.0, 1.3))
    assert whole >= -4e-4 - ROUNDING
    assert less < -4e-4


@pytest.mark.parametrize("part", [-0.2, -0.05])
def test_what_a_step_changes_of_a_torque_that_is_late_is_paid_for(part: float) -> None:
    """A proxy whose steps cost nothing at the samples, and much by the time at which their torques act."""
    omega = 0.3
    motions, proposed = resonant(0.01, omega, SUBSTEPS // 2, 800, ratio=complex(np.exp(0.5j * omega)) / part)
    exerted, held = torques(motions, proposed, tank=1e-2)
    assert held > 100
    assert least_energy(motions, exerted, bound(motions.latest))[0] >= -1e-2 - ROUNDING


def test_without_the_test_a_proxy_gives_energy() -> None:
    ticks = 6
    turns = np.zeros((1, ticks, SUBSTEPS, 3))
    turns[0, :, :, 0] = 0.01
    motions = Motions(turns, np.full((1, ticks, SUBSTEPS), 1 / SUBSTEPS), np.zeros((1, ticks), dtype=np.intp))

    def ahead(i: int, k: int, R: Quaternion, Q: Quaternion) -> Quaternion:
        return _turn(R, np.array([0.4, 0.0, 0.0]))

    believed = np.array([[torque(1.0, R, ahead(0, k, R, R)) for k, R in enumerate(map(_q, motions.samples[0]))]])
    kept, held = torques(motions, ahead)
    assert least_energy(motions, believed, bound(0.0))[0] < -0.05
    assert least_energy(motions, kept, bound(0.0))[0] >= -ROUNDING
    assert held == ticks


def test_the_torque_is_limited_by_letting_the_proxy_follow() -> None:
    rng = np.random.default_rng(3)
    motions = violent(rng, 200, 12, SUBSTEPS)
    exerted, _ = torques(motions, hostile(rng, 200, 12), most=0.1)
    assert np.linalg.norm(exerted, axis=-1).max() <= 0.1
    assert least_energy(motions, exerted, bound(motions.latest)).min() >= -ROUNDING


def test_beyond_a_quarter_turn_the_proxy_follows() -> None:
    spring = OrientationSpring(1.0)
    for k in range(40):
        R = of((0.1 * k, 0.0, 0.0))
        assert np.linalg.norm(spring.turn(R, None)) == pytest.approx(math.sin(min(0.1 * k, math.pi / 2)), abs=1e-9)
    assert spring.account >= 0.0


def test_what_one_hand_gives_the_other_may_have_whatever_is_lost() -> None:
    """Two hands whose proxies are each other's device, with messages that are lost: together they never gain."""
    rng = np.random.default_rng(7)
    given_away = 0.0
    for _ in range(60):
        motions = violent(rng, 2, 40, 0)
        springs, bank = [OrientationSpring(1.0) for _ in range(2)], OrientationBank(("a", "b"))
        exerted, samples = np.empty((2, 40, 3)), motions.samples
        grants, seen = [0.0, 0.0], [UPRIGHT, UPRIGHT]
        for k in range(40):
            here = [_q(samples[i, k]) for i in range(2)]
            for i, name in enumerate(("a", "b")):
                if rng.random() < 0.8:
                    seen[i] = here[i]
                    bank.deposit(name, springs[i].deposited)
            for i, name in enumerate(("a", "b")):
                need = -yielded(1.0, here[i], springs[i].proxy, seen[1 - i])
                total = bank.grant(name, need)
                came = rng.random() < 0.8
                grants[i] = total if came else grants[i]
                exerted[i, k] = springs[i].turn(here[i], seen[1 - i] if came else None, grants[i])
            assert bank.balance >= 0.0
            assert sum(spring.account for spring in springs) >= -ROUNDING
        put_in = least_energy(motions, exerted, bound(0.0))
        given_away = min(given_away, *put_in)
        turns = motions.turns.reshape(2, -1, 3)
        burnt = bound(0.0) * (turns**2).sum(-1) / motions.lasts.reshape(2, -1)
        work = (np.repeat(exerted, SUBSTEPS, axis=1) * turns).sum(-1)
        assert np.cumsum((burnt - work).sum(axis=0)).min() >= -ROUNDING
    assert given_away < -0.01  # one hand was moved by the other, or the bank was never asked


def test_a_deposit_or_a_grant_that_comes_late_changes_nothing() -> None:
    bank = OrientationBank(("a", "b"), tank=1.0)
    bank.deposit("a", 0.0)
    bank.deposit("a", 2.0)
    bank.deposit("a", 1.5)
    assert bank.balance == 3.0
    assert bank.grant("b", 2.5) == 2.5
    assert bank.grant("b", 2.5) == 3.0
    assert bank.grant("a", -1.0) == 0.0
    assert bank.balance == 0.0
    spring = OrientationSpring(1.0)
    spring.turn(UPRIGHT, None, 2.0)
    spring.turn(UPRIGHT, None, 1.0)
    assert (spring.granted, spring.deposited) == (2.0, 2.0)


def test_letting_go_costs_nothing() -> None:
    spring = OrientationSpring(1.0)
    R = of((0.3, 0.2, -0.1))
    assert np.linalg.norm(spring.turn(R, None)) > 0.1
    spring.release(R)
    assert spring.turn(R, None) == (0.0, 0.0, 0.0)
    assert spring.account >= 0.0


def test_a_process_that_starts_anew_neither_brings_nor_takes_what_was_spent() -> None:
    bank = OrientationBank(("a", "b"), tank=1.0)
    bank.deposit("a", 3.0, life=7.0)  # the bank itself may be the new one
    assert bank.balance == 1.0
    bank.deposit("a", 3.5, life=7.0)
    assert bank.grant("a", 1.5) == 1.5
    bank.deposit("a", 0.2, life=8.0)
    assert (bank.balance, bank.granted["a"], bank.lives["a"]) == (0.0, 0.0, 8.0)
    bank.deposit("a", 0.5, life=8.0)
    assert bank.balance == pytest.approx(0.3)
    for no_life in (0.0, 0.5, -1.0, 2.0**60, math.inf, math.nan):
        bank.deposit("a", 9.0, life=no_life)
    assert bank.balance == pytest.approx(0.3)


def test_no_hand_deposits_more_than_it_can_have_put_in() -> None:
    bank = OrientationBank(("a",), power={"a": 0.25})
    bank.deposit("a", 0.0, tick=10)
    bank.deposit("a", 1e300, tick=12)
    assert bank.balance == 0.5
    bank.grant("a", 0.5)
    bank.deposit("a", 1e300, tick=12)
    assert bank.balance == 0.5  # what it was granted it may have given back
    bank.deposit("a", 1e300, tick=13)
    assert bank.balance == 0.75


def test_what_is_owed_is_paid_or_forgiven() -> None:
    spring = OrientationSpring(1.0)
    spring.charge(0.3)
    spring.pay(0.1)
    assert spring.owed == pytest.approx(0.2)
    spring.pay(1.0)
    assert (spring.owed, spring.late, spring.account) == (0.0, 0.3, 0.0)


@pytest.mark.parametrize(
    "numbers",
    [
        (0.0, 0.0, 0.0, 0.0),
        (1.0 + 1e-5, 0.0, 0.0, 0.0),
        (math.nan, 0.0, 0.0, 1.0),
        (math.inf, 0.0, 0.0, 0.0),
        (1e200, 1e200, -1e200, 0.0),
    ],
)
def test_numbers_that_are_no_orientation_are_none(numbers: tuple[float, ...]) -> None:
    assert unit(numbers) is None


@given(st.lists(st.floats(), min_size=4, max_size=4), st.floats())
def test_whatever_comes_is_an_orientation_of_length_1_or_none_and_a_sum_is_one(
    numbers: list[float], number: float
) -> None:
    found = unit(numbers)
    assert found is None or math.isclose(math.hypot(*found), 1.0, rel_tol=1e-15)
    assert 0.0 <= total(number) < math.inf


def test_an_orientation_that_was_rounded_is_normalised() -> None:
    found = unit((1.0 + 1e-7, 0.0, 0.0, 0.0))
    assert found == UPRIGHT


@pytest.mark.parametrize(
    ("stiffness", "most"), [(0.0, 1.0), (math.inf, 1.0), (math.nan, 1.0), (1.0, 0.0), (1.0, math.nan)]
)
def test_a_spring_without_a_stiffness_or_a_limit_is_refused(stiffness: float, most: float) -> None:
    with pytest.raises(ValueError, match="expected a"):
        OrientationSpring(stiffness, most)


def _q(numbers: Array) -> Quaternion:
    return Quaternion(*numbers.tolist())


def _turn(R: Quaternion, vector: Array) -> Quaternion:
    return Quaternion(*product(turned(vector), np.array(R)).tolist())
