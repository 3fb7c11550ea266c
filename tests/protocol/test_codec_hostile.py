"""Whatever comes in: ``decode`` returns, and returns something that could have been sent."""

import math
import struct
import tracemalloc
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.protocol import limits
from manyhands.protocol.codec import LAYOUTS, Flaw, ForeignHello, Malformed, decode, encode
from manyhands.protocol.messages import (
    Connect,
    Fault,
    LinkHello,
    Message,
    NodeHello,
    Ready,
    Refusal,
    Report,
    Role,
    Sample,
    Start,
    Stop,
    Telemetry,
    Welcome,
)

LIMIT = limits.MAX_CONTROL_BYTES
VALID: list[Message] = [
    LinkHello(1, "c0ffee", "example-1", "cx", Role.COUPLING, ("dx", "dy"), ((0.1, 0.0), (0.0, 0.2))),
    NodeHello(1, "c0ffee", "example-1", "dx", Role.DEVICE, 4321, {"cx": "ipc:///tmp/s/cx"}),
    Welcome(),
    Refusal("certificate", "no"),
    Connect({"cx": "ipc:///tmp/s/cx"}),
    Ready(),
    Start(10**15, 10_000),
    Stop("done"),
    Sample(7, 10**15, np.array([0.1, -0.2, 0.3])),
    Telemetry(100, {"speed": 0.1}, {"x": np.arange(6.0).reshape(3, 2)}),
    Report(10_000, {"peak": 0.5}, {"late": 3}, {"tau_us": {"p50": 120.0}}),
    Fault("boom"),
]
FRAMES = [encode(message) for message in VALID]


def check(frame: bytes) -> None:
    """It returns; and a message that came in could also have gone out, with the same meaning."""
    received = decode(frame, LIMIT)
    if isinstance(received, Malformed):
        assert received.reason
        assert len(received.reason) < 1000
        assert received.reason.replace("\n", " ").isprintable()
    elif isinstance(received, ForeignHello):
        assert received.version != 1
    else:
        again = encode(received)
        assert encode(decode(again, LIMIT)) == again  # type: ignore[arg-type]


@given(st.binary(max_size=200))
@settings(max_examples=500)
def test_any_bytes(frame: bytes) -> None:
    check(frame)


@given(st.integers(0x90, 0x9F), st.sampled_from([number for number, _ in LAYOUTS.values()]), st.binary(max_size=100))
@settings(max_examples=500)
def test_any_bytes_behind_a_plausible_start(array: int, number: int, rest: bytes) -> None:
    check(bytes([array, number]) + rest)


@pytest.mark.parametrize("frame", FRAMES, ids=[type(message).__name__ for message in VALID])
def test_every_truncation_is_malformed(frame: bytes) -> None:
    for length in range(len(frame)):
        assert isinstance(decode(frame[:length], LIMIT), Malformed)


@pytest.mark.parametrize("frame", FRAMES, ids=[type(message).__name__ for message in VALID])
def test_a_frame_with_something_behind_it_is_malformed(frame: bytes) -> None:
    assert isinstance(decode(frame + b"\x00", LIMIT), Malformed)


@pytest.mark.parametrize("frame", FRAMES, ids=[type(message).__name__ for message in VALID])
def test_every_byte_replaced(frame: bytes) -> None:
    for place in range(len(frame)):
        for byte in (0x00, 0x01, 0x7F, 0x80, 0x90, 0xA0, 0xC0, 0xC1, 0xC3, 0xC9, 0xCB, 0xCF, 0xD9, 0xDD, 0xDF, 0xFF):
            check(frame[:place] + bytes([byte]) + frame[place + 1 :])


plain = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**64 - 1)
    | st.floats()
    | st.text(max_size=8)
    | st.binary(max_size=9),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=4) | st.integers(0, 9), inner, max_size=3)
    ),
    max_leaves=8,
)


@given(st.sampled_from(FRAMES), st.integers(0, 8), plain)
@settings(max_examples=500)
def test_any_field_replaced_by_anything(frame: bytes, place: int, value: Any) -> None:
    items = msgpack.unpackb(frame)
    items[place % len(items)] = value
    check(msgpack.packb(items))


def flaw_of(*items: Any) -> Flaw:
    received = decode(msgpack.packb(list(items)), LIMIT)
    assert isinstance(received, Malformed), received
    return received.flaw


def doubles(*numbers: float) -> bytes:
    return struct.pack(f"<{len(numbers)}d", *numbers)


