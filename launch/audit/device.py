"""Computes a recorded device again, by its own core and its own hand, from the forces that it felt.

Where the hand is simulated, the displacement follows from the forces. Then the work that the hand intended is known,
and the ledger follows, all to the last bit.

A device that received no force for a while ran free for some periods. A process that ended and came back began at rest.
Neither has a row; both are recorded as events, with their ticks (:mod:`manyhands.launch.audit.events`). Where
events are missing, the device is not checked from there on, until a new process begins.

**A device in wall time** (:func:`recompute_in_wall_time`) recorded the instants of its events: s(k), when x was
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

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from manyhands.launch.audit.events import Course, Happening
from manyhands.launch.audit.findings import (
    EVERY,
    Progress,
    Recomputed,
    UncheckedTicks,
    find_again,
    lose,
    no_progress,
)
from manyhands.launch.audit.replay import GivenMotion
from manyhands.launch.recordings.run import there
from manyhands.nodes.device.core import DeviceCore, Guard
from manyhands.nodes.device.drivers import Driver
from manyhands.nodes.device.telemetry import given_figures
from manyhands.nodes.device.tick import WallTimeTick
from manyhands.nodes.device.wall_time import LONGEST_GAP
from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.kernel.bundle import DeviceBundle
from manyhands.nodes.monitor.given import FIGURES
from manyhands.protocol.clock import Instant, from_seconds

Array = NDArray[np.float64]

MOST_FREE: Final = 600_000
"""The most free periods of a device that are computed, in all: ten minutes at 1 kHz."""


class _State:
    """A device with its hand, between two periods."""

    def __init__(self, bundle: DeviceBundle, driver: Driver) -> None:
        """Device and hand begin at rest."""
        self._bundle, self._driver, self._turn = bundle, driver, 0
        self._period = from_seconds(bundle.common.period)
        self._zero: Floats = [0.0] * len(bundle.common.ports)
        self.core = DeviceCore(*bundle.promises[0], bundle.common.period)

    def free(self) -> None:
        """Compute a period without force, as the device's loop does it."""
        x = list(self._driver.sample(self._turn, self._now))
        self._step(x, self._zero)

    def row(self, x: Floats, f: Floats) -> Floats:
        """Compute a period in which the force f (N) was applied; x (m) was recorded. Returns the computed position,
        m.
        """
        moved = list(self._driver.sample(self._turn, self._now))
        self._step(x, f)
        return moved

    @property
    def _now(self) -> Instant:
        return Instant(self._turn * self._period)

    def _step(self, x: Floats, f: Floats) -> None:
        self._driver.apply(f, self._now)
        self.core.sample(x)
        self.core.apply(f, self._driver.intended_work())
        self._turn += 1

    def change(self, rung: int) -> None:
        """Change the promised level to that of ``rung``."""
        self.core.change(*self._bundle.promises[rung])


def recompute_device(
    bundle: DeviceBundle,
    make: Callable[[], Driver | str],
    x: Array,
    f: Array,
    course: Course,
    progress: Progress = no_progress,
) -> Recomputed:
    """The x and the ledger of a device, from the forces that it felt.

    Args:
        bundle: the device's part of the session.
        make: makes the device with its hand, at rest; or returns the reason why its motion is unknown.
        x: recorded, ticks x axes, m; used for the ledger alone.
        f: recorded, the force that was applied, ticks x axes, N.
        course: what happened between the rows.
        progress: called now and then with the number of ticks that are done.
    """
    out, driver = Recomputed.nothing(*x.shape), make()
    if isinstance(driver, str):
        out.gaps.append(UncheckedTicks(0, len(x), f"{driver}: its motion and its ledger are not checked"))
        return out
    state: _State | None = _State(bundle, driver)
    nothing, freed = Happening(), 0
    for k in np.flatnonzero(there(x) & there(f)).tolist():
        happened = course.before.get(k, nothing)
        if happened.began and k > 0:
            again = make()
            state = None if isinstance(again, str) else _State(bundle, again)
        freed += happened.released
        why = happened.unknown
        if freed > MOST_FREE:
            why = why or f"it ran free for {freed} periods, more than are computed"
        if why and state is not None:
            state = None
            lose(out.gaps, k, len(x), why)
        if state is None:
            continue
        if happened.began:
            find_again(out.gaps, k)
        if happened.rung is not None:
            state.change(happened.rung)
        for _ in range(happened.released):
            state.free()
        out.signal[k] = state.row(x[k].tolist(), f[k].tolist())
        if k in course.rungs:
            state.change(course.rungs[k])
        out.ledger[k] = state.core.ledger.total
        if k % EVERY == 0:
            progress(k)
    return out


ROUNDING: Final = 64.0
"""Units in the last place of the energy exchanged so far, by which each free period may change the ledger's sum."""

