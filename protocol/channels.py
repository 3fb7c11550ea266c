"""The tables of channels and topics: what processes exchange, and what a running session shows.

:data:`CHANNELS` lists the messages of each channel, the roles that may send and receive them, and how often. Sockets,
permissions, documentation and displays are derived from it; there is no other list.

:data:`TOPICS` lists the quantities that a node shows tick by tick, with the paper's letters and units. A topic is a
*trace* of the node's telemetry. Topics that are signals have the names of the channels that carry them; the others are
findings of the node itself. Recordings, live plots and printed lines are derived from it; there is no other list.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType
from typing import Final

from manyhands.protocol.messages import (
    Absent,
    Condition,
    Connect,
    Echo,
    Fault,
    Fetch,
    Force,
    Grasp,
    LinkHello,
    Message,
    NodeHello,
    Observation,
    Offer,
    PathKey,
    Piece,
    Probe,
    Reaction,
    Ready,
    Refusal,
    Release,
    Report,
    Return,
    Role,
    Rung,
    Sample,
    Shift,
    Start,
    Stop,
    Telemetry,
    Tool,
    Wave,
    Welcome,
)


class Rate(StrEnum):
    """How often a channel carries a message."""

    EVERY_TICK = "every tick"
    TEN_HZ = "10 Hz"
    ONCE = "once"


@dataclass(frozen=True, slots=True)
class Channel:
    """One row of the table of channels.

    Attributes:
        name: last part of the channel's full name.
        messages: the message types that it carries.
        senders: roles that may send on it.
        receivers: roles that receive from it.
        symbol: the quantity in the paper's letters; empty where it carries none.
        unit: SI unit of the values (of a translational port); empty where there is none.
        rate: how often it carries a message.
    """

    name: str
    messages: tuple[type[Message], ...]
    senders: tuple[Role, ...]
    receivers: tuple[Role, ...]
    symbol: str
    unit: str
    rate: Rate


_NODES: Final = (Role.DEVICE, Role.COUPLING, Role.ENVIRONMENT)
_ENDS_OF_A_WAVE_LINK: Final = (Role.COUPLING, Role.ENVIRONMENT)
_EVERYONE: Final = (*_NODES, Role.SUPERVISOR, Role.OBSERVER)

_TABLE: Final = (
    Channel("sample", (Sample,), (Role.DEVICE,), (Role.COUPLING,), "x", "m", Rate.EVERY_TICK),
    Channel("tool", (Tool,), (Role.COUPLING,), (Role.ENVIRONMENT,), "p", "m", Rate.EVERY_TICK),
    Channel("reaction", (Reaction,), (Role.ENVIRONMENT,), (Role.COUPLING,), "f_v", "N", Rate.EVERY_TICK),
    Channel("force", (Force,), (Role.COUPLING,), (Role.DEVICE,), "f_v", "N", Rate.EVERY_TICK),
    # not every tick: the two ends of a wave link have ticks of their own, and send as often as it is worth it
    Channel("wave", (Wave,), _ENDS_OF_A_WAVE_LINK, _ENDS_OF_A_WAVE_LINK, "U", "√(J·s)", Rate.ONCE),
    Channel("path", (PathKey,), (Role.ENVIRONMENT,), (Role.COUPLING,), "", "", Rate.ONCE),
    Channel("handshake", (LinkHello, Welcome, Refusal), _NODES, _NODES, "", "", Rate.ONCE),
    Channel(
        "rung",
        (Rung,),
        (Role.ENVIRONMENT, Role.COUPLING),
        (Role.COUPLING, Role.DEVICE),
        "",
        "",
        Rate.ONCE,
    ),
    Channel(
        "absence",
        (Absent,),
        (Role.DEVICE, Role.COUPLING),
        (Role.COUPLING, Role.ENVIRONMENT),
        "",
        "",
        Rate.ONCE,
    ),
    Channel(
        "control",
        (
            *(NodeHello, Welcome, Refusal, Connect, Ready, Start, Stop, Probe, Echo),
            *(Fetch, Piece, Absent, Offer, Return, Shift, Report, Fault),
        ),
        _EVERYONE,
        _EVERYONE,
        "",
        "",
        Rate.ONCE,
    ),
    Channel("telemetry", (Telemetry,), _NODES, (Role.SUPERVISOR,), "", "", Rate.TEN_HZ),
    Channel("observation", (Observation, Condition), (Role.SUPERVISOR,), (Role.OBSERVER,), "", "", Rate.TEN_HZ),
    Channel("grip", (Grasp, Release), (Role.HAND,), (Role.DEVICE,), "", "m", Rate.ONCE),
)

CHANNELS: Final[Mapping[str, Channel]] = MappingProxyType({channel.name: channel for channel in _TABLE})
"""Every channel by its name."""


DISPLACEMENT: Final = "x"
FREE_POSITION: Final = "p"
FORCE: Final = "f_v"
TOOL_POSITION: Final = "x_e"
MASS_POSITION: Final = "q"
ORIENTATION: Final = "R"
PROXY: Final = "Q"
TORQUE: Final = "t_v"
PROPOSED: Final = "proposed"
ACCOUNT: Final = "account"
HEARD: Final = "heard"
TOLD: Final = "told"
LEDGER: Final = "ledger"
TAU: Final = "tau_us"
INTERFACE: Final = "interface"
INSTANTS: Final = "instants"
APPLIED: Final = "x_a"
WORK: Final = "work"
WAVE: Final = "c"
TANK: Final = "tank"

INSTANT_NAMES: Final = ("sampled", "applied", "ended")
"""The columns of the trace of instants: when x was sampled, when f was applied, and when the force before had ended."""

WORK_NAMES: Final = ("sampled", "applied")
"""The columns of the trace of the work of motors that hold torques: from the last number until x was sampled, and from
then until f was applied, J."""

TANK_NAMES: Final = ("L", "G", "H")
"""The columns of the trace of a tank, for each wave link: the energy in it, what it has shipped in the present life of
the link, and what it has heard of the other end's, J."""

