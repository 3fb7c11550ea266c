"""Which sessions run on this machine under this user, and which of them is meant.

Each has a directory of its own below the temporary one (:mod:`manyhands.launch.run_directory`), which nobody else may
enter; there it says what it is (:class:`manyhands.nodes.observer.about.About`).
"""

from __future__ import annotations

from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

from manyhands.launch.run_directory import run_directories
from manyhands.nodes.log import LOG_FOLDER
from manyhands.nodes.observer.about import About, AboutError


class NoSession(Exception):
    """The session that was asked for does not run, or several could be meant; says which there are."""


@dataclass(frozen=True)
class Running:
    """A session that runs: its directory, and what it says of itself."""

    directory: Path
    about: About


def running_sessions() -> list[Running]:
    """The sessions that run, the oldest first; one that is just beginning or ending may be left out."""
    found = []
    for directory in run_directories():
        try:
            found.append(Running(directory, About.load(directory)))
        except AboutError:
            continue  # not yet begun, over since, or another version's
    return sorted(found, key=lambda running: (running.about.started, running.about.session, running.about.pid))


def find_session(name: str | None) -> Running:
    """The running session of this name, or the only one.

    Args:
        name: its name, or its supervisor's process id, which tells two of one name apart; None for the only one.

    Raises:
        NoSession: there is none, or several.
    """
    running = running_sessions()
    if not running:
        raise NoSession("found no running session; start one with: manyhands launch SESSION")
    wanted = [r for r in running if name is None or name in (r.about.session, str(r.about.pid))]
    listed = ", ".join(f"{r.about.session} (process {r.about.pid})" for r in running)
    if len(wanted) > 1:
        which = "several" if name is None else f"{len(wanted)} of the name {name!r}"
        raise NoSession(f"found {which} running: {listed}; expected one, named by --session NAME or its process id")
    if not wanted:
        close = get_close_matches(name or "", [r.about.session for r in running], n=1)
        hint = f"; did you mean {close[0]!r}?" if close else ""
        raise NoSession(f"found no running session {name!r}; expected one of {listed}{hint}")
    return wanted[0]


def session_in(directory: Path) -> Running:
    """The running session of this directory: its own below the temporary one, or the one that its user keeps.

    Raises:
        NoSession: it is of none that runs.
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
    except OSError:  # one of them is not there
        return False
