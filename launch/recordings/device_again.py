"""A recorded device computed again, by its own core and its own hand, from the forces that it felt.

Where the hand is a simulated one, the displacement follows from the forces; with that the work that the hand intended
is known, and the ledger follows, all to the last bit.

A device that heard no force for a while ran free, untold, for some periods. How many is in its figures, and where they
were shows in its displacement, so they are put in again. At rest it does not show, until the hand begins to push at
another tick than expected: then they are put in where it was at rest. A process that ended and came back begins at
rest; after a gap both are tried, going on and beginning anew, and what fits is what was. Where neither fits, nothing is
claimed from there on.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from manyhands.launch.recordings.findings import Gap
from manyhands.launch.recordings.recomputed import EVERY, Progress, Recomputed, no_progress
from manyhands.launch.recordings.rows import Figures, count_until, there
from manyhands.nodes import telemetry as names
from manyhands.nodes.bundle import DeviceBundle
from manyhands.nodes.device.core import DeviceCore
from manyhands.nodes.device.driver import Driver
from manyhands.nodes.linear_map import Floats

Array = NDArray[np.float64]

MOST_FREE: Final = 60_000
"""Periods that a device is followed through without a row: a minute at 1 kHz."""

MOST_STEPS: Final = 5_000_000
"""Rows that are computed again in all to find where free periods at rest were."""


class _State:
    """A device with its hand between two periods.

    Attributes:
        core: the device's.
        freed: periods without force so far.
    """

    def __init__(self, bundle: DeviceBundle, driver: Driver) -> None:
        """At rest."""
        self._bundle, self._driver, self._turn, self.freed = bundle, driver, 0, 0
        self._zero: Floats = [0.0] * len(bundle.common.ports)
        self.core = DeviceCore(bundle.level, bundle.K, bundle.common.period)

    def peek(self) -> Floats:
        """Where the device is at the next period; as often as one likes, for nothing changes by it."""
        return list(copy.deepcopy(self._driver).sample(self._turn))

    def free(self, periods: int) -> None:
        """Periods without force, as the device's loop does them."""
        for _ in range(periods):
            self.row(list(self._driver.sample(self._turn)), self._zero, sampled=True)
        self.freed += periods

    def row(self, x: Floats, f: Floats, *, sampled: bool = False) -> Floats:
        """A period in which the force f (N) was applied; x is what was recorded. Returns where the device was, m."""
        moved = x if sampled else list(self._driver.sample(self._turn))
        self._driver.apply(f)
        self.core.sample(x)
        self.core.apply(f, self._driver.intended_work())
        self._turn += 1
        return moved

    def change(self, rung: int) -> None:
        """Another promise from now on."""
        promise = self._bundle.rungs[rung]
        self.core.change(promise.level, promise.K)

    def after(self, x: Floats, most: int) -> int | None:
        """How many free periods there are until the device is at x, m; None if it is not there after ``most``."""
        trial = copy.deepcopy(self)
        for periods in range(min(most, MOST_FREE) + 1):
            moved = list(trial._driver.sample(trial._turn))
            if moved == x:
                return periods
            trial.row(moved, self._zero, sampled=True)
        return None


def recompute_device(
    bundle: DeviceBundle,
    make: Callable[[], Driver | None],
    x: Array,
    f: Array,
    figures: Figures,
    shifts: Sequence[tuple[int, int]] = (),
    progress: Progress = no_progress,
) -> Recomputed:
    """The x and the ledger of a device, from the forces that it felt.

    Args:
        bundle: the device's part of the session.
        make: the device with its hand, at rest; None where a person was the hand.
        x: recorded, ticks x axes, m; it says where free periods are, and nothing else.
        f: recorded, the force that was applied, N.
        figures: the device's.
        shifts: ticks after which it changed its rung, with its couplings, and to which.
        progress: told now and then how many ticks are done.
    """
    driver = make()
    if driver is None:
        out = Recomputed.nothing(*x.shape)
        out.gaps.append(Gap(0, len(x), "a person moved the device: its motion and its ledger are believed"))
        return out

    def at_rest() -> _State:
        again = make()
        return _State(bundle, driver if again is None else again)

    return _Following(at_rest, x, f, figures, shifts).follow(progress)


