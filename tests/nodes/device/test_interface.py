"""The device's interface account: what it is, that it stays above -E_0 whatever happens, and that it never acts alone.

The adversary of the property chooses everything that the device does not: where the device moves (within its limit of
speed), what the couplings answer, and when each sample is taken, each force applied, each answer left out.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.kernel.inertia import Inertia
from manyhands.protocol.clock import Instant

from ...support.moved_device import E_0, OSP, SPEED, TICK, Array, Device, T, promise


def unit(m: int) -> st.SearchStrategy[list[float]]:
    return st.lists(st.floats(-1.0, 1.0), min_size=m, max_size=m)


@st.composite
def hostile_ticks(draw: st.DrawFn, m: int) -> list[tuple[Floats, Floats, Floats, int, int]]:
    """Ticks: velocities before and after the force is applied, the answer, and how long each part lasts, ns."""
    delay = st.sampled_from([0, 300_000, 600_000, TICK, 3 * TICK, 20 * TICK, 50 * TICK])
    rest = st.sampled_from([0, 400_000, TICK, TICK, 2 * TICK, 50 * TICK])
    force = st.sampled_from([0.0, 0.5, 5.0, 40.0])
    ticks = []
    for _ in range(draw(st.integers(1, 25))):
        size = draw(force)
        f = [size * way for way in draw(unit(m))]
        ticks.append((draw(unit(m)), draw(unit(m)), f, draw(delay), draw(rest)))
    return ticks


@pytest.mark.parametrize("osp", OSP.values(), ids=list(OSP))
@pytest.mark.parametrize(("tau", "above"), [(0.0, 0.0), (3e-4, 0.3), (1e-3, 0.5)])
@given(data=st.data())
@settings(max_examples=25, deadline=None)
def test_no_sequence_of_delays_takes_more_than_the_tank(
    osp: Array, tau: float, above: float, data: st.DataObject
) -> None:
    device = Device(osp, promise(tau, above), tau, E_0)
    known = data.draw(st.booleans())  # whether the device knows where it is when it applies a force
    for before, after, f, delay, rest in data.draw(hostile_ticks(len(osp))):
        device.send()
        device.move(SPEED * np.array(before), device.now + delay)
        device.answer(f, known)
        # the account is a lower bound of the definition: exact except where a force ended between two samples
        assert device.interface.account.least >= -E_0 * (1.0 + 1e-9)
        if known:  # otherwise the last part of the motion is booked with the next sample
            assert device.energy >= device.interface.account.energy - 1e-12 * device.scale
        assert device.energy >= -E_0 - 1e-12 * device.scale
        device.move(SPEED * np.array(after), device.now + rest)


@pytest.mark.parametrize("latency", [300_000, TICK])
@pytest.mark.parametrize("osp", OSP.values(), ids=list(OSP))
@given(data=st.data())
@settings(max_examples=10, deadline=None)
def test_neither_does_any_with_a_latency_whatever_acts_first(osp: Array, latency: int, data: st.DataObject) -> None:
    """A force may act after the next sample was taken, and none ends before its device is told."""
    tau = latency * 1e-9
    device = Device(osp, promise(tau, 0.1), tau, E_0, latency)
    for before, after, f, delay, rest in data.draw(hostile_ticks(len(osp))):
        device.send()
        device.move(SPEED * np.array(before), device.now + delay)
        device.answer(f)
        assert device.interface.account.least >= -E_0 * (1.0 + 1e-9)
        assert device.energy >= -E_0 - 1e-12 * device.scale
        device.move(SPEED * np.array(after), device.now + max(rest, 100_000))


@pytest.mark.parametrize("latency", [0, 300_000, TICK])
@given(data=st.data())
@settings(max_examples=40, deadline=None)
def test_neither_does_any_with_motors_that_exert_less_than_they_are_given(latency: int, data: st.DataObject) -> None:
    """A motor's own watchdog lets go, or its protection: it says so, and the tick goes on."""
    osp, tau = next(iter(OSP.values())), max(3e-4, latency * 1e-9)
    device = Device(osp, promise(tau, 0.1), tau, E_0, latency)
    for before, after, f, delay, rest in data.draw(hostile_ticks(len(osp))):
        device.send()
        device.move(SPEED * np.array(before), device.now + delay)
        device.answer(f, part=data.draw(st.sampled_from([0.0, 0.0, 0.5, 1.0])))
        assert device.interface.account.least >= -E_0 * (1.0 + 1e-9)
        assert device.energy >= -E_0 - 1e-12 * device.scale
        device.move(SPEED * np.array(after), device.now + max(rest, 100_000))


