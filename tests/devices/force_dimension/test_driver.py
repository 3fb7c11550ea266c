"""The driver on the fake library: its devices' time is the test's, so that nothing here depends on the machine."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from manyhands.devices.force_dimension import ForceDimension, ForceDimensionError
from manyhands.devices.force_dimension.__main__ import main
from manyhands.devices.force_dimension.driver import CALM, LONGEST, _Watchdog
from manyhands.devices.force_dimension.library import Kinematics, is_rotation
from manyhands.launch.conformance.driver import Bench, Push, check_driver
from manyhands.launch.conformance.judgement import Conformance, Judgement, broken
from manyhands.nodes.device.plugin import PluginDriver
from manyhands.nodes.device.specification import ROUND, TIMES, AxisMap
from manyhands.protocol.clock import Instant

from ...fakes.dhd import FakeDevices, OwnTime, fake_devices

MS = 1_000_000
PORTS = ("dx.x", "dx.y", "dx.z")
AT = Instant(0)


@pytest.fixture
def devices() -> Iterator[FakeDevices]:
    with fake_devices() as found:
        yield found


@pytest.fixture
def clock(devices: FakeDevices) -> OwnTime:
    return OwnTime(devices)


def made(devices: FakeDevices, clock: OwnTime, **parameters: Any) -> ForceDimension:
    return ForceDimension(PORTS, 1e-3, {"library": devices.path, **parameters}, clock)


@pytest.fixture
def driver(devices: FakeDevices, clock: OwnTime) -> Iterator[ForceDimension]:
    with closing(made(devices, clock)) as found:
        found.sample(0, AT)
        found.work()
        yield found


# --- the start


def test_it_states_what_the_library_knows(devices: FakeDevices, clock: OwnTime) -> None:
    with closing(made(devices, clock, reach=0.04, speed=0.8)) as driver:
        stated = driver.specification()
    assert stated.axes == ("x", "y", "z")
    assert stated.displacement == (0.04,) * 3
    assert stated.speed == (0.8,) * 3
    assert 3.0 < stated.force[0] == stated.force[1] == stated.force[2] < 6.0
    assert stated.step is not None
    assert all(1e-5 < step < 3e-5 for step in stated.step)
    assert stated.holds_torque
    assert stated.mass is None
    assert "velocity threshold (3000" in stated.by_itself[0]
    assert stated.measured == TIMES
    # an exchange takes 20 us here
    assert stated.timing.sample_age == pytest.approx(ROUND)
    assert stated.timing.actuation_delay == pytest.approx(ROUND)


def test_it_states_no_less_than_the_longest_exchange(devices: FakeDevices, clock: OwnTime) -> None:
    devices.order("trip 130")
    with closing(made(devices, clock)) as driver:
        timing = driver.specification().timing
    assert (timing.sample_age, timing.jitter) == pytest.approx((150e-6, 150e-6))
    assert timing.actuation_delay == pytest.approx(150e-6)


def test_what_the_device_does_by_itself_is_switched_off(devices: FakeDevices, driver: ForceDimension) -> None:
    seen = devices.asked()
    assert (seen.gravity, seen.guard_us, seen.watchdog, seen.mode) == (False, 0, LONGEST, 0)


def test_the_reach_is_the_cube_in_the_workspace_of_its_family(driver: ForceDimension) -> None:
    assert driver.specification().displacement == (0.043,) * 3


@pytest.mark.parametrize(
    ("order", "said"),
    [
        ("uncalibrated 1", "not calibrated.*rest position.*autoinit"),
        ("no_watchdog 1", "without a watchdog.*would last on"),
        ("present 0", "found no device with the number 0.*udev rule.*1451"),
        ("unplugged 1", "found no device with the number 0"),
        ("asynchronous 1", "communication mode 3; expected 0.*sample_age"),
        ("rotated 1", "found its position .* mm from the place of its encoders"),
        ("transposed 1", "where its Jacobian says"),
        ("scale 1000", "found a Jacobian of .* another unit of length than m"),
    ],
)
def test_a_device_that_is_not_usable_is_refused(devices: FakeDevices, clock: OwnTime, order: str, said: str) -> None:
    devices.order(order)
    with pytest.raises(ForceDimensionError, match=said):
        made(devices, clock)


def test_a_mode_of_unknown_age_is_used_where_the_age_is_stated(devices: FakeDevices, clock: OwnTime) -> None:
    devices.order("asynchronous 1")
    with closing(made(devices, clock, sample_age=0.001)) as driver:
        assert driver.specification().timing.sample_age == 0.001


def test_two_devices_by_their_serial_numbers(devices: FakeDevices, clock: OwnTime) -> None:
    devices.order("present 1", device=1)
    with closing(made(devices, clock, serial=7002)) as one, closing(made(devices, clock, serial=7001)) as other:
        for driver, force in ((one, 1.0), (other, -1.0)):
            driver.apply([force, 0.0, 0.0], AT)
        clock.wait(0.002)
        assert devices.asked(1).x[0] > 1e-6
        assert devices.asked(0).x[0] < -1e-6
    with closing(made(devices, clock, device=1)) as one:
        one.apply([1.0, 0.0, 0.0], AT)
        assert any(devices.asked(1).t)
    with pytest.raises(ForceDimensionError, match=r"serial number 7003.*7001, omega.3 7002"):
        made(devices, clock, serial=7003)


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ({"port": 3}, "found 'port'; expected library, device"),
        ({"library": "libdrd.so"}, "library: found 'libdrd.so'; expected the whole path"),
        ({"library": 3}, "library: found 3"),
        ({"device": -1}, "device: found -1; expected a whole number from 0 to 7"),
        ({"device": True}, "device: found True"),
        ({"serial": "7001"}, "serial: found '7001'"),
        ({"reach": 0}, "reach: found 0; expected a length"),
        ({"speed": None}, "speed: found None"),
        ({"silence": 3}, "silence: found 3; expected a time"),
    ],
)
def test_parameters_that_are_none_are_refused(parameters: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        ForceDimension(PORTS, 1e-3, parameters)


def test_another_number_of_axes_is_refused() -> None:
    with pytest.raises(ValueError, match="dof 1; expected 3"):
        ForceDimension(("dx",), 1e-3, {})


def test_a_library_that_is_none_or_another_one_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ForceDimensionError, match=r"found no library.*parameters.library, set FORCEDIM_SDK"):
        ForceDimension(PORTS, 1e-3, {"library": str(tmp_path / "none.so")})
    monkeypatch.setenv("FORCEDIM_SDK", str(tmp_path))
    with pytest.raises(ForceDimensionError, match="found no library"):
        ForceDimension(PORTS, 1e-3, {})
    libc = next(line.split()[-1] for line in Path("/proc/self/maps").read_text().splitlines() if "libc.so" in line)
    with pytest.raises(ForceDimensionError, match=r"library without .*expected libdrd of SDK 3\.10"):
        ForceDimension(PORTS, 1e-3, {"library": libc})


def test_the_library_is_found_by_the_environment(
    devices: FakeDevices, clock: OwnTime, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FORCEDIM_SDK", devices.path)
    with closing(ForceDimension(PORTS, 1e-3, {}, clock)):
        pass
    machine = __import__("platform").machine()
    folder = tmp_path / "lib" / "release" / f"lin-{machine}-gcc"
    folder.mkdir(parents=True)
    (folder / "libdrd.so.3.17.0").symlink_to(devices.path)
    monkeypatch.setenv("FORCEDIM_SDK", str(tmp_path))
    with closing(ForceDimension(PORTS, 1e-3, {}, clock)):
        pass


def test_a_device_that_another_program_has_is_refused(devices: FakeDevices, clock: OwnTime) -> None:
    """The fake keeps the process that has opened it; one that lives is process 1."""
    with closing(made(devices, clock)):
        pass
    devices.order("owner 1")
    with pytest.raises(ForceDimensionError, match=r"device already in use.*no other program"):
        made(devices, clock)


# --- forces, work, and their end


def test_a_force_is_exerted_as_it_is_given(devices: FakeDevices, clock: OwnTime, driver: ForceDimension) -> None:
    begin = driver.sample(1, AT)
    driver.apply([3.0, -2.0, 1.0], AT)
    assert driver.exerted() == pytest.approx((3.0, -2.0, 1.0))
    assert driver.kinematics.force() == pytest.approx((3.0, -2.0, 1.0), abs=0.01)
    clock.wait(0.01)
    way = [b - a for a, b in zip(begin, driver.sample(2, AT), strict=True)]
    assert [part / way[2] for part in way] == pytest.approx((3.0, -2.0, 1.0), rel=0.05)
    driver.release(AT)
    assert devices.asked().t == (0.0, 0.0, 0.0)


def moved(
    devices: FakeDevices, clock: OwnTime, driver: ForceDimension, ticks: int, every: int
) -> tuple[float, float, float]:
    """Push it with forces that turn about, and ask for the work; returns that work, the true one, and f dx, J."""
    told = ports = 0.0
    before, x = devices.asked().work, list(driver.sample(0, AT))
    driver.work()
    held = [0.0, 0.0, 0.0]
    for tick in range(ticks):
        now = driver.sample(tick, AT)
        ports += sum(f * (b - a) for f, a, b in zip(held, x, now, strict=True))
        x = list(now)
        if tick % every == 0:
            answer = driver.work()
            assert answer is not None
            told += answer
        clock.wait(0.0003)
        held = [2.5 * math.sin(0.13 * tick), 2.5 * math.cos(0.11 * tick), 2.0 * math.sin(0.07 * tick + 1.0)]
        driver.apply(held, AT, Instant(6 * MS))
        clock.wait(0.0006)
    driver.sample(ticks, AT)
    told += driver.work() or 0.0
    return told, devices.asked().work - before, ports


@pytest.mark.parametrize("every", [1, 7])
@pytest.mark.parametrize("trip", [2, 60])
def test_the_work_is_that_of_the_motors(
    devices: FakeDevices, clock: OwnTime, driver: ForceDimension, every: int, trip: int
) -> None:
    """Never less, and more by no more than is said of the calls; f dx of the ports is something else."""
    devices.order("plant 0.1 0.2 0")
    devices.order(f"trip {trip}")
    told, true, ports = moved(devices, clock, driver, 300, every)
    assert abs(true) > 1e-2
    # 0.3 N a tick times 0.6 m/s times three calls, in 300 ticks; and counts of 2e-5 m under forces up to 3.5 N
    assert -1e-4 < told - true < 300 * 0.3 * 0.6 * 3e-6 * trip + 1e-4
    assert abs(ports - true) > 1e-3


def test_a_watchdog_ends_a_force_though_nobody_calls_and_its_work_is_not_told(
    devices: FakeDevices, clock: OwnTime, driver: ForceDimension
) -> None:
    driver.apply([1.0, 0.0, 0.0], AT, Instant(5 * MS))
    assert devices.asked().watchdog == 40
    clock.wait(0.004)
    assert any(devices.asked().t)
    clock.wait(0.0015)
    assert devices.asked().t == (0.0, 0.0, 0.0)
    driver.sample(1, AT)
    assert driver.work() is None
    assert driver.work() == 0.0  # it was told once that nobody knows
    driver.apply([1.0, 0.0, 0.0], AT, Instant(5 * MS))  # and its forces come back
    assert any(devices.asked().t)
    assert driver.figures()["watchdog_ends"] == 1.0
    clock.wait(0.001)
    driver.sample(2, AT)
    assert driver.work() is not None


def test_a_watchdog_that_ends_no_force_is_seen_as_well(
    devices: FakeDevices, clock: OwnTime, driver: ForceDimension
) -> None:
    """A device that brakes for want of calls is to obey the next force at once."""
    driver.release(AT)
    clock.wait(0.04)
    driver.sample(1, AT)
    assert driver.work() == 0.0
    driver.apply([1.0, 0.0, 0.0], AT)
    assert any(devices.asked().t)


def test_no_old_torque_acts_when_forces_are_turned_on_again(
    devices: FakeDevices, clock: OwnTime, driver: ForceDimension
) -> None:
    driver.apply([3.0, 0.0, 0.0], AT, Instant(2 * MS))
    clock.wait(0.01)
    before = devices.asked().work
    driver.apply([0.0, 0.0, 0.0], AT, Instant(2 * MS))
    assert devices.asked().work == before


def test_a_force_that_may_not_last_a_step_of_the_watchdog_is_none(devices: FakeDevices, driver: ForceDimension) -> None:
    driver.apply([1.0, 0.0, 0.0], AT, Instant(100_000))
    assert devices.asked().t == (0.0, 0.0, 0.0)
    assert driver.exerted() is None
    driver.release(AT)
    assert driver.exerted() == [0.0, 0.0, 0.0]


def test_readings_do_not_keep_a_force_alive(devices: FakeDevices, clock: OwnTime, driver: ForceDimension) -> None:
    """A device whose watchdog counts readings as well is told to stop by the driver."""
    devices.order("deaf 1")
    driver.apply([1.0, 0.0, 0.0], AT, Instant(3 * MS))
    clock.wait(0.0031)
    assert any(devices.asked().t)
    driver.sample(1, AT)
    assert devices.asked().t == (0.0, 0.0, 0.0)


def test_the_watchdog_follows_shorter_times_at_once_and_longer_ones_after_many() -> None:
    watchdog = _Watchdog()
    watchdog.steps = watchdog.after(40)
    assert watchdog.steps == 40
    watchdog.steps = watchdog.after(30)
    assert watchdog.steps == 30
    found = [watchdog.after(35 + k % 3) for k in range(CALM)]
    assert found == [30] * (CALM - 1) + [35]


def test_a_shorter_watchdog_that_ends_the_last_force_is_seen(
    devices: FakeDevices, clock: OwnTime, driver: ForceDimension
) -> None:
    driver.apply([1.0, 0.0, 0.0], AT, Instant(20 * MS))
    clock.wait(0.005)
    driver.apply([1.0, 0.0, 0.0], AT, Instant(2 * MS))  # set, it ends the first one, which is 5 ms old
    assert any(devices.asked().t)
    driver.sample(1, AT)
    assert driver.work() is None


def test_saturated_motors_are_counted_and_what_is_exerted_is_told(
    devices: FakeDevices, clock: OwnTime, driver: ForceDimension
) -> None:
    devices.order("most 0.2")
    driver.apply([5.0, 1.0, 0.0], AT)
    F = driver.exerted()
    assert F is not None
    assert F[0] < 4.9
    assert F[1] / F[0] == pytest.approx(0.2)
    assert driver.kinematics.force() == pytest.approx(F, abs=0.01)
    assert max(map(abs, devices.asked().t)) == pytest.approx(0.2, rel=1e-3)
    assert driver.figures()["saturated"] == 1.0
    clock.wait(0.001)
    driver.sample(1, AT)
    assert driver.work() is not None  # the driver has scaled them by itself


def test_torques_that_the_library_scales_are_asked_back_and_their_work_is_not_told(
    devices: FakeDevices, clock: OwnTime, driver: ForceDimension, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where a motor can give less than the library says beforehand."""
    monkeypatch.setattr(driver.kinematics, "torques", lambda q: ([-9.0] * 3, [9.0] * 3))
    devices.order("most 0.2")
    driver.apply([5.0, 1.0, 0.0], AT)
    assert driver.exerted() == pytest.approx((3.06, 0.612, 0.0), abs=0.01)
    assert driver.figures()["saturated"] == 1.0
    clock.wait(0.001)
    driver.sample(1, AT)
    assert driver.work() is None


