"""Hostile guests in real processes, and what the session then says of the honest ones.

    python -m tests.system.blame [--runs N] [--seed S] [--again SEED]

Each run hosts the shipped session with two seats over encrypted sockets. An honest guest takes the left seat; the one
in the right seat does what :func:`tests.deterministic.blame.hostility` plans. Judged is who is named, not how fast it
ran. A session that ended must have named the guest as the cause.
"""

from __future__ import annotations

import argparse
import json
import re
import signal
import sys
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from manyhands.launch.run.outcome import rows_of
from manyhands.nodes.monitor.health import missed, verdict
from manyhands.protocol.messages import PromiseStatus

from ..deterministic.blame import GUILTY, HONEST, BlameOutcome, hostility, judge, named
from ..support.capture import free_ports
from .test_seats import command, guest, hosted, invitation_to

REPOSITORY = Path(__file__).parents[2]
OF_THE_MACHINE = {"pace", "delay", "period", "punctuality", "presence"}
"""What a busy machine breaks by itself: such a row alone asks for no cause, and its names are printed, not judged."""
OF_PROCESSES = re.compile(r"fell silent while running|is back")
"""Incidents that say who came and went; a process without its turn falls silent on a busy machine."""


@dataclass(frozen=True)
class GuestOutcome(BlameOutcome):
    """A run in real processes; ``apart`` is what it said of honest parties' timing, which is not judged."""

    apart: tuple[str, ...] = ()


OF_A_USERS_MACHINE = OF_THE_MACHINE | {"wave link", "lateness energy"}
"""What lateness of a user's own process has the session enforce."""


def run(seed: int, folder: Path, ticks: int = 2000) -> GuestOutcome:
    """Host one session with the hostile guest of a seed; returns what it said."""
    home, here, there, code = (folder / name for name in ("home", "here", "there", "code"))
    code.mkdir()
    armed = f"from tests.deterministic.blamed_guest import arm\narm({seed})\n"
    (code / "sitecustomize.py").write_text(armed)
    address = f"127.0.0.1:{free_ports(4)[0]}"
    path = f"PYTHONPATH={code}:{REPOSITORY}"
    with ExitStack() as stack:
        host = stack.enter_context(hosted(home, address))
        left = stack.enter_context(guest("left_seat", home, here))
        invitation = invitation_to("right_seat", home, there)
        host.joined("left_seat")
        hostile = stack.enter_context(command("join", invitation.name, "--yes", cwd=there, within=("env", path)))
        host.until("right_seat has joined")
        with suppress(AssertionError):  # it has ended; whom it named for that is judged below
            host.go_on(ticks)
        if host.process.poll() is None:
            host.process.send_signal(signal.SIGINT)
        host.process.communicate(timeout=60.0)
        left.process.communicate(timeout=60.0)
        if hostile.poll() is None:
            hostile.send_signal(signal.SIGINT)
        hostile.communicate(timeout=60.0)
    report = json.loads((home / "run.json").read_text())
    rows: list[PromiseStatus] = rows_of(report)
    judged = [row for row in rows if row.promise not in OF_THE_MACHINE]
    incidents, notices = report.get("incidents", []), report.get("notices", [])
    acted = any(row.promise not in OF_A_USERS_MACHINE or {*row.who} & {*GUILTY} for row in missed(judged))
    wrong = judge(judged, [text for text in incidents if not OF_PROCESSES.search(text)], notices, acted)
    last = verdict(rows)
    apart = [
        f"{row.promise} of {', '.join(row.who)}" for row in missed(rows) if {*row.who} & {*HONEST} and row not in judged
    ]
    apart += [text for text in incidents if OF_PROCESSES.search(text) and named(text)]
    if faults := [line for line in host.lines if line.startswith("error: ")]:
        wrong += [
            f"the session ended, and names no cause: {text}" for text in faults if not any(x in text for x in GUILTY)
        ]
        apart += [f"the session ended: {text}" for text in faults]
    return GuestOutcome(host.tick, last, tuple(wrong), tuple(apart))


def main() -> int:
    """Run the campaign; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--again", type=int, help="only the run of this seed")
    given = parser.parse_args()
    seeds = [given.again] if given.again is not None else [given.seed * 100_000 + i for i in range(given.runs)]
    failing = 0
    for seed in seeds:
        with TemporaryDirectory() as folder:
            outcome = run(seed, Path(folder))
        print(f"seed {seed}: {hostility(seed)}: {outcome.ticks} ticks: {outcome.last}", flush=True)  # noqa: T201
        for text in outcome.wrong:
            print(f"  WRONG {text}", flush=True)  # noqa: T201 -- a campaign
        for text in outcome.apart:
            print(f"  not judged: {text}", flush=True)  # noqa: T201 -- likewise
        failing += bool(outcome.wrong)
    print(f"{len(seeds) - failing} of {len(seeds)} runs name nobody who is honest")  # noqa: T201 -- likewise
    return 1 if failing else 0


if __name__ == "__main__":
    sys.exit(main())
