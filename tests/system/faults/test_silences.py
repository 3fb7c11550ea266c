"""Parties that fall silent without dying: stopped, slow, cut off, or in an endless computation."""

from __future__ import annotations

import dataclasses
import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from manyhands.launch.plan.reach import reach
from manyhands.launch.run import supervisor as supervisor_module
from manyhands.launch.run.conductor import Conductor
from manyhands.launch.run.outcome import Progress
from manyhands.launch.run.states import Instruction
from manyhands.protocol.clock import from_seconds
from manyhands.protocol.codec import Received
from manyhands.protocol.messages import NodeHello

from ...support.rows import rows_of
from .proxy import Cable
from .stage import (
    HERE,
    NODES,
    PORTS,
    PROMISE,
    all_on,
    at,
    gone_on,
    nodes_of,
    nothing,
    play,
    prepared,
    recording_of,
    require_sound,
    returned,
    send,
    simulated,
    told_of,
)


def throttled(victim: str, turns: int) -> tuple[Any, Any]:
    """A step in which a process is stopped and continued in turn, one turn at each look."""
    done: list[int] = []

    def when(progress: Progress) -> bool:
        done.append(0)
        os.kill(progress.pids[victim], signal.SIGCONT if len(done) % 2 == 0 else signal.SIGSTOP)
        return len(done) == 2 * turns

    return when, nothing


def test_under_the_simulated_clock_a_stopped_or_slow_process_changes_nothing() -> None:
    """The session's time stops with the process: every number equals the run without faults."""
    outcome = play(
        (at(100), send(signal.SIGSTOP, "dx")),
        (lambda progress: progress.silent == NODES, send(signal.SIGCONT, "dx")),
        (all_on(50), nothing),
        throttled("cy", 4),
        throttled("environment", 4),
        (all_on(50), nothing),
    )
    require_sound(outcome)
    assert outcome.incidents == ()
    for i, port in enumerate(PORTS):
        _, f = rows_of(recording_of(outcome), port)
        assert f.tobytes() == simulated(len(f))[:, i].tobytes()


@pytest.mark.alone
def test_in_real_time_a_stopped_device_is_frozen_and_returns() -> None:
    outcome = play(
        (told_of(100), send(signal.SIGSTOP, "dx")),
        (gone_on({"dx", "cx"}, 200), send(signal.SIGCONT, "dx")),
        (returned("dx", "cx"), nothing),
        clock="realtime",
    )
    require_sound(outcome)
    nodes = nodes_of(outcome)
    assert nodes["environment"]["incidents"]["frozen"] >= 200
    assert nodes["dx"]["incidents"]["jumps"] >= 1
    # no process died; on a slow machine a second passes before it has returned
    assert all("cx (dx) is frozen since" in one for one in outcome.incidents)


@pytest.mark.alone
def test_in_real_time_a_slow_device_costs_others_only_its_absence() -> None:
    others: list[tuple[int, int]] = []

    def ticks(progress: Progress) -> None:
        others.append((progress.telemetry["dy"].tick, progress.telemetry["environment"].tick))

    outcome = play(
        (told_of(100), ticks),
        throttled("dx", 10),
        (lambda _: True, ticks),
        (returned("dx", "cx"), nothing),
        clock="realtime",
    )
    require_sound(outcome)
    before, after = others
    assert after[0] > before[0]
    assert after[1] > before[1]
    assert nodes_of(outcome)["environment"]["late_couplings"]["cx"]["held"] > 0


@pytest.mark.alone
def test_a_device_lets_go_at_the_first_sample_without_answer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = tmp_path / "driver.log"
    popen = subprocess.Popen

    def start(command: list[str], **options: Any) -> subprocess.Popen[bytes]:
        if Path(command[-2]).stem != "dx":
            return popen(command, **options)
        options["env"] = {**options["env"], "PYTHONPATH": search_path(HERE.parent)}
        return popen([sys.executable, "-P", "-m", "faults.logged_device", *command[-2:], str(log)], **options)

    monkeypatch.setattr(subprocess, "Popen", start)
    outcome = play(
        (told_of(100), send(signal.SIGSTOP, "cx")),
        (gone_on({"dx", "cx"}, 200), send(signal.SIGCONT, "cx")),
        (returned("dx", "cx"), nothing),
        clock="realtime",
    )
    require_sound(outcome)
    calls = log.read_text()
    # at the end it releases what it holds, be it in a tick, between two, or just after it has let go (srr)
    assert re.fullmatch(r"(se?[az]|se?rr(sr)*)*(s?e?r|se?rr|se?)", calls), (
        "it held a force after a sample without answer"
    )
    free = re.search(r"srr(?:sr){200,}", calls)  # periods, while the others did as many
    assert free
    assert 200 <= nodes_of(outcome)["dx"]["incidents"]["released"] <= calls.count("r")
    assert "a" in calls[free.end() :]  # and later it felt the world again


