"""Example 1 in real time, alone and observed: by its recorder, by ``top``, by a page in a browser, by all of them.

    python benchmarks/watched.py [--rounds N] [--seconds S] [--only NAME ...] [--json FILE] [--markdown FILE]

The session is that of loop.py. Every round runs each variant once, in shuffled order. Onlookers are started when the
session runs, and given some seconds to settle, as is the session that has none; then the delays of the ticks of the
next seconds are taken from the devices' telemetry. This program itself reads that in every variant, so that it is no
difference between them. In one variant all onlookers are then stopped: no node may wait for them.
"""

from __future__ import annotations

import argparse
import json
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import Any

import proc
from loop import PERIOD_US, prepare, tell
from loop_ours import MANYHANDS, until
from loop_runs import Failed, Run
from page import fill
from watched_figures import ALONE, PAGE, RECORDER, VARIANTS, WATCHED, Variant, Window, table
from watched_onlookers import CHROMIUM, Onlookers, looking_on

from manyhands.launch.look.sessions import find_session
from manyhands.launch.plan.topology import topology
from manyhands.launch.session import load_session
from manyhands.protocol.channels import TAU
from manyhands.protocol.clock import from_seconds
from manyhands.protocol.codec import decode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import Observation, Role
from manyhands.protocol.transport.broadcast import Visit

SETTLING = 5.0  # s, from when all are there to the first tick that is measured
PATIENCE = 30.0  # s, beyond its own time, for a measurement to be over
LONGEST = 600.0  # s: the requested duration of a session; it is ended before


@contextmanager
def launched(folder: Path, options: list[str]) -> Iterator[subprocess.Popen[str]]:
    """The session, running; ended by Ctrl-C."""
    with subprocess.Popen(  # noqa: S603 -- our own command
        [*MANYHANDS, "launch", str(folder / "session.yaml"), "--certificate", str(folder / "certificate.json"),
         "--duration", str(LONGEST), *options],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    ) as launch:  # fmt: skip
        try:
            said = until(launch.stderr, ": running")
            if ": running" not in said:
                raise Failed(f"the session ended before it ran:\n{said}")
            yield launch
        finally:
            launch.send_signal(signal.SIGINT)
            try:
                launch.communicate(timeout=PATIENCE)
            except subprocess.TimeoutExpired:
                launch.kill()
                raise


def measured(folder: Path, variant: Variant, devices: list[str], seconds: float) -> dict[str, Any]:
    """One run: ``run`` as of loop.py, and the processors that ``onlookers`` used.

    Raises:
        Failed: an onlooker did not come, or the session did not get through it.
    """
    recording = folder / "run.mcap"
    recording.unlink(missing_ok=True)
    options = ["--record", str(recording)] if RECORDER in variant.onlookers else []
    with (
        launched(folder, options) as launch,
        looking_on(variant.onlookers, launch.pid, folder) as onlookers,
        closing(Visit(find_session(str(launch.pid)).directory)) as visit,
    ):
        settled = time.monotonic() + SETTLING
        first = max((tick for _, tick, _ in _heard(visit, onlookers, settled)), default=0)
        with onlookers.stopped() if variant.stopped else nullcontext():
            theirs = onlookers.pids()
            own = [pid for pid in proc.family(launch.pid) if pid not in theirs]
            began, used = time.monotonic(), [proc.cpu_seconds(pids) for pids in (own, theirs)]
            window = Window(devices, first, round(seconds * 1e6 / PERIOD_US))
            for device, tick, tau in _heard(visit, onlookers, began + seconds + PATIENCE):
                window.take(device, tick, tau)
                if window.over:
                    break
            else:
                raise Failed("the session did not tell of the ticks that were to be measured")
            lasted = time.monotonic() - began
            cpu = [(proc.cpu_seconds(pids) - before) / lasted for pids, before in zip((own, theirs), used, strict=True)]
            memory = sum(proc.resident(pid) or 0.0 for pid in own)
    return {"run": asdict(window.run(PERIOD_US, len(own), cpu[0], memory)), "onlookers": cpu[1]}


def _heard(visit: Visit, onlookers: Onlookers, deadline: float) -> Iterator[tuple[str, int, Any]]:
    """Each word of a device on its delays, until ``deadline``: its name, the tick, and tau (us) of the ticks before."""
    while time.monotonic() < deadline:
        frame = visit.recv(from_seconds(0.05))
        onlookers.read()
        if frame is None:
            continue
        message = decode(frame, MAX_CONTROL_BYTES)
        if isinstance(message, Observation) and TAU in message.traces:
            yield message.node, message.tick, message.traces[TAU][:, 0]


def campaign(names: list[str], rounds: int, seconds: float) -> list[dict[str, dict[str, Any]]]:
    """All runs, interleaved."""
    done: list[dict[str, dict[str, Any]]] = []
    shuffler = random.Random(0)  # noqa: S311 -- an order, no secret
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as temporary:
        folder = Path(temporary)
        prepare(folder)
        graph = topology(load_session(folder / "session.yaml"))
        devices = [name for name, role in graph.nodes.items() if role is Role.DEVICE]
        for number in range(rounds):
            order = list(names)
            shuffler.shuffle(order)
            done.append({})
            for name in order:
                done[-1][name] = measured(folder, VARIANTS[name], devices, seconds)
                run = Run(**done[-1][name]["run"])
                tell(
                    f"round {number + 1}: {name}: tau {run.median:.0f} us, p99 {run.worst('p99'):.0f}, "
                    f"p99.9 {run.worst('p999'):.0f}, late {run.late:.2%}"
                )
    return done


def main() -> None:
    """Measure, print a table, and write what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=4)
    parser.add_argument("--seconds", type=float, default=10.0, help="of each measurement (default: %(default)s)")
    parser.add_argument("--only", nargs="*", metavar="NAME", help=f"beside {ALONE}: {', '.join(VARIANTS)}")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="a page with marks: docs/loop-benchmark.md")
    arguments = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # what it has started is ended, too
    if arguments.rounds < 1 or not 0.0 < arguments.seconds <= LONGEST / 2:
        parser.error(f"expected at least one round, and more than 0 seconds, at most {LONGEST / 2:g}")
    if unknown := set(arguments.only or ()) - set(VARIANTS):
        parser.error(f"--only: found {', '.join(sorted(unknown))}; expected some of {', '.join(VARIANTS)}")
    names = [*dict.fromkeys([ALONE, *(VARIANTS if arguments.only is None else arguments.only)])]
    if any(PAGE in VARIANTS[name].onlookers for name in names) and not Path(CHROMIUM).exists():
        parser.error(f"found no {CHROMIUM}; expected it for the page, or --only without it")
    runs = campaign(names, arguments.rounds, arguments.seconds)
    content = {"machine": proc.machine(), "rounds": arguments.rounds, "seconds": arguments.seconds, "runs": runs}
    text = table(content)
    print(text)
    if arguments.json is not None:
        arguments.json.parent.mkdir(parents=True, exist_ok=True)
        arguments.json.write_text(json.dumps(content, indent=1) + "\n")
    if arguments.markdown is not None:
        fill(arguments.markdown, WATCHED, text)


if __name__ == "__main__":
    main()
