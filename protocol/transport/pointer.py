"""The way of a person's hand to a device of a running session: datagrams in the session's directory.

Only the latest matters, nobody waits, and a device reads it in its tick without another thread: so a Unix datagram
socket, and not ZeroMQ. Who may enter the directory may hold the device.
"""

import contextlib
import socket
from pathlib import Path
from typing import Final

from manyhands.protocol.codec import decode, encode
from manyhands.protocol.messages import Grasp, Release
from manyhands.protocol.transport import TransportError, require_name, require_path

MAX_GRIP_BYTES: Final = 8192
"""Longest datagram that is read: a position of as many axes as a link has ports."""

_MOST_AT_ONCE: Final = 16  # datagrams read in one look: what the kernel keeps, by default


def pointer_path(directory: Path, device: str) -> Path:
    """Where the device of this name can be held.

    Raises:
        TransportError: no socket can have that path.
    """
    require_name(device)
    path = directory.absolute() / f"grip-{device}"
    require_path(path)
    return path


class PointerInlet:
    """The device's end.

    Attributes:
        malformed: datagrams that were neither a grasp nor a release.
    """

    def __init__(self, directory: Path, device: str) -> None:
        """Open it.

        Raises:
            TransportError: the socket cannot be bound there.
        """
        self._path = pointer_path(directory, device)
        self.malformed = 0
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._path.unlink(missing_ok=True)  # of the device's former process
            self._socket.bind(str(self._path))
            self._file = self._path.stat().st_ino
        except OSError as error:
            self._socket.close()
            raise TransportError(f"cannot bind {self._path}: {error.strerror}") from error

    def latest(self) -> Grasp | Release | None:
        """What was said last since the last look; None if nothing was. Bounded, and never blocks."""
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
        """Close it, and leave no file, unless it is the next process's by now. A second time does nothing."""
        with contextlib.suppress(FileNotFoundError):
            if self._socket.fileno() >= 0 and self._path.stat().st_ino == self._file:
                self._path.unlink()
        self._socket.close()


class PointerOutlet:
    """The end of whoever speaks for a person's hand."""

    def __init__(self, directory: Path, device: str) -> None:
        """Reach for a device; that it is there is only known when something is said to it.

        Raises:
            TransportError: no device can be there.
        """
        self._path = str(pointer_path(directory, device))
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)

    def say(self, message: Grasp | Release) -> bool:
        """Say it, and return at once; False if nobody is there, or has no room, or this end is closed.

        Raises:
            ValueError: the message is not what the protocol allows.
        """
        frame = encode(message)
        try:
            return self._socket.sendto(frame, self._path) > 0
        except OSError:  # gone, full, or in its place something that is no device's: it will not have heard
            return False

    def close(self) -> None:
        """Close it. A second time does nothing."""
        self._socket.close()
