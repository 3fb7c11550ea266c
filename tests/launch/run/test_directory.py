"""The run's own directory, which is removed, and the kept one."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import stat
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from manyhands.design.certificate import load
from manyhands.launch.files import TargetError
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.run.directory import (
    REPORT,
    SessionDirectory,
    is_bare,
    require_new,
    run_directories,
    run_directory,
    sweep_directories,
)
from manyhands.launch.run.outcome import save_json
from manyhands.launch.session import load_session

SESSIONS = Path(__file__).parents[3] / "launch" / "sessions"


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


def test_a_kept_directory_is_its_users_alone_whatever_the_umask(tmp_path: Path) -> None:
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
    save_json({"session": "example-1"}, kept.path / REPORT)
    assert sorted(path.name for path in kept.path.iterdir()) == [
        "certificate.json",
        "log",
        "report.json",
        "session.yaml",
    ]
    assert load_session(kept.path / "session.yaml") == prepared.session == session.with_delay(0.0)
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


# --- whose supervisor lives


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A temporary directory of this test's own, in which it may sweep."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


ENTER = "import os, sys, tempfile; tempfile.tempdir = sys.argv[1]; pid = int(sys.argv[2])\n"
ENTER += "from manyhands.launch.run import directory as d; d.os.getpid = lambda: pid\n"
ENTER += "with d.run_directory() as path: print(path, flush=True); sys.stdin.read()"
SWEEP = "import sys, tempfile; tempfile.tempdir = sys.argv[1]\n"
SWEEP += "from manyhands.launch.run.directory import sweep_directories; sweep_directories()"


def no_process() -> int:
    """An unused process id; every process of another namespace looks like this from here."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


@contextmanager
def supervisor(temporary: Path, pid: int) -> Iterator[tuple[subprocess.Popen[str], Path]]:
    """A process that holds a run's directory, known by a process id that is not one here."""
    with subprocess.Popen(
        [sys.executable, "-c", ENTER, str(temporary), str(pid)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            assert process.stdout is not None
            yield process, Path(process.stdout.readline().strip())
        finally:
            process.kill()


def test_the_directory_of_a_supervisor_unseen_here_is_not_swept(temporary: Path) -> None:
    """Containers that share /tmp and a user: its process id is unused here, and its session goes on."""
    with supervisor(temporary, no_process()) as (process, directory):
        sweep_directories()
        assert directory.is_dir()
        assert run_directories() == [directory]
        process.kill()
        process.wait()
        assert run_directories() == []
        sweep_directories()
        assert not directory.exists()


def test_a_sweep_in_another_pid_namespace_leaves_a_live_session_alone(temporary: Path) -> None:
    apart = [shutil.which("unshare") or "unshare", "--pid", "--fork", "--mount-proc"]
    if subprocess.run([*apart, "true"], capture_output=True, check=False).returncode:
        pytest.skip("this user may make no pid namespace")
    with run_directory() as directory:
        subprocess.run([*apart, sys.executable, "-c", SWEEP, str(temporary)], check=True)
        assert directory.is_dir()


def test_what_bears_a_runs_name_and_is_none_is_left_alone(temporary: Path) -> None:
    pid, elsewhere = no_process(), temporary / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "ours").write_text("precious")
    (temporary / f"manyhands-{pid}-link").symlink_to(elsewhere)
    (temporary / f"manyhands-{pid}-file").write_text("")
    (temporary / "manyhands-x-y").mkdir()
    sweep_directories()
    assert len(list(temporary.iterdir())) == 4
    assert (elsewhere / "ours").read_text() == "precious"


def test_a_directory_swept_before_its_lock_is_made_again(temporary: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[Path] = []
    mkdtemp = tempfile.mkdtemp

    def noted(prefix: str) -> str:
        made.append(Path(mkdtemp(prefix=prefix)))
        return str(made[-1])

    lock = fcntl.flock

    def too_late(descriptor: int, how: int) -> None:
        lock(descriptor, how)
        if len(made) == 1:
            made[0].rmdir()  # by a sweep that had taken the lock first, and is done by now

    monkeypatch.setattr(tempfile, "mkdtemp", noted)
    monkeypatch.setattr(fcntl, "flock", too_late)
    with run_directory() as directory:
        assert directory == made[1]
        assert directory.is_dir()


def test_without_locks_nothing_is_swept(temporary: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_locks(_descriptor: int, _how: int) -> None:
        raise OSError(9, "Bad file descriptor")

    (temporary / f"manyhands-{no_process()}-left").mkdir()
    monkeypatch.setattr(fcntl, "flock", no_locks)
    with run_directory() as directory:
        assert directory.is_dir()
        assert run_directories() != []
    assert [path.name.endswith("-left") for path in temporary.iterdir()] == [True]
