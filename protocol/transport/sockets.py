"""ZeroMQ's sockets as links and hubs.

PAIR for a link: it admits one peer and is, with a blocking receive, the fastest of ZeroMQ's patterns; ROUTER
and DEALER for the hub; PUSH and PULL for an outlet. Receiving blocks in the kernel with RCVTIMEO rather than in a
poller (5 % faster, and busy waiting is ruinous on few cores), but for the time before a process has its peers, when it
has to answer those who want to be let in; sending never blocks.
"""

import time
from collections.abc import Sequence
from typing import Final

import zmq

from manyhands.protocol.clock import Duration
from manyhands.protocol.limits import LINGER_MS, MAX_CONTROL_BYTES
from manyhands.protocol.transport import TransportError, Trouble, milliseconds, require_name, require_sendable
from manyhands.protocol.transport.doorkeeper import Doorkeeper
from manyhands.protocol.transport.monitor import Fate, close_monitor, event_of, monitor_of

HUB_DROPS: Final = (
    "not_a_frame",  # not one frame from somebody with a proper name
    "second_route",  # the name is somebody else's already, who connected first
)
"""Why a hub drops a message."""


class ZmqLink:
    """A PAIR socket, the DEALER end of a hub, or either end of an outlet."""

    def __init__(self, socket: "zmq.Socket[bytes]", door: Doorkeeper | None, watched: bool = False) -> None:
        """Take over ``socket``; ``watched``: its connection's fate is wanted (before it connects)."""
        self._socket, self._door = socket, door
        # pyzmq's own send but for a wrapper that sees to text, groups and routes: a third of its cost in a tick
        self._send = super(zmq.Socket, socket).send
        self._receive = socket.recv
        self._timeout: Duration | None = None  # for ever, ZeroMQ's default of RCVTIMEO
        self._monitor = monitor_of(socket, Fate.EVENTS) if watched else None
        self._fate = Fate()

    def send(self, frame: bytes) -> bool:
        """Queue a frame; see :class:`~manyhands.protocol.transport.Link`."""
        if len(frame) > MAX_CONTROL_BYTES:
            require_sendable(frame)  # which says what is wrong
        try:
            self._send(frame, _AT_ONCE)
        except zmq.Again:
            return False
        except zmq.ZMQError as error:
            raise failed("send on a link", error) from error
        return True

    def recv(self, timeout: Duration | None) -> bytes | None:
        """The next frame; see :class:`~manyhands.protocol.transport.Link`."""
        door = self._door
        if door is not None and not door.settled:
            return self._recv_attending(milliseconds(timeout), door)
        at_once = timeout is not None and timeout <= 0
        try:
            if at_once:
                return self._receive(_AT_ONCE)
            if timeout != self._timeout:  # a loop waits equally long each tick: spare it the call
                self._socket.setsockopt(zmq.RCVTIMEO, milliseconds(timeout))
                self._timeout = timeout
            return self._receive()
        except zmq.Again:
            if not at_once and door is not None:  # in vain: the peer may have lost its connection and be at the door
                door.attend()
            return None
        except zmq.ZMQError as error:
            raise failed("receive from a link", error) from error

    def _recv_attending(self, wait_ms: int, door: Doorkeeper) -> bytes | None:
        """The next frame, answering meanwhile those who want to be let in; the peer may be among them."""
        deadline = time.monotonic_ns() + wait_ms * 1_000_000
        try:
            while True:
                try:
                    return self._socket.recv(zmq.NOBLOCK)
                except zmq.Again:
                    left_ms = _left_ms(wait_ms, deadline)
                if left_ms == 0:
                    return None
                await_any(self._socket, door, left_ms)
        except zmq.ZMQError as error:
            raise failed("receive from a link", error) from error

    def trouble(self) -> Trouble | None:
        """What has gone wrong with the connection; see :class:`~manyhands.protocol.transport.Link`."""
        if self._monitor is not None and not self._socket.closed:
            while self._monitor.poll(0, zmq.POLLIN):
                self._fate.take(event_of(self._monitor.recv_multipart()))
        return self._fate.trouble

    def close(self) -> None:
        """Close this end."""
        if self._door is not None:
            self._door.dismiss(self._socket)
        if self._monitor is not None:
            close_monitor(self._socket, self._monitor)
        self._socket.close(linger=LINGER_MS)


_AT_ONCE: Final = int(zmq.NOBLOCK)  # a plain number: the enumeration's is converted at every call
_DROPS_AT_ONCE: Final = 32  # then the caller is asked again: a flood must not keep it from everything else


