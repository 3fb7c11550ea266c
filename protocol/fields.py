"""The fields of a message: how each becomes plain MessagePack data, and the checks on the way back.

A reader accepts exactly the type it expects (a bool is not an int, an int is not a float) within the bounds
of :mod:`manyhands.protocol.limits`, and raises :class:`Unfit` otherwise, which the codec turns into a value.
"""

import math
from collections.abc import Callable, Mapping
from enum import StrEnum
from typing import Any, Final, NamedTuple

import numpy as np

from manyhands.protocol.limits import (
    MAX_COUNT,
    MAX_ENDPOINT,
    MAX_ENTRIES,
    MAX_NAME,
    MAX_PID,
    MAX_PORTS,
    MAX_RUNG,
    MAX_SENTENCES,
    MAX_TEXT,
    MAX_TRACE_SIDE,
)
from manyhands.protocol.messages import RefusalCode, Role, Values, is_presentable

_WIRE_FLOAT: Final = np.dtype("<f8")


class Unfit(Exception):
    """What was found in a field, and what would be right. Stays within the codec."""


class NotFinite(Unfit):
    """A number that must be finite is not."""


class Field(NamedTuple):
    """One field: ``pack`` makes plain data of a value, ``read`` a value of plain data or raises ``Unfit``."""

    pack: Callable[[Any], object]
    read: Callable[[object], Any]


def _describe(value: object) -> str:
    """A value from outside, short and printable enough to be shown."""
    if isinstance(value, (str, bytes, list, dict, tuple)) and len(value) > 40:
        return f"{type(value).__name__} of length {len(value)}"
    return f"{value!r:.120}"


# --- numbers


def _plain_integer(value: object) -> object:
    return int(value) if isinstance(value, np.integer) else value


def _plain_number(value: object) -> object:
    if isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool):
        return float(value)
    return value


def integer(low: int, high: int) -> Field:
    """An int of ``low`` to ``high``."""

    def read(value: object) -> int:
        if type(value) is not int or not low <= value <= high:
            raise Unfit(f"found {_describe(value)}; expected an integer from {low} to {high}")
        return value

    return Field(_plain_integer, read)


def _read_number(value: object) -> float:
    if type(value) is not float:
        raise Unfit(f"found {_describe(value)}; expected a float")
    return value


def _read_finite(value: object) -> float:
    number = _read_number(value)
    if not math.isfinite(number):
        raise NotFinite(f"found {number}; expected a finite number")
    return number


# --- text


def _read_text(value: object) -> str:
    if type(value) is not str or len(value) > MAX_TEXT or not is_presentable(value):
        raise Unfit(f"found {_describe(value)}; expected printable text of at most {MAX_TEXT} characters")
    return value


def _word(limit: int) -> Callable[[object], str]:
    def read(value: object) -> str:
        if type(value) is not str or not 1 <= len(value) <= limit or not value.isprintable():
            raise Unfit(f"found {_describe(value)}; expected a printable name of 1 to {limit} characters")
        return value

    return read


_read_name = _word(MAX_NAME)


def _choice(kind: type[StrEnum]) -> Field:
    members = {str(member): member for member in kind}

    def read(value: object) -> StrEnum:
        if type(value) is not str or value not in members:
            raise Unfit(f"found {_describe(value)}; expected one of {', '.join(members)}")
        return members[value]

    return Field(lambda value: str(value) if isinstance(value, StrEnum) else value, read)


# --- collections


def _mapping(pack: Callable[[Any], object], read: Callable[[object], Any]) -> Field:
    def pack_all(value: Mapping[str, Any]) -> object:
        return {key: pack(item) for key, item in value.items()}

    def read_all(value: object) -> dict[str, Any]:
        if type(value) is not dict or len(value) > MAX_ENTRIES:
            raise Unfit(f"found {_describe(value)}; expected a map of at most {MAX_ENTRIES} entries")
        return {_read_name(key): read(item) for key, item in value.items()}

    return Field(pack_all, read_all)


def _read_ports(value: object) -> tuple[str, ...]:
    if type(value) is not list or not 1 <= len(value) <= MAX_PORTS:
        raise Unfit(f"found {_describe(value)}; expected an array of 1 to {MAX_PORTS} ports")
    ports = tuple(_read_name(port) for port in value)
    if len(set(ports)) != len(ports):
        raise Unfit(f"found {_describe(list(ports))}; expected every port once")
    return ports


def _pack_tuple(value: Any) -> object:
    return list(value) if isinstance(value, tuple) else value


