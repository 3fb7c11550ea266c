"""The devices' motions and forces of a recording that was written as it happened: whole, or as far as it goes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from manyhands.launch.recordings.gathering import Gatherer, span_of
from manyhands.launch.recordings.recording import Array, Recording
from manyhands.launch.recordings.run import MOST_MISSING, cut_at, read_topics, require_beginning
from manyhands.nodes.recorder.coverage import Coverage, missing_by_party
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
    span = span_of([*gatherers.values()], MOST_MISSING)
    require_beginning(path, span.start)
    columns = [_columns(gatherers[device, sample], gatherers[device, force], span) for device in recorded.devices]
    coverages = {device: Coverage() for device in recorded.devices}
    for coverage, (_, _, told) in zip(coverages.values(), columns, strict=True):
        coverage.take_each(np.flatnonzero(told))
    ticks = max(coverage.next for coverage in coverages.values())
    return Recording(
        recorded.session,
        recorded.certificate,
        recorded.period,
        tuple(port for ports in recorded.devices.values() for port in ports),
        np.hstack([x[:ticks] for x, _, _ in columns]),
        np.hstack([f_v[:ticks] for _, f_v, _ in columns]),
        missing_by_party(coverages, 0, ticks),
        None if reading.why is None else cut_at(reading.why, ticks),
    )


def _columns(sample: Gatherer, force: Gatherer, span: range) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Both signals of a device, x and f_v, and the ticks of which both were told; NaN in the others."""
    (x, x_told), (f_v, f_told) = sample.rows(span), force.rows(span)
    told = x_told & f_told
    x[~told] = f_v[~told] = np.nan
    return x, f_v, told
