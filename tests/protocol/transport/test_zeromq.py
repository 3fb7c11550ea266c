"""Properties of ZeroMQ alone: socket files, paths, descriptors, and peers of other programs."""

import os
import struct
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from socket import AF_INET, AF_UNIX
from socket import socket as raw_socket

import pytest
import zmq
from zmq.utils.monitor import parse_monitor_message, recv_monitor_message

from manyhands.protocol.clock import Duration
from manyhands.protocol.keys import KeyRing, new_pair
from manyhands.protocol.limits import MAX_CONTROL_BYTES, MAX_SOCKET_PATH
from manyhands.protocol.transport import TransportError
from manyhands.protocol.transport.door import event_of
from manyhands.protocol.transport.zeromq import Arrivals, ZmqHub, ZmqTransport

LONG = Duration(10_000_000_000)
LONG_MS = 10_000
LEAVING = 10.0  # s, that a joined thread may take to leave /proc on a busy machine


@pytest.fixture(params=["ipc", "tcp"])
def make(request: pytest.FixtureRequest, tmp_path: Path) -> Callable[[], ZmqTransport]:
    return (lambda: ZmqTransport.ipc(tmp_path)) if request.param == "ipc" else ZmqTransport.tcp


@pytest.fixture
def transport(make: Callable[[], ZmqTransport]) -> Iterator[ZmqTransport]:
    made = make()
    yield made
    made.close()


class ForeignProgram:
    """A program that speaks ZeroMQ, and not our protocol."""

    def __init__(self) -> None:
        self._context = zmq.Context()
        self._sockets: list[zmq.Socket[bytes]] = []

    def connect(self, kind: int, endpoint: str) -> "zmq.Socket[bytes]":
        socket = self._context.socket(kind)
        socket.connect(endpoint)
        self._sockets.append(socket)
        return socket

    def monitor(self, socket: "zmq.Socket[bytes]", events: int) -> "zmq.Socket[bytes]":
        monitor = socket.get_monitor_socket(events)
        self._sockets.append(monitor)
        return monitor

    def leave(self) -> None:
        for socket in self._sockets:
            socket.close(linger=0)
        self._context.term()


@pytest.fixture
def stranger() -> Iterator[ForeignProgram]:
    outside = ForeignProgram()
    yield outside
    outside.leave()


def await_event(monitor: "zmq.Socket[bytes]", event: int) -> None:
    while True:
        assert monitor.poll(LONG_MS), "the event never came"
        if recv_monitor_message(monitor)["event"] == event:
            return


@pytest.mark.parametrize("event", [one for one in zmq.Event if one < 1 << 16], ids=lambda one: one.name)
def test_a_monitors_event_is_read_as_pyzmq_reads_it(event: zmq.Event) -> None:
    frames = [struct.pack("=Hi", event, 111), b"tcp://127.0.0.1:7400"]
    assert event_of(frames) is event
    if event < 1 << 15:  # pyzmq takes the sixteen bits for a number with a sign
        assert parse_monitor_message(frames)["event"] is event


def descriptors_and_threads() -> tuple[set[str], int]:
    return set(os.listdir("/proc/self/fd")), len(os.listdir("/proc/self/task"))


def settled(wanted: tuple[set[str], int]) -> tuple[set[str], int]:
    """Descriptors and threads once no thread is on its way out.

    A thread can be joined a moment before the kernel takes it off /proc: joining waits for a word in memory to be
    cleared, which an exiting thread does before its last steps.
    """
    deadline = time.monotonic() + LEAVING
    while (found := descriptors_and_threads()) != wanted and time.monotonic() < deadline:
        os.sched_yield()
    return found


def test_closing_leaves_no_descriptor_thread_or_file(make: Callable[[], ZmqTransport], tmp_path: Path) -> None:
    before = descriptors_and_threads()
    for _ in range(3):
        one, other = make(), make()
        bound, endpoint = one.bind("cx", "dx")
        hub, hub_endpoint = one.bind_hub("supervisor", ("dx", "dy"))
        connected, node = other.connect(endpoint, "supervisor"), other.join(hub_endpoint, "dx")
        assert connected.send(b"x")
        assert bound.recv(LONG) == b"x"
        assert node.send(b"y")
        hub.wait(LONG)
        assert descriptors_and_threads() != before
        one.close()
        other.close()
        # the listing itself opens one descriptor, at the lowest free number, both times
        assert settled(before) == before
        assert list(tmp_path.iterdir()) == []


