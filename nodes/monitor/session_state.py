"""The state of a running session as an observer sees it: pure, apart from reading and writing one file.

:class:`About` describes what does not change: nodes, links, virtual world and certificate. The supervisor writes it as
one JSON file into the run's directory before the nodes start. It holds no key and no block of V.

:class:`LiveSession` takes in the frames of the session's broadcast (:mod:`manyhands.protocol.transport.broadcast`) and
holds what changes: phase, ticks, rates, health. A table, a page or a line shows it; nothing here waits, prints or knows
of sockets.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Final

from manyhands.design.files import read_regular, replacing
from manyhands.design.models.axis import AxisKind, Units, kinds_of
from manyhands.design.models.contacts import coordinates
from manyhands.design.models.scene import ContactScene, geometry_of
from manyhands.nodes.environment.drawing import WorldDrawing
from manyhands.nodes.kernel.bundle import REALTIME
from manyhands.nodes.kernel.driver_statement import DriverWord
from manyhands.nodes.monitor.health import (
    AWAY_STATES,
    FREE_STATE,
    Health,
    PromiseState,
    readable,
    session_health,
    worse,
)
from manyhands.nodes.monitor.health_model import Terms
from manyhands.nodes.rows import figures as names
from manyhands.nodes.rows.own_ticks import session_tick
from manyhands.nodes.rows.promises import Promise
from manyhands.nodes.rows.tick_events import Kind, events_in
from manyhands.nodes.wave_link.felt import FeltLink, felt_link
from manyhands.protocol.channels import Topic, hands_at, links_at, topics_of
from manyhands.protocol.clock import Instant, from_seconds
from manyhands.protocol.codec import Received, decode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import Condition, Figures, Observation, PromiseStatus, Role
from manyhands.protocol.plain import Added, PlainForm, Requirement, read, shown, written

ABOUT: Final = "about.json"
"""The file's name in the run's directory."""

MAX_ABOUT_BYTES: Final = 16 * 2**20

_LATEST: Final = 2.5e11  # seconds since 1970, in the year 9892: calendars can show no later one
_INSTANT: Final = Requirement(lambda t: 0.0 <= t < _LATEST, "seconds since 1970")
PERIOD: Final = Requirement(lambda T: T > 0.0, "a time greater than 0")
_PID: Final = Requirement(lambda pid: pid > 0, "a process id")
_COUNT: Final = Requirement(lambda count: count >= 0, "a number of at least 0")


def _geometry(data: Any) -> ContactScene:
    try:
        return geometry_of(data)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise ValueError(f"found a scene that is none ({error}); expected tools and bodies") from error


GEOMETRY: Final = PlainForm(lambda scene: None if scene is None else scene.geometry_terms(), _geometry)
"""A scene's tools, bodies and obstacles, without its springs and motions."""


class AboutError(Exception):
    """A session's description cannot be read; the message names the file and what is wrong."""


@dataclass(frozen=True)
class NodeAbout:
    """A node.

    Attributes:
        role: of the node.
        ports: in the order of its traces.
        process: the node whose process it shares; None for a process of its own.
        wall: whether it is a device in wall time, which reports more topics than one in its own.
        period: its T, s, where it has one of its own; None for the session's.
        impedance: the least and the greatest eigenvalue of b, N*s/m, of a coupling with a wave link; None for others.
        driver: of a device that a driver of another package moves; None for others.
        torques: whether it is a device whose motors hold torques; in wall time it reports their work.
    """

    role: Role
    ports: tuple[str, ...]
    process: str | None = None
    wall: bool = False
    period: Annotated[float, PERIOD] | None = None
    impedance: tuple[float, float] | None = None
    driver: Added[DriverWord | None] = None
    torques: Added[bool] = False