def test_a_reading_of_the_past_is_no_sample(devices: FakeDevices, clock: OwnTime, driver: ForceDimension) -> None:
    devices.order("stuck 1")
    clock.wait(0.003)
    driver.sample(1, AT)
    figures = driver.figures()
    assert figures["not_refreshed"] == 1.0
    assert figures["oldest_ms"] == pytest.approx(3.0, abs=0.1)
    assert figures["older_than_stated"] == 1.0
    assert driver.work() == 0.0  # no torques
    driver.apply([1.0, 0.0, 0.0], AT)
    driver.sample(2, AT)
    assert driver.work() is None  # where it is and was is not known
    clock.wait(0.01)
    with pytest.raises(ForceDimensionError, match="no new reading for"):
        driver.sample(3, AT)


def test_an_exchange_that_stalls_is_an_old_sample(devices: FakeDevices, driver: ForceDimension) -> None:
    devices.order("stall 5")
    driver.sample(1, AT)
    assert driver.figures()["oldest_ms"] == pytest.approx(5.0, abs=0.1)
    assert driver.figures()["older_than_stated"] == 1.0


# --- what fails, by name


def test_an_unplugged_device_is_named_and_closing_it_is_quiet(devices: FakeDevices, clock: OwnTime) -> None:
    driver = made(devices, clock)
    devices.order("unplugged 1")
    for call in (lambda: driver.sample(1, AT), lambda: driver.apply([0.1] * 3, AT), lambda: driver.release(AT)):
        with pytest.raises(ForceDimensionError, match=r"7001: dhd\w+ failed: found 'communication error'.*cable"):
            call()
    driver.close()
    driver.close()
    devices.order("unplugged 0")
    with closing(made(devices, clock)) as again:
        assert len(again.sample(0, AT)) == 3


