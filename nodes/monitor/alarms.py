"""What a person should know of a running session at once, since when, and what to do about it: pure.

An alarm is raised when its cause is first seen, and cleared when the cause has been absent for a while. So a cause that
comes and goes with every telemetry message is one alarm and not ten a second. Most causes are promises that are not
kept (:mod:`manyhands.nodes.monitor.health`), so none stands beside a health that is ok. Incidents and faults report
what has happened, so they are never cleared. Whether delays are worth an alarm is decided in one place, for the notices
(:mod:`manyhands.launch.run.breaches`): every machine has a late tick now and then.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Final

from manyhands.nodes.monitor.health import PROMISES, Health, PromiseState, grouped, is_present, missed, sentence
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
        text: what has happened.
        advice: what to do.
        since: when it began, s of the session's time.
        earlier: whether it may have begun before that: it was there at the first look.
        cleared: when its cause was last seen, s, if it is gone; None while it lasts.
    """

    key: str
    level: AlarmLevel
    text: str
    advice: str
    since: float
    earlier: bool = False
    cleared: float | None = None


@dataclass(frozen=True)
class AlarmCause:
    """A cause that is present now, and raises an alarm.

    Attributes:
        key, level, text, advice: of the alarm.
        lasting: whether it cannot be undone.
        since: when it began, s of the session's time; None where only its first sight is known.
    """

    key: str
    level: AlarmLevel
    text: str
    advice: str
    lasting: bool = False
    since: float | None = None


_LATE_ADVICE: Final = "The machine is too slow for the period: run manyhands doctor, and close other programs."
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
    for node in live.nodes.values():
        if node.health is Health.LATE:
            text = f"{node.name}: more of its ticks are late than is usual on any machine"
            yield AlarmCause(f"{node.name} late", AlarmLevel.WARNING, text, _LATE_ADVICE)
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
        text = row.remark or sentence(row)
        yield AlarmCause(f"{row.promise} {row.state}", level or AlarmLevel.WARNING, text, advice, since=row.since)


def _sentences(live: LiveSession) -> Iterator[AlarmCause]:
    condition = live.condition
    if condition is None:
        return
    for text in condition.faults:
        advice = "The run counts as failed: see its report and logs."
        yield AlarmCause(f"fault: {text}", AlarmLevel.FAULT, text, advice, True)
    about_promises = {row.remark for row in live.promises}
    for text in condition.notices:
        if text not in about_promises:
            advice = "An assumption of the certificate was broken: what it proves does not cover this."
            yield AlarmCause(f"notice: {text}", AlarmLevel.WARNING, text, advice, True)
    for text in condition.incidents:
        yield AlarmCause(f"incident: {text}", AlarmLevel.NOTE, text, "Nothing: the session survived it.", True)


def _unheard(live: LiveSession, now: Instant) -> Iterator[AlarmCause]:
    received = [node.received for node in live.nodes.values() if node.received is not None]
    over = live.condition is not None and live.condition.phase in ("ending", "over")
    if received and not over and now - max(received) > UNHEARD:
        yield AlarmCause(
            "unheard",
            AlarmLevel.FAULT,
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
                self._put(Alarm(cause.key, cause.level, cause.text, cause.advice, since, earlier))
                if cause.lasting:
                    self._lasting.add(cause.key)
            elif standing.text != cause.text:
                self._put(replace(standing, text=cause.text))
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
