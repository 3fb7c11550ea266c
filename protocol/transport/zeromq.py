"""ZeroMQ over Unix-domain sockets (``ipc``) or TCP.

Over TCP everything is encrypted and both sides prove who they are (CURVE), unless the process was given no keys; over
``ipc`` the directory of the sockets is what keeps others out. TCP keeps ZeroMQ's default of TCP_NODELAY.
"""

from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Final

import zmq

from manyhands.protocol.keys import KeyRing
from manyhands.protocol.limits import (
    DEAF_BYTES,
    HEARTBEAT_MS,
    HUB_INBOX_FRAMES,
    HUB_QUEUE_FRAMES,
    LINGER_MS,
    LINK_QUEUE_FRAMES,
    MAX_CONTROL_BYTES,
    SILENCE_MS,
)
from manyhands.protocol.transport import Hub, Link, TransportError, require_name, require_path
from manyhands.protocol.transport.descriptors import require_room
from manyhands.protocol.transport.doorkeeper import Doorkeeper
from manyhands.protocol.transport.sockets import ZmqHub, ZmqLink, failed

SCHEMES: Final = ("ipc", "tcp")
"""What a session can be carried by."""

_CURVE_BYTES: Final = 33  # by which encryption makes a message longer: command, nonce, flags and authenticator

LOOPBACK: Final = "127.0.0.1"

HUB: Final = "supervisor"
"""Whose key a hub proves."""


def is_address(place: str) -> bool:
    """Whether this is HOST:PORT; of a port, ZeroMQ would read as much as it can."""
    host, _, port = place.rpartition(":")
    return bool(host) and port.isascii() and port.isdecimal() and len(port) <= 5 and 0 < int(port) < 65536


