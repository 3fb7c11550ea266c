"""Decimation keeps every extreme of each bucket, however the trace is cut, and time keeps its order."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.nodes.monitor.tracks import Decimator, extremes

VALUES = st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=200)


def buckets_of(size: int, tick: int, values: list[float], cuts: list[int]) -> dict[int, list[tuple[float, float]]]:
    """What a decimator makes of a trace in pieces, by bucket."""
    decimator = Decimator(size, 1)
    bounds = [0, *sorted({cut % (len(values) + 1) for cut in cuts}), len(values)]
    found: dict[int, list[tuple[float, float]]] = {}
    for begin, end in pairwise(bounds):
        for piece in decimator.take(tick + begin, np.array(values[begin:end])[:, None]):
            for index, pair in enumerate(piece.values[:, :, 0].tolist()):
                found.setdefault(piece.first + index, []).append(tuple(pair))
    return found


@given(st.integers(1, 12), st.integers(0, 50), VALUES, st.lists(st.integers(0, 200), max_size=8))
def test_every_bucket_keeps_its_extremes_in_their_order(
    size: int, tick: int, values: list[float], cuts: list[int]
) -> None:
    found = buckets_of(size, tick, values, cuts)
    whole = range(-(-tick // size) if tick % size else tick // size, (tick + len(values)) // size)
    expected = {b: values[max(b * size - tick, 0) : (b + 1) * size - tick] for b in whole}
    assert set(expected) <= set(found)
    assert all(b * size < tick + len(values) for b in found)
    for bucket, inside in expected.items():
        [(first, second)] = found[bucket]
        assert {first, second} == {min(inside), max(inside)}
        assert inside.index(first) <= len(inside) - 1 - inside[::-1].index(second)


@given(VALUES)
def test_the_extremes_of_the_trace_are_in_what_is_drawn(values: list[float]) -> None:
    found = buckets_of(7, 0, values + [0.0] * (-len(values) % 7), [])
    drawn = [value for pairs in found.values() for pair in pairs for value in pair]
    assert max(values) <= max(drawn)
    assert min(values) >= min(drawn)


def test_columns_are_apart() -> None:
    values = np.array([[[1.0, 9.0], [5.0, 3.0], [2.0, 4.0]]])
    assert extremes(values).tolist() == [[[1.0, 9.0], [5.0, 3.0]]]


def test_what_is_not_a_number_is_no_extreme() -> None:
    gap = np.nan
    values = np.array([[[gap], [2.0], [1.0]], [[gap], [gap], [gap]]])
    drawn = extremes(values)[:, :, 0]
    assert drawn[0].tolist() == [2.0, 1.0]
    assert np.isnan(drawn[1]).all()


def test_a_gap_splits_a_bucket_and_both_parts_are_shown() -> None:
    decimator = Decimator(10, 1)
    assert decimator.take(0, np.array([[1.0], [2.0]])) == []
    cut, whole = decimator.take(8, np.array([[7.0], [5.0]]))
    assert (cut.first, cut.values[:, :, 0].tolist()) == (0, [[1.0, 2.0]])
    assert (whole.first, whole.values[:, :, 0].tolist()) == (0, [[7.0, 5.0]])


def test_what_came_before_is_not_taken_twice() -> None:
    decimator = Decimator(2, 1)
    decimator.take(0, np.array([[1.0], [2.0], [3.0]]))
    [piece] = decimator.take(1, np.array([[99.0], [99.0], [4.0]]))
    assert (piece.first, piece.values[:, :, 0].tolist()) == (1, [[3.0, 4.0]])
    assert decimator.take(0, np.array([[5.0]])) == []


def test_a_bucket_has_a_tick_at_least() -> None:
    with pytest.raises(ValueError, match="bucket of 0 ticks"):
        Decimator(0, 1)
