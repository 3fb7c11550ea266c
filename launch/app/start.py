"""How a session starts, whoever starts it: its form, its delay, its certificates, and its run.

Each step is a function, and :func:`start` takes them in turn. Python takes the same steps and does something of its own
between them. A hosted session differs in three of them: a seat's delay is stated and not
measured, its certificates are kept from one start to the next, and its guests need their invitations.
"""

from __future__ import annotations

import shutil
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

from rich.console import Console

from manyhands.launch.app.design_report import progress_on
from manyhands.launch.app.risks import warn_insecure, warn_of_code
from manyhands.launch.app.session_run import run_session
from manyhands.launch.doctor import delay
from manyhands.launch.doctor.colocation import Where, settle_colocation
from manyhands.launch.doctor.profile import Profile, drop_profile, outlived
from manyhands.launch.doctor.rates import certified_lines
from manyhands.launch.look.display import say
from manyhands.launch.plan.engine import engine_lines, require_engine
from manyhands.launch.plan.feel import feel_lines, network_lines
from manyhands.launch.plan.hosts import by_hand, hosts_of, require_hosts_alone
from manyhands.launch.plan.keys import Keys, load_folder, make_keys
from manyhands.launch.plan.loop import NotCertified
from manyhands.launch.plan.plan import Plan
from manyhands.launch.plan.prepare import Prepared, must_measure, prepare, prepare_again
from manyhands.launch.plan.reach import IPC, Reach, ReachError, reach
from manyhands.launch.plan.seats import KEYS, invitations, keep_certificates, require_folder, seat_nodes
from manyhands.launch.plan.sites import with_kept_delay
from manyhands.launch.plan.topology import Topology, require_runnable
from manyhands.launch.run.options import Hosting, StartOptions
from manyhands.launch.run.outcome import Outcome
from manyhands.launch.run.supervised import claimed_files
from manyhands.launch.session import ENVIRONMENT, Session
from manyhands.launch.session.design import AUTO
from manyhands.nodes.kernel.bundle import REALTIME
from manyhands.nodes.recorder.format import CERTIFICATE_FILE
from manyhands.protocol.transport.zeromq import SCHEMES


@dataclass(frozen=True)
class SettledForm:
    """A session in the form in which it runs.

    Attributes:
        session: the session, which states whether couplings run in their devices' processes.
        ways: how its processes reach each other.
        reason: why they run there (:attr:`.Colocation.reason`); empty where there was no choice.
        stale: the names in the folder of a hosted session's keys that the session no longer has.
    """

    session: Session
    ways: Reach = IPC
    reason: str = ""
    stale: tuple[str, ...] = ()


@dataclass(frozen=True)
class SettledDelay:
    """A session with the delay that it is designed for.

    Attributes:
        session: the session.
        profile: this machine's for the session, kept or new; None where there is none, or none is of use.
        measured: whether the delay is this machine's, and not stated.
    """

    session: Session
    profile: Profile | None = None
    measured: bool = False


def settle_form(session: Session, options: StartOptions) -> SettledForm:
    """Settle which processes a session has, and how they reach each other; nothing is measured or designed.

    The folder of a hosted session is made, with the keys that it lacks.

    Raises:
        ReachError: the options contradict each other or the session.
        LinkTooWide, FactoryError: the session cannot run.
        KeyFileError, TargetError, OSError: the keys cannot be read or made.
    """
    hosting, transport = options.hosting, options.transport or SCHEMES[0]
    invited = bool(options.on or options.remote)
    observed = options.uncertified and options.listen is not None  # the id of such a run has the form in it
    where = Where.of(realtime=options.clock == REALTIME, elsewhere=invited or observed)
    session, reason = settle_colocation(session, Where.HOSTED if hosting else where, transport, not options.insecure)
    seats = frozenset[str]() if hosting is None else _seats(session)
    plan = Plan(session)
    require_runnable(plan.graph, len(session.observers))
    if ENVIRONMENT not in options.remote:
        require_engine(session)
    hosts = hosts_of(options.on, plan, options.remote)
    require_hosts_alone(hosts, options.transport, options.insecure, options.listen is not None)
    if hosts and shutil.which("ssh") is None:
        raise ReachError("--on needs ssh on PATH: install it, or start the nodes by hand (--remote)")
    keys, stale = _keys(session, options)
    ways = reach(
        plan,
        "tcp" if hosts else transport,
        insecure=options.insecure,
        keys=keys,
        listen=options.listen,
        remote=options.remote | seats,
        hosts=hosts,
        program=options.program,
    )
    return SettledForm(session, replace(ways, seats=seats), reason, stale)


