"""Child processes and signals: the supervisor keeps a session's nodes here, a recording its recorder, the doctor its
probe.

:class:`Processes` starts processes, watches them through process file descriptors, ends and reaps them. Nothing else in
the product starts one.

:class:`EndRequest` wakes a poll by a file descriptor when a run is to end. :class:`Interrupt` is the one that Ctrl-C,
SIGTERM and the other signals of a terminal make. It raises no exception. One raised by a signal handler can surface
between any two instructions, even after a process has started and before it is noted here. So while processes run, a
request to end is a flag.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import FrameType, TracebackType
from typing import Self

from manyhands.nodes.kernel.lifetime import terminal_signals
from manyhands.protocol.messages import Role

_LOG_SHOWN = 2000  # characters of a process's error output that a message quotes

# Matrices of a few rows gain nothing from threads, and idle BLAS threads would take processor time from the loop.
ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")


class Processes:
    """Child processes by name; several names may share one process."""

    def __init__(self, directory: Path) -> None:
        """A keeper without processes; ``directory`` holds their logs and the sockets of nodes."""
        self._directory = directory
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._fds: dict[int, tuple[str, ...]] = {}
        self._logged: dict[str, int] = {}  # by name, the length of its log before its latest process

    @property
    def fds(self) -> tuple[int, ...]:
        """File descriptors that become readable when their process ends."""
        return tuple(self._fds)

    @property
    def pids(self) -> Mapping[str, int]:
        """Process ids of the processes that still run, by name."""
        return {name: process.pid for name, process in self._running.items()}

    def start(self, nodes: Sequence[str], role: Role, bundles: Sequence[Path], processor: int | None = None) -> None:
        """Start a node, and the nodes that share its process.

        Args:
            nodes: the node, whose name the log has, and those that its process carries.
            role: the node's.
            bundles: one bundle file for each.
            processor: the processor to run on; any by default.

        Raises:
            OSError: the process cannot be started.
        """
        for node in nodes:
            self._sweep(node)
        self.spawn(nodes, f"manyhands.nodes.{role.value}", list(map(str, bundles)), processor)

    def spawn(
        self,
        names: Sequence[str],
        module: str,
        arguments: Sequence[str],
        processor: int | None = None,
        output: int | None = None,
    ) -> None:
        """Start ``python -m MODULE FIRST PARENT_PID OTHERS...``; its log is appended to that of an earlier process.

        The process has a session of its own, so that Ctrl-C in a terminal reaches the parent alone.

        Args:
            names: of the process; the first names its log.
            module: the module to run.
            arguments: FIRST and OTHERS.
            processor: the processor to run on; any by default.
            output: the file descriptor of its standard output; by default its log.

        Raises:
            OSError: the process cannot be started.
        """
        first, *others = arguments
        with (self._directory / f"{names[0]}.log").open("ab") as log:
            self._logged[names[0]] = log.tell()
            process = subprocess.Popen(  # noqa: S603 -- our own interpreter and module, no shell
                [sys.executable, "-P", "-m", module, first, str(os.getpid()), *others],
                stdin=subprocess.DEVNULL,
                stdout=log if output is None else output,
                stderr=log,
                start_new_session=True,
                env={**os.environ, **ONE_THREAD},
            )
        self._keep(names, process)
        if processor is not None:
            with contextlib.suppress(ProcessLookupError):  # it has ended already, which its descriptor reports
                os.sched_setaffinity(process.pid, {processor})  # before it starts threads, which inherit it

    def start_elsewhere(self, node: str, command: Sequence[str], given: bytes) -> None:
        """Start a command that runs a node on another machine; its log is appended to that of an earlier process.

        Its standard input stays open for as long as this process and the command live.

        Args:
            node: the node's name.
            command: the command and its arguments.
            given: what it reads first from its standard input.

        Raises:
            OSError: the process cannot be started.
        """
        with (self._directory / f"{node}.log").open("ab") as log:
            process = subprocess.Popen(  # noqa: S603 -- ssh, without a shell on this machine
                command, stdin=subprocess.PIPE, stdout=log, stderr=log, start_new_session=True, bufsize=0
            )
        if process.stdin is not None:
            descriptor = os.dup(process.stdin.fileno())
            threading.Thread(target=_hand_over, args=(descriptor, given), daemon=True).start()
        self._keep([node], process)

    def _keep(self, names: Sequence[str], process: subprocess.Popen[bytes]) -> None:
        self._running.update(dict.fromkeys(names, process))
        self._fds[os.pidfd_open(process.pid)] = tuple(names)

    def reap(self, fds: set[int]) -> dict[str, int]:
        """Reap the processes behind the readable ``fds``; returns exit codes by name (negative: killed by that
        signal).
        """
        out = {}
        for fd in fds & self._fds.keys():
            nodes = self._fds.pop(fd)
            os.close(fd)
            ended = {name: self._running.pop(name) for name in nodes}
            out.update({name: process.wait() for name, process in ended.items()})
            for process in ended.values():
                _close_input(process)
        return out

    def send(self, which: signal.Signals) -> None:
        """Send a signal to every process that still runs."""
        for process in set(self._running.values()):
            process.send_signal(which)

    def await_all(self, seconds: float) -> None:
        """Wait until every process has ended, at most ``seconds``; :meth:`end_all` kills the others."""
        deadline = time.monotonic() + seconds
        while self._fds and (left := deadline - time.monotonic()) > 0.0:
            self.reap(set(select.select(self.fds, [], [], left)[0]))

    def _sweep(self, name: str) -> None:
        """Remove the sockets that a killed process has left: it binds ``NAME-PEER``, and no name contains a hyphen."""
        for path in self._directory.glob(f"{name}-*"):
            if path.is_socket():
                path.unlink()

    def kill(self, name: str) -> None:
        """Kill one process if it still runs; its end is reported like any other."""
        if name in self._running:
            self._running[name].send_signal(signal.SIGKILL)

    def end_all(self) -> None:
        """Kill and reap every process that still runs; for the way out after an error."""
        self.send(signal.SIGKILL)
        for process in self._running.values():
            process.wait()
            _close_input(process)
        for fd in self._fds:
            os.close(fd)
        self._running.clear()
        self._fds.clear()

    def log(self, name: str) -> str:
        """The end of a process's error output; empty if there is none, or if the process runs elsewhere."""
        path = self._directory / f"{name}.log"
        return path.read_text(errors="replace").strip()[-_LOG_SHOWN:] if path.exists() else ""

    def last_words(self, name: str) -> str:
        """The last line of a process's error output; empty if its latest process wrote none."""
        if name not in self._logged:
            return ""
        with (self._directory / f"{name}.log").open("rb") as log:
            log.seek(max(self._logged[name], log.seek(0, os.SEEK_END) - _LOG_SHOWN))  # it may be of any size
            said = log.read(_LOG_SHOWN).decode(errors="replace").strip()
        return said.rpartition("\n")[2][:_LOG_SHOWN]


