"""What is felt in the sessions ``rub``, ``peg``, ``tray`` and ``mujoco``, drawn after a simulation of each.

python examples/scenes.py              # writes scenes.png; the last one takes the extra mujoco
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from numpy.typing import NDArray

import manyhands as mh

SECONDS = 4.0
INSTANTS = (0.0, 0.7, 3.0)  # s, of the peg
MM = 1e3


def main(target: Path) -> None:
    """Simulate the four sessions, and draw them."""
    figure = Figure(figsize=(9.0, 7.0), layout="constrained", facecolor="white")
    (rub, peg), (tray, mujoco) = figure.subplots(2, 2)
    said = [rubbed(rub), put_in(peg), lifted(tray), pushed(mujoco)]
    figure.savefig(target, dpi=110)
    print(f"{target}: {'; '.join(said)}")


def simulated(name: str) -> tuple[mh.Session, NDArray[np.float64], dict[str, NDArray[np.float64]]]:
    """A shipped session, and the instants (s) and columns of a simulation of it."""
    session = mh.load(name)
    run = mh.simulate(session, SECONDS)
    return session, run.time, dict(run.columns())


def rubbed(axes: Axes) -> str:
    """The force along the wall against the way along it: it sticks, and then slips at mu times the normal force."""
    session, _, columns = simulated("rub")
    normal, along = (columns[f"hand.force[hand.{axis}]_N"] for axis in "xy")
    way = columns["environment.tools[hand.y]_m"]
    bound = session.environment.contact.friction * np.abs(normal)
    axes.plot(MM * way, along, color="tab:blue", lw=1, label="force along the wall")
    axes.plot(MM * way, bound, color="0.6", lw=0.6, label="μ times the normal force")
    axes.plot(MM * way, -bound, color="0.6", lw=0.6)
    axes.set(xlabel="y of the tool [mm]", ylabel="force [N]", title="rub: sticking and slipping")
    axes.legend(frameon=False, fontsize="small")
    return f"rub slips at up to {np.abs(along).max():.1f} N"


def put_in(axes: Axes) -> str:
    """The peg from the side: it slides over the edge and into the hole."""
    session, time, columns = simulated("peg")
    scene, tool = session.environment, session.environment.tools["hand"]
    x, y = (MM * (tool.at[axis] + columns[f"environment.tools[hand.{'xyz'[axis]}]_m"]) for axis in (0, 1))
    for name in ("left", "right"):
        (left, low, _), (right, high, _) = MM * np.array([scene.obstacles[name].low, scene.obstacles[name].high])
        axes.add_patch(Rectangle((left, low), right - left, high - low, color="0.85"))
    axes.axhspan(-4.0, 0.0, color="0.85", lw=0)
    axes.plot(x, y, color="tab:blue", lw=1)
    for instant in INSTANTS:
        k = int(np.searchsorted(time, instant))
        axes.add_patch(Circle((x[k], y[k]), MM * tool.radius, ec="tab:blue", fc="none"))
    at = ", ".join(f"{instant:g}" for instant in INSTANTS)
    axes.set(xlim=(-35, 35), ylim=(-4, 74), xlabel="x [mm]", ylabel="y [mm]", aspect="equal", title=f"peg at {at} s")
    return f"the peg ends {y[-1]:.1f} mm over the plate"


def lifted(axes: Axes) -> str:
    """The heights of the tray's three corners."""
    session, time, columns = simulated("tray")
    heights = {
        name: MM * (body.at[1] + columns[f"environment.masses[{name}.y]_m"])
        for name, body in session.environment.bodies.items()
    }
    for style, (name, height) in zip(("-", "--", ":"), heights.items(), strict=True):
        axes.plot(time, height, style, label=name)
    axes.set(xlabel="time [s]", ylabel="height [mm]", title="tray: its three masses")
    axes.legend(frameon=False, fontsize="small")
    return f"the tray is lifted by {min(np.ptp(height) for height in heights.values()):.0f} mm"


def pushed(axes: Axes) -> str:
    """The puck and the two tools from above."""
    session, _, columns = simulated("mujoco")
    starts = {"left": -60.0, "right": 60.0}  # mm, as in the model
    for name in session.environment.tools:
        x, y = (MM * columns[f"environment.tools[{name}.{axis}]_m"] for axis in "01")
        axes.plot(starts[name] + x, y, lw=1, label=name)
    x, y = (MM * columns[f"environment.masses[puck.{axis}]_m"] for axis in "xy")
    axes.plot(x, y, color="tab:red", lw=1, label="puck")
    axes.add_patch(Circle((x[-1], y[-1]), 30.0, ec="tab:red", fc="none"))
    for edge in (-110.0, 90.0):
        axes.add_patch(Rectangle((-200.0, edge), 400.0, 20.0, color="0.85"))
    axes.set(xlim=(-115, 115), ylim=(-115, 115), xlabel="x [mm]", ylabel="y [mm]", aspect="equal")
    axes.set_title(f"mujoco after {SECONDS:g} s")
    axes.legend(frameon=False, fontsize="small")
    return f"the puck is {np.hypot(x[-1], y[-1]):.0f} mm away"


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("scenes.png"))