class _Following:
    """A device, followed from row to row."""

    def __init__(
        self, at_rest: Callable[[], _State], x: Array, f: Array, figures: Figures, shifts: Sequence[tuple[int, int]]
    ) -> None:
        self._at_rest, self._x, self._f, self._rungs = at_rest, x, f, dict(shifts)
        self._released = count_until(figures, names.RELEASED)
        self._state = at_rest()
        self._out = Recomputed.nothing(*x.shape)
        self._resting: tuple[int, _State] | None = None  # row and state at which free periods would not show
        self._steps = 0
        self._rows: list[int] = np.flatnonzero(there(x) & there(f)).tolist()

    def follow(self, progress: Progress) -> Recomputed:
        """All rows."""
        before = -1
        for i, k in enumerate(self._rows):
            gap = k != before + 1
            if not self._brought_to(i, gap):
                why = "it had rows missing" if gap else "it ran free"
                text = f"{why}, and where it was then follows from nothing recorded: from there on it is believed"
                self._out.gaps.append(Gap(k, len(self._x), text))
                break
            self._row(k)
            before = k
            if k % EVERY == 0:
                progress(k)
        return self._out

    def _row(self, k: int) -> bool:
        """Compute a row; returns whether it is the recorded one."""
        x: Floats = self._x[k].tolist()
        moved = self._state.row(x, self._f[k].tolist())
        if k in self._rungs:
            self._state.change(self._rungs[k])
        self._out.signal[k], self._out.ledger[k] = moved, self._state.core.ledger.total
        return moved == x

    def _budget(self, k: int, state: _State) -> int:
        """Free periods that the figures tell of and that have not been put in before row ``k``."""
        return int(min(self._released(k), 2.0**40)) - state.freed

    def _brought_to(self, i: int, gap: bool) -> bool:
        """Put in what is told of in no row before the i-th; False where nothing fits, and there was something."""
        k, state = self._rows[i], self._state
        budget = self._budget(k, state)
        if budget <= 0 and not gap:
            return True  # whatever it is, it is to be compared
        x: Floats = self._x[k].tolist()
        periods = state.after(x, max(0, budget))
        if periods is not None:
            if budget > 0 and periods == 0 and self._resting is None and self._still_at(x, state):
                self._resting = i, copy.deepcopy(state)
            if periods:
                self._resting = None
            state.free(periods)
            return True
        if budget > 0 and self._rested(i):
            return True
        if not gap and self._alone(i):
            return True
        if not gap:
            return False
        anew = self._at_rest()
        periods = anew.after(x, int(min(self._released(k), 2.0**40)))
        if periods is None:
            return False
        anew.free(periods)
        self._state, self._resting = anew, None
        return True

    def _fits(self, state: _State, k: int) -> bool:
        """Whether the device is where row ``k`` says."""
        x: Floats = self._x[k].tolist()
        return state.peek() == x

    def _still_at(self, x: Floats, state: _State) -> bool:
        """Whether a free period more would not show."""
        trial = copy.deepcopy(state)
        trial.free(1)
        return trial.peek() == x

    def _rested(self, i: int) -> bool:
        """Whether free periods while the device was at rest explain the i-th row: then they are put in there."""
        if self._resting is None:
            return False
        at, state = self._resting
        for periods in range(1, min(self._budget(self._rows[i], state), MOST_FREE) + 1):
            trial = copy.deepcopy(state)
            trial.free(periods)
            if self._leads_to(trial, at, i):
                self._state = copy.deepcopy(state)
                self._state.free(periods)
                for j in range(at, i):
                    self._row(self._rows[j])
                self._resting = None
                return True
            if self._steps > MOST_STEPS:
                return False
        return False

    def _leads_to(self, trial: _State, at: int, i: int) -> bool:
        """Whether the rows from ``at`` to the i-th follow from a state."""
        for j in range(at, i):
            k = self._rows[j]
            x: Floats = self._x[k].tolist()
            self._steps += 1
            if trial.row(x, self._f[k].tolist()) != x:
                return False
        return self._fits(trial, self._rows[i])

    def _alone(self, i: int) -> bool:
        """Whether the i-th row is the only one that does not follow: the next does, were it not for this one."""
        if i + 1 >= len(self._rows) or self._rows[i + 1] != self._rows[i] + 1:
            return False
        trial = copy.deepcopy(self._state)
        k = self._rows[i]
        trial.row(self._x[k].tolist(), self._f[k].tolist())
        return self._fits(trial, k + 1)
