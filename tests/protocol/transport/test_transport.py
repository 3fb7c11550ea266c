"""Conformance of every transport with the promises of the interfaces, one by one."""

import os
import signal
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from types import FrameType
from typing import TYPE_CHECKING

import pytest

from manyhands.protocol.clock import Duration
from manyhands.protocol.limits import LINK_QUEUE_FRAMES, MAX_CONTROL_BYTES
from manyhands.protocol.transport import Hub, Link, TransportError, milliseconds

if TYPE_CHECKING:
    from conftest import Ends

MS = 1_000_000
LONG = Duration(10_000 * MS)  # far longer than anything here takes; never waited for in full


@pytest.fixture
def linked(ends: "Ends") -> tuple[Link, Link]:
    """The bound and the connected end of a link, known to be joined."""
    bound, endpoint = ends.binder.bind("cx", "dx")
    connected = ends.connector.connect(endpoint, "supervisor")
    assert connected.send(b"here")
    assert bound.recv(LONG) == b"here"
    return bound, connected


@pytest.fixture
def joined(ends: "Ends") -> tuple[Hub, Link, Link]:
    """A hub and two nodes, dx and dy, known to be joined."""
    hub, endpoint = ends.binder.bind_hub("supervisor", ("dx", "dy"))
    nodes = ends.join(endpoint, "dx"), ends.join(endpoint, "dy")
    for node in nodes:
        assert node.send(b"here")
    assert {receive(hub), receive(hub)} == {("dx", b"here"), ("dy", b"here")}
    return hub, *nodes


def receive(hub: Hub) -> tuple[str, bytes]:
    while (received := hub.recv()) is None:
        hub.wait(LONG)
    return received


