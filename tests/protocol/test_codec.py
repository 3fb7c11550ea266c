"""Every message survives the wire, in either encoding, and what cannot be represented is refused before it leaves."""

import dataclasses
import math
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from manyhands.protocol import limits
from manyhands.protocol.codec import LAYOUTS, ForeignHello, decode, encode
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
    RefusalCode,
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
    presentable,
)

printable = st.characters(exclude_categories=["C", "Z"], include_characters=" ")
names = st.text(printable, min_size=1, max_size=limits.MAX_NAME)
texts = st.text(printable | st.sampled_from("\n\t"), max_size=200)
counts = st.integers(0, limits.MAX_COUNT)
roles = st.sampled_from(Role)
finite = st.floats(allow_nan=False, allow_infinity=False)
numbers = st.floats(allow_nan=False)
endpoints = st.dictionaries(names, st.text(printable, min_size=1, max_size=limits.MAX_ENDPOINT), max_size=4)
named_numbers = st.dictionaries(names, numbers, max_size=4)
figures = st.builds(Figures, named_numbers, st.dictionaries(names, named_numbers, max_size=3))
statuses = st.builds(
    PromiseStatus,
    names,
    names,
    st.lists(names, max_size=2).map(tuple),
    st.none() | finite,
    st.none() | finite,
    named_numbers,
    texts,
)
values = hnp.arrays(np.float64, st.integers(1, limits.MAX_PORTS), elements=finite)
traces = hnp.arrays(np.float64, hnp.array_shapes(min_dims=2, max_dims=2, min_side=0, max_side=5), elements=numbers)


@st.composite
def link_hellos(draw: st.DrawFn) -> LinkHello:
    ports = tuple(draw(st.lists(names, min_size=1, max_size=4, unique=True)))
    row = st.tuples(*[finite] * len(ports))
    feedthrough = draw(st.none() | st.tuples(*[row] * len(ports)))
    certificate, session, name = draw(names), draw(names), draw(names)
    return LinkHello(PROTOCOL_VERSION, certificate, session, name, draw(roles), ports, feedthrough)


deeds = st.lists(names, max_size=limits.MAX_BY_ITSELF).map(tuple)

MESSAGES: dict[type[Any], st.SearchStrategy[Message]] = {
    LinkHello: link_hellos(),
    NodeHello: st.builds(
        NodeHello, st.just(PROTOCOL_VERSION), names, names, names, roles, st.integers(1, limits.MAX_PID), endpoints
    ),
    Welcome: st.just(Welcome()),
    Refusal: st.builds(Refusal, st.sampled_from(RefusalCode), texts),
    Connect: st.builds(Connect, endpoints),
    Ready: st.builds(Ready, deeds),
    Start: st.builds(Start, counts, counts, counts),
    Stop: st.builds(Stop, texts),
    Sample: st.builds(Sample, counts, counts, values),
    Tool: st.builds(Tool, counts, counts, values),
    Reaction: st.builds(Reaction, counts, counts, values),
    Force: st.builds(Force, counts, counts, values),
    Telemetry: st.builds(Telemetry, counts, figures, st.dictionaries(names, traces, max_size=3)),
    Report: st.builds(Report, counts, figures),
    Fault: st.builds(Fault, texts),
    Probe: st.builds(Probe, counts),
    Echo: st.builds(Echo, counts, counts, counts, st.none() | st.floats(0.0, 60.0, exclude_min=True)),
    Absent: st.builds(Absent, names),
    Offer: st.builds(Offer, names, names),
    Return: st.builds(Return, names, names),
    Shift: st.builds(Shift, names, st.integers(0, limits.MAX_RUNG)),
    Rung: st.builds(Rung, st.integers(0, limits.MAX_RUNG)),
    Observation: st.builds(Observation, names, counts, figures, st.dictionaries(names, traces, max_size=3)),
    Condition: st.builds(
        Condition,
        names,
        st.floats(allow_nan=False, allow_infinity=False),
        st.dictionaries(names, names, max_size=3),
        st.lists(names, max_size=3).map(tuple),
        *[st.lists(texts, max_size=3).map(tuple)] * 3,
        st.lists(statuses, max_size=3).map(tuple),
        st.dictionaries(names, deeds, max_size=3),
    ),
    Wave: st.builds(Wave, counts, st.lists(finite, min_size=1, max_size=limits.MAX_PORTS).map(tuple), finite),
    PathKey: st.builds(
        PathKey, st.binary(min_size=8, max_size=8), st.binary(min_size=32, max_size=32), st.integers(1, 65535)
    ),
    Fetch: st.builds(Fetch, st.integers(0, limits.MAX_PART_BYTES - 1)),
    Piece: st.builds(
        Piece,
        st.integers(0, limits.MAX_PART_BYTES - 1),
        st.integers(1, limits.MAX_PART_BYTES),
        st.binary(min_size=1, max_size=500),
    ),
    Grasp: st.builds(Grasp, values),
    Release: st.just(Release()),
}
SIGNALS = (Sample, Tool, Reaction, Force)


