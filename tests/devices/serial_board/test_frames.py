"""Frames: what Python and C make of the same bytes, and that no byte of a stranger raises."""

from __future__ import annotations

import ctypes
import math
import struct
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.devices.serial_board.frames import (
    MOST_AXES,
    MOST_FRAME,
    About,
    Feature,
    Reader,
    State,
    Status,
    coded,
    crc,
    decoded,
    force,
    hello,
    read,
    sealed,
)

from ...fakes.compiled import core

FORM = [
    (b"", b"\x01"),
    (b"\0", b"\x01\x01"),
    (b"\0\0", b"\x01\x01\x01"),
    (b"\x11\x22\0\x33", b"\x03\x11\x22\x02\x33"),
    (b"\x11\0\0\0", b"\x02\x11\x01\x01\x01"),
    (bytes(range(1, 255)), b"\xff" + bytes(range(1, 255))),
    (b"\0" + bytes(range(1, 255)), b"\x01\xff" + bytes(range(1, 255))),
    (bytes(range(1, 256)), b"\xff" + bytes(range(1, 255)) + b"\x02\xff"),
    (bytes(range(2, 256)) + b"\0", b"\xff" + bytes(range(2, 256)) + b"\x01\x01"),
]
"""Of the paper that COBS is from, section IV, and the examples that everybody compares with."""


@pytest.fixture(scope="module")
def firmware() -> ctypes.CDLL:
    library = ctypes.CDLL(str(core()))
    library.mhb_code.restype = library.mhb_decode.restype = ctypes.c_size_t
    library.mhb_crc.restype = ctypes.c_uint16
    return library


def by_c(library: ctypes.CDLL, data: bytes) -> bytes:
    out = ctypes.create_string_buffer(2 * len(data) + 2)
    length = library.mhb_code(data, len(data), out)
    return out.raw[:length]


@pytest.mark.parametrize(("data", "code"), FORM)
def test_the_code_is_the_known_one(data: bytes, code: bytes, firmware: ctypes.CDLL) -> None:
    assert coded(data) == code
    assert by_c(firmware, data) == code
    assert decoded(code) == data


def test_the_checksum_is_the_known_one(firmware: ctypes.CDLL) -> None:
    assert crc(b"123456789") == firmware.mhb_crc(b"123456789", 9) == 0x29B1


@given(st.binary(max_size=600) | st.lists(st.sampled_from([0, 1]), max_size=600).map(bytes))
def test_both_ends_code_alike(data: bytes) -> None:
    library = ctypes.CDLL(str(core()))
    library.mhb_code.restype = library.mhb_decode.restype = ctypes.c_size_t
    code = coded(data)
    assert by_c(library, data) == code
    assert 0 not in code
    assert decoded(code) == data
    back = ctypes.create_string_buffer(len(code) + 1)
    length = library.mhb_decode(code, len(code), back)
    assert back.raw[:length] == data
    assert library.mhb_crc(data, len(data)) & 0xFFFF == crc(data)


@given(st.binary(max_size=400))
def test_both_ends_refuse_alike(code: bytes) -> None:
    library = ctypes.CDLL(str(core()))
    library.mhb_decode.restype = ctypes.c_size_t
    out = ctypes.create_string_buffer(len(code) + 1)
    length = library.mhb_decode(code, len(code), out)
    data = decoded(code)
    assert (length == ctypes.c_size_t(-1).value) == (data is None)
    if data is not None:
        assert out.raw[:length] == data


floats = st.floats(width=32, allow_nan=False, allow_infinity=False)


def state_payload(x: tuple[float, ...], f: tuple[float, ...], work: int | None, any_force: bool = True) -> bytes:
    head = struct.pack("<BHHIBB", 0x82, 7, 9, 123, int(Status.READY | Status.CALIBRATED), any_force)
    tail = b"" if work is None else work.to_bytes(8, "little", signed=True)
    return head + struct.pack(f"<{2 * len(x)}f", *x, *f) + tail


