"""A simulated device with dry friction: it burns c |dx| in each step and no less, stands where it must, in any time."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.design.levels.contract import DeviceShare
from manyhands.design.levels.dry_friction import DryFriction
from manyhands.design.models.device import HeldDevice, held_device
from manyhands.design.models.statespace import StateSpace
from manyhands.nodes.device.drivers import driver_of
from manyhands.nodes.device.friction import STEP, DryPlant
from manyhands.nodes.device.simulated import HeldDeviceDriver, IntentHand, Intention, OwnTimeDriver, Plant
from manyhands.nodes.device.tick import DeviceTick, OwnTimeTick, WallTimeTick
from manyhands.nodes.kernel.allowance import LatenessAllowance
from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.kernel.bundle import OWN, WALL, DeviceBundle, DeviceRung, Limits, PersonHand, SimulatedHand
from manyhands.nodes.kernel.friction_curve import FrictionCurve
from manyhands.nodes.kernel.intent import Intent
from manyhands.protocol.clock import Instant
from manyhands.protocol.plain import Unfit, read, written
from tests.support.mechanisms import mechanism_bundle

T = 1e-3
TICK = 1_000_000
forces = st.floats(-3.0, 3.0) | st.sampled_from([0.0, 0.3, -0.3, 0.2999, 0.3001])


def bare(m: int = 1, mass: float = 0.2, damping: float = 0.0) -> HeldDevice:
    """Masses that nobody holds."""
    return held_device([mass] * m, [damping] * m, StateSpace.static(np.zeros((m, m))), [0.0] * m, [0.0] * m)


def held(m: int) -> HeldDevice:
    """Masses in a hand that joins their axes."""
    D = 0.5 * np.eye(m) + 0.4 * np.ones((m, m))
    return held_device([0.2] * m, [0.1] * m, StateSpace(-20.0 * np.eye(m), D, D.T, D), [1.0] * m, [300.0] * m)


@st.composite
def frictions(draw: st.DrawFn, m: int) -> list[float] | FrictionCurve:
    """Constants by axis, or levels that rise up to tenfold at rest and in places, 10 um to 0.3 m apart."""
    least = draw(st.lists(st.floats(0.02, 0.5), min_size=m, max_size=m))
    if draw(st.booleans()):
        return least
    most, static = (tuple(c * draw(st.floats(1.0, 10.0)) for c in least) for _ in range(2))
    pitch, stribeck = (tuple(10.0 ** draw(st.floats(-5.0, -0.5)) for _ in least) for _ in range(2))
    return FrictionCurve(tuple(least), most, pitch, static, stribeck)


def least_of(friction: list[float] | FrictionCurve) -> Floats:
    return list(friction.least) if isinstance(friction, FrictionCurve) else friction


def levels(friction: list[float] | FrictionCurve, x: Floats, v: Floats) -> Floats:
    """The levels in this state, from the formula of docs/session-file/device.md."""
    if not isinstance(friction, FrictionCurve):
        return friction
    each = zip(friction.least, friction.most, friction.pitch, friction.static, friction.stribeck, x, v, strict=True)
    return [
        c + 0.5 * (most - c) * (1.0 - math.cos(2.0 * math.pi * at / pitch)) + (static - c) * math.exp(-((v / v_s) ** 2))
        for c, most, pitch, static, v_s, at, v in each
    ]


def at_rest(m: int) -> Intention:
    return Intention([0.0] * m, [0.0] * m)


@pytest.mark.long
@pytest.mark.parametrize("m", [1, 2, 3])
@given(data=st.data(), part=st.integers(1_000, TICK))
@settings(max_examples=40, deadline=None)
def test_a_step_obeys_coulombs_law_and_burns_no_less(m: int, data: st.DataObject, part: int) -> None:
    """By the plant without friction, which is given the same forces and those of friction: it comes to the same."""
    friction = data.draw(frictions(m))
    plant, free = DryPlant(held(m), T, friction), Plant(held(m), T, parts=True)
    vector = st.lists(forces, min_size=m, max_size=m)
    state, h = plant.holding([0.0] * m, data.draw(vector)), min(part, STEP)
    for _ in range(8):
        f, intention = data.draw(vector), Intention(data.draw(vector), data.draw(vector))
        before, n = state, plant.order
        state = plant.after(before, f, intention, h)
        given = np.array(state[n:]) - before[n:]
        dx = np.array(state[:m]) - before[:m]
        stands = dx == 0.0
        phi = np.where(stands, 0.0, given / (h * 1e-9))
        c = np.array(levels(friction, before[:m], before[m : 2 * m]))
        assert phi[~stands] == pytest.approx(-(c * np.sign(dx))[~stands], abs=1e-9)
        assert -float(phi @ dx) >= float(np.array(least_of(friction)) @ np.abs(dx)) - 1e-12
        assert not np.any(np.array(state[m : 2 * m])[stands])
        if not stands.any():
            same = free.after(before[:n], [a + b for a, b in zip(f, phi, strict=True)], intention, h)
            assert state[:n] == pytest.approx(same, rel=1e-9, abs=1e-12)


@given(data=st.data(), wait=st.lists(st.integers(1, 2 * TICK), min_size=1, max_size=20), friction=frictions(1))
@settings(max_examples=100, deadline=None)
def test_in_wall_time_it_burns_what_its_displacements_say(
    data: st.DataObject, wait: list[int], friction: list[float] | FrictionCurve
) -> None:
    """A mass alone: what it has of its motors' work is at most what least |d| leaves, whenever it is sampled."""
    (c,) = least_of(friction)
    driver = HeldDeviceDriver(IntentHand(DryPlant(bare(), T, friction), [zero], [zero], T), T)
    at, x, r, left = 0, driver.sample(0, Instant(0))[0], 0.0, 0.0
    for number, time in enumerate(wait):
        at += time
        to = driver.sample(number, Instant(at))[0]
        left += r * (to - x) - c * abs(to - x)
        x, at = to, at + data.draw(st.integers(0, TICK))
        if number % 3 == 2:
            driver.idle(Instant(at))
        moment = driver.apply([force := data.draw(forces)], Instant(at))[0]
        left += r * (moment - x) - c * abs(moment - x)
        x, r = moment, force
        speed = driver._latest()[1]
        assert 0.5 * 0.2 * speed * speed <= left + 1e-15


