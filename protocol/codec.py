"""Messages to frames and back, in MessagePack.

A frame is one MessagePack array, ``[type id, field, ...]``. What comes in is never trusted and never raises: ``decode``
returns a message, or a :class:`Malformed` that says what is wrong with the frame. What goes out is read back
through the very same checks before it leaves, so that the two sides cannot disagree about what is allowed.

Signals take a direct path in both directions, since they are what a tick is made of: their first 23 bytes
have a fixed layout (still plain MessagePack; a frame that another encoder wrote with shorter integers is
read by the general path).
"""

import dataclasses
import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Final, TypeAlias

import msgpack
import numpy as np

from manyhands.protocol import fields
from manyhands.protocol.fields import Field, NotFinite, Unfit
from manyhands.protocol.limits import (
    MAX_CONTAINERS,
    MAX_CONTROL_BYTES,
    MAX_COUNT,
    MAX_ENTRIES,
    MAX_PORTS,
    MAX_TEXT,
    MAX_VERSION,
)
from manyhands.protocol.messages import (
    PROTOCOL_VERSION,
    Absent,
    Condition,
    Connect,
    Echo,
    Fault,
    Force,
    Grasp,
    LinkHello,
    Message,
    NodeHello,
    Observation,
    Offer,
    Probe,
    Reaction,
    Ready,
    Refusal,
    Release,
    Report,
    Return,
    Rung,
    Sample,
    Shift,
    Signal,
    SignalMessage,
    Start,
    Stop,
    Telemetry,
    Tool,
    Welcome,
)
from manyhands.protocol.signal_head import ARRAY_OF_4, BIN16, UINT64, USUAL, type_and_next


class Flaw(StrEnum):
    """In which way a frame is malformed."""

    SIZE = "size"  # longer than its limit
    SYNTAX = "syntax"  # not exactly one MessagePack array within the limits
    SHAPE = "shape"  # of no known type, or a field is missing, too many, of a wrong type or out of bounds
    NOT_FINITE = "not finite"  # well formed, but a value is infinite or not a number


@dataclass(frozen=True, slots=True)
class Malformed:
    """What ``decode`` returns for a frame that is no message: what is wrong with it, in words and in kind."""

    reason: str
    flaw: Flaw = Flaw.SHAPE


@dataclass(frozen=True, slots=True)
class ForeignHello:
    """A hello of another protocol version, of which nothing else is read."""

    version: int


Received: TypeAlias = Message | ForeignHello | Malformed
"""Everything that a frame can turn out to be."""

_HELLOS: Final[dict[int, type[Message]]] = {1: LinkHello, 2: NodeHello}
_SIGNALS: Final[dict[int, type[SignalMessage]]] = {
    16: Sample,
    17: Tool,
    18: Reaction,
    19: Force,
}
_SIGNAL_IDS: Final[dict[type[Signal], int]] = {kind: number for number, kind in _SIGNALS.items()}

_WIRE_FLOAT: Final = np.dtype("<f8")

_Layout: TypeAlias = tuple[int, tuple[Field, ...]]

# type id and fields, in the order in which the dataclass declares them; ids are never given to another type
# again
_HELLO_START: Final = (fields.integer(0, MAX_VERSION), fields.NAME, fields.NAME, fields.NAME, fields.ROLE)
LAYOUTS: Final[dict[type[Message], _Layout]] = {
    LinkHello: (1, (*_HELLO_START, fields.PORTS, fields.FEEDTHROUGH)),
    NodeHello: (2, (*_HELLO_START, fields.PID, fields.ENDPOINTS)),
    Welcome: (3, ()),
    Refusal: (4, (fields.REFUSAL_CODE, fields.TEXT)),
    Connect: (5, (fields.ENDPOINTS,)),
    Ready: (6, ()),
    Start: (7, (fields.COUNT, fields.COUNT, fields.COUNT)),
    Stop: (8, (fields.TEXT,)),
    Probe: (9, (fields.COUNT,)),
    Echo: (10, (fields.COUNT, fields.COUNT, fields.COUNT)),
    Absent: (11, (fields.NAME,)),
    Offer: (12, (fields.NAME, fields.ENDPOINT)),
    Return: (13, (fields.NAME, fields.ENDPOINT)),
    Shift: (14, (fields.NAME, fields.RUNG)),
    Rung: (15, (fields.RUNG,)),
    **{kind: (number, (fields.COUNT, fields.COUNT, fields.VALUES)) for number, kind in _SIGNALS.items()},
    Telemetry: (32, (fields.COUNT, fields.FIGURES, fields.TRACES)),
    Report: (33, (fields.COUNT, fields.FIGURES, fields.COUNTS, fields.PERCENTILES)),
    Fault: (34, (fields.TEXT,)),
    Observation: (35, (fields.NAME, fields.COUNT, fields.FIGURES, fields.TRACES)),
    Condition: (36, (fields.NAME, fields.ELAPSED, fields.STATES, fields.NAMES, *[fields.SENTENCES] * 3)),
    Grasp: (37, (fields.VALUES,)),
    Release: (38, ()),
}
_KINDS: Final = {number: kind for kind, (number, _) in LAYOUTS.items()}
_FIELD_NAMES: Final = {kind: tuple(f.name for f in dataclasses.fields(kind)) for kind in LAYOUTS}