@given(st.data(), st.integers(1, MOST_AXES), st.none() | st.integers(-(2**63), 2**63 - 1))
def test_a_state_is_read_as_it_was_sent_however_the_stream_is_cut(
    data: st.DataObject, axes: int, work: int | None
) -> None:
    numbers = [tuple(data.draw(st.tuples(*[floats] * axes))) for _ in range(2)]
    stream = sealed(state_payload(numbers[0], numbers[1], work)) * 3
    assert len(stream) / 3 <= MOST_FRAME
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=6)))
    reader = Reader()
    reader.axes = axes
    found = [message for a, b in pairwise([0, *cuts, len(stream)]) for message in reader.take(stream[a:b])]
    expected = State(7, 9, 123, Status.READY | Status.CALIBRATED, *numbers, None if work is None else 1e-9 * work)
    assert found == [expected] * 3
    assert reader.broken == 0


@given(st.binary(max_size=700), st.integers(0, MOST_AXES))
def test_noise_is_counted_and_ends_with_the_next_zero(noise: bytes, axes: int) -> None:
    reader = Reader()
    reader.axes = axes or 1
    list(reader.take(noise + b"\0"))
    whole = sealed(state_payload((0.5,) * reader.axes, (1.0,) * reader.axes, None))
    (state,) = reader.take(whole)
    assert isinstance(state, State)
    assert state.x == (0.5,) * reader.axes


def about_payload(axes: int = 2, **changed: object) -> bytes:
    of = {
        "version": 1, "nonce": 77, "name": b"board", "rotations": 2, "features": 3, "period": 500, "longest": 50_000,
        "numbers": [5.0] * axes + [0.1] * axes + [2.0] * axes + [1e-5] * axes + [0.0] * axes, **changed,
    }  # fmt: skip
    head = struct.pack(
        "<BBI16sBBBII", 0x81, of["version"], of["nonce"], of["name"], axes, of["rotations"], of["features"],
        of["period"], of["longest"],
    )  # fmt: skip
    return head + struct.pack(f"<{5 * axes}f", *of["numbers"])  # type: ignore[misc]


def test_an_about_is_read() -> None:
    about = read(about_payload(), 0)
    assert isinstance(about, About)
    assert (about.version, about.nonce, about.name, about.axes) == (1, 77, "board", 2)
    assert about.rotations == (False, True)
    assert about.features == Feature.TELLS_WORK | Feature.HOLDS_TORQUE
    assert (about.period, about.longest) == pytest.approx((5e-4, 5e-2))
    assert about.force == (5.0, 5.0)
    assert about.mass == (0.0, 0.0)


@pytest.mark.parametrize("place", range(10))
@pytest.mark.parametrize("bad", [math.nan, math.inf, -1.0])
def test_an_about_with_numbers_of_no_use_is_none(place: int, bad: float) -> None:
    numbers = [5.0, 5.0, 0.1, 0.1, 2.0, 2.0, 1e-5, 1e-5, 0.2, 0.2]
    numbers[place] = bad
    assert read(about_payload(numbers=numbers), 0) is None


@pytest.mark.parametrize("changed", [{"period": 0}, {"longest": 0}, {"numbers": [0.0] * 10}])
def test_an_about_without_a_period_or_limits_is_none(changed: dict[str, object]) -> None:
    assert read(about_payload(**changed), 0) is None


def test_a_board_of_another_version_says_which() -> None:
    about = read(about_payload(version=9), 0)
    assert isinstance(about, About)
    assert (about.version, about.nonce, about.axes) == (9, 77, 0)


@given(st.binary(max_size=200), st.integers(0, MOST_AXES))
def test_no_payload_raises(payload: bytes, axes: int) -> None:
    for first in (b"\x81", b"\x82", b""):
        read(first + payload, axes)


def test_frames_of_the_host_are_short() -> None:
    assert len(hello(2**32 - 1)) <= MOST_FRAME
    assert len(force(65536 + 3, -1, [1.0] * MOST_AXES)) <= MOST_FRAME
