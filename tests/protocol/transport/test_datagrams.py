"""Conformance of datagram paths with their promises, over every family of addresses and with each kind of link."""

import errno
import os
import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
import zmq

from manyhands.protocol.clock import Duration, Instant, SimulatedClock
from manyhands.protocol.codec import encode
from manyhands.protocol.messages import Ready, Wave
from manyhands.protocol.path import KEEP_ALIVE, MOST_PORTS, NO_TOKEN, PROBE, SILENCE, PathState
from manyhands.protocol.transport import Link, Transport, TransportError
from manyhands.protocol.transport.datagrams import DatagramPath, DatagramSocket
from manyhands.protocol.transport.zeromq import ZmqTransport
from tests.protocol.conftest import ring
from tests.support.datagram_relay import Relay, lost, passed
from tests.support.memory_transport import MemoryTransport

MS = 1_000_000
LONG = Duration(10_000 * MS)  # far longer than anything here takes; never waited for in full
NOWHERE = 9  # the port of the service that discards everything; nobody has it here

FAMILIES = {
    "IPv4": ("127.0.0.1", "127.0.0.1"),
    "IPv6": ("::1", "::1"),
    "both, by IPv4": ("", "127.0.0.1"),
    "both, by IPv6": ("", "::1"),
    "by name": ("", "localhost"),
}


def wave(tick: int, ports: int = 1) -> Wave:
    return Wave(tick, tuple(tick + 0.5 + port for port in range(ports)), 0.25 * tick)


@dataclass
class Pair:
    """Both ends of a wave link, as two processes would hold them, at the instant of one clock."""

    clock: SimulatedClock
    server: DatagramSocket
    client: DatagramSocket
    links: tuple[Link, Link]
    environment: DatagramPath
    coupling: DatagramPath
    transports: list[Transport]
    relay: Relay | None = None

    def pass_ms(self, ms: float) -> None:
        self.clock.sleep_until(Instant(self.clock.now() + round(ms * MS)))

    def listen(self) -> None:
        """Hand to each end what its link has."""
        for link, path in zip(self.links, (self.environment, self.coupling), strict=True):
            while (frame := link.recv(Duration(0))) is not None:
                assert path.take(frame)

    def hear(self) -> tuple[Wave | None, Wave | None]:
        """What either end takes in: the environment, the coupling."""
        self.listen()
        if self.relay is not None:
            self.relay.pump()
        self.server.read()
        return self.environment.receive(), self.coupling.receive()

    def exchange(self, tick: int) -> tuple[Wave | None, Wave | None]:
        """A wave each way, and what either end took in, 1 ms later."""
        assert self.coupling.send(wave(tick))
        up = self.hear()[0]
        assert self.environment.send(wave(tick))
        down = self.hear()[1]
        self.pass_ms(1)
        return up, down

    def open(self) -> int:
        """Exchange waves until the path is UP at both ends; returns the next tick."""
        for tick in range(400):
            self.exchange(tick)
            if {self.environment.state, self.coupling.state} == {PathState.UP}:
                return tick + 1
        raise AssertionError("the path does not open")


def memory_links(_folder: Path, pair: list[Transport]) -> tuple[Link, Link]:
    pair.append(MemoryTransport())
    bound, endpoint = pair[0].bind("environment", "dx")
    return bound, pair[0].connect(endpoint, "environment")


def keyed_links(_folder: Path, pair: list[Transport]) -> tuple[Link, Link]:
    pair += [ZmqTransport.tcp(ring("supervisor")), ZmqTransport.tcp(ring("dx"))]
    bound, endpoint = pair[0].bind("environment", "dx")
    connected = pair[1].connect(endpoint, "supervisor")
    assert connected.send(encode(Ready()))
    assert bound.recv(LONG) == encode(Ready())
    return bound, connected


Maker = Callable[..., Pair]


@pytest.fixture
def make(tmp_path: Path) -> Iterator[Maker]:
    """Makes pairs, and closes them."""
    with ExitStack() as stack:

        def pair(
            family: str = "IPv4",
            links: Callable[[Path, list[Transport]], tuple[Link, Link]] = memory_links,
            width: int = 1,
            port: int | None = None,
            relayed: bool = False,
        ) -> Pair:
            clock = SimulatedClock()
            host, target = FAMILIES[family]
            transports: list[Transport] = []
            ends = links(tmp_path, transports)
            for transport in transports:
                stack.callback(transport.close)
            server, client = DatagramSocket.bound(host, 0, clock), DatagramSocket.unbound(clock)
            stack.callback(server.close)
            stack.callback(client.close)
            environment = server.offer(ends[0], width)
            relay = Relay(server.port) if relayed else None
            if relay is not None:
                stack.callback(relay.close)
                port = relay.port
            key = environment.key if port is None else replace(environment.key, port=port)
            coupling = client.take_up(key, target, ends[1], width)
            return Pair(clock, server, client, ends, environment, coupling, transports, relay)

        yield pair


