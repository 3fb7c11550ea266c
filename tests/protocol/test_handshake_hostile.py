"""Both sides of a handshake with an attacker between them: it drops, repeats, reorders, changes and invents frames.

A handshake without cryptography promises three things. A peer is accepted only as the node that every part of its hello
names, whatever came before. A hello altered in an essential part is refused. A pair that the attacker leaves alone
succeeds. The transport ensures that a hello comes from its sender. The environment ensures that D_V is the
certificate's: here only the shape of D_V is essential.
"""

import dataclasses
from typing import Any

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis.stateful import Bundle, RuleBasedStateMachine, initialize, invariant, precondition, rule

from manyhands.protocol.clock import Duration, Instant
from manyhands.protocol.codec import decode, encode
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
    Fault,
    LinkHello,
    Message,
    NodeHello,
    Ready,
    Refusal,
    Role,
    Sample,
    Welcome,
)

from ..support.cases import cases

D_V = ((0.1, 0.0), (0.0, 0.2))
OTHER_D_V = ((0.3, 0.0), (0.0, 0.4))
PORTS = ("dx", "dy")
COUPLING = LinkHello(PROTOCOL_VERSION, "c0ffee", "example-1", "cx", Role.COUPLING, PORTS, D_V)
ENVIRONMENT = LinkHello(PROTOCOL_VERSION, "c0ffee", "example-1", "environment", Role.ENVIRONMENT, PORTS)
TO_DEVICE = dataclasses.replace(COUPLING, feedthrough=None)
DEVICE = LinkHello(PROTOCOL_VERSION, "c0ffee", "example-1", "dxy", Role.DEVICE, PORTS)
PAIRS = [(COUPLING, ENVIRONMENT), (DEVICE, TO_DEVICE)]  # the connecting and the binding side

LIVE = {state for state, _ in TRANSITIONS}
REFUSED = {State.REFUSED, State.REFUSED_BY_PEER}

ALTERATIONS: dict[str, list[Any]] = {
    "version": [0, PROTOCOL_VERSION - 1, PROTOCOL_VERSION + 1, 2**31 - 1],
    "certificate": ["bad1dea", "c0ffe", "C0FFEE", "c0ffee0"],
    "session": ["example-2", "example", "Example-1"],
    "name": ["cy", "cx0", "CX", "supervisor", "environment0"],
    "role": [Role.OBSERVER, Role.SUPERVISOR],
    "ports": [("dx",), ("dy", "dx"), ("dx", "dz"), ("dx", "dy", "dz"), ("dx.0", "dy")],
    "feedthrough": [(), ((0.1,),), ((0.1, 0.2),), ((0.1,), (0.2,)), ((0.1, 0.2), (0.3,))],
}


def essence(hello: LinkHello) -> LinkHello:
    """What of a hello the handshake itself protects: everything, of D_V its shape."""
    rows = hello.feedthrough
    return dataclasses.replace(hello, feedthrough=None if rows is None else tuple((0.0,) * len(row) for row in rows))


@st.composite
def altered_hellos(draw: st.DrawFn, hello: LinkHello) -> LinkHello:
    """``hello`` with at least one essential field that is another."""
    fields = draw(st.sets(st.sampled_from(sorted(ALTERATIONS)), min_size=1, max_size=3))
    return dataclasses.replace(hello, **{field: draw(st.sampled_from(ALTERATIONS[field])) for field in sorted(fields)})


strangers = st.sampled_from([hello for pair in PAIRS for hello in pair]).flatmap(altered_hellos)
others: st.SearchStrategy[Message] = st.sampled_from(
    [
        Ready(),
        Fault("boom"),
        Sample(0, 0, np.ones(2)),
        NodeHello(PROTOCOL_VERSION, "c0ffee", "example-1", "cx", Role.COUPLING, 1, {}),
    ]
)
ANSWERS: list[Message] = [Welcome(), Refusal("name", "no")]
junk = st.binary(max_size=30) | strangers.map(encode) | others.map(encode)


class RecordedSide:
    """One end, and a diary of what it was handed while it listened."""

    def __init__(self, own: LinkHello, hopes: LinkHello, opens: bool) -> None:
        self.own, self.hopes = own, hopes
        self.handshake = LinkHandshake(own, Expected(hopes.name, hopes.role, hopes.ports), opens)
        self.heard: list[bytes] = []
        self.ended: tuple[State, LinkHello | None, str | None] | None = None


