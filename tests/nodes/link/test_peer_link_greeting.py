"""How a node and its peers connect: the order of messages, and which peers are awaited."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.nodes.joins import HANDSHAKE_TIME, establish
from manyhands.nodes.kernel.bundle import Common, Peer
from manyhands.nodes.link.join import OwnEnd, Received, positions
from manyhands.nodes.link.peer_link import bind_links, bounds_by_peer, hello_to
from manyhands.protocol.clock import Duration, Instant, RealtimeClock
from manyhands.protocol.codec import encode
from manyhands.protocol.gate import Bounds
from manyhands.protocol.handshake import HandshakeTimeout
from manyhands.protocol.messages import (
    PROTOCOL_VERSION,
    LinkHello,
    Message,
    Role,
    Sample,
    Welcome,
)
from manyhands.protocol.transport import Link
from tests.support.memory_transport import MemoryTransport

ENVIRONMENT = Peer("environment", Role.ENVIRONMENT, ("a", "b", "c"), binds=False)
LEFT = Peer("left", Role.DEVICE, ("a", "c"), binds=True)
RIGHT = Peer("right", Role.DEVICE, ("b",), binds=True)
D_V = np.diag([1.0, 2.0, 3.0])


def common(*peers: Peer) -> Common:
    return Common(
        session="s", name="c", role=Role.COUPLING, certificate="id", period=0.001, clock="simulated",
        transport="ipc", public={}, private="", directory="", control="memory://control", ports=("a", "b", "c"),
        peers=peers, telemetry_ticks=100, telemetry_first=100,
    )  # fmt: skip


COMMON = common(ENVIRONMENT, LEFT, RIGHT)


@pytest.fixture
def transport() -> Iterator[MemoryTransport]:
    transport = MemoryTransport()
    yield transport
    transport.close()


@given(own=st.lists(st.integers(0, 20), min_size=1, unique=True), data=st.data())
def test_ports_are_found_where_they_are(own: list[int], data: st.DataObject) -> None:
    ports = tuple(map(str, own))
    chosen = data.draw(st.lists(st.sampled_from(ports), min_size=1, unique=True))
    where = positions(ports, tuple(chosen))
    assert list(np.array(ports)[where]) == chosen
    at = [ports.index(port) for port in chosen]
    assert isinstance(where, slice) == (at == list(range(at[0], at[0] + len(at))))


def test_D_V_is_for_the_environment_alone() -> None:
    said = {peer.name: hello_to(COMMON, peer, D_V) for peer in COMMON.peers}
    assert said["environment"].feedthrough == ((1.0, 0.0, 0.0), (0.0, 2.0, 0.0), (0.0, 0.0, 3.0))
    assert said["left"] == LinkHello(PROTOCOL_VERSION, "id", "s", "c", Role.COUPLING, ("a", "c"), None)
    assert hello_to(COMMON, ENVIRONMENT, None).feedthrough is None


def test_bounds_go_with_their_ports() -> None:
    realtime = dataclasses.replace(COMMON, clock="realtime")
    bounds = bounds_by_peer(realtime, Role.DEVICE, [0.1, None, 0.3], [0.01, 0.02, None])
    assert bounds == {
        "left": Bounds((0.1, 0.3), (0.01, math.inf), Duration(1_000_000)),
        "right": Bounds((math.inf,), (0.02,), Duration(1_000_000)),
    }
    bounds = bounds_by_peer(COMMON, Role.DEVICE, [0.1, None, 0.3], [0.01, 0.02, None])
    assert [bound.period for bound in bounds.values()] == [None, None]
    with pytest.raises(ValueError, match="zip"):
        bounds_by_peer(COMMON, Role.DEVICE, [0.1], [0.1])


def test_a_node_binds_what_is_its_own_to_bind(transport: MemoryTransport) -> None:
    links, endpoints = bind_links(COMMON, transport)
    assert links.keys() == endpoints.keys() == {"left", "right"}
    assert endpoints["left"] == "memory://c-left"


def answering(link: Link, *messages: Message) -> None:
    for message in messages:
        assert link.send(encode(message))


def hello(peer: Peer) -> LinkHello:
    return LinkHello(PROTOCOL_VERSION, "id", "s", peer.name, peer.role, peer.ports)


def test_an_absent_peer_is_not_awaited_and_keeps_its_peer_link(transport: MemoryTransport) -> None:
    links, endpoints = bind_links(common(LEFT, RIGHT), transport)
    del links["left"]
    answering(transport.connect(endpoints["right"], "c"), hello(RIGHT), Welcome(), Sample(0, 0, np.array([0.5])))
    joins, _ = establish(OwnEnd(common(LEFT, RIGHT), RealtimeClock(), feedthrough=D_V), links)
    assert [join.peer for join in joins] == [LEFT, RIGHT]
    assert [join.here for join in joins] == [False, True]
    assert [join.hello for join in joins] == [None, hello(RIGHT)]
    x = np.zeros(3)
    assert joins[1].hear(x, 0, Duration(0), None) is Received.SIGNAL  # type: ignore[arg-type]
    assert list(x) == [0.0, 0.5, 0.0]


class Stepping:
    """A clock that every look moves on by a second."""

    def __init__(self) -> None:
        self.looks = 0

    def now(self) -> Instant:
        self.looks += 1
        return Instant(self.looks * 10**9)


def test_all_handshakes_together_have_one_deadline(transport: MemoryTransport) -> None:
    """The first peer answers late, and what is left is the second one's."""
    node = common(dataclasses.replace(LEFT), RIGHT)
    links, endpoints = bind_links(node, transport)
    answering(transport.connect(endpoints["left"], "c"), hello(LEFT), Welcome())

    class Silent:
        """A link to a peer that is there and sends nothing."""

        def send(self, _frame: bytes) -> bool:
            return True

        def recv(self, _timeout: Duration | None) -> None:
            return None

        def close(self) -> None:
            pass

    clock = Stepping()
    own = OwnEnd(node, clock, feedthrough=D_V)  # type: ignore[arg-type]
    with pytest.raises(HandshakeTimeout, match="right"):
        establish(own, {**links, "right": Silent()})  # type: ignore[dict-item]
    assert clock.looks <= 2 + HANDSHAKE_TIME // 10**9
