"""The messages that a page receives, and the task that follows one session for all pages.

A page receives what never changes once, in its first message, and then pictures, each with what is new since the last
(:class:`Feed`, which is pure). A picture is made when the page can take it, from rings of bounded length. A page that
does not read for a while therefore misses only what has left the rings, and no messages wait for it in memory.

:class:`BroadcastFollower` follows the session's broadcast in an event loop, and notices the end of its supervisor;
:class:`Watch` does so for pages. :class:`SessionTime` has the times of ticks, for viewers beside the page.
"""

from __future__ import annotations

import asyncio
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Final, Protocol

from manyhands.launch.look.display import world_lines
from manyhands.launch.look.page.pointer import Holding
from manyhands.launch.run.running import Running
from manyhands.nodes.kernel.json_number import json_figures, json_number
from manyhands.nodes.monitor.alarms import Alarms
from manyhands.nodes.monitor.given import GivenForce, shares_cell
from manyhands.nodes.monitor.health import PROMISES, cells, condensed, is_present, summary
from manyhands.nodes.monitor.session_state import About, LiveSession
from manyhands.nodes.monitor.tracks import BUCKETS, WINDOW, Decimated, Tracks
from manyhands.nodes.recorder.format import MAX_TIME_NS, Recorded
from manyhands.nodes.rows.promises import Promise
from manyhands.nodes.rows.units import units_of_columns
from manyhands.protocol.clock import Clock, Duration, Instant
from manyhands.protocol.messages import Observation, PromiseStatus, Role
from manyhands.protocol.transport.broadcast import Visit

ALARMS_SHOWN: Final = 100
"""Number of alarms that a page receives at most, the gravest ones."""

_DIGITS: Final = 6
"""Significant digits of the values that a page draws; a plot has about a thousand lines of pixels."""


@dataclass
class Cursor:
    """What one page has received so far."""

    buckets: dict[str, int] = field(default_factory=dict)
    received: dict[str, Instant] = field(default_factory=dict)
    alarms: int = -1


class Feed:
    """Makes the messages about one session for its pages.

    Attributes:
        live: the state of the session as far as it is known.
        over: whether the session is over.
    """

    def __init__(self, about: About) -> None:
        """A feed of the session ``about`` that has not received a frame."""
        self.live, self.over = LiveSession(about), False
        self._tracks, self._alarms = Tracks(about), Alarms()

    def take(self, frame: bytes, now: Instant) -> None:
        """Take in a frame of the broadcast that came at ``now``."""
        message = self.live.take(frame, now)
        if isinstance(message, Observation):
            self._tracks.take(message)
        elif self.live.condition is not None and self.live.condition.phase == "over":
            self.over = True

    def look(self, now: Instant) -> None:
        """Raise and clear alarms; once the session is over, alarms stay as they are."""
        if not self.over:
            self._alarms.look(self.live, now)

    def session(self) -> str:
        """The first message of a page, with what does not change (JSON)."""
        about = self.live.about
        tracks = {
            key.name: {
                "node": key.node,
                "topic": key.topic.name,
                "symbol": key.topic.symbol,
                "units": units_of_columns(key.topic, columns, about.turning),
                "columns": columns,
                "seconds": self._tracks.sizes[key.node] * about.period_of(key.node),
            }
            for key, columns in self._tracks.columns.items()
        }
        seen = {"bucket": self._tracks.size, "buckets": BUCKETS, "window": WINDOW, "tracks": tracks}
        return json.dumps({"type": "session", **about.as_plain(), **seen})

    def picture(self, cursor: Cursor, held: dict[str, str]) -> str:
        """The session's present state with what is new since ``cursor``, which is moved on (JSON)."""
        live = self.live
        message: dict[str, Any] = {
            "type": "picture",
            "over": self.over,
            "phase": "" if live.condition is None else live.condition.phase,
            "elapsed": None if live.condition is None else live.condition.elapsed,
            "health": live.health,
            "tick": live.tick,
            "rate": _rounded(live.rate),
            "pace": live.pace,
            "promises": [_shown(row) for row in condensed(live.promises)],
            "present": summary(live.promises),
            "lobby": [{"text": seat.sentence(), "health": seat.health} for seat in live.lobby],
            "energy": "; ".join(line for node in live.nodes.values() for line in world_lines(node.figures)),
            "wave_links": [felt.sentence(name) for name, felt in live.felt_links.items()],
            "nodes": self._nodes(cursor),
            "links": [live.link_health(link) for link in live.about.links],
            "tracks": self._new_buckets(cursor),
            "held": held,
        }
        if cursor.alarms != self._alarms.version:
            cursor.alarms = self._alarms.version
            message["alarms"] = self._listed()
        return json.dumps(message)

    def _nodes(self, cursor: Cursor) -> dict[str, Any]:
        live, out = self.live, dict[str, Any]()
        for name, node in live.nodes.items():
            out[name] = {"state": node.state, "health": node.health, "tick": node.tick, "rate": _rounded(node.rate)}
            if node.role is Role.DEVICE and live.about.certificate is not None:
                out[name]["covered"] = live.covered_tau(name)
            if node.role is Role.DEVICE:
                out[name]["pressed"] = node.pressed
            if node.received is not None and cursor.received.get(name) != node.received:
                cursor.received[name] = node.received
                out[name]["figures"] = json_figures(node.figures, _rounded)
                if (given := GivenForce.of(node.figures)) is not None:
                    out[name]["given"] = shares_cell(given.by_force, given.by_time)
        return out

    def _new_buckets(self, cursor: Cursor) -> dict[str, Any]:
        out = {}
        for key, track in self._tracks.items():
            sent = cursor.buckets.get(key.name, 0)
            if track.end == sent:
                continue
            # the last bucket is sent again: it may have grown after a gap that ended inside it
            new = track.since(max(sent - 1, 0))
            cursor.buckets[key.name] = track.end
            out[key.name] = _piece(new)
        return out

    def _listed(self) -> list[dict[str, Any]]:
        return [
            {
                "key": alarm.key,
                "level": alarm.level,
                "headline": alarm.headline,
                "who": alarm.who,
                "text": alarm.text,
                "advice": alarm.advice,
                "since": alarm.since,
                "latest": alarm.latest,
                "earlier": alarm.earlier,
                "cleared": alarm.cleared,
            }
            for alarm in self._alarms.listed()[:ALARMS_SHOWN]
        ]


