"""What the commands share: consoles, options, shell completion, and one message and exit code for every error.

Completion runs at every press of Tab. Names of running sessions, topics, session files and nodes therefore come from
files, and no session is contacted. Where a file cannot be read, there is no completion and no error message.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Annotated, NoReturn

import typer
from rich.console import Console

from manyhands.design.errors import CertificateError, DesignError
from manyhands.extras import MissingExtra, explained, require
from manyhands.launch.doctor.profile import ProbeFailed, ProbeInterrupted
from manyhands.launch.files import EXIT_BAD_INPUT, EXIT_FAILED, EXIT_INTERRUPTED, EXIT_NOT_CERTIFIED, TargetError
from manyhands.launch.look.display import could_help, say
from manyhands.launch.look.page.security import ViewError
from manyhands.launch.look.sessions import NoSession, find_session
from manyhands.launch.look.topics import NoTopic, named_topics, session_of
from manyhands.launch.plan.loop import NotCertified
from manyhands.launch.plan.reach import ReachError
from manyhands.launch.plan.sites import IN_TICK
from manyhands.launch.plan.topology import LinkTooWide
from manyhands.launch.recordings.recording import RecordingError
from manyhands.launch.run.running import running_sessions
from manyhands.launch.session import ENVIRONMENT, SUPERVISOR, Session, SessionError
from manyhands.launch.session.session import whole_ticks
from manyhands.launch.session.shipped import load_named, shipped_sessions
from manyhands.nodes.device.plugin import DriverFailure
from manyhands.nodes.environment.model import ModelFailure
from manyhands.nodes.kernel.bundle import CLOCKS
from manyhands.nodes.kernel.factory import FactoryError
from manyhands.protocol.keys import KeyFileError
from manyhands.protocol.transport import TransportError

_MOST = 500  # completions


def one_word_of(words: Iterable[str]) -> Callable[[str], list[str]]:
    """The completion of an option that takes one of these words."""
    known = tuple(words)

    def complete(incomplete: str) -> list[str]:
        return _that_begin_with(incomplete, known)

    return complete


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
    names = [f"{name}.yaml" for name in shipped_sessions()]
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


def shipped_names(incomplete: str) -> list[str]:
    """The names of shipped sessions."""
    return _that_begin_with(incomplete, shipped_sessions())


def node_names(ctx: typer.Context, incomplete: str) -> list[str]:
    """Nodes and observers of the session file that stands earlier on the command line."""
    loaded = _named_session(ctx)
    return [] if loaded is None else _that_begin_with(incomplete, [*loaded.roles, *loaded.observers])


def _named_session(ctx: typer.Context) -> Session | None:
    """The session whose file stands earlier on the command line, if it can be read."""
    path = ctx.params.get("session")
    try:
        return None if path is None else load_named(path, ctx.params.get("overrides") or [])
    except (SessionError, OSError):
        return None


def placed_node_names(ctx: typer.Context, incomplete: str) -> list[str]:
    """Nodes of the session file that stands earlier on the command line, each with the sign before its machine."""
    return [f"{name}=" for name in node_names(ctx, incomplete)]


def session_keys(ctx: typer.Context, incomplete: str) -> list[str]:
    """The keys of single values in the session file that stands earlier on the command line, each with the sign = ."""
    loaded = _named_session(ctx)
    return [] if loaded is None else [f"{key}=" for key in _that_begin_with(incomplete, _keys("", loaded.as_plain()))]


def _keys(prefix: str, tree: Mapping[str, object]) -> Iterator[str]:
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from _keys(f"{prefix}{key}.", value)
        else:
            yield f"{prefix}{key}"


def part_names(ctx: typer.Context, incomplete: str) -> list[str]:
    """The parts of the session file that stands earlier on the command line, each of which has a certificate."""
    loaded = _named_session(ctx)
    parts = [] if loaded is None else [*loaded.wave_links, IN_TICK, ENVIRONMENT]
    return _that_begin_with(incomplete, parts)


def key_names(ctx: typer.Context, incomplete: str) -> list[str]:
    """The processes that have a key of their own, in the session file that stands earlier on the command line."""
    return [*node_names(ctx, incomplete), *_that_begin_with(incomplete, [SUPERVISOR])]


def _that_begin_with(incomplete: str, names: Iterable[str]) -> list[str]:
    return [name for name in names if name.startswith(incomplete)][:_MOST]


_NO_TERMINAL_WIDTH = 140  # columns, for tables in a file or a pipe, unless COLUMNS states others


class _Console(Console):
    def on_broken_pipe(self) -> None:
        """Raise BrokenPipeError, so that the command decides what a closed pipe means."""
        raise BrokenPipeError


def _console(stderr: bool) -> Console:
    console = _Console(stderr=stderr, highlight=False, soft_wrap=True)
    if console.is_terminal:
        return console
    stated = os.environ.get("COLUMNS", "")
    width = int(stated) if stated.isdecimal() and int(stated) else _NO_TERMINAL_WIDTH
    return _Console(stderr=stderr, highlight=False, width=width)


out, err = _console(stderr=False), _console(stderr=True)

SessionPath = Annotated[
    Path,
    typer.Argument(
        metavar="SESSION", help="A session file, or the name of a shipped one.", autocompletion=session_files
    ),
]
Overrides = Annotated[
    list[str],
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Override a value of the session; repeatable.",
        autocompletion=session_keys,
    ),
]
RunningName = Annotated[
    str | None,
    typer.Option(
        "--running",
        metavar="NAME",
        help="A running session, by its name or process id; by default the only one.",
        autocompletion=running_names,
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]
Duration = Annotated[float, typer.Option("--duration", metavar="S", help="How long to run, in s.")]
MostDuration = Annotated[
    float | None, typer.Option("--duration", metavar="S", help="How long to run, in s; without it, until Ctrl-C.")
]
ReportFile = Annotated[Path | None, typer.Option("--report", metavar="FILE", help="Write the report (JSON).")]
Clock = Annotated[
    str,
    typer.Option(
        metavar="|".join(CLOCKS), help="The clock that paces the session.", autocompletion=one_word_of(CLOCKS)
    ),
]
CertificatePath = Annotated[
    Path | None, typer.Option("--certificate", metavar="CERT", help="Run under this certificate instead of designing.")
]
Uncertified = Annotated[bool, typer.Option("--uncertified", help="Run even if nothing proves the session stable.")]


def time_of(option: str, text: str) -> float:
    """A time in s from a text such as 40ms, 0.04s or 0.04."""
    return _amount(option, text, {"ms": 1e-3, "us": 1e-6, "s": 1.0}, "a time, such as 40ms or 0.04 (s)")


def part_of(option: str, text: str) -> float:
    """A part from a text such as 2% or 0.02."""
    return _amount(option, text, {"%": 0.01}, "a part, such as 2% or 0.02")


def _amount(option: str, text: str, units: Mapping[str, float], expected: str) -> float:
    number, factor = text.strip(), 1.0
    for unit, value in units.items():
        if number.endswith(unit):
            number, factor = number.removesuffix(unit), value
            break
    try:
        return round(float(number) * factor, 12)
    except ValueError:
        refuse(f"{option}: found {text!r:.40}; expected {expected}")


Delay = Annotated[
    str | None,
    typer.Option("--delay", metavar="TIME", help="Simulate a network on every wave link: one way, such as 40ms."),
]
Jitter = Annotated[
    str | None, typer.Option("--jitter", metavar="TIME", help="Of that network: by how much a wave is later at most.")
]
Loss = Annotated[str | None, typer.Option("--loss", metavar="PART", help="Of that network: lost waves, such as 2%.")]


def load_with_network(
    path: Path, overrides: list[str], delay: str | None, jitter: str | None, loss: str | None
) -> Session:
    """The session, with the network of these options on every wave link; as it is without any of them.

    Raises:
        SessionError: it cannot be read, or a number of the network is out of its range.
    """
    session = load_named(path, overrides)
    given = {"delay": (delay, time_of, "40ms"), "jitter": (jitter, time_of, "10ms"), "loss": (loss, part_of, "2%")}
    network = [f"{name}: {read(f'--{name}', text)!r}" for name, (text, read, _) in given.items() if text is not None]
    if not network:
        return session
    if not session.wave_links:
        coupling, there = next(iter(session.couplings)), 2.0 * time_of("--delay", delay or "50ms")
        refuse(
            f"--{network[0].partition(':')[0]}: found a session without a wave link; expected one, for a delay inside "
            f"the tick is design.tau: --set 'couplings.{coupling}.wave_link={{mass: 0.5, round_trip: {there:g}}}'"
        )
    stated = "{" + ", ".join(network) + "}"
    more = [f"couplings.{name}.wave_link.network={stated}" for name in session.wave_links]
    try:
        return load_named(path, [*overrides, *more])
    except SessionError as error:
        if (option := error.key.rpartition(".")[2]) not in given:
            raise
        text, _, example = given[option]
        refuse(f"--{option}: found {text!r}; expected {error.expected}, such as {example}")


KeyFolder = Annotated[
    Path | None,
    typer.Option("--keys", metavar="DIR", help="The folder of the session's keys (manyhands invite); tcp only."),
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


def ticks_of(session: Session, duration: float, *, kept: bool = False) -> int:
    """Number of ticks in ``duration`` (s); ``kept`` for a run whose values are kept in memory."""
    try:
        return whole_ticks(session, duration, kept=kept)
    except ValueError as error:
        refuse(f"--duration: {error}")


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


def refuse(text: str) -> NoReturn:
    """End the command with this error message and exit code 2."""
    say(err, f"error: {text}")
    raise typer.Exit(EXIT_BAD_INPUT)


_BAD_INPUT = (
    CertificateError,
    MissingExtra,
    KeyFileError,
    LinkTooWide,
    FactoryError,
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
def errors(*needed: str) -> Iterator[None]:
    """Turn every expected error into one message and its exit code, and Ctrl-C into exit code 130.

    Args:
        needed: the extras that the command needs in every case; without them it ends before it begins.
    """
    try:
        try:
            require(*needed)
            with explained():
                yield
        finally:
            if ctrl_c:  # even where an import has turned the SystemExit into an error of its own
                raise SystemExit(EXIT_INTERRUPTED) from None
    except _BAD_INPUT as error:
        say(err, f"error: {error}")
        raise typer.Exit(EXIT_BAD_INPUT) from error
    except (NotCertified, DesignError) as error:
        say(err, f"error: {error}")
        could_help(err, error if isinstance(error, DesignError) else error.__cause__)
        raise typer.Exit(EXIT_NOT_CERTIFIED) from error
    except ProbeInterrupted as error:
        raise typer.Exit(128 + error.signal) from error
    except ProbeFailed as error:
        say(err, f"error: the delay of a tick could not be measured: {error}; state one, such as design.tau=0.0005")
        raise typer.Exit(EXIT_FAILED) from error
    except (DriverFailure, ModelFailure) as error:
        say(err, f"error: {error}")
        raise typer.Exit(EXIT_FAILED) from error
    except OSError as error:
        place = "" if error.filename is None else f"{error.filename}: "
        say(err, f"error: {place}{error.strerror or error}")
        raise typer.Exit(EXIT_FAILED) from error
