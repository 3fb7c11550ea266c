"""What somebody who looks on keeps of a session's traces: the last seconds of each, decimated, in bounded memory. Pure.

Every trace of the table of topics is a track, and so is each device's velocity, which is the difference of its
displacement from tick to tick, taken before anything is left out.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from manyhands.nodes.observer.about import About
from manyhands.nodes.observer.decimation import Decimated, Decimator, Floats, extremes
from manyhands.protocol.messages import Observation, Role
from manyhands.protocol.topics import DISPLACEMENT, LEDGER, Columns, Topic, topics_of

WINDOW: Final = 10.0
"""Seconds of a trace that are kept."""

BUCKETS: Final = 1000
"""Into so many buckets those seconds are cut: as many as a picture is wide."""

VELOCITY: Final = Topic("velocity", "v", "v", "m/s", Columns.PORTS)
"""What no node tells: the difference of a device's displacement over a period."""


class Track:
    """The last buckets of one trace, in a ring.

    Attributes:
        end: index of the bucket after the latest; 0 before there is any.
    """

    def __init__(self, columns: int, capacity: int = BUCKETS) -> None:
        """Empty."""
        self._ring = np.full((capacity, 2, columns), np.nan)
        self._begin = self.end = 0

    def add(self, piece: Decimated) -> None:
        """Add buckets; between them and the latest there may be a gap, which is kept as one of NaN.

        A bucket that is the latest already (a gap began and ended inside it) is joined with what it has.
        """
        capacity, first, values = len(self._ring), piece.first, piece.values
        end = first + len(values)
        if self.end and first == self.end - 1:
            place = first % capacity
            both = np.concatenate([self._ring[place], values[0]])[None]
            values = np.concatenate([extremes(both), values[1:]])
        elif not self.end or first > self.end + capacity:
            self._begin, self.end = first, first
            self._ring[:] = np.nan
        gap = np.arange(self.end, max(first, self.end)) % capacity
        self._ring[gap] = np.nan
        places = np.arange(max(first, end - capacity), end)
        self._ring[places % capacity] = values[len(values) - len(places) :]
        self.end = end
        self._begin = max(self._begin, end - capacity)

    def since(self, bucket: int) -> Decimated:
        """The buckets from ``bucket`` on, or as many of them as are kept."""
        first = min(max(bucket, self._begin), self.end)
        return Decimated(first, self._ring[np.arange(first, self.end) % len(self._ring)])


@dataclass(frozen=True)
class TrackKey:
    """Which track: of which node, and of which topic."""

    node: str
    topic: Topic

    @property
    def name(self) -> str:
        """Node and topic in one word."""
        return f"{self.node}/{self.topic.name}"


class Tracks:
    """All tracks of a session.

    Attributes:
        size: ticks a bucket.
        columns: names of each track's columns.
        unfit: observations whose traces were not of this session's shape.
    """

    def __init__(self, about: About, window: float = WINDOW, buckets: int = BUCKETS) -> None:
        """Nothing has come yet."""
        self.size = max(1, round(window / about.period / buckets))
        self._about, self._buckets = about, buckets
        self.columns = {key: _columns(key, about) for key in _keys(about)}
        self._tracks = {key: Track(len(columns), buckets) for key, columns in self.columns.items()}
        self._decimators = {key: Decimator(self.size, len(columns)) for key, columns in self.columns.items()}
        self._last: dict[str, tuple[int, Floats]] = {}  # of each device its latest displacement, and its tick
        self.unfit = 0

    def take(self, observation: Observation) -> None:
        """Take in what a node told."""
        rows = max((len(trace) for trace in observation.traces.values()), default=0)
        first = observation.tick - rows
        for key in self.columns:
            if key.node != observation.node or key.topic is VELOCITY:
                continue
            values = observation.traces.get(key.topic.trace)
            if values is None:
                continue
            if values.shape != (rows, len(self.columns[key])) or first < 0:
                self.unfit += 1
                continue
            self._add(key, first, values)
            if key.topic.trace == DISPLACEMENT:
                self._add(TrackKey(key.node, VELOCITY), first, self._velocity(key.node, first, values))

    def items(self) -> Iterator[tuple[TrackKey, Track]]:
        """Every track, in the order of the session's nodes and of the table."""
        return iter(self._tracks.items())

    def _add(self, key: TrackKey, first: int, values: Floats) -> None:
        for piece in self._decimators[key].take(first, values):
            self._tracks[key].add(piece)

    def _velocity(self, node: str, first: int, x: Floats) -> Floats:
        """v(k) = (x(k) - x(k-1)) / T, m/s; NaN where the tick before is not known."""
        tick, before = self._last.get(node, (-1, x[:1]))
        known = before if tick == first - 1 and first else np.full_like(before, np.nan)
        self._last[node] = first + len(x) - 1, x[-1:]
        return np.diff(x, axis=0, prepend=known) / self._about.period


def _keys(about: About) -> Iterator[TrackKey]:
    for name, node in about.nodes.items():
        for topic in topics_of(node.role, tuple(about.masses)):
            if topic.trace == LEDGER and about.certificate is None:
                continue
            yield TrackKey(name, topic)
            if node.role is Role.DEVICE and topic.trace == DISPLACEMENT:
                yield TrackKey(name, VELOCITY)


def _columns(key: TrackKey, about: About) -> tuple[str, ...]:
    return key.topic.columns_of(about.nodes[key.node].ports, tuple(about.masses))
