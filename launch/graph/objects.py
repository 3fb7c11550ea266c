"""A session's graph and capability table, and a running session's graph, as ``--json`` prints them."""

from __future__ import annotations

from typing import Any

from manyhands.launch.access import DATA, joins
from manyhands.launch.looking.listing import rounded
from manyhands.launch.plan import Plan
from manyhands.launch.topology import Topology
from manyhands.nodes.observer.scene import Scene
from manyhands.protocol.messages import Role


def graph_object(plan: Plan) -> dict[str, Any]:
    """Nodes, links and observers, as ``--json`` prints them.

    ``signals`` of a link are the channels that each of its ends writes; an observer's ``reads`` are as in the session.
    A node that runs in another one's process has that one's name as its ``process``.
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


def scene_object(scene: Scene) -> dict[str, Any]:
    """The graph of a running session: as that of its file, with the health of each node and link.

    ``between`` of a link begins with the end that is nearer to the world, as in a file's.
    """
    about = scene.about
    roles = {name: node.role for name, node in about.nodes.items()}
    return {
        "session": about.session,
        "pid": about.pid,
        "health": scene.health.value,
        "nodes": {
            name: {
                "role": node.role.value,
                "ports": list(node.ports),
                **({} if node.process is None else {"process": node.process}),
                "state": scene.nodes[name].state,
                "rate": rounded(scene.nodes[name].rate),
                "health": scene.nodes[name].health.value,
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
                "health": scene.link_health(link).value,
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