QUATERNION_NAMES: Final = ("qw", "qx", "qy", "qz")
"""The columns of the trace of orientations, for each body: real and imaginary parts of a unit quaternion."""

AXIS_NAMES: Final = ("x", "y", "z")
"""The columns of the trace of a torque: about the world's axes."""

ACCOUNT_NAMES: Final = ("A", "D", "G", "owed", "late", "most")
"""The columns of the trace of a hand's account: what its proxy's steps have yielded, deposits, grants, what late ticks
still owe, what they may have given out in all, J; and the greatest torque of the tick, N*m."""

PROPOSED_NAMES: Final = (*QUATERNION_NAMES, "G")
"""The columns of the trace of what a hand is told: a proxy, and the sum of grants, J; zeros for nothing."""

HEARD_NAMES: Final = (*QUATERNION_NAMES, "D", "life")
"""The columns of the trace of what the world hears of a hand: its orientation, the sum of deposits, J, and which of its
lives it is, counted from 1; zeros for nothing."""

TELEMETRY: Final = "telemetry"
"""The topic of a node's figures, ten times a second, which every node has besides the topics of its role."""

CONDITION: Final = "condition"
"""The topic of the whole session, which the supervisor reports: phase, states, notices, incidents, faults."""


class Columns(StrEnum):
    """The columns of a trace: one for each port, each mass, or each port with a wave link; a single one; the three
    instants of a tick; the work until two of them; the three figures of a tank for each wave link; or the four parts of
    a unit quaternion for each body. A device's orientation has such parts, the axes of a torque, an account and what is
    proposed; the environment what it heard of each such hand, and told it.
    """

    PORTS = "ports"
    MASSES = "masses"
    ONE = "one"
    INSTANTS = "instants"
    WORKS = "works"
    LINKED = "linked ports"
    TANKS = "tanks"
    QUATERNIONS = "quaternions"
    QUATERNION = "quaternion"
    AXES = "axes"
    ACCOUNT = "account"
    PROPOSED = "proposed"
    HEARD = "heard"
    TOLD = "told"


