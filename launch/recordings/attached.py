"""Recording a session that runs already, from another terminal: what its broadcast shows is written down as it comes.

The session does not know of it and cannot be disturbed by it: what this process has no time for is missing from the
file, and told. The file begins where the recorder came in; it is whole up to a second ago whenever the recorder is
killed, and ends as every recording does when the session is over, or when it was asked to end.
"""

from __future__ import annotations

import os
import select
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, Final, Protocol

from manyhands.design.files import open_regular
from manyhands.launch.observe.sessions import NoSession, Running
from manyhands.launch.run.processes import Interrupt
from manyhands.launch.run.states import SessionPhase
from manyhands.nodes.observer.scene import ABOUT, About
from manyhands.nodes.recorder.core import RecorderCore
from manyhands.nodes.recorder.format import MEDIA_TYPES, Recorded
from manyhands.nodes.recorder.mcap import RecordingFile
from manyhands.nodes.recorder.node import FLUSH_EVERY
from manyhands.protocol.clock import Clock, Duration, Instant, from_seconds
from manyhands.protocol.codec import decode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import Condition
from manyhands.protocol.transport.broadcast import Visit

MOST_ATTACHED_BYTES: Final = 64 * 2**20
"""Longest file of a session that is put into a recording."""

_PATIENCE: Final = from_seconds(0.2)  # for a frame, before the supervisor and Ctrl-C are looked after


class Ending(StrEnum):
    """Why a recording came to its end."""

    OVER = "the session is over"
    GONE = "the session's supervisor is gone"
    DURATION = "it is as long as was asked for"
    INTERRUPTED = "it was asked to end"


def recorded_of(about: About) -> Recorded:
    """What a recording of this session says that it is of."""
    return Recorded(
        session=about.session,
        certificate=about.id,
        period=about.period,
        clock=about.clock,
        roles={name: node.role for name, node in about.nodes.items()},
        ports={name: node.ports for name, node in about.nodes.items()},
        masses=tuple(about.masses),
    )


class AttachedCore:
    """What is to be done with each frame, when to write, and when to end. Without any I/O.

    Attributes:
        ending: why it is over; None while it goes on.
    """

    def __init__(self, core: RecorderCore, recorded: Recorded, duration: float | None, now: Instant) -> None:
        """Nothing was heard yet.

        Args:
            core: makes the file.
            recorded: what the file is of.
            duration: how long to record, s of the session's time, from the first tick that is heard of; None: no end.
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
        """It is over; the first reason counts."""
        self.ending = self.ending or ending

    def piece(self, now: Instant) -> bytes:
        """What is to be written now: nothing, unless a second has gone by, or much has come."""
        if now < self._due and not self._core.full:
            return b""
        self._due = Instant(now + FLUSH_EVERY)
        return self._core.cut()

    def rest(self) -> bytes:
        """The file's end."""
        return self._core.cut() + self._core.end()

    @property
    def tick(self) -> int:
        """Up to which tick the recording goes."""
        return self._core.tick

    @property
    def beginning(self) -> dict[str, int]:
        """The first tick of each device that was heard of."""
        found = self._core.coverage.items()
        return {device: coverage.first for device, coverage in found if coverage.first is not None}

    @property
    def missing(self) -> dict[str, int]:
        """Ticks that were lost between the first and the last, by device, those that miss some."""
        return {device: coverage.missing for device, coverage in self._core.coverage.items() if coverage.missing}

    @property
    def refused(self) -> int:
        """Frames that made no sense."""
        return self._core.refused


