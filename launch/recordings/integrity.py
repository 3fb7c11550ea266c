"""Finds where a recording was changed or cut: the checksums of its format locate each change to a chunk or a record.

| part of the file | what checks it | a change is located to |
|---|---|---|
| chunk, attachment | its own checksum | the record |
| message index | the messages of the chunk before it | the record |
| header, session's metadata, framing | being readable; the checksum of the data section | the record; the section |
| summary and footer | the checksum of the summary | the summary |

The data section ends with a record that states the section's checksum; the summary and the footer follow. :class:`Walk`
goes through the data section record by record. :func:`findings` examines the whole file.
"""

from __future__ import annotations

import os
import zlib
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import BinaryIO, Final

from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
)
from mcap.writer import MCAP0_MAGIC

from manyhands.design.files import open_regular
from manyhands.launch.recordings.mcap import FRAME, MOST_RECORD_BYTES, NO_MCAP, Unpacking, message_indexes, record_of
from manyhands.launch.recordings.recording import RecordingError
from manyhands.nodes.recorder.format import METADATA, Recorded

_OF_DATA: Final = {
    Opcode.CHUNK: "a chunk",
    Opcode.MESSAGE_INDEX: "a message index",
    Opcode.ATTACHMENT: "an attachment",
    Opcode.METADATA: "metadata",
    Opcode.DATA_END: "the end of the data",
}
"""The records that may follow the header; schemas, channels and messages are inside chunks."""

DATA_END_BYTES: Final = FRAME.size + 4
_LIBRARY: Final = "manyhands"
_PIECE: Final = 2**20


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


@dataclass
class DataSection:
    """The result of a walk through the records.

    Attributes:
        damages: what is wrong.
        whole_to: the records are readable up to this byte.
        end: the first byte after the section's last record; None if the section has no such record.
        checksum: the checksum that the last record states.
    """

    damages: list[Damage] = field(default_factory=list)
    whole_to: int = 0
    end: int | None = None
    checksum: int = 0


class _WrongRecord(Exception):
    """A record is wrong; the message states how."""


class Walk:
    """Goes through the records of a file's data section."""

    def __init__(self, file: BinaryIO, limit: int, known: Callable[[], list[int]]) -> None:
        """Prepare a walk through an open file; its position does not matter.

        Args:
            file: the file.
            limit: the last byte at which the section may end.
            known: returns the beginnings of records by the file's own summary, in order. After a record with an
                impossible length the walk resumes there. Called at most once, when it is needed.
        """
        self._file, self._limit, self._ask = file, limit, known
        self._out = DataSection()
        self._unpacking = Unpacking()
        self._awaited: deque[bytes] | None = deque()  # expected message indexes; None where they are not known

    def run(self, progress: Callable[[float], None]) -> DataSection:
        """Go through the section; ``progress`` is called with the part that is done, 0 to 1."""
        out, limit = self._out, self._limit
        self._file.seek(0)
        magic = self._file.read(len(MCAP0_MAGIC))
        if magic != MCAP0_MAGIC:
            self._damaged(0, len(magic), NO_MCAP)
        out.whole_to = len(magic)
        at: int | None = out.whole_to
        while at is not None and at < limit and out.end is None:
            progress(at / limit)
            at = self._step(at)
        return out

    def _damaged(self, begin: int, end: int, what: str) -> None:
        self._out.damages.append(Damage(begin, end, what))

    def _step(self, at: int) -> int | None:
        """Examine the record that begins at ``at``; returns where the next one begins, None if that is not known."""
        head = self._head(at)
        if head is None or head[1] > self._limit:
            after, self._awaited = self._resume(at), None
            if after is None and not self._known:
                return None  # the file ends here, which the examination reports
            self._damaged(
                at, after or self._limit, "found a record that is longer than the file; expected one within it"
            )
            return after
        opcode, end = head
        body = self._file.read(end - at - FRAME.size)
        if opcode == Opcode.DATA_END and len(body) == DATA_END_BYTES - FRAME.size:
            self._end(at, body)
            return end
        try:
            self._take(at, opcode, body)
        except _WrongRecord as wrong:
            if self._awaited and opcode != Opcode.CHUNK and self._plausible(own := at + len(self._awaited[0])):
                end = own  # so long is the index that was expected here; a length that was changed may reach further
            followed = end == self._limit or self._plausible(end)
            after = end if followed else self._resume(at)
            self._damaged(at, after or self._limit, str(wrong))
            if self._awaited and followed and opcode != Opcode.CHUNK:
                self._awaited.popleft()  # the wrong record stands where this index was expected
            else:
                self._awaited = None
            self._out.whole_to = after or self._limit
            return after
        self._out.whole_to = end
        return end

    def _head(self, at: int) -> tuple[int, int] | None:
        """Opcode and end of the record that begins at ``at``; the file's position is then at its body."""
        self._file.seek(at)
        head = self._file.read(FRAME.size)
        if len(head) < FRAME.size:
            return None
        opcode, length = FRAME.unpack(head)
        return opcode, at + FRAME.size + length

    def _plausible(self, at: int) -> bool:
        """Whether the bytes at ``at`` look like the head of a record."""
        head = self._head(at)
        return head is not None and head[0] in _OF_DATA and head[1] <= self._limit

    @cached_property
    def _known(self) -> list[int]:
        return self._ask()

    def _resume(self, at: int) -> int | None:
        place = bisect_right(self._known, at)
        return self._known[place] if place < len(self._known) else None

    def _end(self, at: int, body: bytes) -> None:
        self._all_indexed(at)
        record = record_of(Opcode.DATA_END, body)
        self._out.checksum = record.data_section_crc if isinstance(record, DataEnd) else 0
        self._out.end = self._out.whole_to = at + DATA_END_BYTES

    def _all_indexed(self, at: int) -> None:
        if self._awaited:
            self._damaged(
                at, at, f"found no message index for {len(self._awaited)} channels of the chunk before; expected one"
            )
        self._awaited = deque()

    def _take(self, at: int, opcode: int, body: bytes) -> None:
        first = at == len(MCAP0_MAGIC)
        if len(body) > MOST_RECORD_BYTES:
            raise _WrongRecord(f"found a record of {len(body)} bytes; expected at most {MOST_RECORD_BYTES}")
        if (opcode == Opcode.HEADER) != first or not (first or opcode in _OF_DATA):
            expected = "a header" if first else ", ".join(_OF_DATA.values())
            raise _WrongRecord(f"found a record with opcode 0x{opcode:02x}; expected {expected}")
        record = record_of(opcode, body)
        if opcode != Opcode.MESSAGE_INDEX and record is not None:
            self._all_indexed(at)
        match record:
            case Header(profile, library):
                if profile or not library.startswith(_LIBRARY):
                    raise _WrongRecord(
                        f"found profile {profile!r:.40}, library {library!r:.40}; expected '', {_LIBRARY!r}"
                    )
            case Chunk():
                self._chunk(record, at + FRAME.size + len(body))
            case Attachment():
                pass  # it could be read, so it agrees with its checksum
            case Metadata(name, texts):
                self._session(name, texts)
            case _ if opcode == Opcode.MESSAGE_INDEX:
                self._index(at, FRAME.pack(opcode, len(body)) + body)
            case _:
                kind = "a header" if first else _OF_DATA[Opcode(opcode)]
                raise _WrongRecord(f"found {kind} whose lengths, texts or checksum do not agree with each other")

    @staticmethod
    def _session(name: str, texts: dict[str, str]) -> None:
        if name != METADATA:
            raise _WrongRecord(f"found metadata of the name {name!r:.40}; expected {METADATA!r}")
        try:
            Recorded.from_metadata(texts)
        except ValueError as error:
            raise _WrongRecord(str(error)) from error

    def _chunk(self, chunk: Chunk, end: int) -> None:
        try:
            self._awaited = deque(message_indexes(chunk, self._unpacking, end))
        except ValueError as error:
            raise _WrongRecord(str(error)) from error

    def _index(self, at: int, found: bytes) -> None:
        if self._awaited is None:  # the chunk cannot be read, so its indexes cannot be compared
            if record_of(Opcode.MESSAGE_INDEX, found[FRAME.size :]) is None:
                raise _WrongRecord("found a message index whose lengths do not agree with each other")
            return
        if not self._awaited:
            raise _WrongRecord("found a message index of no chunk; expected as many as the chunk before has channels")
        if found != self._awaited[0]:
            raise _WrongRecord("found a message index that does not agree with the messages of its chunk")
        self._awaited.popleft()


