"""A recording as a table: every number exact, in each format."""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from pyarrow import parquet
from typer.testing import CliRunner

from manyhands.extras import MissingExtra
from manyhands.launch.app.cli import app
from manyhands.launch.recordings.formats import TABLES
from manyhands.launch.recordings.recording import RecordingError
from manyhands.launch.recordings.run import RecordedRun, chosen, column_names, export, read_run
from manyhands.launch.recordings.tables import read_saved
from manyhands.nodes.recorder.core import RecorderCore

from ...support.small_recordings import RECORDED, STARTED, cut_recording, observation

NAMES = [
    *("dx.sample[x]_m", "dx.force[x]_N", "dx.ledger[E]_J", "dx.tau[τ]_us"),
    *("c.tool[x]_m", "c.reaction[x]_N", "c.ledger[E]_J"),
    *("environment.tools[x]_m", "environment.masses[puck]_m", "environment.ledger[E]_J"),
]

pytestmark = pytest.mark.usefixtures("own_interrupt")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """Ticks 0 to 4 and 10 to 14 of a device, 0 to 19 of the others."""
    core = RecorderCore(RECORDED)
    for node, ticks in (("dx", (5, 15)), ("c", (5, 10, 15, 20)), ("environment", (20,))):
        for tick in ticks:
            core.take(observation(node, tick, 20 if node == "environment" else 5), STARTED)
    path = tmp_path / "run.mcap"
    path.write_bytes(core.cut() + core.end())
    return path


def values_of(run: RecordedRun) -> dict[str, np.ndarray]:
    return {
        name: trace.values[:, place]
        for (node, _), trace in run.traces.items()
        for place, name in enumerate(column_names(node, trace))
    }


def from_csv(path: Path) -> dict[str, np.ndarray]:
    with path.open(newline="", encoding="utf-8") as text:
        head, *rows = csv.reader(text)
    return dict(zip(head, np.array(rows, dtype=np.float64).T, strict=True))


def from_npz(path: Path) -> dict[str, np.ndarray]:
    with np.load(path) as found:
        return {name: found[name] for name in found.files}


def from_parquet(path: Path) -> dict[str, np.ndarray]:
    table = parquet.read_table(path, use_threads=False)
    return {name: table[name].to_numpy() for name in table.column_names}


READERS = {"csv": from_csv, "npz": from_npz, "parquet": from_parquet}


@pytest.mark.parametrize("to", TABLES)
def test_every_number_comes_back_as_it_was(to: str, file: Path, tmp_path: Path) -> None:
    run, parts = read_run(file), []
    export(run, tmp_path / f"out.{to}", to, progress=parts.append)
    found, expected = READERS[to](tmp_path / f"out.{to}"), values_of(run)
    assert [*expected] == NAMES
    assert np.isnan(expected["dx.sample[x]_m"]).tolist() == [not (k < 5 or 10 <= k < 15) for k in range(20)]
    assert found["tick"].tolist() == list(range(20))
    assert found["time_s"].tobytes() == run.time.tobytes()
    read = read_saved(tmp_path / f"out.{to}")
    np.testing.assert_array_equal(read.x, run.x)
    np.testing.assert_array_equal(read.f_v, run.f_v)
    assert (read.ports, read.turning) == (run.ports, ())
    assert abs(read.period - run.period) < 1e-15 * run.period
    for name, values in expected.items():
        assert np.array_equal(found[name], values, equal_nan=True), name
    assert parts[-1] == 1.0


def test_the_csv_table_has_one_row_per_tick_and_ordered_columns(file: Path, tmp_path: Path) -> None:
    export(read_run(file), tmp_path / "out.csv", "csv")
    first, *rows = (tmp_path / "out.csv").read_text(encoding="utf-8").splitlines()
    assert first == ",".join(["tick", "time_s", *NAMES])
    assert len(rows) == 20
    assert rows[7].startswith("7,0.007,nan,nan,")


def test_the_arrays_are_those_of_a_simulations_file_and_more(file: Path, tmp_path: Path) -> None:
    run = read_run(file)
    export(run, tmp_path / "out.npz", "npz")
    found = from_npz(tmp_path / "out.npz")
    assert np.array_equal(found["x"], run.traces["dx", "sample"].values, equal_nan=True)
    assert np.array_equal(found["f_v"], run.traces["dx", "force"].values, equal_nan=True)
    assert (found["ports"].tolist(), float(found["period"])) == (["x"], 0.001)
    assert (str(found["session"]), str(found["certificate"])) == ("s", RECORDED.certificate)


def test_the_data_frame_knows_its_session(file: Path, tmp_path: Path) -> None:
    export(read_run(file), tmp_path / "out.parquet", "parquet")
    told = parquet.read_schema(tmp_path / "out.parquet").metadata
    assert told[b"manyhands.session"] == b"s"
    assert told[b"manyhands.certificate"] == RECORDED.certificate.encode()
    assert float(told[b"manyhands.period"]) == 0.001


