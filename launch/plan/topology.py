"""The processes of a session, the links between them, and the processor on which each process runs.

Processes and links follow from the couplings. A device is linked to every coupling that has one of its ports, unless
the two are one process; every coupling is linked to the environment. A link carries exactly the ports that both its
ends may see.

Passing a tick from one process to the next is cheaper within one processor than between two, the more so where
processors are few (docs/decisions/0006-the-tick.md has figures). Linked devices and couplings, directly or through
others, form one user's chain. A chain runs on one processor. The chains are assigned in turn to the processor with the
least to do: a chain's load is its rate, and the quickest chain is first. So a user at 4 kHz has a processor alone where
three others at 1 kHz share one. A single chain is left to the kernel, which can spread it.

All processes wait for the environment, so it stays free to run on any processor. Where processes have a real-time
priority (SCHED_FIFO, which only pinned processes get), the environment is pinned, too: to the processor with the fewest
processes (docs/decisions/0017-timing.md).
"""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

from manyhands.launch.session import ENVIRONMENT, SUPERVISOR, Session
from manyhands.nodes.kernel.realtime import may_raise
from manyhands.protocol.limits import MAX_PORTS
from manyhands.protocol.messages import Role
from manyhands.protocol.transport.descriptors import node_needs, require_descriptors


@dataclass(frozen=True)
class LinkPlan:
    """One link: the process ``binder`` binds it, ``connector`` connects; its signals have one entry for each port."""

    binder: str
    connector: str
    ports: tuple[str, ...]


@dataclass(frozen=True)
class Topology:
    """The graph of a session.

    Attributes:
        nodes: every node's name and role, devices first, then couplings, then the environment.
        ports: the ports of each node, in order.
        links: in the session's order, which every node follows in its handshakes.
        carriers: the device of each coupling that runs in its device's process.
        rates: ticks in one of the session's, of the nodes whose period is not the session's.
    """

    nodes: Mapping[str, Role]
    ports: Mapping[str, tuple[str, ...]]
    links: tuple[LinkPlan, ...]
    carriers: Mapping[str, str] = field(default_factory=dict)
    rates: Mapping[str, float] = field(default_factory=dict)

    def links_of(self, node: str) -> tuple[LinkPlan, ...]:
        """The links that end at ``node``, in the session's order."""
        return tuple(link for link in self.links if node in (link.binder, link.connector))

    def couplings_of(self, device: str) -> tuple[str, ...]:
        """The couplings of a device, in its own process or in another."""
        linked = [link.binder for link in self.links_of(device)]
        return (*linked, *(name for name, carrier in self.carriers.items() if carrier == device))

    def rate(self, node: str) -> float:
        """The ticks of ``node`` in one of the session's."""
        return self.rates.get(node, 1.0)

    def together(self, node: str) -> tuple[str, ...]:
        """The nodes of the process in which ``node`` runs: first the device that carries the others."""
        leader = self.carriers.get(node, node)
        return (leader, *(name for name, carrier in self.carriers.items() if carrier == leader))


class LinkTooWide(Exception):
    """A link would carry more ports than a signal may have values."""


def require_runnable(graph: Topology, observers: int = 0) -> None:
    """Refuse a session that cannot run as processes; called before anything is made.

    Raises:
        LinkTooWide: a link carries more than ``MAX_PORTS`` ports.
        TransportError: the supervisor, or the node with most links, may not open enough files.
    """
    for link in graph.links:
        if len(link.ports) > MAX_PORTS:
            raise LinkTooWide(
                f"the link between {link.binder} and {link.connector}: found {len(link.ports)} ports; "
                f"expected at most {MAX_PORTS}; divide the coupling into more blocks"
            )
    of_nodes = (node_needs(len(graph.links_of(node))) for node in graph.nodes)  # nodes inherit the supervisor's limit
    require_descriptors(max(node_needs(0) + _MEMBER_DESCRIPTORS * (len(graph.nodes) + observers), *of_nodes))


_MEMBER_DESCRIPTORS = 8  # of the supervisor, for each node or observer: process, connection, socket and its monitor


def roster(session: Session) -> Mapping[str, Role]:
    """The name and role of everything that has a key: the nodes, the supervisor, the observers."""
    return {
        **session.roles,
        SUPERVISOR: Role.SUPERVISOR,
        **dict.fromkeys(session.observers, Role.OBSERVER),
    }


def topology(session: Session) -> Topology:
    """The processes and links of ``session``."""
    ports = {
        **{device: session.ports_of(device) for device in session.devices},
        **dict(zip(session.couplings, session.blocks, strict=True)),
        ENVIRONMENT: session.ports,
    }
    links = [LinkPlan(ENVIRONMENT, coupling, ports[coupling]) for coupling in session.couplings]
    device_of = {port: device for device in session.devices for port in ports[device]}
    place = {device: i for i, device in enumerate(session.devices)}
    for coupling in session.couplings:
        if coupling in session.carriers:  # one process with its device
            continue
        shared: dict[str, list[str]] = {}
        for port in ports[coupling]:
            shared.setdefault(device_of[port], []).append(port)
        links += [LinkPlan(coupling, device, tuple(shared[device])) for device in sorted(shared, key=place.__getitem__)]
    return Topology(session.roles, ports, tuple(links), session.carriers, session.own_rates)


def placement(
    graph: Topology, processors: Sequence[int], raised: bool = False, remote: Collection[str] = ()
) -> Mapping[str, int]:
    """The processor of each node that is pinned to one; empty where there is one processor.

    Without a priority a single chain is left to the kernel, and so is the environment. With one, everything is pinned.

    Args:
        graph: the session's nodes and links.
        processors: the processors that this process may use.
        raised: whether pinned processes will have a real-time priority
            (:func:`manyhands.nodes.kernel.realtime.may_raise`).
        remote: the nodes that run on other machines.
    """
    chains = [local for chain in chains_of(graph) if (local := [node for node in chain if node not in remote])]
    if len(processors) < 2 or (len(chains) < 2 and not raised):
        return {}
    load = dict.fromkeys(processors, 0.0)
    places: dict[str, int] = {}
    for rate, chain in sorted(((graph.rate(chain[0]), chain) for chain in chains), key=lambda one: -one[0]):
        freest = min(processors, key=load.__getitem__)
        load[freest] += rate
        places.update(dict.fromkeys(chain, freest))
    if raised:
        held = {processor: sum(graph.rate(node) for node in places if places[node] == processor) for processor in load}
        places[ENVIRONMENT] = min(reversed(processors), key=held.__getitem__)
    return places


def usual_placement(graph: Topology, remote: Collection[str] = ()) -> Mapping[str, int]:
    """The :func:`placement` of a run in real time on this machine's processors, without the nodes elsewhere."""
    return placement(graph, sorted(os.sched_getaffinity(0)), may_raise(), remote)


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
