"""Hostile parties of every kind in simulated sessions, and what the session then says of the honest ones.

    python -m tests.deterministic.blame [--runs N] [--seed S] [--again SEED]

One line for each run; the seed alone makes it happen again. A run is wrong where an honest party is named as broken by
a row of health, an incident, a notice or the last line; or where the session has acted and the cause is not named.
"""

from __future__ import annotations

import argparse
import math
import re
import sys
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from random import Random
from typing import Final

from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.run.states import SessionPhase
from manyhands.launch.session import load_session
from manyhands.nodes.device.drivers import Driver
from manyhands.nodes.monitor.health import PromiseState, missed, verdict
from manyhands.protocol.clock import Instant
from manyhands.protocol.codec import decode, encode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import Figures, PromiseStatus, Sample, Telemetry, Tool, Wave
from manyhands.protocol.transport import Link, TransportError, Trouble

from .scheduler import Scheduler, VirtualClock
from .world import SimulatedSession

BALL: Final = Path(__file__).parents[2] / "launch" / "sessions" / "ball.yaml"
GUILTY: Final = ("right", "right_seat")
HONEST: Final = ("left", "left_seat", "environment")
BEGINS: Final = 1_700_000_000
"""ns of virtual time at which the hostility begins: both users are in by then."""
TICKS: Final = 2500
KINDS: Final = ("waves", "energy", "frozen waves", "flood", "late", "silent", "telemetry", "driver")


@dataclass(frozen=True)
class Hostility:
    """What the hostile party does.

    Attributes:
        seed: of all that is left open.
        kinds: one or several of :data:`KINDS`.
        amplitude: of the tool's motion that its waves state, m.
        frequency: of it, Hz.
        shipped: the energy that its waves claim, J.
        late: delay of its frames, ns.
        linked: whether the two users are behind wave links; otherwise both are in the tick.
    """

    seed: int
    kinds: tuple[str, ...]
    amplitude: float
    frequency: float
    shipped: float
    late: int
    linked: bool

    def __str__(self) -> str:
        """In words."""
        place = "wave links" if self.linked else "in the tick"
        return (
            f"{place}: {', '.join(self.kinds)} ({self.amplitude:.3g} m, {self.frequency:.2g} Hz, {self.shipped:.2g} J, "
            f"{self.late / 1e6:.2f} ms)"
        )


def hostility(seed: int) -> Hostility:
    """That of a seed."""
    random = Random(f"blame {seed}")

    def any_of(least: float, most: float) -> float:
        return math.exp(random.uniform(math.log(least), math.log(most)))

    kinds = tuple(sorted(random.sample(KINDS, random.choice((1, 1, 2, 3)))))
    return Hostility(
        seed,
        kinds,
        any_of(1e-3, 1e3),
        any_of(0.2, 30.0),
        any_of(1e-3, 1e12),
        int(any_of(2e5, 3e7)),
        random.random() < 0.7,
    )


class HostileLink:
    """The end of a link that a hostile node holds."""

    def __init__(self, link: Link, scheduler: Scheduler, plan: Hostility) -> None:
        self._link, self._scheduler, self._plan, self._random = link, scheduler, plan, Random(f"link {plan.seed}")
        self._last: Wave | None = None
        self.recv = link.recv

    def send(self, frame: bytes) -> bool:
        """Send a frame, or what the plan makes of it."""
        plan, scheduler = self._plan, self._scheduler
        if scheduler.now < BEGINS:
            return self._link.send(frame)
        message = decode(frame, MAX_CONTROL_BYTES)
        if isinstance(message, Wave):
            frame = encode(self._changed(message))
        if "silent" in plan.kinds and isinstance(message, Wave | Sample | Tool):
            return True
        if "flood" in plan.kinds:
            for _ in range(40):
                self._link.send(self._random.randbytes(24))
        if "late" in plan.kinds and isinstance(message, Wave | Sample | Tool):
            scheduler.after(int(plan.late * self._random.random()), lambda: self._later(frame))
            return True
        return self._link.send(frame)

    def _changed(self, wave: Wave) -> Wave:
        plan, t = self._plan, (self._scheduler.now - BEGINS) / 1e9
        if "waves" in plan.kinds or "driver" in plan.kinds:
            sums = math.sqrt(5.0) * plan.amplitude * math.sin(2.0 * math.pi * plan.frequency * t)
            wave = replace(wave, sums=(sums,) * len(wave.sums))
        if "energy" in plan.kinds:
            wave = replace(wave, shipped=plan.shipped)
        if "frozen waves" in plan.kinds:
            self._last = self._last or wave
            wave = replace(self._last, tick=wave.tick)
        return wave

    def _later(self, frame: bytes) -> None:
        with suppress(TransportError):
            self._link.send(frame)

    def trouble(self) -> Trouble | None:
        """None that is known."""
        return self._link.trouble()

    def close(self) -> None:
        """Close this end."""
        self._link.close()


class LyingDriver:
    """A device that moves as it likes within its reach, whatever it is sent."""

    def __init__(self, driver: Driver, clock: VirtualClock, plan: Hostility) -> None:
        self._driver, self._clock, self._plan = driver, clock, plan
        self.axes = driver.axes
        self.apply, self.release, self.idle = driver.apply, driver.release, driver.idle
        self.intended_work, self.figures, self.close = driver.intended_work, driver.figures, driver.close

    def sample(self, tick: int, at: Instant) -> Sequence[float]:
        """Where it says that it is."""
        x, now = self._driver.sample(tick, at), self._clock.now()
        if now < BEGINS:
            return x
        wave = math.sin(2.0 * math.pi * self._plan.frequency * (now - BEGINS) / 1e9)
        return [min(self._plan.amplitude, 0.15) * wave] * self.axes


