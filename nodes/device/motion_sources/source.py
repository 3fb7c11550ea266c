"""A device without motors that reports how far it is deflected (:class:`MotionSource`), and how its file is opened.

The file is read when the loop asks, without waiting, until nothing is left: the newest report counts. Between reports
the deflection is the last one. A device at rest has reported zero, so silence is no error. A device that is unplugged
ends the read with an error (:class:`MotionSourceError`), and so its node.

**A session names the file, and may be a stranger's.** So nothing is opened but the character devices of the source's
kind, whose names have its pattern, and named pipes, into which another program writes what such a device reports.
"""

from __future__ import annotations

import os
import re
import stat
from abc import ABC, abstractmethod
from typing import ClassVar, Final

MOST_AT_ONCE: Final = 64
"""Reads in one look. A kernel keeps 64 reports of a hidraw device for a reader, and 64 events of a joystick."""

MOST_BUTTONS: Final = 32
"""Buttons of a device that are told apart."""

READ_BYTES: Final = 512
"""Bytes of one read: a report of a hidraw device, or up to 64 events of a joystick."""


class MotionSourceError(ValueError):
    """A device cannot be opened, or has gone; the message names its file and says what to do."""


class MotionSource(ABC):
    """A device that reports its deflection.

    Attributes:
        deflection: of each of :data:`AXES`, from -1 to 1.
        buttons: those that are held down, bit i for the button i.
        pressed: those that were pressed between the last two looks.
        reports: reports that were taken.
        refused: reports that were none of this device's.
    """

    AXES: ClassVar[tuple[str, ...]]
    """The names of its axes, those first that a device of the session has unless it says otherwise."""

    BUTTONS: ClassVar[tuple[str, ...]] = tuple(f"button{i}" for i in range(MOST_BUTTONS))
    """The names of its buttons, by the numbers that its reports have."""

    DEAD_ZONE: ClassVar[float]
    """The part of the full deflection that a device of this kind may report at rest, unless the session says more."""

    NAME: ClassVar[str]
    """In messages."""

    FILES: ClassVar[re.Pattern[str]]
    """The paths of its character devices."""

    PERMISSION: ClassVar[str]
    """What to do where this user may not open them."""

    def __init__(self, device: str) -> None:
        """Open the device.

        Args:
            device: the path of its file; empty for the one that is plugged in.

        Raises:
            MotionSourceError: there is none, it is of another kind, or it cannot be opened.
        """
        self.deflection = [0.0] * len(self.AXES)
        self.reports = self.refused = 0
        self.buttons = self.pressed = 0
        self.path = device or self.found()
        self._fd = self._opened()
        try:
            self._recognise(self._fd, stat.S_ISFIFO(os.fstat(self._fd).st_mode))
        except MotionSourceError:
            self.close()
            raise

    @classmethod
    @abstractmethod
    def found(cls) -> str:
        """The path of the device that is plugged in.

        Raises:
            MotionSourceError: there is none.
        """

    @abstractmethod
    def _recognise(self, fd: int, pipe: bool) -> None:
        """Look at what was opened, a device or a ``pipe``.

        Raises:
            MotionSourceError: it is a device of another kind.
        """

    @abstractmethod
    def _take(self, data: bytes) -> bool:
        """Take in what one read gave; returns whether a button was pressed."""

    def look(self) -> bool:
        """Take in what has come since the last call, without waiting; returns whether a button was pressed.

        Raises:
            MotionSourceError: the device has gone.
        """
        pressed, self.pressed = False, 0
        for _ in range(MOST_AT_ONCE):
            try:
                data = os.read(self._fd, READ_BYTES)
            except BlockingIOError:
                break
            except OSError as error:
                raise self._gone(error.strerror) from error
            if not data:
                raise self._gone("the end of its data")
            pressed = self._take(data) or pressed
        return pressed

    def close(self) -> None:
        """Close the file. A second call does nothing."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def _gone(self, found: str | None) -> MotionSourceError:
        return MotionSourceError(
            f"{self.path}: found {found}; expected reports of a {self.NAME}: plug it in again, and look at the output "
            "of `dmesg` if it was not unplugged"
        )

    def _opened(self) -> int:
        """The descriptor of the device's file; reads of it do not wait."""
        path = os.path.realpath(self.path)
        try:
            mode = os.stat(path).st_mode
            if not stat.S_ISFIFO(mode) and not (stat.S_ISCHR(mode) and self.FILES.fullmatch(path)):
                raise MotionSourceError(
                    f"{self.path}: found another kind of file; expected that of a {self.NAME}, {self.FILES.pattern}, "
                    "or a named pipe with its reports"
                )
            return os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
        except FileNotFoundError:
            raise MotionSourceError(
                f"{self.path}: found no such file; expected a {self.NAME} that is plugged in: look at "
                "`ls /dev/hidraw* /dev/input/js*` before and after, or leave `device` away"
            ) from None
        except PermissionError:
            raise MotionSourceError(
                f"{self.path}: found no permission; expected that this user may read it: {self.PERMISSION}"
            ) from None
        except OSError as error:
            raise MotionSourceError(
                f"{self.path}: found {error.strerror}; expected a {self.NAME} that can be opened: plug it in again"
            ) from error