class ZmqHub:
    """A ROUTER socket.

    Without keys a node is who it says it is, and ZeroMQ leaves the name to the first connection while that lasts. With
    keys its name is that of the key which its connection has proved, and the first keeps it until :meth:`forget`.

    Attributes:
        dropped: messages not passed on, by reason; the keys are :data:`HUB_DROPS`.
        handled: messages read, whether passed on or dropped.
    """

    def __init__(self, socket: "zmq.Socket[bytes]", door: Doorkeeper | None) -> None:
        self._socket, self._door = socket, door
        self._routes: dict[str, bytes] = {}
        self.dropped = dict.fromkeys(HUB_DROPS, 0)
        self.handled = 0

    def recv(self) -> tuple[str, bytes] | None:
        """The next frame and its sender; see :class:`~manyhands.protocol.transport.Hub`."""
        for _ in range(_DROPS_AT_ONCE):
            try:
                parts = self._socket.recv_multipart(zmq.NOBLOCK, copy=False)
            except zmq.Again:
                return None
            except zmq.ZMQError as error:
                raise failed("receive from a hub", error) from error
            self.handled += 1
            route = parts[0].bytes
            try:
                name = route.decode("ascii") if self._door is None else str(parts[-1].get("User-Id"))
                require_name(name)
            except (UnicodeDecodeError, TransportError, zmq.ZMQError):
                self.dropped["not_a_frame"] += 1
                continue
            if len(parts) != 2:
                self.dropped["not_a_frame"] += 1
            elif self._door is not None and self._routes.setdefault(name, route) != route:
                self.dropped["second_route"] += 1
            else:
                return name, parts[1].bytes
        return None

    def send(self, identity: str, frame: bytes) -> bool:
        """Queue a frame for a node; see :class:`~manyhands.protocol.transport.Hub`."""
        require_name(identity)
        require_sendable(frame)
        # with keys, of somebody unheard of: nobody's, for ZeroMQ makes up longer ones
        route = identity.encode("ascii") if self._door is None else self._routes.get(identity, b"\x00")
        try:
            self._socket.send_multipart([route, frame], zmq.NOBLOCK)
        except zmq.Again:
            return False
        except zmq.ZMQError as error:
            if error.errno == zmq.EHOSTUNREACH:
                return False
            raise failed("send from a hub", error) from error
        return True

    def forget(self, identity: str) -> None:
        """Let another connection have the name; see :class:`~manyhands.protocol.transport.Hub`."""
        self._routes.pop(identity, None)

    def wait(self, timeout: Duration | None, fds: Sequence[int] = (), frames: bool = True) -> set[int]:
        """Wait for a frame or a descriptor; see :class:`~manyhands.protocol.transport.Hub`."""
        if self._socket.closed:  # a poller would wait on it in silence
            raise TransportError("cannot wait on a hub: it is closed")
        poller = zmq.Poller()
        if frames:
            poller.register(self._socket, zmq.POLLIN)
        for fd in fds:
            poller.register(fd, zmq.POLLIN | zmq.POLLERR)
        door = self._door
        knocking = [] if door is None else door.knocking
        for socket in knocking:
            poller.register(socket, zmq.POLLIN)
        wait_ms = milliseconds(timeout)
        deadline = time.monotonic_ns() + wait_ms * 1_000_000
        try:
            while True:
                ready = poller.poll(wait_ms if door is None else door.at_most(wait_ms))
                if door is not None and (door.shut or any(which in knocking for which, _ in ready)):
                    door.attend()
                if any(which not in knocking for which, _ in ready):
                    break
                wait_ms = _left_ms(wait_ms, deadline)
                if wait_ms == 0:  # whoever knocks on and on does not hold up the caller
                    break
        except zmq.ZMQError as error:
            raise failed("wait on a hub", error) from error
        return {which for which, _ in ready if isinstance(which, int)}

    def close(self) -> None:
        """Close it."""
        self._socket.close(linger=LINGER_MS)


def await_any(socket: "zmq.Socket[bytes]", door: Doorkeeper, wait_ms: int) -> None:
    """Wait until ``socket`` has a frame, or somebody at the door was attended to, or the time is over."""
    poller = zmq.Poller()
    for one in (socket, *door.knocking):
        poller.register(one, zmq.POLLIN)
    ready = poller.poll(door.at_most(wait_ms))
    if door.shut or any(which is not socket for which, _ in ready):
        door.attend()


def _left_ms(wait_ms: int, deadline: int) -> int:
    """What is left of a wait until ``deadline`` (monotonic ns), ms rounded up; one for ever (-1) stays so."""
    return wait_ms if wait_ms < 0 else max(0, -(-(deadline - time.monotonic_ns()) // 1_000_000))


def failed(what: str, error: zmq.ZMQError) -> TransportError:
    """ZeroMQ's error as ours."""
    return TransportError(f"cannot {what}: {error.strerror}")
