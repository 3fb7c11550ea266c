"""Two hands lift a ball by friction: the scene ``carry`` from the side, and the heights over time.

    python examples/carry.py               # writes carry.png

The hands press on the ball from both sides, and nothing else holds it.
"""

import sys
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

import manyhands as mh

NAMES = ("anna", "ben", "red")
COLOURS = {"anna": "tab:blue", "ben": "tab:green", "red": "tab:red"}
INSTANTS = (0.0, 1.2, 2.0)  # s


def main(target: Path) -> None:
    """Simulate the session for four seconds, and draw it."""
    session = mh.load("carry")
    scene = session.environment
    spheres = {**scene.tools, **scene.bodies}
    run = mh.simulate(session, 4.0)
    columns = dict(run.columns())
    paths = {}
    for name in NAMES:
        kind = "tools" if name in scene.tools else "masses"
        paths[name] = [
            spheres[name].at[axis] + columns[f"environment.{kind}[{name}.{'xyz'[axis]}]_m"] for axis in (0, 1)
        ]
    figure = Figure(figsize=(8.0, 3.4), layout="constrained", facecolor="white")
    side, heights = figure.subplots(1, 2)
    from_the_side(side)
    for instant in INSTANTS:
        k = round(instant / run.period)
        for name, (x, y) in paths.items():
            strength = 0.25 + 0.75 * instant / INSTANTS[-1]
            outline = Circle((x[k], y[k]), spheres[name].radius, ec=COLOURS[name], fc="none", alpha=strength, lw=1.5)
            side.add_patch(outline)
    for name, (_, y) in paths.items():
        heights.plot(run.time, 1e3 * y, color=COLOURS[name], label=name)
    heights.set(xlabel="time [s]", ylabel="height [mm]", title="heights of the centres")
    heights.legend(frameon=False)
    figure.savefig(target, dpi=130)
    print(f"{target}: the ball is lifted by {1e3 * (max(paths['red'][1]) - paths['red'][1][0]):.0f} mm")


def from_the_side(axes: Axes) -> None:
    """Axes that show x and y, with the floor."""
    axes.axhspan(-0.01, 0.0, color="0.8", lw=0)
    axes.set(xlim=(-0.11, 0.11), ylim=(-0.01, 0.16), xlabel="x [m]", ylabel="y [m]", aspect="equal")
    axes.set_title(f"at {', '.join(f'{instant:g}' for instant in INSTANTS)} s")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("carry.png"))
