"""What a gate of waves admits, and under which name it counts every other frame."""

import math
import struct
from collections.abc import Callable
from itertools import pairwise

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.protocol.clock import Duration, Instant, SimulatedClock, from_seconds
from manyhands.protocol.codec import decode, encode, read_wave
from manyhands.protocol.gate import DRIFT, DROP_REASONS, MOST_DELAY, WaveBounds, WaveGate
from manyhands.protocol.limits import MAX_CONTROL_BYTES, MAX_COUNT
from manyhands.protocol.messages import Ready, Sample, Wave

T = from_seconds(0.001)
FIRST = Wave(10, (1.0, -2.0), 0.5)


def doubles(*numbers: float) -> bytes:
    return struct.pack(f"<{len(numbers)}d", *numbers)


def usual(tick: int, sums: tuple[float, ...], shipped: float) -> bytes:
    """A wave's frame in the usual layout, whatever its numbers."""
    head = struct.pack(">BBBQBH", 0x94, 20, 0xCF, tick, 0xC5, 8 * len(sums))
    return head + doubles(*sums) + struct.pack(">Bd", 0xCB, shipped)


def other_words(wave: Wave) -> bytes:
    """The same wave as an encoder writes it that makes integers and lengths as short as it can."""
    frame: bytes = msgpack.packb(msgpack.unpackb(encode(wave)))
    return frame


def test_our_waves_have_the_usual_layout() -> None:
    assert encode(FIRST) == usual(10, (1.0, -2.0), 0.5)


@pytest.mark.parametrize("write", [encode, other_words])
def test_the_first_and_every_newer_wave_is_admitted(write: Callable[[Wave], bytes]) -> None:
    gate = WaveGate(2)
    assert gate.newest is None
    for wave in (FIRST, Wave(11, (1.5, -2.0), 0.5), Wave(900, (0.0, 0.0), 7.0), Wave(MAX_COUNT, (0.0, -0.0), 7.0)):
        assert gate.admitted(write(wave)) == wave
        assert gate.newest == wave
    assert gate.dropped == dict.fromkeys(DROP_REASONS, 0)


REFUSED = [
    (b"", "malformed"),
    (b"\x94\x14", "malformed"),
    (encode(FIRST)[:-1], "malformed"),
    (encode(FIRST) + b"\x00", "malformed"),
    (b"\x95" + encode(Wave(11, (1.0, 2.0), 1.0))[1:], "malformed"),
    (usual(MAX_COUNT + 1, (1.0, 2.0), 1.0), "malformed"),
    (usual(11, tuple(map(float, range(20))), 1.0), "malformed"),  # longer than two sums can be
    (msgpack.packb([20, 11, doubles(1.0, 2.0), 1]), "malformed"),
    (msgpack.packb([20, 11.0, doubles(1.0, 2.0), 1.0]), "malformed"),
    (msgpack.packb([20, -1, doubles(1.0, 2.0), 1.0]), "malformed"),
    (msgpack.packb([20, 11, doubles(1.0, 2.0), 1.0, 0]), "malformed"),
    (msgpack.packb([20, 11, doubles(1.0, 2.0)[1:], 1.0]), "malformed"),
    (encode(Sample(11, 0, np.array([1.0, 2.0]))), "wrong_kind"),
    (encode(Ready()), "wrong_kind"),
    (encode(Wave(11, (1.0,), 1.0)), "wrong_width"),
    (encode(Wave(11, (1.0, 2.0, 3.0), 1.0)), "wrong_width"),
    (other_words(Wave(9, (1.0,), 1.0)), "wrong_width"),
    (encode(FIRST), "old_tick"),
    (other_words(FIRST), "old_tick"),
    (usual(9, (math.nan, 2.0), 1.0), "old_tick"),
    (encode(Wave(0, (1.0, 2.0), 9.0)), "old_tick"),
    (usual(11 + 10_000, (1.0, 2.0), 1.0), "future_tick"),
    (usual(MAX_COUNT, (math.inf, 2.0), 1.0), "future_tick"),
    (usual(11, (1.0, math.nan), 1.0), "not_finite"),
    (usual(11, (-math.inf, 1.0), 0.0), "not_finite"),
    (usual(11, (1.0, 1.0), math.nan), "not_finite"),
    (msgpack.packb([20, 11, doubles(1.0, math.inf), 1.0]), "not_finite"),
    (encode(Wave(11, (1.0, 2.0), 0.25)), "out_of_range"),
    (other_words(Wave(11, (1.0, 2.0), -0.5)), "out_of_range"),
]


@pytest.mark.parametrize(("frame", "reason"), REFUSED)
def test_anything_else_is_dropped_and_counted_and_changes_nothing(frame: bytes, reason: str) -> None:
    gate = WaveGate(2, T, SimulatedClock())
    assert gate.admitted(encode(FIRST)) == FIRST
    assert gate.admitted(frame) is None
    assert gate.dropped == {**dict.fromkeys(DROP_REASONS, 0), reason: 1}
    assert gate.newest == FIRST
    following = Wave(11, (1.0, 2.0), 0.5)
    assert gate.admitted(encode(following)) == following


def test_the_first_energy_is_not_below_zero() -> None:
    gate = WaveGate(1)
    assert gate.admitted(encode(Wave(5, (1.0,), -1e-9))) is None
    assert gate.dropped["out_of_range"] == 1
    assert gate.admitted(encode(Wave(5, (1.0,), 0.0))) is not None


