"""The commands that look on at running sessions: list, echo, hz, top.

The command that serves the page of a running session: view.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Annotated

import typer

from manyhands.launch.cli.common import Json, RunningName, end, err, errors, out, refuse, topic_names
from manyhands.launch.observe.topics import DEFAULT_WINDOW
from manyhands.launch.output import pipe_may_close
from manyhands.launch.run.display import say

commands = typer.Typer()

TopicName = Annotated[
    str,
    typer.Argument(
        metavar="TOPIC",
        help="NODE/TOPIC or /SESSION/NODE/TOPIC, such as dx/sample, dx/telemetry, supervisor/condition.",
        autocompletion=topic_names,
    ),
]


@commands.command("list", epilog="Example: manyhands list --json")
def list_sessions(as_json: Json = False) -> None:
    """List the sessions that run on this machine, and how they and their nodes are."""
    with errors():
        import time

        from manyhands.launch.design_report import print_json
        from manyhands.launch.observe.sessions import running_sessions
        from manyhands.launch.observe.tables import look_at, print_sessions, session_object
        from manyhands.protocol.clock import RealtimeClock

        scenes = look_at(running_sessions(), RealtimeClock())
        if not scenes:
            say(err, "no session is running; start one with: manyhands launch SESSION")
        if as_json:
            print_json([session_object(scene) for scene in scenes])
        elif scenes:
            print_sessions(out, scenes, time.time())


@commands.command(epilog="Example: manyhands echo dx/sample -n 10 --every 100")
def echo(
    topic: TopicName,
    session: RunningName = None,
    count: Annotated[int | None, typer.Option("-n", min=1, metavar="COUNT", help="End after so many lines.")] = None,
    every: Annotated[
        int,
        typer.Option("--every", min=1, metavar="N", help="Only ticks that are multiples of N, or each Nth message."),
    ] = 1,
) -> None:
    """Print each value of a topic of a running session as a line of JSON, as recordings have them."""
    with errors(), pipe_may_close():
        from manyhands.launch.observe.sessions import find_session, visiting
        from manyhands.launch.observe.topics import EchoLines, find_topic, session_of
        from manyhands.protocol.clock import RealtimeClock

        running = find_session(session or session_of(topic))
        lines = EchoLines(find_topic(running.about, topic), running.about.period, count, every)
        with visiting(running, RealtimeClock()) as (scene, seeing):
            for seen in seeing:
                text = "\n".join(lines.lines(seen.message, scene.tick))
                if text:
                    typer.echo(text)
                if lines.done:
                    break


@commands.command(epilog="Example: manyhands hz dx/sample --duration 5")
def hz(
    topic: TopicName,
    session: RunningName = None,
    window: Annotated[
        int, typer.Option("--window", min=2, metavar="N", help="Take figures over the last N ticks, or messages.")
    ] = DEFAULT_WINDOW,
    duration: Annotated[
        float | None, typer.Option("--duration", metavar="S", help="End after so many s; without it, on Ctrl-C.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Say how often a topic of a running session is told of, and how evenly: a line a second, the last at the end."""
    with errors(), pipe_may_close():
        from manyhands.launch.design_report import print_json
        from manyhands.launch.observe.sessions import find_session, visiting
        from manyhands.launch.observe.topics import Pacing, find_topic, sentence, session_of
        from manyhands.protocol.clock import Instant, RealtimeClock, from_seconds

        if duration is not None and not 0.0 < duration <= 1e9:
            refuse(f"--duration: found {duration:g} s; expected more than 0 and at most 1e9 s")
        running = find_session(session or session_of(topic))
        pacing = Pacing(find_topic(running.about, topic), window)
        clock = RealtimeClock()
        began = clock.now()
        until = None if duration is None else Instant(began + from_seconds(duration))
        told = began
        with visiting(running, clock, until) as (_, seeing):
            try:
                for seen in seeing:
                    pacing.take(seen.message, seen.at)
                    if not as_json and seen.at - told >= from_seconds(1.0):
                        told = seen.at
                        typer.echo(sentence(pacing.found()))
            finally:  # on Ctrl-C, too: that is how it mostly ends
                found = pacing.found()
                if as_json:
                    print_json(found)
                else:
                    typer.echo(sentence(found))


@commands.command(epilog="Example: manyhands top --once")
def top(
    session: RunningName = None,
    once: Annotated[bool, typer.Option("--once", help="Show it once, and end.")] = False,
    as_json: Json = False,
) -> None:
    """Watch the nodes of a running session: a table on a terminal, until q or Ctrl-C; else one every 2 s."""
    with errors(), pipe_may_close():
        import json

        from manyhands.launch.design_report import print_json
        from manyhands.launch.observe.sessions import find_session, visiting
        from manyhands.launch.observe.tables import look_at, picture, quit_key, show_live, tell, top_object
        from manyhands.nodes.observer.scene import Scene
        from manyhands.protocol.clock import RealtimeClock

        running = find_session(session)
        clock = RealtimeClock()
        if once:
            for scene in look_at([running], clock):
                if as_json:
                    print_json(top_object(scene))
                else:
                    out.print(picture(scene, out.width))
            end(0)
            return

        def show(scene: Scene) -> None:
            if as_json:
                typer.echo(json.dumps(top_object(scene), allow_nan=False))
            else:
                out.print(picture(scene, out.width))

        with visiting(running, clock) as (scene, seeing):
            if as_json or not out.is_terminal:
                tell(scene, seeing, show)
            else:
                with quit_key() as stop:
                    show_live(scene, seeing, out, stop)
        say(err, f"{running.about.session}: looked on to tick {scene.tick}")


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
        from manyhands.launch.observe.sessions import find_session
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
