"""The handshake as a state machine, and the checks of hellos: pure, both sides driven by hand."""

import dataclasses
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.protocol.codec import ForeignHello, Malformed, Received, decode, encode
from manyhands.protocol.handshake import TRANSITIONS, Expected, HandshakeEvent, LinkHandshake, State, check_node_hello
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import (
    PROTOCOL_VERSION,
    Connect,
    LinkHello,
    Message,
    NodeHello,
    Ready,
    Refusal,
    RefusalCode,
    Role,
    Welcome,
)

PORTS = ("dx", "dy")
D_V = ((0.1, 0.0), (0.0, 0.2))
COUPLING = LinkHello(PROTOCOL_VERSION, "c0ffee", "example-1", "cx", Role.COUPLING, PORTS, D_V)
ENVIRONMENT = LinkHello(PROTOCOL_VERSION, "c0ffee", "example-1", "environment", Role.ENVIRONMENT, PORTS)


def expected(hello: LinkHello) -> Expected:
    return Expected(hello.name, hello.role, hello.ports)


def both(coupling: LinkHello = COUPLING, environment: LinkHello = ENVIRONMENT) -> tuple[LinkHandshake, LinkHandshake]:
    """The coupling connects to the environment, each expecting the other as it should be."""
    return (
        LinkHandshake(coupling, expected(ENVIRONMENT), opens=True),
        LinkHandshake(environment, expected(COUPLING), opens=False),
    )


def over_the_wire(message: Message) -> Received:
    return decode(encode(message), MAX_CONTROL_BYTES)


def converse(connector: LinkHandshake, binder: LinkHandshake) -> list[Message]:
    """Carry messages to and fro until neither side has any; returns all of them in order."""
    said: list[Message] = []
    waiting = [(binder, message) for message in connector.start()] + [(connector, m) for m in binder.start()]
    while waiting:
        receiver, message = waiting.pop(0)
        said.append(message)
        sender = connector if receiver is binder else binder
        waiting += [(sender, answer) for answer in receiver.receive(over_the_wire(message))]
    return said


def test_three_messages_establish_a_link() -> None:
    connector, binder = both()
    assert converse(connector, binder) == [COUPLING, ENVIRONMENT, Welcome()]
    assert connector.state is binder.state is State.ESTABLISHED
    assert (connector.peer, binder.peer) == (ENVIRONMENT, COUPLING)
    assert connector.refusal is binder.refusal is None


def test_a_link_between_device_and_coupling_carries_no_feedthrough() -> None:
    device = dataclasses.replace(ENVIRONMENT, name="dx", role=Role.DEVICE)
    coupling = dataclasses.replace(COUPLING, feedthrough=None)
    connector = LinkHandshake(device, expected(coupling), opens=True)
    binder = LinkHandshake(coupling, expected(device), opens=False)
    converse(connector, binder)
    assert connector.state is binder.state is State.ESTABLISHED


UNFIT: list[tuple[dict[str, Any], RefusalCode, str, str]] = [
    (
        {"version": PROTOCOL_VERSION + 1},
        RefusalCode.VERSION,
        f"found protocol version {PROTOCOL_VERSION + 1}; expected {PROTOCOL_VERSION}",
        "install the same release",
    ),
    (
        {"certificate": "bad1dea"},
        RefusalCode.CERTIFICATE,
        "found the certificate bad1dea; expected c0ffee",
        "start all",
    ),
    ({"session": "other"}, RefusalCode.SESSION, "found the session other; expected example-1", "see that"),
    ({"name": "cy"}, RefusalCode.NAME, "found cy at the other end; expected cx", "see that"),
    ({"role": Role.DEVICE}, RefusalCode.ROLE, "found the role device; expected coupling", "start both"),
    ({"ports": ("dy", "dx")}, RefusalCode.PORTS, "found the ports dy, dx; expected dx, dy", "start both"),
    ({"feedthrough": None}, RefusalCode.FEEDTHROUGH, "found none as feedthrough; expected 2 x 2", "start both"),
    ({"feedthrough": ((0.1,), (0.2,))}, RefusalCode.FEEDTHROUGH, "found rows of 1, 1 as", "start both"),
    ({"feedthrough": D_V[:1]}, RefusalCode.FEEDTHROUGH, "found rows of 2 as", "start both"),
]


