"""A hand drives a screw: depth, turns, the torque that it feels over the depth, and what it has put in.

    python examples/screw.py               # writes screw.png; it takes the extra mujoco

The session ``screw``: three strokes, between which the driver is lifted and turned back.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

import manyhands as mh

SECONDS = 7.0
MM = 1e3

Array = NDArray[np.float64]


def main(target: Path) -> None:
    """Simulate the session, and draw it."""
    run = mh.simulate(mh.load("screw"), SECONDS)
    time, columns = run.time, dict(run.columns())
    height = columns["environment.masses[driver.z]_m"]
    deep = -columns["environment.masses[screw.z]_m"]
    felt = columns["driver.torque[z]_N·m"]
    figure = Figure(figsize=(9.0, 6.4), layout="constrained", facecolor="white")
    (way, turned), (torque, over) = figure.subplots(2, 2)
    way.plot(time, MM * deep, color="tab:red", label="depth of the screw [mm]")
    way.plot(time, 0.1 * MM * (height - height[0]), color="0.6", lw=1, label="height of the driver [cm]")
    way.set(title="the way", xlabel="time [s]")
    for body, colour in (("driver", "0.6"), ("screw", "tab:red")):
        turned.plot(time, turn(columns, body), color=colour, label=body)
    turned.set(title="turned to the right", xlabel="time [s]", ylabel="[°]")
    torque.plot(time, MM * felt, color="tab:blue", lw=1, label="about the vertical")
    torque.set(title="torque on the wrist", xlabel="time [s]", ylabel="[mN·m]")
    over.plot(MM * deep, MM * felt, color="tab:blue", lw=1, label="about the vertical")
    over.set(title="torque on the wrist, over the depth", xlabel="depth [mm]", ylabel="[mN·m]")
    for axes in (way, turned, torque, over):
        axes.legend(frameon=False, fontsize="small")
    figure.savefig(target, dpi=110)
    print(
        f"{target}: {MM * deep[-1]:.2f} mm deep by {turn(columns, 'screw')[-1] / 360.0:.2f} turns; the wrist felt "
        f"up to {MM * felt.max():.0f} mN·m"
    )


def turn(columns: dict[str, Array], body: str) -> Array:
    """How far a body has been turned about the vertical, to the right, degrees."""
    w, z = (columns[f"environment.orientations[{body}.q{part}]_1"] for part in "wz")
    return np.asarray(-np.degrees(np.unwrap(2.0 * np.arctan2(z, w))))


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("screw.png"))
