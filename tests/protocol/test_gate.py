"""What a gate admits, and under which name it counts every other frame."""

import math
import struct
import sys
from collections.abc import Sequence

import msgpack
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from manyhands.protocol.clock import Duration, Instant
from manyhands.protocol.codec import LAYOUTS, LONGEST, decode, encode, read_head, type_of
from manyhands.protocol.gate import DRIFT, DROP_REASONS, MOST_PERIODS, ROUNDING, Bounds, Gate
from manyhands.protocol.limits import MAX_CONTROL_BYTES, MAX_COUNT
from manyhands.protocol.messages import PROTOCOL_VERSION, Figures, LinkHello, Ready, Role, Sample, Telemetry, Tool
from tests.support.gates import admit

from ..support.cases import cases

TICK = 10
PAIR = np.array([1.0, 2.0])


def doubles(*numbers: float) -> bytes:
    return struct.pack(f"<{len(numbers)}d", *numbers)


def usual(tick: int, *numbers: float, stamp: int = 0, number: int = 16) -> bytes:
    """A signal's frame in the usual layout, whatever its values."""
    head = struct.pack(">BBBQBQBH", 0x94, number, 0xCF, tick, 0xCF, stamp, 0xC5, 8 * len(numbers))
    return head + doubles(*numbers)


def counted(gate: Gate) -> dict[str, int]:
    return {reason: count for reason, count in gate.dropped.items() if count}


def test_the_awaited_signal_is_admitted() -> None:
    gate = Gate(Sample, 2)
    admitted = admit(gate, encode(Sample(TICK, 123, PAIR)), TICK)
    assert admitted is not None
    np.testing.assert_array_equal(admitted, PAIR)
    assert admitted.dtype == np.float64
    assert gate.stamp == 123
    assert gate.dropped == dict.fromkeys(DROP_REASONS, 0)


def test_our_signals_have_the_usual_layout() -> None:
    assert encode(Sample(TICK, 7, PAIR)) == usual(TICK, 1.0, 2.0, stamp=7)


SHORT = msgpack.packb([16, TICK, 0, doubles(1.0, 2.0)])

REFUSED = [
    (b"", "malformed"),
    (b"\xc1", "malformed"),
    (b"\x94", "malformed"),
    (b"\xdc\x00", "malformed"),
    (b"\x94\xc3" + usual(TICK, 1.0, 2.0)[2:], "malformed"),  # true is no type
    (b"\x90", "malformed"),
    (b"\x91\x63", "malformed"),  # no such type
    (b"\x91\x10", "malformed"),
    (b"\x95" + usual(TICK, 1.0, 2.0)[1:], "malformed"),
    (msgpack.packb([16, TICK, 0, doubles(1.0, 2.0), 0]), "malformed"),
    (msgpack.packb([16, TICK, 0]), "malformed"),
    (msgpack.packb([16, TICK, 0, [1.0, 2.0]]), "malformed"),
    (msgpack.packb([16, TICK, 0, b""]), "malformed"),
    (msgpack.packb([16, TICK, 0, doubles(1.0, 2.0)[1:]]), "malformed"),
    (msgpack.packb([16, float(TICK), 0, doubles(1.0, 2.0)]), "malformed"),
    (msgpack.packb([16, -1, 0, doubles(1.0, 2.0)]), "malformed"),
    (msgpack.packb([16, TICK, -1, doubles(1.0, 2.0)]), "malformed"),
    *[(msgpack.packb([16, tick, 0, doubles(1.0, 2.0)]), "malformed") for tick in (-100, -300, -70_000, -(2**40))],
    (usual(MAX_COUNT + 1, 1.0, 2.0), "malformed"),
    (usual(TICK, 1.0, 2.0, stamp=MAX_COUNT + 1), "malformed"),
    (usual(TICK - 1, 1.0, 2.0, stamp=MAX_COUNT + 1), "malformed"),
    (usual(TICK, 1.0, 2.0)[:-1], "malformed"),
    (usual(TICK, 1.0, 2.0) + b"\x00", "malformed"),
    (SHORT[:-1], "malformed"),
    (SHORT + b"\x00", "malformed"),
    (usual(TICK, *range(20)), "malformed"),  # longer than two values can be
    (encode(Sample(TICK, 0, PAIR)) + bytes(MAX_CONTROL_BYTES), "malformed"),
    (encode(Tool(TICK, 0, PAIR)), "wrong_kind"),
    (usual(TICK, math.nan, 2.0, number=17), "wrong_kind"),
    (encode(Ready()), "wrong_kind"),
    (encode(Telemetry(TICK, Figures(), {})), "wrong_kind"),
    (encode(LinkHello(PROTOCOL_VERSION + 1, "c", "s", "n", Role.DEVICE, ("p",))), "wrong_kind"),
    (usual(TICK, 1.0), "wrong_width"),
    (usual(TICK, 1.0, 2.0, 3.0), "wrong_width"),
    (usual(TICK - 1, 1.0), "wrong_width"),
    (msgpack.packb([16, TICK, 0, doubles(math.nan)]), "wrong_width"),
    (usual(TICK - 1, 1.0, 2.0), "old_tick"),
    (usual(0, math.nan, 2.0), "old_tick"),
    (usual(TICK + 1, 1.0, 2.0), "future_tick"),
    (usual(MAX_COUNT, math.inf, 2.0), "future_tick"),
    (usual(TICK, 1.0, math.nan), "not_finite"),
    (usual(TICK, -math.inf, 1.0), "not_finite"),
    (msgpack.packb([16, TICK, 0, doubles(1.0, math.nan)]), "not_finite"),
]


