"""The elements of every drawing of a session: nodes in layers, links between them, and the health of each. Pure.

A drawing of a session file has no health; that of a running session takes it from its live state. The same graphs,
and the capability table, are here as the objects that ``--json`` prints.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from manyhands.launch.look.tables import rounded
from manyhands.launch.plan.access import DATA, joins
from manyhands.launch.plan.plan import Plan
from manyhands.launch.plan.topology import Topology
from manyhands.nodes.monitor.health import Health
from manyhands.nodes.monitor.session_state import LiveSession
from manyhands.protocol.messages import Role

LAYERS: Final = {Role.DEVICE: 0, Role.COUPLING: 1, Role.ENVIRONMENT: 2}
"""The layers of a drawing, from the hands on the left to the environment on the right."""

_MOST_PORTS: Final = 4  # named in a label; more are counted


@dataclass(frozen=True)
class Part:
    """A node, or an observer.

    Attributes:
        name: its name.
        role: its role.
        ports: its ports in order; empty for an observer.
        note: a remark after the role; may be empty.
        health: its health; None in the drawing of a file.
        detail: its state or rate, as a text.
    """

    name: str
    role: Role
    ports: tuple[str, ...] = ()
    note: str = ""
    health: Health | None = None
    detail: str = ""

    @property
    def label(self) -> tuple[str, ...]:
        """The lines in its box, its name first."""
        lines = [self.name, self.role.value if not self.note else f"{self.role.value}, {self.note}"]
        if self.role is not Role.OBSERVER and self.ports:
            lines.append(_few(self.ports))
        if self.health is not None:
            lines.append(self.health.value if not self.detail else f"{self.health.value}: {self.detail}")
        return tuple(lines)

    @property
    def whole(self) -> str:
        """Everything known about the part, in one sentence."""
        ports = f"; ports {', '.join(self.ports)}" if self.ports else ""
        return f"{': '.join(self.label[:2])}{ports}{''.join(f'; {line}' for line in self.label[3:])}"


@dataclass(frozen=True)
class Tie:
    """A line between two parts: a link of the session, or another relation.

    Attributes:
        ends: the two parts, the one nearer to a hand first.
        ports: the ports of the link.
        there: the signals from the first end to the second, in the paper's letters; empty where there is no link.
        back: the signals from the second end to the first.
        health: the link's health; None in the drawing of a file.
        why: the relation, where the line is no link.
        looks: whether the relation is that the second part observes the first.
    """

    ends: tuple[str, str]
    ports: tuple[str, ...] = ()
    there: str = ""
    back: str = ""
    health: Health | None = None
    why: str = ""
    looks: bool = False

    @property
    def is_shown(self) -> bool:
        """Whether the label stands beside the line; an observer's lines have none, for its box lists what it reads."""
        return not self.looks

    @property
    def is_link(self) -> bool:
        """Whether the line is a link of the session, with a signal each way."""
        return not self.why

    @property
    def label(self) -> str:
        """The text beside the line."""
        return f"{self.there} → ← {self.back}" if self.is_link else self.why

    @property
    def whole(self) -> str:
        """Everything known about the line, in one sentence."""
        first, second = self.ends
        if not self.is_link:
            return f"{first}, {second}: {self.why}"
        health = "" if self.health is None else f"; {self.health.value}"
        return f"{first} to {second}: {self.there}, back: {self.back}; ports {', '.join(self.ports)}{health}"


@dataclass(frozen=True)
class Drawing:
    """A session's graph; ``health`` is that of the whole session, None for a file."""

    title: str
    parts: tuple[Part, ...]
    ties: tuple[Tie, ...]
    health: Health | None = None


def drawing_of_session(plan: Plan) -> Drawing:
    """The graph of a session file, with its observers."""
    session, graph = plan.session, plan.graph
    parts = [
        Part(name, role, graph.ports[name], _carried(graph.carriers.get(name))) for name, role in graph.nodes.items()
    ]
    links = [((link.connector, link.binder), link.ports) for link in graph.links]
    ties = [_link(ends, ports, graph.nodes, None) for ends, ports in links]
    reads = {name: tuple(observer.reads) for name, observer in session.observers.items()}
    return Drawing(
        session.name, (*parts, *_observers(reads)), (*ties, *_carriers(graph.carriers), *_looks(reads, graph.nodes))
    )


