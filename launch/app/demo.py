"""`manyhands demo`: Example 1 of the paper, from the design through a run of seven processes to plots.

The plots follow the paper's Figs. 5-7: velocities of the devices over time, without coupling, with the decentralised
coupling, and with a centralised one. In real time there are two more: the same session without coupling as seven
processes, until the limits of its devices end it, and the interface accounts of the certified run.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.console import Console

from manyhands.design.certificate import save as save_certificate
from manyhands.launch.app.design_report import print_certificate, print_report
from manyhands.launch.app.session_run import run_session
from manyhands.launch.app.start import start
from manyhands.launch.audit.simulation import Simulation
from manyhands.launch.files import EXIT_FAILED, EXIT_OK
from manyhands.launch.look.display import say, status
from manyhands.launch.look.figures import new_figure
from manyhands.launch.look.figures import save as save_picture
from manyhands.launch.look.plots import VELOCITY, draw_panel, picture_of_run
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.plan.reach import IPC
from manyhands.launch.recordings.curves import Array, Curve, Panel
from manyhands.launch.recordings.recording import Recording
from manyhands.launch.recordings.run import RecordedRun, read_run, rows_of
from manyhands.launch.run.options import StartOptions
from manyhands.launch.run.outcome import Outcome, falling, joules
from manyhands.launch.session import Session
from manyhands.nodes.kernel.bundle import REALTIME
from manyhands.nodes.monitor.health_model import LEDGER_ROUNDING
from manyhands.protocol.channels import FORCE, INTERFACE

_WIDTH, _ONE, _OF_SEVERAL = 8.0, 3.2, 2.2  # inches

DISPLACEMENT_LIMIT, SPEED_LIMIT = 0.2, 3.0
"""m and m/s: limits of the devices that run in real time without coupling. A hand that shakes exceeds them soon."""

LIMITED: Final = tuple(
    f"devices.{name}.limits={{displacement: {DISPLACEMENT_LIMIT}, speed: {SPEED_LIMIT}}}" for name in ("dx", "dy", "dz")
)
"""What ``example1-uncoupled`` is changed to for that run, as overrides of its file."""


@dataclass(frozen=True, eq=False)
class Row:
    """One row of a figure.

    Attributes:
        time: the instants of the ticks, s.
        panel: the curves.
        bound: where a line is drawn that the curves keep above; None for no line.
    """

    time: Array
    panel: Panel
    bound: float | None = None


def velocities(recording: Recording, title: str) -> Row:
    """The velocity of every port."""
    columns = zip(recording.ports, recording.velocity.T, strict=True)
    curves = tuple(Curve(port, column) for port, column in columns)
    return Row(recording.time, Panel("velocity", title, "velocity [m/s]", curves))


def velocities_of_run(run: RecordedRun, title: str) -> Row:
    """The velocity of every port of a recorded run."""
    [found] = picture_of_run(run, [VELOCITY]).panels
    return Row(run.time, replace(found, title=title))


def accounts(run: RecordedRun, tank: float) -> Row:
    """The interface account of every device of a recorded run, beside its bound; ``tank`` is E_0, J."""
    [found] = picture_of_run(run, [INTERFACE]).panels
    curves = tuple(Curve(curve.label, 1e3 * curve.values) for curve in found.curves)
    title = f"the same run: each device's energy account, kept above {joules(0.0 - tank)} whatever is late"
    return Row(run.time, Panel(found.name, title, "e [mJ]", curves), 0.0 - 1e3 * tank)


def plot(rows: Sequence[Row], path: Path) -> None:
    """Plot rows into one file, one above the other, over the same time axis."""
    height = (_ONE if len(rows) == 1 else _OF_SEVERAL) * len(rows)
    figure = new_figure(_WIDTH, height)
    all_axes = figure.subplots(len(rows), 1, sharex=True, squeeze=False)[:, 0]
    for axes, row in zip(all_axes, rows, strict=True):
        if row.bound is not None:
            axes.axhline(row.bound, color="0.35", linewidth=0.9, linestyle="--", label="bound")
        draw_panel(axes, row.time, row.panel)
        axes.set_xlabel("time [s]" if axes is all_axes[-1] else "")
    save_picture(figure, path)


UNCOUPLED: Final = "uncoupled-in-real-time"
"""The name of that run's files."""

_QUIET: Final = Console(quiet=True)

SETTLED = 1e-3  # a device is at rest when its speed is below this part of its peak speed


