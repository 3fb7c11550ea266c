"""Checking a recorded run against its certificate, offline: every ledger anew, from the signals that were recorded.

Whoever has the file needs nobody's word. The certificate in it is proved again; then each party's part is computed from
what that party was told by the others, by the arithmetic of the nodes, and compared with what it told itself:

| party | from | follows |
|---|---|---|
| device | the forces that it exerted, and its hand | x, its ledger |
| coupling | x of its devices, f_v from the environment | p, its ledger |
| environment | p of all couplings | x_e, q, f_v, its ledger |

and what two parties told of the same thing is compared. So a number that was changed afterwards stands in contradiction
to others at its own tick. What a recording does not hold is not claimed: each check says which ticks it does not speak
of, and why.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from manyhands.launch import bundles as cutting
from manyhands.launch.preparation import NotCertified, Prepared
from manyhands.launch.recordings import agreement
from manyhands.launch.recordings.coupling_again import recompute_coupling
from manyhands.launch.recordings.course import Course, course_of, sent_no_force
from manyhands.launch.recordings.device_again import recompute_device
from manyhands.launch.recordings.findings import Check, Verdict, compare
from manyhands.launch.recordings.hands import hand_of
from manyhands.launch.recordings.prepared import prepared_of
from manyhands.launch.recordings.recomputed import Recomputed
from manyhands.launch.recordings.recording import RecordingError
from manyhands.launch.recordings.rows import changed_after, first_sign, rows_of, there
from manyhands.launch.recordings.run import Run
from manyhands.launch.recordings.world import Blocks, increments, recompute_environment
from manyhands.launch.topology import ENVIRONMENT
from manyhands.nodes import telemetry as names
from manyhands.nodes.bundle import SIMULATED, CouplingBundle, DeviceBundle, EnvironmentBundle
from manyhands.nodes.device.guard import Guard
from manyhands.nodes.recorder.layout import CERTIFICATE_FILE

Array = NDArray[np.float64]
Progress = Callable[[int], None]


@dataclass(frozen=True)
class Audit:
    """What came of an audit.

    Attributes:
        session: the session's name.
        certificate: id of the certificate that it says it ran under.
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
        """Whether nothing was found that cannot be."""
        return all(check.holds for check in self.checks)

    @property
    def broken(self) -> tuple[Check, ...]:
        """The checks that do not hold, the earliest tick first."""
        found = [check for check in self.checks if not check.holds]
        return tuple(sorted(found, key=lambda check: -1 if check.first is None else check.first.tick))

    def as_plain(self) -> dict[str, Any]:
        """As JSON values."""
        return {
            "holds": self.holds,
            "session": self.session,
            "certificate": self.certificate,
            "clock": self.clock,
            "ticks": self.ticks,
            "checks": [check.as_plain() for check in self.checks],
        }


def require_certificate(path: Path, run: Run) -> None:
    """Refuse a recording that has no certificate: nothing was promised, so nothing can be audited.

    Raises:
        RecordingError: so it is.
    """
    if CERTIFICATE_FILE not in run.attachments:
        raise RecordingError(
            f"{path}: found no certificate in it, but a session that ran as {run.recorded.certificate[:24]}; expected "
            "a certified one, for without a certificate nobody has promised anything"
        )


def work_of(run: Run) -> int:
    """How many ticks of nodes an audit recomputes, for its progress."""
    return run.ticks * len(run.recorded.roles)


def audit(path: Path, run: Run, say: Callable[[str], None], progress: Progress) -> Audit:
    """Check a recording.

    Args:
        path: the recording, for messages.
        run: what was read from it.
        say: told what a design is doing, where a ladder has to be designed.
        progress: told now and then how many ticks of nodes are done.

    Raises:
        RecordingError: it has no session or no certificate, or they are not those that were recorded.
    """
    require_certificate(path, run)
    recorded, what = run.recorded, "the certificate is proved, and this session's"
    try:
        prepared = prepared_of(path, run, say)
    except NotCertified as error:
        checks: tuple[Check, ...] = (Check("certificate", "session", what, Verdict.BROKEN, told=str(error)),)
    else:
        proved = Check("certificate", "session", what, Verdict.HOLDS, told=prepared.id)
        checks = (proved, *_Auditing(prepared, run, progress).checks())
    return Audit(recorded.session, recorded.certificate, recorded.clock, run.ticks, checks)


