"""Positions in columns, as recordings and other programs write them down: .npz and .csv, read within bounds.

A recording of this program names its columns by ports; another's has times in its first column and one for each axis.
"""

import csv
import io
import zipfile
from collections.abc import Iterable
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from manyhands.launch.session.error import show
from manyhands.launch.session.limits import MAX_TRACE_BYTES, MAX_TRACE_ROWS

Array = NDArray[np.float64]

_TIME_COLUMN: Final = "time_s"
_FIRST, _LAST = "x[", "]_m"  # around a port, in the heading of its column


class Table(NamedTuple):
    """What was read.

    Attributes:
        times: s.
        x: times x columns, m.
        ports: of each column; None where nothing says whose they are.
    """

    times: Array
    x: Array
    ports: tuple[str, ...] | None


def table_of(path: Path) -> Table:
    """Read a ``.npz`` or ``.csv`` file.

    Raises:
        OSError, ValueError, BadZipFile: it cannot be read, or holds no table.
    """
    return _from_npz(path) if path.suffix == ".npz" else _from_csv(path)


def _from_npz(path: Path) -> Table:
    with zipfile.ZipFile(path) as archive:
        if sum(member.file_size for member in archive.infolist()) > MAX_TRACE_BYTES:
            raise ValueError(f"larger than {MAX_TRACE_BYTES} bytes when unpacked")
        names = {name.removesuffix(".npy") for name in archive.namelist()}
        wanted = ("x", "ports", "period") if {"ports", "period"} <= names else ("x", "t")
        if not names.issuperset(wanted):
            raise ValueError(f"which holds {', '.join(sorted(names)) or 'nothing'}, and not {', '.join(wanted)}")
        arrays = {name: _array(archive.read(f"{name}.npy")) for name in wanted}
    x = _numbers(arrays["x"])
    x = x[:, None] if x.ndim == 1 else x
    if x.ndim != 2:
        raise ValueError("whose x is not ticks x columns")
    if "t" in arrays:
        times, ports = _numbers(arrays["t"]), None
    else:
        ports = tuple(map(str, np.atleast_1d(arrays["ports"])))
        times = np.arange(x.shape[0], dtype=np.float64) * float(_numbers(arrays["period"]))
    if times.shape != x.shape[:1] or (ports is not None and len(ports) != x.shape[1]):
        raise ValueError("whose x has not a row for each time and a column for each port")
    return Table(times, x, ports)


def _array(data: bytes) -> NDArray[np.generic]:
    array: NDArray[np.generic] = np.lib.format.read_array(io.BytesIO(data), allow_pickle=False)
    return array


def _numbers(array: NDArray[np.generic]) -> Array:
    if array.dtype.kind not in "fiu":
        raise ValueError("which holds something else than numbers")
    return array.astype(np.float64)


def _from_csv(path: Path) -> Table:
    with path.open(encoding="utf-8-sig", newline="") as file:
        rows = csv.reader(file)
        try:
            first = next(rows, [])
            heading = first if any(_number(cell) is None for cell in first) else None
            if heading is not None and _TIME_COLUMN in heading:
                columns = [heading.index(_TIME_COLUMN)]
                columns += [i for i, cell in enumerate(heading) if cell.startswith(_FIRST) and cell.endswith(_LAST)]
                ports = tuple(heading[i][len(_FIRST) : -len(_LAST)] for i in columns[1:])
                values = _rows(rows, columns)
                return Table(values[:, 0], values[:, 1:], ports)
            values = _rows(rows if heading is not None else [first, *rows], list(range(len(first))))
        except csv.Error as error:
            raise ValueError(f"which is no table ({error})") from error
        except UnicodeDecodeError:
            raise ValueError("which is not UTF-8 text") from None
    return Table(values[:, 0], values[:, 1:], None)


def _rows(rows: Iterable[list[str]], columns: list[int]) -> Array:
    """The numbers in these columns; an empty cell is a position that was not recorded."""
    out: list[list[float]] = []
    for row in rows:
        if not row:
            continue  # a blank line, as editors leave one at the end
        cells = [row[i] if i < len(row) else None for i in columns]
        numbers = [None if cell is None else np.nan if cell == "" else _number(cell) for cell in cells]
        kept = [number for number in numbers if number is not None]
        if len(kept) != len(columns):
            raise ValueError(f"row {len(out) + 1}: {show(','.join(row))}, and not {len(columns)} numbers")
        if len(out) == MAX_TRACE_ROWS:
            raise ValueError(f"more than {MAX_TRACE_ROWS} rows")
        out.append(kept)
    return np.array(out, dtype=np.float64).reshape(len(out), max(1, len(columns)))


def _number(cell: str) -> float | None:
    try:
        return float(cell)
    except ValueError:
        return None
