"""Messages to frames and back, in MessagePack.

A frame is one MessagePack array, ``[type id, field, ...]``. Incoming bytes are never trusted and never raise:
:func:`decode` returns a message, or a :class:`Malformed` with the reason. :func:`encode` reads an outgoing message back
through the same checks before it leaves, so the two sides cannot disagree about what is allowed.

**Fields.** The :class:`.PlainForm` of a field turns a value into plain MessagePack data, and checks plain data on the
way back. It accepts exactly the type that it expects (a bool is not an int, an int is not a float) within the bounds of
:mod:`manyhands.protocol.limits`. It raises :class:`.Unfit` otherwise, which :func:`decode` turns into a value.

**Signals** take a direct path in both directions, for a tick consists of them. Their first 23 bytes have a fixed
layout, :data:`USUAL`, which is still plain MessagePack. A frame that a different encoder wrote with shorter integers
takes the general path. So do waves: their fixed layout is

    array of 4 | type id | tick, uint 64 | length of the sums, bin 16 | sums | shipped, float 64

**Buttons.** Samples, tools and waves end with the state of the buttons where any is held down: the array has one entry
more, and the frame :data:`BUTTONS_TAIL` at its end, with the same layout before it.

**Heads.** The head of a signal's frame is everything before its values:

    array of 4 | type id | tick | stamp | length of the values | values

A gate that waits for one signal decides by the head alone. So a refusal costs little, and the same whatever follows the
head. :func:`read_head` reads every encoding that MessagePack has for this array. It agrees with :func:`decode` on what
a signal is (a test compares them).
"""

import dataclasses
import math
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Final, NamedTuple, TypeAlias

import msgpack
import numpy as np

from manyhands.protocol.limits import (
    MAX_BUTTONS,
    MAX_BY_ITSELF,
    MAX_CONTAINERS,
    MAX_CONTROL_BYTES,
    MAX_COUNT,
    MAX_ENDPOINT,
    MAX_ENTRIES,
    MAX_NAME,
    MAX_PART_BYTES,
    MAX_PID,
    MAX_PIECE_BYTES,
    MAX_PORTS,
    MAX_ROUND_TRIP,
    MAX_RUNG,
    MAX_SENTENCE,
    MAX_SENTENCES,
    MAX_TEXT,
    MAX_TRACE_SIDE,
    MAX_VERSION,
)
from manyhands.protocol.messages import (
    PROTOCOL_VERSION,
    Absent,
    Condition,
    Connect,
    Echo,
    Fault,
    Fetch,
    Figures,
    Force,
    Grasp,
    LinkHello,
    Message,
    NodeHello,
    Observation,
    Offer,
    PathKey,
    Piece,
    Probe,
    PromiseStatus,
    Reaction,
    Ready,
    Refusal,
    RefusalCode,
    Release,
    Report,
    Return,
    Role,
    Rung,
    Sample,
    Shift,
    Signal,
    SignalMessage,
    Start,
    Stop,
    Telemetry,
    Tool,
    Values,
    Wave,
    Welcome,
    is_presentable,
)
from manyhands.protocol.plain import NotFinite, PlainForm, Unfit, form_of, optional, same, shown

_WIRE_FLOAT: Final = np.dtype("<f8")

CONNECTION_BYTES: Final = 8
"""The length of the id of a datagram path, bytes."""

SECRET_BYTES: Final = 32
"""The length of the key of a datagram path, bytes."""


# --- numbers


def _plain_integer(value: object) -> object:
    return int(value) if isinstance(value, np.integer) else value


def _plain_number(value: object) -> object:
    if isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool):
        return float(value)
    return value


def integer(low: int, high: int) -> PlainForm:
    """A field of an int from ``low`` to ``high``."""

    def read(value: object) -> int:
        if type(value) is not int or not low <= value <= high:
            raise Unfit(f"found {shown(value)}; expected an integer from {low} to {high}")
        return value

    return PlainForm(_plain_integer, read)


def _read_number(value: object) -> float:
    if type(value) is not float:
        raise Unfit(f"found {shown(value)}; expected a float")
    return value


def _read_finite(value: object) -> float:
    number = _read_number(value)
    if not math.isfinite(number):
        raise NotFinite(f"found {number}; expected a finite number")
    return number


FINITE: Final = PlainForm(_plain_number, _read_finite)


