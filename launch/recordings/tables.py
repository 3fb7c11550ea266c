"""Recordings as tables: reads x and f_v from files of any format, and writes any topic as a table.

:func:`read_saved` reads what :meth:`manyhands.launch.recordings.recording.Recording.save` wrote, ``.npz`` and ``.csv``.
:func:`read_recording` reads an ``.mcap`` file, whole or as far as it goes. The files may come from anywhere: nothing in
them is executed (no pickles), and their size is checked before they are read.

:func:`export` writes one row a tick and one column for each of a topic's columns, for a spreadsheet, numpy or a data
frame. A column is named ``NODE.TOPIC[COLUMN]_UNIT``, such as ``dx.sample[x]_m``. Every number is exact, and NaN where
the recording has none. The rows are at the session's ticks: where a node has a period of its own, each has the newest
of that node's rows.
"""

from __future__ import annotations

import csv
import math
import os
import re
from array import array
from collections.abc import Callable, Mapping, Sequence
from fnmatch import fnmatchcase
from io import TextIOWrapper
from pathlib import Path
from typing import Any, BinaryIO, Final, TextIO

import numpy as np
from numpy.typing import NDArray

from manyhands.design.files import open_regular, replacing
from manyhands.extras import require
from manyhands.launch.recordings.arrays import read_arrays
from manyhands.launch.recordings.recording import Array, Recording, RecordingError, one_period, require_format
from manyhands.launch.recordings.run import (
    MOST_MISSING,
    Gatherer,
    RecordedRun,
    RecordedTrace,
    cut_at,
    read_topics,
    require_beginning,
    span_of,
)
from manyhands.nodes.recorder.coverage import Coverage, missing_by_party
from manyhands.nodes.recorder.format import Recorded
from manyhands.nodes.rows.own_ticks import own_span
from manyhands.protocol.channels import DISPLACEMENT, FORCE, topic_name, topics_of
from manyhands.protocol.messages import Role

MOST_BYTES: Final = 4 * 2**30
"""The longest file that is read; of ``.npz``, the most unpacked bytes."""

_ARRAYS: Final = ("x", "f_v", "ports", "period", "session", "certificate")
_COLUMN = re.compile(r"(x|f_v)\[(.+)\]_(m|N)")
_LINES_TOLD = 10_000  # lines between two reports of progress


def read_saved(path: Path, progress: Callable[[float], None] | None = None) -> Recording:
    """Read a ``.npz`` or ``.csv`` recording; for ``.csv`` the file's name is the session's, and the certificate empty.

    Args:
        path: the file.
        progress: called with the part that is done, 0 to 1.

    Raises:
        RecordingError: the suffix is another, or the file cannot be read or is no recording.
    """
    require_format(path, (".npz", ".csv"))
    try:
        recording = _npz(path) if path.suffix == ".npz" else _csv(path, progress or (lambda _part: None))
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror or error}") from error
    except MemoryError as error:
        raise RecordingError(f"{path}: found more than this machine has memory for; expected a smaller file") from error
    except (ValueError, TypeError) as error:
        raise RecordingError(f"{path}: found no recording: {error}; expected what simulate --record writes") from error
    if len(recording.x) < 1 or not recording.ports:
        raise RecordingError(f"{path}: found no ticks; expected at least one")
    return recording


def _npz(path: Path) -> Recording:
    data = read_arrays(path, (_ARRAYS,), MOST_BYTES)
    x, f_v = (np.asarray(data[name], dtype=np.float64) for name in ("x", "f_v"))
    ports = tuple(str(port) for port in data["ports"])
    period = float(data["period"])
    session, certificate = str(data["session"]), str(data["certificate"])
    if x.ndim != 2 or x.shape != f_v.shape or x.shape[1] != len(ports):
        raise ValueError(f"x of shape {x.shape} and f_v of {f_v.shape} for {len(ports)} ports")
    if not 0.0 < period < math.inf:
        raise ValueError(f"the period {period:g} s")
    return Recording(session, certificate, period, ports, x, f_v)


