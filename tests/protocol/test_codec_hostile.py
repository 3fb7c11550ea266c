"""For any input ``decode`` returns a message that could have been sent, or a refusal, within a frame's memory."""

import math
import random
import struct
import tracemalloc
from collections.abc import Callable, Iterator
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.protocol import limits
from manyhands.protocol.codec import LAYOUTS, Flaw, ForeignHello, Malformed, decode, encode
from manyhands.protocol.gate import Gate
from manyhands.protocol.messages import (
    PROTOCOL_VERSION,
    Absent,
    Condition,
    Connect,
    Echo,
    Fault,
    Fetch,
    Figures,
    Force,
    Grasp,
    LinkHello,
    Message,
    NodeHello,
    Observation,
    Offer,
    PathKey,
    Piece,
    Probe,
    PromiseStatus,
    Reaction,
    Ready,
    Refusal,
    Release,
    Report,
    Return,
    Role,
    Rung,
    Sample,
    Shift,
    Start,
    Stop,
    Telemetry,
    Tool,
    Wave,
    Welcome,
)
from tests.support.gates import admit

from ..support.cases import cases

LIMIT = limits.MAX_CONTROL_BYTES
V = PROTOCOL_VERSION
VALID: list[Message] = [
    LinkHello(V, "c0ffee", "example-1", "cx", Role.COUPLING, ("dx", "dy"), ((0.1, 0.0), (0.0, 0.2))),
    NodeHello(V, "c0ffee", "example-1", "dx", Role.DEVICE, 4321, {"cx": "ipc:///tmp/s/cx"}),
    Welcome(),
    Refusal("certificate", "no"),
    Connect({"cx": "ipc:///tmp/s/cx"}),
    Ready(("compensates gravity",)),
    Start(10**15, 10_000),
    Stop("done"),
    Probe(10**15),
    Echo(10**15, 5, 6, 0.04),
    Absent("cx"),
    Offer("cx", "ipc:///tmp/s/dx-cx.1"),
    Return("cx", "ipc:///tmp/s/cx-dx"),
    Shift("cx", 2),
    Rung(2),
    Sample(7, 10**15, np.array([0.1, -0.2, 0.3])),
    Tool(7, 10**15, np.array([0.1])),
    Reaction(7, 10**15, np.array([-0.2])),
    Force(7, 10**15, np.array([0.3, 0.4])),
    Wave(7, (0.3, -0.4), 0.5),
    PathKey(bytes(8), bytes(32), 7400),
    Fetch(65536),
    Piece(65536, 65540, b"rest"),
    Telemetry(100, Figures({"speed": 0.1}), {"x": np.arange(6.0).reshape(3, 2)}),
    Observation("dx", 100, Figures({"speed": 0.1}), {"x": np.arange(6.0).reshape(3, 2)}),
    Condition(
        "running",
        1.5,
        {"dx": "running"},
        ("cx",),
        ("late",),
        ("lost", "back"),
        ("boom",),
        (PromiseStatus("delay", "enforced", ("dx",), 0.5, None, {"ticks": 3.0}, "late"),),
    ),
    Grasp(np.array([0.1, -0.2])),
    Release(),
    Report(10_000, Figures({"peak": 0.5, "late": 3}, {"tau_us": {"p50": 120.0}})),
    Fault("boom"),
]
FRAMES = [encode(message) for message in VALID]
SAMPLE = FRAMES[[type(message) for message in VALID].index(Sample)]


def test_there_is_one_of_every_message() -> None:
    assert {type(message) for message in VALID} == set(LAYOUTS)


def check(frame: bytes) -> None:
    """It returns; and a message that came in could also have gone out, with the same meaning."""
    received = decode(frame, LIMIT)
    if isinstance(received, Malformed):
        assert received.reason
        assert len(received.reason) < 1000
        assert received.reason.replace("\n", " ").isprintable()
    elif isinstance(received, ForeignHello):
        assert received.version != V
    else:
        again = encode(received)
        assert encode(decode(again, LIMIT)) == again  # type: ignore[arg-type]


