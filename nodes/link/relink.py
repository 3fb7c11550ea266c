"""The links that a node in its loop closes and opens anew, when the supervisor reports that a peer is lost or back.

The link to a lost peer is closed. Of the two ends of a link one binds: it binds a new link at once and reports the
endpoint, which the supervisor hands to the peer's new process. The other end connects when the peer is back. Either
end then begins a handshake, which goes on between the ticks.
"""

from __future__ import annotations

from collections.abc import Sequence

from manyhands.nodes.link.join import Join, join_of
from manyhands.nodes.link.peer_link import handshake_of
from manyhands.nodes.link.supervisor_line import ControlLine, Word
from manyhands.protocol.messages import Absent, Return
from manyhands.protocol.transport import TransportError


def follow(word: Word, joins: Sequence[Join], control: ControlLine) -> Join | None:
    """Follow the supervisor's report of a peer that is lost or back; any other message is ignored here.

    Returns:
        The join to the lost peer; None where the message reports no lost peer of this node.
    """
    match word:
        case Absent():
            return unlink(word, joins, control)
        case Return():
            relink(word, joins, control)
    return None


def unlink(absent: Absent, joins: Sequence[Join], control: ControlLine) -> Join | None:
    """Close the link to a lost peer; where this node binds it, bind a new one and report its endpoint.

    Returns:
        The join to that peer; None where this node has no such peer.
    """
    join = join_of(joins, absent.peer)
    if join is None:
        return None
    join.lose()
    if join.peer.binds:
        try:
            link, endpoint = control.bind_anew(join.peer)
        except TransportError:  # without a socket the peer cannot come back, and the session goes on without it
            return join
        join.greet(link, handshake_of(join))
        control.offer(join.peer.name, endpoint)
    return join


def relink(back: Return, joins: Sequence[Join], control: ControlLine) -> None:
    """Connect to a peer that is back, where the peer binds the link."""
    join = join_of(joins, back.peer)
    if join is None or join.peer.binds:
        return
    try:
        link = control.connect(back.endpoint, join.peer)
    except TransportError:  # the endpoint is none of this transport: the session goes on without the peer
        return
    join.greet(link, handshake_of(join))
