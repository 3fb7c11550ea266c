"""Records a running session from another terminal: writes what its broadcast shows as it arrives.

The session does not know of it and cannot be disturbed by it. Frames that this process has no time for are missing from
the file, and are counted. The file begins where the recorder came in. If the recorder is killed, the file is whole up
to a second before. It ends regularly when the session is over, or when the recorder was asked to end.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, Final

from manyhands.design.files import open_regular
from manyhands.launch.look.sessions import NoSession, Source, presence
from manyhands.launch.run.processes import Interrupt
from manyhands.launch.run.running import Running
from manyhands.launch.run.states import SessionPhase
from manyhands.nodes.recorder.core import RecorderCore
from manyhands.nodes.recorder.format import Recorded, media_type, recorded_of
from manyhands.nodes.recorder.mcap import RecordingFile
from manyhands.nodes.recorder.node import FLUSH_EVERY
from manyhands.nodes.rows.own_ticks import session_tick
from manyhands.protocol.clock import Clock, Duration, Instant, from_seconds
from manyhands.protocol.codec import decode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import Condition
from manyhands.protocol.transport.broadcast import Visit

MOST_ATTACHED_BYTES: Final = 64 * 2**20
"""The longest file of a session that is put into a recording."""

_TIMEOUT: Final = from_seconds(0.2)  # for a frame; then the supervisor and Ctrl-C are checked


class Ending(StrEnum):
    """Why a recording ended."""

    OVER = "the session is over"
    GONE = "the session's supervisor is gone"
    DURATION = "it has the length that was asked for"
    INTERRUPTED = "it was asked to end"


class AttachedCore:
    """Decides what to do with each frame, when to write, and when to end: without any I/O.

    Attributes:
        ending: why the recording ended; None while it goes on.
    """

    def __init__(self, core: RecorderCore, recorded: Recorded, duration: float | None, now: Instant) -> None:
        """Begin without any frame.

        Args:
            core: makes the file.
            recorded: the session of the file.
            duration: how long to record, s of the session's time, from the first tick that arrives; None: no end.
            now: the present instant.
        """
        self._core, self._recorded = core, recorded
        self._most = None if duration is None else round(duration / recorded.period)
        self._due = Instant(now + FLUSH_EVERY)
        self.ending: Ending | None = None

    def take(self, frame: bytes, wall: int) -> None:
        """Take in a frame that came at ``wall``, ns since 1970."""
        message = decode(frame, MAX_CONTROL_BYTES)
        refused = self._core.refused
        self._core.take(frame, wall)
        if self._core.refused > refused:
            return
        match message:
            case Condition(SessionPhase.OVER.value):
                self.end(Ending.OVER)
        if self._most is not None and self.tick - min(self.beginning.values(), default=self.tick) >= self._most:
            self.end(Ending.DURATION)

    def end(self, ending: Ending) -> None:
        """End the recording; the first reason counts."""
        self.ending = self.ending or ending

    def piece(self, now: Instant) -> bytes:
        """The bytes to write now: none, unless :data:`FLUSH_EVERY` has passed, or a chunk is full."""
        if now < self._due and not self._core.full:
            return b""
        self._due = Instant(now + FLUSH_EVERY)
        return self._core.cut()

    def rest(self) -> bytes:
        """The end of the file."""
        return self._core.cut() + self._core.end()

    @property
    def tick(self) -> int:
        """The session's tick after the last one of the recording."""
        return self._core.tick

    @property
    def beginning(self) -> dict[str, int]:
        """The session's tick in which the first tick of each device lies that arrived."""
        rate_of, found = self._recorded.rate_of, self._core.coverage.items()
        return {device: session_tick(one.first, rate_of(device)) for device, one in found if one.first is not None}

    @property
    def missing(self) -> dict[str, int]:
        """Number of ticks that were lost between the first and the last, by device, for devices that miss some."""
        return {device: coverage.missing for device, coverage in self._core.coverage.items() if coverage.missing}

    @property
    def refused(self) -> int:
        """Number of frames that made no sense."""
        return self._core.refused


