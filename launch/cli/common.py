"""What the commands share: consoles, options, shell completion, and one message and exit code for every error.

Completion runs at every press of Tab. Names of running sessions, topics, session files and nodes therefore come from
files, and no session is contacted. Where a file cannot be read, there is no completion and no error message.
"""

from __future__ import annotations

import importlib.resources
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from manyhands.design.certificate import unrecorded
from manyhands.design.errors import CertificateError, DesignError
from manyhands.launch.files import (
    EXIT_BAD_INPUT,
    EXIT_FAILED,
    EXIT_INTERRUPTED,
    EXIT_NOT_CERTIFIED,
    TargetError,
    load_named,
)
from manyhands.launch.observe.sessions import NoSession, find_session, running_sessions
from manyhands.launch.observe.topics import NoTopic, named_topics, session_of
from manyhands.launch.plan.plan import Plan
from manyhands.launch.plan.prepare import NotCertified, Prepared, must_measure, prepare
from manyhands.launch.plan.reach import ReachError
from manyhands.launch.plan.topology import LinkTooWide, require_runnable
from manyhands.launch.recordings.recording import RecordingError
from manyhands.launch.run.display import say
from manyhands.launch.session import PythonEnvironment, Session, SessionError
from manyhands.launch.session.design import AUTO
from manyhands.launch.view.security import ViewError
from manyhands.nodes.bundle import CLOCKS
from manyhands.nodes.environment.model import ModelError, ModelFailure
from manyhands.protocol.keys import KeyFileError
from manyhands.protocol.transport import TransportError

if TYPE_CHECKING:
    from manyhands.launch.doctor.profile import Profile

_MOST = 500  # completions


def running_names(incomplete: str) -> list[str]:
    """Names of running sessions; where several have the same name, their process ids instead."""
    running = [one.about for one in running_sessions()]
    names = [about.session for about in running]
    return _that_begin_with(
        incomplete, (str(one.pid) if names.count(one.session) > 1 else one.session for one in running)
    )


def topic_names(ctx: typer.Context, incomplete: str) -> list[str]:
    """Topics of the named or only session; with their full path where ``incomplete`` begins with a slash."""
    try:
        about = find_session(ctx.params.get("session") or session_of(incomplete)).about
    except NoSession:
        return []
    topics = named_topics(about)
    if incomplete.startswith("/"):
        return _that_begin_with(incomplete, (named.full for named in topics.values()))
    return _that_begin_with(incomplete, topics)


def session_files(incomplete: str) -> list[str]:
    """Session files and folders that complete the path, and the shipped sessions."""
    shipped = importlib.resources.files("manyhands.launch") / "sessions"
    names = sorted(file.name for file in shipped.iterdir() if file.name.endswith(".yaml"))
    folder, _, start = incomplete.rpartition("/")
    prefix = f"{folder}/" if "/" in incomplete else ""
    try:
        entries = sorted(Path(prefix or ".").expanduser().iterdir())
    except OSError:
        entries = []
    here = []
    for path in entries:
        if path.name.startswith(".") and not start.startswith("."):
            continue
        if path.suffix in (".yaml", ".yml"):
            here.append(f"{prefix}{path.name}")
        elif path.is_dir():
            here.append(f"{prefix}{path.name}/")
    return _that_begin_with(incomplete, dict.fromkeys([*here, *names]))


def node_names(ctx: typer.Context, incomplete: str) -> list[str]:
    """Nodes and observers of the session file that stands earlier on the command line."""
    session = ctx.params.get("session")
    if session is None:
        return []
    try:
        loaded = load_named(session, ctx.params.get("overrides") or [])
    except (SessionError, OSError):
        return []
    return _that_begin_with(incomplete, [*loaded.roles, *loaded.observers])


def _that_begin_with(incomplete: str, names: Iterable[str]) -> list[str]:
    return [name for name in names if name.startswith(incomplete)][:_MOST]


MOST_SIMULATED_VALUES = 100_000_000  # ticks x ports kept in memory, 1.6 GB

