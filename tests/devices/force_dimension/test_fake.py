"""The fake behind the ABI is a delta robot: its angles, places and Jacobian belong together, and its work is exact."""

from __future__ import annotations

from collections.abc import Iterator
from ctypes import c_int
from itertools import product

import numpy as np
import pytest

from manyhands.design.models.linkage import bending_at, linkage_of
from manyhands.devices.force_dimension.library import Kinematics, load
from manyhands.devices.force_dimension.survey import BEYOND, bending, survey

from ...fakes.dhd import LINKAGE, MIDDLE, FakeDevices, OwnTime, fake_devices

REACH = 0.04
BOX = {"low": [-REACH, -REACH, MIDDLE - REACH], "high": [REACH, REACH, MIDDLE + REACH]}
TO_LINKAGE = [1, 2, 0]  # the linkage's x, y, z are the library's y, z, x


@pytest.fixture
def devices() -> Iterator[FakeDevices]:
    with fake_devices() as found:
        OwnTime(found)
        yield found


@pytest.fixture
def kinematics(devices: FakeDevices) -> Kinematics:
    library = load(devices.path)
    library.dhdEnableExpertMode()
    assert library.drdOpenID(0) == 0
    return Kinematics(library, 0, "fake")


def test_its_joints_and_jacobian_are_those_of_the_linkage_that_a_session_states(kinematics: Kinematics) -> None:
    linkage = linkage_of({**LINKAGE, **BOX})
    for place in ([0.0, 0.0, 0.0], [0.03, -0.02, 0.01], [-0.04, 0.04, 0.035]):
        counts = kinematics.counts(place)
        q, x = kinematics.angles(counts), np.array(kinematics.place(counts))
        assert x == pytest.approx(place, abs=3e-5)  # the counts are whole
        tip = x[TO_LINKAGE] + [0.0, 0.0, MIDDLE]
        assert q == pytest.approx(linkage.joints(tip), abs=1e-9)
        J = np.array(kinematics.jacobian(q)).reshape(3, 3)[TO_LINKAGE]
        assert pytest.approx(linkage.jacobian(tip), abs=1e-9) == J


def test_kappa_by_the_library_alone_is_that_of_the_linkage(
    kinematics: Kinematics, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the corners of the box; more places cost seconds, and are what the command searches."""
    monkeypatch.setattr("manyhands.devices.force_dimension.survey.FINE", 2)
    along = np.random.default_rng(1).normal(size=(2000, 3))
    along /= np.linalg.norm(along, axis=1)[:, None]
    linkage = linkage_of({**LINKAGE, **BOX})
    corners = product(*zip(BOX["low"], BOX["high"], strict=True))
    expected = max(bending_at(linkage, np.array(corner), along) for corner in corners)
    assert bending(kinematics, REACH) / BEYOND == pytest.approx(expected, rel=0.01)


def test_what_its_motors_hold_everywhere_and_its_step(kinematics: Kinematics) -> None:
    found = survey(kinematics, REACH)
    linkage = linkage_of({**LINKAGE, **BOX})
    rng = np.random.default_rng(1)
    for tip in rng.uniform(BOX["low"], BOX["high"], (50, 3)):
        J = linkage.jacobian(tip)
        for f in rng.normal(size=(20, 3)):
            assert np.abs(J.T @ f).max() * found.force / np.linalg.norm(f) <= 1.01  # N*m, of each motor
        steps = np.abs(J).sum(axis=1) * 2 * np.pi / 65536
        assert np.all(steps <= 1.01 * np.array(found.step)[[1, 2, 0]])


def test_a_watchdog_ends_the_torques_and_brakes(devices: FakeDevices, kinematics: Kinematics) -> None:
    clock = OwnTime(devices)
    for call, value in (("dhdSetWatchdog", 8), ("dhdEnableForce", 1)):
        kinematics.called(call, value)
    kinematics.called("dhdSetDeltaJointTorques", 0.1, 0.1, 0.1)
    assert devices.asked().t == pytest.approx((0.1, 0.1, 0.1), rel=1e-3)
    clock.wait(0.0008)
    assert devices.asked().forces
    clock.wait(0.0004)
    seen = devices.asked()
    assert (seen.forces, seen.braked, seen.watchdogs, seen.t) == (False, True, 1, (0.0, 0.0, 0.0))
    status = (c_int * 64)()
    kinematics.called("dhdGetStatus", status)
    assert status[14] == 3  # DHD_FORCEOFF_WATCHDOG


def test_its_time_guard_answers_with_the_past(devices: FakeDevices, kinematics: Kinematics) -> None:
    clock = OwnTime(devices)
    kinematics.called("dhdSetTimeGuard", 1000)
    clock.wait(0.002)
    assert kinematics.read()[0]
    assert not kinematics.read()[0]
    clock.wait(0.0011)
    assert kinematics.read()[0]
    kinematics.called("dhdSetTimeGuard", 0)
    assert kinematics.read()[0]


def test_its_work_is_what_its_energy_and_its_damper_have(devices: FakeDevices, kinematics: Kinematics) -> None:
    """Without damping and friction all work becomes kinetic energy."""
    devices.order("plant 0.2 0 0")
    clock = OwnTime(devices)
    kinematics.called("dhdEnableForce", 1)
    kinematics.called("dhdSetDeltaJointTorques", 0.05, 0.02, 0.03)
    clock.wait(0.05)
    one = devices.asked()
    clock.wait(0.0001)
    other = devices.asked()
    speed = np.subtract(other.x, one.x) / 0.0001
    assert one.work > 1e-3
    assert 0.1 * speed @ speed == pytest.approx(0.5 * (one.work + other.work), rel=0.01)


@pytest.mark.parametrize(
    ("fault", "call", "said"),
    [
        ("unplugged 1", "dhdGetStatus", "communication error"),
        ("no_watchdog 1", "dhdSetWatchdog", "not available"),
    ],
)
def test_its_failures_have_words(
    devices: FakeDevices, kinematics: Kinematics, fault: str, call: str, said: str
) -> None:
    devices.order(fault)
    with pytest.raises(RuntimeError, match=said):
        kinematics.called(call, (c_int * 64)() if call == "dhdGetStatus" else 9)