_EPSILON: Final = float(np.finfo(np.float64).eps)


@dataclass(frozen=True, eq=False)
class WallRows:
    """What a device in wall time recorded, and what its couplings handed on; NaN in ticks without a row.

    Attributes:
        x: at the instants s(k), ticks x axes, m.
        f: the force that was exerted from a(k) on, ticks x axes, N.
        asked: the force that the couplings handed on, ticks x axes, N.
        instants: s(k), a(k), and when the force before had ended, ticks x 3, ns since tick 0.
        applied: x at the instants a(k), ticks x axes, m; NaN where the device could not measure it.
        let_go: the tick from which on the device may have let go; None if it never did.
        stopped: by tick, whether its process may not have run for a while.
        unexerted: the tick from which on its hardware may have exerted other forces than it was given; None if it
            never did.
    """

    x: Array
    f: Array
    asked: Array
    instants: Array
    applied: Array
    let_go: int | None
    stopped: NDArray[np.bool_]
    unexerted: int | None = None


@dataclass(frozen=True, eq=False)
class RecomputedInWallTime:
    """The signals of a device in wall time, computed again; NaN where they could not be.

    Attributes:
        x: at the instants s(k), ticks x axes, m.
        applied: x at the instants a(k), ticks x axes, m.
        sent: the displacement that the couplings received, ticks x axes, m.
        exerted: the force that the interface lets the device exert, ticks x axes, N.
        ended: when the force before had ended, ticks x 1, ns since tick 0.
        account: e(k), ticks x 1, J.
        given: the force that its hand was given up to the tick, ticks x the figures of GivenForce.
        ledger: ticks x 1, J.
        tolerance: of the ledger, ticks x 1, J; 0 before the first free period.
        gaps: the ticks that could not be computed, with the reason.
        motion_gaps: the ticks in which motion and ledger could not be computed.
    """

    x: Array
    applied: Array
    sent: Array
    exerted: Array
    ended: Array
    account: Array
    given: Array
    ledger: Array
    tolerance: Array
    gaps: list[UncheckedTicks] = field(default_factory=list)
    motion_gaps: list[UncheckedTicks] = field(default_factory=list)

    @classmethod
    def nothing(cls, ticks: int, axes: int) -> RecomputedInWallTime:
        """All NaN, before anything is computed."""
        x, applied, sent, exerted = (np.full((ticks, axes), np.nan) for _ in range(4))
        ended, account, ledger = (np.full((ticks, 1), np.nan) for _ in range(3))
        given = np.full((ticks, len(FIGURES)), np.nan)
        return cls(x, applied, sent, exerted, ended, account, given, ledger, np.zeros((ticks, 1)))


class _FollowedGuard(Guard):
    """A device's guard, of which the samples of free periods are not known.

    Attributes:
        may_let_go: whether the device may have let go so far; if it never did, its guard changes nothing.
    """

    may_let_go = False

    def report(self, x: Floats, periods: int = 1) -> Floats:
        """What the guard makes of x, m; x itself if the device never let go."""
        if self.may_let_go or self.leaving:
            return super().report(x, periods)
        self.breach(x, periods)
        return x


class _WallState:
    """A device in wall time between two rows, with what its recording does not fix to the last bit."""

    def __init__(self, bundle: DeviceBundle, driver: Driver, joins: bool) -> None:
        """Device and hand begin at rest, at the first sample; ``joins`` is whether the session ran already."""
        self._period = from_seconds(bundle.common.period)
        self.guard = _FollowedGuard(bundle.limits, bundle.common.period, bundle.common.ports)
        self.tick = WallTimeTick(bundle, driver, self.guard)
        if joins:
            self.tick.joins()
        self._applied: Instant | None = None
        self._energy = 0.0  # all that was exchanged so far, J
        self._released = 0

    def periods_to(self, sampled: Instant, applied: Instant, free: bool) -> int:
        """Periods that the driver integrates from the last force to the next, with the sample of its tick in between.

        ``free`` is whether the loop sampled in between. A gap is integrated up to LONGEST_GAP otherwise.
        """
        if self._applied is None:
            return 0
        before, after = sampled - self._applied, applied - sampled
        return (min(before, LONGEST_GAP) + (after if free else min(after, LONGEST_GAP))) // self._period

    def release(self, periods: int, at: Instant, applied: Instant) -> None:
        """Run free for so many periods, until ``applied``; the force had ended at ``at``."""
        self._released += periods
        self.tick.release(at)
        for instant in range(at + LONGEST_GAP, applied, LONGEST_GAP):  # the loop sampled, so its driver saw no gap
            self.tick.driver.release(Instant(instant))

    def exert(self, asked: Floats, recorded: Floats, at: Instant) -> Floats:
        """Take the couplings' answer, N, and exert what was recorded, N, from ``at`` on; returns what follows, N."""
        tick, ledger = self.tick, self.tick.core.ledger
        held = tick.exert(asked, at, recorded)
        before = ledger.total
        tick.book()
        self._energy += abs(tick.work) + abs(ledger.total - before - tick.work)
        self._applied = at
        return held

    @property
    def tolerance(self) -> float:
        """By how much the ledger may differ, J."""
        return ROUNDING * _EPSILON * self._released * self._energy


