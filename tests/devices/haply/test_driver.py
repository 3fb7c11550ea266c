"""The driver on a fake service: a process of its own, in real time, with failures to order.

Nothing here judges how fast the machine is: what is awaited comes in the end, or the test fails by its own time-out.
"""

from __future__ import annotations

import os
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from typing import Any

import pytest

from manyhands.devices.haply import HaplyError, HaplyInverse3
from manyhands.extras import MissingExtra
from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.session import Session
from manyhands.nodes.device.drivers import driver_of
from manyhands.nodes.device.specification import ROUND, TIMES
from manyhands.nodes.device.tick import tick_of
from manyhands.nodes.kernel.bundle import REALTIME, DeviceBundle
from manyhands.nodes.kernel.factory import FactoryError
from manyhands.nodes.kernel.realtime import may_raise
from manyhands.protocol.clock import Instant

from ...fakes.haply import FakeHaply, fake_haply
from ...support.slot import told

MS = 1_000_000
PATIENCE = 20.0
"""s, in which a test waits for a service before it fails."""

PORTS = ("hand.x", "hand.y", "hand.z")
SLOW = {"silence": 0.9}
"""A machine that is busy with other tests may give the service no turn for a while."""


@contextmanager
def opened(one: FakeHaply, **parameters: Any) -> Iterator[HaplyInverse3]:
    given = {"port": one.port, "events": one.events, **SLOW, **parameters}
    with closing(HaplyInverse3(PORTS, 1e-3, given)) as driver:
        yield driver


