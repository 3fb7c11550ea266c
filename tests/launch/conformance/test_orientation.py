"""The suite for drivers that turn in space: a good one passes, and each broken one is named for what it is."""

from __future__ import annotations

import re
from typing import Any

import pytest

from manyhands.launch.conformance.driver import (
    EXCEPTION,
    JUMP,
    RELEASE,
    SIGN,
    SILENCE,
    STALE,
    SWAPPED,
    TORQUE,
    WRONG_ANSWER,
    Bench,
    Push,
    check_driver,
)
from manyhands.launch.conformance.judgement import Conformance, Judgement, broken
from manyhands.launch.conformance.timing import CallTimer
from manyhands.nodes.device.plugin import DeviceDriver, PluginDriver
from manyhands.nodes.device.specification import AxisMap
from manyhands.protocol.clock import SimulatedClock
from tests.support import turning_drivers as drivers
from tests.support.plugin_drivers import CALLS

T = 1e-3
PORTS = ("d.x", "d.y", "d.z")


def findings(kind: type[DeviceDriver], push: Push | None = Push(), **parameters: Any) -> list[Judgement]:  # noqa: B008
    driver = kind(PORTS, T, parameters)  # type: ignore[call-arg]
    stated = driver.specification()
    plugin = PluginDriver(kind.__name__, driver, AxisMap((0, 1, 2), (1.0,) * 3), stated, T)
    return list(check_driver(Bench(plugin, T, SimulatedClock(), CallTimer(CALLS, lambda: 0)), stated, push))


@pytest.mark.parametrize(
    "own",
    [
        {},
        {"burn": 1e-4},
        {"inertia": 3e-6, "burn": 1e-5},  # which turns on and on, by several turns
        {"burn": 0.003, "inertia": 1e-4},
        {"at": (0.5, -2.0, 1.0)},
        {"age": 2e-4, "delay": 3e-4, "timing": {"sample_age": 2e-4, "actuation_delay": 3e-4}},
    ],
)
def test_a_good_driver_keeps_everything(own: dict[str, Any]) -> None:
    found = findings(drivers.Pen, **own)
    assert {finding.verdict for finding in found} == {Conformance.KEPT}, found
    about = {check for check in (STALE, SWAPPED, SIGN, RELEASE, SILENCE) for axis in ("rx", "ry", "rz")}
    turned = {finding.check for finding in found if re.search(r"on axis r[xyz]", finding.text)}
    assert turned >= about
    assert {JUMP, TORQUE} <= {finding.check for finding in found}


def test_one_that_is_sensed_is_turned_by_no_torque() -> None:
    found = findings(drivers.Pen, sensed=True, wrist=0.002)
    assert {finding.verdict for finding in found} == {Conformance.KEPT}, found
    assert not any(re.search("N·m", finding.text) for finding in found)
    assert JUMP in {finding.check for finding in found}
    found = findings(drivers.Pen, holds="tool")  # nothing is proved of it, so a session has no torque of it
    assert TORQUE not in {finding.check for finding in found}


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        (drivers.NotUnit, WRONG_ANSWER),
        (drivers.NotANumber, WRONG_ANSWER),
        (drivers.Three, WRONG_ANSWER),
        (drivers.Words, EXCEPTION),
        (drivers.Torn, EXCEPTION),
        (drivers.WrenchTorn, EXCEPTION),
        (drivers.Jumping, JUMP),
        (drivers.Ticking, JUMP),
        (drivers.Twisting, TORQUE),
        (drivers.TwistingByForce, TORQUE),
        (drivers.TorqueKept, SILENCE),
        (drivers.TorqueNotReleased, RELEASE),
        (drivers.TorqueOpposed, SIGN),
        (drivers.TorqueSwapped, SWAPPED),
        (drivers.TorqueLate, STALE),
        (drivers.Conjugate, SIGN),
        (drivers.ScalarLast, SWAPPED),
        (drivers.OldOrientation, STALE),
    ],
    ids=lambda value: value.__name__ if isinstance(value, type) else None,
)
def test_a_broken_driver_is_named_for_what_it_is(kind: type[DeviceDriver], name: str) -> None:
    found = findings(kind, inertia=1e-4)
    assert name in broken(found), found
    text = next(finding.text for finding in found if finding.verdict is Conformance.BROKEN)
    assert "found" in text
    assert "expected" in text
    if name not in (WRONG_ANSWER, EXCEPTION, JUMP):
        assert {*broken(found)} == {name}, found


def test_without_a_push_its_orientation_alone_is_judged() -> None:
    found = findings(drivers.Pen, push=None, wrist=0.002)
    assert broken(found) == []
    assert {finding.check for finding in found if finding.verdict is Conformance.KEPT} >= {JUMP}
    assert TORQUE not in {finding.check for finding in found}


def test_of_hardware_that_turns_by_itself_nothing_is_said() -> None:
    """It may hang, or somebody may hold it."""
    found = findings(drivers.TwistingByForce, hardware=True)
    assert broken(found) == []
    assert [finding.check for finding in found if finding.verdict is Conformance.OPEN] == [TORQUE]
