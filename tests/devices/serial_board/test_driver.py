"""The driver on a fake board: a process of its own behind a pseudo-terminal, in real time, with failures to order.

Nothing here judges how fast the machine is: what is awaited comes in the end, or the test fails by its own time-out.
"""

from __future__ import annotations

import os
import struct
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from typing import Any

import pytest

from manyhands.devices.serial_board import BoardError, SerialBoard
from manyhands.devices.serial_board.frames import Feature, sealed
from manyhands.devices.serial_port import PortError
from manyhands.nodes.device.specification import ROUND, TIMES
from manyhands.protocol.clock import Instant

from ...fakes.board import Axis, FakeBoard, fake_board

MS = 1_000_000
PATIENCE = 20.0
"""s, in which a test waits for a board before it fails."""

SLOW = {"silence": 0.9}
"""A machine that is busy with other tests may give the board no turn for a while."""


@contextmanager
def opened(one: FakeBoard, axes: int = 1, **parameters: Any) -> Iterator[SerialBoard]:
    ports = tuple(f"dx.{i}" for i in range(axes))
    with closing(SerialBoard(ports, 1e-3, {"port": one.path, **SLOW, **parameters})) as driver:
        yield driver


def until(true: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE
    while not true():
        assert time.monotonic() < end, "it never came"
        time.sleep(1e-3)


def test_a_board_is_greeted_and_states_what_it_is() -> None:
    axis = Axis(m=0.2, force=4.0, displacement=0.05, speed=1.5)
    with fake_board(axis, axis, period_us=500) as one, opened(one, 2) as driver:
        stated = driver.specification()
    assert stated.axes == ("x", "y")
    assert stated.force == (4.0, 4.0)
    assert stated.displacement == pytest.approx((0.05, 0.05), rel=1e-6)
    assert stated.mass == pytest.approx((0.2, 0.2), rel=1e-6)
    assert stated.hardware
    timing = stated.timing
    assert stated.measured == TIMES
    assert timing.sample_age > 5e-4
    assert timing.jitter <= timing.sample_age
    for time_stated in (timing.sample_age, timing.actuation_delay):
        assert time_stated / ROUND == pytest.approx(round(time_stated / ROUND))
        assert time_stated > 0.0


def test_given_times_are_stated_as_they_are() -> None:
    with fake_board() as one, opened(one, sample_age=0.002, actuation_delay=0.001) as driver:
        timing = driver.specification().timing
        assert driver.specification().measured == ()
    assert (timing.sample_age, timing.jitter, timing.actuation_delay) == (0.002, 0.002, 0.001)


def test_a_board_that_holds_torques_says_so() -> None:
    for features, held in ((Feature.TELLS_WORK, False), (Feature.TELLS_WORK | Feature.HOLDS_TORQUE, True)):
        with fake_board(features=features) as one, opened(one) as driver:
            assert driver.specification().holds_torque is held


def test_a_force_moves_the_board_and_is_exerted() -> None:
    with fake_board(Axis(m=0.1, b=0.2)) as one, opened(one) as driver:
        first = driver.sample(0, Instant(0))[0]
        driver.apply([0.5], Instant(0), Instant(40 * MS))
        until(lambda: one.asked()[1] == [0.5] or one.asked()[0][0] > 1e-4)
        until(lambda: driver.sample(1, Instant(0))[0] > first)
        driver.apply([-0.5], Instant(0))
        until(lambda: driver.exerted() in ((-0.5,), (0.0,)))
        driver.release(Instant(0))
        until(lambda: driver.exerted() == (0.0,))
        assert one.asked()[1] == [0.0]


def test_a_force_ends_by_itself_though_nobody_calls() -> None:
    with fake_board(Axis(b=5.0)) as one, opened(one) as driver:
        driver.apply([2.0], Instant(0), Instant(20 * MS))
        until(lambda: one.asked()[0][0] > 1e-5)
        until(lambda: one.asked()[1] == [0.0])


def test_the_work_is_that_of_the_motors() -> None:
    with fake_board(Axis(m=0.1, b=1.0)) as one, opened(one) as driver:
        driver.sample(0, Instant(0))
        assert driver.work() is None  # nothing before it
        total = 0.0
        for tick in range(1, 60):
            driver.apply([0.4], Instant(0), Instant(40 * MS))
            x = driver.sample(tick, Instant(0))[0]
            total += driver.work() or 0.0
            time.sleep(1e-3)
        # one force all the time, but where the machine was so late that it ended: then it is f dx of the rest
        assert 0.0 < total <= 0.4 * x + 1e-5


def test_a_board_that_does_not_tell_its_work() -> None:
    with fake_board(features=Feature(0)) as one, opened(one) as driver:
        driver.sample(0, Instant(0))
        driver.sample(1, Instant(0))
        assert driver.work() is None


def test_forces_that_a_stalled_bus_delivers_late_are_none() -> None:
    """The frame names the instant at which it ends: so what was queued is dead on arrival."""
    with fake_board(Axis(b=5.0), longest_us=20_000) as one, opened(one) as driver:
        before = one.asked()[2]["late"]
        one.order("stall 200")
        time.sleep(0.01)  # so that the board has begun to stall; a longer one changes nothing
        driver.apply([3.0], Instant(0), Instant(20 * MS))
        until(lambda: one.asked()[2]["late"] > before)
        x, f, _ = one.asked()
        assert f == [0.0]
        assert x == [0.0]


def test_it_is_greeted_anew_by_the_next_driver() -> None:
    with fake_board() as one:
        for _ in range(2):
            with opened(one) as driver:
                driver.apply([1.0], Instant(0))
            until(lambda: one.asked()[1] == [0.0])


# --- what fails, by name


def failing(driver: SerialBoard, tick: int = 0) -> str:
    """What the driver says once it fails."""
    said: list[str] = []

    def fails() -> bool:
        try:
            driver.sample(tick, Instant(0))
            driver.apply([0.1] * len(driver.specification().force), Instant(0))
        except (BoardError, PortError) as error:
            said.append(str(error))
        return bool(said)

    until(fails)
    return said[0]


@pytest.mark.parametrize(
    ("order", "said"),
    [
        ("mute", "found no state for"),
        ("reset", "found no state for"),
        ("brake", "found the board braked by its own protection"),
        ("stall 3000", "found no state for"),
    ],
)
def test_a_board_that_is_of_no_use_any_more_is_named(order: str, said: str) -> None:
    with fake_board() as one, opened(one) as driver:
        one.order(order)
        assert said in failing(driver)
        assert one.path in failing(driver)


def test_an_unplugged_board_is_named_and_closing_it_is_quiet() -> None:
    with fake_board() as one, opened(one, silence=0.9) as driver:
        one.unplug()
        assert one.path in failing(driver)


def test_a_board_comes_back() -> None:
    with fake_board() as one:
        with opened(one) as driver:
            one.order("reset")
            failing(driver)
        with opened(one) as driver:
            assert len(driver.sample(0, Instant(0))) == 1


def test_lost_and_broken_states_are_counted() -> None:
    with fake_board() as one, opened(one) as driver:
        one.order("drop 5")
        one.order("noise 40")
        until(lambda: driver.sample(0, Instant(0)) is not None and driver.figures()["missing_states"] >= 5)
        until(lambda: driver.sample(0, Instant(0)) is not None and driver.figures()["broken_frames"] >= 1)
        assert len(driver.sample(0, Instant(0))) == 1


def test_a_wrong_number_of_axes_is_refused() -> None:
    with (
        fake_board(Axis(), Axis()) as one,
        pytest.raises(BoardError, match=r"found a board of 2 axes.*expected 1"),
        opened(one),
    ):
        pass


@contextmanager
def line(answer: bytes | None) -> Iterator[str]:
    """A port whose other end answers all that it hears with the same words; None for an end that is silent."""
    master, slave = os.openpty()
    tty.setraw(slave)

    def speak() -> None:
        while os.read(master, 1000) != b"end":
            if answer is not None:
                os.write(master, answer)

    speaker = threading.Thread(target=speak)
    speaker.start()
    try:
        yield os.ttyname(slave)
    finally:
        os.write(slave, b"end")
        speaker.join()
        os.close(master)
        os.close(slave)


@pytest.mark.parametrize(
    ("answer", "said"), [(None, "found no answer"), (b"hello, I am a printer\0", "found something else")]
)
def test_a_port_where_nobody_speaks_the_protocol_is_refused(
    answer: bytes | None, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("manyhands.devices.serial_board.driver.GREETING", 300 * MS)
    with line(answer) as path, pytest.raises(BoardError, match=said):
        SerialBoard(("dx.0",), 1e-3, {"port": path})


def test_a_board_of_another_version_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.urandom", bytes)  # the nonce that this board answers to
    with line(sealed(struct.pack("<BBI", 0x81, 2, 0))) as path, pytest.raises(BoardError, match="version 2"):
        SerialBoard(("dx.0",), 1e-3, {"port": path})


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ({}, "port: found none"),
        ({"port": "/dev/null", "speed": 3}, "parameters: found 'speed'"),
        ({"port": "/dev/null", "baud": "fast"}, "baud: found 'fast'"),
        ({"port": "/dev/null", "baud": 1234}, "baud: found 1234"),
        ({"port": "/dev/null", "silence": 0}, "silence: found 0"),
        ({"port": "/dev/null", "silence": None}, "silence: found None"),
        ({"port": "/dev/null", "sample_age": True}, "sample_age: found True"),
    ],
)
def test_parameters_that_are_none_are_refused(parameters: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        SerialBoard(("dx.0",), 1e-3, parameters)


@pytest.mark.parametrize(
    ("path", "said"), [("/dev/no-such-port", "plug the device in"), ("/dev/null", "cannot use /dev/null")]
)
def test_a_port_that_is_none_is_refused(path: str, said: str) -> None:
    with pytest.raises(PortError, match=said):
        SerialBoard(("dx.0",), 1e-3, {"port": path})
