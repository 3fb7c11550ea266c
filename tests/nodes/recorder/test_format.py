"""A recording read by others: by the ``mcap`` package, and by the letter of the specification."""

from __future__ import annotations

import json
import struct
import zlib
from io import BytesIO
from typing import Any

import numpy as np
import pytest
from mcap.data_stream import ReadDataStream
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Channel, Chunk, Message, MessageIndex, Schema
from mcap.stream_reader import StreamReader, get_chunk_data_stream
from mcap.summary import Summary

from manyhands.nodes.recorder.core import RecorderCore
from manyhands.nodes.recorder.format import CERTIFICATE_FILE, SESSION_FILE, Recorded
from manyhands.protocol.codec import encode
from manyhands.protocol.messages import Condition, Figures, Observation, Role

RECORDED = Recorded(
    "s",
    "id",
    0.002,
    "realtime",
    {"a": Role.DEVICE, "b": Role.DEVICE, "c": Role.COUPLING, "environment": Role.ENVIRONMENT},
    {"a": ("a",), "b": ("b.0", "b.1"), "c": ("a", "b.0", "b.1"), "environment": ("a", "b.0", "b.1")},
    ("plate", "lid"),
)
FILES = {SESSION_FILE: b"name: s\n", CERTIFICATE_FILE: b'{"id": "id"}\n'}
ROWS, PIECES = 30, 5
TICKS = ROWS * PIECES
NOW = 1_700_000_000_000_000_000
FIRST_ARRIVAL = NOW + ROWS * 2_000_000
EVERY = [(node, topic) for node in RECORDED.roles for topic in RECORDED.topics(node)]
NUMBERS = np.random.default_rng(3)
TRACES = {
    (node, topic.trace): NUMBERS.normal(size=(TICKS, len(RECORDED.columns(node, topic))))
    * 10.0 ** NUMBERS.integers(-30, 30, size=(TICKS, 1))
    for node, topic in EVERY
}
TRACES["a", "tau_us"][7] = np.inf
TRACES["b", "x"][7, 1] = np.nan
CONDITIONS = [
    (0, Condition("starting", 0.0, {"a": "starting"})),
    (ROWS, Condition("running", 0.3, {"a": "running"}, ("a",), ("Δt: too long",))),
    (TICKS, Condition("over", 1.0, {"a": "ended"}, (), (), (), ("“b” ended",))),
]


def written() -> bytes:
    core = RecorderCore(RECORDED, FILES, started=NOW - 1_000_000_000)
    out = [core.cut()]
    core.take(encode(CONDITIONS[0][1]), NOW - 500)
    for piece in range(PIECES):
        end = (piece + 1) * ROWS
        for node in RECORDED.roles:
            traces = {trace: values[end - ROWS : end] for (of, trace), values in TRACES.items() if of == node}
            arrival = FIRST_ARRIVAL + piece * 7_000_000_000  # whatever the clock on the wall does
            core.take(encode(Observation(node, end, Figures({"late": float(piece), "worst": np.nan}), traces)), arrival)
        if piece == 0:
            core.take(encode(CONDITIONS[1][1]), NOW)
        core.take(encode(Condition("running", 0.3 + piece, {"a": "running"}, ("a",), ("Δt: too long",))), NOW)
        out.append(core.cut())
    core.take(encode(CONDITIONS[2][1]), NOW)
    assert (core.refused, core.missing_in_all, core.tick) == (0, {}, TICKS)
    return b"".join((*out, core.end()))


DATA = written()


def summary() -> Summary:
    found = make_reader(BytesIO(DATA), validate_crcs=True).get_summary()
    assert found is not None
    return found


def by_topic(messages: Any) -> dict[str, list[tuple[Schema, Channel, Message]]]:
    out: dict[str, list[tuple[Schema, Channel, Message]]] = {}
    for schema, channel, message in messages:
        out.setdefault(channel.topic, []).append((schema, channel, message))
    return out


READERS = {
    "seeking": lambda: make_reader(BytesIO(DATA), validate_crcs=True).iter_messages(log_time_order=False),
    "not seeking": lambda: NonSeekingReader(BytesIO(DATA), validate_crcs=True).iter_messages(log_time_order=False),
}


@pytest.mark.parametrize("reader", READERS)
def test_there_is_a_message_for_every_tick_of_every_topic(reader: str) -> None:
    found = by_topic(READERS[reader]())
    rows = {f"/s/{node}/{topic.name}": (node, topic) for node, topic in EVERY}
    others = {*(f"/s/{node}/telemetry" for node in RECORDED.roles), "/s/supervisor/condition"}
    assert found.keys() == rows.keys() | others
    for name, (node, topic) in rows.items():
        plain = [json.loads(message.data, parse_constant=pytest.fail) for _, _, message in found[name]]
        assert [one["tick"] for one in plain] == list(range(TICKS))
        assert [one["time"] for one in plain] == [k * 2 / 1000 for k in range(TICKS)]
        one_number = topic.name in ("ledger", "tau")
        values = np.array([one[topic.trace] for one in plain], dtype=np.float64)
        expected = TRACES[node, topic.trace][:, 0] if one_number else TRACES[node, topic.trace]
        expected = np.where(np.isfinite(expected), expected, np.nan)
        assert values.tobytes() == expected.tobytes()
        assert {one.keys() == {"tick", "time", topic.trace} for one in plain} == {True}
        for k, (_, _, message) in enumerate(found[name]):
            assert (message.sequence, message.log_time, message.publish_time) == (k, *[NOW + k * 2_000_000] * 2)


