"""Whole sessions recorded as they run, with the recorder killed, or with a disk that is really full."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import stat
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from manyhands.launch.audit.audit import audit
from manyhands.launch.audit.findings import CheckVerdict
from manyhands.launch.audit.replay import replay
from manyhands.launch.audit.simulation import Simulation
from manyhands.launch.plan.keys import ephemeral
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.plan.reach import reach
from manyhands.launch.plan.topology import roster
from manyhands.launch.recordings.recording import Recording
from manyhands.launch.recordings.run import read_run
from manyhands.launch.recordings.tables import read_recording
from manyhands.launch.run import recorder as recorder_process
from manyhands.launch.run.directory import REPORT, SessionDirectory
from manyhands.launch.run.outcome import Outcome, Progress, save_json
from manyhands.launch.run.recorder import RecorderProcess
from manyhands.launch.run.states import SessionPhase
from manyhands.launch.run.supervisor import Supervisor
from manyhands.launch.session import load_session
from manyhands.protocol.channels import topic_name, topics_of

from ..support.commands import MANYHANDS, run

SESSIONS = Path(__file__).parents[2] / "launch" / "sessions"
TICKS = 1250  # no multiple of the ticks between two telemetry messages


@pytest.fixture(scope="module")
def prepared() -> Prepared:
    return prepare(load_session(SESSIONS / "example1.yaml"))


@pytest.fixture(scope="module")
def expected(prepared: Prepared) -> Recording:
    return Simulation(prepared).run(TICKS)


def recorded(
    prepared: Prepared,
    recorder: RecorderProcess,
    clock: str,
    ticks: int,
    show: Callable[[Progress], None] | None = None,
) -> Outcome:
    ways = reach(prepared, "ipc")
    return Supervisor(prepared, clock=clock, reach=ways, ticks=ticks, record=False, recorder=recorder, show=show).run()


def test_under_the_simulated_clock_the_file_holds_the_simulations_numbers(
    prepared: Prepared, expected: Recording, tmp_path: Path
) -> None:
    recorder = RecorderProcess(prepared, "simulated", tmp_path / "r.mcap")
    ways = reach(prepared, "ipc")
    supervisor = Supervisor(prepared, clock="simulated", reach=ways, ticks=TICKS, record=False, recorder=recorder)
    outcome = supervisor.run()
    assert supervisor._collector.tick == 0  # nothing of it stays in the supervisor's memory
    assert (outcome.code, outcome.faults, outcome.incidents, outcome.recording) == (0, (), (), None)
    found = read_recording(tmp_path / "r.mcap")
    assert (found.cut, found.missing, found.certificate, found.ports) == (None, {}, prepared.id, expected.ports)
    assert found.x.tobytes() == expected.x.tobytes()
    assert found.f_v.tobytes() == expected.f_v.tobytes()
    assert outcome.report["recording"] == {"file": str(tmp_path / "r.mcap"), "ticks": TICKS}
    whole = read_run(tmp_path / "r.mcap")
    assert (whole.ticks, whole.cut, whole.recorded.masses) == (TICKS, None, ("hub",))
    for node, role in whole.recorded.roles.items():
        assert [tick for tick, _ in whole.figures[node]][-1] == TICKS
        for topic in topics_of(role, ("hub",)):
            assert not np.isnan(whole.traces[node, topic.name].values).any(), (node, topic.name)
    phases = [condition.phase for _, condition in whole.conditions]
    assert phases == sorted(phases, key=[phase.value for phase in SessionPhase].index)
    assert (phases[-1], whole.conditions[-1][0]) == ("over", TICKS)


@pytest.mark.parametrize(
    ("own", "rate"),
    [("", 1), (", period: 0.0005", 2), (", interval: 0.003", 1)],
    ids=["one period", "a site of 2 kHz", "a wave in 3 ticks"],
)
def test_both_ends_of_a_wave_link_are_recorded_as_an_audit_computes_them(own: str, rate: int, tmp_path: Path) -> None:
    link = f"couplings.cx.wave_link={{b: 20, depth: 2{own}}}"
    linked, path = prepare(load_session(SESSIONS / "example1.yaml", [link, "design.ladder=[]"])), tmp_path / "r.mcap"
    outcome = recorded(linked, RecorderProcess(linked, "simulated", path), "simulated", 400)
    assert (outcome.code, outcome.faults, outcome.incidents) == (0, (), ())
    assert outcome.report["wave_links"].keys() == {"cx"}
    run = read_run(path)
    done = audit(path, run, lambda text: None, lambda tick: None)
    assert [check for check in done.checks if check.verdict is not CheckVerdict.HOLDS] == []
    assert (run.ticks, run.ticks_of("dx"), run.ticks_of("dy")) == (400, 400 * rate, 400)
    if rate == 1:
        assert replay(linked, run).identical


@pytest.mark.parametrize("clock", ["realtime", "simulated"])
def test_a_recorder_that_is_killed_ends_no_session(
    clock: str, prepared: Prepared, expected: Recording, tmp_path: Path
) -> None:
    """Every tick is done, and the exit code says that the recording is not whole."""
    recorder = RecorderProcess(prepared, clock, tmp_path / "r.mcap")

    def kill(progress: Progress) -> None:
        if recorder.pid is not None and progress.telemetry:
            os.kill(recorder.pid, signal.SIGKILL)

    outcome = recorded(prepared, recorder, clock, TICKS, kill)
    assert outcome.code == 1
    assert outcome.report["nodes"]["environment"]["ticks"] == TICKS
    (incident,) = (told for told in outcome.incidents if told.startswith("recording"))
    assert "the recorder was killed by SIGKILL" in incident
    assert outcome.report["recording"]["stopped"] == incident
    assert outcome.faults == ((incident,) if clock == "simulated" else ())
    found = read_recording(tmp_path / "r.mcap")
    assert found.cut is not None
    if clock == "simulated":  # in real time a busy machine may have frozen somebody's ports, and moved hands otherwise
        assert_begins(found, expected)


def test_while_the_recorder_is_slow_telemetry_waits_at_the_nodes(
    prepared: Prepared, expected: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A recorder that is stopped until as much waits as may wait; the run is too short for the true bounds."""
    most, frame = 20_000, 4_000
    monkeypatch.setattr(recorder_process, "MOST_WAITING_BYTES", most)
    monkeypatch.setattr(recorder_process, "MOST_UNDER_WAY", 4)
    recorder = RecorderProcess(prepared, "simulated", tmp_path / "r.mcap")
    waited: list[int] = []
    had_no_room: list[bool] = []

    def stop_and_go(progress: Progress) -> None:
        assert recorder.pid is not None or progress.phase is SessionPhase.OVER
        waited.append(recorder._waiting_bytes)
        if not recorder.has_room:
            had_no_room.append(True)
        if recorder.pid is not None and not had_no_room:
            os.kill(recorder.pid, signal.SIGSTOP)
        elif recorder.pid is not None:
            os.kill(recorder.pid, signal.SIGCONT)

    outcome = recorded(prepared, recorder, "simulated", TICKS, stop_and_go)
    assert (outcome.code, outcome.faults) == (0, ())
    assert had_no_room
    assert max(waited) < most + frame
    found = read_recording(tmp_path / "r.mcap")
    assert (found.cut, found.missing) == (None, {})
    assert found.x.tobytes() == expected.x.tobytes()


