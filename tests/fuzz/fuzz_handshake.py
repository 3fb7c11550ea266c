"""Any frames to one side of a link's handshake, at every point of it: it never raises, never strays from its states,
and is never established with anyone but the node that it expects.

The rules are written here a second time, apart from the code under test: :func:`belongs` and :func:`_expected`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from draws import Draws
from forger import Forger

from manyhands.protocol.clock import Duration, Instant
from manyhands.protocol.codec import Received, decode, encode
from manyhands.protocol.handshake import (
    TRANSITIONS,
    Expected,
    HandshakeRefused,
    HandshakeTimeout,
    LinkHandshake,
    State,
    shake_hands,
)
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import (
    PROTOCOL_VERSION,
    LinkHello,
    Message,
    NodeHello,
    Ready,
    Refusal,
    Role,
    Sample,
    Welcome,
    is_presentable,
)

MOST_FRAMES: Final = 24
PATIENCE: Final = 1000
"""Time that a handshake over a link is allowed here, ns of a clock that passes as it is told."""

_ONE, _TWO = ("dx",), ("dx", "dy")
_D_V = ((0.1, 0.0), (0.0, 0.2))
_SESSION = (PROTOCOL_VERSION, "c0ffee", "example-1")
DEVICE: Final = LinkHello(*_SESSION, "dx", Role.DEVICE, _ONE)
TO_DEVICE: Final = LinkHello(*_SESSION, "cx", Role.COUPLING, _ONE)
TO_ENVIRONMENT: Final = LinkHello(*_SESSION, "cx", Role.COUPLING, _TWO, _D_V)
ENVIRONMENT: Final = LinkHello(*_SESSION, "environment", Role.ENVIRONMENT, _TWO)


@dataclass(frozen=True)
class Side:
    """One side of a link: its own hello, the hello it expects, and whether it sends first."""

    own: LinkHello
    hopes: LinkHello
    opens: bool

    def handshake(self) -> LinkHandshake:
        """The side before the first message."""
        return LinkHandshake(self.own, Expected(self.hopes.name, self.hopes.role, self.hopes.ports), self.opens)

    @cached_property
    def in_place(self) -> dict[str, Message]:
        """A possible message in such a conversation, by either side or by a stranger."""
        hopes = self.hopes
        return {
            "hoped for": hopes,
            "echo": self.own,
            "welcome": Welcome(),
            "refusal": Refusal("certificate", "no"),
            "foreign": dataclasses.replace(hopes, version=PROTOCOL_VERSION + 1),
            "other certificate": dataclasses.replace(hopes, certificate="bad1dea"),
            "other session": dataclasses.replace(hopes, session="example-2"),
            "other name": dataclasses.replace(hopes, name="cy"),
            "other role": dataclasses.replace(hopes, role=Role.OBSERVER),
            "other ports": dataclasses.replace(hopes, ports=("dy", "dx")),
            "more ports": dataclasses.replace(hopes, ports=(*hopes.ports, "dz")),
            "other feedthrough": dataclasses.replace(hopes, feedthrough=((0.1,), (0.2,))),
            "ready": Ready(),
            "node hello": NodeHello(*_SESSION, hopes.name, hopes.role, 1, {}),
            "sample": Sample(0, 0, np.array([0.5])),
        }


SIDES: Final = {
    "device": Side(DEVICE, TO_DEVICE, True),
    "coupling to device": Side(TO_DEVICE, DEVICE, False),
    "coupling to environment": Side(TO_ENVIRONMENT, ENVIRONMENT, True),
    "environment": Side(ENVIRONMENT, TO_ENVIRONMENT, False),
}
WAYS: Final = ("pure", "over a link")


def check(data: bytes) -> None:
    """Play the conversation that ``data`` decides; raise if the handshake breaks one of its promises."""
    play(Draws(data))


def play(draws: Draws) -> None:
    """The same for decisions from anywhere."""
    side = SIDES[draws.choice(tuple(SIDES))]
    forger = Forger(draws, side.in_place, ("c0ffee", "c0ffe", "example-1", "cx", "cy", "dx", "dy", "environment"))
    if draws.choice(WAYS) == "pure":
        _converse(side, draws, forger.frame)
    else:
        _over_a_link(side, draws, forger.frame)


def belongs(received: Received, side: Side) -> bool:
    """Whether ``received`` is the hello of the one node that belongs at the other end."""
    if not isinstance(received, LinkHello):
        return False
    hopes, rows = side.hopes, received.feedthrough
    widths = None if rows is None else [len(row) for row in rows]
    return (
        (received.version, received.certificate, received.session) == _SESSION
        and (received.name, received.role, received.ports) == (hopes.name, hopes.role, hopes.ports)
        and widths == (None if hopes.feedthrough is None else [len(hopes.ports)] * len(hopes.ports))
    )


def _converse(side: Side, draws: Draws, next_frame: Callable[[], bytes]) -> None:
    handshake = side.handshake()
    assert handshake.start() == ([side.own] if side.opens else [])
    for _ in range(MOST_FRAMES):
        if not draws.more:
            return
        received = decode(next_frame(), MAX_CONTROL_BYTES)
        before, peer, refusal = handshake.state, handshake.peer, handshake.refusal
        answers = handshake.receive(received)
        state, answer = _expected(before, received, side)
        assert handshake.state is state, f"{before} and {received!r}: found {handshake.state}; expected {state}"
        assert [type(one) for one in answers] == answer, f"{before} and {received!r}: answered {answers}"
        _check_side(handshake, side)
        if before not in _LIVE:
            assert (handshake.peer, handshake.refusal) == (peer, refusal), "a final state was not final"
        for one in answers:
            assert decode(encode(one), MAX_CONTROL_BYTES) == one
            assert not isinstance(one, LinkHello) or one == side.own
        if state is State.AWAITING_WELCOME or (state is State.ESTABLISHED and before is State.AWAITING_ANSWER):
            assert handshake.peer == received


_LIVE: Final = frozenset(state for state, _ in TRANSITIONS)


def _expected(state: State, received: Received, side: Side) -> tuple[State, list[type[Message]]]:
    """SPEC.md, section 4, in other words than the code's."""
    if state not in _LIVE:
        return state, []
    if isinstance(received, Refusal):
        return State.REFUSED_BY_PEER, []
    if state is State.AWAITING_HELLO and belongs(received, side):
        return State.AWAITING_WELCOME, [LinkHello]
    if state is State.AWAITING_ANSWER and belongs(received, side):
        return State.ESTABLISHED, [Welcome]
    if state is State.AWAITING_WELCOME and isinstance(received, Welcome):
        return State.ESTABLISHED, []
    return State.REFUSED, [Refusal]


