"""A recording as a table: one row a tick, one column of each topic's; for a spreadsheet, numpy, or a data frame.

A column is named ``NODE.TOPIC[COLUMN]_UNIT``, such as ``dx.sample[x]_m``. Every number is exact, and not a number where
the recording has none.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping, Sequence
from fnmatch import fnmatchcase
from io import TextIOWrapper
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
from numpy.typing import NDArray

from manyhands.design.files import replacing
from manyhands.launch.recordings.recording import RecordingError
from manyhands.launch.recordings.run import Run, Trace
from manyhands.nodes.recorder.layout import Recorded
from manyhands.protocol.topics import DISPLACEMENT, FORCE, topic_name

Array = NDArray[np.float64]
Progress = Callable[[float], None]

TICK: Final = "tick"
TIME: Final = "time_s"
_ROWS: Final = 2048  # that are turned into text at a time


def chosen(run: Run, patterns: Sequence[str]) -> dict[tuple[str, str], Trace]:
    """The traces that are meant: all without patterns.

    Args:
        run: the recording.
        patterns: with ``*`` and ``?``, each for a full name ``/SESSION/NODE/TOPIC``, ``NODE/TOPIC``, a node or a topic.

    Raises:
        RecordingError: a pattern means none.
    """
    names = {
        key: (topic_name(run.recorded.session, *key), "/".join(key), *key)  # each of them may be meant
        for key in run.traces
    }
    meant = set()
    for pattern in patterns:
        fitting = {key for key, texts in names.items() if any(fnmatchcase(text, pattern) for text in texts)}
        if not fitting:
            there = ", ".join("/".join(key) for key in names)
            raise RecordingError(f"--topics: found {pattern!r}, which is none of this recording's; expected of {there}")
        meant |= fitting
    return {key: trace for key, trace in run.traces.items() if not patterns or key in meant}


def column_names(node: str, trace: Trace) -> list[str]:
    """The names of a trace's columns in a table."""
    return [f"{node}.{trace.topic.name}[{column}]_{trace.topic.unit}" for column in trace.columns]


def about(recorded: Recorded) -> dict[str, str]:
    """What a table says of the session besides its numbers, as texts."""
    return {
        "session": recorded.session,
        "certificate": recorded.certificate,
        "period": repr(recorded.period),
        "clock": recorded.clock,
        "version": recorded.version,
    }


def export(run: Run, path: Path, to: str, patterns: Sequence[str] = (), progress: Progress | None = None) -> None:
    """Write a recording as a table, whole or not at all.

    Args:
        run: the recording.
        path: where the table goes.
        to: the format, one of :data:`FORMATS`.
        patterns: which topics; see :func:`chosen`.
        progress: gets the part that is done, 0 to 1.

    Raises:
        RecordingError: a pattern means no topic, the format cannot be written here, or the file cannot.
    """
    traces = chosen(run, patterns)
    write = FORMATS[to]
    try:
        with replacing(path) as file:
            write(run, traces, file, progress or (lambda _part: None))
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written: {error.strerror}") from error


Traces = Mapping[tuple[str, str], Trace]


def _save_csv(run: Run, traces: Traces, file: BinaryIO, progress: Progress) -> None:
    time, ticks = run.time, run.ticks
    text = TextIOWrapper(file, encoding="utf-8", newline="")
    writer = csv.writer(text)
    writer.writerow([TICK, TIME, *(name for key, trace in traces.items() for name in column_names(key[0], trace))])
    for begin in range(0, ticks, _ROWS):
        end = min(begin + _ROWS, ticks)
        block = np.hstack([time[begin:end, None], *(trace.values[begin:end] for trace in traces.values())])
        writer.writerows([tick, *map(repr, row)] for tick, row in enumerate(block.tolist(), run.first + begin))
        progress(end / ticks)
    text.detach()  # flushes it, and leaves the file open


def _columns(run: Run, traces: Traces) -> dict[str, NDArray[Any]]:
    out: dict[str, NDArray[Any]] = {TICK: np.arange(run.first, run.first + run.ticks, dtype=np.int64), TIME: run.time}
    for key, trace in traces.items():
        out |= dict(zip(column_names(key[0], trace), trace.values.T, strict=True))
    return out


def _save_npz(run: Run, traces: Traces, file: BinaryIO, progress: Progress) -> None:
    recorded = run.recorded
    ports = [port for own in recorded.devices.values() for port in own]
    arrays: dict[str, Any] = {**about(recorded), "period": recorded.period, "ports": np.array(ports)}
    for name in (DISPLACEMENT, FORCE):  # as a simulation's file has them, for whoever reads those
        every = [t.values for (node, _), t in traces.items() if node in recorded.devices and t.topic.trace == name]
        if len(every) == len(recorded.devices):
            arrays[name] = np.hstack(every)
    np.savez(file, **arrays | _columns(run, traces))
    progress(1.0)


def _save_parquet(run: Run, traces: Traces, file: BinaryIO, progress: Progress) -> None:
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError as error:
        raise RecordingError(
            "--to parquet: found no pyarrow, which writes such files; expected it: pip install 'manyhands[parquet]'"
        ) from error
    told = {f"manyhands.{key}": text for key, text in about(run.recorded).items()}
    table = pa.table({name: pa.array(np.ascontiguousarray(values)) for name, values in _columns(run, traces).items()})
    parquet.write_table(table.replace_schema_metadata(told), file)
    progress(1.0)


FORMATS: Final[Mapping[str, Callable[[Run, Traces, BinaryIO, Progress], None]]] = {
    "csv": _save_csv,
    "npz": _save_npz,
    "parquet": _save_parquet,
}
"""How a table can be written."""
