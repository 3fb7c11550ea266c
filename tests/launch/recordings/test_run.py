"""A recording that was cut anywhere is readable to its last whole chunk and reports the cut."""

from __future__ import annotations

import random
import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.writer import CompressionType, Writer

from manyhands.launch.recordings.recording import RecordingError
from manyhands.launch.recordings.run import read_run
from manyhands.launch.recordings.tables import read_recording
from manyhands.nodes.recorder.core import RecorderCore
from manyhands.nodes.recorder.format import Recorded
from manyhands.protocol.codec import encode
from manyhands.protocol.messages import Figures, Observation, Role

RECORDED = Recorded(
    "s", "id", 0.001, "simulated", {"a": Role.DEVICE, "b": Role.DEVICE}, {"a": ("a",), "b": ("b.0", "b.1")}
)
ROWS, CHUNKS = 7, 6
NOISE = np.random.default_rng(1).normal(size=(2, ROWS * CHUNKS, 3))


class Written:
    """A recording in chunks of ``ROWS`` ticks each: where its beginning and each chunk's record end, and each piece."""

    def __init__(self) -> None:
        core = RecorderCore(RECORDED)
        self.data = core.cut()
        self.pieces = [len(self.data)]
        for k in range(CHUNKS):
            rows = slice(k * ROWS, (k + 1) * ROWS)
            for node, columns in (("a", slice(0, 1)), ("b", slice(1, 3))):
                traces = {"x": NOISE[0, rows, columns], "f_v": NOISE[1, rows, columns]}
                core.take(encode(Observation(node, rows.stop, Figures({"late": 1.0}), traces)), 1_000 + k)
            self.data += core.cut()
            self.pieces.append(len(self.data))
        self.data += core.end()
        self.borders = [self.pieces[0], *chunk_ends(self.data)]


def chunk_ends(data: bytes) -> list[int]:
    """Where the chunks of an MCAP file end, by its specification: records of opcode, length and so many bytes."""
    at, out = 8, []
    while at < len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, at)
        at += 9 + length
        out += [at] if opcode == 6 else []
    assert len(out) == CHUNKS
    return out


@pytest.fixture(scope="module")
def written() -> Written:
    return Written()


def whole_chunks(written: Written, length: int) -> int:
    return sum(border <= length for border in written.borders) - 1


def assert_readable(written: Written, path: Path, length: int) -> None:
    """The first ``length`` bytes are in ``path``."""
    ticks = ROWS * whole_chunks(written, length)
    found = read_recording(path)
    np.testing.assert_array_equal(found.x, NOISE[0, :ticks])
    np.testing.assert_array_equal(found.f_v, NOISE[1, :ticks])
    assert found.missing == {}
    assert found.ports == ("a", "b.0", "b.1")


def test_the_whole_file_is_not_cut(written: Written, tmp_path: Path) -> None:
    (tmp_path / "r.mcap").write_bytes(written.data)
    assert_readable(written, tmp_path / "r.mcap", len(written.data))
    assert read_recording(tmp_path / "r.mcap").cut is None


def test_cut_around_every_border_of_a_chunk_and_anywhere_else(written: Written, tmp_path: Path) -> None:
    path, data = tmp_path / "r.mcap", written.data
    at = {border + by for border in (*written.borders, *written.pieces) for by in (-2, -1, 0, 1, 2, 8, 9, 10)}
    at |= set(random.Random(0).sample(range(written.pieces[0], written.pieces[-1]), 300))
    for length in sorted(at):
        path.write_bytes(data[:length])
        if length < written.borders[0]:
            with pytest.raises(RecordingError, match="no metadata of a session"):
                read_recording(path)
            continue
        assert_readable(written, path, length)
        cut = read_recording(path).cut
        if length >= written.pieces[-1] + 9:  # the record that ends the data has begun: there is no more
            assert cut is None
            continue
        assert cut is not None
        assert f"goes to tick {ROWS * whole_chunks(written, length)}" in cut


def test_only_the_index_is_gone_where_the_data_is_whole(written: Written, tmp_path: Path) -> None:
    """What viewers look for is at the end; what was recorded is all there."""
    (tmp_path / "r.mcap").write_bytes(written.data[:-40])
    assert_readable(written, tmp_path / "r.mcap", len(written.data))
    assert read_recording(tmp_path / "r.mcap").cut is None


