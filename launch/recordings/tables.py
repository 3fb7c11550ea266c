"""Recordings as tables: reads x and f_v from files of any format.

:func:`read_saved` reads every table of :data:`manyhands.launch.recordings.formats.TABLES`, whether a simulation, a
session or an export wrote it. An export has topics of every node; its x and f_v are the devices' samples and forces.
:func:`read_recording` reads an ``.mcap`` file, whole or as far as it goes. The files may come from anywhere: nothing in
them is executed (no pickles), and their size is checked before they are read.
"""

from __future__ import annotations

import csv
import math
import os
import re
from array import array
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from io import TextIOWrapper
from pathlib import Path
from typing import Final, TextIO

import numpy as np
from numpy.typing import NDArray

from manyhands.design.files import open_regular
from manyhands.design.models.axis import units_by_port
from manyhands.extras import require
from manyhands.launch.recordings.arrays import read_arrays
from manyhands.launch.recordings.formats import ABOUT, SUFFIXES, TICK, TIME
from manyhands.launch.recordings.reading import MOST_MISSING, Gatherer, cut_at, read_topics, require_beginning, span_of
from manyhands.launch.recordings.recording import Array, Recording, RecordingError, one_period, require_format
from manyhands.nodes.recorder.coverage import Coverage, missing_by_party
from manyhands.nodes.rows.own_ticks import own_span
from manyhands.protocol.channels import DISPLACEMENT, FORCE, topics_of
from manyhands.protocol.messages import Role

MOST_BYTES: Final = 4 * 2**30
"""The longest file that is read; of ``.npz``, the most unpacked bytes."""

_ARRAYS: Final = ("x", "f_v", "ports", "period", "session", "certificate")
_SIGNALS = (DISPLACEMENT, FORCE)
_TOPICS = tuple(next(t.name for t in topics_of(Role.DEVICE) if t.trace == signal) for signal in _SIGNALS)
_COLUMN = re.compile(rf"(?:({'|'.join(_SIGNALS)})|.+\.({'|'.join(_TOPICS)}))\[(.+)\]_(m|N|rad|N·m)")
"""A column of x or f_v: of a recording, or of a device's topic in an export."""

_LINES_TOLD = 10_000  # lines between two reports of progress


def read_saved(path: Path, progress: Callable[[float], None] | None = None) -> Recording:
    """Read x and f_v of a table; for ``.csv`` the file's name is the session's, and the certificate empty.

    Args:
        path: the file.
        progress: called with the part that is done, 0 to 1.

    Raises:
        RecordingError: the suffix is another, or the file cannot be read or is no recording.
        MissingExtra: an extra is missing that reads such files.
    """
    require_format(path, SUFFIXES)
    try:
        recording = _READERS[path.suffix](path, progress or (lambda _part: None))
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror or error}") from error
    except MemoryError as error:
        raise RecordingError(f"{path}: found more than this machine has memory for; expected a smaller file") from error
    except (ValueError, TypeError) as error:
        raise RecordingError(
            f"{path}: found no recording: {error}; expected what simulate, launch, save or export writes"
        ) from error
    if len(recording.x) < 1 or not recording.ports:
        raise RecordingError(f"{path}: found no ticks; expected at least one")
    return recording


def _npz(path: Path, _progress: Callable[[float], None]) -> Recording:
    data = read_arrays(path, ((*_ARRAYS, "turning"), _ARRAYS), MOST_BYTES)
    x, f_v = (np.asarray(data[name], dtype=np.float64) for name in ("x", "f_v"))
    ports = tuple(str(port) for port in data["ports"])
    period = float(data["period"])
    session, certificate = str(data["session"]), str(data["certificate"])
    if x.ndim != 2 or x.shape != f_v.shape or x.shape[1] != len(ports):
        raise ValueError(f"x of shape {x.shape} and f_v of {f_v.shape} for {len(ports)} ports")
    if not 0.0 < period < math.inf:
        raise ValueError(f"the period {period:g} s")
    turning = tuple(str(port) for port in data.get("turning", ()))
    if not {*turning} <= {*ports}:
        raise ValueError(f"turning ports {turning} that are none of {ports}")
    return Recording(session, certificate, period, ports, x, f_v, turning=turning)


