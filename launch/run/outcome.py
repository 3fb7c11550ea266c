"""The progress and the outcome of a run, and its report.

The report is one JSON object for people and other programs; docs/files.md lists its keys.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from manyhands.design.files import replacing
from manyhands.design.models.axis import AxisKind, Units
from manyhands.design.models.brief import brief_repr
from manyhands.launch.plan.prepare import Prepared
from manyhands.launch.recordings.recording import Recording
from manyhands.launch.run.states import Incidents, SessionPhase
from manyhands.launch.session import Session
from manyhands.launch.session.session import ENVIRONMENT
from manyhands.nodes.kernel.words import counted
from manyhands.nodes.monitor.given import GivenForce, percent
from manyhands.nodes.monitor.health import MOST_ROWS, PromiseState, condensed, missed, verdict
from manyhands.nodes.rows import figures as names
from manyhands.nodes.rows.figures import Figure, Unit
from manyhands.nodes.rows.lateness import lateness_by_coupling
from manyhands.nodes.rows.promises import Promise
from manyhands.nodes.wave_link.felt import FeltLink, felt_link
from manyhands.protocol.limits import MAX_COUNT
from manyhands.protocol.messages import Figures, PromiseStatus, Report, Role, Telemetry
from manyhands.protocol.plain import read, written


@dataclass(frozen=True)
class Progress:
    """The state of a run, for a display.

    Attributes:
        phase: of the session.
        states: of each node.
        pids: process ids of the nodes that run.
        telemetry: the latest telemetry of each node.
        elapsed: since the first tick, s.
        notices: assumptions found broken, one sentence for each.
        refused: what the supervisor did not admit, by kind: attempts of strangers, and messages of members out of turn.
        silent: nodes that run, but have sent no telemetry for a while.
        incidents: the latest faults that the session survived.
        faults: what went wrong.
        promises: how each promise of the session stands.
        by_itself: by device, what it does by itself, as its driver states.
        visits: who has lately taken a seat, or left one as its user wanted.
    """

    phase: SessionPhase
    states: Mapping[str, str]
    pids: Mapping[str, int]
    telemetry: Mapping[str, Telemetry]
    elapsed: float
    notices: tuple[str, ...]
    refused: Mapping[str, int]
    silent: frozenset[str] = frozenset()
    incidents: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()
    promises: tuple[PromiseStatus, ...] = ()
    by_itself: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    visits: tuple[str, ...] = ()

    __repr__ = brief_repr

    @property
    def behind(self) -> dict[str, float]:
        """By device in wall time, how far its tool lags behind it, m (rad on an axis that turns), because of lateness.

        What lags is a part of every wall that is missing: a coupling of K (N/m) presses by K times the lag less. The
        force that was asked for, of which :attr:`without_force` judges, does not know of that.
        """
        found = ((name, told.figures.get(names.INTERFACE_BEHIND)) for name, told in self.telemetry.items())
        return {name: behind for name, behind in found if behind is not None}

    @property
    def without_force(self) -> tuple[str, ...]:
        """The devices that have been given too little of the force asked in the last seconds: their walls are gone.

        What counts as too little, and over which time, has :mod:`manyhands.nodes.monitor.given`. A tool that lags
        behind asks for less: that is told by :attr:`behind`.
        """
        lasting = [row for row in self.promises if row.promise == Promise.GIVEN and row.until is None]
        return tuple(sorted({name for row in lasting if row.state == PromiseState.BROKEN for name in row.who}))


@dataclass(frozen=True)
class Outcome:
    """How a run went.

    Attributes:
        code: exit code: 0, 1 a process failed or the recording stopped, 130 on Ctrl-C (143 on SIGTERM, 129 on SIGHUP,
            131 on SIGQUIT). A process that failed and came back, or was on its way back at the end, is an incident and
            no failure of the run.
        faults: what went wrong, empty for a good run.
        notices: assumptions of the certificate that the run broke.
        report: the report's object.
        recording: every x and f_v, if it was asked for and any were received.
        lost: number of ticks missing from the recording, by device.
        refused: what the supervisor did not admit, by kind: attempts of strangers, and messages of members out of turn.
        incidents: the latest faults that the session survived.
    """

    code: int
    faults: tuple[str, ...]
    notices: tuple[str, ...]
    report: Mapping[str, Any]
    recording: Recording | None
    lost: Mapping[str, int]
    refused: Mapping[str, int]
    incidents: tuple[str, ...] = ()

    __repr__ = brief_repr


def node_entry(role: Role, report: Report, restarts: int = 0) -> dict[str, Any]:
    """A node's part of the report, by the declarations of :data:`~manyhands.nodes.rows.figures.FIGURES`.

    Keys that its role does not have are absent, and so are values that make no sense.

    Args:
        role: the node's.
        report: its final report; of a node that came back, with the figures of all its processes.
        restarts: how often it came back.
    """
    figures = report.figures.finite()  # JSON has no NaN
    entry: dict[str, Any] = {"role": role.value, "ticks": report.ticks, **reported(figures)}
    if (given := GivenForce.of(figures)) is not None:
        entry["given"] = given.as_plain()
    if late := lateness_by_coupling(figures):
        entry["late_couplings"] = {name: one.as_plain() for name, one in late.items()}
    if restarts:
        entry.setdefault("incidents", {})["restarts"] = restarts
    return entry


def reported(figures: Figures) -> dict[str, Any]:
    """What of these figures is in a report, at the keys that their declarations state."""
    out: dict[str, Any] = {}
    lacking = set()
    for figure in names.FIGURES.values():
        if (at := figure.report) is None:
            continue
        value = _told(figure, figures)
        group = at.path[0]
        if value is None or (at.positive and not value):
            lacking |= {group} if at.needed else set()
        elif len(at.path) == 1:
            out[group] = value
        else:
            out.setdefault(group, {})[at.path[1]] = value
    return {key: value for key, value in out.items() if key not in lacking}


def _told(figure: Figure, figures: Figures) -> Any:
    """The number or the table of a figure as the report has it; None where there is none, or it makes no sense."""
    scale = 1.0 if figure.report is None else figure.report.scale
    if figure.key is None:
        return _reported(scale * figures[figure.name], figure.unit) if figure.name in figures else None
    found = {key: _reported(scale * value, figure.unit) for key, value in figures.table(figure.name).items()}
    positive = figure.report is not None and figure.report.positive
    return {key: value for key, value in found.items() if value or not positive} or None


def _reported(value: float, unit: Unit) -> float | int | bool | None:
    """A number as the report has it: counts are whole; a node may send any number."""
    if unit is Unit.STATE:
        return value > 0.0
    if unit is Unit.TICK:
        return int(value) if 0.0 <= value <= MAX_COUNT else None
    return int(min(max(value, 0.0), MAX_COUNT)) if unit.whole else value


def enforcement_sentence(figures: Mapping[str, float]) -> str:
    """What a passivity controller kept back; empty where there is none, or where it never acted."""
    ticks = figures.get(names.ENFORCED_TICKS, 0.0)
    if not ticks:
        return ""
    kept = joules(figures[names.ENFORCED_ENERGY])
    return f"the controller kept back {kept} of the environment's energy in {counted(ticks, 'tick')}"


def lateness_entry(prepared: Prepared, clock: str) -> dict[str, Any] | None:
    """What a session promises about lateness, for its report; None where no device can be late, or nothing is proved.

    Args:
        prepared: the session with its certificate.
        clock: "realtime" or "simulated".
    """
    session = prepared.session
    late = any(session.in_wall_time(name, clock) for name in session.devices)
    if not prepared.certified or not late:
        return None
    return {
        "tau": min(certificate.tau for certificate in prepared.certificates),
        "period_tolerance": min(certificate.period_tolerance for certificate in prepared.certificates),
        "enforced": session.faults.enforced_tank is not None,
        "tank": session.faults.tank.energy,
        "power": session.faults.tank.power,
    }


_LEAST_GIVEN: Final = {"force": "of the force asked", "time": "by time"}


def _given(nodes: Mapping[str, Mapping[str, Any]]) -> str:
    """The least share of the force asked that any device was given, by force and by time, to follow; empty for none."""
    entries = {name: node["given"] for name, node in nodes.items() if "given" in node}
    found = []
    for share, words in _LEAST_GIVEN.items():
        shares = {name: entry[share] for name, entry in entries.items() if share in entry}
        if shares:
            least = min(shares, key=shares.__getitem__)
            found.append(f"{percent(shares[least])} {words} ({least})")
    return f"; least given: {', '.join(found)}" if found else ""


def given_sentences(report: Mapping[str, Any]) -> list[str]:
    """Which devices were not given their force, why, and what helps: a sentence for each, of a whole report."""
    rows = [row for row in missed(rows_of(report)) if row.promise == Promise.GIVEN]
    return [row.remark for row in condensed(rows)]


def falling(lateness: Mapping[str, Any]) -> str:
    """By what power the bound of an account falls, to follow it; empty for none."""
    power = lateness.get("power", 0.0)
    return f", falling by {1e3 * power:g} mW" if power else ""


def lateness_sentence(report: Mapping[str, Any]) -> str | None:
    """What is proved of lateness, what was enforced beyond, and the least account: a sentence about a whole report.

    Returns:
        None for a run without devices in wall time.
    """
    entries = {name: node["interface"] for name, node in report["nodes"].items() if "interface" in node}
    if not entries:
        return None
    least = min(entries, key=lambda name: entries[name]["min"])
    account, promise = entries[least]["min"], report.get("lateness")
    missing = report.get("unreported", ())
    of = f" of those reported, and no figures came from {', '.join(missing)}" if missing else ""
    lowest = (f"least account {joules(account)} ({least})" if account < 0.0 else "no account fell below 0") + of
    for name, node in report["nodes"].items():
        if "suspended" in node:
            slept = node["suspended"]
            lowest += (
                f"; the process of {name} was suspended for {slept['seconds']:.3g} s, which put in "
                f"{joules(slept['energy'])}"
            )
    given = _given(report["nodes"])
    if promise is None:
        return f"lateness: nothing is proved, and it was only counted; {lowest}{given}"
    proved = f"lateness: proved up to τ = {1e3 * promise['tau']:.4g} ms"
    if promise["enforced"]:
        changed, kept = (sum(entry[key] for entry in entries.values()) for key in ("changed_ticks", "kept_back"))
        beyond = f"enforced beyond: {counted(changed, 'tick')} changed, {joules(kept)} kept back"
    else:
        beyond = "only counted beyond"
    return f"{proved}, {beyond}; {lowest}, bound {joules(0.0 - promise['tank'])}{falling(promise)}{given}"


LATE_WORTH_SAYING: Final = 0.01
"""The part of a node's ticks that must be late before the last line says so: of a notice, too."""