def _read_round_trip(value: object) -> float:
    number = _read_finite(value)
    if not 0.0 < number <= MAX_ROUND_TRIP:
        raise Unfit(f"found {number}; expected a round trip above 0 s, and at most {MAX_ROUND_TRIP} s")
    return number


ROUND_TRIP: Final = optional(PlainForm(_plain_number, _read_round_trip))


# --- text


def _read_text(value: object) -> str:
    if type(value) is not str or len(value) > MAX_TEXT or not is_presentable(value):
        raise Unfit(f"found {shown(value)}; expected printable text of at most {MAX_TEXT} characters")
    return value


def _word(limit: int) -> PlainForm:
    def read(value: object) -> str:
        if type(value) is not str or not 1 <= len(value) <= limit or not value.isprintable():
            raise Unfit(f"found {shown(value)}; expected a printable name of 1 to {limit} characters")
        return value

    return PlainForm(same, read)


NAME: Final = _word(MAX_NAME)
TEXT: Final = PlainForm(same, _read_text)


# --- collections


def _mapping(of: PlainForm) -> PlainForm:
    def pack_all(value: Mapping[str, Any]) -> object:
        return {key: of.write(item) for key, item in value.items()}

    def read_all(value: object) -> dict[str, Any]:
        if type(value) is not dict or len(value) > MAX_ENTRIES:
            raise Unfit(f"found {shown(value)}; expected a map of at most {MAX_ENTRIES} entries")
        return {NAME.read(key): of.read(item) for key, item in value.items()}

    return PlainForm(pack_all, read_all)


def _pack_numbers(value: Mapping[str, Any]) -> object:
    plain = dict(value)
    return plain if _are_floats(plain) else {key: _plain_number(item) for key, item in plain.items()}


def _read_numbers(value: object) -> dict[str, float]:
    """Numbers by name; all of them are looked at together, for one by one 400 of them take 0.2 ms of a tick."""
    if type(value) is dict and len(value) <= MAX_ENTRIES and _are_names(value) and _are_floats(value):
        numbers: dict[str, float] = value
        return numbers
    refused: dict[str, float] = _each_number(value)  # raises, and describes the first that does not fit
    return refused


def _pack_figures(value: Any) -> object:
    if not isinstance(value, Figures):
        raise Unfit(f"found {shown(value)}; expected figures")
    return [_pack_numbers(value), TABLES.write(value.tables)]


def _read_figures(value: object) -> Figures:
    if type(value) is not list or len(value) != 2:
        raise Unfit(f"found {shown(value)}; expected [numbers, tables]")
    numbers, tables = value
    return Figures(_read_numbers(numbers), TABLES.read(tables))


def _are_floats(value: Mapping[Any, object]) -> bool:
    return {*map(type, value.values())} <= _FLOAT_ALONE


def _are_names(value: Mapping[Any, object]) -> bool:
    if not {*map(type, value)} <= _STR_ALONE:
        return False
    return "" not in value and max(map(len, value), default=1) <= MAX_NAME and "".join(value).isprintable()


_FLOAT_ALONE: Final = {float}
_STR_ALONE: Final = {str}
_each_number: Final = _mapping(PlainForm(_plain_number, _read_number)).read


def _read_ports(value: object) -> tuple[str, ...]:
    if type(value) is not list or not 1 <= len(value) <= MAX_PORTS:
        raise Unfit(f"found {shown(value)}; expected an array of 1 to {MAX_PORTS} ports")
    ports = tuple(NAME.read(port) for port in value)
    if len(set(ports)) != len(ports):
        raise Unfit(f"found {shown(list(ports))}; expected every port once")
    return ports


def _pack_tuple(value: Any) -> object:
    return list(value) if isinstance(value, tuple) else value


def _list_of(what: str, most: int, of: PlainForm) -> PlainForm:
    def pack_all(value: Any) -> object:
        return [of.write(item) for item in value] if isinstance(value, tuple) else value

    def read_all(value: object) -> tuple[Any, ...]:
        if type(value) is not list or len(value) > most:
            raise Unfit(f"found {shown(value)}; expected an array of at most {most} {what}")
        return tuple(of.read(item) for item in value)

    return PlainForm(pack_all, read_all)


