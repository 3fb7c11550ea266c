"""Where nodes and their session stand, and which message leads a node where."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Final

from manyhands.protocol.messages import Fault, Message, NodeHello, Probe, Ready, Report, Telemetry


class NodeState(StrEnum):
    """Where a node stands in its life."""

    STARTING = "starting"
    WELCOMED = "connecting"
    CONNECTED = "shaking hands"
    READY = "ready"
    RUNNING = "running"
    REPORTED = "done"
    FAULTED = "failed"
    LEAVING = "leaving"  # its process is as good as over, and is waited for
    LOST = "lost"  # it died while the session ran; it may come back
    GONE = "gone for good"
    ENDED = "ended"


class Phase(StrEnum):
    """Where the session stands."""

    STARTING = "starting"
    RUNNING = "running"
    ENDING = "ending"
    OVER = "over"


TRANSITIONS: Mapping[tuple[NodeState, type[Message]], NodeState] = {
    (NodeState.STARTING, NodeHello): NodeState.WELCOMED,
    (NodeState.WELCOMED, Probe): NodeState.WELCOMED,
    (NodeState.CONNECTED, Probe): NodeState.CONNECTED,
    (NodeState.CONNECTED, Ready): NodeState.READY,
    (NodeState.RUNNING, Probe): NodeState.RUNNING,
    (NodeState.RUNNING, Telemetry): NodeState.RUNNING,
    (NodeState.RUNNING, Report): NodeState.REPORTED,
    (NodeState.STARTING, Fault): NodeState.FAULTED,
    (NodeState.WELCOMED, Fault): NodeState.FAULTED,
    (NodeState.CONNECTED, Fault): NodeState.FAULTED,
    (NodeState.READY, Fault): NodeState.FAULTED,
    (NodeState.RUNNING, Fault): NodeState.FAULTED,
}
"""Every message a node may send unasked, and where it leaves the node. Anything else is counted and ignored.

An Offer is an answer, and heard from whoever was asked for it: see :mod:`manyhands.launch.link_states`."""

RETURNING: Final = frozenset({NodeState.STARTING, NodeState.WELCOMED, NodeState.CONNECTED, NodeState.READY})
"""While the session runs: on the way back into it."""

OFFERING: Final = frozenset({NodeState.CONNECTED, NodeState.RUNNING})
"""In these states a node has been told who is absent, and may offer a place for them."""
