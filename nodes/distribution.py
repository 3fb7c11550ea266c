"""Percentiles of a stream of durations, in bounded memory and constant time a value.

A run has no stated end, so values cannot be kept. They are counted in buckets whose widths grow with the
value, one percent each: a percentile is exact to one percent, the maximum exactly.
"""

from __future__ import annotations

import math

_SMALLEST = 0.1  # us; anything below counts as zero
_GROWTH = 0.01
_BUCKETS = 2 + int(math.log(1e10) / math.log1p(_GROWTH))  # up to 1e9 us, a quarter of an hour
_PER_LOG = 1.0 / math.log1p(_GROWTH)
_BLOCK = 64  # buckets that are counted together as well, so that a percentile is found in a hundred steps, not 2,000

PERCENTILES = ("p50", "p99", "p999", "max")
"""What is told of a distribution."""


class Distribution:
    """Counts durations, us."""

    def __init__(self) -> None:
        self._counts = [0] * _BUCKETS  # a list: to count one there costs a loop a tenth of numpy's, cold
        self._blocks = [0] * (1 + _BUCKETS // _BLOCK)
        self._maximum = 0.0

    def add(self, microseconds: float) -> None:
        """Count one duration, us; negative ones count as zero."""
        if microseconds > self._maximum:
            self._maximum = microseconds
        bucket = 0
        if microseconds >= _SMALLEST:
            bucket = min(1 + int(math.log(microseconds / _SMALLEST) * _PER_LOG), _BUCKETS - 1)
        self._counts[bucket] += 1
        self._blocks[bucket // _BLOCK] += 1

    def quantile(self, fraction: float) -> float:
        """The duration (us) that ``fraction`` of all do not exceed; 0 when there are none."""
        total = sum(self._blocks)
        if total == 0:
            return 0.0
        block, counted = _reach(self._blocks, 0, 0, fraction * total)
        bucket, _ = _reach(self._counts, block * _BLOCK, counted, fraction * total)
        return 0.0 if bucket == 0 else min(_SMALLEST * math.exp(bucket / _PER_LOG), self._maximum)

    def percentiles(self) -> dict[str, float]:
        """p50, p99, p999 and max, us."""
        values = (self.quantile(0.5), self.quantile(0.99), self.quantile(0.999), self._maximum)
        return dict(zip(PERCENTILES, values, strict=True))


def _reach(counts: list[int], first: int, counted: int, target: float) -> tuple[int, int]:
    """Where, from ``first`` on, a sum that begins at ``counted`` reaches ``target``; and what it was before."""
    at = first
    while counted + counts[at] < target:
        counted += counts[at]
        at += 1
    return at, counted
