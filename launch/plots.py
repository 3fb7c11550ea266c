"""Pictures of the demonstration, in the manner of the paper's Figs. 5-7: velocities of the devices over time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from manyhands.launch.recordings.curves import Curve, Panel
from manyhands.launch.recordings.plots import draw_panel, save
from manyhands.launch.recordings.recording import Recording

_WIDTH, _ONE, _OF_SEVERAL = 8.0, 3.2, 2.4  # inches


def plot_velocities(recording: Recording, title: str, path: Path) -> None:
    """One picture with the velocity of every port."""
    save(_figure([(title, recording)], _ONE), path)


def plot_comparison(runs: Sequence[tuple[str, Recording]], path: Path) -> None:
    """The velocities of several runs, one above the other, over the same time."""
    save(_figure(runs, _OF_SEVERAL), path)


def _figure(runs: Sequence[tuple[str, Recording]], height: float) -> Figure:
    figure = Figure(figsize=(_WIDTH, height * len(runs)), layout="constrained", facecolor="white")
    rows = figure.subplots(len(runs), 1, sharex=True, squeeze=False)[:, 0]
    for axes, (title, recording) in zip(rows, runs, strict=True):
        columns = zip(recording.ports, recording.velocity.T, strict=True)
        curves = tuple(Curve(port, column) for port, column in columns)
        draw_panel(axes, recording.time, Panel("velocity", title, "velocity [m/s]", curves))
        axes.set_xlabel("time [s]" if axes is rows[-1] else "")
    return figure
