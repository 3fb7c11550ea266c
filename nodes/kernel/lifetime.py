"""When a node's process ends, whatever its role.

A node ends when its ticks are done, when the supervisor asks (SIGTERM), or when the supervisor is gone. The kernel is
asked to send SIGTERM at the parent's death. That signal also comes at the death of the parent's *thread*, and is missed
where the parent dies before the request. So a node also compares the parent's id whenever a wait brings no signal.
Nodes ignore Ctrl-C: the supervisor handles it, so that one process decides the order of ending.

A guest, a node on a different machine than its supervisor, has no such parent. It checks its line to the supervisor
instead. Ctrl-C or Ctrl-backslash in its own terminal, or that terminal's end, ends it.
"""

from __future__ import annotations

import ctypes
import gc
import os
import signal
from collections.abc import Callable
from enum import Enum
from types import FrameType

from manyhands.protocol.clock import Instant, from_seconds

_PR_SET_PDEATHSIG = 1  # linux/prctl.h
_LOOK_EVERY = from_seconds(0.1)


def terminal_signals() -> tuple[signal.Signals, ...]:
    """The signals of a terminal besides Ctrl-C (SIGHUP, SIGQUIT), without ignored ones such as SIGHUP under nohup."""
    return tuple(which for which in (signal.SIGHUP, signal.SIGQUIT) if signal.getsignal(which) != signal.SIG_IGN)


class Stopped(Exception):
    """A request to end came before the node's loop had begun."""


class Sight(Enum):
    """The state of the supervisor, as the node sees it."""

    PRESENT = "present"
    ENDING = "ending"  # the supervisor asks this node to end
    GONE = "gone"


def _sight_of(parent: int) -> Sight:
    return Sight.PRESENT if os.getppid() == parent else Sight.GONE


class Life:
    """Whether this process should still run.

    Attributes:
        stopping: whether the process should end at the next tick.
        leaving: whether a device should let its hand go by a ramp first, and end the process then.
        orphaned: whether its supervisor is gone.
        failure: the reason of a failure that ends it; None without one.
        signal: the number of the signal that asked it to end; None without one.
        watch: for a node without a parent, returns the state of the supervisor.
    """

    def __init__(self, parent: int | None) -> None:
        """Handle the signals of this process.

        Args:
            parent: the supervisor's process id; None for a supervisor on a different machine.
        """
        self.stopping = self.leaving = self.orphaned = False
        self.failure: str | None = None
        self.signal: int | None = None
        self.watch: Callable[[], Sight] = lambda: Sight.PRESENT
        self._parent = parent
        self._raises = True
        self._due = Instant(0)
        signal.signal(signal.SIGTERM, self._asked_to_stop)
        if parent is None:
            for which in (signal.SIGINT, *terminal_signals()):
                signal.signal(which, self._asked_to_stop)
            return
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        prctl = getattr(ctypes.CDLL(None), "prctl", None)
        if prctl is not None:
            prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
        self.check()

    def look(self, now: Instant) -> None:
        """Call :meth:`check` at most every 0.1 s; cheap enough for every tick, also of a loop that never waits."""
        if now >= self._due:
            self._due = Instant(now + _LOOK_EVERY)
            self.check()

    def check(self) -> None:
        """Check that the supervisor is still there; call this after every wait without a signal."""
        sight = self.watch() if self._parent is None else _sight_of(self._parent)
        if sight is not Sight.PRESENT:
            self.stopping = True
            self.orphaned = sight is Sight.GONE

    def fail(self, text: str) -> None:
        """End at the next tick because of a failure, with the message ``text``; the first failure is reported."""
        self.stopping = True
        self.failure = self.failure or text

    def enter_loop(self) -> None:
        """Begin the loop: from now on a request to end only sets ``stopping``, so that it interrupts no tick.

        Raises:
            Stopped: a request to end has come already.
        """
        self._raises = False
        if self.stopping:
            raise Stopped
        # a collection in a tick would walk through all objects of the start-up, which stay anyway
        gc.collect()
        gc.freeze()
        gc.disable()

    def leave_loop(self) -> None:
        """End the loop: the garbage collector may run again. A request to end still only sets ``stopping``."""
        gc.enable()
        gc.unfreeze()

    def _asked_to_stop(self, signum: int, _frame: FrameType | None) -> None:
        self.stopping, self.signal = True, signum
        if self._raises:
            raise Stopped
