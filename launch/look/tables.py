"""The tables of `manyhands top`.

`top --all` shows the running sessions with their nodes and states. `top` shows the figures of every node of one
session, and below them the links that are not well, notices, incidents and faults.
"""

from __future__ import annotations

import os
import select
import sys
import termios
import tty
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Final

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from manyhands.design.models.axis import Units
from manyhands.launch.look.display import (
    COLUMNS,
    figure_cells,
    figure_table,
    heading,
    promise_lines,
    ranks,
    say,
    world_lines,
)
from manyhands.launch.look.sessions import Seeing, Source
from manyhands.launch.run.running import Running
from manyhands.launch.run.states import NodeState
from manyhands.nodes.kernel.json_number import json_figures, json_number
from manyhands.nodes.monitor.given import FIGURES
from manyhands.nodes.monitor.health import Health, summary
from manyhands.nodes.monitor.session_state import LiveNode, LiveSession
from manyhands.protocol.clock import Clock, Duration, Instant, from_seconds
from manyhands.protocol.plain import written
from manyhands.protocol.transport import TransportError
from manyhands.protocol.transport.broadcast import Visit, await_any

GLANCE: Final = from_seconds(1.5)
"""The longest time for a glance at sessions, however few messages they send."""


@dataclass(frozen=True, eq=False)
class Glance:
    """The state of a session, and the source of its frames, during a glance."""

    live: LiveSession
    source: Source

    @property
    def settled(self) -> bool:
        """Whether the state has all that a glance can show: the session's condition and each running node's rate."""
        condition, nodes = self.live.condition, self.live.nodes.values()
        return condition is not None and all(
            node.rate is not None for node in nodes if node.state == NodeState.RUNNING and not node.silent
        )


def glance(glances: Sequence[Glance], clock: Clock, await_frames: Callable[[Sequence[Glance], Duration], None]) -> None:
    """Take the sessions' frames into their states until each has settled, at most for :data:`GLANCE`.

    Args:
        glances: the sessions.
        clock: the clock that bounds the glance.
        await_frames: returns when any of these sessions has sent a frame, or after the given time.
    """
    until = Instant(clock.now() + GLANCE)
    while (unsettled := [one for one in glances if not one.settled]) and (now := clock.now()) < until:
        await_frames(unsettled, Duration(until - now))
        for one in unsettled:
            frame = one.source.recv(Duration(0))
            while frame is not None:
                one.live.take(frame, clock.now())
                frame = one.source.recv(Duration(0)) if clock.now() < until else None


@contextmanager
def visits(running: Sequence[Running]) -> Iterator[dict[Glance, Visit]]:
    """A connection to the broadcast of each session, closed on exit; sessions that cannot be observed are left out."""
    with ExitStack() as stack:
        found = {}
        for one in running:
            try:
                visit = Visit(one.directory)
            except TransportError:  # it has just ended, or no socket can be in its directory
                continue
            stack.callback(visit.close)
            found[Glance(LiveSession(one.about), visit)] = visit
        yield found


def look_at(running: Sequence[Running], clock: Clock) -> list[LiveSession]:
    """The states of these sessions, after a glance at all of them at once."""
    with visits(running) as found:

        def await_frames(glances: Sequence[Glance], timeout: Duration) -> None:
            await_any([found[one] for one in glances], timeout)

        glance(list(found), clock, await_frames)
        return [one.live for one in found]


def session_object(live: LiveSession) -> dict[str, Any]:
    """The object that ``--json`` prints for a session."""
    about, condition = live.about, live.condition
    return {
        "session": about.session,
        "id": about.id,
        "pid": about.pid,
        "clock": about.clock,
        "since": datetime.fromtimestamp(about.started, UTC).isoformat(timespec="milliseconds"),
        "phase": None if condition is None else condition.phase,
        "tick": live.tick,
        "rate": rounded(live.rate),
        "health": live.health.value,
        "promises": [written(row) for row in live.promises],
        **({"seats": {seat.name: seat.as_plain() for seat in live.lobby}} if about.seats else {}),
        "nodes": {
            node.name: {
                "role": node.role.value,
                "state": node.state,
                "tick": node.tick,
                "rate": rounded(node.rate),
                "health": node.health.value,
            }
            for node in live.nodes.values()
        },
    }


def rounded(rate: float | None) -> float | None:
    """A rate rounded to 0.1 Hz, which is finer than its accuracy; None if it is unknown."""
    return None if (known := json_number(rate)) is None else round(known, 1)


def print_sessions(out: Console, sessions: Sequence[LiveSession], time: float) -> None:
    """Print the sessions and their nodes as tables; ``time`` is now, in seconds since 1970."""
    table = _table("running sessions", "session", "pid", "clock", "up since", "tick", "rate [Hz]", "health")
    for live in sessions:
        about = live.about
        table.add_row(
            escape(about.session),
            str(about.pid),
            escape(about.clock),
            _since(about.started, time),
            str(live.tick),
            shown(live.rate),
            live.health.value,
        )
    out.print(table)
    for live in sessions:
        nodes = _table(f"{live.about.session}: nodes", "node", "role", "state", "rate [Hz]", "health")
        for node in live.nodes.values():
            nodes.add_row(escape(node.name), node.role.value, escape(node.state), shown(node.rate), node.health.value)
        out.print(nodes)
        for line in (summary(live.promises), *(seat.sentence() for seat in live.lobby)):
            if line:
                say(out, f"{live.about.session}: {line}")


def shown(rate: float | None) -> str:
    """A rate in a table; empty while it is unknown."""
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


REFRESH: Final = from_seconds(0.2)
"""The shortest time between two updates on a terminal."""

PRINT_EVERY: Final = from_seconds(2.0)
"""The same where there is no terminal, and each update prints a table."""

