"""Computes a recorded device again, by its own core and its own hand, from the forces that it felt.

Where the hand is simulated, the displacement follows from the forces. Then the work that the hand intended is known,
and the ledger follows, all to the last bit.

A device that received no force for a while ran free for some periods. A process that ended and came back began at rest.
Neither has a row; both are recorded as events, with their ticks (:mod:`manyhands.launch.audit.events`). Where
events are missing, the device is not checked from there on, until a new process begins.

**A device in wall time** (:class:`FollowedInWallTime`) recorded the instants of its events: s(k), when x was
sampled, a(k), when its force was applied, and when the force before had ended. Driver, guard, interface and core make
the same calls as in the loop, with the forces that the couplings handed on. So x(s(k)), the motion that the couplings
received, the exerted force, the account e(k) and what the hand was given follow to the last bit. Free periods need no
instants of their own: the device exerts no force in them, and a sample or a release in between does not cut its
integration.

The ledger sums up what the hand's intention did, free period by free period. The audit computes it in one piece from
sample to sample. Only the rounding of these sums differs. In units in the last place of all the energy that was
exchanged so far, each free period adds a few: the sum itself, and a part of a grid period that is added and subtracted
once more. :data:`ROUNDING` of them are allowed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from manyhands.launch.audit.events import Happening
from manyhands.launch.audit.findings import UncheckedTicks
from manyhands.launch.audit.recompute import Array, FollowedParty, Lost, from_there_on
from manyhands.launch.audit.replay import GivenMotion
from manyhands.launch.recordings.run import there
from manyhands.nodes.device.drivers import Driver
from manyhands.nodes.device.telemetry import given_figures
from manyhands.nodes.device.tick import DeviceTick, OwnTimeTick, WallTimeTick
from manyhands.nodes.device.wall_time import LONGEST_GAP
from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.kernel.bundle import DeviceBundle
from manyhands.nodes.kernel.orientation import Quaternion
from manyhands.nodes.monitor.given import FIGURES
from manyhands.nodes.rows import figures as names
from manyhands.protocol.channels import WORK
from manyhands.protocol.clock import Instant, from_seconds

MOST_FREE: Final = 600_000
"""The most free periods of a device that are computed, in all: ten minutes at 1 kHz."""

ROUNDING: Final = 64.0
"""Units in the last place of the energy exchanged so far, by which each free period may change the ledger's sum."""

SENT: Final = "sent"
"""The field of the displacement that the couplings received, m."""

ENDED: Final = "ended"
"""The field of the instant at which the force before had ended, ns since tick 0."""

GIVEN: Final = "given"
"""The field of the force that a device's hand was given up to the tick: the figures of GivenForce."""

TOLERANCE: Final = "tolerance"
"""The field of the ledger's tolerance, J; 0 before the first free period of a device in wall time."""

_EPSILON: Final = float(np.finfo(np.float64).eps)


@dataclass(frozen=True, eq=False)
class DeviceRows:
    """What a device recorded, and what its couplings handed on; NaN in ticks without a row.

    Attributes:
        x: at the instants s(k), ticks x axes, m.
        f: the force that was exerted from a(k) on, ticks x axes, N.
        asked: the force that the couplings handed on, ticks x axes, N.
        instants: of a device in wall time s(k), a(k), and when the force before had ended, ticks x 3, ns since tick 0.
        applied: likewise x at the instants a(k), ticks x axes, m; NaN where the device could not measure it.
        let_go: the tick from which on the device may have let go; None if it never did.
        stopped: by tick, whether its process may not have run for a while.
        turned: how it was turned, ticks x 4; None where its orientation is no port.
        unexerted: the tick from which on its hardware may have exerted other forces than it was given; None if it
            never did.
        work: of motors that hold torques, until s(k) and from then until a(k), ticks x 2, J; None for others.
    """

    x: Array
    f: Array
    asked: Array
    instants: Array
    applied: Array
    let_go: int | None
    stopped: NDArray[np.bool_]
    unexerted: int | None = None
    turned: Array | None = None
    work: Array | None = None


