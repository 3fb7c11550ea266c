"""The formats of tables: what a run, a simulation and a recording can be written as, and the function that writes each.

A format is a line in :data:`TABLES`. `simulate`, `launch`, `export` and ``save`` take all of them. A recording with all
telemetry, :data:`STREAMED`, is written while the session's processes run, by a process of its own
(:mod:`manyhands.launch.run.recorder`); a simulation in one process has no processes whose telemetry it could hold.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from io import TextIOWrapper
from typing import Any, BinaryIO, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from manyhands.extras import require

Columns: TypeAlias = Mapping[str, NDArray[Any]]
Progress: TypeAlias = Callable[[float], None]

TICK: Final = "tick"
TIME: Final = "time_s"
"""The first two columns of a table."""

ABOUT: Final = "manyhands"
"""What the keys of a Parquet file's own words begin with, before a dot."""

_ROWS = 2048  # rows that are converted to text at a time


@dataclass(frozen=True, eq=False)
class TableOfRun:
    """What is written of a run.

    Attributes:
        columns: of one length, by name.
        arrays: what ``.npz`` holds.
        about: what the session is, as texts, for formats that keep such.
    """

    columns: Columns
    arrays: Mapping[str, Any]
    about: Mapping[str, str] = field(default_factory=dict)


def write_csv(file: BinaryIO, columns: Columns, progress: Progress | None = None) -> None:
    """Write a table: its names in the first row, then a row for each entry of the columns, every number exact.

    Args:
        file: open for writing; it stays open.
        columns: of one length, by name.
        progress: called with the part that is done, 0 to 1.
    """
    text = TextIOWrapper(file, encoding="utf-8", newline="")
    writer = csv.writer(text)
    writer.writerow(columns)
    rows = max(map(len, columns.values()), default=0)
    for begin in range(0, rows, _ROWS):
        block = (column[begin : begin + _ROWS].tolist() for column in columns.values())
        writer.writerows(zip(*block, strict=True))
        if progress is not None:
            progress(min(begin + _ROWS, rows) / rows)
    text.detach()  # flushes it, and leaves the file open


def _csv(file: BinaryIO, table: TableOfRun, progress: Progress) -> None:
    write_csv(file, table.columns, progress)


def _npz(file: BinaryIO, table: TableOfRun, progress: Progress) -> None:
    np.savez(file, **table.arrays)
    progress(1.0)


def _parquet(file: BinaryIO, table: TableOfRun, progress: Progress) -> None:
    require("parquet")
    import pyarrow as pa
    from pyarrow import parquet

    arrow = pa.table({name: pa.array(np.ascontiguousarray(values)) for name, values in table.columns.items()})
    about = {f"{ABOUT}.{key}": text for key, text in table.about.items()}
    parquet.write_table(arrow.replace_schema_metadata(about), file)
    progress(1.0)


TABLES: Final[Mapping[str, Callable[[BinaryIO, TableOfRun, Progress], None]]] = {
    "csv": _csv,
    "npz": _npz,
    "parquet": _parquet,
}
"""The formats of a table, each with the function that writes it; a file's suffix is the name after a dot."""

SUFFIXES: Final = tuple(f".{name}" for name in TABLES)
"""Of tables: what a simulation in one process writes, which keeps every value in memory."""

STREAMED: Final = ".mcap"
RUN_SUFFIXES: Final = (*SUFFIXES, STREAMED)
"""What a session of processes writes, and what is read again here."""

EXTRAS: Final[Mapping[str, str]] = {STREAMED: "record", ".parquet": "parquet"}
"""The extra that a format needs, by suffix."""
