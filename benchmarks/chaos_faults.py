"""The faults of the chaos campaign in a running session: kinds drawn by a seed, one after the other.

Signals make each fault in the processes themselves, at a moment that the supervisor reports. Mostly the next one
waits until all nodes take part again; now and then it does not.
"""

from __future__ import annotations

import os
import random
import signal
import time
from collections import Counter
from dataclasses import dataclass, field

from chaos_kinds import VICTIMS, Kind, draw

from manyhands.launch.plan.topology import Topology
from manyhands.launch.run.outcome import Progress
from manyhands.launch.run.states import NodeState, SessionPhase
from manyhands.nodes.rows import figures as names
from manyhands.protocol.messages import Role

OVERLAP = 0.15
"""Of all faults, so many come while the one before is not over."""

STUCK = 90.0
"""A session that does not come to its next fault in this time does not go on, s."""


@dataclass
class Chaos:
    """The faults of one run.

    Attributes:
        graph: the session's nodes and links.
        count: how many faults.
        random: what decides.
        done: the kinds so far.
        hits: how often each user may have been made to let go.
        stuck: why the run was given up; empty for none.
        ledgers: the least margin that each node's ledger ever had, J.
    """

    graph: Topology
    count: int
    random: random.Random
    done: Counter[Kind] = field(default_factory=Counter)
    hits: Counter[str] = field(default_factory=Counter)
    stuck: str = ""
    ledgers: dict[str, float] = field(default_factory=dict)
    _since: float = field(default_factory=time.monotonic)
    _calm: int = -1  # the tick from which on everybody took part; -1: not everybody does
    _gap: int = 50  # ticks of calm before the next one
    _held: dict[str, list[bool]] = field(default_factory=dict)  # what becomes of whom at the next looks: True runs
    _interrupted: bool = False

    def show(self, progress: Progress) -> None:
        """Take the supervisor's progress."""
        for node, told in progress.telemetry.items():
            if names.LEDGER_MARGIN in told.figures:
                self.ledgers[node] = min(self.ledgers.get(node, 0.0), told.figures[names.LEDGER_MARGIN])
        if progress.phase is not SessionPhase.RUNNING or self._interrupted:
            return
        self._hold(progress)
        self._watch_calm(progress)
        calm = self._calm >= 0 and self._latest(progress) >= self._calm + self._gap
        if self.done.total() == self.count:
            if calm and not self._held:
                self._interrupt()
        elif calm or (self._held and self.random.random() < OVERLAP / 10) or self._overlaps(progress):
            self._strike(progress)
        if time.monotonic() > self._since + STUCK:
            states = {name: state for name, state in progress.states.items() if state != NodeState.RUNNING.value}
            self.stuck = (
                f"after {self.done.total()} faults it did not go on: {states}, silent {sorted(progress.silent)}"
            )
            for node in list(self._held):
                self._signal(progress, node, signal.SIGCONT)
            self._interrupt()

    def _overlaps(self, progress: Progress) -> bool:
        """Whether the next fault comes while a node rejoins."""
        returning = any(state == NodeState.STARTING.value for state in progress.states.values())
        return returning and self.random.random() < OVERLAP / 3

    def _interrupt(self) -> None:
        self._interrupted = True
        os.kill(os.getpid(), signal.SIGINT)

    def _latest(self, progress: Progress) -> int:
        return min((told.tick for told in progress.telemetry.values()), default=0)

    def _watch_calm(self, progress: Progress) -> None:
        told = progress.telemetry
        running = all(state == NodeState.RUNNING.value for state in progress.states.values())
        frozen = any(one.figures.get(names.FROZEN, 0.0) > 0.0 for one in told.values())
        if not running or frozen or told.keys() != progress.states.keys() or self._held:
            self._calm = -1
        elif self._calm < 0:
            self._calm = max(one.tick for one in told.values())

    def _strike(self, progress: Progress) -> None:
        """Do the next fault."""
        kind, victims = draw(self.graph, [node for node in self.graph.nodes if node in progress.pids], self.random)
        if not victims:
            return  # dead already; another time
        if kind in VICTIMS:
            for node in victims:
                self._held.pop(node, None)
                self._signal(progress, node, signal.SIGKILL)
        else:
            looks = self.random.randint(2, 12)
            self._held[victims[0]] = [False] * looks if kind is Kind.STOPPED else [i % 2 == 1 for i in range(2 * looks)]
        self.hits.update(self._users_of(victims))
        self.done[kind] += 1
        self._since, self._calm, self._gap = time.monotonic(), -1, self.random.randint(20, 250)

    def _hold(self, progress: Progress) -> None:
        """Stop and continue those that are to be."""
        for node, plan in list(self._held.items()):
            runs = plan.pop(0) if plan else True
            self._signal(progress, node, signal.SIGCONT if runs else signal.SIGSTOP)
            if not plan and runs:
                del self._held[node]

    def _signal(self, progress: Progress, node: str, which: signal.Signals) -> None:
        pid = progress.pids.get(node)
        if pid is not None:
            os.kill(pid, which)  # not reaped yet: the supervisor that reported it runs in this very thread

    def _users_of(self, victims: list[str]) -> set[str]:
        """The devices that a fault of ``victims`` makes let go."""
        devices = {node for node, role in self.graph.nodes.items() if role is Role.DEVICE}
        out: set[str] = set()
        for victim in victims:
            match self.graph.nodes[victim]:
                case Role.DEVICE:
                    out.add(victim)
                case Role.COUPLING:
                    ends = {end for link in self.graph.links_of(victim) for end in (link.binder, link.connector)}
                    out |= ends & devices
                case _:
                    out |= devices
        return out
