"""SPEC.md agrees with the code: its examples are the known byte vectors, its tables equal the data."""

import dataclasses
import re
from typing import Any

import msgpack
import numpy as np
import pytest

from manyhands.protocol import limits, messages
from manyhands.protocol.channels import CHANNELS, TOPICS
from manyhands.protocol.clock import Exchange, Instant
from manyhands.protocol.codec import LAYOUTS, decode, encode
from manyhands.protocol.gate import DROP_REASONS
from manyhands.protocol.handshake import TRANSITIONS, Expected, check_link_hello, check_node_hello
from manyhands.protocol.messages import (
    PROTOCOL_VERSION,
    Figures,
    LinkHello,
    NodeHello,
    PathKey,
    RefusalCode,
    Role,
    Telemetry,
    Wave,
)
from manyhands.protocol.path import TRANSITIONS as PATH_TRANSITIONS
from manyhands.protocol.path import Direction, NotOpened, PathEnd
from manyhands.protocol.transport.door import NotAdmitted

from ..support.spec_text import SPEC, table

NAMESPACE = {kind.__name__: kind for kind in LAYOUTS} | {"Role": Role, "Figures": Figures, "array": np.array}
EXAMPLES = [
    (eval(message, dict(NAMESPACE)), bytes.fromhex(frame))
    for message, frame in re.findall(r"^\| `([A-Z].*?)` \| `([0-9a-f ]+)` \|$", SPEC, re.MULTILINE)
]


@pytest.mark.parametrize(("message", "frame"), EXAMPLES, ids=[type(message).__name__ for message, _ in EXAMPLES])
def test_an_example_is_what_is_sent_and_understood(message: Any, frame: bytes) -> None:
    assert encode(message) == frame
    assert decode(frame, limits.MAX_CONTROL_BYTES) == message


def test_there_is_an_example_of_every_message() -> None:
    assert {type(message) for message, _ in EXAMPLES} == set(LAYOUTS)


def test_short_floats_are_understood_as_promised() -> None:
    frame = msgpack.packb([32, 1, [{"speed": 0.5}, {}], {}], use_single_float=True)
    assert decode(frame, limits.MAX_CONTROL_BYTES) == Telemetry(1, Figures({"speed": 0.5}), {})


def test_the_version_is_this_one() -> None:
    assert SPEC.startswith(f"# The manyhands protocol, version {PROTOCOL_VERSION}\n")


def test_channels() -> None:
    expected = [
        [
            channel.name,
            ", ".join(message.__name__ for message in channel.messages),
            ", ".join(channel.senders),
            ", ".join(channel.receivers),
            channel.symbol,
            channel.unit,
            channel.rate,
        ]
        for channel in CHANNELS.values()
    ]
    assert table("| channel | messages | from | to | quantity | unit | rate |") == expected


def test_topics() -> None:
    expected = [
        [role, topic.name, topic.trace, topic.symbol, topic.unit, topic.columns]
        for role, topics in TOPICS.items()
        for topic in topics
    ]
    found = table("| role | topic | trace | quantity | unit | columns |")
    assert [[cell.strip("`") for cell in row] for row in found] == expected


def test_messages_and_their_fields() -> None:
    expected = [
        [str(number), kind.__name__, ", ".join(field.name for field in dataclasses.fields(kind))]
        for kind, (number, _) in LAYOUTS.items()
    ]
    assert table("| type | message | fields |") == expected


def test_every_field_is_explained() -> None:
    explained = {name for row in table("| field | is |") for name in row[0].split(", ")}
    assert explained == {field.name for kind in LAYOUTS for field in dataclasses.fields(kind)}


@pytest.mark.parametrize("choices", [Role, RefusalCode])
def test_choices(choices: Any) -> None:
    (row,) = [row for row in table("| field | is |") if row[0] == {Role: "role", RefusalCode: "code"}[choices]]
    assert re.findall(r'"(\w+)"', row[1]) == list(choices)


def test_the_handshake() -> None:
    expected = [[state, event, following, answer] for (state, event), (following, answer) in TRANSITIONS.items()]
    assert table("| state | what arrives | next state | is answered with |") == expected


def test_limits() -> None:
    expected = {name: value for name, value in vars(limits).items() if name.isupper()}
    assert {row[0]: int(row[1]) for row in table("| limit | value | of |")} == expected


def test_what_is_dropped_in_the_order_in_which_it_is_seen() -> None:
    assert [row[0] for row in table("| count | is |")] == list(DROP_REASONS)


def test_messages_that_are_declared_can_be_sent() -> None:
    declared = {kind for kind in vars(messages).values() if dataclasses.is_dataclass(kind)}
    declared -= {messages.Signal, messages.PromiseStatus}  # parts of messages
    assert declared == set(LAYOUTS)


