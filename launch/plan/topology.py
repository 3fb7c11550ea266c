"""Which processes a session has and which links join them: derived from its couplings, and nowhere else.

A device is linked to every coupling that holds one of its ports, unless the two are one process; every coupling is
linked to the environment. A link carries exactly the ports that both its ends may see.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from manyhands.launch.session import ENVIRONMENT, SUPERVISOR, Session
from manyhands.protocol.limits import MAX_PORTS
from manyhands.protocol.messages import Role
from manyhands.protocol.transport.descriptors import node_needs, require_descriptors

__all__ = ["ENVIRONMENT", "LinkPlan", "LinkTooWide", "Topology", "require_runnable", "roster", "topology"]


@dataclass(frozen=True)
class LinkPlan:
    """One link: ``binder`` binds it, ``connector`` connects, ``ports`` are its signals' entries in order."""

    binder: str
    connector: str
    ports: tuple[str, ...]


@dataclass(frozen=True)
class Topology:
    """The graph of a session.

    Attributes:
        nodes: every process's name and role, devices first, then couplings, then the environment.
        ports: the ports of each node, in order.
        links: in the session's order, which every node follows in its handshakes.
        carriers: of each coupling that runs in its device's process, the device.
    """

    nodes: Mapping[str, Role]
    ports: Mapping[str, tuple[str, ...]]
    links: tuple[LinkPlan, ...]
    carriers: Mapping[str, str] = field(default_factory=dict)

    def links_of(self, node: str) -> tuple[LinkPlan, ...]:
        """The links that end at ``node``, in the session's order."""
        return tuple(link for link in self.links if node in (link.binder, link.connector))

    def together(self, node: str) -> tuple[str, ...]:
        """The nodes of the process that ``node`` runs in: the one that carries the others first."""
        leader = self.carriers.get(node, node)
        return (leader, *(name for name, carrier in self.carriers.items() if carrier == leader))


class LinkTooWide(Exception):
    """A link would have to carry more ports than a signal may have values."""


def require_runnable(graph: Topology, observers: int = 0) -> None:
    """Refuse a session that can be designed and simulated, but not be run as processes; before anything is made.

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
    of_nodes = (node_needs(len(graph.links_of(node))) for node in graph.nodes)  # which inherit the supervisor's limit
    require_descriptors(max(node_needs(0) + _A_MEMBER * (len(graph.nodes) + observers), *of_nodes))


_A_MEMBER = 8  # descriptors of the supervisor: the process, its connection, an observer's socket and its monitor


def roster(session: Session) -> Mapping[str, Role]:
    """Every name of a session that has a key, and its role: the nodes, the supervisor, the observers."""
    return {
        **session.roles,
        SUPERVISOR: Role.SUPERVISOR,
        **dict.fromkeys(session.observers, Role.OBSERVER),
    }


def topology(session: Session) -> Topology:
    """The graph of ``session``."""
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
    return Topology(session.roles, ports, tuple(links), session.carriers)
