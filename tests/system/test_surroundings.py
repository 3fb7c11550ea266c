"""The surroundings of a session: signals of its terminal, poor locales, narrow terminals, a user without rights."""

from __future__ import annotations

import ctypes
import io
import json
import os
import re
import resource
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from rich.cells import cell_len
from rich.console import Console

from manyhands.launch.look.live import LiveTable
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.run.broadcast import describe
from manyhands.launch.run.outcome import Progress
from manyhands.launch.run.states import NodeState, SessionPhase
from manyhands.launch.session import load_session
from manyhands.nodes.rows import figures as names
from manyhands.protocol.messages import Figures, Telemetry

from ..support.commands import read_until

ALONE = Path(__file__).parents[1] / "deterministic/alone.yaml"
LAUNCH = [sys.executable, "-P", "-m", "manyhands", "launch", str(ALONE)]
_PR_CAPBSET_DROP, _PR_SET_NO_NEW_PRIVS = 24, 38  # linux/prctl.h
_CAPABILITIES = 64


def ignore_hangup() -> None:
    """As nohup does; a shell that runs the tests in the background has had them ignore Ctrl-backslash."""
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    signal.signal(signal.SIGQUIT, signal.SIG_DFL)


def test_under_nohup_a_session_outlives_its_terminal_until_ctrl_backslash(tmp_path: Path) -> None:
    with subprocess.Popen(
        [*LAUNCH, "--clock", "simulated", "--report", str(tmp_path / "run.json")],
        preexec_fn=ignore_hangup,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            read_until(process, ": running")
            process.send_signal(signal.SIGHUP)
            read_until(process, "running: tick")  # it goes on
            process.send_signal(signal.SIGQUIT)
            process.communicate(timeout=60)
        except BaseException:
            process.kill()
            raise
    assert process.returncode == 128 + signal.SIGQUIT
    assert json.loads((tmp_path / "run.json").read_text())["nodes"].keys() == {"d", "c", "environment"}


def drop_rights() -> None:
    """Become an ordinary user: no capability, no real-time priority, no memory that can be locked."""
    prctl = ctypes.CDLL(None).prctl
    for capability in range(_CAPABILITIES):
        prctl(_PR_CAPBSET_DROP, capability, 0, 0, 0)  # of an ordinary user there is none to drop
    prctl(_PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)
    for limit in (resource.RLIMIT_RTPRIO, resource.RLIMIT_NICE, resource.RLIMIT_MEMLOCK):
        resource.setrlimit(limit, (0, 0))


def test_real_time_works_without_rights_display_or_unicode(tmp_path: Path) -> None:
    """Folder, session file and report have other letters; the table that is printed, too."""
    folder = tmp_path / "üτ"
    folder.mkdir()
    (folder / "s.yaml").write_text(ALONE.read_text(encoding="utf-8"), encoding="utf-8")
    locale = {"LC_ALL": "POSIX", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "NO_COLOR": "1"}
    with open("/dev/full", "wb") as full:
        done = subprocess.run(
            [
                *LAUNCH[:-1],
                folder / "s.yaml",
                "--set",
                "design.tau=0",
                "--duration",
                "0.3",
                "--report",
                folder / "run.json",
            ],
            preexec_fn=drop_rights,
            env={**os.environ, **locale},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=full,
            timeout=120,
            check=False,
        )
    assert done.returncode == 0
    assert b"\\u03c4 [" in done.stdout
    report = json.loads((folder / "run.json").read_text())
    lost = "the display was lost (standard error: No space left on device); the session goes on without it"
    assert lost in report["incidents"]
    device = report["nodes"]["d"]
    assert device["ticks"] == 300
    assert (device["realtime"]["fifo"], device["realtime"]["memory_locked"]) == (False, False)


@pytest.mark.parametrize("width", [1, 2, 7, 20, 60])
def test_a_narrow_terminal_cuts_the_display_and_nothing_else(width: int) -> None:
    written, prepared = io.StringIO(), prepare(load_session(ALONE))
    graph = prepared.graph
    console = Console(file=written, force_terminal=True, width=width)
    telemetry = {node: Telemetry(10**6, Figures({names.LATE: 3.0}), {}) for node in graph.nodes}
    states = dict.fromkeys(graph.nodes, NodeState.RUNNING.value)
    with LiveTable(console, "alone", describe(prepared, "realtime", "ipc", 0)) as table:
        assert table(Progress(SessionPhase.RUNNING, states, {}, telemetry, 1.0, ("τ is long",), {"no_key": 3})) is None
    shown = re.sub("\x1b\\[[0-9;?]*[A-Za-z]", "", written.getvalue())
    assert 0 < max(map(cell_len, shown.replace("\r", "\n").split("\n"))) <= width
