"""Percentiles of a stream of durations, in bounded memory and in constant time for each value.

A run has no stated end, so it cannot keep the values. They are counted in buckets whose widths grow by one percent
each: a percentile is right to one percent, and the maximum is exact.
"""

from __future__ import annotations

import math

_SMALLEST = 0.1  # us; anything below counts as zero
_GROWTH = 0.01
_BUCKETS = 2 + int(math.log(1e10) / math.log1p(_GROWTH))  # up to 1e9 us, a quarter of an hour
_PER_LOG = 1.0 / math.log1p(_GROWTH)
_BLOCK = 64  # buckets that have a sum of their own, so that a percentile takes a hundred steps and not 2,000

PERCENTILES = ("p50", "p99", "p999", "max")
"""The figures of a distribution in a report."""


class Distribution:
    """The distribution of durations, us, by counts in buckets."""

    def __init__(self) -> None:
        self._counts = [0] * _BUCKETS  # a list: with cold caches an increment costs a tenth of numpy's
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
    """The index from ``first`` on at which a sum that begins at ``counted`` reaches ``target``, and the sum before."""
    at = first
    while counted + counts[at] < target:
        counted += counts[at]
        at += 1
    return at, counted
