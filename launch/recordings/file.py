"""The devices' motions and forces of a recording that was written as it happened: whole, or as far as it goes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from manyhands.launch.recordings.gathering import Gatherer, most_ticks
from manyhands.launch.recordings.recording import Array, Recording
from manyhands.launch.recordings.run import MOST_MISSING, cut_at, read_topics
from manyhands.protocol.messages import Role
from manyhands.protocol.topics import DISPLACEMENT, FORCE, topics_of

_SIGNALS = (DISPLACEMENT, FORCE)


def read_recording(path: Path) -> Recording:
    """Read x and f_v of an ``.mcap`` recording of this program, whole or cut anywhere behind its beginning.

    What devices did not record, or what is lost with the end of a file that was cut, is NaN up to the last tick that
    any device recorded, and counted in ``missing``. A tick is recorded where both its x and its f_v are.

    Raises:
        RecordingError: not readable, no such recording, larger than is read, or cut before it says what it is.
    """
    sample, force = (next(t.name for t in topics_of(Role.DEVICE) if t.trace == signal) for signal in _SIGNALS)
    reading = read_topics(path, lambda node, topic: topic.name in (sample, force))
    recorded, gatherers = reading.recorded, reading.gatherers
    most = most_ticks([*gatherers.values()], MOST_MISSING)
    columns = [_columns(gatherers[device, sample], gatherers[device, force], most) for device in recorded.devices]
    ticks = max(int(np.flatnonzero(told).max(initial=-1)) + 1 for _, _, told in columns)
    missing = {
        device: ticks - int(told[:ticks].sum()) for device, (_, _, told) in zip(recorded.devices, columns, strict=True)
    }
    return Recording(
        recorded.session,
        recorded.certificate,
        recorded.period,
        tuple(port for ports in recorded.devices.values() for port in ports),
        np.hstack([x[:ticks] for x, _, _ in columns]),
        np.hstack([f_v[:ticks] for _, f_v, _ in columns]),
        {device: count for device, count in missing.items() if count},
        None if reading.why is None else cut_at(reading.why, ticks),
    )


def _columns(sample: Gatherer, force: Gatherer, ticks: int) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Both signals of a device, x and f_v, and the ticks of which both were told; NaN in the others."""
    (x, x_told), (f_v, f_told) = sample.rows(ticks), force.rows(ticks)
    told = x_told & f_told
    x[~told] = f_v[~told] = np.nan
    return x, f_v, told
