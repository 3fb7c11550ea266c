"""The memory of another process: while it runs, and at its end, before the kernel frees it.

ptrace stops the process at any time, and at its end (PTRACE_EVENT_EXIT), when it has done all its work and its memory
is still there.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType

from .capture import missing
from .patterns import Patterns

_PIECE = 2**18  # bytes read at once
_PATIENCE = 60.0  # s until a process that was to stop, or end, is given up

# linux/ptrace.h
_CONT, _DETACH, _SEIZE, _INTERRUPT, _LISTEN = 7, 17, 0x4206, 0x4207, 0x4208
_OPTION_TRACE_EXIT = 0x40
_EVENT_EXIT, _EVENT_STOP = 6, 128
_WALL = 0x40000000  # waitpid's __WALL: also for a process that is not our child

_KERNELS_OWN = ("[vvar]", "[vvar_vclock]", "[vsyscall]")  # the same in every process, and cannot be read


class CannotTrace(Exception):
    """This machine does not let one process hold another."""


def memory_contains(pid: int, patterns: Patterns) -> set[str]:
    """The names of those ``patterns`` that occur anywhere in a process's readable memory.

    In a process that is not held, the search may miss data that moves meanwhile.

    Raises:
        OSError: its memory cannot be read.
    """
    found: set[str] = set()
    with Path(f"/proc/{pid}/mem").open("rb", buffering=0) as memory:
        for begin, end in _readable(pid):
            found |= patterns.found_in(_pieces(memory.fileno(), begin, end))
    return found


def _readable(pid: int) -> list[tuple[int, int]]:
    """The readable ranges of addresses; adjacent ones are joined."""
    out: list[tuple[int, int]] = []
    for line in Path(f"/proc/{pid}/maps").read_text().splitlines():
        addresses, rights, *rest = line.split(maxsplit=5)
        begin, end = (int(address, 16) for address in addresses.split("-"))
        if not rights.startswith("r") or rest[-1].strip() in _KERNELS_OWN:
            continue
        if out and out[-1][1] == begin:
            out[-1] = (out[-1][0], end)
        else:
            out.append((begin, end))
    return out


def _pieces(memory: int, begin: int, end: int) -> Iterator[bytes]:
    at = begin
    while at < end:
        try:
            piece = os.pread(memory, min(_PIECE, end - at), at)
        except OSError as error:
            if error.errno != errno.EIO:
                raise
            piece = b""
        if not piece:  # a page of a mapped file that lies behind the file's end: there is nothing in it
            piece = bytes(min(os.sysconf("SC_PAGE_SIZE"), end - at))
        yield piece
        at += len(piece)


class TracedProcess:
    """A process that a test can hold; use it as a context, in one thread.

    The process runs on until :meth:`hold`, and again after :meth:`resume`. A process that is still there at the end of
    the context runs on.
    """

    def __init__(self, pid: int) -> None:
        """``pid`` belongs to a process that we may trace: our own, or a descendant's."""
        self.pid = pid
        self.exit_status: int | None = None
        self._libc = ctypes.CDLL(None, use_errno=True)
        self._libc.ptrace.argtypes = (ctypes.c_long, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)
        self._libc.ptrace.restype = ctypes.c_long
        self._is_held = False

    def __enter__(self) -> TracedProcess:
        """Begin to watch the process.

        Raises:
            CannotTrace: not permitted here.
        """
        # its changes of state are waited for, not polled: with the signal blocked none is missed
        self._mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGCHLD})
        try:
            self._ask(_SEIZE, _OPTION_TRACE_EXIT)
        except OSError as error:
            signal.pthread_sigmask(signal.SIG_SETMASK, self._mask)
            raise CannotTrace(f"process {self.pid} cannot be traced: {error.strerror}") from error
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """Let the process go."""
        try:
            with contextlib.suppress(ProcessLookupError):  # it has ended meanwhile
                if self.exit_status is None:
                    if not self._is_held:
                        self.hold()
                    self._ask(_DETACH)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, self._mask)

    def hold(self) -> None:
        """Stop the process's main thread where it is.

        Raises:
            TimeoutError: it has not stopped.
        """
        self._ask(_INTERRUPT)
        self._wait_for(_EVENT_STOP)

    def resume(self) -> None:
        """Let the process run on."""
        self._is_held = False
        self._ask(_CONT)

    def hold_at_end(self) -> None:
        """Wait until the process is about to end, and hold it there.

        Raises:
            TimeoutError: it has not ended.
        """
        self._wait_for(_EVENT_EXIT)

    def let_end(self) -> int:
        """After :meth:`hold_at_end`: let it end, and return its exit code (negative: the signal that ended it)."""
        self.resume()
        status = self._next_change()
        assert os.WIFEXITED(status) or os.WIFSIGNALED(status)
        self.exit_status = os.waitstatus_to_exitcode(status)
        return self.exit_status

    def _wait_for(self, event: int) -> None:
        """Wait until ``event`` stops the process; other signals are passed on."""
        while True:
            status = self._next_change()
            if not os.WIFSTOPPED(status):
                self.exit_status = os.waitstatus_to_exitcode(status)
                raise ProcessLookupError(f"process {self.pid} ended with {self.exit_status}")
            happened = status >> 16
            if happened == event:
                self._is_held = True
                return
            # a signal on its way to the process is delivered; a stop by SIGSTOP and the like stays one
            self._ask(_LISTEN if happened == _EVENT_STOP else _CONT, 0 if happened else os.WSTOPSIG(status))

    def _next_change(self) -> int:
        deadline = time.monotonic() + _PATIENCE
        while True:
            pid, status = os.waitpid(self.pid, os.WNOHANG | _WALL)
            if pid:
                return status
            remaining = deadline - time.monotonic()
            if remaining <= 0:
                raise TimeoutError(f"process {self.pid}: nothing has happened for {_PATIENCE:g} s")
            signal.sigtimedwait({signal.SIGCHLD}, remaining)

    def _ask(self, request: int, data: int = 0) -> None:
        if self._libc.ptrace(request, self.pid, None, data) < 0:
            code = ctypes.get_errno()
            raise OSError(code, os.strerror(code))


@contextlib.contextmanager
def held(pid: int) -> Iterator[TracedProcess]:
    """Hold a process; skips or fails the test where that is not permitted, see :func:`.capture.missing`."""
    with contextlib.ExitStack() as stack:
        try:
            holding = stack.enter_context(TracedProcess(pid))
        except CannotTrace as error:
            missing(str(error))
        yield holding
