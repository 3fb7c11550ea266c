"""The path of a person's pointer to a device of a running session: datagrams in the session's directory.

Only the latest message matters, neither end waits, and a device reads it in its tick without a second thread. So this
is a Unix datagram socket, and not ZeroMQ. Every process that may enter the directory may hold the device.
"""

import contextlib
import socket
from pathlib import Path
from typing import Final

from manyhands.protocol.codec import decode, encode
from manyhands.protocol.messages import Grasp, Release
from manyhands.protocol.transport import TransportError, require_name, require_path

MAX_GRIP_BYTES: Final = 8192
"""The longest datagram that is read: a position with as many axes as a link has ports."""

_MOST_AT_ONCE: Final = 16  # datagrams read in one look: as many as the kernel keeps by default


def pointer_path(directory: Path, device: str) -> Path:
    """The path of the pointer socket of a device.

    Raises:
        TransportError: no socket can have that path.
    """
    require_name(device)
    path = directory.absolute() / f"grip-{device}"
    require_path(path)
    return path


class PointerInlet:
    """The device's end of a pointer.

    Attributes:
        malformed: datagrams that were neither a grasp nor a release.
    """

    def __init__(self, directory: Path, device: str) -> None:
        """Open the pointer of ``device`` in the session's ``directory``.

        Raises:
            TransportError: the socket cannot be bound there.
        """
        self._path = pointer_path(directory, device)
        self.malformed = 0
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._path.unlink(missing_ok=True)  # a former process of the device may have left it
            self._socket.bind(str(self._path))
            self._file = self._path.stat().st_ino
        except OSError as error:
            self._socket.close()
            raise TransportError(f"cannot bind {self._path}: {error.strerror}") from error

    def latest(self) -> Grasp | Release | None:
        """The latest message since the last call; None without one. Reads a bounded number, and never blocks."""
        last: Grasp | Release | None = None
        for _ in range(_MOST_AT_ONCE):
            try:
                frame = self._socket.recv(MAX_GRIP_BYTES + 1)
            except (BlockingIOError, InterruptedError):
                break
            message = decode(frame, MAX_GRIP_BYTES)
            if isinstance(message, Grasp | Release):
                last = message
            else:
                self.malformed += 1
        return last

    def close(self) -> None:
        """Close the socket and remove its file, unless that belongs to a new process. A second call does nothing."""
        with contextlib.suppress(FileNotFoundError):
            if self._socket.fileno() >= 0 and self._path.stat().st_ino == self._file:
                self._path.unlink()
        self._socket.close()


class PointerOutlet:
    """The end of a pointer that the page's server uses."""

    def __init__(self, directory: Path, device: str) -> None:
        """Open a socket towards ``device``; only :meth:`send` shows whether the device is there.

        Raises:
            TransportError: no socket can have the device's path.
        """
        self._path = str(pointer_path(directory, device))
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)

    def send(self, message: Grasp | Release) -> bool:
        """Send a message and return at once; False if no device is there, its queue is full, or this end is closed.

        Raises:
            ValueError: the protocol does not allow the message.
        """
        frame = encode(message)
        try:
            return self._socket.sendto(frame, self._path) > 0
        except OSError:  # the socket is gone, full, or no socket of a device: the message was not delivered
            return False

    def close(self) -> None:
        """Close the socket. A second call does nothing."""
        self._socket.close()