_NO_LINKS: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class Topic:
    """One row of the table of topics.

    Attributes:
        name: last part of its full name, ``/session/node/name``.
        trace: the trace of the node's telemetry that holds it, one row for each tick.
        symbol: the quantity in the paper's letters.
        unit: SI unit (of a translational port); delays are in microseconds.
        columns: the columns of the trace.
        wall: whether only devices in wall time have it, which the realtime clock alone has.
        linked: whether only the ends of wave links have it.
        torques: whether only devices have it whose motors hold torques.
        certified: whether only sessions with a certificate have it, for it is about what is promised.
        hands: whether only hands have it whose orientation is a port, and their world.
        felt: whether only those of them have it that feel a torque, and not those whose orientation is sensed alone.
    """

    name: str
    trace: str
    symbol: str
    unit: str
    columns: Columns
    wall: bool = False
    linked: bool = False
    torques: bool = False
    certified: bool = False
    hands: bool = False
    felt: bool = False

    def columns_of(
        self,
        ports: tuple[str, ...],
        masses: tuple[str, ...],
        links: Mapping[str, tuple[str, ...]] = _NO_LINKS,
        oriented: tuple[str, ...] = (),
        hands: tuple[str, ...] = (),
    ) -> tuple[str, ...]:
        """The names of the columns.

        Args:
            ports: of the node.
            masses: of the environment.
            links: the ports of each wave link that ends at the node, by its coupling.
            oriented: the bodies of the environment whose orientations are reported.
            hands: the devices whose orientation is a port.
        """
        return {
            Columns.PORTS: ports,
            Columns.MASSES: masses,
            Columns.ONE: (self.symbol,),
            Columns.INSTANTS: INSTANT_NAMES,
            Columns.WORKS: WORK_NAMES,
            Columns.LINKED: tuple(port for own in links.values() for port in own),
            Columns.TANKS: tuple(f"{coupling}.{figure}" for coupling in links for figure in TANK_NAMES),
            Columns.QUATERNION: QUATERNION_NAMES,
            Columns.AXES: AXIS_NAMES,
            Columns.ACCOUNT: ACCOUNT_NAMES,
            Columns.PROPOSED: PROPOSED_NAMES,
            Columns.HEARD: tuple(f"{hand}.{part}" for hand in hands for part in HEARD_NAMES),
            Columns.TOLD: tuple(f"{hand}.{part}" for hand in hands for part in PROPOSED_NAMES),
            Columns.QUATERNIONS: tuple(f"{body}.{part}" for body in oriented for part in QUATERNION_NAMES),
        }[self.columns]


_LEDGER: Final = Topic("ledger", LEDGER, "E", "J", Columns.ONE, certified=True)
_TANK: Final = Topic("tank", TANK, "L, G, H", "J", Columns.TANKS, linked=True)

