"""Where a running session can be looked at, by anybody who may enter its directory: one speaks, any number listen.

ZeroMQ's PUB and SUB, one way. A visitor comes and goes as it likes and says nothing; one that does not read misses what
finds no room in its queue, and nobody waits for it. What is shown is all there is: whoever may see less is an observer
with keys (:mod:`manyhands.launch.run.broadcast`), not a visitor.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import zmq

from manyhands.protocol.clock import Duration
from manyhands.protocol.limits import LINK_QUEUE_FRAMES, MAX_CONTROL_BYTES
from manyhands.protocol.transport import milliseconds, require_path, require_sendable
from manyhands.protocol.transport.descriptors import require_room
from manyhands.protocol.transport.zeromq import failed

BROADCAST: Final = "gallery"
"""The socket's name in its session's directory."""

_FAREWELL_MS: Final = 200  # how long the last word may take to visitors; one that is stopped makes it that long


class Broadcast:
    """The end that speaks."""

    def __init__(self, directory: Path) -> None:
        """Open it in ``directory``, which exists and which only the session's user may enter.

        Raises:
            TransportError: the socket cannot be bound there, or this process may not open enough files.
        """
        self._path = directory.absolute() / BROADCAST
        require_path(self._path)
        require_room()
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.PUB)
        self._socket.setsockopt(zmq.SNDHWM, LINK_QUEUE_FRAMES)
        self._socket.setsockopt(zmq.MAXMSGSIZE, MAX_CONTROL_BYTES)
        self._socket.setsockopt(zmq.LINGER, _FAREWELL_MS)
        try:
            self._socket.bind(f"ipc://{self._path}")
        except zmq.ZMQError as error:
            _leave(self._context, self._socket)
            raise failed(f"bind {self._path}", error) from error

    def show(self, frame: bytes) -> None:
        """Show a frame to whoever is there, and return at once.

        Raises:
            ValueError: if the frame is longer than ``MAX_CONTROL_BYTES``.
            TransportError: if it is closed.
        """
        require_sendable(frame)
        try:
            self._socket.send(frame, zmq.NOBLOCK)  # PUB drops for whom its queue is full
        except zmq.ZMQError as error:
            raise failed(f"show at {self._path}", error) from error

    def close(self) -> None:
        """Close it, and leave no file. A second time does nothing."""
        if not self._socket.closed:
            _leave(self._context, self._socket)
            self._path.unlink(missing_ok=True)


class Visit:
    """The end that listens."""

    def __init__(self, directory: Path) -> None:
        """Enter the broadcast of the session in ``directory``, now or as soon as it is there.

        Raises:
            TransportError: there can be none, or this process may not open enough files.
        """
        path = directory.absolute() / BROADCAST
        require_path(path)
        require_room()
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.SUB)
        self._socket.setsockopt(zmq.RCVHWM, LINK_QUEUE_FRAMES)
        self._socket.setsockopt(zmq.MAXMSGSIZE, MAX_CONTROL_BYTES)
        self._socket.setsockopt(zmq.LINGER, 0)
        self._socket.setsockopt(zmq.SUBSCRIBE, b"")
        try:
            self._socket.connect(f"ipc://{path}")
        except zmq.ZMQError as error:
            _leave(self._context, self._socket)
            raise failed(f"connect to {path}", error) from error

    @property
    def fd(self) -> int:
        """Becomes readable when something may have come; says so once, so read until :meth:`recv` has no more."""
        return int(self._socket.getsockopt(zmq.FD))

    def recv(self, timeout: Duration | None) -> bytes | None:
        """The next frame, or None if none came within ``timeout`` (0: do not wait, None: wait for ever).

        Raises:
            TransportError: if it is closed.
        """
        try:
            if not self._socket.poll(milliseconds(timeout), zmq.POLLIN):
                return None
            return self._socket.recv(zmq.NOBLOCK)
        except zmq.Again:
            return None
        except zmq.ZMQError as error:
            raise failed("look on", error) from error

    def close(self) -> None:
        """Leave. A second time does nothing."""
        _leave(self._context, self._socket)


def await_any(visits: Sequence[Visit], timeout: Duration) -> None:
    """Return as soon as any of the visits has a frame, or after ``timeout``."""
    poller = zmq.Poller()
    for visit in visits:
        poller.register(visit._socket, zmq.POLLIN)
    poller.poll(milliseconds(timeout))


def _leave(context: zmq.Context[zmq.Socket[bytes]], socket: zmq.Socket[bytes]) -> None:
    socket.close()
    context.term()
