"""Figures every node reports, in telemetry and in its last word, under one set of names.

Lengths of time are in microseconds, energies in joules, speeds in m/s; traces are in m and N.

Percentiles of a stream of durations, in bounded memory and constant time a value.

A run has no stated end, so values cannot be kept. They are counted in buckets whose widths grow with the
value, one percent each: a percentile is exact to one percent, the maximum exactly.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from manyhands.nodes.environment.energy import Energy
from manyhands.nodes.passivity import Ledger, PassivityController
from manyhands.nodes.peer_link import PeerLink
from manyhands.protocol.channels import DISPLACEMENT, FORCE, FREE_POSITION, LEDGER, MASS_POSITION, TAU, TOOL_POSITION
from manyhands.protocol.messages import Telemetry

__all__ = ["DISPLACEMENT", "FORCE", "FREE_POSITION", "LEDGER", "MASS_POSITION", "TAU", "TOOL_POSITION"]


LEDGER_MIN = "ledger_min"
SPEED = "speed"
PEAK_SPEED = "peak_speed"
FINAL_SPEED = "final_speed"
LATE = "late"
STALE = "stale"
PERIOD = "period_us"
TAU_BREACHES = "tau_breaches"
CLIPPED = "clipped"  # ticks whose force a device clipped: a coupling misbehaves
LET_GO = "let_go"  # times that a device was beyond its displacement or speed, and exerted no force any more
SATURATED = "saturated"  # ticks whose force a coupling clipped: not those of the certificate
REFUSED = "refused_"  # and why: connections that the process did not admit
NOT_ADMITTED = "not_admitted"  # connections and frames together, for a glance
FROZEN = "frozen"  # couplings that are frozen now
FROZEN_TICKS = "frozen_ticks"  # ticks in which any was
ABSENCES = "absences"  # times that a coupling was frozen
JUMPS = "jumps"  # times that a node went on at a later tick than its own
RELEASED = "released"  # periods in which a device exerted no force, for it heard of none
RUNG = "rung"  # of the ladder of couplings
TAU_WORST = "tau_worst_us"  # since the last telemetry
WAITED_IN = "waited:"  # and which coupling: a trace of those of its telemetry's ticks in which the others waited for it
WAITED_TICKS = "waited_ticks_"  # and which coupling: ticks in which the others waited for it alone
WAITED_TIME = "waited_us_"  # and which coupling: what that made the others wait
FROZEN_LATE = "frozen_late_"  # and which coupling: times that it was frozen for it
PERIOD_BREACHES = "period_breaches"  # ticks that came another time after the one before than the certificate assumes
DROPPED_TELEMETRY = "dropped_telemetry"
DROPPED_LOG = "dropped_log"
LATE_CAUSE = "late_"  # and which
REALTIME = "realtime_"  # and which wish: 1 where the machine granted it
LEDGER_MIN_TICK = "ledger_min_tick"  # of the party's own ticks, from 1 on; 0 where it never fell below its beginning
LEDGER_MARGIN = "ledger_margin"  # by how much the least total stayed above the bound, J
GRASPED = "grasped"  # 1 where a person's browser holds the device, else 0
GRASPS = "grasps"  # positions that it was given, of which were
GRASPS_CLIPPED = "grasps_clipped"  # beyond what it is drawn to, and
GRASPS_REFUSED = "grasps_refused"  # besides, what was said there that was no position of this device
GRASPS_LAPSED = "grasps_lapsed"  # times that a hand fell silent without letting go
GIVEN = "given_"  # and which coupling: J that the others have received of its energy
RECEIVED = "received_"  # and which coupling: J that it has received of the others'
MOVED = "moved_"  # supplier, "/" and receiver: J
SCALED = "scaled_"  # and which coupling: ticks in which it was held to less than it did, for its energy budget
STOPS = "stops_"  # and which coupling: times that nothing was left of it
UNOWNED = "unowned"  # J that users received of the environment's own
ENFORCED_TICKS = "enforced_ticks"  # in which a passivity controller kept a force back
ENFORCED_ENERGY = "enforced_energy"  # that was kept back, J


def ledger_figures(ledger: Ledger | None) -> dict[str, float]:
    """The ledger's total, its minimum, where that was, and its margin; nothing where nothing was promised."""
    if ledger is None:
        return {}
    return {
        LEDGER: ledger.total,
        LEDGER_MIN: ledger.minimum,
        LEDGER_MIN_TICK: float(ledger.at),
        LEDGER_MARGIN: ledger.margin,
    }


def ledger_trace(ledger: Ledger | None, totals: Sequence[float]) -> dict[str, NDArray[np.float64]]:
    """The ledger's totals of so many ticks, J, as a trace of one column; nothing where nothing was promised."""
    return {} if ledger is None else {LEDGER: np.array(totals)[:, None]}


def enforcement_figures(controller: PassivityController | None) -> dict[str, float]:
    """How often a controller acted, and what it kept back; nothing where nothing is enforced."""
    if controller is None:
        return {}
    return {ENFORCED_TICKS: float(controller.ticks), ENFORCED_ENERGY: controller.energy}


@dataclass(frozen=True)
class CouplingLateness:
    """What a coupling made the others wait.

    Attributes:
        ticks: in which it came after the others, or not at all.
        time: that it cost the others, us.
        frozen: times that it was frozen for it.
    """

    ticks: int
    time: float
    frozen: int

    def sentence(self, name: str) -> str:
        """The same for a person; ``name``: the coupling's."""
        return (
            f"the others waited for {name} in {self.ticks} ticks, {self.time / 1e6:.3g} s in all, and it was frozen "
            f"for that {self.frozen} times"
        )


