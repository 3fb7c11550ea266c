"""`manyhands demo`: Example 1 of the paper, from the design through a run of seven processes to plots.

The plots follow the paper's Figs. 5-7: velocities of the devices over time, without coupling, with the decentralised
coupling, and with a centralised one.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure
from rich.console import Console

from manyhands.design.certificate import save as save_certificate
from manyhands.launch.design_report import print_certificate, print_report
from manyhands.launch.doctor.profile import Profile
from manyhands.launch.doctor.rates import certified_lines
from manyhands.launch.files import EXIT_FAILED, EXIT_OK
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.plan.reach import IPC
from manyhands.launch.recordings.curves import Curve, Panel
from manyhands.launch.recordings.plots import draw_panel
from manyhands.launch.recordings.plots import save as save_picture
from manyhands.launch.recordings.recording import Recording
from manyhands.launch.run.display import say, status
from manyhands.launch.run.session_run import run_session
from manyhands.launch.session import Session
from manyhands.launch.simulation import Simulation
from manyhands.nodes.bundle import REALTIME

_WIDTH, _ONE, _OF_SEVERAL = 8.0, 3.2, 2.4  # inches


def plot_velocities(recording: Recording, title: str, path: Path) -> None:
    """Plot the velocity of every port into one file."""
    save_picture(_figure([(title, recording)], _ONE), path)


def plot_comparison(runs: Sequence[tuple[str, Recording]], path: Path) -> None:
    """Plot the velocities of several runs, one above the other, over the same time axis."""
    save_picture(_figure(runs, _OF_SEVERAL), path)


def _figure(runs: Sequence[tuple[str, Recording]], height: float) -> Figure:
    figure = Figure(figsize=(_WIDTH, height * len(runs)), layout="constrained", facecolor="white")
    rows = figure.subplots(len(runs), 1, sharex=True, squeeze=False)[:, 0]
    for axes, (title, recording) in zip(rows, runs, strict=True):
        columns = zip(recording.ports, recording.velocity.T, strict=True)
        curves = tuple(Curve(port, column) for port, column in columns)
        draw_panel(axes, recording.time, Panel("velocity", title, "velocity [m/s]", curves))
        axes.set_xlabel("time [s]" if axes is rows[-1] else "")
    return figure


SETTLED = 1e-3  # a device is at rest when its speed is below this part of its peak speed


def run_demo(
    sessions: Mapping[str, Session],
    out: Console,
    err: Console,
    folder: Path,
    ticks: int,
    clock: str,
    profile: Profile | None = None,
) -> int:
    """Run the demonstration.

    Args:
        sessions: ``example1``, ``example1-centralised`` and ``example1-uncoupled``.
        out: for results.
        err: for progress.
        folder: the folder for certificate, plots and report; made if absent.
        ticks: number of ticks to run.
        clock: "realtime" or "simulated".
        profile: this machine's for ``example1``, in real time.

    Returns:
        The exit code: 0 when every device came to rest.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with status(err, "designing the decentralised coupling"):
        decentralised = prepare(sessions["example1"])
    if decentralised.certificate is not None:
        print_certificate(out, decentralised.certificate)
        save_certificate(decentralised.certificate, folder / "certificate.json")
        if clock == REALTIME:
            for line in certified_lines(decentralised.certificate, decentralised.session, profile, time.time()):
                say(err, line)
    outcome = run_session(
        decentralised,
        err,
        clock=clock,
        reach=IPC,
        ticks=ticks,
        report=folder / "report.json",
        keep=True,
    )
    print_report(out, outcome.report)
    if outcome.code or outcome.recording is None:
        return outcome.code
    with status(err, "simulating without coupling and with a centralised one"):
        uncoupled = _simulated(sessions["example1-uncoupled"], ticks)
        centralised = _simulated(sessions["example1-centralised"], ticks)
        runs = {
            "fig5-without-coupling": ("without virtual coupling (Fig. 5)", uncoupled),
            "fig6-decentralised": ("decentralised coupling, seven processes (Fig. 6)", outcome.recording),
            "fig7-centralised": ("centralised coupling (Fig. 7)", centralised),
        }
    with status(err, "drawing"):
        for name, (title, recording) in runs.items():
            plot_velocities(recording, title, folder / f"{name}.png")
        plot_comparison(list(runs.values()), folder / "velocities.png")
    return _judge(outcome.report["nodes"], out, folder)


def _simulated(session: Session, ticks: int) -> Recording:
    return Simulation(prepare(session, uncertified=True)).run(ticks)


def _judge(nodes: Mapping[str, Mapping[str, float]], out: Console, folder: Path) -> int:
    """Print whether every device came to rest, and where the plots are; returns the exit code."""
    ratios = {name: node["final_speed"] / node["peak_speed"] for name, node in nodes.items() if "peak_speed" in node}
    text = ", ".join(f"{name} {ratio:.1e}" for name, ratio in ratios.items())
    settled = all(ratio < SETTLED for ratio in ratios.values())
    verdict = "every device came to rest" if settled else f"not every device came to rest (below {SETTLED:g})"
    say(out, f"speed at the end over peak speed: {text}: {verdict}")
    say(out, f"plots, certificate and report: {folder}")
    return EXIT_OK if settled else EXIT_FAILED
