"""A session's nodes and links as tables, with their health where it runs; its capability table; and Mermaid.

A drawing as a Mermaid flowchart can be shown by many programs that display Markdown.
"""

from __future__ import annotations

from collections.abc import Iterable

from rich.console import Console
from rich.markup import escape

from manyhands.design.models.axis import Units, units_of
from manyhands.launch.look.display import say, titled_table
from manyhands.launch.look.graph.parts import Drawing
from manyhands.launch.plan.access import Capability
from manyhands.launch.plan.plan import Plan
from manyhands.nodes.monitor.health import Health
from manyhands.protocol.channels import CHANNELS
from manyhands.protocol.messages import Role

_SAID_ONCE = (
    "In addition, once: on every link the handshake, in which a coupling sends the D_V of its block to the "
    "environment; between every process and the supervisor the messages that start and end the session."
)


def print_graph(out: Console, drawing: Drawing) -> None:
    """Print nodes with their ports, and links with their signals both ways; of a running session with their health."""
    runs = drawing.health is not None
    nodes = titled_table(f"{drawing.title}: nodes", ("node", "role", "ports", *(["state", "health"] if runs else [])))
    for part in drawing.nodes:
        role = part.role.value if part.process is None else f"{part.role.value}, in {part.process}"
        stands = [] if part.health is None else [part.state, part.health.value]
        nodes.add_row(*map(escape, (part.name, role, ", ".join(part.ports), *stands)))
    for part in drawing.observers:
        nodes.add_row(*map(escape, (part.name, part.role.value, f"reads {', '.join(part.reads)}")))
    out.print(nodes)
    links = titled_table(
        f"{drawing.title}: links", ("from", "to", "ports", "there", "back", *(["health"] if runs else []))
    )
    for tie, channels in drawing.links():  # from the hand to the environment, the direction of a tick
        units = units_of(tie.ports, drawing.turning)
        there, back = (", ".join(_signal(name, units) for name in names) for names in channels)
        stands = [] if tie.health is None else [tie.health.value]
        links.add_row(*map(escape, (*tie.ends, ", ".join(tie.ports), there, back, *stands)))
    out.print(links)


def print_access(out: Console, plan: Plan) -> None:
    """Print the capability table, one row for each node and channel."""
    table = titled_table(
        f"{plan.session.name}: who may read and write what", ("node", "role", "", "channel", "which ports")
    )
    for rows in _by_node_and_channel(plan.access):
        first = rows[0]
        units = units_of([port for row in rows for port in row.ports], plan.session.turning)
        direction = "to" if first.action == "write" else "from"
        lines = [f"{direction} {row.peer}: {', '.join(row.content or row.ports)}" for row in rows]
        table.add_row(first.node, first.role, f"{first.action}s", _signal(first.channel, units), "\n".join(lines))
    out.print(table)
    say(out, _SAID_ONCE)


def _by_node_and_channel(table: Iterable[Capability]) -> list[list[Capability]]:
    """The rows of one node and channel together; a channel is either read or written by one node."""
    grouped: dict[tuple[str, str], list[Capability]] = {}
    for row in table:
        grouped.setdefault((row.node, row.channel), []).append(row)
    return list(grouped.values())


def _signal(name: str, units: Units) -> str:
    """A channel with its quantity, such as ``sample (x, m)``."""
    channel = CHANNELS[name]
    return f"{name} ({channel.symbol}, {units(channel.unit)})" if channel.symbol else name


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
