"""Which processor each process runs on: a user's device and coupling share one, so that a tick does not travel.

Handing a tick from one process to the next is cheaper within a processor than between two, more so where
processors are few (docs/decisions/0006-the-tick.md has figures). Devices and couplings that are linked, directly or
through others, are one user's chain; chains are dealt to the processors in turn. The environment, on which
all wait, goes wherever there is room. A single chain is left to the kernel, which can spread it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from manyhands.launch.topology import ENVIRONMENT, Topology


def placement(graph: Topology, processors: Sequence[int]) -> Mapping[str, int]:
    """The processor of each node that gets one.

    Args:
        graph: the session's nodes and links.
        processors: those that this process may use.
    """
    chains = _chains(graph)
    if len(chains) < 2 or len(processors) < 2:
        return {}
    return {node: processors[i % len(processors)] for i, chain in enumerate(chains) for node in chain}


def _chains(graph: Topology) -> list[list[str]]:
    """The connected components of the session without its environment, in the session's order."""
    component = {node: {node} for node in graph.nodes if node != ENVIRONMENT}
    for link in graph.links:
        if ENVIRONMENT not in (link.binder, link.connector):
            joined = component[link.binder] | component[link.connector]
            component.update(dict.fromkeys(joined, joined))
    distinct = {id(nodes): nodes for nodes in component.values()}
    return [[node for node in graph.nodes if node in nodes] for nodes in distinct.values()]