def test_every_message_type_is_tested_here() -> None:
    assert MESSAGES.keys() == LAYOUTS.keys()
    assert len({number for number, _ in LAYOUTS.values()}) == len(LAYOUTS)
    for kind, (_, layout) in LAYOUTS.items():
        assert len(layout) == len(dataclasses.fields(kind))


@pytest.mark.parametrize("kind", MESSAGES, ids=lambda kind: kind.__name__)
@given(data=st.data())
def test_a_message_survives_the_wire(kind: type[Any], data: st.DataObject) -> None:
    message = data.draw(MESSAGES[kind])
    received = decode(encode(message), limits.MAX_CONTROL_BYTES)
    assert type(received) is kind
    assert received == message


@pytest.mark.parametrize("kind", MESSAGES, ids=lambda kind: kind.__name__)
@given(data=st.data())
def test_another_messagepack_encoder_is_understood(kind: type[Any], data: st.DataObject) -> None:
    """One that writes integers and byte strings as short as it can, so that signals miss the direct path."""
    message = data.draw(MESSAGES[kind])
    frame = msgpack.packb(msgpack.unpackb(encode(message)))
    assert decode(frame, limits.MAX_CONTROL_BYTES) == message


@pytest.mark.parametrize("kind", SIGNALS)
@given(tick=counts, stamp=counts, sent=values)
def test_bits_of_a_signal_are_kept(kind: type[Any], tick: int, stamp: int, sent: np.ndarray) -> None:
    received = decode(encode(kind(tick, stamp, sent)), limits.MAX_CONTROL_BYTES)
    assert isinstance(received, kind)
    assert received.values.dtype == np.float64
    assert received.values.tobytes() == sent.tobytes()  # the sign of zero too
    assert not received.values.flags.writeable


@given(counts, st.lists(finite, min_size=1, max_size=4), finite)
def test_bits_of_a_wave_are_kept(tick: int, sums: list[float], shipped: float) -> None:
    received = decode(encode(Wave(tick, tuple(sums), shipped)), limits.MAX_CONTROL_BYTES)
    assert isinstance(received, Wave)
    assert list(map(float.hex, (*received.sums, received.shipped))) == list(map(float.hex, (*sums, shipped)))


def test_a_path_key_shows_no_secret() -> None:
    key = PathKey(b"\x01" * 8, b"secret!!" * 4, 7400)
    assert "secret" not in f"{key} {key!r}"
    for wrong in (dataclasses.replace(key, secret=b"secret!!"), dataclasses.replace(key, secret="secret!!")):
        with pytest.raises(ValueError, match=r"PathKey.secret: found (8 bytes|str); expected 32 bytes"):
            encode(wrong)
    received = decode(msgpack.packb([21, key.connection, b"secret!!", 7400]), limits.MAX_CONTROL_BYTES)
    assert "secret!!" not in str(received)


def test_a_signal_that_is_not_contiguous_is_sent_as_it_reads() -> None:
    every_second = np.arange(6.0)[::2]
    received = decode(encode(Sample(0, 0, every_second)), limits.MAX_CONTROL_BYTES)
    assert received == Sample(0, 0, np.array([0.0, 2.0, 4.0]))


def test_signals_of_different_kind_or_content_differ() -> None:
    one = np.array([1.0])
    assert Sample(1, 2, one) == Sample(1, 2, np.array([1.0]))
    assert Sample(1, 2, one) != Tool(1, 2, one)
    assert Sample(1, 2, one) != Sample(2, 2, one)
    assert Sample(1, 2, one) != Sample(1, 3, one)
    assert Sample(1, 2, one) != Sample(1, 2, np.array([2.0]))
    assert Sample(1, 2, one) != (1, 2, one)
    assert Telemetry(1, Figures(), {"x": np.eye(1)}) != Telemetry(1, Figures(), {"x": np.zeros((1, 1))})
    assert Telemetry(1, Figures(), {}) != Ready()