def test_figures_and_conditions_stand_at_their_ticks() -> None:
    found = by_topic(READERS["seeking"]())
    told = [(message.log_time, json.loads(message.data)) for _, _, message in found["/s/c/telemetry"]]
    assert told == [
        (NOW + end * 2_000_000, {"tick": end, "figures": {"late": piece, "worst": None}})
        for piece, end in enumerate(range(ROWS, TICKS + 1, ROWS))
    ]
    conditions = [json.loads(message.data) for _, _, message in found["/s/supervisor/condition"]]
    assert [(one["tick"], one["phase"], one["elapsed"]) for one in conditions] == [
        (tick, condition.phase, condition.elapsed) for tick, condition in CONDITIONS
    ]
    assert conditions[1]["notices"] == ["Δt: too long"]
    times = [message.log_time for _, _, message in found["/s/supervisor/condition"]]
    assert times == [NOW - 500, NOW + ROWS * 2_000_000, NOW + TICKS * 2_000_000]


def fits(schema: dict[str, Any], value: Any) -> bool:
    """Whether a value conforms to a schema, for the keywords that our schemas use."""
    match schema["type"]:
        case "integer":
            return type(value) is int
        case "number":
            return type(value) in (int, float) or (value is None and schema.get("nullable", False))
        case "string":
            return type(value) is str
        case "array":
            return type(value) is list and all(fits(schema["items"], item) for item in value)
        case "object":
            more = schema.get("additionalProperties", {"type": "nothing"})
            return (
                type(value) is dict
                and value.keys() >= set(schema.get("required", ()))
                and all(fits(schema["properties"].get(key, more), item) for key, item in value.items())
            )
        case _:
            return False


def test_every_message_matches_its_schema_in_words_viewers_know() -> None:
    for schema, _, message in READERS["seeking"]():
        assert schema.encoding == "jsonschema"
        told = json.loads(schema.data)
        assert fits(told, json.loads(message.data)), (schema.name, message.data)
        assert set(told["required"]) == set(told["properties"])
        for field in told["properties"].values():  # Foxglove: one type each, objects with properties, arrays with items
            assert type(field["type"]) is str
            assert "properties" in field or field["type"] != "object"
            assert type(field.get("items", {}).get("type", "")) is str
    wrong = {"type": "object", "properties": {"tick": {"type": "integer"}}, "required": ["tick"]}
    assert not any(fits(wrong, value) for value in ({}, {"tick": 1.0}, {"tick": 1, "more": 1}))


def test_channels_say_what_they_are() -> None:
    channels = {channel.topic: channel for channel in summary().channels.values()}
    assert {channel.message_encoding for channel in channels.values()} == {"json"}
    for node, topic in EVERY:
        about = dict(channels[f"/s/{node}/{topic.name}"].metadata)
        assert tuple(json.loads(about.pop("columns"))) == RECORDED.columns(node, topic)
        assert about == {"node": node, "role": RECORDED.roles[node], "symbol": topic.symbol, "unit": topic.unit}
    assert channels["/s/c/telemetry"].metadata == {"node": "c", "role": "coupling"}
    assert channels["/s/supervisor/condition"].metadata == {"node": "supervisor", "role": "supervisor"}


def test_the_statistics_hold_and_the_index_finds_every_chunk() -> None:
    found, told = summary(), by_topic(READERS["not seeking"]())
    assert found.statistics is not None
    counts = {found.channels[number].topic: count for number, count in found.statistics.channel_message_counts.items()}
    assert counts == {topic: len(messages) for topic, messages in told.items()}
    times = [message.log_time for messages in told.values() for _, _, message in messages]
    assert found.statistics.message_count == len(times)
    assert found.statistics.message_start_time == min(times)
    assert found.statistics.message_end_time == max(times)
    assert found.statistics.chunk_count == len(found.chunk_indexes) == PIECES + 1
    assert (found.statistics.attachment_count, found.statistics.metadata_count) == (2, 1)
    assert found.statistics.schema_count == len(found.schemas)
    for index in found.chunk_indexes:
        opcode, length = struct.unpack_from("<BQ", DATA, index.chunk_start_offset)
        assert (opcode, length + 9) == (6, index.chunk_length)
        size = index.chunk_start_offset + index.chunk_length + index.message_index_length
        after = StreamReader(BytesIO(DATA[index.chunk_start_offset : size]), skip_magic=True, emit_chunks=True).records
        chunk = next(after)
        assert isinstance(chunk, Chunk)
        assert (chunk.compression, chunk.uncompressed_size) == ("zstd", index.uncompressed_size)
        stream, _ = get_chunk_data_stream(chunk, validate_crc=True)
        plain = stream.read(chunk.uncompressed_size)
        inside = []
        for number, offset in index.message_index_offsets.items():
            record = _message_index(offset)
            assert record.channel_id == number
            for time, at in record.records:
                code, _, channel, _, log_time = struct.unpack_from("<BQHIQ", plain, at)
                assert (code, channel, log_time) == (5, number, time)
                inside.append(time)
        assert (min(inside), max(inside)) == (index.message_start_time, index.message_end_time)
        assert (min(inside), max(inside)) == (chunk.message_start_time, chunk.message_end_time)