@pytest.mark.parametrize("bounds", [None, Bounds((4.0, 4.0), (1.0, 1.0)), Bounds((math.inf,) * 2)])
@pytest.mark.parametrize(("frame", "reason"), REFUSED)
def test_anything_else_is_dropped_and_counted(frame: bytes, reason: str, bounds: Bounds | None) -> None:
    gate = Gate(Sample, 2, bounds)
    assert admit(gate, encode(Sample(TICK - 1, 55, PAIR)), TICK - 1) is not None
    assert admit(gate, frame, TICK) is None
    assert gate.dropped == {**dict.fromkeys(DROP_REASONS, 0), reason: 1}
    assert gate.stamp == 55
    assert admit(gate, encode(Sample(TICK, 56, PAIR)), TICK) is not None  # and changes nothing


@given(st.lists(st.binary(max_size=40) | st.integers(0, 5).map(lambda k: encode(Sample(k, k, PAIR))), max_size=30))
def test_no_frame_is_lost_in_silence(frames: list[bytes]) -> None:
    gate = Gate(Sample, 2)
    admitted = sum(admit(gate, frame, 3) is not None for frame in frames)
    assert admitted + sum(gate.dropped.values()) == len(frames)
    assert gate.dropped.keys() == set(DROP_REASONS)


# --- the head, against the codec


def integers(number: int) -> list[bytes]:
    """Every encoding that MessagePack has for a number that is not negative."""
    forms = {0xCC: ">B", 0xCD: ">H", 0xCE: ">I", 0xCF: ">Q", 0xD0: ">b", 0xD1: ">h", 0xD2: ">i", 0xD3: ">q"}
    out = [bytes([number])] if number < 0x80 else []
    for tag, form in forms.items():
        bits = 8 * struct.calcsize(form) - form.islower()
        if number < 2**bits:
            out.append(bytes([tag]) + struct.pack(form, number))
    return out


@st.composite
def signals(draw: st.DrawFn) -> bytes:
    """A signal in any encoding, with any values, sometimes with one byte changed or cut off."""
    counts = st.sampled_from([0, TICK - 1, TICK, TICK, TICK, TICK + 1, 300, 70_000, 2**40, MAX_COUNT, MAX_COUNT + 1])
    values = draw(st.lists(st.floats() | st.floats(-2.0, 2.0), min_size=1, max_size=3))
    data = doubles(*values)
    array = draw(st.sampled_from([b"\x94", b"\xdc\x00\x04", b"\xdd\x00\x00\x00\x04"]))
    head = [draw(st.sampled_from(integers(draw(which)))) for which in (st.sampled_from([16, 16, 17]), counts, counts)]
    length = draw(st.sampled_from([b"\xc4" + bytes([len(data)]), struct.pack(">BH", 0xC5, len(data)),
                                   struct.pack(">BI", 0xC6, len(data))]))  # fmt: skip
    frame = array + b"".join(head) + length + data
    match draw(st.integers(0, 5)):
        case 0:
            at = draw(st.integers(0, len(frame) - 1))
            frame = frame[:at] + bytes([draw(st.integers(0, 255))]) + frame[at + 1 :]
        case 1:
            frame = frame[: draw(st.integers(0, len(frame)))]
    return frame


@settings(max_examples=cases(100, 600))
@given(signals() | st.binary(max_size=60))
@example(usual(TICK, 1.0, -0.0))
@example(b"\xdd\x00\x00\x00\x04\xd3" + b"\x00" * 7 + b"\x10" + (b"\xd3" + b"\x00" * 7 + b"\x0a") * 2
         + b"\xc6\x00\x00\x00\x10" + doubles(1.0, 2.0))  # fmt: skip
