"""The run's own directory, which goes, and the one that is kept."""

from __future__ import annotations

import json
import os
import stat
from pathlib import Path

import pytest

from manyhands.design.certificate import load
from manyhands.launch.files import TargetError
from manyhands.launch.preparation import prepare
from manyhands.launch.run_directory import SessionDirectory, is_bare, require_new, run_directory
from manyhands.launch.session import load_session

SESSIONS = Path(__file__).parents[2] / "launch" / "sessions"


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_the_runs_own_directory_goes_with_its_logs() -> None:
    with run_directory() as directory:
        assert mode(directory) == mode(directory / "log") == 0o700
        (directory / "log" / "dx.jsonl").write_text("{}\n")
    assert not directory.exists()


@pytest.mark.parametrize("fails", [False, True])
def test_logs_that_are_kept_outlive_it(fails: bool, tmp_path: Path) -> None:
    kept = SessionDirectory(tmp_path / "run")
    try:
        with run_directory(kept.logs) as directory:
            (directory / "log" / "dx.jsonl").write_text("{}\n")
            (directory / "dx.key").write_text("secret")
            if fails:
                raise RuntimeError("the supervisor went wrong")
    except RuntimeError:
        assert fails
    assert not directory.exists()
    assert [path.relative_to(kept.path).as_posix() for path in kept.path.rglob("*")] == ["log", "log/dx.jsonl"]


def test_a_kept_directory_is_its_users_alone_whatever_the_umask_and_however_it_was_made(tmp_path: Path) -> None:
    before = os.umask(0)
    try:
        (tmp_path / "made").mkdir(mode=0o755)
        for name in ("new", "made"):
            kept = SessionDirectory(tmp_path / name)
            assert mode(kept.path) == mode(kept.logs) == 0o700
    finally:
        os.umask(before)


def test_what_cannot_become_a_runs_directory_is_refused_and_left_alone(tmp_path: Path) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "report.json").write_text("an older run")
    (tmp_path / "file").write_text("")
    for name, found in (("full", "not empty"), ("file", "found a file"), ("absent/run", "found no folder")):
        for refuse in (require_new, SessionDirectory):
            with pytest.raises(TargetError, match=f"{name}: .*{found}|{name}: {found}"):
                refuse(tmp_path / name)
    require_new(tmp_path / "new")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "full"]
    assert (tmp_path / "full" / "report.json").read_text() == "an older run"


def test_the_session_as_it_is_run_the_certificate_and_the_report(tmp_path: Path) -> None:
    session = load_session(SESSIONS / "example1.yaml", ["devices.dx.mass=0.3"])
    prepared = prepare(session)
    kept = SessionDirectory(tmp_path / "run")
    kept.keep_session(prepared)
    kept.keep_report({"session": "example-1"})
    assert sorted(path.name for path in kept.path.iterdir()) == [
        "certificate.json",
        "log",
        "report.json",
        "session.yaml",
    ]
    assert load_session(kept.path / "session.yaml") == session
    certificate, _ = load(kept.path / "certificate.json")
    assert certificate.id == prepared.id
    assert json.loads((kept.path / "report.json").read_text()) == {"session": "example-1"}


def test_a_session_that_nothing_proves_has_no_certificate_to_keep(tmp_path: Path) -> None:
    kept = SessionDirectory(tmp_path / "run")
    kept.keep_session(prepare(load_session(SESSIONS / "example1-uncoupled.yaml"), uncertified=True))
    assert sorted(path.name for path in kept.path.iterdir()) == ["log", "session.yaml"]


@pytest.mark.parametrize(
    ("file", "bare"), [("run.mcap", True), ("./run.mcap", True), ("out/run.mcap", False), ("/run.mcap", False)]
)
def test_a_bare_name_is_one_without_a_folder(file: str, bare: bool) -> None:
    assert is_bare(Path(file)) is bare