_NO_TERMINAL_WIDTH = 140  # columns, for tables in a file or a pipe


class _Console(Console):
    def on_broken_pipe(self) -> None:
        """Raise BrokenPipeError, so that the command decides what a closed pipe means."""
        raise BrokenPipeError


def _console(stderr: bool) -> Console:
    console = _Console(stderr=stderr, highlight=False, soft_wrap=True)
    return console if console.is_terminal else _Console(stderr=stderr, highlight=False, width=_NO_TERMINAL_WIDTH)


out, err = _console(stderr=False), _console(stderr=True)

SessionPath = Annotated[
    Path,
    typer.Argument(
        metavar="SESSION", help="A session file, or the name of a shipped one.", autocompletion=session_files
    ),
]
Overrides = Annotated[
    list[str], typer.Option("--set", metavar="KEY=VALUE", help="Override a value of the session; repeatable.")
]
RunningName = Annotated[
    str | None,
    typer.Option(
        "--session",
        metavar="NAME",
        help="A running session, by its name or process id; by default the only one.",
        autocompletion=running_names,
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]
Duration = Annotated[float, typer.Option("--duration", metavar="S", help="How long to run, in s.")]
Clock = Annotated[str, typer.Option(metavar="|".join(CLOCKS), help="The clock that paces the session.")]
CertificatePath = Annotated[
    Path | None, typer.Option("--certificate", metavar="CERT", help="Run under this certificate instead of designing.")
]
Uncertified = Annotated[bool, typer.Option("--uncertified", help="Run even if nothing proves the session stable.")]


KeyFolder = Annotated[
    Path | None, typer.Option("--keys", metavar="DIR", help="The session's keys (manyhands keys); tcp only.")
]
Insecure = Annotated[
    bool,
    typer.Option("--insecure", help="Use TCP without encryption: anybody who can reach its ports can take part."),
]
ctrl_c: list[int] = []  # the signals that came: foreign code may catch the exception on its way up


def unwind(signum: int, _frame: FrameType | None) -> None:
    """Handle Ctrl-C: note the signal, and unwind the stack."""
    ctrl_c.append(signum)
    raise SystemExit(EXIT_INTERRUPTED)


def prepare_session(session: Session, certificate: Path | None, uncertified: bool) -> Prepared:
    """Settle the coupling of a run; print the design's progress, and what a certificate's file does not record."""
    from manyhands.launch.design_report import progress_on

    with progress_on(err, "designing the coupling") as progress:
        prepared = prepare(session, certificate, uncertified, progress)
    if prepared.certificate is not None and (lack := unrecorded(prepared.certificate)):
        say(err, f"{certificate}: {lack}")
    return prepared


def settle_delay(
    session: Session, *, realtime: bool, designed: bool = True, transport: str = "ipc", encrypted: bool = True
) -> tuple[Session, Profile | None]:
    """The session with the delay that it is to be designed for, measured on this machine where it has to be.

    Args:
        session: the session.
        realtime: as for :func:`must_measure`.
        designed: whether a coupling is to be designed; otherwise the session stays as it is.
        transport: "ipc" or "tcp".
        encrypted: whether links over "tcp" are encrypted.

    Returns:
        The session, and this machine's profile for it, kept or new; None where there is none, or none is of use.
    """
    wanted = designed and must_measure(session, realtime=realtime)
    if designed and not wanted and session.design.tau == AUTO:
        session = session.with_delay(0.0)  # it has no coupling
    if not (realtime or wanted):
        return session, None
    from manyhands.launch.doctor.probe import PROFILE_TIME, ProbeFailed, ProbeInterrupted, Way, measure_profile
    from manyhands.launch.doctor.profile import allowance, keep_profile, kept_profile

    plan = Plan(session)
    way = Way.of_run(plan, transport, encrypted)
    profile = kept_profile(way.profile_key(plan), time.time())
    if not wanted:
        return session, profile
    if profile is None:
        require_runnable(plan.graph)
        say(err, f"{session.name}: measuring the delay of a tick on this machine for {PROFILE_TIME:g} s")
        try:
            profile = measure_profile(plan, way)
        except ProbeInterrupted as error:
            raise typer.Exit(128 + error.signal) from error
        except ProbeFailed as error:
            say(err, f"error: the delay of a tick could not be measured: {error}; state one, such as design.tau=0.0005")
            raise typer.Exit(EXIT_FAILED) from error
        try:
            keep_profile(profile)
        except OSError as error:
            say(err, f"warning: the measurement is not kept: {error.filename}: {error.strerror}")
    chosen = allowance(profile, session.device_period)
    return session.with_delay(chosen.tau, chosen.period_tolerance), profile


def ticks_of(session: Session, duration: float) -> int:
    """Number of ticks in ``duration`` (s)."""
    if not session.period <= duration <= 1e9:
        refuse(f"--duration: found {duration:g} s; expected from one period, {session.period:g} s, to 1e9 s")
    return round(duration / session.period)


def kept_ticks(session: Session, duration: float) -> int:
    """Number of ticks in ``duration`` (s) of a run whose values are kept in memory."""
    ticks, ports = ticks_of(session, duration), len(session.ports)
    if ticks * ports > MOST_SIMULATED_VALUES:
        refuse(
            f"--duration: found {duration:g} s, {ticks} ticks of {ports} ports; expected at most "
            f"{MOST_SIMULATED_VALUES // ports} ticks"
        )
    return ticks


def require_one_of(option: str, value: str, valid: tuple[str, ...]) -> None:
    """End the command with an error unless the option's value is one of the valid ones."""
    if value not in valid:
        refuse(f"{option}: found {value!r}; expected {' or '.join(valid)}")


def require_folder(path: Path | None) -> None:
    """End the command with an error if there is a file where a folder is to be made."""
    if path is not None and path.exists() and not path.is_dir():
        refuse(f"{path}: found a file; expected the name of a folder")


def end(code: int) -> None:
    """End the command with this exit code."""
    if code:
        raise typer.Exit(code)


def refuse(text: str) -> None:
    """End the command with this error message and exit code 2."""
    say(err, f"error: {text}")
    raise typer.Exit(EXIT_BAD_INPUT)


def warn_of_model(console: Console, session: Session) -> None:
    """Warn that a run imports and executes the code of a model, if the session names one."""
    if isinstance(session.environment, PythonEnvironment):
        say(
            console,
            f"{session.name}: runs the code of the model {session.environment.model}, which is not confined; run only "
            "models from people you trust",
        )


def warn_insecure(console: Console) -> None:
    """Warn in red that a run is open to everybody on the network."""
    console.print(
        "warning: --insecure: nothing is encrypted and nobody proves who they are; anybody who can reach these ports "
        "can read every motion and push every hand",
        style="bold red",
        markup=False,
        soft_wrap=True,
    )


_BAD_INPUT = (
    CertificateError,
    KeyFileError,
    LinkTooWide,
    ModelError,
    NoSession,
    NoTopic,
    ReachError,
    RecordingError,
    SessionError,
    TargetError,
    TransportError,  # the address to listen at is not this machine's, or not free
    ViewError,
)


@contextmanager
def errors() -> Iterator[None]:
    """Turn every expected error into one message and its exit code, and Ctrl-C into exit code 130."""
    try:
        try:
            yield
        finally:
            if ctrl_c:  # even where an import has turned the SystemExit into an error of its own
                raise SystemExit(EXIT_INTERRUPTED) from None
    except _BAD_INPUT as error:
        say(err, f"error: {error}")
        raise typer.Exit(EXIT_BAD_INPUT) from error
    except (NotCertified, DesignError) as error:
        say(err, f"error: {error}")
        raise typer.Exit(EXIT_NOT_CERTIFIED) from error
    except ModelFailure as error:
        say(err, f"error: {error}")
        raise typer.Exit(EXIT_FAILED) from error
    except OSError as error:
        place = "" if error.filename is None else f"{error.filename}: "
        say(err, f"error: {place}{error.strerror or error}")
        raise typer.Exit(EXIT_FAILED) from error