@pytest.mark.parametrize(
    ("patterns", "expected"),
    [
        ([], NAMES),
        (["dx"], NAMES[:4]),
        (["force"], NAMES[1:2]),
        (["*/ledger"], [NAMES[2], NAMES[6], NAMES[9]]),
        (["c/tool", "/s/dx/s*"], [NAMES[0], NAMES[4]]),
    ],
)
def test_topics_are_chosen_by_patterns(patterns: list[str], expected: list[str], file: Path) -> None:
    traces = chosen(read_run(file), patterns)
    assert [name for (node, _), trace in traces.items() for name in column_names(node, trace)] == expected


def test_without_the_devices_forces_there_is_no_f_v(file: Path, tmp_path: Path) -> None:
    export(read_run(file), tmp_path / "out.npz", "npz", ["sample"])
    found = from_npz(tmp_path / "out.npz")
    assert "x" in found
    assert not {"f_v", "dx.force[x]_N"} & found.keys()


def test_a_pattern_without_match_is_refused_with_the_available_names(file: Path, tmp_path: Path) -> None:
    (tmp_path / "out.csv").write_text("an older table")
    with pytest.raises(RecordingError, match=r"found 'dz'.*expected one of dx/sample, dx/force"):
        export(read_run(file), tmp_path / "out.csv", "csv", ["dz"])
    assert (tmp_path / "out.csv").read_text() == "an older table"


def test_without_pyarrow_the_error_names_how_to_get_it(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(MissingExtra, match=r"pip install 'manyhands\[parquet\]'"):
        export(read_run(file), tmp_path / "out.parquet", "parquet")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run.mcap"]


def test_the_command_writes_beside_the_recording(file: Path) -> None:
    result = CliRunner().invoke(app, ["export", str(file), "--format", "csv", "--topics", "dx/*,masses"])
    assert (result.exit_code, result.stdout) == (0, "")
    assert result.stderr.splitlines()[-2:] == [
        f"warning: {file}: ticks are missing in the recording: 10 of 20 of dx, the first at tick 5 (0.005 s); the "
        "table has NaN there",
        f"20 ticks written to {file.with_suffix('.csv')}",
    ]
    assert [*from_csv(file.with_suffix(".csv"))] == ["tick", "time_s", *NAMES[:4], NAMES[8]]


@pytest.mark.parametrize(("option", "name"), [("-o", "own.csv"), ("--layout", "own.json")])
def test_a_file_that_exists_is_replaced_where_the_user_says_so_alone(
    file: Path, tmp_path: Path, option: str, name: str
) -> None:
    (own := tmp_path / name).write_text("precious")
    command = ["export", str(file), option, str(own)]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 2
    assert f"{own}: found a file that exists; expected a new name, or --overwrite" in result.stderr
    assert own.read_text() == "precious"
    assert CliRunner().invoke(app, [*command, "--overwrite"]).exit_code == 0
    assert len(own.read_text()) > 100


def test_a_bag_is_never_replaced(file: Path, tmp_path: Path) -> None:
    (own := tmp_path / "own.rosbag").mkdir()
    result = CliRunner().invoke(app, ["export", str(file), "-o", str(own), "--overwrite"])
    assert result.exit_code == 2
    assert "--overwrite: found a bag, which is a folder and never replaced" in result.stderr
    assert list(own.iterdir()) == []


def test_nothing_is_said_of_a_node_that_is_whole(file: Path) -> None:
    result = CliRunner().invoke(app, ["export", str(file), "--format", "csv", "--topics", "c/tool"])
    assert (result.exit_code, "missing" in result.stderr) == (0, False)


def test_the_command_reports_a_cut_recording(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(cut_recording(ticks=20, each=5))
    result = CliRunner().invoke(app, ["export", str(path), "-o", str(tmp_path / "out.npz")])
    assert result.exit_code == 0
    assert "warning" in result.stderr
    assert 0 < len(from_npz(tmp_path / "out.npz")["tick"]) < 20


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "found neither --format nor -o; expected one of csv, npz"),
        (["--format", "xls"], "--format: found 'xls'"),
        (["-o", "out.xls"], "-o: found 'xls'"),
        (["-o", "out.json"], "-o: found out.json, which is a layout's suffix; expected --layout out.json"),
        (["--format", "csv", "-o", "out.npz"], "expected one of .csv"),
        (["--format", "csv", "-o", "nowhere/out.csv"], "found no folder nowhere"),
        (["--format", "csv", "--topics", "dz"], "found 'dz'"),
    ],
)
def test_the_command_refuses(arguments: list[str], said: str, file: Path) -> None:
    result = CliRunner().invoke(app, ["export", str(file), *arguments])
    assert (result.exit_code, result.stdout) == (2, "")
    assert said in result.stderr
    assert json.dumps(result.stderr).count("error") == 1
    assert not file.with_suffix(".csv").exists()
