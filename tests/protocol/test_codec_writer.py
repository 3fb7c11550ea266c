"""The writer that a loop uses in every tick makes the same bytes as the codec."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from manyhands.protocol.codec import SignalWriter, WaveWriter, encode
from manyhands.protocol.limits import MAX_COUNT, MAX_PORTS
from manyhands.protocol.messages import Force, Reaction, Sample, SignalMessage, Tool, Wave

KINDS: tuple[type[SignalMessage], ...] = (Sample, Tool, Reaction, Force)
COUNTS = st.integers(-1, 3) | st.integers(MAX_COUNT - 1, MAX_COUNT + 1)
NUMBERS = st.lists(st.floats(width=64), max_size=4)


def outcome(make: Callable[[], bytes]) -> bytes | str:
    """The frame, or why there is none."""
    try:
        return make()
    except ValueError as error:
        return str(error)


@given(st.sampled_from(KINDS), st.integers(1, 4), COUNTS, COUNTS, NUMBERS)
@example(Sample, 1, 0, 0, [math.nan])
@example(Force, 2, 0, MAX_COUNT, [0.5, -math.inf])
@example(Tool, 1, MAX_COUNT, 0, [-0.0])
def test_a_written_signal_is_the_encoded_one_or_refused_alike(
    kind: type[SignalMessage], width: int, tick: int, stamp: int, values: list[float]
) -> None:
    writer = SignalWriter(kind, width)
    assert outcome(lambda: writer.frame(tick, stamp, values)) == outcome(
        lambda: encode(kind(tick, stamp, np.array(values, dtype=np.float64)))
    )


@given(st.integers(1, 4), COUNTS, NUMBERS, st.floats(width=64))
@example(1, 0, [math.nan], 0.0)
@example(2, MAX_COUNT, [0.5, -0.0], -math.inf)
def test_a_written_wave_is_the_encoded_one_or_refused_alike(
    width: int, tick: int, sums: list[float], shipped: float
) -> None:
    written = outcome(lambda: WaveWriter(width).frame(tick, sums, shipped))
    if len(sums) == width:
        assert written == outcome(lambda: encode(Wave(tick, tuple(sums), shipped)))
    else:
        assert written == f"Wave.sums: found {len(sums)} sums; expected {width}"


def test_a_link_is_no_wider_than_a_session() -> None:
    with pytest.raises(ValueError, match="values"):
        SignalWriter(Tool, MAX_PORTS + 1).frame(0, 0, [0.0] * (MAX_PORTS + 1))
