"""The last seconds of every trace of a session, decimated, in bounded memory: pure.

Every trace of the table of topics is a track, except for those that nobody draws: the instants of ticks, and what a
hand that turns and its world hear of each other, for the audit. So is each device's velocity: the difference of its
displacement from sample to sample, taken before decimation; and so is the angle between a device and its tool, where a
hand turns that and feels a torque.

A bucket is a run of ticks of fixed length, counted from tick 0, so that the buckets of all nodes of one period are
aligned. Of each bucket two values are kept, its least and its greatest, in the order of time. A curve through them
touches every extreme of the trace, however short; a curve through every n-th sample would not.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from manyhands.nodes.kernel.orientation import angles
from manyhands.nodes.monitor.session_state import About
from manyhands.protocol.channels import DISPLACEMENT, INSTANT_NAMES, INSTANTS, ORIENTATION, PROXY, Columns, Topic
from manyhands.protocol.messages import Observation, Role

Floats = NDArray[np.float64]


def extremes(values: Floats) -> Floats:
    """Least and greatest value of each bucket, in the order of time.

    Args:
        values: buckets x ticks x columns; NaN where there is no value.

    Returns:
        Buckets x 2 x columns: the two values of every bucket and column, the earlier first; NaN twice where all are
            NaN.
    """
    absent = np.isnan(values)
    least = np.where(absent, np.inf, values).argmin(axis=1)
    greatest = np.where(absent, -np.inf, values).argmax(axis=1)
    places = np.stack([np.minimum(least, greatest), np.maximum(least, greatest)], axis=1)
    return np.take_along_axis(values, places, axis=1)


@dataclass(frozen=True, eq=False)
class Decimated:
    """Consecutive buckets of a trace: the index of the first, and the two values of each (buckets x 2 x columns)."""

    first: int
    values: Floats


class Decimator:
    """Makes buckets of a trace that arrives in successive pieces.

    Attributes:
        size: ticks per bucket.
    """

    def __init__(self, size: int, columns: int) -> None:
        """Begin before the first piece.

        Raises:
            ValueError: ``size`` is below 1.
        """
        if size < 1:
            raise ValueError(f"found a bucket of {size} ticks; expected at least 1")
        self.size, self._columns = size, columns
        self._next: int | None = None
        self._rest = np.empty((0, columns))

    def take(self, tick: int, values: Floats) -> list[Decimated]:
        """Take in the next piece.

        Args:
            tick: of its first row; rows that came before are left out.
            values: ticks x columns.

        Returns:
            The buckets that are complete now, or that a gap has ended, in the order of time.
        """
        if self._next is not None and tick < self._next:
            values = values[self._next - tick :]
            tick = self._next
        if not len(values):
            return []
        done = self._cut() if self._next is not None and tick > self._next else []
        whole = self._whole(tick, values)
        return done if whole is None else [*done, whole]

    def _cut(self) -> list[Decimated]:
        """The bucket that was begun before a gap."""
        rest, self._rest = self._rest, self._rest[:0]
        if not len(rest) or self._next is None:
            return []
        return [Decimated((self._next - 1) // self.size, extremes(rest[None]))]

    def _whole(self, tick: int, values: Floats) -> Decimated | None:
        begun = tick - len(self._rest)
        rows = np.concatenate([self._rest, values])
        self._next = tick + len(values)
        first, before = divmod(begun, self.size)  # a piece after a gap may begin inside a bucket
        if before:
            rows = np.concatenate([np.full((before, self._columns), np.nan), rows])
        count = len(rows) // self.size
        self._rest = rows[count * self.size :]
        if not count:
            self._rest = rows[before:]
            return None
        return Decimated(first, extremes(rows[: count * self.size].reshape(count, self.size, self._columns)))


WINDOW: Final = 10.0
"""Seconds of a trace that are kept."""

BUCKETS: Final = 1000
"""Number of buckets in those seconds: about the width of a picture in pixels."""

VELOCITY: Final = Topic("velocity", "v", "v", "m/s", Columns.PORTS)
"""A topic that no node reports: the difference of a device's displacements, divided by the time between their samples.
"""

ANGLE: Final = Topic("angle", "angle", "θ", "rad", Columns.ONE, hands=True)
"""A topic that no node reports: the angle of the turn between a device's orientation and its proxy's."""

DERIVED: Final[Mapping[str, Topic]] = {DISPLACEMENT: VELOCITY, PROXY: ANGLE}
"""The topics that no node reports, by the trace of a device that each is made of; :class:`Tracks` makes them."""

_UNDRAWN: Final = (Columns.INSTANTS, Columns.PROPOSED, Columns.HEARD)


class Track:
    """The last buckets of one trace, in a ring.

    Attributes:
        end: index of the bucket after the latest; 0 before there is any.
    """

    def __init__(self, columns: int, capacity: int = BUCKETS) -> None:
        """Begin empty, with room for ``capacity`` buckets."""
        self._ring = np.full((capacity, 2, columns), np.nan)
        self._begin = self.end = 0

    def add(self, piece: Decimated) -> None:
        """Add buckets. A gap between them and the latest is kept as buckets of NaN.

        If the first one is the latest already (a gap began and ended inside it), the two are joined.
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
        """The buckets from ``bucket`` on, as many of them as are kept."""
        first = min(max(bucket, self._begin), self.end)
        return Decimated(first, self._ring[np.arange(first, self.end) % len(self._ring)])