def _record(kind: type[Any], *forms: PlainForm) -> PlainForm:
    """A data class as the array of its fields."""
    names = tuple(field.name for field in dataclasses.fields(kind))

    def pack(value: Any) -> object:
        if not isinstance(value, kind):
            raise Unfit(f"found {shown(value)}; expected a {kind.__name__}")
        return [form.write(getattr(value, name)) for name, form in zip(names, forms, strict=True)]

    def read(value: object) -> Any:
        if type(value) is not list or len(value) != len(names):
            raise Unfit(f"found {shown(value)}; expected [{', '.join(names)}]")
        return kind(*(form.read(item) for form, item in zip(forms, value, strict=True)))

    return PlainForm(pack, read)


# --- arrays


def all_finite(values: Sequence[float]) -> bool:
    """Whether no value is infinite or not a number; for a few values six times as fast as numpy's isfinite().all()."""
    for value in values:  # noqa: SIM110 -- a generator would cost three times as much
        if not -math.inf < value < math.inf:
            return False
    return True


def _doubles(data: bytes) -> Values:
    return np.frombuffer(data, dtype=_WIRE_FLOAT)


def pack_values(values: Any) -> bytes:
    """The values of a signal as little-endian float64.

    Raises:
        Unfit: the values are not a 1-D array of 1 to ``MAX_PORTS`` finite float64.
    """
    if not isinstance(values, np.ndarray) or values.dtype != np.float64 or values.ndim != 1:
        raise Unfit(f"found {values!r:.80}; expected a 1-D array of float64")
    data = values.astype(_WIRE_FLOAT, copy=False).tobytes()
    read_values(data)
    return data


def read_values(data: object) -> Values:
    """The values of a signal, as a read-only array.

    Raises:
        Unfit: the data are not 8 bytes for each of 1 to ``MAX_PORTS`` values.
        NotFinite: a value is infinite or not a number.
    """
    if type(data) is not bytes or len(data) % 8 or not 8 <= len(data) <= 8 * MAX_PORTS:
        raise Unfit(f"found {shown(data)}; expected 8 bytes each for 1 to {MAX_PORTS} values")
    values = _doubles(data)
    if not all_finite(values.tolist()):
        raise NotFinite("found a value that is not finite; expected finite values")
    return values


def _pack_sums(value: Any) -> object:
    if type(value) is not tuple or not all(type(entry) is float for entry in value):
        raise Unfit(f"found {value!r:.80}; expected a tuple of floats")
    return struct.pack(f"<{len(value)}d", *value)


def _read_sums(value: object) -> tuple[float, ...]:
    return tuple(read_values(value).tolist())


def _raw(least: int, most: int) -> PlainForm:
    """A field of so many bytes, which no message quotes: they may be secret."""
    expected = f"{most} bytes" if least == most else f"{least} to {most} bytes"

    def read(value: object) -> bytes:
        if type(value) is not bytes or not least <= len(value) <= most:
            found = f"{len(value)} bytes" if isinstance(value, bytes) else type(value).__name__
            raise Unfit(f"found {found}; expected {expected}")
        return value

    return PlainForm(same, read)


def _pack_trace(value: Any) -> object:
    if not isinstance(value, np.ndarray) or value.dtype != np.float64 or value.ndim != 2:
        raise Unfit(f"found {value!r:.80}; expected a 2-D array of float64")
    return [*value.shape, value.astype(_WIRE_FLOAT, copy=False).tobytes()]


def _read_trace(value: object) -> Values:
    if type(value) is not list or len(value) != 3:
        raise Unfit(f"found {shown(value)}; expected [rows, columns, bytes]")
    rows, columns, data = value
    for side in (rows, columns):
        if type(side) is not int or not 0 <= side <= MAX_TRACE_SIDE:
            raise Unfit(f"found {shown(side)} rows or columns; expected 0 to {MAX_TRACE_SIDE}")
    if type(data) is not bytes or len(data) != 8 * rows * columns:
        raise Unfit(f"found {shown(data)}; expected {8 * rows * columns} bytes ({rows} x {columns})")
    return _doubles(data).reshape(rows, columns)


ROLE: Final = form_of(Role)
REFUSAL_CODE: Final = form_of(RefusalCode)
COUNT: Final = integer(0, MAX_COUNT)
PID: Final = integer(1, MAX_PID)
PORT_NUMBER: Final = integer(1, 65535)
PORTS: Final = PlainForm(_pack_tuple, _read_ports)
FEEDTHROUGH: Final = optional(_list_of("rows", MAX_PORTS, _list_of("numbers", MAX_PORTS, FINITE)))
"""The handshake checks that the rows fit the ports, and can name the ports in its refusal."""

