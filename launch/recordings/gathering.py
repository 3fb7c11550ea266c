"""Putting the rows of a topic together again, tick by tick, out of the messages that tell one tick each."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain
from types import NoneType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from manyhands.nodes.recorder.layout import TICK
from manyhands.protocol.topics import Columns, Topic

Array = NDArray[np.float64]

MOST_TICK: Final = 2**53
"""Ticks beyond are no ticks of a run."""


_ROOM_OF_A_ROW: Final = 200
_ROOM_OF_A_NUMBER: Final = 32
"""Bytes that a message's text takes at most, besides and for each number; longer ones are not parsed."""


def objects(texts: Sequence[bytes]) -> list[Any]:
    """What each text is in JSON, those that are it: all at once, or one by one where that does not go."""
    try:
        found: list[Any] = json.loads(b"[%b]" % b",".join(texts))
    except (ValueError, RecursionError):
        found = []
    return found if len(found) == len(texts) else list(_one_by_one(texts))


def _one_by_one(texts: Iterable[bytes]) -> Iterator[Any]:
    for text in texts:
        try:
            yield json.loads(text)
        except (ValueError, RecursionError):
            continue  # a checksum says that this is what was written: who wrote it meant something else


def fitting(plain: Iterable[Any], read: Callable[[Any], Any]) -> Iterator[Any]:
    """What ``read`` makes of each object; those of which it says that they are none are passed over."""
    for one in plain:
        try:
            yield read(one)
        except ValueError:
            continue


class Gatherer:
    """The rows of one topic of one node.

    Attributes:
        topic: the topic.
        columns: names of its columns.
    """

    def __init__(self, topic: Topic, columns: tuple[str, ...]) -> None:
        """Nothing is gathered yet."""
        self.topic, self.columns = topic, columns
        self._pieces: list[tuple[NDArray[np.int64], Array]] = []

    @property
    def count(self) -> int:
        """How many rows were taken."""
        return sum(len(ticks) for ticks, _ in self._pieces)

    def take(self, texts: Sequence[bytes]) -> None:
        """Take in messages; what is none of this topic is passed over, and its tick is missing then."""
        most = _ROOM_OF_A_ROW + _ROOM_OF_A_NUMBER * len(self.columns)
        plain = objects([text for text in texts if len(text) <= most])
        piece = self._read(plain)
        if piece is None:
            for one in plain:
                self._keep(self._read([one]))
        else:
            self._keep(piece)

    def _keep(self, piece: tuple[NDArray[np.int64], Array] | None) -> None:
        if piece is not None and len(piece[0]):
            self._pieces.append(piece)

    def _read(self, plain: list[Any]) -> tuple[NDArray[np.int64], Array] | None:
        """Ticks and rows of messages that were read; None if not all of them are as they should be."""
        key, one = self.topic.trace, self.topic.columns is Columns.ONE
        try:
            numbers, rows = [each[TICK] for each in plain], [each[key] for each in plain]
            kinds = {type(value) for value in (rows if one else chain.from_iterable(rows))}
            if {type(number) for number in numbers} != {int} or not kinds <= {float, int, NoneType}:
                return None
            ticks, values = np.array(numbers, dtype=np.int64), np.array(rows, dtype=np.float64)  # None: not a number
        except (LookupError, TypeError, ValueError, OverflowError):
            return None
        values = values[:, None] if one else values
        right = values.shape == (len(plain), len(self.columns)) and (ticks >= 0).all() and (ticks < MOST_TICK).all()
        return (ticks, values) if right else None

    @property
    def first(self) -> int | None:
        """The earliest tick that was told of; None if none was."""
        return min((int(at.min()) for at, _ in self._pieces), default=None)

    def end(self, most: int) -> int:
        """One more than the latest tick of those below ``most``."""
        return max((int(at[at < most].max(initial=-1)) + 1 for at, _ in self._pieces), default=0)

    def rows(self, span: range) -> tuple[Array, NDArray[np.bool_]]:
        """The rows of the ticks of ``span``, NaN where there are none, and which of them were told."""
        values = np.full((len(span), len(self.columns)), np.nan)
        told = np.zeros(len(span), dtype=np.bool_)
        for at, piece in self._pieces:
            inside = (at >= span.start) & (at < span.stop)
            row = at[inside] - span.start
            values[row], told[row] = piece[inside], True
        return values, told


def span_of(gatherers: Sequence[Gatherer], most_missing: int) -> range:
    """The ticks that there are, up to the latest told of; such that no more than ``most_missing`` numbers are missing.

    From tick 0 on, unless so many are missing before the first that was told of, in a recording of a session's later
    hours: then from there. A single message of a tick out of this world would otherwise cost memory for all before it.
    """
    told = sum(gatherer.count * len(gatherer.columns) for gatherer in gatherers)
    width = sum(len(gatherer.columns) for gatherer in gatherers)
    room = (told + most_missing) // max(1, width)
    earliest = min((gatherer.first for gatherer in gatherers if gatherer.first is not None), default=0)
    first = earliest if earliest >= room else 0
    return range(first, max((gatherer.end(first + room) for gatherer in gatherers), default=first))
