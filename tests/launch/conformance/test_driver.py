"""The suite for drivers: a good one passes, and each broken one is named for what it is."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from manyhands.design.budget import stiffest
from manyhands.design.models.axis import TRANSLATING
from manyhands.launch.conformance.driver import (
    BLOCKING,
    EXCEPTION,
    FORCE,
    MOTION,
    RELEASE,
    SIGN,
    SILENCE,
    STALE,
    SWAPPED,
    UNIT,
    WORK,
    WRONG_ANSWER,
    Bench,
    Push,
    _estimate,
    check_driver,
    checked_apart,
)
from manyhands.launch.conformance.judgement import Conformance, Judgement, broken
from manyhands.launch.conformance.timing import CallTimer
from manyhands.nodes.device.plugin import DeviceDriver, PluginDriver
from manyhands.nodes.device.specification import AxisMap, DeviceSpecification
from manyhands.protocol.clock import Instant, SimulatedClock

from ...support import plugin_drivers as drivers

T = 1e-3


def bench_of(kind: type[DeviceDriver], axes: int = 2, period: float = T, **parameters: Any) -> tuple[Bench, Any]:
    driver = kind(tuple(f"d.{axis}" for axis in range(axes)), period, parameters)  # type: ignore[call-arg]
    stated = driver.specification()
    plugin = PluginDriver(kind.__name__, driver, AxisMap(tuple(range(axes)), (1.0,) * axes), stated, period)
    return Bench(plugin, period, SimulatedClock(), CallTimer(drivers.CALLS, lambda: 0)), stated


def findings(kind: type[DeviceDriver], axes: int = 2, push: Push | None = Push(), **parameters: Any) -> list[Judgement]:  # noqa: B008
    return list(check_driver(*bench_of(kind, axes, **parameters), push))


@pytest.mark.parametrize("axes", [1, 2, 3])
@pytest.mark.parametrize("damping", [0.0, 0.1, 1.5, 10.0])
def test_a_good_driver_keeps_everything(axes: int, damping: float) -> None:
    found = findings(drivers.Counterpart, axes, damping=damping)
    assert {finding.verdict for finding in found} == {Conformance.KEPT}, found
    assert {STALE, SIGN, UNIT, RELEASE, SILENCE, EXCEPTION, BLOCKING, SWAPPED} <= {finding.check for finding in found}


class Rotor(drivers.Counterpart):
    """A light rotor, whose driver does not state its inertia."""

    def specification(self) -> DeviceSpecification:
        return replace(super().specification(), mass=None, turning=("0",))


def test_a_rotor_is_no_wrong_unit_and_is_told_in_its_units() -> None:
    """As a mass, what it has would be far below what a hand can hold."""
    own: dict[str, Any] = {"mass": 0.0005, "damping": 0.02, "push": Push(0.005, 0.2)}
    found = findings(Rotor, 1, **own)
    assert broken(found) == []
    told = " ".join(finding.text for finding in found)
    assert re.search(r"0\.005 N·m move 0\.0005\d* kg·m² on its axis", told), told
    assert re.search(r"it seems to damp \S+ N·m·s/rad, and \S+ N·m, on its axis, worth \S+ N·m/rad", told)
    assert re.search(r"samples up to \S+ rad, within", told)
    assert not re.search(r" (N|m|kg|N/m|N·s/m)\b(?![·/])", told), told

    class Slide(Rotor):
        def specification(self) -> DeviceSpecification:
            return replace(super().specification(), turning=())

    assert broken(findings(Slide, 1, **own)) == [UNIT]


@pytest.mark.parametrize("friction", [0.01, 0.05, 0.15])
@pytest.mark.parametrize("damping", [0.1, 1.5])
def test_dry_friction_of_a_counterpart_is_no_wrong_force(friction: float, damping: float) -> None:
    found = findings(drivers.Counterpart, 1, friction=friction, damping=damping)
    assert {finding.verdict for finding in found} == {Conformance.KEPT}, found
    assert "wrong force" in broken(findings(drivers.Slightly, 1, friction=friction, damping=damping))


@pytest.mark.parametrize("friction", [0.0, 0.05, 0.15])
@pytest.mark.parametrize("damping", [0.05, 0.4, 1.5])
@pytest.mark.parametrize("step", [0.0, 5e-5])
def test_damping_and_friction_are_estimated_and_called_no_osp(step: float, damping: float, friction: float) -> None:
    """Within 0.04 N·s/m or a tenth, and 0.01 N: what was seen at this push of 0.5 N with steps of 50 µm."""
    own = {"mass": 0.15, "damping": damping, "friction": friction, "step": step, "push": Push(0.5, 0.05)}
    (text,) = [one.text for one in findings(drivers.Counterpart, 1, **own) if one.check == "estimate"]
    b, c = map(float, re.findall(r"damp (\S+) N·s/m, and (\S+) N,", text)[0])
    assert b == pytest.approx(damping, rel=0.1, abs=0.04)
    assert c == pytest.approx(friction, abs=0.012)
    worth = float(re.findall(r"worth (\S+) N/m", text)[0])
    assert worth == pytest.approx(2.0 * b / T, rel=0.15, abs=20.0)  # b is printed with two digits
    assert "an estimate, and no osp" in text


def test_the_first_step_of_a_coarse_encoder_is_waited_for() -> None:
    """0.2 kg take sqrt(2 m q/f) = 20 ms to move by 0.5 mm at 0.5 N; without the step that is an old sample."""
    coarse = {"step": 5e-4, "damping": 0.05, "push": Push(0.5, 0.2)}
    assert broken(findings(drivers.Counterpart, 1, **coarse)) == []
    assert broken(findings(drivers.Unstepped, 1, **coarse)) == [STALE]


@pytest.mark.parametrize("damping", [0.0, 1.5, 10.0])
@pytest.mark.parametrize(
    "timing", [{}, {"age": 2e-4, "delay": 1e-4, "timing": {"sample_age": 2e-4, "actuation_delay": 1e-4}}]
)
def test_the_work_of_motors_is_compared_with_what_the_ports_saw(damping: float, timing: dict[str, Any]) -> None:
    found = findings(drivers.Working, damping=damping, step=1e-6, **timing)
    assert {finding.verdict for finding in found} == {Conformance.KEPT}, found
    assert [finding.check for finding in found].count(WORK) == 2
    [text, *_] = (finding.text for finding in findings(drivers.WorkUnknown) if finding.check == WORK)
    assert text.startswith("the driver could not tell the work of a push on axis 0")


@pytest.mark.parametrize(
    ("kind", "fault"),
    [
        (drivers.WorkAgainst, "of the motors on the device, and not the other way round"),
        (drivers.WorkInMillijoules, "it is in J"),
        (drivers.WorkOfAll, "since the last answer, with the torques"),
        (drivers.WorkOfOneSample, "asked in one of 5 ticks; .* and not of the last tick alone"),
    ],
)
def test_wrong_books_are_named_for_their_fault(kind: type[DeviceDriver], fault: str) -> None:
    [text] = {finding.text for finding in findings(kind) if finding.verdict is Conformance.BROKEN}
    assert re.search(fault, text), text


@pytest.mark.parametrize("step", [1e-6, 1e-5, 5e-5])
def test_the_steps_of_an_encoder_are_no_fault(step: float) -> None:
    assert broken(findings(drivers.Counterpart, step=step)) == []


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        (drivers.OldSample, STALE),
        (drivers.HeldSample, STALE),
        (drivers.Frozen, STALE),
        (drivers.NoRelease, RELEASE),
        (drivers.KeptOnSilence, SILENCE),
        (drivers.WrongSign, SIGN),
        (drivers.Millimetres, UNIT),
        (drivers.Millinewtons, UNIT),
        (drivers.SwappedAxes, SWAPPED),
        (drivers.Blocking, BLOCKING),
        (drivers.SometimesSlow, BLOCKING),
        (drivers.Tenth, FORCE),
        (drivers.LateForce, STALE),
        (drivers.WorkAgainst, WORK),
        (drivers.WorkInMillijoules, WORK),
        (drivers.WorkOfAll, WORK),
        (drivers.WorkOfOneSample, WORK),
        (drivers.HoldsOn, STALE),  # the end of its force comes late
        (drivers.Raising, EXCEPTION),
        (drivers.WrongAnswer, WRONG_ANSWER),
    ],
    ids=lambda value: value.__name__ if isinstance(value, type) else None,
)
@pytest.mark.parametrize("damping", [0.1, 1.5])
def test_a_broken_driver_is_named_for_what_it_is(kind: type[DeviceDriver], name: str, damping: float) -> None:
    found = findings(kind, damping=damping)
    assert set(broken(found)) == {name}, found
    text = next(finding.text for finding in found if finding.verdict is Conformance.BROKEN)
    assert "found" in text
    assert "expected" in text


def silence_of(kind: type[DeviceDriver], **parameters: Any) -> Judgement:
    (found,) = [one for one in findings(kind, 1, push=Push(travel=0.05), **parameters) if one.check == SILENCE]
    return found


@pytest.mark.parametrize(("damping", "friction"), [(0.1, 0.0), (0.1, 0.15), (1.5, 0.0), (10.0, 0.0)])
@pytest.mark.parametrize(
    ("watchdog", "period", "asked"),
    [(20, 0.002, 12), (20, 0.001, 6), (10, 0.002, 4), (10, 0.004, None), (3, 0.001, None)],  # ms, s, ms
)
def test_a_watchdog_is_judged_by_the_time_that_a_session_of_this_period_counts_on(
    watchdog: int, period: float, asked: int | None, damping: float, friction: float
) -> None:
    """One of 20 ms outlives the 12 ms of a session of 2 ms; one of 10 ms outlives what its account may ask."""
    device = {"watchdog": watchdog * 1_000_000, "period": period, "damping": damping, "friction": friction}
    found = silence_of(drivers.Watchdog, **device)
    assert (found.verdict is Conformance.KEPT) == (asked is None), found
    if asked is not None:
        said = re.search(r"went on for (\S+) ms .* expected its end after (\S+) ms, its 'until'.*", found.text)
        assert said is not None, found.text
        assert float(said[1]) == pytest.approx(watchdog, rel=0.06)
        assert float(said[2]) == asked
        period = float(re.findall(r"a period of at least (\S+) ms$", found.text)[0]) * 1e-3
        assert silence_of(drivers.Watchdog, **{**device, "period": period}).verdict is Conformance.KEPT


def test_a_coarse_encoder_sees_only_the_end_of_longer_forces_or_of_none() -> None:
    found = silence_of(drivers.Counterpart, step=1e-4)
    assert found.verdict is Conformance.KEPT
    assert [float(asked) for asked in re.findall(r" of (\S+) ms", found.text)] == [6.0, 5.0]
    found = silence_of(drivers.Counterpart, step=3e-4)
    assert found.verdict is Conformance.OPEN
    assert found.text.startswith("a step of 0.0003 m is too coarse to see whether a force on its axis ends after 6 ms")
    assert silence_of(drivers.KeptOnSilence, step=1e-4).verdict is Conformance.BROKEN


@pytest.fixture
def endless() -> Iterator[None]:
    yield
    drivers.Endless.free()


@pytest.mark.usefixtures("endless")
def test_a_call_that_never_returns_is_named() -> None:
    bench, stated = bench_of(drivers.Endless)
    found = checked_apart(bench, lambda: list(check_driver(bench, stated, None)), patience=0.05)
    assert broken(found) == [BLOCKING]
    assert "sample has not returned" in found[0].text


def test_without_a_push_nothing_about_forces_is_judged() -> None:
    found = findings(drivers.Raising, push=None)  # it raises at a force
    assert broken(found) == []
    assert {finding.check for finding in found if finding.verdict is Conformance.OPEN} == {
        STALE, SWAPPED, SIGN, RELEASE, SILENCE,
    }  # fmt: skip


def test_a_device_that_moves_by_itself_is_not_judged_by_pushes() -> None:
    found = findings(drivers.MovesByItself)
    skipped = {finding.check: finding.text for finding in found if finding.verdict is Conformance.OPEN}
    assert skipped.keys() == {STALE, SWAPPED, SIGN, RELEASE, SILENCE}
    assert {*skipped.values()} == {"skipped: the driver states that no force moves its device (moved_by_force=False)"}
    assert broken(found) == []
    bench, stated = bench_of(drivers.MovesByItself)
    pushed = list(check_driver(bench, replace(stated, moved_by_force=True), Push()))  # as if it were pushed
    assert broken(pushed) == [MOTION]


@pytest.mark.parametrize(
    ("kind", "found"),
    [
        (
            drivers.MovesByItself,
            "found a device that moves by itself: its acceleration changes by ±0.24 m/s² without a ",
        ),
        (drivers.Drifting, "found a device that moves by 0.00199 m without a force, and no differently for a push"),
    ],
)
def test_a_motion_without_force_is_no_answer(kind: type[DeviceDriver], found: str) -> None:
    """Nor is it a wrong sign; of hardware nothing is judged, for somebody may hold it."""
    for hardware in (False, True):
        bench, stated = bench_of(kind)
        judged = list(check_driver(bench, replace(stated, moved_by_force=True, hardware=hardware), Push()))
        first = next(one for one in judged if one.check == MOTION)
        assert (first.verdict, first.text[: len(found)]) == (
            Conformance.OPEN if hardware else Conformance.BROKEN,
            found,
        )
        assert first.text.endswith("a driver whose device no force moves states moved_by_force=False")
        assert broken(judged) == ([] if hardware else [MOTION])
        assert {SIGN, SWAPPED, STALE, UNIT} & {one.check for one in judged if one.verdict is Conformance.OPEN} == set()


@pytest.mark.parametrize("spring", [100, 500, 2000])
def test_a_spring_of_the_devices_own_is_no_wrong_sign_and_no_delay(spring: int) -> None:
    """One of 2000 N/m drives 0.2 kg back within the push of 60 ms."""
    judged = findings(drivers.Sprung, spring=spring)
    assert broken(judged) == []
    assert [one.text for one in judged if one.check == MOTION] == [
        f"a spring of about {spring} N/m hides the rest on axis {axis}: switch off its own springs or centring for this"
        for axis in (0, 1)
    ]
    assert [one.verdict for one in judged if one.check == SIGN] == [Conformance.KEPT] * 2


class SprungAndWrong(drivers.Sprung):
    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> Sequence[float] | None:
        return super().apply([-force for force in f], at, until)


@pytest.mark.parametrize("spring", [1, 100])
def test_a_wrong_sign_is_one_with_a_spring_as_well(spring: int) -> None:
    assert broken(findings(SprungAndWrong, spring=spring)) == [SIGN]


@pytest.mark.parametrize(("age", "delay"), [(0.004, 0.0), (0.0, 0.003), (0.002, 0.003)])
def test_a_stated_delay_is_no_fault_and_an_unstated_one_is(age: float, delay: float) -> None:
    late = {"age": age, "delay": delay}
    assert broken(findings(drivers.Counterpart, **late, timing={"sample_age": age, "actuation_delay": delay})) == []
    unstated = findings(drivers.Counterpart, **late)
    assert set(broken(unstated)) == {STALE}
    (text,) = {
        finding.text.partition("ms late")[0][-8:] for finding in unstated if finding.verdict is Conformance.BROKEN
    }
    assert float(text.split()[-1]) == pytest.approx(1e3 * (age + delay), abs=1.0)


def test_a_hardware_that_something_holds_is_not_judged() -> None:
    found = findings(drivers.Counterpart, 1, mass=1e15, hardware=True)
    assert broken(found) == []
    assert [finding.check for finding in found if finding.verdict is Conformance.OPEN] == [STALE]


@pytest.mark.parametrize("kind", [drivers.Threefold, drivers.Tenth])
@pytest.mark.parametrize("hardware", [False, True])
def test_a_driver_that_measures_a_wrong_force_is_named(kind: type[DeviceDriver], hardware: bool) -> None:
    """By its own measurement, whatever its mass; three times the force is 19 % of its limit too much at 0.5 N."""
    found = findings(kind, measures=True, hardware=hardware, push=Push(5.0))
    assert FORCE in broken(found), found


@pytest.mark.parametrize(
    ("latency", "jitter", "worth"),
    [(0.0, 0.0, 400.0), (2e-4, 0.0, 0.2 / 8e-4), (2e-4, 1e-4, 0.2 / 8.5e-4), (1e-3, 0.0, 100.0), (1.1e-3, 0.0, None)],
)
def test_an_estimate_is_worth_what_the_budget_says(latency: float, jitter: float, worth: float | None) -> None:
    fit = SimpleNamespace(damping=0.2, friction=0.0)
    text = _estimate(cast(Any, fit), "at x", 1e-3, latency, jitter, TRANSLATING).text
    if worth is None:
        assert "worth nothing in this period" in text
        return
    assert float(re.findall(r"worth (\S+) N/m", text)[0]) == pytest.approx(worth, rel=5e-3)
    limit = stiffest(0.2 * np.eye(1), 1e-3, latency, period_tolerance=jitter / 1e-3).certified
    assert limit == pytest.approx(worth)
