"""The handshake of two processes: it makes sure, before the first tick, that they belong to one session.

On a link the connecting side sends its hello. The binding side checks it and answers with its own hello. The connecting
side checks that and sends a welcome. A side that finds a mistake sends a refusal before it ends, so that both ends can
report the cause.

:class:`LinkHandshake` is pure: messages go in, messages to send come out, by the table :data:`TRANSITIONS`.
:func:`shake_hands` runs it over a link. The checks of a hello are pure functions (:func:`check_link_hello`). The
supervisor's check of a node's hello needs no states (:func:`check_node_hello`).

A refusal is one sentence: which process refused which, what was found, what was expected and what to do. It is sent to
the other side as it is, so both ends report the same.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from manyhands.protocol.clock import Clock, Duration, Instant
from manyhands.protocol.codec import ForeignHello, Malformed, Received, decode, encode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import (
    PROTOCOL_VERSION,
    LinkHello,
    Message,
    NodeHello,
    Refusal,
    RefusalCode,
    Role,
    Welcome,
    presentable,
)
from manyhands.protocol.transport import Link


@dataclass(frozen=True, slots=True)
class Expected:
    """The peer that must be at the other end of a link: its name, its role, and the ports of the link in order."""

    name: str
    role: Role
    ports: tuple[str, ...]


def check_link_hello(hello: LinkHello | ForeignHello, own: LinkHello, expects: Expected) -> Refusal | None:
    """The refusal of a hello for its most fundamental mistake; None for a hello without a mistake.

    Args:
        hello: the peer's hello.
        own: the hello of this side.
        expects: the peer that must be at the other end.
    """
    me, peer = own.name, expects.name
    if hello.version != own.version or isinstance(hello, ForeignHello):
        return _refuse_version(me, peer, hello.version, own.version)
    refusal = _check_session(me, peer, hello, own.certificate, own.session)
    if refusal is not None:
        return refusal
    if hello.name != expects.name:
        text = f"found {hello.name} at the other end; expected {expects.name}; see that endpoints are not swapped"
        return refuse(me, hello.name, RefusalCode.NAME, text)
    refusal = _check_role(me, peer, hello.role, expects.role)
    if refusal is not None:
        return refusal
    if hello.ports != expects.ports:
        text = (
            f"found the ports {_list(hello.ports)}; expected {_list(expects.ports)}; start both from one session file"
        )
        return refuse(me, peer, RefusalCode.PORTS, text)
    return _check_feedthrough(hello, own, expects)


def check_node_hello(
    hello: Received,
    certificate: str,
    session: str,
    expected: Mapping[str, Role],
    sender: str,
    binds: Collection[str] = (),
) -> Refusal | None:
    """The supervisor's refusal of a node's first message; None if the node may join.

    Args:
        hello: the node's first frame, decoded.
        certificate: id of the certificate that the session runs under.
        session: name of the session.
        expected: the session's nodes and observers, and their roles.
        sender: the name by which the transport knows the sender; with keys, the name of its key.
        binds: the peers for which the sender binds a link, so that it must name an endpoint.
    """
    own = Role.SUPERVISOR.value
    match hello:
        case ForeignHello(version):
            return _refuse_version(own, "a node", version, PROTOCOL_VERSION)
        case NodeHello():
            pass
        case _:
            text = f"found {describe(hello)}; expected the hello of a node; see that nothing else connects here"
            return refuse(own, "a node", RefusalCode.MALFORMED, text)
    if hello.version != PROTOCOL_VERSION:
        return _refuse_version(own, hello.name, hello.version, PROTOCOL_VERSION)
    refusal = _check_session(own, hello.name, hello, certificate, session)
    if refusal is not None:
        return refusal
    if hello.name not in expected:
        text = f"found this name; expected one of {_list(tuple(expected))}; start it from the same session file"
        return refuse(own, hello.name, RefusalCode.NAME, text)
    if hello.name != sender:
        text = f"found the name {hello.name} from {sender}; expected its own; start it from its own bundle"
        return refuse(own, sender, RefusalCode.NAME, text)
    refusal = _check_role(own, hello.name, hello.role, expected[hello.name])
    if refusal is None and set(hello.endpoints) != set(binds):
        text = (
            f"found endpoints for {_list(sorted(hello.endpoints))}; expected them for {_list(sorted(binds))}; "
            "start it from the bundle of this session"
        )
        return refuse(own, hello.name, RefusalCode.ENDPOINTS, text)
    return refusal


def _check_session(me: str, peer: str, hello: LinkHello | NodeHello, certificate: str, session: str) -> Refusal | None:
    if hello.certificate != certificate:
        text = (
            f"found the certificate {hello.certificate}; expected {certificate}; "
            "start all nodes of the session from one certificate file, or have the invitation renewed"
        )
        return refuse(me, peer, RefusalCode.CERTIFICATE, text)
    if hello.session != session:
        text = f"found the session {hello.session}; expected {session}; see that no two share endpoints"
        return refuse(me, peer, RefusalCode.SESSION, text)
    return None


def _check_role(me: str, peer: str, found: Role, expected: Role) -> Refusal | None:
    if found is expected:
        return None
    text = f"found the role {found}; expected {expected}; start both from one session file"
    return refuse(me, peer, RefusalCode.ROLE, text)


def _check_feedthrough(hello: LinkHello, own: LinkHello, expects: Expected) -> Refusal | None:
    """Check D_V, which only a coupling sends, and only to the environment, which solves the algebraic loop with it."""
    rows = hello.feedthrough
    if own.role is not Role.ENVIRONMENT or hello.role is not Role.COUPLING:
        if rows is None:
            return None
        text = f"found a feedthrough for a {own.role}; expected none; only the environment may see it"
        return refuse(own.name, expects.name, RefusalCode.FEEDTHROUGH, text)
    size = len(expects.ports)
    if rows is not None and len(rows) == size and all(len(row) == size for row in rows):
        return None
    found = "none" if rows is None else f"rows of {_list([str(len(row)) for row in rows])}"
    text = f"found {found} as feedthrough; expected {size} x {size}; start both from one certificate file"
    return refuse(own.name, expects.name, RefusalCode.FEEDTHROUGH, text)


def _refuse_version(me: str, peer: str, found: int, expected: int) -> Refusal:
    text = f"found protocol version {found}; expected {expected}; install the same release of manyhands on both sides"
    return refuse(me, peer, RefusalCode.VERSION, text)


def refuse(me: str, peer: str, code: RefusalCode, text: str) -> Refusal:
    """The refusal of ``peer`` by ``me``; ``text`` states what was found, what was expected and what to do."""
    return Refusal(code, presentable(f"{me} refused {peer}: {text}"))


def describe(received: Received) -> str:
    """A frame that was received, in a few words."""
    if isinstance(received, Malformed):
        return f"a malformed frame ({received.reason})"
    return f"a {type(received).__name__}"


def _list(names: Sequence[str]) -> str:
    """At most 8 names, and the number of the others."""
    shown = ", ".join(names[:8]) or "none"
    return shown if len(names) <= 8 else f"{shown} and {len(names) - 8} more"


class HandshakeRefused(Exception):
    """One side refused the other; the message states which, what was found, what was expected and what to do."""


class HandshakeTimeout(Exception):
    """The other side did not take part in time."""


class State(StrEnum):
    """The state of one side of a handshake."""

    AWAITING_HELLO = "awaiting hello"  # binding side, no frame received yet
    AWAITING_ANSWER = "awaiting answer"  # connecting side, own hello sent
    AWAITING_WELCOME = "awaiting welcome"  # binding side, own hello sent
    ESTABLISHED = "established"
    REFUSED = "refused"  # this side refused
    REFUSED_BY_PEER = "refused by peer"


class HandshakeEvent(StrEnum):
    """The meaning of a frame from the other side."""

    GOOD_HELLO = "good hello"
    BAD_HELLO = "bad hello"  # its version, certificate, session, ... is not the expected one
    WELCOME = "welcome"
    REFUSAL = "refusal"
    OTHER = "anything else"  # malformed frames included


class Answer(StrEnum):
    """The message that a side sends in return."""

    HELLO = "hello"
    WELCOME = "welcome"
    REFUSAL = "refusal"
    NOTHING = "nothing"


TRANSITIONS: Final[Mapping[tuple[State, HandshakeEvent], tuple[State, Answer]]] = {
    (State.AWAITING_HELLO, HandshakeEvent.GOOD_HELLO): (State.AWAITING_WELCOME, Answer.HELLO),
    (State.AWAITING_HELLO, HandshakeEvent.BAD_HELLO): (State.REFUSED, Answer.REFUSAL),
    (State.AWAITING_HELLO, HandshakeEvent.WELCOME): (State.REFUSED, Answer.REFUSAL),
    (State.AWAITING_HELLO, HandshakeEvent.REFUSAL): (State.REFUSED_BY_PEER, Answer.NOTHING),
    (State.AWAITING_HELLO, HandshakeEvent.OTHER): (State.REFUSED, Answer.REFUSAL),
    (State.AWAITING_ANSWER, HandshakeEvent.GOOD_HELLO): (State.ESTABLISHED, Answer.WELCOME),
    (State.AWAITING_ANSWER, HandshakeEvent.BAD_HELLO): (State.REFUSED, Answer.REFUSAL),
    (State.AWAITING_ANSWER, HandshakeEvent.WELCOME): (State.REFUSED, Answer.REFUSAL),
    (State.AWAITING_ANSWER, HandshakeEvent.REFUSAL): (State.REFUSED_BY_PEER, Answer.NOTHING),
    (State.AWAITING_ANSWER, HandshakeEvent.OTHER): (State.REFUSED, Answer.REFUSAL),
    (State.AWAITING_WELCOME, HandshakeEvent.GOOD_HELLO): (State.REFUSED, Answer.REFUSAL),
    (State.AWAITING_WELCOME, HandshakeEvent.BAD_HELLO): (State.REFUSED, Answer.REFUSAL),
    (State.AWAITING_WELCOME, HandshakeEvent.WELCOME): (State.ESTABLISHED, Answer.NOTHING),
    (State.AWAITING_WELCOME, HandshakeEvent.REFUSAL): (State.REFUSED_BY_PEER, Answer.NOTHING),
    (State.AWAITING_WELCOME, HandshakeEvent.OTHER): (State.REFUSED, Answer.REFUSAL),
}
"""The whole handshake. States without a row are final: a frame that comes then changes nothing and gets no answer."""

_SLICE: Final = 200_000_000
"""The longest single wait, ns: a process signal that comes just before a wait is handled only after it."""

_FINAL: Final = frozenset(State) - {state for state, _ in TRANSITIONS}


class LinkHandshake:
    """One side of a link's handshake.

    Attributes:
        own: the hello that this side sends.
        expects: the peer that must be at the other end.
        state: the state of this side.
        peer: the other side's hello, once it is accepted; None before, and after a refusal.
        refusal: which side refused and why, in one sentence; None unless the handshake was refused.
    """

    def __init__(self, own: LinkHello, expects: Expected, opens: bool) -> None:
        self.own = own
        self.expects = expects
        self.state = State.AWAITING_ANSWER if opens else State.AWAITING_HELLO
        self.peer: LinkHello | None = None
        self.refusal: str | None = None
        self._opens = opens

    @property
    def finished(self) -> bool:
        """Whether the state is final."""
        return self.state in _FINAL

    def start(self) -> list[Message]:
        """The messages to send first: the hello, on the side that opens."""
        return [self.own] if self._opens else []

    def receive(self, received: Received) -> list[Message]:
        """Change the state by :data:`TRANSITIONS`; returns the messages to send in return for ``received``."""
        if self.finished:
            return []
        event, found = self._judge(received)
        self.state, answer = TRANSITIONS[self.state, event]
        if event is HandshakeEvent.GOOD_HELLO and isinstance(received, LinkHello) and answer is not Answer.REFUSAL:
            self.peer = received
        if isinstance(received, Refusal):
            self.peer = None
            self.refusal = f"{self.own.name}: the link was refused at the other end: {received.text}"
        match answer:
            case Answer.HELLO:
                return [self.own]
            case Answer.WELCOME:
                return [Welcome()]
            case Answer.REFUSAL:
                self.peer = None
                self.refusal = found.text
                return [found]
            case Answer.NOTHING:
                return []

    def _judge(self, received: Received) -> tuple[HandshakeEvent, Refusal]:
        """The event that ``received`` is, and the refusal to send if :data:`TRANSITIONS` asks for one."""
        unexpected = refuse(
            self.own.name,
            self.expects.name,
            RefusalCode.MALFORMED,
            f"found {describe(received)}; expected {self._awaited()}; see that nothing else connects here",
        )
        match received:
            case LinkHello() | ForeignHello():
                refusal = check_link_hello(received, self.own, self.expects)
                return (
                    (HandshakeEvent.GOOD_HELLO, unexpected) if refusal is None else (HandshakeEvent.BAD_HELLO, refusal)
                )
            case Welcome():
                return HandshakeEvent.WELCOME, unexpected
            case Refusal():
                return HandshakeEvent.REFUSAL, unexpected
            case _:
                return HandshakeEvent.OTHER, unexpected

    def _awaited(self) -> str:
        return "a welcome" if self.state is State.AWAITING_WELCOME else "the hello of a link"


def shake_hands(link: Link, handshake: LinkHandshake, clock: Clock, deadline: Instant) -> LinkHello:
    """Run a handshake over a link; returns the other side's hello.

    When this raises, a refusal may still be on its way. An ordinary close of link and transport lets it leave (see
    ``LINGER_MS``).

    Raises:
        HandshakeRefused: one side refused the other.
        HandshakeTimeout: the other side has not taken part by ``deadline``.
    """
    _send_all(link, handshake, handshake.start())
    while not handshake.finished:
        remaining = deadline - clock.now()
        frame = link.recv(Duration(min(remaining, _SLICE))) if remaining > 0 else None
        if frame is None and remaining > _SLICE:
            continue
        if frame is None:
            expects = handshake.expects
            raise HandshakeTimeout(
                f"{handshake.own.name}: found no answer of {expects.name} in the time allowed ({handshake.state}); "
                f"expected the {expects.role} of session {handshake.own.session} at the other end; "
                "see whether that process has started and how it ended"
            )
        _send_all(link, handshake, handshake.receive(decode(frame, MAX_CONTROL_BYTES)))
    if handshake.peer is None:
        raise HandshakeRefused(handshake.refusal)
    return handshake.peer


def _send_all(link: Link, handshake: LinkHandshake, messages: list[Message]) -> None:
    for message in messages:
        # a refusal that cannot be sent raises nothing here: the caller reports its reason anyway
        if not link.send(encode(message)) and not isinstance(message, Refusal):
            raise HandshakeTimeout(
                f"{handshake.own.name}: {handshake.expects.name} left before the handshake was over; "
                "see how that process ended"
            )
