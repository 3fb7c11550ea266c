"""The tables and the picture of the runs of the chain, made of the same data as the JSON file."""

from __future__ import annotations

import statistics
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from loop_middleware import BARE, MIDDLEWARES
from loop_ours import VARIANTS
from loop_runs import Run

TABLE, SOAK = "loop", "soak"
"""The marks of the tables on the page."""

TARGETS = {"ratio": 1.3, "colocated": 1.0, "p999": 800.0, "late": 0.001}
"""Ours on an otherwise idle two-core machine: median against bare pyzmq's, the same with co-located couplings, p99.9 of
tau (us), share of late ticks."""

_LABELS = {name: one.label for name, one in (*VARIANTS.items(), *MIDDLEWARES.items())}
_COLOURS = {**dict.fromkeys(VARIANTS, "#D55E00"), BARE: "#0072B2"}  # Okabe and Ito's
_OTHERS = "0.45"
_WARMING = 0.1  # of a long run, in which what grows is not yet a leak


def _runs(content: Mapping[str, Any]) -> dict[str, list[Run]]:
    """The runs of each, in the order of the rounds; those that have run in every round."""
    found: dict[str, list[Run]] = {}
    for of in content["runs"]:
        for name in of:
            found.setdefault(name, []).append(Run(**of[name]))
    order = [name for name in _LABELS if len(found.get(name, ())) == len(content["runs"])]
    return {name: found[name] for name in sorted(order, key=lambda name: statistics.median(_ratios(found, name)))}


def _ratios(runs: Mapping[str, list[Run]], name: str) -> list[float]:
    """The median tau against bare pyzmq's in the same round."""
    return [one.median / bare.median for one, bare in zip(runs[name], runs[BARE], strict=True)]


