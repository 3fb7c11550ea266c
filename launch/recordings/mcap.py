"""The records of a recording, one after the other: of a whole file, or of one that was cut anywhere.

A recorder that was killed, a full disk, a power failure leave a file without its end. What is in it in whole chunks is
read, and the last thing told is where it ends and why that is known. The file may come from anywhere: its lengths are
held against its size and against limits, its chunks against their checksums, and nothing is unpacked beyond what a
chunk says of itself.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple, TypeAlias

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, DataEnd, Metadata, Schema
from mcap.writer import MCAP0_MAGIC

from manyhands.design.files import open_regular
from manyhands.launch.recordings.recording import RecordingError

MOST_RECORD_BYTES: Final = 64 * 2**20
"""Longest record that is read, and most that a chunk may hold unpacked; a recorder's are a mebibyte or a few."""

_UNPACKED_ANYWAY: Final = 16 * 2**20
_UNPACKED_PER_BYTE: Final = 1000
"""Bytes that a file's chunks may unpack to; of what a recorder packs, a session of 2048 ports at rest reaches 700."""

_FRAME: Final = struct.Struct("<BQ")  # opcode and length of what follows
_MESSAGE: Final = struct.Struct("<HIQQ")  # channel, sequence, log_time, publish_time
_CRC: Final = struct.Struct("<I")
_DAMAGED: Final = (McapError, struct.error, ValueError, OverflowError, zstandard.ZstdError)


class Message(NamedTuple):
    """One message: its channel's number and its data, as the recorder wrote it."""

    channel: int
    sequence: int
    log_time: int
    data: bytes


class Messages(NamedTuple):
    """The messages of one chunk, in the order in which they are in it."""

    messages: list[Message]


class End(NamedTuple):
    """Where the reading of a file came to its end; ``why`` if that is not the file's own."""

    why: str | None


Part: TypeAlias = Metadata | Attachment | Schema | Channel | Messages | End


@dataclass(frozen=True)
class Heard:
    """One message with the channel it is of."""

    channel: Channel
    message: Message


def parts(path: Path, progress: Callable[[float], None] | None = None) -> Iterator[Part]:
    """The metadata, attachments, schemas, channels and messages of a file in its own order, then one :class:`End`.

    A channel comes before its first message, unless the file is damaged. Message indexes and the summary at the end
    are passed over: they say nothing that the rest does not.

    Args:
        path: the file.
        progress: told which share of the file was read, from 0 to 1.

    Raises:
        RecordingError: not readable, or not begun as such files are.
    """
    try:
        with open_regular(path) as file:
            if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
                raise RecordingError(f"{path}: found a file that does not begin as MCAP does; expected a recording")
            yield from _parts(file, progress)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from error


def messages(path: Path, progress: Callable[[float], None] | None = None) -> Iterator[Heard | End]:
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
                        yield Heard(channels[message.channel], message)
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
    """What is wrong with the data as a whole, by the record at its end; one that was cut itself says nothing."""
    if len(body) < _CRC.size:
        return None
    stated = DataEnd.read(ReadDataStream(BytesIO(body))).data_section_crc
    return "its checksum is not that of its bytes" if stated not in (0, checksum) else None


def _parts_of(opcode: int, body: bytes) -> list[Part]:
    """What is in a record.

    Raises:
        Those of ``_DAMAGED``: it is not what its opcode says.
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
        raise ValueError("an attachment with another checksum than its own")
    found: Attachment = Attachment.read(ReadDataStream(BytesIO(body)))
    return found


class Unpacking:
    """What the chunks of one file unpack to, so far: kilobytes must not become gigabytes, nor millions of records."""

    def __init__(self) -> None:
        self._total = 0

    def data(self, chunk: Chunk, at: int) -> bytes:
        """The records in the next chunk, as bytes; it ends before byte ``at`` of the file.

        Raises:
            ValueError: as :func:`unpacked`, or the chunks unpack to more than a recorder packs into so many bytes.
            zstandard.ZstdError: its packing is damaged.
        """
        self._total += chunk.uncompressed_size
        if self._total > _UNPACKED_ANYWAY + _UNPACKED_PER_BYTE * at:
            raise ValueError(f"chunks of {self._total} bytes in {at}; expected at most {_UNPACKED_PER_BYTE} times more")
        return unpacked(chunk)


def require_records(count: int, chunk: Chunk) -> None:
    """Refuse more records in a chunk than packed bytes: each has a time of its own, which takes a byte when packed.

    Raises:
        ValueError: it has more.
    """
    if count > len(chunk.data):
        raise ValueError(f"a chunk of more than {len(chunk.data)} records in as many bytes; expected fewer")


def unpacked(chunk: Chunk) -> bytes:
    """The records in a chunk, as bytes.

    Raises:
        ValueError: larger than is read, not as large as it says, of another checksum, or packed in another way.
        zstandard.ZstdError: its packing is damaged.
    """
    size = chunk.uncompressed_size
    if size > MOST_RECORD_BYTES:
        raise ValueError(f"a chunk of {size} bytes")
    if chunk.compression == "zstd":
        packing = zstandard.ZstdDecompressor(max_window_size=MOST_RECORD_BYTES)
        with packing.stream_reader(BytesIO(chunk.data)) as reader:
            data = reader.read(size + 1)  # never more than it says, whatever is packed into it
    elif chunk.compression == "":
        data = chunk.data
    else:
        raise ValueError(f"a chunk compressed with {chunk.compression!r:.20}; expected zstd or none")
    if len(data) != size or chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise ValueError("a chunk of another length or checksum than its own")
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
