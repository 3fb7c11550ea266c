"""A device's tick without links, clocks or telemetry: driver, guard, interface and core, in the order of their calls.

The device's loop, the audit and the campaign of late instants make the same calls. So a recording is computed again as
the loop computed it, to the last bit. A tick is

    sample ... sample, with a free period after each but the last;   exert;   book.

:meth:`DeviceTick.sample` returns what the couplings receive, and :meth:`DeviceTick.exert` takes their answer. Work that
nobody waits for is in :meth:`DeviceTick.book`.

A device in its own time (:class:`OwnTimeTick`) makes one period of each sample. For one in wall time
(:class:`WallTimeTick`) what was sent for a tick stays as it is until the tick is answered, so that its account knows
what the couplings received. They know of no motion since then, so the work that the hand intended since then counts
with the next tick.

**Latency.** Where a driver states that its samples are old, or its forces act late
(:mod:`manyhands.nodes.device.specification`), the interface of the device takes each sample to be older by both. Only
the time from a sample to a force counts, so one shift stands for both. A force may then act after the next sample was
taken. The account has both at their true instants. The loop's schedule knows nothing of it: a late device is no late
loop.

**Buttons** are read with the sample that is sent. Scripts hold those of a simulated device and of a recorded motion;
any other driver tells them, if it can (``buttons()``).

**Orientation.** A device that turns in space has its law here, too (:mod:`manyhands.nodes.device.orientation`). What
rides with the sample is :attr:`DeviceTick.rides`, and what came with the answer is handed to :meth:`DeviceTick.exert`.
One whose orientation is sensed alone has no torque, and nothing that came concerns it. A driver of another package is
given the torque together with the force.

**Encoder steps.** What a simulated device sends is rounded to the steps of its encoder. Its row, ledger and account
have its true displacement, which no real device knows. So they count the energy that the steps put into the loop.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Final, Protocol, cast

from manyhands.nodes.device.core import DeviceCore, Guard
from manyhands.nodes.device.covered import CoveredHolds, TurningSpeed
from manyhands.nodes.device.drivers import Driver
from manyhands.nodes.device.interface import DeviceInterface, interface_of
from manyhands.nodes.device.orientation import (
    DeviceOrientation,
    DriverBody,
    Oriented,
    SensedOrientation,
    Telling,
    Turnable,
    TurnedBody,
)
from manyhands.nodes.device.plugin import PluginDriver
from manyhands.nodes.device.wrist import Wrist
from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.kernel.bundle import WALL, DeviceBundle, OrientationPart, PersonHand, SensedPart, SimulatedHand
from manyhands.nodes.kernel.buttons import Buttons, scripted
from manyhands.nodes.kernel.orientation import NO_RIDER, Quaternion
from manyhands.nodes.kernel.passivity import Ledger
from manyhands.nodes.kernel.timeouts import longest_hold
from manyhands.nodes.rows.two_port import Row
from manyhands.protocol.clock import Instant, from_seconds

Instants = tuple[Instant, Instant, Instant]
"""The instants of a tick in wall time, since tick 0's: x was sampled, f was applied, and the force before had ended."""

_EQUAL: Final = 1.0 + 1e-9
"""Of a speed: that of a difference of displacements, in doubles."""

NO_INSTANTS: Final = (Instant(0), Instant(0), Instant(0))


class WrenchDriver(Protocol):
    """A driver that exerts a torque together with its force."""

    def apply_wrench(
        self, f: Sequence[float], torque: Sequence[float], at: Instant, until: Instant | None = None
    ) -> Sequence[float] | None:
        """Exert f (N) of the ports and a torque (N*m) about the world's axes, as :meth:`Driver.apply`."""
        ...


