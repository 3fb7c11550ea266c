"""The interface of a transport, the same for every implementation.

A :class:`Link` joins exactly two nodes and carries one frame each way in a tick. A :class:`Hub` is the supervisor's end
of a star of connections, which it distinguishes by identity. Sending never blocks: a loop that paces a hand cannot wait
for a slow reader, so a full queue is an answer (``False``) and not a delay. All implementations pass the same tests
(``tests/protocol/transport/test_transport.py``). A link or a hub is used by one thread.
"""

from collections.abc import Collection, Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import Protocol

from manyhands.protocol.clock import Duration
from manyhands.protocol.limits import MAX_CONTROL_BYTES, MAX_NAME, MAX_SOCKET_PATH


class TransportError(Exception):
    """An endpoint cannot be used as asked; the message states what was found and what was expected."""


class Trouble(StrEnum):
    """The failures of a connection, in words for a person."""

    NOBODY = "nobody listens there"
    NOT_ADMITTED = "the other side does not admit this key"
    BROKEN_OFF = "the other side ended the connection before it had proved its key"
    NOT_PROVED = "the other side does not hold the key expected of it, or one side is encrypted and the other is not"
    LOST = "the connection was lost"


class Link(Protocol):
    """One end of a connection between two processes. Frames keep their borders and their order."""

    def send(self, frame: bytes) -> bool:
        """Queue a frame and return at once; False if it cannot be queued: no peer is there yet, or the queue is full.

        Raises:
            ValueError: the frame is longer than ``MAX_CONTROL_BYTES``.
            TransportError: the link is closed.
        """
        ...

    def recv(self, timeout: Duration | None) -> bytes | None:
        """The next frame, or None if none came within ``timeout``.

        The timeout is rounded up to whole ms; 0 means not to wait, None to wait without an end. An exception of a
        signal handler is raised through this call.

        Raises:
            TransportError: the link is closed.
        """
        ...

    @property
    def host(self) -> str:
        """The host at which this end has reached the other; empty for the end that binds, and within one machine."""
        ...

    def trouble(self) -> Trouble | None:
        """The known failure of the connection; None without one.

        Only the connection to a hub over a network is watched so closely: there no supervisor reports a loss.
        """
        ...

    def close(self) -> None:
        """Close this end; frames on their way still leave. A second call does nothing."""
        ...


class Hub(Protocol):
    """The central end of a star of connections."""

    @property
    def dropped(self) -> Mapping[str, int]:
        """Messages that were not passed on, by reason."""
        ...

    @property
    def handled(self) -> int:
        """The number of messages read, whether passed on or dropped."""
        ...

    def recv(self) -> tuple[str, bytes] | None:
        """The next frame and the identity of its sender, or None if there is none now; never blocks.

        None may also mean that many messages in a row were dropped; :meth:`wait` then returns at once.

        Raises:
            TransportError: the hub is closed.
        """
        ...

    def send(self, identity: str, frame: bytes) -> bool:
        """Queue a frame for ``identity`` and return at once; False if it is not there or its queue is full.

        Raises:
            ValueError: the frame is longer than ``MAX_CONTROL_BYTES``.
            TransportError: the hub is closed.
        """
        ...

    def forget(self, identity: str) -> None:
        """Free the name ``identity`` for a new connection; otherwise it stays with the first one that had it."""
        ...

    def wait(self, timeout: Duration | None, fds: Sequence[int] = (), frames: bool = True) -> set[int]:
        """Wait until there is a frame, or one of ``fds`` is readable or hung up, or ``timeout`` has passed.

        An exception of a signal handler is raised through this call.

        Args:
            timeout: the longest wait; None for no end.
            fds: file descriptors to wait for as well.
            frames: whether a frame ends the wait; no frame is read in any case.

        Returns:
            The file descriptors of ``fds`` that are ready.

        Raises:
            TransportError: the hub is closed.
        """
        ...

    def close(self) -> None:
        """Close the hub; frames on their way still leave. A second call does nothing."""
        ...


