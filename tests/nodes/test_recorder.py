"""What a recorder writes: the file's layout, what it takes in and refuses, and a disk that fails."""

from __future__ import annotations

import json
import math
import os
import resource
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from manyhands.launch.recordings.file import read_recording
from manyhands.launch.recordings.recording import RecordingError
from manyhands.nodes.recorder import status
from manyhands.nodes.recorder.core import CHUNK_BYTES, RecorderCore
from manyhands.nodes.recorder.file import RecordingFile
from manyhands.nodes.recorder.layout import Recorded, decode_rows, encode_figures, encode_rows
from manyhands.nodes.recorder.plan import Plan, PlanError
from manyhands.protocol.codec import encode
from manyhands.protocol.messages import Observation, Role, Stop, Telemetry

numbers = st.floats() | st.sampled_from([math.nan, math.inf, -math.inf])
RECORDED = Recorded(
    "s",
    "id",
    0.001,
    "realtime",
    {"a": Role.DEVICE, "b": Role.DEVICE, "c": Role.COUPLING, "environment": Role.ENVIRONMENT},
    {"a": ("a",), "b": ("b.0", "b.1"), "c": ("a", "b.0", "b.1"), "environment": ("a", "b.0", "b.1")},
)
X = np.arange(1.0, 5.0).reshape(4, 1)


def observation(node: str, tick: int, rows: int, columns: int, **more: float) -> Observation:
    x = np.arange(float(rows * columns)).reshape(rows, columns) + tick
    names = ("p", "f_v") if node == "c" else ("x", "f_v")
    return Observation(node, tick, more, dict(zip(names, (x, -x), strict=True)))


class Test_layout:
    @given(
        st.integers(0, 2**63 - 1), hnp.arrays(np.float64, hnp.array_shapes(min_dims=2, max_dims=2), elements=numbers)
    )
    def test_rows_round_trip_bit_for_bit(self, first: int, values: np.ndarray) -> None:
        tick, found = decode_rows(encode_rows(first, values))
        assert tick == first
        assert found.shape == values.shape
        assert found.tobytes() == values.tobytes()

    def test_rows_are_the_bytes_that_ros_2_would_write(self) -> None:
        """Encapsulation, then members at their alignment, counted from behind it: 8, 4, 4, 4, padding, 8 each."""
        told = encode_rows(258, np.array([[1.5, -2.0]]))
        assert told.hex(" ", 4) == (
            "00010000 02010000 00000000 01000000 02000000 02000000 00000000 00000000 0000f83f 00000000 000000c0"
        )

    @given(st.binary(max_size=80) | st.builds(lambda head, rest: head + rest, st.just(b"\0\1\0\0"), st.binary()))
    def test_what_is_no_message_of_rows_is_refused(self, data: bytes) -> None:
        try:
            tick, values = decode_rows(data)
        except ValueError:
            return
        assert encode_rows(tick, values)[:20] == data[:20]

    @pytest.mark.parametrize("cut", [1, 8, 9])
    def test_a_message_of_another_length_is_refused(self, cut: int) -> None:
        with pytest.raises(ValueError, match="expected"):
            decode_rows(encode_rows(0, X)[:-cut])
        with pytest.raises(ValueError, match="expected"):
            decode_rows(encode_rows(0, X) + b"\0" * cut)

    def test_figures_that_json_cannot_say_are_null(self) -> None:
        told = encode_figures(3, {"a": math.nan, "b": math.inf, "c": 0.1})
        assert json.loads(told, parse_constant=pytest.fail) == {"tick": 3, "figures": {"a": None, "b": None, "c": 0.1}}

    def test_what_was_recorded_round_trips(self) -> None:
        assert Recorded.from_metadata(RECORDED.as_metadata()) == RECORDED
        assert RECORDED.devices == {"a": ("a",), "b": ("b.0", "b.1")}

    @pytest.mark.parametrize(
        "change",
        [
            {"format": "other"},
            {"version": "2"},
            {"period": "0.0"},
            {"period": "nan"},
            {"period": "soon"},
            {"roles": "{}"},
            {"roles": '{"a": "king"}'},
            {"roles": "[1]"},
            {"ports": '{"a": ["a"]}'},
            {"ports": '{"a": [1], "b": [], "c": [], "environment": []}'},
            {"ports": '{"a": 1}'},
            {"ports": "["},
        ],
    )
    def test_metadata_that_makes_no_sense_is_refused(self, change: dict[str, str]) -> None:
        with pytest.raises(ValueError, match=r"found|expected|Expecting|could not convert|is not a valid"):
            Recorded.from_metadata(RECORDED.as_metadata() | change)
        for key in change:
            texts = RECORDED.as_metadata()
            del texts[key]
            with pytest.raises(ValueError, match="found"):
                Recorded.from_metadata(texts)


