"""One link of a running node: its signals of the tick, and what else may come of a peer.

A peer does its part in time, is silent, has fallen behind, is lost, or comes back on a new link. A peer link hears all
of that and says which (:class:`Received`); what is done about it is the node's own business (:class:`Listener`).

How a node and its peers come together: links bound, hands shaken, before the first tick and again later.

Before the first tick a node waits for its peers, one after the other, in the session's order. Once the loop runs
nobody waits any more: a peer that was lost and comes back is greeted on a new link, frame by frame, between the
ticks (:meth:`manyhands.nodes.peer_link.PeerLink.greet`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from enum import Enum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from manyhands.nodes.arithmetic import Floats
from manyhands.nodes.bundle import SIMULATED, Common, Peer
from manyhands.protocol.clock import Clock, Duration, Instant, from_seconds
from manyhands.protocol.codec import LAYOUTS, SignalWriter, decode, encode, type_of
from manyhands.protocol.gate import Bounds, Gate
from manyhands.protocol.handshake import Expected, LinkHandshake, shake_hands
from manyhands.protocol.limits import MAX_CONTROL_BYTES, MAX_STRAY_FRAMES
from manyhands.protocol.messages import PROTOCOL_VERSION, Absent, LinkHello, Refusal, Role, Rung, SignalMessage, Values
from manyhands.protocol.transport import Link, Transport

Indices = NDArray[np.int64]


class Received(Enum):
    """What came of listening to a peer."""

    SIGNAL = "the signal of the tick, put in its place"
    NOTHING = "nothing of use in the time allowed"
    DECLINED = "the listener wants no more of this tick"
    RECONNECTED = "the peer is back: hands were shaken on the new link"


class Listener(Protocol):
    """What a node makes of a frame that is not the signal of the tick."""

    def on_other_tick(self, peer_link: PeerLink, told: int, awaited: int) -> bool:
        """A proper signal of tick ``told`` came while ``awaited`` was waited for; whether to stop waiting for it."""
        ...

    def on_notice(self, peer_link: PeerLink, message: Rung | Absent) -> bool:
        """A word besides the signals; whether to stop waiting."""
        ...

    def flooded(self, text: str) -> None:
        """A peer sends more stray frames than any honest one: the node has to end, and why."""
        ...


class PeerLink:
    """One link of a node.

    Attributes:
        own: the hello that this end says.
        peer: who is at the other end.
        link: the connection; None while the peer is lost.
        gate: admits the peer's signals.
        indices: where the link's ports are among the node's own; a slice where they follow each other.
        handshake: the one that goes on with a peer that comes back; None otherwise.
        hello: what a peer said who came back.
        new: whether nothing has been admitted yet of a peer who came back: it may be at another tick.
        tick: that of the latest signal; -1 before the first.
        other_tick: the tick of the last signal that was not of the tick awaited.
        other_zero: whether all values of that signal were zero.
        other_frame: its frame.
    """

    def __init__(
        self,
        own: LinkHello,
        peer: Peer,
        link: Link | None,
        admits: type[SignalMessage],
        indices: slice | Indices,
        clock: Clock,
        bounds: Bounds | None = None,
    ) -> None:
        """Join the node to a peer that has shaken hands on ``link``.

        Args:
            own: the hello that this end says.
            peer: who is at the other end.
            link: the connection.
            admits: the signal that comes from there.
            indices: where its values belong.
            clock: by which a wait knows how long it has lasted, and a gate what has passed; a realtime one.
            bounds: what its values keep within.
        """
        self.own, self.peer, self.link, self.indices = own, peer, link, indices
        self.handshake: LinkHandshake | None = None
        self.hello: LinkHello | None = None
        self.new = False
        self.tick, self.other_tick, self.other_zero, self.other_frame = -1, 0, False, b""
        self._admits, self._bounds, self._clock = admits, bounds, clock
        self.gate = Gate(admits, len(peer.ports), bounds, clock)
        self._part = indices if isinstance(indices, slice) else None
        self._at = () if isinstance(indices, slice) else tuple(indices.tolist())
        self._writer: SignalWriter | None = None  # it sends one kind of signal, which is known when it does
        self._last: bytes = b""
        self._junk_tick, self._junk = -1, 0  # frames that were no signal at all, while this tick's was awaited

    @property
    def reachable(self) -> bool:
        """Whether there is a link to the peer, or the beginning of one."""
        return self.link is not None

    @property
    def here(self) -> bool:
        """Whether signals can be exchanged with the peer."""
        return self._open is not None

    @property
    def _open(self) -> Link | None:
        """The link, where hands have been shaken on it."""
        return self.link if self.handshake is None else None

    def share(self, values: Floats) -> Floats:
        """This link's part of the node's ``values``."""
        return [values[at] for at in self._at] if self._part is None else values[self._part]

    def put(self, values: Floats, share: Sequence[float]) -> None:
        """Put this link's ``share`` into the node's ``values``."""
        if self._part is not None:
            values[self._part] = share
            return
        for at, value in zip(self._at, share, strict=True):
            values[at] = value

    def send(self, kind: type[SignalMessage], tick: int, stamp: int, values: Floats) -> bool:
        """Send this link's share of the node's ``values``; False when the peer's queue is full or gone."""
        link = self.link
        if link is None or self.handshake is not None:
            return False
        writer = self._writer
        if writer is None or writer.kind is not kind:
            writer = self._writer = SignalWriter(kind, len(self.peer.ports))
        part = self._part
        share = self.share(values) if part is None else values[part]
        self._last = frame = writer.frame(tick, stamp, share)
        return link.send(frame)

    def send_again(self) -> None:
        """Send the last signal once more: it, or the answer to it, may have been lost with a connection."""
        link = self._open
        if link is not None and self._last:
            link.send(self._last)

    def send_zero(self, kind: type[SignalMessage], tick: int) -> None:
        """Tell the peer, by a force of zero, that ``tick`` is over: it goes on with the one after it."""
        link = self._open
        if link is not None and tick >= 0:
            link.send(encode(kind(tick, 0, np.zeros(len(self.peer.ports)))))

    def say(self, message: Rung | Absent) -> None:
        """Send a word besides the signals."""
        link = self._open
        if link is not None:
            link.send(encode(message))

    def hear(self, values: Floats, tick: int, timeout: Duration, listener: Listener) -> Received:
        """Listen for the peer's signal of ``tick``, at most ``timeout``, and put it into the node's ``values``."""
        link = self.link
        if link is None:
            return Received.NOTHING
        frame = link.recv(timeout)
        if frame is None:
            return Received.NOTHING
        if self.handshake is None:
            admitted = self.gate.admitted(frame, tick)
            if admitted is not None:
                part = self._part
                if part is None:
                    self.put(values, admitted)
                else:
                    values[part] = admitted
                self.tick = tick
                return Received.SIGNAL
        return self._hear_on(frame, values, tick, timeout, listener)

    def take(self, frame: bytes, values: Floats, tick: int) -> bool:
        """Put a signal that came early into the node's ``values``, now that it is its turn; whether it is admitted."""
        admitted = self.gate.admitted(frame, tick)
        if admitted is None:
            return False
        self.put(values, admitted)
        self.tick = tick
        return True

    def settle(self, tick: int) -> None:
        """The force of ``tick`` is applied; nothing is left to do for a peer in a process of its own."""

    def lose(self) -> None:
        """The peer is gone: close the link to it."""
        if self.link is not None:
            self.link.close()
        self.link, self.handshake = None, None

    def greet(self, link: Link, handshake: LinkHandshake) -> None:
        """Begin to shake hands with the peer, who comes back on ``link``; :meth:`hear` goes on with it."""
        self.lose()
        self.link, self.handshake = link, handshake
        for message in handshake.start():
            link.send(encode(message))

    def _hear_on(self, frame: bytes, values: Floats, tick: int, timeout: Duration, listener: Listener) -> Received:
        """Look at a frame that was not the signal of the tick, and listen on for the rest of the time."""
        due = Instant(self._clock.now() + timeout)
        strays = 0
        if self._junk_tick != tick:
            self._junk_tick, self._junk = tick, 0
        while True:
            signal = None if self.handshake is not None else self.gate.of_other_tick(frame)
            received = self._take(frame, signal, tick, listener)
            if received is not None:
                return received
            strays += 1
            self._junk += signal is None  # who is only behind says the same again and again
            if max(strays, self._junk) > MAX_STRAY_FRAMES:
                listener.flooded(self._flood(tick))
                return Received.NOTHING
            link = self.link
            left = Duration(max(0, due - self._clock.now())) if timeout else timeout
            if link is None or (timeout and not left):
                return Received.NOTHING
            following = link.recv(left)
            if following is None:
                return Received.NOTHING
            frame = following
            if self.handshake is None:
                admitted = self.gate.admitted(frame, tick)
                if admitted is not None:
                    self.put(values, admitted)
                    self.tick, self._junk_tick = tick, -1
                    return Received.SIGNAL

    def _take(self, frame: bytes, signal: tuple[int, bool] | None, tick: int, listener: Listener) -> Received | None:
        if self.handshake is not None:
            return self._shake(frame, self.handshake)
        if signal is not None and signal[0] != tick:
            (self.other_tick, self.other_zero), self.other_frame = signal, frame
            return Received.DECLINED if listener.on_other_tick(self, signal[0], tick) else None
        if signal is None and len(frame) <= _LONGEST_WORD and type_of(frame) in _WORDS:
            message = decode(frame, MAX_CONTROL_BYTES)
            if isinstance(message, Rung | Absent):
                self.gate.dropped["wrong_kind"] -= 1  # it was counted as a stray, and is none
                return Received.DECLINED if listener.on_notice(self, message) else None
        return None

    def _shake(self, frame: bytes, handshake: LinkHandshake) -> Received | None:
        link = self.link
        if link is None:
            return Received.NOTHING
        for message in handshake.receive(decode(frame, MAX_CONTROL_BYTES)):
            if not link.send(encode(message)) and not isinstance(message, Refusal):
                self.lose()  # gone again; the supervisor will tell
                return Received.NOTHING
        if not handshake.finished:
            return None
        if handshake.peer is None:  # refused: as good as absent, and told at the other end
            self.lose()
            return Received.NOTHING
        self.handshake, self.hello, self.new = None, handshake.peer, True
        before, self.gate = self.gate, Gate(self._admits, len(self.peer.ports), self._bounds, self._clock)
        self.gate.dropped.update(before.dropped)
        self._last, self.tick = b"", -1
        return Received.RECONNECTED

    def _flood(self, tick: int) -> str:
        kinds = ", ".join(f"{reason} {count}" for reason, count in self.gate.dropped.items() if count)
        return (
            f"{self.own.name}: {self.peer.name} sent {MAX_STRAY_FRAMES + 1} stray frames while its signal of tick "
            f"{tick} was awaited (in all: {kinds}); expected at most {MAX_STRAY_FRAMES}; see what runs as "
            f"{self.peer.name}"
        )


