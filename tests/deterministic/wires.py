"""Links and a hub whose frames take a virtual time to arrive, and may be lost with the process that sent them.

They behave as ZeroMQ's do here: order is kept, queues are bounded, a bound link without a peer declines to send, and
one that has connected sends into the void once the other end is gone.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Mapping
from typing import Final

from manyhands.protocol.clock import Duration, Instant
from manyhands.protocol.limits import HUB_QUEUE_FRAMES, LINK_QUEUE_FRAMES
from manyhands.protocol.transport import Hub, Link, TransportError, Trouble, milliseconds

from .scheduler import NEVER, Scheduler

LATENCY: Final = (5_000, 40_000)  # ns, of a frame
_MILLISECOND: Final = 1_000_000  # ns


class Inbox:
    """Frames on their way to one end of a link, and those that have arrived."""

    def __init__(self, scheduler: Scheduler, limit: int) -> None:
        self._scheduler, self._limit = scheduler, limit
        self._frames: deque[tuple[Instant, bytes]] = deque()
        self._latest = Instant(0)
        self.closed = False

    def first(self) -> Instant:
        """When the first one arrives, or did."""
        return self._frames[0][0] if self._frames else NEVER

    def put(self, frame: bytes) -> bool:
        """A frame is sent; False if it is not queued."""
        if self.closed or len(self._frames) >= self._limit:
            return False
        scheduler = self._scheduler
        arrives = scheduler.now + scheduler.random.randint(*LATENCY)
        self._latest = Instant(max(self._latest, arrives))  # they keep their order
        self._frames.append((self._latest, frame))
        return True

    def take(self, timeout: Duration | None) -> bytes | None:
        """The next frame that has arrived, within ``timeout``."""
        scheduler = self._scheduler
        rounded = milliseconds(timeout)  # up, as ZeroMQ's poll does
        until = NEVER if rounded < 0 else Instant(scheduler.now + rounded * _MILLISECOND)
        scheduler.wait(self, until)
        return self._frames.popleft()[1] if self.first() <= scheduler.now else None

    def lose(self, chance: float) -> None:
        """Their sender dies: those after some point never leave it."""
        random = self._scheduler.random
        while self._frames and self._frames[-1][0] > self._scheduler.now and random.random() < chance:
            self._frames.pop()

    def close(self) -> None:
        """Nobody reads here any more."""
        self.closed = True
        self._frames.clear()


class Wire:
    """One endpoint: the binder's inbox, and the connector's once it has come."""

    def __init__(self, scheduler: Scheduler) -> None:
        self.binder = Inbox(scheduler, LINK_QUEUE_FRAMES)
        self.connector: Inbox | None = None


class WireLink:
    """One end of a link."""

    def __init__(self, own: Inbox, put: Callable[[bytes], bool], other: Callable[[], Inbox | None]) -> None:
        self._own, self._put, self._other = own, put, other

    def send(self, frame: bytes) -> bool:
        """Queue a frame; see :class:`~manyhands.protocol.transport.Link`."""
        if self._own.closed:
            raise TransportError("cannot send on a link: it is closed")
        return self._put(frame)

    def recv(self, timeout: Duration | None) -> bytes | None:
        """The next frame; see :class:`~manyhands.protocol.transport.Link`."""
        if self._own.closed:
            raise TransportError("cannot receive: it is closed")
        return self._own.take(timeout)

    def trouble(self) -> Trouble | None:
        """Nothing is known of the connection; see :class:`~manyhands.protocol.transport.Link`."""
        return None

    def close(self) -> None:
        """Close this end."""
        self._own.close()

    def die(self, chance: float) -> None:
        """Close it as the end of its process does: what it sent last may be lost."""
        other = self._other()
        if other is not None:
            other.lose(chance)
        self._own.close()


class Wires:
    """All endpoints of a session, and the nodes at its hub.

    Attributes:
        endpoints: the wires, by the endpoint that a node receives.
        seen: called with every frame between nodes as it is sent: the process, the peer, the frame.
    """

    def __init__(self, scheduler: Scheduler, hear: Callable[[str, bytes], None]) -> None:
        """``hear`` receives each frame to the hub when it arrives, with its sender."""
        self.scheduler, self._hear = scheduler, hear
        self.endpoints: dict[str, Wire] = {}
        self.seen: Callable[[str, str, bytes], None] = lambda _sender, _peer, _frame: None
        self._members: dict[str, Inbox] = {}
        self._latest: dict[Inbox, int] = {}

    def join(self, identity: str) -> WireLink:
        """A link to the hub; the name stays with the first that has it until it is released."""
        own = Inbox(self.scheduler, HUB_QUEUE_FRAMES)
        self._members.setdefault(identity, own)

        def put(frame: bytes) -> bool:
            if self._members.get(identity) is own:  # of a former connection nothing is heard any more
                arrives = self.scheduler.now + self.scheduler.random.randint(*LATENCY)
                arrives = self._latest[own] = max(arrives, self._latest.get(own, 0) + 1)
                self.scheduler.at(arrives, lambda: self._hear(identity, frame))
            return True

        return WireLink(own, put, lambda: None)

    def tell(self, identity: str, frame: bytes) -> None:
        """Send from the hub."""
        inbox = self._members.get(identity)
        if inbox is not None:
            inbox.put(frame)

    def release(self, identity: str) -> None:
        """Let another connection have the name."""
        self._members.pop(identity, None)


class ProcessTransport:
    """The :class:`~manyhands.protocol.transport.Transport` of one process."""

    def __init__(self, wires: Wires, process: str, led: Callable[[WireLink], Link] = lambda link: link) -> None:
        """``led``: makes of each link to a peer what the process has of it."""
        self._wires, self._process, self._led = wires, process, led
        self._links: list[WireLink] = []

    def bind(self, name: str, peer: str, address: str = "") -> tuple[Link, str]:
        """A link to connect to; see :class:`~manyhands.protocol.transport.Transport`."""
        endpoint = f"wire://{self._process}/{name}"
        if endpoint in self._wires.endpoints:
            raise TransportError(f"found {endpoint} in use")
        wire = self._wires.endpoints[endpoint] = Wire(self._wires.scheduler)

        def put(frame: bytes) -> bool:
            self._wires.seen(self._process, peer, frame)
            return wire.connector is not None and wire.connector.put(frame)

        return self._led(self._keep(WireLink(wire.binder, put, lambda: wire.connector))), endpoint

    def connect(self, endpoint: str, peer: str) -> Link:
        """The other end of a bound link; see :class:`~manyhands.protocol.transport.Transport`."""
        wire = self._wires.endpoints[endpoint]
        assert wire.connector is None, f"{endpoint} was connected to twice"
        own = wire.connector = Inbox(self._wires.scheduler, LINK_QUEUE_FRAMES)

        def put(frame: bytes) -> bool:
            self._wires.seen(self._process, peer, frame)
            return wire.binder.closed or wire.binder.put(frame)

        return self._led(self._keep(WireLink(own, put, lambda: wire.binder)))

    def join(self, endpoint: str, identity: str) -> Link:
        """A link to the hub; see :class:`~manyhands.protocol.transport.Transport`."""
        return self._keep(self._wires.join(identity))

    def die(self, chance: float) -> None:
        """The process is gone."""
        for link in self._links:
            link.die(chance)

    def bind_outlet(self, name: str, peer: str, address: str = "") -> tuple[Link, str]:
        """Not in these sessions."""
        raise NotImplementedError

    def connect_outlet(self, endpoint: str, peer: str) -> Link:
        """Not in these sessions."""
        raise NotImplementedError

    def bind_hub(self, name: str, members: Collection[str], address: str = "") -> tuple[Hub, str]:
        """The supervisor has no hub here: it receives each frame by a call."""
        raise NotImplementedError

    def settle(self) -> None:
        """There is no door."""

    def attend(self) -> None:
        """There is no door."""

    def refused(self) -> Mapping[str, int]:
        """Nobody is refused."""
        return {}

    def close(self) -> None:
        """Close everything made here; what was sent is delivered."""
        self.die(0.0)

    def _keep(self, link: WireLink) -> WireLink:
        self._links.append(link)
        return link
