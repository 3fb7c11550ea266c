"""SPEC.md says what the code does: its examples are the known byte vectors, its tables are compared with the data."""

import dataclasses
import re
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest

import manyhands.protocol
from manyhands.protocol import limits, messages
from manyhands.protocol.channels import CHANNELS
from manyhands.protocol.codec import LAYOUTS, decode, encode
from manyhands.protocol.gate import DROP_REASONS
from manyhands.protocol.handshake import TRANSITIONS
from manyhands.protocol.messages import PROTOCOL_VERSION, RefusalCode, Role, Telemetry

SPEC = (Path(manyhands.protocol.__file__).parent / "SPEC.md").read_text(encoding="utf-8")
NAMESPACE = {kind.__name__: kind for kind in LAYOUTS} | {"Role": Role, "array": np.array}
EXAMPLES = [
    (eval(message, dict(NAMESPACE)), bytes.fromhex(frame))
    for message, frame in re.findall(r"^\| `([A-Z].*?)` \| `([0-9a-f ]+)` \|$", SPEC, re.MULTILINE)
]


def table(header: str) -> list[list[str]]:
    """The cells of the table that begins with ``header``, without the backticks."""
    below = SPEC.split(header + "\n")[1].split("\n")[1:]
    rows = below[: next(i for i, line in enumerate(below) if not line.startswith("|"))]
    return [[cell.strip().strip("`") for cell in row.strip("|").split("|")] for row in rows]


@pytest.mark.parametrize(("message", "frame"), EXAMPLES, ids=[type(message).__name__ for message, _ in EXAMPLES])
def test_an_example_is_what_is_sent_and_understood(message: Any, frame: bytes) -> None:
    assert encode(message) == frame
    assert decode(frame, limits.MAX_CONTROL_BYTES) == message


def test_there_is_an_example_of_every_message() -> None:
    assert {type(message) for message, _ in EXAMPLES} == set(LAYOUTS)


def test_short_floats_are_understood_as_promised() -> None:
    frame = msgpack.packb([32, 1, {"speed": 0.5}, {}], use_single_float=True)
    assert decode(frame, limits.MAX_CONTROL_BYTES) == Telemetry(1, {"speed": 0.5}, {})


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


def test_what_is_dropped() -> None:
    assert {row[0] for row in table("| count | is |")} == set(DROP_REASONS)


def test_messages_that_are_declared_can_be_sent() -> None:
    declared = {kind for kind in vars(messages).values() if dataclasses.is_dataclass(kind)} - {messages.Signal}
    assert declared == set(LAYOUTS)
