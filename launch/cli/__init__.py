"""The command line: what the arguments mean, what is printed, and the exit codes.

0 done; 1 a process failed; 2 usage error or bad input; 3 not certified; 130 Ctrl-C. Results go to standard
output, everything else to standard error, so that ``--json`` can be piped. Each module holds a group of commands;
what they need is imported when they run.
"""

from __future__ import annotations

import signal
from typing import Annotated

import typer

import manyhands
from manyhands.launch.cli import design, doctor, network, observe, recordings, run
from manyhands.launch.cli.common import err, errors, out, unwind
from manyhands.launch.run.display import say

__all__ = ["app", "err", "out"]

app = typer.Typer(
    name="manyhands",
    help="Several haptic devices, one virtual environment, and a certificate that the loop is stable.",
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
for group in (design, run, network, doctor, observe, recordings):
    app.add_typer(group.commands)


def _version(wanted: bool) -> None:
    if wanted:
        with errors():
            say(out, f"manyhands {manyhands.__version__}")
        raise typer.Exit


@app.callback()
def _main(
    version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Print it.")] = False,
) -> None:
    # From here on there may be half-written files to clear away, so Ctrl-C unwinds instead of leaving at once.
    signal.signal(signal.SIGINT, unwind)