@pytest.mark.parametrize("family", FAMILIES)
def test_waves_pass_both_ways_and_need_no_link(make: Maker, family: str) -> None:
    pair = make(family)
    first = pair.open()
    for tick in range(first, first + 50):
        assert pair.exchange(tick) == (wave(tick), wave(tick))
    for path in (pair.environment, pair.coupling):
        assert sum(path.gate.dropped.values()) == path.gate.dropped["old_tick"] <= 2  # those that came both ways
        assert not any(path.end.refused.values())
        assert path.undelivered == 0
    assert all(link.recv(Duration(0)) is None for link in pair.links)
    assert pair.environment.end.opened > 50
    assert pair.server.unsent == pair.client.unsent == 0


def test_the_first_wave_does_not_wait_for_the_path(make: Maker) -> None:
    pair = make()
    assert pair.exchange(0) == (wave(0), wave(0))


def test_over_a_keyed_tcp_link_until_the_path_is_up(make: Maker) -> None:
    pair = make(links=keyed_links, port=NOWHERE)
    for tick in range(3):
        for path, other, link in (
            (pair.coupling, pair.environment, pair.links[0]),
            (pair.environment, pair.coupling, pair.links[1]),
        ):
            assert path.send(wave(tick))
            frame = link.recv(LONG)
            assert frame is not None
            assert other.take(frame)
            assert other.receive() == wave(tick)
    assert {pair.coupling.state, pair.environment.state} == {PathState.DOWN}


def test_bits_and_widths_are_kept(make: Maker) -> None:
    pair = make(width=MOST_PORTS)
    for tick in range(0, 2000, 101):
        sent = Wave(tick, (-0.0, 5e-324, *[1 / 3] * (MOST_PORTS - 2)), 1e300)
        assert pair.coupling.send(sent)
        heard, _ = pair.hear()
        assert heard is not None
        assert list(map(float.hex, heard.sums)) == list(map(float.hex, sent.sums))
        assert pair.environment.send(sent)
        assert pair.hear()[1] == sent
        pair.pass_ms(101)
    assert pair.coupling.state is PathState.UP


def test_of_several_waves_the_newest_is_received_once(make: Maker) -> None:
    pair = make()
    first = pair.open()
    for tick in range(first, first + 20):
        assert pair.coupling.send(wave(tick))
    assert pair.hear() == (wave(first + 19), None)
    assert pair.hear() == (None, None)


def test_it_is_pollable_beside_a_link(make: Maker) -> None:
    """A loop that has both waits once for either."""
    pair = make(links=keyed_links)
    poller = zmq.Poller()
    poller.register(pair.environment, zmq.POLLIN)
    poller.register(pair.links[0]._socket, zmq.POLLIN)  # type: ignore[attr-defined]  # as await_any has it
    assert poller.poll(0) == []
    assert pair.coupling.send(wave(0))
    assert (pair.server.fileno(), zmq.POLLIN) in poller.poll(10_000)
    pair.server.read()
    assert pair.environment.receive() == wave(0)
    frame = pair.links[0].recv(LONG)
    assert frame is not None
    assert pair.environment.take(frame)
    assert pair.environment.receive() is None, "the same wave a second time"
    assert pair.environment.gate.dropped["old_tick"] == 1
    assert poller.poll(0) == []


def test_a_frame_that_is_no_wave_is_left_to_the_loop(make: Maker) -> None:
    pair = make()
    assert not pair.environment.take(encode(Ready()))
    assert not pair.environment.take(b"")
    assert not any(pair.environment.gate.dropped.values())
    assert pair.environment.take(encode(wave(3))[:-1])
    assert pair.environment.gate.dropped["malformed"] == 1


def test_waves_that_no_datagram_brings_come_over_the_link(make: Maker) -> None:
    pair = make(port=NOWHERE)
    for tick in range(1500):
        assert pair.exchange(tick) == (wave(tick), wave(tick))
    assert pair.coupling.state is PathState.DOWN
    assert pair.environment.end.opened == 0


