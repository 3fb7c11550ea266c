"""Pictures of recordings: panels of curves over one time axis, the delays as a histogram, incidents as numbered marks.

A :class:`Picture` states what is shown, and holds no drawing. Its quantities follow from the table of topics
(:mod:`manyhands.protocol.channels`) and from what the file holds; velocities are computed from positions, and from the
instants of their samples where these are recorded. :func:`draw`
is the way from a recording's file to its picture's, with progress.

Texts come from files of any origin: none is read as mathematics, and none is longer than a line.
"""

from __future__ import annotations

import json
import math
import textwrap
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.console import Console

from manyhands.launch.look.display import progress_bar
from manyhands.launch.look.figures import COLOURS, new_figure, require_picture, save
from manyhands.launch.recordings.curves import (
    Array,
    Curve,
    Panel,
    alone,
    backward_difference,
    band,
    by_rate,
    gaps,
    thinned,
)
from manyhands.launch.recordings.formats import RUN_SUFFIXES, STREAMED
from manyhands.launch.recordings.recording import Recording, RecordingError, require_format
from manyhands.launch.recordings.run import RecordedRun, RecordedTrace, read_run
from manyhands.launch.recordings.tables import read_saved
from manyhands.launch.run.states import is_summary
from manyhands.nodes.kernel.bundle import REALTIME
from manyhands.nodes.kernel.orientation import angles
from manyhands.nodes.recorder.format import CERTIFICATE_FILE
from manyhands.nodes.rows.own_ticks import own_tick
from manyhands.nodes.rows.units import units_of_columns
from manyhands.protocol.channels import INSTANTS, INTERFACE, LEDGER, TAU, TOPICS
from manyhands.protocol.messages import Condition, Role, presentable

VELOCITY: Final = "velocity"
ANGLE: Final = "angle"
_DERIVED: Final[Mapping[str, str]] = MappingProxyType({VELOCITY: "sample", ANGLE: "orientation"})
"""The quantities that are no topic, by what they are computed from."""


_TITLES: Final[Mapping[str, str]] = MappingProxyType(
    {
        "sample": "positions of the devices",
        VELOCITY: "velocities of the devices",
        "force": "forces of the devices on the hands",
        "orientation": "orientations of the devices, as unit quaternions",
        "proxy": "where the world would have their tools, as unit quaternions",
        ANGLE: "angles between the devices and their tools",
        "torque": "torques of the devices on the hands",
        "account": "accounts of the orientations: A below D - G, and a promise is broken",
        "tool": "free positions of the tools, of the couplings",
        "reaction": "forces of the environment on the couplings",
        "tools": "positions of the tools in the environment",
        "masses": "positions of the masses in the environment",
        "orientations": "orientations of the bodies in the environment, as unit quaternions",
        "ledger": "energy ledgers: below zero a promise is broken",
        "tau": "delays inside the tick",
        "interface": "energy accounts of the devices' interfaces",
        "wave": "waves that come in over wave links",
        "tank": "energy of the ends of wave links: in the tank (L), shipped (G), heard (H)",
    }
)
"""Titles by quantity, in the order in which they are shown."""

_INSTANTS: Final = next(topic.name for topic in TOPICS[Role.DEVICE] if topic.trace == INSTANTS)

QUANTITIES: Final = tuple(_TITLES)
SHOWN: Final = ("sample", VELOCITY, "force", "ledger", "tau", "interface")
"""The quantities that are shown by default, as far as they are recorded."""

_MOST_CERTIFICATE_BYTES = 64 * 2**20


class NotDrawable(RecordingError):
    """The recording does not hold what was asked for."""


@dataclass(frozen=True)
class Mark:
    """An event in a picture.

    Attributes:
        time: s since tick 0, of the latest tick when it was reported.
        text: what happened, a sentence.
    """

    time: float
    text: str