class AdversaryBetween(RuleBasedStateMachine):
    """Two honest sides; the adversary controls every frame between them and may invent frames.

    Frames wait in two lists, ``ways``: 0 to the side that binds, 1 to the one that connects.
    """

    kept: Bundle[bytes] = Bundle("kept")

    @initialize(pair=st.sampled_from(PAIRS))
    def begin(self, pair: tuple[LinkHello, LinkHello]) -> None:
        connects, binds = pair
        self.sides = (RecordedSide(binds, connects, opens=False), RecordedSide(connects, binds, opens=True))
        self.ways: tuple[list[bytes], list[bytes]] = ([], [])
        self.meddled = False
        for side in (1, 0):
            self._say(side, self.sides[side].handshake.start())

    def _say(self, side: int, messages: list[Message]) -> None:
        self.ways[1 - side].extend(encode(message) for message in messages)

    def _hand_over(self, side: int, frame: bytes) -> None:
        one = self.sides[side]
        before = one.handshake.state
        answers = one.handshake.receive(decode(frame, MAX_CONTROL_BYTES))
        if before in LIVE:
            one.heard.append(frame)
            assert one.handshake.state in {
                reached for (state, _), (reached, _) in TRANSITIONS.items() if state is before
            }
            assert len(answers) <= 1
        else:
            assert one.handshake.state is before
            assert answers == []
        self._say(side, answers)

    @rule(side=st.integers(0, 1))
    def deliver(self, side: int) -> None:
        """The next frame arrives as it was sent, if there is one."""
        if self.ways[side]:
            self._hand_over(side, self.ways[side].pop(0))

    @rule(target=kept, side=st.integers(0, 1))
    def copy(self, side: int) -> bytes:
        """Copy the frames under way, unnoticed by both sides."""
        return self.ways[side][0] if self.ways[side] else b""

    @rule(side=st.integers(0, 1), frame=kept)
    def replay(self, side: int, frame: bytes) -> None:
        """A copy arrives, at either side."""
        self.meddled = True
        self._hand_over(side, frame)

    @rule(side=st.integers(0, 1))
    def duplicate(self, side: int) -> None:
        """The next frame arrives, and again."""
        if self.ways[side]:
            self.meddled = True
            frame = self.ways[side].pop(0)
            self._hand_over(side, frame)
            self._hand_over(side, frame)

    @rule(side=st.integers(0, 1))
    def lose(self, side: int) -> None:
        if self.ways[side]:
            self.meddled = True
            self.ways[side].pop(0)

    @rule(side=st.integers(0, 1))
    def reorder(self, side: int) -> None:
        if len(self.ways[side]) > 1:
            self.meddled = True
            self.ways[side].reverse()

    @rule(side=st.integers(0, 1), data=st.data())
    def alter(self, side: int, data: st.DataObject) -> None:
        """The next frame arrives, but an essential part of it is another."""
        if self.ways[side]:
            self.meddled = True
            message = decode(self.ways[side].pop(0), MAX_CONTROL_BYTES)
            is_hello = isinstance(message, LinkHello)
            self._hand_over(side, encode(data.draw(altered_hellos(message))) if is_hello else data.draw(junk))

    @rule(side=st.integers(0, 1))
    def alter_values(self, side: int) -> None:
        """D_V on its way becomes another of the same shape."""
        if self.ways[side]:
            message = decode(self.ways[side][0], MAX_CONTROL_BYTES)
            if isinstance(message, LinkHello) and message.feedthrough == D_V:
                self.ways[side][0] = encode(dataclasses.replace(message, feedthrough=OTHER_D_V))

    @rule(side=st.integers(0, 1), message=st.sampled_from(ANSWERS))
    def answer_for_somebody(self, side: int, message: Message) -> None:
        """Deliver an answer that neither side gave."""
        self.meddled = True
        self._hand_over(side, encode(message))

    @rule(side=st.integers(0, 1), frame=junk)
    def invent(self, side: int, frame: bytes) -> None:
        self.meddled = True
        self._hand_over(side, frame)

    @invariant()
    @precondition(lambda self: hasattr(self, "sides"))
    def nobody_is_taken_for_somebody_else(self) -> None:
        for side in self.sides:
            peer = side.handshake.peer
            if peer is not None:
                assert essence(peer) == essence(side.hopes)
                assert encode(peer) in side.heard  # the accepted hello was sent, and to this side
            if side.handshake.state is State.ESTABLISHED:
                assert peer is not None

    @invariant()
    @precondition(lambda self: hasattr(self, "sides"))
    def who_refuses_says_why(self) -> None:
        for side in self.sides:
            refused = side.handshake.state in REFUSED
            assert (side.handshake.refusal is not None) == refused
            assert not (refused and side.handshake.peer)

    @invariant()
    @precondition(lambda self: hasattr(self, "sides"))
    def what_is_final_stays(self) -> None:
        for side in self.sides:
            now = (side.handshake.state, side.handshake.peer, side.handshake.refusal)
            assert side.ended is None or side.ended == now
            if side.handshake.finished:
                side.ended = now

    @invariant()
    @precondition(lambda self: hasattr(self, "sides"))
    def who_is_established_heard_what_it_should_and_nothing_else(self) -> None:
        for side, rest in zip(self.sides, ([Welcome()], []), strict=True):
            if side.handshake.state is State.ESTABLISHED:
                hello, *others = [decode(frame, MAX_CONTROL_BYTES) for frame in side.heard]
                assert isinstance(hello, LinkHello)
                assert essence(hello) == essence(side.hopes)
                assert others == rest

    def teardown(self) -> None:
        """Deliver the remaining frames; a pair that the adversary left alone succeeds."""
        if not hasattr(self, "sides"):
            return
        while any(self.ways):
            for side in (0, 1):
                if self.ways[side]:
                    self._hand_over(side, self.ways[side].pop(0))
        for check in (
            self.nobody_is_taken_for_somebody_else,
            self.who_refuses_says_why,
            self.what_is_final_stays,
            self.who_is_established_heard_what_it_should_and_nothing_else,
        ):
            check()
        if not self.meddled:
            assert {side.handshake.state for side in self.sides} == {State.ESTABLISHED}


