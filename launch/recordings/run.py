"""Reads a recording as a whole: every topic of every node, tick by tick, and everything else the file holds.

A message reports one tick of one topic. A :class:`Gatherer` collects them into rows; a row is whole, or it is missing.
:class:`RecordedRun` is the result. What happened to a node between two rows is in its events
(:mod:`manyhands.launch.audit.events`). :func:`first_sign` finds the first tick at which a clutch may have moved.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain
from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from manyhands.design.models.brief import brief_names, brief_repr
from manyhands.launch.recordings.curves import backward_difference
from manyhands.launch.recordings.recording import RecordingError, data_frame, require_suffix
from manyhands.nodes.recorder.format import METADATA, SUPERVISOR, TICK, Recorded, decode_condition, decode_figures
from manyhands.nodes.rows import telemetry as names
from manyhands.nodes.rows.own_ticks import own_span, own_tick, own_ticks_before, session_tick
from manyhands.nodes.rows.tick_events import Kind, events_in
from manyhands.protocol.channels import (
    CONDITION,
    DISPLACEMENT,
    FORCE,
    INSTANTS,
    LEDGER,
    TELEMETRY,
    Columns,
    Topic,
    topic_name,
)
from manyhands.protocol.messages import Condition, Role

if TYPE_CHECKING:
    import pandas

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


@dataclass(frozen=True, eq=False)
class RecordedTrace:
    """One topic of one node.

    Attributes:
        topic: the topic.
        columns: names of its columns.
        values: ticks x columns; row k is the node's tick ``first_of(node) + k`` (see :class:`RecordedRun`); NaN where
            nothing was recorded.
    """

    topic: Topic
    columns: tuple[str, ...]
    values: Array

    __repr__ = brief_repr


@dataclass(frozen=True, eq=False)
class RecordedRun:
    """The content of a recording.

    Attributes:
        recorded: the session.
        traces: by node and topic name, in the table's order, over the same time: all of one node have the same length.
            A topic without any record is all NaN. Without any record, a ledger is absent, since not every node keeps
            one, and so is a topic that only devices in wall time have.
        figures: by node, its tick and figures of each telemetry message.
        conditions: the session's conditions, each with the latest tick at that time.
        attachments: contents by name, of the session file and the certificate.
        cut: why the file is not whole, and up to which tick it is; None for a whole file.
        first: the session's tick of the first row: 0, unless the recording begins so late that there is no room for the
            ticks before.
        started: the time of tick 0, ns since 1970; None where no file stated one.
    """

    recorded: Recorded
    traces: Mapping[tuple[str, str], RecordedTrace]
    figures: Mapping[str, Sequence[tuple[int, Mapping[str, float]]]] = field(default_factory=dict)
    conditions: Sequence[tuple[int, Condition]] = ()
    attachments: Mapping[str, bytes] = field(default_factory=dict)
    cut: str | None = None
    first: int = 0
    started: int | None = None

    @property
    def session(self) -> str:
        """The session's name."""
        return self.recorded.session

    @property
    def certificate(self) -> str:
        """Id of the certificate that it ran under, or of the uncertified session."""
        return self.recorded.certificate

    @property
    def period(self) -> float:
        """T of the session, s."""
        return self.recorded.period

    @property
    def ports(self) -> tuple[str, ...]:
        """Names of the m ports."""
        return tuple(port for ports in self.recorded.devices.values() for port in ports)

    @property
    def x(self) -> Array:
        """The displacements that the devices sent, ticks x m, m; NaN where nothing was recorded."""
        return self._of_devices(DISPLACEMENT)

    @property
    def f_v(self) -> Array:
        """The forces that the devices exerted on the hands, ticks x m, N; NaN where nothing was recorded."""
        return self._of_devices(FORCE)

    @property
    def velocity(self) -> Array:
        """The backward difference of x over time, ticks x m, m/s; of a device in wall time over its own instants."""
        return np.hstack([self._newest(device, self.velocity_of(device)) for device in self.recorded.devices])

    def velocity_of(self, device: str) -> Array:
        """(x(k) - x(k-1))/T at each of a device's ticks, its ticks x m_i, m/s; NaN where one of the two is missing.

        A device in wall time has the instants of its samples recorded, and their differences stand in place of T.
        Before tick 0 x is zero.
        """
        instants = next(
            (kept for (of, _), kept in self.traces.items() if (of, kept.topic.trace) == (device, INSTANTS)), None
        )
        sampled = None if instants is None else rows_of(self, device, INSTANTS)[:, :1]
        found = backward_difference(rows_of(self, device, DISPLACEMENT), self.recorded.period_of(device), sampled)
        if self.first_of(device) > 0:
            found[:1] = np.nan  # the sample before the recording's first is not in it
        return found

    def _of_devices(self, trace: str) -> Array:
        return np.hstack([self._newest(device, rows_of(self, device, trace)) for device in self.recorded.devices])

    def _newest(self, node: str, rows: Array) -> Array:
        """A node's rows at the session's ticks, each the newest one."""
        return rows if node not in self.recorded.periods else rows[self.at_session_ticks(node)]

    @property
    def topics(self) -> list[tuple[str, str]]:
        """The topics with a row, by node and name."""
        return [key for key, trace in self.traces.items() if np.isfinite(trace.values).any()]

    def columns(self, *topics: str) -> dict[str, NDArray[Any]]:
        """The recording as a table at the session's ticks, by name, such as ``dx.sample[dx]_m``.

        Args:
            topics: with ``*`` and ``?``, each a node, a topic, or ``NODE/TOPIC``; without any, all.

        Raises:
            RecordingError: a pattern names no topic.

        Example:
            >>> import manyhands as mh
            >>> run = mh.simulate(mh.load("example1"), 0.1)
            >>> list(run.columns("dx/*"))
            ['tick', 'time_s', 'dx.sample[dx]_m', 'dx.force[dx]_N', 'dx.ledger[E]_J']
        """
        from manyhands.launch.recordings.tables import chosen, table_columns  # it reads what is defined here

        return table_columns(self, chosen(self, topics))

    def to_pandas(self, *topics: str) -> pandas.DataFrame:
        """The table of :meth:`columns` as a data frame, with the time in s as its index.

        Raises:
            RecordingError: a pattern names no topic, or pandas is not installed.
        """
        return data_frame(self.columns(*topics), "time_s")

    def save(self, path: Path | str, *topics: str) -> None:
        """Write the table of :meth:`columns` whole or not at all, as ``.csv``, ``.npz`` or ``.parquet``.

        Raises:
            RecordingError: the suffix is another, a pattern names no topic, or the file cannot be written.
        """
        from manyhands.launch.recordings.tables import FORMATS, export

        path = Path(path)
        require_suffix(path, tuple(f".{name}" for name in FORMATS))
        export(self, path, path.suffix.removeprefix("."), topics)

    def __repr__(self) -> str:
        cut = ", cut" if self.cut else ""
        return (
            f"RecordedRun({self.session}, {self.recorded.clock} clock: {self.ticks} ticks of {self.period:g} s, "
            f"ports {brief_names(self.ports)}{cut})"
        )

    @cached_property
    def ticks(self) -> int:
        """Number of the session's ticks, up to the end of the longest trace."""
        ends = [(len(trace.values), node) for (node, _), trace in self.traces.items()]
        last = [session_tick(self.first_of(node) + rows - 1, self.recorded.rate_of(node)) for rows, node in ends]
        return max(last, default=self.first - 1) + 1 - self.first

    def first_of(self, node: str) -> int:
        """A node's tick of the first row."""
        return own_tick(self.first, self.recorded.rate_of(node))

    def ticks_of(self, node: str) -> int:
        """Number of a node's rows."""
        return own_tick(self.first + self.ticks, self.recorded.rate_of(node)) - self.first_of(node)

    @property
    def time(self) -> Array:
        """The instants kT of the session's ticks, s."""
        return np.arange(self.first, self.first + self.ticks, dtype=np.float64) * self.recorded.period

    def at_session_ticks(self, node: str) -> NDArray[np.intp]:
        """For each of the session's ticks, the row of the node's newest tick."""
        own = own_ticks_before(np.arange(self.first, self.first + self.ticks), self.recorded.rate_of(node))
        return np.maximum(own - self.first_of(node), 0)

    def require_beginning(self, path: Path) -> RecordedRun:
        """This run, checked to begin at tick 0, so that row k is tick k.

        Raises:
            RecordingError: it begins too late for that.
        """
        require_beginning(path, self.first)
        return self


