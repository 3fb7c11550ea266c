"""The transport over ZeroMQ: links and hubs over Unix-domain sockets (``ipc``) or TCP.

Over TCP all messages are encrypted and both sides prove their keys (CURVE), unless the process has no keys. Over
``ipc`` the permissions of the sockets' directory keep others out. TCP has TCP_NODELAY, which is ZeroMQ's default.
A process of a session with nodes on other machines uses both: ``ipc`` with its peers on its own machine, and TCP with
the others. Each then has a thread of ZeroMQ to itself, so that only that of ``ipc`` may have a real-time priority.

A link is a PAIR socket: it admits one peer and is, with a blocking receive, the fastest of ZeroMQ's patterns. A hub is
ROUTER and DEALER, an outlet PUSH and PULL. Receiving blocks in the kernel with RCVTIMEO and not in a poller: that is
5 % faster, and busy waiting is ruinous on few cores. Only before a process has its peers it polls, for it must answer
connection requests meanwhile. Sending never blocks.
"""

import time
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Final

import zmq

from manyhands.protocol.clock import Duration
from manyhands.protocol.keys import KeyRing
from manyhands.protocol.limits import (
    CONNECT_MS,
    HEARTBEAT_MS,
    HUB_INBOX_FRAMES,
    HUB_QUEUE_FRAMES,
    LINGER_MS,
    LINK_QUEUE_FRAMES,
    MAX_CONTROL_BYTES,
    SEND_ONLY_BYTES,
    SILENCE_MS,
)
from manyhands.protocol.transport import (
    Hub,
    Link,
    TransportError,
    Trouble,
    milliseconds,
    require_name,
    require_path,
    require_sendable,
)
from manyhands.protocol.transport.descriptors import require_room
from manyhands.protocol.transport.door import Doorkeeper, Fate, close_monitor, event_of, monitor_of

HUB_DROPS: Final = (
    "not_a_frame",  # it is not one frame, or its sender has no valid name
    "second_route",  # an earlier connection has the sender's name already
)
"""The reasons for which a hub drops a message."""


class ZmqLink:
    """A PAIR socket, the DEALER end of a hub, or either end of an outlet.

    Attributes:
        host: see :class:`~manyhands.protocol.transport.Link`.
    """

    def __init__(
        self, socket: "zmq.Socket[bytes]", door: Doorkeeper | None, watched: bool = False, host: str = ""
    ) -> None:
        """Take over a socket.

        Args:
            socket: bound, or about to connect.
            door: answers connection requests; None for a transport without keys.
            watched: whether :meth:`trouble` reports on its connection; only before the socket connects.
            host: where it connects to; empty for none.
        """
        self.host = host
        self._socket, self._door = socket, door
        # pyzmq's send without its wrapper for text, groups and routes: a third of the cost in a tick
        self._send = super(zmq.Socket, socket).send
        self._receive = socket.recv
        self._timeout: Duration | None = None  # for ever, ZeroMQ's default of RCVTIMEO
        self._monitor = monitor_of(socket, Fate.EVENTS) if watched else None
        self._fate = Fate()

    @property
    def socket(self) -> "zmq.Socket[bytes]":
        """Its socket."""
        return self._socket

    def send(self, frame: bytes) -> bool:
        """Queue a frame; see :class:`~manyhands.protocol.transport.Link`."""
        if len(frame) > MAX_CONTROL_BYTES:
            require_sendable(frame)  # raises, with the reason
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
            if timeout != self._timeout:  # a loop has the same timeout in each tick, and saves the call
                self._socket.setsockopt(zmq.RCVTIMEO, milliseconds(timeout))
                self._timeout = timeout
            return self._receive()
        except zmq.Again:
            if not at_once and door is not None:  # no frame came: the peer may have lost its connection, and ask anew
                door.attend()
            return None
        except zmq.ZMQError as error:
            raise failed("receive from a link", error) from error

    def _recv_attending(self, wait_ms: int, door: Doorkeeper) -> bytes | None:
        """The next frame; answers connection requests meanwhile, for one of them may be the peer's."""
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
        """The failure of the connection; see :class:`~manyhands.protocol.transport.Link`."""
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


