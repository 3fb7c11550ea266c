"""Who puts how much energy into whom, from the environment's own ports alone, and what each party may put into others.

In a tick a party (a coupling with its devices) puts g_i = -f_e,i^T (x_e,i(k) - x_e,i(k-1)) into the world, J: it is a
supplier where g_i > 0 and a receiver where g_i < 0. All of it passes through one well mixed store, which remembers
whose energy it holds, so that what is stored now and released later is still its supplier's. Of what receivers take
together every owner's part is in proportion to what the store holds of it. What j takes of i's is charged to i; what j
takes of its own is its own again.

What a receiver gives back, of what it has received, is neither its own supply nor charged a second time: it is
``returned``, nobody's. Of what it has received a party may give back at most what a passive hand can store. So a hand
that only gives way is never charged, however often the energy goes to and fro, and however late it comes back.

The world burns some of what it holds, of everybody's in proportion. Where the energy that it stores is known
(:meth:`Energy.bound`), the store holds no more than that. Where it is not, energy is forgotten with the time constant
:data:`MEMORY`. What receivers take beyond the store is the environment's own.

**The budget** of a party is a bucket of E joules, filled with P watts and emptied by charges. Its *room* is the bucket
less what the store still holds of the party's: a charge leaves the room as it is, so that nobody else's motion can
overdraw it, and only the party's own supply takes from it. The party's ratio is 1 down to half a bucket of room, and
falls to 0 with the room; and where it is below 1, the cores halt the party in any tick that is worth more than
its room. So the room stays above 0, unless a single tick at ratio 1 is worth more than three eighths of a bucket. The
others then receive of the party's energy at most E + P t in every window of t seconds, whatever it does. Where the room
falls to :data:`STOP` of the bucket, the party is stopped until half of it is free.

**A posting** enters the work of :data:`POSTING` ticks at once, summed by party: it is the dearest part of what a tick
costs beside its forces. While the ratio of any party is below 1 every tick is posted; and a tick that brings what waits
beyond :data:`SOON` of the smallest bucket is posted with it, so that nobody is noticed later for the waiting.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from manyhands.nodes.arithmetic import Floats

MEMORY: Final = 0.5
"""Time constant of forgetting, s: longer than a period of a hand that shakes something at 3 Hz."""

BOUND_TICKS: Final = 16
"""Ticks between two calls of :meth:`Energy.bound`."""

POSTING: Final = 4
"""Ticks that are entered into the accounts at once."""

SOON: Final = 0.125
"""Part of a bucket that may wait to be entered."""

STOP: Final = 0.05
"""Room, as part of the bucket, at which a party is stopped."""

MOST_PAIRS: Final = 16
"""Parties up to which it is kept who moved whom; of more only what each put into others, and what each received."""


@dataclass(frozen=True)
class EnergyBudget:
    """What a party may put into the others.

    Attributes:
        power: P, W, for as long as it likes.
        energy: E, J, at once.
        store: J of what it has received that it may give back, uncharged.

    Raises:
        ValueError: one of them is not a finite number greater than 0.
    """

    power: float
    energy: float
    store: float

    def __post_init__(self) -> None:
        for found in (self.power, self.energy, self.store):
            if not 0.0 < found < math.inf:
                raise ValueError(f"found {found} in a budget; expected a finite number greater than 0")


class Energy:
    """The accounts of all parties between ticks.

    Attributes:
        given: by party, J that the others have received of its energy.
        received: by party, J that it has received of others' energy, the environment's own and what was returned
            left out.
        moved: by supplier and receiver, J; empty where there are more than :data:`MOST_PAIRS` parties.
        unowned: J that receivers took beyond what the store held: the environment's own.
        restrained: whether the ratio of any party is below 1, or was in the tick before.
        scaled: by party, ticks in which its ratio was below 1.
        stops: by party, how often it was stopped.
    """

    def __init__(
        self, blocks: Sequence[Sequence[int]], budgets: Sequence[EnergyBudget] | None, T: float, known: bool = False
    ) -> None:
        """All accounts at 0, all buckets full.

        Args:
            blocks: the ports of each party.
            budgets: one for each; None where nobody is held to one.
            T: period, s.
            known: whether the energy that the world stores is known, and told by :meth:`bound`.
        """
        n = len(blocks)
        free = EnergyBudget(1e300, 1e300, 1e300)  # of a bucket that is never empty
        self._blocks = [tuple(block) for block in blocks]
        self._plain = self._blocks == [(i,) for i in range(n)]
        keep = 1.0 if known else 1.0 - T / MEMORY
        self._keep = [keep**ticks for ticks in range(POSTING + 1)]
        self._waiting, self._ticks = [0.0] * sum(len(block) for block in self._blocks), 0
        self._own, self._held, self._returned = [0.0] * n, [0.0] * n, 0.0
        self._fixed = [
            (i, budget.power * T, budget.energy, 0.5 * budget.energy, budget.store)
            for i, budget in enumerate([free] * n if budgets is None else budgets)
        ]
        self._bucket = [size for _, _, size, _, _ in self._fixed]
        self._soon = SOON * min(self._bucket, default=0.0)
        self._ratio = [1.0] * n
        self._stopped = [False] * n
        self.given, self.received = [0.0] * n, [0.0] * n
        self.moved = [[0.0] * n for _ in range(n)] if n <= MOST_PAIRS else []
        self.unowned = 0.0
        self.restrained = False
        self.scaled, self.stops = [0] * n, [0] * n

    def enter(self, f: Floats, x_e: Floats, before: Floats) -> None:
        """Account for one tick; it is posted now, or with those after it.

        Args:
            f: f_e(k) by port, N.
            x_e: the tools' positions x_e(k), m.
            before: x_e(k-1), m.
        """
        ends = zip(self._waiting, f, x_e, before, strict=True)
        self._waiting = work = [so_far + force * (last - at) for so_far, force, at, last in ends]
        self._ticks += 1
        if self._ticks == POSTING or self.restrained or max(work) > self._soon:
            self._post()

    def _post(self) -> None:
        work, ticks = self._waiting, self._ticks
        self._waiting, self._ticks = [0.0] * len(work), 0
        self.supply(work if self._plain else [sum([work[port] for port in block]) for block in self._blocks], ticks)

    def supply(self, supplied: Floats, ticks: int = 1) -> None:
        """Post ``ticks`` ticks in which party i put ``supplied[i]`` J into the world, negative where it received."""
        own, held, bucket, ratio = self._own, self._held, self._bucket, self._ratio
        takers: list[tuple[int, float]] = []
        for i, energy in enumerate(supplied):
            if energy > 0.0:
                left = held[i] - energy
                if left >= 0.0:
                    held[i] = left
                    self._returned += energy
                else:
                    self._returned += held[i]
                    held[i] = 0.0
                    own[i] -= left
            elif energy < 0.0:
                takers.append((i, -energy))
        if takers:
            self._take(takers)
        keep = self._keep[ticks]
        if keep < 1.0:
            self._returned *= keep
            self._own = own = [keep * energy for energy in own]
        restrained = False
        for i, filling, size, half, store in self._fixed:
            level = bucket[i] + ticks * filling
            if level > size:
                level = size
            bucket[i] = level
            if held[i] > store:
                held[i] = store
            if level - own[i] < half or ratio[i] < 1.0:
                restrained = True
                self._restrain(i, level - own[i])
        self.restrained = restrained

    def _take(self, takers: list[tuple[int, float]]) -> None:
        """What receivers take comes out of the store, and is charged to its owners.

        Args:
            takers: party and J of each receiver.
        """
        own, held, moved = self._own, self._held, self.moved
        taken = sum([energy for _, energy in takers])
        total = self._returned + sum(own)
        part = 1.0
        if taken < total:
            part = taken / total
        else:
            self.unowned += taken - total
        self._returned -= part * self._returned
        outs = [part * stored for stored in own]
        out = sum(outs)
        for i, energy in takers:
            rate = energy / taken
            self.received[i] += rate * (out - outs[i])
            back = rate * outs[i]
            held[i] += energy - back
            self.given[i] -= back
            self._bucket[i] += back
        for i, energy in enumerate(outs):
            if energy > 0.0:
                own[i] -= energy
                self.given[i] += energy
                self._bucket[i] -= energy
                if moved:
                    row, rate = moved[i], energy / taken
                    for j, share in takers:
                        if j != i:
                            row[j] += rate * share

    def _restrain(self, i: int, room: float) -> None:
        """Choose the ratio of a party whose room is below half its bucket, or was."""
        _, _, size, half, _ = self._fixed[i]
        if self._stopped[i]:
            self._stopped[i] = room < half and not (self._bucket[i] >= size and room >= 2.0 * STOP * size)
        elif room <= STOP * size:
            self._stopped[i] = True
            self.stops[i] += 1
        self._ratio[i] = 0.0 if self._stopped[i] else min(1.0, max(0.0, room / half))
        self.scaled[i] += self._ratio[i] < 1.0

    def ratio(self, party: int) -> float:
        """The greatest ratio that the party's clutch may have."""
        return self._ratio[party]

    def room(self, party: int) -> float:
        """What the party may put into the world in a tick, J: its room, and what it only gives back."""
        return self._bucket[party] - self._own[party] + self._held[party]

    def bound(self, stored: float) -> None:
        """The world stores no more than ``stored`` J: what it has burned goes off everybody's share."""
        if self._ticks:
            self._post()
        total = self._returned + sum(self._own)
        if total > stored:
            part = max(0.0, stored) / total
            self._returned *= part
            self._own = [part * energy for energy in self._own]
