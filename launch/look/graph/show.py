"""A graph in the requested form, to standard output or into a file."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import typer
from rich.console import Console

from manyhands.design.files import replacing
from manyhands.launch.files import EXIT_OK, TargetError
from manyhands.launch.look.graph.parts import (
    Drawing,
    access_object,
    drawing_of_live,
    drawing_of_session,
    graph_object,
    live_object,
)
from manyhands.launch.look.graph.svg import svg
from manyhands.launch.look.graph.text import mermaid, print_access, print_graph, print_live
from manyhands.launch.plan.plan import Plan
from manyhands.nodes.monitor.session_state import LiveSession

TEXT, JSON = "text", "json"

PICTURES: Final[dict[str, Callable[[Drawing], str]]] = {"mermaid": mermaid, "svg": svg}
"""The drawn forms, and the function that makes each."""

FORMATS: Final = (TEXT, *PICTURES)
"""The values of ``--format``."""

_SUFFIXES: Final = {".svg": "svg", ".mmd": "mermaid", ".mermaid": "mermaid", ".txt": TEXT, ".json": JSON}
_FILE_WIDTH = 140


def format_of(name: str | None, output: Path | None, as_json: bool) -> str:
    """The form of the output: the requested one, or that of the file's suffix, or text.

    Raises:
        TargetError: the file's suffix is unknown, and no form was requested.
    """
    if as_json:
        return JSON
    if name is not None:
        return name
    if output is None:
        return TEXT
    try:
        return _SUFFIXES[output.suffix]
    except KeyError:
        known = ", ".join(_SUFFIXES)
        raise TargetError(f"{output}: found the suffix {output.suffix!r}; expected {known}, or --format") from None


def show_session(plan: Plan, out: Console, form: str, output: Path | None, show_access: bool = False) -> int:
    """Show the graph of a session file, or its capability table (as text or JSON); returns the exit code.

    Raises:
        OSError: the file cannot be written.
    """
    if form in PICTURES:
        return _put(PICTURES[form](drawing_of_session(plan)), output)
    if form == JSON:
        return _put(_as_json(access_object(plan) if show_access else graph_object(plan)), output)
    write = print_access if show_access else print_graph
    return _print(lambda console: write(console, plan), out, output)


def show_running(live: LiveSession, out: Console, form: str, output: Path | None) -> int:
    """Show the graph of a running session, with the health of each node and link; returns the exit code.

    Raises:
        OSError: the file cannot be written.
    """
    if form in PICTURES:
        return _put(PICTURES[form](drawing_of_live(live)), output)
    if form == JSON:
        return _put(_as_json(live_object(live)), output)
    return _print(lambda console: print_live(console, live), out, output)


def _as_json(plain: dict[str, Any]) -> str:
    return json.dumps(plain, indent=2, allow_nan=False) + "\n"


def _print(write: Callable[[Console], None], out: Console, output: Path | None) -> int:
    if output is None:
        write(out)
        return EXIT_OK
    text = io.StringIO()
    write(Console(file=text, width=_FILE_WIDTH, highlight=False))
    return _put(text.getvalue(), output)


def _put(text: str, output: Path | None) -> int:
    if output is None:
        typer.echo(text, nl=False)
    else:
        with replacing(output) as file:
            file.write(text.encode())
    return EXIT_OK
