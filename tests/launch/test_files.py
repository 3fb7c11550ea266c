"""Written files are whole, go through no link, serve one run at a time, and use the same two functions."""

from __future__ import annotations

import os
import re
import secrets
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from manyhands.design.files import open_new, replacing
from manyhands.launch.app.cli import app
from manyhands.launch.files import TargetError, claimed, require_target
from manyhands.launch.recordings.recording import Recording
from manyhands.launch.run.outcome import save_json
from manyhands.nodes.recorder.mcap import RecordingFile

from ..support.rooms import ROOMS

ROOT = Path(__file__).parents[2]
RUN = Recording("s", "id", 0.001, ("a",), np.zeros((3, 1)), np.zeros((3, 1)))


# --- whole, through no link


@pytest.mark.parametrize(
    ("partial", "write"),
    [
        (".run.npz.part.npz", lambda folder: RUN.save(folder / "run.npz")),
        (".run.csv.part.csv", lambda folder: RUN.save(folder / "run.csv")),
        (".run.json.part.json", lambda folder: save_json({}, folder / "run.json")),
        (".run.mcap.part", lambda folder: RecordingFile(folder / "run.mcap", b"beginning").close()),
    ],
)
def test_no_name_that_others_can_guess_leads_a_file_elsewhere(partial: str, write: object, tmp_path: Path) -> None:
    """In a shared folder another user has put a link to our file, under the name that 0.5.0 wrote."""
    ours = tmp_path / "ours"
    ours.write_bytes(b"precious")
    folder = tmp_path / "shared"
    folder.mkdir()
    (folder / partial).symlink_to(ours)
    write(folder)  # type: ignore[operator]
    assert ours.read_bytes() == b"precious"
    assert (folder / partial).is_symlink()
    (made,) = {path.name for path in folder.iterdir()} - {partial}
    assert not (folder / made).is_symlink()