def _shown(row: PromiseStatus) -> dict[str, Any]:
    """A row about a promise, as texts, with what the page shows of it besides."""
    claim = PROMISES[Promise(row.promise)].claim
    return {
        "cells": cells(row),
        "state": row.state,
        "present": is_present(row),
        "claim": claim,
        "remark": row.remark,
        "who": row.who,
    }


def _piece(new: Decimated) -> list[Any]:
    """The number of the first bucket, and the values of each column, two for each bucket."""
    columns = new.values.reshape(-1, new.values.shape[2]).T.tolist()
    return [new.first, [[_rounded(value) for value in column] for column in columns]]


def _rounded(value: float | None) -> float | None:
    return None if (known := json_number(value)) is None else float(f"{known:.{_DIGITS}g}")


LOOK_EVERY: Final = 0.25
"""How often alarms and holds are checked, s."""

_MOST_AT_ONCE: Final = 64  # frames that are taken in before other tasks get their turn


EVERY: Final = 10
"""Ticks of which one is sent by default to viewers beside the page: 100 messages a second of a trace at 1 kHz."""


class SessionTime:
    """The times of a session's ticks, those of a recording that began now.

    Tick k was at the start plus kT, with the node's T. The start is computed back from the arrival of the environment's
    first telemetry. The environment runs where the session does, so no user elsewhere can shift the time.

    Attributes:
        start: the time of tick 0, ns since 1970; None before it is known.
        latest: the environment's time, ns since 1970, which never goes back; None before any.
    """

    def __init__(self, recorded: Recorded) -> None:
        """No time is known of the session ``recorded``."""
        self._recorded = recorded
        self.start: int | None = None
        self.latest: int | None = None

    def take(self, observation: Observation, wall: int) -> int | None:
        """The time of telemetry, ns since 1970; None before the start is known, and beyond all times.

        Args:
            observation: the telemetry.
            wall: when it came, ns since 1970.
        """
        node, tick = observation.node, observation.tick
        is_environment = self._recorded.roles[node] is Role.ENVIRONMENT
        if self.start is None and is_environment:
            self.start = max(0, wall - self._since_start(node, tick))
        at = self.of(node, tick)
        if at is not None and is_environment:
            self.latest = at if self.latest is None else max(self.latest, at)  # viewers begin anew where time goes back
        return at

    def of(self, node: str, tick: int) -> int | None:
        """The time of a node's tick, ns since 1970; None before the start is known, and beyond all times."""
        if self.start is None:
            return None
        at = self.start + self._since_start(node, tick)
        return at if at <= MAX_TIME_NS else None

    def _since_start(self, node: str, tick: int) -> int:
        return round(tick * self._recorded.tick_ns(node))


