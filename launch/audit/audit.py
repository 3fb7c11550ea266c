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
| wave link, user's end | p of the coupling, the wave c | f_v, its tank |
| wave link, world's end | f_v behind the clutch, the wave c | p, its tank |

Signals that two parties recorded are compared as well. So a number that was changed afterwards contradicts others at
its own tick. What a recording does not hold is not claimed: each check lists the ticks that it does not cover, with the
reason.

Some checks need no state of a party (:mod:`manyhands.launch.audit.checks`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from manyhands.launch.audit.checks import (
    account_bounded,
    bounded,
    delay_assumed,
    figures_agree,
    forces_agree,
    limits_kept,
    ordered,
    period_assumed,
    tools_agree,
)
from manyhands.launch.audit.coupling import FollowedCoupling
from manyhands.launch.audit.device import (
    ENDED,
    GIVEN,
    SENT,
    TOLERANCE,
    DeviceRows,
    FollowedInOwnTime,
    FollowedInWallTime,
)
from manyhands.launch.audit.device import ROUNDING as FREE_ROUNDING
from manyhands.launch.audit.environment import ROUNDING, Blocks, FollowedEnvironment, increments
from manyhands.launch.audit.events import Course, course_of
from manyhands.launch.audit.findings import EXACT, Check, CheckVerdict, UncheckedTicks, compare
from manyhands.launch.audit.orientation import device_checks, world_checks
from manyhands.launch.audit.prepared import prepared_of
from manyhands.launch.audit.presence import Presence, fitted
from manyhands.launch.audit.press import Press, presses
from manyhands.launch.audit.promises import promises_of
from manyhands.launch.audit.recompute import Array, FollowedParty, Recomputed, recompute
from manyhands.launch.audit.replay import hand_of
from manyhands.launch.audit.torques import torques_agree
from manyhands.launch.audit.wave_link import (
    EndRows,
    FollowedUserEnd,
    FollowedWorldEnd,
    end_checks,
    heard_from,
    ledger_of_both,
)
from manyhands.launch.plan import bundles as cutting
from manyhands.launch.plan.loop import NotCertified
from manyhands.launch.plan.prepare import Prepared
from manyhands.launch.recordings.integrity import Damage
from manyhands.launch.recordings.recording import RecordingError
from manyhands.launch.recordings.run import (
    FiguresByTick,
    RecordedRun,
    at_telemetry,
    changed_after,
    first_sign,
    grown_in,
    pressed_in,
    rows_of,
    there,
)
from manyhands.launch.session.session import ENVIRONMENT
from manyhands.nodes.environment.clutch import LET_GO
from manyhands.nodes.kernel.bundle import (
    SIMULATED,
    WALL,
    CouplingBundle,
    DeviceBundle,
    EnvironmentBundle,
    WaveEnd,
)
from manyhands.nodes.monitor.given import FIGURES
from manyhands.nodes.monitor.health import PROMISES, SESSION, PromiseState, holds
from manyhands.nodes.recorder.format import CERTIFICATE_FILE
from manyhands.nodes.rows import figures as names
from manyhands.nodes.rows.promises import Promise
from manyhands.nodes.rows.tick_events import Kind, events_in
from manyhands.nodes.wave_link.faces import wave_feedthrough
from manyhands.protocol.channels import ORIENTATION, TANK_NAMES, WORK, WORK_NAMES
from manyhands.protocol.clock import from_seconds
from manyhands.protocol.messages import PromiseStatus
from manyhands.protocol.plain import written

FREE_SUMS: Final = (
    f"{FREE_ROUNDING:g} units in the last place of the energy exchanged so far for each free period, since the order "
    "of the sums differs; exact before the first"
)


def let_go_source(offsets: int) -> str:
    """The source of the tolerance of the environment's increments, as a sentence."""
    text = f"{ROUNDING:g} units in the last place of the tick's products, since the order of the sums differs"
    if offsets:
        text += f"; and in {offsets} ticks LET_GO = {LET_GO:g} m times the force, the offset that a clutch may drop"
    return text


class Follows(NamedTuple):
    """What follows for one field of a party.

    Attributes:
        check: the name of the check.
        field: the field that is compared with the trace of its name.
        what: the claim, a sentence.
        of_motion: whether it needs the device's motion to be known.
    """

    check: str
    field: str
    what: str
    of_motion: bool = False


LEDGER_FOLLOWS: Final = Follows("ledger", names.LEDGER, "its ledger follows at the certificate's level", True)
OWN_TIME_FOLLOWS: Final = (
    Follows("signal", names.DISPLACEMENT, "x follows from f_v by the device and its hand", True),
    LEDGER_FOLLOWS,
)
WALL_TIME_FOLLOWS: Final = (
    Follows("signal", names.DISPLACEMENT, "x at s_k follows from f_v, a_k and s_k by the device and its hand", True),
    Follows("applied", names.APPLIED, "x at a_k follows likewise", True),
    Follows(
        "exerted", names.FORCE, "it exerts what its couplings asked for, as far as its limits and its account allow"
    ),
    Follows("interface", names.INTERFACE, "its account e_k follows from motion, forces, s_k and a_k"),
)
WORK_FOLLOWS: Final = Follows("work", WORK, "the work of its motors follows likewise, until s_k and until a_k", True)
ENDED_FOLLOWS: Final = Follows("ended", ENDED, "the force before ended when the device states")
COUPLING_FOLLOWS: Final = (
    Follows("signal", names.FREE_POSITION, "p follows from x and f_v by the certificate's block"),
    LEDGER_FOLLOWS,
)
ENVIRONMENT_FOLLOWS: Final = (
    Follows("tools", names.TOOL_POSITION, "x_e follows from p of all couplings"),
    Follows("masses", names.MASS_POSITION, "q follows from p of all couplings"),
    Follows("forces", names.FORCE, "f_v follows from p of all couplings"),
    Follows("ledger", names.LEDGER, "its ledger follows from p of all couplings"),
)


_WAVE_TRACES: Final = (names.FREE_POSITION, names.FORCE, names.WAVE, names.TANK)
"""The traces of an end of a wave link, in the order of :class:`EndRows`."""

TickProgress = Callable[[int], None]


class AuditVerdict(StrEnum):
    """The result of an audit."""

    HOLDS = "holds"  # all that the certificate needs was checked, and kept or enforced
    UNCHECKED = "not checked"  # what the recording has was kept, and something that the certificate needs is not in it
    BROKEN = "does not hold"


@dataclass(frozen=True)
class Audit:
    """The result of an audit.

    Attributes:
        session: the session's name.
        certificate: id of the certificate that the session ran under, by the recording's metadata.
        clock: "realtime" or "simulated".
        ticks: of the longest trace.
        checks: all of them.
        promises: how each promise stood, by the checks and by what the session recorded.
        faults: why the session failed, by its last recorded condition; empty where it did not.
        presses: the stiffness that hands were given, where they held still.
    """

    session: str
    certificate: str
    clock: str
    ticks: int
    checks: tuple[Check, ...]
    promises: tuple[PromiseStatus, ...]
    faults: tuple[str, ...] = ()
    presses: tuple[Press, ...] = ()

    @property
    def holds(self) -> bool:
        """Whether all that the certificate needs was checked, and kept or enforced, and nothing else is broken."""
        return all(check.holds for check in self.checks) and holds(self.promises)

    @property
    def verdict(self) -> AuditVerdict:
        """What was found, in one word; only the first is a success."""
        if self.holds:
            return AuditVerdict.HOLDS
        needed = (row.state for row in self.promises if PROMISES[Promise(row.promise)].needed)
        broken = bool(self.broken) or PromiseState.BROKEN in needed
        return AuditVerdict.BROKEN if broken else AuditVerdict.UNCHECKED

    @property
    def broken(self) -> tuple[Check, ...]:
        """The checks that do not hold, the earliest tick first."""
        found = [check for check in self.checks if not check.holds]
        return tuple(sorted(found, key=lambda check: -1 if check.first is None else check.first.tick))

    def as_plain(self) -> dict[str, Any]:
        """As a JSON object."""
        return {
            "holds": self.holds,
            "found": self.verdict.value,
            "session": self.session,
            "certificate": self.certificate,
            "clock": self.clock,
            "ticks": self.ticks,
            "promises": [written(row) for row in self.promises],
            "faults": list(self.faults),
            "checks": [check.as_plain() for check in self.checks],
            "presses": [press.as_plain() for press in self.presses],
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


def _file_checks(run: RecordedRun, damage: Sequence[Damage]) -> list[Check]:
    """What the file itself says: its checksums, whether it has its end, and whether the session did a tick."""
    changed = [found for found in damage if not found.cut]
    cut = next((found.what for found in damage if found.cut), run.cut)
    out = []
    if changed:
        why = f"bytes {changed[0].begin} to {changed[0].end - 1}: {changed[0].what}"
        out.append(Check("bytes", SESSION, "all checksums match", CheckVerdict.BROKEN, remark=why))
    if cut is not None:
        what = "the recording has its end"
        out.append(Check("end", SESSION, what, CheckVerdict.MISSING, remark=f"{cut}; what came after is not checked"))
    if not run.topics:
        why = "the session did no tick, or the recording has none of them"
        out.append(Check("ticks", SESSION, "the session has ticks", CheckVerdict.MISSING, remark=why))
    return out


def work_of(run: RecordedRun) -> int:
    """Number of ticks that an audit recomputes, over all nodes, for its progress."""
    return run.ticks * len(run.recorded.roles)


def audit(
    path: Path,
    run: RecordedRun,
    say: Callable[[str], None],
    progress: TickProgress,
    damage: Sequence[Damage] = (),
) -> Audit:
    """Check a recording.

    Args:
        path: the recording, for messages.
        run: its content.
        say: called with the step of a design, where a ladder has to be designed.
        progress: called now and then with the number of ticks that are done, over all nodes.
        damage: where the file's bytes are not as they were written.

    Raises:
        RecordingError: session or certificate are missing, or differ from those that were recorded.
    """
    require_certificate(path, run)
    recorded, what = run.recorded, "the certificate is proved, and it is this session's"
    try:
        prepared = prepared_of(path, run, say)
    except NotCertified as error:
        checks: tuple[Check, ...] = (Check("certificate", "session", what, CheckVerdict.BROKEN, remark=str(error)),)
        of_none = Promise.CERTIFICATE.value, PromiseState.BROKEN.value, (SESSION,)
        promises: tuple[PromiseStatus, ...] = (PromiseStatus(*of_none, remark=str(error)),)
        pressed: tuple[Press, ...] = ()
    else:
        proved = Check("certificate", "session", what, CheckVerdict.HOLDS, remark=prepared.id)
        checks = (proved, *_file_checks(run, damage), *_AuditRun(prepared, run, progress).checks())
        promises = promises_of(prepared, run, checks)
        pressed = presses(prepared, run)
    faults = run.conditions[-1][1].faults if run.conditions else ()
    about = recorded.session, recorded.certificate, recorded.clock, run.ticks
    return Audit(*about, checks, promises, tuple(faults), pressed)


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
        users: dict[str, DeviceBundle | CouplingBundle] = {**devices, **couplings}
        courses = {name: self._course(name, bundle) for name, bundle in users.items()}
        ledgers = [name for name in self._bundles if self._has_ledger(name)]
        self._presence = Presence(self._run, self._session, frozenset(ledgers))
        out = [self._presence.check(name) for name in self._bundles]
        for rate in sorted({self._run.recorded.rate_of(name) for name in courses}):
            own = {name for name in courses if self._run.recorded.rate_of(name) == rate}
            out += self._users(
                {name: device for name, device in devices.items() if name in own},
                {name: coupling for name, coupling in couplings.items() if name in own},
                courses,
            )
        out += self._environment(couplings, courses)
        world = self._bundles[ENVIRONMENT]
        out += world_checks(self._run, ENVIRONMENT, world) if isinstance(world, EnvironmentBundle) else []
        out += [figures_agree(self._run, name) for name in ledgers]
        out += [bounded(self._run, name) for name in ledgers if name not in devices]
        for name, device in devices.items():
            assumed = self._assumed(name, device, courses[name])
            found = [check for check in (*out, *assumed) if check.party == name]
            missed = (CheckVerdict.ASSUMPTION, CheckVerdict.ENFORCED)
            within = all(check.verdict not in missed for check in found) and not courses[name].released
            promised = device.time != WALL or device.allowance is not None or within
            if self._session.devices[name].word is None:  # otherwise its ledger lacks the work of a person's hand
                out.append(bounded(self._run, name, device.allowed, promised))
            out += [*limits_kept(self._run, name, device, courses[name]), *assumed]
            out += device_checks(self._run, name, device, courses[name])
        order = {"session": -1} | {name: i for i, name in enumerate(self._bundles)}
        return sorted(out, key=lambda check: order[check.party])

    def _users(
        self,
        devices: Mapping[str, DeviceBundle],
        couplings: Mapping[str, CouplingBundle],
        courses: Mapping[str, Course],
    ) -> list[Check]:
        """The checks of all devices and couplings of one period.

        Args:
            devices: by name.
            couplings: by name.
            courses: what happened between the rows of each.
        """
        x, f = (self._wide([*devices], trace) for trace in (names.DISPLACEMENT, names.FORCE))
        blocks = Blocks(
            couplings,
            {name: self._ports[name] for name in couplings},
            self._wide([*couplings], names.FREE_POSITION),
            self._wide([*couplings], names.FORCE),
            courses,
        )
        out: list[Check] = []
        for name, device in devices.items():
            out += self._device(name, device, x, f, blocks.f, courses[name])
        for name, coupling in couplings.items():
            own, course = self._ports[name], courses[name]
            resampled = course.resampled
            for of in self._session.devices_of(name):
                resampled |= courses[of].resampled
            block = FollowedCoupling(coupling, x[:, own], blocks.p[:, own], blocks.f[:, own], resampled)
            again = self._again(block, course)
            again.gaps += block.excused
            out += self._compared(name, again, COUPLING_FOLLOWS)
        return out + forces_agree(self._run, blocks, f, self._presence.owed)

    def _assumed(self, name: str, bundle: DeviceBundle, course: Course) -> list[Check]:
        """What the certificate assumes of a device's delays and periods."""
        taus = {0: bundle.rungs[0].tau} | {tick + 1: bundle.rungs[rung].tau for tick, rung in course.in_force}
        tolerance = bundle.rungs[0].period_tolerance  # every rung of a ladder has that of the certificate
        enforced = bundle.time == WALL and bundle.allowance is not None
        return [
            delay_assumed(self._run, name, taus, enforced, bundle.time == WALL and bundle.timing.latency > 0.0),
            period_assumed(self._run, name, tolerance, enforced),
        ]

    def _device(self, name: str, bundle: DeviceBundle, x: Array, f: Array, asked: Array, course: Course) -> list[Check]:
        """Check a device, and replace its x and f by what its couplings received and asked for.

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
        run, own, wall = self._run, self._ports[name], bundle.time == WALL
        figures = run.figures.get(name, ())
        let_go = changed_after(figures, names.LET_GO)
        guarded = wall or run.recorded.clock == SIMULATED
        if not guarded:
            leaves = (k for k, happened in course.before.items() if happened.leaves)
            let_go = min((k for k in (let_go, *leaves) if k is not None), default=None)
        rows = DeviceRows(
            x=rows_of(run, name, names.DISPLACEMENT),
            f=rows_of(run, name, names.FORCE),
            asked=asked[:, own],
            instants=rows_of(run, name, names.INSTANTS) if wall else np.full((len(x), 3), np.nan),
            applied=rows_of(run, name, names.APPLIED) if wall else np.full((len(x), len(own)), np.nan),
            let_go=let_go,
            stopped=grown_in(figures, names.SUSPENDED, len(x)),
            unexerted=changed_after(figures, names.UNEXERTED),
            turned=rows_of(run, name, ORIENTATION) if wall and bundle.twisting is not None else None,
            work=rows_of(run, name, WORK) if wall and bundle.held is not None and bundle.held.works else None,
        )
        device = (FollowedInWallTime if wall else FollowedInOwnTime)(
            bundle, lambda: hand_of(bundle, self._session, run.recorded.clock), rows, guarded
        )
        again = self._again(device, course)
        known = there(again[SENT])
        unknown = self._unknown(name, known, course, wall)
        same = known & there(rows.asked) & (again[names.FORCE] == rows.f).all(axis=1)
        x[np.ix_(known, own)], x[np.ix_(unknown, own)] = again[SENT][known], np.nan
        f[np.ix_(same, own)], f[np.ix_(unknown, own)] = asked[np.ix_(same, own)], np.nan
        if not wall:
            jumped = [k for k, happened in course.before.items() if happened.may_be_zero]
            sent_on = np.ix_(np.array(jumped, dtype=np.intp), own)
            f[sent_on] = np.where(f[sent_on] == 0.0, np.nan, f[sent_on])  # a zero force is in no coupling's row
            return self._compared(name, again, OWN_TIME_FOLLOWS, device.motion_gaps)
        return [
            *self._compared(name, again, WALL_TIME_FOLLOWS, device.motion_gaps),
            *self._compared(name, again, () if rows.work is None else (WORK_FOLLOWS,), device.motion_gaps),
            *self._torques(name, bundle, rows, course),
            *self._given(name, figures, again[GIVEN], again.gaps),
            *self._compared(name, again, (ENDED_FOLLOWS,), recorded={ENDED: rows.instants[:, 2:]}),
            ordered(run, name, rows.instants, course, self._presence.owed[name], from_seconds(bundle.timing.latency)),
            account_bounded(name, rows_of(run, name, names.INTERFACE), rows.instants[:, 1], bundle.allowance),
            *self._compared(name, again, (LEDGER_FOLLOWS,), device.motion_gaps),
        ]

    def _torques(self, name: str, bundle: DeviceBundle, rows: DeviceRows, course: Course) -> list[Check]:
        """Check the work that a driver of another package told of its motors, which hold torques."""
        device = self._session.devices[name]
        if rows.work is None or device.factory is None:
            return []
        return [torques_agree(name, bundle, device.factory, device.step, rows, course)]

    def _unknown(self, name: str, known: NDArray[np.bool_], course: Course, wall: bool) -> NDArray[np.bool_]:
        """By tick, whether what its couplings received of a device may differ from its own rows.

        Args:
            name: the device.
            known: by tick, whether it can be computed.
            course: what happened between its rows.
            wall: whether it is in wall time.
        """
        figures, ticks = self._run.figures.get(name, ()), len(known)
        counts = (names.LET_GO, names.INTERFACE_TICKS, names.INTERFACE_OFFSET)
        changed = [tick for count in counts if (tick := changed_after(figures, count)) is not None]
        changed += [k for k, happened in course.before.items() if happened.leaves]
        unknown: NDArray[np.bool_] = ~known & (np.arange(ticks) >= min(changed, default=ticks))
        if wall:
            astray = [k for k, happened in course.before.items() if happened.may_be_zero or happened.unknown]
            unknown[astray] |= ~known[astray]
        return unknown

    def _course(self, name: str, bundle: DeviceBundle | CouplingBundle) -> Course:
        """What happened to a device or a coupling between its rows."""
        run, couplings = self._run, []
        if isinstance(bundle, DeviceBundle):
            own = [coupling for coupling in self._session.couplings if name in self._session.devices_of(coupling)]
            couplings = [run.figures.get(coupling, ()) for coupling in own]
        trace = names.DISPLACEMENT if isinstance(bundle, DeviceBundle) else names.FREE_POSITION
        rows = there(rows_of(run, name, trace)) & there(rows_of(run, name, names.FORCE))
        return course_of(run.figures.get(name, ()), rows, len(bundle.rungs), couplings)

    def _environment(self, couplings: Mapping[str, CouplingBundle], courses: Mapping[str, Course]) -> list[Check]:
        run, bundle = self._run, self._bundles[ENVIRONMENT]
        if not isinstance(bundle, EnvironmentBundle):
            raise AssertionError("every session has an environment")
        blocks = Blocks(
            couplings,
            {name: self._ports[name] for name in couplings},
            self._at_the_world([*couplings], names.FREE_POSITION),
            self._at_the_world([*couplings], names.FORCE),
            courses,
            {name: fitted(held, run.ticks) for name, held in self._presence.held.items()},
            {name: wave_feedthrough(wave.b, bundle.common.period) for name, wave in bundle.waves.items()},
        )
        sign = first_sign(run, ENVIRONMENT)
        tools, ports = rows_of(run, ENVIRONMENT, names.TOOL_POSITION), bundle.common.ports
        buttons = pressed_in(run.figures.get(ENVIRONMENT, ()), bundle.common.buttons)
        again = self._again(FollowedEnvironment(bundle, blocks, tools, sign, buttons), Course({}, {}, len(tools)))
        follows = [one for one in ENVIRONMENT_FOLLOWS if one.field != names.MASS_POSITION or bundle.masses]
        out = self._compared(ENVIRONMENT, again, follows, recorded={names.FORCE: blocks.f}, masses=bundle.masses)
        out.append(tools_agree(blocks, ports, ENVIRONMENT, tools, sign, self._presence.owed[ENVIRONMENT]))
        if bundle.Phi_E is not None:
            out.append(self._work(bundle, bundle.Phi_E, blocks, sign[0]))
        for name, wave in bundle.waves.items():
            out += self._wave_link(name, couplings[name], bundle, wave, courses[name])
        return out

    def _work(self, bundle: EnvironmentBundle, Phi: Array, blocks: Blocks, sign: int) -> Check:
        """Compare the environment's ledger with the work at its ports, from which it follows without any state.

        Args:
            bundle: the environment's part of the session.
            Phi: the level that it promised, N*s/m.
            blocks: the recorded signals of all couplings, at the environment.
            sign: the first tick at which a clutch may have moved.
        """
        run, figures = self._run, self._run.figures.get(ENVIRONMENT, ())
        tools, ledger = rows_of(run, ENVIRONMENT, names.TOOL_POSITION), rows_of(run, ENVIRONMENT, names.LEDGER)
        silent, changed = (np.zeros(blocks.f.shape, dtype=np.bool_) for _ in range(2))
        for name, its in blocks.ports.items():
            if name not in blocks.faces:
                silent[:, its] = self._presence.frozen[name][:, None]
                changed[:, its] = fitted(blocks.courses[name].resampled, len(silent))[:, None]
        events = (event for _, values in figures for event in events_in(values))
        begun = [event.tick for event in events if event.kind is Kind.BEGAN and 0 < event.tick < len(tools)]
        held = sum(
            max((one.table(names.SCALED).get(name, 0.0) for _, one in figures), default=0.0) for name in blocks.ports
        )
        own = increments(
            Phi,
            self._session.period,
            blocks,
            tools,
            ledger,
            sign,
            silent,
            changed,
            begun,
            bundle.energy_at_start,
            int(held) if 0.0 < held < math.inf else 0,
        )
        return compare(
            "work",
            ENVIRONMENT,
            "its ledger gains in each tick the work at the couplings' ends and the dissipation by Phi_E",
            ("E",),
            own.recorded,
            own.recomputed,
            gaps=own.gaps,
            tolerance=own.tolerance,
            source=let_go_source(own.offsets),
            owed=self._presence.owed[ENVIRONMENT],
        )

    def _wave_link(
        self, name: str, coupling: CouplingBundle, world: EnvironmentBundle, wave: WaveEnd, course: Course
    ) -> list[Check]:
        """The checks of a wave link: each end, what each has heard of the other, and the energy at both."""
        run = self._run
        if coupling.wave is None:
            raise AssertionError("the world has the end of a wave link, and its coupling has none")
        own, its = (
            EndRows(*(self._of_link(node, name, trace) for trace in _WAVE_TRACES)) for node in (name, ENVIRONMENT)
        )
        user = FollowedUserEnd(coupling.common, coupling, coupling.wave, own, course).end()
        other = FollowedWorldEnd(world.common, wave, its, name, run.figures.get(ENVIRONMENT, ())).end()
        ports = run.recorded.ports[name]
        return [
            *end_checks(name, name, ports, user, user=True),
            *end_checks(ENVIRONMENT, name, ports, other, user=False),
            heard_from(name, ENVIRONMENT, user, other),
            heard_from(ENVIRONMENT, name, other, user),
            ledger_of_both(name, user, other, run.recorded.rate_of(name)),
        ]

    def _of_link(self, node: str, coupling: str, trace: str) -> Array:
        """The columns of a trace of ``node`` that belong to the wave link of ``coupling``."""
        rows, links = rows_of(self._run, node, trace), self._run.recorded.links_of(node)
        width = len(TANK_NAMES) if trace == names.TANK else 0
        begin = 0
        for name, ports in links.items():
            end = begin + (width or len(ports))
            if name == coupling:
                return rows[:, begin:end]
            begin = end
        raise AssertionError("every coupling of the audit's bundles with a wave link is one of the recording's")

    def _again(self, follower: FollowedParty, course: Course) -> Recomputed:
        """A party's fields, computed again, with progress."""
        again = recompute(follower, course, lambda tick: self._progress(self._done + tick))
        self._done += self._run.ticks
        self._progress(self._done)
        return again

    def _compared(
        self,
        party: str,
        again: Recomputed,
        follows: Iterable[Follows],
        motion_gaps: Sequence[UncheckedTicks] = (),
        recorded: Mapping[str, Array] = MappingProxyType({}),
        masses: tuple[str, ...] = (),
    ) -> list[Check]:
        """Compare a party's fields with what was recorded of them, in the ticks that it owed.

        Args:
            party: its node.
            again: its fields, computed again.
            follows: what to compare; a ledger that it does not keep is left out.
            motion_gaps: why its motion could not be computed.
            recorded: what was recorded of fields that are no trace of the node.
            masses: of the environment.
        """
        out, run = [], self._run
        columns = {names.MASS_POSITION: masses, names.LEDGER: ("E",), names.INTERFACE: ("e",), ENDED: ("ended",)}
        columns[WORK] = WORK_NAMES
        for name, field, what, of_motion in follows:
            if field == names.LEDGER and not self._has_ledger(party):
                continue
            told = recorded[field] if field in recorded else rows_of(run, party, field)
            owed: NDArray[np.bool_] = self._presence.owed[party]
            tolerance: Array | float = 0.0
            if field in (names.APPLIED, WORK):
                owed = owed & (there(told) | there(again[field]))  # not every device measures it
            if field == names.LEDGER and TOLERANCE in again.fields:
                tolerance = np.nan_to_num(again[TOLERANCE])
            gaps = [*motion_gaps, *again.gaps] if of_motion else again.gaps
            ports, source = run.recorded.ports[party], FREE_SUMS if np.any(tolerance) else EXACT
            out.append(
                compare(
                    name, party, what, columns.get(field, ports), told, again[field], gaps=gaps,
                    tolerance=tolerance, source=source, owed=owed,
                )
            )  # fmt: skip
        return out

    def _has_ledger(self, name: str) -> bool:
        bundle = self._bundles[name]
        if isinstance(bundle, EnvironmentBundle):
            return bundle.Phi_E is not None
        return isinstance(bundle, DeviceBundle) or (isinstance(bundle, CouplingBundle) and bundle.level is not None)

    def _wide(self, nodes: list[str], trace: str) -> Array:
        """One trace of several nodes, in the order of the session's ports."""
        ticks = max((self._run.ticks_of(name) for name in nodes), default=0)
        out = np.full((ticks, len(self._session.ports)), np.nan)
        for name in nodes:
            out[:, self._ports[name]] = rows_of(self._run, name, trace)
        return out

    def _at_the_world(self, couplings: Sequence[str], trace: str) -> Array:
        """One trace of all couplings at the environment: of those with a wave link, that of the world's end."""
        linked = self._run.recorded.links_of(ENVIRONMENT)
        out = np.full((self._run.ticks_of(ENVIRONMENT), len(self._session.ports)), np.nan)
        for name in couplings:
            at = self._of_link(ENVIRONMENT, name, trace) if name in linked else rows_of(self._run, name, trace)
            out[:, self._ports[name]] = at
        return out

    def _given(self, name: str, figures: FiguresByTick, again: Array, gaps: Sequence[UncheckedTicks]) -> list[Check]:
        """Check what a device says that its hand was given; recordings of older versions do not say it."""
        told = at_telemetry(figures, FIGURES, len(again))
        said = there(told)
        what = "its hand was given so much of the force that was asked for, by force and by time"
        found = np.where(said[:, None], again, np.nan)
        return [compare("given", name, what, FIGURES, told, found, gaps=gaps, owed=said)] if said.any() else []
