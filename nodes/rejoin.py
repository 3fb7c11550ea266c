"""What a node in its loop does when the supervisor tells that a peer is lost, or back."""

from __future__ import annotations

from collections.abc import Sequence

from manyhands.nodes.peer_link import PeerLink, handshake_of, peer_link_of
from manyhands.nodes.supervisor_line import ControlLine, Word
from manyhands.protocol.messages import Absent, Return
from manyhands.protocol.transport import TransportError


def follow(word: Word, peer_links: Sequence[PeerLink], control: ControlLine) -> PeerLink | None:
    """Do as the supervisor says about a peer; whatever else it may say is not for here.

    Returns:
        The peer link with a peer that is lost; None if it was not said of one.
    """
    match word:
        case Absent():
            return part(word, peer_links, control)
        case Return():
            meet(word, peer_links, control)
    return None


def part(absent: Absent, peer_links: Sequence[PeerLink], control: ControlLine) -> PeerLink | None:
    """Close the link to a peer that is lost; where it is ours to bind, bind a new one and offer it.

    Returns:
        The peer link with that peer; None if there is none.
    """
    peer_link = peer_link_of(peer_links, absent.peer)
    if peer_link is None:
        return None
    peer_link.lose()
    if peer_link.peer.binds:
        try:
            link, endpoint = control.bind_anew(peer_link.peer)
        except TransportError:  # the peer stays away: there is nowhere to come back to
            return peer_link
        peer_link.greet(link, handshake_of(peer_link))
        control.offer(peer_link.peer.name, endpoint)
    return peer_link


def meet(back: Return, peer_links: Sequence[PeerLink], control: ControlLine) -> None:
    """Connect to a peer that is back and binds the link to us."""
    peer_link = peer_link_of(peer_links, back.peer)
    if peer_link is None or peer_link.peer.binds:
        return
    try:
        link = control.connect(back.endpoint, peer_link.peer)
    except TransportError:  # no endpoint of this transport: it stays away
        return
    peer_link.greet(link, handshake_of(peer_link))