_BY_LATENESS: Final = (Promise.DELAY, Promise.PERIOD, Promise.LATENESS)
"""Promises that are enforced by taking force away, where a device is late."""


def last_line(report: Mapping[str, Any], faults: Sequence[str] = ()) -> str:
    """How a run went, in one line: what made it fail, or what was worst; who was late, and what force that has cost.

    A force that was taken away is what a user has felt, so where no promise was broken it comes first.

    Args:
        report: the whole report of a run.
        faults: what made the run fail.
    """
    if faults:
        return f"failed: {faults[0].splitlines()[0]}"
    rows = rows_of(report)
    if not rows:
        return ""
    text, late = verdict(rows), _late(report["nodes"])
    enforced = any(row.promise in _BY_LATENESS and row.state == PromiseState.ENFORCED for row in rows)
    absent = any(row.promise == Promise.PRESENCE and row.state != PromiseState.KEPT for row in rows)
    lost, free = _lost(report, absent) if enforced else ([], "")
    if lost and not any(row.state == PromiseState.BROKEN for row in rows):
        return "; ".join(part for part in (*lost, text, late, free) if part)
    said = "; ".join(part for part in (late, *lost, free) if part)
    if not said:
        return text
    return f"{text} {said[0].upper()}{said[1:]}." if text.endswith(".") else f"{text}; {said}"


