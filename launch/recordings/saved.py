"""Reading what :meth:`manyhands.launch.recordings.recording.Recording.save` wrote: ``.npz`` and ``.csv``.

The files may come from anywhere: nothing in them is run (no pickles), and their size is looked at before they are read.
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

from manyhands.design.files import open_regular
from manyhands.launch.recordings.recording import Array, Recording, RecordingError, require_format
from manyhands.launch.session.table import read_arrays

MOST_BYTES: Final = 4 * 2**30
"""Longest file (of ``.npz``: of what is packed in it) that is read."""

_ARRAYS: Final = ("x", "f_v", "ports", "period", "session", "certificate")
_COLUMN = re.compile(r"(x|f_v)\[(.+)\]_(m|N)")
_LINES_TOLD = 10_000  # lines between two words on how far the reading is


def read_saved(path: Path, progress: Callable[[float], None] | None = None) -> Recording:
    """Read a ``.npz`` or ``.csv`` recording; a ``.csv`` has no session's name but the file's, and no certificate.

    Args:
        path: the file.
        progress: told how far it is, 0 ... 1.

    Raises:
        RecordingError: another suffix, not readable, or no such recording.
    """
    require_format(path, (".npz", ".csv"))
    try:
        recording = _npz(path) if path.suffix == ".npz" else _csv(path, progress or (lambda _part: None))
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror or error}") from error
    except MemoryError as error:
        raise RecordingError(f"{path}: found more than this machine has memory for; expected a smaller file") from error
    except (ValueError, TypeError) as error:
        raise RecordingError(f"{path}: found no recording: {error}; expected what simulate -o writes") from error
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
        raise ValueError("ticks that do not go on one by one from 0, or no time with them")
    return Recording(path.stem, "", period, ports, table[:, 2 : 2 + m], table[:, 2 + m :])


def _rows(file: TextIO, tell: Callable[[], None]) -> tuple[tuple[str, ...], array[float]]:
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
                tell()
    except csv.Error as error:
        raise ValueError(f"line {reader.line_num}: {error}") from error
    return ports, values
