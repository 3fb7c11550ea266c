"""The command that serves the page of a running session: view."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Annotated

import typer

from manyhands.launch.cli.common import RunningName, err, errors
from manyhands.launch.display import say

commands = typer.Typer()


@commands.command(epilog="Example: manyhands view --session example-1 --open")
def view(
    session: RunningName = None,
    host: Annotated[
        str, typer.Option("--host", metavar="HOST", help="Where to listen; a token is asked for but on loopback.")
    ] = "127.0.0.1",
    port: Annotated[
        int, typer.Option("--port", metavar="PORT", min=0, max=65535, help="Likewise; 0 for any that is free.")
    ] = 0,
    token_file: Annotated[
        Path | None,
        typer.Option(
            "--token-file",
            metavar="FILE",
            help="Ask for the token in this file of yours (mode 0600); without it, where one is needed, it is drawn.",
        ),
    ] = None,
    open_: Annotated[bool, typer.Option("--open/--no-open", help="Open the page in this machine's browser.")] = False,
) -> None:
    """Serve a page of a running session until Ctrl-C: what moves, what is certified, alarms; devices can be dragged."""
    with errors():
        from manyhands.launch.looking.sessions import find_session
        from manyhands.launch.view.security import is_loopback, new_token, read_token
        from manyhands.launch.view.server import serve

        token = None if token_file is None else read_token(token_file)
        running = find_session(session)
        if not is_loopback(host):
            token = token or new_token()
            say(
                err,
                "warning: the page is served without encryption: who is on the way can read the token and hold "
                "devices; over networks that are not yours, listen on loopback and use ssh -L",
            )

        def ready(address: str) -> None:
            if token_file is None:
                say(err, f"page: {address}")
            else:  # whose token it is has it already
                say(err, f"page: {address.partition('#')[0]}")
                say(err, f"open it with #token= and the token in {token_file} at its end")
            if open_:
                import webbrowser

                webbrowser.open(address)

        refused: Counter[str] = Counter()
        try:
            serve(running, host, port, token, ready, refused)
        finally:  # on Ctrl-C, which is how it ends
            if refused:
                say(err, "refused: " + ", ".join(f"{kind} {count}" for kind, count in sorted(refused.items())))
