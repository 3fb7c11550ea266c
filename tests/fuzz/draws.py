"""Choices out of bytes, and bytes out of choices.

A coverage-guided fuzzer hands over bytes and changes them at random. :class:`Draws` makes decisions of them (which
message, which field, which value), so that most inputs mean something; nothing of it depends on the fuzzer, which is
why a corpus can be replayed without it. :class:`Dictation` goes the other way and serves to write seeds: it is
told the decisions, answers with them, and keeps the bytes that a :class:`Draws` would have read.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

T = TypeVar("T")


class Draws:
    """Decisions read from ``data``, front to back. At its end every number is the lowest possible."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    @property
    def more(self) -> bool:
        """Whether any of the data is left."""
        return self._at < len(self._data)

    def integer(self, low: int, high: int) -> int:
        """A number of ``low`` to ``high``."""
        size = _bytes_for(high - low)
        taken = self._data[self._at : self._at + size]
        self._at += size
        return low + int.from_bytes(taken, "little") % (high - low + 1)

    def choice(self, options: Sequence[T]) -> T:
        """One of ``options``."""
        return options[self.integer(0, len(options) - 1)]

    def blob(self, longest: int) -> bytes:
        """At most ``longest`` bytes; fewer than announced where the data ends."""
        size = self.integer(0, longest)
        taken = self._data[self._at : self._at + size]
        self._at += size
        return taken


class Misdictated(Exception):
    """A given decision is not one of those possible."""


class Dictation(Draws):
    """Given decisions, one after the other, and the ``bytes`` that lead to them."""

    def __init__(self, *told: object) -> None:
        super().__init__(b"")
        self._told = list(told)
        self.bytes = b""

    @property
    def more(self) -> bool:
        """Whether any decision is left."""
        return bool(self._told)

    def integer(self, low: int, high: int) -> int:
        """The next decision, a number.

        Raises:
            Misdictated: if it is none of ``low`` to ``high``.
        """
        value = self._told.pop(0) if self._told else low
        if type(value) is not int or not low <= value <= high:
            raise Misdictated(f"found {value!r}; expected a number of {low} to {high}")
        self._write(value - low, high - low)
        return value

    def choice(self, options: Sequence[T]) -> T:
        """The next decision, one of ``options``.

        Raises:
            Misdictated: if it is none of them.
        """
        value = self._told.pop(0) if self._told else options[0]
        if value not in options:
            raise Misdictated(f"found {value!r}; expected one of {options}")
        index = options.index(value)
        self._write(index, len(options) - 1)
        return options[index]

    def blob(self, longest: int) -> bytes:
        """The next decision, bytes.

        Raises:
            Misdictated: if they are none, or more than ``longest``.
        """
        value = self._told.pop(0) if self._told else b""
        if not isinstance(value, bytes) or len(value) > longest:
            raise Misdictated(f"found {value!r}; expected at most {longest} bytes")
        self._write(len(value), longest)
        self.bytes += value
        return value

    def _write(self, offset: int, greatest: int) -> None:
        self.bytes += offset.to_bytes(_bytes_for(greatest), "little")


def _bytes_for(greatest: int) -> int:
    """How many bytes hold every number of 0 to ``greatest``: none where there is nothing to choose."""
    return (greatest.bit_length() + 7) // 8
