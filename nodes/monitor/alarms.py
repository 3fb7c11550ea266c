"""What a person should know of a running session at once, since when, and what to do about it: pure.

An alarm is raised when its cause is first seen, and cleared when the cause has been absent for a while. So a cause that
comes and goes with every telemetry message is one alarm and not ten a second. Most causes are promises that are not
kept (:mod:`manyhands.nodes.monitor.health`), so none stands beside a health that is ok. Incidents and faults report
what has happened, so they are never cleared. Whether delays are worth an alarm is decided in one place, for the notices
(:mod:`manyhands.launch.run.breaches`): every machine has a late tick now and then.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Final

from manyhands.nodes.monitor.given import MEASURE
from manyhands.nodes.monitor.health import (
    PROMISES,
    SESSION,
    Health,
    PromiseState,
    grouped,
    is_present,
    missed,
    sentence,
)
from manyhands.nodes.monitor.session_state import LiveSession
from manyhands.nodes.rows.promises import Promise
from manyhands.protocol.clock import Instant, from_seconds

HOLD: Final = from_seconds(2.0)
"""How long a cause must be absent before its alarm is cleared."""

UNHEARD: Final = from_seconds(3.0)
"""After so long without any frame, a session that is not over raises an alarm."""

MOST_ALARMS: Final = 1000
"""The most alarms that are kept. Above it the cleared ones go first, then the oldest. Sentences alone may be 384."""


class AlarmLevel(StrEnum):
    """The severity of an alarm; a later value is graver."""

    NOTE = "note"  # it happened, and the session survived it
    WARNING = "warning"  # an assumption of the certificate does not hold, or a user is affected
    FAULT = "fault"  # a promise is broken, or a part of the session is gone


@dataclass(frozen=True)
class Alarm:
    """Something that a person should know.

    Attributes:
        key: what it is about; at any time there is one alarm for each key.
        level: its severity.
        headline: the cause in a few words, without the parties.
        who: the parties, in the order in which they are known; empty where none is named.
        text: what has happened, whole; a line for each sentence about it.
        advice: what to do.
        since: when it began, s of the session's time.
        latest: when its text last changed, s.
        earlier: whether it may have begun before that: it was there at the first look.
        cleared: when its cause was last seen, s, if it is gone; None while it lasts.
    """

    key: str
    level: AlarmLevel
    headline: str
    who: tuple[str, ...]
    text: str
    advice: str
    since: float
    latest: float
    earlier: bool = False
    cleared: float | None = None


@dataclass(frozen=True)
class AlarmCause:
    """A cause that is present now, and raises an alarm.

    Attributes:
        key, level, headline, who, text, advice: of the alarm.
        lasting: whether it cannot be undone.
        since: when it began, s of the session's time; None where only its first sight is known.
    """

    key: str
    level: AlarmLevel
    headline: str
    who: tuple[str, ...]
    text: str
    advice: str
    lasting: bool = False
    since: float | None = None


_LATE_ADVICE: Final = f"The machine is too slow for the period; {MEASURE}."
_BROKEN: Final = {
    Promise.DELAY: AlarmLevel.WARNING,
    Promise.PERIOD: AlarmLevel.WARNING,
    Promise.FORCE: AlarmLevel.WARNING,
    Promise.PACE: AlarmLevel.WARNING,
    Promise.GIVEN: AlarmLevel.WARNING,
}
"""The level of the alarm of a broken promise that is not a fault: an assumption of the certificate that does not hold,
or a hand that feels less than it should.
"""

_STAYS_CERTIFIED: Final = "The session bounds what this may cost, and stays certified."

_ENFORCED: Final = {
    Promise.PRESENCE: AlarmLevel.WARNING,
    Promise.PUNCTUALITY: AlarmLevel.WARNING,
}
"""The level of the alarm of an enforced promise that a user is affected by. Lateness that is enforced raises none,
unless it is worth a notice."""


def causes(live: LiveSession, now: Instant) -> Iterator[AlarmCause]:
    """Every cause that is present now, in no order of severity."""
    yield from _promises(live)
    yield from _sentences(live)
    late = tuple(node.name for node in live.nodes.values() if node.health is Health.LATE)
    if late:
        text = f"more ticks are late than is usual on any machine: {', '.join(late)}"
        yield AlarmCause("late", AlarmLevel.WARNING, "many late ticks", late, text, _LATE_ADVICE)
    yield from _unheard(live, now)


def _promises(live: LiveSession) -> Iterator[AlarmCause]:
    """One cause for each promise that is not kept now, and each of its states."""
    notices = () if live.condition is None else live.condition.notices
    for row in grouped(row for row in missed(live.promises) if is_present(row)):
        promise, broken, noticed = Promise(row.promise), row.state == PromiseState.BROKEN, row.remark in notices
        level = _BROKEN.get(promise, AlarmLevel.FAULT) if broken else _ENFORCED.get(promise)
        if level is None and not noticed:
            continue
        advice = PROMISES[promise].advice
        if noticed:  # the notice itself says what to do
            advice = "What the certificate proves does not cover this." if broken else _STAYS_CERTIFIED
        text, what = row.remark or sentence(row), f"{row.promise} {row.state}"
        who = () if row.who == (SESSION,) else tuple(dict.fromkeys(row.who))
        yield AlarmCause(what, level or AlarmLevel.WARNING, what, who, text, advice, since=row.since)


def _sentences(live: LiveSession) -> Iterator[AlarmCause]:
    condition = live.condition
    if condition is None:
        return
    about_promises = {row.remark for row in live.promises}
    notices = [text for text in condition.notices if text not in about_promises]
    for word, level, texts, advice in (
        ("fault", AlarmLevel.FAULT, condition.faults, "The run counts as failed: see its report and logs."),
        ("notice", AlarmLevel.WARNING, notices, _NOT_COVERED),
        ("incident", AlarmLevel.NOTE, condition.incidents, "Nothing: the session survived it."),
    ):
        for headline, (who, alike) in _alike(texts, live.nodes).items():
            yield AlarmCause(f"{word}: {headline}", level, headline, who, "\n".join(alike), advice, True)


_NOT_COVERED: Final = "An assumption of the certificate was broken: what it proves does not cover this."

_WHEN: Final = re.compile(r"at \d+(\.\d+)? s: ")
"""How the sentence of an incident begins."""


def _alike(texts: Iterable[str], nodes: Collection[str]) -> dict[str, tuple[tuple[str, ...], list[str]]]:
    """Sentences that say the same of different nodes: by what they say, the nodes and the sentences.

    What a sentence says is what follows its time and the node that it begins with, up to its first colon or semicolon.
    """
    out: dict[str, tuple[tuple[str, ...], list[str]]] = {}
    for text in texts:
        said = text.removeprefix(found[0]) if (found := _WHEN.match(text)) else text
        first, _, rest = said.partition(" ")
        node = first.removesuffix(":")
        who = (node,) if node in nodes and rest else ()
        headline = re.split(r"[:;] ", rest if who else said, maxsplit=1)[0]
        before, sentences = out.get(headline, ((), []))
        out[headline] = tuple(dict.fromkeys((*before, *who))), [*sentences, text]
    return out


def _unheard(live: LiveSession, now: Instant) -> Iterator[AlarmCause]:
    received = [node.received for node in live.nodes.values() if node.received is not None]
    over = live.condition is not None and live.condition.phase in ("ending", "over")
    if received and not over and now - max(received) > UNHEARD:
        yield AlarmCause(
            "unheard",
            AlarmLevel.FAULT,
            "nothing is received",
            (),
            "nothing has come from the whole session for a while",
            "The picture is old: see whether its supervisor is stopped or the machine is overloaded.",
        )


_GRAVITY: Final = {level: place for place, level in enumerate(AlarmLevel)}


class Alarms:
    """The alarms of a session.

    Attributes:
        version: changes whenever :meth:`listed` does.
    """

    def __init__(self) -> None:
        """No alarm yet."""
        self._alarms: dict[str, Alarm] = {}
        self._seen: dict[str, tuple[Instant, float]] = {}  # the clock of the onlooker, and the session's time
        self._lasting: set[str] = set()
        self._first: float | None = None  # the session's time at the first look that showed it
        self.version = 0

    def look(self, live: LiveSession, now: Instant) -> None:
        """Raise and clear alarms, as the session at ``now`` requires; ``now`` is a time of the onlooker's own clock."""
        time = live.time
        if self._first is None and live.condition is not None:
            self._first = time
        for cause in causes(live, now):
            self._seen[cause.key] = now, time
            standing = self._alarms.get(cause.key)
            if standing is None or standing.cleared is not None:
                self._alarms.pop(cause.key, None)  # raised again: a new alarm, at the end
                since = time if cause.since is None else cause.since
                earlier = cause.since is None and self._first is not None and time <= self._first
                told = cause.level, cause.headline, cause.who, cause.text, cause.advice
                self._put(Alarm(cause.key, *told, since, time, earlier))
                if cause.lasting:
                    self._lasting.add(cause.key)
            elif (standing.text, standing.who) != (cause.text, cause.who):
                self._put(replace(standing, text=cause.text, who=cause.who, latest=time))
        for key, alarm in list(self._alarms.items()):
            seen, seen_time = self._seen[key]
            if alarm.cleared is None and key not in self._lasting and now - seen > HOLD:
                self._put(replace(alarm, cleared=seen_time))
        self._forget()

    def listed(self) -> list[Alarm]:
        """The alarms that last, the gravest first, then the cleared ones; within each severity the latest first."""

        def order(alarm: Alarm) -> tuple[bool, int, float]:
            return alarm.cleared is not None, -_GRAVITY[alarm.level], -alarm.since

        latest_first = [*self._alarms.values()][::-1]  # for those of one instant
        return sorted(latest_first, key=order)

    def _put(self, alarm: Alarm) -> None:
        self._alarms[alarm.key] = alarm
        self.version += 1

    def _forget(self) -> None:
        for alarm in [] if len(self._alarms) <= MOST_ALARMS else self.listed()[MOST_ALARMS:]:
            del self._alarms[alarm.key], self._seen[alarm.key]
            self._lasting.discard(alarm.key)
