"""A sweep computes each case once, on any executor, and goes on from its journal, whatever ended it."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest

import manyhands as mh
from manyhands.launch.app.sweep import Row
from manyhands.launch.files import TargetError, claimed

TAUS = [0.0, 0.0001, 0.0002, 0.0003]
GRID = {"design.tau": TAUS}
COUNT = "MANYHANDS_TEST_COUNT"  # a folder with a file for each case that was computed
DEADLY = "MANYHANDS_TEST_DEADLY"  # tau of the case that ends its process


def tau_of(session: mh.Session) -> Row:
    """A quick task that notes that it ran."""
    tau = session.design.stated_tau
    assert tau is not None
    (Path(os.environ[COUNT]) / f"{tau}-{len(os.listdir(os.environ[COUNT]))}").touch()
    if os.environ.get(DEADLY) == str(tau):
        os._exit(7)
    return {"twice": 2.0 * tau, "name": session.name}


def sour(session: mh.Session) -> Row:
    """A task that fails for one case."""
    if session.design.tau == TAUS[1]:
        raise RuntimeError("sour")
    return {"value": np.float64(1.5), "list": [1]} if session.design.tau == TAUS[2] else {"value": np.float64(1.5)}  # type: ignore[dict-item]


@pytest.fixture(autouse=True)
def count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "count"
    folder.mkdir()
    monkeypatch.setenv(COUNT, str(folder))
    return folder


@pytest.fixture
def threads() -> Iterator[Executor]:
    with ThreadPoolExecutor(2) as executor:
        yield executor


def computed(folder: Path) -> list[str]:
    return sorted(path.name.partition("-")[0] for path in folder.iterdir())


def test_a_sweep_designs_every_combination_as_a_single_design_does(threads: Executor) -> None:
    found = mh.sweep("example1", {"design.tau": [0.0, 0.0005], "design.objective": ["stiffest"]}, executor=threads)
    assert [dict(case) for case in found.cases] == [
        {"design.tau": 0.0, "design.objective": "stiffest"},
        {"design.tau": 0.0005, "design.objective": "stiffest"},
    ]
    for case, row in zip(found.cases, found.rows, strict=True):
        assert row is not None
        alone = mh.certify(mh.load("example1", case))
        assert row["certificate"] == alone.id
        assert row["stiffness_N/m"] == np.linalg.eigvalsh(alone.stiffness)[0]
        each = [row[f"stiffness_{name}_N/m"] for name in ("cx", "cy", "cz")]
        assert each == alone.stiffness.diagonal().tolist()  # springs of one port each
    assert found.columns()["certified"].tolist() == [True, True]


def test_what_cannot_be_certified_is_a_result(threads: Executor) -> None:
    found = mh.sweep("example1", {"environment.delay": [0, 1]}, executor=threads).columns()
    assert found["certified"].tolist() == [True, False]
    assert "the environment lacks passivity" in found["reason"][1]
    assert np.isnan(found["stiffness_N/m"]).tolist() == [False, True]


def test_cases_may_be_listed(threads: Executor) -> None:
    cases = [{"design.tau": 0.0001}, {"design.tau": 0.0002, "period": 0.002}]
    found = mh.sweep("example1", cases, tau_of, executor=threads)
    table = found.columns()
    assert table["twice"].tolist() == [0.0002, 0.0004]
    assert table["period"].tolist()[1] == 0.002
    assert np.isnan(table["period"][0])
    assert repr(found) == "Sweep(2 cases of design.tau, period; 0 without a result)"


def test_a_wrong_case_is_refused_before_anything_is_computed(threads: Executor, count: Path) -> None:
    with pytest.raises(mh.SessionError, match=r"design\.tau: found -1.0; expected"):
        mh.sweep("example1", {"design.tau": [0.0, -1.0]}, tau_of, executor=threads)
    assert computed(count) == []


def test_an_error_of_a_task_is_that_of_its_case(threads: Executor, tmp_path: Path) -> None:
    progress: list[tuple[int, int]] = []
    found = mh.sweep(
        "example1", GRID, sour, executor=threads, journal=tmp_path / "j", progress=lambda *now: progress.append(now)
    )
    assert found.errors[1] == "RuntimeError: sour"
    assert found.errors[2].startswith("TypeError: found a list in the result; expected numbers")
    assert [row is None for row in found.rows] == [False, True, True, False]
    assert found.columns()["error"].tolist()[0] == ""
    assert progress == [(done, 4) for done in range(5)]
    assert len((tmp_path / "j").read_text().splitlines()) == 1 + 2  # what failed is tried again


def test_a_sweep_goes_on_from_its_journal(threads: Executor, tmp_path: Path, count: Path) -> None:
    journal = tmp_path / "j"
    part = mh.sweep("example1", {"design.tau": TAUS[:2]}, tau_of, executor=threads, journal=journal)
    whole = mh.sweep("example1", GRID, tau_of, executor=threads, journal=journal)
    assert computed(count) == [str(tau) for tau in TAUS]
    assert whole.rows[:2] == part.rows
    afresh = mh.sweep("example1", GRID, tau_of, executor=threads)
    assert whole.rows == afresh.rows
    assert len(computed(count)) == 8


def test_another_task_or_session_is_another_case(threads: Executor, tmp_path: Path, count: Path) -> None:
    journal = tmp_path / "j"
    mh.sweep("example1", GRID, tau_of, executor=threads, journal=journal)
    mh.sweep("example1-centralised", GRID, tau_of, executor=threads, journal=journal)
    mh.sweep("example1", GRID, sour, executor=threads, journal=journal)
    assert len(computed(count)) == 8


def test_a_line_that_a_killed_run_had_begun_is_computed_again(threads: Executor, tmp_path: Path, count: Path) -> None:
    journal = tmp_path / "j"
    whole = mh.sweep("example1", GRID, tau_of, executor=threads, journal=journal)
    data = journal.read_bytes()
    last = data.rstrip(b"\n").rfind(b"\n") + 1
    for size in (last + 1, len(data) - 1, 5, 0):
        for path in count.iterdir():
            path.unlink()
        journal.write_bytes(data[:size])
        again = mh.sweep("example1", GRID, tau_of, executor=threads, journal=journal)
        assert again.rows == whole.rows
        assert len(computed(count)) == (1 if size >= last else 4)
        assert sorted(journal.read_bytes().splitlines()) == sorted(data.splitlines())


@pytest.mark.parametrize(
    ("content", "found"),
    [
        (b"a,b\n1,2\n", "found another file; expected the journal of a sweep, or none"),
        (b"notes", "found another file"),
        (b"manyhands-sweep 1\nnonsense\n", "found no case in line 2; expected the journal as a sweep wrote it"),
        (b'manyhands-sweep 1\n{"case": "x"}\n', "found no case in line 2"),
    ],
)
def test_another_file_is_no_journal_and_stays(content: bytes, found: str, threads: Executor, tmp_path: Path) -> None:
    journal = tmp_path / "j"
    journal.write_bytes(content)
    with pytest.raises(TargetError, match=found):
        mh.sweep("example1", GRID, tau_of, executor=threads, journal=journal)
    assert journal.read_bytes() == content


def test_a_task_without_a_name_needs_no_journal_and_no_process(threads: Executor, tmp_path: Path) -> None:
    found = mh.sweep("example1", GRID, lambda session: {"name": session.name}, executor=threads)
    assert set(found.columns()["name"]) == {"example-1"}
    with pytest.raises(ValueError, match=r"task: found .*<lambda>; expected a function at the top level of a module"):
        mh.sweep("example1", GRID, lambda session: {"name": session.name})
    with pytest.raises(ValueError, match=r"task: found .*<lambda>"):
        mh.sweep("example1", GRID, lambda session: {"name": session.name}, executor=threads, journal=tmp_path / "j")


def test_a_sweep_that_is_ended_keeps_what_is_done(tmp_path: Path, count: Path) -> None:
    """Ctrl-C comes as an exception, here by the progress; no process is left, which a fixture checks."""

    def end(done: int, _every: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        mh.sweep("example1", GRID, tau_of, workers=1, journal=tmp_path / "j", progress=end)
    assert len((tmp_path / "j").read_text().splitlines()) == 1 + 2
    whole = mh.sweep("example1", GRID, tau_of, workers=1, journal=tmp_path / "j")
    assert [row["twice"] for row in whole.rows if row] == [2.0 * tau for tau in TAUS]


def test_two_sweeps_do_not_write_one_journal(threads: Executor, tmp_path: Path) -> None:
    with claimed(tmp_path / "j"), pytest.raises(TargetError, match="found another run that writes to it"):
        mh.sweep("example1", GRID, tau_of, executor=threads, journal=tmp_path / "j")


def test_a_process_that_dies_costs_its_case_alone(tmp_path: Path, count: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(DEADLY, str(TAUS[2]))
    journal = tmp_path / "j"
    found = mh.sweep("example1", GRID, tau_of, journal=journal)
    assert found.errors == {2: "the process that computed it died"}
    assert [row is None for row in found.rows] == [False, False, True, False]
    monkeypatch.delenv(DEADLY)
    before = len(computed(count))
    again = mh.sweep("example1", GRID, tau_of, journal=journal)
    assert again.errors == {}
    assert len(computed(count)) == before + 1
    lines = [json.loads(line) for line in journal.read_text().splitlines()[1:]]
    assert sorted(line["changes"]["design.tau"] for line in lines) == TAUS


def test_a_given_executor_that_breaks_is_an_error_and_the_journal_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(DEADLY, str(TAUS[3]))
    with ProcessPoolExecutor(1, get_context("fork")) as executor, pytest.raises(BrokenProcessPool):
        mh.sweep("example1", GRID, tau_of, executor=executor, journal=tmp_path / "j")
    assert (tmp_path / "j").read_text().startswith("manyhands-sweep 1\n")