class FollowedDevice(FollowedParty):
    """A device with its hand, from the forces that it felt and those of its couplings.

    Attributes:
        motion_gaps: the ticks in which motion and ledger cannot be computed, for the motion does not follow.
    """

    _tick: DeviceTick

    def __init__(
        self, bundle: DeviceBundle, make: Callable[[], Driver | str], rows: DeviceRows, guarded: bool = True
    ) -> None:
        """Take what was recorded.

        Args:
            bundle: the device's part of the session.
            make: makes the device with its hand, at rest; or returns the reason why its motion does not follow. Then
                the recorded motion is taken, and motion and ledger are not computed.
            rows: what was recorded.
            guarded: whether its guard can be followed after it has let go.
        """
        self._bundle, self._make, self._recorded, self._guarded = bundle, make, rows, guarded
        self._period = from_seconds(bundle.common.period)
        self._freed = 0
        self._made: Driver | str = make()
        self.motion_gaps: list[UncheckedTicks] = []
        self.ticks, axes = rows.x.shape
        if isinstance(self._made, str):
            why = f"{self._made}: its motion and its ledger are not checked"
            self.motion_gaps.append(UncheckedTicks(0, self.ticks, why))
        self.rows = np.flatnonzero(there(rows.x) & there(rows.f)).tolist()
        self.fields = {names.DISPLACEMENT: axes, SENT: axes, names.FORCE: axes, names.LEDGER: 1}

    def change(self, rung: int) -> None:
        """Take the level and K of ``rung``, and in wall time the delay that it covers."""
        self._tick.change(rung)

    def _hand(self, joins: bool) -> Driver:
        """The device with its hand, at rest, or what moves as was recorded."""
        made = self._make() if joins else self._made
        of = self._recorded
        return GivenMotion(of.x, of.applied, of.work) if isinstance(made, str) else made

    def _free(self, periods: int) -> None:
        """Count free periods.

        Raises:
            Lost: there were too many.
        """
        self._freed += periods
        if self._freed > MOST_FREE:
            raise Lost(from_there_on(f"it ran free for {self._freed} periods, more than are computed"))


class FollowedInOwnTime(FollowedDevice):
    """A device in its own time: its row is a period, and so is each sample without a force.

    Its ledger and its guard take the displacement that was recorded, and its hand alone computes another. A sample
    without a force has no row. So in real time the guard, which sees it, can be followed until the device first lets
    go.
    """

    _tick: OwnTimeTick

    def begin(self, joins: bool) -> None:
        """Device and hand begin at rest."""
        self._tick, self._turn = OwnTimeTick(self._bundle, self._hand(joins)), 0
        self._tick.guard.armed = self._guarded

    def row(self, k: int, happened: Happening, rung: int | None) -> Mapping[str, Sequence[float]]:
        """What was sampled, what is sent and exerted, and the ledger."""
        rows, tick = self._recorded, self._tick
        self._free(happened.released)
        for _ in range(happened.released):
            turn, now = self._next(k)
            tick.sample(turn, now)
            tick.free(now)
        turn, now = self._next(k)
        sent = tick.sample(turn, now, recorded=rows.x[k].tolist())
        exerted = tick.exert(rows.asked[k].tolist(), now, rows.f[k].tolist())
        tick.book()
        if rung is not None:
            tick.change(rung)
        out: dict[str, Sequence[float]] = {}
        if self._guarded or rows.let_go is None or k < rows.let_go:
            out |= {SENT: sent, names.FORCE: exerted}
        if not self.motion_gaps:
            out |= {names.DISPLACEMENT: tick.moved, names.LEDGER: [tick.ledger.total]}
        return out

    def _next(self, k: int) -> tuple[int, Instant]:
        """Number and instant of the next sample; a motion that is given is looked up by the tick ``k``."""
        turn, self._turn = k if self.motion_gaps else self._turn, self._turn + 1
        return turn, Instant(turn * self._period)