@dataclass(frozen=True)
class TrackKey:
    """A track's node and topic."""

    node: str
    topic: Topic

    @property
    def name(self) -> str:
        """Node and topic in one word."""
        return f"{self.node}/{self.topic.name}"


class Tracks:
    """All tracks of a session.

    Attributes:
        size: the session's ticks per bucket.
        sizes: by node, its own ticks per bucket.
        columns: names of each track's columns.
        unfit: number of traces that did not have this session's shape.
    """

    def __init__(self, about: About, window: float = WINDOW, buckets: int = BUCKETS) -> None:
        """Begin without any tick."""
        self.size = max(1, round(window / about.period / buckets))
        self.sizes = {name: max(1, round(self.size * about.rate_of(name))) for name in about.nodes}
        self._about, self._buckets = about, buckets
        self.columns = {key: _columns(key, about) for key in _keys(about)}
        self._tracks = {key: Track(len(columns), buckets) for key, columns in self.columns.items()}
        self._decimators = {key: Decimator(self.sizes[key.node], len(columns)) for key, columns in self.columns.items()}
        self._derived: Mapping[Topic, Callable[[int, Floats, Observation], Floats]] = {
            VELOCITY: self._velocity,
            ANGLE: self._angle,
        }
        self._last: dict[str, tuple[int, Floats, Floats]] = {}  # each device's latest tick, with x and s then
        self.unfit = 0

    def take(self, observation: Observation) -> None:
        """Take in a node's observation."""
        rows = max((len(trace) for trace in observation.traces.values()), default=0)
        first = observation.tick - rows
        for key in self.columns:
            if key.node != observation.node or key.topic in self._derived:
                continue
            values = observation.traces.get(key.topic.trace)
            if values is None:
                continue
            if values.shape != (rows, len(self.columns[key])) or first < 0:
                self.unfit += 1
                continue
            self._add(key, first, values)
            derived = TrackKey(key.node, DERIVED.get(key.topic.trace, key.topic))
            if derived != key and derived in self.columns:
                self._add(derived, first, self._derived[derived.topic](first, values, observation))

    def items(self) -> Iterator[tuple[TrackKey, Track]]:
        """Every track, in the order of the session's nodes and of the table."""
        return iter(self._tracks.items())

    def _add(self, key: TrackKey, first: int, values: Floats) -> None:
        for piece in self._decimators[key].take(first, values):
            self._tracks[key].add(piece)

    def _velocity(self, first: int, x: Floats, observation: Observation) -> Floats:
        """v(k) = (x(k) - x(k-1)) / (s(k) - s(k-1)), m/s; NaN where the tick before is not known.

        A device in wall time reports its samples' instants s(k); for any other they are kT.
        """
        node, instants = observation.node, observation.traces.get(INSTANTS)
        if instants is None or instants.shape != (len(x), len(INSTANT_NAMES)):
            s = self._about.period_of(node) * np.arange(first, first + len(x), dtype=np.float64)[:, None]
        else:
            s = 1e-9 * instants[:, :1]
        tick, *before = self._last.get(node, (-1, x[:1], s[:1]))
        self._last[node] = first + len(x) - 1, x[-1:], s[-1:]
        if tick != first - 1 or not first:
            before = [np.full_like(x[:1], np.nan), np.full_like(s[:1], np.nan)]
        with np.errstate(invalid="ignore", over="ignore"):  # a node may send any number; the curve then has a gap
            moved, passed = (np.diff(values, axis=0, prepend=last) for values, last in zip((x, s), before, strict=True))
            return np.divide(moved, passed, out=np.full_like(moved, np.nan), where=passed > 0.0)

    def _angle(self, _first: int, proxy: Floats, observation: Observation) -> Floats:
        """The angle of R Q^T, rad; nothing where the device's orientation is not told."""
        R = observation.traces.get(ORIENTATION)
        return angles(R, proxy)[:, None] if R is not None and R.shape == proxy.shape else np.empty((0, 1))


def _keys(about: About) -> Iterator[TrackKey]:
    for name, node in about.nodes.items():
        for topic in about.topics(name):
            if topic.columns in _UNDRAWN:
                continue
            yield TrackKey(name, topic)
            if node.role is Role.DEVICE and topic.trace in DERIVED:
                yield TrackKey(name, DERIVED[topic.trace])


def _columns(key: TrackKey, about: About) -> tuple[str, ...]:
    if key.topic not in DERIVED.values():
        return about.topics(key.node)[key.topic]
    return (key.topic.symbol,) if key.topic.columns is Columns.ONE else about.nodes[key.node].ports
