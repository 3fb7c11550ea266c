"""Writes an MCAP file: records one after the other, messages in compressed chunks, and an index at the end.

The records are those of https://mcap.dev/spec, most of them as the library ``mcap`` writes them. Its writer makes an
object of each message and writes it field by field, which takes longer than all other work of a recorder. Here the
messages of one trace are laid out together, with their indexes.

:class:`Tape` makes the bytes. :class:`RecordingFile` appends each piece to the disk whole, or leaves the file as it
was.
"""

from __future__ import annotations

import errno
import os
import struct
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from manyhands.design.files import open_beside

COMPRESSION: Final = "zstd"
LEVEL: Final = 1  # higher levels take twice the time and more, and save a tenth of the bytes

_CHUNK: Final = struct.Struct("<BQQQQI")  # opcode, length, first and last time, uncompressed size, checksum
_INDEX: Final = struct.Struct("<BQHI")  # opcode, length, channel, bytes of entries
_FOOTER: Final = struct.Struct("<BQQQ")  # opcode, length, start of the summary and of its offsets: in the checksum
_CRC: Final = struct.Struct("<I")
_LENGTH: Final = struct.Struct("<Q")

_HEAD: Final = np.dtype(
    [
        ("opcode", "<u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)
_HEAD_BYTES: Final = np.dtype(f"V{_HEAD.itemsize}")
_FRAME_BYTES: Final = 9  # opcode and length, which the length field does not count
_ENTRY: Final = np.dtype([("time", "<u8"), ("offset", "<u8")])


class _Chunk:
    """The open chunk."""

    def __init__(self) -> None:
        self.parts: list[bytes] = []
        self.size = 0
        self.first, self.last = 2**64 - 1, 0
        self.indexes: dict[int, list[bytes]] = {}

    def add(self, record: bytes) -> None:
        self.parts.append(record)
        self.size += len(record)


class Tape:
    """The bytes of a file, in the order in which they are to be written; :meth:`take` returns those that are ready."""

    def __init__(self, library: str) -> None:
        """Begin a file; ``library`` is the program that its header names."""
        self._ready: list[bytes] = []
        self._at = self._crc = 0
        self._chunk = _Chunk()
        self._compressor = zstandard.ZstdCompressor(level=LEVEL)
        self._schemas: list[bytes] = []
        self._channels: list[bytes] = []
        self._chunks: list[bytes] = []
        self._attachments: list[bytes] = []
        self._metadata: list[bytes] = []
        self._counts: dict[int, int] = {}
        self._first, self._last = 2**64 - 1, 0
        self._write(MCAP0_MAGIC)
        self._write(_record(Header("", library)))

    def _write(self, piece: bytes) -> None:
        self._ready.append(piece)
        self._at += len(piece)
        self._crc = zlib.crc32(piece, self._crc)

    @property
    def waiting(self) -> int:
        """Bytes in the open chunk, uncompressed."""
        return self._chunk.size

    def metadata(self, name: str, texts: Mapping[str, str]) -> None:
        """Write texts by name, outside the chunks."""
        record = _record(Metadata(name, dict(texts)))
        self._metadata.append(_record(MetadataIndex(self._at, len(record), name)))
        self._write(record)

    def attach(self, name: str, media_type: str, data: bytes, time: int) -> None:
        """Write the content of another file, made at ``time``, ns since 1970."""
        record = _record(Attachment(time, time, name, media_type, data))
        index = AttachmentIndex(self._at, len(record), time, time, len(data), name, media_type)
        self._attachments.append(_record(index))
        self._write(record)

    def schema(self, name: str, encoding: str, text: str) -> int:
        """Declare a schema for the messages of some channels; returns its number."""
        number = len(self._schemas) + 1
        self._schemas.append(_record(Schema(number, text.encode(), encoding, name)))
        self._chunk.add(self._schemas[-1])
        return number

    def channel(self, topic: str, encoding: str, schema: int, about: dict[str, str]) -> int:
        """Declare a channel for messages of ``topic``; returns its number."""
        number = len(self._channels) + 1
        self._channels.append(_record(Channel(number, topic, encoding, about, schema)))
        self._chunk.add(self._channels[-1])
        self._counts[number] = 0
        return number

    def messages(
        self,
        channel: int,
        times: NDArray[np.uint64],
        sequences: NDArray[np.uint32],
        lengths: NDArray[np.uint64],
        columns: Sequence[Sequence[bytes]],
    ) -> None:
        """Add messages to the chunk.

        Args:
            channel: their channel.
            times: time of each message, ns since 1970; at least one.
            sequences: their sequence numbers.
            lengths: length of each message's data, bytes.
            columns: the data in parts: the first part of every message, then every second part, and so on.
        """
        count, chunk = len(times), self._chunk
        heads = np.empty(count, dtype=_HEAD)
        heads["opcode"], heads["length"], heads["channel"] = Opcode.MESSAGE, lengths + np.uint64(22), channel
        heads["sequence"], heads["log_time"], heads["publish_time"] = sequences, times, times
        width = len(columns) + 1
        parts: list[bytes] = [b""] * (count * width)
        parts[0::width] = heads.view(_HEAD_BYTES).tolist()
        for place, column in enumerate(columns, 1):
            parts[place::width] = column
        entries = np.empty(count, dtype=_ENTRY)
        ends = np.cumsum(lengths + np.uint64(_HEAD.itemsize))
        entries["time"], entries["offset"][0] = times, chunk.size
        entries["offset"][1:] = ends[:-1] + np.uint64(chunk.size)
        chunk.indexes.setdefault(channel, []).append(entries.tobytes())
        chunk.add(b"".join(parts))
        chunk.first, chunk.last = min(chunk.first, int(times.min())), max(chunk.last, int(times.max()))
        self._counts[channel] += count

    def message(self, channel: int, time: int, sequence: int, data: bytes) -> None:
        """Add one message to the chunk."""
        one = np.ones(1, dtype=np.uint64)
        numbers = np.array([sequence], dtype=np.uint32)
        self.messages(channel, one * np.uint64(time), numbers, one * np.uint64(len(data)), [[data]])

    def close_chunk(self) -> None:
        """Compress the open chunk and write it with its indexes; nothing happens if it holds no message."""
        chunk = self._chunk
        if not chunk.indexes:
            return
        self._chunk = _Chunk()
        data = b"".join(chunk.parts)
        packed = self._compressor.compress(data)
        name = COMPRESSION.encode()
        length = _CHUNK.size - _FRAME_BYTES + 4 + len(name) + 8 + len(packed)
        head = _CHUNK.pack(Opcode.CHUNK, length, chunk.first, chunk.last, len(data), zlib.crc32(data))
        began = self._at
        self._write(b"".join((head, _CRC.pack(len(name)), name, _LENGTH.pack(len(packed)), packed)))
        indexed, offsets = self._at, {}
        for channel, entries in chunk.indexes.items():
            listed = b"".join(entries)
            offsets[channel] = self._at
            self._write(_INDEX.pack(Opcode.MESSAGE_INDEX, 6 + len(listed), channel, len(listed)) + listed)
        index = ChunkIndex(
            chunk_length=indexed - began,
            chunk_start_offset=began,
            compression=COMPRESSION,
            compressed_size=len(packed),
            message_end_time=chunk.last,
            message_index_length=self._at - indexed,
            message_index_offsets=offsets,
            message_start_time=chunk.first,
            uncompressed_size=len(data),
        )
        self._chunks.append(_record(index))
        self._first, self._last = min(self._first, chunk.first), max(self._last, chunk.last)

    def take(self) -> bytes:
        """The bytes that are ready and were not taken yet; they end at the border of a record."""
        out = b"".join(self._ready)
        self._ready.clear()
        return out

    def finish(self) -> None:
        """Close the last chunk and the file: its checksum, and the summary that viewers look for at the end."""
        self.close_chunk()
        self._write(_record(DataEnd(self._crc)))
        started, offsets = self._at, []
        summary: list[bytes] = []
        for opcode, group in (
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [_record(self._statistics())]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.ATTACHMENT_INDEX, self._attachments),
            (Opcode.METADATA_INDEX, self._metadata),
        ):
            if group:
                at, length = started + sum(map(len, summary)), sum(map(len, group))
                offsets.append(_record(SummaryOffset(opcode, at, length)))
                summary += group
        offsets_at = started + sum(map(len, summary))
        summary += offsets
        footer = _FOOTER.pack(Opcode.FOOTER, 20, started, offsets_at)
        self._write(b"".join((*summary, footer)))
        checksum = zlib.crc32(b"".join((*summary, footer)))
        self._write(_CRC.pack(checksum) + MCAP0_MAGIC)

    def _statistics(self) -> Statistics:
        messages = sum(self._counts.values())
        return Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunks),
            message_count=messages,
            message_end_time=self._last,
            message_start_time=self._first if messages else 0,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )


def _record(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    out: bytes = builder.end()  # type: ignore[no-untyped-call]  # mcap annotates arguments alone
    return out


class RecordingFile:
    """A file that replaces an older one once its beginning is written, and grows from then on.

    Every piece is on the disk (fdatasync) when :meth:`append` returns. A power failure loses only what came after.
    """

    def __init__(self, path: Path, beginning: bytes) -> None:
        """Begin the file.

        Raises:
            OSError: it cannot be written; an older file of that name is still there.
        """
        partial, self._file = open_beside(path)
        self._fd = self._file.fileno()
        self._length = 0
        try:
            self.append(beginning)
            os.replace(partial, path)
        except BaseException:
            self.close()
            partial.unlink(missing_ok=True)
            raise

    def append(self, piece: bytes) -> None:
        """Add a piece, whole or not at all.

        Raises:
            OSError: there is no room, the disk fails, or the file was cut or removed meanwhile.
        """
        self._require_own()
        try:
            rest = memoryview(piece)
            while rest:
                rest = rest[os.write(self._fd, rest) :]
            os.fdatasync(self._fd)
        except OSError:
            os.ftruncate(self._fd, self._length)  # works on a full disk as well
            os.lseek(self._fd, self._length, os.SEEK_SET)
            raise
        self._length += len(piece)

    def _require_own(self) -> None:
        """Refuse to go on with a file that another program has changed: what comes next would stand behind a hole."""
        now = os.fstat(self._fd)
        if now.st_size != self._length:
            why = f"found a file of {now.st_size} bytes; expected the {self._length} that were written"
            raise OSError(errno.EIO, f"{why}: another program has changed it")
        if now.st_nlink == 0:
            raise OSError(errno.ENOENT, "another program has removed or replaced the file")

    def close(self) -> None:
        """Close the file; nothing is buffered."""
        self._file.close()