class FollowedInWallTime(FollowedDevice):
    """A device in wall time: its instants were recorded, and what they do not fix to the last bit is its ledger."""

    _tick: WallTimeTick

    def __init__(
        self, bundle: DeviceBundle, make: Callable[[], Driver | str], rows: DeviceRows, guarded: bool = True
    ) -> None:
        """Arguments as of :class:`FollowedDevice`."""
        super().__init__(bundle, make, rows, guarded)
        if not there(rows.instants).any():
            lacks = "it was in wall time, and the recording has no instants"
            why = f"{lacks}: its motion, account and ledger are not checked"
            self.gaps, self.motion_gaps = [UncheckedTicks(0, self.ticks, why)], []
        self.rows = [k for k in self.rows if np.isfinite(rows.instants[k]).all()]
        if rows.work is not None:
            self.fields = {**self.fields, WORK: 2}
        more = {names.APPLIED: rows.x.shape[1], names.INTERFACE: 1, ENDED: 1, GIVEN: len(FIGURES), TOLERANCE: 1}
        self.fields = {**self.fields, **more}

    def begin(self, joins: bool) -> None:
        """Device and hand begin at rest, at the first sample."""
        self._tick = WallTimeTick(self._bundle, self._hand(joins))
        if joins:
            self._tick.joins()
        self._applied: Instant | None = None
        self._energy = 0.0  # all that was exchanged so far, J
        self._released = 0

    def row(self, k: int, happened: Happening, rung: int | None) -> Mapping[str, Sequence[float]]:
        """What was sampled at both instants, what is sent and exerted, account, ledger, and what the hand was given."""
        rows, tick = self._recorded, self._tick
        sampled, applied, ended = (Instant(int(at)) for at in rows.instants[k].tolist())
        asked = rows.asked[k]
        if happened.may_be_zero:  # the coupling's row then has its answer to another signal
            asked = np.where(rows.f[k] == 0.0, 0.0, asked)
        tick.guard.armed = rows.let_go is not None and k >= rows.let_go
        self._require_known(k, happened, asked, applied - sampled > LONGEST_GAP)
        self._free(max(0, self._periods_to(sampled, applied, happened.released > 0) - 1))
        if happened.leaves:
            tick.guard.leave()
        sent = tick.sample(k, sampled)
        if happened.may_be_zero and not tick.guard.holds and np.any(rows.asked[k]):
            # it exerts none of either: which of the two forces it was asked for does not show
            raise Lost(
                from_there_on("it had let go when it went on at another tick, with one of two forces asked of it")
            )
        if happened.released:
            self._release(happened.released, ended, applied)
        if happened.jumped:
            tick.skipped()
        if rows.turned is not None:
            tick.recorded_turn = Quaternion(*rows.turned[k].tolist())
        exerted = self._exert(asked.tolist(), rows.f[k].tolist(), applied)
        if rung is not None:
            tick.change(rung)
        given = given_figures(tick.wall_interface.given)
        out: dict[str, Sequence[float]] = {
            SENT: sent,
            names.FORCE: exerted,
            names.INTERFACE: [tick.wall_interface.account.energy],
            ENDED: [tick.instants[-1]],
            GIVEN: [given[name] for name in FIGURES],
        }
        if not self.motion_gaps:
            tolerance = ROUNDING * _EPSILON * self._released * self._energy
            out |= {names.DISPLACEMENT: tick.x, names.LEDGER: [tick.ledger.total], TOLERANCE: [tolerance]}
            if tick.x_a is not None:
                out[names.APPLIED] = tick.x_a
        if rows.work is not None:
            out[WORK] = tick.done
        return out

    def _periods_to(self, sampled: Instant, applied: Instant, free: bool) -> int:
        """Periods that the driver integrates from the last force to the next, with the sample of its tick in between.

        ``free`` is whether the loop sampled in between. A gap is integrated up to LONGEST_GAP otherwise.
        """
        if self._applied is None:
            return 0
        before, after = sampled - self._applied, applied - sampled
        return (min(before, LONGEST_GAP) + (after if free else min(after, LONGEST_GAP))) // self._period

    def _require_known(self, k: int, happened: Happening, asked: Array, long: bool) -> None:
        """Refuse a row that does not follow; ``long`` is whether its force came long after its sample.

        Raises:
            Lost: it does not.
        """
        rows, guard = self._recorded, self._tick.guard
        why, samples = "", "and the samples of free periods are not recorded"
        if not np.isfinite(asked).all():
            why = "the force that a coupling handed on is not recorded"
        elif happened.released and (guard.armed or guard.leaving):
            why = f"it was beyond its limits and ran free, {samples}"
        elif happened.released and rows.stopped[k] and long:
            why = f"its process did not run for a while and ran free, {samples}"
        elif rows.unexerted is not None and k >= rows.unexerted:
            why = "its hardware exerted another force than it was given, which its account counts"
        if why:
            raise Lost(from_there_on(why))

    def _release(self, periods: int, at: Instant, applied: Instant) -> None:
        """Run free for so many periods, until ``applied``; the force had ended at ``at``."""
        self._released += periods
        self._tick.release(at)
        for instant in range(at + LONGEST_GAP, applied, LONGEST_GAP):  # the loop sampled, so its driver saw no gap
            self._tick.driver.release(Instant(instant))

    def _exert(self, asked: Floats, recorded: Floats, at: Instant) -> Floats:
        """Take the couplings' answer, N, and exert what was recorded, N, from ``at`` on; returns what follows, N."""
        tick, ledger = self._tick, self._tick.ledger
        held = tick.exert(asked, at, recorded)
        before = ledger.total
        tick.book()
        self._energy += abs(tick.work) + abs(ledger.total - before - tick.work)
        self._applied = at
        return held