@dataclass(frozen=True)
class _Heading:
    """Where a table has what of a recording.

    Attributes:
        ports: of the devices.
        turning: those of them that turn.
        places: of the columns of tick, time, x and f_v of each port.
    """

    ports: tuple[str, ...]
    turning: tuple[str, ...]
    places: tuple[int, ...]

    @classmethod
    def of(cls, names: list[str]) -> _Heading:
        """Of a table with these columns; ValueError if it does not have x and f_v of the same ports."""
        if names[:2] != [TICK, TIME]:
            raise ValueError(f"the heading {','.join(names)[:80]!r}")
        found: dict[str, dict[str, tuple[str, int]]] = {signal: {} for signal in _SIGNALS}
        for place, name in enumerate(names[2:], 2):
            if match := _COLUMN.fullmatch(name):
                signal, topic, port, unit = match.groups()
                own = found[signal or _SIGNALS[_TOPICS.index(topic)]]
                if port in own:
                    raise ValueError(f"two columns of the port {port[:80]!r}, the second {name[:80]!r}")
                own[port] = unit, place
        x, f_v = (found[signal] for signal in _SIGNALS)
        if not x or x.keys() != f_v.keys():
            raise ValueError(f"x of the ports {', '.join(x)[:80]!r} and f_v of {', '.join(f_v)[:80]!r}")
        turning = tuple(port for port, (unit, _) in x.items() if unit == "rad")
        units = units_by_port(tuple(x), turning)
        for signal, one, unit in (("x", x, "m"), ("f_v", f_v, "N")):
            for port, (stated, _) in one.items():
                if stated != units[port](unit):
                    raise ValueError(
                        f"{signal} of the port {port[:80]!r} in {stated}, where {units[port](unit)} is right"
                    )
        return cls(tuple(x), turning, (0, 1, *(at for _, at in x.values()), *(f_v[port][1] for port in x)))

    def recording(self, table: Array, session: str, certificate: str = "", period: float | None = None) -> Recording:
        """The recording of these columns, ticks x places; a period that is not stated is found from the times."""
        m, ticks, time = len(self.ports), table[:, 0], table[:, 1]
        if len(table) < 2 and period is None:
            raise ValueError(f"{len(table)} lines of ticks, which show no period")
        period = float(time[-1] / (len(time) - 1)) if period is None else period
        if not np.array_equal(ticks, np.arange(len(table))) or not 0.0 < period < math.inf:
            raise ValueError("ticks that do not count up from 0, or no times beside them")
        x, f_v = table[:, 2 : 2 + m], table[:, 2 + m :]
        return Recording(session, certificate, period, self.ports, x, f_v, turning=self.turning)


def _csv(path: Path, progress: Callable[[float], None]) -> Recording:
    with TextIOWrapper(open_regular(path, MOST_BYTES), newline="", encoding="utf-8") as file:
        heading, values = _rows(file, progress)
    return heading.recording(np.frombuffer(values, dtype=np.float64).reshape(-1, len(heading.places)), path.stem)


def _rows(file: TextIO, progress: Callable[[float], None]) -> tuple[_Heading, array[float]]:
    """The heading, and below it every number of a column that it names."""
    size = os.fstat(file.fileno()).st_size
    reader = csv.reader(file, strict=True)
    try:
        head = next(reader, [])
        heading, values = _Heading.of(head), array("d")
        for row in reader:
            if len(row) != len(head):
                raise ValueError(f"line {reader.line_num}: {len(row)} columns beside {len(head)} of the heading")
            values.extend(float(row[place]) for place in heading.places)
            if reader.line_num % _LINES_TOLD == 0:
                progress(os.lseek(file.fileno(), 0, os.SEEK_CUR) / max(size, 1))
    except csv.Error as error:
        raise ValueError(f"line {reader.line_num}: {error}") from error
    return heading, values


def _parquet(path: Path, progress: Callable[[float], None]) -> Recording:
    require("parquet")
    import pyarrow as pa
    from pyarrow import parquet

    try:
        with open_regular(path, MOST_BYTES) as file:
            stored = parquet.ParquetFile(file)
            names = stored.schema_arrow.names
            heading = _Heading.of(names)
            if (size := stored.metadata.num_rows * len(heading.places) * 8) > MOST_BYTES:
                raise ValueError(f"{size} bytes when unpacked; expected at most {MOST_BYTES}")
            about = stored.schema_arrow.metadata or {}
            read = stored.read(columns=[names[place] for place in heading.places], use_threads=False)
            columns = [np.asarray(read.column(names[place]).to_numpy(), np.float64) for place in heading.places]
    except pa.ArrowException as error:
        raise ValueError(f"which is damaged ({error})") from error
    session, certificate, period = (
        about.get(f"{ABOUT}.{key}".encode(), b"").decode() for key in ("session", "certificate", "period")
    )
    progress(1.0)
    return heading.recording(np.stack(columns, 1), session or path.stem, certificate, float(period) if period else None)


_READERS: Final[Mapping[str, Callable[[Path, Callable[[float], None]], Recording]]] = {
    ".csv": _csv,
    ".npz": _npz,
    ".parquet": _parquet,
}


def read_recording(path: Path) -> Recording:
    """Read x and f_v of an ``.mcap`` recording of this program, whole or cut anywhere after its metadata.

    The rows end with the last tick that any device recorded. Ticks that a device did not record are NaN and counted in
    ``missing``, and so are ticks that are lost with the end of a cut file. A tick is recorded where both its x and its
    f_v are.

    Raises:
        RecordingError: the file cannot be read, is no recording, is too large, or is cut before its metadata; or its
            devices have different periods.
    """
    sample, force = _TOPICS
    reading = read_topics(path, lambda node, topic: topic.name in _TOPICS)
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
        tuple(port for port in recorded.turning if any(port in own for own in recorded.devices.values())),
    )


def _signal_columns(sample: Gatherer, force: Gatherer, span: range) -> tuple[Array, Array, NDArray[np.bool_]]:
    """The x and f_v of a device, NaN in ticks that lack one of them, and which ticks have both."""
    (x, x_there), (f_v, f_there) = sample.rows(span), force.rows(span)
    both = x_there & f_there
    x[~both] = f_v[~both] = np.nan
    return x, f_v, both
