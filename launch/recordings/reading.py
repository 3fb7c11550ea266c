"""Reads the rows of a recording: every topic of every node, tick by tick, and what else the file holds.

A message reports one tick of one topic. A :class:`Gatherer` collects them into rows; a row is whole, or it is missing.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from manyhands.launch.recordings.recording import RecordingError
from manyhands.nodes.recorder.format import METADATA, SUPERVISOR, TICK, Recorded, decode_condition, decode_figures
from manyhands.nodes.rows.own_ticks import own_tick, session_tick
from manyhands.protocol.channels import CONDITION, TELEMETRY, Columns, Topic, topic_name
from manyhands.protocol.messages import Condition, Figures

if TYPE_CHECKING:
    from manyhands.launch.recordings.mcap import Message

Array = NDArray[np.float64]

MOST_TICK: Final = 2**53
"""Greater numbers are no ticks of a run."""


_ROOM_OF_A_ROW: Final = 200
_ROOM_OF_A_NUMBER: Final = 32
"""The most bytes of a message's text, in all besides the numbers and for each number; longer texts are not parsed."""


def objects(texts: Sequence[bytes]) -> list[Any]:
    """The JSON objects of those texts that hold one: parsed all at once, or one by one if that fails."""
    try:
        found: list[Any] = json.loads(b"[%b]" % b",".join(texts))
    except (ValueError, RecursionError):
        found = []
    return found if len(found) == len(texts) else list(_one_by_one(texts))


def _one_by_one(texts: Iterable[bytes]) -> Iterator[Any]:
    for text in texts:
        try:
            yield json.loads(text)
        except (ValueError, RecursionError):
            continue  # the checksum agrees, so the writer of the file meant something else


def fitting(plain: Iterable[Any], read: Callable[[Any], Any]) -> Iterator[Any]:
    """What ``read`` returns for each object; objects that it refuses by a ValueError are skipped."""
    for one in plain:
        try:
            yield read(one)
        except ValueError:
            continue


class Gatherer:
    """Collects the rows of one topic of one node.

    Attributes:
        topic: the topic.
        columns: names of its columns.
    """

    def __init__(self, topic: Topic, columns: tuple[str, ...]) -> None:
        """Begin without any row."""
        self.topic, self.columns = topic, columns
        self._pieces: list[tuple[NDArray[np.int64], Array]] = []

    @property
    def count(self) -> int:
        """Number of rows that were taken."""
        return sum(len(ticks) for ticks, _ in self._pieces)

    def take(self, texts: Sequence[bytes]) -> None:
        """Take in messages. One that does not fit the topic is skipped, and its tick is missing then."""
        most = _ROOM_OF_A_ROW + _ROOM_OF_A_NUMBER * len(self.columns)
        plain = objects([text for text in texts if len(text) <= most])
        piece = self._read(plain)
        if piece is None:
            for one in plain:
                self._keep(self._read([one]))
        else:
            self._keep(piece)

    def _keep(self, piece: tuple[NDArray[np.int64], Array] | None) -> None:
        if piece is not None and len(piece[0]):
            self._pieces.append(piece)

    def _read(self, plain: list[Any]) -> tuple[NDArray[np.int64], Array] | None:
        """Ticks and rows of parsed messages; None if any of them does not fit the topic."""
        key, one = self.topic.trace, self.topic.columns is Columns.ONE
        try:
            numbers, rows = [each[TICK] for each in plain], [each[key] for each in plain]
            kinds = {type(value) for value in (rows if one else chain.from_iterable(rows))}
            if {type(number) for number in numbers} != {int} or not kinds <= {float, int, NoneType}:
                return None
            ticks, values = np.array(numbers, dtype=np.int64), np.array(rows, dtype=np.float64)  # None becomes NaN
        except (LookupError, TypeError, ValueError, OverflowError):
            return None
        values = values[:, None] if one else values
        right = values.shape == (len(plain), len(self.columns)) and (ticks >= 0).all() and (ticks < MOST_TICK).all()
        return (ticks, values) if right else None

    @property
    def first(self) -> int | None:
        """The earliest tick with a row; None if there is none."""
        return min((int(at.min()) for at, _ in self._pieces), default=None)

    def end(self, most: int) -> int:
        """One more than the latest tick below ``most``."""
        return max((int(at[at < most].max(initial=-1)) + 1 for at, _ in self._pieces), default=0)

    def rows(self, span: range) -> tuple[Array, NDArray[np.bool_]]:
        """The rows of the node's ticks in ``span``, NaN where there are none, and which ticks have one."""
        values = np.full((len(span), len(self.columns)), np.nan)
        present = np.zeros(len(span), dtype=np.bool_)
        for at, piece in self._pieces:
            inside = (at >= span.start) & (at < span.stop)
            row = at[inside] - span.start
            values[row], present[row] = piece[inside], True
        return values, present