@pytest.mark.parametrize("tail", [b"\0" * 5000, b"\xff" * 5000, struct.pack("<BQ", 6, 2**62), b"\x06" + b"\0" * 40])
def test_the_remains_of_a_power_failure_are_no_chunk(tail: bytes, written: Written, tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    path.write_bytes(written.data[: written.borders[3]] + tail)
    assert_readable(written, path, written.borders[3])
    assert read_recording(path).cut is not None


def test_a_chunk_that_was_changed_is_found_out(written: Written, tmp_path: Path) -> None:
    """One digit of a number, packed again: only the checksum of the chunk's content shows it."""
    path, (before, after) = tmp_path / "r.mcap", written.borders[2:4]
    start = written.data.index(b"\x28\xb5\x2f\xfd", before)  # the magic number of a zstd frame
    packed = written.data[start:after] if after < len(written.data) else b""
    plain = zstandard.ZstdDecompressor().decompress(packed)
    number = repr(float(NOISE[0, 2 * ROWS, 0])).encode()
    assert plain.count(number) == 1
    digit = plain.index(number) + len(number) - 1
    changed = plain[:digit] + bytes([plain[digit] ^ 1]) + plain[digit + 1 :]
    again = zstandard.ZstdCompressor(level=1).compress(changed)
    lengths = before_chunk(written.data, before), start - 8
    data = bytearray(written.data[:start] + again)
    struct.pack_into("<Q", data, lengths[0], struct.unpack_from("<Q", data, lengths[0])[0] + len(again) - len(packed))
    struct.pack_into("<Q", data, lengths[1], len(again))
    path.write_bytes(data)
    assert_readable(written, path, written.borders[2])
    assert "damaged (ValueError)" in str(read_recording(path).cut)


def before_chunk(data: bytes, at: int) -> int:
    """Where the length of the next chunk's record stands, from the end ``at`` of the chunk before."""
    while data[at] != 6:
        at += 9 + struct.unpack_from("<Q", data, at + 1)[0]
    return at + 1


def test_a_chunk_larger_than_its_header_states_is_not_unpacked(written: Written, tmp_path: Path) -> None:
    """A gibibyte of zeros in some thirty kilobytes: reading it must not cost the gibibyte."""
    path, end = tmp_path / "r.mcap", written.borders[1]
    packing = zstandard.ZstdCompressor(level=1).compressobj()
    zeros = bytes(2**20)
    bomb = b"".join(packing.compress(zeros) for _ in range(2**10)) + packing.flush()
    for size in (100, 2**26, 2**26 + 1, 2**63):
        body = struct.pack("<QQQII4sQ", 0, 0, size, 0, 4, b"zstd", len(bomb)) + bomb
        path.write_bytes(written.data[:end] + struct.pack("<BQ", 6, len(body)) + body)
        tracemalloc.start()
        try:
            assert_readable(written, path, end)
            assert tracemalloc.get_traced_memory()[1] < 2**28
        finally:
            tracemalloc.stop()
        assert "damaged" in str(read_recording(path).cut)


def test_any_wrong_byte_raises_a_recording_error_or_nothing(written: Written, tmp_path: Path) -> None:
    path, chance = tmp_path / "r.mcap", random.Random(2)
    for _ in range(400):
        data = bytearray(written.data)
        for _ in range(chance.randint(1, 3)):
            data[chance.randrange(len(data))] = chance.randrange(256)
        path.write_bytes(data)
        try:
            found = read_recording(path)
        except RecordingError:
            continue
        assert found.x.shape == found.f_v.shape
        known = ~np.isnan(found.x)
        assert np.array_equal(found.x[known], NOISE[0, : len(found.x)][known])


def test_lost_ticks_are_nan_and_counted_for_their_device_alone(
    tmp_path: Path,
) -> None:
    core = RecorderCore(RECORDED)

    def told(node: str, tick: int, columns: int) -> None:
        x = np.full((5, columns), float(tick))
        core.take(encode(Observation(node, tick, Figures(), {"x": x, "f_v": x})), 1)

    told("a", 5, 1)
    told("b", 5, 2)
    told("b", 15, 2)  # five were lost
    told("b", 20, 2)  # and a is gone
    (tmp_path / "r.mcap").write_bytes(core.cut() + core.end())
    found = read_recording(tmp_path / "r.mcap")
    assert found.x.shape == (20, 3)
    assert found.missing == {"a": 15, "b": 5}
    np.testing.assert_array_equal(np.isnan(found.x[:, 0]), np.arange(20) >= 5)
    np.testing.assert_array_equal(np.isnan(found.f_v[:, 1]), (np.arange(20) >= 5) & (np.arange(20) < 10))


def test_a_tick_out_of_this_world_costs_no_memory(tmp_path: Path) -> None:
    core = RecorderCore(RECORDED)
    one = np.ones((1, 1))
    core.take(encode(Observation("a", 2**60, Figures(), {"x": one, "f_v": one})), 1)
    (tmp_path / "r.mcap").write_bytes(core.cut() + core.end())
    assert read_recording(tmp_path / "r.mcap").x.shape == (0, 3)


def test_a_force_without_its_sample_is_no_tick(tmp_path: Path) -> None:
    written_by_another(tmp_path / "r.mcap", {"/s/a/force": [b'{"tick": 0, "time": 0.0, "f_v": [1.0]}']})
    assert read_recording(tmp_path / "r.mcap").x.shape == (0, 3)


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"\xff",
        b"[" * 5000,
        b"[]",
        b"null",
        b"1, 2",
        b'{"tick": 1}',
        b'{"tick": "1", "x": [2.0]}',
        b'{"tick": 1.0, "x": [2.0]}',
        b'{"tick": true, "x": [2.0]}',
        b'{"tick": -1, "x": [2.0]}',
        b'{"tick": 100000000000000000000, "x": [2.0]}',
        b'{"tick": 1, "x": []}',
        b'{"tick": 1, "x": [1.0, 2.0]}',
        b'{"tick": 1, "x": [[1.0]]}',
        b'{"tick": 1, "x": ["a"]}',
        b'{"tick": 1, "x": ["2.0"]}',
        b'{"tick": 1, "x": [true]}',
        b'{"tick": 1, "x": 2.0}',
        b'{"tick": 1, "x": null}',
        b'{"tick": 1, "x": {}}',
        b'{"tick": 1, "x": [1e999999999999]' + b"0" * 10,
    ],
)
def test_a_nonsensical_message_leaves_its_neighbours_readable(text: bytes, tmp_path: Path) -> None:
    x, f_v = ([b'{"tick": %d, "%b": [%d.5]}' % (k, key, k) for k in range(3)] for key in (b"x", b"f_v"))
    written_by_another(tmp_path / "r.mcap", {"/s/a/sample": [x[0], text, x[2]], "/s/a/force": f_v})
    found = read_recording(tmp_path / "r.mcap")
    np.testing.assert_array_equal(found.x[:, 0], [0.5, np.nan, 2.5])
    assert found.missing == {"a": 1, "b": 3}