class DeviceTick(ABC):
    """One device, from its samples to its forces; all instants count from tick 0's.

    Attributes:
        driver: the device itself.
        guard: its limits.
        core: its ledger.
        interface: of a device in wall time; None for one in its own.
        moved: the displacement that the driver gave last, m.
        x: the displacement of the tick's row, m.
        sent: the displacement that the couplings receive, m.
        held: the force of the tick, within what limits and account allow, N.
        below: v*, the speed below which its certificate holds, m/s; None where it holds at every speed.
        fastest: the greatest speed of an axis from one sample to the next, m/s; where there is such a speed. Of
            measured displacements it is what the speed may have been at most.
        known_to: the step to which displacements are known in that, by axis, m; 0 for true ones.
        beyond: the times that it was greater than that.
        x_a: the displacement when the force was applied, m; None where it is not known.
        instants: of the last tick, of a device in wall time.
        buttons: those that are held down in the tick.
        changed: of them, those that changed with its sample.
        done: the work of motors that hold torques until the sample of the last tick, and from then until its force, J;
            NaN where it is not known. Empty for others.
        orientation: its orientation, with the torque if it has one; None where that is no port.
        recorded_turn: how it was turned in the tick, in place of what its driver tells; None for that.
    """

    interface: DeviceInterface | None = None

    def __init__(self, bundle: DeviceBundle, driver: Driver) -> None:
        """Begin at rest."""
        common = bundle.common
        self._rungs, self._promises, self._period = bundle.rungs, bundle.promises, from_seconds(common.period)
        self._zero: Floats = [0.0] * len(common.ports)
        self._at = self._row_at = Instant(0)  # of the last sample, and of the row's
        self._first = True
        # of a driver of another package: what it really exerts of the force that it was given; it is held to its word
        self._exerted = driver.exerted if isinstance(driver, PluginDriver) else None
        self._torques = bundle.held is not None and bundle.held.works  # its motors hold them and tell their work
        simulated = bundle.inertia if isinstance(bundle.source, SimulatedHand) else None
        self._steps = simulated.step if simulated is not None and any(simulated.step) else None
        self.driver = driver
        self.guard = Guard(bundle.limits, common.period, common.ports, common.kinds)
        self.core = DeviceCore(*bundle.promises[0], common.period, bundle.allowed.energy)
        self.below = None if bundle.friction is None else bundle.friction.speed
        self.known_to = self._zero if bundle.measured is None else list(bundle.measured)
        self._jitter = bundle.timing.jitter  # s
        self.fastest, self.beyond = 0.0, 0
        self.buttons, self.changed = Buttons(common.buttons, common.period), 0
        self._scripts, self._told = bundle.scripts, getattr(driver, "buttons", None) if common.buttons else None
        self._samples = 0  # those that were sent
        self._last: Floats | None = None  # the true displacement of the last sample, where there is such a speed
        self.moved = self.x = self.sent = self.held = self._zero
        self.x_a: Floats | None = None
        self.instants: Instants = NO_INSTANTS
        self.done: tuple[float, ...] = ()
        self._until_sampled = math.nan
        self.orientation = _orientation_of(bundle, driver)
        twisting = bundle.twisting is not None and bundle.time == WALL
        self._covered = CoveredHolds(common.period, from_seconds(bundle.timing.latency)) if twisting else None
        self._left = bundle.levels if twisting else None  # what they leave of Delta_D, by rung
        self._rung = bundle.rungs[0]
        self.recorded_turn: Quaternion | None = None
        own = bundle.orientation
        turning = own.speed if isinstance(own, OrientationPart) else math.inf
        self._turning = TurningSpeed(turning, self._jitter) if twisting else None
        # of a driver of another package that exerts a torque, too
        felt = isinstance(own, OrientationPart) and own.source is None
        self._wrench: WrenchDriver | None = cast("WrenchDriver", driver) if felt else None

    @property
    def rides(self) -> Floats:
        """What rides with the sample of the tick; nothing for a device whose orientation is no port."""
        return [] if self.orientation is None else self.orientation.rides

    def sample(self, turn: int, at: Instant, first: bool = True, recorded: Floats | None = None) -> Floats:
        """Take a sample; returns the displacement that the couplings receive, m.

        In wall time the first sample of a tick is sent, and is the tick's row; in its own time every sample is.

        Args:
            turn: counts the samples from 0.
            at: the instant.
            first: whether it is the first of its tick.
            recorded: the displacement to take in place of the driver's own, m; None for that.
        """
        # a copy: a driver may fill the same list or array every time
        self.moved = x = list(map(float, self.driver.sample(turn, at)))
        if self.orientation is not None:
            self.orientation.sample(turn, at)
        if recorded is not None:
            x = recorded
        last, period, interface = self._at, self._period, self.interface
        measured = x if self._steps is None else in_steps(x, self._steps)
        goal = self.guard.report(measured, max(1, -((last - at + period // 2) // period)))
        if self.below is not None:
            self._compare(x, (period if interface is None else at - last) * 1e-9, self.below)
        self._at, self._first = at, first
        self.changed = 0
        if first and self.buttons.names:
            self._read_buttons(turn, at)
        if interface is None:
            self.x, self.sent = x, goal
        elif first:
            self.x, self._row_at = x, at
            work = self.driver.work() if self._torques else None
            self.sent = interface.send(x, goal, at, work)
            self._until_sampled = math.nan if work is None else work
            if interface.shortened:
                self._exert_now(interface.exerted, at, interface.until)
                if self._together and self.orientation is not None and interface.until is not None:
                    self.orientation.shorten(interface.until)
        return self.sent

    @property
    def _together(self) -> bool:
        """Whether a torque ends with its force."""
        return self._wrench is not None or self._covered is not None

    def _exert_now(self, f: Floats, at: Instant, until: Instant | None) -> Sequence[float] | None:
        """Exert f (N), and the orientation's torque where the driver exerts one; returns as :meth:`Driver.apply`."""
        if self._wrench is None or self.orientation is None:
            return self.driver.apply(f, at, until)
        return self._wrench.apply_wrench(f, self.orientation.torque, at, until)

    def _read_buttons(self, turn: int, at: Instant) -> None:
        if self._scripts:
            wanted = scripted(self._scripts, (turn * self._period if self.interface is None else at) * 1e-9)
        else:
            wanted = 0 if self._told is None else self._told()
        self.changed = self.buttons.take(self._samples, wanted)
        self._samples += 1

    def _compare(self, x: Floats, h: float, below: float) -> None:
        """Compare the speed of each axis, from the last sample to that at x (m), h (s) later, with ``below``, m/s.

        Of measured displacements it is the greatest that they allow: the way is up to a step longer than it looks, and
        the time between two samples up to the jitter of their age shorter. Where none is left, nothing bounds it.
        """
        before, self._last = self._last, x
        if before is None or not h > 0.0:
            return
        h -= self._jitter
        if not h > 0.0:
            self.beyond += 1
            return
        fastest = max([abs(to - at) + q for to, at, q in zip(x, before, self.known_to, strict=True)]) / h
        self.fastest = max(self.fastest, fastest)
        if fastest > below * _EQUAL:
            self.beyond += 1

    @property
    def ledger(self) -> Ledger:
        """The device's energy ledger."""
        return self.core.ledger

    @abstractmethod
    def release(self, at: Instant) -> None:
        """Exert no force from ``at`` on."""

    @abstractmethod
    def free(self, at: Instant) -> None:
        """End a period at ``at`` in which no force came: exert none, and count the intention's work."""

    @abstractmethod
    def exert(
        self, asked: Floats, at: Instant, recorded: Floats | None = None, came: Sequence[float] = NO_RIDER
    ) -> Floats:
        """Take the couplings' answer, N, and exert what limits and account allow of it from ``at`` on; returns that.

        Where the force was ``recorded``, N, that is exerted, and the other is returned. All lists are kept until the
        next call. What ``came`` with the answer is for the orientation.
        """

    @abstractmethod
    def book(self) -> None:
        """Do the accounts of the force that was exerted."""

    @abstractmethod
    def row(self) -> Row:
        """x, f_v, the ledger's total; in wall time also e(k), x at the instant of the force, the instants, the work;
        then R, Q, the torque, what was proposed, and the account of an orientation; R alone of one that is sensed.

        A part without numbers stands for what a device in its own time has not. The parts of an orientation are there
        where it is a port.
        """

    @property
    def _row_of_orientation(self) -> Row:
        return () if self.orientation is None else self.orientation.row()

    def _turn(self, came: Sequence[float], at: Instant, until: Instant | None = None, ratio: float = 1.0) -> None:
        if self.orientation is not None:
            self.orientation.exert(came, at, self.guard.ratio * ratio, until if self._together else None)

    def _release_turn(self, at: Instant) -> None:
        if self.orientation is not None:
            self.orientation.release(at)

    def skipped(self) -> None:
        """The session has gone on to a later tick: the answer to the motion sent last will not be known."""
        if self.interface is not None:
            self.interface.skipped()

    def joins(self) -> None:
        """The device comes into a session that runs already: its force rises by the ramp first."""
        if self.interface is not None:
            self.interface.given.joins()

    def conclude(self, at: Instant) -> None:
        """The process ends at ``at``."""
        if self.interface is not None:
            self.interface.conclude(at)

    def change(self, rung: int) -> None:
        """Take the level and K of ``rung``; the last two forces are zero, so the ledger stays valid."""
        self._rung = of = self._rungs[rung]
        self.core.change(*self._promises[rung])
        if self.interface is not None:
            left = None if self._left is None else self._left[rung]
            self.interface.change(of.share, of.tau, of.period_tolerance, left)
        if self.orientation is not None:
            self.orientation.change(self._rungs[rung])


class OwnTimeTick(DeviceTick):
    """A device in its own time: each sample is one period."""

    def release(self, at: Instant) -> None:
        """Exert no force."""
        self.driver.release(at)
        self._release_turn(at)

    def free(self, at: Instant) -> None:
        """Count a period with zero force."""
        self.driver.release(at)
        self._release_turn(at)
        self.held = self._zero
        self.book()

    def exert(
        self, asked: Floats, at: Instant, recorded: Floats | None = None, came: Sequence[float] = NO_RIDER
    ) -> Floats:
        """Exert what the limits allow, or the recorded force."""
        held = self.guard.clip(asked)
        self.held = exerted = held if recorded is None else recorded
        self._turn(came, at)
        self._exert_now(exerted, at, None)
        return held

    def book(self) -> None:
        """Count the period in the ledger."""
        # not before the force is applied: ZeroMQ's thread may send x(k) only while this one waits
        if self._exerted is not None:
            self._exerted(self.held)
        work = self.driver.intended_work()
        self.core.sample(self.x)
        self.core.apply(self.held, work)

    def row(self) -> Row:
        """x, f_v and the ledger's total."""
        return self.x, self.held, (self.core.ledger.total,), (), (), (), (), *self._row_of_orientation


class WallTimeTick(DeviceTick):
    """A device in wall time, with the interface that keeps account of lateness.

    Attributes:
        wall_interface: ``interface``, which is never None here.
        work: the work of the intention that :meth:`book` has counted last, J.
    """

    def __init__(self, bundle: DeviceBundle, driver: Driver) -> None:
        """Begin at rest; arguments as of :class:`DeviceTick`."""
        super().__init__(bundle, driver)
        self.interface = self.wall_interface = interface_of(bundle)
        self._asked = self._zero
        self._unknown: Floats = [math.nan] * len(self._zero)
        self._applied = Instant(0)
        self._moved: Sequence[float] | None = None
        self._until: Instant | None = None
        self.work = self._since = 0.0  # of the intention up to the motion sent, and since

    def release(self, at: Instant) -> None:
        """Exert no force from ``at`` on."""
        self.driver.release(at)
        self._release_turn(at)
        self.wall_interface.released(at)

    def free(self, at: Instant) -> None:
        """Count the intention's work; the couplings were given nothing in this period."""
        self.driver.release(at)
        self._release_turn(at)
        if self._exerted is not None:
            self._exerted(self._zero)
        self._count(self.driver.intended_work())

    def exert(
        self, asked: Floats, at: Instant, recorded: Floats | None = None, came: Sequence[float] = NO_RIDER
    ) -> Floats:
        """Exert what limits and account allow, or the recorded force."""
        within, ratio = self.guard.clip(asked), 1.0
        turning = self.orientation if isinstance(self.orientation, DeviceOrientation) else None
        if (
            self._turning is not None
            and turning is not None
            and self._turning.beyond(self.recorded_turn or turning.R, self._row_at)
        ):
            within, ratio = self._zero, 0.0  # beyond its greatest speeds, all that it is given is outside the claim
        held, until = self.wall_interface.force(asked, within, at)
        if self.guard.leaving:
            self.wall_interface.given.leaves()
        if self._covered is not None and turning is not None and ratio:
            latest = self._covered.until(self._row_at, at, self._rung, turning.rung)
            if latest is None:
                self.wall_interface.withhold()
                held, until, ratio = self._zero, None, 0.0
            else:
                until = latest if until is None else min(latest, until)
        self.held = exerted = held if recorded is None else recorded
        self._turn(came, at, until, ratio)
        self._moved = self._exert_now(exerted, at, until)
        self._asked, self._applied, self._until = asked, at, until
        return held

    def book(self) -> None:
        """Do the accounts: e(k) from what the driver measured, the ledger from what the couplings know."""
        moved, interface = self._moved, self.wall_interface
        self.x_a = None if moved is None else list(map(float, moved))
        exerted = self.held if self._exerted is None else self._exerted(self.held)
        work = self.driver.work() if self._torques and moved is not None else None
        ended = interface.applied(self.x_a, self._applied, exerted, self._until, work)
        if self._torques:
            self.done = self._until_sampled, math.nan if work is None else work
        self.instants = (self._row_at, self._applied, ended)
        # not before the force is applied: ZeroMQ's thread may send x(k) only while this one waits
        self._count(self.driver.intended_work())
        self.core.sample(self.sent, interface.speed)
        self.core.ledger.allowed = interface.allowed
        self.core.apply(self._asked, self.work)

    def row(self) -> Row:
        """x, f_v, the ledger's total, e(k), x at the instant of the force, the instants, and the work of its motors;
        then those of its orientation.
        """
        energy, x_a = self.wall_interface.account.energy, self._unknown if self.x_a is None else self.x_a
        own = self.x, self.held, (self.core.ledger.total,), (energy,), x_a, self.instants, self.done
        return *own, *self._row_of_orientation

    def _count(self, work: float) -> None:
        """Count the work of the intention up to the latest sample, J."""
        if self._first:
            self.work, self._since = self._since + work, 0.0
        else:
            self._since += work


def in_steps(x: Floats, steps: Sequence[float]) -> Floats:
    """The displacement x as an encoder gives it, m: to the nearest multiple of its step on each axis that has one."""
    return [q * math.floor(at / q + 0.5) if q > 0.0 else at for at, q in zip(x, steps, strict=True)]


def _orientation_of(bundle: DeviceBundle, driver: Driver) -> Oriented | None:
    """The orientation of a device; a torque is held until it is stale, and one period more."""
    own, T = bundle.orientation, bundle.common.period
    if own is None:
        return None
    body = _body_of(own, bundle, driver)
    if isinstance(own, SensedPart):
        return SensedOrientation(body, T, bundle.time == WALL)
    longest = longest_hold(bundle.common) if bundle.time == WALL else None
    return DeviceOrientation(own, T, bundle.rungs[0], bundle.allowance, longest, body, bundle.timing, bundle.twisting)


def _body_of(own: OrientationPart | SensedPart, bundle: DeviceBundle, driver: Driver) -> Turnable:
    """What the hand turns: what the driver tells of, or a simulated body, which a person may turn."""
    source, T = own.source, bundle.common.period
    if source is None:
        return DriverBody(cast("Telling", driver))
    goal = getattr(driver, "wanted_turn", None) if isinstance(bundle.source, PersonHand) else None
    if goal is None:
        return TurnedBody(source, T)
    most, speed = (own.torque, own.speed) if isinstance(own, OrientationPart) else (math.inf, math.inf)
    return TurnedBody(source, T, Wrist(goal, source.inertia, most, speed, T))


def tick_of(bundle: DeviceBundle, driver: Driver) -> DeviceTick:
    """The tick of a device in the time that its bundle names."""
    return WallTimeTick(bundle, driver) if bundle.time == WALL else OwnTimeTick(bundle, driver)
