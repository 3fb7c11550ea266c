"""The commands that observe running sessions: echo, hz, top, and view, which serves a session's page."""

from __future__ import annotations

import json
import os
import time
import webbrowser
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from manyhands.launch.app.cli.common import Json, RunningName, end, err, errors, out, refuse, topic_names
from manyhands.launch.look.display import say
from manyhands.launch.look.page.security import Token, is_loopback, new_token, read_token
from manyhands.launch.look.sessions import find_session, visiting
from manyhands.launch.look.tables import (
    look_at,
    picture,
    print_sessions,
    quit_key,
    session_object,
    show_live,
    show_repeatedly,
    top_object,
)
from manyhands.launch.look.topics import DEFAULT_WINDOW, EchoLines, Pacing, find_topic, sentence, session_of
from manyhands.launch.output import pipe_may_close, print_json
from manyhands.launch.run.running import Running, running_sessions
from manyhands.nodes.monitor.session_state import LiveSession
from manyhands.protocol.clock import Instant, RealtimeClock, from_seconds

commands = typer.Typer()

TopicName = Annotated[
    str,
    typer.Argument(
        metavar="TOPIC",
        help="NODE/TOPIC or /SESSION/NODE/TOPIC, such as dx/sample, dx/telemetry, supervisor/condition.",
        autocompletion=topic_names,
    ),
]


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
        running = find_session(session or session_of(topic))
        named = find_topic(running.about, topic)
        lines = EchoLines(named, running.about.period_of(named.node), count, every)
        with visiting(running, RealtimeClock()) as (live, seeing):
            for seen in seeing:
                text = "\n".join(lines.lines(seen.message, live.tick))
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
    all_: Annotated[
        bool, typer.Option("--all", help="Show the state of every session that runs on this machine, and end.")
    ] = False,
    once: Annotated[bool, typer.Option("--once", help="Show the table once, and end.")] = False,
    as_json: Json = False,
) -> None:
    """Watch the nodes of a running session: on a terminal a live table, until q or Ctrl-C; else a table every 2 s."""
    with errors(), pipe_may_close():
        if all_:
            if session is not None:
                refuse("give either --all or --running NAME")
            _show_all(as_json)
            return
        running = find_session(session)
        clock = RealtimeClock()
        if once:
            for live in look_at([running], clock):
                if as_json:
                    print_json(top_object(live))
                else:
                    out.print(picture(live, out.width))
            end(0)
            return

        def show(live: LiveSession) -> None:
            if as_json:
                typer.echo(json.dumps(top_object(live), allow_nan=False))
            else:
                out.print(picture(live, out.width))

        with visiting(running, clock) as (live, seeing):
            if as_json or not out.is_terminal:
                show_repeatedly(live, seeing, show)
            else:
                with quit_key() as stop:
                    show_live(live, seeing, out, stop)
        say(err, f"{running.about.session}: observed until tick {live.tick}")


def _show_all(as_json: bool) -> None:
    sessions = look_at(running_sessions(), RealtimeClock())
    if not sessions:
        say(err, "no session is running; start one with: manyhands launch SESSION")
    if as_json:
        print_json([session_object(live) for live in sessions])
    elif sessions:
        print_sessions(out, sessions, time.time())


Port = Annotated[
    int | None,
    typer.Option(
        "--port",
        metavar="PORT",
        min=0,
        max=65535,
        help="The port to listen at, 0 for any free one; by default that, with --foxglove 8765. With --ros: listen "
        "there for nodes of ROS 2, without a router.",
    ),
]
TokenFile = Annotated[
    Path | None,
    typer.Option(
        "--token-file",
        metavar="FILE",
        help="Require the token in this file (yours, mode 0600); by default, where one is needed, it is random.",
    ),
]


@commands.command(epilog="Example: manyhands view --running example-1 --open")
def view(
    session: RunningName = None,
    host: Annotated[
        str,
        typer.Option("--host", metavar="HOST", help="The address to listen at; other than loopback needs a token."),
    ] = "127.0.0.1",
    port: Port = None,
    token_file: TokenFile = None,
    open_: Annotated[bool, typer.Option("--open/--no-open", help="Open the page in this machine's browser.")] = False,
    foxglove: Annotated[
        bool, typer.Option("--foxglove", help="Serve Foxglove's live connection instead of the page.")
    ] = False,
    every: Annotated[
        int | None,
        typer.Option(
            "--every",
            min=1,
            metavar="N",
            help="With --foxglove or --ros, send ticks that are multiples of N [10].",
        ),
    ] = None,
    layout: Annotated[
        Path | None,
        typer.Option(
            "--layout",
            metavar="LAYOUT",
            help="With --foxglove, write the session's layout here (.json; .xml: PlotJuggler).",
        ),
    ] = None,
    ros: Annotated[bool, typer.Option("--ros", help="Publish the devices in ROS 2 instead of the page.")] = False,
    router: Annotated[
        str | None,
        typer.Option(
            "--router",
            metavar="HOST:PORT",
            help="With --ros, the router of Zenoh that ROS 2 uses [localhost:7447].",
        ),
    ] = None,
    servo: Annotated[
        bool,
        typer.Option("--servo", help="With --ros, let nodes of ROS 2 hold the devices that a page could drag."),
    ] = False,
) -> None:
    """Serve a page of a running session until Ctrl-C: motions, certificate and alarms; devices can be dragged.

    With --foxglove it serves the channels of a recording to Foxglove, live. With --ros it publishes motions and forces
    of the devices in ROS 2, by the protocol of rmw_zenoh.
    """
    if ros and foxglove:
        refuse("give either --foxglove or --ros")
    for option, given, fits, needed in (
        ("--every", every is not None, foxglove or ros, "--foxglove or --ros"),
        ("--layout", layout is not None, foxglove, "--foxglove"),
        ("--router", router is not None, ros, "--ros"),
        ("--servo", servo, ros, "--ros"),
    ):
        if given and not fits:
            refuse(f"{option} needs {needed}")
    if ros:
        for option, given in (("--open", open_), ("--token-file", token_file is not None)):
            if given:
                refuse(f"give either {option} or --ros")
        _view_in_ros(session, host, port, router, every, servo)
    elif foxglove:
        _view_in_foxglove(session, host, port, token_file, open_, every, layout)
    else:
        _view_page(session, host, port, token_file, open_)


