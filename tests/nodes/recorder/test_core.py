"""The recorder's core: the file's layout, the frames that it accepts or refuses, and a disk that fails."""

from __future__ import annotations

import json
import math
import os
import resource
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from manyhands.launch.recordings.recording import RecordingError
from manyhands.launch.recordings.run import read_run
from manyhands.launch.recordings.tables import read_recording
from manyhands.nodes.recorder import node as status
from manyhands.nodes.recorder.core import CHUNK_BYTES, RecorderCore, Ticks, row_texts
from manyhands.nodes.recorder.format import Recorded, decode_condition, decode_figures, encode_condition, encode_figures
from manyhands.nodes.recorder.mcap import RecordingFile
from manyhands.nodes.recorder.node import PlanError, RecordingPlan
from manyhands.protocol.codec import encode
from manyhands.protocol.messages import Condition, Figures, Observation, PromiseStatus, Role, Stop, Telemetry

SENTENCES = ("silent", "notices", "incidents", "faults")
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
    return Observation(node, tick, Figures(more), dict(zip(names, (x, -x), strict=True)))


class Test_rows:
    @given(hnp.arrays(np.float64, hnp.array_shapes(min_dims=2, max_dims=2, max_side=8), elements=numbers))
    def test_each_row_is_json_that_reads_back_as_the_same_doubles(self, values: np.ndarray) -> None:
        texts = row_texts(values, one=False)
        found = [json.loads(b"[%b]" % text, parse_constant=pytest.fail) for text in texts]
        told = np.array(found, dtype=np.float64)
        expected = np.where(np.isfinite(values), values, np.nan)
        assert told.shape == values.shape
        assert np.array_equal(told, expected, equal_nan=True)
        assert np.array_equal(np.signbit(told[told == 0]), np.signbit(expected[expected == 0]))
        ones = [json.loads(text) for text in row_texts(values[:, :1], one=True)]
        assert ones == [row[0] for row in found]

    @given(st.integers(0, 2**40), st.integers(1, 5), st.sampled_from([0.001, 1 / 3000, 2e-4, 0.0125]))
    def test_the_time_of_a_tick_is_exact_to_the_nanosecond(self, first: int, count: int, period: float) -> None:
        told = replace(RECORDED, period=period)
        ticks = Ticks.of(first, count, 10**18, told.tick_ns("a"))
        for k, (begin, time) in enumerate(zip(ticks.beginnings, ticks.times.tolist(), strict=True), first):
            plain = json.loads(begin + b'"x": 0}')
            assert plain["tick"] == k
            assert plain["time"] == pytest.approx(k * period, rel=1e-9, abs=1e-9)
            assert time - 10**18 == pytest.approx(k * period * 1e9, rel=1e-9, abs=1)
        assert ticks.sequences.tolist() == [k % 2**32 for k in range(first, first + count)]

    def test_the_time_of_a_usual_period_has_no_tail(self) -> None:
        ticks = Ticks.of(0, 5000, 0, RECORDED.tick_ns("a"))
        assert max(ticks.lengths) == len(b'{"tick": 4999, "time": 4.999, ')
        assert ticks.times.tolist() == list(range(0, 5_000_000_000, 1_000_000))


