"""The energy that each party puts into the others, from the environment's own ports alone, and the party's budget.

In a tick a party (a coupling with its devices) puts the energy g_i = -f_e,i^T (x_e,i(k) - x_e,i(k-1)) into the
environment, J: it is a supplier where g_i > 0 and a receiver where g_i < 0. All energy passes through one well mixed
store. The store keeps account of each owner's energy, so energy that is stored now and released later still belongs to
its supplier. Of the energy that receivers take together, every owner's part is in proportion to what the store holds of
it. Energy of i that j takes is charged to i; energy of its own that j takes is its own again.

A receiver may give back energy that it has received. That is neither its own supply nor charged a second time: it is
``returned``, and has no owner. A party may give back at most as much as a passive hand can store, however late, and
besides what it received lately: beyond a hand's store its memory fades with :data:`MEMORY`. So neither a hand that only
yields is charged, however often the energy goes to and fro, nor one through whom a blow of others passes.

The environment dissipates some of the energy that it holds, of each owner's in proportion. Where the energy that it
stores is known (:meth:`Energy.bound`), the store holds no more than that. Otherwise the store forgets energy with the
time constant :data:`MEMORY`. Energy that receivers take beyond the store is the environment's own.

**The budget** of a party is a bucket of E joules, filled with P watts and emptied by charges. Its *room* is the bucket
less the party's energy that the store still holds. A charge leaves the room as it is, so no other party's motion can
overdraw it: only the party's own supply takes from it. The party's ratio is 1 down to half a bucket of room, and falls
to 0 with the room. Where the ratio is below 1, the cores halt the party in any tick that is worth more than its room.
So the room stays above 0, unless a single tick at ratio 1 is worth more than three eighths of a bucket. The others then
receive of the party's energy at most E + P t in every window of t seconds, whatever it does. Where the room falls to
:data:`STOP` of the bucket, the party is stopped until half of the bucket is free.

**A posting** enters the work of :data:`POSTING` ticks at once, summed by party: beside the forces it is the most costly
part of a tick. While the ratio of any party is below 1 every tick is posted. Where the unposted work of a port exceeds
:data:`SOON` of the smallest bucket it is posted at once, so that no overdraft is noticed later for the waiting.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Final

from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.kernel.energy_budget import EnergyBudget
from manyhands.nodes.rows import figures as names

MEMORY: Final = 0.5
"""Time constant of forgetting, s: longer than the period of a hand that shakes an object at 3 Hz.