class ZmqTransport:
    """Links and hubs of one ZeroMQ context, which lives as long as this does.

    A context must not be carried over a fork: construct the transport in the process that uses it.
    """

    def __init__(self, scheme: str, address_of: Callable[[str, str], str], ring: KeyRing | None = None) -> None:
        """Make a transport without sockets.

        Raises:
            TransportError: this process may not open enough files.
        """
        self._scheme: Final = scheme
        self._address_of = address_of
        require_room()
        self._context = zmq.Context()
        self._door = None if ring is None else Doorkeeper(self._context, ring)
        self._sockets: list[zmq.Socket[bytes]] = []
        self._links: list[ZmqLink] = []
        self._names: set[str] = set()
        self._files: list[Path] = []

    @classmethod
    def ipc(cls, directory: Path) -> "ZmqTransport":
        """Unix-domain sockets in ``directory``, which exists and which only the session's user may enter."""
        absolute = directory.absolute()  # peers may run elsewhere
        return cls("ipc", lambda name, _address: str(absolute / name))

    @classmethod
    def tcp(cls, ring: KeyRing | None = None) -> "ZmqTransport":
        """TCP, on the loopback where no address is asked for; encrypted and proved with ``ring``'s keys, or plain."""
        return cls("tcp", lambda _name, address: address or f"{LOOPBACK}:*", ring)

    @classmethod
    def of(cls, scheme: str, directory: Path, ring: KeyRing | None = None) -> "ZmqTransport":
        """The transport of one of :data:`SCHEMES`; ``directory`` is for ``ipc``, ``ring`` for ``tcp``.

        Raises:
            TransportError: if there is no such scheme, or this process may not open enough files.
        """
        if scheme not in SCHEMES:
            raise TransportError(f"found the transport {scheme!r:.40}; expected {' or '.join(SCHEMES)}")
        return cls.ipc(directory) if scheme == "ipc" else cls.tcp(ring)

    def bind(self, name: str, peer: str, address: str = "") -> tuple[Link, str]:
        """A link for ``peer`` to connect to; see :class:`~manyhands.protocol.transport.Transport`."""
        socket = self._socket(zmq.PAIR, LINK_QUEUE_FRAMES)
        endpoint = self._bind(socket, name, (peer,), address)
        return self._link(socket), endpoint

    def connect(self, endpoint: str, peer: str) -> Link:
        """The other end of a link that ``peer`` has bound; see :class:`~manyhands.protocol.transport.Transport`."""
        socket = self._socket(zmq.PAIR, LINK_QUEUE_FRAMES)
        self._connect(socket, endpoint, peer)
        return self._link(socket)

    def bind_outlet(self, name: str, peer: str, address: str = "") -> tuple[Link, str]:
        """A link to ``peer`` alone, one way; see :class:`~manyhands.protocol.transport.Transport`.

        A PUSH socket: a PAIR learns late that its peer has left, and is mute for ever to one who came before that.
        """
        socket = self._socket(zmq.PUSH, LINK_QUEUE_FRAMES)
        socket.setsockopt(zmq.RCVHWM, 1)  # nobody reads here
        socket.setsockopt(zmq.MAXMSGSIZE, DEAF_BYTES)
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
        socket.setsockopt(zmq.ROUTER_MANDATORY, 1)  # otherwise a frame for an unknown identity vanishes in silence
        endpoint = self._bind(socket, name, members, address)
        return ZmqHub(socket, self._door), endpoint

    def join(self, endpoint: str, identity: str, hub: str = HUB) -> Link:
        """A link to a hub; see :class:`~manyhands.protocol.transport.Transport`."""
        require_name(identity)
        socket = self._socket(zmq.DEALER, HUB_QUEUE_FRAMES)
        if self._door is None:  # with keys the hub knows the name, and routes cannot be guessed and taken
            socket.setsockopt(zmq.ROUTING_ID, identity.encode("ascii"))
        if self._scheme == "tcp":
            socket.setsockopt(zmq.HEARTBEAT_IVL, HEARTBEAT_MS)
            socket.setsockopt(zmq.HEARTBEAT_TIMEOUT, SILENCE_MS)
        link = self._link(socket, watched=self._scheme == "tcp")
        self._connect(socket, endpoint, hub)
        return link

    def settle(self) -> None:
        """From now on, admit only in :meth:`attend`; see :class:`~manyhands.protocol.transport.Transport`."""
        if self._door is not None:
            self._door.settled = True

    def attend(self) -> None:
        """Attend to those at the door; see :class:`~manyhands.protocol.transport.Transport`."""
        if self._door is not None:
            self._door.attend()

    def refused(self) -> Mapping[str, int]:
        """Connections not admitted; see :class:`~manyhands.protocol.transport.Transport`."""
        return {} if self._door is None else self._door.refused()

    def close(self) -> None:
        """Close everything made here; see :class:`~manyhands.protocol.transport.Transport`."""
        for link in self._links:
            link.close()
        if self._door is not None:
            self._door.close()
        for socket in self._sockets:
            socket.close(linger=LINGER_MS)
        self._context.term()  # waits for frames on their way and joins ZeroMQ's threads
        for file in self._files:
            file.unlink(missing_ok=True)  # ZeroMQ has removed it, unless it was interrupted
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
        socket.setsockopt(zmq.SNDHWM, queue_frames)
        socket.setsockopt(zmq.RCVHWM, queue_frames)
        overhead = 0 if self._door is None else _CURVE_BYTES  # ZeroMQ measures what comes over the wire
        socket.setsockopt(zmq.MAXMSGSIZE, MAX_CONTROL_BYTES + overhead)
        return socket

    def _link(self, socket: "zmq.Socket[bytes]", watched: bool = False) -> ZmqLink:
        link = ZmqLink(socket, self._door, watched)
        self._links.append(link)
        return link

    def _bind(self, socket: "zmq.Socket[bytes]", name: str, admits: Collection[str], wanted: str) -> str:
        require_name(name)
        if name in self._names:
            raise TransportError(f"found the name {name} in use; expected a name that is bound once")
        self._names.add(name)
        address = self._address_of(name, wanted)
        if self._scheme == "ipc":
            self._claim(Path(address))
        if self._door is not None:
            try:
                self._door.guard(socket, name, admits)
            except KeyError as error:
                raise _no_key(error) from error
        try:
            socket.bind(f"{self._scheme}://{address}")
        except zmq.ZMQError as error:
            raise failed(f"bind {self._scheme}://{address}", error) from error
        return socket.getsockopt_string(zmq.LAST_ENDPOINT)

    def _claim(self, path: Path) -> None:
        require_path(path)
        if path.exists():  # ZeroMQ would take it away from whoever listens there
            raise TransportError(f"found {path} in use; expected a name bound once, in its own directory")
        self._files.append(path)

    def _connect(self, socket: "zmq.Socket[bytes]", endpoint: str, peer: str) -> None:
        if not endpoint.startswith(f"{self._scheme}://"):
            raise TransportError(f"found the endpoint {endpoint!r:.300}; expected {self._scheme}://...")
        if self._door is not None:
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