@pytest.mark.parametrize("ways", [("up",), ("down",), ("up", "down")], ids="+".join)
def test_a_path_that_breaks_goes_over_to_the_link_and_back(make: Maker, ways: tuple[str, ...]) -> None:
    pair = make(relayed=True)
    first = pair.open()
    for way in ways:
        setattr(pair.relay, way, lost)
    heard = [pair.exchange(tick) for tick in range(first, first + 2000)]
    missed = [k for k, both in enumerate(heard) if None in both]
    assert missed == list(range(len(missed)))
    assert SILENCE / MS - 2 <= len(missed) <= 2 * SILENCE / MS + 2
    assert PathState.UP not in {pair.coupling.state, pair.environment.state}
    for way in ways:
        setattr(pair.relay, way, passed)
    first += 2000
    assert all(pair.exchange(tick) == (wave(tick), wave(tick)) for tick in range(first, first + 500))
    assert {pair.coupling.state, pair.environment.state} == {PathState.UP}


def test_a_link_whose_queue_is_full_is_reported(make: Maker) -> None:
    pair = make(port=NOWHERE)
    sent = 0
    while pair.coupling.send(wave(sent)):
        sent += 1
        assert sent < 10_000
    assert pair.coupling.undelivered == 1
    pair.listen()
    assert pair.coupling.send(wave(sent + 1))


def test_many_users_share_one_port(make: Maker) -> None:
    pair = make()
    transport = pair.transports[0]
    users = []
    with ExitStack() as stack:
        for number in range(20):
            bound, endpoint = transport.bind(f"environment-{number}", f"c{number}")
            client = DatagramSocket.unbound(pair.clock)
            stack.callback(client.close)
            environment = pair.server.offer(bound, 2)
            users.append(
                (environment, client.take_up(environment.key, "127.0.0.1", transport.connect(endpoint, "e"), 2))
            )
        assert len({environment.key.connection for environment, _ in users}) == 20
        assert len({environment.key.secret for environment, _ in users}) == 20
        assert {environment.key.port for environment, _ in users} == {pair.server.port}
        for tick in range(0, 1200, 101):
            for number, (_, coupling) in enumerate(users):
                coupling.send(Wave(tick, (float(number), 0.0), 0.0))
            pair.server.read()
            for number, (environment, _) in enumerate(users):
                assert environment.receive() == Wave(tick, (float(number), 0.0), 0.0)
                environment.send(Wave(tick, (0.0, float(number)), 0.0))
            assert [coupling.receive() for _, coupling in users] == [
                Wave(tick, (0.0, float(number)), 0.0) for number in range(20)
            ]
            pair.pass_ms(101)
        assert {path.state for both in users for path in both} == {PathState.UP}


def test_the_environment_follows_a_coupling_whose_address_changes(make: Maker) -> None:
    """As a translator of addresses changes it, from one datagram to the next."""
    pair = make(relayed=True)
    assert pair.relay is not None
    first = pair.open()
    for tick in range(first, first + 100):
        if tick % 10 == 0:
            pair.relay.rebind()
        assert pair.exchange(tick) == (wave(tick), wave(tick))
        assert pair.environment.address == pair.relay.address
    assert pair.coupling.end.changes == 1, "the coupling noticed it"


def test_a_coupling_tries_every_address_of_its_host(make: Maker, monkeypatch: pytest.MonkeyPatch) -> None:
    """A name has an address at which nobody is, and then one at which the environment is."""
    pair = make()
    family = socket.AF_INET6
    found = [
        (family, socket.SOCK_DGRAM, 17, "", (f"::ffff:127.0.0.{last}", pair.server.port, 0, 0)) for last in (2, 1, 1)
    ]
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: found)
    pair.coupling.close()
    pair.coupling = pair.client.take_up(pair.environment.key, "host", pair.links[1], 1)
    pair.open()
    assert pair.coupling.address == found[1][4]


def test_a_quiet_coupling_keeps_its_address_alive(make: Maker) -> None:
    pair = make()
    pair.open()
    received = pair.environment.end.refused.values
    for _ in range(3):
        before = sum(received())
        pair.pass_ms(KEEP_ALIVE / MS)
        pair.hear()
        pair.hear()
        assert sum(received()) == before + 1
    assert pair.environment.receive() is None


def test_a_life_ends_with_its_path(make: Maker) -> None:
    """A coupling that comes back has a new key; nothing of the former life opens any more, whoever sends it."""
    pair = make()
    first = pair.open()
    pair.environment.close()
    pair.environment.close()
    again = pair.server.offer(pair.links[0], 1)
    assert again.key.connection != pair.environment.key.connection
    assert again.key.secret != pair.environment.key.secret
    assert pair.coupling.send(wave(first))
    pair.server.read()
    assert (pair.environment.receive(), again.receive()) == (None, None)
    assert pair.environment.end.opened == first
    pair.coupling.close()
    pair.coupling = pair.client.take_up(again.key, "127.0.0.1", pair.links[1], 1)
    pair.environment = again
    assert pair.open() > 0, "n begins anew with a new key"


