"""What somebody who looks on knows of a running session: a state that frames of its gallery are taken into. Pure.

Who shows it (a table, a page, a line a tick) reads it; nothing here waits, prints or knows of sockets.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final

from manyhands.nodes import telemetry as names
from manyhands.nodes.observer.about import About, LinkAbout
from manyhands.protocol.clock import Instant, from_seconds
from manyhands.protocol.codec import decode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import Condition, Observation, Role

RATE_OVER: Final = from_seconds(0.5)
"""The shortest time that a rate is taken over: telemetry comes ten times a second."""

LATE_SHARE: Final = 0.01
"""Of the ticks between two looks, so many late ones make a node's health LATE."""


class Health(StrEnum):
    """How a node or a link is, at a glance; the worse the later."""

    OK = "ok"
    WAITING = "waiting"  # it has not begun, or has nothing more to do
    LATE = "late"  # more of its ticks are late than every machine has now and then
    FROZEN = "frozen"  # it takes no part, and others go on
    SILENT = "silent"  # it runs, and nothing is heard of it
    AWAY = "away"  # it died, or failed


_SEVERITY: Final = {health: place for place, health in enumerate(Health)}

STATE_HEALTH: Final = {
    "running": Health.OK,
    "lost": Health.AWAY,
    "gone for good": Health.AWAY,
    "failed": Health.AWAY,
    "leaving": Health.AWAY,
}
"""What a node's state says of its health; every other state is one of waiting."""


@dataclass
class NodeScene:
    """What is known of one node.

    Attributes:
        name: the node's.
        role: the node's.
        state: where it stands, in the supervisor's words; empty before anything was heard.
        tick: the latest it told of.
        rate: its ticks a second; None before two looks.
        figures: of its latest telemetry.
        heard: when that came; None if none has.
        late: whether more of its ticks than usual were late lately.
        silent: whether the supervisor has not heard of it for a while, though it runs.
    """

    name: str
    role: Role
    state: str = ""
    tick: int = 0
    rate: float | None = None
    figures: dict[str, float] = field(default_factory=dict)
    heard: Instant | None = None
    late: bool = False
    silent: bool = False
    _since: tuple[Instant, int, float] | None = None

    @property
    def health(self) -> Health:
        """How it is."""
        health = STATE_HEALTH.get(self.state, Health.WAITING)
        if health is not Health.OK:
            return health
        if self.silent:
            return Health.SILENT
        return Health.LATE if self.late else Health.OK

    def take(self, told: Observation, now: Instant) -> None:
        """Its latest telemetry."""
        late = told.figures.get(names.LATE, 0.0)
        if self._since is None or told.tick < self.tick or late < self._since[2]:  # the first, or of a new process
            self._since, self.rate, self.late = (now, told.tick, late), None, False
        since, tick, late_then = self._since
        if now - since >= RATE_OVER:
            done = told.tick - tick
            self.rate = done * 1e9 / (now - since)
            self.late = late - late_then > LATE_SHARE * max(done, 1)
            self._since = now, told.tick, late
        self.tick, self.figures, self.heard = told.tick, dict(told.figures), now

    def stand(self, state: str, silent: bool) -> None:
        """Where the supervisor sees it; whoever does not run, or says nothing, has no rate."""
        self.state, self.silent = state, silent
        if STATE_HEALTH.get(state) is not Health.OK or silent:
            self._since, self.rate, self.late = None, None, False


class Scene:
    """A session as it is seen.

    Attributes:
        about: what does not change.
        nodes: every node, in the session's order.
        condition: the latest that the supervisor has said; None before it has.
        malformed: frames that were nothing of a gallery's.
    """

    def __init__(self, about: About) -> None:
        """Nothing has been seen yet."""
        self.about = about
        self.nodes = {name: NodeScene(name, node.role) for name, node in about.nodes.items()}
        self.condition: Condition | None = None
        self.malformed = 0

    def take(self, frame: bytes, now: Instant) -> Observation | Condition | None:
        """Take in a frame that came at ``now``; returns what it was, None if it was nothing of this session's."""
        message = decode(frame, MAX_CONTROL_BYTES)
        match message:
            case Observation(node) if node in self.nodes:
                self.nodes[node].take(message, now)
                return message
            case Condition():
                self.condition = message
                for name, seen in self.nodes.items():
                    seen.stand(message.states.get(name, ""), name in message.silent)
                return message
            case _:
                self.malformed += 1
                return None

    @property
    def tick(self) -> int:
        """The latest tick that any node told of."""
        return max((node.tick for node in self.nodes.values()), default=0)

    @property
    def rate(self) -> float | None:
        """Ticks a second of the environment, whose ticks are the session's; None before it is known."""
        rates = [node.rate for node in self.nodes.values() if node.role is Role.ENVIRONMENT]
        return rates[0] if rates else None

    @property
    def frozen(self) -> int:
        """Couplings that are frozen now, as the environment says; what is no number of couplings counts as none."""
        told = (n.figures.get(names.FROZEN, 0.0) for n in self.nodes.values() if n.role is Role.ENVIRONMENT)
        return round(sum(value for value in told if 0.0 < value < math.inf))

    @property
    def frozen_late(self) -> dict[str, names.Lateness]:
        """Couplings that were frozen because the others waited for them again and again, as the environment says."""
        worlds = (node.figures for node in self.nodes.values() if node.role is Role.ENVIRONMENT)
        late = [item for told in worlds for item in names.lateness_by_coupling(told, told).items()]
        return {name: lateness for name, lateness in late if lateness.frozen}

    @property
    def health(self) -> Health:
        """How the session is: as its worst node, and FROZEN where any coupling is."""
        worst = max((node.health for node in self.nodes.values()), key=_SEVERITY.__getitem__, default=Health.WAITING)
        return max(worst, Health.FROZEN, key=_SEVERITY.__getitem__) if self.frozen else worst

    def link_health(self, link: LinkAbout) -> Health:
        """How a link is: as the worse of its two ends."""
        return max((self.nodes[end].health for end in link.ends), key=_SEVERITY.__getitem__)
