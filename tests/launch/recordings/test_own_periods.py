"""A recording whose site has a period of its own: every node is read, shown and exported by its own ticks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from manyhands.launch.audit.replay import require_simulated
from manyhands.launch.look.plots import figure_of, picture_of_run
from manyhands.launch.recordings.info import read_info
from manyhands.launch.recordings.recording import RecordingError
from manyhands.launch.recordings.run import RecordedRun, RecordedTrace, export, read_run
from manyhands.launch.recordings.tables import read_recording
from manyhands.nodes.recorder.core import RecorderCore
from manyhands.nodes.recorder.format import Recorded
from manyhands.protocol.codec import encode
from manyhands.protocol.messages import Figures, Observation, Role

T, OWN, TICKS = 1e-3, 0.25e-3, 30
RECORDED = Recorded(
    "s",
    "id",
    T,
    "realtime",
    {"a": Role.DEVICE, "b": Role.DEVICE, "ca": Role.COUPLING, "cb": Role.COUPLING, "environment": Role.ENVIRONMENT},
    {"a": ("a",), "b": ("b",), "ca": ("a",), "cb": ("b",), "environment": ("a", "b")},
    periods={"a": OWN, "ca": OWN},
)
TRACES = {Role.DEVICE: ("x", "f_v"), Role.COUPLING: ("p", "f_v"), Role.ENVIRONMENT: ("x_e",)}


def column(node: str, own: int) -> np.ndarray:
    """The number of the tick in every row."""
    return np.tile(np.arange(float(own))[:, None], (1, len(RECORDED.ports[node])))


def written(path: Path, recorded: Recorded = RECORDED, missing: tuple[str, ...] = ()) -> Path:
    """The recording of a run of ``TICKS`` ticks of the session; telemetry comes twice, ``missing`` nodes once."""
    core = RecorderCore(recorded)
    for node, role in recorded.roles.items():
        ticks = TICKS * round(recorded.rate_of(node))
        values = column(node, ticks)
        for begin, end in ((0, ticks // 2), (ticks // 2, ticks)):
            if begin and node in missing:
                continue
            traces = dict.fromkeys(TRACES[role], values[begin:end])
            assert core.refused == 0
            core.take(
                encode(Observation(node, end, Figures({"late": 0.0}), traces)), 10**18 + round(T * TICKS / 2 * 1e9)
            )
    assert core.tick == TICKS
    path.write_bytes(core.cut() + core.end())
    return path


@pytest.fixture
def run(tmp_path: Path) -> RecordedRun:
    return read_run(written(tmp_path / "run.mcap"))


def test_metadata_state_the_periods_and_are_as_before_without_them() -> None:
    texts = RECORDED.as_metadata()
    assert Recorded.from_metadata(texts) == RECORDED
    plain = replace(RECORDED, periods={})
    assert plain.as_metadata() == {name: text for name, text in texts.items() if name != "periods"}


@pytest.mark.parametrize("periods", ['{"z": 0.001}', '{"a": 0}', '{"a": -1}', '{"a": "1"}', "[1]", '{"a": 1e999}'])
def test_periods_that_make_no_sense_are_refused(periods: str) -> None:
    with pytest.raises(ValueError, match="found"):
        Recorded.from_metadata(RECORDED.as_metadata() | {"periods": periods})


def test_a_node_has_the_rows_of_its_own_ticks(run: RecordedRun) -> None:
    assert run.ticks == TICKS
    for node, count in (("a", 4 * TICKS), ("ca", 4 * TICKS), ("b", TICKS), ("environment", TICKS)):
        assert run.ticks_of(node) == count
        for (of, _), trace in run.traces.items():
            if of == node and trace.topic.trace in ("x", "p", "x_e"):
                np.testing.assert_array_equal(trace.values, column(node, count))


def test_messages_have_the_time_of_their_own_tick(tmp_path: Path) -> None:
    found = read_info(written(tmp_path / "run.mcap"))
    rates = {channel.topic: channel.rate for channel in found.channels if channel.topic.endswith(("sample", "tools"))}
    assert rates == pytest.approx({"/s/a/sample": 4000.0, "/s/b/sample": 1000.0, "/s/environment/tools": 1000.0})
    assert (found.first, found.ticks, found.duration) == (0, TICKS, pytest.approx(T * TICKS))
    assert found.missing == {}
    assert found.as_plain()["periods"] == {"a": OWN, "ca": OWN}


@pytest.mark.parametrize("lost", ["a", "b"])
def test_missing_ticks_are_the_devices_own(tmp_path: Path, lost: str) -> None:
    found = read_info(written(tmp_path / "run.mcap", missing=(lost,)))
    own = TICKS * round(RECORDED.rate_of(lost))
    assert found.missing == {lost: own // 2}
    assert [(gap.begin, gap.end) for gap in found.gaps[lost]] == [(own // 2, own)]


def test_a_table_has_the_newest_row_of_each_node_at_the_sessions_ticks(run: RecordedRun, tmp_path: Path) -> None:
    export(run, tmp_path / "run.npz", "npz")
    with np.load(tmp_path / "run.npz") as found:
        np.testing.assert_array_equal(found["tick"], np.arange(TICKS))
        np.testing.assert_array_equal(found["a.sample[a]_m"], 4.0 * np.arange(TICKS))
        np.testing.assert_array_equal(found["b.sample[b]_m"], np.arange(TICKS))
        np.testing.assert_array_equal(found["x"], np.stack([4.0 * np.arange(TICKS), np.arange(TICKS)], axis=1))
    export(run, tmp_path / "run.csv", "csv", ("a/sample", "b/sample"))
    lines = (tmp_path / "run.csv").read_text().splitlines()
    assert lines[3] == "2,0.002,8.0,2.0"
    assert len(lines) == 1 + TICKS


def test_arrays_have_the_newest_row_at_the_sessions_ticks_and_velocities_each_devices_own(run: RecordedRun) -> None:
    expected = np.stack([4.0 * np.arange(TICKS), np.arange(TICKS)], axis=1)
    np.testing.assert_array_equal(run.x, expected)
    np.testing.assert_array_equal(run.f_v, expected)
    np.testing.assert_array_equal(run.columns("a/sample")["a.sample[a]_m"], expected[:, 0])
    np.testing.assert_allclose(run.velocity[1:], np.tile([1.0 / OWN, 1.0 / T], (TICKS - 1, 1)))
    assert (run.session, run.certificate, run.period, run.ports) == ("s", "id", T, ("a", "b"))


def test_velocities_in_wall_time_are_over_the_instants_of_the_samples() -> None:
    recorded = replace(RECORDED, periods={})
    sample, instants = (topic for topic in recorded.topics("a") if topic.trace in ("x", "instants"))
    x = np.array([[0.0], [0.002], [0.003]])  # m
    s = np.array([[0.0, 0.0], [2e6, 2e6], [3e6, 3e6]])  # ns: the second sample came a period late
    traces = {
        ("a", sample.name): RecordedTrace(sample, ("a",), x),
        ("a", instants.name): RecordedTrace(instants, ("s", "a"), s),
        ("b", sample.name): RecordedTrace(sample, ("b",), x),
    }
    found = RecordedRun(recorded, traces).velocity
    np.testing.assert_allclose(found[1:], [[1.0, 2.0], [1.0, 1.0]])


def test_a_table_of_x_and_f_v_alone_needs_one_period_for_all_devices(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"found the period 0.00025 s of a and 0.001 s of b; expected devices of"):
        read_recording(written(tmp_path / "run.mcap"))
    alike = replace(RECORDED, periods=dict.fromkeys(("a", "b", "ca", "cb"), OWN))
    found = read_recording(written(tmp_path / "alike.mcap", alike))
    assert (found.period, found.missing) == (OWN, {})
    np.testing.assert_array_equal(found.x, np.tile(column("a", 4 * TICKS), (1, 2)))


def test_a_picture_has_each_curve_over_its_own_ticks(run: RecordedRun) -> None:
    picture = picture_of_run(run, ("sample", "velocity"))
    sample, velocity = picture.panels
    assert [(curve.label, curve.rate, len(curve.values)) for curve in sample.curves] == [
        ("a", 4.0, 4 * TICKS),
        ("b", 1.0, TICKS),
    ]
    np.testing.assert_allclose(velocity.curves[0].values[1:], 1.0 / OWN)
    np.testing.assert_allclose(velocity.curves[1].values[1:], 1.0 / T)
    lines = figure_of(picture).axes[0].get_lines()
    np.testing.assert_allclose(np.asarray(lines[0].get_xdata())[[1, -1]], [OWN, (4 * TICKS - 1) * OWN])
    np.testing.assert_allclose(np.asarray(lines[1].get_xdata())[[1, -1]], [T, (TICKS - 1) * T])


def test_a_recording_of_later_hours_begins_with_the_same_tick_for_all(tmp_path: Path) -> None:
    core, hour = RecorderCore(RECORDED), 10**9
    for node in ("a", "b"):
        first = hour * round(RECORDED.rate_of(node))
        x = np.ones((8, 1))
        core.take(encode(Observation(node, first + 8, Figures(), {"x": x, "f_v": x})), 10**18)
    path = tmp_path / "late.mcap"
    path.write_bytes(core.cut() + core.end())
    run = read_run(path)
    assert (run.first, run.first_of("a"), run.first_of("b")) == (hour, 4 * hour, hour)
    assert (run.ticks, run.ticks_of("a")) == (8, 32)
    assert run.traces["a", "sample"].values[:8].tolist() == [[1.0]] * 8


def test_no_replay_is_claimed_of_it(run: RecordedRun, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"found the period 0.00025 s of a; expected the session's, 0.001 s"):
        require_simulated(tmp_path / "run.mcap", run)


def test_figures_keep_the_nodes_own_tick(run: RecordedRun) -> None:
    assert [tick for tick, _ in run.figures["a"]] == [2 * TICKS, 4 * TICKS]