def table(content: Mapping[str, Any]) -> str:
    """Medians over the rounds, ratios within a round and their range, and whether the targets are met."""
    runs = _runs(content)
    lines = [
        f"{content['rounds']} rounds of {content['seconds']:g} s each; {_told(content['machine'])}. "
        f"Granted to our nodes and so to the others': {_granted(content['treatment'])}.",
        "",
        "| carried by | median of tau, us | p99 | p99.9 | late | against bare pyzmq (range) "
        "| processes | processors used | memory, MiB |",
        "|---|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for name, of in runs.items():
        ratios = _ratios(runs, name)
        middle = statistics.median
        label = f"**{_LABELS[name]}**" if name in VARIANTS else _LABELS[name]
        lines.append(
            f"| {label} | {middle(one.median for one in of):.0f} | {middle(one.worst('p99') for one in of):.0f} "
            f"| {middle(one.worst('p999') for one in of):.0f} | {middle(one.late for one in of):.2%} "
            f"| {middle(ratios):.2f} ({min(ratios):.2f}-{max(ratios):.2f}) | {of[-1].processes} "
            f"| {middle(one.cpu for one in of):.2f} | {middle(one.resident for one in of):.0f} |"
        )
    lines += ["", "Targets on an otherwise idle two-core machine:", ""]
    lines += [f"- {_verdict(runs, name)}" for name in VARIANTS if name in runs]
    versions = sorted({one.told for of in runs.values() for one in of if one.told})
    lines += ["", f"Versions: {'; '.join(versions)}."]
    lines += [f"\n{_LABELS[name]} did not run: {reason}" for name, reason in content["failed"].items()]
    return "\n".join(lines)


def _verdict(runs: Mapping[str, list[Run]], name: str) -> str:
    """Whether one variant of ours meets the targets, in one sentence."""
    kind = "colocated" if VARIANTS[name].colocated else "ratio"
    ratio = statistics.median(_ratios(runs, name))
    p999 = statistics.median(one.worst("p999") for one in runs[name])
    late = statistics.median(one.late for one in runs[name])
    words = {True: "met", False: "missed"}
    return (
        f"{VARIANTS[name].label}: median at most {TARGETS[kind]:g} x bare pyzmq: "
        f"{words[ratio <= TARGETS[kind]]} ({ratio:.2f}); p99.9 at most {TARGETS['p999']:g} us: "
        f"{words[p999 <= TARGETS['p999']]} ({p999:.0f}); late at most {TARGETS['late']:.1%}: "
        f"{words[late <= TARGETS['late']]} ({late:.2%})."
    )


def _told(machine: Mapping[str, str]) -> str:
    return ", ".join(f"{name} {value}" for name, value in machine.items())


def _granted(treatment: Mapping[str, str]) -> str:
    nodes: dict[str, list[str]] = {}
    for node, granted in treatment.items():
        nodes.setdefault(granted, []).append(node)
    return "; ".join(f"{', '.join(sorted(names))}: {granted}" for granted, names in nodes.items())


def slope(seconds: list[float], mebibytes: list[float]) -> float:
    """How fast memory grows, KiB a minute, by least squares over what is left after warming up."""
    first = int(_WARMING * len(seconds))
    if len(seconds) - first < 2:
        return 0.0
    return statistics.linear_regression(seconds[first:], mebibytes[first:]).slope * 1024.0 * 60.0


def soak_table(content: Mapping[str, Any]) -> str:
    """Every process's memory at start and end, and how fast it grows."""
    seconds = content["seconds"]
    lines = [
        f"{seconds[-1]:.0f} s, {content['run']['ticks']} ticks; {_told(content['machine'])}. Growth is that of a line "
        f"through what follows the first {_WARMING:.0%}.",
        "",
        "| process | MiB at the start | after warming up | at the end | growth, KiB a minute |",
        "|---|---:|---:|---:|---:|",
    ]
    for name, of in content["resident"].items():
        warm = of[int(_WARMING * len(of))]
        lines.append(f"| {name} | {of[0]:.1f} | {warm:.1f} | {of[-1]:.1f} | {slope(seconds, of):.1f} |")
    return "\n".join(lines)


def plot(content: Mapping[str, Any], path: Path) -> None:
    """For each, from the median to p99.9 of tau: every round a thin line, the median of the rounds a thick one."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    runs = _runs(content)
    figure, axes = plt.subplots(figsize=(8.0, 0.6 * len(runs) + 1.4), layout="constrained")
    for row, (name, of) in enumerate(runs.items()):
        colour = _COLOURS.get(name, _OTHERS)
        rounds = [(one.median, one.worst("p99"), one.worst("p999")) for one in of]
        for number, points in enumerate(rounds):
            height = row + 0.3 * ((number + 0.5) / len(rounds) - 0.5)
            axes.plot([points[0], points[2]], [height] * 2, color=colour, linewidth=0.6, alpha=0.5)
        middle = [statistics.median(column) for column in zip(*rounds, strict=True)]
        axes.plot([middle[0], middle[2]], [row, row], color=colour, linewidth=2.0)
        for value, marker in zip(middle, "o|>", strict=True):
            axes.plot(value, row, color=colour, marker=marker, markersize=9, markeredgewidth=2.0, linestyle="")
        axes.annotate(
            f"{middle[0]:.0f}", (middle[0], row), xytext=(0, 8), textcoords="offset points", ha="center", fontsize=8
        )
    axes.axvline(TARGETS["p999"], color="0.3", linestyle=":", linewidth=1.0)
    axes.axvline(content["period_us"], color="0.3", linestyle="--", linewidth=1.0)
    axes.set_yticks(range(len(runs)), [_LABELS[name] for name in runs])
    axes.invert_yaxis()
    axes.set(xscale="log", xlabel="tau, us: median (dot), p99 (bar), p99.9 (arrow); dotted: 0.8 ms, dashed: the period")
    axes.set_xticks([200, 300, 500, 1000, 2000, 5000], ["200", "300", "500", "1000", "2000", "5000"])
    axes.minorticks_off()
    axes.grid(True, axis="x", alpha=0.25)
    figure.savefig(path, dpi=130)
    plt.close(figure)
