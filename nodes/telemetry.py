"""Figures every node reports, in telemetry and in its last word, under one set of names.

Lengths of time are in microseconds, energies in joules, speeds in m/s; traces are in m and N.
"""

from __future__ import annotations

from collections.abc import Iterable

from manyhands.nodes.exchange import Joint
from manyhands.nodes.ledger import Ledger

LEDGER = "ledger"
LEDGER_MIN = "ledger_min"
SPEED = "speed"
PEAK_SPEED = "peak_speed"
FINAL_SPEED = "final_speed"
LATE = "late"
STALE = "stale"
TAU = "tau_us"
PERIOD = "period_us"
TAU_BREACHES = "tau_breaches"
CLIPPED = "clipped"  # ticks whose force a device clipped: a coupling misbehaves
SATURATED = "saturated"  # ticks whose force a coupling clipped: not those of the certificate
REFUSED = "refused_"  # and why: connections that the process did not admit
NOT_ADMITTED = "not_admitted"  # connections and frames together, for a glance
DISPLACEMENT = "x"
FREE_POSITION = "p"
FORCE = "f_v"


def ledger_figures(ledger: Ledger | None) -> dict[str, float]:
    """The ledger's total and minimum; nothing where nothing was promised."""
    return {} if ledger is None else {LEDGER: ledger.total, LEDGER_MIN: ledger.minimum}


def stray_frames(joints: Iterable[Joint]) -> dict[str, float]:
    """How many frames no gate admitted, whatever the reason."""
    return {NOT_ADMITTED: float(sum(count for joint in joints for count in joint.gate.dropped.values()))}


def dropped_frames(joints: Iterable[Joint]) -> dict[str, int]:
    """Frames that no gate admitted, by reason, over all links."""
    out: dict[str, int] = {}
    for joint in joints:
        for reason, count in joint.gate.dropped.items():
            out[f"dropped_{reason}"] = out.get(f"dropped_{reason}", 0) + count
    return out
