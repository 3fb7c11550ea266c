"""Recorded motions and traces in a session file, read from recordings and tables into numbers.

A :class:`Motion` holds the positions by axis that a device with ``driver: trace`` repeats. Its file is a recording
(``.mcap``, ``.npz``, ``.csv``) of this program, whose columns are named by ports, or a table of another program with
times in the first column and positions of one axis in each other. A :class:`TraceData` holds one intended force or
motion of a simulated hand, from a CSV file with the columns ``t`` (s) and value.

Files are read under limits on rows and bytes. A session keeps the numbers and not the file's name: a device's process
opens no file that the session's author named, and a session that a run keeps needs no other file.
"""

import csv
import functools
import io
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PlainSerializer
from pydantic_core import PydanticCustomError

from manyhands.design.files import open_regular
from manyhands.launch.recordings.arrays import read_arrays
from manyhands.launch.session.errors import listed, one_of, show
from manyhands.launch.session.fields import PortLimits, Problem, Quantity, SessionModel, problems_of, refusal, refuse
from manyhands.launch.session.forms import JsonSchema, either, list_of, mapping_of
from manyhands.launch.session.limits import (
    MAX_DOF,
    MAX_MOTION_NUMBERS,
    MAX_TRACE_BYTES,
    MAX_TRACE_LINE,
    MAX_TRACE_ROWS,
    PROBE_COUNT,
    PROBE_SECONDS,
)
from manyhands.nodes.kernel.intent import ALLOWED, Formula, FormulaError, IntentError, SampledSignal

_ROW: Final = "rows of two numbers, 't,value', with t in s increasing from 0"


class TraceData(SessionModel):
    """A recorded trace as numbers: ``times`` (s) and the ``values`` at them (N or m)."""

    times: tuple[float, ...]
    values: tuple[float, ...]


def trace_from_numbers(times: tuple[float, ...], values: tuple[float, ...], name: str) -> TraceData:
    """The trace of these numbers; errors call it ``name``.

    Raises:
        PydanticCustomError: the numbers are no trace.
    """
    try:
        SampledSignal(times, values)
    except IntentError as error:
        raise refuse(f"{name}: {error}", _ROW) from None
    return TraceData(times=times, values=values)


def plain_intent(intent: float | str | TraceData) -> object:
    """An intention as a bundle has it, and :func:`manyhands.nodes.kernel.intent.intent_from` reads it."""
    if isinstance(intent, TraceData):
        return {"times": list(intent.times), "values": list(intent.values)}
    return intent


def read_trace(file: object, folder: Path) -> TraceData:
    """Read a trace; its path is relative to ``folder``, the folder of the session file.

    Raises:
        PydanticCustomError: the file cannot be read, or does not hold a trace.
    """
    if not isinstance(file, str) or not file:
        raise refuse(show(file), "the name of a CSV file, relative to the session file")
    name = f"the trace {show(file)}"
    try:
        times, values = _trace_columns(folder / file, name)
    except PydanticCustomError:
        raise  # also a ValueError, but it reports a line and not the opening of the file
    except UnicodeDecodeError:
        raise refuse(f"{name}, which is not UTF-8 text", _ROW) from None
    except (OSError, ValueError) as error:  # ValueError: a path with a zero byte in it
        reason = getattr(error, "strerror", None) or str(error)
        raise refuse(f"{name}, {reason.lower()}", "a CSV file that can be read, relative to the session file") from None
    return trace_from_numbers(times, values, name)


def _trace_columns(path: Path, name: str) -> tuple[tuple[float, ...], tuple[float, ...]]:
    times: list[float] = []
    values: list[float] = []
    number = 0
    with io.TextIOWrapper(open_regular(path, MAX_TRACE_BYTES), encoding="utf-8-sig") as file:
        while line := file.readline(MAX_TRACE_LINE + 1):
            number += 1
            if len(line) > MAX_TRACE_LINE:
                raise refuse(f"{name}, line {number}: more than {MAX_TRACE_LINE} characters", _ROW)
            if number > MAX_TRACE_ROWS + 1:
                raise refuse(f"{name}, more than {MAX_TRACE_ROWS} rows", f"at most {MAX_TRACE_ROWS} rows")
            cells = [_number(cell) for cell in line.split(",")]
            match cells:
                case [float(time), float(value)]:
                    times.append(time)
                    values.append(value)
                case [None, None] if number == 1:
                    pass  # the header
                case _ if not line.strip():
                    pass  # a blank line, which editors leave at the end
                case _:
                    raise refuse(f"{name}, line {number}: no two numbers", _ROW)  # the content may be a secret
    return tuple(times), tuple(values)


def _number(cell: str) -> float | None:
    try:
        return float(cell)
    except ValueError:
        return None