class Arrivals:
    """The frames that have come over many links, found by one question for all of them.

    To ask an empty link for a frame costs 3 us, and to ask one of 64 links together 0.6 us.
    """

    def __init__(self) -> None:
        """No links."""
        self._poller = zmq.Poller()
        self._links: list[Link | None] = []
        self._at: dict[object, int] = {}  # socket to the link's index
        self._others: list[int] = []  # links of other kinds, which are asked one by one

    def take(self, links: list[Link | None], most: int) -> list[tuple[int, bytes]]:
        """The frames that are there now, at most ``most`` of a link, each with the index of its link in ``links``.

        Connection requests are not answered meanwhile: each link has its peer, or waits for one that comes back. A link
        that is closed has none.

        Raises:
            TransportError: a link cannot be read.
        """
        if links != self._links:
            self._register(links)
        found: list[tuple[int, bytes]] = []
        for i in self._others:
            link = links[i]
            for _ in range(most):
                frame = None if link is None else link.recv(Duration(0))
                if frame is None:
                    break
                found.append((i, frame))
        if not self._at:
            return found
        try:
            ready = self._poller.poll(0)
            for _ in range(most):
                if not ready:
                    break
                # a socket that was closed meanwhile is none of these
                found += [(self._at[socket], socket.recv(_AT_ONCE)) for socket, _ in ready if socket in self._at]
                ready = zmq.zmq_poll(ready, 0)
        except zmq.ZMQError as error:
            raise failed("receive from a link", error) from error
        return found

    def _register(self, links: list[Link | None]) -> None:
        self._links = list(links)
        self._poller, self._at, self._others = zmq.Poller(), {}, []
        for i, link in enumerate(links):
            if isinstance(link, ZmqLink):
                socket = link.socket
                self._at[socket] = i
                self._poller.register(socket, zmq.POLLIN)
            elif link is not None:
                self._others.append(i)


_AT_ONCE: Final = int(zmq.NOBLOCK)  # a plain number, for a member of the enumeration is converted in every call
_DROPS_AT_ONCE: Final = 32  # then the call returns: a flood must not keep the caller from its other work


class ZmqHub:
    """A ROUTER socket.

    Without keys a node has the name that it claims, and ZeroMQ leaves a name to its first connection while that lasts.
    With keys its name is that of the key that its connection has proved. The first connection keeps the name until
    :meth:`forget`, or until it is silent for :data:`SILENCE_MS` while a second one with the same key speaks. That is a
    node whose connection broke: it has a new one, and the old one never speaks again.

    Attributes:
        dropped: messages not passed on, by reason; the keys are :data:`HUB_DROPS`.
        handled: messages read, whether passed on or dropped.
    """

    def __init__(self, socket: "zmq.Socket[bytes]", door: Doorkeeper | None) -> None:
        self._socket, self._door = socket, door
        self._routes: dict[str, bytes] = {}
        self._rivals: dict[str, tuple[int, int]] = {}  # since when (monotonic ns), and after how many frames
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
            elif self._door is not None and not self._has(name, route):
                self.dropped["second_route"] += 1
            else:
                return name, parts[1].bytes
        return None

    def _has(self, name: str, route: bytes) -> bool:
        """Whether this connection has the name, whose key it has proved.

        The silence of the first connection is counted from the second one's first frame, for a slow hub reads old
        frames. ZeroMQ takes turns between connections, so that a frame of the first would be among the next few.
        """
        first = self._routes.setdefault(name, route)
        if first == route:
            self._rivals.pop(name, None)
            return True
        now = time.monotonic_ns()
        since, handled = self._rivals.setdefault(name, (now, self.handled))
        if now - since < SILENCE_MS * 1_000_000 or self.handled - handled < len(self._routes):
            return False
        del self._rivals[name]
        self._routes[name] = route
        return True

    def send(self, identity: str, frame: bytes) -> bool:
        """Queue a frame for a node; see :class:`~manyhands.protocol.transport.Hub`."""
        require_name(identity)
        require_sendable(frame)
        # with keys and a name that never connected: a route that no connection has, for ZeroMQ makes longer ones
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
        """Free the name for a new connection; see :class:`~manyhands.protocol.transport.Hub`."""
        self._routes.pop(identity, None)
        self._rivals.pop(identity, None)

    def wait(self, timeout: Duration | None, fds: Sequence[int] = (), frames: bool = True) -> set[int]:
        """Wait for a frame or a descriptor; see :class:`~manyhands.protocol.transport.Hub`."""
        if self._socket.closed:  # a poller would wait on it without an error
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
                if wait_ms == 0:  # endless connection requests must not hold up the caller
                    break
        except zmq.ZMQError as error:
            raise failed("wait on a hub", error) from error
        return {which for which, _ in ready if isinstance(which, int)}

    def close(self) -> None:
        """Close the hub; see :class:`~manyhands.protocol.transport.Hub`."""
        self._socket.close(linger=LINGER_MS)


