"""Pictures of runs, in the manner of the paper's Figs. 5-7: velocities of the devices over time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")  # files only: no screen is needed, and none is looked for
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

from manyhands.launch.recordings.recording import Recording

_SIZE = (8.0, 3.2)  # inches
_DPI = 130


def plot_velocities(recording: Recording, title: str, path: Path) -> None:
    """One picture with the velocity of every port."""
    figure, axes = plt.subplots(figsize=_SIZE, layout="constrained")
    _velocities(axes, recording, title)
    figure.savefig(path, dpi=_DPI)
    plt.close(figure)


def plot_comparison(runs: Sequence[tuple[str, Recording]], path: Path) -> None:
    """The velocities of several runs, one above the other, over the same time."""
    figure, rows = plt.subplots(
        len(runs), 1, sharex=True, squeeze=False, figsize=(_SIZE[0], 2.4 * len(runs)), layout="constrained"
    )
    for axes, (title, recording) in zip(rows[:, 0], runs, strict=True):
        _velocities(axes, recording, title)
        axes.set_xlabel("")
    rows[-1, 0].set_xlabel("time [s]")
    figure.savefig(path, dpi=_DPI)
    plt.close(figure)


def _velocities(axes: Axes, recording: Recording, title: str) -> None:
    velocity = recording.velocity
    for port, column in zip(recording.ports, velocity.T, strict=True):
        axes.plot(recording.time, column, label=port, linewidth=0.8)
    axes.set_title(title, loc="left", fontsize="medium")
    axes.set_xlabel("time [s]")
    axes.set_ylabel("velocity [m/s]")
    axes.grid(alpha=0.3)
    axes.margins(x=0.0)
    axes.legend(loc="upper right", ncols=len(recording.ports), fontsize="small", frameon=False)
