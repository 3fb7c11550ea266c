"""The door: which peers are admitted, how both kinds are counted, and when a crowd shuts it."""

from __future__ import annotations

import os
import resource
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path

import pytest
import zmq
from hypothesis import given
from hypothesis import strategies as st
from zmq import Event
from zmq.utils import z85

from manyhands.protocol.clock import Duration
from manyhands.protocol.keys import KeyPair, KeyRing, new_pair
from manyhands.protocol.limits import DOOR_BURST, DOOR_FAILURES, DOOR_SHUT_MS, MAX_CONTROL_BYTES
from manyhands.protocol.transport import Trouble, zeromq
from manyhands.protocol.transport import door as doorkeeper_module
from manyhands.protocol.transport import door as monitor
from manyhands.protocol.transport.door import Doorkeeper, NotAdmitted, judge
from manyhands.protocol.transport.zeromq import ZmqTransport

MS = 1_000_000
LONG = Duration(10_000 * MS)
LONG_MS = 10_000
PAIRS = {name: new_pair() for name in ("supervisor", "cx", "dx", "dy", "stranger")}
PLAIN_GREETING = b"\xff" + bytes(8) + b"\x7f\x03\x00" + b"NULL".ljust(20, b"\0") + bytes(32)  # of ZMTP 3.0
ROOM = 4 * DOOR_BURST  # as many connections may be open besides those of members


def ring(name: str, *peers: str, pair: KeyPair | None = None) -> KeyRing:
    return KeyRing(name, pair or PAIRS[name], {peer: PAIRS[peer].public for peer in peers})


def raw(public: str) -> bytes:
    return z85.decode(public.encode())


ADMITS = {b"cx-dx": {raw(PAIRS["dx"].public): "dx"}, b"control": {raw(PAIRS["cx"].public): "cx"}}
KNOWN = [raw(PAIRS[name].public) for name in ("cx", "dx", "dy")]


class Test_the_answer_to_a_zap_request:
    def request(self, key: str = "dx", domain: bytes = b"cx-dx", mechanism: bytes = b"CURVE") -> list[bytes]:
        return [b"1.0", b"7", domain, b"127.0.0.1", b"", mechanism, raw(PAIRS[key].public)]

    def test_the_right_key_is_admitted_under_its_name(self) -> None:
        reply, refused = judge(self.request(), ADMITS, KNOWN)
        assert reply == [b"1.0", b"7", b"200", b"OK", b"dx", b""]
        assert refused is None

    @pytest.mark.parametrize(
        ("changes", "why"),
        [
            ({"key": "dy"}, NotAdmitted.WRONG_KEY),
            ({"key": "cx"}, NotAdmitted.WRONG_KEY),  # admitted, but at another door
            ({"key": "stranger"}, NotAdmitted.UNKNOWN_KEY),
            ({"domain": b"elsewhere"}, NotAdmitted.WRONG_KEY),
            ({"domain": b""}, NotAdmitted.WRONG_KEY),
            ({"mechanism": b"NULL"}, NotAdmitted.NO_KEY),
            ({"mechanism": b"PLAIN"}, NotAdmitted.NO_KEY),
        ],
    )
    def test_any_other_is_not(self, changes: dict[str, str | bytes], why: NotAdmitted) -> None:
        reply, refused = judge(self.request(**changes), ADMITS, KNOWN)  # type: ignore[arg-type]
        assert reply[:3] == [b"1.0", b"7", b"400"]
        assert reply[4:] == [b"", b""]
        assert refused is why

    @given(st.lists(st.binary(max_size=40), max_size=9))
    def test_nothing_else_is_ever_admitted_and_nothing_raises(self, request_frames: list[bytes]) -> None:
        reply, refused = judge(request_frames, ADMITS, KNOWN)
        assert len(reply) == 6
        assert reply[2] == b"400"
        assert refused is not None

    @given(cut=st.integers(0, 6), extra=st.lists(st.binary(max_size=4), max_size=2))
    def test_a_good_request_cut_short_or_made_longer_is_refused(self, cut: int, extra: list[bytes]) -> None:
        frames = self.request()[:cut] + extra
        assert judge(frames, ADMITS, KNOWN)[0][2] == b"400"
        if extra:
            assert judge(self.request() + extra, ADMITS, KNOWN)[0][2] == b"400"


