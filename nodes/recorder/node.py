"""The recorder's process: what its supervisor tells it goes to the disk, twice a second.

Writing and syncing take as long as the disk takes, milliseconds or seconds: that is why this is nobody's loop. The
supervisor keeps what it has not taken in yet, within bounds, and hears of every frame that was. The recorder ends when
it is told that the session is over, when it cannot write any more, or when the supervisor is gone; the file then has
all that was taken in before, unless it was killed, which costs less than a second.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from typing import Final

from manyhands.nodes.life import Life
from manyhands.nodes.process import EXIT_FAILED, EXIT_OK
from manyhands.nodes.recorder.core import RecorderCore
from manyhands.nodes.recorder.file import RecordingFile
from manyhands.nodes.recorder.plan import Plan
from manyhands.nodes.recorder.status import Closed, Ready, Status, Stopped, Taken, encode
from manyhands.protocol.clock import Clock, Duration, Instant, from_seconds
from manyhands.protocol.messages import presentable
from manyhands.protocol.transport import Link, TransportError
from manyhands.protocol.transport.zeromq import HUB, ZmqTransport

FLUSH_EVERY: Final = from_seconds(0.5)
"""So that a recorder that is killed costs no second, what was under way to it included."""

TAKEN_EVERY: Final = 32
"""Frames after which they are said to be taken, though more are waiting."""

NICENESS: Final = 10  # the loop's processes come first on a busy machine: being late costs nothing here
_PATIENCE: Final = from_seconds(0.1)

Say = Callable[[Status], None]


def to_pipe(fd: int) -> Say:
    """A way to tell the supervisor, over its pipe; one that is gone hears nothing, and ``Life`` finds out."""

    def say(status: Status) -> None:
        try:
            os.write(fd, encode(status))
        except BrokenPipeError:
            return

    return say


def record(plan: Plan, life: Life, clock: Clock, say: Say) -> int:
    """Record until the session is over, or nothing more can be written; returns the exit code."""
    os.nice(NICENESS)
    core = RecorderCore(plan.recorded, plan.attachments, plan.started)
    try:
        file = RecordingFile(plan.file, core.cut())
    except OSError as error:
        return _stopped(say, _reason(error), 0)
    transport = ZmqTransport.ipc(plan.directory)
    try:
        link, endpoint = transport.bind("recorder", HUB)
        say(Ready(endpoint))
        return _Recording(core, file, link, clock, say).run(life)
    except TransportError as error:
        return _stopped(say, str(error), 0)
    finally:
        transport.close()
        file.close()


class _Recording:
    """A file being written."""

    def __init__(self, core: RecorderCore, file: RecordingFile, link: Link, clock: Clock, say: Say) -> None:
        self._core, self._file, self._link, self._clock, self._say = core, file, link, clock, say
        self._taken = self._told = 0
        self._tick = 0  # up to which it is on the disk

    def run(self, life: Life) -> int:
        """Take in, write, say so, until the end."""
        core, clock = self._core, self._clock
        due = Instant(clock.now() + FLUSH_EVERY)
        try:
            while not core.over:
                frame = self._link.recv(Duration(0))
                if frame is None:
                    self._tell()
                    if life.stopping:  # and all that came before has been taken in
                        break
                    frame = self._link.recv(Duration(min(_PATIENCE, max(due - clock.now(), 1))))
                if frame is not None:
                    core.take(frame, time.time_ns())
                    self._taken += 1
                    if self._taken - self._told >= TAKEN_EVERY:
                        self._tell()
                life.look(clock.now())
                if core.full or clock.now() >= due:
                    self._write(core.cut())
                    due = Instant(clock.now() + FLUSH_EVERY)
            self._write(core.cut())
            self._write(core.end())
        except OSError as error:
            return _stopped(self._say, _reason(error), self._tick)
        self._say(Closed(core.missing_in_all, core.tick))
        return EXIT_OK

    def _tell(self) -> None:
        if self._taken > self._told:
            self._told = self._taken
            self._say(Taken(self._taken))

    def _write(self, piece: bytes) -> None:
        if piece:
            self._file.append(piece)
            self._tick = self._core.tick


def _reason(error: OSError) -> str:
    return error.strerror or str(error)


def _stopped(say: Say, why: str, tick: int) -> int:
    text = presentable(why)
    say(Stopped(text, tick))
    print(f"recording stopped at tick {tick}: {text}", file=sys.stderr)  # noqa: T201 -- the process's own error channel
    return EXIT_FAILED
