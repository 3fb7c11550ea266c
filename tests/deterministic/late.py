"""Sessions in which some users sample late: slow drivers, and the telemetry of everybody."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Mapping, Sequence

import numpy as np

from manyhands.launch.plan.prepare import Prepared
from manyhands.launch.run.states import SessionPhase
from manyhands.nodes.device.drivers import Driver
from manyhands.nodes.rows import figures as names
from manyhands.nodes.rows.lateness import CouplingLateness, lateness_by_coupling
from manyhands.protocol.clock import Instant
from manyhands.protocol.codec import decode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import Telemetry

from .scheduler import VirtualClock
from .world import SimulatedSession

PERIOD = 1_000_000  # ns

Delay = Callable[[int], float]
"""By how many periods a device's sample comes late, by the number of its sample."""


class Late:
    """A driver with slow samples."""

    def __init__(self, driver: Driver, clock: VirtualClock, delay: Delay) -> None:
        self._driver, self._delay = driver, delay
        self._now, self._sleep_until = clock.now, clock.sleep_until
        self.axes = driver.axes
        self.apply, self.release, self.idle = driver.apply, driver.release, driver.idle
        self.intended_work, self.figures, self.close = driver.intended_work, driver.figures, driver.close

    def sample(self, tick: int, at: Instant) -> Sequence[float]:
        """The displacement, after a while."""
        late = int(self._delay(tick) * PERIOD)
        self._sleep_until(Instant(self._now() + late))
        return self._driver.sample(tick, Instant(at + late))


class LateSession(SimulatedSession):
    """A session in real time of so many ticks, and the telemetry of all its nodes.

    Attributes:
        told: the telemetry of each node.
    """

    def __init__(
        self,
        prepared: Prepared,
        ticks: int,
        delays: Mapping[str, Delay],
        early: Collection[str] = (),
        seed: int = 1,
        stopped: Mapping[str, tuple[int, int]] | None = None,
    ) -> None:
        """Run it.

        Args:
            prepared: the session, designed.
            ticks: how many.
            delays: of the devices that are late, by name.
            early: of these, the devices that do not wait until a tick is due: they sample once they are answered.
            seed: of all that is left open.
            stopped: the processes that do not run for a while: from when on, and for how long, in periods.
        """
        self.told: dict[str, list[Telemetry]] = defaultdict(list)

        def moved(name: str, driver: Driver, clock: VirtualClock) -> Driver:
            if name not in delays:
                return driver
            late = Late(driver, clock, delays[name])
            if name in early:
                clock.sleep_until = lambda _t: None  # type: ignore[method-assign]
            return late

        super().__init__(prepared, "realtime", seed, ticks=ticks, moved=moved)
        for node, (at, lasting) in (stopped or {}).items():
            self.scheduler.after(at * PERIOD, lambda node=node, lasting=lasting: self.stop(node, lasting * PERIOD))  # type: ignore[misc]
        self.scheduler.watch = lambda: self.conductor.phase is SessionPhase.OVER and not self.processes
        self.scheduler.run()
        self.scheduler.join()

    def taus(self, device: str) -> np.ndarray:
        """The delay of each tick, us, by tick; not a number where the device had none."""
        ticks = max(told.tick for told in self.told[device])
        out = np.full(ticks, np.nan)
        for told in self.told[device]:
            tau = told.traces[names.TAU][:, 0]
            out[told.tick - len(tau) : told.tick] = tau
        return out

    def lateness(self, coupling: str) -> CouplingLateness | None:
        """The environment's final figure of the time that the others waited for a coupling."""
        return lateness_by_coupling(self.conductor.reports["environment"].figures).get(coupling)

    def _hear(self, sender: str, frame: bytes) -> None:
        message = decode(frame, MAX_CONTROL_BYTES)
        if isinstance(message, Telemetry):
            self.told[sender].append(message)
        super()._hear(sender, frame)