def await_all(
    peer_links: Sequence[PeerLink],
    last: PeerLink,
    values: Floats,
    tick: int,
    listener: Listener,
    react: Callable[[PeerLink, Received, int], int],
    pause: Callable[[int], Duration | None],
) -> int | None:
    """Wait until every peer has sent its signal of one tick; listen in turn to those that have not.

    Args:
        peer_links: the links.
        last: the one that was listened to last; the first round begins behind it.
        values: the node's values, where the signals are put.
        tick: the tick that is awaited.
        listener: what the node makes of frames that are not the signal.
        react: does what the node does about what it heard of a peer while it waited for a tick; returns the tick that
            is awaited from then on.
        pause: called before every round with the tick that is awaited; returns how long to listen to each peer at
            most, ns, or None to wait no longer.

    Returns:
        The tick that everybody has sent a signal of; None where the node waits no longer.
    """
    behind = peer_links.index(last) + 1
    order = (*peer_links[behind:], *peer_links[:behind])
    while any(peer_link.tick != tick for peer_link in order):
        left = pause(tick)
        if left is None:
            return None
        for peer_link in order:
            if peer_link.tick != tick:
                tick = react(peer_link, peer_link.hear(values, tick, left, listener), tick)
    return tick


_WORDS = {LAYOUTS[kind][0] for kind in (Rung, Absent)}
_LONGEST_WORD = 128  # bytes