def await_links(links: Sequence[Link], timeout: Duration) -> None:
    """Wait until any of ``links`` has a frame, at most ``timeout``; links of other kinds are not looked at.

    The timeout is rounded up to whole ms.
    """
    poller = zmq.Poller()
    for link in links:
        if isinstance(link, ZmqLink):
            poller.register(link.socket, zmq.POLLIN)
    if poller.sockets:
        poller.poll(milliseconds(timeout))


def await_any(socket: "zmq.Socket[bytes]", door: Doorkeeper, wait_ms: int) -> None:
    """Wait until ``socket`` has a frame, or a connection request was answered, or ``wait_ms`` is over."""
    poller = zmq.Poller()
    for one in (socket, *door.knocking):
        poller.register(one, zmq.POLLIN)
    ready = poller.poll(door.at_most(wait_ms))
    if door.shut or any(which is not socket for which, _ in ready):
        door.attend()


def _left_ms(wait_ms: int, deadline: int) -> int:
    """The rest of a wait until ``deadline`` (monotonic ns), ms rounded up; -1, a wait without an end, stays -1."""
    return wait_ms if wait_ms < 0 else max(0, -(-(deadline - time.monotonic_ns()) // 1_000_000))


def refuse_old_versions(socket: "zmq.Socket[bytes]") -> None:
    """Have a socket without keys, in a context without a door, end each connection that speaks no ZMTP of version 3.

    libzmq takes whatever does not begin as ZMTP, such as a request of HTTP, for a peer of version 1. It hands the first
    message of such a peer on before it knows whether it may (``process_routing_id_msg``), and aborts the process where
    the socket is being closed just then. A socket with a domain of ZAP refuses such versions in their first byte.
    Without a door nobody answers for the domain, and libzmq admits all others as before.
    """
    socket.setsockopt_string(zmq.ZAP_DOMAIN, _VERSION_3)


_VERSION_3: Final = "zmtp-3"


def failed(what: str, error: zmq.ZMQError) -> TransportError:
    """The TransportError for an error of ZeroMQ; ``what`` names the action that failed."""
    return TransportError(f"cannot {what}: {error.strerror}")


SCHEMES: Final = ("ipc", "tcp")
"""The transports of a session."""

_IPC: Final = "ipc://"
_TCP: Final = "tcp://"

NETWORK_THREAD: Final = 1
"""The number of ZeroMQ's thread for all that goes over TCP, in a process that has such links; 0 is that of ``ipc``."""

_CURVE_BYTES: Final = 33  # added to a message by encryption: command, nonce, flags and authenticator

LOOPBACK: Final = "127.0.0.1"

HUB: Final = "supervisor"
"""The name of the process whose key a hub proves."""


def host_of(endpoint: str) -> str:
    """The host of a tcp endpoint, without the brackets of an IPv6 address; empty for an endpoint of this machine."""
    scheme, _, place = endpoint.partition("://")
    return place.rpartition(":")[0].strip("[]") if scheme == "tcp" else ""


def is_address(place: str) -> bool:
    """Whether ``place`` is HOST:PORT; ZeroMQ itself would accept a port with other characters after its digits."""
    host, _, port = place.rpartition(":")
    return bool(host) and port.isascii() and port.isdecimal() and len(port) <= 5 and 0 < int(port) < 65536


class ZmqTransport:
    """Links and hubs of one ZeroMQ context, which is closed with this object.

    A context must not be carried over a fork: construct the transport in the process that uses it.
    """

    def __init__(self, directory: Path | None, tcp: bool, ring: KeyRing | None = None) -> None:
        """Make a transport without sockets.

        Args:
            directory: where its Unix-domain sockets are, which exists and only the session's user may enter; None where
                there are none.
            tcp: whether a link to which an address is given goes over TCP.
            ring: the keys of this process; None for no encryption.

        Raises:
            TransportError: this process may not open enough files.
        """
        # peers may have a different working directory
        self._directory: Final = None if directory is None else directory.absolute()
        self._tcp: Final = tcp
        require_room()
        self._context = zmq.Context(io_threads=2 if tcp else 1)
        self._door = None if ring is None else Doorkeeper(self._context, ring)
        self._sockets: list[zmq.Socket[bytes]] = []
        self._links: list[ZmqLink] = []
        self._names: set[str] = set()
        self._files: list[Path] = []

    @classmethod
    def ipc(cls, directory: Path) -> "ZmqTransport":
        """A transport over Unix-domain sockets in ``directory``, which exists and only the session's user may enter."""
        return cls(directory, tcp=False)

    @classmethod
    def tcp(cls, ring: KeyRing | None = None, directory: Path | None = None) -> "ZmqTransport":
        """A transport over TCP; encrypted with the keys of ``ring``, or plain for None.

        Where no address is given, a link is in ``directory``, over ``ipc``, and without one on the loopback.
        """
        return cls(directory, tcp=True, ring=ring)

    @classmethod
    def of(cls, scheme: str, directory: Path | None, ring: KeyRing | None = None) -> "ZmqTransport":
        """The transport of one of :data:`SCHEMES`; ``directory`` is for ``ipc``, also beside ``tcp``, ``ring`` for it.

        Raises:
            TransportError: the scheme is unknown, or this process may not open enough files.
        """
        if scheme not in SCHEMES:
            raise TransportError(f"found the transport {scheme!r:.40}; expected {' or '.join(SCHEMES)}")
        return cls.tcp(ring, directory) if scheme == "tcp" else cls.ipc(directory or Path())

    def bind(self, name: str, peer: str, address: str = "") -> tuple[Link, str]:
        """A link for ``peer`` to connect to; see :class:`~manyhands.protocol.transport.Transport`."""
        socket = self._socket(zmq.PAIR, LINK_QUEUE_FRAMES)
        endpoint = self._bind(socket, name, (peer,), address)
        return self._link(socket), endpoint

    def connect(self, endpoint: str, peer: str) -> Link:
        """The other end of a link that ``peer`` has bound; see :class:`~manyhands.protocol.transport.Transport`."""
        socket = self._socket(zmq.PAIR, LINK_QUEUE_FRAMES)
        self._connect(socket, endpoint, peer)
        return self._link(socket, host=host_of(endpoint))

    def bind_outlet(self, name: str, peer: str, address: str = "") -> tuple[Link, str]:
        """A link to ``peer`` alone, one way; see :class:`~manyhands.protocol.transport.Transport`.

        This is a PUSH socket. A PAIR notices late that its peer has left, and never sends to a new peer that came
        before that.
        """
        socket = self._socket(zmq.PUSH, LINK_QUEUE_FRAMES)
        socket.setsockopt(zmq.RCVHWM, 1)  # this end never reads
        socket.setsockopt(zmq.MAXMSGSIZE, SEND_ONLY_BYTES)
        endpoint = self._bind(socket, name, (peer,), address)
        return self._link(socket), endpoint

    def connect_outlet(self, endpoint: str, peer: str) -> Link:
        """The other end of an outlet; see :class:`~manyhands.protocol.transport.Transport`."""
        socket = self._socket(zmq.PULL, LINK_QUEUE_FRAMES)
        self._connect(socket, endpoint, peer)
        return self._link(socket)

    def bind_hub(self, name: str, members: Collection[str], address: str = "") -> tuple[Hub, str]:
        """A hub for ``members`` to join; see :class:`~manyhands.protocol.transport.Transport`."""
        socket = self._socket(zmq.ROUTER, HUB_QUEUE_FRAMES)
        socket.setsockopt(zmq.RCVHWM, HUB_INBOX_FRAMES)
        socket.setsockopt(zmq.ROUTER_MANDATORY, 1)  # otherwise a frame for an unknown identity is lost without an error
        endpoint = self._bind(socket, name, members, address or (f"{LOOPBACK}:*" if self._tcp else ""))
        return ZmqHub(socket, self._door), endpoint

    def join(self, endpoint: str, identity: str, hub: str = HUB) -> Link:
        """A link to a hub; see :class:`~manyhands.protocol.transport.Transport`."""
        require_name(identity)
        socket = self._socket(zmq.DEALER, HUB_QUEUE_FRAMES)
        if self._door is None:  # with keys the hub knows the name, and routes cannot be guessed and taken
            socket.setsockopt(zmq.ROUTING_ID, identity.encode("ascii"))
        if self._tcp:
            socket.setsockopt(zmq.HEARTBEAT_IVL, HEARTBEAT_MS)
            socket.setsockopt(zmq.HEARTBEAT_TIMEOUT, SILENCE_MS)
        link = self._link(socket, watched=self._tcp)
        self._connect(socket, endpoint, hub)
        return link

    def settle(self) -> None:
        """Admit connections only in :meth:`attend` now; see :class:`~manyhands.protocol.transport.Transport`."""
        if self._door is not None:
            self._door.settled = True

    def attend(self) -> None:
        """Answer connection requests; see :class:`~manyhands.protocol.transport.Transport`."""
        if self._door is not None:
            self._door.attend()

    def refused(self) -> Mapping[str, int]:
        """Connections not admitted; see :class:`~manyhands.protocol.transport.Transport`."""
        return {} if self._door is None else self._door.refused()

    def close(self) -> None:
        """Close all sockets and the context; see :class:`~manyhands.protocol.transport.Transport`."""
        for link in self._links:
            link.close()
        if self._door is not None:
            self._door.close()
        for socket in self._sockets:
            socket.close(linger=LINGER_MS)
        self._context.term()  # waits for frames on their way and joins ZeroMQ's threads
        for file in self._files:
            file.unlink(missing_ok=True)  # ZeroMQ removes the file itself, unless it was interrupted
        self._sockets.clear()
        self._links.clear()
        self._files.clear()

    def _socket(self, kind: int, queue_frames: int) -> "zmq.Socket[bytes]":
        if self._context.closed:
            raise TransportError("cannot open a socket: the transport is closed")
        try:
            socket = self._context.socket(kind)
        except zmq.ZMQError as error:
            raise failed("open a socket", error) from error
        self._sockets.append(socket)
        socket.setsockopt(zmq.LINGER, LINGER_MS)
        socket.setsockopt(zmq.CONNECT_TIMEOUT, CONNECT_MS)
        socket.setsockopt(zmq.SNDHWM, queue_frames)
        socket.setsockopt(zmq.RCVHWM, queue_frames)
        if self._door is None:
            refuse_old_versions(socket)
        overhead = 0 if self._door is None else _CURVE_BYTES  # ZeroMQ measures what comes over the wire
        socket.setsockopt(zmq.MAXMSGSIZE, MAX_CONTROL_BYTES + overhead)
        return socket

    def _link(self, socket: "zmq.Socket[bytes]", watched: bool = False, host: str = "") -> ZmqLink:
        link = ZmqLink(socket, self._door, watched, host)
        self._links.append(link)
        return link

    def _bind(self, socket: "zmq.Socket[bytes]", name: str, admits: Collection[str], wanted: str) -> str:
        require_name(name)
        if name in self._names:
            raise TransportError(f"found the name {name} in use; expected a name that is bound once")
        self._names.add(name)
        endpoint = self._place(name, wanted)
        self._use_thread(socket, endpoint)
        if endpoint.startswith(_IPC):
            self._claim(Path(endpoint.removeprefix(_IPC)))
        elif self._door is not None:
            try:
                self._door.guard(socket, name, admits)
            except KeyError as error:
                raise _no_key(error) from error
        try:
            socket.bind(endpoint)
        except zmq.ZMQError as error:
            raise failed(f"bind {endpoint}", error) from error
        return socket.getsockopt_string(zmq.LAST_ENDPOINT)

    def _place(self, name: str, wanted: str) -> str:
        """The endpoint to bind under a name, where the address ``wanted`` is asked for; empty for none."""
        if self._directory is None or (self._tcp and wanted):
            return f"{_TCP}{wanted or f'{LOOPBACK}:*'}"
        return f"{_IPC}{self._directory / name}"

    def _use_thread(self, socket: "zmq.Socket[bytes]", endpoint: str) -> None:
        """Choose ZeroMQ's thread for a socket: what comes over a network is not of the thread that may be raised."""
        if self._tcp:
            socket.setsockopt(zmq.AFFINITY, 1 << NETWORK_THREAD if endpoint.startswith(_TCP) else 1)

    def _claim(self, path: Path) -> None:
        require_path(path)
        if path.exists():  # ZeroMQ would take the path away from the process that listens there
            raise TransportError(f"found {path} in use; expected a name bound once, in its own directory")
        self._files.append(path)

    def _connect(self, socket: "zmq.Socket[bytes]", endpoint: str, peer: str) -> None:
        expected = [scheme for scheme, used in ((_IPC, self._directory is not None), (_TCP, self._tcp)) if used]
        if not endpoint.startswith(tuple(expected)):
            raise TransportError(f"found the endpoint {endpoint!r:.300}; expected {'... or '.join(expected)}...")
        self._use_thread(socket, endpoint)
        if self._door is not None and endpoint.startswith(_TCP):
            try:
                self._door.introduce(socket, peer)
            except KeyError as error:
                raise _no_key(error) from error
        try:
            socket.connect(endpoint)
        except zmq.ZMQError as error:
            raise failed(f"connect to {endpoint!r:.300}", error) from error


def _no_key(error: KeyError) -> TransportError:
    return TransportError(f"found no public key of {error.args[0]}; expected it among this process's keys")
