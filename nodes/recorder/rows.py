"""The JSON messages of many ticks at once: what a recorder does most, 23 000 times a second with three users.

A message is ``{"tick": 17, "time": 0.017, "x": [0.001]}``. Its beginning is the same for all topics of a node and is
made once for all of them; the numbers of a whole trace are written by one call. Numbers are the shortest text that is
read back as the same double; what is infinite or not a number is null.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from manyhands.nodes.recorder.layout import SEQUENCES, TICK, TIME


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
        since = np.rint(numbers.astype(np.float64) * tick_ns)
        beginnings = tuple(
            f'{{"{TICK}": {tick}, "{TIME}": {time!r}, '.encode()
            for tick, time in zip(numbers.tolist(), (since / 1e9).tolist(), strict=True)
        )
        return cls(
            np.uint64(start) + since.astype(np.uint64),
            (numbers % np.uint64(SEQUENCES)).astype(np.uint32),
            beginnings,
            lengths_of(beginnings),
        )


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
