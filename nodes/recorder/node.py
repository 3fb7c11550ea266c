"""The recorder's process: it writes the supervisor's observations to the disk, twice a second.

Writing and syncing take as long as the disk takes, milliseconds or seconds. So a process of its own does it, in which
no tick runs. The supervisor keeps the frames that the recorder has not taken in yet, within bounds. The recorder ends
when the session is over, when it cannot write any more, or when the supervisor is gone. The file then has all frames
that were taken in; if the recorder was killed, less than a second of them is lost.

A :class:`Plan` states what a recorder records and where to. A recorder reports its :data:`Status` to its supervisor on
a pipe, one line of JSON for each:

    {"ready": ENDPOINT}               the file is begun; the supervisor sends observations to this endpoint
    {"taken": N}                      so many frames in all have been taken in: there is room for others
    {"stopped": TEXT, "tick": K}      nothing more can be written; the file is readable up to tick K
    {"closed": {...}, "tick": K}      the file is whole; ticks missing by device

A recorder and its supervisor have one version and run on one machine, so this is not part of the protocol.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, TypeAlias

from manyhands.design.files import open_new
from manyhands.nodes.lifetime import Life
from manyhands.nodes.process import EXIT_FAILED, EXIT_OK
from manyhands.nodes.recorder.core import RecorderCore
from manyhands.nodes.recorder.format import Recorded
from manyhands.nodes.recorder.mcap import RecordingFile
from manyhands.protocol.clock import Clock, Duration, Instant, from_seconds
from manyhands.protocol.messages import presentable
from manyhands.protocol.transport import Link, TransportError
from manyhands.protocol.transport.zeromq import HUB, ZmqTransport


class PlanError(Exception):
    """A plan cannot be read; the message names the file and the reason."""


@dataclass(frozen=True)
class Plan:
    """A recorder's plan.

    Attributes:
        file: the absolute path of the recording.
        directory: the run's own directory, mode 0700, where the recorder binds its socket.
        recorded: the session that is recorded.
        attachments: the contents of text files that go into the recording, by name.
        started: the time at which the recording starts, ns since 1970.
    """

    file: Path
    directory: Path
    recorded: Recorded
    attachments: Mapping[str, bytes] = field(default_factory=dict)
    started: int = 0

    def save(self, path: Path) -> None:
        """Write the plan to a new file that only its owner can read (mode 0600).

        Raises:
            OSError: the file exists or cannot be written.
        """
        plain = {
            "file": str(self.file),
            "directory": str(self.directory),
            "recorded": self.recorded.as_metadata(),
            "attachments": {name: data.decode() for name, data in self.attachments.items()},
            "started": self.started,
        }
        with open_new(path, mode=0o600) as file:
            file.write(json.dumps(plain).encode())

    @classmethod
    def load(cls, path: Path) -> Plan:
        """Read a plan.

        Raises:
            PlanError: the file cannot be read, or is no plan.
        """
        try:
            data = json.loads(path.read_text())
            return cls(
                Path(data["file"]),
                Path(data["directory"]),
                Recorded.from_metadata(data["recorded"]),
                {name: text.encode() for name, text in data["attachments"].items()},
                int(data["started"]),
            )
        except OSError as error:
            raise PlanError(f"{path}: cannot be read: {error.strerror}") from error
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise PlanError(f"{path}: not a recorder's plan: {type(error).__name__}: {error}") from error


MAX_LINE_BYTES: Final = 1024 * 1024
"""The greatest length of a line, which may name every device."""


@dataclass(frozen=True)
class Ready:
    """The file is begun; the recorder expects observations at ``endpoint``."""

    endpoint: str


@dataclass(frozen=True)
class Taken:
    """The number of frames that have been taken in since the beginning."""

    frames: int


@dataclass(frozen=True)
class Stopped:
    """Nothing more can be written, for the reason ``text``; the file is readable up to ``tick``."""

    text: str
    tick: int


@dataclass(frozen=True)
class Closed:
    """The file is whole up to ``tick``; ``missing`` has the number of ticks that never came, by device."""

    missing: Mapping[str, int]
    tick: int


Status: TypeAlias = Ready | Taken | Stopped | Closed


def encode(status: Status) -> bytes:
    """The line of a status."""
    plain: dict[str, object]
    match status:
        case Ready(endpoint):
            plain = {"ready": endpoint}
        case Taken(frames):
            plain = {"taken": frames}
        case Stopped(text, tick):
            plain = {"stopped": text, "tick": tick}
        case Closed(missing, tick):
            plain = {"closed": dict(missing), "tick": tick}
    return json.dumps(plain).encode() + b"\n"


class Lines:
    """Joins the pieces that a pipe delivers into lines.

    Attributes:
        nonsense: lines that were no status.
    """

    def __init__(self) -> None:
        self._rest = b""
        self.nonsense = 0

    def feed(self, piece: bytes) -> Iterator[Status]:
        """The statuses whose lines are complete with ``piece``."""
        *whole, self._rest = (self._rest + piece).split(b"\n")
        if len(self._rest) > MAX_LINE_BYTES:
            self._rest = b""
            self.nonsense += 1
        for line in whole:
            status = _decode(line)
            if status is None:
                self.nonsense += 1
            else:
                yield status


def _decode(line: bytes) -> Status | None:
    try:
        match json.loads(line):
            case {"ready": str(endpoint)}:
                return Ready(endpoint)
            case {"taken": int(frames)}:
                return Taken(frames)
            case {"stopped": str(text), "tick": int(tick)}:
                return Stopped(text, tick)
            case {"closed": dict(missing), "tick": int(tick)} if all(type(n) is int for n in missing.values()):
                return Closed(missing, tick)
            case _:
                return None
    except (ValueError, RecursionError):
        return None


FLUSH_EVERY: Final = from_seconds(0.5)
"""The time between two writes; a killed recorder then loses less than a second, frames on their way included."""

TAKEN_EVERY: Final = 32
"""Frames after which the recorder reports them as taken, even while more are waiting."""

NICENESS: Final = 10  # on a busy machine the loop's processes come first: a late recorder costs nothing
_PATIENCE: Final = from_seconds(0.1)

Say = Callable[[Status], None]


def to_pipe(fd: int) -> Say:
    """A function that reports to the supervisor over its pipe; without a reader it does nothing."""

    def say(status: Status) -> None:
        try:
            os.write(fd, encode(status))
        except BrokenPipeError:
            return

    return say


def record(plan: Plan, life: Life, clock: Clock, say: Say) -> int:
    """Record until the session is over, or nothing more can be written; returns the exit code.

    Args:
        plan: the session, and the file to write.
        life: whether the process should still run.
        clock: paces the writes; a realtime one.
        say: reports to the supervisor.
    """
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
    """The loop of a recorder whose file has begun."""

    def __init__(self, core: RecorderCore, file: RecordingFile, link: Link, clock: Clock, say: Say) -> None:
        self._core, self._file, self._link, self._clock, self._say = core, file, link, clock, say
        self._taken = self._told = 0
        self._tick = 0  # the tick up to which the file is on the disk

    def run(self, life: Life) -> int:
        """Take in frames, write and report, until the end; returns the exit code.

        The loop reads all frames that wait before it reports or looks at ``life``: the supervisor holds them back until
        they are reported as taken, and a request to end must not lose frames that came before it.
        """
        core, clock = self._core, self._clock
        due = Instant(clock.now() + FLUSH_EVERY)
        try:
            while not core.over:
                frame = self._link.recv(Duration(0))
                if frame is None:
                    self._tell()
                    if life.stopping:  # only here, where every frame that came before has been taken in
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
