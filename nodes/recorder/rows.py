"""The JSON messages of many ticks at once: what a recorder does most, 23 000 times a second with three users.

A message is ``{"tick": 17, "time": 0.017, "x": [0.001]}``. Its beginning is the same for all topics of a node and is
made once for all of them; the numbers of a whole trace are written by one call. Numbers are the shortest text that is
read back as the same double; what is infinite or not a number is null.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from manyhands.nodes.recorder.layout import SEQUENCES, TICK, TIME

_BLOCK: Final = 128  # ticks


@dataclass(frozen=True, eq=False)
class Ticks:
    """Consecutive ticks of a session: what their messages have in common.

    Attributes:
        times: when they were, ns since 1970, uint64.
        sequences: their sequence numbers, uint32.
        beginnings: how each one's messages begin, as far as the key of the topic's value.
        lengths: of the beginnings, bytes.
    """

    times: NDArray[np.uint64]
    sequences: NDArray[np.uint32]
    beginnings: tuple[bytes, ...]
    lengths: NDArray[np.uint64]

    @classmethod
    def of(cls, first: int, count: int, start: int, tick_ns: float) -> Ticks:
        """The ticks ``first`` to ``first + count - 1`` of a session whose tick 0 was at ``start``, ns since 1970."""
        numbers = np.arange(first, first + count, dtype=np.uint64)
        beginnings = _beginnings(first, count, tick_ns)
        return cls(
            np.uint64(start) + _since_start(first, count, tick_ns).astype(np.uint64),
            (numbers % np.uint64(SEQUENCES)).astype(np.uint32),
            beginnings,
            lengths_of(beginnings),
        )


def _since_start(first: int, count: int, tick_ns: float) -> NDArray[np.float64]:
    """How long after tick 0 the ticks are, ns: whole numbers."""
    return np.rint(np.arange(first, first + count, dtype=np.uint64).astype(np.float64) * tick_ns)


def _beginnings(first: int, count: int, tick_ns: float) -> tuple[bytes, ...]:
    """How the messages of these ticks begin, out of blocks: all nodes tell of the same ticks, one after the other."""
    out: list[bytes] = []
    for block in range(first // _BLOCK, (first + count - 1) // _BLOCK + 1):
        out += _block(block, tick_ns)
    skipped = first % _BLOCK
    return tuple(out[skipped : skipped + count])


@lru_cache(maxsize=64)
def _block(number: int, tick_ns: float) -> tuple[bytes, ...]:
    first = number * _BLOCK
    times = (_since_start(first, _BLOCK, tick_ns) / 1e9).tolist()
    return tuple(f'{{"{TICK}": {tick}, "{TIME}": {time!r}, '.encode() for tick, time in enumerate(times, first))


def lengths_of(texts: Sequence[bytes]) -> NDArray[np.uint64]:
    """The length of each text, bytes."""
    return np.fromiter(map(len, texts), dtype=np.uint64, count=len(texts))


def row_texts(values: NDArray[np.float64], one: bool) -> list[bytes]:
    """Each row as JSON has it without brackets: its numbers, or, of ``one`` column, its number.

    Args:
        values: ticks x columns; at least one of each.
        one: whether the rows are plain numbers, and no arrays.
    """
    plain = values[:, 0].tolist() if one else values.tolist()
    text = repr(plain).encode()
    if not np.isfinite(values).all():
        for word in (b"nan", b"-inf", b"inf"):
            text = text.replace(word, b"null")
    return text[1:-1].split(b", ") if one else text[2:-2].split(b"], [")
