"""The records of an MCAP file as they lie on the disk, each held to the one way in which its content is written.

A record is an opcode, a length and a body. Whoever reads a file that may be damaged trusts none of them: lengths are
held against limits before memory is given to them, and a body counts as a record only if writing it anew gives the same
bytes, which also holds an attachment against its checksum.
"""

from __future__ import annotations

import struct
import zlib
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

FRAME: Final = struct.Struct("<BQ")
"""Opcode, and length of the body that follows."""

MOST_RECORD_BYTES: Final = 256 * 2**20
"""Longest record that is read; a recorder's are little longer than a mebibyte."""

MOST_CHUNK_BYTES: Final = 64 * 2**20
"""Longest content of a chunk, uncompressed; a recorder closes its chunks at a mebibyte or soon after."""

COMPRESSED: Final = "zstd"
"""How recorders compress their chunks, as the chunk says it."""

_MOST_WINDOW_BYTES: Final = 128 * 2**20  # that a compressed chunk may ask a reader to keep
_MESSAGE: Final = struct.Struct("<HIQ")  # channel, sequence, log time; publish time and data follow
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
        schemas: by number, in order.
        channels: likewise.
        counts: messages by channel, in the order of their first ones.
        first: least log time of a message, 0 without any.
        last: greatest likewise.
        indexes: by channel, the message index that belongs to the chunk, as it is written.
    """

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    first: int = 0
    last: int = 0
    indexes: dict[int, bytes] = field(default_factory=dict)


def uncompressed(chunk: Chunk) -> bytes:
    """The content of a chunk, held against its size and its checksum.

    Raises:
        ValueError: it cannot be had, or is another; says what was found.
    """
    if chunk.compression not in (COMPRESSED, ""):
        raise ValueError(f"found the compression {chunk.compression!r:.40}; expected {COMPRESSED!r}")
    if chunk.uncompressed_size > MOST_CHUNK_BYTES:
        raise ValueError(f"found a chunk of {chunk.uncompressed_size} bytes; expected at most {MOST_CHUNK_BYTES}")
    data = chunk.data
    if chunk.compression:
        try:
            with zstandard.ZstdDecompressor(max_window_size=_MOST_WINDOW_BYTES).stream_reader(data) as reader:
                data = reader.read(chunk.uncompressed_size + 1)
        except zstandard.ZstdError as error:
            raise ValueError(f"cannot be uncompressed: {error}") from error
    if len(data) != chunk.uncompressed_size:
        raise ValueError(f"found content that is not of {chunk.uncompressed_size} bytes; expected as many")
    if zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("found content that does not agree with its checksum")
    return data


def content_of(data: bytes) -> Content:
    """What the uncompressed bytes of a chunk hold.

    Raises:
        ValueError: they are no schemas, channels and messages.
    """
    out = Content()
    entries: dict[int, bytearray] = {}
    times: list[int] = []
    at, size = 0, len(data)
    while at < size:
        if size - at < FRAME.size:
            raise ValueError(f"found {size - at} bytes behind the chunk's last record; expected none")
        opcode, length = FRAME.unpack_from(data, at)
        begin = at + FRAME.size
        if length > size - begin:
            raise ValueError("found a record in the chunk that is longer than the chunk")
        if opcode == Opcode.MESSAGE and length >= _MESSAGE_HEAD:
            channel, _, time = _MESSAGE.unpack_from(data, begin)
            entries.setdefault(channel, bytearray()).extend(_INDEX_ENTRY.pack(time, at))
            times.append(time)
        else:
            match record_of(opcode, data[begin : begin + length]):
                case Schema() as schema:
                    out.schemas[schema.id] = schema
                case Channel() as told:
                    out.channels[told.id] = told
                case _:
                    raise ValueError(f"found a record in the chunk with opcode {opcode} that is none")
        at = begin + length
    if times:
        out.first, out.last = min(times), max(times)
    for channel, listed in entries.items():
        body = struct.pack("<HI", channel, len(listed)) + listed
        out.indexes[channel] = FRAME.pack(Opcode.MESSAGE_INDEX, len(body)) + body
        out.counts[channel] = len(listed) // _INDEX_ENTRY.size
    return out
