"""Both drivers of a motor axis on their fakes: processes of their own behind pseudo-terminals, in real time.

Nothing here judges how fast the machine is: what is awaited comes in the end, or the test fails by its own time-out.
"""

from __future__ import annotations

import math
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing, contextmanager
from typing import Any

import pytest

from manyhands.devices.moteus import Moteus
from manyhands.devices.motor_axis import MotorAxis, MotorError, Questions
from manyhands.devices.odrive import ODrive
from manyhands.devices.serial_port import PortError
from manyhands.launch.conformance.driver import Bench, Push, check_driver
from manyhands.launch.conformance.judgement import Conformance
from manyhands.nodes.device.plugin import PluginDriver
from manyhands.nodes.device.specification import TIMES, AxisMap
from manyhands.protocol.clock import Instant, RealtimeClock, from_seconds

from ..fakes.moteus import fake_moteus
from ..fakes.odrive import fake_odrive
from ..fakes.rotor import FakeMotor, Rotor

MS = 1_000_000
PATIENCE = 20.0
"""s, in which a test waits for a controller before it fails."""

Fake = Callable[..., AbstractContextManager[FakeMotor]]
Kind = tuple[type[MotorAxis], Fake]
KINDS: dict[str, Kind] = {"moteus": (Moteus, fake_moteus), "odrive": (ODrive, fake_odrive)}

SLOW = {"silence": 0.9, "torque": 0.5}
"""A machine that is busy with other tests may give the fake no turn for a while."""


@pytest.fixture(params=KINDS)
def kind(request: pytest.FixtureRequest) -> Kind:
    return KINDS[request.param]


@contextmanager
def opened(of: type[MotorAxis], one: FakeMotor, period: float = 0.01, **parameters: Any) -> Iterator[MotorAxis]:
    with closing(of(("knob.0",), period, {"port": one.path, **SLOW, **parameters})) as driver:
        yield driver