def until(true: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE
    while not true():
        assert time.monotonic() < end, "it never came"
        time.sleep(1e-3)


class Loop:
    """Ticks of 1 ms or later, as the machine allows."""

    def __init__(self, driver: HaplyInverse3) -> None:
        self.driver, self.begin, self.tick = driver, time.monotonic_ns(), 0
        self.work, self.unknown = 0.0, 0

    def turn(self, f: list[float] | None = None, lives: int = 100 * MS) -> list[float]:
        at = Instant(time.monotonic_ns() - self.begin)
        x = list(self.driver.sample(self.tick, at))
        done = self.driver.work()
        self.work += done or 0.0
        self.unknown += done is None
        if f is None:
            self.driver.release(at)
        else:
            self.driver.apply(f, at, Instant(at + lives))
        self.driver.exerted()
        self.driver.idle(Instant(at + MS))
        self.tick += 1
        time.sleep(1e-3)
        return x


def test_what_it_states() -> None:
    with fake_haply() as one, opened(one, force=3, reach=0.1, speed=0.5) as driver:
        stated = driver.specification()
        assert one.order("ask")["profiles"] == ["org.manyhands:hand"]
    assert stated.axes == ("x", "y", "z")
    assert (stated.force, stated.displacement, stated.speed) == ((3.0,) * 3, (0.1,) * 3, (0.5,) * 3)
    assert stated.hardware
    assert stated.holds_torque
    assert stated.mass is None
    assert stated.by_itself == ()
    assert stated.measured == TIMES
    timing = stated.timing
    assert 0.0 < timing.jitter <= timing.sample_age
    for time_stated in (timing.sample_age, timing.actuation_delay):
        assert time_stated / ROUND == pytest.approx(round(time_stated / ROUND))
        assert time_stated > 0.0002


def test_given_words_are_stated_as_they_are() -> None:
    with (
        fake_haply() as one,
        opened(one, sample_age=0.002, actuation_delay=0.001, force_held="firmware") as driver,
    ):
        stated = driver.specification()
        assert driver.lead <= 0.002 - 0.00025  # what is asked for so late is at most as old as stated
    assert not stated.holds_torque
    assert stated.measured == ()
    assert (stated.timing.sample_age, stated.timing.jitter, stated.timing.actuation_delay) == (0.002, 0.002, 0.001)


@pytest.mark.parametrize(("version", "dialect"), [("3.4.1", "values"), ("3.5.0", "vector")])
def test_a_force_moves_the_device_in_either_dialect(version: str, dialect: str) -> None:
    with fake_haply(version=version, dialects=[dialect], damping=5.0) as one, opened(one) as driver:
        loop = Loop(driver)
        first = loop.turn()
        until(lambda: loop.turn([0.0, 0.0, 0.5])[2] > first[2] + 1e-3)
        until(lambda: driver.exerted() == (0.0, 0.0, 0.5))
        x, y, _ = loop.turn()
        assert max(abs(x - first[0]), abs(y - first[1])) < 1e-3
        until(lambda: one.asked()["f"] == [0.0, 0.0, 0.0])


def test_a_force_ends_by_itself_though_nobody_calls() -> None:
    """The service would hold it for ten seconds."""
    with fake_haply(idle=10.0, damping=5.0) as one, opened(one) as driver:
        Loop(driver).turn([2.0, 0.0, 0.0], 30 * MS)
        until(lambda: one.asked()["most"] > 1.0)
        until(lambda: one.asked()["f"] == [0.0, 0.0, 0.0])
        assert not one.asked()["idle"]  # it was the driver


def test_a_force_whose_end_comes_nearer_ends_there() -> None:
    """Though the keeper sleeps for longer than that: its next turn is days away."""
    with fake_haply(idle=60.0, damping=5.0) as one:
        given = {"port": one.port, "events": one.events, "sample_age": 0.002, **SLOW}
        with closing(HaplyInverse3(PORTS, 1e6, given)) as driver:
            driver.apply([2.0, 0.0, 0.0], Instant(0), Instant(40_000 * MS))
            until(lambda: one.asked()["most"] > 1.0)
            driver.apply([2.0, 0.0, 0.0], Instant(0), Instant(50 * MS))
            until(lambda: one.asked()["f"] == [0.0, 0.0, 0.0])


def test_a_force_that_is_over_already_is_none() -> None:
    with fake_haply(damping=5.0) as one, opened(one) as driver:
        driver.apply([2.0, 0.0, 0.0], Instant(5 * MS), Instant(5 * MS))
        loop = Loop(driver)
        for _ in range(20):
            loop.turn()
        assert one.asked()["most"] == 0.0


def test_the_keeper_asks_once_more_in_each_period() -> None:
    """Without it there is one message a tick, and a sample nearly a period old."""
    with fake_haply() as one, opened(one) as driver:
        loop = Loop(driver)
        before, first = one.order("ask")["messages"], loop.tick
        for _ in range(200):
            loop.turn()
        assert one.order("ask")["messages"] - before > 1.5 * (loop.tick - first)


def test_a_loop_that_has_paused_gets_a_new_state() -> None:
    with fake_haply(damping=5.0) as one, opened(one, silence=0.5) as driver:
        loop = Loop(driver)
        loop.turn()
        until(lambda: one.asked()["idle"])  # the keeper has stopped, too
        time.sleep(0.6)  # longer than the silence that counts
        before = one.order("ask")["messages"]
        loop.turn()
        assert one.order("ask")["messages"] > before


def test_a_service_that_is_behind_is_asked_no_more() -> None:
    """Answers that queue up would make every later sample older, and every force later."""
    with fake_haply() as one, opened(one) as driver:
        Loop(driver).turn()
        until(lambda: one.asked()["idle"])
        before = one.order("stall 300")["messages"]
        driver.apply([0.0, 0.0, 0.0], Instant(0))  # the keeper goes on for 200 ms
        until(lambda: one.order("ask")["messages"] > before)
        until(lambda: one.asked()["idle"])
        assert one.order("ask")["messages"] - before < 10


def test_how_long_the_service_holds_a_force_is_measured() -> None:
    with fake_haply(idle=0.1) as one, opened(one) as driver:
        assert 95.0 < driver.figures()["idle_after_ms"] < 500.0
    with fake_haply(idle=10.0) as one, opened(one) as driver:
        assert driver.figures()["idle_after_ms"] == 0.0
        assert "may hold a force for 0.5 s and more" in driver.specification().by_itself[0]


@pytest.mark.parametrize("given", [{}, {"float32": True}, {"late": True}])
def test_what_is_exerted_is_the_force_itself_or_unknown(given: dict[str, Any]) -> None:
    """A report that is rounded, or of the message before, is no other force."""
    with fake_haply(damping=5.0, **given) as one, opened(one) as driver:
        loop, told = Loop(driver), 0
        for tick in range(100):
            f = (0.1 * (tick // 10) + 1.0 / 3.0, 0.0, 0.0)
            loop.turn([*f])
            found = driver.exerted()
            assert found in (None, f)
            told += found is not None
        assert told


# --- the work


def worked(late: bool) -> tuple[float, float, int]:
    """The work of the fake's motors and what the driver told of it, J; and how often it could not tell."""
    with fake_haply(damping=3.0, step=0.0005, late=late, idle=1.0) as one, opened(one) as driver:
        loop = Loop(driver)
        for tick in range(80):
            loop.turn([0.5 if tick % 60 < 30 else -0.5, 0.3, -0.2], 5_000 * MS)
        for _ in range(20):
            loop.turn()
        assert driver.figures()["torques_doubted"] == 0.0
        return one.asked()["work"], loop.work, loop.unknown


@pytest.mark.parametrize("late", [False, True])
def test_the_work_is_that_of_the_motors(late: bool) -> None:
    for _ in range(10):
        done, told, unknown = worked(late)
        if not unknown:  # the machine gave the loop its turn within 50 ms each time
            assert told == pytest.approx(done, rel=0.05, abs=1e-5)
            return
    pytest.fail(f"the machine was too slow ten times: {unknown} answers were unknown")


@pytest.mark.parametrize("given", [{"tells_torques": False}, {"torque_unit": 1000.0}])
def test_torques_that_frames_do_not_tell_are_no_work(given: dict[str, Any]) -> None:
    with fake_haply(damping=3.0, **given) as one, opened(one) as driver:
        loop = Loop(driver)
        until(lambda: loop.turn([1.0, 0.0, 0.0])[0] > 0.02)
        before = loop.unknown, loop.work
        until(lambda: loop.turn([1.0, 0.0, 0.0]) != [] and loop.unknown > before[0] + 5)
        assert loop.work == before[1]


class Unkept(HaplyInverse3):
    """Its keeper does nothing, as that of a process that is stopped."""

    def _keep(self) -> None:
        return


def test_the_work_of_a_pause_is_unknown() -> None:
    """The service has let go meanwhile, nobody knows when."""
    with fake_haply(damping=3.0, idle=0.03) as one:
        with closing(Unkept(PORTS, 1e-3, {"port": one.port, "events": one.events, **SLOW})) as driver:
            loop = Loop(driver)
            until(lambda: loop.turn([0.5, 0.0, 0.0])[0] > 1e-3)
            driver.apply([0.5, 0.0, 0.0], Instant(0), Instant(60_000 * MS))
            until(lambda: one.asked()["idle"])
            time.sleep(0.06)  # longer than a force is held without an end
            driver.sample(0, Instant(0))  # the answer to that force, and a new state
            assert driver.work() is None


def test_the_work_while_the_service_stalls_is_unknown() -> None:
    """Its device has let go meanwhile, though messages were sent all the time."""
    with fake_haply(damping=3.0, idle=0.03) as one, opened(one) as driver:
        loop = Loop(driver)
        until(lambda: loop.turn([0.5, 0.0, 0.0])[0] > 1e-3)
        before = loop.unknown
        one.order("stall 100")
        for _ in range(200):
            loop.turn([0.5, 0.0, 0.0])
        assert loop.unknown > before


def test_a_pause_that_is_shorter_than_the_silence_leaves_no_old_state() -> None:
    with fake_haply(damping=5.0) as one, opened(one, silence=PATIENCE) as driver:
        loop = Loop(driver)
        loop.turn()
        until(lambda: one.asked()["idle"])  # the keeper has stopped, too
        before = driver.figures()["oldest_ms"]
        time.sleep(0.5)
        loop.turn()
        assert driver.figures()["oldest_ms"] < before + 450.0


def test_nor_does_one_after_which_the_keeper_asks_before_the_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    with fake_haply(damping=5.0) as one, opened(one, silence=PATIENCE) as driver:
        loop = Loop(driver)
        loop.turn()
        until(lambda: one.asked()["idle"])
        before = driver.figures()["oldest_ms"]
        time.sleep(0.5)
        read = driver._read

        def keeper_first() -> dict[str, Any] | None:
            monkeypatch.setattr(driver, "_read", read)
            found = read()
            one.order("stall 50")  # so that the answer is not there at once
            driver._send()
            return found

        monkeypatch.setattr(driver, "_read", keeper_first)
        loop.turn()
        assert driver.figures()["oldest_ms"] < before + 450.0


@pytest.mark.skipif(not may_raise(), reason="this user may have no real-time priority")
def test_the_keeper_has_the_priority_of_its_loop() -> None:
    with fake_haply() as one, opened(one) as driver:
        keeper = next(thread for thread in threading.enumerate() if thread.name == "haply")
        assert keeper.native_id is not None
        policy, param = os.sched_getscheduler(0), os.sched_getparam(0)
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
            Loop(driver).turn()
            until(lambda: os.sched_getscheduler(keeper.native_id or 0) == os.SCHED_FIFO)
        except PermissionError:
            pytest.skip("its control group has no real-time share")
        finally:
            os.sched_setscheduler(0, policy, param)
        until(lambda: os.sched_getscheduler(keeper.native_id or 0) == policy)


# --- what the device does by itself


def test_what_it_does_by_itself_is_off_meanwhile() -> None:
    with fake_haply() as one:
        with opened(one) as driver:
            found = one.asked()
            assert driver.specification().by_itself == ()
        assert (found["gate"], found["damping"]) == (0.0, 0.0)
        assert found["enabled"] == {"gravity_compensation": False, "torque_scaling": False}
        assert one.asked()["enabled"] == {"gravity_compensation": True, "torque_scaling": True}


@pytest.mark.parametrize(
    ("given", "parameters", "said"),
    [
        ({"refuses": ["torque_scaling"]}, {}, "scales the torques of its joints (torque_scaling: enabled is True; swi"),
        ({"filters": False}, {}, "lets a gate weaken forces that oscillate (force_gate: gain is 0.3)"),
        ({}, {"leave": ["gravity_compensation"]}, "compensates gravity by forces of its own (gravity_compensation: en"),
        ({"tells_config": False}, {}, "its service does not tell"),
    ],
)
def test_what_is_not_off_is_stated(given: dict[str, Any], parameters: dict[str, Any], said: str) -> None:
    with fake_haply(**given) as one, opened(one, **parameters) as driver:
        by_itself = driver.specification().by_itself
    assert said in by_itself[0]
    assert len(by_itself) == (4 if given.get("tells_config") is False else 1)


def test_a_gate_that_stays_on_is_seen_in_the_forces() -> None:
    with fake_haply(filters=False, damping=5.0) as one, opened(one) as driver:
        loop = Loop(driver)
        until(lambda: loop.turn([2.0, 0.0, 0.0]) != [] and driver.figures()["other_forces"] > 0.0)
        assert driver.figures()["other_most"] == pytest.approx(0.6)
        until(lambda: driver.exerted() == pytest.approx((1.4, 0.0, 0.0)))


# --- which device


def test_one_of_two_devices_is_chosen_by_its_id() -> None:
    with fake_haply(devices=["049D", "04BA"], damping=5.0) as one:
        with pytest.raises(HaplyError, match=r"found the devices 049D, 04BA; expected one: .*device_id"):
            HaplyInverse3(PORTS, 1e-3, {"port": one.port})
        with opened(one, device_id="04BA") as second, opened(one, device_id="049D") as first:
            loop = Loop(second)
            until(lambda: loop.turn([0.5, 0.0, 0.0])[0] > 1e-3)
            assert abs(Loop(first).turn()[0]) < 1e-4
            assert one.asked("049D")["most"] == 0.0
            Loop(first).turn()
            with pytest.raises(HaplyError, match="049D: found it in use by another program"):
                HaplyInverse3(PORTS, 1e-3, {"port": one.port, "device_id": "049D"})
        with pytest.raises(HaplyError, match="expected 04CC"):
            HaplyInverse3(PORTS, 1e-3, {"port": one.port, "device_id": "04CC"})


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"devices": []}, "found the devices none; expected one: plug it in"),
        ({"in_use": True}, "found it in use by another program"),
        ({"first_frame": False}, "found no frame within 0.3 s"),
        ({"version": "3.0.7"}, "update the Haply Hub"),
    ],
)
def test_a_service_that_is_of_no_use_is_refused(
    given: dict[str, Any], said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("manyhands.devices.haply.driver.PATIENCE", 0.3 if "first_frame" in given else 2.0)
    with fake_haply(**given) as one, pytest.raises(HaplyError, match=said):
        HaplyInverse3(PORTS, 1e-3, {"port": one.port})


def test_no_service_is_named() -> None:
    with socket.socket() as taken:
        taken.bind(("localhost", 0))  # nobody listens
        with pytest.raises(HaplyError, match=r"found no service \(Connection refused\)"):
            HaplyInverse3(PORTS, 1e-3, {"port": taken.getsockname()[1]})


def test_without_its_library_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "websockets", None)
    with fake_haply() as one, pytest.raises(MissingExtra, match=r"expected the extra haply: pip install"):
        HaplyInverse3(PORTS, 1e-3, {"port": one.port})


