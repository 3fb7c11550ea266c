"""Who makes the others wait: a state machine for the environment's late arrivals. Pure.

In every tick the environment reads the signals of its couplings one after the other, and notes when each was there.
The tick is *due* when the devices sample: at the first multiple of T behind the forces of the tick before. Of a tick in
which all signals were there at t_1 <= t_2 <= ..., in the order in which they were read,

    base = max(due, t_1),      waited_i = t_i - max(due, t_{i-1}),      late_i = t_i - base.

A coupling is **late** when late_i exceeds the allowance and it was itself waited for: who was read at once after a late
one was there before. It is charged one tick and the time waited_i, so that the charges of a tick add up to what the
others waited, also where several are late together. Nobody is charged for being first: when all are late alike, nobody
waited for anybody.

Charges fill a bucket that leaks (:data:`BURST`, :data:`SHARE`), and one that is full is a reason to freeze
(docs/decisions/0028-who-is-late.md). A machine that is too slow for the session makes everybody late now and then. So
whenever everybody was late once more, each is forgiven :data:`COMMON` charges.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from manyhands.protocol.clock import Duration

LEAST_ALLOWANCE: Final = 0.25
"""Part of a period that a signal may always come after the first: as much as a device's sample may be off its time."""

SHARE: Final = 0.01
"""Of all ticks, so many may be late for ever: the policy of breaches allows a device as many."""

BURST: Final = 50
"""Late ticks beyond that share before a coupling is frozen: half of what a device tells in one telemetry."""

COMMON: Final = 4
"""Charges that everybody is forgiven when everybody was late once more: on a slow machine nobody is frozen who is late
less than so many times as often as the one who is late least."""

AT_ONCE: Final = 1 / 16
"""Part of a period in which a signal that was there already is read: it was not waited for."""

CROSSING: Final = 0.25
"""Last part of a period in which forces that leave the environment may reach a device before or after it samples."""


def allowance(period: Duration, tau: Duration) -> Duration:
    """How long after the first signal of a tick another may come, ns.

    Half of the delay is for a user's own way to the environment and back, the other half for waiting for others: then
    no delay is beyond ``tau`` but one user's own way is too long, or another user is late.

    Args:
        period: T, ns.
        tau: the longest delay that the session can cover, ns.
    """
    return Duration(max(round(LEAST_ALLOWANCE * period), tau // 2))


class LateArrivals:
    """The charges of a session's couplings, by the index of each.

    Attributes:
        allowance: how long after the first signal of a tick another may come, ns.
        ticks: in which each was late, or was waited for in vain.
        waited: the time that it cost the others, ns.
        lately: the ticks since they were told last in which others waited for each, charged or not.
        added: what each added to the wait in the latest tick that was judged, ns.
    """

    __slots__ = ("_all", "_at", "_level", "_period", "added", "allowance", "lately", "ticks", "waited")

    def __init__(self, number: int, period: Duration, allowance: Duration) -> None:
        """Nobody has been late yet.

        Args:
            number: of couplings.
            period: T, ns.
            allowance: how long after the first signal of a tick another may come, ns.
        """
        self._period, self.allowance = period, allowance
        self.ticks, self.waited, self.added = [0] * number, [0] * number, [0] * number
        self.lately: list[list[int]] = [[] for _ in range(number)]
        self._level, self._at = [0.0] * number, [0] * number  # of the bucket, and the tick when it was that
        self._all = [0] * number  # late ticks that not everybody has had yet

    def begin(self, index: int, tick: int) -> None:
        """A coupling is active since ``tick``: what it is charged with does not lapse while it is away."""
        self._at[index] = max(self._at[index], tick)

    def judge(self, tick: int, due: int, crossed: bool, arrivals: Sequence[tuple[int, int]]) -> list[int]:
        """Charge those who were late in ``tick``.

        Args:
            tick: k.
            due: when the devices sample x(k), ns.
            crossed: whether the forces of the tick before left in the last part of a period (:data:`CROSSING`). Then
                a device may sample a period later, and who comes in time after that is not late.
            arrivals: when each signal was there, ns, and whose, in the order in which they were read.

        Returns:
            Those who are to be frozen: their buckets are full.
        """
        period, allowed = self._period, self.allowance
        base = before = max(due, arrivals[0][0])
        self.added[arrivals[0][1]] = base - due
        full = []
        for at, index in arrivals[1:]:
            waited, late = max(0, at - before), at - base
            self.added[index], before = waited, max(before, at)
            in_next = crossed and period <= at - due <= period + allowed
            if late > allowed and waited > AT_ONCE * period and not in_next and self._charge(index, tick, waited):
                full.append(index)
        self._forgive([index for _, index in arrivals])
        return full

    def missed(self, tick: int, who: Sequence[int], waited: Duration) -> None:
        """All of ``who`` were waited for in vain, together for so long; they are frozen anyway."""
        for index in who:
            self._charge(index, tick, waited // len(who))

    def gone(self, tick: int, who: Sequence[int]) -> None:
        """All of ``who`` were waited for, and then known to be gone: no charge, but the wait is not the others."""
        for index in who:
            self.lately[index].append(tick)

    def _charge(self, index: int, tick: int, waited: int) -> bool:
        """Charge one tick; whether the bucket is full."""
        self.ticks[index] += 1
        self.lately[index].append(tick)
        self.waited[index] += waited
        self._all[index] += 1
        level = max(0.0, self._level[index] - SHARE * (tick - self._at[index])) + 1.0
        self._level[index], self._at[index] = min(level, BURST + 1.0), tick
        return level > BURST

    def _forgive(self, present: Sequence[int]) -> None:
        """Forgive those present what all of them have had."""
        common = min(self._all[index] for index in present)
        if common == 0:
            return
        for index in present:
            self._all[index] -= common
            self._level[index] = max(0.0, self._level[index] - COMMON * common)
