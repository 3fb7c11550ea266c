"""The state of buttons on the wire: absent where none is held down, bounded by what the peer has."""

from __future__ import annotations

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.protocol.codec import Malformed, SignalWriter, WaveWriter, decode, encode
from manyhands.protocol.gate import Gate, WaveGate
from manyhands.protocol.limits import MAX_BUTTONS, MAX_CONTROL_BYTES
from manyhands.protocol.messages import Force, Reaction, Sample, Tool, Wave

VALUES = np.array([1.0, -2.0])
MOST = 2**MAX_BUTTONS - 1


@pytest.mark.parametrize("kind", [Sample, Tool])
@pytest.mark.parametrize("buttons", [0, 1, 5, MOST])
def test_a_signal_with_buttons_is_written_and_read(kind: type[Sample] | type[Tool], buttons: int) -> None:
    frame = encode(kind(3, 7, VALUES, buttons))
    assert decode(frame, MAX_CONTROL_BYTES) == kind(3, 7, VALUES, buttons)
    assert frame == SignalWriter(kind, 2).frame(3, 7, VALUES.tolist(), buttons)
    assert len(frame) == len(encode(kind(3, 7, VALUES))) + 5 * bool(buttons)
    gate = Gate(kind, 2, buttons=MAX_BUTTONS)
    assert gate.admitted(frame, 3) == (1.0, -2.0)
    assert gate.buttons == buttons


@pytest.mark.parametrize("buttons", [-1, MOST + 1, True, 1.0])
def test_no_other_state_is_sent(buttons: int) -> None:
    with pytest.raises(ValueError, match="buttons"):
        encode(Sample(3, 7, VALUES, buttons))
    with pytest.raises(ValueError, match="buttons"):
        encode(Wave(3, (1.0,), 0.0, buttons))


@given(st.integers(0, MOST))
def test_a_frame_of_another_encoder_is_admitted_alike(buttons: int) -> None:
    plain = [16, 3, 7, VALUES.tobytes(), *([buttons] if buttons else [])]
    gate = Gate(Sample, 2, buttons=MAX_BUTTONS)
    assert gate.admitted(msgpack.packb(plain), 3) == (1.0, -2.0)
    assert gate.buttons == buttons


@pytest.mark.parametrize("entry", [0, -1, MOST + 1, 1.5, None, "a", b"", True, [1]])
def test_any_other_entry_after_the_values_is_malformed(entry: object) -> None:
    for plain in ([16, 3, 7, VALUES.tobytes(), entry], [20, 3, VALUES.tobytes(), 0.0, entry]):
        frame = msgpack.packb(plain)
        assert isinstance(decode(frame, MAX_CONTROL_BYTES), Malformed)
        gate: Gate | WaveGate = Gate(Sample, 2, buttons=MAX_BUTTONS) if plain[0] == 16 else WaveGate(2, buttons=3)
        assert (gate.admitted(frame, 3) if isinstance(gate, Gate) else gate.admitted(frame)) is None
        assert gate.dropped["malformed"] == 1


@pytest.mark.parametrize("kind", [Reaction, Force])
def test_no_force_has_buttons(kind: type[Reaction] | type[Force]) -> None:
    frame = msgpack.packb([18 if kind is Reaction else 19, 3, 7, VALUES.tobytes(), 1])
    assert isinstance(decode(frame, MAX_CONTROL_BYTES), Malformed)
    gate = Gate(kind, 2, buttons=MAX_BUTTONS)
    assert gate.admitted(frame, 3) is None


def test_a_button_that_the_peer_has_not_is_out_of_range() -> None:
    gate, waves = Gate(Sample, 2, buttons=2), WaveGate(2, buttons=2)
    assert gate.admitted(encode(Sample(3, 7, VALUES, 0b100)), 3) is None
    assert gate.admitted(encode(Sample(3, 7, VALUES, 0b11)), 3) is not None
    assert waves.admitted(WaveWriter(2).frame(1, [0.0, 0.0], 0.0, 0b100)) is None
    wave = waves.admitted(WaveWriter(2).frame(1, [0.0, 0.0], 0.0, 0b10))
    assert wave is not None
    assert (gate.buttons, wave.buttons) == (0b11, 0b10)
    assert gate.dropped["out_of_range"] == waves.dropped["out_of_range"] == 1


def test_a_frame_with_buttons_that_breaks_off_is_malformed() -> None:
    whole = encode(Sample(3, 7, VALUES, 5))
    for size in range(len(whole)):
        gate = Gate(Sample, 2, buttons=3)
        assert gate.admitted(whole[:size], 3) is None
        assert gate.dropped["malformed"] == 1, size


def test_a_signal_of_another_tick_with_buttons_is_recognised() -> None:
    assert Gate(Sample, 2, buttons=3).of_other_tick(encode(Sample(9, 7, VALUES, 5))) == (9, False)


def test_the_state_of_a_signal_that_is_refused_does_not_count() -> None:
    gate = Gate(Sample, 2, buttons=3)
    gate.admitted(encode(Sample(3, 7, VALUES, 1)), 3)
    gate.admitted(encode(Sample(9, 7, VALUES, 2)), 4)
    assert gate.buttons == 1
    gate.admitted(encode(Sample(4, 7, VALUES)), 4)
    assert gate.buttons == 0