def test_observations_of_different_nodes_or_content_differ() -> None:
    one = Observation("dx", 1, Figures({"speed": 0.5}), {"x": np.eye(1)})
    assert one == Observation("dx", 1, Figures({"speed": 0.5}), {"x": np.eye(1)})
    for other in (
        Observation("dy", 1, Figures({"speed": 0.5}), {"x": np.eye(1)}),
        Observation("dx", 2, Figures({"speed": 0.5}), {"x": np.eye(1)}),
        Observation("dx", 1, Figures({"speed": 0.6}), {"x": np.eye(1)}),
        Observation("dx", 1, Figures({"speed": 0.5}), {"x": np.zeros((1, 1))}),
        Telemetry(1, Figures({"speed": 0.5}), {"x": np.eye(1)}),
    ):
        assert one != other


def test_telemetry_carries_nonfinite_values() -> None:
    sent = Telemetry(3, Figures({"peak": math.inf, "ratio": math.nan}), {"x": np.array([[math.nan, -math.inf]])})
    received = decode(encode(sent), limits.MAX_CONTROL_BYTES)
    assert isinstance(received, Telemetry)
    assert received.figures["peak"] == math.inf
    assert math.isnan(received.figures["ratio"])
    np.testing.assert_array_equal(received.traces["x"], sent.traces["x"])


def test_numbers_of_numpy_are_numbers() -> None:
    sent = Report(np.int64(3), Figures({"a": np.float32(0.5), "b": 1, "c": np.int32(4)}))  # type: ignore[arg-type]
    assert decode(encode(sent), limits.MAX_CONTROL_BYTES) == Report(3, Figures({"a": 0.5, "b": 1.0, "c": 4}))
    tick = np.int64(7)
    assert decode(encode(Sample(tick, 0, np.ones(1))), limits.MAX_CONTROL_BYTES) == Sample(7, 0, np.ones(1))  # type: ignore[arg-type]


def test_the_greatest_link_fits_its_limits() -> None:
    ports = tuple(f"{i:0{limits.MAX_NAME}}" for i in range(limits.MAX_PORTS))
    row = (1 / 3,) * limits.MAX_PORTS
    certificate = "c" * limits.MAX_NAME
    hello = LinkHello(PROTOCOL_VERSION, certificate, "s", "n", Role.COUPLING, ports, (row,) * limits.MAX_PORTS)
    assert len(encode(hello)) <= limits.MAX_CONTROL_BYTES
    assert decode(encode(hello), limits.MAX_CONTROL_BYTES) == hello
    signal = encode(Tool(limits.MAX_COUNT, limits.MAX_COUNT, np.ones(limits.MAX_PORTS)))
    assert len(signal) == 2071 <= limits.MAX_CONTROL_BYTES


ONE = np.ones(1)
HELLO = LinkHello(1, "c", "s", "n", Role.DEVICE, ("p",))


