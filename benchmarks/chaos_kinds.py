"""The random faults and their sessions, shared by real processes (chaos.py) and simulated ones.

The simulation is ``tests/deterministic``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from random import Random
from typing import Final

from manyhands.launch.plan.topology import Topology
from manyhands.protocol.messages import Role

FOLDER: Final = Path(__file__).parent
RESTLESS: Final = [
    f"devices.{device}.{key}={value}"
    for device, frequency in (("dx", 1.3), ("dy", 0.9), ("dz", 1.7))
    for key, value in (
        ("hand.force", f'"1.5*sin(2*pi*{frequency}*t)"'),
        ("limits", "{force: 8, displacement: 2, speed: 2}"),
    )
]
"""Hands that never rest, for Example 1."""
SESSIONS: Final[Mapping[str, tuple[Path, Sequence[str]]]] = {
    "example-1": (FOLDER.parent / "launch" / "sessions" / "example1.yaml", RESTLESS),
    "chaos-four": (FOLDER / "chaos_four.yaml", []),
}
"""Each one's file and overrides."""
ENDURING: Final = "faults={restarts: 100, window: 60, breach: warn}"
"""The override by which a session outlives a campaign."""
PROMISE: Final = -1e-12
"""Below this a ledger's total is a broken promise, J."""


class Kind(StrEnum):
    """Kinds of faults."""

    DEVICE_KILLED = "device killed"
    COUPLING_KILLED = "coupling killed"
    ENVIRONMENT_KILLED = "environment killed"
    USER_KILLED = "device and coupling killed"
    LINKED_KILLED = "coupling and environment killed"
    STOPPED = "stopped and continued"
    SLOW = "stopped and continued again and again"


VICTIMS: Final[Mapping[Kind, tuple[Role, ...]]] = {
    Kind.DEVICE_KILLED: (Role.DEVICE,),
    Kind.COUPLING_KILLED: (Role.COUPLING,),
    Kind.ENVIRONMENT_KILLED: (Role.ENVIRONMENT,),
    Kind.USER_KILLED: (Role.DEVICE, Role.COUPLING),
    Kind.LINKED_KILLED: (Role.COUPLING, Role.ENVIRONMENT),
}
"""Who is killed, linked to each other; of the others it may be anybody."""


def draw(graph: Topology, alive: Sequence[str], random: Random) -> tuple[Kind, list[str]]:
    """The next fault and its nodes; no node if one of them is dead already."""
    kind = random.choice(list(Kind))
    if kind not in VICTIMS:
        return kind, [random.choice(alive)] if alive else []
    first, *others = VICTIMS[kind]
    victim = random.choice([node for node, role in graph.nodes.items() if role is first])
    linked = {end for link in graph.links_of(victim) for end in (link.binder, link.connector)}
    victims = [victim, *(node for node in sorted(linked - {victim}) if graph.nodes[node] in others)]
    return kind, victims if all(node in alive for node in victims) else []
