"""Checks a recorded run against its certificate, offline: every ledger is computed anew from the recorded signals.

The file alone is enough; no party has to be trusted. Its session and certificate are read as their own files are, and
the certificate is proved again. It has to be this session's. Then each party's part is computed from the signals that
the others sent it, by the arithmetic of the nodes. The result is compared with what the party recorded itself:

| party | from | follows |
|---|---|---|
| device | the forces that it exerted, and its hand | x, its ledger |
| device in wall time | the forces of its couplings, its hand, s_k and a_k | the same, the exerted force, e_k |
| coupling | x of its devices, f_v from the environment | p, its ledger |
| environment | p of all couplings | x_e, q, f_v, its ledger |

Signals that two parties recorded are compared as well. So a number that was changed afterwards contradicts others at
its own tick. What a recording does not hold is not claimed: each check lists the ticks that it does not cover, with the
reason.

Some checks need no state of a party. The force that a coupling handed on is the force that its devices exerted. A tool
is where its coupling's end is. The total in a node's figures is the last of its trace. A ledger never falls below where
it began. No device exceeds its limits.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from manyhands.design.errors import CertificateError
from manyhands.launch.plan import bundles as cutting
from manyhands.launch.plan.bundles import mass_names
from manyhands.launch.plan.plan import Plan
from manyhands.launch.plan.prepare import UNCERTIFIED, NotCertified, Prepared, prepare
from manyhands.launch.recordings.audit_coupling import recompute_coupling
from manyhands.launch.recordings.audit_device import ROUNDING as FREE_ROUNDING
from manyhands.launch.recordings.audit_device import WallRows, recompute_device, recompute_in_wall_time
from manyhands.launch.recordings.audit_environment import ROUNDING, Blocks, increments, recompute_environment
from manyhands.launch.recordings.events import Course, course_of, sent_no_force
from manyhands.launch.recordings.findings import (
    EXACT,
    Check,
    CheckVerdict,
    Recomputed,
    UncheckedTicks,
    compare,
    first_of,
)
from manyhands.launch.recordings.recording import RecordingError
from manyhands.launch.recordings.replay import hand_of
from manyhands.launch.recordings.run import RecordedRun, changed_after, first_sign, rows_of, there
from manyhands.launch.session import Session, SessionError, load_session
from manyhands.launch.session.session import ENVIRONMENT
from manyhands.nodes import telemetry as names
from manyhands.nodes.bundle import SIMULATED, WALL, CouplingBundle, DeviceBundle, EnvironmentBundle
from manyhands.nodes.device.core import Guard
from manyhands.nodes.device.telemetry import longest_period
from manyhands.nodes.environment.clutch import LET_GO
from manyhands.nodes.recorder.format import CERTIFICATE_FILE, SESSION_FILE

Array = NDArray[np.float64]

_EPSILON = float(np.finfo(np.float64).eps)

LEDGER_ROUNDING = 1e-12
"""A ledger may be below its bound by this part of all the work in its increments, which is rounding."""

FREE_SUMS: Final = (
    f"{FREE_ROUNDING:g} units in the last place of the energy exchanged so far for each free period, since the order "
    "of the sums differs; exact before the first"
)

_LIMITS = "no tolerance: the node itself compares with this limit"


def forces_agree(run: RecordedRun, blocks: Blocks, forces: Array) -> list[Check]:
    """For each coupling: the force that it handed on is the force that its devices exerted."""
    what = "the force that it handed on is the one that its devices exerted"
    ports = run.recorded.ports
    return [
        compare("agreement", name, what, ports[name], blocks.f[:, own], forces[:, own])
        for name, own in blocks.ports.items()
    ]


def tools_agree(blocks: Blocks, columns: tuple[str, ...], party: str, tools: Array, sign: tuple[int, str]) -> Check:
    """Tools are at x_e = p + D_V f_v, as long as no clutch has moved."""
    ends, size = blocks.ends()
    begin, why = sign
    ends[begin:] = np.nan
    ends[blocks.clipped] = np.nan
    gaps = [UncheckedTicks(begin, len(tools), f"{why}, and a clutch may have moved")] if begin < len(tools) else []
    tolerance = ROUNDING * _EPSILON * np.where(np.isnan(size), 0.0, size)
    source = f"{ROUNDING:g} units in the last place of |p| + |D_V| |f_v|, since the order of the sums differs"
    what = "tools are at p + D_V f_v, as the couplings recorded them"
    return compare("agreement", party, what, columns, tools, ends, gaps=gaps, tolerance=tolerance, source=source)


def figures_agree(run: RecordedRun, node: str) -> Check:
    """The ledger's total in the figures is the last of the trace before them.

    Figures before a gap, or at a run's end in real time, are not compared: they may count free periods that have no
    row.
    """
    trace = rows_of(run, node, names.LEDGER)
    reported = np.full_like(trace, np.nan)
    last = len(reported) if run.recorded.clock == SIMULATED else len(reported) - 1
    for tick, figures in run.figures.get(node, ()):
        if 0 < tick <= last and (tick == len(reported) or np.isfinite(trace[tick, 0])):
            reported[tick - 1] = figures.get(names.LEDGER, np.nan)
    return compare("figures", node, "the ledger's total in its figures is that of its trace", ("E",), trace, reported)


def bounded(run: RecordedRun, node: str, allowed: float = 0.0) -> Check:
    """A ledger of ``node`` is never below 0. It includes the work of every hand, a person's at a browser as well.

    Args:
        run: the recording.
        node: its name.
        allowed: how far the ledger may fall below 0, J: of a device in wall time, its tank.

    Returns:
        The check; nothing was checked where no ledger was kept.
    """
    trace = rows_of(run, node, names.LEDGER)
    total = trace[np.isfinite(trace)]
    work = float(np.abs(np.diff(total, prepend=0.0)).sum())
    tolerance = LEDGER_ROUNDING * work
    bound = f"-{allowed:g} J, its tank" if allowed else "0"
    what = f"its ledger never fell below {bound}: it kept its promise"
    source = f"{LEDGER_ROUNDING:g} of the sum of its increments' magnitudes: rounding"
    wrong = trace < -allowed - tolerance
    first = first_of(wrong, ("E",), trace, np.full_like(trace, 0.0 - allowed))
    verdict = CheckVerdict.BROKEN if first is not None else CheckVerdict.HOLDS if len(total) else CheckVerdict.UNCHECKED
    remark = f"least {min(0.0, float(total.min())):.6g} J" if len(total) else ""
    return Check(
        "bound",
        node,
        what,
        verdict,
        len(total),
        first,
        int(wrong.sum()),
        tolerance=tolerance,
        source=source,
        remark=remark,
    )


def account_bounded(node: str, account: Array, tank: float | None) -> Check:
    """The account e_k of a device in wall time is never below -E_0; where it is counted alone, 0 is an assumption.

    Args:
        node: the device.
        account: recorded, ticks x 1, J.
        tank: E_0, J; None where nothing bounds the account.
    """
    known = account[np.isfinite(account)]
    tolerance = LEDGER_ROUNDING * float(np.abs(np.diff(known, prepend=0.0)).sum())
    least = 0.0 - (tank or 0.0)
    wrong = account < least - tolerance
    first = first_of(wrong, ("e",), account, np.full_like(account, least))
    if tank is None:
        what = "its account is never below 0, as within the certificate; nothing bounds it in this session"
    else:
        what = f"lateness put in no more than its tank of {1e3 * tank:g} mJ"
    verdict = CheckVerdict.HOLDS if len(known) else CheckVerdict.UNCHECKED
    if first is not None:
        verdict = CheckVerdict.ASSUMPTION if tank is None else CheckVerdict.BROKEN
    remark = f"least account {1e3 * min(0.0, float(known.min())):.4g} mJ" if len(known) else ""
    source = f"{LEDGER_ROUNDING:g} of the sum of its increments' magnitudes: rounding"
    return Check(
        "account",
        node,
        what,
        verdict,
        len(known),
        first,
        int(wrong.sum()),
        tolerance=tolerance,
        source=source,
        remark=remark,
    )


def ordered(run: RecordedRun, node: str, instants: Array, course: Course) -> Check:
    """The instants of a device in wall time are in order: a_(k-1) <= s_k <= a_k, and the force before ended by a_k.

    The delay tau that was recorded is a_k - s_k. After free periods it counts from their last sample instead.
    """
    sampled, applied, ended = instants.T
    rows = np.flatnonzero(there(instants))
    expected = instants.copy()
    free = np.zeros(len(instants), dtype=np.bool_)
    free[[k for k, happened in course.before.items() if happened.released or happened.unknown]] = True
    tau = np.rint(1e3 * rows_of(run, node, names.TAU)[:, 0])
    expected[:, 1] = np.where(free | np.isnan(tau), np.maximum(applied, sampled), sampled + tau)
    expected[:, 2] = np.minimum(ended, applied)
    begun = {k for k, happened in course.before.items() if happened.began}
    for last, k in pairwise(rows.tolist()):
        if k not in begun:
            expected[k, 0] = max(sampled[k], applied[last])
    what = "samples and forces are in the order of time, and tau is the time between them"
    return compare("instants", node, what, ("sampled", "applied", "ended"), instants, expected)


def limits_kept(run: RecordedRun, node: str, bundle: DeviceBundle, course: Course) -> list[Check]:
    """A device's force is within its limit, and so is its displacement.

    Its speed is checked under the simulated clock alone, where no tick is late. Beyond one of the last two limits the
    device has let go, and exerts no force. In wall time a row after free periods has the displacement before them, and
    the force after them; there the displacement is not judged.
    """
    x, f, ports = rows_of(run, node, names.DISPLACEMENT), rows_of(run, node, names.FORCE), run.recorded.ports[node]
    judged = np.ones(len(x), dtype=np.bool_)
    if bundle.time == WALL:
        judged[[k for k, happened in course.before.items() if happened.released]] = False
    found = [
        ("displacement", np.where(judged[:, None], np.abs(x), np.nan), bundle.limits.displacement, "m"),
        ("force", np.abs(f), bundle.limits.force, "N"),
    ]
    if run.recorded.clock == SIMULATED:
        step = np.abs(np.diff(x, axis=0, prepend=x[:1]))
        found.append(("step", step, tuple(run.recorded.period * v for v in bundle.limits.speed), "m"))
    out = []
    exerted = np.any(f != 0.0, axis=1, keepdims=True)
    for name, values, limits, unit in found:
        most = np.broadcast_to(np.array(limits), values.shape)
        beyond = (values > most) & exerted
        first = first_of(beyond, ports, values, most)
        numbers = int(np.isfinite(values).sum())
        verdict = (
            CheckVerdict.BROKEN if first is not None else CheckVerdict.HOLDS if numbers else CheckVerdict.UNCHECKED
        )
        remark = f"greatest {float(np.nanmax(values)):.6g} {unit} of {max(limits):g}" if numbers else ""
        what = f"its {name} is within its limit" + ("" if name == "force" else ", or it exerts no force")
        out.append(Check("limits", node, what, verdict, numbers, first, int(beyond.sum()), (), 0.0, _LIMITS, remark))
    return out


def delay_assumed(run: RecordedRun, node: str, tau: Mapping[int, float]) -> Check:
    """The certificate assumes that a force acts at most tau after its sample.

    Args:
        run: the recording.
        node: a device.
        tau: the delay that is covered, s, by the tick from which it holds.
    """
    trace = rows_of(run, node, names.TAU)
    covered = np.zeros_like(trace)
    for begin, most in sorted(tau.items()):
        covered[begin:] = most * 1e6
    late = trace > covered
    ticks, numbers = int(late.sum()), int(np.isfinite(trace).sum())
    remark = f"longest {float(np.nanmax(trace)):.6g} us of {max(tau.values()) * 1e6:g}" if numbers else ""
    if ticks:
        remark = f"later in {ticks} of {numbers} ticks; {remark}"
    first = first_of(late, ("τ",), trace, covered)
    verdict = CheckVerdict.ASSUMPTION if ticks else CheckVerdict.HOLDS if numbers else CheckVerdict.UNCHECKED
    what = "the force acts no later after its sample than the certificate assumes"
    return Check("tau", node, what, verdict, numbers, first, ticks, source=EXACT, remark=remark)


def period_assumed(run: RecordedRun, node: str, period_tolerance: float) -> Check:
    """The certificate assumes that samples come every T, or earlier; the device itself has counted the later ones.

    Args:
        run: the recording.
        node: a device.
        period_tolerance: rho of the certificate, which covers periods up to (1 + rho) T.
    """
    figures = run.figures.get(node, ())
    counts = [one[names.PERIOD_BREACHES] for _, one in figures if names.PERIOD_BREACHES in one]
    what = f"samples are at most {longest_period(1.0, period_tolerance):g} T apart, as the device counted"
    if not counts:
        return Check("period", node, what, CheckVerdict.UNCHECKED)
    most = max(counts)
    remark = f"not in {most:.0f} ticks" if most else ""
    return Check(
        "period", node, what, CheckVerdict.ASSUMPTION if most else CheckVerdict.HOLDS, len(counts), remark=remark
    )


def let_go_source(offsets: int) -> str:
    """The source of the tolerance of the environment's increments, as a sentence."""
    text = f"{ROUNDING:g} units in the last place of the tick's products, since the order of the sums differs"
    if offsets:
        text += f"; and in {offsets} ticks LET_GO = {LET_GO:g} m times the force, the offset that a clutch may drop"
    return text


