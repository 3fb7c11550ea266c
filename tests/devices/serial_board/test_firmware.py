"""The firmware's core, compiled natively: what it obeys, what it counts, and that every force ends by itself."""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.devices.serial_board.frames import About, Reader, State, Status, force, hello, sealed

from ...fakes.compiled import core

AXES, LONGEST = 2, 50_000
COUNTS = ("broken", "unknown", "early", "old", "late", "unusable")


class AboutC(ctypes.Structure):
    _fields_ = [
        ("name", ctypes.c_char * 16), ("axes", ctypes.c_uint8), ("rotations", ctypes.c_uint8),
        ("features", ctypes.c_uint8), ("period_us", ctypes.c_uint32), ("longest_us", ctypes.c_uint32),
        *((name, ctypes.c_float * 6) for name in ("force", "displacement", "speed", "step", "mass")),
    ]  # fmt: skip


class Core:
    """The core with a clock that the test moves."""

    def __init__(self, now: int = 0, **changed: object) -> None:
        self.library = ctypes.CDLL(str(core()))
        self.library.mhb_force.restype = ctypes.POINTER(ctypes.c_float)
        self.library.mhb_state.restype = ctypes.c_size_t
        self.board = ctypes.create_string_buffer(4096)  # more than the structure has, which is this library's own
        limits = (ctypes.c_float * 6)(5.0, 3.0, 1, 1, 1, 1)
        self.about = AboutC(b"test", AXES, 0, 1, 500, LONGEST, limits, limits, limits)
        for name, value in changed.items():
            setattr(self.about, name, value)
        self.begun = self.library.mhb_init(self.board, ctypes.byref(self.about))
        self.now, self.reader = now, Reader()

    def take(self, data: bytes) -> None:
        for byte in data:
            self.library.mhb_take(self.board, ctypes.c_uint8(byte), ctypes.c_uint32(self.now & 0xFFFFFFFF))

    def force(self) -> tuple[float, ...]:
        found = self.library.mhb_force(self.board, ctypes.c_uint32(self.now & 0xFFFFFFFF))
        return tuple(found[i] for i in range(self.about.axes))

    def sent(self, x: Sequence[float] = (0.0, 0.0), work: int = 0) -> About | State | None:
        out = ctypes.create_string_buffer(162)
        numbers, zero = (ctypes.c_float * 6)(*x), (ctypes.c_float * 6)()
        length = self.library.mhb_state(
            self.board, ctypes.c_uint32(self.now & 0xFFFFFFFF), numbers, zero, ctypes.c_uint8(3),
            ctypes.c_int64(work), out,
        )  # fmt: skip
        self.reader.axes = self.about.axes
        return next(iter(self.reader.take(out.raw[:length])), None)

    def state(self) -> State:
        state = self.sent()
        assert isinstance(state, State)
        return state


@pytest.fixture
def greeted() -> Core:
    one = Core()
    one.take(hello(5))
    assert isinstance(one.sent(), About)
    return one


def test_a_board_that_was_not_greeted_says_nothing_and_exerts_nothing() -> None:
    one = Core()
    one.take(force(1, 1000, [1.0, 1.0]))
    assert one.sent() is None
    assert one.force() == (0.0, 0.0)


def test_a_hello_is_answered_with_what_the_board_is() -> None:
    one = Core()
    one.take(hello(0xDEADBEEF))
    about = one.sent()
    assert isinstance(about, About)
    assert (about.nonce, about.name, about.force) == (0xDEADBEEF, "test", (5.0, 3.0))
    first, second = one.state(), one.state()
    assert (first.number, second.number, first.answers) == (0, 1, None)


def test_a_hello_of_another_version_is_answered_and_begins_nothing() -> None:
    one = Core()
    payload = struct.pack("<BBBI", 1, 7, 9, 5)
    one.take(sealed(payload))
    about = one.sent()
    assert isinstance(about, About)
    assert about.version == 1
    assert one.sent() is None


def test_a_force_acts_until_its_end_and_never_comes_back(greeted: Core) -> None:
    greeted.take(force(1, 1000, [1.0, -2.0]))
    assert greeted.force() == (1.0, -2.0)
    greeted.now = 999
    assert greeted.force() == (1.0, -2.0)
    assert greeted.state().status == Status.CALIBRATED | Status.READY
    greeted.now = 1000
    assert greeted.force() == (0.0, 0.0)
    assert Status.EXPIRED in greeted.state().status
    for greeted.now in (2**31, 2**32 + 500, 2**33):  # the clock wraps
        assert greeted.force() == (0.0, 0.0)