ENDPOINT: Final = _word(MAX_ENDPOINT)
ENDPOINTS: Final = _mapping(ENDPOINT)
NAMES: Final = _list_of("names", MAX_ENTRIES, NAME)
SENTENCES: Final = _list_of("sentences", MAX_SENTENCES, TEXT)
BY_ITSELF: Final = _list_of("sentences", MAX_BY_ITSELF, _word(MAX_SENTENCE))
ALL_BY_ITSELF: Final = _mapping(_list_of("sentences", 2 * MAX_BY_ITSELF, _word(MAX_SENTENCE)))
STATES: Final = _mapping(NAME)
RUNG: Final = integer(0, MAX_RUNG)
BUTTONS: Final = integer(1, 2**MAX_BUTTONS - 1)
"""A field that is left out where its value is 0, so that a state has one form alone."""

VALUES: Final = PlainForm(pack_values, read_values)
SUMS: Final = PlainForm(_pack_sums, _read_sums)
CONNECTION: Final = _raw(CONNECTION_BYTES, CONNECTION_BYTES)
SECRET: Final = _raw(SECRET_BYTES, SECRET_BYTES)
PLACE: Final = integer(0, MAX_PART_BYTES - 1)
LENGTH: Final = integer(1, MAX_PART_BYTES)
PIECE: Final = _raw(1, MAX_PIECE_BYTES)
NUMBERS: Final = PlainForm(_pack_numbers, _read_numbers)
TABLES: Final = _mapping(NUMBERS)
FIGURES: Final = PlainForm(_pack_figures, _read_figures)
MOMENT: Final = optional(FINITE)
STATUS: Final = _record(PromiseStatus, NAME, NAME, NAMES, MOMENT, MOMENT, NUMBERS, TEXT)
PROMISES: Final = _list_of("promises", MAX_SENTENCES, STATUS)
TRACES: Final = _mapping(PlainForm(_pack_trace, _read_trace))


USUAL: Final = struct.Struct(">BBBQBQBH")
"""array of 4, type id, uint 64, tick, uint 64, stamp, bin 16, length; the constant bytes are MessagePack's own tags."""

BUTTONS_TAIL: Final = struct.Struct(">BI")
"""uint 32, buttons."""

ARRAY_OF_4: Final = 0x94
ARRAY_OF_5: Final = 0x95
UINT32: Final = 0xCE
UINT64: Final = 0xCF
BIN16: Final = 0xC5

LONGEST: Final = 5 + 3 * 9 + 5
"""The length of the longest head, bytes: array 32, three integers of 64 bits with their tags, bin 32."""

FLOAT64: Final = 0xCB

WAVE_HEAD: Final = struct.Struct(">BBBQBH")
"""array of 4, type id, uint 64, tick, bin 16, length of the sums; the constant bytes are MessagePack's own tags."""

WAVE_TAIL: Final = struct.Struct(">Bd")
"""float 64, shipped."""

_INTEGERS: Final = {
    tag: struct.Struct(form)
    for tag, form in {
        0xCC: ">B", 0xCD: ">H", 0xCE: ">I", 0xCF: ">Q", 0xD0: ">b", 0xD1: ">h", 0xD2: ">i", 0xD3: ">q"
    }.items()
}  # fmt: skip
_ARRAYS: Final = {0xDC: struct.Struct(">H"), 0xDD: struct.Struct(">I")}
_FLOATS: Final = {0xCA: struct.Struct(">f"), FLOAT64: struct.Struct(">d")}
_BINARIES: Final = {0xC4: struct.Struct(">B"), 0xC5: struct.Struct(">H"), 0xC6: struct.Struct(">I")}


class Head(NamedTuple):
    """The head of a signal's frame.

    Attributes:
        tick: k.
        stamp: when x(k) was sampled, ns.
        size: bytes of the head; the values follow, 8 bytes each.
        length: bytes of the values.
        buttons: those that are held down; 0 where the frame ends with the values.
    """

    tick: int
    stamp: int
    size: int
    length: int
    buttons: int = 0


def type_of(frame: bytes) -> int | None:
    """The type id of a frame of any message, without reading the rest; None if the frame begins differently."""
    try:
        _, number, _ = _start(frame)
    except (IndexError, KeyError, struct.error):
        return None
    return number