def until(true: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE
    while not true():
        assert time.monotonic() < end, "it never came"
        time.sleep(1e-3)


def turned(driver: MotorAxis, torque: float, lives: int = 50) -> float:
    """One tick of a loop: the angle, rad."""
    x = driver.sample(0, Instant(0))[0]
    driver.apply([torque], Instant(0), Instant(lives * MS))
    driver.exerted()
    driver.idle(Instant(0))
    return x


def failing(driver: MotorAxis) -> str:
    """What the driver says once it fails."""
    said: list[str] = []

    def fails() -> bool:
        try:
            turned(driver, 0.01)
        except (MotorError, PortError) as error:
            said.append(str(error))
        return bool(said)

    until(fails)
    return said[0]


def test_what_is_stated(kind: Kind) -> None:
    of, fake = kind
    with fake() as one, opened(of, one, torque=0.4, range=2.0, speed=30.0, inertia=2e-4, counts=4096) as driver:
        stated = driver.specification()
    assert stated.axes == ("rz",)
    assert (stated.force, stated.displacement, stated.speed) == ((0.4,), (2.0,), (30.0,))
    assert (stated.mass, stated.holds_torque, stated.hardware) == ((2e-4,), False, True)
    assert stated.step is not None
    assert stated.step[0] == pytest.approx(2.0 * math.pi / 4096)
    timing = stated.timing
    assert {*stated.measured} == {*TIMES}
    assert timing.sample_age + timing.actuation_delay > 4e-4  # twice the fake's latency, less a shortest trip
    assert any("watchdog" in one for one in stated.by_itself)
    assert any("tracking loop" in one for one in stated.by_itself)
    assert not any("cogging" in one for one in stated.by_itself)


def test_given_times_are_stated_as_they_are(kind: Kind) -> None:
    of, fake = kind
    with fake() as one, opened(of, one, sample_age=0.004, actuation_delay=0.001) as driver:
        timing = driver.specification().timing
        assert driver.specification().measured == ("age_jitter",)
    assert (timing.sample_age, timing.actuation_delay) == (0.004, 0.001)
    assert timing.jitter <= 0.004


def test_a_torque_turns_the_motor_the_right_way_and_ends(kind: Kind) -> None:
    of, fake = kind
    with fake() as one, opened(of, one) as driver:
        turned(driver, 0.0)
        until(lambda: turned(driver, 0.02) > 0.05)
        assert one.asked()["torque"] in (pytest.approx(0.02), 0.0)
        turning = [turned(driver, -0.02)]
        until(lambda: bool(turning.append(turned(driver, -0.02)) or turning[-1] < turning[-2]))
        driver.release(Instant(0))
        until(lambda: one.asked()["torque"] == 0.0)


def test_an_angle_is_in_rad(kind: Kind) -> None:
    of, fake = kind
    with fake() as one, opened(of, one, zero=0.25) as driver:
        until(lambda: (turned(driver, 0.02), one.asked()["angle"])[1] > 1.0)
        driver.release(Instant(0))
        until(lambda: abs(driver.sample(0, Instant(0))[0] + 0.25 - one.asked()["angle"]) < 1e-3)


def test_no_torque_is_greater_than_the_session_gave(kind: Kind) -> None:
    of, fake = kind
    with fake() as one, opened(of, one, torque=0.03) as driver:
        until(lambda: (turned(driver, 5.0), one.asked()["torque"])[1] == pytest.approx(0.03))
        until(lambda: (turned(driver, -5.0), one.asked()["torque"])[1] == pytest.approx(-0.03))


def test_a_torque_ends_by_itself_and_the_axis_comes_back(kind: Kind) -> None:
    """The watchdog disarms the axis; the driver notices, says that nothing is exerted, and arms it again."""
    of, fake = kind
    with fake() as one, opened(of, one) as driver:
        until(lambda: (turned(driver, 0.02), one.asked()["torque"])[1] == pytest.approx(0.02))
        assert one.asked()["lives"] == pytest.approx(0.05)
        expired, trips = one.asked()["expired"], driver.figures()["watchdog_trips"]
        until(lambda: one.asked()["expired"] > expired)
        assert one.asked()["torque"] == 0.0
        disarmed = []

        def again() -> bool:
            turned(driver, 0.02, lives=100)
            disarmed.append(driver.exerted())
            return one.asked()["torque"] == pytest.approx(0.02)

        until(again)
        assert (0.0,) in disarmed  # what is claimed while nothing is exerted
        until(lambda: (turned(driver, 0.02, lives=100), driver.exerted())[1] is None)
        assert driver.figures()["watchdog_trips"] > trips


def test_an_axis_that_is_said_to_exert_nothing_exerts_nothing(kind: Kind) -> None:
    """Also while it is armed again, which takes its time: a torque that was sent before would act by itself then."""
    of, fake = kind
    with fake() as one, opened(of, one) as driver:
        until(lambda: (turned(driver, 0.02), one.asked()["torque"])[1] == pytest.approx(0.02))
        expired, claims = one.asked()["expired"], 0
        until(lambda: one.asked()["expired"] > expired)
        while claims == 0 or driver.exerted() is not None:
            driver.sample(0, Instant(0))
            driver.apply([0.02], Instant(0), Instant(100 * MS))
            claimed = driver.exerted()
            time.sleep(0.02)
            if claimed is not None:
                claims += 1
                assert one.asked()["torque"] == 0.0
            driver.idle(Instant(0))


def test_an_axis_comes_back_where_all_torques_are_short(kind: Kind) -> None:
    """A reserve for lateness ends torques early: the axis is fed for long until it is known to be armed."""
    of, fake = kind
    with fake() as one, opened(of, one) as driver:
        until(lambda: (turned(driver, 0.02), one.asked()["torque"])[1] == pytest.approx(0.02))
        expired, disarmed = one.asked()["expired"], []

        def again() -> bool:
            turned(driver, 0.02, lives=1)
            time.sleep(0.005)
            disarmed.append(driver.exerted() is not None)
            return disarmed[-2:] == [True, False]

        until(again)
        assert one.asked()["expired"] > expired


def test_a_pause_while_an_axis_is_armed_again_is_no_other_program(kind: Kind) -> None:
    """The process has no turn between the watchdog's end and the torque that arms the axis: nobody else is to blame."""
    of, fake = kind
    with fake() as one, opened(of, one, silence=0.1) as driver:
        until(lambda: (turned(driver, 0.02), one.asked()["torque"])[1] == pytest.approx(0.02))
        expired = one.asked()["expired"]
        until(lambda: one.asked()["expired"] > expired)
        for _ in range(3):
            for _ in range(4):
                driver.sample(0, Instant(0))  # asks, and says that the axis is to be armed, but no torque follows
                time.sleep(0.01)
            time.sleep(0.15)
        until(lambda: (turned(driver, 0.02), one.asked()["torque"])[1] == pytest.approx(0.02))


def test_an_end_that_comes_nearer_is_obeyed(kind: Kind) -> None:
    """The account may end a force sooner: the second call of a tick has the same torque and less time."""
    of, fake = kind
    with fake() as one, opened(of, one) as driver:
        until(lambda: (turned(driver, 0.02, lives=100), one.asked()["torque"])[1] == pytest.approx(0.02))
        expired = one.asked()["expired"]
        driver.apply([0.02], Instant(0), Instant(2 * MS))
        until(lambda: one.asked()["expired"] > expired)
        assert one.asked()["lives"] == pytest.approx(0.002)
        assert one.asked()["torque"] == 0.0
        driver.apply([0.02], Instant(5 * MS), Instant(5 * MS))  # over when it comes
        assert one.asked()["torque"] == 0.0


def test_a_stalled_bus_is_given_no_torques_to_deliver_late(kind: Kind) -> None:
    of, fake = kind
    with fake() as one, opened(of, one) as driver:
        turned(driver, 0.0)
        before, again = driver.figures()["unsent_torques"], [0.0]

        def unsent() -> float:
            if time.monotonic() > again[0]:  # anew, where this process had no turn while it lasted
                one.order("stall 300")
                again[0] = time.monotonic() + 0.6
            turned(driver, 0.02)
            return driver.figures()["unsent_torques"]

        until(lambda: unsent() > before + 3)
        until(lambda: (turned(driver, 0.0), one.asked()["torque"])[1] == 0.0)


@pytest.mark.parametrize(
    ("order", "said"),
    [("mute", "found no answer for"), ("stall 3000", "found no answer for"), ("reset", "has started anew")],
)
def test_a_controller_that_is_of_no_use_any_more_is_named(kind: Kind, order: str, said: str) -> None:
    of, fake = kind
    with fake() as one, opened(of, one) as driver:
        until(lambda: (turned(driver, 0.02, lives=100), driver.exerted())[1] is None)
        one.order(order)
        found = failing(driver)
        assert said in found
        assert one.path in found


def test_an_unplugged_controller_is_named_and_closing_it_is_quiet(kind: Kind) -> None:
    of, fake = kind
    with fake() as one, opened(of, one) as driver:
        one.unplug()
        assert one.path in failing(driver)


def test_closing_takes_the_power_from_the_motor(kind: Kind) -> None:
    """Also where the controller hears of it after the port was closed."""
    of, fake = kind
    stopped = {Moteus: 0, ODrive: 1}[of]
    with fake() as one:
        with opened(of, one) as driver:
            until(lambda: (turned(driver, 0.02), one.asked()["torque"])[1] == pytest.approx(0.02))
            assert one.asked()["told"] not in (0, stopped)
            one.process.send_signal(signal.SIGSTOP)
        one.process.send_signal(signal.SIGCONT)
        until(lambda: one.asked()["told"] == stopped)
        assert one.asked()["torque"] == 0.0
        driver.close()  # a second call does nothing


def test_a_controller_that_was_reset_comes_back(kind: Kind) -> None:
    of, fake = kind
    with fake() as one:
        with opened(of, one) as driver:
            turned(driver, 0.0)
            one.order("reset")
        with opened(of, one) as driver:
            until(lambda: (turned(driver, 0.02), one.asked()["torque"])[1] == pytest.approx(0.02))
        until(lambda: one.asked()["torque"] == 0.0)


def test_lost_and_broken_answers_do_no_harm(kind: Kind) -> None:
    of, fake = kind
    with fake() as one, opened(of, one) as driver:
        turned(driver, 0.0)
        one.order("drop 1")
        one.order("noise")
        until(lambda: (turned(driver, 0.02), driver.figures()["broken_lines"])[1] >= 1)
        before = turned(driver, 0.02)
        until(lambda: turned(driver, 0.02) != before)


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ({"port": ""}, "port: found none"),
        ({"force": 3}, "parameters: found 'force'"),
        ({"torque": None}, "torque: found None; expected a number of N·m greater than 0"),
        ({"torque": 0}, "torque: found 0"),
        ({"range": "far"}, "range: found 'far'"),
        ({"inertia": True}, "inertia: found True"),
        ({"counts": -1}, "counts: found -1"),
        ({"zero": math.inf}, "zero: found inf"),
        ({"silence": 0}, "silence: found 0"),
        ({"sample_age": 2}, "sample_age: found 2; expected a time in s, below 1"),
        ({"baud": "fast"}, "baud: found 'fast'"),
    ],
)
def test_parameters_that_are_none_are_refused(kind: Kind, parameters: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        kind[0](("knob.0",), 0.01, {"port": "/dev/null", "torque": 0.5, **parameters})


def test_two_axes_are_refused(kind: Kind) -> None:
    with pytest.raises(ValueError, match="found a device of 2 axes; expected dof: 1"):
        kind[0](("knob.0", "knob.1"), 0.01, {"port": "/dev/null", "torque": 0.5})


def test_an_answer_ends_older_questions() -> None:
    questions = Questions()
    for tag, at in (("a", 1), ("b", 2), ("c", 3)):
        questions.ask(tag, Instant(at))
    assert (questions.answer("b"), questions.oldest, len(questions)) == (2, 3, 1)
    assert "a" not in questions
    assert questions.answer("a") is None


# --- check-driver's suite, in real time


def judged(of: type[MotorAxis], one: FakeMotor, **parameters: Any) -> dict[str, tuple[Conformance, str]]:
    """The suite's judgement by check, at 100 Hz, and with delays in which a fake has its turn."""
    period = 0.01
    given = {"port": one.path, **SLOW, "sample_age": 0.004, "actuation_delay": 0.002, "inertia": 2e-3, **parameters}
    driver = of(("knob.0",), period, given)
    stated = driver.specification()
    plugged = PluginDriver("fake", driver, AxisMap((0,), (1.0,)), stated, period, stated.timing)
    bench = Bench(plugged, period, RealtimeClock())
    found: dict[str, tuple[Conformance, str]] = {}
    for check in check_driver(bench, stated, Push(force=0.01, travel=1.0)):
        if check.check not in found or check.verdict is Conformance.BROKEN:
            found[check.check] = check.verdict, check.text
    samples = sorted(bench.durations["sample"])
    assert samples[len(samples) // 2] < from_seconds(period) / 2  # the greatest is that of a busy machine
    found.pop("blocking call", None)
    return found


HEAVY = Rotor(J=2e-3, b=1e-3)
"""A push of half a second turns it by half a radian."""


@pytest.mark.long
@pytest.mark.alone  # its calls and samples are judged by the clock
def test_the_suite_finds_the_driver_in_order(kind: Kind) -> None:
    of, fake = kind
    with fake(HEAVY) as one:
        found = judged(of, one)
    assert {check: text for check, (verdict, text) in found.items() if verdict is Conformance.BROKEN} == {}
    for check in ("wrong sign", "no release", "force kept on silence", "exception"):
        assert found[check][0] is Conformance.KEPT, found[check]


@pytest.mark.alone  # likewise
@pytest.mark.parametrize(("name", "scale", "check"), [("moteus", 360.0, "wrong unit"), ("odrive", -1.0, "wrong sign")])
def test_the_suite_finds_a_firmware_that_reports_something_else(name: str, scale: float, check: str) -> None:
    of, fake = KINDS[name]
    with fake(HEAVY) as one:
        one.order(f"scale {scale}")
        found = judged(of, one, range=1e5)
    assert found[check][0] is Conformance.BROKEN