Array = NDArray[np.float64]

_TIME_COLUMN: Final = "time_s"
_HEADING: Final = re.compile(r"x\[(.+)\]_(?:m|rad)")  # of a column: it has the port


class Table(NamedTuple):
    """Positions over time.

    Attributes:
        times: s.
        x: times x columns, m.
        ports: the port of each column; None where the file does not name them.
    """

    times: Array
    x: Array
    ports: tuple[str, ...] | None


def table_of(path: Path) -> Table:
    """Read a ``.npz`` or ``.csv`` file.

    Raises:
        OSError, ValueError: the file cannot be read, or holds no table.
    """
    return _from_npz(path) if path.suffix == ".npz" else _from_csv(path)


def _from_npz(path: Path) -> Table:
    arrays = read_arrays(path, (("x", "ports", "period"), ("x", "t")), MAX_TRACE_BYTES)
    x = _floats(arrays["x"])
    x = x[:, None] if x.ndim == 1 else x
    if x.ndim != 2:
        raise ValueError("whose x is not ticks x columns")
    if "t" in arrays:
        times, ports = _floats(arrays["t"]), None
    else:
        ports = tuple(map(str, np.atleast_1d(arrays["ports"])))
        times = np.arange(x.shape[0], dtype=np.float64) * float(_floats(arrays["period"]))
    if times.shape != x.shape[:1] or (ports is not None and len(ports) != x.shape[1]):
        raise ValueError("whose x has not a row for each time and a column for each port")
    return Table(times, x, ports)


def _floats(array: NDArray[np.generic]) -> Array:
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
                found = [_HEADING.fullmatch(cell) for cell in heading]
                columns += [i for i, match in enumerate(found) if match]
                ports = tuple(match[1] for match in found if match)
                values = _rows(rows, columns)
                return Table(values[:, 0], values[:, 1:], ports)
            values = _rows(rows if heading is not None else [first, *rows], list(range(len(first))))
        except csv.Error as error:
            raise ValueError(f"which is no table ({error})") from error
        except UnicodeDecodeError:
            raise ValueError("which is not UTF-8 text") from None
    return Table(values[:, 0], values[:, 1:], None)


def _rows(rows: Iterable[list[str]], columns: list[int]) -> Array:
    """The numbers in these columns, rows x columns; an empty cell, a position that was not recorded, becomes NaN."""
    out: list[list[float]] = []
    for row in rows:
        if not row:
            continue  # a blank line, which editors leave at the end
        cells = [row[i] if i < len(row) else None for i in columns]
        numbers = [None if cell is None else np.nan if cell == "" else _number(cell) for cell in cells]
        kept = [number for number in numbers if number is not None]
        if len(kept) != len(columns):
            raise ValueError(f"row {len(out) + 1}: not {len(columns)} numbers")  # the content may be a secret
        if len(out) == MAX_TRACE_ROWS:
            raise ValueError(f"more than {MAX_TRACE_ROWS} rows")
        out.append(kept)
    return np.array(out, dtype=np.float64).reshape(len(out), max(1, len(columns)))


OWN_NAME: Final = "(name of the device)"
"""Key under which a session passes a device's name to its trace; no session file can sensibly use it."""

_FORM: Final = "{file: FILE, device: NAME} or {times: [...], values: [...]}"
_FILES: Final = "a recording (.mcap, .npz, .csv) or a table of t and a column for each axis (.npz, .csv)"
_POSITION: Final = Quantity("a position", "m")
_TIME: Final = Quantity("a time", "s")


def _plain_values(values: tuple[tuple[float, ...], ...]) -> object:
    """The positions in the notation of a session file, where a single axis has no list around it."""
    return values[0] if len(values) == 1 else values


