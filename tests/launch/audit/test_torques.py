"""The work that a driver told of its motors, by its linkage along the recorded motion: no honest one is accused."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from manyhands.design.levels.held_torque import HeldTorque
from manyhands.design.models.linkage import greatest_bending, linkage_of
from manyhands.launch.audit.device import DeviceRows
from manyhands.launch.audit.events import Course, Happening
from manyhands.launch.audit.findings import Check, CheckVerdict
from manyhands.launch.audit.torques import torques_agree
from manyhands.nodes.kernel.bundle import WALL, DeviceBundle, Limits, PluginDevice
from manyhands.nodes.kernel.driver_statement import DeviceTiming
from manyhands.nodes.kernel.factory import FactoryName

from ...support.held_arm import Arm
from ...support.mechanisms import mechanism_bundle

TICKS = 40
ARM = Arm((0.3, 1.6))
LINKAGE = {
    "kind": "chain", "turns": ["z", "z"], "links": [[0.12, 0, 0], [0.14, 0, 0]],
    "low": [-0.1, 1.2], "high": [0.7, 2.0],
}  # fmt: skip
KAPPA = 1.05 * greatest_bending(linkage_of(LINKAGE))
LIMIT = 0.7  # m/s, on each axis


@dataclass(frozen=True)
class Motion:
    """A motion of the tip, m: a sum of two swings on each axis."""

    sizes: tuple[float, ...]
    rates: tuple[float, ...]

    def at(self, t: float) -> np.ndarray:
        a, b, c, d = (size * math.sin(rate * t) for size, rate in zip(self.sizes, self.rates, strict=True))
        return np.array([a + b, c + d])


@dataclass(frozen=True)
class Driver:
    """What a driver does that is honest.

    Attributes:
        step: of its encoders, m at the tip, or rad of each joint.
        of_joints: which of both.
        late: where the joints are read of which a torque is formed, from the sample to its force.
        own: whether its work is of its own readings; otherwise of the true joints.
        measures: whether it returns the displacement at each force.
        age: of its samples, s.
        delay: of its forces, s.
    """

    step: float = 1e-5
    of_joints: bool = False
    late: float = 0.0
    own: bool = True
    measures: bool = True
    age: float = 0.0
    delay: float = 0.0

    @property
    def stated(self) -> tuple[float, float]:
        """The step on each axis, m: the sum of both joints'."""
        return (0.4 * self.step,) * 2 if self.of_joints else (self.step,) * 2

    def seen(self, x: np.ndarray) -> np.ndarray:
        """The joints as they are read at x, rad."""
        q = ARM.joints(x)
        if self.step == 0.0:
            return q
        if self.of_joints:
            return self.step * np.floor(q / self.step + 0.5)
        return ARM.joints(self.step * np.floor(x / self.step + 0.5))


def recorded(driver: Driver, motion: Motion, forces: np.ndarray, delays: np.ndarray) -> DeviceRows:
    """The rows of a device that a hand moves, whose driver sums up the work of its motors."""

    def joints(t: float) -> np.ndarray:
        return driver.seen(motion.at(t))

    def told_of(t: float) -> np.ndarray:
        return joints(t) if driver.own else ARM.joints(motion.at(t))

    def torque(k: int) -> np.ndarray:
        return ARM.jacobian(joints(k * 1e-3 - driver.age + driver.late * (delays[k] + driver.age))).T @ forces[k]

    torques = [torque(k) for k in range(TICKS)]
    acts = [k * 1e-3 + delays[k] + driver.delay for k in range(TICKS)]
    x, applied, instants, work = [], [], [], []

    def done(begin: float, end: float) -> float:
        total, at = 0.0, begin
        for k in range(TICKS):
            until = min(end, acts[k + 1] if k + 1 < TICKS else math.inf)
            if until > max(at, acts[k]):
                start = max(at, acts[k])
                total += float(torques[k] @ (told_of(until) - told_of(start)))
                at = until
        return total

    before = -driver.age
    for k in range(TICKS):
        s, a = k * 1e-3, k * 1e-3 + delays[k]
        x.append(ARM.tip(joints(s - driver.age)))
        row = [done(before, s - driver.age), math.nan]
        before = s - driver.age
        if driver.measures:
            row[1], before = done(s, a), a
        applied.append(ARM.tip(joints(a)) if driver.measures else [math.nan] * 2)
        instants.append([round(1e9 * s), round(1e9 * a), round(1e9 * a)])
        work.append(row)
    rows = (np.array(one, dtype=float) for one in (x, forces, forces, instants, applied))
    return DeviceRows(*rows, None, np.zeros(TICKS, dtype=np.bool_), work=np.array(work))


