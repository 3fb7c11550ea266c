"""The recorder's process: it writes the frames that its supervisor sends to the disk, twice a second.

Writing and syncing take milliseconds or seconds, as long as the disk takes, so no process of the loop does it. The
supervisor keeps frames that the recorder has not taken yet, within bounds, and learns how many were taken. The recorder
ends when the session is over, when it cannot write any more, or when the supervisor is gone. The file then has all that
was taken before. If the recorder is killed, less than a second is lost.

:class:`RecordingPlan` is what a recorder starts from: the file, the session, and the folder of its socket. Its statuses
go to the supervisor on a pipe of their own, one line of JSON each:

    {"kind": "ready", "endpoint": ENDPOINT}             the file is begun; observations are expected at this endpoint
    {"kind": "taken", "frames": N}                      N frames in all have been taken: there is room for others
    {"kind": "stopped", "text": TEXT, "tick": K}        nothing more can be written; readable up to tick K
    {"kind": "closed", "missing": {...}, "tick": K}     the file is complete; missing ticks by device

A recorder and its supervisor are of one version on one machine: these lines are no part of the protocol.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, TypeAlias

from manyhands.design.files import open_new
from manyhands.nodes.kernel.lifetime import Life
from manyhands.nodes.link.process import EXIT_FAILED, EXIT_OK
from manyhands.nodes.recorder.format import Recorded
from manyhands.protocol.clock import Clock, Duration, Instant, from_seconds
from manyhands.protocol.messages import presentable
from manyhands.protocol.plain import PlainForm, by_kind, read, written
from manyhands.protocol.transport import Link, TransportError
from manyhands.protocol.transport.zeromq import HUB, ZmqTransport

if TYPE_CHECKING:  # a supervisor that records nothing needs neither them nor their libraries
    from manyhands.nodes.recorder.core import RecorderCore
    from manyhands.nodes.recorder.mcap import RecordingFile


_PATH: Final = PlainForm(str, Path)


class PlanError(Exception):
    """A plan cannot be read; the message names the file and what is wrong."""


@dataclass(frozen=True)
class RecordingPlan:
    """A recorder's plan.

    Attributes:
        file: the recording, absolute.
        directory: the run's own directory, mode 0700, where the recorder binds its socket.
        recorded: the session to record.
        attachments: text files that go into the recording, contents by name.
        started: start of the recording, ns since 1970.
    """

    file: Annotated[Path, _PATH]
    directory: Annotated[Path, _PATH]
    recorded: Annotated[Recorded, PlainForm(Recorded.as_metadata, Recorded.from_metadata)]
    attachments: Mapping[str, Annotated[bytes, PlainForm(bytes.decode, str.encode)]] = field(default_factory=dict)
    started: int = 0

    def save(self, path: Path) -> None:
        """Write the plan, readable for its owner alone (mode 0600).

        Raises:
            OSError: the file cannot be written.
        """
        with open_new(path, mode=0o600) as file:
            file.write(json.dumps(written(self)).encode())

    @classmethod
    def load(cls, path: Path) -> RecordingPlan:
        """Read a plan.

        Raises:
            PlanError: the file cannot be read, or holds no plan.
        """
        try:
            return read(cls, json.loads(path.read_text()))
        except OSError as error:
            raise PlanError(f"{path}: cannot be read: {error.strerror}") from error
        except (ValueError, RecursionError) as error:
            raise PlanError(f"{path}: not a recorder's plan: {error}") from error


MAX_LINE_BYTES: Final = 1024 * 1024
"""The longest line: it may name every device."""


@dataclass(frozen=True)
class FileBegun:
    """The file is begun; observations are expected at ``endpoint``."""

    endpoint: str


@dataclass(frozen=True)
class Taken:
    """Number of frames that have been taken since the beginning."""

    frames: int


@dataclass(frozen=True)
class WriteFailed:
    """Nothing more can be written because of ``text``; the file is readable up to ``tick``."""

    text: str
    tick: int


@dataclass(frozen=True)
class Closed:
    """The file is complete up to ``tick``; ``missing`` counts the ticks that a device never reported, where there
    are any.
    """

    missing: Mapping[str, int]
    tick: int


Status: TypeAlias = FileBegun | Taken | WriteFailed | Closed
_STATUS: Final = by_kind(ready=FileBegun, taken=Taken, stopped=WriteFailed, closed=Closed)


def encode(status: Status) -> bytes:
    """The line of a status."""
    return json.dumps(_STATUS.write(status)).encode() + b"\n"


class Lines:
    """Joins the pieces that a pipe delivers into lines, and reads the statuses.

    Attributes:
        nonsense: number of lines that were no status.
    """

    def __init__(self) -> None:
        self._rest = b""
        self.nonsense = 0

    def feed(self, piece: bytes) -> Iterator[Status]:
        """The statuses that are complete with ``piece``."""
        *whole, self._rest = (self._rest + piece).split(b"\n")
        if len(self._rest) > MAX_LINE_BYTES:
            self._rest = b""
            self.nonsense += 1
        for line in whole:
            try:
                status: Status = _STATUS.read(json.loads(line))
            except (ValueError, RecursionError):
                self.nonsense += 1
            else:
                yield status


FLUSH_EVERY: Final = from_seconds(0.5)
"""Twice a second, so that a killed recorder loses less than a second, frames on the way to it included."""

TAKEN_EVERY: Final = 32
"""After so many frames they are reported as taken, even if more are waiting."""

NICENESS: Final = 10  # on a busy machine the loop's processes come first; a late recorder costs nothing
_TIMEOUT: Final = from_seconds(0.1)

SendStatus = Callable[[Status], None]


def to_pipe(fd: int) -> SendStatus:
    """A function that sends a status to the supervisor's pipe. A broken pipe is ignored here: ``Life`` sees the
    supervisor end.
    """

    def send(status: Status) -> None:
        try:
            os.write(fd, encode(status))
        except BrokenPipeError:
            return

    return send


def record(plan: RecordingPlan, life: Life, clock: Clock, send: SendStatus) -> int:
    """Record until the session is over or nothing more can be written; returns the exit code."""
    from manyhands.nodes.recorder.core import RecorderCore
    from manyhands.nodes.recorder.mcap import RecordingFile

    os.nice(NICENESS)
    core = RecorderCore(plan.recorded, plan.attachments, plan.started)
    try:
        file = RecordingFile(plan.file, core.cut())
    except OSError as error:
        return _stopped(send, _reason(error), 0)
    transport = ZmqTransport.ipc(plan.directory)
    try:
        link, endpoint = transport.bind("recorder", HUB)
        send(FileBegun(endpoint))
        return _Recording(core, file, link, clock, send).run(life)
    except TransportError as error:
        return _stopped(send, str(error), 0)
    finally:
        transport.close()
        file.close()


class _Recording:
    """A file being written."""

    def __init__(self, core: RecorderCore, file: RecordingFile, link: Link, clock: Clock, send: SendStatus) -> None:
        self._core, self._file, self._link, self._clock, self._send = core, file, link, clock, send
        self._taken = self._reported = 0
        self._tick = 0  # the file is on the disk up to this tick

    def run(self, life: Life) -> int:
        """Take frames, write them, report them as taken, until the end; returns the exit code."""
        core, clock = self._core, self._clock
        due = Instant(clock.now() + FLUSH_EVERY)
        try:
            while not core.over:
                frame = self._link.recv(Duration(0))
                if frame is None:  # report before waiting: the supervisor may hold frames back until it has room
                    self._report_taken()
                    if life.stopping:  # and every frame that came before has been taken
                        break
                    frame = self._link.recv(Duration(min(_TIMEOUT, max(due - clock.now(), 1))))
                if frame is not None:
                    core.take(frame, time.time_ns())
                    self._taken += 1
                    if self._taken - self._reported >= TAKEN_EVERY:
                        self._report_taken()
                life.look(clock.now())
                if core.full or clock.now() >= due:
                    self._write(core.cut())
                    due = Instant(clock.now() + FLUSH_EVERY)
            self._write(core.cut())
            self._write(core.end())
        except OSError as error:
            return _stopped(self._send, _reason(error), self._tick)
        self._send(Closed(core.missing_in_all, core.tick))
        return EXIT_OK

    def _report_taken(self) -> None:
        if self._taken > self._reported:
            self._reported = self._taken
            self._send(Taken(self._taken))

    def _write(self, piece: bytes) -> None:
        if piece:
            self._file.append(piece)
            self._tick = self._core.tick


def _reason(error: OSError) -> str:
    return error.strerror or str(error)


def _stopped(send: SendStatus, why: str, tick: int) -> int:
    text = presentable(why)
    send(WriteFailed(text, tick))
    print(f"recording stopped at tick {tick}: {text}", file=sys.stderr)  # noqa: T201 -- the process's own error channel
    return EXIT_FAILED
