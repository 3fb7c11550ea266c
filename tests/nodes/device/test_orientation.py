"""A device's orientation: whatever comes, or does not, its hand has put in what its account and its lateness leave."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.design.levels.contract import DeviceShare
from manyhands.nodes.device.orientation import NO_TORQUE, DeviceOrientation, TurnedBody, follow
from manyhands.nodes.kernel.allowance import LatenessAllowance
from manyhands.nodes.kernel.bundle import DeviceRung, OrientationPart, TurnedHand
from manyhands.nodes.kernel.orientation import (
    FIRST_LIFE,
    NO_RIDER,
    UPRIGHT,
    OrientationSpring,
    Quaternion,
    Vector3,
    angle,
    turned_by,
)
from manyhands.protocol.clock import Duration, Instant, from_seconds

T, RHO, TAU = 1e-3, 0.2, 1e-3
B = 2e-3
K = 2.0 * B / (T * (1.0 + RHO) + 3.0 * TAU)
"""The greatest stiffness that (*) of the law allows."""

SPEED, ROUNDING = 1000.0, 1e-12
RUNG = DeviceRung(TAU, RHO, DeviceShare())


class Measured(TurnedBody):
    """A body that knows what was burnt and what the motors did, J; in closed form over each piece."""

    def __init__(self, of: TurnedHand) -> None:
        super().__init__(of, T)
        self.inertia = of.inertia
        self.burnt = self.work = self.fastest = 0.0

    def _move(self, dt: float) -> None:
        a, b = self._rate, self._damping
        for own, held, before in zip(self._hand, self._u, self._omega, strict=True):
            end, d = (own + held) / b, before - (own + held) / b
            self.work += held * (end * dt + d * -math.expm1(-a * dt) / a)
            self.burnt += b * (
                end * end * dt - 2.0 * end * d * math.expm1(-a * dt) / a - d * d * math.expm1(-2.0 * a * dt) / (2.0 * a)
            )
        super()._move(dt)
        self.fastest = max(self.fastest, math.hypot(*self._omega))

    @property
    def put_in(self) -> float:
        """What the hand has put in beyond the body's kinetic energy, J."""
        return self.burnt - self.work


def oriented(
    rng: np.random.Generator, allowance: LatenessAllowance | None = None, inertia: float = 1e-6, force: float = 0.4
) -> tuple[DeviceOrientation, Measured]:
    times = (np.arange(120) * T).tolist()
    intents = tuple({"times": times, "values": (force * rng.standard_normal(120)).tolist()} for _ in range(3))
    hand = TurnedHand(inertia, B, intents)
    found = DeviceOrientation(
        OrientationPart(B, K, 0.8 * K, SPEED, hand), T, RUNG, allowance, Duration(6 * from_seconds(T))
    )
    body = Measured(hand)
    found._body = body
    return found, body


def whatever(rng: np.random.Generator, of: DeviceOrientation) -> list[float]:
    """What comes: proxies that would be paid for by the hand, and what is no proxy at all."""
    bad: list[Any] = [[math.nan] * 6, [*NO_RIDER], [1e200] * 6, [1.0, 0.0, 0.0, 0.0, math.inf, of.life], [-1.0] * 6]
    kind = rng.integers(0, 6)
    if kind == 0:
        return list(bad[rng.integers(len(bad))])
    if kind == 1:
        return [1.0, 0.0, 0.0, 0.0, 1e9, of.life + 1.0]
    proxy = turned_by(of.R, rng.standard_normal(3) * (0.5 if kind < 4 else 2.0))
    return [*proxy, of.spring.deposited, of.life]  # a hand alone is granted what it has deposited


@pytest.mark.parametrize("seed", range(12))
def test_a_hand_in_time_puts_in_its_account_at_least(seed: int) -> None:
    rng = np.random.default_rng(seed)
    of, body = oriented(rng)
    s = 0
    for k in range(110):
        of.sample(k, Instant(s))
        d, h = from_seconds(rng.uniform(0, TAU)), from_seconds(T * rng.uniform(1.0, 1.0 + RHO))
        a = s + min(d, h)
        if rng.random() < 0.1:
            of.release(Instant(a))
        else:
            of.exert(whatever(rng, of), Instant(a), rng.choice([1.0, 1.0, 0.3, 0.0]))
        assert math.hypot(*of.torque) <= of.most * (1.0 + 1e-9)
        assert body.put_in >= of.least - ROUNDING
        assert of.spring.account >= of.spring.deposited - of.spring.granted - ROUNDING
        s += h
    assert of.spring.late == 0.0
    assert of.least >= -ROUNDING  # for it was granted no more than it had deposited
    assert body.fastest < SPEED
    assert of.spring.held > 0


