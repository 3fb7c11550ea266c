"""The messages between the processes of a session, as types.

Messages are values: frozen, compared by content, without behaviour. The codec (:mod:`manyhands.protocol.codec`) defines
their frames, and the channel table (:mod:`manyhands.protocol.channels`) the roles that may send and receive them.
SPEC.md describes both for other implementations.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from types import MappingProxyType
from typing import Annotated, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from manyhands.protocol.limits import MAX_TEXT
from manyhands.protocol.plain import Added, PlainForm, form_of

PROTOCOL_VERSION: Final[int] = 6
"""The version of SPEC.md that this code speaks."""

Values: TypeAlias = NDArray[np.float64]


class Role(StrEnum):
    """The role of a process in the session."""

    DEVICE = "device"
    COUPLING = "coupling"
    ENVIRONMENT = "environment"
    SUPERVISOR = "supervisor"
    OBSERVER = "observer"
    HAND = "hand"


class RefusalCode(StrEnum):
    """The part of a hello for which it was refused."""

    VERSION = "version"
    CERTIFICATE = "certificate"
    SESSION = "session"
    NAME = "name"
    ROLE = "role"
    PORTS = "ports"
    FEEDTHROUGH = "feedthrough"
    ENDPOINTS = "endpoints"
    MALFORMED = "malformed"


@dataclass(frozen=True, slots=True)
class LinkHello:
    """The first message on a link between two nodes.

    Attributes:
        version: protocol version of the sender.
        certificate: id of the certificate that the sender runs under.
        session: name of the session.
        name: name of the sender.
        role: role of the sender.
        ports: the ports that this link carries, in the order of the values in its signals.
        feedthrough: D_V of the block, m/N, ``len(ports)`` square; only from a coupling to the environment.
    """

    version: int
    certificate: str
    session: str
    name: str
    role: Role
    ports: tuple[str, ...]
    feedthrough: tuple[tuple[float, ...], ...] | None = None


@dataclass(frozen=True, slots=True)
class NodeHello:
    """The first message of a node to the supervisor; ``endpoints`` has, by peer, the endpoint that is bound for it."""

    version: int
    certificate: str
    session: str
    name: str
    role: Role
    pid: int
    endpoints: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Welcome:
    """The hello was accepted."""


@dataclass(frozen=True, slots=True)
class Refusal:
    """The hello was not accepted, because of the part ``code`` (a :class:`RefusalCode`); ``text`` is for a person."""

    code: str
    text: str


@dataclass(frozen=True, slots=True)
class Connect:
    """From the supervisor: by peer, the endpoint to connect to."""

    endpoints: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Ready:
    """To the supervisor: all links of the sender are established.

    Attributes:
        by_itself: of a device, a sentence for each thing that it does by itself, as its driver states.
    """

    by_itself: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Start:
    """From the supervisor: begin the ticks.

    Attributes:
        epoch: the instant of tick 0, monotonic ns.
        ticks: the number of ticks of the session; 0 for no end.
        tick: a tick that the session has reached already, where a node that is started later finds its peers; 0 at
            the beginning.
    """

    epoch: int
    ticks: int
    tick: int = 0


JOIN_AGAIN: Final = "join again"
"""The end of the reason of a Stop after which a guest may join again: the session goes on."""


@dataclass(frozen=True, slots=True)
class Stop:
    """From the supervisor: end now, for ``reason``."""

    reason: str

    @property
    def again(self) -> bool:
        """Whether the session goes on, and the node may join it again."""
        return self.reason.endswith(JOIN_AGAIN)


@dataclass(frozen=True, slots=True)
class Probe:
    """To the supervisor: a request for the time of its clock; ``sent`` is the sender's own time, monotonic ns."""

    sent: int


@dataclass(frozen=True, slots=True)
class Echo:
    """The supervisor's answer to a probe: its own time when it ``heard`` the probe and ``answered``, monotonic ns.

    Attributes:
        sent: as in the probe.
        heard: when the probe was read.
        answered: when this answer was made.
        round_trip: to the coupling of a wave link, R as its two ends measure it now, s: above 0, and at most
            ``MAX_ROUND_TRIP``; None where that is not known, and to every other node.
    """

    sent: int
    heard: int
    answered: int
    round_trip: float | None = None


