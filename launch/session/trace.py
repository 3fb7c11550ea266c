"""Recorded traces: CSV files of two columns, ``t`` (s) and the value, read under a bound on rows and bytes."""

import io
from pathlib import Path
from typing import Final

from pydantic_core import PydanticCustomError

from manyhands.design.files import open_regular
from manyhands.launch.session.error import show
from manyhands.launch.session.fields import SessionModel, refuse
from manyhands.launch.session.limits import MAX_TRACE_BYTES, MAX_TRACE_LINE, MAX_TRACE_ROWS
from manyhands.nodes.device.intent import IntentError, Trace

_ROW: Final = "rows of two numbers, 't,value', with t in s increasing from 0"


class TraceData(SessionModel):
    """A recorded trace as numbers: ``times`` (s) and the ``values`` at them (N or m)."""

    times: tuple[float, ...]
    values: tuple[float, ...]


def trace_from_numbers(times: tuple[float, ...], values: tuple[float, ...], name: str) -> TraceData:
    """The trace of these numbers; ``name`` is how errors call it.

    Raises:
        PydanticCustomError: the numbers are no trace.
    """
    try:
        Trace(times, values)
    except IntentError as error:
        raise refuse(f"{name}: {error}", _ROW) from None
    return TraceData(times=times, values=values)


def read_trace(file: object, folder: Path) -> TraceData:
    """Read a trace; its path is relative to ``folder``, where the session file stands.

    Raises:
        PydanticCustomError: the file cannot be read or holds something else than a trace.

    """
    if not isinstance(file, str) or not file:
        raise refuse(show(file), "the name of a CSV file, relative to the session file")
    name = f"the trace {show(file)}"
    try:
        times, values = _columns(folder / file, name)
    except PydanticCustomError:
        raise  # a refusal of a line is a ValueError too, but not one of opening the file
    except UnicodeDecodeError:
        raise refuse(f"{name}, which is not UTF-8 text", _ROW) from None
    except (OSError, ValueError) as error:  # ValueError: a path with a zero byte in it
        reason = getattr(error, "strerror", None) or str(error)
        raise refuse(f"{name}, {reason.lower()}", "a CSV file that can be read, relative to the session file") from None
    return trace_from_numbers(times, values, name)


def _columns(path: Path, name: str) -> tuple[tuple[float, ...], tuple[float, ...]]:
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
                    pass  # a blank line, as editors leave one at the end
                case _:
                    raise refuse(f"{name}, line {number}: no two numbers", _ROW)  # what there is may be a secret
    return tuple(times), tuple(values)


def _number(cell: str) -> float | None:
    try:
        return float(cell)
    except ValueError:
        return None