def _csv(path: Path, progress: Callable[[float], None]) -> Recording:
    with TextIOWrapper(open_regular(path, MOST_BYTES), newline="", encoding="utf-8") as file:
        size = os.fstat(file.fileno()).st_size
        ports, values = _rows(file, lambda: progress(os.lseek(file.fileno(), 0, os.SEEK_CUR) / max(size, 1)))
    m = len(ports)
    table: Array = np.frombuffer(values, dtype=np.float64).reshape(-1, 2 + 2 * m)
    ticks, time = table[:, 0], table[:, 1]
    if len(table) < 2:
        raise ValueError(f"{len(table)} lines of ticks, which show no period")
    period = float(time[-1] / (len(time) - 1))
    if not np.array_equal(ticks, np.arange(len(table))) or not 0.0 < period < math.inf:
        raise ValueError("ticks that do not count up from 0, or no times beside them")
    return Recording(path.stem, "", period, ports, table[:, 2 : 2 + m], table[:, 2 + m :])


def _rows(file: TextIO, progress: Callable[[], None]) -> tuple[tuple[str, ...], array[float]]:
    """The ports of the heading, and every number below it."""
    reader = csv.reader(file, strict=True)
    try:
        head = next(reader, [])
        found = [_COLUMN.fullmatch(name) for name in head[2:]]
        names = [(match[1], match[2]) for match in found if match]
        ports = tuple(port for kind, port in names if kind == "x")
        if head[:2] != ["tick", "time_s"] or names != [(kind, port) for kind in ("x", "f_v") for port in ports]:
            raise ValueError(f"the heading {','.join(head)[:80]!r}")
        values: array[float] = array("d")
        for row in reader:
            if len(row) != len(head):
                raise ValueError(f"line {reader.line_num}: {len(row)} columns beside {len(head)} of the heading")
            values.extend(map(float, row))
            if reader.line_num % _LINES_TOLD == 0:
                progress()
    except csv.Error as error:
        raise ValueError(f"line {reader.line_num}: {error}") from error
    return ports, values


_SIGNALS = (DISPLACEMENT, FORCE)


def read_recording(path: Path) -> Recording:
    """Read x and f_v of an ``.mcap`` recording of this program, whole or cut anywhere after its metadata.

    The rows end with the last tick that any device recorded. Ticks that a device did not record are NaN and counted in
    ``missing``, and so are ticks that are lost with the end of a cut file. A tick is recorded where both its x and its
    f_v are.

    Raises:
        RecordingError: the file cannot be read, is no recording, is too large, or is cut before its metadata; or its
            devices have different periods.
    """
    sample, force = (next(t.name for t in topics_of(Role.DEVICE) if t.trace == signal) for signal in _SIGNALS)
    reading = read_topics(path, lambda node, topic: topic.name in (sample, force))
    recorded, gatherers = reading.recorded, reading.gatherers
    session = span_of(gatherers, recorded, MOST_MISSING)
    require_beginning(path, session.start)
    period = one_period({device: recorded.period_of(device) for device in recorded.devices}, path)
    span = own_span(session, recorded.period / period)
    columns = [
        _signal_columns(gatherers[device, sample], gatherers[device, force], span) for device in recorded.devices
    ]
    coverages = {device: Coverage() for device in recorded.devices}
    for coverage, (_, _, recorded_ticks) in zip(coverages.values(), columns, strict=True):
        coverage.take_each(np.flatnonzero(recorded_ticks))
    ticks = max(coverage.next for coverage in coverages.values())
    return Recording(
        recorded.session,
        recorded.certificate,
        period,
        tuple(port for ports in recorded.devices.values() for port in ports),
        np.hstack([x[:ticks] for x, _, _ in columns]),
        np.hstack([f_v[:ticks] for _, f_v, _ in columns]),
        missing_by_party(coverages, dict.fromkeys(coverages, range(ticks))),
        None if reading.why is None else cut_at(reading.why, ticks),
    )


def _signal_columns(sample: Gatherer, force: Gatherer, span: range) -> tuple[Array, Array, NDArray[np.bool_]]:
    """The x and f_v of a device, NaN in ticks that lack one of them, and which ticks have both."""
    (x, x_there), (f_v, f_there) = sample.rows(span), force.rows(span)
    both = x_there & f_there
    x[~both] = f_v[~both] = np.nan
    return x, f_v, both


