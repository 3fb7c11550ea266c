"""The contents of ``info`` for a recording."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from manyhands.launch.app.cli import app
from manyhands.launch.recordings.info import read_info
from manyhands.launch.recordings.recording import RecordingError
from manyhands.launch.recordings.run import read_run
from manyhands.nodes.recorder.core import RecorderCore
from manyhands.nodes.recorder.coverage import Coverage, Gap, missing_by_party
from manyhands.nodes.recorder.format import METADATA
from manyhands.nodes.recorder.mcap import Tape

from ...support.small_recordings import ATTACHED, RECORDED, STARTED, condition, cut_recording, observation, recording

pytestmark = pytest.mark.usefixtures("own_interrupt")


def test_it_describes_a_whole_recording(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(recording(ticks=20, each=5))
    info = read_info(path)
    assert info.recorded == RECORDED
    assert (info.first, info.ticks, info.duration, info.size) == (0, 20, 0.02, path.stat().st_size)
    assert (info.missing, info.gaps, info.cut) == ({}, {}, None)
    assert info.attachments == {name: len(data) for name, data in ATTACHED.items()}
    channels = {channel.topic: channel for channel in info.channels}
    assert (channels["/s/dx/sample"].messages, channels["/s/dx/sample"].rate) == (20, 1000.0)
    assert (channels["/s/dx/telemetry"].messages, channels["/s/dx/telemetry"].rate) == (4, 200.0)
    assert (channels["/s/supervisor/condition"].messages, channels["/s/supervisor/condition"].rate) == (1, None)
    assert len(channels) == 4 + 3 + 3 + 3 + 1


def test_missing_ticks_are_reported_by_device(tmp_path: Path) -> None:
    core = RecorderCore(RECORDED)
    data = core.cut()
    for tick in (10, 20, 40):
        core.take(observation("dx", tick, 5), STARTED)
        data += core.cut()
    path = tmp_path / "run.mcap"
    path.write_bytes(data + core.end())
    info = read_info(path)
    assert (info.first, info.ticks, info.missing) == (5, 40, {"dx": 20})
    assert info.gaps == {"dx": (Gap(10, 15), Gap(20, 35))}


@given(st.sets(st.integers(0, 60), min_size=1), st.integers(1, 7))
def test_gaps_are_the_ticks_that_are_not_there(there: set[int], each: int) -> None:
    told, ticks = sorted(there), Coverage()
    for begin in range(0, len(told), each):
        ticks.take_each(np.array(told[begin : begin + each], dtype=np.int64))
    lacking = {tick for gap in ticks.gaps_in(ticks.first or 0, ticks.next) for tick in range(gap.begin, gap.end)}
    assert lacking == set(range(min(there), max(there))) - there
    assert ticks.missing == len(lacking)
    assert (ticks.first, ticks.next) == (min(there), max(there) + 1)
    wider = {tick for gap in ticks.gaps_in(0, 70) for tick in range(gap.begin, gap.end)}
    assert wider == set(range(70)) - there
    assert ticks.missing_in(0, 70) == len(wider)
    coverages = {"a": ticks, "nobody": Coverage()}
    assert missing_by_party(coverages, dict.fromkeys(coverages, range(70))) == {"a": len(wider), "nobody": 70}


def test_a_cut_recording_is_described_up_to_its_cut(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(cut_recording(ticks=20, each=5))
    info = read_info(path)
    assert info.cut is not None
    assert 0 < info.ticks < 20


@pytest.mark.parametrize("text", [b"", b"no recording", recording()[:60]])
def test_what_is_no_recording_is_refused(text: bytes, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(text)
    with pytest.raises(RecordingError, match=r"run\.mcap: found"):
        read_info(path)


def test_the_least_account_of_each_device_is_reported(tmp_path: Path) -> None:
    core = RecorderCore(RECORDED)
    for tick, least in ((5, 0.0), (10, -0.0025), (15, -0.001), (20, float("nan"))):  # a new process began after tick 10
        core.take(observation("dx", tick, 5, interface_min=least), STARTED)
        core.take(observation("c", tick, 5, interface_min=-1.0), STARTED)  # no device
    path = tmp_path / "run.mcap"
    path.write_bytes(core.cut() + core.end())
    assert read_info(path).accounts == {"dx": -0.0025}
    runner = CliRunner()
    assert "least interface account of dx: -2.5 mJ" in runner.invoke(app, ["info", str(path)]).stdout
    assert json.loads(runner.invoke(app, ["info", str(path), "--json"]).stdout)["accounts"] == {"dx": -0.0025}
    path.write_bytes(recording())
    assert read_info(path).accounts == {}


def test_the_command_reports_damage_and_fails(tmp_path: Path) -> None:
    whole, path = recording(), tmp_path / "run.mcap"
    path.write_bytes(whole)
    runner = CliRunner()
    result = runner.invoke(app, ["info", str(path), "--json"])
    assert (result.exit_code, json.loads(result.stdout)["damaged"]) == (0, [])
    assert "intact: all checksums match" in runner.invoke(app, ["info", str(path)]).stdout
    at = whole.index(b"jsonschema") if b"jsonschema" in whole else len(whole) // 2
    path.write_bytes(whole[:at] + b"X" + whole[at + 1 :])
    result = runner.invoke(app, ["info", str(path)])
    assert (result.exit_code, "damaged: bytes" in result.stdout) == (1, True)
    result = runner.invoke(app, ["info", str(path), "--json"])
    (damage,) = json.loads(result.stdout)["damaged"]
    assert result.exit_code == 1
    assert damage["begin"] <= at < damage["end"]


def test_the_command_refuses_what_is_no_recording(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["info", str(tmp_path / "none.mcap")])
    assert (result.exit_code, result.stdout) == (2, "")
    assert "none.mcap: cannot be read" in result.stderr


def test_a_condition_alone_is_a_recording_without_ticks(tmp_path: Path) -> None:
    core = RecorderCore(RECORDED)
    core.take(condition(), STARTED)
    path = tmp_path / "run.mcap"
    path.write_bytes(core.cut() + core.end())
    info = read_info(path)
    assert (info.first, info.ticks, info.duration, info.missing) == (None, 0, 0.0, {})


def test_it_lists_the_attachments_that_every_other_command_reads(tmp_path: Path) -> None:
    """Wherever they stand, also before the metadata; of two with one name the first."""
    tape = Tape("manyhands")
    tape.attach("session.yaml", "application/yaml", b"first", STARTED)
    tape.metadata(METADATA, RECORDED.as_metadata())
    tape.attach("session.yaml", "application/yaml", b"the second", STARTED)
    tape.attach("certificate.json", "application/json", b"{}", STARTED)
    tape.finish()
    path = tmp_path / "run.mcap"
    path.write_bytes(tape.take())
    read = {name: len(data) for name, data in read_run(path).attachments.items()}
    assert read_info(path).attachments == read == {"session.yaml": 5, "certificate.json": 2}
