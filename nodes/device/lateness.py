"""Why a tick was late: the device's own work, a partner's answer, or a processor that was not to be had.

A tick is late when its force is applied after the next tick was due. The time from kT, when it was due, to then is
all spent on one of three accounts, known from stamps that the loop takes anyway:

    kT ... ready      own          what the tick before left to do (telemetry, mostly) went on beyond kT
       ... sampled    descheduled  the alarm had rung, and the thread did not run
       ... sent       own          sampling and sending
       ... received   partner      waiting for the forces
       ... applied    own          applying

The thread's processor time in the tick tells how much of its own parts it did run; what they took beyond that
goes from own to descheduled, unless the kernel has not once taken the processor from this thread since the last late
tick: then the thread waited by its own doing, a driver that blocks or a page that had to be read.

**The cause is the greatest of the three accounts**; of equal ones the first of own, descheduled, partner. It is the
cause that a remedy should begin with, not the only one: a tick can be late by three small delays.

What cannot be told apart from within: an answer that came in time while this thread was not woken is the partner's;
a partner that was itself descheduled, or waits for another, is a partner (its own report tells more); what
a hypervisor takes from a virtual processor counts as the thread's own time.
"""

from __future__ import annotations

import resource
from collections.abc import Callable
from enum import StrEnum

from manyhands.protocol.clock import Duration, Instant


class Cause(StrEnum):
    """On what the greatest part of a late tick was spent."""

    OWN = "own"
    DESCHEDULED = "descheduled"
    PARTNER = "partner"


def cause(
    due: Instant,
    ready: Instant,
    sampled: Instant,
    sent: Instant,
    received: Instant,
    applied: Instant,
    computed: Duration | None = None,
    preempted: bool = True,
) -> Cause:
    """The cause of one late tick; its instants are in this order, but that ``ready`` may be before or after ``due``.

    Args:
        due: kT.
        ready: when the loop had nothing left to do but to wait for kT.
        sampled: when it had woken and sampled x(k).
        sent: when x(k) was sent to every coupling.
        received: when the last force was there.
        applied: when f_v(k) was applied.
        computed: processor time of the thread from ``sampled`` on; None where it is not known.
        preempted: whether the kernel may have taken the processor from the thread in this tick.
    """
    began = max(due, ready)
    after = (sent - sampled) + (applied - received)
    own = (began - due) + after
    descheduled = sampled - began
    if computed is not None and preempted:
        not_run = max(after - computed, 0)
        own -= not_run
        descheduled += not_run
    greatest = max(own, descheduled, received - sent)
    if own == greatest:
        return Cause.OWN
    return Cause.DESCHEDULED if descheduled == greatest else Cause.PARTNER


def times_preempted() -> int:
    """How often the kernel has taken the processor from the calling thread."""
    return resource.getrusage(resource.RUSAGE_THREAD).ru_nivcsw


class Lateness:
    """Counts late ticks by their cause.

    A tick that is in time costs one comparison: what else has to be asked of the kernel is asked when it is late.

    Attributes:
        counts: late ticks by cause.
    """

    __slots__ = ("_period", "_preemptions", "_times_preempted", "counts")

    def __init__(self, period: Duration, preemptions: Callable[[], int] = times_preempted) -> None:
        """Make it in the loop's thread.

        Args:
            period: T.
            preemptions: how often this thread has lost the processor so far.
        """
        self.counts = dict.fromkeys(Cause, 0)
        self._period = period
        self._preemptions = preemptions
        self._times_preempted = preemptions()

    def judge(
        self,
        due: Instant,
        ready: Instant,
        sampled: Instant,
        sent: Instant,
        received: Instant,
        applied: Instant,
        computed: Duration | None = None,
    ) -> Cause | None:
        """Count the tick if it was late; the arguments are those of :func:`cause`.

        Returns:
            Its cause; None for a tick that was in time.
        """
        if applied <= due + self._period:
            return None
        times = self._preemptions()
        found = cause(due, ready, sampled, sent, received, applied, computed, times != self._times_preempted)
        self._times_preempted = times
        self.counts[found] += 1
        return found

    def figures(self) -> dict[str, int]:
        """Late ticks by cause, under the names of the report: ``late_own`` and so on."""
        return {f"late_{name.value}": count for name, count in self.counts.items()}