def bundle_of(driver: Driver) -> DeviceBundle:
    source = PluginDevice(FactoryName("arm:driver", {}), 2, timing=DeviceTiming(driver.age, 0.0, driver.delay))
    held = HeldTorque(KAPPA, 12.0, LIMIT * math.sqrt(2.0), LINKAGE)
    limits = Limits((12.0,) * 2, (0.1,) * 2, (LIMIT,) * 2)
    return replace(
        mechanism_bundle(), source=source, osp=5.0 * np.eye(2), held=held, time=WALL, limits=limits,
    )  # fmt: skip


def judged(driver: Driver, rows: DeviceRows, course: Course | None = None, bundle: DeviceBundle | None = None) -> Check:
    course = course or Course({0: Happening(began=True)}, {}, TICKS)
    return torques_agree("d", bundle or bundle_of(driver), "arm:driver", driver.stated, rows, course)


@st.composite
def drivers(draw: st.DrawFn) -> Driver:
    of_joints, own, late = draw(st.booleans()), draw(st.booleans()), draw(st.sampled_from([0.0, 0.5, 1.0]))
    driver = Driver(draw(st.sampled_from([0.0, 1e-6, 1e-5, 1e-4])), of_joints, late, own, draw(st.booleans()))
    if driver.measures or draw(st.booleans()):
        return driver
    return replace(driver, age=draw(st.sampled_from([0.0, 3e-4])), delay=draw(st.sampled_from([0.0, 2e-4, 1e-3])))