StepProgress = Callable[[str], None]

MOST_VALUES: Final = 100_000_000
"""The most numbers of a recording that is recomputed: the recorded and the recomputed ones need 0.8 GB each."""


def prepared_of(path: Path, run: RecordedRun, progress: StepProgress | None = None) -> Prepared:
    """The session of a recording with its coupling, its certificate and its ladder.

    Args:
        path: the recording, for messages.
        run: its content.
        progress: called with the step of a design, where one is needed: for a ladder, or a session without certificate.

    Raises:
        RecordingError: session or certificate are missing or cannot be read, or differ from those that were recorded.
        NotCertified: the certificate does not hold, or belongs to another session.
    """
    with _unpacked(path, run) as folder:
        session = _session(path, run, folder)
        certified = CERTIFICATE_FILE in run.attachments
        if not certified and not run.recorded.certificate.startswith(UNCERTIFIED):
            raise RecordingError(
                f"{path}: found no certificate in it; expected {run.recorded.certificate[:16]} attached"
            )
        try:
            prepared = prepare(session, folder / CERTIFICATE_FILE if certified else None, not certified, progress)
        except CertificateError as error:
            raise RecordingError(_within(path, folder, error)) from error
        except NotCertified as error:
            raise NotCertified(_within(path, folder, error)) from error
    if prepared.id != run.recorded.certificate:
        raise NotCertified(
            f"{path}: found the certificate {prepared.id[:32]} in it; expected {run.recorded.certificate[:32]}, which "
            "its session ran under by its metadata"
        )
    return prepared