@pytest.mark.parametrize(("order", "said"), [("button", "by its force button"), ("speed 4 0 0", "velocity threshold")])
def test_forces_that_its_protections_take_away_end_the_driver(
    devices: FakeDevices, clock: OwnTime, driver: ForceDimension, order: str, said: str
) -> None:
    driver.apply([0.1, 0.0, 0.0], AT)
    devices.order(order)
    clock.wait(0.021)
    with pytest.raises(ForceDimensionError, match=said):
        driver.idle(AT)


def test_closing_takes_the_force_away(devices: FakeDevices, clock: OwnTime) -> None:
    driver = made(devices, clock)
    driver.apply([1.0, 0.0, 0.0], AT)
    driver.close()
    assert devices.asked().t == (0.0, 0.0, 0.0)
    assert devices.asked().braked


# --- the suite, and the command


def checked(devices: FakeDevices, clock: OwnTime, T: float = 1e-3) -> list[Judgement]:
    driver = ForceDimension(PORTS, T, {"library": devices.path, "silence": 0.9}, clock)
    stated = driver.specification()
    plugin = PluginDriver("fake", driver, AxisMap((0, 1, 2), (1.0, 1.0, 1.0)), stated, T)
    return list(check_driver(Bench(plugin, T, clock), stated, Push()))


