"""The data section of a recording, record by record: which of them are damaged, and where the section ends."""

from __future__ import annotations

import zlib
from bisect import bisect_right
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import BinaryIO, Final

from mcap.opcode import Opcode
from mcap.records import Attachment, Chunk, DataEnd, Header, Metadata
from mcap.writer import MCAP0_MAGIC

from manyhands.launch.recordings.records import FRAME, message_indexes, record_of
from manyhands.launch.recordings.stream import MOST_RECORD_BYTES, Unpacking
from manyhands.nodes.recorder.layout import METADATA, Recorded

_OF_DATA: Final = {
    Opcode.CHUNK: "a chunk",
    Opcode.MESSAGE_INDEX: "a message index",
    Opcode.ATTACHMENT: "an attachment",
    Opcode.METADATA: "metadata",
    Opcode.DATA_END: "the end of the data",
}
"""What stands behind the header; schemas, channels and messages are in chunks."""

DATA_END_BYTES: Final = FRAME.size + 4
_LIBRARY: Final = "manyhands"
_PIECE: Final = 2**20


@dataclass(frozen=True)
class Damage:
    """Something that is wrong with a file.

    Attributes:
        begin: the first byte of what it is wrong with.
        end: the first byte behind it.
        what: what is wrong, a sentence without its full stop.
    """

    begin: int
    end: int
    what: str


@dataclass
class DataSection:
    """What a walk through the records found.

    Attributes:
        damages: what is wrong.
        whole_to: up to which byte there are records.
        end: the first byte behind the section's last record; None where none ends it.
        checksum: that its last record states.
    """

    damages: list[Damage] = field(default_factory=list)
    whole_to: int = 0
    end: int | None = None
    checksum: int = 0


class _Wrong(Exception):
    """A record is not as it should be; says how."""


class Walk:
    """Goes through the records of a file's data section."""

    def __init__(self, file: BinaryIO, limit: int, known: Callable[[], list[int]]) -> None:
        """Of a file that is open at any place.

        Args:
            file: the file.
            limit: where at the latest the section ends.
            known: tells where records begin, by the file's own summary, in order: there the walk goes on after one
                whose length is not to be believed. Asked when it is needed, and once.
        """
        self._file, self._limit, self._ask = file, limit, known
        self._out = DataSection()
        self._unpacking = Unpacking()
        self._awaited: deque[bytes] | None = deque()  # message indexes to come; None where that is not known

    def run(self, progress: Callable[[float], None]) -> DataSection:
        """Go through it; ``progress`` gets the part that is done."""
        out, limit = self._out, self._limit
        self._file.seek(0)
        magic = self._file.read(len(MCAP0_MAGIC))
        if magic != MCAP0_MAGIC:
            self._tell(0, len(magic), "found a file that does not begin as MCAP does; expected a recording")
        out.whole_to = len(magic)
        at: int | None = out.whole_to
        while at is not None and at < limit and out.end is None:
            progress(at / limit)
            at = self._step(at)
        return out

    def _tell(self, begin: int, end: int, what: str) -> None:
        self._out.damages.append(Damage(begin, end, what))

    def _step(self, at: int) -> int | None:
        """Look at the record that begins at ``at``; returns where the next one does, None if that is not known."""
        head = self._head(at)
        if head is None or head[1] > self._limit:
            after, self._awaited = self._resume(at), None
            if after is None and not self._known:
                return None  # the file ends here, which its reader tells
            self._tell(at, after or self._limit, "found a record that is longer than the file; expected one within it")
            return after
        opcode, end = head
        body = self._file.read(end - at - FRAME.size)
        if opcode == Opcode.DATA_END and len(body) == DATA_END_BYTES - FRAME.size:
            self._end(at, body)
            return end
        try:
            self._take(at, opcode, body)
        except _Wrong as wrong:
            followed = end == self._limit or self._plausible(end)
            after = end if followed else self._resume(at)
            self._tell(at, after or self._limit, str(wrong))
            if self._awaited and followed and opcode != Opcode.CHUNK:
                self._awaited.popleft()  # it was this one, then
            else:
                self._awaited = None
            self._out.whole_to = after or self._limit
            return after
        self._out.whole_to = end
        return end

    def _head(self, at: int) -> tuple[int, int] | None:
        """Opcode and end of the record that begins at ``at``; the file is then at its body."""
        self._file.seek(at)
        head = self._file.read(FRAME.size)
        if len(head) < FRAME.size:
            return None
        opcode, length = FRAME.unpack(head)
        return opcode, at + FRAME.size + length

    def _plausible(self, at: int) -> bool:
        """Whether a record begins here, by its head."""
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
            self._tell(
                at, at, f"found no message index for {len(self._awaited)} channels of the chunk before; expected one"
            )
        self._awaited = deque()

    def _take(self, at: int, opcode: int, body: bytes) -> None:
        first = at == len(MCAP0_MAGIC)
        if len(body) > MOST_RECORD_BYTES:
            raise _Wrong(f"found a record of {len(body)} bytes; expected at most {MOST_RECORD_BYTES}")
        if (opcode == Opcode.HEADER) != first or not (first or opcode in _OF_DATA):
            expected = "a header" if first else ", ".join(_OF_DATA.values())
            raise _Wrong(f"found a record with opcode 0x{opcode:02x}; expected {expected}")
        record = record_of(opcode, body)
        if opcode != Opcode.MESSAGE_INDEX and record is not None:
            self._all_indexed(at)
        match record:
            case Header(profile, library):
                if profile or not library.startswith(_LIBRARY):
                    raise _Wrong(f"found profile {profile!r:.40}, library {library!r:.40}; expected '', {_LIBRARY!r}")
            case Chunk():
                self._chunk(record, at + FRAME.size + len(body))
            case Attachment():
                pass  # to be read at all, it agrees with its checksum
            case Metadata(name, texts):
                self._session(name, texts)
            case _ if opcode == Opcode.MESSAGE_INDEX:
                self._index(at, FRAME.pack(opcode, len(body)) + body)
            case _:
                kind = "a header" if first else _OF_DATA[Opcode(opcode)]
                raise _Wrong(f"found {kind} whose lengths, texts or checksum do not agree with each other")

    @staticmethod
    def _session(name: str, texts: dict[str, str]) -> None:
        if name != METADATA:
            raise _Wrong(f"found metadata of the name {name!r:.40}; expected {METADATA!r}")
        try:
            Recorded.from_metadata(texts)
        except ValueError as error:
            raise _Wrong(str(error)) from error

    def _chunk(self, chunk: Chunk, end: int) -> None:
        try:
            self._awaited = deque(message_indexes(chunk, self._unpacking, end))
        except ValueError as error:
            raise _Wrong(str(error)) from error

    def _index(self, at: int, found: bytes) -> None:
        if self._awaited is None:  # the chunk cannot be read: its indexes may be right
            if record_of(Opcode.MESSAGE_INDEX, found[FRAME.size :]) is None:
                raise _Wrong("found a message index whose lengths do not agree with each other")
            return
        if not self._awaited:
            raise _Wrong("found a message index of no chunk; expected as many as the chunk before has channels")
        if found != self._awaited[0]:
            raise _Wrong("found a message index that does not agree with the messages of its chunk")
        self._awaited.popleft()


def checksum_of(file: BinaryIO, end: int) -> int:
    """CRC-32 of a file up to ``end``."""
    file.seek(0)
    crc, left = 0, end
    while left > 0 and (piece := file.read(min(left, _PIECE))):
        crc = zlib.crc32(piece, crc)
        left -= len(piece)
    return crc
