"""What every test runs under: no test may leave a process, thread, socket, file descriptor or file behind."""

from __future__ import annotations

import os
import shutil
import signal
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path

import hypothesis
import pytest
from hypothesis.internal.conjecture import providers

from .support import designs
from .support.cases import EXAMPLES, WIDE_EXAMPLES, cases

os.environ.pop("COLUMNS", None)  # xdist states one to its workers; pages and tests quote the width of a pipe

hypothesis.settings.register_profile(
    "repeatable",
    max_examples=cases(EXAMPLES, WIDE_EXAMPLES),
    derandomize=True,  # the same cases on every machine: a red run can be repeated
    deadline=None,  # timings are benchmarks, not tests
    suppress_health_check=[hypothesis.HealthCheck.too_slow, hypothesis.HealthCheck.function_scoped_fixture],
    database=None,
)
# for `make campaign`: other cases every time, so that a longer search finds what the repeatable cases do not
hypothesis.settings.register_profile(
    "campaign", parent=hypothesis.settings.get_profile("repeatable"), derandomize=False, print_blob=True
)
hypothesis.settings.load_profile("repeatable")

# Hypothesis draws constants that stand in whatever local modules happen to be loaded: cases then depend on which tests
# ran before in the same process, and on numbers in code that has nothing to do with the test. A red run could not be
# repeated by its test alone.
if hasattr(providers, "_get_local_constants"):
    providers._get_local_constants = lambda: providers._local_constants


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark every property of random cases as one that `make test-long` searches more widely.

    The suite of processes comes first: its files take longest, and at the end one worker would wait for the other.
    """
    items.sort(key=lambda item: "tests/system/" not in item.nodeid)
    for item in items:
        if isinstance(item, pytest.Function) and hypothesis.is_hypothesis_test(item.obj):
            item.add_marker(pytest.mark.wide)


SOLVER = ("tests/design/", "tests/attack/")
"""Whose tests ask the solver itself, as those that are marked ``solver`` do."""


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Before any fixture of the test: whether it may be given what another test had designed."""
    designs.serving = item.get_closest_marker("solver") is None and not item.nodeid.startswith(SOLVER)


@pytest.fixture(scope="session", autouse=True)
def designed_once() -> Iterator[None]:
    """One and the same design is asked of the solver once in a process of the tests."""
    with pytest.MonkeyPatch.context() as patch:
        designs.remember(patch)
        yield


@pytest.fixture(scope="session", autouse=True)
def folder_of_compiled(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """C code of the tests is compiled once in a process of theirs (tests/fakes/compiled.py)."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MANYHANDS_COMPILED", str(tmp_path_factory.mktemp("compiled")))
        yield


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
    found: set[int] = set()
    open_ = [os.getpid()]
    while open_:
        for children in Path(f"/proc/{open_.pop()}/task").glob("*/children"):
            try:
                pids = set(map(int, children.read_text().split()))
            except (FileNotFoundError, ProcessLookupError):
                continue
            open_ += pids - found
            found |= pids
    return found


@pytest.fixture(autouse=True)
def leaves_nothing_behind(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Fail the test that leaves something behind.

    Temporary files of the test and of every process it starts go into a folder of its own, with a short name, for
    a socket's path may not be long.
    """
    tmp_path_factory.getbasetemp()  # pytest's own folder is settled before the place of temporary files is moved
    folder = Path(tempfile.mkdtemp(prefix="mh"))
    monkeypatch.setenv("TMPDIR", str(folder))
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))  # no profile of the user's
    threads = set(threading.enumerate())
    descriptors = _descriptors()
    children = _children()
    yield
    started = set(threading.enumerate()) - threads
    for thread in started:
        thread.join(timeout=5.0)  # a thread that was asked to end may need a moment
    left = [f"thread {thread.name}" for thread in started if thread.is_alive()]
    left += [f"process {pid}" for pid in _children() - children]
    left += [f"file {path}" for path in folder.iterdir()]
    shutil.rmtree(folder)
    left += [
        f"descriptor {fd} -> {target}"
        for fd, target in _descriptors().items()
        if fd not in descriptors and not target.endswith(".ttf")  # matplotlib keeps the fonts it has drawn with open
    ]
    assert not left, f"the test left behind: {', '.join(left)}"


@pytest.fixture
def own_interrupt(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Restore Ctrl-C after a command within this process: it sets a handler, as if the process were its own.

    The test begins with no interrupt counted.
    """
    monkeypatch.setattr("manyhands.launch.app.cli.common.ctrl_c", [])
    before = signal.getsignal(signal.SIGINT)
    yield
    signal.signal(signal.SIGINT, before)
