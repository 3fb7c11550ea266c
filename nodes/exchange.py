"""A node's links to its peers, from the handshake to the last tick."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from manyhands.nodes.bundle import Common, Peer
from manyhands.nodes.life import Life
from manyhands.protocol.clock import Clock, Duration, Instant, from_seconds
from manyhands.protocol.codec import encode
from manyhands.protocol.gate import Bounds, Gate
from manyhands.protocol.handshake import Expected, LinkHandshake, shake_hands
from manyhands.protocol.limits import MAX_STRAY_FRAMES
from manyhands.protocol.messages import PROTOCOL_VERSION, LinkHello, Role, SignalMessage, Values
from manyhands.protocol.transport import Link, Transport

HANDSHAKE_TIME = from_seconds(20.0)
Indices = NDArray[np.int64]
PATIENCE = from_seconds(0.1)  # between two looks at whether the node should still run


@dataclass(frozen=True, eq=False)
class Joint:
    """One established link.

    Attributes:
        own: the node at this end.
        peer: who is at the other end.
        link: the connection.
        gate: admits the peer's signals.
        indices: where the link's ports are among the node's own; a slice where they follow each other.
        clock: by which a wait knows how long it has lasted; a realtime one.
    """

    own: str
    peer: Peer
    link: Link
    gate: Gate
    indices: slice | Indices
    clock: Clock

    def send(self, kind: type[SignalMessage], tick: int, stamp: int, values: Values) -> bool:
        """Send this link's share of the node's ``values``; False when the peer's queue is full or gone."""
        return self.link.send(encode(kind(tick, stamp, values[self.indices])))

    def receive_into(
        self,
        values: Values,
        tick: int,
        life: Life,
        patience: Duration = PATIENCE,
        silence: Callable[[], None] | None = None,
    ) -> bool:
        """Wait for the peer's signal of ``tick`` and put it into the node's ``values``.

        ``silence`` is called whenever ``patience`` has passed in vain, whatever else has arrived meanwhile. A peer
        that sends more than :data:`MAX_STRAY_FRAMES` other frames in one wait has the node fail.

        Returns:
            False when the node should end.
        """
        strays = 0
        now = self.clock.now()
        life.look(now)
        remaining, due = patience, Instant(now + patience)
        while not life.stopping:
            frame = self.link.recv(remaining)
            if frame is not None:
                admitted = self.gate.admit(frame, tick)
                if admitted is not None:
                    values[self.indices] = admitted
                    return True
                strays += 1
                if strays > MAX_STRAY_FRAMES:
                    life.fail(self._flood(strays, tick))
                    return False
                remaining = Duration(due - self.clock.now())
                if remaining > 0:
                    continue
            life.check()
            if silence is not None:
                silence()
            remaining, due = patience, Instant(self.clock.now() + patience)
        return False

    def _flood(self, strays: int, tick: int) -> str:
        kinds = ", ".join(f"{reason} {count}" for reason, count in self.gate.dropped.items() if count)
        return (
            f"{self.own}: {self.peer.name} sent {strays} stray frames while its signal of tick {tick} was awaited "
            f"(in all: {kinds}); expected at most {MAX_STRAY_FRAMES}; see what runs as {self.peer.name}"
        )


def _positions(own: tuple[str, ...], carried: tuple[str, ...]) -> slice | Indices:
    """Where ``carried`` ports are among ``own``: as a slice, which costs a tick less, where one will do."""
    at = [own.index(port) for port in carried]
    if at == list(range(at[0], at[0] + len(at))):
        return slice(at[0], at[0] + len(at))
    return np.array(at)


def bounds_by_peer(
    common: Common, role: Role, magnitude: Sequence[float | None], step: Sequence[float | None]
) -> dict[str, Bounds]:
    """Bounds of the signals of every peer of ``role``, from those of the node's own ports; None for no bound."""

    def of(bound: float | None) -> float:
        return math.inf if bound is None else bound

    by_port = {port: (of(m), of(s)) for port, m, s in zip(common.ports, magnitude, step, strict=True)}
    return {
        peer.name: Bounds(tuple(by_port[p][0] for p in peer.ports), tuple(by_port[p][1] for p in peer.ports))
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
) -> tuple[list[Joint], dict[str, LinkHello]]:
    """Shake hands on every link, in the session's order, which all nodes share: no two can wait for each other.

    Args:
        common: the node's bundle.
        links: a link for each peer.
        admits: the signal to expect from each peer.
        clock: for the time limit, and for waiting on the joints; a realtime one, for processes start and wait in real
            time whatever the session's clock.
        feedthrough: D_V, told to the environment alone.
        bounds: what the signals of a peer keep within; those of peers without an entry are not bounded.

    Returns:
        The joints in the order of the peers, and the peers' hellos.

    Raises:
        HandshakeRefused, HandshakeTimeout: told clearly, at both ends.
    """
    joints: list[Joint] = []
    hellos: dict[str, LinkHello] = {}
    deadline = Instant(clock.now() + HANDSHAKE_TIME)
    for peer in common.peers:
        tells = feedthrough is not None and peer.role == "environment"
        own = LinkHello(
            PROTOCOL_VERSION,
            common.certificate,
            common.session,
            common.name,
            common.role,
            peer.ports,
            tuple(map(tuple, feedthrough.tolist())) if tells and feedthrough is not None else None,
        )
        handshake = LinkHandshake(own, Expected(peer.name, peer.role, peer.ports), opens=not peer.binds)
        hellos[peer.name] = shake_hands(links[peer.name], handshake, clock, deadline)
        gate = Gate(admits[peer.name], len(peer.ports), (bounds or {}).get(peer.name))
        joints.append(Joint(common.name, peer, links[peer.name], gate, _positions(common.ports, peer.ports), clock))
    return joints, hellos