class Motion(SessionModel):
    """A recorded motion as numbers: ``times`` (s) and, for each axis, the ``values`` at them (m)."""

    times: tuple[float, ...] = Field(description="times of the samples in s, increasing from 0")
    values: Annotated[tuple[tuple[float, ...], ...], PlainSerializer(_plain_values)] = Field(
        description="the positions in m at those times, of one axis or as a list for each"
    )

    def at_ticks(self, period: float) -> Array:
        """The positions (m) at the ticks of this period (s): ticks x axes, up to the first tick after the end."""
        ticks = np.arange(self._last_tick(period) + 1) * period
        return np.stack([np.interp(ticks, self.times, axis) for axis in self.values], axis=1)

    def _last_tick(self, period: float) -> int:
        return int(np.ceil(self.times[-1] / period))

    def problem(self, period: float, limits: PortLimits) -> Problem | None:
        """The first sample at which the motion exceeds these limits, or its excessive length; None if it fits."""
        if self.times[-1] / period > MAX_TRACE_ROWS:
            return Problem((), f"a motion of {self.times[-1]:g} s", f"at most {MAX_TRACE_ROWS} ticks of the period")
        x = self.at_ticks(period)
        steps = np.diff(x, axis=0, prepend=np.zeros((1, x.shape[1])))  # every device begins at rest in 0
        for what, unit, found, most in (
            ("displacement", "m", x, np.array(limits.displacement)),
            ("speed", "m/s", steps / period, np.array(limits.speed)),
        ):
            beyond = np.argwhere(~(np.abs(found) <= most))
            if beyond.size:
                tick, axis = beyond[0]
                value, limit = found[tick, axis], most[axis]
                where = f" of axis {axis}" if len(self.values) > 1 else ""
                return Problem(
                    (),
                    f"a {what}{where} of {value:.6g} {unit} at tick {tick}",
                    f"at most {limit:g} {unit}, the device's limit; scale the motion, or raise the limit",
                )
        return None

    @property
    def numbers(self) -> int:
        """How many numbers the motion takes in a session file."""
        return len(self.times) * (1 + len(self.values))


def motion_problems(motions: Mapping[str, tuple[Motion, PortLimits]], period: float) -> Iterator[Problem]:
    """The problems of the motions of a session's devices, by name; their total size is limited, too."""
    total = sum(motion.numbers for motion, _ in motions.values())
    for name, (motion, limits) in motions.items():
        if total > MAX_MOTION_NUMBERS:
            found = f"recorded motions of {total} numbers in all"
            yield Problem(("devices", name, "trace"), found, f"at most {MAX_MOTION_NUMBERS}; cut them shorter")
            return
        if problem := motion.problem(period, limits):
            yield problem._replace(at=("devices", name, "trace"))


def with_own_names(devices: object) -> object:
    """The devices as given, where each trace with a file also has the name of its device (:data:`OWN_NAME`)."""
    if not isinstance(devices, Mapping):
        return devices
    named = {}
    for name, device in devices.items():
        named[name] = device
        trace = device.get("trace") if isinstance(device, Mapping) else None
        if isinstance(trace, Mapping) and "file" in trace:
            named[name] = {**device, "trace": {**trace, OWN_NAME: name}}
    return named


_LISTS: Final = list_of(_POSITION.json_schema, MAX_MOTION_NUMBERS)
_FILE: Final[JsonSchema] = {"type": "string", "pattern": r"[^/]\.(mcap|npz|csv)$"}
MOTION_FORM: Final = either(
    mapping_of({"file": _FILE}, {"device": {"type": "string", "minLength": 1}}),
    mapping_of(
        {
            "times": list_of(_TIME.json_schema, MAX_MOTION_NUMBERS),
            "values": either(_LISTS, list_of(_LISTS, MAX_DOF)),
        }
    ),
)
"""The JSON schema of what :func:`motion` accepts."""


def motion(value: object, dof: int, folder: Path) -> Motion:
    """The motion that a session file states.

    Args:
        value: a file and optionally a device, or times and values.
        dof: number of axes of the device that repeats the motion.
        folder: the folder of the session file.

    Raises:
        PydanticCustomError: the value is no motion, or its file cannot be used.
    """
    match value:
        case Motion():
            return value
        case Mapping() if "file" in value and value.keys() <= {"file", "device", OWN_NAME}:
            return _read(value["file"], value.get("device"), str(value.get(OWN_NAME, "")), dof, folder)
        case Mapping() if value.keys() == {"times", "values"}:
            return _from_lists(value["times"], value["values"], dof)
        case Mapping():
            raise refuse(f"a mapping with {listed(str(key) for key in value if key != OWN_NAME)}", _FORM)
        case _:
            raise refuse(show(value), f"a recorded motion: {_FORM}")


def _from_lists(times: object, values: object, dof: int) -> Motion:
    if not isinstance(times, list | tuple):
        raise refuse(show(times), "a list of times in s", ("times",))
    flat = isinstance(values, list | tuple) and not any(isinstance(axis, list | tuple) for axis in values)
    by_axis = [values] if flat else values
    if not isinstance(by_axis, list | tuple) or len(by_axis) != dof:
        expected = "a list of positions in m" if dof == 1 else f"{dof} lists of positions in m, one for each axis"
        raise refuse(show(values), expected, ("values",))
    for axis in by_axis:
        if not isinstance(axis, list | tuple) or len(axis) != len(times):
            raise refuse(show(axis), f"a list of {len(times)} positions in m, one at each time", ("values",))
    positions = [_number_list(_POSITION, axis, "values") for axis in by_axis]
    return _checked(_number_list(_TIME, times, "times"), positions, "the trace")


