"""The health of a session: how each of its promises stands, by whom, since when, and at what cost. Pure.

Each promise is *kept*; or it was about to be missed and is *enforced* by what the session does about it; or it is
*broken*. :data:`PROMISES` is the table of all promises. A row states how one of them stands
(:class:`~manyhands.protocol.messages.PromiseStatus`). :mod:`manyhands.nodes.monitor.health_model` makes the rows. The
supervisor shows them in each condition. Page, `top`, `list` and the report print these rows, and an audit makes them
again from the recorded telemetry. So all of them speak of the same things in the same words.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from types import MappingProxyType
from typing import Final

from manyhands.nodes.kernel.words import counted
from manyhands.nodes.monitor.given import ENOUGH, MEASURE
from manyhands.nodes.rows.promises import Promise
from manyhands.protocol.limits import MAX_SENTENCES
from manyhands.protocol.messages import PromiseStatus


class Health(StrEnum):
    """The health of a node, a link or a session, at a glance; a later value is worse."""

    FREE = "free"  # a seat that nobody has taken
    OK = "ok"
    WAITING = "waiting"  # it has not begun, or has nothing more to do
    ENFORCED = "enforced"  # of a session: a promise is enforced now
    LATE = "late"  # more of its ticks are late than is usual on any machine
    SLOW = "slow"  # of a session: it runs slower than its period
    FROZEN = "frozen"  # it takes no part, and the others go on
    SILENT = "silent"  # it runs, but sends no telemetry
    AWAY = "away"  # its process died, or failed
    BROKEN = "broken"  # of a session: what its certificate needs does not hold


SEVERITY: Final = {health: place for place, health in enumerate(Health)}


def worse(*healths: Health) -> Health:
    """The worst of these."""
    return max(healths, key=SEVERITY.__getitem__)


class PromiseState(StrEnum):
    """How a promise stands; a later value is graver."""

    KEPT = "kept"
    UNJUDGED = "not judged"  # nothing here can judge it: the work of a person's hand, the word of a driver
    ENFORCED = "enforced"
    UNCHECKED = "not checked"  # of an audit: the recording does not hold what would show it
    BROKEN = "broken"


GRAVITY: Final = {state: place for place, state in enumerate(PromiseState)}


@dataclass(frozen=True)
class PromiseText:
    """What a promise is, in words.

    Attributes:
        claim: the promise, to follow its party.
        needed: whether the certificate needs it: a run in which it is broken is covered by no proof.
        advice: what to do where it is not kept.
        moved: the same where another party moved the one that counted it (:data:`MOVED`).
    """

    claim: str
    needed: bool
    advice: str
    moved: str = ""


MOVED: Final = "another party moved it"
"""How the remark begins of a row about a force that was cut while the environment's account shows another mover."""

UNKNOWN_MOVER: Final = "the environment has not reported who moved"

