"""The commands that design and prove: design, verify, budget."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from manyhands.launch.cli.common import (
    Json,
    Overrides,
    SessionPath,
    end,
    err,
    errors,
    out,
    require_folder,
    settle_delay,
)
from manyhands.launch.files import load_named, require_target

commands = typer.Typer()


@commands.command(epilog="Example: manyhands design example1.yaml -o example1.cert.json")
def design(
    session: SessionPath,
    output: Annotated[Path | None, typer.Option("-o", metavar="CERT", help="Write the certificate here.")] = None,
    pictures: Annotated[
        Path | None, typer.Option("--plot", metavar="DIR", help="Draw the design into this folder.")
    ] = None,
    overrides: Overrides = [],  # noqa: B006 -- typer reads the default and makes its own list
    as_json: Json = False,
) -> None:
    """Find a virtual coupling, prove it, and write the certificate. Exit code 3: infeasible.

    Ctrl-C ends a long search and keeps the best coupling so far, proved like any other (exit code 130).
    """
    with errors():
        from manyhands.launch.design_report import run_design

        loaded = load_named(session, overrides)
        if output is not None:
            require_target(output)
        require_folder(pictures)
        loaded, _ = settle_delay(loaded, realtime=False)
        end(run_design(loaded, out, err, output, pictures, as_json))


@commands.command(name="verify", epilog="Example: manyhands verify example1.cert.json --session example1.yaml")
def verify_command(
    certificate: Annotated[Path, typer.Argument(metavar="CERT", help="A certificate file.")],
    session: Annotated[
        Path | None, typer.Option("--session", metavar="SESSION", help="Also check that it belongs to this session.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Prove a certificate again, from its physical data in exact and ball arithmetic. Exit code 3: not proved."""
    with errors():
        from manyhands.launch.design_report import run_verify

        end(run_verify(certificate, None if session is None else load_named(session, []), out, err, as_json))


@commands.command(epilog="Example: manyhands budget example1.yaml --plot budget.png")
def budget(
    session: SessionPath,
    picture: Annotated[
        Path | None, typer.Option("--plot", metavar="FILE", help="Draw the curves (.png, .svg or .pdf).")
    ] = None,
    overrides: Overrides = [],  # noqa: B006
    as_json: Json = False,
) -> None:
    """Show the stiffness that can be certified for each device, over the delay inside the tick and the period."""
    with errors():
        from manyhands.launch.budget import require_picture
        from manyhands.launch.design_report import run_budget

        loaded = load_named(session, overrides)
        if picture is not None:
            require_picture(picture)
        loaded, _ = settle_delay(loaded, realtime=False)
        end(run_budget(loaded, out, err, picture, as_json))