What an environment of unknown inside stores is forgotten with it, and what a party received beyond a hand's store.
"""

BOUND_TICKS: Final = 16
"""Ticks between two calls of :meth:`Energy.bound`."""

POSTING: Final = 4
"""Ticks that are entered into the accounts at once."""

SOON: Final = 0.125
"""Part of a bucket that may wait to be entered."""

STOP: Final = 0.05
"""Room, as part of the bucket, at which a party is stopped."""

MOST_PAIRS: Final = 16
"""The most parties for which the energy of each pair is kept; with more, only what each gave and received in all."""


class Energy:
    """The accounts of all parties between ticks.

    Attributes:
        given: by party, the energy of its own that the others have received, J.
        received: by party, the others' energy that it has received, J, without the environment's own and without
            returned energy.
        moved: by supplier and receiver, J; empty where there are more than :data:`MOST_PAIRS` parties.
        supplied: by party, the energy of its own that it has put into the environment, J, without what it gave back.
        unowned: the energy that receivers took beyond what the store held, J: the environment's own.
        restrained: whether the ratio of any party is below 1, or was in the tick before.
        scaled: by party, the number of ticks in which its ratio was below 1.
        stops: by party, how often it was stopped.
    """

    def __init__(
        self, blocks: Sequence[Sequence[int]], budgets: Sequence[EnergyBudget] | None, T: float, known: bool = False
    ) -> None:
        """All accounts at 0, all buckets full.

        Args:
            blocks: the ports of each party.
            budgets: the budget of each party; None for no budgets.
            T: period, s.
            known: whether the energy that the environment stores is known, and given to :meth:`bound`.
        """
        n = len(blocks)
        free = EnergyBudget(1e300, 1e300, 1e300)  # a bucket that is never empty
        self._blocks = [tuple(block) for block in blocks]
        self._plain = self._blocks == [(i,) for i in range(n)]
        keep = 1.0 if known else 1.0 - T / MEMORY
        self._keep = [keep**ticks for ticks in range(POSTING + 1)]
        self._fade = [(1.0 - T / MEMORY) ** ticks for ticks in range(POSTING + 1)]
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
        self.given, self.received, self.supplied = [0.0] * n, [0.0] * n, [0.0] * n
        self.moved = [[0.0] * n for _ in range(n)] if n <= MOST_PAIRS else []
        self.unowned = 0.0
        self.restrained = False
        self.scaled, self.stops = [0] * n, [0] * n

    def enter(self, f: Floats, x_e: Floats, before: Floats) -> None:
        """Account for one tick, which is posted now or together with the ticks after it.

        Args:
            f: f_e(k) by port, N.
            x_e: the tools' positions x_e(k), m.
            before: x_e(k-1), m.
        """
        waiting = self._waiting
        self._waiting = work = [waiting[i] + f[i] * (before[i] - x_e[i]) for i in range(len(waiting))]
        self._ticks += 1
        if self._ticks == POSTING or self.restrained or max(work) > self._soon:
            self._post()

    def _post(self) -> None:
        work, ticks = self._waiting, self._ticks
        self._waiting, self._ticks = [0.0] * len(work), 0
        self.supply(work if self._plain else [sum([work[port] for port in block]) for block in self._blocks], ticks)

    def supply(self, supplied: Floats, ticks: int = 1) -> None:
        """Post ``ticks`` ticks in which party i put ``supplied[i]`` J into the environment; negative for a receiver."""
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
                    self.supplied[i] -= left
            elif energy < 0.0:
                takers.append((i, -energy))
        if takers:
            self._take(takers)
        keep = self._keep[ticks]
        if keep < 1.0:
            self._returned *= keep
            self._own = own = [keep * energy for energy in own]
        restrained, fade = False, self._fade[ticks]
        for i, filling, size, half, store in self._fixed:
            level = bucket[i] + ticks * filling
            if level > size:
                level = size
            bucket[i] = level
            if held[i] > store:
                held[i] = store + fade * (held[i] - store)
            if level - own[i] < half or ratio[i] < 1.0:
                restrained = True
                self._restrain(i, level - own[i])
        self.restrained = restrained

    def _take(self, takers: list[tuple[int, float]]) -> None:
        """Take the receivers' energy out of the store, and charge it to its owners.

        Args:
            takers: index and energy, J, of each receiver.
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
        """Choose the ratio of a party whose room is below half its bucket, or was in the posting before."""
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
        """The energy that the party may put into the environment in a tick, J: its room, and energy it gives back."""
        return self._bucket[party] - self._own[party] + self._held[party]

    def bound(self, stored: float) -> None:
        """Limit the store to ``stored`` J: the energy dissipated since is taken from each owner's part.

        Rounding may have left less than 0 J stored, which counts as 0.
        """
        if self._ticks:
            self._post()
        stored = max(0.0, stored)
        total = self._returned + sum(self._own)
        if total > stored:
            part = stored / total
            self._returned *= part
            self._own = [part * energy for energy in self._own]


def energy_tables(energy: Energy, parties: tuple[str, ...]) -> dict[str, dict[str, float]]:
    """The energy between the ``parties``, and how often a budget scaled or stopped each; without what is 0."""
    pairs = _pairs(parties) if energy.moved else ()
    moved = [value for row in energy.moved for value in row]
    return {
        names.GIVEN: _occurred(parties, energy.given),
        names.RECEIVED: _occurred(parties, energy.received),
        names.SCALED: _occurred(parties, energy.scaled),
        names.STOPS: _occurred(parties, energy.stops),
        names.SUPPLIED: _occurred(parties, energy.supplied),
        names.MOVED: _occurred(pairs, moved),
    }


def _occurred(keys: Sequence[str], values: Sequence[float]) -> dict[str, float]:
    return {key: float(value) for key, value in zip(keys, values, strict=True) if value}


@lru_cache(maxsize=16)
def _pairs(parties: tuple[str, ...]) -> tuple[str, ...]:
    """The keys of the energy of all pairs; to make them anew for each message takes 0.1 ms of a tick."""
    return tuple(f"{supplier}/{to}" for supplier in parties for to in parties)