def read_run(path: Path, progress: Callable[[float], None] | None = None) -> RecordedRun:
    """Read an ``.mcap`` recording of this program, whole or cut anywhere after its metadata.

    Args:
        path: the recording.
        progress: called with the part of the file that was read, 0 to 1.

    Raises:
        RecordingError: the file cannot be read, is no recording, is too large, or is cut before its metadata.
    """
    reading = read_topics(path, lambda node, topic: True, progress)
    recorded = reading.recorded
    span = span_of(reading.gatherers, recorded, MOST_MISSING)
    spans = {node: own_span(span, recorded.rate_of(node)) for node in recorded.roles}
    traces = {
        key: RecordedTrace(gatherer.topic, gatherer.columns, gatherer.rows(spans[key[0]])[0])
        for key, gatherer in reading.gatherers.items()
        if gatherer.count or not (gatherer.topic.trace == LEDGER or gatherer.topic.wall)
    }
    cut = None if reading.why is None else cut_at(reading.why, span.stop)
    return RecordedRun(
        recorded, traces, reading.figures, reading.conditions, reading.attachments, cut, span.start, reading.started
    )


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
        self.figures: dict[str, list[tuple[int, Mapping[str, float]]]] = {node: [] for node in recorded.roles}
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


Figures = Sequence[tuple[int, Mapping[str, float]]]