@dataclass(frozen=True, slots=True)
class Fetch:
    """To the supervisor, from a guest that has a key and no bundle yet: a request for its part of the session.

    Attributes:
        at: from which byte on.
    """

    at: int


@dataclass(frozen=True, slots=True)
class Piece:
    """The supervisor's answer to a :class:`Fetch`.

    Attributes:
        at: the first byte that it has.
        total: the length of the part, bytes.
        content: of the part; it may hold keys, and shows in no text.
    """

    at: int
    total: int
    content: bytes = field(repr=False)


@dataclass(frozen=True, slots=True)
class Absent:
    """From the supervisor: ``peer`` is gone. The receiver closes the link, and binds a new one where it bound the old.

    On a link, from a device or a coupling: samples of the device ``peer`` are missing, and the sender is silent.
    """

    peer: str


@dataclass(frozen=True, slots=True)
class Offer:
    """To the supervisor: the sender has bound a new link for ``peer``, which was absent, at ``endpoint``."""

    peer: str
    endpoint: str


@dataclass(frozen=True, slots=True)
class Return:
    """From the supervisor: ``peer``, which was absent, is back, and binds its link to the receiver at ``endpoint``."""

    peer: str
    endpoint: str


@dataclass(frozen=True, slots=True)
class Shift:
    """From the supervisor to the environment: change the coupling ``node`` to this ``rung`` of the ladder."""

    node: str
    rung: int


@dataclass(frozen=True, slots=True)
class Rung:
    """On the links, from the environment to a coupling and on to its devices: this ``rung`` holds from this tick on.

    It is sent before a signal of zero force, in a tick in which the block exerts no force.
    """

    rung: int


@dataclass(frozen=True, slots=True, eq=False)
class Signal:
    """The base of the four signal messages; only those four are sent.

    Attributes:
        tick: k, at least 0.
        stamp: when x(tick) was sampled, monotonic ns of the device; each node copies it into its own signal.
        values: one value for each port of the link, in the handshake's order; 1-D float64, finite.
    """

    tick: int
    stamp: int
    values: Values

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Signal) or type(other) is not type(self):
            return NotImplemented
        alike = self.tick == other.tick and self.stamp == other.stamp and np.array_equal(self.values, other.values)
        return alike and getattr(self, "buttons", 0) == getattr(other, "buttons", 0)


@dataclass(frozen=True, slots=True, eq=False)
class Sample(Signal):
    """x(k), the sampled device displacement, m. Device to coupling.

    Attributes:
        buttons: which of the device's buttons are held down in this tick, bit i for its i-th; the field is left out
            where none is.
    """

    buttons: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Tool(Signal):
    """p(k) = x(k) + C_V ξ(k), the free tool position, m. Coupling to environment.

    Attributes:
        buttons: those of its devices, one after the other, as in a :class:`Sample`.
    """

    buttons: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Reaction(Signal):
    """f_v(k) of the block's ports, N. Environment to coupling."""


@dataclass(frozen=True, slots=True, eq=False)
class Force(Signal):
    """f_v(k) of the device's ports, to be applied and held, N. Coupling to device."""


@dataclass(frozen=True, slots=True)
class Wave:
    """From either end of a wave link to the other: sums over the link's life, of which the newest counts alone.

    Attributes:
        tick: n, the sender's tick count, at least 0; it rises from each wave of a life to the next.
        sums: U = Σ T a, the sum of the outgoing wave a over the sender's ticks of T seconds; one entry for each port of
            the link, √(J·s), finite; then what rides with the tick's motion or force, as in a :class:`Sample`.
        shipped: G, the energy shipped so far, J, finite; it never falls within a life.
        buttons: from a coupling, those of its devices in tick n, as in a :class:`Tool`.
    """

    tick: int
    sums: tuple[float, ...]
    shipped: float
    buttons: int = 0


