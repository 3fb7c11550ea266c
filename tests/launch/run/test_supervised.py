"""The files of a start: which are refused before a session is designed."""

from __future__ import annotations

from pathlib import Path

import pytest

from manyhands.launch.files import TargetError
from manyhands.launch.recordings.recording import RecordingError
from manyhands.launch.run.options import Hosting, StartOptions
from manyhands.launch.run.supervised import claimed_files, require_files


def test_a_recording_in_the_runs_own_folder_waits_for_that_folder(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    require_files(StartOptions(record=folder / "r.mcap", directory=folder))
    with pytest.raises(TargetError, match="found no folder"):
        require_files(StartOptions(record=folder / "r.mcap", directory=tmp_path / "other"))
    with pytest.raises(RecordingError, match=r"found the suffix '\.txt'"):
        require_files(StartOptions(record=folder / "r.txt", directory=folder))
    assert list(tmp_path.iterdir()) == []


def test_a_hosted_session_is_recorded_while_it_runs(tmp_path: Path) -> None:
    require_files(StartOptions(record=tmp_path / "r.npz"))
    with pytest.raises(RecordingError, match=r"r\.npz"):
        require_files(StartOptions(record=tmp_path / "r.npz", hosting=Hosting(tmp_path, "192.0.2.7:7400")))


def test_two_starts_do_not_write_to_one_file(tmp_path: Path) -> None:
    first = StartOptions(record=tmp_path / "a.mcap", report=tmp_path / "r.json")
    with claimed_files(first):
        for other in (StartOptions(record=first.record), StartOptions(report=first.report)):
            with pytest.raises(TargetError, match="found another run that writes to it"), claimed_files(other):
                pass
    with claimed_files(first):
        pass