STIFF, SOFT = DeviceRung(0.0, RHO, DeviceShare(), 2.0 * B / (T * (1.0 + RHO))), DeviceRung(TAU, RHO, DeviceShare(), K)
"""Rungs for no delay and for the longest, each with the stiffest spring that is proved there."""


@pytest.mark.parametrize("seed", range(6))
def test_a_change_of_rung_changes_the_stiffness_where_no_torque_acts(seed: int) -> None:
    rng = np.random.default_rng(200 + seed)
    of, body = oriented(rng)
    s, k_before, changes = 0, K, 0
    for k in range(1000):
        if k % 250 == 10:
            of.change(STIFF if k % 500 == 10 else SOFT)
        of.sample(k, Instant(s))
        late = of._k == K and of._next is None
        d, h = from_seconds(rng.uniform(0, TAU) if late else 0.0), from_seconds(T * rng.uniform(1.0, 1.0 + RHO))
        before = of.torque
        of.exert(whatever(rng, of), Instant(s + min(d, h)))
        if of._k != k_before:
            k_before, changes = of._k, changes + 1
            assert before == of.torque == NO_TORQUE
            assert of.spring.proxy == of.R
        elif of.most < of._limit:  # the ramp is a hundredth of the limit in each tick
            assert math.hypot(*of.torque) <= of.most * (1.0 + 1e-9)
        assert body.put_in >= of.least - ROUNDING
        assert of.spring.account >= of.spring.deposited - of.spring.granted - ROUNDING
        s += h
    assert of.spring.late == 0.0
    assert changes == 4


@pytest.mark.parametrize("seed", range(12))
def test_late_ticks_give_no_more_than_is_counted(seed: int) -> None:
    """Whatever the rung is, and whenever that changes."""
    rng = np.random.default_rng(100 + seed)
    of, body = oriented(rng)
    s = 0
    for k in range(60 if seed % 2 else 450):
        if k % 150 == 20:
            of.change(STIFF if k % 300 == 20 else SOFT)
        of.sample(k, Instant(s))
        h, d = from_seconds(T), from_seconds(TAU * rng.uniform(0, 1))
        if rng.random() < 0.3:
            h = from_seconds(T * rng.uniform(1, 8))
            d = from_seconds(rng.uniform(0, 1) * h * 1e-9)
        of.exert(whatever(rng, of), Instant(s + d))
        assert body.put_in >= of.least - of.spring.late - ROUNDING
        s += h
    assert of.spring.late > 0.0


class Led(TurnedBody):
    """A body about the x axis that a hand leads along a path of instants, ns, and angles, rad."""

    def __init__(self, instants: list[int], angles: list[float]) -> None:
        super().__init__(TurnedHand(1.0, B, (0.0, 0.0, 0.0)), T)
        self.instants, self.angles, self.put_in, self.until = instants, angles, 0.0, 0

    def to(self, at: Instant) -> Quaternion:
        theta = np.interp([self.until, at], self.instants, self.angles)
        ends = [self.until, *(t for t in self.instants if self.until < t < at), at]
        for begin, end in itertools.pairwise(ends):
            moved = float(np.diff(np.interp([begin, end], self.instants, self.angles))[0])
            self.put_in += B * moved**2 / max((end - begin) * 1e-9, 1e-12) - self._u[0] * moved
        self.until = at
        return turned_by(UPRIGHT, (float(theta[1]), 0.0, 0.0))


@pytest.mark.parametrize("back", [4.0, 6.0, 8.0])
def test_a_hand_that_comes_back_within_a_late_tick_gets_what_is_counted_and_much_of_it(back: float) -> None:
    far, period = 0.4, from_seconds(T)
    at = [0, 100 * period, 100 * period + from_seconds(back * T)]
    speed = far / (back * T)
    of = DeviceOrientation(
        OrientationPart(B, K, K, speed, TurnedHand(1.0, B, (0.0, 0.0, 0.0))), T, RUNG, None, Duration(20 * period)
    )
    of._body = body = Led(at, [0.0, far, 0.0])
    for k in range(101):
        of.sample(k, Instant(k * period))
        of.exert(NO_RIDER, Instant(k * period))
    before = body.put_in
    of.sample(101, Instant(at[-1]))
    given_out = before - body.put_in
    assert body.put_in >= -of.spring.late
    counted = 1.0 + math.hypot(*of.torque) / (B * speed)  # the torque could have turned it faster by so much
    assert of.spring.late <= 20.0 * given_out * counted**2  # no more than a bound that is good for something


