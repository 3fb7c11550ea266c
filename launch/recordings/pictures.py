"""What a picture of a recording shows: panels of curves, delays, and marks of what happened; nothing is drawn here.

Which quantities there are follows from the table of topics (:mod:`manyhands.protocol.topics`) and from what the file
holds; velocities are made from the positions.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final

import numpy as np

from manyhands.launch.incidents import is_summary
from manyhands.launch.recordings.curves import Array, Curve, Panel, backward_difference
from manyhands.launch.recordings.recording import Recording, RecordingError
from manyhands.launch.recordings.run import Run, Trace
from manyhands.nodes.bundle import REALTIME
from manyhands.nodes.recorder.layout import CERTIFICATE_FILE
from manyhands.protocol.messages import Condition, Role
from manyhands.protocol.topics import LEDGER, TAU, TOPICS

VELOCITY: Final = "velocity"

_TITLES: Final[Mapping[str, str]] = MappingProxyType(
    {
        "sample": "positions of the devices",
        VELOCITY: "velocities of the devices",
        "force": "forces of the devices on the hands",
        "tool": "free positions of the tools, of the couplings",
        "reaction": "forces of the environment on the couplings",
        "tools": "positions of the tools in the environment",
        "masses": "positions of the masses in the environment",
        "ledger": "energy ledgers: below zero a promise is broken",
        "tau": "delays inside the tick",
    }
)
"""By quantity, in the order in which they are shown."""

QUANTITIES: Final = tuple(_TITLES)
SHOWN: Final = ("sample", VELOCITY, "force", "ledger", "tau")
"""What is shown where nothing is asked for, as far as it is recorded."""

_MOST_CERTIFICATE_BYTES = 64 * 2**20


class NotDrawable(RecordingError):
    """What was asked for cannot be shown of this recording."""


@dataclass(frozen=True)
class Mark:
    """Something that happened.

    Attributes:
        time: since tick 0, s, of the latest tick when it was told.
        text: what, a sentence.
    """

    time: float
    text: str


@dataclass(frozen=True, eq=False)
class Delays:
    """The delays of a run in real time.

    Attributes:
        curves: tau of each device, us.
        certified: tau of the certificate, us; None where the file has none.
        period: T, us.
    """

    curves: tuple[Curve, ...]
    certified: float | None
    period: float


@dataclass(frozen=True, eq=False)
class Picture:
    """All that one picture shows.

    Attributes:
        title: of what it is.
        period: T, s.
        first: the first tick shown.
        ticks: how many are shown.
        panels: over time, from above.
        delays: None where they are not shown.
        marks: in order.
        cut: why the file is not whole; None where it is.
    """

    title: str
    period: float
    first: int
    ticks: int
    panels: tuple[Panel, ...]
    delays: Delays | None = None
    marks: tuple[Mark, ...] = ()
    cut: str | None = None

    @property
    def time(self) -> Array:
        """The instants of the ticks shown, s."""
        return np.arange(self.first, self.first + self.ticks, dtype=np.float64) * self.period


def picture_of_run(run: Run, quantities: Sequence[str] | None = None) -> Picture:
    """What is shown of a recorded session.

    Args:
        run: the recording.
        quantities: some of :data:`QUANTITIES`; by default :data:`SHOWN`, as far as there are any.

    Raises:
        NotDrawable: a quantity that is none, or that is not in the file.
    """
    recorded, ticks = run.recorded, run.ticks
    realtime = recorded.clock == REALTIME
    there = {panel.name: panel for panel in _panels(run.traces, recorded.period, ticks)}
    delays = there.pop("tau", None)
    wanted = _wanted(quantities, [*there, *(["tau"] if delays and realtime else [])], realtime)
    name = f"{recorded.session}, {recorded.clock} clock, certificate {recorded.certificate:.12}"
    return Picture(
        title=f"{name}, {ticks} ticks, {ticks * recorded.period:g} s{', cut' if run.cut else ''}",
        period=recorded.period,
        first=run.first,
        ticks=ticks,
        panels=tuple(there[name] for name in wanted if name in there),
        delays=Delays(delays.curves, _certified_tau(run.attachments), recorded.period * 1e6)
        if delays is not None and "tau" in wanted
        else None,
        marks=marks_of(run.conditions, recorded.period),
        cut=run.cut,
    )


def picture_of_recording(recording: Recording, quantities: Sequence[str] | None = None) -> Picture:
    """What is shown of a recording that holds x and f_v alone, as :func:`picture_of_run`.

    Raises:
        NotDrawable: likewise.
    """
    topics = {topic.name: topic for topic in TOPICS[Role.DEVICE]}
    traces = {
        ("", name): Trace(topics[name], recording.ports, values)
        for name, values in (("sample", recording.x), ("force", recording.f_v))
    }
    ticks = len(recording.x)
    there = {panel.name: panel for panel in _panels(traces, recording.period, ticks)}
    wanted = _wanted(quantities, list(there), realtime=True)
    certificate = f", certificate {recording.certificate:.12}" if recording.certificate else ""
    title = f"{recording.session}{certificate}, {ticks} ticks, {ticks * recording.period:g} s"
    return Picture(title, recording.period, 0, ticks, tuple(there[name] for name in wanted), cut=recording.cut)


def between(picture: Picture, start: float | None, end: float | None) -> Picture:
    """The same of the time from ``start`` to ``end`` (s), both included.

    Raises:
        NotDrawable: no tick is in it.
    """
    stop = picture.first + picture.ticks
    last = (stop - 1) * picture.period
    for option, value in (("--from", start), ("--until", end)):
        if value is not None and not (math.isfinite(value) and value >= 0.0):
            raise NotDrawable(f"{option}: found {value:g} s; expected 0 or more")
    slack = 1e-9  # of a tick: 0.3 / 0.001 is not 300
    first = picture.first if start is None else max(picture.first, math.ceil(start / picture.period - slack))
    beyond = stop if end is None else min(stop, math.floor(end / picture.period + slack) + 1)
    if first >= stop:
        raise NotDrawable(f"--from: found {start:g} s; expected at most {last:g} s, where the recording ends")
    if first >= beyond:
        raise NotDrawable(f"--until: found {end:g} s; expected more than --from, {start or 0.0:g} s")
    delays, rows = picture.delays, (first - picture.first, beyond - picture.first)
    if delays is not None:
        curves = tuple(Curve(curve.label, curve.values[slice(*rows)]) for curve in delays.curves)
        delays = replace(delays, curves=curves)
    return replace(
        picture,
        first=first,
        ticks=beyond - first,
        panels=tuple(panel.window(*rows) for panel in picture.panels),
        delays=delays,
        marks=tuple(mark for mark in picture.marks if first <= mark.time / picture.period + slack < beyond),
    )


def marks_of(conditions: Iterable[tuple[int, Condition]], period: float) -> tuple[Mark, ...]:
    """What notices, incidents and faults were new in each condition."""
    marks: list[Mark] = []
    before: Counter[str] = Counter()
    for tick, condition in conditions:
        now = Counter(
            text for text in (*condition.notices, *condition.incidents, *condition.faults) if not is_summary(text)
        )
        marks += [Mark(tick * period, text) for text in (now - before).elements()]
        before = now
    return tuple(marks)


def _wanted(quantities: Sequence[str] | None, there: Collection[str], realtime: bool) -> tuple[str, ...]:
    """The quantities to be shown, in the order of the table."""
    if unknown := [name for name in quantities or () if name not in QUANTITIES]:
        raise NotDrawable(f"--topics: found {unknown[0]!r}; expected some of {', '.join(QUANTITIES)}")
    if "tau" in (quantities or ()) and not realtime:
        raise NotDrawable("--topics: found 'tau' of a run under the simulated clock; expected one in real time")
    if absent := [name for name in quantities or () if name not in there]:
        held = [name for name in QUANTITIES if name in there]
        raise NotDrawable(f"--topics: found {absent[0]!r}, which is not recorded; expected some of {', '.join(held)}")
    out = tuple(name for name in QUANTITIES if name in (quantities or SHOWN) and name in there)
    if not out:
        raise NotDrawable("found a recording without a tick of any quantity; expected something to draw")
    return out


def _panels(traces: Mapping[tuple[str, str], Trace], period: float, ticks: int) -> list[Panel]:
    """Every quantity that is recorded, in the order of the table; a node that did fewer ticks than others has a gap."""
    found: dict[str, list[Trace]] = {}
    nodes: dict[str, list[str]] = {}
    recorded = {name for (_, name), trace in traces.items() if not np.all(np.isnan(trace.values))}
    for (node, name), trace in traces.items():
        if name in recorded:
            found.setdefault(name, []).append(trace)
            nodes.setdefault(name, []).append(node)
    panels = []
    for name, title in _TITLES.items():
        source = "sample" if name == VELOCITY else name
        if source not in found:
            continue
        topic = found[source][0].topic
        curves: list[Curve] = []
        for node, trace in zip(nodes[source], found[source], strict=True):
            labels = (node,) if topic.trace in (LEDGER, TAU) else trace.columns
            values = _of_length(trace.values, ticks)
            if name == VELOCITY:
                values = backward_difference(values, period)
            curves += [Curve(label, column) for label, column in zip(labels, values.T, strict=True)]
        axis = f"velocity [{topic.unit}/s]" if name == VELOCITY else f"{topic.symbol} [{topic.unit}]"
        panels.append(Panel(name, title, axis, tuple(curves), zero=topic.trace == LEDGER))
    return panels


def _of_length(values: Array, ticks: int) -> Array:
    missing = ticks - len(values)
    return np.vstack([values, np.full((missing, values.shape[1]), np.nan)]) if missing > 0 else values


def _certified_tau(attachments: Mapping[str, bytes]) -> float | None:
    """Tau (us) of the certificate in the file; None where there is none, or nothing that makes sense of one."""
    text = attachments.get(CERTIFICATE_FILE, b"")
    if not 0 < len(text) <= _MOST_CERTIFICATE_BYTES:
        return None
    try:
        tau = json.loads(text)["tau"]
    except (ValueError, TypeError, KeyError, RecursionError):
        return None
    return 1e6 * tau if isinstance(tau, (int, float)) and 0.0 <= tau < math.inf else None
