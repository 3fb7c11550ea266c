"""Finding a topic of a running session by its name, however much of it was said. Pure.

What `manyhands echo` prints: a line of JSON for each value of a topic, as a recording has them.

What `manyhands hz` finds: how often a topic is told of, and how evenly, and who measured that. Pure.

Ticks come in batches, one telemetry of about a hundred: when a batch arrives says how fast ticks go, and nothing of
how evenly. That the device measures itself, from sample to sample, and tells the percentiles since it was started; the
delays inside its ticks it tells one by one.
"""

from __future__ import annotations

import dataclasses
import json
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any, Final

import numpy as np

from manyhands.launch.session import SUPERVISOR
from manyhands.nodes import telemetry as names
from manyhands.nodes.json_number import json_number
from manyhands.nodes.observer.scene import About
from manyhands.protocol.channels import CONDITION, LEDGER, TAU, TELEMETRY, Columns, Topic, topic_name, topics_of
from manyhands.protocol.clock import Instant
from manyhands.protocol.messages import Condition, Observation

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


class EchoLines:
    """Makes lines of what is seen.

    Attributes:
        printed: lines made so far.
        misfits: observations whose trace was not of the topic's columns.
    """

    def __init__(self, named: Named, period: float, count: int | None = None, every: int = 1) -> None:
        """Echo a topic.

        Args:
            named: the topic.
            period: T, s.
            count: lines to make; None for no end.
            every: of a topic of ticks those that are a multiple of it, of another one every so many messages.
        """
        self._named, self._period, self._count, self._every = named, period, count, every
        self._messages = 0
        self.printed = self.misfits = 0

    @property
    def done(self) -> bool:
        """Whether all lines are made."""
        return self._count is not None and self.printed >= self._count

    def lines(self, message: Observation | Condition | None, tick: int) -> Iterator[str]:
        """The lines of a message, none if it says nothing of the topic; ``tick`` is the session's latest."""
        for value in self._values(message, tick):
            if self.done:
                return
            self.printed += 1
            yield json.dumps(value, allow_nan=False, ensure_ascii=False)

    def _values(self, message: Observation | Condition | None, tick: int) -> Iterator[dict[str, Any]]:
        named = self._named
        if isinstance(message, Condition):
            if named.name == CONDITION and self._turn():
                yield self._at(tick) | dataclasses.asdict(message)
        elif message is not None and message.node == named.node:
            if named.topic is not None:
                yield from self._rows(message)
            elif named.name == TELEMETRY and self._turn():
                figures = {name: json_number(value) for name, value in message.figures.items()}
                yield {"tick": message.tick, "figures": figures}

    def _rows(self, told: Observation) -> Iterator[dict[str, Any]]:
        topic = self._named.topic
        trace = None if topic is None else told.traces.get(topic.trace)
        if topic is None or trace is None:
            return
        rows = trace.shape[0]
        if trace.ndim != 2 or trace.shape[1] != len(self._named.columns) or rows > told.tick:
            self.misfits += 1
            return
        for tick, row in enumerate(trace.tolist(), start=told.tick - rows):
            if tick % self._every == 0:
                numbers = [json_number(value) for value in row]
                yield self._at(tick) | {topic.trace: numbers[0] if topic.columns is Columns.ONE else numbers}

    def _at(self, tick: int) -> dict[str, Any]:
        return {"tick": tick, "time": round(tick * self._period, 9)}

    def _turn(self) -> bool:
        self._messages += 1
        return (self._messages - 1) % self._every == 0


DEFAULT_WINDOW: Final = 10_000
"""Messages that figures are taken over, if nothing else is asked for: of a topic of ticks, so many ticks."""


@dataclass(frozen=True, eq=False)
class _Batch:
    """What came at once: when, how many messages, which tick they lead up to, and the delays inside their ticks, us."""

    at: Instant
    messages: int
    tick: int
    tau: tuple[float, ...]


