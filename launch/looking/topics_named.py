"""Finding a topic of a running session by its name, however much of it was said. Pure."""

from __future__ import annotations

from dataclasses import dataclass
from difflib import get_close_matches

from manyhands.launch.session import SUPERVISOR
from manyhands.nodes.observer.about import About
from manyhands.protocol.topics import CONDITION, LEDGER, TELEMETRY, Topic, topic_name, topics_of

_MOST_LISTED = 60  # names in one message


class NoTopic(Exception):
    """There is no such topic; says which there are."""


@dataclass(frozen=True)
class Named:
    """A topic of a session.

    Attributes:
        session: the session's name.
        node: whose it is; the supervisor's is the session's condition.
        name: last part of its name.
        topic: its row of the table, or None where it is none of a node's ticks.
        columns: of a row of it.
    """

    session: str
    node: str
    name: str
    topic: Topic | None
    columns: tuple[str, ...] = ()

    @property
    def full(self) -> str:
        """Its full name."""
        return topic_name(self.session, self.node, self.name)


def named_topics(about: About) -> dict[str, Named]:
    """Every topic of a session by ``NODE/TOPIC``, in the session's order. A session without promises has no ledgers."""
    masses = tuple(about.masses)
    found = []
    for name, node in about.nodes.items():
        found += [
            Named(about.session, name, topic.name, topic, topic.columns_of(node.ports, masses))
            for topic in topics_of(node.role, masses)
            if about.certificate is not None or topic.trace != LEDGER
        ]
        found.append(Named(about.session, name, TELEMETRY, None))
    found.append(Named(about.session, SUPERVISOR, CONDITION, None))
    return {f"{one.node}/{one.name}": one for one in found}


def session_of(name: str) -> str | None:
    """The session that a topic's full name, ``/SESSION/NODE/TOPIC``, begins with; None for one that is not full."""
    parts = name.split("/")
    return parts[1] if len(parts) == 4 and not parts[0] else None


def find_topic(about: About, name: str) -> Named:
    """The topic of this name.

    Args:
        about: the session.
        name: ``NODE/TOPIC`` or ``/SESSION/NODE/TOPIC``.

    Raises:
        NoTopic: the session has none of that name.
    """
    topics = named_topics(about)
    session = session_of(name)
    short = name if session is None else name.split("/", 2)[2]
    if short in topics and session in (None, about.session):
        return topics[short]
    node, _, last = short.partition("/")
    by_quantity = [
        other
        for other, one in topics.items()
        if one.node == node and one.topic and last in (one.topic.trace, one.topic.symbol)
    ]
    close = by_quantity or get_close_matches(short, topics, n=1)
    hint = f"; did you mean {close[0]}?" if close else ""
    listed = list(topics)
    rest = f" and {len(listed) - _MOST_LISTED} more" if len(listed) > _MOST_LISTED else ""
    shown = ", ".join(listed[:_MOST_LISTED]) + rest
    raise NoTopic(f"found no topic {name!r} in session {about.session!r}{hint}; expected one of: {shown}")
