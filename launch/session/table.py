"""Positions in columns, as recordings and other programs write them down: .npz and .csv, read within bounds.

A recording of this program names its columns by ports; another's has times in its first column and one for each axis.
"""

import csv
import io
import math
import zipfile
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from manyhands.design.files import open_regular
from manyhands.launch.session.limits import MAX_TRACE_BYTES, MAX_TRACE_ROWS

Array = NDArray[np.float64]

_TIME_COLUMN: Final = "time_s"
_FIRST, _LAST = "x[", "]_m"  # around a port, in the heading of its column
_HEADERS: Final[Mapping[int, Callable[[Any], Any]]] = {
    1: np.lib.format.read_array_header_1_0,
    2: np.lib.format.read_array_header_2_0,
}
"""By an array's version, what reads its header: shape, order and type."""


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
        OSError, ValueError: it cannot be read, or holds no table.
    """
    return _from_npz(path) if path.suffix == ".npz" else _from_csv(path)


def _from_npz(path: Path) -> Table:
    arrays = read_arrays(path, (("x", "ports", "period"), ("x", "t")), MAX_TRACE_BYTES)
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


def read_arrays(path: Path, choices: Sequence[Sequence[str]], most: int) -> dict[str, NDArray[np.generic]]:
    """The arrays of a ``.npz`` file, those of the first of ``choices`` that it has all of.

    What a member claims of its size is held against the file and the limit before room is made for it.

    Args:
        path: the file.
        choices: names of arrays, one list of which is wanted.
        most: bytes of the file, and of all that is packed in it.

    Raises:
        OSError, ValueError: it cannot be read, is damaged or larger, or has none of the choices.
    """
    try:
        with open_regular(path, most) as file, zipfile.ZipFile(file) as archive:
            members = {member.filename: member for member in archive.infolist()}
            for wanted in choices:
                files = [f"{name}.npy" for name in wanted]
                if members.keys() >= {*files}:
                    if sum(members[one].file_size for one in files) > most:
                        raise ValueError(f"larger than {most} bytes when unpacked")
                    return {name: _array(archive, members[one]) for name, one in zip(wanted, files, strict=True)}
    except (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError) as error:  # encrypted: RuntimeError
        raise ValueError(f"which is damaged ({error})") from error
    raise ValueError(f"which does not hold {', or '.join(', '.join(wanted) for wanted in choices)}")


def _array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray[np.generic]:
    """One array, when its header says that it is as large as its file."""
    with archive.open(member) as file:
        major, _ = np.lib.format.read_magic(file)
        if major not in _HEADERS:
            raise ValueError(f"with an array of version {major}; expected 1 or 2")
        shape, _, dtype = _HEADERS[major](file)
        if dtype.hasobject:
            raise ValueError("which holds Python's objects and not numbers or texts")  # reading them would run code
        stated = math.prod(shape) * dtype.itemsize
        if member.file_size - file.tell() != stated:
            raise ValueError(f"with an array of {stated} bytes by its header and {member.file_size} in its file")
        file.seek(0)
        array: NDArray[np.generic] = np.lib.format.read_array(file, allow_pickle=False)
    return array


def _numbers(array: NDArray[np.generic]) -> Array:
    if array.dtype.kind not in "fiu":
        raise ValueError("which holds something else than numbers")
    return array.astype(np.float64)


def _from_csv(path: Path) -> Table:
    with io.TextIOWrapper(open_regular(path, MAX_TRACE_BYTES), encoding="utf-8-sig", newline="") as file:
        rows = csv.reader(file)
        try:
            first = next(rows, [])
            heading = first if any(cell and _number(cell) is None for cell in first) else None
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
            raise ValueError(f"row {len(out) + 1}: not {len(columns)} numbers")  # what there is may be a secret
        if len(out) == MAX_TRACE_ROWS:
            raise ValueError(f"more than {MAX_TRACE_ROWS} rows")
        out.append(kept)
    return np.array(out, dtype=np.float64).reshape(len(out), max(1, len(columns)))


def _number(cell: str) -> float | None:
    try:
        return float(cell)
    except ValueError:
        return None