def type_and_next(frame: bytes) -> tuple[int, int] | None:
    """The type id of a frame and the integer after it; None if the frame begins differently."""
    try:
        entries, number, at = _start(frame)
        following, _ = _integer(frame, at)
    except (IndexError, KeyError, struct.error):
        return None
    return (number, following) if entries > 1 else None


def read_head(frame: bytes) -> Head | None:
    """The head of a signal of any type; None if this is no frame of a signal. Never raises."""
    try:
        entries, number, at = _start(frame)
        tick, at = _integer(frame, at)
        stamp, at = _integer(frame, at)
        length, at = _tagged(frame, at, _BINARIES)
        pressed = entries == 5 and number in _WITH_BUTTONS
        buttons, end = _integer(frame, at + length) if pressed else (0, at + length)
    except (IndexError, KeyError, struct.error):
        return None
    counts = 0 <= tick <= MAX_COUNT and 0 <= stamp <= MAX_COUNT
    whole = end == len(frame) and length % 8 == 0 and 8 <= length <= 8 * MAX_PORTS
    fits = (entries == 4 or pressed) and int(pressed) <= buttons < 2**MAX_BUTTONS
    return Head(tick, stamp, at, length, buttons) if fits and counts and whole else None


class RawWave(NamedTuple):
    """The fields of a wave's frame, of whose numbers none is checked but the tick.

    Attributes:
        tick: n, from 0 to ``MAX_COUNT``.
        sums: U, 8 bytes for each of 1 to ``MAX_PORTS`` entries.
        shipped: G.
        buttons: those that are held down.
    """

    tick: int
    sums: bytes
    shipped: float
    buttons: int = 0


def read_wave(frame: bytes) -> RawWave | None:
    """The fields of a wave in any encoding of MessagePack; None if this is no frame of a wave. Never raises."""
    try:
        entries, number, at = _start(frame)
        tick, at = _integer(frame, at)
        length, at = _tagged(frame, at, _BINARIES)
        end = at + length
        shipped, after = _tagged(frame, end, _FLOATS)
        pressed = entries == 5
        buttons, after = _integer(frame, after) if pressed else (0, after)
    except (IndexError, KeyError, struct.error):
        return None
    whole = after == len(frame) and length % 8 == 0 and 8 <= length <= 8 * MAX_PORTS
    fits = (entries == 4 or pressed) and int(pressed) <= buttons < 2**MAX_BUTTONS
    is_wave = fits and number == WAVE_ID and type(tick) is int and 0 <= tick <= MAX_COUNT
    return RawWave(int(tick), frame[at:end], float(shipped), buttons) if is_wave and whole else None


def _start(frame: bytes) -> tuple[int, int, int]:
    """The number of entries of the array, the type id, and the offset of the next entry."""
    first = frame[0]
    entries, at = (first & 0x0F, 1) if first & 0xF0 == 0x90 else _tagged(frame, 0, _ARRAYS)
    return entries, *_integer(frame, at)


def _integer(frame: bytes, at: int) -> tuple[int, int]:
    """The integer at the offset ``at``, and the offset of the next entry."""
    first = frame[at]
    return (first, at + 1) if first < 0x80 else _tagged(frame, at, _INTEGERS)


def _tagged(frame: bytes, at: int, forms: Mapping[int, struct.Struct]) -> tuple[Any, int]:
    """The number after the tag at the offset ``at``, an int or a float by the tag's form, and the offset after it."""
    form = forms[frame[at]]
    (number,) = form.unpack_from(frame, at + 1)
    return number, at + 1 + form.size


class Flaw(StrEnum):
    """The kind of a malformed frame's flaw."""

    SIZE = "size"  # longer than its limit
    SYNTAX = "syntax"  # not exactly one MessagePack array within the limits
    SHAPE = "shape"  # of no known type, or a field is missing, too many, of a wrong type or out of bounds
    NOT_FINITE = "not finite"  # well formed, but a value is infinite or not a number


@dataclass(frozen=True, slots=True)
class Malformed:
    """The result of :func:`decode` for a frame that is no message: the reason in words, and its kind."""

    reason: str
    flaw: Flaw = Flaw.SHAPE


@dataclass(frozen=True, slots=True)
class ForeignHello:
    """A hello of a different protocol version; the rest of its frame is not read."""

    version: int


Received: TypeAlias = Message | ForeignHello | Malformed
"""A result of :func:`decode`."""