def _late(nodes: Mapping[str, Mapping[str, Any]]) -> str:
    """The nodes of which many ticks were late, the latest first; empty where there are none."""
    shares = {name: node["late"] / node["ticks"] for name, node in nodes.items() if node.get("late") and node["ticks"]}
    often = sorted((name for name in shares if shares[name] >= LATE_WORTH_SAYING), key=lambda name: -shares[name])
    words = ", ".join(
        f"{name} in {percent(min(1.0, shares[name]))} of its ticks{_by_itself(nodes[name])}"
        for name in often[:MOST_ROWS]
    )
    more = f" and {len(often) - MOST_ROWS} more" if len(often) > MOST_ROWS else ""
    return f"late: {words}{more}" if often else ""


def _by_itself(node: Mapping[str, Any]) -> str:
    """In how many ticks a node was late by the work of its own process, such as its driver's; empty for few."""
    own = node.get("late_causes", {}).get("own", 0) / node["ticks"]
    return f" ({percent(own)} by its own work)" if own >= LATE_WORTH_SAYING else ""


def _lost(report: Mapping[str, Any], absent: bool) -> tuple[list[str], str]:
    """What lateness has taken from hands, and the sentence for a run in which it has taken no force.

    The first names the hand that lacked force for longest, without the time in which somebody was ``absent``.
    """
    nodes, lagged = report["nodes"], _lagged(report)
    beside, behind = "besides absences, " if absent else "", [lagged] if lagged else []
    given = {name: node["given"] for name, node in nodes.items() if node.get("given", {}).get("seconds")}
    if not given:
        return behind, ""
    lacked = {name: (one["away"] + one["held_back"]) / one["seconds"] for name, one in given.items()}
    most = max(lacked, key=lacked.__getitem__)
    if not lacked[most]:
        changed = sum(node.get("interface", {}).get("changed_ticks", 0) for node in nodes.values())
        moved = f", and the motion of {counted(changed, 'tick')} was changed" if changed else ""
        return behind, f"{beside}no force was taken away{moved}"
    share = math.ceil(1000.0 * min(1.0, lacked[most]) - 1e-9) / 10.0  # up: what was lacking is never called nothing
    return [f"{beside}force was taken away for {share:.3g} % of the time ({most})", *behind], ""


