"""Sets of damping and friction: the truth is in each as long as errors are within the bounds that were given."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from manyhands.design.identification import (
    Doubt,
    Identified,
    MeasuredMotion,
    NotOfThisClass,
    TooLittle,
    damping_set,
    encoder_step,
    lines,
    measured_line,
)

Array = NDArray[np.float64]
T = 2e-3
AXIS = np.array([1.0])
TRAVEL = 0.03


def motion(
    level: int,
    speed: float,
    m: float,
    b: float,
    c: float,
    g: float = 0.0,
    late: float = 0.0,
    drag: float = 0.0,
    power: float = 2.0,
) -> MeasuredMotion:
    """A smooth stroke to and fro with the force that it takes, in closed form; samples are ``late`` s old."""
    omega = speed / TRAVEL
    t = np.arange(0.0, 2.75 * 2.0 * np.pi / omega, T)
    middle = t + 0.5 * T  # a force is held: that of the middle of its tick
    v, a = speed * np.cos(omega * middle), -speed * omega * np.sin(omega * middle)
    f = m * a + b * v + drag * np.sign(v) * np.abs(v) ** power + c * np.sign(v) - g
    turns = np.flatnonzero(np.diff(np.floor(omega * t / np.pi + 0.5)))
    x = TRAVEL * np.sin(omega * (t - late))
    return MeasuredMotion(t, x[:, None], t, f[:, None], level, tuple(int(turn) + 1 for turn in turns))


SPEEDS = (0.03, 0.06, 0.12, 0.25)


def found(doubt: Doubt, motions: list[MeasuredMotion]) -> Identified:
    return damping_set(measured_line(motions, AXIS, doubt))


@settings(max_examples=12, deadline=None)
@given(
    m=st.floats(0.03, 1.0),
    b=st.floats(0.02, 2.0),
    c=st.floats(0.0, 1.0),
    g=st.floats(-2.0, 2.0),
    delta=st.sampled_from([1e-6, 1e-5, 5e-5]),
    seed=st.integers(0, 2**31),
)
def test_the_truth_is_in_the_set_whatever_the_errors_within_their_bound(
    m: float, b: float, c: float, g: float, delta: float, seed: int
) -> None:
    random = np.random.default_rng(seed)
    motions = []
    for level, speed in enumerate(SPEEDS):
        one = motion(level, speed, m, b, c, g)
        # rounding, a random sign at every tick, or one that turns round with the stroke: the worst for a work
        error = (delta * np.sign(one.f - np.mean(one.f))) if seed % 2 else random.choice([-delta, delta], one.x.shape)
        motions.append(dataclasses.replace(one, x=one.x + error))
    identified = found(Doubt(delta), motions)
    assert identified.damping.holds(b)
    assert identified.friction[0].low <= c
    assert identified.mass[0].low <= m <= identified.mass[0].high * 1.001


@pytest.mark.parametrize("late", [0.0, 0.0005, 0.001])
def test_a_delay_within_its_bounds_is_within_the_interval(late: float) -> None:
    motions = [motion(level, speed, 0.3, 0.1, 0.1, late=late) for level, speed in enumerate(SPEEDS)]
    assert found(Doubt(1e-6, (0.0, 0.001)), motions).damping.holds(0.1)


@pytest.mark.parametrize("late", [-0.003, -0.01])
def test_a_delay_that_is_denied_looks_like_drag_and_adds_nothing_to_the_lower_end(late: float) -> None:
    """It seems to burn m omega^2 v^2 times the delay, with an omega that grows with the speed: without drag in the
    class, that was damping.
    """
    motions = [motion(level, speed, 0.3, 0.1, 0.1, late=late) for level, speed in enumerate(SPEEDS)]
    identified = found(Doubt(1e-7), motions)
    assert identified.damping.low <= 0.1
    assert identified.stribeck


def test_a_known_delay_is_taken_out_and_costs_nothing() -> None:
    """Taken as 0, it would let this damping be up to 0.4 N*s/m."""
    motions = [motion(level, speed, 0.3, 0.1, 0.1, late=0.003) for level, speed in enumerate(SPEEDS)]
    damping = found(Doubt(1e-7, (0.003, 0.003)), motions).damping
    assert 0.09 < damping.low <= 0.1 <= damping.high < 0.11


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_error_of_displacement_that_goes_with_a_restless_force_is_within_the_bound_of_the_work(sign: float) -> None:
    """A force that alternates from tick to tick moves nothing from tick to tick; with such an error, it seems to work.

    A velocity is taken over an even number of ticks, and so this error is none of its: only the work has it.
    """
    motions = []
    for level, speed in enumerate(SPEEDS):
        one = motion(level, speed, 1.0, 0.3, 0.1)
        alternating = np.where(np.arange(len(one.sampled)) % 2, 1.0, -1.0)[:, None]
        motions.append(dataclasses.replace(one, x=one.x + sign * 1e-5 * alternating, f=one.f + 0.3 * alternating))
    assert found(Doubt(1e-5), motions).damping.holds(0.3)


@pytest.mark.parametrize("c", [0.0, 0.1])
@pytest.mark.parametrize("power", [1.5, 1.6, 2.0, 2.2, 3.0])
@pytest.mark.parametrize("b", [0.0, 0.1])
def test_drag_is_no_damping(b: float, power: float, c: float) -> None:
    """What is burned is at least osp v^2 at every speed, and of drag alone that is 0."""
    drag = 0.2 / SPEEDS[-1] ** (power - 1.0)  # at the greatest speed as much as 0.2 N*s/m
    motions = [motion(level, speed, 0.2, b, c, drag=drag, power=power) for level, speed in enumerate(SPEEDS)]
    identified = found(Doubt(1e-7), motions)
    assert identified.damping.holds(b)
    assert identified.friction[0].low <= c


def test_dry_friction_is_not_counted_as_damping() -> None:
    motions = [motion(level, speed, 0.2, 0.05, 0.5) for level, speed in enumerate(SPEEDS)]
    identified = found(Doubt(1e-6), motions)
    assert 0.03 < identified.damping.low <= 0.05
    assert 0.45 < identified.friction[0].low <= 0.5


def test_damping_that_falls_with_the_speed_is_not_of_the_class_or_claims_no_more() -> None:
    """Drag of -v|v|: the least of b - 0.6 v up to 0.25 m/s is what any claim has to stay below."""
    motions = [motion(level, speed, 0.2, 0.5, 0.02, drag=-1.0) for level, speed in enumerate(SPEEDS)]
    try:
        identified = found(Doubt(1e-6), motions)
    except NotOfThisClass:
        return
    assert identified.damping.low <= 0.5 - 0.5 * SPEEDS[-1]


def test_something_that_gives_energy_is_not_of_the_class() -> None:
    motions = [motion(level, speed, 0.2, -0.3, 0.0) for level, speed in enumerate(SPEEDS)]
    with pytest.raises(NotOfThisClass, match="a hand, a cable"):
        found(Doubt(1e-6), motions)


def test_a_single_speed_does_not_tell_damping_from_friction() -> None:
    with pytest.raises(TooLittle, match="expected two or more"):
        measured_line([motion(0, 0.1, 0.2, 0.3, 0.1)], AXIS, Doubt(1e-6))


def test_a_device_that_hardly_moves_is_refused() -> None:
    motions = [motion(level, speed, 0.2, 0.3, 0.1) for level, speed in enumerate(SPEEDS)]
    with pytest.raises(TooLittle, match="something holds the device"):
        measured_line(motions, AXIS, Doubt(0.002))


def test_the_step_of_an_encoder_is_found_and_nothing_where_there_is_none() -> None:
    x = 0.02 * np.sin(np.linspace(0.0, 7.0, 3000))
    step = encoder_step(3.7e-5 * np.round(x / 3.7e-5))
    assert step == pytest.approx(3.7e-5, rel=1e-9)
    assert encoder_step(x) is None


def test_the_lines_are_the_axes_and_the_full_diagonals() -> None:
    assert [line.tolist() for line in lines(2)] == [[1, 0], [0, 1], [1, 1], [1, -1]]
    assert len(lines(3)) == 7


def test_displacements_that_are_too_old_are_left_out() -> None:
    """One in fifty is 2 mm off; left in, they cost the whole answer."""
    motions = []
    for level, speed in enumerate(SPEEDS):
        one = motion(level, speed, 0.3, 0.1, 0.1)
        stale = np.arange(len(one.sampled)) % 50 == 17
        motions.append(dataclasses.replace(one, x=one.x + 2e-3 * stale[:, None], stale=stale))
    damping = found(Doubt(1e-6), motions).damping
    assert 0.08 < damping.low <= 0.1 <= damping.high < 0.12
    assert found(Doubt(1e-6), [dataclasses.replace(one, stale=None) for one in motions]).damping.low < 0.01