@dataclass(frozen=True, eq=False)
class Delays:
    """The delays of a run in real time.

    Attributes:
        curves: tau of each device, us.
        certified: tau of the certificate, us; None where the file has none.
        periods: T of the devices, us, each once.
    """

    curves: tuple[Curve, ...]
    certified: float | None
    periods: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Picture:
    """The content of one picture.

    Attributes:
        title: of the picture.
        period: T, s; a node with a period of its own has curves of another rate.
        first: the first tick shown.
        ticks: number of ticks shown.
        panels: over time, from the top.
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


def picture_of_run(run: RecordedRun, quantities: Sequence[str] | None = None) -> Picture:
    """The picture of a recorded session.

    Args:
        run: the recording.
        quantities: some of :data:`QUANTITIES`; by default :data:`SHOWN`, as far as they are recorded.

    Raises:
        NotDrawable: a quantity is unknown or not in the file.
    """
    recorded, ticks = run.recorded, run.ticks
    realtime = recorded.clock == REALTIME
    there = _by_name(_panels(run.traces, recorded.turning, recorded.period, run.ticks_of, recorded.rate_of))
    delays = next(iter(there.pop("tau", ())), None)
    wanted = _wanted(quantities, [*there, *(["tau"] if delays and realtime else [])], realtime)
    name = f"{recorded.session}, {recorded.clock} clock, certificate {recorded.certificate:.12}"
    return Picture(
        title=f"{name}, {ticks} ticks, {ticks * recorded.period:g} s{', cut' if run.cut else ''}",
        period=recorded.period,
        first=run.first,
        ticks=ticks,
        panels=tuple(panel for name in wanted for panel in there.get(name, ())),
        delays=Delays(
            delays.curves,
            _certified_tau(run.attachments),
            tuple(sorted({recorded.period_of(device) * 1e6 for device in recorded.devices})),
        )
        if delays is not None and "tau" in wanted
        else None,
        marks=marks_of(run.conditions, recorded.period),
        cut=run.cut,
    )


def picture_of_recording(recording: Recording, quantities: Sequence[str] | None = None) -> Picture:
    """The picture of a recording that holds x and f_v alone; arguments as of :func:`picture_of_run`.

    Raises:
        NotDrawable: as :func:`picture_of_run`.
    """
    topics = {topic.name: topic for topic in TOPICS[Role.DEVICE]}
    traces = {
        ("", name): RecordedTrace(topics[name], recording.ports, values)
        for name, values in (("sample", recording.x), ("force", recording.f_v))
    }
    ticks = len(recording.x)
    panels = _panels(traces, recording.turning, recording.period, lambda _node: ticks, lambda _node: 1.0)
    there = _by_name(panels)
    wanted = _wanted(quantities, list(there), realtime=True)
    certificate = f", certificate {recording.certificate:.12}" if recording.certificate else ""
    title = f"{recording.session}{certificate}, {ticks} ticks, {ticks * recording.period:g} s"
    shown = tuple(panel for name in wanted for panel in there[name])
    return Picture(title, recording.period, 0, ticks, shown, cut=recording.cut)


def _by_name(panels: Iterable[Panel]) -> dict[str, list[Panel]]:
    """The panels of each quantity: one for each of its units."""
    found: dict[str, list[Panel]] = {}
    for panel in panels:
        found.setdefault(panel.name, []).append(panel)
    return found


def between(picture: Picture, start: float | None, end: float | None) -> Picture:
    """The same picture for the time from ``start`` to ``end`` (s), both included.

    Raises:
        NotDrawable: no tick lies in it.
    """
    stop = picture.first + picture.ticks
    last = (stop - 1) * picture.period
    for option, value in (("--from", start), ("--until", end)):
        if value is not None and not (math.isfinite(value) and value >= 0.0):
            raise NotDrawable(f"{option}: found {value:g} s; expected 0 or more")
    slack = 1e-9  # of a tick, for rounding: 0.3 / 0.001 is not 300
    first = picture.first if start is None else max(picture.first, math.ceil(start / picture.period - slack))
    beyond = stop if end is None else min(stop, math.floor(end / picture.period + slack) + 1)
    if first >= stop:
        raise NotDrawable(f"--from: found {start:g} s; expected at most {last:g} s, where the recording ends")
    if first >= beyond:
        raise NotDrawable(f"--until: found {end:g} s; expected more than --from, {start or 0.0:g} s")
    delays, rows = picture.delays, (first - picture.first, beyond - picture.first)
    if delays is not None:
        curves = tuple(curve.window(range(*rows)) for curve in delays.curves)
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
    """The notices, incidents, visits and faults that are new in each condition."""
    marks: list[Mark] = []
    before: Counter[str] = Counter()
    for tick, condition in conditions:
        told = (*condition.notices, *condition.incidents, *condition.visits, *condition.faults)
        now = Counter(text for text in told if not is_summary(text))
        marks += [Mark(tick * period, text) for text in (now - before).elements()]
        before = now
    return tuple(marks)


def _wanted(quantities: Sequence[str] | None, there: Collection[str], realtime: bool) -> tuple[str, ...]:
    """The quantities to show, in the order of the table."""
    if unknown := [name for name in quantities or () if name not in QUANTITIES]:
        raise NotDrawable(f"--show: found {unknown[0]!r}; expected some of {', '.join(QUANTITIES)}")
    if "tau" in (quantities or ()) and not realtime:
        raise NotDrawable("--show: found 'tau' of a run under the simulated clock; expected one in real time")
    if absent := [name for name in quantities or () if name not in there]:
        held = [name for name in QUANTITIES if name in there]
        raise NotDrawable(f"--show: found {absent[0]!r}, which is not recorded; expected some of {', '.join(held)}")
    out = tuple(name for name in QUANTITIES if name in (quantities or SHOWN) and name in there)
    if not out:
        raise NotDrawable("found a recording without a tick of any quantity; expected something to draw")
    return out


def _panels(
    traces: Mapping[tuple[str, str], RecordedTrace],
    turning: Collection[str],
    period: float,
    ticks_of: Callable[[str], int],
    rate_of: Callable[[str], float],
) -> list[Panel]:
    """A panel for every recorded quantity and unit, in the order of the table; a node with fewer rows has a gap.

    Args:
        traces: by node and topic name.
        turning: the ports and masses that turn.
        period: T of the picture, s.
        ticks_of: the number of a node's ticks.
        rate_of: ticks of a node in one of the picture's.
    """
    found: dict[str, list[RecordedTrace]] = {}
    nodes: dict[str, list[str]] = {}
    recorded = {name for (_, name), trace in traces.items() if not np.all(np.isnan(trace.values))}
    for (node, name), trace in traces.items():
        if name in recorded:
            found.setdefault(name, []).append(trace)
            nodes.setdefault(name, []).append(node)
    panels = []
    for name, title in _TITLES.items():
        source = _DERIVED.get(name, name)
        if source not in found:
            continue
        topic = found[source][0].topic
        curves: list[Curve] = []
        units: list[str] = []
        for node, trace in zip(nodes[source], found[source], strict=True):
            if name == ANGLE and (node, "proxy") not in traces:
                continue  # sensed alone: no spring pulls at the hand
            labels = (node,) if topic.trace in (LEDGER, TAU, INTERFACE) or name == ANGLE else trace.columns
            if topic.hands and name != ANGLE:
                labels = tuple(f"{node}.{column}" for column in labels)
            ticks, rate = ticks_of(node), rate_of(node)
            used = {curve.label for curve in curves}
            labels = tuple(f"{node} {label}" if label in used else label for label in labels)
            values = _of_length(trace.values, ticks)
            if name == VELOCITY:
                instants = traces.get((node, _INSTANTS))
                values = backward_difference(
                    values, period / rate, None if instants is None else _of_length(instants.values[:, :1], ticks)
                )
            if name == ANGLE:
                values = angles(values, _of_length(traces[node, "proxy"].values, ticks))[:, None]
            curves += [Curve(label, column, rate) for label, column in zip(labels, values.T, strict=True)]
            units += ["rad"] if name == ANGLE else units_of_columns(topic, trace.columns, turning)
        for unit in dict.fromkeys(units):
            own = tuple(curve for curve, its in zip(curves, units, strict=True) if its == unit)
            symbol = "θ" if name == ANGLE else topic.symbol
            axis = f"velocity [{unit}/s]" if name == VELOCITY else f"{symbol} [{unit}]"
            panels.append(Panel(name, title, axis, own, zero=topic.trace in (LEDGER, INTERFACE)))
    return panels


def _of_length(values: Array, ticks: int) -> Array:
    missing = ticks - len(values)
    return np.vstack([values, np.full((missing, values.shape[1]), np.nan)]) if missing > 0 else values


def _certified_tau(attachments: Mapping[str, bytes]) -> float | None:
    """Tau (us) of the certificate in the file; None where there is no certificate, or none that makes sense."""
    text = attachments.get(CERTIFICATE_FILE, b"")
    if not 0 < len(text) <= _MOST_CERTIFICATE_BYTES:
        return None
    try:
        tau = json.loads(text)["tau"]
    except (ValueError, TypeError, KeyError, RecursionError):
        return None
    return 1e6 * tau if isinstance(tau, (int, float)) and 0.0 <= tau < math.inf else None


MOST_LINES = 12
"""A panel with more curves shows the band that they fill."""

MOST_MARKS_LISTED = 30

_GAP, _MARK, _BAD = "0.85", "0.35", "#B00020"
_WIDTH = 10.0  # inches
_PANEL, _HISTOGRAM, _LINE, _HEAD = 2.1, 2.6, 0.16, 0.7  # heights, inches
_LONGEST_LABEL, _LINE_LENGTH = 24, 150  # characters
_BINS = 120
_NEAR = 0.045  # of the width: marks nearer than this share one label


def figure_of(picture: Picture) -> Figure:
    """The figure; its axes are the panels in order, then the histogram and the list of marks, where there are any."""
    lines = _mark_lines(picture.marks)
    heights = [_PANEL] * len(picture.panels)
    heights += [_HISTOGRAM] if picture.delays is not None else []
    heights += [_LINE * (len(lines) + 1)] if lines else []
    figure = new_figure(_WIDTH, sum(heights) + _HEAD)
    figure.suptitle(plain(picture.title, _LINE_LENGTH), x=0.01, ha="left", fontsize="medium", fontweight="bold")
    grid = figure.add_gridspec(len(heights), 1, height_ratios=heights)
    time = picture.time
    first: Axes | None = None
    for row, panel in enumerate(picture.panels):
        axes = figure.add_subplot(grid[row], sharex=first)
        first = first or axes
        draw_panel(axes, time, panel)
        _draw_marks(axes, picture, time, numbers=row == 0)
        axes.tick_params(labelbottom=row == len(picture.panels) - 1)
        axes.set_xlabel("time [s]" if row == len(picture.panels) - 1 else "")
    if picture.delays is not None:
        draw_delays(figure.add_subplot(grid[len(picture.panels)]), picture.delays)
    if lines:
        axes = figure.add_subplot(grid[len(heights) - 1])
        axes.axis("off")
        axes.text(0.0, 1.0, "\n".join(lines), va="top", fontsize="x-small", transform=axes.transAxes)
    if picture.cut is not None:
        text = f"This recording is cut: {picture.cut}"
        figure.supxlabel(
            "\n".join(textwrap.wrap(plain(text, 3 * _LINE_LENGTH), _LINE_LENGTH - 30)),
            x=0.01, ha="left", fontsize="small", color=_BAD,
        )  # fmt: skip
    return figure


def draw_panel(axes: Axes, time: Array, panel: Panel) -> None:
    """Draw curves against ``time`` (s): lines of a few, the band between the extremes of many.

    No extreme is lost where there are more ticks than pixels: see :mod:`manyhands.launch.recordings.curves`.
    """
    axes.set_title(panel.title, loc="left", fontsize="small")
    axes.set_xlabel("time [s]")
    axes.set_ylabel(panel.axis, fontsize="small")
    axes.grid(alpha=0.3)
    axes.margins(x=0.0)
    if panel.zero:
        axes.axhline(0.0, color=_BAD, linewidth=0.8, linestyle=":")
    groups = by_rate(panel.curves)
    times = {rate: _time_of(curves[0], time) for rate, curves in groups.items()}
    spans = []
    for rate, curves in groups.items():
        own = times[rate]
        period = own[1] - own[0] if len(own) > 1 else 0.0
        spans += [(own[first], (beyond - first) * period) for first, beyond in gaps(curves)]
    if spans:
        axes.broken_barh(spans, (0.0, 1.0), transform=axes.get_xaxis_transform(), facecolor=_GAP,
                         edgecolor=_GAP, linewidth=0.5, zorder=0.5, label="not recorded")  # fmt: skip
    if len(panel.curves) > MOST_LINES:
        for rate, curves in groups.items():
            _draw_band(axes, times[rate], curves)
    else:
        for number, curve in enumerate(panel.curves):
            _draw_line(axes, times[curve.rate], curve, number)
    handles, labels = axes.get_legend_handles_labels()
    axes.legend(handles, labels, loc="upper left", bbox_to_anchor=(1.0, 1.02), fontsize="x-small", frameon=False)
    if len(time) > 1:
        axes.set_xlim(time[0], time[-1])


def _time_of(curve: Curve, time: Array) -> Array:
    """The instants of a curve's ticks, s, where those of the picture's ticks are ``time``."""
    if curve.rate == 1.0 or len(time) < 2:
        return time
    period = time[1] - time[0]
    first = own_tick(round(time[0] / period), curve.rate)
    ticks: Array = np.arange(first, first + len(curve.values), dtype=np.float64)
    return ticks * float(period / curve.rate)


def _draw_line(axes: Axes, time: Array, curve: Curve, number: int) -> None:
    colour, style = COLOURS[number % len(COLOURS)], "-" if number < len(COLOURS) else "--"
    shown = thinned(curve.values)
    t, values = time[shown], curve.values[shown]
    axes.plot(t, values, color=colour, linestyle=style, linewidth=0.9, label=label(curve.label))
    dots = alone(values)
    if np.any(dots):
        axes.plot(t[dots], values[dots], ".", color=colour, markersize=3)


def _draw_band(axes: Axes, time: Array, curves: Sequence[Curve]) -> None:
    starts, least, greatest = band(curves)
    axes.fill_between(time[starts], least, greatest, step="post", color=COLOURS[0], alpha=0.35, linewidth=0.8,
                      label=f"all {len(curves)}, from the\nleast to the greatest")  # fmt: skip
    peaks = [(np.nanmax(np.abs(curve.values), initial=0.0), number) for number, curve in enumerate(curves)]
    peak, which = max(peaks, key=lambda found: found[0])
    if peak > 0.0:
        _draw_line(axes, time, Curve(f"{curves[which].label}, the farthest", curves[which].values), 1)


def draw_delays(axes: Axes, delays: Delays) -> None:
    """Draw how often each tau occurred, of each device or of many together, with the certificate's tau and T marked."""
    known = [Curve(curve.label, curve.values[curve.values > 0.0]) for curve in delays.curves]
    every = np.concatenate([curve.values for curve in known]) if known else np.zeros(0)
    axes.set_xlabel("τ [µs], from sampling x to applying f_v")
    axes.set_ylabel("ticks", fontsize="small")
    axes.grid(alpha=0.3, which="both")
    if not len(every):
        axes.set_title("delays inside the tick: none recorded", loc="left", fontsize="small")
        return
    percentiles = "   ".join(f"{name} {np.percentile(every, share):.0f}" for name, share in
                      (("p50", 50.0), ("p99", 99.0), ("p99.9", 99.9), ("greatest", 100.0)))  # fmt: skip
    axes.set_title(f"delays inside the tick, µs:   {percentiles}", loc="left", fontsize="small")
    limits = [limit for limit in (delays.certified, *delays.periods) if limit]
    least, most = min(float(every.min()), *limits) * 0.9, max(float(every.max()), *limits) * 1.1
    edges = np.geomspace(least, most, _BINS + 1)
    shown = known if len(known) <= MOST_LINES else [Curve(f"all {len(known)} devices", every)]
    for number, curve in enumerate(shown):
        counts, _ = np.histogram(curve.values, edges)
        axes.stairs(counts, edges, color=COLOURS[number % len(COLOURS)], linewidth=1.0, label=label(curve.label),
                    linestyle="-" if number < len(COLOURS) else "--")  # fmt: skip
    periods = ((period, "period T", "-") for period in delays.periods)
    for limit, name, style in ((delays.certified, "τ of the certificate", "--"), *periods):
        if limit:
            above = np.count_nonzero(every > limit) / len(every)
            text = f"{name}, {limit:.4g} µs:\n{above:.2%} above"
            axes.axvline(limit, color="black", linestyle=style, linewidth=1.2, label=text)
    if delays.certified == 0.0:
        axes.plot([], [], " ", label="τ of the certificate, 0 µs:\nall above")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlim(least, most)
    axes.set_ylim(bottom=0.7)
    ticks = [tick for tick in (50, 100, 200, 500, 1000, 2000, 5000, 10000, 100000) if least <= tick <= most]
    if len(ticks) > 1:
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.set_xticks([], minor=True)
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.02), fontsize="x-small", frameon=False)