class Test_core:
    def written(self, core: RecorderCore, path: Path) -> bytes:
        data = core.cut() + core.end()
        path.write_bytes(data)
        return data

    def test_what_it_is_told_is_in_the_file(self, tmp_path: Path) -> None:
        core = RecorderCore(RECORDED)
        for tick in (10, 20):
            core.take(encode(observation("a", tick, 10, 1, late=1.0)), 5)
            core.take(encode(observation("b", tick, 10, 2)), 5)
            core.take(encode(observation("c", tick, 10, 3, ledger=math.nan)), 5)
            core.take(encode(Observation("environment", tick, {"ledger": 0.5}, {})), 5)
        assert not core.over
        core.take(encode(Stop("over")), 5)
        assert core.over
        self.written(core, tmp_path / "r.mcap")
        found = read_recording(tmp_path / "r.mcap")
        assert (found.session, found.certificate, found.period, found.ports) == ("s", "id", 0.001, ("a", "b.0", "b.1"))
        parts = [np.hstack([observation("a", t, 10, 1).traces["x"], observation("b", t, 10, 2).traces["x"]])
                 for t in (10, 20)]  # fmt: skip
        np.testing.assert_array_equal(found.x, np.vstack(parts))
        np.testing.assert_array_equal(found.f_v, -found.x)
        assert (found.missing, found.cut, core.tick, core.refused) == ({}, None, 20, 0)

    def test_any_reader_of_mcap_finds_channels_units_ticks_and_figures(self, tmp_path: Path) -> None:
        from mcap.reader import make_reader

        core = RecorderCore(RECORDED)
        core.take(encode(observation("b", 2**32 + 10, 10, 2, late=3.0)), 1_700_000_000_000_000_000)
        core.take(encode(observation("c", 10, 10, 3)), 1_700_000_000_000_000_001)
        self.written(core, tmp_path / "r.mcap")
        with (tmp_path / "r.mcap").open("rb") as file:
            reader = make_reader(file)
            summary = reader.get_summary()
            assert summary is not None
            assert {c.topic: c.metadata.get("unit") for c in summary.channels.values()} == {
                "/s/a/sample": "m",
                "/s/a/force": "N",
                "/s/a/telemetry": None,
                "/s/b/sample": "m",
                "/s/b/force": "N",
                "/s/b/telemetry": None,
                "/s/c/tool": "m",
                "/s/c/reaction": "N",
                "/s/c/telemetry": None,
                "/s/environment/telemetry": None,
            }
            found = {channel.topic: (schema, message) for schema, channel, message in reader.iter_messages()}
        assert found.keys() == {"/s/b/sample", "/s/b/force", "/s/b/telemetry", "/s/c/tool", "/s/c/reaction"}
        schema, message = found["/s/b/telemetry"]
        assert json.loads(message.data) == {"tick": 2**32 + 10, "figures": {"late": 3.0}}
        assert schema is not None
        assert schema.encoding == "jsonschema"
        assert (message.sequence, message.log_time) == (10, 1_700_000_000_000_000_000)
        schema, message = found["/s/b/sample"]
        assert schema is not None
        assert (schema.encoding, schema.name) == ("ros2msg", "manyhands/msg/Rows")
        assert decode_rows(message.data)[0] == 2**32

    @pytest.mark.parametrize(
        "frame",
        [
            b"junk",
            encode(Telemetry(1, {}, {})),
            encode(observation("stranger", 10, 10, 1)),
            encode(observation("a", 10, 10, 2)),
            encode(observation("a", 10, 11, 1)),  # before tick 0
            encode(observation("environment", 10, 10, 3)),  # which has no traces
            encode(Observation("a", 10, {}, {"x": X, "f_v": X[:2]})),
            encode(Observation("a", 10, {}, {"speed": X})),
        ],
    )
    def test_what_does_not_fit_is_counted_and_not_written(self, frame: bytes, tmp_path: Path) -> None:
        core = RecorderCore(RECORDED)
        core.take(frame, 5)
        assert core.refused == 1
        self.written(core, tmp_path / "r.mcap")
        assert read_recording(tmp_path / "r.mcap").x.shape == (0, 3)

    def test_ticks_that_were_told_are_not_told_again_and_those_that_never_were_are_counted(self) -> None:
        core = RecorderCore(RECORDED)
        for tick, rows in ((10, 10), (10, 10), (15, 10), (30, 10)):
            core.take(encode(observation("a", tick, rows, 1)), 5)
        assert core.refused == 2
        assert core.missing == {"a": 10, "b": 0}

    def test_a_chunk_is_full_by_its_bytes_and_empty_when_cut(self) -> None:
        core = RecorderCore(RECORDED)
        assert b"dx" not in core.cut()
        for k in range(1, 4):
            assert not core.full
            core.take(encode(observation("a", 30_000 * k, 30_000, 1)), 5)
        assert core.full
        assert len(core.cut()) > CHUNK_BYTES
        assert not core.full
        assert core.cut() == b""


