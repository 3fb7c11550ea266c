"""A simulated network: it delivers messages late, twice, out of order, in a lump, or not at all, by a seed.

A :class:`Path` describes one direction, and a :class:`Channel` carries messages along it in simulated time. Nothing
here waits or reads a clock.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from random import Random
from typing import Final, Generic, TypeVar

Message = TypeVar("Message")


@dataclass(frozen=True)
class Path:
    """One direction of a network.

    Attributes:
        delay: least time under way, s.
        jitter: what the time under way exceeds it by at most, s.
        kind: how the time under way varies, one of :data:`KINDS`.
        loss: part of the messages that are lost at random.
        again: part of the messages that come a second time, up to 300 ms later.
        outage_every: mean time between outages, s; infinite for none. They last 50 to 500 ms.
        outages: further times at which everything is lost, s.
        rate: messages in a second that pass; the others queue up to 200 ms and are lost beyond. Infinite for no limit.
    """

    delay: float = 0.0
    jitter: float = 0.0
    kind: str = "uniform"
    loss: float = 0.0
    again: float = 0.0
    outage_every: float = math.inf
    outages: tuple[tuple[float, float], ...] = ()
    rate: float = math.inf


_QUEUE: Final = 0.2  # longest wait before a limited rate, s
_LATER: Final = 0.3  # how much later a second copy comes at most, s


class Channel(Generic[Message]):
    """One direction of a network in simulated time."""

    def __init__(self, path: Path, seed: int) -> None:
        """Nothing under way."""
        self._path, self._random = path, Random(seed)
        self._extra = KINDS[path.kind](path.jitter, self._random)
        self._under_way: list[tuple[float, int, Message]] = []
        self._count = 0
        self._free_at = 0.0  # when the limited rate lets the next message pass
        self._out_until, self._next_outage = -1.0, path.outage_every * self._random.expovariate(1.0)

    def send(self, at: float, message: Message) -> None:
        """Send ``message`` at the time ``at``, s, which never falls."""
        path, random = self._path, self._random
        lost = random.random() < path.loss or self._is_out(at)
        under_way = path.delay + self._extra(at)
        again = random.random() < path.again
        if path.rate < math.inf:
            leaves = max(at, self._free_at)
            lost = lost or leaves > at + _QUEUE
            if not lost:
                self._free_at = leaves + 1.0 / path.rate
                under_way += leaves - at
        if not lost:
            self._carry(at + under_way, message)
            if again:
                self._carry(at + under_way + random.uniform(0.0, _LATER), message)

    def arrived(self, by: float) -> Iterator[Message]:
        """The messages that have arrived by the time ``by``, s, in the order of their arrival."""
        while self._under_way and self._under_way[0][0] <= by:
            yield heapq.heappop(self._under_way)[2]

    def _carry(self, arrives: float, message: Message) -> None:
        self._count += 1
        heapq.heappush(self._under_way, (arrives, self._count, message))

    def _is_out(self, at: float) -> bool:
        if at >= self._next_outage:
            self._out_until = at + self._random.uniform(0.05, 0.5)
            self._next_outage = self._out_until + self._path.outage_every * self._random.expovariate(1.0)
        return at < self._out_until or any(first <= at < last for first, last in self._path.outages)


Extra = Callable[[float], float]


def _uniform(jitter: float, random: Random) -> Extra:
    """Anything up to the jitter, each message by itself: most overtake each other."""
    return lambda at: jitter * random.random()


def _machine(jitter: float, random: Random) -> Extra:
    """A shared machine: 0 to 15 % of the jitter, and for 3 % of the messages 15 % to all of it besides."""

    def extra(at: float) -> float:
        late = random.uniform(0.15, 1.0) if random.random() < 0.03 else 0.0
        return jitter * min(1.0, late + 0.06 * random.random() + random.expovariate(1.0 / 0.03))

    return extra


def _sawtooth(jitter: float, random: Random) -> Extra:
    """It grows for 0.15 to 1.5 s, and then falls to 0 at once: a queue that fills and is thrown away."""
    period, phase = random.uniform(0.15, 1.5), random.uniform(0.0, 1.5)
    return lambda at: jitter * ((at + phase) % period) / period


def _lumps(jitter: float, random: Random) -> Extra:
    """It falls as time goes on: all that was sent in as long as the jitter arrives together."""
    period, phase = jitter * random.uniform(1.1, 4.0) + 1e-9, random.uniform(0.0, 0.4)
    return lambda at: max(0.0, jitter - (at + phase) % period)


def _switching(jitter: float, random: Random) -> Extra:
    """All or nothing, for 20 to 200 ms in the mean: two ways, between which the messages change."""
    mean = random.uniform(0.02, 0.2)
    state = [False, 0.0]

    def extra(at: float) -> float:
        if at >= state[1]:
            state[0], state[1] = not state[0], at + random.expovariate(1.0 / mean)
        return jitter if state[0] else 0.0

    return extra


KINDS: Final[Mapping[str, Callable[[float, Random], Extra]]] = {
    "uniform": _uniform,
    "machine": _machine,
    "sawtooth": _sawtooth,
    "lumps": _lumps,
    "switching": _switching,
}
"""How the time under way may vary, from the jitter (s) to the extra time of a message sent at a time."""