@pytest.mark.parametrize("osp", OSP.values(), ids=list(OSP))
@pytest.mark.parametrize(("tau", "above"), [(0.0, 0.0), (1e-3, 0.5)])
@given(data=st.data(), faster=st.sampled_from([3.0, 30.0]))
@settings(max_examples=10, deadline=None)
def test_a_motion_beyond_the_limit_of_speed_costs_what_decision_30_states(
    osp: Array, tau: float, above: float, faster: float, data: st.DataObject
) -> None:
    """Every motion: the account falls below -E_0 by no more than two successive ticks have cost beyond the limit."""
    device = Device(osp, promise(tau, above), tau, E_0)
    for before, after, f, delay, rest in data.draw(hostile_ticks(len(osp))):
        device.send()
        device.move(faster * SPEED * np.array(before), device.now + delay)
        device.answer(f)
        most = max(map(sum, pairwise(device.beyond)))
        assert device.energy >= -E_0 - most - 1e-12 * device.scale
        assert device.energy >= device.interface.account.energy - 1e-12 * device.scale - sum(device.beyond)
        device.move(faster * SPEED * np.array(after), device.now + rest)


def test_only_a_motion_beyond_the_limit_of_speed_breaks_the_bound() -> None:
    """A little damping, and a force that moves the device along itself at once, as if it had no mass."""
    osp, tau = np.array([[0.1]]), 3e-4

    def after_a_late_tick(speed: float) -> tuple[float, float]:
        device = Device(osp, promise(tau, 0.1), tau, E_0)
        device.send()
        device.answer([3.0])
        device.move(np.array([speed]), 5 * TICK)
        device.send()
        device.answer([0.0])
        return device.energy, max(map(sum, pairwise(device.beyond)))

    within, most = after_a_late_tick(SPEED)
    assert (within >= -E_0, most) == (True, pytest.approx(0.0, abs=1e-15))
    beyond, most = after_a_late_tick(15.0)  # 3 N and 0.1 N·s/m: a mechanism without mass would come to 30 m/s
    assert -E_0 - most <= beyond < -2.0 * E_0


@st.composite
def covered_ticks(draw: st.DrawFn, m: int) -> list[tuple[Floats, Floats, Floats, float]]:
    """Ticks: velocities before and after the force is applied, the answer, and the delay as a part of tau."""
    size = draw(st.sampled_from([0.1, 1.0, 5.0]))
    each = st.tuples(unit(m), unit(m), unit(m).map(lambda f: [size * way for way in f]), st.floats(0.0, 1.0))
    return draw(st.lists(each, min_size=1, max_size=25))


@pytest.mark.parametrize("osp", OSP.values(), ids=list(OSP))
@pytest.mark.parametrize(("tau", "above"), [(0.0, 0.0), (3e-4, 0.3), (1e-3, 0.5)])
@pytest.mark.parametrize("tank", [None, 0.1], ids=["counted", "bounded"])
@given(data=st.data())
@settings(max_examples=12, deadline=None)
def test_within_the_certified_delay_nothing_is_lost_and_nothing_changed(
    osp: Array, tau: float, above: float, tank: float | None, data: st.DataObject
) -> None:
    device = Device(osp, promise(tau, above), tau, tank)
    for before, after, f, late in data.draw(covered_ticks(len(osp))):
        device.send()
        sampled = device.now
        device.move(SPEED * np.array(before), sampled + int(late * tau * 1e9))
        device.answer(f)
        stored = 0.5 * device.promised.kappa * T * float(np.array(f) @ np.linalg.inv(osp) @ np.array(f))
        # the terms of the sum are at most of the order of f w and f K f, some 10 mJ each, over 25 ticks
        assert device.interface.account.energy >= stored - 1e-12
        assert device.energy == pytest.approx(device.interface.account.energy, abs=1e-12)
        assert device.sent.tolist() == device.x.tolist() or device.now > sampled
        assert device.interface.account.exerted == f
        device.move(SPEED * np.array(after), sampled + TICK)
    assert device.interface.ticks == 0
    assert device.interface.offset == 0.0