@dataclass(frozen=True)
class LinkAbout:
    """A link: its two ends, the one nearer to the user first, and its ports."""

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
    """The main figures of the session's certificate.

    Attributes:
        tau: the longest delay inside the tick that it covers, s.
        margins: by condition, N*s/m.
        gamma: proved level of the transparency objective, or None.
        delta_D: the least eigenvalue of each device's level, N*s/m.
        ladder: the delays that the further rungs cover, s.
        enforced: parties whose level is enforced at run time instead of proved.
        tank: E_0, what lateness may put in through each device in wall time at once, J.
        power: P, what it may put in besides for as long as it likes, W.
        bounded: whether the devices keep to that bound; otherwise lateness is counted alone.
        taus: the longest delay by device, s, in a session with wave links, whose sites have certificates of their own;
            ``tau`` is then the shortest of them.
    """

    tau: float
    margins: Mapping[str, float]
    gamma: float | None
    delta_D: Mapping[str, float]
    ladder: tuple[float, ...]
    enforced: tuple[str, ...]
    tank: float
    bounded: bool
    taus: Mapping[str, float] = field(default_factory=dict)
    power: Added[float] = 0.0


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
        ticks: number of ticks it runs; 0 for no end.
        started: seconds since 1970.
        nodes: by name, devices first, then couplings, then the environment.
        links: in the session's order.
        masses: of the virtual world, kg by name, or 0 for each coordinate of an engine's bodies; empty for other kinds.
        springs: of the virtual world; empty if it is no network.
        grips: devices that a person can hold in the browser.
        reach: the greatest displacement of each port's device, m.
        certificate: None for an uncertified session.
        environment: the environment's type.
        observers: what each observer may read, by name, as in the session file.
        seats: the device of each seat that users take and leave while the session runs, by the seat's name, which is
            that of its coupling.
        scene: the geometry of the virtual world's tools, bodies and obstacles; None if it is no scene and no mesh.
        force: the limit of the force at each port's device, N.
        drawing: what the world of a physics engine looks like; None for other worlds, and where no engine says it.
        turning: the ports and bodies that turn, whose traces are in rad and N·m.
        oriented: the bodies whose orientations the environment reports.
        hands: the devices whose orientation is a port.
        sensed: those of them that only sense it, and feel no torque.
    """

    session: str
    id: str
    pid: Annotated[int, _PID]
    clock: str
    transport: str
    period: Annotated[float, PERIOD]
    ticks: Annotated[int, _COUNT]
    started: Annotated[float, _INSTANT]
    nodes: Mapping[str, NodeAbout]
    links: tuple[LinkAbout, ...]
    masses: Mapping[str, float]
    springs: tuple[SpringAbout, ...]
    grips: tuple[str, ...]
    reach: Mapping[str, float]
    certificate: CertificateAbout | None
    environment: str
    observers: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    seats: Mapping[str, str] = field(default_factory=dict)
    scene: Annotated[ContactScene, GEOMETRY] | None = None
    force: Added[Mapping[str, float]] = field(default_factory=dict)
    drawing: Added[WorldDrawing | None] = None
    turning: Added[tuple[str, ...]] = ()
    oriented: Added[tuple[str, ...]] = ()
    hands: Added[tuple[str, ...]] = ()
    sensed: Added[tuple[str, ...]] = ()

    @property
    def terms(self) -> Terms:
        """What the session promises."""
        certificate = self.certificate
        return Terms(
            period=self.period,
            roles={name: node.role for name, node in self.nodes.items()},
            rates={name: self.rate_of(name) for name, node in self.nodes.items() if node.period is not None},
            realtime=self.clock == REALTIME,
            wall=tuple(name for name, node in self.nodes.items() if node.wall),
            certified=certificate is not None,
            tank=0.0 if certificate is None else certificate.tank,
            bounded=certificate is not None and certificate.bounded,
            enforced=() if certificate is None else certificate.enforced,
            linked=self.linked,
            seats=self.seats,
            drivers={name: node.driver for name, node in self.nodes.items() if node.driver is not None},
            couplings=self._couplings,
            units={name: self.units_at(name) for name in self.nodes} if self.turning else {},
            turned=tuple(hand for hand in self.hands if hand not in self.sensed),
        )

    def units_at(self, node: str) -> Units:
        """The units of a node's ports together."""
        return Units.of(self.kinds_at(node))

    def kinds_at(self, node: str) -> tuple[AxisKind, ...]:
        """What the axis of each of a node's ports does; nothing where all axes of the session translate."""
        return kinds_of(self.nodes[node].ports, self.turning) if self.turning else ()

    @property
    def _couplings(self) -> Mapping[str, tuple[str, ...]]:
        """The couplings of each device, in its own process or in another."""
        out: dict[str, tuple[str, ...]] = {}
        for device in (name for name, node in self.nodes.items() if node.role is Role.DEVICE):
            linked = [link.ends[1] for link in self.links if link.ends[0] == device]
            out[device] = (*linked, *(name for name, node in self.nodes.items() if node.process == device))
        return out

    def period_of(self, node: str) -> float:
        """T of a node, s; the session's for a name that is no node's."""
        known = self.nodes.get(node)
        return self.period if known is None or known.period is None else known.period

    def rate_of(self, node: str) -> float:
        """Ticks of a node in one of the session's."""
        return self.period / self.period_of(node)

    @property
    def linked(self) -> tuple[str, ...]:
        """The couplings that have a wave link."""
        return tuple(name for name, node in self.nodes.items() if node.impedance is not None)

    def topics(self, node: str) -> dict[Topic, tuple[str, ...]]:
        """The topics that a node reports, with the names of their columns, in the table's order."""
        known, masses = self.nodes[node], tuple(self.masses)
        links = links_at(node, known.role, {name: one.ports for name, one in self.nodes.items()}, self.linked)
        certified = self.certificate is not None
        hands = hands_at(node, known.role, self.hands)
        topics = topics_of(
            known.role, masses, known.wall, bool(links), known.torques, certified, self.oriented, hands, self.sensed
        )
        return {topic: topic.columns_of(known.ports, masses, links, self.oriented, hands) for topic in topics}

    def as_plain(self) -> dict[str, Any]:
        """As a JSON object."""
        plain: dict[str, Any] = written(self)
        return plain

    def save(self, directory: Path) -> None:
        """Write it into the run's directory, for its user alone (mode 0600), whole or not at all.

        Raises:
            OSError: it cannot be written.
        """
        with replacing(directory / ABOUT, mode=0o600) as file:
            file.write(json.dumps(self.as_plain(), allow_nan=False).encode())

    @classmethod
    def load(cls, directory: Path) -> About:
        """Read it from a run's directory.

        Raises:
            AboutError: the file cannot be read, or holds no description of this version.
        """
        path = directory / ABOUT
        try:
            about = read(cls, json.loads(read_regular(path, MAX_ABOUT_BYTES)))
            about.require_known_names()
        except OSError as error:
            raise AboutError(f"{path}: cannot be read: {error.strerror}") from error
        except (ValueError, RecursionError) as error:
            raise AboutError(f"{path}: found no session's description of this version: {error}") from error
        return about

    def require_known_names(self) -> None:
        """Refuse a description that names what it does not describe.

        Raises:
            ValueError: a link, a process or a seat is of no node, or the scene has other ports or bodies than the
                environment.
        """
        named = [(f"links[{i}].ends", name) for i, link in enumerate(self.links) for name in link.ends]
        named += [("seats", name) for seat in self.seats.items() for name in seat]
        named += [("hands", name) for name in self.hands]
        for place, name in (*named, *((f"nodes.{own}.process", node.process) for own, node in self.nodes.items())):
            if name is not None and name not in self.nodes:
                raise ValueError(f"{place}: found {shown(name)}; expected a node")
        if self.scene is not None:
            bodies = {name for body in self.scene.bodies for name in coordinates(body.name)}
            ports = {port for node in self.nodes.values() if node.role is Role.ENVIRONMENT for port in node.ports}
            if not (bodies <= self.masses.keys() and {*self.scene.ports} <= ports):
                raise ValueError("scene: found other ports or bodies; expected the environment's")
        for name, frame in () if self.drawing is None else self.drawing.frames.items():
            known = f"{name}.x" in self.masses and (not frame.oriented or name in self.oriented)
            hand = frame.pivot is None or any({*frame.ports} == {*self.nodes[hand].ports} for hand in self.hands)
            if not ({*frame.ports} <= self.reach.keys() and (known or not frame.reported) and hand):
                raise ValueError(f"drawing.frames.{name}: found other ports or bodies; expected the environment's")