def _number_list(of: Quantity, entries: Sequence[object], key: str) -> tuple[float, ...]:
    """The numbers of a list; the error for the first wrong entry names its position."""
    numbers = []
    for index, entry in enumerate(entries):
        try:
            numbers.append(of(entry))
        except PydanticCustomError as error:
            raise refusal(*(problem._replace(at=(key, index)) for problem in problems_of(error))) from None
    return tuple(numbers)


def _checked(times: Sequence[float], values: Sequence[Sequence[float]], name: str) -> Motion:
    try:
        for axis in values:
            SampledSignal(times, axis)
    except IntentError as error:
        raise refuse(f"{name}: {error}", "samples with t in s increasing from 0, and finite positions in m") from None
    return Motion(times=tuple(times), values=tuple(map(tuple, values)))


def _read(file: object, device: object, own_name: str, dof: int, folder: Path) -> Motion:
    if not isinstance(file, str) or Path(file).suffix not in (".mcap", ".npz", ".csv"):
        raise refuse(show(file), f"{_FILES}, relative to the session file", ("file",))
    if device is not None and (not isinstance(device, str) or not device):
        raise refuse(show(device), "the name of a device of the recording", ("device",))
    name = f"the trace {show(file)}"
    try:
        table = _table(folder / file)
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or str(error)
        raise refuse(f"{name}, {why[:1].lower() + why[1:]}", _FILES, ("file",)) from None
    x = _motion_columns(table, device, own_name, dof, name)
    there = np.flatnonzero(~np.isnan(x).all(axis=1))
    x = x[: there[-1] + 1 if there.size else 0]  # a device that ended before the others keeps its last position
    if x.shape[0] * (1 + dof) > MAX_MOTION_NUMBERS:
        raise refuse(f"{name}, of {x.shape[0]} samples", f"at most {MAX_MOTION_NUMBERS // (1 + dof)}", ("file",))
    missing = np.flatnonzero(~np.isfinite(x).all(axis=1))
    if missing.size:
        where = "sample" if table.ports is None else "tick"
        raise refuse(
            f"{name}, without a position at {where} {missing[0]}", f"one at every {where}, from 0 on", ("file",)
        )
    return _checked(table.times[: x.shape[0]].tolist(), x.T.tolist(), name)


def _motion_columns(table: Table, device: object, own_name: str, dof: int, name: str) -> Array:
    """The columns of a device's axes, or those of a table without devices."""
    if table.ports is None:
        if device is not None:
            raise refuse(f"{name}, a table that names no devices", "no device, or a recording", ("device",))
        if table.x.shape[1] != dof:
            raise refuse(f"{name}, of {table.x.shape[1]} columns besides t", f"{dof}, one for each axis", ("file",))
        return table.x
    wanted = own_name if device is None else str(device)
    owners = [port.partition(".")[0] for port in table.ports]
    columns = [index for index, owner in enumerate(owners) if owner == wanted]
    if not columns:
        named = "" if device is not None else ", the device's own name"
        expected = f"device: {one_of(dict.fromkeys(owners), wanted)}"
        raise refuse(f"{name}, without a device {wanted!r}{named}", expected, ("device",))
    if len(columns) != dof:
        raise refuse(f"{name}, whose {wanted!r} has {len(columns)} axes", f"{dof}, as many as this device", ("device",))
    return table.x[:, columns]


def _table(path: Path) -> Table:
    """The table in a recording or a table file.

    Raises:
        OSError, ValueError: the file cannot be read, or holds neither.
    """
    if path.suffix == ".mcap":
        # imported here: only a session with a recorded motion needs the readers of recordings
        from manyhands.launch.recordings.recording import RecordingError
        from manyhands.launch.recordings.tables import read_recording

        try:
            recording = read_recording(path)
        except RecordingError as error:
            raise ValueError(f"which is no recording ({error})") from error
        return Table(recording.time, recording.x, recording.ports)
    return table_of(path)


def motion_of(value: object, dof: int, context: Mapping[str, Any] | None) -> Motion | None:
    """As :func:`motion`, for a value that may be absent; ``context`` is pydantic's, with the file's ``folder``."""
    return None if value is None else motion(value, dof, (context or {}).get("folder", Path()))


@functools.lru_cache(maxsize=256)  # many hands have the same intention
def require_formula(text: str) -> None:
    """Refuse a formula that is not allowed, or that fails at a time within the first PROBE_SECONDS."""
    try:
        formula = Formula(text)
        for k in range(PROBE_COUNT + 1):
            formula(PROBE_SECONDS * k / PROBE_COUNT)
    except FormulaError as error:
        if error.position is None:
            raise refuse(f"{error.problem} in the formula {show(text)}", "a finite value at every time") from None
        raise refuse(f"{error.problem} at position {error.position} in the formula {show(text)}", ALLOWED) from None