@given(
    driver=drivers(),
    sizes=st.tuples(*[st.floats(0.0, 0.01)] * 4),
    rates=st.tuples(*[st.floats(1.0, 34.0)] * 4),
    size=st.sampled_from([0.0, 1.0, 5.0, 12.0]),
    smooth=st.booleans(),
    seed=st.integers(0, 2**32 - 1),
)
@settings(max_examples=60, deadline=None, phases=[Phase.explicit, Phase.generate])
def test_no_honest_driver_is_accused(
    driver: Driver, sizes: tuple[float, ...], rates: tuple[float, ...], size: float, smooth: bool, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    forces = (
        size
        / math.sqrt(2.0)
        * (np.repeat(rng.uniform(-1.0, 1.0, (1, 2)), TICKS, axis=0) if smooth else rng.uniform(-1.0, 1.0, (TICKS, 2)))
    )
    check = judged(driver, recorded(driver, Motion(sizes, rates), forces, rng.uniform(0.0, 4e-4, TICKS)))
    assert check.verdict is CheckVerdict.HOLDS
    assert check.numbers >= (2 if driver.measures else 1) * (TICKS - 4)


SWING = Motion((0.015, 0.0, 0.008, 0.0), (20.0, 1.0, 20.0, 1.0))  # up to 0.34 m/s
PUSH = np.repeat([[3.0, 1.0]], TICKS, axis=0)
LATE = np.full(TICKS, 3e-4)


@pytest.mark.parametrize("driver", [Driver(), Driver(measures=False), Driver(measures=False, age=3e-4, delay=2e-4)])
@pytest.mark.parametrize("wrong", [-1.0, 0.5, 2.0, 1e3], ids=["against", "halved", "twice", "in mJ"])
def test_a_wrong_work_is_named_with_its_driver(driver: Driver, wrong: float) -> None:
    rows = recorded(driver, SWING, PUSH, LATE)
    assert rows.work is not None
    assert judged(driver, rows).verdict is CheckVerdict.HOLDS
    check = judged(driver, replace(rows, work=wrong * rows.work))
    assert check.verdict is CheckVerdict.BROKEN
    assert check.differing > TICKS / 2
    assert "d: the driver arm:driver told another work of its motors than its linkage does" in check.remark


def test_forces_that_change_leave_a_work_as_sharp_where_the_device_measures_each_of_their_ways() -> None:
    """Elsewhere the way up to the force may have been any within the limit of speed."""
    forces = PUSH * np.where(np.arange(TICKS) % 2, 1.0, -1.0)[:, None]
    for measures, named in ((True, True), (False, False)):
        driver = Driver(measures=measures)
        rows = recorded(driver, SWING, forces, LATE)
        assert rows.work is not None
        assert judged(driver, rows).verdict is CheckVerdict.HOLDS
        halved = judged(driver, replace(rows, work=0.5 * rows.work))
        assert (halved.verdict is CheckVerdict.BROKEN) == named


def test_a_force_that_acts_a_period_late_is_the_one_of_which_the_work_is_told() -> None:
    driver = Driver(measures=False, delay=1e-3)
    forces = 12.0 * np.where(np.arange(TICKS) < 10, 0.0, 1.0)[:, None] * np.array([0.8, 0.6])
    slow = replace(bundle_of(driver), limits=Limits((12.0,) * 2, (0.1,) * 2, (0.35,) * 2))
    assert judged(driver, recorded(driver, SWING, forces, LATE), bundle=slow).verdict is CheckVerdict.HOLDS


def test_forces_of_another_axis_do_another_work() -> None:
    driver, rows = Driver(step=1e-6), recorded(Driver(step=1e-6), SWING, PUSH, LATE)
    assert judged(driver, replace(rows, f=rows.f[:, ::-1])).verdict is CheckVerdict.BROKEN


def test_what_the_recording_does_not_fix_is_not_judged() -> None:
    driver = Driver()
    rows = recorded(driver, SWING, PUSH, LATE)
    assert rows.work is not None
    wrong = rows.work.copy()
    wrong[10] = 1.0
    ended, unknown = rows.instants.copy(), wrong.copy()
    ended[10, 2] -= 350_000
    unknown[10] = math.inf
    began = Course({0: Happening(began=True), 10: Happening(released=1)}, {}, TICKS)
    for one, course, why in (
        (replace(rows, work=wrong, instants=ended), None, "a force ended by itself"),
        (replace(rows, work=unknown), None, "its driver could not tell the work"),
        (replace(rows, work=wrong), began, ""),
        (replace(rows, work=wrong, unexerted=10), None, "its hardware exerted another force"),
    ):
        check = judged(driver, one, course)
        assert check.verdict is CheckVerdict.HOLDS
        assert any(gap.begin == 10 for gap in check.gaps)
        assert not why or any(why in gap.why for gap in check.gaps)
    assert judged(driver, replace(rows, work=wrong)).verdict is CheckVerdict.BROKEN
    for way in (0.2, -0.05):  # where its links do not reach, and where its box ends
        far = replace(rows, x=rows.x + way, applied=rows.applied + way, work=wrong)
        assert judged(driver, far).verdict is CheckVerdict.UNCHECKED
    anyhow = replace(bundle_of(driver), limits=Limits((12.0,) * 2, (0.1,) * 2, (100.0,) * 2))
    assert judged(driver, replace(rows, work=wrong), bundle=anyhow).verdict is CheckVerdict.UNCHECKED


@pytest.mark.parametrize(("step", "kinematics"), [(None, True), ((1e-5, 1e-5), False)])
def test_a_work_that_nothing_follows_for_is_believed_and_that_is_said(
    step: tuple[float, float] | None, kinematics: bool
) -> None:
    bundle = bundle_of(Driver())
    assert bundle.held is not None
    if not kinematics:
        bundle = replace(bundle, held=replace(bundle.held, linkage=None))
    rows = recorded(Driver(), SWING, PUSH, LATE)
    check = torques_agree("d", bundle, "arm:driver", step, rows, Course({}, {}, TICKS))
    assert check.verdict is CheckVerdict.UNCHECKED
    (gap,) = check.gaps
    assert gap.why.startswith("the work that its driver told of its motors is believed: ")
    assert gap.why.endswith(
        "kappa is stated, and no kinematics" if not kinematics else "no step of its encoder is stated"
    )
