"""A recording as a whole (:class:`RecordedRun`), and how it is written as a table.

What happened to a node between two rows is in its events (:mod:`manyhands.launch.audit.events`). :func:`first_sign`
finds the first tick at which a clutch may have moved.

:func:`export` writes one row a tick and one column for each of a topic's columns, for a spreadsheet, numpy or a data
frame. A column is named ``NODE.TOPIC[COLUMN]_UNIT``, such as ``dx.sample[x]_m``. Every number is exact, and NaN where
the recording has none. The rows are at the session's ticks: where a node has a period of its own, each has the newest
of that node's rows.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from manyhands.design.files import replacing
from manyhands.design.models.brief import brief_names, brief_repr
from manyhands.launch.recordings.curves import angular_velocity, backward_difference
from manyhands.launch.recordings.formats import TABLES, TICK, TIME, Progress, TableOfRun
from manyhands.launch.recordings.reading import MOST_MISSING, cut_at, read_topics, require_beginning, span_of
from manyhands.launch.recordings.recording import Array, RecordingError, data_frame, require_suffix
from manyhands.nodes.kernel.bundle import REALTIME
from manyhands.nodes.recorder.format import Recorded
from manyhands.nodes.rows import figures as names
from manyhands.nodes.rows.own_ticks import own_span, own_tick, own_ticks_before, session_tick
from manyhands.nodes.rows.tick_events import Kind, events_in
from manyhands.nodes.rows.units import units_of_columns
from manyhands.protocol.channels import DISPLACEMENT, FORCE, INSTANTS, ORIENTATION, Topic, topic_name
from manyhands.protocol.messages import Condition, Figures, Role

if TYPE_CHECKING:
    import pandas


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
    figures: Mapping[str, Sequence[tuple[int, Figures]]] = field(default_factory=dict)
    conditions: Sequence[tuple[int, Condition]] = ()
    attachments: Mapping[str, bytes] = field(default_factory=dict)
    cut: str | None = None
    first: int = 0
    started: int | None = None

    @property
    def by_itself(self) -> dict[str, tuple[str, ...]]:
        """By device, what it does by itself, which no certificate covers; of each the latest that was recorded."""
        return {device: own for _, condition in self.conditions for device, own in condition.by_itself.items()}

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
        x = rows_of(self, device, DISPLACEMENT)
        found = backward_difference(x, self.recorded.period_of(device), self._sampled(device))
        if self.first_of(device) > 0:
            found[:1] = np.nan  # the sample before the recording's first is not in it
        return found

    def angular_velocity_of(self, device: str) -> Array:
        """The turn from tick to tick over the time between, of a device whose orientation is a port, its ticks x 3.

        In the world's axes, rad/s; see :meth:`velocity_of`.
        """
        found = angular_velocity(
            rows_of(self, device, ORIENTATION), self.recorded.period_of(device), self._sampled(device)
        )
        if self.first_of(device) > 0:
            found[:1] = np.nan
        return found

    def _sampled(self, device: str) -> Array | None:
        """The instants of a device's samples, its ticks x 1, ns; None of one that has a sample every T."""
        own = (kept for (of, _), kept in self.traces.items() if (of, kept.topic.trace) == (device, INSTANTS))
        return None if next(own, None) is None else rows_of(self, device, INSTANTS)[:, :1]

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
        return table_columns(self, chosen(self, topics))

    def to_pandas(self, *topics: str) -> pandas.DataFrame:
        """The table of :meth:`columns` as a data frame, with the time in s as its index.

        Raises:
            RecordingError: a pattern names no topic, or pandas is not installed.
        """
        return data_frame(self.columns(*topics), "time_s")

    def save(self, path: Path | str, *topics: str) -> None:
        """Write the table of :meth:`columns` whole or not at all, in the format of its suffix (:data:`.SUFFIXES`).

        Raises:
            RecordingError: the suffix is another, a pattern names no topic, or the file cannot be written.
        """
        path = Path(path)
        require_suffix(path)
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
        if gatherer.count or not (gatherer.topic.certified or gatherer.topic.wall)
    }
    cut = None if reading.why is None else cut_at(reading.why, span.stop)
    return RecordedRun(
        recorded, traces, reading.figures, reading.conditions, reading.attachments, cut, span.start, reading.started
    )


