"""The supervisor's end of a real recorder: it supplies frames, never waits, and reports how the recorder ended."""

from __future__ import annotations

import os
import resource
import select
import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from manyhands.design.certificate import load
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.recordings.recording import RecordingError
from manyhands.launch.recordings.run import read_run
from manyhands.launch.recordings.tables import read_recording
from manyhands.launch.run import recorder as recorder_process
from manyhands.launch.run.broadcast import observation_frame
from manyhands.launch.run.directory import SessionDirectory
from manyhands.launch.run.recorder import Recorder, RecorderProcess
from manyhands.launch.session import load_session
from manyhands.protocol.messages import Figures, Telemetry

SESSIONS = Path(__file__).parents[3] / "launch" / "sessions"
ROWS = 700  # of a frame: 11 kB, which become 110 kB of messages
FRAMES_A_CHUNK = 4  # of each of three devices: enough to fill one
MOST_WAITING_BYTES = 400_000  # instead of the true bound, which would take minutes to read back


@pytest.fixture(autouse=True)
def bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder_process, "MOST_WAITING_BYTES", MOST_WAITING_BYTES)


@pytest.fixture(scope="module")
def prepared() -> Prepared:
    return prepare(load_session(SESSIONS / "example1-uncoupled.yaml"), uncertified=True)


class ReadyRecorder:
    """A recorder that is ready, and a supervisor's poll over it."""

    def __init__(self, recorder: RecorderProcess, folder: Path) -> None:
        self.recorder = recorder
        (folder / "run").mkdir(mode=0o700)
        self.interrupt, self.interrupted = os.pipe()
        self.told = 0
        self.incidents: list[str] = []
        recorder.start(folder / "run")
        recorder.await_ready(self.interrupt)

    def tell(self, frames: int) -> None:
        assert self.told < 200, "there is room for ever"
        for _ in range(frames):
            self.told += 1
            tick = self.told * ROWS
            x = np.arange(tick - ROWS, tick, dtype=np.float64).reshape(ROWS, 1)
            for device in ("dx", "dy", "dz"):
                self.recorder.take(
                    observation_frame(device, Telemetry(tick, Figures({"late": 0.0}), {"x": x, "f_v": -x}))
                )

    def attend(self) -> bool:
        """Wait for any message of the recorder; returns whether there may be more."""
        poll = select.poll()
        for fd in self.recorder.fds:
            poll.register(fd, select.POLLIN)
        ready = {fd for fd, _ in poll.poll(60_000)}
        assert ready, "the recorder says nothing any more"
        incident = self.recorder.attend(ready)
        self.incidents += [] if incident is None else [incident]
        return bool(self.recorder.fds)

    def attend_until_taken(self) -> None:
        while self.recorder._taken < 3 * self.told:
            assert self.attend(), self.incidents

    def finish(self) -> None:
        incident = self.recorder.finish(self.interrupt)
        self.incidents += [] if incident is None else [incident]

    def close(self) -> None:
        self.recorder.close()
        os.close(self.interrupt)
        os.close(self.interrupted)


@pytest.fixture(params=["realtime"])
def stage(request: pytest.FixtureRequest, prepared: Prepared, tmp_path: Path) -> Iterator[ReadyRecorder]:
    out = ReadyRecorder(RecorderProcess(prepared, request.param, tmp_path / "r.mcap"), tmp_path)
    yield out
    out.close()


simulated = pytest.mark.parametrize("stage", ["simulated"], indirect=True)


def assert_prefix(path: Path, least: int) -> int:
    """Check that the recording has the first ticks of the telemetry, at least so many; returns the number."""
    found = read_recording(path)
    whole = found.x[~np.isnan(found.x).any(axis=1)]
    np.testing.assert_array_equal(whole, np.arange(len(whole), dtype=np.float64)[:, None].repeat(3, axis=1))
    np.testing.assert_array_equal(found.f_v[: len(whole)], -whole)
    assert len(whole) >= least
    return len(whole)


def test_every_frame_is_recorded(stage: ReadyRecorder, tmp_path: Path) -> None:
    stage.tell(3)
    stage.finish()
    assert stage.incidents == []
    assert stage.recorder.as_plain() == {"recording": {"file": str(tmp_path / "r.mcap"), "ticks": 3 * ROWS}}
    assert assert_prefix(tmp_path / "r.mcap", 3 * ROWS) == 3 * ROWS
    found = read_recording(tmp_path / "r.mcap")
    assert (found.missing, found.cut, found.session) == ({}, None, "example-1-uncoupled")
    assert stage.recorder.pid is None
    assert stage.recorder.fds == ()


