"""The report of a run, as architecture and other programs expect it: one JSON object."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from manyhands.launch.files import replacing
from manyhands.nodes import telemetry as names
from manyhands.nodes.distribution import PERCENTILES
from manyhands.protocol.messages import Report, Role


def node_entry(role: Role, report: Report) -> dict[str, Any]:
    """A node's part of the report; keys that its role does not have, or that it did not tell properly, are absent."""
    figures = {name: value for name, value in report.figures.items() if math.isfinite(value)}  # JSON has no other
    counts = report.counts
    entry: dict[str, Any] = {"role": role.value, "ticks": report.ticks}
    if names.LATE in counts:
        entry["late"] = counts[names.LATE]
    for quantity in (names.TAU, names.PERIOD):
        told = report.percentiles.get(quantity, {})
        percentiles = {name: told[name] for name in PERCENTILES if math.isfinite(told.get(name, math.nan))}
        if percentiles:
            entry[quantity] = percentiles
    if {names.LEDGER, names.LEDGER_MIN} <= figures.keys():
        entry["ledger"] = {"min": figures[names.LEDGER_MIN], "final": figures[names.LEDGER]}
    if {names.PEAK_SPEED, names.FINAL_SPEED} <= figures.keys():
        entry |= {speed: figures[speed] for speed in (names.PEAK_SPEED, names.FINAL_SPEED)}
    if names.TAU_BREACHES in counts:
        entry[names.TAU_BREACHES] = counts[names.TAU_BREACHES]
    for clips in (names.CLIPPED, names.SATURATED):
        if clips in counts:
            entry[clips] = counts[clips]
    refused = {
        key.removeprefix(names.REFUSED): n for key, n in counts.items() if key.startswith(names.REFUSED) and n > 0
    }
    if refused:
        entry["refused"] = refused
    dropped = {key: n for key, n in counts.items() if key.startswith("dropped_") and n > 0}
    if dropped:
        entry["dropped"] = {key.removeprefix("dropped_"): n for key, n in dropped.items()}
    return entry


def run_report(
    session: str,
    certificate: str,
    clock: str,
    duration: float,
    nodes: Mapping[str, Role],
    reports: Mapping[str, Report],
    refused: Mapping[str, int],
) -> dict[str, Any]:
    """The whole report.

    Args:
        session: the session's name.
        certificate: the id it ran under.
        clock: "realtime" or "simulated".
        duration: what was run, in the session's own time, s.
        nodes: every node's role.
        reports: the last words of those that gave one.
        refused: what the supervisor did not admit, by kind; those kinds that occurred.
    """
    return {
        "session": session,
        "certificate": certificate,
        "clock": clock,
        "duration": duration,
        "nodes": {name: node_entry(role, reports[name]) for name, role in nodes.items() if name in reports},
        **({"refused": dict(refused)} if refused else {}),
    }


def save_json(data: Mapping[str, Any], path: Path) -> None:
    """Write one JSON object, whole or not at all.

    Raises:
        OSError: the file cannot be written.
    """
    with replacing(path) as partial:
        partial.write_text(json.dumps(data, indent=2, allow_nan=False) + "\n")
