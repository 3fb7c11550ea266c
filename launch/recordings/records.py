"""The records of an MCAP file as they lie on the disk, each held to the one way in which its content is written.

A record is an opcode, a length and a body. Whoever reads a file that may be damaged trusts none of them: lengths are
held against limits before memory is given to them, and a body counts as a record only if writing it anew gives the same
bytes, which also holds an attachment against its checksum.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from io import BytesIO
from typing import Final, cast

import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    MessageIndex,
    Metadata,
    MetadataIndex,
)

from manyhands.launch.recordings.stream import Unpacking, require_records

FRAME: Final = struct.Struct("<BQ")
"""Opcode, and length of the body that follows."""

_MESSAGE: Final = struct.Struct("<HIQ")  # channel, sequence, log time; publish time and data follow
_LEAST_BODY: Final = 2  # of a schema or a channel: its number
_MESSAGE_HEAD: Final = 22
_INDEX_ENTRY: Final = struct.Struct("<QQ")  # log time, offset in the chunk

_READERS: Final[Mapping[int, Callable[[ReadDataStream], McapRecord]]] = {
    Opcode.HEADER: Header.read,
    Opcode.FOOTER: Footer.read,
    Opcode.CHUNK: Chunk.read,
    Opcode.MESSAGE_INDEX: MessageIndex.read,
    Opcode.CHUNK_INDEX: ChunkIndex.read,
    Opcode.ATTACHMENT: Attachment.read,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex.read,
    Opcode.METADATA: Metadata.read,
    Opcode.METADATA_INDEX: MetadataIndex.read,
    Opcode.DATA_END: DataEnd.read,
}


def _bytes_of(record: McapRecord) -> bytes:
    """A record as it is written, with its opcode and length."""
    builder = RecordBuilder()
    record.write(builder)
    return cast(bytes, builder.end())  # type: ignore[no-untyped-call]  # mcap annotates arguments alone


def record_of(opcode: int, body: bytes) -> McapRecord | None:
    """The record of this body; None if it is none, or not written in the one way in which it would be."""
    reader = _READERS.get(opcode)
    if reader is None:
        return None
    try:
        record = reader(ReadDataStream(BytesIO(body)))
        return record if _bytes_of(record)[FRAME.size :] == body else None
    except (McapError, struct.error, ValueError, OverflowError):  # ValueError: a text that is none
        return None


def message_indexes(chunk: Chunk, unpacking: Unpacking, end: int) -> list[bytes]:
    """The message indexes that belong to a chunk which ends before byte ``end`` of its file, as they are written.

    The chunk is held against its size, its checksum and its times.

    Raises:
        ValueError: the chunk cannot be unpacked or disagrees with itself; the text says what was found.
    """
    if chunk.uncompressed_crc == 0:
        raise ValueError("found a chunk without a checksum; expected one")
    try:
        entries = _entries(unpacking.data(chunk, end), chunk)
    except zstandard.ZstdError as error:
        raise ValueError(f"found a chunk that cannot be unpacked ({error}); expected zstd") from error
    except ValueError as error:
        raise ValueError(f"found {error}") from error
    times = [time for listed in entries.values() for time, _ in listed]
    stated, actual = (chunk.message_start_time, chunk.message_end_time), (min(times, default=0), max(times, default=0))
    if stated != actual:
        raise ValueError(f"found a chunk of times {stated}; expected its messages', {actual}")
    return [_message_index(channel, listed) for channel, listed in entries.items()]


def _message_index(channel: int, listed: list[tuple[int, int]]) -> bytes:
    """The record that lists time and offset of each message of a channel."""
    body = struct.pack("<HI", channel, len(listed) * _INDEX_ENTRY.size)
    body += b"".join(_INDEX_ENTRY.pack(*entry) for entry in listed)
    return FRAME.pack(Opcode.MESSAGE_INDEX, len(body)) + body


def _entries(data: bytes, chunk: Chunk) -> dict[int, list[tuple[int, int]]]:
    """By channel, log time and offset of each message in the uncompressed bytes of a chunk.

    Raises:
        ValueError: the bytes are no schemas, channels and messages, or are more of them than there can be.
    """
    entries: dict[int, list[tuple[int, int]]] = {}
    at, size, count = 0, len(data), 0
    while at < size:
        count += 1
        require_records(count, chunk)
        if size - at < FRAME.size:
            raise ValueError(f"{size - at} bytes behind the chunk's last record")
        opcode, length = FRAME.unpack_from(data, at)
        begin = at + FRAME.size
        if length > size - begin:
            raise ValueError("a record in the chunk that is longer than the chunk")
        if opcode == Opcode.MESSAGE and length >= _MESSAGE_HEAD:
            channel, _, time = _MESSAGE.unpack_from(data, begin)
            entries.setdefault(channel, []).append((time, at))
        elif opcode not in (Opcode.SCHEMA, Opcode.CHANNEL) or length < _LEAST_BODY:
            raise ValueError(f"a record in the chunk with opcode 0x{opcode:02x} that is none")
        at = begin + length
    return entries
