"""Faults of real devices in running sessions: a few of each, and faults of theirs that the campaign must find."""

from __future__ import annotations

from pathlib import Path
from random import Random

import pytest

from ..fakes.far_side import Given, Record
from ..support.cases import WIDE
from .device_faults import drawn, run
from .device_row_evdev_wheel import WheelWire
from .device_row_haply import forces
from .device_row_moteus import MoteusWire
from .device_row_odrive import ODriveWire
from .device_rows import ROWS, BoardWire

pytestmark = pytest.mark.usefixtures("own_interrupt")

FEW = {
    "serial-board": ["process killed", "stalled for 30 ms", "unplugged"],
    "moteus": ["stalled for 30 ms", "under voltage"],
    "odrive": ["stalled for 30 ms", "first frames lost"],
    "haply-inverse3": ["stalled for 30 ms", "service killed"],
    "force-dimension": ["reset, and not calibrated", "process killed"],
    "evdev-wheel": ["stalled for 30 ms", "process killed"],
}
"""By device, the faults of the ordinary tests; `make device-faults` has all."""

ALWAYS = "serial-board"
"""The device that `make test` tries, and `make test-long` more widely."""

MINUTES = [pytest.mark.long, pytest.mark.alone, pytest.mark.minutes]
"""The others' few are run by `make guests`: their sessions in real time take minutes."""

EACH = [pytest.param(device, marks=[] if device == ALWAYS else MINUTES) for device in ROWS]


@pytest.mark.long
@pytest.mark.wide
@pytest.mark.parametrize("device", EACH)
def test_a_device_that_fails_exerts_nothing_and_comes_back_and_nobody_else_feels_it(
    device: str, tmp_path: Path
) -> None:
    row = ROWS[device]
    names = drawn(row, 2 * len(row.faults), Random(1)) if WIDE and device == ALWAYS else FEW[device]
    found = run(row, names, 1, tmp_path)
    assert found.wrong == []
    assert sum(map(len, found.zero.values())) == len(names)
    assert found.restarts == sum(row.faults[name].dies for name in names)
    assert found.forces > 50  # it was felt in between


# --- what the campaign has to find, planted

SWALLOWS = """
from manyhands.devices.serial_board import BoardError, SerialBoard


class Board(SerialBoard):
    '''Goes on with the last displacement, whatever has become of its board.'''

    def sample(self, tick, at):
        try:
            self.last = super().sample(tick, at)
        except BoardError:
            pass
        return self.last
"""

STALE = """
from manyhands.devices.serial_board import SerialBoard


class Board(SerialBoard):
    '''After a stall it sends what it had sent before, as if that were new.'''

    left, kept = 0, None

    def apply(self, f, at, until=None):
        if self._board.age(self._clock.now()) > 0.01:
            self.left = 30
        self.left = max(0, self.left - 1)
        if not self.left or self.kept is None:
            self.kept = list(f)
        return super().apply(self.kept, at, until)
"""


def planted(tmp_path: Path, fault: str, driver: str = "", *orders: str, device: str = "serial-board") -> str:
    """What the campaign finds wrong with a device's fault, by a driver of this code, and a fake with these orders."""
    (tmp_path / "planted.py").write_text(driver)
    changes = {"driver": "planted:Board"} if driver else {}
    return "\n".join(run(ROWS[device], [fault], 1, tmp_path, changes, orders, patience=3.0).wrong)


@pytest.mark.parametrize(
    ("device", "order", "on_the_wire"),
    [
        ("serial-board", "forever", False),
        pytest.param("moteus", "forever", True, marks=MINUTES),
        pytest.param("odrive", "forever", True, marks=MINUTES),
        pytest.param("haply-inverse3", "forever", False, marks=MINUTES),
        pytest.param("force-dimension", "deaf 1", False, marks=MINUTES),
        pytest.param("evdev-wheel", "endless", False, marks=MINUTES),
    ],
)
def test_a_device_without_a_watchdog_is_found(device: str, order: str, on_the_wire: bool, tmp_path: Path) -> None:
    """Where a wire says until when a force is held, its record says so too."""
    found = planted(tmp_path, "process killed", "", order, device=device)
    assert "process killed 0: zero: found a force" in found
    if on_the_wire:
        assert "wire: found" in found


