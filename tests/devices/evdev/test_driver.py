"""The driver on a fake wheel, whose time mostly stands still but for the test: so every instant is exact."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest

from manyhands.devices.evdev import EvdevWheel, WheelError
from manyhands.devices.evdev import event_device as ev
from manyhands.devices.evdev.bus import KNOWN, PIDFF, UNKNOWN, KernelDriver, UsbWay
from manyhands.protocol.clock import Instant, from_seconds

from ...fakes.wheel import FakeCalls, FakeWheel, Turn, fake_wheel

T = 0.012
STEP = 15.0 / 65535
KINDS = {
    "memless": KNOWN["hid_logitech"],
    "lg4ff": KNOWN["hid_logitech_new"],
    "pid": PIDFF,
    "tmff2": KNOWN["hid_tmff_new"],
}


@pytest.fixture(autouse=True)
def four_ms(monkeypatch: pytest.MonkeyPatch) -> None:
    """The fake's kernel counts in ticks of 4 ms, whatever this one does."""
    monkeypatch.setattr("manyhands.devices.evdev.driver.tick", lambda: 0.004)


@contextmanager
def opened(one: FakeWheel, way: UsbWay | None = None, axes: int = 1, **parameters: Any) -> Iterator[EvdevWheel]:
    given = {"device": one.path, "range": 15.0, "most": 2.0, **parameters}
    bus = way or UsbWay(PIDFF, 0.001, 0.001)
    with closing(EvdevWheel(tuple(f"w.{i}" for i in range(axes)), T, given, FakeCalls(), bus)) as driver:
        yield driver


def at(seconds: float) -> Instant:
    return Instant(from_seconds(seconds))


def waited(one: FakeWheel, true: Callable[[float], bool], most: float) -> float:
    """How long it takes until the torque of the first axis is so, s; in steps of 0.1 ms."""
    for step in range(1, round(1e4 * most) + 3):
        one.advance(1e-4)
        if true(one.asked()[1][0]):
            return 1e-4 * step
    raise AssertionError(f"not in {most} s")


# --- what it states


def test_a_wheel_states_what_the_session_and_the_bus_say() -> None:
    with fake_wheel(kind="pid") as one, opened(one, mass=0.02) as driver:
        stated = driver.specification()
        assert stated.mass == (0.02,)
        assert (stated.force, stated.displacement, stated.axes) == ((2.0,), (7.5,), ("wheel",))
        assert stated.step == pytest.approx((STEP,))
        assert (stated.timing.sample_age, stated.timing.actuation_delay) == (0.002, 0.004)
        assert stated.hardware
        assert not stated.holds_torque
        assert len(stated.by_itself) == 2
        counts = one.asked()[2]
    assert (counts["auto"], counts["gain"], counts["fuzz"], counts["grabbed"]) == (0, 0xFFFF, 0, 1)


def test_what_cannot_be_switched_off_is_said() -> None:
    with fake_wheel() as one:
        one.order(f"without {ev.FF_AUTOCENTER}")
        one.order(f"without {ev.FF_GAIN}")
        with opened(one, UsbWay(KNOWN["hid_logitech"], 0.001, 0.001)) as driver:
            said = " ".join(driver.specification().by_itself)
            assert one.asked()[2]["auto"] == 0xFFFF  # of the fake, which has no code to switch it off
    assert "no FF_AUTOCENTER" in said
    assert "no FF_GAIN" in said
    assert "rounds a force to 1/127" in said


def test_leaving_gives_the_filter_back_and_no_effect_stays() -> None:
    with fake_wheel() as one:
        with opened(one) as driver:
            driver.apply([1.0], at(0.0), at(5.0))
        while (counts := one.asked()[2])["grabbed"]:
            pass  # the fake hears of the end of a connection in its own turn
        assert (counts["fuzz"], counts["playing"]) == (255, 0)
        driver.close()  # a second call does nothing