def test_lateness_lowers_the_account_by_the_energy_it_put_in() -> None:
    """A wall whose force comes one and a half ticks late pushes a device that moves out of it, as in theory."""
    osp, tau = next(iter(OSP.values())), 0.0
    device = Device(osp, promise(tau, 0.0), tau, None)
    device.send()
    device.answer([2.0])
    device.move(np.array([0.5]), TICK)
    device.send()
    device.move(np.array([0.5]), TICK + TICK // 2)  # 0.25 mm at 2 N, after the couplings had asked for none
    device.answer([0.0])
    late = 2.0 * 0.25e-3 - 1.37 * 0.5 * 0.25e-3
    in_time = Device(osp, promise(tau, 0.0), tau, None)
    in_time.send()
    in_time.answer([2.0])
    in_time.move(np.array([0.5]), TICK)
    in_time.send()
    in_time.answer([0.0])
    in_time.move(np.array([0.5]), TICK + TICK // 2)
    in_time.interface.account.sampled(in_time.x.tolist(), Instant(in_time.now))
    burned = 1.37 * 0.5 * 0.25e-3
    lost = in_time.interface.account.energy - device.interface.account.energy
    assert lost == pytest.approx(late + burned, rel=1e-12)


def test_a_force_is_held_for_as_long_as_the_tank_pays() -> None:
    osp = next(iter(OSP.values()))
    device = Device(osp, promise(0.0, 0.0), 0.0, E_0)
    device.send()
    device.answer([2.0])
    until = device.interface.until
    # a device at 2/(2 * 1.37) m/s would cost 0.73 W; the tank has 5 mJ, and K f^2/2 is 0.73 mJ
    power = 4.0 / (4.0 * 1.37)
    assert until == pytest.approx(1e9 * min((E_0 + 0.5 * 0.5 * T * 4.0 / 1.37) / power, 6e-3), rel=1e-6)
    device.move(np.array([0.0]), TICK)
    device.send()
    assert device.interface.until == pytest.approx(min(until, TICK + 1e9 * E_0 / power), rel=1e-6)


def test_an_offset_goes_as_soon_as_the_account_pays_for_it() -> None:
    """A hand that holds a wall, after lateness: the offset falls with its motion, and motion and device agree again."""
    osp, tau = next(iter(OSP.values())), 5e-4
    device = Device(osp, promise(tau, 0.5), tau, E_0)
    wall, behind = 600.0, list[float]()
    for tick in range(8000):  # the reserve for such delays is forgotten after some 4 s without them
        at = tick * TICK
        if at < device.now:
            continue
        swing = np.array([4e-3 * (1.0 - np.cos(2.0 * np.pi * tick / 400.0))])
        device.move((swing - device.x) / max(1e-9, (at - device.now) * 1e-9), at)
        device.send()
        late = 4 * TICK if 500 < tick < 1500 else TICK // 4
        device.move(np.array([0.0]), device.now + late)
        device.answer([-wall * float(device.sent[0])])
        behind.append(device.interface.behind)
    assert device.interface.offset == max(behind) > 1e-4
    assert behind[-1] < 1e-6
    assert abs(device.sent[0] - device.x[0]) < 1e-6  # one that is smaller is dropped in the next tick
    assert device.interface.account.least >= -E_0


def test_a_hand_that_leans_on_a_wall_does_not_drift_while_forces_are_late_again_and_again() -> None:
    """Every fifth force is 2.5 ms late. The hand moves in until the tank holds a reserve for that, and then comes back.

    An offset that took the reserve, or a motion that did, would let every late force end early, and the hand would move
    in by as much each time: 100 mm/s in this run.
    """
    osp, tau, wall, mass, hand = next(iter(OSP.values())), 6e-4, 835.0, 0.2, 5.0
    inertia = Inertia((mass,), (50.0,), (0.0,))
    device = Device(osp, promise(tau, 0.5), tau, E_0, inertia=inertia, power=1e-3)
    damping, v = float(osp[0, 0]), 0.0

    def pushed(until: int) -> None:
        nonlocal v
        while device.now < until:
            at = min(until, device.now + 250_000)
            if device.until is not None and device.now < device.until < at:
                at = device.until
            h = 1e-9 * (at - device.now)
            acts = device.until is None or device.now < device.until
            push = hand * min(1e-9 * device.now, 1.0)
            v += h / mass * (push + (float(device.exerted[0]) if acts else 0.0) - damping * v)
            device.move(np.array([v]), at)

    places = {}
    while device.now < 25_000 * TICK:
        tick = -(-device.now // TICK)
        pushed(tick * TICK)
        device.send()
        pushed(device.now + (5 * TICK // 2 if tick % 5 == 0 else 2 * TICK // 5))
        device.answer([-wall * float(device.sent[0])])
        places[device.now // TICK // 1000] = float(device.x[0])
    assert max(places.values()) > hand / wall + 1e-3  # lateness could have taken the wall away in this run
    assert places[24] <= places[18] - 1e-3
    assert places[24] < 2.0 * hand / wall
    assert device.interface.margin >= 0.0
