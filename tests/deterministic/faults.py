"""The faults of a session of :mod:`tests.deterministic.world`, drawn by its seed, and when it is given up.

Most faults wait for a stretch of calm. Some come while the one before is not over: after a time of any order of
magnitude, or just when a rejoining node sends something to the supervisor.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from typing import Final

from chaos_kinds import Kind, draw

from manyhands.launch.run.states import SessionPhase
from manyhands.protocol.clock import from_seconds

from .process import SimulatedProcess
from .world import SimulatedSession

OVERLAP: Final = 0.35
"""Of all faults, so many come while the one before is not over."""

GAP: Final = (5, 120)  # ticks of calm before a fault
SOON: Final = (2e4, 60e6)  # ns to a fault that does not wait for calm
HELD: Final = (5e5, 200e6)  # ns that a process is stopped
GIVEN_UP: Final = from_seconds(150.0)
"""Of virtual time: a handshake of 20 s and a return of 60 s may fail before."""
MOST_STEPS: Final = 60_000
"""Steps between two faults at most: fifty times as many as there are, and twenty seconds of all waiting in vain."""


@dataclass
class Faults:
    """The faults of one run.

    Attributes:
        world: the session.
        count: how many faults; in a session with an end, as many as come before it, and no process is killed.
        done: the kinds so far.
        stalled: why the run was given up; empty for none.
        slowest: the longest from a fault to calm, ns.
    """

    world: SimulatedSession
    count: int
    done: Counter[Kind] = field(default_factory=Counter)
    stalled: str = ""
    slowest: int = 0
    _since: int = 0
    _steps: int = 0
    _calm: int = -1  # the tick from which on everybody took part; -1: not everybody does
    _gap: int = 20
    _tick: tuple[int, int] = (0, 0)  # the environment's process, and its tick
    _ended: bool = False

    def __post_init__(self) -> None:
        self._since = self.world.scheduler.now
        self._next_at: int | None = None
        self._next_heard: int | None = None

    def watch(self) -> bool:
        """Check the world; returns whether it is over or given up."""
        world = self.world
        if world.conductor.phase is SessionPhase.OVER:
            return not world.processes
        now, steps = world.scheduler.now, world.scheduler.steps
        if now - self._since > GIVEN_UP or steps - self._steps > MOST_STEPS:
            waited = (now - self._since) / 1e9
            self.stalled = f"after {self.done.total()} faults nothing more came about in {waited:.1f} s"
            return True
        if world.conductor.faults:
            return self._refuse()
        if world.conductor.phase is not SessionPhase.RUNNING or self._ended:
            return False
        self._watch_ticks()
        self._watch_calm()
        calm = self._calm >= 0 and world.tick >= self._calm + self._gap
        if self.done.total() >= self.count:
            if calm and not world.conductor.ticks:
                self._ended = True
                self._go_on()
                world.interrupt()
        elif calm or self._overlaps():
            self._strike()
        return False

    def _refuse(self) -> bool:
        """No fault of this campaign is a reason for the session to end."""
        for fault in self.world.conductor.faults:
            self.world.violate(f"the session ended: {fault}")
        return True

    def _watch_ticks(self) -> None:
        process = self.world.processes.get("environment")
        if process is None:
            return
        before, self._tick = self._tick, (process.pid, self.world.tick)
        if before[0] == process.pid and self._tick[1] < before[1]:
            self.world.violate(f"the environment went back from tick {before[1]} to {self._tick[1]}")

    def _watch_calm(self) -> None:
        if not self.world.whole:
            self._calm = -1
        elif self._calm < 0:
            self._calm = self.world.tick
            self.slowest = max(self.slowest, self.world.scheduler.now - self._since)

    def _overlaps(self) -> bool:
        """Whether the next fault comes before there is calm."""
        world = self.world
        if self._next_heard is not None and world.heard > self._next_heard:
            self._next_at, self._next_heard = world.scheduler.now + self._soon(2e6), None
        return self._next_at is not None and world.scheduler.now >= self._next_at

    def _soon(self, most: float) -> int:
        return self._any(SOON[0], most)

    def _any(self, least: float, most: float) -> int:
        return int(math.exp(self.world.random.uniform(math.log(least), math.log(most))))

    def _go_on(self) -> None:
        scheduler, random = self.world.scheduler, self.world.random
        self._since, self._steps = scheduler.now, scheduler.steps
        self._calm, self._gap = -1, random.randint(*GAP)
        self._next_at = self._next_heard = None
        if random.random() < OVERLAP:
            if random.random() < 0.5:
                self._next_at = scheduler.now + self._soon(SOON[1])
            else:
                self._next_heard = self.world.heard + random.randint(0, 3)

    def _strike(self) -> None:
        """Do the next fault."""
        world, random = self.world, self.world.random
        kind, victims = draw(world.graph, list(world.processes), random)
        while world.conductor.ticks and kind not in (
            Kind.STOPPED,
            Kind.SLOW,
        ):  # a death near the end is the supervisor's
            kind, victims = draw(world.graph, list(world.processes), random)
        if not victims:
            return  # dead already; another time
        self.done[kind] += 1
        self._go_on()
        world.note(f"FAULT {self.done.total()}: {kind.value}, {' and '.join(victims)}")
        match kind:
            case Kind.STOPPED:
                world.stop(victims[0], self._any(*HELD))
            case Kind.SLOW:
                self._slow(world.processes[victims[0]], random.randint(3, 12))
            case _:
                for node in victims:
                    world.kill(node)

    def _slow(self, process: SimulatedProcess, times: int) -> None:
        """Stop the process and let it run a little, repeatedly."""
        world = self.world
        if times == 0 or world.processes.get(process.name) is not process:
            return
        stopped, runs = self._any(5e5, 60e6), self._any(1e5, 20e6)
        world.stop(process.name, stopped)
        world.scheduler.after(stopped + runs, lambda: self._slow(process, times - 1))