class Taker(Protocol):
    """What takes in the frames of a session: a :class:`Feed`, or that of another viewer.

    Attributes:
        over: whether the session is over.
    """

    over: bool

    def take(self, frame: bytes, now: Instant) -> None:
        """Take in a frame of the broadcast that came at ``now``."""
        ...

    def look(self, now: Instant) -> None:
        """Do what is due at ``now``, whether a frame came or not."""
        ...


class BroadcastFollower:
    """Follows one session's broadcast in an event loop, and notices the end of its supervisor.

    Attributes:
        clock: the clock for it and for the limits of its viewers.
    """

    def __init__(self, running: Running, clock: Clock, taker: Taker) -> None:
        """Connect to the session's broadcast, whose frames go to ``taker``.

        Raises:
            TransportError: the broadcast cannot be connected.
        """
        self._running, self.clock, self._taker = running, clock, taker
        self._visit = Visit(running.directory)

    async def run(self) -> None:
        """Follow the session until cancelled; when it is over, its last state stays."""
        loop = asyncio.get_running_loop()
        with self._reading(loop), self._until_its_end(loop):
            while True:
                await asyncio.sleep(LOOK_EVERY)
                self._take_in()
                self.look(self.clock.now())

    def look(self, now: Instant) -> None:
        """Do what is due at ``now``."""
        self._taker.look(now)

    def close(self) -> None:
        """Disconnect. A second call does nothing."""
        self._visit.close()

    @contextmanager
    def _reading(self, loop: asyncio.AbstractEventLoop) -> Iterator[None]:
        fd = self._visit.fd
        loop.add_reader(fd, self._take_in)
        try:
            yield
        finally:
            loop.remove_reader(fd)

    @contextmanager
    def _until_its_end(self, loop: asyncio.AbstractEventLoop) -> Iterator[None]:
        """Notice the end of the supervisor's process, which a killed supervisor does not report."""
        try:
            fd = os.pidfd_open(self._running.about.pid)
        except ProcessLookupError:
            self._end()
            yield
            return

        def ended() -> None:
            loop.remove_reader(fd)
            self._end()

        loop.add_reader(fd, ended)
        try:
            yield
        finally:
            loop.remove_reader(fd)
            os.close(fd)

    def _take_in(self) -> None:
        """Take in the frames that have come, a bounded number at once; the rest follow soon, after other tasks."""
        now = self.clock.now()
        for _ in range(_MOST_AT_ONCE):
            frame = self._visit.recv(Duration(0))
            if frame is None:
                return
            self._taker.take(frame, now)
        asyncio.get_running_loop().call_soon(self._take_in)

    def _end(self) -> None:
        self._take_in()
        self._taker.look(self.clock.now())
        self._taker.over = True


class Watch(BroadcastFollower):
    """Follows one session for all pages, and keeps the devices that the pages hold.

    Attributes:
        feed: the messages for the pages.
        holding: which page holds which device.
    """

    def __init__(self, running: Running, clock: Clock) -> None:
        """Connect to the session's broadcast.

        Raises:
            TransportError: the broadcast, or a device's pointer, cannot be connected.
        """
        self.feed = Feed(running.about)
        self.holding = Holding(running.directory, running.about)
        super().__init__(running, clock, self.feed)

    def look(self, now: Instant) -> None:
        """Check alarms, and let go of devices whose pages have fallen silent."""
        super().look(now)
        self.holding.expire(now)

    def close(self) -> None:
        """Let go of all devices, and disconnect. A second call does nothing."""
        self.holding.close()
        super().close()