def test_a_sliding_mass_stops_where_friction_has_burned_its_energy() -> None:
    plant, state = DryPlant(bare(), T, [0.3]), [0.0, 0.1, 0.0, 0.0]
    for _ in range(100):
        state = plant.after(state, [0.0], at_rest(1))
    assert state[0] == pytest.approx(0.5 * 0.2 * 0.1**2 / 0.3, abs=2e-7)
    assert (state[1], state[-1]) == (0.0, pytest.approx(-0.2 * 0.1, rel=1e-9))


def test_it_stands_up_to_its_friction_and_moves_with_the_rest_beyond() -> None:
    plant, state = DryPlant(bare(2), T, [0.3, 0.3]), [0.0] * 8
    for _ in range(10):
        state = plant.after(state, [0.299, 0.32], at_rest(2))
    assert state[:4] == pytest.approx([0.0, 0.5 * 0.02 / 0.2 * 1e-4, 0.0, 0.02 / 0.2 * 1e-2], rel=1e-9)


CURVE = FrictionCurve((0.1,), (0.1,), (1.0,), (0.3,), (0.01,))


def test_it_breaks_away_at_its_static_friction_and_slides_with_less() -> None:
    plant = DryPlant(bare(), T, CURVE)
    state = plant.holding([0.0], [0.0])
    for _ in range(50):
        state = plant.after(state, [0.299], at_rest(1))
    assert state[:2] == [0.0, 0.0]
    for _ in range(300):
        state = plant.after(state, [0.301], at_rest(1))
    faster = plant.after(state, [0.301], at_rest(1))[1] - state[1]
    assert faster == pytest.approx((0.301 - 0.1) / 0.2 * T, rel=1e-6)
    for number in range(1000):
        state = plant.after(state, [0.2 if number > 900 else 0.0], at_rest(1))
    place = state[0]
    assert state[1] == 0.0
    for _ in range(100):  # more than the friction of a slide, less than that of rest: it stands, and does not chatter
        state = plant.after(state, [0.29], at_rest(1))
        assert state[:2] == [place, 0.0]