def lateness_counts(lateness: Mapping[str, CouplingLateness]) -> dict[str, int]:
    """Late ticks by coupling, and how often it was frozen for them."""
    ticks = {f"{WAITED_TICKS}{name}": one.ticks for name, one in lateness.items()}
    return ticks | {f"{FROZEN_LATE}{name}": one.frozen for name, one in lateness.items()}


def lateness_times(lateness: Mapping[str, CouplingLateness]) -> dict[str, float]:
    """What each made the others wait, us."""
    return {f"{WAITED_TIME}{name}": one.time for name, one in lateness.items()}


def lateness_of(name: str, counts: Mapping[str, float], figures: Mapping[str, float]) -> CouplingLateness | None:
    """What the environment told of the coupling ``name``; None if nothing, or nothing of sense."""
    told = (counts.get(WAITED_TICKS + name), figures.get(WAITED_TIME + name), counts.get(FROZEN_LATE + name, 0.0))
    ticks, time, frozen = (math.nan if value is None else value for value in told)
    if not (0.0 < ticks < math.inf and 0.0 <= time < math.inf and 0.0 <= frozen < math.inf):
        return None
    return CouplingLateness(int(ticks), time, int(frozen))


def energy_figures(energy: Energy, parties: Sequence[str]) -> dict[str, float]:
    """Who moved whom, and who was held to a budget; of what has not happened nothing is said."""
    figures = {UNOWNED: energy.unowned}
    for name, values in (
        (GIVEN, energy.given),
        (RECEIVED, energy.received),
        (SCALED, energy.scaled),
        (STOPS, energy.stops),
    ):
        figures |= {f"{name}{party}": float(value) for party, value in zip(parties, values, strict=True)}
    for supplier, row in zip(parties, energy.moved, strict=False):
        figures |= {f"{MOVED}{supplier}/{to}": value for to, value in zip(parties, row, strict=True)}
    return {name: value for name, value in figures.items() if value != 0.0}


def lateness_by_coupling(counts: Mapping[str, float], figures: Mapping[str, float]) -> dict[str, CouplingLateness]:
    """What the environment told of all couplings that made the others wait."""
    told = {
        key.removeprefix(WAITED_TICKS): lateness_of(key.removeprefix(WAITED_TICKS), counts, figures)
        for key in counts
        if key.startswith(WAITED_TICKS)
    }
    return {name: lateness for name, lateness in told.items() if lateness is not None}


def shown(telemetry: Telemetry) -> Telemetry:
    """What others than the supervisor are shown of a telemetry: without the ticks in which couplings were late."""
    if not any(name.startswith(WAITED_IN) for name in telemetry.traces):
        return telemetry
    traces = {name: trace for name, trace in telemetry.traces.items() if not name.startswith(WAITED_IN)}
    return Telemetry(telemetry.tick, telemetry.figures, traces)


def stray_frames(peer_links: Iterable[PeerLink]) -> dict[str, float]:
    """How many frames no gate admitted, whatever the reason."""
    return {NOT_ADMITTED: float(sum(count for peer_link in peer_links for count in peer_link.gate.dropped.values()))}


def dropped_frames(peer_links: Iterable[PeerLink]) -> dict[str, int]:
    """Frames that no gate admitted, by reason, over all links."""
    out: dict[str, int] = {}
    for peer_link in peer_links:
        for reason, count in peer_link.gate.dropped.items():
            out[f"dropped_{reason}"] = out.get(f"dropped_{reason}", 0) + count
    return out


_SMALLEST = 0.1  # us; anything below counts as zero
_GROWTH = 0.01
_BUCKETS = 2 + int(math.log(1e10) / math.log1p(_GROWTH))  # up to 1e9 us, a quarter of an hour
_PER_LOG = 1.0 / math.log1p(_GROWTH)
_BLOCK = 64  # buckets that are counted together as well, so that a percentile is found in a hundred steps, not 2,000

PERCENTILES = ("p50", "p99", "p999", "max")
"""What is told of a distribution."""


class Distribution:
    """Counts durations, us."""

    def __init__(self) -> None:
        self._counts = [0] * _BUCKETS  # a list: to count one there costs a loop a tenth of numpy's, cold
        self._blocks = [0] * (1 + _BUCKETS // _BLOCK)
        self._maximum = 0.0

    def add(self, microseconds: float) -> None:
        """Count one duration, us; negative ones count as zero."""
        if microseconds > self._maximum:
            self._maximum = microseconds
        bucket = 0
        if microseconds >= _SMALLEST:
            bucket = min(1 + int(math.log(microseconds / _SMALLEST) * _PER_LOG), _BUCKETS - 1)
        self._counts[bucket] += 1
        self._blocks[bucket // _BLOCK] += 1

    def quantile(self, fraction: float) -> float:
        """The duration (us) that ``fraction`` of all do not exceed; 0 when there are none."""
        total = sum(self._blocks)
        if total == 0:
            return 0.0
        block, counted = _reach(self._blocks, 0, 0, fraction * total)
        bucket, _ = _reach(self._counts, block * _BLOCK, counted, fraction * total)
        return 0.0 if bucket == 0 else min(_SMALLEST * math.exp(bucket / _PER_LOG), self._maximum)

    def percentiles(self) -> dict[str, float]:
        """p50, p99, p999 and max, us."""
        values = (self.quantile(0.5), self.quantile(0.99), self.quantile(0.999), self._maximum)
        return dict(zip(PERCENTILES, values, strict=True))


def _reach(counts: list[int], first: int, counted: int, target: float) -> tuple[int, int]:
    """Where, from ``first`` on, a sum that begins at ``counted`` reaches ``target``; and what it was before."""
    at = first
    while counted + counts[at] < target:
        counted += counts[at]
        at += 1
    return at, counted
