"""A session that runs already is recorded from another terminal, looked at, and exported."""

from __future__ import annotations

import json
import signal
import subprocess
from pathlib import Path

import numpy as np

from manyhands.launch.recordings.run import read_run

from .commands import MANYHANDS, read_until, run, started


def test_a_running_session_is_recorded_from_another_terminal(tmp_path: Path) -> None:
    kept, part, rest = tmp_path / "run", tmp_path / "part.mcap", tmp_path / "rest.mcap"
    with started("launch", "example1.yaml", "--directory", kept) as session:
        read_until(session, "running")
        done = json.loads(run("record", kept, "-o", part, "--duration", "0.3", "--json"))
        assert done["ending"] == "it is as long as was asked for"
        assert done["first"] is not None
        assert done["ticks"] - done["first"] >= 300
        with started("record", "--session", "example-1", "-o", rest) as other:
            read_until(other, "recording example-1")
            run("record", "-o", tmp_path / "some.mcap", "--duration", "0.1")  # nobody minds a second one
            session.send_signal(signal.SIGINT)
            said = other.communicate(timeout=120)[1]
            assert (other.returncode, session.wait(120)) == (0, 130), said
    assert "the session is over;" in said or "the session's supervisor is gone;" in said

    for file in (part, rest):
        told = json.loads(run("info", file, "--json", "--check"))
        assert (told["damaged"], told["cut"], told["session"]) == ([], None, "example-1")
        assert {*told["attachments"]} == {"session.yaml", "certificate.json"}
        whole = read_run(file)
        assert {name: (kept / name).read_bytes() for name in whole.attachments} == whole.attachments
        assert [name for name, _ in whole.traces].count("dx") == 4
        for trace in whole.traces.values():
            assert np.isnan(trace.values[: told["first"]]).all() or trace.topic.name != "sample"
        run("export", file, "--to", "npz")
        with np.load(file.with_suffix(".npz")) as table:
            assert np.array_equal(table["dx.sample[dx]_m"], whole.traces["dx", "sample"].values[:, 0], equal_nan=True)


def test_ctrl_c_ends_the_recording_whole_and_not_the_session(tmp_path: Path) -> None:
    file = tmp_path / "r.mcap"
    with started("launch", "example1.yaml") as session:
        read_until(session, "running")
        with started("record", "-o", file) as recorder:
            read_until(recorder, "recording example-1")
            recorder.send_signal(signal.SIGINT)
            said = recorder.communicate(timeout=120)[1]
            assert recorder.returncode == 0, said
        assert session.poll() is None
        assert json.loads(run("info", file, "--json"))["damaged"] == []
        session.send_signal(signal.SIGINT)
        assert session.wait(120) == 130


def test_without_a_session_there_is_nothing_to_record(tmp_path: Path) -> None:
    for arguments in ((), (tmp_path,), ("--session", "example-1")):
        command = [*MANYHANDS, "record", *map(str, arguments), "-o", str(tmp_path / "r.mcap")]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120)
        assert (done.returncode, done.stdout) == (2, "")
        assert "found no running session" in done.stderr
    assert not (tmp_path / "r.mcap").exists()