def test_a_spring_that_is_drawn_slowly_makes_it_stick_and_slip() -> None:
    """By 300 N/m at 5 mm/s: it rests until the spring pulls with 0.3 N, and slips; each time it stands to the bit."""
    device = held_device([0.2], [0.1], StateSpace.static(np.zeros((1, 1))), [0.0], [300.0])
    plant = DryPlant(device, T, CURVE)
    state, stood, slips, force = plant.holding([0.0], [0.0]), 0, [], 0.0
    for tick in range(2000):
        before, state = state, plant.after(state, [0.0], Intention([0.0], [0.005]))
        force = 300.0 * (0.005 * (tick + 1) * T - state[0])
        stands = state[0] == before[0]
        if not stands and stood:
            slips.append(force)
        stood = stood + 1 if stands else 0
        assert not stands or state[1] == 0.0
    assert slips == pytest.approx([0.3] * 5, abs=0.002)  # with steps of a tenth likewise, within 1 ms


def test_over_whole_pitches_it_burns_the_mean_of_least_and_most() -> None:
    plant = DryPlant(bare(), T, FrictionCurve((0.1,), (0.5,), (0.02,), (0.1,), (1.0,)))
    state, burned = plant.holding([0.0], [1.0]), 0.0
    for _ in range(400):
        after = plant.after(state, [0.3], at_rest(1))
        burned += 0.3 * (after[0] - state[0]) - 0.1 * (after[1] ** 2 - state[1] ** 2)
        state = after
    assert state[0] > 0.38
    assert burned == pytest.approx(0.3 * state[0], rel=0.01)


def test_a_curve_is_written_as_it_is_read_and_constants_as_they_always_were() -> None:
    nothing = StateSpace.static(np.zeros((1, 1)))
    hand = SimulatedHand((0.2,), (0.1,), nothing, (1.0,), (1.0,), (0.0,), (0.0,), friction=CURVE)
    data = written(hand)
    assert read(SimulatedHand, json.loads(json.dumps(data))).friction == CURVE
    constants = written(dataclasses.replace(hand, friction=(0.1,)))
    assert constants["friction"] == [0.1]
    assert read(SimulatedHand, constants).friction == (0.1,)
    for wrong in ({"least": [0.1]}, {**data["friction"], "static": [0.05]}, {**data["friction"], "pitch": [0.0]}, 0.1):
        with pytest.raises(Unfit, match=r"friction"):
            read(SimulatedHand, {**data, "friction": wrong})