def test_order_and_borders_are_kept_both_ways(linked: tuple[Link, Link]) -> None:
    frames = [bytes([i]) * (i % 7) for i in range(LINK_QUEUE_FRAMES // 2)]  # the empty frame among them
    for sender, receiver in (linked, linked[::-1]):
        assert all(sender.send(frame) for frame in frames)
        assert [receiver.recv(LONG) for _ in frames] == frames
        assert receiver.recv(Duration(0)) is None


def test_ping_pong_between_threads(linked: tuple[Link, Link]) -> None:
    bound, connected = linked

    def echo() -> None:
        for _ in range(200):
            frame = bound.recv(LONG)
            assert frame is not None
            assert bound.send(frame)

    with ThreadPoolExecutor(1) as other:
        echoing = other.submit(echo)
        for i in range(200):
            assert connected.send(str(i).encode())
            assert connected.recv(LONG) == str(i).encode()
        echoing.result()


def test_without_a_peer_sending_is_declined(ends: "Ends") -> None:
    bound, _ = ends.binder.bind("cx", "dx")
    assert bound.send(b"anybody?") is False


def test_a_peer_that_does_not_read_does_not_block_the_sender(linked: tuple[Link, Link]) -> None:
    bound, connected = linked
    frame = bytes(60_000)  # so that the kernel's buffers fill up soon too
    sent = 0
    while connected.send(frame):
        sent += 1
        assert sent < 20 * LINK_QUEUE_FRAMES
    assert sent >= LINK_QUEUE_FRAMES // 2
    for _ in range(sent):
        assert bound.recv(LONG) == frame


@pytest.mark.parametrize("timeout_ms", [20, 5])
def test_receiving_waits_as_long_as_asked(linked: tuple[Link, Link], timeout_ms: int) -> None:
    bound, connected = linked
    before = time.monotonic_ns()
    assert bound.recv(Duration(timeout_ms * MS)) is None
    assert time.monotonic_ns() - before >= timeout_ms * MS
    assert bound.recv(Duration(0)) is None
    assert bound.recv(Duration(-5)) is None
    assert connected.send(b"late")
    assert bound.recv(None) == b"late"
    assert bound.recv(Duration(timeout_ms * MS)) is None


@pytest.mark.parametrize(
    ("timeout", "expected"),
    [(None, -1), (0, 0), (-1, 0), (1, 1), (MS, 1), (MS + 1, 2), (2**63, 2**31 - 1)],
)
def test_timeouts_are_rounded_up_to_milliseconds(timeout: int | None, expected: int) -> None:
    assert milliseconds(None if timeout is None else Duration(timeout)) == expected


class Interrupted(Exception):
    """What the test's signal handler raises."""


def alarm() -> None:
    """Ask for alarms until one is heeded: one that comes just before the wait begins does not end it."""
    signal.setitimer(signal.ITIMER_REAL, 0.02, 0.02)


def no_alarm() -> None:
    signal.setitimer(signal.ITIMER_REAL, 0)


def interrupt(_number: int, _frame: FrameType | None) -> None:
    no_alarm()
    raise Interrupted


def test_waiting_for_ever_outlasts_an_earlier_timeout_and_a_signal(linked: tuple[Link, Link]) -> None:
    """The frame is sent by a signal handler that returns, well after the earlier timeout has passed again."""
    bound, connected = linked
    assert bound.recv(Duration(MS)) is None
    before = signal.signal(signal.SIGALRM, lambda *_: connected.send(b"in the handler"))
    try:
        alarm()
        assert bound.recv(None) == b"in the handler"
    finally:
        no_alarm()
        signal.signal(signal.SIGALRM, before)


def wait_with_alarm(wait: Callable[[Duration | None], object], timeout: Duration | None) -> None:
    alarm()
    wait(timeout)


@pytest.mark.parametrize("timeout", [None, LONG])
def test_a_signal_handlers_exception_gets_through(ends: "Ends", timeout: Duration | None) -> None:
    link, _ = ends.binder.bind("cx", "dx")
    hub, _ = ends.binder.bind_hub("supervisor", ("dx", "dy"))
    before = signal.signal(signal.SIGALRM, interrupt)
    try:
        for wait in (link.recv, hub.wait):
            with pytest.raises(Interrupted):
                wait_with_alarm(wait, timeout)
    finally:
        no_alarm()
        signal.signal(signal.SIGALRM, before)


def test_the_longest_frame_passes_and_a_longer_one_is_refused_here(
    linked: tuple[Link, Link], joined: tuple[Hub, Link, Link]
) -> None:
    longest = bytes(MAX_CONTROL_BYTES)
    bound, connected = linked
    hub, node, _ = joined
    assert connected.send(longest)
    assert bound.recv(LONG) == longest
    assert node.send(longest)
    assert receive(hub) == ("dx", longest)
    for send in (bound.send, connected.send, node.send, lambda frame: hub.send("dx", frame)):
        with pytest.raises(ValueError, match="found a frame of 1048577 bytes; expected at most 1048576"):
            send(longest + b"\x00")
    assert connected.send(b"still fine")
    assert bound.recv(LONG) == b"still fine"


@pytest.mark.parametrize("what", ["link", "transport"])
def test_what_was_sent_before_closing_arrives(linked: tuple[Link, Link], ends: "Ends", what: str) -> None:
    bound, connected = linked
    frames = [bytes([i]) * 60_000 for i in range(LINK_QUEUE_FRAMES // 4)]  # far more than the kernel's buffers hold
    for frame in frames:
        assert connected.send(frame)
    if what == "link":
        connected.close()
    ends.close_connector()
    for frame in frames:
        assert bound.recv(LONG) == frame


def test_a_closed_link_and_hub_say_so(linked: tuple[Link, Link], joined: tuple[Hub, Link, Link]) -> None:
    hub, node, _ = joined
    for link in (*linked, node):
        link.close()
        link.close()
        with pytest.raises(TransportError, match="cannot"):
            link.send(b"")
        for timeout in (Duration(0), None):
            with pytest.raises(TransportError, match="cannot"):
                link.recv(timeout)
    hub.close()
    hub.close()
    for use in (hub.recv, lambda: hub.send("dx", b""), lambda: hub.wait(Duration(0))):
        with pytest.raises(TransportError, match="cannot"):
            use()


def test_a_hub_answers_each_node_by_name(joined: tuple[Hub, Link, Link]) -> None:
    hub, dx, dy = joined
    assert hub.send("dy", b"for dy")
    assert hub.send("dx", b"for dx")
    assert dx.recv(LONG) == b"for dx"
    assert dy.recv(LONG) == b"for dy"
    assert dx.recv(Duration(0)) is None
    for i in range(100):
        assert dx.send(str(i).encode())
    assert [receive(hub) for _ in range(100)] == [("dx", str(i).encode()) for i in range(100)]
    assert hub.recv() is None


def test_a_node_that_is_not_there_is_not_sent_to(joined: tuple[Hub, Link, Link]) -> None:
    assert joined[0].send("dz", b"hello?") is False


def test_a_hub_waits_for_frames_descriptors_and_time(joined: tuple[Hub, Link, Link]) -> None:
    hub, dx, _ = joined
    reader, writer = os.pipe()
    try:
        before = time.monotonic_ns()
        assert hub.wait(Duration(10 * MS), [reader]) == set()
        assert time.monotonic_ns() - before >= 10 * MS
        assert dx.send(b"frame")
        assert hub.wait(LONG, [reader]) == set()  # ended by the frame, which is still there
        assert hub.recv() == ("dx", b"frame")
        os.write(writer, b"!")
        assert hub.wait(None, [reader]) == {reader}
        os.read(reader, 1)
        assert hub.wait(Duration(0), [reader]) == set()
        os.close(writer)
        writer = -1
        assert hub.wait(None, [reader]) == {reader}  # hung up
    finally:
        os.close(reader)
        if writer >= 0:
            os.close(writer)


def test_a_hub_may_wait_for_everything_but_frames(joined: tuple[Hub, Link, Link]) -> None:
    hub, dx, _ = joined
    reader, writer = os.pipe()
    try:
        assert dx.send(b"frame")
        hub.wait(LONG)  # it has arrived
        before = time.monotonic_ns()
        assert hub.wait(Duration(10 * MS), [reader], frames=False) == set()
        assert time.monotonic_ns() - before >= 10 * MS
        os.write(writer, b"!")
        assert hub.wait(LONG, [reader], frames=False) == {reader}
        assert hub.recv() == ("dx", b"frame")
    finally:
        os.close(reader)
        os.close(writer)


def test_a_hub_counts_the_frames_it_has_read(joined: tuple[Hub, Link, Link]) -> None:
    hub, dx, _ = joined
    before = hub.handled
    assert hub.recv() is None
    for _ in range(5):
        assert dx.send(b"frame")
    for done in range(1, 6):
        receive(hub)
        assert hub.handled == before + done


def test_a_forgotten_name_is_free_and_its_first_owner_may_stay(ends: "Ends") -> None:
    """An observer's visits: each joins anew, and the one before may still be about to leave."""
    hub, endpoint = ends.binder.bind_hub("supervisor", ("dx", "dy"))
    first = ends.join(endpoint, "dy")
    assert first.send(b"first")
    assert receive(hub) == ("dy", b"first")
    hub.forget("dy")
    hub.forget("nobody")
    if ends.scheme not in {"memory", "tcp with keys"}:  # ZeroMQ leaves a routing id to its first owner
        ends.others.pop().close()
        while hub.send("dy", b"still there?"):
            hub.wait(Duration(MS))
    second = ends.join(endpoint, "dy")
    assert second.send(b"second")
    assert receive(hub) == ("dy", b"second")
    assert hub.send("dy", b"to the second")
    assert second.recv(LONG) == b"to the second"
    if ends.scheme in {"memory", "tcp with keys"}:
        assert first.recv(Duration(0)) is None


def test_a_settled_process_admits_when_it_attends(ends: "Ends") -> None:
    """Before, receiving is enough. Afterwards a loop attends in its slack, and admitted peers need not wait for it."""
    first, first_endpoint = ends.binder.bind("cx", "dx")
    late, late_endpoint = ends.binder.bind("cy", "dx")
    connected = ends.connector.connect(first_endpoint, "supervisor")
    assert connected.send(b"here")
    assert first.recv(LONG) == b"here"
    for transport in (ends.binder, ends.connector):
        transport.settle()
        transport.settle()
    newcomer = ends.connector.connect(late_endpoint, "supervisor")
    assert newcomer.send(b"let me in")
    if ends.scheme == "tcp with keys":
        assert late.recv(Duration(30 * MS)) is None
    assert connected.send(b"not disturbed")
    assert first.recv(LONG) == b"not disturbed"
    while (frame := late.recv(Duration(MS))) is None:
        ends.binder.attend()
    assert frame == b"let me in"


def test_nobody_is_refused_and_nothing_is_in_trouble_among_friends(
    ends: "Ends", joined: tuple[Hub, Link, Link], linked: tuple[Link, Link]
) -> None:
    for transport in (ends.binder, ends.connector):
        assert transport.refused() == {}
    for link in (*linked, *joined[1:]):
        assert link.trouble() is None
        link.close()
        assert link.trouble() is None
    ends.close()
    for transport in (ends.binder, ends.connector):
        transport.settle()
        transport.attend()
        assert transport.refused() == {}


@pytest.fixture
def outlet(ends: "Ends") -> tuple[Link, str]:
    return ends.binder.bind_outlet("supervisor-dx", "dx")


def hear(ends: "Ends", outlet: Link, endpoint: str, frame: bytes) -> Link:
    """Join, and receive ``frame``, which is sent until it arrives."""
    link = ends.connector.connect_outlet(endpoint, "supervisor")
    while (heard := link.recv(Duration(MS))) is None:
        ends.binder.attend()
        outlet.send(frame)
    assert heard == frame
    return link


def test_an_outlet_reaches_a_peer_that_comes_and_goes(ends: "Ends", outlet: tuple[Link, str]) -> None:
    bound, endpoint = outlet
    assert bound.send(b"anybody?") is False
    for visit in range(3):
        link = hear(ends, bound, endpoint, f"visit {visit}".encode())
        link.close()


def test_an_outlet_goes_one_way(ends: "Ends", outlet: tuple[Link, str]) -> None:
    bound, endpoint = outlet
    link = hear(ends, bound, endpoint, b"hear")
    with pytest.raises(TransportError, match="cannot receive from a link"):
        bound.recv(Duration(0))
    with pytest.raises(TransportError, match="cannot send on a link"):
        link.send(b"I say")


def test_who_does_not_read_an_outlet_does_not_block_it(ends: "Ends", outlet: tuple[Link, str]) -> None:
    bound, endpoint = outlet
    link = hear(ends, bound, endpoint, bytes(60_000))
    sent = 0
    while bound.send(bytes(60_000)):
        sent += 1
        assert sent < 20 * LINK_QUEUE_FRAMES
    while link.recv(Duration(20 * MS)) is not None:
        pass


def test_no_frame_is_overlooked_by_waiting(joined: tuple[Hub, Link, Link]) -> None:
    """Frames that are there need no new arrival to be noticed (ZeroMQ's own descriptor is edge-triggered)."""
    hub, dx, _ = joined
    for _ in range(3):
        assert dx.send(b"frame")
    for _ in range(3):
        hub.wait(None)
        assert receive(hub) == ("dx", b"frame")


@pytest.mark.parametrize("name", ["", ".", "..", "a/b", "a b", "a*", "@a", "é", "a\x00", "x" * 97])
def test_what_is_no_name_is_refused(ends: "Ends", name: str) -> None:
    _, endpoint = ends.binder.bind_hub("supervisor", ("dx", "dy"))
    for use in (
        lambda name: ends.binder.bind(name, "dx"),
        lambda name: ends.binder.bind_outlet(name, "dx"),
        lambda name: ends.binder.bind_hub(name, ("dx",)),
        lambda name: ends.connector.join(endpoint, name),
    ):
        with pytest.raises(TransportError, match=r"found the name .*expected 1 to 96 ASCII characters"):
            use(name)


def test_a_name_is_bound_once(ends: "Ends") -> None:
    ends.binder.bind("cx", "dx")
    for again in (lambda: ends.binder.bind("cx", "dx"), lambda: ends.binder.bind_hub("cx", ("dx",))):
        with pytest.raises(TransportError, match="in use; expected a name that is bound once"):
            again()


@pytest.mark.parametrize("endpoint", ["", "cx", "inproc://cx", "udp://127.0.0.1:1"])
def test_an_endpoint_of_another_transport_is_refused(ends: "Ends", endpoint: str) -> None:
    for use in (
        lambda endpoint: ends.connector.connect(endpoint, "supervisor"),
        lambda endpoint: ends.connector.connect_outlet(endpoint, "supervisor"),
        lambda endpoint: ends.connector.join(endpoint, "dx"),
    ):
        with pytest.raises(TransportError, match=r"found the endpoint .*; expected"):
            use(endpoint)


def test_closing_leaves_nothing(ends: "Ends", joined: tuple[Hub, Link, Link], linked: tuple[Link, Link]) -> None:
    """Twice is as good as once; and nothing can be made afterwards."""
    ends.close()
    ends.close()
    for link in (*linked, *joined[1:]):
        with pytest.raises(TransportError):
            link.recv(None)
    for make in (
        lambda: ends.binder.bind("late", "dx"),
        lambda: ends.binder.bind_outlet("late", "dx"),
        lambda: ends.binder.bind_hub("late", ("dx", "dy")),
    ):
        with pytest.raises(TransportError, match="the transport is closed"):
            make()
