"""The command line: what the arguments mean, what is printed, and the exit codes.

0 done; 1 a process failed; 2 usage error or bad input; 3 not certified; 130 Ctrl-C. Results go to standard
output, everything else to standard error, so that ``--json`` can be piped.
"""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Annotated

import typer
from rich.console import Console

import manyhands
from manyhands.design.errors import CertificateError, DesignError
from manyhands.launch.display import say
from manyhands.launch.exits import EXIT_BAD_INPUT, EXIT_FAILED, EXIT_INTERRUPTED, EXIT_NOT_CERTIFIED
from manyhands.launch.files import TargetError, require_target
from manyhands.launch.preparation import NotCertified, Prepared, prepare
from manyhands.launch.recording import SUFFIXES, RecordingError, require_suffix
from manyhands.launch.session import Session, SessionError
from manyhands.launch.shipped import load_named
from manyhands.launch.summary import print_report
from manyhands.launch.topology import LinkTooWide, require_runnable, topology
from manyhands.nodes.bundle import CLOCKS, REALTIME
from manyhands.protocol.transport.zeromq import SCHEMES

MOST_SIMULATED_VALUES = 100_000_000  # ticks x ports kept in memory, 1.6 GB

app = typer.Typer(
    name="manyhands",
    help="Several haptic devices, one virtual environment, and a certificate that the loop is stable.",
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

_NO_TERMINAL_WIDTH = 140  # columns, for tables in a file or a pipe


def _console(stderr: bool) -> Console:
    console = Console(stderr=stderr, highlight=False, soft_wrap=True)
    return console if console.is_terminal else Console(stderr=stderr, highlight=False, width=_NO_TERMINAL_WIDTH)


out, err = _console(stderr=False), _console(stderr=True)

SessionPath = Annotated[Path, typer.Argument(metavar="SESSION", help="A session file, or the name of a shipped one.")]
Overrides = Annotated[
    list[str], typer.Option("--set", metavar="KEY=VALUE", help="Override a value of the session; repeatable.")
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]
Duration = Annotated[float, typer.Option("--duration", metavar="S", help="How long to run, in s.")]
Clock = Annotated[str, typer.Option(metavar="|".join(CLOCKS), help="What paces the session.")]
CertificatePath = Annotated[
    Path | None, typer.Option("--certificate", metavar="CERT", help="Run under this certificate instead of designing.")
]
Uncertified = Annotated[bool, typer.Option("--uncertified", help="Run even if nothing proves the session stable.")]


def _version(wanted: bool) -> None:
    if wanted:
        say(out, f"manyhands {manyhands.__version__}")
        raise typer.Exit


@app.callback()
def _main(
    version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Print it.")] = False,
) -> None:
    # From here on there may be half-written files to clear away, so Ctrl-C unwinds instead of leaving at once.
    signal.signal(signal.SIGINT, _unwind)


_ctrl_c: list[int] = []  # what was asked, for the unwinding may be caught on its way by code that is not ours


def _unwind(signum: int, _frame: FrameType | None) -> None:
    _ctrl_c.append(signum)
    raise SystemExit(EXIT_INTERRUPTED)


@app.command(epilog="Example: manyhands design example1.yaml -o example1.cert.json")
def design(
    session: SessionPath,
    output: Annotated[Path | None, typer.Option("-o", metavar="CERT", help="Write the certificate here.")] = None,
    pictures: Annotated[Path | None, typer.Option("--plot", metavar="DIR", help="Draw the design there.")] = None,
    overrides: Overrides = [],  # noqa: B006 -- typer reads the default and makes its own list
    as_json: Json = False,
) -> None:
    """Find a virtual coupling, prove it, and write the certificate. Exit code 3: infeasible.

    Ctrl-C ends a long search and keeps the best coupling so far, proved like any other (exit code 130).
    """
    with _errors():
        from manyhands.launch.designing import run_design

        loaded = load_named(session, overrides)
        if output is not None:
            require_target(output)
        _require_folder(pictures)
        _end(run_design(loaded, out, err, output, pictures, as_json))


@app.command(name="verify", epilog="Example: manyhands verify example1.cert.json --session example1.yaml")
def verify_command(
    certificate: Annotated[Path, typer.Argument(metavar="CERT", help="A certificate file.")],
    session: Annotated[
        Path | None, typer.Option("--session", metavar="SESSION", help="Check that it is this session's, too.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Prove a certificate again, from its physical data in exact and ball arithmetic. Exit code 3: not proved."""
    with _errors():
        from manyhands.launch.designing import run_verify

        _end(run_verify(certificate, None if session is None else load_named(session, []), out, err, as_json))


@app.command(epilog="Example: manyhands budget example1.yaml --plot budget.png")
def budget(
    session: SessionPath,
    picture: Annotated[
        Path | None, typer.Option("--plot", metavar="FILE", help="Draw it (.png, .svg or .pdf).")
    ] = None,
    overrides: Overrides = [],  # noqa: B006
    as_json: Json = False,
) -> None:
    """Show which stiffness each device could certify against the delay inside the tick and the period."""
    with _errors():
        from manyhands.launch.budget import require_picture
        from manyhands.launch.designing import run_budget

        loaded = load_named(session, overrides)
        if picture is not None:
            require_picture(picture)
        _end(run_budget(loaded, out, err, picture, as_json))


@app.command(epilog="Example: manyhands simulate example1.yaml --duration 5 -o run.npz")
def simulate(
    session: SessionPath,
    duration: Duration = 10.0,
    output: Annotated[
        Path | None, typer.Option("-o", metavar="FILE", help=f"Write every x and f_v here ({', '.join(SUFFIXES)}).")
    ] = None,
    overrides: Overrides = [],  # noqa: B006
    certificate: CertificatePath = None,
    uncertified: Uncertified = False,
) -> None:
    """Run the sampled-data loop in one process.

    No hand is shaken by a simulation: a session that cannot be certified is simulated with a warning.
    """
    with _errors():
        from rich.progress import Progress

        from manyhands.launch.simulation import Simulation

        loaded = load_named(session, overrides)
        ticks = _kept_ticks(loaded, duration)
        if output is not None:
            require_suffix(output)
        prepared = _prepare(loaded, certificate, uncertified=True)
        if prepared.certificate is None and not uncertified:
            say(err, f"warning: {loaded.name} is not certified; launch refuses it without --uncertified")
        simulation = Simulation(prepared)
        with Progress(console=err, transient=True) as bar:
            task = bar.add_task("simulating", total=ticks)
            recording = simulation.run(ticks, lambda done: bar.update(task, completed=done))
        if output is not None:
            recording.save(output)
            say(err, f"written to {output}")
        for name, device in simulation.devices.items():
            say(
                out,
                f"{name}: peak speed {device.peak_speed:.3g} m/s, speed at the end {device.speed:.3g} m/s, "
                f"ledger {device.ledger.total:.3g} J (least {device.ledger.minimum:.3g} J)",
            )


@app.command(epilog="Example: manyhands launch example1.yaml --duration 10 --record run.npz --report run.json")
def launch(
    session: SessionPath,
    duration: Annotated[
        float | None, typer.Option("--duration", metavar="S", help="How long to run, in s; without it, until Ctrl-C.")
    ] = None,
    clock: Clock = REALTIME,
    transport: Annotated[
        str, typer.Option(metavar="|".join(SCHEMES), help="How the processes talk (tcp: loopback).")
    ] = SCHEMES[0],
    record: Annotated[
        Path | None, typer.Option("--record", metavar="FILE", help=f"Keep every x and f_v ({', '.join(SUFFIXES)}).")
    ] = None,
    report: Annotated[Path | None, typer.Option("--report", metavar="FILE", help="Write the report (JSON).")] = None,
    overrides: Overrides = [],  # noqa: B006
    certificate: CertificatePath = None,
    uncertified: Uncertified = False,
) -> None:
    """Run every device, coupling and the environment as processes of their own, until --duration or Ctrl-C."""
    with _errors():
        from manyhands.launch.running import run_session

        _require_one_of("--clock", clock, CLOCKS)
        _require_one_of("--transport", transport, SCHEMES)
        loaded = load_named(session, overrides)
        ticks = 0 if duration is None else _ticks(loaded, duration)
        if record is not None:
            require_suffix(record)
        if report is not None:
            require_target(report)
        require_runnable(topology(loaded))
        prepared = _prepare(loaded, certificate, uncertified)
        outcome = run_session(
            prepared, err, clock=clock, transport=transport, ticks=ticks, record=record, report=report
        )
        print_report(out, outcome.report)
        _end(outcome.code)


@app.command(epilog="Example: manyhands demo -o out/demo")
def demo(
    output: Annotated[Path, typer.Option("-o", metavar="DIR", help="Where plots and report go.")] = Path("out/demo"),
    duration: Duration = 10.0,
    clock: Clock = REALTIME,
) -> None:
    """Design Example 1's coupling, run its seven processes, and draw the paper's Figs. 5-7."""
    with _errors():
        from manyhands.launch.demo import run_demo

        _require_one_of("--clock", clock, CLOCKS)
        _require_folder(output)
        shipped = {name: load_named(Path(f"{name}.yaml"), []) for name in DEMO_SESSIONS}
        code = run_demo(shipped, out, err, output, _kept_ticks(shipped["example1"], duration), clock)
        _end(code)


DEMO_SESSIONS = ("example1", "example1-centralised", "example1-uncoupled")


def _prepare(session: Session, certificate: Path | None, uncertified: bool) -> Prepared:
    from manyhands.launch.designing import telling

    with telling(err, "designing the coupling") as progress:
        return prepare(session, certificate, uncertified, progress)


def _ticks(session: Session, duration: float) -> int:
    """Number of ticks in ``duration`` (s)."""
    if not session.period <= duration <= 1e9:
        _refuse(f"--duration: found {duration:g} s; expected from one period, {session.period:g} s, to 1e9 s")
    return round(duration / session.period)


def _kept_ticks(session: Session, duration: float) -> int:
    """Number of ticks in ``duration`` (s) of a run that is kept in memory."""
    ticks, ports = _ticks(session, duration), len(session.ports)
    if ticks * ports > MOST_SIMULATED_VALUES:
        _refuse(
            f"--duration: found {duration:g} s, {ticks} ticks of {ports} ports; expected at most "
            f"{MOST_SIMULATED_VALUES // ports} ticks"
        )
    return ticks


def _require_one_of(option: str, value: str, valid: tuple[str, ...]) -> None:
    if value not in valid:
        _refuse(f"{option}: found {value!r}; expected {' or '.join(valid)}")


def _require_folder(path: Path | None) -> None:
    if path is not None and path.exists() and not path.is_dir():
        _refuse(f"{path}: found a file; expected the name of a folder")


def _end(code: int) -> None:
    if code:
        raise typer.Exit(code)


def _refuse(text: str) -> None:
    say(err, f"error: {text}")
    raise typer.Exit(EXIT_BAD_INPUT)


@contextmanager
def _errors() -> Iterator[None]:
    """Every error of ours as one message and its exit code; Ctrl-C as its own, whatever an import made of it."""
    try:
        try:
            yield
        finally:
            if _ctrl_c:
                raise SystemExit(EXIT_INTERRUPTED) from None
    except (SessionError, CertificateError, RecordingError, TargetError, LinkTooWide) as error:
        say(err, f"error: {error}")
        raise typer.Exit(EXIT_BAD_INPUT) from error
    except (NotCertified, DesignError) as error:
        say(err, f"error: {error}")
        raise typer.Exit(EXIT_NOT_CERTIFIED) from error
    except OSError as error:
        say(err, f"error: {error.filename or ''}: {error.strerror}")
        raise typer.Exit(EXIT_FAILED) from error