@pytest.mark.parametrize("T", [1e-3, 2.5e-4])
def test_check_driver_finds_nothing_wrong(devices: FakeDevices, clock: OwnTime, T: float) -> None:
    found = checked(devices, clock, T=T)
    assert not broken(found), found
    kept = {one.check for one in found if one.verdict is Conformance.KEPT}
    assert {"swapped axes", "wrong sign", "wrong work", "no release", "stale sample", "force kept on silence"} <= kept


@pytest.mark.parametrize(
    ("order", "check"),
    [("lying 1", "wrong sign"), ("stuck 1", "exception"), ("deaf 1", "force kept on silence")],
)
def test_check_driver_names_faults_of_the_device(devices: FakeDevices, clock: OwnTime, order: str, check: str) -> None:
    devices.order(order)
    found = checked(devices, clock)
    assert check in broken(found), found


@pytest.mark.parametrize(
    ("method", "fault", "check"),
    [
        ("jacobian", lambda J: [-value for value in J], "wrong sign"),
        ("jacobian", lambda J: [*J[3:6], *J[:3], *J[6:]], "swapped axes"),
        ("place", lambda x: [1e3 * value for value in x], "wrong unit"),
        ("angles", lambda q: [-value for value in q], "wrong work"),
    ],
)
def test_check_driver_names_faults_of_the_driver(
    devices: FakeDevices, clock: OwnTime, monkeypatch: pytest.MonkeyPatch, method: str, fault: Any, check: str
) -> None:
    true = getattr(Kinematics, method)
    monkeypatch.setattr("manyhands.devices.force_dimension.survey.check", lambda *_: None)
    if method == "angles":  # of the work alone, and not of J
        jacobian = Kinematics.jacobian
        monkeypatch.setattr(Kinematics, "jacobian", lambda self, q: jacobian(self, [-value for value in q]))
    monkeypatch.setattr(Kinematics, method, lambda self, given: fault(true(self, given)))
    assert check in broken(checked(devices, clock))