@dataclass(frozen=True, slots=True)
class PathKey:
    """From the environment to a coupling, on their encrypted link: how the two exchange datagrams in this life of it.

    Attributes:
        connection: the id of the path at the environment's socket, 8 bytes.
        secret: the key of its datagrams, 32 bytes; it shows in no text.
        port: the UDP port of the environment's socket, on the host at which the coupling has reached the environment.
    """

    connection: bytes
    secret: bytes = field(repr=False)
    port: int


_NO_NUMBERS: Final[Mapping[str, float]] = MappingProxyType({})
_NO_TABLES: Final[Mapping[str, Mapping[str, float]]] = MappingProxyType({})


class Figures(Mapping[str, float]):
    """What a node counts and measures: a mapping of names to numbers, and tables of numbers.

    A table has one number for each coupling, percentile or cause. Figures are findings, which may be infinite or not a
    number.

    Attributes:
        tables: by the name of the figure, its numbers.
    """

    __slots__ = ("_numbers", "tables")

    def __init__(
        self, numbers: Mapping[str, float] = _NO_NUMBERS, tables: Mapping[str, Mapping[str, float]] = _NO_TABLES
    ) -> None:
        """``numbers`` by the names of the figures, and ``tables`` likewise."""
        self._numbers, self.tables = numbers, tables

    def table(self, name: str) -> Mapping[str, float]:
        """The table of this name; empty where there is none."""
        return self.tables.get(name, _NO_NUMBERS)

    def with_numbers(self, numbers: Mapping[str, float]) -> "Figures":
        """These figures, with ``numbers`` added or in place of their own."""
        return Figures({**self._numbers, **numbers}, self.tables)

    def finite(self) -> "Figures":
        """These figures without the numbers that are infinite or not a number."""
        tables = {name: _finite(table) for name, table in self.tables.items()}
        return Figures(_finite(self._numbers), tables)

    def __getitem__(self, name: str) -> float:
        return self._numbers[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._numbers)

    def __len__(self) -> int:
        return len(self._numbers)

    def __bool__(self) -> bool:
        """Whether there are any numbers or tables."""
        return bool(self._numbers or self.tables)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Figures):
            return NotImplemented
        return dict(self._numbers) == dict(other._numbers) and dict(self.tables) == dict(other.tables)

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return f"Figures({dict(self._numbers)}, {dict(self.tables)})"


def _finite(numbers: Mapping[str, float]) -> dict[str, float]:
    return {name: value for name, value in numbers.items() if math.isfinite(value)}


@dataclass(frozen=True, slots=True, eq=False)
class Telemetry:
    """To the supervisor, about ten times a second: a node's figures, and its traces of the latest ticks.

    Unlike signals, figures and traces are findings, which may be infinite or not a number.

    Attributes:
        tick: the tick after the latest that it covers.
        figures: what the node counts and measures.
        traces: float64 arrays by name, ticks × ports.
    """

    tick: int
    figures: Figures
    traces: Mapping[str, Values]

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Telemetry):
            return NotImplemented
        return (
            self.tick == other.tick
            and self.figures == other.figures
            and self.traces.keys() == other.traces.keys()
            and all(np.array_equal(trace, other.traces[name]) for name, trace in self.traces.items())
        )


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """From the supervisor to an observer: the part of ``node``'s telemetry that the observer may read."""

    node: str
    tick: int
    figures: Figures
    traces: Mapping[str, Values]

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Observation):
            return NotImplemented
        return self.node == other.node and (
            Telemetry(self.tick, self.figures, self.traces) == Telemetry(other.tick, other.figures, other.traces)
        )


_COSTS: Final = form_of(Mapping[str, float | None])
_FINITE_COSTS: Final = PlainForm(
    _finite, lambda data: {unit: cost for unit, cost in _COSTS.read(data).items() if cost is not None}
)
"""Costs that are no finite numbers are left out; recordings of before have null for them."""