@given(st.binary(max_size=200))
@settings(max_examples=cases(100, 500))
def test_any_bytes(frame: bytes) -> None:
    check(frame)


@given(st.integers(0x90, 0x9F), st.sampled_from([number for number, _ in LAYOUTS.values()]), st.binary(max_size=100))
@settings(max_examples=cases(100, 500))
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
@settings(max_examples=cases(100, 500))
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
        ((10, 1, 2, 3), Flaw.SHAPE),
        ((10, 1, 2, 3, 0.0), Flaw.SHAPE),
        ((10, 1, 2, 3, 60.5), Flaw.SHAPE),
        ((10, 1, 2, 3, 1), Flaw.SHAPE),
        ((10, 1, 2, 3, math.nan), Flaw.NOT_FINITE),
        ((20, 1, doubles(1)), Flaw.SHAPE),
        ((20, 1, doubles(1), 0), Flaw.SHAPE),
        ((20, 1.0, doubles(1), 0.0), Flaw.SHAPE),
        ((20, -1, doubles(1), 0.0), Flaw.SHAPE),
        ((20, 2**63, doubles(1), 0.0), Flaw.SHAPE),
        ((20, 1, b"", 0.0), Flaw.SHAPE),
        ((20, 1, bytes(8 * 257), 0.0), Flaw.SHAPE),
        ((20, 1, doubles(math.nan), 0.0), Flaw.NOT_FINITE),
        ((20, 1, doubles(1), -math.inf), Flaw.NOT_FINITE),
        ((21, bytes(7), bytes(32), 1), Flaw.SHAPE),
        ((21, bytes(8), "s" * 32, 1), Flaw.SHAPE),
        ((21, bytes(8), bytes(32), 65536), Flaw.SHAPE),
        ((3, None), Flaw.SHAPE),
        ((4, "whatever", "text"), Flaw.SHAPE),
        ((4, "name", "x" * 4097), Flaw.SHAPE),
        ((5, {"a": 1}), Flaw.SHAPE),
        ((5, {b"a": "b"}), Flaw.SHAPE),
        ((5, {1: "b"}), Flaw.SYNTAX),
        ((5, {str(i): "e" for i in range(2049)}), Flaw.SYNTAX),
        ((5, {"\x1b[2J": "e"}), Flaw.SHAPE),
        ((5, {"": "e"}), Flaw.SHAPE),
        ((5, {"n" * 97: "e"}), Flaw.SHAPE),
        ((5, {"n": "e" * 257}), Flaw.SHAPE),
        ((7, 1), Flaw.SHAPE),
        ((8, "\x1b[2J"), Flaw.SHAPE),
        ((8, b"bytes"), Flaw.SHAPE),
        ((True, V, "c", "s", "n", "device", ["p"], None), Flaw.SHAPE),
        ((1, True, "c", "s", "n", "device", ["p"], None), Flaw.SHAPE),
        ((1, -1, "c", "s", "n", "device", ["p"], None), Flaw.SHAPE),
        ((1, V, "c", "s", "n", "ghost", ["p"], None), Flaw.SHAPE),
        ((1, V, "c", "s", "n", "device", ["p", "p"], None), Flaw.SHAPE),
        ((1, V, "c", "s", "n", "device", [], None), Flaw.SHAPE),
        ((1, V, "c", "s", "n", "device", "p", None), Flaw.SHAPE),
        ((1, V, "c", "s", "n", "device", ["p"], [[1]]), Flaw.SHAPE),
        ((1, V, "c", "s", "n", "device", ["p"], [[math.inf]]), Flaw.NOT_FINITE),
        ((2, V, "c", "s", "n", "device", 0, {}), Flaw.SHAPE),
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
def test_the_direct_path_finds_nonfinite_values_too(value: float) -> None:
    frame = SAMPLE[:-8] + doubles(value)
    received = decode(frame, LIMIT)
    assert isinstance(received, Malformed)
    assert received.flaw is Flaw.NOT_FINITE


