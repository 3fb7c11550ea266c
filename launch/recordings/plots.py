"""Pictures of recordings: panels over one time axis, the delays as a histogram, what happened as numbered marks.

Matplotlib is used without a screen and without its global state; SVG keeps its text as text. Texts come from files
of anywhere: none of them is read as mathematics, and none is longer than a line.
"""

from __future__ import annotations

import textwrap
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from manyhands.design.files import replacing
from manyhands.launch.files import TargetError, require_target
from manyhands.launch.recordings.curves import Array, Curve, Panel, alone, band, gaps, thinned
from manyhands.launch.recordings.pictures import Delays, Mark, Picture
from manyhands.protocol.messages import presentable

FORMATS: Final = ("png", "svg")
MOST_LINES = 12
"""More curves than these in a panel are shown as the band that they fill."""

MOST_MARKS_LISTED = 30

_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")  # Okabe and Ito's
_GAP, _MARK, _BAD = "0.85", "0.35", "#B00020"
_DPI = 130
_WIDTH = 10.0  # inches
_PANEL, _HISTOGRAM, _LINE, _HEAD = 2.1, 2.6, 0.16, 0.7  # heights, inches
_LONGEST_LABEL, _LINE_LENGTH = 24, 150  # characters
_BINS = 120
_NEAR = 0.045  # of the width: marks nearer than this share a number's place


def require_picture(path: Path) -> None:
    """Refuse a name that no picture can be written to; before the work, not after it.

    Raises:
        TargetError: no such folder, or another suffix than those of :data:`FORMATS`.
    """
    require_target(path)
    if path.suffix.removeprefix(".") not in FORMATS:
        expected = " or ".join(f".{one}" for one in FORMATS)
        raise TargetError(f"{path}: found the suffix {path.suffix!r}; expected {expected}")


def write_picture(picture: Picture, path: Path) -> None:
    """Draw ``picture`` into a file of the format of its suffix, whole or not at all.

    Raises:
        TargetError: not a name of a picture, or no folder to put it in.
    """
    require_picture(path)
    save(figure_of(picture), path)


def save(figure: Figure, path: Path) -> None:
    """Write a figure whole or not at all, the same bytes for the same figure."""
    with (
        rc_context({"svg.fonttype": "none", "svg.hashsalt": "manyhands"}),
        warnings.catch_warnings(),
        replacing(path) as file,
    ):
        warnings.filterwarnings("ignore", r"Glyph \d+ .* missing from", UserWarning)  # a box stands for it
        metadata = {"Date": None} if path.suffix == ".svg" else None
        figure.savefig(file, format=path.suffix[1:], dpi=_DPI, metadata=metadata)


def figure_of(picture: Picture) -> Figure:
    """The figure; its axes are the panels in order, then, where there are any, the histogram and what happened."""
    told = _told(picture.marks)
    heights = [_PANEL] * len(picture.panels)
    heights += [_HISTOGRAM] if picture.delays is not None else []
    heights += [_LINE * (len(told) + 1)] if told else []
    figure = Figure(figsize=(_WIDTH, sum(heights) + _HEAD), layout="constrained", facecolor="white")
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
    if told:
        axes = figure.add_subplot(grid[len(heights) - 1])
        axes.axis("off")
        axes.text(0.0, 1.0, "\n".join(told), va="top", fontsize="x-small", transform=axes.transAxes)
    if picture.cut is not None:
        text = f"This recording is cut: {picture.cut}"
        figure.supxlabel(
            "\n".join(textwrap.wrap(plain(text, 3 * _LINE_LENGTH), _LINE_LENGTH - 30)),
            x=0.01, ha="left", fontsize="small", color=_BAD,
        )  # fmt: skip
    return figure


def draw_panel(axes: Axes, time: Array, panel: Panel) -> None:
    """Draw curves against ``time`` (s): lines of few, the band between the extremes of many.

    Nothing is skipped where ticks are more than pixels: see :mod:`manyhands.launch.recordings.curves`.
    """
    axes.set_title(panel.title, loc="left", fontsize="small")
    axes.set_xlabel("time [s]")
    axes.set_ylabel(panel.axis, fontsize="small")
    axes.grid(alpha=0.3)
    axes.margins(x=0.0)
    if panel.zero:
        axes.axhline(0.0, color=_BAD, linewidth=0.8, linestyle=":")
    missing = gaps(panel.curves)
    period = time[1] - time[0] if len(time) > 1 else 0.0
    if missing:
        spans = [(time[first], (beyond - first) * period) for first, beyond in missing]
        axes.broken_barh(spans, (0.0, 1.0), transform=axes.get_xaxis_transform(), facecolor=_GAP,
                         edgecolor=_GAP, linewidth=0.5, zorder=0.5, label="not recorded")  # fmt: skip
    if len(panel.curves) > MOST_LINES:
        _draw_band(axes, time, panel.curves)
    else:
        for number, curve in enumerate(panel.curves):
            _draw_line(axes, time, curve, number)
    handles, labels = axes.get_legend_handles_labels()
    axes.legend(handles, labels, loc="upper left", bbox_to_anchor=(1.0, 1.02), fontsize="x-small", frameon=False)
    if len(time) > 1:
        axes.set_xlim(time[0], time[-1])