@dataclass(frozen=True, slots=True)
class PromiseStatus:
    """How one promise of a session stands: a row of its health (:mod:`manyhands.nodes.monitor.health`).

    Attributes:
        promise: its name.
        state: kept, enforced or broken.
        who: the parties that the row is about; empty for all that no other row of this promise names.
        since: when the state began, s of the session's time; None where that is not known.
        until: when it was last so, s; None while it lasts.
        cost: what it has cost so far, by unit.
        remark: what has happened, and what to do, as a sentence; empty where there is nothing to add.
    """

    promise: str
    state: str
    who: tuple[str, ...] = ()
    since: Added[float | None] = None
    until: Added[float | None] = None
    cost: Annotated[Mapping[str, float], _FINITE_COSTS] = field(default_factory=dict)
    remark: str = ""


@dataclass(frozen=True, slots=True)
class Condition:
    """From the supervisor to observers: the condition of the session.

    Attributes:
        phase: the phase of the session.
        elapsed: the time since the first tick, s.
        states: by node, its state.
        silent: the nodes that run, but whose telemetry has not come for a while.
        notices: a sentence for each assumption of the certificate that was found broken.
        incidents: a sentence for each of the latest incidents that the session withstood.
        faults: a sentence for each failure.
        promises: how each promise of the session stands.
        by_itself: by device, what it does by itself, which no certificate covers.
        visits: a sentence for each of the latest users who have taken a seat, or left one as they wanted.
    """

    phase: str
    elapsed: float
    states: Mapping[str, str]
    silent: tuple[str, ...] = ()
    notices: tuple[str, ...] = ()
    incidents: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()
    promises: Added[tuple[PromiseStatus, ...]] = ()
    by_itself: Added[Mapping[str, tuple[str, ...]]] = field(default_factory=dict)
    visits: Added[tuple[str, ...]] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Grasp:
    """From a person's pointer to a device: hold the device at ``position``, m, one entry for each axis.

    Behind them may stand the unit quaternion of where a device is to be turned whose orientation is a port.
    """

    position: Values

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Grasp) and np.array_equal(self.position, other.position)


@dataclass(frozen=True, slots=True)
class Release:
    """From a person's pointer to a device: let go of the device."""


@dataclass(frozen=True, slots=True)
class Report:
    """A node's report on the whole run: the tick after its last, and its figures."""

    ticks: int
    figures: Figures


@dataclass(frozen=True, slots=True)
class Fault:
    """To the supervisor: the reason for which the sender ends.

    Attributes:
        text: for a person.
        by_user: whether the sender's user has ended it, and nothing is wrong.
    """

    text: str
    by_user: bool = False


SignalMessage: TypeAlias = Sample | Tool | Reaction | Force
"""A message that a link carries once in each tick."""

Message: TypeAlias = (
    LinkHello
    | NodeHello
    | Welcome
    | Refusal
    | Connect
    | Ready
    | Start
    | Stop
    | Probe
    | Echo
    | Absent
    | Offer
    | Return
    | Shift
    | Rung
    | SignalMessage
    | Wave
    | PathKey
    | Fetch
    | Piece
    | Telemetry
    | Observation
    | Condition
    | Grasp
    | Release
    | Report
    | Fault
)
"""Every message of the protocol."""


def presentable(text: str) -> str:
    """``text`` in a form that can be sent and shown: unprintable characters are replaced, at most ``MAX_TEXT`` long.

    The texts of :class:`Fault`, :class:`Stop` and :class:`Refusal` may quote anything, such as an exception or a peer.
    With this function such a quotation cannot make the message itself fail. Line ends and tabs stay.
    """
    if len(text) > MAX_TEXT:
        text = text[: MAX_TEXT - 1] + "…"
    return "".join(c if is_presentable(c) else "\ufffd" for c in text)


def is_presentable(text: str) -> bool:
    """Whether a terminal can show ``text``: every character is printable, a line end or a tab."""
    return text.replace("\n", " ").replace("\t", " ").isprintable()