@pytest.mark.parametrize("ports", [MOST_PORTS + 1, 256])
def test_a_link_that_is_too_wide_is_refused(make: Maker, ports: int) -> None:
    pair = make()
    with pytest.raises(TransportError, match=f"found a link of {ports} ports; expected at most {MOST_PORTS}"):
        pair.server.offer(pair.links[0], ports)


def test_what_the_protocol_does_not_allow_is_refused_before_it_leaves(make: Maker) -> None:
    pair = make()
    assert pair.coupling.send(wave(5))
    with pytest.raises(ValueError, match=r"found the tick 5; expected 6 to"):
        pair.coupling.send(wave(5))
    with pytest.raises(ValueError, match="found 2 sums; expected 1"):
        pair.coupling.send(wave(6, 2))


def test_a_closed_socket_reports_it(make: Maker) -> None:
    pair = make()
    pair.client.close()
    pair.client.close()
    for use in (lambda: pair.coupling.send(wave(0)), pair.coupling.receive, pair.client.read):
        with pytest.raises(TransportError, match="the socket is closed"):
            use()
    with pytest.raises(TransportError, match="the socket is closed"):
        pair.client.take_up(pair.environment.key, "127.0.0.1", pair.links[1], 1)
    pair.coupling.close()


def test_an_address_that_cannot_be_used_is_refused(make: Maker) -> None:
    pair = make()
    with pytest.raises(TransportError, match=rf"cannot bind udp://127.0.0.1:{pair.server.port}: Address already"):
        DatagramSocket.bound("127.0.0.1", pair.server.port, pair.clock)
    with pytest.raises(TransportError, match="cannot use udp://no host:0"):
        DatagramSocket.bound("no host", 0, pair.clock)
    with pytest.raises(TransportError, match="cannot look up 'no host'"):
        pair.client.take_up(pair.environment.key, "no host", pair.links[1], 1)


@pytest.mark.parametrize("number", [errno.ENETUNREACH, errno.EMSGSIZE, errno.EAGAIN, errno.EPERM])
def test_a_datagram_that_the_system_does_not_take_is_a_lost_one(
    make: Maker, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    pair = make()

    class Deaf:
        """A socket without a route."""

        def sendto(self, *_: object) -> int:
            raise OSError(number, os.strerror(number))

        def fileno(self) -> int:
            return 0

    own, pair.client._socket = pair.client._socket, Deaf()  # type: ignore[assignment]
    assert pair.coupling.send(wave(0))
    assert pair.client.unsent == 1
    pair.client._socket = own
    pair.pass_ms(PROBE / MS)
    assert pair.coupling.send(wave(1))
    assert pair.hear()[0] == wave(1)


def test_no_datagram_is_cut_up_on_its_way(make: Maker) -> None:
    pair = make("both, by IPv4")
    for one in (pair.server._socket, pair.client._socket):
        assert one.getsockopt(socket.IPPROTO_IP, 10) == 3  # IP_MTU_DISCOVER: IP_PMTUDISC_PROBE
        assert one.getsockopt(socket.IPPROTO_IPV6, 23) == 3


def test_a_seat_has_nothing_sent_to_an_address_that_is_not_its_own(make: Maker) -> None:
    """Its key seals datagrams, which come from elsewhere. Over loopback; before, 32,960 B went there for 512 B."""
    pair = make()
    tick = pair.open()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as victim:
        victim.bind(("127.0.0.1", 0))
        victim.setblocking(False)
        sent = got = 0
        for k in range(tick, tick + 2000):
            if (k - tick) % 250 == 0:
                datagram, _ = pair.coupling.end.outgoing(k, encode(wave(k)), pair.clock.now(), NO_TOKEN)
                assert datagram is not None
                sent += victim.sendto(datagram, ("127.0.0.1", pair.server.port))
            pair.server.read()
            assert pair.environment.send(wave(k))  # over ZeroMQ where not as a datagram
            pair.listen()
            pair.pass_ms(1)
            with suppress(BlockingIOError):
                got += len(victim.recv(2000))
    assert 0 < got <= sent


def test_a_new_address_of_an_honest_coupling_misses_no_wave_and_is_proved_at_once(make: Maker) -> None:
    """Its translator gives it another port: each wave of these ticks arrives, the first ones over ZeroMQ."""
    pair = make()
    tick = pair.open()
    before = pair.environment.address
    pair.client._socket.close()
    pair.client._socket = DatagramSocket.unbound(pair.clock)._socket
    pair.client._filter()
    for k in range(tick, tick + 20):
        assert [None if one is None else one.tick for one in pair.exchange(k)] == [k, k]
    assert pair.environment.address != before
    assert pair.environment._replies is not None
    assert pair.environment._replies.certain
