"""The account of a device whose displacements are measured: it never books more friction than was burnt.

An adversary chooses where the device moves, what its encoder shows within half a step, the answers and all instants.
"""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.design.levels.dry_friction import DryFriction
from manyhands.nodes.device.play import Play
from manyhands.nodes.kernel.arithmetic import Floats

from ...support.moved_device import E_0, TICK, Array, Device, T, promise
from .test_interface_friction import FRICTION, OSP, frictions, unit, ways

STEP = 1e-5


class Heard(Play):
    """A play that adds up what it finds, exactly."""

    def __init__(self, steps: Floats) -> None:
        super().__init__(steps)
        self.ways = [Fraction(0)] * len(steps)

    def moved(self, x: Floats) -> Floats:
        found = super().moved(x)
        self.ways = [so_far + Fraction(way) for so_far, way in zip(self.ways, found, strict=True)]
        return found


def measured(
    osp: Array, friction: DryFriction, tank: float | None, tau: float = 0.0, above: float = 0.0, step: float = STEP
) -> tuple[Device, Heard]:
    m = len(osp)
    device = Device(osp, promise(tau, above), tau, tank, friction=friction, steps=[step] * m)
    heard = Heard([step] * m)
    device.interface.account._play = heard
    return device, heard


@pytest.mark.parametrize("osp", OSP.values(), ids=list(OSP))
@pytest.mark.parametrize(("tau", "above"), [(0.0, 0.0), (3e-4, 0.3)])
@given(data=st.data())
@settings(max_examples=40, deadline=None)
def test_no_motion_no_noise_and_no_delay_is_given_more_than_the_tank_or_more_friction_than_there_is(
    osp: Array, tau: float, above: float, data: st.DataObject
) -> None:
    m = len(osp)
    friction = data.draw(frictions(m))
    device, heard = measured(osp, friction, E_0, tau, above)
    known, speed = data.draw(st.booleans()), data.draw(st.sampled_from([0.0, 0.01, 0.1, 0.5]))
    delay = st.sampled_from([100_000, 300_000, TICK, 3 * TICK, 20 * TICK])
    rest = st.sampled_from([100_000, 400_000, TICK, TICK, 50 * TICK])
    size = st.sampled_from([0.0, 0.1, 0.5, 5.0, 40.0])
    noise = st.one_of(st.just([1.0] * m), st.just([-1.0] * m), unit(m))
    for before, after in data.draw(ways(m, data.draw(st.integers(1, 25)))):
        for move, to in ((before, delay), (after, rest)):
            device.noise = 0.5 * STEP * np.array(data.draw(noise))
            if to is delay:
                device.send()
            else:
                force = data.draw(size)
                device.answer([force * way for way in data.draw(unit(m))], known)
            booked = np.array(friction.left) * np.array(heard.ways, dtype=float)
            burnt = (np.array(friction.least) - np.array(friction.kept)) * device.gone
            assert np.all(booked <= burnt * (1.0 + 1e-12))
            device.move(speed * np.array(move), device.now + data.draw(to))
        assert device.interface.account.least >= -E_0 * (1.0 + 1e-9)


def test_an_account_that_counts_what_was_measured_books_friction_of_a_device_at_rest() -> None:
    """What was refused before: at the edge of a step the samples toggle, and c |dx| of them is no friction."""
    energies = []
    for steps in (STEP, 0.0):
        device, _ = measured(OSP["one axis"], FRICTION, None)
        device.interface.account._play = Play([steps])
        for tick in range(1000):
            device.noise = np.array([0.5 * STEP * (-1.0) ** tick])
            device.send()
            device.answer([0.0])
            device.move(np.array([0.0]), (tick + 1) * TICK)
        energies.append(device.interface.account.energy)
    promised = 999 * STEP**2 / T * 0.1 / 0.05  # of each step (c - w)/v* is asked, and nothing was burnt
    assert energies[0] == pytest.approx(-promised, rel=1e-2)
    assert energies[1] > 1000 * 0.1 * STEP * 0.5


def swung(speed: float, tank: float | None, step: float) -> Device:
    """A hand swings to and fro, a tick each way, in a spring as stiff as the promise below v* allows."""
    device, _ = measured(OSP["one axis"], FRICTION, tank, step=step)
    for tick in range(3000):
        at = float(device.x[0])
        device.noise = np.array([step * math.floor(at / step + 0.5) - at])
        device.send()
        device.answer([-2.0 * 2.1 / T * float(device.sent[0])])
        device.move(np.array([speed * (-1.0) ** tick]), (tick + 1) * TICK)
    return device


def test_below_its_speed_the_account_lacks_a_step_a_turn_and_beyond_it_what_friction_does_not_pay_for() -> None:
    q = 1e-6
    below, faster = swung(0.05, None, q), swung(0.1, None, q)
    assert below.interface.account.energy == pytest.approx(-3000 * 0.1 * q, rel=3e-2)
    lost = 3000 * (2.0 * 0.1**2 * T - 0.1 * 0.1 * T)  # d v^2 - c |v|
    assert faster.interface.account.energy == pytest.approx(-lost - 3000 * 0.1 * q, rel=1e-2)
    bounded = swung(0.1, E_0, q)
    assert bounded.interface.account.least >= -E_0 * (1.0 + 1e-9)
    assert bounded.interface.ticks > 100


def test_what_the_steps_take_is_no_friction_and_none_counts_before_it_was_burnt() -> None:
    """With the whole c there were 30 mJ more; a reserve that counts c would let a force below it act for ever."""
    some = DryFriction((0.1,), (0.04,), 0.05)
    device, heard = measured(OSP["one axis"], some, None)
    for tick in range(1000):
        device.send()
        device.answer([0.0])
        device.move(np.array([0.5]), (tick + 1) * TICK)
    assert float(heard.ways[0]) == pytest.approx(0.4995, rel=1e-3)
    asked = 999 * T * 0.5**2 * 0.06 / 0.05
    assert device.interface.account.energy == pytest.approx(0.06 * float(heard.ways[0]) - asked, rel=1e-6)
    assert device.interface.account.cost([0.1]) == pytest.approx(0.1**2 / (4.0 * 0.1))
