"""The alarms of a running session: what a person should know at once, since when, and what to do about it. Pure.

An alarm is raised when its cause is first seen, and cleared when the cause has been away for a while. So a cause that
comes and goes with every telemetry is one alarm, and not ten a second. Notices, incidents and faults of the session
have happened, and are not cleared.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Final

from manyhands.nodes import telemetry as names
from manyhands.nodes.observer.scene import Health, NodeScene, Scene
from manyhands.protocol.clock import Instant, from_seconds
from manyhands.protocol.messages import Role

HOLD: Final = from_seconds(2.0)
"""How long a cause must be away before its alarm is cleared."""

UNHEARD: Final = from_seconds(3.0)
"""How long a session that is not over may be silent before an alarm is raised."""

MOST_ALARMS: Final = 1000
"""The most alarms kept. Of more, the cleared ones go first, then the oldest. Sentences alone may be 384."""

LEDGER_BOUND: Final = 0.0
"""The bound of every party's ledger, -V(psi_0), J: 0, for all parties start at rest."""

LEDGER_ROUNDING: Final = 1e-9
"""The greatest error of a ledger's sum in a long session, J."""


class AlarmLevel(StrEnum):
    """The gravity of an alarm, in rising order."""

    NOTE = "note"  # the session withstood what happened
    WARNING = "warning"  # an assumption of the certificate is broken, or a user takes no part
    FAULT = "fault"  # a promise is broken, or a part of the session is gone


@dataclass(frozen=True)
class Alarm:
    """An alarm that is raised or was cleared.

    Attributes:
        key: names its cause; there is one alarm for a key at a time.
        level: its gravity.
        text: a sentence that states the cause.
        advice: what a person can do about it.
        since: when its cause was first seen.
        cleared: when its cause was last seen, for a cleared alarm; None while the alarm stands.
    """

    key: str
    level: AlarmLevel
    text: str
    advice: str
    since: Instant
    cleared: Instant | None = None


@dataclass(frozen=True)
class AlarmCause:
    """A present cause of an alarm; ``lasting`` if it cannot be undone, so that its alarm is never cleared."""

    key: str
    level: AlarmLevel
    text: str
    advice: str
    lasting: bool = False


_AWAY: Final = "See the log of the node; a session with faults: {restarts: N} brings it back by itself."
_NODE_ADVICE: Final = {
    Health.AWAY: _AWAY,
    Health.SILENT: "Its process runs and sends nothing: see whether it hangs or the machine is overloaded.",
    Health.LATE: "The machine is too slow for the period: run manyhands doctor, and close other programs.",
}
_NODE_TEXT: Final = {
    Health.SILENT: "it has sent nothing for a while",
    Health.LATE: "more of its ticks are late than a machine has now and then",
}
_NODE_LEVEL: Final = {Health.AWAY: AlarmLevel.FAULT, Health.SILENT: AlarmLevel.FAULT, Health.LATE: AlarmLevel.WARNING}


def causes(scene: Scene, now: Instant) -> Iterator[AlarmCause]:
    """The causes of alarms in this scene at ``now``, in no order of gravity."""
    yield from _told(scene)
    for node in scene.nodes.values():
        yield from _of_node(node)
        yield from _ledger(node)
        yield from _tau(node, scene)
    if scene.frozen:
        yield AlarmCause(
            "frozen",
            AlarmLevel.WARNING,
            f"{scene.frozen} of the session's couplings {'is' if scene.frozen == 1 else 'are'} frozen",
            "Their users take no part until their signals come in time again; the others go on, still certified.",
        )
    for name, late in scene.frozen_late.items():
        advice = "See what its user's machine or network does; design for a longer tau where that is all it can do."
        yield AlarmCause(f"{name} late", AlarmLevel.WARNING, late.sentence(name), advice, True)
    yield from _unheard(scene, now)


def _told(scene: Scene) -> Iterator[AlarmCause]:
    said = scene.condition
    if said is None:
        return
    for text in said.faults:
        yield AlarmCause(
            f"fault: {text}", AlarmLevel.FAULT, text, "It ends the session; see the report and the logs.", True
        )
    for text in said.notices:
        advice = "An assumption of the certificate was broken, so its proof does not cover what happened then."
        yield AlarmCause(f"notice: {text}", AlarmLevel.WARNING, text, advice, True)
    for text in said.incidents:
        yield AlarmCause(f"incident: {text}", AlarmLevel.NOTE, text, "Nothing: the session withstood it.", True)


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
            f"{node.name}: its ledger fell to {margin:.3g} J, below its bound of {LEDGER_BOUND:g} J",
            "It broke its promise of passivity: let go of it, and see whether it is as passive as declared (osp).",
        )


def covered_tau(scene: Scene, device: str) -> float:
    """The delay (s) that the certificate covers for a device now: the least of the rungs of its couplings."""
    certificate = scene.about.certificate
    if certificate is None:
        return 0.0
    taus = (certificate.tau, *certificate.ladder)
    couplings = [
        scene.nodes[end]
        for link in scene.about.links
        if device in link.ends
        for end in link.ends
        if end in scene.nodes and scene.nodes[end].role is Role.COUPLING
    ]
    rungs = (round(coupling.figures.get(names.RUNG, 0.0)) for coupling in couplings)
    return min((taus[max(0, min(rung, len(taus) - 1))] for rung in rungs), default=certificate.tau)


def _tau(node: NodeScene, scene: Scene) -> Iterator[AlarmCause]:
    certificate = scene.about.certificate
    if node.role is not Role.DEVICE or certificate is None or scene.about.clock != "realtime":
        return
    worst, covered = node.figures.get(names.TAU_WORST, 0.0), covered_tau(scene, node.name) * 1e6
    if worst > covered:
        yield AlarmCause(
            f"{node.name} tau",
            AlarmLevel.WARNING,
            f"{node.name}: its force came later than the {covered:.4g} us that the certificate covers",
            "Run manyhands doctor; design for a longer tau, or with a ladder and faults: breach: soften.",
        )


def _unheard(scene: Scene, now: Instant) -> Iterator[AlarmCause]:
    heard = [node.heard for node in scene.nodes.values() if node.heard is not None]
    over = scene.condition is not None and scene.condition.phase in ("ending", "over")
    if heard and not over and now - max(heard) > UNHEARD:
        yield AlarmCause(
            "unheard",
            AlarmLevel.FAULT,
            "the whole session has sent nothing for a while",
            "The picture is old: see whether the supervisor is stopped or the machine is overloaded.",
        )


_GRAVITY: Final = {level: place for place, level in enumerate(AlarmLevel)}


class Alarms:
    """The alarms of a session.

    Attributes:
        version: changes whenever :meth:`listed` changes.
    """

    def __init__(self) -> None:
        """No alarm yet."""
        self._alarms: dict[str, Alarm] = {}
        self._seen: dict[str, Instant] = {}
        self._lasting: set[str] = set()
        self.version = 0

    def look(self, scene: Scene, now: Instant) -> None:
        """Raise and clear alarms by the causes in ``scene`` at ``now``."""
        for cause in causes(scene, now):
            self._seen[cause.key] = now
            standing = self._alarms.get(cause.key)
            if standing is None or standing.cleared is not None:
                self._alarms.pop(cause.key, None)  # raised again, so it is a new alarm, at the end
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
        """The alarms that stand, the gravest first, then the cleared ones; of equal gravity the latest first."""

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
