"""What happened to a recorded node between its rows, by the events that it recorded with their ticks.

A process began at rest, ran free for some periods, went on at a later tick, or changed its rung
(:mod:`manyhands.nodes.rows.tick_events`). Events travel with the rows of the same telemetry message, and counts among
the figures state how many there were. Sometimes a count or the rows show that something happened, and no event states
what. Then a node's state is unknown from that tick on, until a new process begins, and the audit reports so.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from manyhands.launch.audit.findings import UncheckedTicks
from manyhands.launch.recordings.run import FiguresByTick, changed_after
from manyhands.nodes.rows import figures as names
from manyhands.nodes.rows.tick_events import Kind, events_in

_NEVER: Final = 2**62

_OF_A_CLUTCH: Final = (Kind.FROZEN, Kind.FREE, Kind.RETURNED)


@dataclass(frozen=True)
class Happening:
    """What happened to a node between two of its rows; it belongs to the later row.

    Attributes:
        began: whether this is the first row of a process, which begins at rest and at rung 0.
        jumped: whether the session had gone on without the node since the tick for which it sent its signal.
        follows: whether it is the first row of a process in the place of another, which may have sent its own signal of
            that tick before it ended.
        released: number of periods without force.
        rung: the rung that the node changed to in a tick without a row; None if it did not.
        leaves: whether a device begins to let go for good with this row's sample.
        unknown: why the node's state is not known from this row on; empty where it is.
    """

    began: bool = False
    jumped: bool = False
    follows: bool = False
    released: int = 0
    rung: int | None = None
    leaves: bool = False
    unknown: str = ""

    @property
    def may_be_zero(self) -> bool:
        """Whether a device's force may be the zero force of another tick, which is in no row of its couplings."""
        return self.jumped or self.follows


@dataclass(frozen=True)
class Course:
    """Everything that happened to a node in a recording.

    Attributes:
        before: what happened before a row, by the row's tick; most rows are absent.
        rungs: the rungs that it changed to, by tick.
        ticks: of the recording.
    """

    before: Mapping[int, Happening]
    rungs: Mapping[int, int]
    ticks: int

    @property
    def released(self) -> bool:
        """Whether the node was without a force in some period."""
        return any(happening.released for happening in self.before.values())

    @property
    def in_force(self) -> list[tuple[int, int]]:
        """The rungs in force after rung 0, each with its first tick, in order; a new process begins at rung 0."""
        begun = [(k, 0) for k, happening in self.before.items() if happening.began and k > 0]
        return sorted([*begun, *self.rungs.items()], key=lambda change: change[0])

    @property
    def unknown(self) -> list[UncheckedTicks]:
        """The ticks from which on the node's state is not known, each up to the next process."""
        out: list[UncheckedTicks] = []
        for k, happening in sorted(self.before.items()):
            if happening.began and out and out[-1].end > k:
                out[-1] = replace(out[-1], end=k)
            if happening.unknown:
                out.append(UncheckedTicks(k, self.ticks, happening.unknown))
        return out

    @property
    def resampled(self) -> NDArray[np.bool_]:
        """The ticks at which the node may have been elsewhere when it sent its signal than its row states."""
        out = np.zeros(self.ticks, dtype=np.bool_)
        out[[k for k, h in self.before.items() if h.released or h.may_be_zero]] = True
        for gap in self.unknown:
            out[gap.begin : gap.end] = True
        return out


def course_of(
    figures: FiguresByTick, rows: NDArray[np.bool_], ladder: int, couplings: Sequence[FiguresByTick] = ()
) -> Course:
    """The course of a node.

    Args:
        figures: the node's.
        rows: the ticks of which it has a row.
        ladder: its number of rungs.
        couplings: of a device, the figures of its couplings. If it recorded no events, they show that its rung, which
            is theirs, changed.
    """
    processes = _processes(figures, ladder)
    if not any(process.recorded for process in processes):
        changed = [changed_after(own, names.RUNG) for own in couplings]
        processes[0].doubt(min((at for at in changed if at is not None), default=_NEVER), "a rung")
    before: dict[int, Happening] = {}
    rungs: dict[int, int] = {}
    ticks, every = np.flatnonzero(rows), len(rows)
    for process, end in zip(processes, [*(p.begin for p in processes[1:]), every], strict=True):
        own = ticks[(ticks >= process.begin) & (ticks < end)]
        if len(own):
            before |= process.happenings(own)
        rungs |= {max(tick, process.begin): rung for tick, rung in process.rungs.items() if tick < end}
    return Course(before, rungs, every)


