"""Drivers in wall time: a device that goes on by the wall clock, whatever its loop does (docs/decisions/0005).

The device is integrated exactly between the instants at which something changes: the force that is exerted, by a call
of :meth:`WallTimeDriver.apply` or at its end ``until``; and the intention of the hand, which is constant over each
period [jT, (j+1)T) of the session's time. These periods are the *grid*.

A force of a physical device has an end as well: the watchdog of its amplifier switches it off when no new force comes.
Here ``until`` is that watchdog.

:meth:`WallTimeDriver.idle` integrates ahead, to the grid point at which the next sample is due, so that only the
lateness of the wake-up is left to integrate when the sample is taken. The present moment is kept. A force that comes
earlier than expected starts from there, so no result depends on whether ``idle`` was called.

A process that was stopped for an hour does not integrate an hour's periods when it goes on: see :data:`LONGEST_GAP`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Final, NamedTuple

from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.protocol.clock import Instant, from_seconds
from manyhands.protocol.messages import Figures

LONGEST_GAP: Final = from_seconds(10.0)
"""The longest time between two calls that is integrated, ns: 0.1 s of work at 1 kHz. Only a process that did not run
has a longer one. Its first part is integrated, in which the device loses its force and comes to rest; then the device
stands still until the present period. Time that stands still does no work and burns nothing, so that the ledger stays
right."""


class Moment(NamedTuple):
    """A device at one instant.

    Attributes:
        at: the instant, ns since tick 0.
        state: the state of device and hand; its first entries are the displacement, m.
        force: the force that is exerted from then on, N.
        until: the instant at which that force falls to zero; None for a force that is held.
        work: the work of the hand's intention since the last sample, J.
    """

    at: int
    state: Floats
    force: Floats
    until: int | None
    work: float


class WallTimeDriver(ABC):
    """A :class:`manyhands.nodes.device.drivers.Driver` in wall time; subclasses give the device and its hand."""

    def __init__(self, axes: int, T: float, divides: bool = False) -> None:
        """Wait for the first call, at whose instant the device begins.

        Args:
            axes: number of axes.
            T: period, s.
            divides: whether the motion depends on where its integration is cut. Then it is cut at each sample that is
                taken while a force acts, so that the motion goes on from what was seen.
        """
        self._m, self._period, self._divides = axes, from_seconds(T), divides
        self._zero: Floats = [0.0] * axes
        self._present: Moment | None = None  # the last force, or a grid point since then; None before the first call
        self._last = Instant(0)  # the instant of the last call
        self._sampled: tuple[int, Floats] | None = None  # instant and outcome of a sample whose work is not yet counted
        self._ahead: Moment | None = None  # the next grid point, if no event comes before it
        self._tick: int | None = None  # the period that was entered last
        self._work = 0.0

    @property
    def axes(self) -> int:
        """Number of axes."""
        return self._m

    def sample(self, tick: int, at: Instant) -> Floats:
        """The displacement at ``at``, m; the work until then is computed by the next call, when nobody waits."""
        at = self._begun(at)
        self._present = now, state, force, until, work = self._cut(self._resumed(at), at)
        if now < at and self._divides and force is not self._zero:
            _, state, _, _, self._work = self._finished(self._present, at)
            self._present = Moment(at, state, force, until, 0.0)
            return state[: self._m]
        if now < at:
            seen = self._seen(state, force, now, at)
            self._sampled = at, seen
            return seen[: self._m]
        self._present, self._work = Moment(now, state, force, until, 0.0), work
        return state[: self._m]

    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> Floats:
        """Exert f (N) from ``at`` on, and none from ``until`` on; returns the displacement at ``at``, m."""
        at = self._begun(at)
        now, state, _, _, work = self._finished(self._cut(self._resumed(at), at), at)
        self._present = Moment(now, state, list(map(float, f)), until, work)  # a float of numpy is slow in the products
        return state[: self._m]

    def release(self, at: Instant) -> Floats:
        """Exert no force from ``at`` on; returns the displacement at ``at``, m.

        Where it was released before, or its force has ended, nothing changes, and the integration is not cut. So the
        motion of a device that runs free does not depend on how often its loop releases it, to the last bit.
        """
        at = self._begun(at)
        moment = self._cut(self._resumed(at), at)
        if moment.force is self._zero:
            self._present = moment
            now, state, force, _, _ = moment
            return (self._seen(state, force, now, at) if now < at else state)[: self._m]
        now, state, _, _, work = self._finished(moment, at)
        self._present = Moment(now, state, self._zero, None, work)
        return state[: self._m]

    def idle(self, due: Instant) -> None:
        """Integrate to the next grid point under the present force, if ``due`` is not before it.

        What can be known of the period that begins there is computed as well.
        """
        self._settle()
        present, period = self._present, self._period
        if present is None or self._ahead is not None:
            return
        tick = present.at // period
        following = (tick + 1) * period
        if following > due:
            return
        if tick != self._tick:
            present = self._present = self._entered(present, tick)
        self._ahead = self._finished(self._cut(present, following), following)
        self._prepare(tick + 1)

    def intended_work(self) -> float:
        """Work of the hand's intention between the last two samples, J."""
        self._settle()
        return self._work

    def work(self) -> float | None:
        """None: the device holds the force itself."""
        return None

    def figures(self) -> Figures:
        """No figures."""
        return Figures()

    def close(self) -> None:
        """Exert no force from the last event on."""
        if self._present is not None:
            self.release(Instant(self._last))

    def _latest(self) -> Floats:
        """The state whose displacement was returned last, as far as :meth:`_seen` has it; before any later question."""
        if self._sampled is not None:
            return self._sampled[1]
        return self._begin(self._last)[0] if self._present is None else self._present.state

    def _settle(self) -> None:
        """Compute the work of the intention between the last two samples."""
        if self._sampled is None or self._present is None:
            return
        (end, seen), self._sampled = self._sampled, None
        at, state, force, until, work = self._present
        part = self._work_over(state, seen, force, at, end)
        self._work = work + part
        self._present = Moment(at, state, force, until, -part)  # it is in the work of the whole piece once more

    def _begun(self, at: Instant) -> Instant:
        """The instant for which a call at ``at`` counts."""
        self._settle()
        if self._present is not None:
            if at - self._last > LONGEST_GAP:
                self._leave_out(at)
            at = max(at, self._last)
        self._last = at
        return at

    def _leave_out(self, at: int) -> None:
        """Integrate the first part of a gap that ends at ``at``; be at the last grid point after it, and changed no
        more.
        """
        end, now = self._last + LONGEST_GAP, at - at % self._period
        if end < now:
            at, state, force, until, work = self._finished(self._cut(self._resumed(end), end), end)
            state, more = self._left(state, force, end, now)
            self._present = Moment(now, state, force, until, work + more)

    def _resumed(self, at: int) -> Moment:
        """The latest known moment that is not after ``at``."""
        present, ahead = self._present, self._ahead
        self._ahead = None  # an event follows: it uses what was integrated ahead now, or never
        if present is None:
            state, work = self._begin(at)
            return Moment(at, state, self._zero, None, work)
        return ahead if ahead is not None and ahead.at <= at else present

    def _entered(self, moment: Moment, tick: int) -> Moment:
        """``moment`` with the state with which its period, that of ``tick``, begins."""
        at, state, force, until, work = moment
        self._tick = tick
        return Moment(at, self._enter(tick, state), force, until, work)

    def _cut(self, moment: Moment, to: int) -> Moment:
        """The device at the last instant up to ``to`` at which force or intention change, or at ``moment``."""
        period = self._period
        while moment.at < to:
            tick = moment.at // period
            if tick != self._tick:
                moment = self._entered(moment, tick)
            end, until = (tick + 1) * period, moment.until
            if until is not None:
                if until <= moment.at:
                    moment = Moment(moment.at, moment.state, self._zero, None, moment.work)
                    continue
                end = min(end, until)
            if end > to:
                break
            moment = self._finished(moment, end)
        return moment

    def _finished(self, moment: Moment, to: int) -> Moment:
        """The device at ``to``, between which and ``moment`` nothing changes."""
        at, state, force, until, work = moment
        if at >= to:
            return moment
        after = self._advance(state, force, at, to)
        return Moment(to, after, force, until, work + self._work_over(state, after, force, at, to))

    def _left(self, state: Floats, f: Floats, begin: int, end: int) -> tuple[Floats, float]:
        """The state at ``end`` where the time from ``begin`` on, ns, is left out, and the work of the intention, J."""
        return state, 0.0

    @abstractmethod
    def _begin(self, at: int) -> tuple[Floats, float]:
        """The state at the first event, at the instant ``at``, and the work of the intention until then, J."""

    @abstractmethod
    def _prepare(self, tick: int) -> None:
        """Compute what does not depend on the state, before the period that begins with ``tick``."""

    @abstractmethod
    def _enter(self, tick: int, state: Floats) -> Floats:
        """Begin the period of ``tick`` in ``state``, once for each; returns the state with which it begins."""

    @abstractmethod
    def _advance(self, state: Floats, f: Floats, begin: int, end: int) -> Floats:
        """The state at ``end``, from that at ``begin``, ns, under the force f (N).

        Both instants are in the period that was entered last, or at its end.
        """

    @abstractmethod
    def _seen(self, state: Floats, f: Floats, begin: int, end: int) -> Floats:
        """The first entries of :meth:`_advance`, as many as :meth:`_work_over` needs, at least the displacement."""

    @abstractmethod
    def _work_over(self, before: Floats, after: Floats, f: Floats, begin: int, end: int) -> float:
        """The work of the hand's intention from ``begin`` to ``end``, J, with the first entries of both states."""
