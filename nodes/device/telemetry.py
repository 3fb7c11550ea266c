"""A device's figures and traces: times, breaches of what the certificate assumes, and the causes of late ticks.

All rows are filled in place: a tick allocates nothing of the telemetry's size.

A tick is late when its force is applied after the next tick was due. The reason is the device's own work, a partner's
late answer, or a processor that was not available. The time from kT, when the tick was due, until the force is applied
is divided among these three accounts, by stamps that the loop takes anyway:

    kT ... ready      own          the work left from the tick before (telemetry, mostly) went on beyond kT
       ... sampled    descheduled  the alarm had rung, and the thread did not run
       ... sent       own          sampling and sending
       ... received   partner      waiting for the forces
       ... applied    own          applying

**The cause is the greatest of the three accounts**; of equal ones the first of own, descheduled, partner. It is the
cause that a remedy should begin with, not the only one: a tick can be late by three small delays.

The stamps cannot separate some cases. An answer that came in time while this thread was not woken counts as the
partner's. A partner that was itself descheduled, or waits for a third process, counts as partner; its own report has
the details. A processor that the kernel or a hypervisor took during the thread's own work counts as that work.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from enum import StrEnum

import numpy as np

from manyhands.nodes.device.given import ForceGiven, Loss
from manyhands.nodes.device.orientation import DeviceOrientation
from manyhands.nodes.device.tick import DeviceTick
from manyhands.nodes.kernel.bundle import REALTIME, Common, DeviceRung
from manyhands.nodes.kernel.driver_statement import NO_DELAY, DeviceTiming
from manyhands.nodes.link.join import Join, dropped_frames, stray_frames
from manyhands.nodes.link.supervisor_line import ControlLine
from manyhands.nodes.rows import figures as names
from manyhands.nodes.rows.distribution import Distribution
from manyhands.nodes.rows.tick_events import TickEvents
from manyhands.nodes.rows.two_port import RowBuffer
from manyhands.protocol.clock import Duration, Instant, from_seconds
from manyhands.protocol.messages import Figures, Report, Role, Telemetry


class LateCause(StrEnum):
    """The account on which the greatest part of a late tick was spent."""

    OWN = "own"
    DESCHEDULED = "descheduled"
    PARTNER = "partner"


def cause(
    due: Instant, ready: Instant, sampled: Instant, sent: Instant, received: Instant, applied: Instant
) -> LateCause:
    """The cause of one late tick. Its instants are in the order of the arguments; only ``ready`` may precede ``due``.

    Args:
        due: kT.
        ready: when the loop had nothing more to do before kT.
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
        """No tick has been late yet; ``period`` is T, ns."""
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

    def table(self) -> dict[str, float]:
        """Late ticks by cause."""
        return {name.value: float(count) for name, count in self.counts.items()}


def given_figures(given: ForceGiven) -> dict[str, float]:
    """How much of the force that was asked for a device exerted."""
    return {
        names.FORCE_ASKED: given.asked,
        names.FORCE_GIVEN: given.given,
        names.FORCE_TIME: given.time / 1e3,
        names.FORCE_AWAY: given.lost[Loss.AWAY] / 1e3,
        names.FORCE_HELD_BACK: given.lost[Loss.HELD_BACK] / 1e3,
        names.FORCE_CUT: given.lost[Loss.CUT] / 1e3,
    }


Times = tuple[Instant, Instant, Instant, Instant, Instant, Instant]
"""The instants of a tick: due, ready, sampled, sent, received and applied, as in :func:`cause`."""


