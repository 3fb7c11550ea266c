"""What a supervisor asks of whoever writes its run down while it goes on.

The supervisor's end of a recorder: starts it, keeps it supplied, and tells what became of the recording.

A recorder that does not keep up never holds up anyone in real time: what it has no room for is lost and counted. Under
the simulated clock nothing may be lost: there ``has_room`` asks the supervisor to leave what nodes tell in the nodes'
own queues for a while. Either way hardly more than :data:`MOST_WAITING_BYTES` is kept here.
"""

from __future__ import annotations

import os
import select
import time
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from manyhands.launch.plan.bundles import mass_names
from manyhands.launch.plan.prepare import Prepared
from manyhands.launch.recordings.recording import RecordingError
from manyhands.launch.run.directory import kept_files
from manyhands.launch.run.processes import Processes
from manyhands.launch.run.states import signal_name
from manyhands.nodes.bundle import SIMULATED
from manyhands.nodes.recorder.format import Recorded
from manyhands.nodes.recorder.node import Closed, Lines, Plan, Ready, Status, Stopped, Taken
from manyhands.protocol.clock import Clock, Duration, Instant, RealtimeClock, from_seconds
from manyhands.protocol.codec import encode
from manyhands.protocol.messages import Stop
from manyhands.protocol.transport import Link, milliseconds
from manyhands.protocol.transport.zeromq import ZmqTransport


class Recorder:
    """Who writes a run down while it goes on: here nobody, in :class:`RecorderProcess` a process of its own."""

    def start(self, directory: Path) -> None:
        """Start it; ``directory`` is the run's own."""

    def await_ready(self, interrupt: int) -> None:
        """Wait until it can be told something, or the descriptor ``interrupt`` is readable."""

    @property
    def fds(self) -> tuple[int, ...]:
        """Descriptors to wait on; when one of them is readable, :meth:`attend`."""
        return ()

    @property
    def has_room(self) -> bool:
        """Whether what nodes tell should be read on; False only where nothing may be lost."""
        return True

    def tell(self, frame: bytes | None) -> None:
        """Pass on what was told, now or when there is room for it; None is what is too long to be passed on."""

    def attend(self, ready: set[int]) -> str | None:
        """Hear what it says and supply it; returns why the recording has stopped, once, when that happens."""
        return None

    def finish(self, interrupt: int) -> str | None:
        """The session is over: have the rest written, unless ``interrupt`` becomes readable; returns as ``attend``."""
        return None

    def close(self) -> None:
        """End it if it still runs."""

    @property
    def missing(self) -> Mapping[str, int]:
        """Ticks that were never told of, by device, those devices that miss some."""
        return {}

    @property
    def failure(self) -> str | None:
        """What is wrong with a recording that has to be whole, the simulated clock's; None if nothing is."""
        return None

    def as_plain(self) -> dict[str, Any]:
        """What it adds to a report: ``recording``, unless there is none."""
        return {}


MOST_WAITING_BYTES: Final = 16 * 2**20
"""Of observations that the recorder has not asked for yet: seconds of the telemetry of a large session."""

MOST_UNDER_WAY: Final = 128
"""Frames sent and not yet taken: as many as are sure to find room in a link's queue."""

STARTING_TIME: Final = from_seconds(30.0)
CLOSING_TIME: Final = from_seconds(30.0)
"""How long the rest of a recording may take to reach the disk when a session is over."""

_NAME: Final = "recorder"  # of its process, for the keeper and in the log's name