def test_without_events_the_device_is_used() -> None:
    with fake_haply() as one, socket.socket() as taken:
        taken.bind(("localhost", 0))
        with opened(one, events=taken.getsockname()[1]) as driver:
            Loop(driver).turn()


# --- what fails, by name


def failing(driver: HaplyInverse3) -> str:
    """What the driver says once it fails."""
    said: list[str] = []
    loop = Loop(driver)

    def fails() -> bool:
        try:
            loop.turn([0.1, 0.0, 0.0])
        except HaplyError as error:
            said.append(str(error))
        return bool(said)

    until(fails)
    return said[0]


@pytest.mark.parametrize(
    ("order", "said"),
    [
        ("ebrake", "its emergency brake on; expected it free: release the brake"),
        ("gone", "found it disconnected"),
        ("lose", "found a frame without it"),
        ("status ready 0", "found it not ready"),
        ("status calibrated 0", "found it not calibrated"),
        ("status power_supply 0", "found it without power"),
        ("mm", "positions may be in another unit since an update"),
        ("close", "expected an open connection"),
        ("stall 4000", "found no answer for"),
    ],
)
def test_a_device_that_is_of_no_use_any_more_is_named(order: str, said: str) -> None:
    with fake_haply(damping=5.0) as one, opened(one, silence=0.4) as driver:
        Loop(driver).turn()
        one.order(order)
        text = failing(driver)
    assert said in text
    assert f"ws://localhost:{one.port}" in text


