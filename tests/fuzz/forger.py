"""Forged frames by an attacker with knowledge of the protocol: whole messages, changed ones, and plain bytes.

What there is to forge is read from the codec's own table and the messages' annotations, so a new message is forged
as soon as it is in the protocol.
"""

from __future__ import annotations

import dataclasses
import math
import struct
from collections.abc import Mapping, Sequence
from types import UnionType
from typing import Any, Final, get_args, get_origin, get_type_hints

import msgpack
from draws import Draws

from manyhands.protocol.codec import LAYOUTS, encode
from manyhands.protocol.limits import MAX_COUNT
from manyhands.protocol.messages import PROTOCOL_VERSION, Message, RefusalCode, Role, Values

LONGEST_BLOB: Final = 300
MOST_ENTRIES: Final = 5
DEEPEST: Final = 4

KINDS: Final = tuple(sorted(LAYOUTS, key=lambda kind: LAYOUTS[kind][0]))
KIND_NAMES: Final = tuple(kind.__name__ for kind in KINDS)
_HINTS: Final = {kind: get_type_hints(kind) for kind in KINDS}
_FIELDS: Final = {kind: tuple(field.name for field in dataclasses.fields(kind)) for kind in KINDS}

HOW: Final = ("as it is", "field", "anything", "made", "bytes", "raw", "extra field", "cut")
PLAIN: Final = ("nil", "bool", "integer", "float", "word", "bytes", "array", "map", "extension", "text")
INTEGERS: Final = (0, 1, 2, PROTOCOL_VERSION, PROTOCOL_VERSION + 1, -1, 255, 2**31, 2**32, MAX_COUNT, MAX_COUNT + 1,
                   2**64 - 1, -(2**63))  # fmt: skip
FLOATS: Final = (0.0, -0.0, 0.5, 1.0, -1.0, 1e308, 5e-324, math.inf, -math.inf, math.nan)
WORDS: Final = ("", "a", "p50", "é", "\x00", "\x1b[2J", "n" * 97, *map(str, Role), *map(str, RefusalCode))


class Forger:
    """Makes one frame after the other.

    Attributes:
        draws: where every decision comes from.
        messages: messages that would be in place here, by a short name.
        words: names that mean something here.
    """

    def __init__(self, draws: Draws, messages: Mapping[str, Message], words: Sequence[str] = ()) -> None:
        self.draws = draws
        self.messages = messages
        self._names = tuple(messages)
        self._words = (*words, *WORDS)

    def frame(self) -> bytes:
        """A frame, good or bad."""
        how = self.draws.choice(HOW)
        if how == "made":
            kind = KINDS[KIND_NAMES.index(self.draws.choice(KIND_NAMES))]
            return _pack([LAYOUTS[kind][0], *(self._typed(_HINTS[kind][name]) for name in _FIELDS[kind])])
        if how == "raw":
            return self.draws.blob(LONGEST_BLOB)
        name = self.draws.choice(self._names)
        frame = encode(self.messages[name])
        if how == "as it is":
            return frame
        if how == "cut":
            return frame[: self.draws.integer(0, len(frame))]
        if how == "bytes":
            place = self.draws.integer(0, len(frame))
            return frame[:place] + self.draws.blob(8) + frame[place + self.draws.integer(0, 8) :]
        items: list[object] = msgpack.unpackb(frame)
        if how == "extra field":
            items.insert(self.draws.integer(0, len(items)), self._plain())
            return _pack(items)
        place = self.draws.integer(0, len(items) - 1)
        kind = type(self.messages[name])
        if how == "anything" or place == 0:
            items[place] = self._plain()
        else:
            items[place] = self._typed(_HINTS[kind][_FIELDS[kind][place - 1]])
        return _pack(items)

    def _plain(self, depth: int = 0) -> object:
        """Any value that MessagePack can hold."""
        match self.draws.choice(PLAIN if depth < DEEPEST else PLAIN[:6]):
            case "bool":
                return bool(self.draws.integer(0, 1))
            case "integer":
                return self._integer()
            case "float":
                return self._float()
            case "word":
                return self._word()
            case "bytes":
                return self.draws.blob(40)
            case "array":
                return [self._plain(depth + 1) for _ in range(self.draws.integer(0, MOST_ENTRIES))]
            case "map":
                return {self._word(): self._plain(depth + 1) for _ in range(self.draws.integer(0, MOST_ENTRIES))}
            case "extension":
                return msgpack.ExtType(self.draws.integer(0, 127), self.draws.blob(8))
            case "text":
                return self.draws.blob(80).decode("utf-8", "surrogateescape")
        return None

    def _typed(self, hint: Any) -> object:
        """Plain data of the type that a field is declared with, its value not always allowed."""
        origin, arguments = get_origin(hint), get_args(hint)
        if origin is Mapping:
            entries = range(self.draws.integer(0, MOST_ENTRIES))
            item = arguments[1]
            return {self._word(): self._trace() if item == Values else self._typed(item) for _ in entries}
        if origin is tuple:
            return [self._typed(arguments[0]) for _ in range(self.draws.integer(0, MOST_ENTRIES))]
        if origin is UnionType:
            return self._typed(self.draws.choice(arguments))
        if hint == Values:
            return self._doubles(self.draws.integer(0, MOST_ENTRIES))
        if hint is type(None):
            return None
        if hint is int:
            return self._integer()
        if hint is float:
            return self._float()
        if hint is Role:
            return str(self.draws.choice(tuple(Role)))
        if hint is str:
            return self._word()
        return self._plain()

    def _integer(self) -> int:
        return self.draws.choice((*INTEGERS, *range(3, 16))) if self.draws.integer(0, 1) else self.draws.integer(0, 255)

    def _float(self) -> float:
        if self.draws.integer(0, 1):
            return self.draws.choice(FLOATS)
        (number,) = struct.unpack("<d", self.draws.integer(0, 2**64 - 1).to_bytes(8, "little"))
        return float(number)

    def _word(self) -> str:
        return self.draws.choice(self._words)

    def _doubles(self, count: int) -> bytes:
        return struct.pack(f"<{count}d", *(self._float() for _ in range(count)))

    def _trace(self) -> list[object]:
        rows, columns = self.draws.integer(0, 3), self.draws.integer(0, 3)
        return [rows + self.draws.choice((0, 0, 0, 1, -1, 2**40)), columns, self._doubles(rows * columns)]


def _pack(items: list[object]) -> bytes:
    packed: bytes = msgpack.packb(items, unicode_errors="surrogateescape")
    return packed
