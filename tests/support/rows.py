"""One port's rows of a recording whose session was ended from outside, in the middle of a tick."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from manyhands.launch.recordings.recording import Recording

UNDONE: Final = 1
"""Ticks by which the rows of devices may end apart, when a session under the simulated clock is ended.

A device that has to end while it awaits its force leaves that tick undone. Another device may have received its own
force of the same tick, and records it. It gets no further: the environment awaits every device for the next tick.
Behind wave links a device is answered by its own end, once the wave of the tick before has come. So another device may
complete one tick more, for the environment has this one's wave of the tick that stays undone."""


def rows_of(recording: Recording, port: str, linked: bool = False) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """x and f_v of a port whose device ran to the end, up to the last tick that the device recorded.

    Fails where the device missed a tick before that one, or where it ended more than :data:`UNDONE` ticks before the
    last device; with ``linked``, where devices are behind wave links, more than one tick more.
    """
    column = recording.ports.index(port)
    x, f_v = recording.x[:, column], recording.f_v[:, column]
    recorded = ~(np.isnan(x) | np.isnan(f_v))
    ticks = int(np.flatnonzero(recorded).max(initial=-1)) + 1
    missed = np.flatnonzero(~recorded[:ticks]).tolist()
    assert not missed, f"{port} missed ticks: found no rows of {missed}; expected one of each tick before {ticks}"
    ahead, most = len(recorded) - ticks, UNDONE + linked
    assert ahead <= most, f"{port} ended early: found its end {ahead} ticks before others'; expected at most {most}"
    return x[:ticks], f_v[:ticks]
