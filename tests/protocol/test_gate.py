"""What a gate admits, and under which name it counts the rest."""

import math
import struct

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.protocol.codec import encode
from manyhands.protocol.gate import DROP_REASONS, Gate
from manyhands.protocol.limits import MAX_FRAME_BYTES
from manyhands.protocol.messages import PROTOCOL_VERSION, LinkHello, Ready, Role, Sample, Tool

TICK = 10
PAIR = np.array([1.0, 2.0])


def test_the_awaited_signal_is_admitted() -> None:
    gate = Gate(Sample, 2)
    admitted = gate.admit(encode(Sample(TICK, 123, PAIR)), TICK)
    assert admitted is not None
    np.testing.assert_array_equal(admitted, PAIR)
    assert gate.stamp == 123
    assert gate.dropped == dict.fromkeys(DROP_REASONS, 0)


@pytest.mark.parametrize(
    ("frame", "reason"),
    [
        (b"", "malformed"),
        (b"\xc1", "malformed"),
        (encode(Sample(TICK, 0, PAIR))[:-1], "malformed"),
        (encode(Sample(TICK, 0, PAIR)) + bytes(MAX_FRAME_BYTES), "malformed"),
        (encode(Tool(TICK, 0, PAIR)), "wrong_kind"),
        (encode(Ready()), "wrong_kind"),
        (encode(LinkHello(PROTOCOL_VERSION + 1, "c", "s", "n", Role.DEVICE, ("p",))), "wrong_kind"),
        (encode(Sample(TICK, 0, np.ones(1))), "wrong_width"),
        (encode(Sample(TICK, 0, np.ones(3))), "wrong_width"),
        (msgpack.packb([16, TICK, 0, struct.pack("<2d", 1.0, math.nan)]), "not_finite"),
        (encode(Sample(TICK - 1, 0, PAIR)), "old_tick"),
        (encode(Sample(TICK + 1, 0, PAIR)), "future_tick"),
    ],
)
def test_anything_else_is_dropped_and_counted(frame: bytes, reason: str) -> None:
    gate = Gate(Sample, 2)
    gate.admit(encode(Sample(TICK - 1, 55, PAIR)), TICK - 1)
    assert gate.admit(frame, TICK) is None
    assert gate.dropped == {**dict.fromkeys(DROP_REASONS, 0), reason: 1}
    assert gate.stamp == 55


@given(st.lists(st.binary(max_size=40) | st.integers(0, 5).map(lambda k: encode(Sample(k, k, PAIR))), max_size=30))
def test_no_frame_is_lost_in_silence(frames: list[bytes]) -> None:
    gate = Gate(Sample, 2)
    admitted = sum(gate.admit(frame, 3) is not None for frame in frames)
    assert admitted + sum(gate.dropped.values()) == len(frames)
    assert gate.dropped.keys() == set(DROP_REASONS)