class _Auditing:
    """One audit."""

    def __init__(self, prepared: Prepared, run: Run, progress: Progress) -> None:
        self._prepared, self._run, self._progress = prepared, run, progress
        self._session = prepared.session
        self._bundles = cutting.cut(prepared, cutting.Run(SIMULATED, None, ""))
        ports = self._session.ports
        index = {port: i for i, port in enumerate(ports)}
        self._ports = {
            name: np.array([index[port] for port in bundle.common.ports]) for name, bundle in self._bundles.items()
        }
        self._done = 0

    def checks(self) -> list[Check]:
        """All but that of the certificate."""
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
        for name, device in devices.items():
            self._follow_guard(name, device, x, f, blocks.f)
        out: list[Check] = []
        for name, coupling in couplings.items():
            own, course = self._ports[name], blocks.courses[name]
            of_devices = [courses[device] for device in self._session.devices_of(name)]
            again = recompute_coupling(
                coupling, x[:, own], blocks.p[:, own], blocks.f[:, own], course, of_devices, self._tell
            )
            out += self._compared(
                name, names.FREE_POSITION, "p follows from x and f_v by the certificate's block", again
            )
            self._next()
        for name, device in devices.items():
            out += self._device(name, device, courses[name])
            self._next()
        out += agreement.forces_agree(self._run, blocks, f)
        out += self._environment(blocks)
        ledgers = [name for name in self._bundles if self._has_ledger(name)]
        out += [agreement.figures_agree(self._run, name) for name in ledgers]
        out += [agreement.bounded(self._run, name) for name in ledgers]
        for name, device in devices.items():
            out += agreement.limits_kept(self._run, name, device)
            taus = {0: device.rungs[0].tau} | {
                tick + 1: device.rungs[rung].tau for tick, rung in courses[name].in_force
            }
            out += [agreement.delay_assumed(self._run, name, taus), agreement.period_assumed(self._run, name)]
        order = {"session": -1} | {name: i for i, name in enumerate(self._bundles)}
        return sorted(out, key=lambda check: order[check.party])

    def _follow_guard(self, name: str, bundle: DeviceBundle, x: Array, f: Array, asked: Array) -> None:
        """Put into x what a device that has let go told its couplings, and into f the forces that it was asked for.

        Both follow from its displacement; but in real time not to the bit, and there they are not known from there on.

        Args:
            name: the device.
            bundle: its part of the session.
            x: recorded, ticks x ports, m; written.
            f: what the devices exerted, N; written where that is what it makes of ``asked``.
            asked: what their couplings handed on, N.
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
                guard = None  # a process that comes back begins anew
                continue
            guard = guard or Guard(bundle.limits, self._session.period, bundle.common.ports)
            x[k, own] = guard.tell(at)
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
            self._tell,
        )
        return self._compared(name, names.DISPLACEMENT, "x follows from f_v by the device and its hand", again)

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
        again = recompute_environment(bundle, blocks, tools, ledger, sign, self._tell)
        self._next()
        ports, gaps = bundle.common.ports, again.gaps
        out = [
            compare("tools", ENVIRONMENT, "x_e follows from p of all couplings", ports, tools, again.tools, gaps=gaps),
            compare("forces", ENVIRONMENT, "f_v of the couplings does", ports, blocks.f, again.forces, gaps=gaps),
            compare("ledger", ENVIRONMENT, "its ledger does", ("E",), ledger, again.ledger, gaps=gaps),
            agreement.tools_agree(blocks, ports, ENVIRONMENT, tools, sign),
        ]
        if bundle.masses:
            masses = rows_of(run, ENVIRONMENT, names.MASS_POSITION)
            what = "q does"
            out.insert(1, compare("masses", ENVIRONMENT, what, bundle.masses, masses, again.masses, gaps=gaps))
        if bundle.Phi_E is not None:
            told = run.figures.get(ENVIRONMENT, ())
            silent = np.zeros(blocks.f.shape, dtype=np.bool_)
            for name, its in blocks.ports.items():
                silent[:, its] = sent_no_force(told, name, there(blocks.f[:, its]))[:, None]
            own = increments(bundle.Phi_E, self._session.period, blocks, tools, ledger, sign[0], silent)
            what = "what its ledger gains in a tick is the work at the couplings' ends and what Phi_E dissipates"
            source = agreement.let_go_source(own.offsets)
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
        """A party's signal and its ledger."""
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

    def _tell(self, tick: int) -> None:
        self._progress(self._done + tick)

    def _next(self) -> None:
        self._done += self._run.ticks
        self._progress(self._done)
