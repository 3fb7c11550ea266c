"""Two users stroke a relief: the session ``stroke`` in space, and one hand's way over the ridges with its forces.

    python examples/stroke.py              # writes stroke.png

The tools are spheres of 3 mm. The arrows are the forces on anna's tool, every 40 ms.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import manyhands as mh
from manyhands.design.models.distance_grid import grid_of_text

COLOURS = {"anna": "tab:blue", "ben": "tab:green"}
SECONDS = 4.0


def main(target: Path) -> None:
    """Simulate the session, and draw it."""
    session = mh.load("stroke")
    run = mh.simulate(session, SECONDS)
    columns = dict(run.columns())
    paths, forces = {}, {}
    for name, tool in session.environment.tools.items():
        at = np.array(tool.at)[:, None]
        paths[name] = 1e3 * (at + np.array([columns[f"environment.tools[{name}.{axis}]_m"] for axis in "xyz"]))
        forces[name] = np.array([columns[f"{name}.force[{name}.{axis}]_N"] for axis in "xyz"])
    figure = Figure(figsize=(9.0, 3.6), layout="constrained", facecolor="white")
    space = figure.add_subplot(1, 2, 1, projection="3d")
    surface = grid_of_text(session.environment.model).surface
    x, y, z = 1e3 * surface.vertices.T
    space.plot_trisurf(x, -z, y, triangles=surface.triangles, color="0.85", edgecolor="0.7", lw=0.2)
    for name, (tool_x, tool_y, tool_z) in paths.items():
        space.plot(tool_x, -tool_z, tool_y, color=COLOURS[name], zorder=10, label=name)
    space.set(xlabel="x [mm]", ylabel="−z [mm]", zlabel="", box_aspect=(96, 56, 26), zticks=(0, 10))
    space.view_init(elev=35, azim=-75)
    space.legend(frameon=False, loc="upper left")
    side = figure.add_subplot(1, 2, 2)
    grid = grid_of_text(session.environment.model)
    middle = grid.distances[:, :, grid.distances.shape[2] // 2].T
    along = [1e3 * (grid.origin[j] + grid.cell * np.arange(grid.distances.shape[j])) for j in (0, 1)]
    side.contourf(*along, middle, levels=[-1.0, 0.0], colors=["0.85"])
    side.plot(*paths["anna"][:2], color=COLOURS["anna"], lw=1)
    every = slice(500, None, 40)
    side.quiver(
        *paths["anna"][:2, every], *forces["anna"][:2, every], color="tab:red", angles="xy", width=0.003, scale=50
    )
    side.set(
        xlim=(-54, 8), ylim=(-9, 18), xlabel="x [mm]", ylabel="y [mm]", aspect="equal", title="anna over the ridges"
    )
    figure.savefig(target, dpi=130)
    most = {name: float(np.linalg.norm(force, axis=0).max()) for name, force in forces.items()}
    print(f"{target}: " + ", ".join(f"{name} felt up to {value:.1f} N" for name, value in most.items()))


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("stroke.png"))
