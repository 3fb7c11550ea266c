"""One port's rows of a recording whose session was ended from outside, in the middle of a tick."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from manyhands.launch.recordings.recording import Recording

UNDONE: Final = 1
"""Ticks by which the rows of devices may end apart, when a session under the simulated clock is ended.

A device that has to end while it awaits its force leaves that tick undone. Another device may have received its own
force of the same tick, and records it. It gets no further: the environment awaits every device for the next tick."""


def rows_of(recording: Recording, port: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """x and f_v of a port whose device ran to the end, up to the last tick that the device recorded.

    Fails where the device missed a tick before that one, or where it ended more than :data:`UNDONE` ticks before the
    last device.
    """
    column = recording.ports.index(port)
    x, f_v = recording.x[:, column], recording.f_v[:, column]
    recorded = ~(np.isnan(x) | np.isnan(f_v))
    ticks = int(np.flatnonzero(recorded).max(initial=-1)) + 1
    missed = np.flatnonzero(~recorded[:ticks]).tolist()
    assert not missed, f"{port} missed ticks: found no rows of {missed}; expected one of each tick before {ticks}"
    ahead = len(recorded) - ticks
    assert ahead <= UNDONE, f"{port} ended early: found its end {ahead} ticks before others'; expected at most {UNDONE}"
    return x[:ticks], f_v[:ticks]
