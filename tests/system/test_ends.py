"""After any end of a session nothing is left, and the exit code shows how it ended.

Nothing here waits for time to pass: each end is brought about at an event that the supervisor reports.
"""

from __future__ import annotations

import dataclasses
import os
import select
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.plan.reach import reach
from manyhands.launch.run import supervisor as supervisor_module
from manyhands.launch.run.directory import sweep_directories
from manyhands.launch.run.outcome import Outcome, Progress
from manyhands.launch.run.states import SessionPhase
from manyhands.launch.run.supervisor import Supervisor
from manyhands.launch.session import load_session
from manyhands.nodes.kernel.bundle import Bundle

SESSIONS = Path(__file__).parents[2] / "launch" / "sessions"
MANYHANDS = [sys.executable, "-P", "-m", "manyhands"]


@pytest.fixture(scope="module")
def prepared() -> Prepared:
    return prepare(load_session(SESSIONS / "example1.yaml"))


@pytest.fixture(scope="module")
def brittle(prepared: Prepared) -> Prepared:
    """The session without restarts."""
    session = load_session(SESSIONS / "example1.yaml", ["faults.restarts=0"])
    return dataclasses.replace(prepared, session=session)


def run(prepared: Prepared, show: Callable[[Progress], None], transport: str = "ipc") -> Outcome:
    """A run without an end of its own."""
    return Supervisor(
        prepared, clock="realtime", reach=reach(prepared, transport), ticks=0, record=False, show=show
    ).run()


def once(when: Callable[[Progress], bool], then: Callable[[Progress], object]) -> Callable[[Progress], None]:
    """Act at the first progress that meets a condition."""
    done: list[bool] = []

    def show(progress: Progress) -> None:
        if not done and when(progress):
            done.append(True)
            then(progress)

    return show


def is_running(progress: Progress) -> bool:
    return progress.phase is SessionPhase.RUNNING and len(progress.telemetry) == 7


@pytest.mark.parametrize(
    ("victim", "transport"),
    [
        ("dx", "ipc"),
        ("cy", "tcp"),
        ("environment", "ipc"),
        *(
            pytest.param(*case, marks=pytest.mark.long)
            for case in (("dx", "tcp"), ("cy", "ipc"), ("environment", "tcp"))
        ),
    ],
)
def test_a_killed_node_ends_a_session_without_restarts_with_code_1(
    victim: str, transport: str, brittle: Prepared
) -> None:
    kill = once(is_running, lambda progress: os.kill(progress.pids[victim], signal.SIGKILL))
    outcome = run(brittle, kill, transport)
    assert outcome.code == 1
    assert outcome.faults == (f"{victim} was killed by SIGKILL while running",)
    assert set(outcome.report["nodes"]) == set(supervisor_nodes(brittle)) - {victim}


@pytest.mark.parametrize("victim", ["dz", pytest.param("cx", marks=pytest.mark.long), "environment"])
def test_a_node_killed_during_start_up(victim: str, prepared: Prepared) -> None:
    kill = once(
        lambda p: p.phase is SessionPhase.STARTING and victim in p.pids,
        lambda progress: os.kill(progress.pids[victim], signal.SIGKILL),
    )
    outcome = run(prepared, kill)
    assert outcome.code == 1
    assert outcome.faults[0].startswith(f"{victim} was killed by SIGKILL while ")


@pytest.mark.parametrize("phase", [SessionPhase.STARTING, SessionPhase.RUNNING])
@pytest.mark.parametrize(("which", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_an_interrupt_ends_the_session(
    phase: SessionPhase, which: signal.Signals, code: int, prepared: Prepared
) -> None:
    outcome = run(prepared, once(lambda p: p.phase is phase, lambda _: os.kill(os.getpid(), which)))
    assert outcome.code == code
    assert outcome.faults == ()


def test_interrupted_while_running_every_node_still_reports(prepared: Prepared) -> None:
    outcome = run(prepared, once(is_running, lambda _: os.kill(os.getpid(), signal.SIGINT)))
    assert outcome.code == 130
    assert set(outcome.report["nodes"]) == set(supervisor_nodes(prepared))
    assert all(node["ticks"] > 0 for node in outcome.report["nodes"].values())


@pytest.mark.parametrize("transport", [pytest.param("ipc", marks=pytest.mark.long), "tcp"])
def test_a_node_of_another_certificate_is_refused_by_the_supervisor(
    transport: str, prepared: Prepared, monkeypatch: pytest.MonkeyPatch
) -> None:
    def forged(prepared: Prepared, run: RunPlan) -> dict[str, Bundle]:
        bundles = cut(prepared, run)
        common = dataclasses.replace(bundles["cy"].common, certificate="0" * 64)
        return {**bundles, "cy": dataclasses.replace(bundles["cy"], common=common)}

    monkeypatch.setattr(supervisor_module, "cut", forged)
    outcome = run(prepared, lambda _: None, transport)
    assert outcome.code == 1
    assert any(f"found the certificate {'0' * 64}" in fault and prepared.id in fault for fault in outcome.faults)


def test_a_node_that_cannot_read_its_bundle_reports_it(prepared: Prepared, monkeypatch: pytest.MonkeyPatch) -> None:
    def swapped(prepared: Prepared, run: RunPlan) -> dict[str, Bundle]:
        bundles = cut(prepared, run)
        return {**bundles, "cy": bundles["dx"]}

    monkeypatch.setattr(supervisor_module, "cut", swapped)
    outcome = run(prepared, lambda _: None)
    assert outcome.code == 1
    assert outcome.faults[0] == "cy ended with exit code 2 while starting"
    assert any("not a bundle for a CouplingBundle" in fault for fault in outcome.faults)


def test_nodes_end_when_their_supervisor_is_killed() -> None:
    process = launched()
    read_until(process, "running: tick")
    nodes = [int(p) for p in Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()]
    assert len(nodes) == 7
    descriptors = [os.pidfd_open(pid) for pid in nodes]
    process.kill()
    process.communicate()
    for descriptor in descriptors:
        assert select.select([descriptor], [], [], 30.0)[0], "a node outlived its supervisor"
        os.close(descriptor)
    sweep_directories()  # as the next run does: the killed one could not remove its folder


def supervisor_nodes(prepared: Prepared) -> list[str]:
    return [*prepared.session.devices, *prepared.session.couplings, "environment"]


def launched(*arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [
            *(*MANYHANDS, "launch", str(SESSIONS / "example1.yaml"), "--set", "design.tau=0"),
            *("--set", "colocate=false", *arguments),  # whatever processors there are: seven processes are to end
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def read_until(process: subprocess.Popen[str], words: str) -> None:
    """Read the process's error output up to the line with ``words``."""
    assert process.stderr is not None
    while words not in (line := process.stderr.readline()):
        assert line, f"it ended with {process.wait()} and never said {words!r}"


@pytest.mark.parametrize("line", [": starting", pytest.param(": running", marks=pytest.mark.long), "running: tick"])
def test_ctrl_c_on_the_command_line(line: str) -> None:
    process = launched()
    read_until(process, line)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert "Traceback" not in out + err