class House:
    """A process with one door (cx-dx, for dx alone) and another for members dx and dy, under a clock of the test's."""

    def __init__(self) -> None:
        self.now = 1_000_000 * MS
        self.context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self.keeper = Doorkeeper(self.context, ring("cx", "dx", "dy"), now=lambda: self.now)
        self.link, self.port = self._door(zmq.PAIR, "cx-dx", ("dx",))
        self.hub, self.hub_port = self._door(zmq.ROUTER, "control", ("dx", "dy"))

    def _door(self, kind: int, domain: str, admits: tuple[str, ...]) -> tuple[zmq.Socket[bytes], int]:
        made: zmq.Socket[bytes] = self.context.socket(kind)
        made.setsockopt(zmq.LINGER, 0)
        self.keeper.guard(made, domain, admits)
        made.bind("tcp://127.0.0.1:*")
        return made, int(made.getsockopt_string(zmq.LAST_ENDPOINT).rpartition(":")[2])

    def attend_until(self, done: Callable[[dict[str, int]], bool]) -> dict[str, int]:
        """Attend, whenever there is something to attend to, until what was refused is so."""
        poller = zmq.Poller()
        for knocking in self.keeper.knocking:
            poller.register(knocking, zmq.POLLIN)
        while True:
            self.keeper.attend()
            refused = self.keeper.refused()
            if done(refused):
                return refused
            assert poller.poll(LONG_MS), f"nothing more happened, and what was refused is {refused}"

    def pass_time(self, ms: int) -> None:
        self.now += ms * MS

    def close(self) -> None:
        self.keeper.close()
        self.link.close()
        self.hub.close()
        self.context.term()


@pytest.fixture
def house() -> Iterator[House]:
    made = House()
    yield made
    made.close()


@pytest.fixture
def outside() -> Iterator[ExitStack]:
    """Connections from outside, closed before the house is."""
    with ExitStack() as stack:
        yield stack


def visitor(
    outside: ExitStack, port: int, who: str, kind: int = zmq.DEALER, *, server: str = "cx", shows: str | None = None
) -> zmq.Socket[bytes]:
    """A ZeroMQ peer with the keys of ``who`` that ``shows`` a public key and does not retry."""
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    outside.callback(context.term)
    made: zmq.Socket[bytes] = context.socket(kind)
    outside.callback(made.close, 0)
    made.setsockopt(zmq.RECONNECT_IVL, -1)
    made.setsockopt(zmq.CURVE_SERVERKEY, PAIRS[server].public.encode())
    made.setsockopt(zmq.CURVE_PUBLICKEY, PAIRS[shows or who].public.encode())
    made.setsockopt(zmq.CURVE_SECRETKEY, PAIRS[who].secret.encode())
    made.connect(f"tcp://127.0.0.1:{port}")
    return made


def knock(visiting: zmq.Socket[bytes], frame: bytes) -> None:
    """Send if the connection still lasts: one without a valid proof ends, and send would wait for ever."""
    with suppress(zmq.Again):
        visiting.send(frame, zmq.DONTWAIT)


def raw_client(outside: ExitStack, port: int) -> socket.socket:
    return outside.enter_context(socket.create_connection(("127.0.0.1", port)))


def crowd(outside: ExitStack, port: int, size: int) -> list[socket.socket]:
    return [raw_client(outside, port) for _ in range(size)]


@pytest.mark.parametrize(
    ("who", "server", "why"),
    [
        ("stranger", "cx", NotAdmitted.UNKNOWN_KEY),
        ("dy", "cx", NotAdmitted.WRONG_KEY),
        (None, "cx", NotAdmitted.NO_KEY),
        ("dx", "stranger", NotAdmitted.NOT_PROVED),  # expects a different server
    ],
)
def test_each_kind_of_stranger_is_counted_once(
    who: str | None, server: str, why: NotAdmitted, house: House, outside: ExitStack
) -> None:
    if who is None:
        raw_client(outside, house.port).sendall(PLAIN_GREETING)
    else:
        knock(visitor(outside, house.port, who, zmq.PAIR, server=server), b"let me in")
    house.attend_until(lambda refused: refused == {why.value: 1})
    assert house.link.poll(0) == 0


