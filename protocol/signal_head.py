"""The head of a signal's frame: all that stands before its values, read without reading those.

    array of 4 | type id | tick | stamp | length of the values | values

Whoever waits for one signal decides by the head what becomes of a frame, so that refusing one costs little and the
same whatever stands behind. :data:`USUAL` is the layout that this implementation writes; :func:`read_head` reads every
other encoding that MessagePack has for the same array, too. It agrees with :func:`manyhands.protocol.codec.decode` on
what a signal is (a test compares them).
"""

import struct
from collections.abc import Mapping
from typing import Final, NamedTuple

from manyhands.protocol.limits import MAX_COUNT, MAX_PORTS

USUAL: Final = struct.Struct(">BBBQBQBH")
"""array of 4, type id, uint 64, tick, uint 64, stamp, bin 16, length; the constant bytes are MessagePack's own tags."""

ARRAY_OF_4: Final = 0x94
UINT64: Final = 0xCF
BIN16: Final = 0xC5

LONGEST: Final = 5 + 3 * 9 + 5
"""Bytes of the longest head: array 32, three integers of 64 bits with their tags, bin 32."""

_INTEGERS: Final = {
    tag: struct.Struct(form)
    for tag, form in {
        0xCC: ">B", 0xCD: ">H", 0xCE: ">I", 0xCF: ">Q", 0xD0: ">b", 0xD1: ">h", 0xD2: ">i", 0xD3: ">q"
    }.items()
}  # fmt: skip
_ARRAYS: Final = {0xDC: struct.Struct(">H"), 0xDD: struct.Struct(">I")}
_BINARIES: Final = {0xC4: struct.Struct(">B"), 0xC5: struct.Struct(">H"), 0xC6: struct.Struct(">I")}


class Head(NamedTuple):
    """A signal's head.

    Attributes:
        tick: k.
        stamp: when x(k) was sampled, ns.
        size: bytes of the head; the values follow, 8 bytes each, up to the end of the frame.
    """

    tick: int
    stamp: int
    size: int


def type_of(frame: bytes) -> int | None:
    """The type id that a frame states, of whatever message; None if it begins otherwise. Nothing else is read."""
    try:
        _, number, _ = _start(frame)
    except (IndexError, KeyError, struct.error):
        return None
    return number


def type_and_next(frame: bytes) -> tuple[int, int] | None:
    """The type id that a frame states and the integer behind it; None if it begins otherwise."""
    try:
        entries, number, at = _start(frame)
        following, _ = _integer(frame, at)
    except (IndexError, KeyError, struct.error):
        return None
    return (number, following) if entries > 1 else None


def read_head(frame: bytes) -> Head | None:
    """The head of a signal, of whatever type; None if this is no signal's frame. Never raises."""
    try:
        entries, _, at = _start(frame)
        tick, at = _integer(frame, at)
        stamp, at = _integer(frame, at)
        length, at = _tagged(frame, at, _BINARIES)
    except (IndexError, KeyError, struct.error):
        return None
    counts = 0 <= tick <= MAX_COUNT and 0 <= stamp <= MAX_COUNT
    whole = length == len(frame) - at and length % 8 == 0 and 8 <= length <= 8 * MAX_PORTS
    return Head(tick, stamp, at) if entries == 4 and counts and whole else None


def _start(frame: bytes) -> tuple[int, int, int]:
    """Entries of the array, type id, and where the next entry begins."""
    first = frame[0]
    entries, at = (first & 0x0F, 1) if first & 0xF0 == 0x90 else _tagged(frame, 0, _ARRAYS)
    return entries, *_integer(frame, at)


def _integer(frame: bytes, at: int) -> tuple[int, int]:
    """The integer that begins ``at``, and where the next entry begins."""
    first = frame[at]
    return (first, at + 1) if first < 0x80 else _tagged(frame, at, _INTEGERS)


def _tagged(frame: bytes, at: int, forms: Mapping[int, struct.Struct]) -> tuple[int, int]:
    """The number behind the tag ``at``, in the form that the tag stands for, and where it ends."""
    form = forms[frame[at]]
    (number,) = form.unpack_from(frame, at + 1)
    return number, at + 1 + form.size
