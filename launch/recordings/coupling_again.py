"""A recorded coupling block computed again, by its own core, from what its devices and the environment told it.

The state xi follows from the forces that the block handed on, and p from that and the devices' displacement, to the
last bit. What happened between two rows shows in p: a process that came back begins at rest, and so does a block that
has changed its rung, at a tick without force; both are tried where the figures or a gap say that there was something.

A device that ran free says its x of one tick again and again, and records the last that it said, where p is of the
first: so in as many rows as it had free periods, and in the row behind a gap, p may be another one. Those rows are not
compared, and told.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from manyhands.launch.recordings.findings import Gap
from manyhands.launch.recordings.recomputed import EVERY, Progress, Recomputed, no_progress
from manyhands.launch.recordings.rows import Figures, Window, changes, there
from manyhands.nodes import telemetry as names
from manyhands.nodes.bundle import CouplingBundle
from manyhands.nodes.coupling.core import CouplingCore

Array = NDArray[np.float64]

MOST_TRIALS: Final = 1000
"""Places at which a block is tried to have changed its rung, for each change that its figures tell of."""

MOST_AHEAD: Final = 100
"""Rows that are looked ahead for one that says which state the block was in behind a gap."""

_SAID_BEFORE = "a device of it had sampled again since p was said: p is believed"


def recompute_coupling(
    bundle: CouplingBundle,
    x: Array,
    p: Array,
    f: Array,
    ledger: Array,
    figures: Figures,
    devices: Sequence[Figures] = (),
    progress: Progress = no_progress,
) -> Recomputed:
    """The p and the ledger of a coupling block, from the displacements and the forces of its ports.

    Args:
        bundle: the coupling's part of the session.
        x: recorded by its devices, ticks x ports, m; NaN where one of them has no row.
        p: recorded, m; it says where a rung was changed or a process began anew, and nothing else.
        f: recorded, the force that was handed on, N.
        ledger: recorded, ticks x 1, J; of several places where a rung may have been changed, or a process begun, it
            says which one it was, and nothing else.
        figures: the coupling's.
        devices: those of its devices.
        progress: told now and then how many ticks are done.
    """
    free = [window for told in devices for window in _growing(told)]
    return _Block(bundle, (x, p, f, ledger), changes(figures, names.RUNG), free).follow(progress)


def _growing(figures: Figures) -> list[Window]:
    """Where a device ran free, and in ``value`` how many periods."""
    windows = changes(figures, names.RELEASED)
    before = [0.0, *(window.value for window in windows)]
    # a count that is less than before is that of a new process
    grown = [now.value - last if now.value > last else now.value for last, now in zip(before, windows, strict=False)]
    return [Window(window.begin, window.end, by) for window, by in zip(windows, grown, strict=True)]


class _Block:
    """A coupling block, followed from row to row."""

    def __init__(
        self, bundle: CouplingBundle, told: tuple[Array, Array, Array, Array], shifts: list[Window], free: list[Window]
    ) -> None:
        self._bundle = bundle
        self._x, self._p, self._f, self._ledger = x, p, f, _ = told
        self._pending, self._free = shifts, [[window.begin, window.end, window.value] for window in free]
        self._out = Recomputed.nothing(*p.shape)
        self._core = self._core_of(0)
        self._rows: list[int] = np.flatnonzero(there(p) & there(f)).tolist()
        self._sampled = there(x)
        self._begun = 0  # the first row, by number, of this process

    def _core_of(self, rung: int) -> CouplingCore:
        of = self._bundle.rungs[rung]
        return CouplingCore(of.block, of.K, of.level, self._bundle.common.period, self._bundle.limits.force)

    def follow(self, progress: Progress) -> Recomputed:
        """All rows."""
        out, before = self._out, -1
        for i, k in enumerate(self._rows):
            gap, compared = k != before + 1, bool(self._sampled[k])
            if compared and not self._fits(self._core, k) and not self._shifted(i):
                if gap and self._begins(k) and self._joins(self._core_of(0), i) < self._joins(self._core, i):
                    self._core, self._begun = self._core_of(0), i  # a new process
                if not self._fits(self._core, k):
                    compared = not self._excused(k, gap)
                    told_of = gap or self._window(k) is not None
                    if compared and told_of and self._joins(self._core, i) > MOST_AHEAD:
                        text = "it had rows missing" if gap else "it changed its rung"
                        why = f"{text}, and its state then follows from nothing recorded: from there on it is believed"
                        out.gaps.append(Gap(k, len(self._p), why))
                        break
                    if not compared:
                        out.gaps.append(Gap(k, k + 1, _SAID_BEFORE))
            if compared:
                out.signal[k] = self._core.free_position(self._x[k].tolist())
            self._core.absorb(self._f[k].tolist())
            if self._core.ledger is not None:
                out.ledger[k] = self._core.ledger.total
            before = k
            if k % EVERY == 0:
                progress(k)
        return out

    def _fits(self, core: CouplingCore, k: int) -> bool:
        """Whether a block in that state says the p that was recorded."""
        same: bool = core.free_position(self._x[k].tolist()) == self._p[k].tolist()
        return same

    def _joins(self, core: CouplingCore, i: int) -> int:
        """After how many rows from the i-th on a row follows from the state at the i-th; more than MOST_AHEAD: none.

        A state is forgotten with time, so that a wrong one joins in the end, but the right one joins first.
        """
        trial = copy.deepcopy(core)
        for j in range(i, min(i + MOST_AHEAD, len(self._rows))):
            k = self._rows[j]
            behind_gap = j > i and k != self._rows[j - 1] + 1
            if self._sampled[k] and not behind_gap and self._fits(trial, k):
                return j - i
            trial.absorb(self._f[k].tolist())
        return MOST_AHEAD + 1

    def _excused(self, k: int, gap: bool) -> bool:
        """Whether a device may have sampled again since p was said; each of its free periods excuses one row."""
        if gap:
            return True
        for window in self._free:
            if window[0] <= k < window[1] and window[2] > 0:
                window[2] -= 1
                return True
        return False

    def _begins(self, k: int) -> bool:
        """Whether a ledger of a process that begins at rest with row ``k`` is the one that was recorded."""
        core = self._core_of(0)
        core.absorb(self._f[k].tolist())
        return core.ledger is None or core.ledger.total == float(self._ledger[k, 0])

    def _window(self, k: int) -> Window | None:
        """The change of rung that may have happened before ``k``, the latest."""
        return next((window for window in reversed(self._pending) if window.begin <= k), None)

    def _shifted(self, i: int) -> bool:
        """Whether the block had changed its rung at some tick before its i-th row, at which it exerted no force."""
        window = self._window(self._rows[i])
        if window is None or window.value not in range(len(self._bundle.rungs)):
            return False
        found: tuple[int, CouplingCore, list[float]] | None = None
        before, tried = self._rows[i - 1], 0
        for j in range(i - 1, self._begun - 1, -1):
            k = self._rows[j]
            if k < window.begin or tried >= MOST_TRIALS:
                break
            if k >= window.end or np.any(self._f[k] != 0.0):
                continue
            tried += 1
            core, ledger = self._shifted_at(j, i, int(window.value))
            if not self._fits(core, self._rows[i]):
                continue
            right = core.ledger is None or ledger[-1] == float(self._ledger[before, 0])
            if found is None or right:
                found = j, core, ledger
            if right:
                break
        if found is None:
            return False
        j, self._core, ledger = found
        self._out.ledger[self._rows[j:i], 0] = ledger
        self._out.shifts.append((self._rows[j], int(window.value)))
        self._pending = [other for other in self._pending if other.begin > window.begin]
        return True

    def _shifted_at(self, j: int, i: int, rung: int) -> tuple[CouplingCore, list[float]]:
        """The block at its i-th row, had it changed its rung at the j-th, and its ledger in the rows between."""
        core, ledger = self._core_of(rung), []
        if core.ledger is not None and j > self._begun:
            core.ledger.enter(float(self._out.ledger[self._rows[j - 1], 0]))
        for k in self._rows[j:i]:
            core.absorb(self._f[k].tolist())
            ledger.append(np.nan if core.ledger is None else core.ledger.total)
        return core, ledger