@dataclass(frozen=True)
class AttachedRecording:
    """What became of it.

    Attributes:
        file: the recording.
        session: the session's name.
        ending: why it ended.
        first: the first tick in it; None if none came.
        ticks: up to which tick it goes.
        missing: ticks lost between, by device.
        refused: frames that made no sense.
    """

    file: Path
    session: str
    ending: Ending
    first: int | None
    ticks: int
    missing: Mapping[str, int] = field(default_factory=dict)
    refused: int = 0

    def as_plain(self) -> dict[str, Any]:
        """As JSON has it."""
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
    """The files of a session's directory that belong into its recording, those that are there."""
    found = {}
    for name in MEDIA_TYPES:
        try:
            with open_regular(directory / name) as file:
                data = file.read(MOST_ATTACHED_BYTES + 1)
        except FileNotFoundError:  # an uncertified session has no certificate
            continue
        if len(data) <= MOST_ATTACHED_BYTES:
            found[name] = data
    return found


class SupervisorWatch:
    """Whether a session's supervisor still runs; to be closed."""

    def __init__(self, running: Running) -> None:
        """Look at it.

        Raises:
            NoSession: it does not.
        """
        self._about = running.directory / ABOUT
        try:
            self._fd = os.pidfd_open(running.about.pid)
        except OSError as error:
            raise NoSession(f"{running.about.session}: found no process {running.about.pid}; it is over") from error

    def gone(self) -> bool:
        """Whether its process has ended, or goes on without this session."""
        poll = select.poll()
        poll.register(self._fd, select.POLLIN)
        return bool(poll.poll(0)) or not self._about.exists()

    def close(self) -> None:
        """Look no more."""
        os.close(self._fd)


def record_attached(
    running: Running,
    path: Path,
    duration: float | None,
    interrupt: Interrupt,
    clock: Clock,
    show: Callable[[AttachedCore], None],
) -> AttachedRecording:
    """Record a running session to ``path`` until it is over, ``duration`` (s) is, or ``interrupt`` came.

    ``show`` is called now and then with what there is.

    Raises:
        NoSession: the session is over already.
        TransportError: its broadcast cannot be entered.
        OSError: the file cannot be written; it is whole up to there.
    """
    supervisor = SupervisorWatch(running)
    try:
        visit = Visit(running.directory)
        try:
            recorded = recorded_of(running.about)
            maker = RecorderCore(recorded, attachments_in(running.directory), time.time_ns())
            core = AttachedCore(maker, recorded, duration, clock.now())
            file = RecordingFile(path, maker.cut())
            try:
                write_down(core, visit, supervisor.gone, file.append, lambda: interrupt.signal is not None, clock, show)
            finally:
                file.close()
        finally:
            visit.close()
    finally:
        supervisor.close()
    first = min(core.beginning.values(), default=None)
    ending = core.ending or Ending.INTERRUPTED
    return AttachedRecording(path, recorded.session, ending, first, core.tick, core.missing, core.refused)


class Shown(Protocol):
    """Where frames come from: a visit to a broadcast."""

    def recv(self, timeout: Duration) -> bytes | None:
        """The next frame, or None if none came within ``timeout``."""
        ...


def write_down(
    core: AttachedCore,
    visit: Shown,
    gone: Callable[[], bool],
    append: Callable[[bytes], None],
    interrupted: Callable[[], bool],
    clock: Clock,
    show: Callable[[AttachedCore], None],
) -> None:
    """Take in frames and write until ``core`` knows why to end, then write the file's end.

    Args:
        core: what is to be done.
        visit: where frames come from.
        gone: whether the session has ended; asked when nothing is heard.
        append: writes.
        interrupted: whether the recording was asked to end.
        clock: for the times of writing.
        show: called whenever something was written.
    """
    while core.ending is None:
        frame = visit.recv(_PATIENCE)
        if frame is not None:
            core.take(frame, time.time_ns())
        elif gone():
            while (frame := visit.recv(Duration(0))) is not None:  # what came before
                core.take(frame, time.time_ns())
            core.end(Ending.GONE)
        if interrupted():
            core.end(Ending.INTERRUPTED)
        if piece := core.piece(clock.now()):
            append(piece)
            show(core)
    append(core.rest())
