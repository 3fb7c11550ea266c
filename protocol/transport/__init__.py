"""What the rest of the program may ask of a transport, whichever it is.

A :class:`Link` joins exactly two nodes and carries one frame each way a tick; the :class:`Hub` is the
supervisor's end of a star, told apart by identity. Sending never blocks: a loop that paces a hand cannot
wait for a slow reader, so a full queue is an answer (``False``), not a delay. All implementations pass the
same tests (``tests/protocol/test_transport.py``). A link or a hub is used by one thread.
"""

from collections.abc import Sequence
from typing import Protocol

from manyhands.protocol.clock import Duration
from manyhands.protocol.limits import MAX_CONTROL_BYTES, MAX_NAME


class TransportError(Exception):
    """An endpoint cannot be used as asked: what was found, and what would be right."""


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

    def close(self) -> None:
        """Close this end; frames on their way still leave. A second time does nothing."""
        ...


class Hub(Protocol):
    """The one end of a star of connections."""

    def recv(self) -> tuple[str, bytes] | None:
        """The next frame and the identity of its sender, or None if there is none now; never blocks.

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

    def wait(self, timeout: Duration | None, fds: Sequence[int] = ()) -> set[int]:
        """Wait until there is a frame, or one of ``fds`` is readable or hung up, or ``timeout`` has passed.

        Returns those of ``fds`` that are ready. An exception raised by a signal handler gets through.

        Raises:
            TransportError: if the hub is closed.
        """
        ...

    def close(self) -> None:
        """Close it; frames on their way still leave. A second time does nothing."""
        ...


class Transport(Protocol):
    """Makes links and hubs of one kind, and cleans up after all it has made."""

    def bind(self, name: str) -> tuple[Link, str]:
        """A link that exactly one peer may connect to, and the endpoint to tell it. ``name`` is used once.

        Raises:
            TransportError: if the endpoint cannot be bound.
        """
        ...

    def connect(self, endpoint: str) -> Link:
        """The other end of a bound link.

        Raises:
            TransportError: if ``endpoint`` is none of this transport's.
        """
        ...

    def bind_hub(self, name: str) -> tuple[Hub, str]:
        """A hub that many may join, and the endpoint to tell them. ``name`` is used once.

        Raises:
            TransportError: if the endpoint cannot be bound.
        """
        ...

    def join(self, endpoint: str, identity: str) -> Link:
        """A link to a hub, which knows it as ``identity``.

        Raises:
            TransportError: if ``endpoint`` is none of this transport's, or ``identity`` is no name.
        """
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


def milliseconds(timeout: Duration | None) -> int:
    """A timeout as polling calls take it: whole ms rounded up, -1 for ever, at most 2³¹ - 1 (24 days)."""
    if timeout is None:
        return -1
    return min(max(-(-timeout // 1_000_000), 0), 2**31 - 1)