FiguresByTick: TypeAlias = Sequence[tuple[int, Figures]]


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


def changed_after(figures: FiguresByTick, name: str, at_rest: float = 0.0, key: str = "") -> int | None:
    """The tick after which a figure first differed from ``at_rest``, as far as telemetry reports it; None for never."""
    begin = 0
    for tick, values in figures:
        value = (values.table(name) if key else values).get(key or name, at_rest)
        if value != at_rest and not np.isnan(value):
            return begin
        begin = tick
    return None


def at_telemetry(figures: FiguresByTick, wanted: Sequence[str], ticks: int) -> Array:
    """Figures by tick, ticks x figures: in the last tick of each telemetry message that has all of them, else NaN."""
    out = np.full((ticks, len(wanted)), np.nan)
    for tick, values in figures:
        if 0 < tick <= ticks and all(name in values for name in wanted):
            out[tick - 1] = [values[name] for name in wanted]
    return out


def grown_in(figures: FiguresByTick, name: str, ticks: int) -> NDArray[np.bool_]:
    """By tick, whether a count has grown between the telemetry messages around it; a new process counts from 0."""
    out, begin, before = np.zeros(ticks, dtype=np.bool_), 0, 0.0
    for tick, values in figures:
        count = values.get(name, 0.0)
        out[begin:tick] = count > before
        begin, before = tick, count
    return out


def pressed_in(figures: FiguresByTick, buttons: Sequence[str]) -> dict[int, int]:
    """By tick, the buttons that are held down from then on, by the events of a node; a new process begins with none.

    Args:
        figures: of the node.
        buttons: their names, in the order of their bits; others, as in a recording that was altered, are left out.
    """
    bits = {button: 1 << i for i, button in enumerate(buttons)}
    events = [event for _, values in figures for event in events_in(values)]
    found, state = dict[int, int](), 0
    for event in sorted(events, key=lambda event: (event.tick, event.kind is not Kind.BEGAN)):
        if event.kind is Kind.BEGAN:
            found[event.tick] = state = 0
        elif event.kind is Kind.PRESSED:
            bit = bits.get(event.peer, 0)
            found[event.tick] = state = state | bit if event.value else state & ~bit
    return found


def first_sign(run: RecordedRun, environment: str) -> tuple[int, str]:
    """The first tick at which a clutch may have been at work, and why; the run's end where there is no sign of one.

    A clutch moves when a coupling is frozen, comes back, changes its rung, or is held to its energy budget. It also
    moves when the devices have waited so long that they may have let go. The devices count how often they let go. The
    environment counts all the rest, and states when it took them to have let go. Behind a wave link nothing that
    happens to a user moves a clutch, but in real time all join by one.
    """
    counts, signs = run.figures.get(environment, ()), [(run.ticks, "")]
    if run.recorded.linked and run.recorded.clock == REALTIME:
        signs.append((0, f"{run.recorded.linked[0]} joins by the ramp"))

    def look(figures: FiguresByTick, name: str, why: str, key: str = "") -> None:
        begin = changed_after(figures, name, key=key)
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
        look(counts, names.of(names.RUNG), f"{node} changed its rung", node)
        look(counts, names.SCALED, f"{node} was held to its budget", node)
    holes = np.flatnonzero(~own)
    signs += [(int(holes[0]), "the environment has no row there")] if len(holes) else []
    for node, role in run.recorded.roles.items():
        if role is Role.COUPLING and not run.recorded.behind_wave_link(node):
            holes = np.flatnonzero(own & ~there(rows_of(run, node, names.FREE_POSITION)))
            signs += [(int(holes[0]), f"{node} has no row there")] if len(holes) else []
    return min(signs)


Traces = Mapping[tuple[str, str], RecordedTrace]


def chosen(run: RecordedRun, patterns: Sequence[str]) -> dict[tuple[str, str], RecordedTrace]:
    """The traces that the patterns name; all without patterns.

    Args:
        run: the recording.
        patterns: with ``*`` and ``?``, each for a full name ``/SESSION/NODE/TOPIC``, ``NODE/TOPIC``, a node or a topic.

    Raises:
        RecordingError: a pattern names no trace.
    """
    names = {
        key: (topic_name(run.recorded.session, *key), "/".join(key), *key)  # a pattern may match any of these
        for key in run.traces
    }
    meant = set()
    for pattern in patterns:
        fitting = {key for key, texts in names.items() if any(fnmatchcase(text, pattern) for text in texts)}
        if not fitting:
            there = ", ".join("/".join(key) for key in names)
            raise RecordingError(f"--topics: found {pattern!r}, which matches no topic here; expected one of {there}")
        meant |= fitting
    return {key: trace for key, trace in run.traces.items() if not patterns or key in meant}