def _seats(session: Session) -> frozenset[str]:
    """The nodes of all seats of a hosted session; a delay that is to be measured is of users without a seat."""
    seats, unknown = seat_nodes(session), _without_delay(session)
    if session.design.tau == AUTO and unknown is not None:
        raise ReachError(
            f"{session.name}: found design.tau: auto, which measures this machine alone, with the seat {unknown!r}; "
            f"expected couplings.{unknown}.wave_link.tau, the delay that the guest keeps to"
        )
    return seats


def _without_delay(session: Session) -> str | None:
    """The first coupling whose wave link states no delay."""
    return next((name for name, link in session.wave_links.items() if link.tau is None), None)


def _keys(session: Session, options: StartOptions) -> tuple[Keys | None, tuple[str, ...]]:
    """The session's keys where there is a folder of them, and the names in it that the session no longer has."""
    if options.hosting is None:
        return None if options.keys is None else load_folder(session, options.keys), ()
    require_folder(options.hosting.folder)
    folder = options.hosting.folder / KEYS
    made = make_keys(session, folder)
    return load_folder(session, folder), made.stale


def settle_delay(
    form: SettledForm, options: StartOptions, console: Console, warn: Callable[[str], object] | None = None
) -> SettledDelay:
    """Settle the delay that a session is designed for: stated, measured here now or before, or of its certificate.

    Args:
        form: the session in its form.
        options: how it is started.
        console: where a measurement is reported.
        warn: called with a sentence if the measurement cannot be kept; by default it is said on the console.

    Raises:
        ReachError: the delay is to be measured here, and nodes of other machines have it as well.
        ProbeFailed, ProbeInterrupted: nothing could be measured.
        NotCertified: the delay measured and the one that a device states are longer than a period together.
    """
    session, ways = form.session, form.ways
    measure = partial(
        delay.settle_delay,
        session,
        partial(say, console),
        warn or (lambda text: say(console, f"warning: {text}")),
        transport=ways.transport,
        encrypted=not options.insecure,
    )
    if options.hosting is not None:
        return _settle_beside_seats(session, options.hosting, measure, partial(say, console))
    if ways.remote and session.design.tau == AUTO and options.certificate is None:
        asked, expected = "--on", "one, or design.tau in seconds"
        if options.remote:
            asked, expected = "--remote", "the file that the invitation was made with"
        raise ReachError(
            f"{asked}: found design.tau: auto, which measures this machine alone, and no --certificate; expected "
            f"{expected}"
        )
    realtime = options.clock == REALTIME and not ways.remote
    designed = options.certificate is None and not (options.uncertified and session.design.tau is None)
    settled, profile = measure(realtime=realtime, designed=designed)
    return SettledDelay(settled, profile, designed and must_measure(session, realtime=realtime))


def _settle_beside_seats(
    session: Session,
    hosting: Hosting,
    measure: Callable[..., tuple[Session, Profile | None]],
    tell: Callable[[str], None],
) -> SettledDelay:
    """Settle the delay of the users without a seat; that of each seat is stated, for its guest keeps to it."""
    here = len(session.wave_links) < len(session.couplings)
    unknown = _without_delay(session)
    if here and unknown is not None and session.design.tau is None:
        tell(
            f"{session.name}: the delay of the users here is not measured, for {unknown} states no wave_link.tau; "
            f"state couplings.{unknown}.wave_link.tau, or design.tau"
        )
    if here and unknown is None and must_measure(session, realtime=True):
        measured, profile = measure(realtime=True)
        return SettledDelay(with_kept_delay(hosting.folder / CERTIFICATE_FILE, measured), profile)
    return SettledDelay(session.with_delay(session.latency) if session.design.tau == AUTO else session)


