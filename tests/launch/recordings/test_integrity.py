"""Any change of a recording is found and located."""

from __future__ import annotations

import random
import struct
from io import BytesIO
from pathlib import Path

import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.data_stream import ReadDataStream
from mcap.records import Chunk

from manyhands.launch.recordings.integrity import Damage, findings
from manyhands.launch.recordings.mcap import unpacked
from manyhands.launch.recordings.recording import RecordingError
from manyhands.nodes.recorder.core import RecorderCore

from ...support.small_recordings import ALONE, ATTACHED, RECORDED, STARTED, recording

MAGIC = 8
HEADER, CHUNK, INDEX, ATTACHMENT, METADATA, DATA_END = 1, 6, 7, 9, 12, 15  # opcodes
PACKED_AT = 9 + 8 + 8 + 8 + 4 + 4 + len("zstd") + 8  # of a chunk's record: where its packed bytes begin


def records(data: bytes) -> list[tuple[int, int]]:
    """Where each record of a whole file begins and ends, its two magics included."""
    found, at = [(0, MAGIC)], MAGIC
    while at < len(data) - MAGIC:
        (length,) = struct.unpack_from("<Q", data, at + 1)
        found.append((at, at + 9 + length))
        at += 9 + length
    return [*found, (at, len(data))]


def place_to_name(whole: bytes, begin: int, end: int) -> tuple[int, int]:
    """The first byte, and the one behind the last, to which a change within the record ``begin`` to ``end`` is located.

    What has a checksum of its own is located to its record; a header, a message index, the metadata and the end of the
    data at worst to the data section; the summary and its footer to both.
    """
    data_end = next(after for at, after in records(whole)[1:] if whole[at] == DATA_END)
    if begin >= data_end and end < len(whole):
        return data_end, len(whole) - MAGIC
    return (0, data_end) if begin and whole[begin] in (HEADER, INDEX, METADATA, DATA_END) else (begin, end)


def unpacks_alike(whole: bytes, data: bytes, begin: int, end: int) -> bool:
    """Whether two forms of a chunk's record, of which only packed bytes may differ, unpack to the same."""
    before, after = (Chunk.read(ReadDataStream(BytesIO(form[begin + 9 : end]))) for form in (whole, data))
    try:
        return unpacked(after) == unpacked(before)
    except (ValueError, zstandard.ZstdError):
        return False


def examined(path: Path, data: bytes) -> list[Damage]:
    path.write_bytes(data)
    return findings(path)


def test_nothing_is_wrong_with_a_recording_as_it_was_written(tmp_path: Path) -> None:
    parts: list[float] = []
    path = tmp_path / "run.mcap"
    path.write_bytes(recording())
    assert findings(path, parts.append) == []
    assert parts == sorted(parts)
    assert 0.0 <= parts[0] <= parts[-1] <= 1.0


def test_a_recording_without_any_telemetry_is_sound(tmp_path: Path) -> None:
    core = RecorderCore(RECORDED, ATTACHED, STARTED)
    assert examined(tmp_path / "run.mcap", core.cut() + core.end()) == []


@pytest.mark.long
def test_every_changed_byte_is_located_to_its_chunk_or_record(tmp_path: Path) -> None:
    whole, path = recording(ticks=4, each=2, recorded=ALONE), tmp_path / "run.mcap"
    draw = random.Random(20)
    kinds = {whole[begin] for begin, _ in records(whole)[1:-1]}
    assert {HEADER, CHUNK, INDEX, ATTACHMENT, METADATA, DATA_END} <= kinds
    section = place_to_name(whole, *next(at for at in records(whole)[1:] if whole[at[0]] == METADATA))
    for begin, end in records(whole):
        own = place_to_name(whole, begin, end)
        for place in range(begin, end):
            data = bytearray(whole)
            data[place] ^= draw.randrange(1, 256)
            found = examined(path, bytes(data))
            told = f"byte {place} of the record {begin}..{end}: {found}"
            packed = whole[begin] == CHUNK and place >= begin + PACKED_AT
            # a bit that zstd does not read changes nothing in the chunk
            least, most = section if packed and unpacks_alike(whole, bytes(data), begin, end) else own
            assert any(least <= damage.begin <= place < damage.end <= most for damage in found), told


