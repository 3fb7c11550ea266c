"""Runs a recorded session again and compares every recorded number, bit for bit.

Under the simulated clock nothing in a session depends on the machine. The cores take the same steps in the same order,
and the result is the same to the last bit. If it is not, another version recorded it, or the recording was changed.

The displacement of a device that a person moved is taken from the recording, since no arithmetic can produce it. So is
that of a device with a driver of another package, whose code is not run. A session that lost a process cannot be
replayed, since the tick of its death is not recorded.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from manyhands.launch.audit.findings import Difference, first_of
from manyhands.launch.audit.simulation import Simulation
from manyhands.launch.plan.prepare import Prepared
from manyhands.launch.plan.recorded import Traces
from manyhands.launch.recordings.recording import RecordingError
from manyhands.launch.recordings.run import RecordedRun, RecordedTrace, pressed_in, rows_of
from manyhands.launch.session import PERSONS, Session
from manyhands.nodes.device.drivers import Driver, driver_of
from manyhands.nodes.environment.model import ModelFailure
from manyhands.nodes.kernel.bundle import SIMULATED, DeviceBundle
from manyhands.nodes.kernel.orientation import UPRIGHT, Quaternion
from manyhands.nodes.recorder.coverage import Coverage
from manyhands.nodes.rows.units import unit_of_all
from manyhands.protocol.channels import DISPLACEMENT, LEDGER, ORIENTATION, TAU
from manyhands.protocol.clock import Instant
from manyhands.protocol.messages import Figures

COMPUTED: Final = frozenset({"simulated", "trace"})
"""Drivers whose motion follows from the session and the forces alone."""


def given_devices(session: Session, clock: str) -> tuple[str, ...]:
    """The devices whose motion only a recording has.

    A person moved them, as under the realtime clock alone; or a driver of another package did, which is neither
    imported nor run to look at a recording.
    """
    computed = COMPUTED if clock != SIMULATED else COMPUTED | {*PERSONS}
    return tuple(name for name, device in session.devices.items() if device.driver not in computed)


def hand_of(bundle: DeviceBundle, session: Session, clock: str) -> Driver | str:
    """The device and its hand, at rest; or the reason why its motion does not follow from the recording."""
    name = bundle.common.name
    if name in given_devices(session, clock):
        return "a person or a driver of another package moved the device"
    return driver_of(bundle)


class GivenMotion:
    """A :class:`manyhands.nodes.device.drivers.Driver` that moves as was recorded, whatever force is exerted on it.

    Attributes:
        ticks: number of ticks that were recorded without a gap.
    """

    def __init__(
        self,
        x: NDArray[np.float64],
        applied: NDArray[np.float64] | None = None,
        work: NDArray[np.float64] | None = None,
        pressed: Mapping[int, int] = MappingProxyType({}),
        turned: NDArray[np.float64] | None = None,
    ) -> None:
        """Move as ``x`` at the samples, and as ``applied`` when a force is applied.

        Args:
            x: ticks x axes, m.
            applied: likewise; NaN in ticks in which it is not known. None for ``x``.
            work: of motors that hold torques, until the sample and from then until the force, ticks x 2, J.
            pressed: by tick, the buttons that are held down from then on.
            turned: its orientation at the samples, ticks x 4; None where that is no port.
        """
        self._turned = turned
        self._presses, self._pressed = pressed, 0
        self._work, self._called = work, 0
        self._x, self._applied, self._tick = x, x if applied is None else applied, 0
        holes = np.flatnonzero(~np.isfinite(x).all(axis=1))
        self.ticks = int(holes[0]) if len(holes) else len(x)

    @property
    def axes(self) -> int:
        """Number of axes."""
        return int(self._x.shape[1])

    def sample(self, tick: int, at: Instant) -> list[float]:
        """The position at that tick, m."""
        self._tick, self._called = tick, 0
        self._pressed = self._presses.get(tick, self._pressed)
        row: list[float] = self._x[tick].tolist()
        return row

    def apply(self, f: Sequence[float], at: Instant, until: Instant | None = None) -> list[float] | None:
        """The force has no effect; returns the position at which it is applied, m, or None where it is not known."""
        self._called = 1
        row: list[float] = self._applied[self._tick].tolist()
        return row if all(map(math.isfinite, row)) else None

    def apply_wrench(
        self, f: Sequence[float], torque: Sequence[float], at: Instant, until: Instant | None = None
    ) -> list[float] | None:
        """Force and torque have no effect; returns as :meth:`apply`."""
        return self.apply(f, at, until)

    def orientation(self) -> Quaternion:
        """The orientation at the tick of the last sample; upright where it is not known."""
        row = [] if self._turned is None else self._turned[self._tick].tolist()
        return Quaternion(*row) if all(map(math.isfinite, row)) else UPRIGHT

    def release(self, at: Instant) -> list[float] | None:
        """There is no force to release; returns the position as :meth:`apply`."""
        return self.apply((), at)

    def idle(self, due: Instant) -> None:
        """There is no deferred work."""

    def intended_work(self) -> float:
        """Zero: the work of a person is unknown."""
        return 0.0

    def work(self) -> float | None:
        """What its motors did until the sample or the force that was called last, J; infinite where they cannot tell.

        None where nothing of it was recorded.
        """
        if self._work is None:
            return None
        done = float(self._work[self._tick, self._called])
        return done if math.isfinite(done) else math.inf

    def buttons(self) -> int:
        """The buttons that were held down at that tick."""
        return self._pressed

    def figures(self) -> Figures:
        """No figures."""
        return Figures()

    def close(self) -> None:
        """There is nothing to close."""


Array = NDArray[np.float64]


@dataclass(frozen=True)
class Deviation:
    """The first number of a topic that differs when the session is run again.

    Attributes:
        node: the node.
        topic: its topic's name.
        unit: of the numbers.
        first: tick, column and both numbers.
    """

    node: str
    topic: str
    unit: str
    first: Difference


@dataclass(frozen=True)
class Replayed:
    """The result of a replay.

    Attributes:
        ticks: number of ticks that were run again.
        numbers: how many numbers were compared, bit for bit.
        differing: how many of them differ.
        deviations: the first number of every topic that differs, in the order of ticks.
        missing: by node and topic, the number of ticks without a recorded row before its last one.
        given: devices whose motion was taken from the recording, since a person moved them.
        ended: why the session ended before its recording does; empty otherwise.
        incidents: the recorded session's incidents, which a replay does not repeat.
    """

    ticks: int
    numbers: int
    differing: int
    deviations: tuple[Deviation, ...]
    missing: Mapping[str, int]
    given: tuple[str, ...]
    ended: str
    incidents: tuple[str, ...]

    @property
    def identical(self) -> bool:
        """Whether every number was recorded and is the same."""
        return not (self.deviations or self.missing or self.ended) and self.numbers > 0

    def as_plain(self) -> dict[str, Any]:
        """As a JSON object."""
        return {
            "identical": self.identical,
            "ticks": self.ticks,
            "numbers": self.numbers,
            "differing": self.differing,
            "deviations": [
                {"node": d.node, "topic": d.topic, "unit": d.unit, **d.first.as_plain()} for d in self.deviations
            ],
            "missing": dict(self.missing),
            "given": list(self.given),
            "ended": self.ended,
            "incidents": list(self.incidents),
        }


def require_simulated(path: Path, run: RecordedRun) -> None:
    """Refuse a recording of a session that kept real time, or whose nodes have different periods.

    Raises:
        RecordingError: the recording has the realtime clock, or a site with a period of its own.
    """
    if run.recorded.periods:
        raise RecordingError(
            f"{path}: found the period {next(iter(run.recorded.periods.values())):g} s of "
            f"{next(iter(run.recorded.periods))}; expected the session's, {run.recorded.period:g} s, for every node, "
            f"since a simulation has one. manyhands audit {path} checks a recording of either kind"
        )
    if run.recorded.clock != SIMULATED:
        raise RecordingError(
            f"{path}: found a session in real time ({run.recorded.clock}), where late ticks and frozen couplings "
            f"depend on the machine; expected one under --clock {SIMULATED}. manyhands audit {path} checks "
            "a recording of either kind"
        )


def replay(prepared: Prepared, run: RecordedRun, progress: Callable[[int], None] | None = None) -> Replayed:
    """Run a recorded session again and compare it.

    Args:
        prepared: the session that was recorded.
        run: its recording.
        progress: called now and then with the number of ticks that are done.

    Raises:
        FactoryError: the environment's model cannot be made.
        ModelFailure: the model gave no usable forces, as it had when it was recorded.
    """
    given = given_devices(prepared.session, run.recorded.clock)
    drivers = {
        name: GivenMotion(
            rows_of(run, name, DISPLACEMENT),
            pressed=pressed_in(run.figures.get(name, ()), prepared.session.buttons_at[name]),
            turned=rows_of(run, name, ORIENTATION) if name in prepared.session.hands else None,
        )
        for name in given
    }
    ticks = min([run.ticks, *(driver.ticks for driver in drivers.values())])
    simulation = Simulation(prepared, drivers)
    traces = simulation.traces(ticks)
    ended = ""
    try:
        simulation.run(ticks, progress, traces=traces)
    except ModelFailure as error:
        ended = str(error)
    return _compared(run, ticks, traces, given, ended)


def _compared(run: RecordedRun, ticks: int, traces: Traces, given: Sequence[str], ended: str) -> Replayed:
    numbers = differing = done = 0
    deviations: list[Deviation] = []
    missing: dict[str, int] = {}
    for (node, topic), trace in run.traces.items():
        if trace.topic.trace == TAU or _believed(trace, node in given):
            continue
        recomputed = next((kept.values for kept in traces.by_node[node] if kept.topic.name == topic), None)
        rows = np.flatnonzero(~np.isnan(trace.values[:ticks]).all(axis=1))
        coverage = Coverage()
        coverage.take_each(rows)
        last = coverage.next
        if recomputed is None:
            if last:
                raise RecordingError(f"found the topic {topic} of {node} in the recording; expected none of it")
            continue  # the node keeps no ledger, and none was recorded
        if lacking := coverage.missing_in(0, last or ticks):
            missing[f"{node}/{topic}"] = lacking
        recorded, again = trace.values[rows], recomputed[rows]
        wrong = recorded.view(np.int64) != again.view(np.int64)
        first = first_of(wrong, trace.columns, recorded, again)
        numbers, differing, done = numbers + recorded.size, differing + int(wrong.sum()), max(done, last)
        if first is not None:
            at = Difference(int(rows[first.tick]), first.column, first.recorded, first.recomputed)
            deviations.append(Deviation(node, topic, unit_of_all(trace.topic, (at.column,), run.recorded.turning), at))
    unrecorded = {
        f"{node}/{kept.topic.name}": ticks
        for node, topics in traces.by_node.items()
        for kept in topics
        if (node, kept.topic.name) not in run.traces
    }
    incidents = run.conditions[-1][1].incidents if run.conditions else ()
    return Replayed(
        done,
        numbers,
        differing,
        tuple(sorted(deviations, key=lambda deviation: deviation.first.tick)),
        missing | unrecorded,
        tuple(given),
        ended if deviations else "",
        tuple(incidents),
    )


def _believed(trace: RecordedTrace, given: bool) -> bool:
    """Whether a topic is taken from the recording: the motion of a device that a person moved, and its ledger."""
    return given and trace.topic.trace in (DISPLACEMENT, ORIENTATION, LEDGER)
