"""The command that draws a recorded run: plot."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from manyhands.launch.cli.common import err, errors, out, refuse, require_one_of
from manyhands.launch.display import say

commands = typer.Typer()

_QUANTITIES = "sample, velocity, force, tool, reaction, tools, masses, ledger, tau"


@commands.command(epilog="Example: manyhands plot run.mcap --topics velocity,force --from 2 --until 3 -o steps.svg")
def plot(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A recording: .mcap, or .npz or .csv of simulate.")],
    output: Annotated[
        Path | None,
        typer.Option("-o", metavar="OUT", help="Write the picture here (.png or .svg); by default beside FILE."),
    ] = None,
    to: Annotated[
        str | None, typer.Option("--to", metavar="png|svg", help="Its format, where OUT is not given.")
    ] = None,
    topics: Annotated[
        str | None, typer.Option("--topics", metavar="LIST", help=f"What to show, with commas: some of {_QUANTITIES}.")
    ] = None,
    start: Annotated[float | None, typer.Option("--from", metavar="S", help="Begin at this time, s.")] = None,
    end: Annotated[float | None, typer.Option("--until", metavar="S", help="End at this time, s.")] = None,
) -> None:
    """Draw a recording: positions, velocities, forces, energy ledgers, delays, and what happened when.

    Gaps are grey, no extreme is left out however long the run, and a file that was cut says so in its picture. The
    delays inside the tick are shown of runs in real time.
    """
    with errors():
        from manyhands.launch.recordings.drawing import draw

        if to is not None:
            require_one_of("--to", to, ("png", "svg"))
            if output is not None:
                refuse(f"--to: found it beside -o {output}, whose suffix says the format; expected one of them")
        target = output if output is not None else file.with_suffix(f".{to or 'png'}")
        wanted = None if topics is None else tuple(name.strip() for name in topics.split(","))
        draw(file, target, err, wanted, start, end)
        say(out, str(target))
