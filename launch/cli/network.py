"""The commands about a session's processes and how they connect: graph, keys, invite, node."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from manyhands.launch.cli.common import (
    CertificatePath,
    Clock,
    Insecure,
    Json,
    KeyFolder,
    Overrides,
    RunningName,
    SessionPath,
    Uncertified,
    end,
    err,
    errors,
    node_names,
    out,
    prepare_session,
    refuse,
    require_one_of,
    session_files,
)
from manyhands.launch.files import load_named
from manyhands.launch.output import pipe_may_close
from manyhands.launch.run.display import say
from manyhands.nodes.bundle import CLOCKS, REALTIME

commands = typer.Typer()

NodeName = Annotated[
    str,
    typer.Argument(
        metavar="NODE", help="A device, a coupling, the environment, or an observer.", autocompletion=node_names
    ),
]


@commands.command(epilog="Example: manyhands graph example1.yaml --format svg -o graph.svg")
def graph(
    session: Annotated[
        Path | None,
        typer.Argument(
            metavar="[SESSION]",
            help="A session file, or the name of a shipped one; not with --session.",
            autocompletion=session_files,
        ),
    ] = None,
    running: RunningName = None,
    access: Annotated[bool, typer.Option("--access", help="Show which process may read and write what.")] = False,
    form: Annotated[
        str | None,
        typer.Option(
            "--format",
            metavar="text|mermaid|svg",
            help="The format; by default that of FILE's suffix, or text.",
            autocompletion=lambda: ["text", "mermaid", "svg"],
        ),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", metavar="FILE", help="Write it here instead (.svg, .mmd, .txt, .json).")
    ] = None,
    overrides: Overrides = [],  # noqa: B006 -- typer reads the default and makes its own list
    as_json: Json = False,
) -> None:
    """Show a session's processes and links, or their access rights; for a running session, the state of each."""
    with errors():
        from manyhands.launch.files import require_target
        from manyhands.launch.graph import FORMATS, format_of, show_scene, show_session
        from manyhands.launch.observe.sessions import find_session
        from manyhands.launch.observe.tables import look_at
        from manyhands.launch.plan.plan import Plan
        from manyhands.protocol.clock import RealtimeClock

        if (session is None) is (running is None):
            refuse("found neither SESSION nor --session NAME, or both; expected a file, or the name of a running one")
        if form is not None:
            require_one_of("--format", form, FORMATS)
            if as_json:
                refuse("found --format and --json; expected one of them")
        if running is not None and (access or overrides):
            refuse("found --access or --set with --session; expected them with a session file")
        if access and form not in (None, "text"):
            refuse(f"--access: found --format {form}; expected text or --json")
        if output is not None:
            require_target(output)
        shape = format_of(form, output, as_json)
        if access and shape not in ("text", "json"):
            refuse(f"--access: found {output}; expected .txt or .json")
        if session is not None:
            code = show_session(Plan(load_named(session, overrides)), out, shape, output, access)
        else:
            scenes = look_at([find_session(running)], RealtimeClock())
            if not scenes:
                refuse(f"--session: found that {running} cannot be looked at; expected one that runs")
            code = show_scene(scenes[0], out, shape, output)
        if output is not None:
            say(err, f"written to {output}")
        end(code)


@commands.command(epilog="Example: manyhands keys example1.yaml -o keys")
def keys(
    session: SessionPath,
    output: Annotated[Path, typer.Option("-o", metavar="DIR", help="The folder of the session's keys.")],
    renew: Annotated[
        list[str], typer.Option("--renew", metavar="NAME", help="Replace this key; others stay. Repeatable.")
    ] = [],  # noqa: B006
    overrides: Overrides = [],  # noqa: B006
    as_json: Json = False,
) -> None:
    """Make a key pair for every process, the supervisor and the observers. Existing keys are kept."""
    with errors():
        from manyhands.launch.plan.keys import run_keys

        end(run_keys(load_named(session, overrides), output, renew, out, err, as_json))


@commands.command(epilog="Example: manyhands invite example1.yaml dx --keys keys --certificate c.json -o dx.bundle")
def invite(
    session: SessionPath,
    node: NodeName,
    output: Annotated[Path, typer.Option("-o", metavar="BUNDLE", help="Write the bundle here (mode 0600).")],
    keys: KeyFolder = None,
    insecure: Insecure = False,
    clock: Clock = REALTIME,
    overrides: Overrides = [],  # noqa: B006
    certificate: CertificatePath = None,
    uncertified: Uncertified = False,
) -> None:
    """Write the bundle that one node on another machine needs to join: its own part of the session, and no other."""
    with errors():
        from manyhands.launch.plan.bundles import invite as cut_bundle
        from manyhands.launch.plan.keys import load_folder

        require_one_of("--clock", clock, CLOCKS)
        if (keys is None) is not insecure:
            refuse("found neither --keys nor --insecure, or both; expected --keys DIR (manyhands keys makes them)")
        if certificate is None and not uncertified:
            refuse("found no --certificate; expected the file that the session will be launched with")
        loaded = load_named(session, overrides)
        folder = None if keys is None else load_folder(loaded, keys)
        prepared = prepare_session(loaded, certificate, uncertified)
        cut_bundle(prepared, node, folder, clock, output)
        say(err, f"{output}: the bundle of {node}, under the certificate {prepared.id}")
        key = "" if keys is None else f" --key {node}.key"
        say(err, f"on its machine: manyhands node {node} --session {output.name}{key} --connect tcp://HOST:PORT")
        end(0)


@commands.command(epilog="Example: manyhands node dx --session dx.bundle --key dx.key --connect tcp://192.0.2.7:7400")
def node(
    name: NodeName,
    bundle: Annotated[
        Path,
        typer.Option(
            "--session",
            metavar="BUNDLE",
            help="The node's bundle (manyhands invite); -: bundle and key come over standard input, from launch --on.",
        ),
    ],
    connect: Annotated[str, typer.Option("--connect", metavar="tcp://HOST:PORT", help="Where the session listens.")],
    key: Annotated[
        Path | None, typer.Option("--key", metavar="FILE", help="The private key; by default BUNDLE with suffix .key.")
    ] = None,
    host: Annotated[
        str | None,
        typer.Option("--host", metavar="HOST", help="This machine's address, if others connect to it."),
    ] = None,
) -> None:
    """Join a session of another machine as one of its nodes, or as an observer, which prints each message as JSON."""
    from manyhands.nodes.remote import join

    with pipe_may_close():
        end(join(name, bundle, key, connect, host))
