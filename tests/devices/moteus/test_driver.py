"""What is moteus' own: its start, settings and faults; the rest of its driver: tests/devices/test_motor_axis.py."""

from __future__ import annotations

import os
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from typing import Any

import pytest

from manyhands.devices.moteus import Moteus, MotorError
from manyhands.protocol.clock import Instant

from ...fakes.moteus import fake_moteus
from ...fakes.rotor import FakeMotor

MS = 1_000_000


@contextmanager
def opened(one: FakeMotor, **parameters: Any) -> Iterator[Moteus]:
    given = {"port": one.path, "torque": 0.5, "silence": 0.9, **parameters}
    with closing(Moteus(("knob.0",), 0.01, given)) as driver:
        yield driver


def go_on(driver: Moteus, again: Callable[[], None]) -> None:
    """A loop, in which something happens again and again: coming back after a late tick begins with a stop, which
    clears a fault."""
    for tick in range(2000):
        driver.sample(tick, Instant(0))
        driver.release(Instant(0))
        if tick % 100 == 50:
            again()
        time.sleep(0.002)


def refused(parameters: dict[str, Any] | None = None, **settings: Any) -> str:
    """What the start says of a controller with these settings."""
    with fake_moteus(**settings) as one, pytest.raises((MotorError, ValueError)) as found:
        with opened(one, **(parameters or {})):
            pass
    return str(found.value)


def test_another_register_map_is_refused() -> None:
    assert "found a moteus with register map 4 (firmware 0x010000); expected 5" in refused(map=4)


def test_another_id_is_not_there(monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr("manyhands.devices.moteus.driver.GREETING", 300 * MS)
        assert "found no answer of a moteus 1 within" in refused(id=2)
    with fake_moteus(id=2) as one, opened(one, id=2) as driver:
        assert len(driver.sample(0, Instant(0))) == 1


def test_a_pause_at_the_start_does_no_harm() -> None:
    with fake_moteus(lapses=2) as one, opened(one) as driver:
        assert len(driver.sample(0, Instant(0))) == 1


def test_a_uart_has_checksums_and_a_spoilt_line_is_dropped() -> None:
    with fake_moteus(uart=True) as one, opened(one) as driver:
        driver.apply([0.1], Instant(0), Instant(90 * MS))
        end = time.monotonic() + 20.0
        while one.asked()["torque"] != pytest.approx(0.1):
            driver.sample(0, Instant(0))
            driver.apply([0.1], Instant(0), Instant(90 * MS))
            assert time.monotonic() < end
        assert one.asked()["bad"] == 0  # every line that it was sent had the right checksum, once it wanted one


def test_what_cannot_be_switched_off_is_stated() -> None:
    conf = {
        "motor.cogging_dq_scale": 0.002,
        "servo.voltage_mode_control": 1.0,
        "servo.max_current_desired_rate": 10000.0,
        "servo.max_velocity": 5.0,
        "motor_position.sources.0.pll_filter_hz": 100.0,
    }
    with fake_moteus(conf=conf) as one, opened(one) as driver:
        stated = driver.specification()
    sentences = " ".join(stated.by_itself)
    for words in ("cogging", "voltages", "10000 A/s", "tracking loop of 100 Hz", "controls its current at 1000 Hz"):
        assert words in sentences
    assert stated.speed[0] == pytest.approx(31.4159, rel=1e-4)
    # the filter's own part of the age: 2.48 / (2 * 2 pi * 100 Hz)
    assert stated.timing.sample_age >= 2.48 / (4.0 * 3.1416 * 100.0)


def test_bounds_of_the_controller_bound_the_displacement() -> None:
    conf = {"servopos.position_min": -0.25, "servopos.position_max": 0.5}
    with fake_moteus(conf=conf) as one, opened(one, zero=0.5) as driver:
        assert driver.specification().displacement[0] == pytest.approx(2.0708, rel=1e-4)  # to -pi/2
    said = refused({"zero": 4.0}, conf=conf)
    assert "zero: found 4 rad; expected an angle between the controller's own bounds, -1.571 and 3.142 rad" in said


def test_fixed_voltage_is_refused() -> None:
    assert "found servo.fixed_voltage_mode; expected 0" in refused(conf={"servo.fixed_voltage_mode": 1.0})


@pytest.mark.parametrize("number", [0, 112, True, "one"])
def test_ids_that_are_none_are_refused(number: object) -> None:
    with fake_moteus() as one, pytest.raises(ValueError, match="id: found"), opened(one, id=number):
        pass


@pytest.mark.parametrize(
    ("code", "said"),
    [
        (40, "found the moteus with fault 40, under voltage: see its supply and cables; expected none (it has 8 V and"),
        (38, "fault 38, over temperature: let it cool"),
        (33, "fault 33, motor driver"),
        (77, "fault 77, see the list of the maker"),
    ],
)
def test_faults_are_named_and_the_next_start_clears_them(code: int, said: str) -> None:
    with fake_moteus() as one:
        with opened(one) as driver:
            with pytest.raises(MotorError) as found:
                go_on(driver, lambda: one.order(f"fault {code}"))
        assert said in str(found.value)
        with opened(one) as driver:
            assert len(driver.sample(0, Instant(0))) == 1


def test_a_port_where_nobody_is_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("manyhands.devices.moteus.driver.GREETING", 200 * MS)
    master, slave = os.openpty()
    tty.setraw(slave)
    try:
        with pytest.raises(MotorError, match=r"found no answer of a moteus 1 within 0\.2 s; expected one"):
            Moteus(("knob.0",), 0.01, {"port": os.ttyname(slave), "torque": 0.5})
    finally:
        os.close(master)
        os.close(slave)