@pytest.mark.alone
def test_a_link_that_is_cut_and_mended(monkeypatch: pytest.MonkeyPatch) -> None:
    """The link is encrypted, between a coupling and the environment: both live on and reconnect."""
    cables: list[Cable] = []
    hear = Conductor.receive

    def rewired(self: Conductor, sender: str, received: Received, now: int) -> list[Instruction]:
        if sender == "environment" and isinstance(received, NodeHello):
            cables.append(Cable(received.endpoints["cx"]))
            endpoints = {**received.endpoints, "cx": cables[0].endpoint}
            received = dataclasses.replace(received, endpoints=endpoints)
        return hear(self, sender, received, now)

    monkeypatch.setattr(Conductor, "receive", rewired)
    try:
        outcome = play(
            (told_of(100), lambda _: cables[0].cut()),
            (gone_on({"dx", "cx"}, 200), lambda _: cables[0].mend()),
            (returned("dx", "cx"), nothing),
            clock="realtime",
            ways=reach(prepared(), "tcp"),
        )
    finally:
        for cable in cables:
            cable.remove()
    require_sound(outcome)
    assert cables[0].carried >= 2
    nodes = nodes_of(outcome)
    assert nodes["environment"]["incidents"]["frozen"] >= 200
    assert nodes["dx"]["incidents"]["released"] > 0
    assert nodes["cx"]["incidents"]["jumps"] >= 1


@pytest.mark.alone
def test_a_model_that_never_returns(monkeypatch: pytest.MonkeyPatch) -> None:
    """The devices let go, the display names the silent node, and Ctrl-C still ends the session."""
    monkeypatch.setenv("PYTHONPATH", search_path(HERE))
    monkeypatch.syspath_prepend(HERE)
    monkeypatch.setattr(supervisor_module, "ENDING_TIME", from_seconds(0.5))
    session = prepared(
        'environment={type: python, model: "endless:Endless", level: 0.1, parameters: {stiffness: 100, lasts: 300}}',
        "design={coupling: given, stiffness: 900, damping: 0.2}",
    )

    def everybody_free(progress: Progress) -> bool:
        return progress.silent == NODES

    outcome = play((everybody_free, nothing), clock="realtime", of=session)
    nodes = nodes_of(outcome)
    assert (outcome.code, outcome.faults) == (130, ())
    assert nodes.keys() == NODES - {"environment"}
    for device in ("dx", "dy"):
        assert nodes[device]["ticks"] <= 300
        assert nodes[device]["incidents"]["released"] > 0
        assert nodes[device]["ledger"]["margin"] >= PROMISE


def test_no_loop_reads_the_wall_clock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In every process the wall clock jumps by a year at each look, forth and back; the numbers stay the same."""
    (tmp_path / "sitecustomize.py").write_text(
        "import itertools, time\n"
        "jumps = itertools.cycle((-1, 1, 1, -1))\n"
        "truth, year = time.time_ns, 365 * 86_400 * 10**9\n"
        "time.time_ns = lambda: truth() + next(jumps) * year\n"
        "time.time = lambda: time.time_ns() / 1e9\n"
    )
    logs = tmp_path / "log"
    logs.mkdir()
    monkeypatch.setenv("PYTHONPATH", search_path(tmp_path))
    ticks = 200
    supervisor = supervisor_module.Supervisor(
        prepared(), clock="simulated", reach=reach(prepared(), "ipc"), ticks=ticks, record=True, logs=logs
    )
    outcome = supervisor.run()
    require_sound(outcome, 0)
    np.testing.assert_array_equal(recording_of(outcome).f_v, simulated(ticks))
    years = set(re.findall(r'"(\d{4})-\d\d-\d\dT', "".join(path.read_text() for path in logs.iterdir())))
    assert len(years) >= 2  # the clocks did jump


def search_path(folder: Path) -> str:
    """The given folder first, then Python's usual search path."""
    return os.pathsep.join([str(folder), *filter(None, [os.environ.get("PYTHONPATH")])])