def _hand_over(descriptor: int, content: bytes) -> None:
    """Write all of it to a pipe, through a descriptor of this thread's own, for the other may be closed meanwhile."""
    left = memoryview(content)
    try:
        while left:
            left = left[os.write(descriptor, left) :]
    except BrokenPipeError:  # the process has ended, which its own descriptor reports
        return
    finally:
        os.close(descriptor)


def _close_input(process: subprocess.Popen[bytes]) -> None:
    if process.stdin is not None:
        process.stdin.close()


_Handler = Callable[[int, FrameType | None], object] | int | None


class EndRequest:
    """A request to end what a poll waits for: it sets :attr:`signal` and makes :attr:`fd` readable.

    Attributes:
        signal: the signal that a request stands for; None before there is one.
        fd: the file descriptor to wait on while entered.
    """

    def __init__(self) -> None:
        self.signal: signal.Signals | None = None
        self.fd = self._write = -1
        self._open = threading.Lock()  # held to write, so that no other file that got the number is written to

    def __enter__(self) -> Self:
        with self._open:
            self.fd, self._write = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
            if self.signal is not None:
                os.write(self._write, b"\0")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._open:
            os.close(self.fd)
            os.close(self._write)
            self.fd = self._write = -1

    def ask(self) -> None:
        """Request the end, from any thread; a second request asks for it at once. After the end it does nothing."""
        with self._open:
            self.signal = signal.SIGINT
            if self._write >= 0:
                os.write(self._write, b"\0")

    def clear(self) -> None:
        """Empty the pipe, so that :attr:`fd` wakes a poll only for the next request."""
        try:
            while os.read(self.fd, 256):
                continue
        except BlockingIOError:
            return


class Interrupt(EndRequest):
    """While entered, SIGINT, SIGTERM, SIGHUP and SIGQUIT are requests to end. Only a main thread can enter it.

    SIGHUP stays ignored if it was ignored before, as under nohup.
    """

    def __init__(self) -> None:
        super().__init__()
        self._before: dict[signal.Signals, _Handler] = {}
        self._fd_before = -1

    def __enter__(self) -> Self:
        super().__enter__()
        self._fd_before = signal.set_wakeup_fd(self._write, warn_on_full_buffer=False)
        for which in (signal.SIGINT, signal.SIGTERM, *terminal_signals()):
            self._before[which] = signal.signal(which, self._note)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for which, handler in self._before.items():
            signal.signal(which, handler)
        signal.set_wakeup_fd(self._fd_before)
        super().__exit__(kind, error, trace)

    def _note(self, number: int, _frame: FrameType | None) -> None:
        self.signal = signal.Signals(number)