def test_a_gate_and_the_codec_agree_on_what_a_signal_is(frame: bytes) -> None:
    gate = Gate(Sample, 2)
    admitted = admit(gate, frame, TICK)
    message = decode(frame, MAX_CONTROL_BYTES)
    awaited = isinstance(message, Sample) and message.values.size == 2 and message.tick == TICK
    assert (admitted is not None) == awaited
    if isinstance(message, Sample) and admitted is not None:
        assert admitted.tobytes() == message.values.tobytes()
        assert gate.stamp == message.stamp
    if isinstance(message, Sample) and not awaited:
        width, k = message.values.size, message.tick
        reason = "wrong_width" if width != 2 else "old_tick" if k < TICK else "future_tick"
        if len(frame) > LONGEST + 8 * 2:
            reason = "malformed"
        assert counted(gate) == {reason: 1}
    if isinstance(message, (Sample, Tool)):
        head = read_head(frame)
        assert head is not None
        assert (head.tick, head.stamp) == (message.tick, message.stamp)
        assert frame[head.size :] == message.values.tobytes()
        assert type_of(frame) == LAYOUTS[type(message)][0]


@pytest.mark.parametrize("at", range(23))
def test_every_byte_of_the_usual_head_replaced(at: int) -> None:
    frame = usual(TICK, 1.0, 2.0, stamp=5)
    for byte in range(256):
        changed = frame[:at] + bytes([byte]) + frame[at + 1 :]
        message = decode(changed, MAX_CONTROL_BYTES)
        admitted = admit(Gate(Sample, 2), changed, TICK)
        assert (admitted is not None) == (isinstance(message, Sample) and message.tick == TICK)


def test_the_longest_encoding_has_the_stated_length() -> None:
    head = b"\xdd\x00\x00\x00\x04" + b"".join(integers(n)[-1] for n in (16, TICK, 5)) + b"\xc6\x00\x00\x00\x10"
    assert len(head) == LONGEST
    assert admit(Gate(Sample, 2), head + doubles(1.0, 2.0), TICK) is not None


# --- bounds

BOUNDS = Bounds((1.0, 10.0), (0.25, math.inf))


def run(gate: Gate, *ticks: Sequence[float]) -> list[bool]:
    """Which of the values, tick after tick, are admitted."""
    return [admit(gate, usual(k, *values), k) is not None for k, values in enumerate(ticks)]


def test_values_beyond_their_magnitude_are_refused_by_port() -> None:
    assert run(Gate(Sample, 2, BOUNDS), (1.0, -10.0)) == [True]
    for values in ((1.01, 0.0), (-1.01, 0.0), (0.0, 10.1), (0.0, -sys.float_info.max)):
        gate = Gate(Sample, 2, BOUNDS)
        assert run(gate, values) == [False]
        assert counted(gate) == {"out_of_range": 1}


def test_steps_are_counted_from_the_values_admitted_last() -> None:
    gate = Gate(Sample, 2, BOUNDS)
    assert run(gate, (1.0, 0.0), (0.75, 9.0), (0.5, -9.0), (0.8, 0.0), (0.6, 0.0)) == [True, True, True, False, True]
    assert counted(gate) == {"out_of_range": 1}


def test_the_first_signal_has_no_step() -> None:
    assert run(Gate(Sample, 2, Bounds((5.0, 5.0), (0.1, 0.1))), (4.0, -4.0), (4.05, -4.05)) == [True, True]


def test_a_value_refused_otherwise_is_no_base_for_a_step() -> None:
    gate = Gate(Sample, 2, BOUNDS)
    assert admit(gate, usual(0, 0.0, 0.0), 0) is not None
    for stray in (usual(0, 0.9, 0.0), usual(2, 0.9, 0.0), usual(1, 0.9, math.nan), usual(1, 0.9, 0.0)):
        assert admit(gate, stray, 1) is None
    assert admit(gate, usual(1, 0.3, 0.0), 1) is None
    assert admit(gate, usual(1, 0.25, 0.0), 1) is not None
    assert counted(gate) == {"old_tick": 1, "future_tick": 1, "not_finite": 1, "out_of_range": 2}


def test_only_the_awaited_ticks_values_are_looked_at() -> None:
    gate = Gate(Sample, 2, BOUNDS)
    admit(gate, usual(4, 99.0, 0.0), 5)
    admit(gate, usual(6, 99.0, 0.0), 5)
    assert counted(gate) == {"old_tick": 1, "future_tick": 1}


