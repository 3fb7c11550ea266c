"""The observers of a session: of each node's telemetry each is told the part that it may read, and nothing else."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from manyhands.launch.access import observed
from manyhands.launch.reach import Reach
from manyhands.launch.session import SUPERVISOR, Session
from manyhands.launch.topology import Topology
from manyhands.nodes import telemetry as names
from manyhands.protocol.codec import encode
from manyhands.protocol.messages import Observation, Telemetry
from manyhands.protocol.transport import Link, Transport

TRACE_OF: Mapping[str, str] = {
    "sample": names.DISPLACEMENT,
    "force": names.FORCE,
    "tool": names.FREE_POSITION,
    "reaction": names.FORCE,
}
"""The trace of a node's telemetry that holds what went over a channel of its."""


def visible(node: str, telemetry: Telemetry, channels: Collection[str]) -> Observation | None:
    """The observation of ``node`` for somebody who may read these of its channels; None if that is nothing.

    Figures belong to the channel ``telemetry``; each trace to the signal it holds.
    """
    wanted = {TRACE_OF[channel] for channel in channels if channel in TRACE_OF}
    traces = {name: trace for name, trace in telemetry.traces.items() if name in wanted}
    figures = telemetry.figures if "telemetry" in channels else {}
    return Observation(node, telemetry.tick, figures, traces) if traces or figures else None


class Audience:
    """The observers, each with a link of its own, on which the supervisor speaks and never listens.

    Attributes:
        missed: observations that nobody was there to take, that were not taken fast enough, or that are too long, with
            the name of their node, to be sent on.
    """

    def __init__(self, session: Session) -> None:
        self._channels = {observer: observed(session, observer) for observer in session.observers}
        self._links: dict[str, Link] = {}
        self.missed = 0

    def serve(self, transport: Transport, reach: Reach, graph: Topology) -> Mapping[str, str]:
        """Bind a link for each observer; returns their endpoints."""
        endpoints = {}
        for index, observer in enumerate(self._channels):
            address = reach.observer_address(graph, index)
            self._links[observer], endpoints[observer] = transport.bind_outlet(
                f"{SUPERVISOR}-{observer}", observer, address
            )
        return endpoints

    def tell(self, node: str, telemetry: Telemetry) -> None:
        """Pass on to each observer what it may know; who does not keep up misses it, and nobody waits."""
        for observer, link in self._links.items():
            observation = visible(node, telemetry, self._channels[observer].get(node, ()))
            if observation is not None and not _send(link, observation):
                self.missed += 1


def _send(link: Link, observation: Observation) -> bool:
    try:
        return link.send(encode(observation))
    except ValueError:  # a node may have filled the longest frame, and it is not for this process to end
        return False