def _draw_line(axes: Axes, time: Array, curve: Curve, number: int) -> None:
    colour, style = _COLOURS[number % len(_COLOURS)], "-" if number < len(_COLOURS) else "--"
    shown = thinned(curve.values)
    t, values = time[shown], curve.values[shown]
    axes.plot(t, values, color=colour, linestyle=style, linewidth=0.9, label=label(curve.label))
    dots = alone(values)
    if np.any(dots):
        axes.plot(t[dots], values[dots], ".", color=colour, markersize=3)


def _draw_band(axes: Axes, time: Array, curves: Sequence[Curve]) -> None:
    starts, least, greatest = band(curves)
    axes.fill_between(time[starts], least, greatest, step="post", color=_COLOURS[0], alpha=0.35, linewidth=0.8,
                      label=f"all {len(curves)}, from the\nleast to the greatest")  # fmt: skip
    peaks = [(np.nanmax(np.abs(curve.values), initial=0.0), number) for number, curve in enumerate(curves)]
    peak, which = max(peaks, key=lambda found: found[0])
    if peak > 0.0:
        _draw_line(axes, time, Curve(f"{curves[which].label}, the farthest", curves[which].values), 1)


def draw_delays(axes: Axes, delays: Delays) -> None:
    """Draw how often each tau was, of each device or of many together, with the certificate's tau and T marked."""
    known = [Curve(curve.label, curve.values[curve.values > 0.0]) for curve in delays.curves]
    every = np.concatenate([curve.values for curve in known]) if known else np.zeros(0)
    axes.set_xlabel("τ [µs], from sampling x to applying f_v")
    axes.set_ylabel("ticks", fontsize="small")
    axes.grid(alpha=0.3, which="both")
    if not len(every):
        axes.set_title("delays inside the tick: none recorded", loc="left", fontsize="small")
        return
    told = "   ".join(f"{name} {np.percentile(every, share):.0f}" for name, share in
                      (("p50", 50.0), ("p99", 99.0), ("p99.9", 99.9), ("greatest", 100.0)))  # fmt: skip
    axes.set_title(f"delays inside the tick, µs:   {told}", loc="left", fontsize="small")
    limits = [limit for limit in (delays.certified, delays.period) if limit]
    least, most = min(float(every.min()), *limits) * 0.9, max(float(every.max()), *limits) * 1.1
    edges = np.geomspace(least, most, _BINS + 1)
    shown = known if len(known) <= MOST_LINES else [Curve(f"all {len(known)} devices", every)]
    for number, curve in enumerate(shown):
        counts, _ = np.histogram(curve.values, edges)
        axes.stairs(counts, edges, color=_COLOURS[number % len(_COLOURS)], linewidth=1.0, label=label(curve.label),
                    linestyle="-" if number < len(_COLOURS) else "--")  # fmt: skip
    for limit, name, style in ((delays.certified, "τ of the certificate", "--"), (delays.period, "period T", "-")):
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
    """A line where something happened, and above it its number in the list; neighbours share a place."""
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


def _told(marks: Sequence[Mark]) -> list[str]:
    """The list of what happened, in lines."""
    lines = []
    for number, mark in enumerate(marks[:MOST_MARKS_LISTED], start=1):
        text = plain(f"{number}   {mark.time:.3f} s   {mark.text}", 2 * _LINE_LENGTH)
        lines += textwrap.wrap(text, _LINE_LENGTH, subsequent_indent="        ")
    if len(marks) > MOST_MARKS_LISTED:
        lines.append(f"and {len(marks) - MOST_MARKS_LISTED} more")
    return lines


def plain(text: str, longest: int) -> str:
    """A text of anywhere as matplotlib shows it as it is: in one line, printable, and no mathematics."""
    line = presentable(" ".join(text.split()))
    return (line if len(line) <= longest else line[: longest - 1] + "…").replace("$", r"\$")


def label(text: str) -> str:
    """The same for a legend, which leaves out what begins with an underscore."""
    shown = plain(text, _LONGEST_LABEL)
    return f" {shown}" if shown.startswith("_") else shown
