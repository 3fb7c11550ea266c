"""The command line: arguments, output and exit codes.

The exit codes are 0 done, 1 a process failed, 2 usage error or bad input, 3 not certified, 130 Ctrl-C. Results go to
standard output and everything else to standard error, so that ``--json`` can be piped. Each module holds one group of
commands, and is imported when one of them runs: ``--help`` needs none. What needs an extra, or takes a while, a command
imports when it runs.
"""

from __future__ import annotations

import importlib
import signal
from collections.abc import Mapping
from difflib import get_close_matches
from typing import Annotated, Any, Final, NamedTuple

import typer
from typer.core import TyperGroup
from typer.main import get_group

import manyhands

__all__ = ["GROUPS", "app"]


class ListedCommand(NamedTuple):
    """A command in the list of all commands.

    Attributes:
        module: of this package, where it is.
        summary: what it does, in a line of 80 columns.
    """

    module: str
    summary: str


GROUPS: Final[Mapping[str, Mapping[str, ListedCommand]]] = {
    "Design": {
        "new": ListedCommand("sessions", "Copy a session file that is shipped, to begin with."),
        "sessions": ListedCommand("sessions", "List the shipped session files, or print one."),
        "mesh": ListedCommand("mesh", "Turn a mesh (STL, OBJ) into a grid to touch."),
        "design": ListedCommand("design", "Find a virtual coupling, prove it, write the certificate."),
        "verify": ListedCommand("design", "Prove a certificate again, in exact arithmetic."),
        "budget": ListedCommand("design", "Show the stiffness that delay and period leave."),
        "sweep": ListedCommand("design", "Design a session for every combination of values."),
        "graph": ListedCommand("network", "Show processes and links, or who may read what."),
    },
    "Run": {
        "simulate": ListedCommand("run", "Run a session in simulated time, in one process."),
        "launch": ListedCommand("run", "Run a session, every node a process of its own."),
        "demo": ListedCommand("run", "Design, run and draw the paper's example."),
    },
    "Look": {
        "top": ListedCommand("observe", "Watch a running session's nodes, or list all sessions."),
        "view": ListedCommand("observe", "Serve a page of a running session to a browser."),
        "echo": ListedCommand("observe", "Print the values of a topic, a line of JSON each."),
        "hz": ListedCommand("observe", "Measure how often and how evenly a topic comes."),
    },
    "Record": {
        "record": ListedCommand("recordings", "Record a running session from now on."),
        "info": ListedCommand("recordings", "Report what a recording holds and whether it is intact."),
        "plot": ListedCommand("recordings", "Draw a recording."),
        "export": ListedCommand("recordings", "Write a recording as a table."),
        "replay": ListedCommand("recordings", "Run a recorded session again and compare each bit."),
        "audit": ListedCommand("recordings", "Check every ledger of a recording."),
    },
    "Share": {
        "host": ListedCommand("network", "Serve a session whose users come and go."),
        "join": ListedCommand("network", "Take a seat in a session on another machine."),
        "invite": ListedCommand("network", "Make keys, and what a node on another machine needs."),
        "node": ListedCommand("network", "Run a node of a session on another machine."),
    },
    "Machine": {
        "doctor": ListedCommand("doctor", "Report what this machine permits, and how fast it is."),
        "devices": ListedCommand("devices", "Show which devices are plugged in, and what is missing."),
        "probe": ListedCommand("check", "Read a device, push it gently, and say what happened."),
        "check-driver": ListedCommand("check", "Try a driver of your own, and name what is wrong."),
        "identify": ListedCommand("identify", "Measure the damping and friction of your device."),
        "check-model": ListedCommand("check", "Try a model of your own, and name what is wrong."),
    },
}
"""Every command, in the order of the help."""

_ENTRIES: Final = {name: entry for group in GROUPS.values() for name, entry in group.items()}


class CommandGroup(TyperGroup):
    """The program: its commands are imported when they run, and listed in groups."""

    def list_commands(self, ctx: Any) -> list[str]:
        """The names of all commands, in the order of the help."""
        return list(_ENTRIES)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command of this name; None where there is none."""
        if cmd_name not in _ENTRIES:
            return None
        module = importlib.import_module(f"{__name__}.{_ENTRIES[cmd_name].module}")
        module.commands.rich_markup_mode = None  # as the program's own help
        return get_group(module.commands).commands[cmd_name]

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the list of commands, group by group."""
        width = max(map(len, _ENTRIES))
        for title, group in GROUPS.items():
            with formatter.section(title):
                formatter.write_dl([(name.ljust(width), entry.summary) for name, entry in group.items()])

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command that the first argument names.

        Where it names none, this ends with a usage error, which has the nearest name.
        """
        if args and not args[0].startswith("-") and args[0] not in _ENTRIES:
            near = get_close_matches(args[0], _ENTRIES, n=1)
            meant = f"did you mean {near[0]!r}?" if near else "see manyhands --help"
            ctx.fail(f"No such command {args[0]!r}; {meant}")
        return super().resolve_command(ctx, args)


app = typer.Typer(
    name="manyhands",
    cls=CommandGroup,
    help="Several haptic devices, one virtual environment, and a certificate that the loop is stable.",
    epilog="Example: manyhands demo -o pictures",
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _version(wanted: bool) -> None:
    if wanted:
        from manyhands.launch.app.cli.common import errors, out
        from manyhands.launch.look.display import say

        with errors():
            say(out, f"manyhands {manyhands.__version__}")
        raise typer.Exit


@app.callback()
def _main(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    from manyhands.launch.app.cli.common import unwind

    # A command may have half-written files to remove, so Ctrl-C unwinds the stack; it does not end the process at once.
    signal.signal(signal.SIGINT, unwind)
