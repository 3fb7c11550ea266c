"""How much of the force that was asked of a device its hand was given, by force and by time (:class:`ForceGiven`).

A certificate bounds the stiffness that a hand may feel. What it does feel is less wherever a force is held back, ends
early or never comes. Two shares say how much less:

**By force**, the impulse of the forces that were exerted, over that of those that were asked for within the limits:
sum |r| dt over sum |f| dt, all axes added. Energy would not do: r^T d is 0 for a hand that rests at a wall, which may
have lost all of it. This share knows only of forces that were asked for. A device whose coupling is frozen is asked for
nothing, so by force it lacks nothing.

**By time**, the part of the time in which the device exerted all of what was asked, and was asked at all. What is
missing is one of three, :class:`Loss`:

- ``AWAY``: it had no valid answer. It let go of a stale force, and none came; or it had none for so long that the
  session took it in again, and the clutch raised its force from 0 by its ramp. A coupling that is frozen sends no
  force, so that is the same case. One that is held for some ticks answers by its own spring.
- ``HELD_BACK``: the reserve for lateness lowered the force, or let it end before the next one came.
- ``CUT``: a limit of force cut it, or the device was beyond a limit of motion and let go. So counts hardware that
  exerts less than it was given.

Time counts from the first force on. A device that joins a session which runs already rises by the ramp as every
newcomer does, and its time counts from the ramp's end. A device that leaves does so by its own wish, so its time ends
there. A change of rung counts as given.

All times are sums of whole nanoseconds, so an audit finds the same to the last digit.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Final

from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.kernel.timeouts import PATIENCE_TICKS, RAMP
from manyhands.protocol.clock import Duration, Instant

ALL: Final = 0.99
"""The part of a force that counts as all of it: hardware rounds, and a part is found to a thousandth."""

_NS: Final = 1e-9


class Loss(IntEnum):
    """Why a device does not exert all that it is asked for."""

    NONE = 0
    AWAY = 1
    HELD_BACK = 2
    CUT = 3


class ForceGiven:
    """The account of one device. A tick is :meth:`ask` and :meth:`applied`; :meth:`let_go` may come before.

    Attributes:
        asked: the impulse of the forces that were asked for within the limits, N*s.
        given: the impulse of those that were exerted, N*s.
        time: the time that counts, ns.
        lost: by :class:`Loss`, the part of it in which not all was exerted, ns; the first entry stays 0.
    """

    __slots__ = (
        "_absent",
        "_at",
        "_begins",
        "_f",
        "_joins",
        "_left",
        "_loss",
        "_period",
        "_ramp",
        "_size",
        "_wanted",
        "_within",
        "asked",
        "given",
        "lost",
        "time",
    )

    def __init__(self, period: Duration) -> None:
        """No force yet; ``period`` is T, ns."""
        self._period = period
        self.asked = self.given = 0.0
        self.time, self.lost = 0, [0] * len(Loss)
        self._at = Instant(0)  # since when the present force is exerted
        self._begins: Instant | None = None  # from which on time counts
        self._joins = self._absent = self._left = False
        self._ramp = 0  # ticks that the force still rises
        self._loss = Loss.NONE  # of the present force
        self._f: Floats = []  # the force that is asked for, N
        self._within: Floats = []  # the part of it within the limits, N
        self._wanted = self._size = 0.0  # of the present force, within the limits and exerted, N

    def joins(self) -> None:
        """The device comes into a session that runs already."""
        self._joins = self._begins is None

    def skipped(self) -> None:
        """The session has gone on to a later tick: before the first force the device joins there."""
        if self._begins is None:
            self._joins = True

    def leaves(self) -> None:
        """The device leaves: from now on no time counts."""
        self._left = True

    def let_go(self) -> None:
        """The force is stale, and the device has let go: no answer came in time."""
        self._absent = True
        if self._begins is None:
            self._joins = True

    def ask(self, f: Floats, within: Floats) -> None:
        """The couplings ask for f (N), of which ``within`` is what the device's limits allow.

        A hand waits for this force, so both lists are kept, and added up once it is exerted.
        """
        self._f, self._within = f, within

    def applied(self, at: Instant, ended: Instant, early: bool, exerted: Floats, lowered: bool) -> None:
        """The device exerts a force from ``at`` on: count the one before.

        Args:
            at: the instant.
            ended: when the force before had ended, at most ``at``.
            early: whether the reserve had brought that end nearer.
            exerted: the force that is exerted now, N.
            lowered: whether the reserve lowers it.
        """
        since, begins = self._at, self._begins
        acted, span = max(0, ended - since), max(0, at - since)
        self.asked += self._wanted * span * _NS
        self.given += self._size * acted * _NS
        if begins is None:
            self._begins = Instant(at + RAMP * self._period) if self._joins else at
        elif at > begins:
            self._count(max(since, begins), at, ended, early)
        self._at, self._absent = at, False
        if begins is not None and span > PATIENCE_TICKS * self._period:
            self._ramp = RAMP  # the session takes the device in again
        raw, wanted, size = sum(map(abs, self._f)), sum(map(abs, self._within)), sum(map(abs, exerted))
        self._wanted, self._size = wanted, size
        if self._ramp:
            self._ramp -= 1
            self._loss = Loss.AWAY
        elif size >= ALL * raw:
            self._loss = Loss.NONE
        else:
            self._loss = Loss.HELD_BACK if lowered and wanted >= ALL * raw else Loss.CUT

    def conclude(self, at: Instant, ended: Instant) -> None:
        """The process ends at ``at``; where the device had let go, the time since its last force counts as well."""
        begins = self._begins
        if self._absent and begins is not None and at > max(begins, self._at):
            self._count(max(self._at, begins), at, ended, early=False)
            self._at = at

    def _count(self, since: Instant, at: Instant, ended: Instant, early: bool) -> None:
        """Count the time from ``since`` to ``at``, in which the present force was exerted until ``ended``."""
        if self._left:
            return
        self.time += at - since
        acted = max(0, ended - since)
        if self._loss:
            self.lost[self._loss] += acted
        # where no answer came at all, the early end of the force before is not what the hand lacked
        self.lost[Loss.HELD_BACK if early and not self._absent else Loss.AWAY] += at - since - acted