def test_somebody_elses_public_key_is_of_no_use(house: House, outside: ExitStack) -> None:
    """dx's public key without its secret."""
    knock(visitor(outside, house.port, "stranger", zmq.PAIR, shows="dx"), b"I am dx")
    house.attend_until(lambda refused: refused == {"not_proved": 1})
    assert house.link.poll(0) == 0


def test_what_comes_to_nothing_is_unfinished(house: House, outside: ExitStack) -> None:
    raw_client(outside, house.port)
    raw_client(outside, house.port).sendall(b"GET / HTTP/1.1\r\n\r\n" * 4)
    raw_client(outside, house.port).sendall(b"\xff\0\0\0\0\0\0\0\x01\x7f\x03")  # half of a greeting
    assert house.attend_until(lambda refused: refused.get("unfinished") == 3) == {"unfinished": 3}


def test_reported_events_are_counted_without_a_separate_look(house: House, outside: ExitStack) -> None:
    house.keeper.attend()
    raw_client(outside, house.port)
    assert house.keeper._doors[0].monitor.poll(LONG_MS)
    assert house.keeper.refused() == {"unfinished": 1}


def test_the_right_peer_may_return_and_a_second_one_is_counted(house: House, outside: ExitStack) -> None:
    for visit in range(3):
        with ExitStack() as stay:
            dx = visitor(stay, house.port, "dx", zmq.PAIR)
            dx.send(b"here")
            while not house.link.poll(10):
                house.keeper.attend()
            assert house.link.recv() == b"here"
            assert house.keeper.refused() == ({} if visit < 2 else {"second_peer": 1})
            if visit == 1:
                visitor(stay, house.port, "dx", zmq.PAIR)
                assert house.attend_until(lambda refused: "second_peer" in refused) == {"second_peer": 1}
        door = house.keeper._doors[0]
        house.attend_until(lambda _, door=door: not door._open)  # type: ignore[misc]


def test_members_of_a_hub_may_come_more_than_once(house: House, outside: ExitStack) -> None:
    for name in ("dx", "dy", "dx"):
        visitor(outside, house.hub_port, name).send(b"here")
    for _ in range(3):
        while not house.hub.poll(10):
            house.keeper.attend()
        house.hub.recv_multipart()
    assert house.keeper.refused() == {}


def exchange(house: House, dx: zmq.Socket[bytes], word: bytes) -> None:
    """Send a frame each way over an existing connection, without attending to the door."""
    dx.send(word)
    assert house.link.poll(LONG_MS)
    assert house.link.recv() == word
    house.link.send(word)
    assert dx.poll(LONG_MS)
    assert dx.recv() == word


@pytest.fixture
def established(house: House, outside: ExitStack) -> zmq.Socket[bytes]:
    dx: zmq.Socket[bytes] = visitor(outside, house.port, "dx", zmq.PAIR)
    dx.send(b"here")
    while not house.link.poll(10):
        house.keeper.attend()
    house.link.recv()
    return dx


def test_a_crowd_shuts_the_door_and_those_inside_go_on(
    house: House, outside: ExitStack, established: zmq.Socket[bytes]
) -> None:
    with ExitStack() as leaving:
        crowd(leaving, house.port, DOOR_BURST + 1)
        house.attend_until(lambda refused: refused.get("unfinished") == DOOR_BURST + 1)
        assert house.keeper.refused()["shut"] == 1
        assert house.keeper.shut
        exchange(house, established, b"through a shut door")
    late = socket.socket()
    outside.callback(late.close)
    late.setblocking(False)
    late.connect_ex(("127.0.0.1", house.port))
    poller = zmq.Poller()
    poller.register(late.fileno(), zmq.POLLOUT)
    house.pass_time(DOOR_SHUT_MS - 1)
    house.keeper.attend()
    assert house.keeper.shut
    assert not poller.poll(50), "the kernel let somebody in at a shut door"  # a connection takes microseconds
    house.pass_time(1)
    house.attend_until(lambda _: not house.keeper.shut)
    assert poller.poll(LONG_MS), "the door did not open again"  # its next try comes a second after the first
    assert late.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR) == 0
    exchange(house, established, b"through an open door")
    refused = house.attend_until(lambda refused: refused["unfinished"] == DOOR_BURST + 2)
    assert refused == {"unfinished": DOOR_BURST + 2, "shut": 1}