class Test_layout:
    def test_figures_that_json_cannot_say_are_null(self) -> None:
        told = encode_figures(
            3, Figures({"a": math.nan, "b": math.inf, "c": 0.1}, {"tau_us": {"p99": math.nan, "p50": 2.5}})
        )
        plain = json.loads(told, parse_constant=pytest.fail)
        assert plain == {"tick": 3, "figures": {"a": None, "b": None, "c": 0.1, "tau_us": {"p99": None, "p50": 2.5}}}
        tick, figures = decode_figures(plain)
        assert (tick, figures["c"], math.isnan(figures["a"])) == (3, 0.1, True)
        assert (figures.table("tau_us")["p50"], math.isnan(figures.table("tau_us")["p99"])) == (2.5, True)

    def test_names_with_prefixes_of_before_protocol_6_are_read_as_tables(self) -> None:
        former = {"late": 3.0, "tau_us_p99": 9.0, "moved_a/b_c": 1.0, "moved_b_c/a": 2.0, "wave_lag_us_b_c": 4.0,
                  "rung_a": 1.0, "driver_heat": 40.0, "held_a": 7.0, "held:a@3": 2.0, "unexerted_most": 0.5,
                  "waited_us_a": 6.0, "frozen_ticks": 5.0, "wave_deaf": 1.0, "wave_deaf_a": 0.0}  # fmt: skip
        _, figures = decode_figures({"tick": 3, "figures": former})
        assert dict(figures) == {
            "late": 3.0, "held:a@3": 2.0, "unexerted_most": 0.5, "frozen_ticks": 5.0, "wave_holding": 1.0
        }  # fmt: skip
        assert figures.tables == {
            "tau_us": {"p99": 9.0},
            "moved": {"a/b_c": 1.0, "b_c/a": 2.0},
            "wave_lag_us_of": {"b_c": 4.0},
            "wave_holding_of": {"a": 0.0},
            "rung_of": {"a": 1.0},
            "driver": {"heat": 40.0},
            "held": {"a": 7.0},
            "waited_us": {"a": 6.0},
        }

    def test_a_condition_round_trips(self) -> None:
        promises = (PromiseStatus("delay", "kept", since=0.0),
                    PromiseStatus("pace", "broken", ("ä", "b"), 0.5, 1.5, {"x": 0.25, "s": 3.0}, "slow"))  # fmt: skip
        condition = Condition("running", 0.5, {"a": "running"}, ("a",), ("ä: so",), ("b\nc",), ("d",), promises,
                              visits=("a has joined",))  # fmt: skip
        assert decode_condition(json.loads(encode_condition(7, condition))) == (7, condition)

    @pytest.mark.parametrize("key", ["promises", "by_itself", "visits"])
    def test_a_condition_of_a_version_without_what_was_added_is_read(self, key: str) -> None:
        plain = json.loads(encode_condition(7, Condition("over", 0.5, {}, (), ("n",))))
        del plain[key]
        assert decode_condition(plain) == (7, Condition("over", 0.5, {}, (), ("n",)))

    def test_a_condition_is_at_the_tick_of_a_session_that_has_no_device_yet(self, tmp_path: Path) -> None:
        core = RecorderCore(RECORDED, {}, started=0)
        rows = {"x_e": np.zeros((700, 3))}
        core.take(encode(Observation("environment", 700, Figures({}), rows)), 0)
        core.take(encode(Condition("running", 0.7, {}, visits=("a has joined",))), 0)
        path = tmp_path / "run.mcap"
        path.write_bytes(core.cut() + core.end())
        assert [tick for tick, _ in read_run(path).conditions] == [700]

    def test_a_condition_in_which_only_costs_grow_is_written_once(self) -> None:
        core = RecorderCore(RECORDED, {}, started=0)
        sizes = []
        for step in range(4):
            row = PromiseStatus("delay", "enforced", ("a",), 0.1, None, {"ticks": 1.0 + step}, "")
            core.take(encode(Condition("running", 0.1 * step, {"a": "running"}, promises=(row,))), step)
            sizes.append(len(core.cut()))
        assert sizes[0] > 0
        assert sizes[1:] == [0, 0, 0]
        core.take(encode(Condition("running", 0.5, {"a": "running"}, promises=(replace(row, state="broken"),))), 5)
        assert len(core.cut()) > 0

    @pytest.mark.parametrize(
        "plain",
        [
            None,
            [],
            {"tick": 1},
            {"tick": -1, "figures": {}},
            {"tick": 2**63, "figures": {}},
            {"tick": 1, "figures": {"a": "b"}},
            {"tick": 1, "figures": {"a": True}},
            {"tick": 1, "figures": {"a": 10**400}},
            {"tick": 1, "phase": "p", "elapsed": None, "states": {}, **{key: [] for key in SENTENCES}},
            {"tick": 1, "phase": "p", "elapsed": 1.0, "states": {"a": 1}, **{key: [] for key in SENTENCES}},
            {"tick": 1, "phase": "p", "elapsed": 1.0, "states": {}, **{key: [1] for key in SENTENCES}},
            {"tick": 1, "phase": "p", "elapsed": 1.0, "states": {}},
            *(
                {
                    "tick": 1,
                    "phase": "p",
                    "elapsed": 1.0,
                    "states": {},
                    **{key: [] for key in SENTENCES},
                    "promises": bad,
                }
                for bad in (
                    5,
                    [5],
                    [{"promise": "p", "state": "s", "remark": "", "cost": {}}],
                    [{"promise": "p", "state": "s", "remark": "", "cost": {"J": "1"}, "who": []}],
                    [{"promise": "p", "state": "s", "remark": "", "cost": {}, "who": [], "since": "1"}],
                )
            ),
        ],
    )
    def test_what_is_none_is_refused(self, plain: object) -> None:
        for decode in (decode_figures, decode_condition):
            with pytest.raises(ValueError, match="expected"):
                decode(plain)

    def test_what_was_recorded_round_trips(self) -> None:
        for recorded in (RECORDED, replace(RECORDED, masses=("m", "n"), version="9")):
            assert Recorded.from_metadata(recorded.as_metadata()) == recorded
        assert RECORDED.devices == {"a": ("a",), "b": ("b.0", "b.1")}

    @pytest.mark.parametrize(
        "change",
        [
            {"format": "other"},
            {"version": "1"},
            {"masses": "[1]"},
            {"masses": "1"},
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

    def test_the_file_holds_every_accepted_frame(self, tmp_path: Path) -> None:
        core = RecorderCore(RECORDED)
        for tick in (10, 20):
            core.take(encode(observation("a", tick, 10, 1, late=1.0)), 5)
            core.take(encode(observation("b", tick, 10, 2)), 5)
            core.take(encode(observation("c", tick, 10, 3, ledger=math.nan)), 5)
            core.take(encode(Observation("environment", tick, Figures({"ledger": 0.5}), {})), 5)
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

    @pytest.mark.parametrize(
        "frame",
        [
            b"junk",
            encode(Telemetry(1, Figures(), {})),
            encode(observation("stranger", 10, 10, 1)),
            encode(observation("a", 10, 10, 2)),
            encode(observation("a", 10, 11, 1)),  # before tick 0
            encode(observation("environment", 10, 10, 3)),  # whose traces are others
            encode(observation("c", 10, 10, 2)),
            encode(Observation("a", 10, Figures(), {"ledger": np.zeros((10, 2))})),  # one number a tick
            encode(Observation("environment", 10, Figures(), {"q": np.zeros((10, 0))})),  # it has no masses
            encode(Observation("a", 2**60, Figures(), {"x": X, "f_v": X})),  # in the year 36 million
            encode(Observation("a", 10, Figures(), {"x": X, "f_v": X[:2]})),
            encode(Observation("a", 10, Figures(), {"speed": X})),
        ],
    )
    def test_what_does_not_fit_is_counted_and_not_written(self, frame: bytes, tmp_path: Path) -> None:
        core = RecorderCore(RECORDED)
        core.take(frame, 5)
        assert core.refused == 1
        self.written(core, tmp_path / "r.mcap")
        assert read_recording(tmp_path / "r.mcap").x.shape == (0, 3)

    def test_repeated_ticks_are_refused_and_missing_ticks_are_counted(self) -> None:
        core = RecorderCore(RECORDED)
        for tick, rows in ((10, 10), (10, 10), (15, 10), (30, 10)):
            core.take(encode(observation("a", tick, rows, 1)), 5)
        assert core.refused == 2
        assert (core.coverage["a"].missing, core.coverage["b"].missing) == (10, 0)
        assert core.missing_in_all == {"a": 10, "b": 30}  # b never sent telemetry; its ticks are missing, too

    def test_a_chunk_is_full_by_its_bytes_and_empty_when_cut(self) -> None:
        core = RecorderCore(RECORDED)
        assert core.cut()  # the beginning
        for k in range(1, 4):
            assert not core.full
            core.take(encode(observation("a", 3000 * k, 3000, 1)), 5)
        assert core._tape.waiting > CHUNK_BYTES
        assert core.full
        assert core.cut()
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
    def test_it_replaces_an_older_file_once_its_beginning_is_written(self, tmp_path: Path) -> None:
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
        status.FileBegun("ipc:///x"),
        status.Taken(3),
        status.WriteFailed("no\nspace", 7),
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
        "line",
        [
            b"",
            b"x",
            b"{}",
            b"[" * 9999,
            b'{"kind": "taken", "frames": "1"}',
            b'{"kind": "closed", "missing": {"a": "b"}, "tick": 1}',
        ],
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
    plan = RecordingPlan(tmp_path / "r.mcap", tmp_path, RECORDED, {"session.yaml": "name: ü\n".encode()}, 17)
    plan.save(tmp_path / "p")
    assert RecordingPlan.load(tmp_path / "p") == plan
    assert os.stat(tmp_path / "p").st_mode & 0o777 == 0o600


@pytest.mark.parametrize("text", ["", "[]", '{"file": 1}', '{"file": "f", "directory": "d", "recorded": {}}'])
def test_an_invalid_plan_is_reported(text: str, tmp_path: Path) -> None:
    (tmp_path / "p").write_text(text)
    with pytest.raises(PlanError, match="not a recorder's plan"):
        RecordingPlan.load(tmp_path / "p")
    with pytest.raises(PlanError, match="cannot be read"):
        RecordingPlan.load(tmp_path / "absent")


def test_a_file_of_somebody_else_is_no_recording(tmp_path: Path) -> None:
    from mcap.writer import Writer

    path = tmp_path / "r.mcap"
    for data, why in ((b"", "begin"), (b"PK" * 20, "begin"), (b"\x89MCAP0\r\n", "no metadata of a session")):
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


@pytest.mark.parametrize("harm", ["cut", "longer", "removed"])
def test_a_file_that_another_program_changes_is_not_gone_on_with(harm: str, tmp_path: Path) -> None:
    """What came next would stand behind a hole, or in no file, and the session would call it written."""
    path = tmp_path / "r"
    file = RecordingFile(path, b"1234")
    match harm:
        case "cut":
            os.truncate(path, 2)
        case "longer":
            path.write_bytes(b"123456")
        case _:
            path.unlink()
    with pytest.raises(OSError, match="another program has"):
        file.append(b"5678")
    file.close()
