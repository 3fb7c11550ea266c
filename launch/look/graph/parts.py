"""The elements of every drawing of a session: nodes in layers, links between them, and the health of each. Pure.

A drawing of a session file has no health; that of a running session takes it from its live state. The same graph,
and the capability table, are here as the objects that ``--json`` prints.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

from manyhands.launch.look.tables import rounded
from manyhands.launch.plan.access import DATA, joins
from manyhands.launch.plan.plan import Plan
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
        process: the node whose process it shares; None for a process of its own.
        reads: what an observer reads, as the session file has it.
        health: its health; None in the drawing of a file, and of an observer.
        state: its state, in a word; empty where it has no health.
        rate: ticks a second; None where it is not known.
    """

    name: str
    role: Role
    ports: tuple[str, ...] = ()
    process: str | None = None
    reads: tuple[str, ...] = ()
    health: Health | None = None
    state: str = ""
    rate: float | None = None

    @property
    def label(self) -> tuple[str, ...]:
        """The lines in its box, its name first."""
        note = f", reads {_few(self.reads)}" if self.reads else "" if self.process is None else f", in {self.process}"
        lines = [self.name, f"{self.role.value}{note}"]
        if self.ports:
            lines.append(_few(self.ports))
        if self.health is not None:
            detail = "" if self.health is Health.OK else self.state
            if self.health in (Health.OK, Health.LATE) and self.rate is not None:
                detail = f"{self.rate:.0f} ticks/s"
            lines.append(f"{self.health.value}: {detail}" if detail else self.health.value)
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
    """A session's graph; ``health`` is that of the whole session and ``pid`` its supervisor's, None for a file.

    ``turning`` has the ports that turn.
    """

    title: str
    parts: tuple[Part, ...]
    ties: tuple[Tie, ...]
    health: Health | None = None
    pid: int | None = None
    turning: frozenset[str] = frozenset()

    @property
    def nodes(self) -> tuple[Part, ...]:
        """The parts without the observers."""
        return tuple(part for part in self.parts if part.role is not Role.OBSERVER)

    @property
    def observers(self) -> tuple[Part, ...]:
        """The observers."""
        return tuple(part for part in self.parts if part.role is Role.OBSERVER)

    def links(self) -> Iterator[tuple[Tie, tuple[list[str], list[str]]]]:
        """The links, each with the channels from its first end to its second, and back."""
        roles = {part.name: part.role for part in self.parts}
        for tie in self.ties:
            if tie.is_link:
                there, back = (
                    [channel.name for channel in DATA if joins(channel, roles[sender], roles[hearer])]
                    for sender, hearer in (tie.ends, tie.ends[::-1])
                )
                yield tie, (there, back)


def drawing_of_session(plan: Plan) -> Drawing:
    """The graph of a session file, with its observers."""
    session, graph = plan.session, plan.graph
    parts = [Part(name, role, graph.ports[name], graph.carriers.get(name)) for name, role in graph.nodes.items()]
    links = [((link.connector, link.binder), link.ports) for link in graph.links]
    ties = [_link(ends, ports, graph.nodes, None) for ends, ports in links]
    reads = {name: tuple(observer.reads) for name, observer in session.observers.items()}
    return Drawing(
        session.name,
        (*parts, *_observers(reads)),
        (*ties, *_carriers(graph.carriers), *_looks(reads, graph.nodes)),
        turning=frozenset(session.turning),
    )


def drawing_of_live(live: LiveSession) -> Drawing:
    """The graph of a running session, with the health of each node and link."""
    about = live.about
    carriers = {name: node.process for name, node in about.nodes.items() if node.process is not None}
    roles = {name: node.role for name, node in about.nodes.items()}
    parts = []
    for name, node in about.nodes.items():
        seen = live.nodes[name]
        parts.append(Part(name, node.role, node.ports, node.process, (), seen.health, seen.state, rounded(seen.rate)))
    ties = [_link(link.ends, link.ports, roles, live.link_health(link)) for link in about.links]
    return Drawing(
        about.session,
        (*parts, *_observers(about.observers)),
        (*ties, *_carriers(carriers), *_looks(about.observers, roles)),
        live.health,
        about.pid,
        frozenset(about.turning),
    )


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
    return [Part(name, Role.OBSERVER, reads=what) for name, what in reads.items()]


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


def graph_object(drawing: Drawing) -> dict[str, Any]:
    """Nodes, links and observers, as ``--json`` prints them; of a running session with the health of each.

    ``between`` of a link begins with the end that is nearer to the environment, and ``signals`` are the channels that
    each end writes; an observer's ``reads`` are as in the session. The ``process`` of a node that runs in a device's
    process is the name of that device.
    """
    whole = {} if drawing.health is None else {"pid": drawing.pid, "health": drawing.health.value}
    return {
        "session": drawing.title,
        **whole,
        "nodes": {part.name: _node_object(part) for part in drawing.nodes},
        "links": [
            {
                "between": [world, hand],
                "ports": list(tie.ports),
                "signals": {world: back, hand: there},
                **({} if tie.health is None else {"health": tie.health.value}),
            }
            for tie, (there, back) in drawing.links()
            for hand, world in (tie.ends,)
        ],
        "observers": {part.name: {"reads": list(part.reads)} for part in drawing.observers},
    }


def _node_object(part: Part) -> dict[str, Any]:
    stands = {} if part.health is None else {"state": part.state, "rate": part.rate, "health": part.health.value}
    process = {} if part.process is None else {"process": part.process}
    return {"role": part.role.value, "ports": list(part.ports), **process, **stands}


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
