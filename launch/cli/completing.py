"""What a shell is told when somebody presses Tab: running sessions, their topics, session files, nodes.

Asked at every Tab, so each answer is found in files, without asking a session; whatever is wrong is no answer.
"""

from __future__ import annotations

import importlib.resources
from collections.abc import Iterable
from pathlib import Path

import typer

from manyhands.launch.looking.sessions import NoSession, find_session, running_sessions
from manyhands.launch.looking.topics_named import named_topics, session_of
from manyhands.launch.session import SessionError
from manyhands.launch.shipped import load_named

_MOST = 500  # answers


def running_names(incomplete: str) -> list[str]:
    """Names of running sessions; the process ids of those that share one."""
    running = [one.about for one in running_sessions()]
    names = [about.session for about in running]
    return _beginning(incomplete, (str(one.pid) if names.count(one.session) > 1 else one.session for one in running))


def topic_names(ctx: typer.Context, incomplete: str) -> list[str]:
    """Topics of the session that is meant, in full where what is there begins like that."""
    try:
        about = find_session(ctx.params.get("session") or session_of(incomplete)).about
    except NoSession:
        return []
    topics = named_topics(about)
    if incomplete.startswith("/"):
        return _beginning(incomplete, (named.full for named in topics.values()))
    return _beginning(incomplete, topics)


def session_files(incomplete: str) -> list[str]:
    """Session files and folders, as far as the path goes, and the shipped sessions."""
    shipped = importlib.resources.files("manyhands.launch") / "sessions"
    names = sorted(file.name for file in shipped.iterdir() if file.name.endswith(".yaml"))
    folder, _, start = incomplete.rpartition("/")
    prefix = f"{folder}/" if "/" in incomplete else ""
    try:
        entries = sorted(Path(prefix or ".").expanduser().iterdir())
    except OSError:
        entries = []
    here = []
    for path in entries:
        if path.name.startswith(".") and not start.startswith("."):
            continue
        if path.suffix in (".yaml", ".yml"):
            here.append(f"{prefix}{path.name}")
        elif path.is_dir():
            here.append(f"{prefix}{path.name}/")
    return _beginning(incomplete, dict.fromkeys([*here, *names]))


def node_names(ctx: typer.Context, incomplete: str) -> list[str]:
    """Nodes and observers of the session file that was named before."""
    session = ctx.params.get("session")
    if session is None:
        return []
    try:
        loaded = load_named(session, ctx.params.get("overrides") or [])
    except (SessionError, OSError):
        return []
    return _beginning(incomplete, [*loaded.roles, *loaded.observers])


def _beginning(incomplete: str, names: Iterable[str]) -> list[str]:
    return [name for name in names if name.startswith(incomplete)][:_MOST]
