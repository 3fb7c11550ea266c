"""What joins a node to each of its peers: one table, and the handshakes on what it makes.

A node knows its peers from its bundle, and its loop knows :class:`~manyhands.nodes.link.join.Join` alone. In between
stands :data:`KINDS`. A new kind is a module with a :class:`~manyhands.nodes.link.join.JoinKind`, and a row here.

Before the first tick a node shakes hands with its peers, one after the other, in the session's order
(:func:`establish`). Once the loop runs no handshake may hold it up: a peer that was lost and comes back is greeted on a
new link, frame by frame, between the ticks (:meth:`~manyhands.nodes.link.join.Join.greet`).
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from manyhands.nodes.kernel.bundle import Peer
from manyhands.nodes.link.join import Join, JoinKind, OwnEnd
from manyhands.nodes.link.peer_link import Frames, handshake_of
from manyhands.nodes.wave_link.ends import WaveLinks
from manyhands.protocol.clock import Instant, from_seconds
from manyhands.protocol.handshake import shake_hands
from manyhands.protocol.transport import Link

HANDSHAKE_TIME = from_seconds(20.0)
"""Time limit for all handshakes of a node before its first tick, ns."""


class Inside(JoinKind):
    """The joins to nodes whose ticks run in this node's loop: each of them makes its own."""

    def serves(self, peer: Peer) -> bool:
        """The peers that are among those nodes."""
        return any(one.as_peer == peer for one in self.own.inside)

    def join(self, peer: Peer, link: Link | None) -> Join:
        """Join the node to ``peer``; no ``link`` leads there."""
        return next(one for one in self.own.inside if one.as_peer == peer).join_from(self.own)


KINDS: Final[Mapping[str, type[JoinKind]]] = MappingProxyType(
    {
        "within a process": Inside,
        "by waves": WaveLinks,
        "by frames": Frames,
    }
)
"""The kinds of joins, by name; the first that serves a peer makes the join."""


def establish(own: OwnEnd, links: Mapping[str, Link]) -> tuple[list[Join], list[JoinKind]]:
    """Join a node to all its peers, and shake hands on every link, in the session's order.

    All nodes share that order, so no two of them can wait for each other.

    Args:
        own: what the node brings to its joins.
        links: a link for each peer that has one; a peer without a link is absent, and is greeted later.

    Returns:
        The joins in the order of the peers, and their kinds. A join has the peer's hello where the peer is present.

    Raises:
        HandshakeRefused: the two ends disagree; each end reports the reason.
        HandshakeTimeout: a peer has not finished its handshake within :data:`HANDSHAKE_TIME`.
    """
    kinds = [kind(own) for kind in KINDS.values()]
    joins: list[Join] = []
    used: dict[JoinKind, None] = {}
    deadline = Instant(own.clock.now() + HANDSHAKE_TIME)
    for peer in (*own.common.peers, *(one.as_peer for one in own.inside)):
        kind = next(kind for kind in kinds if kind.serves(peer))
        link = links.get(peer.name)
        join = kind.join(peer, link)
        joins.append(join)
        used[kind] = None
        if link is not None:
            join.hello = shake_hands(link, handshake_of(join), own.clock, deadline)
    return joins, list(used)
