"""A device whose motors hold force and torque as torques of joints, in its tick: what it gives out is paid for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.session import Session
from manyhands.nodes.device.covered import CoveredHolds
from manyhands.nodes.device.drivers import driver_of
from manyhands.nodes.device.orientation import DeviceOrientation
from manyhands.nodes.device.tick import DeviceTick, tick_of
from manyhands.nodes.kernel.bundle import REALTIME, SIMULATED, DeviceBundle, OrientationPart, SensedPart
from manyhands.nodes.kernel.factory import FactoryError
from manyhands.nodes.kernel.orientation import NO_RIDER, UPRIGHT, Quaternion, turned_by
from manyhands.protocol.clock import Duration, Instant, from_seconds
from tests.support.slot import told
from tests.support.turning_arm import quaternion
from tests.support.twisting import Array, Gantry, Mechanism, bending, curvature, scale, straightest

T = 1e-3
TAU = 2e-4
MS = 1_000_000
FORCE, TORQUE, SPEED, TURNING = 4.0, 0.1, 0.5, 10.0

_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(4)


def twisted(kappa: float = 10.0, length: float = 0.05, tau: float = TAU, **parameters: Any) -> dict[str, Any]:
    """A session whose device holds torques of joints, as a driver of another package tells."""
    data = told(holds="joints", **parameters)
    pen = data["devices"]["pen"]
    pen |= {"held": "torque", "linkage": {"kappa": kappa, "length": length}}
    pen["limits"] |= {"force": FORCE, "speed": SPEED}
    pen["orientation"] |= {"osp": 0.01, "limits": {"torque": TORQUE, "speed": TURNING}}
    # a tank that lets late forces last: what ends them here is the rule alone
    faults = {"tank": {"energy": 1.0, "power": 1.0}}
    return data | {"design": {"coupling": "spring-damper", "tau": tau}, "faults": faults}


def bundle_of(data: dict[str, Any], clock: str = REALTIME) -> DeviceBundle:
    bundle = cut(prepare(Session.from_dict(data), None), RunPlan(clock, None, ""))["pen"]
    assert isinstance(bundle, DeviceBundle)
    return bundle


class Linked:
    """A driver whose joints a hand moves on a given way, whatever acts; it keeps what its motors held.

    Attributes:
        holds: by pair that acted, from and until when (s), the instant at which the joints were read, and f and m.
    """

    def __init__(self, of: Mechanism, knots: Array, every: float) -> None:
        self.of, self.knots, self.every = of, knots, every
        self.holds: list[tuple[float, float, float, Array]] = []
        self.at = 0.0

    def joints(self, t: float) -> Array:
        place = t / self.every
        k = min(int(place), len(self.knots) - 2)
        found: Array = self.knots[k] + (place - k) * (self.knots[k + 1] - self.knots[k])
        return found

    def sample(self, turn: int, at: Instant) -> Sequence[float]:
        self.at = at * 1e-9
        x: list[float] = (self.of.place(self.joints(self.at))[1] - self.of.place(self.knots[0])[1]).tolist()
        return x

    def orientation(self) -> Quaternion:
        return quaternion(self.of.place(self.joints(self.at))[0])

    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> None:
        raise AssertionError("found a force without its torque")

    def apply_wrench(
        self, f: Sequence[float], torque: Sequence[float], at: Instant, until: Instant | None = None
    ) -> list[float]:
        now = at * 1e-9
        self.release(at)
        end = np.inf if until is None else max(now, until * 1e-9)
        self.holds.append((now, end, max(self.at, now - 5e-5), np.array([*f, *torque])))
        x: list[float] = (self.of.place(self.joints(now))[1] - self.of.place(self.knots[0])[1]).tolist()
        return x

    def release(self, at: Instant) -> None:
        if self.holds:
            begun, end, read, wrench = self.holds[-1]
            self.holds[-1] = begun, min(end, at * 1e-9), read, wrench

    def intended_work(self) -> float:
        return 0.0

    def given_out(self, until: float) -> tuple[Array, Array]:
        """What the motors gave out beyond f^T integral v + m^T integral omega, J; and the integral of |xi|^2."""
        ends = [t for begun, end, _, _ in self.holds for t in (begun, min(end, until))]
        instants = np.unique(np.concatenate([ends, np.arange(0.0, until, self.every), [until]]))
        instants = instants[instants <= until]
        q = np.array([self.joints(t) for t in instants])
        step = np.diff(q, axis=0)
        inner = q[:-1, None] + (_POINTS[:, None] + 1) / 2 * step[:, None]
        xi = np.einsum("ipab,ib->ipa", self.of.jacobian(inner), step)
        ahead = np.einsum("ipa,p->ia", xi, _WEIGHTS / 2)
        burnt = np.einsum("ipa,p->i", (scale(self.of) * xi) ** 2, _WEIGHTS / 2) / np.diff(instants)
        middles, given = (instants[1:] + instants[:-1]) / 2, np.zeros(len(step))
        for begun, end, read, wrench in self.holds:
            acts = (middles > begun) & (middles < end)
            torques = self.of.jacobian(self.joints(read)).T @ wrench
            given[acts] += step[acts] @ torques - ahead[acts] @ wrench
        return np.cumsum(given), np.cumsum(burnt)


def swung(rng: np.random.Generator, of: Gantry, seconds: float, every: float, kind: int) -> Array:
    """Joints at knots: on in the direction in which even motion bends most (0), or to and fro in it (1), or freely."""
    count = int(seconds / every) + 2
    knots = np.zeros((count, 6))
    knots[0, 4:] = rng.uniform(-0.2, 0.2), rng.uniform(-np.pi, np.pi)
    best, sign = straightest(bending(of, knots[:1]), rng)[0], 1.0
    for i in range(1, count):
        sign = -sign if kind == 1 and rng.random() < 0.05 else sign
        wanted = rng.standard_normal(6) if kind == 2 else sign * best
        wanted *= 0.4 / np.linalg.norm(wanted) / scale(of)  # at most 0.4 m/s, and 8 rad/s
        rate = np.linalg.solve(of.jacobian(knots[i - 1]), wanted) * every
        there = knots[i - 1] + rate
        if abs(there[4]) > of.high[4]:
            sign, there = -sign, knots[i - 1]
        knots[i] = there
    return knots


def course(rng: np.random.Generator, tick: DeviceTick, driver: Linked, ticks: int, late: float) -> float:
    """Run so many ticks, of which ``late`` are late; returns the instant of the end, s."""
    now = Instant(0)
    for k in range(ticks):
        tick.sample(k, now)
        if rng.random() < 0.05:  # no answer comes
            tick.free(now)
            now = Instant(now + MS)
            continue
        lateness = rng.uniform(TAU, 3 * T) if rng.random() < late else rng.uniform(0.0, TAU)
        at = Instant(now + from_seconds(lateness))
        f = rng.standard_normal(3)
        z = driver.of.jacobian(driver.joints(now * 1e-9))[:3] @ np.ones(6) if rng.random() < 0.5 else f
        asked = (FORCE * np.sign(z)).tolist()
        proxy = turned_by(tick.orientation.R if tick.orientation else UPRIGHT, rng.standard_normal(3).tolist())
        tick.exert(asked, at, came=[*proxy, 1.0, 1.0])
        tick.book()
        span = rng.uniform(1.0, 4.0) if rng.random() < late else rng.uniform(0.7, 1.0)
        now = max(Instant(now + int(span * MS)), at)
    tick.release(now)
    return now * 1e-9


OF = Gantry(np.array([0.05, 0.0, 0.02]), 0.6, 0.05)


@pytest.fixture(scope="module")
def bundle() -> DeviceBundle:
    """Of a session with the kappa of the mechanism."""
    return bundle_of(twisted(1.05 * curvature(OF, np.random.default_rng(0), poses=200, closer=3)))


def device(rng: np.random.Generator, bundle: DeviceBundle, ticks: int, kind: int) -> tuple[DeviceTick, Linked, float]:
    """A tick, the driver below it, and the damping that is set aside, N*s/m."""
    driver = Linked(OF, swung(rng, OF, ticks * 5 * T, T / 4, kind), T / 4)
    assert bundle.held is not None
    return tick_of(bundle, driver), driver, bundle.held.damping(T, TAU, 0.0)  # type: ignore[arg-type]


@pytest.mark.parametrize("late", [0.0, 0.2, 0.8])
def test_what_held_torques_give_out_is_paid_for_however_late_answers_come(bundle: DeviceBundle, late: float) -> None:
    acted = 0
    for seed in range(6):
        rng = np.random.default_rng([seed, int(10 * late)])
        tick, driver, d = device(rng, bundle, 40, seed % 3)
        end = course(rng, tick, driver, 40, late)
        given, burnt = driver.given_out(end)
        assert (d * burnt - given).min() >= -1e-12
        acted += sum(bool(np.any(wrench)) and stop > begun for begun, stop, _, wrench in driver.holds)
    assert acted > 30


def test_without_the_rule_it_is_not(bundle: DeviceBundle) -> None:
    """A constant force, on a way that bends, with answers that come every six periods."""
    spare = {}
    for ruled in (True, False):
        tick, driver, d = device(np.random.default_rng(5), bundle, 20, 0)
        if not ruled:
            tick._covered = None
        began, rate = driver.knots[0], driver.knots[1] - driver.knots[0]
        u = scale(OF) * (OF.jacobian(began) @ rate)
        f = -FORCE * np.sign(np.einsum("acd,c,d->a", bending(OF, began), u, u)[:3])
        now = Instant(0)
        for k in range(12):
            tick.sample(k, now)
            tick.exert(f.tolist(), now, came=NO_RIDER)
            tick.book()
            now = Instant(now + 6 * MS)
        tick.release(now)
        given, burnt = driver.given_out(now * 1e-9)
        spare[ruled] = float((d * burnt - given).min())
    assert spare[True] >= -1e-12
    assert spare[False] < -1e-5


def test_a_pair_that_comes_late_does_not_act_and_none_acts_longer(bundle: DeviceBundle) -> None:
    tick, driver, _ = device(np.random.default_rng(1), bundle, 10, 1)
    assert isinstance(tick.orientation, DeviceOrientation)
    proxy = [*turned_by(tick.orientation.R, (0.1, 0.0, 0.0)), 1.0, 1.0]
    for k, late in enumerate((0, 200_000, 200_001, 0)):
        now = Instant(k * MS)
        tick.sample(k, now)
        tick.exert([1.0, 0.0, 0.0], Instant(now + late), came=proxy)
        tick.book()
        begun, end, _, wrench = driver.holds[-1]
        if k == 2:
            assert not wrench.any()
            assert not any(tick.held)
            assert not any(tick.orientation.torque)
        else:
            assert wrench[0] > 0.0
            assert end <= (now + MS + 200_000) * 1e-9 + 1e-12
        assert begun == pytest.approx((now + late) * 1e-9)


def test_a_device_that_turns_faster_than_its_limit_lets_go_of_its_force_as_well(bundle: DeviceBundle) -> None:
    """Its speeds bound what its joints give out beyond force and torque."""
    driver = Linked(OF, np.zeros((2, 6)), 1.0)
    tick = tick_of(bundle, driver)  # type: ignore[arg-type]
    for k, rate in enumerate((0.0, 0.9, 1.1, 0.0)):
        driver.knots = driver.knots + np.array([0.0, 0.0, 0.0, rate * TURNING * T, 0.0, 0.0])
        tick.sample(k, Instant(k * MS))
        tick.exert([1.0, 0.0, 0.0], Instant(k * MS), came=NO_RIDER)
        tick.book()
        assert bool(any(tick.held)) == (k != 2)
        assert driver.holds[-1][3].any() == (k != 2)


def test_a_driver_that_measures_and_acts_late_is_counted_with_that(bundle: DeviceBundle) -> None:
    covered = CoveredHolds(T, Duration(150_000))
    rung = bundle.rungs[0]
    assert covered.until(Instant(0), Instant(50_000), rung) == 1_050_000
    assert covered.until(Instant(MS), Instant(MS + 50_001), rung) is None
    assert covered.until(Instant(199_999), Instant(200_000), rung) is None  # sampled before the last one acted
    assert covered.until(Instant(200_000), Instant(200_000), rung) == 1_250_000


def test_its_torque_counts_on_what_the_joints_leave(bundle: DeviceBundle) -> None:
    assert bundle.twisting is not None
    assert len(bundle.rungs) > 1
    for rung, level in zip(bundle.rungs, bundle.levels, strict=True):
        taken = bundle.twisting.turning(T, rung.tau, rung.period_tolerance)
        assert 0.0 < taken < 0.01
        assert bundle.turning_osp(rung) == pytest.approx(0.01 - taken)
        assert np.diag(level) == pytest.approx([1.37 - taken / 0.05**2] * 3)


@pytest.mark.parametrize("clock", [SIMULATED, REALTIME])
def test_the_driver_says_that_joints_hold_its_torque_and_need_not_tell_work(clock: str) -> None:
    driver_of(bundle_of(twisted(), clock)).close()
    other = twisted()
    other["devices"]["pen"] |= {"held": "force"}
    del other["devices"]["pen"]["linkage"]
    with pytest.raises(FactoryError, match=r"or held: torque and linkage: \{kappa, length\} of all six directions"):
        driver_of(bundle_of(other, clock))


def test_a_bundle_whose_joints_cannot_be_paid_for_is_refused(bundle: DeviceBundle) -> None:
    assert bundle.held is not None
    assert isinstance(bundle.orientation, OrientationPart)
    sensed = SensedPart(0.3, None)
    for changes, found in (
        ({"orientation": None}, "expected a torque of an orientation"),
        ({"orientation": sensed}, "expected a torque of an orientation"),
        ({"orientation": replace(bundle.orientation, osp=1e-5)}, "leave nothing of an orientation's osp"),
    ):
        with pytest.raises(ValueError, match=found):
            replace(bundle, **changes)  # type: ignore[arg-type]
