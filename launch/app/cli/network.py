"""The commands about a session's processes and how they connect: graph, invite, node, host, join."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from manyhands.launch.app.cli.common import (
    CertificatePath,
    Clock,
    Insecure,
    Json,
    MostDuration,
    Overrides,
    ReportFile,
    RunningName,
    SessionPath,
    Uncertified,
    end,
    err,
    errors,
    key_names,
    node_names,
    one_word_of,
    out,
    refuse,
    require_one_of,
    session_files,
    ticks_of,
)
from manyhands.launch.app.design_report import print_report
from manyhands.launch.app.keys import run_keys
from manyhands.launch.files import require_target
from manyhands.launch.look.display import say
from manyhands.launch.look.graph import FORMATS, format_of, show, show_access
from manyhands.launch.look.graph.parts import drawing_of_live, drawing_of_session
from manyhands.launch.look.sessions import find_session
from manyhands.launch.look.tables import look_at
from manyhands.launch.output import pipe_may_close
from manyhands.launch.plan.bundles import invite as cut_bundle
from manyhands.launch.plan.bundles import require_member
from manyhands.launch.plan.keys import load_folder, make_keys
from manyhands.launch.plan.plan import Plan
from manyhands.launch.plan.reach import Listen
from manyhands.launch.recordings.formats import STREAMED
from manyhands.launch.run.options import Hosting, StartOptions
from manyhands.launch.session import Session
from manyhands.launch.session.shipped import load_named
from manyhands.nodes.guest.invitation import is_guest_address
from manyhands.nodes.kernel.bundle import CLOCKS, REALTIME
from manyhands.protocol.clock import RealtimeClock

commands = typer.Typer()

AllowedCode = Annotated[
    str | None,
    typer.Option(
        "--allow-code",
        metavar="PACKAGE.MODULE:FACTORY",
        help="Let this driver or model of the file run here, with your rights.",
    ),
]

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
            help="A session file, or the name of a shipped one; not with --running.",
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
            autocompletion=one_word_of(("text", "mermaid", "svg")),
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
        if (session is None) is (running is None):
            refuse("give either SESSION or --running NAME")
        if form is not None:
            require_one_of("--format", form, FORMATS)
            if as_json:
                refuse("give either --format or --json")
        if running is not None and (access or overrides):
            refuse("--access and --set need a session file: leave out --running")
        if access and form not in (None, "text"):
            refuse(f"--access: found --format {form}; expected text or --json")
        if output is not None:
            require_target(output)
        shape = format_of(form, output, as_json)
        if access and shape not in ("text", "json"):
            refuse(f"--access: found {output}; expected .txt or .json")
        if session is not None and access:
            show_access(Plan(load_named(session, overrides)), out, shape, output)
        elif session is not None:
            show(drawing_of_session(Plan(load_named(session, overrides))), out, shape, output)
        else:
            sessions = look_at([find_session(running)], RealtimeClock())
            if not sessions:
                refuse(f"--running: no running session {running}")
            show(drawing_of_live(sessions[0]), out, shape, output)
        if output is not None:
            say(err, f"written to {output}")


@commands.command(epilog="Example: manyhands invite example1.yaml dx --keys keys --certificate c.json -o dx.bundle")
def invite(
    session: SessionPath,
    nodes: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[NODE]...",
            help="Devices, couplings, the environment, or observers; without any, keys alone are made.",
            autocompletion=node_names,
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", metavar="PATH", help="The bundle (mode 0600), or a folder for several; by default NODE.bundle here."
        ),
    ] = None,
    keys: Annotated[
        Path | None,
        typer.Option("--keys", metavar="DIR", help="The folder of the session's keys; those that it lacks are made."),
    ] = None,
    renew: Annotated[
        list[str],
        typer.Option(
            "--renew", metavar="NAME", help="Replace this key; others stay. Repeatable.", autocompletion=key_names
        ),
    ] = [],  # noqa: B006
    insecure: Insecure = False,
    clock: Clock = REALTIME,
    overrides: Overrides = [],  # noqa: B006
    certificate: CertificatePath = None,
    uncertified: Uncertified = False,
    as_json: Json = False,
) -> None:
    """Make the keys of a session's processes, and the bundle that each NODE on another machine needs to join.

    A bundle holds its node's own part of the session, and no other. Keys that exist are kept.
    """
    with errors():
        from manyhands.launch.doctor.colocation import Where, settle_colocation

        wanted = nodes or []
        require_one_of("--clock", clock, CLOCKS)
        if (keys is None) is not insecure:
            refuse("give either --keys DIR, where the keys are or are made, or --insecure")
        if insecure and (renew or not wanted):
            refuse("--insecure makes no keys: name a NODE, and leave out --renew")
        if wanted and as_json:
            refuse("--json prints keys alone: leave out NODE")
        if not wanted and (output is not None or certificate is not None):
            refuse(f"{'-o' if output is not None else '--certificate'} needs a NODE of the session")
        loaded, _ = settle_colocation(load_named(session, overrides), Where.APART)  # as the launch with --remote will
        if keys is not None and not wanted:
            end(run_keys(loaded, keys, renew, out, err, as_json))
            return
        from manyhands.launch.app.start import SettledDelay, prepare_settled

        if certificate is None and not uncertified:
            refuse("give --certificate FILE, with which the session will be launched")
        files = bundle_files_of(loaded, wanted, output)
        options = StartOptions(clock, certificate=certificate, uncertified=uncertified)
        prepared = prepare_settled(SettledDelay(loaded), options, err)
        folder = None
        if keys is not None:
            if renew or not keys.exists():
                make_keys(loaded, keys, renew)
            folder = load_folder(loaded, keys)
        for node, file in files.items():
            cut_bundle(prepared, node, folder, clock, file)
            say(err, f"{file}: the bundle of {node}, under the certificate {prepared.id}")
        for node, file in files.items():
            key = "" if keys is None else f" --key {node}.key"
            say(err, f"on its machine: manyhands node {node} --bundle {file.name}{key} --connect tcp://HOST:PORT")
        end(0)


def bundle_files_of(session: Session, nodes: Sequence[str], output: Path | None) -> dict[str, Path]:
    """Where the bundle of each node goes."""
    for node in nodes:
        require_member(session, node)
    if len(set(nodes)) < len(nodes):
        refuse(f"found a node twice among {', '.join(nodes)}; expected each once")
    if output is not None and (len(nodes) > 1 or output.is_dir()):
        if not output.is_dir():
            refuse(f"-o: found {output}; expected a folder that exists, for {len(nodes)} bundles")
        return {node: output / f"{node}.bundle" for node in nodes}
    return {node: output or Path(f"{node}.bundle") for node in nodes}


@commands.command(epilog="Example: manyhands node dx --bundle dx.bundle --key dx.key --connect tcp://192.0.2.7:7400")
def node(
    name: NodeName,
    bundle: Annotated[
        Path,
        typer.Option(
            "--bundle",
            metavar="BUNDLE",
            help="The node's bundle (manyhands invite); with -, launch --on sends bundle and key to standard input.",
        ),
    ],
    connect: Annotated[str, typer.Option("--connect", metavar="tcp://HOST:PORT", help="Where the session listens.")],
    key: Annotated[
        Path | None, typer.Option("--key", metavar="FILE", help="The private key; by default BUNDLE with suffix .key.")
    ] = None,
    host: Annotated[
        str | None,
        typer.Option("--address", metavar="HOST", help="This machine's address, if others connect to it."),
    ] = None,
    allowed: AllowedCode = None,
) -> None:
    """Join a session of another machine as one of its nodes, or as an observer, which prints each message as JSON."""
    from manyhands.nodes.guest.remote import join

    with pipe_may_close():
        end(join(name, bundle, key, connect, host, allowed))


@commands.command(epilog="Example: manyhands host ball --listen 192.0.2.7:7400 --address ball.example.org")
def host(
    session: SessionPath,
    listen: Annotated[
        str,
        typer.Option("--listen", metavar="HOST:PORT", help="This machine's address; links use the ports after PORT."),
    ],
    address: Annotated[
        str | None,
        typer.Option(
            "--address",
            metavar="HOST[:PORT]",
            help="The name or address that guests reach this machine at; by default that of --listen.",
        ),
    ] = None,
    folder: Annotated[
        Path | None,
        typer.Option("-o", metavar="DIR", help="Keys, certificates and invitations; by default the session's name."),
    ] = None,
    duration: MostDuration = None,
    record: Annotated[
        Path | None,
        typer.Option("--record", metavar="FILE", help=f"Record the session while it runs ({STREAMED})."),
    ] = None,
    report: ReportFile = None,
    overrides: Overrides = [],  # noqa: B006
) -> None:
    """Serve a session whose users behind wave links come and go, each with an invitation (manyhands join).

    Every coupling with a wave_link is a seat. The session runs from the start on, whoever is there, until --duration or
    Ctrl-C. The delay of users without a seat is measured on this machine, unless the session states it.

    Designs, keys and invitations are made once and kept in DIR. Where the session has changed since, only what the
    change concerns is made anew: the invitations of the other seats stay good.
    """
    with errors("design"):
        from manyhands.launch.app.start import start

        loaded = load_named(session, overrides)
        ticks = 0 if duration is None else ticks_of(loaded, duration)
        place = Listen.parse(listen)
        if address is None:
            address = listen
        elif not re.search(r":\d+$", address):
            address = f"{address}:{place.port}"
        if not is_guest_address(address):
            refuse(f"--address: found {address!r:.100}; expected HOST or HOST:PORT, such as ball.example.org")
        hosting = Hosting(Path(loaded.name) if folder is None else folder, address)
        options = StartOptions(
            ticks=ticks, transport="tcp", listen=place, hosting=hosting, record=record, report=report
        )
        outcome = start(loaded, options, err)
        print_report(out, outcome.report, outcome.faults)
        end(outcome.code)


@commands.command(epilog="Example: manyhands join right_seat.invitation")
def join(
    invitation: Annotated[
        Path | None,
        typer.Argument(
            metavar="[INVITATION]", help="The file with the host's line; without it, you are asked for the line."
        ),
    ] = None,
    address: Annotated[
        str | None,
        typer.Option("--connect", metavar="HOST:PORT", help="Where the session listens, if not where the line says."),
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask before taking the seat.")] = False,
    most_force: Annotated[
        float | None,
        typer.Option("--max-force", metavar="N", help="The greatest force of your device, whatever the session says."),
    ] = None,
    allowed: AllowedCode = None,
    timeout: Annotated[
        float, typer.Option("--timeout", metavar="S", help="How long to wait for a host at which nobody answers.")
    ] = 60.0,
) -> None:
    """Take a seat in a running session on another machine, until Ctrl-C or the session's end.

    First the way there is measured. What the distance will feel like and the greatest force are reported, and you are
    asked. A session that is
    lost for a while is joined again.
    """
    from manyhands.nodes.guest.seat import take_seat

    if most_force is not None and not 0.0 < most_force < math.inf:
        refuse(f"--max-force: found {most_force}; expected a force greater than 0, N")
    if not 0.0 < timeout < math.inf:
        refuse(f"--timeout: found {timeout}; expected a time greater than 0, s")
    with pipe_may_close():
        end(take_seat(invitation, address, yes, allowed, most_force, timeout))
