"""The device's process: it paces the loop, samples x, and applies f_v.

In a tick: wait for kT on an absolute schedule, sample, send x(k) to every coupling that holds one of its
ports, wait for their f_v(k), apply. A tick is late when its force is applied after the next tick was due;
the schedule then goes on at the next multiple of T, so that devices stay in phase.

The guard looks at a sample before anyone else does, and clips the force last before the driver: a device beyond its
limits of displacement or speed lets go and ends the session.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from manyhands.nodes import telemetry as names
from manyhands.nodes.bundle import SIMULATED, DeviceBundle
from manyhands.nodes.control import ControlLine
from manyhands.nodes.device.core import STALE_TICKS, DeviceCore
from manyhands.nodes.device.driver import Driver
from manyhands.nodes.device.guard import Guard
from manyhands.nodes.distribution import Distribution
from manyhands.nodes.exchange import Joint, establish
from manyhands.nodes.life import Life
from manyhands.protocol.clock import (
    Clock,
    Duration,
    Instant,
    RealtimeClock,
    SimulatedClock,
    from_seconds,
)
from manyhands.protocol.messages import Force, Report, Sample, Start, Telemetry
from manyhands.protocol.transport import Link


class DeviceNode:
    """A :class:`manyhands.nodes.process.Node` for a device."""

    def __init__(self, bundle: DeviceBundle, driver: Driver) -> None:
        """Make the node; ``driver`` is the device itself."""
        common = bundle.common
        self._common, self._driver = common, driver
        self._core = DeviceCore(bundle.level, bundle.K, common.period)
        self._guard = Guard(bundle.limits, common.period, common.ports)
        self._realtime = RealtimeClock()
        self._clock: Clock = SimulatedClock() if common.clock == SIMULATED else self._realtime
        self._period = from_seconds(common.period)
        self._assumed_tau = from_seconds(common.tau)
        self._joints: list[Joint] = []
        self._ticks = self._late = self._stale = self._tau_breaches = 0
        self._tau, self._true_period = Distribution(), Distribution()
        m, rows = len(common.ports), common.telemetry_ticks
        # filled in place: nothing of telemetry's size is allocated in a tick
        self._trace_x, self._trace_f = np.zeros((rows, m)), np.zeros((rows, m))
        self._speeds = np.zeros(rows)
        self._dropped_telemetry = 0

    def establish(self, links: Mapping[str, Link]) -> None:
        """Shake hands with the couplings that hold this device's ports."""
        admits = {peer.name: Force for peer in self._common.peers}
        self._joints, _ = establish(self._common, links, admits, self._realtime)

    def loop(self, start: Start, life: Life, control: ControlLine) -> None:
        """Run the ticks; however they end, the device exerts no force any more."""
        try:
            self._run(start, life, control)
        finally:
            self._driver.release()
        if (rest := self._ticks % self._common.telemetry_ticks) > 0:
            self._publish(control, rest)

    def _run(self, start: Start, life: Life, control: ControlLine) -> None:
        clock, driver, core, guard, period = self._clock, self._driver, self._core, self._guard, self._period
        epoch = Instant(start.epoch) if clock is self._realtime else Instant(0)
        stale_after = Duration(STALE_TICKS * period)
        f = np.zeros(len(self._common.ports))
        slot = tick = 0
        last: Instant | None = None
        while not life.stopping and (start.ticks == 0 or tick < start.ticks):
            clock.sleep_until(Instant(epoch + slot * period))
            sampled = clock.now()
            x = driver.sample(tick)
            breach = guard.breach(x)
            if breach is not None:
                life.fail(f"{self._common.name}: {breach}")
                return
            core.sample(x)
            for joint in self._joints:
                joint.send(Sample, tick, sampled, x)
            if not all(j.receive_into(f, tick, life, stale_after, self._hear_nothing) for j in self._joints):
                return
            held = guard.clip(f.copy())  # f is written again in the next tick
            driver.apply(held)
            applied = clock.now()
            core.apply(held, driver.intended_work())
            driver.idle()
            self._account(
                tick, x, held, Duration(applied - sampled), None if last is None else Duration(sampled - last)
            )
            due_next = epoch + (slot + 1) * period
            if applied > due_next:
                self._late += 1
                slot = -((epoch - applied) // period)  # rounded up
            else:
                slot += 1
            last = sampled
            tick += 1
            self._ticks = tick
            if tick % self._common.telemetry_ticks == 0:
                self._publish(control, self._common.telemetry_ticks)

    def report(self) -> Report:
        """Ticks, lateness, tau and period percentiles, ledger, speeds, clipped forces."""
        core = self._core
        return Report(
            self._ticks,
            {
                names.PEAK_SPEED: core.peak_speed,
                names.FINAL_SPEED: float(np.max(self._speeds)),
                **names.ledger_figures(core.ledger),
            },
            {
                names.LATE: self._late,
                names.STALE: self._stale,
                names.TAU_BREACHES: self._tau_breaches,
                names.CLIPPED: self._guard.clipped,
                "dropped_telemetry": self._dropped_telemetry,
                **names.dropped_frames(self._joints),
            },
            {names.TAU: self._tau.percentiles(), names.PERIOD: self._true_period.percentiles()},
        )

    def _hear_nothing(self) -> None:
        """The force is stale: better none than an old one."""
        self._driver.release()
        self._stale += 1

    def _account(self, tick: int, x: np.ndarray, f: np.ndarray, tau: Duration, period: Duration | None) -> None:
        self._tau.add(tau / 1e3)
        self._tau_breaches += tau > self._assumed_tau
        if period is not None:
            self._true_period.add(period / 1e3)
        row = tick % self._common.telemetry_ticks
        self._trace_x[row], self._trace_f[row] = x, f
        self._speeds[row] = self._core.speed

    def _publish(self, control: ControlLine, rows: int) -> None:
        """Telemetry of the last ``rows`` ticks; its encoding is paid once in ``telemetry_ticks`` ticks."""
        figures = {
            names.SPEED: float(np.max(self._speeds[:rows])),
            names.PEAK_SPEED: self._core.peak_speed,
            names.LATE: float(self._late),
            names.TAU_BREACHES: float(self._tau_breaches),
            names.CLIPPED: float(self._guard.clipped),
            f"{names.TAU}_p50": self._tau.quantile(0.5),
            f"{names.TAU}_p99": self._tau.quantile(0.99),
            **names.ledger_figures(self._core.ledger),
            **names.stray_frames(self._joints),
        }
        traces = (
            {names.DISPLACEMENT: self._trace_x[:rows], names.FORCE: self._trace_f[:rows]} if self._common.traces else {}
        )
        control.publish(Telemetry(self._ticks, figures, traces))
        self._dropped_telemetry = control.dropped
