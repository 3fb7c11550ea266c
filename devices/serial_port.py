"""A serial port, or a pseudo-terminal: raw bytes, of which nothing is waited for. Standard library alone."""

from __future__ import annotations

import fcntl
import os
import select
import sys
import termios
import time
import tty
from contextlib import suppress

from manyhands.protocol.clock import Duration, seconds

_AT_ONCE = 1 << 16

DRAINING = 0.05
"""s."""


class PortError(OSError):
    """The port cannot be opened, or is gone; the message names it and says what to do."""


class SerialPort:
    """An open port, which no other program opens meanwhile."""

    def __init__(self, path: str, baud: int, end: bytes = b"\0") -> None:
        """Open it raw: eight bits, no parity, no flow control.

        Args:
            path: of the device, as ``/dev/ttyACM0``.
            baud: bits a second; a board behind USB ignores it.
            end: what ends a frame on this port, and so what is left of one that was sent in part.

        Raises:
            PortError: there is none, it may not be opened, or another program has it.
            ValueError: the port knows no such rate.
        """
        speed = getattr(termios, f"B{baud}", None)
        if speed is None:
            raise ValueError(f"baud: found {baud}; expected a rate that termios knows, as 115200, 921600 or 2000000")
        self.path, self._end = path, end
        self._torn = False  # whether the last frame was sent in part
        try:
            self._fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
        except OSError as error:
            raise PortError(f"cannot open {path}: {_why(error)}") from error
        try:
            fcntl.ioctl(self._fd, termios.TIOCEXCL)
            tty.setraw(self._fd, termios.TCSANOW)
            mode = termios.tcgetattr(self._fd)
            mode[2] |= termios.CLOCAL | termios.CREAD
            mode[4] = mode[5] = speed
            termios.tcsetattr(self._fd, termios.TCSANOW, mode)
            termios.tcflush(self._fd, termios.TCIOFLUSH)
        except (OSError, termios.error) as error:
            os.close(self._fd)
            raise PortError(f"cannot use {path}: {error}; expected a serial port") from error

    def read(self) -> bytes:
        """All that has come, perhaps nothing.

        Raises:
            PortError: the board was unplugged.
        """
        try:
            data = os.read(self._fd, _AT_ONCE)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise self._gone(error) from error
        if not data:
            raise self._gone(None)
        return data

    def wait(self, timeout: Duration) -> None:
        """Wait until something has come, at most ``timeout``."""
        select.select([self._fd], [], [], seconds(timeout))

    def write(self, frame: bytes) -> bool:
        """Send a frame at once; False where the port has no room for all of it, so that the board will hear nothing.

        Raises:
            PortError: the board was unplugged.
        """
        whole = self._end + frame if self._torn else frame  # which ends what is left of the last one
        try:
            sent = os.write(self._fd, whole)
        except BlockingIOError:
            return False
        except OSError as error:
            raise self._gone(error) from error
        self._torn = sent < len(whole)
        return not self._torn

    def close(self) -> None:
        """Close it; a second call does nothing.

        What was sent last is given :data:`DRAINING` to leave: it is the release. What is left then is thrown away, for
        the kernel would wait half a minute for a line that does not move.
        """
        if self._fd < 0:
            return
        with suppress(OSError, termios.error):  # an unplugged board
            end = time.monotonic() + DRAINING
            while self._queued() and time.monotonic() < end:
                time.sleep(1e-3)  # the kernel tells nobody when its queue is empty
            if self._queued():  # a pseudo-terminal has no queue, and would throw away what is on its way
                termios.tcflush(self._fd, termios.TCOFLUSH)
        os.close(self._fd)
        self._fd = -1

    def _queued(self) -> int:
        """Bytes that wait to be sent."""
        return int.from_bytes(fcntl.ioctl(self._fd, termios.TIOCOUTQ, bytes(4)), sys.byteorder)

    def _gone(self, error: OSError | None) -> PortError:
        why = "its end" if error is None else error.strerror
        return PortError(f"{self.path}: found {why}; expected a device: see that it is plugged in and has power")


def _why(error: OSError) -> str:
    if isinstance(error, FileNotFoundError):
        return "there is no such port; plug the device in"
    if isinstance(error, PermissionError):
        return "it may not be opened; on most systems the group dialout may (log in again after you have joined it)"
    return f"{error.strerror}; see whether another program has it"