@pytest.mark.parametrize(
    ("items", "flaw"),
    [
        ((), Flaw.SYNTAX),
        ((0,), Flaw.SHAPE),
        (("16", 1, 2, doubles(1)), Flaw.SHAPE),
        ((True,), Flaw.SHAPE),
        ((16.0, 1, 2, doubles(1)), Flaw.SHAPE),
        (([16],), Flaw.SHAPE),
        ((16, 1, 2), Flaw.SHAPE),
        ((16, 1, 2, doubles(1), 0), Flaw.SHAPE),
        ((16, -1, 2, doubles(1)), Flaw.SHAPE),
        ((16, 2**63, 2, doubles(1)), Flaw.SHAPE),
        ((16, True, 2, doubles(1)), Flaw.SHAPE),
        ((16, 1.0, 2, doubles(1)), Flaw.SHAPE),
        ((16, 1, 2, "12345678"), Flaw.SHAPE),
        ((16, 1, 2, [1.0]), Flaw.SHAPE),
        ((16, 1, 2, b""), Flaw.SHAPE),
        ((16, 1, 2, b"1234567"), Flaw.SHAPE),
        ((16, 1, 2, bytes(8 * 257)), Flaw.SHAPE),
        ((16, 1, 2, doubles(1, math.nan)), Flaw.NOT_FINITE),
        ((16, 1, 2, doubles(-math.inf)), Flaw.NOT_FINITE),
        ((3, None), Flaw.SHAPE),
        ((4, "whatever", "text"), Flaw.SHAPE),
        ((4, "name", "x" * 4097), Flaw.SHAPE),
        ((5, {"a": 1}), Flaw.SHAPE),
        ((5, {b"a": "b"}), Flaw.SHAPE),
        ((5, {1: "b"}), Flaw.SYNTAX),
        ((5, {str(i): "e" for i in range(2049)}), Flaw.SYNTAX),
        ((7, 1), Flaw.SHAPE),
        ((8, "\x1b[2J"), Flaw.SHAPE),
        ((8, b"bytes"), Flaw.SHAPE),
        ((True, 1, "c", "s", "n", "device", ["p"], None), Flaw.SHAPE),
        ((1, True, "c", "s", "n", "device", ["p"], None), Flaw.SHAPE),
        ((1, -1, "c", "s", "n", "device", ["p"], None), Flaw.SHAPE),
        ((1, 1, "c", "s", "n", "ghost", ["p"], None), Flaw.SHAPE),
        ((1, 1, "c", "s", "n", "device", ["p", "p"], None), Flaw.SHAPE),
        ((1, 1, "c", "s", "n", "device", [], None), Flaw.SHAPE),
        ((1, 1, "c", "s", "n", "device", "p", None), Flaw.SHAPE),
        ((1, 1, "c", "s", "n", "device", ["p"], [[1]]), Flaw.SHAPE),
        ((1, 1, "c", "s", "n", "device", ["p"], [[math.inf]]), Flaw.NOT_FINITE),
        ((2, 1, "c", "s", "n", "device", 0, {}), Flaw.SHAPE),
        ((32, 1, {"a": 1}, {}), Flaw.SHAPE),
        ((32, 1, {}, {"x": [2, 1, doubles(1)]}), Flaw.SHAPE),
        ((32, 1, {}, {"x": [2**40, 0, b""]}), Flaw.SHAPE),
        ((32, 1, {}, {"x": [-1, -1, doubles(1)]}), Flaw.SHAPE),
        ((32, 1, {}, {"x": [1, 1]}), Flaw.SHAPE),
        ((33, 1, {}, {"late": 1.0}, {}), Flaw.SHAPE),
        ((33, 1, {}, {}, {"tau": 1.0}), Flaw.SHAPE),
        ((34, msgpack.ExtType(1, b"12")), Flaw.SYNTAX),
    ],
)
def test_the_flaw_is_named(items: tuple[Any, ...], flaw: Flaw) -> None:
    assert flaw_of(*items) is flaw


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_value_that_is_not_finite_is_found_on_the_direct_path_too(value: float) -> None:
    frame = FRAMES[8][:-8] + doubles(value)
    received = decode(frame, LIMIT)
    assert isinstance(received, Malformed)
    assert received.flaw is Flaw.NOT_FINITE


def test_an_unsigned_tick_beyond_the_bound_is_refused_on_the_direct_path_too() -> None:
    received = decode(FRAMES[8][:3] + b"\xff" * 8 + FRAMES[8][11:], LIMIT)
    assert isinstance(received, Malformed)
    assert "Sample.tick" in received.reason


def test_a_key_that_occurs_twice_is_refused() -> None:
    received = decode(bytes.fromhex("9205 82 a161a162 a161a163"), LIMIT)
    assert isinstance(received, Malformed)
    assert "twice" in received.reason


def test_a_frame_beyond_its_limit_is_not_looked_at() -> None:
    frame = FRAMES[8]
    assert isinstance(decode(frame, len(frame)), Sample)
    received = decode(frame, len(frame) - 1)
    assert isinstance(received, Malformed)
    assert received.flaw is Flaw.SIZE


@pytest.mark.parametrize(
    "bomb",
    [
        b"\xdd\x00\x0f\xff\xff" * 200_000,  # arrays in arrays, each said to hold a million
        b"\x91" * 1_000_000,  # deeper than any message
        b"\xdd\xff\xff\xff\xff",
        b"\x92\x05\xdf\xff\xff\xff\xff",
        b"\x92\x08\xdb\xff\xff\xff\xff",
        b"\x93\x01\x02" + b"\x91" * 1_000_000,  # behind a foreign version, where nothing is read
    ],
)
def test_small_frames_do_not_become_large(bomb: bytes) -> None:
    tracemalloc.start()
    try:
        received = decode(bomb, LIMIT)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert isinstance(received, (Malformed, ForeignHello))
    assert peak < 16 * LIMIT


@pytest.mark.parametrize("number", [1, 2])
@given(version=st.integers(0, limits.MAX_VERSION).filter(lambda v: v != 1), rest=st.binary(max_size=60))
def test_a_hello_of_another_version_is_known_whatever_follows(number: int, version: int, rest: bytes) -> None:
    frame = b"\x98" + msgpack.packb(number) + msgpack.packb(version) + rest
    assert decode(frame, LIMIT) == ForeignHello(version)


def test_no_other_message_is_taken_for_a_foreign_hello() -> None:
    assert isinstance(decode(msgpack.packb([3, 2]), LIMIT), Malformed)
    assert isinstance(decode(msgpack.packb([1]), LIMIT), Malformed)
    assert isinstance(decode(msgpack.packb([7, 2, 3]), LIMIT), Start)
