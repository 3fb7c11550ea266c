"""Recordings: whole, exact, and honest about what is missing."""

from __future__ import annotations

import csv
import re
from pathlib import Path
from typing import BinaryIO

import numpy as np
import pyarrow
import pytest
from pyarrow import parquet

from manyhands.launch.files import TargetError
from manyhands.launch.recordings.formats import SUFFIXES
from manyhands.launch.recordings.recording import Collector, Recording, RecordingError, require_suffix
from manyhands.launch.recordings.tables import read_saved

X = np.array([[0.1, 1 / 3], [0.2, -2.0], [0.3, 1e-300]])


def recording() -> Recording:
    return Recording("s", "id", 0.001, ("a", "b.x"), X, -X)


def test_npz_round_trips_bit_for_bit(tmp_path: Path) -> None:
    recording().save(tmp_path / "run.npz")
    with np.load(tmp_path / "run.npz") as data:
        np.testing.assert_array_equal(data["x"], X)
        np.testing.assert_array_equal(data["f_v"], -X)
        assert data["ports"].tolist() == ["a", "b.x"]
        assert str(data["certificate"]) == "id"
        assert float(data["period"]) == 0.001
    assert [p.name for p in tmp_path.iterdir()] == ["run.npz"]


def test_csv_keeps_every_digit(tmp_path: Path) -> None:
    recording().save(tmp_path / "run.csv")
    with (tmp_path / "run.csv").open() as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["tick", "time_s", "x[a]_m", "x[b.x]_m", "f_v[a]_N", "f_v[b.x]_N"]
    np.testing.assert_array_equal(np.array(rows[1:], dtype=float)[:, 2:4], X)