@pytest.mark.parametrize(("change", "code", "what", "remedy"), UNFIT, ids=[str(code) for _, code, _, _ in UNFIT])
def test_the_binding_side_refuses_and_both_sides_can_say_why(
    change: dict[str, Any], code: RefusalCode, what: str, remedy: str
) -> None:
    connector, binder = both(coupling=dataclasses.replace(COUPLING, **change))
    said = converse(connector, binder)
    assert len(said) == 2
    assert isinstance(said[1], Refusal)
    assert said[1].code == code
    assert (connector.state, binder.state) == (State.REFUSED_BY_PEER, State.REFUSED)
    for side in (connector, binder):
        assert side.refusal is not None
        assert "environment refused c" in side.refusal  # cx, or cy where the name is the fault
        assert what in side.refusal
        assert remedy in side.refusal
        assert side.peer is None


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"certificate": "bad1dea"}, RefusalCode.CERTIFICATE),
        ({"session": "other"}, RefusalCode.SESSION),
        ({"name": "dx"}, RefusalCode.NAME),
        ({"role": Role.DEVICE}, RefusalCode.ROLE),
        ({"ports": ("dx",)}, RefusalCode.PORTS),
        ({"feedthrough": D_V}, RefusalCode.FEEDTHROUGH),
        ({"version": PROTOCOL_VERSION + 1}, RefusalCode.VERSION),
    ],
)
def test_the_connecting_side_refuses_and_both_sides_can_say_why(change: dict[str, Any], code: RefusalCode) -> None:
    """The environment's own hello is the unfit one; what it expects of the coupling is in order."""
    connector, binder = both()
    connector.start()
    assert binder.receive(over_the_wire(COUPLING)) == [ENVIRONMENT]
    (refusal,) = connector.receive(over_the_wire(dataclasses.replace(ENVIRONMENT, **change)))
    assert isinstance(refusal, Refusal)
    assert refusal.code == code
    assert binder.receive(over_the_wire(refusal)) == []
    assert (connector.state, binder.state) == (State.REFUSED, State.REFUSED_BY_PEER)
    assert connector.refusal == refusal.text
    assert binder.refusal is not None
    assert refusal.text in binder.refusal
    assert connector.peer is binder.peer is None


def test_a_side_of_another_version_refuses_this_one() -> None:
    connector, binder = both(environment=dataclasses.replace(ENVIRONMENT, version=PROTOCOL_VERSION + 1))
    converse(connector, binder)
    assert binder.refusal == (
        f"environment refused cx: found protocol version {PROTOCOL_VERSION}; expected {PROTOCOL_VERSION + 1}; "
        "install the same release of manyhands on both sides"
    )
    assert connector.refusal == f"cx: the link was refused at the other end: {binder.refusal}"


@pytest.mark.parametrize("opens", [True, False])
@pytest.mark.parametrize("noise", [Malformed("found rubbish"), Ready(), Welcome(), Connect({})])
def test_noise_in_the_handshake_is_refused(opens: bool, noise: Received) -> None:
    side = both()[0 if opens else 1]
    side.start()
    (answer,) = side.receive(noise)
    assert isinstance(answer, Refusal)
    assert answer.code == RefusalCode.MALFORMED
    assert "expected the hello of a link" in answer.text
    assert side.state is State.REFUSED


@pytest.mark.parametrize("noise", [Malformed("found rubbish"), Ready(), COUPLING])
def test_noise_instead_of_a_welcome_is_refused(noise: Received) -> None:
    _, binder = both()
    binder.receive(COUPLING)
    (answer,) = binder.receive(noise)
    assert isinstance(answer, Refusal)
    assert "expected a welcome" in answer.text
    assert (binder.state, binder.peer) == (State.REFUSED, None)


def test_every_live_state_has_an_answer_to_every_event() -> None:
    live = {state for state, _ in TRANSITIONS}
    assert set(TRANSITIONS) == {(state, event) for state in live for event in HandshakeEvent}
    assert set(State) - live == {State.ESTABLISHED, State.REFUSED, State.REFUSED_BY_PEER}


anything: st.SearchStrategy[Received] = st.sampled_from(
    [
        COUPLING,
        ENVIRONMENT,
        dataclasses.replace(COUPLING, certificate="bad1dea"),
        Welcome(),
        Refusal("certificate", "no"),
        Ready(),
        ForeignHello(PROTOCOL_VERSION + 1),
        Malformed("found rubbish"),
    ]
)


@given(st.booleans(), st.lists(anything, max_size=6))
def test_the_invariants_hold_for_any_messages(opens: bool, said: list[Received]) -> None:
    side = both()[0 if opens else 1]
    side.start()
    for received in said:
        before = side.state
        was_finished = side.finished
        answers = side.receive(received)
        if was_finished:
            assert (side.state, answers) == (before, [])
        assert side.finished == (side.state in {State.ESTABLISHED, State.REFUSED, State.REFUSED_BY_PEER})
        assert (side.refusal is not None) == (side.state in {State.REFUSED, State.REFUSED_BY_PEER})
        if side.state is State.ESTABLISHED:
            assert side.peer == (ENVIRONMENT if opens else COUPLING)
        if side.refusal is not None:
            assert side.peer is None
        for answer in answers:
            over_the_wire(answer)


