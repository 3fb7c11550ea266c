"""Threads of which exactly one runs at any moment; a seed decides their order and the virtual time.

A node's loop is ordinary code that blocks where it receives and sleeps, so each node has a thread. Instead of blocking,
the thread calls :meth:`Scheduler.wait`, which lets the next thread run. Time is a number: it advances to the earliest
instant at which a thread can go on. A node's computations cost a little of it, drawn by the seed.
"""

from __future__ import annotations

import heapq
import itertools
import random
import sys
import threading
from collections.abc import Callable
from types import FrameType
from typing import Final, Protocol

from manyhands.protocol.clock import Instant

NEVER: Final = Instant(2**62)
COST: Final = 8_000  # ns, at most, between two points at which a node may be made to wait
TOGETHER: Final = 5_000  # ns; threads that can go on within this time go in any order
AT_ONCE: Final = 12  # points passed at most before another gets a turn
PASSES: Final = 0.8  # the chance to go on at a point where there is nothing to wait for
WATCHED: Final = 16  # steps between two looks at the world

Tick = tuple[str, int]
"""A function on a thread's stack and the tick that it is at."""


class Killed(BaseException):
    """The process is gone: nothing of it may catch this, as nothing may catch SIGKILL."""


class Source(Protocol):
    """The object of a wait: frames on their way."""

    def first(self) -> Instant:
        """When the next can be had; NEVER if there is none."""
        ...


class Turn:
    """One thread.

    Attributes:
        name: of its process.
        ready: the instant before which it cannot go on, whatever comes; the future for one that is stopped.
        source: what it waits for; None if only for time.
        deadline: when it goes on without.
        word: what is raised in it the next time that it goes on.
        ended: whether it is over.
        cost: how many times slower it computes than others.
    """

    def __init__(self, name: str, ready: Instant) -> None:
        self.name, self.ready = name, ready
        self.source: Source | None = None
        self.deadline = Instant(0)
        self.word: BaseException | None = None
        self.ended = False
        self.cost = 1.0
        self.passed = 0
        self.baton = threading.Lock()
        self.baton.acquire()
        self.thread: threading.Thread | None = None

    def wakes(self) -> Instant:
        """The earliest instant at which it can go on."""
        if self.word is not None:
            return Instant(0)
        if self.source is None:
            return max(self.ready, self.deadline)
        return max(self.ready, min(self.deadline, self.source.first()))

    def stack(self) -> list[Tick]:
        """Where it is: the product's functions that know of a tick, the innermost first."""
        frame: FrameType | None = sys._current_frames().get(self.thread.ident or 0) if self.thread else None
        found: list[Tick] = []
        while frame is not None:
            tick = frame.f_locals.get("tick", frame.f_locals.get("awaited"))
            if "manyhands" in frame.f_code.co_filename and isinstance(tick, int):
                found.append((frame.f_code.co_name, tick))
            frame = frame.f_back
        return found


