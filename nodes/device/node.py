"""The device's process: it paces the loop, samples x, and applies f_v.

In each tick the node waits for kT on an absolute schedule, samples, and sends x(k) to every coupling that holds one of
its ports. It then waits for their f_v(k), and applies it. A tick is late when its force is applied after the next tick
was due. The schedule then goes on at the next multiple of T, so that devices stay in phase. Where a driver states the
age of its samples and the delay of its forces, both count in tau, and not in the loop's lateness.

A device whose force is stale lets go and runs free: in every period it samples, guards and keeps its ledger, without
force. It sends its x(k) again, in every period at first and then more rarely (:mod:`manyhands.nodes.link.repeats`),
until a coupling answers, by the force of this tick or of a later one, with which the device goes on.

What the device itself does in a tick, from driver to ledger, is in :mod:`manyhands.nodes.device.tick`. A device in wall
time feels lateness. Between it and its couplings stands its interface (:mod:`manyhands.nodes.device.interface`), which
keeps account of the energy that lateness puts in, and bounds it.

The guard (:mod:`manyhands.nodes.device.core`) checks a sample before it is sent, and clips the force last before the
driver. A device beyond its limits of displacement or speed lets go. It takes hold again once it is back within them.
"""

from __future__ import annotations

import secrets
from collections.abc import Mapping, Sequence

from manyhands.nodes.device.drivers import Driver
from manyhands.nodes.device.plugin import PluginDriver
from manyhands.nodes.device.telemetry import DeviceTelemetry
from manyhands.nodes.device.tick import tick_of
from manyhands.nodes.joins import establish
from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.kernel.bundle import SIMULATED, DeviceBundle
from manyhands.nodes.kernel.lifetime import Life
from manyhands.nodes.kernel.log import LogEvent
from manyhands.nodes.kernel.orientation import MOST_LIFE, NO_RIDER
from manyhands.nodes.kernel.realtime import way_giver
from manyhands.nodes.kernel.timeouts import LISTEN_TICKS, timeouts
from manyhands.nodes.link.join import Inner, Join, OwnEnd, Received, await_all
from manyhands.nodes.link.relink import follow
from manyhands.nodes.link.repeats import Repeats
from manyhands.nodes.link.supervisor_line import NOT_AT_ALL, ControlLine
from manyhands.protocol.clock import Clock, Duration, Instant, RealtimeClock, SimulatedClock, from_seconds
from manyhands.protocol.messages import Absent, Report, Rung, Sample, Start
from manyhands.protocol.transport import Link

SUSPENSION = from_seconds(0.05)
"""How long a process must not run to count as suspended: a busy scheduler makes it wait for some milliseconds."""


BREATH = from_seconds(0.05)
"""How long a loop may be behind its schedule without waiting once; then it leaves a period out.

A loop that needs more than T a tick would never wait, and the kernel ends a process that computes for too long at a
real-time priority (:data:`manyhands.nodes.kernel.realtime.RUNAWAY_TIME`).
"""


