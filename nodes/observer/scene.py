"""What a running session says of itself to whoever may enter its directory: who takes part, in what world, how surely.

One JSON file, written by the supervisor before its nodes are started. What changes while the session runs comes from
its broadcast (:mod:`manyhands.protocol.transport.broadcast`); what is here does not change. It holds no key and no
block of V.

What somebody who looks on knows of a running session: a state that frames of its broadcast are taken into. Pure.

Who shows it (a table, a page, a line a tick) reads it; nothing here waits, prints or knows of sockets.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, Final

from manyhands.design.files import read_regular, replacing
from manyhands.nodes import telemetry as names
from manyhands.protocol.clock import Instant, from_seconds
from manyhands.protocol.codec import decode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import Condition, Observation, Role

ABOUT: Final = "about.json"
"""The file's name in the session's directory."""

MAX_ABOUT_BYTES: Final = 16 * 2**20

_LATEST: Final = 2.5e11  # the end of the year 9891: what calendars can show


class AboutError(Exception):
    """A session's description cannot be read; names the file and what is wrong."""


@dataclass(frozen=True)
class NodeAbout:
    """A node: its role, its ports in the order of its traces, and the node whose process it shares, if it does."""

    role: Role
    ports: tuple[str, ...]
    process: str | None = None


@dataclass(frozen=True)
class LinkAbout:
    """A link: its two ends, the one nearer to a hand first, and its ports."""

    ends: tuple[str, str]
    ports: tuple[str, ...]


@dataclass(frozen=True)
class SpringAbout:
    """A spring and a damper of the virtual world, between two ports, masses or the ground: N/m and N*s/m."""

    ends: tuple[str, str]
    stiffness: float
    damping: float


@dataclass(frozen=True)
class CertificateAbout:
    """What the session's certificate says: delay that it covers (s), margins by condition, levels, rungs of its ladder.

    Attributes:
        tau: longest delay inside the tick, s.
        margins: by condition, N*s/m.
        gamma: proved level of the transparency objective, or None.
        delta_D: the least eigenvalue of each device's level, N*s/m.
        ladder: delays that further rungs cover, s.
        enforced: parties whose promise a controller keeps at run time, and no proof.
    """

    tau: float
    margins: Mapping[str, float]
    gamma: float | None
    delta_D: Mapping[str, float]
    ladder: tuple[float, ...]
    enforced: tuple[str, ...]


@dataclass(frozen=True)
class About:
    """A session, as it was started.

    Attributes:
        session: its name.
        id: id of its certificate, or of the uncertified session.
        pid: its supervisor's process id.
        clock: "realtime" or "simulated".
        transport: "ipc" or "tcp".
        period: T, s.
        ticks: how many it runs; 0 for no end.
        started: seconds since 1970.
        nodes: by name, devices first, then couplings, then the environment.
        links: in the session's order.
        masses: of the virtual world, kg by name; empty where it is no network.
        springs: of the virtual world; likewise.
        grips: devices that a person's browser can hold.
        reach: of each port's device, the greatest displacement, m.
        certificate: None for a session that nothing proves.
        environment: the environment's type.
        observers: by name what each may read, as in the session.
    """

    session: str
    id: str
    pid: int
    clock: str
    transport: str
    period: float
    ticks: int
    started: float
    nodes: Mapping[str, NodeAbout]
    links: tuple[LinkAbout, ...]
    masses: Mapping[str, float]
    springs: tuple[SpringAbout, ...]
    grips: tuple[str, ...]
    reach: Mapping[str, float]
    certificate: CertificateAbout | None
    environment: str
    observers: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def as_plain(self) -> dict[str, Any]:
        """As JSON has it."""
        return dataclasses.asdict(self)

    def save(self, directory: Path) -> None:
        """Write it into the session's directory, for its user alone (mode 0600), whole or not at all.

        Raises:
            OSError: it cannot be written.
        """
        with replacing(directory / ABOUT, mode=0o600) as file:
            file.write(json.dumps(self.as_plain(), allow_nan=False).encode())

    @classmethod
    def load(cls, directory: Path) -> About:
        """Read it from a session's directory.

        Raises:
            AboutError: not readable, or no such description.
        """
        path = directory / ABOUT
        try:
            return _about(json.loads(read_regular(path, MAX_ABOUT_BYTES)))
        except OSError as error:
            raise AboutError(f"{path}: cannot be read: {error.strerror}") from error
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            raise AboutError(
                f"{path}: found no session's description ({type(error).__name__}); expected one of this version"
            ) from error


_SCALARS: Final[Mapping[str, type | tuple[type, ...]]] = {
    "session": str,
    "id": str,
    "pid": int,
    "clock": str,
    "transport": str,
    "period": (int, float),
    "ticks": int,
    "started": (int, float),
    "environment": str,
}
"""What is neither a list nor a map, and of what type it is."""


def _about(data: Any) -> About:
    certificate = data["certificate"]
    nodes = {
        _text(name): NodeAbout(Role(node["role"]), _texts(node["ports"]), _known(node["process"], data["nodes"]))
        for name, node in data["nodes"].items()
    }
    about = About(
        **{
            **data,
            "nodes": nodes,
            "links": tuple(LinkAbout(_two(link["ends"]), _texts(link["ports"])) for link in data["links"]),
            "masses": _numbers(data["masses"]),
            "springs": tuple(
                SpringAbout(_two(spring["ends"]), _number(spring["stiffness"]), _number(spring["damping"]))
                for spring in data["springs"]
            ),
            "grips": _texts(data["grips"]),
            "reach": _numbers(data["reach"]),
            "certificate": None if certificate is None else _certificate(certificate),
            "observers": {_text(name): _texts(reads) for name, reads in data["observers"].items()},
        }
    )
    for name, kind in _SCALARS.items():
        if not isinstance(data[name], kind) or isinstance(data[name], bool):
            raise TypeError(f"{name}: found {data[name]!r}")
    if not (0.0 < about.period < math.inf and 0 <= about.started < _LATEST and about.pid > 0 and about.ticks >= 0):
        raise ValueError("found a period, an instant, a process id or a number of ticks that there cannot be")
    for link in about.links:
        for name in link.ends:
            _known(name, nodes)
    return about


def _certificate(data: Any) -> CertificateAbout:
    gamma = data["gamma"]
    return CertificateAbout(
        **{
            **data,
            "tau": _number(data["tau"]),
            "margins": _numbers(data["margins"]),
            "gamma": None if gamma is None else _number(gamma),
            "delta_D": _numbers(data["delta_D"]),
            "ladder": tuple(map(_number, data["ladder"])),
            "enforced": _texts(data["enforced"]),
        }
    )


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError(f"found {value!r}; expected a text")
    return value


def _texts(values: Any) -> tuple[str, ...]:
    if not isinstance(values, list):
        raise TypeError(f"found {values!r}; expected a list")
    return tuple(map(_text, values))


def _number(value: Any) -> float:
    if not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value):
        raise TypeError(f"found {value!r}; expected a number")
    return value


def _numbers(values: Any) -> dict[str, float]:
    return {_text(name): _number(value) for name, value in values.items()}


def _known(name: Any, nodes: Mapping[str, Any]) -> Any:
    """A node's name, or None, which is nobody's."""
    if name is not None and name not in nodes:
        raise ValueError(f"found {name!r}; expected a node")
    return name


def _two(ends: Any) -> tuple[str, str]:
    first, second = _texts(ends)
    return first, second


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
        malformed: frames that were nothing of a broadcast's.
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
    def frozen_late(self) -> dict[str, names.CouplingLateness]:
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
