"""The account of a device whose motors hold torques: their exact work is booked, and its bound stays for any motion.

The hands here know the linkage. A real arm of two links moves; what its torques do is tau^T dq, to rounding.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.design.levels.held_torque import HeldTorque
from manyhands.nodes.device.interface import InterfaceAccount, straying
from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.kernel.inertia import Inertia
from manyhands.protocol.clock import Instant

from ...support.held_arm import REACH, Arm, HeldDevice
from ...support.moved_device import E_0, OSP, SPEED, STALE, TICK, Array, T, promise

ARM = Arm()
KAPPA = 1.05 * ARM.kappa(REACH)
HELD = HeldTorque(KAPPA, 5.0, math.sqrt(2.0) * SPEED)
TWO_AXES = {name: osp for name, osp in OSP.items() if len(osp) == 2} | {"little": np.diag([0.2, 0.25])}


def unit(m: int) -> st.SearchStrategy[list[float]]:
    return st.lists(st.floats(-1.0, 1.0), min_size=m, max_size=m)


@st.composite
def hostile_ticks(draw: st.DrawFn) -> list[tuple[Floats, Floats, Floats, int, int]]:
    """Ticks: velocities before and after the force is applied, the answer, and how long each part lasts, ns.

    Some hands swing to and fro in one direction from tick to tick, some do what they like.
    """
    delay = st.sampled_from([0, 300_000, 600_000, TICK, 3 * TICK, 20 * TICK])
    rest = st.sampled_from([0, 400_000, TICK, TICK, TICK, 2 * TICK, 50 * TICK])
    size = st.sampled_from([0.0, 0.5, 5.0, 40.0])
    swings, way, f = draw(st.booleans()), np.array(draw(unit(2))), draw(unit(2))
    ticks = []
    for number in range(draw(st.integers(1, 25))):
        force = [draw(size) * part for part in (f if swings else draw(unit(2)))]
        before, after = (way * (-1.0) ** number,) * 2 if swings else (draw(unit(2)), draw(unit(2)))
        ticks.append((list(before), list(after), force, 0 if swings else draw(delay), TICK if swings else draw(rest)))
    return ticks


@pytest.mark.parametrize("osp", TWO_AXES.values(), ids=list(TWO_AXES))
@pytest.mark.parametrize(("tau", "above"), [(0.0, 0.0), (3e-4, 0.3)])
@given(data=st.data())
@settings(max_examples=40, deadline=None)
def test_no_sequence_of_delays_takes_more_than_the_tank(
    osp: Array, tau: float, above: float, data: st.DataObject
) -> None:
    device = HeldDevice(osp, promise(tau, above), tau, E_0, HELD, SPEED, ARM)
    known, device.tells = data.draw(st.booleans()), data.draw(st.integers(0, 3)) > 0
    for before, after, f, delay, rest in data.draw(hostile_ticks()):
        device.send()
        device.move(SPEED * np.array(before), device.now + delay)
        device.answer(f, known)
        assert device.interface.account.least >= -E_0 * (1.0 + 1e-9)
        if known:
            assert device.energy >= device.interface.account.energy - 1e-12 * device.scale
        assert device.energy >= -E_0 - 1e-12 * device.scale
        device.move(SPEED * np.array(after), device.now + rest)


@pytest.mark.parametrize("osp", TWO_AXES.values(), ids=list(TWO_AXES))
@given(r=unit(2), size=st.sampled_from([0.1, 2.0, 40.0]), parts=st.lists(unit(2), min_size=2, max_size=12), h=st.data())
@settings(max_examples=100, deadline=None)
def test_no_motion_costs_more_than_what_is_held_for_it(
    osp: Array, r: Floats, size: float, parts: list[Floats], h: st.DataObject
) -> None:
    """A torque that was read before a first stretch, any stretches after it: its work is within the bound by chords."""
    longest = STALE * 1e-9
    account = InterfaceAccount(osp, promise(0.0, 0.0), T, (SPEED,) * 2, strays=straying(HELD, (SPEED,) * 2, longest))
    force = size * np.array(r)
    torque, x, taken, each = ARM.torque(force, np.zeros(2)), np.zeros(2), [np.zeros(2)], longest / len(parts)
    for way in parts:
        x = x + each * SPEED * np.array(way)
        taken.append(x)
    begin = h.draw(st.integers(0, len(parts) - 1))
    d, lasts = x - taken[begin], each * (len(parts) - begin)
    work = float(torque @ (ARM.joints(x) - ARM.joints(taken[begin])))
    cost = work - float(d @ osp @ d) / lasts
    assert cost <= lasts * account.cost(force.tolist()) * (1.0 + 1e-9) + 1e-15


def test_the_force_alone_would_not_bound_what_its_torques_cost() -> None:
    """At the limit of speed of both axes, for as long as a force may last at all, read at its beginning."""
    longest, osp = STALE * 1e-9, np.diag([0.01, 0.01])
    ratios = {0.0: 0.0, straying(HELD, (SPEED,) * 2, longest): 0.0}
    for strays in ratios:
        account = InterfaceAccount(osp, promise(0.0, 0.0), T, (SPEED,) * 2, strays=strays)
        for v in ([1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]):
            for way in np.linspace(0.0, 2.0 * np.pi, 73):
                force, d = np.array([np.cos(way), np.sin(way)]), longest * SPEED * np.array(v)
                work = float(ARM.torque(force, np.zeros(2)) @ (ARM.joints(d) - ARM.joints(np.zeros(2))))
                cost = work - float(d @ osp @ d) / longest
                ratios[strays] = max(ratios[strays], cost / (longest * account.cost(force.tolist())))
    force_alone, with_torques = ratios.values()
    assert force_alone > 1.02
    assert 0.85 < with_torques < 1.0


FOLDED = Arm((0.3, 2.5843))  # of condition number 2.4; it bends by 18.8/m
B = 0.1  # N*s/m
PUSH = 12.0  # N
WAYS = [np.array([math.cos(way), math.sin(way)]) for way in np.linspace(0.0, math.pi, 181)]


def worst() -> tuple[Array, Array]:
    """The direction in which the folded arm bends most, and the force of 12 N that grows on each way along it."""
    q = np.array(FOLDED.home)
    way = max(WAYS, key=lambda along: float(np.linalg.norm(FOLDED.bending(q, along))))
    bending = FOLDED.bending(q, way)
    return way, -PUSH * bending / np.linalg.norm(bending)


@pytest.mark.parametrize(
    ("held", "K", "out"), [("force", 200.0, 0.0), ("torque", 0.0, 25.6), ("torque", 200.0, 225.6)], ids=str
)
def test_to_and_fro_a_held_torque_pays_out_what_no_port_counts(held: str, K: float, out: float) -> None:
    """A tick each way, from and to the pose at which 12 N are asked for; at K = 2 b/T a held force is neutral."""
    way, push = worst()
    ends = [np.zeros(2), 1e-4 * way]
    paid = 0.0
    for begin, end in (ends, ends[::-1]):
        force, d = push - K * begin, end - begin
        motors = float(FOLDED.torque(force, begin) @ (FOLDED.joints(end) - FOLDED.joints(begin)))
        paid += (motors if held == "torque" else float(force @ d)) - B * float(d @ d) / T
    assert paid / 1e-8 == pytest.approx(out, abs=0.5)


def swung(tank: float | None, told: bool) -> HeldDevice:
    """A hand swings the folded arm for 20 s at 0.5 m/s, a tick each way, against 12 N where 1 N was stated."""
    osp, held = np.diag([B, B]), HeldTorque(18.8, 1.0, 1.5)
    device = HeldDevice(osp, promise(0.0, 0.0), 0.0, tank, held, 1.0, FOLDED, told=told)
    way, push = worst()
    device.send()
    device.answer(push.tolist())
    for tick in range(20_000):
        device.move((0.5 if tick % 2 == 0 else -0.5) * way, (tick + 1) * TICK)
        device.send()
        device.answer(push.tolist())
    return device


def test_in_20_s_the_hand_gains_64_mj_that_no_port_sees() -> None:
    """Without the work of the torques the account stays at its reserve, while it really falls far below its bound."""
    device = swung(E_0, told=False)
    assert device.done - device.burned == pytest.approx(0.064, abs=0.003)
    assert (device.interface.account.least, device.interface.ticks) == (0.0, 0)
    assert device.energy < -40.0 * E_0


def test_exact_books_see_it_and_are_kept_above_the_bound() -> None:
    counted = swung(None, told=True)
    assert counted.interface.account.least < -20.0 * E_0
    assert counted.interface.account.energy == pytest.approx(counted.energy, abs=1e-9)
    bounded = swung(E_0, told=True)
    assert bounded.interface.account.least >= -E_0
    assert bounded.energy >= -E_0 - 1e-12
    assert bounded.interface.ticks > 1000


@pytest.mark.parametrize(("strays", "far", "broken"), [(0.1, 1.4e-6, None), (0.1, 1.6e-6, 1), (0.0, 1e-9, 1)])
def test_a_stated_inertia_counts_with_what_torques_may_push_beside_the_force(
    strays: float, far: float, broken: int | None
) -> None:
    """0.1 kg and no hand. Of 1 N on the first axis, a tenth speeds up the second one by 1 m/s^2 for two ticks."""
    inertia = Inertia((0.1, 0.1), (0.0, 0.0), (0.0, 0.0))
    account = InterfaceAccount(np.eye(2), promise(0.0, 0.0), T, (10.0, 10.0), inertia, strays=strays)
    account.exert([1.0, 0.0], Instant(0), None)
    for tick, x in enumerate((0.0, 0.0, far)):
        account.sampled([0.0, x], Instant(tick * TICK), 0.0)
    assert account.broken == broken


def test_a_change_of_rung_promises_what_the_torques_leave_at_its_delay() -> None:
    osp = np.eye(2)
    interface = HeldDevice(osp, promise(0.0, 0.0), 0.0, E_0, HELD, SPEED, ARM).interface
    for tau in (0.0, 1e-3):
        interface.change(promise(tau, 0.5), tau, 0.0)
        left = HELD.left(osp, T, tau, 0.0)
        assert left is not None
        assert interface.account.burn([1.0, 2.0]) == pytest.approx((left @ [1.0, 2.0]).tolist(), rel=1e-15)
        assert interface.account.compliance([1.0, 2.0]) == pytest.approx(np.linalg.solve(left, [1.0, 2.0]).tolist())
    with pytest.raises(ValueError, match=r"held: found nothing left of Delta_D at a delay of 0.05 s"):
        interface.change(promise(1e-3, 0.5), 0.05, 0.0)


def test_a_tip_that_may_turn_too_far_is_refused() -> None:
    with pytest.raises(ValueError, match=r"held: found a tip that may turn by 2.4 while .* 0.12 s; expected"):
        straying(HeldTorque(20.0, 1.0, 1.0), (0.5, 0.5), 0.12)