_FASTER: Final = f"{MEASURE}."  # a command has no capital at the head of a sentence either
PROMISES: Final[Mapping[Promise, PromiseText]] = MappingProxyType({
    Promise.CERTIFICATE: PromiseText(
        "the certificate is proved, and it is this session's", True, "Certify the session again: manyhands design."
    ),
    Promise.RECORD: PromiseText(
        "what was recorded follows from what the others sent, by the certified arithmetic", True,
        "Something was changed after it was recorded, or computed otherwise: see the first number that differs.",
    ),
    Promise.PASSIVITY: PromiseText(
        "the energy that it gives off stays within its promised level", True,
        "It broke its promise of passivity: let go of it, and check that it is as passive as declared (osp).",
    ),
    Promise.DRIVER: PromiseText(
        "its device measures, acts and exerts as its driver states", True,
        "The driver is wrong, and not its user: do not use it before manyhands check-driver finds nothing.",
    ),
    Promise.ORIENTATION: PromiseText(
        "the account of its orientation never falls below what it may: it gives off no energy by turning", True,
        "It broke its promise: let go of it, and check its osp and its limits (devices: orientation).",
    ),
    Promise.DELAY: PromiseText("each force acts at most tau after its sample, and before the next one", True, _FASTER),
    Promise.PERIOD: PromiseText("samples are no further apart than the certificate covers", True, _FASTER),
    Promise.LATENESS: PromiseText(
        "lateness puts in no more energy than faults.tank", True,
        "See whether its process was stopped, its clock changed, or its limit of speed is too low for its motion; "
        "with faults: {lateness: enforce} it is bounded for motions within that limit.",
    ),
    Promise.INERTIA: PromiseText(
        "it is no quicker than its stated mass and its hand's force allow", False,
        "State a lesser mass or a stronger hand (devices: mass, limits.hand), or a step of its displacements. Until "
        "then the reserve for lateness rests on the limit of speed, and late ticks take more of its force.",
    ),
    Promise.SPEED: PromiseText(
        "every axis is slower than the speed below which the certificate holds (design.speed)", True,
        "Move more slowly, or certify for a greater speed. Beyond it the tank pays for what dry friction does not.",
    ),
    Promise.FORCE: PromiseText(
        "its forces stay within their limits, as the certificate assumes", True,
        "Raise the limits of force, or soften the world: the certificate does not cover a force that was cut.",
        "The certificate does not cover a force that was cut. Lower the energy and power that the mover may put in "
        "(limits), or let it push less.",
    ),
    Promise.GIVEN: PromiseText(
        f"at least {100.0 * ENOUGH:g} % of the force asked is given, by force and by time", False,
        "Nothing of the certificate is lost, but a hand feels less than was asked for. Its line has the cause.",
    ),
    Promise.LEVEL: PromiseText(
        "the environment keeps its declared level, by a passivity controller where it would not", True,
        "Nothing: the controller keeps the level. To feel the model unchanged, declare a lower level.",
    ),
    Promise.LINK: PromiseText(
        "waves come in time, and cost no more than its tanks hold", True,
        "Nothing: the tool is held while no wave comes. Look after the network between the two ends.",
    ),
    Promise.MOTION: PromiseText(
        "it stays within its limits of displacement and speed, or lets go", False,
        "Nothing: it let go until it was within its limits again. Raise the limits if the device can do more.",
    ),
    Promise.BUDGET: PromiseText(
        "it puts no more energy into the others than its budget", False,
        "Nothing: its force is scaled until it is within its budget again.",
    ),
    Promise.PRESENCE: PromiseText(
        "it takes part in every tick", False,
        "The others go on, still certified. See its log, its machine and its network; it is let in again by a ramp.",
    ),
    Promise.PUNCTUALITY: PromiseText(
        "it does not make the others wait too often", False,
        "Its user's machine or network is slower than the delay that was designed for.",
    ),
    Promise.PACE: PromiseText(
        "the session keeps up with the clock", False,
        _FASTER,
    ),
})  # fmt: skip
"""Every promise, the gravest first."""

SESSION: Final = "session"
"""The party of what the whole session promises."""

ORDER: Final = {promise.value: place for place, promise in enumerate(PROMISES)}

AWAY_STATES: Final = ("lost", "gone for good", "failed", "leaving")
"""The states of a node, as the supervisor names them, in which it takes no part."""

FREE_STATE: Final = "free"
"""The state of a seat that nobody has taken."""


def most_grave(rows: Iterable[PromiseStatus]) -> tuple[PromiseStatus, ...]:
    """As many rows as a condition may have: all promises, and of what is not kept the gravest; in the table's order."""
    ordered = sorted(rows, key=lambda row: (ORDER.get(row.promise, len(ORDER)), -GRAVITY[PromiseState(row.state)]))
    if len(ordered) <= MAX_SENTENCES:
        return tuple(ordered)
    gravest = sorted(ordered, key=lambda row: (row.state != PromiseState.KEPT, -GRAVITY[PromiseState(row.state)]))
    kept = {id(row) for row in gravest[:MAX_SENTENCES]}
    return tuple(row for row in ordered if id(row) in kept)


def readable(rows: Iterable[PromiseStatus]) -> tuple[PromiseStatus, ...]:
    """The rows whose promise and state are known here; others may come from another version."""
    states = {state.value for state in PromiseState}
    return tuple(row for row in rows if row.promise in ORDER and row.state in states)


def session_health(rows: Iterable[PromiseStatus]) -> Health:
    """What the promises say of a session's health now.

    What the certificate needs and was broken once stays broken. Everything else counts while it lasts.
    """
    return worse(Health.OK, *(_health_of(row) for row in rows))


