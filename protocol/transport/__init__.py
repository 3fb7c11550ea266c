"""What the rest of the program may ask of a transport, whichever it is.

A :class:`Link` joins exactly two nodes and carries one frame each way a tick; the :class:`Hub` is the
supervisor's end of a star, told apart by identity. Sending never blocks: a loop that paces a hand cannot
wait for a slow reader, so a full queue is an answer (``False``), not a delay. All implementations pass the
same tests (``tests/protocol/transport/test_transport.py``). A link or a hub is used by one thread.
"""

from collections.abc import Collection, Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import Protocol

from manyhands.protocol.clock import Duration
from manyhands.protocol.limits import MAX_CONTROL_BYTES, MAX_NAME, MAX_SOCKET_PATH


class TransportError(Exception):
    """An endpoint cannot be used as asked: what was found, and what would be right."""


class Trouble(StrEnum):
    """What can go wrong with a connection, in words for a person."""

    NOBODY = "nobody listens there"
    NOT_ADMITTED = "the other side does not admit this key"
    BROKEN_OFF = "the other side ended the connection before it had proved its key"
    NOT_PROVED = "the other side does not hold the key expected of it, or one side is encrypted and the other is not"
    LOST = "the connection was lost"


class Link(Protocol):
    """One end of a connection between two processes. Frames keep their borders and their order."""

    def send(self, frame: bytes) -> bool:
        """Queue a frame and return at once; False if it cannot be queued (nobody there yet, or it is full).

        Raises:
            ValueError: if the frame is longer than ``MAX_CONTROL_BYTES``.
            TransportError: if the link is closed.
        """
        ...

    def recv(self, timeout: Duration | None) -> bytes | None:
        """The next frame, or None if none came within ``timeout``.

        The timeout is rounded up to whole ms; 0 means not to wait, None to wait for ever. An exception
        raised by a signal handler gets through.

        Raises:
            TransportError: if the link is closed.
        """
        ...

    def trouble(self) -> Trouble | None:
        """What is known to have gone wrong with the connection; None while nothing is.

        Only the connection to a hub over a network is watched so closely: there nobody else tells of a loss.
        """
        ...

    def close(self) -> None:
        """Close this end; frames on their way still leave. A second time does nothing."""
        ...


class Hub(Protocol):
    """The one end of a star of connections."""

    @property
    def dropped(self) -> Mapping[str, int]:
        """Messages that were not passed on, by reason."""
        ...

    @property
    def handled(self) -> int:
        """Messages read, whether passed on or dropped."""
        ...

    def recv(self) -> tuple[str, bytes] | None:
        """The next frame and the identity of its sender, or None if there is none now; never blocks.

        None may also mean that many messages in a row were dropped; :meth:`wait` then returns at once.

        Raises:
            TransportError: if the hub is closed.
        """
        ...

    def send(self, identity: str, frame: bytes) -> bool:
        """Queue a frame for ``identity`` and return at once; False if it is not there or its queue is full.

        Raises:
            ValueError: if the frame is longer than ``MAX_CONTROL_BYTES``.
            TransportError: if the hub is closed.
        """
        ...

    def forget(self, identity: str) -> None:
        """Let another connection have the name ``identity``, which otherwise stays with the first that had it."""
        ...

    def wait(self, timeout: Duration | None, fds: Sequence[int] = (), frames: bool = True) -> set[int]:
        """Wait until there is a frame, or one of ``fds`` is readable or hung up, or ``timeout`` has passed.

        Without ``frames``, frames are left where they are. Returns those of ``fds`` that are ready. An exception
        raised by a signal handler gets through.

        Raises:
            TransportError: if the hub is closed.
        """
        ...

    def close(self) -> None:
        """Close it; frames on their way still leave. A second time does nothing."""
        ...


class Transport(Protocol):
    """Makes links and hubs of one kind, and cleans up after all it has made."""

    def bind(self, name: str, peer: str, address: str = "") -> tuple[Link, str]:
        """A link that ``peer`` alone may connect to, and the endpoint to tell it. ``name`` is used once.

        Where the transport has keys, that is enforced by them. ``address`` (host:port) is for TCP; without it, any
        free port of the loopback.

        Raises:
            TransportError: if the endpoint cannot be bound, or there is no key of ``peer``.
        """
        ...

    def connect(self, endpoint: str, peer: str) -> Link:
        """The other end of a link that ``peer`` has bound.

        Raises:
            TransportError: if ``endpoint`` is none of this transport's, or there is no key of ``peer``.
        """
        ...

    def bind_outlet(self, name: str, peer: str, address: str = "") -> tuple[Link, str]:
        """A link on which this end speaks and is never spoken to: as :meth:`bind`, but for a peer that comes and goes.

        To receive on it raises TransportError, and what a peer writes to it nevertheless is neither read nor kept.

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
        """A hub that ``members`` may join, and the endpoint to tell them. ``name`` is used once.

        Raises:
            TransportError: if the endpoint cannot be bound, or there is no key of a member.
        """
        ...

    def join(self, endpoint: str, identity: str) -> Link:
        """A link to a hub, which knows it as ``identity``.

        Raises:
            TransportError: if ``endpoint`` is none of this transport's, or ``identity`` is no name.
        """
        ...

    def settle(self) -> None:
        """All peers are here: from now on receiving is for frames alone, and :meth:`attend` for whoever knocks."""
        ...

    def attend(self) -> None:
        """Answer those who ask to be let in and count those who were not: bounded work, for a loop's slack."""
        ...

    def refused(self) -> Mapping[str, int]:
        """Connections that were not admitted, by reason; reasons that never occurred are absent."""
        ...

    def close(self) -> None:
        """Close all, wait at most ``LINGER_MS`` for frames on their way, leave no file and no thread."""
        ...


def require_sendable(frame: bytes) -> None:
    """Refuse a frame that every receiver would drop.

    Raises:
        ValueError: if it is longer than ``MAX_CONTROL_BYTES``.
    """
    if len(frame) > MAX_CONTROL_BYTES:
        raise ValueError(f"found a frame of {len(frame)} bytes; expected at most {MAX_CONTROL_BYTES}")


def require_name(name: str) -> None:
    """Refuse what cannot be part of an endpoint, or an identity.

    Raises:
        TransportError: if it is empty, too long, not ASCII, or has a character that means something in a
        path.
    """
    plain = name.isascii() and name.isprintable() and not set(name) & set("/\\*@: ")
    if not (plain and 1 <= len(name) <= MAX_NAME and name not in {".", ".."}):
        raise TransportError(
            f"found the name {name!r:.100}; expected 1 to {MAX_NAME} ASCII characters, no space and none of / \\ * @ :"
        )


def require_path(path: Path) -> None:
    """Refuse what cannot be the path of a Unix-domain socket.

    Raises:
        TransportError: if it is too long.
    """
    length = len(bytes(path))
    if length > MAX_SOCKET_PATH:
        raise TransportError(
            f"found a socket path of {length} bytes, {path}; expected at most {MAX_SOCKET_PATH}; "
            "choose a shorter directory, such as one directly under /tmp"
        )


def milliseconds(timeout: Duration | None) -> int:
    """A timeout as polling calls take it: whole ms rounded up, -1 for ever, at most 2³¹ - 1 (24 days)."""
    if timeout is None:
        return -1
    return min(max(-(-timeout // 1_000_000), 0), 2**31 - 1)
