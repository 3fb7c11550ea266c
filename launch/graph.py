"""What `manyhands graph` prints: the nodes and links of a session, or who may read and write what."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from rich.console import Console
from rich.table import Table

from manyhands.launch.access import DATA, Capability, access, joins
from manyhands.launch.designing import print_json
from manyhands.launch.display import say
from manyhands.launch.exits import EXIT_OK
from manyhands.launch.session import Session
from manyhands.launch.topology import Topology, topology
from manyhands.protocol.channels import CHANNELS

_SAID_ONCE = (
    "Besides, once: on every link the handshake, in which a coupling tells the environment the D_V of its block; "
    "between every process and the supervisor what starts and ends the session."
)


def run_graph(session: Session, out: Console, show_access: bool, as_json: bool) -> int:
    """Print a session's graph, or its capability table.

    Args:
        session: the session.
        out: for the tables.
        show_access: print who may read and write what, instead of nodes and links.
        as_json: print one JSON object instead of tables.

    Returns:
        The exit code.
    """
    if as_json:
        print_json(access_object(session) if show_access else graph_object(session))
    elif show_access:
        _print_access(out, session)
    else:
        _print_graph(out, session)
    return EXIT_OK


def graph_object(session: Session) -> dict[str, Any]:
    """Nodes, links and observers, as ``--json`` prints them.

    ``signals`` of a link are the channels that each of its ends writes; an observer's ``reads`` are as in the session.
    A node that runs in another one's process has that one's name as its ``process``.
    """
    graph = topology(session)
    return {
        "session": session.name,
        "nodes": {
            name: {"role": role, "ports": list(graph.ports[name]), **_process(graph, name)}
            for name, role in graph.nodes.items()
        },
        "links": [
            {
                "between": [link.binder, link.connector],
                "ports": list(link.ports),
                "signals": {
                    link.binder: _signals(graph, link.binder, link.connector),
                    link.connector: _signals(graph, link.connector, link.binder),
                },
            }
            for link in graph.links
        ],
        "observers": {name: {"reads": list(observer.reads)} for name, observer in session.observers.items()},
    }


def access_object(session: Session) -> dict[str, Any]:
    """The capability table as ``--json`` prints it: one entry for each node, channel and peer."""
    return {
        "session": session.name,
        "access": [
            {
                "node": row.node,
                "role": row.role,
                "action": row.action,
                "channel": row.channel,
                "peer": row.peer,
                "ports": list(row.ports),
                **({"content": list(row.content)} if row.content else {}),
            }
            for row in access(session)
        ],
    }


def _process(graph: Topology, name: str) -> dict[str, str]:
    return {"process": graph.carriers[name]} if name in graph.carriers else {}


def _signals(graph: Topology, sender: str, receiver: str) -> list[str]:
    return [channel.name for channel in DATA if joins(channel, graph.nodes[sender], graph.nodes[receiver])]


def _print_graph(out: Console, session: Session) -> None:
    graph = topology(session)
    nodes = _table(f"{session.name}: nodes", "node", "role", "ports")
    for name, role in graph.nodes.items():
        carrier = graph.carriers.get(name)
        nodes.add_row(name, role if carrier is None else f"{role}, in {carrier}", ", ".join(graph.ports[name]))
    for name, observer in session.observers.items():
        nodes.add_row(name, "observer", f"reads {', '.join(observer.reads)}")
    out.print(nodes)
    links = _table(f"{session.name}: links", "from", "to", "ports", "there", "back")
    for link in graph.links:
        ends = (link.connector, link.binder)  # from the hand to the world, as the tick goes
        there, back = (", ".join(_signal(name) for name in _signals(graph, *way)) for way in (ends, ends[::-1]))
        links.add_row(*ends, ", ".join(link.ports), there, back)
    out.print(links)


def _print_access(out: Console, session: Session) -> None:
    table = _table(f"{session.name}: who may read and write what", "node", "role", "", "channel", "which ports")
    for rows in _by_node_and_channel(access(session)):
        first = rows[0]
        direction = "to" if first.action == "write" else "from"
        lines = [f"{direction} {row.peer}: {', '.join(row.content or row.ports)}" for row in rows]
        table.add_row(first.node, first.role, f"{first.action}s", _signal(first.channel), "\n".join(lines))
    out.print(table)
    say(out, _SAID_ONCE)


def _by_node_and_channel(table: Iterable[Capability]) -> list[list[Capability]]:
    """The rows of one node and channel together; a channel is either read or written by one node."""
    grouped: dict[tuple[str, str], list[Capability]] = {}
    for row in table:
        grouped.setdefault((row.node, row.channel), []).append(row)
    return list(grouped.values())


def _signal(name: str) -> str:
    """A channel with its quantity, such as ``sample (x, m)``."""
    channel = CHANNELS[name]
    return f"{name} ({channel.symbol}, {channel.unit})" if channel.symbol else name


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title, title_justify="left")
    for column in columns:
        table.add_column(column, overflow="fold")  # a name is never cut short: who may read it is the point
    return table
