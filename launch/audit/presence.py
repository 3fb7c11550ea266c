"""Which ticks each party of a recorded session owed, and whether their rows are whole.

A party owes every tick of the recording except those that it took no part in. Only the environment states these: it
records from which tick on it sent a coupling no force, in which ticks it held one, and which ticks it did not do
itself. A device cannot complete a tick without the forces of all its couplings. Where nobody states why rows are
absent, they are not checked, and neither are those in which a number is not finite. What a party states of its own
absence excuses nothing.

A user behind a wave link counts its ticks by its own clock. There the environment's ticks are taken wider
(:data:`manyhands.nodes.recorder.away.SLACK`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from manyhands.launch.audit.events import frozen_in, held_in, jumped_over
from manyhands.launch.audit.findings import EXACT, Check, CheckVerdict, UncheckedTicks, gaps_of
from manyhands.launch.recordings.run import RecordedRun, rows_of, there
from manyhands.launch.session import Session
from manyhands.launch.session.session import ENVIRONMENT
from manyhands.nodes.kernel.bundle import REALTIME
from manyhands.nodes.recorder.away import SLACK
from manyhands.nodes.rows import figures as names
from manyhands.nodes.rows.own_ticks import own_ticks_before
from manyhands.protocol.channels import APPLIED, WORK
from manyhands.protocol.messages import Role

Flags = NDArray[np.bool_]

LAST: Final = 2
"""In real time a session that is ended leaves so many of its last ticks to some nodes alone: a device and its coupling
may be a tick ahead of the environment, and it one ahead of them."""


class Presence:
    """The ticks that each party owed, and the rows that are there.

    Attributes:
        owed: by node, its own ticks of the recording that are to be checked.
        frozen: by coupling in the tick, the ticks in which the environment sent it no force.
        held: by coupling in the tick, those in which it was held; a coupling need not have a row in them.
    """

    def __init__(self, run: RecordedRun, session: Session, ledgers: frozenset[str]) -> None:
        """Read rows and events.

        Args:
            run: the recording.
            session: of the recording.
            ledgers: the nodes that keep a ledger.
        """
        self._run, self._ledgers = run, ledgers
        figures, ticks = run.figures.get(ENVIRONMENT, ()), run.ticks_of(ENVIRONMENT)
        rows = {name: self._any(name) for name in run.recorded.roles}
        jumped = jumped_over(figures, ticks) & ~rows[ENVIRONMENT]
        done = rows[ENVIRONMENT] | jumped
        self.owed: dict[str, Flags] = {ENVIRONMENT: ~jumped}
        self.frozen: dict[str, Flags] = {}
        self.held: dict[str, Flags] = {}
        excused: dict[str, Flags] = {}
        for name in session.couplings:
            rate, linked = run.recorded.rate_of(name), name in run.recorded.linked
            own = np.zeros(ticks, dtype=np.bool_) if linked else fitted(rows[name], ticks)
            frozen = frozen_in(figures, name, own, done)
            absent = frozen | jumped
            if not linked:
                self.frozen[name], self.held[name] = frozen, held_in(figures, name, ticks)
                absent |= self.held[name]
            if linked:
                absent = _wider(absent, round(SLACK / run.period))
            at = np.minimum(own_ticks_before(np.arange(run.ticks_of(name)), 1.0 / rate), ticks - 1)
            excused[name] = absent[at] if ticks else np.zeros(len(at), dtype=np.bool_)
            self.owed[name] = rows[name] | ~excused[name]
        for device, role in run.recorded.roles.items():
            if role is Role.DEVICE:
                couplings = [name for name in session.couplings if device in session.devices_of(name)]
                out = np.zeros(run.ticks_of(device), dtype=np.bool_)
                for name in couplings:
                    out |= excused[name]
                self.owed[device] = rows[device] | ~out
        if run.recorded.clock == REALTIME:
            # a user far away hears of the end later, and a host of such users is told of ticks after its own last
            ends = LAST + (round(SLACK / run.period) if run.recorded.linked else 0)
            for name, owed in self.owed.items():
                last = math.ceil(ends * run.recorded.rate_of(name))
                if not (~rows[name])[: -last or None].all():
                    owed[-last:] &= rows[name][-last:]

    def _any(self, node: str) -> Flags:
        """The ticks of which a node has any number."""
        out = np.zeros(self._run.ticks_of(node), dtype=np.bool_)
        for trace in self._traces(node):
            out |= np.isfinite(rows_of(self._run, node, trace)).any(axis=1)
        return out

    def _traces(self, node: str) -> list[str]:
        """The traces whose rows a node owes: all but a ledger that it does not keep, and x_a and the work of motors,
        which not every device can measure.
        """
        of = (topic.trace for topic in self._run.recorded.topics(node))
        return [one for one in of if one not in (APPLIED, WORK) and (one != names.LEDGER or node in self._ledgers)]

    def check(self, node: str) -> Check:
        """Whether every row that a node owed is there, and every number in it finite."""
        owed, traces = self.owed[node], self._traces(node)
        whole = {trace: there(rows_of(self._run, node, trace)) for trace in traces}
        none = owed & ~self._any(node)
        gaps = gaps_of(none, "it has no row there, and the environment does not state that it took no part")
        by_why: dict[str, Flags] = {}
        for trace, rows in whole.items():
            missing = owed & ~none & ~rows
            if missing.any():
                by_why[trace] = missing
        gaps += _named(by_why)
        numbers = int(sum(int((owed & rows).sum()) for rows in whole.values()))
        verdict = CheckVerdict.MISSING if gaps else CheckVerdict.HOLDS if numbers else CheckVerdict.UNCHECKED
        lost = sum(gap.end - gap.begin for gap in gaps_of(none | _union(by_why, len(owed)), ""))
        remark = f"{lost} of {int(owed.sum())} ticks are absent or not finite" if gaps else ""
        what = "every tick that it took part in is there, and every number is finite"
        return Check("rows", node, what, verdict, numbers, None, 0, tuple(gaps), 0.0, EXACT, remark)


def _union(flags: Mapping[str, Flags], ticks: int) -> Flags:
    out = np.zeros(ticks, dtype=np.bool_)
    for one in flags.values():
        out |= one
    return out


def _named(missing: Mapping[str, Flags]) -> list[UncheckedTicks]:
    """The ticks in which some traces are not finite, as gaps that name the traces."""
    out: list[UncheckedTicks] = []
    alike: dict[bytes, list[str]] = {}
    for trace, ticks in missing.items():
        alike.setdefault(ticks.tobytes(), []).append(trace)
    for traces in alike.values():
        many = "are" if len(traces) > 1 else "is"
        out += gaps_of(missing[traces[0]], f"{', '.join(traces)} {many} absent, or not finite")
    return out


def _wider(ticks: Flags, by: int) -> Flags:
    """The marked ticks, and so many before and after each."""
    out = ticks.copy()
    for gap in gaps_of(ticks, ""):
        out[max(0, gap.begin - by) : gap.end + by] = True
    return out


def fitted(rows: Flags, ticks: int) -> Flags:
    """The first ``ticks`` of these flags, filled up with False."""
    out = np.zeros(ticks, dtype=np.bool_)
    out[: len(rows)] = rows[:ticks]
    return out
