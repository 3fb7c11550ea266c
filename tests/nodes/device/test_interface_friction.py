"""The account of a device with dry friction: proved below v*, and above its bound whatever the speed.

The hands dither at Nyquist's rate, turn round within the stiction, creep, or do what they like.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.design.levels.dry_friction import DryFriction
from manyhands.nodes.kernel.arithmetic import Floats, linear_map

from ...support.moved_device import E_0, SPEED, TICK, Array, Device, T, promise

OSP = {
    "one axis": np.array([[0.1]]),
    "two axes": np.diag([0.05, 0.4]),
    "joined axes": np.array([[0.3, 0.1], [0.1, 0.2]]),
}


def unit(m: int) -> st.SearchStrategy[list[float]]:
    return st.lists(st.floats(-1.0, 1.0), min_size=m, max_size=m)


@st.composite
def frictions(draw: st.DrawFn, m: int) -> DryFriction:
    least = tuple(draw(st.floats(0.02, 0.5)) for _ in range(m))
    kept = tuple(draw(st.sampled_from([0.0, 0.5])) * c for c in least)
    return DryFriction(least, kept, draw(st.sampled_from([0.01, 0.1, 0.5])))


@st.composite
def ways(draw: st.DrawFn, m: int, ticks: int) -> list[tuple[Floats, Floats]]:
    """By tick, the parts of a speed before and after its force is applied."""
    one = draw(unit(m))
    match draw(st.sampled_from(["dithers", "creeps", "turns", "any"])):
        case "dithers":
            return [([v * (-1.0) ** k for v in one],) * 2 for k in range(ticks)]
        case "creeps":
            return [([0.01 * v for v in one],) * 2 for k in range(ticks)]
        case "turns":
            return [(one, [-v for v in one]) for k in range(ticks)]
        case _:
            return [(draw(unit(m)), draw(unit(m))) for k in range(ticks)]


@pytest.mark.parametrize("osp", OSP.values(), ids=list(OSP))
@pytest.mark.parametrize(("tau", "above"), [(0.0, 0.0), (3e-4, 0.3)])
@given(data=st.data())
@settings(max_examples=40, deadline=None)
def test_no_motion_and_no_delay_takes_more_than_the_tank(
    osp: Array, tau: float, above: float, data: st.DataObject
) -> None:
    m = len(osp)
    device = Device(osp, promise(tau, above), tau, E_0, friction=data.draw(frictions(m)))
    known, speed = data.draw(st.booleans()), data.draw(st.sampled_from([0.01, 0.1, SPEED]))
    delay = st.sampled_from([0, 300_000, TICK, 3 * TICK, 20 * TICK])
    rest = st.sampled_from([0, 400_000, TICK, TICK, 50 * TICK])
    size = st.sampled_from([0.0, 0.1, 0.5, 5.0, 40.0])
    for before, after in data.draw(ways(m, data.draw(st.integers(1, 25)))):
        device.send()
        device.move(speed * np.array(before), device.now + data.draw(delay))
        force = data.draw(size)
        device.answer([force * way for way in data.draw(unit(m))], known)
        assert device.interface.account.least >= -E_0 * (1.0 + 1e-9)
        if known:
            assert device.energy >= device.interface.account.energy - 1e-12 * device.scale
        assert device.energy >= -E_0 - 1e-12 * device.scale
        device.move(speed * np.array(after), device.now + data.draw(rest))


@pytest.mark.parametrize("osp", OSP.values(), ids=list(OSP))
@pytest.mark.parametrize(("tau", "above"), [(0.0, 0.0), (3e-4, 0.3), (1e-3, 0.5)])
@pytest.mark.parametrize("tank", [None, 0.1], ids=["counted", "bounded"])
@given(data=st.data())
@settings(max_examples=20, deadline=None)
def test_below_its_speed_nothing_is_lost_and_nothing_enforced_at_covered_delays(
    osp: Array, tau: float, above: float, tank: float | None, data: st.DataObject
) -> None:
    m = len(osp)
    friction = data.draw(frictions(m))
    assert friction.speed is not None
    device = Device(osp, promise(tau, above), tau, tank, friction=friction)
    size, level = data.draw(st.sampled_from([0.1, 1.0, 5.0])), friction.raised(osp)
    for before, after in data.draw(ways(m, data.draw(st.integers(1, 25)))):
        device.send()
        sampled = device.now
        device.move(friction.speed * np.array(before), sampled + int(data.draw(st.floats(0.0, 1.0)) * tau * 1e9))
        f = [size * way for way in data.draw(unit(m))]
        device.answer(f)
        stored = 0.5 * device.promised.kappa * T * float(np.array(f) @ np.linalg.inv(level) @ np.array(f))
        assert device.interface.account.energy >= stored - 1e-12
        assert device.energy == pytest.approx(device.interface.account.energy, abs=1e-12)
        assert device.interface.account.exerted == f
        device.move(friction.speed * np.array(after), sampled + TICK)
    assert (device.interface.ticks, device.interface.offset) == (0, 0.0)


FRICTION = DryFriction((0.1,), (0.0,), 0.05)


def swung(speed: float, tank: float | None, fault: str = "") -> Device:
    """A hand swings to and fro, a tick each way, in a spring as stiff as the promise below v* allows."""
    osp, K = OSP["one axis"], 2.0 * 2.1 / T
    device = Device(osp, promise(0.0, 0.0), 0.0, tank, friction=FRICTION)
    account = device.interface.account
    if fault == "a damping at every speed":
        account._burned, account._friction = linear_map(FRICTION.raised(osp)), None
    elif fault == "twice its friction":
        account._friction = [0.2]
    for tick in range(3000):
        device.send()
        device.answer([-K * float(device.sent[0])])
        device.move(np.array([speed * (-1.0) ** tick]), (tick + 1) * TICK)
        if fault == "booked twice":
            account.balance += 0.1 * speed * T
    return device


def test_beyond_its_speed_the_account_sees_what_friction_does_not_pay_for_and_bounds_it() -> None:
    """At K = 2 Delta/T a held spring is neutral with the damping Delta: v* is the limit, to the last joule."""
    below, counted, bounded = swung(0.05, E_0), swung(0.1, None), swung(0.1, E_0)
    assert below.interface.account.least == pytest.approx(0.0, abs=1e-12)
    assert below.interface.ticks == 0
    lost = 3000 * (2.0 * 0.1**2 * T - 0.1 * 0.1 * T)  # d v^2 - c |v|
    assert counted.interface.account.energy == pytest.approx(-lost, rel=1e-2)
    assert bounded.energy >= -E_0 - 1e-12
    assert bounded.interface.ticks > 100


@pytest.mark.parametrize("fault", ["a damping at every speed", "booked twice", "twice its friction"])
def test_an_account_that_counts_more_friction_than_there_is_loses_its_bound(fault: str) -> None:
    device = swung(0.1, E_0, fault)
    assert device.interface.account.least >= -E_0
    assert device.energy < -2.0 * E_0


def test_a_force_below_the_friction_costs_nothing_and_one_above_it_the_rest() -> None:
    account = Device(np.array([[0.1]]), promise(0.0, 0.0), 0.0, E_0, friction=FRICTION).interface.account
    assert account.cost([0.1]) == 0.0
    assert account.lasts([0.09], account._since, 0.0) == math.inf
    assert account.cost([0.15]) == pytest.approx(0.05**2 / (4.0 * 0.1))
    assert account.cost([-0.15]) == account.cost([0.15])