class Pacing:
    """Takes in what is seen, and says how often and how evenly it came.

    Attributes:
        missing: ticks that no telemetry told of, between two that did.
        restarts: times that the node began anew, at a tick that it had told of.
    """

    def __init__(self, named: Named, window: int = DEFAULT_WINDOW) -> None:
        """``window``: messages of the topic that the figures are taken over, at least 2."""
        self._named, self._window = named, window
        self._batches: deque[_Batch] = deque()
        self._kept = 0
        self._figures: dict[str, float] = {}
        self.missing = self.restarts = 0

    def take(self, message: Observation | Condition | None, at: Instant) -> bool:
        """Take in a message that came at ``at``; whether it said anything of the topic."""
        named = self._named
        if isinstance(message, Condition):
            if named.name != CONDITION:
                return False
            self._keep(_Batch(at, 1, 0, ()))
            return True
        if message is None or message.node != named.node:
            return False
        rows = 1
        tau: tuple[float, ...] = ()
        if named.topic is not None:
            trace = message.traces.get(named.topic.trace)
            if trace is None or len(trace) == 0:
                return False
            rows = len(trace)
            delays = message.traces.get(TAU)
            tau = () if delays is None else tuple(delays.ravel().tolist())
            self._follow(message.tick, rows)
        self._figures = dict(message.figures)
        self._keep(_Batch(at, rows, message.tick, tau))
        return True

    def _follow(self, tick: int, rows: int) -> None:
        if not self._batches:
            return
        ended = self._batches[-1].tick
        if tick - rows < ended:
            self.restarts += 1
            self._batches.clear()
            self._kept = 0
        else:
            self.missing += tick - rows - ended

    def _keep(self, batch: _Batch) -> None:
        self._batches.append(batch)
        self._kept += batch.messages
        while len(self._batches) > 2 and self._kept - self._batches[0].messages >= self._window:
            self._kept -= self._batches.popleft().messages

    def found(self) -> dict[str, Any]:
        """What is known by now, as ``--json`` prints it.

        ``rate`` (messages a second; of a topic of ticks, ticks a second) and ``arrival_ms`` need two arrivals, and are
        None before. ``period_us`` and ``tau_us`` are there for a device alone, which measures them.
        """
        batches = list(self._batches)
        ticks = self._named.topic is not None
        rate: float | None = None
        arrival: dict[str, float] | None = None
        if len(batches) >= 2 and batches[-1].at > batches[0].at:
            done = batches[-1].tick - batches[0].tick if ticks else len(batches) - 1
            rate = done * 1e9 / (batches[-1].at - batches[0].at)
            arrival = _spread(np.diff([batch.at for batch in batches]) / 1e6)
        found: dict[str, Any] = {
            "topic": self._named.full,
            "of": "ticks" if ticks else "messages",
            "window": self._kept,
            "rate": rate,
            "arrival_ms": arrival,
        }
        if ticks:
            found |= {"missing": self.missing, "restarts": self.restarts}
            period = {name: self._figures.get(f"{names.PERIOD}_{name}") for name in ("p50", "p99")}
            delays = np.array([delay for batch in batches for delay in batch.tau])
            delays = delays[np.isfinite(delays)]
            if all(value is not None and np.isfinite(value) for value in period.values()):
                found["period_us"] = period
            if delays.size:
                found["tau_us"] = _spread(delays)
        return found


def _spread(values: np.ndarray[Any, np.dtype[np.float64]]) -> dict[str, float]:
    p50, p99 = np.percentile(values, (50.0, 99.0)).tolist()
    return {"p50": p50, "p99": p99, "min": float(values.min()), "max": float(values.max())}


def sentence(found: dict[str, Any]) -> str:
    """One line for a person; each figure says who measured it."""
    if found["rate"] is None:
        return f"{found['topic']}: waiting for a second message"
    unit = "ticks/s" if found["of"] == "ticks" else "messages/s"
    parts = [f"{found['topic']}: {found['rate']:.1f} {unit} over {found['window']} {found['of']}"]
    if "period_us" in found:
        period = found["period_us"]
        parts.append(f"period p50/p99 {period['p50']:.0f}/{period['p99']:.0f} us (the device's, since its start)")
    if "tau_us" in found:
        tau = found["tau_us"]
        parts.append(f"tau p50/p99/max {tau['p50']:.0f}/{tau['p99']:.0f}/{tau['max']:.0f} us (the device's)")
    arrival = found["arrival_ms"]
    what = "batches" if found["of"] == "ticks" else "messages"
    spread = f"{arrival['p50']:.1f}/{arrival['p99']:.1f}/{arrival['max']:.1f}"
    parts.append(f"{what} arrive here every p50/p99/max {spread} ms")
    if found["of"] == "ticks":
        parts.append(f"missing {found['missing']}")
        if found["restarts"]:
            parts.append(f"restarts {found['restarts']}")
    return "; ".join(parts)
