"""Finds where a recording was changed or cut: the checksums of its format locate a change to a chunk or an attachment.

| part of the file | what checks it | a change is located to |
|---|---|---|
| chunk, attachment | its own checksum, and its entry in the summary | the record |
| length of a record | where the summary has the next one | the record |
| header, message indexes, session's metadata | the checksum of the data section | the section |
| summary and footer | the checksum of the summary | the summary |

The data section ends with a record that states the section's checksum; the summary and the footer follow. What a
command reads of a recording is in chunks and attachments: a change elsewhere in the section alters none of it.
"""

from __future__ import annotations

import os
import zlib
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, Final

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, AttachmentIndex, Chunk, ChunkIndex, Footer, MetadataIndex
from mcap.writer import MCAP0_MAGIC

from manyhands.design.files import open_regular
from manyhands.launch.recordings.mcap import (
    CRC,
    DAMAGED,
    FRAME,
    MOST_RECORD_BYTES,
    NO_MCAP,
    Unpacking,
    parts_of_chunk,
    record_of,
    records_in,
)
from manyhands.launch.recordings.recording import RecordingError

_OF_DATA: Final = {
    Opcode.CHUNK: "a chunk",
    Opcode.MESSAGE_INDEX: "a message index",
    Opcode.ATTACHMENT: "an attachment",
    Opcode.METADATA: "metadata",
    Opcode.DATA_END: "the end of the data",
}
"""The records that may follow the header; schemas, channels and messages are inside chunks."""

_DATA_END_BYTES: Final = FRAME.size + CRC.size
_FOOTER_BYTES: Final = FRAME.size + 20
_TAIL: Final = _FOOTER_BYTES + len(MCAP0_MAGIC)


@dataclass(frozen=True)
class Damage:
    """Something that is wrong with a file.

    Attributes:
        begin: the first byte of the damaged part.
        end: the first byte after it.
        what: what is wrong, a sentence without its full stop.
        cut: whether nothing was changed, and the file only ends before its recorder had written its end.
    """

    begin: int
    end: int
    what: str
    cut: bool = False

    def as_plain(self) -> dict[str, Any]:
        """As a JSON object."""
        return {"begin": self.begin, "end": self.end, "what": self.what}


def findings(path: Path, progress: Callable[[float], None] | None = None) -> list[Damage]:
    """What is wrong with a recording, in the order of its bytes; nothing if it is as it was written.

    Args:
        path: the file.
        progress: called with the part that is done, 0 to 1.

    Raises:
        RecordingError: the file cannot be read at all.
    """
    try:
        with open_regular(path) as file:
            found = _Examination(file).run(progress or (lambda _part: None))
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from error
    return sorted(found, key=lambda damage: (damage.begin, damage.end))


