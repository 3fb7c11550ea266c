"""Links under a rogue's control: a node's honest frames, and the frames sent beside or instead of them."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from typing import Final

import numpy as np
import zmq
from zmq.utils.monitor import parse_monitor_message

from manyhands.nodes.joins import HANDSHAKE_TIME
from manyhands.protocol.clock import Duration, Instant, RealtimeClock
from manyhands.protocol.codec import LAYOUTS, encode, read_head, type_of
from manyhands.protocol.limits import MAX_CONTROL_BYTES, MAX_STRAY_FRAMES
from manyhands.protocol.messages import Force, Reaction, Sample, SignalMessage, Tool
from manyhands.protocol.transport import Link, TransportError, Trouble
from manyhands.protocol.transport.zeromq import ZmqLink

from .strays import STRAYS, Honest

MISBEHAVES: Final = range(120, 150)
"""Ticks in which a babbling node babbles, and a forceful one is that."""

JUNK: Final = 100
"""Junk frames that a babbling node sends in each of those ticks on top of everything else."""

BURST: Final = 200
"""The tick in which a babbling node sends as many strays as a wait allows for."""

OVERSIZED: Final = 250
"""The tick in which a babbling device sends a frame that no connection survives."""

FLOOD: Final = 130
"""The tick in which a flooding device sends one more than that."""

DEADLINE_MS: Final = 60_000
"""For what takes a moment: whoever is late by so much will not come."""

ABSURD: Final = 1e6
"""The force of a forceful coupling, N."""

SIGNALS: Final[Mapping[int | None, type[SignalMessage]]] = {
    LAYOUTS[kind][0]: kind for kind in (Sample, Tool, Reaction, Force)
}


class Wrapped:
    """A link under a rogue's control."""

    def __init__(self, link: Link) -> None:
        self._link = link

    def send(self, frame: bytes) -> bool:
        return self._link.send(frame)

    def insist(self, frame: bytes) -> None:
        """Send, and retry while the queue is full: a count must not depend on a queue."""
        while not self._link.send(frame):
            os.sched_yield()

    def recv(self, timeout: Duration | None) -> bytes | None:
        return self._link.recv(timeout)

    def trouble(self) -> Trouble | None:
        return self._link.trouble()

    def close(self) -> None:
        self._link.close()


class Babbling(Wrapped):
    """Every stray there is, before the honest signal; and the honest one a second time."""

    def __init__(self, link: Link, bounded: bool) -> None:
        super().__init__(link)
        self._strays = [stray for stray in STRAYS.values() if bounded or not stray.bounded]
        self._first = self._before = b""

    def send(self, frame: bytes) -> bool:
        head, kind = read_head(frame), SIGNALS.get(type_of(frame))
        if head is None or kind is None:
            return super().send(frame)
        values = tuple(np.frombuffer(frame[head.size :], "<f8").tolist())
        self._first = self._first or frame
        if head.tick in MISBEHAVES:
            honest = Honest(kind, head.tick, head.stamp, values, frame, self._before, self._first)
            for stray in self._strays:
                self.insist(stray.frame(honest))
            for _ in range(JUNK):
                self.insist(b"junk")
        elif head.tick == BURST:
            for _ in range(MAX_STRAY_FRAMES):
                self.insist(b"junk")
        self._before = frame
        self.insist(frame)
        if head.tick in MISBEHAVES:
            self.insist(frame)
        return True


class Flooding(Wrapped):
    """One frame too many in one wait."""

    def send(self, frame: bytes) -> bool:
        head = read_head(frame)
        if head is not None and head.tick == FLOOD:
            for _ in range(MAX_STRAY_FRAMES + 1):
                self.insist(b"junk")
        return super().send(frame)


class Oversized(Wrapped):
    """A frame so long that the other side's ZeroMQ ends the connection; the next frame goes over a new connection."""

    def __init__(self, link: Link) -> None:
        super().__init__(link)
        self._socket = require_zmq(link)._socket

    def send(self, frame: bytes) -> bool:
        head = read_head(frame)
        if head is not None and head.tick == OVERSIZED:
            self._change_connections()
        return super().send(frame)

    def _change_connections(self) -> None:
        """Lose one connection and open a new one, so that no honest frame is lost with the first."""
        wanted = [zmq.Event.DISCONNECTED, zmq.Event.HANDSHAKE_SUCCEEDED]
        monitor = self._socket.get_monitor_socket(wanted[0] | wanted[1])
        self._socket.send(bytes(2 * MAX_CONTROL_BYTES))
        deadline = time.monotonic() + DEADLINE_MS / 1000
        while wanted:
            if not monitor.poll(DEADLINE_MS) or time.monotonic() > deadline:
                raise TransportError(f"found no {wanted[0].name} in {DEADLINE_MS} ms; expected one")
            if parse_monitor_message(monitor.recv_multipart())["event"] == wanted[0]:
                del wanted[0]
        self._socket.disable_monitor()
        monitor.close(linger=0)


def require_zmq(link: Link) -> ZmqLink:
    """The link, which in a real process is a ZeroMQ link."""
    if not isinstance(link, ZmqLink):
        raise TypeError(f"found a {type(link).__name__}; expected a link of ZeroMQ")
    return link


class Forceful(Wrapped):
    """An absurd force in place of the environment's."""

    def send(self, frame: bytes) -> bool:
        head = read_head(frame)
        if head is not None and head.tick in MISBEHAVES:
            frame = encode(Force(head.tick, head.stamp, np.array([ABSURD])))
        return super().send(frame)


class HurriedClock(RealtimeClock):
    """A clock that is put forward, so that no test has to wait for a deadline."""

    def __init__(self) -> None:
        super().__init__()
        self._ahead = Duration(0)

    def now(self) -> Instant:
        return Instant(super().now() + self._ahead)

    def put_forward(self, time: Duration) -> None:
        """Advance the clock by so much."""
        self._ahead = Duration(self._ahead + time)


class Lapsing(Wrapped):
    """A link on which the time allowed for a handshake is over after the first frame."""

    def __init__(self, link: Link, clock: HurriedClock) -> None:
        super().__init__(link)
        self._clock, self._heard = clock, False

    def recv(self, timeout: Duration | None) -> bytes | None:
        if self._heard:
            self._clock.put_forward(HANDSHAKE_TIME)
            return None
        self._heard = True
        return super().recv(timeout)
