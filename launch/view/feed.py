"""What a page is told: once what does not change, and then pictures, each with what is new since the last. Pure.

A picture is made when a page can take it, from rings of bounded length: a page that does not read for a while misses
nothing but what has left the rings since, and nothing waits for it in memory.

Looking on at one session within an event loop: its broadcast and the end of its supervisor, until the loop ends.
"""

from __future__ import annotations

import asyncio
import json
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Final

from manyhands.launch.observe.sessions import Running
from manyhands.launch.run.display import energy_line
from manyhands.launch.view.pointer import Holding
from manyhands.nodes.json_number import json_number
from manyhands.nodes.observer.alarms import Alarms, covered_tau
from manyhands.nodes.observer.scene import About, Scene
from manyhands.nodes.observer.tracks import BUCKETS, WINDOW, Decimated, Tracks
from manyhands.protocol.clock import Clock, Duration, Instant
from manyhands.protocol.messages import Observation, Role
from manyhands.protocol.transport.broadcast import Visit

ALARMS_SHOWN: Final = 100
"""So many alarms a page is told of, the gravest."""

_DIGITS: Final = 6
"""Significant digits of what is drawn: a picture has a thousand lines."""


@dataclass
class Cursor:
    """How much a page has been told."""

    buckets: dict[str, int] = field(default_factory=dict)
    heard: dict[str, Instant] = field(default_factory=dict)
    alarms: int = -1


class Feed:
    """A session as pages are told of it.

    Attributes:
        scene: what is known of it.
        over: whether it is over.
    """

    def __init__(self, about: About, wall: float) -> None:
        """Nothing has been seen yet.

        Args:
            about: the session.
            wall: seconds since 1970 at the clock's instant 0, for what people are told the time of.
        """
        self.scene, self.over = Scene(about), False
        self._tracks, self._alarms, self._wall = Tracks(about), Alarms(), wall

    def take(self, frame: bytes, now: Instant) -> None:
        """A frame of the broadcast's."""
        message = self.scene.take(frame, now)
        if isinstance(message, Observation):
            self._tracks.take(message)
        elif self.scene.condition is not None and self.scene.condition.phase == "over":
            self.over = True

    def look(self, now: Instant) -> None:
        """Raise and clear alarms; what a session did that is over is not judged any more."""
        if not self.over:
            self._alarms.look(self.scene, now)

    def session(self) -> str:
        """What does not change, as a page is told it first."""
        tracks = {
            key.name: {
                "node": key.node,
                "topic": key.topic.name,
                "symbol": key.topic.symbol,
                "unit": key.topic.unit,
                "columns": columns,
            }
            for key, columns in self._tracks.columns.items()
        }
        about = self.scene.about.as_plain()
        seen = {"bucket": self._tracks.size, "buckets": BUCKETS, "window": WINDOW, "tracks": tracks}
        return json.dumps({"type": "session", **about, **seen})

    def picture(self, cursor: Cursor, held: dict[str, str]) -> str:
        """How the session is now, with what is new since ``cursor``, which is moved on."""
        scene = self.scene
        told: dict[str, Any] = {
            "type": "picture",
            "over": self.over,
            "phase": "" if scene.condition is None else scene.condition.phase,
            "elapsed": None if scene.condition is None else scene.condition.elapsed,
            "health": scene.health,
            "tick": scene.tick,
            "rate": _rounded(scene.rate),
            "frozen": scene.frozen,
            "energy": "".join(energy_line(node.figures) for node in scene.nodes.values()),
            "nodes": self._nodes(cursor),
            "links": [scene.link_health(link) for link in scene.about.links],
            "tracks": self._new_buckets(cursor),
            "held": held,
        }
        if cursor.alarms != self._alarms.version:
            cursor.alarms = self._alarms.version
            told["alarms"] = self._listed()
        return json.dumps(told)

    def _nodes(self, cursor: Cursor) -> dict[str, Any]:
        scene, out = self.scene, dict[str, Any]()
        for name, node in scene.nodes.items():
            out[name] = {"state": node.state, "health": node.health, "tick": node.tick, "rate": _rounded(node.rate)}
            if node.role is Role.DEVICE and scene.about.certificate is not None:
                out[name]["covered"] = covered_tau(scene, name)
            if node.heard is not None and cursor.heard.get(name) != node.heard:
                cursor.heard[name] = node.heard
                out[name]["figures"] = {figure: _rounded(value) for figure, value in node.figures.items()}
        return out

    def _new_buckets(self, cursor: Cursor) -> dict[str, Any]:
        out = {}
        for key, track in self._tracks.items():
            sent = cursor.buckets.get(key.name, 0)
            if track.end == sent:
                continue
            # the last one once more: a gap that ended inside it may have added to it
            new = track.since(max(sent - 1, 0))
            cursor.buckets[key.name] = track.end
            out[key.name] = _piece(new)
        return out

    def _listed(self) -> list[dict[str, Any]]:
        return [
            {
                "key": alarm.key,
                "level": alarm.level,
                "text": alarm.text,
                "advice": alarm.advice,
                "since": self._wall + alarm.since / 1e9,
                "cleared": None if alarm.cleared is None else self._wall + alarm.cleared / 1e9,
            }
            for alarm in self._alarms.listed()[:ALARMS_SHOWN]
        ]


def _piece(new: Decimated) -> list[Any]:
    """First bucket, and of each column its values, two a bucket."""
    columns = new.values.reshape(-1, new.values.shape[2]).T.tolist()
    return [new.first, [[_rounded(value) for value in column] for column in columns]]


def _rounded(value: float | None) -> float | None:
    return None if (known := json_number(value)) is None else float(f"{known:.{_DIGITS}g}")


LOOK_EVERY: Final = 0.25
"""How often alarms and pointers are looked after, s."""

_MOST_AT_ONCE: Final = 64  # frames that are taken in before pages get their turn


class Watch:
    """What is known of a session, and what is held of it.

    Attributes:
        clock: what it and the pages' bounds go by.
        feed: what pages are told.
        holding: which page holds what.
    """

    def __init__(self, running: Running, clock: Clock) -> None:
        """Enter the session's broadcast.

        Raises:
            TransportError: there can be none.
        """
        self._running, self.clock = running, clock
        self.feed = Feed(running.about, time.time() - clock.now() / 1e9)
        self.holding = Holding(running.directory, running.about)
        self._visit = Visit(running.directory)

    async def run(self) -> None:
        """Look on until cancelled; a session that is over stays as it was last seen."""
        loop = asyncio.get_running_loop()
        with self._reading(loop), self._until_its_end(loop):
            while True:
                await asyncio.sleep(LOOK_EVERY)
                self._take_in()
                now = self.clock.now()
                self.feed.look(now)
                self.holding.expire(now)

    def close(self) -> None:
        """Let go of everything, and leave. A second time does nothing."""
        self.holding.close()
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
        """Notice that the supervisor's process ended, which one that was killed does not tell."""
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
        """Take in what has come; what is left waits for the next look, which is soon."""
        now = self.clock.now()
        for _ in range(_MOST_AT_ONCE):
            frame = self._visit.recv(Duration(0))
            if frame is None:
                return
            self.feed.take(frame, now)
        asyncio.get_running_loop().call_soon(self._take_in)

    def _end(self) -> None:
        self._take_in()
        self.feed.look(self.clock.now())
        self.feed.over = True
