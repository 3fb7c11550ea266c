"""What a node in its loop does when the supervisor tells that a peer is lost, or back."""

from __future__ import annotations

from collections.abc import Sequence

from manyhands.nodes.peer_link import PeerLink, handshake_of, joint_of
from manyhands.nodes.supervisor_line import ControlLine, Word
from manyhands.protocol.messages import Absent, Return
from manyhands.protocol.transport import TransportError


def follow(word: Word, joints: Sequence[PeerLink], control: ControlLine) -> PeerLink | None:
    """Do as the supervisor says about a peer; whatever else it may say is not for here.

    Returns:
        The joint with a peer that is lost; None if it was not said of one.
    """
    match word:
        case Absent():
            return part(word, joints, control)
        case Return():
            meet(word, joints, control)
    return None


def part(absent: Absent, joints: Sequence[PeerLink], control: ControlLine) -> PeerLink | None:
    """Close the link to a peer that is lost; where it is ours to bind, bind a new one and offer it.

    Returns:
        The joint with that peer; None if there is none.
    """
    joint = joint_of(joints, absent.peer)
    if joint is None:
        return None
    joint.lose()
    if joint.peer.binds:
        try:
            link, endpoint = control.bind_anew(joint.peer)
        except TransportError:  # the peer stays away: there is nowhere to come back to
            return joint
        joint.greet(link, handshake_of(joint))
        control.offer(joint.peer.name, endpoint)
    return joint


def meet(back: Return, joints: Sequence[PeerLink], control: ControlLine) -> None:
    """Connect to a peer that is back and binds the link to us."""
    joint = joint_of(joints, back.peer)
    if joint is None or joint.peer.binds:
        return
    try:
        link = control.connect(back.endpoint, joint.peer)
    except TransportError:  # no endpoint of this transport: it stays away
        return
    joint.greet(link, handshake_of(joint))