def test_enumerations() -> None:
    assert table("| role | bytes | is |")
    for choices, header in ((Role, "| role | bytes | is |"), (RefusalCode, "| code | bytes | refuses a hello for |")):
        rows = table(header)
        assert [row[0] for row in rows] == list(choices)
        assert [bytes.fromhex(row[1]) for row in rows] == [msgpack.packb(choice.value) for choice in choices]


def test_of_several_codes_the_first() -> None:
    """A hello that is wrong in every way, put right one thing after the other."""
    right = NodeHello(PROTOCOL_VERSION, "id", "s", "dx", Role.DEVICE, 1, {})
    wrong = NodeHello(PROTOCOL_VERSION + 1, "other", "t", "dz", Role.OBSERVER, 1, {"cx": "ipc:///x"})
    found = []
    for field in ("version", "certificate", "session", "name", "role", "endpoints"):
        refusal = check_node_hello(wrong, "id", "s", {"dx": Role.DEVICE}, "dx")
        assert refusal is not None
        found.append(refusal.code)
        wrong = dataclasses.replace(wrong, **{field: getattr(right, field)})
    own = LinkHello(PROTOCOL_VERSION, "id", "s", "environment", Role.ENVIRONMENT, ("p",))
    good = LinkHello(PROTOCOL_VERSION, "id", "s", "cx", Role.COUPLING, ("p",), ((0.5,),))
    bad = LinkHello(PROTOCOL_VERSION + 1, "other", "t", "cz", Role.DEVICE, ("q",), None)
    on_links = []
    for field in ("version", "certificate", "session", "name", "role", "ports", "feedthrough"):
        refusal = check_link_hello(bad, own, Expected("cx", Role.COUPLING, ("p",)))
        assert refusal is not None
        on_links.append(refusal.code)
        bad = dataclasses.replace(bad, **{field: getattr(good, field)})
    codes = [row[0] for row in table("| code | bytes | refuses a hello for |")]
    for order in (found, on_links):
        assert order == sorted(order, key=codes.index)
    assert {*found, *on_links, RefusalCode.MALFORMED} == set(codes)


def test_what_is_counted_at_a_door() -> None:
    assert [row[0] for row in table("| count at a door | is |")] == list(NotAdmitted)


def test_what_is_refused_at_a_path() -> None:
    assert [row[0] for row in table("| count at a path | is |")] == list(NotOpened)


def test_what_becomes_of_a_path() -> None:
    expected = [[state, event, following] for (state, event), following in PATH_TRANSITIONS.items()]
    assert table("| a path that is | learns of | is then |") == expected


def test_the_example_of_a_datagram() -> None:
    (key,) = (message for message, _ in EXAMPLES if isinstance(message, PathKey))
    (wave,) = (message for message, _ in EXAMPLES if isinstance(message, Wave))
    text = SPEC.split("the coupling's first datagram")[1].split("\n\n")[1]
    coupling, environment = (PathEnd(key, direction, Instant(0)) for direction in Direction)
    datagram, _ = coupling.outgoing(wave.tick, encode(wave), Instant(0))
    assert datagram == bytes.fromhex(text)
    assert environment.opens(datagram, Instant(0)) == encode(wave)


@pytest.mark.parametrize("version", [2, 3, 4])
def test_features_listed_as_new_are_there(version: int) -> None:
    new = SPEC.split(f"Version {version}, against version {version - 1}:")[1].split(", against version")[0]
    numbered = [(name, number) for name, number in re.findall(r"(\w+) \((\d+)\)", new) if name != "section"]
    assert numbered
    for name, number in numbered:
        assert LAYOUTS[getattr(messages, name)][0] == int(number)
    fields = {field.name for kind in LAYOUTS for field in dataclasses.fields(kind)}
    for name in re.findall(r"`(\w+)`", new):
        topics = {topic.name for own in TOPICS.values() for topic in own}
        assert name in {*Role, *CHANNELS, *RefusalCode, *DROP_REASONS, *fields, *topics}, name
    for name in re.findall(r"\b[A-Z]{2,}(?:_[A-Z]+)+\b", new):
        assert hasattr(limits, name), name


def test_clock_offset() -> None:
    formulas = re.findall(r"(offset|round trip) = (.*?)(?:   |\n)", SPEC)
    assert [name for name, _ in formulas] == ["offset", "round trip"]
    exchange = Exchange(sent=100, heard=1700, answered=1750, received=230)
    stamps = dataclasses.asdict(exchange)
    offset, round_trip = (eval(formula.replace("−", "-"), dict(stamps)) for _, formula in formulas)
    assert (offset, round_trip) == (exchange.offset, exchange.round_trip)