def test_the_work_of_an_intended_motion_is_exact() -> None:
    """A hand of a damper alone: its force is b_h (v - v_m), so that its work follows without the momentum."""
    b, goal = 3.0, [0.05]
    device = held_device([0.2], [0.1], StateSpace.static(np.zeros((1, 1))), [b], [0.0])
    plant = DryPlant(device, T, [0.1])
    state = plant.holding([0.0], [0.0])
    for tick in range(50):
        f, intention = [0.4 * (-1.0) ** (tick // 7)], Intention([0.2], goal)
        after = plant.after(state, f, intention)
        moved = after[0] - state[0]
        own = 0.2 * moved - goal[0] * b * (moved - goal[0] * T)
        assert plant.work(state, after, f, intention) == pytest.approx(own, rel=1e-9, abs=1e-15)
        state = after


def zero(t: float) -> float:
    return 0.0


def push(t: float) -> float:
    return 0.5 if t < 0.05 else -0.35


def test_own_time_is_wall_time_with_events_on_the_ticks() -> None:
    def hand(intent: Intent) -> IntentHand:
        return IntentHand(DryPlant(bare(1, 0.2, 0.5), T, [0.2]), [intent], [zero], T)

    own, wall = OwnTimeDriver(hand(push)), HeldDeviceDriver(hand(push), T)
    for tick in range(200):
        at = Instant(tick * TICK)
        x: Floats = own.sample(tick, at)
        assert wall.sample(tick, at) == pytest.approx(x, rel=1e-12, abs=1e-16)
        assert wall.intended_work() == pytest.approx(own.intended_work(), rel=1e-9, abs=1e-15)
        for driver in (own, wall):
            driver.apply([-300.0 * x[0]], at)


def test_friction_is_one_for_each_axis_and_not_behind_joints_or_a_pointer() -> None:
    with pytest.raises(ValueError, match="friction: found 2 numbers; expected 1, one an axis"):
        DryPlant(bare(), T, [0.1, 0.1])
    hand = SimulatedHand(
        (0.2,), (0.1,), StateSpace.static(np.zeros((1, 1))), (1.0,), (1.0,), (0.0,), (0.0,), friction=(0.1,)
    )
    for friction in ((0.0,), (np.inf,), (0.1, 0.1)):
        with pytest.raises(ValueError, match="found"):
            dataclasses.replace(hand, friction=friction)
    with pytest.raises(ValueError, match="found dry friction behind a linkage"):
        dataclasses.replace(hand, linkage={"kind": "chain"})
    with pytest.raises(ValueError, match="found friction of a device that a pointer moves"):
        PersonHand(hand)


C, B, BELOW = 0.1, 0.1, 0.05
K = 2.0 * (B + C / BELOW) / T
"""The stiffness up to which a held spring is passive in a device of that damping, without a delay, N/m."""


def dithered(speed: float, time: str, tank: float | None = None, burned: float = C) -> DeviceTick:
    """A firm hand swings a device almost without mass by ``speed``, a tick each way, in such a spring."""
    of = mechanism_bundle()
    motion = f"{0.5 * speed * T!r} * (1 - cos({1.0 / T!r} * pi * t))"
    nothing = StateSpace.static(np.zeros((1, 1)))
    bundle = DeviceBundle(
        dataclasses.replace(of.common, ports=("d",)),
        np.array([[B]]),
        (DeviceRung(0.0, 0.0, DeviceShare(0.5, 1.0, 0.0)),),
        SimulatedHand((1e-5,), (B,), nothing, (200.0,), (1e6,), (0.0,), (motion,), friction=(burned,)),
        Limits((12.0,), (0.1,), (1.0,)),
        time,
        None if tank is None else LatenessAllowance(tank),
        friction=DryFriction((C,), (0.0,), BELOW),
    )
    tick = (WallTimeTick if time == WALL else OwnTimeTick)(bundle, driver_of(bundle))
    for number in range(1000):
        at = Instant(number * TICK)
        sent = tick.sample(number, at)
        tick.exert([-K * sent[0]], at)
        tick.book()
    return tick


@pytest.mark.parametrize("time", [OWN, WALL])
def test_below_its_speed_the_promise_with_friction_holds_and_beyond_it_does_not(time: str) -> None:
    below, beyond = dithered(0.99 * BELOW, time), dithered(1.5 * BELOW, time)
    assert (below.beyond, below.ledger.minimum >= -1e-12) == (0, True)
    assert below.fastest == pytest.approx(0.99 * BELOW, rel=0.01)
    assert beyond.beyond > 900
    assert beyond.ledger.minimum < -1e-3
    if time == WALL:
        accounts = [tick.interface.account.least for tick in (below, beyond) if tick.interface is not None]
        assert accounts[0] >= -1e-12
        assert accounts[1] < -1e-3


def test_beyond_its_speed_the_tank_bounds_what_friction_does_not_pay_for() -> None:
    tick = dithered(1.5 * BELOW, WALL, 5e-4)
    assert tick.interface is not None
    assert tick.interface.account.least >= -5e-4
    assert tick.interface.ticks > 10


def test_a_device_that_burns_half_of_what_it_promises_breaks_it_below_its_speed() -> None:
    assert dithered(0.99 * BELOW, OWN, burned=0.5 * C).ledger.minimum < -1e-4