def missing_sentence(run: RecordedRun, traces: Traces) -> str | None:
    """Which ticks of each node have no row in these traces: how many, and where first; None where none is missing.

    A node's ticks are its own, and the recording's go to the latest tick of any node.
    """
    parts = []
    for node in dict.fromkeys(node for node, _ in traces):
        rows = [trace.values for (of, _), trace in traces.items() if of == node]
        holes = np.flatnonzero(~np.any([np.isfinite(values).any(axis=1) for values in rows], axis=0))
        if len(holes):
            first = run.first_of(node) + int(holes[0])
            at = first * run.recorded.period_of(node)
            parts.append(f"{len(holes)} of {len(rows[0])} of {node}, the first at tick {first} ({at:.4g} s)")
    return f"ticks are missing in the recording: {'; '.join(parts)}" if parts else None


def column_names(node: str, trace: RecordedTrace, turning: Collection[str] = ()) -> list[str]:
    """The names of a trace's columns in a table; ``turning`` are the session's ports and masses that turn."""
    units = units_of_columns(trace.topic, trace.columns, turning)
    return [f"{node}.{trace.topic.name}[{column}]_{unit}" for column, unit in zip(trace.columns, units, strict=True)]


def about(recorded: Recorded) -> dict[str, str]:
    """The session's properties that a table states besides its numbers, as texts."""
    return {
        "session": recorded.session,
        "certificate": recorded.certificate,
        "period": repr(recorded.period),
        "clock": recorded.clock,
        "version": recorded.version,
    }


def export(
    run: RecordedRun, path: Path, to: str, patterns: Sequence[str] = (), progress: Progress | None = None
) -> None:
    """Write a recording as a table, whole or not at all.

    Args:
        run: the recording.
        path: the table's file.
        to: the format, one of :data:`.TABLES`.
        patterns: the topics to write; see :func:`chosen`.
        progress: called with the part that is done, 0 to 1.

    Raises:
        RecordingError: a pattern names no topic, the format cannot be written here, or the file cannot be written.
    """
    table = _table(run, chosen(run, patterns))
    try:
        with replacing(path) as file:
            TABLES[to](file, table, progress or (lambda _part: None))
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written: {error.strerror}") from error


def table_columns(run: RecordedRun, traces: Traces) -> dict[str, NDArray[Any]]:
    """The columns of a table of these traces by name: the session's ticks, their time in s, and every column."""
    out: dict[str, NDArray[Any]] = {TICK: np.arange(run.first, run.first + run.ticks, dtype=np.int64), TIME: run.time}
    for key, trace in traces.items():
        out |= dict(
            zip(column_names(key[0], trace, run.recorded.turning), _at_session_ticks(run, key[0], trace).T, strict=True)
        )
    return out


def _at_session_ticks(run: RecordedRun, node: str, trace: RecordedTrace) -> Array:
    """The rows of a trace at the session's ticks, each the node's newest one."""
    return trace.values if node not in run.recorded.periods else trace.values[run.at_session_ticks(node)]


def _table(run: RecordedRun, traces: Traces) -> TableOfRun:
    recorded, columns = run.recorded, table_columns(run, traces)
    ports = [port for own in recorded.devices.values() for port in own]
    arrays: dict[str, Any] = {**about(recorded), "period": recorded.period, "ports": np.array(ports)}
    if turning := [port for port in ports if port in recorded.turning]:
        arrays["turning"] = np.array(turning)
    for name in (DISPLACEMENT, FORCE):  # under the names of a simulation's file, so that one reader suits both
        every = [
            _at_session_ticks(run, node, trace)
            for (node, _), trace in traces.items()
            if node in recorded.devices and trace.topic.trace == name
        ]
        if len(every) == len(recorded.devices):
            arrays[name] = np.hstack(every)
    return TableOfRun(columns, arrays | columns, about(recorded))