@contextmanager
def _unpacked(path: Path, run: RecordedRun) -> Iterator[Path]:
    """A temporary folder with the recording's session, and with its certificate if there is one."""
    if SESSION_FILE not in run.attachments:
        raise RecordingError(f"{path}: found no session in it; expected the attachment {SESSION_FILE}")
    with tempfile.TemporaryDirectory(prefix="recorded-") as name:
        folder = Path(name)
        for attachment in (SESSION_FILE, CERTIFICATE_FILE):
            if attachment in run.attachments:
                (folder / attachment).write_bytes(run.attachments[attachment])
        yield folder


def _session(path: Path, run: RecordedRun, folder: Path) -> Session:
    try:
        session = load_session(folder / SESSION_FILE)
    except SessionError as error:
        raise RecordingError(_within(path, folder, error)) from error
    recorded, graph = run.recorded, Plan(session).graph
    for what, found, expected in (
        ("name", session.name, recorded.session),
        ("period", session.period, recorded.period),
        ("nodes", dict(graph.nodes), dict(recorded.roles)),
        ("ports", {name: graph.ports[name] for name in graph.nodes}, dict(recorded.ports)),
        ("masses", mass_names(session), tuple(recorded.masses)),
    ):
        if found != expected:
            raise RecordingError(
                f"{path}: found a session with the {what} {found!r:.200}; expected {expected!r:.200}, as recorded"
            )
    values = run.ticks * sum(len(trace.columns) for trace in run.traces.values())
    if values > MOST_VALUES:
        raise RecordingError(
            f"{path}: found {values} numbers; expected at most {MOST_VALUES}, since all are kept in memory"
        )
    return session


