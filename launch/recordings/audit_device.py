"""Computes a recorded device again, by its own core and its own hand, from the forces that it felt.

Where the hand is simulated, the displacement follows from the forces. Then the work that the hand intended is known,
and the ledger follows, all to the last bit.

A device that received no force for a while ran free for some periods. A process that ended and came back began at rest.
Neither has a row; both are recorded as events, with their ticks (:mod:`manyhands.launch.recordings.events`). Where
events are missing, the device is not checked from there on, until a new process begins.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from manyhands.launch.recordings.events import Course, Happening
from manyhands.launch.recordings.findings import EVERY, Progress, Recomputed, UncheckedTicks, no_progress
from manyhands.launch.recordings.run import there
from manyhands.nodes.arithmetic import Floats
from manyhands.nodes.bundle import DeviceBundle
from manyhands.nodes.device.core import DeviceCore
from manyhands.nodes.device.drivers import Driver
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
            out.gaps.append(UncheckedTicks(k, len(x), f"{why}: from there on it is not checked"))
        if state is None:
            continue
        if happened.began and out.gaps and out.gaps[-1].end > k:
            out.gaps[-1] = replace(out.gaps[-1], end=k)
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