@pytest.mark.parametrize(
    ("driver", "update", "delay"),
    [
        (KINDS["memless"], "replay", 0.004 + 0.002),
        (KINDS["lg4ff"], "replay", 0.002 + 0.002),
        (KINDS["lg4ff"], "restart", 0.002 + 0.003),
        (PIDFF, "replay", 0.004),
        (KINDS["tmff2"], "replay", 0.008 + 0.004 + 0.003),
        (UNKNOWN, "replay", 0.008 + 0.004 + 0.004),
    ],
)
def test_the_delay_is_that_of_the_kernel_driver_and_of_its_reports(
    driver: KernelDriver, update: str, delay: float
) -> None:
    with fake_wheel() as one, opened(one, UsbWay(driver, 0.001, 0.001), update=update) as wheel:
        assert wheel.specification().timing.actuation_delay == pytest.approx(delay)


# --- what it does


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("update", ["replay", "restart"])
def test_forces_act_and_end_within_the_stated_times(kind: str, update: str) -> None:
    """At every phase of the kernel's ticks, timers and frames: from apply to the torque, and from until to its end."""
    turn = Turn(m=1e6)  # nothing moves it, so that nothing else changes
    with fake_wheel(turn, kind=kind) as one, opened(one, UsbWay(KINDS[kind], 0.001, 0.001), update=update) as driver:
        delay = driver.specification().timing.actuation_delay
        one.order("manual")
        slowest = 0.0
        for phase in range(9):
            one.advance(0.1 + 0.00135 * phase)
            assert one.asked()[1] == [0.0]
            driver.apply([1.0], at(0.0), at(0.042))
            acted = waited(one, lambda f: f > 0.9, delay)
            one.advance(0.03 - acted)
            assert one.asked()[1][0] > 0.9
            ended = 0.03 + waited(one, lambda f: f == 0.0, 0.012 + delay)
            assert acted <= delay + 1e-4
            assert ended <= 0.042 + delay + 1e-4
            slowest = max(slowest, acted)
        assert slowest > delay / 4  # the stated delay is no fancy either


@pytest.mark.parametrize("kind", KINDS)
def test_a_force_that_is_renewed_never_drops_out_and_follows(kind: str) -> None:
    with fake_wheel(Turn(m=1e6), kind=kind) as one, opened(one, UsbWay(KINDS[kind], 0.001, 0.001)) as driver:
        one.order("manual")
        found = []
        for turn in range(40):
            level = 1.0 if turn < 20 else -0.5
            driver.apply([level], at(turn * T), at(turn * T + 0.042 + 0.001 * (turn % 3)))
            for _ in range(12):
                one.advance(0.001)
                found.append(one.asked()[1][0])
    for start, level in ((24, 1.0), (20 * 12 + 24, -0.5)):
        steady = found[start : start + 18 * 12 - 24]
        assert min(steady) == pytest.approx(level, abs=0.02)
        assert max(steady) == pytest.approx(level, abs=0.02)


def test_samples_are_no_older_than_stated() -> None:
    """A wheel that its motor speeds up, read at every phase of the frames."""
    with fake_wheel(Turn(b=0.2), in_us=2000) as one, opened(one, UsbWay(KINDS["lg4ff"], 0.002, 0.001)) as driver:
        age = driver.specification().timing.sample_age
        assert age == pytest.approx(0.004)
        one.order("manual")
        driver.apply([1.0], at(0.0), at(30.0))
        true, oldest = [], 0.0
        for tick in range(1500):
            one.advance(1e-4)
            true.append(one.asked()[0][0])
            if tick > 200 and tick % 7 == 0:
                x = driver.sample(tick, at(0.0))[0]
                since = next(n for n in range(len(true)) if true[-1 - n] <= x + STEP / 2)
                oldest = max(oldest, 1e-4 * since)
        assert 0.002 < oldest <= age + 1e-4
        figures = driver.figures()
        assert figures["longest_gap_ms"] == pytest.approx(2.0, abs=0.06)
        assert figures["older_than_stated"] == 0.0