def test_the_direct_path_refuses_unsigned_ticks_beyond_the_bound_too() -> None:
    received = decode(SAMPLE[:3] + b"\xff" * 8 + SAMPLE[11:], LIMIT)
    assert isinstance(received, Malformed)
    assert "Sample.tick" in received.reason


def test_a_key_that_occurs_twice_is_refused() -> None:
    received = decode(bytes.fromhex("9205 82 a161a162 a161a163"), LIMIT)
    assert isinstance(received, Malformed)
    assert "twice" in received.reason


def test_a_frame_beyond_its_limit_is_not_looked_at() -> None:
    frame = SAMPLE
    assert isinstance(decode(frame, len(frame)), Sample)
    received = decode(frame, len(frame) - 1)
    assert isinstance(received, Malformed)
    assert received.flaw is Flaw.SIZE


# --- memory

PEAK_PER_BYTE = 100
"""Memory that decoding takes while it lasts, for one byte of a frame, bytes: an empty map is one byte, and 72 as a
Python object with its place in the array around it."""

PEAK_FIXED = 18 * 1024 * 1024
"""The same for any frame, bytes: MessagePack's reader gives memory to an array or a map as soon as its length is read,
16 KiB to a map of MAX_ENTRIES, and lets 1024 of them begin inside each other."""


def peak_of(act: Callable[[], object]) -> int:
    """The most memory that ``act`` held at any one time, bytes."""
    tracemalloc.start()
    try:
        act()
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    return peak


def filled(leaf: bytes, limit: int) -> bytes:
    """A frame of nearly ``limit`` bytes: arrays of arrays of as many ``leaf`` as an array may have."""
    row = b"\xdc\x01\x00" + 256 * leaf
    block = b"\xdc\x00\x40" + 64 * row
    rows = (limit - 8) % len(block) // len(row)
    blocks = (limit - 8) // len(block)
    return b"\x92\x08\xdc" + (blocks + rows).to_bytes(2, "big") + blocks * block + rows * row


SMALL, LARGE = 64 * 1024, limits.MAX_CONTROL_BYTES
BOMBS = {
    "arrays in arrays, each said to hold a million": b"\xdd\x00\x0f\xff\xff" * 2000,
    "as many as fit": b"\xdd\x00\x0f\xff\xff" * 200_000,
    "deeper than any message": b"\x91" * 1_000_000,
    "an array of 4 billion": b"\xdd\xff\xff\xff\xff",
    "a map of 4 billion": b"\x92\x05\xdf\xff\xff\xff\xff",
    "a text of 4 GiB": b"\x92\x08\xdb\xff\xff\xff\xff",
    "bytes of 4 GiB": b"\x94\x10\x00\x00\xc6\xff\xff\xff\xff",
    "an extension of 4 GiB": b"\x92\x22\xc9\xff\xff\xff\xff\x01",
    "behind a foreign version, where nothing is read": b"\x93\x01\x07" + b"\x91" * 1_000_000,
    "widest arrays in each other": b"\xdc\x01\x00" * 300_000,
    "widest maps in each other": b"\x92\x05" + b"\xde\x08\x00\xa1a" * 2000,
    "widest maps where a type should be": b"\xde\x08\x00\xa1a" * 2000,
    "empty arrays": filled(b"\x90", SMALL),
    "empty maps": filled(b"\x80", SMALL),
    "maps of empty maps": filled(b"\x81\xa0\x80", SMALL),
    "one-entry arrays": filled(b"\x91\xc0", SMALL),
    "characters of 4 bytes": filled(b"\xa4\xf0\x9f\x98\x80", SMALL),
    "floats": filled(b"\xca\x00\x00\x00\x01", SMALL),
    "as many empty maps as a control frame holds": filled(b"\x80", LARGE),
    "as many maps of empty maps": filled(b"\x81\xa0\x80", LARGE),
}