def rows_of(run: RecordedRun, node: str, trace: str) -> Array:
    """The rows of one trace of a node, its ticks x columns; NaN in ticks without a row.

    Args:
        run: the recording.
        node: its name.
        trace: its name in telemetry, such as ``x``.
    """
    ticks = run.ticks_of(node)
    for (of, _), kept in run.traces.items():
        if of == node and kept.topic.trace == trace:
            values = kept.values
            if len(values) == ticks:
                return values
            missing = np.full((ticks - len(values), values.shape[1]), np.nan)
            return np.vstack([values, missing])
    topic = next(topic for topic in run.recorded.topics(node) if topic.trace == trace)
    return np.full((ticks, len(run.recorded.columns(node, topic))), np.nan)


def there(rows: Array) -> NDArray[np.bool_]:
    """The ticks whose row is whole."""
    return np.asarray(np.isfinite(rows).all(axis=1), dtype=np.bool_)


def changed_after(figures: Figures, name: str, at_rest: float = 0.0) -> int | None:
    """The tick after which a figure first differed from ``at_rest``, as far as telemetry reports it; None for never."""
    begin = 0
    for tick, values in figures:
        value = values.get(name, at_rest)
        if value != at_rest and not np.isnan(value):
            return begin
        begin = tick
    return None


def at_telemetry(figures: Figures, wanted: Sequence[str], ticks: int) -> Array:
    """Figures by tick, ticks x figures: in the last tick of each telemetry message that has all of them, else NaN."""
    out = np.full((ticks, len(wanted)), np.nan)
    for tick, values in figures:
        if 0 < tick <= ticks and all(name in values for name in wanted):
            out[tick - 1] = [values[name] for name in wanted]
    return out


def grown_in(figures: Figures, name: str, ticks: int) -> NDArray[np.bool_]:
    """By tick, whether a count has grown between the telemetry messages around it; a new process counts from 0."""
    out, begin, before = np.zeros(ticks, dtype=np.bool_), 0, 0.0
    for tick, values in figures:
        count = values.get(name, 0.0)
        out[begin:tick] = count > before
        begin, before = tick, count
    return out


def first_sign(run: RecordedRun, environment: str) -> tuple[int, str]:
    """The first tick at which a clutch may have been at work, and why; the run's end where there is no sign of one.

    A clutch moves when a coupling is frozen, comes back, changes its rung, or is held to its energy budget. It also
    moves when the devices have waited so long that they may have let go. The devices count how often they let go. The
    environment counts all the rest, and states when it took them to have let go. Behind a wave link nothing that
    happens to a user moves a clutch.
    """
    counts, signs = run.figures.get(environment, ()), [(run.ticks, "")]

    def look(figures: Figures, name: str, why: str) -> None:
        begin = changed_after(figures, name)
        if begin is not None:
            signs.append((begin, why))

    look(counts, names.FROZEN, "a coupling was frozen")
    look(counts, names.FROZEN_TICKS, "a coupling was frozen")
    look(counts, names.CHANGING, "a coupling was to change its rung")  # its clutch opens before it does
    signs += [
        (event.tick, f"{event.peer} was frozen")
        for _, values in counts
        for event in events_in(values)
        if event.kind is Kind.FROZEN and event.peer in run.recorded.linked
    ]
    signs += [
        (event.tick, "the devices had waited")
        for _, values in counts
        for event in events_in(values)
        if event.kind is Kind.RAISED
    ]
    own = there(rows_of(run, environment, names.TOOL_POSITION))
    for node in run.recorded.roles:
        figures = run.figures.get(node, ())
        if not run.recorded.behind_wave_link(node):
            look(figures, names.RELEASED, f"{node} ran free")
            look(figures, names.JUMPS, f"{node} went on at a later tick")
            look(figures, names.RUNG, f"{node} changed its rung")
        look(counts, f"{names.RUNG}_{node}", f"{node} changed its rung")
        look(counts, f"{names.SCALED}{node}", f"{node} was held to its budget")
    holes = np.flatnonzero(~own)
    signs += [(int(holes[0]), "the environment has no row there")] if len(holes) else []
    for node, role in run.recorded.roles.items():
        if role is Role.COUPLING and not run.recorded.behind_wave_link(node):
            holes = np.flatnonzero(own & ~there(rows_of(run, node, names.FREE_POSITION)))
            signs += [(int(holes[0]), f"{node} has no row there")] if len(holes) else []
    return min(signs)