def checksum_of(file: BinaryIO, end: int) -> int:
    """CRC-32 of a file up to ``end``."""
    file.seek(0)
    crc, left = 0, end
    while left > 0 and (piece := file.read(min(left, _PIECE))):
        crc = zlib.crc32(piece, crc)
        left -= len(piece)
    return crc


_CRC_BYTES: Final = 4
_FOOTER_BYTES: Final = FRAME.size + 20
_TAIL: Final = _FOOTER_BYTES + len(MCAP0_MAGIC)


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
        self._footer_bytes = tail[:_FOOTER_BYTES]
        self._magic = tail[_FOOTER_BYTES:] == MCAP0_MAGIC
        footer = record_of(tail[0], tail[FRAME.size : _FOOTER_BYTES]) if len(tail) == _TAIL else None
        framed = tail[: FRAME.size] == FRAME.pack(Opcode.FOOTER, _FOOTER_BYTES - FRAME.size)
        self._footer = footer if framed and isinstance(footer, Footer) else None
        self._start = None if self._footer is None else self._trusted(self._footer)

    def _read(self, begin: int, end: int) -> bytes:
        self._file.seek(begin)
        return self._file.read(max(end - begin, 0))

    def _trusted(self, footer: Footer) -> int | None:
        """Where the summary begins, if the footer is right: its checksum agrees, or the data section ends there."""
        start = footer.summary_start
        if not DATA_END_BYTES <= start <= self._tail_at or self._tail_at - start > MOST_RECORD_BYTES:
            return None
        before = self._read(start - DATA_END_BYTES, start)
        if before[: FRAME.size] == FRAME.pack(Opcode.DATA_END, DATA_END_BYTES - FRAME.size):
            return start
        return (
            start if _footer_crc(self._read(start, self._tail_at), self._footer_bytes) == footer.summary_crc else None
        )

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
        """Examine the whole file."""
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
                f"the file ends at byte {self._size} without a recorder's end: it was cut, and is whole up to byte {at}"
            )
        else:
            what = f"the file ends within its summary: it was cut, and its data, up to byte {at}, is whole"
        return Damage(at, self._size, what, cut=True)

    def _checksum(self, stated: int, end: int) -> list[Damage]:
        """Compare the data section with its checksum, when nothing else is wrong with it."""
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
        """Compare summary and footer with their checksum."""
        if self._tail_at - start > MOST_RECORD_BYTES:
            return [Damage(start, self._tail_at, f"found a summary longer than {MOST_RECORD_BYTES} bytes")]
        actual = _footer_crc(self._read(start, self._tail_at), self._footer_bytes)
        stated = int.from_bytes(self._footer_bytes[-_CRC_BYTES:], "little")
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
    """The checksum of a summary and of its footer, up to the field that states it."""
    return zlib.crc32(footer[: _FOOTER_BYTES - _CRC_BYTES], zlib.crc32(summary))