class DeviceNode:
    """A :class:`manyhands.nodes.link.process.Node` for a device, and the :class:`Listener` on its links.

    Attributes:
        device: the device with its driver, its limits and its accounts.
        joins: the links to the couplings, once every handshake is done.
    """

    def __init__(
        self, bundle: DeviceBundle, driver: Driver, clock: Clock | None = None, inside: Sequence[Inner] = ()
    ) -> None:
        """Take the device's part of the session.

        Args:
            bundle: that part.
            driver: the device itself.
            clock: measures waiting times; by default it is the realtime clock.
            inside: the couplings in this process, whose ticks this node's loop runs. They shake hands before it does.
        """
        common = bundle.common
        self._common, self._rungs = common, bundle.rungs
        self.device = tick_of(bundle, driver)
        if self.device.orientation is not None:
            self.device.orientation.life = float(1 + secrets.randbelow(MOST_LIFE))
        self._realtime: Clock = clock or RealtimeClock()
        self._inside = inside
        self._timeouts = timeouts(common)
        self._stale = self._timeouts.stale or Duration(0)  # after this wait a force is stale; 0 where nothing is late
        self._suspension = Duration(max(SUSPENSION, self._stale))
        self._clock: Clock = SimulatedClock() if common.clock == SIMULATED else self._realtime
        self._period = from_seconds(common.period)
        self.joins: list[Join] = []
        self._account = DeviceTelemetry(common, bundle.rungs[0], self.device, bundle.timing)
        self._free = False  # it has let go
        self._rung = self._next_rung = 0
        self._zero: Floats = [0.0] * len(common.ports)
        self._life: Life | None = None  # until the loop begins
        self._epoch = Instant(0)

    @property
    def by_itself(self) -> tuple[str, ...]:
        """What its device does by itself, as the driver of another package states; a sentence each."""
        driver = self.device.driver
        return driver.by_itself if isinstance(driver, PluginDriver) else ()

    def establish(self, links: Mapping[str, Link]) -> None:
        """Shake hands with the couplings that hold this device's ports."""
        self.joins, _ = establish(OwnEnd(self._common, self._realtime, inside=self._inside), links)

    def loop(self, start: Start, life: Life, control: ControlLine) -> None:
        """Run the ticks; however they end, the device exerts no force afterwards.

        Args:
            start: first tick, number of ticks and epoch.
            life: whether the node should still run.
            control: the line to the supervisor.
        """
        try:
            self._exert(start, life, control)
            self._account.publish_rest(control, self.joins)
            self.device.conclude(self._now())  # for the report alone: telemetry ends with its last row
        finally:
            for join in self.joins:
                join.publish_rest()

    def _exert(self, start: Start, life: Life, control: ControlLine) -> None:
        try:
            self._run(start, life, control)
        finally:
            self.device.driver.release(self._now())

    def _run(self, start: Start, life: Life, control: ControlLine) -> None:
        clock, device, period = self._clock, self.device, self._period
        driver, guard, in_wall_time = device.driver, device.guard, device.interface is not None
        account, joins = self._account, self.joins
        self._life, give_way = life, way_giver()
        epoch = self._epoch = account.epoch = Instant(start.epoch) if clock is self._realtime else Instant(0)
        f, ports = [0.0] * self._common.width, len(self._common.ports)
        turns_in_space = device.orientation is not None
        tick, turns, slot, turn = start.tick, 0, 0, self._timeouts.turn
        sent_tick = -1  # the tick of the last sample
        repeats = Repeats(period, clock.now())
        waited = clock.now()  # when it waited last for a sample to be due
        if tick > 0:  # the session runs already, so this device joins at the next multiple of T
            slot = max(0, -((epoch - clock.now()) // period))
            device.joins()
        while not life.stopping and (start.ticks == 0 or tick < start.ticks):
            life.look(self._realtime.now())
            if turns % LISTEN_TICKS == 0 or self._free:
                self._listen(control)
                if life.leaving:
                    self._leave(tick, life)
            due = Instant(epoch + slot * period)
            ready = clock.now()
            if ready < due:
                waited = ready
            elif ready - waited > BREATH:
                slot = -((epoch - ready) // period)
                due = Instant(epoch + slot * period)
            clock.sleep_until(due)
            sampled = clock.now()
            let_go = guard.let_go
            first = sent_tick != tick
            x = device.sample(turns, Instant(sampled - epoch), first)
            if turns_in_space:
                x = x + device.rides
            if first:
                sent_tick = tick
                repeats.begin(sampled)
                if device.changed:
                    account.press(tick, device.buttons.changes(device.changed))
            if guard.let_go != let_go:
                control.log.note(LogEvent.BREACH, tick=tick, reason=guard.why)
            if first or repeats.due(sampled):
                for join in joins:
                    if join.tick != tick:
                        join.send(Sample, tick, sampled, x, device.buttons.state)
            sent = clock.now()
            turns += 1
            answered: int | None = tick
            for join in joins:
                # a device that runs free waits once, to the end of the period
                result = join.hear(f, tick, NOT_AT_ALL if self._free else turn, self)
                if result is not Received.SIGNAL:
                    answered = self._await_forces(join, result, f, x, tick, sampled, life, control)
                    break
            if life.stopping:
                return
            received = clock.now()
            if self._stale:  # no wait is longer than until a force is stale, and no work or scheduler takes so long
                missed = max(sampled - max(due, ready), sent - sampled, received - sent - self._stale)
                if missed > self._suspension:
                    account.suspend(Duration(missed))
            if answered is None:  # no force in time: the tick is not counted, and comes again in the next period
                device.free(Instant(received - epoch))
                driver.idle(Instant((slot + 1) * period))
                account.release(tick)
                slot += 1
                continue
            if answered > tick:
                self._jump(control)
                tick = answered
            came = f[ports:] if turns_in_space else NO_RIDER
            device.exert(f[:ports], Instant(received - epoch), came=came)  # f is written again in the next tick
            applied = received if in_wall_time else clock.now()  # in wall time the instant that the driver was given
            give_way()
            device.book()
            for join in joins:
                join.settle(tick)
            driver.idle(Instant((slot + 1) * period))
            if self._next_rung != self._rung:
                self._change_rung(tick)
            account.tick(tick, (due, ready, sampled, sent, received, applied))
            # after a late tick the next multiple of T, by a division that rounds up
            slot = -((epoch - applied) // period) if applied > epoch + (slot + 1) * period else slot + 1
            self._free = False
            tick += 1
            account.publish(control, joins)

    def report(self) -> Report:
        """Ticks, lateness and its causes, tau and period percentiles, ledger, speeds, clipped forces."""
        return self._account.report(self.joins, self._rung)

    def on_other_tick(self, join: Join, other: int, awaited: int) -> bool:
        """Stop waiting at the force of a later tick: the session has gone on without this device.

        It is zero, or in real time the force of a coupling that was held.
        """
        return other > awaited and (join.other_zero or self._stale > 0)

    def on_notice(self, join: Join, message: Rung | Absent) -> bool:
        """Note the coupling's change of rung; the zero force that follows is the first of the new rung."""
        if isinstance(message, Rung) and message.rung < len(self._rungs):
            self._next_rung = message.rung
        return False

    def flooded(self, text: str) -> None:
        """End the node: a coupling floods its link, and its forces cannot be found among other frames in time."""
        if self._life is not None:
            self._life.fail(text)

    def close(self) -> None:
        """Release the driver's files and sockets."""
        self.device.driver.close()

    def _await_forces(
        self,
        last: Join,
        result: Received,
        f: Floats,
        x: Floats,
        tick: int,
        sampled: Instant,
        life: Life,
        control: ControlLine,
    ) -> int | None:
        """Wait for the force of every coupling, after listening to ``last`` gave ``result`` in place of its force.

        In real time the wait ends when the force is stale, for an old force may do harm. Where several couplings hold
        ports of this device, one may send it on to a later tick. The others must then come to that tick as well, so
        the device sends them its sample of it, with a message why the ticks in between are missing.

        Returns:
            The tick that the couplings answer: ``tick``, or a later one. None where no force came in
            time and the device has let go, and where the node should end.
        """
        timeouts, joins = self._timeouts, self.joins
        repeats = Repeats(timeouts.again, self._realtime.now())
        due = None if timeouts.stale is None else Instant(sampled + (self._period if self._free else timeouts.stale))

        def react(join: Join, result: Received, tick: int) -> int:
            if result is Received.DECLINED:
                tick = join.tick = join.other_tick
                join.take_other(f, "future_tick")
                for other in joins:  # a coupling that answered the earlier tick must answer this one as well
                    if other.tick != tick:
                        other.notify(Absent(self._common.name))  # no sample comes for the ticks in between
                        other.send(Sample, tick, sampled, x, self.device.buttons.state)
            elif result is Received.RECONNECTED:
                join.send(Sample, tick, sampled, x, self.device.buttons.state)
            return tick

        def pause(tick: int) -> Duration | None:
            now = self._realtime.now()
            life.check()
            self._listen(control, idle=due is None and not self._anybody)
            if due is not None and (now >= due or not self._anybody):
                self._let_go()
                return None
            if life.stopping:
                return None
            if due is None and repeats.due(now):
                for join in joins:
                    if join.tick != tick:
                        join.send_again()
            return timeouts.look if due is None else min(Duration(due - now), timeouts.look)

        return await_all(joins, last, f, react(last, result, tick), self, react, pause)

    @property
    def _anybody(self) -> bool:
        """Whether there is a peer to wait for."""
        return any(join.reachable for join in self.joins)

    def _now(self) -> Instant:
        """The present instant, since tick 0's."""
        return Instant(self._clock.now() - self._epoch)

    def _let_go(self) -> None:
        """Exert no force: the last one is stale, and no force is safer than an old one."""
        if not self._free:
            self.device.release(self._now())
            self._account.stale += 1
        self._free = True

    def _leave(self, tick: int, life: Life) -> None:
        """Let the hand go by a ramp, from ``tick`` on, and end the process once it is free."""
        guard = self.device.guard
        if not guard.leaving:
            guard.leave()
            self._account.leave(tick)
        elif not guard.holds:
            life.stopping = True

    def _listen(self, control: ControlLine, idle: bool = False) -> None:
        """Follow the supervisor's messages; where ``idle``, wait a moment for one."""
        word = control.listen(self._timeouts.look) if idle else control.listen()
        while word is not None:
            follow(word, self.joins, control)
            word = control.listen()
        for join in self.joins:
            join.listen()

    def _jump(self, control: ControlLine) -> None:
        """Send the telemetry so far: the session is at a later tick."""
        self.device.skipped()
        self._account.jump(control, self.joins)
        for join in self.joins:
            join.publish_rest()  # rows follow each other

    def _change_rung(self, tick: int) -> None:
        """Take the level and K of the next rung; the force is zero in this tick, so the ledger stays valid."""
        self._rung = self._next_rung
        self.device.change(self._rung)
        self._account.change_rung(tick, self._rung, self._rungs[self._rung])