BEHIND_WORTH_SAYING: Final = 1e-3
"""m or rad; so far a tool must have lagged behind its device that it is said: K times that is missing of a wall."""


def _lagged(report: Mapping[str, Any]) -> str:
    """How far lateness has made a tool lag behind its device at most; empty where that is not worth saying."""
    nodes = report["nodes"].items()
    offsets = {name: node.get("interface", {}).get("offset", 0.0) for name, node in nodes}
    most = max(offsets, key=offsets.__getitem__, default=None)
    if most is None or not offsets[most] >= BEHIND_WORTH_SAYING:
        return ""
    unit = units_in(report, most)("mm")
    return f"the tool of {most} was up to {1e3 * offsets[most]:.3g} {unit} behind it"


def units_in(report: Mapping[str, Any], *nodes: str) -> Units:
    """The units of what a whole report says of these nodes; of all of them, if none is named."""
    kinds: Mapping[str, Sequence[str]] = report.get("axes", {})
    found = [kinds.get(node, ()) for node in nodes or report["nodes"]]
    return Units.of(AxisKind(kind) for own in found for kind in own)


def felt_links(session: Session, figures: Mapping[str, Figures]) -> dict[str, FeltLink]:
    """Every wave link of a session of which both ends have reported, by its coupling.

    Args:
        session: the session.
        figures: of each node that has reported.
    """
    out: dict[str, FeltLink] = {}
    for name in session.wave_links:
        impedance = session.impedance_of(name)
        if impedance is None or not {name, ENVIRONMENT} <= figures.keys():
            continue
        felt = felt_link(name, impedance, figures[name], figures[ENVIRONMENT], session.kinds_of(name))
        if felt is not None:
            out[name] = felt
    return out


