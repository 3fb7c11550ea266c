"""Which processor each process runs on: a user's device and coupling share one, so that a tick does not travel.

Handing a tick from one process to the next is cheaper within a processor than between two, more so where
processors are few (docs/decisions/0006-the-tick.md has figures). Devices and couplings that are linked, directly or
through others, are one user's chain; chains are dealt to the processors in turn. A single chain is left to the
kernel, which can spread it.

The environment, on which all wait, goes wherever there is room. Where processes come before all others (SCHED_FIFO,
which is for pinned ones alone) it gets a processor, too: the one with the fewest processes
(docs/decisions/0017-timing.md).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from manyhands.launch.topology import ENVIRONMENT, Topology


def placement(graph: Topology, processors: Sequence[int], raised: bool = False) -> Mapping[str, int]:
    """The processor of each node that gets one.

    Args:
        graph: the session's nodes and links.
        processors: those that this process may use.
        raised: whether pinned processes will have a real-time priority
            (:func:`manyhands.nodes.realtime.may_raise`).
    """
    chains = chains_of(graph)
    if len(chains) < 2 or len(processors) < 2:
        return {}
    places = {node: processors[i % len(processors)] for i, chain in enumerate(chains) for node in chain}
    if raised:
        held = Counter(places.values())
        places[ENVIRONMENT] = min(reversed(processors), key=lambda processor: held[processor])
    return places


def chains_of(graph: Topology) -> list[list[str]]:
    """The connected components of the session without its environment, in the session's order."""
    component = {node: {node} for node in graph.nodes if node != ENVIRONMENT}
    pairs = [(link.binder, link.connector) for link in graph.links]
    for one, other in (*pairs, *graph.carriers.items()):
        if ENVIRONMENT not in (one, other):
            joined = component[one] | component[other]
            component.update(dict.fromkeys(joined, joined))
    distinct = {id(nodes): nodes for nodes in component.values()}
    return [[node for node in graph.nodes if node in nodes] for nodes in distinct.values()]
