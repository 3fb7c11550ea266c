"""What an audit says of the promises of a run: the rows of its health, from the checks and the recorded telemetry.

The telemetry gives the rows that the session itself has shown (:mod:`manyhands.nodes.monitor.health`), except for
what only its supervisor's clock shows: the pace, and who was away. These are in the session's last condition, as the
page, `top` and the report had them. A check that was computed again knows more: the exact tick, or that a number was
changed. So each check adds to the row of its promise, or makes it graver. What the recording does not hold is *not
checked*, which is no reason to call it kept.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from manyhands.launch.audit.findings import Check, CheckVerdict
from manyhands.launch.plan.prepare import Prepared
from manyhands.launch.recordings.run import RecordedRun
from manyhands.launch.run.broadcast import describe
from manyhands.nodes.monitor.health import GRAVITY, SESSION, PromiseState, most_grave, readable
from manyhands.nodes.monitor.health_model import HealthModel
from manyhands.nodes.rows.promises import Promise
from manyhands.protocol.messages import PromiseStatus

_OF_CHECKS: Final[Mapping[str, Promise]] = {
    "certificate": Promise.CERTIFICATE,
    "bound": Promise.PASSIVITY,
    "tau": Promise.DELAY,
    "period": Promise.PERIOD,
    "account": Promise.LATENESS,
    "torques": Promise.DRIVER,
    "turned": Promise.ORIENTATION,
    "limits": Promise.FORCE,
    "tank": Promise.LINK,
    "rules": Promise.LINK,
    "link": Promise.LINK,
}
"""The promise that a check is about; every other check is about the record."""

_STATES: Final[Mapping[CheckVerdict, PromiseState]] = {
    CheckVerdict.HOLDS: PromiseState.KEPT,
    CheckVerdict.ENFORCED: PromiseState.ENFORCED,
    CheckVerdict.ASSUMPTION: PromiseState.BROKEN,
    CheckVerdict.BROKEN: PromiseState.BROKEN,
    CheckVerdict.MISSING: PromiseState.UNCHECKED,
    CheckVerdict.UNCHECKED: PromiseState.UNCHECKED,
}


def promises_of(prepared: Prepared, run: RecordedRun, checks: Sequence[Check]) -> tuple[PromiseStatus, ...]:
    """How each promise stood in a recorded run.

    Args:
        prepared: the session with its certificate.
        run: the recording.
        checks: everything that was checked.
    """
    terms = describe(prepared, run.recorded.clock, "", run.ticks).terms
    model = HealthModel(terms)
    telemetry = [(run.recorded.rate_of(node), node, *one) for node, figures in run.figures.items() for one in figures]
    for _, node, tick, figures in sorted(telemetry, key=lambda one: one[2] / one[0]):
        model.take(node, tick, figures)
    model.conclude()
    for device, by_itself in run.by_itself.items():
        model.hear(device, by_itself)
    rows = {(row.promise, row.who): row for row in model.rows()}
    for row in _of_the_clock(run, made := {*terms.promises}):
        shown = rows.get((row.promise, row.who))
        if shown is None or GRAVITY[PromiseState(row.state)] >= GRAVITY[PromiseState(shown.state)]:
            rows[row.promise, row.who] = row
    there = {node for (node, _), trace in run.traces.items() if np.isfinite(trace.values).any()} | {SESSION}
    lacking = {check.party for check in checks if check.verdict is CheckVerdict.MISSING}
    for promise in (Promise.CERTIFICATE, Promise.RECORD):
        rows[promise.value, ()] = PromiseStatus(promise.value, PromiseState.KEPT.value, since=0.0)
    for (promise, party), state in _verdicts(checks).items():
        if state is PromiseState.KEPT:
            continue
        if party not in there | lacking:
            continue  # nobody has sat there
        unmade = promise not in made and promise not in (Promise.CERTIFICATE, Promise.RECORD)
        if state is PromiseState.UNCHECKED and (unmade or promise is Promise.DRIVER):
            continue  # a driver's word that nothing could check is believed, as in the run
        about = [check for check in checks if _about(check) == (promise, party) and _STATES[check.verdict] is state]
        missing = [check for check in about if check.verdict is CheckVerdict.MISSING]
        row = _row(run, promise, party, state, missing or about)
        key = promise.value, row.who
        rows[key] = _graver(rows.get(key), row)
    if not run.ticks:  # nothing happened that could have broken a promise, so none was kept
        kept = PromiseState.KEPT.value
        return most_grave(row for row in rows.values() if row.state != kept or row.promise == Promise.CERTIFICATE)
    return most_grave(rows.values())


def _of_the_clock(run: RecordedRun, made: Collection[Promise]) -> Iterator[PromiseStatus]:
    """The rows that only the supervisor's clock shows, by the last condition that has rows; of parties of the session.

    Where the recording has no such condition, the pace was not checked.
    """
    conditions = [condition for _, condition in run.conditions if condition.promises]
    parties = {*run.recorded.roles, SESSION}
    for row in readable(conditions[-1].promises) if conditions else ():
        if row.promise in (Promise.PACE, Promise.PRESENCE) and row.promise in made and parties.issuperset(row.who):
            yield row
    if not conditions and Promise.PACE in made:
        remark = "the recording has no condition of the session, which its supervisor shows"
        yield PromiseStatus(Promise.PACE.value, PromiseState.UNCHECKED.value, (SESSION,), remark=remark)


def _about(check: Check) -> tuple[Promise, str]:
    return _OF_CHECKS.get(check.name, Promise.RECORD), check.party


def _verdicts(checks: Sequence[Check]) -> Mapping[tuple[Promise, str], PromiseState]:
    """The state of each promise of each party by the checks about it, the gravest.

    A check that had nothing to compare counts only where no other could compare. What the recording lacks is not
    checked, whatever the rest is.
    """
    out: dict[tuple[Promise, str], PromiseState] = {}
    for about in dict.fromkeys(map(_about, checks)):
        own = [check.verdict for check in checks if _about(check) == about]
        compared = [verdict for verdict in own if verdict is not CheckVerdict.UNCHECKED]
        out[about] = max((_STATES[verdict] for verdict in compared or own), key=GRAVITY.__getitem__)
    return out


def _row(run: RecordedRun, promise: Promise, party: str, state: PromiseState, checks: Sequence[Check]) -> PromiseStatus:
    """The row of one party's promise, from the checks that found its state."""
    firsts = [check.first for check in checks if check.first is not None]
    rate = run.recorded.rate_of(party) if party in run.recorded.roles else 1.0
    since = min((first.tick for first in firsts), default=None)
    cost: dict[str, float] = {}
    if state is not PromiseState.UNCHECKED:
        cost["ticks"] = float(max((check.differing for check in checks), default=0))
    if promise in (Promise.PASSIVITY, Promise.LATENESS):  # the energy by which the first number is beyond its bound
        cost["J"] = max((first.recomputed - first.recorded for first in firsts), default=0.0)
    remark = "; ".join(check.remark or check.what for check in checks)
    return PromiseStatus(
        promise.value,
        state.value,
        (party,),
        None if since is None else since / rate * run.recorded.period,
        None,
        {unit: value for unit, value in cost.items() if 0.0 < value < math.inf},
        remark,
    )


def _graver(shown: PromiseStatus | None, found: PromiseStatus) -> PromiseStatus:
    """What the session has shown and what a check has found, in one row: the graver state, and the exact time."""
    if shown is None or (found.state == PromiseState.BROKEN and shown.state != PromiseState.BROKEN):
        return found
    state = max(PromiseState(shown.state), PromiseState(found.state), key=GRAVITY.__getitem__)
    since = shown.since if found.since is None else found.since
    return replace(shown, state=state.value, since=since, cost={**found.cost, **shown.cost}, remark=found.remark)
