"""A node's links to its peers, from the handshake to the last tick."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from manyhands.nodes.bundle import Common, Peer
from manyhands.nodes.life import Life
from manyhands.protocol.clock import Clock, Duration, Instant, from_seconds
from manyhands.protocol.codec import encode
from manyhands.protocol.gate import Gate
from manyhands.protocol.handshake import Expected, LinkHandshake, shake_hands
from manyhands.protocol.messages import PROTOCOL_VERSION, LinkHello, SignalMessage, Values
from manyhands.protocol.transport import Link, Transport

HANDSHAKE_TIME = from_seconds(20.0)
Indices = NDArray[np.int64]
PATIENCE = from_seconds(0.1)  # between two looks at whether the node should still run


@dataclass(frozen=True, eq=False)
class Joint:
    """One established link.

    Attributes:
        peer: who is at the other end.
        link: the connection.
        gate: admits the peer's signals.
        indices: where the link's ports are among the node's own; a slice where they follow each other.
    """

    peer: Peer
    link: Link
    gate: Gate
    indices: slice | Indices

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

        ``silence`` is called whenever ``patience`` has passed in vain. False when the node should end.
        """
        while not life.stopping:
            frame = self.link.recv(patience)
            if frame is None:
                life.check()
                if silence is not None:
                    silence()
                continue
            admitted = self.gate.admit(frame, tick)
            if admitted is not None:
                values[self.indices] = admitted
                return True
        return False


def _positions(own: tuple[str, ...], carried: tuple[str, ...]) -> slice | Indices:
    """Where ``carried`` ports are among ``own``: as a slice, which costs a tick less, where one will do."""
    at = [own.index(port) for port in carried]
    if at == list(range(at[0], at[0] + len(at))):
        return slice(at[0], at[0] + len(at))
    return np.array(at)


def bind_links(common: Common, transport: Transport) -> tuple[dict[str, Link], dict[str, str]]:
    """Bind the links that this node binds; returns them and their endpoints, by peer."""
    links: dict[str, Link] = {}
    endpoints: dict[str, str] = {}
    for peer in common.peers:
        if peer.binds:
            links[peer.name], endpoints[peer.name] = transport.bind(f"{common.name}-{peer.name}")
    return links, endpoints


def establish(
    common: Common,
    links: Mapping[str, Link],
    admits: Mapping[str, type[SignalMessage]],
    clock: Clock,
    feedthrough: Values | None = None,
) -> tuple[list[Joint], dict[str, LinkHello]]:
    """Shake hands on every link, in the session's order, which all nodes share: no two can wait for each other.

    Args:
        common: the node's bundle.
        links: a link for each peer.
        admits: the signal to expect from each peer.
        clock: for the time limit; a realtime one, for processes start in real time whatever the session's clock.
        feedthrough: D_V, told to the environment alone.

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
        gate = Gate(admits[peer.name], len(peer.ports))
        joints.append(Joint(peer, links[peer.name], gate, _positions(common.ports, peer.ports)))
    return joints, hellos
