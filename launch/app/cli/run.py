"""The commands that run a session: simulate, launch, demo."""

from __future__ import annotations

import shutil
import time
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Annotated

import typer

from manyhands.launch.app.cli.common import (
    CertificatePath,
    Clock,
    Duration,
    Insecure,
    KeyFolder,
    Overrides,
    SessionPath,
    Uncertified,
    end,
    err,
    errors,
    node_names,
    one_word_of,
    out,
    placed_node_names,
    prepare_session,
    refuse,
    require_folder,
    require_one_of,
    settle_delay,
    ticks_of,
    warn_insecure,
    warn_of_code,
)
from manyhands.launch.app.design_report import print_report
from manyhands.launch.doctor.colocation import Where, settle_colocation
from manyhands.launch.files import claimed, require_target
from manyhands.launch.look.display import say
from manyhands.launch.plan.engine import require_engine
from manyhands.launch.plan.hosts import by_hand, hosts_of, require_hosts_alone
from manyhands.launch.plan.keys import load_folder
from manyhands.launch.plan.loop import NotCertified
from manyhands.launch.plan.plan import Plan
from manyhands.launch.plan.prepare import must_measure
from manyhands.launch.plan.reach import Listen, reach
from manyhands.launch.plan.topology import require_runnable
from manyhands.launch.recordings.recording import RUN_SUFFIXES, STREAMED, SUFFIXES, require_format, require_suffix
from manyhands.launch.run.directory import SessionDirectory, is_bare, require_new
from manyhands.launch.session import ENVIRONMENT
from manyhands.launch.session.design import AUTO
from manyhands.launch.session.shipped import load_named
from manyhands.nodes.kernel.bundle import CLOCKS, REALTIME
from manyhands.protocol.transport.zeromq import SCHEMES

commands = typer.Typer()


@commands.command(epilog="Example: manyhands simulate example1.yaml --duration 5 --record run.npz")
def simulate(
    session: SessionPath,
    duration: Duration = 10.0,
    record: Annotated[
        Path | None,
        typer.Option("--record", metavar="FILE", help=f"Record every x and f_v ({', '.join(SUFFIXES)})."),
    ] = None,
    overrides: Overrides = [],  # noqa: B006
    certificate: CertificatePath = None,
    uncertified: Uncertified = False,
) -> None:
    """Run the sampled-data loop in one process.

    A simulation shakes no hand: a session that cannot be certified is simulated with a warning.
    """
    with errors("design"), ExitStack() as claims:
        from rich.progress import Progress

        from manyhands.launch.audit.simulation import Simulation, require_one_period
        from manyhands.launch.look.display import world_lines
        from manyhands.launch.run.outcome import enforcement_sentence
        from manyhands.nodes.environment.chatter import contact_tables
        from manyhands.nodes.environment.energy import energy_tables
        from manyhands.nodes.rows.figures import enforcement_figures
        from manyhands.protocol.messages import Figures

        loaded = load_named(session, overrides)
        try:
            require_one_period(loaded)
        except ValueError as error:
            refuse(str(error))
        ticks = ticks_of(loaded, duration, kept=True)
        if record is not None:
            require_suffix(record)
            claims.enter_context(claimed(record))
        if certificate is None:
            loaded, _ = settle_delay(loaded, realtime=False)
        prepared = prepare_session(loaded, certificate, uncertified=True)
        if not prepared.certified and not uncertified:
            say(err, f"warning: {loaded.name} is not certified; launch refuses it without --uncertified")
        warn_of_code(err, loaded)
        with closing(Simulation(prepared)) as simulation, Progress(console=err, transient=True) as bar:
            task = bar.add_task("simulating", total=ticks)
            recording = simulation.run(ticks, lambda done: bar.update(task, completed=done))
        if record is not None:
            recording.save(record)
            say(err, f"written to {record}")
        for name, device in simulation.devices.items():
            say(
                out,
                f"{name}: peak speed {device.peak_speed:.3g} m/s, speed at the end {device.speed:.3g} m/s, "
                f"ledger {device.ledger.total:.3g} J (least {device.ledger.minimum:.3g} J)",
            )
        world, parties = simulation.environment, tuple(simulation.couplings)
        tables = energy_tables(world.energy, parties) | contact_tables(world.held, world.chatter, parties)
        for line in world_lines(Figures(world.figures, tables)):
            say(out, line)
        if line := enforcement_sentence(enforcement_figures(world.controller)):
            say(out, line)
        for name, guard in simulation.guards.items():
            if guard.let_go:
                say(err, f"warning: {name} was beyond its limits and let go (times: {guard.let_go}); last: {guard.why}")


