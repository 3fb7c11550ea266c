"""The summary that a recording's data section implies: nothing stands in it that is not known without it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

from mcap.opcode import Opcode
from mcap.records import Statistics, SummaryOffset

from manyhands.launch.recordings.data_section import DataSection
from manyhands.launch.recordings.records import FRAME, bytes_of

SUMMARY_RECORDS: Final = {
    Opcode.SCHEMA: "a schema",
    Opcode.CHANNEL: "a channel",
    Opcode.STATISTICS: "the statistics",
    Opcode.CHUNK_INDEX: "a chunk's index",
    Opcode.ATTACHMENT_INDEX: "an attachment's index",
    Opcode.METADATA_INDEX: "an index of metadata",
    Opcode.SUMMARY_OFFSET: "an offset",
}
"""What stands in a summary, in this order."""


def records_in(summary: bytes) -> Iterator[tuple[int, bytes]]:
    """Opcode and body of each record of a summary, as far as they go."""
    at = 0
    while len(summary) - at >= FRAME.size:
        opcode, length = FRAME.unpack_from(summary, at)
        at += FRAME.size
        if length > len(summary) - at:
            return
        yield opcode, summary[at : at + length]
        at += length


def implied(section: DataSection, start: int, told: bytes) -> tuple[list[bytes], int]:
    """The records of the summary, and where its offsets begin in the file.

    Args:
        section: a data section that was read without complaint.
        start: where the summary begins.
        told: the summary that is there. A recording without any message has its schemas and channels there alone; and
            of groups that are empty it may have offsets or not.
    """
    content = section.content
    schemas, channels = [*content.schemas.values()], [*content.channels.values()]
    if not section.chunks:
        schemas, channels = (
            [FRAME.pack(opcode, len(body)) + body for opcode, body in records_in(told) if opcode == wanted]
            for wanted in (Opcode.SCHEMA, Opcode.CHANNEL)
        )
    groups: dict[Opcode, Sequence[bytes]] = {
        Opcode.SCHEMA: schemas,
        Opcode.CHANNEL: channels,
        Opcode.STATISTICS: [bytes_of(_statistics(section, len(schemas), len(channels)))],
        Opcode.CHUNK_INDEX: [*map(bytes_of, section.chunks)],
        Opcode.ATTACHMENT_INDEX: [*map(bytes_of, section.attachments)],
        Opcode.METADATA_INDEX: [*map(bytes_of, section.metadata)],
    }
    records: list[bytes] = []
    offsets: dict[Opcode, bytes] = {}
    at = start
    for opcode, group in groups.items():
        length = sum(map(len, group))
        offsets[opcode] = bytes_of(SummaryOffset(opcode, at, length))
        records += group
        at += length
    every = [*records, *offsets.values()]
    if sum(map(len, every)) != len(told):
        full = [*records, *(offset for opcode, offset in offsets.items() if groups[opcode])]
        every = full if sum(map(len, full)) == len(told) else every
    return every, at


def _statistics(section: DataSection, schemas: int, channels: int) -> Statistics:
    content = section.content
    return Statistics(
        attachment_count=len(section.attachments),
        channel_count=channels,
        channel_message_counts=content.counts,
        chunk_count=len(section.chunks),
        message_count=sum(content.counts.values()),
        message_end_time=content.last,
        message_start_time=content.first,
        metadata_count=len(section.metadata),
        schema_count=schemas,
    )
