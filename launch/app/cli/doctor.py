"""The command that examines the machine: doctor."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from manyhands.launch.app.cli.common import Json, Overrides, end, err, errors, out, session_files
from manyhands.launch.session.shipped import load_named

commands = typer.Typer()


@commands.command(epilog="Example: manyhands doctor example1.yaml --duration 10")
def doctor(
    session: Annotated[
        Path,
        typer.Argument(
            metavar="[SESSION]", help="A session file, or the name of a shipped one.", autocompletion=session_files
        ),
    ] = Path("example1.yaml"),
    duration: Annotated[float, typer.Option("--duration", metavar="S", help="How long to measure, in s.")] = 12.0,
    overrides: Overrides = [],  # noqa: B006 -- typer reads the default and makes its own list
    as_json: Json = False,
) -> None:
    """Report what this machine permits, how long a tick takes on it, and which stiffness can then be certified."""
    with errors("design"):
        from manyhands.launch.app.examination import run_doctor

        end(run_doctor(load_named(session, overrides), duration, out, err, as_json))
