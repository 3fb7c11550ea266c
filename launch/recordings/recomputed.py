"""What a device and a coupling must have told of their ticks, recomputed from the signals that they had.

The arithmetic is that of the nodes, by the nodes' own cores, so that the numbers are the same to the last bit.

A device's displacement follows from the forces that it felt, where its hand is a simulated one; with that the work that
the hand intended is known, and the ledger follows. A device that heard no force for a while ran free, untold, for some
periods; how many is in its figures, and where they were shows in its displacement, so they are put in again. A process
that ended and came back begins at rest: after a gap both are tried, going on and beginning anew, and what fits is what
was. Where neither fits, nothing is claimed from there on.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from manyhands.launch.recordings.findings import Gap
from manyhands.launch.recordings.rows import Figures, Window, changes, count_until, there
from manyhands.nodes import telemetry as names
from manyhands.nodes.bundle import CouplingBundle, DeviceBundle
from manyhands.nodes.coupling.core import CouplingCore
from manyhands.nodes.device.core import DeviceCore
from manyhands.nodes.device.driver import Driver
from manyhands.nodes.linear_map import Floats

Array = NDArray[np.float64]
Progress = Callable[[int], None]

MOST_FREE = 60_000
"""Periods that a device is followed through without a row: a minute at 1 kHz."""

MOST_TRIALS = 1000
"""Places at which a coupling is tried to have changed its rung, for each change that its figures tell of."""

_EVERY = 1000  # ticks between two words of progress


@dataclass(eq=False)
class Recomputed:
    """What a party must have told.

    Attributes:
        signal: x of a device or p of a coupling, ticks x ports, m; NaN where it could not be recomputed.
        ledger: ticks x 1, J; likewise.
        gaps: why not.
        shifts: of a coupling, the ticks at which it changed its rung, and to which.
    """

    signal: Array
    ledger: Array
    gaps: list[Gap] = field(default_factory=list)
    shifts: list[tuple[int, int]] = field(default_factory=list)


def no_progress(_tick: int) -> None:
    """Nobody is told."""


class _Hand:
    """A device with its hand, followed from row to row."""

    def __init__(self, make: Callable[[], Driver], axes: int) -> None:
        self._make, self._zero = make, [0.0] * axes
        self.begin()

    def begin(self) -> None:
        """A new process: at rest, its time begins."""
        self.driver, self.turn, self.freed = self._make(), 0, 0

    def free_periods(self, x: Floats, budget: int) -> int | None:
        """How many periods without force lie between the last row and one with the displacement x; None if none fit."""
        trial = copy.deepcopy(self.driver)
        for n in range(min(budget, MOST_FREE) + 1):
            if list(trial.sample(self.turn + n)) == x:
                return n
            trial.apply(self._zero)
        return None

    def run_free(self, core: DeviceCore, periods: int) -> None:
        """Periods without force, as the device's loop does them."""
        for _ in range(periods):
            x = list(self.driver.sample(self.turn))
            self.driver.apply(self._zero)
            core.sample(x)
            core.apply(self._zero, self.driver.intended_work())
            self.turn += 1
            self.freed += 1


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
    ticks = len(x)
    out = Recomputed(np.full_like(x, np.nan), np.full((ticks, 1), np.nan))
    first = make()
    if first is None:
        out.gaps.append(Gap(0, ticks, "a person moved the device: its motion and its ledger are believed"))
        return out
    del first
    hand, core = _Hand(_certain(make), x.shape[1]), DeviceCore(bundle.level, bundle.K, bundle.common.period)
    released, rungs = count_until(figures, names.RELEASED), dict(shifts)
    before = -1
    for k in np.flatnonzero(there(x) & there(f)).tolist():
        row, budget = x[k].tolist(), int(min(max(released(k), 0.0), 2**40)) - hand.freed
        gap = k != before + 1
        periods = hand.free_periods(row, budget) if budget > 0 or gap else 0
        if periods is None and gap:
            anew = _Hand(_certain(make), x.shape[1])
            periods = anew.free_periods(row, budget + hand.freed)
            if periods is not None:
                hand, core = anew, DeviceCore(bundle.level, bundle.K, bundle.common.period)
        if periods is None:
            why = "it had rows missing" if gap else "it ran free"
            out.gaps.append(Gap(k, ticks, f"{why} and its motion fits neither: what follows is believed"))
            break
        hand.run_free(core, periods)
        moved = list(hand.driver.sample(hand.turn))
        force = f[k].tolist()
        hand.driver.apply(force)
        core.sample(row)
        core.apply(force, hand.driver.intended_work())
        hand.turn += 1
        if k in rungs:
            promise = bundle.rungs[rungs[k]]
            core.change(promise.level, promise.K)
        out.signal[k], out.ledger[k] = moved, core.ledger.total
        before = k
        if k % _EVERY == 0:
            progress(k)
    return out