def _draw_marks(axes: Axes, picture: Picture, time: Array, numbers: bool) -> None:
    """A line at each mark, and above it its number in the list; close neighbours share one label."""
    places: list[tuple[float, int, int]] = []
    near = _NEAR * (time[-1] - time[0])
    for number, mark in enumerate(picture.marks, start=1):
        axes.axvline(mark.time, color=_MARK, linewidth=0.7, linestyle="--", zorder=1.5)
        if places and mark.time - places[-1][0] <= near:
            places[-1] = (places[-1][0], places[-1][1], number)
        else:
            places.append((mark.time, number, number))
    for at, first, last in places if numbers else ():
        axes.annotate(str(first) if first == last else f"{first}–{last}", (at, 1.0),
                      xycoords=axes.get_xaxis_transform(), xytext=(1, -1), textcoords="offset points", va="top",
                      fontsize="x-small", color=_MARK)  # fmt: skip


def _mark_lines(marks: Sequence[Mark]) -> list[str]:
    """The list of marks, in lines."""
    lines = []
    for number, mark in enumerate(marks[:MOST_MARKS_LISTED], start=1):
        text = plain(f"{number}   {mark.time:.3f} s   {mark.text}", 2 * _LINE_LENGTH)
        lines += textwrap.wrap(text, _LINE_LENGTH, subsequent_indent="        ")
    if len(marks) > MOST_MARKS_LISTED:
        lines.append(f"and {len(marks) - MOST_MARKS_LISTED} more")
    return lines


