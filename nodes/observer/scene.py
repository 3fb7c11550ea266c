"""A running session as an observer sees it: its description (:class:`About`), and its changing state (:class:`Scene`).

The description is one JSON file in the session's directory, which the supervisor writes before it starts the nodes. It
lists the nodes, the virtual world and the certificate, and does not change. It holds no key and no block of V.

The state is pure: it takes in the frames of the session's broadcast
(:mod:`manyhands.protocol.transport.broadcast`). Tables, the page and the printed lines read it; nothing here waits,
prints or uses a socket.
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

_LATEST: Final = 2.5e11  # the end of the year 9891, about the last that calendars can show


class AboutError(Exception):
    """A session's description cannot be read; the message names the file and the reason."""


@dataclass(frozen=True)
class NodeAbout:
    """A node: its role, its ports in the order of its traces, and the node whose process it shares, or None."""

    role: Role
    ports: tuple[str, ...]
    process: str | None = None


@dataclass(frozen=True)
class LinkAbout:
    """A link: its two ends, the end nearer to a hand first, and its ports."""

    ends: tuple[str, str]
    ports: tuple[str, ...]


@dataclass(frozen=True)
class SpringAbout:
    """A spring (N/m) and a damper (N*s/m) of the virtual world, between two of its ports, masses and the ground."""

    ends: tuple[str, str]
    stiffness: float
    damping: float


@dataclass(frozen=True)
class CertificateAbout:
    """The figures of the session's certificate.

    Attributes:
        tau: the longest delay inside the tick that it covers, s.
        margins: the margin of each condition, N*s/m.
        gamma: the proved level of the transparency objective, or None.
        delta_D: by device, the least eigenvalue of its level, N*s/m.
        ladder: the delays that further rungs cover, s.
        enforced: the parties whose promise a controller keeps at run time in place of a proof.
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
        ticks: the number of ticks that it runs; 0 for no end.
        started: the time of its start, s since 1970.
        nodes: the nodes by name: devices, then couplings, then the environment.
        links: the links, in the session's order.
        masses: the masses of the virtual world by name, kg; empty where it is no network.
        springs: the springs of the virtual world; empty where it is no network.
        grips: the devices that a person's browser can hold.
        reach: by port, the greatest displacement of its device, m.
        certificate: the certificate; None for an uncertified session.
        environment: the environment's type.
        observers: by observer, the nodes that it may read.
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
        """The description in the form that JSON writes."""
        return dataclasses.asdict(self)

    def save(self, directory: Path) -> None:
        """Write the file into the session's directory as a whole, readable by its user alone (mode 0600).

        Raises:
            OSError: the file cannot be written.
        """
        with replacing(directory / ABOUT, mode=0o600) as file:
            file.write(json.dumps(self.as_plain(), allow_nan=False).encode())

    @classmethod
    def load(cls, directory: Path) -> About:
        """Read the file in a session's directory.

        Raises:
            AboutError: the file cannot be read, or is no description.
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
"""The entries that are neither lists nor maps, with their types."""


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
        raise ValueError("found a period, an instant, a process id or a number of ticks that is out of range")
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
    """``name``, which must be one of ``nodes``, or None."""
    if name is not None and name not in nodes:
        raise ValueError(f"found {name!r}; expected a node")
    return name


def _two(ends: Any) -> tuple[str, str]:
    first, second = _texts(ends)
    return first, second


RATE_OVER: Final = from_seconds(0.5)
"""The shortest time over which a rate is taken: telemetry comes ten times a second."""

LATE_SHARE: Final = 0.01
"""The share of late ticks between two looks above which a node's health is LATE."""


class Health(StrEnum):
    """The health of a node, a link or the session, in the order of severity."""

    OK = "ok"
    WAITING = "waiting"  # it has not begun, or has nothing more to do
    LATE = "late"  # more of its ticks are late than any machine has now and then
    FROZEN = "frozen"  # it takes no part, and the others go on
    SILENT = "silent"  # its process runs, and sends nothing
    AWAY = "away"  # its process died, or failed


_SEVERITY: Final = {health: place for place, health in enumerate(Health)}