@pytest.mark.parametrize("bomb", BOMBS.values(), ids=BOMBS)
def test_a_frame_takes_no_more_memory_than_stated(bomb: bytes) -> None:
    received: list[object] = []
    assert len(bomb) <= LARGE
    assert peak_of(lambda: received.append(decode(bomb, LARGE))) <= PEAK_PER_BYTE * len(bomb) + PEAK_FIXED
    assert isinstance(received[0], (Malformed, ForeignHello))


def test_the_largest_messages_take_no_more_memory_than_stated() -> None:
    """As many names as a map may have, as many figures as a control frame has room for; and they are understood."""
    figures = b"\xde\x00\x80" + b"".join(b"\xa3%03x\xca\x7f\x80\x00\x00" % i for i in range(128))
    rows = b"".join(b"\xa3%03x" % i + figures for i in range(904))
    frame = b"\x93\x21\x00\x92\x80\xde" + (904).to_bytes(2, "big") + rows
    received: list[object] = []
    assert LARGE - 2000 < len(frame) <= LARGE
    assert peak_of(lambda: received.append(decode(frame, LARGE))) <= PEAK_PER_BYTE * len(frame) + PEAK_FIXED
    assert isinstance(received[0], Report)


COUNT_OF_FRAMES = 100_000
KEPT_AT_MOST = 256 * 1024  # bytes, after all of them: caches of the interpreter, nothing that grows with the number


def hostile(count: int) -> Iterator[bytes]:
    """``count`` frames: chance, messages with a byte changed, cut or doubled, and now and then a bomb."""
    chance = random.Random(7)
    bombs = [bomb for bomb in BOMBS.values() if len(bomb) < 12_000]
    for number in range(count):
        frame = FRAMES[number % len(FRAMES)]
        place = chance.randrange(len(frame))
        match number % 5:
            case 0:
                yield chance.randbytes(chance.randrange(80))
            case 1:
                yield frame[:place] + chance.randbytes(1) + frame[place + 1 :]
            case 2:
                yield frame[:place]
            case 3:
                yield frame[:place] + frame
            case 4:
                yield chance.choice(bombs) if number % 1000 == 4 else frame[:place] + chance.randbytes(9)


def test_a_hundred_thousand_hostile_frames_leave_no_memory_behind() -> None:
    gate = Gate(Sample, 3)
    longest = max(map(len, hostile(COUNT_OF_FRAMES // 10)))

    def take_all() -> None:
        admitted = 0
        for frame in hostile(COUNT_OF_FRAMES):
            decode(frame, LARGE)
            admitted += admit(gate, frame, 7) is not None
        assert admitted + sum(gate.dropped.values()) == COUNT_OF_FRAMES

    kept = 0

    def twice() -> None:
        nonlocal kept
        for frame in hostile(1000):  # what is made once
            decode(frame, LARGE)
        before, _ = tracemalloc.get_traced_memory()
        take_all()
        after, _ = tracemalloc.get_traced_memory()
        kept = after - before

    assert peak_of(twice) <= PEAK_PER_BYTE * longest + PEAK_FIXED
    assert kept <= KEPT_AT_MOST


@pytest.mark.parametrize("number", [1, 2])
@given(version=st.integers(0, limits.MAX_VERSION).filter(lambda v: v != V), rest=st.binary(max_size=60))
def test_a_hello_of_another_version_is_known_whatever_follows(number: int, version: int, rest: bytes) -> None:
    frame = b"\x98" + msgpack.packb(number) + msgpack.packb(version) + rest
    assert decode(frame, LIMIT) == ForeignHello(version)


def test_no_other_message_is_taken_for_a_foreign_hello() -> None:
    assert isinstance(decode(msgpack.packb([3, 2]), LIMIT), Malformed)
    assert isinstance(decode(msgpack.packb([1]), LIMIT), Malformed)
    assert isinstance(decode(msgpack.packb([7, 2, 3, 4]), LIMIT), Start)
