"""The records of an MCAP file as they lie on the disk, each held to the one way in which its content is written.

A record is an opcode, a length and a body. Whoever reads a file that may be damaged trusts none of them: lengths are
held against limits before memory is given to them, and a body counts as a record only if writing it anew gives the same
bytes, which also holds an attachment against its checksum.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from io import BytesIO
from typing import Final, cast

import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from manyhands.launch.recordings.stream import Unpacking, require_records

FRAME: Final = struct.Struct("<BQ")
"""Opcode, and length of the body that follows."""

_MESSAGE: Final = struct.Struct("<HIQ")  # channel, sequence, log time; publish time and data follow
_NUMBER: Final = struct.Struct("<H")  # of a schema or a channel, first in either
_MESSAGE_HEAD: Final = 22
_INDEX_ENTRY: Final = struct.Struct("<QQ")  # log time, offset in the chunk

_READERS: Final[Mapping[int, Callable[[ReadDataStream], McapRecord]]] = {
    Opcode.HEADER: Header.read,
    Opcode.FOOTER: Footer.read,
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.CHUNK: Chunk.read,
    Opcode.MESSAGE_INDEX: MessageIndex.read,
    Opcode.CHUNK_INDEX: ChunkIndex.read,
    Opcode.ATTACHMENT: Attachment.read,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex.read,
    Opcode.STATISTICS: Statistics.read,
    Opcode.METADATA: Metadata.read,
    Opcode.METADATA_INDEX: MetadataIndex.read,
    Opcode.SUMMARY_OFFSET: SummaryOffset.read,
    Opcode.DATA_END: DataEnd.read,
}


def bytes_of(record: McapRecord) -> bytes:
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
        return record if bytes_of(record)[FRAME.size :] == body else None
    except (McapError, struct.error, ValueError, OverflowError):  # ValueError: a text that is none
        return None


@dataclass
class Content:
    """What a chunk holds.

    Attributes:
        schemas: by number, in order, as they are written.
        channels: likewise.
        counts: messages by channel, in the order of their first ones.
        first: least log time of a message, 0 without any.
        last: greatest likewise.
        indexes: by channel, the message index that belongs to the chunk, as it is written.
    """

    schemas: dict[int, bytes] = field(default_factory=dict)
    channels: dict[int, bytes] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    first: int = 0
    last: int = 0
    indexes: dict[int, bytes] = field(default_factory=dict)


def content_in(chunk: Chunk, unpacking: Unpacking, end: int) -> Content:
    """What a chunk that ends before byte ``end`` of its file holds, held against its size, its checksum and its times.

    Raises:
        ValueError: it cannot be had, or is another; says what was found.
    """
    if chunk.uncompressed_crc == 0:
        raise ValueError("found a chunk without a checksum; expected one")
    try:
        content = _content_of(unpacking.data(chunk, end), chunk)
    except zstandard.ZstdError as error:
        raise ValueError(f"found a chunk that cannot be unpacked ({error}); expected zstd") from error
    except ValueError as error:
        raise ValueError(f"found {error}") from error
    stated = chunk.message_start_time, chunk.message_end_time
    if stated != (content.first, content.last):
        raise ValueError(f"found a chunk of times {stated}; expected its messages', {content.first, content.last}")
    return content


def _content_of(data: bytes, chunk: Chunk) -> Content:
    """What the uncompressed bytes of a chunk hold.

    Raises:
        ValueError: they are no schemas, channels and messages, or more of them than can be.
    """
    out = Content()
    entries: dict[int, bytearray] = {}
    times: list[int] = []
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
            entries.setdefault(channel, bytearray()).extend(_INDEX_ENTRY.pack(time, at))
            times.append(time)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL) and length >= _NUMBER.size:
            (number,) = _NUMBER.unpack_from(data, begin)
            (out.schemas if opcode == Opcode.SCHEMA else out.channels)[number] = data[at : begin + length]
        else:
            raise ValueError(f"a record in the chunk with opcode 0x{opcode:02x} that is none")
        at = begin + length
    if times:
        out.first, out.last = min(times), max(times)
    for channel, listed in entries.items():
        body = struct.pack("<HI", channel, len(listed)) + listed
        out.indexes[channel] = FRAME.pack(Opcode.MESSAGE_INDEX, len(body)) + body
        out.counts[channel] = len(listed) // _INDEX_ENTRY.size
    return out