def test_a_service_that_is_killed_is_named_and_closing_the_driver_is_quiet() -> None:
    with fake_haply() as one:
        with opened(one) as driver:
            one.kill()
            assert f"ws://localhost:{one.port}" in failing(driver)
        one.start()
        with opened(one) as driver:
            assert len(Loop(driver).turn()) == 3


def test_a_brake_that_is_released_lets_the_device_be_used() -> None:
    with fake_haply() as one, opened(one) as driver:
        one.order("ebrake")
        failing(driver)
        one.order("free")
        loop = Loop(driver)

        def works() -> bool:
            try:
                return len(loop.turn()) == 3
            except HaplyError:
                return False

        until(works)
        assert driver.figures()["safety_events"] == 2.0


def test_what_is_said_beside_the_answers_is_counted() -> None:
    with fake_haply() as one, opened(one) as driver:
        loop = Loop(driver)
        loop.turn()
        one.order("rate")
        until(lambda: loop.turn() != [] and driver.figures()["rate_warnings"] == 1.0)
        one.order("ping")
        until(lambda: one.asked()["idle"])  # nothing is on its way any more
        one.order("unasked")
        until(lambda: driver.exerted() is not None and driver.figures()["unasked_frames"] == 1.0)
        for _ in range(20):
            loop.turn()