def test_no_force_lives_longer_than_the_board_permits(greeted: Core) -> None:
    greeted.take(force(1, 2**31 - 1, [1.0, 1.0]))
    greeted.now = LONGEST - 1
    assert greeted.force() == (1.0, 1.0)
    greeted.now = LONGEST
    assert greeted.force() == (0.0, 0.0)


def test_a_force_whose_time_is_over_when_it_comes_is_none(greeted: Core) -> None:
    greeted.now = 5000
    greeted.take(force(1, 9000, [1.0, 1.0]))
    greeted.take(force(2, 4999, [2.0, 2.0]))  # it was held up
    assert greeted.force() == (0.0, 0.0)
    assert greeted.state().answers == 2


def test_forces_are_cut_to_the_limits(greeted: Core) -> None:
    greeted.take(force(1, 1000, [9.0, -9.0]))
    assert greeted.force() == (5.0, -3.0)
    assert Status.SATURATED in greeted.state().status
    greeted.take(force(2, 1000, [4.0, -3.0]))
    assert Status.SATURATED not in greeted.state().status


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -float("inf")])
def test_a_force_that_is_no_number_lets_go(greeted: Core, bad: float) -> None:
    greeted.take(force(1, 1000, [1.0, 1.0]))
    greeted.take(force(2, 1000, [1.0, bad]))
    assert greeted.force() == (0.0, 0.0)


def test_an_old_force_and_one_that_came_twice_count_for_nothing(greeted: Core) -> None:
    """Numbers wrap: of two, the newer is less than half of the circle ahead."""
    sent = (
        (10, 1.0, 1.0),
        (10, 2.0, 1.0),
        (9, 2.0, 1.0),
        (11, 3.0, 3.0),
        (65535, 4.0, 3.0),
        (32000, 4.0, 4.0),
        (64000, 5.0, 5.0),
        (5, 1.5, 1.5),
    )
    for number, given_force, exerted in sent:
        greeted.take(force(number, 1000, [given_force, 0.0]))
        assert greeted.force()[0] == exerted, number


def test_a_new_hello_takes_the_force_away(greeted: Core) -> None:
    greeted.take(force(1, 1000, [1.0, 1.0]))
    greeted.take(hello(6))
    assert greeted.force() == (0.0, 0.0)
    assert isinstance(greeted.sent(), About)
    assert greeted.state().answers is None
    greeted.take(force(1, 1000, [1.0, 1.0]))  # numbers begin anew
    assert greeted.force() == (1.0, 1.0)


def axes(*values: float) -> ctypes.Array[ctypes.c_float]:
    return (ctypes.c_float * 6)(*values)


@pytest.mark.parametrize(
    "changed",
    [
        {"axes": 0},
        {"axes": 7},
        {"period_us": 0},
        {"longest_us": 0},
        {"longest_us": 2**31},
        *(
            {name: axes(1.0, value)}
            for name in ("force", "displacement", "speed")
            for value in (0.0, float("nan"), float("inf"))
        ),
        {"step": axes(-1.0)},
        {"mass": axes(float("nan"))},
    ],
)
def test_a_board_that_is_none_does_not_begin(changed: dict[str, object]) -> None:
    assert Core(**changed).begun == -1


@given(
    st.lists(
        st.binary(max_size=200)
        | st.builds(force, st.integers(0, 70000), st.integers(0, 2**32 - 1), st.tuples(*[st.floats(width=32)] * AXES))
        | st.integers(0, 2**32 - 1).map(hello),
        max_size=12,
    ),
    st.lists(st.integers(0, 2**30), min_size=12, max_size=12),
    st.integers(0, 2**32 - 1),
)
def test_whatever_comes_no_force_is_beyond_its_limits_or_its_time(
    pieces: list[bytes], pauses: list[int], begin: int
) -> None:
    """Any bytes, at any instants of a clock that wraps."""
    one = Core(begin)
    for piece, pause in zip(pieces, pauses, strict=False):
        one.take(piece)
        first, second = one.force()
        assert abs(first) <= 5.0
        assert abs(second) <= 3.0
        one.sent()
        one.now += LONGEST
        assert one.force() == (0.0, 0.0)
        one.now += pause