def recompute_in_wall_time(
    bundle: DeviceBundle,
    make: Callable[[], Driver | str],
    rows: WallRows,
    course: Course,
    progress: Progress = no_progress,
) -> RecomputedInWallTime:
    """The signals of a device in wall time, from the forces of its couplings, its own, and the instants of both.

    Args:
        bundle: the device's part of the session.
        make: makes the device with its hand, at rest; or returns the reason why its motion does not follow. Then the
            recorded motion is taken, and motion and ledger are not computed.
        rows: what was recorded.
        course: what happened between the rows.
        progress: called now and then with the number of ticks that are done.
    """
    ticks = len(rows.x)
    out, given = RecomputedInWallTime.nothing(*rows.x.shape), GivenMotion(rows.x, rows.applied)
    if not there(rows.instants).any():
        why = "it was in wall time, and the recording has no instants: its motion, account and ledger are not checked"
        out.gaps.append(UncheckedTicks(0, ticks, why))
        return out

    def begun(driver: Driver | str, joins: bool) -> _WallState:
        return _WallState(bundle, given if isinstance(driver, str) else driver, joins)

    first = make()
    if isinstance(first, str):
        out.motion_gaps.append(UncheckedTicks(0, ticks, f"{first}: its motion and its ledger are not checked"))
    state: _WallState | None = begun(first, joins=False)
    nothing, freed = Happening(), 0
    for k in np.flatnonzero(there(rows.x) & there(rows.f) & there(rows.instants)).tolist():
        happened = course.before.get(k, nothing)
        if happened.began and k > 0:
            state = begun(make(), joins=True)
        if state is not None:
            sampled, applied, ended = (Instant(int(at)) for at in rows.instants[k].tolist())
            may_let_go = rows.let_go is not None and k >= rows.let_go
            freed += max(0, state.periods_to(sampled, applied, happened.released > 0) - 1)
            asked = rows.asked[k]
            if happened.may_be_zero:  # the coupling's row then has its answer to another signal
                asked = np.where(rows.f[k] == 0.0, 0.0, asked)
            stopped = bool(rows.stopped[k]) and applied - sampled > LONGEST_GAP
            moved = may_let_go or state.guard.leaving
            why = happened.unknown or _unknown(happened.released, moved, stopped, freed, asked)
            if rows.unexerted is not None and k >= rows.unexerted:
                why = why or "its hardware exerted another force than it was given, which its account counts"
            if why:
                state = None
                lose(out.gaps, k, ticks, why)
        if state is None:
            continue
        if happened.began:
            find_again(out.gaps, k)
        if happened.rung is not None:
            state.tick.change(happened.rung)
        state.guard.may_let_go = may_let_go
        if happened.leaves:
            state.guard.leave()
        out.sent[k] = state.tick.sample(k, sampled)
        if happened.released:
            state.release(happened.released, ended, applied)
        if happened.jumped:
            state.tick.skipped()
        out.exerted[k] = state.exert(asked.tolist(), rows.f[k].tolist(), applied)
        tick = state.tick
        if k in course.rungs:
            tick.change(course.rungs[k])
        out.ended[k, 0], out.account[k] = tick.instants[-1], tick.wall_interface.account.energy
        figures = given_figures(tick.wall_interface.given)
        out.given[k] = [figures[name] for name in FIGURES]
        if not out.motion_gaps:
            out.x[k], out.ledger[k], out.tolerance[k] = tick.x, tick.core.ledger.total, state.tolerance
            if tick.x_a is not None:
                out.applied[k] = tick.x_a
        if k % EVERY == 0:
            progress(k)
    return out


def _unknown(released: int, may_let_go: bool, stopped: bool, freed: int, asked: Array) -> str:
    """Why a device in wall time cannot be followed; empty where it can."""
    if not np.isfinite(asked).all():
        return "the force that a coupling handed on is not recorded"
    if released and may_let_go:
        return "it was beyond its limits and ran free, and the samples of free periods are not recorded"
    if released and stopped:
        return "its process did not run for a while and ran free, and the samples of free periods are not recorded"
    if freed > MOST_FREE:
        return f"it ran free for {freed} periods, more than are computed"
    return ""
