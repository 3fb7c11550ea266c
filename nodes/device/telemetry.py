"""What a device keeps of its ticks: times, breaches of what the certificate assumes, traces, and what it tells of them.

All is filled in place: nothing of telemetry's size is allocated in a tick.

Why a tick was late: the device's own work, a partner's answer, or a processor that was not to be had.

A tick is late when its force is applied after the next tick was due. The time from kT, when it was due, to then is
all spent on one of three accounts, known from stamps that the loop takes anyway:

    kT ... ready      own          what the tick before left to do (telemetry, mostly) went on beyond kT
       ... sampled    descheduled  the alarm had rung, and the thread did not run
       ... sent       own          sampling and sending
       ... received   partner      waiting for the forces
       ... applied    own          applying

**The cause is the greatest of the three accounts**; of equal ones the first of own, descheduled, partner. It is the
cause that a remedy should begin with, not the only one: a tick can be late by three small delays.

What cannot be told apart from within: an answer that came in time while this thread was not woken is the partner's;
a partner that was itself descheduled, or waits for another, is a partner (its own report tells more); a processor that
the kernel or a hypervisor took while the thread did its own work counts as that work.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from enum import StrEnum

import numpy as np

from manyhands.nodes import telemetry as names
from manyhands.nodes.arithmetic import Floats
from manyhands.nodes.bundle import Common
from manyhands.nodes.device.core import DeviceCore, Guard
from manyhands.nodes.peer_link import PeerLink
from manyhands.nodes.supervisor_line import ControlLine
from manyhands.nodes.telemetry import Distribution
from manyhands.nodes.tick_events import TickEvents
from manyhands.protocol.clock import Duration, Instant, from_seconds
from manyhands.protocol.messages import Report, Telemetry


class LateCause(StrEnum):
    """On what the greatest part of a late tick was spent."""

    OWN = "own"
    DESCHEDULED = "descheduled"
    PARTNER = "partner"


def cause(
    due: Instant, ready: Instant, sampled: Instant, sent: Instant, received: Instant, applied: Instant
) -> LateCause:
    """The cause of one late tick; its instants are in this order, only ``ready`` may come before ``due``.

    Args:
        due: kT.
        ready: when the loop had nothing left to do but to wait for kT.
        sampled: when it had woken and sampled x(k).
        sent: when x(k) was sent to every coupling.
        received: when the last force was there.
        applied: when f_v(k) was applied.
    """
    began = max(due, ready)
    own = (began - due) + (sent - sampled) + (applied - received)
    descheduled = sampled - began
    greatest = max(own, descheduled, received - sent)
    if own == greatest:
        return LateCause.OWN
    return LateCause.DESCHEDULED if descheduled == greatest else LateCause.PARTNER


class LatenessCounter:
    """Counts late ticks by their cause.

    Attributes:
        counts: late ticks by cause.
    """

    __slots__ = ("_period", "counts")

    def __init__(self, period: Duration) -> None:
        """No tick has been late yet; ``period``: T."""
        self.counts = dict.fromkeys(LateCause, 0)
        self._period = period

    def judge(
        self, due: Instant, ready: Instant, sampled: Instant, sent: Instant, received: Instant, applied: Instant
    ) -> LateCause | None:
        """Count the tick if it was late; the arguments are those of :func:`cause`.

        Returns:
            Its cause; None for a tick that was in time.
        """
        if applied <= due + self._period:
            return None
        found = cause(due, ready, sampled, sent, received, applied)
        self.counts[found] += 1
        return found

    def figures(self) -> dict[str, int]:
        """Late ticks by cause, under the names of the report: ``late_own`` and so on."""
        return {f"late_{name.value}": count for name, count in self.counts.items()}


PERIOD_TOLERANCE = 0.25
"""Part of a period by which two samples may be more or less than a period apart before that is told as a breach."""

Times = tuple[Instant, Instant, Instant, Instant, Instant, Instant]
"""Of a tick: when it was due, when the loop was ready, and when it had sampled, sent, received and applied."""


class DeviceTelemetry:
    """The figures of one device.

    Attributes:
        ticks: done.
        stale: times that the force was stale.
        released: periods without force for that reason.
        jumps: times that the session had gone on without the device.
    """

    def __init__(self, common: Common, tau: Duration, told: Callable[[], Mapping[str, float]] = dict) -> None:
        """``tau``: what the certificate assumes; ``told``: what the driver has to tell with the telemetry."""
        self._common, self._told = common, told
        self.ticks = self.stale = self.released = self.jumps = 0
        self._late = self._tau_breaches = self._period_breaches = 0
        self._assumed_tau = tau
        period = self._period = from_seconds(common.period)
        self._shortest = Duration(round(period * (1.0 - PERIOD_TOLERANCE)))
        self._longest = Duration(round(period * (1.0 + PERIOD_TOLERANCE)))
        self._lateness = LatenessCounter(period)
        self._tau, self._true_period = Distribution(), Distribution()
        self._tau_worst = 0
        m, rows = len(common.ports), common.telemetry_ticks
        self._trace_x: list[Floats] = [[0.0] * m] * rows
        self._trace_f: list[Floats] = [[0.0] * m] * rows
        self._trace_tau: list[int] = [0] * rows
        self._energy = [0.0] * rows
        self._speeds = [0.0] * rows
        self._filled, self._rows = 0, common.telemetry_first
        self._sampled: Instant | None = None
        self._events = TickEvents()

    def change_rung(self, tick: int, rung: int, tau: Duration) -> None:
        """Another rung from ``tick`` on, whose certificate assumes another tau."""
        self._events.change_rung(tick, rung)
        self._assumed_tau = tau

    def tick(self, tick: int, x: Floats, f: Floats, core: DeviceCore, times: Times) -> None:
        """A tick that was answered; x (m) and f (N) are kept until they are told."""
        due, _, sampled, _, _, applied = times
        tau = applied - sampled
        self._tau.add(tau / 1e3)
        if tau > self._assumed_tau:
            self._tau_breaches += 1
        if tau > self._tau_worst:
            self._tau_worst = tau
        if self._sampled is not None:
            between = sampled - self._sampled
            self._true_period.add(between / 1e3)
            if not self._shortest <= between <= self._longest:
                self._period_breaches += 1
        self._sampled = sampled
        if applied > due + self._period:
            self._late += 1
            self._lateness.judge(*times)
        row = self._filled
        self._trace_x[row], self._trace_f[row] = x, f
        self._trace_tau[row], self._energy[row] = tau, core.ledger.total
        self._speeds[row] = core.speed
        self._filled = row + 1
        self.ticks = tick + 1

    def release(self, tick: int) -> None:
        """A period without force, for none of ``tick`` was heard of."""
        self.released += 1
        self._events.release(tick)
        self._sampled = None

    def jump(self, control: ControlLine, core: DeviceCore, guard: Guard, peer_links: Sequence[PeerLink]) -> None:
        """The session is at a later tick: what was kept is told first, for rows follow each other."""
        self.publish_rest(control, core, guard, peer_links)
        self.jumps += 1
        self._sampled = None

    def publish(self, control: ControlLine, core: DeviceCore, guard: Guard, peer_links: Sequence[PeerLink]) -> None:
        """Telemetry when it is time; its encoding is paid once in ``telemetry_ticks`` ticks."""
        if self._filled == self._rows:
            self.publish_rest(control, core, guard, peer_links)

    def publish_rest(
        self, control: ControlLine, core: DeviceCore, guard: Guard, peer_links: Sequence[PeerLink]
    ) -> None:
        """Telemetry of the ticks since the last, if there are any."""
        rows = self._filled
        if rows == 0:
            return
        figures = {
            names.SPEED: max(self._speeds[:rows]),
            names.PEAK_SPEED: core.peak_speed,
            names.LATE: float(self._late),
            names.TAU_BREACHES: float(self._tau_breaches),
            names.TAU_WORST: self._tau_worst / 1e3,
            names.PERIOD_BREACHES: float(self._period_breaches),
            names.RELEASED: float(self.released),
            names.JUMPS: float(self.jumps),
            names.CLIPPED: float(guard.clipped),
            names.LET_GO: float(guard.let_go),
            f"{names.TAU}_p50": self._tau.quantile(0.5),
            f"{names.TAU}_p99": self._tau.quantile(0.99),
            f"{names.PERIOD}_p50": self._true_period.quantile(0.5),
            f"{names.PERIOD}_p99": self._true_period.quantile(0.99),
            **names.ledger_figures(core.ledger),
            **names.stray_frames(peer_links),
            **self._events.take(self.ticks - rows, self.ticks),
            **self._told(),
        }
        traces = {
            names.DISPLACEMENT: np.array(self._trace_x[:rows]),
            names.FORCE: np.array(self._trace_f[:rows]),
            **names.ledger_trace(core.ledger, self._energy[:rows]),
            names.TAU: np.array(self._trace_tau[:rows], dtype=np.float64)[:, None] / 1e3,
        }
        control.publish(Telemetry(self.ticks, figures, traces))
        self._filled, self._rows, self._tau_worst = 0, self._common.telemetry_ticks, 0

    def report(self, core: DeviceCore, guard: Guard, peer_links: Sequence[PeerLink], rung: int) -> Report:
        """The device's last word."""
        return Report(
            self.ticks,
            {
                names.PEAK_SPEED: core.peak_speed,
                names.FINAL_SPEED: max(self._speeds),
                **names.ledger_figures(core.ledger),
            },
            {
                names.LATE: self._late,
                **self._lateness.figures(),
                names.STALE: self.stale,
                names.RELEASED: self.released,
                names.JUMPS: self.jumps,
                names.RUNG: rung,
                names.TAU_BREACHES: self._tau_breaches,
                names.PERIOD_BREACHES: self._period_breaches,
                names.CLIPPED: guard.clipped,
                names.LET_GO: guard.let_go,
                **names.dropped_frames(peer_links),
            },
            {names.TAU: self._tau.percentiles(), names.PERIOD: self._true_period.percentiles()},
        )