def wave_link_sentences(report: Mapping[str, Any]) -> list[str]:
    """A sentence about each wave link of a whole report."""
    entries: Mapping[str, Mapping[str, Any]] = report.get("wave_links", {})
    return [read(FeltLink, entry).sentence(name, over=True) for name, entry in entries.items()]


def rows_of(report: Mapping[str, Any]) -> list[PromiseStatus]:
    """How the promises stood at the end of a run, from its whole report."""
    return [read(PromiseStatus, row) for row in report.get("promises", ())]


def joules(energy: float) -> str:
    """An energy for a sentence, in J, or in mJ below 1 J."""
    return f"{energy:.3g} J" if abs(energy) >= 1.0 else f"{1e3 * energy:.3g} mJ"


def run_report(
    session: str,
    certificate: str,
    clock: str,
    duration: float,
    nodes: Mapping[str, Role],
    reports: Mapping[str, Report],
    refused: Mapping[str, int],
    incidents: Incidents,
    enforced: Sequence[str] = (),
    lateness: Mapping[str, Any] | None = None,
    wave_links: Mapping[str, FeltLink] = MappingProxyType({}),
    promises: Sequence[PromiseStatus] = (),
    unreported: Sequence[str] = (),
    by_itself: Mapping[str, Sequence[str]] = MappingProxyType({}),
    axes: Mapping[str, Sequence[AxisKind]] = MappingProxyType({}),
    visits: Sequence[str] = (),
) -> dict[str, Any]:
    """The whole report.

    Args:
        session: the session's name.
        certificate: the id it ran under.
        clock: "realtime" or "simulated".
        duration: time that was run, by the session's clock, s.
        nodes: every node's role.
        reports: the final reports of the nodes that sent one, each with the figures of all processes of its node.
        refused: what the supervisor did not admit, by kind; only kinds that occurred.
        incidents: the faults that the session survived.
        enforced: parties whose level is enforced at run time instead of proved.
        lateness: what is promised about lateness, as :func:`lateness_entry`.
        wave_links: what is felt of each wave link at the end, by coupling.
        promises: how each promise stands at the end.
        unreported: the nodes that have run and sent no final report.
        by_itself: by device, what it does by itself, as its driver states.
        axes: by device, what its axes do, where some axis of the session turns.
        visits: who has lately taken a seat, or left one as its user wanted.
    """
    restarts = incidents.restarts
    return {
        "session": session,
        "certificate": certificate,
        "clock": clock,
        "duration": duration,
        "nodes": {
            name: node_entry(role, reports[name], restarts[name]) for name, role in nodes.items() if name in reports
        },
        **({"unreported": list(unreported)} if unreported else {}),
        **({"enforced": list(enforced)} if enforced else {}),
        **({"by_itself": {name: list(own) for name, own in by_itself.items()}} if by_itself else {}),
        **({"axes": {name: [kind.value for kind in own] for name, own in axes.items()}} if axes else {}),
        **({} if lateness is None else {"lateness": dict(lateness)}),
        **({"wave_links": {name: felt.as_plain() for name, felt in wave_links.items()}} if wave_links else {}),
        **({"promises": [written(row) for row in promises]} if promises else {}),
        **({"refused": dict(refused)} if refused else {}),
        **({"incidents": list(incidents.sentences)} if incidents.total else {}),
        **({"visits": list(visits)} if visits else {}),
    }


def save_json(data: Mapping[str, Any], path: Path) -> None:
    """Write one JSON object; a failed write leaves any former file as it was.

    Raises:
        OSError: the file cannot be written.
    """
    with replacing(path) as file:
        file.write(json.dumps(data, indent=2, allow_nan=False).encode() + b"\n")
