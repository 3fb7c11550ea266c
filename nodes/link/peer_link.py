"""A join over ZeroMQ: the handshake, the signals of the ticks, and what else a peer may send.

A peer sends its signal in time, is silent, has fallen behind, is lost, or comes back on a new link. :class:`PeerLink`
tells these cases apart (:class:`~manyhands.nodes.link.join.Received`); the node decides what follows from each
(:class:`~manyhands.nodes.link.join.Listener`).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Final

import numpy as np

from manyhands.nodes.kernel.arithmetic import Floats
from manyhands.nodes.kernel.bundle import SIMULATED, Common, Peer
from manyhands.nodes.link.join import Indices, Join, JoinKind, Listener, Received, positions
from manyhands.nodes.link.repeats import TICKS_BACK, most_strays
from manyhands.protocol.clock import Clock, Duration, Instant, from_seconds
from manyhands.protocol.codec import LAYOUTS, SignalWriter, decode, encode, type_of
from manyhands.protocol.gate import Bounds, Gate
from manyhands.protocol.handshake import Expected, LinkHandshake
from manyhands.protocol.limits import MAX_CONTROL_BYTES, MAX_STRAY_FRAMES
from manyhands.protocol.messages import (
    PROTOCOL_VERSION,
    Absent,
    Force,
    LinkHello,
    Reaction,
    Role,
    Rung,
    Sample,
    SignalMessage,
    Tool,
    Values,
)
from manyhands.protocol.transport import Link, Transport


class PeerLink(Join):
    """A join over ZeroMQ: the tick's signals as frames.

    Attributes:
        gate: admits the peer's signals.
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
        riders: Sequence[int] = (),
    ) -> None:
        """Join the node to a peer.

        Args:
            own: the hello that this end sends.
            peer: the peer at the other end.
            link: the connection; None for a peer that is absent.
            admits: the type of the peer's signals.
            indices: where the values of the peer's ports belong among the node's own.
            clock: a realtime clock, which measures the waits and the time between the signals.
            bounds: the bounds of the peer's values; None for no bounds.
            riders: where what rides with the peer's signals belongs among the node's values.
        """
        super().__init__(own, peer, link, indices, clock, riders)
        self._admits, self._bounds = admits, bounds
        self.gate = self._new_gate()
        self._writer: SignalWriter | None = None  # made with the first signal sent, whose kind is known only then
        self._last: bytes = b""
        self._junk_tick, self._junk = -1, 0  # an awaited tick, and the frames during its wait that were no signals
        self._newest = -1  # the latest tick of which a signal was admitted
        self._admissions = deque([clock.now()], TICKS_BACK)  # when the first signal of each such tick was

    @property
    def dropped(self) -> Mapping[str, int]:
        """The frames that were not admitted, by reason."""
        return self.gate.dropped

    def recount(self, reason: str, by: int) -> None:
        """Add ``by`` to the frames that the gate counts for ``reason``."""
        self.gate.dropped[reason] += by

    @property
    def stamp(self) -> int:
        """The stamp of the latest signal admitted, ns; 0 before the first."""
        return self.gate.stamp

    @property
    def pressed(self) -> int:
        """The buttons behind the peer that are held down by the latest signal admitted, among the node's own."""
        return self.gate.buttons << self._first_button

    def forget(self) -> None:
        """Take the next signal as the first one, whose step has no bound."""
        self.gate.forget()

    def send(self, kind: type[SignalMessage], tick: int, stamp: int, values: Floats, pressed: int = 0) -> bool:
        """Send this link's share of the node's ``values`` in one frame; see :meth:`.Join.send`."""
        link = self.link
        if link is None or self.handshake is not None:
            return False
        writer = self._writer
        if writer is None or writer.kind is not kind:
            writer = self._writer = SignalWriter(kind, self.peer.width)
        part = self._part
        share = self.share(values) if part is None else values[part]
        self._last = frame = writer.frame(tick, stamp, share, self.share_of_buttons(pressed))
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
            link.send(encode(kind(tick, 0, np.zeros(self.peer.width))))

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
                self._has(tick)
                return Received.SIGNAL
        return self._hear_on(frame, values, tick, timeout, listener)

    def take(self, frame: bytes, values: Floats, tick: int) -> bool:
        """Put a signal that came early into the node's ``values`` in its own tick; returns whether it was admitted."""
        admitted = self.gate.admitted(frame, tick)
        if admitted is None:
            return False
        self.put(values, admitted)
        self._has(tick)
        return True

    def take_other(self, values: Floats, counted: str) -> bool:
        """Put the signal of :attr:`other_tick` into the node's ``values``; returns whether it was admitted.

        ``counted`` is the reason for which the gate counted it as a stray frame, which it is not, unless it is the zero
        force of a later tick.
        """
        self.recount(counted, -int(counted == "old_tick" or not self.other_zero))
        return super().take_other(values, counted)

    def _hear_on(self, frame: bytes, values: Floats, tick: int, timeout: Duration, listener: Listener) -> Received:
        """Handle a frame that was not the signal of the tick, and listen on for the rest of the time.

        Every frame that is read here costs time in the tick, so their number is bounded. A peer that is only behind
        repeats its valid signal as long as it waits, so such frames count for one call alone, and there may be more of
        them where the wait was long (:mod:`manyhands.nodes.link.repeats`). No honest peer sends many frames that are no
        signals, however long the wait; these count for the whole wait of a tick.
        """
        now = self._clock.now()
        due = Instant(now + timeout)
        strays, most = 0, most_strays(Duration(now - self._admissions[0]))
        if self._junk_tick != tick:
            self._junk_tick, self._junk = tick, 0
        while True:
            signal = None if self.handshake is not None else self.gate.of_other_tick(frame)
            received = self._take(frame, signal, tick, listener)
            if received is not None:
                return received
            strays += 1
            self._junk += signal is None  # a peer that is only behind repeats valid signals, and is no flood
            if strays > most or self._junk > MAX_STRAY_FRAMES:
                listener.flooded(self._flood(tick, most if strays > most else MAX_STRAY_FRAMES))
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
                    self._has(tick)
                    self._junk_tick = -1
                    return Received.SIGNAL

    def _has(self, tick: int) -> None:
        """Note that the peer's signal of ``tick`` was admitted; a node that has no use for it may take it again."""
        self.tick = tick
        if tick > self._newest:
            self._newest = tick
            self._admissions.append(self._clock.now())

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

    def _new_gate(self) -> Gate:
        return Gate(self._admits, self.peer.width, self._bounds, self._clock, self.peer.buttons[1])

    def _begin_life(self) -> None:
        """Begin anew with a peer that has shaken hands."""
        before, self.gate = self.gate, self._new_gate()
        self.gate.dropped.update(before.dropped)
        self._last, self.tick, self._newest = b"", -1, -1
        self._admissions = deque([self._clock.now()], TICKS_BACK)