def encode(message: Message) -> bytes:
    """The frame of a message.

    Raises:
        ValueError: if a field is not what the protocol allows, naming it; nothing has been sent then.
    """
    if isinstance(message, Signal) and (number := _SIGNAL_IDS.get(type(message))) is not None:
        tick, stamp, values = message.tick, message.stamp, message.values
        # the checks of the fields, in one condition: what does not fit is refused below, where it can be said why
        if (
            type(tick) is type(stamp) is int
            and 0 <= tick <= MAX_COUNT
            and 0 <= stamp <= MAX_COUNT
            and type(values) is np.ndarray
            and values.dtype == _WIRE_FLOAT
            and values.ndim == 1
            and 1 <= len(values) <= MAX_PORTS
            and all(map(math.isfinite, values.tolist()))
        ):
            return USUAL.pack(ARRAY_OF_4, number, UINT64, tick, UINT64, stamp, BIN16, values.nbytes) + values.tobytes()
    return _encode_any(message)


class SignalWriter:
    """Frames of the signals that one end of a link sends tick after tick, without a message made for each.

    Attributes:
        kind: the signal.
    """

    __slots__ = ("_length", "_number", "_values", "_width", "kind")

    def __init__(self, kind: type[SignalMessage], width: int) -> None:
        """``width``: ports of the link."""
        self.kind = kind
        self._number, self._width = _SIGNAL_IDS[kind], width
        self._values = struct.Struct(f"<{width}d")
        self._length = self._values.size

    def frame(self, tick: int, stamp: int, values: Sequence[float]) -> bytes:
        """The frame that :func:`encode` makes of the same signal.

        Raises:
            ValueError: as :func:`encode`.
        """
        if (
            0 <= tick <= MAX_COUNT
            and 0 <= stamp <= MAX_COUNT
            and 1 <= len(values) == self._width <= MAX_PORTS
            and all(map(math.isfinite, values))
        ):
            head = USUAL.pack(ARRAY_OF_4, self._number, UINT64, tick, UINT64, stamp, BIN16, self._length)
            return head + self._values.pack(*values)
        return encode(self.kind(tick, stamp, np.array(values, dtype=np.float64)))  # which says what is wrong


def decode(frame: bytes, limit: int) -> Received:
    """What a frame of at most ``limit`` bytes says. Never raises, whatever the bytes.

    Returns:
        A message; a :class:`ForeignHello` for a hello of another protocol version, whatever follows the
        version; or :class:`Malformed`.
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
                    fields.COUNT.read(tick),
                    fields.COUNT.read(stamp),
                    fields.read_values(frame[USUAL.size :]),
                )
            except Unfit:
                return _decode_any(frame)  # which refuses it too, and can say where
    return _decode_any(frame)


def _encode_any(message: Message) -> bytes:
    kind = type(message)
    if kind not in LAYOUTS:
        raise ValueError(f"found {kind.__name__}; expected a message of the protocol")
    number, layout = LAYOUTS[kind]
    plain: list[object] = [number]
    for name, field in zip(_FIELD_NAMES[kind], layout, strict=True):
        try:
            packed = field.pack(getattr(message, name))
            field.read(packed)
        except (Unfit, TypeError, ValueError, AttributeError, OverflowError) as error:
            raise ValueError(f"{kind.__name__}.{name}: {error}") from None
        plain.append(packed)
    frame: bytes = msgpack.packb(plain)
    if len(frame) > MAX_CONTROL_BYTES:
        raise ValueError(f"{kind.__name__}: found a frame of {len(frame)} bytes; expected at most {MAX_CONTROL_BYTES}")
    return frame


def _decode_any(frame: bytes) -> Received:
    """Every frame that is not a signal in its usual layout."""
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
    if len(packed) != len(layout):
        return Malformed(f"{kind.__name__}: found {len(packed)} fields; expected {len(layout)}")
    values = []
    for name, field, value in zip(_FIELD_NAMES[kind], layout, packed, strict=True):
        try:
            values.append(field.read(value))
        except NotFinite as error:
            return Malformed(f"{kind.__name__}.{name}: {error}", Flaw.NOT_FINITE)
        except Unfit as error:
            return Malformed(f"{kind.__name__}.{name}: {error}")
    construct: Callable[..., Message] = kind
    return construct(*values)


def _version_of_hello(frame: bytes) -> int | None:
    """The version that a hello states, read without reading on; None if the frame begins otherwise."""
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


# msgpack gives memory to an array as soon as its length is read, at every level of nesting: hence the small
# bounds. Only str keys, no extension types.
_UNPACKING: Final[dict[str, Any]] = {
    "raw": False,
    "strict_map_key": True,
    "max_array_len": MAX_PORTS,
    "max_map_len": MAX_ENTRIES,
    "max_str_len": 4 * MAX_TEXT,
    "max_bin_len": MAX_CONTROL_BYTES,
    "max_ext_len": 0,
}
