"""Attacks from outside on a session's sockets, by processes that are no part of it, or not the part they play.

Every connection is made once and never repeated by itself, so that the counts equal the attempts.
"""

from __future__ import annotations

import itertools
import select
import socket
import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import Enum
from typing import Final, Self

import zmq
from zmq.utils.monitor import parse_monitor_message

from manyhands.protocol.codec import Received, decode, encode
from manyhands.protocol.keys import KeyPair, new_pair
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import Message

from .links import DEADLINE_MS
from .stage import DEADLINE, RogueSession

PATIENCE_MS: Final = (50, 50, 100, 200, 400, 800, 1600, 3200, 6400, 12800, 25600)
"""How long to look for an answer between one leave and the next."""


def greeting(mechanism: bytes) -> bytes:
    """The first bytes of each side of a ZMTP 3.1 connection: signature, version, mechanism, as-server, filler."""
    return b"\xff" + bytes(7) + b"\x01\x7f\x03\x01" + mechanism.ljust(20, b"\x00") + bytes(32)


GREETING: Final = greeting(b"CURVE")
HELLO_BYTES: Final = 202  # of CURVE's first command, with its frame's two bytes
OVERSIZED: Final = b"\x06" + struct.pack(">Q", 2**62) + b"\x05HELLO"  # a command's frame that claims 4 EiB


class Fate(Enum):
    """The end of a connection."""

    ADMITTED = "admitted"
    NOT_ADMITTED = "not admitted"
    ENDED = "ended before it was one"


_numbers: Final = itertools.count()
_FATES: Final = {
    zmq.Event.HANDSHAKE_SUCCEEDED: Fate.ADMITTED,
    zmq.Event.HANDSHAKE_FAILED_AUTH: Fate.NOT_ADMITTED,
    zmq.Event.HANDSHAKE_FAILED_PROTOCOL: Fate.ENDED,
    zmq.Event.HANDSHAKE_FAILED_NO_DETAIL: Fate.ENDED,
    zmq.Event.DISCONNECTED: Fate.ENDED,
}


@dataclass(frozen=True)
class Claim:
    """The keys that a stranger presents at a door.

    Attributes:
        pair: its keys.
        server: the public key that it expects there.
        shown: the public key that it shows, if that is not its own.
    """

    pair: KeyPair
    server: str
    shown: str | None = None

    @classmethod
    def of(cls, stage: RogueSession, name: str, server: str) -> Self:
        """The real keys of ``name``."""
        return cls(stage.keys.pair(name), stage.keys.public.keys[server])

    @classmethod
    def unknown(cls, stage: RogueSession, server: str) -> Self:
        """Keys unknown to the session."""
        return cls(new_pair(), stage.keys.public.keys[server])

    @classmethod
    def pretended(cls, stage: RogueSession, name: str, server: str) -> Self:
        """The public key of ``name``, without its secret."""
        return cls(new_pair(), stage.keys.public.keys[server], stage.keys.public.keys[name])


@dataclass
class Stranger:
    """Opens connections, and closes them all in the end."""

    context: zmq.Context[zmq.Socket[bytes]] = field(default_factory=zmq.Context)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.context.destroy(linger=0)

    def knock(self, endpoint: str, claim: Claim, kind: int = zmq.DEALER) -> Knock:
        """Begin to connect, once."""
        return Knock(self.context, endpoint, claim, kind)