class Transport(Protocol):
    """Makes links and hubs of one kind, and closes all that it has made."""

    def bind(self, name: str, peer: str, address: str = "") -> tuple[Link, str]:
        """Bind a link to which ``peer`` alone may connect; returns it and its endpoint.

        Where the transport has keys, they enforce that.

        Args:
            name: the name of the endpoint, which is used once.
            peer: the name of the peer.
            address: host:port for TCP; empty for any free port of the loopback.

        Raises:
            TransportError: the endpoint cannot be bound, or there is no key of ``peer``.
        """
        ...

    def connect(self, endpoint: str, peer: str) -> Link:
        """The other end of a link that ``peer`` has bound.

        Raises:
            TransportError: ``endpoint`` is none of this transport, or there is no key of ``peer``.
        """
        ...

    def bind_outlet(self, name: str, peer: str, address: str = "") -> tuple[Link, str]:
        """Bind a send-only link, as :meth:`bind`, for a peer that may come and go.

        To receive on it raises TransportError. Frames of the peer are neither read nor kept.

        Raises:
            TransportError: as :meth:`bind`.
        """
        ...

    def connect_outlet(self, endpoint: str, peer: str) -> Link:
        """The other end of an outlet that ``peer`` has bound; to send on it raises TransportError.

        Raises:
            TransportError: as :meth:`connect`.
        """
        ...

    def bind_hub(self, name: str, members: Collection[str], address: str = "") -> tuple[Hub, str]:
        """Bind a hub that ``members`` may join; returns it and its endpoint.

        Args:
            name: the name of the endpoint, which is used once.
            members: the names of the processes that may join.
            address: host:port for TCP; empty for any free port of the loopback.

        Raises:
            TransportError: the endpoint cannot be bound, or there is no key of a member.
        """
        ...

    def join(self, endpoint: str, identity: str) -> Link:
        """A link to a hub, which knows this end as ``identity``.

        Raises:
            TransportError: ``endpoint`` is none of this transport, or ``identity`` is no valid name.
        """
        ...

    def settle(self) -> None:
        """Note that all peers are connected: from now on only :meth:`attend` answers connection requests."""
        ...

    def attend(self) -> None:
        """Answer connection requests, and count the refused ones: bounded work, for the slack of a loop."""
        ...

    def refused(self) -> Mapping[str, int]:
        """Connections that were not admitted, by reason; reasons that never occurred are absent."""
        ...

    def close(self) -> None:
        """Close everything: wait at most ``LINGER_MS`` for frames on their way, leave no file and no thread."""
        ...


def require_sendable(frame: bytes) -> None:
    """Refuse a frame that every receiver would drop.

    Raises:
        ValueError: the frame is longer than ``MAX_CONTROL_BYTES``.
    """
    if len(frame) > MAX_CONTROL_BYTES:
        raise ValueError(f"found a frame of {len(frame)} bytes; expected at most {MAX_CONTROL_BYTES}")


def require_name(name: str) -> None:
    """Refuse a name that cannot be an identity or part of an endpoint.

    Raises:
        TransportError: the name is empty, too long, not ASCII, or has a character with a meaning in a path.
    """
    plain = name.isascii() and name.isprintable() and not set(name) & set("/\\*@: ")
    if not (plain and 1 <= len(name) <= MAX_NAME and name not in {".", ".."}):
        raise TransportError(
            f"found the name {name!r:.100}; expected 1 to {MAX_NAME} ASCII characters, no space and none of / \\ * @ :"
        )


def require_path(path: Path) -> None:
    """Refuse a path that no Unix-domain socket can have.

    Raises:
        TransportError: the path is too long.
    """
    length = len(bytes(path))
    if length > MAX_SOCKET_PATH:
        raise TransportError(
            f"found a socket path of {length} bytes, {path}; expected at most {MAX_SOCKET_PATH}; "
            "choose a shorter directory, such as one directly under /tmp"
        )


def milliseconds(timeout: Duration | None) -> int:
    """A timeout in the form of polling calls: whole ms rounded up, -1 for no end, at most 2³¹ - 1 (24 days)."""
    if timeout is None:
        return -1
    return min(max(-(-timeout // 1_000_000), 0), 2**31 - 1)
