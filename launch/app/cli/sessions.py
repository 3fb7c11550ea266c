"""The commands about session files, shipped ones and their schema: sessions and new."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from manyhands.design.files import replacing
from manyhands.launch.app.cli.common import Json, err, errors, out, refuse, shipped_names
from manyhands.launch.files import TargetError, require_target
from manyhands.launch.look.display import say
from manyhands.launch.output import pipe_may_close
from manyhands.launch.session.shipped import shipped_copy, shipped_session, shipped_sessions

if TYPE_CHECKING:
    from importlib.resources.abc import Traversable

commands = typer.Typer()


@commands.command(epilog="Example: manyhands sessions ball")
def sessions(
    name: Annotated[
        str | None,
        typer.Argument(metavar="[NAME]", help="Print this session's file.", autocompletion=shipped_names),
    ] = None,
    as_json: Json = False,
    schema: Annotated[
        bool, typer.Option("--schema", help="Print the JSON schema of session files, for editors.")
    ] = False,
) -> None:
    """List the session files that are shipped, with what each of them is, or print one of them.

    A command that takes a session takes these names as well. `manyhands new` copies one.
    """
    with errors(), pipe_may_close():
        if schema:
            if name is not None:
                refuse("give either NAME or --schema")
            from manyhands.launch.session.schema import session_schema

            sys.stdout.write(json.dumps(session_schema(), indent=1, ensure_ascii=False) + "\n")
            return
        if name is not None:
            sys.stdout.write(shipped_session(name).read_text())  # as it is, at any width
            return
        found = {name: about(file) for name, file in shipped_sessions().items()}
        if as_json:
            out.print_json(data=found)
            return
        width = max(map(len, found))
        for name, text in found.items():
            say(out, f"{name.ljust(width)}  {text}")


@commands.command(epilog="Example: manyhands new my-session --from ball")
def new(
    name: Annotated[str, typer.Argument(metavar="NAME", help="The name of the new session; its file is NAME.yaml.")],
    template: Annotated[
        str,
        typer.Option(
            "--from",
            metavar="TEMPLATE",
            help="The shipped session to copy (manyhands sessions).",
            autocompletion=shipped_names,
        ),
    ] = "example1",
) -> None:
    """Copy a shipped session file, with its comments, under a name of its own. An existing file is never replaced."""
    with errors():
        target = Path(f"{name}.yaml")
        text = shipped_copy(template, name)
        require_target(target)
        if target.exists():
            raise TargetError(f"{target}: found a file; expected a free name, since no file is replaced")
        with replacing(target) as file:
            file.write(text.encode())
        say(err, f"{target}: a copy of {template}; next: manyhands design {target}")


def about(file: Traversable) -> str:
    """What a session is: the first sentence of its file's comment."""
    comment = []
    for line in file.read_text().splitlines():
        if not line.startswith("#"):
            break
        comment.append(line.removeprefix("#").strip())
    first, _, _ = " ".join(comment).partition(". ")
    return first.rstrip(".") + "."
