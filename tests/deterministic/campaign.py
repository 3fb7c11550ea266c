"""Thousands of faults in virtual time.

    python -m tests.deterministic.campaign [--faults N] [--a-run N] [--seed S] [--clock CLOCK] [--session NAME]

One line for each run; the seed alone makes it happen again. The exit code is 1 if any run did not hold.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

import chaos_kinds

from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.session import load_session

from .account import account
from .faults import Faults
from .world import SimulatedSession

SESSIONS: Final[dict[str, tuple[Path, Sequence[str]]]] = {
    **chaos_kinds.SESSIONS,
    "crossed": (Path(__file__).parent / "crossed.yaml", []),
    "alone": (Path(__file__).parent / "alone.yaml", []),
}


@dataclass(frozen=True)
class CampaignOutcome:
    """A run and its findings.

    Attributes:
        faults: how many there were.
        ticks: the environment's at the end.
        restarts: processes that came back.
        steps: turns of all threads.
        virtual: its length in virtual time, s.
        slowest: the longest from a fault to calm, s of virtual time.
        violations: what did not hold.
        account: for a run with violations, which node waits for which, and the events before.
    """

    faults: int
    ticks: int
    restarts: int
    steps: int
    virtual: float
    slowest: float
    violations: tuple[str, ...]
    account: str


@cache
def prepared(name: str) -> Prepared:
    """One of the sessions, designed."""
    path, overrides = SESSIONS[name]
    return prepare(load_session(path, [*overrides, chaos_kinds.ENDURING]))


def run(name: str, clock: str, faults: int, seed: int, frames: bool = False, ticks: int = 0) -> CampaignOutcome:
    """Run one session with so many faults; with ``frames`` the account lists every frame.

    With ``ticks`` the session ends by itself, and the only faults are processes that stand still for a while.
    """
    world = SimulatedSession(prepared(name), clock, seed, frames, ticks)
    chaos = Faults(world, faults)
    ticks, told = 0, ""
    began = world.scheduler.now

    def watch() -> bool:
        nonlocal told, ticks
        over = chaos.watch()
        ticks = world.tick or ticks
        if over and (chaos.stalled or world.violations):
            told = account(world, frames)  # while its threads still stand where they wait
        return over

    world.scheduler.watch = watch
    world.scheduler.run()
    left = world.scheduler.join()
    violations = [*([chaos.stalled] if chaos.stalled else []), *world.violations]
    violations += [f"the thread of {name} is left" for name in left]
    silent = [node for node in world.graph.nodes if node not in world.conductor.reports]
    if silent and not violations:
        violations.append(f"no last word of {', '.join(silent)}")
    if violations and not told:
        told = account(world, frames)
    return CampaignOutcome(
        chaos.done.total(),
        ticks,
        world.restarts,
        world.scheduler.steps,
        (world.scheduler.now - began) / 1e9,
        chaos.slowest / 1e9,
        tuple(violations),
        told,
    )


def plan(
    faults: int, a_run: int, seed: int, clocks: Sequence[str], names: Sequence[str]
) -> list[tuple[str, str, int, int]]:
    """Session, clock, faults and seed of every run."""
    runs = []
    for number, begin in enumerate(range(0, faults, a_run)):
        clock = clocks[number % len(clocks)]
        name = names[number // len(clocks) % len(names)]
        runs.append((name, clock, min(a_run, faults - begin), seed * 100_000 + number))
    return runs


def main() -> int:
    """Run the campaign; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--faults", type=int, default=1000)
    parser.add_argument("--a-run", type=int, default=20, help="faults in a run, at most")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--clock", choices=["simulated", "realtime"], action="append")
    parser.add_argument("--session", choices=list(SESSIONS), action="append")
    parser.add_argument("--again", type=int, help="only the run of this seed, with --session and --clock")
    parser.add_argument("--ticks", type=int, default=0, help="of the session, which then ends by itself")
    parser.add_argument("--frames", action="store_true", help="the account tells of every frame between nodes, too")
    parser.add_argument("--quiet", action="store_true", help="no account of the runs that fail")
    given = parser.parse_args()
    clocks, names = given.clock or ["simulated", "realtime"], given.session or list(SESSIONS)
    runs = plan(given.faults, given.a_run, given.seed, clocks, names)
    if given.again is not None:
        runs = [(names[0], clocks[0], given.a_run, given.again)]
    failing = []
    for name, clock, faults, seed in runs:
        began = time.monotonic()
        one = run(name, clock, faults, seed, given.frames, given.ticks)
        print(  # noqa: T201 -- what a campaign is for
            f"seed {seed}: {name}, {clock}, {one.faults} faults, {one.ticks} ticks, {one.restarts} restarts, "
            f"{one.steps} steps, {one.virtual:.1f} s, calm after {one.slowest:.2f} s, took "
            f"{time.monotonic() - began:.1f} s: {'; '.join(v.splitlines()[0] for v in one.violations) or 'sound'}",
            flush=True,
        )
        if one.violations:
            failing.append(f"--session {name} --clock {clock} --a-run {faults} --again {seed}")
            if not given.quiet:
                print("\n".join(one.violations), one.account, sep="\n", flush=True)  # noqa: T201
    for one_of_them in failing:
        print(f"failed: python -m tests.deterministic.campaign {one_of_them}")  # noqa: T201
    return 1 if failing else 0


if __name__ == "__main__":
    sys.exit(main())
