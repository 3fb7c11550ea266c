"""The work of motors that hold torques, from frames: exact for a linkage, and unknown where frames do not tell it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import pytest

from manyhands.devices.haply.service import ZERO, Reading, Vector
from manyhands.devices.haply.work import MotorWork

from ...fakes.haply_service import DEFAULTS, Device

STEPS = 400


def along(late: bool, force: float = 3.0) -> Iterator[tuple[Reading, Vector, float]]:
    """Readings of an arm whose tip goes round a circle, under forces that turn; with the work of its motors so far.

    The frame that answers a message has the torques of that message, or, where it is ``late``, those before it.
    """
    arm = Device("049D", DEFAULTS)
    f, torques, done = ZERO, ZERO, 0.0
    angles: Vector | None = None
    for step in range(STEPS):
        phase = 2.0 * math.pi * step / 100
        arm.x = [0.04 * math.cos(phase), -0.15 + 0.04 * math.sin(phase), 0.15 + 0.02 * math.sin(phase)]
        turn, one, two = arm.joints()
        before, angles = angles or (turn, one, two), (turn, one, two)
        done += sum(t * (b - a) for t, a, b in zip(torques, before, angles, strict=True))
        held, held_torques = f, torques
        if step % 3 == 0:  # each is sent three times, as a keeper does
            f = (force * math.sin(0.1 * step), force * math.cos(0.07 * step), -0.5 * force)
        a, b, c = arm.loads(list(f))
        torques = (a, b, c)
        x, y, z = arm.x
        told = (held, held_torques) if late else (f, torques)
        yield Reading((x, y, z), told[0], angles, told[1], False, (1.0, 1.0, 1.0), {}), f, done


def finished(work: MotorWork, late: bool = False, force: float = 3.0) -> float:
    done = 0.0
    for reading, f, done in along(late, force):  # noqa: B007 -- the last one counts
        work.take(reading, f)
    return done


@pytest.mark.parametrize("late", [False, True])
def test_it_is_that_of_torques_along_angles(late: bool) -> None:
    work = MotorWork()
    done = finished(work, late)
    assert work.unknown <= 2  # until a force has changed, nobody knows which frame tells it
    assert work.sum == pytest.approx(done, abs=0.05 * abs(done) if late else 1e-12)
    assert not work.doubted


def test_it_differs_from_that_of_held_forces() -> None:
    """Otherwise the tests here could not tell one from the other."""
    last: tuple[Reading, Vector] | None = None
    ports = done = 0.0
    for reading, f, done in along(False):  # noqa: B007
        if last is not None:
            ports += sum(a * (c - b) for a, b, c in zip(last[1], last[0].position, reading.position, strict=True))
        last = reading, f
    assert abs(ports - done) > 1e-4


def test_frames_without_torques_tell_none() -> None:
    work = MotorWork()
    for reading, f, _ in along(False):
        work.take(replace(reading, torques=(0.0, 0.0, 0.0)), f)
    assert work.unknown == STEPS - 1


def test_without_a_force_no_torques_are_no_work() -> None:
    work = MotorWork()
    for reading, _, _ in along(False):
        work.take(replace(reading, torques=ZERO, force=ZERO), ZERO)
    assert (work.sum, work.unknown) == (0.0, 0)


@pytest.mark.parametrize("unit", [1000.0, 1e-3, math.pi / 180.0, 180.0 / math.pi, -1.0])
def test_torques_in_another_unit_are_doubted(unit: float) -> None:
    work = MotorWork()
    for reading, f, _ in along(False):
        a, b, c = reading.torques or ZERO
        work.take(replace(reading, torques=(unit * a, unit * b, unit * c)), f)
    assert work.doubted


def test_a_force_that_is_reported_otherwise_tells_none() -> None:
    work = MotorWork()
    for reading, f, _ in along(False):
        a, b, c = reading.force or ZERO
        work.take(replace(reading, force=(0.7 * a, 0.7 * b, 0.7 * c)), f)
    assert work.unknown > 0.9 * STEPS


def test_a_gap_is_unknown_once() -> None:
    work, readings = MotorWork(), along(False)
    for _ in range(10):
        reading, f, _ = next(readings)
        work.take(reading, f)
    assert work.unknown == 0
    work.gap()
    for reading, f, _ in readings:
        work.take(reading, f)
    assert work.unknown == 1