def test_a_torque_that_alone_turns_the_device_beyond_its_greatest_speed_is_counted_as_such() -> None:
    """No hand is at the device: all that it has after 50 ms came from its account, for which others pay, or is owed."""
    held = from_seconds(0.05)
    hand = TurnedHand(0.8 * B * 0.05, B, (0.0, 0.0, 0.0))
    of = DeviceOrientation(OrientationPart(B, K, K, 5.0, hand), T, RUNG, None, held)
    of._body = body = Measured(hand)
    of.sample(0, Instant(0))
    u = of.exert([*turned_by(UPRIGHT, (0.5, 0.0, 0.0)), 1.0, of.life], Instant(0))
    of.sample(1, Instant(held))
    kinetic = -body.put_in  # what the motors did beyond what was burnt
    assert math.hypot(*body._omega) > 10.0 * 5.0
    assert math.hypot(*u) > 10.0 * B * 5.0
    assert 3.0 * -of.least < kinetic <= of.spring.late - of.least


def test_beyond_what_lateness_may_put_in_it_lets_go_until_that_is_paid() -> None:
    rng = np.random.default_rng(1)
    of, _ = oriented(rng, LatenessAllowance(1e-6, 0.0))
    late = from_seconds(3 * T)
    proxy = [*turned_by(UPRIGHT, (0.3, 0.0, 0.0)), 1.0, of.life]
    of.sample(0, Instant(0))
    assert math.hypot(*of.exert(proxy, Instant(late))) > 0.0
    of.sample(1, Instant(late))
    assert of.spring.owed > 1e-6
    assert of.exert(proxy, Instant(late)) == NO_TORQUE
    owed, k, now = of.spring.owed, 2, late
    while of.spring.owed > 1e-6 and k < 100_000:
        now += from_seconds(T)
        of.sample(k, Instant(now))
        of.release(Instant(now))
        k += 1
    assert of.spring.owed < owed
    assert k < 100_000


def test_motors_that_have_let_go_by_themselves_leave_nothing_stored() -> None:
    rng = np.random.default_rng(2)
    of, _ = oriented(rng, force=0.0)
    of.sample(0, Instant(0))
    of.exert([*turned_by(UPRIGHT, (0.3, 0.0, 0.0)), 1.0, of.life], Instant(0))
    account = of.spring.account
    of.sample(1, Instant(from_seconds(1.0)))
    assert of.spring.proxy == of.R
    assert of.spring.account == account


@pytest.mark.parametrize("late", [4.0, 20.0, 50.0])
def test_a_late_tick_without_a_torque_adds_no_more_to_the_account_than_the_hand_has_put_in(late: float) -> None:
    """The proxy rests meanwhile, and the spring to it would seem to have stored what nobody has paid for."""
    times = [0.0, late * T, late * T + 1e-9, 1.0]
    torque = {"times": times, "values": [B / (late * T)] * 2 + [0.0] * 2}  # one radian
    hand = TurnedHand(1e-7, B, (torque, 0.0, 0.0))
    of = DeviceOrientation(OrientationPart(B, K, K, SPEED, hand), T, RUNG, None, Duration(6 * from_seconds(T)))
    of._body = body = Measured(hand)
    of.sample(0, Instant(0))
    of.exert(NO_RIDER, Instant(0))
    now = Instant(from_seconds(late * T))
    of.sample(1, now)
    assert angle(of.R, UPRIGHT) == pytest.approx(1.0, rel=0.05)
    of.release(now)
    assert of.spring.account - of.spring.owed <= body.put_in
    assert of.spring.account > 0.0


def test_what_is_burnt_without_a_torque_pays_once() -> None:
    """For what is owed, or for what the spring may have stored: the account and the debt have less than was put in."""
    hand = TurnedHand(1e-10, B, (0.4, 0.0, 0.0))  # 0.2 rad a tick
    of = DeviceOrientation(OrientationPart(B, K, K, SPEED, hand), T, RUNG, None, Duration(6 * from_seconds(T)))
    of._body = body = Measured(hand)
    of.spring.charge(100.0)
    for k in range(100):
        of.sample(k, Instant(k * from_seconds(T)))
        of.exert(NO_RIDER, Instant(k * from_seconds(T)))
        of.release(Instant(k * from_seconds(T)))
        assert of.spring.account + 100.0 - of.spring.owed <= body.put_in + ROUNDING
    assert of.spring.account > 1e-6
    assert of.spring.owed < 99.99


