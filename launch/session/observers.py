"""Who may look on at a session without taking part in it, and at which channels.

An observer is told what its session lists and nothing else, and it writes nothing. Which channels there are to read
follows from the channel table: every node's telemetry, and each signal under the end that is nearer to the hand,
where its ports are a device's (``dx/sample``, ``dx/force``) or a coupling's (``cx/tool``, ``cx/reaction``).
"""

from collections.abc import Iterator, Mapping
from typing import Annotated, Final

from pydantic import BeforeValidator, Field

from manyhands.launch.session.error import one_of, show
from manyhands.launch.session.fields import Items, Problem, SessionModel, refuse
from manyhands.launch.session.limits import MAX_READS
from manyhands.launch.session.structure import RESERVED
from manyhands.protocol.channels import CHANNELS, Channel, Rate
from manyhands.protocol.messages import Role

TELEMETRY: Final = "telemetry"
"""Alone: the telemetry of every node."""

_FROM_THE_HAND: Final = (Role.DEVICE, Role.COUPLING, Role.ENVIRONMENT)


def _word(value: object) -> str:
    if not isinstance(value, str):
        raise refuse(show(value), f"{TELEMETRY}, or NODE/CHANNEL")
    return value


class Observer(SessionModel):
    """One who looks on."""

    reads: Annotated[tuple[str, ...], BeforeValidator(Items("channels", MAX_READS, _word))] = Field(
        description="what it may read: telemetry for that of all nodes, or single channels as NODE/CHANNEL"
    )

    def problems(self, nodes: Mapping[str, Role]) -> Iterator[Problem]:
        """Which of its channels are none of a session with these nodes, or are listed twice."""
        seen: set[str] = set()
        for index, entry in enumerate(self.reads):
            at = ("reads", index)
            node, slash, channel = entry.partition("/")
            if entry in seen:
                yield Problem(at, f"the channel {show(entry)} twice", "each channel once")
            elif slash and node not in nodes:
                yield Problem(at, f"the unknown node {show(node)} in {show(entry)}", one_of(nodes, node))
            elif slash and channel not in (valid := observable(nodes[node])):
                own = [f"{node}/{name}" for name in valid]
                yield Problem(at, f"the channel {show(channel)} of {node!r}", one_of(own, entry))
            elif not slash and entry != TELEMETRY:
                yield Problem(at, show(entry), f"{TELEMETRY}, or NODE/CHANNEL such as {next(iter(nodes))}/{TELEMETRY}")
            seen.add(entry)


def observable(role: Role) -> tuple[str, ...]:
    """The channels that an observer may be allowed to read of a node of this role."""
    return tuple(channel.name for channel in CHANNELS.values() if role in _told_by(channel))


def _told_by(channel: Channel) -> tuple[Role, ...]:
    """The nodes under whose names a channel is observed; none for what is said to set up and end a session."""
    if channel.rate is Rate.EVERY_TICK:
        ends = {*channel.senders, *channel.receivers}
        return (next(role for role in _FROM_THE_HAND if role in ends),)
    return channel.senders if channel.name == TELEMETRY else ()


def observer_problems(observers: Mapping[str, Observer], nodes: Mapping[str, Role]) -> Iterator[Problem]:
    """Everything that is wrong with the names of observers, and with what they are to read of these nodes."""
    for name, observer in observers.items():
        at = ("observers", name)
        if name in RESERVED:
            yield Problem(at, f"the reserved name {name!r}", f"a name other than {', '.join(RESERVED)}")
        elif name in nodes:
            yield Problem(at, f"the name {name!r} of a {nodes[name]}", "a name that no device or coupling has")
        for problem in observer.problems(nodes):
            yield problem._replace(at=(*at, *problem.at))