TestAdversaryBetween = AdversaryBetween.TestCase
TestAdversaryBetween.settings = settings(max_examples=150, stateful_step_count=10)


def side(own: LinkHello, hopes: LinkHello, opens: bool) -> LinkHandshake:
    return LinkHandshake(own, Expected(hopes.name, hopes.role, hopes.ports), opens)


both_sides = pytest.mark.parametrize(
    ("own", "hopes", "opens"),
    [(own, hopes, opens) for pair in PAIRS for own, hopes, opens in ((*pair, True), (*pair[::-1], False))],
)


@both_sides
@pytest.mark.parametrize("field", ALTERATIONS)
def test_no_hello_with_anything_altered_is_good(own: LinkHello, hopes: LinkHello, opens: bool, field: str) -> None:
    for value in ALTERATIONS[field]:
        handshake = side(own, hopes, opens)
        changed = dataclasses.replace(hopes, **{field: value})
        (answer,) = handshake.receive(decode(encode(changed), MAX_CONTROL_BYTES))
        assert isinstance(answer, Refusal), value
        assert encode(answer)
        assert (handshake.state, handshake.peer) == (State.REFUSED, None)


@given(
    st.sampled_from(PAIRS),
    st.integers(0, 3),
    st.integers(0, 1),
    junk | st.sampled_from(PAIRS).flatmap(st.sampled_from).map(encode) | st.sampled_from(ANSWERS).map(encode),
)
@settings(max_examples=cases(100, 300))
def test_one_frame_too_many_at_any_point(pair: tuple[LinkHello, LinkHello], point: int, to: int, frame: bytes) -> None:
    """Before the first message, between two, or after the last."""
    between = AdversaryBetween()
    between.begin(pair)
    for receiver in (0, 1, 0)[:point]:
        between.deliver(receiver)
    between.invent(to, frame)
    between.teardown()


class ScriptedLink:
    """A link on which a script of frames and silences arrives, and the clock that passes with it."""

    def __init__(self, script: list[bytes | int], deaf: bool) -> None:
        self.script, self.deaf, self.time = list(script), deaf, 0
        self.said: list[bytes] = []

    def now(self) -> Instant:
        return Instant(self.time)

    def sleep_until(self, t: Instant) -> None:
        raise AssertionError("slept")

    def send(self, frame: bytes) -> bool:
        self.said.append(frame)
        return not self.deaf

    def recv(self, timeout: Duration | None) -> bytes | None:
        assert timeout is not None
        assert timeout > 0
        left = int(timeout)
        while self.script:
            item = self.script.pop(0)
            if isinstance(item, bytes):
                return item
            if item >= left:
                self.script.insert(0, item - left)
                break
            left, self.time = left - item, self.time + item
        self.time += left
        return None

    def trouble(self) -> None:
        return None

    def close(self) -> None:
        pass


ALLOWED = 1000
honest = st.sampled_from([encode(hello) for pair in PAIRS for hello in pair] + [encode(answer) for answer in ANSWERS])


@both_sides
@given(script=st.lists(st.integers(1, 600) | junk | honest, max_size=6), deaf=st.booleans())
@settings(max_examples=cases(50, 150))
def test_a_links_handshake_ends_in_time_with_a_clear_message(
    own: LinkHello, hopes: LinkHello, opens: bool, script: list[bytes | int], deaf: bool
) -> None:
    handshake, link = side(own, hopes, opens), ScriptedLink(script, deaf)
    try:
        peer = shake_hands(link, handshake, link, Instant(ALLOWED))
    except (HandshakeRefused, HandshakeTimeout) as error:
        told, peer = str(error), None
    else:
        told = ""
    assert link.time <= ALLOWED
    assert (peer is None) == bool(told)
    if peer is not None:
        assert essence(peer) == essence(hopes)
        assert handshake.state is State.ESTABLISHED
    assert len(link.said) <= 2


def test_a_handshake_that_stops_half_way_ends_at_the_deadline() -> None:
    link = ScriptedLink([encode(COUPLING)], deaf=False)
    handshake = side(ENVIRONMENT, COUPLING, opens=False)
    with pytest.raises(HandshakeTimeout, match=r"found no answer of cx in the time allowed \(awaiting welcome\)"):
        shake_hands(link, handshake, link, Instant(ALLOWED))
    assert link.time == ALLOWED
