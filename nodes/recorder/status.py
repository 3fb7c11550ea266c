"""What a recorder says to its supervisor: a line of JSON each, on a pipe of their own.

    {"ready": ENDPOINT}               the file is begun; this is where to send observations
    {"taken": N}                      so many frames in all have been taken in: there is room for others
    {"stopped": TEXT, "tick": K}      nothing more can be written; the file is readable up to tick K
    {"closed": {...}, "tick": K}      the file is whole; ticks missing by device

A recorder and its supervisor are of one version and one machine: this is not part of the protocol.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final, TypeAlias

MAX_LINE_BYTES: Final = 1024 * 1024
"""Longest line: it may name every device."""


@dataclass(frozen=True)
class Ready:
    """The file is begun; observations are expected at ``endpoint``."""

    endpoint: str


@dataclass(frozen=True)
class Taken:
    """How many frames have been taken in since the beginning."""

    frames: int


@dataclass(frozen=True)
class Stopped:
    """Nothing more can be written, and why; the file is readable up to ``tick``."""

    text: str
    tick: int


@dataclass(frozen=True)
class Closed:
    """The file is whole up to ``tick``; ``missing``: ticks never told, by device, those devices that miss some."""

    missing: Mapping[str, int]
    tick: int


Status: TypeAlias = Ready | Taken | Stopped | Closed


def encode(status: Status) -> bytes:
    """The line of a status."""
    plain: dict[str, object]
    match status:
        case Ready(endpoint):
            plain = {"ready": endpoint}
        case Taken(frames):
            plain = {"taken": frames}
        case Stopped(text, tick):
            plain = {"stopped": text, "tick": tick}
        case Closed(missing, tick):
            plain = {"closed": dict(missing), "tick": tick}
    return json.dumps(plain).encode() + b"\n"


class Lines:
    """Puts the pieces that a pipe delivers together again.

    Attributes:
        nonsense: lines that were no status.
    """

    def __init__(self) -> None:
        self._rest = b""
        self.nonsense = 0

    def feed(self, piece: bytes) -> Iterator[Status]:
        """The statuses that are complete with ``piece``."""
        *whole, self._rest = (self._rest + piece).split(b"\n")
        if len(self._rest) > MAX_LINE_BYTES:
            self._rest = b""
            self.nonsense += 1
        for line in whole:
            status = _decode(line)
            if status is None:
                self.nonsense += 1
            else:
                yield status


def _decode(line: bytes) -> Status | None:
    try:
        match json.loads(line):
            case {"ready": str(endpoint)}:
                return Ready(endpoint)
            case {"taken": int(frames)}:
                return Taken(frames)
            case {"stopped": str(text), "tick": int(tick)}:
                return Stopped(text, tick)
            case {"closed": dict(missing), "tick": int(tick)} if all(type(n) is int for n in missing.values()):
                return Closed(missing, tick)
            case _:
                return None
    except (ValueError, RecursionError):
        return None