def test_what_is_laid_in_the_way_is_not_written_through(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ours, token = tmp_path / "ours", "0" * 32
    ours.write_bytes(b"precious")
    (tmp_path / f".{token}.part").symlink_to(ours)
    monkeypatch.setattr(secrets, "token_hex", lambda _count: token)
    with pytest.raises(FileExistsError), replacing(tmp_path / "new") as file:
        file.write(b"through the link")
    assert ours.read_bytes() == b"precious"
    assert not (tmp_path / "new").exists()


def test_an_older_file_stays_and_nothing_is_left_when_writing_fails(tmp_path: Path) -> None:
    path = tmp_path / "f"
    path.write_bytes(b"older")
    with pytest.raises(TypeError), replacing(path) as file:
        file.writelines([b"half", None])  # type: ignore[list-item]
    assert [p.name for p in tmp_path.iterdir()] == ["f"]
    assert path.read_bytes() == b"older"
    with replacing(path, mode=0o600) as file:
        file.write(b"whole")
    assert (path.read_bytes(), path.stat().st_mode & 0o777) == (b"whole", 0o600)
    assert [p.name for p in tmp_path.iterdir()] == ["f"]


def test_a_link_is_replaced_and_not_followed(tmp_path: Path) -> None:
    ours, link = tmp_path / "ours", tmp_path / "link"
    ours.write_bytes(b"precious")
    link.symlink_to(ours)
    with replacing(link) as file:
        file.write(b"new")
    assert (ours.read_bytes(), link.read_bytes(), link.is_symlink()) == (b"precious", b"new", False)
    with pytest.raises(FileExistsError):
        open_new(link)


def test_what_is_no_regular_file_is_never_replaced(tmp_path: Path) -> None:
    """As the administrator, ``-o /dev/null`` would otherwise replace the machine's."""
    path = tmp_path / "pipe.npz"
    os.mkfifo(path)
    with pytest.raises(TargetError, match="found something other than a file; expected a file, or nothing"):
        require_target(path)
    with pytest.raises(OSError, match="Is a pipe, not a regular file"):
        RecordingFile(path, b"")
    with pytest.raises(OSError, match="Is a pipe, not a regular file"), replacing(path):
        pass
    assert path.is_fifo()


WRITING = re.compile(
    r"""open\([^)]*["'][rb]?[wax]|\.write_text\(|\.write_bytes\(|os\.(rename|replace|link)\(|\.rename\(|O_CREAT|
    mkstemp|NamedTemporaryFile|\bpath\.touch\(|partial\.replace\(""",
    re.VERBOSE,
)
BY_OTHER_MEANS = {
    "design/files.py": "what all others write with",
    "launch/files.py": "locks, which are never written through and never replaced",
    "launch/plan/keys.py": "keys, with protocol/keys.py in a folder that its owner alone may write to",
    "protocol/keys.py": "likewise",
    "nodes/kernel/log.py": "logs are continued; never through a link",
    "launch/app/sweep.py": "a sweep's journal is continued likewise",
    "nodes/recorder/mcap.py": "a recording takes its place when it has its beginning, and grows",
    "launch/run/processes.py": "in the run's own directory, mode 0700",
    "launch/bridges/rosbag.py": "a bag is a folder, and takes its place when it is whole",
    "launch/audit/prepared.py": "in a temporary folder, mode 0700",
    "nodes/guest/observer.py": "/dev/null",
}


def test_files_are_written_in_one_place() -> None:
    found = {
        path.relative_to(ROOT).as_posix()
        for room in ROOMS
        for path in (ROOT / room).rglob("*.py")
        if WRITING.search(path.read_text())
    }
    assert found == BY_OTHER_MEANS.keys()


# --- one run at a time


HOLD = "import sys; from pathlib import Path; from manyhands.launch.files import claimed\n"
HOLD += "with claimed(Path(sys.argv[1])): print('held', flush=True); sys.stdin.read()"


def test_a_second_launch_with_one_recording_is_refused_naming_the_owner(tmp_path: Path) -> None:
    path = tmp_path / "run.npz"
    with subprocess.Popen(
        [sys.executable, "-c", HOLD, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        for option in ("--record", "--report"):
            command = ["launch", "example1.yaml", "--duration", "0.01", "--clock", "simulated", option, str(path)]
            result = CliRunner().invoke(app, command)
            assert result.exit_code == 2
            assert "found another run that writes to it (process " in result.stderr.replace("\n", " ")
            assert str(other.pid) in result.stderr
        assert CliRunner().invoke(app, ["simulate", "example1.yaml", "--record", str(path)]).exit_code == 2
        other.kill()  # the lock goes with its process, however that ends
    with claimed(path):
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_claim_is_of_one_file_and_goes_with_the_run(tmp_path: Path) -> None:
    path, link = tmp_path / "a.npz", tmp_path / "elsewhere"
    link.symlink_to(tmp_path, target_is_directory=True)
    with claimed(path), claimed(tmp_path / "b.npz"):
        for same in (path, link / "a.npz"):
            with pytest.raises(TargetError, match="another run that writes to it"), claimed(same):
                pass
    assert list(tmp_path.iterdir()) == [link]
    with pytest.raises(RuntimeError), claimed(path):
        raise RuntimeError
    with claimed(path):
        pass


def test_no_lock_is_taken_through_a_link_or_pipe(tmp_path: Path) -> None:
    ours, lock = tmp_path / "ours", tmp_path / ".run.npz.lock"
    ours.write_bytes(b"precious")
    lock.symlink_to(ours)
    with pytest.raises(TargetError, match=r"cannot be written: .run.npz.lock"), claimed(tmp_path / "run.npz"):
        pass
    assert ours.read_bytes() == b"precious"
    lock.unlink()
    os.mkfifo(lock)
    with pytest.raises(TargetError, match="something other than a file"), claimed(tmp_path / "run.npz"):
        pass


def test_what_a_stranger_wrote_into_a_lock_is_made_presentable(tmp_path: Path) -> None:
    with claimed(tmp_path / "a"):
        (tmp_path / ".a.lock").write_bytes(b"\x1b]0;evil\x07\n" + b"x" * 1000)
        with pytest.raises(TargetError) as caught, claimed(tmp_path / "a"):
            pass
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 700
