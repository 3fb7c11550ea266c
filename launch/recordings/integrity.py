"""What is wrong with a recording: every byte is held against the others, and what disagrees is named by its place.

The chunks and attachments have checksums; all else follows from them. A message index is what the messages of its chunk
make it, the summary is what the data section makes it, the footer is what both make it: each is written anew, in the
one way in which recorders write it, and compared. What remains, the header, the session's metadata, and the few bytes
of a compressed chunk that do not matter to its content, is covered by the checksum of the whole data section, from
whose syndrome follows where a single byte was changed (:mod:`manyhands.launch.recordings.syndrome`).
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO, Final

from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, ChunkIndex, Footer, MetadataIndex
from mcap.writer import MCAP0_MAGIC

from manyhands.design.files import open_regular
from manyhands.launch.recordings.data_section import DATA_END_BYTES, Damage, DataSection, Walk, checksum_of
from manyhands.launch.recordings.implied import SUMMARY_RECORDS, implied, records_in
from manyhands.launch.recordings.recording import RecordingError
from manyhands.launch.recordings.records import FRAME, bytes_of, record_of
from manyhands.launch.recordings.stream import MOST_RECORD_BYTES
from manyhands.launch.recordings.syndrome import changed_bytes

__all__ = ["Damage", "findings"]

_FOOTER_BYTES: Final = FRAME.size + 20
_TAIL: Final = _FOOTER_BYTES + len(MCAP0_MAGIC)
_MOST_PLACES: Final = 8  # that are told of, where one changed byte could be at any of them


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
        for opcode, body in records_in(self._read(self._start, self._tail_at)):
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
        return found + self._summary(section, end)

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
        behind = end + DATA_END_BYTES
        actual = checksum_of(self._file, end)
        if actual == stated:
            return []
        if stated == 0:
            return [Damage(end, behind, "found no checksum of the data; expected one")]
        disagree = f"the data's checksum is {actual:08x}, and {stated:08x} is stated"
        found = [Damage(0, behind, f"{disagree}: something in it was changed that no other check can tell")]
        syndrome = actual ^ stated
        places = changed_bytes(syndrome, end, _MOST_PLACES + 1)
        if len(places) > _MOST_PLACES:
            return found
        if sum(byte != 0 for byte in syndrome.to_bytes(4, "little")) == 1:
            found.append(
                Damage(end, behind, "if one byte was changed, it may be one of the stated checksum of the data")
            )
        for place in places:
            begin, after = self._record_at(place)
            found.append(Damage(begin, after, f"if one byte was changed, it may be byte {place}, in the record here"))
        return found

    def _record_at(self, place: int) -> tuple[int, int]:
        """The record that holds the byte at ``place``, in a section whose records are in order."""
        begin, end = 0, len(MCAP0_MAGIC)
        while end <= place:
            begin = end
            end += FRAME.size + int.from_bytes(self._read(begin + 1, begin + FRAME.size), "little")
        return begin, end

    def _summary(self, section: DataSection, start: int) -> list[Damage]:
        """Hold summary and footer against what the data section implies, or at least against their checksum."""
        if self._tail_at - start > MOST_RECORD_BYTES:
            return [Damage(start, self._tail_at, f"found a summary longer than {MOST_RECORD_BYTES} bytes")]
        told = self._read(start, self._tail_at)
        if any(damage.begin >= len(MCAP0_MAGIC) for damage in section.damages):
            if self._footer is not None and self._footer.summary_crc == _footer_crc(told, self._told):
                return []
            return [Damage(start, self._tail_at + _FOOTER_BYTES, "the checksum of the summary disagrees with it")]
        records, offset_start = implied(section, start, told)
        expected = b"".join(records)
        found = []
        at = 0
        for record in records:
            if told[at : at + len(record)] != record:
                what = f"found {SUMMARY_RECORDS[Opcode(record[0])]} in the summary that disagrees with the data"
                if len(told) != len(expected):
                    found.append(Damage(start + at, self._tail_at, f"{what}, in a summary of another length"))
                    break
                found.append(Damage(start + at, start + at + len(record), what))
            at += len(record)
        else:
            if at < len(told):
                found.append(Damage(start + at, self._tail_at, "found more in the summary than the data implies"))
        footer = bytes_of(Footer(start, offset_start, 0))
        footer = bytes_of(Footer(start, offset_start, _footer_crc(expected, footer)))
        if self._told != footer:
            what = "found a footer that disagrees with the summary; expected its places and its checksum"
            found.append(Damage(self._tail_at, self._tail_at + _FOOTER_BYTES, what))
        return found


def _footer_crc(summary: bytes, footer: bytes) -> int:
    """The checksum of a summary and of its footer up to where it states it."""
    return zlib.crc32(footer[: _FOOTER_BYTES - 4], zlib.crc32(summary))
