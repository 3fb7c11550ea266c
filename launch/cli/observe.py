"""The commands that observe running sessions: list, echo, hz, top, and view, which serves a session's page."""

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
    """List the sessions that run on this machine, with their state and that of their nodes."""
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
    count: Annotated[int | None, typer.Option("-n", min=1, metavar="COUNT", help="End after this many lines.")] = None,
    every: Annotated[
        int,
        typer.Option("--every", min=1, metavar="N", help="Only ticks that are multiples of N, or each Nth message."),
    ] = 1,
) -> None:
    """Print each value of a running session's topic as a line of JSON, in the form that recordings use."""
    with errors(), pipe_may_close():
        from manyhands.launch.observe.sessions import find_session, visiting
        from manyhands.launch.observe.topics import EchoLines, find_topic, session_of
        from manyhands.protocol.clock import RealtimeClock

        running = find_session(session or session_of(topic))
        named = find_topic(running.about, topic)
        lines = EchoLines(named, running.about.period_of(named.node), count, every)
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
        int, typer.Option("--window", min=2, metavar="N", help="Compute the figures over the last N ticks or messages.")
    ] = DEFAULT_WINDOW,
    duration: Annotated[
        float | None, typer.Option("--duration", metavar="S", help="End after this time, in s; without it, on Ctrl-C.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Measure the rate and regularity of a running session's topic: one line each second, and one at the end."""
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
        printed = began
        with visiting(running, clock, until) as (_, seeing):
            try:
                for seen in seeing:
                    pacing.take(seen.message, seen.at)
                    if not as_json and seen.at - printed >= from_seconds(1.0):
                        printed = seen.at
                        typer.echo(sentence(pacing.found()))
            finally:  # also on Ctrl-C, the usual end
                found = pacing.found()
                if as_json:
                    print_json(found)
                else:
                    typer.echo(sentence(found))


@commands.command(epilog="Example: manyhands top --once")
def top(
    session: RunningName = None,
    once: Annotated[bool, typer.Option("--once", help="Show the table once, and end.")] = False,
    as_json: Json = False,
) -> None:
    """Watch the nodes of a running session: on a terminal a live table, until q or Ctrl-C; else a table every 2 s."""
    with errors(), pipe_may_close():
        import json

        from manyhands.launch.design_report import print_json
        from manyhands.launch.observe.sessions import find_session, visiting
        from manyhands.launch.observe.tables import look_at, picture, quit_key, show_live, show_repeatedly, top_object
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
                show_repeatedly(scene, seeing, show)
            else:
                with quit_key() as stop:
                    show_live(scene, seeing, out, stop)
        say(err, f"{running.about.session}: observed until tick {scene.tick}")


@commands.command(epilog="Example: manyhands view --session example-1 --open")
def view(
    session: RunningName = None,
    host: Annotated[
        str,
        typer.Option("--host", metavar="HOST", help="The address to listen at; other than loopback needs a token."),
    ] = "127.0.0.1",
    port: Annotated[
        int, typer.Option("--port", metavar="PORT", min=0, max=65535, help="The port to listen at; 0 for any free one.")
    ] = 0,
    token_file: Annotated[
        Path | None,
        typer.Option(
            "--token-file",
            metavar="FILE",
            help="Require the token in this file (yours, mode 0600); by default, where one is needed, it is random.",
        ),
    ] = None,
    open_: Annotated[bool, typer.Option("--open/--no-open", help="Open the page in this machine's browser.")] = False,
) -> None:
    """Serve a page of a running session until Ctrl-C: motions, certificate and alarms; devices can be dragged."""
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
                "warning: the page is served without encryption: anybody on the network path can read the token and "
                "hold devices; over networks that are not yours, listen on loopback and use ssh -L",
            )

        def ready(address: str) -> None:
            if token_file is None:
                say(err, f"page: {address}")
            else:  # the token's owner has it already
                say(err, f"page: {address.partition('#')[0]}")
                say(err, f"open it with #token= and the token in {token_file} at its end")
            if open_:
                import webbrowser

                webbrowser.open(address)

        refused: Counter[str] = Counter()
        try:
            serve(running, host, port, token, ready, refused)
        finally:  # Ctrl-C ends the server
            if refused:
                say(err, "refused: " + ", ".join(f"{kind} {count}" for kind, count in sorted(refused.items())))