def test_closing_with_nobody_there_does_not_wait_for_ever(transport: ZmqTransport, tmp_path: Path) -> None:
    scheme = transport.bind("cx", "dx")[1].split("://")[0]
    nobody = tmp_path / "nobody" if scheme == "ipc" else "127.0.0.1:1"
    assert transport.connect(f"{scheme}://{nobody}", "supervisor").send(b"anybody?")
    transport.close()


def test_tcp_stays_on_the_loopback_and_takes_any_free_port() -> None:
    transport = ZmqTransport.tcp()
    try:
        endpoints = {transport.bind(name, "dx")[1] for name in ("a", "b")}
    finally:
        transport.close()
    assert len(endpoints) == 2
    for endpoint in endpoints:
        assert endpoint.startswith("tcp://127.0.0.1:")
        assert int(endpoint.rpartition(":")[2]) > 0


def test_an_ipc_endpoint_is_absolute(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "s").mkdir()
    transport = ZmqTransport.ipc(Path("s"))
    try:
        assert transport.bind("cx", "dx")[1] == f"ipc://{tmp_path}/s/cx"
        assert (tmp_path / "s" / "cx").is_socket()
    finally:
        transport.close()


def test_the_longest_socket_path_binds_and_longer_ones_fail_clearly(tmp_path: Path) -> None:
    directory = tmp_path / ("d" * (MAX_SOCKET_PATH - len(bytes(tmp_path)) - 1 - 5))
    directory.mkdir()
    transport = ZmqTransport.ipc(directory)
    try:
        _, endpoint = transport.bind("cccc", "dx")
        assert len(endpoint.removeprefix("ipc://")) == MAX_SOCKET_PATH
        with pytest.raises(TransportError, match=r"found a socket path of 108 bytes.*at most 107; choose a shorter"):
            transport.bind("ccccc", "dx")
    finally:
        transport.close()


def test_a_missing_directory_is_reported(tmp_path: Path) -> None:
    transport = ZmqTransport.ipc(tmp_path / "missing")
    try:
        with pytest.raises(TransportError, match=r"cannot bind ipc://.*missing/cx: No such file"):
            transport.bind("cx", "dx")
    finally:
        transport.close()


def test_a_file_in_the_way_is_not_taken_away(tmp_path: Path) -> None:
    (tmp_path / "cx").write_text("somebody's")
    transport = ZmqTransport.ipc(tmp_path)
    try:
        with pytest.raises(TransportError, match="in use; expected a name bound once"):
            transport.bind("cx", "dx")
    finally:
        transport.close()
    assert (tmp_path / "cx").read_text() == "somebody's"


def test_an_endpoint_that_zeromq_cannot_read_is_reported() -> None:
    transport = ZmqTransport.tcp()
    try:
        with pytest.raises(TransportError, match="cannot connect to 'tcp://nowhere'"):
            transport.connect("tcp://nowhere", "supervisor")
    finally:
        transport.close()


def test_an_oversized_frame_ends_the_strangers_connection_and_nothing_else(
    transport: ZmqTransport, stranger: ForeignProgram
) -> None:
    hub, endpoint = transport.bind_hub("supervisor", ("dx", "dy"))
    node = transport.join(endpoint, "dx")
    flooder = stranger.connect(zmq.DEALER, endpoint)
    monitor = stranger.monitor(flooder, zmq.EVENT_DISCONNECTED)
    flooder.send(bytes(MAX_CONTROL_BYTES + 1))
    await_event(monitor, zmq.EVENT_DISCONNECTED)
    assert hub.recv() is None
    assert node.send(b"still here")
    hub.wait(LONG)
    assert hub.recv() == ("dx", b"still here")


@pytest.mark.parametrize("end", ["link", "hub", "outlet"])
def test_a_stranger_without_zeromq_is_no_peer_of_an_old_version(transport: ZmqTransport, end: str) -> None:
    """libzmq would abort the process if it closed the socket just when such a peer's first message came."""
    match end:
        case "link":
            _, endpoint = transport.bind("cx", "dx")
        case "hub":
            _, endpoint = transport.bind_hub("supervisor", ("dx",))
        case _:
            _, endpoint = transport.bind_outlet("cx", "dx")
    scheme, _, place = endpoint.partition("://")
    host, _, port = place.rpartition(":")
    over_tcp = scheme == "tcp"
    with raw_socket(AF_INET if over_tcp else AF_UNIX) as outside:
        outside.settimeout(LONG_MS / 1000)
        outside.connect((host, int(port)) if over_tcp else place)
        outside.sendall(b"GET / HTTP/1.1\r\n\r\n" * 100)
        try:
            while outside.recv(4096):
                pass
        except ConnectionResetError:  # it was closed with bytes unread
            pass