SENSELESS: Final = (math.nan, math.inf, -math.inf, 1e308, -1e308, -1.0, 7.0)
ABOUT: Final = ("clipped", "saturated", "tau_breaches", "let_go", "ledger_margin")
"""Figures that a hostile node may state beside its own."""

ABOUT_OTHERS: Final = {"moved": ["left_seat/right_seat"], "scaled": ["left_seat"], "stops": ["left_seat"]}
"""Tables that it may state, with their keys."""


class BlamedSession(SimulatedSession):
    """A session whose hostile party may send any telemetry."""

    plan: Hostility

    def _hear(self, sender: str, frame: bytes) -> None:
        if sender in GUILTY and "telemetry" in self.plan.kinds and self.scheduler.now >= BEGINS:
            message = decode(frame, MAX_CONTROL_BYTES)
            if isinstance(message, Telemetry):
                value = self.random.choice(SENSELESS)
                said = Figures(
                    dict.fromkeys((*message.figures, *ABOUT), value),
                    {
                        name: dict.fromkeys(keys, value)
                        for name, keys in (message.figures.tables | ABOUT_OTHERS).items()
                    },
                )
                frame = encode(replace(message, figures=said, traces={}))
        super()._hear(sender, frame)


@cache
def prepared(linked: bool) -> Prepared:
    """Two users of one ball, each behind a wave link or both in the tick."""
    free = [] if linked else ["couplings={left_seat: {devices: [left]}, right_seat: {devices: [right]}}"]
    return prepare(load_session(BALL, ["colocate=false", "faults={restarts: 100, window: 60}", *free]))


def named(text: str) -> set[str]:
    """The honest parties that a sentence has as its subject, or as broken."""
    subject = re.match(r"(?:at [\d.-]+ s: )?(\w+)", text)
    accused = re.findall(r"(?:broken|and) by ([\w, ]+?)(?= since| from| \(|[.;]|$)", text)
    names = {name for listed in accused for name in re.split(r", | and ", listed)}
    if subject is not None and "another party moved it" not in text and "passes on is within its budget" not in text:
        names.add(subject[1])
    return names & {*HONEST}


def judge(rows: Sequence[PromiseStatus], incidents: Sequence[str], notices: Sequence[str], acted: bool) -> list[str]:
    """What is wrong in what a session says.

    Args:
        rows: of its health.
        incidents: its sentences.
        notices: likewise.
        acted: whether anything was enforced or broken, so that the cause must be named.
    """
    wrong = [
        f"{row.promise}: {row.state} names {', '.join(row.who)}"
        for row in missed(rows)
        if row.state == PromiseState.BROKEN and {*row.who} & {*HONEST}
    ]
    last = verdict(rows)
    wrong += [f"names {', '.join(named(text))}: {text}" for text in (*incidents, *notices, last) if named(text)]
    said = " ".join([*incidents, *notices, last, *(f"{row.who} {row.remark}" for row in missed(rows))])
    if acted and not any(name in said for name in GUILTY):
        wrong.append(f"the cause is not named: {said}")
    return wrong


@dataclass(frozen=True)
class BlameOutcome:
    """A run: its ticks, its last line, and what is wrong in what was said."""

    ticks: int
    last: str
    wrong: tuple[str, ...]


def run(plan: Hostility, ticks: int = TICKS) -> BlameOutcome:
    """Run one session."""

    def lead(link: Link, scheduler: Scheduler) -> Link:
        return HostileLink(link, scheduler, plan)

    def moved(name: str, driver: Driver, clock: VirtualClock) -> Driver:
        return LyingDriver(driver, clock, plan) if name == "right" and "driver" in plan.kinds else driver

    led = dict.fromkeys(GUILTY, lead)
    world = BlamedSession(prepared(plan.linked), "realtime", plan.seed, moved=moved, led=led)
    world.plan = plan
    until, reached = world.scheduler.now + 4 * ticks * 1_000_000, 0

    def watch() -> bool:
        nonlocal reached
        if world.conductor.phase is SessionPhase.OVER:
            return not world.processes
        reached = max(reached, world.tick)
        if world.conductor.phase is SessionPhase.RUNNING and (reached >= ticks or world.scheduler.now > until):
            world.interrupt()
        return False

    world.scheduler.watch = watch
    world.scheduler.run()
    world.health.conclude()
    rows, said = world.health.rows(), world.conductor.incidents.sentences
    acted = bool(missed(rows))
    notices = [text for cause, text in world.assumptions.notices.items() if cause]
    wrong = [*judge(rows, said, notices, acted), *(f"the session ended: {fault}" for fault in world.conductor.faults)]
    wrong += [text for text in world.violations if not text.startswith(GUILTY)]
    return BlameOutcome(reached, verdict(rows), tuple(wrong))


def main() -> int:
    """Run the campaign; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--ticks", type=int, default=TICKS)
    parser.add_argument("--again", type=int, help="only the run of this seed")
    given = parser.parse_args()
    seeds = [given.again] if given.again is not None else [given.seed * 100_000 + i for i in range(given.runs)]
    failing, kinds = 0, Counter[str]()
    for seed in seeds:
        plan = hostility(seed)
        outcome = run(plan, given.ticks)
        print(f"seed {seed}: {plan}: {outcome.ticks} ticks: {outcome.last}", flush=True)  # noqa: T201 -- a campaign
        for text in outcome.wrong:
            print(f"  WRONG {text}", flush=True)  # noqa: T201 -- likewise
        failing += bool(outcome.wrong)
        kinds.update(plan.kinds if outcome.wrong else ())
    print(f"{len(seeds) - failing} of {len(seeds)} runs name nobody who is honest {dict(kinds)}")  # noqa: T201
    return 1 if failing else 0


if __name__ == "__main__":
    sys.exit(main())
