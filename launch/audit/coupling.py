"""Computes a recorded coupling block again, by its own core, from the signals of its devices and the environment.

The state xi follows from the forces that the block handed on, and p follows from xi and the devices' displacement, to
the last bit. A process that came back begins at rest. So does a block that has changed its rung, at a tick without
force. Both are recorded as events, with their ticks (:mod:`manyhands.launch.audit.events`).

A device that runs free samples anew for the same tick, and records the last sample, while p is computed from the first.
So in a row after free periods, and in the first row after a gap, p may differ; such rows are listed as unchecked.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from manyhands.launch.audit.events import Course, Happening
from manyhands.launch.audit.findings import EVERY, Progress, Recomputed, gaps_of, no_progress
from manyhands.launch.recordings.run import there
from manyhands.nodes.coupling.port import CouplingPort
from manyhands.nodes.kernel.bundle import CouplingBundle

Array = NDArray[np.float64]

_SAID_BEFORE: Final = "a device of it had sampled again after p was computed: p is not checked"


def recompute_coupling(
    bundle: CouplingBundle,
    x: Array,
    p: Array,
    f: Array,
    course: Course,
    devices: Sequence[Course] = (),
    progress: Progress = no_progress,
) -> Recomputed:
    """The p and the ledger of a coupling block, from the displacements and the forces of its ports.

    Args:
        bundle: the coupling's part of the session.
        x: recorded by its devices, ticks x ports, m; NaN where one of them has no row.
        p: recorded, ticks x ports, m; used only to see whether a device had sampled again.
        f: recorded, the force that was handed on, ticks x ports, N.
        course: what happened between the coupling's rows.
        devices: the same of its devices.
        progress: called now and then with the number of ticks that are done.
    """
    out, nothing = Recomputed.nothing(*p.shape), Happening()
    resampled = course.resampled
    for device in devices:
        resampled |= device.resampled
    sampled, excused = there(x), np.zeros(len(p), dtype=np.bool_)
    port: CouplingPort | None = CouplingPort(bundle)
    for k in np.flatnonzero(there(p) & there(f)).tolist():
        happened = course.before.get(k, nothing)
        if happened.began:
            port = CouplingPort(bundle)
        if happened.unknown:
            port = None
        if port is None:
            continue
        if happened.rung is not None:
            port.change(happened.rung)
        if sampled[k]:
            now = port.up(x[k].tolist())
            excused[k] = resampled[k] and now != p[k].tolist()
            if not excused[k]:
                out.signal[k] = now
        if k in course.rungs:
            port.change(course.rungs[k])
        port.f = f[k].tolist()
        port.book()
        if port.ledger is not None:
            out.ledger[k] = port.ledger.total
        if k % EVERY == 0:
            progress(k)
    out.gaps += [replace(gap, why=f"{gap.why}: from there on it is not checked") for gap in course.unknown]
    out.gaps += gaps_of(excused, _SAID_BEFORE)
    return out
