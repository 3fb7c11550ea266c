"""The user's hand on the keyboard while a device moves: any key ends the motion (:func:`any_key`)."""

from __future__ import annotations

import select
import sys
import termios
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def any_key() -> Iterator[Callable[[], bool]]:
    """While entered, whether a key was pressed; without a terminal none ever is."""
    if not sys.stdin.isatty():
        yield lambda: False
        return
    descriptor = sys.stdin.fileno()
    before = termios.tcgetattr(descriptor)
    tty.setcbreak(descriptor, termios.TCSANOW)  # Ctrl-C still interrupts
    termios.tcflush(descriptor, termios.TCIFLUSH)
    try:
        yield lambda: bool(select.select([descriptor], [], [], 0.0)[0])
    finally:
        termios.tcflush(descriptor, termios.TCIFLUSH)
        termios.tcsetattr(descriptor, termios.TCSANOW, before)
