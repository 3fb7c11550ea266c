"""The supervisor's end of a recorder: starts its process, supplies it with frames, and reports what became of the
recording.

A slow recorder never delays a node in real time: frames without room are lost and counted. Under the simulated clock
nothing may be lost. There ``has_room`` makes the supervisor leave the nodes' frames in the nodes' own queues for a
while. Either way hardly more than :data:`MOST_WAITING_BYTES` is kept here.
"""

from __future__ import annotations

import os
import select
import time
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from manyhands.launch.plan.prepare import Prepared
from manyhands.launch.plan.recorded import recorded_of
from manyhands.launch.recordings.recording import RecordingError
from manyhands.launch.run.directory import kept_files
from manyhands.launch.run.processes import Processes
from manyhands.launch.run.states import signal_name
from manyhands.nodes.kernel.bundle import SIMULATED
from manyhands.nodes.recorder.node import Closed, FileBegun, Lines, RecordingPlan, Status, Taken, WriteFailed
from manyhands.protocol.clock import Clock, Duration, Instant, RealtimeClock, from_seconds
from manyhands.protocol.codec import encode
from manyhands.protocol.messages import Stop
from manyhands.protocol.transport import Link, milliseconds
from manyhands.protocol.transport.zeromq import ZmqTransport


class Recorder:
    """What the supervisor asks of a recorder. This one records nothing; :class:`RecorderProcess` records in its own
    process.
    """

    def start(self, directory: Path) -> None:
        """Start it; ``directory`` is the run's own."""

    def await_ready(self, interrupt: int) -> None:
        """Wait until it accepts frames, or the file descriptor ``interrupt`` is readable."""

    @property
    def fds(self) -> tuple[int, ...]:
        """File descriptors to wait on; when one of them is readable, call :meth:`attend`."""
        return ()

    @property
    def has_room(self) -> bool:
        """Whether the supervisor should read more frames of the nodes; False only where nothing may be lost."""
        return True

    def take(self, frame: bytes | None) -> None:
        """Pass on a frame, now or when there is room for it; None stands for a frame that was too long."""

    def attend(self, ready: set[int]) -> str | None:
        """Read the recorder's status and supply it with frames; returns why the recording stopped, once, when it
        does.
        """
        return None

    def finish(self, interrupt: int) -> str | None:
        """Have the rest written after the session, unless ``interrupt`` becomes readable; returns as :meth:`attend`."""
        return None

    def close(self) -> None:
        """End it if it still runs."""

    @property
    def missing(self) -> Mapping[str, int]:
        """Number of ticks without any telemetry, by device, for the devices that miss some."""
        return {}

    @property
    def stopped(self) -> bool:
        """Whether the recording stopped before its session did."""
        return False

    @property
    def failure(self) -> str | None:
        """Why a recording that must be complete (under the simulated clock) is not; None otherwise."""
        return None

    def as_plain(self) -> dict[str, Any]:
        """What the report contains about it: the key ``recording``, or nothing."""
        return {}


MOST_WAITING_BYTES: Final = 16 * 2**20
"""The most bytes of observations that wait for the recorder: seconds of the telemetry of a large session."""

MOST_UNDER_WAY: Final = 128
"""The most frames that are sent but not yet taken: as many as surely fit into a link's queue."""

STARTING_TIME: Final = from_seconds(30.0)
CLOSING_TIME: Final = from_seconds(30.0)
"""The longest time that the rest of a recording may take to reach the disk after the session."""

_NAME: Final = "recorder"  # of its process and its log


