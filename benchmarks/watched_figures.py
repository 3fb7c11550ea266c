"""The onlookers in the comparison of watched.py, the measurements of the loop, and their table."""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from loop_runs import Run, share_late
from numpy.typing import NDArray

WATCHED = "watched"
"""The mark of the table on the page."""

RECORDER, TOP, PAGE = "recorder", "top", "page"


@dataclass(frozen=True)
class Variant:
    """A way to be looked on at.

    Attributes:
        label: in the table.
        onlookers: their names.
        stopped: whether they are stopped where they stand (SIGSTOP) before the measurement begins.
    """

    label: str
    onlookers: tuple[str, ...] = ()
    stopped: bool = False


ALONE = "alone"
VARIANTS: Mapping[str, Variant] = {
    ALONE: Variant("nobody"),
    RECORDER: Variant("the recorder (`launch --record`)", (RECORDER,)),
    TOP: Variant("`top` on a terminal", (TOP,)),
    PAGE: Variant("`view`, its page in Chromium", (PAGE,)),
    "all": Variant("all three", (RECORDER, TOP, PAGE)),
    "stopped": Variant("all three, stopped (SIGSTOP)", (RECORDER, TOP, PAGE), stopped=True),
}


class Window:
    """The delays of some ticks of the devices, put together from what their telemetry shows."""

    def __init__(self, devices: Iterable[str], first: int, ticks: int) -> None:
        """The ticks ``first`` ... ``first + ticks`` - 1 of ``devices``."""
        self._first, self._ticks = first, ticks
        self._tau: dict[str, list[NDArray[np.float64]]] = {device: [] for device in devices}
        self._next = dict.fromkeys(self._tau, first)

    def take(self, device: str, tick: int, tau_us: NDArray[np.float64]) -> None:
        """Take the delays (us) of the ticks before ``tick``, one each; other nodes than the devices are passed over."""
        if device not in self._tau:
            return
        begins = tick - len(tau_us)
        wanted = tau_us[max(0, self._next[device] - begins) : max(0, self._first + self._ticks - begins)]
        self._tau[device].append(wanted[np.isfinite(wanted)])
        self._next[device] = max(self._next[device], tick)

    @property
    def over(self) -> bool:
        """Whether every device has sent telemetry of its last tick."""
        return min(self._next.values()) >= self._first + self._ticks

    def run(self, period_us: float, processes: int, cpu: float, resident: float) -> Run:
        """The result: a tick without telemetry was not done, and counts as late.

        Args:
            period_us: T, us.
            processes: of the session.
            cpu: processors that they used.
            resident: their memory, MiB.

        Raises:
            ValueError: a device sent telemetry of no tick.
        """
        tau = {device: np.concatenate([np.zeros(0), *parts]) for device, parts in self._tau.items()}
        if silent := [device for device, values in tau.items() if not len(values)]:
            raise ValueError(f"{', '.join(silent)} told of no tick; expected {self._ticks}")
        return Run(
            {
                device: {
                    **{name: float(np.percentile(values, share)) for name, share in _PERCENTILES.items()},
                    "max": float(values.max()),
                }
                for device, values in tau.items()
            },
            min(len(values) for values in tau.values()),
            share_late(self._ticks, [(len(values), int(np.sum(values > period_us))) for values in tau.values()]),
            processes,
            cpu,
            resident,
        )


_PERCENTILES = {"p50": 50.0, "p99": 99.0, "p999": 99.9}


def table(content: Mapping[str, Any]) -> str:
    """Medians over the rounds, and ratios to the run without onlookers within a round, with their range."""
    rounds: Sequence[Mapping[str, Any]] = content["runs"]
    runs = {name: [Run(**of[name]["run"]) for of in rounds] for name in VARIANTS if all(name in of for of in rounds)}
    told = ", ".join(f"{name} {value}" for name, value in content["machine"].items())
    lines = [
        f"{content['rounds']} rounds of {content['seconds']:g} s each; {told}.",
        "",
        "| looking on | median of tau, us | p99 | p99.9 | late | median against nobody (range) "
        "| p99 against nobody (range) | processors: the session | who looks on |",
        "|---|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    middle = statistics.median
    for name, of in runs.items():
        onlookers = [one[name]["onlookers"] for one in rounds]
        lines.append(
            f"| {VARIANTS[name].label} | {middle(one.median for one in of):.0f} "
            f"| {middle(one.worst('p99') for one in of):.0f} | {middle(one.worst('p999') for one in of):.0f} "
            f"| {middle(one.late for one in of):.2%} "
            f"| {_spread([one.median / alone.median for one, alone in zip(of, runs[ALONE], strict=True)])} "
            f"| {_spread([one.worst('p99') / alone.worst('p99') for one, alone in zip(of, runs[ALONE], strict=True)])} "
            f"| {middle(one.cpu for one in of):.2f} | {middle(onlookers):.2f} |"
        )
    return "\n".join(lines)


def _spread(ratios: Sequence[float]) -> str:
    return f"{statistics.median(ratios):.2f} ({min(ratios):.2f}-{max(ratios):.2f})"
