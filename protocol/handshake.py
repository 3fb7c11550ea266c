"""How two processes make sure, before the first tick, that they belong together.

On a link the connecting side sends its hello; the binding side checks it and answers with its own; the
connecting side checks that and sends a welcome. Whoever finds something wrong says so to the other before it
ends, so that both ends can name the cause. :class:`LinkHandshake` is pure: messages go in, messages to send
come out, and what leads to what stands in :data:`TRANSITIONS`. :func:`shake_hands` runs one over a link. The
supervisor's side of a node's hello needs no states: :func:`check_node_hello`.
"""

from collections.abc import Mapping
from enum import StrEnum
from typing import Final

from manyhands.protocol.admission import Expected, check_link_hello, check_node_hello, describe, refuse
from manyhands.protocol.clock import Clock, Duration, Instant
from manyhands.protocol.codec import ForeignHello, Received, decode, encode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import (
    LinkHello,
    Message,
    Refusal,
    RefusalCode,
    Welcome,
)
from manyhands.protocol.transport import Link

# the checks of hellos live next door; who shakes hands need not know that
__all__ = [
    "TRANSITIONS",
    "Answer",
    "Event",
    "Expected",
    "HandshakeRefused",
    "HandshakeTimeout",
    "LinkHandshake",
    "State",
    "check_node_hello",
    "shake_hands",
]


class HandshakeRefused(Exception):
    """One side refused the other; the text says which, what was found, what would be right and what to do."""


class HandshakeTimeout(Exception):
    """The other side did not take part in time."""


class State(StrEnum):
    """Where a side of the handshake stands."""

    AWAITING_HELLO = "awaiting hello"  # binding side, nothing heard yet
    AWAITING_ANSWER = "awaiting answer"  # connecting side, own hello sent
    AWAITING_WELCOME = "awaiting welcome"  # binding side, own hello sent
    ESTABLISHED = "established"
    REFUSED = "refused"  # this side refused
    REFUSED_BY_PEER = "refused by peer"


class Event(StrEnum):
    """What a frame from the other side amounts to."""

    GOOD_HELLO = "good hello"
    BAD_HELLO = "bad hello"  # of another version, certificate, session, ... than expected
    WELCOME = "welcome"
    REFUSAL = "refusal"
    OTHER = "anything else"  # malformed frames among it


class Answer(StrEnum):
    """What is sent in return."""

    HELLO = "hello"
    WELCOME = "welcome"
    REFUSAL = "refusal"
    NOTHING = "nothing"


TRANSITIONS: Final[Mapping[tuple[State, Event], tuple[State, Answer]]] = {
    (State.AWAITING_HELLO, Event.GOOD_HELLO): (State.AWAITING_WELCOME, Answer.HELLO),
    (State.AWAITING_HELLO, Event.BAD_HELLO): (State.REFUSED, Answer.REFUSAL),
    (State.AWAITING_HELLO, Event.WELCOME): (State.REFUSED, Answer.REFUSAL),
    (State.AWAITING_HELLO, Event.REFUSAL): (State.REFUSED_BY_PEER, Answer.NOTHING),
    (State.AWAITING_HELLO, Event.OTHER): (State.REFUSED, Answer.REFUSAL),
    (State.AWAITING_ANSWER, Event.GOOD_HELLO): (State.ESTABLISHED, Answer.WELCOME),
    (State.AWAITING_ANSWER, Event.BAD_HELLO): (State.REFUSED, Answer.REFUSAL),
    (State.AWAITING_ANSWER, Event.WELCOME): (State.REFUSED, Answer.REFUSAL),
    (State.AWAITING_ANSWER, Event.REFUSAL): (State.REFUSED_BY_PEER, Answer.NOTHING),
    (State.AWAITING_ANSWER, Event.OTHER): (State.REFUSED, Answer.REFUSAL),
    (State.AWAITING_WELCOME, Event.GOOD_HELLO): (State.REFUSED, Answer.REFUSAL),
    (State.AWAITING_WELCOME, Event.BAD_HELLO): (State.REFUSED, Answer.REFUSAL),
    (State.AWAITING_WELCOME, Event.WELCOME): (State.ESTABLISHED, Answer.NOTHING),
    (State.AWAITING_WELCOME, Event.REFUSAL): (State.REFUSED_BY_PEER, Answer.NOTHING),
    (State.AWAITING_WELCOME, Event.OTHER): (State.REFUSED, Answer.REFUSAL),
}
"""The whole handshake. States without a row are final: whatever comes then changes nothing and is not answered."""

_SLICE: Final = 200_000_000
"""At most so long is waited at once, ns: a signal that comes just before a wait is heard only after it."""

_FINAL: Final = frozenset(State) - {state for state, _ in TRANSITIONS}


class LinkHandshake:
    """One side of a link's handshake.

    Attributes:
        own: the hello this side sends.
        expects: who must be at the other end.
        state: where it stands.
        peer: the other side's hello, once it was accepted.
        refusal: who refused whom and why, in one sentence; None unless the handshake ended so.
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
        """Whether nothing more can happen."""
        return self.state in _FINAL

    def start(self) -> list[Message]:
        """What to send first: the hello of the side that opens."""
        return [self.own] if self._opens else []

    def receive(self, received: Received) -> list[Message]:
        """What to send in return for ``received``; the state moves on as :data:`TRANSITIONS` says."""
        if self.finished:
            return []
        event, found = self._judge(received)
        self.state, answer = TRANSITIONS[self.state, event]
        if event is Event.GOOD_HELLO and isinstance(received, LinkHello) and answer is not Answer.REFUSAL:
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

    def _judge(self, received: Received) -> tuple[Event, Refusal]:
        """What ``received`` amounts to, and the refusal to send should it be out of place."""
        unexpected = refuse(
            self.own.name,
            self.expects.name,
            RefusalCode.MALFORMED,
            f"found {describe(received)}; expected {self._awaited()}; see that nothing else connects here",
        )
        match received:
            case LinkHello() | ForeignHello():
                refusal = check_link_hello(received, self.own, self.expects)
                return (Event.GOOD_HELLO, unexpected) if refusal is None else (Event.BAD_HELLO, refusal)
            case Welcome():
                return Event.WELCOME, unexpected
            case Refusal():
                return Event.REFUSAL, unexpected
            case _:
                return Event.OTHER, unexpected

    def _awaited(self) -> str:
        return "a welcome" if self.state is State.AWAITING_WELCOME else "the hello of a link"


def shake_hands(link: Link, handshake: LinkHandshake, clock: Clock, deadline: Instant) -> LinkHello:
    """Run a handshake over a link and return the other side's hello.

    A refusal is on its way when this raises; close the link and the transport in the ordinary manner, which lets it
    leave (see ``LINGER_MS``).

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
        # a refusal that cannot leave is not worth a second error
        if not link.send(encode(message)) and not isinstance(message, Refusal):
            raise HandshakeTimeout(
                f"{handshake.own.name}: {handshake.expects.name} left before the handshake was over; "
                "see how that process ended"
            )
