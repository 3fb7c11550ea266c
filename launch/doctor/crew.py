"""The processes of the probe: started, talked to in lines of JSON, and none of them left, however the probe ends.

As with the nodes of a session: each in a session of its own, so that Ctrl-C reaches the doctor alone, with the parent's
death as its own end, watched through its descriptors, killed and reaped on the way out.
"""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from manyhands.launch.interrupt import Interrupt
from manyhands.protocol.clock import Clock, Duration, Instant

MAX_LINE_BYTES = 64 * 2**20  # ten minutes of ticks at 4 kHz take half of it
_READ_BYTES = 2**16
_LOG_SHOWN = 2000  # characters of a process's own error output that a message quotes


class ProbeFailed(Exception):
    """The probe could not be done; says which process did what."""


class Interrupted(Exception):
    """The user wants no more of it.

    Attributes:
        signal: how that was said.
    """

    def __init__(self, which: signal.Signals) -> None:
        super().__init__(which)
        self.signal = which


class Crew:
    """The processes of one measurement; entered, it has none, and left, none again."""

    def __init__(self, directory: Path, interrupt: Interrupt, clock: Clock) -> None:
        """Make a crew of nobody.

        Args:
            directory: for what the processes write to their error output.
            interrupt: entered; ends every wait.
            clock: a realtime one, for deadlines.
        """
        self._directory, self._interrupt, self._clock = directory, interrupt, clock
        self._members: dict[str, subprocess.Popen[bytes]] = {}
        self._unread: dict[str, bytes] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for process in self._members.values():
            process.kill()
        for process in self._members.values():
            process.wait()
            for pipe in (process.stdin, process.stdout):
                if pipe is not None:
                    pipe.close()
        self._members.clear()

    def start(self, name: str, processor: int | None) -> None:
        """Start a process that waits for its task, on one processor if that is given."""
        with (self._directory / f"{name}.log").open("wb") as log:
            process = subprocess.Popen(  # noqa: S603 -- our own interpreter and module, no shell
                [sys.executable, "-P", "-m", "manyhands.launch.doctor.part", str(os.getpid())],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                bufsize=0,
                start_new_session=True,
            )
        self._members[name] = process
        self._unread[name] = b""
        if processor is not None:
            os.sched_setaffinity(process.pid, {processor})  # it is not reaped yet, so it is there

    def tell(self, name: str, message: Mapping[str, Any]) -> None:
        """Send a line to one process.

        Raises:
            ProbeFailed: it has ended.
        """
        pipe = self._members[name].stdin
        if pipe is None:
            raise ProbeFailed(f"{name}: has no standard input")
        try:
            pipe.write(json.dumps(message).encode() + b"\n")
        except BrokenPipeError:
            raise self._ended(name) from None

    def hear_all(self, within: Duration) -> dict[str, dict[str, Any]]:
        """A line from every process.

        Raises:
            Interrupted: on Ctrl-C.
            ProbeFailed: one of them has ended, or not answered ``within`` this time.
        """
        heard: dict[str, dict[str, Any]] = {}
        deadline = Instant(self._clock.now() + within)
        while heard.keys() != self._members.keys():
            awaited = [name for name in self._members if name not in heard]
            ready = self._wait(awaited, deadline)
            if not ready:
                raise ProbeFailed(f"{', '.join(awaited)}: no answer within {within / 1e9:g} s; see what else runs here")
            for name in ready:
                if (line := self._line(name)) is not None:
                    heard[name] = json.loads(line)
        return heard

    def _wait(self, names: Iterable[str], deadline: Instant) -> list[str]:
        """Those of ``names`` that have written something, or ended; none when the deadline has passed."""
        outputs = {pipe.fileno(): name for name in names if (pipe := self._members[name].stdout) is not None}
        poll = select.poll()
        for fd in (*outputs, self._interrupt.fd):
            poll.register(fd, select.POLLIN)
        found = poll.poll(max(deadline - self._clock.now(), 0) / 1e6)
        if self._interrupt.signal is not None:
            raise Interrupted(self._interrupt.signal)
        return [outputs[fd] for fd, _ in found if fd in outputs]

    def _line(self, name: str) -> bytes | None:
        """The next line of a process that has written something; None while it is not whole."""
        pipe = self._members[name].stdout
        more = b"" if pipe is None else os.read(pipe.fileno(), _READ_BYTES)
        if not more:
            raise self._ended(name)
        self._unread[name] += more
        if len(self._unread[name]) > MAX_LINE_BYTES:
            raise ProbeFailed(f"{name}: found a line of more than {MAX_LINE_BYTES} bytes")
        line, end, rest = self._unread[name].partition(b"\n")
        if not end:
            return None
        self._unread[name] = rest
        return line

    def _ended(self, name: str) -> ProbeFailed:
        code = self._members[name].wait()
        wrote = (self._directory / f"{name}.log").read_text(errors="replace").strip()[-_LOG_SHOWN:]
        return ProbeFailed(
            f"{name}: ended with {code} before it had answered" + (f"; it wrote:\n{wrote}" if wrote else "")
        )
