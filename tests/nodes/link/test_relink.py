"""A node's actions at its links when the supervisor reports that a peer is lost, or back."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from manyhands.nodes.kernel.bundle import Peer
from manyhands.nodes.link.peer_link import PeerLink
from manyhands.nodes.link.relink import relink, unlink
from manyhands.nodes.link.supervisor_line import NOT_AT_ALL
from manyhands.protocol.clock import RealtimeClock
from manyhands.protocol.codec import decode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import PROTOCOL_VERSION, Absent, LinkHello, Return, Role, Sample
from manyhands.protocol.transport import Link, TransportError
from tests.support.memory_transport import MemoryTransport

OWN = LinkHello(PROTOCOL_VERSION, "c", "s", "cx", Role.COUPLING, ("x",))
DEVICE = Peer("dx", Role.DEVICE, ("x",), binds=True)
ENVIRONMENT = Peer("environment", Role.ENVIRONMENT, ("x",), binds=False)


class OfferingLine:
    """A node's line to a supervisor, over a transport that may have no place left."""

    def __init__(self, transport: MemoryTransport) -> None:
        self.transport, self.full = transport, False
        self.bound: list[Link] = []
        self.offers: list[tuple[str, str]] = []

    def bind_anew(self, peer: Peer) -> tuple[Link, str]:
        if self.full:
            raise TransportError("no place left")
        link, endpoint = self.transport.bind(f"cx-{peer.name}.{len(self.bound)}", peer.name)
        self.bound.append(link)
        return link, endpoint

    def connect(self, endpoint: str, peer: Peer) -> Link:
        return self.transport.connect(endpoint, peer.name)

    def offer(self, peer: str, endpoint: str) -> None:
        self.offers.append((peer, endpoint))


@pytest.fixture
def transport() -> Iterator[MemoryTransport]:
    transport = MemoryTransport()
    yield transport
    transport.close()


@pytest.fixture
def line(transport: MemoryTransport) -> OfferingLine:
    return OfferingLine(transport)


@pytest.fixture
def joins(transport: MemoryTransport) -> list[PeerLink]:
    links = [transport.bind("cx-dx", "dx")[0], transport.connect(transport.bind("environment-cx", "cx")[1], "e")]
    return [
        PeerLink(OWN, peer, link, Sample, slice(0, 1), RealtimeClock())
        for peer, link in zip((DEVICE, ENVIRONMENT), links, strict=True)
    ]


def test_who_binds_the_link_makes_a_new_place_and_offers_it(joins: list[PeerLink], line: OfferingLine) -> None:
    before = joins[0].link
    assert unlink(Absent("dx"), joins, line) is joins[0]  # type: ignore[arg-type]
    assert joins[0].link is line.bound[0] is not before
    assert joins[0].reachable
    assert not joins[0].here  # not before hands are shaken
    ((peer, endpoint),) = line.offers
    returned = line.transport.connect(endpoint, "dx")
    assert peer == "dx"
    assert returned.send(b"hello")
    with pytest.raises(TransportError):
        before.recv(NOT_AT_ALL)  # type: ignore[union-attr]


def test_a_connecting_node_waits_for_the_endpoint(joins: list[PeerLink], line: OfferingLine) -> None:
    assert unlink(Absent("environment"), joins, line) is joins[1]  # type: ignore[arg-type]
    assert not joins[1].reachable
    assert not line.offers
    bound, endpoint = line.transport.bind("environment-cx.1", "cx")
    relink(Return("environment", endpoint), joins, line)  # type: ignore[arg-type]
    assert joins[1].reachable
    assert not joins[1].here
    frame = bound.recv(NOT_AT_ALL)
    assert frame is not None
    assert decode(frame, MAX_CONTROL_BYTES) == OWN  # the connecting side sends its hello first


def test_every_absence_of_one_peer_has_its_own_endpoint(joins: list[PeerLink], line: OfferingLine) -> None:
    for _ in range(3):
        unlink(Absent("dx"), joins, line)  # type: ignore[arg-type]
    assert len({endpoint for _, endpoint in line.offers}) == 3
    assert joins[0].link is line.bound[-1]
    for old in line.bound[:-1]:
        with pytest.raises(TransportError):
            old.recv(NOT_AT_ALL)


def test_a_peer_for_whom_there_is_no_place_stays_away(joins: list[PeerLink], line: OfferingLine) -> None:
    line.full = True
    assert unlink(Absent("dx"), joins, line) is joins[0]  # type: ignore[arg-type]
    assert not joins[0].reachable
    assert not line.offers


def test_strangers_and_wrong_ends_are_nobodys_business(joins: list[PeerLink], line: OfferingLine) -> None:
    before = [join.link for join in joins]
    assert unlink(Absent("dz"), joins, line) is None  # type: ignore[arg-type]
    relink(Return("dz", "memory://nowhere"), joins, line)  # type: ignore[arg-type]
    relink(Return("dx", "memory://nowhere"), joins, line)  # type: ignore[arg-type] -- its own to bind
    relink(Return("environment", "carrier pigeon"), joins, line)  # type: ignore[arg-type]
    assert [join.link for join in joins] == before
    assert all(join.here for join in joins)
    assert not line.offers
