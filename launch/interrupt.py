"""Ctrl-C, SIGTERM and what else a terminal sends, noted rather than raised, and a file descriptor that wakes a poll.

An exception out of a signal handler can surface between any two instructions, a process just started and not
yet written down among them. While processes run, the request is a flag.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from types import FrameType, TracebackType
from typing import Self

from manyhands.nodes.life import terminal_signals

_Handler = Callable[[int, FrameType | None], object] | int | None


class Interrupt:
    """While entered, SIGINT, SIGTERM, SIGHUP and SIGQUIT set :attr:`signal` and make :attr:`fd` readable.

    SIGHUP stays ignored where it was, as under nohup.
    """

    def __init__(self) -> None:
        self.signal: signal.Signals | None = None
        self.fd, self._write = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        self._before: dict[signal.Signals, _Handler] = {}
        self._fd_before = -1

    def __enter__(self) -> Self:
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
        os.close(self.fd)
        os.close(self._write)

    def clear(self) -> None:
        """Empty the pipe, so that :attr:`fd` wakes a poll only for what comes next."""
        try:
            while os.read(self.fd, 256):
                continue
        except BlockingIOError:
            return

    def _note(self, number: int, _frame: FrameType | None) -> None:
        self.signal = signal.Signals(number)
