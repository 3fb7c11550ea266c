"""Faults of real devices in running sessions: a few of each, and faults of theirs that the campaign must find."""

from __future__ import annotations

from pathlib import Path
from random import Random

import pytest

from ..fakes.far_side import Given, Record
from ..support.cases import WIDE
from .device_faults import drawn, run
from .device_row_haply import forces
from .device_rows import ROWS, BoardWire

pytestmark = pytest.mark.usefixtures("own_interrupt")

FEW = {
    "serial-board": ["process killed", "stalled for 30 ms", "unplugged"],
    "haply-inverse3": ["stalled for 30 ms", "service killed"],
}
"""By device, the faults of the ordinary tests; `make device-faults` has all."""

ALWAYS = "serial-board"
"""The device that `make test` tries, and `make test-long` more widely; the others' few are in `make test-long`."""


@pytest.mark.wide
@pytest.mark.parametrize(
    "device", [pytest.param(device, marks=[] if device == ALWAYS else pytest.mark.long) for device in ROWS]
)
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


def planted(tmp_path: Path, fault: str, driver: str = "", *orders: str) -> str:
    """What the campaign finds wrong with a board's fault, by a driver of this code, and a fake with these orders."""
    (tmp_path / "planted.py").write_text(driver)
    changes = {"driver": "planted:Board"} if driver else {}
    return "\n".join(run(ROWS["serial-board"], [fault], 1, tmp_path, changes, orders, patience=3.0).wrong)


def test_a_board_without_a_watchdog_is_found(tmp_path: Path) -> None:
    found = planted(tmp_path, "process killed", "", "forever")
    assert "process killed 0: zero: found a force" in found


@pytest.mark.long
def test_an_inverse3_that_never_lets_go_is_found(tmp_path: Path) -> None:
    row = ROWS["haply-inverse3"]
    found = "\n".join(run(row, ["process killed"], 1, tmp_path, orders=["forever"], patience=3.0).wrong)
    assert "process killed 0: zero: found a force" in found


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
