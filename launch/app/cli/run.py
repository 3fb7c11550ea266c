"""The commands that run a session: simulate, launch, demo."""

from __future__ import annotations

import shlex
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Annotated

import typer

from manyhands.launch.app.cli.common import (
    CertificatePath,
    Clock,
    Delay,
    Duration,
    Insecure,
    Jitter,
    KeyFolder,
    Loss,
    MostDuration,
    Overrides,
    ReportFile,
    SessionPath,
    Uncertified,
    end,
    err,
    errors,
    load_with_network,
    node_names,
    one_word_of,
    out,
    placed_node_names,
    refuse,
    require_folder,
    require_one_of,
    ticks_of,
)
from manyhands.launch.app.design_report import print_report
from manyhands.launch.app.risks import warn_of_code
from manyhands.launch.files import claimed
from manyhands.launch.look.display import progress_bar, say, world_lines
from manyhands.launch.plan.engine import engine_lines
from manyhands.launch.plan.feel import network_lines, person_lines
from manyhands.launch.plan.reach import Listen
from manyhands.launch.recordings.formats import RUN_SUFFIXES, STREAMED, SUFFIXES
from manyhands.launch.recordings.recording import require_suffix
from manyhands.launch.run.directory import is_bare
from manyhands.launch.run.options import StartOptions
from manyhands.launch.run.outcome import enforcement_sentence
from manyhands.launch.session.shipped import load_named
from manyhands.nodes.environment.chatter import contact_tables
from manyhands.nodes.environment.energy import energy_tables
from manyhands.nodes.kernel.bundle import CLOCKS, REALTIME, SIMULATED
from manyhands.nodes.rows.figures import enforcement_figures
from manyhands.protocol.messages import Figures
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
    delay: Delay = None,
    jitter: Jitter = None,
    loss: Loss = None,
) -> None:
    """Run the sampled-data loop in one process.

    A simulation shakes no hand: a session that cannot be certified is simulated with a warning.
    """
    with errors("design"), ExitStack() as claims:
        from manyhands.launch.app.start import SettledForm, settle_and_prepare
        from manyhands.launch.audit.simulation import Simulation, require_one_period

        loaded = load_with_network(session, overrides, delay, jitter, loss)
        try:
            require_one_period(loaded)
        except ValueError as error:
            refuse(str(error))
        ticks = ticks_of(loaded, duration, kept=True)
        if record is not None:
            if record.suffix == STREAMED:
                given = {"--certificate": certificate, "--delay": delay, "--jitter": jitter, "--loss": loss}
                same = [
                    *("manyhands", "launch", str(session), "--clock", "simulated"),
                    *("--duration", f"{loaded.period * ticks:g}", "--record", str(record)),
                    *(word for one in overrides for word in ("--set", one)),
                    *(word for name, value in given.items() if value is not None for word in (name, str(value))),
                    *(["--uncertified"] if uncertified else []),
                ]
                refuse(
                    f"--record: found {record}; expected one of {', '.join(SUFFIXES)}: {STREAMED} has the telemetry of "
                    f"processes, which do the same ticks with: {shlex.join(same)}"
                )
            require_suffix(record)
            claims.enter_context(claimed(record))
        options = StartOptions(clock=SIMULATED, certificate=certificate, uncertified=True)
        _, prepared = settle_and_prepare(SettledForm(loaded), options, err)
        if not prepared.certified and not uncertified:
            say(err, f"warning: {loaded.name} is not certified; launch refuses it without --uncertified")
        warn_of_code(err, loaded)
        with closing(Simulation(prepared)) as simulation, progress_bar(err, "simulating", ticks) as tell:
            recording = simulation.run(ticks, tell)
        if record is not None:
            recording.save(record)
            say(err, f"written to {record}")
        for name, device in simulation.devices.items():
            unit = loaded.devices[name].units("m/s")
            say(
                out,
                f"{name}: peak speed {device.core.peak_speed:.3g} {unit}, "
                f"final speed {recording.final_speed(loaded.ports_of(name)):.3g} {unit}, "
                f"ledger {device.ledger.total:.3g} J (least {device.ledger.minimum:.3g} J)",
            )
        for name, link in simulation.links.items():
            if (impedance := loaded.impedance_of(name)) is not None and ticks:
                say(out, link.felt(impedance, loaded.kinds_of(name)).sentence(name, over=True))
        for line in (*person_lines(loaded), *network_lines(loaded, SIMULATED), *engine_lines(loaded)):
            say(err, line)
        world, parties = simulation.environment, tuple(simulation.couplings)
        tables = energy_tables(world.energy, parties) | contact_tables(world.held, world.chatter, parties)
        for line in world_lines(Figures(world.figures, tables)):
            say(out, line)
        if line := enforcement_sentence(enforcement_figures(world.controller)):
            say(out, line)
        for name, device in simulation.devices.items():
            if device.beyond:
                was, unit = "may have been" if any(device.known_to) else "was", loaded.devices[name].units("m/s")
                say(
                    err,
                    f"warning: {name} {was} faster than the {device.below:g} {unit} below which its certificate holds "
                    f"(times: {device.beyond}, up to {device.fastest:.3g} {unit}); beyond, only its account counts",
                )
            if (guard := device.guard).let_go:
                say(err, f"warning: {name} was beyond its limits and let go (times: {guard.let_go}); last: {guard.why}")