_HELLOS: Final[dict[int, type[Message]]] = {1: LinkHello, 2: NodeHello}
_SIGNALS: Final[dict[int, type[SignalMessage]]] = {
    16: Sample,
    17: Tool,
    18: Reaction,
    19: Force,
}
WAVE_ID: Final = 20
_SIGNAL_IDS: Final[dict[type[Signal], int]] = {kind: number for number, kind in _SIGNALS.items()}
_WITH_BUTTONS: Final = {_SIGNAL_IDS[Sample], _SIGNAL_IDS[Tool]}


_Layout: TypeAlias = tuple[int, tuple[PlainForm, ...]]

# type id and fields, in the order in which the dataclass declares them; an id is never used for a second type
_HELLO_START: Final = (integer(0, MAX_VERSION), NAME, NAME, NAME, ROLE)
LAYOUTS: Final[dict[type[Message], _Layout]] = {
    LinkHello: (1, (*_HELLO_START, PORTS, FEEDTHROUGH)),
    NodeHello: (2, (*_HELLO_START, PID, ENDPOINTS)),
    Welcome: (3, ()),
    Refusal: (4, (REFUSAL_CODE, TEXT)),
    Connect: (5, (ENDPOINTS,)),
    Ready: (6, (BY_ITSELF,)),
    Start: (7, (COUNT, COUNT, COUNT)),
    Stop: (8, (TEXT,)),
    Probe: (9, (COUNT,)),
    Echo: (10, (COUNT, COUNT, COUNT, ROUND_TRIP)),
    Absent: (11, (NAME,)),
    Offer: (12, (NAME, ENDPOINT)),
    Return: (13, (NAME, ENDPOINT)),
    Shift: (14, (NAME, RUNG)),
    Rung: (15, (RUNG,)),
    **{
        kind: (number, (COUNT, COUNT, VALUES, *([BUTTONS] if number in _WITH_BUTTONS else [])))
        for number, kind in _SIGNALS.items()
    },
    Wave: (WAVE_ID, (COUNT, SUMS, FINITE, BUTTONS)),
    PathKey: (21, (CONNECTION, SECRET, PORT_NUMBER)),
    Fetch: (22, (PLACE,)),
    Piece: (23, (PLACE, LENGTH, PIECE)),
    Telemetry: (32, (COUNT, FIGURES, TRACES)),
    Report: (33, (COUNT, FIGURES)),
    Fault: (34, (TEXT, form_of(bool))),
    Observation: (35, (NAME, COUNT, FIGURES, TRACES)),
    Condition: (36, (NAME, FINITE, STATES, NAMES, *[SENTENCES] * 3, PROMISES, ALL_BY_ITSELF, SENTENCES)),
    Grasp: (37, (VALUES,)),
    Release: (38, ()),
}
_KINDS: Final = {number: kind for kind, (number, _) in LAYOUTS.items()}
_FIELD_NAMES: Final = {kind: tuple(f.name for f in dataclasses.fields(kind)) for kind in LAYOUTS}


def encode(message: Message) -> bytes:
    """The frame of a message.

    Raises:
        ValueError: the protocol does not allow the value of a field, which the message names.
    """
    if isinstance(message, Signal) and (number := _SIGNAL_IDS.get(type(message))) is not None:
        tick, stamp, values = message.tick, message.stamp, message.values
        # all checks of the fields in one condition; a signal that does not fit is refused below, with the reason
        if (
            type(tick) is type(stamp) is int
            and 0 <= tick <= MAX_COUNT
            and 0 <= stamp <= MAX_COUNT
            and type(values) is np.ndarray
            and values.dtype == _WIRE_FLOAT
            and values.ndim == 1
            and 1 <= len(values) <= MAX_PORTS
            and all(map(math.isfinite, values.tolist()))
            and getattr(message, "buttons", 0) == 0
        ):
            return USUAL.pack(ARRAY_OF_4, number, UINT64, tick, UINT64, stamp, BIN16, values.nbytes) + values.tobytes()
    if type(message) is Wave:
        _encode_any(message)  # refuses a field that is not allowed, and names it
        return WaveWriter(len(message.sums)).frame(message.tick, message.sums, message.shipped, message.buttons)
    if isinstance(message, Sample | Tool):
        _encode_any(message)
        writer = SignalWriter(type(message), len(message.values))
        return writer.frame(message.tick, message.stamp, message.values.tolist(), message.buttons)
    return _encode_any(message)


