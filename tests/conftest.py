"""What every test runs under: no test may leave a process, thread, socket, file descriptor or run directory behind."""

from __future__ import annotations

import os
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path

import hypothesis
import pytest

hypothesis.settings.register_profile(
    "repeatable",
    derandomize=True,  # the same cases on every machine: a red run can be repeated
    deadline=None,  # timings are benchmarks, not tests
    suppress_health_check=[hypothesis.HealthCheck.too_slow, hypothesis.HealthCheck.function_scoped_fixture],
    database=None,
)
hypothesis.settings.load_profile("repeatable")


def _descriptors() -> dict[int, str]:
    """This process's open file descriptors and what they lead to."""
    found = {}
    for fd in os.listdir("/proc/self/fd"):
        try:
            found[int(fd)] = os.readlink(f"/proc/self/fd/{fd}")
        except FileNotFoundError:
            continue  # the descriptor of the listing itself
    return found


def _children() -> set[int]:
    """Process ids of all descendants, however they were started."""
    parents = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                stat = (entry / "stat").read_text()
            except (FileNotFoundError, ProcessLookupError):
                continue
            parents[int(entry.name)] = int(stat.rsplit(")", 1)[1].split()[1])
    ours = {os.getpid()}
    while more := {pid for pid, parent in parents.items() if parent in ours} - ours:
        ours |= more
    return ours - {os.getpid()}


def _run_directories() -> set[str]:
    return {path.name for path in Path(tempfile.gettempdir()).glob("manyhands-*")}


@pytest.fixture(autouse=True)
def leaves_nothing_behind() -> Iterator[None]:
    """Fail the test that leaves something behind."""
    threads = set(threading.enumerate())
    descriptors = _descriptors()
    children, directories = _children(), _run_directories()
    yield
    left = [f"thread {t.name}" for t in set(threading.enumerate()) - threads]
    left += [f"process {pid}" for pid in _children() - children]
    left += [f"directory {name}" for name in _run_directories() - directories]
    left += [
        f"descriptor {fd} -> {target}"
        for fd, target in _descriptors().items()
        if fd not in descriptors
    ]
    assert not left, f"the test left behind: {', '.join(left)}"
