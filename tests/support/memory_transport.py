"""The transport for tests: queues within one process, usable from several threads, without sockets.

It behaves as ZeroMQ does where the interface leaves no choice (a bound link without a peer declines to send,
queues are bounded), and is stricter where ZeroMQ is silent: a second peer of a link is an error here.
"""

import os
import select
import threading
from collections import deque
from collections.abc import Collection, Mapping, Sequence

from manyhands.protocol.clock import Duration
from manyhands.protocol.limits import HUB_QUEUE_FRAMES, LINK_QUEUE_FRAMES
from manyhands.protocol.transport import (
    Hub,
    Link,
    TransportError,
    Trouble,
    milliseconds,
    require_name,
    require_sendable,
)


class _Mailbox:
    """A bounded queue that one thread reads and any may fill; its descriptor is readable while it is not empty.

    With a descriptor, waiting for the queue is the same call as waiting for a process to end, and a signal
    handler's exception gets through it.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._lock = threading.Lock()
        self._items: deque[tuple[str, bytes]] = deque()
        self._closed = False
        self.fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)

    def put(self, sender: str, frame: bytes) -> bool:
        with self._lock:
            if self._closed or len(self._items) >= self._limit:
                return False
            if not self._items:
                os.eventfd_write(self.fd, 1)
            self._items.append((sender, frame))
            return True

    def take(self) -> tuple[str, bytes] | None:
        with self._lock:
            if self._closed:
                raise TransportError("cannot receive: it is closed")
            if not self._items:
                return None
            item = self._items.popleft()
            if not self._items:
                os.eventfd_read(self.fd)
            return item

    def wait(self, timeout: Duration | None, fds: Sequence[int] = (), frames: bool = True) -> set[int]:
        if self._closed:
            raise TransportError("cannot wait: it is closed")
        poller = select.poll()
        for fd in (*([self.fd] if frames else []), *fds):
            poller.register(fd, select.POLLIN)
        return {fd for fd, _ in poller.poll(milliseconds(timeout)) if fd != self.fd}

    def close(self) -> None:
        with self._lock:
            if not self._closed:
                self._closed = True
                self._items.clear()
                os.close(self.fd)

    @property
    def closed(self) -> bool:
        return self._closed


class _Boxes:
    """The mailboxes of one endpoint: its own, and one for each peer that connected or joined.

    Attributes:
        own: the mailbox of the bound end.
        peers: the mailbox of each peer with an identity, by identity.
        all: every mailbox, including those of forgotten peers.
    """

    def __init__(self, limit: int) -> None:
        self.own = _Mailbox(limit)
        self.peers: dict[str, _Mailbox] = {}
        self.all = [self.own]

    def close(self) -> None:
        for box in self.all:
            box.close()


class MemoryLink:
    """One end of a link; ``identity`` names this end to the other."""

    host = ""

    def __init__(
        self, boxes: _Boxes, inbox: _Mailbox, identity: str | None, sends: bool = True, receives: bool = True
    ) -> None:
        self._boxes, self._inbox = boxes, inbox
        self._sends, self._receives = sends, receives
        self._identity = identity  # None: the bound end

    def send(self, frame: bytes) -> bool:
        """Queue a frame; see :class:`~manyhands.protocol.transport.Link`."""
        require_sendable(frame)
        if self._inbox.closed or not self._sends:
            raise TransportError(f"cannot send on a link: it is {'closed' if self._sends else 'for receiving'}")
        if self._identity is not None:
            return self._boxes.own.put(self._identity, frame)
        peer = self._boxes.peers.get(_PEER)
        return peer is not None and peer.put("", frame)

    def recv(self, timeout: Duration | None) -> bytes | None:
        """The next frame; see :class:`~manyhands.protocol.transport.Link`."""
        if not self._receives:
            raise TransportError("cannot receive from a link: it is for sending")
        item = self._inbox.take()
        if item is None and milliseconds(timeout) != 0:
            self._inbox.wait(timeout)
            item = self._inbox.take()
        return None if item is None else item[1]

    def trouble(self) -> Trouble | None:
        """Nothing goes wrong within a process; see :class:`~manyhands.protocol.transport.Link`."""
        return None

    def close(self) -> None:
        """Close this end."""
        self._inbox.close()


_PEER = "peer"  # the one identity of a link's other end


class MemoryHub:
    """The centre of a star."""

    def __init__(self, boxes: _Boxes) -> None:
        self._boxes = boxes
        self.dropped: dict[str, int] = {}  # every peer here sends only frames
        self.handled = 0

    def recv(self) -> tuple[str, bytes] | None:
        """The next frame and its sender; see :class:`~manyhands.protocol.transport.Hub`."""
        received = self._boxes.own.take()
        self.handled += received is not None
        return received

    def send(self, identity: str, frame: bytes) -> bool:
        """Queue a frame for a node; see :class:`~manyhands.protocol.transport.Hub`."""
        require_name(identity)
        require_sendable(frame)
        if self._boxes.own.closed:
            raise TransportError("cannot send from a hub: it is closed")
        peer = self._boxes.peers.get(identity)
        return peer is not None and peer.put("", frame)

    def forget(self, identity: str) -> None:
        """Make the name free again; see :class:`~manyhands.protocol.transport.Hub`."""
        self._boxes.peers.pop(identity, None)

    def wait(self, timeout: Duration | None, fds: Sequence[int] = (), frames: bool = True) -> set[int]:
        """Wait for a frame or a descriptor; see :class:`~manyhands.protocol.transport.Hub`."""
        return self._boxes.own.wait(timeout, fds, frames)

    def close(self) -> None:
        """Close it."""
        self._boxes.own.close()


class MemoryTransport:
    """Links and hubs within this process; ``memory://name`` is the endpoint of ``name``."""

    _SCHEME = "memory://"

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._endpoints: dict[str, _Boxes] = {}
        self._closed = False

    def bind(self, name: str, peer: str, address: str = "") -> tuple[Link, str]:
        """A link to connect to; see :class:`~manyhands.protocol.transport.Transport`."""
        boxes, endpoint = self._bind(name, LINK_QUEUE_FRAMES)
        return MemoryLink(boxes, boxes.own, None), endpoint

    def connect(self, endpoint: str, peer: str) -> Link:
        """The other end of a bound link; see :class:`~manyhands.protocol.transport.Transport`."""
        return self._enter(endpoint, _PEER, LINK_QUEUE_FRAMES)

    def bind_outlet(self, name: str, peer: str, address: str = "") -> tuple[Link, str]:
        """A link one way; see :class:`~manyhands.protocol.transport.Transport`."""
        boxes, endpoint = self._bind(name, LINK_QUEUE_FRAMES)
        return MemoryLink(boxes, boxes.own, None, receives=False), endpoint

    def connect_outlet(self, endpoint: str, peer: str) -> Link:
        """Its other end; see :class:`~manyhands.protocol.transport.Transport`."""
        return self._enter(endpoint, _PEER, LINK_QUEUE_FRAMES, outlet=True)

    def bind_hub(self, name: str, members: Collection[str], address: str = "") -> tuple[Hub, str]:
        """A hub to join; see :class:`~manyhands.protocol.transport.Transport`."""
        boxes, endpoint = self._bind(name, HUB_QUEUE_FRAMES)
        return MemoryHub(boxes), endpoint

    def join(self, endpoint: str, identity: str) -> Link:
        """A link to a hub; see :class:`~manyhands.protocol.transport.Transport`."""
        require_name(identity)
        return self._enter(endpoint, identity, HUB_QUEUE_FRAMES)

    def settle(self) -> None:
        """There is no door; see :class:`~manyhands.protocol.transport.Transport`."""

    def attend(self) -> None:
        """There is no door; see :class:`~manyhands.protocol.transport.Transport`."""

    def refused(self) -> Mapping[str, int]:
        """No peer is refused within a process; see :class:`~manyhands.protocol.transport.Transport`."""
        return {}

    def close(self) -> None:
        """Close everything made here."""
        with self._lock:
            self._closed = True
            for boxes in self._endpoints.values():
                boxes.close()

    def _bind(self, name: str, limit: int) -> tuple[_Boxes, str]:
        require_name(name)
        endpoint = self._SCHEME + name
        with self._lock:
            self._require_open()
            if endpoint in self._endpoints:
                raise TransportError(f"found {endpoint} in use; expected a name that is bound once")
            boxes = self._endpoints[endpoint] = _Boxes(limit)
        return boxes, endpoint

    def _enter(self, endpoint: str, identity: str, limit: int, outlet: bool = False) -> Link:
        with self._lock:
            self._require_open()
            boxes = self._endpoints.get(endpoint)
            if boxes is None:
                raise TransportError(f"found the endpoint {endpoint!r:.300}; expected one that was bound here")
            there = boxes.peers.get(identity)
            if there is not None and not (outlet and there.closed):
                raise TransportError(f"found {identity} at {endpoint} already; expected it once")
            inbox = boxes.peers[identity] = _Mailbox(limit)
            boxes.all.append(inbox)
        return MemoryLink(boxes, inbox, identity, sends=not outlet)

    def _require_open(self) -> None:
        if self._closed:
            raise TransportError("cannot open an endpoint: the transport is closed")
