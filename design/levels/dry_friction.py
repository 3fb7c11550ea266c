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
from fractions import Fraction

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
        exact = max(Fraction(c) * (1 - _BELOW) - Fraction(w), Fraction(0)) / Fraction(speed)
        rounded = float(exact)
        out.append(rounded if Fraction(rounded) <= exact else math.nextafter(rounded, 0.0))
    return tuple(out)
