"""What dry friction adds to a device's damping, for motions below a stated speed.

A device that burns at least c |v| besides Delta_D v^2 has (c - w) |v| left where w |v| pays for the steps of encoders
(:mod:`manyhands.design.quantisation`). While |v(t)| <= v*,

    (c - w) |v| >= d v^2,        d = (c - w)/v*,

so that the device is as good as one of the level Delta_D + diag(d) with no friction. Beyond v* nothing is promised
(docs/decisions/0051-encoder-steps-and-friction.md).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from manyhands.design.levels.rounding import rounded_down
from manyhands.design.models.statespace import Matrix, matrix

_BELOW = Fraction(1, 10**12)  # of c: a file's numbers are its shortest decimals, which a proof takes exactly


def damping_below(speed: float, friction: Sequence[float], kept: Sequence[float]) -> tuple[float, ...]:
    """The damping d that dry friction stands for on each axis, N*s/m, rounded down; 0 where nothing is left.

    Args:
        speed: v*, m/s.
        friction: c by axis, N.
        kept: w by axis, N: what is kept for the steps of encoders.
    """
    out = []
    for c, w in zip(friction, kept, strict=True):
        out.append(rounded_down(max(Fraction(c) * (1 - _BELOW) - Fraction(w), Fraction(0)) / Fraction(speed)))
    return tuple(out)


@dataclass(frozen=True)
class DryFriction:
    """The dry friction of a device, by axis.

    Attributes:
        least: c, what it burns at least besides its level, as a force against its velocity, N.
        kept: w, how much of it is kept for the steps of encoders, N.
        speed: v*, m/s, below which the rest counts as damping; None where none of it does.

    Raises:
        ValueError: there is not one w for each c, or a number is out of its range.
    """

    least: tuple[float, ...]
    kept: tuple[float, ...]
    speed: float | None = None

    def __post_init__(self) -> None:
        if len(self.kept) != len(self.least):
            raise ValueError(f"friction: found {len(self.kept)} numbers kept of {len(self.least)}; expected as many")
        if not all(0.0 <= force < math.inf for force in (*self.least, *self.kept)):
            raise ValueError(f"friction: found {self.least} and {self.kept} N; expected finite numbers of at least 0")
        if self.speed is not None and not 0.0 < self.speed < math.inf:
            raise ValueError(f"friction: found a speed of {self.speed} m/s; expected a finite one greater than 0")

    @property
    def left(self) -> tuple[float, ...]:
        """What the steps of encoders leave of it, c - w, N, rounded down; 0 where nothing is left."""
        return damping_below(1.0, self.least, self.kept)

    def raised(self, level: Matrix) -> Matrix:
        """The level Delta_D (N*s/m) with what the friction adds below v*: Delta_D + diag((c - w)/v*)."""
        if self.speed is None:
            return level
        return matrix(level + np.diag(damping_below(self.speed, self.least, self.kept)))