def drawing_of_live(live: LiveSession) -> Drawing:
    """The graph of a running session, with the health of each node and link."""
    about = live.about
    carriers = {name: node.process for name, node in about.nodes.items() if node.process is not None}
    roles = {name: node.role for name, node in about.nodes.items()}
    parts = []
    for name, node in about.nodes.items():
        seen = live.nodes[name]
        detail = "" if seen.health is Health.OK and seen.rate is None else seen.state
        if seen.health in (Health.OK, Health.LATE) and seen.rate is not None:
            detail = f"{seen.rate:.0f} ticks/s"
        parts.append(Part(name, node.role, node.ports, _carried(node.process), seen.health, detail))
    ties = [_link(link.ends, link.ports, roles, live.link_health(link)) for link in about.links]
    return Drawing(
        about.session,
        (*parts, *_observers(about.observers)),
        (*ties, *_carriers(carriers), *_looks(about.observers, roles)),
        live.health,
    )


def _carried(carrier: str | None) -> str:
    return "" if carrier is None else f"in {carrier}"


def _link(ends: tuple[str, str], ports: tuple[str, ...], roles: Mapping[str, Role], health: Health | None) -> Tie:
    """A link with its signals, which are the channels between the roles of its ends."""
    there, back = (_signal(roles[sender], roles[hearer]) for sender, hearer in (ends, ends[::-1]))
    return Tie(ends, ports, there, back, health)


def _signal(sender: Role, hearer: Role) -> str:
    """The letters of the signals that one role sends to another in every tick."""
    return ", ".join(channel.symbol for channel in DATA if channel.symbol and joins(channel, sender, hearer))


def _carriers(carriers: Mapping[str, str]) -> list[Tie]:
    return [Tie((carrier, name), why="one process") for name, carrier in carriers.items()]


def _observers(reads: Mapping[str, tuple[str, ...]]) -> list[Part]:
    return [Part(name, Role.OBSERVER, note=f"reads {_few(what)}") for name, what in reads.items()]


def _looks(reads: Mapping[str, tuple[str, ...]], roles: Mapping[str, Role]) -> list[Tie]:
    """Lines from single nodes to the observers that read them; an observer's label lists what it reads of all nodes."""
    found = []
    for name, what in reads.items():
        of: dict[str, list[str]] = {}
        for one in what:
            node, slash, last = one.partition("/")
            if slash and node in roles:
                of.setdefault(node, []).append(last)
        found += [Tie((node, name), why=", ".join(lasts), looks=True) for node, lasts in of.items()]
    return found


def _few(names: tuple[str, ...]) -> str:
    if len(names) <= _MOST_PORTS:
        return ", ".join(names)
    return f"{', '.join(names[: _MOST_PORTS - 1])} … {len(names)} in all"


def graph_object(plan: Plan) -> dict[str, Any]:
    """Nodes, links and observers, as ``--json`` prints them.

    ``signals`` of a link are the channels that each of its ends writes; an observer's ``reads`` are as in the session.
    The ``process`` of a node that runs in a device's process is the name of that device.
    """
    session, graph = plan.session, plan.graph
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
                    link.binder: signals(graph.nodes[link.binder], graph.nodes[link.connector]),
                    link.connector: signals(graph.nodes[link.connector], graph.nodes[link.binder]),
                },
            }
            for link in graph.links
        ],
        "observers": {name: {"reads": list(observer.reads)} for name, observer in session.observers.items()},
    }


def access_object(plan: Plan) -> dict[str, Any]:
    """The capability table as ``--json`` prints it: one entry for each node, channel and peer."""
    return {
        "session": plan.session.name,
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
            for row in plan.access
        ],
    }


def live_object(live: LiveSession) -> dict[str, Any]:
    """The graph of a running session: that of its file, with the health of each node and link.

    ``between`` of a link begins with the end that is nearer to the environment, as in :func:`graph_object`.
    """
    about = live.about
    roles = {name: node.role for name, node in about.nodes.items()}
    return {
        "session": about.session,
        "pid": about.pid,
        "health": live.health.value,
        "nodes": {
            name: {
                "role": node.role.value,
                "ports": list(node.ports),
                **({} if node.process is None else {"process": node.process}),
                "state": live.nodes[name].state,
                "rate": rounded(live.nodes[name].rate),
                "health": live.nodes[name].health.value,
            }
            for name, node in about.nodes.items()
        },
        "links": [
            {
                "between": [world, hand],
                "ports": list(link.ports),
                "signals": {
                    world: signals(roles[world], roles[hand]),
                    hand: signals(roles[hand], roles[world]),
                },
                "health": live.link_health(link).value,
            }
            for link in about.links
            for hand, world in (link.ends,)
        ],
        "observers": {name: {"reads": list(reads)} for name, reads in about.observers.items()},
    }


def signals(sender: Role, receiver: Role) -> list[str]:
    """The channels on which one role sends to another in every tick."""
    return [channel.name for channel in DATA if joins(channel, sender, receiver)]


def _process(graph: Topology, name: str) -> dict[str, str]:
    return {"process": graph.carriers[name]} if name in graph.carriers else {}
