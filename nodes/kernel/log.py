"""The log of one process: a file of JSON lines, one for each event.

    {"time": "2026-01-02T03:04:05.678901Z", "monotonic_ns": 1, "session": "s", "node": "dx", "level": "info",
     "event": "loop", ...}

A tick never waits for the log. :meth:`Log.note` costs a call and a tuple in a queue of bounded length.
:meth:`Log.flush` formats and writes; a node calls it before its loop, when it sends telemetry, and at its end. A run
without incidents notes no event between the first tick and the last, so it writes nothing then. The rare line at an
incident takes as long as a write to the page cache. A failure of the disk is counted and never raised, so that it does
not end the loop.
"""

from __future__ import annotations

import json
import os
import time
from collections import deque
from collections.abc import Callable
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import Final, TypeAlias

from manyhands.nodes.kernel.json_number import json_number
from manyhands.protocol.clock import Clock
from manyhands.protocol.messages import presentable

Value: TypeAlias = str | int | float | bool | None
"""A value of an event: a name, a count, a length of time or a reason, and never a private key."""

LOG_FOLDER: Final = "log"
LOG_SUFFIX: Final = ".jsonl"

QUEUE_EVENTS: Final = 256
"""The most events that wait to be written; further ones before the next flush are dropped and counted."""

MAX_LOG_BYTES: Final = 1024 * 1024
"""The greatest length of a process's log. Only two lines may follow: ``truncated``, and the process's ``end``."""

MAX_VALUE: Final = 500
"""The greatest length of an event's text, characters."""

_NS_PER_S: Final = 1_000_000_000
_LAST_WORDS_BYTES: Final = 4096


class LogEvent(StrEnum):
    """The kinds of events, each with its further fields. The value is the line's ``event``."""

    START = "start"  # the process has started: role, pid, certificate
    WELCOMED = "welcomed"  # the supervisor has accepted the node
    ESTABLISHED = "established"  # every link has shaken hands: peers
    GRANTED = "granted"  # the machine granted or refused a wish of a real-time process: wish, granted, said
    REFUSED = "refused"  # the supervisor or a peer refused the node: reason
    LOOP = "loop"  # the first tick is set: ticks
    FROZEN = "frozen"  # the ports of a peer are frozen: peer, tick
    RETURNED = "returned"  # a peer that was frozen or lost is active again: peer, tick
    LOST = "lost"  # the supervisor reports that a peer is lost: peer, tick
    JUMPED = "jumped"  # the node went on over ticks that it missed: tick, to
    RUNG = "rung"  # a rung of the ladder holds from this tick on: rung, tick
    STALE = "stale"  # a force is stale, and zero is applied until a new one comes: tick
    BREACH = "breach"  # an assumption of the certificate or a limit is broken: tick, reason
    CLIPPED = "clipped"  # a force was clipped for the first time: tick
    STARTED = "started"  # the supervisor has started a process: peer, pid
    EXITED = "exited"  # a process has ended: peer, code
    PHASE = "phase"  # the session has reached a phase: phase
    NOTICE = "notice"  # a message to the user: text
    INCIDENT = "incident"  # a message to the user about an incident: text
    VISIT = "visit"  # a message to the user about a guest at a seat: text
    FAULT = "fault"  # a message to the user about a failure: text
    TRUNCATED = "truncated"  # this log has its greatest length
    END = "end"  # the process ends: reason, ticks, dropped


class LogLevel(StrEnum):
    """The gravity of an event."""

    INFO = "info"
    WARNING = "warning"
    ERROR = "error"


LEVELS: Final[dict[LogEvent, LogLevel]] = {
    **dict.fromkeys(LogEvent, LogLevel.INFO),
    **dict.fromkeys(
        (
            *(
                LogEvent.FROZEN,
                LogEvent.LOST,
                LogEvent.JUMPED,
                LogEvent.RUNG,
                LogEvent.STALE,
                LogEvent.BREACH,
                LogEvent.CLIPPED,
            ),
            *(LogEvent.NOTICE, LogEvent.INCIDENT, LogEvent.TRUNCATED),
        ),
        LogLevel.WARNING,
    ),
    **dict.fromkeys((LogEvent.FAULT, LogEvent.REFUSED), LogLevel.ERROR),
}
"""The level of each event."""

_Entry: TypeAlias = tuple[int, int, LogEvent, dict[str, Value]]


