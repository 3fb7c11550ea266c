"""What `manyhands graph` shows: a session's nodes and links, or its access rights, in several forms.

Read :mod:`parts` first (the elements of every drawing), then :mod:`svg` (the drawing), and :mod:`text` (tables and
Mermaid). This is the choice among them, to standard output or into a file.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import typer
from rich.console import Console

from manyhands.design.files import replacing
from manyhands.launch.files import TargetError
from manyhands.launch.look.graph.parts import Drawing, access_object, graph_object
from manyhands.launch.look.graph.svg import svg
from manyhands.launch.look.graph.text import mermaid, print_access, print_graph
from manyhands.launch.plan.plan import Plan

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


def show(drawing: Drawing, out: Console, form: str, output: Path | None) -> None:
    """Show a graph.

    Args:
        drawing: the graph.
        out: where tables go.
        form: one of :data:`FORMATS`, or :data:`JSON`.
        output: the file to write instead; None for none.

    Raises:
        OSError: the file cannot be written.
    """
    if form in PICTURES:
        _put(PICTURES[form](drawing), output)
    elif form == JSON:
        _put(_as_json(graph_object(drawing)), output)
    else:
        _print(lambda console: print_graph(console, drawing), out, output)


def show_access(plan: Plan, out: Console, form: str, output: Path | None) -> None:
    """Show the capability table of a session file, as text or JSON; arguments as of :func:`show`.

    Raises:
        OSError: the file cannot be written.
    """
    if form == JSON:
        _put(_as_json(access_object(plan)), output)
    else:
        _print(lambda console: print_access(console, plan), out, output)


def _as_json(plain: dict[str, Any]) -> str:
    return json.dumps(plain, indent=2, allow_nan=False) + "\n"


def _print(write: Callable[[Console], None], out: Console, output: Path | None) -> None:
    if output is None:
        write(out)
        return
    text = io.StringIO()
    write(Console(file=text, width=_FILE_WIDTH, highlight=False))
    _put(text.getvalue(), output)


def _put(text: str, output: Path | None) -> None:
    if output is None:
        typer.echo(text, nl=False)
        return
    with replacing(output) as file:
        file.write(text.encode())
