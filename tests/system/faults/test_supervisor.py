"""The supervisor's own end in the middle of a recovery, and sessions that start and stop again and again."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import tempfile
from pathlib import Path

import pytest

from manyhands.launch.run.directory import sweep_directories
from manyhands.launch.run.states import SessionPhase

from ...support.cases import cases
from ...support.commands import read_until, started
from .stage import DEADLINE, HERE, NODES, all_on, nothing, play

STARTS = int(os.environ.get("MANYHANDS_STARTS", cases(3, 5)))
"""How often a session is started and stopped; fifty times by ``MANYHANDS_STARTS=50``."""


def children(process: subprocess.Popen[str]) -> dict[str, int]:
    """The process ids of a supervisor's nodes."""
    found = {}
    for pid in map(int, Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()):
        words = Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
        bundles = [Path(os.fsdecode(word)).stem for word in words if word.endswith(b".bundle")]
        found.update(dict.fromkeys(bundles, pid))
    return found


def test_nodes_end_when_their_supervisor_dies_during_a_rejoin() -> None:
    with started("launch", HERE / "pair.yaml", "--clock", "simulated") as process:
        read_until(process, "running: tick")
        first = children(process)
        assert first.keys() == NODES
        os.kill(first["dx"], signal.SIGKILL)
        read_until(process, "dx was killed by SIGKILL")
        second = children(process)
        assert second["dx"] != first["dx"]
        descriptors = {name: os.pidfd_open(pid) for name, pid in second.items()}
        process.kill()
        for name, descriptor in descriptors.items():
            assert select.select([descriptor], [], [], DEADLINE)[0], f"{name} outlived its supervisor"
            os.close(descriptor)
    sweep_directories()  # as the next run does: the killed one could not remove its folder


@pytest.mark.wide
@pytest.mark.alone  # /dev/shm is the whole machine's: a browser of another test has files there, too
def test_starts_and_stops_in_a_row_leave_nothing() -> None:
    """For each run by itself: not one descriptor, shared memory or temporary file more than before."""

    def left() -> tuple[set[str], set[str], set[str]]:
        shared = {path.name for path in Path("/dev/shm").iterdir() if path.stat().st_uid == os.getuid()}
        return set(os.listdir("/proc/self/fd")), shared, set(os.listdir(tempfile.gettempdir()))

    before: tuple[set[str], set[str], set[str]] | None = None
    for start in range(STARTS):
        at_once = (lambda progress: progress.phase is SessionPhase.RUNNING, nothing)
        outcome = play(at_once if start % 2 else (all_on(0), nothing))
        assert (outcome.code, outcome.faults) == (130, ())
        found = left()
        before = before or found  # the first start may open what stays open, as a font or a random source
        assert found[0] == before[0]
        assert found[2] == set()
        assert found[1] <= before[1]