def _certain(make: Callable[[], Driver | None]) -> Callable[[], Driver]:
    """The same, where it is known that there is one."""

    def made() -> Driver:
        driver = make()
        if driver is None:
            raise AssertionError("a device that can be computed cannot be computed any more")
        return driver

    return made


def recompute_coupling(
    bundle: CouplingBundle, x: Array, p: Array, f: Array, figures: Figures, progress: Progress = no_progress
) -> Recomputed:
    """The p and the ledger of a coupling block, from the displacements and the forces of its ports.

    Args:
        bundle: the coupling's part of the session.
        x: recorded by its devices, ticks x ports, m; NaN where one of them has no row.
        p: recorded, m; it says where a rung was changed or a process began anew, and nothing else.
        f: recorded, the force that was handed on, N.
        figures: the coupling's.
        progress: told now and then how many ticks are done.
    """
    return _Block(bundle, x, p, f, figures).follow(progress)


class _Block:
    """A coupling block, followed from row to row."""

    def __init__(self, bundle: CouplingBundle, x: Array, p: Array, f: Array, figures: Figures) -> None:
        self._bundle, self._x, self._p, self._f = bundle, x, p, f
        self._pending: list[Window] = changes(figures, names.RUNG)
        self._rung = 0
        self._out = Recomputed(np.full_like(p, np.nan), np.full((len(p), 1), np.nan))
        self._core = self._core_of(0)
        self._rows: list[int] = []  # of this process

    def _core_of(self, rung: int) -> CouplingCore:
        of = self._bundle.rungs[rung]
        return CouplingCore(of.block, of.K, of.level, self._bundle.common.period, self._bundle.limits.force)

    def follow(self, progress: Progress) -> Recomputed:
        """All rows."""
        out, x, f, ticks = self._out, self._x, self._f, len(self._p)
        before, sampled = -1, there(x)
        for k in np.flatnonzero(there(self._p) & there(f)).tolist():
            if sampled[k] and not self._fits(self._core, k):
                shifted = self._shifted(k)
                if not shifted and k != before + 1 and self._fits(self._core_of(0), k):
                    self._core, self._rung, self._rows = self._core_of(0), 0, []  # a new process
                elif not shifted and (k != before + 1 or self._window(k) is not None):
                    why = "it had rows missing" if k != before + 1 else "it changed its rung"
                    out.gaps.append(Gap(k, ticks, f"{why} and its motion fits no state: what follows is believed"))
                    break
            if sampled[k]:
                out.signal[k] = self._core.free_position(x[k].tolist())
            self._core.absorb(f[k].tolist())
            self._rows.append(k)
            if self._core.ledger is not None:
                out.ledger[k] = self._core.ledger.total
            before = k
            if k % _EVERY == 0:
                progress(k)
        return out

    def _fits(self, core: CouplingCore, k: int) -> bool:
        """Whether a block in that state says the p that was recorded."""
        said: Floats = self._p[k].tolist()
        return core.free_position(self._x[k].tolist()) == said

    def _window(self, k: int) -> Window | None:
        """The change of rung that may have happened before ``k``, the latest."""
        return next((window for window in reversed(self._pending) if window.begin <= k), None)

    def _shifted(self, k: int) -> bool:
        """Whether the block had changed its rung at some tick before ``k``, at which it exerted no force."""
        window = self._window(k)
        if window is None or not 0 <= window.value < len(self._bundle.rungs) or window.value != int(window.value):
            return False
        rung = int(window.value)
        tried = 0
        for i in range(len(self._rows) - 1, -1, -1):
            j = self._rows[i]
            if j < window.begin or tried >= MOST_TRIALS:
                return False
            if j >= window.end or np.any(self._f[j] != 0.0):
                continue
            tried += 1
            core = self._core_of(rung)
            if core.ledger is not None and i > 0:
                core.ledger.enter(float(self._out.ledger[self._rows[i - 1], 0]))
            ledgers = []
            for row in self._rows[i:]:
                core.absorb(self._f[row].tolist())
                ledgers.append(np.nan if core.ledger is None else core.ledger.total)
            if self._fits(core, k):
                self._out.ledger[self._rows[i:], 0] = ledgers
                self._core, self._rung = core, rung
                self._out.shifts.append((j, rung))
                self._pending = [other for other in self._pending if other.begin > window.begin]
                return True
        return False