STATE_HEALTH: Final = {
    "running": Health.OK,
    "lost": Health.AWAY,
    "gone for good": Health.AWAY,
    "failed": Health.AWAY,
    "leaving": Health.AWAY,
}
"""The health of a node in each state of the supervisor; every other state means WAITING."""


@dataclass
class NodeScene:
    """The present figures of one node.

    Attributes:
        name: the node's name.
        role: the node's role.
        state: its state, in the supervisor's words; empty before the first condition.
        tick: the tick after the latest of its telemetry.
        rate: its ticks a second; None before two looks.
        figures: the figures of its latest telemetry.
        heard: when that telemetry came; None before any.
        late: whether more than :data:`LATE_SHARE` of its latest ticks were late.
        silent: whether the supervisor has received nothing of it for a while, though it runs.
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
        """The node's health, by its state, silence and late ticks."""
        health = STATE_HEALTH.get(self.state, Health.WAITING)
        if health is not Health.OK:
            return health
        if self.silent:
            return Health.SILENT
        return Health.LATE if self.late else Health.OK

    def take(self, told: Observation, now: Instant) -> None:
        """Take in the node's telemetry, which came at ``now``."""
        late = told.figures.get(names.LATE, 0.0)
        # the first telemetry of a process begins a new rate: a new process counts late ticks from 0
        if self._since is None or told.tick < self.tick or late < self._since[2]:
            self._since, self.rate, self.late = (now, told.tick, late), None, False
        since, tick, late_then = self._since
        if now - since >= RATE_OVER:
            done = told.tick - tick
            self.rate = done * 1e9 / (now - since)
            self.late = late - late_then > LATE_SHARE * max(done, 1)
            self._since = now, told.tick, late
        self.tick, self.figures, self.heard = told.tick, dict(told.figures), now

    def stand(self, state: str, silent: bool) -> None:
        """Take in the supervisor's ``state`` of the node; a node that does not run or is silent has no rate."""
        self.state, self.silent = state, silent
        if STATE_HEALTH.get(state) is not Health.OK or silent:
            self._since, self.rate, self.late = None, None, False


class Scene:
    """The present state of a session.

    Attributes:
        about: the session's description, which does not change.
        nodes: every node by name, in the session's order.
        condition: the supervisor's latest condition; None before any.
        malformed: frames that were no message of this session's broadcast.
    """

    def __init__(self, about: About) -> None:
        """No frame has come yet."""
        self.about = about
        self.nodes = {name: NodeScene(name, node.role) for name, node in about.nodes.items()}
        self.condition: Condition | None = None
        self.malformed = 0

    def take(self, frame: bytes, now: Instant) -> Observation | Condition | None:
        """Take in a frame that came at ``now``; returns its message, or None if it is none of this session."""
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
        """The latest tick of any node's telemetry."""
        return max((node.tick for node in self.nodes.values()), default=0)

    @property
    def rate(self) -> float | None:
        """The environment's ticks a second, which are the session's; None before they are known."""
        rates = [node.rate for node in self.nodes.values() if node.role is Role.ENVIRONMENT]
        return rates[0] if rates else None

    @property
    def frozen(self) -> int:
        """The number of couplings that are not active now, by the environment's figures; 0 for a senseless figure."""
        told = (n.figures.get(names.FROZEN, 0.0) for n in self.nodes.values() if n.role is Role.ENVIRONMENT)
        return round(sum(value for value in told if 0.0 < value < math.inf))

    @property
    def frozen_late(self) -> dict[str, names.CouplingLateness]:
        """The couplings that were frozen for being late, by the environment's figures."""
        worlds = (node.figures for node in self.nodes.values() if node.role is Role.ENVIRONMENT)
        late = [item for told in worlds for item in names.lateness_by_coupling(told, told).items()]
        return {name: lateness for name, lateness in late if lateness.frozen}

    @property
    def health(self) -> Health:
        """The health of the session: that of its worst node, and at least FROZEN where any coupling is frozen."""
        worst = max((node.health for node in self.nodes.values()), key=_SEVERITY.__getitem__, default=Health.WAITING)
        return max(worst, Health.FROZEN, key=_SEVERITY.__getitem__) if self.frozen else worst

    def link_health(self, link: LinkAbout) -> Health:
        """The health of a link: the worse of its two ends."""
        return max((self.nodes[end].health for end in link.ends), key=_SEVERITY.__getitem__)
