"""What was measured along each line, and what the set allows: a picture for each pose."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from manyhands.design.models.axis import Units
from manyhands.launch.identify.experiment import AtPose, line_name
from manyhands.launch.look.figures import BLUE, VERMILLION, new_figure, save


def plot_poses(folder: Path, poses: tuple[AtPose, ...], axes: tuple[str, ...], units: Units) -> list[Path]:
    """Draw the burned force over the speed, by pose and line, with the ends of the damping's interval.

    Raises:
        OSError: a picture cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for number, one in enumerate(poses, start=1):
        names = [line_name(line.u, axes) for line in one.lines]
        figure = new_figure(4.0 * len(names), 3.4)
        panels = np.atleast_1d(figure.subplots(1, len(names)))
        for at, (name, panel) in enumerate(zip(names, panels, strict=True)):
            line, mass = one.lines[at], one.found.mass[at]
            if not line.pairs:
                panel.set_title(f"{name}: no way without a stop", fontsize=8)
                continue
            u = line.u / np.sqrt(line.u @ line.u)
            speeds = np.array([u @ pair.V @ u / pair.R for pair in line.pairs])
            inertia = [0.5 * (mass.low + mass.high) * float(u @ pair.Q @ u) for pair in line.pairs]
            forces = np.array([(pair.D - Q) / pair.R for pair, Q in zip(line.pairs, inertia, strict=True)])
            panel.errorbar(
                speeds,
                forces,
                [(pair.D_error + mass.high * pair.Q_error) / pair.R for pair in line.pairs],
                fmt="o",
                markersize=3.0,
                color=BLUE,
                label="measured",
            )
            damping, across = one.found.by_line[at], np.array([0.0, speeds.max()])
            slowest = int(np.argmin(speeds))
            for end, style in ((damping.low, "-"), (damping.high, "--")):
                start = max(0.0, float(forces[slowest] - end * speeds[slowest]))
                panel.plot(
                    across, start + end * across, style, color=VERMILLION, label=f"b = {end:.3g} {units('N·s/m')}"
                )
            panel.set(xlabel=f"speed along {name}, {units('m/s')}", xlim=(0.0, None), ylim=(0.0, None))
            panel.legend(fontsize=8)
        panels[0].set_ylabel(f"burned: friction and damping, {units('N')}")
        written.append(save(figure, folder / f"identify-{number}.png"))
    return written