@commands.command(epilog="Example: manyhands launch example1.yaml --duration 10 --record run.npz --report run.json")
def launch(
    session: SessionPath,
    duration: Annotated[
        float | None, typer.Option("--duration", metavar="S", help="How long to run, in s; without it, until Ctrl-C.")
    ] = None,
    clock: Clock = REALTIME,
    transport: Annotated[
        str | None,
        typer.Option(
            metavar="|".join(SCHEMES),
            autocompletion=one_word_of(SCHEMES),
            help=f"How the processes communicate; tcp is encrypted. [default: {SCHEMES[0]}; tcp with --on]",
        ),
    ] = None,
    keys: KeyFolder = None,
    listen: Annotated[
        str | None,
        typer.Option(
            metavar="HOST:PORT",
            help="The address for remote nodes and observers (tcp); links use the ports after PORT.",
        ),
    ] = None,
    remote: Annotated[
        list[str],
        typer.Option(
            metavar="NODE", help="Wait for this node to join by invitation; repeatable.", autocompletion=node_names
        ),
    ] = [],  # noqa: B006
    on: Annotated[
        list[str],
        typer.Option(
            "--on",
            metavar="NODE=HOST",
            autocompletion=placed_node_names,
            help="Start this node on HOST by ssh, over tcp with keys; repeatable: --on dx=lab --on cx=lab.",
        ),
    ] = [],  # noqa: B006
    program: Annotated[
        str, typer.Option("--program", metavar="COMMAND", help="With --on: what starts manyhands on those machines.")
    ] = "manyhands",
    together: Annotated[
        bool, typer.Option("--together", help="End the session when a remote node leaves; by default the others go on.")
    ] = False,
    insecure: Insecure = False,
    record: Annotated[
        Path | None,
        typer.Option(
            "--record",
            metavar="FILE",
            help=f"Record every x and f_v ({', '.join(RUN_SUFFIXES)}); {STREAMED} is written while the session runs, "
            "with all telemetry. A bare name is put into --directory.",
        ),
    ] = None,
    report: Annotated[Path | None, typer.Option("--report", metavar="FILE", help="Write the report (JSON).")] = None,
    directory: Annotated[
        Path | None,
        typer.Option(
            "--directory", metavar="DIR", help="Keep session, certificate, report and logs of this run in a new folder."
        ),
    ] = None,
    overrides: Overrides = [],  # noqa: B006
    certificate: CertificatePath = None,
    uncertified: Uncertified = False,
) -> None:
    """Run every device, coupling and the environment as processes of their own, until --duration or Ctrl-C.

    In real time, on a machine with fewer processors than processes, each coupling runs in its device's process, unless
    the session says otherwise: --set colocate=false, or true.
    """
    with errors("design"), ExitStack() as claims:
        from manyhands.launch.app.session_run import run_session
        from manyhands.launch.doctor.profile import drop_profile, outlived
        from manyhands.launch.doctor.rates import certified_lines

        require_one_of("--clock", clock, CLOCKS)
        if transport is not None:
            require_one_of("--transport", transport, SCHEMES)
        loaded = load_named(session, overrides)
        ticks = 0 if duration is None else ticks_of(loaded, duration)
        if directory is not None:
            require_new(directory)
        if record is not None and directory is not None and is_bare(record):
            record = directory / record
            require_format(record, RUN_SUFFIXES)
        elif record is not None:
            require_suffix(record, RUN_SUFFIXES)
            claims.enter_context(claimed(record))
        if report is not None:
            require_target(report)
            claims.enter_context(claimed(report))
        invited = bool(on or remote) or (uncertified and listen is not None)  # such an id has the form in it
        where = Where.of(realtime=clock == REALTIME, elsewhere=invited)
        loaded, processes = settle_colocation(loaded, where, transport or SCHEMES[0], not insecure)
        plan = Plan(loaded)
        require_runnable(plan.graph, len(loaded.observers))
        if ENVIRONMENT not in remote:
            require_engine(loaded)
        hosts = hosts_of(on, plan, remote)
        require_hosts_alone(hosts, transport, insecure, listen is not None)
        if hosts and shutil.which("ssh") is None:
            refuse("--on: found no ssh on PATH; expected the system's client, or the nodes started by hand (--remote)")
        transport = transport or ("tcp" if hosts else SCHEMES[0])
        ways = reach(
            plan,
            transport,
            insecure=insecure,
            keys=None if keys is None else load_folder(loaded, keys),
            listen=None if listen is None else Listen.parse(listen),
            remote=frozenset(remote),
            hosts=hosts,
            program=program,
        )
        if insecure:
            warn_insecure(err)
        local = clock == REALTIME and not ways.remote
        if ways.remote and loaded.design.tau == AUTO and certificate is None:
            expected = "the file that the invitation was made with" if remote else "one, or design.tau in seconds"
            refuse(
                f"{'--remote' if remote else '--on'}: found design.tau: auto, which measures this machine alone, and "
                f"no --certificate; expected {expected}"
            )
        designed = certificate is None and not (uncertified and loaded.design.tau is None)
        settled, profile = settle_delay(
            loaded, realtime=local, designed=designed, transport=transport, encrypted=not insecure
        )
        try:
            prepared = prepare_session(settled, certificate, uncertified)
        except NotCertified as error:
            if designed and must_measure(loaded, realtime=local):
                tau = f"{1e3 * (settled.design.stated_tau or 0.0):.3g} ms"
                text = f"{error}; the delay of {tau} was measured here: design.tau=0 asks for a certificate without any"
                raise NotCertified(text) from error
            raise
        for line in certified_lines(prepared, settled, profile, time.time()) if clock == REALTIME else ():
            say(err, line)
        if processes:
            say(err, f"{loaded.name}: {processes}")
        warn_of_code(err, loaded, ways.remote - hosts.keys())
        for name in sorted(ways.remote):
            if name in hosts:
                say(err, f"{name}: started on {hosts[name]} by ssh")
            elif ways.listen.port:
                say(err, f"{name} is awaited; on its machine: {by_hand(name, f'tcp://{listen}')}")
        kept = None if directory is None else SessionDirectory(directory)
        outcome = run_session(
            prepared,
            err,
            clock=clock,
            reach=ways,
            ticks=ticks,
            record=record,
            report=report,
            directory=kept,
            together=together,
        )
        if profile is not None and outlived(profile, loaded, outcome.report["nodes"]):
            drop_profile(profile)
            say(err, f"{loaded.name}: the delays were not those measured before; the next launch measures them anew")
        print_report(out, outcome.report, outcome.faults)
        end(outcome.code)