def _within(path: Path, folder: Path, error: Exception) -> str:
    """An error's text, with the recording's name in place of the temporary folder's."""
    return str(error).replace(f"{folder}/", f"{path}: in it: ")


TickProgress = Callable[[int], None]


@dataclass(frozen=True)
class Audit:
    """The result of an audit.

    Attributes:
        session: the session's name.
        certificate: id of the certificate that the session ran under, by the recording's metadata.
        clock: "realtime" or "simulated".
        ticks: of the longest trace.
        checks: all of them.
    """

    session: str
    certificate: str
    clock: str
    ticks: int
    checks: tuple[Check, ...]

    @property
    def holds(self) -> bool:
        """Whether no check is broken."""
        return all(check.holds for check in self.checks)

    @property
    def broken(self) -> tuple[Check, ...]:
        """The checks that do not hold, the earliest tick first."""
        found = [check for check in self.checks if not check.holds]
        return tuple(sorted(found, key=lambda check: -1 if check.first is None else check.first.tick))

    def as_plain(self) -> dict[str, Any]:
        """As a JSON object."""
        return {
            "holds": self.holds,
            "session": self.session,
            "certificate": self.certificate,
            "clock": self.clock,
            "ticks": self.ticks,
            "checks": [check.as_plain() for check in self.checks],
        }