def prepare_settled(settled: SettledDelay, options: StartOptions, console: Console) -> Prepared:
    """Design a session, or prove its certificates again; what a hosted one is designed for is kept in its folder.

    Args:
        settled: the session with its delay.
        options: how it is started.
        console: where the progress of a design is shown.

    Raises:
        CertificateError: a certificate cannot be read.
        NotCertified: no certificate was found, and the run may not be uncertified; or one does not hold.
    """
    if options.hosting is not None:
        return _prepare_again(settled.session, options.hosting, console)
    try:
        with progress_on(console, "designing the coupling") as progress:
            return prepare(settled.session, options.certificate, options.uncertified, progress)
    except NotCertified as error:
        if not settled.measured:
            raise
        tau = f"{1e3 * (settled.session.design.stated_tau or 0.0):.3g} ms"
        when = "" if settled.profile is None else f" ({settled.profile.told(time.time())})"
        text = (
            f"{error}; the delay of {tau} is this machine's{when}: {delay.ANEW}; design.tau=0 asks for a certificate "
            "without any"
        )
        raise NotCertified(text) from error


def settle_and_prepare(
    form: SettledForm, options: StartOptions, console: Console, warn: Callable[[str], object] | None = None
) -> tuple[SettledDelay, Prepared]:
    """Settle the delay and design for it; where what was measured a while ago would refuse the session, measure anew.

    Args:
        form: the session in its form.
        options: how it is started.
        console: where measurements and the progress of a design are shown.
        warn: as for :func:`settle_delay`.

    Raises:
        ReachError, ProbeFailed, ProbeInterrupted: as :func:`settle_delay`.
        CertificateError, NotCertified: as :func:`prepare_settled`.
    """
    settled = settle_delay(form, options, console, warn)
    try:
        return settled, prepare_settled(settled, options, console)
    except NotCertified:
        profile = settled.profile if settled.measured else None
        if profile is None or not delay.outdated(profile, form.session, partial(say, console)):
            raise
    return settle_and_prepare(form, options, console, warn)  # it measures: nothing is kept now


def _prepare_again(session: Session, hosting: Hosting, console: Console) -> Prepared:
    """The session under the certificates that are kept; what has changed since is designed anew, and kept as well."""
    kept = hosting.folder / CERTIFICATE_FILE
    if kept.exists():
        with progress_on(console, "designing what has changed") as progress:
            prepared, renewed = prepare_again(session, kept, progress)
        if renewed:
            changed = ", ".join(renewed)
            say(console, f"{hosting.folder}: designed anew, for the session has changed: {changed}")
    else:
        with progress_on(console, "designing the coupling") as progress:
            prepared, renewed = prepare(session, progress=progress), (session.name,)
    if renewed:
        keep_certificates(prepared, hosting.folder)
    return prepared


def announce(
    prepared: Prepared, form: SettledForm, settled: SettledDelay, options: StartOptions, console: Console
) -> None:
    """Say what a run is certified for, why it has its form, whose code it runs, and whom it waits for.

    Raises:
        ReachError: guests are to reach it at ports that are not free.
    """
    session, ways = form.session, form.ways
    measurable = options.hosting is None or len(session.wave_links) < len(session.couplings)
    if options.clock == REALTIME and measurable:
        for line in certified_lines(prepared, settled.session, settled.profile, time.time()):
            say(console, line)
    engine = () if ENVIRONMENT in options.remote else engine_lines(session)
    for line in (*feel_lines(session, prepared.certificates), *network_lines(session, options.clock), *engine):
        say(console, line)
    if form.reason:
        say(console, f"{session.name}: {form.reason}")
    if options.hosting is not None:
        _invite(prepared, form, options.hosting, console)
    warn_of_code(console, session, ways.remote - ways.hosts.keys())
    for name in sorted(ways.remote - ways.seats):
        if name in ways.hosts:
            say(console, f"{name}: started on {ways.hosts[name]} by ssh")
        elif ways.listen.port:
            say(console, f"{name} is awaited; on its machine: {by_hand(name, f'tcp://{ways.listen}')}")


def _why_not_free(host: str, port: int, kind: socket.SocketKind) -> str | None:
    """Why a port cannot be bound; None where it can."""
    with socket.socket(type=kind) as probe:
        if kind is socket.SOCK_STREAM:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # as ZeroMQ: those of a run before are free
        try:
            probe.bind((host, port))
        except OSError as error:
            return str(error.strerror)
    return None