def peer_link_of(peer_links: Sequence[PeerLink], peer: str) -> PeerLink | None:
    """The peer link with ``peer``; None if there is no such peer."""
    return next((peer_link for peer_link in peer_links if peer_link.peer.name == peer), None)


HANDSHAKE_TIME = from_seconds(20.0)


def bounds_by_peer(
    common: Common, role: Role, magnitude: Sequence[float | None], step: Sequence[float | None]
) -> dict[str, Bounds]:
    """Bounds of the signals of every peer of ``role``, from those of the node's own ports; None for no bound.

    Under the simulated clock a tick is one period, whatever the stamps say and however long it takes.
    """

    def of(bound: float | None) -> float:
        return math.inf if bound is None else bound

    period = None if common.clock == SIMULATED else from_seconds(common.period)
    by_port = {port: (of(m), of(s)) for port, m, s in zip(common.ports, magnitude, step, strict=True)}
    return {
        peer.name: Bounds(
            tuple(by_port[p][0] for p in peer.ports),
            tuple(by_port[p][1] for p in peer.ports),
            period,
        )
        for peer in common.peers
        if peer.role is role
    }


def bind_links(common: Common, transport: Transport) -> tuple[dict[str, Link], dict[str, str]]:
    """Bind the links that this node binds; returns them and their endpoints, by peer."""
    links: dict[str, Link] = {}
    endpoints: dict[str, str] = {}
    for peer in common.peers:
        if peer.binds:
            links[peer.name], endpoints[peer.name] = transport.bind(
                f"{common.name}-{peer.name}", peer.name, peer.address
            )
    return links, endpoints