class DeviceTelemetry:
    """The figures and traces of one device.

    Attributes:
        ticks: the tick after the latest.
        epoch: the instant of tick 0, by the clock that paces the device.
        stale: how often the device let go because its force was stale.
        released: periods without force for that reason.
        jumps: how often the session had gone on to a later tick without the device.
        suspended: how often the process did not run for 50 ms or more.
    """

    def __init__(
        self,
        common: Common,
        rung: DeviceRung,
        device: DeviceTick,
        timing: DeviceTiming = NO_DELAY,
    ) -> None:
        """No tick yet.

        Args:
            common: the device's bundle.
            rung: the rung in force, with the delays and periods that it covers.
            device: whose rows these are.
            timing: of it beside its loop. Its latency is a part of every tau, and two samples may be further
                apart by as much as their age varies.
        """
        self._latency, self._jitter = from_seconds(timing.latency), from_seconds(timing.jitter)
        self._common, self._device, self._interface = common, device, device.interface
        self.epoch, self._applied = Instant(0), Instant(0)
        self._paced = common.clock == REALTIME
        self.ticks = self.stale = self.released = self.jumps = 0
        self._late = self._tau_breaches = self._period_breaches = 0
        self.suspended, self._suspended_time, self._suspended_energy = 0, 0, 0.0
        self._presses = 0
        self._peak_force = 0.0  # N, up to the last telemetry
        self._before: float | None = None  # the account when the process was suspended, until the next tick
        period = self._period = from_seconds(common.period)
        self._assume(rung)
        self._lateness = LatenessCounter(period)
        self._tau, self._true_period = Distribution(), Distribution()
        self._tau_worst = self._tau_before = 0
        self._tau_kept = True
        self._speeds = [0.0] * common.telemetry_ticks
        self._rows = RowBuffer(Role.DEVICE, common.telemetry_first, common.telemetry_ticks)
        self._sampled: Instant | None = None
        self._events = TickEvents()

    def change_rung(self, tick: int, number: int, rung: DeviceRung) -> None:
        """Record the change to the rung ``number`` at ``tick``; from now on its delay and period are covered."""
        self._events.change_rung(tick, number)
        self._assume(rung)

    def leave(self, tick: int) -> None:
        """Record that the device begins to let go for good with its sample of ``tick``."""
        self._events.leave(tick)

    def press(self, tick: int, changes: Iterable[tuple[str, bool]]) -> None:
        """Record which buttons are held down from the sample of ``tick`` on, or not any more."""
        for button, held_down in changes:
            self._events.press(tick, button, held_down)
            self._presses += held_down

    def _assume(self, rung: DeviceRung) -> None:
        self._assumed_tau, self._share = from_seconds(rung.tau), rung.share
        self._longest = from_seconds(self._common.period * (1.0 + rung.period_tolerance))

    def _covers(self, between: Duration) -> bool:
        """Whether the certificate covers a time between two samples, after the delay of the force in it.

        It covers the rung's longest period after its longest delay, and a longer one after a shorter delay. Every
        shorter period is covered, because the device then dissipates more.
        """
        if between <= self._longest:
            return True
        period = self._period
        return between <= period * self._share.longest_period(min(self._tau_before, self._assumed_tau) / period)

    def tick(self, tick: int, times: Times) -> None:
        """Keep the row of a tick that was answered; ``times`` are the instants of the device's loop."""
        due, _, sampled, _, _, applied = times
        self._applied = applied
        tau = applied - sampled + self._latency
        microseconds = tau / 1e3
        self._tau.add(microseconds)
        if tau > self._assumed_tau:
            self._tau_breaches += 1
        if tau > self._tau_worst:
            self._tau_worst = tau
        if self._sampled is not None:
            between = Duration(sampled - self._sampled)
            self._true_period.add(between / 1e3)
            if not self._covers(Duration(between + self._jitter)):
                self._period_breaches += 1
            if self._tau_kept and between < self._tau_before:  # the force before acts after this sample was taken
                self._tau_breaches += 1
        self._sampled, self._tau_before, self._tau_kept = sampled, tau, tau <= self._assumed_tau
        if applied > due + self._period:
            self._late += 1
            self._lateness.judge(*times)
        device, rows = self._device, self._rows
        self._speeds[rows.filled] = device.core.speed
        x, f, ledger, *wall = device.row()
        rows.add((x, f, ledger, (microseconds,), *wall))
        if self._interface is not None and self._before is not None:
            self._suspended_energy += max(0.0, self._before - self._interface.account.energy)
            self._before = None
        self.ticks = tick + 1

    def suspend(self, time: Duration) -> None:
        """The process did not run for ``time``, ns: the machine slept, somebody stopped it, or a debugger did."""
        self.suspended += 1
        self._suspended_time += time
        if self._interface is not None and self._before is None:
            self._before = self._interface.account.energy

    def release(self, tick: int) -> None:
        """Count a period without force, in which no force of ``tick`` came."""
        self.released += 1
        self._events.release(tick)
        self._sampled = None

    def jump(self, control: ControlLine, joins: Sequence[Join]) -> None:
        """Count a jump to a later tick; the rows so far are sent first, as the ticks of a telemetry are consecutive."""
        self.publish_rest(control, joins)
        self.jumps += 1
        self._sampled = None

    def publish(self, control: ControlLine, joins: Sequence[Join]) -> None:
        """Send telemetry once its rows are full: its encoding costs time once in ``telemetry_ticks`` ticks."""
        if self._rows.full:
            self.publish_rest(control, joins)

    def publish_rest(self, control: ControlLine, joins: Sequence[Join]) -> None:
        """Send the telemetry of the ticks since the last one, if there are any."""
        rows = self._rows.filled
        if rows == 0:
            return
        traces = self._rows.take()
        self._peak_force = max(self._peak_force, float(np.abs(traces[names.FORCE]).max()))
        of_driver = self._device.driver.figures()
        numbers = {
            names.SPEED: max(max(self._speeds[:rows]), self._device.guard.take_pace()),
            names.TAU_WORST: self._tau_worst / 1e3,
            **({names.ELAPSED: (self._applied - self.epoch) / 1e3} if self._paced else {}),
            **self._numbers(),
            **stray_frames(joins),
            **self._events.take(self.ticks - rows, self.ticks),
            **of_driver,
        }
        tables = {
            names.TAU: {"p50": self._tau.quantile(0.5), "p99": self._tau.quantile(0.99)},
            names.PERIOD: {"p50": self._true_period.quantile(0.5), "p99": self._true_period.quantile(0.99)},
            names.LATE_CAUSE: self._lateness.table(),
            **({names.BUTTONS_DOWN: self._device.buttons.table()} if self._common.buttons else {}),
            **of_driver.tables,
        }
        control.publish(Telemetry(self.ticks, Figures(numbers, tables), traces))
        self._tau_worst = 0

    def _numbers(self) -> dict[str, float]:
        """What telemetry and report have alike."""
        core, guard = self._device.core, self._device.guard
        return {
            names.LATE: float(self._late),
            names.TAU_BREACHES: float(self._tau_breaches),
            names.PERIOD_BREACHES: float(self._period_breaches),
            names.RELEASED: float(self.released),
            names.JUMPS: float(self.jumps),
            names.CLIPPED: float(guard.clipped),
            names.LET_GO: float(guard.let_go),
            names.PEAK_SPEED: core.peak_speed,
            names.PEAK_FORCE: self._peak_force,
            **names.ledger_figures(core.ledger),
            **self._speed_figures(),
            **self._interface_figures(),
            **self._orientation_figures(),
            **({names.BUTTON_PRESSES: float(self._presses)} if self._common.buttons else {}),
        }

    def _orientation_figures(self) -> dict[str, float]:
        """How the account of its orientation stands, where it has one."""
        own = self._device.orientation
        if not isinstance(own, DeviceOrientation):
            return {}
        return {
            names.ORIENTATION_LEAST: own.least,
            names.ORIENTATION_MARGIN: own.margin,
            names.ORIENTATION_HELD: float(own.spring.held),
            names.ORIENTATION_LET_GO: float(own.let_go),
            names.ORIENTATION_LATE: own.spring.late,
        }

    def _speed_figures(self) -> dict[str, float]:
        """How fast it was, where its certificate holds below a speed."""
        device = self._device
        if device.below is None:
            return {}
        return {names.BEYOND: float(device.beyond), names.FASTEST: device.fastest}

    def _interface_figures(self) -> dict[str, float]:
        interface = self._interface
        if interface is None:
            return {}
        suspended = {
            names.SUSPENDED: float(self.suspended),
            names.SUSPENDED_TIME: self._suspended_time / 1e3,
            names.SUSPENDED_ENERGY: self._suspended_energy,
        }
        return (suspended if self.suspended else {}) | {
            names.INTERFACE: interface.account.energy,
            names.INTERFACE_LEAST: interface.account.least,
            names.INTERFACE_MARGIN: interface.margin,
            names.QUICKER: float(interface.account.broken is not None),
            **given_figures(interface.given),
            names.INTERFACE_TICKS: float(interface.ticks),
            names.INTERFACE_KEPT_BACK: interface.kept_back,
            names.INTERFACE_OFFSET: interface.offset,
            names.INTERFACE_BEHIND: interface.behind,
        }

    def report(self, joins: Sequence[Join], rung: int) -> Report:
        """Ticks, lateness and its causes, breaches, ledger, speeds, clipped forces and refused frames of the run."""
        numbers = {
            **self._numbers(),
            names.FINAL_SPEED: max(self._speeds),
            names.STALE: float(self.stale),
            names.SUSPENDED: float(self.suspended),
            names.SUSPENDED_TIME: self._suspended_time / 1e3,
            names.SUSPENDED_ENERGY: self._suspended_energy,
            names.RUNG: float(rung),
        }
        tables = {
            names.TAU: self._tau.percentiles(),
            names.PERIOD: self._true_period.percentiles(),
            names.LATE_CAUSE: self._lateness.table(),
            names.DROPPED: dropped_frames(joins),
        }
        return Report(self.ticks, Figures(numbers, tables))