STYLES: Final = {
    Health.FREE: "dim",
    Health.OK: "green",
    Health.WAITING: "dim",
    Health.ENFORCED: "cyan",
    Health.LATE: "yellow",
    Health.SLOW: "yellow",
    Health.FROZEN: "cyan",
    Health.SILENT: "magenta",
    Health.AWAY: "red",
    Health.BROKEN: "red",
}
"""The style in which a terminal shows the word for a health."""

_FIXED: Final = ("node", "role", "state", "tick", "rate\n[Hz]")
_MOST_SENTENCES: Final = 8  # shown of each kind, the latest ones


def top_object(live: LiveSession) -> dict[str, Any]:
    """The object that ``--json`` prints: that of :func:`session_object`, with figures, links, notices and faults."""
    found, links = session_object(live), live.felt_links
    for name, node in live.nodes.items():
        plain = json_figures(node.figures)
        keys = {*(figure.name for figure, _ in COLUMNS), *FIGURES} & plain.keys()
        found["nodes"][name]["figures"] = {key: plain[key] for key in sorted(keys)}
    found["links"] = [{"between": list(link.ends), "health": live.link_health(link).value} for link in live.about.links]
    found |= {"wave_links": {name: felt.as_plain() for name, felt in links.items()}} if links else {}
    condition = live.condition
    for kind in ("notices", "incidents", "faults", "visits"):
        found[kind] = [] if condition is None else list(getattr(condition, kind))
    return found


def picture(live: LiveSession, width: int, title: str | None = None) -> RenderableType:
    """Table and sentences, for a terminal with ``width`` columns; figures without room are left out.

    Args:
        live: the session.
        width: of the terminal.
        title: names the session; by default its name, process and clock.
    """
    about, condition = live.about, live.condition
    phase = "connecting" if condition is None else f"{condition.phase}, {condition.elapsed:.0f} s"
    named = title or f"{about.session} (process {about.pid}, {about.clock} clock)"
    kinds = [kind for node in about.nodes for kind in about.kinds_at(node)]
    units = Units.of(kinds)
    titles = [*_FIXED, *(heading(column.title, units) for _, column in COLUMNS), "health"]
    rows: list[list[str | Text]] = [
        [*_cells(node), Text(node.health, style=STYLES[node.health])] for node in live.nodes.values()
    ]
    table, _ = figure_table(f"{named}: {phase}; {live.health}", titles, rows, ranks(units), width)
    return Group(table, *(Text(text, style=style) for text, style in sentences(live)))


def sentences(live: LiveSession) -> Iterator[tuple[str, str]]:
    """The sentences below the table, each with a style: seats, promises, links that are not well, notices, incidents,
    faults.
    """
    for seat in live.lobby:
        yield seat.sentence(), STYLES[seat.health]
    yield from promise_lines(live.promises, () if live.condition is None else live.condition.notices)
    for link in live.about.links:
        health = live.link_health(link)
        if health not in (Health.OK, Health.FREE):
            yield f"link {link.ends[0]} - {link.ends[1]}: {health}", STYLES[health]
    for node in live.nodes.values():
        yield from ((line, "") for line in world_lines(node.figures))
    for name, felt in live.felt_links.items():
        yield felt.sentence(name), "yellow" if felt.holding else ""
    condition = live.condition
    if condition is None:
        return
    warnings = (condition.notices, "notice", "yellow"), (condition.incidents, "incident", "yellow")
    for texts, kind, style in (*warnings, (condition.faults, "fault", "red")):
        if len(texts) > _MOST_SENTENCES:
            yield f"{kind}s: {len(texts) - _MOST_SENTENCES} earlier ones", style
        for text in texts[-_MOST_SENTENCES:]:
            yield f"{kind}: {text}", style


def _cells(node: LiveNode) -> list[str]:
    figures = figure_cells(node.figures)
    tick = "" if node.received is None else str(node.tick)
    return [node.name, node.role.value, node.state, tick, shown(rounded(node.rate)), *figures]


def show_live(live: LiveSession, seeing: Seeing, console: Console, stop: Callable[[], bool]) -> None:
    """Show a session on a terminal until it is over, or ``stop`` returns True (the user pressed q)."""
    shown_at: Instant | None = None
    with Live(console=console, auto_refresh=False, screen=True, vertical_overflow="crop") as display:
        for seen in seeing:
            if stop():
                return
            if shown_at is None or seen.at - shown_at >= REFRESH:
                shown_at = seen.at
                display.update(picture(live, console.width), refresh=True)


def show_repeatedly(live: LiveSession, seeing: Seeing, show: Callable[[LiveSession], None]) -> None:
    """Show a session where there is no terminal: every :data:`PRINT_EVERY`, and once more at its end."""
    shown_at: Instant | None = None
    last: Instant | None = None
    for seen in seeing:
        last = seen.at
        shown_at = seen.at if shown_at is None else shown_at
        if seen.at - shown_at >= PRINT_EVERY:
            shown_at = seen.at
            show(live)
    if last is None or shown_at != last:
        show(live)


@contextmanager
def quit_key() -> Iterator[Callable[[], bool]]:
    """Yields a function that returns whether q was pressed; always False where standard input is no terminal."""
    if not sys.stdin.isatty():
        yield lambda: False
        return
    fd = sys.stdin.fileno()
    before = termios.tcgetattr(fd)
    try:
        tty.setcbreak(fd)  # keys are readable one by one, and Ctrl-C is still a signal
        yield lambda: bool(select.select([fd], [], [], 0)[0]) and b"q" in os.read(fd, 64).lower()
    finally:
        termios.tcsetattr(fd, termios.TCSADRAIN, before)