@dataclass(frozen=True)
class AttachedRecording:
    """The result of a recording.

    Attributes:
        file: the recording.
        session: the session's name.
        ending: why it ended.
        first: the first tick in it; None if none came.
        ticks: the tick after the last one in it.
        missing: number of ticks lost between, by device.
        refused: number of frames that made no sense.
    """

    file: Path
    session: str
    ending: Ending
    first: int | None
    ticks: int
    missing: Mapping[str, int] = field(default_factory=dict)
    refused: int = 0

    def as_plain(self) -> dict[str, Any]:
        """As a JSON object."""
        return {
            "file": str(self.file),
            "session": self.session,
            "ending": self.ending.value,
            "first": self.first,
            "ticks": self.ticks,
            "missing": dict(self.missing),
            "refused": self.refused,
        }


def attachments_in(directory: Path) -> dict[str, bytes]:
    """The files of a session's directory that belong into its recording, as far as they exist."""
    found = {}
    for name in sorted(path.name for path in directory.iterdir() if media_type(path.name)):
        try:
            with open_regular(directory / name) as file:
                data = file.read(MOST_ATTACHED_BYTES + 1)
        except FileNotFoundError:  # the session has just ended
            continue
        if len(data) <= MOST_ATTACHED_BYTES:
            found[name] = data
    return found


def record_attached(
    running: Running,
    path: Path,
    duration: float | None,
    interrupt: Interrupt,
    clock: Clock,
    show: Callable[[AttachedCore], None],
) -> AttachedRecording:
    """Record a running session until it is over, ``duration`` has passed, or ``interrupt`` came.

    Args:
        running: the session.
        path: the recording's file.
        duration: s of the session's time; None: no end.
        interrupt: Ctrl-C and the other signals.
        clock: for the times of writing.
        show: called with the progress whenever something was written.

    Raises:
        NoSession: the session is over already.
        TransportError: its broadcast cannot be entered.
        OSError: the file cannot be written; it is whole up to there.
    """
    with presence(running) as gone:
        if gone():
            raise NoSession(f"{running.about.session}: found no process {running.about.pid}; it is over")
        with closing(Visit(running.directory)) as visit:
            recorded = recorded_of(running.about)
            maker = RecorderCore(recorded, attachments_in(running.directory), time.time_ns())
            core = AttachedCore(maker, recorded, duration, clock.now())
            with closing(RecordingFile(path, maker.cut())) as file:
                write_down(core, visit, gone, file.append, lambda: interrupt.signal is not None, clock, show)
    first = min(core.beginning.values(), default=None)
    ending = core.ending or Ending.INTERRUPTED
    return AttachedRecording(path, recorded.session, ending, first, core.tick, core.missing, core.refused)


def write_down(
    core: AttachedCore,
    visit: Source,
    gone: Callable[[], bool],
    append: Callable[[bytes], None],
    interrupted: Callable[[], bool],
    clock: Clock,
    show: Callable[[AttachedCore], None],
) -> None:
    """Take in frames and write them until ``core`` has a reason to end, then write the file's end.

    Args:
        core: decides what to do.
        visit: the source of frames.
        gone: whether the session has ended; called when no frame comes.
        append: writes a piece.
        interrupted: whether the recording was asked to end.
        clock: for the times of writing.
        show: called whenever something was written.
    """
    while core.ending is None:
        frame = visit.recv(_TIMEOUT)
        if frame is not None:
            core.take(frame, time.time_ns())
        elif gone():
            while (frame := visit.recv(Duration(0))) is not None:  # frames that came before the session's end
                core.take(frame, time.time_ns())
            core.end(Ending.GONE)
        if interrupted():
            core.end(Ending.INTERRUPTED)
        if piece := core.piece(clock.now()):
            append(piece)
            show(core)
    append(core.rest())
