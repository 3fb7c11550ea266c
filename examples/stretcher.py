"""Two people carry a stretcher: its way, its roll, the torques on both wrists, and what one gives the other.

    python examples/stretcher.py           # writes stretcher.png; it takes the extra mujoco

One of them rolls it by a twist of the wrist, and the other one's wrist, which only holds, is turned along.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

import manyhands as mh

SECONDS = 4.6
COLOURS = {"stretcher": "tab:red", "front": "tab:blue", "back": "tab:green"}
HANDS = ("front", "back")

Array = NDArray[np.float64]


def main(target: Path) -> None:
    """Simulate the session, and draw it."""
    run = mh.simulate(mh.load("stretcher"), SECONDS)
    time, columns = run.time, dict(run.columns())
    figure = Figure(figsize=(9.0, 6.4), layout="constrained", facecolor="white")
    (way, roll), (torques, given) = figure.subplots(2, 2)
    height = columns["environment.masses[stretcher.z]_m"]
    way.plot(time, 1e3 * (height - height[0]), color="0.4", label="height [mm]")
    way.plot(time, angle(columns, "environment.orientations[stretcher.{}]_1", "z"), "--", color="0.4", label="turn [°]")
    way.set(title="the stretcher")
    rolls = {"stretcher": angle(columns, "environment.orientations[stretcher.{}]_1", "x")}
    rolls |= {hand: angle(columns, hand + ".orientation[{}]_1", "x") for hand in HANDS}
    for name, values in rolls.items():
        roll.plot(time, values, "--" if name == "stretcher" else "-", color=COLOURS[name], label=name, lw=1)
    roll.set(title="roll of the stretcher and of both wrists", ylabel="[°]")
    for hand in HANDS:
        torques.plot(time, 1e3 * columns[f"{hand}.torque[x]_N·m"], color=COLOURS[hand], label=f"{hand}, about x", lw=1)
        given.plot(time, 1e3 * columns[f"{hand}.account[D]_J, N·m"], color=COLOURS[hand], label=f"{hand} has given")
        given.plot(time, 1e3 * columns[f"{hand}.account[G]_J, N·m"], "--", color=COLOURS[hand], label=f"{hand} got")
    torques.set(title="torque on both wrists", ylabel="[mN·m]")
    given.set(title="energy by turning", ylabel="[mJ]")
    for axes in (way, roll, torques, given):
        axes.set_xlabel("time [s]")
        axes.legend(frameon=False, fontsize="small")
    figure.savefig(target, dpi=110)
    got = 1e3 * columns["back.account[G]_J, N·m"][-1]
    print(
        f"{target}: lifted by {1e3 * (height.max() - height[0]):.0f} mm, rolled by {rolls['stretcher'].max():.1f} "
        f"degrees, and the wrist that holds by {rolls['back'].max():.1f}, of {got:.2f} mJ that the other gave"
    )


def angle(columns: dict[str, Array], name: str, axis: str) -> Array:
    """The turn about an axis of the world, degrees; for small turns."""
    w, part = columns[name.format("qw")], columns[name.format(f"q{axis}")]
    return np.asarray(np.degrees(2.0 * part * np.sign(w)))


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("stretcher.png"))
