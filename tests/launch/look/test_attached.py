"""Recording a session that already runs, without sockets: each frame's handling, the writes, and the end."""

from __future__ import annotations

import os
import stat
import subprocess
import sys
from collections import deque
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from manyhands.launch.app.cli import app
from manyhands.launch.look.attached import (
    AttachedCore,
    Ending,
    attachments_in,
    record_attached,
    write_down,
)
from manyhands.launch.look.sessions import NoSession, session_in
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.recordings.integrity import findings
from manyhands.launch.recordings.run import read_run
from manyhands.launch.run.broadcast import Showing, describe
from manyhands.launch.run.directory import SessionDirectory, kept_files, run_directory
from manyhands.launch.run.processes import Interrupt
from manyhands.launch.run.running import Running
from manyhands.launch.run.states import SessionPhase
from manyhands.launch.session import load_session
from manyhands.nodes.recorder.core import RecorderCore
from manyhands.nodes.recorder.format import recorded_of
from manyhands.nodes.recorder.node import FLUSH_EVERY
from manyhands.protocol.clock import Duration, Instant, RealtimeClock, SimulatedClock

from ...support.small_recordings import ATTACHED, RECORDED, STARTED, condition, frames, observation

SESSIONS = Path(__file__).parents[3] / "launch" / "sessions"

pytestmark = pytest.mark.usefixtures("own_interrupt")


@pytest.fixture(scope="module")
def prepared() -> Prepared:
    return prepare(load_session(SESSIONS / "example1.yaml"))


def core_of(duration: float | None = None) -> AttachedCore:
    return AttachedCore(RecorderCore(RECORDED, ATTACHED, STARTED), RECORDED, duration, Instant(0))


class BroadcastFrames:
    """A broadcast of which these frames are seen, each ``each`` after the one before; then nothing."""

    def __init__(self, clock: SimulatedClock, frames: Iterable[bytes | None], each: Duration) -> None:
        self._clock, self._frames, self._each = clock, deque(frames), each

    def recv(self, timeout: Duration) -> bytes | None:
        if timeout:
            self._clock.sleep_until(Instant(self._clock.now() + self._each))
        return self._frames.popleft() if self._frames else None