class SignalWriter:
    """Makes the frames of the signals that one end of a link sends tick after tick, without a message for each.

    Attributes:
        kind: the type of the signals.
    """

    __slots__ = ("_length", "_number", "_values", "_width", "kind")

    def __init__(self, kind: type[SignalMessage], width: int) -> None:
        """Make frames of ``kind`` with ``width`` values, one for each port of the link."""
        self.kind = kind
        self._number, self._width = _SIGNAL_IDS[kind], width
        self._values = struct.Struct(f"<{width}d")
        self._length = self._values.size

    def frame(self, tick: int, stamp: int, values: Sequence[float], buttons: int = 0) -> bytes:
        """The frame that :func:`encode` makes of the same signal; ``buttons`` are of a Sample or a Tool.

        Raises:
            ValueError: as :func:`encode`.
        """
        if (
            0 <= tick <= MAX_COUNT
            and 0 <= stamp <= MAX_COUNT
            and 1 <= len(values) == self._width <= MAX_PORTS
            and all_finite(values)
        ):
            if not buttons:
                head = USUAL.pack(ARRAY_OF_4, self._number, UINT64, tick, UINT64, stamp, BIN16, self._length)
                return head + self._values.pack(*values)
            if self._number in _WITH_BUTTONS and 0 < buttons < 2**MAX_BUTTONS:
                head = USUAL.pack(ARRAY_OF_5, self._number, UINT64, tick, UINT64, stamp, BIN16, self._length)
                return head + self._values.pack(*values) + BUTTONS_TAIL.pack(UINT32, buttons)
        array = np.array(values, dtype=np.float64)
        if self.kind is Sample or self.kind is Tool:
            return encode(self.kind(tick, stamp, array, buttons))  # raises, and names the field
        return encode(self.kind(tick, stamp, array))


class WaveWriter:
    """Makes the frames of the waves that one end of a wave link sends, without a message for each."""

    __slots__ = ("_layout", "_length", "_values", "_width")

    def __init__(self, width: int) -> None:
        """Make frames with ``width`` sums, one for each port of the link."""
        self._width = width
        self._values = struct.Struct(f"<{width}d")
        self._length = self._values.size
        self._layout = struct.Struct(f"{WAVE_HEAD.format}{self._length}s{WAVE_TAIL.format[1:]}")

    def frame(self, tick: int, sums: Sequence[float], shipped: float, buttons: int = 0) -> bytes:
        """The frame of a wave, as :func:`encode` makes it.

        Raises:
            ValueError: a field is not as :class:`~manyhands.protocol.messages.Wave` states it.
        """
        if (
            type(tick) is int
            and 0 <= tick <= MAX_COUNT
            and 1 <= len(sums) == self._width <= MAX_PORTS
            and all(map(math.isfinite, sums))
            and math.isfinite(shipped)
            and 0 <= buttons < 2**MAX_BUTTONS
        ):
            values, entries = self._values.pack(*sums), ARRAY_OF_5 if buttons else ARRAY_OF_4
            wave = self._layout.pack(entries, WAVE_ID, UINT64, tick, BIN16, self._length, values, FLOAT64, shipped)
            return wave + BUTTONS_TAIL.pack(UINT32, buttons) if buttons else wave
        if len(sums) != self._width:
            raise ValueError(f"Wave.sums: found {len(sums)} sums; expected {self._width}")
        return _encode_any(Wave(tick, tuple(map(float, sums)), shipped, buttons))  # raises, and names the field


def decode(frame: bytes, limit: int) -> Received:
    """Read a frame of at most ``limit`` bytes. Never raises, whatever the bytes.

    Returns:
        A message; a :class:`ForeignHello` for a hello of a different protocol version, whatever follows the version;
        or a :class:`Malformed`.
    """
    if len(frame) > limit:
        return Malformed(f"found {len(frame)} bytes; expected at most {limit}", Flaw.SIZE)
    if len(frame) >= USUAL.size and frame[0] == ARRAY_OF_4:
        _, number, tick_tag, tick, stamp_tag, stamp, values_tag, length = USUAL.unpack_from(frame)
        if (
            number in _SIGNALS
            and tick_tag == stamp_tag == UINT64
            and values_tag == BIN16
            and length == len(frame) - USUAL.size
        ):
            try:
                return _SIGNALS[number](
                    COUNT.read(tick),
                    COUNT.read(stamp),
                    read_values(frame[USUAL.size :]),
                )
            except Unfit:
                return _decode_any(frame)  # refuses it as well, and names the field
        if number == WAVE_ID and (raw := read_wave(frame)) is not None and math.isfinite(raw.shipped):
            try:
                return Wave(raw.tick, _read_sums(raw.sums), raw.shipped)
            except Unfit:
                return _decode_any(frame)
    return _decode_any(frame)


