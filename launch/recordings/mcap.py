"""Reads the records of a recording one after the other, from a whole file or from one that was cut anywhere.

A killed recorder, a full disk or a power failure leaves a file without its end. Its whole chunks are read, and the last
part reports where the file ends and why.

The file may come from anywhere, so nothing in it is trusted. A record is an opcode, a length and a body. Lengths are
compared with the file's size and with limits before memory is allocated. Chunks are compared with their checksums, and
no more is unpacked than a chunk states.

:func:`record_of` serves the check of the bytes. It accepts a body only if writing its record anew gives the same bytes,
which also compares an attachment with its checksum.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple, TypeAlias, cast

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
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
)
from mcap.writer import MCAP0_MAGIC

from manyhands.design.files import open_regular
from manyhands.launch.recordings.recording import RecordingError

NO_MCAP: Final = (
    "found a file that does not begin as MCAP does; expected an .mcap recording, of launch --record or of record"
)
"""What is wrong with another file that was given for a recording, such as the .npz of a simulation."""

MOST_RECORD_BYTES: Final = 64 * 2**20
"""The longest record that is read, and the most that a chunk may hold unpacked; a recorder writes one mebibyte or a
few."""

_UNPACKED_ANYWAY: Final = 16 * 2**20
_UNPACKED_PER_BYTE: Final = 1000
"""Bytes that the chunks of a file may unpack to, per byte of the file. A recorder's session of 2048 ports at rest
reaches 700."""

FRAME: Final = struct.Struct("<BQ")
"""Opcode and length of the body that follows."""

CRC: Final = struct.Struct("<I")
"""A checksum, CRC-32."""

_MESSAGE: Final = struct.Struct("<HIQQ")  # channel, sequence, log_time, publish_time

DAMAGED: Final = (McapError, struct.error, ValueError, OverflowError, zstandard.ZstdError)
"""What reading a record raises that is none."""


class Message(NamedTuple):
    """One message: its channel's number, sequence number and log time (ns), and its data as the recorder wrote it."""

    channel: int
    sequence: int
    log_time: int
    data: bytes


class Messages(NamedTuple):
    """The messages of one chunk, in the chunk's order."""

    messages: list[Message]


class End(NamedTuple):
    """The end of reading; ``why`` states a reason if it is not the file's regular end."""

    why: str | None


Part: TypeAlias = Metadata | Attachment | Schema | Channel | Messages | End


@dataclass(frozen=True)
class ChannelMessage:
    """One message with its channel."""

    channel: Channel
    message: Message


def parts(path: Path, progress: Callable[[float], None] | None = None) -> Iterator[Part]:
    """The metadata, attachments, schemas, channels and messages of a file in its own order, then one :class:`End`.

    A channel comes before its first message, unless the file is damaged. Message indexes and the summary at the end are
    skipped: they contain nothing new.

    Args:
        path: the file.
        progress: called with the part of the file that was read, 0 to 1.

    Raises:
        RecordingError: the file cannot be read, or does not begin as MCAP does.
    """
    try:
        with open_regular(path) as file:
            if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
                raise RecordingError(f"{path}: {NO_MCAP}")
            yield from _parts(file, progress)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from error


def messages(path: Path, progress: Callable[[float], None] | None = None) -> Iterator[ChannelMessage | End]:
    """The messages of a file one by one with their channels, then one :class:`End`; arguments as of :func:`parts`.

    Raises:
        RecordingError: as :func:`parts`.
    """
    channels: dict[int, Channel] = {}
    for part in parts(path, progress):
        match part:
            case Channel():
                channels[part.id] = part
            case Messages(found):
                for message in found:
                    if message.channel in channels:
                        yield ChannelMessage(channels[message.channel], message)
            case End():
                yield part


def _parts(file: BinaryIO, progress: Callable[[float], None] | None) -> Iterator[Part]:
    at, size = file.tell(), os.fstat(file.fileno()).st_size
    checksum = zlib.crc32(MCAP0_MAGIC)
    unpacking = Unpacking()
    while True:
        head = file.read(FRAME.size)
        if len(head) < FRAME.size:
            yield End(f"it ends at byte {size}")
            return
        opcode, length = FRAME.unpack(head)
        at += FRAME.size + length
        if opcode == Opcode.DATA_END:
            body = file.read(min(length, CRC.size))
            yield End(_end_of_data(body, checksum))
            return
        if opcode == 0 or at > size or length > MOST_RECORD_BYTES:
            yield End(f"it ends at byte {size} within a record")
            return
        body = file.read(length)
        checksum = zlib.crc32(body, zlib.crc32(head, checksum))
        try:
            found = parts_of_chunk(body, unpacking, at) if opcode == Opcode.CHUNK else _parts_of(opcode, body)
        except DAMAGED as error:
            yield End(f"the record that ends at byte {at} of {size} is damaged ({type(error).__name__})")
            return
        yield from found
        if progress is not None:
            progress(at / size)


def _end_of_data(body: bytes, checksum: int) -> str | None:
    """What is wrong with the data as a whole, by the record at its end; None if that record is cut or agrees."""
    if len(body) < CRC.size:
        return None
    stated = DataEnd.read(ReadDataStream(BytesIO(body))).data_section_crc
    return "its checksum is not that of its bytes" if stated not in (0, checksum) else None


