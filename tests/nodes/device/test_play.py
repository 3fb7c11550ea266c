"""The least way of a measured motion: never more than the way that was gone, and as much as any motion allows."""

from __future__ import annotations

import math
from fractions import Fraction
from itertools import pairwise

import pytest
from hypothesis import example, find, given, settings
from hypothesis import strategies as st

from manyhands.nodes.device.play import Play

WAYS = st.lists(st.floats(-1e-3, 1e-3), min_size=1, max_size=40)
STEPS = st.sampled_from([0.0, 1e-6, 1e-5, 64e-6, 1e-3])
PLACES = st.floats(-1.0, 1.0)
PARTS = st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=40)


def total(steps: float, samples: list[float]) -> Fraction:
    """The least way, by what the play adds up, m."""
    play = Play([steps])
    return sum((Fraction(play.moved([x])[0]) for x in samples), Fraction(0))


def gone(places: list[Fraction]) -> Fraction:
    return sum((abs(b - a) for a, b in pairwise(places)), Fraction(0))


def whole(x: Fraction, q: float, zero: float) -> float:
    """As an encoder with another zero gives it, m; its own arithmetic is in doubles."""
    return float(x) if q == 0.0 else q * math.floor(float((x - Fraction(zero)) / Fraction(q)) + 0.5) + zero


@given(begin=PLACES, ways=WAYS, q=STEPS, zero=st.floats(0.0, 1e-3))
@settings(max_examples=300, deadline=None)
def test_an_encoder_never_shows_more_than_was_gone(begin: float, ways: list[float], q: float, zero: float) -> None:
    places = [Fraction(begin)]
    for way in ways:
        places.append(places[-1] + Fraction(way))
    assert total(q, [whole(x, q, zero) for x in places]) <= gone(places)


@given(begin=PLACES, ways=WAYS, noise=PARTS, q=STEPS, seen=st.integers(1, 5))
@settings(max_examples=300, deadline=None)
@example(begin=0.0, ways=[0.0] * 4, noise=[1.0, -1.0], q=1e-5, seen=1)  # at rest, and toggling
def test_no_noise_within_half_a_step_and_no_sample_left_out_shows_more(
    begin: float, ways: list[float], noise: list[float], q: float, seen: int
) -> None:
    places = [Fraction(begin)]
    for way in ways:
        places.append(places[-1] + Fraction(way))
    error = [0.5 * q * noise[k % len(noise)] for k in range(len(places))]
    samples = [float(x + Fraction(d)) for x, d in zip(places, error, strict=True)]
    play, so_far = Play([q]), Fraction(0)
    for k in range(0, len(places), seen):
        so_far += Fraction(play.moved([samples[k]])[0])
        assert so_far <= gone(places[: k + 1])


@given(samples=st.lists(st.integers(-6, 6), min_size=1, max_size=12), q=st.sampled_from([1, 2, 3]))
@settings(max_examples=300, deadline=None)
def test_some_motion_that_the_samples_allow_is_no_longer(samples: list[int], q: int) -> None:
    """By all motions on a grid of q/2, whose edges the intervals have."""
    least = {2 * samples[0] + at: 0 for at in range(-q, q + 1)}
    for x in samples[1:]:
        least = {
            2 * x + at: min(way + abs(2 * x + at - place) for place, way in least.items()) for at in range(-q, q + 1)
        }
    shortest = min(least.values()) * 0.5
    assert float(total(float(q), [float(x) for x in samples])) == pytest.approx(shortest, abs=1e-9)


def test_the_sum_of_what_was_measured_counts_noise_as_way() -> None:
    """What a play is for: a device at rest at the edge of a step goes on for ever by its samples."""
    at_rest = find(
        st.lists(st.floats(-1.0, 1.0), min_size=2, max_size=8),
        lambda noise: sum(abs(b - a) for a, b in pairwise(noise)) > 2.0,
    )
    samples = [0.5e-5 * part for part in at_rest]
    assert sum(abs(b - a) for a, b in pairwise(samples)) > 0.0
    assert total(1e-5, samples) == 0


def test_a_long_way_one_way_lacks_the_first_step_alone() -> None:
    samples = [1e-5 * k for k in range(1001)]
    assert float(total(1e-5, samples)) == pytest.approx(1e-2 - 1e-5, rel=1e-9)
    assert float(total(1e-5, [*samples, *samples[::-1]])) == pytest.approx(2e-2 - 2e-5, rel=1e-9)


def test_each_axis_has_a_play_of_its_own() -> None:
    play = Play([1e-3, 0.0])
    assert play.moved([0.0, 0.0]) == [0.0, 0.0]
    assert play.moved([1e-3, 1e-3]) == [0.0, pytest.approx(1e-3, rel=1e-6)]
    assert play.moved([2e-3, 1e-3]) == [pytest.approx(1e-3, rel=1e-6), 0.0]


def test_the_rounding_of_a_drivers_own_arithmetic_is_no_way() -> None:
    for q in (0.0, 1e-5):
        assert total(q, [0.1 + (0.5 * q + 4e-13) * (-1.0) ** k for k in range(1000)]) == 0