def test_the_command_prints_what_a_session_has_to_state(
    devices: FakeDevices, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["--library", devices.path, "--reach", "0.03", "--serial", "7001"]) == 0
    printed = capsys.readouterr().out
    assert "omega.3 7001" in printed
    assert "held: torque" in printed
    assert "displacement: 0.03" in printed
    assert main(["--library", devices.path, "--serial", "9"]) == 2
    assert "found no device with the serial number 9" in capsys.readouterr().err


def test_its_buttons_are_those_of_the_library(devices: FakeDevices, driver: ForceDimension) -> None:
    assert driver.specification().buttons[:2] == ("button0", "button1")
    assert driver.buttons() == 0
    devices.order("pressed 5")
    assert driver.buttons() == 0b101
    devices.order("unplugged 1")
    assert driver.buttons() == 0


# --- a wrist

TURNS = [
    (1.0, 0.0, 0.0, 0.0), (0.6, 0.0, 0.8, 0.0), (0.0, 0.6, 0.0, -0.8), (0.0, 0.0, 0.0, 1.0), (0.0, 1.0, 0.0, 0.0),
    (0.5, -0.5, 0.5, 0.5), (0.1, 0.7, -0.1, 0.7), (-0.3, 0.1, 0.9, 0.3),
]  # fmt: skip


