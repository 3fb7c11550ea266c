"""Which of this user's running sessions is meant (:mod:`manyhands.launch.run.running`), and the loop that observes it.

The loop (:func:`watch`) takes frames of the session's broadcast. It ends when the session reports its end, when the
supervisor's process has ended, or at a deadline. It waits for frames only, and its only clock is the given one.
"""

from __future__ import annotations

import os
import select
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Final, Protocol, TypeAlias

from manyhands.launch.run.running import Running, running_sessions
from manyhands.launch.run.states import SessionPhase
from manyhands.nodes.kernel.log import LOG_FOLDER
from manyhands.nodes.monitor.session_state import ABOUT, LiveSession
from manyhands.protocol.clock import Clock, Duration, Instant, from_seconds
from manyhands.protocol.messages import Condition, Observation
from manyhands.protocol.transport.broadcast import Visit


class NoSession(Exception):
    """The requested session does not run, or the request fits several; the message lists the running ones."""


def find_session(name: str | None) -> Running:
    """The running session of this name, or the only one.

    Args:
        name: its name, or its supervisor's process id, which distinguishes sessions of one name; None for the only one.

    Raises:
        NoSession: no session fits, or several do.
    """
    running = running_sessions()
    if not running:
        raise NoSession("found no running session; start one with: manyhands launch SESSION")
    wanted = [r for r in running if name is None or name in (r.about.session, str(r.about.pid))]
    listed = ", ".join(f"{r.about.session} (process {r.about.pid})" for r in running)
    if len(wanted) > 1:
        which = "several" if name is None else f"{len(wanted)} of the name {name!r}"
        raise NoSession(f"found {which} running: {listed}; expected one, named by --running NAME or its process id")
    if not wanted:
        close = get_close_matches(name or "", [r.about.session for r in running], n=1)
        hint = f"; did you mean {close[0]!r}?" if close else ""
        raise NoSession(f"found no running session {name!r}; expected one of {listed}{hint}")
    return wanted[0]


def session_in(directory: Path) -> Running:
    """The running session with this directory: its own below the temporary one, or that of ``launch --directory``.

    Raises:
        NoSession: no running session has this directory.
    """
    running = running_sessions()
    for one in running:
        if _same(one.directory, directory) or _same(one.directory / LOG_FOLDER, directory / LOG_FOLDER):
            return one
    listed = ", ".join(f"{one.about.session} in {one.directory}" for one in running) or "none runs"
    raise NoSession(f"{directory}: found no running session's directory; expected that of one: {listed}")


def _same(one: Path, other: Path) -> bool:
    try:
        return one.samefile(other)
    except OSError:  # one of them does not exist
        return False


LOOK: Final = from_seconds(0.2)
"""The longest wait for a frame; after each wait without one, the loop checks that the session still exists."""


class Source(Protocol):
    """Where frames come from: a :class:`Visit`, or a test's list."""

    def recv(self, timeout: Duration | None) -> bytes | None:
        """The next frame, or None if none came within ``timeout``."""
        ...


@dataclass(frozen=True, eq=False)
class Seen:
    """What was seen at an instant: a message, or None where none came within :data:`LOOK`."""

    at: Instant
    message: Observation | Condition | None


Seeing: TypeAlias = Iterator[Seen]


def watch(
    source: Source, live: LiveSession, clock: Clock, gone: Callable[[], bool], until: Instant | None = None
) -> Seeing:
    """Take the frames of ``source`` into ``live``, and yield each message in order.

    Args:
        source: where frames come from.
        live: the state of the session.
        clock: the clock that gives the instant of each frame.
        gone: whether the session's supervisor has ended.
        until: when to stop; None for the session's end.

    Yields:
        Each message; where none comes, a Seen without a message at least every :data:`LOOK`, so that the caller can
        check other things. The last message is the Condition that reports the session's end, if it was received.
    """
    while True:
        now = clock.now()
        if until is not None and now >= until:
            return
        wait = LOOK if until is None else min(LOOK, Duration(until - now))
        frame = source.recv(wait)
        if frame is None:
            if gone():
                return
            yield Seen(clock.now(), None)
            continue
        at = clock.now()
        message = live.take(frame, at)
        yield Seen(at, message)
        if isinstance(message, Condition) and message.phase == SessionPhase.OVER:
            return


@contextmanager
def presence(running: Running) -> Iterator[Callable[[], bool]]:
    """Yields a function that returns whether the supervisor has ended.

    It watches the process itself, since the kernel may give the same process id to a new process.
    """
    about = running.directory / ABOUT
    process: int | None = None
    try:
        process = os.pidfd_open(running.about.pid)
    except OSError:  # the process has ended already, or this kernel cannot watch it
        alive = Path(f"/proc/{running.about.pid}")
    try:
        if process is None:
            yield lambda: not (alive.exists() and about.exists())
        else:
            fd = process
            yield lambda: bool(select.select([fd], [], [], 0)[0]) or not about.exists()
    finally:
        if process is not None:
            os.close(process)


@contextmanager
def visiting(running: Running, clock: Clock, until: Instant | None = None) -> Iterator[tuple[LiveSession, Seeing]]:
    """Observe a running session; yields its state, and the iterator of :func:`watch`.

    Raises:
        TransportError: its broadcast cannot be received.
    """
    live = LiveSession(running.about)
    with presence(running) as gone:
        visit = Visit(running.directory)
        try:
            yield live, watch(visit, live, clock, gone, until)
        finally:
            visit.close()
