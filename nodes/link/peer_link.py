"""One link of a node to a peer: the handshake, the signals of the ticks, and what else a peer may send.

A peer sends its signal in time, is silent, has fallen behind, is lost, or comes back on a new link. :class:`PeerLink`
tells these cases apart (:class:`Received`); the node decides what follows from each (:class:`Listener`).
:func:`await_all` waits until every peer has sent its signal of one tick.

Before the first tick a node binds its links and shakes hands with its peers, one after the other, in the session's
order (:func:`establish`). Once the loop runs no handshake may hold it up: a peer that was lost and comes back is
greeted on a new link, frame by frame, between the ticks (:meth:`PeerLink.greet`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from enum import Enum
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.kernel.bundle import SIMULATED, Common, Peer
from manyhands.nodes.rows import figures as names
from manyhands.protocol.clock import Clock, Duration, Instant, from_seconds
from manyhands.protocol.codec import LAYOUTS, SignalWriter, decode, encode, type_of
from manyhands.protocol.gate import Bounds, Gate
from manyhands.protocol.handshake import Expected, LinkHandshake, shake_hands
from manyhands.protocol.limits import MAX_CONTROL_BYTES, MAX_STRAY_FRAMES
from manyhands.protocol.messages import PROTOCOL_VERSION, Absent, LinkHello, Refusal, Role, Rung, SignalMessage, Values
from manyhands.protocol.transport import Link, Transport

Indices = NDArray[np.int64]


class Received(Enum):
    """The outcome of listening to a peer once."""

    SIGNAL = "the signal of the tick, put into the node's values"
    NOTHING = "nothing of use in the time allowed"
    DECLINED = "the listener no longer awaits this tick"
    RECONNECTED = "the peer is back, and has shaken hands on a new link"
    FLOODED = "more stray frames than any honest peer sends, so that the link was closed"


class Listener(Protocol):
    """How a node handles a frame that is not the signal of the tick."""

    def on_other_tick(self, peer_link: PeerLink, other: int, awaited: int) -> bool:
        """Handle a valid signal of tick ``other``, which came in place of ``awaited``; returns whether to stop waiting.

        Where this returns True, :meth:`PeerLink.hear` returns ``Received.DECLINED``.
        """
        ...

    def on_notice(self, peer_link: PeerLink, message: Rung | Absent) -> bool:
        """Handle a message that is no signal; returns whether to stop waiting for ``Received.DECLINED``."""
        ...

    def flooded(self, text: str) -> None:
        """End the node, for the reason ``text``: a peer sends more stray frames than any honest peer does."""
        ...


class WaveRow(NamedTuple):
    """One tick of an end of a wave link, as telemetry reports it.

    Attributes:
        c: the incoming wave, W^(1/2).
        tank: the energy in the tank, what it has shipped, and what it has heard, J.
        p: the free position of the tool at a world's end, m; empty at a user's, whose block reports it.
        f: the force on it behind its clutch, N; likewise.
        begins: whether a world's end took its position from the first wave of a life in this tick.
    """

    c: Floats
    tank: Floats
    p: Floats = []  # noqa: RUF012  # never changed
    f: Floats = []  # noqa: RUF012
    begins: bool = False


class PeerLink:
    """One link of a node.

    Attributes:
        own: the hello that this end sends.
        peer: the peer at the other end.
        link: the connection; None while the peer is lost.
        gate: admits the peer's signals.
        indices: where the link's ports are among the node's own; a slice where they follow each other.
        handshake: the unfinished handshake with a peer that comes back; None otherwise.
        hello: the hello of a peer that came back; None before that.
        new: whether the peer came back and no signal of it has been admitted since: it may be at another tick.
        tick: the tick of the latest signal admitted; -1 before the first.
        other_tick: the tick of the last signal that was not of the tick awaited.
        other_zero: whether all values of that signal were zero.
        other_frame: the frame of that signal.
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
        """Join the node to a peer.

        Args:
            own: the hello that this end sends.
            peer: the peer at the other end.
            link: the connection; None for a peer that is absent.
            admits: the type of the peer's signals.
            indices: where the peer's values belong among the node's own.
            clock: a realtime clock, which measures the waits and the time between the signals.
            bounds: the bounds of the peer's values; None for no bounds.
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
        self._writer: SignalWriter | None = None  # made with the first signal sent, whose kind is known only then
        self._last: bytes = b""
        self._junk_tick, self._junk = -1, 0  # an awaited tick, and the frames during its wait that were no signals

    @property
    def reachable(self) -> bool:
        """Whether there is a link to the peer, with its handshake finished or not."""
        return self.link is not None

    @property
    def here(self) -> bool:
        """Whether signals can be exchanged with the peer."""
        return self._open is not None

    @property
    def _open(self) -> Link | None:
        """The link, once its handshake is finished; None before."""
        return self.link if self.handshake is None else None

    @property
    def dropped(self) -> Mapping[str, int]:
        """The frames that were not admitted, by reason."""
        return self.gate.dropped

    @property
    def strays(self) -> int:
        """The number of frames that were not admitted."""
        return sum(self.gate.dropped.values())

    @property
    def stamp(self) -> int:
        """The stamp of the latest signal admitted, ns; 0 before the first."""
        return self.gate.stamp

    def resume(self) -> None:
        """Begin in a session that runs already; a link that carries the tick's signals needs nothing for that."""

    def forget(self) -> None:
        """Take the next signal as the first one, whose step has no bound."""
        self.gate.forget()

    def figures(self) -> Mapping[str, float]:
        """Figures of the link itself, for telemetry and report; a link that carries the tick's signals has none."""
        return {}

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
        """Send this link's share of the node's ``values``.

        Args:
            kind: the type of the signal.
            tick: k.
            stamp: when the device took the sample that the signal follows from, ns.
            values: those of all ports of the node.

        Returns:
            Whether the frame is on its way; False where the peer is lost, or its queue is full.
        """
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
        """Send the last signal once more: the signal or its answer may have been lost with a connection."""
        link = self._open
        if link is not None and self._last:
            link.send(self._last)

    def send_zero(self, kind: type[SignalMessage], tick: int) -> None:
        """Send the peer a zero force of ``tick``: that tick is over, and the peer goes on with the next one."""
        link = self._open
        if link is not None and tick >= 0:
            link.send(encode(kind(tick, 0, np.zeros(len(self.peer.ports)))))

    def notify(self, message: Rung | Absent) -> None:
        """Send a message that is no signal."""
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
        """Put a signal that came early into the node's ``values`` in its own tick; returns whether it was admitted."""
        admitted = self.gate.admitted(frame, tick)
        if admitted is None:
            return False
        self.put(values, admitted)
        self.tick = tick
        return True

    def take_other(self, values: Floats, counted: str) -> bool:
        """Put the signal of :attr:`other_tick` into the node's ``values``; returns whether it was admitted.

        ``counted`` is the reason for which the gate counted it as a stray frame, which it is not, unless it is the zero
        force of a later tick.
        """
        self.gate.dropped[counted] -= counted == "old_tick" or not self.other_zero
        return self.take(self.other_frame, values, self.other_tick)

    def settle(self, tick: int) -> None:
        """Finish ``tick``, once its force is applied; a peer in a process of its own needs nothing more."""

    def finished(self, tick: int) -> WaveRow | None:
        """Finish ``tick``, and return the :attr:`row`."""
        self.settle(tick)
        return self.row

    @property
    def row(self) -> WaveRow | None:
        """What telemetry reports of the end of a wave link in the last tick; None for every other link."""
        return None

    def lose(self) -> None:
        """Close the link to a peer that is gone."""
        if self.link is not None:
            self.link.close()
        self.link, self.handshake = None, None

    def refuse(self, refusal: Refusal) -> None:
        """Tell a peer that has shaken hands why it stays absent, and close the link."""
        if (link := self._open) is not None:
            link.send(encode(refusal))
        self.lose()

    def greet(self, link: Link, handshake: LinkHandshake) -> None:
        """Begin the handshake with a peer that comes back on ``link``; :meth:`hear` continues it."""
        self.lose()
        self.link, self.handshake = link, handshake
        for message in handshake.start():
            link.send(encode(message))

    def _hear_on(self, frame: bytes, values: Floats, tick: int, timeout: Duration, listener: Listener) -> Received:
        """Handle a frame that was not the signal of the tick, and listen on for the rest of the time.

        Every frame that is read here costs time in the tick, so their number is bounded. A peer that is only behind
        repeats its valid signal as long as it waits, so such frames count for one call alone. Frames that are no
        signals count for the whole wait of a tick.
        """
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
            self._junk += signal is None  # a peer that is only behind repeats valid signals, and is no flood
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
                self.gate.dropped["wrong_kind"] -= 1  # the gate counted it as a stray frame, which it is not
                return Received.DECLINED if listener.on_notice(self, message) else None
        return None

    def _shake(self, frame: bytes, handshake: LinkHandshake) -> Received | None:
        link = self.link
        if link is None:
            return Received.NOTHING
        for message in handshake.receive(decode(frame, MAX_CONTROL_BYTES)):
            if not link.send(encode(message)) and not isinstance(message, Refusal):
                self.lose()  # the peer is gone again; the supervisor will report it
                return Received.NOTHING
        if not handshake.finished:
            return None
        if handshake.peer is None:  # refused: the peer counts as absent, and the other end has received the reason
            self.lose()
            return Received.NOTHING
        self.handshake, self.hello, self.new = None, handshake.peer, True
        self._begin_life()
        return Received.RECONNECTED

    def _begin_life(self) -> None:
        """Begin anew with a peer that has shaken hands."""
        before, self.gate = self.gate, Gate(self._admits, len(self.peer.ports), self._bounds, self._clock)
        self.gate.dropped.update(before.dropped)
        self._last, self.tick = b"", -1

    def _flood(self, tick: int) -> str:
        kinds = ", ".join(f"{reason} {count}" for reason, count in self.dropped.items() if count)
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
    """Wait until every peer has sent its signal of one tick; listen in turn to the peers that have not.

    The awaited tick may change during the wait: ``react`` moves a node to the tick of a peer that is further on. Peers
    whose signal of the earlier tick is there already are then awaited again, so the loop compares with the tick anew.

    Args:
        peer_links: the links.
        last: the link that was listened to last; the first round begins with the link after it.
        values: the node's values, where the signals are put.
        tick: the tick that is awaited.
        listener: handles the frames that are not the signal.
        react: called with a link, the outcome of listening to it and the awaited tick; returns the tick that is awaited
            from then on.
        pause: called before every round with the tick that is awaited; returns how long to listen to each peer at
            most, ns, or None to wait no longer.

    Returns:
        The tick of which every peer has sent its signal; None where the node waits no longer.
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
"""Time limit for all handshakes of a node before its first tick, ns."""


def bounds_by_peer(
    common: Common, role: Role, magnitude: Sequence[float | None], step: Sequence[float | None]
) -> dict[str, Bounds]:
    """The bounds of the signals of every peer of ``role``, by the peer's name.

    Under the simulated clock a tick counts as one period, whatever the stamps say and however long it takes.

    Args:
        common: the node's bundle.
        role: the role of the peers.
        magnitude: by port of the node, the greatest absolute value, in the signal's unit; None for no bound.
        step: by port of the node, the greatest change in one period, in the signal's unit; None for no bound.
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
    ends: Mapping[str, Callable[[Peer, Link | None], PeerLink]] | None = None,
) -> tuple[list[PeerLink], dict[str, LinkHello]]:
    """Shake hands on every link, in the session's order.

    All nodes share that order, so no two of them can wait for each other.

    Args:
        common: the node's bundle.
        links: a link for each peer; a peer without a link is absent, and is greeted later.
        admits: the type of the signals of each peer.
        clock: a realtime clock, for the time limit and the waits on the links. Processes start and wait in real time,
            whatever the session's clock.
        feedthrough: D_V of a coupling, m/N, which is sent to the environment alone.
        bounds: the bounds of a peer's signals; the signals of peers without an entry are not bounded.
        ends: what makes the ends of wave links, by peer; a peer without an entry exchanges the signals of the tick.

    Returns:
        The peer links in the order of the peers, and by peer the hellos of the peers that are present.

    Raises:
        HandshakeRefused: the two ends disagree; each end reports the reason.
        HandshakeTimeout: a peer has not finished its handshake within :data:`HANDSHAKE_TIME`.
    """
    peer_links: list[PeerLink] = []
    hellos: dict[str, LinkHello] = {}
    deadline = Instant(clock.now() + HANDSHAKE_TIME)
    for peer in common.peers:
        link = links.get(peer.name)
        if ends and peer.name in ends:
            peer_link = ends[peer.name](peer, link)
        else:
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
    """A new handshake with the peer at the other end of ``peer_link``."""
    peer = peer_link.peer
    return LinkHandshake(peer_link.own, Expected(peer.name, peer.role, peer.ports), opens=not peer.binds)


