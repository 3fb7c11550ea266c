"""Where a recording was changed or cut: the checksums of its format locate each change to a chunk or a record.

| part of the file | what checks it | a change is located to |
|---|---|---|
| chunk, attachment | its own checksum | the record |
| message index | the messages of the chunk before it | the record |
| header, session's metadata, framing | being readable; the checksum of the data section | the record; the section |
| summary and footer | the checksum of the summary | the summary |

The data section ends where its last record states the section's checksum; the summary and the footer follow.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO, Final

from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, ChunkIndex, Footer, MetadataIndex
from mcap.writer import MCAP0_MAGIC

from manyhands.design.files import open_regular
from manyhands.launch.recordings.data_section import DATA_END_BYTES, Damage, DataSection, Walk, checksum_of
from manyhands.launch.recordings.recording import RecordingError
from manyhands.launch.recordings.records import FRAME, record_of
from manyhands.launch.recordings.stream import MOST_RECORD_BYTES

__all__ = ["Damage", "findings"]

_CRC_BYTES: Final = 4
_FOOTER_BYTES: Final = FRAME.size + 20
_TAIL: Final = _FOOTER_BYTES + len(MCAP0_MAGIC)


def findings(path: Path, progress: Callable[[float], None] | None = None) -> list[Damage]:
    """What is wrong with a recording, in the order of its bytes; nothing with one that is as it was written.

    Args:
        path: the file.
        progress: gets the part that is done, 0 to 1.

    Raises:
        RecordingError: it cannot be read at all.
    """
    try:
        with open_regular(path) as file:
            found = _Examination(file).run(progress or (lambda _part: None))
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from error
    return sorted(found, key=lambda damage: (damage.begin, damage.end))


class _Examination:
    """Of one file."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._size = os.fstat(file.fileno()).st_size
        self._tail_at = max(self._size - _TAIL, 0)  # where the footer begins
        tail = self._read(self._tail_at, self._size)
        self._told = tail[:_FOOTER_BYTES]
        self._magic = tail[_FOOTER_BYTES:] == MCAP0_MAGIC
        footer = record_of(tail[0], tail[FRAME.size : _FOOTER_BYTES]) if len(tail) == _TAIL else None
        framed = tail[: FRAME.size] == FRAME.pack(Opcode.FOOTER, _FOOTER_BYTES - FRAME.size)
        self._footer = footer if framed and isinstance(footer, Footer) else None
        self._start = None if self._footer is None else self._trusted(self._footer)

    def _read(self, begin: int, end: int) -> bytes:
        self._file.seek(begin)
        return self._file.read(max(end - begin, 0))

    def _trusted(self, footer: Footer) -> int | None:
        """Where the summary begins, if the footer is right: the checksum agrees, or the data ends before it."""
        start = footer.summary_start
        if not DATA_END_BYTES <= start <= self._tail_at or self._tail_at - start > MOST_RECORD_BYTES:
            return None
        before = self._read(start - DATA_END_BYTES, start)
        if before[: FRAME.size] == FRAME.pack(Opcode.DATA_END, DATA_END_BYTES - FRAME.size):
            return start
        return start if _footer_crc(self._read(start, self._tail_at), self._told) == footer.summary_crc else None

    def _known(self) -> list[int]:
        """Where records of the data section begin, by the summary."""
        if self._start is None:
            return []
        found = {self._start - DATA_END_BYTES}
        for opcode, body in _records_in(self._read(self._start, self._tail_at)):
            match record_of(opcode, body):
                case ChunkIndex() as index:
                    found |= {index.chunk_start_offset, *index.message_index_offsets.values()}
                case AttachmentIndex(offset) | MetadataIndex(offset):
                    found.add(offset)
        return sorted(found)

    def run(self, progress: Callable[[float], None]) -> list[Damage]:
        """Look at everything."""
        whole = self._size >= _TAIL and (self._magic or self._footer is not None)
        limit = self._size if not whole else self._tail_at if self._start is None else self._start
        section = Walk(self._file, limit, self._known).run(progress)
        found, end = list(section.damages), section.end or self._start
        if not whole:
            return [*found, self._cut(section)]
        if not self._magic:
            found.append(
                Damage(self._tail_at + _FOOTER_BYTES, self._size, "found a file that does not end as MCAP does")
            )
        if end is None:
            return found or [Damage(section.whole_to, self._size, "found no end of the data; expected one")]
        if self._start is not None and end < self._start:
            found.append(Damage(end, self._start, "found bytes between the data and its summary; expected none"))
        if not section.damages:
            found += self._checksum(section.checksum, end - DATA_END_BYTES)
        return found + self._summary(end)

    def _cut(self, section: DataSection) -> Damage:
        at = section.whole_to
        if section.end is None:
            what = (
                f"the file ends at byte {self._size} as no recorder ends it: it was cut, and is whole up to byte {at}"
            )
        else:
            what = f"the file ends within its summary: it was cut, and its data, up to byte {at}, is whole"
        return Damage(at, self._size, what)

    def _checksum(self, stated: int, end: int) -> list[Damage]:
        """Hold the data section against its checksum, when nothing else is wrong with it."""
        actual = checksum_of(self._file, end)
        if actual == stated:
            return []
        if stated == 0:
            return [Damage(end, end + DATA_END_BYTES, "found no checksum of the data; expected one")]
        what = (
            f"found data with the checksum {actual:08x}; expected {stated:08x}, as stated. Each chunk, message index "
            "and attachment agrees with its own, so the header, the session's metadata, the framing or the stated "
            "checksum was changed"
        )
        return [Damage(0, end + DATA_END_BYTES, what)]

    def _summary(self, start: int) -> list[Damage]:
        """Hold summary and footer against their checksum."""
        if self._tail_at - start > MOST_RECORD_BYTES:
            return [Damage(start, self._tail_at, f"found a summary longer than {MOST_RECORD_BYTES} bytes")]
        actual = _footer_crc(self._read(start, self._tail_at), self._told)
        stated = int.from_bytes(self._told[-_CRC_BYTES:], "little")
        if actual == stated:
            return []
        what = f"found a summary and a footer with the checksum {actual:08x}; expected {stated:08x}, as stated"
        return [Damage(start, self._tail_at + _FOOTER_BYTES, what)]


def _records_in(summary: bytes) -> Iterator[tuple[int, bytes]]:
    """Opcode and body of each record of a summary, up to the first one that is longer than the rest of it."""
    at = 0
    while len(summary) - at >= FRAME.size:
        opcode, length = FRAME.unpack_from(summary, at)
        at += FRAME.size
        if length > len(summary) - at:
            return
        yield opcode, summary[at : at + length]
        at += length


def _footer_crc(summary: bytes, footer: bytes) -> int:
    """The checksum of a summary and of its footer up to where it states it."""
    return zlib.crc32(footer[: _FOOTER_BYTES - _CRC_BYTES], zlib.crc32(summary))
