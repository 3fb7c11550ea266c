"""Sessions with a hostile guest that keeps within its bounds, and honest ones, in virtual time.

    python -m tests.deterministic.hostile [--runs N] [--seed S] [--honest] [--again SEED]

One line for each run; the seed alone makes it happen again. The exit code is 1 if anything did not hold for the others.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import Final

import yaml

from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.run.states import SessionPhase
from manyhands.launch.session import load_session

from .account import account
from .guests import Guest, Leaving, Strategy, Timing, strategy
from .guests import honest as fair
from .innocence import Innocence, Wrong, watched_gates
from .world import SimulatedSession

GUEST: Final = "mal"
HONEST: Final = ("ann", "bea", "cas")
LAYOUTS: Final = ("plain", "split", "joined")
LIMITS: Final = {"force": 8, "displacement": 0.3, "speed": 2}
BUDGETED: Final = LIMITS | {"power": 1, "energy": 0.2}
"""Of the guest: what it may put into the others is far less than it can."""
STRONG: Final = {"force": 60, "displacement": 1, "speed": 8}
"""Where a hand pushes with 20 N: its budget is the default."""
TOLERATED: Final = 1.25
"""Periods of lateness up to which the ladder, whose last rung covers as much, softens the others rather than freezes.

A guest is charged from half of it on; one that is now below and now above that is frozen later than it softens.
"""
TICKS: Final = 500
GIVEN_UP: Final = 60_000_000_000
"""ns of virtual time: far more than so many ticks take, at three periods each and with every pause."""


@dataclass(frozen=True)
class HostileCase:
    """A session with its guest.

    Attributes:
        seed: of all that happens.
        clock: "realtime" or "simulated".
        users: honest ones.
        layout: whether devices have a block each, two blocks each (one an axis), or two honest ones share a block.
        moving: whether the honest hands intend to move.
        strategy: of the guest.
        honest: whether the guest is as honest as the others: it pushes with 20 N at 3 Hz, its connection has a burst
            of late frames, and somebody is slow at the start.
    """

    seed: int
    clock: str
    users: int
    layout: str
    moving: bool
    strategy: Strategy
    honest: bool = False

    def __str__(self) -> str:
        """In words."""
        hands = "moving" if self.moving else "at rest"
        return f"{self.clock}, {self.users} honest ({hands}), {self.layout}: {self.strategy}"


@dataclass(frozen=True)
class HostileOutcome:
    """A run and its findings.

    Attributes:
        ticks: the environment's at the end.
        late: ticks of honest devices later than the certificate covers, of all of them.
        received: J that the others have received at most, net.
        seconds: that it took in virtual time.
        wrong: what did not hold.
        account: of a run with violations.
    """

    ticks: int
    late: int
    received: float
    seconds: float
    wrong: tuple[tuple[Wrong, str], ...]
    account: str


def case(seed: int, honest: bool = False) -> HostileCase:
    """The case of a seed."""
    random = Random(f"case {seed}")
    users = random.randint(1, 3)
    layout = random.choice([one for one in LAYOUTS if one != "joined" or users > 1])
    clock = "simulated" if random.random() < 0.25 else "realtime"
    moving = random.random() < 0.3
    return HostileCase(seed, clock, users, layout, moving, fair(random) if honest else strategy(random), honest)


@cache
def prepared(users: int, layout: str, moving: bool, strong: bool = False) -> Prepared:
    """A session of so many honest users and one more, designed with its ladder.

    With ``strong`` the last one is as honest as the others, and pushes with 20 N at 3 Hz.
    """
    axes = ["x", "y"] if layout == "split" else ["x"]
    devices, couplings, links = {}, {}, []
    for number, name in enumerate((*HONEST[:users], GUEST)):
        force = f"{1.5}*sin(2*pi*{0.7 + 0.4 * number:.1f}*t)" if moving else 0
        if strong and name == GUEST:
            force = "20*sin(2*pi*3*t)"
        devices[name] = {
            "dof": len(axes), "osp": 1.37, "driver": "simulated", "mass": 0.2,
            "limits": STRONG if strong else BUDGETED if name == GUEST else LIMITS,
            "hand": {"operator": {"num": [0.02, 1.2, 20], "den": [1, 10.3, 100]}, "force": [force] * len(axes)},
        }  # fmt: skip
        if len(axes) > 1:
            devices[name]["axes"] = axes
        ports = [f"{name}.{axis}" for axis in axes] if len(axes) > 1 else [name]
        links += [{"between": [port, f"hub{i}"], "stiffness": 2400 + 100 * number, "damping": 0.2}
                  for i, port in enumerate(ports)]  # fmt: skip
        if layout == "split":
            couplings |= {f"{name}_{axis}": {"ports": [f"{name}.{axis}"]} for axis in axes}
        else:
            couplings[f"{name}_c"] = {"devices": [name]}
    if layout == "joined":
        del couplings["ann_c"], couplings["bea_c"]
        couplings = {"both_c": {"devices": ["ann", "bea"]}, **couplings}
    hubs = [f"hub{i}" for i in range(len(axes))]
    links += [{"between": [hub, "ground"], "stiffness": 2600, "damping": 0.5} for hub in hubs]
    session = {
        "session": "hostile", "period": 0.001, "devices": devices, "couplings": couplings,
        "environment": {"type": "network", "masses": dict.fromkeys(hubs, 3.0), "links": links},
        "design": {"coupling": "spring-damper", "tau": 0.0005},
        "faults": {"restarts": 100, "window": 60, "breach": "soften"},
    }  # fmt: skip
    with TemporaryDirectory() as folder:
        path = Path(folder) / "session.yaml"
        path.write_text(yaml.safe_dump(session))
        return prepare(load_session(path))


def run(one: HostileCase, ticks: int = TICKS, frames: bool = False) -> HostileOutcome:
    """Run one session, for so many ticks of its environment."""
    design, plan = prepared(one.users, one.layout, one.moving, one.honest), one.strategy
    tolerated = plan.timing is not Timing.IN_TIME and plan.late <= TOLERATED
    measured = tolerated or plan.timing in (Timing.CREEPING, Timing.RANDOM)
    innocence = Innocence(design, None if one.honest else GUEST, not one.moving, tolerated, measured)
    guest = Guest(GUEST, plan, Random(f"guest {one.seed}"))
    world = SimulatedSession(design, one.clock, one.seed, frames, guest=guest, witness=innocence)
    if one.honest:
        slow_start(world, Random(f"slow {one.seed}"))
    wrong: list[tuple[Wrong, str]] = []
    began, reached, returns, told = world.scheduler.now, 0, 0, ""
    leaves = Random(f"leaves {one.seed}")
    ended = False
    next_leave = leaves.randint(30, plan.stays)

    def watch() -> bool:
        nonlocal reached, ended, next_leave, returns, told
        if world.conductor.phase is SessionPhase.OVER:
            return not world.processes
        reached = max(reached, world.tick)
        if ended or world.conductor.phase is not SessionPhase.RUNNING:
            return False
        if plan.leaving is not Leaving.STAYS and reached >= next_leave:
            process = world.processes.get(GUEST)
            if process is not None and not process.life.starting:
                returns += 1
                next_leave = reached + leaves.randint(30, plan.stays)
                world.note(f"{GUEST} leaves")
                if plan.leaving is Leaving.POLITELY:
                    process.terminate()
                else:
                    world.kill(GUEST)
        stalled = world.scheduler.now - began > GIVEN_UP
        if stalled:
            wrong.append((Wrong.STALLED, f"after {reached} ticks"))
        if stalled or reached >= ticks or (one.clock == "simulated" and refused(world)):
            ended = True
            wrong.extend(innocence.verdict(world, returns))
            told = account(world, frames)
            world.interrupt()
        return False

    world.scheduler.watch = watch
    with watched_gates(world.scheduler, one.clock == "simulated", wrong):
        world.scheduler.run()
    if not ended:
        wrong += innocence.verdict(world, returns)
        told = account(world, frames)
    wrong += [(Wrong.PROMISE, text) for text in world.violations]
    seconds = (world.scheduler.now - began) / 1e9
    return HostileOutcome(
        reached, innocence.late.total(), innocence.most_received, seconds, tuple(wrong), told if wrong else ""
    )


def refused(world: SimulatedSession) -> bool:
    """Whether a sample of the guest was refused: under the simulated clock the others then wait for it for ever."""
    joins = [join for process in world.processes.values() for join in process.joins]
    return any(join.peer.name == GUEST and join.gate.dropped["out_of_range"] for join in joins)


def slow_start(world: SimulatedSession, random: Random) -> None:
    """A party is slow at first, like a process that still reads its program from a disk."""
    process = world.processes[random.choice(list(world.processes))]
    turn = process.turn
    assert turn is not None
    turn.cost = random.uniform(2.0, 12.0)
    world.scheduler.after(random.randint(50_000_000, 300_000_000), lambda: setattr(turn, "cost", 1.0))


def main() -> int:
    """Run the campaign; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--ticks", type=int, default=TICKS)
    parser.add_argument(
        "--honest", action="store_true", help="nobody is hostile: a strong hand, late bursts, slow starts"
    )
    parser.add_argument("--again", type=int, help="only the run of this seed, with an account of what happened")
    parser.add_argument("--frames", action="store_true", help="the account tells of every frame between nodes, too")
    given = parser.parse_args()
    seeds = [given.again] if given.again is not None else [given.seed * 100_000 + i for i in range(given.runs)]
    kinds: Counter[Wrong] = Counter()
    failing = []
    for seed in seeds:
        began, one = time.monotonic(), case(seed, given.honest)
        outcome = run(one, given.ticks, given.frames)
        found = "; ".join(sorted({kind.value for kind, _ in outcome.wrong})) or "sound"
        print(  # noqa: T201 -- what a campaign is for
            f"seed {seed}: {one}: {outcome.ticks} ticks, {outcome.late} late, {outcome.received:.3g} J in "
            f"{outcome.seconds:.2f} s, took {time.monotonic() - began:.1f} s: {found}",
            flush=True,
        )
        kinds.update({kind for kind, _ in outcome.wrong})
        if outcome.wrong:
            failing.append(seed)
            if given.again is not None:
                print("\n".join(f"{kind}: {text}" for kind, text in outcome.wrong), outcome.account, sep="\n")  # noqa: T201
    for kind, count in kinds.most_common():
        print(f"{kind}: {count} of {len(seeds)} runs")  # noqa: T201
    print(f"{len(seeds) - len(failing)} of {len(seeds)} runs sound")  # noqa: T201
    return 1 if failing else 0


if __name__ == "__main__":
    sys.exit(main())
