"""The offset of another clock: its error is at most half of the shortest round trip."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.protocol.clock import Exchange, offset_of

times = st.integers(0, 2**62)
delays = st.integers(0, 10**12)


def exchange(offset: int, sent: int, there: int, thinking: int, back: int) -> Exchange:
    """One exchange with a clock that is ``offset`` ns ahead, with these delays on the way, ns."""
    heard = sent + there + offset
    return Exchange(sent, heard, heard + thinking, sent + there + thinking + back)


@st.composite
def exchanges(draw: st.DrawFn) -> tuple[int, list[Exchange], int]:
    """A true offset, some exchanges, and the shortest way among them."""
    offset = draw(st.integers(-(2**62), 2**62))
    drawn = draw(st.lists(st.tuples(times, delays, delays, delays), min_size=1, max_size=8))
    shortest = min(there + back for _, there, _, back in drawn)
    return offset, [exchange(offset, *one) for one in drawn], shortest


@given(exchanges())
def test_the_error_is_at_most_half_the_shortest_round_trip(case: tuple[int, list[Exchange], int]) -> None:
    offset, made, shortest = case
    assert abs(offset_of(made) - offset) <= (shortest + 1) // 2


@given(times, delays, delays, st.integers(-(2**62), 2**62))
def test_equal_ways_give_the_offset_itself(sent: int, way: int, thinking: int, offset: int) -> None:
    one = exchange(offset, sent, way, thinking, way)
    assert one.round_trip == 2 * way
    assert one.offset == offset


@given(exchanges())
def test_a_round_trip_is_the_time_on_the_way(case: tuple[int, list[Exchange], int]) -> None:
    _, made, shortest = case
    assert min(one.round_trip for one in made) == shortest


def test_the_shortest_way_is_believed() -> None:
    late = exchange(1000, 0, there=900, thinking=5, back=0)  # by itself: 450 too much
    quick = exchange(1000, 5000, there=10, thinking=5, back=12)
    assert late.offset == 1450
    assert quick.offset == 999
    assert offset_of([late, quick]) == offset_of([quick, late]) == 999


def test_without_an_exchange_there_is_no_offset() -> None:
    with pytest.raises(ValueError, match="empty"):
        offset_of([])