def _health_of(row: PromiseStatus) -> Health:
    if row.state == PromiseState.BROKEN and PROMISES[Promise(row.promise)].needed:
        return Health.BROKEN
    if row.state in (PromiseState.KEPT, PromiseState.UNJUDGED) or row.until is not None:
        return Health.OK
    if row.promise == Promise.GIVEN:
        return Health.ENFORCED  # what took the force is what keeps the session stable
    if row.state == PromiseState.BROKEN:
        return Health.SLOW if row.promise == Promise.PACE else Health.OK  # the nodes who are away show it themselves
    return Health.FROZEN if row.promise == Promise.PRESENCE else Health.ENFORCED


def is_present(row: PromiseStatus) -> bool:
    """Whether a row counts now: its state lasts, or what the certificate needs was broken."""
    broken = row.state == PromiseState.BROKEN and PROMISES[Promise(row.promise)].needed
    return row.until is None or broken


def missed(rows: Iterable[PromiseStatus]) -> list[PromiseStatus]:
    """The rows of promises that were not kept by themselves, the gravest first."""
    found = [row for row in rows if row.state != PromiseState.KEPT]
    return sorted(found, key=lambda row: (row.until is not None, -GRAVITY[PromiseState(row.state)]))


def holds(rows: Iterable[PromiseStatus]) -> bool:
    """Whether all that the certificate needs was kept or enforced."""
    broken = (PromiseState.BROKEN, PromiseState.UNCHECKED)
    return not any(row.state in broken for row in rows if PROMISES[Promise(row.promise)].needed)


def grouped(rows: Iterable[PromiseStatus]) -> list[PromiseStatus]:
    """One row for each promise and state, of all its parties: since the first of them, until the last, costs added."""
    out: dict[tuple[str, str], PromiseStatus] = {}
    for row in rows:
        before = out.get((row.promise, row.state))
        if before is None:
            out[row.promise, row.state] = row
            continue
        sinces = [at for at in (before.since, row.since) if at is not None]
        until = None if before.until is None or row.until is None else max(before.until, row.until)
        cost = {unit: before.cost.get(unit, 0.0) + row.cost.get(unit, 0.0) for unit in {**before.cost, **row.cost}}
        cost = {unit: value for unit, value in cost.items() if math.isfinite(value)}
        remark = before.remark if row.remark in before.remark else f"{before.remark}; {row.remark}".removeprefix("; ")
        out[row.promise, row.state] = replace(
            before, who=(*before.who, *row.who), since=min(sinces, default=None), until=until, cost=cost, remark=remark
        )
    return list(out.values())


def condensed(rows: Iterable[PromiseStatus]) -> list[PromiseStatus]:
    """The rows for people: of a promise that some do not keep, no row says that all others do; and one row for all
    parties of a promise and state, where more than :data:`MOST_ROWS` would be about it.
    """
    rows = list(rows)
    missing = {row.promise for row in missed(rows) if row.state != PromiseState.UNJUDGED}
    shown = [row for row in rows if row.state != PromiseState.KEPT or row.promise not in missing]
    alike = Counter((row.promise, row.state) for row in shown)
    many = {key for key, count in alike.items() if count > MOST_ROWS}
    one = {(row.promise, row.state): row for row in grouped(shown)}
    out: dict[tuple[str, ...], PromiseStatus] = {}
    for row in shown:
        key = row.promise, row.state
        if key in many:
            out.setdefault(key, one[key])
        else:
            out[*key, *row.who] = row
    return list(out.values())


_CAUSED: Final = (Promise.DELAY, Promise.PERIOD, Promise.FORCE)
"""Promises that may be broken without any party that is known to have broken them."""

MOST_ROWS: Final = 3
"""The most parties of one promise and state that have a row each, where people read them."""


_MOST_NAMED: Final = 4


def parties(who: tuple[str, ...]) -> str:
    """The parties of a row, for people."""
    if not who:
        return "all"
    more = f" and {len(who) - _MOST_NAMED} more" if len(who) > _MOST_NAMED else ""
    return ", ".join(who[:_MOST_NAMED]) + more


def when(row: PromiseStatus) -> str:
    """Since when a row holds, and until when, s of the session's time; empty for a promise that is kept."""
    if row.state in (PromiseState.KEPT, PromiseState.UNJUDGED) or row.since is None:
        return ""
    return f"{row.since:.1f} s" if row.until is None else f"{row.since:.1f} s to {row.until:.1f} s"