def _begin(session: str | None, host: str, token_file: Path | None, page: bool) -> tuple[Running, Token | None]:
    """The session that is served, and the token that is needed for it; None where the address is enough."""
    token = None if token_file is None else read_token(token_file)
    running = find_session(session)
    served = "its page" if page else "the live connection"
    say(err, f"{running.about.session}: starting {served}")  # the libraries take a while
    if not is_loopback(host):
        token = token or new_token()
        say(
            err,
            f"warning: {'the page' if page else 'this'} is served without encryption: anybody on the network path can "
            f"read the token and {'hold devices' if page else 'the session'}; over networks that are not yours, listen "
            "on loopback and use ssh -L",
        )
    return running, token


@contextmanager
def _counting() -> Iterator[Counter[str]]:
    """Yields a counter of refusals; they are said at the end, also on Ctrl-C, which ends a server."""
    refused: Counter[str] = Counter()
    try:
        yield refused
    finally:
        if refused:
            say(err, "refused: " + ", ".join(f"{kind} {count}" for kind, count in sorted(refused.items())))


def _view_page(session: str | None, host: str, port: int | None, token_file: Path | None, open_: bool) -> None:
    with errors("view"), _counting() as refused:
        running, token = _begin(session, host, token_file, page=True)
        from manyhands.launch.look.page.server import serve

        def ready(address: str) -> None:
            if token_file is None:
                say(err, f"page: {address}")
            else:  # the token's owner has it already
                say(err, f"page: {address.partition('#')[0]}")
                say(err, f"open it with #token= and the token in {token_file} at its end")
            say(err, f"{running.about.session}: waiting for a browser to open this address; Ctrl-C ends")
            if open_:
                webbrowser.open(address)

        serve(running, host, port or 0, token, ready, refused)


def _view_in_foxglove(
    session: str | None,
    host: str,
    port: int | None,
    token_file: Path | None,
    open_: bool,
    every: int | None,
    layout: Path | None,
) -> None:
    with errors("view", "foxglove"), _counting() as refused:
        if open_ and (token_file is not None or not is_loopback(host)):
            refuse("--open would send the token to foxglove.dev: leave it out, and open Foxglove yourself")
        running, token = _begin(session, host, token_file, page=False)
        from manyhands.launch.bridges.foxglove import PORT, application_address, serve_foxglove
        from manyhands.launch.bridges.layouts import live_topics, save_layout
        from manyhands.launch.look.page.feed import EVERY
        from manyhands.nodes.recorder.format import recorded_of

        def ready(address: str) -> None:
            if layout is not None:
                save_layout(layout, recorded_of(running.about), live_topics(running.about))
                say(err, f"layout: {layout}")
            say(err, f"foxglove: {address}{'' if token is None or token_file else f'?token={token.reveal()}'}")
            if token_file is not None:
                say(err, f"connect to it with ?token= and the token in {token_file} at its end")
            say(err, f"{running.about.session}: waiting for Foxglove to connect to this address; Ctrl-C ends")
            if open_:
                webbrowser.open(application_address(address))

        serve_foxglove(running, host, PORT if port is None else port, token, every or EVERY, ready, refused)


def _view_in_ros(
    session: str | None, host: str, port: int | None, router: str | None, every: int | None, servo: bool
) -> None:
    with errors("ros"), _counting() as refused:
        from manyhands.launch.bridges.ros import ROUTER, ZenohAccess, domain_of, holdable, serve_ros
        from manyhands.launch.look.page.feed import EVERY

        if port is not None and router is not None:
            refuse("give either --port, at which nodes connect to this program, or --router")
        if not is_loopback(host):
            refuse(f"--host: found {host}; expected a loopback address, since --ros asks nobody for a token")
        shown = f"[{host}]" if ":" in host else host
        access = ZenohAccess(router or ROUTER) if port is None else ZenohAccess(f"{shown}:{port}", listens=True)
        if servo and not access.is_local:
            refuse(
                f"--servo: found the router {access.address}; expected one of this machine, since --servo asks nobody "
                "for a token: reach another with ssh -L 7447:127.0.0.1:7447"
            )
        domain, running = domain_of(os.environ), find_session(session)
        if not access.is_local:
            say(
                err,
                "warning: the session is sent without encryption: anybody on the network path can read it; over "
                "networks that are not yours, use ssh -L 7447:127.0.0.1:7447",
            )
        held = holdable(running.about)
        if servo and not held:
            refuse(
                "--servo: found no device that a person can hold; expected one with driver: browser, of at most three "
                "axes, in a session in real time"
            )
        if servo:
            say(
                err,
                f"warning: every node of ROS 2 that reaches {access.address} can hold {', '.join(held)}; a router that "
                "listens to other machines lets theirs in, too",
            )

        def ready(topics: int) -> None:
            where = f"listening at {access.address}" if access.listens else f"by the router {access.address}"
            say(err, f"ros: {topics} topics of {running.about.session} in domain {domain}, {where}")

        serve_ros(running, access, domain, every or EVERY, servo, ready, refused)
