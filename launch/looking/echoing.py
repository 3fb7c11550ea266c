"""What `manyhands echo` prints: a line of JSON for each value of a topic, as a recording has them."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from typing import Any

from manyhands.launch.looking.topics_named import Named
from manyhands.nodes.json_number import json_number
from manyhands.protocol.messages import Condition, Observation
from manyhands.protocol.topics import CONDITION, TELEMETRY, Columns


class Echo:
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