def establish(
    common: Common,
    links: Mapping[str, Link],
    admits: Mapping[str, type[SignalMessage]],
    clock: Clock,
    feedthrough: Values | None = None,
    bounds: Mapping[str, Bounds] | None = None,
) -> tuple[list[PeerLink], dict[str, LinkHello]]:
    """Shake hands on every link, in the session's order, which all nodes share: no two can wait for each other.

    Args:
        common: the node's bundle.
        links: a link for each peer; a peer without one is absent, and met later.
        admits: the signal to expect from each peer.
        clock: for the time limit, and for waiting on the peer links; a realtime one, for processes start and wait in
        real
            time whatever the session's clock.
        feedthrough: D_V, told to the environment alone.
        bounds: what the signals of a peer keep within; those of peers without an entry are not bounded.

    Returns:
        The peer links in the order of the peers, and the hellos of those who are there.

    Raises:
        HandshakeRefused, HandshakeTimeout: told clearly, at both ends.
    """
    peer_links: list[PeerLink] = []
    hellos: dict[str, LinkHello] = {}
    deadline = Instant(clock.now() + HANDSHAKE_TIME)
    for peer in common.peers:
        link = links.get(peer.name)
        peer_link = PeerLink(
            hello_to(common, peer, feedthrough),
            peer,
            link,
            admits[peer.name],
            positions(common.ports, peer.ports),
            clock,
            (bounds or {}).get(peer.name),
        )
        peer_links.append(peer_link)
        if link is not None:
            hellos[peer.name] = shake_hands(link, handshake_of(peer_link), clock, deadline)
    return peer_links, hellos


def handshake_of(peer_link: PeerLink) -> LinkHandshake:
    """A handshake with the peer at the other end, at its beginning."""
    peer = peer_link.peer
    return LinkHandshake(peer_link.own, Expected(peer.name, peer.role, peer.ports), opens=not peer.binds)


def hello_to(common: Common, peer: Peer, feedthrough: Values | None) -> LinkHello:
    """What a node says first to one of its peers; D_V to the environment alone."""
    tells = feedthrough is not None and peer.role is Role.ENVIRONMENT
    return LinkHello(
        PROTOCOL_VERSION,
        common.certificate,
        common.session,
        common.name,
        common.role,
        peer.ports,
        tuple(map(tuple, feedthrough.tolist())) if tells and feedthrough is not None else None,
    )


def positions(own: tuple[str, ...], carried: tuple[str, ...]) -> slice | Indices:
    """Where ``carried`` ports are among ``own``: as a slice, which costs a tick less, where one will do."""
    at = [own.index(port) for port in carried]
    if at == list(range(at[0], at[0] + len(at))):
        return slice(at[0], at[0] + len(at))
    return np.array(at)