def cost_text(cost: Mapping[str, float]) -> str:
    """What a row has cost, with units; empty where it is nothing."""
    return ", ".join(_priced(unit, value) for unit, value in cost.items() if math.isfinite(value) and value > 0.0)


def _cost_of(row: PromiseStatus) -> str:
    """The cost of a row, which says so where it is the sum of several parties."""
    text = cost_text(row.cost)
    return f"{text} in all" if text and len(row.who) > 1 else text


def _priced(unit: str, value: float) -> str:
    if unit in ("ticks", "times"):
        return counted(value, unit.removesuffix("s"))
    if unit == "J":
        return f"{value:.3g} J" if value >= 1.0 else f"{1e3 * value:.3g} mJ"
    if unit == "x":
        return f"{value:.2f} of real time"
    return f"{value:.3g} {unit}"


def cells(row: PromiseStatus) -> tuple[str, str, str, str, str]:
    """Promise, state, parties, time and cost of a row, as texts of a table."""
    return row.promise, row.state, parties(row.who), when(row), _cost_of(row)


def sentence(row: PromiseStatus) -> str:
    """A row that is not kept, as a sentence; what is the session's as a whole names nobody."""
    by = "by" if row.state == PromiseState.BROKEN and row.promise != Promise.GIVEN else "at"  # whoever lacks a force
    cost = _cost_of(row)
    if row.state == PromiseState.UNJUDGED:
        return f"{row.promise}: {row.state}: {row.remark}"
    nobody = row.promise in _CAUSED and row.who == (SESSION,)
    text = f"{row.promise}: {row.state}" + ("" if nobody else f" {by} {parties(row.who)}")
    time = when(row)
    since = f" since {time}" if row.until is None else f" from {time}"
    return text + (since if time else "") + (f" ({cost})" if cost else "")


def cut_forces(rows: Iterable[PromiseStatus]) -> str:
    """Whose forces were cut to their limits, or who moved them, in a sentence about rows of :attr:`Promise.FORCE`."""
    found = [row.remark or f"those of {parties(row.who)}" for row in rows]
    return f"forces were cut to their limits, and the certificate covers no force beyond them: {'; '.join(found)}"


def verdict(rows: Iterable[PromiseStatus]) -> str:
    """How a run went, in one line: the worst that was broken, by whom, how much and what to do; or that nothing was.

    Of what was broken, the worst is what the certificate needs, then what stands first in :data:`PROMISES`, then who
    broke it most.
    """
    rows = missed(rows)
    broken = [row for row in rows if row.state == PromiseState.BROKEN]
    if not broken:
        enforced = [
            f"{row.promise} ({parties(row.who)})" for row in grouped(rows) if row.state == PromiseState.ENFORCED
        ]
        text = f"all promises kept, or enforced: {', '.join(enforced)}" if enforced else "all promises kept"
        open_ = [f"{row.promise} ({parties(row.who)})" for row in grouped(rows) if row.state == PromiseState.UNJUDGED]
        return f"{text}; not judged: {', '.join(open_)}" if open_ else text

    def place(row: PromiseStatus) -> tuple[bool, int, float]:
        return not PROMISES[Promise(row.promise)].needed, ORDER[row.promise], -max(row.cost.values(), default=0.0)

    first = min(broken, key=place)
    also = [party for row in broken if row.promise == first.promise for party in row.who if party not in first.who]
    also = [party for party in also if party != SESSION]
    others = sorted({row.promise for row in broken} - {first.promise}, key=ORDER.__getitem__)
    word = "at" if first.promise == Promise.GIVEN else "by"
    text = f"worst: {sentence(first)}" + (f", and {word} {parties(tuple(also))}" if also else "")
    about, moved = PROMISES[Promise(first.promise)], first.remark.startswith(MOVED)
    if moved or first.remark.startswith(UNKNOWN_MOVER):
        text += f"; {first.remark}"
    advice = f"{first.remark}." if first.promise == Promise.GIVEN and first.remark else about.advice
    return f"{text}. {about.moved if moved else advice}" + (f" Also broken: {', '.join(others)}." if others else "")


def summary(rows: Iterable[PromiseStatus]) -> str:
    """The promises that are broken or enforced now, with their parties, in a line; empty where there are none."""
    present = grouped(row for row in missed(rows) if is_present(row) and row.state != PromiseState.UNJUDGED)
    parts = [f"{row.promise} {row.state} ({parties(row.who)})" for row in present]
    return "; ".join(parts)