class Log:
    """One process's log.

    Attributes:
        dropped: events that were not written, for the queue was full, the log too long, or the disk failed.
        trouble: the error of the first write that failed; None without one.
    """

    def __init__(
        self,
        path: Path | None,
        session: str,
        node: str,
        clock: Clock,
        wall: Callable[[], int] = time.time_ns,
        most_bytes: int = MAX_LOG_BYTES,
    ) -> None:
        """Open the log; a node that was started anew continues the file of its process before.

        Args:
            path: the file; None for a log that is not kept.
            session: the session's name.
            node: the name of the process.
            clock: a realtime clock for ``monotonic_ns``, whatever paces the session.
            wall: returns the time of day, ns since 1970.
            most_bytes: the greatest length of the file.
        """
        self._who = {"session": session, "node": node}
        self._clock, self._wall, self._most_bytes = clock, wall, most_bytes
        self._kept = path is not None
        self._queue: deque[_Entry] = deque()
        self._fd = -1
        self._length = 0
        self._full = False
        self.dropped = 0
        self.trouble: str | None = None
        if path is not None:
            self._open(path)

    def _open(self, path: Path) -> None:
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW
        try:
            self._fd = os.open(path, flags, 0o600)
            self._length = os.fstat(self._fd).st_size
        except OSError as error:
            self.trouble = error.strerror or str(error)

    def note(self, event: LogEvent, **data: Value) -> None:
        """Note an event with the present time, to be written at the next flush; cheap enough for a tick."""
        if not self._kept:
            return
        if len(self._queue) >= QUEUE_EVENTS:
            self.dropped += 1
            return
        self._queue.append((self._wall(), self._clock.now(), event, data))

    def flush(self) -> None:
        """Write the events that were noted; an error of the disk is counted and not raised."""
        queue = self._queue
        if not queue:
            return
        lines: list[bytes] = []
        while queue:
            line = self._admit(queue.popleft())
            lines += [line] if line else []
        self._write(lines)

    def close(self) -> None:
        """Write the events that were noted, and close the file. A second call does nothing."""
        self.flush()
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def _admit(self, entry: _Entry) -> bytes:
        """The line of an entry if the file has room for it; the end of a process always has room."""
        line = self._line(entry)
        if self._full or self._length + len(line) > self._most_bytes:
            if entry[2] is LogEvent.END and len(line) <= _LAST_WORDS_BYTES:
                return line if self._full else self._truncated(entry) + line
            self.dropped += 1
            return b"" if self._full else self._truncated(entry)
        self._length += len(line)
        return line

    def _truncated(self, entry: _Entry) -> bytes:
        self._full = True
        return self._line((entry[0], entry[1], LogEvent.TRUNCATED, {"most_bytes": self._most_bytes}))

    def _line(self, entry: _Entry) -> bytes:
        wall, now, event, data = entry
        day = datetime.fromtimestamp(wall // _NS_PER_S, UTC).strftime("%Y-%m-%dT%H:%M:%S")
        whole: dict[str, Value] = {
            "time": f"{day}.{wall % _NS_PER_S // 1000:06d}Z",
            "monotonic_ns": now,
            **self._who,
            "level": LEVELS[event].value,
            "event": event.value,
        }
        whole |= {name: _plain(value) for name, value in data.items() if name not in whole}
        if event is LogEvent.END and self.dropped:
            whole["dropped"] = self.dropped
        return json.dumps(whole, allow_nan=False).encode() + b"\n"

    def _write(self, lines: list[bytes]) -> None:
        if self._fd < 0:
            self.dropped += len(lines)
            return
        data = b"".join(lines)
        try:
            written = os.write(self._fd, data)
        except OSError as error:
            written, self.trouble = 0, self.trouble or error.strerror or str(error)
        if written < len(data):
            self._undo(written)
            self.dropped += len(lines)

    def _undo(self, written: int) -> None:
        """Take back the part of a batch that went to a full disk, so that the file has no half line."""
        self.trouble = self.trouble or "not all of a line was taken"
        try:
            if written:
                os.ftruncate(self._fd, os.fstat(self._fd).st_size - written)
        except OSError as error:
            self.trouble = error.strerror or str(error)


def _plain(value: Value) -> Value:
    """A value in the form that JSON writes, of bounded length; a number that is not finite is null."""
    if isinstance(value, float):
        return json_number(float(value))
    if value is None or isinstance(value, bool | int):
        return value
    return presentable(str(value))[:MAX_VALUE]  # also of any other type: a bad value must not end a loop


def log_path(directory: str, node: str) -> Path | None:
    """The path of a node's log in the run's directory; None for a guest, which has no such directory."""
    return Path(directory) / LOG_FOLDER / f"{node}{LOG_SUFFIX}" if directory else None