def test_a_torque_that_its_motors_have_let_go_of_turns_it_no_more() -> None:
    """What a stopped process left behind would else act for as long as that stands still, and nothing counts it."""
    rng = np.random.default_rng(2)
    of, body = oriented(rng, force=0.0)
    of.sample(0, Instant(0))
    torque = of.exert([*turned_by(UPRIGHT, (0.3, 0.0, 0.0)), 1.0, of.life], Instant(0))
    of.sample(1, Instant(from_seconds(0.02)))
    assert angle(of.R, UPRIGHT) == pytest.approx(6 * T * math.hypot(*torque) / B, rel=1e-6)
    assert body.put_in >= of.least - of.spring.late


def test_a_hand_that_turns_faster_than_its_limit_is_let_go() -> None:
    part = OrientationPart(B, K, 1.0, 1.0, TurnedHand(1e-5, B, (0.5, 0.0, 0.0)))
    of = DeviceOrientation(part, T, RUNG)
    for k in range(100):
        of.sample(k, Instant(0))
        of.exert([*UPRIGHT, 1.0, of.life], Instant(0))
    assert of.let_go > 50
    assert of.torque == NO_TORQUE


def test_the_body_comes_to_the_speed_at_which_its_damping_takes_the_torque() -> None:
    body = TurnedBody(TurnedHand(1e-4, 1e-3, (0.0, 2e-3, 0.0)), T)
    there = body.to(Instant(from_seconds(1.0)))
    # omega = 2 rad/s but for the start, which costs 2 rad/s * J/b = 0.2 rad
    assert angle(there, UPRIGHT) == pytest.approx(1.8, abs=1e-4)
    assert there.y == pytest.approx(math.sin(0.9), abs=1e-4)
    assert body.to(Instant(0)) == there


def test_parts_of_a_period_lead_where_the_whole_does() -> None:
    hand = TurnedHand(1e-5, 1e-3, (0.01, 0.0, 0.0))
    whole, parts = TurnedBody(hand, T), TurnedBody(hand, T)
    for k in range(1, 40):
        parts.to(Instant(k * 250_000 + k % 3))
    end = Instant(from_seconds(11 * T))
    assert angle(whole.to(end), parts.to(end)) < 1e-9


def test_what_is_for_another_life_is_neither_proxy_nor_grant() -> None:
    of, _ = oriented(np.random.default_rng(0))
    there = turned_by(UPRIGHT, (0.1, 0.0, 0.0))
    of.sample(0, Instant(0))
    of.exert([*there, 5.0, FIRST_LIFE + 1.0], Instant(0))
    assert (of.spring.proxy, of.spring.granted, any(of.came)) == (UPRIGHT, 0.0, False)
    of.exert([*there, 5.0, FIRST_LIFE], Instant(0))
    assert of.spring.proxy == pytest.approx(there)
    assert of.spring.granted == 5.0


def test_a_torque_follows_again_from_what_was_kept_of_the_tick_before() -> None:
    rng = np.random.default_rng(9)
    of, _ = oriented(rng)
    kept = of.row()
    for k in range(60):
        of.sample(k, Instant(k * from_seconds(T)))
        of.exert(whatever(rng, of), Instant(k * from_seconds(T)))
        _, proxy, _, _, (account, deposited, granted, *_) = kept
        spring = OrientationSpring(K, at=Quaternion(*proxy))
        spring.account, spring.deposited, spring.granted = account, deposited, granted
        kept = of.row()
        assert follow(spring, Quaternion(*kept[0]), kept[3], kept[4][5]) == tuple(kept[2])
        assert (spring.proxy, spring.account, spring.deposited, spring.granted) == (kept[1], *kept[4][:3])


@given(st.lists(st.floats(), min_size=6, max_size=6), st.floats(0.0, 1.0))
def test_whatever_comes_the_torque_is_finite_and_limited(came: list[float], ratio: float) -> None:
    of = DeviceOrientation(OrientationPart(B, K, 0.1, SPEED, TurnedHand(1e-5, B, (0.1, 0.0, 0.0))), T, RUNG)
    for k in range(3):
        of.sample(k, Instant(0))
        torque: Vector3 = of.exert(came, Instant(0), ratio)
        assert math.hypot(*torque) <= 0.1 * ratio * (1.0 + 1e-9)
        assert all(map(math.isfinite, of.rides))
        assert isinstance(of.R, Quaternion)


@pytest.mark.parametrize("wrong", [0.0, -1.0, math.inf, math.nan])
def test_numbers_of_an_orientation_that_are_not_positive_are_refused(wrong: float) -> None:
    hand = TurnedHand(1e-5, 1e-3, (0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="expected finite positive"):
        OrientationPart(1e-3, wrong, 1.0, 1.0, hand)
    with pytest.raises(ValueError, match="expected positive ones"):
        TurnedHand(wrong, 1e-3, (0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="three"):
        TurnedHand(1e-5, 1e-3, (0.0, 0.0))
