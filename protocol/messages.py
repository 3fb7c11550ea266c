"""Everything that processes of a session say to each other, as types.

Messages are values: frozen, compared by content, without behaviour. What a frame of each looks like is the
codec's business (:mod:`manyhands.protocol.codec`), who may send it to whom is the channel table's
(:mod:`manyhands.protocol.channels`), and SPEC.md tells both to other implementations.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from manyhands.protocol.limits import MAX_TEXT

PROTOCOL_VERSION: Final[int] = 4
"""The version of SPEC.md that this code speaks."""

Values: TypeAlias = NDArray[np.float64]


class Role(StrEnum):
    """What a process is in the session."""

    DEVICE = "device"
    COUPLING = "coupling"
    ENVIRONMENT = "environment"
    SUPERVISOR = "supervisor"
    OBSERVER = "observer"
    HAND = "hand"


class RefusalCode(StrEnum):
    """What about a hello was not accepted."""

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
    """First message on a link between two nodes.

    Attributes:
        version: protocol version of the sender.
        certificate: id of the certificate it runs under.
        session: name of the session.
        name: name of the sending node.
        role: what the sending node is.
        ports: the ports this link carries, in the order of the values in its signals.
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
    """First message of a node to the supervisor; ``endpoints``: a peer's name to what was bound for it."""

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
    """The hello was not accepted: ``code`` (a :class:`RefusalCode`) says what about it, ``text`` tells a person."""

    code: str
    text: str


@dataclass(frozen=True, slots=True)
class Connect:
    """From the supervisor: a peer's name to the endpoint to connect to."""

    endpoints: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Ready:
    """To the supervisor: all my links are established."""


@dataclass(frozen=True, slots=True)
class Start:
    """From the supervisor: tick 0 is at ``epoch`` (monotonic ns); run ``ticks`` ticks (0: until stopped).

    ``tick``: one that the session has reached already; 0 at its beginning. Who is started later finds its peers there.
    """

    epoch: int
    ticks: int
    tick: int = 0


@dataclass(frozen=True, slots=True)
class Stop:
    """From the supervisor: end now, and why."""

    reason: str


@dataclass(frozen=True, slots=True)
class Probe:
    """To the supervisor: what does your clock say? ``sent``: the sender's own, monotonic ns."""

    sent: int


@dataclass(frozen=True, slots=True)
class Echo:
    """The supervisor's answer to a probe: its own clock (monotonic ns) when it ``heard`` and when it ``answered``."""

    sent: int
    heard: int
    answered: int


@dataclass(frozen=True, slots=True)
class Absent:
    """From the supervisor: ``peer`` is gone; close the link to it, and where it is yours to bind, bind a new one."""

    peer: str


@dataclass(frozen=True, slots=True)
class Offer:
    """To the supervisor: here ``peer``, who was absent, finds the link that this node has bound for it anew."""

    peer: str
    endpoint: str


@dataclass(frozen=True, slots=True)
class Return:
    """From the supervisor: ``peer``, who was absent, is back, and binds its link to this node there."""

    peer: str
    endpoint: str


@dataclass(frozen=True, slots=True)
class Shift:
    """From the supervisor to the environment: have the coupling ``node`` change to this ``rung`` of the ladder."""

    node: str
    rung: int


@dataclass(frozen=True, slots=True)
class Rung:
    """In band, from the environment to a coupling and on to its devices: from this tick on, this ``rung``.

    It is sent before a signal of zero force, at a tick at which the block exerts none.
    """

    rung: int


@dataclass(frozen=True, slots=True, eq=False)
class Signal:
    """What the four signal messages share; only those four are sent.

    Attributes:
        tick: k, at least 0.
        stamp: when x(tick) was sampled, monotonic ns of the device; handed on along the chain.
        values: one per port of the link, in the handshake's order; 1-D float64, finite.
    """

    tick: int
    stamp: int
    values: Values

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Signal) or type(other) is not type(self):
            return NotImplemented
        return self.tick == other.tick and self.stamp == other.stamp and np.array_equal(self.values, other.values)