def test_rounding_is_let_pass_and_no_more() -> None:
    assert run(Gate(Sample, 1, Bounds((1.0,))), (1.0 + 0.9 * ROUNDING,)) == [True]
    assert run(Gate(Sample, 1, Bounds((1.0,))), (1.0 + 1.1 * ROUNDING,)) == [False]
    most = 1e-3 + ROUNDING * (1e-3 + 1.0)
    for value, admitted in ((0.999_999_99 * most, True), (1.000_000_01 * most, False)):
        assert run(Gate(Sample, 1, Bounds((1.0,), (1e-3,))), (0.0,), (value,)) == [True, admitted]


def test_without_a_bound_every_finite_value_passes() -> None:
    largest = sys.float_info.max
    for bounds in (None, Bounds((math.inf,)), Bounds((math.inf,), (math.inf,)), Bounds((largest,), None)):
        assert run(Gate(Sample, 1, bounds), (largest,), (-largest,), (math.inf,), (0.0,)) == [True, True, False, True]


@pytest.mark.parametrize("entries", [((-1.0,), None), ((math.nan,), None), ((1.0,), (-1.0,)), ((1.0,), (1.0, 1.0))])
def test_bounds_that_are_none_are_refused(entries: tuple[tuple[float, ...], tuple[float, ...] | None]) -> None:
    with pytest.raises(ValueError, match="expected"):
        Bounds(*entries)


def test_bounds_of_another_width_are_refused() -> None:
    with pytest.raises(ValueError, match="found bounds of 2 values; expected 3"):
        Gate(Sample, 3, BOUNDS)


T = 1_000_000  # ns
STEP = 0.25


class Hands:
    """A receiver's clock, moved by hand."""

    def __init__(self) -> None:
        self.time = 0.0  # ns

    def now(self) -> Instant:
        return Instant(round(self.time))

    def sleep_until(self, t: Instant) -> None:
        raise NotImplementedError


def timed(*signals: tuple[float, int, float], bounds: Bounds | None = None) -> list[bool]:
    """Which signals are admitted, of instants at the receiver (ms), stamps (ms) and values, tick after tick."""
    clock = Hands()
    gate = Gate(Sample, 1, bounds or Bounds((10.0,), (STEP,), Duration(T)), clock)
    admitted = []
    for tick, (instant, stamp, value) in enumerate(signals):
        clock.time = instant * T
        admitted.append(admit(gate, encode(Sample(tick, stamp * T, np.array([value]))), tick) is not None)
    return admitted


def stamped(*signals: tuple[int, float], bounds: Bounds | None = None) -> list[bool]:
    """The same where every stamp is true."""
    return timed(*((stamp, stamp, value) for stamp, value in signals), bounds=bounds)


def test_a_steps_bound_grows_with_periods_up_to_the_longest_wait() -> None:
    assert stamped((5, 0.0), (6, 0.25), (8, 0.75), (9, 1.25)) == [True, True, True, False]
    assert stamped((5, 0.0), (5 + MOST_PERIODS, 0.25 * MOST_PERIODS)) == [True, True]
    assert stamped((5, 0.0), (5000, 0.25 * MOST_PERIODS + 0.01)) == [True, False]
    assert stamped((5, 0.0), (0, 0.5)) == [True, False]  # a stamp that goes back gains nothing
    assert stamped((5, 9.9), (11, 10.1)) == [True, False]  # within its step, beyond its reach


def test_without_a_period_a_tick_is_one_whatever_the_stamps_claim() -> None:
    assert stamped((5, 0.0), (8, 0.75), bounds=Bounds((10.0,), (STEP,))) == [True, False]


def test_bounds_with_a_period_need_a_clock() -> None:
    with pytest.raises(ValueError, match="expected the receiver's clock"):
        Gate(Sample, 1, Bounds((10.0,), (STEP,), Duration(T)))


def test_claiming_the_longest_tick_every_time_gains_only_once() -> None:
    clock = Hands()
    gate = Gate(Sample, 1, Bounds((1e3,), (STEP,), Duration(T)), clock)
    at = 0.0
    for tick in range(100):
        clock.time += T
        further = at + STEP * MOST_PERIODS if tick else 0.0
        if admit(gate, encode(Sample(tick, MOST_PERIODS * T * tick, np.array([further]))), tick) is not None:
            at = further
    assert at <= STEP * (99 * (1.0 + DRIFT) + MOST_PERIODS)  # by the stamps alone it was 594 steps


def test_who_sends_faster_than_time_passes_gets_no_further() -> None:
    signals = [(0.1 * tick, tick, STEP * tick) for tick in range(12)]
    assert timed(*signals) == [tick <= 6 for tick in range(12)]