def _check_side(handshake: LinkHandshake, side: Side) -> None:
    refused = handshake.state in (State.REFUSED, State.REFUSED_BY_PEER)
    assert handshake.finished == (handshake.state not in _LIVE)
    assert (handshake.refusal is not None) == refused
    assert handshake.refusal is None or (handshake.refusal and is_presentable(handshake.refusal))
    if handshake.peer is None:
        assert handshake.state is not State.ESTABLISHED
    else:
        assert not refused
        assert belongs(handshake.peer, side), f"took {handshake.peer!r} for {side.hopes.name}"


class _Told:
    """A link with forged frames at its other end, and their clock: the harness decides about both."""

    def __init__(self, draws: Draws, next_frame: Callable[[], bytes]) -> None:
        self._draws, self._next_frame = draws, next_frame
        self._now = 0
        self.said: list[bytes] = []

    def now(self) -> Instant:
        """The present instant."""
        return Instant(self._now)

    def sleep_until(self, t: Instant) -> None:
        """Not available: nothing may wait for time to pass."""
        raise AssertionError(f"slept until {t}")

    def send(self, frame: bytes) -> bool:
        """Whether the frame found room, as the harness decides."""
        self.said.append(frame)
        return self._draws.integer(0, 15) != 15

    def recv(self, timeout: Duration | None) -> bytes | None:
        """A frame after a decided time, ns, or none in the time allowed."""
        assert timeout is not None, "waited without a limit"
        assert 0 < timeout <= PATIENCE
        waited = self._draws.integer(0, 255)
        if waited >= timeout or not self._draws.more:
            self._now += timeout
            return None
        self._now += waited
        return self._next_frame()

    def trouble(self) -> None:
        """Nothing is known to have gone wrong."""

    def close(self) -> None:
        """Nothing is open."""


def _over_a_link(side: Side, draws: Draws, next_frame: Callable[[], bytes]) -> None:
    handshake, told = side.handshake(), _Told(draws, next_frame)
    why = ""
    try:
        peer = shake_hands(told, handshake, told, Instant(PATIENCE))
    except HandshakeRefused as refused:
        why = str(refused)
        assert handshake.state in (State.REFUSED, State.REFUSED_BY_PEER)
    except HandshakeTimeout as late:
        why = str(late)
    else:
        assert handshake.state is State.ESTABLISHED
        assert belongs(peer, side), f"took {peer!r} for {side.hopes.name}"
    assert is_presentable(why)
    assert why or handshake.state is State.ESTABLISHED, "failed and did not say why"
    assert told.now() <= PATIENCE
    assert len(told.said) <= 2, "a handshake says at most two things"