TOPICS: Final[Mapping[Role, tuple[Topic, ...]]] = MappingProxyType(
    {
        Role.DEVICE: (
            Topic("sample", DISPLACEMENT, "x", "m", Columns.PORTS),
            Topic("force", FORCE, "f_v", "N", Columns.PORTS),
            _LEDGER,
            Topic("tau", TAU, "τ", "us", Columns.ONE),
            Topic("interface", INTERFACE, "e", "J", Columns.ONE, wall=True),
            Topic("applied", APPLIED, "x(a)", "m", Columns.PORTS, wall=True),
            Topic("instants", INSTANTS, "s, a", "ns", Columns.INSTANTS, wall=True),
            Topic("work", WORK, "W", "J", Columns.WORKS, wall=True, torques=True, certified=True),
            Topic("orientation", ORIENTATION, "R", "1", Columns.QUATERNION, hands=True),
            Topic("proxy", PROXY, "Q", "1", Columns.QUATERNION, hands=True, felt=True),
            Topic("torque", TORQUE, "t", "N·m", Columns.AXES, hands=True, felt=True),
            Topic("proposed", PROPOSED, "Q, G", "1, J", Columns.PROPOSED, hands=True, felt=True),
            Topic("account", ACCOUNT, "A", "J, N·m", Columns.ACCOUNT, hands=True, felt=True),
        ),
        Role.COUPLING: (
            Topic("tool", FREE_POSITION, "p", "m", Columns.PORTS),
            Topic("reaction", FORCE, "f_v", "N", Columns.PORTS),
            _LEDGER,
            Topic("wave", WAVE, "c", "√W", Columns.LINKED, linked=True),
            _TANK,
        ),
        Role.ENVIRONMENT: (
            Topic("tools", TOOL_POSITION, "x_e", "m", Columns.PORTS),
            Topic("masses", MASS_POSITION, "q", "m", Columns.MASSES),
            Topic("orientations", ORIENTATION, "R", "1", Columns.QUATERNIONS),
            _LEDGER,
            Topic("heard", HEARD, "R, D", "1, J", Columns.HEARD, hands=True),
            Topic("told", TOLD, "Q, G", "1, J", Columns.TOLD, hands=True),
            Topic("tool", FREE_POSITION, "p", "m", Columns.LINKED, linked=True),
            Topic("reaction", FORCE, "f_v", "N", Columns.LINKED, linked=True),
            Topic("wave", WAVE, "c", "√W", Columns.LINKED, linked=True),
            _TANK,
        ),
    }
)
"""The topics of each role, in the order in which they are shown."""


def topics_of(
    role: Role,
    masses: tuple[str, ...] = (),
    wall: bool = False,
    linked: bool = False,
    torques: bool = False,
    certified: bool = True,
    oriented: tuple[str, ...] = (),
    hands: tuple[str, ...] = (),
    sensed: Collection[str] = (),
) -> tuple[Topic, ...]:
    """The topics of a node of this role.

    Args:
        role: of the node.
        masses: of the environment; without them its topic of masses is left out.
        wall: whether it is, or may be, a device in wall time; the topics of these are left out otherwise.
        linked: whether a wave link ends at it; the topics of such ends are left out otherwise.
        torques: whether its motors hold torques, or may; the topics of such devices are left out otherwise.
        certified: whether its session has a certificate, or may; what only such sessions have is left out otherwise.
        oriented: the bodies of the environment whose orientations are reported; without them their topic is left out.
        hands: the devices whose orientation is a port: of the environment, or this device alone; without them the
            topics of such hands are left out.
        sensed: the devices whose orientation is sensed alone; such a device has only the topics of those.
    """
    felt = not {*hands} <= {*sensed}
    return tuple(
        topic
        for topic in TOPICS.get(role, ())
        if (masses or topic.columns is not Columns.MASSES)
        and (oriented or topic.columns is not Columns.QUATERNIONS)
        and (hands or not topic.hands)
        and (felt or not topic.felt)
        and (wall or not topic.wall)
        and (linked or not topic.linked)
        and (torques or not topic.torques)
        and (certified or not topic.certified)
    )


def links_at(
    node: str, role: Role, ports: Mapping[str, tuple[str, ...]], linked: Collection[str]
) -> dict[str, tuple[str, ...]]:
    """The wave links that end at a node: the ports of each, by its coupling.

    Args:
        node: its name.
        role: its role.
        ports: of every node.
        linked: the couplings that have a wave link, in the session's order.
    """
    if role is Role.ENVIRONMENT:
        return {name: ports[name] for name in linked}
    return {node: ports[node]} if node in linked else {}


def topic_name(session: str, node: str, topic: str) -> str:
    """The full name of a node's topic, ``/session/node/topic``."""
    return f"/{session}/{node}/{topic}"


def hands_at(node: str, role: Role, hands: Collection[str]) -> tuple[str, ...]:
    """The devices whose orientations a node has topics of: a device its own, the environment all.

    Args:
        node: its name.
        role: its role.
        hands: the devices whose orientation is a port, in the session's order.
    """
    if role is Role.ENVIRONMENT:
        return tuple(hands)
    return (node,) if node in hands else ()