@dataclass(frozen=True, slots=True, eq=False)
class Sample(Signal):
    """x(k), the sampled device displacement, m. Device to coupling."""


@dataclass(frozen=True, slots=True, eq=False)
class Tool(Signal):
    """p(k) = x(k) + C_V ξ(k), the free tool position, m. Coupling to environment."""


@dataclass(frozen=True, slots=True, eq=False)
class Reaction(Signal):
    """f_v(k) of the block's ports, N. Environment to coupling."""


@dataclass(frozen=True, slots=True, eq=False)
class Force(Signal):
    """f_v(k) of the device's ports, to be applied and held, N. Coupling to device."""


@dataclass(frozen=True, slots=True, eq=False)
class Telemetry:
    """What a node observed lately, to the supervisor about ten times a second.

    Figures and traces are findings, so unlike signals they may be infinite or not a number.

    Attributes:
        tick: the latest tick it covers.
        figures: name to value.
        traces: name to a float64 array, ticks × ports.
    """

    tick: int
    figures: Mapping[str, float]
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
    """From the supervisor to an observer: as much of ``node``'s telemetry as that observer may read."""

    node: str
    tick: int
    figures: Mapping[str, float]
    traces: Mapping[str, Values]

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Observation):
            return NotImplemented
        return self.node == other.node and (
            Telemetry(self.tick, self.figures, self.traces) == Telemetry(other.tick, other.figures, other.traces)
        )


@dataclass(frozen=True, slots=True)
class Condition:
    """From the supervisor to whoever looks on: how the session is.

    Attributes:
        phase: where it stands.
        elapsed: since the first tick, s.
        states: where each node stands.
        silent: nodes that run, and whose telemetry has not come for a while.
        notices: assumptions of the certificate that were found broken, a sentence each.
        incidents: what the session withstood, likewise, the latest.
        faults: what went wrong, likewise.
    """

    phase: str
    elapsed: float
    states: Mapping[str, str]
    silent: tuple[str, ...] = ()
    notices: tuple[str, ...] = ()
    incidents: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Grasp:
    """From a person's hand elsewhere: there it wants the device to be, m, one entry an axis."""

    position: Values

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Grasp) and np.array_equal(self.position, other.position)


@dataclass(frozen=True, slots=True)
class Release:
    """From the same: it has let go."""


@dataclass(frozen=True, slots=True)
class Report:
    """A node's last word on a run: ticks done, figures, counts, and per quantity its percentiles."""

    ticks: int
    figures: Mapping[str, float]
    counts: Mapping[str, int]
    percentiles: Mapping[str, Mapping[str, float]]


@dataclass(frozen=True, slots=True)
class Fault:
    """To the supervisor: why I end."""

    text: str


SignalMessage: TypeAlias = Sample | Tool | Reaction | Force
"""What is exchanged once a tick."""

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
    | Telemetry
    | Observation
    | Condition
    | Grasp
    | Release
    | Report
    | Fault
)
"""Everything that can be sent."""


def presentable(text: str) -> str:
    """``text`` made fit to be sent and shown: unprintable characters replaced, at most ``MAX_TEXT`` long.

    For the texts of :class:`Fault`, :class:`Stop` and :class:`Refusal`, which may quote anything (an
    exception, a peer), so that telling what went wrong does not itself go wrong. Line ends and tabs stay.
    """
    if len(text) > MAX_TEXT:
        text = text[: MAX_TEXT - 1] + "…"
    return "".join(c if is_presentable(c) else "\ufffd" for c in text)


def is_presentable(text: str) -> bool:
    """Whether a terminal can be shown ``text``: every character printable, a line end or a tab."""
    return text.replace("\n", " ").replace("\t", " ").isprintable()
