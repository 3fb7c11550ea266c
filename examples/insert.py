"""A hand turns a peg and presses it into a hole: depth, angles, torques and forces of the session ``insert``.

    python examples/insert.py              # writes insert.png; it takes the extra mujoco

Two more hands hold the part with the hole between them. The same session is drawn with a hand that does not wiggle.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

import manyhands as mh

SECONDS = 5.0
MM = 1e3
COLOURS = ("tab:blue", "tab:green", "tab:red")
JAMMED: dict[str, object] = {
    "devices.peg.orientation.torque": ["-0.0058*pulse(t, 0.4, 0.9)", 0, "-0.013*pulse(t, 0.9, 1.4)"]
}
"""The hand turns the peg as before, and then holds still, 1.4 degrees from where it fits."""

Array = NDArray[np.float64]


def main(target: Path) -> None:
    """Simulate the session, and the same one without wiggling, and draw them."""
    time, columns = simulated()
    _, jammed = simulated(JAMMED)
    figure = Figure(figsize=(9.0, 6.4), layout="constrained", facecolor="white")
    (deep, turned), (torques, forces) = figure.subplots(2, 2)
    deep.plot(time, MM * depth(jammed), color="0.6", label="not wiggled: it jams")
    deep.plot(time, MM * depth(columns), color="tab:blue", label="wiggled")
    drawn(deep, "depth of the peg in the hole", "[mm]")
    angles = np.column_stack([angles_of(columns, "peg", part) for part in "xyz"])
    lines(turned, time, angles, [f"about {axis}" for axis in "xyz"])
    turned.axhspan(-0.5, 0.5, color="0.85", lw=0, label="within half a degree")
    drawn(turned, "the peg's orientation", "[°]")
    felt = np.column_stack([columns[f"peg.torque[{axis}]_N·m"] for axis in "xyz"])
    lines(torques, time, MM * felt, [f"about {axis}" for axis in "xyz"])
    drawn(torques, "torque on the hand of the peg", "[mN·m]")
    along = np.column_stack([columns[f"{hand}.force[{hand}.z]_N"] for hand in ("peg", "left")])
    lines(forces, time, along, ["peg", "left, and right likewise"])
    drawn(forces, "vertical force on each hand", "[N]")
    figure.savefig(target, dpi=110)
    print(
        f"{target}: the peg ends {MM * depth(columns)[-1]:.1f} mm deep, and not wiggled "
        f"{MM * max(depth(jammed)[-1], 0.0):.1f} mm; its hand felt up to {MM * np.abs(felt).max():.0f} mN·m"
    )


def simulated(changes: dict[str, object] | None = None) -> tuple[Array, dict[str, Array]]:
    """The instants, s, and columns of a simulation."""
    run = mh.simulate(mh.load("insert", changes or {}), SECONDS)
    return run.time, dict(run.columns())


def depth(columns: dict[str, Array]) -> Array:
    """How far the end of the peg is below the rim of the hole, m."""
    rim = columns["environment.masses[part.z]_m"] + 0.025
    return np.asarray(rim - (columns["environment.masses[peg.z]_m"] - 0.035))


def angles_of(columns: dict[str, Array], body: str, axis: str) -> Array:
    """The turn of a body about an axis of the world, degrees; for small turns."""
    w, part = (columns[f"environment.orientations[{body}.q{one}]_1"] for one in ("w", axis))
    return np.asarray(np.degrees(2.0 * part * np.sign(w)))


def lines(axes: Axes, time: Array, values: Array, names: list[str]) -> None:
    """A line for each column."""
    for one, name, colour in zip(values.T, names, COLOURS, strict=False):
        axes.plot(time, one, color=colour, lw=1, label=name)


def drawn(axes: Axes, title: str, unit: str) -> None:
    """Say what the axes show."""
    axes.set(xlabel="time [s]", ylabel=unit, title=title)
    axes.legend(frameon=False, fontsize="small")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("insert.png"))