def frozen_in(
    figures: FiguresByTick, coupling: str, rows: NDArray[np.bool_], done: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """The ticks in which the environment sent a coupling no force, by the environment's events.

    A new process of the environment sends no coupling a force before its return. A coupling may have a row in such a
    tick: that of its return, in which it receives no force yet. Where a row of the environment is missing, so may be
    the event of the return: then the coupling's next row ends the time.

    Args:
        figures: the environment's.
        coupling: its name.
        rows: the ticks of which the coupling has a row.
        done: the ticks of which the environment has a row, or which it did not do.
    """
    out = np.zeros(len(rows), dtype=np.bool_)
    changes = [
        (event.tick, event.kind is not Kind.RETURNED)
        for _, values in figures
        for event in sorted(events_in(values), key=lambda event: event.kind is not Kind.BEGAN)
        if event.tick < len(rows)
        and ((event.kind is Kind.BEGAN and event.tick > 0) or (event.peer == coupling and event.kind in _OF_A_CLUTCH))
    ]
    for (begin, frozen), (end, _) in pairwise([*changes, (len(rows), False)]):
        if frozen:
            lost = np.flatnonzero(~done[begin:end])
            known = begin + int(lost[0]) if len(lost) else end
            again = np.flatnonzero(rows[known:end])
            out[begin : known + int(again[0]) if len(again) else end] = True
    return out


def held_in(figures: FiguresByTick, coupling: str, ticks: int) -> NDArray[np.bool_]:
    """The ticks in which the environment held a coupling, by the environment's events."""
    out = np.zeros(ticks, dtype=np.bool_)
    for _, values in figures:
        for event in events_in(values):
            if event.kind is Kind.HELD and event.peer == coupling:
                out[event.tick : event.tick + event.value] = True
    return out


def jumped_over(figures: FiguresByTick, ticks: int) -> NDArray[np.bool_]:
    """The ticks that a node did not do, since the session had gone on without it, by its own events."""
    out = np.zeros(ticks, dtype=np.bool_)
    for _, values in figures:
        for event in events_in(values):
            if event.kind is Kind.JUMPED:
                out[event.value : event.tick] = True
    return out


@dataclass
class _Process:
    """The events of one process of a node.

    Attributes:
        begin: the tick of its first row; 0 where no event states it.
        recorded: whether an event states it.
        late: whether it began at an earlier tick, and the session had gone on before its first row.
        jumps: by the tick of a row, the tick after the row before.
        releases: number of periods without force, by the tick that was awaited.
        rungs: by tick.
        leaves: ticks from which on it lets go for good.
        known: the tick from which on events are missing.
        why: how that is known.
    """

    begin: int = 0
    recorded: bool = False
    late: bool = False
    jumps: dict[int, int] = field(default_factory=dict)
    releases: dict[int, int] = field(default_factory=dict)
    rungs: dict[int, int] = field(default_factory=dict)
    leaves: list[int] = field(default_factory=list)
    known: int = _NEVER
    why: str = ""

    def doubt(self, tick: int, what: str) -> None:
        """Note that events of ``what`` are missing from ``tick`` on."""
        if tick < self.known:
            self.known, self.why = tick, f"{what} changed, and no event states at which tick"

    def happenings(self, rows: NDArray[np.intp]) -> dict[int, Happening]:
        """What happened before each of the process's rows."""
        out: dict[int, Happening] = {}
        first = int(rows[0])
        if self.recorded:
            out[first] = Happening(began=True, jumped=self.late, follows=first > 0)
        if first != self.begin:
            out[first] = replace(out.get(first, Happening()), unknown="its first rows are missing")
        for i in np.flatnonzero(np.diff(rows) != 1):
            last, k = int(rows[i]), int(rows[i + 1])
            if self.jumps.get(k) == last + 1:
                out[k] = Happening(jumped=True)
            else:
                out[k] = Happening(unknown="it had rows missing, and no event states why")
        for tick, periods in self.releases.items():
            for k in _row_from(rows, tick):
                known = out.get(k, Happening())
                out[k] = replace(known, released=known.released + periods)
        for tick, rung in sorted(self.rungs.items()):
            for k in _row_from(rows, tick):
                if k != tick:
                    out[k] = replace(out.get(k, Happening()), rung=rung)
        for tick in self.leaves:
            for k in _row_from(rows, tick):
                out[k] = replace(out.get(k, Happening()), leaves=True)
        for k in _row_from(rows, self.known):
            known = out.get(k, Happening())
            out[k] = replace(known, unknown=known.unknown or self.why)
        return out


def _row_from(rows: NDArray[np.intp], tick: int) -> list[int]:
    """The first row of ``tick`` or later, if there is one."""
    i = int(np.searchsorted(rows, tick))
    return [int(row) for row in rows[i : i + 1]]


def _processes(figures: FiguresByTick, ladder: int) -> list[_Process]:
    """The processes of a node, in order; at least one, which may lack the event of its beginning."""
    out = [_Process()]
    released, rung, before = 0, 0, 0
    for tick, values in figures:
        events = sorted(events_in(values), key=lambda event: (event.kind is not Kind.BEGAN, event.tick))
        for event in events:
            match event.kind:
                case Kind.BEGAN:
                    if event.tick >= out[-1].begin:
                        # the count of a process's first telemetry is that of its first row: a jump begins a telemetry
                        late = values.get(names.JUMPS, 0.0) > 0.0
                        out.append(_Process(event.tick, recorded=True, late=late))
                        released, rung, before = 0, 0, event.tick
                case Kind.JUMPED:
                    out[-1].jumps[event.tick] = event.value
                case Kind.RELEASED:
                    out[-1].releases[event.tick] = event.value
                    released += event.value
                case Kind.RUNG if event.value < ladder:
                    out[-1].rungs[event.tick] = rung = event.value
                case Kind.LEAVING:
                    out[-1].leaves.append(event.tick)
                case Kind.RUNG:
                    out[-1].doubt(event.tick, "the rung")
        for what, count, figure in (
            ("the count of free periods", released, names.RELEASED),
            ("the rung", rung, names.RUNG),
        ):
            if values.get(figure, count) != count:
                out[-1].doubt(before, what)
        before = tick
    return out[1:] if len(out) > 1 and out[1].begin == 0 else out