def test_closing_it_leaves_no_force_and_no_thread() -> None:
    with fake_haply(idle=10.0, damping=5.0) as one:
        with opened(one) as driver:
            Loop(driver).turn([1.0, 0.0, 0.0], 10_000 * MS)
            until(lambda: one.asked()["most"] > 0.5)
            assert "haply" in [thread.name for thread in threading.enumerate()]
        assert "haply" not in [thread.name for thread in threading.enumerate()]
        until(lambda: one.asked()["f"] == [0.0, 0.0, 0.0])
        driver.close()


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ({"ports": 3}, "parameters: found 'ports'"),
        ({"port": "10001"}, "port: found '10001'"),
        ({"events": 0}, "events: found 0"),
        ({"device_id": 490}, "device_id: found 490; expected the id as text, in quotes"),
        ({"force": -1}, "force: found -1"),
        ({"silence": None}, "silence: found None"),
        ({"sample_age": True}, "sample_age: found True"),
        ({"force_held": "yes"}, "force_held: found 'yes'"),
        ({"leave": ["damping"]}, "leave: found"),
        ({"leave": "torque_scaling"}, "leave: found"),
        ({"origin": [0, 0]}, "origin: found"),
    ],
)
def test_parameters_that_are_none_are_refused(parameters: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        HaplyInverse3(PORTS, 1e-3, parameters)


def test_it_has_three_axes() -> None:
    with pytest.raises(ValueError, match="dof: found 2; expected 3"):
        HaplyInverse3(PORTS[:2], 1e-3, {})


def test_the_buttons_of_a_verse_grip_come_with_the_frames() -> None:
    with fake_haply(pressed="") as one, opened(one) as driver:
        loop = Loop(driver)
        loop.turn()
        assert driver.specification().buttons == ("a", "b", "c")
        assert driver.buttons() == 0
        one.order("pressed ac")
        until(lambda: loop.turn() and driver.buttons() == 0b101)
        one.order("pressed")
        until(lambda: loop.turn() and driver.buttons() == 0)


def test_the_orientation_of_a_verse_grip_comes_with_the_frames() -> None:
    """A frame without it, or with none that is one, leaves the one before, and is counted."""
    with fake_haply(turned=[1.0, 0.0, 0.0, 0.0]) as one, opened(one, turning=20) as driver:
        loop = Loop(driver)
        loop.turn()
        of = driver.specification().orientation
        assert of is not None
        assert (of.speed, of.felt) == (20.0, False)
        assert [*driver.orientation()] == [1.0, 0.0, 0.0, 0.0]
        one.order("turned 0.6 0.0 0.8 0.0")
        until(lambda: loop.turn() and [*driver.orientation()] == [0.6, 0.0, 0.8, 0.0])
        for lost in ("turned", "turned 0.6 0.0 0.9 0.0", "turned nan 0 0 0"):
            before = driver.figures()["grip_missing"]
            one.order(lost)
            until(lambda before=before: loop.turn() and driver.figures()["grip_missing"] > before + 3.0)
            assert [*driver.orientation()] == [0.6, 0.0, 0.8, 0.0]


@pytest.mark.parametrize(("given", "parameters"), [({"pressed": ""}, {}), ({"turned": [1, 0, 0, 0]}, {"grip": "7"})])
def test_without_its_verse_grip_it_states_no_orientation(given: dict[str, Any], parameters: dict[str, Any]) -> None:
    with fake_haply(**given) as one, opened(one, **parameters) as driver:
        assert driver.specification().orientation is None
        assert driver.figures()["grip_missing"] == 0.0


def test_a_session_senses_it_beside_torques_that_joints_hold() -> None:
    """No torque acts on the grip, so nothing is to be proved of these together (decision 54)."""
    pytest.importorskip("mujoco")
    with fake_haply(turned=[0.6, 0.0, 0.8, 0.0]) as one:
        data = told({"sensed": True, "stiffness": 0.3}, driver="haply-inverse3")
        data["devices"]["pen"] |= {
            "parameters": {"port": one.port, "events": one.events, "sample_age": 5e-4, "actuation_delay": 4e-4, **SLOW},
            "sample_age": 5e-4, "actuation_delay": 4e-4, "held": "torque", "linkage": {"kappa": 0.01},
            "limits": {"force": 4, "displacement": 0.15, "speed": 1},
        }  # fmt: skip
        del data["devices"]["pen"]["mass"]
        bundle = cut(prepare(Session.from_dict(data), None), RunPlan(REALTIME, None, ""))["pen"]
        assert isinstance(bundle, DeviceBundle)
        with closing(driver_of(bundle)) as driver:
            tick = tick_of(bundle, driver)
            tick.sample(0, Instant(0))
            assert tick.rides == [0.6, 0.0, 0.8, 0.0, 0.0, 1.0]
            tick.release(Instant(MS))
        one.order("turned")
        with pytest.raises(FactoryError, match="which states no orientation"):
            driver_of(bundle)
