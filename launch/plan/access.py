"""Which process may read and write what: the capability table, derived from a session's structure alone.

On a connection, two processes may use those channels of the channel table that join their roles in that direction, for
the ports of the connection, and nothing else. Sockets, key rings and the output of `manyhands graph` follow from this
table. A process can therefore obtain exactly those signals with which its block of V was designed.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

from manyhands.launch.plan.topology import Topology, roster
from manyhands.launch.session import SUPERVISOR, Session
from manyhands.launch.session.errors import listed, one_of
from manyhands.launch.session.session import TELEMETRY
from manyhands.protocol.channels import CHANNELS, Channel, Rate
from manyhands.protocol.messages import Role

Action = Literal["read", "write"]

DATA: Final = tuple(channel for channel in CHANNELS.values() if channel.rate is not Rate.ONCE)
"""The channels that carry a session's data; the others, which set up and end it, exist on every connection."""


@dataclass(frozen=True, slots=True)
class Capability:
    """One row of the table: ``node`` may read or write one channel of its connection with ``peer``.

    Attributes:
        node: the node, supervisor or observer that has the right.
        role: its role.
        action: whether it may read or write.
        channel: a name in the channel table.
        peer: the process from which it reads, or to which it writes.
        ports: the ports whose values or telemetry the channel carries between the two, in their order.
        content: the channels that an observation may hold, NODE/CHANNEL each; empty on all other channels.
    """

    node: str
    role: Role
    action: Action
    channel: str
    peer: str
    ports: tuple[str, ...]
    content: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class _Connection:
    """Two processes that can send each other frames, and the ports that the frames concern."""

    ends: tuple[str, str]
    ports: tuple[str, ...]
    content: tuple[str, ...] = ()


def access(session: Session, graph: Topology) -> tuple[Capability, ...]:
    """The capability table: one row for each node, channel and peer, in the order of nodes, then of channels.

    Args:
        session: the session.
        graph: its graph.
    """
    roles = roster(session)
    rows: dict[str, list[Capability]] = {name: [] for name in roles}
    connections = tuple(_connections(session, graph))
    for channel in DATA:
        for connection in connections:
            for sender, receiver in (connection.ends, connection.ends[::-1]):
                if joins(channel, roles[sender], roles[receiver]):
                    about = (connection.ports, connection.content)
                    rows[sender].append(Capability(sender, roles[sender], "write", channel.name, receiver, *about))
                    rows[receiver].append(Capability(receiver, roles[receiver], "read", channel.name, sender, *about))
    return tuple(row for own in rows.values() for row in own)


def joins(channel: Channel, sender: Role, receiver: Role) -> bool:
    """Whether a process of one role may send on a channel to a process of another."""
    return sender in channel.senders and receiver in channel.receivers


def _connections(session: Session, graph: Topology) -> Iterator[_Connection]:
    for link in graph.links:
        yield _Connection((link.binder, link.connector), link.ports)
    for node in graph.nodes:
        yield _Connection((SUPERVISOR, node), graph.ports[node])
    for observer in session.observers:
        seen = observed(session, observer)
        ports = {port for node in seen for port in graph.ports[node]}
        yield _Connection(
            (SUPERVISOR, observer),
            tuple(port for port in session.ports if port in ports),
            tuple(f"{node}/{channel}" for node, channels in seen.items() for channel in channels),
        )


def observed(session: Session, observer: str) -> Mapping[str, tuple[str, ...]]:
    """The channels of each node that an observer may read, in the order of the nodes and of the channel table.

    Raises:
        ValueError: the session has no such observer.
    """
    if observer not in session.observers:
        raise ValueError(f"found the observer {observer!r}; expected {one_of(session.observers, observer)}")
    wanted: dict[str, set[str]] = {node: set() for node in session.roles}
    for entry in session.observers[observer].reads:
        node, slash, channel = entry.partition("/")
        if slash:
            wanted[node].add(channel)
            continue
        for everyone in wanted.values():
            everyone.add(TELEMETRY)
    return {node: tuple(name for name in CHANNELS if name in channels) for node, channels in wanted.items() if channels}


def peers(table: Iterable[Capability]) -> Mapping[str, frozenset[str]]:
    """The processes with which each node, the supervisor and each observer share a channel, and so public keys."""
    found: dict[str, set[str]] = {}
    for row in table:
        found.setdefault(row.node, set()).add(row.peer)
    return {name: frozenset(others) for name, others in found.items()}


def capability_violations(
    session: Session, table: Iterable[Capability], structure: Mapping[str, Sequence[str]]
) -> list[str]:
    """Where blocks of V need ports that their processes may not both read and write; empty where they agree.

    Args:
        session: the session.
        table: its capability table.
        structure: the ports of each block by name, as in a certificate.

    Returns:
        One sentence for each port outside its process, and for each block without a process.
    """
    allowed = _within_reach(table)
    owner = {port: coupling for coupling, ports in session.blocks_by_name.items() for port in ports}
    found = []
    for block, ports in structure.items():
        if block not in allowed:
            found.append(f"the block {block!r} has no process; expected {one_of(allowed, block)}")
            continue
        for port in ports:
            if port not in allowed[block]:
                whose = f"of the coupling {owner[port]!r}" if port in owner else "of none of the couplings"
                found.append(
                    f"the block {block!r} touches the port {port!r} {whose}; "
                    f"the process {block!r} may read and write {listed(allowed[block])} alone"
                )
    return found


def _within_reach(table: Iterable[Capability]) -> dict[str, tuple[str, ...]]:
    """The ports of each coupling that all of its signals carry: it cannot couple a port that one of them lacks."""
    by_channel: dict[str, dict[str, dict[str, None]]] = {}
    for row in table:
        if row.role is Role.COUPLING and CHANNELS[row.channel].rate is Rate.EVERY_TICK:
            by_channel.setdefault(row.node, {}).setdefault(row.channel, {}).update(dict.fromkeys(row.ports))
    return {
        node: tuple(port for port in next(iter(sets.values())) if all(port in ports for ports in sets.values()))
        for node, sets in by_channel.items()
    }