@commands.command(epilog="Example: manyhands demo -o out/demo")
def demo(
    output: Annotated[Path, typer.Option("-o", metavar="DIR", help="The folder for plots and report.")] = Path(
        "out/demo"
    ),
    duration: Duration = 10.0,
    clock: Clock = REALTIME,
) -> None:
    """Design Example 1's coupling, run its seven processes with it and without, and draw the paper's Figs. 5-7."""
    with errors("design", "record", "plot"):
        from manyhands.launch.app.demo import LIMITED, run_demo

        require_one_of("--clock", clock, CLOCKS)
        require_folder(output)
        shipped = {name: load_named(Path(f"{name}.yaml"), [_APART]) for name in DEMO_SESSIONS}
        shipped["example1-limited"] = load_named(Path("example1-uncoupled.yaml"), [_APART, *LIMITED])
        require_runnable(Plan(shipped["example1"]).graph)
        ticks = ticks_of(shipped["example1"], duration, kept=True)
        shipped["example1"], profile = settle_delay(shipped["example1"], realtime=clock == REALTIME)
        end(run_demo(shipped, out, err, output, ticks, clock, profile))


DEMO_SESSIONS = ("example1", "example1-centralised", "example1-uncoupled")
_APART = "colocate=false"  # the paper's structure on every machine: a process for each block of V
