"""The running sessions of this user on this machine.

Each session has its own directory below the temporary one (:mod:`manyhands.launch.run.directory`), which no other user
may enter. A file there describes the session (:class:`manyhands.nodes.monitor.session_state.About`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from manyhands.launch.run.directory import run_directories
from manyhands.nodes.kernel.bundle import REALTIME
from manyhands.nodes.monitor.session_state import About, AboutError


@dataclass(frozen=True)
class Running:
    """A session that runs: its directory, and its description of itself."""

    directory: Path
    about: About


def running_sessions() -> list[Running]:
    """The sessions that run, the oldest first; a session that is just beginning or ending may be absent."""
    found = []
    for directory in run_directories():
        try:
            found.append(Running(directory, About.load(directory)))
        except AboutError:
            continue  # it has not yet begun, has just ended, or belongs to another version
    return sorted(found, key=lambda running: (running.about.started, running.about.session, running.about.pid))


def twins(own: Running) -> Iterator[str]:
    """A sentence for each other run of the same session, where both are in real time.

    A run asks after it has described itself in its directory. So of two that begin at the same time at least one finds
    the other.
    """
    for other in running_sessions() if own.about.clock == REALTIME else ():
        about = other.about
        if other.directory != own.directory and (about.session, about.clock) == (own.about.session, REALTIME):
            apart = f"--running {about.pid} names the other, --running {own.about.pid} this one"
            yield (
                f"{about.session} runs here twice, the other time as process {about.pid}: the two share devices and "
                f"processors" + ("" if about.pid == own.about.pid else f"; {apart}")
            )