def _require_free(host: str, first: int, last: int) -> None:
    """Refuse to invite anybody to ports that another program has.

    Raises:
        ReachError: one of them cannot be bound.
    """
    for port in range(first, last + 1) if first else ():
        if (why := _why_not_free(host, port, socket.SOCK_STREAM)) is not None:
            raise ReachError(
                f"--listen: found {host}:{port}, which cannot be bound ({why}); expected an address of "
                f"this machine whose ports {first} to {last} are free"
            )


def _say_without_datagrams(ways: Reach, session: Session, graph: Topology, console: Console) -> None:
    """Say so where the waves of guests cannot have the UDP port that they would take."""
    port = ways.datagram_port(graph, session.wave_links)
    if port and (why := _why_not_free(ways.listen.host, port, socket.SOCK_DGRAM)) is not None:
        say(
            console,
            f"! the UDP port {port} cannot be bound ({why}): the waves of guests go by TCP, where a lost packet delays "
            "all that follow; free it, or take another port (--listen), and start again",
        )


def _invite(prepared: Prepared, form: SettledForm, hosting: Hosting, console: Console) -> None:
    """Write the invitation of every seat, and say how its guest gets it, and which ports guests need."""
    ways, graph = form.ways, prepared.graph
    if ways.keys is None:
        raise AssertionError("a hosted session has keys")
    first = ways.listen.port
    last = first + len(graph.links) + len(form.session.observers)
    _require_free(ways.listen.host, first, last)
    for seat, invitation in invitations(prepared, ways.keys, hosting.address).items():
        path = hosting.folder / f"{seat}.invitation"
        invitation.save(path)
        if console.is_terminal:  # where it is kept in a log, an invitation may not be
            say(console, f"waiting for {seat}: send this line over a secure channel; there: manyhands join")
            console.print(invitation.line, markup=False, emoji=False, soft_wrap=True)  # in one piece, to be copied
        else:
            say(console, f"waiting for {seat}: send {path} over a secure channel; there: manyhands join {path.name}")
    say(console, f"listening at {ways.listen}; guests need its ports {first} to {last}, of TCP and of UDP")
    _say_without_datagrams(ways, form.session, graph, console)
    if form.stale:
        say(console, f"{hosting.folder / KEYS}: holds keys that the session no longer has: {', '.join(form.stale)}")


def drop_outlived(
    form: SettledForm, settled: SettledDelay, outcome: Outcome, options: StartOptions, console: Console
) -> None:
    """Forget what was measured of this machine, where the run has shown that it does not hold."""
    profile, session = settled.profile, form.session
    nodes = {name: node for name, node in outcome.report["nodes"].items() if name not in form.ways.remote}
    if profile is not None and outlived(profile, session, nodes):
        drop_profile(profile)
        what = "launch" if options.hosting is None else "host"
        given = "" if options.certificate is None else " without a certificate's file"
        say(
            console,
            f"{session.name}: the delays were not those measured before; the next {what}{given} measures them anew",
        )


def start(
    session: Session,
    options: StartOptions,
    console: Console,
    designed: Callable[[Prepared], None] = lambda _prepared: None,
) -> Outcome:
    """Start a session, and run it to its end.

    Args:
        session: the session.
        options: how it is started.
        console: where progress, notices and faults go.
        designed: called with the session and its certificates, before it runs.

    Raises:
        RecordingError, TargetError, OSError: a file cannot be written.
        ReachError, LinkTooWide, FactoryError, KeyFileError: as :func:`settle_form`.
        ProbeFailed, ProbeInterrupted: as :func:`settle_delay`.
        CertificateError, NotCertified: as :func:`prepare_settled`.
    """
    with claimed_files(options):
        form = settle_form(session, options)
        if options.insecure:
            warn_insecure(console)
        settled, prepared = settle_and_prepare(form, options, console)
        designed(prepared)
        announce(prepared, form, settled, options, console)
        outcome = run_session(prepared, console, form.ways, options)
        drop_outlived(form, settled, outcome, options, console)
        return outcome
