"""The command line: arguments, output and exit codes.

The exit codes are 0 done, 1 a process failed, 2 usage error or bad input, 3 not certified, 130 Ctrl-C. Results go to
standard output and everything else to standard error, so that ``--json`` can be piped. Each module holds one group of
commands. A command imports what it needs when it runs, which keeps ``--help`` fast.
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
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    # A command may have half-written files to remove, so Ctrl-C unwinds the stack; it does not end the process at once.
    signal.signal(signal.SIGINT, unwind)
