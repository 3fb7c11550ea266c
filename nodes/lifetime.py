"""How a node's process lives and ends, whatever its role.

A node ends when its ticks are done, when the supervisor asks (SIGTERM), or when the supervisor is gone. The
kernel is asked to send SIGTERM on the parent's death; as that fires on the death of the parent's *thread* and
can be missed before it is asked for, the parent's id is compared as well whenever a node waits in vain.
Ctrl-C is the supervisor's business: nodes ignore it, so that the order of ending stays in one hand.

A node on another machine than its supervisor has no such parent. It looks at its line to the supervisor instead, and
Ctrl-C or Ctrl-backslash in its own terminal, or that terminal's end, ends it.
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
    """What a terminal sends besides Ctrl-C (SIGHUP, SIGQUIT), but for what is ignored, as SIGHUP is under nohup."""
    return tuple(which for which in (signal.SIGHUP, signal.SIGQUIT) if signal.getsignal(which) != signal.SIG_IGN)


class Stopped(Exception):
    """The node was asked to end before its loop had begun."""


class Sight(Enum):
    """What was seen of the supervisor."""

    PRESENT = "present"
    ENDING = "ending"  # it wants this node to end
    GONE = "gone"


def _sight_of(parent: int) -> Sight:
    return Sight.PRESENT if os.getppid() == parent else Sight.GONE


class Life:
    """Whether this process should still run.

    Attributes:
        stopping: becomes true when it should end at the next tick.
        orphaned: becomes true when its supervisor is gone.
        failure: why it ends, if that is a failure.
        signal: the signal that asked it to end, if one did.
        watch: for a node without a parent: looks after the supervisor some other way, and says what it saw.
    """

    def __init__(self, parent: int | None) -> None:
        """Watch over the process whose supervisor has the process id ``parent``, or is on another machine."""
        self.stopping = self.orphaned = False
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
        """:meth:`check`, if that was not done lately; for a loop that is kept busy, cheap enough for every signal."""
        if now >= self._due:
            self._due = Instant(now + _LOOK_EVERY)
            self.check()

    def check(self) -> None:
        """Look after the supervisor; to be called wherever the node has waited in vain."""
        sight = self.watch() if self._parent is None else _sight_of(self._parent)
        if sight is not Sight.PRESENT:
            self.stopping = True
            self.orphaned = sight is Sight.GONE

    def fail(self, text: str) -> None:
        """End at the next tick because of a failure; the first one is the one that is told."""
        self.stopping = True
        self.failure = self.failure or text

    def enter_loop(self) -> None:
        """From now on a request to end is only noted, so that no tick is cut in two."""
        self._raises = False
        if self.stopping:
            raise Stopped
        # what start-up made stays: a collection in a tick would walk all of it
        gc.collect()
        gc.freeze()
        gc.disable()

    def leave_loop(self) -> None:
        """The ticks are over; the collector may run again. A request to end is still only noted."""
        gc.enable()
        gc.unfreeze()

    def _asked_to_stop(self, signum: int, _frame: FrameType | None) -> None:
        self.stopping, self.signal = True, signum
        if self._raises:
            raise Stopped