Progress = Callable[[float], None]
Traces = Mapping[tuple[str, str], RecordedTrace]

TICK: Final = "tick"
TIME: Final = "time_s"
_ROWS: Final = 2048  # rows that are converted to text at a time


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


def column_names(node: str, trace: RecordedTrace) -> list[str]:
    """The names of a trace's columns in a table."""
    return [f"{node}.{trace.topic.name}[{column}]_{trace.topic.unit}" for column in trace.columns]


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
        to: the format, one of :data:`FORMATS`.
        patterns: the topics to write; see :func:`chosen`.
        progress: called with the part that is done, 0 to 1.

    Raises:
        RecordingError: a pattern names no topic, the format cannot be written here, or the file cannot be written.
    """
    traces = chosen(run, patterns)
    write = FORMATS[to]
    try:
        with replacing(path) as file:
            write(run, traces, file, progress or (lambda _part: None))
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written: {error.strerror}") from error


def _save_csv(run: RecordedRun, traces: Traces, file: BinaryIO, progress: Progress) -> None:
    time, ticks = run.time, run.ticks
    rows = [_at_session_ticks(run, node, trace) for (node, _), trace in traces.items()]
    text = TextIOWrapper(file, encoding="utf-8", newline="")
    writer = csv.writer(text)
    writer.writerow([TICK, TIME, *(name for key, trace in traces.items() for name in column_names(key[0], trace))])
    for begin in range(0, ticks, _ROWS):
        end = min(begin + _ROWS, ticks)
        block = np.hstack([time[begin:end, None], *(values[begin:end] for values in rows)])
        writer.writerows([tick, *map(repr, row)] for tick, row in enumerate(block.tolist(), run.first + begin))
        progress(end / ticks)
    text.detach()  # flushes it, and leaves the file open


def table_columns(run: RecordedRun, traces: Traces) -> dict[str, NDArray[Any]]:
    """The columns of a table of these traces by name: the session's ticks, their time in s, and every column."""
    out: dict[str, NDArray[Any]] = {TICK: np.arange(run.first, run.first + run.ticks, dtype=np.int64), TIME: run.time}
    for key, trace in traces.items():
        out |= dict(zip(column_names(key[0], trace), _at_session_ticks(run, key[0], trace).T, strict=True))
    return out


def _at_session_ticks(run: RecordedRun, node: str, trace: RecordedTrace) -> Array:
    """The rows of a trace at the session's ticks, each the node's newest one."""
    return trace.values if node not in run.recorded.periods else trace.values[run.at_session_ticks(node)]


def _save_npz(run: RecordedRun, traces: Traces, file: BinaryIO, progress: Progress) -> None:
    recorded = run.recorded
    ports = [port for own in recorded.devices.values() for port in own]
    arrays: dict[str, Any] = {**about(recorded), "period": recorded.period, "ports": np.array(ports)}
    for name in (DISPLACEMENT, FORCE):  # under the names of a simulation's file, so that one reader suits both
        every = [
            _at_session_ticks(run, node, trace)
            for (node, _), trace in traces.items()
            if node in recorded.devices and trace.topic.trace == name
        ]
        if len(every) == len(recorded.devices):
            arrays[name] = np.hstack(every)
    np.savez(file, **arrays | table_columns(run, traces))
    progress(1.0)


def _save_parquet(run: RecordedRun, traces: Traces, file: BinaryIO, progress: Progress) -> None:
    require("parquet")
    import pyarrow as pa
    from pyarrow import parquet

    metadata = {f"manyhands.{key}": text for key, text in about(run.recorded).items()}
    table = pa.table(
        {name: pa.array(np.ascontiguousarray(values)) for name, values in table_columns(run, traces).items()}
    )
    parquet.write_table(table.replace_schema_metadata(metadata), file)
    progress(1.0)


FORMATS: Final[Mapping[str, Callable[[RecordedRun, Traces, BinaryIO, Progress], None]]] = {
    "csv": _save_csv,
    "npz": _save_npz,
    "parquet": _save_parquet,
}
"""The formats of a table, with the functions that write them."""