class Knock:
    """One attempt to connect, and the connection if it comes about."""

    def __init__(self, context: zmq.Context[zmq.Socket[bytes]], endpoint: str, claim: Claim, kind: int) -> None:
        self.socket = context.socket(kind)
        self.socket.setsockopt(zmq.RECONNECT_IVL, -1)
        self.socket.setsockopt(zmq.RCVTIMEO, DEADLINE_MS)
        self.socket.setsockopt(zmq.SNDTIMEO, DEADLINE_MS)
        self.socket.setsockopt(zmq.CURVE_SERVERKEY, claim.server.encode())
        self.socket.setsockopt(zmq.CURVE_PUBLICKEY, (claim.shown or claim.pair.public).encode())
        self.socket.setsockopt(zmq.CURVE_SECRETKEY, claim.pair.secret.encode())
        self._monitor = self.socket.get_monitor_socket(addr=f"inproc://fate-{next(_numbers)}")
        self.socket.connect(endpoint)

    def close(self) -> None:
        """Leave."""
        self.socket.disable_monitor()
        self._monitor.close(linger=0)
        self.socket.close(linger=0)

    def fate(self, timeout_ms: int) -> Fate | None:
        """The end of the attempt; None before it."""
        while self._monitor.poll(timeout_ms):
            fate = _FATES.get(zmq.Event(parse_monitor_message(self._monitor.recv_multipart())["event"]))
            if fate is not None:
                return fate
        return None

    def send(self, *messages: Message | bytes) -> None:
        """Send frames, one each."""
        for message in messages:
            self.socket.send(message if isinstance(message, bytes) else encode(message))

    def receive(self) -> Received:
        """The next message."""
        return decode(self.socket.recv(), MAX_CONTROL_BYTES)


def fates(stage: RogueSession, knocks: Sequence[Knock], held: bool) -> list[Fate]:
    """The ends of attempts to connect.

    Args:
        stage: the session.
        knocks: the attempts.
        held: whether the other side answers only as ticks go on, as nodes do and the supervisor does not.

    Raises:
        TimeoutError: there is no answer.
    """
    found: dict[int, Fate] = {}
    for wait_ms in PATIENCE_MS:
        if held:
            stage.go_on()
        for index, knock in enumerate(knocks):
            if index not in found and (fate := knock.fate(wait_ms)) is not None:
                found[index] = fate
        if len(found) == len(knocks):
            return [found[index] for index in range(len(knocks))]
    raise TimeoutError(f"found answers to {sorted(found)} of {len(knocks)} attempts to connect; expected all")


def address(endpoint: str) -> tuple[str, int]:
    """Host and port of an endpoint."""
    host, _, port = endpoint.removeprefix("tcp://").rpartition(":")
    return host, int(port)


def without_key(endpoint: str, mechanism: bytes) -> Fate:
    """Ask for admission by a mechanism without keys, and stay until the other side ends it.

    ZeroMQ's own client would leave as soon as it reads what is wanted, now and then before it was heard itself.
    """
    with socket.create_connection(address(endpoint), DEADLINE) as connection:
        connection.sendall(greeting(mechanism))
        while connection.recv(4096):
            pass
    return Fate.ENDED


@contextmanager
def crowd(endpoint: str, size: int, says: bytes) -> Iterator[list[socket.socket]]:
    """Many TCP connections that are opened and left idle, each after some bytes.

    When this is entered every one of them has been accepted: the other side has begun its own greeting.
    """
    connections = [socket.create_connection(address(endpoint), DEADLINE) for _ in range(size)]
    try:
        for connection in connections:
            if not connection.recv(1):
                raise ConnectionError("found a connection that was closed at once; expected a greeting")
            connection.sendall(says)
        yield connections
    finally:
        for connection in connections:
            connection.close()


@contextmanager
def halfway(stranger: Stranger, endpoint: str, claim: Claim) -> Iterator[None]:
    """A handshake of real keys that stops in its middle: its last part is held back between the two."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        knock = stranger.knock(f"tcp://127.0.0.1:{listener.getsockname()[1]}", claim)
        listener.settimeout(DEADLINE)
        client, _ = listener.accept()
        with client, socket.create_connection(address(endpoint), DEADLINE) as server:
            through, answered = 0, 0
            while through < len(GREETING) + HELLO_BYTES or answered <= len(GREETING):
                ready, _, _ = select.select([client, server], [], [], DEADLINE)
                if not ready:
                    raise TimeoutError(
                        f"found {through} bytes of a handshake and {answered} of its answer; expected more"
                    )
                for side in ready:
                    data = side.recv(4096)
                    if not data:
                        raise ConnectionError("found the end of a connection; expected a handshake")
                    if side is client:
                        data = data[: len(GREETING) + HELLO_BYTES - through]
                        through += len(data)
                        server.sendall(data)
                    else:
                        answered += len(data)
                        client.sendall(data)
            yield
            knock.close()