@contextmanager
def files_no_longer_than(length: int) -> Iterator[None]:
    """The kernel refuses what would make a file of this process longer, as it does on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (length, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


class Test_file:
    def test_it_takes_the_place_of_an_older_one_when_it_has_its_beginning(self, tmp_path: Path) -> None:
        path = tmp_path / "r.mcap"
        path.write_bytes(b"an older run")
        with files_no_longer_than(3), pytest.raises(OSError, match="too large"):
            RecordingFile(path, b"beginning")
        assert path.read_bytes() == b"an older run"
        file = RecordingFile(path, b"beginning")
        assert path.read_bytes() == b"beginning"
        file.append(b" and more")
        file.close()
        assert path.read_bytes() == b"beginning and more"
        assert list(tmp_path.iterdir()) == [path]

    @pytest.mark.parametrize("room", [0, 1, 8])
    def test_a_piece_is_there_whole_or_not_at_all(self, room: int, tmp_path: Path) -> None:
        file = RecordingFile(tmp_path / "r", b"1234")
        with files_no_longer_than(4 + room), pytest.raises(OSError, match="too large"):
            file.append(b"567890abc")
        assert (tmp_path / "r").read_bytes() == b"1234"
        file.append(b"5")  # there is room again
        file.close()
        assert (tmp_path / "r").read_bytes() == b"12345"


class Test_status:
    every: tuple[status.Status, ...] = (
        status.Ready("ipc:///x"),
        status.Taken(3),
        status.Stopped("no\nspace", 7),
        status.Closed({"dx": 2}, 9),
    )

    @given(st.lists(st.sampled_from(every), max_size=5), st.data())
    def test_lines_arrive_whole_however_the_pipe_cuts_them(
        self, told: list[status.Status], data: st.DataObject
    ) -> None:
        stream = b"".join(map(status.encode, told))
        cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=4)))
        lines = status.Lines()
        found: list[status.Status] = []
        for begin, end in zip([0, *cuts], [*cuts, len(stream)], strict=True):
            found += lines.feed(stream[begin:end])
        assert (found, lines.nonsense) == (told, 0)

    @pytest.mark.parametrize(
        "line", [b"", b"x", b"{}", b"[" * 9999, b'{"taken": "1"}', b'{"closed": {"a": "b"}, "tick": 1}']
    )
    def test_nonsense_is_counted(self, line: bytes) -> None:
        lines = status.Lines()
        assert list(lines.feed(line + b"\n")) == []
        assert lines.nonsense == 1

    def test_a_line_without_an_end_is_not_kept(self) -> None:
        lines = status.Lines()
        for _ in range(3):
            list(lines.feed(b"x" * status.MAX_LINE_BYTES))
        assert lines.nonsense > 0
        assert len(lines._rest) <= status.MAX_LINE_BYTES


def test_a_plan_round_trips_and_is_its_owners_alone(tmp_path: Path) -> None:
    plan = Plan(tmp_path / "r.mcap", tmp_path, RECORDED)
    plan.save(tmp_path / "p")
    assert Plan.load(tmp_path / "p") == plan
    assert os.stat(tmp_path / "p").st_mode & 0o777 == 0o600


@pytest.mark.parametrize("text", ["", "[]", '{"file": 1}', '{"file": "f", "directory": "d", "recorded": {}}'])
def test_what_is_no_plan_is_told(text: str, tmp_path: Path) -> None:
    (tmp_path / "p").write_text(text)
    with pytest.raises(PlanError, match="not a recorder's plan"):
        Plan.load(tmp_path / "p")
    with pytest.raises(PlanError, match="cannot be read"):
        Plan.load(tmp_path / "absent")


def test_a_file_of_somebody_else_is_no_recording(tmp_path: Path) -> None:
    from mcap.writer import Writer

    path = tmp_path / "r.mcap"
    for data, why in ((b"", "begin"), (b"PK" * 20, "begin"), (b"\x89MCAP0\r\n", "no word of what was recorded")):
        path.write_bytes(data)
        with pytest.raises(RecordingError, match=why):
            read_recording(path)
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.add_metadata("session", {"format": "other"})
        writer.finish()  # type: ignore[no-untyped-call]
    with pytest.raises(RecordingError, match="expected 'manyhands-recording'"):
        read_recording(path)
    with pytest.raises(RecordingError, match="cannot be read"):
        read_recording(tmp_path)
    path.write_bytes(b"\x89MCAP0\r\n" + struct.pack("<BQ", 0x06, 2**63))
    with pytest.raises(RecordingError, match="within a record"):
        read_recording(path)