NODE = NodeHello(PROTOCOL_VERSION, "c0ffee", "example-1", "dx", Role.DEVICE, 4321, {})
SESSION_NODES = {"dx": Role.DEVICE, "cx": Role.COUPLING}


def test_the_supervisor_admits_a_node_of_its_session() -> None:
    assert check_node_hello(over_the_wire(NODE), "c0ffee", "example-1", SESSION_NODES, "dx") is None
    bound = dataclasses.replace(NODE, name="cx", role=Role.COUPLING, endpoints={"dx": "ipc:///s/cx-dx"})
    assert check_node_hello(over_the_wire(bound), "c0ffee", "example-1", SESSION_NODES, "cx", ["dx"]) is None


@pytest.mark.parametrize(
    ("hello", "code", "what"),
    [
        (
            ForeignHello(PROTOCOL_VERSION + 1),
            RefusalCode.VERSION,
            f"supervisor refused a node: found protocol version {PROTOCOL_VERSION + 1}; expected {PROTOCOL_VERSION}",
        ),
        (
            dataclasses.replace(NODE, version=PROTOCOL_VERSION + 1),
            RefusalCode.VERSION,
            f"refused dx: found protocol version {PROTOCOL_VERSION + 1}",
        ),
        (dataclasses.replace(NODE, certificate="bad1dea"), RefusalCode.CERTIFICATE, "found the certificate bad1dea"),
        (dataclasses.replace(NODE, session="other"), RefusalCode.SESSION, "found the session other"),
        (dataclasses.replace(NODE, name="dz"), RefusalCode.NAME, "refused dz: found this name; expected one of dx, cx"),
        (
            dataclasses.replace(NODE, name="cx", role=Role.COUPLING),
            RefusalCode.NAME,
            "supervisor refused dx: found the name cx from dx; expected its own; start it from its own bundle",
        ),
        (dataclasses.replace(NODE, role=Role.COUPLING), RefusalCode.ROLE, "found the role coupling; expected device"),
        (dataclasses.replace(NODE, role=Role.OBSERVER), RefusalCode.ROLE, "found the role observer; expected device"),
        (
            dataclasses.replace(NODE, endpoints={"cx": "tcp://192.0.2.1:1", "environment": "tcp://192.0.2.1:2"}),
            RefusalCode.ENDPOINTS,
            "found endpoints for cx, environment; expected them for none; start it from the bundle of this session",
        ),
        (Ready(), RefusalCode.MALFORMED, "found a Ready; expected the hello of a node"),
        (COUPLING, RefusalCode.MALFORMED, "found a LinkHello; expected the hello of a node"),
        (Malformed("rubbish"), RefusalCode.MALFORMED, "found a malformed frame (rubbish)"),
    ],
)
def test_the_supervisor_gives_its_reason_to_refuse(hello: Received, code: RefusalCode, what: str) -> None:
    refusal = check_node_hello(hello, "c0ffee", "example-1", SESSION_NODES, "dx")
    assert refusal is not None
    assert refusal.code == code
    assert what in refusal.text
    assert over_the_wire(refusal) == refusal


@pytest.mark.parametrize("endpoints", [{}, {"dy": "ipc:///s/cx-dy"}, {"dx": "ipc:///a", "dy": "ipc:///b"}])
def test_a_node_has_endpoints_of_exactly_the_links_that_it_binds(endpoints: dict[str, str]) -> None:
    """Else it could have peers connect to it that are not its own, or wait for ever."""
    hello = dataclasses.replace(NODE, name="cx", role=Role.COUPLING, endpoints=endpoints)
    refusal = check_node_hello(hello, "c0ffee", "example-1", SESSION_NODES, "cx", ["dx"])
    assert refusal is not None
    assert refusal.code == RefusalCode.ENDPOINTS
    assert "expected them for dx; " in refusal.text


def test_a_refusal_of_a_large_session_can_be_sent() -> None:
    nodes = {f"{'d' * 90}{i}": Role.DEVICE for i in range(1024)}
    refusal = check_node_hello(NODE, "c0ffee", "example-1", nodes, "dx")
    assert refusal is not None
    assert "and 1016 more" in refusal.text
    assert over_the_wire(refusal) == refusal
