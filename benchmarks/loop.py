"""Example 1's whole chain in real time beside the same chain carried by bare pyzmq and by others, in one run.

    python benchmarks/loop.py [--rounds N] [--seconds S] [--json FILE] [--plot FILE] [--markdown FILE]
    python benchmarks/loop.py --install          # gets the others, into out/peers-venv and from Debian's packages
    python benchmarks/loop.py --soak 600         # ours alone, and how its memory grows

device -> coupling -> environment -> coupling -> device for three users at 1 kHz: seven processes. Ours is what
``manyhands launch`` starts, with all it does in a tick. The others are the same seven processes with the same links,
lengths of frame and pacing (absolute deadlines, timer slack 1 ns, collector frozen), granted what our nodes are found
to be granted (processors, scheduling), and with no mathematics. Ours runs in four variants: as it is, with each
coupling in its device's process, and both with a compiled tick (docs/decisions/0032-a-compiled-tick.md). Every round
runs each once, in shuffled order: on a machine that others use, only the ratio to bare pyzmq within a round is
reliable. tau is from sampling x to having f_v.
"""

from __future__ import annotations

import argparse
import json
import random
import signal
import subprocess
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path

import proc
from loop_figures import SOAK, TABLE, plot, soak_table, table
from loop_middleware import BARE, FOLDER, MIDDLEWARES, PEERS_VENV, peer
from loop_ours import MANYHANDS, OURS, VARIANTS, install_compiled, ours
from loop_runs import Failed, Run, Treatment
from page import add_outputs, fill, make_folders, tell

from manyhands.launch.plan.topology import topology
from manyhands.launch.session import load_session
from manyhands.protocol.clock import from_seconds

SESSION = FOLDER.parent / "launch" / "sessions" / "example1.yaml"
PERIOD_US = 1000.0  # of the session
SETTLING = 1.0  # s, of a run that is thrown away: files are read, and it is seen what our nodes are granted


def prepare(folder: Path, colocated: bool = False) -> dict[str, object]:
    """Put the session and its certificate into ``folder``; the plan of its chain.

    The session is designed for this machine, as ``launch`` does it without a certificate.
    """
    text = SESSION.read_text().replace("\ndesign:\n", "\ndesign:\n  tau: auto\n")
    (folder / "session.yaml").write_text(f"{text}\ncolocate: {str(colocated).lower()}\n")
    subprocess.run(  # noqa: S603 -- our own command
        [*MANYHANDS, "design", str(folder / "session.yaml"), "-o", str(folder / "certificate.json")],
        check=True,
        capture_output=True,
    )
    session = load_session(folder / "session.yaml")
    graph = topology(session)
    return {
        "roles": {name: role.value for name, role in graph.nodes.items()},
        "links": [[link.binder, link.connector] for link in graph.links],
        "period": from_seconds(session.period),
    }


def campaign(
    names: list[str], rounds: int, seconds: float
) -> tuple[list[dict[str, Run]], dict[str, str], dict[str, Treatment]]:
    """All runs, interleaved; what did not run, and why; and what our processes were granted."""
    done: list[dict[str, Run]] = []
    failed: dict[str, str] = {}
    shuffler = random.Random(0)  # noqa: S311 -- an order, no secret
    plan: dict[str, object] = {}  # of the chain with seven processes
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        folders = {False: folder / "separate", True: folder / "colocated"}
        for colocated, own in folders.items():
            own.mkdir()
            prepared = prepare(own, colocated)
            plan = plan or prepared
        _, seen = ours(folders[False], min(SETTLING, seconds))
        for number in range(rounds):
            order = list(names)
            shuffler.shuffle(order)
            done.append({})
            for name in order:
                if name in failed:
                    continue
                try:
                    if (variant := VARIANTS.get(name)) is not None:
                        run, _ = ours(folders[variant.colocated], seconds, compiled=variant.compiled)
                    else:
                        run = peer(name, seconds, plan, seen.treatment, folder / f"{name}-{number}")
                except Failed as error:
                    if name in (OURS, BARE):
                        raise
                    failed[name] = str(error)
                    tell(f"round {number + 1}: {name}: {error}")
                    continue
                done[-1][name] = run
                tell(
                    f"round {number + 1}: {name}: tau {run.median:.0f} us, p99 {run.worst('p99'):.0f}, "
                    f"p99.9 {run.worst('p999'):.0f}, late {run.late:.2%}"
                )
    return done, failed, seen.treatment


def soak(seconds: float) -> dict[str, object]:
    """Our processes' memory (MiB) over one long run."""
    with tempfile.TemporaryDirectory() as temporary:
        prepare(Path(temporary))
        run, seen = ours(Path(temporary), seconds)
    return {"run": asdict(run), "seconds": seen.seconds, "resident": seen.resident}


def install() -> None:
    """Install the compiled tick and every middleware; a failure is reported, and the others go on."""
    tell(f"compiled tick: {'installed' if install_compiled() else 'missing'}")
    if not PEERS_VENV.exists():
        subprocess.run([sys.executable, "-m", "venv", str(PEERS_VENV)], check=True)  # noqa: S603
    for name, middleware in MIDDLEWARES.items():
        if middleware.installs:
            try:
                code = subprocess.run(middleware.installs, check=False).returncode  # noqa: S603 -- the table's
                tell(f"{name}: {'installed' if code == 0 else f'exit code {code}'}")
            except OSError as error:
                tell(f"{name}: {middleware.installs[0]}: {error.strerror}")


def main() -> None:
    """Measure, print a table, and write what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=6)
    parser.add_argument("--seconds", type=float, default=10.0, help="of each run (default: %(default)s)")
    parser.add_argument("--only", nargs="*", metavar="NAME", help=f"beside ours and {BARE}: {', '.join(MIDDLEWARES)}")
    parser.add_argument("--soak", type=float, metavar="SECONDS", help="ours alone, for its memory")
    parser.add_argument("--install", action="store_true", help="get what is measured beside ours, and end")
    add_outputs(parser)
    arguments = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # what it has started is ended, too
    if arguments.install:
        return install()
    if arguments.rounds < 1 or arguments.seconds <= 0.0 or (arguments.soak is not None and arguments.soak <= 0.0):
        parser.error("expected at least one round, and more than 0 seconds")
    if unknown := set(arguments.only or ()) - set(MIDDLEWARES):
        parser.error(f"--only: found {', '.join(sorted(unknown))}; expected some of {', '.join(MIDDLEWARES)}")
    make_folders(arguments.json, arguments.plot)
    if arguments.soak is not None:
        content = {"machine": proc.machine(), **soak(arguments.soak)}
        text, mark = soak_table(content), SOAK
    else:
        names = [*VARIANTS, *dict.fromkeys([BARE, *(MIDDLEWARES if arguments.only is None else arguments.only)])]
        done, failed, treatment = campaign(names, arguments.rounds, arguments.seconds)
        content = {
            "machine": proc.machine(),
            "rounds": arguments.rounds,
            "seconds": arguments.seconds,
            "period_us": PERIOD_US,
            "treatment": {node: str(one) for node, one in treatment.items()},
            "failed": failed,
            "runs": [{name: asdict(run) for name, run in of.items()} for of in done],
        }
        text, mark = table(content), TABLE
        if arguments.plot is not None:
            plot(content, arguments.plot)
    print(text)
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(content, indent=1) + "\n")
    if arguments.markdown is not None:
        fill(arguments.markdown, mark, text)


if __name__ == "__main__":
    main()