def hello_to(common: Common, peer: Peer, feedthrough: Values | None) -> LinkHello:
    """The first message of a node to one of its peers; D_V, m/N, is in it for the environment alone."""
    informed = feedthrough is not None and peer.role is Role.ENVIRONMENT
    return LinkHello(
        PROTOCOL_VERSION,
        peer.certificate or common.certificate,
        common.session,
        common.name,
        common.role,
        peer.ports,
        tuple(map(tuple, feedthrough.tolist())) if informed and feedthrough is not None else None,
    )


def positions(own: tuple[str, ...], carried: tuple[str, ...]) -> slice | Indices:
    """Where the ``carried`` ports are among ``own``: a slice where they follow each other, for it costs a tick less."""
    at = [own.index(port) for port in carried]
    if at == list(range(at[0], at[0] + len(at))):
        return slice(at[0], at[0] + len(at))
    return np.array(at)


def stray_frames(peer_links: Iterable[PeerLink]) -> dict[str, float]:
    """The number of frames that the gates did not admit, as a figure of telemetry."""
    return {names.NOT_ADMITTED: float(sum(peer_link.strays for peer_link in peer_links))}


def dropped_frames(peer_links: Iterable[PeerLink]) -> dict[str, float]:
    """The numbers of frames that the gates did not admit, by reason, over all links."""
    out: dict[str, float] = {}
    for peer_link in peer_links:
        for reason, count in peer_link.dropped.items():
            out[reason] = out.get(reason, 0.0) + count
    return out
