"""Recordings of honest sessions in real time, with faults, open clutches and frozen users: an audit accuses nobody.

    python -m tests.deterministic.honest [--recordings N] [--seed S] [--ticks N]

Every session is whole: the product's nodes and conductor, in virtual time (:mod:`tests.deterministic.world`), with
devices in wall time. Processes are killed, stopped for up to 200 ms, and slow for a while; users are frozen and
come back by a ramp; couplings change their rungs, and users are held to their energy budgets. One line for each
recording; the exit code is 1 if an honest party was accused.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from random import Random
from typing import Final

import chaos_kinds

from manyhands.launch.audit.audit import Audit
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.session import load_session
from manyhands.nodes.monitor.health import PROMISES, PromiseState
from manyhands.nodes.rows.promises import Promise
from manyhands.nodes.rows.tick_events import events_in

from .recorded import Told, WatchedSession, audited
from .world import SimulatedSession

HERE: Final = Path(__file__).parent
EXAMPLE: Final = HERE.parents[1] / "launch" / "sessions" / "example1.yaml"
ROOM: Final = [f"devices.{name}.limits={{force: 40, displacement: 2, speed: 2}}" for name in ("dx", "dy", "dz")]
"""Limits that a return after a silence does not reach; the restless hands' own are reached at times."""

EXAMPLE_1: Final = [*chaos_kinds.RESTLESS, *ROOM]

KINDS: Final[dict[str, tuple[Path, Sequence[str]]]] = {
    "restless": (EXAMPLE, [*EXAMPLE_1, chaos_kinds.ENDURING]),
    "clipped": (EXAMPLE, [*chaos_kinds.RESTLESS, chaos_kinds.ENDURING]),
    "tight": (EXAMPLE, [*EXAMPLE_1, chaos_kinds.ENDURING, "design.tau=0", "design.ladder=[]"]),
    "ladder": (EXAMPLE, [*EXAMPLE_1, "design.tau=0.0003", "faults={restarts: 100, window: 60}"]),
    "budget": (
        EXAMPLE,
        [
            *EXAMPLE_1,
            chaos_kinds.ENDURING,
            "devices.dy.limits={force: 40, displacement: 2, speed: 2, power: 0.001, energy: 0.002}",
        ],
    ),
    "four": (chaos_kinds.FOLDER / "chaos_four.yaml", [chaos_kinds.ENDURING]),
    "crossed": (HERE / "crossed.yaml", [chaos_kinds.ENDURING]),
    "alone": (HERE / "alone.yaml", [chaos_kinds.ENDURING]),
}
"""By kind, the session's file and its overrides."""


@cache
def prepared(kind: str) -> Prepared:
    """The session of a kind, designed."""
    path, overrides = KINDS[kind]
    return prepare(load_session(path, overrides))


@dataclass(frozen=True)
class Honest:
    """An honest recording and what its audit found.

    Attributes:
        kind: of the session.
        happened: the events in the recording, by kind.
        done: the audit.
    """

    kind: str
    happened: Counter[str]
    done: Audit

    @property
    def accused(self) -> list[str]:
        """Who was accused, and of what; not of a force that was clipped, which the run's own telemetry counts."""
        found = [f"{check.party}: {check.name}: {check.first}" for check in self.done.broken]
        rows = (row for row in self.done.promises if PROMISES[Promise(row.promise)].needed)
        broken = (row for row in rows if row.state == PromiseState.BROKEN and row.promise != Promise.FORCE)
        return found + [f"{row.promise} {row.who}" for row in broken]


def trouble(ticks: int, seed: int, least: int = 1, most: int = 4) -> Callable[[SimulatedSession], None]:
    """Plans faults at random in a session of so many ticks."""
    random = Random(seed)

    def plan(session: SimulatedSession) -> None:
        for _ in range(random.randint(least, most)):
            at = int(random.uniform(0.03, 0.85) * ticks * 1e6)
            held = int(math.exp(random.uniform(math.log(5e5), math.log(2e8))))
            node = random.choice(list(session.graph.nodes))
            if random.random() < 0.3:
                session.scheduler.after(at, lambda node=node: session.kill(node))
            else:
                session.scheduler.after(at, lambda node=node, held=held: session.stop(node, held))

    return plan


def one(seed: int, ticks: int, folder: Path, kind: str | None = None) -> Honest:
    """The recording of one seed, and its audit."""
    kind = kind or list(KINDS)[seed % len(KINDS)]
    session = WatchedSession(prepared(kind), trouble(ticks, seed), ticks, seed)
    assert session.violations == [], session.violations
    return Honest(kind, happened_in(session.told), audited(folder / f"{seed}.mcap", prepared(kind), session.told))


def happened_in(told: Told) -> Counter[str]:
    """How many events of each kind the nodes have reported."""
    return Counter(event.kind.value for messages in told.values() for of in messages for event in events_in(of.figures))


def main() -> int:
    """Run the campaign; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recordings", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--ticks", type=int, default=900)
    parser.add_argument("--keep", type=Path, help="a folder in which the recordings stay")
    given = parser.parse_args()
    accused = 0
    with tempfile.TemporaryDirectory() as temporary:
        for number in range(given.recordings):
            seed, began = given.seed * 100_000 + number, time.monotonic()
            honest = one(seed, given.ticks, given.keep or Path(temporary))
            words = "; ".join(honest.accused)
            accused += bool(words)
            happened = ", ".join(f"{count} {kind}" for kind, count in sorted(honest.happened.items()))
            print(  # noqa: T201 -- what a campaign is for
                f"seed {seed}: {honest.kind}, {happened}; took {time.monotonic() - began:.1f} s: "
                f"{words or honest.done.verdict}",
                flush=True,
            )
    print(f"{given.recordings} honest recordings: {accused} accused somebody")  # noqa: T201
    return 1 if accused else 0


if __name__ == "__main__":
    sys.exit(main())
