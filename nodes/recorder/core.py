"""Turns observations into the bytes of an MCAP file, in the order in which they are to be written: without any I/O.

Observations go in. What the file still lacks comes out in pieces, each of which ends at the border of a chunk. A chunk
has a checksum and stands alone, so a file that ends anywhere can be read up to its last whole chunk. All messages of
one observation are in one chunk.

With three users 23 000 JSON messages are written a second, which is most of a recorder's work. A message is ``{"tick":
17, "time": 0.017, "x": [0.001]}``. Its beginning is the same for all topics of a tick and is made once for all nodes;
one call writes the numbers of a whole trace. A number is the shortest text that is read back as the same double; an
infinite value or NaN is null.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from manyhands.nodes.recorder.away import Away
from manyhands.nodes.recorder.coverage import Coverage, missing_by_party, spans_by_party
from manyhands.nodes.recorder.format import (
    MAX_TIME_NS,
    MESSAGE_ENCODING,
    METADATA,
    SCHEMA_ENCODING,
    SEQUENCES,
    SUPERVISOR,
    TICK,
    TIME,
    Recorded,
    encode_condition,
    encode_figures,
    media_type,
)
from manyhands.nodes.recorder.mcap import Tape
from manyhands.nodes.rows.own_ticks import session_tick
from manyhands.nodes.rows.tick_events import Kind
from manyhands.protocol.channels import CONDITION, TELEMETRY, Columns, Topic
from manyhands.protocol.codec import decode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import Condition, Observation, Role, Stop, Values

_BLOCK: Final = 128  # ticks


@dataclass(frozen=True, eq=False)
class Ticks:
    """Consecutive ticks of a session: the parts that their messages have in common.

    Attributes:
        times: time of each tick, ns since 1970, uint64.
        sequences: their sequence numbers, uint32.
        beginnings: the text of each tick's messages before the key of the topic's value.
        lengths: of the beginnings, bytes.
    """

    times: NDArray[np.uint64]
    sequences: NDArray[np.uint32]
    beginnings: tuple[bytes, ...]
    lengths: NDArray[np.uint64]

    @classmethod
    def of(cls, first: int, count: int, start: int, tick_ns: float) -> Ticks:
        """The ticks ``first`` to ``first + count - 1`` of a node whose tick 0 was at ``start``, ns since 1970."""
        numbers = np.arange(first, first + count, dtype=np.uint64)
        beginnings = _beginnings(first, count, tick_ns)
        return cls(
            np.uint64(start) + _since_start(first, count, tick_ns).astype(np.uint64),
            (numbers % np.uint64(SEQUENCES)).astype(np.uint32),
            beginnings,
            lengths_of(beginnings),
        )


def _since_start(first: int, count: int, tick_ns: float) -> NDArray[np.float64]:
    """Time from tick 0 to each of the ticks, ns: whole numbers."""
    return np.rint(np.arange(first, first + count, dtype=np.uint64).astype(np.float64) * tick_ns)


def _beginnings(first: int, count: int, tick_ns: float) -> tuple[bytes, ...]:
    """The beginnings of these ticks' messages, from cached blocks: the nodes of one period report the same ticks, one
    after the other.
    """
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
    """Each row as JSON without its brackets: its numbers, or, with ``one`` column, its number.

    Args:
        values: ticks x columns; at least one of each.
        one: whether the rows are plain numbers instead of arrays.
    """
    plain = values[:, 0].tolist() if one else values.tolist()
    text = repr(plain).encode()
    if not np.isfinite(values).all():
        for word in (b"nan", b"-inf", b"inf"):
            text = text.replace(word, b"null")
    return text[1:-1].split(b", ") if one else text[2:-2].split(b"], [")


def trace_messages(
    topic: Topic, ticks: Ticks, values: Values
) -> tuple[NDArray[np.uint64], tuple[Sequence[bytes], ...]]:
    """The messages of one trace: the length of each, bytes, and their pieces, which are to be joined in their order.

    Args:
        topic: of the trace.
        ticks: those of its rows, at least one.
        values: ticks x columns.
    """
    one = topic.columns is Columns.ONE
    rows, count = row_texts(values, one), len(values)
    key, end = f'"{topic.trace}": {"" if one else "["}'.encode(), b"}" if one else b"]}"
    lengths = ticks.lengths + lengths_of(rows) + np.uint64(len(key) + len(end))
    return lengths, (ticks.beginnings, (key,) * count, rows, (end,) * count)


CHUNK_BYTES: Final = 1024 * 1024
"""A chunk of this size is closed, however young it is."""


class RecorderCore:
    """Turns observations into a file.

    Times in the file follow the session's own clock: tick k was at the start plus kT, with the node's T. The start is
    computed back from the arrival of the first observation. So it is the time of day as well, as long as ticks keep
    pace with the wall clock.

    Attributes:
        over: becomes true when the session has reported that nothing more will come.
        tick: the session's tick after the latest of any device that was taken.
        refused: number of frames that were no observation, named no node, or did not fit their node's columns and
            ticks.
    """

    def __init__(self, recorded: Recorded, attachments: Mapping[str, bytes] | None = None, started: int = 0) -> None:
        """Begin the file of the session ``recorded``.

        Args:
            recorded: the session.
            attachments: contents by name, with names of :data:`~manyhands.nodes.recorder.format.MEDIA_TYPES`.
            started: start of the recording, ns since 1970.
        """
        self._recorded = recorded
        self._tape = Tape(f"manyhands {recorded.version}")
        self._tape.metadata(METADATA, recorded.as_metadata())
        for name, data in (attachments or {}).items():
            self._tape.attach(name, media_type(name) or "application/octet-stream", data, started)
        self._shown = recorded.space_messages()
        self._topics = {node: {topic.trace: topic for topic in recorded.topics(node)} for node in recorded.roles}
        self._schemas: dict[str, int] = {}
        self._channels: dict[tuple[str, str], int] = {}
        self._coverage = {node: Coverage() for node in recorded.roles}
        self._away = Away(recorded)
        self._start: int | None = None
        self._condition: Condition | None = None
        self._latest = 0  # the session's tick after the latest of any node
        self.over = False
        self.tick = 0
        self.refused = 0

    def take(self, frame: bytes, time: int) -> None:
        """Take in a frame that arrived at ``time``, ns since 1970. A frame that makes no sense is counted."""
        message = decode(frame, MAX_CONTROL_BYTES)
        if isinstance(message, Stop):
            self.over = True
        elif isinstance(message, Condition):
            self._note(message, time)
        elif isinstance(message, Observation) and self._fits(message):
            if self._start is None:
                self._start = max(0, time - self._since_start(message.node, message.tick))
            self._write(message)
        else:
            self.refused += 1

    def _since_start(self, node: str, tick: int) -> int:
        """Time from tick 0 to a node's ``tick``, ns."""
        return round(tick * self._recorded.tick_ns(node))

    def _fits(self, observation: Observation) -> bool:
        topics, rows = self._topics.get(observation.node), {trace.shape[0] for trace in observation.traces.values()}
        if topics is None or not observation.traces.keys() <= topics.keys():
            return False
        first = observation.tick - max(rows, default=0)
        return (
            len(rows) <= 1
            and first >= (self._earliest(observation, first) if rows else 0)
            and (self._start or 0) + self._since_start(observation.node, observation.tick) <= MAX_TIME_NS
            and all(
                self._width(observation.node, topics[name]) == trace.shape[1]
                for name, trace in observation.traces.items()
            )
        )

    def _earliest(self, observation: Observation, first: int) -> int:
        """The earliest tick of which an observation may have a row.

        A process that takes the place of one may do its last tick again, whose signal was not sent on. Its row is the
        later one in the file, which readers take.
        """
        after = self._coverage[observation.node].next
        began = f"{Kind.BEGAN}@{first}" in observation.figures
        return after - 1 if began and after else after

    def _width(self, node: str, topic: Topic) -> int:
        return len(self._recorded.columns(node, topic))

    def _write(self, observation: Observation) -> None:
        start, rows = self._start or 0, max((trace.shape[0] for trace in observation.traces.values()), default=0)
        node, tick = observation.node, observation.tick
        if rows:
            ticks = Ticks.of(tick - rows, rows, start, self._recorded.tick_ns(node))
            for topic in self._topics[node].values():
                if topic.trace in observation.traces:
                    self._write_trace(node, topic, ticks, observation.traces[topic.trace])
            if node in self._shown:
                for made in self._shown[node].of(tick, observation.traces, start):
                    channel = self._channel(node, made.topic)
                    self._tape.message(channel, made.time, made.tick % SEQUENCES, made.data)
            self._coverage[node].take(tick - rows, tick)
            reached = session_tick(tick - 1, self._recorded.rate_of(node)) + 1
            self._latest = max(self._latest, reached)
            if node in self._recorded.devices:
                self.tick = max(self.tick, reached)
        if observation.figures:
            if self._recorded.roles[node] is Role.ENVIRONMENT:
                self._away.take(observation.figures)
            channel = self._channel(node, TELEMETRY)
            time = start + self._since_start(node, tick)
            self._tape.message(channel, time, tick % SEQUENCES, encode_figures(tick, observation.figures))

    def _write_trace(self, node: str, topic: Topic, ticks: Ticks, values: Values) -> None:
        lengths, columns = trace_messages(topic, ticks, values)
        self._tape.messages(self._channel(node, topic), ticks.times, ticks.sequences, lengths, columns)

    def _channel(self, node: str, topic: Topic | str) -> int:
        """The channel of a node's topic; its record is written before its first message."""
        name = topic if isinstance(topic, str) else topic.name
        number = self._channels.get((node, name))
        if number is None:
            about = self._recorded.channel(node, topic)
            if about.schema not in self._schemas:
                self._schemas[about.schema] = self._tape.schema(about.schema, SCHEMA_ENCODING, about.schema_text)
            number = self._tape.channel(
                about.topic, MESSAGE_ENCODING, self._schemas[about.schema], dict(about.metadata)
            )
            self._channels[node, name] = number
        return number

    def _note(self, condition: Condition, time: int) -> None:
        """Write the session's condition, unless nothing but the time and the costs has changed."""
        before, self._condition = self._condition, condition
        if before is not None and _without_figures(condition) == _without_figures(before):
            return
        channel = self._channel(SUPERVISOR, CONDITION)
        tick = self._latest  # of any node: a session may go on without a device
        data = encode_condition(tick, condition)
        if self._start is not None:  # before that the time of tick 0 is not known
            time = self._start + self._since_start(SUPERVISOR, tick)
        self._tape.message(channel, time, tick % SEQUENCES, data)

    @property
    def missing_in_all(self) -> dict[str, int]:
        """Number of ticks that were never reported, up to the latest of any device, by device, for devices that miss
        some; those in which nobody was there do not count.
        """
        coverage = self.coverage
        spans = spans_by_party(coverage, self._recorded.rate_of, 0)
        return missing_by_party(coverage, spans, self._away.of(spans))

    @property
    def coverage(self) -> dict[str, Coverage]:
        """The ticks of each device that were taken; the others were lost on the way."""
        return {device: self._coverage[device] for device in self._recorded.devices}

    @property
    def full(self) -> bool:
        """Whether the chunk should be closed now, however young it is."""
        return self._tape.waiting >= CHUNK_BYTES

    def cut(self) -> bytes:
        """Close the chunk; returns the bytes that the file lacks so far, which may be none."""
        self._tape.close_chunk()
        return self._tape.take()

    def end(self) -> bytes:
        """Close the file; returns its rest, with the index that viewers look for at the end."""
        self._tape.finish()
        return self._tape.take()


def _without_figures(condition: Condition) -> Condition:
    """A condition without what grows all the time: its time, and what its promises have cost."""
    promises = (replace(status, until=None, cost={}) for status in condition.promises)
    return replace(condition, elapsed=0.0, promises=tuple(promises))
