"""How long a call takes by itself, on a machine with other work.

A call that waits (for a device, a lock or a file) gives its processor away by itself. From a call that is preempted the
kernel takes the processor, and other programs run. So a call in which the thread was preempted counts by its processor
time, and every other one by the clock.
"""

from __future__ import annotations

import resource
import time
from collections.abc import Callable

Timer = Callable[[], int]


class CallTimer:
    """Times one call after the other in one thread."""

    def __init__(self, clock: Timer = time.perf_counter_ns, preemptions: Timer | None = None) -> None:
        """By default with the clock and the preemptions of this thread.

        Args:
            clock: ns.
            preemptions: how often the thread has been preempted so far.
        """
        self._clock, self._preemptions = clock, preemptions or _preemptions
        self.begin()

    def begin(self) -> None:
        """A call begins."""
        self._preempted, self._processor = self._preemptions(), time.thread_time_ns()
        self._began = self._clock()

    def end(self) -> int:
        """The call is over; returns how long it took by itself, ns."""
        took, processor = self._clock() - self._began, time.thread_time_ns() - self._processor
        return min(took, processor) if self._preemptions() != self._preempted else took


def _preemptions() -> int:
    return resource.getrusage(resource.RUSAGE_THREAD).ru_nivcsw
