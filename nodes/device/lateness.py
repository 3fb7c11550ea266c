"""Why a tick was late: the device's own work, a partner's answer, or a processor that was not to be had.

A tick is late when its force is applied after the next tick was due. The time from kT, when it was due, to then is
all spent on one of three accounts, known from stamps that the loop takes anyway:

    kT ... ready      own          what the tick before left to do (telemetry, mostly) went on beyond kT
       ... sampled    descheduled  the alarm had rung, and the thread did not run
       ... sent       own          sampling and sending
       ... received   partner      waiting for the forces
       ... applied    own          applying

**The cause is the greatest of the three accounts**; of equal ones the first of own, descheduled, partner. It is the
cause that a remedy should begin with, not the only one: a tick can be late by three small delays.

What cannot be told apart from within: an answer that came in time while this thread was not woken is the partner's;
a partner that was itself descheduled, or waits for another, is a partner (its own report tells more); a processor that
the kernel or a hypervisor took while the thread did its own work counts as that work.
"""

from __future__ import annotations

from enum import StrEnum

from manyhands.protocol.clock import Duration, Instant


class Cause(StrEnum):
    """On what the greatest part of a late tick was spent."""

    OWN = "own"
    DESCHEDULED = "descheduled"
    PARTNER = "partner"


def cause(due: Instant, ready: Instant, sampled: Instant, sent: Instant, received: Instant, applied: Instant) -> Cause:
    """The cause of one late tick; its instants are in this order, only ``ready`` may come before ``due``.

    Args:
        due: kT.
        ready: when the loop had nothing left to do but to wait for kT.
        sampled: when it had woken and sampled x(k).
        sent: when x(k) was sent to every coupling.
        received: when the last force was there.
        applied: when f_v(k) was applied.
    """
    began = max(due, ready)
    own = (began - due) + (sent - sampled) + (applied - received)
    descheduled = sampled - began
    greatest = max(own, descheduled, received - sent)
    if own == greatest:
        return Cause.OWN
    return Cause.DESCHEDULED if descheduled == greatest else Cause.PARTNER


class Lateness:
    """Counts late ticks by their cause.

    Attributes:
        counts: late ticks by cause.
    """

    __slots__ = ("_period", "counts")

    def __init__(self, period: Duration) -> None:
        """No tick has been late yet; ``period``: T."""
        self.counts = dict.fromkeys(Cause, 0)
        self._period = period

    def judge(
        self, due: Instant, ready: Instant, sampled: Instant, sent: Instant, received: Instant, applied: Instant
    ) -> Cause | None:
        """Count the tick if it was late; the arguments are those of :func:`cause`.

        Returns:
            Its cause; None for a tick that was in time.
        """
        if applied <= due + self._period:
            return None
        found = cause(due, ready, sampled, sent, received, applied)
        self.counts[found] += 1
        return found

    def figures(self) -> dict[str, int]:
        """Late ticks by cause, under the names of the report: ``late_own`` and so on."""
        return {f"late_{name.value}": count for name, count in self.counts.items()}
