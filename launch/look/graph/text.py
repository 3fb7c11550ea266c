"""A session's nodes and links as tables, with their health where it runs; its capability table; and Mermaid.

A drawing as a Mermaid flowchart can be shown by many programs that display Markdown.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from manyhands.launch.look.display import say
from manyhands.launch.look.graph.parts import Drawing, signals
from manyhands.launch.plan.access import Capability
from manyhands.launch.plan.plan import Plan
from manyhands.nodes.monitor.health import Health
from manyhands.nodes.monitor.session_state import LiveSession
from manyhands.protocol.channels import CHANNELS
from manyhands.protocol.messages import Role

_SAID_ONCE = (
    "In addition, once: on every link the handshake, in which a coupling sends the D_V of its block to the "
    "environment; between every process and the supervisor the messages that start and end the session."
)


def print_graph(out: Console, plan: Plan) -> None:
    """Print nodes with their ports, and links with their signals in both directions."""
    session, graph = plan.session, plan.graph
    nodes = _table(f"{session.name}: nodes", "node", "role", "ports")
    for name, role in graph.nodes.items():
        carrier = graph.carriers.get(name)
        nodes.add_row(name, role if carrier is None else f"{role}, in {carrier}", ", ".join(graph.ports[name]))
    for name, observer in session.observers.items():
        nodes.add_row(name, "observer", f"reads {', '.join(observer.reads)}")
    out.print(nodes)
    links = _table(f"{session.name}: links", "from", "to", "ports", "there", "back")
    for link in graph.links:
        ends = (link.connector, link.binder)  # from the hand to the environment, the direction of a tick
        there, back = _there_and_back(ends, graph.nodes)
        links.add_row(*ends, ", ".join(link.ports), there, back)
    out.print(links)


def print_live(out: Console, live: LiveSession) -> None:
    """Print the same tables for a running session, with the health of each node and link."""
    about = live.about
    roles = {name: node.role for name, node in about.nodes.items()}
    nodes = _table(f"{about.session}: nodes", "node", "role", "ports", "state", "health")
    for name, node in about.nodes.items():
        role = node.role if node.process is None else f"{node.role}, in {node.process}"
        seen = live.nodes[name]
        nodes.add_row(escape(name), escape(role), escape(", ".join(node.ports)), escape(seen.state), seen.health.value)
    for name, reads in about.observers.items():
        nodes.add_row(escape(name), "observer", escape(f"reads {', '.join(reads)}"))
    out.print(nodes)
    links = _table(f"{about.session}: links", "from", "to", "ports", "there", "back", "health")
    for link in about.links:
        there, back = _there_and_back(link.ends, roles)
        ends = map(escape, link.ends)
        links.add_row(*ends, escape(", ".join(link.ports)), there, back, live.link_health(link).value)
    out.print(links)


def print_access(out: Console, plan: Plan) -> None:
    """Print the capability table, one row for each node and channel."""
    table = _table(f"{plan.session.name}: who may read and write what", "node", "role", "", "channel", "which ports")
    for rows in _by_node_and_channel(plan.access):
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


def _there_and_back(ends: tuple[str, str], roles: Mapping[str, Role]) -> tuple[str, str]:
    there, back = (
        ", ".join(_signal(name) for name in signals(roles[sender], roles[hearer]))
        for sender, hearer in (ends, ends[::-1])
    )
    return there, back


def _signal(name: str) -> str:
    """A channel with its quantity, such as ``sample (x, m)``."""
    channel = CHANNELS[name]
    return f"{name} ({channel.symbol}, {channel.unit})" if channel.symbol else name


def _table(title: str, *columns: str) -> Table:
    table = Table(title=escape(title), title_justify="left")
    for column in columns:
        table.add_column(column, overflow="fold")  # a name is folded and never cut, since the tables show access rights
    return table


_SHAPES = {
    Role.DEVICE: ('(["', '"])'),
    Role.COUPLING: ('["', '"]'),
    Role.ENVIRONMENT: ('[["', '"]]'),
    Role.OBSERVER: ('>"', '"]'),
}

_CLASSES = {
    Health.OK: "stroke:#2e7d32,stroke-width:2px",
    Health.FREE: "stroke:#757575,stroke-dasharray:2 4",
    Health.WAITING: "stroke:#757575,stroke-dasharray:4 3",
    Health.LATE: "stroke:#b26a00,stroke-width:3px",
    Health.FROZEN: "stroke:#0277bd,stroke-width:3px",
    Health.SILENT: "stroke:#8e24aa,stroke-width:3px,stroke-dasharray:4 3",
    Health.AWAY: "stroke:#c62828,stroke-width:3px,stroke-dasharray:2 3",
}


def mermaid(drawing: Drawing) -> str:
    """The text of the flowchart; links lead from a hand to the environment, labelled with the signals both ways."""
    ids = {part.name: f"n{number}" for number, part in enumerate(drawing.parts)}
    lines = ["flowchart LR", f"  accTitle: {_plain(drawing.title)}"]
    for part in drawing.parts:
        before, after = _SHAPES[part.role]
        lines.append(f"  {ids[part.name]}{before}{'<br/>'.join(map(_escaped, part.label))}{after}")
    healths: dict[Health, list[int]] = {}
    for number, tie in enumerate(drawing.ties):
        first, second = (ids[end] for end in tie.ends)
        label = tie.label if tie.health is None else f"{tie.label}, {tie.health.value}"
        lines.append(f'  {first} {"<-->" if tie.is_link else "-.-"}|"{_escaped(label)}"| {second}')
        if tie.health is not None:
            healths.setdefault(tie.health, []).append(number)
    for health, style in _CLASSES.items():
        of = [ids[part.name] for part in drawing.parts if part.health is health]
        if of:
            lines += [f"  classDef {health.value} {style}", f"  class {','.join(of)} {health.value}"]
        if health in healths:
            lines.append(f"  linkStyle {','.join(map(str, healths[health]))} {style}")
    return "\n".join(lines) + "\n"


def _escaped(text: str) -> str:
    """A text for a quoted label: special characters as their numbers."""
    return "".join(c if c.isalnum() or c in " .,:_-/→←…" else f"#{ord(c)};" for c in text)


def _plain(text: str) -> str:
    """A text for a line without quotes: special characters as spaces."""
    return "".join(c if c.isalnum() or c in " .,_-" else " " for c in text)