Transport = Annotated[
    str | None,
    typer.Option(
        metavar="|".join(SCHEMES),
        autocompletion=one_word_of(SCHEMES),
        help=f"How the processes communicate; tcp is encrypted. [default: {SCHEMES[0]}; tcp with --on]",
    ),
]
Remote = Annotated[
    list[str],
    typer.Option(
        metavar="NODE", help="Wait for this node to join by invitation; repeatable.", autocompletion=node_names
    ),
]
Placed = Annotated[
    list[str],
    typer.Option(
        "--on",
        metavar="NODE=HOST",
        autocompletion=placed_node_names,
        help="Start this node on HOST by ssh, over tcp with keys; repeatable: --on dx=lab --on cx=lab.",
    ),
]


@commands.command(epilog="Example: manyhands launch example1.yaml --duration 10 --record run.npz --report run.json")
def launch(
    session: SessionPath,
    duration: MostDuration = None,
    clock: Clock = REALTIME,
    transport: Transport = None,
    keys: KeyFolder = None,
    listen: Annotated[
        str | None,
        typer.Option(
            metavar="HOST:PORT",
            help="The address for remote nodes and observers (tcp); links use the ports after PORT.",
        ),
    ] = None,
    remote: Remote = [],  # noqa: B006
    on: Placed = [],  # noqa: B006
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
    report: ReportFile = None,
    directory: Annotated[
        Path | None,
        typer.Option(
            "--directory", metavar="DIR", help="Keep session, certificate, report and logs of this run in a new folder."
        ),
    ] = None,
    overrides: Overrides = [],  # noqa: B006
    certificate: CertificatePath = None,
    uncertified: Uncertified = False,
    delay: Delay = None,
    jitter: Jitter = None,
    loss: Loss = None,
) -> None:
    """Run every device, coupling and the environment as processes of their own, until --duration or Ctrl-C.

    In real time, on a machine with fewer processors than processes, each coupling runs in its device's process, unless
    the session says otherwise: --set colocate=false, or true.
    """
    with errors("design"):
        from manyhands.launch.app.start import start

        require_one_of("--clock", clock, CLOCKS)
        if transport is not None:
            require_one_of("--transport", transport, SCHEMES)
        loaded = load_with_network(session, overrides, delay, jitter, loss)
        if clock != SIMULATED and (delay, jitter, loss) != (None, None, None):
            refuse(
                "--delay, --jitter, --loss: found the realtime clock, whose network is the real one; expected "
                "--clock simulated"
            )
        options = StartOptions(
            clock=clock,
            ticks=0 if duration is None else ticks_of(loaded, duration),
            transport=transport,
            insecure=insecure,
            keys=keys,
            listen=None if listen is None else Listen.parse(listen),
            remote=frozenset(remote),
            on=tuple(on),
            program=program,
            together=together,
            certificate=certificate,
            uncertified=uncertified,
            record=directory / record if directory and record and is_bare(record) else record,
            report=report,
            directory=directory,
        )
        outcome = start(loaded, options, err)
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
        ticks = ticks_of(shipped["example1"], duration, kept=True)
        end(run_demo(shipped, out, err, output, ticks, clock))


DEMO_SESSIONS = ("example1", "example1-centralised", "example1-uncoupled")
_APART = "colocate=false"  # the paper's structure on every machine: a process for each block of V