def test_a_length_that_reaches_over_the_next_record_is_located_to_its_own(tmp_path: Path) -> None:
    whole, path = recording(ticks=4, each=2, recorded=ALONE), tmp_path / "run.mcap"
    places = records(whole)
    indexes = [place for place, (begin, _) in enumerate(places) if whole[begin] == INDEX]
    place = next(place for place in indexes if place + 1 in indexes)
    (begin, end), (_, after) = places[place], places[place + 1]
    data = bytearray(whole)
    data[begin + 1 : begin + 9] = (after - begin - 9).to_bytes(8, "little")
    assert [(damage.begin, damage.end) for damage in examined(path, bytes(data))] == [(begin, end)]


@pytest.mark.parametrize("bit", range(8))
def test_so_is_a_single_bit_where_it_is_easily_overlooked(tmp_path: Path, bit: int) -> None:
    """Texts of the header and of the metadata, which are neither in a chunk nor in the summary."""
    whole, path = recording(), tmp_path / "run.mcap"
    for begin, end in records(whole)[1:3]:
        for place in range(begin, end, 7):
            data = bytearray(whole)
            data[place] ^= 1 << bit
            found = examined(path, bytes(data))
            least, most = place_to_name(whole, begin, end)
            assert any(least <= damage.begin <= place < damage.end <= most for damage in found), found


def test_what_follows_damage_is_not_called_damaged(tmp_path: Path) -> None:
    whole, path = recording(ticks=40, each=5, chunks=4), tmp_path / "run.mcap"
    for begin, end in [records(whole)[place] for place in (5, 6, 9)]:  # chunks and indexes in the middle
        for place in (begin, begin + 1, begin + 8, *((begin + 12, end - 1) if whole[begin] == CHUNK else ())):
            data = bytearray(whole)
            data[place] ^= 0x55
            found = examined(path, bytes(data))
            assert found
            assert all(begin <= damage.begin and damage.end <= end for damage in found), found


def test_two_changed_chunks_are_both_reported(tmp_path: Path) -> None:
    whole, path = recording(ticks=40, each=5, chunks=4), tmp_path / "run.mcap"
    chunks = [(begin, end) for begin, end in records(whole)[1:-1] if whole[begin] == 6]
    data = bytearray(whole)
    for begin, end in chunks[1:3]:
        data[(begin + end) // 2] ^= 1
    assert [(damage.begin, damage.end) for damage in examined(path, bytes(data))] == chunks[1:3]


def test_a_change_only_the_data_checksum_shows_names_the_whole_section(tmp_path: Path) -> None:
    whole, path = recording(), tmp_path / "run.mcap"
    data = bytearray(whole)
    at = whole.index(RECORDED.certificate.encode())
    data[at : at + 4] = b"eeee"
    (damage,) = examined(path, bytes(data))
    begin, end = next(r for r in records(whole) if whole[r[0]] == 0x0F)
    assert (damage.begin, damage.end) == (0, end)
    assert "checksum" in damage.what
    assert begin > at


@pytest.mark.parametrize("less", [0, 1, 3])
def test_a_cut_file_is_reported_with_its_whole_part(less: int, tmp_path: Path) -> None:
    whole, path = recording(ticks=20, each=5, chunks=3), tmp_path / "run.mcap"
    for begin, end in records(whole)[1:-2]:
        cut = max(end - less, begin + 1)
        (damage,) = examined(path, whole[:cut])
        data_end = next(r[1] for r in records(whole) if whole[r[0]] == 0x0F)
        assert "cut" in damage.what
        assert (damage.begin, damage.end) == (min(end if cut == end else begin, data_end), cut)


@settings(max_examples=60)
@given(st.data())
def test_no_bytes_make_it_raise(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    """Cut anywhere, then changed at several places or overwritten; and texts that never were a recording."""
    whole = recording(ticks=4, each=4)
    path = tmp_path_factory.getbasetemp() / "any.mcap"
    text = bytearray(whole[: data.draw(st.integers(0, len(whole)))] or data.draw(st.binary()))
    for place in data.draw(st.lists(st.integers(0, max(len(text) - 1, 0)), max_size=6)):
        text[place : place + 1] = data.draw(st.binary(max_size=9))
    found = examined(path, bytes(text))
    assert found or bytes(text) == whole
    assert all(0 <= damage.begin <= damage.end <= len(text) for damage in found)


def test_a_chunk_that_unpacks_beyond_the_memory_is_refused_unread(tmp_path: Path) -> None:
    whole, path = recording(), tmp_path / "run.mcap"
    begin = next(b for b, _ in records(whole)[1:] if whole[b] == 6)
    data = bytearray(whole)
    data[begin + 25 : begin + 33] = struct.pack("<Q", 2**50)
    assert any(damage.begin == begin and str(2**50) in damage.what for damage in examined(path, bytes(data)))


def test_what_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="cannot be read"):
        findings(tmp_path / "none.mcap")