def test_a_second_peer_of_a_link_is_not_heard(transport: ZmqTransport, stranger: ForeignProgram) -> None:
    bound, endpoint = transport.bind("cx", "dx")
    connected = transport.connect(endpoint, "supervisor")
    assert connected.send(b"first")
    assert bound.recv(LONG) == b"first"
    intruder = stranger.connect(zmq.PAIR, endpoint)
    monitor = stranger.monitor(intruder, zmq.EVENT_HANDSHAKE_SUCCEEDED)
    intruder.send(b"intruding")
    await_event(monitor, zmq.EVENT_HANDSHAKE_SUCCEEDED)
    assert bound.recv(Duration(20_000_000)) is None
    assert connected.send(b"second")
    assert bound.recv(LONG) == b"second"


def test_a_hub_counts_and_drops_anything_except_named_nodes_single_frames(
    transport: ZmqTransport, stranger: ForeignProgram
) -> None:
    hub, endpoint = transport.bind_hub("supervisor", ("dx", "dy"))
    assert isinstance(hub, ZmqHub)
    node = transport.join(endpoint, "dx")
    nameless = stranger.connect(zmq.DEALER, endpoint)  # ZeroMQ gives it an identity that is no name
    nameless.send(b"frame")
    while hub.dropped["not_a_frame"] < 1:
        hub.wait(LONG)
        assert hub.recv() is None
    request = stranger.connect(zmq.REQ, endpoint)  # puts an empty frame before its own
    request.send(b"frame")
    while hub.dropped["not_a_frame"] < 2:
        hub.wait(LONG)
        assert hub.recv() is None
    assert node.send(b"fine")
    hub.wait(LONG)
    assert hub.recv() == ("dx", b"fine")


def test_one_question_finds_the_frames_of_all_links_in_their_order(make: Callable[[], ZmqTransport]) -> None:
    ours, theirs = make(), make()
    try:
        bound = [ours.bind(f"a{i}", "peer") for i in range(4)]
        ends = [theirs.connect(endpoint, "us") for _, endpoint in bound]
        links = [link for link, _ in bound]
        for i, end in enumerate(ends):
            assert end.send(b"hello")
            assert links[i].recv(LONG) == b"hello"
        arrivals = Arrivals()
        assert arrivals.take(links, 3) == []
        for number in range(5):
            ends[1].send(bytes([number]))
        ends[3].send(b"x")
        found: list[tuple[int, bytes]] = []
        deadline = time.monotonic() + LEAVING
        while len(found) < 6 and time.monotonic() < deadline:
            some = arrivals.take(links, 3)
            assert sum(which == 1 for which, _ in some) <= 3
            found += some
        assert [frame for which, frame in found if which == 1] == [bytes([number]) for number in range(5)]
        assert [frame for which, frame in found if which == 3] == [b"x"]
        # a link that was lost is none, and a new one in its place is read
        again, endpoint = ours.bind("again", "peer")
        late = theirs.connect(endpoint, "us")
        late.send(b"back")
        found = []
        while not found and time.monotonic() < deadline:
            found += arrivals.take([None, links[1], again, None], 3)
        assert found == [(2, b"back")]
        links[1].close()
        assert arrivals.take([None, links[1], again, None], 3) == []
    finally:
        theirs.close()
        ours.close()


def test_beside_tcp_a_link_without_an_address_is_a_file_that_needs_no_key(tmp_path: Path) -> None:
    """And one with an address is neither in the directory nor open to a program without a key."""
    ring = KeyRing("cx", new_pair(), {})
    transport = ZmqTransport.tcp(ring, tmp_path)
    try:
        local, endpoint = transport.bind("cx-dx", "dx")
        assert endpoint == f"ipc://{tmp_path}/cx-dx"
        foreign = ForeignProgram()
        foreign.connect(zmq.PAIR, endpoint).send(b"here")
        assert local.recv(LONG) == b"here"
        foreign.leave()
        with pytest.raises(TransportError, match="no public key of dx"):
            transport.bind("cx-dx.1", "dx", "127.0.0.1:*")
        with pytest.raises(TransportError, match=r"expected ipc://\.\.\. or tcp://\.\.\."):
            transport.connect("inproc://x", "dx")
    finally:
        transport.close()


def test_a_node_elsewhere_connects_to_no_file(tmp_path: Path) -> None:
    transport = ZmqTransport.of("tcp", None)
    try:
        with pytest.raises(TransportError, match=r"expected tcp://\.\.\."):
            transport.connect(f"ipc://{tmp_path}/cx-dx", "dx")
    finally:
        transport.close()
