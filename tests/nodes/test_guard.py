"""A device's limits: what is let pass, what is clipped, and what ends the session."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.nodes.bundle import Limits
from manyhands.nodes.device.guard import Guard
from manyhands.nodes.saturation import Saturation

T = 1e-3
AXES = ("arm.0", "arm.1")
LIMITS = Limits(force=(8.0, 2.0), displacement=(0.2, 0.5), speed=(2.0, 1.0))


def guard() -> Guard:
    return Guard(LIMITS, T, AXES)


def test_a_force_within_its_limits_is_handed_on_as_it_is() -> None:
    g = guard()
    f = [8.0, -2.0]
    assert g.clip(f) is f
    assert g.clipped == 0


def test_a_force_beyond_is_clipped_axis_by_axis_and_counted_once_a_tick() -> None:
    g = guard()
    f = [-9.0, 3.0]
    np.testing.assert_array_equal(g.clip(f), [-8.0, 2.0])
    np.testing.assert_array_equal(f, [-9.0, 3.0])
    np.testing.assert_array_equal(g.clip([1.0, 2.5]), [1.0, 2.0])
    assert g.clipped == 2


def test_what_is_no_number_is_no_force() -> None:
    g = guard()
    np.testing.assert_array_equal(g.clip([math.nan, math.inf]), [0.0, 2.0])
    np.testing.assert_array_equal(g.clip([-math.inf, math.nan]), [-8.0, 0.0])
    assert g.clipped == 2


@given(st.lists(st.tuples(st.floats(), st.floats(0.0, 1e300)), min_size=1, max_size=6))
def test_whatever_the_force_it_is_within_and_changed_no_more_than_needed(pairs: list[tuple[float, float]]) -> None:
    f, limits = np.array([pair[0] for pair in pairs]), np.array([pair[1] for pair in pairs])
    saturation = Saturation(limits.tolist())
    clipped = np.array(saturation.clip(f.tolist()))
    assert np.all(np.abs(clipped) <= limits)
    within = np.abs(f) <= limits
    np.testing.assert_array_equal(clipped[within], f[within])
    assert np.all((np.sign(clipped) == np.sign(f)) | np.isnan(f) | (limits == 0.0))
    assert saturation.ticks == (not np.all(within))


def test_within_its_limits_nothing_is_breached() -> None:
    g = guard()
    for x in ([0.2, -0.5], [0.1981, -0.4991], [0.2, -0.5]):
        assert g.breach(x) is None


@pytest.mark.parametrize(
    ("x", "sentence"),
    [
        ([0.21, 0.0], "found a displacement of 0.21 m at arm.0; expected at most 0.2 m, its limit; see"),
        ([0.0, -0.6], "found a displacement of -0.6 m at arm.1; expected at most 0.5 m"),
        ([math.nan, 0.0], "found a displacement of nan m at arm.0"),
        ([0.0, math.inf], "found a displacement of inf m at arm.1"),
    ],
)
def test_a_displacement_beyond_is_told(x: list[float], sentence: str) -> None:
    g = guard()
    assert g.breach([0.0] * 2) is None
    found = g.breach(x)
    assert found is not None
    assert found.startswith(sentence)


def test_a_speed_beyond_is_told() -> None:
    g = guard()
    assert g.breach([0.1, 0.1]) is None
    assert g.breach([0.1, 0.1009]) is None
    found = g.breach([0.1, 0.0994])
    assert found is not None
    assert found.startswith("found a speed of -1.5 m/s at arm.1; expected at most 1 m/s, its limit; see")


def test_the_first_sample_has_no_speed() -> None:
    assert guard().breach([-0.2, 0.5]) is None


def test_a_speed_is_that_of_one_period() -> None:
    slow = Guard(LIMITS, 1.0, AXES)
    assert slow.breach([0.0] * 2) is None
    assert slow.breach([0.0, 0.5]) is None
