"""A simulated device with dry friction, computed again from its recording: motion and account to the last bit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from manyhands.design.levels.dry_friction import DryFriction
from manyhands.launch.audit.device import DeviceRows, FollowedInWallTime
from manyhands.launch.audit.events import Course, Happening
from manyhands.launch.audit.recompute import recompute
from manyhands.nodes.device.drivers import driver_of
from manyhands.nodes.device.tick import WallTimeTick
from manyhands.nodes.kernel.allowance import LatenessAllowance
from manyhands.nodes.kernel.bundle import WALL, DeviceBundle, SimulatedHand
from manyhands.nodes.rows import figures as names
from tests.support.instants import instant
from tests.support.mechanisms import mechanism_bundle, swinging

TICKS = 300


@pytest.fixture(scope="module")
def bundle() -> DeviceBundle:
    """Of a device in wall time, with a tank."""
    motion = ("0.004 * (1 - cos(9 * pi * t))", "0.002 * sin(40 * t)")
    hand = replace(
        swinging(None), mass=(0.1, 0.2), hand_stiffness=(300.0,) * 2, hand_damping=(2.0,) * 2, motion=motion,
        friction=(0.1, 0.3),
    )  # fmt: skip
    friction = DryFriction((0.1, 0.3), (0.0, 0.05), 0.05)
    return replace(mechanism_bundle(), source=hand, time=WALL, allowance=LatenessAllowance(5e-3), friction=friction)


def test_a_device_with_friction_follows_with_late_forces_and_free_periods(bundle: DeviceBundle) -> None:
    """Samples of free periods have no instants in a recording, and so must not change the motion."""
    tick, rows, before, at = WallTimeTick(bundle, driver_of(bundle)), [], {}, 0.0
    for turn in range(TICKS):
        sent, late, released = tick.sample(turn, instant(at)), 0.1 + 0.37 * (turn % 3), turn % 50 == 49
        if released:
            tick.release(instant(at + 2.2))
            for free in (3.1, 4.05):
                tick.sample(turn, instant(at + free), first=False)
                tick.free(instant(at + free))
            late, before[turn] = 4.4, Happening(released=2)
        asked = [-2000.0 * sent[0], -500.0 * sent[1]]
        tick.exert(asked, instant(at + late))
        tick.book()
        x, f, _, energy, x_a, instants, _ = tick.row()
        rows.append([*x, *f, *asked, *instants, *x_a, *energy])
        at += 5.0 if released else 1.0
    x, f, asked_all, instants_all, x_a_all, energies = np.split(np.array(rows), [2, 4, 6, 9, 11], axis=1)
    recorded = DeviceRows(x, f, asked_all, instants_all, x_a_all, None, np.zeros(TICKS, dtype=np.bool_))
    course = Course(before, {}, TICKS)
    again = recompute(FollowedInWallTime(bundle, lambda: driver_of(bundle), recorded), course)
    assert again[names.DISPLACEMENT].tolist() == x.tolist()
    assert again[names.APPLIED].tolist() == x_a_all.tolist()
    assert again[names.INTERFACE].tolist() == energies.tolist()
    assert isinstance(bundle.source, SimulatedHand)
    smooth = replace(bundle, source=replace(bundle.source, friction=(0.1, 0.2)))
    other = recompute(FollowedInWallTime(smooth, lambda: driver_of(smooth), recorded), course)
    assert np.abs(other[names.DISPLACEMENT] - x).max() > 1e-6