def test_the_recording_holds_the_session_as_run_and_its_certificate(prepared: Prepared, tmp_path: Path) -> None:
    certified = prepare(load_session(SESSIONS / "example1.yaml", ["devices.dx.mass=0.3"]))
    for number, (one, names) in enumerate(
        ((prepared, ["session.yaml"]), (certified, ["session.yaml", "certificate.json"]))
    ):
        folder = tmp_path / str(number)
        folder.mkdir()
        stage = ReadyRecorder(RecorderProcess(one, "realtime", folder / "r.mcap"), folder)
        stage.finish()
        stage.close()
        directory = SessionDirectory(folder / "kept")
        directory.keep_session(one)
        found = read_run(folder / "r.mcap")
        assert list(found.attachments) == names
        for name in names:
            assert found.attachments[name] == (directory.path / name).read_bytes()
        assert (found.recorded.certificate, found.recorded.masses) == (one.id, tuple(one.session.environment.masses))
    (folder / "c.json").write_bytes(found.attachments["certificate.json"])
    assert load(folder / "c.json")[0].id == certified.id
    (folder / "s.yaml").write_bytes(found.attachments["session.yaml"])
    assert load_session(folder / "s.yaml") == certified.session


def test_a_killed_recorder_leaves_its_file_and_is_reported_once(stage: ReadyRecorder, tmp_path: Path) -> None:
    stage.tell(2 * FRAMES_A_CHUNK)
    stage.attend_until_taken()
    assert stage.recorder.pid is not None
    os.kill(stage.recorder.pid, signal.SIGKILL)
    while stage.attend():
        pass
    stage.tell(1)  # this has no effect
    stage.finish()
    (incident,) = stage.incidents
    assert "the recorder was killed by SIGKILL" in incident
    # all but the last chunk at least: it was taken in after those before it had been written
    assert_prefix(tmp_path / "r.mcap", ROWS * FRAMES_A_CHUNK)
    assert "goes to tick" in str(read_recording(tmp_path / "r.mcap").cut)
    assert stage.recorder.failure is None


def test_a_full_disk_ends_the_recording_at_a_reported_tick(stage: ReadyRecorder, tmp_path: Path) -> None:
    """The kernel refuses the recorder what would make its file longer; tests/system has a disk that is really full."""
    assert stage.recorder.pid is not None
    resource.prlimit(stage.recorder.pid, resource.RLIMIT_FSIZE, (600_000, resource.RLIM_INFINITY))
    stage.tell(4 * FRAMES_A_CHUNK)
    while stage.attend():
        pass
    (incident,) = stage.incidents
    end = assert_prefix(tmp_path / "r.mcap", ROWS)
    assert incident.startswith("recording stopped at tick ")
    assert "File too large" in incident
    told = int(incident.split()[4].rstrip(":"))
    assert read_recording(tmp_path / "r.mcap").x.shape[0] == told
    assert end <= told <= end + ROWS  # the devices' frames may be in different chunks
    assert stage.recorder.as_plain()["recording"]["ticks"] == told
    assert stage.recorder.as_plain()["recording"]["stopped"] == incident
    assert stage.recorder.stopped  # the exit code is 1
    assert list(tmp_path.glob(".*")) == []


def test_ending_the_recorder_leaves_a_whole_file(stage: ReadyRecorder, tmp_path: Path) -> None:
    stage.tell(1)
    stage.attend_until_taken()
    assert stage.recorder.pid is not None
    os.kill(stage.recorder.pid, signal.SIGTERM)
    while stage.attend():
        pass
    assert stage.incidents == [
        f"recording ended at tick {ROWS}: a signal ended the recorder; {tmp_path / 'r.mcap'} is complete up to there"
    ]
    assert assert_prefix(tmp_path / "r.mcap", ROWS) == ROWS
    assert read_recording(tmp_path / "r.mcap").cut is None


