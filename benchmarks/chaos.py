"""Hundreds of random faults in running sessions, and the invariants that must hold in each.

    python benchmarks/chaos.py [--simulated N] [--realtime N] [--a-run N] [--seed S] [--json FILE] [--markdown FILE]

Each run is a session of real processes, Example 1 with hands that never rest and four users in turn, with a recording
and a report. Processes are killed, stopped and slowed down by a seed (chaos_faults.py); afterwards the run is held
against the invariants (chaos_checks.py). The exit code is 1 if any did not hold.
"""

from __future__ import annotations

import argparse
import json
import random
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

from chaos_checks import broken_promises, examine, left_behind, step_bounds, unreadable_when_cut
from chaos_faults import Chaos
from chaos_kinds import ENDURING, SESSIONS, Kind
from page import fill

from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.plan.reach import reach
from manyhands.launch.plan.topology import topology
from manyhands.launch.recordings.recording import RecordingError
from manyhands.launch.recordings.tables import read_recording
from manyhands.launch.run import supervisor as supervisor_module
from manyhands.launch.run.recorder import RecorderProcess
from manyhands.launch.run.supervisor import Supervisor
from manyhands.launch.session import load_session
from manyhands.protocol.clock import from_seconds

LOOK = from_seconds(0.05)
INTERRUPTED = 130
MARK = "chaos"


@dataclass(frozen=True)
class Run:
    """A run and its findings.

    Attributes:
        session: its name.
        clock: "realtime" or "simulated".
        seed: of its faults.
        faults: how many of each kind.
        ticks: that the environment did.
        restarts: processes that came back.
        ledger: the least total that any party reported, J.
        force: the greatest force, in parts of its limit.
        step: the greatest step of a force, in parts of its bound.
        let_go: how often a force fell to zero at once.
        missing: ticks of devices that are not in the recording, because no process ran them.
        seconds: how long it took.
        violations: what did not hold.
    """

    session: str
    clock: str
    seed: int
    faults: Mapping[str, int]
    ticks: int
    restarts: int
    ledger: float
    force: float
    step: float
    let_go: int
    missing: int
    seconds: float
    violations: Sequence[str]


@cache
def session(index: int) -> tuple[Prepared, Mapping[str, float]]:
    """One of the two sessions, and how large a step of each user's force may be."""
    path, overrides = list(SESSIONS.values())[index]
    prepared = prepare(load_session(path, [*overrides, ENDURING]))
    return prepared, step_bounds(prepared)


def run(index: int, clock: str, faults: int, seed: int) -> Run:
    """Run one of the sessions with so many faults."""
    prepared, bounds = session(index)
    chance = random.Random(seed)  # noqa: S311 -- which process is killed is no secret
    chaos = Chaos(topology(prepared.session), faults, chance)
    began, before = time.monotonic(), left_behind()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        recorder = RecorderProcess(prepared, clock, path)
        ways = reach(prepared, "ipc")
        outcome = Supervisor(
            prepared, clock=clock, reach=ways, ticks=0, record=False, recorder=recorder, show=chaos.show
        ).run()
        violations = [chaos.stuck] if chaos.stuck else []
        if (outcome.code, outcome.faults) != (INTERRUPTED, ()):
            violations.append(f"found the exit code {outcome.code} and {outcome.faults}; expected {INTERRUPTED}")
        reports = outcome.report["nodes"]
        silent = [node for node in chaos.graph.nodes if node not in reports]
        if silent:
            violations.append(f"no last word of {', '.join(silent)}")
        least = {node: entry["ledger"]["margin"] for node, entry in reports.items() if "ledger" in entry}
        for node, told in chaos.ledgers.items():
            least[node] = min(told, least.get(node, 0.0))
        violations += broken_promises(least)
        try:
            recording = read_recording(path)
            hits = chaos.hits if clock == "simulated" else None
            found = examine(prepared, recording, bounds, hits)
            size = path.stat().st_size
            violations += found.violations
            violations += unreadable_when_cut(path, recording, chance.randint(size // 2, size - 64))
        except RecordingError as error:
            raise SystemExit(f"seed {seed}: {error}") from error
    if left := left_behind() - before:
        violations.append(f"left behind: {', '.join(sorted(left))}")
    return Run(
        prepared.session.name,
        clock,
        seed,
        {kind.value: count for kind, count in sorted(chaos.done.items())},
        reports.get("environment", {}).get("ticks", 0),
        sum(entry.get("incidents", {}).get("restarts", 0) for entry in reports.values()),
        min(least.values(), default=0.0),
        found.force,
        found.step,
        found.let_go,
        found.missing,
        time.monotonic() - began,
        violations,
    )


def table(runs: Sequence[Run]) -> str:
    """The campaign in a few lines: one for each session and clock."""
    lines = [
        "| session | clock | runs | faults | restarts | ticks | least ledger [J] | force / limit | step / bound "
        "| let go | violations |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for key in dict.fromkeys((one.session, one.clock) for one in runs):
        group = [one for one in runs if (one.session, one.clock) == key]
        lines.append(
            f"| {key[0]} | {key[1]} | {len(group)} | {sum(sum(one.faults.values()) for one in group)} "
            f"| {sum(one.restarts for one in group)} | {sum(one.ticks for one in group)} "
            f"| {min(one.ledger for one in group):.2g} | {max(one.force for one in group):.2f} "
            f"| {max(one.step for one in group):.2f} | {sum(one.let_go for one in group)} "
            f"| {sum(len(one.violations) for one in group)} |"
        )
    kinds = {kind: sum(one.faults.get(kind.value, 0) for one in runs) for kind in Kind}
    return "\n".join([*lines, "", "; ".join(f"{kind.value} {count}" for kind, count in kinds.items()) + "."])


def main() -> int:
    """Run the campaign; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--simulated", type=int, default=200, help="faults under the simulated clock")
    parser.add_argument("--realtime", type=int, default=20, help="faults in real time")
    parser.add_argument("--a-run", type=int, default=10, help="faults in a run, at most")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--markdown", type=Path, help="a page with a place for the figures")
    given = parser.parse_args()
    supervisor_module.REFRESH = LOOK
    runs: list[Run] = []
    for clock, count in (("simulated", given.simulated), ("realtime", given.realtime)):
        for number, begin in enumerate(range(0, count, given.a_run)):
            seed = given.seed * 1000 + len(runs)
            runs.append(run(number % 2, clock, min(given.a_run, count - begin), seed))
            one = runs[-1]
            print(
                f"seed {seed}: {one.session}, {one.clock}, {sum(one.faults.values())} faults, {one.ticks} ticks, "
                f"step {one.step:.2f} of its bound, {one.seconds:.0f} s: {'; '.join(one.violations) or 'sound'}",
                flush=True,
            )
    print(table(runs))
    if given.json:
        given.json.write_text(json.dumps({"seed": given.seed, "runs": [asdict(one) for one in runs]}, indent=2) + "\n")
    if given.markdown:
        fill(given.markdown, MARK, table(runs))
    return 1 if any(one.violations for one in runs) else 0


if __name__ == "__main__":
    sys.exit(main())