def span_of(gatherers: Mapping[tuple[str, str], Gatherer], recorded: Recorded, most_missing: int) -> range:
    """The session's ticks in a recording, up to the latest with a row, of which few numbers are missing.

    The span begins at tick 0. It begins at the first tick with a row if too much is missing before, in a recording of a
    session's later hours. Without the limit, a single message with an absurd tick would cost memory for all ticks
    before it.

    Args:
        gatherers: the rows, by node and topic name.
        recorded: the session.
        most_missing: the most numbers that may be missing.
    """
    by_rate = [(gatherer, recorded.rate_of(node)) for (node, _), gatherer in gatherers.items()]
    found = sum(gatherer.count * len(gatherer.columns) for gatherer, _ in by_rate)
    width = sum(len(gatherer.columns) * rate for gatherer, rate in by_rate)
    room = int((found + most_missing) // max(1.0, width))
    starts = [session_tick(gatherer.first, rate) for gatherer, rate in by_rate if gatherer.first is not None]
    earliest = min(starts, default=0)
    first = earliest if earliest >= room else 0
    ends = [(gatherer.end(own_tick(first + room, rate)), rate) for gatherer, rate in by_rate]
    return range(first, max((session_tick(end - 1, rate) + 1 for end, rate in ends), default=first))


MOST_VALUES: Final = 500_000_000
"""The most numbers that are read from one recording: 4 GB, about four hours of three users."""

MOST_MISSING: Final = 100_000_000
"""The most numbers that are filled with NaN where something is missing: 0.8 GB."""

MOST_OTHERS: Final = 10_000_000
"""The most messages with figures and conditions, both together."""

MOST_ATTACHED_BYTES: Final = 256 * 2**20
"""The most bytes of all attachments together."""


def cut_at(why: str, ticks: int) -> str:
    """Why a file is not whole, in a sentence; ``ticks`` is the tick up to which it can be read."""
    return f"{why}, without a recorder's end; what it holds goes to tick {ticks}"


def require_beginning(path: Path, first: int) -> None:
    """Refuse a recording that begins too late to be computed from tick 0 on.

    Raises:
        RecordingError: its first row is that of another tick than 0.
    """
    if first:
        raise RecordingError(
            f"{path}: found a recording that begins at tick {first}; expected one from tick 0 on, since this command "
            "computes from there; export and plot take it as it is"
        )


class Reading:
    """A recording while it is read.

    Attributes:
        recorded: the session.
        gatherers: the rows of the wanted topics, by node and topic name, in the table's order.
        figures: tick and figures of each telemetry message, by node.
        conditions: tick and condition.
        attachments: contents by name.
        why: why the file is not whole; None if it is.
        started: the time of tick 0, ns since 1970; None before any row.
    """

    def __init__(self, path: Path, recorded: Recorded, wanted: Callable[[str, Topic], bool]) -> None:
        """Begin after the metadata of a file.

        Args:
            path: the recording, for messages.
            recorded: the session.
            wanted: which topics of which nodes to read.
        """
        self._path = path
        self.recorded = recorded
        self.gatherers = {
            (node, topic.name): Gatherer(topic, recorded.columns(node, topic))
            for node in recorded.roles
            for topic in recorded.topics(node)
            if wanted(node, topic)
        }
        self.figures: dict[str, list[tuple[int, Figures]]] = {node: [] for node in recorded.roles}
        self.conditions: list[tuple[int, Condition]] = []
        self.attachments: dict[str, bytes] = {}
        self.why: str | None = None
        self.started: int | None = None
        name = recorded.session
        self._nodes = {topic_name(name, *key): key[0] for key in self.gatherers}
        self._takers: dict[str, Callable[[list[bytes]], None]] = {
            **{topic_name(name, *key): gatherer.take for key, gatherer in self.gatherers.items()},
            **{topic_name(name, node, TELEMETRY): self._figures_of(node) for node in recorded.roles},
            topic_name(name, SUPERVISOR, CONDITION): self._take_conditions,
        }
        self._channels: dict[int, Callable[[list[bytes]], None]] = {}
        self._nodes_by_channel: dict[int, str] = {}
        self._values = self._others = self._attached = 0

    def _figures_of(self, node: str) -> Callable[[list[bytes]], None]:
        def take(texts: list[bytes]) -> None:
            self._others += len(texts)
            self.figures[node] += fitting(objects(texts), decode_figures)

        return take

    def _take_conditions(self, texts: list[bytes]) -> None:
        self._others += len(texts)
        self.conditions += fitting(objects(texts), decode_condition)

    def take(self, part: object) -> None:
        """Take in a part of the file; a part that belongs to no topic is skipped.

        Raises:
            RecordingError: the file holds more than is read.
        """
        from mcap.records import Attachment, Channel  # a simulation's run is made without

        from manyhands.launch.recordings.mcap import End, Messages

        match part:
            case Channel():
                if part.topic in self._takers:
                    self._channels[part.id] = self._takers[part.topic]
                if part.topic in self._nodes:
                    self._nodes_by_channel[part.id] = self._nodes[part.topic]
            case Attachment():
                self._attached += len(part.data)
                self.attachments.setdefault(part.name, part.data)
            case Messages(found):
                texts: dict[int, list[bytes]] = {}
                self._look_for_the_start(found)
                for message in found:
                    texts.setdefault(message.channel, []).append(message.data)
                for channel, own in texts.items():
                    if channel in self._channels:
                        self._channels[channel](own)
            case End(why):
                self.why = why
        self._require_room()

    def _look_for_the_start(self, found: Sequence[Message]) -> None:
        """Take the time of tick 0 from the first row: every row is at it plus kT."""
        if self.started is not None:
            return
        for message in found:
            node = self._nodes_by_channel.get(message.channel)
            for plain in objects([message.data]) if node is not None else []:
                match plain:
                    case {"tick": int(tick)} if 0 <= tick < MOST_TICK:
                        self.started = max(0, message.log_time - round(tick * self.recorded.tick_ns(node or "")))
                        return

    def _require_room(self) -> None:
        values = sum(gatherer.count * len(gatherer.columns) for gatherer in self.gatherers.values())
        for what, found, most in (
            ("numbers", values, MOST_VALUES),
            ("figures and conditions", self._others, MOST_OTHERS),
        ):
            if found > most:
                raise RecordingError(f"{self._path}: found more than {most} {what}; expected a recording of fewer")
        require_attached(self._path, self._attached)


def require_attached(path: Path, size: int) -> None:
    """Refuse a recording whose attachments so far have ``size`` bytes, if that is too much.

    Raises:
        RecordingError: it is.
    """
    if size > MOST_ATTACHED_BYTES:
        raise RecordingError(
            f"{path}: found more than {MOST_ATTACHED_BYTES} bytes of attachments; expected a recording of fewer"
        )


def read_topics(
    path: Path, wanted: Callable[[str, Topic], bool], progress: Callable[[float], None] | None = None
) -> Reading:
    """Read the topics of a recording that are ``wanted``, by node and topic; everything else as :func:`read_run`.

    Raises:
        RecordingError: as :func:`read_run`.
    """
    from mcap.records import Attachment, Metadata

    from manyhands.launch.recordings.mcap import End, parts

    reading: Reading | None = None
    attached: list[Attachment] = []  # before the metadata, where another program may have put them
    for part in parts(path, progress):
        match part:
            case Attachment() if reading is None:
                attached.append(part)
                require_attached(path, sum(len(one.data) for one in attached))
            case Metadata(name, texts) if name == METADATA and reading is None:
                try:
                    reading = Reading(path, Recorded.from_metadata(texts), wanted)
                except ValueError as error:
                    raise RecordingError(f"{path}: {error}") from error
                for one in attached:
                    reading.take(one)
            case End(why) if reading is None:
                raise RecordingError(
                    f"{path}: found no metadata of a session ({why or 'another file'}); expected a recording"
                )
            case _ if reading is not None:
                reading.take(part)
    if reading is None:
        raise RecordingError(f"{path}: found no metadata of a session; expected a recording")
    return reading
