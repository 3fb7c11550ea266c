"""Looking on at one session within an event loop: its gallery and the end of its supervisor, until the loop ends."""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from manyhands.launch.looking.sessions import Running
from manyhands.launch.view.feed import Feed
from manyhands.launch.view.holding import Holding
from manyhands.protocol.clock import Clock, Duration
from manyhands.protocol.transport.gallery import Visit

LOOK_EVERY: Final = 0.25
"""How often alarms and grips are looked after, s."""

_MOST_AT_ONCE: Final = 64  # frames that are taken in before pages get their turn


class Watch:
    """What is known of a session, and what is held of it.

    Attributes:
        clock: what it and the pages' bounds go by.
        feed: what pages are told.
        holding: which page holds what.
    """

    def __init__(self, running: Running, clock: Clock) -> None:
        """Enter the session's gallery.

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