def _parts_of(opcode: int, body: bytes) -> list[Part]:
    """The content of a record.

    Raises:
        Those of ``DAMAGED``: the body does not fit the opcode.
    """
    stream = ReadDataStream(BytesIO(body))
    match opcode:
        case Opcode.METADATA:
            return [Metadata.read(stream)]
        case Opcode.ATTACHMENT:
            return [_attachment(body)]
        case Opcode.SCHEMA:
            return [Schema.read(stream)]
        case Opcode.CHANNEL:
            return [Channel.read(stream)]
        case Opcode.MESSAGE:
            return [Messages([_message(body)])]
        case _:
            return []


def _attachment(body: bytes) -> Attachment:
    if len(body) < CRC.size:
        raise ValueError("an attachment without its checksum")
    (stated,) = CRC.unpack_from(body, len(body) - CRC.size)
    if stated not in (0, zlib.crc32(body[: -CRC.size])):
        raise ValueError("an attachment that does not agree with its checksum")
    found: Attachment = Attachment.read(ReadDataStream(BytesIO(body)))
    return found


class Unpacking:
    """Counts what the chunks of one file unpack to: kilobytes must not become gigabytes, nor millions of records."""

    def __init__(self) -> None:
        self._total = 0

    def data(self, chunk: Chunk, at: int) -> bytes:
        """The bytes of the records in the next chunk, which ends before byte ``at`` of the file.

        Raises:
            ValueError: as :func:`unpacked`, or the chunks unpack to more than a recorder packs into so many bytes.
            zstandard.ZstdError: the packed bytes are damaged.
        """
        self._total += chunk.uncompressed_size
        if self._total > _UNPACKED_ANYWAY + _UNPACKED_PER_BYTE * at:
            raise ValueError(f"chunks of {self._total} bytes in {at}; expected at most {_UNPACKED_PER_BYTE} times more")
        return unpacked(chunk)


def require_records(count: int, chunk: Chunk) -> None:
    """Refuse more records in a chunk than packed bytes: each record has its own time, which takes at least a byte.

    Raises:
        ValueError: the chunk has more.
    """
    if count > len(chunk.data):
        raise ValueError(f"a chunk of more than {len(chunk.data)} records in as many bytes; expected fewer")


def unpacked(chunk: Chunk) -> bytes:
    """The bytes of the records in a chunk.

    Raises:
        ValueError: the chunk is larger than is read, disagrees with its stated size or checksum, or has another
            packing.
        zstandard.ZstdError: the packed bytes are damaged.
    """
    size = chunk.uncompressed_size
    if size > MOST_RECORD_BYTES:
        raise ValueError(f"a chunk of {size} bytes")
    if chunk.compression == "zstd":
        packing = zstandard.ZstdDecompressor(max_window_size=MOST_RECORD_BYTES)
        with packing.stream_reader(BytesIO(chunk.data)) as reader:
            data = reader.read(size + 1)  # at most one byte more than the chunk states, whatever it holds
    elif chunk.compression == "":
        data = chunk.data
    else:
        raise ValueError(f"a chunk compressed with {chunk.compression!r:.20}; expected zstd or none")
    if len(data) != size or chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise ValueError("a chunk that does not agree with its length or checksum")
    return data


def parts_of_chunk(body: bytes, unpacking: Unpacking, end: int) -> list[Part]:
    """The content of a chunk that ends before byte ``end`` of its file.

    Raises:
        Those of :data:`DAMAGED`: the body is no chunk, or contradicts itself.
    """
    chunk = Chunk.read(ReadDataStream(BytesIO(body)))
    data = unpacking.data(chunk, end)
    out: list[Part] = []
    run: list[Message] = []
    at, size, count = 0, len(data), 0
    while at < size:
        count += 1
        require_records(count, chunk)
        opcode, length = FRAME.unpack_from(data, at)
        at += FRAME.size
        if at + length > size:
            raise ValueError("a record that is longer than its chunk")
        if opcode == Opcode.MESSAGE:
            run.append(_message(data[at : at + length]))
        else:
            if run:
                out.append(Messages(run))
                run = []
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                out += _parts_of(opcode, data[at : at + length])
        at += length
    return [*out, Messages(run)] if run else out


def _message(body: bytes) -> Message:
    channel, sequence, log_time, _ = _MESSAGE.unpack_from(body)
    return Message(channel, sequence, log_time, body[_MESSAGE.size :])


_READERS: Final[Mapping[int, Callable[[ReadDataStream], McapRecord]]] = {
    Opcode.CHUNK: Chunk.read,
    Opcode.CHUNK_INDEX: ChunkIndex.read,
    Opcode.ATTACHMENT: Attachment.read,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex.read,
    Opcode.METADATA_INDEX: MetadataIndex.read,
}


def _bytes_of(record: McapRecord) -> bytes:
    """A record as it is written, with its opcode and length."""
    builder = RecordBuilder()
    record.write(builder)
    return cast(bytes, builder.end())  # type: ignore[no-untyped-call]  # mcap annotates arguments alone


def record_of(opcode: int, body: bytes) -> McapRecord | None:
    """The record of this body; None if it is none, or if writing it anew gives other bytes."""
    reader = _READERS.get(opcode)
    if reader is None:
        return None
    try:
        record = reader(ReadDataStream(BytesIO(body)))
        return record if _bytes_of(record)[FRAME.size :] == body else None
    except (McapError, struct.error, ValueError, OverflowError):  # ValueError: a text that is no UTF-8
        return None


def records_in(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Opcode and body of each record of a summary, up to the first one that is longer than the rest of it."""
    at = 0
    while len(data) - at >= FRAME.size:
        opcode, length = FRAME.unpack_from(data, at)
        at += FRAME.size
        if length > len(data) - at:
            return
        yield opcode, data[at : at + length]
        at += length