@pytest.mark.parametrize(
    ("message", "what"),
    [
        (Sample(-1, 0, ONE), "Sample.tick: found -1; expected an integer from 0"),
        (Sample(True, 0, ONE), "Sample.tick: found True"),
        (Sample(2**63, 0, ONE), "Sample.tick: found 9223372036854775808"),
        (Sample(0, -1, ONE), "Sample.stamp: found -1"),
        (Tool(0, 0, np.array([math.nan])), "Tool.values: found a value that is not finite"),
        (Tool(0, 0, np.array([1.0, math.inf])), "Tool.values: found a value that is not finite"),
        (Tool(0, 0, np.ones(0)), "Tool.values: found b''; expected 8 bytes each for 1 to 256 values"),
        (Tool(0, 0, np.ones(limits.MAX_PORTS + 1)), "Tool.values: found bytes of length 2056"),
        (Tool(0, 0, np.ones((1, 1))), "Tool.values: found array.*expected a 1-D array of float64"),
        (Tool(0, 0, np.ones(1, np.float32)), "Tool.values: found array.*expected a 1-D array of float64"),
        (Tool(0, 0, [1.0]), r"Tool.values: found \[1.0\]; expected a 1-D array of float64"),
        (dataclasses.replace(HELLO, name=""), "LinkHello.name: found ''; expected a printable name"),
        (dataclasses.replace(HELLO, name="x" * 97), "LinkHello.name: found str of length 97"),
        (dataclasses.replace(HELLO, certificate="a\x1b[2J"), "LinkHello.certificate: found"),
        (dataclasses.replace(HELLO, version=-1), "LinkHello.version: found -1"),
        (dataclasses.replace(HELLO, role="ghost"), "LinkHello.role: found 'ghost'; expected one of device, coupling"),
        (dataclasses.replace(HELLO, ports=()), "LinkHello.ports: found"),
        (dataclasses.replace(HELLO, ports="dx"), "LinkHello.ports: found 'dx'; expected an array"),
        (dataclasses.replace(HELLO, ports=("a", "a")), "LinkHello.ports: found .*expected every port once"),
        (dataclasses.replace(HELLO, feedthrough=((math.nan,),)), "LinkHello.feedthrough: found nan"),
        (dataclasses.replace(HELLO, feedthrough=((True,),)), "LinkHello.feedthrough: found True; expected a float"),
        (NodeHello(1, "c", "s", "n", Role.DEVICE, 0, {}), "NodeHello.pid: found 0"),
        (Connect({"a": ""}), "Connect.endpoints: found ''"),
        (Connect(None), "Connect.endpoints"),
        (Refusal("no such code", "text"), "Refusal.code: found 'no such code'"),
        (Stop("x" * 4097), "Stop.reason: found str of length 4097"),
        (Fault("a\x00b"), "Fault.text: found"),
        (Fault("\ud800"), "Fault.text: found"),
        (Wave(-1, (1.0,), 0.0), "Wave.tick: found -1"),
        (Wave(True, (1.0,), 0.0), "Wave.tick: found True"),
        (Wave(0, (), 0.0), "Wave.sums: found b''; expected 8 bytes each for 1 to 256 values"),
        (Wave(0, (1.0,) * 257, 0.0), "Wave.sums: found bytes of length 2056"),
        (Wave(0, (math.inf,), 0.0), "Wave.sums: found a value that is not finite"),
        (Wave(0, [1.0], 0.0), r"Wave.sums: found \[1.0\]; expected a tuple of floats"),
        (Wave(0, (1,), 0.0), r"Wave.sums: found \(1,\); expected a tuple of floats"),
        (Wave(0, (1.0,), math.nan), "Wave.shipped: found nan; expected a finite number"),
        (Wave(0, (1.0,), "0"), "Wave.shipped: found '0'; expected a float"),
        (PathKey(b"", bytes(32), 1), "PathKey.connection: found 0 bytes; expected 8 bytes"),
        (PathKey(bytes(8), bytes(32), 0), "PathKey.port: found 0; expected an integer from 1 to 65535"),
        (Fetch(2**24), "Fetch.at: found 16777216; expected an integer from 0 to 16777215"),
        (Piece(0, 0, b"x"), "Piece.total: found 0; expected an integer from 1"),
        (Piece(0, 1, b""), "Piece.content: found 0 bytes; expected 1 to 65536 bytes"),
        (Piece(0, 2**24, bytes(65537)), "Piece.content: found 65537 bytes; expected 1 to 65536 bytes"),
        (Rung(16), "Rung.rung: found 16; expected an integer from 0 to 15"),
        (Offer("cx", ""), "Offer.endpoint: found ''; expected a printable name"),
        (Probe(-1), "Probe.sent: found -1; expected an integer from 0"),
        (Echo(0, 2**63, 0), "Echo.heard: found 9223372036854775808"),
        *((Echo(0, 0, 0, R), "Echo.round_trip: found") for R in (0.0, -0.1, 60.1, math.inf, math.nan, 1j)),
        (Observation("", 1, Figures(), {}), "Observation.node: found ''"),
        (
            Observation("dx", 1, Figures(), {"x": np.ones(3)}),
            "Observation.traces: found .*expected a 2-D array of float64",
        ),
        (Report(1, {"late": 1.0}), "Report.figures: found {'late': 1.0}; expected figures"),  # type: ignore[arg-type]
        (Report(1, Figures({"a": 10**400})), "Report.figures"),
        (Telemetry(1, Figures(), {"x": np.ones(3)}), "Telemetry.traces: found .*expected a 2-D array of float64"),
        (Telemetry(1, Figures(), {"x": np.zeros((200_000, 1))}), "Telemetry.traces: found 200000 rows"),
        (
            Telemetry(1, Figures(), {k: np.zeros((9, 9000)) for k in "ab"}),
            "Telemetry: found a frame of .*at most 1048576",
        ),
        (ForeignHello(2), "found ForeignHello; expected a message of the protocol"),
    ],
)
def test_what_cannot_be_represented_is_refused(message: Any, what: str) -> None:
    with pytest.raises(ValueError, match=what):
        encode(message)


@given(st.text(max_size=50) | st.text(min_size=limits.MAX_TEXT - 2, max_size=limits.MAX_TEXT + 5))
def test_a_presentable_text_can_always_be_sent(text: str) -> None:
    assert isinstance(decode(encode(Fault(presentable(text))), limits.MAX_CONTROL_BYTES), Fault)


@given(texts)
def test_a_text_that_is_presentable_stays_as_it_is(text: str) -> None:
    assert presentable(text) == text
