"""What comes of recomputing a party from the signals that it had."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from manyhands.launch.recordings.findings import Gap

Array = NDArray[np.float64]
Progress = Callable[[int], None]

EVERY: Final = 1000
"""Ticks between two words of progress."""


@dataclass(eq=False)
class Recomputed:
    """What a party must have told.

    Attributes:
        signal: x of a device or p of a coupling, ticks x ports, m; NaN where it could not be recomputed.
        ledger: ticks x 1, J; likewise.
        gaps: why not.
    """

    signal: Array
    ledger: Array
    gaps: list[Gap] = field(default_factory=list)

    @classmethod
    def nothing(cls, ticks: int, ports: int) -> Recomputed:
        """Nothing yet."""
        return cls(np.full((ticks, ports), np.nan), np.full((ticks, 1), np.nan))


def no_progress(_tick: int) -> None:
    """Nobody is told."""
