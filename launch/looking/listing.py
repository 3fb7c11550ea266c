"""What `manyhands list` shows: the sessions that run, how each is, and how its nodes are."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Final

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from manyhands.launch.looking.sessions import Running
from manyhands.launch.looking.watching import Source
from manyhands.launch.node_states import NodeState
from manyhands.nodes.json_number import json_number
from manyhands.nodes.observer.scene import Scene
from manyhands.protocol.clock import Clock, Duration, Instant, from_seconds
from manyhands.protocol.transport import TransportError
from manyhands.protocol.transport.gallery import Visit, await_any

GLANCE: Final = from_seconds(1.5)
"""The longest that a glance at sessions takes, however little they say."""


@dataclass(frozen=True, eq=False)
class Glance:
    """A session and what is seen of it meanwhile."""

    scene: Scene
    source: Source

    @property
    def settled(self) -> bool:
        """Whether all was seen that a glance can show: how the session is, and the rate of each node that runs."""
        condition, nodes = self.scene.condition, self.scene.nodes.values()
        return condition is not None and all(
            node.rate is not None for node in nodes if node.state == NodeState.RUNNING and not node.silent
        )


def glance(glances: Sequence[Glance], clock: Clock, await_frames: Callable[[Sequence[Glance], Duration], None]) -> None:
    """Take in what the sessions say until each has settled, or for :data:`GLANCE`.

    Args:
        glances: the sessions.
        clock: what tells how late it is.
        await_frames: returns as soon as any of these sessions says something, or after so long.
    """
    until = Instant(clock.now() + GLANCE)
    while (unsettled := [one for one in glances if not one.settled]) and (now := clock.now()) < until:
        await_frames(unsettled, Duration(until - now))
        for one in unsettled:
            frame = one.source.recv(Duration(0))
            while frame is not None:
                one.scene.take(frame, clock.now())
                frame = one.source.recv(Duration(0)) if clock.now() < until else None


@contextmanager
def visits(running: Sequence[Running]) -> Iterator[dict[Glance, Visit]]:
    """A visit to each of the sessions, left again afterwards; one that cannot be looked at shows nothing."""
    with ExitStack() as stack:
        found = {}
        for one in running:
            try:
                visit = Visit(one.directory)
            except TransportError:  # it has just ended, or its directory is one that no socket can be in
                continue
            stack.callback(visit.close)
            found[Glance(Scene(one.about), visit)] = visit
        yield found


def look_at(running: Sequence[Running], clock: Clock) -> list[Scene]:
    """How these sessions are, after a glance at all of them at once."""
    with visits(running) as found:

        def await_frames(glances: Sequence[Glance], timeout: Duration) -> None:
            await_any([found[one] for one in glances], timeout)

        glance(list(found), clock, await_frames)
        return [one.scene for one in found]


def session_object(scene: Scene) -> dict[str, Any]:
    """A session as ``--json`` prints it."""
    about, condition = scene.about, scene.condition
    return {
        "session": about.session,
        "id": about.id,
        "pid": about.pid,
        "clock": about.clock,
        "since": datetime.fromtimestamp(about.started, UTC).isoformat(timespec="milliseconds"),
        "phase": None if condition is None else condition.phase,
        "tick": scene.tick,
        "rate": rounded(scene.rate),
        "health": scene.health.value,
        "nodes": {
            node.name: {
                "role": node.role.value,
                "state": node.state,
                "tick": node.tick,
                "rate": rounded(node.rate),
                "health": node.health.value,
            }
            for node in scene.nodes.values()
        },
    }


def rounded(rate: float | None) -> float | None:
    """A rate to a tenth of a tick a second, which is more than is known."""
    return None if (known := json_number(rate)) is None else round(known, 1)


def print_sessions(out: Console, scenes: Sequence[Scene], time: float) -> None:
    """Print them as tables; ``time`` is now, seconds since 1970."""
    sessions = _table("running sessions", "session", "pid", "clock", "up since", "tick", "rate [Hz]", "health")
    for scene in scenes:
        about = scene.about
        sessions.add_row(
            escape(about.session),
            str(about.pid),
            escape(about.clock),
            _since(about.started, time),
            str(scene.tick),
            shown(scene.rate),
            scene.health.value,
        )
    out.print(sessions)
    for scene in scenes:
        nodes = _table(f"{scene.about.session}: nodes", "node", "role", "state", "rate [Hz]", "health")
        for node in scene.nodes.values():
            nodes.add_row(escape(node.name), node.role.value, escape(node.state), shown(node.rate), node.health.value)
        out.print(nodes)


def shown(rate: float | None) -> str:
    """A rate in a table; nothing before it is known."""
    return "" if rate is None else f"{rate:.0f}"


def _since(started: float, time: float) -> str:
    when = datetime.fromtimestamp(started).astimezone().isoformat(sep=" ", timespec="seconds")[:19]
    up = max(0, round(time - started))
    return f"{when} ({up // 3600}:{up // 60 % 60:02}:{up % 60:02})"


def _table(title: str, *columns: str) -> Table:
    table = Table(title=escape(title), title_justify="left")
    for column in columns:
        table.add_column(column, justify="right" if column in ("pid", "tick", "rate [Hz]") else "left", overflow="fold")
    return table