_WORDS = {LAYOUTS[kind][0] for kind in (Rung, Absent)}
_LONGEST_WORD = 128  # bytes


SIGNALS: Final[Mapping[tuple[Role, Role], type[SignalMessage]]] = MappingProxyType(
    {
        (Role.DEVICE, Role.COUPLING): Sample,
        (Role.COUPLING, Role.ENVIRONMENT): Tool,
        (Role.ENVIRONMENT, Role.COUPLING): Reaction,
        (Role.COUPLING, Role.DEVICE): Force,
    }
)
"""The signal of a tick, by the roles of sender and receiver."""


class Frames(JoinKind):
    """The joins over ZeroMQ, or any transport that carries frames."""

    def serves(self, peer: Peer) -> bool:
        """Every peer that no other kind of join serves."""
        return True

    def join(self, peer: Peer, link: Link | None) -> PeerLink:
        """Join the node to ``peer``."""
        own, common = self.own, self.own.common
        where, bounds = positions(common.ports, peer.ports), own.bounds.get(peer.name)
        hello = hello_to(common, peer, own.feedthrough)
        riders = common.riders(peer.riding)
        return PeerLink(hello, peer, link, SIGNALS[peer.role, common.role], where, own.clock, bounds, riders)


def bounds_by_peer(
    common: Common, role: Role, magnitude: Sequence[float | None], step: Sequence[float | None]
) -> dict[str, Bounds]:
    """The bounds of the signals of every peer of ``role``, by the peer's name.

    What rides with a signal need only be finite here: whoever uses it judges it, and the motion beside it stays good.

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
            tuple(by_port[p][0] for p in peer.ports) + (math.inf,) * (peer.width - len(peer.ports)),
            tuple(by_port[p][1] for p in peer.ports) + (math.inf,) * (peer.width - len(peer.ports)),
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


def handshake_of(join: Join) -> LinkHandshake:
    """A new handshake with the peer at the other end of ``join``."""
    peer = join.peer
    return LinkHandshake(join.own, Expected(peer.name, peer.role, peer.ports), opens=not peer.binds)


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
