"""The command that makes a mesh touchable: mesh."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

import typer

from manyhands.design.files import replacing
from manyhands.design.models.triangle_mesh import MeshError
from manyhands.launch.app.cli.common import err, errors, one_word_of, refuse
from manyhands.launch.files import require_target
from manyhands.launch.look.display import say

commands = typer.Typer()

UNITS: Final = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "inch": 0.0254}
"""The units of a mesh's coordinates, m."""


@commands.command(epilog="Example: manyhands mesh part.stl --unit mm --cell 0.001")
def mesh(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="An STL or OBJ file with a closed surface.")],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="OUT", help="The grid's file; by default that of the mesh, as .grid."),
    ] = None,
    unit: Annotated[
        str,
        typer.Option(
            "--unit", metavar="|".join(UNITS), help="The unit of the coordinates.", autocompletion=one_word_of(UNITS)
        ),
    ] = "mm",
    cell: Annotated[
        float | None,
        typer.Option("--cell", metavar="M", help="Between nodes, in m; by default a 64th of the longest side."),
    ] = None,
    band: Annotated[
        int,
        typer.Option(
            "--band", metavar="COUNT", help="Cells on each side of the surface: a tool's radius may be two less."
        ),
    ] = 4,
) -> None:
    """Turn a mesh into a grid of signed distances, for an environment of the type mesh.

    The grid has all that a session needs, and is part of every recording. An edge is rounded by about a cell.
    """
    with errors("mesh"):
        from manyhands.launch.app.mesh import made_grid, read_mesh

        if unit not in UNITS:
            refuse(f"--unit: found {unit!r}; expected one of {', '.join(UNITS)}")
        target = Path(f"{file.stem}.grid") if output is None else output
        require_target(target)
        try:
            solid = read_mesh(file, UNITS[unit])
            grid = made_grid(solid, cell, band)
        except MeshError as error:
            refuse(f"{file}: {error}")
        except ValueError as error:
            refuse(f"--cell, --band: {error}")
        with replacing(target) as stream:
            stream.write(grid.text.encode())
        low, high = solid.bounds
        size = " x ".join(f"{1e3 * side:.4g}" for side in (high - low).tolist())
        nodes = " x ".join(map(str, grid.distances.shape))
        say(
            err,
            f"{target}: {len(solid.triangles)} triangles of {size} mm, in {nodes} nodes {1e3 * grid.cell:g} mm apart; "
            f"next: environment: {{type: mesh, model: {target.name}, ...}}",
        )