class RecorderProcess(Recorder):
    """One recording, from before the first tick to after the last.

    Attributes:
        path: the recording.
        lost: number of observations without room at the recorder, or too long for a frame.
        incident: why the recording stopped before its session, if it did.
    """

    def __init__(self, prepared: Prepared, clock_name: str, path: Path, clock: Clock | None = None) -> None:
        """Plan a recording; nothing is started yet.

        Args:
            prepared: the session.
            clock_name: the clock that paces it, "realtime" or "simulated".
            path: the recording's file.
            clock: for time limits.
        """
        self.path = path
        self.lost = 0
        self.incident: str | None = None
        self._recorded = recorded_of(prepared, clock_name)
        self._attachments = kept_files(prepared)
        self._lossless = clock_name == SIMULATED
        self._clock = clock or RealtimeClock()
        self._processes: Processes | None = None
        self._transport: ZmqTransport | None = None
        self._link: Link | None = None
        self._pipe: int | None = None
        self._lines = Lines()
        self._waiting: deque[bytes] = deque()
        self._waiting_bytes = self._sent = self._taken = 0
        self._end: Closed | WriteFailed | None = None
        self._finishing = self._gone = False

    def start(self, directory: Path) -> None:
        """Start the process.

        Args:
            directory: the run's own, for the recorder's plan, its socket and its error output.

        Raises:
            OSError: the process cannot be started.
        """
        plan = directory / "recorder.plan"
        started = time.time_ns()
        RecordingPlan(self.path.absolute(), directory.absolute(), self._recorded, self._attachments, started).save(plan)
        pipe, its_end = os.pipe2(os.O_CLOEXEC)
        self._pipe = pipe
        os.set_blocking(pipe, False)
        self._processes = Processes(directory)
        try:
            self._processes.spawn((_NAME,), "manyhands.nodes.recorder", [str(plan)], output=its_end)
        finally:
            os.close(its_end)
        # Unix-domain sockets, whatever transport the session has: the recorder runs here, in a private directory
        self._transport = ZmqTransport.ipc(directory)

    def await_ready(self, interrupt: int) -> None:
        """Wait until the file is begun, or the file descriptor ``interrupt`` is readable.

        Raises:
            RecordingError: the recording cannot be begun.
        """
        deadline = Instant(self._clock.now() + STARTING_TIME)
        while self._link is None:
            ready = self._wait(deadline, interrupt)
            if interrupt in ready:
                return
            self.attend(ready)
            if self.incident is not None or not ready:
                silent = self.incident or "the recorder did not report that it is ready"
                why = self._end.text if isinstance(self._end, WriteFailed) else silent
                raise RecordingError(f"{self.path}: cannot be recorded to: {why}")

    def _wait(self, deadline: Instant, *more: int) -> set[int]:
        """The ready ones among its file descriptors and ``more``; an empty set when the time is over."""
        poll = select.poll()
        for fd in (*self.fds, *more):
            poll.register(fd, select.POLLIN)
        left = milliseconds(Duration(max(deadline - self._clock.now(), 0)))
        return {fd for fd, _ in poll.poll(left)}

    @property
    def fds(self) -> tuple[int, ...]:
        """Its pipe, and its process; see :class:`Recorder`."""
        if self._gone or self._pipe is None or self._processes is None:
            return ()
        return (self._pipe, *self._processes.fds)

    @property
    def pid(self) -> int | None:
        """Its process id while it runs."""
        return None if self._gone or self._processes is None else self._processes.pids.get(_NAME)

    @property
    def has_room(self) -> bool:
        """False when too much waits for the recorder and none of it may be lost; see :class:`Recorder`."""
        return self._gone or not self._lossless or self._waiting_bytes < MOST_WAITING_BYTES

    def take(self, frame: bytes | None) -> None:
        """Send the frame, keep it for a while, or drop and count it; see :class:`Recorder`."""
        if self._gone:
            return
        if frame is None:
            self.lost += 1
            return
        if not self._lossless and self._waiting_bytes + len(frame) > MOST_WAITING_BYTES:
            self.lost += 1
            return
        self._waiting.append(frame)
        self._waiting_bytes += len(frame)
        self._supply()

    def _supply(self) -> None:
        """Send waiting frames while there is room."""
        link = self._link
        while link is not None and self._waiting and self._sent - self._taken < MOST_UNDER_WAY:
            if not link.send(self._waiting[0]):
                return
            self._sent += 1
            self._waiting_bytes -= len(self._waiting.popleft())

    def attend(self, ready: set[int]) -> str | None:
        """Read the recorder's status, supply it, and note its end; see :class:`Recorder`."""
        if self._processes is None or not ready.intersection(self.fds):
            return None
        self._read_statuses()
        if ended := self._processes.reap(ready):
            self._read_statuses()  # its last status may have arrived between the two calls
            self._ended(ended[_NAME])
            return self.incident
        self._supply()
        return None

    def _read_statuses(self) -> None:
        if self._pipe is None:
            return
        try:
            while piece := os.read(self._pipe, 65536):
                for status in self._lines.feed(piece):
                    self._take(status)
        except BlockingIOError:
            return

    def _take(self, status: Status) -> None:
        match status:
            case FileBegun(endpoint) if self._transport is not None and self._link is None:
                self._link = self._transport.connect(endpoint, "recorder")
            case Taken(frames) if self._taken <= frames <= self._sent:
                self._taken = frames
            case Closed() | WriteFailed():
                self._end = status
            case _:
                self._lines.nonsense += 1

    def _ended(self, code: int) -> None:
        """The process has ended; the frames that it has not taken are dropped."""
        self._gone = True
        self._waiting.clear()
        self._waiting_bytes = 0
        match self._end:
            case Closed() if self._finishing:
                return
            case Closed(_, tick):
                self.incident = (
                    f"recording ended at tick {tick}: a signal ended the recorder; {self.path} is complete up to there"
                )
            case WriteFailed(text, tick):
                self.incident = f"recording stopped at tick {tick}: {text}; {self.path} can be read up to there"
            case None:
                how = f"was killed by {signal_name(-code)}" if code < 0 else f"ended with exit code {code}"
                self.incident = (
                    f"recording stopped: the recorder {how}; {self.path} can be read up to the last data it wrote"
                )

    def finish(self, interrupt: int) -> str | None:
        """Have the rest written, and wait for that as long as a disk may need; see :class:`Recorder`."""
        if self._processes is None or self._gone:
            return None
        deadline = Instant(self._clock.now() + CLOSING_TIME)
        self._finishing = True
        self._waiting.append(encode(Stop("the session is over")))
        self._supply()
        others: tuple[int, ...] = (interrupt,)
        while not self._gone:
            ready = self._wait(deadline, *others)
            self.attend(ready)
            if not ready or ready & {*others}:  # too slow, or the user does not wait: from now on only its end counts
                self._processes.kill(_NAME)
                deadline, others = Instant(2**62), ()
        return self.incident

    def close(self) -> None:
        """End the process if it still runs, and leave nothing of it but the recording."""
        if self._processes is not None:
            self._processes.end_all()
        if self._pipe is not None:
            os.close(self._pipe)
            self._pipe = None
        self._gone = True
        if self._transport is not None:
            self._transport.close()

    @property
    def missing(self) -> Mapping[str, int]:
        """As the recorder counted it; see :class:`Recorder`."""
        return self._end.missing if isinstance(self._end, Closed) else {}

    @property
    def stopped(self) -> bool:
        """See :class:`Recorder`."""
        return self.incident is not None

    @property
    def failure(self) -> str | None:
        """Under the simulated clock, why the recording is not complete; see :class:`Recorder`."""
        if not self._lossless or (self.incident is None and self.lost == 0):
            return None
        return self.incident or f"{self.lost} observations were not recorded; expected none under the simulated clock"

    def as_plain(self) -> dict[str, Any]:
        """File, ticks, and what is missing; see :class:`Recorder`."""
        out: dict[str, Any] = {"file": str(self.path)}
        if self._end is not None:
            out["ticks"] = self._end.tick
        out |= {"missing": dict(self.missing)} if self.missing else {}
        out |= {"lost": self.lost} if self.lost else {}
        out |= {} if self.incident is None else {"stopped": self.incident}
        return {"recording": out}
