"""Reading a recording that was written as it happened: whole, or as far as it goes.

A recorder that was killed, a full disk, a power failure leave a file without its end. What is in it in whole chunks is
read, and :attr:`~manyhands.launch.recordings.recording.Recording.cut` says where it ends and why that is known. The
file may come from anywhere: its lengths are held against its size, its chunks against their checksums.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, Final

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Message, Metadata
from mcap.stream_reader import breakup_chunk
from mcap.writer import MCAP0_MAGIC

from manyhands.launch.recordings.recording import Array, Collector, Recording, RecordingError
from manyhands.nodes.recorder.layout import FORCE, METADATA, SAMPLE, Recorded, decode_rows
from manyhands.protocol.channels import channel_name

MOST_RECORD_BYTES: Final = 256 * 2**20
"""Longest record that is read; a recorder's are little longer than a mebibyte."""

MOST_VALUES: Final = 100_000_000
"""Most ticks x ports that are filled with NaN where something is missing: 1.6 GB."""

_FRAME: Final = struct.Struct("<BQ")  # opcode and length of what follows
_DAMAGED: Final = (McapError, struct.error, ValueError, OverflowError)  # ValueError: a checksum, or a text that is none


@dataclass(frozen=True)
class _End:
    """Where the reading of a file came to its end; ``why`` if that is not the file's own."""

    why: str | None


def read_recording(path: Path) -> Recording:
    """Read an ``.mcap`` recording of this program, whole or cut anywhere behind its beginning.

    What devices did not record, or what is lost with the end of a file that was cut, is NaN up to the last tick that
    any device recorded, and counted in ``missing``.

    Raises:
        RecordingError: not readable, no such recording, or cut before it says what it is.
    """
    try:
        with path.open("rb") as file:
            return _read(path, file)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from error


def _read(path: Path, file: BinaryIO) -> Recording:
    if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
        raise RecordingError(f"{path}: found a file that does not begin as MCAP does; expected a recording")
    reading: _Reading | None = None
    for part in _parts(file):
        match part:
            case Metadata(name, texts) if name == METADATA and reading is None:
                try:
                    reading = _Reading(Recorded.from_metadata(texts))
                except ValueError as error:
                    raise RecordingError(f"{path}: {error}") from error
            case _End(why):
                if reading is None:
                    raise RecordingError(f"{path}: found no word of what was recorded, but {why or 'another file'}")
                return reading.recording(why)
            case _ if reading is not None:
                reading.take(part)
    raise RecordingError(f"{path}: found no end")  # the last part is an end


def _parts(file: BinaryIO) -> Iterator[McapRecord | _End]:
    """The metadata, channels and messages of a file, then one :class:`_End`."""
    at, size = file.tell(), os.fstat(file.fileno()).st_size
    while True:
        head = file.read(_FRAME.size)
        if len(head) < _FRAME.size:
            yield _End(f"it ends at byte {size}")
            return
        opcode, length = _FRAME.unpack(head)
        if opcode == Opcode.DATA_END:
            yield _End(None)
            return
        at += _FRAME.size + length
        if opcode == 0 or at > size or length > MOST_RECORD_BYTES:
            yield _End(f"it ends at byte {size} within a record")
            return
        body = file.read(length)
        try:
            yield from _parts_of(opcode, body)
        except _DAMAGED as error:
            yield _End(f"the record that ends at byte {at} of {size} is damaged ({type(error).__name__})")
            return


def _parts_of(opcode: int, body: bytes) -> list[McapRecord]:
    if opcode == Opcode.METADATA:
        return [Metadata.read(ReadDataStream(BytesIO(body)))]
    if opcode != Opcode.CHUNK:
        return []
    chunk = Chunk.read(ReadDataStream(BytesIO(body)))
    if chunk.compression:
        raise ValueError("a compressed chunk, which recorders do not write")
    return breakup_chunk(chunk, validate_crc=True)


class _Reading:
    """Puts x and f_v of the devices together again."""

    def __init__(self, recorded: Recorded) -> None:
        self._recorded = recorded
        every_port = sum(len(ports) for ports in recorded.devices.values())
        self._collector = Collector(recorded.devices, MOST_VALUES // max(1, every_port))
        self._signals = {
            channel_name(recorded.session, device, signal): (device, signal)
            for device in recorded.devices
            for signal in (SAMPLE, FORCE)
        }
        self._channels: dict[int, tuple[str, str]] = {}
        self._x: dict[str, tuple[int, Array]] = {}

    def take(self, part: McapRecord) -> None:
        """Take in a channel, or a message; what is of no device's x or f_v, or makes no sense, is passed over."""
        match part:
            case Channel(number, topic) if topic in self._signals:
                self._channels[number] = self._signals[topic]
            case Message() if part.channel_id in self._channels:
                device, signal = self._channels[part.channel_id]
                try:
                    first, values = decode_rows(part.data)
                except ValueError:
                    return  # its ticks are missing, then
                if signal == SAMPLE:
                    self._x[device] = first, values
                    return
                of, x = self._x.pop(device, (-1, values))
                if of == first:
                    self._collector.add(device, first + values.shape[0], x, values)

    def recording(self, why: str | None) -> Recording:
        """What was read; ``why`` the file is not whole."""
        collector, recorded = self._collector, self._recorded
        collector.level()
        out = collector.recording(recorded.session, recorded.certificate, recorded.period)
        if why is None:
            return out
        return replace(out, cut=f"{why}, and not as a recorder ends it; what it holds goes to tick {collector.tick}")