def test_in_real_time_a_slow_recorder_loses_ticks_and_counts_them(stage: ReadyRecorder, tmp_path: Path) -> None:
    assert stage.recorder.pid is not None
    os.kill(stage.recorder.pid, signal.SIGSTOP)
    while stage.recorder.lost == 0:
        stage.tell(1)
        assert stage.recorder.has_room
        assert stage.recorder._waiting_bytes <= MOST_WAITING_BYTES
    stage.tell(2)
    lost = stage.recorder.lost
    assert lost >= 6
    os.kill(stage.recorder.pid, signal.SIGCONT)
    while stage.recorder._waiting:
        assert stage.attend()
    stage.tell(1)
    stage.finish()
    assert stage.incidents == []
    assert stage.recorder.as_plain()["recording"]["lost"] == lost
    assert stage.recorder.missing == read_recording(tmp_path / "r.mcap").missing
    assert sum(stage.recorder.missing.values()) == lost * ROWS
    assert stage.recorder.failure is None


@simulated
def test_under_the_simulated_clock_it_asks_for_time_and_loses_nothing(stage: ReadyRecorder, tmp_path: Path) -> None:
    assert stage.recorder.pid is not None
    os.kill(stage.recorder.pid, signal.SIGSTOP)
    while stage.recorder.has_room:
        stage.tell(1)
    assert stage.recorder.lost == 0
    os.kill(stage.recorder.pid, signal.SIGCONT)
    while not stage.recorder.has_room:
        assert stage.attend()
    stage.tell(1)
    stage.finish()
    assert (stage.incidents, stage.recorder.missing, stage.recorder.failure) == ([], {}, None)
    assert assert_prefix(tmp_path / "r.mcap", 0) == stage.told * ROWS


@simulated
def test_under_the_simulated_clock_an_incomplete_recording_is_a_failure(stage: ReadyRecorder) -> None:
    assert stage.recorder.pid is not None
    os.kill(stage.recorder.pid, signal.SIGKILL)
    while stage.attend():
        pass
    assert stage.recorder.has_room  # the session goes on all the same
    assert stage.recorder.failure == stage.incidents[0]


def test_who_does_not_want_to_wait_for_the_disk_need_not(stage: ReadyRecorder, tmp_path: Path) -> None:
    assert stage.recorder.pid is not None
    os.kill(stage.recorder.pid, signal.SIGSTOP)
    os.write(stage.interrupted, b"x")
    stage.finish()
    assert "was killed by SIGKILL" in stage.incidents[0]
    assert read_recording(tmp_path / "r.mcap").x.shape == (0, 3)


def test_telemetry_too_long_to_be_passed_on_is_lost_and_counted(stage: ReadyRecorder) -> None:
    stage.recorder.take(
        observation_frame("dx", Telemetry(2**17, Figures(), {"x": np.zeros((2**17, 1)), "f_v": np.zeros((1, 1))}))
    )
    assert stage.recorder.lost == 1
    stage.finish()


def test_a_recording_that_cannot_begin_fails_before_the_session(prepared: Prepared, tmp_path: Path) -> None:
    (tmp_path / "run").mkdir(mode=0o700)
    (tmp_path / "r.mcap").mkdir()
    recorder = RecorderProcess(prepared, "realtime", tmp_path / "r.mcap")
    interrupt, interrupted = os.pipe()
    try:
        recorder.start(tmp_path / "run")
        with pytest.raises(RecordingError, match=r"r\.mcap: cannot be recorded to: Is a folder"):
            recorder.await_ready(interrupt)
    finally:
        recorder.close()
        os.close(interrupt)
        os.close(interrupted)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["r.mcap", "run"]


def test_an_older_recording_is_there_until_the_new_one_has_begun(prepared: Prepared, tmp_path: Path) -> None:
    (tmp_path / "r.mcap").write_bytes(b"an older run")
    recorder = RecorderProcess(prepared, "realtime", tmp_path / "r.mcap")
    assert (tmp_path / "r.mcap").read_bytes() == b"an older run"
    stage = ReadyRecorder(recorder, tmp_path)
    assert read_recording(tmp_path / "r.mcap").x.shape == (0, 3)
    stage.finish()
    stage.close()


def test_without_a_recording_no_message_is_exchanged(tmp_path: Path) -> None:
    nobody = Recorder()
    nobody.start(tmp_path)
    nobody.take(observation_frame("dx", Telemetry(1, Figures(), {})))
    nobody.take(None)
    assert (nobody.fds, nobody.has_room, nobody.attend({1}), nobody.finish(0)) == ((), True, None, None)
    assert (nobody.missing, nobody.failure, nobody.as_plain()) == ({}, None, {})
    assert list(tmp_path.iterdir()) == []
