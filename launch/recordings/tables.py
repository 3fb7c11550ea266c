"""Recordings as tables: reads x and f_v from files of any format.

:func:`read_saved` reads what :meth:`manyhands.launch.recordings.recording.Recording.save` wrote, ``.npz`` and ``.csv``.
:func:`read_recording` reads an ``.mcap`` file, whole or as far as it goes. The files may come from anywhere: nothing in
them is executed (no pickles), and their size is checked before they are read.
"""

from __future__ import annotations

import csv
import math
import os
import re
from array import array
from collections.abc import Callable
from io import TextIOWrapper
from pathlib import Path
from typing import Final, TextIO

import numpy as np
from numpy.typing import NDArray

from manyhands.design.files import open_regular
from manyhands.design.models.axis import units_by_port
from manyhands.launch.recordings.arrays import read_arrays
from manyhands.launch.recordings.reading import MOST_MISSING, Gatherer, cut_at, read_topics, require_beginning, span_of
from manyhands.launch.recordings.recording import Array, Recording, RecordingError, one_period, require_format
from manyhands.nodes.recorder.coverage import Coverage, missing_by_party
from manyhands.nodes.rows.own_ticks import own_span
from manyhands.protocol.channels import DISPLACEMENT, FORCE, topics_of
from manyhands.protocol.messages import Role

MOST_BYTES: Final = 4 * 2**30
"""The longest file that is read; of ``.npz``, the most unpacked bytes."""

_ARRAYS: Final = ("x", "f_v", "ports", "period", "session", "certificate")
_COLUMN = re.compile(r"(x|f_v)\[(.+)\]_(m|N|rad|N·m)")
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


def _csv(path: Path, progress: Callable[[float], None]) -> Recording:
    with TextIOWrapper(open_regular(path, MOST_BYTES), newline="", encoding="utf-8") as file:
        size = os.fstat(file.fileno()).st_size
        ports, turning, values = _rows(file, lambda: progress(os.lseek(file.fileno(), 0, os.SEEK_CUR) / max(size, 1)))
    m = len(ports)
    table: Array = np.frombuffer(values, dtype=np.float64).reshape(-1, 2 + 2 * m)
    ticks, time = table[:, 0], table[:, 1]
    if len(table) < 2:
        raise ValueError(f"{len(table)} lines of ticks, which show no period")
    period = float(time[-1] / (len(time) - 1))
    if not np.array_equal(ticks, np.arange(len(table))) or not 0.0 < period < math.inf:
        raise ValueError("ticks that do not count up from 0, or no times beside them")
    x, f_v = table[:, 2 : 2 + m], table[:, 2 + m :]
    return Recording(path.stem, "", period, ports, x, f_v, turning=turning)


def _rows(file: TextIO, progress: Callable[[], None]) -> tuple[tuple[str, ...], tuple[str, ...], array[float]]:
    """The ports of the heading, those of them that turn, and every number below it."""
    reader = csv.reader(file, strict=True)
    try:
        head = next(reader, [])
        found = [_COLUMN.fullmatch(name) for name in head[2:]]
        names = [match.groups() for match in found if match]
        ports = tuple(port for kind, port, _ in names if kind == "x")
        turning = tuple(port for kind, port, unit in names if kind == "x" and unit == "rad")
        units = units_by_port(ports, turning)
        wanted = [(kind, port, units[port](unit)) for kind, unit in (("x", "m"), ("f_v", "N")) for port in ports]
        if head[:2] != ["tick", "time_s"] or names != wanted:
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
    return ports, turning, values


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
        tuple(port for port in recorded.turning if any(port in own for own in recorded.devices.values())),
    )


def _signal_columns(sample: Gatherer, force: Gatherer, span: range) -> tuple[Array, Array, NDArray[np.bool_]]:
    """The x and f_v of a device, NaN in ticks that lack one of them, and which ticks have both."""
    (x, x_there), (f_v, f_there) = sample.rows(span), force.rows(span)
    both = x_there & f_there
    x[~both] = f_v[~both] = np.nan
    return x, f_v, both
