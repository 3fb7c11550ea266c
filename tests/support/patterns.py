"""A search for many byte strings at once in a long stream of bytes: network traffic, or a process's memory."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

SHORTEST = 8
"""Bytes of a pattern, at least: among 10^8 others, shorter ones turn up by accident."""


class Patterns:
    """Byte strings to look for.

    The first eight bytes of each stand in one sorted table. At every position the next two bytes say whether a look
    into that table is worth while, so that the time hardly depends on how many patterns there are.
    """

    def __init__(self, wanted: Mapping[bytes, str]) -> None:
        """``wanted`` gives the meaning of each byte string.

        Raises:
            ValueError: one is shorter than :data:`SHORTEST`, or nothing but zeros.
        """
        for pattern, what in wanted.items():
            if len(pattern) < SHORTEST or not any(pattern):
                raise ValueError(
                    f"{what}: found the pattern {pattern!r}; expected {SHORTEST} bytes or more, not all zero"
                )
        self._wanted = dict(wanted)
        self._by_head: dict[int, list[bytes]] = {}
        for pattern in wanted:
            self._by_head.setdefault(int.from_bytes(pattern[:8], "little"), []).append(pattern)
        self._heads = np.sort(np.array(list(self._by_head), dtype="<u8"))
        self._starts = np.zeros(2**16, dtype=bool)
        self._starts[self._heads & 0xFFFF] = True
        self._overlap = max(map(len, wanted), default=1) - 1

    def found_in(self, pieces: Iterable[bytes]) -> set[str]:
        """The meanings of the patterns that occur in consecutive ``pieces``, also across their borders."""
        found: set[bytes] = set()
        rest = b""
        for piece in pieces:
            data = rest + piece
            self._search(data, found)
            rest = data[max(0, len(data) - self._overlap) :]
        return {self._wanted[pattern] for pattern in found}

    def _search(self, data: bytes, found: set[bytes]) -> None:
        positions = len(data) - 7
        if positions <= 0 or not self._by_head or _is_nothing(data):
            return
        words: NDArray[np.uint64] = np.ndarray((positions,), "<u8", data, 0, (1,))  # the eight bytes at every position
        for shift in range(2):
            pairs = np.frombuffer(data, "<u2", (positions + 1 - shift) // 2, shift)
            promising = 2 * np.flatnonzero(self._starts[pairs]) + shift
            candidates = words[promising]
            nearest = np.minimum(np.searchsorted(self._heads, candidates), len(self._heads) - 1)
            for hit in np.flatnonzero(self._heads[nearest] == candidates):
                at = int(promising[hit])
                found.update(p for p in self._by_head[int(candidates[hit])] if data.startswith(p, at))


def _is_nothing(data: bytes) -> bool:
    """Whether these bytes are all zero, as in most memory that a process has never touched."""
    return not data[0] and not any(data[:64]) and data.count(0) == len(data)


def is_distinctive(value: float) -> bool:
    """Whether a number hardly occurs by accident: at least five distinct bytes other than zero."""
    return len(set(struct.pack("<d", value)) - {0}) >= 5
