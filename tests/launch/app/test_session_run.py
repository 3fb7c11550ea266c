"""The files of a run: a file that cannot be written does not prevent the others."""

from __future__ import annotations

import json
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from rich.console import Console

from manyhands.launch.app import session_run
from manyhands.launch.files import TargetError
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.plan.reach import IPC
from manyhands.launch.recordings.recording import Recording
from manyhands.launch.run import supervised
from manyhands.launch.run.directory import REPORT
from manyhands.launch.run.options import StartOptions
from manyhands.launch.run.outcome import Outcome
from manyhands.launch.session import load_session

from ...support.simulated_recordings import SESSIONS

OUTCOME = Outcome(
    0, (), (), {"ticks": 1}, Recording("s", "c", 1e-3, ("dx",), np.zeros((1, 1)), np.zeros((1, 1))), {}, {}
)


class EndedSession:
    """In place of the supervisor: a session that is over."""

    def __init__(self, *_: object, **__: object) -> None:
        pass

    def run(self) -> Outcome:
        return OUTCOME


def write_files_of_a_run(record: Path, report: Path, kept: Path, console: Console) -> None:
    session_run.run_session(
        prepare(load_session(SESSIONS / "example1-uncoupled.yaml"), uncertified=True),
        console,
        IPC,
        StartOptions("simulated", 1, record=record, report=report, directory=kept),
    )


def test_a_recording_that_cannot_be_saved_leaves_the_reports(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(supervised, "Supervisor", EndedSession)
    report, kept, shown = tmp_path / "report.json", tmp_path / "kept", StringIO()
    with pytest.raises(TargetError, match=r"r\.npz: found no folder"):
        write_files_of_a_run(tmp_path / "none" / "r.npz", report, kept, Console(file=shown))
    for path in (report, kept / REPORT):
        assert json.loads(path.read_text()) == OUTCOME.report
    assert "recording written" not in shown.getvalue()


def test_every_file_that_cannot_be_written_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(supervised, "Supervisor", EndedSession)
    shown = StringIO()
    with pytest.raises(TargetError, match=r"r\.npz"):
        write_files_of_a_run(
            tmp_path / "no" / "r.npz", tmp_path / "none" / "r.json", tmp_path / "kept", Console(file=shown)
        )
    assert ": No such file or directory" in shown.getvalue().replace("\n", " ")


class Titled:
    """In place of the live table: the titles that it was given."""

    titles: ClassVar[list[str]] = []

    def __init__(self, _console: Console, title: str, _about: object) -> None:
        self.titles.append(title)
        self.announced: tuple[str, ...] = ()

    def __enter__(self) -> Titled:
        return self

    def __exit__(self, *_: object) -> None:
        pass


def test_a_certificate_that_holds_below_a_speed_says_so_with_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session_run, "LiveTable", Titled)
    monkeypatch.setattr(session_run, "run_prepared", lambda *_, **__: OUTCOME)
    prepared = prepare(load_session(SESSIONS / "example1-uncoupled.yaml"), uncertified=True)
    for speed in (None, 0.3):
        of = replace(prepared, loop=replace(prepared.loop, speed=speed))
        session_run.run_session(of, Console(file=StringIO()), IPC, StartOptions("simulated", 1))
    at_every, below = Titled.titles
    assert below == f"{at_every} below 0.3 m/s"
