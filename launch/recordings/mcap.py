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
    Footer,
    Header,
    McapRecord,
    MessageIndex,
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

_FRAME: Final = struct.Struct("<BQ")  # opcode and length of what follows
_MESSAGE: Final = struct.Struct("<HIQQ")  # channel, sequence, log_time, publish_time
_CRC: Final = struct.Struct("<I")
_DAMAGED: Final = (McapError, struct.error, ValueError, OverflowError, zstandard.ZstdError)


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
        head = file.read(_FRAME.size)
        if len(head) < _FRAME.size:
            yield End(f"it ends at byte {size}")
            return
        opcode, length = _FRAME.unpack(head)
        at += _FRAME.size + length
        if opcode == Opcode.DATA_END:
            body = file.read(min(length, _CRC.size))
            yield End(_end_of_data(body, checksum))
            return
        if opcode == 0 or at > size or length > MOST_RECORD_BYTES:
            yield End(f"it ends at byte {size} within a record")
            return
        body = file.read(length)
        checksum = zlib.crc32(body, zlib.crc32(head, checksum))
        try:
            found = _parts_of_chunk(body, unpacking, at) if opcode == Opcode.CHUNK else _parts_of(opcode, body)
        except _DAMAGED as error:
            yield End(f"the record that ends at byte {at} of {size} is damaged ({type(error).__name__})")
            return
        yield from found
        if progress is not None:
            progress(at / size)


def _end_of_data(body: bytes, checksum: int) -> str | None:
    """What is wrong with the data as a whole, by the record at its end; None if that record is cut or agrees."""
    if len(body) < _CRC.size:
        return None
    stated = DataEnd.read(ReadDataStream(BytesIO(body))).data_section_crc
    return "its checksum is not that of its bytes" if stated not in (0, checksum) else None


def _parts_of(opcode: int, body: bytes) -> list[Part]:
    """The content of a record.

    Raises:
        Those of ``_DAMAGED``: the body does not fit the opcode.
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
    if len(body) < _CRC.size:
        raise ValueError("an attachment without its checksum")
    (stated,) = _CRC.unpack_from(body, len(body) - _CRC.size)
    if stated not in (0, zlib.crc32(body[: -_CRC.size])):
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


def _parts_of_chunk(body: bytes, unpacking: Unpacking, end: int) -> list[Part]:
    chunk = Chunk.read(ReadDataStream(BytesIO(body)))
    data = unpacking.data(chunk, end)
    out: list[Part] = []
    run: list[Message] = []
    at, size, count = 0, len(data), 0
    while at < size:
        count += 1
        require_records(count, chunk)
        opcode, length = _FRAME.unpack_from(data, at)
        at += _FRAME.size
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


FRAME: Final = struct.Struct("<BQ")
"""Opcode and length of the body that follows."""

_MESSAGE_START: Final = struct.Struct("<HIQ")  # channel, sequence, log time; publish time and data follow
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
    """The record of this body; None if it is none, or if writing it anew gives other bytes."""
    reader = _READERS.get(opcode)
    if reader is None:
        return None
    try:
        record = reader(ReadDataStream(BytesIO(body)))
        return record if _bytes_of(record)[FRAME.size :] == body else None
    except (McapError, struct.error, ValueError, OverflowError):  # ValueError: a text that is no UTF-8
        return None


def message_indexes(chunk: Chunk, unpacking: Unpacking, end: int) -> list[bytes]:
    """The message indexes, as they are written, of a chunk that ends before byte ``end`` of its file.

    The chunk is compared with its size, its checksum and its times.

    Raises:
        ValueError: the chunk cannot be unpacked or contradicts itself; the message states what was found.
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
    """Log time and offset of each message in the uncompressed bytes of a chunk, by channel.

    Raises:
        ValueError: the bytes are not schemas, channels and messages, or are more of them than there can be.
    """
    entries: dict[int, list[tuple[int, int]]] = {}
    at, size, count = 0, len(data), 0
    while at < size:
        count += 1
        require_records(count, chunk)
        if size - at < FRAME.size:
            raise ValueError(f"{size - at} bytes after the chunk's last record")
        opcode, length = FRAME.unpack_from(data, at)
        begin = at + FRAME.size
        if length > size - begin:
            raise ValueError("a record in the chunk that is longer than the chunk")
        if opcode == Opcode.MESSAGE and length >= _MESSAGE_HEAD:
            channel, _, time = _MESSAGE_START.unpack_from(data, begin)
            entries.setdefault(channel, []).append((time, at))
        elif opcode not in (Opcode.SCHEMA, Opcode.CHANNEL) or length < _LEAST_BODY:
            raise ValueError(f"a record in the chunk with opcode 0x{opcode:02x}, which does not belong there")
        at = begin + length
    return entries