def test_reports_that_come_later_than_stated_are_counted() -> None:
    with fake_wheel(in_us=8000) as one, opened(one, UsbWay(KINDS["lg4ff"], 0.001, 0.001)) as driver:
        one.order("manual")
        driver.apply([1.0], at(0.0), at(30.0))
        for tick in range(40):
            one.advance(0.008)
            driver.sample(tick, at(0.0))
        figures = driver.figures()
        assert figures["longest_gap_ms"] == pytest.approx(8.0, abs=0.06)
        assert figures["older_than_stated"] > 10.0


def test_a_length_is_whole_ticks_and_changes_seldom() -> None:
    with fake_wheel() as one, opened(one) as driver:
        lengths = [
            driver._length(from_seconds(lives)) for lives in (-0.01, 0.0039, 0.004, 0.0235, 0.026, 0.019, 0.05, 100.0)
        ]
    assert lengths == [0, 0, 4, 20, 20, 16, 48, 32767]


@pytest.mark.parametrize("end", [0.0235, 0.02, 0.01])
def test_a_force_that_may_not_last_a_tick_is_none(end: float) -> None:
    """Nor is one whose end is over, as where a machine was late."""
    with fake_wheel(Turn(m=1e6)) as one, opened(one) as driver:
        one.order("manual")
        driver.apply([1.0], at(0.0), at(0.05))
        one.advance(0.02)
        assert one.asked()[1][0] == pytest.approx(1.0, abs=0.02)
        driver.apply([1.0], at(0.02), at(end))
        one.advance(0.01)
        assert one.asked()[1] == [0.0]


def test_a_force_without_an_end_has_one() -> None:
    with fake_wheel(Turn(m=1e6)) as one, opened(one) as driver:
        one.order("manual")
        driver.apply([1.0], at(0.0))
        one.advance(0.02)
        assert one.asked()[1][0] == pytest.approx(1.0, abs=0.02)
        one.advance(0.05)
        assert one.asked()[1] == [0.0]


def test_forces_are_clipped_at_the_greatest() -> None:
    with fake_wheel(Turn(m=1e6)) as one, opened(one) as driver:
        one.order("manual")
        for f, expected in ((7.0, 2.0), (-7.0, -2.0)):
            driver.apply([f], at(0.0), at(1.0))
            one.advance(0.02)
            assert one.asked()[1][0] == pytest.approx(expected, abs=0.02)


def test_a_joystick_has_an_effect_for_each_axis() -> None:
    stick = Turn(m=0.001, b=0.02, range=0.7, most=0.5)
    with fake_wheel(stick, stick, kind="pid") as one, opened(one, axes=2, range=[0.7, 0.7], most=0.5) as driver:
        stated = driver.specification()
        assert (stated.axes, stated.force, stated.displacement) == (("x", "y"), (0.5, 0.5), (0.35, 0.35))
        one.order("manual")
        driver.sample(0, at(0.0))
        driver.apply([0.2, -0.1], at(0.0), at(1.0))
        one.advance(0.04)
        x, f, counts = one.asked()
        assert f == pytest.approx([0.2, -0.1], abs=0.001)
        assert counts["playing"] == 2
        assert driver.sample(1, at(0.0)) == pytest.approx(x, abs=0.01)  # 2 ms at 4 rad/s
        assert x[0] > 0.0 > x[1]
        driver.release(at(0.04))
        one.advance(0.02)
        assert one.asked()[1] == [0.0, 0.0]


def test_a_mirrored_device_is_turned_round() -> None:
    with fake_wheel(Turn(m=1e6)) as one:
        one.order("mirror")
        one.order("manual")
        with opened(one, reverse=True) as driver:
            driver.apply([1.0], at(0.0), at(1.0))
            one.advance(0.02)
            assert one.asked()[1][0] == pytest.approx(1.0, abs=0.02)


