"""A driver of another package that turns in space: its axes, what it states, how it fails, and how late it is."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import permutations, product
from typing import Any

import numpy as np
import pytest

from manyhands.launch.audit.simulation import simulate
from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.session import Session
from manyhands.nodes.device.drivers import driver_of
from manyhands.nodes.device.orientation import DeviceOrientation
from manyhands.nodes.device.plugin import DriverFailure, PluginDriver
from manyhands.nodes.device.specification import AxisMap, DeviceSpecification, OrientationSpecification
from manyhands.nodes.device.tick import DeviceTick, tick_of
from manyhands.nodes.kernel.bundle import REALTIME, SIMULATED, DeviceBundle, OrientationPart, TurnedHand
from manyhands.nodes.kernel.driver_statement import NO_DELAY, DeviceTiming
from manyhands.nodes.kernel.factory import FactoryError
from manyhands.nodes.kernel.orientation import NO_RIDER, UPRIGHT, Quaternion, Vector3, angle, turned_by
from manyhands.protocol.clock import Duration, Instant, from_seconds
from tests.nodes.device.test_orientation import RUNG, SPEED, B, K, Measured, T, whatever
from tests.support import turning_drivers as drivers
from tests.support.slot import told, values

MAPS = [AxisMap(axes, signs, 2.0) for axes in permutations(range(3)) for signs in product((1.0, -1.0), repeat=3)]


def plugin(kind: type[drivers.Pen], axis_map: AxisMap | None = None, **parameters: Any) -> tuple[Any, PluginDriver]:
    made = kind(("d.x", "d.y", "d.z"), T, parameters)
    axis_map = axis_map or AxisMap((0, 1, 2), (1.0,) * 3)
    return made, PluginDriver(kind.__name__, made, axis_map, made.specification(), T)


def rotation(q: Quaternion) -> np.ndarray:
    w, x, y, z = q
    v, cross = np.array([x, y, z]), np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return (w * w - v @ v) * np.eye(3) + 2.0 * np.outer(v, v) + 2.0 * w * cross


@pytest.mark.parametrize("axis_map", MAPS, ids=str)
def test_its_axes_are_those_of_the_session_even_in_a_mirror(axis_map: AxisMap) -> None:
    """P R P^T for any signed permutation P; and a torque does the same work on both sides."""
    driver, mapped = plugin(drivers.Pen, axis_map, at=(0.4, -1.1, 0.7))
    P = np.zeros((3, 3))
    for port, (axis, sign) in enumerate(zip(axis_map.axes, axis_map.signs, strict=True)):
        P[port, axis] = sign
    mapped.sample(0, Instant(0))
    assert rotation(mapped.orientation()) == pytest.approx(P @ rotation(driver.R) @ P.T, abs=1e-12)
    torque = (0.01, -0.02, 0.03)
    mapped.apply_wrench([0.0] * 3, torque, Instant(0))
    own = np.array(driver.torques[-1][1])
    before, rate = mapped.orientation(), np.array([0.3, 0.2, -0.5])
    driver.R = turned_by(driver.R, (1e-6 * rate).tolist())
    driver.stood = [(0, driver.R)]
    after = mapped.orientation()
    there = rotation(after) @ rotation(before).T
    omega = 1e6 * np.array([there[2, 1], there[0, 2], there[1, 0]])
    assert own @ rate == pytest.approx(np.array(torque) @ omega, rel=1e-4, abs=1e-6)


@pytest.mark.parametrize(
    ("kind", "found"),
    [
        (drivers.NotUnit, r"NotUnit failed in orientation: found \[.*; expected a unit quaternion \(w, x, y, z\)"),
        (drivers.NotANumber, r"failed in orientation: found \[nan, .*; expected a unit quaternion"),
        (drivers.Three, r"failed in orientation: found \[0.0, 0.0, 1.0\]; expected a unit quaternion"),
        (drivers.Words, r"failed in orientation: found .*; expected a unit quaternion"),
        (drivers.Torn, r"failed in orientation: found .*no grip.*; expected a unit quaternion"),
    ],
)
def test_an_orientation_of_no_use_ends_the_node_with_one_sentence(kind: type[drivers.Pen], found: str) -> None:
    _, mapped = plugin(kind)
    mapped.sample(0, Instant(0))
    with pytest.raises(DriverFailure, match=found):
        mapped.orientation()
    mapped.release(Instant(0))  # it is let go all the same
    mapped.close()


def test_a_wrench_of_no_use_is_named_as_well() -> None:
    with pytest.raises(DriverFailure, match=r"failed in apply_wrench: found .*no amplifier"):
        plugin(drivers.WrenchTorn)[1].apply_wrench([0.0] * 3, (0.0, 0.0, 0.1), Instant(0))


def bundle_of(data: dict[str, Any], clock: str = SIMULATED) -> DeviceBundle:
    bundle = cut(prepare(Session.from_dict(data), None), RunPlan(clock, None, ""))["pen"]
    assert isinstance(bundle, DeviceBundle)
    return bundle


SENSED = {"sensed": True, "stiffness": 0.3}
FELT = {"osp": 0.001, "stiffness": 0.3}


@pytest.mark.parametrize(
    ("data", "found"),
    [
        (
            told(driver="tests.support.plugin_drivers:Counterpart"),
            "which states no orientation; expected one",
        ),
        (told(sensed=True), "found a torque; expected sensed: true, for no motor turns its device"),
        (told(holds="tool"), "expected sensed: true, for its motors hold it in the tool's axes, of which nothing is"),
        (
            told(holds="joints"),
            r"expected sensed: true, or held: torque and linkage: \{kappa, length\} of all six",
        ),
        (told({**FELT, "limits": {"torque": 0.3, "speed": 30}}), r"limits.torque: found 0.3 N·m; expected at most 0.2"),
        (told({**FELT, "limits": {"torque": 0.2, "speed": 90}}), r"limits.speed: found 90 rad/s; expected at most 60"),
    ],
)
def test_a_session_that_promises_more_than_its_driver_is_refused(data: dict[str, Any], found: str) -> None:
    with pytest.raises(FactoryError, match=found) as refused:
        driver_of(bundle_of(data))
    assert "devices.pen" in str(refused.value)


@pytest.mark.parametrize("holds", ["world", "tool", "joints"])
def test_a_torque_that_a_session_does_not_use_keeps_nobody_out(holds: str) -> None:
    driver_of(bundle_of(told(SENSED, holds=holds))).close()
    driver_of(bundle_of(told(SENSED, sensed=True))).close()


@pytest.mark.parametrize(
    ("own", "found"),
    [
        ({"speed": 0.0}, "speed: found 0.0"),
        ({"speed": math.nan}, "speed: found nan"),
        ({"speed": 1.0, "torque": -1.0}, "torque: found -1.0"),
        ({"speed": 1.0, "holds": "hand"}, "holds: found 'hand'; expected one of world, tool, joints"),
    ],
)
def test_a_specification_that_is_none_is_refused(own: dict[str, Any], found: str) -> None:
    with pytest.raises(ValueError, match=found):
        OrientationSpecification(**own)


def test_an_orientation_stands_beside_three_axes_that_translate() -> None:
    of = OrientationSpecification(1.0)
    for axes, turning in ((2, None), (3, ("2",))):
        with pytest.raises(ValueError, match="3 axes that translate, and form a right-handed frame"):
            DeviceSpecification((1.0,) * axes, (1.0,) * axes, (1.0,) * axes, turning=turning, orientation=of)
    stated = DeviceSpecification((1.0,) * 3, (1.0,) * 3, (1.0,) * 3, orientation=of)
    assert stated.session_keys()["orientation"] == {"sensed": True}
    felt = replace(stated, orientation=OrientationSpecification(2.0, 0.1))
    assert felt.session_keys()["orientation"] == {"limits": {"torque": 0.1, "speed": 2.0}}


def ticks_of(kind: str, clock: str, orientation: dict[str, Any] | None = None) -> tuple[DeviceTick, Any]:
    bundle = bundle_of(told(orientation, driver=f"tests.support.turning_drivers:{kind}"), clock)
    driver = driver_of(bundle)
    assert isinstance(driver, PluginDriver)
    return tick_of(bundle, driver), driver._driver


@pytest.mark.parametrize("clock", [SIMULATED, REALTIME])
def test_a_torque_is_exerted_together_with_the_force_and_ends_with_it(clock: str) -> None:
    tick, pen = ticks_of("Pen", clock)
    proxy = [*turned_by(UPRIGHT, (0.1, 0.0, 0.0)), 1.0, 1.0]
    for k in range(5):
        at = Instant(k * 1_000_000)
        tick.sample(k, at)
        tick.exert([0.1, 0.0, 0.0], at, came=proxy)
        tick.book()
        assert tick.orientation is not None
        held = [torque for instant, torque in pen.torques if instant == at]
        assert held == [tick.orientation.torque]
        assert pen.torques[-1][0] == (at if clock == SIMULATED else at + 6_000_000)  # until a force is stale
    assert tick.orientation is not None
    assert tick.orientation.torque[0] > 0.0
    tick.release(Instant(5_000_000))
    assert pen.torques[-1][1] == (0.0, 0.0, 0.0)


def test_a_sensed_one_is_given_no_torque() -> None:
    tick, pen = ticks_of("WrenchTorn", SIMULATED, SENSED)
    for k in range(5):
        tick.sample(k, Instant(k * 1_000_000))
        tick.exert([0.1, 0.0, 0.0], Instant(k * 1_000_000), came=[*turned_by(UPRIGHT, (0.1, 0.0, 0.0)), 1.0, 1.0])
    assert not any(any(torque) for _, torque in pen.torques)
    assert tick.orientation is not None
    assert tick.row()[7:] == (tick.orientation.R,)


def test_its_proxy_begins_where_it_is() -> None:
    """A spring that began upright would turn a grip that is not, with energy that nobody gave."""
    own = DeviceOrientation(PART, T, RUNG, body=Late(np.random.default_rng(0), NO_DELAY, (0.0, 1.2, 0.0)))
    own.sample(0, Instant(0))
    assert own.spring.proxy == own.R
    assert own.exert(NO_RIDER, Instant(0)) == (0.0, 0.0, 0.0)


PART = OrientationPart(B, K, 0.8 * K, SPEED, None)


class Late:
    """A body whose samples are old, and whose torques act late and end by themselves."""

    def __init__(self, rng: np.random.Generator, timing: DeviceTiming, at: Vector3 = (0.0, 0.0, 0.0)) -> None:
        times = (np.arange(200) * T).tolist()
        self.body = Measured(
            TurnedHand(
                1e-6, B, tuple({"times": times, "values": (0.4 * rng.standard_normal(200)).tolist()} for _ in "xyz")
            )
        )
        self.body.R = turned_by(UPRIGHT, at)
        self.rng, self.timing = rng, timing
        self.coming: list[tuple[int, Vector3]] = []

    def to(self, at: Instant) -> Quaternion:
        age = self.timing.sample_age - self.timing.jitter * self.rng.random()
        seen = at - from_seconds(age)
        while self.coming and self.coming[0][0] <= seen:
            instant, torque = self.coming.pop(0)
            self.body.apply(torque, Instant(instant))
        return self.body.to(Instant(max(0, seen)))

    def apply(self, u: Vector3, at: Instant, until: Instant | None = None) -> None:
        """It is told by :meth:`exert`."""

    def exert(self, u: Vector3, at: int, until: int) -> None:
        delay = from_seconds(self.timing.actuation_delay)
        self.coming = [one for one in self.coming if one[0] < at + delay]
        self.coming += [(at + delay, u), (until + delay, (0.0, 0.0, 0.0))]


@pytest.mark.parametrize("early", [False, True])
@pytest.mark.parametrize("seed", range(10))
def test_however_old_and_late_and_brief_it_is_it_gives_no_more_than_is_counted(seed: int, early: bool) -> None:
    rng = np.random.default_rng(seed)
    timing = DeviceTiming(0.3e-3, 0.1e-3, 0.2e-3)
    body = Late(rng, timing)
    of = DeviceOrientation(PART, T, RUNG, None, Duration(6 * from_seconds(T)), body, timing)
    s, lost = from_seconds(2 * T), 0
    for k in range(90):
        of.sample(k, Instant(s))
        lost += any(of.torque) and of.spring.proxy == of.R
        h, d = from_seconds(T), from_seconds(0.5e-3 * rng.random())
        if rng.random() < 0.1:
            h, d = (from_seconds(T * rng.uniform(1.0, 6.0)) for _ in "hd")
            d = min(d, h)
        a = s + d
        until = a + from_seconds(T * (rng.uniform(0.1, 3.0) if early and rng.random() < 0.5 else 6.0))
        of.exert(whatever(rng, of), Instant(a), until=Instant(until))
        body.exert(of.torque, a, until)
        assert body.body.put_in >= of.least - of.spring.late - 1e-12
        assert of.spring.account >= of.spring.deposited - of.spring.granted - 1e-12
        s += h
    assert body.body.fastest < SPEED
    assert of.spring.late > 0.0
    assert (lost > 3) == early


@pytest.mark.parametrize(
    ("h", "d", "late"), [(1.0, 0.4, False), (1.0, 0.6, True), (1.05, 0.4, False), (1.15, 0.4, True), (1.0, 0.0, False)]
)
def test_its_own_delay_and_jitter_count_with_those_of_the_loop(h: float, d: float, late: bool) -> None:
    """Of tau = 1 ms its own 0.5 ms leave 0.5 ms, and of periods of up to 1.2 ms its jitter of 0.1 ms leaves 1.1 ms."""
    timing = DeviceTiming(0.3e-3, 0.1e-3, 0.2e-3)
    of = DeviceOrientation(PART, T, RUNG, None, Duration(6 * from_seconds(T)), Turned(), timing)
    for k in range(3):
        of.sample(k, Instant(round(1e6 * h * k)))
        of.exert([*turned_by(UPRIGHT, (0.1, 0.0, 0.0)), 1.0, of.life], Instant(round(1e6 * (h * k + d))))
    assert any(of.torque)
    assert (of.spring.late > 0.0) == late


class Turned:
    """A body that nothing turns."""

    def to(self, at: Instant) -> Quaternion:
        return UPRIGHT

    def apply(self, u: Vector3, at: Instant, until: Instant | None = None) -> None:
        """It stays."""


@pytest.mark.parametrize(("ends", "lost"), [(0.9, True), (0.95, True), (1.6, False)])
def test_a_torque_that_its_account_has_shortened_leaves_nothing_stored(
    ends: float, lost: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    tick, pen = ticks_of("Pen", REALTIME)
    own, interface = tick.orientation, tick.interface
    assert isinstance(own, DeviceOrientation)
    assert interface is not None
    proxy = [*turned_by(UPRIGHT, (0.1, 0.0, 0.0)), 1.0, own.life]
    tick.sample(0, Instant(0))
    tick.exert([0.0, 0.0, 0.0], Instant(0), came=proxy)
    before = own.torque
    tick.book()
    shorter = Instant(round(1e6 * (1.0 + ends)))

    def send(x: list[float], goal: list[float], at: Instant, work: float | None) -> list[float]:
        interface.shortened, interface.account.until = True, shorter
        return x

    monkeypatch.setattr(interface, "send", send)
    tick.sample(1, Instant(1_000_000))
    assert pen.torques[-1] == (shorter, (0.0, 0.0, 0.0))
    assert any(torque == before for _, torque in pen.torques)  # it goes on until then
    own.sample(2, Instant(2_000_000))
    assert (own.spring.proxy == own.R) == lost


@pytest.fixture(scope="module")
def prepared() -> Prepared:
    return prepare(Session.from_dict(told()), None)


def test_in_a_session_the_slot_holds_it_about_one_axis(prepared: Prepared) -> None:
    run = simulate(prepared, 250)
    account = values(run, "pen", "account")
    assert (account[:, 0] >= account[:, 1] - account[:, 2] - 1e-15).all()
    assert abs(values(run, "pen", "t_v")).max() > 1e-4
    R, Q = values(run, "pen", "R"), values(run, "pen", "Q")
    assert angle(Quaternion(*R[-1]), UPRIGHT) > 0.05
    assert angle(Quaternion(*R[-1]), Quaternion(*Q[-1])) < 0.2