def _message_index(at: int) -> MessageIndex:
    opcode, length = struct.unpack_from("<BQ", DATA, at)
    assert opcode == 7
    return MessageIndex.read(ReadDataStream(BytesIO(DATA[at + 9 : at + 9 + length])))


def test_a_span_of_time_is_found_without_the_rest() -> None:
    begin, end = NOW + 40 * 2_000_000, NOW + 45 * 2_000_000
    reader = make_reader(BytesIO(DATA))
    found = [
        m.sequence for _, _, m in reader.iter_messages(topics=["/s/a/sample"], starting_at=begin, ending_before=end)
    ]
    assert found == [40, 41, 42, 43, 44]


def test_the_session_and_its_certificate_are_attached() -> None:
    reader = make_reader(BytesIO(DATA))
    attached = [*reader.iter_attachments()]
    assert {one.name: one.data for one in attached} == FILES
    assert {one.name: one.media_type for one in attached} == {
        SESSION_FILE: "application/yaml",
        CERTIFICATE_FILE: "application/json",
    }
    assert {(one.log_time, one.create_time) for one in attached} == {(NOW - 1_000_000_000,) * 2}
    (metadata,) = reader.iter_metadata()
    assert metadata.name == "session"
    assert Recorded.from_metadata(metadata.metadata) == RECORDED
    assert metadata.metadata["version"] == "2"


def test_every_checksum_is_there_and_right() -> None:
    """The library leaves out some that are zero, or that are of attachments: here they are reckoned by hand."""
    at, seen = 8, set()
    while at < len(DATA) - 8:
        opcode, length = struct.unpack_from("<BQ", DATA, at)
        body = DATA[at + 9 : at + 9 + length]
        seen.add(opcode)
        if opcode == 9:  # attachment
            assert struct.unpack("<I", body[-4:])[0] == zlib.crc32(body[:-4])
        elif opcode == 6:  # chunk
            assert struct.unpack_from("<I", body, 24)[0] != 0  # and right, as the readers found
        elif opcode == 15:  # end of data
            assert struct.unpack("<I", body)[0] == zlib.crc32(DATA[:at])
        elif opcode == 2:  # footer
            start, offsets, stated = struct.unpack("<QQI", body)
            assert stated == zlib.crc32(DATA[start : at + 9 + 16])
            assert start < offsets < at
        at += 9 + length
    assert {2, 6, 7, 9, 15} <= seen <= set(range(1, 16))
    assert DATA[at:] == DATA[:8] == b"\x89MCAP0\r\n"


def test_records_of_the_summary_are_found_by_their_offsets() -> None:
    at, groups = 8, {}
    while at < len(DATA) - 8:
        opcode, length = struct.unpack_from("<BQ", DATA, at)
        if opcode == 14:
            group, start, size = struct.unpack_from("<BQQ", DATA, at + 9)
            groups[group] = DATA[start : start + size]
        at += 9 + length
    assert groups.keys() == {3, 4, 8, 10, 11, 13}
    for group, data in groups.items():
        while data:
            opcode, length = struct.unpack_from("<BQ", data)
            assert opcode == group
            data = data[9 + length :]


def test_what_is_in_one_observation_is_in_one_chunk() -> None:
    for record in StreamReader(BytesIO(DATA), emit_chunks=True).records:
        if not isinstance(record, Chunk):
            continue
        told = _ticks_of(record)
        assert all(len(ticks) == ROWS for ticks in told.values())
        assert len({max(ticks) for ticks in told.values()}) <= 1


def _ticks_of(chunk: Chunk) -> dict[int, list[int]]:
    """The ticks in a chunk, by channel, for channels with ticks."""
    stream, size = get_chunk_data_stream(chunk)
    data, at = stream.read(size), 0
    out: dict[int, list[int]] = {}
    while at < len(data):
        opcode, length = struct.unpack_from("<BQ", data, at)
        if opcode == 5:
            plain = json.loads(data[at + 31 : at + 9 + length])
            if "time" in plain:
                channel = struct.unpack_from("<H", data, at + 9)[0]
                out.setdefault(channel, []).append(plain["tick"])
        at += 9 + length
    return out
