"""What a device's inertia bounds: its speed, its displacement, its interface's reserve; and what shows it false."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.nodes.device.speed_bound import SpeedBound
from manyhands.nodes.kernel.inertia import Inertia

from ...deterministic.inertia import course
from ...support.cases import cases
from ...support.moved_device import E_0, TICK, Device, promise

STATED = Inertia((0.2,), (20.0,), (0.0,))
part = st.floats(-1.0, 1.0)
pieces = st.tuples(part, st.floats(0.0, 1.0), st.floats(-30.0, 30.0), st.sampled_from([1e-4, 1e-3, 5e-3]))


@settings(max_examples=cases(100, 1000))
@given(motion=st.lists(st.lists(pieces, min_size=1, max_size=3), min_size=2, max_size=20))
def test_a_motion_that_inertia_allows_stays_within_the_bounds(
    motion: list[list[tuple[float, float, float, float]]],
) -> None:
    """Between two displacements up to three forces act; the device brakes at once, and speeds up as it can."""
    reach, v = SpeedBound(STATED), 0.0
    for between in motion:
        far, u = 0.0, reach.fastest
        moved, parts = 0.0, []
        for way, brake, r, h in between:
            a = way * (20.0 + abs(r)) / 0.2
            v *= brake
            moved += v * h + 0.5 * a * h * h
            v += a * h
            far += h * reach.speeds(u, [r], h)[0]
            u = reach.grown(u, [r], h)
            parts.append(([r], h))
            assert abs(v) <= u[0] * (1.0 + 1e-9) + 1e-12
        assert abs(moved) <= far * (1.0 + 1e-9) + 1e-12
        reach.saw([moved], parts)
        assert reach.broken is None
        assert abs(v) <= reach.fastest[0] * (1.0 + 1e-9) + 1e-12


def test_a_bound_of_the_speed_is_found_again_after_a_fast_motion() -> None:
    reach = SpeedBound(STATED)
    for _ in range(3):
        reach.saw([1e-3], [([0.0], 1e-3)])
    assert reach.fastest[0] == pytest.approx(1.0 + 0.05)  # |d|/t, and half of what 100 m/s^2 add in a tick
    reach.saw([0.0], [([0.0], 1e-3)])
    assert reach.fastest[0] == pytest.approx(0.1)
    assert reach.broken is None


def test_a_step_of_the_encoder_is_no_motion() -> None:
    """A device at rest whose displacement flickers by a step, between two readings in 0.1 ms."""
    for step, broken in ((1e-5, False), (0.0, True)):
        reach = SpeedBound(Inertia((0.2,), (20.0,), (step,)))
        for k in range(20):
            reach.saw([0.0 if k % 2 else 1e-5], [([0.0], 1e-4)])
        assert (reach.broken is not None) == broken


@pytest.mark.parametrize("seed", range(cases(12, 100)))
def test_no_motion_within_mass_and_hand_takes_more_than_the_tank(seed: int) -> None:
    found = course(seed, 50)
    assert found.margin >= 0.0
    assert not found.broken


def test_a_lighter_device_breaks_the_bound_and_is_named() -> None:
    """With half the stated mass, or three times the force of the hand, the same search finds what the reserve needs."""
    lighter = [course(seed, 50, mass=0.5) for seed in range(100, 130)]
    assert all(one.broken for one in lighter)
    assert all(course(seed, 50, hand=3.0).broken for seed in range(10))
    assert any(course(seed, 50, mass=0.5).margin < 0.0 for seed in BROKEN)


BROKEN = (71, 110, 155, 238)
"""Courses in which half the mass costs more than the tank."""


def held_for(osp: float, inertia: Inertia | None) -> float:
    """For how long the interface lets 5 N act on a device that stands still, s."""
    device = Device(np.array([[osp]]), promise(0.0, 0.1), 0.0, E_0, inertia=inertia, speed=100.0)
    for _ in range(5):
        device.send()
        device.answer([0.0])
        device.move(np.array([0.0]), device.now + TICK)
    device.send()
    device.answer([5.0])
    assert device.interface.until is not None
    assert device.exerted.tolist() == [5.0]
    return (device.interface.until - device.now) * 1e-9


def test_a_light_device_holds_a_force_through_a_late_tick() -> None:
    """5 N on a device of 0.05 N·s/m: without its 45 g for 0.14 ms beyond a tick, with them as long as any force."""
    assert 1e-3 < held_for(0.05, None) < 1.2e-3
    assert held_for(0.05, Inertia((0.045,), (20.0,), (0.0,))) == pytest.approx(6e-3)
    assert held_for(1.37, Inertia((0.2,), (20.0,), (0.0,))) > 2.0 * held_for(1.37, None)


def test_the_force_that_was_given_is_held_against_the_force_that_was_asked_for() -> None:
    """5 N for twenty ticks, after each fourth of which the loop is late by 20 ms: the force ends by itself."""
    device = Device(np.array([[1.37]]), promise(0.0, 0.1), 0.0, E_0, speed=100.0)
    given = 0.0
    for k in range(20):
        device.send()
        device.answer([5.0])
        following = device.now + (20 * TICK if k % 4 == 3 else TICK)
        given += float(device.exerted[0]) * 1e-9 * (min(device.until or following, following) - device.now) * (k < 19)
        device.move(np.array([0.0]), following)
    assert device.interface.given.asked == pytest.approx(5.0 * (15e-3 + 4 * 20e-3))
    assert device.interface.given.given < 0.5 * device.interface.given.asked
    assert device.interface.given.given <= given * (1.0 + 1e-12)


def test_a_power_fills_the_tank_and_lowers_the_bound() -> None:
    device = Device(np.array([[1.37]]), promise(0.0, 0.1), 0.0, E_0, power=1e-3)
    for _ in range(1001):
        device.send()
        device.answer([0.0])
        device.move(np.array([0.0]), device.now + TICK)
    assert device.interface.allowed == pytest.approx(E_0 + 1e-3)
    assert device.interface.tank == pytest.approx(E_0)  # at rest without a force it holds no more than E_0
    assert device.interface.margin == pytest.approx(E_0)


@pytest.mark.parametrize(
    ("mass", "hand", "step", "words"),
    [
        ((0.0,), (1.0,), (0.0,), "mass"),
        ((1.0,), (float("nan"),), (0.0,), "hand"),
        ((1.0,), (1.0,), (-1.0,), "step"),
        ((1.0, 1.0), (1.0,), (0.0,), "one an axis"),
    ],
)
def test_senseless_statements_are_refused(
    mass: tuple[float, ...], hand: tuple[float, ...], step: tuple[float, ...], words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        Inertia(mass, hand, step)