def test_allowed_failures_keep_it_open_and_windows_count_apart(house: House, outside: ExitStack) -> None:
    with ExitStack() as leaving:
        crowd(leaving, house.port, DOOR_BURST)
        house.attend_until(lambda refused: refused.get("unfinished") == DOOR_BURST)
    house.pass_time(100)
    crowd(outside, house.port, DOOR_BURST)
    assert house.attend_until(lambda refused: refused["unfinished"] == 2 * DOOR_BURST) == {"unfinished": 2 * DOOR_BURST}


def fail(house: House, so_far: int) -> None:
    """Make one more handshake with an unknown key and wait for its end."""
    with ExitStack() as leaving:
        visitor(leaving, house.port, "stranger", zmq.PAIR)
        house.attend_until(lambda refused: {**refused, "shut": 1} == {"unknown_key": so_far + 1, "shut": 1})


def test_repeated_failures_shut_it_before_they_are_a_crowd(house: House) -> None:
    for count in range(DOOR_FAILURES + 1):
        assert not house.keeper.shut
        fail(house, count)
    assert house.keeper.shut
    assert house.keeper.refused()["shut"] == 1


def test_failures_are_counted_by_the_second(house: House) -> None:
    for count in range(DOOR_FAILURES):
        fail(house, count)
    house.pass_time(1000)
    for count in range(DOOR_FAILURES, 2 * DOOR_FAILURES):
        fail(house, count)
    assert not house.keeper.shut


def test_a_crowd_before_one_door_leaves_the_other_open(house: House, outside: ExitStack) -> None:
    crowd(outside, house.port, 2 * DOOR_BURST)
    house.attend_until(lambda refused: "shut" in refused)
    visitor(outside, house.hub_port, "dy").send(b"here")
    while not house.hub.poll(10):
        house.keeper.attend()


def test_slow_connections_shut_it_until_they_are_gone(house: House, outside: ExitStack) -> None:
    """Few at a time, but none of them leaves: they are descriptors of this process."""
    with ExitStack() as leaving:
        for done in range(0, ROOM + 2, DOOR_BURST):
            some = min(DOOR_BURST, ROOM + 2 - done)
            crowd(leaving, house.port, some)
            house.attend_until(lambda refused, n=done + some: refused.get("unfinished") == n)  # type: ignore[misc]
            house.pass_time(100)
        assert house.keeper.refused() == {"unfinished": ROOM + 2, "shut": 1}
        house.pass_time(10 * DOOR_SHUT_MS)
        house.keeper.attend()
        assert house.keeper.shut
    house.attend_until(lambda _: not house.keeper.shut)


def test_a_shut_door_is_looked_at_even_where_nobody_knocks(house: House, outside: ExitStack) -> None:
    assert house.keeper.at_most(-1) == -1
    assert house.keeper.at_most(LONG_MS) == LONG_MS
    crowd(outside, house.port, DOOR_BURST + 2)
    house.attend_until(lambda _: house.keeper.shut)
    assert 0 < house.keeper.at_most(-1) <= DOOR_SHUT_MS
    assert 0 < house.keeper.at_most(LONG_MS) <= DOOR_SHUT_MS
    assert house.keeper.at_most(0) == 0