def test_a_kernel_driver_that_takes_a_level_from_rest_alone_is_restarted() -> None:
    """logitech-trueforce-linux-driver#11: the default leaves the old force, and restart does not."""
    for update, expected in (("replay", 1.0), ("restart", -0.5)):
        with fake_wheel(Turn(m=1e6)) as one, opened(one, update=update) as driver:
            one.order("frozen")
            one.order("manual")
            for f in (1.0, -0.5):
                driver.apply([f], at(0.0), at(1.0))
                one.advance(0.02)
            assert one.asked()[1][0] == pytest.approx(expected, abs=0.02)


def test_lost_events_are_asked_for() -> None:
    """A queue that has overflown keeps one event, and says so."""
    with fake_wheel(Turn(b=0.02)) as one, opened(one) as driver:
        one.order("manual")
        driver.apply([1.0], at(0.0), at(30.0))
        one.advance(0.3)
        x = driver.sample(0, at(0.0))[0]
        assert driver.figures()["dropped_reports"] >= 1.0
        assert x == pytest.approx(one.asked()[0][0], abs=0.05)


# --- what fails, by name


@pytest.mark.parametrize(
    ("order", "said"),
    [
        ("deny 1", "found no permission to open it; manyhands devices prints the rule of udev"),
        ("busy 1", "found another program that has grabbed it"),
        ("full 1", "found no room for 1 effects"),
        (f"without {ev.FF_CONSTANT}", "found vibration alone; expected constant forces"),
        (f"without {ev.EV_FF}", "found no force feedback; expected constant forces"),
        ("unplug", "found no such device; plug it in"),
    ],
)
def test_a_device_that_is_of_no_use_is_refused(order: str, said: str) -> None:
    with fake_wheel() as one:
        one.order(order)
        with pytest.raises(WheelError, match=said) as caught, opened(one):
            pass
        assert one.path in str(caught.value)
        while one.asked()[2]["grabbed"]:
            pass  # until the fake hears that the driver has closed it


def test_an_axis_that_is_not_there_is_named() -> None:
    with (
        fake_wheel() as one,
        pytest.raises(WheelError, match="found no absolute axis 1; expected 2"),
        opened(one, axes=2),
    ):
        pass


def test_a_file_that_is_no_event_device_is_refused() -> None:
    given = {"device": "/dev/null", "range": 15.0, "most": 2.0}
    with pytest.raises(WheelError, match=r"/dev/null: found Inappropriate ioctl .*expected an event device"):
        EvdevWheel(("w.0",), T, given, way=UsbWay(PIDFF, 0.001, 0.001))


def test_an_unplugged_wheel_is_named_and_comes_back() -> None:
    with fake_wheel() as one:
        with opened(one) as driver:
            driver.apply([1.0], at(0.0), at(1.0))
            one.order("unplug")
            one.asked()
            for call in (
                lambda: driver.sample(0, at(0.0)),
                lambda: driver.apply([1.0], at(0.0), at(1.0)),
                lambda: driver.release(at(0.0)),
            ):
                with pytest.raises(WheelError, match="found it unplugged; expected a device that obeys"):
                    call()
        one.order("plug")
        with opened(one) as driver:
            assert len(driver.sample(0, at(0.0))) == 1