def test_parquet_keeps_every_digit_and_names_the_session(tmp_path: Path) -> None:
    recording().save(tmp_path / "run.parquet")
    table = parquet.read_table(tmp_path / "run.parquet", use_threads=False)
    assert table.column_names == ["tick", "time_s", "x[a]_m", "x[b.x]_m", "f_v[a]_N", "f_v[b.x]_N"]
    np.testing.assert_array_equal(np.column_stack([table[name] for name in ("x[a]_m", "x[b.x]_m")]), X)
    told = {b"manyhands.session": b"s", b"manyhands.certificate": b"id", b"manyhands.period": b"0.001"}
    assert table.schema.metadata == told


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_what_is_saved_is_read_again(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"s{suffix}"
    saved = Recording("s", "" if suffix == ".csv" else "id", 0.001, ("a", "b.x"), X, -X, turning=("b.x",))
    saved.save(path)
    read = read_saved(path)
    for name in ("session", "certificate", "ports", "turning"):
        assert getattr(read, name) == getattr(saved, name)
    assert abs(read.period - 0.001) < 1e-18  # .csv shows it by the last time alone, which is rounded once
    np.testing.assert_array_equal(read.x, X)
    np.testing.assert_array_equal(read.f_v, -X)


HEAD = "tick,time_s,x[a]_m,f_v[a]_N"


@pytest.mark.parametrize(
    ("head", "found"),
    [
        ("time_s,tick,x[a]_m,f_v[a]_N", "the heading"),
        ("tick,time_s,dx.ledger[E]_J,c.tool[a]_m", "x of the ports '' and f_v of ''"),
        ("tick,time_s,dx.sample[a]_m,dx.force[b]_N", "x of the ports 'a' and f_v of 'b'"),
        (f"{HEAD},dx.sample[a]_m", "two columns of the port 'a', the second 'dx.sample[a]_m'"),
        ("tick,time_s,x[a]_rad,f_v[a]_N", "f_v of the port 'a' in N, where N·m is right"),
        ("tick,time_s,x[a]_N,f_v[a]_N", "x of the port 'a' in N, where m is right"),
    ],
)
def test_a_table_that_is_no_recording_is_refused_with_what_was_found(head: str, found: str, tmp_path: Path) -> None:
    row = [str(0)] * len(head.split(","))
    (tmp_path / "t.csv").write_text("\n".join([head, ",".join(row), ",".join(["1", "0.001", *row[2:]])]) + "\n")
    columns = {name: np.zeros(2) for name in head.split(",")}
    parquet.write_table(pyarrow.table(columns), tmp_path / "t.parquet")
    for suffix in ("csv", "parquet"):
        with pytest.raises(RecordingError, match=re.escape(f"t.{suffix}: found no recording: {found}")):
            read_saved(tmp_path / f"t.{suffix}")


def test_a_damaged_parquet_file_is_refused_and_one_that_says_nothing_of_itself_is_read(tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    columns = {"tick": np.arange(3), "time_s": np.arange(3) * 0.002, "x[a]_m": X[:, 0], "f_v[a]_N": X[:, 1]}
    parquet.write_table(pyarrow.table(columns), path)
    read = read_saved(path)
    assert (read.session, read.certificate, read.period) == ("t", "", 0.002)
    content = path.read_bytes()
    for bad in (content[:-9], content[: len(content) // 2] + b"PAR1", b"PAR1"):
        path.write_bytes(bad)
        with pytest.raises(RecordingError, match="found no recording: which is damaged"):
            read_saved(path)
    texts = pyarrow.table({**columns, "x[a]_m": ["one", "two", "three"]})
    parquet.write_table(texts, path)
    with pytest.raises(RecordingError, match="found no recording"):
        read_saved(path)


def test_velocity_is_the_backward_difference_from_rest() -> None:
    np.testing.assert_allclose(recording().velocity[:, 0], [100.0, 100.0, 100.0], rtol=1e-12)


@pytest.mark.parametrize("name", ["run.mat", "run", "absent/run.npz", "folder.npz"])
def test_a_name_that_cannot_be_written_is_refused_before_the_run(name: str, tmp_path: Path) -> None:
    (tmp_path / "folder.npz").mkdir()
    with pytest.raises((RecordingError, TargetError), match="expected"):
        require_suffix(tmp_path / name)


def test_a_file_that_cannot_be_written_leaves_nothing_half_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The disk is full in the middle of it."""

    def full(file: BinaryIO, **arrays: object) -> None:
        file.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", full)
    (tmp_path / "run.npz").write_bytes(b"an older run")
    with pytest.raises(RecordingError, match=r"run\.npz.*No space left"):
        recording().save(tmp_path / "run.npz")
    assert [p.name for p in tmp_path.iterdir()] == ["run.npz"]
    assert (tmp_path / "run.npz").read_bytes() == b"an older run"


def test_collector_puts_parts_together_and_counts_a_gap() -> None:
    collector = Collector({"a": ("a",), "b": ("b.x",)})
    collector.add("a", 2, X[:2, :1], -X[:2, :1])
    collector.add("a", 3, X[2:, :1], -X[2:, :1])
    collector.add("b", 1, X[:1, 1:], -X[:1, 1:])
    collector.add("b", 4, X[2:, 1:], -X[2:, 1:])  # ticks 1 and 2 were lost
    out = collector.recording("s", "c", 0.001)
    assert out.x.shape == (4, 2)
    np.testing.assert_array_equal(out.x[:, 0], [*X[:, 0], np.nan])
    np.testing.assert_array_equal(out.x[:, 1], [X[0, 1], np.nan, np.nan, X[2, 1]])
    np.testing.assert_array_equal(out.f_v[:, 1], [-X[0, 1], np.nan, np.nan, -X[2, 1]])
    assert collector.missing == out.missing == {"a": 1, "b": 2}


def test_a_silent_node_empties_no_others_recording(tmp_path: Path) -> None:
    """A guest whose telemetry never comes, and one whose telemetry ends early."""
    collector = Collector({"a": ("a",), "silent": ("s.x", "s.y"), "early": ("e",)})
    collector.add("a", 3, X[:, :1], -X[:, :1])
    collector.add("early", 1, X[:1, :1], X[:1, :1])
    out = collector.recording("s", "c", 0.001)
    np.testing.assert_array_equal(out.x[:, 0], X[:, 0])
    np.testing.assert_array_equal(out.f_v[:, 0], -X[:, 0])
    assert np.isnan(out.x[:, 1:3]).all()
    np.testing.assert_array_equal(out.x[:, 3], [X[0, 0], np.nan, np.nan])
    assert collector.missing == out.missing == {"silent": 3, "early": 2}
    for name in ("run.npz", "run.csv"):
        out.save(tmp_path / name)
        read = read_saved(tmp_path / name)
        np.testing.assert_array_equal(read.x, out.x)
        np.testing.assert_array_equal(read.f_v, out.f_v)
    assert Collector({"a": ("a",)}).recording("s", "c", 0.001).x.shape == (0, 1)


def test_collector_drops_and_counts_what_does_not_fit() -> None:
    collector = Collector({"a": ("a",)})
    collector.add("stranger", 1, X[:1, :1], X[:1, :1])
    collector.add("a", 3, X, X)  # two columns for one port
    collector.add("a", 3, X[:, 0], X[:, 0])
    collector.add("a", 2**62, X[:, :1], X[:, :1])
    collector.add("a", 3, X[:, :1], X[:, :1])
    collector.add("a", 4, X[:, :1], X[:, :1])  # repeats two ticks
    assert collector.refused == 5
    assert collector.missing == {}
    np.testing.assert_array_equal(collector.recording("s", "c", 0.001).x, X[:, :1])
