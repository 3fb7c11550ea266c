"""From observations to the bytes of an MCAP file, in the order in which they are to be written. Pure.

Observations go in, and the bytes that the file still lacks come out, in pieces that end at a chunk's border. A chunk
has a checksum and stands alone, so a file that ends anywhere is readable up to its last whole chunk. All messages of
one observation are in one chunk.

A message is ``{"tick": 17, "time": 0.017, "x": [0.001]}``. With three users a recorder makes 23 000 messages a second,
its greatest work, so it makes those of many ticks at once. The beginning of a message is the same for all topics of a
node and is made once; one call writes the numbers of a whole trace. A number is the shortest text that reads back as
the same double; a number that is not finite is null.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from manyhands.nodes.recorder.coverage import Coverage, missing_by_party
from manyhands.nodes.recorder.format import (
    MAX_TIME_NS,
    MEDIA_TYPES,
    MESSAGE_ENCODING,
    METADATA,
    OTHER_SCHEMAS,
    SCHEMA_ENCODING,
    SEQUENCES,
    SUPERVISOR,
    TICK,
    TIME,
    Recorded,
    encode_condition,
    encode_figures,
    schema_of,
)
from manyhands.nodes.recorder.mcap import Tape
from manyhands.protocol.channels import CONDITION, TELEMETRY, Columns, Topic, topic_name
from manyhands.protocol.codec import decode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import Condition, Observation, Role, Stop, Values

_BLOCK: Final = 128  # ticks


@dataclass(frozen=True, eq=False)
class Ticks:
    """The common parts of the messages of consecutive ticks.

    Attributes:
        times: the time of each tick, ns since 1970, uint64.
        sequences: their sequence numbers, uint32.
        beginnings: for each tick the beginning of its messages, up to the key of the topic's value.
        lengths: the lengths of the beginnings, bytes.
    """

    times: NDArray[np.uint64]
    sequences: NDArray[np.uint32]
    beginnings: tuple[bytes, ...]
    lengths: NDArray[np.uint64]

    @classmethod
    def of(cls, first: int, count: int, start: int, tick_ns: float) -> Ticks:
        """The ticks ``first`` to ``first + count - 1`` of a session whose tick 0 was at ``start``, ns since 1970."""
        numbers = np.arange(first, first + count, dtype=np.uint64)
        beginnings = _beginnings(first, count, tick_ns)
        return cls(
            np.uint64(start) + _since_start(first, count, tick_ns).astype(np.uint64),
            (numbers % np.uint64(SEQUENCES)).astype(np.uint32),
            beginnings,
            lengths_of(beginnings),
        )


def _since_start(first: int, count: int, tick_ns: float) -> NDArray[np.float64]:
    """The times of the ticks since tick 0, ns: whole numbers."""
    return np.rint(np.arange(first, first + count, dtype=np.uint64).astype(np.float64) * tick_ns)


def _beginnings(first: int, count: int, tick_ns: float) -> tuple[bytes, ...]:
    """The beginnings of the messages of these ticks, from cached blocks: all nodes have messages of the same ticks."""
    out: list[bytes] = []
    for block in range(first // _BLOCK, (first + count - 1) // _BLOCK + 1):
        out += _block(block, tick_ns)
    skipped = first % _BLOCK
    return tuple(out[skipped : skipped + count])


@lru_cache(maxsize=64)
def _block(number: int, tick_ns: float) -> tuple[bytes, ...]:
    first = number * _BLOCK
    times = (_since_start(first, _BLOCK, tick_ns) / 1e9).tolist()
    return tuple(f'{{"{TICK}": {tick}, "{TIME}": {time!r}, '.encode() for tick, time in enumerate(times, first))


def lengths_of(texts: Sequence[bytes]) -> NDArray[np.uint64]:
    """The length of each text, bytes."""
    return np.fromiter(map(len, texts), dtype=np.uint64, count=len(texts))


def row_texts(values: NDArray[np.float64], one: bool) -> list[bytes]:
    """Each row as JSON text without brackets.

    Args:
        values: ticks x columns; at least one of each.
        one: whether a row is a plain number, and no array.
    """
    plain = values[:, 0].tolist() if one else values.tolist()
    text = repr(plain).encode()
    if not np.isfinite(values).all():
        for word in (b"nan", b"-inf", b"inf"):
            text = text.replace(word, b"null")
    return text[1:-1].split(b", ") if one else text[2:-2].split(b"], [")


CHUNK_BYTES: Final = 1024 * 1024
"""The size at which a chunk is closed, however young it is, bytes."""


class RecorderCore:
    """Turns observations into the bytes of a file.

    Times in the file are the session's own: tick k was at the start plus kT. The start is counted back from the arrival
    of the first observation. So times are the time of day as well, as long as the ticks keep pace with it.

    Attributes:
        over: whether the supervisor has reported the end of the session.
        tick: the latest tick of any device that was taken.
        refused: frames that were no observation, were of an unknown node, or did not fit its columns and ticks.
    """

    def __init__(self, recorded: Recorded, attachments: Mapping[str, bytes] | None = None, started: int = 0) -> None:
        """Begin the file.

        Args:
            recorded: the session that is recorded.
            attachments: contents by name, with names from :data:`~manyhands.nodes.recorder.format.MEDIA_TYPES`.
            started: the time at which the recording starts, ns since 1970.
        """
        self._recorded = recorded
        self._tape = Tape(f"manyhands {recorded.version}")
        self._tape.metadata(METADATA, recorded.as_metadata())
        for name, data in (attachments or {}).items():
            self._tape.attach(name, MEDIA_TYPES.get(name, "application/octet-stream"), data, started)
        self._topics = {node: {topic.trace: topic for topic in recorded.topics(node)} for node in recorded.roles}
        self._schemas: dict[str, int] = {}
        self._channels: dict[tuple[str, str], int] = {}
        self._coverage = {node: Coverage() for node in recorded.roles}
        self._start: int | None = None
        self._condition: Condition | None = None
        self.over = False
        self.tick = 0
        self.refused = 0

    def take(self, frame: bytes, time: int) -> None:
        """Take in a frame that arrived at ``time``, ns since 1970; frames that are refused are counted."""
        message = decode(frame, MAX_CONTROL_BYTES)
        if isinstance(message, Stop):
            self.over = True
        elif isinstance(message, Condition):
            self._note(message, time)
        elif isinstance(message, Observation) and self._fits(message):
            if self._start is None:
                self._start = max(0, time - self._since_start(message.tick))
            self._write(message)
        else:
            self.refused += 1

    def _since_start(self, tick: int) -> int:
        """The time of ``tick`` since tick 0, ns."""
        return round(tick * self._recorded.tick_ns)

    def _fits(self, told: Observation) -> bool:
        topics, rows = self._topics.get(told.node), {trace.shape[0] for trace in told.traces.values()}
        if topics is None or not told.traces.keys() <= topics.keys():
            return False
        first = told.tick - max(rows, default=0)
        return (
            len(rows) <= 1
            and first >= (self._coverage[told.node].next if rows else 0)
            and (self._start or 0) + self._since_start(told.tick) <= MAX_TIME_NS
            and all(self._width(told.node, topics[name]) == trace.shape[1] for name, trace in told.traces.items())
        )

    def _width(self, node: str, topic: Topic) -> int:
        return len(self._recorded.columns(node, topic))

    def _write(self, told: Observation) -> None:
        start, rows = self._start or 0, max((trace.shape[0] for trace in told.traces.values()), default=0)
        if rows:
            ticks = Ticks.of(told.tick - rows, rows, start, self._recorded.tick_ns)
            for topic in self._topics[told.node].values():
                if topic.trace in told.traces:
                    self._write_trace(told.node, topic, ticks, told.traces[topic.trace])
            self._coverage[told.node].take(told.tick - rows, told.tick)
            if told.node in self._recorded.devices:
                self.tick = max(self.tick, told.tick)
        if told.figures:
            channel = self._channel(told.node, TELEMETRY, None)
            self._add(channel, told.tick, start, encode_figures(told.tick, told.figures))

    def _write_trace(self, node: str, topic: Topic, ticks: Ticks, values: Values) -> None:
        one = topic.columns is Columns.ONE
        rows, count = row_texts(values, one), len(values)
        key, end = f'"{topic.trace}": {"" if one else "["}'.encode(), b"}" if one else b"]}"
        lengths = ticks.lengths + lengths_of(rows) + np.uint64(len(key) + len(end))
        columns = (ticks.beginnings, (key,) * count, rows, (end,) * count)
        self._tape.messages(self._channel(node, topic.name, topic), ticks.times, ticks.sequences, lengths, columns)

    def _channel(self, node: str, name: str, topic: Topic | None) -> int:
        """The number of the channel of a node's topic; its record is written before its first message."""
        number = self._channels.get((node, name))
        if number is None:
            about = {"node": node, "role": self._recorded.roles.get(node, Role.SUPERVISOR).value}
            if topic is not None:
                columns = json.dumps(self._recorded.columns(node, topic), ensure_ascii=False)
                about |= {"symbol": topic.symbol, "unit": topic.unit, "columns": columns}
            title, text = OTHER_SCHEMAS[name] if topic is None else schema_of(topic)
            if title not in self._schemas:
                self._schemas[title] = self._tape.schema(title, SCHEMA_ENCODING, text)
            full = topic_name(self._recorded.session, node, name)
            number = self._tape.channel(full, MESSAGE_ENCODING, self._schemas[title], about)
            self._channels[node, name] = number
        return number

    def _add(self, channel: int, tick: int, start: int, data: bytes) -> None:
        self._tape.message(channel, start + self._since_start(tick), tick % SEQUENCES, data)

    def _note(self, condition: Condition, time: int) -> None:
        """Write the session's condition, if more of it than the time has changed."""
        before, self._condition = self._condition, condition
        if before is not None and replace(condition, elapsed=before.elapsed) == before:
            return
        channel = self._channel(SUPERVISOR, CONDITION, None)
        data = encode_condition(self.tick, condition)
        if self._start is None:  # the time of tick 0 is not known yet
            self._tape.message(channel, time, self.tick % SEQUENCES, data)
        else:
            self._add(channel, self.tick, self._start, data)

    @property
    def missing_in_all(self) -> dict[str, int]:
        """By device, the ticks up to the latest of any device that never came; devices without any are left out."""
        return missing_by_party(self.coverage, 0, self.tick)

    @property
    def coverage(self) -> dict[str, Coverage]:
        """By device, the ticks that were taken; the other ticks were lost on the way."""
        return {device: self._coverage[device] for device in self._recorded.devices}

    @property
    def full(self) -> bool:
        """Whether the chunk has its greatest size and should be closed now."""
        return self._tape.waiting >= CHUNK_BYTES

    def cut(self) -> bytes:
        """Close the chunk; returns the bytes that the file lacks so far, which may be none."""
        self._tape.close_chunk()
        return self._tape.take()

    def end(self) -> bytes:
        """Close the file; returns its last bytes, with the index that viewers expect at the end."""
        self._tape.finish()
        return self._tape.take()