def require_certificate(path: Path, run: RecordedRun) -> None:
    """Refuse a recording without a certificate: no party promised anything, so there is nothing to audit.

    Raises:
        RecordingError: the recording has no certificate.
    """
    if CERTIFICATE_FILE not in run.attachments:
        raise RecordingError(
            f"{path}: found no certificate in it, but a session that ran as {run.recorded.certificate[:24]}; expected "
            "a certified one, since without a certificate no party has promised anything"
        )


def work_of(run: RecordedRun) -> int:
    """Number of ticks that an audit recomputes, over all nodes, for its progress."""
    return run.ticks * len(run.recorded.roles)


def audit(path: Path, run: RecordedRun, say: Callable[[str], None], progress: TickProgress) -> Audit:
    """Check a recording.

    Args:
        path: the recording, for messages.
        run: its content.
        say: called with the step of a design, where a ladder has to be designed.
        progress: called now and then with the number of ticks that are done, over all nodes.

    Raises:
        RecordingError: session or certificate are missing, or differ from those that were recorded.
    """
    require_certificate(path, run)
    recorded, what = run.recorded, "the certificate is proved, and it is this session's"
    try:
        prepared = prepared_of(path, run, say)
    except NotCertified as error:
        checks: tuple[Check, ...] = (Check("certificate", "session", what, CheckVerdict.BROKEN, remark=str(error)),)
    else:
        proved = Check("certificate", "session", what, CheckVerdict.HOLDS, remark=prepared.id)
        checks = (proved, *_AuditRun(prepared, run, progress).checks())
    return Audit(recorded.session, recorded.certificate, recorded.clock, run.ticks, checks)


