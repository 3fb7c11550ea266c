"""The experiment on random devices of known damping, in simulated time, and how it ends when something is wrong."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from manyhands.design.identification import Identified, NotOfThisClass
from manyhands.launch.files import TargetError, require_new_target
from manyhands.launch.identify.device_file import above, below, device_file, statement, write_device_file
from manyhands.launch.identify.experiment import AtPose, drag, experiment, poses
from manyhands.launch.identify.rig import Aborted, Late, Rig, Safety
from manyhands.nodes.device.plugin import PluginDriver
from manyhands.nodes.device.specification import AxisMap, DeviceSpecification, DeviceTiming
from manyhands.protocol.clock import Instant, SimulatedClock

from ...support.cases import WIDE
from ...support.identified_devices import identified, random_driver, summary
from ...support.identified_plants import PlantDriver, Slide

T = 2e-3
QUICK = Safety(force=3.0, travel=0.025)


def rig_of(driver: PlantDriver, safety: Safety = QUICK) -> Rig:
    m = driver.plant.axes
    plugin = PluginDriver("counterpart", driver, AxisMap(tuple(range(m)), (1.0,) * m), driver.stated, T)
    return Rig(plugin, driver.stated, T, SimulatedClock(), safety)


def found(driver: PlantDriver) -> AtPose:
    return experiment(rig_of(driver))


def test_no_lower_end_is_above_the_truth() -> None:
    numbers = [number for number in range(24 if WIDE else 14) if number % 10 or WIDE]
    lines, holds = summary([identified(number, seed=7) for number in numbers])
    assert holds, "\n".join(lines)


@pytest.mark.long
def test_of_an_arm_with_a_fine_encoder_more_than_half_of_the_least_damping_is_stated() -> None:
    arm = identified(70, seed=20261127)
    assert arm.kind == "arm"
    assert arm.useful
    assert arm.covered
    assert not arm.false


def test_the_devices_are_the_same_for_a_seed() -> None:
    first, second = (random_driver(3, 7)[0].plant for _ in range(2))
    assert first == second


def test_what_a_good_encoder_allows_is_tight() -> None:
    damping = found(PlantDriver(Slide(m=0.2, b=0.3, c=0.1), step=5e-6)).found.damping
    assert 0.23 < damping.low <= 0.3 <= damping.high < 0.4


def stating(driver: PlantDriver, **stated: Any) -> PlantDriver:
    driver.stated = replace(driver.stated, **stated)
    return driver


def test_a_device_whose_damping_is_great_beside_its_mass_is_found() -> None:
    """As of a small motor: what pushes it on at its greatest speed would throw it out of bounds at the least."""
    driver = PlantDriver(Slide(m=0.02, b=1.0, c=0.02), step=5e-6)
    damping = found(stating(driver, mass=(0.02,))).found.damping
    assert 0.9 < damping.low <= 1.0 <= damping.high < 1.1


@pytest.mark.long
@pytest.mark.parametrize("power", [1.5, 2.0, 3.0])
def test_of_drag_alone_nothing_is_stated(power: float) -> None:
    drag = 0.3 / 0.25 ** (power - 1.0)
    driver = PlantDriver(Slide(m=0.2, b=0.0, c=0.05, drag=drag, power=power), step=5e-6)
    at_pose = found(driver)
    assert at_pose.found.damping.low == 0.0
    said = statement([at_pose], driver.stated)
    assert said.osp is None
    assert at_pose.found.friction[0].low <= 0.05


@pytest.mark.long
def test_a_delay_that_the_driver_denies_makes_a_false_answer_or_none() -> None:
    """So the delay is used: a planted fault in the driver's statement is a fault in the answer."""
    truth = 0.05
    driver = PlantDriver(Slide(m=0.5, b=truth, c=0.02), step=1e-6, delay=0.006)
    try:
        identified: Identified | None = found(stating(driver, timing=DeviceTiming())).found
    except (NotOfThisClass, Aborted):
        identified = None
    assert identified is None or not identified.damping.holds(truth)
    assert found(PlantDriver(Slide(m=0.5, b=truth, c=0.02), step=1e-6, delay=0.006)).found.damping.low <= truth