def written(
    core: AttachedCore, shown: Iterable[bytes | None], gone: bool = True, interrupted: bool = False
) -> list[bytes]:
    pieces: list[bytes] = []
    clock = SimulatedClock()
    visit = BroadcastFrames(clock, shown, Duration(FLUSH_EVERY // 4))
    write_down(core, visit, lambda: gone, pieces.append, lambda: interrupted, clock, lambda _core: None)
    return pieces


def test_it_begins_where_it_came_in(tmp_path: Path) -> None:
    core = core_of()
    shown = [*list(frames(30, 5))[9:], condition(SessionPhase.OVER.value)]
    pieces = written(core, shown, gone=False)
    assert (core.ending, core.beginning, core.tick, core.missing) == (Ending.OVER, {"dx": 15}, 30, {})
    path = tmp_path / "run.mcap"
    path.write_bytes(b"".join(pieces))
    assert findings(path) == []
    x = read_run(path).traces["dx", "sample"].values
    assert np.isnan(x[:15]).all()
    assert x[15:, 0].tolist() == np.sin(np.arange(15.0, 30.0) + 1.0).tolist()


def test_it_writes_at_least_once_a_second_in_readable_form() -> None:
    pieces = written(core_of(), [*frames(40, 5), condition(SessionPhase.OVER.value)])
    assert len(pieces) == len(list(frames(40, 5))) // 4 + 1
    assert all(pieces)


def test_nothing_is_written_while_nothing_comes() -> None:
    core = core_of()
    assert core.piece(Instant(FLUSH_EVERY // 2)) == b""
    assert core.piece(Instant(FLUSH_EVERY))  # the file's beginning
    assert core.piece(Instant(2 * FLUSH_EVERY)) == b""


def test_lost_frames_are_reported_as_missing_ticks() -> None:
    core = core_of()
    for tick in (105, 110, 125):
        core.take(observation("dx", tick, 5), STARTED)
    assert (core.beginning, core.missing) == ({"dx": 100}, {"dx": 10})


def test_it_ends_when_it_is_as_long_as_was_asked_for() -> None:
    core = core_of(duration=0.010)
    core.take(observation("dx", 105, 5), STARTED)
    assert core.ending is None
    core.take(observation("dx", 110, 5), STARTED)
    assert core.ending is Ending.DURATION


def test_it_ends_with_the_supervisor_and_keeps_what_came_before() -> None:
    core = core_of()
    written(core, [observation("dx", 5, 5), None, observation("dx", 10, 5)])
    assert (core.ending, core.tick) == (Ending.GONE, 10)


def test_silence_alone_is_no_end() -> None:
    core = core_of()
    written(core, [None, None, observation("dx", 5, 5), None, condition(SessionPhase.OVER.value)], gone=False)
    assert (core.ending, core.tick) == (Ending.OVER, 5)


def test_it_ends_when_it_is_asked_to() -> None:
    core = core_of()
    written(core, frames(10, 5), interrupted=True)
    assert core.ending is Ending.INTERRUPTED


@pytest.mark.parametrize("frame", [b"", b"nonsense", observation("dx", 5, 5)[:-3], condition("over")[:-2]])
def test_what_makes_no_sense_is_counted_and_ends_nothing(frame: bytes) -> None:
    core = core_of()
    core.take(frame, STARTED)
    assert (core.refused, core.ending, core.beginning) == (1, None, {})


def test_what_is_recorded_is_what_the_sessions_own_recorder_would_say(prepared: Prepared) -> None:
    about = describe(prepared, "realtime", "ipc", 0)
    recorded = recorded_of(about)
    assert (recorded.session, recorded.certificate, recorded.clock) == ("example-1", prepared.id, "realtime")
    assert (recorded.period, recorded.masses) == (prepared.session.period, ("hub",))
    assert [*recorded.devices] == [*prepared.session.devices]


def test_a_sessions_directory_has_its_files_for_its_user_alone(prepared: Prepared) -> None:
    with run_directory() as directory:
        Showing(directory, describe(prepared, "realtime", "ipc", 0), kept_files(prepared)).close()
        assert attachments_in(directory) == kept_files(prepared)
        assert {stat.S_IMODE((directory / name).stat().st_mode) for name in kept_files(prepared)} == {0o600}


def test_a_session_is_found_by_either_of_its_directories(prepared: Prepared, tmp_path: Path) -> None:
    kept = SessionDirectory(tmp_path / "kept")
    with run_directory(kept.logs) as directory:
        about = describe(prepared, "realtime", "ipc", 0)
        Showing(directory, about).close()
        assert session_in(tmp_path / "kept").about == session_in(directory).about == about
        (tmp_path / "other" / "log").mkdir(parents=True)
        for other in (tmp_path, tmp_path / "other", tmp_path / "none"):
            with pytest.raises(NoSession, match=f"{other}: found no running session's directory; expected .*example-1"):
                session_in(other)


def test_a_session_that_is_over_is_not_recorded(prepared: Prepared, tmp_path: Path) -> None:
    with run_directory() as directory, subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as it:
        about = replace(describe(prepared, "realtime", "ipc", 0), pid=it.pid)
        about.save(directory)
        it.kill()
        os.waitid(os.P_PID, it.pid, os.WEXITED | os.WNOWAIT)  # not yet reaped
        with pytest.raises(NoSession, match="it is over"), Interrupt() as interrupt:
            record_attached(
                Running(directory, about), tmp_path / "r.mcap", None, interrupt, RealtimeClock(), lambda _core: None
            )
        assert [*tmp_path.iterdir()] == []


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "found no running session"),
        (["."], "found no running session's directory"),
        (["--running", "example-1"], "found no running session"),
        ([".", "--running", "example-1"], "give either DIR or --running NAME"),
        (["--duration", "0"], "--duration: found 0 s"),
        (["-o", "run.csv"], "expected one of .mcap"),
        (["-o", "nowhere/run.mcap"], "found no folder nowhere"),
    ],
)
def test_the_command_refuses(arguments: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, ["record", "-o", "run.mcap", *arguments])
    assert (result.exit_code, result.stdout) == (2, "")
    assert said in result.stderr
    assert [*tmp_path.iterdir()] == []
