"""The commands about a session's processes and how they connect: graph, invite, node, host, join."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from manyhands.launch.app.cli.common import (
    CertificatePath,
    Clock,
    Insecure,
    Json,
    Overrides,
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
    prepare_session,
    refuse,
    require_one_of,
    session_files,
    settle_delay,
    ticks_of,
    warn_of_code,
)
from manyhands.launch.app.design_report import print_report
from manyhands.launch.files import claimed, require_target
from manyhands.launch.look.display import say
from manyhands.launch.output import pipe_may_close
from manyhands.launch.recordings.recording import STREAMED, require_suffix
from manyhands.launch.session import Session
from manyhands.launch.session.design import AUTO
from manyhands.launch.session.shipped import load_named
from manyhands.nodes.guest.invitation import is_guest_address
from manyhands.nodes.kernel.bundle import CLOCKS, REALTIME
from manyhands.nodes.recorder.format import CERTIFICATE_FILE

commands = typer.Typer()

AllowedCode = Annotated[
    str | None,
    typer.Option(
        "--allow-code",
        metavar="PACKAGE.MODULE:FACTORY",
        help="Let the file have this driver or model run here, with your rights.",
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
        from manyhands.launch.files import require_target
        from manyhands.launch.look.graph import FORMATS, format_of, show_scene, show_session
        from manyhands.launch.look.sessions import find_session
        from manyhands.launch.look.tables import look_at
        from manyhands.launch.plan.plan import Plan
        from manyhands.protocol.clock import RealtimeClock

        if (session is None) is (running is None):
            refuse("found neither SESSION nor --running NAME, or both; expected a file, or the name of a running one")
        if form is not None:
            require_one_of("--format", form, FORMATS)
            if as_json:
                refuse("found --format and --json; expected one of them")
        if running is not None and (access or overrides):
            refuse("found --access or --set with --running; expected them with a session file")
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
                refuse(f"--running: found that {running} cannot be looked at; expected one that runs")
            code = show_scene(scenes[0], out, shape, output)
        if output is not None:
            say(err, f"written to {output}")
        end(code)


@commands.command(epilog="Example: manyhands invite example1.yaml dx --keys keys --certificate c.json -o dx.bundle")
def invite(
    session: SessionPath,
    nodes: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[NODE]...",
            help="Devices, couplings, the environment, or observers; without, the keys alone are made.",
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
        from manyhands.launch.app.keys import run_keys
        from manyhands.launch.doctor.colocation import Where, settle_colocation
        from manyhands.launch.plan.bundles import invite as cut_bundle
        from manyhands.launch.plan.keys import load_folder, make_keys

        wanted = nodes or []
        require_one_of("--clock", clock, CLOCKS)
        if (keys is None) is not insecure:
            refuse("found neither --keys nor --insecure, or both; expected --keys DIR, where the keys are or are made")
        if insecure and (renew or not wanted):
            refuse("found --insecure, with which there are no keys; expected NODE, and no --renew")
        if wanted and as_json:
            refuse("found --json with NODE; expected it for keys alone")
        if not wanted and (output is not None or certificate is not None):
            refuse(f"found no NODE for {'-o' if output is not None else '--certificate'}; expected one of the session")
        loaded, _ = settle_colocation(load_named(session, overrides), Where.APART)  # as the launch with --remote will
        if keys is not None and not wanted:
            end(run_keys(loaded, keys, renew, out, err, as_json))
            return
        if certificate is None and not uncertified:
            refuse("found no --certificate; expected the file that the session will be launched with")
        files = bundle_files_of(loaded, wanted, output)
        prepared = prepare_session(loaded, certificate, uncertified)
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
    from manyhands.launch.plan.bundles import require_member

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
            help="The node's bundle (manyhands invite); -: bundle and key come over standard input, from launch --on.",
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
    duration: Annotated[
        float | None, typer.Option("--duration", metavar="S", help="How long to run, in s; without it, until Ctrl-C.")
    ] = None,
    record: Annotated[
        Path | None,
        typer.Option("--record", metavar="FILE", help=f"Record the session while it runs ({STREAMED})."),
    ] = None,
    report: Annotated[Path | None, typer.Option("--report", metavar="FILE", help="Write the report (JSON).")] = None,
    overrides: Overrides = [],  # noqa: B006
) -> None:
    """Serve a session whose users behind wave links come and go, each with an invitation (manyhands join).

    Every coupling with a wave_link is a seat. The session runs from the start on, whoever is there, until --duration or
    Ctrl-C. The delay of users without a seat is measured on this machine, unless the session states it.

    Designs, keys and invitations are made once and kept in DIR. Where the session has changed since, only what the
    change concerns is made anew: the invitations of the other seats stay good.
    """
    with errors("design"), ExitStack() as claims:
        from manyhands.launch.app.design_report import progress_on
        from manyhands.launch.app.session_run import run_session
        from manyhands.launch.doctor.colocation import Where, settle_colocation
        from manyhands.launch.doctor.profile import drop_profile, outlived
        from manyhands.launch.doctor.rates import certified_lines
        from manyhands.launch.plan.engine import require_engine
        from manyhands.launch.plan.keys import load_folder, make_keys
        from manyhands.launch.plan.plan import Plan
        from manyhands.launch.plan.prepare import must_measure, prepare_again
        from manyhands.launch.plan.reach import Listen, reach
        from manyhands.launch.plan.seats import (
            KEYS,
            invitations,
            keep_certificates,
            require_folder,
            seat_nodes,
        )
        from manyhands.launch.plan.sites import with_kept_delay
        from manyhands.launch.plan.topology import require_runnable

        loaded, _ = settle_colocation(load_named(session, overrides), Where.HOSTED, "tcp")
        seats = seat_nodes(loaded)
        ticks = 0 if duration is None else ticks_of(loaded, duration)
        place = Listen.parse(listen)
        if address is None:
            address = listen
        elif not re.search(r":\d+$", address):
            address = f"{address}:{place.port}"
        if not is_guest_address(address):
            refuse(f"--address: found {address!r:.100}; expected HOST or HOST:PORT, such as ball.example.org")
        if record is not None:
            require_suffix(record, (STREAMED,))
            claims.enter_context(claimed(record))
        if report is not None:
            require_target(report)
            claims.enter_context(claimed(report))
        plan = Plan(loaded)
        require_runnable(plan.graph, len(loaded.observers))
        require_engine(loaded)
        directory = Path(loaded.name) if folder is None else folder
        require_folder(directory)
        certificate = directory / CERTIFICATE_FILE
        kept = certificate.exists()
        unknown = [name for name, link in loaded.wave_links.items() if link.tau is None]
        if loaded.design.tau == AUTO and unknown:
            refuse(
                f"{loaded.name}: found design.tau: auto, which measures this machine alone, with the seat "
                f"{unknown[0]!r}; expected couplings.{unknown[0]}.wave_link.tau, the delay that the guest keeps to"
            )
        profile, local = None, len(loaded.wave_links) < len(loaded.couplings)
        if local and not unknown and must_measure(loaded, realtime=True):
            loaded, profile = settle_delay(loaded, realtime=True, transport="tcp")
            loaded = with_kept_delay(certificate, loaded)
        elif loaded.design.tau == AUTO:
            loaded = loaded.with_delay(loaded.latency)  # every user has a seat, whose delay is stated
        if kept:
            with progress_on(err, "designing what has changed") as progress:
                prepared, renewed = prepare_again(loaded, certificate, progress)
            if renewed:
                say(err, f"{directory}: designed anew, for the session has changed: {', '.join(renewed)}")
        else:
            prepared, renewed = prepare_session(loaded, None, uncertified=False), (loaded.name,)
        if renewed:
            keep_certificates(prepared, directory)
        for line in certified_lines(prepared, loaded, profile, time.time()) if local else ():
            say(err, line)
        if local and unknown and loaded.design.tau is None:
            say(
                err,
                f"{loaded.name}: the delay of the users here is not measured, for {unknown[0]} states no "
                f"wave_link.tau; state couplings.{unknown[0]}.wave_link.tau, or design.tau",
            )
        made = make_keys(loaded, directory / KEYS)
        folder_keys = load_folder(loaded, directory / KEYS)
        ways = replace(reach(plan, "tcp", keys=folder_keys, listen=place, remote=seats), seats=seats)
        for seat, invitation in invitations(prepared, folder_keys, address).items():
            path = directory / f"{seat}.invitation"
            invitation.save(path)
            if err.is_terminal:  # where it is kept in a log, an invitation may not be
                say(err, f"waiting for {seat}: send this line over a secure channel; there: manyhands join")
                err.print(invitation.line, markup=False, emoji=False, soft_wrap=True)  # in one piece, to be copied
            else:
                say(err, f"waiting for {seat}: send {path} over a secure channel; there: manyhands join {path.name}")
        last = place.port + len(plan.graph.links) + len(loaded.observers)
        say(err, f"listening at {listen}; guests need its ports {place.port} to {last}, of TCP and of UDP")
        if made.stale:
            say(err, f"{directory / KEYS}: has keys that the session no longer has: {', '.join(made.stale)}")
        warn_of_code(err, loaded, seats)
        outcome = run_session(prepared, err, clock=REALTIME, reach=ways, ticks=ticks, record=record, report=report)
        local_nodes = {name: node for name, node in outcome.report["nodes"].items() if name not in seats}
        if profile is not None and outlived(profile, loaded, local_nodes):
            drop_profile(profile)
            say(err, f"{loaded.name}: the delays were not those measured before; the next host measures them anew")
        print_report(out, outcome.report, outcome.faults)
        end(outcome.code)


@commands.command(epilog="Example: manyhands join right_seat.invitation")
def join(
    invitation: Annotated[
        Path | None,
        typer.Argument(
            metavar="[INVITATION]", help="The file with the host's line; without, you are asked for the line."
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
) -> None:
    """Take a seat in a running session on another machine, until Ctrl-C or the session's end.

    First the way there is measured. What the distance will feel like and the greatest force are reported, and you are
    asked. A session that is
    lost for a while is joined again.
    """
    from manyhands.nodes.guest.seat import take_seat

    if most_force is not None and not 0.0 < most_force < math.inf:
        refuse(f"--max-force: found {most_force}; expected a force greater than 0, N")
    with pipe_may_close():
        end(take_seat(invitation, address, yes, allowed, most_force))
