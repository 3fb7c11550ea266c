"""The broadcast of a running session: the supervisor sends, and any process that may enter its directory receives.

It uses ZeroMQ's PUB and SUB, one way. A visitor may come and go at any time, and sends nothing. A visitor that does not
read misses the frames for which its queue has no room, and no process waits for it. Visitors see everything; a process
that may see less is an observer with keys (:mod:`manyhands.launch.run.broadcast`).
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import zmq

from manyhands.protocol.clock import Duration
from manyhands.protocol.limits import LINK_QUEUE_FRAMES, MAX_CONTROL_BYTES
from manyhands.protocol.transport import milliseconds, require_path, require_sendable
from manyhands.protocol.transport.descriptors import require_room
from manyhands.protocol.transport.zeromq import failed, refuse_old_versions

BROADCAST: Final = "gallery"
"""The socket's name in its session's directory."""

_FAREWELL_MS: Final = 200  # the longest wait for visitors to take the last frames; a stopped visitor makes it that long


class Broadcast:
    """The sending end of a broadcast."""

    def __init__(self, directory: Path) -> None:
        """Open the broadcast in ``directory``, which exists and which only the session's user may enter.

        Raises:
            TransportError: the socket cannot be bound there, or this process may not open enough files.
        """
        self._path = directory.absolute() / BROADCAST
        require_path(self._path)
        require_room()
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.PUB)
        refuse_old_versions(self._socket)
        self._socket.setsockopt(zmq.SNDHWM, LINK_QUEUE_FRAMES)
        self._socket.setsockopt(zmq.MAXMSGSIZE, MAX_CONTROL_BYTES)
        self._socket.setsockopt(zmq.LINGER, _FAREWELL_MS)
        try:
            self._socket.bind(f"ipc://{self._path}")
        except zmq.ZMQError as error:
            _leave(self._context, self._socket)
            raise failed(f"bind {self._path}", error) from error

    def show(self, frame: bytes) -> None:
        """Send a frame to every visitor, and return at once.

        Raises:
            ValueError: the frame is longer than ``MAX_CONTROL_BYTES``.
            TransportError: the broadcast is closed.
        """
        require_sendable(frame)
        try:
            self._socket.send(frame, zmq.NOBLOCK)  # PUB drops the frame for a visitor whose queue is full
        except zmq.ZMQError as error:
            raise failed(f"show at {self._path}", error) from error

    def close(self) -> None:
        """Close the broadcast and remove its file. A second call does nothing."""
        if not self._socket.closed:
            _leave(self._context, self._socket)
            self._path.unlink(missing_ok=True)


class Visit:
    """The receiving end of a broadcast."""

    def __init__(self, directory: Path) -> None:
        """Connect to the broadcast of the session in ``directory``, now or as soon as it is there.

        Raises:
            TransportError: no socket can have the broadcast's path, or this process may not open enough files.
        """
        path = directory.absolute() / BROADCAST
        require_path(path)
        require_room()
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.SUB)
        refuse_old_versions(self._socket)
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
        """A descriptor that becomes readable once when frames may have come: then read until :meth:`recv` has none."""
        return int(self._socket.getsockopt(zmq.FD))

    def recv(self, timeout: Duration | None) -> bytes | None:
        """The next frame, or None if none came within ``timeout`` (0: do not wait, None: wait without an end).

        Raises:
            TransportError: the visit is closed.
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
        """Close the connection. A second call does nothing."""
        _leave(self._context, self._socket)


def await_any(visits: Sequence[Visit], timeout: Duration) -> None:
    """Wait until any of ``visits`` has a frame, at most ``timeout``."""
    poller = zmq.Poller()
    for visit in visits:
        poller.register(visit._socket, zmq.POLLIN)
    poller.poll(milliseconds(timeout))


def _leave(context: zmq.Context[zmq.Socket[bytes]], socket: zmq.Socket[bytes]) -> None:
    socket.close()
    context.term()