RATE_OVER: Final = from_seconds(0.5)
"""The shortest time that a rate is taken over: telemetry comes ten times a second."""

RATE_ACCURACY: Final = 0.01
"""The part by which a rate may be wrong: telemetry may arrive a few milliseconds late, and is measured over 0.5 s."""

LATE_SHARE: Final = 0.01
"""A greater part of late ticks between two rates makes a node's health LATE."""


STATE_HEALTH: Final = {
    "running": Health.OK,
    FREE_STATE: Health.FREE,
    **dict.fromkeys(AWAY_STATES, Health.AWAY),
}
"""The health that follows from a node's state; every other state means WAITING."""


@dataclass
class LiveNode:
    """The state of one node of a running session.

    Attributes:
        name: the node's.
        role: the node's.
        state: as the supervisor names it; empty before any condition arrived.
        tick: the latest tick it reported.
        rate: its ticks a second; None before two observations.
        figures: of its latest telemetry.
        received: when its latest telemetry came; None if none has.
        late: whether more of its latest ticks than usual were late.
        silent: whether the supervisor has received no telemetry for a while, though the node runs.
        frozen: whether it is a coupling that takes no part now.
    """

    name: str
    role: Role
    state: str = ""
    tick: int = 0
    rate: float | None = None
    figures: Figures = field(default_factory=Figures)
    received: Instant | None = None
    late: bool = False
    silent: bool = False
    frozen: bool = False
    _since: tuple[Instant, int, float] | None = None

    @property
    def health(self) -> Health:
        """The node's health."""
        health = STATE_HEALTH.get(self.state, Health.WAITING)
        if health is not Health.OK:
            return health
        if self.silent:
            return Health.SILENT
        if self.frozen:
            return Health.FROZEN
        return Health.LATE if self.late else Health.OK

    @property
    def pressed(self) -> tuple[str, ...]:
        """Of a device, the buttons that are held down now, or were pressed since the telemetry before."""
        down = self.figures.tables.get(names.BUTTONS_DOWN, {})
        events = events_in(self.figures) if down else ()
        since = {event.peer for event in events if event.kind is Kind.PRESSED and event.value}
        return tuple(name.removeprefix(f"{self.name}.") for name, state in down.items() if state or name in since)

    def take(self, observation: Observation, now: Instant) -> None:
        """Take in its latest telemetry, which came at ``now``."""
        late = observation.figures.get(names.LATE, 0.0)
        if (
            self._since is None or observation.tick < self.tick or late < self._since[2]
        ):  # the first message, or a new process
            self._since, self.rate, self.late = (now, observation.tick, late), None, False
        since, tick, late_then = self._since
        if now - since >= RATE_OVER:
            done = observation.tick - tick
            self.rate = done * 1e9 / (now - since)
            self.late = late - late_then > LATE_SHARE * max(done, 1)
            self._since = now, observation.tick, late
        self.tick, self.figures, self.received = observation.tick, observation.figures, now

    def stand(self, state: str, silent: bool, frozen: bool = False) -> None:
        """Set the state that the supervisor reports; a node that does not run, or is silent, has no rate."""
        self.state, self.silent, self.frozen = state, silent, frozen
        if STATE_HEALTH.get(state) is not Health.OK or silent:
            self._since, self.rate, self.late = None, None, False


