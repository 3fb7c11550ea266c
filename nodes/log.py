"""What happened to one process, for whoever wants to know afterwards: a file of JSON lines, one for each event.

    {"time": "2026-01-02T03:04:05.678901Z", "monotonic_ns": 1, "session": "s", "node": "dx", "level": "info",
     "event": "loop", ...}

A tick never waits for it. To note an event costs a call and a tuple in a queue of bounded length; formatting and
writing are :meth:`Log.flush`'s, which a node calls where it has time: before its loop, when it sends telemetry, and at
its end. In a run without incidents nothing is noted between the first tick and the last, so nothing is written then;
the rare line at an incident takes as long as a write to the page cache takes. Whatever the disk does is counted and
never raised: a loop outlives its log.
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

from manyhands.nodes.json_number import json_number
from manyhands.protocol.clock import Clock
from manyhands.protocol.messages import presentable

Value: TypeAlias = str | int | float | bool | None
"""What an event may carry; a private key never is such a value: only names, counts, lengths of time and reasons are."""

LOG_FOLDER: Final = "log"
LOG_SUFFIX: Final = ".jsonl"

QUEUE_EVENTS: Final = 256
"""Events that wait to be written; more than that between two flushes are counted and dropped."""

MAX_LOG_BYTES: Final = 1024 * 1024
"""Longest log of one process, but for its last two lines: the one that says so, and the process's end."""

MAX_VALUE: Final = 500
"""Longest text of an event, characters."""

_NS_PER_S: Final = 1_000_000_000
_LAST_WORDS_BYTES: Final = 4096


class LogEvent(StrEnum):
    """Everything that is noted. The value is the line's ``event``."""

    START = "start"  # the process: role, pid, certificate
    WELCOMED = "welcomed"  # by the supervisor
    ESTABLISHED = "established"  # every link: peers
    GRANTED = "granted"  # what the machine permits a real-time process, by name
    REFUSED = "refused"  # by the supervisor, or by a peer at the handshake: reason
    LOOP = "loop"  # the first tick is set: ticks
    FROZEN = "frozen"  # the ports of a peer: peer, tick
    RETURNED = "returned"  # a peer that was frozen or lost: peer, tick
    LOST = "lost"  # a peer, by the supervisor's word: peer, tick
    JUMPED = "jumped"  # over ticks that this node missed: tick, to
    RUNG = "rung"  # of the ladder, from this tick on: rung, tick
    STALE = "stale"  # a force; zero is applied until there is a new one: tick
    BREACH = "breach"  # of what the certificate assumes, or of a limit: tick, reason
    CLIPPED = "clipped"  # a force, the first time: tick
    STARTED = "started"  # a process, by the supervisor: peer, pid
    EXITED = "exited"  # a process, seen by the supervisor: peer, code
    PHASE = "phase"  # of the session: phase
    NOTICE = "notice"  # as the user was told it: text
    INCIDENT = "incident"  # likewise
    FAULT = "fault"  # likewise
    TRUNCATED = "truncated"  # this log is as long as it may get
    END = "end"  # the process's: reason, ticks, dropped


class LogLevel(StrEnum):
    """How grave an event is."""

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
        dropped: events that were not written: the queue was full, the log too long, or the disk did not take them.
        trouble: what the disk said when it first did not take a line; None while it does.
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
        """Open the log; a file that is there is continued, by a node that was started anew.

        Args:
            path: the file; None for a log that is not kept.
            session: the session's name.
            node: the process's.
            clock: for ``monotonic_ns``; a realtime one, whatever paces the session.
            wall: the time of day, ns since 1970.
            most_bytes: how long the file may get.
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
        """Note an event of now, to be written at the next flush; cheap enough for a tick in which something happens."""
        if not self._kept:
            return
        if len(self._queue) >= QUEUE_EVENTS:
            self.dropped += 1
            return
        self._queue.append((self._wall(), self._clock.now(), event, data))

    def flush(self) -> None:
        """Write what was noted; nothing that goes wrong with that is raised."""
        queue = self._queue
        if not queue:
            return
        lines: list[bytes] = []
        while queue:
            line = self._admit(queue.popleft())
            lines += [line] if line else []
        self._write(lines)

    def close(self) -> None:
        """Write what was noted, and close the file. A second time does nothing."""
        self.flush()
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def _admit(self, entry: _Entry) -> bytes:
        """The line of an entry if the file has room for it: the end of a process always has."""
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
        """Leave no half line: what of a batch went to a full disk is taken back."""
        self.trouble = self.trouble or "not all of a line was taken"
        try:
            if written:
                os.ftruncate(self._fd, os.fstat(self._fd).st_size - written)
        except OSError as error:
            self.trouble = error.strerror or str(error)


def _plain(value: Value) -> Value:
    """A value as JSON has it, of bounded length; what is infinite or not a number is null."""
    if isinstance(value, float):
        return json_number(float(value))
    if value is None or isinstance(value, bool | int):
        return value
    return presentable(str(value))[:MAX_VALUE]  # also what a type checker would have refused: a loop outlives its log


def log_path(directory: str, node: str) -> Path | None:
    """Where the log of a node is, by the run's own directory; None for a node on another machine, which has none."""
    return Path(directory) / LOG_FOLDER / f"{node}{LOG_SUFFIX}" if directory else None