class _AuditRun:
    """The audit of one recording, party by party."""

    def __init__(self, prepared: Prepared, run: RecordedRun, progress: TickProgress) -> None:
        self._prepared, self._run, self._progress = prepared, run, progress
        self._session = prepared.session
        self._bundles = cutting.cut(prepared, cutting.RunPlan(run.recorded.clock, None, ""))
        ports = self._session.ports
        index = {port: i for i, port in enumerate(ports)}
        self._ports = {
            name: np.array([index[port] for port in bundle.common.ports]) for name, bundle in self._bundles.items()
        }
        self._done = 0

    def checks(self) -> list[Check]:
        """All checks except that of the certificate."""
        of = self._bundles.items()
        devices = {name: bundle for name, bundle in of if isinstance(bundle, DeviceBundle)}
        couplings = {name: bundle for name, bundle in of if isinstance(bundle, CouplingBundle)}
        x, f = (self._wide([*devices], trace) for trace in (names.DISPLACEMENT, names.FORCE))
        blocks = Blocks(
            couplings,
            {name: self._ports[name] for name in couplings},
            self._wide([*couplings], names.FREE_POSITION),
            self._wide([*couplings], names.FORCE),
            {name: self._course(name, coupling) for name, coupling in couplings.items()},
        )
        courses = {name: self._course(name, device) for name, device in devices.items()}
        out: list[Check] = []
        for name, device in devices.items():
            if device.time == WALL:
                out += self._in_wall_time(name, device, x, f, blocks.f, courses[name])
            else:
                self._follow_guard(name, device, x, f, blocks.f)
                out += self._device(name, device, courses[name])
                jumped = np.array([k for k, happened in courses[name].before.items() if happened.jumped], dtype=np.intp)
                sent_on = np.ix_(jumped, self._ports[name])
                f[sent_on] = np.where(f[sent_on] == 0.0, np.nan, f[sent_on])  # a zero force is in no coupling's row
            self._next()
        for name, coupling in couplings.items():
            own, course = self._ports[name], blocks.courses[name]
            of_devices = [courses[device] for device in self._session.devices_of(name)]
            again = recompute_coupling(
                coupling, x[:, own], blocks.p[:, own], blocks.f[:, own], course, of_devices, self._report
            )
            out += self._compared(
                name, names.FREE_POSITION, "p follows from x and f_v by the certificate's block", again
            )
            self._next()
        out += forces_agree(self._run, blocks, f)
        out += self._environment(blocks)
        ledgers = [name for name in self._bundles if self._has_ledger(name)]
        out += [figures_agree(self._run, name) for name in ledgers]
        allowed = {name: device.allowed for name, device in devices.items()}
        out += [bounded(self._run, name, allowed.get(name, 0.0)) for name in ledgers]
        for name, device in devices.items():
            out += limits_kept(self._run, name, device, courses[name])
            taus = {0: device.rungs[0].tau} | {
                tick + 1: device.rungs[rung].tau for tick, rung in courses[name].in_force
            }
            tolerance = device.rungs[0].period_tolerance  # every rung of a ladder has that of the certificate
            out += [delay_assumed(self._run, name, taus), period_assumed(self._run, name, tolerance)]
        order = {"session": -1} | {name: i for i, name in enumerate(self._bundles)}
        return sorted(out, key=lambda check: order[check.party])

    def _follow_guard(self, name: str, bundle: DeviceBundle, x: Array, f: Array, asked: Array) -> None:
        """Replace x and f of a device that has let go by the x that it sent its couplings and the forces it was asked
        for.

        Both follow from its displacement to the bit under the simulated clock alone. In real time they are unknown from
        the first time that it lets go.

        Args:
            name: the device.
            bundle: its part of the session.
            x: recorded, ticks x ports, m; changed in place.
            f: exerted by the devices, N; changed in place where it agrees with ``asked``.
            asked: handed on by their couplings, N.
        """
        own, run = self._ports[name], self._run
        if run.recorded.clock != SIMULATED:
            begin = changed_after(run.figures.get(name, ()), names.LET_GO)
            if begin is not None:
                x[begin:, own] = f[begin:, own] = np.nan
            return
        guard: Guard | None = None
        for k in range(run.ticks):
            at = x[k, own].tolist()
            if not np.all(np.isfinite(at)):
                guard = None  # a new process begins with a new guard
                continue
            guard = guard or Guard(bundle.limits, self._session.period, bundle.common.ports)
            x[k, own] = guard.report(at)
            wanted = asked[k, own].tolist()
            if guard.let_go and guard.clip(wanted.copy()) == f[k, own].tolist():
                f[k, own] = wanted

    def _device(self, name: str, bundle: DeviceBundle, course: Course) -> list[Check]:
        run = self._run
        again = recompute_device(
            bundle,
            lambda: hand_of(bundle, self._session, self._run.recorded.clock),
            rows_of(run, name, names.DISPLACEMENT),
            rows_of(run, name, names.FORCE),
            course,
            self._report,
        )
        return self._compared(name, names.DISPLACEMENT, "x follows from f_v by the device and its hand", again)

    def _in_wall_time(
        self, name: str, bundle: DeviceBundle, x: Array, f: Array, asked: Array, course: Course
    ) -> list[Check]:
        """Check a device in wall time, and replace its x and f by what its couplings received and asked for.

        Where these cannot be computed, its x and f are taken for them as long as neither its guard nor its interface
        has changed anything, by its figures.

        Args:
            name: the device.
            bundle: its part of the session.
            x: recorded, ticks x ports, m; changed in place.
            f: exerted by the devices, N; changed in place where it is what follows from ``asked``.
            asked: handed on by their couplings, N.
            course: what happened between its rows.
        """
        run, own = self._run, self._ports[name]
        figures, ports = run.figures.get(name, ()), run.recorded.ports[name]
        its_x, its_f = rows_of(run, name, names.DISPLACEMENT), rows_of(run, name, names.FORCE)
        instants, account = rows_of(run, name, names.INSTANTS), rows_of(run, name, names.INTERFACE)
        let_go = changed_after(figures, names.LET_GO)
        applied = rows_of(run, name, names.APPLIED)
        rows = WallRows(its_x, its_f, asked[:, own], instants, applied, let_go)
        again = recompute_in_wall_time(
            bundle, lambda: hand_of(bundle, self._session, run.recorded.clock), rows, course, self._report
        )
        counts = (names.LET_GO, names.INTERFACE_TICKS, names.INTERFACE_OFFSET)
        changed = [tick for count in counts if (tick := changed_after(figures, count)) is not None]
        known = there(again.sent)
        unknown = ~known & (np.arange(run.ticks) >= min(changed, default=run.ticks))
        same = known & (again.exerted == its_f).all(axis=1)
        x[np.ix_(known, own)], x[np.ix_(unknown, own)] = again.sent[known], np.nan
        f[np.ix_(same, own)], f[np.ix_(unknown, own)] = asked[np.ix_(same, own)], np.nan
        gaps, of_motion = again.gaps, [*again.motion_gaps, *again.gaps]
        return [
            compare(
                "signal",
                name,
                "x at s_k follows from f_v, a_k and s_k by the device and its hand",
                ports,
                its_x,
                again.x,
                gaps=of_motion,
            ),
            compare("applied", name, "x at a_k follows likewise", ports, applied, again.applied, gaps=of_motion),
            compare(
                "exerted",
                name,
                "it exerts what its couplings asked for, as far as its limits and its account allow",
                ports,
                its_f,
                again.exerted,
                gaps=gaps,
            ),
            compare(
                "interface",
                name,
                "its account e_k follows from motion, forces, s_k and a_k",
                ("e",),
                account,
                again.account,
                gaps=gaps,
            ),
            compare(
                "ended",
                name,
                "the force before ended when the device states",
                ("ended",),
                instants[:, 2:],
                again.ended,
                gaps=gaps,
            ),
            ordered(run, name, instants, course),
            account_bounded(name, account, bundle.tank),
            compare(
                "ledger",
                name,
                "its ledger follows at the certificate's level",
                ("E",),
                rows_of(run, name, names.LEDGER),
                again.ledger,
                gaps=of_motion,
                tolerance=again.tolerance,
                source=EXACT if not again.tolerance.any() else FREE_SUMS,
            ),
        ]

    def _course(self, name: str, bundle: DeviceBundle | CouplingBundle) -> Course:
        """What happened to a device or a coupling between its rows."""
        run, couplings = self._run, []
        if isinstance(bundle, DeviceBundle):
            own = [coupling for coupling in self._session.couplings if name in self._session.devices_of(coupling)]
            couplings = [run.figures.get(coupling, ()) for coupling in own]
        trace = names.DISPLACEMENT if isinstance(bundle, DeviceBundle) else names.FREE_POSITION
        rows = there(rows_of(run, name, trace)) & there(rows_of(run, name, names.FORCE))
        return course_of(run.figures.get(name, ()), rows, len(bundle.rungs), couplings)

    def _environment(self, blocks: Blocks) -> list[Check]:
        run, bundle = self._run, self._bundles[ENVIRONMENT]
        if not isinstance(bundle, EnvironmentBundle):
            raise AssertionError("every session has an environment")
        sign = first_sign(run, ENVIRONMENT)
        tools, ledger = rows_of(run, ENVIRONMENT, names.TOOL_POSITION), rows_of(run, ENVIRONMENT, names.LEDGER)
        again = recompute_environment(bundle, blocks, tools, ledger, sign, self._report)
        self._next()
        ports, gaps = bundle.common.ports, again.gaps
        out = [
            compare("tools", ENVIRONMENT, "x_e follows from p of all couplings", ports, tools, again.tools, gaps=gaps),
            compare(
                "forces", ENVIRONMENT, "f_v follows from p of all couplings", ports, blocks.f, again.forces, gaps=gaps
            ),
            compare(
                "ledger",
                ENVIRONMENT,
                "its ledger follows from p of all couplings",
                ("E",),
                ledger,
                again.ledger,
                gaps=gaps,
            ),
            tools_agree(blocks, ports, ENVIRONMENT, tools, sign),
        ]
        if bundle.masses:
            masses = rows_of(run, ENVIRONMENT, names.MASS_POSITION)
            what = "q follows from p of all couplings"
            out.insert(1, compare("masses", ENVIRONMENT, what, bundle.masses, masses, again.masses, gaps=gaps))
        if bundle.Phi_E is not None:
            figures = run.figures.get(ENVIRONMENT, ())
            silent = np.zeros(blocks.f.shape, dtype=np.bool_)
            for name, its in blocks.ports.items():
                silent[:, its] = sent_no_force(figures, name, there(blocks.f[:, its]))[:, None]
            own = increments(bundle.Phi_E, self._session.period, blocks, tools, ledger, sign[0], silent)
            what = "its ledger gains in each tick the work at the couplings' ends and the dissipation by Phi_E"
            source = let_go_source(own.offsets)
            out.append(
                compare(
                    "work",
                    ENVIRONMENT,
                    what,
                    ("E",),
                    own.recorded,
                    own.recomputed,
                    gaps=own.gaps,
                    tolerance=own.tolerance,
                    source=source,
                )
            )
        return out

    def _compared(self, name: str, trace: str, what: str, again: Recomputed) -> list[Check]:
        """Compare a party's signal and its ledger."""
        run = self._run
        columns, signal = run.recorded.ports[name], rows_of(run, name, trace)
        out = [compare("signal", name, what, columns, signal, again.signal, gaps=again.gaps)]
        if self._has_ledger(name):
            kept, text = rows_of(run, name, names.LEDGER), "its ledger follows at the certificate's level"
            out.append(compare("ledger", name, text, ("E",), kept, again.ledger, gaps=again.gaps))
        return out

    def _has_ledger(self, name: str) -> bool:
        bundle = self._bundles[name]
        if isinstance(bundle, EnvironmentBundle):
            return bundle.Phi_E is not None
        return isinstance(bundle, DeviceBundle) or (isinstance(bundle, CouplingBundle) and bundle.level is not None)

    def _wide(self, nodes: list[str], trace: str) -> Array:
        """One trace of several nodes, in the order of the session's ports."""
        out = np.full((self._run.ticks, len(self._session.ports)), np.nan)
        for name in nodes:
            out[:, self._ports[name]] = rows_of(self._run, name, trace)
        return out

    def _report(self, tick: int) -> None:
        self._progress(self._done + tick)

    def _next(self) -> None:
        self._done += self._run.ticks
        self._progress(self._done)