@pytest.mark.long
def test_a_driver_that_swallows_its_error_is_found(tmp_path: Path) -> None:
    found = planted(tmp_path, "mute", SWALLOWS)
    assert "mute 0: named: found []" in found
    assert "mute 0: back: found" in found
    assert "back: found 0 restarts of tested; expected 1" in found


def test_a_driver_that_sends_a_stale_force_after_a_stall_is_found(tmp_path: Path) -> None:
    found = planted(tmp_path, "stalled for 30 ms", STALE)
    assert "given: found" in found
    assert "after their end" in found


# --- the far side's record


def test_the_forces_of_a_message_to_an_inverse3_are_read() -> None:
    from manyhands.devices.haply.service import Speech

    speech = Speech("049D", (3, 5))
    assert [*forces(speech.force((0.1, -2.0, 1e-9)))] == [(0.1, -2.0, 1e-9)]
    assert [*forces(speech.hello("org.manyhands:hand"))] == [(0.0, 0.0, 0.0)]


def test_the_time_to_zero_is_from_the_mark_to_the_first_instant_without_force() -> None:
    motors = [(0, (0.0,)), (10, (1.0,)), (30, (2.0,)), (45, (0.0,)), (60, (1.0,))]
    record = Record(motors, None, {0: 5, 1: 20, 2: 50, 3: 70}, [(18, 22), (40, 43), (41, 44), (44, 99)])
    assert record.to_zero(0) == (0, 0)
    assert record.to_zero(1) == (25, 7)
    assert record.to_zero(2) == (0, 0)
    assert record.to_zero(3) is None
    assert record.exerted() == [(10, 30, (1.0,)), (30, 45, (2.0,))]


def test_the_wire_is_read_across_the_wrap_of_the_boards_clock() -> None:
    from manyhands.devices.serial_board.frames import force

    wire = BoardWire()
    wire.clock(1_000_000, 2**32 - 500)
    sent = force(1, 1500, [0.5, -9.0])  # 2 ms after the clock's 0
    wire.take(sent[:5], 1_100_000)
    wire.take(sent[5:] + force(2, 2**32 - 1, [0.25, 0.0]), 1_200_000)
    assert wire.given == [Given(1_200_000, 3_000_000, (0.5, -5.0)), Given(1_200_000, 1_499_000, (0.25, 0.0))]


def test_the_torques_on_a_moteus_wire_are_read() -> None:
    from manyhands.devices.moteus.frames import QUERY, can_id, command, torque

    wire = MoteusWire()
    for payload, at in ((torque(0.25, 0.5, 0.0625), 1000), (QUERY, 2000), (torque(-0.75, 0.5, 0.125), 3000)):
        wire.take(command(can_id(0x70, 1, False), payload).decode(), at)
    assert wire.given == [Given(1000, 62_501_000, (0.25,)), Given(3000, 125_003_000, (-0.5,))]


def test_the_torques_on_an_odrive_wire_are_read() -> None:
    wire = ODriveWire()
    for at, line in enumerate(("c 0 0.1 *1", "w axis0.config.watchdog_timeout 0.0625 *2", "f 0 *3", "c 0 -0.25 *4")):
        wire.take(line, at)
    assert wire.given == [Given(0, 0, (0.1,)), Given(3, 62_500_003, (-0.25,))]


def test_the_reports_of_a_wheel_say_until_when_a_torque_lasts() -> None:
    """A level counts at once, also of a torque that acts; a length counts from the last start."""
    wire = WheelWire()
    for at, kind, value in (
        (1_000_000, "length", 20),
        (1_500_000, "level", -0x7FFF),
        (2_000_000, "start", 1),
        (6_000_000, "level", 0),
        (9_000_000, "length", 5),
        (9_500_000, "level", 7),
    ):
        wire.take(at, kind, value)
    assert wire.given == [
        Given(2_000_000, 22_000_000, (2.0,)),
        Given(6_000_000, 22_000_000, (0.0,)),
    ]