# --- it ends


def test_a_key_ends_it_and_the_device_is_released() -> None:
    driver = PlantDriver(Slide())
    rig = rig_of(driver)
    looks = iter(range(1000))
    rig.stop = lambda: next(looks) > 20
    with pytest.raises(Aborted, match="stopped by a key"):
        experiment(rig)
    assert driver.released


class Pushed(Slide):
    """Somebody takes it away after a second."""

    count = 0

    def step(self, h: float) -> None:
        self.count += 1
        self.g = 8.0 if self.count * h > 1.0 else 0.0
        super().step(h)


def test_a_device_that_is_pushed_away_ends_it() -> None:
    driver = PlantDriver(Pushed(), h=5e-4)
    with pytest.raises(Aborted, match=r"expected at most|device's own limit"):
        found(driver)
    assert driver.released


class Standing(SimulatedClock):
    """A machine that gives the loop no turn for 0.4 s, once in its fastest motion (after 58 s) or in every second."""

    def __init__(self, every: float) -> None:
        super().__init__()
        self._every, self._next = every, 58.0

    def sleep_until(self, t: Instant) -> None:
        if 1e-9 * t > self._next:
            self._next += self._every
            t = Instant(t + 400_000_000)
        super().sleep_until(t)


def coasting(every: float) -> AtPose:
    """A heavy slide in a narrow room: without force it leaves its bounds."""
    driver = PlantDriver(Slide(m=0.8, b=0.05, c=0.0), step=5e-6)
    rig = rig_of(driver)
    rig = Rig(rig._driver, driver.stated, T, Standing(every), QUICK)
    told: list[str] = []
    at_pose = experiment(rig, told.append)
    assert any("once more, for a tick came 402 ms after the one before" in text for text in told)
    assert rig.late >= 1
    assert driver.released
    return at_pose


def test_a_motion_that_a_late_tick_let_out_of_bounds_is_begun_again() -> None:
    assert coasting(every=1e9).found.damping.low <= 0.05


def test_a_machine_that_is_late_again_and_again_ends_it_and_is_named_for_it() -> None:
    with pytest.raises(Late) as ended:
        coasting(every=1.0)
    assert str(ended.value).startswith("a tick came 402 ms after the one before, when its force had ended, and axis 0 ")
    assert "own limit" not in str(ended.value)
    assert "somebody" not in str(ended.value)


class Uneven(SimulatedClock):
    """Every 40th tick comes 14 ms late: none of its forces has ended by then."""

    ticks = 0

    def sleep_until(self, t: Instant) -> None:
        self.ticks += 1
        super().sleep_until(Instant(t + 14_000_000) if self.ticks % 40 == 0 else t)


def test_ticks_that_come_late_make_no_device_faster_than_it_is() -> None:
    """The velocity that a servo is told, and that is judged, is a mean of true ones, whenever the samples came."""
    driver = PlantDriver(Slide(m=0.2, b=0.3, c=0.0), step=0.0)
    rig = Rig(rig_of(driver)._driver, driver.stated, T, Uneven(), QUICK)
    told, true = [], []

    def push(x: Sequence[float], v: Sequence[float], t: float) -> list[float]:
        told.append(abs(v[0]))
        true.append(abs(driver.plant.v))
        return [0.5 * math.sin(20.0 * t)]

    rig.run(push, 5.0, 1.0)
    assert rig.late > 40
    assert rig.longest == pytest.approx(0.016)
    assert 0.95 * max(true) < max(told) <= max(true)


class Stalling(PlantDriver):
    """The program gets no turn for 30 ms within a call, before it reads: in every 400th tick from the 8000th on."""

    clock: SimulatedClock

    def sample(self, tick: int, at: Instant) -> Any:
        if tick > 8000 and tick % 400 == 0:
            self.clock.sleep_until(Instant(self.clock.now() + 30_000_000))
        return super().sample(tick, self.clock.now())


