"""Topics of a running session: found by full or short name, printed by `manyhands echo`, timed by `manyhands hz`.

`echo` prints a line of JSON for each value of a topic, in the form that recordings use. `hz` finds the rate and the
regularity of a topic, and each figure names what measured it.

Ticks arrive in batches: one telemetry message holds about a hundred. The arrival times of batches give the rate of
ticks, but not their regularity. The device itself measures the period from sample to sample, and reports the
percentiles since its start; it reports the delay inside each tick one by one. Everything here is pure.
"""

from __future__ import annotations

import dataclasses
import json
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any, Final

import numpy as np

from manyhands.launch.session import SUPERVISOR
from manyhands.nodes.kernel.json_number import json_figures, json_number
from manyhands.nodes.monitor.session_state import About
from manyhands.nodes.rows import figures as names
from manyhands.protocol.channels import CONDITION, TAU, TELEMETRY, Columns, Topic, topic_name
from manyhands.protocol.clock import Instant
from manyhands.protocol.messages import Condition, Observation

_MOST_LISTED = 60  # names in one message


class NoTopic(Exception):
    """The session has no such topic; the message lists its topics."""


@dataclass(frozen=True)
class Named:
    """A topic of a session.

    Attributes:
        session: the session's name.
        node: the node that it belongs to; the supervisor's topic is the session's condition.
        name: last part of its name.
        topic: its row in the table of topics; None for a topic that has no value for each tick.
        columns: the columns of one tick's values.
    """

    session: str
    node: str
    name: str
    topic: Topic | None
    columns: tuple[str, ...] = ()

    @property
    def full(self) -> str:
        """The full name, ``/SESSION/NODE/TOPIC``."""
        return topic_name(self.session, self.node, self.name)


def named_topics(about: About) -> dict[str, Named]:
    """Every topic of a session by ``NODE/TOPIC``, in the session's order."""
    found = []
    for name in about.nodes:
        found += [
            Named(about.session, name, topic.name, topic, columns) for topic, columns in about.topics(name).items()
        ]
        found.append(Named(about.session, name, TELEMETRY, None))
    found.append(Named(about.session, SUPERVISOR, CONDITION, None))
    return {f"{one.node}/{one.name}": one for one in found}


def session_of(name: str) -> str | None:
    """The session in a topic's full name, ``/SESSION/NODE/TOPIC``; None for a short name."""
    parts = name.split("/")
    return parts[1] if len(parts) == 4 and not parts[0] else None


def find_topic(about: About, name: str) -> Named:
    """The topic of this name.

    Args:
        about: the session.
        name: ``NODE/TOPIC`` or ``/SESSION/NODE/TOPIC``.

    Raises:
        NoTopic: the session has no topic of that name.
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
    """Turns the messages of a session into lines of JSON for one topic.

    Attributes:
        printed: lines made so far.
        misfits: observations whose trace did not have the topic's columns.
    """

    def __init__(self, named: Named, period: float, count: int | None = None, every: int = 1) -> None:
        """Lines for a topic.

        Args:
            named: the topic.
            period: T of its node, s.
            count: lines to make; None for no limit.
            every: N; a topic with a value for each tick prints the ticks that are multiples of N, any other topic each
                Nth message.
        """
        self._named, self._period, self._count, self._every = named, period, count, every
        self._messages = 0
        self.printed = self.misfits = 0

    @property
    def done(self) -> bool:
        """Whether all lines are made."""
        return self._count is not None and self.printed >= self._count

    def lines(self, message: Observation | Condition | None, tick: int) -> Iterator[str]:
        """The lines of a message, none if it does not hold the topic; ``tick`` is the session's latest tick."""
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
                yield {"tick": message.tick, "figures": json_figures(message.figures)}

    def _rows(self, observation: Observation) -> Iterator[dict[str, Any]]:
        topic = self._named.topic
        trace = None if topic is None else observation.traces.get(topic.trace)
        if topic is None or trace is None:
            return
        rows = trace.shape[0]
        if trace.ndim != 2 or trace.shape[1] != len(self._named.columns) or rows > observation.tick:
            self.misfits += 1
            return
        for tick, row in enumerate(trace.tolist(), start=observation.tick - rows):
            if tick % self._every == 0:
                numbers = [json_number(value) for value in row]
                yield self._at(tick) | {topic.trace: numbers[0] if topic.columns is Columns.ONE else numbers}

    def _at(self, tick: int) -> dict[str, Any]:
        return {"tick": tick, "time": round(tick * self._period, 9)}

    def _turn(self) -> bool:
        self._messages += 1
        return (self._messages - 1) % self._every == 0


DEFAULT_WINDOW: Final = 10_000
"""Number of ticks (of messages, for a topic without ticks) over which figures are computed by default."""


@dataclass(frozen=True, eq=False)
class _Batch:
    """One arrival: its instant, the number of ticks or messages in it, its last tick, and its ticks' delays, us."""

    at: Instant
    messages: int
    tick: int
    tau: tuple[float, ...]


class Pacing:
    """Measures the rate and regularity of one topic from the messages of a session.

    Attributes:
        missing: ticks that no telemetry reported, between two that did.
        restarts: how often the node began anew, at a tick that it had reported before.
    """

    def __init__(self, named: Named, window: int = DEFAULT_WINDOW) -> None:
        """``window``: number of ticks or messages over which the figures are computed, at least 2."""
        self._named, self._window = named, window
        self._batches: deque[_Batch] = deque()
        self._kept = 0
        self._period: Mapping[str, float] = {}
        self.missing = self.restarts = 0

    def take(self, message: Observation | Condition | None, at: Instant) -> bool:
        """Take in a message that came at ``at``; returns whether it held the topic."""
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
        self._period = message.figures.table(names.PERIOD)
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
        """The figures so far, as ``--json`` prints them.

        ``rate`` (ticks a second, or messages a second for a topic without ticks) and ``arrival_ms`` need two arrivals,
        and are None before. Only a device, which measures them, has ``period_us`` and ``tau_us``.
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
            period = {name: self._period.get(name) for name in ("p50", "p99")}
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
    """The figures in one line; those that the device measured say so."""
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
