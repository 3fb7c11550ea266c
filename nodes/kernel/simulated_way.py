"""A network under the simulated clock: waves come late, out of order, or not at all, by a seed.

Where no time passes, a wave leaves and arrives in its tick. A session may state a delay, a jitter and a loss in place
of that (:class:`SimulatedWay`). The end that hears a wave then keeps it until the tick in which it is due
(:class:`WavesUnderWay`). So a run in one process and one of many processes have the same numbers.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from random import Random


@dataclass(frozen=True)
class SimulatedWay:
    """One direction of a simulated network.

    Attributes:
        delay: the least time under way, s.
        jitter: by how much the time under way exceeds it at most, s; each wave by itself, evenly.
        loss: the part of the waves that are lost, at random.
        seed: of the chances.

    Raises:
        ValueError: a number is out of its range.
    """

    delay: float = 0.0
    jitter: float = 0.0
    loss: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        if not (0.0 <= self.delay < math.inf and 0.0 <= self.jitter < math.inf and 0.0 <= self.loss < 1.0):
            raise ValueError(f"found {self}; expected finite times of at least 0 s, and a loss of at least 0, below 1")


Kept = tuple[int, Sequence[float], float, int, int, tuple[float, ...]]
"""A wave as a face hears it: its tick, its sums, the energy shipped, its life, the buttons that are held down, and what
rides with it."""


class WavesUnderWay:
    """The waves of one direction that were sent and are not heard yet."""

    def __init__(self, way: SimulatedWay, period: float) -> None:
        """Nothing is under way.

        Args:
            way: the network.
            period: of the end that sends, s.
        """
        self._way, self._period, self._random = way, period, Random(way.seed)  # noqa: S311
        self._waves: list[tuple[float, Kept]] = []

    def send(self, wave: Kept) -> None:
        """A wave leaves at the end of its tick, or is lost."""
        way, random = self._way, self._random
        lost, extra = random.random() < way.loss, way.jitter * random.random()  # both of every wave, lost or not
        if not lost:
            heapq.heappush(self._waves, (wave[0] * self._period + way.delay + extra, wave))

    def arrived(self, by: float) -> Iterator[Kept]:
        """The waves that have come by the time ``by``, s, in the order of their arrival."""
        while self._waves and self._waves[0][0] <= by + _ROUNDING:
            yield heapq.heappop(self._waves)[1]


_ROUNDING = 1e-9  # s; a time is a product of a tick and a period