def test_a_number_that_is_none_was_recorded_all_the_same(tmp_path: Path) -> None:
    core = RecorderCore(RECORDED)
    x = np.array([[1.0], [np.nan], [-np.inf]])
    core.take(encode(Observation("a", 3, Figures(), {"x": x, "f_v": x})), 1)
    core.take(encode(Observation("b", 3, Figures(), {"x": np.ones((3, 2)), "f_v": np.ones((3, 2))})), 1)
    (tmp_path / "r.mcap").write_bytes(core.cut() + core.end())
    found = read_recording(tmp_path / "r.mcap")
    np.testing.assert_array_equal(found.x[:, 0], [1.0, np.nan, np.nan])
    assert found.missing == {}


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD])
@pytest.mark.parametrize("chunks", [True, False])
def test_a_recording_that_another_program_has_written_again_is_read(
    compression: CompressionType, chunks: bool, tmp_path: Path
) -> None:
    told = {f"/s/{node}/{topic}": [b'{"tick":0,"%b":%b}' % (key, row)]
            for node, row in (("a", b"[1]"), ("b", b"[1,1.0]"))
            for topic, key in (("sample", b"x"), ("force", b"f_v"))}  # fmt: skip
    written_by_another(tmp_path / "r.mcap", told, compression, chunks)
    found = read_recording(tmp_path / "r.mcap")
    np.testing.assert_array_equal(found.x, np.ones((1, 3)))
    assert (found.missing, found.cut) == ({}, None)


def written_by_another(
    path: Path,
    told: dict[str, list[bytes]],
    compression: CompressionType = CompressionType.NONE,
    chunks: bool = True,
) -> None:
    with path.open("wb") as file:
        writer = Writer(file, compression=compression, use_chunking=chunks, enable_data_crcs=True)
        writer.start()
        writer.add_metadata("session", RECORDED.as_metadata())
        for topic, texts in told.items():
            channel = writer.register_channel(topic, "json", 0)
            for text in texts:
                writer.add_message(channel, 1, text, 1)
        writer.finish()  # type: ignore[no-untyped-call]


def test_a_recording_of_a_sessions_later_hours_begins_where_it_began(tmp_path: Path) -> None:
    """More ticks precede it than fit in memory: they are left out, and a computation from tick 0 on reports this."""
    begin = 40_000_000
    core = RecorderCore(RECORDED)
    data = core.cut()
    for node, width in (("a", 1), ("b", 2)):
        rows = np.full((5, width), 0.25)
        core.take(encode(Observation(node, begin + 5, Figures(), {"x": rows, "f_v": -rows})), 1_000)
    (tmp_path / "r.mcap").write_bytes(data + core.cut() + core.end())
    run = read_run(tmp_path / "r.mcap")
    assert (run.first, run.ticks, run.time[0]) == (begin, 5, begin * RECORDED.period)
    assert run.traces["b", "sample"].values.tolist() == [[0.25, 0.25]] * 5
    with pytest.raises(RecordingError, match=f"found a recording that begins at tick {begin}"):
        read_recording(tmp_path / "r.mcap")