class _Examination:
    """The examination of one file: data section, end, and summary."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._size = os.fstat(file.fileno()).st_size
        self._tail_at = max(self._size - _TAIL, 0)  # where the footer begins
        tail = self._read(self._tail_at, self._size)
        self._footer, self._magic = tail[:_FOOTER_BYTES], tail[_FOOTER_BYTES:] == MCAP0_MAGIC
        framed = tail[: FRAME.size] == FRAME.pack(Opcode.FOOTER, _FOOTER_BYTES - FRAME.size) and len(tail) == _TAIL
        self._start = self._start_of_summary() if framed else None
        self._whole = len(tail) == _TAIL and (self._magic or framed)
        self._limit = self._size if not self._whole else self._tail_at if self._start is None else self._start
        self._chunks: dict[int, ChunkIndex] = {}
        self._known = self._indexed()
        self._unpacking = Unpacking()
        self._damages: list[Damage] = []
        self._readable = 0  # the data section is readable up to this byte
        self._end: int | None = None  # the first byte after its last record; None if it has none
        self._stated = self._actual = 0  # its checksum

    def _read(self, begin: int, end: int) -> bytes:
        self._file.seek(begin)
        return self._file.read(max(end - begin, 0))

    def _start_of_summary(self) -> int | None:
        """Where the summary begins, if the footer is right: its checksum agrees, or the data section ends there."""
        footer = Footer.read(ReadDataStream(BytesIO(self._footer[FRAME.size :])))
        start: int = footer.summary_start
        if not _DATA_END_BYTES <= start <= self._tail_at or self._tail_at - start > MOST_RECORD_BYTES:
            return None
        before = self._read(start - _DATA_END_BYTES, start)
        ends_there = before[: FRAME.size] == FRAME.pack(Opcode.DATA_END, CRC.size)
        return start if ends_there or self._summary_checksums(start)[0] == footer.summary_crc else None

    def _summary_checksums(self, start: int) -> tuple[int, int]:
        """The checksum of the summary and of its footer, up to the field that states it; and what it states."""
        (stated,) = CRC.unpack(self._footer[-CRC.size :])
        return zlib.crc32(self._footer[: -CRC.size], zlib.crc32(self._read(start, self._tail_at))), stated

    def _indexed(self) -> list[int]:
        """Where records of the data section begin by the summary, in order; none without one that agrees."""
        actual, stated = (0, 1) if self._start is None else self._summary_checksums(self._start)
        if self._start is None or actual != stated:
            return []
        found = {self._start - _DATA_END_BYTES}
        for opcode, body in records_in(self._read(self._start, self._tail_at)):
            match record_of(opcode, body):
                case ChunkIndex() as index:
                    self._chunks[index.chunk_start_offset] = index
                    found |= {index.chunk_start_offset, *index.message_index_offsets.values()}
                case AttachmentIndex(offset) | MetadataIndex(offset):
                    found.add(offset)
        return sorted(found)

    def run(self, progress: Callable[[float], None]) -> list[Damage]:
        """Examine the whole file."""
        magic = self._read(0, len(MCAP0_MAGIC))
        if magic != MCAP0_MAGIC:
            self._damages.append(Damage(0, len(magic), NO_MCAP))
        self._actual = zlib.crc32(magic)
        at: int | None = len(magic)
        self._readable = len(magic)
        while at is not None and at < self._limit and self._end is None:
            progress(at / self._limit)
            at = self._step(at)
        return [*self._damages, *self._after()]

    def _step(self, at: int) -> int | None:
        """Examine the record that begins at ``at``; returns where the next one begins, None if that is not known."""
        head = self._read(at, at + FRAME.size)
        opcode, length = FRAME.unpack(head) if len(head) == FRAME.size else (0, self._limit)
        end, place = at + FRAME.size + length, bisect_right(self._known, at)
        after = self._known[place] if place < len(self._known) else None
        first = at == len(MCAP0_MAGIC)
        if end > self._limit and not self._known:
            if self._whole:
                self._damages.append(Damage(at, self._limit, "found a record that is longer than the file"))
            return None
        if after not in (None, end) or end > self._limit:
            what = f"found a record up to byte {end}; expected one up to byte {after}, as the summary has it"
        elif (opcode == Opcode.HEADER) != first or not (first or opcode in _OF_DATA):
            expected = "a header" if first else ", ".join(_OF_DATA.values())
            what, after = f"found a record with opcode 0x{opcode:02x}; expected {expected}", after or self._next(end)
        else:
            what, after = self._content(at, opcode, head, end), end
        if what:
            self._damages.append(Damage(at, after or self._limit, what))
        self._readable = after or self._limit
        return after

    def _next(self, end: int) -> int | None:
        """``end``, if the bytes there look like the head of a record."""
        head = self._read(end, end + FRAME.size)
        opcode, length = FRAME.unpack(head) if len(head) == FRAME.size else (0, 0)
        return end if opcode in _OF_DATA and end + FRAME.size + length <= self._limit else None

    def _content(self, at: int, opcode: int, head: bytes, end: int) -> str:
        """What is wrong with the body of a record; empty where nothing is. Its bytes count for the section's checksum.

        The file is then at the record's body.
        """
        if end - at > MOST_RECORD_BYTES:
            return f"found a record of {end - at} bytes; expected at most {MOST_RECORD_BYTES}"
        body = self._file.read(end - at - FRAME.size)
        if opcode == Opcode.DATA_END:
            self._end, self._stated = end, CRC.unpack(body)[0] if len(body) == CRC.size else 0
            return "" if len(body) == CRC.size else "found an end of the data without its checksum; expected one"
        self._actual = zlib.crc32(body, zlib.crc32(head, self._actual))
        if opcode not in (Opcode.CHUNK, Opcode.ATTACHMENT):
            return ""
        record = record_of(opcode, body)
        if not isinstance(record, Chunk | Attachment):
            return f"found {_OF_DATA[Opcode(opcode)]} whose lengths, texts or checksum do not agree with each other"
        return self._chunk(at, record, body, end) if isinstance(record, Chunk) else ""

    def _chunk(self, at: int, chunk: Chunk, body: bytes, end: int) -> str:
        if chunk.uncompressed_crc == 0:
            return "found a chunk without a checksum; expected one"
        try:
            parts_of_chunk(body, self._unpacking, end)
        except DAMAGED as error:
            return f"found {error}" if isinstance(error, ValueError) else f"found a chunk that is damaged ({error})"
        found = chunk.message_start_time, chunk.message_end_time
        index = self._chunks.get(at)
        if index is not None and found != (expected := (index.message_start_time, index.message_end_time)):
            return f"found a chunk of times {found}; expected its messages', {expected}"
        return ""

    def _after(self) -> list[Damage]:
        """What is wrong with all but the single records: the section as a whole, its end, and the summary."""
        if not self._whole:
            return [self._cut()]
        found, end = [], self._end or self._start
        if not self._magic:
            what = "found a file that does not end as MCAP does"
            found.append(Damage(self._tail_at + _FOOTER_BYTES, self._size, what))
        if end is None:
            missing = Damage(self._readable, self._size, "found no end of the data; expected one")
            return found if found or self._damages else [missing]
        if self._start is not None and end < self._start:
            found.append(Damage(end, self._start, "found bytes between the data and its summary; expected none"))
        if not self._damages and self._actual != self._stated:
            found.append(self._of_the_section(end))
        if self._tail_at - end > MOST_RECORD_BYTES:
            return [*found, Damage(end, self._tail_at, f"found a summary longer than {MOST_RECORD_BYTES} bytes")]
        actual, stated = self._summary_checksums(end)
        if actual != stated:
            what = f"found a summary and a footer with the checksum {actual:08x}; expected {stated:08x}, as stated"
            found.append(Damage(end, self._tail_at + _FOOTER_BYTES, what))
        return found

    def _cut(self) -> Damage:
        at = self._readable
        if self._end is None:
            what = (
                f"the file ends at byte {self._size} without a recorder's end: it was cut, and is whole up to byte {at}"
            )
        else:
            what = f"the file ends within its summary: it was cut, and its data, up to byte {at}, is whole"
        return Damage(at, self._size, what, cut=True)

    def _of_the_section(self, end: int) -> Damage:
        """The section's checksum disagrees, where nothing else is wrong with it."""
        if self._end is None or self._stated == 0:
            return Damage(end - _DATA_END_BYTES, end, "found no checksum of the data; expected one")
        what = (
            f"found data with the checksum {self._actual:08x}; expected {self._stated:08x}, as stated. Each chunk and "
            "attachment agrees with its own, so the header, the session's metadata, a message index, the stated "
            "checksum, or a byte of a chunk that changes nothing in it was changed"
        )
        return Damage(0, end, what)
