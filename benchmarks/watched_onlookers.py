"""The onlookers of a running session, started as a user does; each is ended with all that it has started."""

from __future__ import annotations

import fcntl
import os
import pty
import select
import signal
import struct
import subprocess
import termios
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from urllib.parse import urlsplit

import proc
from loop_ours import MANYHANDS
from loop_runs import Failed
from watched_figures import PAGE, RECORDER, TOP

CHROMIUM = "/usr/bin/chromium"
_CHROMIUM_OPTIONS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
_PATIENCE = 60.0  # s, for one of them to be there
_ENDING = 10.0  # s, for one of them to end when it is asked to
_LINES, _COLUMNS = 40, 160  # of the terminal
_ESTABLISHED = "01"  # in /proc/net/tcp


class Onlookers:
    """All that look on: their processes, and the terminal that has to be read meanwhile."""

    def __init__(self) -> None:
        self._roots: list[int] = []
        self._terminal: int | None = None

    def pids(self) -> list[int]:
        """Every process of theirs."""
        return [pid for root in self._roots for pid in proc.family(root)]

    def add(self, pid: int) -> None:
        """One more process that looks on, with all that it starts."""
        self._roots.append(pid)

    def show(self, terminal: int) -> None:
        """Read the output on this terminal, as a person before it does."""
        self._terminal = terminal

    def read(self) -> int:
        """Take from the terminal what there is; returns how many bytes."""
        taken = 0
        while self._terminal is not None and select.select([self._terminal], [], [], 0.0)[0]:
            try:
                taken += len(os.read(self._terminal, 65536))
            except OSError:  # the other end has closed it
                self._terminal = None
        return taken

    @contextmanager
    def stopped(self) -> Iterator[None]:
        """Stop them all where they stand, and let them go on afterwards."""
        pids = self.pids()
        try:
            for pid in pids:
                os.kill(pid, signal.SIGSTOP)
            yield
        finally:
            for pid in pids:
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGCONT)


@contextmanager
def looking_on(names: tuple[str, ...], launch: int, folder: Path) -> Iterator[Onlookers]:
    """Have ``names`` look on at the session that process ``launch`` runs; all are there when the body begins.

    The recorder has been started by ``launch`` itself.

    Raises:
        Failed: one of them is not there in time.
    """
    with ExitStack() as stack:
        onlookers = Onlookers()
        if RECORDER in names:
            onlookers.add(_recorder(launch))
        if TOP in names:
            stack.enter_context(_top(launch, onlookers))
        if PAGE in names:
            port, address = stack.enter_context(_page(launch, onlookers))
            stack.enter_context(_chromium(address, port, folder, onlookers))
        yield onlookers


def _recorder(launch: int) -> int:
    for pid in proc.family(launch):
        if "manyhands.nodes.recorder" in proc.arguments(pid):
            return pid
    raise Failed("found no recorder among the session's processes")


@contextmanager
def _top(launch: int, onlookers: Onlookers) -> Iterator[None]:
    """``manyhands top`` on a terminal of its own."""
    ours, its = pty.openpty()
    fcntl.ioctl(its, termios.TIOCSWINSZ, struct.pack("HHHH", _LINES, _COLUMNS, 0, 0))
    try:
        with _started([*MANYHANDS, "top", "--running", str(launch)], signal.SIGINT, terminal=its) as process:
            onlookers.add(process.pid)
            onlookers.show(ours)
            _await(lambda: onlookers.read() > 0, process, "top shows nothing")
            yield
            onlookers.read()
    finally:
        os.close(its)
        os.close(ours)


@contextmanager
def _page(launch: int, onlookers: Onlookers) -> Iterator[tuple[int, str]]:
    """``manyhands view``; its port and address."""
    command = [*MANYHANDS, "view", "--running", str(launch), "--port", "0", "--no-open"]
    with _started(command, signal.SIGINT, stderr=subprocess.PIPE) as process:
        onlookers.add(process.pid)
        said = ""
        for line in process.stderr or ():
            said += line
            if line.startswith("page: "):
                address = line.removeprefix("page: ").strip()
                break
        else:
            raise Failed(f"view ended before it served a page:\n{said}")
        yield urlsplit(address).port or 80, address


@contextmanager
def _chromium(address: str, port: int, folder: Path, onlookers: Onlookers) -> Iterator[None]:
    """Chromium, without a screen, on the page."""
    command = [CHROMIUM, *_CHROMIUM_OPTIONS, f"--user-data-dir={folder / 'chromium'}", address]
    with _started(command, signal.SIGTERM) as process:
        onlookers.add(process.pid)
        _await(lambda: _is_connected(port), process, "Chromium does not open the page")
        yield


def _is_connected(port: int) -> bool:
    """Whether this port of this machine has a connection."""
    fields = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    return any(int(of[1].split(":")[1], 16) == port and of[3] == _ESTABLISHED for of in fields)


def _await(there: Callable[[], bool], process: subprocess.Popen[str], otherwise: str) -> None:
    deadline = time.monotonic() + _PATIENCE
    while not there():
        if process.poll() is not None or time.monotonic() > deadline:
            raise Failed(f"{otherwise}; its exit code: {process.returncode}")
        time.sleep(0.05)


@contextmanager
def _started(
    command: list[str], ending: signal.Signals, terminal: int | None = None, stderr: int = subprocess.DEVNULL
) -> Iterator[subprocess.Popen[str]]:
    """A process in a group of its own, which is ended whole: asked to by ``ending``, and at last killed."""
    streams = subprocess.DEVNULL if terminal is None else terminal
    process = subprocess.Popen(  # noqa: S603 -- our own commands, and the browser
        command,
        stdin=streams,
        stdout=streams,
        stderr=stderr if terminal is None else terminal,
        text=True,
        start_new_session=True,
        env={**os.environ, "TERM": "xterm-256color"},
    )
    try:
        yield process
    finally:
        process.send_signal(ending)
        with suppress(subprocess.TimeoutExpired):  # killed then, with what it has started
            process.wait(_ENDING)
        with suppress(ProcessLookupError):  # no process is left
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        if process.stderr is not None:
            process.stderr.close()
