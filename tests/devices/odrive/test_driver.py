"""What is ODrive's own: its start, properties and errors; the rest of its driver: tests/devices/test_motor_axis.py."""

from __future__ import annotations

import os
import time
import tty
from collections.abc import Iterator
from contextlib import closing, contextmanager
from typing import Any

import pytest

from manyhands.devices.odrive import MotorError, ODrive
from manyhands.protocol.clock import Duration, Instant

from ...fakes.odrive import fake_odrive
from ...fakes.rotor import FakeMotor, Rotor

MS = 1_000_000


@contextmanager
def opened(one: FakeMotor, **parameters: Any) -> Iterator[ODrive]:
    given = {"port": one.path, "torque": 0.5, "silence": 0.9, **parameters}
    with closing(ODrive(("knob.0",), 0.01, given)) as driver:
        yield driver


def go_on(driver: ODrive) -> None:
    """A loop that exerts nothing."""
    for tick in range(2000):
        driver.sample(tick, Instant(0))
        driver.release(Instant(0))
        driver.idle(Instant(0))
        time.sleep(0.002)


def refused(parameters: dict[str, Any] | None = None, **settings: Any) -> str:
    """What the start says of a controller with these settings."""
    with fake_odrive(**settings) as one, pytest.raises((MotorError, ValueError)) as found:
        with opened(one, **(parameters or {})):
            pass
    return str(found.value)


def test_another_firmware_is_refused() -> None:
    assert "found an ODrive of firmware 0.5; expected 0.6" in refused(properties={"fw_version_minor": 5})


def test_an_axis_that_is_not_calibrated_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("manyhands.devices.odrive.driver.GREETING", 500 * MS)
    assert "found the axis in state 1; expected 8 (closed loop control): calibrate" in refused(uncalibrated=True)


def test_a_torque_beyond_its_own_limits_is_refused() -> None:
    assert "torque: found 0.5 N·m; expected at most 0.2" in refused(properties={"axis0.config.torque_soft_max": 0.2})
    assert "torque: found 1.5 N·m; expected at most 1," in refused({"torque": 1.5})  # 0.05 N·m/A times 20 A


def test_what_cannot_be_switched_off_is_stated() -> None:
    properties = {"axis0.config.anticogging.enabled": 1, "axis0.config.encoder_bandwidth": 500.0}
    with fake_odrive(properties=properties) as one, opened(one, counts=10_000_000) as driver:
        stated = driver.specification()
    sentences = " ".join(stated.by_itself)
    for words in ("cogging", "tracking loop of 500 rad/s", "controls its current at 5000 rad/s", "vel_limit"):
        assert words in sentences
    assert stated.speed[0] == pytest.approx(62.83, rel=1e-3)
    assert stated.timing.sample_age >= 0.001  # 1/(2 * 500 rad/s) of it is the filter's
    assert stated.step is not None
    assert stated.step[0] == pytest.approx(6.2832e-6, rel=1e-4)  # it sends six digits of a turn


def test_an_axis_comes_back_though_a_question_is_always_open(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on a machine that is too busy to wait for an answer: whether it is armed again was never asked."""
    with fake_odrive(Rotor(latency=0.003)) as one, opened(one) as driver:
        monkeypatch.setattr(driver, "_longest", Duration(0))
        expired, trips, end = one.asked()["expired"], driver.figures()["watchdog_trips"], time.monotonic() + 20.0
        disarmed: list[bool] = []
        while disarmed[-2:] != [True, False]:
            assert time.monotonic() < end
            lives = 100 if one.asked()["expired"] > expired else 1
            driver.sample(0, Instant(0))
            driver.apply([0.02], Instant(0), Instant(lives * MS))
            disarmed.append(driver.exerted() is not None)
            driver.idle(Instant(0))
            time.sleep(0.005)
        assert driver.figures()["watchdog_trips"] > trips


@pytest.mark.parametrize("number", [2, True, "one"])
def test_axes_that_are_none_are_refused(number: object) -> None:
    with fake_odrive() as one, pytest.raises(ValueError, match="axis: found"), opened(one, axis=number):
        pass


@pytest.mark.parametrize(
    ("code", "said"),
    [
        (0x200, "found the disarm reason DC_BUS_UNDER_VOLTAGE; expected none: see its supply and cables"),
        (0x4000, "found the disarm reason INVERTER_OVER_TEMP; expected none: let it cool"),
        (0x8000, "VELOCITY_LIMIT_VIOLATION; expected none: it was turned faster than vel_limit allows"),
        (0x2000000, "ESTOP_REQUESTED; expected none: see the maker's list of errors"),
    ],
)
def test_errors_are_named_and_the_next_start_clears_them(code: int, said: str) -> None:
    with fake_odrive() as one:
        with opened(one) as driver:
            one.order(f"fault {code}")
            with pytest.raises(MotorError) as found:
                go_on(driver)
        assert said in str(found.value)
        with opened(one) as driver:
            assert len(driver.sample(0, Instant(0))) == 1


def test_discarded_answers_are_asked_for_again() -> None:
    """The manual's rule: an answer that would begin before the last one has left is discarded."""
    with fake_odrive(discards=True) as one, opened(one) as driver:
        angles = set()
        end = time.monotonic() + 20.0
        while len(angles) < 20:
            angles.add(driver.sample(0, Instant(0))[0])
            driver.apply([0.05], Instant(0), Instant(90 * MS))
            driver.idle(Instant(0))
            time.sleep(0.001)
            assert time.monotonic() < end


def test_a_port_where_nobody_is_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("manyhands.devices.odrive.driver._TRIES", 1)
    master, slave = os.openpty()
    tty.setraw(slave)
    try:
        with pytest.raises(MotorError, match="found no answer of an ODrive; expected one"):
            ODrive(("knob.0",), 0.01, {"port": os.ttyname(slave), "torque": 0.5})
    finally:
        os.close(master)
        os.close(slave)