def plain(text: str, longest: int) -> str:
    """A text of any origin, made safe for matplotlib: one line, printable, and no mathematics."""
    line = presentable(" ".join(text.split()))
    return (line if len(line) <= longest else line[: longest - 1] + "…").replace("$", r"\$")


def label(text: str) -> str:
    """The same for a legend, which leaves out texts that begin with an underscore."""
    shown = plain(text, _LONGEST_LABEL)
    return f" {shown}" if shown.startswith("_") else shown


def draw(
    file: Path,
    target: Path,
    console: Console,
    quantities: Sequence[str] | None = None,
    start: float | None = None,
    end: float | None = None,
) -> None:
    """Draw the recording in ``file`` into ``target``.

    Args:
        file: of a recording, of one of :data:`.RUN_SUFFIXES`.
        target: .png, .svg or .pdf.
        console: for progress.
        quantities: what to show; None for :data:`SHOWN`.
        start: s since tick 0; None for the beginning.
        end: s since tick 0; None for the end.

    Raises:
        RecordingError: the file is no recording, or holds nothing of what was asked for.
        TargetError: the picture cannot be written there.
    """
    require_format(file, RUN_SUFFIXES)
    require_picture(target)
    with progress_bar(console, f"reading {file.name}") as tell:
        picture = between(_picture(file, quantities, tell), start, end)
    with progress_bar(console, f"drawing {target.name}"):
        save(figure_of(picture), target)


def _picture(file: Path, quantities: Sequence[str] | None, tell: Callable[[float], None]) -> Picture:
    if file.suffix == STREAMED:
        return picture_of_run(read_run(file, tell), quantities)
    return picture_of_recording(read_saved(file, tell), quantities)
