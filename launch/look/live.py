"""What a person sees while a session runs: the table of `manyhands top`, or plain lines where there is no terminal."""

from __future__ import annotations

from collections.abc import Mapping
from types import TracebackType
from typing import Final, Self

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.text import Text

from manyhands.launch.look.display import say
from manyhands.launch.look.tables import picture
from manyhands.launch.output import has_room, lost_at
from manyhands.launch.run.broadcast import condition_of
from manyhands.launch.run.outcome import Progress
from manyhands.launch.run.states import SessionPhase
from manyhands.nodes.monitor.session_state import About, LiveSession
from manyhands.nodes.rows import figures as names
from manyhands.nodes.rows.own_ticks import session_tick
from manyhands.nodes.rows.promises import Promise
from manyhands.protocol.clock import Instant, from_seconds
from manyhands.protocol.messages import Observation, Telemetry

_LINE_EVERY: Final = 2.0  # s between two lines of progress without a terminal
_LATE_SHOWN: Final = 4


class LiveTable:
    """Shows a run's progress on a console; call it with each :class:`Progress`.

    It never waits for a console that takes no output now, since the session would wait as well.

    Attributes:
        announced: notices that were printed while the session ran, and need not be repeated at its end.
    """

    def __init__(self, console: Console, title: str, about: About) -> None:
        """Show the session ``about`` under ``title``."""
        self._console, self._title, self._about = console, title, about
        self._session = LiveSession(about)
        self._taken: dict[str, Telemetry] = {}  # the telemetry of each node that the table has
        # the supervisor's loop refreshes it, so no second thread is needed
        self._live = Live(console=console, auto_refresh=False, transient=True) if console.is_terminal else None
        self._line_at = 0.0
        self._phase: SessionPhase | None = None
        self._printed: set[str] = set()
        self._lacking: set[str] = set()  # devices of which a line has said that they lack their force
        self.announced: set[str] = set()
        self._lost: str | None = None

    def __enter__(self) -> Self:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.stop()

    def __call__(self, progress: Progress) -> str | None:
        """Show ``progress``; when the console is lost, returns an incident that reports it, once."""
        if self._lost is None and has_room(self._console.file):
            self._show(progress)
            self._lost = lost_at(self._console.file)
            if self._lost is not None:
                return f"the display was lost ({self._lost}); the session goes on without it"
        return None

    def _show(self, progress: Progress) -> None:
        if self._live is not None:
            self._live.update(self._render(progress), refresh=True)
            return
        if progress.phase is not self._phase:
            self._phase = progress.phase
            say(self._console, f"{self._title}: {progress.phase}")
        # a guest may join and fail at once, but a lost one does not join at once
        for mark, happened in (("", progress.visits), ("! ", progress.incidents)):
            for sentence in happened:
                if sentence not in self._printed:
                    say(self._console, f"{mark}{sentence}")
        self._printed = {*progress.incidents, *progress.visits}
        for row in progress.promises:
            if row.promise == Promise.PACE and row.remark and row.remark not in self.announced:
                self.announced.add(row.remark)
                say(self._console, f"! {row.remark}")
            if row.promise == Promise.GIVEN and row.remark and not self._lacking.issuperset(row.who):
                self._lacking.update(row.who)  # its figures change with every message
                say(self._console, f"! {row.remark}")
        if progress.elapsed - self._line_at >= _LINE_EVERY:
            self._line_at = progress.elapsed
            rate_of, of = self._about.rate_of, f" of {self._about.ticks}" if self._about.ticks else ""
            done = max((session_tick(t.tick, rate_of(n)) for n, t in progress.telemetry.items()), default=0)
            say(self._console, f"{progress.phase}: tick {done}{of}, {late_line(progress.telemetry)}")

    def _render(self, progress: Progress) -> RenderableType:
        """What `manyhands top` shows of the session, and what was not admitted."""
        now = Instant(from_seconds(progress.elapsed))
        for name, latest in progress.telemetry.items():
            if self._taken.get(name) is not latest:
                self._taken[name] = latest
                self._session.note(Observation(name, latest.tick, latest.figures, {}), now)
        self._session.note(condition_of(progress), now)
        refused = (Text(f"! {line}", style="yellow") for line in not_admitted(progress.refused))
        return Group(picture(self._session, self._console.width, self._title), *refused)


def late_line(telemetry: Mapping[str, Telemetry]) -> str:
    """The part of its ticks in which each device was late, the most first; a few of them, and how many more.

    Args:
        telemetry: the latest of each node.
    """
    parts = {
        n: t.figures[names.LATE] / t.tick for n, t in telemetry.items() if t.figures.get(names.LATE) and t.tick > 0
    }
    worst = sorted(parts, key=lambda name: -parts[name])
    shown = ", ".join(f"{name} {parts[name]:.1%}" for name in worst[:_LATE_SHOWN])
    more = f" and {len(worst) - _LATE_SHOWN} more" if len(worst) > _LATE_SHOWN else ""
    return f"late ticks: {shown}{more}" if shown else "none late"


def not_admitted(refused: Mapping[str, int]) -> list[str]:
    """One line with what the supervisor did not admit, by kind; none if there was nothing."""
    counts = ", ".join(f"{kind} {count}" for kind, count in refused.items())
    return [f"not admitted by the supervisor: {counts}"] if counts else []
