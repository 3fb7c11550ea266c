"""How a node and its peers come together: links bound, hands shaken, before the first tick and again later.

Before the first tick a node waits for its peers, one after the other, in the session's order. Once the loop runs
nobody waits any more: a peer that was lost and comes back is greeted on a new link, frame by frame, between the
ticks (:meth:`manyhands.nodes.exchange.Joint.greet`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from manyhands.nodes.bundle import SIMULATED, Common, Peer
from manyhands.nodes.exchange import Indices, Joint
from manyhands.protocol.clock import Clock, Instant, from_seconds
from manyhands.protocol.gate import Bounds
from manyhands.protocol.handshake import Expected, LinkHandshake, shake_hands
from manyhands.protocol.messages import PROTOCOL_VERSION, LinkHello, Role, SignalMessage, Values
from manyhands.protocol.transport import Link, Transport

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
) -> tuple[list[Joint], dict[str, LinkHello]]:
    """Shake hands on every link, in the session's order, which all nodes share: no two can wait for each other.

    Args:
        common: the node's bundle.
        links: a link for each peer; a peer without one is absent, and met later.
        admits: the signal to expect from each peer.
        clock: for the time limit, and for waiting on the joints; a realtime one, for processes start and wait in real
            time whatever the session's clock.
        feedthrough: D_V, told to the environment alone.
        bounds: what the signals of a peer keep within; those of peers without an entry are not bounded.

    Returns:
        The joints in the order of the peers, and the hellos of those who are there.

    Raises:
        HandshakeRefused, HandshakeTimeout: told clearly, at both ends.
    """
    joints: list[Joint] = []
    hellos: dict[str, LinkHello] = {}
    deadline = Instant(clock.now() + HANDSHAKE_TIME)
    for peer in common.peers:
        link = links.get(peer.name)
        joint = Joint(
            hello_to(common, peer, feedthrough),
            peer,
            link,
            admits[peer.name],
            positions(common.ports, peer.ports),
            clock,
            (bounds or {}).get(peer.name),
        )
        joints.append(joint)
        if link is not None:
            hellos[peer.name] = shake_hands(link, handshake_of(joint), clock, deadline)
    return joints, hellos


def handshake_of(joint: Joint) -> LinkHandshake:
    """A handshake with the joint's peer, at its beginning."""
    peer = joint.peer
    return LinkHandshake(joint.own, Expected(peer.name, peer.role, peer.ports), opens=not peer.binds)


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
