"""How long a certified design takes, and how much memory, against the number of ports.

    python benchmarks/design.py [--ports 3 6 12 ...] [--limit SECONDS] [--memory GIB] [--repeats N] [--to FOLDER]

Every run is a process of its own, with a limit on time and memory, so that no run warms the next one up and peak memory
is its own; methods are interleaved, so that a machine that slows down slows all of them. Linear algebra has one
thread, as in the command line. Of the repeats the median is shown, with least and greatest. Measured is from the
physical data to the proved certificate (for the transcription: to its last iterate), without the interpreter's start.
The methods are

- this package, for a passive network of m masses, decentralised;
- this package, for the same network softer and one tick late, which is not passive: dense, up to 100 ports;
- a plain cvxpy transcription of Theorem 4 (transcription.py) with Clarabel, and, as that mostly fails, in states scaled
  by energy with Clarabel and with SCS. Where it converges, its coupling is handed to this package, to prove or refuse.

Once a transcription reaches a limit, its sizes above 24 ports are not tried, and the table shows this.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import subprocess
import sys
import textwrap
import time
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).resolve().parent
SIZES = (3, 6, 12, 24, 48, 100, 300, 1000)
NOTE = (
    "From 126 ports on a storage matrix would be of an order above 250. There the mechanical energy of the passive "
    "network proves it, and no matrix is needed: hence the dip."
)
COMPARED = 24  # ports up to which every method is run, whatever limits it reached before
MOST_LATE = 100  # ports: storage matrices are dense
T, OSP = 1e-3, 1.37  # s, N*s/m
STIFFNESS = {"passive": 1000.0, "late": 600.0}  # N/m between port and mass
METHODS = {
    "passive": "manyhands",
    "late": "manyhands, not passive (a tick late)",
    "plain": "Theorem 4 in cvxpy, Clarabel",
    "clarabel": "the same, states scaled by energy",
    "scs": "the same with SCS",
}
OURS = ("passive", "late")
SOLVERS = {"plain": "CLARABEL", "clarabel": "CLARABEL", "scs": "SCS"}


@dataclass(frozen=True)
class Run:
    """One process.

    Attributes:
        method: key of METHODS.
        ports: m.
        outcome: "certified"; "converged" and whether what it found can be proved; or why there is no result.
        seconds: from the physical data to the result; for a run that was ended, how long it had run.
        mebibytes: peak resident memory of the process.
        iterations: of the transcription.
        spread: least and greatest seconds of the repeats, when there were some.
    """

    method: str
    ports: int
    outcome: str
    seconds: float
    mebibytes: float
    iterations: int = 0
    spread: tuple[float, float] | None = None

    @property
    def finished(self) -> bool:
        """Whether the method came to an end by itself with a result."""
        return self.outcome.startswith(("certified", "converged"))

    @property
    def limited(self) -> bool:
        """Whether a limit ended it."""
        return self.outcome.startswith("limit")


# --- in the child


def child(method: str, ports: int) -> dict[str, Any]:
    """Do one run and report its result."""
    import numpy as np

    from manyhands.design.errors import DesignError
    from manyhands.design.models.coupling import Partition, SpringDamper
    from manyhands.design.models.environment import DelayedNetwork
    from manyhands.design.models.network import GROUND, Network, NetworkLink
    from manyhands.design.problem import DeviceLevel, HapticLoop, SpringDamperGiven, SpringDamperWanted
    from manyhands.design.synthesis import design

    k = STIFFNESS["late" if method == "late" else "passive"]
    links = [NetworkLink((f"p{i}", f"m{i}"), k, 0.1) for i in range(ports)]
    links += [NetworkLink((f"m{i}", f"m{(i + 1) % ports}"), k / 2.0, 0.2) for i in range(ports)]
    links += [NetworkLink((f"m{i}", GROUND), k / 3.0, 0.5) for i in range(0, ports, 10)]
    network = Network(tuple(f"p{i}" for i in range(ports)), tuple((f"m{i}", 0.5) for i in range(ports)), tuple(links))
    loop = HapticLoop(
        session="benchmark",
        period=T,
        ports=network.ports,
        devices=tuple(DeviceLevel(f"d{i}", (i,), np.array([[OSP]])) for i in range(ports)),
        partition=Partition(tuple(f"c{i}" for i in range(ports)), tuple((i,) for i in range(ports))),
        environment=DelayedNetwork(network, 1) if method == "late" else network,
    )
    if method in OURS:
        begin = time.perf_counter()
        design(loop, SpringDamperWanted())
        return {"outcome": "certified", "seconds": time.perf_counter() - begin}

    from transcription import theorem_4, transformed_environment

    E_hat = transformed_environment(network, T, by_energy=method != "plain")
    begin = time.perf_counter()
    try:
        found = theorem_4(E_hat, OSP, T, SOLVERS[method])
    except MemoryError:
        return {"outcome": "limit: memory", "seconds": time.perf_counter() - begin}
    result: dict[str, Any] = {"seconds": time.perf_counter() - begin, "iterations": found.iterations}
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0  # before anything of ours checks it
    if found.stiffness is None or found.damping is None:
        return {"outcome": found.status, "mebibytes": peak, **result}
    try:
        design(loop, SpringDamperGiven(SpringDamper(np.diag(found.stiffness), np.diag(found.damping))))
        proved = "its coupling can be proved"
    except (DesignError, ValueError) as error:
        proved = f"its coupling cannot be proved ({str(error)[:80]})"
    return {"outcome": f"converged, {proved}", "mebibytes": peak, **result}


# --- in the parent


def measure(method: str, ports: int, limit: float, gibibytes: float) -> Run:
    """One run in a process of its own."""

    def confined() -> None:
        size = int(gibibytes * 2**30)
        resource.setrlimit(resource.RLIMIT_AS, (size, size))

    begin = time.perf_counter()
    command = [sys.executable, str(FOLDER / "design.py"), "--child", method, str(ports)]
    with subprocess.Popen(  # noqa: S603 -- our own interpreter and file, no shell
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=confined,
        env=os.environ | dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"), "1"),
    ) as process:
        try:
            output, errors = process.communicate(timeout=limit + 5.0)  # the interpreter's start is not the method's
            ended = False
        except subprocess.TimeoutExpired:
            peak = peak_of(process.pid)
            process.kill()
            output, errors = process.communicate()
            ended = True
        except BaseException:
            process.kill()
            raise
    if ended:
        return Run(method, ports, "limit: time", limit, peak)
    last = output.strip().splitlines()[-1:] or [""]
    if process.returncode == 0 and last[0].startswith("{"):
        return Run(method, ports, **json.loads(last[0]))
    memory = "MemoryError" in errors or "alloc" in errors.lower() or process.returncode in (-9, -6)
    reason = (errors.strip().splitlines() or [f"exit {process.returncode}"])[-1][:120]
    outcome = "limit: memory" if memory else f"failed: {reason}"
    return Run(method, ports, outcome, time.perf_counter() - begin, float("nan"))


def peak_of(pid: int) -> float:
    """Peak resident memory of a running process, MiB."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmHWM:"):
            return float(line.split()[1]) / 1024.0
    return float("nan")