def assert_begins(found: Recording, expected: Recording) -> None:
    known = ~np.isnan(found.x)
    np.testing.assert_array_equal(found.x[known], expected.x[: len(found.x)][known])


def may_mount() -> bool:
    unshare = shutil.which("unshare")
    if unshare is None:
        return False
    try_it = [unshare, "--user", "--map-root-user", "--mount", "mount", "-t", "tmpfs", "none", "/mnt"]
    return subprocess.run(try_it, capture_output=True, check=False).returncode == 0


@pytest.mark.long
@pytest.mark.skipif(not may_mount(), reason="a disk of one's own needs a user namespace; the kernel refuses it here")
def test_a_full_disk_ends_the_recording_and_not_the_session(expected: Recording, tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    script = 'mount -t tmpfs -o size=96k none disk && "$@"; code=$?; cp disk/r.mcap full.mcap; exit $code'
    launch = [*MANYHANDS, "launch", "example1.yaml", "--duration", str(TICKS / 1000), "--record", "disk/r.mcap",
              "--report", "report.json", "--clock", "simulated"]  # fmt: skip
    done = subprocess.run(
        ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c", script, "sh", *launch],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 1, done.stderr  # under the simulated clock a recording is whole or the run has failed
    stopped = re.search(r"recording stopped at tick (\d+): No space left on device", done.stderr)
    assert stopped is not None, done.stderr
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["recording"]["ticks"] == int(stopped[1])
    assert report["recording"]["stopped"].startswith(stopped[0])
    assert {node["ticks"] for node in report["nodes"].values()} == {TICKS}
    found = read_recording(tmp_path / "full.mcap")
    assert len(found.x) == int(stopped[1])
    assert_begins(found, expected)


def test_everything_of_one_run_is_in_its_directory(tmp_path: Path) -> None:
    kept = tmp_path / "run"
    run("launch", "example1.yaml", "--clock", "simulated", "--duration", "0.3", "--set", "devices.dx.mass=0.3",
        "--directory", kept, "--record", "r.mcap", "--transport", "tcp")  # fmt: skip
    found = {path.name for path in kept.iterdir()}
    assert found == {"session.yaml", "certificate.json", "report.json", "log", "r.mcap"}
    assert stat.S_IMODE(kept.stat().st_mode) == 0o700
    session = load_session(kept / "session.yaml")
    assert session == load_session(
        SESSIONS / "example1.yaml", ["devices.dx.mass=0.3", "design.tau=0", "colocate=false"]
    )
    certificate, report = (json.loads((kept / f"{name}.json").read_text()) for name in ("certificate", "report"))
    recording, attached = read_recording(kept / "r.mcap"), read_run(kept / "r.mcap").attachments
    assert attached == {name: (kept / name).read_bytes() for name in ("session.yaml", "certificate.json")}
    assert certificate["id"] == report["certificate"] == recording.certificate
    assert recording.x.shape == (300, 3)
    events = [json.loads(line) for line in (kept / "log" / "supervisor.jsonl").read_text().splitlines()]
    assert [event["event"] for event in events][:2] == ["start", "phase"]
    assert events[-1]["event"] == "end"
    assert {event["peer"] for event in events if event["event"] == "exited"} == set(session.roles)
    assert {event["code"] for event in events if event["event"] == "exited"} == {0}


def test_every_tick_of_every_topic_is_a_message_of_its_own(tmp_path: Path) -> None:
    ticks = 450
    run("launch", "example1.yaml", "--clock", "simulated", "--duration", "0.45", "--record", tmp_path / "r.mcap")
    session = load_session(SESSIONS / "example1.yaml")
    with (tmp_path / "r.mcap").open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    counts = summary.statistics.channel_message_counts
    found = {channel.topic: counts[number] for number, channel in summary.channels.items()}
    told = {
        topic_name(session.name, node, topic.name): ticks
        for node, role in session.roles.items()
        for topic in topics_of(role, ("hub",))
    }
    assert len(told) == 3 * 4 + 3 * 3 + 3
    assert {topic: found.pop(topic) for topic in told} == told
    condition = topic_name(session.name, "supervisor", "condition")
    assert found.keys() == {condition, *(topic_name(session.name, node, "telemetry") for node in session.roles)}


def test_a_directory_of_another_run_is_refused_before_anything_is_started(tmp_path: Path) -> None:
    (tmp_path / "older").write_text("an older run")
    command = [*MANYHANDS, "launch", "example1.yaml", "--directory", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2
    assert "found a folder that is not empty; expected a new one for each run" in " ".join(done.stderr.split())
    assert [path.name for path in tmp_path.iterdir()] == ["older"]


def test_no_key_is_in_what_is_kept(prepared: Prepared, tmp_path: Path) -> None:
    keys = ephemeral(roster(prepared.session), prepared.session.name)
    secrets = [keys.pair(name).secret.encode() for name in roster(prepared.session)]
    directory = SessionDirectory(tmp_path / "run")
    directory.keep_session(prepared)
    recorder = RecorderProcess(prepared, "simulated", directory.path / "r.mcap")
    outcome = Supervisor(
        prepared,
        clock="simulated",
        reach=reach(prepared, "tcp", keys=keys),
        ticks=300,
        record=False,
        recorder=recorder,
        logs=directory.logs,
    ).run()
    assert outcome.code == 0, outcome.faults
    save_json(outcome.report, directory.path / REPORT)
    kept = {path: path.read_bytes() for path in directory.path.rglob("*") if path.is_file()}
    assert directory.logs / "supervisor.jsonl" in kept
    assert [path for path, content in kept.items() if any(secret in content for secret in secrets)] == []
