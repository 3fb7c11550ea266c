"""A device whose motors hold torques, computed again from its recording: motion, work and account to the last bit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from manyhands.design.levels.held_torque import HeldTorque
from manyhands.launch.audit.device import DeviceRows, FollowedInWallTime
from manyhands.launch.audit.events import Course
from manyhands.launch.audit.recompute import recompute
from manyhands.nodes.device.drivers import driver_of
from manyhands.nodes.device.tick import WallTimeTick
from manyhands.nodes.kernel.allowance import LatenessAllowance
from manyhands.nodes.kernel.bundle import WALL, DeviceBundle
from manyhands.nodes.rows import figures as names
from manyhands.protocol.channels import WORK
from tests.support.instants import instant
from tests.support.mechanisms import CHAIN, mechanism_bundle, swinging, worst

TICKS = 300


@pytest.fixture(scope="module")
def bundle() -> DeviceBundle:
    """Of a device in wall time, with a tank."""
    hand = replace(swinging(CHAIN), damping=(0.15,) * 2)
    return replace(
        mechanism_bundle(), source=hand, osp=0.15 * np.eye(2), held=HeldTorque(19.0, 12.0, 1.5), time=WALL,
        allowance=LatenessAllowance(5e-3),
    )  # fmt: skip


@pytest.fixture(scope="module")
def recorded(bundle: DeviceBundle) -> tuple[DeviceRows, np.ndarray]:
    """Its rows and its account, with a late force now and then."""
    tick, rows, at = WallTimeTick(bundle, driver_of(bundle)), [], 0.0
    _, push = worst()
    for turn in range(TICKS):
        tick.sample(turn, instant(at))
        late = 1.4 if turn % 10 == 9 else 0.1
        tick.exert(push, instant(at + late))
        tick.book()
        x, f, _, energy, x_a, instants, work = tick.row()
        rows.append([*x, *f, *push, *instants, *x_a, *work, *energy])
        at += 2.0 if late > 1.0 else 1.0
    x, f, asked, instants, x_a, work, energy = np.split(np.array(rows), [2, 4, 6, 9, 11, 13], axis=1)
    stopped = np.zeros(TICKS, dtype=np.bool_)
    return DeviceRows(x, f, asked, instants, x_a, None, stopped, work=work), energy


def test_a_simulated_linkage_follows_with_the_work_of_its_motors(
    bundle: DeviceBundle, recorded: tuple[DeviceRows, np.ndarray]
) -> None:
    rows, energy = recorded
    again = recompute(FollowedInWallTime(bundle, lambda: driver_of(bundle), rows), Course({}, {}, TICKS))
    assert again[names.INTERFACE].tolist() == energy.tolist()
    assert again[WORK].tolist() == rows.work.tolist()  # type: ignore[union-attr]
    assert again[names.DISPLACEMENT].tolist() == rows.x.tolist()
    assert np.ptp(rows.work) > 1e-3  # type: ignore[arg-type]


def test_the_account_of_another_packages_driver_follows_from_its_recorded_work(
    bundle: DeviceBundle, recorded: tuple[DeviceRows, np.ndarray]
) -> None:
    rows, energy = recorded
    again = recompute(FollowedInWallTime(bundle, lambda: "given", rows), Course({}, {}, TICKS))
    assert again[names.INTERFACE].tolist() == energy.tolist()
    assert again[names.FORCE].tolist() == rows.f.tolist()
    ports = recompute(FollowedInWallTime(bundle, lambda: "given", replace(rows, work=None)), Course({}, {}, TICKS))
    assert np.abs(ports[names.INTERFACE] - energy).max() > 1e-4
    unknown = replace(rows, work=np.full((TICKS, 2), np.nan))
    least = recompute(FollowedInWallTime(bundle, lambda: "given", unknown), Course({}, {}, TICKS))
    assert np.all(least[names.INTERFACE][10:] < energy[10:])