def campaign(sizes: list[int], limit: float, gibibytes: float, repeats: int) -> list[Run]:
    """All runs, interleaved; of a method's repeats the median is kept."""
    runs: list[Run] = []
    beyond: set[str] = set()
    for ports in sizes:
        done: dict[str, list[Run]] = {}
        for repeat in range(repeats):
            for method in METHODS:
                if method in beyond or (method == "late" and ports > MOST_LATE):
                    continue
                if repeat and method not in OURS and done[method][0].seconds > limit / 10.0:
                    continue  # minutes are not measured better by repeating them
                run = measure(method, ports, limit, gibibytes)
                cost = f"{run.seconds:9.3f} s {run.mebibytes:8.0f} MiB"
                tell(f"{ports:5d} ports  {METHODS[method]:36s} {cost}  {run.outcome}")
                done.setdefault(method, []).append(run)
        kept = {method: median(found) for method, found in done.items()}
        runs += kept.values()
        if ports >= COMPARED:
            beyond |= {method for method, run in kept.items() if run.limited and method not in OURS}
    return runs


def median(runs: list[Run]) -> Run:
    """The run of median time (of an even number the slower one), with the spread of all."""
    ordered = sorted(runs, key=lambda run: run.seconds)
    spread = (ordered[0].seconds, ordered[-1].seconds) if len(runs) > 1 else None
    return replace(ordered[len(ordered) // 2], spread=spread)


def tell(text: str) -> None:
    """A line of progress."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def machine() -> dict[str, str]:
    """What it ran on."""
    names = [
        line.split(":", 1)[1].strip() for line in Path("/proc/cpuinfo").read_text().splitlines() if "model name" in line
    ]
    return {
        "processor": names[0] if names else platform.machine(),
        "cores": str(len(os.sched_getaffinity(0))),
        "python": platform.python_version(),
        **{name: version(name) for name in ("numpy", "scipy", "cvxpy", "clarabel", "scs")},
    }


def table(runs: list[Run], limit: float, gibibytes: float, told: dict[str, str]) -> str:
    """The markdown page."""
    sizes = sorted({run.ports for run in runs})
    by = {(run.method, run.ports): run for run in runs}
    lines = [
        "# Design: time and memory against the number of ports",
        "",
        *wrapped(
            f"`python benchmarks/design.py --limit {limit:g}` produced this page; its docstring states what is "
            "measured. The figures are the median of the repeats, with the least and the greatest. "
            f"Limits a run: {limit:g} s, {gibibytes:g} GiB. Machine: {', '.join(f'{k} {v}' for k, v in told.items())}."
        ),
        "",
        "| ports | " + " | ".join(METHODS.values()) + " |",
        "|---:|" + "---:|" * len(METHODS),
    ]
    for ports in sizes:
        cells = []
        for method in METHODS:
            run = by.get((method, ports))
            cells.append("" if run is None else cell(run))
        lines.append(f"| {ports} | " + " | ".join(cells) + " |")
    lines += ["", "An empty cell was not run: the method had reached a limit at a smaller size, or is dense.", ""]
    lines += [*wrapped(NOTE), "", "![time and memory against ports](images/design-benchmark.png)", ""]
    lines += speedups(by, sizes)
    notes = [run for run in runs if run.method not in OURS and run.outcome != "converged, its coupling can be proved"]
    if notes:
        lines += ["", "Runs of the transcription that did not end in a provable coupling:", ""]
        lines += [f"- {METHODS[run.method]}, {run.ports} ports: {run.outcome}" for run in notes]
    return "\n".join(lines) + "\n"


def wrapped(paragraph: str) -> list[str]:
    """A paragraph of the page, in lines of at most 120 characters."""
    return textwrap.wrap(paragraph, 120, break_long_words=False, break_on_hyphens=False)


def cell(run: Run) -> str:
    """Time and memory of a run, in few words."""
    if run.limited:
        return f"> {run.seconds:.0f} s" if "time" in run.outcome else "out of memory"
    size = f"{run.mebibytes:.0f} MiB"
    if not run.finished:
        return f"no result ({run.seconds:.3g} s, {size})"
    mark = "" if "cannot" not in run.outcome else ", not provable"
    spread = "" if run.spread is None else f" ({run.spread[0]:.3g}-{run.spread[1]:.3g})"
    return f"{run.seconds:.3g} s{spread}, {size}{mark}"


def speedups(by: dict[tuple[str, int], Run], sizes: list[int]) -> list[str]:
    """How many times quicker than the transcription, a lower bound where that was ended."""
    lines = [
        *wrapped(
            "The table states how many times quicker the design of the passive network is than the transcription, or "
            "than the limit that ended it:"
        ),
        "",
    ]
    lines += [
        "| ports | " + " | ".join(METHODS[method] for method in SOLVERS) + " |",
        "|---:|" + "---:|" * len(SOLVERS),
    ]
    for ports in sizes:
        ours, cells = by.get(("passive", ports)), []
        for method in SOLVERS:
            run = by.get((method, ports))
            if ours is None or run is None or not (run.finished or run.outcome == "limit: time"):
                cells.append("")
            else:
                cells.append(f"{'> ' if run.limited else ''}{run.seconds / ours.seconds:.0f} x")
        lines.append(f"| {ports} | " + " | ".join(cells) + " |")
    return lines


def plot(runs: list[Run], limit: float, path: Path) -> None:
    """Time and memory against ports, both logarithmic."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(11.0, 4.5), layout="constrained")
    colours = dict(
        zip(METHODS, ("#0072B2", "#56B4E9", "#E69F00", "#D55E00", "#CC79A7"), strict=True)
    )  # Okabe and Ito's
    markers = dict(zip(METHODS, "osvD^", strict=True))
    for axis, name, unit in zip(axes, ("seconds", "mebibytes"), ("time, s", "peak memory, MiB"), strict=True):
        for method, label in METHODS.items():
            done = [run for run in runs if run.method == method and run.finished]
            style = {"color": colours[method], "marker": markers[method], "label": label}
            axis.plot([run.ports for run in done], [getattr(run, name) for run in done], **style)
            ended = [run for run in runs if run.method == method and not run.finished]
            values = [getattr(run, name) for run in ended]
            axis.plot(
                [run.ports for run in ended],
                values,
                linestyle="",
                marker=markers[method],
                mfc="none",
                mec=colours[method],
            )
        axis.set(xscale="log", yscale="log", xlabel="ports", ylabel=unit)
        sizes = sorted({run.ports for run in runs})
        axis.set_xticks(sizes, [str(ports) for ports in sizes])
        axis.minorticks_off()
        axis.grid(True, which="major", alpha=0.3)
    axes[0].axhline(limit, color="0.4", linestyle=":", linewidth=1.0)
    axes[0].annotate("limit", (1.0, limit), xycoords=("axes fraction", "data"), ha="right", va="bottom", color="0.4")
    axes[0].legend(fontsize=8, title="hollow: no result", title_fontsize=8)
    figure.suptitle("Certified decentralised design, from physical data to proof")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=150)
    plt.close(figure)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description="Time and memory of certified designs against the number of ports.")
    parser.add_argument(
        "--ports", type=int, nargs="+", default=list(SIZES), help="sizes m, at least 3 (default: %(default)s)"
    )
    parser.add_argument("--limit", type=float, default=600.0, help="seconds a run (default: %(default)s)")
    parser.add_argument("--memory", type=float, default=8.0, help="GiB of address space a run (default: %(default)s)")
    parser.add_argument("--repeats", type=int, default=3, help="the median counts (default: %(default)s)")
    parser.add_argument("--to", type=Path, default=FOLDER.parent / "docs", help="folder of the page (default: docs)")
    parser.add_argument("--child", nargs=2, metavar=("METHOD", "PORTS"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child:
        method, ports = arguments.child
        result = child(method, int(ports))
        result.setdefault("mebibytes", resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0)
        tell(json.dumps(result))
        return
    if min(arguments.ports) < 3 or arguments.limit <= 0.0 or arguments.repeats < 1:
        parser.error("expected ports of at least 3, a positive limit and at least one repeat")
    runs = campaign(sorted(arguments.ports), arguments.limit, arguments.memory, arguments.repeats)
    told = machine()
    arguments.to.mkdir(parents=True, exist_ok=True)
    data = {
        "limit": arguments.limit,
        "memory": arguments.memory,
        "machine": told,
        "runs": [asdict(run) for run in runs],
    }
    (arguments.to / "design-benchmark.json").write_text(json.dumps(data, indent=1) + "\n")
    (arguments.to / "design-benchmark.md").write_text(table(runs, arguments.limit, arguments.memory, told))
    plot(runs, arguments.limit, arguments.to / "images" / "design-benchmark.png")
    tell(f"written: {arguments.to / 'design-benchmark.md'}, .json, and images/design-benchmark.png")


if __name__ == "__main__":
    main()