def test_a_device_without_a_wrist_states_no_orientation(driver: ForceDimension) -> None:
    assert driver.specification().orientation is None


@pytest.mark.parametrize(("wrist", "holds"), [(1, "world"), (2, "joints")])
def test_the_orientation_of_a_wrist_is_sensed_whatever_motors_it_has(
    devices: FakeDevices, clock: OwnTime, wrist: int, holds: str
) -> None:
    devices.order(f"wrist {wrist}")
    with closing(made(devices, clock, turning=12)) as driver:
        of = driver.specification().orientation
        assert of is not None
        assert (of.speed, of.torque, of.holds, of.felt) == (12.0, None, holds, False)
        assert driver.specification().session_keys()["orientation"] == {"sensed": True}
        (sentence,) = of.promises_too_much(0.1, 1.0)
        assert ("its driver exerts none by its joints" in sentence) == (wrist == 2)
        for turn in TURNS:
            norm = math.hypot(*turn)
            wanted = [part / norm for part in turn]
            devices.order("turned " + " ".join(map(repr, wanted)))
            found = driver.orientation()
            sign = math.copysign(1.0, sum(a * b for a, b in zip(found, wanted, strict=True)))
            assert [sign * part for part in found] == pytest.approx(wanted, abs=1e-12)


def test_the_motors_of_a_wrist_exert_nothing(devices: FakeDevices, clock: OwnTime) -> None:
    devices.order("wrist 2\ntwisted 0.2")  # another program has left it
    with closing(made(devices, clock)) as driver:
        assert devices.wrist() == (0.0, 0.0, 0.0)
        for tick in range(5):
            driver.sample(tick, Instant(tick * MS))
            driver.apply([1.0, -1.0, 0.5], Instant(tick * MS), Instant((tick + 6) * MS))
            assert devices.wrist() == (0.0, 0.0, 0.0)
        assert any(devices.asked().t)


def test_a_frame_that_is_no_rotation_is_named(devices: FakeDevices, clock: OwnTime) -> None:
    devices.order("wrist 1\nskewed 1")
    with closing(made(devices, clock)) as driver, pytest.raises(ForceDimensionError, match="expected a rotation"):
        driver.orientation()


@pytest.mark.parametrize(
    "rows",
    [
        [1.0, 0, 0, 0, 1, 0, 0, 0, -1],  # a mirror
        [1.0, 0, 0, 0, 1, 0, 0, 0, 1.01],
        [1.0, 0.01, 0, 0, 1, 0, 0, 0, 1],
        [math.nan, 0, 0, 0, 1, 0, 0, 0, 1],
        [0.0] * 9,
    ],
)
def test_what_is_no_rotation_is_none(rows: list[float]) -> None:
    assert is_rotation([1.0, 0, 0, 0, 1, 0, 0, 0, 1])
    assert not is_rotation(rows)


@pytest.mark.parametrize("wrist", [1, 2])
def test_one_with_a_wrist_passes_the_suite_with_its_orientation(
    devices: FakeDevices, clock: OwnTime, wrist: int
) -> None:
    devices.order(f"wrist {wrist}\nturned 0.6 0.0 0.8 0.0")
    found = checked(devices, clock)
    assert broken(found) == [], found
    assert "jumping orientation" in {one.check for one in found if one.verdict is Conformance.KEPT}
