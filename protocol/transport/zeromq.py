"""ZeroMQ over Unix-domain sockets (``ipc``) or TCP.

PAIR for a link: it admits one peer and is, with a blocking receive, the fastest of ZeroMQ's patterns; ROUTER
and DEALER for the hub. Receiving blocks in the kernel with RCVTIMEO rather than in a poller (5 % faster, and
busy waiting is ruinous on few cores); sending never blocks. TCP keeps ZeroMQ's default of TCP_NODELAY.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import zmq

from manyhands.protocol.clock import Duration
from manyhands.protocol.limits import (
    HUB_QUEUE_FRAMES,
    LINGER_MS,
    LINK_QUEUE_FRAMES,
    MAX_CONTROL_BYTES,
    MAX_SOCKET_PATH,
)
from manyhands.protocol.transport import (
    Hub,
    Link,
    TransportError,
    milliseconds,
    require_name,
    require_sendable,
)

SCHEMES: Final = ("ipc", "tcp")
"""What a session can be carried by."""


class ZmqLink:
    """A PAIR socket, or the DEALER end of a hub."""

    def __init__(self, socket: "zmq.Socket[bytes]") -> None:
        self._socket = socket
        self._timeout_ms = -1  # ZeroMQ's default of RCVTIMEO

    def send(self, frame: bytes) -> bool:
        """Queue a frame; see :class:`~manyhands.protocol.transport.Link`."""
        require_sendable(frame)
        try:
            self._socket.send(frame, zmq.NOBLOCK)
        except zmq.Again:
            return False
        except zmq.ZMQError as error:
            raise _failed("send on a link", error) from error
        return True

    def recv(self, timeout: Duration | None) -> bytes | None:
        """The next frame; see :class:`~manyhands.protocol.transport.Link`."""
        wait_ms = milliseconds(timeout)
        try:
            if wait_ms == 0:
                return self._socket.recv(zmq.NOBLOCK)
            if wait_ms != self._timeout_ms:  # a loop waits equally long each tick: spare it the call
                self._socket.setsockopt(zmq.RCVTIMEO, wait_ms)
                self._timeout_ms = wait_ms
            return self._socket.recv()
        except zmq.Again:
            return None
        except zmq.ZMQError as error:
            raise _failed("receive from a link", error) from error

    def close(self) -> None:
        """Close this end."""
        self._socket.close(linger=LINGER_MS)


class ZmqHub:
    """A ROUTER socket.

    Attributes:
        dropped: messages that were not one frame from a proper identity.
    """

    def __init__(self, socket: "zmq.Socket[bytes]") -> None:
        self._socket = socket
        self.dropped = 0

    def recv(self) -> tuple[str, bytes] | None:
        """The next frame and its sender; see :class:`~manyhands.protocol.transport.Hub`."""
        while True:
            try:
                parts = self._socket.recv_multipart(zmq.NOBLOCK)
            except zmq.Again:
                return None
            except zmq.ZMQError as error:
                raise _failed("receive from a hub", error) from error
            try:
                identity = parts[0].decode("ascii")
                require_name(identity)
            except (UnicodeDecodeError, TransportError):
                self.dropped += 1
                continue
            if len(parts) == 2:
                return identity, parts[1]
            self.dropped += 1

    def send(self, identity: str, frame: bytes) -> bool:
        """Queue a frame for a node; see :class:`~manyhands.protocol.transport.Hub`."""
        require_name(identity)
        require_sendable(frame)
        try:
            self._socket.send_multipart([identity.encode("ascii"), frame], zmq.NOBLOCK)
        except zmq.Again:
            return False
        except zmq.ZMQError as error:
            if error.errno == zmq.EHOSTUNREACH:
                return False
            raise _failed("send from a hub", error) from error
        return True

    def wait(self, timeout: Duration | None, fds: Sequence[int] = ()) -> set[int]:
        """Wait for a frame or a descriptor; see :class:`~manyhands.protocol.transport.Hub`."""
        if self._socket.closed:  # a poller would wait on it in silence
            raise TransportError("cannot wait on a hub: it is closed")
        poller = zmq.Poller()
        poller.register(self._socket, zmq.POLLIN)
        for fd in fds:
            poller.register(fd, zmq.POLLIN | zmq.POLLERR)
        try:
            ready = poller.poll(milliseconds(timeout))
        except zmq.ZMQError as error:
            raise _failed("wait on a hub", error) from error
        return {which for which, _ in ready if isinstance(which, int)}

    def close(self) -> None:
        """Close it."""
        self._socket.close(linger=LINGER_MS)


class ZmqTransport:
    """Links and hubs of one ZeroMQ context, which lives as long as this does.

    A context must not be carried over a fork: construct the transport in the process that uses it.
    """

    def __init__(self, scheme: str, address_of: Callable[[str], str]) -> None:
        self._scheme: Final = scheme
        self._address_of = address_of
        self._context = zmq.Context()
        self._sockets: list[zmq.Socket[bytes]] = []
        self._names: set[str] = set()
        self._files: list[Path] = []

    @classmethod
    def ipc(cls, directory: Path) -> "ZmqTransport":
        """Unix-domain sockets in ``directory``, which exists and which only the session's user may enter."""
        absolute = directory.absolute()  # peers may run elsewhere
        return cls("ipc", lambda name: str(absolute / name))

    @classmethod
    def tcp(cls, host: str = "127.0.0.1") -> "ZmqTransport":
        """TCP on ``host``, with ports that the system chooses."""
        return cls("tcp", lambda name: f"{host}:*")

    @classmethod
    def of(cls, scheme: str, directory: Path) -> "ZmqTransport":
        """The transport of one of :data:`SCHEMES`; ``directory`` is for ``ipc``, and ``tcp`` stays on loopback.

        Raises:
            TransportError: if there is no such scheme.
        """
        if scheme not in SCHEMES:
            raise TransportError(f"found the transport {scheme!r:.40}; expected {' or '.join(SCHEMES)}")
        return cls.ipc(directory) if scheme == "ipc" else cls.tcp()

    def bind(self, name: str) -> tuple[Link, str]:
        """A link to connect to; see :class:`~manyhands.protocol.transport.Transport`."""
        socket = self._socket(zmq.PAIR, LINK_QUEUE_FRAMES)
        return ZmqLink(socket), self._bind(socket, name)

    def connect(self, endpoint: str) -> Link:
        """The other end of a bound link; see :class:`~manyhands.protocol.transport.Transport`."""
        socket = self._socket(zmq.PAIR, LINK_QUEUE_FRAMES)
        self._connect(socket, endpoint)
        return ZmqLink(socket)

    def bind_hub(self, name: str) -> tuple[Hub, str]:
        """A hub to join; see :class:`~manyhands.protocol.transport.Transport`."""
        socket = self._socket(zmq.ROUTER, HUB_QUEUE_FRAMES)
        socket.setsockopt(zmq.ROUTER_MANDATORY, 1)  # otherwise a frame for an unknown identity vanishes in silence
        return ZmqHub(socket), self._bind(socket, name)

    def join(self, endpoint: str, identity: str) -> Link:
        """A link to a hub; see :class:`~manyhands.protocol.transport.Transport`."""
        require_name(identity)
        socket = self._socket(zmq.DEALER, HUB_QUEUE_FRAMES)
        socket.setsockopt(zmq.ROUTING_ID, identity.encode("ascii"))
        self._connect(socket, endpoint)
        return ZmqLink(socket)

    def close(self) -> None:
        """Close everything made here; see :class:`~manyhands.protocol.transport.Transport`."""
        for socket in self._sockets:
            socket.close(linger=LINGER_MS)
        self._context.term()  # waits for frames on their way and joins ZeroMQ's threads
        for file in self._files:
            file.unlink(missing_ok=True)  # ZeroMQ has removed it, unless it was interrupted
        self._sockets.clear()
        self._files.clear()

    def _socket(self, kind: int, queue_frames: int) -> "zmq.Socket[bytes]":
        if self._context.closed:
            raise TransportError("cannot open a socket: the transport is closed")
        try:
            socket = self._context.socket(kind)
        except zmq.ZMQError as error:
            raise _failed("open a socket", error) from error
        self._sockets.append(socket)
        socket.setsockopt(zmq.LINGER, LINGER_MS)
        socket.setsockopt(zmq.SNDHWM, queue_frames)
        socket.setsockopt(zmq.RCVHWM, queue_frames)
        socket.setsockopt(zmq.MAXMSGSIZE, MAX_CONTROL_BYTES)
        return socket

    def _bind(self, socket: "zmq.Socket[bytes]", name: str) -> str:
        require_name(name)
        if name in self._names:
            raise TransportError(f"found the name {name} in use; expected a name that is bound once")
        self._names.add(name)
        address = self._address_of(name)
        if self._scheme == "ipc":
            self._claim(Path(address))
        try:
            socket.bind(f"{self._scheme}://{address}")
        except zmq.ZMQError as error:
            raise _failed(f"bind {self._scheme}://{address}", error) from error
        return socket.getsockopt_string(zmq.LAST_ENDPOINT)

    def _claim(self, path: Path) -> None:
        length = len(bytes(path))
        if length > MAX_SOCKET_PATH:
            raise TransportError(
                f"found a socket path of {length} bytes, {path}; expected at most {MAX_SOCKET_PATH}; "
                "choose a shorter directory, such as one directly under /tmp"
            )
        if path.exists():  # ZeroMQ would take it away from whoever listens there
            raise TransportError(f"found {path} in use; expected a name bound once, in its own directory")
        self._files.append(path)

    def _connect(self, socket: "zmq.Socket[bytes]", endpoint: str) -> None:
        if not endpoint.startswith(f"{self._scheme}://"):
            raise TransportError(f"found the endpoint {endpoint!r:.300}; expected {self._scheme}://...")
        try:
            socket.connect(endpoint)
        except zmq.ZMQError as error:
            raise _failed(f"connect to {endpoint!r:.300}", error) from error


def _failed(what: str, error: zmq.ZMQError) -> TransportError:
    return TransportError(f"cannot {what}: {error.strerror}")
