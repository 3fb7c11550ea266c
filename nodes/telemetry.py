"""Figures every node reports, in telemetry and in its last word, under one set of names.

Lengths of time are in microseconds, energies in joules, speeds in m/s.
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
DISPLACEMENT = "x"
FORCE = "f_v"


def ledger_figures(ledger: Ledger | None) -> dict[str, float]:
    """The ledger's total and minimum; nothing where nothing was promised."""
    return {} if ledger is None else {LEDGER: ledger.total, LEDGER_MIN: ledger.minimum}


def dropped_frames(joints: Iterable[Joint]) -> dict[str, int]:
    """Frames that no gate admitted, by reason, over all links."""
    out: dict[str, int] = {}
    for joint in joints:
        for reason, count in joint.gate.dropped.items():
            out[f"dropped_{reason}"] = out.get(f"dropped_{reason}", 0) + count
    return out
