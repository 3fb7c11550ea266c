"""Who moved whom, and who made whom wait, in a stretch of a session, by the environment's own account: pure.

A party knows that its force was cut, that it let go, or that a force came late. It does not know why, and what it says
may be false. The environment measures at its own ports whose energy went where, and which coupling came after the
others. So what a party reports about itself decides only whether something happened there. The environment's account
decides who is named for it.

The environment's figures are sums, which come about ten times a second. :class:`Causes` keeps the latest of them, so a
question is about the growth of these sums over a stretch of time, widened to the messages around it. What happened
:data:`BEFORE` the stretch counts as well: energy that moves a hand now was given to it a moment ago.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Final

from manyhands.nodes.rows import figures as names
from manyhands.protocol.messages import Figures

BEFORE: Final = 1.0
"""Seconds before a stretch that count as well: twice the time constant with which the store of
:mod:`manyhands.nodes.environment.energy` forgets, and more than a wave link plays late."""

KEPT: Final = 128
"""The messages of the environment that are kept: twelve seconds of them."""

_SUMS: Final = (
    names.MOVED, names.GIVEN, names.RECEIVED, names.SUPPLIED, names.SCALED, names.STOPS, names.WAITED_TICKS,
    names.FROZEN_LATE,
)  # fmt: skip


@dataclass(frozen=True)
class Mover:
    """The party that moved another one.

    Attributes:
        party: a coupling.
        energy: what the other received of it in the stretch, J.
        total: what the other received of all parties, J.
        beyond: whether the environment held the party to its energy budget in the stretch.
    """

    party: str
    energy: float
    total: float
    beyond: bool


class Causes:
    """The environment's sums of a session's last seconds.

    Attributes:
        until: the time up to which the environment has reported, s of the session's time; -inf before its first
            message.
    """

    def __init__(self) -> None:
        """Nothing is reported yet."""
        self.until = -math.inf
        self._rows: deque[tuple[float, Mapping[str, Mapping[str, float]]]] = deque(maxlen=KEPT)

    def forget(self) -> None:
        """The environment has a new process, which counts from 0."""
        self._rows.clear()

    def take(self, at: float, figures: Figures) -> None:
        """Keep the sums of an environment's message that ends at ``at``, s; a sum that makes no sense is left out.

        A message of an earlier time begins the account anew: it is of another process.
        """
        if self._rows and at < self._rows[-1][0]:
            self.forget()
        sums = {
            name: {key: value for key, value in figures.table(name).items() if 0.0 <= value < math.inf}
            for name in _SUMS
        }
        self._rows.append((at, sums))
        self.until = at

    def mover(self, receivers: Collection[str], since: float, until: float) -> Mover | None:
        """Who moved a party between two times, s.

        It is the party of which the receivers took most energy. One that was held to its budget comes before all
        others.

        Args:
            receivers: the party's couplings.
            since: when it began.
            until: when it was over.

        Returns:
            None where the receivers put in at least as much energy of their own as they received of others: then they
            moved themselves.
        """
        begin = since - BEFORE
        own = sum(
            max(self._grown(sum_, name, begin, until) for sum_ in (names.SUPPLIED, names.GIVEN)) for name in receivers
        )
        by = self._received_of(receivers, begin, until)
        total = sum(by.values())
        if not by or total <= own:
            return None
        beyond = {
            party for party in by for sum_ in (names.SCALED, names.STOPS) if self._grown(sum_, party, begin, until)
        }
        party = max(beyond or by, key=by.__getitem__)
        return Mover(party, by[party], total, party in beyond)

    def waited_for(self, own: Collection[str], since: float, until: float) -> dict[str, float]:
        """The couplings, except ``own``, that made the others wait between two times, s, and in how many ticks."""
        found = self._all_grown(names.WAITED_TICKS, since, until)
        return {name: ticks for name, ticks in found.items() if ticks > 0.0 and name not in own}

    def frozen(self, couplings: Collection[str], since: float, until: float) -> dict[str, float]:
        """How often each of these couplings was frozen for staying silent between two times, s."""
        return {name: self._grown(names.FROZEN_LATE, name, since, until) for name in couplings}

    def _received_of(self, receivers: Collection[str], since: float, until: float) -> dict[str, float]:
        """By supplier, J that the receivers took of its energy; of many parties only what each gave in all is known."""
        by: dict[str, float] = {}
        pairs = self._keys(names.MOVED)
        for pair in pairs:
            supplier, _, receiver = pair.partition("/")
            if receiver in receivers and supplier not in receivers:
                by[supplier] = by.get(supplier, 0.0) + self._grown(names.MOVED, pair, since, until)
        if not pairs:
            received = sum(self._grown(names.RECEIVED, name, since, until) for name in receivers)
            given = self._all_grown(names.GIVEN, since, until)
            by = {name: min(energy, received) for name, energy in given.items() if name not in receivers}
        return {name: energy for name, energy in by.items() if energy > 0.0}

    def _all_grown(self, table: str, since: float, until: float) -> dict[str, float]:
        """How much each sum of a table has grown, as :meth:`_grown`."""
        return {key: self._grown(table, key, since, until) for key in self._keys(table)}

    def _keys(self, table: str) -> Collection[str]:
        return self._rows[-1][1][table].keys() if self._rows else ()

    def _grown(self, table: str, key: str, since: float, until: float) -> float:
        """How much a sum has grown from the last message before ``since`` to the first one from ``until`` on."""
        rows = self._rows
        if not rows:
            return 0.0
        # the sums of a session begin at 0; where older messages were dropped, with the oldest that is kept
        before = rows[0][1][table].get(key, 0.0) if len(rows) == KEPT else 0.0
        after = 0.0
        for at, sums in rows:
            value = sums[table].get(key, 0.0)
            if at <= since:
                before = value
            after = value
            if at >= until:
                break
        return max(0.0, after - before)
