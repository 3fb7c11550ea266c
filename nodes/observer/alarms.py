"""What a person should know of a running session at once, since when, and what to do about it: pure.

An alarm is raised when its cause is first seen, and cleared when the cause has been absent for a while. So a cause that
comes and goes with every telemetry message is one alarm and not ten a second. The sentences of the session (notices,
incidents, faults) report what has happened, so they are never cleared. Whether delays are worth an alarm is decided in
one place, for the notices (:mod:`manyhands.launch.run.breaches`): every machine has a late tick now and then.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Final

from manyhands.nodes import telemetry as names
from manyhands.nodes.observer.scene import Health, NodeScene, Scene
from manyhands.protocol.clock import Instant, from_seconds

HOLD: Final = from_seconds(2.0)
"""How long a cause must be absent before its alarm is cleared."""

UNHEARD: Final = from_seconds(3.0)
"""After so long without any frame, a session that is not over raises an alarm."""

MOST_ALARMS: Final = 1000
"""The most alarms that are kept. Above it the cleared ones go first, then the oldest. Sentences alone may be 384."""

LEDGER_BOUND: Final = 0.0
"""J: the least that a ledger's margin may be; its bound is -V(psi_0) = 0, less what lateness may put in."""

LEDGER_ROUNDING: Final = 1e-9
"""The largest rounding error of a long session's sums, J, of ledgers and of interface accounts."""


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
        since: when it was first seen.
        cleared: when its cause was last seen, if it is gone; None while it lasts.
    """

    key: str
    level: AlarmLevel
    text: str
    advice: str
    since: Instant
    cleared: Instant | None = None


@dataclass(frozen=True)
class AlarmCause:
    """A cause that is present now, and raises an alarm; ``lasting`` if it cannot be undone."""

    key: str
    level: AlarmLevel
    text: str
    advice: str
    lasting: bool = False


_AWAY: Final = "See the log of the node; a session with faults: {restarts: N} brings it back by itself."
_NODE_ADVICE: Final = {
    Health.AWAY: _AWAY,
    Health.SILENT: "Its process runs but sends nothing: see whether it hangs or the machine is overloaded.",
    Health.LATE: "The machine is too slow for the period: run manyhands doctor, and close other programs.",
}
_NODE_TEXT: Final = {
    Health.SILENT: "no telemetry has come from it for a while",
    Health.LATE: "more of its ticks are late than is usual on any machine",
}
_NODE_LEVEL: Final = {Health.AWAY: AlarmLevel.FAULT, Health.SILENT: AlarmLevel.FAULT, Health.LATE: AlarmLevel.WARNING}


def causes(scene: Scene, now: Instant) -> Iterator[AlarmCause]:
    """Every cause that is present in this scene, in no order of severity."""
    yield from _sentences(scene)
    for node in scene.nodes.values():
        yield from _of_node(node)
        yield from _ledger(node)
        yield from _account(node, scene)
    if scene.frozen:
        yield AlarmCause(
            "frozen",
            AlarmLevel.WARNING,
            f"{scene.frozen} of the session's couplings {'is' if scene.frozen == 1 else 'are'} frozen",
            "Their users take no part until their signals come in time again; the others go on, still certified.",
        )
    for name, late in scene.frozen_late.items():
        advice = "Check its user's machine and network; if they cannot be faster, design for a longer tau."
        yield AlarmCause(f"{name} late", AlarmLevel.WARNING, late.sentence(name), advice, True)
    yield from _unheard(scene, now)


def _sentences(scene: Scene) -> Iterator[AlarmCause]:
    condition = scene.condition
    if condition is None:
        return
    for text in condition.faults:
        yield AlarmCause(
            f"fault: {text}", AlarmLevel.FAULT, text, "The run counts as failed: see its report and logs.", True
        )
    for text in condition.notices:
        advice = "An assumption of the certificate was broken: what it proves does not cover this."
        yield AlarmCause(f"notice: {text}", AlarmLevel.WARNING, text, advice, True)
    for text in condition.incidents:
        yield AlarmCause(f"incident: {text}", AlarmLevel.NOTE, text, "Nothing: the session survived it.", True)


def _of_node(node: NodeScene) -> Iterator[AlarmCause]:
    level = _NODE_LEVEL.get(node.health)
    if level is None or node.state == "leaving":
        return
    text = _NODE_TEXT.get(node.health, node.state)
    yield AlarmCause(f"{node.name} {node.health}", level, f"{node.name}: {text}", _NODE_ADVICE[node.health])


def _ledger(node: NodeScene) -> Iterator[AlarmCause]:
    margin = node.figures.get(names.LEDGER_MARGIN, 0.0)
    if margin < LEDGER_BOUND - LEDGER_ROUNDING:
        yield AlarmCause(
            f"{node.name} ledger",
            AlarmLevel.FAULT,
            f"{node.name}: its ledger fell {-margin:.3g} J below its bound",
            "It broke its promise of passivity: let go of it, and check that it is as passive as declared (osp).",
        )


def _account(node: NodeScene, scene: Scene) -> Iterator[AlarmCause]:
    certificate, least = scene.about.certificate, node.figures.get(names.INTERFACE_LEAST, 0.0)
    if certificate is None or not least < -certificate.tank - LEDGER_ROUNDING:
        return
    lateness = f"{node.name}: lateness has put {-least:.3g} J into the loop, more than the {certificate.tank:.3g} J"
    if certificate.bounded:
        text = f"{lateness} that its interface has to keep to"
        advice = "See whether its process was stopped or its clock changed; if not, report it: the bound is proved."
    else:
        text = f"{lateness} of faults.tank; it is counted and not bounded"
        advice = "Let the device bound it (faults: {lateness: enforce}), or design for a longer tau (design.tau: auto)."
    yield AlarmCause(f"{node.name} account", AlarmLevel.FAULT, text, advice)


def _unheard(scene: Scene, now: Instant) -> Iterator[AlarmCause]:
    received = [node.received for node in scene.nodes.values() if node.received is not None]
    over = scene.condition is not None and scene.condition.phase in ("ending", "over")
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
        self._seen: dict[str, Instant] = {}
        self._lasting: set[str] = set()
        self.version = 0

    def look(self, scene: Scene, now: Instant) -> None:
        """Raise and clear alarms, as the scene at ``now`` requires."""
        for cause in causes(scene, now):
            self._seen[cause.key] = now
            standing = self._alarms.get(cause.key)
            if standing is None or standing.cleared is not None:
                self._alarms.pop(cause.key, None)  # raised again: a new alarm, at the end
                self._put(Alarm(cause.key, cause.level, cause.text, cause.advice, now))
                if cause.lasting:
                    self._lasting.add(cause.key)
            elif standing.text != cause.text:
                self._put(replace(standing, text=cause.text))
        for key, alarm in list(self._alarms.items()):
            if alarm.cleared is None and key not in self._lasting and now - self._seen[key] > HOLD:
                self._put(replace(alarm, cleared=self._seen[key]))
        self._forget()

    def listed(self) -> list[Alarm]:
        """The alarms that last, the gravest first, then the cleared ones; within each severity the latest first."""

        def order(alarm: Alarm) -> tuple[bool, int, int]:
            return alarm.cleared is not None, -_GRAVITY[alarm.level], -alarm.since

        return sorted(self._alarms.values(), key=order)

    def _put(self, alarm: Alarm) -> None:
        self._alarms[alarm.key] = alarm
        self.version += 1

    def _forget(self) -> None:
        for alarm in [] if len(self._alarms) <= MOST_ALARMS else self.listed()[MOST_ALARMS:]:
            del self._alarms[alarm.key], self._seen[alarm.key]
            self._lasting.discard(alarm.key)