class Scheduler:
    """Decides the next thread and the time.

    Attributes:
        random: decides what is left open; the world's only one.
        now: the present instant.
        steps: turns so far.
        watch: looks at the world now and then; whether to stop.
        failure: what went wrong in the world itself, or in a thread beyond what a node may raise.
    """

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self.now = Instant(1_000_000_000)
        self.steps = 0
        self.watch: Callable[[], bool] = lambda: False
        self.failure: BaseException | None = None
        self._turns: list[Turn] = []
        self._timers: list[tuple[int, int, Callable[[], None]]] = []
        self._order = itertools.count()
        self._main = threading.Lock()
        self._main.acquire()
        self._current: Turn | None = None
        self._draining = False

    def at(self, instant: int, deed: Callable[[], None]) -> None:
        """Have ``deed`` done at ``instant``; it may not wait."""
        heapq.heappush(self._timers, (instant, next(self._order), deed))

    def after(self, duration: int, deed: Callable[[], None]) -> None:
        """Have ``deed`` done after a time from now."""
        self.at(self.now + duration, deed)

    def begin(
        self, name: str, run: Callable[[], None], delay: int, ended: Callable[[BaseException | None], None]
    ) -> Turn:
        """Start a thread; at its end it calls ``ended`` with the error, or with None."""
        turn = Turn(name, Instant(self.now + delay))

        def body() -> None:
            turn.baton.acquire()
            error: BaseException | None = turn.word
            if error is None:
                try:
                    run()
                except BaseException as caught:  # noqa: BLE001 -- reported, whatever it is
                    error = caught
            turn.ended = True
            self._turns.remove(turn)
            if not self._draining:
                ended(error)
            self._hand_over(None)

        turn.thread = threading.Thread(target=body, name=f"{name}, deterministic", daemon=True)
        turn.thread.start()
        self._turns.append(turn)
        return turn

    def run(self) -> None:
        """Run the threads until the watch returns True or nothing is left; then end all threads."""
        self._hand_over(None)
        self._main.acquire()
        self._draining = True
        for turn in list(self._turns):
            turn.word = Killed()
            turn.baton.release()
            self._main.acquire()
        if self.failure is not None:
            raise self.failure

    def join(self) -> list[str]:
        """The names of the threads that are left after :meth:`run`."""
        return [turn.name for turn in self._turns]

    def wait(self, source: Source | None, deadline: Instant) -> None:
        """Wait, in a thread of this scheduler, for ``source`` or until ``deadline``."""
        turn = self._current
        assert turn is not None, "only threads of the scheduler wait"
        if self._draining:
            raise Killed
        present = deadline <= self.now or (source is not None and source.first() <= self.now)
        turn.passed += 1
        if present and turn.passed < AT_ONCE and self.random.random() < PASSES and turn.ready <= self.now:
            return
        cost = int(turn.cost * turn.passed * self.random.random() * COST)
        turn.ready, turn.passed = Instant(max(turn.ready, self.now + cost)), 0
        turn.source, turn.deadline = source, deadline
        self._hand_over(turn)
        if turn.word is not None:
            word, turn.word = turn.word, None
            raise word

    def raise_in(self, turn: Turn, word: BaseException) -> None:
        """Have ``word`` raised in a thread; the one of a process that was stopped, too."""
        if not turn.ended:
            turn.word = word

    def _hand_over(self, turn: Turn | None) -> None:
        """Let the next thread run, and return at the next turn of ``turn``."""
        following = None
        if not self._draining:
            try:
                following = self._next()
            except BaseException as error:  # noqa: BLE001 -- raised in the thread that runs the world
                self.failure = self.failure or error
        self._current = following
        if following is turn and turn is not None:
            return
        (self._main if following is None else following.baton).release()
        if turn is not None:
            turn.baton.acquire()
            self._current = turn

    def _next(self) -> Turn | None:
        """The next thread; advances the time to its instant; None to stop."""
        while True:
            self.steps += 1
            if self.steps % WATCHED == 0 and self.watch():
                return None
            wakes = [turn.wakes() for turn in self._turns]
            first = min(wakes, default=NEVER)
            if self._timers and self._timers[0][0] <= max(first, self.now):
                instant, _, deed = heapq.heappop(self._timers)
                self.now = Instant(max(self.now, instant))
                deed()
                continue
            if first == NEVER:
                return None
            soon = max(first, self.now) + TOGETHER
            able = [i for i, wake in enumerate(wakes) if wake <= soon]
            chosen = able[0] if len(able) == 1 else self.random.choice(able)
            self.now = Instant(max(self.now, wakes[chosen]))
            return self._turns[chosen]


class VirtualClock:
    """A :class:`manyhands.protocol.clock.Clock` of a scheduler's time."""

    def __init__(self, scheduler: Scheduler) -> None:
        self._scheduler = scheduler

    def now(self) -> Instant:
        """The present instant."""
        return self._scheduler.now

    def sleep_until(self, t: Instant) -> None:
        """Let others go on until ``t``."""
        if t > self._scheduler.now:
            self._scheduler.wait(None, t)