def test_ticks_keep_to_the_receivers_clock() -> None:
    clock = SimulatedClock()
    gate = WaveGate(1, T, clock)
    clock.sleep_until(Instant(77 * T))
    assert gate.admitted(encode(Wave(1000, (0.0,), 0.0))) is not None
    for seconds in (0, 1, 10_000):
        clock.sleep_until(Instant(77 * T + from_seconds(seconds)))
        last = 1000 + math.floor(((1.0 + DRIFT) * from_seconds(seconds) + MOST_DELAY) / T)
        assert gate.admitted(encode(Wave(last + 1, (0.0,), 0.0))) is None
        assert gate.admitted(encode(Wave(last, (0.0,), 0.0))) is not None
    assert gate.dropped["future_tick"] == 3


def test_a_link_that_stood_still_goes_on() -> None:
    """What waited in a stalled connection comes first, and what was sent since right behind it."""
    clock = SimulatedClock()
    gate = WaveGate(1, T, clock)
    assert gate.admitted(encode(Wave(0, (0.0,), 0.0))) is not None
    clock.sleep_until(Instant(60_000 * T))
    for tick in (1, 59_990, 60_000):
        assert gate.admitted(encode(Wave(tick, (0.0,), 0.0))) is not None
    assert not any(gate.dropped.values())


def test_a_period_needs_a_clock() -> None:
    with pytest.raises(ValueError, match="found a period and no clock"):
        WaveGate(1, Duration(T))


@given(
    st.lists(
        st.binary(max_size=40)
        | st.builds(usual, st.integers(0, 8), st.lists(st.floats(), min_size=1, max_size=3).map(tuple), st.floats())
        | st.builds(lambda n, g: other_words(Wave(n, (1.0, 2.0), g)), st.integers(0, 8), st.floats(-1.0, 5.0)),
        max_size=30,
    )
)
def test_ticks_rise_energy_never_falls_and_no_frame_is_lost_in_silence(frames: list[bytes]) -> None:
    gate = WaveGate(2)
    admitted: list[Wave] = []
    for frame in frames:
        wave = gate.admitted(frame)
        if wave is not None:
            assert wave == decode(frame, MAX_CONTROL_BYTES)
            admitted.append(wave)
    for before, after in pairwise(admitted):
        assert after.tick > before.tick
        assert after.shipped >= before.shipped
    assert all(len(wave.sums) == 2 and wave.shipped >= 0.0 for wave in admitted)
    assert len(admitted) + sum(gate.dropped.values()) == len(frames)
    assert gate.newest == (admitted[-1] if admitted else None)


@given(st.binary(max_size=60) | st.binary(max_size=40).map(lambda rest: b"\x94\x14" + rest))
def test_the_quick_reader_agrees_with_the_codec(frame: bytes) -> None:
    read, message = read_wave(frame), decode(frame, MAX_CONTROL_BYTES)
    if isinstance(message, Wave):
        assert read is not None
        assert (read.tick, read.shipped, struct.unpack(f"<{len(message.sums)}d", read.sums)) == (
            message.tick, message.shipped, message.sums,
        )  # fmt: skip
    elif read is not None:
        assert not all(map(math.isfinite, (read.shipped, *np.frombuffer(read.sums, "<f8"))))


BOUNDS = WaveBounds(step=(0.01, 0.02), first=(0.5, 0.5), lent=0.005, gain=0.001, delay=10.0)


def bounded() -> WaveGate:
    gate = WaveGate(2, bounds=BOUNDS)
    assert gate.admitted(encode(Wave(100, (0.5, -0.5), 0.0))) is not None
    return gate


@pytest.mark.parametrize(
    ("wave", "admitted"),
    [
        (Wave(101, (0.51, -0.52), 0.0), True),
        (Wave(101, (0.5101, -0.5), 0.0), False),
        (Wave(101, (0.5, -0.5201), 0.0), False),
        (Wave(200, (1.5, 1.5), 0.0), True),  # those between are lost, and their steps with them
        (Wave(200, (1.51, 1.5), 0.0), False),
        (Wave(101, (0.5, -0.5), 0.016), True),  # lent, 10 ticks of delay, one tick
        (Wave(101, (0.5, -0.5), 0.0161), False),
        (Wave(201, (0.5, -0.5), 0.116), True),
        (Wave(101, (9e11, -9e11), 0.0), False),
        (Wave(101, (0.5, -0.5), 1e12), False),
        (Wave(101, (5e-324, 1e-300), 5e-324), False),
    ],
)
def test_a_wave_that_no_honest_site_can_send_is_out_of_range(wave: Wave, admitted: bool) -> None:
    gate = bounded()
    assert (gate.admitted(encode(wave)) is not None) == admitted
    assert gate.dropped["out_of_range"] == (not admitted)


def test_a_lifes_first_wave_has_a_place_and_energy_that_was_granted_may_come_back() -> None:
    gate = WaveGate(2, bounds=BOUNDS)
    assert gate.admitted(encode(Wave(3, (0.51, 0.0), 0.0))) is None
    assert gate.admitted(encode(Wave(3, (0.5, 0.0), 0.02))) is None
    assert gate.admitted(encode(Wave(3, (0.5, 0.0), 0.015))) is not None
    assert gate.admitted(encode(Wave(4, (0.5, 0.0), 2.0))) is None
    gate.granted = 2.0
    assert gate.admitted(encode(Wave(5, (0.5, 0.0), 2.0))) is not None
