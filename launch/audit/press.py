"""The stiffness that a hand was given, delivered against certified, where a recording has a press that allows it.

A device that is held still against a constant force shows it: the force over the distance from the device to its tool
in the world is the stiffness *delivered*. *Certified* is the static stiffness of the coupling for these forces,
|f_i| / |(V(1) f)_i|, without the world's compliance. Everything that lateness costs is in the first: forces that were
held back, and the offset that a clutch or the interface left behind.

A hand that moves tells nothing, so many recordings have no press. None is sought behind wave links, whose spring
depends on the round trip, nor where a coupling was softened.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from manyhands.design.models.axis import TRANSLATING, TURNING
from manyhands.launch.plan.prepare import Prepared
from manyhands.launch.recordings.run import RecordedRun, changed_after, rows_of
from manyhands.launch.session.session import ENVIRONMENT
from manyhands.nodes.rows import figures as names

Array = NDArray[np.float64]

BLOCK: Final = 0.1
"""What is averaged before it is compared, s: a force that the reserve interrupts still has a mean."""

LEAST_HOLD: Final = 1.0
"""The shortest press, s: longer than a coupling takes to settle."""

LEAST_FORCE: Final = 0.5
"""The least force of a press, N: below it friction and steps of an encoder count for much."""

STILL: Final = 5e-4
"""How far the device may move in a press, m; its hand's tremor is less."""

CONSTANT: Final = 0.1
"""The part of its first value by which the force may change in a press."""


@dataclass(frozen=True)
class Press:
    """A press on one axis of a device.

    Attributes:
        port: the axis.
        since: when it begins, s of the session's time.
        seconds: for how long it was held.
        force: the mean force on the device, N; greater than 0.
        delivered: the force over the distance from the device to its tool, N/m.
        certified: the static stiffness of the coupling, N/m.
        turns: whether the axis turns: what is in N and N/m otherwise is in N·m and N·m/rad.
    """

    port: str
    since: float
    seconds: float
    force: float
    delivered: float
    certified: float
    turns: bool = False

    def sentence(self) -> str:
        """The press in words."""
        units = TURNING if self.turns else TRANSLATING
        return (
            f"{self.port} was held still for {self.seconds:.1f} s at {self.force:.3g} {units('N')} from "
            f"{self.since:.1f} s on: {self.delivered:.4g} {units('N/m')} delivered of {self.certified:.4g} certified"
        )

    def as_plain(self) -> dict[str, Any]:
        """As a JSON object."""
        return asdict(self)


def presses(prepared: Prepared, run: RecordedRun) -> tuple[Press, ...]:
    """The longest press on each axis of a recorded run; none of an axis on which nothing was held still.

    Args:
        prepared: the session with its certificate.
        run: the recording.
    """
    return tuple(press for device in prepared.session.devices for press in _of_device(prepared, run, device))


def _of_device(prepared: Prepared, run: RecordedRun, device: str) -> Iterator[Press]:
    certificate, session = prepared.certificate_of(device), prepared.session
    linked = any(device in session.devices_of(name) for name in session.wave_links)
    if certificate is None or linked or changed_after(run.figures.get(device, ()), names.RUNG) is not None:
        return
    ports = certificate.loop.ports
    own = [ports.index(port) for port in run.recorded.ports[device]]
    compliance = np.linalg.inv(certificate.stiffness)[np.ix_(own, own)]
    tools = rows_of(run, ENVIRONMENT, names.TOOL_POSITION)[:, [session.ports.index(ports[i]) for i in own]]
    x, f = rows_of(run, device, names.DISPLACEMENT), rows_of(run, device, names.FORCE)
    ticks = min(len(x), len(tools))
    x, f, apart = (averaged(of[:ticks], run.recorded.period) for of in (x, f, x[:ticks] - tools[:ticks]))
    for axis, port in enumerate(run.recorded.ports[device]):
        begin, end = held_still(x[:, axis], f[:, axis])
        if (end - begin) * BLOCK < LEAST_HOLD:
            continue
        force, distance = -f[begin:end].mean(axis=0), float(apart[begin:end, axis].mean())
        certified = abs(float(force[axis])) / abs(float((compliance @ force)[axis]))
        if distance * force[axis] > 0.0:  # otherwise it is no spring that pushed it back
            delivered = float(force[axis]) / distance
            held, turns = (end - begin) * BLOCK, port in session.turning
            yield Press(port, begin * BLOCK, held, abs(float(force[axis])), delivered, certified, turns)


def averaged(rows: Array, period: float) -> Array:
    """The means of :data:`BLOCK` each, blocks x columns; NaN where a row is missing."""
    size = max(1, round(BLOCK / period))
    blocks = len(rows) // size
    means: Array = rows[: blocks * size].reshape(blocks, size, rows.shape[1]).mean(axis=1)
    return means


def held_still(x: Array, f: Array) -> tuple[int, int]:
    """Begin and end of the longest run of blocks in which x (m) is still and f (N) constant; (0, 0) for none."""
    best, begin = (0, 0), 0
    low = high = np.nan
    for k in range(len(x) + 1):
        if begin < k < len(x) and np.isfinite(x[k]):
            low, high = min(low, x[k]), max(high, x[k])
            if high - low <= STILL and abs(f[k] - f[begin]) <= CONSTANT * abs(f[begin]):
                continue
        if k > begin and k - begin > best[1] - best[0]:
            best = begin, k
        if k < len(x):
            usable = bool(abs(f[k]) >= LEAST_FORCE and np.isfinite(x[k]))
            begin, low, high = (k if usable else k + 1), x[k], x[k]
    return best