@given(
    data=st.lists(
        st.tuples(
            st.floats(0.0, 20.0),  # periods that pass at the receiver
            st.integers(0, 10**13) | st.integers(0, 200).map(lambda k: k * T),  # any stamp
            st.floats(-1.0, 1.0),  # of the greatest step that the claim would allow
            st.booleans(),
        ),
        max_size=60,
    )
)
@example(data=[(1.0, MOST_PERIODS * k * T, (-1.0) ** k, False) for k in range(40)])
def test_no_stamps_let_a_peer_go_further_than_time_has_passed(data: list[tuple[float, int, float, bool]]) -> None:
    clock = Hands()
    gate = Gate(Sample, 2, Bounds((1e3, 1e3), (STEP, STEP), Duration(T)), clock)
    most = STEP * (1.0 + ROUNDING) + ROUNDING * 1e3  # what a bound yields to rounding
    windows: list[tuple[float, float]] = []  # when it began, and the path since
    at, was = np.zeros(2), None
    for tick, (passed, stamp, share, both) in enumerate(data):
        clock.time += passed * T
        claimed = MOST_PERIODS * STEP * share
        values = at + np.array([claimed, claimed if both else 0.0])
        if admit(gate, encode(Sample(tick, stamp, values)), tick) is None:
            continue
        step = 0.0 if was is None else float(np.max(np.abs(values - was)))
        at = was = values
        windows = [(began, path + step) for began, path in windows]
        windows.append((clock.time, 0.0))
        for began, path in windows:
            periods = (1.0 + DRIFT) * (clock.time - began) / T + MOST_PERIODS
            assert path <= most * periods * (1.0 + 1e-9)


@given(
    ticks=st.lists(st.tuples(st.floats(0.0, 5.0), st.sampled_from([0.0, 0.0, 0.2, 0.9])), min_size=2, max_size=80),
    ppm=st.integers(-1000, 1000),
    offset=st.integers(10**9, 10**15),
)
@example(ticks=[(delay, 0.0) for delay in (0.0, 5.0, 0.0, 5.0, 5.0, 0.0)], ppm=1000, offset=10**9)
@example(ticks=[(0.1, 0.0)] * 4000, ppm=1000, offset=10**9)
@example(ticks=[(0.1, 0.0), (5.0, 0.9)] * 300, ppm=-1000, offset=10**9)
def test_an_honest_hand_at_its_limit_is_never_refused(ticks: list[tuple[float, float]], ppm: int, offset: int) -> None:
    """It samples late, by another clock, and its signals take anything up to what a device waits for an answer."""
    clock = Hands()
    gate = Gate(Sample, 1, Bounds((1e4,), (STEP,), Duration(T)), clock)
    fast = 1.0 + 1e-6 * ppm
    slot, before, value, way = 0, 0.0, 0.0, 1.0
    for tick, (delay, late) in enumerate(ticks):
        sampled = (slot + late) * T  # by its own clock
        passed = (sampled - before) / T
        value += way * STEP * min(passed, max(1, round(passed)))  # its own guard's limit
        way = -way if abs(value) > 100.0 else way
        clock.time = max(clock.time, sampled / fast + delay * T)
        frame = encode(Sample(tick, offset + round(sampled), np.array([value])))
        assert admit(gate, frame, tick) is not None
        before = sampled
        slot = max(slot + 1, min(math.ceil(clock.time * fast / T), math.floor(sampled / T) + MOST_PERIODS - 1))


def test_who_comes_back_after_long_is_admitted_from_where_it_is() -> None:
    clock = Hands()
    gate = Gate(Sample, 1, Bounds((10.0,), (STEP,), Duration(T)), clock)
    assert admit(gate, encode(Sample(0, 0, np.array([0.0]))), 0) is not None
    clock.time = 5000.0 * T
    gate.forget()
    assert admit(gate, encode(Sample(1, 5000 * T, np.array([9.0]))), 1) is not None
    clock.time += T
    assert admit(gate, encode(Sample(2, 5001 * T, np.array([9.0 + STEP]))), 2) is not None


def test_what_is_forgotten_bounds_no_step() -> None:
    gate = Gate(Sample, 1, Bounds((10.0,), (0.25,)))
    assert admit(gate, encode(Sample(0, 0, np.array([0.0]))), 0) is not None
    assert admit(gate, encode(Sample(1, T, np.array([5.0]))), 1) is None
    gate.forget()
    assert admit(gate, encode(Sample(2, 0, np.array([5.0]))), 2) is not None
    assert admit(gate, encode(Sample(3, 0, np.array([0.0]))), 3) is None