def test_forces_that_a_stalled_bus_delivers_late_are_over_for_a_kernel_that_counts() -> None:
    with fake_wheel(Turn(m=1e6), kind="lg4ff") as one, opened(one, UsbWay(KINDS["lg4ff"], 0.001, 0.001)) as driver:
        one.order("manual")
        one.order("stall 200")
        driver.apply([1.0], at(0.0), at(0.042))
        one.advance(0.3)
        assert one.asked()[1] == [0.0]


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ({"device": ""}, "device: found none"),
        ({"device": 7}, "device: found none"),
        ({"colour": 1}, "parameters: found 'colour'"),
        ({"range": None}, "range: found None"),
        ({"range": [1.0, 2.0]}, r"range: found \[1.0, 2.0\].*each of 1 axes"),
        ({"most": -1.0}, "most: found -1.0"),
        ({"most": True}, "most: found True"),
        ({"mass": 0}, "mass: found 0; expected inertia"),
        ({"update": "play"}, "update: found 'play'; expected one of replay, restart"),
        ({"reverse": 1}, "reverse: found 1"),
        ({"sample_age": 0}, "sample_age: found 0"),
        ({"actuation_delay": "soon"}, "actuation_delay: found 'soon'"),
    ],
)
def test_parameters_that_are_none_are_refused(parameters: dict[str, Any], said: str) -> None:
    given = {"device": "/dev/null", "range": 15.0, "most": 2.0, **parameters}
    with pytest.raises(ValueError, match=said):
        EvdevWheel(("w.0",), T, given, way=UsbWay(PIDFF, 0.001, 0.001))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"sample_age": 0.0005}, "sample_age: found 0.0005 s; expected 0.001 s or more, by its bus alone"),
        ({"actuation_delay": 0.002}, "actuation_delay: found 0.002 s; expected 0.003 s or more"),
    ],
)
def test_times_that_the_bus_alone_exceeds_are_refused(given: dict[str, Any], said: str) -> None:
    with fake_wheel() as one, pytest.raises(ValueError, match=said), opened(one, **given):
        pass


def test_a_device_that_is_away_is_named_before_anything_is_said_of_its_bus() -> None:
    with pytest.raises(WheelError, match="no-such-wheel: found no such device"):
        EvdevWheel(("w.0",), T, {"device": "/dev/input/no-such-wheel", "range": 15.0, "most": 2.0})


def test_times_are_needed_where_no_bus_tells_them() -> None:
    with fake_wheel() as one:
        with pytest.raises(ValueError, match=r"no USB endpoint of .* in /sys"), opened(one, UsbWay()):
            pass
        with opened(one, UsbWay(), sample_age=0.003, actuation_delay=0.005) as driver:
            timing = driver.specification().timing
    assert (timing.sample_age, timing.actuation_delay) == (0.003, 0.005)


def test_a_period_in_which_the_bus_cannot_take_the_reports_is_refused() -> None:
    """4 ms a report, three of them in 12 ms: as many as leave. A restart is one too many."""
    way = UsbWay(PIDFF, 0.001, 0.004)
    with fake_wheel(kind="pid", out_us=4000) as one:
        with opened(one, way) as driver:
            assert driver.specification().timing.actuation_delay == pytest.approx(0.016)
        with (
            pytest.raises(ValueError, match="found a period of 12 ms; expected 16 ms or more"),
            opened(one, way, update="restart"),
        ):
            pass


def test_without_that_refusal_forces_would_queue_up() -> None:
    """What the fake shows of a bus that takes one report in 8 ms, of three in 12."""
    with fake_wheel(Turn(m=1e6), kind="pid", out_us=8000) as one, opened(one) as driver:
        one.order("manual")
        for turn in range(40):
            driver.apply([0.01 * turn], at(0.0), at(0.042))
            one.advance(T)
        assert one.asked()[2]["queued"] > 15


def test_a_range_that_differs_from_the_kernel_drivers_is_refused() -> None:
    with fake_wheel() as one:
        with (
            pytest.raises(ValueError, match=r"range: found 15 rad; expected 15.708 rad \(900°\)"),
            opened(one, UsbWay(PIDFF, 0.001, 0.001, 15.708)),
        ):
            pass
        with opened(one, UsbWay(PIDFF, 0.001, 0.001, 15.708), range=15.7):
            pass


def test_a_range_that_is_changed_meanwhile_ends_it_by_name(tmp_path: Path) -> None:
    """A wheel that stands in its middle then does not jump: its positions alone would not show it."""
    file = tmp_path / "range"
    file.write_text("900\n")
    way = UsbWay(PIDFF, 0.001, 0.001, 15.708, file)
    with fake_wheel() as one, opened(one, way, range=15.7) as driver:
        driver.idle(at(1.0))
        file.write_text("270\n")
        driver.idle(at(1.4))  # it was asked lately
        with pytest.raises(
            WheelError, match=r"found its range set to 4.7124 rad \(270°\); expected 15.7 rad.*set it back"
        ):
            driver.idle(at(1.5))
