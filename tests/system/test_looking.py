"""Observing a running session: every command, its ends, and no effect of an observer on the session."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from ..support.commands import Command, manyhands_command, read_until

ROLES = {"d": "device", "cx": "coupling", "cy": "coupling", "cz": "coupling", "environment": "environment"}
PERIOD = 0.005  # s; observers see no more at 1 kHz, and on a machine with little time the session takes it from them
END = 60.0  # s, of patience with a process that is about to end

pytestmark = pytest.mark.usefixtures("own_interrupt")


@pytest.fixture(scope="module")
def session() -> Iterator[subprocess.Popen[str]]:
    """One session for all tests, in a temporary directory of its own; observers have to look there."""
    folder = tempfile.mkdtemp(prefix="mh", dir="/tmp")
    command = [
        "launch",
        "example1-operator.yaml",
        "--set",
        "design.tau=0",
        "--set",
        "colocate=false",  # whatever processors there are: links between devices and couplings are looked at
        "--set",
        f"period={PERIOD}",
        "--set",
        "observers={scope: {reads: [cx/tool]}}",
    ]
    with Command(
        command, env={**os.environ, "TMPDIR": folder}, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    ) as process:
        process.folder = folder  # type: ignore[attr-defined]  # where it runs
        try:
            read_until(process, ": running")
            yield process
        finally:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
                process.communicate(timeout=END)
    left = os.listdir(folder)
    shutil.rmtree(folder)
    assert left == []


@pytest.fixture(autouse=True)
def look_there(session: subprocess.Popen[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Temporary files are where the session's are, in this process and those that it starts."""
    folder: str = session.folder  # type: ignore[attr-defined]
    monkeypatch.setenv("TMPDIR", folder)
    monkeypatch.setattr(tempfile, "tempdir", folder)


def looked(*arguments: object) -> str:
    """What a command prints that ends by itself."""
    done = manyhands_command(*arguments)
    assert done.exit_code == 0, done.stderr
    return done.stdout


def looked_json(*arguments: object) -> Any:
    return json.loads(looked(*arguments))


def settled(*arguments: object, key: str) -> Any:
    """Repeat the command until ``key`` is known: on a busy machine one look may see nothing."""
    for _ in range(40):
        said = looked_json(*arguments)
        (one,) = said if isinstance(said, list) else [said]
        if one[key] is not None:
            return one
    pytest.fail(f"{arguments} never knew its {key}")


@contextmanager
def onlooker(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    """An observing command in a process of its own."""
    with Command(arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            if process.poll() is None:
                process.kill()


def test_list(session: subprocess.Popen[str]) -> None:
    said = settled("top", "--all", "--json", key="phase")
    assert (said["session"], said["pid"], said["clock"]) == ("example-1-operator", session.pid, "realtime")
    assert said["phase"] == "running"
    assert {name: node["role"] for name, node in said["nodes"].items()} == ROLES
    text = looked("top", "--all")
    assert "running sessions" in text
    assert "environment" in text


def test_graph(tmp_path: Path) -> None:
    said = looked_json("graph", "--running", "example-1-operator", "--json")
    assert {name: node["role"] for name, node in said["nodes"].items()} == ROLES
    assert said["observers"] == {"scope": {"reads": ["cx/tool"]}}
    assert len(said["links"]) == 6
    assert all(link["health"] for link in said["links"])
    assert looked("graph", "--running", "example-1-operator", "-o", tmp_path / "g.svg") == ""
    assert ET.parse(tmp_path / "g.svg").getroot().tag == "{http://www.w3.org/2000/svg}svg"


def test_echo_prints_consecutive_ticks(session: subprocess.Popen[str]) -> None:
    lines = [json.loads(line) for line in looked("echo", "d/sample", "-n", 30, "--running", session.pid).splitlines()]
    ticks = [line["tick"] for line in lines]
    assert len(ticks) == 30
    assert ticks == sorted(set(ticks))  # each once; a device that was too late goes on at a later one
    assert all(len(line["x"]) == 3 and line["time"] == round(line["tick"] * PERIOD, 9) for line in lines)
    (figures,) = map(json.loads, looked("echo", "/example-1-operator/d/telemetry", "-n", 1).splitlines())
    assert {"late", "tau_us", "period_us", "ledger"} <= figures["figures"].keys()
    (condition,) = map(json.loads, looked("echo", "supervisor/condition", "-n", 1).splitlines())
    assert condition["phase"] == "running"
    assert condition["states"] == dict.fromkeys(ROLES, "running")


def test_hz() -> None:
    said = settled("hz", "d/force", "--duration", "1.5", "--json", key="rate")
    assert said["topic"] == "/example-1-operator/d/force"
    assert said["window"] > 0
    assert {"p50", "p99"} <= said["period_us"].keys()
    assert {"p50", "p99", "max"} <= said["tau_us"].keys()


def test_top() -> None:
    said = looked_json("top", "--once", "--json")
    assert said["nodes"].keys() == ROLES.keys()
    assert len(said["links"]) == 6
    assert "example-1-operator (process " in looked("top", "--once")


def test_observers_end_freely_and_a_stalled_one_changes_nothing(session: subprocess.Popen[str]) -> None:
    """At the end of the session its last observer ends by itself, and the session ends as if unobserved."""
    with (
        onlooker("echo", "d/sample") as leaves,
        onlooker("hz", "d/sample") as interrupted,
        onlooker("echo", "environment/tools") as stalled,
        onlooker("echo", "supervisor/condition") as stays,
    ):
        for process in (leaves, interrupted, stalled, stays):
            assert process.stdout is not None
            assert process.stdout.readline()
        stalled.send_signal(signal.SIGSTOP)
        assert leaves.stdout is not None
        leaves.stdout.close()  # as head does
        assert leaves.wait(END) == 0
        assert leaves.stderr is not None
        assert leaves.stderr.read() == ""
        interrupted.send_signal(signal.SIGINT)
        out, errors = interrupted.communicate(timeout=END)
        assert (interrupted.returncode, errors) == (130, "")
        assert "missing" in out.splitlines()[-1]
        first, second = (int(json.loads(looked("echo", "d/sample", "-n", 1))["tick"]) for _ in range(2))
        assert second > first  # it goes on
        session.send_signal(signal.SIGINT)
        session.communicate(timeout=END)
        assert session.returncode == 130
        conditions, errors = stays.communicate(timeout=END)
        assert (stays.returncode, errors) == (0, "")
        assert json.loads(conditions.splitlines()[-1])["phase"] in ("ending", "over", "running")
        stalled.send_signal(signal.SIGCONT)
        out, errors = stalled.communicate(timeout=END)
        assert (stalled.returncode, errors) == (0, "")