def test_a_call_that_stood_still_is_no_speed_of_the_device() -> None:
    driver = stating(Stalling(Slide(m=0.2, b=0.3, c=0.1), step=5e-6), speed=(0.3,))
    driver.clock = SimulatedClock()
    rig = Rig(rig_of(driver)._driver, driver.stated, 4e-3, driver.clock, replace(QUICK, speed=0.2))
    with pytest.raises(Late) as ended:
        experiment(rig)
    assert str(ended.value).startswith(
        "a call of the driver took 30 ms, within which nobody knows when it read: axis 0"
    )
    assert "own limit" not in str(ended.value)


def test_the_device_s_own_limits_end_it() -> None:
    small = DeviceSpecification((5.0,), (0.005,), (2.0,), hardware=False)
    driver = PlantDriver(Slide(), stated=small)
    with pytest.raises(Aborted, match="the device's own limit: begin nearer to the middle"):
        found(driver)
    assert driver.released


def test_no_force_is_greater_than_what_was_allowed() -> None:
    driver = PlantDriver(Slide(m=0.5, b=0.3, c=0.3))
    experiment(rig_of(driver, Safety(force=1.0, travel=0.02)))
    assert max(abs(f[0]) for f in driver.applied) <= 1.0


def test_a_failing_driver_is_released() -> None:
    class Failing(PlantDriver):
        def sample(self, tick: int, at: Any) -> Any:
            if tick > 500:
                raise OSError("unplugged")
            return super().sample(tick, at)

    driver = Failing(Slide())
    with pytest.raises(ValueError, match="unplugged"):
        found(driver)
    assert driver.released


# --- poses and the file


def test_it_is_dragged_from_pose_to_pose() -> None:
    driver = PlantDriver(Slide(c=0.05))
    rig = rig_of(driver)
    wanted = poses(rig.origin, rig, 3)
    assert [place[0] for place in wanted] == pytest.approx([0.0, 0.05, -0.05])
    drag(rig, wanted[1])
    assert driver.plant.place()[0] == pytest.approx(0.05, abs=0.01)


def test_there_may_be_no_room_for_poses() -> None:
    small = DeviceSpecification((5.0,), (0.045,), (2.0,), hardware=False)
    rig = rig_of(PlantDriver(Slide(), stated=small))
    with pytest.raises(ValueError, match="--poses: found 2"):
        poses(rig.origin, rig, 2)


@pytest.mark.parametrize(("value", "low", "high"), [(0.123456, 0.123, 0.124), (0.5, 0.5, 0.5), (1234.5, 1230, 1240)])
def test_numbers_are_rounded_to_the_safe_side(value: float, low: float, high: float) -> None:
    assert (below(value), above(value)) == (low, high)


def test_the_file_has_a_source_for_each_key_and_is_not_replaced(tmp_path: Path) -> None:
    driver = PlantDriver(Slide(m=0.2, b=0.3, c=0.1), step=5e-6, age=0.0002, delay=0.0001, jitter=0.0)
    said = statement([found(driver)], driver.stated)
    assert 0.0 < (said.osp or 0.0) <= 0.3
    assert 0.0 < (said.mass or 0.0) <= 0.2
    path = tmp_path / "slide.device.yaml"
    promised = driver.stated.promised()
    write_device_file(
        path, device_file("slide", "some:driver", {"port": "x"}, driver.stated, promised, 1, said, "2026-11-27")
    )
    read = yaml.safe_load(path.read_text())
    assert list(read) == ["device", "keys", "sources", "by_itself", "identification"]
    assert read["sources"].keys() == read["keys"].keys()
    assert read["keys"]["osp"] == said.osp
    assert read["keys"]["limits"] == {"force": 5.0, "displacement": 0.2, "speed": 2.0}
    assert read["keys"]["sample_age"] == 0.0002
    with pytest.raises(TargetError, match="--overwrite"):
        require_new_target(path, overwrite=False)
    require_new_target(path, overwrite=True)
