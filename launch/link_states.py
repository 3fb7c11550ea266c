"""The links of a running session, as far as the supervisor has to mend them.

A link that lost one of its ends is cut. It can be joined again once there is a fresh place to meet at, which is the
binder's to make: one that runs *offers* it when it is told of the absence, one that comes back names it in its hello.
The connector is told of the place when it is there itself, and then the link is joined.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from enum import StrEnum
from typing import Final

from manyhands.launch.topology import LinkPlan, Topology


class LinkState(StrEnum):
    """Where a link stands."""

    JOINED = "joined"
    CUT = "cut"
    OFFERED = "offered"  # cut, and there is a fresh place that the connector has not been told of


class LinkEvent(StrEnum):
    """What happens to a link."""

    BINDER_LOST = "binder lost"
    CONNECTOR_LOST = "connector lost"
    PLACE = "place"  # the binder has bound a fresh one
    ASKED = "asked"  # the binder, at its return, is told that the connector is absent, and binds once more
    TOLD = "told"  # the connector is told where to connect to


LINK_TRANSITIONS: Final[Mapping[tuple[LinkState, LinkEvent], LinkState]] = {
    (LinkState.JOINED, LinkEvent.BINDER_LOST): LinkState.CUT,
    (LinkState.JOINED, LinkEvent.CONNECTOR_LOST): LinkState.CUT,
    (LinkState.CUT, LinkEvent.BINDER_LOST): LinkState.CUT,
    (LinkState.CUT, LinkEvent.CONNECTOR_LOST): LinkState.CUT,
    (LinkState.CUT, LinkEvent.PLACE): LinkState.OFFERED,
    (LinkState.OFFERED, LinkEvent.BINDER_LOST): LinkState.CUT,
    (LinkState.OFFERED, LinkEvent.CONNECTOR_LOST): LinkState.OFFERED,  # nobody has been there: it is as good as new
    (LinkState.OFFERED, LinkEvent.ASKED): LinkState.CUT,
    (LinkState.OFFERED, LinkEvent.TOLD): LinkState.JOINED,
}
"""Everything that can happen to a link. A link that is cut, and whose binder runs, is owed one Offer: no more than one
is ever on its way."""


def other_end(link: LinkPlan, node: str) -> str:
    """Who is at the end of ``link`` that is not ``node``'s."""
    return link.connector if link.binder == node else link.binder


class Links:
    """The state of every link, and the places of those that are offered."""

    def __init__(self, graph: Topology) -> None:
        """All joined, as after a start."""
        self._of = {node: graph.links_of(node) for node in graph.nodes}
        self._states = {(link.binder, link.connector): LinkState.JOINED for link in graph.links}
        self._places: dict[tuple[str, str], str] = {}
        self._links = graph.links

    def of(self, node: str) -> tuple[LinkPlan, ...]:
        """The links that end at ``node``."""
        return self._of[node]

    def state(self, link: LinkPlan) -> LinkState:
        """Where ``link`` stands."""
        return self._states[link.binder, link.connector]

    def lost(self, node: str) -> list[str]:
        """``node`` is gone: cut its links; returns the other ends of those that were joined."""
        severed = []
        for link in self._of[node]:
            if self.state(link) is LinkState.JOINED:
                severed.append(other_end(link, node))
            self._move(link, LinkEvent.BINDER_LOST if link.binder == node else LinkEvent.CONNECTOR_LOST)
        return severed

    def owed(self, binder: str, connector: str) -> bool:
        """Whether ``binder`` may offer a place for ``connector``."""
        return self._states.get((binder, connector)) is LinkState.CUT

    def offer(self, binder: str, connector: str, place: str) -> None:
        """``binder`` has bound a fresh place; the link must be cut."""
        state = self._states[binder, connector]
        self._states[binder, connector] = LINK_TRANSITIONS[state, LinkEvent.PLACE]
        self._places[binder, connector] = place

    def ask(self, link: LinkPlan) -> None:
        """The binder of an offered link is told that the connector is absent."""
        self._move(link, LinkEvent.ASKED)

    def tell(self, link: LinkPlan) -> str:
        """The connector of an offered link is told; returns the place."""
        self._move(link, LinkEvent.TOLD)
        return self._places.pop((link.binder, link.connector))

    def offered_between(self, nodes: Iterable[str]) -> Iterator[LinkPlan]:
        """Offered links with both ends among ``nodes``."""
        there = set(nodes)
        for link in self._links:
            if self.state(link) is LinkState.OFFERED and link.binder in there and link.connector in there:
                yield link

    def _move(self, link: LinkPlan, event: LinkEvent) -> None:
        self._states[link.binder, link.connector] = LINK_TRANSITIONS[self.state(link), event]