def _list_of(what: str, most: int, read: Callable[[object], str]) -> Field:
    def read_all(value: object) -> tuple[str, ...]:
        if type(value) is not list or len(value) > most:
            raise Unfit(f"found {_describe(value)}; expected an array of at most {most} {what}")
        return tuple(read(item) for item in value)

    return Field(_pack_tuple, read_all)


def _pack_feedthrough(value: Any) -> object:
    return None if value is None else [[_plain_number(entry) for entry in row] for row in value]


def _read_feedthrough(value: object) -> tuple[tuple[float, ...], ...] | None:
    """Rows of finite floats; whether they fit the ports is for the handshake, which can say so clearly."""
    if value is None:
        return None
    if type(value) is not list or len(value) > MAX_PORTS:
        raise Unfit(f"found {_describe(value)}; expected nil or at most {MAX_PORTS} rows")
    for row in value:
        if type(row) is not list or len(row) > MAX_PORTS:
            raise Unfit(f"found {_describe(row)}; expected a row of at most {MAX_PORTS} numbers")
    return tuple(tuple(_read_finite(entry) for entry in row) for row in value)


# --- arrays


def _doubles(data: bytes) -> Values:
    return np.frombuffer(data, dtype=_WIRE_FLOAT)


def pack_values(values: Any) -> bytes:
    """The values of a signal as little-endian float64.

    Raises:
        Unfit: if they are anything else than 1 to ``MAX_PORTS`` finite float64 in a row.
    """
    if not isinstance(values, np.ndarray) or values.dtype != np.float64 or values.ndim != 1:
        raise Unfit(f"found {values!r:.80}; expected a 1-D array of float64")
    data = values.astype(_WIRE_FLOAT, copy=False).tobytes()
    read_values(data)
    return data


def read_values(data: object) -> Values:
    """The values of a signal, read only.

    Raises:
        Unfit: if the data is not 8 bytes each for 1 to ``MAX_PORTS`` values; :class:`NotFinite` if one is
        not finite.
    """
    if type(data) is not bytes or len(data) % 8 or not 8 <= len(data) <= 8 * MAX_PORTS:
        raise Unfit(f"found {_describe(data)}; expected 8 bytes each for 1 to {MAX_PORTS} values")
    values = _doubles(data)
    # for a few ports six times as fast as numpy's own isfinite().all()
    if not all(map(math.isfinite, values.tolist())):
        raise NotFinite("found a value that is not finite; expected finite values")
    return values


def _pack_trace(value: Any) -> object:
    if not isinstance(value, np.ndarray) or value.dtype != np.float64 or value.ndim != 2:
        raise Unfit(f"found {value!r:.80}; expected a 2-D array of float64")
    return [*value.shape, value.astype(_WIRE_FLOAT, copy=False).tobytes()]


def _read_trace(value: object) -> Values:
    if type(value) is not list or len(value) != 3:
        raise Unfit(f"found {_describe(value)}; expected [rows, columns, bytes]")
    rows, columns, data = value
    for side in (rows, columns):
        if type(side) is not int or not 0 <= side <= MAX_TRACE_SIDE:
            raise Unfit(f"found {_describe(side)} rows or columns; expected 0 to {MAX_TRACE_SIDE}")
    if type(data) is not bytes or len(data) != 8 * rows * columns:
        raise Unfit(f"found {_describe(data)}; expected {8 * rows * columns} bytes ({rows} x {columns})")
    return _doubles(data).reshape(rows, columns)


def _same(value: object) -> object:
    return value


NAME: Final = Field(_same, _read_name)
TEXT: Final = Field(_same, _read_text)
ROLE: Final = _choice(Role)
REFUSAL_CODE: Final = _choice(RefusalCode)
COUNT: Final = integer(0, MAX_COUNT)
PID: Final = integer(1, MAX_PID)
PORTS: Final = Field(_pack_tuple, _read_ports)
FEEDTHROUGH: Final = Field(_pack_feedthrough, _read_feedthrough)
ENDPOINT: Final = Field(_same, _word(MAX_ENDPOINT))
ENDPOINTS: Final = _mapping(_same, ENDPOINT.read)
NAMES: Final = _list_of("names", MAX_ENTRIES, _read_name)
SENTENCES: Final = _list_of("sentences", MAX_SENTENCES, _read_text)
STATES: Final = _mapping(_same, _read_name)
ELAPSED: Final = Field(_plain_number, _read_finite)
RUNG: Final = integer(0, MAX_RUNG)
VALUES: Final = Field(pack_values, read_values)
FIGURES: Final = _mapping(_plain_number, _read_number)
COUNTS: Final = _mapping(_plain_integer, integer(0, MAX_COUNT).read)
PERCENTILES: Final = _mapping(FIGURES.pack, FIGURES.read)
TRACES: Final = _mapping(_pack_trace, _read_trace)