@dataclass(frozen=True)
class Seat:
    """A seat of a session, and who is in it.

    Attributes:
        name: of the seat, which is that of its coupling.
        device: its user's.
        state: ``free``, ``joining`` or ``in``.
        felt: the delay, stiffness and mass of its wave link; None while that is not known.
        health: of its two nodes.
    """

    name: str
    device: str
    state: str
    felt: FeltLink | None
    health: Health

    def sentence(self) -> str:
        """Who is in, with delay, felt stiffness and mass, and health."""
        if self.health is Health.FREE:
            return f"seat {self.name}: free"
        felt = "" if self.felt is None else f", {self.felt.figures()}"
        return f"seat {self.name}: {self.state}{felt}, {self.health}"

    def as_plain(self) -> dict[str, Any]:
        """As a JSON object."""
        felt = None if self.felt is None else self.felt.as_plain()
        return {"device": self.device, "state": self.state, "felt": felt, "health": self.health.value}


class LiveSession:
    """The state of a running session.

    Attributes:
        about: what does not change.
        nodes: every node, in the session's order.
        condition: the latest that the supervisor has sent; None before any.
        malformed: number of frames that belong to no broadcast.
    """

    def __init__(self, about: About) -> None:
        """Begin with the description alone."""
        self.about = about
        self.nodes = {name: LiveNode(name, node.role) for name, node in about.nodes.items()}
        self.condition: Condition | None = None
        self.malformed = 0

    def take(self, frame: bytes, now: Instant) -> Observation | Condition | None:
        """Take in a frame that came at ``now``; returns its message, or None if it was none of this session's."""
        return self.note(decode(frame, MAX_CONTROL_BYTES), now)

    def note(self, message: Received, now: Instant) -> Observation | Condition | None:
        """Take in a message that came at ``now``; returns it, or None if it was none of this session's."""
        match message:
            case Observation(node) if node in self.nodes:
                self.nodes[node].take(message, now)
                return message
            case Condition():
                self.condition = replace(message, promises=readable(message.promises))
                frozen = self.frozen
                for name, seen in self.nodes.items():
                    seen.stand(message.states.get(name, ""), name in message.silent, name in frozen)
                return message
            case _:
                self.malformed += 1
                return None

    @property
    def tick(self) -> int:
        """The latest tick of the session that any node reported."""
        return max((session_tick(node.tick, self.about.rate_of(name)) for name, node in self.nodes.items()), default=0)

    @property
    def rate(self) -> float | None:
        """Ticks a second of the environment, which counts the session's ticks; None before it is known."""
        rates = [node.rate for node in self.nodes.values() if node.role is Role.ENVIRONMENT]
        return rates[0] if rates else None

    @property
    def pace(self) -> str:
        """The rate in words, beside that of the period; empty before it is known.

        A session in real time cannot run faster than its period, unless it makes up for ticks that it is behind. So a
        rate above the period's is never shown without that word. What is within :data:`RATE_ACCURACY` of the period's
        rate is that rate: the instants at which telemetry arrives are no more accurate.
        """
        if self.rate is None:
            return ""
        nominal = 1.0 / self.about.period
        if self.about.clock != REALTIME:
            return f"{self.rate:.0f} / s, {self.rate / nominal:.1f} times real time"
        above = self.rate > nominal * (1.0 + RATE_ACCURACY)
        rate = self.rate if above else min(self.rate, nominal)
        return f"{rate:.0f} of {nominal:.0f} / s" + (", catching up" if above else "")

    @property
    def promises(self) -> tuple[PromiseStatus, ...]:
        """How each promise stands, as the supervisor shows it; empty before any condition arrived."""
        return () if self.condition is None else self.condition.promises

    @property
    def frozen(self) -> tuple[str, ...]:
        """The couplings that are frozen now."""
        rows = (row for row in self.promises if row.promise == Promise.PRESENCE and row.until is None)
        return tuple(name for row in rows if row.state == PromiseState.ENFORCED for name in row.who)

    def covered_tau(self, device: str) -> float:
        """The delay (s) that the certificate covers for a device now: that of its couplings' rung."""
        certificate = self.about.certificate
        if certificate is None:
            return 0.0
        taus = (certificate.taus.get(device, certificate.tau), *certificate.ladder)
        ends = {end for link in self.about.links if device in link.ends for end in link.ends}
        ends |= {name for name, node in self.about.nodes.items() if node.process == device}  # they have no link
        couplings = [self.nodes[end] for end in ends if end in self.nodes and self.nodes[end].role is Role.COUPLING]
        rungs = (coupling.figures.get(names.RUNG, 0.0) for coupling in couplings)
        return min((taus[round(rung)] for rung in rungs if 0.0 <= rung <= len(taus) - 1), default=taus[0])

    @property
    def felt_links(self) -> dict[str, FeltLink]:
        """Every wave link of which both ends have reported, by its coupling."""
        worlds = [node for node in self.nodes.values() if node.role is Role.ENVIRONMENT]
        out = {}
        for name, node in self.about.nodes.items():
            for world in worlds:
                if node.impedance is None:
                    continue
                felt = felt_link(
                    name, node.impedance, self.nodes[name].figures, world.figures, self.about.kinds_at(name)
                )
                if felt is not None:
                    out[name] = felt
        return out

    @property
    def health(self) -> Health:
        """The session's health: that of its worst node, or that of its promises, whichever is worse."""
        return worse(session_health(self.promises), *(node.health for node in self.nodes.values()))

    @property
    def time(self) -> float:
        """The session's time, s: that of its latest tick."""
        return self.tick * self.about.period

    def link_health(self, link: LinkAbout) -> Health:
        """The health of a link: that of the worse of its two ends; free where one end is a free seat."""
        ends = [self.nodes[end].health for end in link.ends]
        return Health.FREE if Health.FREE in ends else worse(*ends)

    @property
    def lobby(self) -> tuple[Seat, ...]:
        """Every seat of the session, in its order."""
        links = self.felt_links
        return tuple(self._seat(name, device, links.get(name)) for name, device in self.about.seats.items())

    def _seat(self, name: str, device: str, felt: FeltLink | None) -> Seat:
        ends = [self.nodes[name], self.nodes[device]]
        health = worse(*(end.health for end in ends))
        there = all(end.state == "running" for end in ends)
        word = "free" if health is Health.FREE else "in" if there else "joining"
        return Seat(name, device, word, felt if there else None, health)
