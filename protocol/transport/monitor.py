"""What becomes of a socket's connections, as ZeroMQ tells it."""

import struct
from functools import reduce
from operator import or_
from typing import Final

import zmq

from manyhands.protocol.transport import Trouble


def monitor_of(socket: "zmq.Socket[bytes]", events: int) -> "zmq.Socket[bytes]":
    """A socket that becomes readable with each of these ``events`` of ``socket``, which is neither bound nor connected.

    Its queue is not bounded: ZeroMQ's own thread writes to it and would wait for room, with every connection of the
    process. Whoever reads it sees to it that events do not pile up.
    """
    address = f"inproc://monitor-{id(socket)}"
    socket.monitor(address, events)
    monitor: zmq.Socket[bytes] = socket.context.socket(zmq.PAIR)
    monitor.setsockopt(zmq.RCVHWM, 0)
    monitor.connect(address)
    return monitor


def close_monitor(socket: "zmq.Socket[bytes]", monitor: "zmq.Socket[bytes]") -> None:
    """End it, before or after ``socket`` is closed."""
    if not socket.closed:
        socket.disable_monitor()  # before its other end closes: ZeroMQ says goodbye to it
    monitor.close(linger=0)


_EVENT: Final = struct.Struct("=Hi")


def event_of(frames: list[bytes]) -> zmq.Event:
    """Which event a monitor's message reports: 16 bits of event and 32 of its value, then the endpoint.

    pyzmq has a reader of its own in ``zmq.utils.monitor``, which imports asyncio: 50 ms of every node's start.
    """
    event, _ = _EVENT.unpack(frames[0])
    return zmq.Event(event)


class Fate:
    """What has become of the connection of a socket that connects, from ZeroMQ's events in their order. Pure.

    A connection that ends within its handshake does not tell why. A host that does not hold the key expected of it ends
    each one at once; one that is too busy to admit anybody ends it after ``HANDSHAKE_MS``. So a wrong key is concluded
    from many in a row alone.

    Attributes:
        trouble: what is wrong now; None while nothing is known to be.
    """

    EVENTS: Final = reduce(
        or_,
        (
            zmq.Event.HANDSHAKE_SUCCEEDED,
            zmq.Event.HANDSHAKE_FAILED_AUTH,
            zmq.Event.HANDSHAKE_FAILED_PROTOCOL,
            zmq.Event.HANDSHAKE_FAILED_NO_DETAIL,
            zmq.Event.DISCONNECTED,
            zmq.Event.CONNECT_RETRIED,
        ),
    )

    def __init__(self) -> None:
        self.trouble: Trouble | None = None
        self._established = False
        self._broken_off = 0

    def take(self, event: zmq.Event) -> None:
        """One of :attr:`EVENTS` has happened."""
        if event is zmq.Event.HANDSHAKE_SUCCEEDED:
            self.trouble, self._established, self._broken_off = None, True, 0
            return
        if event is zmq.Event.HANDSHAKE_FAILED_NO_DETAIL:
            self._broken_off += 1
        if self.trouble in _PASSING:  # what came first is the cause: a loss follows a refusal, too
            self.trouble = self._meaning(event)

    def _meaning(self, event: zmq.Event) -> Trouble | None:
        match event:
            case zmq.Event.HANDSHAKE_FAILED_AUTH:
                return Trouble.NOT_ADMITTED
            case zmq.Event.HANDSHAKE_FAILED_PROTOCOL:
                return Trouble.NOT_PROVED
            case zmq.Event.HANDSHAKE_FAILED_NO_DETAIL:
                return Trouble.BROKEN_OFF if self._broken_off < BROKEN_OFF_IN_A_ROW else Trouble.NOT_PROVED
            case zmq.Event.DISCONNECTED if self._established:
                return Trouble.LOST
            case zmq.Event.CONNECT_RETRIED if self.trouble is None:
                return Trouble.NOBODY
        return self.trouble


BROKEN_OFF_IN_A_ROW: Final = 20
"""Connections that may end within their handshake, one after the other, before the other side's key is doubted: three
seconds of a wrong key, more than a minute of a host that is busy."""

_PASSING: Final = (None, Trouble.NOBODY, Trouble.BROKEN_OFF)
