"""A driver of another package: its axes, what it states, what it exerts, and how it fails."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from manyhands.design.levels.held_torque import HeldTorque
from manyhands.design.models.axis import AxisKind
from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.session import load_session
from manyhands.nodes.device.drivers import driver_of
from manyhands.nodes.device.plugin import DriverFailure, GivenForces, PluginDriver, made_driver
from manyhands.nodes.device.specification import AxisMap, DeviceSpecification, other_kinds
from manyhands.nodes.device.tick import WallTimeTick
from manyhands.nodes.kernel.bundle import REALTIME, SIMULATED, DeviceBundle, Limits, PluginDevice, load, save
from manyhands.nodes.kernel.driver_statement import DeviceTiming
from manyhands.nodes.kernel.factory import FactoryError, FactoryName
from manyhands.nodes.kernel.inertia import Inertia
from manyhands.nodes.rows import figures as names
from manyhands.protocol.clock import Duration, Instant

from ...support.instants import instant
from ...support.plugin_drivers import Counterpart, Raising, Working, WorkUnknown, WrongAnswer

SESSIONS = Path(__file__).parents[3] / "launch" / "sessions"
MADE = "tests.support.plugin_drivers:Counterpart"
T = 1e-3


def plugin(kind: type[Any] = Counterpart, axis_map: AxisMap | None = None, **parameters: Any) -> tuple[Any, Any]:
    driver = kind(("x", "y", "z"), T, parameters)
    return driver, PluginDriver(
        "some:driver", driver, axis_map or AxisMap((0, 1, 2), (1.0,) * 3), driver.specification(), 1e-3
    )


@lru_cache
def example1() -> Prepared:
    return prepare(load_session(SESSIONS / "example1.yaml"))


def bundle_for(
    device: PluginDevice, clock: str = REALTIME, inertia: Inertia | None = None, **limits: tuple[float, ...]
) -> DeviceBundle:
    """The bundle of a device of Example 1, moved by another driver."""
    bundle = cut(example1(), RunPlan(clock, None, ""))["dx"]
    assert isinstance(bundle, DeviceBundle)
    within: dict[str, Any] = {"force": (8.0,), "displacement": (0.2,), "speed": (2.0,)} | limits
    return replace(bundle, source=device, limits=Limits(**within), inertia=inertia)


def named(**parameters: Any) -> FactoryName:
    return FactoryName(MADE, parameters)


class NoNumber(Working):
    def work(self) -> Any:
        return math.nan


class Unplugged(Working):
    def work(self) -> Any:
        raise OSError("unplugged")


def test_the_work_of_motors_is_that_of_the_ports_whatever_their_axes_and_scale() -> None:
    _, mapped = plugin(Working, AxisMap((2, 0, 1), (-1.0, 1.0, -1.0), 2.5))
    x, seen = mapped.sample(0, instant(0)), 0.0
    for tick in range(1, 50):
        f = [0.3, -0.2, 0.1]
        mapped.apply(f, instant(tick - 1))
        before, x = x, mapped.sample(tick, instant(tick))
        seen += sum(force * (b - a) for force, a, b in zip(f, before, x, strict=True))
    assert mapped.tells_work
    assert mapped.work() == pytest.approx(seen, rel=1e-9)
    assert mapped.work() == 0.0


def test_a_work_that_is_unknown_once_is_no_number_and_one_that_is_never_told_is_none() -> None:
    assert plugin(WorkUnknown)[1].work() == math.inf
    silent = plugin(Counterpart)[1]
    assert (silent.tells_work, silent.work()) == (False, None)


@pytest.mark.parametrize(
    ("kind", "found"),
    [
        (NoNumber, "failed in work: found nan; expected a finite work in J, or None"),
        (Unplugged, "found .*unplugged.*J or"),
    ],
)
def test_a_work_of_no_use_ends_the_node(kind: type[Any], found: str) -> None:
    with pytest.raises(DriverFailure, match=found):
        plugin(kind)[1].work()


def test_torques_in_wall_time_need_a_driver_that_tells_their_work() -> None:
    held = HeldTorque(18.0, 8.0, 2.0)
    silent, told = (
        PluginDevice(FactoryName(f"tests.support.plugin_drivers:{of}", {}), 1) for of in ("Counterpart", "Working")
    )
    with pytest.raises(
        FactoryError, match=r"devices.dx: found the driver .*:Counterpart without a method work; expected"
    ):
        driver_of(replace(bundle_for(silent), held=held))
    driver_of(replace(bundle_for(silent, SIMULATED), held=held)).close()  # its own time has no lateness
    driver_of(bundle_for(silent)).close()
    driver_of(replace(bundle_for(told), held=held)).close()


def test_a_session_must_know_that_the_motors_of_a_driver_hold_torques() -> None:
    device = PluginDevice(FactoryName("tests.support.plugin_drivers:HoldsTorque", {}), 1)
    with pytest.raises(
        FactoryError, match=r"devices\.dx\.held: found force; expected torque, for the driver .*HoldsTorque"
    ):
        driver_of(bundle_for(device))
    driver_of(replace(bundle_for(device), held=HeldTorque(18.0, 8.0, 2.0))).close()


@pytest.mark.parametrize("name", ["Working", "WorkUnknown"])
def test_the_account_takes_what_its_motors_did(name: str) -> None:
    """Cartesian motors that tell f dx have the account of a held force; of an unknown work it counts the most."""
    device = PluginDevice(FactoryName(f"tests.support.plugin_drivers:{name}", {}), 1)
    bundle = replace(bundle_for(device), held=HeldTorque(18.0, 8.0, 2.0), allowance=None)
    tick = WallTimeTick(bundle, driver_of(bundle))
    for turn in range(200):
        tick.sample(turn, instant(turn))
        tick.exert([0.5], instant(turn))
        tick.book()
    assert (tick.wall_interface.account.energy < 0.0) == (name == "WorkUnknown")


def test_axes_signs_and_scale_keep_the_power() -> None:
    rng = np.random.default_rng(1)
    axis_map = AxisMap((2, 0, 1), (-1.0, 1.0, -1.0), 2.5)
    driver, mapped = plugin(axis_map=axis_map, damping=0.0)
    x = np.array(mapped.sample(0, instant(0)))
    X = np.array(driver.x)
    for tick in range(1, 50):
        f = rng.normal(size=3)
        mapped.apply(f.tolist(), instant(tick - 1))
        before = X, x
        x, X = np.array(mapped.sample(tick, instant(tick))), np.array(driver.x)
        work = f @ (x - before[1])
        assert work == pytest.approx(np.array(driver.commanded) @ (X - before[0]), rel=1e-9)
    np.testing.assert_allclose(x, [-2.5 * X[2], 2.5 * X[0], -2.5 * X[1]])


@pytest.mark.parametrize(
    ("axes", "signs", "scale"), [((0, 0), (1.0, 1.0), 1.0), ((0, 1), (1.0, 2.0), 1.0), ((0, 1), (1.0, 1.0), 0.0)]
)
def test_maps_that_are_none(axes: tuple[int, ...], signs: tuple[float, ...], scale: float) -> None:
    with pytest.raises(ValueError, match="expected"):
        AxisMap(axes, signs, scale)


@pytest.mark.parametrize(
    ("stated", "found"),
    [
        ({"force": (1.0, 2.0)}, "displacement: found"),
        ({"displacement": (0.0,)}, "displacement: found"),
        ({"speed": (float("inf"),)}, "speed: found"),
        ({"mass": (-1.0,)}, "mass: found"),
        ({"step": (0.0,)}, "step: found"),
        ({"axes": ("x", "y")}, "axes: found"),
        ({"turning": ("phi",)}, "turning: found"),
        ({"force": ()}, "force: found"),
        ({"by_itself": "one sentence"}, "by_itself: found"),
        ({"by_itself": ("",)}, "by_itself: found"),
        ({"by_itself": ("two\nlines",)}, "by_itself: found"),
        ({"by_itself": ("x" * 201,)}, "by_itself: found"),
        ({"by_itself": ("holds itself up",) * 9}, "by_itself: found"),
        ({"measured": ("age",)}, "measured: found"),
        ({"measured": "sample_age"}, "measured: found"),
    ],
)
def test_specifications_that_are_none(stated: dict[str, Any], found: str) -> None:
    whole: dict[str, Any] = {"force": (1.0,), "displacement": (1.0,), "speed": (1.0,)} | stated
    with pytest.raises(ValueError, match=found):
        DeviceSpecification(**whole)


@pytest.mark.parametrize("timing", [{"sample_age": -1.0}, {"actuation_delay": float("nan")}, {"age_jitter": 0.1}])
def test_timings_that_are_none(timing: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="found"):
        DeviceTiming(**timing)


STARTS = (DeviceTiming(4e-4, 1e-4, 2e-4), DeviceTiming(6e-4, 2e-4, 1e-4))


@pytest.mark.parametrize(
    ("measured", "promised"),
    [
        ((), DeviceTiming(6e-4, 2e-4, 2e-4)),
        (("sample_age", "age_jitter"), DeviceTiming(9e-4, None, 2e-4)),
        (("age_jitter",), DeviceTiming(6e-4, None, 2e-4)),
        (("actuation_delay",), DeviceTiming(6e-4, 2e-4, 3e-4)),
    ],
)
def test_what_a_session_may_state_bounds_every_start_with_room_where_it_was_measured(
    measured: tuple[str, ...], promised: DeviceTiming
) -> None:
    first, second = (DeviceSpecification((1.0,), (1.0,), (1.0,), one, measured=measured) for one in STARTS)
    assert first.promised([second.timing]) == promised
    assert ("age_jitter" in first.session_keys()) == ("age_jitter" not in measured)
    whole = replace(first, timing=DeviceTiming(4e-4))  # all of the age: so it is where the age has room
    assert whole.promised().age_jitter is None


def test_a_bundle_is_read_as_it_was_written(tmp_path: Path) -> None:
    device = PluginDevice(named(mass=0.3), 1, ("-0",), 2.0, DeviceTiming(2e-4, 1e-4, 1e-4))
    save(bundle_for(device), tmp_path / "dx.bundle")
    read = load(tmp_path / "dx.bundle", DeviceBundle)
    assert read.source == device
    assert read.timing == device.timing


@pytest.mark.parametrize(
    ("parameters", "timing", "limits", "found"),
    [
        ({}, {}, {"force": (9.0,)}, "limits.force: found 9 N; expected at most 8 N"),
        ({}, {}, {"displacement": (0.3,)}, "limits.displacement: found 0.3 m; expected at most 0.2 m"),
        ({}, {}, {"speed": (3.0,)}, "limits.speed: found 3 m/s; expected at most 2 m/s"),
        (
            {"sample_age": 3e-4, "age_jitter": 0.0},
            {"sample_age": 2e-4},
            {},
            "sample_age: found 0.0002 s; expected at least 0.0003 s",
        ),
        ({"actuation_delay": 3e-4}, {}, {}, "actuation_delay: found 0 s; expected at least 0.0003 s"),
        (
            {"sample_age": 3e-4},
            {"sample_age": 3e-4, "age_jitter": 1e-4},
            {},
            "age_jitter: found 0.0001 s; expected at least 0.0003 s",
        ),
    ],
)
def test_a_session_that_promises_more_than_its_driver_states_is_refused(
    parameters: dict[str, float], timing: dict[str, float], limits: dict[str, tuple[float, ...]], found: str
) -> None:
    device = PluginDevice(named(timing=parameters), 1, timing=DeviceTiming(**timing))
    with pytest.raises(FactoryError) as caught:
        driver_of(bundle_for(device, **limits))
    assert str(caught.value) == f"devices.dx: the session promises more than its driver {MADE} states: {found}"


def test_a_session_has_to_say_of_each_axis_what_its_driver_says() -> None:
    bundle = bundle_for(PluginDevice(named(turning=["0"]), 1))
    with pytest.raises(FactoryError) as caught:
        driver_of(bundle)
    assert str(caught.value) == (
        f"devices.dx: the driver {MADE} states what its axes do, and the session says otherwise: "
        "axes: found translation for dx; expected rotation"
    )
    turning = replace(bundle, common=replace(bundle.common, turning=("dx",)))
    driver_of(turning).close()
    beyond = replace(turning, limits=Limits((9.0,), (0.3,), (2.0,)))
    with pytest.raises(
        FactoryError, match=r"found 9 N·m; expected at most 8 N·m; limits\.displacement: found 0\.3 rad;"
    ):
        driver_of(beyond)
    driver_of(replace(turning, source=PluginDevice(named(), 1))).close()  # it does not say what they do
    with pytest.raises(FactoryError, match="found rotation for dx; expected translation"):
        driver_of(replace(turning, source=PluginDevice(named(turning=[]), 1)))


def test_a_port_that_has_a_name_is_told_with_it() -> None:
    stated = DeviceSpecification((1.0, 1.0), (1.0, 1.0), (1.0, 1.0), axes=("x", "rz"), turning=("rz",))
    swapped = AxisMap((1, 0), (1.0, -1.0))
    kinds = (AxisKind.TRANSLATION, AxisKind.TRANSLATION)
    assert list(other_kinds(stated, swapped, ("d.phi", "d.x"), kinds)) == [
        "axes: found translation for d.phi; expected {phi: rotation}"
    ]
    assert list(other_kinds(stated, swapped, ("d.phi", "d.x"), (AxisKind.ROTATION, AxisKind.TRANSLATION))) == []


def test_limits_are_compared_at_the_ports() -> None:
    """With the scale 2 the session may state half the force, and twice the way and the speed."""
    device = PluginDevice(named(), 1, scale=2.0)
    driver_of(bundle_for(device, force=(4.0,), displacement=(0.4,), speed=(4.0,))).close()
    with pytest.raises(FactoryError, match="found 8 N; expected at most 4 N"):
        driver_of(bundle_for(device, force=(8.0,)))


def test_a_mass_is_compared_at_the_ports() -> None:
    """With the scale 2 a quarter of the mass is felt there: twice the way, and half the force."""
    device, own = (
        PluginDevice(named(mass=0.2), 1, scale=2.0),
        {"force": (4.0,), "displacement": (0.4,), "speed": (4.0,)},
    )
    driver_of(bundle_for(device, inertia=Inertia((0.05,), (50.0,), (0.0,)), **own)).close()
    with pytest.raises(FactoryError, match=r"mass: found 0.06 kg; expected at most 0.05 kg"):
        driver_of(bundle_for(device, inertia=Inertia((0.06,), (50.0,), (0.0,)), **own))


def test_a_step_is_compared_at_the_ports() -> None:
    """With the scale 2 a step of 0.5 mm is 1 mm there."""
    own = {"force": (4.0,), "displacement": (0.4,), "speed": (4.0,)}
    driver_of(bundle_for(PluginDevice(named(step=5e-4), 1, scale=2.0, step=(1e-3,)), **own)).close()
    driver_of(bundle_for(PluginDevice(named(step=5e-4), 1, scale=2.0), **own)).close()  # nothing counts on it
    with pytest.raises(FactoryError, match=r"step: found 0.0009 m; expected at least 0.001 m"):
        driver_of(bundle_for(PluginDevice(named(step=5e-4), 1, scale=2.0, step=(9e-4,)), **own))


def test_hardware_is_refused_under_the_simulated_clock() -> None:
    device = PluginDevice(named(hardware=True), 1)
    driver_of(bundle_for(device)).close()
    with pytest.raises(FactoryError, match="found hardware under the simulated clock; expected the realtime clock"):
        driver_of(replace(bundle_for(device, SIMULATED), time="own"))


def test_what_a_driver_says_of_its_own_hardware_is_said_alone() -> None:
    absent = PluginDevice(FactoryName("builtins:open", {}), 1)  # a TypeError of its arguments
    with pytest.raises(FactoryError, match="expected a factory of"):
        driver_of(bundle_for(absent))
    board = FactoryName("manyhands.devices.serial_board:SerialBoard", {"port": "/dev/no-such-port"})
    with pytest.raises(FactoryError, match=r"no-such-port: there is no such port; plug the device in$"):
        driver_of(bundle_for(PluginDevice(board, 1)))


@pytest.mark.parametrize(
    ("device", "found"),
    [
        (PluginDevice(named(), 1, ("y",)), "axis_map: found the axis 'y'; expected one of 0"),
        (PluginDevice(FactoryName("builtins:dict", {}), 1), "cannot be made: found TypeError"),
        (PluginDevice(FactoryName("builtins:isinstance", {}), 1), "cannot be made: found TypeError"),
        (PluginDevice(FactoryName("nowhere.at_all:f", {}), 1), "cannot be made: found ModuleNotFoundError"),
        (PluginDevice(FactoryName("stick.py:Stick", {}), 1), "a module is named without its suffix, stick:Stick"),
    ],
)
def test_a_driver_that_cannot_be_made_is_named(device: PluginDevice, found: str) -> None:
    with pytest.raises(FactoryError) as caught:
        driver_of(bundle_for(device))
    assert found in str(caught.value)


def test_what_is_no_driver_is_told_by_what_it_lacks() -> None:
    with pytest.raises(FactoryError, match=r"found tuple without specification, sample, apply, release, close"):
        made_driver(FactoryName("tests.nodes.device.test_plugin:no_driver", {}), ("x",), T)


def no_driver(ports: tuple[str, ...], period: float, parameters: dict[str, Any]) -> tuple[str, ...]:
    return ports


def test_a_failure_names_the_driver_and_the_call_and_the_release_after_it_raises_nothing() -> None:
    class AlwaysRaising(Raising):
        def release(self, at: Instant) -> None:
            raise OSError("still no such device")

        def close(self) -> None:
            raise OSError("still no such device")

    _, mapped = plugin(AlwaysRaising)
    mapped.sample(0, instant(0))
    with pytest.raises(DriverFailure) as caught:
        mapped.apply([1.0, 0.0, 0.0], instant(0))
    assert str(caught.value) == (
        "the driver some:driver failed in apply: found OSError: no such device; expected no exception"
    )
    assert caught.value.raised
    assert mapped.release(instant(0)) is None
    mapped.close()


def test_an_answer_of_no_use_is_no_exception_of_the_driver() -> None:
    _, mapped = plugin(WrongAnswer)
    with pytest.raises(DriverFailure, match=r"failed in sample: found \[nan, nan, nan\]; expected 3 finite") as caught:
        mapped.sample(0, instant(0))
    assert not caught.value.raised


def test_what_the_hardware_exerts_is_counted_and_mapped_back() -> None:
    axis_map = AxisMap((1, 0, 2), (1.0, -1.0, 1.0), 2.0)
    _, mapped = plugin(axis_map=axis_map, clip=1.0)
    mapped.sample(0, instant(0))
    small, large = [0.1, 0.2, 0.3], [0.1, 2.0, 0.3]
    mapped.apply(small, instant(0))
    assert mapped.exerted(small) is small
    assert names.UNEXERTED not in mapped.figures()
    mapped.apply(large, instant(0))  # 4 N on the driver's axis 0, which clips it to 1 N: half a newton at the port
    assert mapped.exerted(large) == [0.1, 0.5, 0.3]
    # before that instant the force was 0 N, and 1 N is between it and 4 N
    assert dict(mapped.figures()) == {names.MEASURED: 2.0, names.UNEXERTED: 1.0, names.UNEXERTED_MOST: 3.0}


def test_a_measured_force_is_held_against_those_that_were_given_lately() -> None:
    """A force that is given now may be measured a period and the stated delay later, and not after that."""
    given = GivenForces((8.0, 8.0), Duration(1_300_000))
    given.give([5.0, 0.0], instant(1))
    for F in ([0.0, 0.0], [2.5, 0.39], [5.39, -0.39]):
        given.measured(F)
    assert (given.untrue.ticks, given.untrue.most) == (0, 0.0)
    for F, beyond in (([5.41, 0.0], 0.41), ([-0.5, 0.0], 0.5), ([0.0, 1.0], 1.0)):
        given.measured(F)
        assert given.untrue.most == pytest.approx(beyond)
    assert given.untrue.ticks == 3
    given.give([5.0, 0.0], instant(2.2), instant(5))
    given.measured([0.0, 0.0])
    assert given.untrue.ticks == 3
    given.give([5.0, 0.0], instant(2.4), instant(5))
    given.measured([1.0, 0.0])  # for 1.4 ms it should have been 5 N
    assert (given.untrue.ticks, given.untrue.most) == (4, 4.0)
    given.measured([0.3, -0.3])  # none: it has let go
    assert (given.untrue.ticks, given.limp.ticks, given.limp.most) == (4, 1, 4.7)
    given.give([0.0, 0.0], instant(3))  # released
    given.measured([5.0, 0.0])
    assert given.untrue.ticks == 4
    given.give([0.0, 0.0], instant(4.4))
    given.measured([5.0, 0.0])  # and not exerted any more
    assert given.untrue.ticks == 5


def test_the_account_is_kept_with_the_force_that_was_exerted() -> None:
    """A device that is pushed less than it was told to gives the couplings less: its account sees the true force."""
    accounts = []
    for clip in (8.0, 0.5):
        bundle = bundle_for(PluginDevice(named(clip=clip), 1))
        tick = WallTimeTick(replace(bundle, time="wall", allowance=None), driver_of(bundle))
        for k in range(50):
            at = Instant(k * 1_000_000)
            tick.sample(k, at)
            tick.exert([2.0], at)
            tick.book()
        assert tick.wall_interface.exerted == [min(2.0, clip)]
        accounts.append(tick.wall_interface.account.energy)
        found = dict(tick.driver.figures())
        # in the first tick the zero before may still be measured, and 0.5 N are between it and 2 N
        untrue = {names.UNTRUE: 49.0, names.UNTRUE_MOST: 1.5}
        expected = {names.UNEXERTED: 50.0, names.UNEXERTED_MOST: 1.5, **untrue} if clip < 2.0 else {}
        assert found == {names.MEASURED: 50.0, **expected}
    assert accounts[1] > accounts[0]


def test_a_device_with_a_latency_does_not_say_where_it_was() -> None:
    """What a driver returns at a force is then older than the force."""
    device = PluginDevice(named(), 1, timing=DeviceTiming(1e-4))
    driver = driver_of(bundle_for(device))
    driver.sample(0, instant(0))
    assert driver.apply([1.0], instant(0)) is None
    assert driver_of(bundle_for(PluginDevice(named(), 1))).apply([1.0], instant(0)) is not None


class Pressing(Counterpart):
    """A driver with two buttons, whose state a test sets."""

    state: Any = 0

    def specification(self) -> DeviceSpecification:
        return replace(super().specification(), buttons=("menu", "grip"))

    def buttons(self) -> Any:
        return type(self).state


def pressing(*buttons: str) -> PluginDriver:
    """A device whose session names these buttons."""
    bundle = bundle_for(PluginDevice(FactoryName("tests.nodes.device.test_plugin:Pressing", {}), 1))
    made = driver_of(replace(bundle, common=replace(bundle.common, buttons=tuple(f"dx.{name}" for name in buttons))))
    assert isinstance(made, PluginDriver)
    return made


def test_the_buttons_of_a_driver_are_those_that_the_session_names(monkeypatch: pytest.MonkeyPatch) -> None:
    found = []
    for state in (0b00, 0b01, 0b10, 0b110, np.int64(3)):
        monkeypatch.setattr(Pressing, "state", state)
        found.append((pressing("grip").buttons(), pressing("grip", "menu").buttons()))
    assert found == [(0, 0), (0, 0b10), (1, 0b01), (1, 0b01), (1, 0b11)]


@pytest.mark.parametrize("state", [-1, 1.0, None, "1"])
def test_a_state_of_buttons_that_is_none_ends_the_node(state: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Pressing, "state", state)
    with pytest.raises(DriverFailure, match=r"failed in buttons: found .*; expected an integer of at least 0"):
        pressing("grip").buttons()


def test_a_button_that_the_driver_does_not_have_is_refused() -> None:
    with pytest.raises(FactoryError, match=r"devices.dx.buttons: found 'red'; expected buttons of .*menu, grip"):
        pressing("grip", "red")


def test_a_driver_without_buttons_needs_no_method_for_them() -> None:
    assert plugin()[1].buttons() == 0