def test_a_process_without_a_descriptor_left_still_shuts_its_door(house: House, outside: ExitStack) -> None:
    """A crowd may use them all up; then nothing that attends may need one more."""
    before = len(os.listdir("/proc/self/fd"))
    crowd(outside, house.port, DOOR_BURST + 2)
    while len(os.listdir("/proc/self/fd")) < before + 2 * (DOOR_BURST + 2):  # both ends of each are ours
        os.sched_yield()
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(map(int, os.listdir("/proc/self/fd"))) + 1, hard))
    taken: list[int] = []
    try:
        with pytest.raises(OSError, match="Too many open files"):
            taken.extend(iter(lambda: os.dup(0), None))
        house.attend_until(lambda refused: "shut" in refused)
    finally:
        for descriptor in taken:
            os.close(descriptor)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_a_door_whose_socket_is_closed_is_left_alone(house: House, outside: ExitStack) -> None:
    """Another socket may have its descriptor by now, and a filter would cut that off."""
    door = house.keeper._doors[0]
    house.keeper.attend()
    crowd(outside, house.port, DOOR_BURST + 2)
    while door._came <= DOOR_BURST:  # the door reads every event, and acts on none yet
        assert door.monitor.poll(LONG_MS)
        door._listen_to_monitor()
    house.link.close()
    assert door._listener is not None
    while Path(f"/proc/self/fd/{door._listener}").exists():
        os.sched_yield()
    other = outside.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
    other.bind(("127.0.0.1", 0))
    if other.fileno() != door._listener:
        outside.callback(os.close, os.dup2(other.fileno(), door._listener))
    house.keeper.attend()
    assert not house.keeper.shut
    other.sendto(b"still heard", other.getsockname())
    assert other.recv(100, socket.MSG_DONTWAIT) == b"still heard"


@pytest.mark.parametrize("order", [("keeper", "sockets"), ("sockets", "keeper")])
def test_closing_in_either_order_and_twice(order: tuple[str, str]) -> None:
    """The fixture of all tests sees to it that nothing is left."""
    house = House()
    for what in (*order, *order):
        if what == "keeper":
            house.keeper.close()
        else:
            house.link.close()
            house.hub.close()
    house.keeper.attend()
    house.context.term()


def test_a_name_without_a_key_is_neither_admitted_nor_introduced(house: House) -> None:
    made: zmq.Socket[bytes] = house.context.socket(zmq.PAIR)
    with pytest.raises(KeyError, match="dz"):
        house.keeper.guard(made, "cx-dz", ("dz",))
    with pytest.raises(KeyError, match="dz"):
        house.keeper.introduce(made, "dz")
    made.close()


AUTH, PROTOCOL, BROKEN = Event.HANDSHAKE_FAILED_AUTH, Event.HANDSHAKE_FAILED_PROTOCOL, Event.HANDSHAKE_FAILED_NO_DETAIL
ATTEMPT = (BROKEN, Event.DISCONNECTED, Event.CONNECT_RETRIED)


@pytest.mark.parametrize(
    ("events", "expected"),
    [
        ([], None),
        ([Event.CONNECT_RETRIED], Trouble.NOBODY),
        ([Event.CONNECT_RETRIED, Event.HANDSHAKE_SUCCEEDED], None),
        ([Event.HANDSHAKE_SUCCEEDED, Event.DISCONNECTED], Trouble.LOST),
        ([Event.HANDSHAKE_SUCCEEDED, Event.DISCONNECTED, Event.CONNECT_RETRIED], Trouble.LOST),
        ([Event.HANDSHAKE_SUCCEEDED, Event.DISCONNECTED, *ATTEMPT], Trouble.LOST),
        ([Event.HANDSHAKE_SUCCEEDED, Event.DISCONNECTED, Event.HANDSHAKE_SUCCEEDED], None),
        ([AUTH, Event.DISCONNECTED], Trouble.NOT_ADMITTED),
        ([PROTOCOL, Event.DISCONNECTED], Trouble.NOT_PROVED),
        ([*ATTEMPT, PROTOCOL], Trouble.NOT_PROVED),
        (ATTEMPT, Trouble.BROKEN_OFF),
        ([Event.CONNECT_RETRIED, *ATTEMPT], Trouble.BROKEN_OFF),
        ([*ATTEMPT, Event.HANDSHAKE_SUCCEEDED], None),
        (ATTEMPT * 19, Trouble.BROKEN_OFF),
        (ATTEMPT * 20, Trouble.NOT_PROVED),
    ],
)
def test_what_a_connections_events_mean(events: Sequence[Event], expected: Trouble | None) -> None:
    fate = monitor.Fate()
    for event in events:
        fate.take(event)
    assert fate.trouble is expected