def _encode_any(message: Message) -> bytes:
    kind = type(message)
    if kind not in LAYOUTS:
        raise ValueError(f"found {kind.__name__}; expected a message of the protocol")
    number, layout = LAYOUTS[kind]
    plain: list[object] = [number]
    for name, field in zip(_FIELD_NAMES[kind], layout, strict=True):
        value = getattr(message, name)
        if field is BUTTONS and value == 0 and type(value) is int:
            continue
        try:
            packed = field.write(value)
            field.read(packed)
        except (Unfit, TypeError, ValueError, AttributeError, OverflowError) as error:
            raise ValueError(f"{kind.__name__}.{name}: {error}") from None
        plain.append(packed)
    frame: bytes = msgpack.packb(plain)
    if len(frame) > MAX_CONTROL_BYTES:
        raise ValueError(f"{kind.__name__}: found a frame of {len(frame)} bytes; expected at most {MAX_CONTROL_BYTES}")
    return frame


def _decode_any(frame: bytes) -> Received:
    """Read a frame that is not a valid signal in the usual layout."""
    version = _version_of_hello(frame)
    if version is not None and version != PROTOCOL_VERSION:
        return ForeignHello(version)
    try:
        containers = _Containers()
        plain = msgpack.unpackb(frame, list_hook=containers.array, object_pairs_hook=containers.mapping, **_UNPACKING)
    except (ValueError, msgpack.UnpackException) as error:
        return Malformed(f"found no single MessagePack value within the limits ({error})", Flaw.SYNTAX)
    if type(plain) is not list or not plain:
        return Malformed(f"found {type(plain).__name__}; expected an array with a type first", Flaw.SYNTAX)
    number, *packed = plain
    kind = _KINDS.get(number) if type(number) is int else None
    if kind is None:
        return Malformed(f"found type {number!r:.40}; expected one of {sorted(_KINDS)}")
    _, layout = LAYOUTS[kind]
    fewer = len(packed) == len(layout) - 1 and layout[-1] is BUTTONS
    if len(packed) != len(layout) and not fewer:
        return Malformed(f"{kind.__name__}: found {len(packed)} fields; expected {len(layout)}")
    values = []
    for name, field, value in zip(_FIELD_NAMES[kind], layout, packed, strict=not fewer):
        try:
            values.append(field.read(value))
        except NotFinite as error:
            return Malformed(f"{kind.__name__}.{name}: {error}", Flaw.NOT_FINITE)
        except Unfit as error:
            return Malformed(f"{kind.__name__}.{name}: {error}")
    construct: Callable[..., Message] = kind
    return construct(*values)


def _version_of_hello(frame: bytes) -> int | None:
    """The version of a hello, without reading the rest; None if the frame begins differently."""
    number, version = type_and_next(frame) or (0, -1)
    return version if number in _HELLOS and 0 <= version <= MAX_VERSION else None


class _Containers:
    """Counts the arrays and maps of one frame while it is read, and refuses keys that occur twice."""

    __slots__ = ("_left",)

    def __init__(self) -> None:
        self._left = MAX_CONTAINERS

    def array(self, items: list[Any]) -> list[Any]:
        self._count()
        return items

    def mapping(self, pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        self._count()
        mapping = dict(pairs)
        if len(mapping) != len(pairs):
            raise ValueError("a key occurs twice in a map")
        return mapping

    def _count(self) -> None:
        self._left -= 1
        if self._left < 0:
            raise ValueError(f"more than {MAX_CONTAINERS} arrays and maps")


# msgpack allocates memory for an array as soon as it has read its length, at every level of nesting, so the bounds are
# small; only str keys, no extension types
_UNPACKING: Final[dict[str, Any]] = {
    "raw": False,
    "strict_map_key": True,
    "max_array_len": MAX_PORTS,
    "max_map_len": MAX_ENTRIES,
    "max_str_len": 4 * MAX_TEXT,
    "max_bin_len": MAX_CONTROL_BYTES,
    "max_ext_len": 0,
}