class RecorderProcess(Recorder):
    """One recording, from before the first tick to after the last.

    Attributes:
        path: the recording.
        lost: what the recorder had no room for, or observations that are too long to be passed on.
        incident: why the recording stopped before its session, if it did.
    """

    def __init__(self, prepared: Prepared, clock_name: str, path: Path, clock: Clock | None = None) -> None:
        """Plan a recording; nothing is started yet.

        Args:
            prepared: the session.
            clock_name: what paces it, "realtime" or "simulated".
            path: where the recording goes.
            clock: for time limits.
        """
        self.path = path
        self.lost = 0
        self.incident: str | None = None
        session, graph = prepared.session, prepared.graph
        self._recorded = Recorded(
            session.name, prepared.id, session.period, clock_name, graph.nodes, graph.ports, mass_names(session)
        )
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
        self._end: Closed | Stopped | None = None
        self._finishing = self._gone = False

    def start(self, directory: Path) -> None:
        """Start the process; ``directory`` is the run's own, for its plan, its socket and its error output.

        Raises:
            OSError: it cannot be started.
        """
        plan = directory / "recorder.plan"
        started = time.time_ns()
        Plan(self.path.absolute(), directory.absolute(), self._recorded, self._attachments, started).save(plan)
        pipe, its_end = os.pipe2(os.O_CLOEXEC)
        self._pipe = pipe
        os.set_blocking(pipe, False)
        self._processes = Processes(directory)
        try:
            self._processes.spawn((_NAME,), "manyhands.nodes.recorder", [str(plan)], output=its_end)
        finally:
            os.close(its_end)
        # Unix-domain sockets whatever carries the session: the recorder is here, and the directory keeps others out
        self._transport = ZmqTransport.ipc(directory)

    def await_ready(self, interrupt: int) -> None:
        """Wait until the file is begun, or the descriptor ``interrupt`` is readable.

        Raises:
            RecordingError: it cannot be begun.
        """
        deadline = Instant(self._clock.now() + STARTING_TIME)
        while self._link is None:
            ready = self._wait(deadline, interrupt)
            if interrupt in ready:
                return
            self.attend(ready)
            if self.incident is not None or not ready:
                silent = self.incident or "the recorder did not say that it is ready"
                why = self._end.text if isinstance(self._end, Stopped) else silent
                raise RecordingError(f"{self.path}: cannot be recorded to: {why}")

    def _wait(self, deadline: Instant, *more: int) -> set[int]:
        """Those of its descriptors and of ``more`` that are ready; none when the time is over."""
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
        """False when too much is waiting and none of it may be lost; see :class:`Recorder`."""
        return self._gone or not self._lossless or self._waiting_bytes < MOST_WAITING_BYTES

    def tell(self, frame: bytes | None) -> None:
        """Send it on, keep it for a while, or lose it and count that; see :class:`Recorder`."""
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
        """Send on what there is room for."""
        link = self._link
        while link is not None and self._waiting and self._sent - self._taken < MOST_UNDER_WAY:
            if not link.send(self._waiting[0]):
                return
            self._sent += 1
            self._waiting_bytes -= len(self._waiting.popleft())

    def attend(self, ready: set[int]) -> str | None:
        """Hear what the recorder says, supply it, and note its end; see :class:`Recorder`."""
        if self._processes is None or not ready.intersection(self.fds):
            return None
        self._hear()
        if ended := self._processes.reap(ready):
            self._hear()  # its last word may have come between
            self._ended(ended[_NAME])
            return self.incident
        self._supply()
        return None

    def _hear(self) -> None:
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
            case Ready(endpoint) if self._transport is not None and self._link is None:
                self._link = self._transport.connect(endpoint, "recorder")
            case Taken(frames) if self._taken <= frames <= self._sent:
                self._taken = frames
            case Closed() | Stopped():
                self._end = status
            case _:
                self._lines.nonsense += 1

    def _ended(self, code: int) -> None:
        """Its process is gone; so is what it has not taken."""
        self._gone = True
        self._waiting.clear()
        self._waiting_bytes = 0
        match self._end:
            case Closed() if self._finishing:
                return
            case Closed(_, tick):
                self.incident = (
                    f"recording ended at tick {tick}: somebody ended the recorder; {self.path} is whole up to there"
                )
            case Stopped(text, tick):
                self.incident = f"recording stopped at tick {tick}: {text}; {self.path} can be read up to there"
            case None:
                how = f"was killed by {signal_name(-code)}" if code < 0 else f"ended with exit code {code}"
                self.incident = (
                    f"recording stopped: the recorder {how}; {self.path} can be read up to what it had written"
                )

    def finish(self, interrupt: int) -> str | None:
        """Have the rest written, and wait for that as long as a disk may take; see :class:`Recorder`."""
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
            if not ready or ready & {*others}:
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
        """As the recorder counted them; see :class:`Recorder`."""
        return self._end.missing if isinstance(self._end, Closed) else {}

    @property
    def failure(self) -> str | None:
        """Under the simulated clock, that it is not whole; see :class:`Recorder`."""
        if not self._lossless or (self.incident is None and self.lost == 0):
            return None
        return self.incident or f"{self.lost} observations were not recorded; expected none under the simulated clock"

    def as_plain(self) -> dict[str, Any]:
        """File, ticks, and what is wrong with it; see :class:`Recorder`."""
        out: dict[str, Any] = {"file": str(self.path)}
        if self._end is not None:
            out["ticks"] = self._end.tick
        out |= {"missing": dict(self.missing)} if self.missing else {}
        out |= {"lost": self.lost} if self.lost else {}
        out |= {} if self.incident is None else {"stopped": self.incident}
        return {"recording": out}