class Test_what_a_node_is_told_of_its_line:
    """The side that connects: why it is not let in, in :class:`Trouble`."""

    @pytest.fixture
    def supervisor(self) -> Iterator[ZmqTransport]:
        made = ZmqTransport.tcp(ring("supervisor", "dx"))
        yield made
        made.close()

    def trouble(self, outside: ExitStack, supervisor: ZmqTransport, keys: KeyRing | None) -> Trouble:
        hub, endpoint = supervisor.bind_hub("control", ["dx"])
        node = ZmqTransport.tcp(keys)
        outside.callback(node.close)
        line = node.join(endpoint, "dx")
        while (found := line.trouble()) in (None, Trouble.BROKEN_OFF):
            hub.wait(Duration(5 * MS))
        assert found is not None
        return found

    @pytest.fixture(autouse=True)
    def few_attempts(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(monitor, "BROKEN_OFF_IN_A_ROW", 3)

    def test_a_host_too_busy_to_admit_anybody_is_awaited(
        self, outside: ExitStack, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """It answers no peer until connections have timed out; that proves nothing about a key."""
        monkeypatch.setattr(monitor, "BROKEN_OFF_IN_A_ROW", 20)
        monkeypatch.setattr(doorkeeper_module, "HANDSHAKE_MS", 50)
        supervisor, node = ZmqTransport.tcp(ring("supervisor", "dx")), ZmqTransport.tcp(ring("dx", "supervisor"))
        outside.callback(supervisor.close)
        outside.callback(node.close)
        hub, endpoint = supervisor.bind_hub("control", ["dx"])
        line = node.join(endpoint, "dx")
        assert line.send(b"here")
        while line.trouble() is None:
            assert line.recv(Duration(5 * MS)) is None
        assert line.trouble() is Trouble.BROKEN_OFF
        while (heard := hub.recv()) is None:
            hub.wait(Duration(5 * MS))
        assert heard == ("dx", b"here")
        assert line.trouble() is None

    def test_not_admitted(self, outside: ExitStack, supervisor: ZmqTransport) -> None:
        keys = ring("dx", "supervisor", pair=PAIRS["stranger"])
        assert self.trouble(outside, supervisor, keys) is Trouble.NOT_ADMITTED
        assert supervisor.refused() == {"unknown_key": 1}

    def test_another_supervisor(self, outside: ExitStack, supervisor: ZmqTransport) -> None:
        keys = KeyRing("dx", PAIRS["dx"], {"supervisor": PAIRS["stranger"].public})
        assert self.trouble(outside, supervisor, keys) is Trouble.NOT_PROVED

    def test_plain_against_encrypted(self, outside: ExitStack, supervisor: ZmqTransport) -> None:
        assert self.trouble(outside, supervisor, None) is Trouble.NOT_PROVED

    def test_encrypted_against_plain(self, outside: ExitStack) -> None:
        plain = ZmqTransport.tcp()
        outside.callback(plain.close)
        assert self.trouble(outside, plain, ring("dx", "supervisor")) is Trouble.NOT_PROVED

    def test_nobody_there_and_then_somebody_and_then_gone(self, outside: ExitStack) -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            address = f"127.0.0.1:{probe.getsockname()[1]}"
        node = ZmqTransport.tcp(ring("dx", "supervisor"))
        outside.callback(node.close)
        line = node.join(f"tcp://{address}", "dx")
        while line.trouble() is None:
            assert line.recv(Duration(5 * MS)) is None
        assert line.trouble() is Trouble.NOBODY
        supervisor = ZmqTransport.tcp(ring("supervisor", "dx"))
        outside.callback(supervisor.close)
        hub, _ = supervisor.bind_hub("control", ["dx"], address)
        assert line.send(b"here")
        while hub.recv() is None:
            hub.wait(LONG)
        assert line.trouble() is None
        supervisor.close()
        while line.trouble() is None:
            assert line.recv(Duration(5 * MS)) is None
        assert line.trouble() in (Trouble.LOST, Trouble.NOBODY)
        line.close()
        assert line.trouble() is not None


def test_the_longest_frame_passes_encrypted_too() -> None:
    """Encryption makes it longer on the wire, where ZeroMQ measures it."""
    cx, dx = ZmqTransport.tcp(ring("cx", "dx")), ZmqTransport.tcp(ring("dx", "cx"))
    try:
        bound, endpoint = cx.bind("cx-dx", "dx")
        connected = dx.connect(endpoint, "cx")
        assert connected.send(bytes(MAX_CONTROL_BYTES))
        assert bound.recv(LONG) == bytes(MAX_CONTROL_BYTES)
    finally:
        dx.close()
        cx.close()


def test_a_hubs_name_stays_with_its_first_connection_until_forgotten(outside: ExitStack) -> None:
    supervisor = ZmqTransport.tcp(ring("supervisor", "dx"))
    outside.callback(supervisor.close)
    hub, endpoint = supervisor.bind_hub("control", ["dx"])
    first, second = (ZmqTransport.tcp(ring("dx", "supervisor")) for _ in range(2))
    outside.callback(first.close)
    outside.callback(second.close)
    one, other = first.join(endpoint, "dx"), second.join(endpoint, "dx")

    def receive() -> tuple[str, bytes]:
        while (received := hub.recv()) is None:
            hub.wait(LONG)
        return received

    assert one.send(b"first")
    assert receive() == ("dx", b"first")
    assert other.send(b"second")
    while hub.dropped["second_route"] == 0:
        hub.wait(LONG)
        assert hub.recv() is None
    assert hub.send("dx", b"to the first")
    assert one.recv(LONG) == b"to the first"
    assert other.recv(Duration(0)) is None
    hub.forget("dx")
    assert other.send(b"again")
    assert receive() == ("dx", b"again")
    assert hub.send("dx", b"to the second")
    assert other.recv(LONG) == b"to the second"


@pytest.mark.parametrize("speaks", [False, True], ids=["silent", "speaking"])
def test_a_hubs_name_passes_to_a_second_connection_only_once_the_first_is_silent(
    outside: ExitStack, monkeypatch: pytest.MonkeyPatch, speaks: bool
) -> None:
    monkeypatch.setattr(zeromq, "SILENCE_MS", 20)
    supervisor = ZmqTransport.tcp(ring("supervisor", "dx"))
    outside.callback(supervisor.close)
    hub, endpoint = supervisor.bind_hub("control", ["dx"])
    first, second = (ZmqTransport.tcp(ring("dx", "supervisor")) for _ in range(2))
    outside.callback(first.close)
    outside.callback(second.close)
    one, other = first.join(endpoint, "dx"), second.join(endpoint, "dx")

    def handled(frames: int) -> list[bytes]:
        heard, until = [], hub.handled + frames
        while hub.handled < until:
            hub.wait(LONG)
            received = hub.recv()
            heard += [] if received is None else [received[1]]
        return heard

    assert one.send(b"first")
    assert handled(1) == [b"first"]
    began, rounds, heard = time.monotonic_ns(), 0, list[bytes]()
    while not heard and (rounds < 100 or not speaks):
        rounds += 1
        assert other.send(b"second")
        heard = handled(1)
        if speaks:
            assert one.send(b"still here")
            assert handled(1) == [b"still here"]
    assert heard == ([] if speaks else [b"second"])
    assert hub.dropped["second_route"] == rounds - len(heard) > 0
    assert hub.send("dx", b"to whom the name belongs")
    assert (one if speaks else other).recv(LONG) == b"to whom the name belongs"
    if not speaks:
        assert time.monotonic_ns() - began >= 20 * MS
        assert one.send(b"too late")
        assert handled(1) == []


def test_endless_connection_attempts_do_not_delay_a_waiting_hub(
    outside: ExitStack, monkeypatch: pytest.MonkeyPatch
) -> None:
    supervisor = ZmqTransport.tcp(ring("supervisor", "dx"))
    outside.callback(supervisor.close)
    hub, _ = supervisor.bind_hub("control", ["dx"])
    always_readable, writer = os.pipe()
    for end in (always_readable, writer):
        outside.callback(os.close, end)
    os.write(writer, b"!")
    looks: list[None] = []

    def attend(_: Doorkeeper) -> None:
        looks.append(None)
        assert len(looks) < 1_000_000, "it waits for as long as somebody knocks"

    monkeypatch.setattr(Doorkeeper, "knocking", property(lambda _: [always_readable]))
    monkeypatch.setattr(Doorkeeper, "attend", attend)
    for wait_ms in (20, 0):
        looks.clear()
        hub.wait(Duration(wait_ms * MS))
        assert looks
