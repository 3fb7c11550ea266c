"""The loop of whoever looks on at one running session: frames of its gallery, until there is a reason to stop.

It ends when the session says that it is over, when the supervisor's process has ended, or at a deadline. It waits for
frames alone and reads no clock but the one that it is handed.
"""

from __future__ import annotations

import os
import select
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Protocol, TypeAlias

from manyhands.launch.looking.sessions import Running
from manyhands.launch.node_states import Phase
from manyhands.nodes.observer.about import ABOUT
from manyhands.nodes.observer.scene import Scene
from manyhands.protocol.clock import Clock, Duration, Instant, from_seconds
from manyhands.protocol.messages import Condition, Observation
from manyhands.protocol.transport.gallery import Visit

LOOK: Final = from_seconds(0.2)
"""The longest wait for a frame: so often it is seen to that the session is still there, whatever it says."""


class Source(Protocol):
    """Where frames come from: a :class:`Visit`, or a test's list."""

    def recv(self, timeout: Duration | None) -> bytes | None:
        """The next frame, or None if none came within ``timeout``."""
        ...


@dataclass(frozen=True, eq=False)
class Seen:
    """What was seen at an instant: a message, or None where nothing came for a while."""

    at: Instant
    message: Observation | Condition | None


Seeing: TypeAlias = Iterator[Seen]


def watch(source: Source, scene: Scene, clock: Clock, gone: Callable[[], bool], until: Instant | None = None) -> Seeing:
    """Take what comes into ``scene``, and tell of each, in order.

    Args:
        source: where frames come from.
        scene: of the session.
        clock: what tells when they came.
        gone: whether the session's supervisor is no more.
        until: when to stop; None for the session's end.

    Yields:
        Each message, and one without a message at least every :data:`LOOK` where none comes, so that whoever watches
        can look at other things too. The last is the Condition that says that the session is over, if it was heard.
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
        message = scene.take(frame, at)
        yield Seen(at, message)
        if isinstance(message, Condition) and message.phase == Phase.OVER:
            return


@contextmanager
def presence(running: Running) -> Iterator[Callable[[], bool]]:
    """Whether a session's supervisor is gone; by its process, not by its number, which another one may get."""
    about = running.directory / ABOUT
    process: int | None = None
    try:
        process = os.pidfd_open(running.about.pid)
    except OSError:  # it is gone already, or its process cannot be watched here
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
def visiting(running: Running, clock: Clock, until: Instant | None = None) -> Iterator[tuple[Scene, Seeing]]:
    """Look on at a running session; yields its scene, and what is seen.

    Raises:
        TransportError: it cannot be looked at.
    """
    scene = Scene(running.about)
    with presence(running) as gone:
        visit = Visit(running.directory)
        try:
            yield scene, watch(visit, scene, clock, gone, until)
        finally:
            visit.close()
