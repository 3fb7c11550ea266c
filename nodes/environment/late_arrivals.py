"""Which couplings make the others wait: a state machine for the environment's late arrivals. Pure.

In every tick the environment reads the signals of its couplings one after the other, and notes when each was there.
The tick is *due* when the devices sample: at the first multiple of T behind the forces of the tick before. In a tick
whose signals were there at t_1 <= t_2 <= ..., in the order in which they were read,

    base = max(due, t_1),      waited_i = t_i - max(due, t_{i-1}),      late_i = t_i - base.

A coupling is **late** when late_i exceeds the allowance and the environment waited for this coupling itself. A signal
that is read at once after a late one was there before, and is not late. A late coupling is charged one tick and the
time waited_i, so the charges of a tick add up to the time that the others waited, also where several are late together.
The first coupling is never charged: when all are late alike, none waited for another.

Charges fill a leaky bucket (:data:`BURST`, :data:`SHARE`), and a coupling whose bucket is full is not waited for
(docs/decisions/0028-who-is-late.md). A machine that is too slow for the session makes every coupling late now and then.
So whenever every coupling was late once more, each is forgiven :data:`COMMON` charges.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from manyhands.protocol.clock import Duration

LEAST_ALLOWANCE: Final = 0.25
"""Part of a period by which a signal may always come after the first; a device's sample may be off its time by that."""

SHARE: Final = 0.01
"""The share of all ticks that may be late for ever; the policy of breaches allows a device as many."""

BURST: Final = 50
"""Late ticks beyond that share before a coupling is not waited for: half of the ticks of a device's telemetry."""

COMMON: Final = 4
"""Charges that each coupling is forgiven when every coupling was late once more.

So on a slow machine every coupling is waited for that is late less than so many times as often as the least late one.
"""

AT_ONCE: Final = 1 / 16
"""Part of a period within which a signal that is there already is read; a signal read so soon was not waited for."""

CROSSING: Final = 0.25
"""Last part of a period in which forces that leave the environment may reach a device before or after it samples."""


def allowance(period: Duration, tau: Duration) -> Duration:
    """How long after the first signal of a tick any other may come, ns.

    Half of the delay is for a user's own way to the environment and back, the other half for the wait for others. A
    delay beyond ``tau`` then means that the user's own way is too long, or that a different user is late.

    Args:
        period: T, ns.
        tau: the longest delay that the session can cover, ns.
    """
    return Duration(max(round(LEAST_ALLOWANCE * period), tau // 2))


class LateArrivals:
    """The charges of a session's couplings, by the index of each.

    Attributes:
        allowance: how long after the first signal of a tick any other may come, ns.
        ticks: by coupling, the ticks in which it was late or did not come.
        waited: by coupling, the time that the others waited for it in them, ns.
        lately: by coupling, the ticks since the last telemetry in which the others waited for it, charged or not.
        added: by coupling, its part of the wait in the latest tick that was judged, ns.
    """

    __slots__ = ("_all", "_at", "_level", "_period", "added", "allowance", "lately", "ticks", "waited")

    def __init__(self, number: int, period: Duration, allowance: Duration) -> None:
        """No coupling has been late yet.

        Args:
            number: the number of couplings.
            period: T, ns.
            allowance: how long after the first signal of a tick any other may come, ns.
        """
        self._period, self.allowance = period, allowance
        self.ticks, self.waited, self.added = [0] * number, [0] * number, [0] * number
        self.lately: list[list[int]] = [[] for _ in range(number)]
        self._level, self._at = [0.0] * number, [0] * number  # of each bucket, and the tick at which it was that
        self._all = [0] * number  # late ticks beyond those that every coupling has had

    def begin(self, index: int, tick: int) -> None:
        """Let no bucket leak before ``tick``, since which the coupling is active: its charges stay while it is away."""
        self._at[index] = max(self._at[index], tick)

    def judge(self, tick: int, due: int, crossed: bool, arrivals: Sequence[tuple[int, int]]) -> list[int]:
        """Charge the couplings that were late in ``tick``.

        Args:
            tick: k.
            due: when the devices sample x(k), ns.
            crossed: whether the forces of the tick before left in the last part of a period (:data:`CROSSING`). Then
                a device may sample a period later, and a signal in time after that is not late.
            arrivals: when each signal was there, ns, and the coupling's index, in the order in which they were read.

        Returns:
            The indices of the couplings that are not waited for from now on: their buckets are full.
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
        """Charge the couplings ``who``, which did not come; the others waited ``waited``, ns, for all of them together.

        The environment waits no longer for them in any case.
        """
        for index in who:
            self._charge(index, tick, waited // len(who))

    def gone(self, tick: int, who: Sequence[int]) -> None:
        """Note that the wait of ``tick`` was for the couplings ``who``, which could not come in time: no charge."""
        for index in who:
            self._note(index, tick)

    def full(self, index: int, tick: int) -> bool:
        """Whether the coupling's bucket has leaked too little by ``tick`` to wait for it again."""
        return self._level[index] - SHARE * (tick - self._at[index]) > BURST

    def _note(self, index: int, tick: int) -> None:
        """Note once that the others waited for the coupling in ``tick``, however often they gave it up in it."""
        lately = self.lately[index]
        if not lately or lately[-1] != tick:
            lately.append(tick)

    def _charge(self, index: int, tick: int, waited: int) -> bool:
        """Charge one late tick; returns whether the bucket is full."""
        self.ticks[index] += 1
        self._note(index, tick)
        self.waited[index] += waited
        self._all[index] += 1
        level = max(0.0, self._level[index] - SHARE * (tick - self._at[index])) + 1.0
        self._level[index], self._at[index] = min(level, BURST + 1.0), tick
        return level > BURST

    def _forgive(self, present: Sequence[int]) -> None:
        """Forgive the couplings ``present`` the late ticks that all of them have had."""
        common = min(self._all[index] for index in present)
        if common == 0:
            return
        for index in present:
            self._all[index] -= common
            self._level[index] = max(0.0, self._level[index] - COMMON * common)