def run_demo(
    sessions: Mapping[str, Session],
    out: Console,
    err: Console,
    folder: Path,
    ticks: int,
    clock: str,
) -> int:
    """Run the demonstration.

    Args:
        sessions: ``example1``, ``example1-centralised``, ``example1-uncoupled``, and the last with :data:`LIMITED` as
            ``example1-limited``.
        out: for results.
        err: for progress.
        folder: the folder for certificate, recordings, plots and report; made if absent.
        ticks: number of ticks to run.
        clock: "realtime" or "simulated".

    Returns:
        The exit code: 0 when every promise was kept, and every device came to rest.
    """
    recorded = folder / "run.mcap"
    folder.mkdir(parents=True, exist_ok=True)

    def designed(prepared: Prepared) -> None:
        for certificate in prepared.certificates:
            print_certificate(out, certificate)
            save_certificate(certificate, folder / "certificate.json")

    options = StartOptions(clock, ticks, record=recorded, report=folder / "report.json")
    outcome = start(sessions["example1"], options, err, designed)
    print_report(out, outcome.report, outcome.faults)
    if outcome.code:
        return outcome.code
    rows = {}
    if clock == REALTIME:
        with status(err, "running the same session without coupling, in real time"):
            path = folder / f"{UNCOUPLED}.mcap"
            shaken = _uncoupled(sessions["example1-limited"], ticks, path)
        for fault in shaken.faults:
            say(err, f"error: {fault}")
        if shaken.code:
            return shaken.code
        shaken_run = read_run(path)
        what = how_it_ended(shaken_run, shaken.report["nodes"])
        say(out, f"without coupling, as seven processes in real time: {what}")
        rows[UNCOUPLED] = velocities_of_run(shaken_run, f"without coupling, in real time: {what}")
    with status(err, "simulating without coupling and with a centralised one"):
        uncoupled = _simulated(sessions["example1-uncoupled"], ticks)
        centralised = _simulated(sessions["example1-centralised"], ticks)
        certified = "decentralised coupling, seven processes (Fig. 6)"
        rows = {
            "fig5-without-coupling": velocities(uncoupled, "without virtual coupling (Fig. 5)"),
            **rows,
            "fig6-decentralised": velocities_of_run(run := read_run(recorded), certified),
        }
        if "lateness" in outcome.report:
            rows["accounts"] = accounts(run, outcome.report["lateness"]["tank"])
        rows["fig7-centralised"] = velocities(centralised, "centralised coupling (Fig. 7)")
    with status(err, "drawing"):
        for name, row in rows.items():
            plot([row], folder / f"{name}.png")
        plot([*rows.values()], folder / "velocities.png")
    say(out, f"plots, certificate, recordings and report: {folder}")
    sentence, kept = verdict(outcome.report)
    say(out, sentence)
    return EXIT_OK if kept else EXIT_FAILED


def _simulated(session: Session, ticks: int) -> Recording:
    return Simulation(prepare(session, uncertified=True)).run(ticks)


def _uncoupled(session: Session, ticks: int, path: Path) -> Outcome:
    """Run a session that nothing certifies; its incidents are what is to be seen, and the demonstration words them."""
    prepared = prepare(session, uncertified=True)
    return run_session(prepared, _QUIET, IPC, StartOptions(REALTIME, ticks, record=path))


def how_it_ended(run: RecordedRun, nodes: Mapping[str, Mapping[str, Any]]) -> str:
    """What became of a run whose devices let go beyond their limits, as a part of a sentence.

    Args:
        run: the run.
        nodes: of its report.
    """
    gone = [name for name, node in nodes.items() if node.get("let_go")]
    if not gone:
        peak = max(node.get("peak_speed", 0.0) for node in nodes.values())
        return f"within {DISPLACEMENT_LIMIT:g} m and {SPEED_LIMIT:g} m/s to the end, up to {peak:.2g} m/s"
    forced = [np.flatnonzero(np.any(np.nan_to_num(rows_of(run, name, FORCE)), axis=1)) for name in gone]
    end = run.recorded.period * (run.first + 1 + max((int(ticks[-1]) for ticks in forced if ticks.size), default=-1))
    return (
        f"{', '.join(gone)} exceeded {DISPLACEMENT_LIMIT:g} m or {SPEED_LIMIT:g} m/s and let go; no force after "
        f"{end:.1f} s"
    )


def verdict(report: Mapping[str, Any]) -> tuple[str, bool]:
    """One sentence about a whole report: promises, rest, least account, late ticks and enforced energy.

    Returns:
        The sentence, and whether every promise was kept and every device came to rest.
    """
    nodes, lateness = report["nodes"], report.get("lateness")
    tank = 0.0 if lateness is None else lateness["tank"]
    broken = [name for name, node in nodes.items() if not _kept(node)]
    moving = [
        name
        for name, n in nodes.items()
        if "peak_speed" in n and n.get("final_speed", 0.0) >= SETTLED * n["peak_speed"]
    ]
    promises = f"promises broken by {', '.join(broken)}" if broken else f"all {len(nodes)} promises were kept"
    rest = f"not every device came to rest ({', '.join(moving)})" if moving else "every device came to rest"
    parts = [f"{promises}, and {rest}"]
    devices = [node for node in nodes.values() if "interface" in node]
    if devices and lateness is not None:
        least = min(node["interface"]["min"] for node in devices)
        enforced = sum(node["interface"]["kept_back"] for node in devices)
        late, ticks = (sum(node[key] for node in devices) for key in ("late", "ticks"))
        beyond = sum(node["tau_breaches"] for node in devices)
        parts += [
            f"the least energy account was {joules(least)} (bound {joules(0.0 - tank)}{falling(lateness)})",
            f"{late} of {ticks} ticks were late, {beyond} beyond the certified τ",
            f"{joules(enforced)} was held back by enforcement",
        ]
    return "; ".join(parts), not broken and not moving


def _kept(node: Mapping[str, Any]) -> bool:
    """Whether a party kept its ledger, and a device its interface account, above their bounds."""
    margin = node["ledger"].get("margin", 0.0) if "ledger" in node else 0.0
    account = node["interface"]["margin"] if "interface" in node else 0.0
    return bool(min(margin, account) >= -LEDGER_ROUNDING)
