"""Where a single changed byte lies, by what it does to a checksum.

CRC-32 is linear: two texts of one length that differ in one byte have checksums whose difference (exclusive or, the
*syndrome*) depends on that byte's place and change alone, not on the text. Going back from the end, a zero byte at a
time, the syndrome is at the changed byte one of the 255 words that a lone byte can make. Of ``n`` places, about
``255 n / 2**32`` fit by chance.
"""

from __future__ import annotations

import zlib
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

Words = NDArray[np.uint32]

_BLOCK_BITS: Final = 16  # places that are looked at together: 2**16


def changed_bytes(syndrome: int, length: int, most: int) -> list[int]:
    """The places at which one changed byte makes this difference of checksums.

    Args:
        syndrome: exclusive or of the checksums, not 0.
        length: of the text, bytes.
        most: how many are looked for, from the end on.
    """
    table, by_high_byte = _tables()
    block = np.array([syndrome], dtype=np.uint32)
    for bits in range(min(_BLOCK_BITS, (length - 1).bit_length())):
        block = np.concatenate([block, _apply(_back(bits), block)])
    found: list[int] = []
    for done in range(0, length, block.size):
        changes = by_high_byte[block >> np.uint32(24)]
        places = length - 1 - done - np.flatnonzero((table[changes] == block) & (changes != 0))
        found += [int(place) for place in places if place >= 0]
        if len(found) >= most:
            break
        block = _apply(_back(_BLOCK_BITS), block)
    return found[:most]


@cache
def _tables() -> tuple[Words, Words]:
    """The checksum's word of each byte, and the byte by the word's high byte, which differs for each."""
    words = [zlib.crc32(bytes([byte])) ^ zlib.crc32(b"\0") for byte in range(256)]
    table = np.array(words, dtype=np.uint32)
    by_high_byte = np.zeros(256, dtype=np.uint32)
    by_high_byte[table >> np.uint32(24)] = np.arange(256, dtype=np.uint32)
    return table, by_high_byte


@cache
def _back(bits: int) -> tuple[Words, ...]:
    """The map that takes a word back by ``2**bits`` zero bytes: for each of its four bytes, a table."""
    if bits > 0:
        half = _back(bits - 1)
        return tuple(_apply(half, table) for table in half)
    table, by_high_byte = _tables()
    out = []
    for shift in (0, 8, 16, 24):
        words = np.arange(256, dtype=np.uint32) << np.uint32(shift)
        byte = by_high_byte[words >> np.uint32(24)]
        out.append(((words ^ table[byte]) << np.uint32(8)) | byte)
    return tuple(out)


def _apply(tables: tuple[Words, ...], words: Words) -> Words:
    out = np.zeros_like(words)
    for place, table in enumerate(tables):
        out ^= table[(words >> np.uint32(8 * place)) & np.uint32(0xFF)]
    return out
